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
from optdock.geometry.clothoid import ClothoidSpline, subdivided
from optdock.geometry.pose import Pose2, normalize_angle, transform_points
from optdock.geometry.separation import separation
from optdock.kernels import Kernel, twin_of
from optdock.model.path import Path
from optdock.model.segments import ClothoidSegment, TurnSegment
from optdock.quadratic_program import EXACT, UNBOUNDED, DenseProgram, QuadraticProgram, minimizer
from optdock.verification import TOLERANCE, compiled_clearances

if TYPE_CHECKING:
    from collections.abc import Sequence

    from optdock.geometry.arrays import FloatArray, IntArray
    from optdock.geometry.separation import ConvexBody, ConvexPieces
    from optdock.model.limits import MotionLimits
    from optdock.model.problem import DockingProblem
    from optdock.model.segments import Segment
    from optdock.verification import Violation

__all__ = ["Push", "deformed", "push_off", "pushes_off"]

_ROOM = 0.005  # [m]: additional distance of a push, because the nearest point moves along the path
_CLOSED = 2e-7  # [m], [rad]: a fifth of the certificate's tolerance
_FLAT = 1e-6  # [m]: tolerance of corners of an edge along an obstacle
_PUSHED = 1e-4  # [m]: tolerance of pushes
_SPACING = 0.02  # [m] between the poses whose clearance is checked
_MOST_AT_ONCE = 8  # pushes: along a wall of map cells there is one per cell, which each takes 0.1 ms per step
_STEPS = 8  # of Gauss-Newton; a gap of decimetres takes four
_LEAST_PIECES = 12  # of a gear
_SHORTEST_PIECE = 0.01  # [m]: shorter pieces are not divided
_LENGTH_PRICE = 0.5  # of a relative change of length; a change of curvature by its limit over 1 m costs `_BEND_PRICE`
_BEND_PRICE = 0.3
_USED = 0.999  # share of the bounds that the program uses
_SLOW = 0.3  # least speed in a bend as share of the speed at the start
_USED_BY_BENDS = 0.8  # share of the yaw acceleration for bends; the rest is for acceleration in them
_LEAST_TURN = 1e-3  # [rad]: smaller turns in place vanish
_MOST_STRETCH = 0.3  # largest change of the logarithm of a length per step, for the validity of the linear model
# Shortening: most steps; relative change of the length in the last step; largest change of the logarithm of a length
# per step, halved where the next step fails; price of a metre, which is high enough for such changes.
_SHORTENINGS, _SAME_LENGTH, _MOST_SHORTENED, _LENGTH_GAIN = 8, 0.01, 0.9, 10.0
_SHORTEST_GEAR = 2.05 * _SHORTEST_PIECE  # shorter gears cannot be deformed again
_USUAL_SWING = 0.25  # [m]: length over which the curvature changes by its bound, without a limit of its rate
# Three Gauss points on [0, 1]: exact for a hat function times a quadratic. The positions at these points and at the end
# of the piece are integrated from one to the next by four Gauss points on [-1, 1].
_NODES, _WEIGHTS = (readonly(part) for part in np.array(np.polynomial.legendre.leggauss(3)) / 2.0 + [[0.5], [0.0]])
_BORDERS = readonly(np.append(_NODES, 1.0))
_PLACES, _RULE = map(readonly, np.polynomial.legendre.leggauss(4))


class _Gears(NamedTuple):
    """Gears and turns in place of a path that is deformed, m in number, with n knots.

    The variables of a gear are its curvatures at the knots and the logarithm of its length, that of a turn in place is
    its angle: knot j of gear i has variable i + j, and the last variable of gear i is `first[i + 1] + i`.

    `signs`: 1, -1, or 0 for a turn in place, Shape (m,). `tails`: lengths of the straight lines at the ends of the
    gears, Shape (m,) [m]. `turns`: angles of the turns in place, Shape (m,) [rad]. `first`: index of the first knot of
    each gear, and n, Shape (m + 1,). `knots`: knots of the gears before their straight lines, from 0 in each gear,
    Shape (n,) [m]. `curvature`: Shape (n,) [1/m].
    """

    signs: FloatArray
    tails: FloatArray
    turns: FloatArray
    first: IntArray
    knots: FloatArray
    curvature: FloatArray

    @property
    def ends(self) -> FloatArray:
        """Lengths of the gears before their straight lines, 0 for turns in place, Shape (m,) [m]."""
        return self.knots[self.first[1:] - 1] * (self.signs != 0.0) if self.knots.size else np.zeros(self.signs.size)

    @property
    def length(self) -> float:
        """Sum of these lengths [m]."""
        return float(self.ends.sum())

    @classmethod
    def of(cls, path: Path, final_straight: float) -> _Gears | None:
        """Return the gears with enough knots, or None if a segment has a different class or is too short."""
        signs, tails, turns, knots, curvature = (
            list[float](),
            list[float](),
            list[float](),
            [np.zeros(0)],
            [np.zeros(0)],
        )
        for segment in path.segments:
            is_turn = isinstance(segment, TurnSegment)
            tails.append(final_straight if segment is path.segments[-1] and not is_turn else 0.0)
            if isinstance(segment, TurnSegment):
                signs.append(0.0)
                turns.append(segment.turn)
                continue
            free = segment.length - tails[-1]
            if not isinstance(segment, ClothoidSegment) or free <= 2.0 * _SHORTEST_PIECE:
                return None
            signs.append(float(segment.spline.sign))
            turns.append(0.0)
            knots.append(_refined(segment.knots, free))
            curvature.append(segment.curvature_at(knots[-1]))
        counts = np.zeros(len(signs) + 1, dtype=np.int64)
        counts[1:][np.array(signs) != 0.0] = [one.size for one in knots[1:]]
        rows = np.array((signs, tails, turns))
        return cls(rows[0], rows[1], rows[2], counts.cumsum(), np.concatenate(knots), np.concatenate(curvature))

    def path(self, start: Pose2, frame: str) -> Path | None:
        """Return the exact curves that begin at a pose, or None if a curve cannot be evaluated."""
        segments: list[Segment] = []
        for i, (sign, tail) in enumerate(zip(self.signs.tolist(), self.tails.tolist(), strict=True)):
            if sign == 0.0:
                turn = TurnSegment(start, float(self.turns[i]))
                segments.append(turn)
                start = turn.end
                continue
            own = slice(*self.first[i : i + 2].tolist())
            knots, curvature = self.knots[own], self.curvature[own]
            if tail > 0.0:
                knots, curvature = np.append(knots, knots[-1] + tail), np.append(curvature, 0.0)
            try:
                spline = ClothoidSpline(start, knots, curvature, int(sign))
            except InvalidValue:
                return None
            segments.append(ClothoidSegment(spline))
            start = spline.end
        return Path(tuple(segments), frame)


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


class _Pushes(NamedTuple):
    """k pushes, and the same pushes as arrays for the kernel.

    `sizes`: gear, and numbers of corners of body and obstacle, Shape (k, 3). `numbers`: share, distance, and the arrays
    of body and obstacle of each, one after the other, Shape (p,). `corners`: largest sum of both numbers of corners.
    """

    given: Sequence[Push]
    sizes: IntArray
    numbers: FloatArray
    corners: int

    @classmethod
    def of(cls, pushes: Sequence[Push]) -> _Pushes | None:
        """Return the pushes with their arrays for the kernel, or None if there are no pushes."""
        if not pushes:
            return None
        sizes = np.array([(one.gear, len(one.body.vertices), len(one.piece.x)) for one in pushes], dtype=np.int64)
        parts: list[FloatArray | tuple[float, float]] = []
        for one in pushes:
            parts += ((one.share, one.distance), *[part.ravel() for part in (*one.body, *one.piece)])
        return cls(pushes, sizes, np.concatenate(parts), int(sizes[:, 1:].sum(axis=1).max()))


class _Contacts(NamedTuple):
    """Derivatives of the clearances by all variables, Shape (k, m + n), and missing clearances, Shape (k,) [m]."""

    moves: FloatArray
    short: FloatArray


def deformed(  # noqa: PLR0913 - a path, its new ends, and bounds
    path: Path,
    start: Pose2,
    goal: Pose2,
    limits: MotionLimits,
    *,
    final_straight: float = 0.0,
    steers: bool = True,
    speed: float = 0.0,
    least: float = 0.0,
    pushes: Sequence[Push] = (),
    shortens: bool = False,
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
        least: Least length of the first segment, in which the robot stops if more segments follow [m].
        pushes: Required distances from obstacles.
        shortens: Whether the gears are first shortened as far as the bounds permit, from a path that is longer than
            necessary.
    """
    gears = _Gears.of(path, final_straight)
    if gears is None:
        return None
    program, begin = _Program(gears, limits, speed, len(pushes), steers=steers), start.as_array()
    pushed = _Pushes.of(pushes)
    program.least, length, before = least, math.inf, None
    for step in range(_SHORTENINGS + _STEPS if shortens else _STEPS):
        if program.has_vanished(gears):
            return None
        if shortens:
            was, length = length, gears.length
            shortens = step < _SHORTENINGS and abs(length - was) > _SAME_LENGTH * length
        drive = _driven(gears, begin)
        x, y, yaw = drive.borders[-1].tolist()
        gap = goal.x - x, goal.y - y, normalize_angle(goal.yaw - yaw)
        contacts = None if pushed is None else _contacts(pushed, gears, drive)
        is_pushed = contacts is None or contacts.short.max() <= _PUSHED
        is_closed = max(map(abs, gap)) <= _CLOSED and is_pushed and not shortens
        if is_closed and program.keeps_bounds(gears):
            return gears.path(start, path.frame)
        changed = program.with_least_change(gears, drive, gap, contacts, shortens=shortens)
        if changed is not None:
            before, gears = gears, changed
        elif shortens and before is not None:  # the lengths have become too short in one step
            gears, length, program.most_shortened = before, math.inf, 0.5 * program.most_shortened
        else:
            return None
    return None


def _refined(knots: FloatArray, length: float) -> FloatArray:
    """Return the knots before `length`, `length` itself, and additional knots between distant knots."""
    kept = knots[(knots > 0.0) & (knots < length)]
    apart = 0.1 * _SHORTEST_PIECE  # closer knots add a rate constraint without a degree of freedom
    kept = kept[(kept > apart) & (kept < length - apart)]
    ends = np.concatenate(([0.0], kept, [length]))
    steps = np.diff(ends)
    parts = np.ceil(steps / max(length / _LEAST_PIECES, _SHORTEST_PIECE)).astype(np.int64)
    return subdivided(ends, parts)


class _Drive(NamedTuple):
    """Poses of gears: at their borders, Shape (m + 1, 3), and at the knots, Shape (n, 3).

    `at_nodes`: positions at the Gauss nodes of the piece behind each knot, Shape (n, 3, 2) [m]; 0 behind the last knot
    of a gear.
    """

    borders: FloatArray
    at_knots: FloatArray
    at_nodes: FloatArray


_POSES = Kernel("optdock_deformed_poses", sizes=2, numbers=0)
_MOVES = Kernel("optdock_deformation_moves", sizes=3, numbers=6)
_CONTACTS = Kernel("optdock_deformation_contacts", sizes=5, numbers=1)


def _driven_native(gears: _Gears, start: FloatArray) -> _Drive:
    (m, n), rule = (gears.signs.size, gears.knots.size), _PLACES.size
    drive = _Drive(np.empty((m + 1, 3)), np.empty((n, 3)), np.empty((n, 3, 2)))
    arrays = (*zip(gears, (m, m, m, m + 1, n, n), strict=True), (start, 3), (_BORDERS, 4))
    rules = (_PLACES, rule), (_RULE, rule)
    _POSES((m, n), (), (*arrays, *rules, *zip(drive, (3 * m + 3, 3 * n, 6 * n), strict=True)))
    return drive


@twin_of(_driven_native)
def _driven(gears: _Gears, start: FloatArray) -> _Drive:
    """Return the poses of gears that begin at a pose, Shape (3,)."""
    m, n = gears.signs.size, gears.knots.size
    borders, at_knots, at_nodes = np.empty((m + 1, 3)), np.empty((n, 3)), np.zeros((n, 3, 2))
    pose = start.copy()
    for i, (sign, tail, turn) in enumerate(zip(gears.signs, gears.tails, gears.turns, strict=True)):
        borders[i] = pose
        pose[2] += turn
        first, last = gears.first[i : i + 2]
        if first == last:
            continue
        knots, curvature = gears.knots[first:last], gears.curvature[first:last]
        step = np.diff(knots)
        yaw = np.concatenate(([0.0], 0.5 * step * (curvature[:-1] + curvature[1:])))
        yaw[0] = pose[2]
        yaw = yaw.cumsum()
        # Each piece is integrated from node to node.
        ends = step[:, None] * np.concatenate(([0.0], _BORDERS))
        half, middle = 0.5 * np.diff(ends, axis=1), 0.5 * (ends[:, :-1] + ends[:, 1:])
        u = middle[..., None] + half[..., None] * _PLACES
        slope = 0.5 * (np.diff(curvature) / step)[:, None, None]
        heading = yaw[:-1, None, None] + u * (curvature[:-1, None, None] + slope * u)
        moved = np.stack([(sign * half * (part(heading) @ _RULE)).ravel() for part in (np.cos, np.sin)], axis=1)
        reached = np.concatenate((pose[None, :2], moved)).cumsum(axis=0)
        at_knots[first:last] = np.column_stack((reached[:: _BORDERS.size], yaw))
        at_nodes[first : last - 1] = reached[1:].reshape(-1, _BORDERS.size, 2)[:, :-1]
        pose = at_knots[last - 1] + sign * tail * np.array([math.cos(yaw[-1]), math.sin(yaw[-1]), 0.0])
    borders[m] = pose
    return _Drive(borders, at_knots, at_nodes)


class _Place(NamedTuple):
    """A point of the robot, Shape (2,) [m], at a place on the path.

    `gear`: index of the gear. `share`: driven share of the gear. `driven`: distance driven in it [m]. `robot`: position
    of the robot, at most at the last knot of the gear [m].
    """

    point: tuple[float, float]
    gear: int
    share: float
    driven: float
    robot: tuple[float, float]


def _moves_native(gears: _Gears, drive: _Drive, place: _Place) -> FloatArray:
    m, n = gears.signs.size, gears.knots.size
    found = np.empty((3, m + n))
    arrays = (
        *((gears.signs, m), (gears.first, m + 1), (gears.knots, n), (gears.curvature, n)),
        *zip(drive, (3 * m + 3, 3 * n, 6 * n), strict=True),
        *((_BORDERS, 4), (_WEIGHTS, 3), (found, found.size)),
    )
    _MOVES((m, n, place.gear), (*place.point, place.share, place.driven, *place.robot), arrays)
    return found


@twin_of(_moves_native)
def _moves(gears: _Gears, drive: _Drive, place: _Place) -> FloatArray:
    """Return the derivatives of a point of the robot by all variables (D3), Shape (3, m + n)."""
    found, (x, y) = np.zeros((3, gears.signs.size + gears.knots.size)), place.point
    for i in range(place.gear + 1):
        (first, last), border, is_last = gears.first[i : i + 2], drive.borders[i], i == place.gear
        if gears.signs[i] == 0.0:
            found[:, last + i] = (place.share if is_last else 1.0) * np.array([border[1] - y, x - border[0], 1.0])
            continue
        knots, at = gears.knots[first:last], drive.at_nodes[first : last - 1]
        step = np.diff(knots)[:, None]
        weights = step * _WEIGHTS
        if is_last:
            weights = weights * (knots[:-1, None] + step * _NODES <= place.driven)
        turned = weights * np.stack((at[..., 1] - y, x - at[..., 0], np.ones(weights.shape)))
        bends = found[:, first + i : last + i]
        bends[:, :-1] += turned @ (1.0 - _NODES)
        bends[:, 1:] += turned @ _NODES
        # By the logarithm of the length, the turns and the travelled distance grow in proportion.
        found[:, last + i] = bends @ gears.curvature[first:last]
        found[:2, last + i] += (place.robot if is_last else drive.at_knots[last - 1, :2]) - border[:2]
    return found


def _pose_at(gears: _Gears, drive: _Drive, gear: int, share: float) -> tuple[FloatArray, float]:
    """Return the pose at a share of the length of a gear, Shape (3,), and the distance driven in the gear [m]."""
    if gears.signs[gear] == 0.0:
        return drive.borders[gear] + np.array([0.0, 0.0, share * gears.turns[gear]]), 0.0
    first, last = gears.first[gear : gear + 2].tolist()
    driven = share * float(gears.knots[last - 1] + gears.tails[gear])
    row = int(np.searchsorted(gears.knots[first:last], driven, side="right")) + first - 1
    pose, sign, step = drive.at_knots[row], float(gears.signs[gear]), driven - float(gears.knots[row])
    bend, slope = float(gears.curvature[row]), 0.0
    if row < last - 1:
        slope = (float(gears.curvature[row + 1]) - bend) / float(gears.knots[row + 1] - gears.knots[row])
    u = 0.5 * step * (1.0 + _PLACES)
    heading = pose[2] + u * (bend + 0.5 * u * slope)
    along, across = (0.5 * sign * step * float(part(heading) @ _RULE) for part in (np.cos, np.sin))
    return pose + np.array([along, across, step * (bend + 0.5 * step * slope)]), driven


def _contacts_native(pushes: _Pushes, gears: _Gears, drive: _Drive) -> _Contacts:
    m, n, k = gears.signs.size, gears.knots.size, len(pushes.given)
    found = _Contacts(np.empty((k, m + n)), np.empty(k))
    arrays = (
        *zip(gears, (m, m, m, m + 1, n, n), strict=True),
        *zip(drive, (3 * m + 3, 3 * n, 6 * n), strict=True),
        *((pushes.sizes, 3 * k), (pushes.numbers, pushes.numbers.size)),
        *((_BORDERS, 4), (_WEIGHTS, 3), (_PLACES, _PLACES.size), (_RULE, _RULE.size)),
        *((np.empty(work := 3 * (m + n) + 2 * pushes.corners), work), (found.moves, k * (m + n)), (found.short, k)),
    )
    _CONTACTS((m, n, k, pushes.numbers.size, pushes.corners), (_FLAT,), arrays)
    return found


@twin_of(_contacts_native)
def _contacts(pushes: _Pushes, gears: _Gears, drive: _Drive) -> _Contacts:
    """Return the contacts of pushes on the current path."""
    moves, short = zip(*(_contact(push, gears, drive) for push in pushes.given), strict=True)
    return _Contacts(np.array(moves), np.array(short))


def _contact(push: Push, gears: _Gears, drive: _Drive) -> tuple[FloatArray, float]:
    """Return the derivatives of the clearance by all variables, Shape (m + n,), and the missing clearance [m]."""
    pose, driven = _pose_at(gears, drive, push.gear, push.share)
    found = separation(push.body, pose[None], push.piece)
    normal = found.axis[0]
    corners = transform_points(pose[None], push.body.vertices)[0]
    heights = corners @ normal
    nearest = np.flatnonzero(heights <= heights.min() + _FLAT)
    point = corners[nearest[0]]
    if nearest.size > 1:  # an edge: the point next to the nearest corner of the obstacle
        outline = np.column_stack((push.piece.x[:, 0], push.piece.y[:, 0]))
        corner, edge = outline[np.argmax(outline @ normal)], corners[nearest[-1]] - point
        point = point + edge * min(max(float((corner - point) @ edge) / float(edge @ edge), 0.0), 1.0)
    last = int(gears.first[push.gear + 1]) - 1
    robot = drive.at_knots[last] if gears.signs[push.gear] != 0.0 and driven > gears.knots[last] else pose
    place = _Place(
        (float(point[0]), float(point[1])), push.gear, push.share, driven, (float(robot[0]), float(robot[1]))
    )
    moves = _moves(gears, drive, place)
    return normal[0] * moves[0] + normal[1] * moves[1], push.distance - float(found.distance[0])


def _rates_at_speed(knots: FloatArray, limits: MotionLimits, speed: float) -> FloatArray:
    """Return the largest curvature rate over every piece of a gear while braking from `speed`, Shape (n - 1,)."""
    left = speed * speed - 2.0 * limits.max_deceleration * knots[:-1]
    speeds = np.sqrt(np.maximum(left, (_SLOW * speed) ** 2))
    turning = _USED_BY_BENDS * limits.max_yaw_acceleration / speeds**2
    if not math.isfinite(limits.max_steering_rate):
        return turning
    return np.minimum(turning, _USED_BY_BENDS * limits.max_steering_rate / (limits.wheelbase * speeds))


class _Program:
    """Quadratic program of a step, whose solution is the least change that closes the gap within the bounds."""

    def __init__(self, gears: _Gears, limits: MotionLimits, speed: float, pushes: int, *, steers: bool) -> None:
        sharpest = float(np.abs(gears.curvature).max(initial=0.0))
        self.most_shortened = _MOST_SHORTENED
        self.least, self.most = 0.0, limits.max_curvature * _USED
        self.scale = limits.max_curvature if math.isfinite(limits.max_curvature) else max(sharpest, 1.0)
        rate = limits.max_curvature_rate
        self.rate_scale = rate if math.isfinite(rate) else self.scale / _USUAL_SWING
        m, n = gears.signs.size, gears.knots.size
        self.owner = np.arange(m).repeat(np.diff(gears.first))
        self.bends, self.lengths = np.arange(n) + self.owner, gears.first[1:] + np.arange(m)
        self.is_turn = gears.signs == 0.0
        self.left = np.flatnonzero(self.owner[1:] == self.owner[:-1])  # first knots of the pieces
        self.most_rates = np.full(self.left.size, rate * _USED)
        if speed > 0.0 and gears.signs[0] != 0.0:
            own = slice(0, int(gears.first[1]) - 1)
            first, bound = (
                np.abs(self._rates(gears))[own],
                _rates_at_speed(gears.knots[: gears.first[1]], limits, speed),
            )
            self.most_rates[own] = np.minimum(self.most_rates[own], np.maximum(bound, first))
        self.fixed = dict[int, float]()  # curvatures of knots
        if steers and gears.signs[0] != 0.0:
            self.fixed[0] = float(gears.curvature[0])
        if gears.signs[-1] != 0.0:
            self.fixed[n - 1] = 0.0 if gears.tails[-1] > 0.0 else float(gears.curvature[-1])
        self.size, self.pushed = m + n, 3 + self.left.size
        self.price, self.rows = self._price(gears), np.zeros((self.pushed + pushes, self.size))
        self.bounds = np.full((2, self.size + len(self.rows)), UNBOUNDED)
        self.bounds[0] = -UNBOUNDED
        known = [*(self.bends[list(self.fixed)] + 1), *range(self.size + 1, self.size + 4)]
        self.active = np.array(known, dtype=np.int64)  # of the last solution: at first the equations

    def _rates(self, gears: _Gears) -> FloatArray:
        """Return the curvature rates of the pieces [1/m^2]."""
        left = self.left
        return (gears.curvature[left + 1] - gears.curvature[left]) / (gears.knots[left + 1] - gears.knots[left])

    def _with_bounded_lengths(self, gears: _Gears, *, shortens: bool) -> FloatArray:
        """Set the bounds of the changes of length; return the linear cost of all variables, Shape (m + n,)."""
        (lower, upper), slope = self.bounds, np.zeros(self.size)
        most, own = self.most_shortened if shortens else _MOST_STRETCH, self.lengths[~self.is_turn]
        lower[own], upper[own] = -most, most
        if shortens:
            ends = gears.ends[~self.is_turn]
            slope[own] = _LENGTH_GAIN * ends
            lower[own] = np.maximum(-most, np.minimum(np.log(_SHORTEST_GEAR / ends), 0.0))
        if self.least > 0.0 and gears.signs[0] != 0.0:
            length, tail = float(gears.knots[gears.first[1] - 1]), float(gears.tails[0])
            first = math.log(min(max(self.least - tail, _SHORTEST_PIECE) / length, 1.0))
            lower[own[0]] = max(float(lower[own[0]]), first)
        return slope

    def has_vanished(self, gears: _Gears) -> bool:
        """Whether a turn in place is too small."""
        return any(is_turn and abs(turn) < _LEAST_TURN for is_turn, turn in zip(self.is_turn, gears.turns, strict=True))

    def keeps_bounds(self, gears: _Gears) -> bool:
        """Whether the curvature and its rates are within their bounds."""
        slack, rates = 1.0 / _USED, np.abs(self._rates(gears))
        return bool(np.all(np.abs(gears.curvature) <= slack * self.most) and np.all(rates <= slack * self.most_rates))

    def with_least_change(
        self,
        gears: _Gears,
        drive: _Drive,
        gap: tuple[float, float, float],
        contacts: _Contacts | None,
        *,
        shortens: bool,
    ) -> _Gears | None:
        """Return the gears with the change of least cost that closes the gap subject to pushes and bounds, or None."""
        rates, left, curvature = self._rates(gears), self.left, gears.curvature
        (lower, upper), rows, at = self.bounds, self.rows, np.arange(3, self.pushed)
        room, slope = min(self.most, UNBOUNDED), self._with_bounded_lengths(gears, shortens=shortens)
        lower[self.bends], upper[self.bends] = -room - curvature, room - curvature
        for knot, value in self.fixed.items():
            lower[self.bends[knot]] = upper[self.bends[knot]] = value - curvature[knot]
        (x, y, _), last = drive.borders[-1].tolist(), drive.at_knots[-1] if len(drive.at_knots) else drive.borders[0]
        whole = _Place((x, y), gears.signs.size - 1, 1.0, math.inf, (float(last[0]), float(last[1])))
        rows[:3] = _moves(gears, drive, whole)
        lower[self.size : self.size + 3] = upper[self.size : self.size + 3] = gap
        inverse, owner = 1.0 / (gears.knots[left + 1] - gears.knots[left]), self.lengths[self.owner[left]]
        rows[at, self.bends[left]], rows[at, self.bends[left + 1]] = -inverse, inverse
        rows[at, owner] = -rates  # the same turn over a longer gear
        most = np.minimum(self.most_rates, UNBOUNDED)
        lower[self.size + at], upper[self.size + at] = -most - rates, most - rates
        if contacts is not None:
            rows[self.pushed :], lower[self.size + self.pushed :] = contacts
        found = minimizer(QuadraticProgram(self.price, slope, rows, self.bounds, self.size, self.active, self.dense))
        if found is None:
            return None
        self.active, change = found.active, found.solution
        stretch = change[self.lengths]
        turns = gears.turns + np.where(self.is_turn, stretch, 0.0)
        knots = gears.knots * np.exp(stretch)[self.owner]
        return gears._replace(turns=turns, knots=knots, curvature=curvature + change[self.bends])

    def dense(self) -> DenseProgram:
        """Create the program of the twin."""
        return DenseProgram(self.size, len(self.rows), tolerance=EXACT)

    def _price(self, gears: _Gears) -> FloatArray:
        """Return the matrix of the quadratic cost for changing the variables (D4)."""
        steps, first = gears.knots[self.left + 1] - gears.knots[self.left], self.bends[self.left]
        width, price = np.zeros(self.size), np.zeros((self.size, self.size))
        width[first] += 0.5 * steps
        width[first + 1] += 0.5 * steps
        swing = 1.0 / (steps * self.rate_scale**2)
        values = _BEND_PRICE * width / self.scale**2
        values[first] += swing
        values[first + 1] += swing
        values[self.lengths] = np.where(self.is_turn, 1.0, _LENGTH_PRICE * gears.ends)
        np.fill_diagonal(price, values)
        price[first, first + 1] = price[first + 1, first] = -swing
        return price


def push_off(violation: Violation, path: Path, problem: DockingProblem) -> Push:
    """Return the push that moves the robot away from the obstacle of a clearance violation."""
    pose = path.poses_at(violation.s)
    clearance, row = compiled_clearances(pose, problem.robot.footprint, problem.all_obstacles)
    return _push(violation.s, float(clearance[0]) + violation.amount, pose[0], int(row[0]), path, problem)


def pushes_off(path: Path, problem: DockingProblem) -> list[Push]:
    """Return pushes for the worst stretches of a path whose samples are too close to one obstacle, at the worst sample.

    Next to a start that is too close itself, the weaker rule of the certificate applies.
    """
    s = np.linspace(0.0, path.length, 2 + int(path.length / _SPACING))
    poses, rule, room = path.poses_at(s), problem.path_clearance, problem.path_clearance.required + _ROOM
    clearance, row = compiled_clearances(poses, problem.robot.footprint, problem.all_obstacles, room)
    relief = problem.start_run if clearance[0] < rule.required else 0.0
    required = rule.required_for(poses, problem.goal, problem.start, float(clearance[0]), relief)
    missing = required - clearance
    short = np.flatnonzero(missing > TOLERANCE)
    borders = np.flatnonzero((np.diff(short) > 1) | (np.diff(row[short]) != 0)) + 1
    worst = [int(some[missing[some].argmax()]) for some in np.split(short, borders)] if short.size else []
    worst = sorted(worst, key=lambda k: -missing[k])[:_MOST_AT_ONCE]
    return [_push(float(s[k]), float(required[k]), poses[k], int(row[k]), path, problem) for k in worst]


def _push(at: float, required: float, pose: FloatArray, row: int, path: Path, problem: DockingProblem) -> Push:
    """Return the push of the pose at an arc length [m] off the obstacle in a row; `required`: clearance [m]."""
    piece, bodies = problem.all_obstacles.pieces(np.array([row])), problem.robot.footprint.bodies
    body = (
        min(bodies, key=lambda one: float(separation(one, pose[None], piece).distance[0]))
        if len(bodies) > 1
        else bodies[0]
    )
    gear = int(np.clip(np.searchsorted(path.segment_starts, at, side="right") - 1, 0, len(path.segments) - 1))
    share = (at - float(path.segment_starts[gear])) / path.segments[gear].length
    return Push(gear, min(max(share, 0.0), 1.0), body, piece, required + _ROOM)
