"""Whether a robot follows its reference, and comes nearer to what is accepted at the end."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from optdock.controllers.finish import Patience
from optdock.errors import NoValidControl

if TYPE_CHECKING:
    from optdock.controllers.finish import Accepted
    from optdock.controllers.tracking_parameters import TrackingControllerParameters
    from optdock.geometry.pose import Pose2

__all__ = ["ProgressCheck"]


class ProgressCheck:
    """The checks of one attempt."""

    def __init__(self) -> None:
        self._following, self._arriving = Patience(), Patience()

    def check_error(self, p: TrackingControllerParameters, error: Pose2) -> None:
        """Refuse to drive a robot that is too far from its reference.

        Raises:
            NoValidControl: It is.
        """
        distance = math.hypot(error.x, error.y)
        if distance > p.max_error or abs(error.yaw) > p.max_yaw_error:
            raise NoValidControl(
                f"TrackingController: {distance:.3f} m and {abs(error.yaw):.3f} rad from the reference, more than "
                f"max_error = {p.max_error} m or max_yaw_error = {p.max_yaw_error} rad; plan again from here",
                where={"along": error.x, "cross": error.y, "yaw": error.yaw},
            )

    def check_progress(
        self,
        p: TrackingControllerParameters,
        error: Pose2,
        accepted: Accepted,
        period: float,
        *,
        is_held: bool,
        is_finishing: bool,
    ) -> None:
        """Refuse to stand for ever: a robot that does not follow, or that cannot reach what is accepted.

        Args:
            p: Parameters of the controller.
            error: The robot in the frame of the reference.
            accepted: At the end.
            period: Since the last call [s].
            is_held: Whether the reference waits for the robot.
            is_finishing: Whether the reference has come to its end.

        Raises:
            NoValidControl: As described.
        """
        where = {"along": error.x, "cross": error.y, "yaw": error.yaw}
        if self._following.lost(2.0 if is_held else 0.0, period, p.patience):
            raise NoValidControl(
                f"TrackingController: the robot does not follow: for {p.patience:g} s the reference has waited for it, "
                f"{abs(error.x):.3f} m ahead; it is blocked, or its drive does not answer",
                where=where,
            )
        left = accepted.shortfall(error) if is_finishing else 0.0
        if self._arriving.lost(left, period, p.patience):
            raise NoValidControl(
                f"TrackingController: cannot come any nearer: {error.x:.3f} m along, {error.y:.3f} m across and "
                f"{error.yaw:.3f} rad are left, accepted are {accepted.along:g} m, {accepted.cross:g} m and "
                f"{accepted.yaw:g} rad, and nothing has become better for {p.patience:g} s; plan again from here",
                where=where,
            )
