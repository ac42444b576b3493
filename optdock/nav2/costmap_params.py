"""Costmap parameters of a Nav2 parameter file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from optdock.errors import InvalidValue
from optdock.geometry.footprint import Footprint
from optdock.io.numbers import check_outline
from optdock.nav2.parameter_numbers import NumberReader

if TYPE_CHECKING:
    from collections.abc import Mapping

    from optdock.io.yaml_lines import Document, Keys

__all__ = ["CostmapParams", "read_costmap"]

_NO_FOOTPRINT = ("", "[]")


@dataclass(frozen=True, eq=False)
class CostmapParams:
    """The parameters of a costmap.

    Args:
        name: Its name, such as `global_costmap`.
        footprint: The robot's outline as given, or None where `robot_radius` holds.
        robot_radius: Radius of a round robot [m].
        footprint_padding: How far Nav2 moves every vertex outward [m].
        resolution: Side of a cell [m].
        global_frame: Name of the coordinate frame.
        layers: Names of the layers, from the bottom up.
        filters: Names of the filters.
    """

    name: str
    footprint: Footprint | None = None
    robot_radius: float = 0.1
    footprint_padding: float = 0.01
    resolution: float = 0.1
    global_frame: str = "map"
    layers: tuple[str, ...] = ()
    filters: tuple[str, ...] = ()

    @property
    def outline(self) -> Footprint:
        """The padded footprint that Nav2 would check."""
        given = self.footprint if self.footprint is not None else Footprint.from_radius(self.robot_radius)
        return given.padded(self.footprint_padding)


def read_costmap(
    document: Document, keys: Keys, name: str, values: Mapping[str, object], faults: list[str]
) -> CostmapParams:
    """The costmap whose parameters stand at `keys`; faults are added to `faults`."""
    read = NumberReader(document, keys, values, faults)
    costmap = CostmapParams(
        name=name,
        footprint=_footprint(values.get("footprint", "[]"), read),
        robot_radius=read.number("robot_radius", 0.1, positive=True, unit="m"),
        footprint_padding=read.number("footprint_padding", 0.01, unit="m"),
        resolution=read.number("resolution", 0.1, positive=True),
        global_frame=read.text("global_frame", "map"),
        layers=_names(values.get("plugins")),
        filters=_names(values.get("filters")),
    )
    try:
        _ = costmap.outline
    except InvalidValue as error:
        read.fault("footprint_padding", f"leaves no outline: {error}")
    return costmap


def _footprint(value: object, read: NumberReader) -> Footprint | None:
    """Nav2 falls back to the radius when the text is wrong; here only an empty one does."""
    text = value.strip() if isinstance(value, str) else str(value)
    if text in _NO_FOOTPRINT:
        return None
    try:
        footprint = Footprint.from_string(text)
        check_outline(footprint)
    except InvalidValue as error:
        read.fault("footprint", str(error).removeprefix("footprint: "))
        return None
    return footprint


def _names(value: object) -> tuple[str, ...]:
    return tuple(str(name) for name in value) if isinstance(value, list) else ()
