"""Nav2's docks: where they stand (its dock databases, or a parameter file), and of which type they are.

Unlike Nav2's file loader, every dock is read on its own: an `id` never leaks to the docks below it, and all faults
are reported at once.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from optdock.errors import InvalidFile, InvalidValue
from optdock.geometry.pose import Pose2
from optdock.io.numbers import check_yaw, is_number
from optdock.io.quoting import shown
from optdock.io.yaml_lines import listed, load_yaml
from optdock.model.dock import DockDirection
from optdock.nav2.parameter_numbers import NumberReader
from optdock.plugins.parameters import closest

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from optdock.io.yaml_lines import Document, Keys

__all__ = ["DockEntry", "DockTypeParams", "docked_pose", "load_dock_database", "read_dock", "read_dock_type"]

_DIRECTIONS = (DockDirection.FORWARD.value, DockDirection.BACKWARD.value)


def docked_pose(dock: Pose2, direction: DockDirection) -> Pose2:
    """Where the robot stands when docked: the x axis of Nav2's docks points into them, also for a robot that backs in.

    Half a turn is its own inverse, so this also gives the dock's pose of a robot that stands docked.
    """
    return dock @ Pose2(0.0, 0.0, math.pi) if direction is DockDirection.BACKWARD else dock


@dataclass(frozen=True)
class DockTypeParams:
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

    def docked_pose(self, dock: Pose2) -> Pose2:
        """Where the robot stands when docked; see the function of this name."""
        return docked_pose(dock, self.dock_direction)

    def staging_pose(self, dock: Pose2) -> Pose2:
        """Where Nav2 would begin the approach to `dock`."""
        return dock @ Pose2(self.staging_x_offset, 0.0, self.staging_yaw_offset)


def read_dock_type(
    document: Document, keys: Keys, name: str, values: Mapping[str, object], faults: list[str]
) -> DockTypeParams:
    """The dock type whose parameters stand at `keys`; faults are added to `faults`."""
    read = NumberReader(document, keys, values, faults)
    direction = read.text("dock_direction", _DIRECTIONS[0])
    if direction not in _DIRECTIONS:
        read.fault(
            "dock_direction", f"must be forward or backward, got {shown(direction)}{closest(direction, _DIRECTIONS)}"
        )
        direction = _DIRECTIONS[0]
    if values.get("rotate_to_dock") is True and direction != DockDirection.BACKWARD.value:
        read.fault("rotate_to_dock", "needs dock_direction: backward")
    return DockTypeParams(
        name=name,
        dock_direction=DockDirection(direction),
        staging_x_offset=read.number("staging_x_offset", -0.7),
        staging_yaw_offset=read.number("staging_yaw_offset", 0.0, unit="rad"),
        docking_threshold=read.number("docking_threshold", 0.05, positive=True),
    )


_KEYS = ("type", "frame", "pose", "id")
_DEFAULT_FRAME = "map"


@dataclass(frozen=True)
class DockEntry:
    """One dock.

    Args:
        name: Its name.
        type: Name of the dock plugin instance that knows how to dock there.
        pose: Of the dock, in `frame`: where a robot stands that has driven in forwards; one that has backed in stands
            the other way round.
        frame: Name of the coordinate frame.
        id: What detectors call it, or None.
        unknown: Keys that Nav2 does not read.
    """

    name: str
    type: str
    pose: Pose2
    frame: str = _DEFAULT_FRAME
    id: str | None = None
    unknown: tuple[str, ...] = ()


def load_dock_database(source: str | Path) -> dict[str, DockEntry]:
    """Read a dock database: `docks:`, then per name `type`, `pose: [x, y, yaw]`, optionally `frame` and `id`.

    Raises:
        InvalidFile: The file cannot be read, has no docks, or a dock lacks its type or pose or has a wrong value; the
            message lists every fault.
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
    """The dock at `keys` of a document, or None when it has faults, which are added to `faults`."""
    block = _at(document.value, keys)
    if not isinstance(block, Mapping):
        faults.append(document.fault(keys, f"must be a mapping with type and pose, got {shown(block)}"))
        return None
    before = len(faults)
    texts = {key: _text(document, keys, block, key, faults) for key in ("type", "frame", "id")}
    pose = _pose(document, keys, block, faults)
    if pose is None or texts["type"] is None or len(faults) > before:
        return None
    unknown = tuple(str(key) for key in block if key not in _KEYS)
    return DockEntry(str(keys[-1]), texts["type"], pose, texts["frame"] or _DEFAULT_FRAME, texts["id"], unknown)


def _at(value: object, keys: Keys) -> object:
    for key in keys:
        value = value.get(key) if isinstance(value, Mapping) else None
    return value


def _text(document: Document, keys: Keys, block: Mapping[str, object], key: str, faults: list[str]) -> str | None:
    value = block.get(key)
    if key not in block:
        if key == "type":
            faults.append(_missing(document, keys, block, key, "the name of a dock plugin"))
        return None
    if isinstance(value, bool) or not isinstance(value, str | int) or value == "":
        faults.append(document.fault((*keys, key), f"must be text, got {shown(value)}"))
        return None
    return str(value)


def _pose(document: Document, keys: Keys, block: Mapping[str, object], faults: list[str]) -> Pose2 | None:
    value = block.get("pose")
    if "pose" not in block:
        faults.append(_missing(document, keys, block, "pose", "[x, y, yaw] in m, m, rad"))
        return None
    if not (isinstance(value, list) and len(value) == 3):
        faults.append(document.fault((*keys, "pose"), f"must be [x, y, yaw] in m, m, rad, got {shown(value)}"))
        return None
    return _checked_pose(document, (*keys, "pose"), value, faults)


def _checked_pose(document: Document, keys: Keys, values: Sequence[object], faults: list[str]) -> Pose2 | None:
    bad = [i for i, v in enumerate(values) if not is_number(v)]
    faults.extend(document.fault((*keys, i), f"must be a number, got {shown(values[i])}") for i in bad)
    if bad:
        return None
    try:
        pose = Pose2(*(float(str(value)) for value in values))
        check_yaw(pose.yaw)
    except InvalidValue as error:
        faults.append(document.fault(keys, str(error)))
        return None
    return pose


def _missing(document: Document, keys: Keys, block: Mapping[str, object], key: str, what: str) -> str:
    near = [name for name in map(str, block) if name not in _KEYS and closest(name, [key])]
    hint = f"; {near[0]} is not read, did you mean {key}?" if near else ""
    return document.fault((*keys, key), f"is required: {what}{hint}")
