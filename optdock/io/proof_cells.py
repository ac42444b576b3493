"""Proofs in plan files: the statement of the problem, and cells of the path with separating directions.

`optdock.verification.judge`, which imports nothing of this library, checks them. Nothing here is trusted: wrong cells
make the judge refuse the file.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import logging
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.footprint import convex_body
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.polygon import convex_cover
from optdock.geometry.pose import FARTHEST, transform_points
from optdock.geometry.separation import separation
from optdock.model.limits import finite_limits
from optdock.verification import TOLERANCE
from optdock.verification.clearance_kernel import end_clearances
from optdock.verification.motion_bounds import Cells, PathMotion

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


class _Middles(NamedTuple):
    """Motion in the middles of cells: poses, velocities, Shape (n, 3); half width, bounds (C4), Shape (n,)."""

    poses: FloatArray
    velocity: FloatArray
    half: FloatArray
    bend: FloatArray
    twist: FloatArray

    def rows(self, keep: IntArray) -> _Middles:
        """Return the cells selected by `keep`."""
        return _Middles(*(column[keep] for column in self))

    def corners(self, body: ConvexBody) -> _Corners:
        """Return the corners of a body."""
        places = transform_points(self.poses, body.vertices)
        arm, move = places - self.poses[:, None, :2], self.velocity[:, None]
        moves = move[..., :2] + move[..., 2:] * np.stack((-arm[..., 1], arm[..., 0]), axis=-1)
        stray = self.bend[:, None] + np.hypot(*body.vertices.T) * self.twist[:, None]
        return _Corners(places, moves * self.half[:, None, None], 0.5 * stray * self.half[:, None] ** 2)


class _Corners(NamedTuple):
    """Corners of a body in cells: places and largest moves along the tangent, Shape (n, k, 2); rest (n, k) [m]."""

    places: FloatArray
    moves: FloatArray
    stray: FloatArray

    def boxes(self, reach: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the lower and upper corners of boxes around the body in each cell, Shape (n, 2)."""
        spread = np.abs(self.moves) + self.stray[..., None] + reach[:, None, None]
        return (self.places - spread).min(axis=1), (self.places + spread).max(axis=1)

    def heights(self, n: FloatArray) -> FloatArray:
        """Return lower bounds of the body along the directions n, Shape (n, 2), in each cell, Shape (n,)."""
        height, rate = (np.sum(n[:, None] * column, axis=2) for column in self[:2])
        least: FloatArray = (height - np.abs(rate) - self.stray).min(axis=1)
        return least


class _Planes(NamedTuple):
    """Directions that separate a body from obstacles: angle [rad], Shape (n,).

    `gap`: lower bound of the distance in the cell [m]. `most`: distance in its middle, which no smaller cell around the
    middle exceeds (C3).
    """

    angle: FloatArray
    gap: FloatArray
    most: FloatArray


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
            proven, hopeless, planes = self._round(cells)
            if hopeless.any() or np.count_nonzero(~proven) > _MOST_OPEN:
                return None
            done = np.flatnonzero(proven)
            found += zip(*(column[done].tolist() for column in cells), (planes[k] for k in done), strict=True)
            if done.size == proven.size:
                found.sort(key=lambda cell: cell[:2])
                groups = itertools.groupby(found, key=lambda cell: cell[0])
                return [_segment_cells([*group]) for _, group in groups]
            cells = cells.rows(np.flatnonzero(~proven)).cut(2)
        return None

    def _round(self, cells: Cells) -> tuple[BoolArray, BoolArray, list[list[list[float]]]]:
        """Return masks of the proven cells and of those that cannot be divided into proven ones, and their planes.

        A plane consists of obstacle, piece of the footprint, and angle.
        """
        middle = 0.5 * (cells.first + cells.last)
        n = middle.size
        nodes = self.motion.nodes(np.tile(cells.segment, 3), np.concatenate((cells.first, middle, cells.last)))
        first, at, last = nodes.poses[:n], nodes.poses[n : 2 * n], nodes.poses[2 * n :]
        before = self.motion.bounds(Cells(cells.segment, cells.first, middle), first, at)
        after = self.motion.bounds(Cells(cells.segment, middle, cells.last), at, last)
        half, bend = np.maximum(before.width, after.width), np.maximum(before.bend, after.bend)
        middles = _Middles(at, before.velocity_last, half, bend, np.maximum(before.twist, after.twist))
        need = self._required(first, last, 0.5 * bend * half**2) - TOLERANCE
        need_there = self._required(at, at, np.zeros(n)) - TOLERANCE
        proven, hopeless = np.ones(n, dtype=np.bool_), np.zeros(n, dtype=np.bool_)
        planes: list[list[list[float]]] = [[] for _ in range(n)]
        for number, body in enumerate(self.bodies):
            low, high = middles.corners(body).boxes(np.maximum(need, 0.0) + _BEYOND)
            proven[np.any((low < self.region[0]) | (high > self.region[1]), axis=1)] = False
            meets = np.all((self.obstacles.lower <= high[:, None]) & (self.obstacles.upper >= low[:, None]), axis=2)
            cell, rock = np.nonzero(meets)
            angle, gap, most = self._planes(body, middles.rows(cell), rock)
            proven[cell[~(gap >= need[cell] + _SPARE)]] = False
            hopeless[cell[most < need_there[cell] + _SPARE]] = True
            for k, *plane in zip(cell.tolist(), rock.tolist(), angle.tolist(), strict=True):
                planes[k].append([plane[0], number, plane[1]])
        return proven, hopeless, planes

    def _required(self, first: FloatArray, last: FloatArray, sag: FloatArray) -> FloatArray:
        """Return the largest required clearance in every cell [m], Shape (n,)."""
        far = [
            np.maximum(*(np.hypot(*(ends[:, :2] - [place.x, place.y]).T) for ends in (first, last))) + sag
            for place in (self.problem.goal, self.problem.start)
        ]
        return self.problem.path_clearance.required_at(far[0], far[1], self.at_start, self.relief)

    def _planes(self, body: ConvexBody, cells: _Middles, rock: IntArray) -> _Planes:
        """Return a plane for every pair of a cell and an obstacle."""
        found = self._best_planes(body, cells, rock)
        near = np.flatnonzero(found.gap < _APART)
        if len(self.bodies) == 1 or near.size == 0:
            return found
        # A piece may overlap by the tolerance only along a direction in which the whole footprint does.
        angle, gap, most = self._best_planes(self.hull, cells.rows(near), rock[near])
        found.angle[near], found.gap[near] = angle, gap
        found.most[near] = np.where(found.most[near] >= _APART, found.most[near], most)
        return found

    @functools.cached_property
    def hull(self) -> ConvexBody:
        """The convex hull of the footprint."""
        import shapely

        (hull,) = convex_cover(shapely.convex_hull(shapely.Polygon(self.problem.robot.footprint.vertices)))
        return convex_body(hull)

    def _best_planes(self, body: ConvexBody, cells: _Middles, rock: IntArray) -> _Planes:
        if rock.size == 0:
            return _Planes(np.zeros(0), np.zeros(0), np.zeros(0))
        most, axis = separation(body, cells.poses, self.obstacles.pieces(rock))
        angle = np.asarray(np.round(np.arctan2(axis[:, 1], axis[:, 0]), _DIGITS), dtype=np.float64)
        n = np.column_stack((np.cos(angle), np.sin(angle)))
        far = np.sum(n[:, None] * self.obstacles.vertices[rock], axis=2).max(axis=1)
        return _Planes(angle, cells.corners(body).heights(n) - far, most)


def _segment_cells(cells: list[tuple[int, float, float, list[list[float]]]]) -> dict[str, object]:
    return {"borders": [cells[0][1], *(cell[2] for cell in cells)], "planes": [cell[3] for cell in cells]}
