"""Collision checks of poses: a distance field and covering discs, then exact distances.

The field contains exact distances at grid points, which bound the distance of any point from below and above
([Ericson2005] ch. 7, [Ziegler2010]). Discs that cover the footprint prove that a pose is free, and discs inside the
footprint prove that it is blocked. The remaining poses are measured exactly. Poses outside the field are not free.
"""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.arrays import readonly
from optdock.geometry.lazy import cached_property
from optdock.kernels import Kernel, twin_of
from optdock.model.clearance_rule import START_RELIEF_SLOPE
from optdock.planners.manoeuvres.disc_routes import Wavefront
from optdock.planners.manoeuvres.distance_field import Discs, DistanceField, disc_states
from optdock.verification import TOLERANCE, end_clearances, pose_clearances
from optdock.verification.clearance_kernel import packed_footprint

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.geometry.arrays import BoolArray, FloatArray
    from optdock.geometry.footprint import Footprint
    from optdock.geometry.separation import ConvexBody
    from optdock.model.problem import DockingProblem
    from optdock.planners.manoeuvres.distance_field import KernelArrays

__all__ = ["Effort", "FreeSpace"]

# Grid points along the sides of the field, and its side in robot widths, or twice the distance of start and goal if
# that is longer: 16 points per width of the robot; poses that the grid leaves undecided are measured exactly.
_POINTS, _SIDE = 2048, 128.0
_POSES_PER_WIDTH = 12, 24  # least and most poses of a collision check per width of the robot
_FINE_DISCS = 4  # across the width of the footprint
# Corners of the footprint times those of the obstacles up to which the kernel measures a pose exactly in less time than
# it takes to examine the fine discs: 0.3 and 0.7 us in parking slots. Both have the same result.
_FEW_CORNERS = 256
_EXACT_BLOCK = 300  # poses per exact measurement, about 2 ms
_AT_ONCE = 4000  # poses times (corners of the footprint + 4) per call of a kernel, at most a millisecond
_MARGIN_SLOPE = 0.25  # at which the margin grows from both ends


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


@functools.lru_cache(maxsize=64)
def _discs(footprint: Footprint, across: int) -> Discs:
    """Return the discs of all bodies, cached."""
    parts = zip(*(_discs_of(body, across) for body in footprint.bodies), strict=True)
    return Discs(*(readonly(np.concatenate(part)) for part in parts))


def _discs_of(body: ConvexBody, across: int) -> Discs:
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
    return Discs(centres[kept], np.full(np.count_nonzero(kept), cover), inside[kept])


class FreeSpace:
    """Test whether poses have the clearance that a problem requires, plus a margin.

    `poll` is called every few milliseconds and raises an exception to end the search. Attribute `width`: smaller extent
    of the footprint [m].
    """

    def __init__(self, problem: DockingProblem, poll: Callable[[], None]) -> None:
        self.problem, self.poll = problem, poll
        self.footprint: Footprint = problem.robot.footprint
        self.obstacles = problem.all_obstacles
        self._start, self._goal = problem.start.as_array()[:2], problem.goal.as_array()[:2]
        clearances = end_clearances(problem)
        self._start_clearance, self._goal_clearance = clearances.start, clearances.goal
        self._reach = self.footprint.circumscribed_radius + problem.path_clearance.required
        self.width = min(self.footprint.width, self.footprint.length)
        side = max(_SIDE * self.width, 2.0 * float(np.abs(self._goal - self._start).max()))
        self._square = np.array((*(0.5 * (self._start + self._goal)).tolist(), side))
        self.field = DistanceField(self.obstacles, self._square, side / _POINTS, 2.0 * self._reach, poll)
        self.levels = []
        for across in (1, _FINE_DISCS):  # a millisecond each for a new footprint with 60 corners
            self.levels.append(_discs(self.footprint, across))
            poll()
        robot = packed_footprint(self.footprint)
        self._at_once = max(1, _AT_ONCE // (robot.corners * len(robot.sizes) + 4))

    def spacing(self, effort: Effort) -> float:
        """Return the spacing [m] between the poses of a collision check."""
        return self.width / min(max(effort.fineness, _POSES_PER_WIDTH[0]), _POSES_PER_WIDTH[1])

    def wavefront(self, source: FloatArray, radius: float | None = None) -> Wavefront:
        """Return the wavefront of a disc, by default the inscribed disc, from a position, Shape (2,) [m]."""
        return Wavefront(self._coarse, source, self.footprint.inscribed_radius if radius is None else radius)

    @cached_property
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
        at_start = max(self._start_clearance, 0.0) + _MARGIN_SLOPE * from_start
        at_goal = max(self._goal_clearance, 0.0) + _MARGIN_SLOPE * from_goal
        kept: FloatArray = np.maximum(rule, np.minimum(rule + margin, np.minimum(at_start, at_goal)))
        return kept

    def may_be_free(self, poses: FloatArray) -> BoolArray:
        """Whether no disc inside the footprint overlaps an obstacle, a fast necessary condition. Shape (n,)."""
        if len(self.obstacles) == 0:
            return np.ones(len(poses), dtype=np.bool_)
        return ~disc_states(self.field, self.levels[0], poses, np.zeros(len(poses))).blocked

    def is_free(self, poses: FloatArray, margin: float = 0.0, start_relief: float = 0.0) -> BoolArray:
        """Whether poses, Shape (n, 3), have the required clearance plus the margin [m]. Shape (n,)."""
        if len(self.obstacles) == 0 or len(poses) == 0:
            return np.ones(len(poses), dtype=np.bool_)
        return _are_free(self, poses, margin, start_relief)

    def check(
        self,
        kernel: Kernel,
        sizes: tuple[int, ...],
        numbers: tuple[float, ...],
        arrays: KernelArrays,
        limits: tuple[float, float],
    ) -> None:
        """Call a kernel that checks as many poses as possible until it has done all of its sizes[0] items.

        `limits`: margin and start relief. The kernel gets a limit of poses per call as its last size, the limits and
        the least clearance of the start after its own numbers, and the arrays of the free space after its own arrays.
        """
        (margin, relief), progress = limits, np.zeros(3, dtype=np.int64)
        leaving = self.problem.path_clearance.least_leaving(self._start_clearance, relief)
        given, bounds, parts = (*sizes, self._at_once), (*numbers, margin, relief, leaving), (*arrays, *self._packed)
        while progress[0] < sizes[0]:
            self.field.call(kernel, given, bounds, parts, progress)

    @cached_property
    def _packed(self) -> KernelArrays:
        """Return the arrays from `sizes` to `work` of the kernels; see `SPACE_PARAMETERS` in C."""
        rule, robot, rocks = self.problem.path_clearance, packed_footprint(self.footprint), self.field.obstacles
        (m, k, _), bodies = rocks.vertices.shape, len(robot.sizes)
        levels = 1 if m * k * int(robot.sizes[:, 0].sum()) <= _FEW_CORNERS else 2
        discs = [level.cover.size for level in self.levels]
        sizes = np.array((levels, *discs, bodies, *robot.sizes.ravel().tolist()))
        at_start = np.nan if rule.at_start is None else rule.at_start
        rules = (
            *(rule.required, rule.at_dock, rule.taper, rule.dock_run, START_RELIEF_SLOPE, at_start),
            *(*self._start.tolist(), *self._goal.tolist()),
            *(max(self._start_clearance, 0.0), max(self._goal_clearance, 0.0), _MARGIN_SLOPE),
            *(TOLERANCE, self.footprint.circumscribed_radius),
        )
        circles = [part for one in self.levels for part in (*one.centres.T, one.cover, one.inside)]
        numbers = np.concatenate((rules, *circles, robot.numbers))
        near, work = np.empty(m, dtype=np.int64), np.empty(2 * (robot.corners + k + robot.circles))
        return tuple([(part, part.size) for part in (sizes, numbers, near, work)])


_POSES_KERNEL = Kernel("optdock_are_free", sizes=2, numbers=3)


def _are_free_native(space: FreeSpace, poses: FloatArray, margin: float, start_relief: float) -> BoolArray:
    n = len(poses)
    free = np.empty(n, dtype=np.int64)
    arrays = (np.ascontiguousarray(poses), 3 * n), (free, n)
    space.check(_POSES_KERNEL, (n,), (), arrays, (margin, start_relief))
    found: BoolArray = free != 0
    return found


@twin_of(_are_free_native)
def _are_free(space: FreeSpace, poses: FloatArray, margin: float, start_relief: float) -> BoolArray:
    required = space.required(poses, margin, start_relief) - TOLERANCE
    free = np.zeros(len(poses), dtype=np.bool_)
    open_rows = np.arange(len(poses))
    for level, discs in enumerate(space.levels):
        states = disc_states(space.field, discs, poses[open_rows], required[open_rows])
        free[open_rows[states.covered]] = True
        is_decided = states.covered | states.blocked
        open_rows = open_rows[~(is_decided if level else is_decided | states.outside)]
        if open_rows.size == 0:
            return free
    for k in range(0, open_rows.size, _EXACT_BLOCK):
        space.poll()
        some = open_rows[k : k + _EXACT_BLOCK]
        within = float(required[some].max()) + 1e-6
        exact, _ = pose_clearances(poses[some], space.footprint, space.obstacles, within, checks_unions=False)
        free[some] = exact >= required[some]
    return free
