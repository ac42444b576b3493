"""`CasadiSmoother`: what it promises about every result."""

import dataclasses
import functools
import itertools
import math
import time

import numpy as np
import pytest

from experiments.dense_check import dense_check
from experiments.families import FEASIBLE_FAMILIES, INFEASIBLE_FAMILIES, instance
from optdock.deadline import Deadline
from optdock.errors import FailedToSmoothPath, SmootherException
from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2
from optdock.kernels import using_kernels
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.costmap import Costmap
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.path import ClothoidSegment, Direction, Path
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.plugins.interfaces import PluginContext, Smoother, SmoothingStatus, never_cancelled
from optdock.plugins.registry import create_plugin
from optdock.verification import certify_path
from smoothers.casadi_smoother import CasadiSmoother
from smoothers.scp.collision.linearization import covering_disc_rows
from smoothers.scp.qp_step import pool_of_this_thread
from smoothers.scp.search import Solver, is_clothoid_answer
from smoothers.scp.settings import DEFAULT_SETTINGS

LONG = 30.0  # [s]: no deadline
S_CURVE = ((0.0, 0.0), (1.2, 0.0), (2.0, 0.7), (3.2, 0.7))
GOAL = Pose2(3.2, 0.7, 0.0)


@pytest.fixture(scope="module")
def smoother():
    return CasadiSmoother()


@functools.cache
def solved(family, seed=0):
    """A problem of a family with the result of the smoother with default parameters."""
    case = instance(family, seed)
    return case, CasadiSmoother().smooth(case.raw_path, LONG, problem=case.problem)


@pytest.fixture(scope="module")
def s_curve(smoother, cases):
    """The S in the open, smoothed."""
    return smoother.smooth(cases.kinked(*S_CURVE), LONG, problem=cases.open_problem(GOAL))


@pytest.mark.parametrize("family", FEASIBLE_FAMILIES)
def test_a_feasible_problem_is_solved_and_an_independent_checker_agrees(family):
    case, result = solved(family)
    assert result.completed
    assert certify_path(result.path, case.problem).certified
    assert dense_check(result.path, case.problem).faults == ()
    assert all(isinstance(segment, ClothoidSegment) for segment in result.path.segments)
    wanted = [segment.direction for segment in case.raw_path.segments]
    assert [segment.direction for segment in result.path.segments] == wanted


@pytest.mark.parametrize("family", INFEASIBLE_FAMILIES)
def test_an_infeasible_problem_is_refused_for_its_reason(smoother, family):
    for seed in range(2):
        case = instance(family, seed)
        with pytest.raises(FailedToSmoothPath) as caught:
            smoother.smooth(case.raw_path, LONG, problem=case.problem)
        assert caught.value.where["reason"] == case.expected_reason
        assert caught.value.where["amount"] > 0.0
        assert 0.0 <= caught.value.where["s"] <= case.raw_path.length + 1.0


def test_the_goal_is_met_and_the_last_stretch_is_straight(s_curve):
    path = s_curve.path
    assert path.end.distance_to(GOAL) < 5e-8
    assert path.end.yaw == pytest.approx(0.0, abs=5e-8)
    assert path.curvature_at(np.linspace(path.length - 0.3 + 1e-9, path.length, 7)) == pytest.approx(0.0, abs=1e-12)


def test_gears_join_exactly(smoother):
    case = instance("parallel", 3)
    path = smoother.smooth(case.raw_path, LONG, problem=case.problem).path
    assert len(path.segments) == 3
    for before, after in itertools.pairwise(path.segments):
        assert before.poses_at(before.length)[0] == pytest.approx(after.poses_at(0.0)[0], abs=1e-12)


@pytest.mark.parametrize("bound", [("max_curvature", 0.3), ("max_curvature_rate", 1.5)])
def test_a_bound_is_broken_without_it_and_kept_with_it(smoother, cases, bound):
    name, limit = bound
    raw = cases.kinked((0.0, 0.0), (1.5, 0.0), (3.0, 1.2), (4.5, 1.2))
    goal = Pose2(4.5, 1.2, 0.0)
    measured = {
        "max_curvature": lambda path, p: certify_path(path, p).max_curvature,
        "max_curvature_rate": lambda path, p: certify_path(path, p).max_curvature_rate,
    }[name]
    free, held = (cases.open_problem(goal, **{name: value}) for value in (math.inf, limit))
    assert measured(smoother.smooth(raw, LONG, problem=free).path, free) > limit
    assert measured(smoother.smooth(raw, LONG, problem=held).path, held) <= limit * (1.0 + 1e-9)


def test_an_obstacle_is_hit_without_it_and_cleared_with_it(smoother, cases):
    raw, goal = cases.kinked((0.0, 0.0), (2.0, 0.1), (4.0, 0.0)), Pose2(4.0, 0.0, 0.0)
    rock = [[1.6, -0.6], [2.0, -0.6], [2.0, -0.15], [1.6, -0.15]]
    free, held = cases.open_problem(goal), cases.open_problem(goal, obstacles=[rock])
    assert not certify_path(smoother.smooth(raw, LONG, problem=free).path, held).certified
    assert certify_path(smoother.smooth(raw, LONG, problem=held).path, held).min_clearance >= 0.05 - 1e-6


@pytest.mark.parametrize("curvature", [-0.8, 0.0, 1.2])
def test_the_start_curvature_is_kept(smoother, cases, curvature):
    problem = cases.open_problem(GOAL, start_curvature=curvature)
    path = smoother.smooth(cases.kinked(*S_CURVE), LONG, problem=problem).path
    assert path.curvature_at(0.0)[0] == pytest.approx(curvature, abs=1e-12)


def test_without_limits_a_path_is_found(smoother, cases):
    problem = cases.open_problem(GOAL, max_curvature=math.inf, max_curvature_rate=math.inf)
    result = smoother.smooth(cases.kinked(*S_CURVE), LONG, problem=problem)
    assert certify_path(result.path, problem).certified


def test_a_final_straight_is_not_needed(smoother, cases):
    problem = cases.open_problem(GOAL)
    problem = dataclasses.replace(problem, dock=Dock(GOAL))
    result = smoother.smooth(cases.kinked(*S_CURVE), LONG, problem=problem)
    assert certify_path(result.path, problem).certified


def moved_problem(problem, motion):
    """The whole problem in another frame."""
    corners = [motion @ Pose2(*corner, 0.0) for piece in problem.obstacles.vertices for corner in piece]
    shape = problem.obstacles.vertices.shape
    vertices = np.array([[c.x, c.y] for c in corners]).reshape(shape)
    polygons = [list(dict.fromkeys(map(tuple, piece))) for piece in vertices]
    dock = dataclasses.replace(problem.dock, pose=motion @ problem.dock.pose)
    obstacles = ObstacleSet.from_polygons(polygons)
    return dataclasses.replace(problem, start=motion @ problem.start, dock=dock, obstacles=obstacles)


@pytest.mark.parametrize("family", ["alcove", "reverse_cusp"])
def test_moving_the_world_moves_the_path(smoother, family):
    case, motion = instance(family, 1), Pose2(1.0, -2.0, 2.1)
    moved = moved_problem(case.problem, motion)
    raw = Path.from_poses(
        np.concatenate([[(motion @ Pose2(*pose)).as_array() for pose in s.poses] for s in case.raw_path.segments])
    )
    here = smoother.smooth(case.raw_path, LONG, problem=case.problem)
    there = smoother.smooth(raw, LONG, problem=moved)
    assert there.report.cost == pytest.approx(here.report.cost, rel=1e-4)
    for share in np.linspace(0.0, 1.0, 9):
        expected = motion @ here.path.pose_at(share * here.path.length)
        assert expected.distance_to(there.path.pose_at(share * there.path.length)) < 5e-3


def test_a_mirrored_world_has_a_mirrored_path(smoother, cases):
    rock = np.array([[1.4, -0.9], [1.8, -0.9], [1.8, -0.4], [1.4, -0.4]])
    flip = np.array([1.0, -1.0])
    one = cases.open_problem(GOAL, obstacles=[rock])
    other = cases.open_problem(Pose2(GOAL.x, -GOAL.y, 0.0), obstacles=[rock * flip])
    first = smoother.smooth(cases.kinked(*S_CURVE), LONG, problem=one)
    second = smoother.smooth(cases.kinked(*np.array(S_CURVE) * flip), LONG, problem=other)
    assert second.report.cost == pytest.approx(first.report.cost, rel=1e-6)
    share = np.linspace(0.0, 1.0, 20)
    left, right = first.path.poses_at(share * first.path.length), second.path.poses_at(share * second.path.length)
    assert left * [1.0, -1.0, -1.0] == pytest.approx(right, abs=1e-5)


@pytest.mark.parametrize("family", ["u_dock", "alcove", "corridor"])
def test_a_certified_clothoid_is_exchanged_for_a_cheaper_path_only(smoother, family):
    """Of a path that keeps its distance from kinks for its curvature's sake, and of one that cannot be bettered."""
    case = instance(family, 2)
    straightened = CasadiSmoother(curvature_weight=20.0).smooth(case.raw_path, LONG, problem=case.problem).path
    solver = Solver(pool_of_this_thread(), Deadline(LONG), never_cancelled, smoother.settings)
    nlp, _ = solver.prepared(smoother.call_for(straightened, case.problem))
    better = smoother.smooth(straightened, LONG, problem=case.problem)
    assert better.report.status is SmoothingStatus.CONVERGED
    assert better.report.cost < nlp.cost.of_clothoids(straightened, case.problem.dock.final_straight)
    path, costs = better.path, []
    for _ in range(8):
        result = smoother.smooth(path, LONG, problem=case.problem)
        costs.append(result.report.cost)
        if result.report.status is SmoothingStatus.INPUT_KEPT:
            break
        path = result.path
    assert result.path is path
    assert costs == sorted(costs, reverse=True)


def test_a_requested_early_stop_counts_as_completed():
    """`completed` False means the time limit and nothing else."""
    case = instance("reverse_cusp", 0)
    for parameters in ({"stop_at_first": True}, {"max_iterations": 3}):
        result = CasadiSmoother(**parameters).smooth(case.raw_path, LONG, problem=case.problem)
        assert result.completed
        assert result.report.total_s < 0.5 * LONG


def test_an_earlier_result_in_another_frame_is_none(smoother):
    case, earlier = solved("open_s")
    elsewhere = Path(earlier.path.segments, "odom")
    result = smoother.smooth(case.raw_path, LONG, problem=case.problem, warm_start=elsewhere)
    assert result.path.frame == case.problem.frame
    assert certify_path(result.path, case.problem).certified


def test_a_straight_line_is_kept_as_it_is(smoother, cases):
    from optdock.geometry.clothoid import ClothoidSpline

    goal = Pose2(3.0, 0.0, 0.0)
    line = Path((ClothoidSegment(ClothoidSpline(Pose2(0.0, 0.0, 0.0), [0.0, 3.0], [0.0, 0.0])),), "map")
    result = smoother.smooth(line, LONG, problem=cases.open_problem(goal))
    assert result.path is line
    assert result.report.status is SmoothingStatus.INPUT_KEPT


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_from_the_staging_pose_only_the_straight_is_left(smoother, cases, sign):
    goal = Pose2(sign * 0.3, 0.0, 0.0)
    problem = cases.open_problem(goal)
    result = smoother.smooth(Path.from_poses([Pose2(0.0, 0.0, 0.0), goal]), LONG, problem=problem)
    assert certify_path(result.path, problem).certified
    assert result.path.length == pytest.approx(0.3)
    assert result.report.status is SmoothingStatus.STRAIGHT


def test_a_start_within_the_final_straight_is_refused(smoother, cases):
    goal = Pose2(0.25, 0.0, 0.0)
    with pytest.raises(FailedToSmoothPath) as caught:
        smoother.smooth(Path.from_poses([Pose2(0.0, 0.0, 0.0), goal]), LONG, problem=cases.open_problem(goal))
    assert caught.value.where["reason"] == "goal_unreachable"


def test_a_gear_of_one_centimetre_is_no_obstacle(smoother, cases):
    poses = [[x, 0.0, 0.0] for x in (0.0, 0.5, 1.0, 0.99, 1.5, 2.0, 2.5)]
    problem = cases.open_problem(Pose2(2.5, 0.0, 0.0))
    result = smoother.smooth(Path.from_poses(np.array(poses)), LONG, problem=problem)
    assert len(result.path.segments) == 3
    assert certify_path(result.path, problem).certified


@pytest.mark.parametrize("gap", [0.0, 0.02, 0.049])
def test_a_robot_that_starts_close_to_a_wall_drives_away_from_it(smoother, cases, gap):
    wall = [[-0.6, -1.0], [-0.45 - gap, -1.0], [-0.45 - gap, 1.0], [-0.6, 1.0]]
    problem = cases.open_problem(GOAL, obstacles=[wall])
    result = smoother.smooth(cases.kinked(*S_CURVE), LONG, problem=problem)
    assert certify_path(result.path, problem).certified


def test_a_wall_along_a_start_too_close_is_named(smoother, cases):
    wall = [[-2.0, -0.6], [1.0, -0.6], [1.0, -0.32], [-2.0, -0.32]]
    with pytest.raises(FailedToSmoothPath, match="obstacles\\[0\\]") as caught:
        smoother.smooth(cases.kinked(*S_CURVE), LONG, problem=cases.open_problem(GOAL, obstacles=[wall]))
    assert caught.value.where["reason"] == "clearance"
    assert caught.value.where["s"] < 1.5


@pytest.mark.parametrize("straight", [0.0, 0.3])
def test_a_dock_may_be_touched_at_the_goal(smoother, cases, straight):
    dock = Footprint(np.array([[0.45, -0.4], [0.6, -0.4], [0.6, 0.4], [0.45, 0.4]]))
    problem = dataclasses.replace(cases.open_problem(GOAL), dock=Dock(GOAL, dock, final_straight=straight))
    result = smoother.smooth(cases.kinked(*S_CURVE), LONG, problem=problem)
    assert certify_path(result.path, problem).certified
    assert result.report.iterations < 10


def test_duplicate_poses_change_nothing(smoother, cases, s_curve):
    poses = cases.kinked(*S_CURVE).segments[0].poses
    twice = Path.from_poses(np.repeat(poses, 3, axis=0))
    again = smoother.smooth(twice, LONG, problem=cases.open_problem(GOAL))
    assert again.report.cost == pytest.approx(s_curve.report.cost, rel=1e-9)


def test_a_rotation_in_place_becomes_a_drivable_turn(smoother, cases):
    turn = [[2.0, 0.0, yaw] for yaw in np.linspace(0.0, 1.2, 9)]
    ahead = [[2.0 + d * math.cos(1.2), d * math.sin(1.2), 1.2] for d in np.linspace(0.1, 2.5, 20)]
    raw = Path.from_poses(np.array([[x, 0.0, 0.0] for x in np.linspace(0.0, 1.9, 20)] + turn + ahead))
    problem = cases.open_problem(raw.end)
    result = smoother.smooth(raw, LONG, problem=problem)
    assert certify_path(result.path, problem).certified


def test_a_rotation_in_place_without_room_is_refused(smoother, cases):
    poses = [[0.0, 0.0, yaw] for yaw in np.linspace(0.0, 1.5, 9)] + [[0.0, y, 1.5707] for y in (0.2, 0.4)]
    raw = Path.from_poses(np.array(poses))
    walls = [[[-1.0, 1.2], [1.2, 1.2], [1.2, 1.3], [-1.0, 1.3]], [[0.8, -1.0], [0.9, -1.0], [0.9, 1.2], [0.8, 1.2]]]
    with pytest.raises(FailedToSmoothPath) as caught:
        smoother.smooth(raw, LONG, problem=cases.open_problem(raw.end, obstacles=walls))
    assert caught.value.where["reason"] in {"goal_unreachable", "clearance", "approach_blocked"}


def test_every_part_of_a_concave_robot_keeps_clear(smoother, cases):
    outline = Footprint(np.array([[0.5, 0.3], [0.1, 0.3], [0.1, 0.5], [-0.4, 0.5], [-0.4, -0.3], [0.5, -0.3]]))
    rock = [[1.5, 0.52], [2.2, 0.52], [2.2, 0.8], [1.5, 0.8]]
    goal = Pose2(4.0, 0.0, 0.0)
    problem = cases.open_problem(goal, obstacles=[rock], footprint=outline)
    raw = cases.kinked((0.0, 0.0), (2.0, 0.1), (4.0, 0.0))
    result = smoother.smooth(raw, LONG, problem=problem)
    assert dense_check(result.path, problem).faults == ()


def test_stop_at_first_returns_the_first_certified_path():
    case, best = solved("parallel")
    first = CasadiSmoother(stop_at_first=True).smooth(case.raw_path, LONG, problem=case.problem)
    assert first.report.iterations < best.report.iterations
    assert first.report.cost > best.report.cost


@pytest.mark.parametrize("family", ["u_dock", "reverse_cusp", "parallel"])
def test_a_warm_start_needs_fewer_iterations(smoother, family):
    case, before = solved(family)
    goal = case.problem.goal @ Pose2(0.005, 0.01, 0.01)
    moved = dataclasses.replace(case.problem, dock=dataclasses.replace(case.problem.dock, pose=goal))
    cold = smoother.smooth(case.raw_path, LONG, problem=moved)
    warm = smoother.smooth(case.raw_path, LONG, problem=moved, warm_start=before.path)
    assert certify_path(warm.path, moved).certified
    assert warm.report.iterations < cold.report.iterations
    assert warm.report.cost == pytest.approx(cold.report.cost, rel=0.01)


def test_a_warm_start_further_along_the_path(smoother):
    case, found = solved("reverse_cusp")
    before = found.path
    s = 0.4 * before.cusps[0]
    later = dataclasses.replace(case.problem, start=before.pose_at(s), start_curvature=float(before.curvature_at(s)[0]))
    raw = Path.from_poses(np.concatenate([segment.poses for segment in case.raw_path.segments])[8:])
    result = smoother.smooth(raw, LONG, problem=later, warm_start=before)
    assert certify_path(result.path, later).certified
    assert result.path.length == pytest.approx(before.length - s, abs=0.1)


def test_a_warm_start_through_a_new_obstacle_still_finds_the_way(smoother, cases):
    raw, goal = cases.kinked((0.0, 0.0), (2.0, 0.4), (4.5, 0.0)), Pose2(4.5, 0.0, 0.0)
    earlier = smoother.smooth(raw, LONG, problem=cases.open_problem(goal)).path
    rock = [[1.7, -0.5], [2.3, -0.5], [2.3, 0.0], [1.7, 0.0]]
    blocked = cases.open_problem(goal, obstacles=[rock])
    assert not certify_path(earlier, blocked).certified
    result = smoother.smooth(raw, LONG, problem=blocked, warm_start=earlier)
    assert certify_path(result.path, blocked).certified


def test_the_wrong_gear_for_the_dock_is_refused(smoother, cases):
    from optdock.model.dock import DockDirection

    problem = cases.open_problem(GOAL)
    problem = dataclasses.replace(problem, dock=dataclasses.replace(problem.dock, direction=DockDirection.BACKWARD))
    with pytest.raises(FailedToSmoothPath, match="direction") as caught:
        smoother.smooth(cases.kinked(*S_CURVE), LONG, problem=problem)
    assert caught.value.where["reason"] == "direction"


def test_a_moving_start_in_the_wrong_gear_is_refused(smoother, cases):
    problem = dataclasses.replace(cases.open_problem(GOAL), start_speed=-0.2)
    with pytest.raises(FailedToSmoothPath) as caught:
        smoother.smooth(cases.kinked(*S_CURVE), LONG, problem=problem)
    assert caught.value.where["reason"] == "direction"


def test_a_start_curvature_beyond_the_limit_is_refused(smoother, cases):
    problem = cases.open_problem(GOAL, start_curvature=2.0)
    with pytest.raises(FailedToSmoothPath) as caught:
        smoother.smooth(cases.kinked(*S_CURVE), LONG, problem=problem)
    assert caught.value.where == {
        "reason": "start_curvature",
        "every_path": True,
        "s": 0.0,
        "amount": pytest.approx(0.5),
        "obstacle": "",
    }


def test_a_start_curvature_beyond_the_limit_by_rounding_is_kept(smoother, cases):
    problem = cases.open_problem(GOAL, start_curvature=1.5 * (1.0 + 5e-7))
    path = smoother.smooth(cases.kinked(*S_CURVE), LONG, problem=problem).path
    assert certify_path(path, problem).certified


def test_an_occupied_goal_is_named(smoother, cases):
    rock = [[3.4, 0.5], [3.5, 0.5], [3.5, 0.9], [3.4, 0.9]]
    with pytest.raises(FailedToSmoothPath, match="obstacles\\[0\\]") as caught:
        smoother.smooth(cases.kinked(*S_CURVE), LONG, problem=cases.open_problem(GOAL, obstacles=[rock]))
    assert caught.value.where["reason"] == "approach_blocked"
    assert caught.value.where["amount"] == pytest.approx(0.15, abs=0.11)


def test_without_a_problem_it_smooths_between_the_ends_of_the_path(cases):
    plugin = create_plugin(Smoother, "ConstrainedSmoother", {"max_curvature": 1.8, "max_curvature_rate": 8.0})
    plugin.configure(PluginContext(name="smoother", footprint=Footprint.rectangle(0.3, 0.3, 0.4)))
    raw = cases.kinked(*S_CURVE)
    path = plugin.smooth(raw, LONG).path
    assert path.start.distance_to(raw.start) < 1e-9
    assert path.end.distance_to(raw.end) < 5e-8
    limits = MotionLimits(max_curvature=1.8, max_curvature_rate=8.0)
    problem = DockingProblem(raw.start, Dock(raw.end), Robot(Footprint.rectangle(0.3, 0.3, 0.4), limits))
    assert certify_path(path, problem).certified


def test_without_a_problem_the_costmap_s_cells_are_obstacles(cases):
    cells = np.zeros((80, 120), dtype=np.uint8)
    cells[10:26, 50:58] = 254
    costmap = Costmap(cells, 0.05, (-1.0, -2.0))
    footprint = Footprint.rectangle(0.3, 0.3, 0.4)
    plugin = CasadiSmoother(max_curvature=2.0)
    plugin.configure(PluginContext(name="smoother", footprint=footprint, costmap=costmap))
    raw = cases.kinked((0.0, 0.0), (1.7, -0.6), (3.4, 0.0))
    path = plugin.smooth(raw, LONG).path
    cell_block = [[1.5, -1.5], [1.9, -1.5], [1.9, -0.7], [1.5, -0.7]]
    limits = MotionLimits(max_curvature=2.0, max_curvature_rate=10.0)
    problem = DockingProblem(
        raw.start,
        Dock(raw.end),
        Robot(footprint, limits),
        ObstacleSet.from_polygons([cell_block]),
        ClearanceRule(0.0, 0.0, 0.0),
    )
    assert not certify_path(raw, problem).certified
    assert certify_path(path, problem).certified


def test_warm_up_leaves_nothing_to_build():
    plugin = CasadiSmoother()
    plugin.warm_up()
    case = instance("open_s", 0)
    assert plugin.smooth(case.raw_path, LONG, problem=case.problem).report.build_s == 0.0


def test_warm_up_pushes_out_of_an_obstacle_too(monkeypatch):
    pushed = []
    pushing = "smoothers.scp.collision.linearization.covering_disc_rows"
    monkeypatch.setattr(pushing, lambda *a: pushed.append(1) or covering_disc_rows(*a))
    with using_kernels("twin"):
        CasadiSmoother().warm_up()
    assert pushed


def test_a_reverse_drive_mirrors_a_forward_drive(smoother, cases, s_curve):
    """A robot symmetric about its origin drives the same curve tail first."""
    forward, goal = cases.kinked(*S_CURVE), GOAL
    poses = forward.segments[0].poses + np.array([0.0, 0.0, math.pi])
    backward = Path.from_poses(poses)
    assert backward.segments[0].direction is Direction.REVERSE
    one = cases.open_problem(goal)
    other = cases.open_problem(
        Pose2(goal.x, goal.y, math.pi), start=Pose2(0.0, 0.0, math.pi), footprint=one.robot.footprint
    )
    second = smoother.smooth(backward, LONG, problem=other)
    assert second.report.cost == pytest.approx(s_curve.report.cost, rel=1e-9)


def test_warming_up_survives_parameters_that_find_no_path(monkeypatch):
    failures, follow = [], Solver.follow_strategy

    def followed(self, call):
        try:
            return follow(self, call)
        except SmootherException as failure:
            failures.append(failure)
            raise

    monkeypatch.setattr(Solver, "follow_strategy", followed)
    CasadiSmoother(max_iterations=1).warm_up()
    assert failures


def test_warming_up_measures_the_pace_of_the_machine(monkeypatch):
    """The same work by a clock that runs a thousand times faster is a machine that is so much slower."""
    pool, pace = pool_of_this_thread(), DEFAULT_SETTINGS.anytime.pace_range
    monkeypatch.setattr(pool, "pace", 1.0)
    plugin = CasadiSmoother()
    plugin.configure(PluginContext(name="smoother", clock=lambda: 1e3 * time.monotonic()))
    plugin.warm_up()
    assert pool.pace == pace[1]
    plugin = CasadiSmoother()
    plugin.configure(PluginContext(name="smoother", clock=lambda: 1e-3 * time.monotonic()))
    plugin.warm_up()
    assert pool.pace == pace[0]


def test_a_cluttered_scene_is_searched_with_finer_nodes():
    task = instance("clutter", 44)
    assert len(task.problem.all_obstacles) > 60
    result = CasadiSmoother().smooth(task.raw_path, 30.0, problem=task.problem)
    assert certify_path(result.path, task.problem).certified


def test_a_side_that_rolls_around_a_corner_needs_fewer_steps_when_they_overshoot(monkeypatch):
    case, first = instance("long_approach", 24), CasadiSmoother(stop_at_first=True)
    taken = first.smooth(case.raw_path, LONG, problem=case.problem).report.iterations
    loop = dataclasses.replace(DEFAULT_SETTINGS.loop, overshot=0.0)
    monkeypatch.setattr(first, "settings", dataclasses.replace(DEFAULT_SETTINGS, loop=loop))
    assert taken < first.smooth(case.raw_path, LONG, problem=case.problem).report.iterations


def test_an_earlier_result_that_still_holds_is_better_than_none(smoother, monkeypatch):
    case, found = solved("alcove")
    earlier, gap = found.path, instance("gap_blocked", 0)
    monkeypatch.setattr(Solver, "_try", lambda self, _search: setattr(self.outcome, "converged", True))
    again = smoother.smooth(case.raw_path, LONG, problem=case.problem, warm_start=earlier)
    assert again.report.status is SmoothingStatus.WARM_START_KEPT
    assert again.path is earlier
    moved = dataclasses.replace(case.problem, start=gap.problem.start)
    assert not is_clothoid_answer(earlier, moved, DEFAULT_SETTINGS.anytime)
