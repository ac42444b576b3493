import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from optdock.errors import InvalidValue
from optdock.nav2.layers.inflation import InflationRule, inflation_costs

DISTANCES = [0.25, 0.30, 0.40, 0.50, 0.55, 0.70]


@pytest.mark.parametrize(("factor", "costs"), [(3.0, [230, 198, 146, 108, 93, 59]), (10.0, [186, 113, 41, 15, 9, 2])])
def test_costs_are_nav2s_to_the_integer(factor, costs):
    rule = InflationRule(inscribed_radius=0.22, inflation_radius=0.70, cost_scaling_factor=factor)
    assert rule.cost_at(DISTANCES).tolist() == costs
    assert rule.cost_at([0.0, 0.05, 0.22, 0.75]).tolist() == [254, 253, 253, 0]


def test_the_default_radius_ends_before_seventy_centimetres():
    assert InflationRule(0.22).cost_at(DISTANCES).tolist() == [186, 113, 41, 15, 9, 0]


def brute_force(seeds, resolution, rule):
    """Nearest seed by trying all of them, Nav2's formula by `math`."""
    costs = np.zeros(seeds.shape, dtype=int)
    places = np.argwhere(seeds)
    for j, i in np.ndindex(*seeds.shape):
        cells = min((math.hypot(i - si, j - sj) for sj, si in places), default=math.inf)
        d = cells * resolution
        if cells == 0:
            costs[j, i] = 254
        elif d > rule.inflation_radius + 1e-9:
            costs[j, i] = 0
        elif d <= rule.inscribed_radius:
            costs[j, i] = 253
        else:
            costs[j, i] = int(252 * math.exp(-rule.cost_scaling_factor * (d - rule.inscribed_radius)))
    return costs


@given(
    hnp.arrays(np.bool_, st.tuples(st.integers(1, 9), st.integers(1, 9))),
    st.sampled_from([0.0, 0.1, 0.3, 0.55, 2.0]),
    st.sampled_from([0.0, 0.12, 0.37]),
)
def test_grid_costs_are_those_of_the_nearest_seed(seeds, radius, inscribed):
    rule = InflationRule(inscribed, radius, 3.0)
    np.testing.assert_array_equal(inflation_costs(seeds, 0.1, rule), brute_force(seeds, 0.1, rule))


def test_the_fourteenth_cell_is_within_seventy_centimetres_in_spite_of_rounding():
    rule = InflationRule(0.22, 0.70, 3.0)
    seeds = np.zeros((1, 20), dtype=bool)
    seeds[0, 0] = True
    costs = inflation_costs(seeds, 0.05, rule)[0]
    assert rule.reach(0.05) == 14
    assert costs[14] == 59
    assert costs[15] == 0


@pytest.mark.parametrize("name", ["inscribed_radius", "inflation_radius", "cost_scaling_factor"])
@pytest.mark.parametrize("value", [-0.1, math.nan, math.inf])
def test_bad_values_are_named(name, value):
    with pytest.raises(InvalidValue, match=rf"inflation\.{name}"):
        InflationRule(**{"inscribed_radius": 0.2, name: value})
