"""Manoeuvres of turns in place and straight lines, for robots that can turn in place.

On open floor, the fastest motions of a differential drive with bounded wheel speeds are such sequences [Balkcom2002].
Straight runs leave the start and enter the dock. Between the ends of two such runs the robot turns, drives straight and
turns again. If obstacles block this straight line, the robot follows a shortest route around the obstacles for the disc
in which it turns, shortened by lines of sight. The smoother rounds corners that have enough room, so that no stop is
needed there.
"""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np

from optdock.geometry.arrays import readonly
from optdock.geometry.pose import Pose2, wrap_angles
from optdock.model.path import Path
from optdock.model.segments import Direction, PolylineSegment, TurnSegment
from optdock.planners.manoeuvres.arcs import advance
from optdock.planners.manoeuvres.connections import TreeNodes
from optdock.planners.manoeuvres.price import driving_prices, stopping_cost, turning_times

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray
    from optdock.model.segments import Segment
    from optdock.planners.manoeuvres.free_space import Effort, FreeSpace

__all__ = ["TurnSearch", "TurnsAndDrives", "routes", "turning_places", "turns_and_drives"]

_NOTHING = 1e-9  # [m], [rad]: smaller values do not count as motion
_HEADINGS = 24  # headings at which turning in place is checked: every 15 degrees
_COARSE = readonly(np.arange(1, 8) / 7.0)  # shares of a line at which the coarse check samples it
_BATCH = 64  # lines per coarse check
_MOST_BATCHES = 8  # after 512 lines without result no free one is expected
_CLOSE_POSES_PER_WIDTH = 40.0  # poses of the final check of a whole manoeuvre, per width of the robot
_ROUNDED = 2.0  # [rad]: largest corner that can be rounded without a stop
_PARALLEL = 0.05  # [rad]: axes at a smaller angle count as parallel
_WIDEST = 4  # local maxima of the free space on the axis of an end
_TANGENT_SHARE = 0.8  # share of the tangents of an arc that both legs of a rounded corner must have
_WAYS_OUT, _WAYS_IN = 3, 4  # straight runs out of the start and into the dock that routes join
_KINDS = (False, True)  # of manoeuvres: every corner turned in place, some corners rounded
_TRIES = 2  # most manoeuvres of each kind
_SIGHT = readonly(np.linspace(0.0, 1.0, 64))  # shares of a line of sight at which it is sampled
_POINTS = 40  # points of a way that a line of sight may join


# `turns_and_drives` or `routes`.
TurnSearch: TypeAlias = (
    "Callable[[TreeNodes, TreeNodes, FreeSpace, Effort, Callable[[], float]], Iterator[TurnsAndDrives]]"
)


class TurnsAndDrives(NamedTuple):
    """A manoeuvre from `start`, Shape (3,): pairs of a turn [rad] and a straight drive [m], Shape (k,) each.

    `is_rounded`: whether corners between two drives in one gear are left to the smoother, which rounds them without a
    stop.
    """

    start: FloatArray
    turns: FloatArray
    lengths: FloatArray
    is_rounded: bool = False

    def rounds(self) -> BoolArray:
        """Return a mask of the turns that are rounded corners. Shape (k,)."""
        goes_on = np.append(False, self.lengths[1:] * self.lengths[:-1] > 0.0)
        rounded: BoolArray = goes_on & (np.abs(self.turns) < _ROUNDED) & self.is_rounded
        return rounded

    def joints(self) -> tuple[FloatArray, FloatArray]:
        """Return the poses before and after every turn, Shape (k, 3) each."""
        yaw = self.start[2] + np.cumsum(self.turns)
        x, y = (self.start[i] + np.cumsum(self.lengths * f(yaw)) for i, f in ((0, np.cos), (1, np.sin)))
        before = np.column_stack((np.append(self.start[0], x[:-1]), np.append(self.start[1], y[:-1]), yaw - self.turns))
        return before, np.column_stack((before[:, :2], yaw))

    def poses_every(self, spacing: float, radius: float) -> FloatArray:
        """Return poses, Shape (q, 3); between two of them no point within `radius` moves more than `spacing` [m]."""
        before, after = self.joints()
        blocks = []
        swept = np.where(self.rounds(), 0.0, self.turns)
        for pose, turned, turn, length in zip(before, after, swept, self.lengths, strict=True):
            angles = np.linspace(0.0, turn, math.ceil(abs(turn) * radius / spacing) + 1)
            blocks.append(np.column_stack((np.broadcast_to(pose[:2], (angles.size, 2)), pose[2] + angles)))
            blocks.append(_line(turned, length, spacing))
        return np.concatenate(blocks)

    def path(self, spacing: float, goal: Pose2, frame: str) -> Path | None:
        """Return a path of turn segments and of polylines with a given spacing [m], which ends exactly at `goal`.

        The result is None if there is nothing to turn or drive.
        """
        before, after = self.joints()
        segments: list[Segment] = []
        rounds = np.append(self.rounds(), False)
        run: list[FloatArray] = []
        for k, (turn, length) in enumerate(zip(self.turns.tolist(), self.lengths.tolist(), strict=True)):
            if rounds[k]:
                run[-1][-1, 2] += 0.5 * turn  # the corner, halfway between the two headings
            elif abs(turn) > _NOTHING:
                segments.append(TurnSegment(Pose2.from_sequence(before[k]), turn))
            if abs(length) <= _NOTHING:
                continue
            run.append(_line(after[k], length, spacing)[1 if rounds[k] else 0 :])
            if not rounds[k + 1]:
                gear = Direction.FORWARD if length > 0.0 else Direction.REVERSE
                segments.append(PolylineSegment(np.concatenate(run), gear))
                run = []
        return Path((*segments[:-1], _ending_at(segments[-1], goal)), frame) if segments else None


def _line(pose: FloatArray, length: float, spacing: float) -> FloatArray:
    """Return poses on a straight line. Shape (q, 3)."""
    return advance(pose, np.linspace(0.0, length, math.ceil(abs(length) / spacing) + 1), np.zeros(1))


def _ending_at(last: Segment, goal: Pose2) -> Segment:
    """Return the last segment with exactly the goal as its last pose."""
    if isinstance(last, TurnSegment):
        return TurnSegment(last.pose, last.turn + math.remainder(goal.yaw - last.end.yaw, 2.0 * math.pi))
    assert isinstance(last, PolylineSegment)  # other types of segment are not built here
    poses = last.poses.copy()
    poses[-1] = goal.x, goal.y, poses[-1, 2] + math.remainder(goal.yaw - poses[-1, 2], 2.0 * math.pi)
    return PolylineSegment(poses, last.direction)


def _allowed_turns(poses: FloatArray, turns: FloatArray, rows: IntArray, space: FreeSpace, effort: Effort) -> BoolArray:
    """Whether turns [rad] from the poses at `rows` may be collision-free, checked at some headings. Shape (n,)."""
    space.poll()
    step = 2.0 * math.pi / _HEADINGS
    around = np.repeat(poses[:, None], _HEADINGS, axis=1)
    around[:, :, 2] += step * np.arange(1, _HEADINGS + 1)
    free = space.is_free(around.reshape(-1, 3), effort.margin, effort.start_relief).reshape(len(poses), _HEADINGS)
    left, right = (
        (np.where(side.all(axis=1), _HEADINGS, np.argmin(side, axis=1)) + 1.0) * step
        for side in (free, free[:, -2::-1])  # the last heading is the first one again
    )
    allowed: BoolArray = (turns <= left[rows]) & (-turns <= right[rows])
    return allowed


def turning_places(pose: FloatArray, other: FloatArray, space: FreeSpace) -> FloatArray:
    """Return distances from a pose along its axis, in either gear, of positions suited for a turn. Shape (n,) [m].

    These are the intersection with the axis of the other end, the foot of the perpendicular from the other end to the
    axis, and the positions with the largest clearance.
    """
    ahead = np.array([math.cos(pose[2]), math.sin(pose[2])])
    across = np.array([-math.sin(other[2]), math.cos(other[2])])
    between = other[:2] - pose[:2]
    longest = float(np.hypot(*between)) + 2.0 * space.footprint.circumscribed_radius
    found = [float(between @ ahead)]
    if abs(float(ahead @ across)) > _PARALLEL:
        found.append(float(between @ across) / float(ahead @ across))
    s = np.arange(-longest, longest, space.field.spacing)
    room, _ = space.field.bounds(pose[:2] + s[:, None] * ahead)
    peak = (room[1:-1] > room[:-2]) & (room[1:-1] >= room[2:]) & (room[1:-1] < 0.9 * space.field.reach)
    peaks = np.flatnonzero(peak) + 1
    widest = peaks[np.argsort(-room[peaks], kind="stable")[:_WIDEST]]
    lengths = np.abs(np.concatenate((found, s[widest])))
    places: FloatArray = lengths[(lengths > _NOTHING) & (lengths < longest)]
    return places


def turns_and_drives(
    exits: TreeNodes, entries: TreeNodes, space: FreeSpace, effort: Effort, worthwhile: Callable[[], float]
) -> Iterator[TurnsAndDrives]:
    """Yield free manoeuvres in ascending order of price: a straight run, a turn, a line, a turn, a straight run.

    `exits` are the start and the ends of straight runs out of it, `entries` poses at which straight runs into the dock
    begin; `worthwhile` returns the price at or above which a manoeuvre is useless [s].
    """
    found = _lines(exits, entries, space, effort)
    left = {False: _TRIES, True: _TRIES}
    for k in range(0, min(found.prices.size, _BATCH * _MOST_BATCHES), _BATCH):
        space.poll()
        some = found.rows(slice(k, k + _BATCH))
        some = some.rows(np.flatnonzero(np.where(some.rounded, left[True], left[False]) > 0))
        leaving = exits.tree.poses[some.exits]
        leaving[:, 2] += some.turns[:, 0]
        line = advance(leaving[:, None], some.lengths[:, None] * _COARSE, np.zeros(1))
        free = space.is_free(line.reshape(-1, 3), effort.margin, effort.start_relief)
        passed = free.reshape(line.shape[:2]).all(axis=1)
        for row in np.flatnonzero(passed).tolist():
            price, is_rounded = float(some.prices[row]), bool(some.rounded[row])
            if price >= worthwhile():
                return
            if left[is_rounded] == 0:
                continue
            middle = some.turns[row], some.lengths[row : row + 1]
            whole = _whole(exits, int(some.exits[row]), middle, entries, int(some.entries[row]))
            whole = whole._replace(is_rounded=is_rounded)
            if _is_free(whole, space, effort):
                left[is_rounded] -= 1
                yield whole


class _Lines(NamedTuple):
    """Lines between nodes (n,), the turns before and after each (n, 2) [rad], and whether corners are rounded."""

    prices: FloatArray
    exits: IntArray
    entries: IntArray
    turns: FloatArray
    lengths: FloatArray
    rounded: BoolArray

    def rows(self, keep: IntArray | slice) -> _Lines:
        which = self.prices[keep], self.exits[keep], self.entries[keep]
        return _Lines(*which, self.turns[keep], self.lengths[keep], self.rounded[keep])


def _lines(exits: TreeNodes, entries: TreeNodes, space: FreeSpace, effort: Effort) -> _Lines:
    """Return the lines in both gears, with turns in both directions, that may be free, in ascending order of price."""
    limits = space.problem.robot.limits
    leaving, arriving = exits.tree.poses[exits.rows], entries.tree.poses[entries.rows]
    axes = np.arange(len(leaving)), np.arange(len(arriving)), *([np.array([1.0, -1.0])] * 3)
    i, j, gear, first, second = (axis.ravel() for axis in np.meshgrid(*axes, indexing="ij"))
    dx, dy = (arriving[j, :2] - leaving[i, :2]).T
    length = np.hypot(dx, dy)
    drives = length > _NOTHING
    heading = np.where(drives, np.arctan2(gear * dy, gear * dx), leaving[i, 2])
    turns = np.column_stack((wrap_angles(heading - leaving[i, 2]), wrap_angles(arriving[j, 2] - heading)))
    # Turn the shorter way or the other one.
    turns -= 2.0 * np.pi * np.where(turns >= 0.0, 1.0, -1.0) * (np.column_stack((first, second)) < 0.0)
    turns[np.abs(turns) <= _NOTHING] = 0.0
    rows = exits.rows[i], entries.rows[j]
    prices = driving_prices(gear * length, space.problem.robot)
    prices += exits.tree.prices[rows[0]] + entries.tree.prices[rows[1]]
    prices += turning_times(np.abs(turns), limits.turning).sum(axis=1)
    out, into = exits.tree.signs[rows[0]], -entries.tree.signs[rows[1]]
    stops = drives & (out != 0.0) & ((turns[:, 0] != 0.0) | (out * gear < 0.0))
    stops = stops + (drives & (into != 0.0) & ((turns[:, 1] != 0.0) | (into * gear < 0.0)))
    prices += stopping_cost(limits) * (stops + (~drives & (out != 0.0) & (into != 0.0)))
    turns_out = _allowed_turns(leaving, turns[:, 0], i, space, effort)
    can_turn = np.column_stack((turns_out, _allowed_turns(arriving, -turns[:, 1], j, space, effort)))
    turned = np.flatnonzero(can_turn.all(axis=1))
    run = np.abs(entries.tree.lengths[rows[1]]) - space.problem.dock.final_straight
    goes_on = np.column_stack((out * gear > 0.0, into * gear > 0.0)) & drives[:, None]
    corners = goes_on & (turns != 0.0) & (np.abs(turns) < _ROUNDED)
    legs = np.minimum(length[:, None], np.column_stack((np.abs(exits.tree.lengths[rows[0]]), run)))
    speed = np.where(gear > 0.0, limits.max_speed, limits.max_reverse_speed)
    saved, has_room = _saved_by_rounding(np.abs(turns), legs, speed[:, None], space, effort)
    rounded = np.flatnonzero(corners.any(axis=1) & np.where(corners, has_room, can_turn).all(axis=1))
    which, is_rounded = np.concatenate((turned, rounded)), np.repeat([False, True], [turned.size, rounded.size])
    prices = prices[which] - is_rounded * np.where(corners, saved, 0.0).sum(axis=1)[which]
    order = np.argsort(prices, kind="stable")
    kept = which[order]
    found = rows[0][kept], rows[1][kept], turns[kept], (gear * length)[kept]
    return _Lines(prices[order], *found, is_rounded[order])


def _saved_by_rounding(
    bend: FloatArray, legs: FloatArray, speed: FloatArray, space: FreeSpace, effort: Effort
) -> tuple[FloatArray, BoolArray]:
    """Return the time saved by rounding corners [s], and whether the legs have room for the tangents of an arc."""
    limits = space.problem.robot.limits
    tangent = effort.radius * np.tan(0.5 * np.minimum(bend, _ROUNDED))
    saved = turning_times(bend, limits.turning) + stopping_cost(limits)
    saved += (2.0 * tangent - effort.radius * bend) / speed
    return saved, _TANGENT_SHARE * tangent <= legs


def _whole(
    exits: TreeNodes, exit_row: int, middle: tuple[FloatArray, FloatArray], entries: TreeNodes, entry_row: int
) -> TurnsAndDrives:
    """Return the manoeuvre of a run out of the start, the turns and drives `middle`, and a run into the dock.

    `middle` contains one more turn than drives.
    """
    out, into = exits.tree.way(exit_row)[0], entries.tree.way(entry_row)[0]
    nothing = np.zeros(1)
    turns = np.concatenate((np.zeros(out.size), middle[0], np.zeros(into.size)))
    lengths = np.concatenate((out, middle[1], nothing, into))
    return TurnsAndDrives(exits.tree.poses[0], *_simplified(turns.tolist(), lengths.tolist()))


def _simplified(turns: list[float], lengths: list[float]) -> tuple[FloatArray, FloatArray]:
    """Merge turns without a drive between them, and drives in one gear without a turn between them."""
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
    """Return the price [s] at full speed plus the cost of stops, which is comparable with the price of words."""
    limits, lengths, rounds = space.problem.robot.limits, whole.lengths, whole.rounds()
    stops = max(int(np.count_nonzero(np.abs(lengths) > _NOTHING)) - 1, 0) - int(np.count_nonzero(rounds))
    turning = turning_times(np.where(rounds, 0.0, np.abs(whole.turns)), limits.turning)
    return float(driving_prices(lengths, space.problem.robot).sum() + turning.sum()) + stopping_cost(limits) * stops


def _is_free(whole: TurnsAndDrives, space: FreeSpace, effort: Effort) -> bool:
    """Whether a manoeuvre is free at widely spaced poses with the margin, and at closely spaced poses without it."""
    space.poll()
    reach = space.footprint.circumscribed_radius
    if not space.is_free(whole.poses_every(space.spacing(effort), reach), effort.margin, effort.start_relief).all():
        return False
    close = whole.poses_every(space.width / _CLOSE_POSES_PER_WIDTH, reach)
    return bool(space.is_free(close, 0.0, effort.start_relief).all())


def routes(
    exits: TreeNodes, entries: TreeNodes, space: FreeSpace, effort: Effort, worthwhile: Callable[[], float]
) -> Iterator[TurnsAndDrives]:
    """Yield manoeuvres around obstacles that turn in place at the corners of a shortest route.

    The shortest way is computed first for the disc in which the robot turns, then for a disc as wide as the robot. The
    arguments are as in `turns_and_drives`.
    """
    kept = space.problem.path_clearance.required + effort.margin
    ways_out, ways_in = _spread(exits, _WAYS_OUT), _spread(entries, _WAYS_IN)
    driving = 0.5 * space.footprint.width + kept
    for radius, out in itertools.product((space.footprint.circumscribed_radius + kept, driving), ways_out):
        found = list(_around(exits, out, TreeNodes(entries.tree, np.array(ways_in)), space, (radius, driving)))
        # Smoothing a long way takes a tenth of a second or fails, so manoeuvres without rounded corners come first.
        offered = [_cheapest_free([one for one in found if one.is_rounded is kind], space, effort) for kind in _KINDS]
        yield from (one[1] for one in offered if one is not None and one[0] < worthwhile())
        if any(one is not None for one in offered):
            return


def _around(
    exits: TreeNodes, out: int, entries: TreeNodes, space: FreeSpace, radii: tuple[float, float]
) -> Iterator[TurnsAndDrives]:
    """Yield manoeuvres in both gears along shortest routes of a disc between nodes, shortened for a narrower disc."""
    source, (turning, driving) = exits.tree.poses[out], radii
    wave = space.wavefront(source[:2], turning)
    for into in entries.rows.tolist():
        target = entries.tree.poses[into]
        way = wave.way(target[:2])
        if way is None:
            continue
        corners = _corners(way, source[:2], target[:2], space, driving)
        for gear, is_rounded in itertools.product((1.0, -1.0), _KINDS):
            whole = _whole(exits, out, _along(corners, gear, source[2], target[2]), entries, into)
            yield whole._replace(is_rounded=is_rounded)


def _cheapest_free(
    found: Sequence[TurnsAndDrives], space: FreeSpace, effort: Effort
) -> tuple[float, TurnsAndDrives] | None:
    """Return the price of the cheapest free manoeuvre and the manoeuvre, or None if none is free."""
    priced = [(_price(whole, space), whole) for whole in found if not whole.is_rounded or whole.rounds().any()]
    ordered = sorted(priced, key=lambda one: one[0])
    return next((one for one in ordered if _is_free(one[1], space, effort)), None)


def _spread(nodes: TreeNodes, count: int) -> list[int]:
    """Return some of the nodes, from the lowest to the highest price."""
    order = np.argsort(nodes.tree.prices[nodes.rows], kind="stable")
    picked = order[np.unique(np.linspace(0.0, max(order.size - 1, 0), min(count, order.size)).astype(np.int64))]
    return [int(row) for row in nodes.rows[picked]]


def _along(corners: FloatArray, gear: float, first: float, last: float) -> tuple[FloatArray, FloatArray]:
    """Return turns and lengths along a polyline of corners in one gear, between two headings."""
    step = np.diff(corners, axis=0)
    heading = np.arctan2(gear * step[:, 1], gear * step[:, 0])
    turns = wrap_angles(np.diff(np.concatenate(([first], heading, [last]))))
    return turns, gear * np.hypot(step[:, 0], step[:, 1])


def _corners(way: FloatArray, source: FloatArray, target: FloatArray, space: FreeSpace, radius: float) -> FloatArray:
    """Return the corners of a route that remain after shortening it by lines of sight of a disc. Shape (k, 2)."""
    some = way[np.unique(np.linspace(0, len(way) - 1, _POINTS).astype(np.int64))]
    points = np.concatenate((source[None], some[1:-1], target[None]))
    corners, at, last = [points[0]], 0, len(points) - 1
    while at < last:
        space.poll()
        ahead = points[at + 1 :]
        line = points[at] + _SIGHT[:, None, None] * (ahead - points[at])
        lower, _ = space.field.bounds(line)
        # Near the ends the disc need not fit; the final check of the manoeuvre decides.
        near = [np.hypot(*np.moveaxis(line - end, -1, 0)) < radius for end in (source, target)]
        is_seen = ((lower >= radius) | near[0] | near[1]).all(axis=0)
        is_seen[0] = True
        at += 1 + int(np.flatnonzero(is_seen)[-1])
        corners.append(points[at])
    return np.array(corners)
