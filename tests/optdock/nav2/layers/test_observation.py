import numpy as np
import shapely
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from optdock.nav2.layers.obstacle import segments_in_box

# Eighths, so that nothing but the cut itself rounds.
segments = hnp.arrays(int, st.tuples(st.integers(0, 6), st.just(2), st.just(2)), elements=st.integers(-40, 40))


@given(segments)
def test_cut_segments_are_what_shapely_leaves_of_them(corners):
    starts, ends = corners[:, 0] / 8.0, corners[:, 1] / 8.0
    lower, upper = np.array([-1.0, -2.0]), np.array([3.0, 1.0])
    cut_starts, cut_ends, meets = segments_in_box(starts, ends, lower, upper)
    box = shapely.box(*lower, *upper)
    for n in range(len(starts)):
        whole = shapely.Point(starts[n]) if np.all(starts[n] == ends[n]) else shapely.LineString([starts[n], ends[n]])
        rest = whole.intersection(box)
        assert meets[n] == (not rest.is_empty) or box.distance(whole) < 1e-12
        if meets[n] and not rest.is_empty:
            assert abs(rest.length - np.linalg.norm(cut_ends[n] - cut_starts[n])) < 1e-9
            assert rest.distance(shapely.Point(cut_starts[n])) < 1e-9
