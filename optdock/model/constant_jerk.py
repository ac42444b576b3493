"""Motion under piecewise constant jerk: states, braking, and the time law of a trajectory.

This is the only implementation of this motion in the library: `constant_jerk` evaluates it within a phase, and
`border_states` over many phases. The reference implementations in `experiments` are deliberately independent.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from optdock.errors import InvalidValue
from optdock.geometry.arrays import FloatArray, FrozenArrays, IntArray, frozen_array, readonly
from optdock.geometry.checked import finite_number
from optdock.geometry.lazy import cached_property

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


__all__ = ["TimeLaw", "border_states", "braking_phases", "braking_time", "constant_jerk"]

Number = TypeVar("Number", float, FloatArray)


def constant_jerk(t: Number, s: Number, v: Number, a: Number, jerk: Number) -> tuple[Number, Number, Number]:
    """Return distance, speed and acceleration after a time `t` of constant jerk, for numbers or arrays of one shape.

    The distance is s + v t + a t^2 / 2 + j t^3 / 6; speed and acceleration are its derivatives.

    Args:
        t: Time since the initial state [s].
        s: Initial distance [m].
        v: Speed [m/s].
        a: Acceleration [m/s^2].
        jerk: Jerk [m/s^3].
    """
    gain = t * jerk
    return s + t * (v + t * (0.5 * a + gain / 6.0)), v + t * (a + 0.5 * gain), a + gain


def border_states(durations: FloatArray, jerks: FloatArray, start: tuple[float, float, float]) -> FloatArray:
    """Return distance, speed and acceleration at the borders of phases of constant jerk.

    Args:
        durations: Shape (n,) [s].
        jerks: Shape (n,) [m/s^3].
        start: Distance, speed and acceleration at the first border.

    Returns:
        Shape (3, n + 1).
    """
    states = np.empty((3, durations.size + 1))
    s, v, a = states
    gain = durations * jerks
    s[0], v[0], a[0] = 0.0, 0.0, 0.0
    gain.cumsum(out=a[1:])
    a += start[2]
    (durations * (a[:-1] + 0.5 * gain)).cumsum(out=v[1:])
    v += start[1]
    (durations * (v[:-1] + durations * (0.5 * a[:-1] + gain / 6.0))).cumsum(out=s[1:])
    s += start[0]
    return states


def braking_phases(v: float, a: float, deceleration: float, jerk: float) -> tuple[tuple[float, float], ...]:
    """Return the phases (duration [s], jerk [m/s^3]) of full braking to rest: -J to -D, hold, and +J to rest.

    The state must allow a stop without reversing: v >= 0, and v >= a^2 / (2 J) if a < 0. A change of the acceleration
    from a to -b and then to 0 changes the speed by (a^2 - 2 b^2) / (2 J). The deceleration b is at most D, and the
    remaining speed is reduced at the deceleration b. An initial deceleration beyond D is first reduced to D.

    Args:
        v: Speed along the travel [m/s].
        a: Acceleration along the travel [m/s^2].
        deceleration: Largest deceleration D [m/s^2].
        jerk: Largest jerk J [m/s^3].
    """
    if a < -deceleration:
        spare = max(0.0, v - 0.5 * a * a / jerk)  # after +J directly to rest; limited to -D
        phases = ((-deceleration - a) / jerk, jerk), (spare / deceleration, 0.0), (deceleration / jerk, jerk)
    else:
        brake = min(deceleration, math.sqrt(max(0.0, jerk * v + 0.5 * a * a)))
        hold = max(0.0, v + (0.5 * a * a - brake * brake) / jerk) / deceleration if brake == deceleration else 0.0
        phases = ((a + brake) / jerk, -jerk), (hold, 0.0), (brake / jerk, jerk)
    return tuple(phase for phase in phases if phase[0] > 0.0)


def braking_time(speed: float, deceleration: float, jerk: float) -> float:
    """Return the duration of `braking_phases` from a constant speed [s].

    Args:
        speed: Speed along the travel, >= 0 [m/s].
        deceleration: Largest deceleration [m/s^2].
        jerk: Largest jerk [m/s^3].
    """
    if speed < deceleration**2 / jerk:
        return 2.0 * math.sqrt(speed / jerk)
    return speed / deceleration + deceleration / jerk


@dataclass(frozen=True, eq=False, repr=False)
class TimeLaw(FrozenArrays):
    """Travelled distance as a function of time, in phases of constant jerk.

    Args:
        durations: Shape (n,) [s], each > 0.
        jerks: Shape (n,) [m/s^3].
        start_s: Distance at the start [m].
        start_speed: Speed at the start, >= 0 in either gear [m/s].
        start_acceleration: Acceleration at the start [m/s^2].

    Attributes:
        times: Phase borders, Shape (n + 1,) [s], first 0.
        states: Distance, speed, acceleration at the borders, Shape (n + 1, 3).

    Raises:
        InvalidValue: If there is no phase, shapes differ, a duration is not > 0, a value is not finite, or the motion
            overflows.
    """

    durations: FloatArray
    jerks: FloatArray
    start_s: float = 0.0
    start_speed: float = 0.0
    start_acceleration: float = 0.0
    times: FloatArray = field(init=False, repr=False)
    states: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        durations = frozen_array(self.durations, "time law.durations")
        jerks = frozen_array(self.jerks, "time law.jerks")
        if durations.size == 0 or durations.size != jerks.size:
            raise InvalidValue(f"time law: needs >= 1 phase with a jerk each, got {durations.size}, {jerks.size}")
        if not (durations > 0.0).all():
            raise InvalidValue("time law.durations: must be > 0 s")
        for name in ("start_s", "start_speed", "start_acceleration"):
            vars(self)[name] = finite_number(getattr(self, name), f"time law.{name}")
        start = self.start_s, self.start_speed, self.start_acceleration
        with np.errstate(over="ignore", invalid="ignore"):
            times = np.concatenate(([0.0], durations.cumsum()))
            states = np.ascontiguousarray(border_states(durations, jerks, start).T)
        if not (np.isfinite(states).all() and np.isfinite(times[-1])):
            raise InvalidValue("time law: the motion overflows; durations or jerks are too large")
        vars(self).update(durations=durations, jerks=jerks, times=readonly(times), states=readonly(states))

    def __repr__(self) -> str:
        return f"<TimeLaw {self.duration:.3f} s in {self.durations.size} phases of constant jerk>"

    @cached_property
    def duration(self) -> float:
        """Total time [s]."""
        return float(self.times[-1])

    def at(self, t: ArrayLike) -> FloatArray:
        """Return distance, speed, acceleration, jerk at times `t`, Shape (n,) [s], clipped. Shape (n, 4)."""
        points = np.clip(np.atleast_1d(np.asarray(t, dtype=np.float64)), 0.0, self.duration)
        phase = self._phases_at(points)
        (s, v, a), jerk = self.states[phase].T, self.jerks[phase]
        return np.column_stack((*constant_jerk(points - self.times[phase], s, v, a, jerk), jerk))

    def state_at(self, t: float) -> tuple[float, float, float]:
        """Return distance, speed and acceleration at one time [s], clipped; several times as fast as `at`."""
        begins, states, jerks = self._phases
        t = min(max(t, 0.0), self.duration)
        phase = bisect_right(begins, t, 1) - 1
        return constant_jerk(t - begins[phase], *states[phase], jerks[phase])

    @cached_property
    def _phases(self) -> tuple[list[float], list[tuple[float, float, float]], list[float]]:
        """Begin, state at the begin, and jerk of every phase."""
        states = [(s, v, a) for s, v, a in self.states[:-1].tolist()]
        return self.times[:-1].tolist(), states, self.jerks.tolist()

    def phase_middles(self, t: FloatArray) -> FloatArray:
        """Return, for each time `t`, Shape (n,) [s], the mean of the end distances of its phase. Shape (n,) [m]."""
        phase = self._phases_at(t)
        middles: FloatArray = 0.5 * (self.states[phase, 0] + self.states[phase + 1, 0])
        return middles

    def _phases_at(self, t: FloatArray) -> IntArray:
        return np.searchsorted(self.times[1:-1], t, side="right")
