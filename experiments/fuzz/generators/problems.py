"""Path problems whose margins are near the requirement, the likely place of a false certificate."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import shapely

from experiments.fuzz.generators.routes import route
from experiments.fuzz.generators.shapes import (
    end_rules,
    footprint,
    log_uniform,
    obstacle,
    rectangle,
    shallow_wall,
    turned,
)
from experiments.fuzz.generators.traps import trap
from experiments.fuzz.oracle.motion import motion_of
from experiments.fuzz.oracle.sweep import start_run, sweep, tube
from experiments.fuzz.oracle.world import World

if TYPE_CHECKING:
    from experiments.fuzz.case import Case
    from experiments.fuzz.generators.shapes import Points
    from experiments.fuzz.oracle.motion import Floats, Motion
    from experiments.fuzz.oracle.sweep import Sweep

__all__ = ["beside", "path_problem", "wanted_margin"]

Rng: TypeAlias = np.random.Generator
_POSES = 48  # poses of the swept area used to place obstacles next to it
_TRAPS = 0.06  # share of cases built around one weak spot
_TRIES = 10  # outline points tried per obstacle, until one is at the border of the swept area


def path_problem(rng: Rng) -> Case:
    """Return a path with a problem that it solves, nearly solves or nearly misses."""
    if rng.uniform() < _TRAPS:
        return trap(rng)
    gears = route(rng)
    motion = motion_of(gears)
    case = _frame(rng, gears, motion)
    swept = _Swept(case, motion)
    scene = rng.uniform()
    if scene < 0.18:
        _add_grid(rng, case, swept)
    if scene >= 0.12:
        case["obstacles"] += _beside(rng, swept, float(case["clearance"][0]))
    if rng.uniform() < 0.1:
        case["dock"]["footprint"] = _station(rng, swept)
    _aim(rng, case, motion)
    _spoil(rng, case)
    return case


def _frame(rng: Rng, gears: list[Case], motion: Motion) -> Case:
    case: Case = {
        "kind": "paths",
        "path": gears,
        "footprint": footprint(rng),
        "obstacles": [],
        "grid": None,
        "dock": {"pose": motion.end.tolist(), "footprint": None, **_entry(rng, motion)},
        "start": motion.start.tolist(),
        "start_speed": 0.0,
        "start_curvature": float(motion.k0[0]) if motion.exact[0] and rng.uniform() < 0.1 else None,
        "clearance": _rule(rng),
        "limits": _bounds(rng, motion),
        "zone": [None, 0.0],
        **_turning(rng, motion),
        **_tracking(rng.spawn(1)[0]),
    }
    case["clearance"] += end_rules(rng.spawn(1)[0], case["clearance"][0])
    return case


def _tracking(rng: Rng) -> Case:
    """Sometimes set a tube; from a separate random stream, so that the other cases of a seed stay unchanged."""
    if rng.uniform() > 0.15:
        return {}
    return {"tracking": [log_uniform(rng, 1e-4, 0.1), float(rng.uniform(0.0, 0.2))]}


def _turning(rng: Rng, motion: Motion) -> Case:
    """Return whether the robot turns in place: nearly always if its path does."""
    turns = any(one.in_place for one in motion.segments)
    return {"turns_in_place": bool(rng.uniform() < 0.97)} if turns else {}


def _entry(rng: Rng, motion: Motion) -> Case:
    """Return the gear required by the dock, and its final straight."""
    last = motion.segments[-1]
    gears = [one.gear for one in motion.segments if not one.in_place]
    fitting = "forward" if (gears or [1])[-1] > 0 else "backward"
    word = str(rng.choice([fitting, "auto", "forward"], p=[0.4, 0.55, 0.05]))
    straight = 0.0
    if last.exact and np.all(last.curvature[-2:] == 0.0) and rng.uniform() < 0.5:
        straight = float(last.knots[-1] - last.knots[-2]) * rng.choice([1.0, 0.7, 1.0 + 1e-5])
    return {"direction": word, "final_straight": straight}


def _rule(rng: Rng) -> list[float]:
    required = 0.0 if rng.uniform() < 0.3 else log_uniform(rng, 1e-3, 0.2)
    if rng.uniform() < 0.65:
        return [required, required, 0.0]
    return [required, required * rng.uniform(), log_uniform(rng, 0.05, 1.0) * (rng.uniform() < 0.95)]


def _bounds(rng: Rng, motion: Motion) -> Case:
    """Return curvature limits at, above and (rarely) below the largest values of the path."""
    limits: Case = {}
    if any(one.in_place for one in motion.segments):
        limits = {"max_yaw_rate": 1.0, "max_yaw_acceleration": 1.0}
    with np.errstate(all="ignore"):
        rates = np.where(motion.k1 == motion.k0, 0.0, (motion.k1 - motion.k0) / motion.h)
    driven = motion.gear != 0.0
    seen = {
        "max_curvature": np.abs(np.append(motion.k0, motion.k1))[np.tile(driven, 2)],
        "max_curvature_rate": np.abs(rates),
    }
    for name, values in seen.items():
        top = float(np.max(values, initial=0.0))
        if math.isfinite(top) and top > 0.0 and rng.uniform() < 0.4:
            limits[name] = top * float(
                rng.choice([1.0, 1.0 + 1e-9, 1.5, 1.0 - 3.5e-6, 0.9], p=[0.4, 0.15, 0.25, 0.15, 0.05])
            )
    return limits


class _Swept:
    """Poses along the path, the outline at each, and points at the border of the swept area."""

    def __init__(self, case: Case, motion: Motion) -> None:
        share = np.linspace(0.0, 1.0, _POSES)
        s = share * motion.length
        piece = np.clip(np.searchsorted(motion.s, s, side="right") - 1, 0, motion.s.size - 1)
        local = np.clip((s - motion.s[piece]) / np.maximum(motion.h[piece], 1e-300), 0.0, 1.0)
        poses = motion.poses_at(piece, local)
        if len(motion.h) <= 400:  # turns in place have poses that no arc length addresses
            poses = np.vstack((poses, motion.poses_at(np.arange(motion.h.size), np.full(motion.h.size, 0.5))))
        self.poses: Floats = poses
        shape = case["footprint"]
        if "polygon" in shape:
            self.outline = np.array(shape["polygon"])
        else:
            angle = np.linspace(0.0, 2.0 * math.pi, 65)[:-1]
            self.outline = shape["radius"] * np.column_stack((np.cos(angle), np.sin(angle)))
        c, s_ = np.cos(poses[:, 2, None]), np.sin(poses[:, 2, None])
        x = poses[:, 0, None] + c * self.outline[:, 0] - s_ * self.outline[:, 1]
        y = poses[:, 1, None] + s_ * self.outline[:, 0] + c * self.outline[:, 1]
        self.corners = np.stack((x, y), axis=-1)
        self.bodies: Any = shapely.polygons(self.corners)

    def border_point(self, rng: Rng, gap: float) -> tuple[Floats, Floats] | None:
        """Return a point next to the swept area and the direction away from it."""
        pose = rng.integers(0, len(self.poses), _TRIES)
        edge = rng.integers(0, len(self.outline), _TRIES)
        a, b = self.corners[pose, edge], self.corners[pose, (edge + 1) % len(self.outline)]
        along = np.where(rng.uniform(size=_TRIES) < 0.5, 0.0, rng.uniform(size=_TRIES))
        ring = self.outline
        ccw = float(np.sum(ring[:, 0] * np.roll(ring[:, 1], -1) - np.roll(ring[:, 0], -1) * ring[:, 1])) > 0.0
        way = (b - a) / np.hypot(*(b - a).T)[:, None]
        tilt = np.where(along == 0.0, rng.uniform(-0.3, 1.2, _TRIES), 0.0)  # at a corner: between its two normals
        angle = np.arctan2(way[:, 1], way[:, 0]) + (-0.5 if ccw else 0.5) * math.pi - (tilt if ccw else -tilt)
        normal = np.column_stack((np.cos(angle), np.sin(angle)))
        point = a + along[:, None] * (b - a) + gap * normal
        probe = point + 1e-9 * normal
        free = ~shapely.contains_xy(self.bodies[:, None], probe[None, :, 0], probe[None, :, 1]).any(axis=0)
        found = np.flatnonzero(free)
        return (point[found[0]], normal[found[0]]) if found.size else None


def _beside(rng: Rng, swept: _Swept, required: float) -> list[Points]:
    """Return obstacles around the path; those that block it are mostly removed."""
    count = int(rng.choice([1, 2, 4, 8], p=[0.35, 0.3, 0.25, 0.1]))
    placed: list[Points] = []
    for _ in range(count):
        placed += _one(rng, swept, required + log_uniform(rng, 1e-6, 0.3))
    if not placed or rng.uniform() < 0.06:
        return placed
    distance = shapely.distance(swept.bodies[:, None], np.array([shapely.Polygon(p) for p in placed])[None]).min(axis=0)
    return [one for one, near in zip(placed, distance, strict=True) if near > 0.0]


def beside(rng: Rng, case: Case, motion: Motion, gaps: list[float]) -> list[Points]:
    """Return obstacles at given gaps [m] from the swept area of a motion; a negative gap reaches into it."""
    swept = _Swept(case, motion)
    return [one for gap in gaps for one in _one(rng, swept, gap)]


def _one(rng: Rng, swept: _Swept, gap: float) -> list[Points]:
    style = rng.uniform()
    if style < 0.2:
        return [_wall(rng, swept, gap)]
    at = swept.border_point(rng, gap)
    if at is None:
        return []
    point, normal = at
    if style < 0.32:
        return _touching(rng, point, normal)
    shape = np.array(obstacle(rng))
    nearest = int(np.argmin(shape @ normal))
    return [(shape - shape[nearest] + point).tolist()]


def _wall(rng: Rng, swept: _Swept, gap: float) -> Points:
    """Return a wall along a side of the swept area; sometimes a long one of almost flat reflex corners."""
    heading = rng.uniform(-math.pi, math.pi)
    if rng.uniform() < 0.4:
        heading = float(swept.poses[int(rng.integers(len(swept.poses))), 2]) + 0.5 * math.pi * int(rng.integers(4))
    normal = np.array([math.cos(heading), math.sin(heading)])
    reach = swept.corners.reshape(-1, 2) @ normal
    first = swept.corners.reshape(-1, 2)[int(np.argmax(reach))]
    face = shallow_wall(rng) if rng.uniform() < 0.15 else [[-6.0, 0.0], [6.0, 0.0], [6.0, 1.0], [-6.0, 1.0]]
    at = first + gap * normal
    return turned(face, heading - 0.5 * math.pi, float(at[0]), float(at[1]))


def _touching(rng: Rng, point: Floats, normal: Floats) -> list[Points]:
    """Return two adjacent squares whose seam points at the robot."""
    heading = math.atan2(float(normal[1]), float(normal[0])) - 0.5 * math.pi
    size = rng.uniform(0.1, 0.6)
    halves = (
        [[-size, 0.0], [0.0, 0.0], [0.0, size], [-size, size]],
        [[0.0, 0.0], [size, 0.0], [size, size], [0.0, size]],
    )
    return [turned(half, heading, float(point[0]), float(point[1])) for half in halves]


def _station(rng: Rng, swept: _Swept) -> Points:
    """Return a dock in front of the docked robot."""
    front = float(swept.outline[:, 0].max()) + log_uniform(rng, 1e-6, 0.1)
    return turned(rectangle(0.2, 0.0, rng.uniform(0.2, 1.0)), 0.0, front, 0.0)


def _add_grid(rng: Rng, case: Case, swept: _Swept) -> None:
    """Add a grid around the path, with occupied or unknown cells next to it; rarely a small one far away."""
    side = float(rng.choice([0.05, 0.1, 0.25]))
    low, high = swept.corners.reshape(-1, 2).min(axis=0), swept.corners.reshape(-1, 2).max(axis=0)
    origin = low - log_uniform(rng, 1e-3, 0.6)
    size = np.minimum(np.ceil((high - origin + log_uniform(rng, 1e-3, 0.6)) / side), 160).astype(int)
    dense = log_uniform(rng, 1e-3, 0.06)
    shares = [0.96 - dense, 0.02, 0.02, 0.5 * dense, 0.5 * dense]
    drawn = rng.choice([0, 100, 253, 254, 255], size=(size[1], size[0]), p=shares)
    if rng.uniform() < 0.05:
        origin, size, drawn = low + log_uniform(rng, 10.0, 3e4), np.array([30, 30]), np.zeros((30, 30), dtype=int)
    j, i = np.nonzero(drawn >= 254)
    if i.size and rng.uniform() < 0.93:
        boxes = shapely.box(origin[0] + side * i, origin[1] + side * j,
                            origin[0] + side * (i + 1), origin[1] + side * (j + 1))  # fmt: skip
        hit = np.unique(shapely.STRtree(boxes).query(swept.bodies, predicate="intersects")[1])
        drawn[j[hit], i[hit]] = 0
    case["grid"] = {"cells": drawn.tolist(), "resolution": side, "origin": origin.tolist()}
    case["grid_alone"] = bool(rng.uniform() < 0.25)


def wanted_margin(rng: Rng) -> float:
    """Return a margin near the limit: accepted by a tolerance five times too large, a missing centimetre, or none."""
    style = rng.uniform()
    if style < 0.3:
        return -float(rng.uniform(2.2e-6, 4.9e-6))
    if style < 0.65:
        return -log_uniform(rng, 3e-6, 1e-2)
    if style < 0.8:
        return log_uniform(rng, 1e-7, 1e-3)
    return log_uniform(rng, 1.1e-3, 5e-2)


def _aim(rng: Rng, case: Case, motion: Motion) -> None:
    """Move the requirement, the nearest obstacle or the grid until the margin has a chosen value."""
    world = World.of(case)
    if world.is_empty or rng.uniform() < 0.12:
        return
    wanted = wanted_margin(rng)
    relief = start_run(case) if rng.uniform() < 0.3 else 0.0
    found = sweep(case, motion, world, relief=relief)
    clearance = float(found.clearance.min())
    if clearance > wanted + 1e-4 and rng.uniform() < 0.6:
        _require(case, found, wanted)
    else:
        _shift(case, found, world, wanted)


def _require(case: Case, found: Sweep, wanted: float) -> None:
    required = max(0.0, float(found.clearance.min()) - wanted - tube(case))
    case["clearance"] = [required, required, 0.0]


def _shift(case: Case, found: Sweep, world: World, wanted: float) -> None:
    """Move the nearest obstacle of the worst pose, or the grid, by the missing margin."""
    k = found.worst
    if world.solid is None or found.clearance[k] > 1.0:
        return
    body = world.bodies(found.poses[k : k + 1])[0]
    near = [shapely.Polygon(one).distance(body) for one in case["obstacles"]]
    line = shapely.get_coordinates(shapely.shortest_line(body, world.solid))
    way = line[1] - line[0]
    length = float(np.hypot(*way))
    if length < 1e-7:
        return
    move = (wanted - float(found.margin[k])) * way / length
    if near and min(near) <= length + 1e-9:
        nearest = shapely.Polygon(case["obstacles"][int(np.argmin(near))])
        for i, one in enumerate(case["obstacles"]):
            if shapely.Polygon(one).distance(nearest) <= 1e-9:  # obstacles that touch it move with it
                case["obstacles"][i] = (np.array(one) + move).tolist()
    elif case["grid"] is not None:
        case["grid"]["origin"] = (np.array(case["grid"]["origin"]) + move).tolist()


def _spoil(rng: Rng, case: Case) -> None:
    """Rarely change start or goal by an error within or beyond the tolerance."""
    if rng.uniform() < 0.06:
        error = log_uniform(rng, 1e-7, 1e-2)
        target = case["start"] if rng.uniform() < 0.5 else case["dock"]["pose"]
        target[int(rng.integers(3))] += error
    if rng.uniform() < 0.02:
        case["start_speed"] = float(rng.uniform(-0.3, 0.3))
