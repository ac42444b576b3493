"""Nav2's parameter files: which plugins they ask for, their costmaps, dock types and docks.

Pure reading: no plugin is imported here. `optdock.nav2.provided_plugins` instantiates what optdock provides.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from optdock.errors import InvalidFile
from optdock.io.yaml_lines import listed, load_yaml
from optdock.nav2.costmap_params import CostmapParams, read_costmap
from optdock.nav2.docks import DockEntry, DockTypeParams, read_dock, read_dock_type
from optdock.nav2.plugin_lists import PARAMETERS, NodeBlock, PluginInstance, checked_names, plugin_instances

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from optdock.io.yaml_lines import listed
from optdock.io.yaml_lines import Document, Keys

__all__ = ["Nav2Params", "PluginInstance", "load_nav2_params", "with_nested_names"]

N = TypeVar("N", CostmapParams, DockTypeParams, DockEntry)

_COSTMAP_KEYS = ("footprint", "robot_radius", "rolling_window", "inflation_radius")


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
    dock_types: Mapping[str, DockTypeParams]
    docks: Mapping[str, DockEntry]

    def node(self, name: str) -> Mapping[str, object]:
        """Parameters of the first node whose path ends in `name`; empty when there is none."""
        found = (values for path, values in self.nodes.items() if path.rsplit("/", 1)[-1] == name)
        return next(found, {})


def load_nav2_params(source: str | Path) -> Nav2Params:
    """Read a Nav2 parameter file; a bare costmap file, without nodes, counts as one costmap.

    Parameters that nothing reads are kept, not refused. Dotted names count as nested blocks. Where several namespaces
    hold a costmap, dock type or dock of one name, the first counts.

    Raises:
        InvalidFile: The file cannot be read, holds no parameters, has a plugin list that is empty, repeats a name or
            names a plugin without a class, or has a footprint, a dock or a dock type that breaks its rules; the
            message lists every fault.
    """
    document = with_nested_names(load_yaml(source), PARAMETERS)
    blocks = list(_blocks(document.value, ())) or _bare_costmap(document)
    faults: list[str] = []
    plugins = [plugin for block in blocks for plugin in plugin_instances(document, block, faults)]
    costmaps = [_costmap(document, block, faults) for block in blocks if _is_costmap(block)]
    docks = [dock for block in blocks for dock in _docks(document, block, faults)]
    types = [
        read_dock_type(document, plugin.keys, plugin.name, plugin.parameters, faults)
        for plugin in plugins
        if plugin.kind == "dock"
    ]
    if faults:
        raise InvalidFile(listed(str(document.path), faults))
    return Nav2Params(
        source=Path(source),
        nodes={block.path: block.values for block in blocks},
        plugins=tuple(plugins),
        costmaps=_first_of_name(costmaps),
        dock_types=_first_of_name(types),
        docks=_first_of_name(docks),
    )


def _blocks(value: object, keys: Keys) -> Iterator[NodeBlock]:
    """Every `ros__parameters` mapping, however deep its namespaces nest."""
    if not isinstance(value, Mapping):
        return
    for key, inner in value.items():
        if key != PARAMETERS:
            yield from _blocks(inner, (*keys, key))
        elif isinstance(inner, Mapping):
            yield NodeBlock((*keys, key), inner)


def _bare_costmap(document: Document) -> list[NodeBlock]:
    value = document.value
    if isinstance(value, Mapping) and any(key in value for key in _COSTMAP_KEYS):
        return [NodeBlock((), value)]
    raise InvalidFile(f"{document.path}: holds no {PARAMETERS} and no costmap parameters")


def _is_costmap(block: NodeBlock) -> bool:
    return not block.keys or block.path.endswith("costmap")


def _costmap(document: Document, block: NodeBlock, faults: list[str]) -> CostmapParams:
    name = block.path.rsplit("/", 1)[-1] or document.path.stem
    return read_costmap(document, block.keys, name, block.values, faults)


def _docks(document: Document, block: NodeBlock, faults: list[str]) -> Iterator[DockEntry]:
    if "docks" not in block.values:
        return
    for name in checked_names(document, (*block.keys, "docks"), block.values["docks"], faults):
        dock = read_dock(document, (*block.keys, name), faults)
        if dock is not None:
            yield dock


def _first_of_name(named: Iterable[N]) -> dict[str, N]:
    """By name; of several namespaces the first counts, as in `Nav2Params.node`."""
    found: dict[str, N] = {}
    for item in named:
        found.setdefault(item.name, item)
    return found


def with_nested_names(document: Document, below: str) -> Document:
    """The document with every dotted name under a key `below` taken apart; line numbers follow.

    A name that stands there both ways keeps its first value, and a repetition is not looked for.
    """
    lines = dict(document.lines)
    value = _nested(document.value, (), (), lines, below)
    return dataclasses.replace(document, value=value, lines=lines)


def _nested(value: object, old: Keys, new: Keys, lines: dict[Keys, int], below: str) -> object:
    """`value`, found at `old` and put at `new`; names are taken apart once `below` has been passed."""
    if not isinstance(value, Mapping):
        return value
    result: dict[object, object] = {}
    for key, inner in value.items():
        parts = _parts(key) if below in new else (key,)
        place = new + parts
        for n in range(len(new) + 1, len(place) + 1):
            lines.setdefault(place[:n], lines.get((*old, key), 1))
        _put(result, parts, _nested(inner, (*old, key), place, lines, below))
    return result


def _parts(key: str | int) -> Keys:
    parts = str(key).split(".")
    return tuple(parts) if len(parts) > 1 and all(parts) else (key,)


def _put(result: dict[object, object], parts: Keys, value: object) -> None:
    for part in parts[:-1]:
        inner = result.setdefault(part, {})
        if not isinstance(inner, dict):
            return
        result = inner
    present = result.get(parts[-1])
    if isinstance(present, dict) and isinstance(value, dict):
        for key, inner in value.items():
            _put(present, (key,), inner)
    else:
        result.setdefault(parts[-1], value)
