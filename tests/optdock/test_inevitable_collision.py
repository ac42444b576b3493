"""Laws of inevitable collisions: no motion within the limits avoids them, and nothing is claimed about other starts."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.path import Path
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.model.segments import ClothoidSegment
from optdock.planning.inevitable_collision import inevitable_collision
from optdock.planning.replanning import DriveState, ReplanOutcome, replan
from optdock.verification import certify_path
from tests.optdock.test_replanning import BUDGET, LEAD, box_at, running

LIMITS = MotionLimits(max_curvature=1.5, max_curvature_rate=6.0)


def problem_with(box, speed, bend, acceleration=0.0, limits=LIMITS):
    """Return a problem with a box whose start, at the origin, is in motion."""
    robot = Robot(Footprint.rectangle(0.45, 0.45, 0.6), limits)
    goal = Dock(Pose2(4.0, 1.0, 0.0))
    known = DockingProblem(Pose2(0.0, 0.0, 0.3), goal, robot, [box])
    return known.starting_at(known.start, speed, bend, acceleration)


def driven(problem, rng, length):
    """Return a path of random curvature within the limits, in the gear of the start."""
    limits, knots = problem.robot.limits, np.linspace(0.0, length, 6)
    bends, change = [problem.start_curvature], limits.max_curvature_rate * knots[1]
    sharpest = rng.integers(-1, 3)
    for _ in knots[1:]:
        step = change * (sharpest if abs(sharpest) == 1 else rng.uniform(-1.0, 1.0))
        bends.append(float(np.clip(bends[-1] + step, -limits.max_curvature, limits.max_curvature)))
    sign = int(math.copysign(1.0, problem.start_speed))
    return Path((ClothoidSegment(ClothoidSpline(problem.start, knots, np.array(bends), sign)),))


def stopping_distance(problem):
    """Return the distance of full braking from the start, integrated in small steps [m]."""
    limits, step = problem.robot.limits, 1e-4
    v, a = problem.start_state(int(math.copysign(1.0, problem.start_speed)))
    s = 0.0
    while v > 0.0:
        release = a * a / (2.0 * limits.max_jerk)  # the speed that is lost while the deceleration is reduced to 0
        slower, change = a < 0.0 and v <= release, limits.max_jerk * step
        a = min(a + change, 0.0) if slower else max(a - change, -limits.max_deceleration)
        s, v = s + v * step, v + a * step
        if slower and a == 0.0:
            break
    return s + 1e-3


@settings(max_examples=150)
@given(
    at=st.tuples(st.floats(-1.2, 1.2), st.floats(-1.2, 1.2)),
    speed=st.sampled_from([0.5, 0.3, 0.1, -0.3, -0.05]),
    bend=st.floats(-1.4, 1.4),
    acceleration=st.floats(-0.5, 0.5),
    seed=st.integers(0, 2**32 - 1),
)
def test_no_random_motion_avoids_an_inevitable_collision(at, speed, bend, acceleration, seed):
    problem = problem_with(box_at(*at), speed, bend, acceleration)
    if not inevitable_collision(problem):
        return
    rng = np.random.default_rng(seed)
    for _ in range(10):
        path = driven(problem, rng, stopping_distance(problem))
        found = certify_path(path, problem)
        assert any(violation.kind == "clearance" for violation in found.violations)


def test_wall_before_a_fast_robot_is_inevitable_and_before_a_slow_one_is_not():
    wall = np.array([[0.6, -3.0], [0.7, -3.0], [0.7, 3.0], [0.6, 3.0]])
    assert "too close to" in inevitable_collision(problem_with(wall, 0.5, 0.0))
    assert inevitable_collision(problem_with(wall, 0.05, 0.0)) == ""
    assert inevitable_collision(problem_with(wall, -0.3, 0.0)) == ""  # drives away from it
    assert inevitable_collision(problem_with(wall, 0.0, None)) == ""
    unlimited = MotionLimits(max_curvature=1.5)
    assert inevitable_collision(problem_with(wall, 0.5, 0.0, limits=unlimited)) == ""


def test_replan_stops_at_once_where_the_robot_cannot_stop_in_time():
    plan = running()
    time = 0.35 * plan.trajectory.duration
    at = plan.path.pose_at(float(plan.trajectory.sample_at(time + LEAD).s[0]))
    ahead = at @ Pose2(0.45 + 0.1 + 0.12, 0.0, 0.0)
    new = box_at(ahead.x, ahead.y)
    obstacles = plan.problem.obstacles + ObstacleSet.from_polygons([new], "new")
    problem = dataclasses.replace(plan.problem, obstacles=obstacles)
    found = replan(plan, problem, DriveState(time), BUDGET, lead=LEAD)
    assert found.outcome is ReplanOutcome.STOP
    assert "m to stop" in found.reason
    assert found.tried == ()


def test_nothing_is_claimed_about_a_robot_that_brakes_harder_than_the_jerk_limit_can_end():
    slow = dataclasses.replace(LIMITS, max_jerk=0.13)
    assert inevitable_collision(problem_with(box_at(0.8, 0.2), 0.1, 0.5, -0.4, slow)) == ""
