"""What of a Nav2 parameter file optdock provides, and why not the rest."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from pydantic import ValidationError

from optdock.errors import InvalidValue, PluginError
from optdock.nav2.layers.base import LayerParameters
from optdock.nav2.plugin_lists import UNLISTED
from optdock.plugins.parameters import closest, parse_parameters
from optdock.plugins.registry import INTERFACES, create_plugin, load_plugin

if TYPE_CHECKING:
    from optdock.nav2.costmap_params import CostmapParams
    from optdock.nav2.params import Nav2Params, PluginInstance
    from optdock.plugins.lifecycle import Plugin

__all__ = ["Nav2Plugin", "nav2_costmap_rows", "nav2_plugin_rows", "nav2_plugins", "provided"]

# Nav2's kinds of plugins that have an interface here.
_KINDS: Mapping[str, str] = {
    "planner": "planners",
    "smoother": "smoothers",
    "controller": "controllers",
    "goal_checker": "goal_checkers",
    "behavior": "behaviors",
    "layer": "layers",
}
# Parameters that Nav2's plugins of a kind read from their node instead of their own block.
_OF_THE_NODE: Mapping[str, tuple[str, ...]] = {
    "behavior": ("cycle_frequency", "simulate_ahead_time"),
    "layer": (
        *("track_unknown_space", "trinary_costmap", "lethal_cost_threshold", "unknown_cost_value"),
        *("inscribed_obstacle_cost_value", "use_maximum"),
    ),
}
_REASONS: Mapping[str, str] = {
    "dock": "its staging offsets, direction and threshold are read, the plugin talks to sensors",
    UNLISTED: "no list of plugins names it",
}
_UNSEEN = "nothing has been seen yet"
_CLASS_REASONS: Mapping[str, str] = {
    "InflationLayer": "clearance is proven with the exact footprint, inflated costs change no plan",
    **dict.fromkeys(("ObstacleLayer", "VoxelLayer", "RangeSensorLayer", "NonPersistentVoxelLayer"), _UNSEEN),
}


@dataclass(frozen=True, eq=False)
class Nav2Plugin:
    """One plugin that a Nav2 file asks for, and what became of it.

    Args:
        instance: What the file says.
        plugin: The plugin, built with the parameters it knows; None when it is not provided.
        taken: The parameters of the file that count.
        reason: Why it is not provided; empty when it is.
        unknown: Parameters that the plugin here does not read: those it does not have, each with the nearest one that
            it has, if any, and those that mean something on a ROS graph only.
        refused: Whether there is such a plugin here, but it refuses its parameters.
    """

    instance: PluginInstance
    plugin: Plugin | None = None
    taken: Mapping[str, object] = field(default_factory=dict)
    reason: str = ""
    unknown: tuple[str, ...] = ()
    refused: bool = False

    @property
    def outcome(self) -> str:
        """What became of it, on one line: the plugin with the parameters taken, or why there is none."""
        if self.plugin is None:
            return f"not provided: {self.reason}"
        taken = ", ".join(f"{name}={value}" for name, value in self.taken.items())
        ignored = f"; not read: {', '.join(self.unknown)}" if self.unknown else ""
        return f"{type(self.plugin).__name__}({taken}){ignored}"


def nav2_plugins(params: Nav2Params) -> tuple[Nav2Plugin, ...]:
    """Every plugin of the file, instantiated where optdock provides it; nothing here is an error.

    Nav2's files carry many parameters that a plugin here does not have: they are listed, not refused. Behaviors and
    layers take what their own block leaves out from their node, where Nav2 keeps it.
    """
    return tuple(provided(instance, params) for instance in params.plugins)


def provided(instance: PluginInstance, params: Nav2Params) -> Nav2Plugin:
    """One plugin of the file; see `nav2_plugins`."""
    node, kind = params.nodes.get(instance.node, {}), _KINDS.get(instance.kind)
    if kind is None:
        reason = _REASONS.get(instance.kind, f"optdock has no plugins of the kind {instance.kind}")
        return Nav2Plugin(instance, reason=reason)
    try:
        plugin_class = load_plugin(INTERFACES[kind], instance.nav2_class)
    except PluginError as error:
        unknown_class = error.__cause__ is None  # otherwise a plugin of ours cannot be imported
        known_reason = _CLASS_REASONS.get(instance.nav2_class.rsplit(":", 1)[-1].rsplit("/", 1)[-1])
        reason = known_reason or f"optdock has no {instance.kind.replace('_', ' ')} of this class"
        reason = reason if unknown_class else str(error)
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
    dropped = _of_the_graph(plugin_class, known)
    return Nav2Plugin(instance, plugin, _without(known, dropped), unknown=unknown + dropped)


def _refused(plugin_class: type[Plugin], parameters: Mapping[str, object]) -> tuple[str, ...]:
    """Names that the plugin's own model does not accept, however it takes a block apart."""
    try:
        parse_parameters(plugin_class.Parameters, parameters, "")
    except InvalidValue as error:
        cause = error.__cause__
        faults = cause.errors() if isinstance(cause, ValidationError) else []
        return tuple(str(item["loc"][-1]) for item in faults if item["type"] == "extra_forbidden")
    return ()


def _of_the_graph(plugin_class: type[Plugin], values: Mapping[str, object]) -> tuple[str, ...]:
    """Names in the block and the blocks in it that the plugin accepts and drops."""
    model = plugin_class.Parameters
    if not issubclass(model, LayerParameters):
        return ()
    here = [name for name in values if name in model.graph_names]
    inner = [
        name for value in values.values() if isinstance(value, Mapping) for name in _of_the_graph(plugin_class, value)
    ]
    return tuple(dict.fromkeys((*here, *inner)))


def _without(values: Mapping[str, object], names: tuple[str, ...]) -> dict[str, object]:
    """The block and the blocks in it without these names."""
    kept = {str(name): value for name, value in values.items() if str(name) not in names}
    return {name: _without(value, names) if isinstance(value, Mapping) else value for name, value in kept.items()}


def nav2_plugin_rows(params: Nav2Params) -> list[tuple[str, str, str, str]]:
    """Node, instance, Nav2's class, and what became of it with which parameters: one row per plugin."""
    return [(p.instance.node, p.instance.name, p.instance.nav2_class, p.outcome) for p in nav2_plugins(params)]


def nav2_costmap_rows(params: Nav2Params) -> list[tuple[str, str, str, str]]:
    """Name, resolution, outline and layers: one row per costmap."""
    return [
        (
            costmap.name,
            f"{costmap.resolution:g} m",
            f"{'radius' if costmap.footprint is None else 'footprint'} {_outline(costmap)}",
            f"layers: {', '.join(costmap.layers) or 'none'}; filters: {', '.join(costmap.filters) or 'none'}",
        )
        for costmap in params.costmaps.values()
    ]


def _outline(costmap: CostmapParams) -> str:
    padding = f"padded by {costmap.footprint_padding:g} m"
    if costmap.footprint is None:
        return f"{costmap.robot_radius:g} m, {padding}"
    return f"{costmap.footprint.length:g} m x {costmap.footprint.width:g} m, {padding}"
