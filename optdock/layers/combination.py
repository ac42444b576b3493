"""How a layer's costs meet those already in the master grid (Nav2: `CombinationMethod`)."""

from __future__ import annotations

from enum import IntEnum
from typing import TYPE_CHECKING

import numpy as np

from optdock.costmap.costs import NO_INFORMATION

if TYPE_CHECKING:
    from optdock.costmap.costs import CostArray

__all__ = ["CombinationMethod", "combined"]


class CombinationMethod(IntEnum):
    """Nav2's numbers."""

    OVERWRITE = 0
    MAX = 1
    MAX_WITHOUT_UNKNOWN_OVERWRITE = 2


def combined(master: CostArray, layer: CostArray, method: CombinationMethod) -> CostArray:
    """The master's costs after a layer of the same shape; where the layer knows nothing the master stays.

    OVERWRITE takes the layer's cost, MAX the higher one and the layer's where the master is unknown,
    MAX_WITHOUT_UNKNOWN_OVERWRITE the higher one and leaves the master's unknown cells.
    """
    is_known = layer != NO_INFORMATION
    if method is CombinationMethod.OVERWRITE:
        return np.where(is_known, layer, master)
    is_unknown = master == NO_INFORMATION
    wins = is_known & (layer > master)
    if method is CombinationMethod.MAX:
        wins |= is_known & is_unknown
    return np.where(wins, layer, master)
