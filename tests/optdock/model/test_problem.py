"""The docking problem accepts plain values (polygons, one number, a grid) and names invalid ones."""

import dataclasses
import math

import numpy as np
import pytest

from optdock.errors import InvalidValue, NoMotionExists, StartOccupied
from optdock.geometry.arrays import digest
from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.costmap import Costmap
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.planning.pipeline import plan_dock

ROBOT = Robot(Footprint.rectangle(0.3, 0.3, 0.4), MotionLimits(max_curvature=2.0, max_curvature_rate=8.0))
DOCK = Dock(Pose2(3.0, 1.0, 0.0))
START = Pose2(0.5, 1.0, 0.0)
BOX = [(1, 2), (3, 2), (3, 2.4), (1, 2.4)]


def problem(**parts):
    return DockingProblem(**{"start": START, "dock": DOCK, "robot": ROBOT, **parts})


@pytest.mark.parametrize(
    "polygons", [[BOX], ([[x, y] for x, y in BOX],), [np.array(BOX)], np.array([BOX]), (box for box in [BOX])]
)
def test_plain_polygons_are_obstacles(polygons):
    made, same = problem(obstacles=polygons), problem(obstacles=ObstacleSet.from_polygons([BOX]))
    assert type(made.obstacles) is ObstacleSet
    assert made.fingerprint == same.fingerprint
    assert made.obstacles.name_of(0) == "obstacles[0]"


def test_distant_stations_are_rejected():
    """The robot is 0.72 m long; a station within 1 m is accepted."""
    corners = np.array([[0.0, -0.2], [0.2, -0.2], [0.2, 0.2], [0.0, 0.2]])
    for gap, accepted in ((0.0, True), (0.99, True), (1.01, False), (50.0, False)):
        for side, shift in ((1.0, [0.3 + gap, 0.0]), (-1.0, [0.3 + gap, 0.0]), (1.0, [-0.1, 0.4 + gap])):
            dock = dataclasses.replace(DOCK, footprint=Footprint(side * (corners + np.array(shift))))
            if accepted:
                assert len(problem(dock=dock).all_obstacles) == 1
            else:
                with pytest.raises(InvalidValue, match=f"^dock.footprint: is {gap:.3f} m away from the docked robot"):
                    problem(dock=dock)


def test_a_long_wall_beside_the_docked_robot_is_a_station():
    wall = Footprint(np.array([[0.31, -20.0], [0.5, -20.0], [0.5, 20.0], [0.31, 20.0]]))
    around = Footprint(np.array([[-0.5, -9.0], [9.0, -9.0], [9.0, 9.0], [-0.5, 9.0], [-0.5, 8.9], [8.9, 8.9],
                                 [8.9, -8.9], [-0.5, -8.9]]))  # fmt: skip
    assert len(problem(dock=dataclasses.replace(DOCK, footprint=wall)).all_obstacles) == 1
    with pytest.raises(InvalidValue, match=r"is 8\.6\d* m away"):
        problem(dock=dataclasses.replace(DOCK, footprint=around))


def test_no_alternative_is_suggested_for_a_station_far_in_both_frames():
    far = Footprint(np.array([[90.0, 0.0], [91.0, 0.0], [91.0, 1.0]]))
    with pytest.raises(InvalidValue, match="not of the map$"):
        problem(dock=dataclasses.replace(DOCK, footprint=far))


def test_obstacles_default_to_none():
    for nothing in ([], (), ObstacleSet.empty()):
        assert len(problem(obstacles=nothing).all_obstacles) == 0
    assert problem().fingerprint == problem(obstacles=[]).fingerprint


@pytest.mark.parametrize(
    ("obstacles", "message"),
    [
        ([BOX, [(0, 0), (1, 0)]], r"^obstacles\[1\]"),
        ([BOX, BOX, [(0, 0), (1, 1), (1, 0), (0, 1)]], r"^obstacles\[2\]"),
        ([BOX, [(0, 0), (1, math.nan), (1, 0)]], r"^obstacles\[1\]"),
        ([BOX, "wall"], r"^obstacles\[1\]"),
        (BOX, r"^obstacles\[0\]"),
        ("wall", "^obstacles: must be an ObstacleSet or a list of polygons, got str"),
        (3, "^obstacles: must be an ObstacleSet or a list of polygons, got int"),
        (None, "^obstacles: must be an ObstacleSet or a list of polygons, got NoneType"),
        ({"wall": BOX}, "^obstacles: must be an ObstacleSet or a list of polygons, got dict"),
        (Footprint(np.array(BOX)), "^obstacles: must be an ObstacleSet or a list of polygons, got Footprint"),
    ],
)
def test_invalid_polygons_are_named(obstacles, message):
    with pytest.raises(InvalidValue, match=message):
        problem(obstacles=obstacles)


@pytest.mark.parametrize("value", [0.05, np.float64(0.05), 0, 1])
def test_one_clearance_holds_everywhere_also_at_the_dock(value):
    rule = problem(clearance=value).clearance
    assert type(rule) is ClearanceRule
    assert (rule.required, rule.at_dock) == (value, value)
    np.testing.assert_array_equal(rule.required_at(np.array([0.0, 0.1, 5.0]), np.full(3, 9.0), 9.0), float(value))


@pytest.mark.parametrize(
    "value", [-0.1, math.nan, math.inf, pytest.param(10**400, id="huge"), True, "0.05", None, [0.05]]
)
def test_a_clearance_is_a_rule_or_a_number(value):
    with pytest.raises(InvalidValue, match="^clearance"):
        problem(clearance=value)


def test_another_start_changes_nothing_else():
    case = problem(obstacles=[BOX], clearance=0.1, start_speed=0.2, start_curvature=0.0, frame="hall")
    moved = case.starting_at(Pose2(0.2, 1.5, 0.1))
    assert (moved.start, moved.start_speed, moved.start_curvature) == (Pose2(0.2, 1.5, 0.1), 0.0, None)
    assert moved.fingerprint.differences(case.fingerprint) == ("start",)
    driving = case.starting_at(Pose2(0.2, 1.5, 0.1), speed=-0.1, curvature=0.3)
    assert (driving.start_speed, driving.start_curvature) == (-0.1, 0.3)


def test_a_start_acceleration_is_in_the_digest_only_if_set():
    case = problem(start_speed=0.2, start_curvature=0.0)
    pressed = case.starting_at(case.start, 0.2, 0.0, -0.3)
    assert pressed.start_acceleration == -0.3
    assert pressed.fingerprint.differences(case.fingerprint) == ("start",)
    assert case.fingerprint.start == digest(case.start.as_array(), 0.2, "0.0")
    with pytest.raises(InvalidValue, match=r"start\.acceleration"):
        problem(start_acceleration=math.nan)


@pytest.mark.parametrize(
    ("given", "gear", "along"),
    [
        ((0.2, 0.3), -1, (0.2, 0.3)),  # in motion the speed says which gear it is
        ((-0.2, 0.3), 1, (0.2, -0.3)),
        ((0.0, 0.3), 1, (0.0, 0.3)),
        ((0.0, 0.3), -1, (0.0, -0.3)),
        ((0.0, 0.0), 0, (0.0, 0.0)),
    ],
)
def test_the_start_along_the_travel(given, gear, along):
    assert problem(start_speed=given[0], start_acceleration=given[1]).start_state(gear) == along


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_rounding_errors_of_rest_count_as_rest(sign):
    """Sampled trajectories end with accelerations such as -1e-12, from which a robot at rest cannot start."""
    still = problem(start_speed=sign * 1e-14, start_acceleration=-1e-12)
    assert (still.start_speed, still.start_acceleration) == (0.0, 0.0)
    jerk = still.robot.limits.max_jerk
    least = 0.5 * (0.1 * 0.1) / jerk  # at -0.1 m/s^2
    braking = problem(start_speed=sign * (least - 1e-12), start_acceleration=-sign * 0.1)
    assert braking.start_speed == pytest.approx(sign * least, abs=1e-17)
    rolling = problem(start_speed=sign * 0.5 * least, start_acceleration=-sign * 0.1)  # no rounding: it rolls back
    assert rolling.start_speed == sign * 0.5 * least


# Row 0 is the lowest y: a wall of cells above the way, and one occupied cell at the lower left corner of the grid.
GRID = np.zeros((40, 80), dtype=np.int8)
GRID[0, 0] = 100
GRID[30:32, 20:60] = 100


def from_grid(grid, **more):
    return DockingProblem.from_grid(grid, 0.05, (-0.2, 0.1), start=START, dock=DOCK, robot=ROBOT, **more)


def boxes(case):
    """Return the lower and upper corners of all pieces on the map."""
    inside = [i for i in range(len(case.all_obstacles)) if case.all_obstacles.name_of(i) == "map"]
    corners = np.column_stack((case.all_obstacles.lower, case.all_obstacles.upper))[inside]
    return sorted(tuple(row) for row in np.round(corners, 9).tolist())


def test_row_0_of_a_grid_is_the_lowest_y_and_column_0_the_lowest_x():
    assert boxes(from_grid(GRID)) == [(-0.2, 0.1, -0.15, 0.15), (0.8, 1.6, 2.8, 1.7)]


def test_flipped_or_transposed_grids_give_other_obstacles():
    """The grid has no symmetry, so exchanged rows and columns or a flipped axis give other obstacles."""
    seen = [boxes(from_grid(grid)) for grid in (GRID, GRID[::-1], GRID[:, ::-1], GRID.T)]
    assert all(seen[i] != seen[j] for i in range(4) for j in range(i))


def test_the_plot_of_a_grid_matches_its_obstacles(tmp_path):
    """The wall has a larger y than the path, so it is above the path in the picture."""
    from PIL import Image

    plan_dock(from_grid(GRID), time_budget=20.0).plot(tmp_path / "plan.png")
    pixels = np.asarray(Image.open(tmp_path / "plan.png").convert("RGB"), dtype=int)
    grey, blue = (np.all(np.abs(pixels - colour) <= 2, axis=2) for colour in ([70, 70, 70], [0, 114, 178]))
    wall, way = (np.flatnonzero(colour.sum(axis=1) > 0.2 * pixels.shape[1]) for colour in (grey, blue))
    assert wall.size > 0
    assert way.size > 0
    assert wall.max() < way.min()


@pytest.mark.parametrize("kind", [np.int8, np.int64, np.uint8, list])
def test_integers_are_occupancies(kind):
    grid = GRID.tolist() if kind is list else GRID.astype(kind)
    assert boxes(from_grid(grid)) == boxes(from_grid(GRID))


def test_booleans_are_occupied_or_free():
    assert boxes(from_grid(GRID > 0)) == boxes(from_grid(GRID))
    assert len(boxes(from_grid(np.zeros_like(GRID, dtype=bool)))) == 0


def test_cells_above_the_threshold_are_obstacles():
    for occupancy in (0, 2, 19, 20, 21, 50, 64, 65, 66, 99, 100):
        grid = np.zeros((4, 4), dtype=np.int8)
        grid[1, 2] = occupancy
        assert (len(boxes(from_grid(grid))) == 1) is (occupancy >= 65)
        assert (len(boxes(from_grid(grid, occupied_from=20))) == 1) is (occupancy >= 20)


def test_ones_are_occupied_with_threshold_one():
    assert boxes(from_grid((GRID > 0).astype(int), occupied_from=1)) == boxes(from_grid(GRID))


def test_unknown_cells_are_obstacles_by_default():
    grid = GRID.copy()
    grid[15:20, 5:20] = -1  # under the robot at the start
    assert "unknown" in from_grid(grid).all_obstacles.names
    with pytest.raises(StartOccupied, match="unknown"):
        plan_dock(from_grid(grid), time_budget=20.0)
    assert plan_dock(from_grid(grid, unknown_is_obstacle=False), time_budget=20.0).certificate.certified


def test_grid_and_obstacles_are_combined():
    across = [[(1.5, 0.2), (1.6, 0.2), (1.6, 1.9), (1.5, 1.9)]]
    assert plan_dock(from_grid(GRID), time_budget=20.0).certificate.certified
    with pytest.raises(NoMotionExists):
        plan_dock(from_grid(GRID, obstacles=across), time_budget=20.0)


def test_a_grid_is_a_costmap():
    costmap = Costmap(np.where(GRID > 0, 254, 0), 0.05, (-0.2, 0.1))
    assert from_grid(GRID, clearance=0.1).fingerprint == problem(costmap=costmap, clearance=0.1).fingerprint
    assert dataclasses.replace(from_grid(GRID), start=DOCK.pose).costmap is not None


@pytest.mark.parametrize(
    ("grid", "more", "message"),
    [
        (GRID.astype(float), {}, "occupancy: must be booleans, or integers -1"),
        ([["free"]], {}, "occupancy: must be booleans, or integers -1"),
        (np.array([[0, 101]]), {}, "occupancy: must be -1 .* got 101"),
        (np.array([[0, -2]]), {}, "occupancy: must be -1 .* got -2"),
        (np.array([[0, 255]], dtype=np.uint8), {}, "occupancy: must be -1 .* got 255"),
        (GRID[0], {}, r"must have shape \(rows, columns\)"),
        (np.zeros((0, 3), dtype=int), {}, "at least one cell"),
        ((GRID > 0).astype(int), {}, "pass a mask as booleans, or set occupied_from = 1"),
        (np.ma.masked_equal(GRID, 0), {}, "must not be masked"),
        ([[0, 100], [0]], {}, "every row must have as many cells"),
        (GRID, {"occupied_from": 0}, "occupied_from: must be an integer in 1..100"),
        (GRID, {"occupied_from": 0.65}, "occupied_from: must be an integer in 1..100"),
    ],
)
def test_invalid_grids_are_rejected(grid, more, message):
    with pytest.raises(InvalidValue, match=message):
        from_grid(grid, **more)
