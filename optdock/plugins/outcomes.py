"""Results and reports of plugins."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum, IntEnum
from typing import TYPE_CHECKING, NamedTuple

from optdock.errors import FailedToSmoothPath, FailedToTimePath, TimingTimedOut

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
    "SampledBound",
    "SmoothingReport",
    "SmoothingResult",
    "SmoothingStatus",
    "TimingReport",
    "TimingResult",
    "TimingStatus",
    "Tolerances",
]

_SAMPLED_TOLERANCE = 1e-6  # as the certificate's


class Guess(NamedTuple):
    """Raw path of a planner, exactly from the start to the goal, and the name of the stage that found the path."""

    path: Path
    stage: str = ""


class SampledBound(NamedTuple):
    """Bound `value >= 0` of a smoother at samples of a path, not proven between them; its truth value is `holds`.

    `name`: name of the bound. `least`: smallest value at a sample; -inf if a value is not a finite number. `s`: path
    coordinate of this value [m]. `spacing`: largest distance between samples [m].
    """

    name: str
    least: float
    s: float
    spacing: float

    def __bool__(self) -> bool:
        return self.holds

    @property
    def holds(self) -> bool:
        """Whether the bound holds at all samples, up to 1e-6."""
        return self.least >= -_SAMPLED_TOLERANCE

    @property
    def violation(self) -> str:
        """Sentence about the violation of the bound."""
        return f"the term {self.name!r} is {self.least:.4g} at s = {self.s:.3f} m, must be >= 0"

    def failure(self, path: Path) -> FailedToSmoothPath:
        """Return the error that describes the violation on `path`."""
        pose = path.poses_at(self.s)[0].tolist()
        where = {"reason": "term", "term": self.name, "s": self.s, "amount": -self.least, "obstacle": "", "pose": pose}
        return FailedToSmoothPath(f"term: {self.violation}", where=where)

    def as_dict(self) -> dict[str, object]:
        """Return plain values for a plan file."""
        return {**self._asdict(), "verdict": "sampled, not proven"}

    def __str__(self) -> str:
        least = f"{self.name}: at least {self.least:.4g} at s = {self.s:.3f} m"
        return f"{least}, sampled every {self.spacing:g} m, not proven"


class SmoothingStatus(str, Enum):
    """Origin of a smoother's path."""

    CONVERGED = "converged"  # a local optimum
    STOPPED = "stopped"  # the best path when the limit of time or iterations was reached
    INPUT_KEPT = "input kept"  # the input is certified, and no better path was found
    WARM_START_KEPT = "warm start kept"  # the earlier result is certified, and no other path was found
    STRAIGHT = "straight"  # the straight line from start to goal is certified


@dataclass(frozen=True, repr=False)
class SmoothingReport:
    """Report of a smoother; values that the smoother does not report are None or empty.

    Args:
        status: Origin of the path.
        cost: Cost of the path, defined by the smoother.
        iterations: Number of iterations.
        setup_s: Time before the first iteration, excluding `build_s` [s].
        build_s: Time for building programs that later calls in this process reuse [s].
        certify_s: Time for certificates [s].
        first_certified_s: Time until the first certified path [s].
        total_s: Time of the call [s].
        certificate: Certificate that the smoother computed; the pipeline certifies the path again.
        extra: Further entries.
        warning: Warning for the user, or empty.
        sampled: Own bounds of the smoother at samples of the path, which no certificate covers.
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
    sampled: tuple[SampledBound, ...] = ()

    def __repr__(self) -> str:
        parts = [self.status.value] if self.status is not None else []
        parts += [f"{self.iterations} iterations"] if self.iterations is not None else []
        parts += [f"cost {self.cost:.4g}"] if self.cost is not None else []
        parts += [f"{1e3 * self.total_s:.1f} ms"] if self.total_s is not None else []
        if self.certificate is not None:
            parts.append("certified" if self.certificate.certified else "not certified")
        parts += map(str, self.sampled)
        parts += [f"warning: {self.warning}"] if self.warning else []
        return f"<SmoothingReport {', '.join(parts) or 'empty'}>"


@dataclass(frozen=True, eq=False, repr=False)
class SmoothingResult:
    """Result of a smoother.

    Args:
        path: Smoothed path.
        completed: False if the computation was stopped by the time limit.
        report: Report.
    """

    path: Path
    completed: bool = True
    report: SmoothingReport = field(default_factory=SmoothingReport)

    def __repr__(self) -> str:
        ended = "completed" if self.completed else "stopped early"
        return f"<SmoothingResult {self.path.length:.3f} m, {ended}, {self.report!r}>"


class TimingStatus(IntEnum):
    """Status of a time parameterization; only OK is true. An infeasible motion has a status and raises no exception."""

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
    """Report of a time parameterizer.

    Args:
        gears: Method used for every gear, in driving order.
        replaced: Reason why `plan_dock` used the default method instead; empty if it used this method.
        extra: Further entries.
    """

    gears: tuple[str, ...] = ()
    replaced: str = ""
    extra: Mapping[str, object] = field(default_factory=dict)

    def __repr__(self) -> str:
        parts = [*self.gears, *([f"replaced {self.replaced.split(':')[0]}"] if self.replaced else [])]
        return f"<TimingReport {', '.join(parts) or 'empty'}>"


@dataclass(frozen=True, eq=False, repr=False)
class TimingResult:
    """Result of a time parameterizer.

    Args:
        status: Status.
        trajectory: Motion. OK: motion along the whole path. START_INFEASIBLE: full braking until after the last
            violation, then the motion to the end, or to rest if that fails. CANNOT_STOP: full braking in the present
            gear, beyond its end. BAD_START, FAIL, TIMED_OUT: None.
        worst_ratio: Largest ratio of a quantity to its limit; at most 1 if OK.
        overshoot: Distance of full braking beyond the end of the gear segment [m]; 0 unless CANNOT_STOP.
        report: Report.
        reason: Reason if the status is not OK, one sentence with numbers.
        limit: Name of the exceeded limit in `MotionLimits`, or `approach_speed`; empty if no single limit is exceeded.
        at_s: Arc length of the violation [m]; None if the violation has no single position.
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
        """Return the error that describes a result that is not OK."""
        where: dict[str, object] = {"status": self.status.name}
        where |= {"worst_ratio": self.worst_ratio, "overshoot": self.overshoot}
        if self.limit:
            where["limit"] = self.limit
        if self.at_s is not None:
            where["s"] = self.at_s
        kind = TimingTimedOut if self.status is TimingStatus.TIMED_OUT else FailedToTimePath
        return kind(f"the path cannot be timed: {self.reason or self.status.name}", where=where)


class CostmapInfoType(IntEnum):
    """Costmaps that a behavior needs."""

    NONE = 0
    LOCAL = 1
    GLOBAL = 2
    BOTH = 3


class BehaviorStatus(IntEnum):
    """Status of a behavior; only SUCCEEDED is true."""

    SUCCEEDED = 1
    FAILED = 2
    RUNNING = 3

    def __bool__(self) -> bool:
        return self is BehaviorStatus.SUCCEEDED


@dataclass(frozen=True)
class BehaviorResult:
    """Status, Nav2 error code (0 for none) and message of a behavior; true if the behavior has succeeded."""

    status: BehaviorStatus
    error_code: int = 0
    error_msg: str = ""

    def __bool__(self) -> bool:
        return bool(self.status)


class Contact(Enum):
    """Kind of contact with a dock."""

    SIGNAL = "external signal"  # a switch, or the charger
    STALL = "stall"  # the robot is commanded to move, but stays at rest


class Bounds(NamedTuple):
    """Box in the costmap's frame [m]."""

    min_x: float
    min_y: float
    max_x: float
    max_y: float


class Tolerances(NamedTuple):
    """Accepted errors of a goal checker [m], [rad], [m/s], [rad/s]; None: not checked."""

    x: float | None = None
    y: float | None = None
    yaw: float | None = None
    linear_speed: float | None = None
    angular_speed: float | None = None
    path_length: float | None = None
