"""Cost values and their conversion from and to occupancy (Nav2: `cost_values.hpp`, `StaticLayer::interpretValue`)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray

from optdock.errors import InvalidValue

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

__all__ = [
    "FREE_SPACE",
    "INSCRIBED",
    "LETHAL",
    "MAX_NON_OBSTACLE",
    "NO_INFORMATION",
    "OCCUPANCY_UNKNOWN",
    "CostArray",
    "OccupancyArray",
    "OccupancyRule",
    "costs_from_occupancy",
    "occupancy_from_costs",
]

CostArray: TypeAlias = NDArray[np.uint8]
OccupancyArray: TypeAlias = NDArray[np.int8]

FREE_SPACE = 0
MAX_NON_OBSTACLE = 252
INSCRIBED = 253
LETHAL = 254
NO_INFORMATION = 255

OCCUPANCY_UNKNOWN = -1
_OCCUPANCY_INSCRIBED = 99


@dataclass(frozen=True)
class OccupancyRule:
    """Conversion of occupancy to cost; the fields are Nav2's costmap parameters.

    `track_unknown_space` is True by default (Nav2: False), because a dock planner must not drive into unknown space.

    Args:
        track_unknown_space: Whether unknown cells stay unknown (255); otherwise they are free.
        lethal_cost_threshold: Smallest occupancy of a lethal cell, 1..100.
        trinary_costmap: Whether all values below the threshold are free; otherwise they are scaled.
        unknown_cost_value: The occupancy that means unknown, as an unsigned byte; 255 stands for -1.
        inscribed_obstacle_cost_value: The occupancy that means inscribed (253).

    Raises:
        InvalidValue: If the threshold is not in 1..100 or another value not in 0..255.
    """

    track_unknown_space: bool = True
    lethal_cost_threshold: int = 100
    trinary_costmap: bool = True
    unknown_cost_value: int = 255
    inscribed_obstacle_cost_value: int = 99

    def __post_init__(self) -> None:
        if not 1 <= self.lethal_cost_threshold <= 100:
            raise InvalidValue(f"lethal_cost_threshold: must be in 1..100, got {self.lethal_cost_threshold}")
        for name in ("unknown_cost_value", "inscribed_obstacle_cost_value"):
            if not 0 <= getattr(self, name) <= 255:
                raise InvalidValue(f"{name}: must be in 0..255, got {getattr(self, name)}")

    def table(self) -> CostArray:
        """Return the costs of the occupancies 0..100, followed by the cost of -1. Shape (102,)."""
        occupancy = np.append(np.arange(101), 255)
        scaled = (occupancy / self.lethal_cost_threshold * LETHAL).astype(np.int64)
        below = np.zeros_like(scaled) if self.trinary_costmap else scaled
        costs = np.where(occupancy >= self.lethal_cost_threshold, LETHAL, below)
        costs[occupancy == self.inscribed_obstacle_cost_value] = INSCRIBED
        costs[occupancy == self.unknown_cost_value] = NO_INFORMATION if self.track_unknown_space else FREE_SPACE
        return costs.astype(np.uint8)


def costs_from_occupancy(occupancy: ArrayLike, rule: OccupancyRule | None = None) -> CostArray:
    """Convert occupancies to costs; by default 100 becomes 254, 99 becomes 253, -1 becomes 255, all others 0.

    Args:
        occupancy: Integers, -1 (unknown) or 0..100, any shape.
        rule: The conversion; None for the defaults.

    Raises:
        InvalidValue: If a value is not an integer in -1..100.
    """
    values = np.asarray(occupancy)
    if values.dtype.kind not in "iu":
        raise InvalidValue(f"occupancy: must be integers, got {values.dtype}")
    bad = values[(values < OCCUPANCY_UNKNOWN) | (values > 100)]
    if bad.size:
        raise InvalidValue(f"occupancy: must be -1 (unknown) or 0..100, got {int(bad[0])}")
    costs: CostArray = (rule or OccupancyRule()).table()[values]
    return costs


def occupancy_from_costs(costs: CostArray) -> OccupancyArray:
    """Convert costs to the occupancies that Nav2 publishes: 1..252 to 1..98, 253 to 99, 254 to 100, 255 to -1."""
    scale = np.arange(256)
    table = np.where(scale == FREE_SPACE, 0, 1 + (97 * (scale - 1)) // 251)
    table[[INSCRIBED, LETHAL, NO_INFORMATION]] = (_OCCUPANCY_INSCRIBED, 100, OCCUPANCY_UNKNOWN)
    occupancy: OccupancyArray = table.astype(np.int8)[costs]
    return occupancy
