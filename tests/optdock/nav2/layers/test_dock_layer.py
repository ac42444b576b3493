import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optdock.errors import InvalidValue
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.model.costmap import Costmap, OccupancyGrid
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.nav2.global_costmap import layered_costmap
from optdock.nav2.layers.dock_layer import DockLayer
from optdock.nav2.layers.raster import fill_footprint
from optdock.nav2.layers.static import StaticLayer
from optdock.plugins.lifecycle import PluginContext

ROBOT = Footprint.rectangle(0.3, 0.3, 0.4)
STATION = Footprint(np.array([[0.3, -0.3], [0.5, -0.3], [0.5, 0.3], [0.3, 0.3]]))


def highest_cost(costs, pose):
    """Highest cost under the footprint of the robot, its interior included."""
    under = Costmap.writable(costs.data.shape, costs.resolution, costs.origin)
    fill_footprint(under, ROBOT, pose, 1)
    return int(costs.data[under.data == 1].max())


def costs_with(dock, occupancy=0, **parameters):
    grid = OccupancyGrid(np.full((60, 60), occupancy), 0.05)
    static, layer = StaticLayer(), DockLayer(**parameters)
    static.set_map(grid)
    layer.set_dock(dock)
    return layered_costmap(grid, {"static": static, "dock": layer}, Pose2(0.0, 0.0, 0.0), ROBOT)


@settings(max_examples=20)
@given(st.floats(1.0, 2.0), st.floats(1.0, 2.0), st.floats(-math.pi, math.pi))
def test_the_docked_robot_is_free_and_one_beyond_it_is_not(x, y, yaw):
    dock = Dock(Pose2(x, y, yaw), STATION)
    costs = costs_with(dock)
    too_far = dock.pose @ Pose2(0.12, 0.0, 0.0)
    assert (highest_cost(costs, dock.pose), highest_cost(costs, too_far)) == (0, 254)


def test_a_dock_that_is_too_large_in_the_map_blocks_only_without_the_layer():
    dock = Dock(Pose2(1.5, 1.5, 0.4), STATION)
    assert highest_cost(costs_with(dock, 100, enabled=False), dock.pose) == 254
    assert highest_cost(costs_with(dock, 100), dock.pose) == 0


def test_the_margin_is_the_distance_to_which_the_map_is_cleared():
    cleared = np.argwhere(costs_with(Dock(Pose2(1.5, 1.5, 0.0)), 100, contact_margin=0.19).data == 0)
    assert (cleared.min(axis=0) * 0.05).tolist() == pytest.approx([1.1, 1.0])
    assert (cleared.max(axis=0) * 0.05).tolist() == pytest.approx([1.85, 1.95])
    with pytest.raises(InvalidValue, match=r"DockLayer\.contact_margin"):
        DockLayer(contact_margin=-0.1)


def test_without_a_dock_nothing_is_written():
    assert np.all(costs_with(None, 100).data == 254)


def test_the_dock_of_the_problem_is_used_unless_one_was_set():
    problem = DockingProblem(Pose2(0.0, 0.0, 0.0), Dock(Pose2(1.0, 1.0, 0.0), STATION), Robot(ROBOT, MotionLimits()))
    for given_dock, x in ((None, 1.3), (Dock(Pose2(0.2, 1.0, 0.0), STATION), 0.5)):
        layer, master = DockLayer(), Costmap.writable((40, 40), 0.05, (0.0, 0.0))
        if given_dock is not None:
            layer.set_dock(given_dock)
        layer.configure(PluginContext(name="dock", problem=problem))
        layer.update_costs(master, 0, 0, 40, 40)
        assert np.argwhere(master.data == 254)[:, 1].min() * 0.05 == pytest.approx(x, abs=0.051)


def test_other_objects_than_docks_are_refused():
    with pytest.raises(InvalidValue, match="DockLayer: a dock must be a Dock or None, got 'home'"):
        DockLayer().set_dock("home")
