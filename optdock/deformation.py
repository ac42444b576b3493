"""The rest of a path, deformed onto another start and another goal: the least change of its curvature that closes it.

What is left of a plan is drivable, smooth and knows its way between the obstacles; a dock that turns out to be some
centimetres aside asks for a small change of it. Let a path have curvature k(s) in its gears. To first order a change
dk ds at s turns all that comes after about the point p(s), so that it moves the end by

    d(end) = dk ds * (-(y_end - y(s)), x_end - x(s), 1),

a longer gear moves it along, and a turn in place turns it about where the robot stands. Gauss-Newton: the change of
least weighted norm that closes the gap in this linear model, then the exact path, until nothing is left. What is least
is the curvature rate, which is what drivers feel and what the drive's yaw acceleration pays for; bounds of curvature
and of its rate are kept by holding what has reached one.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.arrays import readonly
from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.pose import Pose2, normalize_angle
from optdock.path import Path
from optdock.segments import ClothoidSegment, TurnSegment

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from optdock.limits import MotionLimits
    from optdock.segments import Segment

__all__ = ["deformed"]

_CLOSED = 2e-7  # [m], [rad]: a fifth of what the certificate accepts
_STEPS = 8  # of Gauss-Newton; a gap of decimetres takes four
_LEAST_PIECES = 12  # of a gear: fewer leave no shape to bend it into
_SHORTEST_PIECE = 0.01  # [m]: shorter ones are not cut any further
_LENGTH_PRICE = 0.5  # of a gear's relative change of length, where one of the curvature by its limit over 1 m costs 1
_BEND_PRICE = 0.3  # of curvature, likewise, beside its rate
_USED = 0.999  # share of the bounds that is taken where one is reached
_LEAST_TURN = 1e-3  # [rad]: a turn in place that shrinks to less is none
_MOST_STRETCH = 0.3  # of a gear in one step, relative: beyond it the linear model knows nothing
_USUAL_SWING = 0.25  # [m]: without a limit, the way over which the curvature is thought to swing by all it has
# Three Gauss points on [0, 1] integrate what is linear in a hat, and quadratic in between, exactly.
_NODES, _WEIGHTS = (readonly(part) for part in np.array(np.polynomial.legendre.leggauss(3)) / 2.0 + [[0.5], [0.0]])


class _Gear(NamedTuple):
    """One gear, or turn, that is bent.

    `knots`: of the free part, Shape (n,) [m], first 0. `curvature`: there, Shape (n,) [1/m]. `tail`: length of the
    straight run after it [m]. `sign`: 1, -1, or 0 for a turn in place, of `turn` [rad].
    """

    knots: FloatArray
    curvature: FloatArray
    tail: float
    sign: int
    turn: float = 0.0

    @property
    def size(self) -> int:
        """How many numbers shape it: curvatures and the length, or the turn."""
        return self.curvature.size + 1 if self.sign else 1

    def changed(self, change: FloatArray) -> _Gear:
        """The gear with its numbers changed by so much; a length by its logarithm."""
        if self.sign == 0:
            return self._replace(turn=self.turn + float(change[0]))
        return self._replace(knots=self.knots * math.exp(float(change[-1])), curvature=self.curvature + change[:-1])

    def segment(self, start: Pose2) -> Segment:
        """The exact curve from a pose."""
        if self.sign == 0:
            return TurnSegment(start, self.turn)
        knots, curvature = self.knots, self.curvature
        if self.tail > 0.0:
            knots, curvature = np.append(knots, knots[-1] + self.tail), np.append(curvature, 0.0)
        return ClothoidSegment(ClothoidSpline(start, knots, curvature, self.sign))


def deformed(
    path: Path, start: Pose2, goal: Pose2, limits: MotionLimits, *, final_straight: float = 0.0, steers: bool = True
) -> Path | None:
    """A path near `path` from `start` to `goal`, with its gears; or None where the bounds leave no room for one.

    Clearance is none of its business: the certificate decides.

    Args:
        path: What is left of a path, of clothoids and turns in place.
        start: Where it is to begin.
        goal: Where it is to end.
        limits: Its curvature and curvature rate are kept.
        final_straight: Length of the straight run at the end [m].
        steers: Whether the curvature at the start must stay what it is: the robot is in motion, or steers its wheels.
    """
    gears = _gears(path, final_straight)
    if gears is None:
        return None
    program = _Program(gears, limits, steers=steers)
    for _ in range(_STEPS):
        segments = _driven(gears, start)
        if segments is None:
            return None
        end = segments[-1].poses_at(segments[-1].length)[0]
        gap = np.array([goal.x - end[0], goal.y - end[1], normalize_angle(goal.yaw - float(end[2]))])
        if float(np.abs(gap).max()) <= _CLOSED and not program.hold_broken(gears):
            return Path(segments, path.frame)
        change = program.least_change(gears, segments, gap)
        if change is None:
            return None
        gears = [gear.changed(part) for gear, part in zip(gears, change, strict=True)]
    return None


def _gears(path: Path, final_straight: float) -> list[_Gear] | None:
    """The gears of a path with knots enough to be bent; None where it is made of something else, or has no room."""
    gears = []
    for segment in path.segments:
        if isinstance(segment, TurnSegment):
            gears.append(_Gear(segment.knots, np.zeros(0), 0.0, 0, segment.turn))
        elif isinstance(segment, ClothoidSegment):
            tail = final_straight if segment is path.segments[-1] else 0.0
            free = segment.length - tail
            if free <= 2.0 * _SHORTEST_PIECE:
                return None
            knots = _refined(segment.knots, free)
            gears.append(_Gear(knots, segment.curvature_at(knots), tail, segment.spline.sign))
        else:
            return None
    return gears


def _refined(knots: FloatArray, length: float) -> FloatArray:
    """The knots before `length`, that one, and more between those that are far apart."""
    kept = knots[(knots > 0.0) & (knots < length)]
    apart = 0.1 * _SHORTEST_PIECE  # what is nearer to another knot bends nothing, and would ask for a rate of its own
    kept = kept[(kept > apart) & (kept < length - apart)]
    ends = np.concatenate(([0.0], kept, [length]))
    steps = np.diff(ends)
    parts = np.ceil(steps / max(length / _LEAST_PIECES, _SHORTEST_PIECE)).astype(np.int64)
    pieces = [np.linspace(a, b, n, endpoint=False) for a, b, n in zip(ends[:-1], ends[1:], parts, strict=True)]
    return np.append(np.concatenate(pieces), length)


def _driven(gears: list[_Gear], start: Pose2) -> tuple[Segment, ...] | None:
    """The exact curves from a pose; None where a turn has vanished or changed its side."""
    segments: list[Segment] = []
    for gear in gears:
        if gear.sign == 0 and abs(gear.turn) < _LEAST_TURN:
            return None
        segments.append(gear.segment(start))
        start = Pose2.from_sequence(segments[-1].poses_at(segments[-1].length)[0])
    return tuple(segments)


class _Program:
    """The quadratic program of a step: its prices, and the bounds that are held.

    Args:
        gears: As they are at first.
        limits: Their bounds.
        steers: See `deformed`.
    """

    def __init__(self, gears: list[_Gear], limits: MotionLimits, *, steers: bool) -> None:
        sharpest = max((float(np.abs(gear.curvature).max()) for gear in gears if gear.sign), default=0.0)
        self.most = limits.max_curvature * _USED
        self.most_rate = limits.max_curvature_rate * _USED
        self.scale = limits.max_curvature if math.isfinite(limits.max_curvature) else max(sharpest, 1.0)
        rate = limits.max_curvature_rate
        self.rate_scale = rate if math.isfinite(rate) else self.scale / _USUAL_SWING
        sizes = [gear.size for gear in gears]
        self.starts = np.concatenate(([0], np.cumsum(sizes)))
        self.held: dict[tuple[str, int], float] = {}
        if steers and gears[0].sign:
            self.held["curvature", 0] = float(gears[0].curvature[0])
        if gears[-1].sign:
            last = int(self.starts[-1]) - 2
            self.held["curvature", last] = 0.0 if gears[-1].tail > 0.0 else float(gears[-1].curvature[-1])

    def hold_broken(self, gears: list[_Gear]) -> bool:
        """Hold whatever is beyond a bound at that bound; whether there is anything."""
        before = len(self.held)
        for begin, gear in zip(self.starts.tolist(), gears, strict=False):
            if gear.sign == 0:
                continue
            for i in np.flatnonzero(np.abs(gear.curvature) > self.most / _USED).tolist():
                self.held.setdefault(("curvature", begin + i), math.copysign(self.most, gear.curvature[i]))
            rates = np.diff(gear.curvature) / np.diff(gear.knots)
            for i in np.flatnonzero(np.abs(rates) > self.most_rate / _USED).tolist():
                self.held.setdefault(("rate", begin + i), math.copysign(self.most_rate, rates[i]))
        return len(self.held) > before

    def least_change(
        self, gears: list[_Gear], segments: tuple[Segment, ...], gap: FloatArray
    ) -> list[FloatArray] | None:
        """The cheapest change that closes a gap and keeps what is held, by gears; None where nothing does both."""
        size = int(self.starts[-1])
        price = np.zeros((size, size))
        rows, wanted = [*self._moves(gears, segments)], [*gap.tolist()]
        for begin, gear in zip(self.starts.tolist(), gears, strict=False):
            price[begin : begin + gear.size, begin : begin + gear.size] = self._price(gear)
        for (kind, i), value in self.held.items():
            row, now = self._held_row(kind, i, gears, size)
            rows.append(row)
            wanted.append(value - now)
        if len(rows) > size:
            return None
        table = np.array(rows)
        count = len(rows)
        system = np.block([[price, table.T], [table, np.zeros((count, count))]])
        try:
            solved = np.linalg.solve(system, np.concatenate((np.zeros(size), wanted)))[:size]
        except np.linalg.LinAlgError:
            return None
        lengths = self.starts[1:][[gear.sign != 0 for gear in gears]] - 1
        if not np.all(np.isfinite(solved)) or np.any(np.abs(solved[lengths]) > _MOST_STRETCH):
            return None
        return np.split(solved, self.starts[1:-1])

    def _held_row(self, kind: str, i: int, gears: list[_Gear], size: int) -> tuple[FloatArray, float]:
        """A held number as a row over all numbers, and what it is now."""
        owner = int(np.searchsorted(self.starts, i, side="right")) - 1
        gear, k, row = gears[owner], i - int(self.starts[owner]), np.zeros(size)
        if kind == "curvature":
            row[i] = 1.0
            return row, float(gear.curvature[k])
        step = float(gear.knots[k + 1] - gear.knots[k])
        row[i], row[i + 1] = -1.0 / step, 1.0 / step
        rate = float(gear.curvature[k + 1] - gear.curvature[k]) / step
        row[int(self.starts[owner + 1]) - 1] = -rate  # a longer gear swings more slowly
        return row, rate

    def _price(self, gear: _Gear) -> FloatArray:
        """Of a change of a gear's numbers: the squared norm of what it does, as a matrix."""
        if gear.sign == 0:
            return np.array([[1.0]])
        steps, n = np.diff(gear.knots), gear.curvature.size
        swing = np.diff(np.eye(n), axis=0) / np.sqrt(steps)[:, None] / self.rate_scale
        width = 0.5 * (np.append(steps, 0.0) + np.append(0.0, steps))
        price = np.zeros((n + 1, n + 1))
        price[:n, :n] = swing.T @ swing + np.diag(_BEND_PRICE * width / self.scale**2)
        price[n, n] = _LENGTH_PRICE * gear.knots[-1]
        return price

    def _moves(self, gears: list[_Gear], segments: tuple[Segment, ...]) -> FloatArray:
        """How the end moves with every number, Shape (3, all numbers)."""
        end = segments[-1].poses_at(segments[-1].length)[0]
        columns = []
        for gear, segment in zip(gears, segments, strict=True):
            if gear.sign == 0:
                x, y, _ = segment.poses_at(0.0)[0]
                columns.append(np.array([[-(end[1] - y)], [end[0] - x], [1.0]]))
                continue
            steps = np.diff(gear.knots)
            s = (gear.knots[:-1, None] + steps[:, None] * _NODES).ravel()
            poses = segment.poses_at(s)
            turned = np.stack((poses[:, 1] - end[1], end[0] - poses[:, 0], np.ones(s.size)))
            weights = np.repeat(steps, _NODES.size) * np.tile(_WEIGHTS, steps.size)
            weighted = (turned * weights).reshape(3, steps.size, _NODES.size)
            bends = np.zeros((3, gear.curvature.size))
            bends[:, :-1] += weighted @ (1.0 - _NODES)
            bends[:, 1:] += weighted @ _NODES
            first, last = segment.poses_at([0.0, gear.knots[-1]])
            # As long again, with the same curvatures: as much turn more everywhere, and the way itself.
            longer = bends @ gear.curvature + np.array([*(last - first)[:2], 0.0])
            columns.append(np.column_stack((bends, longer)))
        return np.concatenate(columns, axis=1)
