"""Costmap and footprint topics in a node of this process."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hall import COSTMAP, FOOTPRINT, OUTLINE, Surroundings
from harness import LATCHED, spinning
from nav_msgs.msg import OccupancyGrid
from optdock_ros.frame_lookup import TransformBuffer
from optdock_ros.surroundings import CostmapTopic, FootprintTopic, SurroundingsError, first_collision, nav2_footprint
from rclpy.node import Node

from optdock import ros
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.model.costmap import Costmap as Grid
from optdock.model.costs import LETHAL, NO_INFORMATION
from optdock.ros.transforms import TransformError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from harness import Client

    from optdock.ros import StampedCostmap


@pytest.fixture(scope="module")
def node(context: None) -> Iterator[Node]:  # noqa: ARG001 - a node needs it
    """A node that spins."""
    made = Node("surroundings")
    with spinning(made):
        yield made


@pytest.fixture(scope="module")
def world(client_node: Client) -> Surroundings:
    """The publishers."""
    return Surroundings(client_node)


@pytest.fixture
def topic(node: Node, world: Surroundings, client_node: Client) -> Iterator[CostmapTopic]:
    """A costmap topic with a small grid."""
    made = CostmapTopic(node, COSTMAP)
    world.costmap(small())
    client_node.until(lambda: heard(made), what="a costmap")
    # Latched messages of tests before this one come before the first of this one.
    time.sleep(0.1)
    world.costmap(small())
    client_node.until(lambda: np.array_equal(made.newest().costmap.data, small().data))
    yield made
    made.close()


def small(value: int = 0) -> Grid:
    """Return a grid of 4 x 3 cells."""
    return Grid(np.full((3, 4), value, dtype=np.uint8), 0.5, (1.0, 2.0))


def heard(topic: CostmapTopic) -> StampedCostmap | None:
    """Return the costmap of a topic, or None."""
    try:
        return topic.newest()
    except SurroundingsError:
        return None


def test_no_costmap_yet(node: Node) -> None:
    silent = CostmapTopic(node, "silent/costmap_raw")
    with pytest.raises(SurroundingsError, match=r"silent/costmap_raw: no costmap yet"):
        silent.newest()
    silent.close()


def test_a_costmap_and_its_updates(topic: CostmapTopic, world: Surroundings, client_node: Client) -> None:
    first = topic.newest()
    assert (first.frame, first.costmap.resolution, first.costmap.origin) == ("map", 0.5, (1.0, 2.0))
    assert topic.newest() is first
    world.update(1, 0, np.full((2, 3), LETHAL))
    client_node.until(lambda: bool(topic.newest().costmap.data.any()), what="an update")
    expected = np.zeros((3, 4))
    expected[0:2, 1:4] = LETHAL
    assert np.array_equal(topic.newest().costmap.data, expected)
    assert topic.newest().stamp > first.stamp
    world.costmap(small(7))
    client_node.until(lambda: np.all(topic.newest().costmap.data == 7), what="a whole costmap")


def test_many_updates_are_applied(topic: CostmapTopic, world: Surroundings, client_node: Client) -> None:
    for n in range(100):
        world.update(n % 4, n % 3, np.full((1, 1), n))
        time.sleep(0.002)
    client_node.until(lambda: topic.newest().costmap.data[99 % 3, 99 % 4] == 99, what="the last update")
    assert len(topic._updates) < 32


def test_update_that_does_not_fit_invalidates_the_costmap(
    topic: CostmapTopic, world: Surroundings, client_node: Client
) -> None:
    world.update(3, 2, np.full((2, 2), 1))
    with pytest.raises(SurroundingsError, match="must lie within the 4 x 3 cells"):
        client_node.until(lambda: topic.newest() and None, timeout=5.0)
    with pytest.raises(SurroundingsError, match="must lie within the 4 x 3 cells"):  # until something better comes
        topic.newest()
    world.costmap(small(5))
    client_node.until(lambda: heard(topic))


def test_invalid_costmap(topic: CostmapTopic, world: Surroundings, client_node: Client) -> None:
    bad = ros.costmap_message(ros.imported, small(), "map", 1.0)
    bad.metadata.size_x = 5
    world._costmap.publish(bad)
    with pytest.raises(SurroundingsError, match=r"costmap_raw: nav2_msgs/msg/Costmap: data: must have 5 x 3 cells"):
        client_node.until(lambda: topic.newest() and None, timeout=5.0)


def test_an_occupancy_grid(node: Node, client_node: Client) -> None:
    publisher = client_node.create_publisher(OccupancyGrid, "map", LATCHED)
    publisher.publish(ros.occupancy_message(ros.imported, small(LETHAL), "map", 5.0))
    grid = CostmapTopic(node, "map")
    client_node.until(lambda: heard(grid), what="a map")
    assert (grid.newest().costmap.data == LETHAL).all()
    assert grid.newest().stamp == 5.0
    grid.close()


@pytest.fixture
def outline(node: Node) -> Iterator[tuple[FootprintTopic, TransformBuffer]]:
    """A footprint topic and its transforms."""
    buffer = TransformBuffer(node)
    made = FootprintTopic(node, FOOTPRINT, buffer, "base_link", 0.2)
    yield made, buffer
    made.close()
    buffer.close()


def publish_first_outline(
    outline: tuple[FootprintTopic, TransformBuffer], world: Surroundings, client_node: Client, stood: Pose2
) -> None:
    """Publish the transform and the outline of a robot at a pose in the map, and wait until both have arrived."""
    topic, buffer = outline
    client_node.until(
        lambda: world.transform("map", "base_link", stood) or "base_link" in buffer.frames, what="a transform"
    )
    world.transform("map", "base_link", stood)
    world.footprint(stood, "map")
    client_node.until(lambda: topic.is_heard)


def test_outline_is_transformed_to_the_robot(
    outline: tuple[FootprintTopic, TransformBuffer], world: Surroundings, client_node: Client
) -> None:
    topic, _ = outline
    assert not topic.is_heard
    with pytest.raises(SurroundingsError, match="no footprint yet"):
        topic.newest()
    client_node.until(world._footprint.get_subscription_count)
    stood = Pose2(130.0, -95.0, 0.8)  # where a float tells 8 micrometres: four times what contact forgives
    publish_first_outline(outline, world, client_node, stood)
    found, stamp = topic.newest()
    assert np.abs(found.vertices - OUTLINE.vertices).max() < 1e-12
    assert abs(world.now() - stamp) < 5.0
    world.transform("map", "base_link", Pose2(1.0, 1.0, 0.2))
    world.footprint(Pose2(1.0, 1.0, 0.2), "map")
    time.sleep(0.1)
    assert topic.newest()[0] is found  # it is no other because floats are short
    world.footprint(outline=Footprint.rectangle(1.0, 1.0, 1.0))
    client_node.until(lambda: topic.newest()[0] is not found)
    assert topic.newest()[0].length == pytest.approx(2.0)


def test_known_outline_is_used_until_the_transform_arrives(
    outline: tuple[FootprintTopic, TransformBuffer], world: Surroundings, client_node: Client
) -> None:
    """An older transform would displace the outline of a moving robot."""
    topic, _ = outline
    topic.tolerance = 10.0
    client_node.until(world._footprint.get_subscription_count)
    stood = Pose2(1.0, 2.0, 0.3)
    publish_first_outline(outline, world, client_node, stood)
    found, stamp = topic.newest()
    time.sleep(0.05)
    moved = Pose2(1.1, 2.0, 0.3)
    world.footprint(moved, "map")  # newer than every transform, within the tolerance
    time.sleep(0.2)
    assert topic.newest() == (found, stamp)
    time.sleep(0.05)
    world.transform("map", "base_link", moved)
    client_node.until(lambda: topic.newest()[1] > stamp, what="the outline at the time of its transform")


def test_outline_in_an_unknown_frame(
    outline: tuple[FootprintTopic, TransformBuffer], world: Surroundings, client_node: Client
) -> None:
    topic, _ = outline
    client_node.until(world._footprint.get_subscription_count)
    world.footprint(Pose2(0.0, 0.0, 0.0), "nowhere")
    client_node.until(lambda: topic.is_heard)
    for _ in range(2):
        with pytest.raises(TransformError, match="there is no transform of 'nowhere'"):
            topic.newest()


def test_the_outline_of_nav2s_parameters() -> None:
    assert nav2_footprint("", 0.2, 0.0).inscribed_radius == pytest.approx(0.2)
    assert nav2_footprint("[]", 0.2, 0.01).inscribed_radius >= 0.21
    given = nav2_footprint("[[0.3, 0.2], [-0.3, 0.2], [-0.3, -0.2], [0.3, -0.2]]", 0.1, 0.01)
    assert (given.length, given.width) == (pytest.approx(0.62), pytest.approx(0.42))


def test_nav2s_collision_check() -> None:
    """Nav2's unit test, an obstacle inside the outline, unknown cells, and the border of the map."""
    square, free = Footprint.rectangle(1.0, 1.0, 2.0), np.zeros((100, 100), dtype=np.uint8)
    ring = np.full((100, 100), LETHAL, dtype=np.uint8)
    ring[40:61, 40:61] = 0
    points = free.copy()
    points[50, 62] = points[60, 39] = LETHAL

    def _hit(data: np.ndarray, x: float, y: float) -> bool:
        return first_collision(np.array([[x, y, 0.0]]), square, Grid(data, 0.1)) == 0

    assert [_hit(ring, 5.0, y) for y in (5.0, 4.9, 5.2)] == [False, True, True]
    assert [_hit(points, x, 5.0) for x in (5.0, 4.9, 5.2)] == [False, True, True]
    inside = free.copy()
    inside[50, 50] = LETHAL
    assert not _hit(inside, 5.0, 5.0)
    unknown = free.copy()
    unknown[60, 55] = NO_INFORMATION
    assert _hit(unknown, 5.0, 5.0)
    assert _hit(free, 0.5, 5.0)
    way = np.array([[5.0, 5.0, 0.0], [5.5, 5.0, 0.5], [9.5, 5.0, 0.0], [5.2, 5.0, 0.0]])
    assert first_collision(way, square, Grid(free, 0.1)) == 2
    assert first_collision(way[:2], square, Grid(free, 0.1)) == -1
