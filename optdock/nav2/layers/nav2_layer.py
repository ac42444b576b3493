"""Base class of the layers, with common parameters, boxes in metres and windows of cells."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, ClassVar

from pydantic import Field, model_validator

from optdock.errors import InvalidValue
from optdock.geometry.pose import transform_points
from optdock.plugins.interfaces import Bounds, Layer
from optdock.plugins.parameters import PluginParameters

if TYPE_CHECKING:
    from optdock.geometry.footprint import Footprint
    from optdock.geometry.pose import Pose2
    from optdock.model.costmap import Costmap

__all__ = ["NOWHERE", "CellWindow", "LayerParameters", "Nav2Layer", "checked_window", "joined", "outline_bounds"]

NOWHERE = Bounds(math.inf, math.inf, -math.inf, -math.inf)

CellWindow = tuple[slice, slice]
"""Rows and columns, an index of a grid's data."""


class LayerParameters(PluginParameters):
    """Base class of the layers' parameters.

    Parameters that only matter in a ROS graph (topics, transforms) are accepted and ignored, so that a block of a Nav2
    parameter file can be used unchanged.
    """

    enabled: bool = Field(default=True, description="whether the layer is used")

    graph_names: ClassVar[frozenset[str]] = frozenset()

    @model_validator(mode="before")
    @classmethod
    def _without_graph_names(cls, values: object) -> object:
        if not isinstance(values, Mapping):
            return values
        return {name: value for name, value in values.items() if name not in cls.graph_names}


class Nav2Layer(Layer):
    """Base class of layers that have an `enabled` parameter.

    These layers store no observations and write all their cells in every update.
    """

    Parameters = LayerParameters
    parameters: LayerParameters

    def is_enabled(self) -> bool:
        """Return the parameter `enabled`."""
        return self.parameters.enabled

    def reset(self) -> None:
        """Do nothing; the layer stores no observations."""


def joined(first: Bounds, second: Bounds) -> Bounds:
    """Return the smallest box around two boxes.

    >>> joined(NOWHERE, Bounds(0.0, 0.0, 1.0, 1.0))
    Bounds(min_x=0.0, min_y=0.0, max_x=1.0, max_y=1.0)
    """
    return Bounds(
        min(first.min_x, second.min_x),
        min(first.min_y, second.min_y),
        max(first.max_x, second.max_x),
        max(first.max_y, second.max_y),
    )


def outline_bounds(footprint: Footprint, pose: Pose2) -> Bounds:
    """Return the smallest box around a footprint at a pose."""
    corners = transform_points(pose.as_array()[None], footprint.vertices)[0]
    return Bounds(*corners.min(axis=0).tolist(), *corners.max(axis=0).tolist())


def checked_window(grid: Costmap, min_i: int, min_j: int, max_i: int, max_j: int) -> CellWindow:
    """Return rows and columns of the window [min_i, max_i) x [min_j, max_j).

    Raises:
        InvalidValue: If the window is not within the grid, or the grid is read-only.
    """
    if not (0 <= min_i <= max_i <= grid.columns and 0 <= min_j <= max_j <= grid.rows):
        raise InvalidValue(
            f"window: columns [{min_i}, {max_i}), rows [{min_j}, {max_j}) are not within the master grid of "
            f"{grid.columns} columns and {grid.rows} rows"
        )
    if not grid.data.flags.writeable:
        raise InvalidValue("master grid: is read-only; layers need a grid made by Costmap.writable")
    return slice(min_j, max_j), slice(min_i, max_i)
