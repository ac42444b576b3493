"""The costmap: a grid of costs with its place in the world."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from optdock.errors import InvalidValue
from optdock.geometry.arrays import readonly
from optdock.geometry.checked import finite_number, number
from optdock.model.costs import (
    FREE_SPACE,
    INSCRIBED,
    LETHAL,
    NO_INFORMATION,
    CostArray,
    OccupancyArray,
    occupancy_from_costs,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike

    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray

__all__ = ["FREE_SPACE", "INSCRIBED", "LETHAL", "NO_INFORMATION", "Costmap"]

_FAR = 2.0**40  # cells; farther points, and points that are not finite, count as this far off the map


@dataclass(frozen=True, eq=False, repr=False)
class Costmap:
    """Square cells with a cost each; cell (i, j) is column i (along x) and row j (along y).

    Args:
        data: Shape (rows, columns), integers 0..255; row 0 has the lowest y. Copied and made read-only.
        resolution: Side of a cell [m].
        origin: Lower left corner of cell (0, 0), x and y [m].

    Raises:
        InvalidValue: No cell, costs that are not integers in 0..255, resolution not > 0, origin not finite.

    >>> Costmap(np.array([[0, 254]]), resolution=0.5).cost_at([[0.2, 0.2], [0.7, 0.2], [9.0, 9.0]]).tolist()
    [0, 254, 255]
    """

    data: CostArray
    resolution: float
    origin: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        object.__setattr__(self, "resolution", number(self.resolution, "costmap.resolution"))
        if not (math.isfinite(self.resolution) and self.resolution > 0.0):
            raise InvalidValue(f"costmap.resolution: must be finite and > 0 m, got {self.resolution}")
        object.__setattr__(self, "origin", _checked_origin(self.origin))
        object.__setattr__(self, "data", _checked_costs(self.data))
        if not all(math.isfinite(value) for value in self.upper):
            raise InvalidValue(f"costmap: its upper corner must be finite, got {self.upper}; check the resolution")

    def __reduce__(self) -> tuple[Callable[..., Costmap], tuple[object, ...]]:
        """How it is copied and pickled: what is frozen stays so, and so does what layers write into."""
        made = _writable if self._is_writable else Costmap
        return made, (self.data, self.resolution, self.origin)

    def __repr__(self) -> str:
        (x, y), side = self.origin, self.resolution
        return f"<Costmap {self.columns} x {self.rows} cells of {side:g} m from ({x:g}, {y:g}) m>"

    @classmethod
    def writable(
        cls, shape: tuple[int, int], resolution: float, origin: tuple[float, float], fill: int = FREE_SPACE
    ) -> Costmap:
        """A grid for layers to write into; hand out `frozen()` copies of it.

        Args:
            shape: Rows and columns.
            resolution: Side of a cell [m].
            origin: Lower left corner [m].
            fill: Cost of every cell.

        Raises:
            InvalidValue: As the constructor.
        """
        return _writable(np.full(shape, fill, dtype=np.uint8), resolution, origin)

    def frozen(self) -> Costmap:
        """The grid itself where it is read-only; else a read-only copy."""
        return Costmap(self.data, self.resolution, self.origin) if self._is_writable else self

    @property
    def _is_writable(self) -> bool:
        """Whether layers write into it: only then the memory is its array's own, whatever the array is flagged."""
        return self.data.flags.owndata

    def with_data(self, data: ArrayLike) -> Costmap:
        """The same grid with other costs.

        Raises:
            InvalidValue: Another shape, or costs that are not integers in 0..255.
        """
        costs = _checked_costs(data)
        if costs.shape != self.data.shape:
            raise InvalidValue(f"costmap.data: must have shape {self.data.shape}, got {costs.shape}")
        return Costmap(costs, self.resolution, self.origin)

    @property
    def rows(self) -> int:
        """Number of rows, along y."""
        return int(self.data.shape[0])

    @property
    def columns(self) -> int:
        """Number of columns, along x."""
        return int(self.data.shape[1])

    @property
    def lower(self) -> tuple[float, float]:
        """Lower left corner of the map [m]."""
        return self.origin

    @property
    def upper(self) -> tuple[float, float]:
        """Upper right corner of the map [m]."""
        return (
            self.origin[0] + self.columns * self.resolution,
            self.origin[1] + self.rows * self.resolution,
        )

    def cell_of(self, points: ArrayLike) -> IntArray:
        """Cells (i, j) of points: floor((point - origin) / resolution), on the map or off it.

        Args:
            points: Shape (n, 2) [m]; a point that is not finite gets a cell off the map.

        Returns:
            Shape (n, 2), column i and row j.
        """
        scaled = np.floor((np.asarray(points, dtype=np.float64) - np.array(self.origin)) / self.resolution)
        cells: IntArray = np.clip(np.nan_to_num(scaled, nan=-_FAR), -_FAR, _FAR).astype(np.int64)
        return cells

    def centre_of(self, cells: ArrayLike) -> FloatArray:
        """Centres of cells (i, j), Shape (n, 2), on the map or off it. Shape (n, 2) [m]."""
        centres: FloatArray = np.array(self.origin) + (np.asarray(cells, dtype=np.float64) + 0.5) * self.resolution
        return centres

    def has_cell(self, cells: IntArray) -> BoolArray:
        """Whether cells (i, j), Shape (n, 2), are on the map. Shape (n,)."""
        inside: BoolArray = np.all((cells >= 0) & (cells < (self.columns, self.rows)), axis=-1)
        return inside

    def contains(self, points: ArrayLike) -> BoolArray:
        """Whether points, Shape (n, 2) [m], are on the map. Shape (n,)."""
        return self.has_cell(self.cell_of(points))

    def cost_at(self, points: ArrayLike) -> CostArray:
        """Costs at points, Shape (n, 2) [m]; NO_INFORMATION off the map. Shape (n,)."""
        cells = self.cell_of(points)
        inside = self.has_cell(cells)
        costs = np.full(inside.shape, NO_INFORMATION, dtype=np.uint8)
        costs[inside] = self.data[cells[inside, 1], cells[inside, 0]]
        return costs

    def occupancy(self) -> OccupancyArray:
        """Nav2's published occupancies, Shape (rows, columns), -1 (unknown) or 0..100."""
        return occupancy_from_costs(self.data)


def _writable(data: CostArray, resolution: float, origin: tuple[float, float]) -> Costmap:
    grid = Costmap(data, resolution, origin)
    object.__setattr__(grid, "data", grid.data.copy())
    return grid


def _checked_origin(origin: object) -> tuple[float, float]:
    if not isinstance(origin, Sequence | np.ndarray) or isinstance(origin, str) or len(origin) != 2:
        raise InvalidValue(f"costmap.origin: must be two finite numbers [m], got {origin!r}")
    x, y = (finite_number(value, "costmap.origin") for value in origin)
    return x, y


def _checked_costs(data: ArrayLike) -> CostArray:
    """A read-only copy of costs, Shape (rows, columns)."""
    values = np.asarray(data)
    if values.dtype.kind not in "iu":
        raise InvalidValue(f"costmap.data: must be integers, got {values.dtype}")
    if values.ndim != 2 or values.size == 0:
        raise InvalidValue(f"costmap.data: must have shape (rows, columns) with at least one cell, got {values.shape}")
    if values.dtype != np.uint8 and (values.min() < 0 or values.max() > NO_INFORMATION):
        raise InvalidValue(f"costmap.data: must be in 0..255, got {values.min()}..{values.max()}")
    return readonly(np.ascontiguousarray(values, dtype=np.uint8))
