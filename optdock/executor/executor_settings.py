"""How a docking is to be carried out: times, distances, sensors. Nav2's names and values where Nav2 has them."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, ValidationError

from optdock.plugins.parameters import PluginParameters, invalid_parameters

__all__ = ["ExecutorSettings"]


class ExecutorSettings(PluginParameters):
    """Parameters of a `DockingExecutor`; every time is measured on the clock of the measurements.

    Raises:
        InvalidValue: A parameter is unknown, of the wrong type or out of range.
    """

    def __init__(self, **values: object) -> None:
        try:
            super().__init__(**values)
        except ValidationError as error:
            raise invalid_parameters(error, type(self), type(self).__name__) from error

    # What counts as docked.
    contact: Literal["distance", "touch"] = Field(
        default="distance",
        description="distance: docked where the goal checker says so; touch: the robot presses on until it is felt",
    )
    wait_for_charge: bool = Field(default=False, description="docked is not enough: the external signal must come")
    wait_charge_timeout: float = Field(default=5.0, gt=0.0, description="how long to wait for that signal [s]")
    contact_range: float = Field(
        default=0.05, gt=0.0, description="farther from the dock neither stall nor signal mean contact [m]"
    )
    contact_speed: float = Field(default=0.03, gt=0.0, description="speed while pressing on towards contact [m/s]")
    contact_overrun: float = Field(default=0.03, ge=0.0, description="how far beyond the docked pose to press on [m]")
    stall_speed: float = Field(default=0.005, gt=0.0, description="slower than this by odometry is standing [m/s]")
    stall_time: float = Field(default=0.4, gt=0.0, description="no motion against a command for so long is a stall [s]")

    timeout: float | None = Field(default=None, gt=0.0, description="of the whole task [s]; None: none")

    # Staging and retries.
    navigate_to_staging_pose: bool = Field(default=True, description="drive there first where the robot is far from it")
    staging_distance: float | None = Field(
        default=None,
        gt=0.0,
        description="of the staging pose from the docked one, on its axis [m]; None: what the curvature needs, >= 0.7",
    )
    prestaging_tolerance: float = Field(
        default=0.5, gt=0.0, description="no staging within this of it: one norm over m, m, rad, as Nav2's"
    )
    max_retries: int = Field(default=3, ge=0, description="approaches after the first one")
    max_staging_time: float = Field(default=1000.0, gt=0.0, description="drive to the staging pose [s]")
    dock_approach_timeout: float = Field(
        default=30.0, gt=0.0, description="an approach may take so much longer than its plan [s]"
    )
    max_undocking_time: float = Field(default=30.0, gt=0.0, description="as above, for the way out [s]")
    back_out_distance: float = Field(
        default=0.1, gt=0.0, description="straight out of contact at most, before a way back is planned [m]"
    )

    # Perception of the dock.
    use_detections: bool = Field(default=True, description="the dock is where it is seen; False: where it is stored")
    initial_perception_timeout: float = Field(default=5.0, gt=0.0, description="for the first detections, at rest [s]")
    least_detections: int = Field(default=3, ge=1, description="that must agree before the approach begins")
    detection_patience: float | None = Field(
        default=None,
        gt=0.0,
        description="the approach goes on so long without a detection [s]; None: as long as the robot will know at the "
        "dock, by odometry, whether it stands in it",
    )
    detection_blind_distance: float = Field(
        default=0.0, ge=0.0, description="nearer than this to the dock no detection is waited for [m]"
    )
    max_detection_offset: float = Field(
        default=0.25, gt=0.0, description="a first detection farther than this from the stored dock is another dock [m]"
    )
    dock_confirmations: int = Field(
        default=3, ge=2, description="rejected detections that agree until they are believed, one fewer if closely"
    )
    detection_delay_sigma: float = Field(
        default=0.05, ge=0.0, description="of an unknown delay of the detections' stamps, which is learned [s]"
    )
    stored_position_sigma: float = Field(default=0.1, gt=0.0, description="of the stored dock's x and y, each [m]")
    stored_yaw_sigma: float = Field(default=0.06, gt=0.0, description="of the stored dock's yaw [rad]")
    dock_drift: float = Field(default=0.0005, ge=0.0, description="random walk of a dock that moves [m/sqrt(s)]")

    # Perception of the robot.
    position_sigma: float = Field(default=0.005, gt=0.0, description="of the measured x and y, each [m]")
    yaw_sigma: float = Field(default=0.009, gt=0.0, description="of the measured yaw [rad]")
    odometry_sigma: float = Field(default=0.005, gt=0.0, description="of odometry per way driven [m/sqrt(m)]")
    odometry_yaw_sigma: float = Field(default=0.02, gt=0.0, description="of its yaw per turn [rad/sqrt(rad)]")
    odometry_straight_yaw_sigma: float = Field(
        default=0.008, gt=0.0, description="of its yaw per way driven; small slips of the wheels included [rad/sqrt(m)]"
    )
    odometry_scale_sigma: float = Field(
        default=0.003, ge=0.0, description="of a systematic error of the way driven, which is learned [1]"
    )
    odometry_drift_sigma: float = Field(
        default=0.005, ge=0.0, description="of a systematic turn per way driven, which is learned [rad/m]"
    )
    pose_patience: float = Field(default=0.5, gt=0.0, description="odometry alone steers for so long [s]")
    localization_timeout: float = Field(default=5.0, gt=0.0, description="at rest without a pose for so long: end [s]")

    # Surroundings, progress, clock.
    costmap_patience: float | None = Field(
        default=None,
        gt=0.0,
        description="surroundings older than this stop the robot [s]; None: they may stay the same",
    )
    costmap_timeout: float = Field(default=5.0, gt=0.0, description="at rest without newer ones for so long: end [s]")
    contact_margin: float = Field(
        default=0.05,
        ge=0.0,
        description="cells of a costmap this near to the edge of the docked robot that touches are the station's [m]",
    )
    obstacle_patience: float = Field(
        default=5.0, ge=0.0, description="at rest before an obstacle that nothing leads around [s]"
    )
    progress_time: float = Field(default=3.0, gt=0.0, description="commanded to move and not moving for so long [s]")
    settling_time: float = Field(default=2.0, gt=0.0, description="at the end of the path, until docked [s]")
    late_tick: float = Field(default=0.08, gt=0.0, description="a longer period is said in the log [s]")
    longest_tick: float = Field(default=0.5, gt=0.0, description="after a longer period the robot stops first [s]")

    # Planning.
    time_budget: float = Field(default=1.0, gt=0.0, description="wall clock of a plan made at rest [s]")
    replan_budget: float = Field(default=0.02, gt=0.0, description="wall clock of a plan made in motion [s]")
    replanning: bool = Field(default=True, description="plan again in motion for a dock that is elsewhere")
    replan_pause: float = Field(default=0.2, ge=0.0, description="least time between two plans in motion [s]")
    worth_position: float = Field(
        default=0.002, gt=0.0, description="error left at the dock that is worth a plan in motion [m]"
    )
    worth_yaw: float = Field(default=0.009, gt=0.0, description="as above, of the heading [rad]")
