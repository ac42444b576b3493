"""How wide the tube must be: split conformal prediction over dockings that were driven again."""

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
    """A tube that holds with a probability.

    Attributes:
        tube: How wide; None: there are too few dockings for the coverage asked for.
        coverage: The probability that another docking stays inside, at least [1].
        quantities: Its two widths and their sum at the farthest point of the footprint.
    """

    tube: TrackingTube | None
    coverage: float
    quantities: list[Quantity]


def conformal_rank(count: int, coverage: float) -> int:
    """Which of `count` scores, counted from the smallest as 1, bounds another one with a probability; above: none does.

    Another score is as likely to have any rank among all count + 1, so that it is at most the k-th one with a
    probability of k / (count + 1) or more ([Vovk2005]).
    """
    return math.ceil(coverage * (count + 1) - 1e-9)


def conformal_tube(deviations: Sequence[tuple[float, float]], radius: float, coverage: float) -> DrivenTube:
    """The tube that the next docking stays in with a probability.

    What counts of a docking is by how far a point of the footprint can have been off at most; as the width of the tube
    is all that a certificate knows of it, how this is shared between `cross` and `yaw` is free: as their medians are.

    Args:
        deviations: Of each docking: the largest distance across the path [m], the largest turn off it [rad].
        radius: Circumscribed radius of the footprint [m]; 0: not known.
        coverage: The probability asked for.

    Returns:
        The tube; None in its place with the reason in its quantities where dockings are too few for the coverage or the
        footprint is not known.
    """
    names = ("tube, cross", "m"), ("tube, yaw", "rad")
    count = len(deviations)
    rank, reason = conformal_rank(count, coverage), ""
    if rank > count:
        needed = math.ceil(coverage / (1.0 - coverage) - 1e-9)
        reason = f"there are {count} whole dockings; to tell of {100 * coverage:g} %, {needed} are needed"
    elif radius <= 0.0:
        reason = "the outline of the robot is not known"
    if reason:
        return DrivenTube(None, 0.0, [unknown(name, unit, reason, count) for name, unit in names])
    rows = np.array(deviations)
    scores = np.array([float(displacement(cross, yaw, radius)) for cross, yaw in deviations])
    width = float(np.sort(scores)[rank - 1])
    cross, yaw = np.median(rows, axis=0).tolist()
    share = cross / max(cross + 2.0 * radius * math.sin(0.5 * yaw), 1e-9)
    tube = TrackingTube(share * width, 2.0 * math.asin(min((1.0 - share) * width / (2.0 * radius), 1.0)))
    found = [
        Quantity(name, unit, value, 0.0, value, count, count)
        for (name, unit), value in zip(names, (tube.cross, tube.yaw), strict=True)
    ]
    return DrivenTube(tube, rank / (count + 1), found)
