"""The plugins that a Nav2 server's parameters name."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Generic, TypeVar

from optdock.errors import OptdockError
from optdock.nav2.params import Nav2Params
from optdock.nav2.plugin_lists import PluginInstance
from optdock.nav2.provided_plugins import provided
from optdock.plugins.lifecycle import Plugin
from optdock.plugins.parameters import parse_parameters
from optdock.plugins.registry import PluginChoice, create_plugin, load_plugin

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from optdock.plugins.lifecycle import PluginContext

__all__ = ["NamedPlugin", "named_plugins"]

P = TypeVar("P", bound=Plugin)


@dataclass(frozen=True)
class NamedPlugin(Generic[P]):
    """A plugin as the parameters ask for it, judged; every task has one of its own made.

    So a change of parameters is wholly in a task or not at all, and what a plugin has got into in one task does not
    reach the next.

    Args:
        name: Of the instance.
        interface: What it is.
        choice: Its class, as the parameters name it, and the parameters that count.
        not_read: Its other parameters, each with a hint where it looks misspelt.
    """

    name: str
    interface: type[P]
    choice: PluginChoice
    not_read: tuple[str, ...] = ()

    @property
    def plugin_class(self) -> type[P]:
        """Its class."""
        return load_plugin(self.interface, self.choice.name)

    @contextmanager
    def made(self, context: PluginContext) -> Iterator[P]:
        """The plugin, configured and active; shut down afterwards, however its work ends.

        Raises:
            OptdockError: It refuses its surroundings.
        """
        plugin = create_plugin(self.interface, self.choice.name, self.choice.parameters)
        try:
            plugin.configure(context)
            plugin.activate()
            yield plugin
        finally:
            plugin.shutdown()


def named_plugins(
    node: str, kind: str, interface: type[P], names: tuple[str, ...], block: Mapping[str, object]
) -> tuple[dict[str, NamedPlugin[P]], list[str]]:
    """The plugins that a node's list names, and what is wrong with them, one line per fault.

    Nav2's files carry parameters that a plugin here does not have: under Nav2's class names they are not read, and
    told. Under a name of ours, which only files for this server have, they are refused.

    Args:
        node: Name of the node.
        kind: `smoother`, `planner`, ...
        interface: Of that kind.
        names: What the list says.
        block: All parameters of the node, nested.
    """
    params = Nav2Params(Path(), {node: block}, (), {}, {}, {})
    found: dict[str, NamedPlugin[P]] = {}
    faults = [] if names else [f"{kind}_plugins: must name at least one plugin"]
    faults += [f"{kind}_plugins: names {name} more than once" for name in dict.fromkeys(names) if names.count(name) > 1]
    for name in dict.fromkeys(names):
        own = block.get(name)
        nav2_class = own.get("plugin") if isinstance(own, dict) else None
        if not isinstance(own, dict) or not isinstance(nav2_class, str):
            faults.append(f"{name}.plugin: is required: {kind}_plugins lists {name}")
            continue
        rest = {key: value for key, value in own.items() if key != "plugin"}
        answer = provided(PluginInstance(node, kind, name, nav2_class, rest, (name,), 0), params)
        is_ours = not {":", "/"} & set(nav2_class)
        refused = _refused(interface, nav2_class, name, rest) if is_ours and (answer.unknown or answer.refused) else []
        faults += refused
        if answer.plugin is None and not refused:
            faults.append(f"Failed to create {kind} {name} of type {nav2_class}: {answer.outcome}")
        elif not refused:
            found[name] = NamedPlugin(name, interface, PluginChoice(nav2_class, dict(answer.taken)), answer.unknown)
    return found, faults


def _refused(interface: type[Plugin], plugin: str, name: str, parameters: Mapping[str, object]) -> list[str]:
    """What a plugin's own model says of all its parameters."""
    try:
        parse_parameters(load_plugin(interface, plugin).Parameters, parameters, name)
    except OptdockError as error:
        return str(error).splitlines()
    return []
