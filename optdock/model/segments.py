"""Gear segments: curves by arc length, exact (clothoid spline) or sampled (polyline), and turns in place.

A turn in place covers no distance, so arc length cannot distinguish its poses. It therefore occupies an interval of the
path coordinate s as long as the arc of a point 1 m from the robot's origin, which is 1 m per rad. Every s then has
exactly one pose. A time law over s describes a turn in the same way as a curve, with the yaw rate as speed and the yaw
acceleration as acceleration. Proofs, samples and files treat turns like other segments. Only driven distances must
exclude turns.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import IntEnum
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np

from optdock.errors import InvalidPath, InvalidValue
from optdock.geometry.arrays import FrozenArrays, frozen_array, readonly, vector
from optdock.geometry.checked import exactly, finite_number, member
from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.pose import Pose2, check_range, transform_points, unwrap_yaw

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from optdock.geometry.arrays import FloatArray, IntArray

__all__ = [
    "SAME_POSITION",
    "SAME_YAW",
    "TURN_RADIUS",
    "ClothoidSegment",
    "Direction",
    "PathSamples",
    "PolylineSegment",
    "Segment",
    "TurnSegment",
    "first_pose",
    "moved_segment",
    "piece_of",
]

SAME_POSITION = 1e-9  # [m]: shorter steps carry no direction
SAME_YAW = 1e-9  # [rad]
TURN_RADIUS = 1.0  # [m]: a turn in place has the length of the arc of a point at this distance from the origin


class Direction(IntEnum):
    """Gear of a segment."""

    FORWARD = 1
    REVERSE = -1
    IN_PLACE = 0


class PathSamples(NamedTuple):
    """Points of a path, all Shape (n,): s [m], x [m], y [m], yaw [rad], curvature [1/m], direction.

    The direction is 1 or -1, or 0 in turns in place.
    """

    s: FloatArray
    x: FloatArray
    y: FloatArray
    yaw: FloatArray
    curvature: FloatArray
    direction: IntArray

    @property
    def poses(self) -> FloatArray:
        """x, y, yaw, Shape (n, 3)."""
        return np.column_stack((self.x, self.y, self.yaw))


@dataclass(frozen=True, eq=False, repr=False)
class ClothoidSegment(FrozenArrays):
    """A gear segment that is an exact clothoid spline, as returned by the smoother."""

    spline: ClothoidSpline

    def __post_init__(self) -> None:
        exactly(ClothoidSpline, self.spline, "path: a clothoid segment's spline")

    def __repr__(self) -> str:
        return f"<ClothoidSegment {self.length:.3f} m {self.direction.name.lower()}, {self.knots.size - 1} pieces>"

    @property
    def direction(self) -> Direction:
        """Gear of the segment."""
        return Direction.FORWARD if self.spline.sign > 0 else Direction.REVERSE

    @property
    def length(self) -> float:
        """Arc length [m]."""
        return self.spline.length

    @property
    def knots(self) -> FloatArray:
        """Arc lengths at which the curvature rate may jump, Shape (n,) [m]."""
        return self.spline.knots

    def poses_at(self, s: ArrayLike) -> FloatArray:
        """Return the poses at `s`. Shape (n, 3)."""
        return self.spline.poses_at(s)

    def curvature_at(self, s: ArrayLike) -> FloatArray:
        """Return the curvature at `s`. Shape (n,) [1/m]."""
        return self.spline.curvature_at(s)

    def curvature_rate_at(self, s: ArrayLike) -> FloatArray:
        """Return the curvature rate at `s`. Shape (n,) [1/m^2]."""
        return self.spline.curvature_rate_at(s)


@dataclass(frozen=True, eq=False, repr=False)
class PolylineSegment(FrozenArrays):
    """A gear segment given by poses, as returned by planners.

    Position and yaw are linear between poses. The curvature of a step is the curvature of the circular arc with the
    same chord and turn, of length chord * (turn / 2) / sin(turn / 2). A sampled arc therefore has its exact curvature.
    A step that changes only the yaw has no length and infinite curvature.

    Args:
        poses: Shape (n, 3) [m, m, rad], n >= 2.
        direction: Gear.

    Raises:
        InvalidPath: If there are fewer than two poses.
        InvalidValue: If a pose is not finite or beyond 1e8 m or 1e6 rad, or the direction is not a gear.
    """

    poses: FloatArray
    direction: Direction = Direction.FORWARD
    knots: FloatArray = field(init=False, repr=False)
    node_curvature: FloatArray = field(init=False, repr=False)  # (n,), mean of the steps that meet there

    def __post_init__(self) -> None:
        poses = np.array(frozen_array(self.poses, "path", columns=3))
        if len(poses) < 2:
            raise InvalidPath(f"path: a segment needs at least 2 poses, got {len(poses)}")
        direction = member(Direction, self.direction, "path: a segment's direction")
        if direction is Direction.IN_PLACE:
            raise InvalidValue("path: a segment's direction: poses are driven forward or in reverse; see TurnSegment")
        check_range(poses, "path")
        poses[:, 2] = unwrap_yaw(poses[:, 2])
        knots, nodes, (turn, arc) = np.zeros(len(poses)), np.empty(len(poses)), _step_arcs(poses)
        arc.cumsum(out=knots[1:])
        curvature = _step_curvature(turn, arc)
        nodes[0], nodes[-1] = curvature[0], curvature[-1]
        with np.errstate(invalid="ignore"):
            nodes[1:-1] = 0.5 * (curvature[:-1] + curvature[1:])
        nodes[np.isnan(nodes)] = np.inf
        arrays = {"poses": readonly(poses), "knots": readonly(knots), "node_curvature": readonly(nodes)}
        vars(self).update(arrays, direction=direction)

    def __repr__(self) -> str:
        return f"<PolylineSegment {self.length:.3f} m {self.direction.name.lower()}, {len(self.poses)} poses>"

    @property
    def length(self) -> float:
        """Arc length [m]."""
        return float(self.knots[-1])

    @property
    def step_curvature(self) -> FloatArray:
        """Turn divided by arc length of every step, Shape (n - 1,) [1/m]; infinite for steps without length."""
        return _step_curvature(*_step_arcs(self.poses))

    @property
    def step_swing(self) -> FloatArray:
        """Variation of the curvature per metre of every step, Shape (n - 1,) [1/m^2].

        The variation is half the sum of the absolute curvature changes at both ends of the step, divided by the length
        of the step. For monotonic curvature, the variation equals the slope of `curvature_at`. It also detects an
        oscillation from step to step, which the mean curvatures at the poses do not show.
        """
        swing, moving = np.zeros(self.knots.size - 1), np.diff(self.knots) > 0.0
        changes = np.abs(np.diff(self.step_curvature[moving], prepend=np.nan, append=np.nan))
        changes[[0, -1]] = 0.0  # the curvature at the ends is that of the first and of the last step
        swing[moving] = 0.5 * (changes[:-1] + changes[1:]) / np.diff(self.knots)[moving]
        return swing

    def poses_at(self, s: ArrayLike) -> FloatArray:
        """Interpolate the given poses linearly. Shape (n, 3)."""
        points, knots = vector(s), self.knots
        poses = np.empty((points.size, 3))
        for i, column in enumerate(self.poses.T):
            poses[:, i] = np.interp(points, knots, column)
        return poses

    def curvature_at(self, s: ArrayLike) -> FloatArray:
        """Interpolate the mean curvatures of the adjacent steps at the poses. Shape (n,) [1/m]."""
        nodes = self.node_curvature
        if not np.isfinite(nodes).all():
            nodes = np.where(np.isfinite(nodes), nodes, np.sign(nodes) * 1e9)
        return np.interp(vector(s), self.knots, nodes)

    def curvature_rate_at(self, s: ArrayLike) -> FloatArray:
        """Return the slope of `curvature_at`, Shape (n,) [1/m^2]."""
        points = vector(s)
        kept = np.flatnonzero(np.diff(self.knots, prepend=-1.0) > 0.0)
        if kept.size < 2:
            return np.zeros(points.size)
        slope = np.diff(self.curvature_at(self.knots[kept])) / np.diff(self.knots[kept])
        found = np.searchsorted(self.knots[kept], points, side="right") - 1
        rates: FloatArray = slope[np.clip(found, 0, slope.size - 1)]
        return rates


@dataclass(frozen=True, eq=False, repr=False)
class TurnSegment(FrozenArrays):
    """A turn in place: constant position, yaw from one heading to another.

    Only robots with `turns_in_place` can execute a turn. The robot is at rest at both ends.

    Args:
        pose: Pose at the beginning.
        turn: Angle, left positive; may exceed a whole turn [rad].

    Attributes:
        knots: Bounds of the interval of s, whose length is `TURN_RADIUS` * |turn|, Shape (2,) [m].

    Raises:
        InvalidValue: If `pose` is not a `Pose2`, or the turn is 0, not finite, or leads beyond 1e6 rad.
    """

    pose: Pose2
    turn: float
    knots: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        exactly(Pose2, self.pose, "path: a turn's pose")
        turn = finite_number(self.turn, "path: a turn")
        if turn == 0.0:
            raise InvalidValue("path: a turn: must not be 0 rad")
        vars(self).update(turn=turn, knots=readonly(np.array([0.0, TURN_RADIUS * abs(turn)])))
        check_range(self.poses_at(self.knots), "path: a turn")

    def __repr__(self) -> str:
        return f"<TurnSegment {self.turn:.4g} rad at {self.pose.brief}>"

    @property
    def direction(self) -> Direction:
        """Value 0, because a turn in place has no gear."""
        return Direction.IN_PLACE

    @property
    def length(self) -> float:
        """Length [m] of the interval of s."""
        return float(self.knots[-1])

    @property
    def end(self) -> Pose2:
        """Pose at the end."""
        return Pose2(self.pose.x, self.pose.y, self.pose.yaw + self.turn)

    def poses_at(self, s: ArrayLike) -> FloatArray:
        """Return the poses at `s`. Shape (n, 3)."""
        points = np.clip(vector(s), 0.0, self.length)
        poses = np.tile(self.pose.as_array(), (points.size, 1))
        poses[:, 2] += math.copysign(1.0 / TURN_RADIUS, self.turn) * points
        return poses

    def curvature_at(self, s: ArrayLike) -> FloatArray:
        """Return d yaw / ds: 1 / `TURN_RADIUS`, negative for turns to the right. Shape (n,) [1/m]."""
        return np.full(np.atleast_1d(np.asarray(s)).size, math.copysign(1.0 / TURN_RADIUS, self.turn))

    def curvature_rate_at(self, s: ArrayLike) -> FloatArray:
        """Return zeros. Shape (n,) [1/m^2]."""
        return np.zeros(np.atleast_1d(np.asarray(s)).size)


Segment: TypeAlias = ClothoidSegment | PolylineSegment | TurnSegment
"""A curve of one gear by arc length, or a turn; arguments are clipped to [0, length]."""


def first_pose(segment: Segment) -> Pose2:
    """Return the pose at s = 0; for a polyline whose first step changes only the yaw, the pose before this step."""
    if isinstance(segment, ClothoidSegment):
        return Pose2.from_sequence(segment.spline.table[0, 1:4])
    return segment.pose if isinstance(segment, TurnSegment) else Pose2.from_sequence(segment.poses[0])


def piece_of(segment: Segment, begin: float, end: float) -> Segment:
    """Return the piece of a segment from `begin` to `end` [m], 0 <= begin < end <= length; its `s` starts at 0."""
    if begin <= 0.0 and end >= segment.length:
        return segment
    if isinstance(segment, ClothoidSegment):
        return ClothoidSegment(segment.spline.piece(begin, end))
    if isinstance(segment, TurnSegment):
        share = (end - begin) / segment.length
        return TurnSegment(Pose2.from_sequence(segment.poses_at(begin)[0]), share * segment.turn)
    inside = (segment.knots > begin) & (segment.knots < end)
    poses = np.concatenate((segment.poses_at(begin), segment.poses[inside], segment.poses_at(end)))
    return PolylineSegment(poses, segment.direction)


def moved_segment(segment: Segment, move: Pose2) -> Segment:
    """Return a segment transformed by a rigid motion of the plane: every pose p becomes `move @ p`."""
    if isinstance(segment, ClothoidSegment):
        spline = segment.spline
        return ClothoidSegment(ClothoidSpline(move @ spline.start, spline.knots, spline.curvature, spline.sign))
    if isinstance(segment, TurnSegment):
        return TurnSegment(move @ segment.pose, segment.turn)
    at = transform_points(move.as_array()[None], segment.poses[:, :2])[0]
    return PolylineSegment(np.column_stack((at, segment.poses[:, 2] + move.yaw)), segment.direction)


def _step_arcs(poses: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the turn [rad] and arc length [m] of every step."""
    dx, dy, turn = (poses[1:] - poses[:-1]).T
    chord, swept = np.hypot(dx, dy), np.abs(turn)
    half = np.pi * (np.minimum(0.5 * swept, 0.5 * np.pi) / np.pi)
    half[half == 0.0] = 1e-20  # the limit of the ratio of half and sine
    arc = chord / (np.sin(half) / half)
    turn[(swept <= SAME_YAW) & (arc <= 0.0)] = 0.0
    arc[chord <= SAME_POSITION] = 0.0
    return turn, arc


def _step_curvature(turn: FloatArray, arc: FloatArray) -> FloatArray:
    """Return turn / arc of every step, infinite for steps without length that turn. Shape (n,) [1/m]."""
    stands = arc == 0.0
    ratio: FloatArray = turn / np.where(stands, 1.0, arc)
    ratio[stands] = np.copysign(np.inf, turn[stands])
    ratio[turn == 0.0] = 0.0
    return ratio
