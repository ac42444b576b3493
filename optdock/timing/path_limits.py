"""Path limits: bounds on the motion along one segment, derived from its curvature and the limits of the drive.

A segment has the curvature k(s) = dtheta/ds over arc length s, with the rate k'(s). With the speed v and its rate a,

    v <= min(v_max, sqrt(a_lat / |k|), w_max / |k|, v_wheel / (1 + b |k| / 2), v_zone)    the speed caps,
    v <= steering rate (1 + (L k)^2) / (L |k'|)                                           the cap of steered wheels,
    |d/dt (v^n k)| <= its bound                                                           the turning limits.

The turning limits are defined in `turning_limits`. The steering angle atan(L k), L the wheelbase, changes at the rate L
k' v / (1 + (L k)^2); the cap is discontinuous where k' is.

The *maximum velocity curve* [Bobrow1985] [Shin1985] is the minimum of the caps and of the speeds above which no motion
at constant speed satisfies a turning limit; for a limit al on the yaw acceleration this speed is sqrt(al / |k'|).
Speeds are stored as their reciprocals, `slowness`: the largest reciprocal is the limit, and an infinite limit is zero.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.arrays import readonly
from optdock.model.limits import LIMITS
from optdock.model.path import ClothoidSegment, Direction, PolylineSegment, TurnSegment, place_before_end
from optdock.timing.jerk_phases import DriveBounds
from optdock.timing.turning_limits import TurningLimit, turning_limits, turning_ratio

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray, IntArray
    from optdock.model.limits import MotionLimits, SpeedZone
    from optdock.model.path import Path, Segment

__all__ = [
    "CHECK_MARGIN",
    "KNOT_STEP",
    "NO_LENGTH",
    "SPEED_MARGIN",
    "LimitPoints",
    "PathLimits",
    "ReferenceBounds",
    "SpeedCaps",
    "Tightening",
    "limits_along",
    "segment_limits",
]

NO_LENGTH = 1e-11  # [m]: a shorter segment has no limits
_CLOTHOID_SPACING = 0.005  # [m], between nodes: clothoids are represented exactly between them
_POLYLINE_SPACING = 0.002  # [m], between nodes of a polyline
_MOST_NODES = 6000  # per segment
_LEFT_OF_NODE = 1e-7  # share of a cell: place where the curvature rate to the left of a node is evaluated

KNOT_STEP = 0.08  # [s]: knot spacing of the reference
# Shares of the limits that the near-optimal method does not use. These constants, and constants in other modules for
# which no reason is given, were tuned with `python -m experiments.benchmarks timing`, for duration over optimum, the
# CPU time and the number of paths that violate a limit.
SPEED_MARGIN = 0.003  # share of the speed caps, in the reference: allows for the corners that ruckig cuts
_YAW_MARGIN = 0.02  # share of the yaw acceleration; for other turning limits in powers of the speed
_JERK_MARGIN = 0.015
CHECK_MARGIN = 0.001  # share of the speed caps when moves are accepted; for the yaw acceleration twice this share
_RELIEVED_SPEED, _RELIEVED_YAW = 1e-4, 1e-3  # used where full braking from a moving start permits no margins
_JUMP = 0.004  # share of the yaw acceleration: the margins cover smaller jumps of v^2 * rate
_NONE = readonly(np.zeros(0, dtype=np.int64))
_CAP_JUMP = 0.001  # share of a speed cap: the margins cover smaller jumps of the steering cap


class LimitPoints(NamedTuple):
    """Curvature [1/m], curvature rate [1/m^2], slowness = 1 / speed cap [s/m], Shape (n,) each."""

    curvature: FloatArray
    rate: FloatArray
    slowness: FloatArray


@dataclass(frozen=True)
class SpeedCaps:
    """Speed caps as a function of curvature, as their reciprocals; `direction` is the gear."""

    drive: MotionLimits
    direction: Direction
    max_speed: float = field(init=False)  # speed limit of the gear [m/s]
    steering: bool = field(
        init=False
    )  # whether the steering rate is limited, so that the curvature rate caps the speed

    def __post_init__(self) -> None:
        drive = self.drive
        top = drive.max_speed if self.direction > 0 else drive.max_reverse_speed
        vars(self).update(max_speed=top, steering=math.isfinite(drive.max_steering_rate))

    def slowness(self, curvature: FloatArray, excess: FloatArray | float = 0.0) -> FloatArray:
        """Return the reciprocal of the lowest speed cap at |curvature| + excess, without the steering cap. Shape (n,).

        Limit of both wheels: |v +- (b/2) v k| <= v_wheel  <=>  v (1 + b |k| / 2) <= v_wheel.
        """
        bend, drive = np.abs(curvature) + excess, self.drive
        slowness = np.maximum(1.0 / self.max_speed, bend * (1.0 / drive.max_yaw_rate))
        if math.isfinite(drive.max_lateral_acceleration):
            slowness = np.maximum(slowness, np.sqrt(bend * (1.0 / drive.max_lateral_acceleration)))
        if math.isfinite(drive.max_wheel_speed):
            slowness = np.maximum(slowness, (1.0 + 0.5 * drive.track_width * bend) / drive.max_wheel_speed)
        return slowness

    def steering_slowness(self, curvature: FloatArray, rate: FloatArray) -> FloatArray:
        """Return the reciprocal of the largest speed that the steering rate permits at each curvature and its rate.

        Shape (n,) [s/m].
        """
        return self.drive.steering_per_metre(curvature, rate) / self.drive.max_steering_rate

    def tightest(self, bend: float, rate: float) -> str:
        """Return the name of the lowest cap at a |curvature| [1/m] and a curvature rate [1/m^2]."""
        drive = self.drive
        table = (
            (1.0 / self.max_speed, "max_speed" if self.direction > 0 else "max_reverse_speed"),
            (bend / drive.max_yaw_rate, "max_yaw_rate"),
            (math.sqrt(bend / drive.max_lateral_acceleration), "max_lateral_acceleration"),
            ((1.0 + 0.5 * drive.track_width * bend) / drive.max_wheel_speed, "max_wheel_speed"),
            (float(self.steering_slowness(np.array(bend), np.array(rate))), "max_steering_rate"),
        )
        return max(table)[1]


@dataclass(eq=False)
class PathLimits:
    """Limits along one segment. The curvature is linear between nodes; its rate is linear in a cell and jumps at nodes.

    Attributes:
        drive: Limits of the drive.
        slowness_left: 1 / speed cap just to the right of every cell's left node, without the zone, Shape (n - 1,)
        [s/m].
        slowness_right: The same just to the left of every cell's right node, Shape (n - 1,) [s/m].
        steepest: The larger |rate| of every cell, Shape (n - 1,) [1/m^2].
        turning: Turning limits of the drive.
        turning_rows: Number of linear rows, and of rows with the speed, of the reference program.
        turning_numbers: Orders and bounds of two turning limits, for kernels.
        length: Length of the segment [m].
        duration_estimate: Longest of three approximate lower bounds [s]: along the maximum velocity curve, from rest to
            rest under only the acceleration limit, and from rest to rest under only the jerk limit.
    """

    s: FloatArray  # nodes, Shape (n,) [m], n >= 2, from 0, strictly increasing, with every knot and the zone start
    curvature: FloatArray  # at the nodes, Shape (n,) [1/m]
    rate_left: FloatArray  # d curvature / ds just to the right of every cell's left node, Shape (n - 1,) [1/m^2]
    rate_right: FloatArray  # the same just to the left of every cell's right node, Shape (n - 1,) [1/m^2]
    caps: SpeedCaps
    zone_start: float  # start of the speed zone, exactly a node; `length` if there is no zone [m]
    zone_speed: float  # speed limit in the zone [m/s]
    excess: FloatArray | None = None  # addition to |curvature| at the nodes, for the caps, Shape (n,) [1/m]; None: zero
    begin: float = 0.0  # start of this segment on the whole path, for messages [m]

    def __post_init__(self) -> None:
        self.drive = drive = self.caps.drive
        slowness = self.caps.slowness(self.curvature, 0.0 if self.excess is None else self.excess)
        left, right = slowness[:-1], slowness[1:]
        if self.caps.steering:
            first, last = self.curvature[:-1], self.curvature[1:]
            crosses = first * last < 0.0  # the steering rate of a cell is largest at zero curvature
            left = np.maximum(left, self.caps.steering_slowness(np.where(crosses, 0.0, first), self.rate_left))
            right = np.maximum(right, self.caps.steering_slowness(np.where(crosses, 0.0, last), self.rate_right))
        self.slowness_left, self.slowness_right = readonly(left), readonly(right)
        self.steepest = readonly(np.maximum(np.abs(self.rate_left), np.abs(self.rate_right)))
        self.turning = turning_limits(drive)
        second = len([one for one in self.turning if one.order == 2])
        self.turning_rows = 3 + 4 * (len(self.turning) - second), 2 + 4 * second
        orders, bounds = [float(one.order) for one in self.turning], [one.bound for one in self.turning]
        self.turning_numbers = (*orders, 0.0, 0.0)[:2] + (*bounds, math.inf, math.inf)[:2]
        self.length = length = float(self.s[-1])
        along_curve = float(((self.s[1:] - self.s[:-1]) * self.maximum_velocity_curve()).sum())
        by_drive = math.sqrt(2.0 * length * (1.0 / drive.max_acceleration + 1.0 / drive.max_deceleration))
        by_jerk = math.exp(math.log(32.0 * length / drive.max_jerk) / 3.0)
        self.duration_estimate = max(along_curve, by_drive, by_jerk)

    @property
    def drive_bounds(self) -> DriveBounds:
        """Bounds of the drive, independent of the path."""
        drive = self.drive
        return DriveBounds(self.caps.max_speed, drive.max_acceleration, drive.max_deceleration, drive.max_jerk)

    @property
    def fastest(self) -> float:
        """Largest speed cap [m/s]."""
        return 1.0 / min(float(self.slowness_left.min()), float(self.slowness_right.min()))

    @property
    def has_zone(self) -> bool:
        """Whether the speed zone begins in this segment."""
        return self.zone_start < self.length

    def maximum_velocity_curve(self, turning_share: float = 1.0) -> FloatArray:
        """Return the slowness of the maximum velocity curve, with the speed zone, per cell. Shape (n - 1,) [s/m].

        The curvature rate may use `turning_share` of the turning limits.
        """
        slowness = np.maximum(self.slowness_left, self.slowness_right)
        if self.has_zone:
            slow = self.s[1:] > self.zone_start + 1e-12
            slowness = np.where(slow, np.maximum(slowness, 1.0 / self.zone_speed), slowness)
        for limit in self.turning:
            slowness = np.maximum(slowness, limit.slowness(self.steepest, turning_share))
        return slowness

    def cells_at(self, s: FloatArray) -> IntArray:
        """Return the index of the cell of each point, Shape (n,)."""
        found: IntArray = self.s.searchsorted(s, side="right") - 1
        cells: IntArray = np.minimum(np.maximum(found, 0), self.s.size - 2)
        return cells

    def points_at(self, s: FloatArray) -> LimitPoints:
        """Return the limits at arc lengths `s`, Shape (n,) [m], with the zone; at nodes, the right-hand limits."""
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
        """Return the name of the limit with the lowest speed cap at `s` [m], and a text with the name and the value."""
        point = self.points_at(np.array([s]))
        if self.has_zone and s >= self.zone_start and float(point.slowness[0]) <= 1.0 / self.zone_speed:
            return "approach_speed", f"approach_speed = {self.zone_speed:.4g} m/s"
        name = self.caps.tightest(abs(float(point.curvature[0])), float(point.rate[0]))
        return name, f"{name} = {getattr(self.drive, name):.4g} {LIMITS[name].unit}"

    def turning_limit_at(self, s: float, v: float, a: float) -> TurningLimit:
        """Return the turning limit with the largest ratio at `s` [m]."""
        point, (speed, gain) = self.points_at(np.array([s])), np.array([[v], [a]])
        return max(self.turning, key=lambda one: float(one.ratio(point.curvature, point.rate, speed, gain)[0]))

    def after(self, start: float) -> PathLimits:
        """Return the limits beyond `start` [m], 0 <= start < length, with arc lengths from 0."""
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
    """Return the limits of every segment of a path; None for a segment of zero length and for a turn in place."""
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
    """Return the limits along one segment.

    Args:
        segment: Clothoid spline or polyline.
        caps: Speed caps as a function of curvature.
        zone_start: Start of the speed zone in this segment [m]; if it is at or beyond the length, there is no zone.
        zone_speed: Speed limit in the zone [m/s].
        begin: Start of the segment on the whole path [m].
    """
    spacing = _CLOTHOID_SPACING if isinstance(segment, ClothoidSegment) else _POLYLINE_SPACING
    length = segment.length
    zone_start = min(max(zone_start, 0.0), length)
    s = _nodes(segment.knots, length, max(spacing, length / _MOST_NODES), zone_start)
    zone_start = float(s[np.abs(s - zone_start).argmin()])  # the nearest node replaces the zone start
    cells = s[1:] - s[:-1]
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
    """Return the curvature rates at `s`; for a polyline at least the rate of its oscillation. Shape (n,) [1/m^2]."""
    rates = segment.curvature_rate_at(s)
    if not isinstance(segment, PolylineSegment):
        return rates
    swing = segment.step_swing[
        np.clip(np.searchsorted(segment.knots, middles, side="right") - 1, 0, len(segment.poses) - 2)
    ]
    faster: FloatArray = np.copysign(np.maximum(np.abs(rates), swing), rates)
    return faster


def _step_excess(segment: PolylineSegment, s: FloatArray) -> FloatArray:
    """Return the curvature of the steps, as in `certify_trajectory`, minus the mean between the poses [1/m]."""
    steps = np.abs(segment.step_curvature)
    at_poses = np.maximum(np.append(steps, 0.0), np.insert(steps, 0, 0.0))
    excess: FloatArray = np.maximum(np.interp(s, segment.knots, at_poses) - np.abs(segment.curvature_at(s)), 0.0)
    return excess


def _nodes(knots: FloatArray, length: float, spacing: float, zone_start: float) -> FloatArray:
    """Return the segment's knots and the zone start, with equal steps of at most `spacing` between them."""
    knots = np.concatenate((knots, [zone_start]))
    knots.sort()
    keep = np.empty(knots.size, dtype=np.bool_)
    keep[0] = True
    keep[1:] = knots[1:] - knots[:-1] > 1e-12 * max(1.0, length)
    knots = knots[keep]
    knots[-1] = length
    steps = knots[1:] - knots[:-1]
    parts = np.maximum(1, np.ceil(steps / spacing - 1e-9)).astype(np.int64)
    owner = np.arange(steps.size).repeat(parts)
    rank = np.arange(owner.size) - (parts.cumsum() - parts).repeat(parts)
    return np.concatenate((knots[owner] + steps[owner] * rank / parts[owner], knots[-1:]))


class Tightening(NamedTuple):
    """Interval [m] in which speeds must be reduced by `factor` below the limits."""

    left: float
    right: float
    factor: float


@dataclass(eq=False)
class ReferenceBounds:
    """Limits of a segment, reduced by margins: bounds per cell for the reference, and bounds for the moves along it.

    Attributes:
        speed_squared: Bound on v^2 in each cell for the reference, Shape (n - 1,) [m^2/s^2].
        turning: Turning limits in each cell for the reference, Shape (n - 1,) each.
        cap_squared: v^2 of the speed caps of a cell, without margin, Shape (n - 1,) [m^2/s^2].
        jumps: Indices of the inner nodes where a jump of the curvature rate is large in relation to the limit of the
            yaw acceleration or to the cap of the steering rate.
    """

    limits: PathLimits
    step: float = KNOT_STEP  # knot spacing of the reference [s]
    smooth: bool = False  # whether the reference itself is the motion, with nearly continuous jerk between knots
    relief: float = 0.0  # distance over which full braking from a moving start permits no margins [m]
    tightenings: tuple[Tightening, ...] = ()

    def __post_init__(self) -> None:
        limits = self.limits
        left, right = limits.slowness_left, limits.slowness_right
        if limits.has_zone:
            slow = np.where(limits.s[:-1] >= limits.zone_start, 1.0 / limits.zone_speed, 0.0)
            left, right = np.maximum(left, slow), np.maximum(right, slow)
        ends = np.array((limits.curvature[1:], limits.rate_right, right))
        self._left = np.array((limits.curvature[:-1], limits.rate_left, left))
        self._slope = (ends - self._left) / (limits.s[1:] - limits.s[:-1])
        relieved = limits.s[:-1] < self.relief
        factor = self._factors() if self.tightenings else 1.0
        cap = np.maximum(left, right) ** -2.0
        speed = (factor * np.where(relieved, 1.0 - _RELIEVED_SPEED, 1.0 - SPEED_MARGIN)) ** 2
        turning = factor**2 * np.where(relieved, 1.0 - _RELIEVED_YAW, 1.0 - _YAW_MARGIN)
        self.jumps = _NONE
        if limits.turning:
            jump, least = np.abs(limits.rate_left[1:] - limits.rate_right[:-1]), np.minimum(cap[1:], cap[:-1])
            large = [limit.at_constant_speed(least, jump) > _JUMP * limit.bound for limit in limits.turning]
            self.jumps = np.logical_or.reduce(large).nonzero()[0] + 1
        if limits.caps.steering:
            at_caps = np.flatnonzero(np.abs(left[1:] / right[:-1] - 1.0) > _CAP_JUMP) + 1
            self.jumps = np.union1d(self.jumps, at_caps)
        self.turning = tuple(readonly(limit.bounds(turning)) for limit in limits.turning)
        self.cap_squared, self.speed_squared = readonly(cap), readonly(cap * speed)

    def _factors(self) -> FloatArray:
        s = self.limits.s
        factor: FloatArray = np.ones(s.size - 1)
        for stretch in self.tightenings:
            inside = (s[1:] > stretch.left) & (s[:-1] < stretch.right)
            factor = np.where(inside, np.minimum(factor, stretch.factor), factor)
        return factor

    @property
    def jerk(self) -> float:
        """Bound on the jerk of the reference [m/s^3]."""
        return self.limits.drive.max_jerk * (1.0 - _JERK_MARGIN)

    @cached_property
    def packed(self) -> tuple[FloatArray, FloatArray]:
        """All of `curve_at` and `jump_excess_at` for the kernels.

        The first array contains the nodes, and curvature, rate and slowness at the left end of the cells with their
        slopes, Shape (7 n - 6,). The second array contains place, curvature, rates on both sides and slowness at the
        jumps, Shape (5, jumps).
        """
        limits, nodes = self.limits, self.jumps
        along = np.concatenate((limits.s, self._left, self._slope), axis=None)
        if not nodes.size:
            return along, np.zeros((5, 0))
        slowness = np.zeros(nodes.size)
        if limits.caps.steering:
            slowness = np.maximum(limits.slowness_right[nodes - 1], limits.slowness_left[nodes])
        sides = limits.rate_right[nodes - 1], limits.rate_left[nodes]
        return along, np.array((limits.s[nodes], limits.curvature[nodes], *sides, slowness))

    def curve_at(self, s: FloatArray) -> FloatArray:
        """Return curvature, its rate, and slowness, linear in each cell. Shape (3, n)."""
        cell = self.limits.cells_at(s)
        values: FloatArray = self._left[:, cell] + self._slope[:, cell] * (s - self.limits.s[cell])
        return values

    def excess_at(self, s: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        """Return the time stretch factor that satisfies the checked limits at `s`; > 1 means too fast. Shape (n,)."""
        curvature, rate, slowness = self.curve_at(s)
        turning = turning_ratio(self.limits.turning, curvature, rate, v, a)
        return self._checked(s, np.maximum(v * slowness, np.sqrt(turning)))

    def jump_excess_at(self, nodes: IntArray, v: FloatArray, a: FloatArray) -> FloatArray:
        """Return the excess at `nodes` of the limits that depend on the curvature rates of both sides. Shape (n,)."""
        limits, curvature = self.limits, self.limits.curvature[nodes]
        sides = (limits.rate_right[nodes - 1], limits.rate_left[nodes])
        left, right = (turning_ratio(limits.turning, curvature, rate, v, a) for rate in sides)
        excess = np.sqrt(np.maximum(left, right))
        if limits.caps.steering:
            excess = np.maximum(excess, v * np.maximum(limits.slowness_right[nodes - 1], limits.slowness_left[nodes]))
        return self._checked(limits.s[nodes], excess)

    def _checked(self, s: FloatArray, excess: FloatArray) -> FloatArray:
        share = 1.0 / (1.0 - CHECK_MARGIN)
        return excess * (np.where(s < self.relief, 1.0, share) if self.relief > 0.0 else share)
