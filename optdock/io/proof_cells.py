"""Proofs in plan files: the statement of the problem, and cells of the path with separating directions.

`optdock.verification.judge`, which imports nothing of this library, checks them. Nothing here is trusted: wrong cells
make the judge refuse the file.
"""

from __future__ import annotations

import dataclasses
import itertools
import logging
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import FARTHEST, transform_points
from optdock.geometry.separation import separation
from optdock.model.limits import finite_limits
from optdock.verification import TOLERANCE
from optdock.verification.motion_bounds import Cells, PathMotion
from optdock.verification.proximity import end_clearances

if TYPE_CHECKING:
    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray
    from optdock.geometry.separation import ConvexBody
    from optdock.model.path import Path
    from optdock.model.problem import DockingProblem

__all__ = ["proof_of", "statement_of"]

logger = logging.getLogger(__name__)

_MAX_STEP = 0.08  # [m], length of first cells
_MAX_LEVELS = 24  # of bisection
_MOST_OPEN = 5_000  # cells that are not proven; more of them would make a file of many megabytes
_DIGITS = 9  # of directions [rad]
_SPARE = 0.02 * TOLERANCE  # [m]: for the rounding of directions and the intervals of the judge
_APART = 1e-9  # [m]: pieces of a footprint that is not convex must not touch anything
_BEYOND = 1e-6  # [m]: by which boxes are wider than needed


def proof_of(path: Path, problem: DockingProblem, start_relief: float) -> dict[str, object] | None:
    """Return the proof of a certified path as plain JSON values.

    Args:
        path: The path.
        problem: The problem for which it is certified.
        start_relief: `Certificate.start_relief`.

    Returns:
        None if the cells do not prove the clearance, e.g. because a footprint that is not convex touches the station.
    """
    statement, obstacles, region = _stated(path, problem, start_relief)
    cells = _Search(path, problem, start_relief, obstacles, region).cells()
    if cells is None:
        logger.warning("the clearance of the path is certified, but not provable in cells: written without a proof")
        return None
    return {**statement, "cells": cells}


def statement_of(path: Path, problem: DockingProblem, start_relief: float) -> dict[str, object]:
    """Return all keys of the result of `proof_of` but `cells`."""
    return _stated(path, problem, start_relief)[0]


def _stated(
    path: Path, problem: DockingProblem, start_relief: float
) -> tuple[dict[str, object], ObstacleSet, FloatArray]:
    """Return the statement, and its obstacles and region as arrays."""
    robot, dock, rule = problem.robot, problem.dock, problem.clearance
    limits = robot.limits
    # The steering angle is included in the largest curvature.
    bounds = {name: value for name, value in finite_limits(limits).items() if name != "max_steering_angle"}
    sizes = {name: getattr(limits, name) for name in ("track_width", "wheelbase")}
    pieces = {"pieces": [body.vertices.tolist() for body in robot.footprint.bodies]}
    speed, seen = dock.approach.speed, {"visible_distance": dock.visible_distance}
    near, region = _near(path, problem)
    statement: dict[str, object] = {
        "robot": {
            "footprint": robot.footprint.vertices.tolist(),
            **(pieces if len(robot.footprint.bodies) > 1 else {}),
            "turning": list(limits.turning) if robot.turns_in_place else None,
            "tracking": [robot.tracking.cross, robot.tracking.yaw],
            "limits": {**bounds, **sizes},
        },
        "start": {
            "pose": problem.start.as_array().tolist(),
            "speed": problem.start_speed,
            "acceleration": problem.start_acceleration,
            "curvature": problem.start_curvature,
        },
        "dock": {
            "pose": dock.pose.as_array().tolist(),
            "direction": dock.direction.value,
            "final_straight": dock.final_straight,
            **({"approach_speed": speed} if np.isfinite(speed) else {}),
            "approach_distance": dock.approach.distance,
            **(seen if dock.visible_distance > 0.0 else {}),
        },
        "clearance": {**dataclasses.asdict(rule), "start_relief": start_relief},
        "region": region.ravel().tolist(),
        "obstacles": [_distinct(piece).tolist() for piece in near.vertices],
    }
    return statement, near, region


def _distinct(piece: FloatArray) -> FloatArray:
    """Return a piece without the vertices that were repeated by padding."""
    kept: FloatArray = piece[np.append(True, np.any(np.diff(piece, axis=0) != 0.0, axis=1))]
    return kept


def _near(path: Path, problem: DockingProblem) -> tuple[ObstacleSet, FloatArray]:
    """Return all obstacles that meet a box around the swept area, and the corners of the box, Shape (2, 2) [m]."""
    motion = PathMotion(path)
    ends = motion.cells(_MAX_STEP).ends()
    places = motion.nodes(ends.segment, ends.u).poses[:, :2]
    reach = problem.robot.footprint.circumscribed_radius + problem.path_clearance.required + _MAX_STEP
    region = np.stack((places.min(axis=0) - reach, places.max(axis=0) + reach))
    everything = problem.all_obstacles
    near = everything.subset(everything.rows_in_box(*region))
    # The half-planes beyond a map are rectangles that end far away, where floats are coarse.
    far = np.any(np.abs(near.vertices) > FARTHEST, axis=(1, 2))
    if not far.any():
        return near, region
    vertices = np.where(far[:, None, None], np.clip(near.vertices, region[0] - 1.0, region[1] + 1.0), near.vertices)
    return ObstacleSet(vertices, near.names, near.group), region


class _Pairs(NamedTuple):
    """Pairs of a cell and an obstacle that need a separating direction: indices, angle [rad]. Shape (n,).

    `gap`: lower bound of the distance along the direction in the cell [m]. `distance`: distance in the middle of the
    cell [m]. `outside`: mask of the cells in which the robot may leave the region.
    """

    cell: IntArray
    obstacle: IntArray
    angle: FloatArray
    gap: FloatArray
    distance: FloatArray
    outside: BoolArray


class _Search:
    """Bisection of cells until a direction per nearby obstacle proves the clearance, as in the judge."""

    def __init__(
        self, path: Path, problem: DockingProblem, start_relief: float, obstacles: ObstacleSet, region: FloatArray
    ) -> None:
        self.motion, self.problem, self.obstacles, self.relief = PathMotion(path), problem, obstacles, start_relief
        self.region = region
        self.bodies = problem.robot.footprint.bodies
        self.at_start = end_clearances(problem).start

    def cells(self) -> list[dict[str, object]] | None:
        """Return the borders and planes of every segment, or None."""
        cells = self.motion.cells(_MAX_STEP)
        found: list[tuple[int, float, float, list[list[float]]]] = []
        for _ in range(_MAX_LEVELS):
            proven, planes, is_hopeless = self._round(cells)
            if is_hopeless or np.count_nonzero(~proven) > _MOST_OPEN:
                return None
            done = np.flatnonzero(proven)
            found += zip(*(column[done].tolist() for column in cells), (planes[k] for k in done), strict=True)
            if done.size == proven.size:
                found.sort(key=lambda cell: cell[:2])
                groups = itertools.groupby(found, key=lambda cell: cell[0])
                return [_segment_cells([*group]) for _, group in groups]
            cells = cells.rows(np.flatnonzero(~proven)).cut(2)
        return None

    def _round(self, cells: Cells) -> tuple[BoolArray, list[list[list[float]]], bool]:
        """Return a mask of the proven cells, their planes (obstacle, piece, angle), and whether no cells can be proven.

        No direction gives more than the distance (C3). If the distance in the middle of a cell is less than required
        there, no smaller cell that contains this pose is proven.
        """
        middle = 0.5 * (cells.first + cells.last)
        n = middle.size
        nodes = self.motion.nodes(np.tile(cells.segment, 3), np.concatenate((cells.first, middle, cells.last)))
        first, at, last = nodes.poses[:n], nodes.poses[n : 2 * n], nodes.poses[2 * n :]
        before = self.motion.bounds(Cells(cells.segment, cells.first, middle), first, at)
        after = self.motion.bounds(Cells(cells.segment, middle, cells.last), at, last)
        half, velocity = np.maximum(before.width, after.width), before.velocity_last
        bend, twist = np.maximum(before.bend, after.bend), np.maximum(before.twist, after.twist)
        least = -np.inf if len(self.bodies) == 1 else _APART
        need = np.maximum(self._required(first, last, 0.5 * bend * half**2) - TOLERANCE, least)
        need_there = np.maximum(self._required(at, at, np.zeros(n)) - TOLERANCE, least)
        proven: BoolArray = np.ones(n, dtype=np.bool_)
        is_hopeless = False
        planes: list[list[list[float]]] = [[] for _ in range(n)]
        for number, body in enumerate(self.bodies):
            stray = 0.5 * (bend[:, None] + np.hypot(*body.vertices.T) * twist[:, None]) * half[:, None] ** 2
            pairs = self._pairs(body, at, velocity, half, stray, np.maximum(need, 0.0) + _BEYOND)
            proven[pairs.outside] = False
            proven[pairs.cell[~(pairs.gap >= need[pairs.cell] + _SPARE)]] = False
            is_hopeless |= bool(np.any(pairs.distance < need_there[pairs.cell] + _SPARE))
            for cell, *plane in zip(pairs.cell.tolist(), pairs.obstacle.tolist(), pairs.angle.tolist(), strict=True):
                planes[cell].append([plane[0], number, plane[1]])
        return proven, planes, is_hopeless

    def _required(self, first: FloatArray, last: FloatArray, sag: FloatArray) -> FloatArray:
        """Return the largest required clearance in every cell [m], Shape (n,)."""
        far = [
            np.maximum(*(np.hypot(*(ends[:, :2] - [place.x, place.y]).T) for ends in (first, last))) + sag
            for place in (self.problem.goal, self.problem.start)
        ]
        return self.problem.path_clearance.required_at(far[0], far[1], self.at_start, self.relief)

    def _pairs(
        self,
        body: ConvexBody,
        at: FloatArray,
        velocity: FloatArray,
        half: FloatArray,
        stray: FloatArray,
        reach: FloatArray,
    ) -> _Pairs:
        """Return the pairs of cells and obstacles whose boxes are within `reach`."""
        corners = transform_points(at, body.vertices)
        arm = corners - at[:, None, :2]
        moves = velocity[:, None, :2] + velocity[:, None, 2:] * np.stack((-arm[..., 1], arm[..., 0]), axis=-1)
        spread = np.abs(moves) * half[:, None, None] + stray[..., None]
        low, high = (corners - spread).min(axis=1), (corners + spread).max(axis=1)
        low, high = low - reach[:, None], high + reach[:, None]
        outside: BoolArray = np.any((low < self.region[0]) | (high > self.region[1]), axis=1)
        rocks = self.obstacles
        meets = np.all((rocks.lower <= high[:, None]) & (rocks.upper >= low[:, None]), axis=2)
        cell, rock = np.nonzero(meets)
        if cell.size == 0:
            nothing = np.zeros(0)
            return _Pairs(cell, rock, nothing, nothing, nothing, outside)
        distance, axis = separation(body, at[cell], rocks.pieces(rock))
        angle = np.asarray(np.round(np.arctan2(axis[:, 1], axis[:, 0]), _DIGITS), dtype=np.float64)
        n = np.column_stack((np.cos(angle), np.sin(angle)))[:, None]
        height, rate = (np.sum(n * column[cell], axis=2) for column in (corners, moves))
        near = (height - np.abs(rate) * half[cell, None] - stray[cell]).min(axis=1)
        far = np.sum(n * rocks.vertices[rock], axis=2).max(axis=1)
        return _Pairs(cell, rock, angle, near - far, distance, outside)


def _segment_cells(cells: list[tuple[int, float, float, list[list[float]]]]) -> dict[str, object]:
    return {"borders": [cells[0][1], *(cell[2] for cell in cells)], "planes": [cell[3] for cell in cells]}
