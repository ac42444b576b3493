"""Motion bounds: a path as cells of smooth motion, and bounds of the velocity and acceleration of footprint points.

Within a cell the motion of the body is `pose(u)`, u from u0 to u1, and equation C4 of docs/theory/certificate.md bounds
the velocity and acceleration of its points; [Zhang2006] bounds velocities along an axis in the same way. For a clothoid
u is arc length: |p'| = 1, |p''| = |curvature|, yaw' = curvature, yaw'' = curvature rate. For a polyline u is the pose
number, and p'' = yaw'' = 0. For a turn in place u is the path coordinate: p' = 0, yaw' = +-1 rad/m, yaw'' = 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.clothoid import subdivided
from optdock.geometry.lazy import cached_property
from optdock.kernels import Kernel, twin_of
from optdock.model.path import ClothoidSegment, PolylineSegment, TurnSegment

if TYPE_CHECKING:
    from collections.abc import Iterator

    from optdock.geometry.arrays import FloatArray, IntArray
    from optdock.model.path import Path, Segment

__all__ = ["CellEnds", "CellMotion", "Cells", "Nodes", "PathMotion", "Pieces", "divided", "first_cells"]


class Cells(NamedTuple):
    """Stretches of motion: segment index, parameter at the start and at the end, each Shape (n,)."""

    segment: IntArray
    first: FloatArray
    last: FloatArray

    def cut(self, parts: int) -> Cells:
        """Return the cells, each divided into equal parts."""
        edges = self.first + (self.last - self.first) * (np.arange(1, parts) / parts)[:, None]
        first, last = np.vstack((self.first, edges)), np.vstack((edges, self.last))
        return Cells(np.tile(self.segment, parts), first.ravel(), last.ravel())

    def last_halved(self) -> Cells:
        """Return the cells, with the last cell divided into two halves."""
        last = self.rows(np.array([-1])).cut(2)
        return Cells(
            np.append(self.segment, last.segment[1:]),
            np.concatenate((self.first[:-1], last.first)),
            np.concatenate((self.last[:-1], last.last)),
        )

    def ends(self) -> CellEnds:
        """Return the distinct positions at which cells begin or end."""
        segment, u = np.tile(self.segment, 2), np.concatenate((self.first, self.last))
        order = np.lexsort((u, segment))
        new = np.ones(order.size, dtype=np.bool_)
        new[1:] = (np.diff(u[order]) != 0.0) | (np.diff(segment[order]) != 0)
        place = np.empty(order.size, dtype=np.int64)
        place[order] = np.cumsum(new) - 1
        chosen = order[new]
        return CellEnds(segment[chosen], u[chosen], place[: self.first.size], place[self.first.size :])

    def blocks(self, most: int) -> Iterator[Cells]:
        """Yield the cells in groups of at most `most`."""
        if self.first.size <= most:
            yield self
            return
        for start in range(0, self.first.size, most):
            yield self.rows(slice(start, start + most))

    def packed(self) -> tuple[IntArray, FloatArray]:
        """Return the segments, Shape (n,), and the first and last parameters, Shape (2, n), for kernels."""
        edges = np.empty((2, self.first.size))
        edges[0], edges[1] = self.first, self.last
        return self.segment, edges

    def rows(self, keep: FloatArray | IntArray | slice) -> Cells:
        """Return the cells selected by `keep`."""
        return Cells(self.segment[keep], self.first[keep], self.last[keep])


class CellEnds(NamedTuple):
    """Borders of cells: segment and parameter, Shape (k,); rows of the first and the last border of each cell, (n,)."""

    segment: IntArray
    u: FloatArray
    first: IntArray
    last: IntArray

    def packed(self) -> IntArray:
        """Return the rows of the first and the last borders, Shape (2, n), for kernels."""
        rows = np.empty((2, self.first.size), dtype=np.int64)
        rows[0], rows[1] = self.first, self.last
        return rows


class Nodes(NamedTuple):
    """Poses, Shape (n, 3), and their arc lengths on the whole path, Shape (n,) [m]."""

    poses: FloatArray
    s: FloatArray


class CellMotion(NamedTuple):
    """Bounds of the motion within each cell, Shape (n,) unless noted.

    `velocity_first`, `velocity_last`: d(x, y, yaw)/du at the two ends, Shape (n, 3). `width`: u1 - u0. `speed`: bound
    of |p'|. `turn`: bound of |yaw'|. `bend`: bound of |p''|. `twist`: bound of |yaw''| + yaw'^2.
    """

    velocity_first: FloatArray
    velocity_last: FloatArray
    width: FloatArray
    speed: FloatArray
    turn: FloatArray
    bend: FloatArray
    twist: FloatArray

    def farthest(self, ends: CellEnds, distances: FloatArray) -> FloatArray:
        """Return an upper bound of the distance from a fixed point within each cell, from the distances at the `ends`.

        The distance is convex along the chord, and a cell deviates from its chord by at most bend * width^2 / 8.
        """
        return np.maximum(distances[ends.first], distances[ends.last]) + self.bend * self.width**2 / 8.0


class Pieces(NamedTuple):
    """Clothoids and turns of a path in the form for kernels.

    `kinds`: number of breaks and gear of each segment, 0 for a turn in place, Shape (k, 2). `table`:
    `ClothoidSpline.table` of all segments one after the other, Shape (n, 6); of a turn in place, two rows for its ends
    with the turn per metre as curvature.
    """

    kinds: IntArray
    table: FloatArray


@dataclass(frozen=True, eq=False)
class PathMotion:
    """The motion along a path."""

    path: Path

    @cached_property
    def pieces(self) -> Pieces | None:
        """The segments for kernels; None if one of them is a polyline."""
        segments = self.path.segments
        tables = [_table_of(one) for one in segments if not isinstance(one, PolylineSegment)]
        if len(tables) < len(segments):
            return None
        kinds = np.array([(len(table), int(one.direction)) for table, one in zip(tables, segments, strict=True)])
        return Pieces(kinds, tables[0] if len(tables) == 1 else np.concatenate(tables))

    def cells(self, max_step: float) -> Cells:
        """Return cells of at most `max_step` [m] that cover the path; breaks of its curves are ends of cells."""
        parts = [_segment_breaks(segment, max_step) for segment in self.path.segments]
        owner = np.concatenate([np.full(part.size - 1, i) for i, part in enumerate(parts)])
        return Cells(owner, np.concatenate([part[:-1] for part in parts]), np.concatenate([part[1:] for part in parts]))

    def nodes(self, segment: IntArray, u: FloatArray) -> Nodes:
        """Return the poses at parameters `u` of segments `segment`, Shape (n,) each."""
        if len(self.path.segments) == 1:
            return Nodes(*_segment_poses(self.path.segments[0], u))
        poses, s = np.empty((u.size, 3)), np.empty(u.size)
        for i, one in enumerate(self.path.segments):
            mine = segment == i
            poses[mine], local = _segment_poses(one, u[mine])
            s[mine] = local + self.path.segment_starts[i]
        return Nodes(poses, s)

    def bounds(self, cells: Cells, first: FloatArray, last: FloatArray) -> CellMotion:
        """Return bounds of the motion in `cells` with the end poses `first` and `last`, Shape (n, 3) each."""
        if len(self.path.segments) == 1:
            return _segment_bounds(self.path.segments[0], cells, first, last)
        n = cells.first.size
        columns = [np.empty((n, 3)), np.empty((n, 3)), *(np.empty(n) for _ in range(5))]
        for i, one in enumerate(self.path.segments):
            mine = np.flatnonzero(cells.segment == i)
            part = _segment_bounds(one, cells.rows(mine), first[mine], last[mine])
            for column, value in zip(columns, part, strict=True):
                column[mine] = value
        return CellMotion(*columns)


def _table_of(segment: ClothoidSegment | TurnSegment) -> FloatArray:
    if isinstance(segment, ClothoidSegment):
        return segment.spline.table
    ends = segment.knots
    return np.column_stack((ends, segment.poses_at(ends), segment.curvature_at(ends), segment.curvature_rate_at(ends)))


_FIRST = Kernel("optdock_first_cells", sizes=3, numbers=1)
_DIVIDED = Kernel("optdock_divided_cells", sizes=3, numbers=0)


class _NewCells:
    """Arrays that receive at most `most` cells and their ends, see `cells_in` in C."""

    def __init__(self, most: int) -> None:
        self.whole, self.numbers = np.empty((6, most), dtype=np.int64), np.empty((4, most))

    def made(self, n: int, ends: int) -> tuple[Cells, CellEnds]:
        """Return the first n cells and their ends."""
        end_segment, rows, end_u = self.whole[2:4].ravel(), self.whole[4:].ravel(), self.numbers[2:].ravel()
        cells = Cells(self.whole[0, :n], self.numbers[0, :n], self.numbers[1, :n])
        return cells, CellEnds(end_segment[:ends], end_u[:ends], rows[:n], rows[n : 2 * n])


def _first_cells_native(motion: PathMotion, max_step: float) -> tuple[Cells, CellEnds]:
    pieces = motion.pieces
    assert pieces is not None
    segments, count = len(pieces.kinds), len(pieces.table)
    most = int(motion.path.length / max_step) + 2 * count + 2
    new, found = _NewCells(most), np.empty(2, dtype=np.int64)
    path = (pieces.kinds, 2 * segments), (pieces.table, 6 * count)
    if (
        _FIRST(
            (segments, count, most), (max_step,), (*path, (new.whole, 6 * most), (new.numbers, 4 * most), (found, 2))
        )
        < 0
    ):
        raise IndexError(f"cells: more than {most} on a path of {motion.path.length} m")
    return new.made(*found.tolist())


@twin_of(_first_cells_native)
def _first_cells_chosen(motion: PathMotion, max_step: float) -> tuple[Cells, CellEnds]:
    return _first_cells_numpy(motion, max_step)


def _first_cells_numpy(motion: PathMotion, max_step: float) -> tuple[Cells, CellEnds]:
    # At the goal the clearance is often just the required one: a last cell of full length needs a second round.
    cells = motion.cells(max_step).last_halved()
    return cells, cells.ends()


def first_cells(motion: PathMotion, max_step: float) -> tuple[Cells, CellEnds]:
    """Return `PathMotion.cells` with the last cell divided into two halves, and the ends of all cells."""
    return (_first_cells_numpy if motion.pieces is None else _first_cells_chosen)(motion, max_step)


def _divided_native(cells: Cells, chosen: IntArray, parts: int) -> tuple[Cells, CellEnds]:
    n, most = cells.first.size, chosen.size * parts
    new = _NewCells(most)
    arrays = (
        (np.ascontiguousarray(cells.segment), n),
        (np.ascontiguousarray(cells.first), n),
        (np.ascontiguousarray(cells.last), n),
        (np.ascontiguousarray(chosen), chosen.size),
        (new.whole, 6 * most),
        (new.numbers, 4 * most),
    )
    ends = _DIVIDED((n, chosen.size, parts), (), arrays)
    if ends < 0:
        raise IndexError("chosen: must be rows of cells")
    return new.made(most, ends)


@twin_of(_divided_native)
def divided(cells: Cells, chosen: IntArray, parts: int) -> tuple[Cells, CellEnds]:
    """Return the cells of the rows `chosen`, Shape (m,), each divided into equal parts, and their ends."""
    finer = cells.rows(chosen).cut(parts)
    return finer, finer.ends()


def _segment_breaks(segment: Segment, max_step: float) -> FloatArray:
    if isinstance(segment, PolylineSegment):
        return np.arange(segment.knots.size, dtype=np.float64)
    breaks = segment.spline.table[:, 0] if isinstance(segment, ClothoidSegment) else segment.knots
    return subdivided(breaks, np.maximum(1, np.ceil(np.diff(breaks) / max_step)).astype(np.int64))


def _segment_poses(segment: Segment, u: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return poses and local arc lengths."""
    if isinstance(segment, PolylineSegment):
        index = np.arange(segment.knots.size, dtype=np.float64)
        columns = [np.interp(u, index, segment.poses[:, i]) for i in range(3)]
        return np.column_stack(columns), np.interp(u, index, segment.knots)
    return segment.poses_at(u), u


def _segment_bounds(segment: Segment, cells: Cells, first: FloatArray, last: FloatArray) -> CellMotion:
    if isinstance(segment, PolylineSegment):
        return _polyline_bounds(segment, cells)
    if isinstance(segment, TurnSegment):
        return _turn_bounds(segment, cells)
    return _clothoid_bounds(segment, cells, first, last)


def _polyline_bounds(segment: PolylineSegment, cells: Cells) -> CellMotion:
    step = np.diff(segment.poses, axis=0)[np.floor(cells.first + 1e-9).astype(np.int64)]
    speed, turn = np.hypot(step[:, 0], step[:, 1]), np.abs(step[:, 2])
    return CellMotion(step, step, cells.last - cells.first, speed, turn, np.zeros(len(step)), turn**2)


def _turn_bounds(segment: TurnSegment, cells: Cells) -> CellMotion:
    width = cells.last - cells.first
    rate, none = segment.curvature_at(cells.first), np.zeros(width.size)
    velocity = np.column_stack((none, none, rate))
    return CellMotion(velocity, velocity, width, none, np.abs(rate), none, rate**2)


def _clothoid_bounds(segment: ClothoidSegment, cells: Cells, first: FloatArray, last: FloatArray) -> CellMotion:
    width = cells.last - cells.first
    breaks, *_, curvature, rates = segment.spline.table.T
    piece = np.searchsorted(breaks, 0.5 * (cells.first + cells.last)) - 1
    rate = rates[piece]
    at_first = curvature[piece] + rate * (cells.first - breaks[piece])
    at_last = at_first + rate * width
    turn = np.maximum(np.abs(at_first), np.abs(at_last))
    sign = float(segment.direction)
    return CellMotion(
        np.column_stack((sign * np.cos(first[:, 2]), sign * np.sin(first[:, 2]), at_first)),
        np.column_stack((sign * np.cos(last[:, 2]), sign * np.sin(last[:, 2]), at_last)),
        width,
        np.ones(width.size),
        turn,
        turn,
        np.abs(rate) + turn**2,
    )
