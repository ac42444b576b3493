import numpy as np
import pytest

from optdock.errors import InvalidValue
from optdock.model.costmap import Costmap, OccupancyGrid
from optdock.model.costs import INSCRIBED, LETHAL, OccupancyRule, costs_from_occupancy, occupancy_from_costs


def test_published_occupancies_follow_nav2s_integers():
    costs = np.array([0, 1, 2, 128, 251, 252, 253, 254, 255], dtype=np.uint8)
    assert occupancy_from_costs(costs).tolist() == [0, 1, 1, 1 + 97 * 127 // 251, 97, 98, 99, 100, -1]


def test_published_occupancies_never_fall_with_the_cost():
    occupancy = occupancy_from_costs(np.arange(255, dtype=np.uint8))
    assert np.all(np.diff(occupancy.astype(int)) >= 0)
    assert set(occupancy.tolist()) == set(range(101))


def test_trinary_keeps_only_unknown_inscribed_and_lethal():
    assert costs_from_occupancy([-1, 0, 50, 98, 99, 100]).tolist() == [255, 0, 0, 0, INSCRIBED, LETHAL]


def test_unknown_is_free_when_it_is_not_tracked():
    assert costs_from_occupancy([-1], OccupancyRule(track_unknown_space=False)).tolist() == [0]


def test_scaled_costs_are_the_share_of_the_threshold():
    rule = OccupancyRule(trinary_costmap=False, lethal_cost_threshold=80)
    assert costs_from_occupancy([0, 1, 40, 79, 80, 99], rule).tolist() == [0, 3, 127, 250, LETHAL, INSCRIBED]


def test_the_unknown_and_inscribed_values_can_be_moved():
    rule = OccupancyRule(unknown_cost_value=50, inscribed_obstacle_cost_value=98)
    assert costs_from_occupancy([50, 98, 99, -1], rule).tolist() == [255, INSCRIBED, 0, LETHAL]


@pytest.mark.parametrize("bad", [[101], [-2], [300]])
def test_occupancies_out_of_range_are_refused(bad):
    with pytest.raises(InvalidValue, match=f"got {bad[0]}"):
        costs_from_occupancy(bad)


def test_occupancies_that_are_not_integers_are_refused():
    with pytest.raises(InvalidValue, match="must be integers"):
        costs_from_occupancy([0.5])


@pytest.mark.parametrize("changes", [{"lethal_cost_threshold": 0}, {"lethal_cost_threshold": 101}])
def test_a_threshold_out_of_range_is_refused(changes):
    with pytest.raises(InvalidValue, match=r"lethal_cost_threshold: must be in 1\.\.100"):
        OccupancyRule(**changes)


@pytest.mark.parametrize("name", ["unknown_cost_value", "inscribed_obstacle_cost_value"])
def test_special_values_must_be_bytes(name):
    with pytest.raises(InvalidValue, match=name):
        OccupancyRule(**{name: 256})


def test_lethal_free_and_unknown_survive_the_round_trip():
    costmap = Costmap(costs_from_occupancy([[0, 100, -1, 99]]), 0.1)
    assert costmap.occupancy().tolist() == [[0, 100, -1, 99]]


def test_an_occupancy_grid_is_checked_copied_and_read_only():
    data = np.array([[0, 100]], dtype=np.int16)
    occupancy = OccupancyGrid(data, 0.5, (1, 2))
    data[0, 0] = 100
    assert occupancy.data.tolist() == [[0, 100]]
    assert not occupancy.data.flags.writeable
    assert occupancy.costmap.data.tolist() == [[0, LETHAL]]
    with pytest.raises(InvalidValue, match="resolution"):
        OccupancyGrid(data, 0.0)
    with pytest.raises(InvalidValue, match="occupancy"):
        OccupancyGrid(np.array([[101]]), 0.5)
