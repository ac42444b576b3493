"""Plugins listed by the nodes of a Nav2 parameter file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

    from optdock.io.yaml_lines import Keys
    from optdock.nav2.parameter_block import ParameterBlock

__all__ = ["UNLISTED", "PluginInstance", "plugin_instances"]

UNLISTED = "unlisted"
"""Kind of a block that has a class but is in no list of its node."""

_COSTMAP_LISTS: Mapping[str, str] = {"plugins": "layer", "filters": "filter"}


@dataclass(frozen=True)
class PluginInstance:
    """One plugin of a parameter file.

    Args:
        node: Path of the node that loads it, such as `controller_server` or `global_costmap/global_costmap`.
        kind: Kind of plugin: `controller`, `planner`, `smoother`, `goal_checker`, `behavior`, `layer`, `filter`,
            `dock`, ... or `UNLISTED`.
        name: Name of the instance; dotted for an instance inside another block.
        nav2_class: Class as named in the file.
        parameters: Other parameters of the block.
        keys: Position of the block in the file.
        line: Line of the class.
    """

    node: str
    kind: str
    name: str
    nav2_class: str
    parameters: Mapping[str, object]
    keys: Keys
    line: int


def plugin_instances(block: ParameterBlock) -> list[PluginInstance]:
    """Return the instances named in the node's lists, then the blocks that have a class but are in no list.

    Lists are `<kind>_plugins`, `plugins` and `filters` of a costmap, a single `<kind>_plugin`, and any other list that
    contains only names of blocks that have a class.
    """
    listed = [found for key in block.values for found in _listed(block, str(key))]
    named = {instance.keys for instance in listed}
    unlisted = [keys for keys in _blocks_with_class(block.values, ()) if (*block.keys, *keys) not in named]
    return [*listed, *(_instance(block, UNLISTED, keys) for keys in unlisted)]


def _listed(block: ParameterBlock, key: str) -> Iterator[PluginInstance]:
    value = block.values.get(key)
    if key in _COSTMAP_LISTS or key.endswith("_plugins"):
        kind = _COSTMAP_LISTS.get(key, key.removesuffix("_plugins"))
        names = block.names(key)
        if value == [] and key not in _COSTMAP_LISTS:
            block.fault(key, message="must name at least one plugin")
        for name in names:
            if _class_of(block, (name,)):
                yield _instance(block, kind, (name,))
            else:
                block.fault(name, "plugin", message=f"is required: {key} lists {name}")
    elif key.endswith("_plugin") and isinstance(value, str) and _class_of(block, (value,)):
        yield _instance(block, key.removesuffix("_plugin"), (value,))
    elif isinstance(value, list) and value and all(isinstance(n, str) and _class_of(block, (n,)) for n in value):
        yield from (_instance(block, key, (name,)) for name in dict.fromkeys(value))


def _blocks_with_class(values: Mapping[str, object], keys: Keys) -> Iterator[Keys]:
    for key, inner in values.items():
        if isinstance(inner, Mapping):
            if isinstance(inner.get("plugin"), str):
                yield (*keys, key)
            yield from _blocks_with_class(inner, (*keys, key))


def _inner(block: ParameterBlock, keys: Keys) -> Mapping[str, object]:
    """Return the mapping at `keys` in the block, or an empty mapping."""
    value: object = block.values
    for key in keys:
        value = value.get(key) if isinstance(value, Mapping) else None
    return value if isinstance(value, Mapping) else {}


def _class_of(block: ParameterBlock, keys: Keys) -> str:
    found = _inner(block, keys).get("plugin")
    return found if isinstance(found, str) else ""


def _instance(block: ParameterBlock, kind: str, keys: Keys) -> PluginInstance:
    parameters = {key: value for key, value in _inner(block, keys).items() if key != "plugin"}
    place = (*block.keys, *keys)
    return PluginInstance(
        node=block.path,
        kind=kind,
        name=".".join(map(str, keys)),
        nav2_class=_class_of(block, keys),
        parameters=parameters,
        keys=place,
        line=block.document.line_of((*place, "plugin")),
    )
