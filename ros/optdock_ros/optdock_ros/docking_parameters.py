"""What the parameters of the docking server mean: Nav2's names for what Nav2 has, blocks of ours for the rest."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

from pydantic import Field

from optdock.errors import InvalidValue, OptdockError
from optdock.executor import ExecutorSettings
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.model.dock import Dock, DockTolerances
from optdock.model.problem import ClearanceRule
from optdock.nav2.docks import DockEntry
from optdock.plugins.interfaces import Controller, GoalChecker
from optdock.plugins.parameters import PluginParameters, parse_parameters
from optdock.plugins.registry import PluginChoice, plugin_from
from optdock_ros.dock_database import docks_of_parameters
from optdock_ros.dock_plugins import DockPlugin, plugin_class
from optdock_ros.nested_parameters import ServerParameters, clearance_parameters, robot_parameters, unknown_names
from optdock_ros.surroundings import nav2_footprint

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from optdock.plugins.interfaces import DockType
    from optdock.plugins.lifecycle import Plugin
    from optdock_ros.nested_parameters import RobotParameters

__all__ = ["ControllerParameters", "DockParameters", "DockingParameters", "DockingSettings", "docking_settings"]

T = TypeVar("T")

_SLOWEST, _FASTEST = 10.0, 200.0  # [Hz]: between them the executor's laws are tested


class DockingParameters(ServerParameters):
    """The parameters at the top; those with a Nav2 name have its default."""

    controller_frequency: float = Field(
        default=50.0, ge=_SLOWEST, le=_FASTEST, description="of the control loop and of cmd_vel [Hz]"
    )
    initial_perception_timeout: float = Field(default=5.0, gt=0.0, description="for the first detections [s]")
    wait_charge_timeout: float = Field(default=5.0, gt=0.0, description="in contact, for the charge to begin [s]")
    dock_approach_timeout: float = Field(
        default=30.0, gt=0.0, description="an approach may take so much longer than its plan [s]"
    )
    max_retries: int = Field(default=3, ge=0, description="approaches after the first one")
    base_frame: str = Field(default="base_link", min_length=1, description="of the robot")
    fixed_frame: str = Field(
        default="odom", min_length=1, description="in which is planned and driven; it must not jump"
    )
    dock_prestaging_tolerance: float = Field(
        default=0.5, gt=0.0, description="no staging within this of it: one norm over m, m, rad"
    )
    odom_topic: str = Field(default="odom", min_length=1, description="nav_msgs/Odometry with the robot's velocity")
    odom_duration: float = Field(default=0.3, gt=0.0, description="an older velocity is not believed [s]")
    navigator_bt_xml: str = Field(default="", description="behaviour tree of the way to the staging pose")
    dock_plugins: list[str] = Field(default=[], description="names of the types of docks; each has a block")
    dock_database: str = Field(default="", description="file with the docks; else they are in the parameters")
    docks: list[str] = Field(default=[], description="names of the docks; each has a block")
    enable_stamped_cmd_vel: bool = Field(default=True, description="TwistStamped, as Nav2 since Kilted; else Twist")

    use_realtime_priority: bool = Field(
        default=False,
        description="the kernel prefers this process while a task is at work; needs the right to (rtprio)",
    )

    stage_by_executor: bool = Field(
        default=False, description="drive to the staging pose here, certified, instead of asking navigate_to_pose"
    )
    footprint: str = Field(default="", description="'[[x, y], ...]', where no topic tells [m]")
    robot_radius: float = Field(default=0.1, gt=0.0, description="of a round robot, where nothing else tells [m]")
    footprint_padding: float = Field(default=0.01, ge=0.0, description="how far that outline is moved outward [m]")


class ControllerParameters(PluginParameters):
    """The block `controller`: what of Nav2's means something here."""

    v_linear_max: float = Field(
        default=0.25, gt=0.0, description="default of robot.limits.max_speed, either gear [m/s]"
    )
    v_angular_max: float = Field(default=0.75, gt=0.0, description="default of robot.limits.max_yaw_rate [rad/s]")
    use_collision_detection: bool = Field(
        default=True, description="false: neither costmap nor obstacles; only the dock's own outline counts"
    )
    costmap_topic: str = Field(default="local_costmap/costmap_raw", min_length=1, description="the local costmap")
    footprint_topic: str = Field(
        default="local_costmap/published_footprint", min_length=1, description="the robot's outline"
    )
    transform_tolerance: float = Field(
        default=0.1, gt=0.0, description="an older pose of the robot is not believed [s]"
    )
    map_topic: str = Field(
        default="", description="a larger map, into which the local costmap is pasted; empty: the local one alone"
    )
    costmap_timeout: float = Field(default=1.0, gt=0.0, description="an older costmap stops the robot [s]")


class TolerancesParameters(PluginParameters):
    """The block `dock.tolerances`: when the robot counts as docked."""

    along: float = Field(default=0.01, gt=0.0, description="accepted error along the heading [m]")
    cross: float = Field(default=0.02, gt=0.0, description="accepted error across it [m]")
    yaw: float = Field(default=0.05, gt=0.0, description="accepted heading error [rad]")


class DockParameters(PluginParameters):
    """The block `dock`, of all docks, and `<type>.dock`, of one type: names of the scenario format."""

    footprint: str = Field(
        default="", description="outline of the station seen from the docked robot, '[[x, y], ...]', an obstacle [m]"
    )
    final_straight: float = Field(default=0.0, ge=0.0, description="straight run at the end of the path [m]")
    approach_speed: float = Field(
        default=0.1, gt=0.0, description="largest speed over the last approach_distance [m/s]"
    )
    approach_distance: float = Field(default=0.15, ge=0.0, description="length of the slow stretch [m]")
    contact_margin: float = Field(
        default=0.05, ge=0.0, description="the costmap is free so far around the docked robot's front [m]"
    )
    tolerances: TolerancesParameters = Field(default=TolerancesParameters(), description="when it counts as docked")

    def dock(self, plugin: DockPlugin, docked: Pose2) -> Dock:
        """A dock at which the robot stands docked at `docked`.

        Raises:
            InvalidValue: The station's outline is none.
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


# What Nav2 has and what nothing here reads: its law steers otherwise, its loop waits otherwise.
NOT_READ = frozenset(
    {
        *("rotate_to_dock_timeout", "undock_linear_tolerance", "undock_angular_tolerance"),
        *("rotation_angular_tolerance", "dock_backwards", "initial_rotation", "backward_blind"),
        *("introspection_mode", "action_server_result_timeout"),
    }
)
_LAW = frozenset(
    {
        *("k_phi", "k_delta", "beta", "lambda", "v_linear_min", "slowdown_radius", "deceleration_max"),
        *("rotate_to_heading_angular_vel", "rotate_to_heading_max_angular_accel", "dock_collision_threshold"),
        *("projection_time", "simulation_time_step", "simulation_step", "use_dynamic_window"),
    }
)
# Settings of the executor that have a name of Nav2's, or that a dock's type or the goal decides.
_SAID_ELSEWHERE: Mapping[str, str] = {
    "max_retries": "max_retries",
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
# Settings of the executor that are parameters of the dock type of Nav2's classes.
_OF_SIMPLE_DOCK = ("stall_speed", "stall_time", "back_out_distance")
# Limits that Nav2 does not have and that a path for a differential drive needs; those of the docking study.
_LIMITS = {
    "max_acceleration": 0.5, "max_deceleration": 0.5, "max_jerk": 2.0, "max_yaw_acceleration": 1.5,
    "max_curvature": 3.0, "max_curvature_rate": 30.0,
}  # fmt: skip
_TUBE = {"cross": 0.02, "yaw": 0.03}  # [m], [rad]: what the study's robots kept to, with noise and lag


@dataclass(frozen=True)
class DockingSettings:
    """All parameters of the server, checked.

    Attributes:
        own: Those at the top.
        controller: The block of that name.
        executor: The block of that name; see `task_settings`.
        robot: The block of that name.
        clearance: The block of that name.
        tracker: What drives, block `tracker`.
        goal_checker: What says that the robot is docked, block `goal_checker`.
        plugins: Types of docks by name.
        dock_parameters: The block `dock` of every type.
        docks: By name.
        not_read: Names in docks, types and blocks that nothing reads.
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

    @property
    def period(self) -> float:
        """Of the control loop [s]."""
        return 1.0 / self.own.controller_frequency

    def executor_settings(self, plugin: DockPlugin, **of_goal: object) -> ExecutorSettings:
        """How a docking at this type of docks is carried out.

        Args:
            plugin: The type.
            **of_goal: What the goal says.
        """
        own, of_type = self.own, plugin.parameters
        values: dict[str, object] = {
            **{name: value for name, value in self.executor.items() if name not in _OF_SIMPLE_DOCK},
            "max_retries": own.max_retries,
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
            # The costmap is handed over in every cycle as long as it is new enough; a few cycles may fail.
            values["costmap_patience"] = max(0.1, 5.0 * self.period)
        return ExecutorSettings(**values)

    def dock_type(self, plugin: DockPlugin) -> DockType:
        """What the executor asks about docks of a type: a new one."""
        return plugin.dock_type({name: self.executor[name] for name in _OF_SIMPLE_DOCK if name in self.executor})


class _BlockReader:
    """Reads blocks, and collects everything that is wrong and everything that is not read."""

    def __init__(self, block: Mapping[str, object]) -> None:
        self.block = block
        self.faults: list[str] = []
        self.not_read: list[str] = []

    def inner(self, name: str, block: Mapping[str, object] | None = None) -> Mapping[str, object]:
        """A block in a block; one that is not there is empty."""
        found = (self.block if block is None else block).get(name, {})
        if isinstance(found, Mapping):
            return found
        self.faults.append(f"{name}: must be a block of parameters, got {found!r}")
        return {}

    def checked(self, make: Callable[[], T], instead: T) -> T:
        """What `make` makes, or something instead where it cannot, with its faults taken down."""
        try:
            return make()
        except OptdockError as error:
            self.faults.extend(str(error).splitlines())
            return instead

    def known(
        self, given: Mapping[str, object], owner: str, fields: Iterable[str], accepted: Iterable[str] = ()
    ) -> dict[str, object]:
        """What of a block of Nav2's is read; misspelt names are faults, others of Nav2's are noted."""
        names = set(fields)
        wrong, ignored = unknown_names(given, names, accepted)
        self.faults.extend(f"{owner}.{line}" for line in wrong)
        self.not_read.extend(f"{owner}.{key}" for key in ignored)
        return {key: value for key, value in given.items() if key in names}


def docking_settings(block: Mapping[str, object], own: DockingParameters) -> DockingSettings:
    """What the parameters mean.

    Args:
        block: All of them, nested.
        own: Those at the top.

    Raises:
        InvalidValue: What is wrong in any block, one line per fault.
    """
    read = _BlockReader(block)
    given = read.known(read.inner("controller"), "controller", ControllerParameters.model_fields, _LAW)
    controller = read.checked(
        lambda: parse_parameters(ControllerParameters, given, "controller"), ControllerParameters()
    )
    executor = _executor(read)
    robot = read.checked(lambda: robot_parameters(_robot(read, controller)), robot_parameters({}))
    clearance = read.checked(lambda: clearance_parameters(block.get("clearance", {})), ClearanceRule())
    tracker = _choice(read, Controller, "tracker", "TrackingController")
    checker = _choice(read, GoalChecker, "goal_checker", "DockGoalChecker")
    read.checked(lambda: nav2_footprint(own.footprint, own.robot_radius, own.footprint_padding), None)
    if not own.dock_plugins:
        read.faults.append("dock_plugins: needs at least one name")
    plugins: dict[str, DockPlugin] = {}
    of_docks: dict[str, DockParameters] = {}
    for name in own.dock_plugins:
        _read_type(read, name, plugins, of_docks)
    docks = read.checked(lambda: docks_of_parameters(block), dict[str, DockEntry]())
    read.not_read.extend(f"{dock.name}.{key}" for dock in docks.values() for key in dock.unknown)
    if read.faults:
        raise InvalidValue("\n".join(dict.fromkeys(read.faults)))
    not_read = tuple(read.not_read)
    return DockingSettings(
        own, controller, executor, robot, clearance, tracker, checker, plugins, of_docks, docks, not_read
    )


def _executor(read: _BlockReader) -> dict[str, object]:
    """The executor's own settings; those that are given elsewhere are faults here."""
    given = read.inner("executor")
    twice = [name for name in given if name in _SAID_ELSEWHERE]
    read.faults.extend(f"executor.{name}: is {_SAID_ELSEWHERE[name]} of this server" for name in twice)
    own = {name: value for name, value in given.items() if name not in twice}
    try:
        ExecutorSettings(**own)
    except InvalidValue as error:
        read.faults.extend(str(error).replace(f"{ExecutorSettings.__name__}.", "executor.").splitlines())
    return own


def _robot(read: _BlockReader, controller: ControllerParameters) -> dict[str, object]:
    """The block `robot`, with the server's own defaults for what it does not say."""
    given = read.inner("robot")
    speed = controller.v_linear_max
    limits = {
        "max_speed": speed, "max_reverse_speed": speed, "max_yaw_rate": controller.v_angular_max, **_LIMITS,
        **read.inner("limits", given),
    }  # fmt: skip
    return {**given, "limits": limits, "tracking": {**_TUBE, **read.inner("tracking", given)}}


def _choice(read: _BlockReader, interface: type[Plugin], owner: str, default: str) -> PluginChoice:
    """The plugin of a block, and its parameters."""
    given = dict(read.inner(owner))
    choice = PluginChoice(str(given.pop("plugin", default)), given)
    read.checked(lambda: plugin_from(interface, choice, owner), None)
    return choice


def _read_type(
    read: _BlockReader, name: str, plugins: dict[str, DockPlugin], of_docks: dict[str, DockParameters]
) -> None:
    """One type of docks."""
    given, dock = read.inner(name), read.inner("dock")
    special = read.inner("dock", given)
    tolerances = {**read.inner("tolerances", dock), **read.inner("tolerances", special)}
    values = {**dock, **special, **({"tolerances": tolerances} if tolerances else {})}
    parameters = read.checked(lambda: parse_parameters(DockParameters, values, f"{name}.dock"), DockParameters())

    def made() -> DockPlugin | None:
        kind = plugin_class(name, given.get("plugin"))
        block = {key: value for key, value in given.items() if key not in {"plugin", "dock"}}
        return kind(name, read.known(block, name, kind.known_names()))

    plugin = read.checked(made, None)
    if plugin is not None:
        read.checked(lambda: parameters.dock(plugin, Pose2(0.0, 0.0, 0.0)), None)
        plugins[name], of_docks[name] = plugin, parameters
