"""What plugins return and say about themselves: plain values."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Mapping

    from optdock.path import Path
    from optdock.trajectory import Trajectory

__all__ = [
    "BehaviorResult",
    "BehaviorStatus",
    "Bounds",
    "CostmapInfoType",
    "SmoothingResult",
    "TimingResult",
    "TimingStatus",
    "Tolerances",
]


@dataclass(frozen=True, eq=False)
class SmoothingResult:
    """What a smoother returns.

    Args:
        path: The smoothed path; always usable.
        completed: False when the time limit stopped the work early.
        report: Numbers about the work, for people and logs: seconds per stage, iterations, cost.
    """

    path: Path
    completed: bool = True
    report: Mapping[str, object] = field(default_factory=dict)


class TimingStatus(IntEnum):
    """How a time parameterization ended; physics is an outcome, not an exception."""

    OK = 0
    START_INFEASIBLE = 1
    CANNOT_STOP = 2
    BAD_START = 3
    FAIL = 4
    TIMED_OUT = 5


@dataclass(frozen=True, eq=False)
class TimingResult:
    """What a time parameterizer returns.

    Args:
        status: How it ended.
        trajectory: The timed motion. OK: the whole path. START_INFEASIBLE: full braking, which violates the limits
            least, until past the last violation, then on to the end (to rest, where nothing more can be planned).
            CANNOT_STOP: full braking on the gear at hand; its distance runs on beyond that gear's end. None where
            there is no motion to offer: BAD_START, FAIL, TIMED_OUT.
        worst_ratio: Largest quotient of a quantity and its limit; at most 1 when OK.
        overshoot: Distance that full braking needs beyond the end of the gear segment [m]; 0 unless CANNOT_STOP.
        report: Numbers about the work.
        reason: Why it is not OK, one sentence with numbers; empty when OK.
        limit: The limit in the way, by its name in `MotionLimits`, or `approach_speed`; empty where no single one is.
        at_s: Where along the path that is decided [m]; None where it is not one place.
    """

    status: TimingStatus
    trajectory: Trajectory | None
    worst_ratio: float = 0.0
    overshoot: float = 0.0
    report: Mapping[str, object] = field(default_factory=dict)
    reason: str = ""
    limit: str = ""
    at_s: float | None = None


class CostmapInfoType(IntEnum):
    """Which costmaps a behavior needs."""

    NONE = 0
    LOCAL = 1
    GLOBAL = 2
    BOTH = 3


class BehaviorStatus(IntEnum):
    """How a behavior stands."""

    SUCCEEDED = 1
    FAILED = 2
    RUNNING = 3


@dataclass(frozen=True)
class BehaviorResult:
    """Status, Nav2 error code (0 for none) and message of a behavior's cycle."""

    status: BehaviorStatus
    error_code: int = 0
    error_msg: str = ""


class Bounds(NamedTuple):
    """A box in the costmap's frame [m]."""

    min_x: float
    min_y: float
    max_x: float
    max_y: float


class Tolerances(NamedTuple):
    """What a goal checker accepts; None where it does not measure."""

    x: float | None = None
    y: float | None = None
    yaw: float | None = None
    linear_speed: float | None = None
    angular_speed: float | None = None
    path_length: float | None = None
