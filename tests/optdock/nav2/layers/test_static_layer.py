import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from optdock.errors import InvalidValue
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.model.costmap import Costmap, OccupancyGrid
from optdock.nav2.layered_costmap import LayeredCostmap
from optdock.nav2.layers.static import StaticLayer
from optdock.nav2.layers.window import NOWHERE

GRID = OccupancyGrid(np.array([[0, 100, -1], [50, 99, 0]]), 0.5, (1.0, 2.0))
HERE = Pose2(0.0, 0.0, 0.0)


def layer_with(grid=GRID, **parameters):
    layer = StaticLayer(**parameters)
    layer.set_map(grid)
    return layer


def test_defaults_are_nav2s_except_that_unknown_stays_unknown():
    parameters = StaticLayer().parameters.model_dump()
    assert parameters == {
        "enabled": True,
        "track_unknown_space": True,
        "lethal_cost_threshold": 100,
        "trinary_costmap": True,
        "unknown_cost_value": 255,
        "inscribed_obstacle_cost_value": 99,
        "use_maximum": False,
        "footprint_clearing_enabled": False,
    }


def test_names_of_the_ros_graph_are_dropped_and_others_refused():
    StaticLayer(
        map_topic="map", map_subscribe_transient_local=True, subscribe_to_updates=False, transform_tolerance=0.1
    )
    with pytest.raises(InvalidValue, match=r"StaticLayer\.trinary_cosmap: unknown parameter; did you mean trinary"):
        StaticLayer(trinary_cosmap=False)


def test_the_map_is_converted_by_the_parameters():
    assert LayeredCostmap.of_map(GRID, {"map": layer_with()}).update(HERE).data.tolist() == [[0, 254, 255], [0, 253, 0]]
    layer = layer_with(trinary_costmap=False, track_unknown_space=False)
    assert LayeredCostmap.of_map(GRID, {"map": layer}).update(HERE).data.tolist() == [[0, 254, 0], [127, 253, 0]]


def test_changed_parameters_show_in_the_next_update():
    layer = layer_with()
    costmap = LayeredCostmap.of_map(GRID, {"map": layer})
    costmap.update(HERE)
    layer.set_parameters(track_unknown_space=False)
    assert costmap.update(HERE).data[0, 2] == 0


def test_another_map_shows_in_the_next_update():
    layer = layer_with()
    costmap = LayeredCostmap.of_map(GRID, {"map": layer})
    costmap.update(HERE)
    layer.set_map(OccupancyGrid(np.array([[100]]), 0.5, (1.0, 2.0)))
    assert costmap.update(HERE).data.tolist() == [[254, 255, 255], [255, 255, 255]]


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.05, 0.1, 0.13]))
def test_every_master_cell_takes_the_map_at_its_centre(seed, resolution):
    rng = np.random.default_rng(seed)
    grid = OccupancyGrid(rng.choice([0, 100, -1], (9, 7)), 0.1, tuple(rng.uniform(-1, 1, 2)))
    costmap = LayeredCostmap({"map": layer_with(grid)}, width=1.5, height=1.0, resolution=resolution)
    costs = costmap.update(HERE)
    j, i = np.indices(costs.data.shape)
    centres = costs.centre_of(np.column_stack((i.ravel(), j.ravel())))
    np.testing.assert_array_equal(costs.data.ravel(), grid.costmap.cost_at(centres))


def test_use_maximum_keeps_higher_costs_below():
    high = layer_with(OccupancyGrid(np.array([[100, 0, 0], [0, 0, 0]]), 0.5, (1.0, 2.0)))
    costs = LayeredCostmap.of_map(GRID, {"high": high, "map": layer_with(use_maximum=True)}).update(HERE).data
    assert costs.tolist() == [[254, 254, 255], [0, 253, 0]]


def test_the_footprint_is_cleared_and_comes_back_when_the_robot_leaves():
    grid = OccupancyGrid(np.full((10, 10), 100), 0.1)
    costmap = LayeredCostmap.of_map(
        grid, {"map": layer_with(grid, footprint_clearing_enabled=True)}, Footprint.from_radius(0.1)
    )
    assert costmap.update(Pose2(0.25, 0.25, 0.0)).cost_at([[0.25, 0.25], [0.75, 0.75]]).tolist() == [0, 254]
    assert costmap.update(Pose2(0.75, 0.75, 0.0)).cost_at([[0.25, 0.25], [0.75, 0.75]]).tolist() == [254, 0]


def test_without_a_map_it_is_not_current_and_writes_nothing():
    layer = StaticLayer()
    costmap = LayeredCostmap({"map": layer}, width=1.0, height=1.0)
    assert np.all(costmap.update(HERE).data == 255)
    assert not costmap.is_current
    layer.set_map(GRID)
    costmap.update(HERE)
    assert costmap.is_current


def test_a_written_map_asks_for_nothing_more():
    layer = layer_with()
    costmap = LayeredCostmap.of_map(GRID, {"map": layer})
    costmap.update(HERE)
    assert layer.update_bounds(HERE, NOWHERE) == NOWHERE
    layer.reset()
    assert layer.update_bounds(HERE, NOWHERE) == (1.0, 2.0, 2.5, 3.0)


@pytest.mark.parametrize("window", [(0, 0, 4, 2), (-1, 0, 1, 1), (2, 0, 1, 1), (0, 0, 3, 3)])
def test_a_window_larger_than_the_master_is_refused_and_nothing_is_written(window):
    master = Costmap.writable((2, 3), 0.5, (1.0, 2.0), 7)
    with pytest.raises(InvalidValue, match="not within the master grid of 3 columns and 2 rows"):
        layer_with().update_costs(master, *window)
    assert np.all(master.data == 7)


def test_a_read_only_master_is_refused():
    with pytest.raises(InvalidValue, match="read-only"):
        layer_with().update_costs(Costmap(np.zeros((2, 3), dtype=int), 0.5), 0, 0, 1, 1)
