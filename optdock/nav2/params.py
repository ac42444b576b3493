"""Nav2's parameter files: plugins, costmaps, dock types and docks.

This module imports no plugin; `optdock.nav2.provided_plugins` creates the plugins that optdock provides.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from optdock.errors import InvalidFile, InvalidValue
from optdock.geometry.footprint import Footprint
from optdock.io.numbers import check_outline
from optdock.io.quoting import listed
from optdock.io.yaml_lines import load_yaml
from optdock.nav2.docks import DockEntry, DockTypeParams, read_dock, read_dock_type
from optdock.nav2.parameter_block import PARAMETERS, ParameterBlock
from optdock.nav2.plugin_lists import PluginInstance, plugin_instances

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from optdock.io.yaml_lines import Document, Keys

__all__ = ["CostmapParams", "Nav2Params", "load_nav2_params"]

N = TypeVar("N", "CostmapParams", DockTypeParams, DockEntry)

_COSTMAP_KEYS = ("footprint", "robot_radius", "rolling_window", "inflation_radius")
_NO_FOOTPRINT = ("", "[]")


@dataclass(frozen=True, eq=False)
class CostmapParams:
    """Parameters of a costmap.

    Args:
        name: Name, such as `global_costmap`.
        footprint: Outline of the robot; None if `robot_radius` is used.
        robot_radius: Radius of a round robot [m].
        footprint_padding: Distance by which every vertex is moved outward [m].
        resolution: Side of a cell [m].
        global_frame: Name of the coordinate frame.
        layers: Names of the layers, from bottom to top.
        filters: Names of the filters.
    """

    name: str
    footprint: Footprint | None = None
    robot_radius: float = 0.1
    footprint_padding: float = 0.01
    resolution: float = 0.1
    global_frame: str = "map"
    layers: tuple[str, ...] = ()
    filters: tuple[str, ...] = ()

    @property
    def outline(self) -> Footprint:
        """Padded footprint."""
        given = self.footprint if self.footprint is not None else Footprint.from_radius(self.robot_radius)
        return given.padded(self.footprint_padding)


@dataclass(frozen=True, eq=False)
class Nav2Params:
    """Content of a parameter file.

    Args:
        source: The file.
        nodes: Parameters of every node, by the path of the node.
        plugins: Plugins in the order of the file.
        costmaps: Costmaps by name, such as `local_costmap`.
        dock_types: Dock plugin instances by name.
        docks: Docks listed in the file, by name.
    """

    source: Path
    nodes: Mapping[str, Mapping[str, object]]
    plugins: tuple[PluginInstance, ...]
    costmaps: Mapping[str, CostmapParams]
    dock_types: Mapping[str, DockTypeParams]
    docks: Mapping[str, DockEntry]

    def node(self, name: str) -> Mapping[str, object]:
        """Return the parameters of the first node whose path ends in `name`, or an empty mapping."""
        found = (values for path, values in self.nodes.items() if path.rsplit("/", 1)[-1] == name)
        return next(found, {})


def load_nav2_params(source: str | Path) -> Nav2Params:
    """Read a Nav2 parameter file, or a bare costmap file without nodes.

    Unknown parameters are kept. Dotted names are read as nested blocks. If several namespaces contain a costmap, dock
    type or dock of the same name, the first is used.

    Raises:
        InvalidFile: If the file cannot be read, contains no parameters, has a plugin list that is empty, repeats a name
            or names a plugin without a class, or has an invalid footprint, dock or dock type; the message lists all
            faults.
    """
    document = _with_nested_names(load_yaml(source))
    faults: list[str] = []
    blocks = [ParameterBlock(document, keys, values, faults) for keys, values in _nodes(document)]
    plugins = [plugin for block in blocks for plugin in plugin_instances(block)]
    costmaps = [_read_costmap(block) for block in blocks if not block.keys or block.path.endswith("costmap")]
    docks = [dock for block in blocks if "docks" in block.values for dock in _read_docks(block)]
    backwards = {block.path: block.values.get("dock_backwards") for block in blocks}
    types = [
        read_dock_type(
            plugin.name,
            ParameterBlock(document, plugin.keys, plugin.parameters, faults),
            dock_backwards=backwards[plugin.node],
        )
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


def _nodes(document: Document) -> list[tuple[Keys, Mapping[str, object]]]:
    """Return the position and the content of every `ros__parameters` mapping, or of a bare costmap."""
    found = list(_parameter_mappings(document.value, ()))
    value = document.value
    if found:
        return found
    if isinstance(value, Mapping) and any(key in value for key in _COSTMAP_KEYS):
        return [((), value)]
    raise InvalidFile(f"{document.path}: contains no {PARAMETERS} and no costmap parameters")


def _parameter_mappings(value: object, keys: Keys) -> Iterator[tuple[Keys, Mapping[str, object]]]:
    if not isinstance(value, Mapping):
        return
    for key, inner in value.items():
        if key != PARAMETERS:
            yield from _parameter_mappings(inner, (*keys, key))
        elif isinstance(inner, Mapping):
            yield (*keys, key), inner


def _read_costmap(block: ParameterBlock) -> CostmapParams:
    costmap = CostmapParams(
        name=block.path.rsplit("/", 1)[-1] or block.document.path.stem,
        footprint=_read_footprint(block),
        robot_radius=block.number("robot_radius", 0.1, positive=True, unit="m"),
        footprint_padding=block.number("footprint_padding", 0.01, unit="m"),
        resolution=block.number("resolution", 0.1, positive=True),
        global_frame=block.text("global_frame", "map"),
        layers=_names(block.values.get("plugins")),
        filters=_names(block.values.get("filters")),
    )
    try:
        _ = costmap.outline
    except InvalidValue as error:
        block.fault("footprint_padding", message=f"leaves no footprint: {error}")
    return costmap


def _read_footprint(block: ParameterBlock) -> Footprint | None:
    """Return the footprint, or None if it is empty. Nav2 also uses the radius if the text is invalid."""
    value = block.values.get("footprint", "[]")
    text = value.strip() if isinstance(value, str) else str(value)
    if text in _NO_FOOTPRINT:
        return None
    try:
        footprint = Footprint.from_string(text)
        check_outline(footprint)
    except InvalidValue as error:
        block.fault("footprint", message=str(error).removeprefix("footprint: "))
        return None
    return footprint


def _names(value: object) -> tuple[str, ...]:
    return tuple(str(name) for name in value) if isinstance(value, list) else ()


def _read_docks(block: ParameterBlock) -> Iterator[DockEntry]:
    for name in block.names("docks"):
        dock = read_dock(block.document, (*block.keys, name), block.faults)
        if dock is not None:
            yield dock


def _first_of_name(named: Iterable[N]) -> dict[str, N]:
    found: dict[str, N] = {}
    for item in named:
        found.setdefault(item.name, item)
    return found


def _with_nested_names(document: Document) -> Document:
    """Return a document with every dotted parameter name split into nested blocks; line numbers are preserved.

    If a name is given in both notations, its first value is used.
    """
    lines = dict(document.lines)
    value = _nested(document.value, (), (), lines)
    return dataclasses.replace(document, value=value, lines=lines)


def _nested(value: object, old: Keys, new: Keys, lines: dict[Keys, int]) -> object:
    """Return `value` with dotted names in parameter blocks split into nested blocks.

    Line numbers found in `lines` under the key path `old` are added under `new`.
    """
    if not isinstance(value, Mapping):
        return value
    result: dict[object, object] = {}
    for key, inner in value.items():
        parts = _parts(key) if PARAMETERS in new else (key,)
        place = new + parts
        for n in range(len(new) + 1, len(place) + 1):
            lines.setdefault(place[:n], lines.get((*old, key), 1))
        _put(result, parts, _nested(inner, (*old, key), place, lines))
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
