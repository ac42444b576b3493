"""Motions as phases of constant jerk, fast enough for inner loops; the formulas are in `optdock.model.trajectory`."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np

from optdock.model.constant_jerk import border_states, constant_jerk

if TYPE_CHECKING:
    from collections.abc import Iterable

    from optdock.geometry.arrays import FloatArray

__all__ = ["DriveBounds", "Motion", "MotionState", "Phases", "braking_slack", "duration_of", "state_after", "stretched"]

_MOST_SAMPLES = 40_000  # per motion, 320 kB per column: longer motions are sampled more coarsely

Phases: TypeAlias = "tuple[tuple[float, float], ...]"
"""Duration [s] and jerk [m/s^3] of every phase, in order."""


class MotionState(NamedTuple):
    """Distance [m], speed [m/s], acceleration [m/s^2] in the direction of travel."""

    s: float = 0.0
    v: float = 0.0
    a: float = 0.0


class DriveBounds(NamedTuple):
    """Constant bounds on one motion, all > 0: speed [m/s], acceleration, deceleration [m/s^2], jerk [m/s^3]."""

    speed: float
    acceleration: float
    deceleration: float
    jerk: float


def state_after(state: MotionState, duration: float, jerk: float) -> MotionState:
    """Return the state after one phase."""
    return MotionState(*constant_jerk(duration, *state, jerk))


def duration_of(phases: Phases) -> float:
    """Return the total duration of phases [s]."""
    return sum([duration for duration, _jerk in phases])


def stretched(phases: Phases, factor: float) -> Phases:
    """Return the same motion from rest, slowed down by `factor` >= 1; limits satisfied before remain satisfied.

    Speeds are divided by the factor, accelerations by its square, jerk by its cube.
    """
    return tuple((duration * factor, jerk / factor**3) for duration, jerk in phases)


def braking_slack(state: MotionState, jerk: float) -> float:
    """Return the speed when a deceleration has been reduced to 0 [m/s]; if < 0, rolling backwards is unavoidable."""
    return state.v - 0.5 * state.a * state.a / jerk if state.a < 0.0 else state.v


class Motion(NamedTuple):
    """A start state and phases, with the states at all phase boundaries."""

    durations: FloatArray  # Shape (n,) [s]
    jerks: FloatArray  # Shape (n,) [m/s^3]
    times: FloatArray  # phase boundaries, Shape (n + 1,) [s]
    states: FloatArray  # distance, speed, acceleration at the boundaries, Shape (3, n + 1)

    @classmethod
    def of(cls, start: MotionState, phases: Iterable[tuple[float, float]]) -> Motion:
        """Return the motion from a start state; phases of zero duration are omitted."""
        table = np.array([phase for phase in phases if phase[0] > 0.0], dtype=np.float64).reshape(-1, 2)
        durations, jerks = table[:, 0], table[:, 1]
        times = np.concatenate(([0.0], durations.cumsum()))
        return cls(durations, jerks, times, border_states(durations, jerks, start))

    @property
    def start(self) -> MotionState:
        """State at the start."""
        return MotionState(*self.states[:, 0].tolist())

    @property
    def end(self) -> MotionState:
        """State at the end."""
        return MotionState(*self.states[:, -1].tolist())

    @property
    def phases(self) -> Phases:
        """Durations and jerks of the phases."""
        return tuple(zip(self.durations.tolist(), self.jerks.tolist(), strict=True))

    @property
    def duration(self) -> float:
        """Total time [s]."""
        return float(self.times[-1])

    def at(self, t: FloatArray) -> FloatArray:
        """Return distance, speed, acceleration at times `t`, Shape (n,) [s], in [0, duration]. Shape (3, n)."""
        if not self.durations.size:  # if an acceleration is so small that its square is 0
            return np.repeat(self.states, t.size, axis=1)
        phase = np.minimum(self.times.searchsorted(t, side="right") - 1, self.durations.size - 1)
        s, v, a = self.states[:, phase]
        return np.array(constant_jerk(t - self.times[phase], s, v, a, self.jerks[phase]))

    def sample_times(self, period: float) -> FloatArray:
        """Return all phase boundaries, and times at most `period` [s] apart, or further apart in very long motions."""
        count = int(min(self.duration / period, _MOST_SAMPLES)) + 1
        return np.union1d(self.times, np.minimum(np.arange(count) * max(period, self.duration / count), self.duration))

    def crossing_times(self, s: FloatArray) -> FloatArray:
        """Return the times at which the distances `s`, Shape (n,) [m], are reached; speeds >= 0. Shape (n,) [s].

        The times are found by linear interpolation on a 10 ms grid and two Newton steps.
        """
        grid = self.sample_times(0.01)
        t = np.interp(s, np.maximum.accumulate(self.at(grid)[0]), grid)
        for _ in range(2):
            distance, speed, _a = self.at(t)
            step = (distance - s) / np.maximum(speed, 1e-3)
            t = np.minimum(np.maximum(t - np.minimum(np.maximum(step, -0.01), 0.01), 0.0), self.duration)
        return t

    def cut(self, t: float) -> tuple[Phases, MotionState]:
        """Return the phases before time `t` [s], and the state at that time."""
        kept: list[tuple[float, float]] = []
        state, left = self.start, t
        for duration, jerk in self.phases:
            part = min(duration, left)
            if part <= 0.0:
                break
            kept.append((part, jerk))
            state, left = state_after(state, part, jerk), left - part
        return tuple(kept), state
