"""Laws of `still_holds`: true only where it is proven, and equal to what a proof of the rest says."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from experiments.dense_check import dense_check
from optdock.errors import InvalidValue
from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2
from optdock.model.costmap import Costmap
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot, TrackingTube
from optdock.planning.pipeline import plan_dock
from optdock.planning.replanning import still_holds
from optdock.verification import certify_path

ORIGIN, CELL, SIDE = (-3.0, -2.0), 0.1, 40


def box_at(x, y):
    """A square of 0.16 m."""
    return np.array([[x - 0.08, y - 0.08], [x + 0.08, y - 0.08], [x + 0.08, y + 0.08], [x - 0.08, y + 0.08]])


@functools.cache
def running():
    """A plan among two boxes, on a map whose left part is blocked."""
    limits = MotionLimits(max_curvature=1.5, max_curvature_rate=6.0)
    robot = Robot(Footprint.rectangle(0.3, 0.3, 0.4), limits)
    station = Footprint([[0.31, -0.2], [0.4, -0.2], [0.4, 0.2], [0.31, 0.2]])
    cells = np.zeros((SIDE, SIDE), dtype=np.uint8)
    cells[:, 0] = 254
    problem = DockingProblem(
        Pose2(-2.0, 0.5, 0.2),
        Dock(Pose2(0.3, 0.0, 0.0), station, final_straight=0.2),
        robot,
        [box_at(-1.0, 1.2), box_at(-1.0, -0.9)],
        costmap=Costmap(cells, CELL, ORIGIN),
    )
    return plan_dock(problem, time_budget=30.0)


def rest_problem(world, time):
    """The problem of the rest of the plan, from where the robot is."""
    plan = running()
    rest = plan.path.piece(float(plan.trajectory.sample_at(time).s[0]))
    return rest, world.starting_at(rest.start)


def worlds(draw):
    """The plan's world with other cells, another grid, or other boxes."""
    plan = running()
    rng = np.random.default_rng(draw)
    kind = int(rng.integers(3))
    if kind == 0:
        cells = plan.problem.costmap.data.copy()
        cells[tuple(rng.integers(0, SIDE, (2, int(rng.integers(1, 12)))))] = rng.choice([254, 255])
        return Costmap(cells, CELL, ORIGIN)
    if kind == 1:
        shift, count = rng.uniform(-0.3, 0.3, 2), int(rng.integers(36, 60))
        cells = np.where(rng.uniform(size=(count, count)) < 0.004, 254, 0).astype(np.uint8)
        return Costmap(cells, float(rng.uniform(0.08, 0.1)), (ORIGIN[0] + shift[0], ORIGIN[1] + shift[1]))
    boxes = [box_at(*place) for place in rng.uniform([-2.5, -1.2], [0.5, 1.5], (int(rng.integers(1, 5)), 2))]
    return ObstacleSet.from_polygons([*plan.problem.obstacles.vertices, *boxes])


def as_problem(world):
    part = {"costmap": world} if isinstance(world, Costmap) else {"obstacles": world}
    return dataclasses.replace(running().problem, **part)


@settings(max_examples=25)
@given(st.integers(0, 10_000), st.floats(0.0, 0.99))
def test_result_equals_a_proof_of_the_rest(draw, share):
    plan, world = running(), worlds(draw)
    time = share * plan.trajectory.duration
    found = still_holds(plan, world, time)
    rest, problem = rest_problem(as_problem(world), time)
    verdict = certify_path(rest, problem)
    broken = {violation.kind for violation in verdict.violations} & {"clearance", "unproven"}
    if found:
        assert "clearance" not in dense_check(rest, problem).broken
        # A rule that the robot has been relieved of is stricter for one that begins anew; this plan has none such.
        assert not broken
    else:
        assert broken or _stands_too_close(rest, problem)
        assert found.at_s >= float(plan.trajectory.sample_at(time).s[0]) - 1e-9
        assert float(plan.trajectory.sample_at(found.at_time).s[0]) == pytest.approx(found.at_s, abs=1e-6)
        assert found.obstacle
        assert found.clearance < found.required
        assert found.obstacle in found.reason


def _stands_too_close(rest, problem):
    """A proof of the rest forgives a robot that stands too close already; the plan's rule does not."""
    from optdock.verification import pose_clearance

    return pose_clearance(rest.start, problem.robot.footprint, problem.all_obstacles)[0] < problem.clearance.required


def test_unchanged_world_is_not_proven_again():
    plan = running()
    same = Costmap(plan.problem.costmap.data, CELL, ORIGIN)
    for world in (plan.problem, plan.problem.costmap, same, ObstacleSet.from_polygons(plan.problem.obstacles.vertices)):
        assert still_holds(plan, world, 1.0).changed == ()
        assert still_holds(plan, world, 1.0, is_late=lambda: True)


def test_changes_are_named():
    plan = running()
    problem = plan.problem
    moved = dataclasses.replace(problem.dock, pose=problem.goal @ Pose2(0.01, 0.0, 0.0))
    for change, names in (
        ({"dock": moved}, ("dock",)),
        ({"clearance": 0.01}, ("clearance",)),
        ({"obstacles": [], "costmap": None}, ("obstacles", "costmap")),
        ({"robot": Robot(Footprint.rectangle(0.3, 0.3, 0.3), problem.robot.limits)}, ("footprint",)),
        ({"robot": Robot(problem.robot.footprint, MotionLimits(max_speed=0.1))}, ("limits",)),
    ):
        assert still_holds(plan, dataclasses.replace(problem, **change), 1.0).changed == names


def test_world_in_another_frame_does_not_hold():
    plan = running()
    found = still_holds(plan, dataclasses.replace(plan.problem, frame="odom"))
    assert not found
    assert found.changed == ("frame",)
    assert "odom" in found.reason


def test_obstacles_behind_the_robot_are_ignored():
    plan = running()
    on_the_way = ObstacleSet.from_polygons([box_at(*plan.path.poses_at(0.5)[0, :2])], "crate")
    world = plan.problem.obstacles + on_the_way
    early, late = still_holds(plan, world, 0.0), still_holds(plan, world, 0.85 * plan.trajectory.duration)
    assert not early
    assert early.obstacle == "crate[0]"
    assert late
    assert late.changed == ("obstacles",)


def test_station_that_moves_into_the_robot_is_a_conflict():
    plan = running()
    nearer = dataclasses.replace(plan.problem.dock, pose=plan.problem.goal @ Pose2(-0.05, 0.0, 0.0))
    found = still_holds(plan, dataclasses.replace(plan.problem, dock=nearer), 1.0)
    assert not found
    assert found.obstacle == "dock"


@pytest.mark.parametrize("counts", [True, False])
def test_unknown_cells_that_become_obstacles_are_new_ones(counts):
    """The map is the same, what it means is not."""
    cells = np.zeros((100, 100), dtype=np.uint8)
    cells[45:56, 35] = 255
    known = dataclasses.replace(open_problem(), costmap=Costmap(cells, 0.1, (-5.0, -5.0)), unknown_is_obstacle=False)
    plan = plan_dock(known, time_budget=30.0)
    found = still_holds(plan, dataclasses.replace(known, unknown_is_obstacle=counts))
    assert found.holds is not counts
    assert found.changed == (("costmap",) if counts else ())


def test_map_that_ends_on_the_way_is_a_border():
    plan = running()
    window = Costmap(np.zeros((10, 10), dtype=np.uint8), CELL, (-2.5, 0.0))
    found = still_holds(plan, window)
    assert not found
    assert found.obstacle == "map border"


def test_invalid_worlds_are_refused():
    with pytest.raises(InvalidValue, match="world"):
        still_holds(running(), "a map")
    with pytest.raises(InvalidValue, match="from_time"):
        still_holds(running(), running().problem, float("nan"))


NONE, WIDE = TrackingTube(), TrackingTube(0.4)


def open_problem(tube=NONE, obstacles=()):
    robot = Robot(Footprint.from_radius(0.3), MotionLimits(max_curvature=1.5, max_curvature_rate=6.0), tracking=tube)
    return DockingProblem(Pose2(-3.0, 0.2, 0.0), Dock(Pose2(0.0, 0.0, 0.0)), robot, obstacles)


def post_beside(plan, gap, share=0.5):
    """A small post so far from the left side of a round robot on its path."""
    pose = plan.path.pose_at(share * plan.path.length)
    x, y = (pose @ Pose2(0.0, 0.3 + gap, 0.0)).as_array()[:2]
    return np.array([[x - 0.01, y], [x + 0.01, y], [x + 0.01, y + 0.02], [x - 0.01, y + 0.02]])


@functools.cache
def planned(tube):
    return plan_dock(open_problem(tube))


@pytest.mark.parametrize("gap", [0.02, 0.2, 0.3, 0.38, 0.5])
@pytest.mark.parametrize("tube", [NONE, WIDE])
def test_tube_adds_to_the_clearance(tube, gap):
    plan = planned(tube)
    obstacles = ObstacleSet.of([post_beside(plan, gap)])
    there = dataclasses.replace(plan.problem, obstacles=obstacles)
    assert still_holds(plan, obstacles).holds is certify_path(plan.path, there).certified


def test_wider_tube_changes_the_clearance_rule():
    plan = plan_dock(open_problem(obstacles=[post_beside(planned(NONE), 0.2)]))
    wide = dataclasses.replace(plan.problem, robot=open_problem(WIDE).robot)
    found = still_holds(plan, wide)
    assert not found
    assert found.changed == ("clearance",)
    assert not certify_path(plan.path, wide).certified


@pytest.mark.parametrize("beyond", [0.0, 1.0])
def test_robot_at_the_end_of_its_plan_must_be_clear(beyond):
    plan = planned(NONE)
    x, y = plan.path.end.x, plan.path.end.y
    time = plan.trajectory.duration + beyond
    on_the_robot = ObstacleSet.of([np.array([[x, y], [x + 0.1, y], [x, y + 0.1]])])
    assert not still_holds(plan, on_the_robot, time)
    cells = np.zeros((100, 100), dtype=np.uint8)
    assert still_holds(plan, Costmap(cells, 0.1, (-5.0, -5.0)), time)
    cells[50, 50] = 254
    assert not still_holds(plan, Costmap(cells, 0.1, (-5.0, -5.0)), time)


class _SameDigest(ObstacleSet):
    """Obstacles that call themselves those of the plan."""

    @property
    def digest(self):
        return running().problem.obstacles.digest


def test_world_is_no_subclass_that_could_be_another_one():
    plan = running()
    known = plan.problem
    wall = ObstacleSet.of([box_at(-1.0, 0.2)])
    assert not still_holds(plan, wall)
    classes = [
        _SameDigest(wall.vertices, wall.names, wall.group),
        type("Grid", (Costmap,), {})(known.costmap.data, CELL, ORIGIN),
        type("World", (DockingProblem,), {})(known.start, known.dock, known.robot),
    ]
    for world in classes:
        with pytest.raises(InvalidValue, match="world"):
            still_holds(plan, world)
