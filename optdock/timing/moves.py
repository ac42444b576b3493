"""State-to-state motions by ruckig's community edition, offline, and full braking.

ruckig happily drives backwards and accepts start states beyond its limits; both are seen to here. It never gets an
intermediate position: with one, the community edition would call a cloud service.
"""

from __future__ import annotations

import importlib
import math
import threading
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

from optdock.errors import PluginError
from optdock.timing.motion import Phases, State

if TYPE_CHECKING:
    from types import ModuleType

__all__ = ["Box", "full_stop", "load_ruckig", "move"]

_ABOVE = 1.0 + 1e-9  # ruckig refuses a target exactly at its speed limit
_STILL = 1e-9  # [m/s]: rounding below zero that does not count as driving backwards


class Box(NamedTuple):
    """Bounds of one motion, all > 0: speed [m/s], acceleration, deceleration [m/s^2], jerk [m/s^3]."""

    speed: float
    acceleration: float
    deceleration: float
    jerk: float


def move(start: State, target: State, box: Box, longest: float = math.inf) -> Phases | None:
    """The time-optimal motion between two states; None where there is none without driving backwards.

    The speed bound is raised to what the two states make inevitable; whoever needs it kept checks the result.

    Args:
        start: First state.
        target: Last state.
        box: Bounds.
        longest: Motions that take longer count as none [s].
    """
    rise = max(
        target.v + (0.5 * target.a * target.a / box.jerk if target.a < 0.0 else 0.0),
        start.v + (0.5 * start.a * start.a / box.jerk if start.a > 0.0 else 0.0),
    )
    phases = _tool().position_move(start, target, box, max(box.speed, rise * _ABOVE), longest)
    return phases if _drives_forward(start, phases) else None


def full_stop(start: State, box: Box) -> Phases:
    """Full braking to rest, wherever that is, in closed form: -J to the deceleration, hold, +J to rest.

    From a state that need not roll backwards: v >= 0, and v >= a^2 / (2 J) where a < 0. Leading the acceleration from a
    to -b and on to 0 changes the speed by (a^2 - 2 b^2) / (2 J); the largest b is the deceleration, and what is left of
    the speed then is braked off at b. A deceleration beyond it is led back first.
    """
    _s, v, a = start
    jerk, most = box.jerk, box.deceleration
    if a < -most:
        spare = max(0.0, v - 0.5 * a * a / jerk)  # after +J straight to rest; held at -D, where +J passes it
        return _timed(((-most - a) / jerk, jerk), (spare / most, 0.0), (most / jerk, jerk))
    brake = min(most, math.sqrt(max(0.0, jerk * v + 0.5 * a * a)))
    hold = max(0.0, v + (0.5 * a * a - brake * brake) / jerk) / most if brake == most else 0.0
    return _timed(((a + brake) / jerk, -jerk), (hold, 0.0), (brake / jerk, jerk))


def _timed(*phases: tuple[float, float]) -> Phases:
    return tuple(phase for phase in phases if phase[0] > 0.0)


def _drives_forward(start: State, phases: Phases | None) -> bool:
    if phases is None:
        return False
    _s, v, a = start
    for duration, jerk in phases:
        end_a = a + duration * jerk
        if a < 0.0 < end_a and v - 0.5 * a * a / jerk < -_STILL:
            return False
        v += 0.5 * duration * (a + end_a)
        a = end_a
        if v < -_STILL:
            return False
    return True


class _Tool:
    """One set of ruckig's objects; a trajectory object is overwritten by every calculation."""

    def __init__(self, ruckig: ModuleType) -> None:
        self.otg: Any = ruckig.Ruckig(1)  # ruckig ships no types
        self.input: Any = ruckig.InputParameter(1)
        self.output: Any = ruckig.Trajectory(1)
        self.error: type[Exception] = ruckig.RuckigError

    def position_move(self, start: State, target: State, box: Box, speed: float, longest: float) -> Phases | None:
        """From state to state; inputs are copies inside ruckig, so lists are assigned, never changed."""
        given = self.input
        given.current_position, given.current_velocity, given.current_acceleration = [start.s], [start.v], [start.a]
        given.target_position, given.target_velocity, given.target_acceleration = [target.s], [target.v], [target.a]
        given.max_velocity, given.max_jerk = [speed], [box.jerk]
        given.max_acceleration, given.min_acceleration = [box.acceleration], [-box.deceleration]
        return self._calculated(longest)

    def _calculated(self, longest: float) -> Phases | None:
        """The phases of the motion that the inputs ask for, brake phases first; None where ruckig finds none."""
        try:
            self.otg.calculate(self.input, self.output)
        except self.error:
            return None
        if self.output.duration > longest:
            return None
        profile = self.output.profiles[0][0]
        brake = profile.brake
        times, jerks = profile.t, profile.j
        if brake.duration > 0.0:
            times, jerks = [*brake.t, *times], [*brake.j, *jerks]
        return tuple([phase for phase in zip(times, jerks, strict=True) if phase[0] > 0.0])


def load_ruckig() -> None:
    """Import ruckig now, for this thread.

    Raises:
        PluginError: It is not installed.
    """
    _tool()


class _Local(threading.local):
    tool: _Tool | None = None


_local = _Local()


def _tool() -> _Tool:
    if _local.tool is None:
        _local.tool = _Tool(_ruckig())
    return _local.tool


@cache
def _ruckig() -> ModuleType:
    try:
        return importlib.import_module("ruckig")
    except ImportError as error:
        raise PluginError(f"timing: needs the package ruckig ({error}); install it: pip install ruckig") from error
