"""How far a wheeled robot can still move sideways before the dock, and what of an error will be left there."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from optdock.controllers.tracking_law import left_after

if TYPE_CHECKING:
    from optdock.model.limits import MotionLimits
    from optdock.model.problem import DockingProblem

__all__ = ["DECAY", "SHORTEST_DECAY", "can_be_planned_away", "left_at_dock", "reachable_offset", "staging_distance"]

# [m]: over which lateral errors decay, the TrackingController's convergence_distance; and the shortest to which it goes
# before the dock, at 0.1 m/s in a drive that is 0.25 s late.
DECAY, SHORTEST_DECAY = 0.25, 0.08
_LEAST_STAGING = 0.7  # [m], Nav2's staging_x_offset
_STORED_OFFSET = 0.15  # [m] to the side that the approach must be able to correct: 10 cm, and 5 degrees over 0.6 m


def reachable_offset(distance: float, limits: MotionLimits) -> float:
    """How far to the side a forward path can end that begins and ends in one direction, over this distance [m].

    Four equal pieces with the curvature rising and falling at its largest rate c give c d^3 / 32; two arcs of the
    largest curvature k, one left and one right, k d^2 / 4. No path of the limits does better than either.
    """
    free = max(0.0, distance)
    if free == 0.0:
        return 0.0
    arcs = 0.25 * limits.max_curvature * free**2
    ramps = limits.max_curvature_rate * free**3 / 32.0
    return min(arcs, ramps)


def can_be_planned_away(offset: float, turn: float, distance: float, gear: float, limits: MotionLimits) -> bool:
    """Whether a path of half the largest curvature and curvature rate takes an error back over a distance.

    Half, because the path begins with the curvature that the robot has.

    Args:
        offset: To the left of the path [m].
        turn: Of the heading, to the left [rad].
        distance: Left to drive before the final straight [m].
        gear: 1 forward, -1 in reverse.
        limits: Of the robot.
    """
    if distance <= 0.0:
        return False
    # One arc to the side takes a turn back, and moves the robot by half of what it would have drifted.
    beside = abs(offset + 0.5 * gear * math.sin(turn) * distance)
    turned = min(limits.max_curvature * distance, 0.25 * limits.max_curvature_rate * distance**2)
    return beside <= 0.5 * reachable_offset(distance, limits) and abs(turn) <= 0.5 * turned


def left_at_dock(offset: float, turn: float, distance: float, gear: float, decay: float) -> tuple[float, float]:
    """What feedback leaves of an error at the dock: offset [m] and turn [rad], see `left_after`.

    Args:
        offset: To the left of the path now [m].
        turn: Of the heading, to the left [rad].
        distance: Left to drive [m].
        gear: 1 forward, -1 in reverse.
        decay: Distance over which the feedback lets errors decay [m].
    """
    beside, slope = left_after(max(0.0, distance), offset, gear * turn, decay)
    return beside, gear * slope


def staging_distance(problem: DockingProblem) -> float:
    """How far before the docked pose an approach should begin so that it can correct a dock that is stored wrongly [m].

    At least Nav2's 0.7 m; else what an offset of 15 cm needs, half of it the robot's own, and the final straight.
    """
    needed = _LEAST_STAGING
    limits = problem.robot.limits
    while reachable_offset(needed - problem.dock.final_straight, limits) < _STORED_OFFSET and needed < _MOST_STAGING:
        needed += 0.05
    return needed


_MOST_STAGING = 3.0  # [m]: beyond it no room is that large, and a robot so stiff must turn elsewhere
