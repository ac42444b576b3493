"""Gains of the feedback law: as given, lower for a late drive, and higher where an error would be left at the end."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from optdock.controllers.tracking_law import Gains, delay_bounds, left_after
from optdock.geometry.pose import Pose2, Twist2

if TYPE_CHECKING:
    from optdock.controllers.control_clock import ControlClock
    from optdock.controllers.finish import Accepted
    from optdock.controllers.moving_reference import ReferenceState
    from optdock.controllers.tracking_parameters import TrackingControllerParameters

__all__ = ["CREEPING", "FeedbackGains"]

CREEPING = 1e-3  # [m/s]: a reference slower than this tells no curvature
_SHORTEST_CONVERGENCE = 0.05  # [m]
_QUICKEST_TURN = 4.0  # [1/s], of the heading alone before the end, where the delay allows it
_AT_END = 0.78  # of what the delay asks for, where too much would be left: a phase margin of 37 degrees, once
_ERROR_SMOOTHING = 0.2  # [s], of the errors across and of the heading: more hides a jump from what is left of the way
_SCATTER_SMOOTHING = 1.0  # [s], of its squared noise
_GROWTH, _LEAST_SCATTER = 4.0, 4e-6  # [1], [m^2] or [rad^2]: what a single error may add to that
_NOISES = 3.0  # standard deviations
# [m] before the end, with no rest between: farther off an error decays anyway, and in the bends of a manoeuvre, at the
# robot's limits, nothing is left for higher gains.
_NEAR_END, _NOTHING_LEFT = 0.5, 1e-6
_LEFT = 0.25  # of the accepted errors across and of the heading, that may be left at the end by what is seen now


class FeedbackGains:
    """The gains for one attempt, and the noise of the measured poses that they depend on.

    Attributes:
        scatter: Variance of a measured pose across the robot [m^2].
    """

    def __init__(self) -> None:
        self._aside = self._askew = self.scatter = self._yaw_scatter = 0.0
        self._pose_before: tuple[Pose2, Twist2] | None = None

    def learn_noise(self, pose: Pose2, velocity: Twist2, clock: ControlClock) -> None:
        """Take in how much poses scatter across, beyond what odometry says the robot has moved.

        Two poses have twice the variance of one.
        """
        period, before = clock.elapsed, self._pose_before
        self._pose_before = (pose, velocity)
        if before is None or clock.silent:
            return
        last, speed = before
        driven = Twist2(0.5 * (speed.linear + velocity.linear), 0.5 * (speed.angular + velocity.angular))
        off, share = last.moved(driven, period).in_frame_of(pose), min(1.0, period / _SCATTER_SMOOTHING)
        most = _GROWTH * self.scatter + _LEAST_SCATTER  # a jump is not noise
        self.scatter += share * (min(0.5 * off.y * off.y, most) - self.scatter)
        most = _GROWTH * self._yaw_scatter + _LEAST_SCATTER
        self._yaw_scatter += share * (min(0.5 * off.yaw * off.yaw, most) - self._yaw_scatter)

    def at(  # noqa: PLR0913 - what they depend on
        self,
        p: TrackingControllerParameters,
        now: ReferenceState,
        error: Pose2,
        accepted: Accepted,
        clock: ControlClock,
        *,
        delay: float,
        finished: bool,
    ) -> Gains:
        """As the parameters say, as far as the drive's delay allows; where too much would be left at the end, others.

        What counts are the errors across and of the heading in units of what is accepted, smoothed and beyond their own
        noise, which higher gains would amplify. An error across is taken back by turning the robot: where too little of
        the way is left for turning it back, the heading is taken back and the error across is left.

        Args:
            p: Parameters of the controller.
            now: The reference.
            error: The robot in its frame.
            accepted: At the end.
            clock: Of the calls.
            delay: Of the drive [s].
            finished: Whether the reference has come to its end.
        """
        ahead = now.ahead
        bounds = delay_bounds(ahead.twist.linear, delay + 0.5 * clock.period, p.damping)
        share = min(1.0, clock.elapsed / _ERROR_SMOOTHING)
        self._aside += share * (error.y - self._aside)
        self._askew += share * (error.yaw - self._askew)
        smoothed = math.sqrt(share / (2.0 - share))
        aside = self._aside if abs(self._aside) > _NOISES * smoothed * math.sqrt(self.scatter) else 0.0
        askew = self._askew if abs(self._askew) > _NOISES * smoothed * math.sqrt(self._yaw_scatter) else 0.0
        slope, speed = now.gear * askew, max(abs(ahead.twist.linear), CREEPING)

        def left_with(distance: float, turn: float) -> float:
            pull = max(turn / speed, 2.0 * p.damping / distance)
            across, turned = left_after(ahead.left, aside, slope, distance, pull)
            return max(abs(across) / accepted.cross, abs(turned) / accepted.yaw)

        turns = min(p.turn_gain, bounds.rate), min(_QUICKEST_TURN, bounds.rate)
        usual = max(p.convergence_distance, bounds.distance)
        least = min(max(_SHORTEST_CONVERGENCE, _AT_END * bounds.distance), usual)
        best, is_near = (usual, turns[0]), ahead.left <= min(_NEAR_END, ahead.to_rest + _NOTHING_LEFT)
        if finished and abs(askew) > _LEFT * accepted.yaw:
            best = usual, turns[1]
        elif is_near and (least_left := left_with(*best)) > _LEFT:
            distance = usual
            while distance > least:
                for turn in turns:
                    if (found := left_with(distance, turn)) < least_left:
                        best, least_left = (distance, turn), found
                distance *= 0.85
        return Gains(min(p.along_gain, bounds.rate), best[0], p.damping, best[1])
