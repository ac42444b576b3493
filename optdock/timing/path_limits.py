"""Path limits: what curvature and drive allow along one segment of a path, and how much of it a motion uses.

Over arc length s a segment has the curvature k(s) = dtheta/ds and its rate k'(s). With the speed v and its rate a,

    v <= min(v_max, sqrt(a_lat / |k|), w_max / |k|, v_wheel / (1 + b |k| / 2), v_zone)    the speed caps,
    v <= steering rate (1 + (L k)^2) / (L |k'|)                                           one more, of steered wheels,
    |d/dt (v^n k)| <= its bound                                                           the turning limits.

Turning limits bound what `turning_limits` is about; the yaw acceleration, n = 1, is one. The steering angle atan(L k),
L the wheelbase, turns at L k' v / (1 + (L k)^2). Its cap jumps where k' does.

The *maximum velocity curve* [Bobrow1985] [Shin1985] is the least of the caps and of the speeds beyond which no motion
at constant speed keeps a turning limit, sqrt(al / |k'|) for a yaw acceleration al. Speeds are kept as their
reciprocals, `slowness`: the largest of them counts, and a limit that is infinite vanishes.

In order: the speed caps, the limits along a segment, the dense check of a motion, and what the reference may use.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.arrays import readonly
from optdock.model.limits import LIMITS
from optdock.model.path import ClothoidSegment, Direction, PolylineSegment, TurnSegment, place_before_end
from optdock.timing.jerk_phases import DriveBounds, Motion
from optdock.timing.timing_settings import NEAR_OPTIMAL, SAMPLING, NearOptimalSettings
from optdock.timing.turning_limits import TurningLimit, turning_limits, turning_ratio

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray, IntArray
    from optdock.model.limits import MotionLimits, SpeedZone
    from optdock.model.path import Path, Segment

__all__ = [
    "KEPT",
    "NO_LENGTH",
    "LimitPoints",
    "PathLimits",
    "Ratios",
    "ReferenceBounds",
    "SpeedCaps",
    "Tightening",
    "Worst",
    "limits_along",
    "motion_ratios",
    "segment_limits",
    "worst_ratio",
]

KEPT = 1.0 + 1e-9  # rounding of a quotient that is meant to be at most 1
NO_LENGTH = 1e-11  # [m]: the knots of a shorter segment are one
_LEFT_OF_NODE = 1e-7  # of a cell: where the curvature rate to the left of a node is read


class LimitPoints(NamedTuple):
    """Shape (n,) each: curvature [1/m], curvature rate [1/m^2], slowness = 1 / speed cap [s/m]."""

    curvature: FloatArray
    rate: FloatArray
    slowness: FloatArray


@dataclass(frozen=True)
class SpeedCaps:
    """1 / speed cap as a function of curvature: the largest of the reciprocal limits, so `inf` limits vanish.

    Args:
        drive: What the drive can do.
        direction: Gear.
    """

    drive: MotionLimits
    direction: Direction

    @property
    def max_speed(self) -> float:
        """The direction's own speed limit [m/s]."""
        return self.drive.max_speed if self.direction > 0 else self.drive.max_reverse_speed

    def slowness(self, curvature: FloatArray, excess: FloatArray | float = 0.0) -> FloatArray:
        """Speed, yaw rate, lateral acceleration and both wheels' speeds, at |curvature| + excess. Shape (n,) [s/m].

        Both wheels: |v +- (b/2) v k| <= v_wheel  <=>  v (1 + b |k| / 2) <= v_wheel.
        """
        bend, drive = np.abs(curvature) + excess, self.drive
        slowness = np.maximum(1.0 / self.max_speed, bend * (1.0 / drive.max_yaw_rate))
        if np.isfinite(drive.max_lateral_acceleration):
            slowness = np.maximum(slowness, np.sqrt(bend * (1.0 / drive.max_lateral_acceleration)))
        if np.isfinite(drive.max_wheel_speed):
            slowness = np.maximum(slowness, (1.0 + 0.5 * drive.track_width * bend) / drive.max_wheel_speed)
        return slowness

    @property
    def steering(self) -> bool:
        """Whether the wheels take time to turn, so that the curvature rate caps the speed."""
        return math.isfinite(self.drive.max_steering_rate)

    def steering_slowness(self, curvature: FloatArray, rate: FloatArray) -> FloatArray:
        """Of the steering rate, at curvatures and their rates. Shape (n,) [s/m]."""
        return self.drive.steering_per_metre(curvature, rate) / self.drive.max_steering_rate

    def tightest(self, bend: float, rate: float) -> tuple[str, str]:
        """The limit that decides: its name in `MotionLimits`, and that with its value.

        Args:
            bend: |curvature| [1/m].
            rate: Curvature rate [1/m^2].
        """
        drive = self.drive
        speed = "max_speed" if self.direction > 0 else "max_reverse_speed"
        table = (
            (1.0 / self.max_speed, speed),
            (bend / drive.max_yaw_rate, "max_yaw_rate"),
            (math.sqrt(bend / drive.max_lateral_acceleration), "max_lateral_acceleration"),
            ((1.0 + 0.5 * drive.track_width * bend) / drive.max_wheel_speed, "max_wheel_speed"),
            (float(self.steering_slowness(np.array(bend), np.array(rate))), "max_steering_rate"),
        )
        _slowness, name = max(table)
        return name, f"{name} = {getattr(drive, name):.4g} {LIMITS[name].unit}"


@dataclass(frozen=True, eq=False)
class PathLimits:
    """Curvature over one segment: continuous and linear between nodes; its rate linear in a cell, jumping at nodes.

    Args:
        s: Nodes, Shape (n,) [m], n >= 2, first 0, strictly increasing, every knot and the zone start among them.
        curvature: At the nodes, Shape (n,) [1/m].
        rate_left: d curvature / ds just right of every cell's left node, Shape (n - 1,) [1/m^2].
        rate_right: Just left of every cell's right node, Shape (n - 1,) [1/m^2].
        caps: Speed caps by curvature.
        zone_start: Where the speed zone begins: exactly a node; `length` without a zone [m].
        zone_speed: Speed limit from there on [m/s].
        excess: What the speed caps add to |curvature| at the nodes, Shape (n,) [1/m]; None: nothing.
        begin: Where this begins on the whole path [m]; messages count from there.

    Attributes:
        slowness_left: 1 / speed cap just right of every cell's left node, zone not included, Shape (n - 1,) [s/m].
        slowness_right: Just left of every cell's right node, Shape (n - 1,) [s/m].
        steepest: The larger |rate| of every cell, Shape (n - 1,) [1/m^2].
        turning: The drive's turning limits.
        length: [m].
        duration_estimate: Along the maximum velocity curve, or from rest to rest under acceleration or jerk alone: the
            longest. Never more than a fraction above the true duration [s].
    """

    s: FloatArray
    curvature: FloatArray
    rate_left: FloatArray
    rate_right: FloatArray
    caps: SpeedCaps
    zone_start: float
    zone_speed: float
    excess: FloatArray | None = None
    begin: float = 0.0
    slowness_left: FloatArray = field(init=False, repr=False)
    slowness_right: FloatArray = field(init=False, repr=False)
    steepest: FloatArray = field(init=False, repr=False)
    turning: tuple[TurningLimit, ...] = field(init=False, repr=False)
    length: float = field(init=False)
    duration_estimate: float = field(init=False)

    def __post_init__(self) -> None:
        slowness = self.caps.slowness(self.curvature, 0.0 if self.excess is None else self.excess)
        left, right = slowness[:-1], slowness[1:]
        if self.caps.steering:
            first, last = self.curvature[:-1], self.curvature[1:]
            crosses = first * last < 0.0  # in a cell that goes through straight on, the wheels turn fastest there
            left = np.maximum(left, self.caps.steering_slowness(np.where(crosses, 0.0, first), self.rate_left))
            right = np.maximum(right, self.caps.steering_slowness(np.where(crosses, 0.0, last), self.rate_right))
        object.__setattr__(self, "slowness_left", readonly(left))
        object.__setattr__(self, "slowness_right", readonly(right))
        steepest = np.maximum(np.abs(self.rate_left), np.abs(self.rate_right))
        object.__setattr__(self, "steepest", readonly(steepest))
        object.__setattr__(self, "turning", turning_limits(self.drive))
        length, drive = float(self.s[-1]), self.drive
        object.__setattr__(self, "length", length)
        along_curve = float(np.sum(np.diff(self.s) * self.maximum_velocity_curve()))
        by_drive = math.sqrt(2.0 * length * (1.0 / drive.max_acceleration + 1.0 / drive.max_deceleration))
        by_jerk = math.exp(math.log(32.0 * length / drive.max_jerk) / 3.0)
        object.__setattr__(self, "duration_estimate", max(along_curve, by_drive, by_jerk))

    @property
    def drive(self) -> MotionLimits:
        """What the drive can do."""
        return self.caps.drive

    @property
    def drive_bounds(self) -> DriveBounds:
        """The drive's own bounds, whatever the path."""
        drive = self.drive
        return DriveBounds(self.caps.max_speed, drive.max_acceleration, drive.max_deceleration, drive.max_jerk)

    @property
    def fastest(self) -> float:
        """The largest of the speed caps [m/s]."""
        return 1.0 / min(float(self.slowness_left.min()), float(self.slowness_right.min()))

    @property
    def has_zone(self) -> bool:
        """Whether the speed zone reaches into this segment."""
        return self.zone_start < self.length

    def maximum_velocity_curve(self, turning_share: float = 1.0) -> FloatArray:
        """Slowness of the maximum velocity curve over every cell, the zone included. Shape (n - 1,) [s/m].

        Args:
            turning_share: Of the turning limits that the curvature rate may use.
        """
        slowness = np.maximum(self.slowness_left, self.slowness_right)
        if self.has_zone:
            slow = self.s[1:] > self.zone_start + 1e-12
            slowness = np.where(slow, np.maximum(slowness, 1.0 / self.zone_speed), slowness)
        for limit in self.turning:
            slowness = np.maximum(slowness, limit.slowness(self.steepest, turning_share))
        return slowness

    def cells_at(self, s: FloatArray) -> IntArray:
        """Index of the cell that holds each point, Shape (n,)."""
        found: IntArray = np.searchsorted(self.s, s, side="right") - 1
        cells: IntArray = np.minimum(np.maximum(found, 0), self.s.size - 2)
        return cells

    def points_at(self, s: FloatArray) -> LimitPoints:
        """Everything at arc lengths `s`, Shape (n,) [m]; the right side at nodes. Slowness includes the zone."""
        cell = self.cells_at(s)
        left = self.s[cell]
        share = (s - left) / (self.s[cell + 1] - left)
        curvature = self.curvature[cell] + share * (self.curvature[cell + 1] - self.curvature[cell])
        rate = self.rate_left[cell] + share * (self.rate_right[cell] - self.rate_left[cell])
        excess = 0.0 if self.excess is None else np.interp(s, self.s, self.excess)
        slowness = self.caps.slowness(curvature, excess)
        if self.caps.steering:
            slowness = np.maximum(slowness, self.caps.steering_slowness(curvature, rate))
        if self.has_zone:
            slowness = np.where(s >= self.zone_start, np.maximum(slowness, 1.0 / self.zone_speed), slowness)
        return LimitPoints(curvature, rate, slowness)

    def cap_at(self, s: float) -> tuple[str, str]:
        """The speed cap that decides at `s` [m]: the name of its limit, and that with its value."""
        point = self.points_at(np.array([s]))
        name, words = self.caps.tightest(abs(float(point.curvature[0])), float(point.rate[0]))
        zone = self.has_zone and s >= self.zone_start and float(point.slowness[0]) <= 1.0 / self.zone_speed
        return ("approach_speed", f"approach_speed = {self.zone_speed:.4g} m/s") if zone else (name, words)

    def turning_limit_at(self, s: float, v: float, a: float) -> TurningLimit:
        """The turning limit, of those that there are, of which a motion uses most at `s` [m]."""
        point, (speed, gain) = self.points_at(np.array([s])), np.array([[v], [a]])
        return max(self.turning, key=lambda one: float(one.ratio(point.curvature, point.rate, speed, gain)[0]))

    def after(self, start: float) -> PathLimits:
        """What is left from `start` [m] on, 0 <= start < length, renumbered from 0."""
        if start <= 0.0:
            return self
        cell = int(self.cells_at(np.array([start]))[0])
        if self.s[cell + 1] - start <= 1e-12:
            cell += 1
        point = self.points_at(np.array([start]))
        keep = slice(cell + 1, None)
        zone_start = self.zone_start - start if self.zone_start > self.s[cell] else 0.0
        return PathLimits(
            s=readonly(np.concatenate(([0.0], self.s[keep] - start))),
            curvature=readonly(np.concatenate((point.curvature, self.curvature[keep]))),
            rate_left=readonly(np.concatenate((point.rate, self.rate_left[keep]))),
            rate_right=self.rate_right[cell:],
            caps=self.caps,
            zone_start=max(0.0, zone_start),
            zone_speed=self.zone_speed,
            excess=None if self.excess is None else np.append(np.interp(start, self.s, self.excess), self.excess[keep]),
            begin=self.begin + start,
        )


def limits_along(path: Path, drive: MotionLimits, zone: SpeedZone) -> list[PathLimits | None]:
    """The limits of every segment of a path; None for a segment of no length, and for a turn in place."""
    zone_start = (
        place_before_end(path, zone.distance) if zone.distance > 0.0 and math.isfinite(zone.speed) else math.inf
    )
    return [
        segment_limits(
            segment, SpeedCaps(drive, segment.direction), zone_start - float(begin), zone.speed, float(begin)
        )
        if segment.length > NO_LENGTH and not isinstance(segment, TurnSegment)
        else None
        for segment, begin in zip(path.segments, path.segment_starts[:-1], strict=True)
    ]


def segment_limits(
    segment: Segment, caps: SpeedCaps, zone_start: float, zone_speed: float, begin: float = 0.0
) -> PathLimits:
    """The limits along one segment.

    Args:
        segment: Clothoid spline or polyline.
        caps: Speed caps by curvature.
        zone_start: Where the speed zone begins in this segment; at or beyond its length: not here [m].
        zone_speed: Speed limit from there on [m/s].
        begin: Where the segment begins on the whole path [m].
    """
    exact = isinstance(segment, ClothoidSegment)
    spacing = SAMPLING.clothoid_spacing if exact else SAMPLING.polyline_spacing
    zone_start = min(max(zone_start, 0.0), segment.length)
    s = _nodes(segment, max(spacing, segment.length / SAMPLING.most_nodes), zone_start)
    zone_start = float(s[np.argmin(np.abs(s - zone_start))])  # of a knot and a zone within rounding one node is left
    cells = np.diff(s)
    return PathLimits(
        s=readonly(s),
        curvature=readonly(segment.curvature_at(s)),
        rate_left=readonly(_rates(segment, s[:-1], s[:-1] + 0.5 * cells)),
        rate_right=readonly(_rates(segment, s[1:] - _LEFT_OF_NODE * cells, s[:-1] + 0.5 * cells)),
        caps=caps,
        zone_start=zone_start,
        zone_speed=zone_speed,
        excess=_step_excess(segment, s) if isinstance(segment, PolylineSegment) else None,
        begin=begin,
    )


def _rates(segment: Segment, s: FloatArray, middles: FloatArray) -> FloatArray:
    """Curvature rates at `s`, each in the cell around one of the `middles`, Shape (n,) [1/m^2].

    A polyline's curvature may swing from step to step faster than its means at the poses tell; `certify_trajectory`
    judges that as well.
    """
    rates = segment.curvature_rate_at(s)
    if not isinstance(segment, PolylineSegment):
        return rates
    swing = segment.step_swing[
        np.clip(np.searchsorted(segment.knots, middles, side="right") - 1, 0, len(segment.poses) - 2)
    ]
    faster: FloatArray = np.copysign(np.maximum(np.abs(rates), swing), rates)
    return faster


def _step_excess(segment: PolylineSegment, s: FloatArray) -> FloatArray:
    """By how much the curvature of the steps exceeds that between the poses, which is their mean. Shape (n,) [1/m].

    A coarse polyline turns a whole step at the step's curvature; `certify_trajectory` judges it so.
    """
    steps = np.abs(segment.step_curvature)
    at_poses = np.maximum(np.append(steps, 0.0), np.insert(steps, 0, 0.0))
    excess: FloatArray = np.maximum(np.interp(s, segment.knots, at_poses) - np.abs(segment.curvature_at(s)), 0.0)
    return excess


def _nodes(segment: Segment, spacing: float, zone_start: float) -> FloatArray:
    """The segment's knots and the zone start, with equal steps of at most `spacing` between them."""
    knots = np.union1d(segment.knots, [zone_start])
    knots = knots[np.concatenate(([True], np.diff(knots) > 1e-12 * max(1.0, segment.length)))]
    knots[-1] = segment.length
    steps = np.diff(knots)
    parts = np.maximum(1, np.ceil(steps / spacing - 1e-9)).astype(np.int64)
    owner = np.repeat(np.arange(steps.size), parts)
    rank = np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)
    return np.append(knots[owner] + steps[owner] * rank / parts[owner], knots[-1])


class Worst(NamedTuple):
    """The largest quotient of a quantity and its limit, where it occurs, and what it means for time.

    Args:
        ratio: Largest quotient.
        s: Where [m].
        path: Factor on time that keeps speeds and turning limits, which depend on the path.
        drive: Factor on time that keeps acceleration and jerk.
        limit: Name of the limit where the ratio is above 1; empty where it is not.
    """

    ratio: float
    s: float
    path: float
    drive: float
    limit: str = ""

    @property
    def stretch(self) -> float:
        """Factor on time that keeps every limit: speeds fall with its first power, accelerations with its second."""
        return max(self.path, self.drive)

    def words(self, begin: float) -> str:
        """What is broken, by how much and where on the path, where the segment begins at `begin` [m]."""
        return f"{self.ratio:.6g} times {self.limit or 'a limit'} at s = {begin + self.s:.4f} m"


class Ratios(NamedTuple):
    """Quotients of quantities and limits at distances `s`, Shape (n,); lateral acceleration as its root.

    `turning` is that of `turning_ratio`; `drive` is of the acceleration at the first of these distances only: it is
    linear between them.
    """

    s: FloatArray
    speed: FloatArray
    turning: FloatArray
    drive: FloatArray


def motion_ratios(limits: PathLimits, motion: Motion, times: FloatArray | None = None) -> Ratios:
    """All limits at time samples, at phase borders, and at every node with the rates on both its sides.

    Between nodes curvature and its rate are linear and the motion is smooth, so the maxima sit at the nodes up to the
    time sampling; time samples alone would miss narrow features. At the nodes speed and acceleration are interpolated
    between time samples, wrong by at most period^2 * jerk / 8. Jerk is the caller's: it is the phases themselves.
    """
    t = motion.sample_times(SAMPLING.check_period) if times is None else times
    s, v, a = motion.at(t)
    s = np.minimum(np.maximum.accumulate(s), limits.length)
    inner, drive = limits.s[1:-1], limits.drive
    first, last = np.searchsorted(inner, (s[0], s[-1]))
    nodes = inner[first:last]
    node_v, node_a = np.interp(nodes, s, v), np.interp(nodes, s, a)
    points = limits.points_at(s)
    slowness = limits.slowness_left[1:][first:last]
    if limits.caps.steering:
        slowness = np.maximum(slowness, limits.slowness_right[:-1][first:last])
    if limits.has_zone:
        slowness = np.where(nodes >= limits.zone_start, np.maximum(slowness, 1.0 / limits.zone_speed), slowness)
    curvature = limits.curvature[1:-1][first:last]
    left = turning_ratio(limits.turning, curvature, limits.rate_right[:-1][first:last], node_v, node_a)
    right = turning_ratio(limits.turning, curvature, limits.rate_left[1:][first:last], node_v, node_a)
    turning = turning_ratio(limits.turning, points.curvature, points.rate, v, a)
    return Ratios(
        s=np.concatenate((s, nodes)),
        speed=np.concatenate((v * points.slowness, node_v * slowness)),
        turning=np.concatenate((turning, np.maximum(left, right))),
        drive=np.maximum(a * (1.0 / drive.max_acceleration), a * (-1.0 / drive.max_deceleration)),
    )


def worst_ratio(limits: PathLimits, motion: Motion, times: FloatArray | None = None) -> Worst:
    """The worst of all limits along a motion, jerk included; at `times`, Shape (n,) [s], instead of the usual ones."""
    ratios = motion_ratios(limits, motion, times)
    largest = np.maximum(ratios.speed, ratios.turning)
    np.maximum(largest[: ratios.drive.size], ratios.drive, out=largest[: ratios.drive.size])
    worst = int(np.argmax(largest))
    steepest = int(np.argmax(np.abs(motion.jerks)))
    jerk = abs(float(motion.jerks[steepest])) / limits.drive.max_jerk
    path = max(float(ratios.speed.max()), math.sqrt(float(ratios.turning.max())))
    drive = max(math.sqrt(max(0.0, float(ratios.drive.max()))), jerk ** (1.0 / 3.0))
    if jerk > largest[worst] * KEPT:
        return Worst(jerk, float(motion.states[0, steepest]), path, drive, "max_jerk" if jerk > 1.0 else "")
    limit = _limit_name(limits, motion, ratios, worst) if largest[worst] > 1.0 else ""
    return Worst(float(largest[worst]), float(ratios.s[worst]), path, drive, limit)


def _limit_name(limits: PathLimits, motion: Motion, ratios: Ratios, k: int) -> str:
    """The limit of which the k-th quotients, the largest of all, use most."""
    if k < ratios.drive.size and ratios.drive[k] >= max(ratios.speed[k], ratios.turning[k]):
        rising = float(motion.states[2].max()) / limits.drive.max_acceleration >= ratios.drive[k] * (1.0 - 1e-9)
        return "max_acceleration" if rising else "max_deceleration"
    s = float(ratios.s[k])
    if ratios.turning[k] >= ratios.speed[k] and limits.turning:
        _s, v, a = motion.at(motion.crossing_times(np.array([s])))
        return limits.turning_limit_at(s, float(v[0]), float(a[0])).name
    return limits.cap_at(s)[0]


class Tightening(NamedTuple):
    """A stretch [m] in which speeds are to be smaller by `factor` than the limits allow."""

    left: float
    right: float
    factor: float


@dataclass(frozen=True, eq=False)
class ReferenceBounds:
    """The limits of a segment less margins: what the reference may use per cell, and what moves are checked against.

    Args:
        limits: The segment's.
        settings: Of the near-optimal method; its margins are what is left unused.
        relief: Up to this distance no margin is taken: full braking from a moving start leaves none [m].
        tightenings: Stretches to take slower.

    Attributes:
        speed_squared: Bound on v^2 in each cell, for the reference, Shape (n - 1,) [m^2/s^2].
        turning: Bounds of the turning limits in each cell, for the reference, Shape (n - 1,) each.
        cap_squared: v^2 at which a cell meets its speed caps, no margin, Shape (n - 1,) [m^2/s^2].
        jumps: Indices of the inner nodes where the curvature rate jumps by so much that it matters, for the yaw
            acceleration or for the cap of the steering rate.
    """

    limits: PathLimits
    settings: NearOptimalSettings = NEAR_OPTIMAL
    relief: float = 0.0
    tightenings: tuple[Tightening, ...] = ()
    speed_squared: FloatArray = field(init=False, repr=False)
    turning: tuple[FloatArray, ...] = field(init=False, repr=False)
    cap_squared: FloatArray = field(init=False, repr=False)
    jumps: IntArray = field(init=False, repr=False)
    _left: FloatArray = field(init=False, repr=False)
    _slope: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        limits, margins = self.limits, self.settings.margins
        left, right = limits.slowness_left, limits.slowness_right
        if limits.has_zone:
            slow = np.where(limits.s[:-1] >= limits.zone_start, 1.0 / limits.zone_speed, 0.0)
            left, right = np.maximum(left, slow), np.maximum(right, slow)
        table = np.stack((limits.curvature[:-1], limits.rate_left, left))
        ends = np.stack((limits.curvature[1:], limits.rate_right, right))
        relieved = limits.s[:-1] < self.relief
        factor = self._factors()
        cap = np.maximum(left, right) ** -2.0
        speed = (factor * np.where(relieved, 1.0 - margins.relieved_speed, 1.0 - margins.speed)) ** 2
        turning = factor**2 * np.where(relieved, 1.0 - margins.relieved_yaw, 1.0 - margins.yaw)
        jump, least = np.abs(limits.rate_left[1:] - limits.rate_right[:-1]), np.minimum(cap[1:], cap[:-1])
        large = np.zeros(jump.size, dtype=np.bool_)
        for limit in limits.turning:
            large |= limit.at_constant_speed(least, jump) > margins.jump * limit.bound
        jumps = np.flatnonzero(large) + 1
        if limits.caps.steering:
            jumps = np.union1d(jumps, np.flatnonzero(np.abs(left[1:] / right[:-1] - 1.0) > margins.cap_jump) + 1)
        object.__setattr__(self, "jumps", jumps)
        object.__setattr__(self, "turning", tuple(readonly(limit.bounds(turning)) for limit in limits.turning))
        for name, value in (
            ("cap_squared", cap),
            ("speed_squared", cap * speed),
            ("_left", table),
            ("_slope", (ends - table) / np.diff(limits.s)),
        ):
            object.__setattr__(self, name, readonly(value))

    def _factors(self) -> FloatArray:
        s = self.limits.s
        factor: FloatArray = np.ones(s.size - 1)
        for stretch in self.tightenings:
            inside = (s[1:] > stretch.left) & (s[:-1] < stretch.right)
            factor = np.where(inside, np.minimum(factor, stretch.factor), factor)
        return factor

    @property
    def jerk(self) -> float:
        """Bound on the jerk in the reference [m/s^3]."""
        return self.limits.drive.max_jerk * (1.0 - self.settings.margins.jerk)

    def curve_at(self, s: FloatArray) -> FloatArray:
        """Curvature, its rate, and slowness, linear in each cell. Shape (3, n)."""
        cell = self.limits.cells_at(s)
        values: FloatArray = self._left[:, cell] + self._slope[:, cell] * (s - self.limits.s[cell])
        return values

    def excess_at(self, s: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        """By how much time would have to be stretched there for the checked limits to hold; > 1 is too fast.

        Shape (n,). Speeds scale with 1 / c, accelerations with 1 / c^2.
        """
        curvature, rate, slowness = self.curve_at(s)
        turning = turning_ratio(self.limits.turning, curvature, rate, v, a)
        return self._checked(s, np.maximum(v * slowness, np.sqrt(turning)))

    def jump_excess_at(self, nodes: IntArray, v: FloatArray, a: FloatArray) -> FloatArray:
        """As `excess_at`, at `nodes`, of what the rates on both their sides limit. Shape (n,)."""
        limits, curvature = self.limits, self.limits.curvature[nodes]
        sides = (limits.rate_right[nodes - 1], limits.rate_left[nodes])
        left, right = (turning_ratio(limits.turning, curvature, rate, v, a) for rate in sides)
        excess = np.sqrt(np.maximum(left, right))
        if limits.caps.steering:
            excess = np.maximum(excess, v * np.maximum(limits.slowness_right[nodes - 1], limits.slowness_left[nodes]))
        return self._checked(limits.s[nodes], excess)

    def _checked(self, s: FloatArray, excess: FloatArray) -> FloatArray:
        share = 1.0 / (1.0 - self.settings.margins.check)
        return excess * (np.where(s < self.relief, 1.0, share) if self.relief > 0.0 else share)
