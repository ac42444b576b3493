"""Settings of the executor: times, distances and sensors, with Nav2's names and default values where they exist."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, ValidationError

from optdock.plugins.parameters import PluginParameters, invalid_parameters

__all__ = ["ExecutorSettings"]


class ExecutorSettings(PluginParameters):
    """Parameters of a `DockingExecutor`; every time is measured on the clock of the measurements.

    Raises:
        InvalidValue: If a parameter is unknown, of the wrong type or out of range.
    """

    def __init__(self, **values: object) -> None:
        try:
            super().__init__(**values)
        except ValidationError as error:
            raise invalid_parameters(error, type(self), type(self).__name__) from error

    # Docked.
    contact: Literal["distance", "touch"] = Field(
        default="distance",
        description="distance: docked by the goal checker; touch: docked by contact, for which the robot presses on",
    )
    wait_for_charge: bool = Field(default=False, description="docked only with the external signal of the charger")
    wait_charge_timeout: float = Field(default=5.0, gt=0.0, description="timeout of the wait for the signal [s]")
    contact_range: float = Field(
        default=0.05, gt=0.0, description="distance from the dock within which stall and signal are contact [m]"
    )
    contact_speed: float = Field(default=0.03, gt=0.0, description="speed of pressing towards contact [m/s]")
    contact_overrun: float = Field(
        default=0.03, ge=0.0, description="largest distance of pressing beyond the docked pose [m]"
    )
    stall_speed: float = Field(default=0.005, gt=0.0, description="odometry speed below which the robot stalls [m/s]")
    stall_time: float = Field(default=0.4, gt=0.0, description="duration of a stall that is contact [s]")

    timeout: float | None = Field(default=None, gt=0.0, description="timeout of the whole task [s]; None: no timeout")

    # Staging and retries.
    navigate_to_staging_pose: bool = Field(default=True, description="drive to a staging pose first if it is far away")
    staging_distance: float | None = Field(
        default=None,
        gt=0.0,
        description="distance of the staging pose from the docked pose, on its axis [m]; None: as the curvature "
        "requires, >= 0.7",
    )
    prestaging_tolerance: float = Field(
        default=0.5, gt=0.0, description="no staging if the staging pose is closer, in Nav2's norm over m, m and rad"
    )
    max_retries: int = Field(default=3, ge=0, description="approaches after the first one")
    max_staging_time: float = Field(default=1000.0, gt=0.0, description="timeout of the drive to the staging pose [s]")
    dock_approach_timeout: float = Field(
        default=30.0, gt=0.0, description="time that an approach may take beyond its plan [s]"
    )
    max_undocking_time: float = Field(default=30.0, gt=0.0, description="largest time of undocking beyond its plan [s]")
    undock_linear_tolerance: float = Field(
        default=0.05, gt=0.0, description="largest distance from the staging pose of an undocked robot [m]"
    )
    undock_angular_tolerance: float = Field(
        default=0.05, gt=0.0, description="largest heading error at the staging pose of an undocked robot [rad]"
    )
    back_out_speed: float = Field(
        default=0.1, gt=0.0, description="speed of backing straight out of contact, above the dead bands [m/s]"
    )
    back_out_distance: float = Field(
        default=0.1, gt=0.0, description="largest straight distance out of contact before a path back is planned [m]"
    )

    # Perception of the dock.
    use_detections: bool = Field(default=True, description="use detections of the dock; False: the stored dock")
    initial_perception_timeout: float = Field(
        default=5.0, gt=0.0, description="timeout of the first detections, at rest [s]"
    )
    least_detections: int = Field(default=3, ge=1, description="agreeing detections before the approach begins")
    detection_patience: float | None = Field(
        default=None,
        gt=0.0,
        description="largest age of the last detection in an approach [s]; None: as long as odometry stays accurate "
        "enough for the dock",
    )
    detection_blind_distance: float = Field(
        default=0.0, ge=0.0, description="distance from the dock within which no detection is expected [m]"
    )
    max_detection_offset: float = Field(
        default=0.25, gt=0.0, description="first detections farther than this from the stored dock are not used [m]"
    )
    dock_confirmations: int = Field(
        default=3, ge=2, description="agreeing rejected detections that move the dock; one fewer if they agree closely"
    )
    detection_delay_sigma: float = Field(
        default=0.05,
        ge=0.0,
        description="standard deviation of the delay of the detections' stamps, which is estimated [s]",
    )
    stored_position_sigma: float = Field(
        default=0.1, gt=0.0, description="standard deviation of the stored dock's x and y, each [m]"
    )
    stored_yaw_sigma: float = Field(
        default=0.06, gt=0.0, description="standard deviation of the stored dock's yaw [rad]"
    )
    dock_drift: float = Field(default=0.0005, ge=0.0, description="random walk of a moving dock [m/sqrt(s)]")

    # Perception of the robot.
    position_sigma: float = Field(
        default=0.005, gt=0.0, description="standard deviation of the measured x and y, each [m]"
    )
    yaw_sigma: float = Field(default=0.009, gt=0.0, description="standard deviation of the measured yaw [rad]")
    odometry_sigma: float = Field(
        default=0.005, gt=0.0, description="standard deviation of odometry per distance [m/sqrt(m)]"
    )
    odometry_yaw_sigma: float = Field(
        default=0.02, gt=0.0, description="standard deviation of the odometry's yaw per rotation [rad/sqrt(rad)]"
    )
    odometry_straight_yaw_sigma: float = Field(
        default=0.008,
        gt=0.0,
        description="standard deviation of the odometry's yaw per distance, with small wheel slips [rad/sqrt(m)]",
    )
    odometry_scale_sigma: float = Field(
        default=0.003, ge=0.0, description="standard deviation of the systematic distance error, which is estimated [1]"
    )
    odometry_drift_sigma: float = Field(
        default=0.005,
        ge=0.0,
        description="standard deviation of the systematic rotation per distance, which is estimated [rad/m]",
    )
    pose_patience: float = Field(default=0.5, gt=0.0, description="time for which odometry replaces the pose [s]")
    localization_timeout: float = Field(default=5.0, gt=0.0, description="timeout of a wait for a pose, at rest [s]")

    # Surroundings, progress, clock.
    costmap_patience: float | None = Field(
        default=None, gt=0.0, description="age of the costmap at which the robot stops [s]; None: no limit"
    )
    costmap_timeout: float = Field(default=5.0, gt=0.0, description="timeout of a wait for a costmap, at rest [s]")
    contact_margin: float = Field(
        default=0.05,
        ge=0.0,
        description="distance from the touching edge of the docked robot within which costmap cells are freed [m]",
    )
    obstacle_patience: float = Field(
        default=5.0, ge=0.0, description="timeout of the wait for an obstacle to move away, at rest [s]"
    )
    progress_time: float = Field(
        default=3.0, gt=0.0, description="largest time of commanded motion without progress [s]"
    )
    settling_time: float = Field(default=2.0, gt=0.0, description="time to dock after the end of the path [s]")
    late_tick: float = Field(default=0.08, gt=0.0, description="period above which a cycle is reported as late [s]")
    longest_tick: float = Field(
        default=0.5, gt=0.0, description="period above which the robot stops before it continues [s]"
    )

    # Planning.
    time_budget: float = Field(
        default=1.0,
        gt=0.0,
        description="wall-clock time of a plan from rest [s]; doubled, up to 8 times, while plans run out of it",
    )
    replan_budget: float = Field(default=0.02, gt=0.0, description="wall-clock time of a plan in motion [s]")
    replanning: bool = Field(default=True, description="plan in motion if the dock has moved")
    replan_pause: float = Field(default=0.2, ge=0.0, description="least time between two plans in motion [s]")
    worth_position: float = Field(
        default=0.002, gt=0.0, description="remaining error at the dock that justifies a plan in motion [m]"
    )
    worth_yaw: float = Field(
        default=0.009, gt=0.0, description="remaining heading error at the dock that justifies a plan in motion [rad]"
    )
