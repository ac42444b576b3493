"""Costmaps written by layers in order (Nav2: `LayeredCostmap`), and the global costmap of a Nav2 parameter file."""

from __future__ import annotations

import math
from contextlib import contextmanager
from typing import TYPE_CHECKING, NamedTuple

from optdock.errors import InvalidFile, InvalidValue, PluginError
from optdock.model.costmap import Costmap
from optdock.model.costs import FREE_SPACE, NO_INFORMATION
from optdock.nav2.layers.dock_layer import DockLayer
from optdock.nav2.layers.nav2_layer import joined
from optdock.nav2.layers.static import StaticLayer
from optdock.nav2.provided_plugins import provided
from optdock.plugins.interfaces import Bounds, Layer
from optdock.plugins.lifecycle import LifecycleState, PluginContext

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from optdock.geometry.footprint import Footprint
    from optdock.geometry.pose import Pose2
    from optdock.model.costmap import OccupancyGrid
    from optdock.model.dock import Dock
    from optdock.nav2.params import CostmapParams, Nav2Params
    from optdock.nav2.plugin_lists import PluginInstance
    from optdock.nav2.provided_plugins import Nav2Plugin

__all__ = ["FileCostmap", "file_costmap", "layered_costmap"]

_ADDED = "static_layer"
_EVERYWHERE = Bounds(-math.inf, -math.inf, math.inf, math.inf)


class FileCostmap(NamedTuple):
    """A costmap, and rows of name and result for every part of the file's costmaps."""

    costmap: Costmap
    rows: tuple[tuple[str, str], ...]


def file_costmap(
    params: Nav2Params, described: CostmapParams, grid: OccupancyGrid, start: Pose2, dock: Dock
) -> FileCostmap:
    """Return the costmap `described`, with the position and size of the map, and without sensor data.

    The layers that optdock provides are applied in the order of the file with their parameters. Layers of sensors are
    skipped because there are no sensor data. Inflation layers are skipped because the clearance is proven with the
    exact footprint. If the file has no static layer, one is added below the others.

    Args:
        params: The parameter file.
        described: One of the costmaps in this file.
        grid: The map.
        start: Pose of the robot, for layers that clear the cells under it.
        dock: The dock, for a `DockLayer`.

    Raises:
        InvalidFile: If a layer that optdock provides rejects its parameters.
    """
    node = next(path for path in params.nodes if (path.rsplit("/", 1)[-1] or params.source.stem) == described.name)
    values = params.nodes[node]
    rows, columns = grid.data.shape
    size = f"{columns * grid.resolution:g} m x {rows * grid.resolution:g} m, cells of {grid.resolution:g} m"
    rolls = "; it does not roll, because the whole map is known" * (values.get("rolling_window") is True)
    listed = [p for p in params.plugins if p.node == node and p.kind in ("layer", "filter")]
    layers, outcomes = _layers(params, listed, grid, dock)
    tracked = values.get("track_unknown_space")
    costmap = layered_costmap(grid, layers, start, described.outline, track_unknown_space=tracked is not False)
    return FileCostmap(
        costmap,
        (
            (described.name, f"built with the place and size of the map: {size}{rolls}"),
            ("unknown cells", _unknown_cells(tracked, layers)),
            *outcomes,
            *((name, _skipped_costmap(name)) for name in params.costmaps if name != described.name),
        ),
    )


def _layers(
    params: Nav2Params, listed: list[PluginInstance], grid: OccupancyGrid, dock: Dock
) -> tuple[dict[str, Layer], list[tuple[str, str]]]:
    """Return the layers by name with their map or dock, and the result for every listed layer."""
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
    """Return the layer with its map or dock, or None, and the result."""
    layer, cleared = found.plugin, ""
    if found.instance.kind == "filter":
        return None, "skipped: optdock has no filters; the restrictions of this filter are not in the costmap"
    if not isinstance(layer, Layer):
        return None, f"skipped: {found.reason}"
    if not layer.is_enabled():
        return None, "skipped: enabled is false"
    if isinstance(layer, StaticLayer):
        if has_map:
            return None, "skipped: there is no second map"
        layer.set_map(grid)
        cleared = "; it clears the cells under the robot at the start" * layer.parameters.footprint_clearing_enabled
    if isinstance(layer, DockLayer):
        layer.set_dock(dock)
    return layer, f"used: {found.outcome}{cleared}"


def _unknown_cells(tracked: object, layers: Mapping[str, Layer]) -> str:
    """Return how unknown cells are treated; the map's layer and the costmap may have different parameters."""
    if any(isinstance(one, StaticLayer) and not one.parameters.track_unknown_space for one in layers.values()):
        return "free: track_unknown_space is false"
    if tracked is False:
        return "obstacles: track_unknown_space is false, but not for the layer of the map"
    silent = "" if tracked is True else " (track_unknown_space is not given; Nav2 would treat them as free)"
    return f"obstacles{silent}"


def _skipped_costmap(name: str) -> str:
    if name.endswith("local_costmap"):
        return "skipped: it contains only sensor data, which is not available"
    return "skipped: planning uses one costmap"


def layered_costmap(
    place: OccupancyGrid,
    layers: Mapping[str, Layer],
    robot: Pose2,
    footprint: Footprint | None = None,
    *,
    track_unknown_space: bool = True,
) -> Costmap:
    """Return the costs that layers write into a grid with the position and size of a map.

    Args:
        place: The map, of which only position and size are used.
        layers: Layers by name, from bottom to top. The layers are active during the call and unconfigured afterwards.
        robot: Pose of the robot in the frame of the map.
        footprint: Outline of the robot, for the layers.
        track_unknown_space: Whether cells that no layer writes are unknown; otherwise they are free.

    Raises:
        InvalidValue: If an entry of `layers` is not a Layer, or a layer is given twice or rejects the footprint.
        LifecycleError: If a layer is already in use.
        PluginError: If a layer shrinks the bounds or returns NaN.
        OptdockError: If a layer raises an error.
    """
    _check_layers(layers)
    fill = NO_INFORMATION if track_unknown_space else FREE_SPACE
    master = Costmap.writable(place.data.shape, place.resolution, place.origin, fill)
    with _active(layers, footprint):
        enabled = {name: layer for name, layer in layers.items() if layer.is_enabled()}
        for name, layer in enabled.items():
            grown = layer.update_bounds(robot, _EVERYWHERE)
            if joined(_EVERYWHERE, grown) != grown:  # also for NaN
                raise PluginError(
                    f"layer {name}: update_bounds must extend the bounds {tuple(_EVERYWHERE)}, got {tuple(grown)}"
                )
        for layer in enabled.values():
            layer.update_costs(master, 0, 0, master.columns, master.rows)
    return master.frozen()


def _check_layers(layers: Mapping[str, Layer]) -> None:
    for name, layer in layers.items():
        if not isinstance(layer, Layer):
            raise InvalidValue(f"costmap.layers.{name}: must be a Layer, got {layer!r}")
    if len({id(layer) for layer in layers.values()}) != len(layers):
        raise InvalidValue(f"costmap.layers: one layer is given twice among {', '.join(layers)}")


@contextmanager
def _active(layers: Mapping[str, Layer], footprint: Footprint | None) -> Iterator[None]:
    """Configure and activate all layers; at the end, clean up the layers that were configured here."""
    started: list[Layer] = []
    try:
        for name, layer in layers.items():
            layer.configure(PluginContext(name=name, footprint=footprint))
            started.append(layer)
            layer.activate()
        yield
    finally:
        for layer in reversed(started):
            if layer.state is LifecycleState.ACTIVE:
                layer.deactivate()
            layer.cleanup()
