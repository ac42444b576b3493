"""What every layer owes the layered costmap."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from optdock.errors import InvalidValue, LifecycleError
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.model.costmap import Costmap, OccupancyGrid
from optdock.model.dock import Dock
from optdock.nav2.layers.dock_layer import DockLayer
from optdock.nav2.layers.static import StaticLayer
from optdock.nav2.layers.window import joined
from optdock.plugins.interfaces import Bounds
from optdock.plugins.lifecycle import PluginContext

ROBOT = Footprint.rectangle(0.2, 0.2, 0.3)


def static():
    layer = StaticLayer()
    layer.set_map(OccupancyGrid(np.random.default_rng(0).choice([0, 100, -1], (20, 20)), 0.1))
    return layer


def dock():
    layer = DockLayer()
    layer.set_dock(Dock(Pose2(1.0, 1.0, 0.3), Footprint.rectangle(0.6, -0.2, 0.5)))
    return layer


MAKERS = {"static": static, "dock": dock}
every_layer = pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS.keys())
poses = st.builds(Pose2, st.floats(-1, 3), st.floats(-1, 3), st.floats(-4, 4))
indices = st.tuples(st.integers(0, 20), st.integers(0, 20))


def configured(make):
    layer = make()
    layer.configure(PluginContext(name="layer", footprint=ROBOT))
    return layer


def speckled():
    master = Costmap.writable((20, 20), 0.1, (0.0, 0.0))
    master.data[:] = np.random.default_rng(1).choice([0, 30, 254, 255], (20, 20))
    return master


@every_layer
@given(robot=poses, corners=st.tuples(*[st.floats(-2, 4)] * 4))
def test_bounds_only_grow(make, robot, corners):
    a, b, c, d = corners
    before = Bounds(min(a, c), min(b, d), max(a, c), max(b, d))
    after = configured(make).update_bounds(robot, before)
    assert joined(before, after) == after


@every_layer
@given(robot=poses, columns=indices, rows=indices)
def test_costs_are_written_inside_the_window_only(make, robot, columns, rows):
    (i0, i1), (j0, j1) = sorted(columns), sorted(rows)
    layer, master = configured(make), speckled()
    layer.update_bounds(robot, Bounds(0.0, 0.0, 2.0, 2.0))
    layer.update_costs(master, i0, j0, i1, j1)
    master.data[j0:j1, i0:i1] = speckled().data[j0:j1, i0:i1]
    np.testing.assert_array_equal(master.data, speckled().data)


@every_layer
def test_it_does_write_something(make):
    layer, master = configured(make), speckled()
    layer.update_bounds(Pose2(1.0, 1.0, 0.0), Bounds(0.0, 0.0, 2.0, 2.0))
    layer.update_costs(master, 0, 0, 20, 20)
    assert np.any(master.data != speckled().data)


@every_layer
@pytest.mark.parametrize("window", [(0, 0, 21, 20), (0, -1, 5, 5), (5, 5, 4, 6)])
def test_a_window_that_the_master_does_not_have_is_refused_before_writing(make, window):
    master = speckled()
    with pytest.raises(InvalidValue, match="window"):
        configured(make).update_costs(master, *window)
    np.testing.assert_array_equal(master.data, speckled().data)


@every_layer
def test_a_read_only_master_is_refused(make):
    with pytest.raises(InvalidValue, match="master grid: is read-only"):
        configured(make).update_costs(speckled().frozen(), 0, 0, 20, 20)


@every_layer
def test_the_lifecycle_can_be_walked_and_jumps_are_refused(make):
    layer = make()
    with pytest.raises(LifecycleError):
        layer.activate()
    layer.configure(PluginContext(name="layer", footprint=ROBOT))
    layer.activate()
    layer.deactivate()
    layer.cleanup()
    layer.shutdown()
    with pytest.raises(LifecycleError):
        layer.configure(PluginContext())


@every_layer
def test_it_can_be_disabled_and_reset(make):
    layer = make()
    assert layer.is_enabled()
    layer.set_parameters(enabled=False)
    assert not layer.is_enabled()
    layer.reset()
    layer.match_size()
    layer.on_footprint_changed()


@every_layer
def test_unknown_parameters_are_refused_and_change_nothing(make):
    layer = make()
    before = layer.parameters
    with pytest.raises(InvalidValue, match="unknown parameter"):
        layer.set_parameters(enbaled=False)
    assert layer.parameters is before
