from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optdock.errors import InvalidValue
from optdock.model.limits import MotionLimits, SpeedZone
from optdock.model.path import Path
from optdock.plugins.interfaces import TimingStatus
from optdock.timing.jerk_phases import DriveBounds
from optdock.timing.windowed import Window, Windowed, reachable_speed, s_curve_length

NO_ZONE = SpeedZone()


def test_straight_line_takes_the_closed_form_time(make):
    # Rest to rest over L with limits V, A = D, J all reached: T = L / V + V / A + A / J.
    limits = MotionLimits(max_speed=0.5, max_acceleration=0.4, max_deceleration=0.4, max_jerk=2.0)
    result = Windowed(max_window=10.0).parameterize(Path((make.spline([2.0, 2.0], [0, 0, 0]),)), limits, NO_ZONE)
    assert result.status is TimingStatus.OK
    speed = 0.5 * (1.0 - 1e-3)
    assert result.trajectory.duration == pytest.approx(4.0 / speed + speed / 0.4 + 0.4 / 2.0, rel=1e-9)


@pytest.mark.parametrize("seed", range(6))
def test_every_limit_holds_and_the_robot_rests_at_cusps(seed, make, dense, all_limits):
    rng, zone = np.random.default_rng(seed), SpeedZone(0.12, 0.4)
    path = make.random_path(rng, gears=1 + seed % 3)
    result = Windowed().parameterize(path, all_limits, zone)
    assert result.status is TimingStatus.OK
    assert max(dense.ratios(result.trajectory, all_limits, zone).values()) <= 1.0 + 1e-6
    assert dense.rests(result.trajectory)


def test_reverse_uses_its_own_speed_limit(make, dense, all_limits):
    path = Path((make.spline([4.0], [0.0, 0.0], sign=-1),))
    result = Windowed().parameterize(path, all_limits, NO_ZONE)
    assert np.max(result.trajectory.time_law.states[:, 1]) == pytest.approx(0.35, rel=2e-3)


def test_too_fast_for_the_bend_brakes_then_goes_on(make, dense, all_limits):
    path = Path((make.spline([0.2, 0.3, 1.0], [0.0, 2.5, 2.5, 0.0]),))
    result = Windowed().parameterize(path, all_limits, NO_ZONE, start_speed=0.6)
    assert result.status is TimingStatus.START_INFEASIBLE
    found = dense.ratios(result.trajectory, all_limits, NO_ZONE)
    assert result.worst_ratio > 1.05
    assert max(found["lateral"] ** 0.5, found["yaw rate"], found["wheel"]) > 1.05
    assert found["jerk"] <= 1.0 + 1e-9
    assert dense.rests(result.trajectory)


def test_nan_start_is_refused(make, all_limits):
    path = Path((make.spline([2.0], [0.0, 0.0]),))
    with pytest.raises(InvalidValue, match="start_speed"):
        Windowed().parameterize(path, all_limits, NO_ZONE, start_speed=math.nan)


@settings(max_examples=20)
@given(*(st.floats(-4.0, 3.0) for _ in range(3)), st.one_of(st.just(0.0), st.floats(1e-9, 10.0)), st.floats(0.0, 1.0))
def test_the_reachable_speed_uses_up_the_window(length, acceleration, jerk, slow, share):
    box = DriveBounds(1.0, 10.0**acceleration, 10.0**acceleration, 10.0**jerk)
    window = Window(0.0, 10.0**length, box)
    found = reachable_speed(window, slow, box.acceleration, math.inf)
    assert s_curve_length(slow, found, box.acceleration, box.jerk) <= 10.0**length
    faster = found + 1e-7 * (found - slow) + 8.0 * math.ulp(found)
    assert s_curve_length(slow, faster, box.acceleration, box.jerk) >= 10.0**length * (1.0 - 2e-9)
    wanted = slow + share * (found - slow)
    assert reachable_speed(window, slow, box.acceleration, wanted) == wanted
