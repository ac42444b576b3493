"""The costmap and footprint topics.

Subscriptions only store messages; they are converted and validated on demand.
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
]

_MOST_UPDATES = 32  # stored at most; then they are applied
# [m]: an outline transformed back from the map's frame as float32 varies by micrometres, 4 of them at 100 m from the
# origin, more than the 2 that a contact tolerates. So it is rounded, and smaller changes are ignored.
_SAME_OUTLINE = 1e-4
_DIGITS = 4  # decimals: a tenth of a millimetre


class SurroundingsError(OptdockError):
    """A topic has no message, or an invalid or old one."""


class CostmapTopic:
    """The newest costmap of a topic, with its later updates.

    A topic whose name ends in `_raw` has nav2_msgs/Costmap, any other nav_msgs/OccupancyGrid.
    """

    def __init__(self, node: Node, topic: str) -> None:
        self.topic, self._node = topic, node
        is_raw = topic.endswith("_raw")
        self._lock = threading.Lock()  # held for list operations only
        self._whole: Any = None
        self._updates: list[Any] = []
        self._known: StampedCostmap | None = None
        self._fault = f"{topic}: no costmap yet"
        self._converting = threading.Lock()
        subscribe = partial(node.create_subscription, callback_group=MutuallyExclusiveCallbackGroup())
        latched = partial(QoSProfile, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        whole = ros.imported("nav2_msgs/msg/Costmap" if is_raw else "nav_msgs/msg/OccupancyGrid")
        self._subscriptions = [subscribe(whole, topic, self._take_whole, latched(depth=1))]
        try:
            part = ros.imported("nav2_msgs/msg/CostmapUpdate" if is_raw else "map_msgs/msg/OccupancyGridUpdate")
        except ImportError:
            node.get_logger().warning(f"{topic}: map_msgs is not installed; its updates are not received")
        else:
            parts = latched(depth=_MOST_UPDATES)
            self._subscriptions.append(subscribe(part, f"{topic}_updates", self._take_part, parts))

    def close(self) -> None:
        """Destroy the subscriptions."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        self._subscriptions = []

    def newest(self) -> StampedCostmap:
        """Return the costmap with all updates; raise `SurroundingsError` if there is no valid message."""
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
        """Return a costmap; None, until the next whole costmap, for an invalid message."""
        try:
            return convert()
        except InvalidValue as error:
            self._fault = f"{topic}: {error}"
            return None

    def _take_whole(self, message: Any) -> None:
        with self._lock:  # keep the updates: newer ones may arrive before their costmap
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
    """The newest outline of a topic, in the robot's frame.

    Nav2 publishes the outline in the frame of its costmap; the transform of the same time transforms it back. For the
    first outline the transform may be older than the message by `tolerance` [s]. Later ones require the exact time,
    because an older transform displaces the outline of a moving robot; until it arrives, the previous outline is used.
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
        self._subscription = node.create_subscription(PolygonStamped, topic, self._take, 1, callback_group=group)

    def close(self) -> None:
        """Destroy the subscription."""
        self._node.destroy_subscription(self._subscription)

    @property
    def is_heard(self) -> bool:
        """Whether a message has been received."""
        return self._newest is not None or self._known is not None

    def newest(self) -> tuple[Footprint, float]:
        """Return the outline in the robot's frame and its stamp [s].

        The outline is rounded to a tenth of a millimetre; smaller changes return the previous outline.

        Raises:
            SurroundingsError: If there is no message, or an invalid one.
            TransformError: If there is no transform at the time of the first message.
        """
        with self._converting:
            message, self._newest = self._newest, None
            if message is not None:
                try:
                    self._known = self._converted(message)
                except OptdockError as error:
                    if self._newest is None:  # try again: its transform may come later
                        self._newest = message
                    if self._known is None or not isinstance(error, ros.TransformError):
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
                tolerance = self.tolerance if self._known is None else 0.0
                stood = self._transforms.lookup(frame, self._base, stamp, tolerance).planar()
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
    """Apply the updates that are not older than the costmap or than previous updates."""
    newer, newest = [], known.stamp
    for update in updates:
        stamp = ros.seconds(update.header.stamp)
        if stamp >= newest:
            newer.append(update)
            newest = stamp
    return ros.patched(known, *newer)


def first_collision(poses: FloatArray, footprint: Footprint, costmap: Costmap) -> int:
    """Return the first of the poses, shape (n, 3), at which the outline meets a lethal or unknown cell, or -1.

    Only the edges of the outline are checked, as in Nav2; cells off the map are unknown.
    """
    corners = transform_points(poses, footprint.vertices)
    count = corners.shape[1]
    starts = costmap.cell_of(corners.reshape(-1, 2))
    ends = costmap.cell_of(np.roll(corners, -1, axis=1).reshape(-1, 2))
    on_map = costmap.has_cell(starts).reshape(-1, count).all(axis=1)
    if not on_map.all():  # check the poses before the first one off the map
        first_off = int(np.flatnonzero(~on_map)[0])
        before = first_collision(poses[:first_off], footprint, costmap) if first_off else -1
        return before if before >= 0 else first_off
    cells, owner = cells_of_lines(starts, ends)
    hit = owner[costmap.data[cells[:, 1], cells[:, 0]] >= LETHAL]
    return int(hit.min() // count) if hit.size else -1


def nav2_footprint(footprint: str, robot_radius: float, padding: float) -> Footprint:
    """Return the outline of Nav2's three parameters, the last two in metres; an empty footprint means a round robot.

    Raises:
        InvalidValue: If the parameters are invalid.
    """
    is_round = footprint.strip() in {"", "[]"}
    outline = Footprint.from_radius(robot_radius) if is_round else Footprint.from_string(footprint)
    return outline.padded(padding) if padding else outline
