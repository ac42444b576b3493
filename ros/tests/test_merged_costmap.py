"""Merged costmaps keep every obstacle of their sources."""

from __future__ import annotations

import math

import numpy as np
import pytest
from optdock_ros.merged_costmap import joined, moved

from optdock.geometry.pose import Pose2, transform_points
from optdock.model.costmap import FREE_SPACE, LETHAL, NO_INFORMATION, Costmap


def scattered(seed: int, side: float = 0.05, origin: tuple[float, float] = (0.3, -0.7)) -> Costmap:
    """Return a grid of 40 x 30 cells, some of them occupied or unknown."""
    random = np.random.default_rng(seed)
    data = random.choice([FREE_SPACE, 100, LETHAL, NO_INFORMATION], p=[0.9, 0.05, 0.03, 0.02], size=(30, 40))
    return Costmap(data.astype(np.uint8), side, origin)


def points_within(costmap: Costmap, count: int = 20000) -> np.ndarray:
    """Return random points on a grid."""
    return np.random.default_rng(1).uniform(costmap.lower, costmap.upper, size=(count, 2))


@pytest.mark.parametrize(
    "frame", [Pose2(0.0, 0.0, 0.0), Pose2(0.35, -0.2, 0.0), Pose2(0.013, 0.02, 0.0), Pose2(1.0, 2.0, 0.7)]
)
def test_moved_costmap_has_no_lower_cost(frame: Pose2) -> None:
    before = scattered(0)
    after = moved(before, frame)
    points = points_within(before)
    there = transform_points(frame.as_array()[None], points)[0]
    costs, found = before.cost_at(points), after.cost_at(there)
    assert np.all(found[costs == LETHAL] == LETHAL), "also beside the unknown"
    assert np.all(found[costs == NO_INFORMATION] >= LETHAL)
    assert np.all(found >= np.minimum(costs, LETHAL))
    # And it is not all occupied: what is free with a cell and a half of room around stays free.
    far = 0.0 if frame.yaw == 0.0 else 1.5 * before.resolution * math.sqrt(2.0)
    around = [[0.0, 0.0], *([[far * math.cos(a), far * math.sin(a)] for a in np.linspace(0.0, 2.0 * math.pi, 32)])]
    free = np.all([before.cost_at(points + offset) == FREE_SPACE for offset in around], axis=0)
    if far == 0.0:
        assert np.all(after.cost_at(there)[free] == FREE_SPACE)
    else:
        assert np.mean(after.cost_at(there)[free] == FREE_SPACE) > 0.5


@pytest.mark.parametrize("yaw", [0.0, 0.5])
def test_moved_costmap_is_cropped_to_the_box(yaw: float) -> None:
    frame, box = Pose2(0.1, 0.2, yaw), (0.9, 0.3, 1.4, 0.7)
    after, whole = moved(scattered(0), frame, box), moved(scattered(0), frame)
    assert after.columns * after.rows <= 13 * 11
    points = np.random.default_rng(2).uniform(box[:2], box[2:], size=(1000, 2))
    assert np.all(after.cost_at(points) >= np.minimum(scattered(0).cost_at(at_origin(frame, points)), LETHAL))
    if yaw == 0.0:
        assert np.array_equal(after.cost_at(points), whole.cost_at(points))
    nothing = moved(scattered(0), frame, (50.0, 50.0, 51.0, 51.0))
    assert nothing.columns * nothing.rows == 1


def at_origin(frame: Pose2, points: np.ndarray) -> np.ndarray:
    """Return points in the frame's coordinates."""
    return transform_points(frame.inverse().as_array()[None], points)[0]


@pytest.mark.parametrize("side", [0.05, 0.1, 0.02])
@pytest.mark.parametrize("origin", [(0.3, -0.7), (0.31, -0.72), (-0.5, -1.0)])
def test_joined_costmap_has_the_obstacles_of_both(side: float, origin: tuple[float, float]) -> None:
    wide, local = scattered(2, side, origin), scattered(3, 0.05, (0.5, -0.5))
    both = joined(wide, local)
    for one in (wide, local):
        points = points_within(one)
        costs, found = one.cost_at(points), both.cost_at(points)
        assert np.all(found[costs == LETHAL] == LETHAL)
    points = points_within(both)
    unknown = both.cost_at(points) == NO_INFORMATION
    assert np.all(local.cost_at(points[unknown]) == NO_INFORMATION), "what is seen is known"
    seen = (wide.cost_at(points) == LETHAL) & (local.cost_at(points) == FREE_SPACE)
    assert np.all(both.cost_at(points[seen]) == LETHAL), "a wall that the robot does not see is a wall"
