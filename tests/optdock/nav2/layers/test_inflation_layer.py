import logging
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from optdock.costmap.costmap import Costmap
from optdock.errors import InvalidValue
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.nav2.layers.inflation import InflationLayer, inflation_costs
from optdock.nav2.layers.window import EVERYWHERE, NOWHERE
from optdock.plugins.interfaces import Bounds
from optdock.plugins.lifecycle import PluginContext

HERE = Pose2(0.0, 0.0, 0.0)


def master_of(data, resolution=0.1):
    master = Costmap.writable(data.shape, resolution, (0.0, 0.0))
    master.data[:] = data
    return master


def inflated(data, **parameters):
    master = master_of(data)
    rows, columns = data.shape
    InflationLayer(custom_inscribed_radius=0.15, **parameters).update_costs(master, 0, 0, columns, rows)
    return master.data


def test_defaults_are_nav2s():
    assert InflationLayer(num_threads=-1).parameters.model_dump() == {
        "enabled": True,
        "inflation_radius": 0.55,
        "cost_scaling_factor": 10.0,
        "inflate_unknown": False,
        "inflate_around_unknown": False,
        "custom_inscribed_radius": -1.0,
    }


@given(st.integers(0, 2**32 - 1), st.data())
def test_a_window_gets_what_the_whole_grid_would_get_and_nothing_else_is_touched(seed, data):
    rng = np.random.default_rng(seed)
    costs = rng.choice([0, 0, 0, 0, 40, 254, 255], (12, 15)).astype(np.uint8)
    i0, i1 = sorted(data.draw(st.tuples(st.integers(0, 15), st.integers(0, 15))))
    j0, j1 = sorted(data.draw(st.tuples(st.integers(0, 12), st.integers(0, 12))))
    master = master_of(costs)
    InflationLayer(custom_inscribed_radius=0.15, inflation_radius=0.4).update_costs(master, i0, j0, i1, j1)
    whole = inflated(costs, inflation_radius=0.4)
    expected = costs.copy()
    expected[j0:j1, i0:i1] = whole[j0:j1, i0:i1]
    np.testing.assert_array_equal(master.data, expected)


@given(st.integers(0, 2**32 - 1))
def test_known_cells_keep_the_higher_cost(seed):
    rng = np.random.default_rng(seed)
    costs = rng.choice([0, 40, 120, 254], (10, 10), p=[0.5, 0.2, 0.2, 0.1]).astype(np.uint8)
    layer = InflationLayer(custom_inscribed_radius=0.15)
    expected = np.maximum(costs, inflation_costs(costs == 254, 0.1, layer.rule))
    np.testing.assert_array_equal(inflated(costs), expected)


def test_unknown_cells_take_strong_costs_only_unless_told_otherwise():
    row = np.array([[254, 255, 255, 255, 255, 255, 255]], dtype=np.uint8)
    assert inflated(row)[0].tolist() == [254, 253, 255, 255, 255, 255, 255]
    weak = inflated(row, inflate_unknown=True)[0].tolist()
    assert weak == [254, 253, 152, 56, 20, 7, 255]


def test_unknown_cells_inflate_only_when_told_to():
    row = np.array([[255, 0, 0]], dtype=np.uint8)
    assert inflated(row)[0].tolist() == [255, 0, 0]
    assert inflated(row, inflate_around_unknown=True)[0].tolist() == [254, 253, 152]


def test_a_radius_of_zero_does_nothing():
    row = np.array([[255, 0, 254]], dtype=np.uint8)
    assert inflated(row, inflation_radius=0.0, inflate_around_unknown=True)[0].tolist() == [255, 0, 254]


def test_the_footprint_gives_the_radius_unless_a_custom_one_is_set():
    layer = InflationLayer()
    layer.configure(PluginContext(name="inflation", footprint=Footprint.rectangle(0.5, 0.5, 0.4)))
    assert layer.rule.inscribed_radius == pytest.approx(0.2)
    layer.set_parameters(custom_inscribed_radius=0.3)
    assert layer.rule.inscribed_radius == 0.3


def test_without_any_radius_it_refuses_before_writing():
    master = master_of(np.array([[254, 0]], dtype=np.uint8))
    with pytest.raises(InvalidValue, match="needs an inscribed radius; give the costmap a footprint, or set"):
        InflationLayer().update_costs(master, 0, 0, 2, 1)
    assert master.data.tolist() == [[254, 0]]


def test_a_radius_below_the_inscribed_one_is_warned_of(caplog):
    layer = InflationLayer(inflation_radius=0.1)
    with caplog.at_level(logging.WARNING):
        layer.configure(PluginContext(name="inflation", footprint=Footprint.rectangle(0.5, 0.5, 0.4)))
    assert "inflation_radius 0.1 m is below the inscribed radius 0.2 m" in caplog.text


def test_bounds_grow_by_the_radius_and_to_everything_after_a_change():
    layer = InflationLayer(custom_inscribed_radius=0.2)
    box = Bounds(0.0, 0.0, 1.0, 2.0)
    assert layer.update_bounds(HERE, box) == EVERYWHERE
    assert layer.update_bounds(HERE, box) == (-0.55, -0.55, 1.55, 2.55)
    assert layer.update_bounds(HERE, NOWHERE) == NOWHERE
    layer.set_parameters(cost_scaling_factor=3.0)
    assert layer.update_bounds(HERE, box) == EVERYWHERE
    layer.on_footprint_changed()
    assert layer.update_bounds(HERE, box) == EVERYWHERE


@pytest.mark.parametrize(
    "parameters", [{"inflation_radius": -0.1}, {"cost_scaling_factor": math.nan}, {"inflation_raduis": 1.0}]
)
def test_bad_parameters_are_named(parameters):
    with pytest.raises(InvalidValue, match=f"InflationLayer.{next(iter(parameters))}"):
        InflationLayer(**parameters)
