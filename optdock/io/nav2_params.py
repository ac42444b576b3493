"""Nav2's parameter files: which plugins they ask for, their costmaps, dock types and docks.

Pure reading: no plugin is imported here. `optdock.config.nav2_plugins` instantiates what optdock provides.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from optdock.errors import InvalidFile
from optdock.io.dock_database import DockEntry, read_dock
from optdock.io.nav2_costmap import CostmapParams, read_costmap
from optdock.io.nav2_docking import DockType, read_dock_type
from optdock.io.yaml_lines import load_yaml

if TYPE_CHECKING:
    from collections.abc import Iterator

    from optdock.io.yaml_lines import Document, Keys

__all__ = ["Nav2Params", "NodeBlock", "PluginInstance", "load_nav2_params"]

_PARAMETERS = "ros__parameters"
_COSTMAP_KEYS = ("footprint", "robot_radius", "rolling_window", "inflation_radius")


class NodeBlock(NamedTuple):
    """The parameters of one node and where they stand."""

    keys: Keys
    values: Mapping[str, object]

    @property
    def path(self) -> str:
        """Names from the outermost namespace to the node, such as `local_costmap/local_costmap`."""
        return "/".join(str(key).strip("/") for key in self.keys if key != _PARAMETERS)


@dataclass(frozen=True)
class PluginInstance:
    """One plugin that a parameter file asks for.

    Args:
        node: Path of the node that loads it, such as `controller_server` or `global_costmap/global_costmap`.
        kind: What it is: `controller`, `planner`, `smoother`, `goal_checker`, `behavior`, `layer`, `filter`, `dock`...
        name: Name of the instance.
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


@dataclass(frozen=True, eq=False)
class Nav2Params:
    """What a parameter file says.

    Args:
        source: The file.
        nodes: All parameters of every node, by the node's path.
        plugins: The plugins asked for, in the order of the file.
        costmaps: Costmaps by name, such as `local_costmap`.
        dock_types: Dock plugin instances by name.
        docks: Docks listed in the file itself, by name.
    """

    source: Path
    nodes: Mapping[str, Mapping[str, object]]
    plugins: tuple[PluginInstance, ...]
    costmaps: Mapping[str, CostmapParams]
    dock_types: Mapping[str, DockType]
    docks: Mapping[str, DockEntry]

    def node(self, name: str) -> Mapping[str, object]:
        """Parameters of the first node whose path ends in `name`; empty when there is none."""
        found = (values for path, values in self.nodes.items() if path.rsplit("/", 1)[-1] == name)
        return next(found, {})


def load_nav2_params(source: str | Path) -> Nav2Params:
    """Read a Nav2 parameter file; a bare costmap file, without nodes, counts as one costmap.

    Parameters that nothing reads are kept, not refused.

    Raises:
        InvalidFile: The file cannot be read, holds no parameters, lists a plugin without a class, or has a footprint,
            a dock or a dock type that breaks its rules; the message lists every fault.
    """
    document = load_yaml(source)
    blocks = list(_blocks(document.value, ())) or _bare_costmap(document)
    faults: list[str] = []
    plugins = [plugin for block in blocks for plugin in _plugins(document, block, faults)]
    costmaps = [_costmap(document, block, faults) for block in blocks if _is_costmap(block)]
    docks = [dock for block in blocks for dock in _docks(document, block, faults)]
    types = [
        read_dock_type(document, plugin.keys, plugin.name, plugin.parameters, faults)
        for plugin in plugins
        if plugin.kind == "dock"
    ]
    if faults:
        raise InvalidFile("\n".join(faults))
    return Nav2Params(
        source=Path(source),
        nodes={block.path: block.values for block in blocks},
        plugins=tuple(plugins),
        costmaps={costmap.name: costmap for costmap in costmaps},
        dock_types={dock_type.name: dock_type for dock_type in types},
        docks={dock.name: dock for dock in docks},
    )


def _blocks(value: object, keys: Keys) -> Iterator[NodeBlock]:
    """Every `ros__parameters` mapping, however deep its namespaces nest."""
    if not isinstance(value, Mapping):
        return
    for key, inner in value.items():
        if key != _PARAMETERS:
            yield from _blocks(inner, (*keys, key))
        elif isinstance(inner, Mapping):
            yield NodeBlock((*keys, key), inner)


def _bare_costmap(document: Document) -> list[NodeBlock]:
    value = document.value
    if isinstance(value, Mapping) and any(key in value for key in _COSTMAP_KEYS):
        return [NodeBlock((), value)]
    raise InvalidFile(f"{document.path}: holds no {_PARAMETERS} and no costmap parameters")


def _is_costmap(block: NodeBlock) -> bool:
    return not block.keys or block.path.endswith("costmap")


def _costmap(document: Document, block: NodeBlock, faults: list[str]) -> CostmapParams:
    name = block.path.rsplit("/", 1)[-1] or document.path.stem
    return read_costmap(document, block.keys, name, block.values, faults)


def _plugins(document: Document, block: NodeBlock, faults: list[str]) -> Iterator[PluginInstance]:
    """The instances that the node's lists name: `<kind>_plugins`, a costmap's `plugins` and `filters`, and others."""
    for key, names in block.values.items():
        if not (isinstance(names, list) and names and all(isinstance(name, str) for name in names)):
            continue
        kind = _kind(key)
        certain = kind != key
        if not certain and not all(_class_of(block, name) for name in names):
            continue
        for name in names:
            place = (*block.keys, name)
            if _class_of(block, name):
                yield _instance(document, block, kind, name)
            else:
                faults.append(document.fault((*place, "plugin"), f"is required: {key} lists {name}"))


def _kind(key: str) -> str:
    return {"plugins": "layer", "filters": "filter"}.get(key, key.removesuffix("_plugins"))


def _class_of(block: NodeBlock, name: str) -> str:
    inner = block.values.get(name)
    found = inner.get("plugin") if isinstance(inner, Mapping) else None
    return found if isinstance(found, str) else ""


def _instance(document: Document, block: NodeBlock, kind: str, name: str) -> PluginInstance:
    inner, keys = block.values[name], (*block.keys, name)
    parameters = {key: v for key, v in inner.items() if key != "plugin"} if isinstance(inner, Mapping) else {}
    return PluginInstance(
        block.path, kind, name, _class_of(block, name), parameters, keys, document.line_of((*keys, "plugin"))
    )


def _docks(document: Document, block: NodeBlock, faults: list[str]) -> Iterator[DockEntry]:
    names = block.values.get("docks")
    for name in names if isinstance(names, list) else ():
        dock = read_dock(document, (*block.keys, str(name)), faults)
        if dock is not None:
            yield dock
