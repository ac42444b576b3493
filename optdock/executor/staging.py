"""Where approaches begin, and from where the dock may be seen."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from optdock.executor.approach import staging_distance
from optdock.geometry.pose import Pose2

if TYPE_CHECKING:
    from optdock.executor.checked_dock_type import CheckedDockType
    from optdock.executor.dock_estimate import DockEstimate
    from optdock.executor.planning_scene import PlanningScene

__all__ = ["StagingPoses"]

_ARRIVED = 0.05, 0.05  # [m], [rad] from the staging pose: Nav2's undock_linear_tolerance and undock_angular_tolerance


class StagingPoses:
    """The staging poses of the dock where it is seen.

    Args:
        dock_type: Says where they are relative to the dock.
        estimate: Says in which gear the dock is entered.
        scene: Says where the dock is.
    """

    def __init__(self, dock_type: CheckedDockType, estimate: DockEstimate, scene: PlanningScene) -> None:
        self.dock_type, self.estimate, self.scene = dock_type, estimate, scene
        self.problem, self.settings, self.perception = scene.problem, scene.settings, scene.perception

    def poses(self) -> tuple[Pose2, ...]:
        """Where an approach may begin, in the fixed frame, the preferred one first."""
        distance = self.settings.staging_distance or staging_distance(self.problem)
        return tuple(self.perception.dock @ pose for pose in self.dock_type.staging_poses(self.estimate.gear, distance))

    def distance_to_nearest(self) -> float:
        """Nav2's norm of the way to the nearest staging pose, metres and radians mixed."""
        gaps = [self.perception.robot.in_frame_of(place) for place in self.poses()]
        return min(math.sqrt(gap.x**2 + gap.y**2 + gap.yaw**2) for gap in gaps)

    def turned_round(self) -> tuple[Pose2, ...]:
        """The staging poses turned round: from where a camera sees a dock that is entered the other way."""
        return tuple(place @ Pose2(0.0, 0.0, math.pi) for place in self.poses())

    def may_see_dock_from(self, places: tuple[Pose2, ...]) -> bool:
        """Whether the marker may be in the camera's view from one of some poses; True where either is not known."""
        camera, marker = self.problem.robot.camera, self.scene.dock.marker_in_world
        if camera is None or marker is None:
            return True
        seen = camera.points_seen(np.array([place.as_array() for place in places]), marker)
        return bool(np.any(camera.margins(seen).smallest > -3.0 * self.perception.sigma[0]))

    def has_arrived_at(self, places: tuple[Pose2, ...]) -> bool:
        """Whether the robot is at one of some poses in the fixed frame."""
        gaps = [self.perception.robot.in_frame_of(place) for place in places]
        return any(math.hypot(gap.x, gap.y) <= _ARRIVED[0] and abs(gap.yaw) <= _ARRIVED[1] for gap in gaps)
