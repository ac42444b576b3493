"""Braking along a path to a rest."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from optdock.geometry.clothoid import ClothoidSpline
from optdock.model.limits import SpeedZone
from optdock.model.path import Path
from optdock.model.segments import SAME_POSITION, TURN_RADIUS, ClothoidSegment
from optdock.model.trajectory import TimeLaw, Trajectory
from optdock.planning.running_drive import NO_WAY
from optdock.timing.jerk_phases import DriveBounds, MotionState
from optdock.timing.start_states import full_stop
from optdock.verification import TOLERANCE, certify_trajectory

if TYPE_CHECKING:
    from optdock.geometry.pose import Pose2
    from optdock.model.limits import MotionLimits
    from optdock.planning.running_drive import BranchPoint
    from optdock.verification import TrajectoryCertificate

__all__ = ["braking"]

# Shares of the deceleration that a stop tries: in a bend the yaw acceleration may leave no more.
_BRAKING = (1.0, 0.8, 0.6, 0.4, 0.25)
_STILL = 0.1  # [s]: how long the motion of a robot lasts that stands


def braking(joint: BranchPoint, limits: MotionLimits, frame: str) -> tuple[Trajectory, TrajectoryCertificate]:
    """The quickest certified braking from a place of a trajectory, or the quickest of all.

    Args:
        joint: Where the robot begins to brake.
        limits: Of the robot.
        frame: That of the path.

    Returns:
        What to drive, and the certificate of its motion, which may refuse it.
    """
    state = MotionState(0.0, abs(joint.speed), joint.acceleration * (joint.gear or 1))
    still = Trajectory(_standing(joint.pose, frame), TimeLaw(np.array([_STILL]), np.zeros(1)))
    if joint.rest is None or joint.rests:
        return still, certify_trajectory(still, limits, SpeedZone())
    first = None
    for share in _BRAKING:
        if joint.gear == 0:
            rate, most, jerk = (TURN_RADIUS * limit for limit in limits.turning)
            bounds = DriveBounds(rate, most, share * most, jerk)
        else:
            most = share * limits.max_deceleration
            bounds = DriveBounds(limits.max_speed, limits.max_acceleration, most, limits.max_jerk)
        phases = np.array(full_stop(state, bounds))
        if state.a < 0.0 < state.v and state.a**2 > 2.0 * state.v * bounds.jerk:
            jerk = state.a**2 / (2.0 * state.v)  # with less it would roll back; with this both end together
            phases = np.array([[-state.a / jerk, jerk]])
        law = TimeLaw(phases[:, 0], phases[:, 1], 0.0, state.v, state.a)
        length = float(law.states[-1, 0])
        segment = joint.rest.segments[0]
        if length <= SAME_POSITION:  # it would roll back, or has as good as stopped; a jump is not certified
            motion = certify_trajectory(still, limits, SpeedZone(), start_speed=state.v, start_acceleration=state.a)
            return still, motion
        if length > segment.length - NO_WAY:  # it comes to rest at the cusp by itself
            length = segment.length
        trajectory = Trajectory(joint.rest.piece(0.0, length), law)
        motion = certify_trajectory(trajectory, limits, SpeedZone())
        first = first or (trajectory, motion)
        if motion.certified:
            return trajectory, motion
    assert first is not None
    return first


def _standing(pose: Pose2, frame: str) -> Path:
    """A path for a robot that stays: a tenth of what the certificate takes for nothing."""
    return Path((ClothoidSegment(ClothoidSpline(pose, np.array([0.0, 0.1 * TOLERANCE]), np.zeros(2))),), frame)
