"""Costmaps and occupancy grids: cells with a position in the world."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from optdock.errors import InvalidValue
from optdock.geometry.arrays import FrozenArrays, readonly
from optdock.geometry.checked import finite_number, positive
from optdock.model.costs import (
    FREE_SPACE,
    INSCRIBED,
    LETHAL,
    NO_INFORMATION,
    CostArray,
    OccupancyArray,
    OccupancyRule,
    costs_from_occupancy,
    occupancy_from_costs,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike

    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray

__all__ = ["FREE_SPACE", "INSCRIBED", "LETHAL", "NO_INFORMATION", "Costmap", "OccupancyGrid"]

_FAR = 2.0**40  # cells; index limit of points that are farther or not finite


@dataclass(frozen=True, eq=False, repr=False)
class Costmap:
    """Grid of square cells, each with one cost; cell (i, j) is in column i (along x) and row j (along y).

    Args:
        data: Shape (rows, columns), integers 0..255; row 0 has the lowest y. Copied and made read-only.
        resolution: Side of a cell [m].
        origin: Lower left corner of cell (0, 0), x and y [m].

    Raises:
        InvalidValue: If there is no cell, a cost is not an integer in 0..255, the resolution is not > 0, or the origin
            is not finite.

    >>> Costmap(np.array([[0, 254]]), resolution=0.5).cost_at([[0.2, 0.2], [0.7, 0.2], [9.0, 9.0]]).tolist()
    [0, 254, 255]
    """

    data: CostArray
    resolution: float
    origin: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        resolution = positive(self.resolution, "costmap.resolution", "m")
        vars(self).update(resolution=resolution, origin=_checked_origin(self.origin), data=_checked_costs(self.data))
        if not all(math.isfinite(value) for value in self.upper):
            raise InvalidValue(f"costmap: its upper corner must be finite, got {self.upper}; check the resolution")

    def __reduce__(self) -> tuple[Callable[..., Costmap], tuple[object, ...]]:
        """Preserve in copies and pickles whether the grid is writable."""
        made = _writable if self._is_writable else Costmap
        return made, (self.data, self.resolution, self.origin)

    def __repr__(self) -> str:
        (x, y), side = self.origin, self.resolution
        return f"<Costmap {self.columns} x {self.rows} cells of {side:g} m from ({x:g}, {y:g}) m>"

    @classmethod
    def writable(
        cls, shape: tuple[int, int], resolution: float, origin: tuple[float, float], fill: int = FREE_SPACE
    ) -> Costmap:
        """Return a grid into which layers can write; its `frozen()` copies can be published.

        Args:
            shape: Rows and columns.
            resolution: Side of a cell [m].
            origin: Lower left corner [m].
            fill: Cost of every cell.

        Raises:
            InvalidValue: As for the constructor.
        """
        return _writable(np.full(shape, fill, dtype=np.uint8), resolution, origin)

    def frozen(self) -> Costmap:
        """Return the grid itself if it is read-only, otherwise a read-only copy."""
        return Costmap(self.data, self.resolution, self.origin) if self._is_writable else self

    @property
    def _is_writable(self) -> bool:
        """Whether layers can write into the grid; only the array of a writable grid owns its memory."""
        return self.data.flags.owndata

    def with_data(self, data: ArrayLike) -> Costmap:
        """Return a grid with the same geometry and other costs.

        Raises:
            InvalidValue: If the shape differs or the costs are not integers in 0..255.
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
        return self.origin[0] + self.columns * self.resolution, self.origin[1] + self.rows * self.resolution

    def cell_of(self, points: ArrayLike) -> IntArray:
        """Return the cells (i, j) of points: floor((point - origin) / resolution), also for points outside the map.

        Args:
            points: Shape (n, 2) [m]; points that are not finite are assigned to cells outside the map.

        Returns:
            Shape (n, 2), column i and row j.
        """
        scaled = np.floor((np.asarray(points, dtype=np.float64) - np.array(self.origin)) / self.resolution)
        cells: IntArray = np.clip(np.nan_to_num(scaled, nan=-_FAR), -_FAR, _FAR).astype(np.int64)
        return cells

    def centre_of(self, cells: ArrayLike) -> FloatArray:
        """Return the centres of cells (i, j), Shape (n, 2), also outside the map. Shape (n, 2) [m]."""
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
        """Return the costs at points, Shape (n, 2) [m]; NO_INFORMATION outside the map. Shape (n,)."""
        cells = self.cell_of(points)
        inside = self.has_cell(cells)
        costs = np.full(inside.shape, NO_INFORMATION, dtype=np.uint8)
        costs[inside] = self.data[cells[inside, 1], cells[inside, 0]]
        return costs

    def occupancy(self) -> OccupancyArray:
        """Return the occupancies that Nav2 publishes for these costs, -1 (unknown) or 0..100, Shape (rows, columns)."""
        return occupancy_from_costs(self.data)


@dataclass(frozen=True, eq=False)
class OccupancyGrid(FrozenArrays):
    """Grid of occupancies with a position in the world (ROS: `nav_msgs/OccupancyGrid`).

    Args:
        data: Shape (rows, columns), -1 (unknown) or 0..100; row 0 has the lowest y. Copied and made read-only.
        resolution: Side of a cell [m].
        origin: Lower left corner of the first cell, x and y [m].

    Raises:
        InvalidValue: If there is no cell, an occupancy is outside -1..100, the resolution is not > 0, or the origin is
            not finite.
    """

    data: OccupancyArray
    resolution: float
    origin: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        values = np.asarray(self.data)
        grid = Costmap(costs_from_occupancy(values), self.resolution, self.origin)  # checks everything
        occupancy = readonly(values.astype(np.int8, order="C"))
        vars(self).update(data=occupancy, resolution=grid.resolution, origin=grid.origin)

    @property
    def costmap(self) -> Costmap:
        """The costmap according to the default rule, by which unknown cells stay unknown."""
        return self.costmap_by(OccupancyRule())

    def costmap_by(self, rule: OccupancyRule) -> Costmap:
        """Return the costmap according to `rule`."""
        return Costmap(costs_from_occupancy(self.data, rule), self.resolution, self.origin)


def _writable(data: CostArray, resolution: float, origin: tuple[float, float]) -> Costmap:
    grid = Costmap(data, resolution, origin)
    vars(grid).update(data=grid.data.copy())
    return grid


def _checked_origin(origin: object) -> tuple[float, float]:
    if not isinstance(origin, Sequence | np.ndarray) or isinstance(origin, str) or len(origin) != 2:
        raise InvalidValue(f"costmap.origin: must be two finite numbers [m], got {origin!r}")
    x, y = (finite_number(value, "costmap.origin") for value in origin)
    return x, y


def _checked_costs(data: ArrayLike) -> CostArray:
    """Return a read-only copy of costs, Shape (rows, columns)."""
    values = np.asarray(data)
    if values.dtype.kind not in "iu":
        raise InvalidValue(f"costmap.data: must be integers, got {values.dtype}")
    if values.ndim != 2 or values.size == 0:
        raise InvalidValue(f"costmap.data: must have shape (rows, columns) with at least one cell, got {values.shape}")
    if values.dtype != np.uint8 and (values.min() < 0 or values.max() > NO_INFORMATION):
        raise InvalidValue(f"costmap.data: must be in 0..255, got {values.min()}..{values.max()}")
    return readonly(np.ascontiguousarray(values, dtype=np.uint8))
