"""How fast the clock of the reference runs: slower under a speed limit, in sharp bends, and for a robot that lags."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from optdock.controllers.moving_reference import peaks
from optdock.model.robot import Drive

if TYPE_CHECKING:
    from optdock.controllers.moving_reference import TrajectoryReference
    from optdock.controllers.tracking_parameters import TrackingControllerParameters
    from optdock.model.limits import MotionLimits
    from optdock.model.trajectory import Trajectory

__all__ = ["ReferenceRate", "waiting_rate"]

_STEERED_RATE = 0.99  # of steered wheels: leaves feedback 3 % of the jerk and 1 % of the steering rate


class ReferenceRate:
    """The rate that the reference is to run at.

    Attributes:
        speed_limit: A speed [m/s], or percent of the planned one where the second is True; None: there is none.
    """

    def __init__(self) -> None:
        self.speed_limit: tuple[float, bool] | None = None

    def target(
        self,
        p: TrackingControllerParameters,
        reference: TrajectoryReference,
        lag: float,
        limits: MotionLimits,
        drive: Drive,
    ) -> float:
        """The rate for a robot that is so far behind its reference [m]."""
        most = min(self._allowed(reference.trajectory), _rate_of_turns(p, reference, limits, drive))
        return waiting_rate(p, lag) * most

    def _allowed(self, trajectory: Trajectory) -> float:
        if self.speed_limit is None:
            return 1.0
        limit, percentage = self.speed_limit
        return min(1.0, limit / 100.0 if percentage else limit / max(peaks(trajectory)[0], 1e-9))


def _rate_of_turns(
    p: TrackingControllerParameters, reference: TrajectoryReference, limits: MotionLimits, drive: Drive
) -> float:
    """The rate at which the reference leaves feedback its reserve: yaw accelerations grow with its square [1]."""
    most = _STEERED_RATE if drive is Drive.ACKERMANN else 1.0
    kept = (1.0 - p.turn_reserve) * limits.max_yaw_acceleration
    if math.isinf(kept):
        return most
    planned = reference.peak_yaw_acceleration()
    return min(most, math.sqrt(kept / planned)) if planned > 0.0 else most


def waiting_rate(p: TrackingControllerParameters, lag: float) -> float:
    """The rate of a reference that waits for a robot that lags [1]."""
    return min(1.0, max(0.0, (p.stop_lag - lag) / max(1e-9, p.stop_lag - p.slow_down_lag)))
