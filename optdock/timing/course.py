"""One gear of a path as the time parameterization sees it: curvature by arc length, and the speed caps it implies."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.arrays import readonly
from optdock.path import ClothoidSegment, Direction, PolylineSegment

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray, IntArray
    from optdock.limits import MotionLimits
    from optdock.path import Segment

__all__ = ["Course", "CoursePoints", "Slowness", "course_of"]

_EXACT_SPACING = 0.005  # [m]: a clothoid is exact between nodes, they only carry the checks
_SAMPLED_SPACING = 0.002  # [m]: a polyline's curvature is that between its poses
_MAX_NODES = 6000
_LEFT_OF_NODE = 1e-7  # of a cell: where the curvature rate to the left of a node is read


class CoursePoints(NamedTuple):
    """Shape (n,) each: curvature [1/m], curvature rate [1/m^2], slowness = 1 / speed cap [s/m]."""

    curvature: FloatArray
    rate: FloatArray
    slowness: FloatArray


@dataclass(frozen=True)
class Slowness:
    """1 / speed cap as a function of curvature: the largest of the reciprocal limits, so `inf` limits vanish.

    Args:
        limits: What the drive can do.
        direction: Gear.
    """

    limits: MotionLimits
    direction: Direction

    @property
    def max_speed(self) -> float:
        """The gear's own speed limit [m/s]."""
        return self.limits.max_speed if self.direction > 0 else self.limits.max_reverse_speed

    def at(self, curvature: FloatArray, excess: FloatArray | float = 0.0) -> FloatArray:
        """Speed, yaw rate, lateral acceleration and both wheels' speeds, at |curvature| + excess. Shape (n,) [s/m].

        Both wheels: |v +- (b/2) v k| <= v_wheel  <=>  v (1 + b |k| / 2) <= v_wheel.
        """
        bend, limits = np.abs(curvature) + excess, self.limits
        slowness = np.maximum(1.0 / self.max_speed, bend * (1.0 / limits.max_yaw_rate))
        if np.isfinite(limits.max_lateral_acceleration):
            slowness = np.maximum(slowness, np.sqrt(bend * (1.0 / limits.max_lateral_acceleration)))
        if np.isfinite(limits.max_wheel_speed):
            slowness = np.maximum(slowness, (1.0 + 0.5 * limits.track_width * bend) / limits.max_wheel_speed)
        return slowness

    def tightest(self, bend: float) -> tuple[str, str]:
        """The limit that decides at |curvature| `bend` [1/m]: its name in `MotionLimits`, and that with its value."""
        limits = self.limits
        speed = "max_speed" if self.direction > 0 else "max_reverse_speed"
        table = (
            (1.0 / self.max_speed, speed, "m/s"),
            (bend / limits.max_yaw_rate, "max_yaw_rate", "rad/s"),
            (math.sqrt(bend / limits.max_lateral_acceleration), "max_lateral_acceleration", "m/s^2"),
            ((1.0 + 0.5 * limits.track_width * bend) / limits.max_wheel_speed, "max_wheel_speed", "m/s"),
        )
        _slowness, name, unit = max(table)
        return name, f"{name} = {getattr(limits, name):.4g} {unit}"


@dataclass(frozen=True, eq=False)
class Course:
    """Curvature over one gear: continuous and linear between nodes; its rate linear in a cell, jumping at nodes.

    Args:
        s: Nodes, Shape (n,) [m], n >= 2, first 0, strictly increasing, every knot and the zone start among them.
        curvature: At the nodes, Shape (n,) [1/m].
        rate_left: d curvature / ds just right of every cell's left node, Shape (n - 1,) [1/m^2].
        rate_right: Just left of every cell's right node, Shape (n - 1,) [1/m^2].
        drive: Speed caps by curvature.
        zone_start: Where the speed zone begins: exactly a node; `length` without a zone [m].
        zone_speed: Speed limit from there on [m/s].
        excess: What the speed caps add to |curvature| at the nodes, Shape (n,) [1/m]; None: nothing.
        begin: Where this course begins on the whole path [m]; messages count from there.

    Attributes:
        slowness: 1 / speed cap at the nodes, zone not included, Shape (n,) [s/m].
        length: [m].
    """

    s: FloatArray
    curvature: FloatArray
    rate_left: FloatArray
    rate_right: FloatArray
    drive: Slowness
    zone_start: float
    zone_speed: float
    excess: FloatArray | None = None
    begin: float = 0.0
    slowness: FloatArray = field(init=False, repr=False)
    length: float = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(
            self, "slowness", readonly(self.drive.at(self.curvature, 0.0 if self.excess is None else self.excess))
        )
        object.__setattr__(self, "length", float(self.s[-1]))

    @property
    def limits(self) -> MotionLimits:
        """What the drive can do."""
        return self.drive.limits

    @property
    def has_zone(self) -> bool:
        """Whether the speed zone reaches into this gear."""
        return self.zone_start < self.length

    @property
    def cell_slowness(self) -> FloatArray:
        """The larger slowness of both nodes of every cell, the zone included, Shape (n - 1,) [s/m]."""
        slowness = np.maximum(self.slowness[:-1], self.slowness[1:])
        if not self.has_zone:
            return slowness
        return np.where(self.s[1:] > self.zone_start + 1e-12, np.maximum(slowness, 1.0 / self.zone_speed), slowness)

    def cells_at(self, s: FloatArray) -> IntArray:
        """Index of the cell that holds each point, Shape (n,)."""
        found: IntArray = np.searchsorted(self.s, s, side="right") - 1
        cells: IntArray = np.minimum(np.maximum(found, 0), self.s.size - 2)
        return cells

    def points_at(self, s: FloatArray) -> CoursePoints:
        """Everything at arc lengths `s`, Shape (n,) [m]; the right side at nodes. Slowness includes the zone."""
        cell = self.cells_at(s)
        left = self.s[cell]
        share = (s - left) / (self.s[cell + 1] - left)
        curvature = self.curvature[cell] + share * (self.curvature[cell + 1] - self.curvature[cell])
        rate = self.rate_left[cell] + share * (self.rate_right[cell] - self.rate_left[cell])
        excess = 0.0 if self.excess is None else np.interp(s, self.s, self.excess)
        slowness = self.drive.at(curvature, excess)
        if self.has_zone:
            slowness = np.where(s >= self.zone_start, np.maximum(slowness, 1.0 / self.zone_speed), slowness)
        return CoursePoints(curvature, rate, slowness)

    def cap_at(self, s: float) -> tuple[str, str]:
        """The speed cap that decides at `s` [m]: the name of its limit, and that with its value."""
        point = self.points_at(np.array([s]))
        name, words = self.drive.tightest(abs(float(point.curvature[0])))
        zone = self.has_zone and s >= self.zone_start and float(point.slowness[0]) <= 1.0 / self.zone_speed
        return ("approach_speed", f"approach_speed = {self.zone_speed:.4g} m/s") if zone else (name, words)

    def after(self, start: float) -> Course:
        """The rest of the course from `start` [m], 0 <= start < length, renumbered from 0."""
        if start <= 0.0:
            return self
        cell = int(self.cells_at(np.array([start]))[0])
        if self.s[cell + 1] - start <= 1e-12:
            cell += 1
        point = self.points_at(np.array([start]))
        keep = slice(cell + 1, None)
        zone_start = self.zone_start - start if self.zone_start > self.s[cell] else 0.0
        return Course(
            s=readonly(np.concatenate(([0.0], self.s[keep] - start))),
            curvature=readonly(np.concatenate((point.curvature, self.curvature[keep]))),
            rate_left=readonly(np.concatenate((point.rate, self.rate_left[keep]))),
            rate_right=self.rate_right[cell:],
            drive=self.drive,
            zone_start=max(0.0, zone_start),
            zone_speed=self.zone_speed,
            excess=None if self.excess is None else np.append(np.interp(start, self.s, self.excess), self.excess[keep]),
            begin=self.begin + start,
        )


def course_of(segment: Segment, drive: Slowness, zone_start: float, zone_speed: float, begin: float = 0.0) -> Course:
    """The course of one gear segment.

    Args:
        segment: Clothoid spline or polyline.
        drive: Speed caps by curvature.
        zone_start: Where the speed zone begins in this segment; at or beyond its length: not here [m].
        zone_speed: Speed limit from there on [m/s].
        begin: Where the segment begins on the whole path [m].
    """
    spacing = _EXACT_SPACING if isinstance(segment, ClothoidSegment) else _SAMPLED_SPACING
    zone_start = min(max(zone_start, 0.0), segment.length)
    s = _nodes(segment, max(spacing, segment.length / _MAX_NODES), zone_start)
    zone_start = float(s[np.argmin(np.abs(s - zone_start))])  # of a knot and a zone within rounding one node is left
    cells = np.diff(s)
    return Course(
        s=readonly(s),
        curvature=readonly(segment.curvature_at(s)),
        rate_left=readonly(segment.curvature_rate_at(s[:-1])),
        rate_right=readonly(segment.curvature_rate_at(s[1:] - _LEFT_OF_NODE * cells)),
        drive=drive,
        zone_start=zone_start,
        zone_speed=zone_speed,
        excess=_step_excess(segment, s) if isinstance(segment, PolylineSegment) else None,
        begin=begin,
    )


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
