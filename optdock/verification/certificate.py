"""Certificates, which list every violation with its position and amount, and the tolerance of all proofs."""

from __future__ import annotations

import math
import weakref
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Generic, TypeVar

if TYPE_CHECKING:
    from collections.abc import Mapping

    from optdock.model.problem import ProblemFingerprint

__all__ = ["SHARPNESS", "TOLERANCE", "Certificate", "Memo", "TrajectoryCertificate", "Violation", "where_broken"]

# Tolerance of every rule: [m], [rad], [m/s], [m/s^2], [1/m], and relative to limits. It covers rounding over kilometres
# (1e-9), files with six decimals, and residuals of solvers (1e-8), and is a thousandth of the resolution of sensors and
# drives.
TOLERANCE = 1e-6
# [m]: the proven minimum of the clearance is at most this far below a clearance that occurs. If the minimum is at the
# dock, the usual case, this accuracy needs no additional time.
SHARPNESS = 1e-3

Subject = TypeVar("Subject")
Value = TypeVar("Value")


class Memo(Generic[Subject, Value]):
    """Cache of one value for every living subject, keyed by the identity and not by the equality of subjects.

    The verdict on immutable inputs never changes, so a proof is computed only once. Verdicts are stored in the cache
    and not in the subject, so a caller cannot supply a verdict.
    """

    def __init__(self) -> None:
        self._kept: dict[int, tuple[weakref.ref[Subject], Value]] = {}

    def recall(self, subject: Subject) -> Value | None:
        """Return the value of `subject`, or None."""
        known = self._kept.get(id(subject))
        return known[1] if known is not None and known[0]() is subject else None

    def keep(self, subject: Subject, value: Value) -> None:
        """Keep `value`, which must not reference `subject`, for the lifetime of `subject`."""
        key = id(subject)
        self._kept[key] = weakref.ref(subject, lambda _: self._kept.pop(key, None)), value


@dataclass(frozen=True)
class Violation:
    """A violated rule.

    Args:
        kind: Machine-readable name of the rule: `frame`, `start`, `goal`, `joint`, `direction`, `turn`, `slip`,
            `curvature`, `curvature_rate`, `start_curvature`, `final_straight`, `clearance`, `view`, `unproven`; for
            trajectories the name of the limit, `yaw_jerk`, `rest`, `coverage` or `start_state`.
        message: Description with the position and the amount of the violation.
        s: Arc length of the violation [m].
        amount: Excess over the rule, in the unit of the rule; > 0.
        where: Additional data: pose, obstacle.
    """

    kind: str
    message: str
    s: float
    amount: float
    where: Mapping[str, object] = field(default_factory=dict)


@dataclass(frozen=True, repr=False)
class _Verdict:
    violations: tuple[Violation, ...]

    def __bool__(self) -> bool:
        return self.certified

    @property
    def certified(self) -> bool:
        """Whether every rule was proven."""
        return not self.violations

    @property
    def reason(self) -> str:
        """Message of the first violation, or the empty string."""
        return self.violations[0].message if self.violations else ""

    def _as_dict(self, **values: object) -> dict[str, object]:
        rows = [
            {"kind": v.kind, "message": v.message, "s": _plain(v.s), "amount": _plain(v.amount), "where": dict(v.where)}
            for v in self.violations
        ]
        return {"certified": self.certified, **values, "violations": rows}


@dataclass(frozen=True, repr=False)
class Certificate(_Verdict):
    """Verdict on a path; its truth value is `certified`.

    Args:
        violations: Every violated rule; empty if certified.
        min_clearance: Proven lower bound of the clearance of the footprint on the whole path [m]; inf without
            obstacles. If poses violate the rule, the value is the smallest clearance found.
        required_clearance: Required clearance at the position of `min_clearance` [m].
        at_s: Arc length of `min_clearance` [m].
        margin: Proven lower bound of clearance minus required clearance on the whole path [m]. Unlike `min_clearance`,
            the bound is not sharp, because a proof stops as soon as the rule is proven. If poses violate the rule, the
            value is the lowest value found.
        nearest: Name of the obstacle at `min_clearance`; empty without obstacles.
        max_curvature: Largest |curvature| [1/m].
        max_curvature_rate: Largest |d curvature / ds| [1/m^2].
        length: Driven distance [m].
        poses_checked: Number of poses that the proof evaluated.
        problem: Digests of the problem; the certificate is valid only for this problem.
        path: Digest of the path.
        start_relief: 0 for the strict clearance rule near the start, which requires a clearance that grows with the
            distance from the start; otherwise the distance [m] from the start within which the weaker rule permits the
            start clearance. The weaker rule is used only if the strict rule is violated.
        tube: Largest displacement of a footprint point from its planned position at which the robot has the required
            clearance [m]. It tapers at the dock like the clearance and is included in `required_clearance` (see
            `TrackingTube`).
        view_margin: Proven lower bound of the margin of the dock's marker in the camera's view, where it must be
            visible [m]; not sharp, like `margin`. If poses violate the rule, the value is the smallest margin found.
            None if the problem requires no view; inf if no part of the path requires it.
    """

    min_clearance: float
    required_clearance: float
    at_s: float
    margin: float
    nearest: str
    max_curvature: float
    max_curvature_rate: float
    length: float
    poses_checked: int
    problem: ProblemFingerprint
    path: str
    start_relief: float = 0.0
    tube: float = 0.0
    view_margin: float | None = None

    def __repr__(self) -> str:
        if not self.certified:
            return f"<Certificate: not certified, {self.reason}>"
        if not self.nearest:
            return f"<Certificate: {self.length:.3f} m certified, no obstacle>"
        closest = f"{self.min_clearance:.4f} m to {self.nearest} at s = {self.at_s:.3f} m"
        relieved = f", no more required than at the start for {self.start_relief:.2f} m" if self.start_relief else ""
        return f"<Certificate: {self.length:.3f} m certified, closest {closest}{relieved}>"

    def as_dict(self) -> dict[str, object]:
        """Return plain values for a plan file; infinities become None."""
        others = ("violations", "nearest", "poses_checked", "problem", "path", "view_margin")
        numbers = {one.name: _plain(getattr(self, one.name)) for one in fields(self) if one.name not in others}
        if self.view_margin is not None:
            numbers["view_margin"] = _plain(self.view_margin)
        return self._as_dict(
            **numbers,
            poses_checked=self.poses_checked,
            nearest=self.nearest,
            problem=self.problem._asdict(),
            path=self.path,
        )


@dataclass(frozen=True, repr=False)
class TrajectoryCertificate(_Verdict):
    """Verdict on the motion limits of a trajectory; its truth value is `certified`.

    Args:
        violations: Every violated rule; empty if certified.
        ratios: Proven upper bound of the ratio of each quantity to its limit; at most 1 + `TOLERANCE` if certified.
        duration: Total time [s].
        path: Digest of the path of the trajectory.
    """

    ratios: Mapping[str, float]
    duration: float
    path: str

    def __repr__(self) -> str:
        if not self.certified:
            return f"<TrajectoryCertificate: not certified, {self.reason}>"
        name, ratio = max(self.ratios.items(), key=lambda item: item[1], default=("nothing", 0.0))
        return f"<TrajectoryCertificate: {self.duration:.3f} s certified, {name} at {100.0 * ratio:.1f} % of its limit>"

    def as_dict(self) -> dict[str, object]:
        """Return plain values for a plan file; infinities become None."""
        ratios = {name: _plain(value) for name, value in self.ratios.items()}
        return self._as_dict(duration=self.duration, ratios=ratios, path=self.path)


def where_broken(verdict: Certificate | TrajectoryCertificate) -> Mapping[str, object]:
    """Return the data of the first violation of a verdict, as details of an error."""
    first = verdict.violations[0]
    return {"kind": first.kind, "s": first.s, "amount": first.amount, **first.where}


def _plain(value: float) -> float | None:
    return value if math.isfinite(value) else None
