"""Obstacles around the robot, staging poses, and the planning problems built from the newest estimates.

In a costmap the station is one or two cells too large, so the docked robot would collide with the part of the station
that it must touch. The cells at the touching edge of the docked robot, the contact zone, are freed before planning.
"""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, Any

import numpy as np

from optdock.executor.dock_estimate import staging_distance
from optdock.executor.task_states import Interrupted
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2, transform_points
from optdock.model.cell_obstacles import obstacles_from_costmap
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.costmap import Costmap
from optdock.model.costs import FREE_SPACE
from optdock.model.dock import Dock, DockDirection

if TYPE_CHECKING:
    from optdock.executor.checked_inputs import CheckedDockType
    from optdock.executor.dock_estimate import DockEstimate
    from optdock.executor.executor_settings import ExecutorSettings
    from optdock.executor.perception import Perception
    from optdock.geometry.footprint import Footprint
    from optdock.model.problem import DockingProblem

__all__ = ["FROM_REST", "PlanningScene", "StagingPoses", "contact_reach", "with_contact_zone"]

_SAME_DOCK = 0.01  # [m], [rad]: displacement of the dock below which the freed cells stay the same
_ARRIVED = 0.05, 0.05  # [m], [rad] from the staging pose
FROM_REST: dict[str, Any] = {"start_speed": 0.0, "start_acceleration": 0.0, "start_curvature": None}


def contact_reach(costmap: Costmap, margin: float) -> float:
    """Return the distance [m] from the touching edge to the farthest cell centres that `with_contact_zone` frees."""
    return max(margin, 1.5 * costmap.resolution)


def with_contact_zone(costmap: Costmap, dock: Dock, footprint: Footprint, margin: float) -> Costmap:
    """Return the costmap with the cells at the touching edge of the docked robot freed.

    Only cells within the margin of that edge are freed, or within one and a half cells if that distance is larger.
    Obstacles in the way of the robot are kept.

    Args:
        costmap: Costmap in the frame of the dock.
        dock: Docked pose and gear.
        footprint: Footprint of the robot.
        margin: Distance from the edge [m].
    """
    ahead = -1.0 if dock.direction is DockDirection.BACKWARD else 1.0
    vertices = footprint.vertices
    front, half = float((ahead * vertices[:, 0]).max()), float(np.abs(vertices[:, 1]).max())
    reach = contact_reach(costmap, margin)
    radius = math.hypot(front + reach, half + reach)
    centre = np.array([dock.pose.x, dock.pose.y])
    low = np.clip(costmap.cell_of([centre - radius])[0], 0, (costmap.columns, costmap.rows))
    high = np.clip(costmap.cell_of([centre + radius])[0] + 1, 0, (costmap.columns, costmap.rows))
    if np.any(high <= low):
        return costmap
    i, j = np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
    cells = np.column_stack((i.ravel(), j.ravel()))
    seen = transform_points(dock.pose.inverse().as_array()[None], costmap.centre_of(cells))[0]
    touches = (np.abs(ahead * seen[:, 0] - front) <= reach) & (np.abs(seen[:, 1]) <= half + reach)
    freed = cells[touches]
    if not np.any(costmap.data[freed[:, 1], freed[:, 0]] != FREE_SPACE):
        return costmap
    data = costmap.data.copy()
    data[freed[:, 1], freed[:, 0]] = FREE_SPACE
    return Costmap(data, costmap.resolution, costmap.origin)


class PlanningScene:
    """Obstacles and planning problems, from the newest costmap and the newest pose of the dock."""

    def __init__(self, problem: DockingProblem, settings: ExecutorSettings, perception: Perception) -> None:
        self.problem, self.settings, self.perception = problem, settings, perception
        self._cleared: tuple[Costmap | None, Costmap | None, Pose2] = (None, None, problem.goal)

    @property
    def dock(self) -> Dock:
        """The dock at its estimated pose."""
        return dataclasses.replace(self.problem.dock, pose=self.perception.dock)

    @property
    def costmap(self) -> Costmap | None:
        """The newest costmap with the contact zone freed; None without a costmap."""
        seen = self.perception.costmap or self.problem.costmap
        if seen is None:
            return None
        dock, (known, cleared, place) = self.perception.dock, self._cleared
        if seen is not known or dock.gap_to(place) > _SAME_DOCK:
            margin, footprint = self.settings.contact_margin, self.problem.robot.footprint
            cleared = with_contact_zone(seen, self.dock, footprint, margin)
            self._cleared = seen, cleared, dock
        return cleared

    @property
    def station(self) -> ObstacleSet:
        """The station at the estimated pose of the dock."""
        station = self.problem.dock.footprint
        if station is None:
            return ObstacleSet.empty()
        return ObstacleSet.from_footprint(station, self.perception.dock, "dock")

    def near(self, robot: Pose2, reach: float, *, with_station: bool = True) -> ObstacleSet:
        """Return the obstacles within `reach` [m] of a pose, with or without the station."""
        centre = np.array([robot.x, robot.y])
        found = self.problem.obstacles.in_box(centre - reach, centre + reach)
        if with_station:
            found += self.station
        costmap = self.costmap
        if costmap is None:
            return found
        return found + obstacles_from_costmap(costmap, region=(centre - reach, centre + reach))

    def to_dock(self) -> DockingProblem:
        """Return the problem from the pose of the robot, at rest, to the estimated dock."""
        return dataclasses.replace(
            self.problem, start=self.perception.robot, dock=self.dock, costmap=self.costmap, **FROM_REST
        )

    def to(self, place: Pose2) -> DockingProblem:
        """Return the problem of driving from the robot's pose, at rest, to a pose in front of the dock.

        The station is an obstacle, and the full clearance is required up to the end of the path.
        """
        kept = self.problem.clearance.required
        return dataclasses.replace(
            self.problem,
            start=self.perception.robot,
            dock=Dock(place),
            obstacles=self.problem.obstacles + self.station,
            clearance=ClearanceRule(kept, kept, 0.0),
            costmap=self.costmap,
            **FROM_REST,
        )


class StagingPoses:
    """The staging poses of the estimated dock."""

    def __init__(self, dock_type: CheckedDockType, estimate: DockEstimate, scene: PlanningScene) -> None:
        self.dock_type, self.estimate, self.scene = dock_type, estimate, scene
        self.problem, self.settings, self.perception = scene.problem, scene.settings, scene.perception

    def poses(self) -> tuple[Pose2, ...]:
        """Return the staging poses in the fixed frame, the preferred one first."""
        distance = self.settings.staging_distance or staging_distance(self.problem)
        return tuple(self.perception.dock @ pose for pose in self.dock_type.staging_poses(self.estimate.gear, distance))

    def distance_to_nearest(self) -> float:
        """Return Nav2's norm, over metres and radians, of the displacement to the nearest staging pose."""
        gaps = [self.perception.robot.in_frame_of(place) for place in self.poses()]
        return min(math.sqrt(gap.x**2 + gap.y**2 + gap.yaw**2) for gap in gaps)

    @property
    def is_passed(self) -> bool:
        """Whether the robot is nearer to the dock than every staging pose."""
        dock = self.perception.dock
        return self.estimate.distance < min(dock.distance_to(place) for place in self.poses()) - _ARRIVED[0]

    def turned_round(self) -> tuple[Pose2, ...]:
        """Return the staging poses rotated by 180 degrees, to detect a dock that is entered in reverse."""
        return tuple(place @ Pose2(0.0, 0.0, math.pi) for place in self.poses())

    def may_see_dock_from(self, places: tuple[Pose2, ...]) -> bool:
        """Whether the marker may be visible from one of the poses; True if the camera or the marker is unknown."""
        camera, marker = self.problem.robot.camera, self.scene.dock.marker_in_world
        if camera is None or marker is None:
            return True
        seen = camera.points_seen(np.array([place.as_array() for place in places]), marker)
        return bool(np.any(camera.margins(seen).smallest > -3.0 * self.perception.sigma[0]))

    def has_arrived_at(self, places: tuple[Pose2, ...], *, is_undocking: bool = False) -> bool:
        """Whether the robot is at one of the poses in the fixed frame; undocking has separate tolerances."""
        settings, gaps = self.settings, [self.perception.robot.in_frame_of(place) for place in places]
        undocked = settings.undock_linear_tolerance, settings.undock_angular_tolerance
        distance, turn = undocked if is_undocking else _ARRIVED
        return any(math.hypot(gap.x, gap.y) <= distance and abs(gap.yaw) <= turn for gap in gaps)

    def require_arrival(self, places: tuple[Pose2, ...], *, is_undocking: bool) -> None:
        """Check that an undocked robot is at one of the poses; other drives are not checked.

        Raises:
            Interrupted: If an undocked robot is at none of the poses.
        """
        if is_undocking and not self.has_arrived_at(places, is_undocking=True):
            gaps = [self.perception.robot.distance_to(place) for place in places]
            raise Interrupted("staging pose missed", f"undocked {min(gaps):.3f} m from it")
