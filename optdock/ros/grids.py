"""Messages of costmaps and occupancy grids, and their updates."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.pose import Pose2
from optdock.model.costmap import Costmap
from optdock.model.costs import OccupancyRule
from optdock.ros import messages
from optdock.ros.messages import column, header, made, refuse, stamped_frame
from optdock.ros.motion import plain_pose, plain_pose_message

if TYPE_CHECKING:
    from optdock.model.costs import CostArray
    from optdock.ros.messages import Message, MessageTypes

__all__ = ["StampedCostmap", "costmap", "costmap_message", "occupancy_message", "patched"]

_TURNED = 1e-6  # [rad]: a millimetre over a map of a kilometre, far less than a cell
_UNKNOWN, _OCCUPIED = -1, 100


class StampedCostmap(NamedTuple):
    """A costmap, its frame and its stamp [s]."""

    frame: str
    stamp: float
    costmap: Costmap


def costmap(message: Message, rule: OccupancyRule | None = None) -> StampedCostmap:
    """Return the costmap of a `nav2_msgs/Costmap` or a `nav_msgs/OccupancyGrid`.

    The resolution is the shortest decimal number with the same 32-bit value, such as 0.05 m instead of
    0.05000000074505806 m.

    Args:
        message: The message.
        rule: Conversion of occupancies to costs; None for the defaults, by which 100 is lethal and 99 inscribed.

    Raises:
        InvalidMessage: If the number of cells is not width times height, an occupancy is outside -1..100, the map is
            rotated, a number is not finite, there is no frame, or the message is of the wrong type.
    """
    frame, time = stamped_frame(message)
    is_costmap = hasattr(message, "metadata")
    if not (is_costmap or hasattr(message, "info")):
        refuse(message, "type", "must be nav2_msgs/msg/Costmap or nav_msgs/msg/OccupancyGrid", "neither")
    meta = message.metadata if is_costmap else message.info
    field, wide, high = ("metadata", "size_x", "size_y") if is_costmap else ("info", "width", "height")
    columns, rows = int(getattr(meta, wide)), int(getattr(meta, high))
    costs = _costs_of(message, columns, rows, None if is_costmap else rule or OccupancyRule())
    corner = plain_pose(message, meta.origin, f"{field}.origin", _TURNED)
    if abs(corner.yaw) > _TURNED:
        refuse(message, f"{field}.origin.orientation", "must not be turned: rows go along x", f"{corner.yaw:.6g} rad")
    resolution = float(str(np.float32(meta.resolution)))
    if not (math.isfinite(resolution) and resolution > 0.0):
        refuse(message, f"{field}.resolution", "must be finite and > 0 m", meta.resolution)
    return StampedCostmap(frame, time, Costmap(costs, resolution, (corner.x, corner.y)))


def patched(known: StampedCostmap, *updates: Message, rule: OccupancyRule | None = None) -> StampedCostmap:
    """Return a costmap with `nav2_msgs/CostmapUpdate` or `map_msgs/OccupancyGridUpdate` messages applied.

    Args:
        known: Costmap of the last complete message.
        *updates: Updates in order; the costmap receives the stamp of the last update.
        rule: As for `costmap`.

    Raises:
        InvalidMessage: If an update is in a different frame, reaches beyond the costmap, has a wrong number of cells,
            or contains an occupancy outside -1..100.
    """
    frame, stamp, grid = known
    data = grid.data.copy() if updates else grid.data
    for update in updates:
        frame, stamp = stamped_frame(update)
        if frame != known.frame:
            refuse(update, "header.frame_id", f"must be the costmap's, {known.frame!r}", repr(frame))
        is_costmap = hasattr(update, "size_x")
        wide, high = ("size_x", "size_y") if is_costmap else ("width", "height")
        columns, rows = int(getattr(update, wide)), int(getattr(update, high))
        x, y = int(update.x), int(update.y)
        if not (0 <= x <= x + columns <= grid.columns and 0 <= y <= y + rows <= grid.rows):
            rule_text = f"must lie within the {grid.columns} x {grid.rows} cells of the costmap"
            refuse(update, wide, rule_text, f"{columns} x {rows} from ({x}, {y})")
        costs = _costs_of(update, columns, rows, None if is_costmap else rule or OccupancyRule())
        data[y : y + rows, x : x + columns] = costs
    return StampedCostmap(frame, stamp, grid.with_data(data)) if updates else known


def costmap_message(types: MessageTypes, costmap: Costmap, frame: str, stamp: float) -> Message:
    """Return a `nav2_msgs/Costmap`.

    Raises:
        InvalidValue: If the frame or the time is invalid.
    """
    name = "nav2_msgs/msg/Costmap"
    metadata = made(
        types,
        "nav2_msgs/msg/CostmapMetaData",
        map_load_time=messages.stamp(types, stamp),
        update_time=messages.stamp(types, stamp),
        layer="master",
        resolution=costmap.resolution,
        size_x=costmap.columns,
        size_y=costmap.rows,
        origin=_origin(types, costmap),
    )
    data = column(types, name, costmap.data)
    return made(types, name, header=header(types, frame, stamp), metadata=metadata, data=data)


def occupancy_message(types: MessageTypes, costmap: Costmap, frame: str, stamp: float) -> Message:
    """Return a `nav_msgs/OccupancyGrid` with the occupancies that Nav2 publishes for costs.

    Raises:
        InvalidValue: If the frame or the time is invalid.
    """
    name = "nav_msgs/msg/OccupancyGrid"
    info = made(
        types,
        "nav_msgs/msg/MapMetaData",
        map_load_time=messages.stamp(types, stamp),
        resolution=costmap.resolution,
        width=costmap.columns,
        height=costmap.rows,
        origin=_origin(types, costmap),
    )
    data = column(types, name, costmap.occupancy())
    return made(types, name, header=header(types, frame, stamp), info=info, data=data)


def _origin(types: MessageTypes, grid: Costmap) -> Message:
    return plain_pose_message(types, Pose2(*grid.origin, 0.0))


def _costs_of(message: Message, columns: int, rows: int, rule: OccupancyRule | None) -> CostArray:
    """Return the costs of a message, Shape (rows, columns); a rule converts cells that contain occupancies."""
    given = message.data
    if isinstance(given, list | tuple):  # rclpy's fields also accept lists
        given = bytes(value % 256 for value in given)
    cells = np.frombuffer(given, dtype=np.uint8)
    if cells.size != columns * rows or cells.size == 0:
        refuse(message, "data", f"must have {columns} x {rows} cells, and at least one", cells.size)
    if rule is None:
        return cells.reshape(rows, columns)
    signed = cells.view(np.int8)
    if signed.min() < _UNKNOWN or signed.max() > _OCCUPIED:
        row = int(np.flatnonzero((signed < _UNKNOWN) | (signed > _OCCUPIED))[0])
        refuse(message, f"data[{row}]", "must be -1 (unknown) or 0..100", int(signed[row]))
    # Lookup table of all bytes, with -1 as the last, for grids of millions of cells.
    table, known = np.zeros(256, dtype=np.uint8), rule.table()
    table[: _OCCUPIED + 1], table[_UNKNOWN] = known[:-1], known[-1]
    costs: CostArray = np.take(table, cells).reshape(rows, columns)
    return costs
