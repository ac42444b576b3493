"""ObstacleLayer with several observation sources: each its own rules, persistence and expected rate."""

import numpy as np
import pytest

from optdock.errors import InvalidValue
from optdock.geometry.pose import Pose2
from optdock.nav2.layered_costmap import LayeredCostmap
from optdock.nav2.layers.obstacle import ObstacleLayer
from optdock.nav2.layers.scan import LaserScan

SENSOR = (0.55, 0.55)
ROBOT = Pose2(*SENSOR, 0.0)
SOURCE = {"topic": "/scan", "clearing": True, "data_type": "LaserScan", "obstacle_max_range": 3.5}


def stack(**parameters):
    layer = ObstacleLayer(**parameters)
    return layer, LayeredCostmap({"obstacles": layer}, width=8.0, height=8.0, resolution=0.1)


def lethal(costs):
    return {tuple(cell) for cell in np.argwhere(costs.data == 254)[:, ::-1].tolist()}


def beam(distance):
    return LaserScan(np.array([distance]), 0.0, 0.1, 0.05, 5.0)


SEVERAL = {"observation_sources": "scan depth", "scan": SOURCE, "depth": {"marking": False, "clearing": True}}


def test_every_source_has_its_own_rules_and_the_layers_where_it_has_none():
    parameters = ObstacleLayer(obstacle_max_range=1.5, **SEVERAL).parameters
    assert list(parameters.sources) == ["scan", "depth"]
    assert [rules.obstacle_max_range for rules in parameters.sources.values()] == [3.5, 1.5]
    assert [rules.marking for rules in parameters.sources.values()] == [True, False]


def test_one_source_marks_and_another_only_clears():
    layer, costmap = stack(**SEVERAL)
    layer.add_points([[1.05, 0.55]], SENSOR, source="scan")
    assert lethal(costmap.update(ROBOT)) == {(10, 5)}
    layer.add_points([[1.35, 0.55]], SENSOR, source="depth")
    assert lethal(costmap.update(ROBOT)) == set()
    layer.set_parameters(enabled=False)
    assert list(layer.parameters.sources) == ["scan", "depth"]


@pytest.mark.parametrize("source", [None, "scann", "", 3])
def test_an_observation_of_no_source_is_refused(source):
    layer, costmap = stack(**SEVERAL)
    refusal = r"obstacles: source must be one of \['scan', 'depth'\], got"
    with pytest.raises(InvalidValue, match=refusal):
        layer.add_points([[1.0, 1.0]], SENSOR, source=source)
    with pytest.raises(InvalidValue, match=refusal):
        layer.add_scan(beam(1.0), ROBOT, source=source)
    assert lethal(costmap.update(ROBOT)) == set()


def test_the_only_source_may_be_named_or_not():
    layer, costmap = stack(observation_sources="scan", scan=SOURCE)
    layer.add_points([[1.05, 0.55]], SENSOR)
    layer.add_scan(beam(1.5), ROBOT, source="scan")
    assert lethal(costmap.update(ROBOT)) == {(10, 5), (20, 5)}
    with pytest.raises(InvalidValue, match="did you mean scan"):
        layer.add_points([[1.05, 0.55]], SENSOR, source="scam")


def test_one_source_twice_is_refused():
    with pytest.raises(InvalidValue, match="observation_sources: names scan more than once"):
        ObstacleLayer(observation_sources="scan scan", scan=SOURCE)


def test_an_observation_persists_as_long_as_told():
    now = [0.0]
    sources = {"observation_sources": "slow fast", "slow": {"observation_persistence": 1.0}, "fast": {"clearing": True}}
    layer = ObstacleLayer(**sources)
    costmap = LayeredCostmap({"obstacles": layer}, width=8.0, height=8.0, clock=lambda: now[0])
    layer.add_points([[1.05, 0.55]], SENSOR, source="slow")
    assert lethal(costmap.update(ROBOT)) == {(10, 5)}
    seen = []
    for now[0] in (0.5, 0.99, 1.0, 1.5):  # the update at 1.0 still had it; it is dropped after
        layer.add_points([[3.55, 0.55]], SENSOR, source="fast")
        seen.append((10, 5) in lethal(costmap.update(ROBOT)))
    assert seen == [True, True, True, False]


def test_a_silent_source_makes_the_layer_stale():
    now = [0.0]
    layer = ObstacleLayer(observation_sources="a b", a={"expected_update_rate": 0.4}, b={})
    costmap = LayeredCostmap({"obstacles": layer}, clock=lambda: now[0])
    costmap.update(ROBOT)
    now[0] = 0.4
    assert layer.is_current()
    now[0] = 0.5
    assert not layer.is_current()
    layer.add_points(np.zeros((0, 2)), SENSOR, source="b")
    assert not costmap.is_current
    layer.add_points(np.zeros((0, 2)), SENSOR, source="a")
    assert costmap.is_current
    now[0] = 1.0
    layer.reset()
    costmap.update(ROBOT)
    assert layer.is_current()


def test_misspelt_names_in_a_source_are_found():
    with pytest.raises(InvalidValue, match="clering: unknown parameter; did you mean clearing"):
        ObstacleLayer(observation_sources="scan", scan={"clering": True})
    with pytest.raises(InvalidValue, match=r"sources\.b\.clering: unknown parameter; did you mean clearing"):
        ObstacleLayer(observation_sources="a b", b={"clering": True})
