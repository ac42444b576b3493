"""What plugins return and say about themselves: plain values."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum, IntEnum
from typing import TYPE_CHECKING, NamedTuple

from optdock.errors import FailedToTimePath, TimingTimedOut

if TYPE_CHECKING:
    from collections.abc import Mapping

    from optdock.model.path import Path
    from optdock.model.trajectory import Trajectory
    from optdock.verification import Certificate

__all__ = [
    "BehaviorResult",
    "BehaviorStatus",
    "Bounds",
    "Contact",
    "CostmapInfoType",
    "Guess",
    "SmoothingReport",
    "SmoothingResult",
    "SmoothingStatus",
    "TimingReport",
    "TimingResult",
    "TimingStatus",
    "Tolerances",
]


class Guess(NamedTuple):
    """A raw path of a planner that has several.

    `path`: exactly from start to goal. `stage`: how it was found, in the words of the method, for reports.
    """

    path: Path
    stage: str = ""


class SmoothingStatus(str, Enum):
    """Where a smoother's path comes from."""

    CONVERGED = "converged"  # a local optimum
    STOPPED = "stopped"  # the best when the time, or the number of iterations, was used up
    INPUT_KEPT = "input kept"  # the input is an answer, and none better was found
    WARM_START_KEPT = "warm start kept"  # the earlier result is an answer still, and no other was found
    STRAIGHT = "straight"  # the straight line from start to goal is an answer: nothing is shorter


@dataclass(frozen=True, repr=False)
class SmoothingReport:
    """What a smoother says about its work; None and empty where it does not say.

    Args:
        status: Where the path comes from.
        cost: Of the path, in the smoother's own terms.
        iterations: How many there were.
        setup_s: Seconds before the first iteration, `build_s` left out.
        build_s: Seconds spent on what later calls in this process will find built.
        certify_s: Seconds spent on proofs.
        first_certified_s: Seconds until the first certified path.
        total_s: Seconds of the call.
        certificate: Of the path, where the smoother proved it; it is proven again.
        extra: Whatever else a plugin has to say.
        warning: What a user of the result should know; empty: nothing.
    """

    status: SmoothingStatus | None = None
    cost: float | None = None
    iterations: int | None = None
    setup_s: float | None = None
    build_s: float | None = None
    certify_s: float | None = None
    first_certified_s: float | None = None
    total_s: float | None = None
    certificate: Certificate | None = None
    extra: Mapping[str, object] = field(default_factory=dict)
    warning: str = ""

    def __repr__(self) -> str:
        said = [self.status.value] if self.status is not None else []
        said += [f"{self.iterations} iterations"] if self.iterations is not None else []
        said += [f"cost {self.cost:.4g}"] if self.cost is not None else []
        said += [f"{1e3 * self.total_s:.1f} ms"] if self.total_s is not None else []
        if self.certificate is not None:
            said.append("certified" if self.certificate.certified else "not certified")
        said += [f"warning: {self.warning}"] if self.warning else []
        return f"<SmoothingReport {', '.join(said) or 'empty'}>"


@dataclass(frozen=True, eq=False, repr=False)
class SmoothingResult:
    """What a smoother returns.

    Args:
        path: The smoothed path; always usable.
        completed: False when the time limit stopped the work early.
        report: About the work.
    """

    path: Path
    completed: bool = True
    report: SmoothingReport = field(default_factory=SmoothingReport)

    def __repr__(self) -> str:
        ended = "completed" if self.completed else "stopped early"
        return f"<SmoothingResult {self.path.length:.3f} m, {ended}, {self.report!r}>"


class TimingStatus(IntEnum):
    """How a time parameterization ended; physics is an outcome, not an exception. OK alone counts as true."""

    OK = 0
    START_INFEASIBLE = 1
    CANNOT_STOP = 2
    BAD_START = 3
    FAIL = 4
    TIMED_OUT = 5

    def __bool__(self) -> bool:
        return self is TimingStatus.OK


@dataclass(frozen=True, repr=False)
class TimingReport:
    """What a time parameterizer says about its work.

    Args:
        gears: How every gear was timed, in driving order, in the words of the method.
        replaced: Why `plan_dock` took the motion of the plain method instead of the chosen one's; empty: it did not.
        extra: Whatever else a plugin has to say.
    """

    gears: tuple[str, ...] = ()
    replaced: str = ""
    extra: Mapping[str, object] = field(default_factory=dict)

    def __repr__(self) -> str:
        said = [*self.gears, *([f"replaced {self.replaced.split(':')[0]}"] if self.replaced else [])]
        return f"<TimingReport {', '.join(said) or 'empty'}>"


@dataclass(frozen=True, eq=False, repr=False)
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
        report: About the work.
        reason: Why it is not OK, one sentence with numbers; empty when OK.
        limit: The limit in the way, by its name in `MotionLimits`, or `approach_speed`; empty where no single one is.
        at_s: Where along the path that is decided [m]; None where it is not one place.
    """

    status: TimingStatus
    trajectory: Trajectory | None
    worst_ratio: float = 0.0
    overshoot: float = 0.0
    report: TimingReport = field(default_factory=TimingReport)
    reason: str = ""
    limit: str = ""
    at_s: float | None = None

    def __repr__(self) -> str:
        lasts = f" {self.trajectory.duration:.3f} s" if self.trajectory is not None else ""
        why = f", {self.reason}" if self.reason else ""
        return f"<TimingResult {self.status.name}{lasts}{why}, {self.report!r}>"

    def __bool__(self) -> bool:
        return bool(self.status)

    def failure(self) -> FailedToTimePath:
        """The error that says why this is not OK."""
        where: dict[str, object] = {"status": self.status.name}
        where |= {"worst_ratio": self.worst_ratio, "overshoot": self.overshoot}
        if self.limit:
            where["limit"] = self.limit
        if self.at_s is not None:
            where["s"] = self.at_s
        kind = TimingTimedOut if self.status is TimingStatus.TIMED_OUT else FailedToTimePath
        return kind(f"the path cannot be timed: {self.reason or self.status.name}", where=where)


class CostmapInfoType(IntEnum):
    """Which costmaps a behavior needs."""

    NONE = 0
    LOCAL = 1
    GLOBAL = 2
    BOTH = 3


class BehaviorStatus(IntEnum):
    """How a behavior stands; SUCCEEDED alone counts as true."""

    SUCCEEDED = 1
    FAILED = 2
    RUNNING = 3

    def __bool__(self) -> bool:
        return self is BehaviorStatus.SUCCEEDED


@dataclass(frozen=True)
class BehaviorResult:
    """Status, Nav2 error code (0 for none) and message of a behavior's cycle; true where it has succeeded."""

    status: BehaviorStatus
    error_code: int = 0
    error_msg: str = ""

    def __bool__(self) -> bool:
        return bool(self.status)


class Contact(Enum):
    """How a robot feels that it is in its dock."""

    SIGNAL = "external signal"  # a switch, or the charger
    STALL = "stall"  # it is driven on and does not move


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
