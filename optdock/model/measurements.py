"""What a robot measures while it docks, as the executor receives it."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from optdock.geometry.pose import Pose2, Twist2

if TYPE_CHECKING:
    from optdock.model.costmap import Costmap

__all__ = ["AtDock", "Detection", "Measurements", "OdometryPose"]


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


class OdometryPose(NamedTuple):
    """Where the robot is by its wheels alone.

    Attributes:
        stamp: When it was measured [s], on the clock of the measurements; it may arrive later.
        pose: In a frame of its own, which drifts but never jumps: REP 105's `odom`.
    """

    stamp: float
    pose: Pose2


class Measurements(NamedTuple):
    """All that arrived since the last control cycle.

    Attributes:
        stamp: Of the control cycle [s], on a monotonic clock.
        pose: Of the robot in the fixed frame; None where localization has nothing new.
        twist: Body velocity of the odometry, for control. Without `odometry` the way of the robot is its integral,
            which is wrong by the way driven in half the window that a velocity is averaged over.
        detections: New ones, in any order.
        contact: What an external switch or charger says; None where there is none.
        costmap: A new picture of the surroundings; None where it has not changed.
        odometry: The newest pose of the odometry; None where there is none.
        pose_stamp: When `pose` was measured [s]; None: at `stamp`.
        held: Whether the robot must stand, as after an emergency stop; the task goes on when it is released.
        current: Into the battery [A], negative where it is discharged; None where nothing tells.
    """

    stamp: float
    pose: Pose2 | None
    twist: Twist2 = Twist2()
    detections: tuple[Detection, ...] = ()
    contact: bool | None = None
    costmap: Costmap | None = None
    odometry: OdometryPose | None = None
    pose_stamp: float | None = None
    held: bool = False
    current: float | None = None


class AtDock(NamedTuple):
    """The input of a dock type in a control cycle.

    Attributes:
        stamp: Of the cycle [s], on a clock that never goes back.
        measurements: Of the cycle; their detections are those that the dock type has chosen.
        commanded: The last command.
        robot: Where the robot is believed to be, seen from the docked pose.
        is_near: Whether it is as near to the docked pose as contact is possible.
    """

    stamp: float
    measurements: Measurements
    commanded: Twist2
    robot: Pose2
    is_near: bool
