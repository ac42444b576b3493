"""What a robot measures while it docks, as it reaches whoever steers it."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from optdock.geometry.pose import Pose2, Twist2

if TYPE_CHECKING:
    from optdock.costmap.costmap import Costmap

__all__ = ["Detection", "Measurements"]


class Detection(NamedTuple):
    """Where a detector saw the dock.

    Attributes:
        stamp: When the picture was taken [s], on the clock of the measurements; it arrives later.
        pose: Of the docked robot, which is what `Dock.pose` says, seen from the robot at `stamp`.
        position_sigma: Standard deviation of its x and y, each [m].
        yaw_sigma: Standard deviation of its yaw [rad].
    """

    stamp: float
    pose: Pose2
    position_sigma: float
    yaw_sigma: float


class Measurements(NamedTuple):
    """All that arrived since the last control cycle.

    Attributes:
        stamp: When pose and twist were measured [s], on a monotonic clock.
        pose: Of the robot in the fixed frame; None where localization has none.
        twist: Body velocity of the odometry.
        detections: New ones, the oldest first.
        contact: What an external switch or charger says; None where there is none.
        costmap: A new picture of the surroundings; None where it has not changed.
    """

    stamp: float
    pose: Pose2 | None
    twist: Twist2 = Twist2()
    detections: tuple[Detection, ...] = ()
    contact: bool | None = None
    costmap: Costmap | None = None
