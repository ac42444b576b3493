"""What a proof says: certified, or every violation with its place and amount; and the tolerance of all proofs."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

    from optdock.geometry.fingerprint import ProblemFingerprint

__all__ = ["SHARPNESS", "TOLERANCE", "Certificate", "TrajectoryCertificate", "Violation", "where_broken"]

# What every rule accepts beyond its bound: [m], [rad], [m/s], [m/s^2], [1/m], and relative to limits. It must cover the
# rounding of arithmetic over kilometres (1e-9) and of files with six decimals, and what a solver leaves of an equation
# (1e-8). It must not be felt by any robot: sensors and drives are a thousand times as coarse.
TOLERANCE = 1e-6
# [m]: the proven minimum of the clearance is at most this far below a clearance that occurs. No plan is finer; where
# the minimum is at the dock, as it mostly is, sharpness costs nothing.
SHARPNESS = 1e-3


@dataclass(frozen=True)
class Violation:
    """One broken rule.

    Args:
        kind: Machine-readable name of the rule: `frame`, `start`, `goal`, `joint`, `direction`, `turn`, `slip`,
            `curvature`, `curvature_rate`, `start_curvature`, `final_straight`, `clearance`, `view`, `unproven`; for
            trajectories the name of the limit, `yaw_jerk`, `rest`, `coverage` or `start_state`.
        message: What is wrong, where, by how much.
        s: Arc length at which it shows [m].
        amount: How far beyond the rule, in the rule's unit; > 0.
        where: More data: pose, obstacle.
    """

    kind: str
    message: str
    s: float
    amount: float
    where: Mapping[str, object] = field(default_factory=dict)


@dataclass(frozen=True, repr=False)
class Certificate:
    """The verdict on a path; it counts as true where it is certified.

    Args:
        violations: Every broken rule; empty when certified.
        min_clearance: Proven: no point of the footprint, anywhere on the path, is closer to an obstacle [m]; inf
            without obstacles. Where poses break the rule, the smallest clearance among those found.
        required_clearance: What was required where `min_clearance` occurs [m].
        at_s: Where it occurs [m].
        margin: Proven lower bound of clearance minus required clearance along the whole path [m]. Unlike
            `min_clearance` it is not sharp: a proof ends where the rule is proven, and 0 may be the bound of a path
            that keeps centimetres more. Where poses break the rule, the worst among those found.
        nearest: Name of the obstacle there, empty without obstacles.
        max_curvature: Largest |curvature| [1/m].
        max_curvature_rate: Largest |d curvature / ds| [1/m^2].
        length: How far the path drives [m].
        poses_checked: How many poses the proof looked at.
        problem: Digests of what it was proven against; a certificate says nothing about any other problem.
        path: Digest of the path that was judged.
        start_relief: Which rule of clearance near the start it speaks of: 0 the strict one, which asks for a growing
            clearance from the start on; else the weaker one, which lets the robot keep what it has within this distance
            from the start [m]. The weaker one counts only where the strict one is broken.
        tube: How far any point of the footprint may be from where the path has it while the robot's clearance holds all
            the same [m]; it tapers at the dock as the clearance does, and `required_clearance` holds it
            (`TrackingTube`).
        view_margin: Proven lower bound, over the part of the path where the dock must be seen, of how far its marker is
            inside the camera's view [m]; it is not sharp, as `margin`. Where poses break the rule, the smallest among
            those found. None where the problem asks for no view; inf where the path has no such part.
    """

    violations: tuple[Violation, ...]
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

    def __bool__(self) -> bool:
        return self.certified

    @property
    def certified(self) -> bool:
        """Whether every rule was proven."""
        return not self.violations

    @property
    def reason(self) -> str:
        """The first violation's message, or the empty string."""
        return self.violations[0].message if self.violations else ""

    def as_dict(self) -> dict[str, object]:
        """Plain values for a plan file; infinities become None."""
        names = (
            "min_clearance",
            "required_clearance",
            "at_s",
            "margin",
            "max_curvature",
            "max_curvature_rate",
            "length",
            "start_relief",
            "tube",
        )
        numbers = {name: _plain(getattr(self, name)) for name in names}
        seen = {} if self.view_margin is None else {"view_margin": _plain(self.view_margin)}
        return {
            "certified": self.certified,
            **numbers,
            **seen,
            "poses_checked": self.poses_checked,
            "nearest": self.nearest,
            "problem": self.problem._asdict(),
            "path": self.path,
            "violations": _rows(self.violations),
        }


@dataclass(frozen=True, repr=False)
class TrajectoryCertificate:
    """The verdict on a trajectory's motion limits; it counts as true where it is certified.

    Args:
        violations: Every broken rule; empty when certified.
        ratios: Proven upper bound of each quantity over its limit; at most 1 + `TOLERANCE` when certified.
        duration: Total time [s].
        path: Digest of the path that the motion follows.
    """

    violations: tuple[Violation, ...]
    ratios: Mapping[str, float]
    duration: float
    path: str

    def __repr__(self) -> str:
        if not self.certified:
            return f"<TrajectoryCertificate: not certified, {self.reason}>"
        name, ratio = max(self.ratios.items(), key=lambda item: item[1], default=("nothing", 0.0))
        return f"<TrajectoryCertificate: {self.duration:.3f} s certified, {name} at {100.0 * ratio:.1f} % of its limit>"

    def __bool__(self) -> bool:
        return self.certified

    @property
    def certified(self) -> bool:
        """Whether every rule was proven."""
        return not self.violations

    @property
    def reason(self) -> str:
        """The first violation's message, or the empty string."""
        return self.violations[0].message if self.violations else ""

    def as_dict(self) -> dict[str, object]:
        """Plain values for a plan file; infinities become None."""
        ratios = {name: _plain(value) for name, value in self.ratios.items()}
        return {
            "certified": self.certified,
            "duration": self.duration,
            "ratios": ratios,
            "path": self.path,
            "violations": _rows(self.violations),
        }


def where_broken(verdict: Certificate | TrajectoryCertificate) -> Mapping[str, object]:
    """What an error says about the first violation of a verdict."""
    first = verdict.violations[0]
    return {"kind": first.kind, "s": first.s, "amount": first.amount, **first.where}


def _plain(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _rows(violations: tuple[Violation, ...]) -> list[dict[str, object]]:
    return [
        {"kind": v.kind, "message": v.message, "s": _plain(v.s), "amount": _plain(v.amount), "where": dict(v.where)}
        for v in violations
    ]
