"""Contract of costmap layers."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from optdock.model.costmap import Costmap, OccupancyGrid
from optdock.plugins.interfaces import Bounds, Layer
from optdock.testing.contracts.contract_scene import ORIGIN
from optdock.testing.contracts.plugin import PluginContract, require

if TYPE_CHECKING:
    from optdock.model.costs import CostArray

__all__ = ["LayerContract"]

_INF = math.inf
_NOWHERE = Bounds(_INF, _INF, -_INF, -_INF)
_BOUNDS = (_NOWHERE, Bounds(0.0, 0.0, 0.0, 0.0), Bounds(-1.0, -0.5, 2.0, 0.7), Bounds(-_INF, -_INF, _INF, _INF))
_ROWS, _COLUMNS, _SIDE = 80, 120, 0.05
_WINDOWS = ((0, 0, _COLUMNS, _ROWS), (30, 20, 90, 60), (55, 35, 56, 36), (0, 0, 0, 0), (90, 0, _COLUMNS, 40))


class LayerContract(PluginContract[Layer]):
    """Rules of `optdock.plugins.interfaces.Layer`."""

    interface: ClassVar[type[Layer]] = Layer

    def feed(self, layer: Layer) -> None:
        """Give the layer observations within 2 m of the origin; by default no observations."""

    def exercise(self, plugin: Layer) -> object:
        """Return the costs that a layer with observations writes into a grid of random costs."""
        self.feed(plugin)
        return _written(plugin).tobytes()

    def test_costs_are_written_within_the_announced_bounds(self) -> None:
        """`update_bounds`, `update_costs`: a layer with observations changes cells, all of them inside its bounds."""
        layer, before, after = self._fed(), _master(), _master()
        grown = layer.update_bounds(ORIGIN, _NOWHERE)
        layer.update_costs(after, 0, 0, _COLUMNS, _ROWS)
        rows, columns = np.nonzero(after.data != before.data)
        require(rows.size > 0, "a layer with observations changes a cell of a grid of random costs")
        centres = before.centre_of(np.column_stack((columns, rows)))
        low, high = centres.min(axis=0) + _SIDE, centres.max(axis=0) - _SIDE
        inside = low[0] >= grown.min_x and low[1] >= grown.min_y and high[0] <= grown.max_x and high[1] <= grown.max_y
        require(inside, f"costs are written within {grown}, got cells from {low} to {high}")

    def test_bounds_only_grow(self) -> None:
        """`update_bounds`: the returned bounds contain the given bounds."""
        for layer in (self.ready_plugin(), self._fed()):
            for given in _BOUNDS:
                grown = Bounds(*layer.update_bounds(ORIGIN, given))
                low = grown.min_x <= given.min_x and grown.min_y <= given.min_y
                high = grown.max_x >= given.max_x and grown.max_y >= given.max_y
                require(low and high, f"{given} may only be extended, got {grown}")  # False for NaN

    def test_costs_outside_the_window_stay(self) -> None:
        """`update_costs`: only columns [min_i, max_i) and rows [min_j, max_j) are written."""
        for min_i, min_j, max_i, max_j in _WINDOWS:
            layer, master = self._fed(), _master()
            before = master.data.copy()
            layer.update_bounds(ORIGIN, _NOWHERE)
            layer.update_costs(master, min_i, min_j, max_i, max_j)
            outside = np.ones(before.shape, dtype=np.bool_)
            outside[min_j:max_j, min_i:max_i] = False
            changed = int(np.count_nonzero((master.data != before) & outside))
            require(changed == 0, f"{changed} cells outside the window {(min_i, min_j, max_i, max_j)} were written")

    def test_every_update_writes_the_costs_again(self) -> None:
        """`update_costs`, `match_size`, `on_footprint_changed`: costs are written in every update and on any grid."""
        layer = self._fed()
        first = _written(layer)
        require(np.array_equal(_written(layer), first), "a second update writes the same costs")
        layer.match_size()
        layer.on_footprint_changed()
        layer.update_bounds(ORIGIN, _NOWHERE)
        layer.update_costs(Costmap.writable((20, 30), 0.1, (-1.0, -1.0)), 0, 0, 30, 20)
        require(layer.is_current(), "on another grid the layer is current after an update")

    def test_reset_removes_observations(self) -> None:
        """`reset`: a clearable layer then behaves like a new layer; other layers write the same costs as before."""
        layer = self._fed()
        before = _written(layer)
        layer.reset()
        wanted = _written(self.ready_plugin()) if layer.is_clearable() else before
        after = _written(layer)
        require(np.array_equal(after, wanted), "after a reset, the costs are those of a new or an unclearable layer")

    def test_flags_are_booleans_and_follow_updates(self) -> None:
        """`is_clearable`, `is_enabled`, `is_current`: the results are bool.

        An update makes a layer current, unless it was set to False.
        """
        for layer in (self.make_plugin(), self.ready_plugin()):
            for name in ("is_clearable", "is_current", "is_enabled"):
                found = getattr(layer, name)()
                require(isinstance(found, bool), f"{name}() is a bool, got {found!r}")
        layer = self._fed()
        _written(layer)
        require(layer.is_current(), "a layer with observations is current after an update")
        for current in (False, True):
            layer.set_current(current)
            _written(layer)
            require(layer.is_current() is current, f"after set_current({current}) is_current() is {current}")

    def test_a_disabled_layer_writes_nothing(self) -> None:
        """`is_enabled`: a layer with a parameter `enabled` writes nothing if it is False."""
        from optdock.nav2.global_costmap import layered_costmap

        layer = self.make_plugin()
        if "enabled" not in type(layer.parameters).model_fields:
            return
        layer.set_parameters(enabled=False)
        require(layer.is_enabled() is False, "enabled: false disables the layer")
        self.feed(layer)
        place = OccupancyGrid(np.full((50, 50), -1), 0.1)
        costs = layered_costmap(place, {"layer": layer}, ORIGIN, self.make_context().footprint).data
        require(np.all(costs == costs.flat[0]), "a disabled layer writes nothing")

    def _fed(self) -> Layer:
        layer = self.ready_plugin()
        self.feed(layer)
        return layer


def _written(layer: Layer) -> CostArray:
    """Return the costs of a whole grid after an update."""
    master = _master()
    layer.update_bounds(ORIGIN, _NOWHERE)
    layer.update_costs(master, 0, 0, _COLUMNS, _ROWS)
    return master.data


def _master() -> Costmap:
    """Return a writable grid of random costs around the origin and the dock."""
    grid = Costmap.writable((_ROWS, _COLUMNS), _SIDE, (-2.0, -2.0))
    draw = np.random.default_rng(7)
    grid.data[:] = draw.integers(0, 253, size=(_ROWS, _COLUMNS))
    grid.data[draw.random(size=(_ROWS, _COLUMNS)) < 0.01] = 254
    return grid
