"""DockLayer: marks the dock as an obstacle and frees the cells of the docked robot."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from optdock.errors import InvalidValue
from optdock.model.costs import FREE_SPACE, LETHAL
from optdock.model.dock import Dock
from optdock.nav2.layers.nav2_layer import LayerParameters, Nav2Layer, checked_window, joined, outline_bounds
from optdock.nav2.layers.raster import fill_footprint

if TYPE_CHECKING:
    from optdock.geometry.footprint import Footprint
    from optdock.geometry.pose import Pose2
    from optdock.model.costmap import Costmap
    from optdock.plugins.interfaces import Bounds

__all__ = ["DockLayer", "DockLayerParameters"]


class DockLayerParameters(LayerParameters):
    """Parameters of the DockLayer; Nav2 has no such layer."""

    contact_margin: float = Field(
        default=0.05, ge=0.0, description="distance around the docked robot within which mapped cells are cleared [m]"
    )


class DockLayer(Nav2Layer):
    """Clear the mapped cells around the docked robot, mark the dock, and free the cells of the docked robot.

    In a map built from scans, the dock is one or two cells too large, so the docked robot appears to be in collision.
    The layer belongs above the map's layer and below the sensor layers. Steps that require the dock or the robot's
    footprint are skipped if the dock or the footprint is unknown.

    Args:
        **parameters: Fields of `DockLayerParameters`.

    Raises:
        InvalidValue: If a parameter is unknown, of the wrong type or out of range.
    """

    Parameters = DockLayerParameters
    parameters: DockLayerParameters

    def __init__(self, **parameters: object) -> None:
        super().__init__(**parameters)
        self._dock: Dock | None = None

    def on_configure(self) -> None:
        """Use the dock of the context's problem unless a dock was set before."""
        if self._dock is None and self.context.problem is not None:
            self.set_dock(self.context.problem.dock)

    def set_dock(self, dock: Dock | None) -> None:
        """Replace the dock.

        Raises:
            InvalidValue: If `dock` is neither a Dock nor None; the previous dock is kept.
        """
        if not (dock is None or isinstance(dock, Dock)):
            raise InvalidValue(f"{self.context.name}: a dock must be a Dock or None, got {dock!r}")
        self._dock = dock

    def update_bounds(self, robot: Pose2, bounds: Bounds) -> Bounds:  # noqa: ARG002 - the interface's
        """Return `bounds` extended by the dock and the cleared cells."""
        if self._dock is not None:
            for outline, _ in self._outlines(self._dock):
                bounds = joined(bounds, outline_bounds(outline, self._dock.pose))
        return bounds

    def update_costs(self, master: Costmap, min_i: int, min_j: int, max_i: int, max_j: int) -> None:
        """Write the dock and the cleared cells into the window.

        Raises:
            InvalidValue: If the window is not within the master grid, or the grid is read-only.
        """
        window = checked_window(master, min_i, min_j, max_i, max_j)
        if self._dock is not None:
            for outline, cost in self._outlines(self._dock):
                fill_footprint(master, outline, self._dock.pose, cost, window)

    def _outlines(self, dock: Dock) -> list[tuple[Footprint, int]]:
        """Return the outlines at the docked pose and their costs, in the order in which they are written."""
        robot, margin = self.context.footprint, self.parameters.contact_margin
        outlines = []
        if robot is not None:
            outlines.append((robot.padded(margin) if margin > 0.0 else robot, FREE_SPACE))
        if dock.footprint is not None:
            outlines.append((dock.footprint, LETHAL))
        if robot is not None:
            outlines.append((robot, FREE_SPACE))
        return outlines
