"""Obstacles from occupied cells, which are merged into a small number of exact rectangles."""

from __future__ import annotations

import functools
import operator
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from optdock.errors import InvalidValue
from optdock.geometry.arrays import frozen_array
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import FARTHEST
from optdock.model.costs import LETHAL, NO_INFORMATION

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray
    from optdock.model.costmap import Costmap

__all__ = [
    "Region",
    "added_obstacles",
    "cell_rectangles",
    "is_same_grid",
    "mapped_obstacles",
    "obstacles_from_costmap",
]

Region: TypeAlias = "tuple[ArrayLike, ArrayLike]"

_BORDER_END = 10.0 * FARTHEST  # [m]: poses are within `FARTHEST`, and no footprint reaches 1.5 `FARTHEST` beyond


def obstacles_from_costmap(
    costmap: Costmap,
    *,
    unknown_is_obstacle: bool = True,
    region: Region | None = None,
    border: bool = True,
) -> ObstacleSet:
    """Return the occupied cells as exact, disjoint, axis-aligned rectangles, together with the outside of the map.

    The groups are named `map` (occupied cells), `unknown` and `map border`. The border is an obstacle by default,
    because the outside of the map is unknown and Nav2's collision checkers reject poses outside the map. Four
    half-planes represent it.

    Args:
        costmap: The grid.
        unknown_is_obstacle: Whether NO_INFORMATION cells are obstacles.
        region: Lower and upper corner [m] of the region of interest; cells that do not intersect the region are
            omitted, and the run time is proportional to the size of the region. None means the whole map.
        border: Whether the outside of the map is an obstacle.

    Raises:
        InvalidValue: If the corners of the region are not finite and ordered.

    >>> from optdock.model.costmap import Costmap
    >>> walls = Costmap(np.array([[254, 254, 254], [254, 0, 0], [254, 0, 0]]), resolution=0.5)
    >>> obstacles_from_costmap(walls, border=False).upper.tolist()
    [[0.5, 1.5], [1.5, 0.5]]
    """
    box = None if region is None else _checked_region(region)
    first, stop = _cell_window(costmap, box)
    window = costmap.data[first[1] : stop[1], first[0] : stop[0]]
    obstacles = _rectangles(costmap, cell_rectangles(window == LETHAL) + np.tile(first, 2), "map")
    if unknown_is_obstacle:
        unknown = cell_rectangles(window == NO_INFORMATION) + np.tile(first, 2)
        obstacles = obstacles + _rectangles(costmap, unknown, "unknown")
    if border:
        outside = _border(costmap)
        obstacles = obstacles + (outside if box is None else outside.in_box(box[0], box[1]))
    return obstacles


@functools.lru_cache(maxsize=16)
def mapped_obstacles(costmap: Costmap, *, unknown_is_obstacle: bool = True) -> ObstacleSet:
    """Return the result of `obstacles_from_costmap` for a whole frozen costmap; the latest results are cached."""
    return obstacles_from_costmap(costmap, unknown_is_obstacle=unknown_is_obstacle)


def added_obstacles(
    costmap: Costmap, known: Costmap | None, places: FloatArray, reach: float, *, unknown_is_obstacle: bool = True
) -> ObstacleSet:
    """Return the cells near given points that are obstacles in a costmap but not in an earlier costmap, and the border.

    The border is omitted if both costmaps have the same grid or if all points are at least `reach` inside the map.

    Args:
        costmap: The new costmap.
        known: The earlier costmap. None, or a costmap with a different grid, means that no obstacle was known.
        places: The points, Shape (n, 2) [m].
        reach: Cells farther than this distance from all points are omitted [m].
        unknown_is_obstacle: Whether NO_INFORMATION cells are obstacles in both costmaps.
    """
    lower, upper = places.min(axis=0) - reach, places.max(axis=0) + reach
    first, stop = _cell_window(costmap, (lower, upper))
    rows, columns = slice(first[1], stop[1]), slice(first[0], stop[0])
    window = costmap.data[rows, columns]
    blocked = window >= LETHAL if unknown_is_obstacle else window == LETHAL
    is_known = known is not None and is_same_grid(costmap, known)
    if known is not None and is_known:
        before = known.data[rows, columns]
        blocked &= ~(before >= LETHAL if unknown_is_obstacle else before == LETHAL)
    rows_at, columns_at = np.nonzero(blocked)
    cells = np.column_stack((columns_at, rows_at))
    if len(cells):
        centres = np.array(costmap.origin) + (cells + first + 0.5) * costmap.resolution
        within = (reach + costmap.resolution) ** 2  # a corner is nearer than the centre by less than a side
        near = np.zeros(len(cells), dtype=np.bool_)
        for place in places:
            near |= np.square(centres - place).sum(axis=1) <= within
        blocked[cells[~near, 1], cells[~near, 0]] = False
    unseen = blocked & (window == NO_INFORMATION)
    parts = [
        _rectangles(costmap, cell_rectangles(these) + np.tile(first, 2), name)
        for name, these in (("map", blocked & ~unseen), ("unknown", unseen))
        if these.any()
    ]
    if not is_known:
        inside = np.all(lower >= costmap.lower) and np.all(upper <= costmap.upper)
        parts += [] if inside else [_border(costmap).in_box(lower, upper)]
    return functools.reduce(operator.add, parts) if parts else ObstacleSet.empty()


def is_same_grid(first: Costmap, second: Costmap) -> bool:
    """Whether two costmaps have equal shapes, origins and resolutions."""
    same = first.data.shape == second.data.shape and first.origin == second.origin
    return same and first.resolution == second.resolution


def cell_rectangles(occupied: BoolArray) -> IntArray:
    """Return disjoint rectangles that exactly cover the true cells, from merged runs of rows or columns.

    The direction of the runs that gives fewer rectangles is used.

    Args:
        occupied: Shape (rows, columns).

    Returns:
        Shape (m, 4): first column, first row, and the column and row after the last ones.
    """
    by_rows = _merged_runs(occupied)
    by_columns = _merged_runs(occupied.T)
    return by_rows if len(by_rows) <= len(by_columns) else by_columns[:, [1, 0, 3, 2]]


def _merged_runs(occupied: BoolArray) -> IntArray:
    """Return rectangles of true cells: runs in rows, merged if runs in consecutive rows are equal. Shape (m, 4)."""
    padded = np.zeros((occupied.shape[0], occupied.shape[1] + 2), dtype=np.bool_)
    padded[:, 1:-1] = occupied
    # The number of changes per row is even, so the flat list alternates between starts and stops of runs.
    changes = np.flatnonzero(padded[:, 1:] != padded[:, :-1])
    row, start = np.divmod(changes[::2], occupied.shape[1] + 1)
    stop = changes[1::2] % (occupied.shape[1] + 1)
    order = np.lexsort((row, stop, start))
    row, start, stop = row[order], start[order], stop[order]
    is_new = np.ones(row.size, dtype=np.bool_)
    is_new[1:] = (np.diff(row) != 1) | (np.diff(start) != 0) | (np.diff(stop) != 0)
    first = np.nonzero(is_new)[0]
    last = np.append(first[1:], row.size)[: first.size] - 1
    return np.column_stack((start[first], row[first], stop[first], row[last] + 1))


def _rectangles(costmap: Costmap, cells: IntArray, name: str) -> ObstacleSet:
    if not len(cells):
        return ObstacleSet.empty()
    corners = np.tile(np.array(costmap.origin), 2) + costmap.resolution * cells
    return ObstacleSet.from_rectangles(corners[:, :2], corners[:, 2:], name)


def _checked_region(region: Region) -> tuple[FloatArray, FloatArray]:
    lower, upper = (
        frozen_array(corner, f"region.{name}") for corner, name in zip(region, ("lower", "upper"), strict=True)
    )
    if lower.shape != (2,) or upper.shape != (2,) or not np.all(lower <= upper):
        raise InvalidValue(f"region: needs lower = [x, y] <= upper = [x, y], got {lower.tolist()}, {upper.tolist()}")
    return lower, upper


def _cell_window(costmap: Costmap, box: tuple[FloatArray, FloatArray] | None) -> tuple[IntArray, IntArray]:
    """Return the first cell (i, j) of the box and the cell after its last cell; outside the map the window is empty."""
    size = np.array([costmap.columns, costmap.rows])
    if box is None:
        return np.zeros(2, dtype=np.int64), size
    first, last = costmap.cell_of(np.stack(box))
    stop = np.clip(last + 1, 0, size)
    return np.clip(first, 0, stop), stop


def _border(costmap: Costmap) -> ObstacleSet:
    """Return four half-planes around the map that overlap beyond its corners.

    Each half-plane is a rectangle whose far sides lie beyond every point that a footprint can reach at any pose. The
    large extent does not reduce the precision: the normal of the near side is exactly an axis, so a single subtraction
    gives the distance.
    """
    (x0, y0), (x1, y1) = costmap.lower, costmap.upper
    left, low = min(x0 - 1.0, -_BORDER_END), min(y0 - 1.0, -_BORDER_END)
    right, high = max(x1 + 1.0, _BORDER_END), max(y1 + 1.0, _BORDER_END)
    lower = np.array([[left, low], [left, y1], [left, low], [x1, low]])
    upper = np.array([[right, y0], [right, high], [x0, high], [right, high]])
    return ObstacleSet.from_rectangles(lower, upper, "map border")
