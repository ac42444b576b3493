"""Which plugins the nodes of a Nav2 parameter file ask for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from optdock.io.quoting import shown

if TYPE_CHECKING:
    from collections.abc import Iterator

    from optdock.io.yaml_lines import Document, Keys

__all__ = ["PARAMETERS", "UNLISTED", "NodeBlock", "PluginInstance", "checked_names", "plugin_instances"]

PARAMETERS = "ros__parameters"
UNLISTED = "unlisted"
"""Kind of a block with a class that no list of its node names."""

_COSTMAP_LISTS: Mapping[str, str] = {"plugins": "layer", "filters": "filter"}


class NodeBlock(NamedTuple):
    """The parameters of one node and where they stand."""

    keys: Keys
    values: Mapping[str, object]

    @property
    def path(self) -> str:
        """Names from the outermost namespace to the node, such as `local_costmap/local_costmap`."""
        return "/".join(str(key).strip("/") for key in self.keys if key != PARAMETERS)


@dataclass(frozen=True)
class PluginInstance:
    """One plugin that a parameter file asks for.

    Args:
        node: Path of the node that loads it, such as `controller_server` or `global_costmap/global_costmap`.
        kind: What it is: `controller`, `planner`, `smoother`, `goal_checker`, `behavior`, `layer`, `filter`, `dock`...
            or `UNLISTED`.
        name: Name of the instance; of one inside another block, dotted.
        nav2_class: Its class, as the file names it.
        parameters: Its other parameters.
        keys: Where its block stands in the file.
        line: The line there.
    """

    node: str
    kind: str
    name: str
    nav2_class: str
    parameters: Mapping[str, object]
    keys: Keys
    line: int


def plugin_instances(document: Document, block: NodeBlock, faults: list[str]) -> list[PluginInstance]:
    """The instances that the node's lists name, then the blocks with a class that no list names.

    Lists are `<kind>_plugins`, a costmap's `plugins` and `filters`, a single `<kind>_plugin`, and whatever else holds
    nothing but names of blocks with a class. Faults are added to `faults`.
    """
    listed = [found for key in block.values for found in _listed(document, block, str(key), faults)]
    named = {instance.keys for instance in listed}
    unlisted = (
        _instance(document, block, UNLISTED, keys)
        for keys in _blocks_with_class(block.values, ())
        if (*block.keys, *keys) not in named
    )
    return [*listed, *unlisted]


def checked_names(document: Document, keys: Keys, value: object, faults: list[str]) -> tuple[str, ...]:
    """A list of different names, or what is right in it; faults are added to `faults`."""
    if not isinstance(value, list):
        faults.append(document.fault(keys, f"must be a list of names, got {shown(value)}"))
        return ()
    wrong = [name for name in value if not (isinstance(name, str) and name)]
    faults.extend(document.fault(keys, f"must be a list of names, got {shown(name)} in it") for name in wrong)
    names = [name for name in value if isinstance(name, str) and name]
    twice = dict.fromkeys(name for name in names if names.count(name) > 1)
    faults.extend(document.fault(keys, f"names {name} more than once") for name in twice)
    return tuple(dict.fromkeys(names))


def _listed(document: Document, block: NodeBlock, key: str, faults: list[str]) -> Iterator[PluginInstance]:
    value, place = block.values.get(key), (*block.keys, key)
    is_costmap_list = key in _COSTMAP_LISTS
    if is_costmap_list or key.endswith("_plugins"):
        names = checked_names(document, place, value, faults)
        if value == [] and not is_costmap_list:
            faults.append(document.fault(place, "must name at least one plugin"))
        kind = _COSTMAP_LISTS.get(key, key.removesuffix("_plugins"))
        yield from _required(document, block, key, kind, names, faults)
    elif key.endswith("_plugin") and isinstance(value, str) and _class_of(block, (value,)):
        yield _instance(document, block, key.removesuffix("_plugin"), (value,))
    elif isinstance(value, list) and value and all(isinstance(n, str) and _class_of(block, (n,)) for n in value):
        yield from (_instance(document, block, key, (name,)) for name in dict.fromkeys(value))


def _required(
    document: Document, block: NodeBlock, key: str, kind: str, names: tuple[str, ...], faults: list[str]
) -> Iterator[PluginInstance]:
    for name in names:
        if _class_of(block, (name,)):
            yield _instance(document, block, kind, (name,))
        else:
            faults.append(document.fault((*block.keys, name, "plugin"), f"is required: {key} lists {name}"))


def _at(block: NodeBlock, keys: Keys) -> object:
    value: object = block.values
    for key in keys:
        value = value.get(key) if isinstance(value, Mapping) else None
    return value


def _class_of(block: NodeBlock, keys: Keys) -> str:
    inner = _at(block, keys)
    found = inner.get("plugin") if isinstance(inner, Mapping) else None
    return found if isinstance(found, str) else ""


def _blocks_with_class(values: Mapping[str, object], keys: Keys) -> Iterator[Keys]:
    for key, inner in values.items():
        if isinstance(inner, Mapping):
            if isinstance(inner.get("plugin"), str):
                yield (*keys, key)
            yield from _blocks_with_class(inner, (*keys, key))


def _instance(document: Document, block: NodeBlock, kind: str, keys: Keys) -> PluginInstance:
    inner, place = _at(block, keys), (*block.keys, *keys)
    parameters = {key: v for key, v in inner.items() if key != "plugin"} if isinstance(inner, Mapping) else {}
    name, line = ".".join(map(str, keys)), document.line_of((*place, "plugin"))
    return PluginInstance(block.path, kind, name, _class_of(block, keys), parameters, place, line)
