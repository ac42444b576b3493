"""LayeredCostmap: one master grid, and the layers that write into it in order (Nav2: `LayeredCostmap`)."""

from __future__ import annotations

import dataclasses
import math
import time
from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field

from optdock.errors import InvalidValue, PluginError
from optdock.model.costmap import Costmap
from optdock.model.costs import FREE_SPACE, NO_INFORMATION
from optdock.nav2.layers.window import EVERYWHERE, NOWHERE, joined, moved_grid, window_of
from optdock.plugins.interfaces import Layer
from optdock.plugins.lifecycle import LifecycleState, PluginContext
from optdock.plugins.parameters import PluginParameters, parse_parameters

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from optdock.geometry.footprint import Footprint
    from optdock.geometry.pose import Pose2
    from optdock.model.costmap import OccupancyGrid
    from optdock.model.costs import CostArray
    from optdock.plugins.interfaces import Bounds

__all__ = ["LayeredCostmap", "LayeredCostmapParameters"]

_MAX_CELLS = 2**27


class LayeredCostmapParameters(PluginParameters):
    """Nav2's parameters of a costmap; `track_unknown_space` is True here, False in Nav2."""

    width: float = Field(default=5.0, gt=0.0, description="extent along x [m]")
    height: float = Field(default=5.0, gt=0.0, description="extent along y [m]")
    resolution: float = Field(default=0.1, gt=0.0, description="side of a cell [m]")
    origin_x: float = Field(default=0.0, description="lower left corner [m]; a rolling window finds its own")
    origin_y: float = Field(default=0.0, description="lower left corner [m]")
    rolling_window: bool = Field(default=False, description="keep the robot in the middle")
    track_unknown_space: bool = Field(default=True, description="cells that no layer writes are unknown; False: free")


class LayeredCostmap:
    """A master grid that plugins write in order; only the window that they ask for is rewritten in each update.

    An update that fails changes nothing and is made up for by the next one. A rolling window moves by whole cells and
    keeps what overlaps. Not for use from several threads at once.

    Args:
        layers: Name and layer, from the bottom up; each is configured with its name and activated.
        footprint: The robot's outline, for the layers.
        clock: Monotonic seconds, for the layers.
        **parameters: Fields of `LayeredCostmapParameters`.

    Raises:
        InvalidValue: A parameter is unknown, of the wrong type or out of range, the grid has more than 2^27 cells, a
            layer stands in `layers` twice, is none, or refuses its surroundings.
        LifecycleError: A layer is in use already.
    """

    def __init__(
        self,
        layers: Mapping[str, Layer],
        footprint: Footprint | None = None,
        *,
        clock: Callable[[], float] = time.monotonic,
        **parameters: object,
    ) -> None:
        self.parameters = parse_parameters(LayeredCostmapParameters, parameters, "costmap")
        self._master = _empty_master(self.parameters)
        self._anchor = self._master.origin
        self._layers = dict(layers)
        self._is_whole_stale = True
        self._enabled: tuple[str, ...] = ()
        self._snapshot = self._master.frozen()
        _start(self._layers, footprint, clock)

    @classmethod
    def of_map(
        cls,
        grid: OccupancyGrid,
        layers: Mapping[str, Layer],
        footprint: Footprint | None = None,
        *,
        track_unknown_space: bool = True,
    ) -> LayeredCostmap:
        """A costmap in the place and size of a map, as Nav2's StaticLayer makes it.

        Raises:
            InvalidValue: As the constructor.
        """
        rows, columns = grid.data.shape
        return cls(
            layers,
            footprint,
            width=columns * grid.resolution,
            height=rows * grid.resolution,
            resolution=grid.resolution,
            origin_x=grid.origin[0],
            origin_y=grid.origin[1],
            track_unknown_space=track_unknown_space,
        )

    @property
    def costmap(self) -> Costmap:
        """The costs of the last update, read-only."""
        return self._snapshot

    @property
    def layers(self) -> Mapping[str, Layer]:
        """The layers by name, from the bottom up."""
        return dict(self._layers)

    @property
    def is_current(self) -> bool:
        """Whether there was an update, and every enabled layer is up to date."""
        return not self._is_whole_stale and all(layer.is_current() for layer in self._active().values())

    def update(self, robot: Pose2) -> Costmap:
        """Ask all layers for their bounds, reset that window and let all layers write it.

        Args:
            robot: Pose of the robot in the costmap's frame.

        Returns:
            The costs, read-only.

        Raises:
            PluginError: A layer shrinks the bounds, returns NaN, or writes outside of its window.
            OptdockError: Whatever a layer raises.
        """
        active = self._active()
        stale = self._is_whole_stale or tuple(active) != self._enabled
        self._is_whole_stale = True  # until this update has succeeded
        scratch = moved_grid(self._master, self._place(robot), self._fill)
        bounds = EVERYWHERE if stale else self._exposed(scratch)
        for name, layer in active.items():
            bounds = _grown(name, bounds, layer.update_bounds(robot, bounds))
        min_i, min_j, max_i, max_j = window_of(scratch, bounds)
        if min_i < max_i and min_j < max_j:
            scratch.data[min_j:max_j, min_i:max_i] = self._fill
            around = [part.copy() for part in _outside(scratch, (min_i, min_j, max_i, max_j))]
            for name, layer in active.items():
                layer.update_costs(scratch, min_i, min_j, max_i, max_j)
                _require_untouched(name, around, scratch, (min_i, min_j, max_i, max_j))
        self._master, self._enabled, self._is_whole_stale = scratch, tuple(active), False
        self._snapshot = scratch.frozen()
        return self._snapshot

    def reset(self) -> None:
        """All layers forget what they observed, and the grid is emptied."""
        self._reset(self._layers)

    def clear(self) -> None:
        """The clearable layers forget what they observed, as Nav2's clearing service has them do."""
        self._reset({name: layer for name, layer in self._layers.items() if layer.is_clearable()})

    def resize(self, **changes: object) -> None:
        """Change `width`, `height`, `resolution` or the origin; the grid is emptied and the layers are notified.

        Raises:
            InvalidValue: As the constructor; nothing has changed then.
        """
        changed = parse_parameters(LayeredCostmapParameters, {**self.parameters.model_dump(), **changes}, "costmap")
        master = _empty_master(changed)
        self.parameters, self._master, self._anchor = changed, master, master.origin
        for layer in self._layers.values():
            layer.match_size()
        self._snapshot, self._is_whole_stale = master.frozen(), True

    def set_footprint(self, footprint: Footprint) -> None:
        """Tell every layer of another outline."""
        for layer in self._layers.values():
            layer.context = dataclasses.replace(layer.context, footprint=footprint)
            layer.on_footprint_changed()
        self._is_whole_stale = True

    @property
    def _fill(self) -> int:
        return NO_INFORMATION if self.parameters.track_unknown_space else FREE_SPACE

    def _active(self) -> dict[str, Layer]:
        return {name: layer for name, layer in self._layers.items() if layer.is_enabled()}

    def _reset(self, layers: Mapping[str, Layer]) -> None:
        for layer in layers.values():
            layer.reset()
        self._is_whole_stale = True

    def _place(self, robot: Pose2) -> Costmap:
        """The grid in its place for this update; a rolling window moves by whole cells."""
        if not self.parameters.rolling_window:
            return self._master
        side = self._master.resolution
        half = (0.5 * self._master.columns * side, 0.5 * self._master.rows * side)
        steps = [
            math.floor((at - h - anchor) / side + 0.5)
            for at, h, anchor in zip((robot.x, robot.y), half, self._anchor, strict=True)
        ]
        origin = (self._anchor[0] + steps[0] * side, self._anchor[1] + steps[1] * side)
        return dataclasses.replace(self._master, origin=origin)

    def _exposed(self, scratch: Costmap) -> Bounds:
        """The box of the cells that came into view."""
        (old_x, old_y), (new_x, new_y) = self._master.origin, scratch.origin
        if (old_x, old_y) == (new_x, new_y):
            return NOWHERE
        if old_x != new_x and old_y != new_y:
            return EVERYWHERE
        x0, y0, x1, y1 = *scratch.lower, *scratch.upper
        if new_x != old_x:
            return type(EVERYWHERE)(*((self._master.upper[0], y0, x1, y1) if new_x > old_x else (x0, y0, old_x, y1)))
        return type(EVERYWHERE)(*((x0, self._master.upper[1], x1, y1) if new_y > old_y else (x0, y0, x1, old_y)))


def _empty_master(parameters: LayeredCostmapParameters) -> Costmap:
    sides = (parameters.height, parameters.width)
    rows, columns = (max(1, math.ceil(min(side / parameters.resolution, 1e18) - 1e-6)) for side in sides)
    if rows * columns > _MAX_CELLS:
        raise InvalidValue(
            f"costmap: {columns} x {rows} cells are more than the {_MAX_CELLS} allowed; lower width and height, or "
            "choose larger cells"
        )
    fill = NO_INFORMATION if parameters.track_unknown_space else FREE_SPACE
    return Costmap.writable((rows, columns), parameters.resolution, (parameters.origin_x, parameters.origin_y), fill)


def _start(layers: Mapping[str, Layer], footprint: Footprint | None, clock: Callable[[], float]) -> None:
    """Configure and activate all layers, or none."""
    for name, layer in layers.items():
        if not isinstance(layer, Layer):
            raise InvalidValue(f"costmap.layers.{name}: must be a Layer, got {layer!r}")
    if len({id(layer) for layer in layers.values()}) != len(layers):
        raise InvalidValue(f"costmap.layers: one layer stands there twice among {', '.join(layers)}")
    started: list[Layer] = []
    try:
        for name, layer in layers.items():
            layer.configure(PluginContext(name=name, footprint=footprint, clock=clock))
            started.append(layer)
            layer.activate()
    except BaseException:
        for layer in reversed(started):
            if layer.state is LifecycleState.ACTIVE:
                layer.deactivate()
            layer.cleanup()
        raise


def _outside(grid: Costmap, window: tuple[int, int, int, int]) -> list[CostArray]:
    """The cells above, below, left and right of a window: views."""
    min_i, min_j, max_i, max_j = window
    rows = grid.data[min_j:max_j]
    return [grid.data[:min_j], grid.data[max_j:], rows[:, :min_i], rows[:, max_i:]]


def _require_untouched(name: str, around: list[CostArray], grid: Costmap, window: tuple[int, int, int, int]) -> None:
    pairs = zip(around, _outside(grid, window), strict=True)
    changed = sum(int(np.count_nonzero(before != after)) for before, after in pairs)
    if changed:
        raise PluginError(
            f"layer {name}: update_costs must write inside of its window {window} only, but changed {changed} cells "
            "outside of it"
        )


def _grown(name: str, before: Bounds, after: Bounds) -> Bounds:
    if any(math.isnan(value) for value in after) or joined(before, after) != after:
        raise PluginError(f"layer {name}: update_bounds must grow the bounds {tuple(before)}, got {tuple(after)}")
    return after
