"""A robot in motion stops within its first gear, however short that is in the guess."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optdock.geometry.footprint import Footprint
from optdock.model.constant_jerk import TimeLaw, braking_phases
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.path import Path
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.model.segments import PolylineSegment
from optdock.planners.manoeuvres.arcs import advance
from optdock.planning.pipeline import plan_dock
from smoothers.casadi_smoother import CasadiSmoother
from smoothers.scp.nlp import _braking_distance

LIMITS = MotionLimits(max_curvature=1.5, max_curvature_rate=6.0, max_deceleration=0.6, max_jerk=2.0)
ROBOT = Robot(Footprint.rectangle(0.45, 0.45, 0.6), LIMITS)


def asked(speed, *gears, acceleration=0.0):
    """Gears of so many metres each, and the problem that they solve."""
    segments, pose = [], np.zeros(3)
    for length, bend in gears:
        poses = advance(pose[None], np.linspace(0.0, length, 20), np.array([bend]))
        segments.append(PolylineSegment(poses, 1 if length > 0.0 else -1))
        pose = poses[-1]
    path = Path(tuple(segments))
    start = {"start_speed": speed, "start_acceleration": acceleration}
    return path, DockingProblem(path.start, Dock(path.end), ROBOT, **start)


@settings(max_examples=25)
@given(st.floats(0.01, 0.5), st.floats(-0.5, 0.3))
def test_the_braking_distance_is_that_of_full_braking(speed, acceleration):
    if acceleration < 0.0 and speed < 0.5 * acceleration**2 / LIMITS.max_jerk:
        return  # it would roll backwards
    _, problem = asked(speed, (1.0, 0.0), acceleration=acceleration)
    durations, jerks = np.array(braking_phases(speed, acceleration, LIMITS.max_deceleration, LIMITS.max_jerk)).T
    law = TimeLaw(durations, jerks, 0.0, speed, acceleration)
    assert _braking_distance(problem) == pytest.approx(law.at(law.duration)[0, 0], abs=1e-9)


def test_at_rest_nothing_is_needed():
    assert _braking_distance(asked(0.0, (1.0, 0.0))[1]) == 0.0


@settings(max_examples=6)
@given(st.sampled_from([1.0, -1.0]), st.floats(0.1, 0.45), st.floats(-0.5, 0.5))
def test_the_first_gear_of_a_smoothed_path_is_long_enough_to_stop_in(gear, speed, bend):
    raw, problem = asked(gear * speed, (0.03 * gear, 0.0), (-1.5 * gear, bend))
    path = CasadiSmoother().smooth(raw, 30.0, problem=problem).path
    assert path.segments[0].length >= _braking_distance(problem)


def test_a_plan_in_motion_with_a_first_gear_of_centimetres_can_be_timed():
    raw, problem = asked(0.4, (0.03, 0.0), (-1.5, 0.3))
    plan = plan_dock(problem, guesses=[raw], time_budget=30.0)
    assert plan.tried[0].price < np.inf
