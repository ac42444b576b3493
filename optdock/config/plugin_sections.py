"""Plugin sections of a scenario: `{plugin: NAME, parameter: value, ...}`."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import TYPE_CHECKING

from pydantic import ValidationError

from optdock.errors import PluginError
from optdock.io.faults import Fault, faults_of
from optdock.io.numbers import is_number, unit_fault
from optdock.io.quoting import shown
from optdock.planning.pipeline import DEFAULT_PLANNERS, DEFAULT_SMOOTHER, DEFAULT_TIMING
from optdock.plugins.registry import INTERFACES, PluginChoice, load_plugin

if TYPE_CHECKING:
    from optdock.plugins.lifecycle import Plugin

__all__ = ["PLUGIN_DEFAULTS", "planners", "plugin_choice", "plural"]

# Default plugins of the sections; of the planners only the first, because only its parameters may be given.
PLUGIN_DEFAULTS: Mapping[str, str] = {
    "planner": DEFAULT_PLANNERS[0],
    "smoother": DEFAULT_SMOOTHER,
    "timing": DEFAULT_TIMING,
    "controller": "TrackingController",
    "goal_checker": "DockGoalChecker",
}
_UNIT = re.compile(r"\[(rad|m/s)\]$")


def plugin_choice(kind: str, section: object, faults: list[Fault]) -> PluginChoice:
    """Return the plugin and the parameters of a section.

    Args:
        kind: Key of the section.
        section: Value of the key; the model reports values that are not mappings.
        faults: List to which an unknown plugin and invalid parameters are added.
    """
    name = PLUGIN_DEFAULTS[kind]
    if not isinstance(section, Mapping):
        return PluginChoice(name, {})
    chosen = section.get("plugin", name)
    parameters = {str(key): value for key, value in section.items() if key != "plugin"}
    if not section:
        return PluginChoice(name, {})
    if not isinstance(chosen, str):
        faults.append(Fault((kind, "plugin"), f"must be text, got {shown(chosen)}"))
        return PluginChoice(name, {})
    try:
        plugin = load_plugin(INTERFACES[plural(kind)], chosen)
    except PluginError as error:
        faults.append(Fault((kind, "plugin"), str(error)))
        return PluginChoice(name, {})
    faults.extend(parameter_faults(plugin, parameters, (kind,)))
    return PluginChoice(chosen, parameters)


def planners(choice: PluginChoice, section: object) -> tuple[PluginChoice, ...]:
    """Return the named planner, or the default planners with the given parameters for the first of them.

    Args:
        choice: Result of `plugin_choice`.
        section: The section.
    """
    if isinstance(section, Mapping) and "plugin" in section:
        return (choice,)
    return (choice, *(PluginChoice(name) for name in DEFAULT_PLANNERS[1:]))


def parameter_faults(plugin: type[Plugin], parameters: Mapping[str, object], base: tuple[str, ...]) -> list[Fault]:
    """Return the faults of the parameters of a plugin."""
    fields = {spec.alias or name: spec for name, spec in plugin.Parameters.model_fields.items()}
    try:
        plugin.Parameters.model_validate(dict(parameters))
    except ValidationError as error:
        return faults_of(error, lambda key: fields if not key else (), base)
    # The description of every field ends with its unit.
    given = ((name, value, _UNIT.search(fields[name].description or "")) for name, value in parameters.items())
    checked = ((name, unit_fault(value, unit[1])) for name, value, unit in given if unit and is_number(value))
    return [Fault((*base, name), fault) for name, fault in checked if fault]


def plural(kind: str) -> str:
    """Return the kind of plugins that a section selects, one of `INTERFACES`."""
    return kind if kind == "timing" else f"{kind}s"
