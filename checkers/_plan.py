"""What every checker asks of the remaining path: how long it is."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable

    from optdock.geometry.pose import Pose2

__all__ = ["longer_than"]


def longer_than(path: Iterable[Pose2], limit: float) -> bool:
    """Whether the path's chords add up to more than `limit` [m]; a path of 0 or 1 poses has length 0.

    Summed in driving order, as Nav2 does, so that a length equal to the limit up to rounding is judged alike.
    """
    total = 0.0
    for before, after in itertools.pairwise(path):
        total += math.hypot(after.x - before.x, after.y - before.y)
        if total > limit:
            return True
    return False
