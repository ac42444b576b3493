"""Plugins of a Nav2 parameter file that optdock provides, and the reasons why other plugins are not provided."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from pydantic import ValidationError

from optdock.errors import InvalidValue, PluginError
from optdock.nav2.declared_parameters import NAV2_DOCKS
from optdock.nav2.plugin_lists import UNLISTED
from optdock.plugins.parameters import closest, parse_parameters
from optdock.plugins.registry import INTERFACES, create_plugin, load_plugin

if TYPE_CHECKING:
    from optdock.nav2.params import Nav2Params
    from optdock.nav2.plugin_lists import PluginInstance
    from optdock.plugins.lifecycle import Plugin

__all__ = ["Nav2Plugin", "nav2_costmap_rows", "nav2_plugin_rows", "nav2_plugins", "provided"]

# Nav2's kinds of plugins, and the entry point groups of their interfaces.
_KINDS: Mapping[str, str] = {
    "planner": "planners",
    "smoother": "smoothers",
    "controller": "controllers",
    "goal_checker": "goal_checkers",
    "behavior": "behaviors",
    "layer": "layers",
}
# Parameters that Nav2's plugins of each kind read from their node.
_OF_THE_NODE: Mapping[str, tuple[str, ...]] = {
    "behavior": ("cycle_frequency", "simulate_ahead_time"),
    "layer": (
        *("track_unknown_space", "trinary_costmap", "lethal_cost_threshold", "unknown_cost_value"),
        *("inscribed_obstacle_cost_value", "use_maximum"),
    ),
}
_REASONS: Mapping[str, str] = {
    UNLISTED: "it is in no list of plugins",
}
_UNSEEN = "there is no sensor data yet"
_CLASS_REASONS: Mapping[str, str] = {
    "InflationLayer": "the clearance is proven with the exact footprint, so inflated costs change no plan",
    **dict.fromkeys(("ObstacleLayer", "VoxelLayer", "RangeSensorLayer", "NonPersistentVoxelLayer"), _UNSEEN),
}


@dataclass(frozen=True, eq=False)
class Nav2Plugin:
    """One plugin of a Nav2 file, and whether optdock provides it.

    Args:
        instance: Entry of the file.
        plugin: Plugin created with its known parameters; None if it is not provided.
        taken: Parameters of the file that are used.
        reason: Reason why the plugin is not provided; empty if it is provided.
        unknown: Parameters that are not used: unknown parameters, each with the closest known name, and parameters that
            only matter in a ROS graph.
        refused: Whether optdock has the plugin, but the plugin rejects its parameters.
    """

    instance: PluginInstance
    plugin: Plugin | None = None
    taken: Mapping[str, object] = field(default_factory=dict)
    reason: str = ""
    unknown: tuple[str, ...] = ()
    refused: bool = False

    @property
    def outcome(self) -> str:
        """Description in one line: the plugin with the parameters used, or the reason why it is not provided."""
        if self.plugin is None:
            return f"not provided: {self.reason}"
        taken = ", ".join(f"{name}={value}" for name, value in self.taken.items())
        ignored = f"; not read: {', '.join(self.unknown)}" if self.unknown else ""
        return f"{type(self.plugin).__name__}({taken}){ignored}"


def nav2_plugins(params: Nav2Params) -> tuple[Nav2Plugin, ...]:
    """Return all plugins of the file; those that optdock provides are created.

    Unknown parameters are listed but not rejected. Behaviors and layers inherit some parameters of their node, as in
    Nav2.
    """
    return tuple(provided(instance, params) for instance in params.plugins)


def provided(instance: PluginInstance, params: Nav2Params) -> Nav2Plugin:
    """Return one plugin of the file; see `nav2_plugins`."""
    node, kind = params.nodes.get(instance.node, {}), _KINDS.get(instance.kind)
    if kind is None:
        reason = _REASONS.get(instance.kind, f"optdock has no plugins of the kind {instance.kind}")
        return Nav2Plugin(instance, reason=_dock_reason(instance) if instance.kind == "dock" else reason)
    try:
        plugin_class = load_plugin(INTERFACES[kind], instance.nav2_class)
    except PluginError as error:
        if error.__cause__ is not None:  # the plugin is installed but cannot be imported
            return Nav2Plugin(instance, reason=str(error))
        default = f"optdock has no {instance.kind.replace('_', ' ')} of this class"
        reason = _CLASS_REASONS.get(instance.nav2_class.rsplit(":", 1)[-1].rsplit("/", 1)[-1], default)
        return Nav2Plugin(instance, reason=reason)
    fields = plugin_class.Parameters.model_fields
    shared = [name for name in _OF_THE_NODE.get(instance.kind, ()) if name in node and name in fields]
    block = {**{name: node[name] for name in shared}, **instance.parameters}
    extra = _refused(plugin_class, block)
    unknown = tuple(f"{name}{closest(name, fields)}" for name in extra)
    known = _without(block, extra)
    try:
        plugin = create_plugin(INTERFACES[kind], instance.nav2_class, known)
    except (InvalidValue, PluginError) as error:
        return Nav2Plugin(instance, reason=" | ".join(str(error).splitlines()), unknown=unknown, refused=True)
    graph_names = getattr(plugin_class.Parameters, "graph_names", ())  # accepted and ignored
    dropped = tuple(name for name in known if name in graph_names)
    return Nav2Plugin(instance, plugin, _without(known, dropped), unknown=unknown + dropped)


def _dock_reason(instance: PluginInstance) -> str:
    name = instance.nav2_class.replace("/", "::")
    if name in NAV2_DOCKS or "::" not in name:
        return "a dock plugin needs sensors; the docking server of optdock_ros provides it"
    return (
        f"the docking server of optdock_ros refuses it; Nav2's classes that it provides are {' and '.join(NAV2_DOCKS)}"
    )


def _refused(plugin_class: type[Plugin], parameters: Mapping[str, object]) -> tuple[str, ...]:
    """Return the names that the plugin's model forbids, including names in nested blocks."""
    try:
        parse_parameters(plugin_class.Parameters, parameters, "")
    except InvalidValue as error:
        cause = error.__cause__
        faults = cause.errors() if isinstance(cause, ValidationError) else []
        return tuple(str(item["loc"][-1]) for item in faults if item["type"] == "extra_forbidden")
    return ()


def _without(values: Mapping[str, object], names: tuple[str, ...]) -> dict[str, object]:
    """Return a block and its nested blocks without these names."""
    kept = {str(name): value for name, value in values.items() if str(name) not in names}
    return {name: _without(value, names) if isinstance(value, Mapping) else value for name, value in kept.items()}


def nav2_plugin_rows(params: Nav2Params) -> list[tuple[str, str, str, str]]:
    """Return one row per plugin: node, instance, Nav2's class, description of the plugin or reason."""
    return [(p.instance.node, p.instance.name, p.instance.nav2_class, p.outcome) for p in nav2_plugins(params)]


def nav2_costmap_rows(params: Nav2Params) -> list[tuple[str, str, str, str]]:
    """Return one row per costmap: name, resolution, outline, layers and filters."""
    rows = []
    for costmap in params.costmaps.values():
        outline = f"radius {costmap.robot_radius:g} m"
        if costmap.footprint is not None:
            outline = f"footprint {costmap.footprint.length:g} m x {costmap.footprint.width:g} m"
        rows.append(
            (
                costmap.name,
                f"{costmap.resolution:g} m",
                f"{outline}, padded by {costmap.footprint_padding:g} m",
                f"layers: {', '.join(costmap.layers) or 'none'}; filters: {', '.join(costmap.filters) or 'none'}",
            )
        )
    return rows
