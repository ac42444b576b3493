"""InflationLayer: costs around obstacles (Nav2: `nav2_costmap_2d::InflationLayer`)."""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from pydantic import Field

from optdock.costmap.costs import FREE_SPACE, INSCRIBED, LETHAL, MAX_NON_OBSTACLE, NO_INFORMATION, CostArray
from optdock.errors import InvalidValue
from optdock.nav2.layers.base import LayerParameters, SwitchedLayer
from optdock.nav2.layers.window import EVERYWHERE, checked_window
from optdock.plugins.interfaces import Bounds

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from optdock.costmap.costmap import Costmap
    from optdock.geometry.arrays import BoolArray
    from optdock.geometry.pose import Pose2

__all__ = ["InflationLayer", "InflationLayerParameters", "InflationRule", "inflation_costs"]

logger = logging.getLogger(__name__)

_CELL_SLACK = 1e-9  # a radius of 14 cells reaches the 14th cell although 14 * 0.05 > 0.7 in floating point


@dataclass(frozen=True)
class InflationRule:
    """Cost by distance d from the nearest lethal cell's centre, cell centre to cell centre.

    d = 0: 254. d <= inscribed_radius: 253. Up to inflation_radius: the integer part of
    252 exp(-cost_scaling_factor (d - inscribed_radius)). Beyond: 0.

    Args:
        inscribed_radius: Radius of the largest circle inside the footprint around the robot's origin [m].
        inflation_radius: How far costs reach [m].
        cost_scaling_factor: How fast they fall [1/m].

    Raises:
        InvalidValue: A value is not finite and >= 0.
    """

    inscribed_radius: float
    inflation_radius: float = 0.55
    cost_scaling_factor: float = 10.0

    def __post_init__(self) -> None:
        for name in ("inscribed_radius", "inflation_radius", "cost_scaling_factor"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise InvalidValue(f"inflation.{name}: must be finite and >= 0, got {value}")

    def cost_at(self, distance: ArrayLike) -> CostArray:
        """Costs at distances [m], any shape."""
        d = np.asarray(distance, dtype=np.float64)
        falling = MAX_NON_OBSTACLE * np.exp(-self.cost_scaling_factor * np.maximum(d - self.inscribed_radius, 0.0))
        costs = np.where(d <= self.inscribed_radius, INSCRIBED, falling.astype(np.int64))
        costs = np.where(d > self.inflation_radius * (1.0 + _CELL_SLACK), FREE_SPACE, costs)
        return np.where(d <= 0.0, LETHAL, costs).astype(np.uint8)

    def reach(self, resolution: float) -> int:
        """How many cells the costs reach, straight along a row."""
        return math.floor(self.inflation_radius / resolution * (1.0 + _CELL_SLACK) + _CELL_SLACK)


def inflation_costs(seeds: BoolArray, resolution: float, rule: InflationRule) -> CostArray:
    """Inflation costs around seed cells, exact to the nearest seed.

    Args:
        seeds: Shape (rows, columns), true where the distance is 0.
        resolution: Side of a cell [m].
        rule: Cost by distance.

    Returns:
        Shape (rows, columns).
    """
    if not seeds.any():
        return np.zeros(seeds.shape, dtype=np.uint8)
    from scipy.ndimage import distance_transform_edt

    distance = distance_transform_edt(~seeds)
    farthest = rule.reach(resolution) + 1
    np.minimum(distance, farthest, out=distance)
    # Distances between cells are roots of whole numbers: a table over their squares is exact.
    np.multiply(distance, distance, out=distance)
    table = rule.cost_at(np.sqrt(np.arange(farthest**2 + 1)) * resolution)
    table[-1] = FREE_SPACE
    costs: CostArray = table[(distance + 0.5).astype(np.int32)]
    return costs


class InflationLayerParameters(LayerParameters):
    """Nav2's parameters of the InflationLayer."""

    inflation_radius: float = Field(default=0.55, ge=0.0, description="how far costs reach [m]")
    cost_scaling_factor: float = Field(default=10.0, ge=0.0, description="how fast they fall [1/m]")
    inflate_unknown: bool = Field(default=False, description="any cost replaces unknown; else only 253 and 254 do")
    inflate_around_unknown: bool = Field(default=False, description="unknown cells are inflated like lethal ones")
    custom_inscribed_radius: float = Field(
        default=-1.0, description="inscribed radius [m]; below 0: that of the footprint"
    )

    graph_names: ClassVar[frozenset[str]] = frozenset({"num_threads"})


class InflationLayer(SwitchedLayer):
    """Raises the costs around the lethal cells that the layers before it have written.

    Needs the robot's inscribed radius: from the footprint of its context, or `custom_inscribed_radius`.

    Args:
        **parameters: Fields of `InflationLayerParameters`.

    Raises:
        InvalidValue: A parameter is unknown, of the wrong type or out of range.
    """

    Parameters = InflationLayerParameters
    parameters: InflationLayerParameters

    def __init__(self, **parameters: object) -> None:
        super().__init__(**parameters)
        self._last_rule: tuple[InflationRule, bool, bool] | None = None

    @property
    def rule(self) -> InflationRule:
        """Cost by distance.

        Raises:
            InvalidValue: There is neither a footprint nor a custom radius.
        """
        radius, footprint = self.parameters.custom_inscribed_radius, self.context.footprint
        if radius < 0.0:
            if footprint is None:
                raise InvalidValue(
                    f"{self.context.name}: needs an inscribed radius; give the costmap a footprint, or set "
                    f"custom_inscribed_radius >= 0 m, got {radius}"
                )
            radius = footprint.inscribed_radius
        return InflationRule(radius, self.parameters.inflation_radius, self.parameters.cost_scaling_factor)

    def on_configure(self) -> None:
        """Check that there is an inscribed radius."""
        rule = self.rule
        if rule.inflation_radius < rule.inscribed_radius:
            logger.warning(
                "%s: inflation_radius %g m is below the inscribed radius %g m: cells where the robot's centre cannot "
                "be will look free",
                self.context.name,
                rule.inflation_radius,
                rule.inscribed_radius,
            )

    def reset(self) -> None:
        """Inflate everything again."""
        self._last_rule = None

    def on_footprint_changed(self) -> None:
        """Inflate everything again."""
        self.reset()

    def match_size(self) -> None:
        """Inflate everything again."""
        self.reset()

    def update_bounds(self, robot: Pose2, bounds: Bounds) -> Bounds:  # noqa: ARG002 - the interface's
        """`bounds` grown by the inflation radius; everything after a change."""
        settings = (self.rule, self.parameters.inflate_unknown, self.parameters.inflate_around_unknown)
        changed = settings != self._last_rule
        self._last_rule = settings
        reach = self.parameters.inflation_radius
        grown = Bounds(bounds.min_x - reach, bounds.min_y - reach, bounds.max_x + reach, bounds.max_y + reach)
        return EVERYWHERE if changed else grown

    def update_costs(self, master: Costmap, min_i: int, min_j: int, max_i: int, max_j: int) -> None:
        """Raise the costs in the window around lethal cells in it and near it.

        Raises:
            InvalidValue: The window is not within the master grid, or there is no inscribed radius.
        """
        window = checked_window(master, min_i, min_j, max_i, max_j)
        rule = self.rule
        reach = rule.reach(master.resolution)
        if reach == 0 or min_i == max_i or min_j == max_j:
            return
        top, left = max(0, min_j - reach), max(0, min_i - reach)
        nearby = master.data[top : max_j + reach, left : max_i + reach]
        seeds = nearby == LETHAL
        if self.parameters.inflate_around_unknown:
            seeds |= nearby == NO_INFORMATION
        costs = inflation_costs(seeds, master.resolution, rule)
        inner = costs[min_j - top : max_j - top, min_i - left : max_i - left]
        master.data[window] = self._merged(master.data[window], inner)

    def _merged(self, old: CostArray, costs: CostArray) -> CostArray:
        strong = costs > FREE_SPACE if self.parameters.inflate_unknown else costs >= INSCRIBED
        merged: CostArray = np.where((old == NO_INFORMATION) & strong, costs, np.maximum(old, costs))
        return merged
