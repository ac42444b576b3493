"""What the cost counts for robots of different size and steering."""

import math

import numpy as np
import pytest

from optdock import ClearanceRule, Dock, DockingProblem, Footprint, MotionLimits, Path, Pose2, Robot
from optdock.model.robot import Drive
from optdock.model.segments import Direction, PolylineSegment
from smoothers.scp.collision.collision_scene import scene_around
from smoothers.scp.cost import Weights
from smoothers.scp.nlp import Formulation, formulate
from smoothers.scp.qp_step import ProgramPool
from smoothers.scp.settings import DEFAULT_SETTINGS


def formulated(limits, *lengths):
    """The program of driving straight on by signed lengths."""
    x, segments = 0.0, []
    for length in lengths:
        poses = np.array([(x, 0.0, 0.0), (x + length, 0.0, 0.0)])
        segments.append(PolylineSegment(poses, Direction(int(math.copysign(1, length)))))
        x += length
    drive = Drive.ACKERMANN if limits.wheelbase > 0.0 else Drive.DIFFERENTIAL
    robot = Robot(Footprint.rectangle(0.4, 0.4, 0.6), limits, drive)
    problem = DockingProblem(Pose2(0.0, 0.0, 0.0), Dock(Pose2(x, 0.0, 0.0)), robot, [], ClearanceRule())
    path = Path(tuple(segments))
    scene = scene_around(problem, np.array([(0.0, 0.0), (x, 0.0)]), 1.0, DEFAULT_SETTINGS.collision)
    return formulate(path, problem, scene, Formulation(Weights(), 24, 0.1), None, DEFAULT_SETTINGS)


def steered(**others):
    return MotionLimits(max_curvature=0.3, wheelbase=2.5, max_steering_rate=0.5, **others)


def test_wheels_may_turn_faster_where_the_robot_sets_off_and_stops():
    nlp = formulated(steered(max_speed=2.0, max_acceleration=1.0, max_deceleration=1.0), 20.0, -0.5)
    easing, gear = nlp.cost.easing, nlp.basis.span_gear
    first, second = easing[gear == 0], easing[gear == 1]
    assert first == pytest.approx(first[::-1])
    assert first.max() == 1.0  # full speed on the way
    assert first[0] < 0.3
    assert second.max() < 0.2  # never fast on half a metre


def test_robots_without_steered_wheels_count_curvature_rates_alike_everywhere():
    assert formulated(MotionLimits(max_curvature=1.5), 3.0).cost.easing is None


@pytest.mark.parametrize(("curvature", "share"), [(3.0, 1.0), (1.5, 1.0), (0.3, 0.04)])
def test_the_wider_a_robot_turns_the_farther_it_may_leave_its_input(curvature, share):
    cost = formulated(MotionLimits(max_curvature=curvature), 3.0).cost
    assert cost.weights.tracking == pytest.approx(share * Weights().tracking)


def test_the_pool_builds_each_program_once_and_measures_the_time():
    pool = ProgramPool()
    assert pool.program(4, 3) is pool.program(4, 3)
    assert pool.program(4, 2) is not pool.program(4, 3)
    assert pool.build_time > 0.0


def test_the_pool_keeps_the_latest_programs():
    pool = ProgramPool()
    first, second = pool.program(2, 1), pool.program(2, 2)
    for rows in range(3, 60):
        pool.program(2, rows)
        assert pool.program(2, 1) is first  # used in between
    assert pool.program(2, 2) is not second
