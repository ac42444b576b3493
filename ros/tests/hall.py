"""A hall of 20 m x 20 m with 20 boxes, a robot, a raw path between the boxes, and their publishers."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from geometry_msgs.msg import Point32, PolygonStamped, TransformStamped
from nav2_msgs.msg import Costmap, CostmapUpdate
from rclpy.qos import DurabilityPolicy, QoSProfile
from tf2_msgs.msg import TFMessage

from optdock import ros
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2, transform_points
from optdock.model.costmap import Costmap as Grid
from optdock.model.costs import LETHAL

if TYPE_CHECKING:
    from rclpy.node import Node

    from optdock.geometry.arrays import FloatArray

CELLS, RESOLUTION = 400, 0.05
ORIGIN = (-10.0, -10.0)
OUTLINE = Footprint.rectangle(0.35, 0.25, 0.5)
COSTMAP, FOOTPRINT = "global_costmap/costmap_raw", "global_costmap/published_footprint"


def hall() -> Grid:
    """Return a hall with two rows of boxes, which form a winding lane 2.4 m wide."""
    data = np.zeros((CELLS, CELLS), dtype=np.uint8)
    grid = Grid(data, RESOLUTION, ORIGIN)
    for n in range(10):
        x = -5.0 + 1.1 * n
        for side in (-1.0, 1.0):
            y = 0.5 * math.sin(0.6 * x) + side * 1.45
            (i, j), (k, m) = grid.cell_of([[x - 0.25, y - 0.25], [x + 0.25, y + 0.25]]).tolist()
            data[j : m + 1, i : k + 1] = LETHAL
    return Grid(data, RESOLUTION, ORIGIN)


def raw_path(count: int = 200, length: float = 10.0) -> FloatArray:
    """Return poses along the lane with the zigzag of a grid, shape (count, 3)."""
    x = np.linspace(-5.0, -5.0 + length, count)
    y = 0.5 * np.sin(0.6 * x) + 0.02 * np.where(np.arange(count) % 8 < 4, 1.0, -1.0)
    yaw = np.arctan2(np.gradient(y), np.gradient(x))
    y[[0, -1]] = 0.5 * np.sin(0.6 * x[[0, -1]])
    yaw[[0, -1]] = np.arctan(0.3 * np.cos(0.6 * x[[0, -1]]))
    return np.column_stack((x, y, yaw))


def message(poses: FloatArray, frame: str = "map", stamp: float = 1.0) -> Any:
    """Return a nav_msgs/Path."""
    return ros.path_message(ros.imported, poses, frame, stamp)


class Surroundings:
    """Publishes costmap, outline and transforms, as Nav2's global costmap and a localization do.

    Args:
        node: Whose publishers they are.
    """

    def __init__(self, node: Node) -> None:
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._node = node
        self._costmap = node.create_publisher(Costmap, COSTMAP, latched)
        self._updates = node.create_publisher(CostmapUpdate, f"{COSTMAP}_updates", latched)
        self._footprint = node.create_publisher(PolygonStamped, FOOTPRINT, 10)
        self._tf = node.create_publisher(TFMessage, "/tf", 100)
        self._static = node.create_publisher(TFMessage, "/tf_static", latched)

    def now(self) -> float:
        """Return the time of the node's clock [s]."""
        return self._node.get_clock().now().nanoseconds * 1e-9

    def costmap(self, grid: Grid | None = None, frame: str = "map", age: float = 0.0) -> None:
        """Publish a costmap."""
        known = hall() if grid is None else grid
        self._costmap.publish(ros.costmap_message(ros.imported, known, frame, self.now() - age))

    def update(self, x: int, y: int, costs: FloatArray, frame: str = "map") -> None:
        """Publish an update of the costmap."""
        part = CostmapUpdate(x=x, y=y, size_x=costs.shape[1], size_y=costs.shape[0])
        part.header.frame_id, part.header.stamp = frame, ros.stamp(ros.imported, self.now())
        part.data = costs.astype(np.uint8).reshape(-1).tolist()
        self._updates.publish(part)

    def footprint(self, at: Pose2 | None = None, frame: str = "base_link", outline: Footprint = OUTLINE) -> None:
        """Publish the outline at the robot's pose."""
        corners = outline.vertices if at is None else transform_points(at.as_array()[None], outline.vertices)[0]
        polygon = PolygonStamped()
        polygon.header.frame_id, polygon.header.stamp = frame, ros.stamp(ros.imported, self.now())
        polygon.polygon.points = [Point32(x=float(x), y=float(y), z=0.0) for x, y in corners]
        self._footprint.publish(polygon)

    def transform(self, parent: str, child: str, pose: Pose2, *, static: bool = False, age: float = 0.0) -> None:
        """Publish a transform."""
        stamped = TransformStamped(child_frame_id=child)
        stamped.header.frame_id, stamped.header.stamp = parent, ros.stamp(ros.imported, self.now() - age)
        stamped.transform.translation.x, stamped.transform.translation.y = pose.x, pose.y
        stamped.transform.rotation.z, stamped.transform.rotation.w = math.sin(pose.yaw / 2), math.cos(pose.yaw / 2)
        (self._static if static else self._tf).publish(TFMessage(transforms=[stamped]))
