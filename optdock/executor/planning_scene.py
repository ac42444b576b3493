"""What stands around the robot by map, costmap and the dock as it is seen, and the planning problems among that."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

import numpy as np

from optdock.executor.contact_zone import with_contact_zone
from optdock.geometry.obstacles import ObstacleSet
from optdock.model.cell_obstacles import obstacles_from_costmap
from optdock.model.dock import Dock
from optdock.model.problem import ClearanceRule

if TYPE_CHECKING:
    from optdock.executor.executor_settings import ExecutorSettings
    from optdock.executor.perception import Perception
    from optdock.geometry.pose import Pose2
    from optdock.model.costmap import Costmap
    from optdock.model.problem import DockingProblem

__all__ = ["AT_A_STAND", "PlanningScene"]

_SAME_DOCK = 0.01  # [m], [rad]: a dock that is seen elsewhere by less stands in the same cells
AT_A_STAND: dict[str, Any] = {"start_speed": 0.0, "start_acceleration": 0.0, "start_curvature": None}


class PlanningScene:
    """Obstacles and planning problems, from the newest costmap and the newest pose of the dock.

    Args:
        problem: Robot, dock as stored, obstacles, clearance; its start plays no part.
        settings: How wide the zone of contact is.
        perception: Brought up to date before every cycle.
    """

    def __init__(self, problem: DockingProblem, settings: ExecutorSettings, perception: Perception) -> None:
        self.problem, self.settings, self.perception = problem, settings, perception
        self._cleared: tuple[Costmap | None, Costmap | None, Pose2] = (None, None, problem.goal)

    @property
    def dock(self) -> Dock:
        """The dock where it is seen."""
        return dataclasses.replace(self.problem.dock, pose=self.perception.dock)

    @property
    def costmap(self) -> Costmap | None:
        """The newest picture of the surroundings, without what it shows of the station where the docked robot touches.

        A station that scanners see stands a cell or two too fat in it.
        """
        seen, dock = self.perception.costmap or self.problem.costmap, self.perception.dock
        if seen is None:
            return None
        known, cleared, place = self._cleared
        if seen is not known or dock.gap_to(place) > _SAME_DOCK:
            cleared = with_contact_zone(
                seen,
                self.dock,
                self.problem.robot.footprint,
                self.settings.contact_margin,
            )
            self._cleared = seen, cleared, dock
        return cleared

    @property
    def station(self) -> ObstacleSet:
        """The station where the dock is seen."""
        station = self.problem.dock.footprint
        return (
            ObstacleSet.empty()
            if station is None
            else ObstacleSet.from_footprint(station, self.perception.dock, "dock")
        )

    def near(self, robot: Pose2, reach: float, *, with_station: bool = True) -> ObstacleSet:
        """Whatever stands within reach of a pose, the station included or not."""
        centre = np.array([robot.x, robot.y])
        found = self.problem.obstacles.in_box(centre - reach, centre + reach)
        if with_station:
            found += self.station
        costmap = self.costmap
        if costmap is None:
            return found
        return found + obstacles_from_costmap(costmap, region=(centre - reach, centre + reach))

    def to_dock(self) -> DockingProblem:
        """From where the robot is to where the dock is seen."""
        return dataclasses.replace(
            self.problem,
            start=self.perception.robot,
            dock=self.dock,
            costmap=self.costmap,
            **AT_A_STAND,
        )

    def to(self, place: Pose2) -> DockingProblem:
        """From where the robot is to a place before the dock, among everything and the station.

        There is nothing to be touched at that place: the whole clearance is kept up to it.
        """
        kept = self.problem.clearance.required
        return dataclasses.replace(
            self.problem,
            start=self.perception.robot,
            dock=Dock(place),
            obstacles=self.problem.obstacles + self.station,
            clearance=ClearanceRule(kept, kept, 0.0),
            costmap=self.costmap,
            **AT_A_STAND,
        )
