"""Inflation: costs that fall with the distance from the nearest lethal cell (Nav2: `InflationLayer::computeCost`)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from optdock.costmap.costs import FREE_SPACE, INSCRIBED, LETHAL, MAX_NON_OBSTACLE, CostArray
from optdock.errors import InvalidValue

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from optdock.geometry.arrays import BoolArray, FloatArray

__all__ = ["InflationRule", "inflation_costs"]

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

    def distance_of(self, cost: ArrayLike) -> FloatArray:
        """Distance [m] at which the cost is 1..252: inscribed_radius + ln(252 / cost) / cost_scaling_factor.

        Costs are integer parts: this is the largest distance with that cost, and `distance_of(cost + 1)` is below all
        of them. 253 gives inscribed_radius, 254 gives 0, 0 infinity, 255 NaN.

        Raises:
            InvalidValue: cost_scaling_factor is 0: one cost stands for many distances.
        """
        if self.cost_scaling_factor <= 0.0:
            raise InvalidValue("inflation.cost_scaling_factor: must be > 0 to tell a distance from a cost, got 0.0")
        table = np.full(256, np.nan)
        scaled = np.arange(1, MAX_NON_OBSTACLE + 1)
        table[scaled] = self.inscribed_radius + np.log(MAX_NON_OBSTACLE / scaled) / self.cost_scaling_factor
        table[[FREE_SPACE, INSCRIBED, LETHAL]] = (np.inf, self.inscribed_radius, 0.0)
        distance: FloatArray = table[np.asarray(cost)]
        return distance

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
