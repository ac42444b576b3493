import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optdock.errors import InvalidValue
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.model.costmap import Costmap, OccupancyGrid
from optdock.nav2.global_costmap import layered_costmap
from optdock.nav2.layers.static import StaticLayer

GRID = OccupancyGrid(np.array([[0, 100, -1], [50, 99, 0]]), 0.5, (1.0, 2.0))
HERE = Pose2(0.0, 0.0, 0.0)


def layer_with(grid=GRID, **parameters):
    layer = StaticLayer(**parameters)
    layer.set_map(grid)
    return layer


def costs_of(place, *layers, robot=HERE, footprint=None):
    return layered_costmap(place, {str(k): layer for k, layer in enumerate(layers)}, robot, footprint)


def test_names_of_the_ros_graph_are_dropped_and_others_refused():
    StaticLayer(
        map_topic="map", map_subscribe_transient_local=True, subscribe_to_updates=False, transform_tolerance=0.1
    )
    with pytest.raises(InvalidValue, match=r"StaticLayer\.trinary_cosmap: unknown parameter; did you mean trinary"):
        StaticLayer(trinary_cosmap=False)


def test_the_map_is_converted_by_the_parameters():
    layer = layer_with()
    assert costs_of(GRID, layer).data.tolist() == [[0, 254, 255], [0, 253, 0]]
    layer.set_parameters(trinary_costmap=False, track_unknown_space=False)
    assert costs_of(GRID, layer).data.tolist() == [[0, 254, 0], [127, 253, 0]]


def test_another_map_replaces_the_first_and_leaves_cells_outside_of_it():
    layer = layer_with()
    layer.set_map(OccupancyGrid(np.array([[100]]), 0.5, (1.0, 2.0)))
    assert costs_of(GRID, layer).data.tolist() == [[254, 255, 255], [255, 255, 255]]


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.05, 0.1, 0.13]))
def test_every_master_cell_takes_the_map_at_its_centre(seed, resolution):
    rng = np.random.default_rng(seed)
    grid = OccupancyGrid(rng.choice([0, 100, -1], (9, 7)), 0.1, tuple(rng.uniform(-1, 1, 2)))
    costs = costs_of(OccupancyGrid(np.zeros((12, 15), dtype=np.int8), resolution), layer_with(grid))
    j, i = np.indices(costs.data.shape)
    centres = costs.centre_of(np.column_stack((i.ravel(), j.ravel())))
    np.testing.assert_array_equal(costs.data.ravel(), grid.costmap.cost_at(centres))


def test_use_maximum_keeps_higher_costs_below():
    high = layer_with(OccupancyGrid(np.array([[100, 0, 0], [0, 0, 0]]), 0.5, (1.0, 2.0)))
    assert costs_of(GRID, high, layer_with(use_maximum=True)).data.tolist() == [[254, 254, 255], [0, 253, 0]]


def test_the_footprint_is_cleared_where_the_robot_is():
    grid = OccupancyGrid(np.full((10, 10), 100), 0.1)
    layer, robot = layer_with(grid, footprint_clearing_enabled=True), Pose2(0.75, 0.75, 0.0)
    costs = costs_of(grid, layer, robot=robot, footprint=Footprint.from_radius(0.1))
    assert costs.cost_at([[0.25, 0.25], [0.75, 0.75]]).tolist() == [254, 0]


def test_without_a_map_it_is_not_current_and_writes_nothing():
    layer = StaticLayer()
    assert np.all(costs_of(GRID, layer).data == 255)
    assert not layer.is_current()
    layer.set_map(GRID)
    assert layer.is_current()
    layer.set_current(False)
    assert not layer.is_current()


@pytest.mark.parametrize("grid", [None, np.zeros((3, 3), dtype=np.int8), "map.yaml"])
def test_other_objects_than_maps_are_refused_and_the_old_one_stays(grid):
    layer = layer_with()
    with pytest.raises(InvalidValue, match="StaticLayer: a map must be an OccupancyGrid, got"):
        layer.set_map(grid)
    assert layer.is_current()


@pytest.mark.parametrize("window", [(0, 0, 4, 2), (-1, 0, 1, 1), (2, 0, 1, 1), (0, 0, 3, 3)])
def test_a_window_larger_than_the_master_is_refused_and_nothing_is_written(window):
    master = Costmap.writable((2, 3), 0.5, (1.0, 2.0), 7)
    with pytest.raises(InvalidValue, match="not within the master grid of 3 columns and 2 rows"):
        layer_with().update_costs(master, *window)
    assert np.all(master.data == 7)


def test_a_read_only_master_is_refused():
    with pytest.raises(InvalidValue, match="read-only"):
        layer_with().update_costs(Costmap(np.zeros((2, 3), dtype=int), 0.5), 0, 0, 1, 1)
