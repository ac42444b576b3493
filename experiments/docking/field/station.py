"""Docking station: an outline that stops the robot, a contact switch, and its appearance in a costmap."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from optdock.model.costmap import LETHAL, Costmap

if TYPE_CHECKING:
    from collections.abc import Sequence

    from optdock.geometry.footprint import Footprint
    from optdock.geometry.pose import Pose2

__all__ = ["Station", "deepest", "shown_in_costmap"]

# [m]: half width of the station's face across the dock's axis; the station does not stop a robot that passes next to it
_FACE = 0.3
_SPACING = 0.01  # [m] between outline points that mark cells: five per cell of 5 cm


@dataclass(frozen=True)
class Station:
    """A charging station with sprung contacts.

    Args:
        give: Travel of the contacts until the robot stands [m].
        has_switch: Whether contact is signalled.
        switch_travel: Distance before the docked pose at which the switch closes [m].
        switch_cross: Largest lateral error at which the switch closes [m].
        switch_yaw: Largest heading error at which the switch closes [rad].
    """

    give: float = 0.005
    has_switch: bool = True
    switch_travel: float = 0.003
    switch_cross: float = 0.02
    switch_yaw: float = 0.1

    def touched(self, seen: Pose2, gear: float) -> bool:
        """Return whether a robot at `seen` in the docked frame closes the switch; gear: 1 forward, -1 backward."""
        aligned = abs(seen.y) <= self.switch_cross and abs(seen.yaw) <= self.switch_yaw
        return aligned and gear * seen.x >= -self.switch_travel


def deepest(seen: tuple[float, float, float], corners: Sequence[tuple[float, float]], gear: float) -> float:
    """Return the depth of the foremost corner beyond the station's face [m]; negative before it, -inf next to it.

    Args:
        seen: Robot pose relative to the docked pose [m, m, rad].
        corners: Corners of the outline [m]; the foremost corners of the docked robot touch the face.
        gear: Gear of the last motion, 1 forward, -1 backward.
    """
    x, y, yaw = seen
    c, s = math.cos(yaw), math.sin(yaw)
    face, found = max(gear * u for u, _ in corners), -math.inf
    for u, v in corners:
        if abs(y + s * u + c * v) <= _FACE:
            found = max(found, gear * (x + c * u - s * v) - face)
    return found


def shown_in_costmap(outline: Footprint, station: Pose2, resolution: float, reach: float) -> Costmap:
    """Return a local costmap of a station: every cell that its outline touches is lethal, all others are free.

    Args:
        outline: Outline of the station in the docked robot's frame.
        station: Docked pose at which the costmap shows the station.
        resolution: Side of a cell [m]; cell edges are multiples of it.
        reach: Distance from the station to each side of the costmap [m].
    """
    c, s = math.cos(station.yaw), math.sin(station.yaw)
    corners = outline.vertices @ np.array([[c, s], [-s, c]]) + [station.x, station.y]
    edges = np.roll(corners, -1, axis=0) - corners
    steps = np.linspace(0.0, 1.0, 2 + int(np.max(np.hypot(*edges.T)) / _SPACING))
    points = (corners[:, None] + steps[:, None] * edges[:, None]).reshape(-1, 2)
    first = np.floor((np.array([station.x, station.y]) - reach) / resolution).astype(int)
    side = 2 * math.ceil(reach / resolution)
    columns, rows = (np.floor(points / resolution).astype(int) - first).T
    data = np.zeros((side, side), dtype=np.uint8)
    data[rows, columns] = LETHAL
    origin = first * resolution
    return Costmap(data, resolution, (float(origin[0]), float(origin[1])))
