import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from optdock.costmap.costmap import Costmap
from optdock.costmap.footprint_cost import footprint_cost_at, footprint_is_free, outline_cost_at
from optdock.errors import InvalidValue
from optdock.geometry.footprint import Footprint
from optdock.interfaces import CostmapInfoType

SQUARE = Footprint(np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]]))
U_SHAPE = Footprint(
    np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [0.3, 0.5], [0.3, -0.3], [-0.3, -0.3], [-0.3, 0.5], [-0.5, 0.5]])
)


def with_cells(*cells, cost=254):
    data = np.zeros((100, 100), dtype=np.uint8)
    for i, j in cells:
        data[j, i] = cost
    return Costmap(data, 0.1)


@pytest.mark.parametrize("cost_at", [footprint_cost_at, outline_cost_at])
def test_nav2s_numbers_in_a_free_island(cost_at):
    data = np.full((100, 100), 254, dtype=np.uint8)
    data[40:61, 40:61] = 0
    poses = [[5.0, 5.0, 0.0], [5.0, 4.9, 0.0], [5.0, 5.2, 0.0]]
    assert cost_at(Costmap(data, 0.1), SQUARE, poses).tolist() == [0, 254, 254]


@pytest.mark.parametrize("cost_at", [footprint_cost_at, outline_cost_at])
def test_nav2s_numbers_beside_single_cells(cost_at):
    poses = [[5.0, 5.0, 0.0], [4.9, 5.0, 0.0], [5.2, 5.0, 0.0]]
    assert cost_at(with_cells((62, 50), (39, 60)), SQUARE, poses).tolist() == [0, 254, 254]


def test_an_obstacle_inside_is_seen_here_and_missed_by_the_outline():
    costmap = with_cells((50, 50))
    assert outline_cost_at(costmap, SQUARE, [[5.0, 5.0, 0.3]]).tolist() == [0]
    assert footprint_cost_at(costmap, SQUARE, [[5.0, 5.0, 0.3]]).tolist() == [254]


def test_an_obstacle_in_the_mouth_of_a_u_is_outside():
    costmap = with_cells((50, 50))
    assert footprint_cost_at(costmap, U_SHAPE, [[5.05, 5.05, 0.0]]).tolist() == [0]
    assert footprint_cost_at(costmap, U_SHAPE, [[5.05, 5.45, 0.0]]).tolist() == [254]


@given(st.integers(0, 2**32 - 1))
def test_the_whole_costs_at_least_as_much_as_the_outline(seed):
    # Unturned, where Bresenham's cells are those that the edge truly meets.
    rng = np.random.default_rng(seed)
    costmap = Costmap(rng.integers(0, 255, (40, 40)), 0.25)
    poses = np.column_stack((rng.uniform(0, 10, (20, 2)), np.zeros(20)))
    for footprint in (SQUARE, U_SHAPE):
        assert np.all(footprint_cost_at(costmap, footprint, poses) >= outline_cost_at(costmap, footprint, poses))


@given(st.integers(0, 2**32 - 1))
def test_no_sampled_point_of_the_footprint_costs_more(seed):
    rng = np.random.default_rng(seed)
    costmap = Costmap(rng.integers(0, 253, (40, 40)), 0.25)
    pose = np.array([*rng.uniform(2, 8, 2), rng.uniform(-4, 4)])
    c, s = np.cos(pose[2]), np.sin(pose[2])
    local = rng.uniform(-1, 1, (200, 2))
    points = pose[:2] + local @ np.array([[c, s], [-s, c]])
    assert footprint_cost_at(costmap, SQUARE, pose[None])[0] >= costmap.cost_at(points).max()


def test_off_the_map_is_lethal_and_unknown_collides():
    costmap = with_cells((50, 50), cost=255)
    poses = [[0.5, 5.0, 0.0], [1e300, 0.0, 0.0], [5.0, 5.0, 0.0], [2.0, 2.0, 0.0]]
    assert footprint_cost_at(costmap, SQUARE, poses).tolist() == [254, 254, 255, 0]
    assert footprint_is_free(costmap, SQUARE, poses).tolist() == [False, False, False, True]


def test_inscribed_cells_do_not_block_the_outline():
    assert footprint_is_free(with_cells((50, 50), cost=253), SQUARE, [[5.0, 5.0, 0.0]]).tolist() == [True]


def test_no_pose_costs_nothing():
    assert footprint_cost_at(with_cells(), SQUARE, np.zeros((0, 3))).tolist() == []
    assert outline_cost_at(with_cells(), SQUARE, np.zeros((0, 3))).tolist() == []


@pytest.mark.parametrize("cost_at", [footprint_cost_at, outline_cost_at, footprint_is_free])
def test_poses_that_are_not_finite_are_refused(cost_at):
    with pytest.raises(InvalidValue, match="poses: must be finite"):
        cost_at(with_cells(), SQUARE, [[np.nan, 0.0, 0.0]])


def test_costmap_info_has_nav2s_numbers():
    assert [(kind.name, kind.value) for kind in CostmapInfoType] == [
        ("NONE", 0),
        ("LOCAL", 1),
        ("GLOBAL", 2),
        ("BOTH", 3),
    ]
