"""Looking ahead: no command is given after which the robot could not stop before it is in something.

What is looked at are the ways on which a robot may come to a stop: what is under way in the drive, one period of the
command, and braking. Along each of them the whole footprint is placed among everything that the context holds.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.errors import NoValidControl
from optdock.geometry.obstacles import ObstacleSet, box_distance, in_words
from optdock.geometry.separation import separation
from optdock.model.cell_obstacles import obstacles_from_costmap
from optdock.plugins.outcomes import CostmapInfoType

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray, IntArray
    from optdock.geometry.footprint import Footprint
    from optdock.geometry.pose import Pose2, Twist2
    from optdock.model.costmap import Costmap
    from optdock.plugins.lifecycle import PluginContext

__all__ = ["LookAhead", "Obstruction", "collision_ahead", "stopping_time", "stopping_way"]

_SPACING = 0.03  # [m] that no point of the footprint moves by more between two poses
_DEEPER = 1e-6  # [m]: a robot that touches something may drive on as long as it does not go deeper
_TOUCHING = 1e-3  # [m]: what is nearer than this where the robot ends is touched there
_AT_CONTACT = 0.1  # [m]: a robot further off, by more than noise and overshoot, is not there yet: it touches by mistake
_MARGIN = 0.5  # [m] around the robot in which obstacles are kept from call to call


class Obstruction(NamedTuple):
    """What is in the way, and how deep the footprint would go into it [m]."""

    obstacle: str
    depth: float


def stopping_time(command: Twist2, deceleration: float, yaw_deceleration: float = math.inf) -> float:
    """How long braking takes along the arc of a command [s]: speed and yaw rate fall together.

    Args:
        command: The velocity to brake from.
        deceleration: Of the speed [m/s^2].
        yaw_deceleration: Of the yaw rate [rad/s^2]; unlimited where it is unknown.
    """
    return max(abs(command.linear) / deceleration, abs(command.angular) / yaw_deceleration)


def stopping_way(pose: Pose2, footprint: Footprint, phases: tuple[tuple[Twist2, float], ...]) -> FloatArray:
    """Poses from `pose` on, along arcs: each a velocity and how long it holds [s]. Shape (n, 3)."""
    radius, poses = footprint.circumscribed_radius, [(pose.x, pose.y, pose.yaw)]
    for twist, duration in phases:
        reach = duration * (abs(twist.linear) + radius * abs(twist.angular))
        count = math.ceil(reach / _SPACING)
        for k in range(1, count + 1):
            then = pose.moved(twist, duration * k / count)
            poses.append((then.x, then.y, then.yaw))
        pose = pose.moved(twist, duration)
    return np.array(poses)


class LookAhead:
    """Looks for obstacles on the ways of a robot; remembers those around it as long as they stay what they are."""

    def __init__(self) -> None:
        self._around: _Around | None = None

    def obstruction(
        self, context: PluginContext, way: FloatArray, contacts: FloatArray, tolerance: float, noise: float = 0.0
    ) -> Obstruction | None:
        """The obstacle that the footprint goes into along a way, the deepest; None where it touches nothing by mistake.

        Where it is in an obstacle already at the first pose it must not go deeper into that one. The station, and what
        it touches at a pose of `contacts`, is touched on purpose: it may be pressed a little, the latter only there.

        Args:
            context: Surroundings; without a footprint nothing is looked at.
            way: Poses, Shape (n, 3).
            contacts: Poses at which the robot may touch something, Shape (k, 3).
            tolerance: How deep it may be in what it touches on purpose, by noise and a bumper that yields [m].
            noise: How deep noise alone may show it in anything [m].
        """
        footprint = context.footprint
        if footprint is None:
            return None
        radius = footprint.circumscribed_radius
        lower, upper = way[:, :2].min(axis=0) - radius, way[:, :2].max(axis=0) + radius
        obstacles = self._near(context, lower, upper)
        rows = obstacles.rows_in_box(lower, upper)
        if rows.size == 0:
            return None
        close = box_distance(obstacles.subset(rows), way[:, :2]) < radius
        columns = np.flatnonzero(close.any(axis=0))
        if columns.size == 0:
            return None
        rows = rows[columns]
        distance = _distances(footprint, way, obstacles, rows)
        deepest, before = distance.min(axis=0), distance[0] - _DEEPER
        if bool(np.all(deepest >= np.minimum(0.0, before))):
            return None
        at_contacts = _distances(footprint, contacts, obstacles, rows)
        touched = (at_contacts >= -tolerance) & (at_contacts <= _TOUCHING)
        off = np.linalg.norm(way[:, None, :2] - contacts[None, :, :2], axis=2)
        meant = np.any((off <= _AT_CONTACT)[:, :, None] & touched, axis=1)
        meant |= np.array([obstacles.name_of(row) == "dock" for row in rows.tolist()])
        allowed = np.minimum(np.where(meant, -tolerance, -min(noise, tolerance)), before)
        beyond = np.where(distance < allowed, distance, np.inf).min(axis=0)
        worst = int(np.argmin(beyond))
        if not math.isfinite(float(beyond[worst])):
            return None
        return Obstruction(obstacles.name_of(int(rows[worst])), -float(beyond[worst]))

    def _near(self, context: PluginContext, lower: FloatArray, upper: FloatArray) -> ObstacleSet:
        """The obstacles of the context in a box and some more around it, its costmaps as they are now."""
        around = self._around
        if around is None or around.context is not context or not around.holds(lower, upper):
            low, high = lower - _MARGIN, upper + _MARGIN
            problem = context.problem
            fixed = ObstacleSet.empty() if problem is None else problem.all_obstacles.in_box(low, high)
            own = None if problem is None else problem.costmap
            grids = tuple(grid for grid in context.costmaps(CostmapInfoType.BOTH) if grid is not own)
            around = self._around = _Around(context, low, high, fixed, tuple(_Grid(grid, low, high) for grid in grids))
        return around.obstacles()


class _Grid:
    """The obstacles of a costmap in a box, found anew only when its cells there have changed."""

    def __init__(self, grid: Costmap, lower: FloatArray, upper: FloatArray) -> None:
        self._grid, self._box = grid, (lower, upper)
        first, last = grid.cell_of(np.stack(self._box))
        size = (grid.columns, grid.rows)
        i, j = (slice(*np.clip((first[k], last[k] + 1), 0, size[k]).tolist()) for k in (0, 1))
        self._window = (j, i)
        self._cells: FloatArray | None = None
        self._obstacles = ObstacleSet.empty()

    def obstacles(self) -> ObstacleSet:
        """As the cells are now."""
        cells = self._grid.data[self._window]
        if self._cells is None or not np.array_equal(cells, self._cells):
            self._cells = cells.copy()
            self._obstacles = obstacles_from_costmap(self._grid, region=self._box)
        return self._obstacles


class _Around:
    """The obstacles of a context in a box."""

    def __init__(
        self, context: PluginContext, lower: FloatArray, upper: FloatArray, fixed: ObstacleSet, grids: tuple[_Grid, ...]
    ) -> None:
        self.context, self._lower, self._upper = context, lower, upper
        self._fixed, self._grids = fixed, grids
        self._parts: tuple[ObstacleSet, ...] = ()
        self._all = fixed

    def holds(self, lower: FloatArray, upper: FloatArray) -> bool:
        """Whether a box lies within."""
        return bool(np.all(self._lower <= lower) and np.all(upper <= self._upper))

    def obstacles(self) -> ObstacleSet:
        """All of them, the costmaps' as they are now."""
        parts = tuple(grid.obstacles() for grid in self._grids)
        if len(parts) != len(self._parts) or any(a is not b for a, b in zip(parts, self._parts, strict=True)):
            self._parts, self._all = parts, self._fixed
            for part in parts:
                self._all = self._all + part
        return self._all


def _distances(footprint: Footprint, poses: FloatArray, obstacles: ObstacleSet, rows: IntArray) -> FloatArray:
    """Signed distances of the footprint at every pose to every one of the obstacles, Shape (n, m) [m]."""
    n, m = len(poses), rows.size
    every, pieces = np.repeat(poses, m, axis=0), obstacles.pieces(np.tile(rows, n))
    found: FloatArray = np.min([separation(body, every, pieces).distance for body in footprint.bodies], axis=0)
    return found.reshape(n, m)


def collision_ahead(context: PluginContext, found: Obstruction) -> NoValidControl:
    """The refusal that names an obstruction."""
    goes = f"the footprint goes {found.depth:.3f} m into {in_words(found.obstacle)}"
    return NoValidControl(
        f"{context.name}: collision ahead: even braking now, {goes}",
        where={"obstacle": found.obstacle, "depth": found.depth},
    )
