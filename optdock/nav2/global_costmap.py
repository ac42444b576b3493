"""The global costmap that a parameter file describes, over a map: its layers in order, and what became of each."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.costmap.costs import NO_INFORMATION
from optdock.errors import InvalidFile
from optdock.interfaces import Layer
from optdock.nav2.layered_costmap import LayeredCostmap
from optdock.nav2.layers.dock import DockLayer
from optdock.nav2.layers.inflation import InflationLayer
from optdock.nav2.layers.obstacle import ObstacleLayer
from optdock.nav2.layers.static import StaticLayer
from optdock.nav2.provided_plugins import provided

if TYPE_CHECKING:
    from collections.abc import Sequence

    from optdock.costmap.costmap import Costmap
    from optdock.costmap.occupancy import OccupancyGrid
    from optdock.dock import Dock
    from optdock.geometry.pose import Pose2
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

    The layers that optdock provides write it in the file's order with the file's parameters; costs around obstacles are
    those of its inflation. Inflation of Nav2's kind writes 253 over unknown cells beside walls; here what the other
    layers leave unknown stays unknown, so that it stays an obstacle. Without a static layer in the file one is put
    under the others, because the map was given.

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
    inflating = [layer for layer in layers.values() if isinstance(layer, InflationLayer) and layer.is_enabled()]
    for layer in inflating:
        layer.set_parameters(enabled=False)
    known = built.update(start)
    for layer in inflating:
        layer.set_parameters(enabled=True)
    costs = np.where(known.data == NO_INFORMATION, NO_INFORMATION, built.update(start).data)
    others = [(name, _why_not(name)) for name in params.costmaps if name != described.name]
    return FileCostmap(known.with_data(costs), (_head(described, grid), _unknown(tracked), *rows, *others))


def _node_of(params: Nav2Params, described: CostmapParams) -> str:
    """Path of the node that holds the costmap's parameters; a file without nodes is one costmap of the file's name."""
    return next(path for path in params.nodes if (path.rsplit("/", 1)[-1] or params.source.stem) == described.name)


def _layers(
    params: Nav2Params, listed: Sequence[PluginInstance], grid: OccupancyGrid, dock: Dock
) -> tuple[dict[str, Layer], list[tuple[str, str]]]:
    layers: dict[str, Layer] = {}
    rows: list[tuple[str, str]] = []
    has_map = False
    for instance in listed:
        found = provided(instance, params)
        if found.refused:
            raise InvalidFile(f"{params.source}:{instance.line}: {instance.name}: {found.reason}")
        layer = found.plugin
        if not isinstance(layer, Layer):
            rows.append((instance.name, f"skipped: {_NO_FILTERS if instance.kind == 'filter' else found.reason}"))
            continue
        if isinstance(layer, StaticLayer):
            if has_map:
                rows.append((instance.name, "skipped: there is no second map"))
                continue
            layer.set_map(grid)
            has_map = True
        if isinstance(layer, DockLayer):
            layer.set_dock(dock)
        blind = isinstance(layer, ObstacleLayer)
        rows.append((instance.name, f"used: {'ObstacleLayer; nothing has been seen yet' if blind else found.outcome}"))
        layers[instance.name] = layer
    if has_map:
        return layers, rows
    static = StaticLayer()
    static.set_map(grid)
    name = _ADDED if _ADDED not in layers else f"{_ADDED} of the map"
    return {name: static, **layers}, [(name, "added: the file lists none, but a map was given"), *rows]


def _head(described: CostmapParams, grid: OccupancyGrid) -> tuple[str, str]:
    rows, columns = grid.data.shape
    size = f"{columns * grid.resolution:g} m x {rows * grid.resolution:g} m, cells of {grid.resolution:g} m"
    return described.name, f"built in the place and size of the map: {size}"


def _unknown(tracked: object) -> tuple[str, str]:
    if tracked is False:
        return "unknown cells", "free: track_unknown_space is false"
    silent = "" if tracked is True else " (track_unknown_space is not given; Nav2 would take them for free)"
    return "unknown cells", f"obstacles{silent}"


def _why_not(name: str) -> str:
    if name.endswith("local_costmap"):
        return "skipped: it holds what sensors see around the robot, and nothing has been seen yet"
    return "skipped: planning looks at one costmap"
