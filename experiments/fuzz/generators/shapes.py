"""Outlines of robots and obstacles: common ones, and numerically difficult ones."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
import shapely

if TYPE_CHECKING:
    from collections.abc import Callable

    from experiments.fuzz.case import Case

__all__ = ["Points", "end_rules", "footprint", "log_uniform", "obstacle", "turned"]

Points: TypeAlias = "list[list[float]]"
Rng: TypeAlias = np.random.Generator


def log_uniform(rng: Rng, low: float, high: float) -> float:
    """Return a number whose logarithm is uniform."""
    return float(10.0 ** rng.uniform(math.log10(low), math.log10(high)))


def end_rules(rng: Rng, required: float) -> list[float | None]:
    """Return rare parts of a clearance rule: the run at the dock, and the sufficient clearance at the start [m]."""
    if rng.uniform() < 0.8:
        return []
    return [float(rng.choice([0.0, 0.1, 1.0])), float(required * rng.uniform()) if rng.uniform() < 0.5 else None]


def turned(points: Points, yaw: float, x: float = 0.0, y: float = 0.0) -> Points:
    """Return points rotated, then moved."""
    c, s = math.cos(yaw), math.sin(yaw)
    return [[x + c * px - s * py, y + s * px + c * py] for px, py in points]


def rectangle(front: float, rear: float, width: float) -> Points:
    """Return a rectangle from x = -rear to x = front, centred in y."""
    return [[front, width / 2], [-rear, width / 2], [-rear, -width / 2], [front, -width / 2]]


def _robot_rectangle(rng: Rng) -> Points:
    return rectangle(rng.uniform(0.1, 0.8), rng.uniform(0.05, 0.8), rng.uniform(0.1, 0.9))


def _needle(rng: Rng) -> Points:
    half = log_uniform(rng, 1e-4, 0.15)
    return [[rng.uniform(0.3, 0.9), 0.0], [0.0, half], [-0.3, max(half, 0.1)], [-0.3, -max(half, 0.1)], [0.0, -half]]


def _regular(rng: Rng) -> Points:
    n, r = int(rng.choice([3, 5, 6, 8, 12, 24, 64])), rng.uniform(0.15, 0.5)
    angle = 2.0 * math.pi * (np.arange(n) + rng.uniform()) / n
    return np.column_stack((r * np.cos(angle), rng.uniform(0.4, 1.0) * r * np.sin(angle))).tolist()


def _fork(rng: Rng) -> Points:
    """Return a U, open to the front."""
    a, w, t = rng.uniform(0.3, 0.8), rng.uniform(0.3, 0.8), log_uniform(rng, 1e-3, 0.12)
    return [[a, w / 2], [-0.2, w / 2], [-0.2, -w / 2], [a, -w / 2], [a, t - w / 2], [0.0, t - w / 2],
            [0.0, w / 2 - t], [a, w / 2 - t]]  # fmt: skip


def _angle(rng: Rng) -> Points:
    """Return an L."""
    a, b, t = rng.uniform(0.3, 0.8), rng.uniform(0.2, 0.6), rng.uniform(0.02, 0.15)
    return [[-t, -t], [a, -t], [a, 0.0], [0.0, 0.0], [0.0, b], [-t, b]]


def _star(rng: Rng) -> Points:
    n, outer = int(rng.integers(3, 9)), rng.uniform(0.25, 0.6)
    inner = outer * rng.uniform(0.15, 0.9)
    angle = math.pi * np.arange(2 * n) / n
    r = np.where(np.arange(2 * n) % 2, inner, outer)
    return np.column_stack((r * np.cos(angle), r * np.sin(angle))).tolist()


def _bitten(rng: Rng) -> Points:
    """Return a shape with a round bay of many corners, which triangulates into a fan of slivers."""
    angle = np.linspace(-0.4, 0.4, int(rng.integers(8, 40)))
    arc = np.column_stack((3.0 - 2.6 * np.cos(angle), 2.6 * np.sin(angle)))
    points: Points = arc.tolist()
    return [*points, [-0.5, float(arc[-1, 1])], [-0.5, float(arc[0, 1])]]


_ROBOTS: tuple[tuple[float, Callable[[Rng], Points]], ...] = (
    (0.4, _robot_rectangle), (0.12, _needle), (0.15, _regular), (0.09, _fork), (0.07, _angle), (0.06, _star),
    (0.03, _bitten),
)  # fmt: skip


def _drawn(rng: Rng, table: tuple[tuple[float, Callable[[Rng], Points]], ...]) -> Points:
    weights = np.array([weight for weight, _ in table])
    return table[int(rng.choice(len(table), p=weights / weights.sum()))][1](rng)


def footprint(rng: Rng) -> Case:
    """Return a robot's outline: a polygon, or (one in twelve) a disc."""
    if rng.uniform() < 1.0 / 12.0:
        return {"radius": float(rng.uniform(0.1, 0.5))}
    return {"polygon": _valid(_drawn(rng, _ROBOTS))}


def _valid(points: Points) -> Points:
    return points if shapely.Polygon(points).is_valid else rectangle(0.4, 0.3, 0.5)


def _post(rng: Rng) -> Points:
    size = log_uniform(rng, 1e-7, 0.1)
    return rectangle(size / 2, size / 2, size * rng.uniform(0.3, 1.0))


def _box(rng: Rng) -> Points:
    return rectangle(rng.uniform(0.05, 0.6), rng.uniform(0.05, 0.6), rng.uniform(0.05, 0.8))


def _sliver(rng: Rng) -> Points:
    return [[rng.uniform(0.2, 1.0), 0.0], [0.0, log_uniform(rng, 1e-9, 1e-2)], [-0.1, 0.0]]


def _thin_wall(rng: Rng) -> Points:
    return rectangle(rng.uniform(0.1, 1.0), rng.uniform(0.1, 1.0), log_uniform(rng, 1e-6, 0.02))


def _drum(rng: Rng) -> Points:
    n, r = int(rng.choice([8, 16, 48])), rng.uniform(0.03, 0.5)
    angle = 2.0 * math.pi * np.arange(n) / n
    return np.column_stack((r * np.cos(angle), r * np.sin(angle))).tolist()


def shallow_wall(rng: Rng) -> Points:
    """Return a wall towards -y whose face is a chain of reflex corners of almost a nanoradian each."""
    length = float(rng.choice([4.0, 100.0, 1e4, 1e5]))
    n = int(rng.choice([1, 40, 200])) if length < 1e3 else 1
    x = np.linspace(length / 2, -length / 2, n + 2)
    y = 0.9e-9 / (2.0 * (x[0] - x[1])) * x * x
    face = np.column_stack((x, -(y - y.min())))[::-1]
    return [*face.tolist(), [length / 2, length], [-length / 2, length]]


_OBSTACLES: tuple[tuple[float, Callable[[Rng], Points]], ...] = (
    (0.22, _post), (0.25, _box), (0.1, _sliver), (0.13, _thin_wall), (0.1, _drum), (0.08, _angle), (0.07, _star),
    (0.05, _fork),
)  # fmt: skip


def obstacle(rng: Rng) -> Points:
    """Return an obstacle around the origin, at a random heading."""
    points = turned(_drawn(rng, _OBSTACLES), rng.uniform(-math.pi, math.pi))
    return points if shapely.Polygon(points).is_valid else _post(rng)
