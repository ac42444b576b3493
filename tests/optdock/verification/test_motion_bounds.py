"""Cells of motion and the places where they meet."""

import numpy as np
import pytest

from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.pose import Pose2
from optdock.model.path import ClothoidSegment, Path, PolylineSegment, TurnSegment
from optdock.verification.motion_bounds import PathMotion

ORIGIN = Pose2(0.0, 0.0, 0.0)


def two_gears():
    forward = ClothoidSpline(Pose2(0.0, 0.0, 0.0), [0.0, 0.5, 1.3], [0.2, 1.0, -0.4])
    back = ClothoidSpline(forward.end, [0.0, 0.7, 0.9], [0.3, -1.2, 0.0], -1)
    return Path((ClothoidSegment(forward), ClothoidSegment(back)))


def turning_polyline():
    return Path.from_poses([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [0.5, 0.0, 1.2], [0.3, -0.5, 1.2]])


@pytest.mark.parametrize("make", [two_gears, turning_polyline])
@pytest.mark.parametrize("parts", [1, 2, 3, 8])
def test_every_end_appears_once_and_every_cell_finds_its_own(make, parts):
    cells = PathMotion(make()).cells(0.08).cut(parts)
    ends = cells.ends()
    assert len(set(zip(ends.segment.tolist(), ends.u.tolist(), strict=True))) == ends.u.size
    for place, u in ((ends.first, cells.first), (ends.last, cells.last)):
        assert (ends.u[place] == u).all()
        assert (ends.segment[place] == cells.segment).all()
    # Every place but the two ends of each segment belongs to two cells.
    assert ends.u.size == cells.first.size + len(set(cells.segment.tolist()))


@pytest.mark.parametrize("parts", [1, 2, 3, 8])
def test_the_parts_of_a_cell_cover_it(parts):
    cells = PathMotion(two_gears()).cells(0.08)
    cut = cells.cut(parts)
    assert cut.first.size == parts * cells.first.size
    order = np.lexsort((cut.first, cut.segment))
    first, last = cut.first[order].reshape(-1, parts), cut.last[order].reshape(-1, parts)
    assert (first[:, 0] == cells.first).all()
    assert (last[:, -1] == cells.last).all()
    assert (first[:, 1:] == last[:, :-1]).all()
    assert (last - first) == pytest.approx(np.tile((cells.last - cells.first)[:, None] / parts, parts), rel=1e-9)


def test_the_two_sides_of_a_cusp_are_two_places():
    path = two_gears()
    ends = PathMotion(path).cells(0.08).ends()
    at_cusp = (ends.segment == 0) & (ends.u == path.segments[0].length) | (ends.segment == 1) & (ends.u == 0.0)
    assert at_cusp.sum() == 2


def test_equal_parameters_on_two_segments_are_two_places():
    poses = [[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [1.0, 0.0, 0.0], [0.6, 0.0, 0.0], [0.2, 0.0, 0.0]]
    cells = PathMotion(Path.from_poses(poses)).cells(0.08)
    first_and_last = cells.rows(np.array([0, 3]))
    assert first_and_last.last[0] == first_and_last.first[1]
    assert first_and_last.ends().u.size == 4


@pytest.mark.parametrize("make", [two_gears, turning_polyline])
def test_the_last_cell_is_halved_and_the_others_stay(make):
    cells = PathMotion(make()).cells(0.08)
    finer = cells.last_halved()
    assert finer.first.size == cells.first.size + 1
    assert (finer.first[:-1] == cells.first).all()
    assert (finer.last[:-2] == cells.last[:-1]).all()
    assert finer.last[-1] == cells.last[-1]
    assert finer.last[-2] == finer.first[-1] == 0.5 * (cells.first[-1] + cells.last[-1])
    assert (finer.segment[-2:] == cells.segment[-1]).all()


def test_a_path_of_one_cell_is_halved_too():
    finer = PathMotion(Path((PolylineSegment([[0.0, 0.0, 0.0], [0.01, 0.0, 0.0]]),))).cells(0.08).last_halved()
    assert finer.first.tolist() == [0.0, 0.5]
    assert finer.last.tolist() == [0.5, 1.0]
    assert np.unique(finer.segment).tolist() == [0]


def turns():
    first = TurnSegment(Pose2(0.3, -0.2, 0.4), 1.7)
    return Path((first, ClothoidSegment(ClothoidSpline(first.end, [0.0, 0.6], [0.0, 0.8])), TurnSegment(ORIGIN, -3.0)))


@pytest.mark.parametrize("make", [two_gears, turning_polyline, turns])
def test_no_body_point_moves_or_bends_faster_than_its_bounds(make):
    """By finite differences of the poses: velocities at both ends of every cell, accelerations within it."""
    motion = PathMotion(make())
    cells = motion.cells(0.08)
    body = np.array([[0.5, 0.2], [-0.3, 0.4], [1.1, -0.7]])

    def places(share):
        poses = motion.nodes(cells.segment, cells.first + share * (cells.last - cells.first)).poses
        c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        turned = np.einsum("ijn,kj->nki", np.array([[c, -s], [s, c]]), body)
        return poses[:, None, :2] + turned, poses

    ends = [places(share)[1] for share in (0.0, 1.0)]
    found = motion.bounds(cells, *ends)
    h = 1e-3
    for share, velocity in ((h, found.velocity_first), (1.0 - h, found.velocity_last)):
        rate = (places(share + h)[1] - places(share - h)[1]) / (2.0 * h * found.width[:, None])
        np.testing.assert_allclose(rate, velocity, atol=2e-3)
    for share in np.linspace(0.0, 1.0 - h, 7):  # the broad phase rests on these two
        x, y, yaw = (places(share + h)[1] - places(share)[1]).T / (h * found.width)
        assert np.all(np.hypot(x, y) <= found.speed + 1e-6)
        assert np.all(np.abs(yaw) <= found.turn + 1e-6)
    reach = np.hypot(*body.T)
    for share in np.linspace(0.05, 0.95, 7):
        before, here, after = (places(share + step)[0] for step in (-0.05, 0.0, 0.05))
        acceleration = np.linalg.norm(after - 2.0 * here + before, axis=2) / (0.05 * found.width[:, None]) ** 2
        assert np.all(acceleration <= found.bend[:, None] + reach * found.twist[:, None] + 1e-6)
    # And hardly less, where that can be told from one end: a turn has one acceleration.
    still = np.flatnonzero(found.speed == 0.0)
    np.testing.assert_allclose(acceleration[still], (reach * found.twist[:, None])[still], rtol=1e-2)
