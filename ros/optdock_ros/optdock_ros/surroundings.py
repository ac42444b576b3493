"""What the costmap and the footprint topics say, and how old it is.

Subscriptions only store what arrives; it is converted, and judged, on demand.
"""

from __future__ import annotations

import threading
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from geometry_msgs.msg import PolygonStamped
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.qos import DurabilityPolicy, QoSProfile

from optdock import ros
from optdock.errors import InvalidValue, OptdockError
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import transform_points
from optdock.model.costs import LETHAL
from optdock.nav2.layers.raster import cells_of_lines

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rclpy.node import Node

    from optdock.geometry.arrays import FloatArray
    from optdock.model.costmap import Costmap
    from optdock.ros import StampedCostmap
    from optdock_ros.frame_lookup import TransformBuffer

__all__ = [
    "CostmapTopic",
    "FootprintTopic",
    "SurroundingsError",
    "first_collision",
    "nav2_footprint",
    "now",
]

# Updates are patched in on demand, or at this number: more would only be kept, and patched at once later.
_MOST_UPDATES = 32
# [m]: an outline that comes back from the map's frame as float32, by an interpolated transform, wanders by micrometres,
# 4 of them 100 m from the origin; it is the same outline. Contact forgives 2 of them, so it is rounded too.
_SAME_OUTLINE = 1e-4
_DIGITS = 4  # after the point: a tenth of a millimetre


class SurroundingsError(OptdockError):
    """A topic has not been heard, says what cannot be, or is too old."""


def now(node: Node) -> float:
    """Seconds on a node's clock, which is the simulation's with `use_sim_time`."""
    return float(node.get_clock().now().nanoseconds) * 1e-9


class CostmapTopic:
    """The newest costmap of a topic, with the updates of parts that came after it.

    Args:
        node: Whose subscription it is.
        topic: Its name. One that ends in `_raw` holds nav2_msgs/Costmap, as `costmap_raw` of Nav2 does; any other
            nav_msgs/OccupancyGrid, as `costmap` and `map`. Updates come on the same name with `_updates`.
    """

    def __init__(self, node: Node, topic: str) -> None:
        self.topic = topic
        self._node = node
        raw = topic.endswith("_raw")
        whole = ros.imported("nav2_msgs/msg/Costmap" if raw else "nav_msgs/msg/OccupancyGrid")
        part = _update_type(raw=raw)
        self._lock = threading.Lock()  # held for list operations only
        self._whole: Any = None
        self._updates: list[Any] = []
        self._known: StampedCostmap | None = None
        self._fault = f"{topic}: no costmap yet"
        self._converting = threading.Lock()
        group = MutuallyExclusiveCallbackGroup()
        kept = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        parts = QoSProfile(depth=_MOST_UPDATES, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._subscriptions = [
            node.create_subscription(whole, topic, self._take_whole, kept, callback_group=group),
        ]
        if part is not None:
            updates = f"{topic}_updates"
            self._subscriptions.append(
                node.create_subscription(part, updates, self._take_part, parts, callback_group=group)
            )
        else:
            node.get_logger().warning(f"{topic}: map_msgs is not installed; only whole grids of it are seen")

    def close(self) -> None:
        """End the subscriptions."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        self._subscriptions = []

    def newest(self) -> StampedCostmap:
        """The costmap as it is known now.

        Raises:
            SurroundingsError: Nothing has come yet, or what came is not a costmap; the message names topic and fault.
        """
        with self._converting:
            with self._lock:
                whole, updates = self._whole, self._updates
                self._whole, self._updates = None, []
            if whole is not None:
                self._known = self._converted(self.topic, partial(ros.costmap, whole))
            if self._known is not None and updates:
                self._known = self._converted(f"{self.topic}_updates", partial(_updated, self._known, updates))
            known, fault = self._known, self._fault
        if known is None:
            raise SurroundingsError(fault, where={"topic": self.topic})
        return known

    def _converted(self, topic: str, convert: Callable[[], StampedCostmap]) -> StampedCostmap | None:
        """A costmap; None, and why is kept, where what came is none or does not fit what is known.

        What was known is then not what there is, until the next whole costmap.
        """
        try:
            return convert()
        except InvalidValue as error:
            self._fault = f"{topic}: {error}"
            return None

    def _take_whole(self, message: Any) -> None:
        with self._lock:
            # What is older than a whole costmap is part of it; later parts may overtake it, and stay.
            self._whole = message

    def _take_part(self, message: Any) -> None:
        with self._lock:
            self._updates.append(message)
            is_many = len(self._updates) >= _MOST_UPDATES
        if is_many:
            try:
                self.newest()
            except SurroundingsError as error:
                self._node.get_logger().error(str(error), throttle_duration_sec=5.0)


class FootprintTopic:
    """The newest outline of the robot from a topic, in the robot's own frame.

    Nav2 publishes the outline where the robot stands, in its costmap's frame; the transform of the same moment takes it
    back.

    Args:
        node: Whose subscription it is.
        topic: Its name; geometry_msgs/PolygonStamped.
        transforms: Where the robot stands.
        base_frame: The robot's own frame.
        tolerance: How much older than the message its transform may be [s].
    """

    def __init__(
        self, node: Node, topic: str, transforms: TransformBuffer, base_frame: str, tolerance: float = 0.0
    ) -> None:
        self.topic = topic
        self._node, self._transforms, self._base, self.tolerance = node, transforms, base_frame, tolerance
        self._newest: PolygonStamped | None = None
        self._known: tuple[Footprint, float] | None = None
        self._converting = threading.Lock()
        group = MutuallyExclusiveCallbackGroup()
        # Nav2 publishes it as any topic; a latched one is taken by this as well, once it moves or is told again.
        self._subscription = node.create_subscription(PolygonStamped, topic, self._take, 1, callback_group=group)

    def close(self) -> None:
        """End the subscription."""
        self._node.destroy_subscription(self._subscription)

    @property
    def is_heard(self) -> bool:
        """Whether anything has come."""
        return self._newest is not None or self._known is not None

    def newest(self) -> tuple[Footprint, float]:
        """The outline in the robot's frame, and its stamp [s].

        It is rounded to a tenth of a millimetre; one that differs from the one before by less is the one before.

        Raises:
            SurroundingsError: Nothing has come yet, or it is not an outline.
            TransformError: Where the robot stood at that moment is not known.
        """
        with self._converting:
            message, self._newest = self._newest, None
            if message is not None:
                try:
                    self._known = self._converted(message)
                except OptdockError:
                    # A transform may come a moment later; a newer message has its own.
                    if self._newest is None:
                        self._newest = message
                    raise
            known = self._known
        if known is None:
            raise SurroundingsError(f"{self.topic}: no footprint yet", where={"topic": self.topic})
        return known

    def _converted(self, message: PolygonStamped) -> tuple[Footprint, float]:
        try:
            frame, stamp = message.header.frame_id.lstrip("/"), ros.seconds(message.header.stamp)
            stood = None
            if frame and frame != self._base.lstrip("/"):
                stood = self._transforms.lookup(frame, self._base, stamp, self.tolerance).planar()
            outline = Footprint(np.round(ros.footprint(message, at=stood).footprint.vertices, _DIGITS))
        except InvalidValue as error:
            raise SurroundingsError(f"{self.topic}: {error}", where={"topic": self.topic}) from error
        known = self._known[0] if self._known is not None else None
        if known is not None and known.vertices.shape == outline.vertices.shape:
            is_same = float(np.abs(known.vertices - outline.vertices).max()) < _SAME_OUTLINE
            outline = known if is_same else outline
        return outline, stamp

    def _take(self, message: PolygonStamped) -> None:
        self._newest = message


def _updated(known: StampedCostmap, updates: Sequence[Any]) -> StampedCostmap:
    """A costmap with the parts that came after it; a part that is older than what is known changes nothing.

    Raises:
        InvalidMessage: A part does not fit.
    """
    newer, newest = [], known.stamp
    for update in updates:
        stamp = ros.seconds(update.header.stamp)
        if stamp >= newest:
            newer.append(update)
            newest = stamp
    return ros.patched(known, *newer)


def _update_type(*, raw: bool) -> type | None:
    """The class of a grid's updates; None where its package is not installed, as may be with map_msgs."""
    try:
        return ros.imported("nav2_msgs/msg/CostmapUpdate" if raw else "map_msgs/msg/OccupancyGridUpdate")
    except ImportError:
        return None


def first_collision(poses: FloatArray, footprint: Footprint, costmap: Costmap) -> int:
    """The first pose whose outline's edges meet a lethal or unknown cell or one off the map, or -1.

    Args:
        poses: Shape (n, 3).
        footprint: The outline.
        costmap: Where to look.
    """
    corners = transform_points(poses, footprint.vertices)
    count = corners.shape[1]
    starts = costmap.cell_of(corners.reshape(-1, 2))
    ends = costmap.cell_of(np.roll(corners, -1, axis=1).reshape(-1, 2))
    on_map = costmap.has_cell(starts).reshape(-1, count).all(axis=1)
    if not on_map.all():
        # Cells are looked up where all corners are on the map; a line between two such is there too.
        inside = np.flatnonzero(on_map)
        first_off = int(np.flatnonzero(~on_map)[0])
        before = first_collision(poses[inside[inside < first_off]], footprint, costmap) if first_off else -1
        return before if before >= 0 else first_off
    cells, owner = cells_of_lines(starts, ends)
    hit = owner[costmap.data[cells[:, 1], cells[:, 0]] >= LETHAL]
    return int(hit.min() // count) if hit.size else -1


def nav2_footprint(footprint: str, robot_radius: float, padding: float) -> Footprint:
    """The outline that Nav2's three parameters mean.

    Args:
        footprint: `"[[x, y], ...]"` [m]; empty or `"[]"`: the robot is round.
        robot_radius: Of a round robot [m].
        padding: How far every vertex is moved outward along x and y [m].

    Raises:
        InvalidValue: They make no outline.
    """
    is_round = footprint.strip() in {"", "[]"}
    outline = Footprint.from_radius(robot_radius) if is_round else Footprint.from_string(footprint)
    return outline.padded(padding) if padding else outline
