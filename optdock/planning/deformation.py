"""Deformation of the rest of a path to a new start and goal, with the least change of its curvature.

Consider a path with curvature k(s) in each gear. To first order, a change dk ds at s turns the rest of the path about
the point p(s), and moves the end by

    d(end) = dk ds * (-(y_end - y(s)), x_end - x(s), 1),

where (x, y) is the point p. A longer gear moves the rest of the path along its direction, and a larger turn in place
turns the rest about the robot. Gauss-Newton steps are repeated until the gap is closed. Each step computes the change
of least weighted norm that closes the gap in this linear model within the bounds of curvature and curvature rate, and
then the exact path. The norm weights the curvature rate, which determines the yaw acceleration.

A path that comes too close to an obstacle is pushed away in the same way, by constraints on points of the robot.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.errors import InvalidValue
from optdock.geometry.arrays import readonly
from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.pose import Pose2, normalize_angle, transform_points
from optdock.geometry.separation import separation
from optdock.model.path import Path
from optdock.model.segments import ClothoidSegment, TurnSegment
from optdock.quadratic_program import UNBOUNDED, DenseProgram

if TYPE_CHECKING:
    from collections.abc import Sequence

    from optdock.geometry.arrays import FloatArray
    from optdock.geometry.separation import ConvexBody, ConvexPieces
    from optdock.model.limits import MotionLimits
    from optdock.model.problem import DockingProblem
    from optdock.model.segments import Segment
    from optdock.verification import Violation

__all__ = ["Push", "deformed", "push_off"]

_ROOM = 0.005  # [m]: additional distance of a push, because the nearest point moves along the path
_CLOSED = 2e-7  # [m], [rad]: a fifth of the certificate's tolerance
_FLAT = 1e-6  # [m]: tolerance of corners of an edge along an obstacle
_PUSHED = 1e-4  # [m]: tolerance of pushes
_STEPS = 8  # of Gauss-Newton; a gap of decimetres takes four
_LEAST_PIECES = 12  # of a gear
_SHORTEST_PIECE = 0.01  # [m]: shorter pieces are not divided
_LENGTH_PRICE = 0.5  # of a relative change of length; a change of curvature by its limit over 1 m costs `_BEND_PRICE`
_BEND_PRICE = 0.3
_ALL = 1_000_000  # gears
_USED = 0.999  # share of the bounds that the program uses
_SLOW = 0.3  # least speed in a bend as share of the speed at the start
_USED_BY_BENDS = 0.8  # share of the yaw acceleration for bends; the rest is for acceleration in them
_LEAST_TURN = 1e-3  # [rad]: smaller turns in place vanish
_MOST_STRETCH = 0.3  # largest relative change of length per step, for the validity of the linear model
_USUAL_SWING = 0.25  # [m]: length over which the curvature changes by its bound, without a limit of its rate
# Three Gauss points on [0, 1]: exact for a hat function times a quadratic.
_NODES, _WEIGHTS = (readonly(part) for part in np.array(np.polynomial.legendre.leggauss(3)) / 2.0 + [[0.5], [0.0]])


class _GearPiece(NamedTuple):
    """One gear, or one turn in place, to be deformed.

    `knots`: knots of the free part, Shape (n,) [m], first 0. `curvature`: curvature at the knots, Shape (n,) [1/m].
    `tail`: length of the straight line after the free part [m]. `sign`: 1, -1, or 0 for a turn in place. `turn`: angle
    of a turn in place [rad].
    """

    knots: FloatArray
    curvature: FloatArray
    tail: float
    sign: int
    turn: float = 0.0

    @property
    def size(self) -> int:
        """Number of variables: the curvatures and the length, or the angle of the turn."""
        return self.curvature.size + 1 if self.sign else 1

    def changed(self, change: FloatArray) -> _GearPiece:
        """Return the gear with changed variables; the last variable is the change of the logarithm of the length."""
        if self.sign == 0:
            return self._replace(turn=self.turn + float(change[0]))
        return self._replace(knots=self.knots * math.exp(float(change[-1])), curvature=self.curvature + change[:-1])

    def segment(self, start: Pose2) -> Segment:
        """Return the exact curve that begins at a pose."""
        if self.sign == 0:
            return TurnSegment(start, self.turn)
        knots, curvature = self.knots, self.curvature
        if self.tail > 0.0:
            knots, curvature = np.append(knots, knots[-1] + self.tail), np.append(curvature, 0.0)
        return ClothoidSegment(ClothoidSpline(start, knots, curvature, self.sign))


class Push(NamedTuple):
    """A required distance from an obstacle at a point of the path.

    Attributes:
        gear: Index of the segment.
        share: Position along the segment as a share of its length, 0 to 1.
        body: The convex piece of the robot that comes too close.
        piece: The convex obstacle.
        distance: Required distance [m].
    """

    gear: int
    share: float
    body: ConvexBody
    piece: ConvexPieces
    distance: float


class _Contact(NamedTuple):
    """Nearest point of the robot (2,) [m], unit normal away from the obstacle (2,), and missing clearance [m]."""

    place: FloatArray
    normal: FloatArray
    short: float


def deformed(  # noqa: PLR0913 - a path, its new ends, and bounds
    path: Path,
    start: Pose2,
    goal: Pose2,
    limits: MotionLimits,
    *,
    final_straight: float = 0.0,
    steers: bool = True,
    speed: float = 0.0,
    pushes: Sequence[Push] = (),
) -> Path | None:
    """Return a path near `path` from `start` to `goal` in the same gears, or None if no such path is within the bounds.

    Clearance is not checked.

    Args:
        path: The rest of a path, of clothoids and turns in place.
        start: New start.
        goal: New goal.
        limits: Bounds of curvature and curvature rate.
        final_straight: Length of the straight run at the end [m].
        steers: Whether the curvature at the start is fixed, because the robot is in motion or its steering rate is
            limited.
        speed: Speed at the start, >= 0 [m/s]. While the robot brakes from this speed, the limits of yaw acceleration
            and steering rate bound the curvature rate.
        pushes: Required distances from obstacles.
    """
    gears = _gears(path, final_straight)
    if gears is None:
        return None
    program = _Program(gears, limits, speed, steers=steers)
    for _ in range(_STEPS):
        driven = _driven(gears, start)
        if driven is None:
            return None
        segments, end = driven
        gap = np.array([goal.x - end[0], goal.y - end[1], normalize_angle(goal.yaw - float(end[2]))])
        contacts = [_contact(push, segments) for push in pushes]
        short = max((contact.short for contact in contacts), default=0.0)
        if float(np.abs(gap).max()) <= _CLOSED and short <= _PUSHED and program.keeps_bounds(gears):
            return Path(segments, path.frame)
        change = program.least_change(gears, driven, gap, list(zip(pushes, contacts, strict=True)))
        if change is None:
            return None
        gears = [gear.changed(part) for gear, part in zip(gears, change, strict=True)]
    return None


def _gears(path: Path, final_straight: float) -> list[_GearPiece] | None:
    """Return the gears with enough knots, or None if a segment has a different class or is too short."""
    gears = []
    for segment in path.segments:
        if isinstance(segment, TurnSegment):
            gears.append(_GearPiece(segment.knots, np.zeros(0), 0.0, 0, segment.turn))
        elif isinstance(segment, ClothoidSegment):
            tail = final_straight if segment is path.segments[-1] else 0.0
            free = segment.length - tail
            if free <= 2.0 * _SHORTEST_PIECE:
                return None
            knots = _refined(segment.knots, free)
            gears.append(_GearPiece(knots, segment.curvature_at(knots), tail, segment.spline.sign))
        else:
            return None
    return gears


def _refined(knots: FloatArray, length: float) -> FloatArray:
    """Return the knots before `length`, `length` itself, and additional knots between distant knots."""
    kept = knots[(knots > 0.0) & (knots < length)]
    apart = 0.1 * _SHORTEST_PIECE  # closer knots add a rate constraint without a degree of freedom
    kept = kept[(kept > apart) & (kept < length - apart)]
    ends = np.concatenate(([0.0], kept, [length]))
    steps = np.diff(ends)
    parts = np.ceil(steps / max(length / _LEAST_PIECES, _SHORTEST_PIECE)).astype(np.int64)
    pieces = [np.linspace(a, b, n, endpoint=False) for a, b, n in zip(ends[:-1], ends[1:], parts, strict=True)]
    return np.append(np.concatenate(pieces), length)


def _driven(gears: list[_GearPiece], start: Pose2) -> tuple[tuple[Segment, ...], FloatArray] | None:
    """Return the exact curves that begin at a pose, and their last pose, Shape (3,).

    Returns None if a turn vanishes or a curve cannot be evaluated.
    """
    segments: list[Segment] = []
    end = start.as_array()
    for gear in gears:
        if gear.sign == 0 and abs(gear.turn) < _LEAST_TURN:
            return None
        try:
            segments.append(gear.segment(start))
        except InvalidValue:
            return None
        end = segments[-1].poses_at(segments[-1].length)[0]
        start = Pose2.from_sequence(end)
    return tuple(segments), end


def _contact(push: Push, segments: tuple[Segment, ...]) -> _Contact:
    """Return the contact of a push on the current path."""
    segment = segments[push.gear]
    pose = segment.poses_at(push.share * segment.length)
    found = separation(push.body, pose, push.piece)
    normal = found.axis[0]
    corners = transform_points(pose, push.body.vertices)[0]
    heights = corners @ normal
    nearest = np.flatnonzero(heights <= heights.min() + _FLAT)
    place = corners[nearest[0]]
    if nearest.size > 1:  # an edge: the point next to the nearest corner of the obstacle
        outline = np.column_stack((push.piece.x[:, 0], push.piece.y[:, 0]))
        corner, edge = outline[np.argmax(outline @ normal)], corners[nearest[-1]] - place
        place = place + edge * min(max(float((corner - place) @ edge) / float(edge @ edge), 0.0), 1.0)
    return _Contact(place, normal, push.distance - float(found.distance[0]))


def _rates_at_speed(gear: _GearPiece, limits: MotionLimits, speed: float) -> FloatArray:
    """Return the largest curvature rate over every piece of a gear while braking from `speed`, Shape (n - 1,)."""
    left = speed * speed - 2.0 * limits.max_deceleration * gear.knots[:-1]
    speeds = np.sqrt(np.maximum(left, (_SLOW * speed) ** 2))
    turning = _USED_BY_BENDS * limits.max_yaw_acceleration / speeds**2
    if not math.isfinite(limits.max_steering_rate):
        return turning
    return np.minimum(turning, _USED_BY_BENDS * limits.max_steering_rate / (limits.wheelbase * speeds))


class _Program:
    """Quadratic program of a step, whose solution is the least change that closes the gap within the bounds."""

    def __init__(self, gears: list[_GearPiece], limits: MotionLimits, speed: float, *, steers: bool) -> None:
        sharpest = max((float(np.abs(gear.curvature).max()) for gear in gears if gear.sign), default=0.0)
        self.most = limits.max_curvature * _USED
        self.scale = limits.max_curvature if math.isfinite(limits.max_curvature) else max(sharpest, 1.0)
        rate = limits.max_curvature_rate
        self.rate_scale = rate if math.isfinite(rate) else self.scale / _USUAL_SWING
        self.starts = np.concatenate(([0], np.cumsum([gear.size for gear in gears])))
        self.size = int(self.starts[-1])
        most_rates = [np.full(gear.knots.size - 1 if gear.sign else 0, rate * _USED) for gear in gears]
        if speed > 0.0 and gears[0].sign:
            first = np.abs(np.diff(gears[0].curvature) / np.diff(gears[0].knots))
            most_rates[0] = np.minimum(most_rates[0], np.maximum(_rates_at_speed(gears[0], limits, speed), first))
        self.most_rates = np.concatenate(most_rates)
        self.fixed: list[tuple[int, float]] = []
        if steers and gears[0].sign:
            self.fixed.append((0, float(gears[0].curvature[0])))
        if gears[-1].sign:
            self.fixed.append((self.size - 2, 0.0 if gears[-1].tail > 0.0 else float(gears[-1].curvature[-1])))
        shaped = [np.arange(gear.curvature.size) for gear in gears]
        self.places = np.concatenate([b + at for b, at in zip(self.starts.tolist(), shaped, strict=False)]).astype(int)
        self.program: DenseProgram | None = None  # built on first use, for all steps
        self.price = np.zeros((self.size, self.size))
        for begin, gear in zip(self.starts.tolist(), gears, strict=False):
            self.price[begin : begin + gear.size, begin : begin + gear.size] = self._price(gear)

    def keeps_bounds(self, gears: list[_GearPiece]) -> bool:
        """Whether the curvature and its rates are within their bounds."""
        curvature, rates, _ = self._bounded(gears)
        slack = 1.0 / _USED
        return bool(np.all(np.abs(curvature) <= slack * self.most) and np.all(np.abs(rates) <= slack * self.most_rates))

    def _bounded(self, gears: list[_GearPiece]) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return all curvatures, all rates, and the derivatives of the rates."""
        curvature = np.concatenate([gear.curvature for gear in gears])
        rates, rows = [], np.zeros((self.most_rates.size, self.size))
        count = 0
        for begin, gear in zip(self.starts.tolist(), gears, strict=False):
            if gear.sign == 0:
                continue
            steps, n = np.diff(gear.knots), gear.curvature.size
            found = np.diff(gear.curvature) / steps
            at = np.arange(n - 1)
            rows[count + at, begin + at], rows[count + at, begin + at + 1] = -1.0 / steps, 1.0 / steps
            rows[count + at, begin + n] = -found  # the same turn over a longer gear
            rates.append(found)
            count += n - 1
        return curvature, np.concatenate(rates) if rates else np.zeros(0), rows

    def least_change(
        self,
        gears: list[_GearPiece],
        driven: tuple[tuple[Segment, ...], FloatArray],
        gap: FloatArray,
        pushes: list[tuple[Push, _Contact]],
    ) -> list[FloatArray] | None:
        """Return the changes of least cost that close the gap subject to pushes and bounds, one per gear, or None."""
        segments, end = driven
        curvature, rates, rate_rows = self._bounded(gears)
        if self.program is None:
            self.program = DenseProgram(self.size, 3 + rates.size + len(pushes))
            self.program.h[:] = self.price
        program, pushed = self.program, 3 + rates.size
        room = min(self.most, UNBOUNDED)
        program.lbx[self.places], program.ubx[self.places] = -room - curvature, room - curvature
        for i, value in self.fixed:
            program.lbx[i] = program.ubx[i] = value - curvature[np.searchsorted(self.places, i)]
        program.a[:3] = self._moves(gears, segments, end)
        program.lba[:3] = program.uba[:3] = gap
        most_rates = np.minimum(self.most_rates, UNBOUNDED)
        program.a[3:pushed] = rate_rows
        program.lba[3:pushed], program.uba[3:pushed] = -most_rates - rates, most_rates - rates
        for row, (push, contact) in enumerate(pushes, pushed):
            place = push.gear, push.share
            program.a[row] = contact.normal @ self._moves(gears, segments, contact.place, place)[:2]
            program.lba[row] = contact.short
        change = program.solve()
        lengths = self.starts[1:][[gear.sign != 0 for gear in gears]] - 1
        if change is None or np.any(np.abs(change[lengths]) > _MOST_STRETCH):
            return None
        return np.split(change, self.starts[1:-1])

    def _price(self, gear: _GearPiece) -> FloatArray:
        """Return the matrix of the quadratic cost for changing the variables of a gear."""
        if gear.sign == 0:
            return np.array([[1.0]])
        steps, n = np.diff(gear.knots), gear.curvature.size
        swing = np.diff(np.eye(n), axis=0) / np.sqrt(steps)[:, None] / self.rate_scale
        width = 0.5 * (np.append(steps, 0.0) + np.append(0.0, steps))
        price = np.zeros((n + 1, n + 1))
        price[:n, :n] = swing.T @ swing + np.diag(_BEND_PRICE * width / self.scale**2)
        price[n, n] = _LENGTH_PRICE * gear.knots[-1]
        return price

    def _moves(
        self,
        gears: list[_GearPiece],
        segments: tuple[Segment, ...],
        end: FloatArray,
        until: tuple[int, float] = (_ALL, 1.0),
    ) -> FloatArray:
        """Return the derivatives of a point of the robot with respect to all variables, Shape (3, variables)."""
        columns = []
        for i, (gear, segment) in enumerate(zip(gears, segments, strict=True)):
            if i > until[0]:
                columns.append(np.zeros((3, gear.size)))
                continue
            share = until[1] if i == until[0] else 1.0
            if gear.sign == 0:
                x, y, _ = segment.poses_at(0.0)[0]
                columns.append(share * np.array([[y - end[1]], [end[0] - x], [1.0]]))
                continue
            steps, last_s = np.diff(gear.knots), share * segment.length
            s = (gear.knots[:-1, None] + steps[:, None] * _NODES).ravel()
            poses = segment.poses_at(np.append(s, [0.0, min(gear.knots[-1], last_s)]))
            poses, (first, last) = poses[:-2], poses[-2:]
            turned = np.stack((poses[:, 1] - end[1], end[0] - poses[:, 0], np.ones(s.size)))
            weights = np.repeat(steps, _NODES.size) * np.tile(_WEIGHTS, steps.size) * (s <= last_s)
            weighted = (turned * weights).reshape(3, steps.size, _NODES.size)
            bends = np.zeros((3, gear.curvature.size))
            bends[:, :-1] += weighted @ (1.0 - _NODES)
            bends[:, 1:] += weighted @ _NODES
            # Derivative by the logarithm of the length: the turns and the travelled distance grow in proportion.
            longer = bends @ gear.curvature + np.array([*(last - first)[:2], 0.0])
            columns.append(np.column_stack((bends, longer)))
        return np.concatenate(columns, axis=1)


def push_off(violation: Violation, path: Path, problem: DockingProblem) -> Push:
    """Return the push that moves the robot away from the obstacle of a clearance violation."""
    pose = path.poses_at(violation.s)[0]
    reach = problem.robot.footprint.circumscribed_radius + problem.path_clearance.required
    near = problem.all_obstacles.near(pose[None, :2], reach)
    rows = np.arange(len(near))
    poses = np.tile(pose, (rows.size, 1))
    body, found = min(
        ((body, separation(body, poses, near.pieces(rows))) for body in problem.robot.footprint.bodies),
        key=lambda one: float(one[1].distance.min()),
    )
    row = int(np.argmin(found.distance))
    distance = float(found.distance[row]) + violation.amount + _ROOM
    gear = int(np.clip(np.searchsorted(path.segment_starts, violation.s, side="right") - 1, 0, len(path.segments) - 1))
    share = (violation.s - float(path.segment_starts[gear])) / path.segments[gear].length
    return Push(gear, min(max(share, 0.0), 1.0), body, near.pieces(np.array([row])), distance)
