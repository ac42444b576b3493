"""Steps 1 to 4 of the dock planner: sizes, the approach axis, the gear, the threshold angle.

F ------ mid ------ C ------ G      the axis runs from the goal G away from the dock
         D
         A                          start A, its foot D
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.errors import NoValidPathCouldBeFound
from optdock.geometry.arrays import FrozenArrays
from optdock.model.dock import DockDirection
from optdock.model.path import Direction

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from optdock.geometry.footprint import Footprint
    from optdock.geometry.pose import Pose2
    from optdock.planners.dock_parameters import DockPlannerParameters

__all__ = ["ApproachAxis", "DockGeometry", "approach_axis"]

_SAME_POSITION = 1e-9  # [m]


class DockGeometry(NamedTuple):
    """Sizes that the planner reads from the outlines [m].

    `robot_length` and `dock_length` are extents along x, `robot_radius` is the circumscribed radius. A dock without
    an outline has length 0: the point before the dock is then half a robot away from the goal.
    """

    robot_length: float
    robot_radius: float
    dock_length: float = 0.0

    @classmethod
    def from_footprints(cls, robot: Footprint, dock: Footprint | None = None) -> DockGeometry:
        """Sizes of two outlines; no dock means a dock of length 0."""
        return cls(robot.length, robot.circumscribed_radius, 0.0 if dock is None else dock.length)


@dataclass(frozen=True, eq=False)
class ApproachAxis(FrozenArrays):
    """The line on which the robot enters the dock, and where the start lies beside it.

    Args:
        goal: Position G, Shape (2,) [m].
        outward: Unit vector from G away from the dock, Shape (2,).
        direction: Gear of the last motion.
        distance_min_c: From G to C [m].
        along: From G to D [m].
        distance_ad: From the start to the axis [m].
        safety_distance: Twice the padded radius of the robot [m].
        angle_threshold: Smallest interior angle at which segment 1 may turn onto the axis [rad].
    """

    goal: FloatArray
    outward: FloatArray
    direction: Direction
    distance_min_c: float
    along: float
    distance_ad: float
    safety_distance: float
    angle_threshold: float

    @property
    def t(self) -> float:
        """The start's coordinate along the axis in units of the distance from G to C."""
        return self.along / self.distance_min_c

    @property
    def distance_cd(self) -> float:
        """From C to D [m]."""
        return self.along - self.distance_min_c

    @property
    def distance_df(self) -> float:
        """From D to F [m], which the source does not give: the safety distance, or the start's distance if longer.

        It leaves room for the turn away from the dock (`dir` -1) up to about 0.6 safety distances beside the axis. From
        further aside the arc no longer fits before F, and where it does not fit before C either a corner is left.
        """
        return max(self.safety_distance, self.distance_ad)

    def point_at(self, distance: float) -> FloatArray:
        """The point of the axis at `distance` [m] from G. Shape (2,) [m]."""
        return self.goal + distance * self.outward

    @property
    def point_c(self) -> FloatArray:
        """The point before the dock, Shape (2,) [m]."""
        return self.point_at(self.distance_min_c)

    @property
    def point_d(self) -> FloatArray:
        """The foot of the perpendicular from the start, Shape (2,) [m]."""
        return self.point_at(self.along)

    @property
    def point_f(self) -> FloatArray:
        """The far end of the centreline, Shape (2,) [m]."""
        return self.point_at(self.distance_min_c + self.distance_cd + self.distance_df)


def approach_axis(start: Pose2, goal: Pose2, geometry: DockGeometry, parameters: DockPlannerParameters) -> ApproachAxis:
    """The axis of a docking manoeuvre, on the side of the goal from which the robot comes.

    Args:
        start: Pose A; its yaw plays no part.
        goal: Pose of the robot when docked.
        geometry: Sizes of robot and dock.
        parameters: `calib_safety_distance`, `alpha`, `beta`, `gamma` and `direction` are read.

    Raises:
        NoValidPathCouldBeFound: The robot has no length or no safety distance, the start is not beyond C, or it lies
            on the side that `direction` forbids.
    """
    safety_distance = 2.0 * (geometry.robot_radius + parameters.calib_safety_distance)
    _check_geometry(geometry, safety_distance)
    distance_min_c = 0.5 * (geometry.robot_length + geometry.dock_length)
    heading = np.array([math.cos(goal.yaw), math.sin(goal.yaw)])
    from_goal = np.array([start.x - goal.x, start.y - goal.y])
    ahead = float(from_goal @ heading)
    # The robot comes from behind the docked pose when it drives in forward.
    direction = Direction.REVERSE if ahead > 0.0 else Direction.FORWARD
    _check_direction(direction, parameters.direction, ahead)
    along = abs(ahead)
    if not along > distance_min_c + _SAME_POSITION:
        raise _not_beyond_c(along, distance_min_c)
    distance_ad = abs(float(heading[0] * from_goal[1] - heading[1] * from_goal[0]))
    return ApproachAxis(
        goal=np.array([goal.x, goal.y]),
        outward=-int(direction) * heading,
        direction=direction,
        distance_min_c=distance_min_c,
        along=along,
        distance_ad=distance_ad,
        safety_distance=safety_distance,
        angle_threshold=_angle_threshold(distance_ad, safety_distance, parameters),
    )


def _check_geometry(geometry: DockGeometry, safety_distance: float) -> None:
    if not geometry.robot_length > 0.0:
        raise NoValidPathCouldBeFound(
            f"dock planner: the robot's length must be > 0 m, got {geometry.robot_length:.6g} m; "
            "check the robot's footprint",
            where={"step": "geometry", "robot_length": geometry.robot_length},
        )
    if not safety_distance > 0.0:
        raise NoValidPathCouldBeFound(
            "dock planner: the safety distance, 2 * (robot radius + calib_safety_distance), must be > 0 m, got "
            f"{safety_distance:.6g} m with a radius of {geometry.robot_radius:.6g} m; raise calib_safety_distance",
            where={"step": "geometry", "safety_distance": safety_distance},
        )


def _check_direction(direction: Direction, wanted: DockDirection, ahead: float) -> None:
    found = DockDirection.FORWARD if direction is Direction.FORWARD else DockDirection.BACKWARD
    if wanted in (DockDirection.AUTO, found):
        return
    side = "in front of" if ahead > 0.0 else "behind"
    raise NoValidPathCouldBeFound(
        f"dock planner: the start is {round(abs(ahead), 3):g} m {side} the docked robot, so it can only dock "
        f"{found.value}, but direction is {wanted.value}; start from the other side, or set direction to auto",
        where={"step": "direction", "wanted": wanted.value, "possible": found.value, "ahead": ahead},
    )


def _not_beyond_c(along: float, distance_min_c: float) -> NoValidPathCouldBeFound:
    return NoValidPathCouldBeFound(
        f"dock planner: the start is {round(along, 3):g} m from the docked pose along the axis of the dock, and must "
        f"be more than {round(distance_min_c, 3):g} m from it, half the lengths of robot and dock; start farther out "
        "along the axis",
        where={"step": "beyond_c", "along": along, "distance_min_c": distance_min_c, "t": along / distance_min_c},
    )


def _angle_threshold(distance_ad: float, safety_distance: float, parameters: DockPlannerParameters) -> float:
    scale = distance_ad / (distance_ad + safety_distance)
    return min((parameters.alpha + abs(scale)) * parameters.beta * math.pi, parameters.gamma * math.pi)
