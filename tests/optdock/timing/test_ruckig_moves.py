from __future__ import annotations

import ast
import importlib
import inspect
import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import ruckig
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from optdock.errors import PluginError
from optdock.model.limits import SpeedZone
from optdock.timing import ruckig_moves
from optdock.timing.jerk_phases import DriveBounds, Motion, MotionState
from optdock.timing.near_optimal import reference_motion
from optdock.timing.path_limits import ReferenceBounds, Tightening, limits_along
from optdock.timing.plan_checks import worst_ratio
from optdock.timing.ruckig_moves import move
from optdock.timing.start_states import full_stop

BOX = DriveBounds(0.5, 0.4, 0.6, 1.5)


def assert_reaches(start, target, phases):
    end = Motion.of(start, phases).end
    assert max(abs(a - b) for a, b in zip(end, target, strict=True)) < 1e-9


def test_no_move_to_a_target_that_requires_reversing():
    assert move(MotionState(0.0, 0.4), MotionState(0.01), BOX) is None


def test_no_move_from_a_moving_state_to_itself():
    assert move(MotionState(0.0, 0.3), MotionState(0.0, 0.3), BOX) is None


def test_reversing_within_a_phase_is_detected():
    # The speed is positive at both ends of the only phases but negative between them.
    assert not ruckig_moves._drives_forward(MotionState(0.0, 0.1, -0.6), ((1.0, 1.0),))
    assert ruckig_moves._drives_forward(MotionState(0.0, 0.2, -0.6), ((1.0, 1.0),))


def test_a_start_beyond_the_speed_bound_keeps_its_brake_phases():
    start, target = MotionState(0.0, 0.7), MotionState(2.0)
    phases = move(start, target, BOX)
    assert_reaches(start, target, phases)


def test_a_start_beyond_the_acceleration_bound_keeps_its_brake_phases():
    start, target = MotionState(0.0, 0.1, 0.9), MotionState(2.0)
    phases = move(start, target, BOX)
    assert_reaches(start, target, phases)


@pytest.mark.parametrize("target", [MotionState(1.0, 0.5, -0.2), MotionState(1.0, 0.5 + 1e-13, 0.0)])
def test_a_legal_target_at_the_speed_bound_is_not_refused(target):
    # ruckig itself refuses vf > V, and vf = V with af < 0, because it must have been faster before.
    phases = move(MotionState(), target, BOX)
    assert_reaches(MotionState(), target, phases)


def test_no_move_to_a_nan_state():
    assert move(MotionState(), MotionState(math.nan), BOX) is None


def test_no_move_above_the_longest_duration():
    assert move(MotionState(), MotionState(1.0), BOX, 10.0) is not None
    assert move(MotionState(), MotionState(1.0), BOX, 1.0) is None


def test_phases_survive_the_next_calculation():
    first = move(MotionState(), MotionState(1.0), BOX)
    kept = list(first)
    move(MotionState(), MotionState(2.0), BOX)
    assert list(first) == kept


def test_no_move_has_no_phases():
    assert move(MotionState(), MotionState(), BOX) == ()


def test_full_stop_from_above_the_speed_bound():
    phases = full_stop(MotionState(0.0, 0.9), BOX)
    end = Motion.of(MotionState(0.0, 0.9), phases).end
    # v^2 / (2 D) + v D / (2 J) for a stop that reaches D.
    assert end.s == pytest.approx(0.81 / 1.2 + 0.9 * 0.6 / 3.0, rel=1e-12)
    assert (end.v, end.a) == pytest.approx((0.0, 0.0), abs=1e-12)
    assert_reaches(MotionState(), MotionState(1.0), move(MotionState(), MotionState(1.0), BOX))


@settings(max_examples=20)
@given(*(st.floats(-2.0, 2.0) for _ in range(4)), st.floats(-3.0, 3.0))
def test_full_braking_agrees_with_ruckig(speed, deceleration, acceleration, jerk, start):
    box = DriveBounds(1.0, 10.0**acceleration, 10.0**deceleration, 10.0**jerk)
    state = MotionState(0.0, 10.0**speed, start)
    assume(start >= 0.0 or state.v > 1.001 * start * start / (2.0 * box.jerk))
    given, found = ruckig.InputParameter(1), ruckig.Trajectory(1)
    given.control_interface = ruckig.ControlInterface.Velocity
    given.current_position, given.current_velocity, given.current_acceleration = [0.0], [state.v], [state.a]
    given.target_velocity, given.target_acceleration, given.max_jerk = [0.0], [0.0], [box.jerk]
    given.max_velocity, given.max_acceleration, given.min_acceleration = [1e9], [box.acceleration], [-box.deceleration]
    ruckig.Ruckig(1).calculate(given, found)
    motion = Motion.of(state, full_stop(state, box))
    assert motion.duration == pytest.approx(found.duration, rel=1e-7)
    assert motion.end.s == pytest.approx(found.at_time(found.duration)[0][0], rel=1e-7)
    peak = state.v + start * start / box.jerk
    assert (motion.end.v, motion.end.a) == pytest.approx((0.0, 0.0), abs=1e-9 * max(1.0, peak, abs(start)))


def test_full_stop_first_reduces_the_acceleration():
    start = MotionState(0.0, 0.2, 0.8)
    motion = Motion.of(start, full_stop(start, BOX))
    assert motion.jerks[0] == pytest.approx(-1.5)
    assert (motion.end.v, motion.end.a) == pytest.approx((0.0, 0.0), abs=1e-12)


def test_threads_do_not_share_ruckig_objects():
    lengths = [0.1 * n for n in range(1, 60)]
    alone = [move(MotionState(), MotionState(length), BOX) for length in lengths]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda length: move(MotionState(), MotionState(length), BOX), lengths * 3))
    assert together == alone * 3


def test_intermediate_positions_are_never_set():
    # With one, the community edition calls a cloud service.
    names = [
        node.attr for node in ast.walk(ast.parse(inspect.getsource(ruckig_moves))) if isinstance(node, ast.Attribute)
    ]
    assert "intermediate_positions" not in names
    move(MotionState(), MotionState(1.0), BOX)
    assert list(ruckig_moves._tool().input.intermediate_positions) == []


def test_missing_ruckig_is_a_plugin_error(monkeypatch):
    def missing(name):
        raise ImportError(f"No module named {name!r}")

    monkeypatch.setattr(importlib, "import_module", missing)
    ruckig_moves._ruckig.cache_clear()
    with pytest.raises(PluginError, match="pip install ruckig"):
        ruckig_moves._ruckig()
    monkeypatch.undo()
    ruckig_moves._ruckig.cache_clear()


STATES = st.tuples(st.floats(0.0, 0.5), st.floats(-0.6, 0.4))


@settings(max_examples=25)
@given(first=STATES, last=STATES, length=st.floats(0.01, 3.0))
def test_moves_reach_their_target_within_the_bounds(first, last, length):
    start, target = MotionState(0.0, *first), MotionState(length, *last)
    phases = move(start, target, BOX)
    assume(phases is not None)
    motion = Motion.of(start, phases)
    assert max(abs(a - b) for a, b in zip(motion.end, target, strict=True)) < 1e-8
    assert abs(motion.jerks).max() <= BOX.jerk * (1.0 + 1e-9)
    assert motion.states[2].max() <= BOX.acceleration * (1.0 + 1e-9)
    assert motion.states[2].min() >= -BOX.deceleration * (1.0 + 1e-9)
    assert motion.at(np.linspace(0.0, motion.duration, 201))[1].min() > -1e-8


def _bounds(make, all_limits, seed, **more):
    path = make.random_path(np.random.default_rng(seed), length=3.0)
    return ReferenceBounds(limits_along(path, all_limits, SpeedZone(0.15, 0.4))[0], **more)


@pytest.mark.parametrize("seed", range(3))
def test_moves_join_to_one_motion_over_the_segment(make, all_limits, seed):
    bounds = _bounds(make, all_limits, seed)
    found = reference_motion(bounds, MotionState())
    motion = Motion.of(MotionState(), found.phases)
    assert tuple(motion.end) == pytest.approx((3.0, 0.0, 0.0), abs=1e-9)
    assert len(found.moves) >= 2  # always split at the zone
    assert found.sound
    assert worst_ratio(bounds.limits, motion).path <= 1.0


def test_tightening_a_stretch_slows_it_down(make, all_limits):
    free = Motion.of(MotionState(), reference_motion(_bounds(make, all_limits, 4), MotionState()).phases)
    tight = _bounds(make, all_limits, 4, tightenings=(Tightening(1.0, 1.5, 0.8),))
    slow = Motion.of(MotionState(), reference_motion(tight, MotionState()).phases)
    s = np.linspace(1.05, 1.45, 9)
    fast_v, slow_v = (motion.at(motion.crossing_times(s))[1] for motion in (free, slow))
    assert np.all(slow_v < fast_v)
    assert slow.duration > free.duration


def test_a_reference_needs_room_between_launch_and_stop(make, all_limits):
    along = limits_along(make.random_path(np.random.default_rng(0), length=3.0), all_limits, SpeedZone())[0]
    short = ReferenceBounds(along.after(along.length - 1e-3))
    assert tuple(Motion.of(MotionState(), reference_motion(short, MotionState()).phases).end) == pytest.approx(
        (1e-3, 0.0, 0.0)
    )
    assert reference_motion(short, MotionState(0.0, 0.0, 0.4)) is None  # leading this acceleration back takes more


def test_a_cell_without_a_move_gets_the_motion_of_the_reference(make, all_limits, monkeypatch):
    bounds = _bounds(make, all_limits, 2)
    monkeypatch.setattr(ruckig_moves, "move", lambda *_: None)
    found = reference_motion(bounds, MotionState())
    motion = Motion.of(MotionState(), found.phases)
    assert tuple(motion.end) == pytest.approx((3.0, 0.0, 0.0), abs=1e-8)
    assert worst_ratio(bounds.limits, motion).stretch <= 1.02
