"""The contract of costmap layers."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from optdock.geometry.pose import Pose2
from optdock.model.costmap import Costmap
from optdock.model.occupancy import OccupancyGrid
from optdock.plugins.interfaces import Bounds, Layer
from optdock.testing.contracts.contract_scene import ORIGIN
from optdock.testing.contracts.plugin import PluginContract
from optdock.testing.contracts.rules import require

if TYPE_CHECKING:
    from optdock.model.costs import CostArray

__all__ = ["LayerContract"]

_INF = math.inf
_BOUNDS = (
    Bounds(_INF, _INF, -_INF, -_INF),
    Bounds(0.0, 0.0, 0.0, 0.0),
    Bounds(-1.0, -0.5, 2.0, 0.7),
    Bounds(-_INF, -_INF, _INF, _INF),
)
_ROWS, _COLUMNS, _SIDE = 80, 120, 0.05
_WINDOWS = ((0, 0, _COLUMNS, _ROWS), (30, 20, 90, 60), (55, 35, 56, 36), (0, 0, 0, 0), (90, 0, _COLUMNS, 40))


class LayerContract(PluginContract[Layer]):
    """`optdock.plugins.interfaces.Layer`: one source of costs in a layered costmap."""

    interface: ClassVar[type[Layer]] = Layer

    def feed(self, layer: Layer) -> None:
        """Let the layer observe something within 2 m of the origin; nothing by default."""

    def robot(self) -> Pose2:
        """Where the robot is, on the grid."""
        return ORIGIN

    def exercise(self, plugin: Layer) -> object:
        """The costs that it writes into a grid of random ones, after it was fed."""
        self.feed(plugin)
        return self._written(plugin).tobytes()

    def test_it_has_something_to_write(self) -> None:
        """`update_costs`: write costs into `master`; the other tests of costs mean nothing for a layer that never does.

        A layer that writes only what it has observed needs `feed`.
        """
        layer = self.ready_plugin()
        self.feed(layer)
        require(np.any(self._written(layer) != _master().data), "fed, it changes a cell of a grid of random costs")

    def test_bounds_only_grow(self) -> None:
        """`update_bounds`: `bounds` grown, never shrunk."""
        for is_fed in (False, True):
            for given in _BOUNDS:
                layer = self.ready_plugin()
                if is_fed:
                    self.feed(layer)
                grown = Bounds(*layer.update_bounds(self.robot(), given))
                low = grown.min_x <= given.min_x and grown.min_y <= given.min_y
                high = grown.max_x >= given.max_x and grown.max_y >= given.max_y
                require(low and high, f"{given} only grows, got {grown}")  # NaN compares false, so it is refused too

    def test_what_it_writes_lies_within_its_bounds(self) -> None:
        """`update_bounds`: grown to what this layer will write: outside of them a second update changes nothing."""
        layer = self.ready_plugin()
        self.feed(layer)
        grown = layer.update_bounds(self.robot(), _BOUNDS[0])
        before, after = _master(), _master()
        layer.update_costs(after, 0, 0, _COLUMNS, _ROWS)
        rows, columns = np.nonzero(after.data != before.data)
        if rows.size == 0:
            return
        centres = before.centre_of(np.column_stack((columns, rows)))
        low, high = centres.min(axis=0), centres.max(axis=0)
        inside = low[0] >= grown.min_x - _SIDE and low[1] >= grown.min_y - _SIDE
        inside = inside and high[0] <= grown.max_x + _SIDE and high[1] <= grown.max_y + _SIDE
        require(inside, f"it writes within {grown}, got cells from {low} to {high}")

    def test_costs_outside_the_window_stay(self) -> None:
        """`update_costs`: inside columns [min_i, max_i) and rows [min_j, max_j) only."""
        for min_i, min_j, max_i, max_j in _WINDOWS:
            layer, master = self.ready_plugin(), _master()
            self.feed(layer)
            before = master.data.copy()
            layer.update_bounds(self.robot(), _BOUNDS[0])
            layer.update_costs(master, min_i, min_j, max_i, max_j)
            outside = np.ones(before.shape, dtype=np.bool_)
            outside[min_j:max_j, min_i:max_i] = False
            changed = int(np.count_nonzero((master.data != before) & outside))
            require(changed == 0, f"{changed} cells outside the window {(min_i, min_j, max_i, max_j)} were written")

    def test_an_update_without_news_writes_the_same(self) -> None:
        """`update_costs`: the master is emptied before every update, so costs that stay are written again."""
        layer = self.ready_plugin()
        self.feed(layer)
        first = self._written(layer)
        require(np.array_equal(self._written(layer), first), "a second update writes the same costs")

    def test_reset_forgets(self) -> None:
        """`reset`: forget everything observed; a layer that may be cleared is then as new.

        A layer that may not be (`is_clearable` False, such as a map) writes the same as before.
        """
        layer = self.ready_plugin()
        self.feed(layer)
        before = self._written(layer)
        layer.reset()
        after = self._written(layer)
        wanted = self._written(self.ready_plugin()) if layer.is_clearable() else before
        require(np.array_equal(after, wanted), "after a reset it writes what a new one, or an unclearable one, does")

    def test_it_answers_its_questions_with_yes_or_no(self) -> None:
        """`is_clearable`, `is_current`, `is_enabled`: booleans, at every stage."""
        for layer in (self.make_plugin(), self.ready_plugin()):
            for name in ("is_clearable", "is_current", "is_enabled"):
                found = getattr(layer, name)()
                require(isinstance(found, bool), f"{name}() is a bool, got {found!r}")

    def test_it_is_current_after_an_update(self) -> None:
        """`is_current`: whether what it writes is up to date; servers wait while it is not, so it must become so."""
        layer = self.ready_plugin()
        self.feed(layer)
        self._written(layer)
        require(layer.is_current(), "fed and updated, it is current")

    def test_it_can_be_said_to_be_out_of_date(self) -> None:
        """`set_current`: out of date until said otherwise, whatever the layer itself knows."""
        layer = self.ready_plugin()
        self.feed(layer)
        for said in (False, True):
            layer.set_current(said)
            self._written(layer)
            require(layer.is_current() is said, f"after set_current({said}) is_current() is {said}")

    def test_a_disabled_layer_takes_no_part(self) -> None:
        """`is_enabled`: whether it takes part: a layered costmap with it alone stays empty.

        For layers with a parameter `enabled`.
        """
        from optdock.nav2.global_costmap import layered_costmap

        layer = self.make_plugin()
        if "enabled" not in type(layer.parameters).model_fields:
            return
        layer.set_parameters(enabled=False)
        require(layer.is_enabled() is False, "with enabled: false it does not take part")
        self.feed(layer)
        context = self.make_context()
        place = OccupancyGrid(np.full((50, 50), -1), 0.1)
        costs = layered_costmap(place, {"layer": layer}, self.robot(), context.footprint).data
        require(np.all(costs == costs.flat[0]), "disabled, it writes nothing")

    def test_it_follows_the_grid(self) -> None:
        """`match_size`, `on_footprint_changed`: the master grid, or the outline, has changed: it goes on."""
        layer = self.ready_plugin()
        self.feed(layer)
        self._written(layer)
        layer.match_size()
        layer.on_footprint_changed()
        small = Costmap.writable((20, 30), 0.1, (-1.0, -1.0))
        layer.update_bounds(self.robot(), _BOUNDS[0])
        layer.update_costs(small, 0, 0, 30, 20)
        require(layer.is_current(), "on another grid it is current after an update")

    def _written(self, layer: Layer) -> CostArray:
        """The master's costs after an update of all of it."""
        master = _master()
        layer.update_bounds(self.robot(), _BOUNDS[0])
        layer.update_costs(master, 0, 0, _COLUMNS, _ROWS)
        return master.data


def _master() -> Costmap:
    """A writable grid of random costs around the origin and the dock."""
    grid = Costmap.writable((_ROWS, _COLUMNS), _SIDE, (-2.0, -2.0))
    draw = np.random.default_rng(7)
    grid.data[:] = draw.integers(0, 253, size=(_ROWS, _COLUMNS))
    grid.data[draw.random(size=(_ROWS, _COLUMNS)) < 0.01] = 254
    return grid
