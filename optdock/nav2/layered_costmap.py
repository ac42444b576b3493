"""Layered costmap: a grid written by layers in order (Nav2: `LayeredCostmap`), built once over a map."""

from __future__ import annotations

import math
from contextlib import contextmanager
from typing import TYPE_CHECKING

from optdock.errors import InvalidValue, PluginError
from optdock.model.costmap import Costmap
from optdock.model.costs import FREE_SPACE, NO_INFORMATION
from optdock.nav2.layers.nav2_layer import joined
from optdock.plugins.interfaces import Bounds, Layer
from optdock.plugins.lifecycle import LifecycleState, PluginContext

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from optdock.geometry.footprint import Footprint
    from optdock.geometry.pose import Pose2
    from optdock.model.occupancy import OccupancyGrid

__all__ = ["layered_costmap"]

_EVERYWHERE = Bounds(-math.inf, -math.inf, math.inf, math.inf)


def layered_costmap(
    place: OccupancyGrid,
    layers: Mapping[str, Layer],
    robot: Pose2,
    footprint: Footprint | None = None,
    *,
    track_unknown_space: bool = True,
) -> Costmap:
    """Return the costs that layers write into a grid with the place and size of a map.

    Args:
        place: The map; its occupancies are not used.
        layers: Layers by name, from the bottom up. They are active during the call and unconfigured afterwards.
        robot: Pose of the robot in the frame of the map.
        footprint: Outline of the robot, for the layers.
        track_unknown_space: Whether cells that no layer writes are unknown; otherwise they are free.

    Raises:
        InvalidValue: If an entry of `layers` is no Layer, or a layer is given twice or refuses the footprint.
        LifecycleError: If a layer is in use already.
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
                    f"layer {name}: update_bounds must grow the bounds {tuple(_EVERYWHERE)}, got {tuple(grown)}"
                )
        for layer in enabled.values():
            layer.update_costs(master, 0, 0, master.columns, master.rows)
    return master.frozen()


def _check_layers(layers: Mapping[str, Layer]) -> None:
    for name, layer in layers.items():
        if not isinstance(layer, Layer):
            raise InvalidValue(f"costmap.layers.{name}: must be a Layer, got {layer!r}")
    if len({id(layer) for layer in layers.values()}) != len(layers):
        raise InvalidValue(f"costmap.layers: one layer stands there twice among {', '.join(layers)}")


@contextmanager
def _active(layers: Mapping[str, Layer], footprint: Footprint | None) -> Iterator[None]:
    """Configure and activate all layers; clean up those configured here at the end."""
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
