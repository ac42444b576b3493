"""Nav2's docks: poses from dock databases or parameter files, and dock types.

Every dock is read separately, whereas Nav2's file loader also uses the `id` of one dock for the docks below it. All
faults are reported together.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from optdock.errors import InvalidFile, InvalidValue
from optdock.geometry.pose import Pose2
from optdock.io.numbers import check_yaw, is_number
from optdock.io.quoting import listed, shown
from optdock.io.yaml_lines import load_yaml
from optdock.model.dock import DockDirection
from optdock.nav2.parameter_block import ParameterBlock
from optdock.plugins.parameters import closest

if TYPE_CHECKING:
    from pathlib import Path

    from optdock.io.yaml_lines import Document, Keys

__all__ = ["DockEntry", "DockTypeParams", "docked_pose", "load_dock_database", "read_dock", "read_dock_type"]

_DIRECTIONS = (DockDirection.FORWARD.value, DockDirection.BACKWARD.value)
_KEYS = ("type", "frame", "pose", "id")
_DEFAULT_FRAME = "map"


def docked_pose(dock: Pose2, direction: DockDirection) -> Pose2:
    """Return the pose of the docked robot; the x axis of Nav2's dock poses points into the dock for both directions.

    The function also converts in the other direction: for the pose of the docked robot, it returns the dock's pose.
    """
    return dock @ Pose2(0.0, 0.0, math.pi) if direction is DockDirection.BACKWARD else dock


@dataclass(frozen=True)
class DockTypeParams:
    """Parameters of a dock plugin instance; names and defaults are the same as in opennav_docking's simple docks.

    Args:
        name: Name of the instance, as used by the `type` of docks.
        dock_direction: Gear of the approach.
        staging_x_offset: Position of the staging pose along the dock's x axis [m].
        staging_yaw_offset: Yaw of the staging pose relative to the dock [rad].
        docking_threshold: Distance at which Nav2 regards the robot as docked [m].
    """

    name: str
    dock_direction: DockDirection = DockDirection.FORWARD
    staging_x_offset: float = -0.7
    staging_yaw_offset: float = 0.0
    docking_threshold: float = 0.05


def read_dock_type(name: str, block: ParameterBlock, *, dock_backwards: object = None) -> DockTypeParams:
    """Return the dock type with the parameters in `block`; faults are added to the faults of the block.

    Args:
        name: Name of the dock type.
        block: Parameters of the dock type.
        dock_backwards: Gear for all docks, a parameter of the docking server; if it is not a bool, `dock_direction` of
            the dock type applies.
    """
    usual = _DIRECTIONS[dock_backwards is True]
    direction = block.text("dock_direction", usual)
    if direction not in _DIRECTIONS:
        hint = closest(direction, _DIRECTIONS)
        block.fault("dock_direction", message=f"must be forward or backward, got {shown(direction)}{hint}")
        direction = usual
    elif isinstance(dock_backwards, bool) and direction != usual:
        block.fault("dock_direction", message=f"contradicts dock_backwards, which means {usual!r}")
    if block.values.get("rotate_to_dock") is True and direction != DockDirection.BACKWARD.value:
        block.fault("rotate_to_dock", message="needs dock_direction: backward")
    return DockTypeParams(
        name=name,
        dock_direction=DockDirection(direction),
        staging_x_offset=block.number("staging_x_offset", -0.7),
        staging_yaw_offset=block.number("staging_yaw_offset", 0.0, unit="rad"),
        docking_threshold=block.number("docking_threshold", 0.05, positive=True),
    )


@dataclass(frozen=True)
class DockEntry:
    """One dock of a database or parameter file.

    Args:
        name: Name of the dock.
        type: Name of its dock plugin instance.
        pose: Pose of a robot docked forward, in `frame`; a robot docked backward has the opposite yaw.
        frame: Name of the coordinate frame.
        id: Name used by detectors, or None.
        unknown: Keys that Nav2 does not read.
    """

    name: str
    type: str
    pose: Pose2
    frame: str = _DEFAULT_FRAME
    id: str | None = None
    unknown: tuple[str, ...] = ()


def load_dock_database(source: str | Path) -> dict[str, DockEntry]:
    """Read a dock database: `docks:`, then by name `type`, `pose: [x, y, yaw]`, and optionally `frame` and `id`.

    Raises:
        InvalidFile: If the file cannot be read or has no docks, or if a dock has a wrong value or lacks its type or
            pose; the message lists all faults.
    """
    document = load_yaml(source)
    docks = document.value.get("docks") if isinstance(document.value, Mapping) else None
    if not (isinstance(docks, Mapping) and docks):
        keys = [str(key) for key in document.value] if isinstance(document.value, Mapping) else []
        hint = f"; the file has {', '.join(keys)}" if keys and "docks" not in keys else ""
        raise InvalidFile(document.fault(("docks",), f"must be a mapping of dock names to docks{hint}"))
    faults: list[str] = []
    entries = [read_dock(document, ("docks", name), faults) for name in docks]
    if faults:
        raise InvalidFile(listed(str(document.path), faults))
    return {entry.name: entry for entry in entries if entry is not None}


def read_dock(document: Document, keys: Keys, faults: list[str]) -> DockEntry | None:
    """Return the dock at `keys` of a document; None if it has faults, which are added to `faults`."""
    values = document.value
    for key in keys:
        values = values.get(key) if isinstance(values, Mapping) else None
    if not isinstance(values, Mapping):
        faults.append(document.fault(keys, f"must be a mapping with type and pose, got {shown(values)}"))
        return None
    before, block = len(faults), ParameterBlock(document, keys, values, faults)
    texts = {key: _text(block, key) for key in ("type", "frame", "id")}
    pose = _pose(block)
    if pose is None or texts["type"] is None or len(faults) > before:
        return None
    unknown = tuple(str(key) for key in values if key not in _KEYS)
    return DockEntry(str(keys[-1]), texts["type"], pose, texts["frame"] or _DEFAULT_FRAME, texts["id"], unknown)


def _text(block: ParameterBlock, key: str) -> str | None:
    value = block.values.get(key)
    if key not in block.values:
        if key == "type":
            _missing(block, key, "the name of a dock plugin")
        return None
    if isinstance(value, bool) or not isinstance(value, str | int) or value == "":
        block.fault(key, message=f"must be text, got {shown(value)}")
        return None
    return str(value)


def _pose(block: ParameterBlock) -> Pose2 | None:
    values = block.values.get("pose")
    if "pose" not in block.values:
        _missing(block, "pose", "[x, y, yaw] in m, m, rad")
        return None
    if not (isinstance(values, list) and len(values) == 3):
        block.fault("pose", message=f"must be [x, y, yaw] in m, m, rad, got {shown(values)}")
        return None
    bad = [i for i, value in enumerate(values) if not is_number(value)]
    for i in bad:
        block.fault("pose", i, message=f"must be a number, got {shown(values[i])}")
    if bad:
        return None
    try:
        pose = Pose2(*map(float, values))
        check_yaw(pose.yaw)
    except InvalidValue as error:
        block.fault("pose", message=str(error))
        return None
    return pose


def _missing(block: ParameterBlock, key: str, what: str) -> None:
    near = [name for name in map(str, block.values) if name not in _KEYS and closest(name, [key])]
    hint = f"; {near[0]} is not read, did you mean {key}?" if near else ""
    block.fault(key, message=f"is required: {what}{hint}")
