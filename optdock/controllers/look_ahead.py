"""Collision check of a command: the footprint along the motion to a stop is checked against the obstacles.

The motion consists of the commands that the drive has not yet executed, one period of the new command, and braking.
"""

from __future__ import annotations

import functools
import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.obstacles import ObstacleSet, box_distance
from optdock.geometry.pose import arc_end
from optdock.geometry.separation import separation
from optdock.kernels import Kernel, twin_of
from optdock.model.cell_obstacles import obstacles_from_costmap
from optdock.plugins.outcomes import CostmapInfoType
from optdock.verification.clearance_kernel import packed_footprint

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from optdock.geometry.footprint import Footprint
    from optdock.geometry.pose import Pose2, Twist2
    from optdock.model.costmap import Costmap
    from optdock.plugins.lifecycle import PluginContext

__all__ = ["LookAhead", "Obstruction", "near_distances", "radius_of", "stopping_way"]

_SPACING = 0.03  # [m], largest motion of a point of the footprint between two poses
_DEEPER = 1e-6  # [m], rounding of a depth that does not increase
_TOUCHING = 1e-3  # [m], largest distance of a contact
_AT_CONTACT = 0.1  # [m], distance from the pose of an intended contact, above noise and overshoot
_FAR = 0.5  # [m]: larger clearances are not computed
_MARGIN = 0.5  # [m] around the motion in which obstacles are cached between calls


class Obstruction(NamedTuple):
    """Name of an obstacle and depth of the footprint in it [m]."""

    obstacle: str
    depth: float


def stopping_way(pose: Pose2, footprint: Footprint, phases: tuple[tuple[Twist2, float], ...]) -> FloatArray:
    """Return poses along successive arcs from `pose`; each arc is a velocity and a duration [s]. Shape (n, 3)."""
    radius, (x, y, yaw) = radius_of(footprint), (pose.x, pose.y, pose.yaw)
    poses = [(x, y, yaw)]
    for twist, duration in phases:
        reach = duration * (abs(twist.linear) + radius * abs(twist.angular))
        velocity, count = (twist.linear, twist.angular, twist.lateral), math.ceil(reach / _SPACING)
        poses += [arc_end(x, y, yaw, velocity, duration * k / count) for k in range(1, count)]
        x, y, yaw = arc_end(x, y, yaw, velocity, duration)
        if count > 0:
            poses.append((x, y, yaw))
    return np.array(poses)


@functools.lru_cache(maxsize=8)
def radius_of(footprint: Footprint) -> float:
    """Return `Footprint.circumscribed_radius` [m], cached."""
    return footprint.circumscribed_radius


class _Clear(NamedTuple):
    """Pose at which the footprint has at least a clearance [m] from all obstacles; `obstacles`: those of the box."""

    x: float
    y: float
    yaw: float
    clearance: float
    obstacles: ObstacleSet


class _Touching(NamedTuple):
    """Poses at which contact is intended, Shape (k, 3), and their distances to the obstacles, Shape (k, m) [m]."""

    obstacles: ObstacleSet
    contacts: FloatArray
    distances: FloatArray


class LookAhead:
    """Search for obstacles along motions; the obstacles around the robot are cached until they change."""

    def __init__(self) -> None:
        self._around: _Around | None = None
        self._clear: _Clear | None = None
        self._touching: _Touching | None = None

    def is_clear(self, context: PluginContext, footprint: Footprint, pose: Pose2, reach: float) -> bool:
        """Whether no motion from `pose` that displaces the footprint by at most `reach` [m] meets an obstacle.

        Only the clearance found by the last call of `obstruction` is used, so False means unknown.
        """
        clear, around = self._clear, self._around
        if clear is None or around is None or around.context is not context:
            return False
        off = math.hypot(pose.x - clear.x, pose.y - clear.y)
        turned = abs(math.sin(0.5 * (pose.yaw - clear.yaw)))
        moved = off + 2.0 * radius_of(footprint) * turned  # see `displacement`
        return moved + reach < clear.clearance and around.obstacles() is clear.obstacles

    def obstruction(
        self, context: PluginContext, way: FloatArray, contacts: FloatArray, tolerance: float, noise: float = 0.0
    ) -> Obstruction | None:
        """Return the obstacle that the footprint penetrates deepest along a motion; None without a collision.

        If the robot overlaps an obstacle at the first pose, the depth must not increase. Contact with the station is
        intended. Near a pose of `contacts`, contact with the obstacles touched at that pose is also intended. Intended
        contact may be as deep as `tolerance`.

        Args:
            context: Footprint and obstacles; without a footprint nothing is checked.
            way: Poses along the motion, Shape (n, 3).
            contacts: Poses at which the robot may touch obstacles, Shape (k, 3).
            tolerance: Largest depth [m] allowed for an intended contact, to cover noise and a compliant bumper.
            noise: Largest apparent depth [m] in an obstacle that can result from noise of the poses.
        """
        footprint = context.footprint
        if footprint is None:
            return None
        radius = radius_of(footprint)
        lower, upper = way[:, :2].min(axis=0) - radius, way[:, :2].max(axis=0) + radius
        obstacles = self._near(context, lower, upper)
        distance = near_distances(footprint, way, obstacles)
        room = 0.0 if self._around is None else self._around.room(way[0], radius)
        x, y, yaw = way[0].tolist()
        self._clear = _Clear(x, y, yaw, min(float(distance[0].min(initial=_FAR)), room), obstacles)
        if float(distance.min(initial=_FAR)) >= 0.0:
            return None
        rows = np.flatnonzero(distance.min(axis=0) < 0.0)
        distance = distance[:, rows]
        before = distance[0] - _DEEPER
        if bool(np.all(distance.min(axis=0) >= np.minimum(0.0, before))):
            return None
        at_contacts = self._at_contacts(footprint, contacts, obstacles)[:, rows]
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

    def _at_contacts(self, footprint: Footprint, contacts: FloatArray, obstacles: ObstacleSet) -> FloatArray:
        """Return the signed distances of the footprint at the contacts to all obstacles, cached. Shape (k, m) [m]."""
        known = self._touching
        if known is None or known.obstacles is not obstacles or not np.array_equal(known.contacts, contacts):
            known = self._touching = _Touching(obstacles, contacts, near_distances(footprint, contacts, obstacles))
        return known.distances

    def _near(self, context: PluginContext, lower: FloatArray, upper: FloatArray) -> ObstacleSet:
        """Return the obstacles of the context in and around a box, from the present costmaps."""
        around = self._around
        if around is None or around.context is not context or not around.contains(lower, upper):
            around = self._around = _Around(context, lower - _MARGIN, upper + _MARGIN)
        return around.obstacles()


class _Grid:
    """Obstacles of a costmap in a box, updated when the cells in the box have changed."""

    def __init__(self, grid: Costmap, lower: FloatArray, upper: FloatArray) -> None:
        self._grid, self._box = grid, (lower, upper)
        first, last = grid.cell_of(np.stack(self._box))
        size = (grid.columns, grid.rows)
        i, j = (slice(*np.clip((first[k], last[k] + 1), 0, size[k]).tolist()) for k in (0, 1))
        self._window = (j, i)
        self._cells: FloatArray | None = None
        self._obstacles = ObstacleSet.empty()

    def obstacles(self) -> ObstacleSet:
        """Return the obstacles that the present cells form."""
        cells = self._grid.data[self._window]
        if self._cells is None or not np.array_equal(cells, self._cells):
            self._cells = cells.copy()
            self._obstacles = obstacles_from_costmap(self._grid, region=self._box)
        return self._obstacles


class _Around:
    """Obstacles of a context that lie in a box, cached until they change."""

    def __init__(self, context: PluginContext, lower: FloatArray, upper: FloatArray) -> None:
        self.context, self._box = context, (*lower.tolist(), *upper.tolist())
        problem = context.problem
        self._fixed = ObstacleSet.empty() if problem is None else problem.all_obstacles.in_box(lower, upper)
        own = None if problem is None else problem.costmap
        grids = (grid for grid in context.costmaps(CostmapInfoType.BOTH) if grid is not own)
        self._grids = tuple(_Grid(grid, lower, upper) for grid in grids)
        self._parts: tuple[ObstacleSet, ...] = ()
        self._all = self._fixed

    def contains(self, lower: FloatArray, upper: FloatArray) -> bool:
        """Whether a given box lies inside this box."""
        (x, y), (far_x, far_y), (least_x, least_y, most_x, most_y) = lower.tolist(), upper.tolist(), self._box
        return bool(least_x <= x and least_y <= y and far_x <= most_x and far_y <= most_y)

    def room(self, pose: FloatArray, radius: float) -> float:
        """Return the distance [m] of a circle around a pose to the border of the box."""
        (x, y, _), (least_x, least_y, most_x, most_y) = pose.tolist(), self._box
        return float(min(x - least_x, y - least_y, most_x - x, most_y - y)) - radius

    def obstacles(self) -> ObstacleSet:
        """Return all obstacles, from the present costmaps."""
        parts = tuple(grid.obstacles() for grid in self._grids)
        if len(parts) != len(self._parts) or any(a is not b for a, b in zip(parts, self._parts, strict=True)):
            self._parts, self._all = parts, self._fixed
            for part in parts:
                self._all = self._all + part
        return self._all


_DISTANCES = Kernel("optdock_near_distances", sizes=4, numbers=1)


def _near_distances_natively(footprint: Footprint, poses: FloatArray, obstacles: ObstacleSet) -> FloatArray:
    robot, n, m, q = packed_footprint(footprint), len(poses), len(obstacles), obstacles.vertices.shape[1]
    out = np.empty((n, m))
    arrays = (
        (robot.sizes, robot.sizes.size),
        (robot.numbers, robot.numbers.size),
        (np.ascontiguousarray(poses), 3 * n),
        (obstacles.vertices, 2 * m * q),
        (obstacles.normals, 2 * m * q),
        (obstacles.offsets, m * q),
        (obstacles.lower, 2 * m),
        (obstacles.upper, 2 * m),
        (out, n * m),
        (np.empty(size := 2 * robot.corners), size),
    )
    _DISTANCES((n, m, len(robot.sizes), q), (radius_of(footprint) + _FAR,), arrays)
    return out


@twin_of(_near_distances_natively)
def near_distances(footprint: Footprint, poses: FloatArray, obstacles: ObstacleSet) -> FloatArray:
    """Return the signed distances of the footprint at poses to obstacles.

    Args:
        footprint: The outline.
        poses: Shape (n, 3).
        obstacles: m obstacles; may be empty.

    Returns:
        Shape (n, m) [m]; infinite for pairs that are farther apart than 0.5 m by their bounding box and circle.
    """
    near = box_distance(obstacles, poses[:, :2]) < radius_of(footprint) + _FAR
    i, o = np.nonzero(near)
    found: FloatArray = np.full(near.shape, np.inf)
    if i.size:
        pieces = obstacles.pieces(o)
        found[near] = np.min([separation(body, poses[i], pieces).distance for body in footprint.bodies], axis=0)
    return found
