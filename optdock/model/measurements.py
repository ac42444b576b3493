"""Measurements of a robot during docking, the input of the executor."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from optdock.geometry.pose import Pose2, Twist2

if TYPE_CHECKING:
    from optdock.model.costmap import Costmap

__all__ = ["AtDock", "Detection", "Measurements", "OdometryPose"]


class Detection(NamedTuple):
    """A detection of the dock.

    Attributes:
        stamp: Time of the exposure [s], on the clock of the measurements; earlier than the arrival of the detection.
        pose: Docked pose (see `Dock.pose`) in the robot frame at `stamp`.
        position_sigma: Standard deviation of x and of y [m].
        yaw_sigma: Standard deviation of the yaw [rad].
    """

    stamp: float
    pose: Pose2
    position_sigma: float
    yaw_sigma: float


class OdometryPose(NamedTuple):
    """Pose of the robot according to wheel odometry.

    Attributes:
        stamp: Time of the measurement [s], on the clock of the measurements; may be earlier than the arrival of the
            pose.
        pose: Pose in a continuous frame that drifts, `odom` in REP 105.
    """

    stamp: float
    pose: Pose2


class Measurements(NamedTuple):
    """Measurements that arrived since the last control cycle.

    Attributes:
        stamp: Time of the control cycle [s], on a monotonic clock.
        pose: Pose of the robot in the fixed frame; None if localization has no new pose.
        twist: Body velocity from odometry, for control. Without `odometry` the motion of the robot is computed as the
            integral of `twist`, with an error equal to the distance driven in half the averaging window of the
            velocity.
        detections: New detections, in any order.
        contact: State of an external contact switch or charger; None without such a signal.
        costmap: New costmap of the surroundings; None if unchanged.
        odometry: Latest odometry pose; None without odometry poses.
        pose_stamp: Time of `pose` [s]; None means `stamp`.
        held: Whether the robot must stay at rest, e.g. after an emergency stop; the task continues when the robot is
            released.
        current: Current into the battery [A], negative while discharging; None if not measured.
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
    """Input of a dock type for one control cycle.

    Attributes:
        stamp: Time of the cycle [s], on a monotonic clock.
        measurements: Measurements of the cycle, with the detections that the dock type selected.
        commanded: The last command.
        robot: Estimated pose of the robot relative to the docked pose.
        is_near: Whether the robot is close enough to the docked pose for contact.
    """

    stamp: float
    measurements: Measurements
    commanded: Twist2
    robot: Pose2
    is_near: bool
