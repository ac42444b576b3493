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
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.arrays import readonly
from optdock.kernels import Kernel, twin_of
from optdock.model.limits import LIMITS
from optdock.model.path import ClothoidSegment, Direction, PolylineSegment, TurnSegment, place_before_end
from optdock.timing.jerk_phases import DriveBounds
from optdock.timing.turning_limits import TurningLimit, turning_limits, turning_ratio

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray, IntArray
    from optdock.geometry.clothoid import ClothoidSpline
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
    "limits_table",
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


@dataclass(eq=False)
class SpeedCaps:
    """Speed caps as a function of curvature, as their reciprocals; `direction` is the gear.

    Attributes:
        max_speed: Speed limit of the gear [m/s].
        steering: Whether the steering rate is limited, so that the curvature rate caps the speed.
    """

    drive: MotionLimits
    direction: Direction

    def __post_init__(self) -> None:
        drive = self.drive
        self.max_speed = drive.max_speed if self.direction > 0 else drive.max_reverse_speed
        self.steering = drive.max_steering_rate < math.inf

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
        s: Nodes, Shape (n,) [m], n >= 2, from 0, strictly increasing, with every knot and the zone start.
        left: Curvature [1/m], curvature rate [1/m^2] and slowness with the zone [s/m] just to the right of every cell's
            left node, Shape (3, n - 1).
        slope: Their derivatives in the cell, Shape (3, n - 1).
        curvature: Curvature at the nodes, Shape (n,) [1/m].
        rate_left: d curvature / ds just to the right of every cell's left node, Shape (n - 1,) [1/m^2].
        rate_right: The same just to the left of every cell's right node, Shape (n - 1,) [1/m^2].
        slowness_left: 1 / speed cap just to the right of every cell's left node, without the zone, Shape (n - 1,)
            [s/m].
        slowness_right: The same just to the left of every cell's right node, Shape (n - 1,) [s/m].
        steepest: The larger |rate| of every cell, Shape (n - 1,) [1/m^2].
        slowest: The larger slowness of every cell, with the zone, Shape (n - 1,) [s/m].
        zone_start: Start of the speed zone, exactly a node; `length` if there is no zone [m].
        has_zone: Whether the speed zone begins in this segment.
        turning: Turning limits of the drive.
        turning_rows: Number of linear rows, and of rows with the speed, of the reference program.
        turning_numbers: Orders and bounds of two turning limits, for kernels.
        length: Length of the segment [m].
        duration_estimate: Longest of three approximate lower bounds [s]: along the maximum velocity curve, from rest to
            rest under only the acceleration limit, and from rest to rest under only the jerk limit.
    """

    table: FloatArray  # result of `limits_table`
    caps: SpeedCaps
    zone_speed: float  # speed limit in the zone [m/s]
    excess: FloatArray | None = None  # addition to |curvature| at the nodes, for the caps, Shape (n,) [1/m]; None: zero
    begin: float = 0.0  # start of this segment on the whole path, for messages [m]

    def __post_init__(self) -> None:
        self.drive, table = self.caps.drive, self.table
        n = (table.size + 9) // 13
        left, bend, rates, cells = n, 7 * n - 6, 8 * n - 6, n - 1
        self.s, self.curvature = table[:n], table[bend:rates]
        self.left, self.slope = table[left:bend].reshape(2, 3, cells)
        self.rate_left = self.left[1]
        columns = table[rates:-2].reshape(5, cells)
        self.rate_right, self.slowness_left, self.slowness_right, self.steepest, self.slowest = columns
        self.zone_start, along_curve = table[-2:].tolist()
        self.length = length = float(self.s[-1])
        self.has_zone = self.zone_start < length
        self.turning = turning = turning_limits(self.drive)
        linear, curved, orders, bounds = 3, 2, (0.0, 0.0), (math.inf, math.inf)
        for limit in reversed(turning):
            linear, curved = (linear + 4, curved) if limit.order == 1 else (linear, curved + 4)
            orders, bounds = (float(limit.order), orders[0]), (limit.bound, bounds[0])
        self.turning_rows, self.turning_numbers = (linear, curved), (*orders, *bounds)
        by_drive = math.sqrt(2.0 * length * (1.0 / self.drive.max_acceleration + 1.0 / self.drive.max_deceleration))
        by_jerk = math.exp(math.log(32.0 * length / self.drive.max_jerk) / 3.0)
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

    def maximum_velocity_curve(self, turning_share: float = 1.0) -> FloatArray:
        """Return the slowness of the maximum velocity curve, with the speed zone, per cell. Shape (n - 1,) [s/m].

        The curvature rate may use `turning_share` of the turning limits.
        """
        return _slowest_with(self.turning, self.slowest, self.steepest, turning_share)

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
        nodes = np.concatenate(([0.0], self.s[keep] - start)), np.concatenate((point.curvature, self.curvature[keep]))
        rates = np.concatenate((point.rate, self.rate_left[keep])), self.rate_right[cell:]
        excess = None if self.excess is None else np.append(np.interp(start, self.s, self.excess), self.excess[keep])
        zone = max(0.0, zone_start), self.zone_speed
        return PathLimits(
            limits_table(nodes, rates, self.caps, zone, excess), self.caps, zone[1], excess, self.begin + start
        )


def limits_along(path: Path, drive: MotionLimits, zone: SpeedZone) -> list[PathLimits | None]:
    """Return the limits of every segment of a path; None for a segment of zero length and for a turn in place."""
    is_slow = zone.distance > 0.0 and math.isfinite(zone.speed)
    zone_start = place_before_end(path, zone.distance) if is_slow else math.inf
    found: list[PathLimits | None] = []
    for segment, begin in zip(path.segments, path.segment_starts.tolist(), strict=False):
        if isinstance(segment, TurnSegment) or segment.length <= NO_LENGTH:
            found.append(None)
        else:
            caps = SpeedCaps(drive, segment.direction)
            found.append(segment_limits(segment, caps, zone_start - begin, zone.speed, begin))
    return found


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
    zone = min(max(zone_start, 0.0), segment.length), zone_speed
    if isinstance(segment, ClothoidSegment):
        # The last bits of a cube root, which turning limits of order 2 need, depend on the library.
        has_roots = caps.drive.max_lateral_jerk < math.inf
        table = (_clothoid_numpy if has_roots else _clothoid_chosen)(segment.spline, caps, *zone)
        return PathLimits(table, caps, zone_speed, None, begin)
    s = _nodes(segment.knots, _POLYLINE_SPACING, zone[0])
    excess = _step_excess(segment, s) if isinstance(segment, PolylineSegment) else None
    return PathLimits(_table_of(segment, s, caps, zone, excess), caps, zone_speed, excess, begin)


_KERNEL = Kernel("optdock_path_limits", sizes=2, numbers=11)


def _clothoid_native(spline: ClothoidSpline, caps: SpeedCaps, zone_start: float, zone_speed: float) -> FloatArray:
    knots, drive, length = spline.knots, caps.drive, spline.length
    spacing, count = max(_CLOTHOID_SPACING, length / _MOST_NODES), knots.size
    room = int(length / spacing) + count + 3
    size = 13 * room + count - 8
    table = np.empty(size)
    n = _KERNEL(
        (count, room),
        (
            *(spacing, zone_start, zone_speed, caps.max_speed, drive.max_yaw_rate, drive.max_lateral_acceleration),
            *(drive.max_wheel_speed, drive.track_width, drive.max_steering_rate, drive.wheelbase),
            drive.max_yaw_acceleration,
        ),
        ((knots, count), (spline.curvature, count), (table, size)),
    )
    if n < 0:
        raise ValueError("limits: needs at least two knots that increase")
    return table[: 13 * n - 9]


def _clothoid_numpy(spline: ClothoidSpline, caps: SpeedCaps, zone_start: float, zone_speed: float) -> FloatArray:
    """Return the limits along a clothoid spline; see `limits_table`."""
    return _table_of(
        ClothoidSegment(spline),
        _nodes(spline.knots, _CLOTHOID_SPACING, zone_start),
        caps,
        (zone_start, zone_speed),
        None,
    )


_clothoid_chosen = twin_of(_clothoid_native)(_clothoid_numpy)


def _table_of(
    segment: Segment, s: FloatArray, caps: SpeedCaps, zone: tuple[float, float], excess: FloatArray | None
) -> FloatArray:
    """Return the limits along a segment with these nodes; see `limits_table`."""
    cells = s[1:] - s[:-1]
    middles = s[:-1] + 0.5 * cells
    rates = _rates(segment, s[:-1], middles), _rates(segment, s[1:] - _LEFT_OF_NODE * cells, middles)
    return limits_table((s, segment.curvature_at(s)), rates, caps, zone, excess)


def limits_table(
    nodes: tuple[FloatArray, FloatArray],
    rates: tuple[FloatArray, FloatArray],
    caps: SpeedCaps,
    zone: tuple[float, float],
    excess: FloatArray | None = None,
) -> FloatArray:
    """Return the limits along a segment as one array of 13 n - 9 numbers.

    It contains `s`, `left`, `slope`, `curvature`, `rate_right`, `slowness_left`, `slowness_right`, `steepest`,
    `slowest` and `zone_start` of `PathLimits`, and the time along the maximum velocity curve [s].

    Args:
        nodes: Places [m] and their curvature [1/m], Shape (n,) each.
        rates: Curvature rates just to the right of every cell's left node and just to the left of its right node,
            Shape (n - 1,) each [1/m^2].
        caps: Speed caps.
        zone: Start of the speed zone, replaced by the nearest node [m], and the speed limit in it [m/s].
        excess: Addition to |curvature| at the nodes, for the caps, Shape (n,) [1/m]; None: zero.
    """
    (s, curvature), (rate_left, rate_right) = nodes, rates
    slowness = caps.slowness(curvature, 0.0 if excess is None else excess)
    left, right, cells = slowness[:-1], slowness[1:], s[1:] - s[:-1]
    if caps.steering:
        first, last = curvature[:-1], curvature[1:]
        crosses = first * last < 0.0  # the steering rate of a cell is largest at zero curvature
        left = np.maximum(left, caps.steering_slowness(np.where(crosses, 0.0, first), rate_left))
        right = np.maximum(right, caps.steering_slowness(np.where(crosses, 0.0, last), rate_right))
    zone_start = float(s[np.abs(s - zone[0]).argmin()])
    slow = np.where((s[:-1] >= zone_start) & (zone_start < s[-1]), 1.0 / zone[1], 0.0)
    begins = np.array((curvature[:-1], rate_left, np.maximum(left, slow)))
    ends = np.array((curvature[1:], rate_right, np.maximum(right, slow)))
    steepest, slowest = np.maximum(np.abs(rate_left), np.abs(rate_right)), np.maximum(begins[2], ends[2])
    along_curve = np.cumsum(cells * _slowest_with(turning_limits(caps.drive), slowest, steepest))[-1]
    columns = begins.ravel(), ((ends - begins) / cells).ravel(), curvature, rate_right, left, right, steepest, slowest
    return np.concatenate((s, *columns, (zone_start, along_curve)))


def _slowest_with(
    turning: tuple[TurningLimit, ...], slowness: FloatArray, steepest: FloatArray, share: float = 1.0
) -> FloatArray:
    """Return the slowness at which constant speed also satisfies a share of the turning limits. Shape (n - 1,)."""
    for limit in turning:
        slowness = np.maximum(slowness, limit.slowness(steepest, share))
    return slowness


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


def _nodes(knots: FloatArray, spacing: float, zone_start: float) -> FloatArray:
    """Return the segment's knots and the zone start, with equal steps of about `spacing` or less between them."""
    length = float(knots[-1])
    spacing = max(spacing, length / _MOST_NODES)
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
        ceiling: Bound on v^2 with the turning limits as speed caps at a = 0, Shape (n - 1,) [m^2/s^2].
        table: `speed_squared`, `ceiling` and `turning`, for kernels, Shape (2 + limits, n - 1).
        jerk: Bound on the jerk of the reference [m/s^3].
        first_cap: v^2 of the speed cap of the first cell, without margin [m^2/s^2].
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
        self.jerk = limits.drive.max_jerk * (1.0 - _JERK_MARGIN)
        relieved = limits.s[:-1] < self.relief if self.relief > 0.0 else np.False_
        factor = self._factors() if self.tightenings else 1.0
        cap = limits.slowest**-2.0
        speed = factor * np.where(relieved, 1.0 - _RELIEVED_SPEED, 1.0 - SPEED_MARGIN)
        share = factor * factor * np.where(relieved, 1.0 - _RELIEVED_YAW, 1.0 - _YAW_MARGIN)
        self.first_cap = float(cap[0])
        self.table = table = np.empty((2 + len(limits.turning), cap.size))
        self.speed_squared, self.ceiling, *turning = table
        self.turning = tuple(turning)
        self.speed_squared[:] = self.ceiling[:] = cap * (speed * speed)
        for limit, bounds in zip(limits.turning, turning, strict=True):
            bounds[:] = limit.bounds(share)
            self.ceiling[:] = np.minimum(self.ceiling, limit.most_squared(bounds, np.maximum(limits.steepest, 1e-9)))
        self.jumps = self._found_jumps(cap)

    def _found_jumps(self, cap: FloatArray) -> IntArray:
        """Return `jumps`; cap: v^2 of the speed caps of a cell, Shape (n - 1,) [m^2/s^2]."""
        limits, jumps = self.limits, _NONE
        if limits.turning:
            jump, least = np.abs(limits.rate_left[1:] - limits.rate_right[:-1]), np.minimum(cap[1:], cap[:-1])
            large = [limit.at_constant_speed(least, jump) > _JUMP * limit.bound for limit in limits.turning]
            jumps = np.logical_or.reduce(large).nonzero()[0] + 1
        if limits.caps.steering:
            slow = np.where(limits.has_zone & (limits.s[:-1] >= limits.zone_start), 1.0 / limits.zone_speed, 0.0)
            before = np.maximum(limits.slowness_right, slow)[:-1]
            jumps = np.union1d(jumps, np.flatnonzero(np.abs(limits.left[2, 1:] / before - 1.0) > _CAP_JUMP) + 1)
        return jumps

    def _factors(self) -> FloatArray:
        s = self.limits.s
        factor: FloatArray = np.ones(s.size - 1)
        for stretch in self.tightenings:
            inside = (s[1:] > stretch.left) & (s[:-1] < stretch.right)
            factor = np.where(inside, np.minimum(factor, stretch.factor), factor)
        return factor

    def curve_at(self, s: FloatArray) -> FloatArray:
        """Return curvature, its rate, and slowness, linear in each cell. Shape (3, n)."""
        limits = self.limits
        cell = limits.cells_at(s)
        values: FloatArray = limits.left[:, cell] + limits.slope[:, cell] * (s - limits.s[cell])
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
