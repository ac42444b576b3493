"""The parameters of the simulated robot, and the simulated world that they describe."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from optdock import simulation
from optdock.config import load_scenario
from optdock.errors import InvalidValue
from optdock.geometry.checked import finite_number, instance
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2
from optdock.model.dock import DockDirection
from optdock.plugins.parameters import closest
from optdock.ros.transforms import quaternion_product

if TYPE_CHECKING:
    from collections.abc import Mapping

    from optdock.model.problem import DockingProblem
    from optdock.ros.transforms import Quaternion as Rotation

__all__ = ["PARAMETERS", "SimulationParameters", "about_z"]

BAY = Path(__file__).with_name("simulated_bay.yaml")
PARAMETERS: dict[str, tuple[object, str]] = {
    "scenario": ("", "scenario file with robot, dock, obstacles, start; empty: the bay of this package"),
    "start": ([], "start pose of the robot in the map; empty: that of the scenario [m, m, rad]"),
    "dock_offset": ([0.0, 0.0, 0.0], "true pose of the dock relative to the pose in the scenario [m, m, rad]"),
    "seed": (0, "seed of the noise"),
    "rate": (100.0, "rate of the simulation steps [Hz]"),
    "speed": (0.0, "speed of the published /clock; 0: real time by the system clock [1]"),
    "map_frame": ("map", "frame of the localization, the scenario and the true pose"),
    "odom_frame": ("odom", "frame of odometry and costmap"),
    "base_frame": ("base_link", "frame of the robot"),
    "enable_stamped_cmd_vel": (True, "cmd_vel is a TwistStamped; false: a Twist"),
    "command_timeout": (0.25, "time without commands after which the base stops [s]"),
    "actuation.linear_lag": (0.1, "time constant of the speed [s]"),
    "actuation.angular_lag": (0.1, "time constant of the yaw rate [s]"),
    "actuation.latency": (0.06, "dead time between a command and its first effect [s]"),
    "actuation.linear_dead_band": (0.0, "speed below which commands have no effect [m/s]"),
    "actuation.angular_dead_band": (0.0, "yaw rate below which commands have no effect [rad/s]"),
    "odometry.rate": (50.0, "rate of odom, odom -> base_link and joint_states [Hz]"),
    "odometry.linear_gain": (1.0, "ratio of measured to true speed [1]"),
    "odometry.angular_gain": (1.0, "ratio of measured to true yaw rate [1]"),
    "odometry.linear_sigma": (0.002, "white noise of the speed [m/s]"),
    "odometry.angular_sigma": (0.002, "white noise of the yaw rate [rad/s]"),
    "localization.rate": (20.0, "rate of map -> odom [Hz]"),
    "localization.transform_tolerance": (0.1, "time by which map -> odom is stamped into the future, as by AMCL [s]"),
    "localization.position_sigma": (0.005, "white noise of x and y, each [m]"),
    "localization.yaw_sigma": (0.009, "white noise of yaw [rad]"),
    "detection.rate": (15.0, "rate of camera images; 0: no detector [Hz]"),
    "detection.latency": (0.06, "delay from an image to its message [s]"),
    "detection.position_sigma": (0.003, "white noise of the dock's x and y within `near`, each [m]"),
    "detection.yaw_sigma": (0.005, "white noise of the dock's yaw within `near` [rad]"),
    "detection.near": (1.0, "distance within which the sigmas are constant [m]"),
    "detection.growth": (1.0, "growth of both sigmas per metre beyond `near` [1/m]"),
    "detection.drop_out": (0.0, "probability of an image without a detection [1]"),
    "detection.field_of_view": (2.0, "horizontal angle of the camera [rad]"),
    "detection.max_range": (4.0, "largest distance of a detected marker [m]"),
    "camera.frame": ("camera_optical_frame", "frame of the camera: x right, y down, z forward"),
    "camera.pose": (
        [0.0, 0.0, 0.3],
        "x, y, z of the camera on the robot, which faces the direction of the approach [m]",
    ),
    "marker.distance": (
        0.2,
        "distance of the marker from the docked robot, into the dock: minus external_detection_translation_x [m]",
    ),
    "marker.height": (0.3, "height of the marker above the floor [m]"),
    "station.stops": (True, "whether the station blocks the robot at the docked pose"),
    "station.depth": (0.0, "distance by which the robot can be driven beyond the docked pose [m]"),
    "battery.charging_current": (2.0, "current while charging [A]"),
    "battery.idle_current": (-1.0, "current otherwise [A]"),
    "battery.delay": (0.5, "delay from contact to charging [s]"),
    "wheels.radius": (0.1, "radius of the wheels [m]"),
    "wheels.stall_effort": (5.0, "effort of a blocked wheel [N m]"),
    "costmap.rate": (5.0, "rate of the costmap; 0: no costmap [Hz]"),
    "costmap.size": (3.0, "side length of the costmap [m]"),
    "costmap.resolution": (0.05, "side length of a cell [m]"),
    "costmap.station": (True, "whether the costmap contains the station"),
    "faults.transforms": (False, "both transforms stop"),
    "faults.localization": (False, "map -> odom stops"),
    "faults.odometry": (False, "odom stops; the transforms continue"),
    "faults.detections": (False, "detections stop"),
    "faults.costmap": (False, "costmap and footprint stop"),
}
"""Name, default and description."""

POSITIVE = (
    "rate", "command_timeout", "odometry.rate", "localization.rate", "wheels.radius", "costmap.size",
    "costmap.resolution",
)  # fmt: skip
NOT_NEGATIVE = ("speed", "costmap.rate", "detection.rate", "battery.delay", "marker.distance")
OPTICAL = (-0.5, 0.5, -0.5, 0.5)  # z forward, x right, y down, seen from a frame with x forward, z up


@dataclass(frozen=True, eq=False)
class SimulationParameters:
    """All parameters, validated.

    Args:
        values: Values by the names of the parameters.

    Raises:
        OptdockError: If a parameter is invalid; the message names it.
    """

    values: Mapping[str, Any]

    def __post_init__(self) -> None:
        unknown = [name for name in self.values if name not in PARAMETERS]
        if unknown:
            raise InvalidValue("\n".join(f"{name}: no such parameter{closest(name, PARAMETERS)}" for name in unknown))
        for name, value in self.values.items():
            default = PARAMETERS[name][0]
            if isinstance(default, list):
                self.numbers(name)
            elif isinstance(default, float):
                number = finite_number(value, name)
                if name in POSITIVE and not number > 0.0:
                    raise InvalidValue(f"{name}: must be > 0, got {number}")
                if name in NOT_NEGATIVE and number < 0.0:
                    raise InvalidValue(f"{name}: must be >= 0, got {number}")
            else:
                instance(type(default), value, name)
        cells = self.values["costmap.size"] / self.values["costmap.resolution"]
        if not 2.0 <= cells <= 2000.0:
            raise InvalidValue(f"costmap.resolution: must divide {self.values['costmap.size']} m into 2 to 2000 cells")
        self.robot()

    def numbers(self, name: str) -> tuple[float, ...]:
        """Return three numbers, or no numbers if the default is empty."""
        found = tuple(finite_number(value, name) for value in self.values[name])
        if len(found) != 3 and not (len(found) == 0 and not PARAMETERS[name][0]):
            raise InvalidValue(f"{name}: must be three numbers, got {list(found)}")
        return found

    def block(self, name: str, *others: str) -> dict[str, Any]:
        """Return the parameters of a block, without `others`."""
        found = {key.partition(".")[2]: value for key, value in self.values.items() if key.startswith(f"{name}.")}
        return {key: value for key, value in found.items() if key not in others}

    @cached_property
    def problem(self) -> DockingProblem:
        """Problem of the scenario."""
        return load_scenario(self.values["scenario"] or BAY).problem

    @cached_property
    def gear(self) -> float:
        """Gear of the approach: 1 for forward, -1 for backward."""
        return -1.0 if self.problem.dock.direction is DockDirection.BACKWARD else 1.0

    @cached_property
    def approach_yaw(self) -> float:
        """Direction of the approach in the robot's frame [rad]."""
        return 0.0 if self.gear > 0.0 else math.pi

    @cached_property
    def dock(self) -> Pose2:
        """True docked pose of the robot."""
        return self.problem.goal @ Pose2(*self.numbers("dock_offset"))

    @cached_property
    def camera(self) -> tuple[tuple[float, float, float], Rotation]:
        """Position and orientation of the camera in the robot's frame."""
        x, y, z = self.numbers("camera.pose")
        return (x, y, z), quaternion_product(about_z(self.approach_yaw), OPTICAL)

    def robot(self) -> simulation.SimulatedRobot:
        """Return the robot at its start, at rest."""
        (x, y, _), values, problem = self.numbers("camera.pose"), self.values, self.problem
        detector = None
        if values["detection.rate"] > 0.0:
            detector = simulation.DockSensor(
                **self.block("detection"),
                camera=Pose2(x, y, self.approach_yaw),
                marker=Pose2(self.gear * values["marker.distance"], 0.0, 0.0),
            )
        direction = DockDirection.FORWARD if self.gear > 0.0 else DockDirection.BACKWARD
        station = simulation.Station(direction, values["station.depth"])
        return simulation.SimulatedRobot(
            simulation.plant_of(problem.robot, simulation.Actuation(**self.block("actuation"))),
            Pose2(*self.numbers("start")) if values["start"] else problem.start,
            self.dock,
            simulation.Sensors(
                simulation.PoseSensor(**self.block("localization", "rate", "transform_tolerance")),
                simulation.Odometry(**self.block("odometry", "rate")),
                detector,
            ),
            station=station if values["station.stops"] else None,
            seed=values["seed"],
        )

    def station(self) -> ObstacleSet:
        """Return the outline of the station at its true pose."""
        outline = self.problem.dock.footprint
        return ObstacleSet.empty() if outline is None else ObstacleSet.from_footprint(outline, self.dock, "dock")


def about_z(angle: float) -> Rotation:
    """Return the rotation by an angle [rad] about the vertical axis."""
    return 0.0, 0.0, math.sin(0.5 * angle), math.cos(0.5 * angle)
