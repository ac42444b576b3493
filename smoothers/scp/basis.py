"""Splines of piecewise linear curvature, as matrices that depend only on the numbers of spans and intervals.

Curvature is linear between knots, so the heading is linear in the knot curvatures: with `u` in [0, 1] along a gear of
length L, `yaw(u) = yaw_start + L * integral_0^u hats(t) dt . K`. The integrals do not depend on the problem, so a basis
is built only once per shape.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import accumulate
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.arrays import FrozenArrays, frozen, product_of_columns, readonly
from optdock.geometry.lazy import cached_property
from smoothers.scp.settings import DEFAULT_SETTINGS

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray, IntArray

__all__ = ["Basis", "Shape", "basis_for", "blocks_of"]

Shape = tuple[tuple[int, int], ...]
"""Per gear: number of knot spans, and of collision intervals in each span."""

_GAUSS = readonly(np.array([0.5 - 0.5 / np.sqrt(3.0), 0.5 + 0.5 / np.sqrt(3.0)]))


@dataclass(frozen=True, eq=False)
class Basis(FrozenArrays):
    """Arrays that depend only on the numbers of spans and intervals.

    Nodes are interval ends; a cusp is a node of both of its gears.
    """

    shape: Shape  # per gear: knot spans and intervals per span
    fit_smoothing: float  # weight of the curvature rate in `fit`
    num_knots: int  # totals over all gears
    num_gears: int
    num_nodes: int
    num_intervals: int
    size: int  # number of path variables: knot curvatures, then gear lengths
    divisions: IntArray  # numbers of spans and of intervals, Shape (num_gears, 2)
    knot_gear: IntArray  # gear of each knot, node, interval and span
    node_gear: IntArray
    interval_gear: IntArray
    span_gear: IntArray
    interval_span: IntArray  # span of each interval
    span_knot: IntArray  # knot at which each span begins; it ends at the next one
    span_counts: FloatArray  # number of spans of the gear of each span
    knot_members: FloatArray  # Shape (num_knots, num_gears), 1 where the knot belongs to the gear
    first_knots: IntArray  # indices for each gear, Shape (num_gears,)
    last_knots: IntArray
    last_nodes: IntArray
    left: IntArray  # node at which each interval begins; it ends at the next one
    position_of: IntArray  # interval boundary (0 to num_intervals) of each node
    fraction: FloatArray  # share of its gear's length at which each node lies
    # Matrices by which curvatures are multiplied are stored by columns, so that NumPy adds in the order of the columns.
    gauss_headings: FloatArray  # Shape (2 num_intervals, num_knots), heading at the two Gauss points of each interval
    # Shape (2 num_intervals, num_gears), weight of each Gauss point as a share of its gear's length
    gauss_shares: FloatArray
    middle_headings: FloatArray  # Shape (num_intervals, num_knots), heading at the middles of the intervals
    node_headings: FloatArray  # Shape (num_nodes, num_knots), heading at the nodes
    node_curvatures: FloatArray  # Shape (num_nodes, num_knots), curvature at the nodes: the hat functions
    span_slopes: FloatArray  # Shape (number of spans, num_knots), curvature rate times gear length in each span
    mass: FloatArray  # Shape (num_knots, num_knots), integrals of products of hats over u
    stiffness: FloatArray  # Shape (num_knots, num_knots), integrals of products of their slopes over u

    @cached_property
    def fit(self) -> FloatArray:
        """Smoothed least squares from turned headings at the interval middles, Shape (num_knots, num_intervals)."""
        middles = self.middle_headings
        normal = (
            product_of_columns(middles, middles) + self.fit_smoothing * self.stiffness + 1e-9 * np.eye(self.num_knots)
        )
        return readonly(np.linalg.solve(normal, middles.T))

    @cached_property
    def packed(self) -> FloatArray:
        """`gauss_headings`, `node_headings` and `node_curvatures` as one array, stored by rows, for the kernels."""
        both = np.concatenate((self.gauss_headings, self.node_headings, self.node_curvatures))
        return readonly(np.ascontiguousarray(both))

    @cached_property
    def own_knots(self) -> tuple[slice, ...]:
        """The knots of each gear."""
        ends = self.last_knots.tolist()
        return tuple(
            slice(end - spans, end + 1) for end, spans in zip(ends, self.divisions[:, 0].tolist(), strict=True)
        )

    @cached_property
    def own_moves(self) -> tuple[slice, ...]:
        """The Gauss points of each gear."""
        counts = (2 * self.divisions[:, 1]).tolist()
        return tuple(slice(end - count, end) for end, count in zip(accumulate(counts), counts, strict=True))

    def slopes(self, curvature: FloatArray) -> FloatArray:
        """Return the curvature rate times the gear length in each span, Shape (number of spans,) [1/m]."""
        change: FloatArray = self.span_counts * (curvature[self.span_knot + 1] - curvature[self.span_knot])
        return change


@lru_cache(maxsize=16)  # of 0.3 MB for three gears
def basis_for(shape: Shape, fit_smoothing: float = DEFAULT_SETTINGS.resolution.fit_smoothing) -> Basis:
    """Return the basis of a shape, with read-only arrays; `fit_smoothing` weights the curvature rate in `fit`."""
    spans = np.array([q for q, _ in shape])
    cells = np.array([q * r for q, r in shape])
    gears, blocks = np.arange(len(spans)), blocks_of(shape)
    knot_gear, node_gear = np.repeat(gears, spans + 1), np.repeat(gears, cells + 1)
    span_gear = np.repeat(gears, spans)
    last_knots, last_nodes = np.cumsum(spans + 1) - 1, np.cumsum(cells + 1) - 1
    arrays = {
        "divisions": np.column_stack((spans, cells)),
        "knot_gear": knot_gear,
        "node_gear": node_gear,
        "interval_gear": np.repeat(gears, cells),
        "span_gear": span_gear,
        "interval_span": np.repeat(np.arange(span_gear.size), np.repeat([r for _, r in shape], spans)),
        "span_knot": np.arange(span_gear.size) + span_gear,
        "span_counts": spans[span_gear].astype(np.float64),
        "knot_members": (knot_gear[:, None] == gears).astype(np.float64),
        "first_knots": last_knots - spans,
        "last_knots": last_knots,
        "last_nodes": last_nodes,
        "left": np.delete(np.arange(node_gear.size), last_nodes),
        "position_of": np.arange(node_gear.size) - node_gear,
        "fraction": np.concatenate([block.nodes for block in blocks]),
        "gauss_headings": np.asfortranarray(_heading_rows(blocks, [block.gauss_integrals for block in blocks])),
        "gauss_shares": _block_diagonal([np.full((2 * n, 1), 0.5 / n) for n in cells]),
        "middle_headings": _heading_rows(blocks, [block.middle_integrals for block in blocks]),
        "node_headings": np.asfortranarray(_heading_rows(blocks, [block.node_integrals for block in blocks])),
        "node_curvatures": np.asfortranarray(_block_diagonal([block.hats for block in blocks])),
        "span_slopes": _block_diagonal([block.slopes for block in blocks]),
        "mass": _block_diagonal([block.mass for block in blocks]),
        "stiffness": _block_diagonal([block.stiffness for block in blocks]),
    }
    knots, count = knot_gear.size, len(spans)
    sizes = knots, count, node_gear.size, int(np.sum(cells)), knots + count
    return Basis(shape, fit_smoothing, *sizes, **arrays)


class _Block(NamedTuple):
    """The arrays of one gear of q spans and n intervals; see `Basis`."""

    nodes: FloatArray  # Shape (n + 1,)
    node_integrals: FloatArray  # integrals of the hat functions, Shape (n + 1, q + 1)
    gauss_integrals: FloatArray  # Shape (2 n, q + 1)
    middle_integrals: FloatArray  # Shape (n, q + 1)
    hats: FloatArray  # Shape (n + 1, q + 1)
    slopes: FloatArray  # Shape (q, q + 1)
    mass: FloatArray  # Shape (q + 1, q + 1)
    stiffness: FloatArray


def blocks_of(shape: Shape) -> list[_Block]:
    """Return the arrays of each gear; half of the work for a new basis."""
    return [_block(spans, spans * cells) for spans, cells in shape]


@lru_cache(maxsize=128)  # of 10 kB
def _block(spans: int, cells: int) -> _Block:
    """Return the arrays of a gear."""
    nodes, steps = np.arange(cells + 1) / cells, np.diff(np.eye(spans + 1), axis=0)
    gauss, middles = ((np.arange(cells)[:, None] + _GAUSS) / cells).ravel(), (np.arange(cells) + 0.5) / cells
    at_all = _hat_integrals(spans, np.concatenate((nodes, gauss, middles)))
    at_nodes, at_gauss, at_middles = at_all[: cells + 1], at_all[cells + 1 : -cells], at_all[-cells:]
    hats = np.maximum(0.0, 1.0 - np.abs(spans * nodes[:, None] - np.arange(spans + 1)))
    stiffness = spans * (steps.T @ steps)
    return frozen(_Block(nodes, at_nodes, at_gauss, at_middles, hats, spans * steps, _mass(spans), stiffness))


def _hat_integrals(spans: int, u: FloatArray) -> FloatArray:
    """Return the integrals of the hat functions from 0 to u. Shape (len(u), spans + 1)."""
    t = np.minimum(np.maximum(spans * u[:, None] - np.arange(spans + 1), -1.0), 1.0)
    half = 0.5 * (1.0 - np.abs(t)) ** 2
    area = np.where(t < 0.0, half, 1.0 - half)
    area[:, 0] -= 0.5
    integrals: FloatArray = area / spans
    return integrals


def _heading_rows(blocks: list[_Block], parts: list[FloatArray]) -> FloatArray:
    """Return heading changes per unit of (gear length * knot curvature), summed over the preceding gears."""
    out, row, column = _block_diagonal(parts), 0, 0
    for block, part in zip(blocks[:-1], parts[:-1], strict=True):
        row, end = row + part.shape[0], column + part.shape[1]
        out[row:, column:end] = block.node_integrals[-1]
        column = end
    return out


def _block_diagonal(parts: list[FloatArray]) -> FloatArray:
    out = np.zeros((sum(p.shape[0] for p in parts), sum(p.shape[1] for p in parts)))
    row = column = 0
    for part in parts:
        out[row : row + part.shape[0], column : column + part.shape[1]] = part
        row, column = row + part.shape[0], column + part.shape[1]
    return out


def _mass(spans: int) -> FloatArray:
    matrix = (4.0 * np.eye(spans + 1) + np.eye(spans + 1, k=1) + np.eye(spans + 1, k=-1)) / (6.0 * spans)
    matrix[0, 0] = matrix[-1, -1] = 1.0 / (3.0 * spans)
    return matrix
