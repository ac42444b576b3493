"""Results of a cycle, with Nav2's error codes."""

from __future__ import annotations

from typing import NamedTuple

from optdock.geometry.pose import Twist2
from optdock.plugins.interfaces import BehaviorResult, BehaviorStatus

__all__ = [
    "BACK_UP",
    "DRIVE_ON_HEADING",
    "RUNNING",
    "SUCCEEDED",
    "Codes",
    "failed",
    "stopped",
]


class Codes(NamedTuple):
    """Nav2's action error codes of one behavior; `invalid_input` is `unknown` where Nav2 has none."""

    unknown: int
    timeout: int
    collision_ahead: int
    invalid_input: int


BACK_UP = Codes(unknown=710, timeout=711, collision_ahead=714, invalid_input=713)
DRIVE_ON_HEADING = Codes(unknown=720, timeout=721, collision_ahead=723, invalid_input=724)

SUCCEEDED = BehaviorResult(BehaviorStatus.SUCCEEDED)
RUNNING = BehaviorResult(BehaviorStatus.RUNNING)


def failed(code: int, message: str) -> BehaviorResult:
    """A failure with its code and reason."""
    return BehaviorResult(BehaviorStatus.FAILED, code, message)


def stopped(result: BehaviorResult) -> tuple[BehaviorResult, Twist2]:
    """The end of a behavior: its result, and the command to stand still."""
    return result, Twist2()
