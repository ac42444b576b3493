"""Constant matrices of a clothoid spline with a given number of knots and intervals; cached by that shape.

Curvature is linear between knots, so the heading is linear in the knot curvatures: with `u` in [0, 1] along a gear of
length L, `yaw(u) = yaw_start + L * integral_0^u hats(t) dt . K`. The integrals do not depend on the problem.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray

__all__ = ["Layout", "Shape", "layout_for"]

Shape = tuple[tuple[int, int], ...]
"""Per gear: number of knot spans, and of intervals in each span."""

_GAUSS = np.array([0.5 - 0.5 / np.sqrt(3.0), 0.5 + 0.5 / np.sqrt(3.0)])
_FIT_SMOOTHING = 1e-4


@dataclass(frozen=True, eq=False)
class Layout:
    """What depends on the shape alone. Nodes are interval ends; a cusp is a node of both of its gears.

    Args:
        shape: Per gear: knot spans and intervals per span.

    Attributes:
        num_knots, num_gears, num_nodes, num_intervals: Counts.
        size: Number of path variables: knot curvatures, then gear lengths.
        knot_gear, node_gear, interval_gear: Gear of each.
        members: Shape (num_knots, num_gears), 1 where the knot belongs to the gear.
        first_knots, last_knots, last_nodes: Of every gear.
        left: Node at which each interval begins; it ends at the next one.
        position_of: Interval boundary (0 to num_intervals) of each node.
        fraction: Share of its gear's length at which each node lies.
        gauss_rows: Shape (2 num_intervals, num_knots), heading at the two Gauss points of each interval.
        gauss_shares: Shape (2 num_intervals, num_gears), share of its gear's length that each Gauss point stands for.
        gauss_members: Shape (2 num_intervals, num_gears), 1 where the Gauss point belongs to the gear.
        node_rows: Shape (num_nodes, num_knots), heading at the nodes.
        node_hats: Shape (num_nodes, num_knots), curvature at the nodes.
        slope_rows: Shape (num_intervals, num_knots), curvature rate times gear length in each interval.
        span_rows: Shape (number of spans, num_knots), the same once per span.
        span_gear: Gear of each span.
        mass, stiffness: Shape (num_knots, num_knots), integrals of hats and of their slopes over u.
        fit: Shape (num_knots, num_intervals), smoothed least squares from turned headings at the interval middles.
    """

    shape: Shape
    num_knots: int = field(init=False)
    num_gears: int = field(init=False)
    num_nodes: int = field(init=False)
    num_intervals: int = field(init=False)
    size: int = field(init=False)
    knot_gear: IntArray = field(init=False)
    node_gear: IntArray = field(init=False)
    interval_gear: IntArray = field(init=False)
    members: FloatArray = field(init=False)
    first_knots: IntArray = field(init=False)
    last_knots: IntArray = field(init=False)
    last_nodes: IntArray = field(init=False)
    left: IntArray = field(init=False)
    position_of: IntArray = field(init=False)
    fraction: FloatArray = field(init=False)
    gauss_rows: FloatArray = field(init=False)
    gauss_shares: FloatArray = field(init=False)
    gauss_members: FloatArray = field(init=False)
    node_rows: FloatArray = field(init=False)
    node_hats: FloatArray = field(init=False)
    slope_rows: FloatArray = field(init=False)
    span_rows: FloatArray = field(init=False)
    span_gear: IntArray = field(init=False)
    mass: FloatArray = field(init=False)
    stiffness: FloatArray = field(init=False)
    fit: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        spans = np.array([q for q, _ in self.shape])
        cells = np.array([q * r for q, r in self.shape])
        values = {**_counts(spans, cells), **_indices(spans, cells)}
        gauss = [((np.arange(n)[:, None] + _GAUSS) / n).ravel() for n in cells]
        nodes = [np.arange(n + 1) / n for n in cells]
        middles = [(np.arange(n) + 0.5) / n for n in cells]
        values["gauss_rows"] = _heading_rows(spans, gauss)
        values["gauss_shares"] = _blocks([np.full((2 * n, 1), 0.5 / n) for n in cells])
        values["gauss_members"] = _blocks([np.ones((2 * n, 1)) for n in cells])
        values["node_rows"] = _heading_rows(spans, nodes)
        values["node_hats"] = _blocks([_hats(q, u) for q, u in zip(spans, nodes, strict=True)])
        slopes = [q * np.diff(np.eye(q + 1), axis=0) for q in spans]
        values["span_rows"] = _blocks(slopes)
        repeats = np.repeat(np.array([r for _, r in self.shape]), spans)
        values["slope_rows"] = np.repeat(_blocks(slopes), repeats, axis=0)
        values["mass"] = _blocks([_mass(q) for q in spans])
        stiffness = _blocks([_stiffness(q) for q in spans])
        values["stiffness"] = stiffness
        rows = _heading_rows(spans, middles)
        normal = rows.T @ rows + _FIT_SMOOTHING * stiffness + 1e-9 * np.eye(rows.shape[1])
        values["fit"] = np.linalg.solve(normal, rows.T)
        for name, value in values.items():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
            object.__setattr__(self, name, value)

    def per_knot(self, of_gears: FloatArray) -> FloatArray:
        """One value per gear, repeated for its knots. Shape (num_knots,)."""
        repeated: FloatArray = of_gears[self.knot_gear]
        return repeated

    @property
    def inner_knots(self) -> BoolArray:
        """Knots that are not the last one, whose curvature is zero. Shape (num_knots,)."""
        return np.arange(self.num_knots) < self.num_knots - 1


@lru_cache(maxsize=64)
def layout_for(shape: Shape) -> Layout:
    """The layout of a shape, built once."""
    return Layout(shape)


def _counts(spans: IntArray, cells: IntArray) -> dict[str, int]:
    knots, gears = int(np.sum(spans + 1)), len(spans)
    return {
        "num_knots": knots,
        "num_gears": gears,
        "num_nodes": int(np.sum(cells + 1)),
        "num_intervals": int(np.sum(cells)),
        "size": knots + gears,
    }


def _indices(spans: IntArray, cells: IntArray) -> dict[str, FloatArray]:
    gears = np.arange(len(spans))
    knot_gear, node_gear = np.repeat(gears, spans + 1), np.repeat(gears, cells + 1)
    last_knots, last_nodes = np.cumsum(spans + 1) - 1, np.cumsum(cells + 1) - 1
    left = np.delete(np.arange(node_gear.size), last_nodes)
    return {
        "knot_gear": knot_gear,
        "node_gear": node_gear,
        "interval_gear": np.repeat(gears, cells),
        "span_gear": np.repeat(gears, spans),
        "members": (knot_gear[:, None] == gears).astype(np.float64),
        "first_knots": last_knots - spans,
        "last_knots": last_knots,
        "last_nodes": last_nodes,
        "left": left,
        "position_of": np.arange(node_gear.size) - node_gear,
        "fraction": np.concatenate([np.arange(n + 1) / n for n in cells]),
    }


def _hats(spans: int, u: FloatArray) -> FloatArray:
    """Hat functions on a uniform grid of [0, 1]. Shape (len(u), spans + 1)."""
    return np.maximum(0.0, 1.0 - np.abs(spans * u[:, None] - np.arange(spans + 1)))


def _hat_integrals(spans: int, u: FloatArray) -> FloatArray:
    """Integrals of the hat functions from 0 to u. Shape (len(u), spans + 1)."""
    t = np.clip(spans * u[:, None] - np.arange(spans + 1), -1.0, 1.0)
    area = np.where(t < 0.0, 0.5 * (1.0 + t) ** 2, 1.0 - 0.5 * (1.0 - t) ** 2)
    area[:, 0] -= 0.5
    integrals: FloatArray = area / spans
    return integrals


def _heading_rows(spans: IntArray, points: list[FloatArray]) -> FloatArray:
    """Heading change per unit of (gear length * knot curvature); later gears carry the earlier ones in full."""
    rows = []
    for m, u in enumerate(points):
        done = [np.tile(_hat_integrals(q, np.ones(1)), (u.size, 1)) for q in spans[:m]]
        ahead = [np.zeros((u.size, q + 1)) for q in spans[m + 1 :]]
        rows.append(np.hstack([*done, _hat_integrals(spans[m], u), *ahead]))
    return np.vstack(rows)


def _blocks(parts: list[FloatArray]) -> FloatArray:
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


def _stiffness(spans: int) -> FloatArray:
    slopes = np.diff(np.eye(spans + 1), axis=0)
    product: FloatArray = spans * (slopes.T @ slopes)
    return product
