"""Seeded paths for the timing benchmark: analytic curvature, and clothoid splines as from a smoother."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from experiments.benchmarks.timing_smoothed import smoothed_paths
from optdock.geometry.arrays import FloatArray, frozen_array
from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.pose import Pose2
from optdock.model.limits import MotionLimits, SpeedZone
from optdock.model.path import ClothoidSegment, Direction, Path

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


__all__ = ["Case", "GaussianSegment", "clothoid_case", "random_case", "suite"]

_MAX_CURVATURE = 2.5  # [1/m]
_POSE_SPACING = 0.005  # [m]


@dataclass(frozen=True, eq=False)
class GaussianSegment:
    """kmax tanh(g / kmax) with g a sum of Gaussians, tapered by (1 - (s / L)^6): smooth and known exactly.

    Args:
        length: [m].
        centres: Shape (n,) [m].
        widths: Standard deviations, Shape (n,) [m].
        amplitudes: Shape (n,) [1/m].
        tapered: Whether the curvature falls to 0 at the end.
        start: Pose at s = 0.
        direction: Gear.
    """

    length: float
    centres: FloatArray
    widths: FloatArray
    amplitudes: FloatArray
    tapered: bool = False
    start: Pose2 = field(default_factory=lambda: Pose2(0.0, 0.0, 0.0))
    direction: Direction = Direction.FORWARD
    poses: ClothoidSpline = field(init=False, repr=False)

    def __post_init__(self) -> None:
        s = np.linspace(0.0, self.length, max(2, int(self.length / _POSE_SPACING) + 1))
        object.__setattr__(self, "poses", ClothoidSpline(self.start, s, self.curvature_at(s), int(self.direction)))

    @property
    def knots(self) -> FloatArray:
        """Empty: the curve is smooth everywhere."""
        return frozen_array([0.0, self.length], "knots")

    def poses_at(self, s: ArrayLike) -> FloatArray:
        """Return poses of a fine clothoid spline, Shape (n, 3); the timing does not depend on poses."""
        return self.poses.poses_at(s)

    def _bumps(self, s: FloatArray) -> tuple[FloatArray, FloatArray]:
        u = (s[:, None] - self.centres) / self.widths
        bump = self.amplitudes * np.exp(-0.5 * u * u)
        return bump.sum(1), (-bump * u / self.widths).sum(1)

    def curvature_at(self, s: ArrayLike) -> FloatArray:
        """Shape (n,) [1/m]."""
        points = np.atleast_1d(np.asarray(s, dtype=np.float64))
        bent = _MAX_CURVATURE * np.tanh(self._bumps(points)[0] / _MAX_CURVATURE)
        curvature: FloatArray = bent * (1.0 - (points / self.length) ** 6) if self.tapered else bent
        return curvature

    def curvature_rate_at(self, s: ArrayLike) -> FloatArray:
        """Shape (n,) [1/m^2]."""
        points = np.atleast_1d(np.asarray(s, dtype=np.float64))
        value, slope = self._bumps(points)
        bent = np.tanh(value / _MAX_CURVATURE)
        rate = slope * (1.0 - bent * bent)
        if not self.tapered:
            return rate
        share = points / self.length
        tapered: FloatArray = rate * (1.0 - share**6) - _MAX_CURVATURE * bent * 6.0 * share**5 / self.length
        return tapered


class Case(NamedTuple):
    """One timing problem; `curves` holds the analytic curves, one per gear, if the path samples such curves."""

    name: str
    path: Path
    limits: MotionLimits
    zone: SpeedZone
    start: tuple[float, float] = (0.0, 0.0)
    curves: tuple[GaussianSegment, ...] = ()


def _limits(speed: float, rise: float, fall: float, jerk: float, turning: tuple[float, float, float]) -> MotionLimits:
    rate, yaw, lateral = turning
    return MotionLimits(
        max_speed=speed,
        max_reverse_speed=0.6 * speed,
        max_acceleration=rise,
        max_deceleration=fall,
        max_jerk=jerk,
        max_yaw_rate=rate,
        max_yaw_acceleration=yaw,
        max_lateral_acceleration=lateral,
        max_wheel_speed=1.2 * speed,
        track_width=0.5,
    )


_STANDARD = (
    _limits(0.4, 0.3, 0.4, 0.6, (0.6, 0.8, 0.4)),
    _limits(0.5, 0.5, 0.6, 2.0, (0.8, 1.5, 0.5)),
    _limits(0.6, 0.4, 0.5, 1.0, (1.0, 1.2, 0.5)),
    _limits(0.8, 0.6, 0.7, 1.5, (1.0, 2.0, 0.6)),
    _limits(1.0, 0.7, 0.7, 2.0, (1.2, 2.0, 0.8)),
)
_HARD = (
    _limits(0.8, 0.5, 0.6, 1.0, (0.4, 0.5, 0.15)),
    _limits(1.0, 0.7, 0.7, 2.0, (0.5, 0.8, 0.2)),
    _limits(1.2, 0.6, 0.8, 1.5, (0.4, 0.6, 0.25)),
)


def _gaussian_segment(
    rng: np.random.Generator, length: float, *, hard: bool, last: bool, start: Pose2, gear: int
) -> GaussianSegment:
    count = max(2, int(length * (2.0 if hard else 1.2)))
    widths = rng.uniform(0.12, 0.4 if hard else 0.8, count)
    top = 4.5 if hard else 2.5
    return GaussianSegment(
        length=length,
        centres=rng.uniform(0.0, length, count),
        widths=widths,
        amplitudes=rng.uniform(-top, top, count),
        tapered=last,
        start=start,
        direction=Direction(gear),
    )


def random_case(
    seed: int, index: int, *, hard: bool = False, length: float | None = None, gears: int | None = None
) -> Case:
    """Return one random path with limits: analytic curves, sampled, 1 to 3 gears, some starts in motion."""
    rng = np.random.default_rng((seed, index))
    total = float(rng.uniform(1.0, 12.0)) if length is None else length
    parts = int(rng.choice((1, 2, 3), p=(0.5, 0.3, 0.2))) if gears is None else gears
    shares = rng.uniform(0.5, 1.5, parts)
    pose, gear, segments = Pose2(0.0, 0.0, 0.0), int(rng.choice((1, -1))), []
    for i, part in enumerate(total * shares / shares.sum()):
        last = i == parts - 1
        segments.append(_gaussian_segment(rng, float(part), hard=hard, last=last, start=pose, gear=gear))
        pose, gear = Pose2.from_sequence(segments[-1].poses_at(part)[0]), -gear
    limits = (_HARD if hard else _STANDARD)[int(rng.integers(len(_HARD if hard else _STANDARD)))]
    zone = SpeedZone(float(rng.uniform(0.08, 0.2)), float(rng.uniform(0.2, 0.6)))
    start = (0.0, 0.0)
    if rng.random() < 0.25:
        start = (float(rng.uniform(0.02, 0.12 if hard else 0.25)), float(rng.uniform(-0.05, 0.1)))
    name, path = f"{'hard' if hard else 'std'}-{seed}-{index}", Path(tuple(_sampled(curve) for curve in segments))
    return Case(name, path, limits, zone, start, tuple(segments))


def clothoid_case(seed: int, index: int, *, length: float | None = None, hard: bool = False) -> Case:
    """Return one gear as a clothoid spline with knots 4 to 12 cm apart: the curvature rate jumps at every knot."""
    rng = np.random.default_rng((seed, index, 7))
    total = float(rng.uniform(1.0, 8.0)) if length is None else length
    steps = rng.uniform(0.04, 0.12, max(3, int(total / 0.08)))
    knots = np.concatenate(([0.0], np.cumsum(steps * total / steps.sum())))
    rough = _gaussian_segment(rng, total, hard=hard, last=True, start=Pose2(0.0, 0.0, 0.0), gear=1)
    spline = ClothoidSpline(Pose2(0.0, 0.0, 0.0), knots, rough.curvature_at(knots), int(rng.choice((1, -1))))
    limits = (_HARD if hard else _STANDARD)[int(rng.integers(len(_HARD if hard else _STANDARD)))]
    zone = SpeedZone(float(rng.uniform(0.08, 0.2)), float(rng.uniform(0.2, 0.6)))
    return Case(f"clothoid-{seed}-{index}", Path((ClothoidSegment(spline),)), limits, zone)


def _sampled(curve: GaussianSegment) -> ClothoidSegment:
    """Return the curve as a clothoid spline, knots 5 mm apart."""
    knots = np.linspace(0.0, curve.length, max(2, int(np.ceil(curve.length / _POSE_SPACING)) + 1))
    return ClothoidSegment(ClothoidSpline(curve.start, knots, curve.curvature_at(knots), curve.direction))


def suite(name: str) -> list[Case]:
    """Return a committed suite: `std` (48 paths), `hard` (24), `clothoid` (24), `smoothed` (45, by CasadiSmoother)."""
    if name == "clothoid":
        return [clothoid_case(5, i, hard=i % 2 == 1) for i in range(24)]
    if name == "hard":
        return [random_case(77, i, hard=True) for i in range(24)]
    if name == "smoothed":
        sets = (*_STANDARD, *_HARD)
        paths = enumerate(smoothed_paths().items())
        return [Case(f"smoothed-{key}", path, sets[i % len(sets)], SpeedZone(0.12, 0.4)) for i, (key, path) in paths]
    return [random_case(1, i) for i in range(48)]
