"""`TransformBuffer` in a node of this process, compared with products of matrices and poses."""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING

import numpy as np
import pytest
from geometry_msgs.msg import TransformStamped
from hall import Surroundings
from harness import spinning
from optdock_ros.frame_lookup import TransformBuffer
from rclpy.node import Node

from optdock import ros
from optdock.geometry.pose import Pose2
from optdock.ros.transforms import Transform, TransformError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from harness import Client

BEGAN = 1_700_000_000.0  # [s]; a time long ago: nothing here depends on the clock


@pytest.fixture(scope="module")
def node(context: None) -> Iterator[Node]:  # noqa: ARG001 - a node needs it
    """A node that spins."""
    made = Node("transforms")
    with spinning(made):
        yield made


@pytest.fixture
def buffer(node: Node) -> Iterator[TransformBuffer]:
    """A new buffer."""
    made = TransformBuffer(node)
    yield made
    made.close()


def told(
    parent: str,
    child: str,
    place: tuple[float, float, float] = (0.0, 0.0, 0.0),
    turn: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0),
    stamp: float = BEGAN,
) -> TransformStamped:
    """Return a message; `turn` is x, y, z, w."""
    message = TransformStamped(child_frame_id=child)
    message.header.frame_id, message.header.stamp = parent, ros.stamp(ros.imported, stamp)
    at, q = message.transform.translation, message.transform.rotation
    at.x, at.y, at.z = place
    q.x, q.y, q.z, q.w = turn
    return message


def about_z(yaw: float) -> tuple[float, float, float, float]:
    """Return a rotation about the vertical axis."""
    return 0.0, 0.0, math.sin(yaw / 2.0), math.cos(yaw / 2.0)


def random_turn(random: np.random.Generator) -> tuple[float, float, float, float]:
    """Return a random rotation."""
    x, y, z, w = random.normal(size=4).tolist()
    norm = math.sqrt(x * x + y * y + z * z + w * w)
    return x / norm, y / norm, z / norm, w / norm


def matrix(transform: Transform) -> np.ndarray:
    """Return a transform as a matrix, shape (4, 4)."""
    x, y, z, w = transform.rotation
    found = np.eye(4)
    found[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    found[:3, 3] = transform.translation
    return found


def test_chains_are_products_of_matrices(buffer: TransformBuffer) -> None:
    """A tree with two branches, in three dimensions, in both directions."""
    random = np.random.default_rng(1)
    edges = {"odom": "map", "base": "odom", "camera": "base", "dock": "map", "marker": "dock"}
    for child, parent in edges.items():
        place = tuple(random.normal(size=3).tolist())
        assert buffer.insert(told(parent, child, place, random_turn(random)), is_static=child == "camera")
    step = {child: matrix(buffer.lookup(parent, child)) for child, parent in edges.items()}
    camera = step["odom"] @ step["base"] @ step["camera"]
    marker = step["dock"] @ step["marker"]
    found = matrix(buffer.lookup("camera", "marker"))
    assert np.abs(found - np.linalg.inv(camera) @ marker).max() < 1e-12
    assert np.abs(matrix(buffer.lookup("marker", "camera")) @ found - np.eye(4)).max() < 1e-12
    assert np.abs(matrix(buffer.lookup("marker", "camera").inverse()) - found).max() < 1e-12
    product = buffer.lookup("camera", "map") @ buffer.lookup("map", "marker")
    assert np.abs(matrix(product) - found).max() < 1e-12


def test_planar_transforms_are_poses(buffer: TransformBuffer) -> None:
    first, second = Pose2(1.0, 2.0, 2.8), Pose2(-0.5, 0.25, 1.1)
    buffer.insert(told("map", "odom", (first.x, first.y, 0.0), about_z(first.yaw)))
    buffer.insert(told("odom", "base", (second.x, second.y, 0.3), about_z(second.yaw)))
    assert buffer.lookup("map", "base").planar().gap_to(first @ second) < 1e-12
    assert buffer.lookup("/map", "/base").planar().gap_to(first @ second) < 1e-12


def test_rotations_are_interpolated_the_short_way(buffer: TransformBuffer) -> None:
    buffer.insert(told("odom", "base", (0.0, 0.0, 0.0), about_z(3.0), BEGAN))
    x, y, z, w = about_z(-3.0)
    # The same rotation by the other sign of its quaternion.
    buffer.insert(told("odom", "base", (1.0, 2.0, 0.0), (-x, -y, -z, -w), BEGAN + 1.0))
    found = buffer.lookup("odom", "base", BEGAN + 0.25)
    across = math.pi - 3.0
    assert found.stamp == BEGAN + 0.25
    assert found.planar().gap_to(Pose2(0.25, 0.5, 3.0 + 0.5 * across)) < 1e-9


def test_the_newest_common_time(buffer: TransformBuffer) -> None:
    """Future stamps of a localization do not extrapolate the pose of the robot."""
    for n in range(11):
        buffer.insert(told("odom", "base", (0.1 * n, 0.0, 0.0), stamp=BEGAN + 0.1 * n))
    buffer.insert(told("map", "odom", stamp=BEGAN))
    buffer.insert(told("map", "odom", (2.0, 0.0, 0.0), stamp=BEGAN + 2.0))
    found = buffer.lookup("map", "base")
    assert found.stamp == pytest.approx(BEGAN + 1.0)
    assert found.translation[0] == pytest.approx(2.0)


def test_nothing_is_extrapolated_beyond_the_tolerance(buffer: TransformBuffer) -> None:
    for n in range(3):
        buffer.insert(told("odom", "base", (0.1 * n, 0.0, 0.0), stamp=BEGAN + 0.1 * n))
    held = buffer.lookup("odom", "base", BEGAN + 0.45, tolerance=0.3)
    assert (held.stamp, held.translation[0]) == (BEGAN + 0.2, 0.2)
    with pytest.raises(TransformError, match=r"the newest of base is 0\.\d+ s older, more than 0\.2 s"):
        buffer.lookup("odom", "base", BEGAN + 0.45, tolerance=0.2)
    with pytest.raises(TransformError, match=r"the oldest known is 1\.000 s newer"):
        buffer.lookup("odom", "base", BEGAN - 1.0, tolerance=5.0)


def test_history_is_ten_seconds_in_any_order_of_messages(buffer: TransformBuffer) -> None:
    order = np.random.default_rng(2).permutation(200)
    for n in order.tolist():
        buffer.insert(told("odom", "base", (0.1 * n, 0.0, 0.0), stamp=BEGAN + 0.1 * n))
    for n in (100, 150, 199):
        assert buffer.lookup("odom", "base", BEGAN + 0.1 * n).translation[0] == pytest.approx(0.1 * n)
    with pytest.raises(TransformError):
        buffer.lookup("odom", "base", BEGAN + 0.1 * 98)


def test_unknown_frames_are_named(buffer: TransformBuffer) -> None:
    buffer.insert(told("map", "odom"), is_static=True)
    buffer.insert(told("world", "camera"))
    with pytest.raises(
        TransformError, match=r"no transform of 'base'; known: map <- odom \(static\), world <- camera \(.* s old"
    ):
        buffer.lookup("map", "base")
    with pytest.raises(TransformError, match="they are not connected"):
        buffer.lookup("map", "camera")


@pytest.mark.parametrize(
    "message",
    [
        told("map", "odom", (math.nan, 0.0, 0.0)),
        told("map", "odom", turn=(0.0, 0.0, 0.0, 0.0)),
        told("map", "odom", turn=(0.0, 0.0, 0.5, 1.0)),
        told("map", "map"),
        told("", "odom"),
        told("map", "odom", stamp=time.time() + 3600.0),
    ],
)
def test_invalid_transforms_are_not_stored(buffer: TransformBuffer, message: TransformStamped) -> None:
    assert not buffer.insert(message)
    assert not buffer.frames


def test_cycles_of_frames_are_rejected(buffer: TransformBuffer) -> None:
    assert buffer.insert(told("a", "b"))
    assert buffer.insert(told("b", "c"))
    assert not buffer.insert(told("c", "a"))
    assert buffer.lookup("a", "c").planar() == Pose2(0.0, 0.0, 0.0)


def test_tilted_frame_is_not_planar(buffer: TransformBuffer) -> None:
    buffer.insert(told("base", "camera", turn=(-0.5, 0.5, -0.5, 0.5)), is_static=True)
    with pytest.raises(TransformError, match=r"base <- camera: is tilted by 1\.571 rad"):
        buffer.lookup("base", "camera").planar()


def test_frame_can_change_its_parent(buffer: TransformBuffer) -> None:
    buffer.insert(told("odom", "box", (1.0, 0.0, 0.0)))
    buffer.insert(told("gripper", "box", (2.0, 0.0, 0.0), stamp=BEGAN + 1.0))
    assert buffer.frames == {"box": "gripper"}


def test_topics_and_latched_static_transforms(node: Node, client_node: Client) -> None:
    world = Surroundings(client_node)
    world.transform("base", "camera", Pose2(0.3, 0.0, 0.0), static=True)
    late = TransformBuffer(node)
    try:
        client_node.until(lambda: "camera" in late.frames, what="the static transform")
        client_node.until(lambda: world.transform("odom", "base", Pose2(1.0, 0.0, 0.0)) or "base" in late.frames)
        found = late.lookup("odom", "camera")
        assert found.planar().gap_to(Pose2(1.3, 0.0, 0.0)) < 1e-12
        assert abs(world.now() - found.stamp) < 5.0
        assert abs(world.now() - late.lookup("base", "camera").stamp) < 5.0
        late.forget()
        assert late.frames == {"camera": "base"}
    finally:
        late.close()


def test_storing_and_looking_up_take_microseconds(buffer: TransformBuffer) -> None:
    """1,000 insertions and lookups take less than a second."""
    began = time.perf_counter()
    for n in range(1000):
        buffer.insert(told("odom", "base", stamp=BEGAN + 0.01 * n))
    for _ in range(1000):
        buffer.lookup("odom", "base")
    assert time.perf_counter() - began < 1.0
