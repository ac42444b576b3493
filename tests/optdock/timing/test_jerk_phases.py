from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optdock.model.constant_jerk import TimeLaw
from optdock.timing.jerk_phases import Motion, MotionState, braking_slack, state_after, stretched

PHASES = ((0.4, 1.0), (0.3, 0.0), (0.5, -0.8), (0.7, 0.2))


def test_agrees_with_the_time_law():
    law = TimeLaw([p[0] for p in PHASES], [p[1] for p in PHASES], 0.1, 0.2, 0.05)
    motion = Motion.of(MotionState(0.1, 0.2, 0.05), PHASES)
    t = np.linspace(0.0, law.duration, 77)
    np.testing.assert_allclose(motion.at(t), law.at(t)[:, :3].T, rtol=0, atol=1e-13)


def test_phases_of_no_duration_are_left_out():
    assert Motion.of(MotionState(), ((0.0, 5.0), *PHASES)).phases == PHASES


def test_state_after_is_the_border_state():
    state = MotionState(0.1, 0.2, 0.05)
    motion = Motion.of(state, PHASES)
    for n, phase in enumerate(PHASES):
        state = state_after(state, *phase)
        assert state == pytest.approx(tuple(motion.states[:, n + 1]), abs=1e-14)


def test_crossing_times_invert_the_distance():
    motion = Motion.of(MotionState(0.0, 0.3), PHASES)
    s = np.linspace(0.0, motion.end.s, 50)
    np.testing.assert_allclose(motion.at(motion.crossing_times(s))[0], s, atol=1e-9)


@settings(max_examples=25)
@given(factor=st.floats(1.0, 3.0))
def test_stretched_motion_scales_speed_and_acceleration(factor):
    motion, slow = Motion.of(MotionState(), PHASES), Motion.of(MotionState(), stretched(PHASES, factor))
    t = np.linspace(0.0, motion.duration, 40)
    s, v, a = motion.at(t)
    np.testing.assert_allclose(slow.at(t * factor), np.stack((s, v / factor, a / factor**2)), atol=1e-12)


def test_braking_slack():
    state = MotionState(0.0, 0.3, -0.5)
    assert braking_slack(state, 2.0) == pytest.approx(state_after(state, 0.25, 2.0).v)
    assert braking_slack(MotionState(0.0, 0.3, 0.5), 2.0) == 0.3
