import math

import numpy as np
import pytest
import yaml
from scipy.ndimage import distance_transform_edt

from optdock.errors import InvalidValue
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.io.maps import load_map
from optdock.nav2.layered_costmap import LayeredCostmap
from optdock.nav2.layers.inflation import InflationLayer, InflationRule
from optdock.nav2.layers.obstacle import ObstacleLayer
from optdock.nav2.layers.obstacle_parameters import CombinationMethod, combined
from optdock.nav2.layers.scan import LaserScan
from optdock.nav2.layers.static import StaticLayer

SENSOR = (0.55, 0.55)
ROBOT = Pose2(*SENSOR, 0.0)


def stack(footprint=None, **parameters):
    layer = ObstacleLayer(**parameters)
    return layer, LayeredCostmap({"obstacles": layer}, footprint, width=8.0, height=8.0, resolution=0.1)


def lethal(costs):
    return {tuple(cell) for cell in np.argwhere(costs.data == 254)[:, ::-1].tolist()}


def free(costs):
    return {tuple(cell) for cell in np.argwhere(costs.data == 0)[:, ::-1].tolist()}


def beam(distance, **changes):
    values = {"angle_min": 0.0, "angle_increment": 0.1, "range_min": 0.05, "range_max": 5.0, **changes}
    return LaserScan(np.array([distance]), **values)


def test_defaults_are_nav2s_except_that_unknown_stays_unknown():
    parameters = ObstacleLayer().parameters
    assert parameters.track_unknown_space
    assert (parameters.marking, parameters.clearing, parameters.inf_is_valid) == (True, False, False)
    assert parameters.combination_method is CombinationMethod.MAX
    assert parameters.footprint_clearing_enabled
    ranges = ("obstacle_max_range", "obstacle_min_range", "raytrace_max_range", "raytrace_min_range")
    assert [getattr(parameters, name) for name in ranges] == [2.5, 0.0, 3.0, 0.0]


def test_points_mark_their_cells_and_nothing_else():
    layer, costmap = stack()
    layer.add_points([[1.05, 0.55], [0.55, 2.349]], SENSOR)
    costs = costmap.update(ROBOT)
    assert lethal(costs) == {(10, 5), (5, 23)}
    assert free(costs) == set()


def test_marks_stay_until_something_clears_them():
    layer, costmap = stack(clearing=True)
    layer.add_points([[1.05, 0.55]], SENSOR)
    costmap.update(ROBOT)
    assert (10, 5) in lethal(costmap.update(ROBOT))
    layer.add_points([[2.05, 0.55]], SENSOR)
    assert lethal(costmap.update(ROBOT)) == {(20, 5)}


def test_a_line_of_sight_is_cleared_up_to_the_hit():
    layer, costmap = stack(clearing=True)
    layer.add_points([[2.05, 0.55]], SENSOR)
    costs = costmap.update(ROBOT)
    assert free(costs) == {(i, 5) for i in range(5, 20)}
    assert lethal(costs) == {(20, 5)}


def test_no_beam_wipes_out_what_another_has_hit():
    layer, costmap = stack(clearing=True)
    layer.add_points([[1.05, 0.55], [2.05, 0.56]], SENSOR)
    layer.add_points([[2.35, 0.55]], SENSOR)
    assert lethal(costmap.update(ROBOT)) == {(10, 5), (20, 5), (23, 5)}


def test_marking_ranges_include_the_minimum_and_exclude_the_maximum():
    layer, costmap = stack(obstacle_min_range=1.0, obstacle_max_range=2.0)
    layer.add_points([[0.99, 0.0], [1.0, 0.0], [1.99, 0.0], [2.0, 0.0]], (0.0, 0.0))
    assert lethal(costmap.update(ROBOT)) == {(10, 0), (19, 0)}


def test_clearing_ranges_cut_the_line():
    layer, costmap = stack(clearing=True, raytrace_min_range=0.5, raytrace_max_range=1.0, marking=False)
    layer.add_points([[2.55, 0.55], [0.55, 0.75]], SENSOR)
    assert free(costmap.update(ROBOT)) == {(i, 5) for i in range(10, 16)}


def test_beams_without_return_are_dropped_or_clear():
    for is_valid in (False, True):
        layer, costmap = stack(clearing=True, inf_is_valid=is_valid)
        layer.add_scan(beam(math.inf), ROBOT)
        costs = costmap.update(ROBOT)
        assert lethal(costs) == set()
        assert free(costs) == ({(i, 5) for i in range(5, 36)} if is_valid else set())


@pytest.mark.parametrize("distance", [math.nan, -math.inf, 0.01, 5.01, -1.0])
def test_beams_without_measurement_are_dropped(distance):
    layer, costmap = stack(clearing=True, inf_is_valid=True)
    layer.add_scan(beam(distance), ROBOT)
    costs = costmap.update(ROBOT)
    assert (lethal(costs), free(costs)) == (set(), set())


def test_a_scan_is_seen_from_the_sensors_pose():
    layer, costmap = stack()
    scan = LaserScan(np.array([1.0, math.nan, 2.0]), 0.0, -math.pi / 4, 0.05, 5.0)
    layer.add_scan(scan, Pose2(3.05, 3.05, math.pi / 2))
    assert lethal(costmap.update(ROBOT)) == {(30, 40), (50, 30)}


def test_points_that_are_not_finite_or_absurd_are_dropped():
    layer, costmap = stack(clearing=True)
    layer.add_points([[math.nan, 1.0], [math.inf, 1.0], [1e200, 1.0], [1.05, 0.55]], SENSOR)
    assert lethal(costmap.update(ROBOT)) == {(10, 5)}


def test_lines_far_beyond_the_map_are_cut_to_it():
    layer, costmap = stack(clearing=True, raytrace_max_range=1e9, obstacle_max_range=1e9)
    layer.add_points([[9e8, 0.55], [-9e8, 9e8]], SENSOR)
    layer.add_points([[5.05, 1.05]], (5.05, -9e8))
    costs = costmap.update(ROBOT)
    assert {(i, 5) for i in range(5, 80)} <= free(costs)
    assert {(50, j) for j in range(10)} <= free(costs)
    assert lethal(costs) == {(50, 10)}


def test_the_footprint_is_kept_free():
    for enabled in (True, False):
        layer, costmap = stack(Footprint.rectangle(0.2, 0.2, 0.2), footprint_clearing_enabled=enabled)
        layer.add_points([[0.65, 0.55], [1.05, 0.55]], SENSOR)
        assert lethal(costmap.update(ROBOT)) == ({(10, 5)} if enabled else {(6, 5), (10, 5)})


def test_reset_forgets_and_is_current_again_after_the_next_update():
    layer, costmap = stack()
    layer.add_points([[1.05, 0.55]], SENSOR)
    costmap.update(ROBOT)
    costmap.clear()
    assert not layer.is_current()
    assert lethal(costmap.update(ROBOT)) == set()
    assert layer.is_current()
    assert layer.is_clearable()


def test_untracked_unknown_starts_free():
    _, costmap = stack(track_unknown_space=False)
    assert np.all(costmap.update(ROBOT).data == 0)


@pytest.mark.parametrize(
    ("method", "expected"),
    [
        ("overwrite", [10, 20, 255, 10, 20, 255, 10, 20, 255]),
        ("max", [100, 100, 100, 10, 20, 0, 10, 20, 255]),
        ("max_without_unknown_overwrite", [100, 100, 100, 10, 20, 0, 255, 255, 255]),
    ],
)
def test_combination_methods(method, expected):
    master = np.repeat(np.array([100, 0, 255], dtype=np.uint8), 3)
    layer = np.tile(np.array([10, 20, 255], dtype=np.uint8), 3)
    if method == "overwrite":  # where the layer knows nothing the master stays
        expected = [10, 20, 100, 10, 20, 0, 10, 20, 255]
    number = ObstacleLayer(combination_method=method).parameters.combination_method
    assert combined(master, layer, number).tolist() == expected
    assert ObstacleLayer(combination_method=int(number)).parameters.combination_method is number


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"combination_method": "min"}, "must be one of overwrite, max, max_without_unknown_overwrite"),
        ({"combination_method": 3}, "combination_method"),
        ({"obstacle_max_range": -1.0}, "obstacle_max_range"),
        ({"raytrace_max_range": math.inf}, "raytrace_max_range"),
        ({"obstacle_range": 1.0}, "unknown parameter"),
    ],
)
def test_bad_parameters_are_named(parameters, message):
    with pytest.raises(InvalidValue, match=message):
        ObstacleLayer(**parameters)


SOURCE = {
    "topic": "/scan",
    "max_obstacle_height": 2.0,
    "clearing": True,
    "data_type": "LaserScan",
    "raytrace_max_range": 4.0,
    "obstacle_max_range": 3.5,
}


def test_a_nav2_block_can_be_passed_as_it_is():
    for layer in (
        ObstacleLayer(enabled=True, observation_sources="scan", scan=SOURCE, footprint_clearing_enabled=False),
        ObstacleLayer(enabled=True, footprint_clearing_enabled=False, **SOURCE),
    ):
        parameters = layer.parameters
        assert (parameters.clearing, parameters.footprint_clearing_enabled) == (True, False)
        assert (parameters.raytrace_max_range, parameters.obstacle_max_range) == (4.0, 3.5)
        layer.set_parameters(clearing=False)
        assert layer.parameters.raytrace_max_range == 4.0


def test_the_layers_of_nav2s_own_parameter_file(real_data):
    text = (real_data / "nav2" / "params" / "nav2_params.yaml").read_text()
    blocks = yaml.safe_load(text)["global_costmap"]["global_costmap"]["ros__parameters"]
    kinds = {"static_layer": StaticLayer, "obstacle_layer": ObstacleLayer, "inflation_layer": InflationLayer}
    layers = {
        name: kind(**{key: value for key, value in blocks[name].items() if key != "plugin"})
        for name, kind in kinds.items()
    }
    assert layers["obstacle_layer"].parameters.clearing
    assert layers["inflation_layer"].parameters.inflation_radius == 0.7
    grid = load_map(real_data / "nav2" / "maps" / "tb3_sandbox.yaml")
    layers["static_layer"].set_map(grid)
    costs = LayeredCostmap.of_map(grid, layers, Footprint.from_radius(blocks["robot_radius"])).update(ROBOT)
    # Lethal cells are the map's; around them Nav2's costs by the distance to the nearest.
    np.testing.assert_array_equal(costs.data == 254, grid.data == 100)
    distance = distance_transform_edt(grid.data != 100) * 0.05
    known = grid.data == 0
    rule = InflationRule(Footprint.from_radius(0.22).inscribed_radius, 0.7, 3.0)
    np.testing.assert_array_equal(costs.data[known], rule.cost_at(distance[known]))


@pytest.mark.parametrize(
    "points", [[1.0, 2.0, 3.0], [["a", "b"]], [[1.0], [1.0, 2.0]], None, "near", [[1.0, 2.0, 3.0]]]
)
def test_points_of_another_shape_or_kind_are_refused_and_leave_no_trace(points):
    layer, costmap = stack()
    with pytest.raises(InvalidValue, match=r"obstacles: points must be numbers of shape \(n, 2\), got"):
        layer.add_points(points, SENSOR)
    assert lethal(costmap.update(ROBOT)) == set()


@pytest.mark.parametrize("sensor", [(math.nan, 0.0), (0.0, 0.0, 0.0), None, (), "here", (math.inf, 0.0)])
def test_a_sensor_without_a_position_is_refused_and_leaves_no_trace(sensor):
    layer, costmap = stack()
    with pytest.raises(InvalidValue, match="the sensor's position must be two finite numbers, got"):
        layer.add_points([[1.05, 0.55]], sensor)
    assert lethal(costmap.update(ROBOT)) == set()


def test_no_points_are_no_observation_of_anything():
    layer, costmap = stack(clearing=True)
    layer.add_points([], SENSOR)
    layer.add_scan(LaserScan(np.full(9, math.nan), 0.0, 0.1, 0.05, 5.0), ROBOT)
    costs = costmap.update(ROBOT)
    assert (lethal(costs), free(costs)) == (set(), set())


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"ranges": np.zeros((2, 2))}, r"shape \(n,\), got \(2, 2\)"),
        ({"ranges": "near"}, "must be numbers"),
        ({"angle_min": math.nan}, "angle_min: must be finite"),
        ({"angle_increment": math.inf}, "angle_increment: must be finite"),
        ({"range_max": 0.01}, "0 <= range_min < range_max < inf"),
        ({"range_max": math.inf}, "0 <= range_min < range_max < inf"),
        ({"range_min": math.nan}, "0 <= range_min < range_max < inf"),
    ],
)
def test_bad_scans_are_named(changes, message):
    values = {"ranges": np.ones(3), "angle_min": 0.0, "angle_increment": 0.1, "range_min": 0.05, "range_max": 5.0}
    with pytest.raises(InvalidValue, match=message):
        LaserScan(**{**values, **changes})
