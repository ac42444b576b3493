"""State-to-state motions and full braking by ruckig's community edition, offline.

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
    """Full braking to rest, wherever that is; starts with speed > 0, or at rest with no acceleration."""
    return _tool().stop_move(start, box)


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
        self.position, self.velocity = ruckig.ControlInterface.Position, ruckig.ControlInterface.Velocity

    def position_move(self, start: State, target: State, box: Box, speed: float, longest: float) -> Phases | None:
        """From state to state; inputs are copies inside ruckig, so lists are assigned, never changed."""
        given = self.input
        given.current_position, given.current_velocity, given.current_acceleration = [start.s], [start.v], [start.a]
        given.target_position, given.target_velocity, given.target_acceleration = [target.s], [target.v], [target.a]
        given.max_velocity, given.max_jerk = [speed], [box.jerk]
        given.max_acceleration, given.min_acceleration = [box.acceleration], [-box.deceleration]
        return self._calculated(longest)

    def stop_move(self, start: State, box: Box) -> Phases:
        """To rest by the velocity interface, which ignores positions and the speed bound."""
        self.input.control_interface = self.velocity
        try:
            return self.position_move(start, State(start.s), box, box.speed, math.inf) or ()
        finally:
            self.input.control_interface = self.position

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
