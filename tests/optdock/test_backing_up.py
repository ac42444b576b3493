"""Laws of backing up: guesses are pieces of the running path, and their plans are short, proven and continuous."""

from __future__ import annotations

import dataclasses
import itertools
import math

import numpy as np
import pytest

from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.pose import Pose2
from optdock.model.limits import MotionLimits
from optdock.model.path import ClothoidSegment, Path
from optdock.model.robot import Drive
from optdock.planning.backing_up import backed_up, transition_length
from optdock.planning.deformation import deformed
from optdock.planning.replanning import DriveState, ReplanOutcome, replan
from optdock.planning.running_drive import BranchPoint, RunningDrive
from tests.optdock.test_replanning import BUDGET, LEAD, assert_continuous, assert_lawful, moved, running

ORIGIN = Pose2(0.0, 0.0, 0.0)


def late(plan, before_the_end):
    """Return the state of a robot at a distance from the end of its path [m]."""
    law = plan.trajectory.time_law
    return DriveState(float(np.interp(plan.path.length - before_the_end, law.states[:, 0], law.times)))


def guess_of(plan, goal, before_the_end):
    """Return the joint, the braking distance, the problem from the joint, and the guess."""
    world = dataclasses.replace(plan.problem, dock=dataclasses.replace(plan.problem.dock, pose=goal))
    drive = RunningDrive(plan, world, late(plan, before_the_end))
    joint = drive.branch_point(0.0)
    problem, least = drive.problem_at(joint), joint.braking_distance(world.robot.limits)
    return joint, least, problem, backed_up(joint, problem, least)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("before_the_end", [0.1, 0.25, 0.5])
def test_guess_lies_on_the_running_path_and_leaves_room_for_braking(sign, before_the_end):
    plan = running(sign)
    joint, least, _, guess = guess_of(plan, moved(plan, 0.0, 0.03, 0.0), before_the_end)
    assert [int(segment.direction) for segment in guess.segments] == [sign, -sign, sign]
    assert guess.start.gap_to(joint.pose) <= 1e-9
    assert guess.end.gap_to(plan.path.end) <= 1e-9
    assert guess.segments[0].length >= least
    along = plan.path.poses_at(np.linspace(0.0, plan.path.length, 20_000))[:, :2]
    for pose in guess.poses_at(np.linspace(0.0, guess.length, 60)):
        assert np.hypot(*(along - pose[:2]).T).min() <= 1e-3
    ends = [segment.poses_at([0.0, segment.length]) for segment in guess.segments]
    for before, after in itertools.pairwise(ends):
        np.testing.assert_allclose(before[1], after[0], atol=1e-9)


def test_robot_that_cannot_stop_before_the_end_backs_up_from_there():
    """In half of the paths the arc length of the end minus that of the last gear is larger than its length."""
    rng, found = np.random.default_rng(3), 0
    for _ in range(60):
        first, last = rng.uniform(0.3, 1.5), rng.uniform(0.82, 0.98)
        back = ClothoidSpline(ORIGIN, np.array([0.0, first]), np.zeros(2), -1)
        ahead = ClothoidSpline(back.end, np.array([0.0, last]), np.zeros(2))
        path = Path((ClothoidSegment(back), ClothoidSegment(ahead)), "map")
        joint = BranchPoint(path, 0.0, first + 0.6 * last, 0.3, 0.0, 1)
        problem = running().problem
        dock = dataclasses.replace(problem.dock, pose=path.end @ Pose2(0.0, 0.02, 0.0))
        problem = dataclasses.replace(problem, dock=dock).starting_at(joint.pose, 0.3, 0.0)
        guess = backed_up(joint, problem, least=10.0)
        if guess is None:
            continue
        found += path.length - path.segment_starts[1] > last
        assert guess.segments[0].length == pytest.approx(0.4 * last)
        assert guess.segments[1].spline.start.gap_to(path.end) <= 1e-9
    assert found > 5


def test_robot_far_from_the_dock_does_not_back_up():
    plan = running()
    assert guess_of(plan, moved(plan, 0.0, 0.03, 0.0), 2.0)[-1] is None


@pytest.mark.parametrize("rate", [6.0, math.inf])
def test_transition_is_as_long_as_the_curve_of_the_same_offset(rate):
    limits = MotionLimits(max_curvature=1.5, max_curvature_rate=rate)
    length = transition_length(ORIGIN, Pose2(1.0, 0.02, 0.0), limits)
    if math.isfinite(rate):  # the rate alternates: + - - +
        knots, peak = np.array([0.0, 0.25, 0.75, 1.0]) * length, 0.25 * length * rate
        curvature = np.array([0.0, peak, -peak, 0.0])
    else:
        knots = np.array([0.0, 0.5, 0.5 + 1e-6, 1.0]) * length
        curvature = np.array([1.5, 1.5, -1.5, -1.5])
    end = ClothoidSpline(ORIGIN, knots, curvature).end
    assert end.yaw == pytest.approx(0.0, abs=1e-5)
    assert end.y == pytest.approx(0.02, rel=0.02)


def test_transition_is_longer_for_a_turn_and_symmetric():
    limits = MotionLimits(max_curvature=1.5, max_curvature_rate=6.0)
    there = Pose2(0.0, 0.02, 0.1)
    length = transition_length(ORIGIN, there, limits)
    assert length > transition_length(ORIGIN, Pose2(0.0, 0.02, 0.0), limits)
    assert length == pytest.approx(transition_length(ORIGIN, Pose2(0.0, -0.02, -0.1), limits))


@pytest.mark.parametrize("before_the_end", [0.1, 0.25])
def test_shortened_path_cannot_be_shortened_further(before_the_end):
    plan = running()
    goal = moved(plan, 0.0, 0.03, 0.0)
    joint, least, problem, guess = guess_of(plan, goal, before_the_end)
    limits, bounds = problem.robot.limits, {"final_straight": 0.3, "speed": abs(joint.speed), "least": least}
    free, short = (
        deformed(guess, problem.start, goal, limits, shortens=shortens, **bounds) for shortens in (False, True)
    )
    again = deformed(short, problem.start, goal, limits, shortens=True, **bounds)
    assert short.end.gap_to(goal) <= 1e-6
    assert short.length < free.length - 0.1
    assert again.length == pytest.approx(short.length, rel=0.02)
    assert short.segments[0].length >= least - 1e-9
    for segment in short.segments:
        assert np.abs(segment.spline.curvature).max() <= limits.max_curvature
        assert np.abs(segment.spline.curvature_rates).max() <= limits.max_curvature_rate


@pytest.mark.parametrize("drive", list(Drive))
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("before_the_end", [0.05, 0.2, 0.5])
def test_robot_too_close_to_a_moved_dock_backs_up(sign, drive, before_the_end):
    plan = running(sign, drive)
    goal = moved(plan, 0.01 * sign, 0.03, 0.02)
    found = replan(plan, goal, late(plan, before_the_end), BUDGET, lead=LEAD)
    assert found.outcome is ReplanOutcome.NEW
    assert found.tried[-1].stage == "backed up"
    assert found.plan.path.end.gap_to(goal) <= 1e-6
    assert [int(segment.direction) for segment in found.plan.path.segments] == [sign, -sign, sign]
    assert found.proven
    assert_continuous(plan, found)
    assert_lawful(found)
