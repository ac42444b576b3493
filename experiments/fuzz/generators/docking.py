"""Random docking problems, plausible and implausible."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
import shapely

from experiments.fuzz.generators.shapes import footprint, log_uniform, obstacle, rectangle, turned
from experiments.fuzz.oracle.world import placed

if TYPE_CHECKING:
    from experiments.fuzz.case import Case
    from experiments.fuzz.generators.shapes import Points

__all__ = ["docking_problem"]

Rng: TypeAlias = np.random.Generator
# [s]: most plans are found within the shorter ones.
_BUDGETS = (0.02, 0.03, 0.03, 0.05, 0.05, 0.05, 0.1)


def docking_problem(rng: Rng) -> Case:
    """Return a start around a dock, with limits, obstacles, zones and a budget; `kind` is `plans`."""
    far = 0.0 if rng.uniform() < 0.93 else log_uniform(rng, 10.0, 1e5)
    goal = [float(rng.uniform(-4, 4)) + far, float(rng.uniform(-4, 4)), float(rng.uniform(-math.pi, math.pi))]
    start = _start(rng, goal)
    limits = _limits(rng)
    case: Case = {
        "kind": "plans",
        "footprint": {"polygon": rectangle(0.4, 0.3, 0.5)} if rng.uniform() < 0.4 else footprint(rng),
        "obstacles": [],
        "grid": None,
        "dock": {
            "pose": goal,
            "footprint": None,
            "direction": str(rng.choice(["auto", "forward", "backward"], p=[0.7, 0.2, 0.1])),
            "final_straight": float(rng.choice([0.0, 0.1, 0.3])) if rng.uniform() < 0.6 else 0.0,
        },
        "start": start,
        "start_speed": 0.0,
        "start_curvature": None,
        "clearance": _rule(rng),
        "limits": limits,
        "zone": [None, 0.0] if rng.uniform() < 0.4 else [log_uniform(rng, 0.02, 0.4), float(rng.uniform(0.05, 1.5))],
        "budget": float(rng.choice(_BUDGETS)),
    }
    if rng.uniform() < 0.2:
        _moving(rng, case)
    own = rng.spawn(1)[0]
    if own.uniform() < 0.2:
        case["tracking"] = [log_uniform(own, 1e-3, 0.05), float(own.uniform(0.0, 0.05))]
    _furnish(rng, case)
    return case


def _start(rng: Rng, goal: list[float]) -> list[float]:
    """Return a start, mostly behind the dock's entry and roughly towards it; sometimes anywhere."""
    away, side = rng.uniform(0.5, 4.0), rng.normal(0.0, 0.5)
    yaw = rng.normal(0.0, 0.4)
    if rng.uniform() < 0.2:
        side, yaw = rng.uniform(-3, 3), rng.uniform(-math.pi, math.pi)
    backwards = rng.uniform() < 0.25  # the robot stands beyond its goal and must reverse into it
    [[x, y]] = turned([[away if backwards else -away, side]], goal[2], goal[0], goal[1])
    return [x, y, goal[2] + float(yaw)]


def _limits(rng: Rng) -> Case:
    limits: Case = {
        "max_speed": log_uniform(rng, 0.1, 2.0),
        "max_reverse_speed": log_uniform(rng, 0.1, 2.0),
        "max_acceleration": log_uniform(rng, 0.1, 2.0),
        "max_deceleration": log_uniform(rng, 0.1, 2.0),
        "max_jerk": log_uniform(rng, 0.3, 16.0),
    }
    if rng.uniform() < 0.8:
        limits["max_curvature"] = log_uniform(rng, 0.7, 4.0)
        limits["max_curvature_rate"] = log_uniform(rng, 2.0, 20.0)
    for name, low in (
        ("yaw_rate", 0.1),
        ("yaw_acceleration", 0.1),
        ("lateral_acceleration", 0.03),
        ("wheel_speed", 0.1),
        ("lateral_jerk", 0.05),
    ):
        if rng.uniform() < 0.3:
            limits[f"max_{name}"] = log_uniform(rng, low, 2.0)
    limits["track_width"] = float(rng.uniform(0.2, 0.9)) if "max_wheel_speed" in limits else 0.0
    return limits


def _rule(rng: Rng) -> list[float]:
    required = 0.0 if rng.uniform() < 0.2 else float(rng.choice([0.02, 0.05, 0.1]))
    return [required, required * float(rng.choice([0.0, 1.0])), float(rng.choice([0.0, 0.5]))]


def _moving(rng: Rng, case: Case) -> None:
    """Return a start at speed, in either gear, with an acceleration, up to the limits and slightly beyond."""
    gear = 1 if rng.uniform() < 0.7 else -1
    top = case["limits"]["max_speed" if gear > 0 else "max_reverse_speed"]
    case["start_speed"] = gear * top * float(rng.uniform(0.05, 1.02))
    if rng.uniform() < 0.4:
        most = case["limits"]["max_acceleration"], case["limits"]["max_deceleration"]
        case["start_acceleration"] = gear * float(rng.uniform(-1.02 * most[1], 1.02 * most[0]))
    if rng.uniform() < 0.3:  # the wheels already turn faster than allowed
        case["limits"]["max_wheel_speed"] = abs(case["start_speed"]) * float(rng.uniform(0.3, 1.1))
        case["limits"]["track_width"] = float(rng.uniform(0.2, 0.9))
    if rng.uniform() < 0.2:
        case["start_curvature"] = float(rng.uniform(-1, 1)) * case["limits"].get("max_curvature", 1.0)


def _furnish(rng: Rng, case: Case) -> None:
    """Add obstacles around the way, a station, a grid; those on the start or the goal are mostly removed."""
    start, goal = np.array(case["start"]), np.array(case["dock"]["pose"])
    ends = _outlines(case, np.stack((start, goal)))
    for _ in range(int(rng.choice([0, 1, 3, 8, 25], p=[0.2, 0.25, 0.3, 0.2, 0.05]))):
        along = rng.uniform(-0.2, 1.2)
        middle = start[:2] + along * (goal[:2] - start[:2]) + rng.normal(0.0, 0.8, 2)
        placed_one = turned(obstacle(rng), 0.0, float(middle[0]), float(middle[1]))
        near = float(shapely.Polygon(placed_one).distance(shapely.multipolygons(ends)))
        if near > case["clearance"][0] * rng.uniform(0.0, 1.5) or rng.uniform() < 0.03:
            case["obstacles"].append(placed_one)
    if rng.uniform() < 0.4:
        case["dock"]["footprint"] = _station(rng, case)
    if rng.uniform() < 0.2:
        _add_grid(rng, case, ends)


def _outlines(case: Case, poses: np.ndarray) -> np.ndarray:
    shape = case["footprint"]
    angle = np.linspace(0.0, 2.0 * math.pi, 33)[:-1]
    disc = np.column_stack((np.cos(angle), np.sin(angle)))
    points = np.array(shape["polygon"]) if "polygon" in shape else shape["radius"] * disc
    bodies: np.ndarray = shapely.polygons(placed(points, poses))
    return bodies


def _station(rng: Rng, case: Case) -> Points:
    """Return a dock before or behind the docked robot."""
    shape = case["footprint"]
    points = np.array(shape["polygon"]) if "polygon" in shape else shape["radius"] * np.array([[-1.0, 0], [1.0, 0]])
    gap = log_uniform(rng, 1e-3, 0.1) + case["clearance"][1]
    wall = turned(rectangle(0.2, 0.0, float(rng.uniform(0.3, 1.0))), 0.0, float(points[:, 0].max()) + gap, 0.0)
    if rng.uniform() < 0.2:
        wall = turned(rectangle(0.0, 0.2, float(rng.uniform(0.3, 1.0))), 0.0, float(points[:, 0].min()) - gap, 0.0)
    return wall


def _add_grid(rng: Rng, case: Case, ends: np.ndarray) -> None:
    """Add a grid around start and goal, with walls and speckles; sometimes it is the only source of obstacles."""
    side = float(rng.choice([0.05, 0.1]))
    low, high = (
        np.array(shapely.bounds(ends)).reshape(-1, 4)[:, :2].min(axis=0),
        shapely.bounds(ends)[:, 2:].max(axis=0),
    )
    origin = low - rng.uniform(0.2, 2.0)
    size = np.minimum(np.ceil((high + rng.uniform(0.2, 2.0) - origin) / side), 200).astype(int)
    cells = rng.choice([0, 254, 255], size=(size[1], size[0]), p=[0.985, 0.01, 0.005])
    if rng.uniform() < 0.3:  # a wall across the whole grid
        cells[:, int(rng.integers(size[0]))] = 254
    j, i = np.nonzero(cells)
    boxes = shapely.box(origin[0] + side * i, origin[1] + side * j,
                        origin[0] + side * (i + 1), origin[1] + side * (j + 1))  # fmt: skip
    if i.size:
        near = shapely.buffer(shapely.multipolygons(ends), case["clearance"][0])
        hit = shapely.intersects(boxes, near)
        cells[j[hit], i[hit]] = 0
    case["grid"] = {"cells": cells.tolist(), "resolution": side, "origin": origin.tolist()}
    case["grid_alone"] = bool(rng.uniform() < 0.3)
