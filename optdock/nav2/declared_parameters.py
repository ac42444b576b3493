"""All parameters that Nav2's docking and smoother servers declare, by distribution, and their use in optdock.

`DECLARED` is the single table: the servers of `optdock_ros`, `optdock plugins --nav2-params` and the reference use it.
"""

from __future__ import annotations

from enum import Enum
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

__all__ = [
    "DECLARED",
    "DISTRIBUTIONS",
    "NAV2_DOCKS",
    "OURS",
    "Block",
    "DeclaredParameter",
    "Use",
    "found",
    "names_of",
]

DISTRIBUTIONS = ("jazzy", "kilted", "lyrical", "main")
"""Distributions of ROS with Nav2's docking server, in order; `main` is the development branch."""

NAV2_DOCKS = ("opennav_docking::SimpleChargingDock", "opennav_docking::SimpleNonChargingDock")
"""Nav2's dock plugins that the docking server provides."""


class Block(str, Enum):
    """Location of a parameter in a parameter file."""

    ANY_NODE = "every node"
    DOCKING = "docking_server"
    CONTROLLER = "docking_server, controller"
    DOCK_TYPE = "docking_server, dock type"
    DOCK = "docking_server, dock"
    SMOOTHING = "smoother_server"
    SMOOTHER = "smoother_server, smoother"


class Use(str, Enum):
    """How optdock uses a parameter of Nav2."""

    READ = "read"
    MAPPED = "mapped"
    NO_EFFECT = "no effect"
    REFUSED = "refused"


class DeclaredParameter(NamedTuple):
    """One parameter of Nav2, and how optdock uses it.

    Attributes:
        block: Location in a parameter file.
        name: Name within the block.
        use: Use in optdock.
        words: Setting to which the parameter is mapped, the reason why the parameter has no effect on the motion, or
            the setting to use instead.
        distributions: Distributions whose servers declare it; empty for names in development versions and in other
            nodes.
    """

    block: Block
    name: str
    use: Use
    words: str
    distributions: tuple[str, ...]


_ALL, _KILTED, _LYRICAL, _JAZZY, _NEVER = DISTRIBUTIONS, DISTRIBUTIONS[1:], DISTRIBUTIONS[2:], DISTRIBUTIONS[:1], ()

_LAW = "a gain of Nav2's control law; the robot follows a planned path"
_ROLLOUT = "of Nav2's simulated arc; the whole planned path is checked for collisions"
_TURN = "turning round is part of the planned path"
_GRAPH = "changes no motion"
_UNRELEASED = "of a development version; no release of Nav2 declares it"

# Block, use, distributions, names, words.
_GROUPS: tuple[tuple[Block, Use, tuple[str, ...], str, str], ...] = (
    (Block.ANY_NODE, Use.READ, _ALL, "use_sim_time bond_heartbeat_period", ""),
    (Block.ANY_NODE, Use.MAPPED, _ALL, "autostart_node", "`autostart`"),
    (Block.ANY_NODE, Use.NO_EFFECT, _ALL, "start_type_description_service qos_overrides", _GRAPH),
    (Block.ANY_NODE, Use.NO_EFFECT, _LYRICAL, "introspection_mode allow_parameter_qos_overrides", _GRAPH),
    (
        Block.ANY_NODE,
        Use.NO_EFFECT,
        _LYRICAL,
        "warn_on_missing_params strict_param_loading",
        "changes no motion; absent parameters have their defaults",
    ),
    (
        Block.ANY_NODE,
        Use.NO_EFFECT,
        _NEVER,
        "service_introspection_mode action_introspection_mode use_realtime_priority",
        "of other nodes, and changes no motion; `docking_server` has `use_realtime_priority`",
    ),
    (
        Block.DOCKING,
        Use.READ,
        _ALL,
        "controller_frequency initial_perception_timeout wait_charge_timeout dock_approach_timeout max_retries "
        "undock_linear_tolerance undock_angular_tolerance base_frame fixed_frame dock_prestaging_tolerance "
        "dock_backwards navigator_bt_xml dock_plugins dock_database docks",
        "",
    ),
    (
        Block.DOCKING,
        Use.READ,
        _ALL,
        "enable_stamped_cmd_vel",
        "by default false on Jazzy only, see `nav2_distribution`",
    ),
    (Block.DOCKING, Use.READ, _KILTED, "odom_topic", ""),
    (Block.DOCKING, Use.READ, _LYRICAL, "odom_duration", ""),
    (
        Block.DOCKING,
        Use.NO_EFFECT,
        _KILTED,
        "rotate_to_dock_timeout",
        f"{_TURN}; `dock_approach_timeout` is its time limit",
    ),
    (
        Block.DOCKING,
        Use.NO_EFFECT,
        _KILTED,
        "rotation_angular_tolerance",
        f"{_TURN}, at whose end `dock.tolerances.yaw` holds",
    ),
    (Block.DOCKING, Use.NO_EFFECT, _JAZZY, "action_server_result_timeout", _GRAPH),
    (Block.DOCKING, Use.NO_EFFECT, _NEVER, "initial_rotation", f"{_UNRELEASED}; {_TURN}"),
    (
        Block.DOCKING,
        Use.REFUSED,
        _NEVER,
        "backward_blind",
        f"{_UNRELEASED}; set `<dock type>.rotate_to_dock` and `dock_direction: backward` instead",
    ),
    (
        Block.CONTROLLER,
        Use.READ,
        _ALL,
        "v_linear_max v_angular_max use_collision_detection costmap_topic footprint_topic transform_tolerance",
        "",
    ),
    (
        Block.CONTROLLER,
        Use.MAPPED,
        _ALL,
        "v_linear_min",
        "`tracker.min_speed`, the dead band of the drive, and least default of `dock.approach_speed`, "
        "`executor.contact_speed` and `executor.back_out_speed`; a value equal to `v_linear_max` is a constant speed "
        "and no dead band",
    ),
    (
        Block.CONTROLLER,
        Use.MAPPED,
        _LYRICAL,
        "deceleration_max",
        "largest default of `robot.limits.max_deceleration`",
    ),
    (
        Block.CONTROLLER,
        Use.MAPPED,
        _ALL,
        "rotate_to_heading_angular_vel",
        "largest default of `robot.limits.max_yaw_rate`, which holds for turns in place and curves",
    ),
    (
        Block.CONTROLLER,
        Use.MAPPED,
        _ALL,
        "rotate_to_heading_max_angular_accel",
        "largest default of `robot.limits.max_yaw_acceleration`, which holds for turns in place and curves",
    ),
    (
        Block.CONTROLLER,
        Use.MAPPED,
        _ALL,
        "dock_collision_threshold",
        "`dock.contact_margin`, less the 0.25 m by which Nav2 moves its target into the dock; more than 0.3 m is "
        "refused, as it would free more obstacles: set `dock.contact_margin` instead",
    ),
    (Block.CONTROLLER, Use.NO_EFFECT, _ALL, "k_phi k_delta beta lambda", _LAW),
    (
        Block.CONTROLLER,
        Use.NO_EFFECT,
        _ALL,
        "slowdown_radius",
        "the planned speed ends at zero within `robot.limits`; the slow zone is `dock.approach_distance`",
    ),
    (Block.CONTROLLER, Use.NO_EFFECT, _ALL, "projection_time simulation_time_step", _ROLLOUT),
    (Block.CONTROLLER, Use.NO_EFFECT, _NEVER, "simulation_step", f"Nav2 does not read it either; {_ROLLOUT}"),
    (Block.CONTROLLER, Use.NO_EFFECT, _NEVER, "use_dynamic_window", f"{_UNRELEASED}; {_LAW}"),
    (
        Block.DOCK_TYPE,
        Use.READ,
        _ALL,
        "plugin use_battery_status charging_threshold use_external_detection_pose external_detection_timeout "
        "external_detection_translation_x external_detection_translation_y use_stall_detection stall_joint_names "
        "stall_velocity_threshold stall_effort_threshold docking_threshold staging_x_offset staging_yaw_offset",
        "",
    ),
    (
        Block.DOCK_TYPE,
        Use.READ,
        _ALL,
        "external_detection_rotation_roll external_detection_rotation_pitch external_detection_rotation_yaw",
        "in the order of `nav2_distribution`",
    ),
    (Block.DOCK_TYPE, Use.READ, _KILTED, "dock_direction rotate_to_dock", ""),
    (Block.DOCK_TYPE, Use.READ, _LYRICAL, "detector_service_name detector_service_timeout subscribe_toggle", ""),
    (
        Block.DOCK_TYPE,
        Use.NO_EFFECT,
        _ALL,
        "filter_coef",
        "the estimate weights detections by `detection_position_sigma` and `detection_yaw_sigma`",
    ),
    (
        Block.DOCK_TYPE,
        Use.REFUSED,
        _NEVER,
        "backward_blind",
        f"{_UNRELEASED}; set `rotate_to_dock` and `dock_direction: backward` instead",
    ),
    (Block.DOCK, Use.READ, _ALL, "type frame pose id", ""),
    (
        Block.SMOOTHING,
        Use.READ,
        _ALL,
        "costmap_topic footprint_topic robot_base_frame transform_tolerance smoother_plugins",
        "",
    ),
    (Block.SMOOTHING, Use.READ, _JAZZY, "action_server_result_timeout", ""),
    (
        Block.SMOOTHER,
        Use.READ,
        _ALL,
        "plugin tolerance max_its w_data w_smooth do_refinement refinement_num",
        "",
    ),
    (Block.SMOOTHER, Use.READ, _KILTED, "enforce_path_inversion", ""),
    (Block.SMOOTHER, Use.READ, _LYRICAL, "window_size poly_order", ""),
)


def _rows() -> Iterator[DeclaredParameter]:
    for block, use, distributions, names, words in _GROUPS:
        for name in names.split():
            yield DeclaredParameter(block, name, use, words, distributions)


DECLARED: Mapping[tuple[Block, str], DeclaredParameter] = {(row.block, row.name): row for row in _rows()}
"""Parameters of Nav2 by block and name."""

OURS: Mapping[Block, tuple[str, ...]] = {
    Block.ANY_NODE: ("autostart",),
    Block.DOCKING: (
        *("nav2_distribution", "stage_by_executor", "use_realtime_priority"),
        *("footprint", "robot_radius", "footprint_padding"),
        *("controller", "robot", "clearance", "executor", "tracker", "goal_checker", "dock"),
    ),
    Block.CONTROLLER: ("map_topic", "costmap_timeout"),
    Block.DOCK_TYPE: (
        *("detection_position_sigma", "detection_yaw_sigma", "contact", "dock"),
        *("contact_topic", "contact_timeout"),
    ),
    Block.SMOOTHING: ("costmap_timeout", "robot", "clearance"),
}
"""Parameters and blocks of the servers that Nav2 does not have."""


def found(block: Block, name: str) -> DeclaredParameter | None:
    """Return a parameter of Nav2 in a block, or of every node in the block of a server; None if it is unknown."""
    everywhere = (Block.ANY_NODE,) if block in (Block.DOCKING, Block.SMOOTHING) else ()
    return next((DECLARED[place, name] for place in (block, *everywhere) if (place, name) in DECLARED), None)


def names_of(block: Block, *uses: Use) -> frozenset[str]:
    """Return the names of Nav2's parameters in a block, all or only those with the given uses."""
    return frozenset(row.name for row in DECLARED.values() if row.block is block and (not uses or row.use in uses))
