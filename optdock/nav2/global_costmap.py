"""The global costmap that a parameter file describes, over a map: its layers in order, and what became of each."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from optdock.errors import InvalidFile
from optdock.nav2.layered_costmap import LayeredCostmap
from optdock.nav2.layers.dock_layer import DockLayer
from optdock.nav2.layers.static import StaticLayer
from optdock.nav2.provided_plugins import Nav2Plugin, provided
from optdock.plugins.interfaces import Layer

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from optdock.geometry.pose import Pose2
    from optdock.model.costmap import Costmap, OccupancyGrid
    from optdock.model.dock import Dock
    from optdock.nav2.costmap_params import CostmapParams
    from optdock.nav2.params import Nav2Params
    from optdock.nav2.plugin_lists import PluginInstance

__all__ = ["FileCostmap", "file_costmap"]

_ADDED = "static_layer"
_NO_FILTERS = "optdock has no filters; what it forbids is not in the costmap"


class FileCostmap(NamedTuple):
    """A costmap, and one row per part of the file's costmaps: its name, and what became of it."""

    costmap: Costmap
    rows: tuple[tuple[str, str], ...]


def file_costmap(
    params: Nav2Params, described: CostmapParams, grid: OccupancyGrid, start: Pose2, dock: Dock
) -> FileCostmap:
    """The costmap `described`, in the place and size of the map, as it is before any sensor has seen anything.

    The layers that optdock provides write it in the file's order with the file's parameters. Layers of sensors have
    seen nothing yet, and inflation changes no plan here, since clearance is proven with the exact footprint: both are
    left out. Without a static layer in the file one is put under the others, because the map was given.

    Args:
        params: The parameter file.
        described: Which of its costmaps.
        grid: The map.
        start: Where the robot is, for layers that free the cells under it.
        dock: The dock, for a `DockLayer`.

    Raises:
        InvalidFile: A layer that optdock provides refuses its parameters.
    """
    node = _node_of(params, described)
    listed = [p for p in params.plugins if p.node == node and p.kind in ("layer", "filter")]
    layers, rows = _layers(params, listed, grid, dock)
    tracked = params.nodes[node].get("track_unknown_space")
    built = LayeredCostmap.of_map(grid, layers, described.outline, track_unknown_space=tracked is not False)
    known = built.update(start)
    others = [(name, _why_not(name)) for name in params.costmaps if name != described.name]
    head = (described.name, _place(grid, rolls=params.nodes[node].get("rolling_window") is True))
    keeps = all(layer.parameters.track_unknown_space for layer in layers.values() if isinstance(layer, StaticLayer))
    return FileCostmap(known, (head, ("unknown cells", _unknown(tracked, keeps=keeps)), *rows, *others))


def _node_of(params: Nav2Params, described: CostmapParams) -> str:
    """Path of the node that holds the costmap's parameters; a file without nodes is one costmap of the file's name."""
    return next(path for path in params.nodes if (path.rsplit("/", 1)[-1] or params.source.stem) == described.name)


def _layers(
    params: Nav2Params, listed: Sequence[PluginInstance], grid: OccupancyGrid, dock: Dock
) -> tuple[dict[str, Layer], list[tuple[str, str]]]:
    layers: dict[str, Layer] = {}
    rows: list[tuple[str, str]] = []
    for instance in listed:
        found = provided(instance, params)
        if found.refused:
            raise InvalidFile(f"{params.source}:{instance.line}: {instance.name}: {found.reason}")
        layer, outcome = _used(found, grid, dock, has_map=_has_map(layers))
        rows.append((instance.name, outcome))
        if layer is not None:
            layers[instance.name] = layer
    if _has_map(layers):
        return layers, rows
    static = StaticLayer()
    static.set_map(grid)
    name = _ADDED if _ADDED not in layers else f"{_ADDED} of the map"
    return {name: static, **layers}, [(name, "added: the file uses none, but a map was given"), *rows]


def _has_map(layers: Mapping[str, Layer]) -> bool:
    return any(isinstance(layer, StaticLayer) for layer in layers.values())


def _used(found: Nav2Plugin, grid: OccupancyGrid, dock: Dock, *, has_map: bool) -> tuple[Layer | None, str]:
    """The layer with what it needs, or None; and what became of it."""
    layer = found.plugin
    if not isinstance(layer, Layer):
        return None, f"skipped: {_NO_FILTERS if found.instance.kind == 'filter' else found.reason}"
    if not layer.is_enabled():
        return None, "skipped: enabled is false"
    if isinstance(layer, StaticLayer):
        if has_map:
            return None, "skipped: there is no second map"
        layer.set_map(grid)
    if isinstance(layer, DockLayer):
        layer.set_dock(dock)
    clears = isinstance(layer, StaticLayer) and layer.parameters.footprint_clearing_enabled
    return layer, f"used: {found.outcome}{'; it frees the cells under the robot at the start' * clears}"


def _place(grid: OccupancyGrid, *, rolls: bool) -> str:
    rows, columns = grid.data.shape
    size = f"{columns * grid.resolution:g} m x {rows * grid.resolution:g} m, cells of {grid.resolution:g} m"
    return f"built in the place and size of the map: {size}{'; it does not roll, the whole map is known' * rolls}"


def _unknown(tracked: object, *, keeps: bool) -> str:
    """What unknown cells count for, as the layer of the map has them, which may say otherwise than the costmap."""
    if not keeps:
        return "free: track_unknown_space is false"
    if tracked is False:
        return "obstacles: track_unknown_space is false, but not of the layer of the map"
    silent = "" if tracked is True else " (track_unknown_space is not given; Nav2 would take them for free)"
    return f"obstacles{silent}"


def _why_not(name: str) -> str:
    if name.endswith("local_costmap"):
        return "skipped: it holds what sensors see around the robot, and nothing has been seen yet"
    return "skipped: planning looks at one costmap"
