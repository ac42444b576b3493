"""Collision checks of poses: a distance field and covering discs, then exact distances.

The field contains exact distances at grid points, which bound the distance of any point from below and above
([Ericson2005] ch. 7, [Ziegler2010]). Discs that cover the footprint prove that a pose is free, and discs inside the
footprint prove that it is blocked. The remaining poses are measured exactly.
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

# Grid points along the sides of the field, and its side in robot widths, or twice the distance of start and goal if
# that is longer: 16 points per width of the robot; poses that the grid leaves undecided are measured exactly.
_POINTS, _SIDE = 2048, 128.0
_POSES_PER_WIDTH = 12, 24  # least and most poses of a collision check per width of the robot
_FINE_DISCS = 4  # across the width of the footprint
_EXACT_BLOCK = 300  # poses per exact measurement, about 2 ms


class Effort(NamedTuple):
    """Resolution and limits of a search.

    `radius`: radius of all arcs [m]. `margin`: additional clearance for the smoother [m]. `fineness`: cells of the pose
    grid per width of the robot. `nodes`: largest number of nodes of hybrid A*. `start_relief`: see
    `ClearanceRule.required_at` [m].
    """

    radius: float
    margin: float
    fineness: int
    nodes: int
    start_relief: float = 0.0


class _Discs(NamedTuple):
    """Centres (k, 2) [m], radius at which discs cover a body, and radii (k,) inside it, negative for no disc."""

    centres: FloatArray
    cover: float
    inside: FloatArray


def _discs(body: ConvexBody, across: int) -> _Discs:
    """Return one disc per square of the body's bounding box, with `across` squares along its shorter side."""
    low, high = body.vertices.min(axis=0), body.vertices.max(axis=0)
    size = high - low
    side = float(size.min()) / across
    counts = np.maximum(np.ceil(size / side - 1e-9), 1.0)
    xs, ys = (low[i] + size[i] * (np.arange(int(counts[i])) + 0.5) / counts[i] for i in (0, 1))
    centres = np.column_stack([axis.ravel() for axis in np.meshgrid(xs, ys, indexing="ij")])
    cover = 0.5 * float(np.hypot(*(size / counts)))
    inside = np.min(body.offsets - centres @ body.normals.T, axis=1)
    # Squares outside the body cover nothing.
    kept = inside > -cover
    return _Discs(centres[kept], cover, inside[kept])


class FreeSpace:
    """Test whether poses have the clearance that a problem requires, plus a margin.

    `poll` is called every few milliseconds and raises an exception to end the search. Attribute `width`: smaller extent
    of the footprint [m].
    """

    def __init__(self, problem: DockingProblem, poll: Callable[[], None]) -> None:
        self.problem, self.poll = problem, poll
        self.footprint: Footprint = problem.robot.footprint
        self.obstacles = problem.all_obstacles
        ends = np.stack((problem.start.as_array(), problem.goal.as_array()))
        self._start, self._goal = ends[:, :2]
        clearances = end_clearances(problem)
        self._start_clearance, self._goal_clearance = clearances.start, clearances.goal
        self._reach = self.footprint.circumscribed_radius + problem.path_clearance.required
        self.width = min(self.footprint.width, self.footprint.length)
        side = max(_SIDE * self.width, 2.0 * float(np.abs(self._goal - self._start).max()))
        self._square = np.array((*ends[:, :2].mean(axis=0), side))
        self.field = DistanceField(self.obstacles, self._square, side / _POINTS, 2.0 * self._reach, poll)
        self._levels = [[_discs(body, across) for body in self.footprint.bodies] for across in (1, _FINE_DISCS)]

    def spacing(self, effort: Effort) -> float:
        """Return the spacing [m] between the poses of a collision check."""
        return self.width / min(max(effort.fineness, _POSES_PER_WIDTH[0]), _POSES_PER_WIDTH[1])

    def wavefront(self, source: FloatArray, radius: float | None = None) -> Wavefront:
        """Return the wavefront of a disc, by default the inscribed disc, from a position, Shape (2,) [m]."""
        return Wavefront(self._coarse, source, self.footprint.inscribed_radius if radius is None else radius)

    @functools.cached_property
    def _coarse(self) -> DistanceField:
        reach = max(2.0 * self.width, 1.25 * self._reach)
        return DistanceField(self.obstacles, self._square, 4.0 * self.field.spacing, reach, self.poll)

    def required(self, poses: FloatArray, margin: float, start_relief: float) -> FloatArray:
        """Return the required clearance plus the margin, which tapers off towards both ends. Shape (n,) [m]."""
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
        """Whether no disc inside the footprint overlaps an obstacle, a fast necessary condition. Shape (n,)."""
        passed = np.ones(len(poses), dtype=np.bool_)
        for discs in self._levels[0] if len(self.obstacles) else ():
            _, upper = self.field.bounds(transform_points(poses, discs.centres))
            passed &= (upper - discs.inside).min(axis=1) >= 0.0
        return passed

    def is_free(self, poses: FloatArray, margin: float = 0.0, start_relief: float = 0.0) -> BoolArray:
        """Whether poses, Shape (n, 3), have the required clearance plus the margin [m]. Shape (n,)."""
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
            within = float(required[some].max()) + 1e-6
            clearances, _ = pose_clearances(poses[some], self.footprint, self.obstacles, within, checks_unions=False)
            free[some] = clearances >= required[some]
        return free
