"""Random paths: clothoid splines in both gears, and polylines of varying quality."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from experiments.fuzz.generators.shapes import log_uniform
from experiments.fuzz.oracle.motion import motion_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from experiments.fuzz.case import Case

__all__ = ["clothoid_route", "route", "with_turns"]

Rng: TypeAlias = np.random.Generator
_TURNS = 0.3  # share of paths that turn in place


def route(rng: Rng) -> list[Case]:
    """Return the gears of a path: clothoids, or polylines made from them."""
    gears = clothoid_route(rng)
    if rng.uniform() >= 0.65:
        gears = _polylines(rng, gears)
    return with_turns(rng, gears) if rng.uniform() < _TURNS else gears


def with_turns(rng: Rng, gears: list[Case]) -> list[Case]:
    """Insert turns in place before, between and after the gears; later gears are rotated accordingly."""
    made: list[Case] = []
    for gear in gears:
        if rng.uniform() < 0.5:
            _turn_at(rng, made, motion_of([gear]).start if not made else motion_of(made[-1:]).end)
        made.append(_moved(gear, motion_of(made[-1:]).end) if made else gear)
    while rng.uniform() < 0.4 or all(one["type"] != "turn" for one in made):
        _turn_at(rng, made, motion_of(made[-1:]).end)
    return made


def _turn_at(rng: Rng, made: list[Case], pose: np.ndarray) -> None:
    style = rng.uniform()
    size = log_uniform(rng, 1e-9, 0.1) if style < 0.15 else rng.uniform(0.05, 3.3)
    size = log_uniform(rng, 3.0, 60.0) if style > 0.95 else size
    turn = float(rng.choice([-1, 1]) * size)
    made.append({"type": "turn", "start": [float(value) for value in pose], "turn": turn, "gear": 0})


def _moved(gear: Case, to: np.ndarray) -> Case:
    """Return a gear moved to begin at a pose."""
    x, y, yaw = motion_of([gear]).start
    c, s = math.cos(to[2] - yaw), math.sin(to[2] - yaw)
    if gear["type"] == "clothoid":
        return {**gear, "start": [float(value) for value in to]}
    poses = np.array(gear["poses"])
    dx, dy = poses[:, 0] - x, poses[:, 1] - y
    moved = np.column_stack((to[0] + c * dx - s * dy, to[1] + s * dx + c * dy, poses[:, 2] + to[2] - yaw))
    return {**gear, "poses": moved.tolist()}


def clothoid_route(rng: Rng) -> list[Case]:
    """Return one to four gears; neighbours mostly differ in direction."""
    count = int(rng.choice([1, 2, 3, 4], p=[0.6, 0.25, 0.1, 0.05]))
    far = 0.0 if rng.uniform() < 0.85 else log_uniform(rng, 10.0, 1e5)
    yaw = rng.uniform(-math.pi, math.pi) if rng.uniform() < 0.97 else log_uniform(rng, 1e2, 1e7)
    at = [float(rng.uniform(-3, 3)) + far, float(rng.uniform(-3, 3)), float(yaw)]
    gear, gears = int(rng.choice([1, -1])), []
    steep = log_uniform(rng, 0.05, 4.0)
    for _ in range(count):
        knots, curvature = _profile(rng, steep)
        gears.append({"type": "clothoid", "start": at, "knots": knots, "curvature": curvature, "gear": gear})
        if len(gears) < count:
            at = motion_of(gears[-1:]).end.tolist()
        gear = -gear if rng.uniform() < 0.95 else gear
    if rng.uniform() < 0.04:
        _disjoint(rng, gears)
    return gears


def _profile(rng: Rng, steep: float) -> tuple[list[float], list[float]]:
    """Return knots and curvatures of a gear."""
    n = int(rng.choice([2, 3, 4, 6, 10, 20]))
    pieces = 10.0 ** rng.uniform(-1.6, -0.2, n - 1) if n > 2 else np.array([rng.uniform(0.1, 2.5)])
    style = rng.uniform()
    if style < 0.2:
        curvature = np.zeros(n)
    elif style < 0.35:
        curvature = np.full(n, rng.uniform(-steep, steep))
    else:
        curvature = np.clip(np.cumsum(rng.normal(0.0, 0.5 * steep, n)), -steep, steep)
    if rng.uniform() < 0.3:
        curvature[-min(n, 2) :] = 0.0
    knots = np.concatenate(([0.0], np.cumsum(pieces)))
    if rng.uniform() < 0.08:
        knots, curvature = _spiked(rng, knots, curvature)
    return knots.tolist(), curvature.tolist()


def _spiked(rng: Rng, knots: np.ndarray, curvature: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a curvature that jumps, or turns the robot, within 1e-14 to 1e-3 m."""
    where = int(rng.integers(0, knots.size - 1))
    a, width = 0.5 * (knots[where] + knots[where + 1]), log_uniform(rng, 1e-14, 1e-3)
    inner = np.array([a, a + width, a + 2.0 * width])
    if not (np.all(np.diff(inner) > 0.0) and inner[-1] < knots[where + 1]):
        return knots, curvature
    high = rng.uniform(-0.6, 0.6) / width if rng.uniform() < 0.5 else rng.uniform(-3.0, 3.0)
    k = np.interp(inner, knots, curvature) + np.array([0.0, high, 0.0])
    return np.insert(knots, where + 1, inner), np.insert(curvature, where + 1, k)


def _disjoint(rng: Rng, gears: list[Case]) -> None:
    """Return gears with small gaps between them, which accumulate."""
    if rng.uniform() < 0.5 and len(gears) > 1:
        gears[-1]["start"] = [value + log_uniform(rng, 1e-7, 1e-3) for value in gears[-1]["start"]]
        return
    side, (x, y, yaw) = rng.uniform(0.5e-6, 0.95e-6), gears[0]["start"]
    count = int(rng.integers(20, 80))
    c, s = math.cos(yaw), math.sin(yaw)
    gears[:] = [
        {"type": "clothoid", "start": [x + 5e-3 * i * c - side * i * s, y + 5e-3 * i * s + side * i * c, yaw],
         "knots": [0.0, 5e-3], "curvature": [0.0, 0.0], "gear": 1}
        for i in range(count)
    ]  # fmt: skip


def _polylines(rng: Rng, gears: list[Case]) -> list[Case]:
    spacing = log_uniform(rng, 0.004, 0.15)
    made = [_sampled(gear, spacing) for gear in gears]
    change = _CHANGES[int(rng.integers(len(_CHANGES)))]
    for gear in made:
        poses = change(rng, np.array(gear["poses"]))
        gear["poses"] = poses.tolist()
    return _rejoined(made)


def _sampled(gear: Case, spacing: float) -> Case:
    motion = motion_of([gear])
    count = max(2, math.ceil(motion.length / spacing) + 1)
    s = np.linspace(0.0, motion.length, min(count, 600))
    piece = np.clip(np.searchsorted(motion.s, s, side="right") - 1, 0, motion.s.size - 1)
    share = np.clip((s - motion.s[piece]) / motion.h[piece], 0.0, 1.0)
    return {"type": "polyline", "poses": motion.poses_at(piece, share).tolist(), "gear": gear["gear"]}


def _rejoined(gears: list[Case]) -> list[Case]:
    """Return gears moved so that each begins at the end of the previous one."""
    for before, after in itertools.pairwise(gears):
        shift = np.array(before["poses"][-1]) - np.array(after["poses"][0])
        after["poses"] = (np.array(after["poses"]) + shift).tolist()
    return gears


def _as_sampled(_: Rng, poses: np.ndarray) -> np.ndarray:
    return poses


def _rounded(rng: Rng, poses: np.ndarray) -> np.ndarray:
    rounded: np.ndarray = np.round(poses, int(rng.choice([3, 4, 5, 6])))
    return rounded


def _turning_in_place(rng: Rng, poses: np.ndarray) -> np.ndarray:
    at = int(rng.integers(0, len(poses)))
    spin = np.linspace(0.0, rng.uniform(-2.0, 2.0), int(rng.integers(2, 12)))[1:]
    inserted = np.column_stack((np.tile(poses[at, :2], (spin.size, 1)), poses[at, 2] + spin))
    return np.vstack((poses[: at + 1], inserted, poses[at + 1 :]))


def _thinned(rng: Rng, poses: np.ndarray) -> np.ndarray:
    """Remove poses, which leaves some long steps."""
    keep = rng.uniform(size=len(poses)) < rng.uniform(0.1, 0.9)
    keep[[0, -1]] = True
    return poses[keep]


def _crabbing(rng: Rng, poses: np.ndarray) -> np.ndarray:
    """Shift every step slightly sideways: each within the tolerance."""
    way = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))))
    side = way * rng.uniform(1e-4, 0.0099)
    yaw = poses[0, 2]
    return poses + np.column_stack((-math.sin(yaw) * side, math.cos(yaw) * side, np.zeros(side.size)))


def _zigzag(rng: Rng, poses: np.ndarray) -> np.ndarray:
    """Shift every other pose slightly to the side."""
    side = np.where(np.arange(len(poses)) % 2, log_uniform(rng, 1e-7, 1e-3), 0.0)
    return poses + np.column_stack((-np.sin(poses[:, 2]) * side, np.cos(poses[:, 2]) * side, np.zeros(side.size)))


def _creeping(rng: Rng, poses: np.ndarray) -> np.ndarray:
    """Return a sideways motion in steps too short to have a direction."""
    at, count = int(rng.integers(0, len(poses))), int(rng.integers(10, 400))
    side = 0.95e-9 * np.arange(1, count + 1)
    normal = [-math.sin(poses[at, 2]), math.cos(poses[at, 2])]
    crept = np.column_stack((poses[at, :2] + side[:, None] * normal, np.full(count, poses[at, 2])))
    rest = poses[at + 1 :] + np.array([*(np.array(normal) * side[-1]), 0.0])
    return np.vstack((poses[: at + 1], crept, rest))


def _noisy(rng: Rng, poses: np.ndarray) -> np.ndarray:
    noise = rng.normal(0.0, log_uniform(rng, 1e-9, 1e-2), poses.shape)
    return poses + noise


_CHANGES: tuple[Callable[[Rng, np.ndarray], np.ndarray], ...] = (
    _as_sampled, _as_sampled, _as_sampled, _as_sampled, _rounded, _turning_in_place, _thinned, _crabbing, _zigzag,
    _creeping, _noisy,
)  # fmt: skip
