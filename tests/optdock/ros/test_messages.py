"""Conversions of messages: values are the same after a round trip, and errors name the field."""

import copy
import math
import tracemalloc
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optdock import ros
from optdock.errors import InvalidMessage, InvalidValue
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2, Twist2, normalize_angle
from optdock.model.costmap import Costmap
from optdock.model.costs import OccupancyRule
from optdock.ros.bag import bag_types as types
from optdock.ros.transforms import TransformError, TransformTree

coordinates = st.floats(-1e4, 1e4)
yaws = st.floats(-math.pi, math.pi)
poses = st.builds(Pose2, coordinates, coordinates, yaws)
twists = st.builds(Twist2, *[st.floats(-5.0, 5.0)] * 3)
times = st.floats(0.0, 2e9)
frames = st.sampled_from(("map", "odom", "robot1/odom"))
laws = settings(max_examples=15)


def same_pose(one, other):
    assert (one.x, one.y) == (other.x, other.y)
    assert abs(normalize_angle(one.yaw - other.yaw)) < 1e-12


@laws
@given(times)
def test_a_time_is_the_same_to_what_a_float_can_tell(time):
    assert ros.seconds(ros.stamp(types, time)) == pytest.approx(time, abs=1e-9, rel=3e-16)


@laws
@given(st.integers(0, 2**31 - 1), st.integers(0, 999_999_999))
def test_a_stamp_is_the_same_to_what_a_float_can_tell(whole, rest):
    again = ros.stamp(types, ros.seconds(SimpleNamespace(sec=whole, nanosec=rest)))
    assert abs((again.sec - whole) * 10**9 + again.nanosec - rest) <= 1 + whole * 10**9 // 2**52


@laws
@given(st.lists(poses, max_size=5), frames, times)
def test_a_path_is_the_same(given_poses, frame, time):
    rows = np.array([pose.as_array() for pose in given_poses]).reshape(-1, 3)
    found = ros.path_poses(ros.path_message(types, rows, frame, time))
    assert found.frame == frame
    assert np.array_equal(found.poses[:, :2], rows[:, :2])
    assert np.allclose(np.exp(1j * found.poses[:, 2]), np.exp(1j * rows[:, 2]), rtol=0.0, atol=1e-12)
    assert not found.poses.flags.writeable


@laws
@given(poses, twists, frames, times)
def test_pose_twist_and_odometry_are_the_same(pose, twist, frame, time):
    one = ros.pose(ros.pose_message(types, pose, frame, time))
    assert one.frame == frame
    same_pose(one.pose, pose)
    both = ros.odometry(ros.odometry_message(types, pose, twist, frame, "base_link", time))
    assert (both.frame, both.child_frame, both.twist) == (frame, "base_link", twist)
    same_pose(both.pose, pose)
    assert ros.twist(ros.twist_message(types, twist, stamped=False)) == ("", None, twist)
    stamped = ros.twist(ros.twist_message(types, twist, "base_link", time, stamped=True))
    assert (stamped.frame, stamped.twist) == ("base_link", twist)


grids = st.builds(
    lambda rows, columns, seed, origin, resolution: Costmap(
        np.random.default_rng(seed).integers(0, 256, (rows, columns)).astype(np.uint8), resolution, origin
    ),
    st.integers(1, 6),
    st.integers(1, 6),
    st.integers(0, 1000),
    st.tuples(coordinates, coordinates),
    st.sampled_from((0.01, 0.025, 0.05, 0.1)),
)


@laws
@given(grids, frames, times)
def test_a_costmap_is_the_same_and_its_resolution_too(grid, frame, time):
    message = ros.costmap_message(types, grid, frame, time)
    # What reaches another node has been through 32 bits.
    message.metadata.resolution = float(np.float32(message.metadata.resolution))
    found = ros.costmap(message)
    assert (found.frame, found.costmap.resolution, found.costmap.origin) == (frame, grid.resolution, grid.origin)
    assert np.array_equal(found.costmap.data, grid.data)


@laws
@given(grids, times)
def test_an_occupancy_grid_blocks_what_the_costmap_blocks(grid, time):
    found = ros.costmap(ros.occupancy_message(types, grid, "map", time)).costmap
    for cost in (253, 254, 255):
        assert np.array_equal(found.data == cost, grid.data == cost)
    assert ros.costmap(ros.occupancy_message(types, found, "map", time)).costmap.data.tolist() == found.data.tolist()


def test_an_occupancy_grid_is_read_by_the_rule_that_is_asked_for():
    message = ros.occupancy_message(types, Costmap(np.array([[0, 200, 254]]), 0.1), "map", 1.0)
    assert message.data.tolist() == [0, 77, 100]
    assert ros.costmap(message).costmap.data.tolist() == [[0, 0, 254]]
    assert ros.costmap(message, OccupancyRule(lethal_cost_threshold=65)).costmap.data.tolist() == [[0, 254, 254]]
    message.data = [0, -1, 99]  # a list, as rclpy takes one
    assert ros.costmap(message).costmap.data.tolist() == [[0, 255, 253]]


def update(kind, x, y, shape, cells, frame="map"):
    head = SimpleNamespace(frame_id=frame, stamp=SimpleNamespace(sec=7, nanosec=0))
    names = ("size_x", "size_y") if kind == "costmap" else ("width", "height")
    return SimpleNamespace(header=head, x=x, y=y, data=cells, **dict(zip(names, shape, strict=True)))


@laws
@given(grids, st.integers(0, 5), st.integers(0, 5), st.integers(1, 6), st.integers(1, 6))
def test_an_update_changes_its_window_and_nothing_else(grid, x, y, wide, high):
    known = ros.StampedCostmap("map", 1.0, grid)
    cells = np.full((high, wide), 254, dtype=np.uint8)
    message = update("costmap", x, y, (wide, high), cells.reshape(-1))
    if x + wide > grid.columns or y + high > grid.rows:
        with pytest.raises(InvalidMessage, match="must lie within"):
            ros.patched(known, message)
        return
    found = ros.patched(known, message)
    expected = grid.data.copy()
    expected[y : y + high, x : x + wide] = 254
    assert found.stamp == 7.0
    assert np.array_equal(found.costmap.data, expected)
    occupied = update("grid", x, y, (wide, high), np.full(wide * high, 100, dtype=np.int8))
    assert np.array_equal(ros.patched(known, occupied).costmap.data, expected)
    again = update("costmap", 0, 0, (1, 1), [7])
    one_by_one, at_once = ros.patched(ros.patched(known, message), again), ros.patched(known, message, again)
    assert np.array_equal(one_by_one.costmap.data, at_once.costmap.data)
    assert ros.patched(known) is known


@laws
@given(poses, st.floats(0.2, 2.0), st.floats(0.2, 2.0))
def test_a_published_outline_is_transformed_into_the_robots_frame(at, length, width):
    outline = Footprint.rectangle(0.6 * length, 0.4 * length, width)
    corners = np.array([(at @ Pose2(x, y, 0.0)).as_array()[:2] for x, y in outline.vertices.tolist()])
    message = ros.polygon_message(types, corners, "odom", 2.0)
    assert np.allclose(ros.footprint(message, at).footprint.vertices, outline.vertices, atol=1e-9)
    assert np.allclose(ros.footprint(message).footprint.vertices, corners)


def broken(message, field, value):
    """The same message with another value in a field."""
    message = copy.deepcopy(message)
    *way, last = field.replace("[", ".").replace("]", "").split(".")
    part = message
    for name in way:
        part = part[int(name)] if name.isdigit() else getattr(part, name)
    if isinstance(part, np.ndarray):
        part[int(last)] = value
    else:
        setattr(part, last, value)
    return message


PATH = ros.path_message(types, np.zeros((3, 3)), "map", 1.0)
for one in PATH.poses:
    one.header = copy.deepcopy(one.header)  # they share one
ODOMETRY = ros.odometry_message(types, Pose2(1.0, 2.0, 3.0), Twist2(), "odom", "base_link", 1.0)
GRID = ros.costmap_message(types, Costmap(np.zeros((2, 3), dtype=np.uint8), 0.1), "map", 1.0)
OCCUPANCY = ros.occupancy_message(types, Costmap(np.zeros((2, 3), dtype=np.uint8), 0.1), "map", 1.0)
POLYGON = ros.polygon_message(types, [(0, 0), (1, 0), (0, 1)], "odom", 1.0)
TWIST = ros.twist_message(types, Twist2(1.0), "base_link", 1.0, stamped=True)
NAN, INF = math.nan, math.inf

WRONG = [
    (ros.path_poses, PATH, "poses[1].pose.position.x", NAN, "must be finite, got nan"),
    (ros.path_poses, PATH, "poses[2].pose.position.z", INF, "must be finite, got inf"),
    (ros.path_poses, PATH, "poses[1].pose.orientation.w", NAN, "must be finite, got nan"),
    (ros.path_poses, PATH, "poses[1].pose.orientation.w", 0.0, "must be of length 1 within 0.01, got 0 for (0, 0, 0"),
    (ros.path_poses, PATH, "poses[1].pose.orientation.x", 0.1, "must rotate about the vertical axis only"),
    (ros.path_poses, PATH, "poses[1].header.frame_id", "odom", "must be the path's, 'map', got 'odom'"),
    (ros.path_poses, PATH, "header.frame_id", "", "must be the name of a coordinate frame, got ''"),
    (ros.path_poses, PATH, "header.stamp.nanosec", 2 * 10**9, "must be in 0..999999999, got 2000000000"),
    (ros.path_poses, PATH, "header.stamp.sec", -1, "must be >= 0, got -1"),
    (ros.odometry, ODOMETRY, "pose.pose.orientation.z", 3.0, "must be of length 1"),
    (ros.odometry, ODOMETRY, "pose.pose.position.y", NAN, "must be finite"),
    (ros.odometry, ODOMETRY, "twist.twist.linear.x", NAN, "must be finite"),
    (ros.odometry, ODOMETRY, "twist.twist.angular.y", INF, "must be finite"),
    (ros.twist, TWIST, "twist.linear.y", NAN, "must be finite"),
    (ros.costmap, GRID, "metadata.size_x", 4, "must have 4 x 2 cells"),
    (ros.costmap, GRID, "metadata.resolution", 0.0, "must be finite and > 0 m"),
    (ros.costmap, GRID, "metadata.origin.position.x", NAN, "must be finite"),
    (ros.costmap, GRID, "metadata.origin.orientation.z", 0.1, "must not be turned"),
    (ros.costmap, OCCUPANCY, "info.height", 0, "and at least one"),
    (ros.costmap, OCCUPANCY, "data[4]", 101, "must be -1 (unknown) or 0..100, got 101"),
    (ros.costmap, OCCUPANCY, "data[5]", -2, "must be -1 (unknown) or 0..100, got -2"),
    (ros.footprint, POLYGON, "polygon.points[1].y", NAN, "must be finite"),
    (ros.footprint, POLYGON, "polygon.points[1].x", 0.0, "must be a simple polygon"),
]


@pytest.mark.parametrize(("read", "message", "field", "value", "rule"), WRONG)
def test_errors_name_message_field_and_value(read, message, field, value, rule):
    read(message)
    with pytest.raises(InvalidMessage) as caught:
        read(broken(message, field, value))
    said, parts = str(caught.value), field.split(".")
    assert rule in said
    assert said.startswith(f"{message.__msgtype__}: {parts[0].partition('[')[0]}") or "must have" in said
    assert caught.value.where["message"] == message.__msgtype__
    assert caught.value.where["field"] in said


def test_a_tilted_pose_is_refused():
    leaning = ros.pose_message(types, Pose2(0.0, 0.0, 0.0), "camera", 1.0)
    leaning.pose.orientation.x, leaning.pose.orientation.w = math.sin(0.2), math.cos(0.2)
    with pytest.raises(InvalidMessage, match=r"tilted by at most 0\.1 rad, got 0\.4 rad"):
        ros.pose(leaning)


def test_other_messages_are_no_grids():
    with pytest.raises(InvalidMessage, match="Odometry: type: must be nav2_msgs/msg/Costmap or nav_msgs"):
        ros.costmap(ODOMETRY)


def test_an_update_of_another_frame_is_refused():
    known = ros.StampedCostmap("map", 1.0, Costmap(np.zeros((2, 2), dtype=np.uint8), 0.1))
    with pytest.raises(InvalidMessage, match=r"header\.frame_id: must be the costmap's, 'map', got 'odom'"):
        ros.patched(known, update("costmap", 0, 0, (1, 1), [0], frame="odom"))


@pytest.mark.parametrize(
    ("write", "rule"),
    [
        (lambda: ros.path_message(types, [(0.0, NAN, 0.0)], "map", 1.0), "poses: must be finite"),
        (lambda: ros.path_message(types, [(0.0, 0.0)], "map", 1.0), r"poses: must have shape \(n, 3\)"),
        (lambda: ros.pose_message(types, Pose2(0, 0, 0), "", 1.0), "frame: must be the name"),
        (lambda: ros.pose_message(types, Pose2(0, 0, 0), "map", -1.0), "stamp: must be >= 0 s"),
        (lambda: ros.pose_message(types, Pose2(0, 0, 0), "map", NAN), "stamp: must be finite"),
        (lambda: ros.stamp(types, 2.0**31), "stamp: must be >= 0 s and < 2147483648 s"),
        (lambda: ros.odometry_message(types, Pose2(0, 0, 0), Twist2(), "odom", "", 1.0), "child_frame: must be"),
        (lambda: ros.diagnostics_message(types, "a", "fine", "", {}, 1.0), "level: must be one of ok, warn"),
    ],
)
def test_invalid_values_are_not_written(write, rule):
    with pytest.raises(InvalidValue, match=rule):
        write()


def test_diagnostics_say_level_text_and_values():
    status = ros.diagnostics_message(types, "certificate", "warn", "close", {"clearance": 1 / 3, "at": "dock"}, 2.5)
    (found,) = status.status
    assert (found.level, found.name, found.message, found.hardware_id) == (1, "certificate", "close", "optdock")
    assert [(pair.key, pair.value) for pair in found.values] == [("clearance", "0.333333"), ("at", "dock")]


def test_recorded_transforms_are_joined_and_interpolated():
    tree = TransformTree(reach=0.2)
    for time, x in ((1.0, 0.0), (2.0, 1.0)):
        (moving,) = ros.transforms_message(types, [("odom", "base_link", Pose2(x, 0.0, 3.1 * x))], time).transforms
        assert tree.insert(moving)
    (fixed,) = ros.transforms_message(types, [("map", "odom", Pose2(10.0, 0.0, math.pi / 2))], 1.0).transforms
    assert tree.insert(fixed, is_static=True)
    at = tree.lookup("map", "base_link", 1.5).planar()
    assert (at.x, at.y, at.yaw) == pytest.approx((10.0, 0.5, math.pi / 2 + 1.55))
    back = tree.lookup("base_link", "map", 1.5).planar() @ at
    assert (back.x, back.y, back.yaw) == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)
    for beyond in (0.85, 2.15):
        assert tree.lookup("odom", "base_link", beyond).planar().x == round(beyond - 1.0)
    with pytest.raises(TransformError, match=r"requested 3\.000 s, but the newest of base_link is 1\.000 s older"):
        tree.lookup("map", "base_link", 3.0)
    with pytest.raises(TransformError, match=r"requested 0\.500 s, but the oldest known is 0\.500 s newer"):
        tree.lookup("map", "base_link", 0.5)
    assert not tree.put("base_link", "camera", 1.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0))
    known = r"map <- odom \(static\), odom <- base_link \(until 2\.000 s\); refused: base_link <- camera \(its quat"
    with pytest.raises(TransformError, match=f"map <- camera: there is no transform of 'camera'; known: {known}"):
        tree.lookup("map", "camera", 1.5)


def test_a_stored_transform_takes_64_bytes():
    tree, count = TransformTree(), 4_000
    tracemalloc.start()
    for n in range(count):
        tree.put("odom", "base_link", 0.01 * n, (1e-3 * n, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    size, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert size / count < 80
    assert tree.lookup("odom", "base_link", 0.5).translation[0] == pytest.approx(0.05)
