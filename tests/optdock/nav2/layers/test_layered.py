import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from optdock.errors import InvalidValue, LifecycleError, PluginError
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.model.costmap import OccupancyGrid
from optdock.nav2.layered_costmap import LayeredCostmap
from optdock.nav2.layers.dock_layer import DockLayer
from optdock.nav2.layers.static import StaticLayer
from optdock.plugins.interfaces import Bounds, Layer
from optdock.plugins.lifecycle import LifecycleState

HERE = Pose2(0.5, 0.5, 0.0)
ROBOT = Footprint.rectangle(0.2, 0.2, 0.3)


class Stamp(Layer):
    """Writes `cost` wherever it is asked to write, inside its box; remembers what it was asked."""

    def __init__(self, box=(0.0, 0.0, 0.1, 0.1), cost=7):
        super().__init__()
        self.box, self.cost, self.windows, self.fails = Bounds(*box), cost, [], False
        self.is_on = True
        self.resets = self.matches = self.footprints = 0

    def reset(self):
        self.resets += 1

    def match_size(self):
        self.matches += 1

    def on_footprint_changed(self):
        self.footprints += 1

    def is_enabled(self):
        return self.is_on

    def update_bounds(self, robot, bounds):
        return Bounds(
            min(bounds.min_x, self.box.min_x),
            min(bounds.min_y, self.box.min_y),
            max(bounds.max_x, self.box.max_x),
            max(bounds.max_y, self.box.max_y),
        )

    def update_costs(self, master, min_i, min_j, max_i, max_j):
        self.windows.append((min_i, min_j, max_i, max_j))
        if self.fails:
            master.data[:] = 99
            raise RuntimeError("sensor on fire")
        master.data[min_j:max_j, min_i:max_i] = self.cost


def small(layers, **changes):
    values = {"width": 1.0, "height": 1.0, "resolution": 0.1, **changes}
    return LayeredCostmap(layers, ROBOT, **values)


def test_the_first_update_writes_everything_and_later_ones_only_what_is_asked_for():
    stamp = Stamp(box=(0.25, 0.35, 0.55, 0.35))
    costmap = small({"stamp": stamp})
    costmap.update(HERE)
    stamp.cost = 9
    costs = costmap.update(HERE).data
    assert stamp.windows == [(0, 0, 10, 10), (2, 3, 6, 4)]
    assert costs[3, 2:6].tolist() == [9, 9, 9, 9]
    assert np.count_nonzero(costs == 9) == 4
    assert np.count_nonzero(costs == 7) == 96


def test_layers_write_in_order():
    costmap = small({"first": Stamp(cost=1), "second": Stamp(cost=2)})
    assert np.all(costmap.update(HERE).data == 2)
    assert list(costmap.layers) == ["first", "second"]


@pytest.mark.parametrize(("track", "fill"), [(True, 255), (False, 0)])
def test_the_window_is_reset_before_the_layers_write(track, fill):
    class Lazy(Stamp):
        def update_costs(self, master, min_i, min_j, max_i, max_j):
            self.windows.append(master.data[min_j:max_j, min_i:max_i].copy())
            master.data[0, 0] = 50

    lazy = Lazy()
    costmap = small({"lazy": lazy}, track_unknown_space=track)
    costmap.update(HERE)
    costmap.update(HERE)
    assert np.all(lazy.windows[1] == fill)


def test_bounds_off_the_map_ask_for_nothing():
    stamp = Stamp(box=(5.0, 5.0, 6.0, 6.0))
    costmap = small({"stamp": stamp})
    costmap.update(HERE)
    costmap.update(HERE)
    assert len(stamp.windows) == 1


@pytest.mark.parametrize("box", [(0.3, 0.3, 0.2, 0.2), (math.nan, 0.0, 1.0, 1.0)])
def test_a_layer_that_shrinks_the_bounds_is_refused_by_name(box):
    class Bad(Stamp):
        def update_bounds(self, robot, bounds):
            return Bounds(*box)

    costmap = small({"good": Stamp(), "bad": Bad()})
    with pytest.raises(PluginError, match="layer bad: update_bounds must grow"):
        costmap.update(HERE)


@pytest.mark.parametrize("cell", [(0, 3), (9, 3), (3, 0), (3, 9)])
def test_a_layer_that_writes_outside_of_its_window_is_refused_by_name(cell):
    class Sprawling(Stamp):
        spilt = False

        def update_costs(self, master, *window):
            super().update_costs(master, *window)
            if self.spilt:
                master.data[cell] = 254

    bad = Sprawling(box=(0.2, 0.2, 0.5, 0.5))
    costmap = small({"good": Stamp(box=(0.2, 0.2, 0.5, 0.5)), "bad": bad})
    before = costmap.update(HERE).data.copy()
    bad.spilt = True
    with pytest.raises(PluginError, match=r"layer bad: .* window \(2, 2, .* but changed 1 cells outside of it"):
        costmap.update(HERE)
    np.testing.assert_array_equal(costmap.costmap.data, before)
    bad.spilt = False
    np.testing.assert_array_equal(costmap.update(HERE).data, before)


@pytest.mark.parametrize("kind", [StaticLayer, DockLayer])
def test_a_costmap_waits_for_a_layer_that_is_said_to_be_out_of_date(kind):
    layer = kind()
    if kind is StaticLayer:
        layer.set_map(OccupancyGrid(np.zeros((10, 10), dtype=np.int8), 0.1))
    costmap = LayeredCostmap({"layer": layer}, ROBOT, width=1.0, height=1.0, resolution=0.1)
    costmap.update(HERE)
    assert costmap.is_current
    layer.set_current(False)
    costmap.update(HERE)
    assert not costmap.is_current
    layer.set_current(True)
    assert costmap.is_current


def test_a_failed_update_changes_nothing_and_the_next_makes_up_for_it():
    stamp, torch = Stamp(cost=3), Stamp(cost=4)
    costmap = small({"stamp": stamp, "torch": torch})
    before = costmap.update(HERE).data.copy()
    torch.fails = True
    with pytest.raises(RuntimeError, match="on fire"):
        costmap.update(HERE)
    np.testing.assert_array_equal(costmap.costmap.data, before)
    assert not costmap.is_current
    torch.fails = False
    costmap.update(HERE)
    assert torch.windows[-1] == (0, 0, 10, 10)
    assert costmap.is_current


def test_users_get_read_only_costs_that_later_updates_do_not_touch():
    stamp = Stamp(cost=3)
    costmap = small({"stamp": stamp})
    first = costmap.update(HERE)
    stamp.cost = 4
    costmap.update(HERE)
    assert first.data[0, 0] == 3
    assert not first.data.flags.writeable


def test_a_disabled_layer_takes_no_part_and_is_missed_at_once():
    low, high = Stamp(cost=1), Stamp(box=(9, 9, 9, 9), cost=2)
    costmap = small({"low": low, "high": high})
    costmap.update(HERE)
    high.is_on = False
    assert np.all(costmap.update(HERE).data == 1)
    high.is_on = True
    assert np.all(costmap.update(HERE).data == 2)


def test_layers_are_active_under_their_names_and_refused_when_in_use():
    stamp = Stamp()
    small({"stamp": stamp})
    assert stamp.state is LifecycleState.ACTIVE
    assert (stamp.context.name, stamp.context.footprint) == ("stamp", ROBOT)
    with pytest.raises(LifecycleError, match="cannot configure"):
        small({"again": stamp})
    assert stamp.state is LifecycleState.ACTIVE


def test_one_layer_twice_is_refused_before_anything_starts():
    stamp = Stamp()
    with pytest.raises(InvalidValue, match="stands there twice"):
        small({"a": stamp, "b": stamp})
    assert stamp.state is LifecycleState.UNCONFIGURED


def test_reset_and_clear_and_resize_reach_the_layers():
    stamp, dock = Stamp(), DockLayer()
    costmap = small({"stamp": stamp, "dock": dock})
    costmap.update(HERE)
    costmap.clear()
    assert stamp.resets == 0
    assert not costmap.is_current
    costmap.reset()
    assert stamp.resets == 1
    costmap.resize(width=2.0)
    assert stamp.matches == 1
    assert costmap.update(HERE).data.shape == (10, 20)
    other = Footprint.rectangle(0.1, 0.1, 0.2)
    costmap.set_footprint(other)
    assert stamp.footprints == 1
    assert stamp.context.footprint is other


def test_a_refused_resize_changes_nothing():
    stamp = Stamp()
    costmap = small({"stamp": stamp})
    costmap.update(HERE)
    with pytest.raises(InvalidValue, match="resolution"):
        costmap.resize(resolution=-1.0)
    assert (stamp.matches, costmap.costmap.data.shape, costmap.is_current) == (0, (10, 10), True)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"resolution": 0.0}, "costmap.resolution"),
        ({"width": -1.0}, "costmap.width"),
        ({"height": math.nan}, "costmap.height"),
        ({"rolling": True}, "unknown parameter; did you mean rolling_window"),
        ({"width": 1e6, "height": 1e6}, "more than the 134217728 allowed"),
        ({"width": 1e300, "resolution": 1e-300}, "more than the 134217728 allowed"),
    ],
)
def test_bad_parameters_are_named(changes, message):
    with pytest.raises(InvalidValue, match=message):
        small({}, **changes)


def test_a_map_gives_its_place_and_size():
    grid = OccupancyGrid(np.zeros((307, 604), dtype=np.int8), 0.05, (-15.1, 3.0))
    static = StaticLayer()
    static.set_map(grid)
    costs = LayeredCostmap.of_map(grid, {"static": static}).update(HERE)
    assert (costs.data.shape, costs.resolution, costs.origin) == ((307, 604), 0.05, (-15.1, 3.0))


@given(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3))
def test_a_rolling_window_stays_on_its_raster_with_the_robot_in_the_middle(x, y):
    costmap = small({"stamp": Stamp()}, rolling_window=True, origin_x=0.03)
    costs = costmap.update(Pose2(x, y, 0.0))
    steps = (np.array(costs.origin) - (0.03, 0.0)) / 0.1
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    centre = (np.array(costs.lower) + costs.upper) / 2
    assert np.all(np.abs(centre - (x, y)) <= 0.05 + 1e-9)


@pytest.mark.parametrize("what", [3, None, StaticLayer, "static_layer"])
def test_what_is_no_layer_is_refused_before_anything_starts(what):
    fine = StaticLayer()
    with pytest.raises(InvalidValue, match=r"costmap\.layers\.odd: must be a Layer, got"):
        LayeredCostmap({"fine": fine, "odd": what})
    assert fine.state is LifecycleState.UNCONFIGURED


@pytest.mark.parametrize("grid", [None, np.zeros((3, 3), dtype=np.int8), "map.yaml"])
def test_what_is_no_map_is_refused_and_the_old_one_stays(grid):
    layer = StaticLayer()
    layer.set_map(OccupancyGrid(np.full((3, 3), 100), 0.1))
    with pytest.raises(InvalidValue, match="StaticLayer: a map must be an OccupancyGrid, got"):
        layer.set_map(grid)
    assert layer.is_current()


def test_what_is_no_dock_is_refused():
    with pytest.raises(InvalidValue, match="DockLayer: a dock must be a Dock or None, got 'home'"):
        DockLayer().set_dock("home")
