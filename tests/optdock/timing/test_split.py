from __future__ import annotations

import numpy as np
import pytest

from optdock.limits import SpeedZone
from optdock.timing import split
from optdock.timing.attempt import Settings, attempt
from optdock.timing.bounds import Bounds, Tightening
from optdock.timing.check import worst_ratio
from optdock.timing.gears import courses_of
from optdock.timing.motion import Motion, State


def _bounds(make, all_limits, seed, **more):
    path = make.random_path(np.random.default_rng(seed), length=3.0)
    return Bounds(courses_of(path, all_limits, SpeedZone(0.15, 0.4))[0], **more)


@pytest.mark.parametrize("seed", range(5))
def test_moves_join_to_one_motion_over_the_gear(make, all_limits, seed):
    bounds = _bounds(make, all_limits, seed)
    found = attempt(bounds, State(), Settings())
    motion = Motion.of(State(), found.phases)
    assert tuple(motion.end) == pytest.approx((3.0, 0.0, 0.0), abs=1e-9)
    assert found.moves >= 2  # always split at the zone
    if not found.bad:
        assert worst_ratio(bounds.course, motion).path <= 1.0 + 1e-6


def test_tightening_a_stretch_slows_it_down(make, all_limits):
    free = Motion.of(State(), attempt(_bounds(make, all_limits, 4), State(), Settings()).phases)
    tight = _bounds(make, all_limits, 4, tightenings=(Tightening(1.0, 1.5, 0.8),))
    slow = Motion.of(State(), attempt(tight, State(), Settings()).phases)
    s = np.linspace(1.05, 1.45, 9)
    fast_v, slow_v = (motion.at(motion.crossing_times(s))[1] for motion in (free, slow))
    assert np.all(slow_v < fast_v)
    assert slow.duration > free.duration


def test_too_short_a_gear_leaves_no_room_for_a_reference(make, all_limits):
    course = courses_of(make.random_path(np.random.default_rng(0), length=3.0), all_limits, SpeedZone())[0]
    almost = course.after(course.length - 1e-5)
    found = attempt(Bounds(almost), State(), Settings())
    assert found is None or Motion.of(State(), found.phases).end.s == pytest.approx(1e-5)


def test_a_cell_without_a_move_is_driven_as_the_reference_drives_it(make, all_limits, monkeypatch):
    bounds = _bounds(make, all_limits, 2)
    monkeypatch.setattr(split, "move", lambda *_: None)
    found = attempt(bounds, State(), Settings())
    motion = Motion.of(State(), found.phases)
    assert tuple(motion.end) == pytest.approx((3.0, 0.0, 0.0), abs=1e-8)
    assert worst_ratio(bounds.course, motion).stretch <= 1.02
