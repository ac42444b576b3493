"""DockLayer: the dock as an obstacle that lets the docked robot in."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from optdock.errors import InvalidValue
from optdock.model.costs import FREE_SPACE, LETHAL
from optdock.model.dock import Dock
from optdock.nav2.layers.base import LayerParameters, SwitchedLayer
from optdock.nav2.layers.raster import corners_of, fill_footprint
from optdock.nav2.layers.window import NOWHERE, checked_window, grown_by_points, joined
from optdock.plugins.interfaces import Bounds

if TYPE_CHECKING:
    from optdock.geometry.footprint import Footprint
    from optdock.geometry.pose import Pose2
    from optdock.model.costmap import Costmap

__all__ = ["DockLayer", "DockLayerParameters"]


class DockLayerParameters(LayerParameters):
    """Parameters of the DockLayer; Nav2 has no such layer."""

    contact_margin: float = Field(
        default=0.05, ge=0.0, description="how far around the docked robot mapped cells are cleared [m]"
    )


class DockLayer(SwitchedLayer):
    """Clears what the map holds around the docked robot, marks the dock, and frees the docked robot's own cells.

    A map drawn from scans shows the dock a cell or two too fat, so that the docked robot seems to collide. Place
    the layer after the map's and before those of the sensors: what they see in the dock must still count. Without a
    dock, or without the robot's footprint, the part that needs it is left out.

    Args:
        **parameters: Fields of `DockLayerParameters`.

    Raises:
        InvalidValue: A parameter is unknown, of the wrong type or out of range.
    """

    Parameters = DockLayerParameters
    parameters: DockLayerParameters

    def __init__(self, **parameters: object) -> None:
        super().__init__(**parameters)
        self._dock: Dock | None = None
        self._pending = NOWHERE
        self._written = NOWHERE

    def on_configure(self) -> None:
        """Take the dock of the problem at hand, unless one was set before."""
        if self._dock is None and self.context.problem is not None:
            self.set_dock(self.context.problem.dock)

    def set_dock(self, dock: Dock | None) -> None:
        """Take another dock, or none; the next update rewrites both places.

        Raises:
            InvalidValue: `dock` is neither a Dock nor None; the old one stays.
        """
        if not (dock is None or isinstance(dock, Dock)):
            raise InvalidValue(f"{self.context.name}: a dock must be a Dock or None, got {dock!r}")
        self._dock = dock
        self._pending = joined(self._written, self._extent())

    def reset(self) -> None:
        """Write the dock again; the dock itself stays."""
        self._pending = joined(self._written, self._extent())

    def match_size(self) -> None:
        """Write the dock again."""
        self.reset()

    def on_footprint_changed(self) -> None:
        """Write the dock again."""
        self.reset()

    def update_bounds(self, robot: Pose2, bounds: Bounds) -> Bounds:  # noqa: ARG002 - the interface's
        """`bounds` grown to the dock and its contact zone where they must be written."""
        return joined(bounds, self._pending)

    def update_costs(self, master: Costmap, min_i: int, min_j: int, max_i: int, max_j: int) -> None:
        """Write dock and contact zone inside the window.

        Raises:
            InvalidValue: The window is not within the master grid.
        """
        window = checked_window(master, min_i, min_j, max_i, max_j)
        dock, robot = self._dock, self.context.footprint
        if dock is not None and robot is not None:
            fill_footprint(master, self._zone(robot), dock.pose, FREE_SPACE, window)
        if dock is not None and dock.footprint is not None:
            fill_footprint(master, dock.footprint, dock.pose, LETHAL, window)
        if dock is not None and robot is not None:
            fill_footprint(master, robot, dock.pose, FREE_SPACE, window)
        self._pending, self._written = NOWHERE, self._extent()

    def _zone(self, robot: Footprint) -> Footprint:
        margin = self.parameters.contact_margin
        return robot.padded(margin) if margin > 0.0 else robot

    def _extent(self) -> Bounds:
        if self._dock is None:
            return NOWHERE
        robot = self.context.footprint
        outlines = [o for o in (self._dock.footprint, None if robot is None else self._zone(robot)) if o is not None]
        bounds = NOWHERE
        for outline in outlines:
            bounds = grown_by_points(bounds, corners_of(outline, self._dock.pose))
        return bounds
