"""Distances to the nearest obstacle on a grid, computed in tiles on demand."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.arrays import readonly
from optdock.geometry.lazy import cached_property
from optdock.geometry.pose import transform_points
from optdock.kernels import Kernel, twin_of

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import TypeAlias

    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray
    from optdock.geometry.obstacles import ObstacleSet

    KernelArrays: TypeAlias = tuple[tuple[FloatArray | IntArray, int], ...]

__all__ = ["TILE", "DiscStates", "Discs", "DistanceField", "disc_states"]

TILE = 32  # grid points along the side of a tile
_TILES_AT_ONCE = 4  # tiles between two polls; most take less than a tenth of a millisecond
_BLOCK = 24  # obstacle pieces per vectorized evaluation of a tile


class DistanceField:
    """Distances up to `reach` [m] from points of a square to the nearest obstacle.

    `square`: centre and length of the sides, Shape (3,) [m]. `spacing`: spacing of the grid [m]. `poll`: called before
    every few tiles are computed. Attributes `tiles`, `side`: numbers of tiles and grid points along each side;
    attribute `origin`: the first grid point, Shape (2,) [m]; attribute `count`: number of tiles that have values.
    """

    def __init__(
        self, obstacles: ObstacleSet, square: FloatArray, spacing: float, reach: float, poll: Callable[[], None]
    ) -> None:
        self.tiles = int(np.ceil(square[2] / (spacing * TILE) - 1e-9))
        self.poll, self.side = poll, TILE * self.tiles
        self.spacing, self.reach = spacing, reach
        self.origin = square[:2] - 0.5 * spacing * (self.side - 1)
        self.obstacles = obstacles
        self._slots = np.full(self.tiles**2, -1)  # index of the values of a tile; -1: not computed yet
        self._values = np.empty((16, TILE, TILE))
        self.count = 0

    def bounds(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return bounds of the distances of points, Shape (..., 2) [m]; the lower bound is -inf outside the field."""
        scaled = (points - self.origin) / self.spacing
        cell = np.rint(scaled)
        kept = np.minimum(np.maximum(cell, 0.0), self.side - 1.0)
        distance = self.at(kept.astype(np.int64))
        apart = scaled - cell
        du, dv = apart[..., 0], apart[..., 1]
        away = self.spacing * np.sqrt(du * du + dv * dv)
        return np.where((cell == kept).all(axis=-1), distance - away, -np.inf), distance + away

    def at(self, index: IntArray) -> FloatArray:
        """Return the distances of grid points, Shape (..., 2) within the grid. Shape (...) [m]."""
        i, j = index[..., 0], index[..., 1]
        tile = (i // TILE) * self.tiles + j // TILE
        slot = self._slots[tile]
        missing = slot < 0
        if missing.any():
            self._compute(np.unique(tile[missing]))
            slot = self._slots[tile]
        values: FloatArray = self._values[slot, i % TILE, j % TILE]
        return values

    def _compute(self, tiles: IntArray) -> None:
        """Compute the values of tiles without any, Shape (n,), in ascending order."""
        for k in range(0, tiles.size, _TILES_AT_ONCE):
            self.poll()
            some, values = tiles[k : k + _TILES_AT_ONCE], self._room_for_more()
            values[self.count : self.count + some.size] = _tile_values(self, some)
            self._slots[some] = np.arange(self.count, self.count + some.size)
            self.count += some.size

    def _room_for_more(self) -> FloatArray:
        """Return the values of all tiles, with room for those that are computed between two polls."""
        if self.count + _TILES_AT_ONCE > len(self._values):
            self._values = np.concatenate((self._values, np.empty_like(self._values)))
        return self._values

    def call(
        self,
        kernel: Kernel,
        sizes: tuple[int, ...],
        numbers: tuple[float, ...],
        arrays: KernelArrays,
        progress: IntArray,
    ) -> int:
        """Poll, and call a kernel that computes at most a few tiles and ends if it needs more.

        The kernel gets `progress`, Shape (3,), and the arrays of the field after its own arrays; it counts in the first
        element what it has done.
        """
        self.poll()
        values, slots = self._room_for_more(), self._slots
        progress[1:] = self.count, self.count + _TILES_AT_ONCE
        memory = (progress, 3), (slots, slots.size), (values, values.size)
        found = kernel(sizes, numbers, (*arrays, *memory, *self._packed))
        self.count = int(progress[1])
        return found

    @cached_property
    def _packed(self) -> KernelArrays:
        """Arrays of the kernels from `shape` to `high`; see `optdock_add_tile` in C."""
        rocks = self.obstacles
        shape = readonly(np.array((self.tiles, *rocks.offsets.shape)))
        grid = readonly(np.array((self.spacing, *self.origin.tolist(), self.reach)))
        parts = shape, grid, rocks.vertices, rocks.normals, rocks.offsets, rocks.lower, rocks.upper
        return tuple([(part, part.size) for part in parts])

    @cached_property
    def is_box(self) -> BoolArray:
        """Mask of the pieces that are axis-aligned rectangles. Shape (m,)."""
        x, y = self.obstacles.vertices[..., 0], self.obstacles.vertices[..., 1]
        low, high = self.obstacles.lower, self.obstacles.upper
        at_corner = ((x == low[:, :1]) | (x == high[:, :1])) & ((y == low[:, 1:]) | (y == high[:, 1:]))
        step = np.roll(self.obstacles.vertices, -1, axis=1) - self.obstacles.vertices
        # No edge of an axis-aligned rectangle is diagonal.
        found: BoolArray = np.all(at_corner & ((step[..., 0] == 0.0) | (step[..., 1] == 0.0)), axis=1)
        return found


class Discs(NamedTuple):
    """Discs of a body: centres (k, 2) [m], radii at which they cover the body, and radii inside it, negative for none.

    Both radii have Shape (k,) [m].
    """

    centres: FloatArray
    cover: FloatArray
    inside: FloatArray


class DiscStates(NamedTuple):
    """Masks of poses, Shape (n,).

    `covered`: the covering discs have the required clearance. `blocked`: a disc inside the body has less. `outside`: a
    disc is outside the field.
    """

    covered: BoolArray
    blocked: BoolArray
    outside: BoolArray


def disc_states(field: DistanceField, discs: Discs, poses: FloatArray, required: FloatArray) -> DiscStates:
    """Compare the discs of a body at poses, Shape (n, 3), with the required clearances, Shape (n,) [m]."""
    lower, upper = field.bounds(transform_points(poses, discs.centres))
    covered: BoolArray = (lower - discs.cover).min(axis=1) >= required
    blocked: BoolArray = (upper - discs.inside).min(axis=1) < required
    outside: BoolArray = np.any(np.isneginf(lower), axis=1)
    return DiscStates(covered, blocked, outside)


_TILES_KERNEL = Kernel("optdock_tile_values", sizes=4, numbers=2)


def _tile_values_native(field: DistanceField, tiles: IntArray) -> FloatArray:
    rocks, n = field.obstacles, tiles.size
    (m, k, _), values = rocks.vertices.shape, np.empty((n, TILE, TILE))
    arrays = tiles, field.origin, rocks.vertices, rocks.normals, rocks.offsets, rocks.lower, rocks.upper, values
    numbers = field.spacing, field.reach
    _TILES_KERNEL((n, field.tiles, m, k), numbers, tuple([(array, array.size) for array in arrays]))
    return values


@twin_of(_tile_values_native)
def _tile_values(field: DistanceField, tiles: IntArray) -> FloatArray:
    """Return the distances from the grid points of tiles, Shape (n,) to (n, 32, 32) [m]."""
    values = np.full((tiles.size, TILE, TILE), field.reach)
    for tile, best in zip(tiles.tolist(), values, strict=True):
        first = np.array(divmod(tile, field.tiles)) * TILE
        axes = field.origin + (first + np.arange(TILE)[:, None]) * field.spacing
        rows = field.obstacles.rows_in_box(axes[0] - field.reach, axes[-1] + field.reach)
        is_box = field.is_box[rows]
        for some, distances in ((rows[is_box], _to_boxes), (rows[~is_box], _to_polygons)):
            for k in range(0, some.size, _BLOCK):
                np.minimum(best, distances(field.obstacles, some[k : k + _BLOCK], axes), out=best)
    return values


def _to_boxes(obstacles: ObstacleSet, rows: IntArray, axes: FloatArray) -> FloatArray:
    low, high = obstacles.lower[rows], obstacles.upper[rows]
    x = np.maximum(low[:, 0] - axes[:, :1], axes[:, :1] - high[:, 0])[:, None, :]
    y = np.maximum(low[:, 1] - axes[:, 1:], axes[:, 1:] - high[:, 1])[None]
    outside = np.sqrt(np.maximum(x, 0.0) ** 2 + np.maximum(y, 0.0) ** 2)
    nearest: FloatArray = (outside + np.minimum(np.maximum(x, y), 0.0)).min(axis=2)
    return nearest


def _to_polygons(obstacles: ObstacleSet, rows: IntArray, axes: FloatArray) -> FloatArray:
    x, y = (axis[..., None] for axis in np.meshgrid(axes[:, 0], axes[:, 1], indexing="ij"))
    vertices, normals, offsets = (part[rows] for part in (obstacles.vertices, obstacles.normals, obstacles.offsets))
    squared: FloatArray | float = np.inf
    height: FloatArray | float = -np.inf
    ends = np.roll(vertices, -1, axis=1)
    for k in range(vertices.shape[1]):
        px, py = vertices[:, k].T
        ex, ey = (ends[:, k] - vertices[:, k]).T
        norm = np.maximum(ex * ex + ey * ey, 1e-300)
        share = np.clip(((x - px) * ex + (y - py) * ey) / norm, 0.0, 1.0)
        squared = np.minimum(squared, (x - px - share * ex) ** 2 + (y - py - share * ey) ** 2)
        height = np.maximum(height, normals[:, k, 0] * x + normals[:, k, 1] * y - offsets[:, k])
    distance = np.sqrt(squared)
    nearest: FloatArray = np.where(np.asarray(height) < 0.0, -distance, distance).min(axis=2)
    return nearest
