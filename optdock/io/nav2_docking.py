"""Dock types of a Nav2 parameter file: where the approach begins and which end of the robot goes first."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from optdock.dock import DockDirection
from optdock.geometry.pose import Pose2
from optdock.io.nav2_numbers import NumberReader
from optdock.parameters import closest

if TYPE_CHECKING:
    from collections.abc import Mapping

    from optdock.io.yaml_lines import Document, Keys

__all__ = ["DockType", "read_dock_type"]

_DIRECTIONS = (DockDirection.FORWARD.value, DockDirection.BACKWARD.value)


@dataclass(frozen=True)
class DockType:
    """A dock plugin instance; names and defaults are those of opennav_docking's simple docks.

    Args:
        name: Name of the instance; a dock's `type` refers to it.
        dock_direction: Gear of the approach.
        staging_x_offset: From the dock to the staging pose, along the dock's x [m].
        staging_yaw_offset: Added to the dock's yaw there [rad].
        docking_threshold: Distance at which Nav2 calls the robot docked [m].
    """

    name: str
    dock_direction: DockDirection = DockDirection.FORWARD
    staging_x_offset: float = -0.7
    staging_yaw_offset: float = 0.0
    docking_threshold: float = 0.05

    def staging_pose(self, dock: Pose2) -> Pose2:
        """Where Nav2 would begin the approach to `dock`."""
        return dock @ Pose2(self.staging_x_offset, 0.0, self.staging_yaw_offset)


def read_dock_type(
    document: Document, keys: Keys, name: str, values: Mapping[str, object], faults: list[str]
) -> DockType:
    """The dock type whose parameters stand at `keys`; faults are added to `faults`."""
    read = NumberReader(document, keys, values, faults)
    direction = read.text("dock_direction", _DIRECTIONS[0])
    if direction not in _DIRECTIONS:
        read.fault("dock_direction", f"must be forward or backward, got {direction!r}{closest(direction, _DIRECTIONS)}")
        direction = _DIRECTIONS[0]
    if values.get("rotate_to_dock") is True and direction != DockDirection.BACKWARD.value:
        read.fault("rotate_to_dock", "needs dock_direction: backward")
    return DockType(
        name=name,
        dock_direction=DockDirection(direction),
        staging_x_offset=read.number("staging_x_offset", -0.7),
        staging_yaw_offset=read.number("staging_yaw_offset", 0.0, unit="rad"),
        docking_threshold=read.number("docking_threshold", 0.05, positive=True),
    )
