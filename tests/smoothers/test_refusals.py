"""What a refusal says can be measured again: its pose, its amount, its obstacle, on the path that it carries."""

import dataclasses
import functools

import numpy as np
import pytest

from experiments.families import instance
from optdock.errors import FailedToSmoothPath, InvalidPath, InvalidValue, SmootherTimedOut
from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.path import ClothoidSegment, Path
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.planning import refinement
from optdock.planning.pipeline import plan_dock
from optdock.planning.plan import PartialPlan
from optdock.verification import certify_path, end_clearances, pose_clearance
from smoothers.casadi_smoother import CasadiSmoother
from smoothers.nav2.savitzky_golay import SavitzkyGolaySmoother
from smoothers.nav2.simple import SimpleSmoother
from smoothers.scp import refusals
from smoothers.scp.refusals import _too_close

EXACT = 1e-9


@functools.cache
def refusal_of(family, seed):
    case = instance(family, seed)
    with pytest.raises(FailedToSmoothPath) as caught:
        CasadiSmoother().smooth(case.raw_path, 30.0, problem=case.problem)
    return case.problem, caught.value


def measured(pose, problem):
    """Required and measured clearance of a pose, and the obstacle nearest to it."""
    apart = [np.array([pose.distance_to(end)]) for end in (problem.goal, problem.start)]
    required = problem.clearance.required_at(*apart, end_clearances(problem).start)[0]
    clearance, row = pose_clearance(pose, problem.robot.footprint, problem.all_obstacles)
    return required, clearance, problem.all_obstacles.name_of(row)


@pytest.mark.parametrize("seed", range(3))
def test_a_clearance_refusal_names_the_worst_measured_pose(seed):
    problem, error = refusal_of("gap_blocked", seed)
    where, path = error.where, error.partial.path
    assert where["reason"] == "clearance"
    pose = Pose2.from_sequence(where["pose"])
    required, clearance, obstacle = measured(pose, problem)
    assert where["amount"] == pytest.approx(required - clearance, abs=EXACT)
    assert (where["required"], where["clearance"]) == pytest.approx((required, clearance), abs=EXACT)
    assert where["obstacle"] == obstacle
    assert path.pose_at(where["s"]).gap_to(pose) < EXACT
    assert where["amount"] > 0.0
    assert f"{where['amount']:.4f} m closer to {obstacle}" in str(error)
    for s in np.linspace(0.0, path.length, 200):
        required, clearance, _ = measured(path.pose_at(s), problem)
        assert required - clearance <= where["amount"] + 5e-3


@pytest.mark.parametrize("seed", range(2))
def test_a_path_that_misses_the_goal_ends_at_the_pose_of_the_refusal(seed):
    problem, error = refusal_of("too_close", seed)
    path, where = error.partial.path, error.where
    end = Pose2.from_sequence(where["pose"])
    assert path.end.gap_to(end) < EXACT
    back = int(path.segments[-1].direction) * problem.dock.final_straight
    assert end.distance_to(problem.goal @ Pose2(-back, 0.0, 0.0)) == pytest.approx(where["amount"], abs=1e-4)


def test_a_refusal_with_only_legal_poses_names_the_bound():
    case = instance("corridor", 0)
    path = CasadiSmoother().smooth(case.raw_path, 30.0, problem=case.problem).path
    error = _too_close(path, case.problem, 0.0123).error()
    assert certify_path(path, case.problem).certified
    assert error.where["amount"] <= 1e-6
    assert error.where["bound"] == 0.0123
    assert "keeps the required clearance" in str(error)
    assert "0.0123 m short" in str(error)
    assert "refused near this guess" in str(error)


def test_a_corner_that_swings_past_a_post_between_two_measured_poses_is_found():
    # The front outer corner is farthest from the centre of the arc. It comes 9.5 mm near a needle halfway between the
    # first measured poses, where 1 cm is required, and is 16 mm away from it at both of them.
    radius, half, front, required, short = 0.5, 0.25, 0.4, 0.01, 5e-4
    length = 30 * refusals._SPACING
    spline = ClothoidSpline(Pose2(0.0, 0.0, 0.0), np.array([0.0, length]), np.full(2, 1.0 / radius))
    path = Path((ClothoidSegment(spline),))
    at = path.pose_at(15.5 * length / 30)
    centre, corner = np.array([0.0, radius]), np.array((at @ Pose2(front, -half, 0.0)).as_array()[:2])
    away = (corner - centre) / np.linalg.norm(corner - centre)
    tip, across = corner + (required - short) * away, np.array([-away[1], away[0]])
    needle = [tip, tip + 0.2 * away + 0.001 * across, tip + 0.2 * away - 0.001 * across]
    robot = Robot(Footprint.rectangle(front, front, 2.0 * half), MotionLimits(max_curvature=3.0))
    rule = ClearanceRule(required=required, at_dock=required)
    problem = DockingProblem(path.start, Dock(path.end), robot, [needle], clearance=rule)
    error = _too_close(path, problem, 0.0123).error()
    assert error.where["amount"] == pytest.approx(short, rel=0.05)
    assert "closer to obstacles[0] than required" in str(error)


def test_a_failed_call_leaves_the_best_path_of_the_search_uncertified():
    problem, error = refusal_of("gap_blocked", 0)
    left = PartialPlan.left_by(error)
    assert left.path.frame == problem.frame
    assert left.path.end.gap_to(problem.goal) < 1e-6
    assert left.certificate is None
    assert not certify_path(left.path, problem).certified


def test_a_refusal_before_any_search_has_no_path():
    _, error = refusal_of("approach_blocked", 0)
    assert error.partial is None


def test_a_time_out_names_the_option_that_gives_more():
    class Late(CasadiSmoother):
        def smooth(self, path, max_time, **rest):
            raise SmootherTimedOut(f"nothing within {max_time:.1f} s", where={"iterations": 3})

    with pytest.raises(
        SmootherTimedOut,
        match=r"^Late ran out of time; raise time_budget, which is 50 s$",
    ) as caught:
        plan_dock(instance("open_s", 0).problem, time_budget=50.0, planner="DockPlanner", smoother=Late())
    assert caught.value.where == {"iterations": 3}


def test_a_budget_without_time_for_smoothing_is_a_time_out(monkeypatch):
    monkeypatch.setattr(refinement.Refinement, "reserved", lambda work, gears, length: 60.0)
    with pytest.raises(SmootherTimedOut, match="^smoothing ran out of time; raise time_budget, which is 30 s$"):
        plan_dock(instance("open_s", 0).problem, time_budget=30.0, planner="DockPlanner")


SMOOTHERS = (CasadiSmoother, SimpleSmoother, SavitzkyGolaySmoother)


@pytest.mark.parametrize("kind", SMOOTHERS)
@pytest.mark.parametrize("poses", [[(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)], np.zeros((3, 3)), None])
def test_poses_instead_of_a_path_are_refused_with_a_hint(kind, poses):
    with pytest.raises(InvalidPath, match=r"path: must be a Path.*Path.from_poses\(poses\) returns a Path"):
        kind().smooth(poses, 1.0, problem=instance("open_s", 0).problem)


@pytest.mark.parametrize("kind", SMOOTHERS)
@pytest.mark.parametrize("name", ["problem", "warm_start"])
def test_arguments_of_another_class_are_refused_by_name(kind, name):
    case = instance("open_s", 0)
    with pytest.raises(InvalidValue, match=f"{name}: must be a "):
        kind().smooth(case.raw_path, 1.0, **{"problem": case.problem, name: "office"})


def moved(path, by):
    return Path.from_poses([by @ Pose2.from_sequence(row) for row in path.sample(0.05).poses])


def test_a_path_of_another_place_is_refused():
    case = instance("open_s", 0)
    with pytest.raises(InvalidPath, match="m from the goal of the problem, allowed are 1.00 m"):
        CasadiSmoother().smooth(Path.from_poses([(20.0, 2.0, 0.0), (22.0, 2.0, 0.0)]), 5.0, problem=case.problem)
    beside = dataclasses.replace(case.problem, start=case.problem.start @ Pose2(-9.0, 0.0, 0.0))
    with pytest.raises(InvalidPath, match="m from the start of the problem"):
        CasadiSmoother().smooth(case.raw_path, 5.0, problem=beside)


def test_an_input_that_is_off_by_decimetres_shows_the_way_to_the_ends_of_the_problem():
    case = instance("open_s", 0)
    off = moved(case.raw_path, Pose2(0.2, -0.2, 0.0))
    found = CasadiSmoother().smooth(off, 30.0, problem=case.problem).path
    assert found.start.gap_to(case.problem.start) < 1e-6
    assert found.end.gap_to(case.problem.goal) < 1e-6


def test_an_input_may_begin_far_behind_the_robot():
    case = instance("open_s", 0)
    plan = plan_dock(case.problem, time_budget=30.0)
    longer = [plan.path.start @ Pose2(x, 0.0, 0.0) for x in np.linspace(-4.0, -0.1, 40)]
    longer += [Pose2.from_sequence(row) for row in plan.path.sample(0.1).poses]
    found = CasadiSmoother().smooth(Path.from_poses(longer), 30.0, problem=case.problem).path
    assert found.start.gap_to(case.problem.start) < 1e-6


def test_results_print_in_a_line():
    case = instance("open_s", 0)
    result = CasadiSmoother().smooth(case.raw_path, 30.0, problem=case.problem)
    plan = plan_dock(case.problem, time_budget=30.0)
    for each in (result, result.report, plan.timing_report):
        assert len(str(each)) < 160
        assert "\n" not in str(each)
    assert f"{result.path.length:.3f} m" in str(result)
