import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from optdock.errors import InvalidValue
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.model.costmap import Costmap, OccupancyGrid
from optdock.model.dock import Dock
from optdock.nav2.layered_costmap import LayeredCostmap
from optdock.nav2.layers.dock_layer import DockLayer
from optdock.nav2.layers.raster import fill_footprint
from optdock.nav2.layers.static import StaticLayer

ROBOT = Footprint.rectangle(0.3, 0.3, 0.4)
STATION = Footprint(np.array([[0.3, -0.3], [0.5, -0.3], [0.5, 0.3], [0.3, 0.3]]))


def highest_cost(costs, pose):
    """Under the whole footprint of the robot, its inside included."""
    under = Costmap.writable(costs.data.shape, costs.resolution, costs.origin)
    fill_footprint(under, ROBOT, pose, 1)
    return int(costs.data[under.data == 1].max())


def dock_at(x, y, yaw):
    return Dock(Pose2(x, y, yaw), STATION)


def stack(dock, occupancy=0, **layers):
    grid = OccupancyGrid(np.full((60, 60), occupancy), 0.05)
    static, dock_layer = StaticLayer(), DockLayer()
    static.set_map(grid)
    dock_layer.set_dock(dock)
    return dock_layer, LayeredCostmap.of_map(grid, {"static": static, "dock": dock_layer, **layers}, ROBOT)


@given(st.floats(1.0, 2.0), st.floats(1.0, 2.0), st.floats(-math.pi, math.pi))
def test_the_docked_robot_is_free_and_the_one_that_went_too_far_is_not(x, y, yaw):
    dock = dock_at(x, y, yaw)
    _, costmap = stack(dock)
    costs = costmap.update(Pose2(0.0, 0.0, 0.0))
    too_far = dock.pose @ Pose2(0.12, 0.0, 0.0)
    assert (highest_cost(costs, dock.pose), highest_cost(costs, too_far)) == (0, 254)


def test_a_dock_that_the_map_shows_too_fat_blocks_without_the_layer_and_not_with_it():
    dock = dock_at(1.5, 1.5, 0.4)
    layer, costmap = stack(dock, occupancy=100)
    layer.set_parameters(enabled=False)
    assert highest_cost(costmap.update(Pose2(0.0, 0.0, 0.0)), dock.pose) == 254
    layer.set_parameters(enabled=True)
    assert highest_cost(costmap.update(Pose2(0.0, 0.0, 0.0)), dock.pose) == 0


def test_the_margin_says_how_much_of_the_map_is_cleared():
    layer, costmap = stack(Dock(Pose2(1.5, 1.5, 0.0)), occupancy=100)
    layer.set_parameters(contact_margin=0.19)
    costmap.set_footprint(ROBOT)
    cleared = np.argwhere(costmap.update(Pose2(0.0, 0.0, 0.0)).data == 0)
    assert (cleared.min(axis=0) * 0.05).tolist() == pytest.approx([1.1, 1.0])
    assert (cleared.max(axis=0) * 0.05).tolist() == pytest.approx([1.85, 1.95])


def test_a_dock_that_moves_leaves_nothing_behind():
    dock, elsewhere = dock_at(0.8, 0.8, 0.0), dock_at(2.0, 2.0, 1.0)
    layer, costmap = stack(dock)
    costmap.update(Pose2(0.0, 0.0, 0.0))
    layer.set_dock(elsewhere)
    moved = costmap.update(Pose2(0.0, 0.0, 0.0)).data
    _, fresh = stack(elsewhere)
    np.testing.assert_array_equal(moved, fresh.update(Pose2(0.0, 0.0, 0.0)).data)
    layer.set_dock(None)
    assert np.all(costmap.update(Pose2(0.0, 0.0, 0.0)).data == 0)


def test_without_a_dock_nothing_is_written():
    _, costmap = stack(None, occupancy=100)
    assert np.all(costmap.update(Pose2(0.0, 0.0, 0.0)).data == 254)


def test_a_negative_margin_is_refused():
    with pytest.raises(InvalidValue, match=r"DockLayer\.contact_margin"):
        DockLayer(contact_margin=-0.1)
