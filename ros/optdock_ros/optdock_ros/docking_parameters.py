"""The parameters of the docking server: Nav2's names and defaults, and further blocks."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple

from pydantic import Field

from optdock.errors import DockNotInDB, DockNotValid, InvalidValue
from optdock.executor import ExecutorSettings
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.io.quoting import printable
from optdock.io.yaml_lines import Document
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.dock import Dock, DockTolerances
from optdock.nav2.controller_settings import controller_settings
from optdock.nav2.declared_parameters import Block
from optdock.nav2.docks import DockEntry, load_dock_database, read_dock
from optdock.nav2.parameter_report import refused_parameters
from optdock.plugins.interfaces import Controller, GoalChecker
from optdock.plugins.parameters import PluginParameters, closest, parse_parameters
from optdock.plugins.registry import PluginChoice, load_plugin, plugin_from
from optdock_ros.detection_rotation import distribution_of
from optdock_ros.dock_plugins import DockPlugin, plugin_class
from optdock_ros.nested_parameters import BlockReader, ServerParameters, clearance_parameters, robot_parameters
from optdock_ros.surroundings import nav2_footprint

if TYPE_CHECKING:
    from optdock.io.yaml_lines import Keys
    from optdock.plugins.interfaces import DockType
    from optdock.plugins.lifecycle import Plugin
    from optdock_ros.nested_parameters import RobotParameters

__all__ = [
    "ControllerParameters",
    "DockParameters",
    "DockingParameters",
    "DockingSettings",
    "Docks",
    "docking_settings",
    "docks_of_parameters",
]

_SLOWEST, _FASTEST = 10.0, 200.0  # [Hz]: tested range of the control laws


class DockingParameters(ServerParameters):
    """The parameters at the top."""

    controller_frequency: float = Field(
        50.0, ge=_SLOWEST, le=_FASTEST, description="rate of the control loop and of cmd_vel [Hz]"
    )
    initial_perception_timeout: float = Field(5.0, gt=0, description="timeout of the first detections [s]")
    wait_charge_timeout: float = Field(5.0, gt=0, description="timeout of the wait for charging in contact [s]")
    dock_approach_timeout: float = Field(30.0, gt=0, description="largest delay of an approach behind its plan [s]")
    max_retries: int = Field(3, ge=0, description="approaches after the first one")
    undock_linear_tolerance: float = Field(
        0.05, gt=0, description="largest distance from the staging pose of an undocked robot [m]"
    )
    undock_angular_tolerance: float = Field(
        0.05, gt=0, description="largest heading error at the staging pose of an undocked robot [rad]"
    )
    base_frame: str = Field("base_link", min_length=1, description="frame of the robot")
    fixed_frame: str = Field("odom", min_length=1, description="frame of planning and driving, without jumps")
    dock_prestaging_tolerance: float = Field(
        0.5, gt=0, description="no staging within this norm over m, m, rad of the staging pose"
    )
    odom_topic: str = Field("odom", min_length=1, description="topic nav_msgs/Odometry with the robot's velocity")
    odom_duration: float = Field(0.3, gt=0, description="largest age of the velocity [s]")
    navigator_bt_xml: str = Field("", description="behaviour tree for the drive to the staging pose")
    dock_plugins: list[str] = Field([], description="names of the dock types; each has a block")
    dock_backwards: bool | None = Field(
        default=None, description="gear into all docks, as on Jazzy; not set: `dock_direction` of the dock's type"
    )
    dock_database: str = Field("", description="file with the docks; empty: docks in the parameters")
    docks: list[str] = Field([], description="names of the docks; each has a block")
    enable_stamped_cmd_vel: bool | None = Field(
        default=None, description="publish TwistStamped; false: Twist; not set: as in Nav2, false on Jazzy only"
    )

    nav2_distribution: Literal["", "jazzy", "kilted", "lyrical", "main"] = Field(
        "",
        description="distribution that sets the order of external_detection_rotation_* and the default of "
        "enable_stamped_cmd_vel; empty: ROS_DISTRO",
    )
    use_realtime_priority: bool = Field(default=False, description="real-time scheduling during tasks; needs rtprio")

    stage_by_executor: bool = Field(
        default=False, description="drive to the staging pose on a certified path instead of by navigate_to_pose"
    )
    footprint: str = Field("", description="footprint '[[x, y], ...]' used without a footprint topic [m]")
    robot_radius: float = Field(0.1, gt=0, description="radius of a round robot, used without another footprint [m]")
    footprint_padding: float = Field(0.01, ge=0, description="padding of that footprint [m]")


class ControllerParameters(PluginParameters):
    """The block `controller`: the parameters of Nav2 that are used here."""

    v_linear_min: float | None = Field(
        None,
        ge=0,
        description="default of tracker.min_speed and least one of dock.approach_speed, if < v_linear_max [m/s]",
    )
    v_linear_max: float = Field(0.25, gt=0, description="default of robot.limits.max_speed [m/s]")
    v_angular_max: float = Field(0.75, gt=0, description="default of robot.limits.max_yaw_rate [rad/s]")
    deceleration_max: float | None = Field(
        None, gt=0, description="largest default of robot.limits.max_deceleration [m/s^2]"
    )
    rotate_to_heading_angular_vel: float | None = Field(
        None, gt=0, description="largest default of robot.limits.max_yaw_rate [rad/s]"
    )
    rotate_to_heading_max_angular_accel: float | None = Field(
        None, gt=0, description="largest default of robot.limits.max_yaw_acceleration [rad/s^2]"
    )
    dock_collision_threshold: float | None = Field(
        None, ge=0, description="default of dock.contact_margin plus 0.25 m; at most 0.3 [m]"
    )
    use_collision_detection: bool = Field(
        default=True, description="check for obstacles; false: the station is the only obstacle"
    )
    costmap_topic: str = Field("local_costmap/costmap_raw", min_length=1, description="topic of the local costmap")
    footprint_topic: str = Field(
        "local_costmap/published_footprint", min_length=1, description="topic of the robot's footprint"
    )
    transform_tolerance: float = Field(0.1, gt=0, description="largest age of the robot's pose [s]")
    map_topic: str = Field("", description="topic of a larger map, merged with the local costmap; empty: none")
    costmap_timeout: float = Field(1.0, gt=0, description="age of the costmap at which the robot stops [s]")


class TolerancesParameters(PluginParameters):
    """The block `dock.tolerances`: accepted errors of a docked robot."""

    along: float = Field(default=0.01, gt=0, description="accepted error along the heading [m]")
    cross: float = Field(default=0.02, gt=0, description="accepted error across the heading [m]")
    yaw: float = Field(default=0.05, gt=0, description="accepted heading error [rad]")


class DockParameters(PluginParameters):
    """The block `dock` for all docks and `<type>.dock` for one type, in the names of the scenario format."""

    footprint: str = Field("", description="footprint of the station in the docked robot's frame, '[[x, y], ...]' [m]")
    final_straight: float = Field(0.0, ge=0, description="length of the straight end of the path [m]")
    approach_speed: float = Field(0.1, gt=0, description="largest speed within approach_distance [m/s]")
    approach_distance: float = Field(0.15, ge=0, description="length of the speed zone at the end of the path [m]")
    contact_margin: float = Field(
        0.05, ge=0, description="distance from the docked robot's front within which costmap cells are freed [m]"
    )
    tolerances: TolerancesParameters = Field(
        default=TolerancesParameters(), description="accepted errors of a docked robot"
    )

    def dock(self, plugin: DockPlugin, docked: Pose2) -> Dock:
        """Return the dock for a docked pose of the robot.

        Raises:
            InvalidValue: If the station's outline is invalid.
        """
        t = self.tolerances
        return Dock(
            docked,
            Footprint.from_string(self.footprint) if self.footprint else None,
            plugin.direction,
            self.final_straight,
            self.approach_speed if self.approach_distance > 0.0 else math.inf,
            self.approach_distance,
            DockTolerances(t.along, t.cross, t.yaw),
        )


# Settings of the executor that are set by a parameter of Nav2, by the dock type or by the goal.
_DIRECTIONS: Mapping[bool | None, str] = {True: "backward", False: "forward"}  # by `dock_backwards`
_SET_ELSEWHERE: Mapping[str, str] = {
    "max_retries": "max_retries",
    "undock_linear_tolerance": "undock_linear_tolerance",
    "undock_angular_tolerance": "undock_angular_tolerance",
    "initial_perception_timeout": "initial_perception_timeout",
    "wait_charge_timeout": "wait_charge_timeout",
    "dock_approach_timeout": "dock_approach_timeout",
    "prestaging_tolerance": "dock_prestaging_tolerance",
    "contact_range": "<dock type>.docking_threshold",
    "staging_distance": "<dock type>.staging_x_offset",
    "use_detections": "<dock type>.use_external_detection_pose",
    "wait_for_charge": "<dock type>.use_battery_status, or the dock type's own",
    "contact": "<dock type>.contact, or the dock type's own",
    "contact_margin": "dock.contact_margin",
    "costmap_patience": "controller.costmap_timeout",
    "navigate_to_staging_pose": "navigate_to_staging_pose of the goal",
    "max_staging_time": "max_staging_time of the goal",
    "max_undocking_time": "max_undocking_time of the goal",
}
# Settings in the block `executor` that are parameters of `SimpleDock`.
_OF_SIMPLE_DOCK = ("stall_speed", "stall_time", "back_out_distance")
# Limits that Nav2 lacks and that a path of a differential drive needs, as in the docking study.
_LIMITS = {
    "max_acceleration": 0.5, "max_deceleration": 0.5, "max_jerk": 2.0, "max_yaw_acceleration": 1.5,
    "max_curvature": 3.0, "max_curvature_rate": 30.0,
}  # fmt: skip
_TUBE = {"cross": 0.02, "yaw": 0.03}  # [m], [rad]: deviations of the study's robots with noise and lag


class Docks:
    """Dock plugins by the names of their instances, and docks by name."""

    def __init__(self, plugins: Mapping[str, DockPlugin], entries: Mapping[str, DockEntry]) -> None:
        self.plugins, self.entries = dict(plugins), dict(entries)

    def reload(self, path: str) -> None:
        """Replace the docks by those of a file; an `InvalidFile` leaves them unchanged."""
        self.entries = load_dock_database(path)

    def find(self, name: str) -> tuple[DockEntry, DockPlugin]:
        """Return a dock and its plugin.

        Raises:
            DockNotInDB: If the name is unknown.
            DockNotValid: If the type of the dock is unknown.
        """
        entry = self.entries.get(name)
        if entry is None:
            known = ", ".join(self.entries) or "none"
            raise DockNotInDB(f"dock_id: there is no dock {name!r}{closest(name, self.entries)}; known: {known}")
        return entry, self.plugin(entry.type, f"dock {name}")

    def plugin(self, type_name: str, owner: str) -> DockPlugin:
        """Return a dock plugin; the only one for an empty name.

        Raises:
            DockNotValid: If the type is unknown.
        """
        if not type_name and len(self.plugins) == 1:
            return next(iter(self.plugins.values()))
        found = self.plugins.get(type_name)
        if found is None:
            known = ", ".join(self.plugins)
            raise DockNotValid(
                f"{owner}: there is no dock type {type_name!r}{closest(type_name, self.plugins)}; known: {known}"
            )
        return found


class _Parameters(Document):
    """Parameters, possibly from several files; error messages name the parameter only."""

    def fault(self, keys: Keys, message: str) -> str:
        return printable(f"{'.'.join(map(str, keys))}: {message}")


def docks_of_parameters(block: Mapping[str, object]) -> dict[str, DockEntry]:
    """Return the docks of a parameter block, or of the file that it names.

    Raises:
        InvalidFile: If the file is invalid.
        InvalidValue: If a dock of the block is invalid; one line per fault.
    """
    path = block.get("dock_database")
    if path:
        return load_dock_database(str(path))
    names = block.get("docks") or []
    if not (isinstance(names, list) and all(isinstance(name, str) for name in names)):
        raise InvalidValue(f"docks: must be a list of names, got {names!r}")
    faults: list[str] = []
    document = _Parameters(Path(), block, {})
    entries = [read_dock(document, (name,), faults) for name in dict.fromkeys(names)]
    if faults:
        raise InvalidValue("\n".join(faults))
    return {entry.name: entry for entry in entries if entry is not None}


@dataclass(frozen=True)
class DockingSettings:
    """All parameters of the server, validated.

    Attributes:
        own: Parameters at the top; the other attributes are the blocks, by name.
        plugins: Dock types by name.
        dock_parameters: Block `dock` of every dock type.
        docks: Docks by name.
        not_read: Names in docks, dock types and blocks that are not read.
        mapped: One line for every parameter of the controller that sets other parameters.
        distribution: Distribution of Nav2; empty if it is unknown.
    """

    own: DockingParameters
    controller: ControllerParameters
    executor: Mapping[str, object]
    robot: RobotParameters
    clearance: ClearanceRule
    tracker: PluginChoice
    goal_checker: PluginChoice
    plugins: Mapping[str, DockPlugin]
    dock_parameters: Mapping[str, DockParameters]
    docks: Mapping[str, DockEntry]
    not_read: tuple[str, ...]
    mapped: tuple[str, ...]
    distribution: str

    @property
    def sends_stamps(self) -> bool:
        """Whether commands are of the type TwistStamped."""
        given = self.own.enable_stamped_cmd_vel
        return self.distribution != "jazzy" if given is None else given

    @property
    def period(self) -> float:
        """Period of the control loop [s]."""
        return 1.0 / self.own.controller_frequency

    def executor_settings(self, plugin: DockPlugin, **of_goal: object) -> ExecutorSettings:
        """Return the executor's settings for a dock type and a goal."""
        own, of_type = self.own, plugin.parameters
        values: dict[str, object] = {
            **{name: value for name, value in self.executor.items() if name not in _OF_SIMPLE_DOCK},
            "max_retries": own.max_retries,
            "undock_linear_tolerance": own.undock_linear_tolerance,
            "undock_angular_tolerance": own.undock_angular_tolerance,
            "initial_perception_timeout": own.initial_perception_timeout,
            "wait_charge_timeout": own.wait_charge_timeout,
            "dock_approach_timeout": own.dock_approach_timeout,
            "prestaging_tolerance": own.dock_prestaging_tolerance,
            "contact_range": of_type.docking_threshold,
            "staging_distance": abs(of_type.staging_x_offset) or None,
            "use_detections": of_type.use_external_detection_pose,
            "contact_margin": self.dock_parameters[plugin.name].contact_margin,
            **of_goal,
        }
        if self.controller.use_collision_detection:
            # A costmap that is new enough is passed in every cycle; a few cycles may miss it.
            values["costmap_patience"] = max(0.1, 5.0 * self.period)
        return ExecutorSettings(**values)

    def dock_type(self, plugin: DockPlugin) -> DockType:
        """Return a new dock type for the executor."""
        return plugin.dock_type({name: self.executor[name] for name in _OF_SIMPLE_DOCK if name in self.executor})


def docking_settings(block: Mapping[str, object], own: DockingParameters) -> DockingSettings:
    """Return the validated parameters of all blocks, given those at the top.

    Raises:
        InvalidValue: If a block is invalid; one line per fault.
    """
    read = BlockReader(block)
    read.faults += refused_parameters(block)
    given = read.known(read.inner("controller"), ControllerParameters.model_fields, Block.CONTROLLER, "controller")
    controller = read.attempt(
        lambda: parse_parameters(ControllerParameters, given, "controller"), ControllerParameters.model_validate({})
    )
    effects = controller_settings(block)
    read.faults += [f"controller.{name}: {one.words}" for name, one in effects.items() if one.is_refused]
    mapped = {key: value for one in effects.values() for key, value in one.values.items()}
    robot = read.attempt(lambda: robot_parameters(_robot(read, controller, mapped)), robot_parameters({}))
    clearance = read.attempt(lambda: clearance_parameters(block.get("clearance", {})), ClearanceRule())
    read.attempt(lambda: nav2_footprint(own.footprint, own.robot_radius, own.footprint_padding), None)
    if not own.dock_plugins:
        read.faults.append("dock_plugins: needs at least one name")
    distribution = own.nav2_distribution or distribution_of(os.environ)
    common = _OfAllTypes(
        _DIRECTIONS.get(own.dock_backwards),
        distribution,
        {**_mapped(mapped, "dock.", DockParameters), **read.inner("dock")},
    )
    types = {name: made for name in own.dock_plugins if (made := _read_type(read, name, common)) is not None}
    docks = read.attempt(lambda: docks_of_parameters(block), dict[str, DockEntry]())
    read.ignored.extend(f"{dock.name}.{key}" for dock in docks.values() for key in dock.unknown)
    settings = DockingSettings(
        own=own,
        controller=controller,
        executor=_executor(read, mapped),
        robot=robot,
        clearance=clearance,
        tracker=_tracker(read, mapped),
        goal_checker=_choice(read, GoalChecker, "goal_checker", "DockGoalChecker"),
        plugins={name: plugin for name, (plugin, _) in types.items()},
        dock_parameters={name: of_dock for name, (_, of_dock) in types.items()},
        docks=docks,
        not_read=tuple(read.ignored),
        mapped=tuple(f"controller.{name}: {one.words}" for name, one in effects.items()),
        distribution=distribution,
    )
    read.check()
    return settings


def _executor(read: BlockReader, mapped: Mapping[str, float]) -> dict[str, object]:
    """Return the block `executor` with the server's defaults; settings that are set elsewhere are faults."""
    given = read.inner("executor")
    twice = [name for name in given if name in _SET_ELSEWHERE]
    read.faults.extend(f"executor.{name}: is {_SET_ELSEWHERE[name]} of this server" for name in twice)
    own = {**_mapped(mapped, "executor.", ExecutorSettings), **given}
    own = {name: value for name, value in own.items() if name not in twice}
    try:
        ExecutorSettings(**own)
    except InvalidValue as error:
        read.faults.extend(str(error).replace(f"{ExecutorSettings.__name__}.", "executor.").splitlines())
    return own


def _robot(read: BlockReader, controller: ControllerParameters, mapped: Mapping[str, float]) -> dict[str, object]:
    """Return the block `robot` with the server's defaults."""
    given = read.inner("robot")
    speed = controller.v_linear_max
    usual = {"max_speed": speed, "max_reverse_speed": speed, "max_yaw_rate": controller.v_angular_max, **_LIMITS}
    limits = {name: min(value, mapped.get(f"robot.limits.{name}", value)) for name, value in usual.items()}
    limits_given = {**limits, **read.inner("limits", given)}
    return {**given, "limits": limits_given, "tracking": {**_TUBE, **read.inner("tracking", given)}}


def _tracker(read: BlockReader, mapped: Mapping[str, float]) -> PluginChoice:
    """Return the controller; its dead band is by default that of the parameters of Nav2."""
    choice = _choice(read, Controller, "tracker", "TrackingController")
    if "tracker.min_speed" not in mapped or read.faults:
        return choice
    if "min_speed" not in load_plugin(Controller, choice.name).Parameters.model_fields:
        read.ignored.append(f"controller.v_linear_min for the tracker {choice.name}")
        return choice
    return PluginChoice(choice.name, {"min_speed": mapped["tracker.min_speed"], **choice.parameters})


def _choice(read: BlockReader, interface: type[Plugin], owner: str, default: str) -> PluginChoice:
    """Return the plugin of a block and its parameters."""
    given = dict(read.inner(owner))
    choice = PluginChoice(str(given.pop("plugin", default)), given)
    read.attempt(lambda: plugin_from(interface, choice, owner), None)
    return choice


class _OfAllTypes(NamedTuple):
    """Parameters that hold for all dock types.

    Attributes:
        direction: Gear by `dock_backwards`; None if it is not set.
        distribution: Distribution of Nav2; empty if it is unknown.
        dock: The block `dock` with its defaults.
    """

    direction: str | None
    distribution: str
    dock: Mapping[str, object]


def _mapped(mapped: Mapping[str, float], prefix: str, model: type[PluginParameters]) -> dict[str, object]:
    """Return the settings of a block that are set by the parameters of Nav2; speeds are not less than the defaults."""
    found = {key.removeprefix(prefix): value for key, value in mapped.items() if key.startswith(prefix)}
    least = {name: model.model_fields[name].default for name in found if name.endswith("_speed")}
    return {name: max(value, least.get(name, value)) for name, value in found.items()}


def _read_type(read: BlockReader, name: str, common: _OfAllTypes) -> tuple[DockPlugin, DockParameters] | None:
    """Return a dock type and its block `dock`; None if it has faults."""
    given, direction = dict(read.inner(name)), common.direction
    stated = given.setdefault("dock_direction", direction) if direction else direction
    if stated != direction:
        read.faults.append(f"{name}.dock_direction: {stated!r} contradicts dock_backwards, which means {direction!r}")
    special = read.inner("dock", given)
    tolerances = {**read.inner("tolerances", common.dock), **read.inner("tolerances", special)}
    values = {**common.dock, **special, **({"tolerances": tolerances} if tolerances else {})}
    parameters = read.attempt(
        lambda: parse_parameters(DockParameters, values, f"{name}.dock"), DockParameters.model_validate({})
    )

    def made() -> DockPlugin | None:
        kind = plugin_class(name, given.get("plugin"))
        block = {key: value for key, value in given.items() if key not in {"plugin", "dock"}}
        known = read.known(block, kind.known_names(), Block.DOCK_TYPE, name)
        return kind(name, known, common.distribution)

    plugin = read.attempt(made, None)
    if plugin is None:
        return None
    read.attempt(lambda: parameters.dock(plugin, Pose2(0.0, 0.0, 0.0)), None)
    return plugin, parameters
