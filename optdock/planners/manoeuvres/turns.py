"""Turn and drive: manoeuvres of robots that turn in place, out of turns and straight lines.

The shortest motions of a differential drive among obstacles that do not hinder its turning are such sequences
([LaValle2006] ch. 15.3.3). Straight runs leave the start and enter the dock; between the ends of two of them the robot
turns, drives straight on and turns again. Where obstacles stand in the way of that line it follows a shortest way
around them for the disc that it needs for turning, shortened by lines of sight [Thorpe1984].
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np

from optdock.geometry.arrays import readonly
from optdock.geometry.pose import Pose2
from optdock.path import Path
from optdock.planners.manoeuvres.arcs import advance
from optdock.planners.manoeuvres.price import stopping_cost, turning_times
from optdock.segments import Direction, PolylineSegment, TurnSegment

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray
    from optdock.planners.manoeuvres.connections import Nodes
    from optdock.planners.manoeuvres.free_space import Effort, FreeSpace
    from optdock.segments import Segment

__all__ = ["TurnSearch", "TurnsAndDrives", "routes", "turns_and_drives"]

_NOTHING = 1e-9  # [m], [rad]: less is neither driven nor turned
_HEADINGS = 24  # around a place, at which it is looked at whether the robot can turn there: every 15 degrees
_GLANCE = readonly(np.arange(1, 8) / 7.0)  # shares of a line at which it is looked at before it is looked at whole
_BATCH = 64  # lines glanced at in one go
_MOST_GLANCES = 8  # batches: places where nothing else was free in half a thousand lines have no free one
_CLOSE_POSES_PER_WIDTH = 40.0  # of the last look at a whole way, over a length as the robot is wide
# [rad]: a corner that turns by less can be rounded without a stop; one that turns by more leads back.
_ROUNDED = 2.0
_WAYS_OUT, _WAYS_IN = 3, 4  # straight runs out of the start and into the dock that routes are looked for between
_SIGHT = readonly(np.linspace(0.0, 1.0, 64))  # shares of a line of sight at which it is looked at
_POINTS = 40  # of a way that a line of sight may join


class TurnsAndDrives(NamedTuple):
    """One manoeuvre: from `start`, Shape (3,), a turn [rad] and a straight drive [m], and again. Shape (k,) each."""

    start: FloatArray
    turns: FloatArray
    lengths: FloatArray

    def joints(self) -> tuple[FloatArray, FloatArray]:
        """Poses before every turn and after it, Shape (k, 3) each."""
        yaw = self.start[2] + np.cumsum(self.turns)
        x, y = (self.start[i] + np.cumsum(self.lengths * f(yaw)) for i, f in ((0, np.cos), (1, np.sin)))
        before = np.column_stack((np.append(self.start[0], x[:-1]), np.append(self.start[1], y[:-1]), yaw - self.turns))
        return before, np.column_stack((before[:, :2], yaw))

    def poses_every(self, spacing: float, radius: float) -> FloatArray:
        """Poses between which no point within `radius` [m] of the origin moves further than `spacing`. Shape (q, 3)."""
        before, after = self.joints()
        blocks = []
        for pose, turned, turn, length in zip(before, after, self.turns, self.lengths, strict=True):
            angles = np.linspace(0.0, turn, math.ceil(abs(turn) * radius / spacing) + 1)
            blocks.append(np.column_stack((np.broadcast_to(pose[:2], (angles.size, 2)), pose[2] + angles)))
            driven = np.linspace(0.0, length, math.ceil(abs(length) / spacing) + 1)
            blocks.append(advance(turned, driven, np.zeros(1)))
        return np.concatenate(blocks)

    def path(self, goal: Pose2, frame: str) -> Path:
        """The turns as segments, the drives as polylines; the last pose is exactly `goal`."""
        before, after = self.joints()
        segments: list[Segment] = []
        for k, (turn, length) in enumerate(zip(self.turns.tolist(), self.lengths.tolist(), strict=True)):
            if abs(turn) > _NOTHING:
                segments.append(TurnSegment(_pose(before[k]), turn))
            if abs(length) > _NOTHING:
                ends = np.stack((after[k], advance(after[k], np.array(length), np.zeros(()))))
                segments.append(PolylineSegment(ends, _gear(length)))
        return Path(tuple(_ending_at(segments, goal)), frame)

    def rounded(self, spacing: float, goal: Pose2, frame: str) -> Path | None:
        """The same without the turns between two drives in one gear, for a smoother to round; None if there are none.

        Args:
            spacing: Of its poses [m].
            goal: Where it leads exactly.
            frame: Name of the coordinate frame.
        """
        before, after = self.joints()
        segments: list[Segment] = []
        run: list[FloatArray] = []
        was_rounded = False
        for k, (turn, length) in enumerate(zip(self.turns.tolist(), self.lengths.tolist(), strict=True)):
            goes_on = bool(run) and length * self.lengths[k - 1] > 0.0 and abs(turn) < _ROUNDED
            if run and not goes_on:
                segments.append(PolylineSegment(np.concatenate(run), _gear(self.lengths[k - 1])))
                run = []
            if abs(turn) > _NOTHING and not goes_on:
                segments.append(TurnSegment(_pose(before[k]), turn))
            if abs(length) <= _NOTHING:
                continue
            was_rounded |= goes_on and abs(turn) > _NOTHING
            driven = np.linspace(0.0, length, math.ceil(abs(length) / spacing) + 1)
            line = advance(after[k], driven, np.zeros(1))
            if goes_on:
                run[-1][-1, 2] += 0.5 * turn  # the corner, halfway between the two headings
            run.append(line[1:] if goes_on else line)
        if run:
            segments.append(PolylineSegment(np.concatenate(run), _gear(self.lengths[-1])))
        return Path(tuple(_ending_at(segments, goal)), frame) if was_rounded else None

    def paths(self, spacing: float, goal: Pose2, frame: str) -> Iterator[Path]:
        """The manoeuvre, and with rounded corners where it has some; arguments as of `rounded`."""
        yield self.path(goal, frame)
        rounded = self.rounded(spacing, goal, frame)
        if rounded is not None:
            yield rounded


def _pose(pose: FloatArray) -> Pose2:
    return Pose2.from_sequence(pose)


def _gear(length: float) -> Direction:
    return Direction.FORWARD if length > 0.0 else Direction.REVERSE


def _ending_at(segments: list[Segment], goal: Pose2) -> list[Segment]:
    """The last pose of a way, which is the goal but for rounding, is the goal."""
    last = segments[-1]
    if isinstance(last, TurnSegment):
        turned = last.turn + math.remainder(goal.yaw - last.end.yaw, 2.0 * math.pi)
        return [*segments[:-1], TurnSegment(last.pose, turned)]
    assert isinstance(last, PolylineSegment)  # nothing else is built here
    poses = last.poses.copy()
    poses[-1] = goal.x, goal.y, poses[-1, 2] + math.remainder(goal.yaw - poses[-1, 2], 2.0 * math.pi)
    return [*segments[:-1], PolylineSegment(poses, last.direction)]


class _Turning(NamedTuple):
    """How far the robot can turn at places, left and right of a heading that is free, Shape (n,) [rad]."""

    left: FloatArray
    right: FloatArray

    @classmethod
    def at(cls, poses: FloatArray, space: FreeSpace, effort: Effort) -> _Turning:
        """By a quick look at some headings; what is not free between two of them shows later."""
        space.poll()
        step = 2.0 * math.pi / _HEADINGS
        around = np.repeat(poses[:, None], _HEADINGS, axis=1)
        around[:, :, 2] += step * np.arange(1, _HEADINGS + 1)
        free = space.is_free(around.reshape(-1, 3), effort.margin, effort.start_relief).reshape(len(poses), -1)
        far = []
        for side in (free, free[:, -2::-1]):  # the last heading is the first one again
            count = np.where(side.all(axis=1), _HEADINGS, np.argmin(side, axis=1))
            far.append((count + 1.0) * step)
        return cls(*far)

    def allows(self, turns: FloatArray, rows: IntArray) -> BoolArray:
        """Whether turns from the headings of the places at `rows` may be free."""
        allowed: BoolArray = (turns <= self.left[rows]) & (-turns <= self.right[rows])
        return allowed


def turns_and_drives(
    exits: Nodes, entries: Nodes, space: FreeSpace, effort: Effort
) -> Iterator[tuple[float, TurnsAndDrives]]:
    """Manoeuvres that are free, the cheapest first: a straight run, a turn, a line, a turn, a straight run.

    Args:
        exits: Ends of straight runs out of the start, which is one of them.
        entries: Where straight runs into the dock begin.
        space: What is free.
        effort: How closely to look.
    """
    found = _lines(exits, entries, space, effort)
    for k in range(0, min(found.prices.size, _BATCH * _MOST_GLANCES), _BATCH):
        space.poll()
        some = found.rows(slice(k, k + _BATCH))
        leaving = exits.tree.poses[some.exits]
        leaving[:, 2] += some.turns[:, 0]
        line = advance(leaving[:, None], some.lengths[:, None] * _GLANCE, np.zeros(1))
        asked = effort.margin, effort.start_relief
        passed = space.is_free(line.reshape(-1, 3), *asked).reshape(line.shape[:2]).all(axis=1)
        for row in np.flatnonzero(passed).tolist():
            exit_row, entry_row = int(some.exits[row]), int(some.entries[row])
            middle = some.turns[row], some.lengths[row : row + 1]
            whole = _whole(exits, exit_row, middle, entries, entry_row)
            if _is_free(whole, space, effort):
                yield float(some.prices[row]), whole


class _Lines(NamedTuple):
    """Lines between nodes: Shape (n,), turns before and after them (n, 2) [rad], signed lengths (n,) [m]."""

    prices: FloatArray
    exits: IntArray
    entries: IntArray
    turns: FloatArray
    lengths: FloatArray

    def rows(self, keep: IntArray | slice) -> _Lines:
        columns = self.prices[keep], self.exits[keep], self.entries[keep], self.turns[keep], self.lengths[keep]
        return _Lines(*columns)


def _lines(exits: Nodes, entries: Nodes, space: FreeSpace, effort: Effort) -> _Lines:
    """Every line in both gears, every turn either way round, that turning may allow; the cheapest first."""
    limits = space.problem.robot.limits
    leaving, arriving = exits.tree.poses[exits.rows], entries.tree.poses[entries.rows]
    ways_out, ways_in = _Turning.at(leaving, space, effort), _Turning.at(arriving, space, effort)
    i, j, gear, first, second = (
        axis.ravel()
        for axis in np.meshgrid(
            np.arange(len(leaving)), np.arange(len(arriving)), *([np.array([1.0, -1.0])] * 3), indexing="ij"
        )
    )
    dx, dy = (arriving[j, :2] - leaving[i, :2]).T
    length = np.hypot(dx, dy)
    heading = np.arctan2(gear * dy, gear * dx)
    heading = np.where(length > _NOTHING, heading, leaving[i, 2])
    turns = np.column_stack((_wrapped(heading - leaving[i, 2]), _wrapped(arriving[j, 2] - heading)))
    # The shorter way round, or the other one.
    turns -= 2.0 * np.pi * np.where(turns >= 0.0, 1.0, -1.0) * (np.column_stack((first, second)) < 0.0)
    turns[np.abs(turns) <= _NOTHING] = 0.0
    allowed = ways_out.allows(turns[:, 0], i) & ways_in.allows(-turns[:, 1], j)
    speed = np.where(gear > 0.0, limits.max_speed, limits.max_reverse_speed)
    prices = exits.tree.prices[exits.rows[i]] + entries.tree.prices[entries.rows[j]] + length / speed
    prices += turning_times(np.abs(turns), limits.turning).sum(axis=1)
    out, into = exits.tree.signs[exits.rows[i]], -entries.tree.signs[entries.rows[j]]
    drives = length > _NOTHING
    turned = (np.abs(turns[:, 0]) > 0.0) | (out * gear < 0.0)
    stops = (drives & (out != 0.0) & turned).astype(np.float64)
    stops += drives & (into != 0.0) & ((np.abs(turns[:, 1]) > 0.0) | (into * gear < 0.0))
    stops += ~drives & (out != 0.0) & (into != 0.0)
    prices += stopping_cost(limits) * stops
    kept = np.flatnonzero(allowed)
    kept = kept[np.argsort(prices[kept], kind="stable")]
    return _Lines(prices[kept], exits.rows[i[kept]], entries.rows[j[kept]], turns[kept], (gear * length)[kept])


def _wrapped(angle: FloatArray) -> FloatArray:
    folded: FloatArray = np.remainder(angle + np.pi, 2.0 * np.pi) - np.pi
    return folded


def _whole(
    exits: Nodes, exit_row: int, middle: tuple[FloatArray, FloatArray], entries: Nodes, entry_row: int
) -> TurnsAndDrives:
    """A run out of the start, turns and drives, of which the last has no drive, and a run into the dock."""
    out, into = exits.tree.way(exit_row)[0], entries.tree.way(entry_row)[0]
    nothing = np.zeros(1)
    turns = np.concatenate((np.zeros(out.size), middle[0], np.zeros(into.size)))
    lengths = np.concatenate((out, middle[1], nothing, into))
    return TurnsAndDrives(exits.tree.poses[0], *_simplified(turns.tolist(), lengths.tolist()))


def _simplified(turns: list[float], lengths: list[float]) -> tuple[FloatArray, FloatArray]:
    """Turns with no drive between them are one, and so are drives in one gear with no turn between them."""
    pairs: list[list[float]] = [[0.0, 0.0]]
    for turn, length in zip(turns, lengths, strict=True):
        last = pairs[-1]
        if abs(last[1]) <= _NOTHING:
            last[0], last[1] = last[0] + turn, length
        elif abs(turn) <= _NOTHING and last[1] * length >= 0.0:
            last[1] += length
        else:
            pairs.append([turn, length])
    table = np.array(pairs)
    return table[:, 0], table[:, 1]


def _price(whole: TurnsAndDrives, space: FreeSpace) -> float:
    """As the words' prices: at full speed, with what every stop adds [s]."""
    limits = space.problem.robot.limits
    lengths = whole.lengths
    driven = np.where(lengths > 0.0, lengths / limits.max_speed, -lengths / limits.max_reverse_speed)
    stops = max(int(np.count_nonzero(np.abs(lengths) > _NOTHING)) - 1, 0)
    turning = turning_times(np.abs(whole.turns), limits.turning)
    return float(driven.sum() + turning.sum()) + stopping_cost(limits) * stops


def _is_free(whole: TurnsAndDrives, space: FreeSpace, effort: Effort) -> bool:
    """A look at all of it, with the margin; and a close one without, because a smoother keeps it as it is."""
    space.poll()
    reach = space.footprint.circumscribed_radius
    if not space.is_free(whole.poses_every(space.spacing(effort), reach), effort.margin, effort.start_relief).all():
        return False
    close = whole.poses_every(space.width / _CLOSE_POSES_PER_WIDTH, reach)
    return bool(space.is_free(close, 0.0, effort.start_relief).all())


def routes(exits: Nodes, entries: Nodes, space: FreeSpace, effort: Effort) -> Iterator[tuple[float, TurnsAndDrives]]:
    """Manoeuvres around obstacles, turning in place at the corners of the way.

    The way is that of the disc in which the robot turns; then that of one that it only drives through, so that turns
    must find their room.

    Args:
        exits: As of `turns_and_drives`.
        entries: As of `turns_and_drives`.
        space: What is free.
        effort: How closely to look.
    """
    footprint, kept = space.footprint, space.problem.clearance.required + effort.margin
    ways_out, ways_in = _spread(exits, _WAYS_OUT), _spread(entries, _WAYS_IN)
    for radius in (footprint.circumscribed_radius + kept, 0.5 * space.width + kept):
        for out in ways_out:
            source = exits.tree.poses[out]
            wave = space.wavefront(source[:2], radius)
            found = []
            for into in ways_in:
                target = entries.tree.poses[into]
                way = wave.way(target[:2])
                if way is None:
                    continue
                corners = _corners(way, source[:2], target[:2], space, radius)
                for gear in (1.0, -1.0):
                    whole = _whole(exits, out, _along(corners, gear, source[2], target[2]), entries, into)
                    found.append((_price(whole, space), whole))
            for price, whole in sorted(found, key=lambda one: one[0]):
                if _is_free(whole, space, effort):
                    yield price, whole


TurnSearch: TypeAlias = "Callable[[Nodes, Nodes, FreeSpace, Effort], Iterator[tuple[float, TurnsAndDrives]]]"
"""`turns_and_drives` or `routes`."""


def _spread(nodes: Nodes, count: int) -> list[int]:
    """Some of the nodes, from the cheapest to the dearest."""
    order = np.argsort(nodes.tree.prices[nodes.rows], kind="stable")
    picked = order[np.unique(np.linspace(0.0, max(order.size - 1, 0), min(count, order.size)).astype(np.int64))]
    return [int(row) for row in nodes.rows[picked]]


def _along(corners: FloatArray, gear: float, first: float, last: float) -> tuple[FloatArray, FloatArray]:
    """Turns and lengths along a polyline of corners in one gear, between two headings."""
    step = np.diff(corners, axis=0)
    heading = np.arctan2(gear * step[:, 1], gear * step[:, 0])
    turns = _wrapped(np.diff(np.concatenate(([first], heading, [last]))))
    return turns, gear * np.hypot(step[:, 0], step[:, 1])


def _corners(way: FloatArray, source: FloatArray, target: FloatArray, space: FreeSpace, radius: float) -> FloatArray:
    """The corners of a way that are left when it is cut short wherever a disc can pass. Shape (k, 2)."""
    some = way[np.unique(np.linspace(0, len(way) - 1, _POINTS).astype(np.int64))]
    points = np.concatenate((source[None], some[1:-1], target[None]))
    corners, at, last = [points[0]], 0, len(points) - 1
    while at < last:
        space.poll()
        ahead = points[at + 1 :]
        line = points[at] + _SIGHT[:, None, None] * (ahead - points[at])
        lower, _ = space.field.bounds(line)
        # Near its ends the way is that of the robot, not of the disc: whether it is free shows later.
        near = [np.hypot(*np.moveaxis(line - end, -1, 0)) < radius for end in (source, target)]
        is_seen = ((lower >= radius) | near[0] | near[1]).all(axis=0)
        is_seen[0] = True
        at += 1 + int(np.flatnonzero(is_seen)[-1])
        corners.append(points[at])
    return np.array(corners)
