"""Width of the tracking tube by split conformal prediction over replayed dockings."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.calibration.statistics import Quantity, unknown
from optdock.geometry.pose import displacement
from optdock.model.robot import TrackingTube

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["DrivenTube", "conformal_rank", "conformal_tube"]


class DrivenTube(NamedTuple):
    """A tracking tube with its coverage.

    Attributes:
        tube: The tube; None if unknown.
        coverage: Lower bound of the probability that a further docking stays inside the tube [1].
        quantities: Widths `cross` and `yaw` of the tube.
    """

    tube: TrackingTube | None
    coverage: float
    quantities: list[Quantity]


def conformal_rank(count: int, coverage: float) -> int:
    """Return the rank, counted from 1, of the score that bounds the next score with probability `coverage`.

    The next score has each of the count + 1 possible ranks with equal probability, so it is at most the k-th score with
    a probability of at least k / (count + 1) ([Vovk2005]). If the rank is larger than `count`, no score is a bound.
    """
    return math.ceil(coverage * (count + 1) - 1e-9)


def conformal_tube(deviations: Sequence[tuple[float, float]], radius: float, coverage: float) -> DrivenTube:
    """Return the tube in which the next docking stays with probability `coverage`.

    The score of a docking is the largest possible displacement of a point of the footprint. A certificate depends only
    on the bound of this displacement, so its division between `cross` and `yaw` is arbitrary; the ratio of their
    medians is used.

    Args:
        deviations: Largest lateral deviation [m] and largest heading deviation [rad] from the path in each docking.
        radius: Circumscribed radius of the footprint [m]; 0 if unknown.
        coverage: Required probability.

    Returns:
        The tube; its quantities contain the reason if there are too few dockings or the footprint is unknown.
    """
    names = ("tube, cross", "m"), ("tube, yaw", "rad")
    count = len(deviations)
    rank, reason = conformal_rank(count, coverage), ""
    if rank > count:
        needed = math.ceil(coverage / (1.0 - coverage) - 1e-9)
        reason = f"there are {count} complete dockings; for {100 * coverage:g} %, {needed} are needed"
    elif radius <= 0.0:
        reason = "the footprint of the robot is unknown"
    if reason:
        return DrivenTube(None, 0.0, [unknown(name, unit, reason, count) for name, unit in names])
    scores = np.array([float(displacement(cross, yaw, radius)) for cross, yaw in deviations])
    width = float(np.sort(scores)[rank - 1])
    cross, yaw = np.median(np.array(deviations), axis=0).tolist()
    share = cross / max(cross + 2.0 * radius * math.sin(0.5 * yaw), 1e-9)
    tube = TrackingTube(share * width, 2.0 * math.asin(min((1.0 - share) * width / (2.0 * radius), 1.0)))
    found = [
        Quantity(name, unit, value, 0.0, value, count, count)
        for (name, unit), value in zip(names, (tube.cross, tube.yaw), strict=True)
    ]
    return DrivenTube(tube, rank / (count + 1), found)
