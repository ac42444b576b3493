"""What one look of a sensor tells a grid: cells to mark, and lines of sight to clear."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.costmap.costs import FREE_SPACE, LETHAL
from optdock.costmap.raster import cells_of_lines

if TYPE_CHECKING:
    from optdock.costmap.costmap import Costmap
    from optdock.geometry.arrays import BoolArray, FloatArray

__all__ = ["Observation", "apply_observations", "segments_in_box"]


class Observation(NamedTuple):
    """Points to mark (m, 2), and starts (k, 2) and ends (k, 2) of the lines to clear, all in the world [m]."""

    marks: FloatArray
    starts: FloatArray
    ends: FloatArray


def apply_observations(grid: Costmap, observations: list[Observation]) -> None:
    """Clear all lines, then mark all points, so that no line wipes out what another beam has just hit."""
    lower, upper = np.array(grid.lower), np.array(grid.upper)
    for seen in observations:
        starts, ends, meets = segments_in_box(seen.starts, seen.ends, lower, upper)
        cells = cells_of_lines(grid.cell_of(starts[meets]), grid.cell_of(ends[meets])).cells
        cells = cells[grid.has_cell(cells)]
        grid.data[cells[:, 1], cells[:, 0]] = FREE_SPACE
    for seen in observations:
        cells = grid.cell_of(seen.marks)
        cells = cells[grid.has_cell(cells)]
        grid.data[cells[:, 1], cells[:, 0]] = LETHAL


def segments_in_box(
    starts: FloatArray, ends: FloatArray, lower: FloatArray, upper: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Segments cut to a box ([Liang1984]): starts (n, 2), ends (n, 2), and whether they meet it (n,)."""
    move = ends - starts
    still = move == 0.0
    step = np.where(still, 1.0, move)
    to_lower, to_upper = (lower - starts) / step, (upper - starts) / step
    entry = np.where(still, -np.inf, np.minimum(to_lower, to_upper)).max(axis=1, initial=0.0)
    leave = np.where(still, np.inf, np.maximum(to_lower, to_upper)).min(axis=1, initial=1.0)
    beside = np.any(still & ((starts < lower) | (starts > upper)), axis=1)
    meets: BoolArray = (entry <= leave) & ~beside
    return starts + entry[:, None] * move, starts + leave[:, None] * move, meets
