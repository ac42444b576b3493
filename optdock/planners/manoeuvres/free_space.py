"""Which poses are free: a distance field with covering discs decides most, exact distances the others.

The field holds exact distances from grid points to the nearest obstacle piece; between grid points a distance changes
by no more than the way there, so it bounds the distance of any point from below and above ([Ericson2005] ch. 7 has
grids, [Ziegler2010] discs that cover a car). Discs that cover the footprint prove a pose free, discs inside it prove it
blocked; what lies between is measured exactly. The field is computed in tiles, on demand.
"""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.pose import transform_points
from optdock.planners.manoeuvres.distance_field import DistanceField, Wavefront
from optdock.verification import TOLERANCE, end_clearances, pose_clearances

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.geometry.arrays import BoolArray, FloatArray
    from optdock.geometry.footprint import Footprint
    from optdock.geometry.separation import ConvexBody
    from optdock.model.problem import DockingProblem

__all__ = ["Effort", "FreeSpace"]

# Grid points along the sides of the field, which is this many robot widths long, or twice as long as start and goal are
# apart: 16 points over the width of the robot; what lies between two of them is decided exactly anyway.
_POINTS, _SIDE = 2048, 128.0
_POSES_PER_WIDTH = 12, 24  # at least and at most: poses looked at over a way as long as the robot is wide
_FINE_DISCS = 4  # across the width of the footprint
_EXACT_BLOCK = 300  # poses measured exactly in one go, about 2 ms


class Effort(NamedTuple):
    """How closely a search looks.

    `radius`: of all arcs [m]. `margin`: kept beside the required clearance, for what a smoother changes [m].
    `fineness`: cells of the pose grid along the width of the robot. `nodes`: where hybrid A* gives up. `start_relief`:
    see `ClearanceRule.required_at` [m].
    """

    radius: float
    margin: float
    fineness: int
    nodes: int
    start_relief: float = 0.0


class _Discs(NamedTuple):
    """Centres (k, 2) [m]; radius that together cover a body; radii (k,) of discs inside it, negative where none is."""

    centres: FloatArray
    cover: float
    inside: FloatArray


def _discs(body: ConvexBody, across: int) -> _Discs:
    """One disc for every square of the body's bounding box, which has `across` of them on its shorter side."""
    low, high = body.vertices.min(axis=0), body.vertices.max(axis=0)
    size = high - low
    side = float(size.min()) / across
    counts = np.maximum(np.ceil(size / side - 1e-9), 1.0)
    xs, ys = (low[i] + size[i] * (np.arange(int(counts[i])) + 0.5) / counts[i] for i in (0, 1))
    centres = np.column_stack([axis.ravel() for axis in np.meshgrid(xs, ys, indexing="ij")])
    cover = 0.5 * float(np.hypot(*(size / counts)))
    inside = np.min(body.offsets - centres @ body.normals.T, axis=1)
    # Squares that lie beside the body cover nothing.
    kept = inside > -cover
    return _Discs(centres[kept], cover, inside[kept])


class FreeSpace:
    """Which poses keep the clearance that a problem asks for, and a margin.

    Args:
        problem: What must hold.
        poll: Called every few milliseconds of work; raises where the caller wants no more.

    Attributes:
        width: The lesser extent of the footprint [m].
    """

    def __init__(self, problem: DockingProblem, poll: Callable[[], None]) -> None:
        self.problem, self.poll = problem, poll
        self.footprint: Footprint = problem.robot.footprint
        self.obstacles = problem.all_obstacles
        ends = np.stack((problem.start.as_array(), problem.goal.as_array()))
        self._start, self._goal = ends[:, :2]
        clearances = end_clearances(problem)
        self._start_clearance, self._goal_clearance = clearances.start, clearances.goal
        radius = self.footprint.circumscribed_radius
        self._reach = radius + problem.path_clearance.required
        self.width = width = min(self.footprint.width, self.footprint.length)
        side = max(_SIDE * width, 2.0 * float(np.abs(self._goal - self._start).max()))
        self._square = np.array((*ends[:, :2].mean(axis=0), side))
        self.field = DistanceField(self.obstacles, self._square, side / _POINTS, 2.0 * self._reach, poll)
        bodies = self.footprint.bodies
        self._levels = tuple(tuple(_discs(body, across) for body in bodies) for across in (1, _FINE_DISCS))

    def spacing(self, effort: Effort) -> float:
        """Between poses that stand for a whole way [m]."""
        return self.width / min(max(effort.fineness, _POSES_PER_WIDTH[0]), _POSES_PER_WIDTH[1])

    def wavefront(self, source: FloatArray, radius: float | None = None) -> Wavefront:
        """Lengths of ways around the obstacles from a place, Shape (2,) [m].

        Args:
            source: The place.
            radius: Of the disc that drives them [m]; None: of the one inside the footprint.
        """
        return Wavefront(self._coarse, source, self.footprint.inscribed_radius if radius is None else radius)

    @functools.cached_property
    def _coarse(self) -> DistanceField:
        reach = max(2.0 * self.width, 1.25 * self._reach)
        return DistanceField(self.obstacles, self._square, 4.0 * self.field.spacing, reach, self.poll)

    def required(self, poses: FloatArray, margin: float, start_relief: float) -> FloatArray:
        """Required clearance at poses, and the margin, which tapers off towards both ends. Shape (n,) [m]."""
        from_start = np.hypot(*(poses[:, :2] - self._start).T)
        from_goal = np.hypot(*(poses[:, :2] - self._goal).T)
        rule: FloatArray = self.problem.path_clearance.required_at(
            from_goal, from_start, self._start_clearance, start_relief
        )
        if margin <= 0.0:
            return rule
        at_start = max(self._start_clearance, 0.0) + 0.25 * from_start
        at_goal = max(self._goal_clearance, 0.0) + 0.25 * from_goal
        kept: FloatArray = np.maximum(rule, np.minimum(rule + margin, np.minimum(at_start, at_goal)))
        return kept

    def may_be_free(self, poses: FloatArray) -> BoolArray:
        """Whether no disc inside the footprint meets an obstacle: a quick first look. Shape (n,)."""
        passed = np.ones(len(poses), dtype=np.bool_)
        for discs in self._levels[0] if len(self.obstacles) else ():
            _, upper = self.field.bounds(transform_points(poses, discs.centres))
            passed &= (upper - discs.inside).min(axis=1) >= 0.0
        return passed

    def is_free(self, poses: FloatArray, margin: float = 0.0, start_relief: float = 0.0) -> BoolArray:
        """Whether poses, Shape (n, 3), keep the required clearance and the margin [m]. Shape (n,)."""
        if len(self.obstacles) == 0 or len(poses) == 0:
            return np.ones(len(poses), dtype=np.bool_)
        required = self.required(poses, margin, start_relief) - TOLERANCE
        free = np.zeros(len(poses), dtype=np.bool_)
        open_rows = np.arange(len(poses))
        for level in self._levels:
            is_covered = np.ones(open_rows.size, dtype=np.bool_)
            is_blocked = np.zeros(open_rows.size, dtype=np.bool_)
            for discs in level:
                lower, upper = self.field.bounds(transform_points(poses[open_rows], discs.centres))
                is_covered &= lower.min(axis=1) - discs.cover >= required[open_rows]
                is_blocked |= (upper - discs.inside).min(axis=1) < required[open_rows]
                is_blocked |= np.isneginf(lower).any(axis=1)
            free[open_rows[is_covered]] = True
            open_rows = open_rows[~is_covered & ~is_blocked]
            if open_rows.size == 0:
                return free
        for k in range(0, open_rows.size, _EXACT_BLOCK):
            self.poll()
            some = open_rows[k : k + _EXACT_BLOCK]
            free[some] = self.clearances(poses[some], float(required[some].max()) + 1e-6) >= required[some]
        return free

    def clearances(self, poses: FloatArray, within: float = np.inf) -> FloatArray:
        """Exact signed clearances of poses up to `within` [m]. Shape (n,)."""
        found, _ = pose_clearances(poses, self.footprint, self.obstacles, within)
        return found
