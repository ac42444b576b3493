"""Parameters of the dock planner."""

from __future__ import annotations

import numpy as np
from pydantic import Field, field_validator

from optdock.geometry.footprint import Footprint
from optdock.model.dock import DockDirection
from optdock.plugins.parameters import PluginParameters

__all__ = ["DockPlannerParameters"]


class DockPlannerParameters(PluginParameters):
    """Parameters of the two-segment planner; names and defaults of the source, `alpha` to `direction` are ours."""

    cost_threshold: int = Field(200, ge=0, le=255, description="a cell with a cost at or above this blocks the curve")
    calib_safety_distance: float = Field(0.0, description="added to the robot's circumscribed radius [m]")
    check_free_space: bool = Field(
        default=False, description="the costmap must be free under the robot's centre; needs one"
    )
    degree: int = Field(2, ge=1, le=2, description="NURBS degree; three control points carry at most 2")
    step: float = Field(0.02, gt=0.0, le=1.0, description="coarsest sampling step of u")
    footprint_dock: tuple[tuple[float, float], ...] | None = Field(
        None, description="outline of the dock, Nav2's string or points [m]; null: the problem's dock, or no length"
    )
    alpha: float = Field(1.0, ge=0.0, description="threshold angle of a start on the axis, in units of beta * pi")
    beta: float = Field(0.5, gt=0.0, le=1.0, description="slope of the threshold angle over the scale, in units of pi")
    gamma: float = Field(0.667, gt=0.0, lt=1.0, description="largest threshold angle, in units of pi")
    direction: DockDirection = Field(DockDirection.AUTO, description="gear of the last motion: auto, forward, backward")
    resolution: float = Field(0.05, gt=0.0, description="largest spacing of poses where there is no costmap [m]")

    @field_validator("footprint_dock", mode="before")
    @classmethod
    def _points(cls, value: object) -> object:
        return [tuple(row) for row in Footprint.from_string(value).vertices] if isinstance(value, str) else value

    @field_validator("footprint_dock")
    @classmethod
    def _is_a_polygon(cls, value: tuple[tuple[float, float], ...] | None) -> tuple[tuple[float, float], ...] | None:
        if value is not None:
            Footprint(np.array(value))
        return value

    @property
    def dock_outline(self) -> Footprint | None:
        """`footprint_dock` as a polygon, None where it is null."""
        return None if self.footprint_dock is None else Footprint(np.array(self.footprint_dock))
