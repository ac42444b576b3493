"""Scenes carved around a motion: everything off its swept area is obstacle, so an impossibility proof is wrong."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
import shapely

from experiments.fuzz.generators.shapes import end_rules, footprint, log_uniform
from experiments.fuzz.oracle.sweep import clearance_rule, required_at
from experiments.fuzz.oracle.world import placed
from optdock.geometry.polygon import convex_cover

if TYPE_CHECKING:
    import numpy.typing as npt

    from experiments.fuzz.case import Case

__all__ = ["carved_scene", "required_between"]

Rng: TypeAlias = np.random.Generator
Floats: TypeAlias = "np.ndarray[tuple[int, ...], np.dtype[np.float64]]"
Shapes: TypeAlias = "np.ndarray[tuple[int, ...], np.dtype[np.object_]]"

# Shares of a step at which the rule is evaluated; the outer ones are as good as its ends.
_SHARES = np.concatenate(([0.0, 1e-6], np.linspace(0.0, 1.0, 65)[1:-1], [1.0 - 1e-6, 1.0]))
_TURN = 0.02  # [rad] per step: the hull of both outlines misses the arc between by 0.00005 of the robot's reach


def carved_scene(rng: Rng) -> Case:
    """Return a random motion, with reversing, turns in place and slips, among obstacles that it just clears.

    The witness is verified here: the hulls of the outlines at neighbouring poses keep the required clearance from all
    obstacles, by shapely's distances. Scenes that fail, by rounding of the carving, are drawn again.
    """
    while True:
        scene = _drawn(rng)
        if scene is not None:
            return scene


def _drawn(rng: Rng) -> Case | None:
    outline = footprint(rng).get("polygon") or _box(rng)
    body = shapely.Polygon(outline)
    if not body.is_valid or body.area < 1e-3:
        return None
    poses = _motion(rng, outline)
    rule = _rule(rng)
    margin = 0.0 if (exact := rng.uniform() < 0.15) else log_uniform(rng, 1e-4, 0.1)
    at_start = float(rng.choice([0.0, 0.01, rule[0] or 0.0]))
    pieces = [shapely.Polygon(piece) for piece in convex_cover(body)]
    hulls = _hulls(pieces, poses)
    needed = required_between(rule, poses, at_start, outline)
    wide = hulls.copy()
    kept = np.flatnonzero(needed + margin > 0.0)
    wide[kept] = shapely.buffer(hulls[kept], (needed[kept] + margin) / math.cos(math.pi / 64.0), quad_segs=16)
    room = shapely.union_all(wide)
    slack = 0.0 if exact else 0.3 * margin
    room = room.buffer(slack).simplify(slack) if slack else room
    polygons = _obstacles(rng, room)
    if not polygons:
        return None
    obstacles = shapely.union_all([shapely.Polygon(polygon) for polygon in polygons])
    clearance = min(float(obstacles.distance(_at(body, poses[0]))), 10.0)
    true = required_between(rule, poses, clearance, outline)
    if np.any(shapely.distance(obstacles, hulls) < true):
        return None
    return {
        "kind": "impossibilities",
        "footprint": {"polygon": [list(map(float, point)) for point in outline]},
        "obstacles": polygons,
        "fenced": _fenced(rng.spawn(1)[0], polygons, poses[-1], outline, float(rule[0] or 0.0)),
        "seed": int(rng.integers(2**31)),
        "start": poses[0].tolist(),
        "goal": poses[-1].tolist(),
        "clearance": rule,
        "budget": float(rng.choice([0.05, 0.1, 0.1, 0.3])),
        "moved": [0.0, 0.0] if rng.uniform() < 0.8 else rng.uniform(-1e5, 1e5, 2).tolist(),
    }


def _box(rng: Rng) -> list[list[float]]:
    front, rear, half = rng.uniform(0.1, 4.0), rng.uniform(0.05, 1.0), rng.uniform(0.1, 0.9)
    return [[front, half], [-rear, half], [-rear, -half], [front, -half]]


def _rule(rng: Rng) -> list[float | None]:
    """Return required, at the dock, taper; sometimes the run at the dock, and the clearance sufficient at the start."""
    required = float(rng.choice([0.0, 1e-6, 1e-5, 0.02, 0.05, 0.2]))
    rule = [required, float(rng.choice([0.0, required])), float(rng.choice([0.0, 0.3, 1.0]))]
    return [*rule, *end_rules(rng.spawn(1)[0], required)]


def _motion(rng: Rng, outline: list[list[float]]) -> Floats:
    """Return poses of several moves with a constant body velocity each, Shape (n, 3)."""
    reach = float(np.hypot(*np.array(outline).T).max())
    poses = [np.array([0.0, 0.0, rng.uniform(-4.0, 4.0)])]
    for _ in range(int(rng.integers(1, 6))):
        kind = rng.choice(["straight", "arc", "turn", "slip"])
        length = rng.uniform(0.2, 3.0) * reach * rng.choice([-1.0, 1.0]) if kind != "turn" else 0.0
        angle = rng.uniform(-2.0, 2.0) if kind in ("arc", "turn") else 0.0
        heading = rng.uniform(-math.pi, math.pi) if kind == "slip" else 0.0
        count = max(1, math.ceil(abs(angle) / _TURN), math.ceil(abs(length) / (0.3 * reach)) if angle == 0.0 else 1)
        for _ in range(count):
            x, y, yaw = poses[-1]
            way = yaw + heading + 0.5 * angle / count
            step = length / count
            poses.append(np.array([x + step * math.cos(way), y + step * math.sin(way), yaw + angle / count]))
    return np.array(poses)


def _at(shape: shapely.Geometry, pose: Floats) -> shapely.Geometry:
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return shapely.transform(shape, lambda points: points @ np.array([[c, s], [-s, c]]) + pose[:2])


def _hulls(pieces: list[shapely.Geometry], poses: Floats) -> Shapes:
    """Return the swept areas between neighbouring poses: hulls of the body's pieces, grown by the sagitta of turns."""
    parts = []
    for piece in pieces:
        corners = placed(shapely.get_coordinates(piece)[:-1], poses)
        parts.append(shapely.convex_hull(shapely.linestrings(np.concatenate((corners[:-1], corners[1:]), axis=1))))
    hulls = parts[0] if len(parts) == 1 else shapely.union_all(np.array(parts), axis=0)
    reach = max(float(np.hypot(*shapely.get_coordinates(piece).T).max()) for piece in pieces)
    sagitta = reach * np.diff(poses[:, 2]) ** 2 / 8.0
    turned = np.flatnonzero(sagitta)
    hulls[turned] = shapely.buffer(hulls[turned], 1.01 * sagitta[turned], quad_segs=4)
    return hulls


def required_between(
    rule: list[float | None], poses: Floats, start_clearance: float, outline: list[list[float]]
) -> Floats:
    """Return the largest requirement within each step, with the weaker relief, because the stronger one requires more.

    Within a step the requirement may exceed that of its ends: if it falls towards the goal and grows from the start,
    and just before a goal with a jump.
    """
    ends = {"dock": {"pose": poses[-1].tolist()}, "start": poses[0].tolist()}
    case: Case = {"clearance": rule, "footprint": {"polygon": outline}, **ends}
    run = 4.0 * float(np.hypot(*np.array(outline).T).max())
    steps = np.diff(poses, axis=0)
    along = poses[:-1, None] + _SHARES[:, None] * steps[:, None]
    needed = required_at(case, along.reshape(-1, 3), start_clearance, run).reshape(along.shape[:2]).max(axis=1)
    required, at_dock, taper, _, at_start = clearance_rule(case)
    steepest = max([0.5, *((required - least) / taper for least in (at_dock, at_start or 0.0) if taper > 0.0)])
    found: Floats = needed + steepest * np.hypot(*steps[:, :2].T) * np.diff(_SHARES).max()
    return found


def _obstacles(rng: Rng, room: shapely.Geometry) -> list[list[list[float]]]:
    """Return convex obstacles outside of the room: its complement, cells of a grid, or random shapes."""
    x0, y0, x1, y1 = room.bounds
    more = log_uniform(rng, 0.05, 3.0)
    world = shapely.box(x0 - more, y0 - more, x1 + more, y1 + more)
    kind = rng.choice(["all", "cells", "strewn"])
    if kind == "all":
        shapes = [world.difference(room)]
    elif kind == "cells":
        side = max(rng.uniform(0.03, 0.3), (x1 - x0 + y1 - y0) / 80.0)
        at_x, at_y = np.meshgrid(np.arange(x0 - more, x1 + more, side), np.arange(y0 - more, y1 + more, side))
        shapely.prepare(room)
        return _runs(
            at_x[0], at_y[:, 0], side, ~shapely.intersects(room, shapely.box(at_x, at_y, at_x + side, at_y + side))
        )
    else:
        points = rng.uniform((x0 - more, y0 - more), (x1 + more, y1 + more), (12, 2))
        sizes = [log_uniform(rng, 1e-3, 1.0) for _ in points]
        blobs = [
            shapely.convex_hull(shapely.MultiPoint(point + size * rng.normal(size=(5, 2))))
            for point, size in zip(points, sizes, strict=True)
        ]
        shapes = [blob.difference(room) for blob in blobs]
    parts = [part for shape in shapes for part in shapely.get_parts(shape) if part.geom_type == "Polygon"]
    return [piece.tolist() for part in parts if part.area > 1e-8 for piece in convex_cover(part)]


def _fenced(
    rng: Rng, polygons: list[list[list[float]]], goal: Floats, outline: list[list[float]], required: float
) -> Case:
    """Return a start and obstacles: a ring around the goal with a gap too narrow for most robots, the start outside."""
    reach = float(np.hypot(*np.array(outline).T).max())
    radius = 1.2 * reach + required + rng.uniform(0.01, 1.0)
    heading, away = rng.uniform(-math.pi, math.pi), 1.1 * radius + 1.2 * reach + required + rng.uniform(0.0, 1.0)
    start = [*(goal[:2] + away * np.array([math.cos(heading), math.sin(heading)])).tolist(), rng.uniform(-4.0, 4.0)]
    near = (
        shapely.distance([shapely.Polygon(one) for one in polygons], shapely.Point(start[:2])) < 1.1 * reach + required
    )
    kept = [one for one, is_near in zip(polygons, near, strict=True) if not is_near]
    return {"start": start, "obstacles": kept + _ring(rng, goal, radius, outline, required)}


def _ring(
    rng: Rng, goal: Floats, radius: float, outline: list[list[float]], required: float
) -> list[list[list[float]]]:
    width = 2.0 * float(shapely.length(shapely.maximum_inscribed_circle(shapely.Polygon(outline))))
    gap = width * rng.choice([0.0, rng.uniform(0.0, 0.9), rng.uniform(0.9, 1.0)]) + 2.0 * required
    half = math.asin(min(0.5 * gap / radius, 0.9))
    angles = rng.uniform(-math.pi, math.pi) + np.linspace(half, 2.0 * math.pi - half, 25)
    ways = np.column_stack((np.cos(angles), np.sin(angles)))
    inner, outer = goal[:2] + radius * ways, goal[:2] + 1.1 * radius * ways
    found: list[list[list[float]]] = np.stack((inner[:-1], outer[:-1], outer[1:], inner[1:]), axis=1).tolist()
    return found


def _runs(x: Floats, y: Floats, side: float, occupied: npt.NDArray[np.bool_]) -> list[list[list[float]]]:
    """Return neighbouring occupied cells of each row as rectangles."""
    edges = np.diff(np.pad(occupied.astype(np.int8), ((0, 0), (1, 1))), axis=1)
    (row, first), (_, stop) = np.nonzero(edges > 0), np.nonzero(edges < 0)
    low, high = np.column_stack((x[first], y[row])), np.column_stack((x[stop - 1] + side, y[row] + side))
    corners = [(low, low), (high, low), (high, high), (low, high)]
    found: list[list[list[float]]] = np.stack(
        [np.column_stack((a[:, 0], b[:, 1])) for a, b in corners], axis=1
    ).tolist()
    return found
