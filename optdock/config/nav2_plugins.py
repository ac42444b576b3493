"""What of a Nav2 parameter file optdock provides, and why not the rest."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from optdock.errors import InvalidValue, PluginError
from optdock.parameters import closest
from optdock.plugins import INTERFACES, load_plugin

if TYPE_CHECKING:
    from optdock.io.nav2_params import Nav2Params, PluginInstance
    from optdock.lifecycle import Plugin

__all__ = ["Nav2Plugin", "nav2_plugin_rows", "nav2_plugins"]

# Nav2's kinds of plugins that have an interface here.
_KINDS: Mapping[str, str] = {
    "planner": "planners",
    "smoother": "smoothers",
    "controller": "controllers",
    "goal_checker": "goal_checkers",
    "behavior": "behaviors",
    "layer": "layers",
}
_READ_ELSEWHERE: Mapping[str, str] = {
    "dock": "its staging offsets, direction and threshold are read, the plugin talks to sensors",
}


@dataclass(frozen=True, eq=False)
class Nav2Plugin:
    """One plugin that a Nav2 file asks for, and what became of it.

    Args:
        instance: What the file says.
        plugin: The plugin, built with the parameters it knows; None when it is not provided.
        reason: Why it is not provided; empty when it is.
        unknown: Parameters that the plugin here does not have, each with the nearest one that it has, if any.
    """

    instance: PluginInstance
    plugin: Plugin | None = None
    reason: str = ""
    unknown: tuple[str, ...] = ()


def nav2_plugins(params: Nav2Params) -> tuple[Nav2Plugin, ...]:
    """Every plugin of the file, instantiated where optdock provides it; nothing here is an error.

    Nav2's files carry many parameters that a plugin here does not have: they are listed, not refused.
    """
    return tuple(_resolved(instance) for instance in params.plugins)


def _resolved(instance: PluginInstance) -> Nav2Plugin:
    kind = _KINDS.get(instance.kind)
    if kind is None:
        reason = _READ_ELSEWHERE.get(instance.kind, f"optdock has no plugins of the kind {instance.kind}")
        return Nav2Plugin(instance, reason=reason)
    try:
        plugin_class = load_plugin(INTERFACES[kind], instance.nav2_class)
    except PluginError as error:
        unknown_class = error.__cause__ is None  # otherwise a plugin of ours cannot be imported
        reason = f"optdock has no {instance.kind.replace('_', ' ')} of this class" if unknown_class else str(error)
        return Nav2Plugin(instance, reason=reason)
    fields = plugin_class.Parameters.model_fields
    known = {name: value for name, value in instance.parameters.items() if name in fields}
    unknown = tuple(f"{name}{closest(name, fields)}" for name in instance.parameters if name not in fields)
    try:
        return Nav2Plugin(instance, plugin_class(**known), unknown=unknown)
    except InvalidValue as error:
        return Nav2Plugin(instance, reason=" | ".join(str(error).splitlines()), unknown=unknown)


def nav2_plugin_rows(params: Nav2Params) -> list[tuple[str, str, str, str]]:
    """Node, instance, Nav2's class, and what became of it: one row per plugin."""
    return [(p.instance.node, p.instance.name, p.instance.nav2_class, _outcome(p)) for p in nav2_plugins(params)]


def _outcome(found: Nav2Plugin) -> str:
    if found.plugin is None:
        return f"not provided: {found.reason}"
    ignored = f"; not read: {', '.join(found.unknown)}" if found.unknown else ""
    return f"{type(found.plugin).__name__}{ignored}"
