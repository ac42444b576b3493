"""Docks along walls: their pose in closed form, and none without room."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import Phase, assume, given, settings
from hypothesis import strategies as st

from optdock.errors import InvalidValue
from optdock.geometry.pose import Pose2, transform_points
from optdock.survey.dock_places import along_walls
from optdock.survey.grid import Box
from tests.optdock.survey.scenes import BACK_STATION, ROOM, STATION, scenario

BEHIND = 0.01 + 0.002  # [m] between the back of the station and the wall
HERE = Pose2(0, 0, 0)
SEAM = 1e-3  # [m]: error of the outline


def in_room(station=STATION, direction="forward", move=HERE, obstacles=()):
    problem = scenario(station=station, direction=direction).problem
    walls = [transform_points(move.as_array()[None], np.array(one, dtype=float))[0] for one in (*ROOM, *obstacles)]
    goal = move @ problem.goal
    return dataclasses.replace(problem, obstacles=walls, start=goal, dock=dataclasses.replace(problem.dock, pose=goal))


def inside(places, move=HERE):
    """Return the poses of docks inside the room, in the frame of the room. Shape (n, 3)."""
    found = [one.pose.in_frame_of(move).as_array() for one in places]
    return np.array([pose for pose in found if 0 < pose[0] < 4 and 0 < pose[1] < 3]).reshape(-1, 3)


def expected(spacing, width, back):
    """Return the docks in closed form: the middles of the walls, as many as fit. Shape (n, 3)."""
    rows = []
    for length, pose in (
        (4.0, lambda a: (a, back, -math.pi / 2)),
        (4.0, lambda a: (4.0 - a, 3.0 - back, math.pi / 2)),
        (3.0, lambda a: (4.0 - back, a, 0.0)),
        (3.0, lambda a: (back, 3.0 - a, math.pi)),
    ):
        count = int((length - width) / spacing + 1e-6) + 1
        first = 0.5 * (length - (count - 1) * spacing)
        rows += [pose(first + k * spacing) for k in range(count)]
    return np.array(rows)


def agree(found, wanted):
    """Whether every dock is next to exactly one of the others."""
    assert len(found) == len(wanted)
    for pose in wanted:
        off = np.hypot(*(found[:, :2] - pose[:2]).T) + np.abs(np.sin(0.5 * (found[:, 2] - pose[2])))
        assert np.sum(off < SEAM) == 1, pose


@given(st.floats(0.3, 2.0), st.floats(-3.1, 3.1), st.floats(-20.0, 20.0))
@settings(max_examples=8, phases=(Phase.generate,))
def test_docks_of_a_rotated_room_are_those_of_the_room(spacing, yaw, x):
    assume(all(abs(rest / spacing - round(rest / spacing)) > 1e-2 for rest in (3.6, 2.6)))  # the number of docks
    move = Pose2(x, -0.5 * x, yaw)
    agree(inside(along_walls(in_room(move=move), spacing), move), expected(spacing, 0.4, 0.25 + BEHIND))


@pytest.mark.parametrize(
    ("station", "direction", "width", "back", "turned"),
    [
        (STATION, "forward", 0.4, 0.25, 0.0),
        (BACK_STATION, "backward", 0.4, 0.25, math.pi),
        (None, "forward", 0.3, 0.15, 0.0),
        (None, "backward", 0.3, 0.15, math.pi),
    ],
)
def test_the_back_of_the_station_is_at_the_wall(station, direction, width, back, turned):
    wanted = expected(0.7, width, back + BEHIND)
    wanted[:, 2] += turned
    agree(inside(along_walls(in_room(station, direction), 0.7)), wanted)


def test_no_dock_where_the_straight_is_blocked():
    """A shelf 0.45 m in front of the lower wall leaves room for the robot, but not for the final straight."""
    shelf = [(0.5, 0.55), (3.5, 0.55), (3.5, 0.6), (0.5, 0.6)]
    found = inside(along_walls(in_room(obstacles=[shelf]), 0.5))
    before = (found[:, 1] < 0.55) & (found[:, 0] > 0.4) & (found[:, 0] < 3.6)
    assert not before.any()
    assert len(found) > 8


def test_no_dock_whose_station_overlaps_an_obstacle():
    """A cable duct in front of the lower wall, which does not touch the docked robots."""
    duct = [(1.5, 0.03), (2.5, 0.03), (2.5, 0.06), (1.5, 0.06)]
    found, without = (inside(along_walls(in_room(obstacles=some), 0.5)) for some in ([duct], []))
    beside = [np.sum((docks[:, 1] < 0.3) & (abs(docks[:, 0] - 2.0) < 0.69)) for docks in (found, without)]
    assert beside[0] == 0
    assert beside[1] > 0


def test_only_docks_in_the_region_with_consecutive_names():
    problem = in_room()
    every = along_walls(problem, 0.5)
    some = along_walls(problem, 0.5, Box(0.0, 0.0, 4.0, 1.0))
    assert [one.name for one in some] == [f"wall {k + 1}" for k in range(len(some))]
    assert {one.pose for one in some} == {one.pose for one in every if 0 <= one.pose.x <= 4 and 0 <= one.pose.y <= 1}


def test_walls_that_are_too_short_have_no_dock():
    post = [(2.0, 1.4), (2.3, 1.4), (2.3, 1.7), (2.0, 1.7)]
    found = inside(along_walls(in_room(obstacles=[post]), 0.5))
    near = np.hypot(found[:, 0] - 2.15, found[:, 1] - 1.55) < 0.6
    assert not near.any()


@pytest.mark.parametrize("spacing", [0.0, -1.0, math.nan, math.inf])
def test_a_wrong_spacing_is_named(spacing):
    with pytest.raises(InvalidValue, match="along walls: the spacing must be > 0 m"):
        along_walls(in_room(), spacing)


def test_no_walls_no_docks():
    problem = dataclasses.replace(scenario().problem, obstacles=())
    assert along_walls(problem, 0.5) == []
