"""Scenes at the limits of exact geometry: seams, slivers, denormal edges, places outside of the map.

Each changes a path problem into one with a short and simple path, so that only the trap decides.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
import shapely

from experiments.fuzz.generators.shapes import footprint, log_uniform, rectangle, turned
from experiments.fuzz.oracle.motion import motion_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from experiments.fuzz.case import Case
    from experiments.fuzz.generators.shapes import Points

__all__ = ["trap"]

Rng: TypeAlias = np.random.Generator


def trap(rng: Rng) -> Case:
    """Return one of the scenes below."""
    return _TRAPS[int(rng.integers(len(_TRAPS)))](rng)


def _scene(path: list[Case], outline: Points, obstacles: list[Points], required: float = 0.0) -> Case:
    motion = motion_of(path)
    return {
        "kind": "paths",
        "path": path,
        "footprint": {"polygon": outline},
        "obstacles": obstacles,
        "grid": None,
        "dock": {"pose": motion.end.tolist(), "footprint": None, "direction": "auto", "final_straight": 0.0},
        "start": motion.start.tolist(),
        "start_speed": 0.0,
        "start_curvature": None,
        "clearance": [required, required, 0.0],
        "limits": {},
        "zone": [None, 0.0],
    }


def _straight(rng: Rng, x: float, y: float, yaw: float) -> list[Case]:
    """Return a straight path that ends at a pose."""
    way = float(rng.uniform(0.1, 1.5))
    start = [x - way * math.cos(yaw), y - way * math.sin(yaw), yaw]
    return [{"type": "clothoid", "start": start, "knots": [0.0, way], "curvature": [0.0, 0.0], "gear": 1}]


def _into_a_seam(rng: Rng) -> Case:
    """A pointed robot whose tip ends between two touching obstacles, or on a seam within a non-convex one."""
    half = log_uniform(rng, 1e-5, 0.3)
    outline = [[0.3, 0.0], [0.0, half], [-0.3, max(half, 0.1)], [-0.3, -max(half, 0.1)], [0.0, -half]]
    yaw, depth = float(rng.uniform(-math.pi, math.pi)), log_uniform(rng, 2e-6, 0.05)
    path = _straight(rng, 0.0, 0.0, yaw)
    front = 0.3 - depth
    above, below = (
        [[front, 0.0], [1.3, 0.0], [1.3, 1.0], [front, 1.0]],
        [[front, -1.0], [1.3, -1.0], [1.3, 0.0], [front, 0.0]],
    )
    # Cut into convex pieces, these two have a seam that may begin at the front.
    corner = [[front, -1.0], [1.3, -1.0], [1.3, 1.0], [front + 0.5, 1.0], [front + 0.5, 0.0], [front, 0.0]]
    tee = [[front, -0.3], [1.3, -1.0], [1.0, 0.0], [1.3, 1.0], [front, 0.3]]
    solids = ([above, below], [corner], [tee])[int(rng.choice(3, p=[0.6, 0.2, 0.2]))]
    return _scene(path, outline, [turned(one, yaw) for one in solids])


def _splinter(rng: Rng) -> Case:
    """A post of a micrometre or less inside the robot, near a corner of a non-convex outline."""
    outline = None
    for _ in range(30):
        drawn = footprint(rng)
        if "polygon" in drawn and not _is_convex(drawn["polygon"]):
            outline = drawn["polygon"]
            break
    outline = outline or [[0.3, 0.3], [-0.3, 0.3], [0.0, 0.0], [-0.3, -0.3], [0.3, -0.3]]
    body, corners = shapely.Polygon(outline), np.array(outline)
    way = rng.uniform(-math.pi, math.pi, 64)
    reach = 10.0 ** rng.uniform(-6, -1, 64)
    points = corners[rng.integers(len(corners), size=64)] + np.column_stack((reach * np.cos(way), reach * np.sin(way)))
    inside = shapely.contains_xy(body, points[:, 0], points[:, 1])
    if not inside.any():
        return _into_a_seam(rng)
    at, size = points[int(np.argmax(inside))], log_uniform(rng, 1e-8, 1e-6)
    yaw = float(rng.uniform(-math.pi, math.pi))
    post = (np.array(rectangle(size / 2, size / 2, size)) + at).tolist()
    return _scene(_straight(rng, 0.0, 0.0, yaw), outline, [turned(post, yaw)])


def _is_convex(outline: Points) -> bool:
    polygon = shapely.Polygon(outline)
    return bool(shapely.area(shapely.convex_hull(polygon)) - polygon.area < 1e-9)


def _denormal_edge(rng: Rng) -> Case:
    """An edge of nearly denormal length at the origin."""
    a, b = float(rng.integers(1, 4)) * 5e-324, float(rng.integers(-3, 4)) * 5e-324
    wedge = [[0.0, 0.0], [a, b], [1.0, 1.0], [-1.0, 1.0]]
    heading = float(rng.uniform(0.1, math.pi - 0.1))  # heading of the motion, towards the tip from below
    required = log_uniform(rng, 1e-2, 1.0)
    gap = 0.2 + required - log_uniform(rng, 3e-6, 0.1 * required)
    path = _straight(rng, -gap * math.cos(heading), -gap * math.sin(heading), heading)
    return _scene(path, rectangle(0.2, 0.2, 0.4), [wedge], required)


def _off_the_map(rng: Rng) -> Case:
    """A small free map, and a path far away from it."""
    away, yaw = log_uniform(rng, 5.0, 1e5), float(rng.uniform(-math.pi, math.pi))
    path = _straight(rng, away * math.cos(yaw), away * math.sin(yaw), float(rng.uniform(-math.pi, math.pi)))
    case = _scene(path, rectangle(0.4, 0.4, 0.6), [], float(rng.choice([0.0, 0.05])))
    case["grid"] = {"cells": np.zeros((40, 40), dtype=int).tolist(), "resolution": 0.1, "origin": [-2.0, -2.0]}
    case["grid_alone"] = False
    return case


_TRAPS: tuple[Callable[[Rng], Case], ...] = (_into_a_seam, _into_a_seam, _splinter, _denormal_edge, _off_the_map)
