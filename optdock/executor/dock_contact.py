"""Actions at the dock: detection at rest, confirmation, pressing, backing out, and correction of small errors.

The motions in this module are short and not planned; they are straight lines or turns in place. Backing out and small
corrections are checked against the obstacles by time of impact; pressing on towards contact is not checked.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from optdock.executor.control_cycles import REST_PATIENCE, STOP
from optdock.executor.dock_estimate import LAST_LOOK, NO_ROOM
from optdock.executor.task_states import NOT_DOCKED, AttemptFailed, EndingKind, Interrupted, State, TaskFailed
from optdock.geometry.pose import Twist2
from optdock.model.constant_jerk import braking_time
from optdock.model.robot import Drive
from optdock.verification import pose_clearance
from optdock.verification.time_of_impact import free_motion

if TYPE_CHECKING:
    from collections.abc import Generator

    from optdock.executor.control_cycles import ControlCycles, Cycles, Target
    from optdock.geometry.arrays import FloatArray

__all__ = ["Nudge", "back_out", "confirm", "has_arrived", "perceive", "press", "stands_docked", "wait_for_detection"]

_INSTANT = 1e-9  # [s], and as a negligible share [1]

# Detections at rest.
# [s] to wait for a detection in the dock: at 10 Hz with half of the detections lost, one wait in 1000 takes longer.
_CONFIRMATION = 1.0
_HIDDEN_FOR = 2.5  # [s] for a person to walk out of the camera's view of a dock that was detected from close by
# Margins to the tolerances, in standard deviations: after a detection from the present place, and after a detection
# from an earlier place.
_SURE_SEEN, _SURE_UNSEEN = 2.0, 1.0
_UNSURE_WAY = 0.04  # [m] within which two detections are required, because a single wrong one may be accepted
_UNSEEN_WAY = 0.015  # [m]: over a shorter distance, wheel slip does not turn a robot by a degree

# Contact and backing out.
_CLEAR_OF_CONTACT = 0.005  # [m] of clearance from which a path is planned; with less, noise may look like overlap
_BACK_OUT_HORIZON = 0.5  # [s] over which backing out must be free of collisions
_CREEP = 1e-6  # [m/s]: does not move the robot, but steers the wheels to the commanded curvature

# Nudging.
_ALIGNED, _NOISE = 0.3, 1.0  # share of the tolerance, standard deviations: smaller heading errors are not corrected
_SHORT = 0.5  # share of the tolerance: most robots that wrongly counted as docked had an estimated distance above it
_CROSS_SHARE = 0.4  # share of the tolerance: another approach is better for a larger lateral error
_LARGEST_TURN = 0.1  # [rad] at a dock: the corners of a usual robot then move by 3 cm
_WHEELS_WITHIN = 0.9  # of the radius of the inscribed circle, for a robot without a track width
# [m/s] of a wheel: half a millimetre in a period at 20 Hz, and above the dead bands of usual drives.
_SLOWEST_NUDGE, _FASTEST_NUDGE = 0.012, 0.12
_MOST_NUDGES = 10  # each one improves the estimate of the motion lost in the dead bands
_LEAST_FREE = 0.3  # share of a nudge that must be free of collisions
_DEAD_BAND = 0.004  # [m] missing from a nudge: with more, a dead band is assumed
_MOST_LEFT_OUT = 0.05  # [m]: largest compensation of a dead band
_ANSWER = 0.3  # [s] in which drive and odometry respond to the last command


def stands_docked(cycles: ControlCycles) -> Generator[Target, None, bool]:
    """Whether the robot is docked before the task begins, for docks without a required signal."""
    situation, settings, estimate = cycles.situation, cycles.situation.settings, cycles.situation.estimate
    needs_signal = situation.dock_type.is_pressed_on or situation.dock_type.waits_for_charge
    if needs_signal or not estimate.is_near:
        return False
    cycles.state, since = State.PERCEIVING, cycles.now
    while settings.use_detections and not estimate.is_known:
        if cycles.now - since >= _CONFIRMATION:
            return False
        yield from cycles.cycle(STOP)
    return estimate.will_know(0.0) and estimate.is_within_tolerances(0.0) and not estimate.may_have_turned


def perceive(cycles: ControlCycles) -> Cycles:
    """Wait at rest until the dock has been detected often enough.

    Raises:
        TaskFailed: If the dock is not detected often enough within the timeout.
    """
    settings, detections = cycles.situation.settings, cycles.situation.perception.detections
    if not settings.use_detections or cycles.situation.estimate.is_found:
        return
    cycles.state = State.PERCEIVING
    since, before = cycles.now, detections.count
    most = f"max_detection_offset is {settings.max_detection_offset:.3f} m"
    while detections.count - before < settings.least_detections:
        if cycles.now - since > settings.initial_perception_timeout:
            found, far = detections.count - before, detections.too_far
            raise TaskFailed(
                EndingKind.FAILED_TO_DETECT_DOCK,
                f"{found} detections in {cycles.now - since:.1f} s, at least {settings.least_detections} are required; "
                f"{detections.rejected} were rejected so far"
                + (f"; the last one was {far:.3f} m from the stored dock, {most}" if far else ""),
            )
        yield from cycles.cycle(STOP)


def wait_for_detection(cycles: ControlCycles) -> Cycles:
    """Wait at rest for detections if the last detection is too old.

    Raises:
        AttemptFailed: If the dock is not detected within the timeout.
    """
    situation, perception, settings = cycles.situation, cycles.situation.perception, cycles.situation.settings
    is_needed = situation.estimate.detection_is_old
    if not settings.use_detections or not (is_needed or situation.estimate.is_hidden):
        return
    since, before, cycles.state = cycles.now, perception.detections.count, State.WAITING_FOR_DETECTION
    while perception.detections.count - before < (settings.least_detections if is_needed else 1):
        if cycles.now - since > settings.initial_perception_timeout:
            reason = f"the dock has not been detected for {perception.detection_age:.1f} s"
            raise AttemptFailed(EndingKind.FAILED_TO_DETECT_DOCK, reason)
        if not (is_needed or situation.estimate.is_hidden):
            return
        yield from cycles.cycle(STOP)


def confirm(cycles: ControlCycles) -> Cycles:
    """Confirm at rest that the robot is docked; wheel slip over the last centimetres shows only in detections.

    Raises:
        Interrupted: If the robot is outside of the tolerances.
        AttemptFailed: If the pose at the dock is unknown.
    """
    situation, since = cycles.situation, cycles.now
    detections, estimate = situation.perception.detections, situation.estimate
    if situation.settings.use_detections:
        while (
            detections.moved_since_seen() > _UNSEEN_WAY
            or detections.moved_since_seen(2) > _UNSURE_WAY
            or estimate.is_in_doubt
        ):
            patience = _HIDDEN_FOR if estimate.sees_from_near else _CONFIRMATION
            if estimate.may_have_turned:
                patience = situation.settings.initial_perception_timeout
            if cycles.now - since >= patience:
                break
            yield from cycles.cycle(STOP)
    _require_certainty(cycles)
    is_seen = detections.moved_since_seen() <= _UNSEEN_WAY
    if not estimate.is_within_tolerances(_SURE_SEEN if is_seen else _SURE_UNSEEN):
        raise Interrupted(NOT_DOCKED, estimate.where)


def has_arrived(cycles: ControlCycles) -> Generator[Target, None, bool]:
    """Whether a robot that was stopped on its way into the dock has reached it anyway, for instance by momentum."""
    situation = cycles.situation
    if situation.dock_type.is_pressed_on or situation.is_held:
        return False
    if not (situation.estimate.will_know(0.0) and situation.estimate.is_within_tolerances(_SURE_SEEN)):
        return False
    try:
        yield from confirm(cycles)
    except (Interrupted, AttemptFailed):
        return False
    return True


def _require_certainty(cycles: ControlCycles) -> None:
    """Raise AttemptFailed if the pose at the dock is too uncertain."""
    situation, perception = cycles.situation, cycles.situation.perception
    kind, unknown = EndingKind.FAILED_TO_DETECT_DOCK, "docking cannot be confirmed"
    if perception.detections.is_contradicted:
        raise AttemptFailed(kind, "the last detections contradict the estimated pose of the dock")
    if situation.estimate.may_have_turned:
        raise AttemptFailed(
            kind,
            f"{unknown}: the localization has turned by {perception.unseen_turn:.3f} rad against the odometry, and "
            f"the dock has not been detected since",
        )
    if not situation.estimate.will_know(0.0):
        along, cross, yaw = perception.sigma_after(0.0)
        raise AttemptFailed(
            kind,
            f"{unknown}: not detected for {perception.detection_age:.1f} s, standard deviations {along:.4f} m "
            f"along, {cross:.4f} m across, {yaw:.4f} rad",
        )


def press(cycles: ControlCycles) -> Generator[Target, None, EndingKind]:
    """Drive slowly along the axis of the dock until there is contact at rest.

    Raises:
        Interrupted: If the motion cannot continue.
        AttemptFailed: If there is no contact.
    """
    situation, settings = cycles.situation, cycles.situation.settings
    cycles.state = State.PRESSING
    gear, speed = situation.estimate.gear, settings.contact_speed
    allowed = settings.contact_overrun + abs(situation.perception.robot_from_dock.x)
    until = cycles.now + REST_PATIENCE + 2.0 * allowed / speed
    while True:
        situation.require_no_interruption()
        kind = situation.contact()
        if kind is not None:
            yield from cycles.stop()
            if kind is not EndingKind.DOCKED_BY_SIGNAL or situation.has_signal:
                return kind
        beyond = gear * situation.perception.robot_from_dock.x
        if beyond > settings.contact_overrun or cycles.now > until:
            raise AttemptFailed(EndingKind.FAILED_TO_CONTROL, f"no contact: {situation.estimate.where}")
        yield from cycles.cycle(Twist2(gear * speed))


def back_out(cycles: ControlCycles, least: float = 0.0) -> Cycles:
    """Drive straight out of contact until a path can be planned; stop before penetrating any obstacle further.

    Args:
        cycles: Cycles of the task.
        least: Least distance to drive, if it is free of obstacles [m].
    """
    situation = cycles.situation
    direction, footprint = -situation.estimate.gear, situation.problem.robot.footprint
    begun_at, begun, is_straight = situation.perception.way, cycles.now, False
    speed = situation.settings.back_out_speed
    braking = 0.5 * speed * situation.braking_time_from(speed)
    farthest = max(least, situation.dock_type.back_out_distance)
    limit = 2.0 * farthest / speed + REST_PATIENCE
    while True:
        yield from cycles.locate()
        robot = situation.perception.robot
        driven = situation.perception.way - begun_at  # the estimated dock may move meanwhile
        near = situation.scene.near(robot, footprint.circumscribed_radius + _CLEAR_OF_CONTACT)
        if driven >= least - braking and pose_clearance(robot, footprint, near)[0] >= _CLEAR_OF_CONTACT:
            break
        cycles.state = State.BACKING_OUT
        if driven >= farthest - braking or cycles.now - begun > limit:
            break
        twist = Twist2(direction * speed)
        # Errors of the estimates, compliant bumpers and late commands may all appear as overlap.
        overlap = situation.estimate.reach_of_contact
        if free_motion(footprint, near, robot, twist, _BACK_OUT_HORIZON, overlap=overlap).free < _BACK_OUT_HORIZON:
            cycles.report("backing out is blocked", f"after {driven:.3f} m")
            break
        if not is_straight:  # steer the wheels of a car straight, from any angle
            straight_at = cycles.now + situation.problem.robot.limits.steering_time_to(0.0)
            while cycles.now < straight_at - _INSTANT:
                yield from cycles.cycle(Twist2(direction * _CREEP))
            begun, is_straight = cycles.now, True
            continue
        yield from cycles.cycle(twist)
    yield from cycles.stop()


class Nudge:
    """Short motions at the dock that correct the remaining error and compensate the dead bands of the wheels."""

    def __init__(self, cycles: ControlCycles) -> None:
        self._cycles, robot = cycles, cycles.situation.problem.robot
        width = robot.limits.track_width
        self._lever = 0.5 * width if width > 0.0 else _WHEELS_WITHIN * robot.footprint.inscribed_radius  # [m]
        self._left_out: FloatArray = np.zeros(2)  # lost in the dead bands of the left and the right wheel [m]

    def _rims(self, linear: float, angular: float) -> tuple[float, float]:
        """Return the distances [m] or speeds [m/s] of the left and the right wheel."""
        return linear - self._lever * angular, linear + self._lever * angular

    def _body_motion(self, left: float, right: float) -> Twist2:
        """Return the motion of the robot for distances or speeds of the wheels; the inverse of `_rims`."""
        return Twist2(0.5 * (left + right), 0.5 * (right - left) / self._lever)

    @property
    def missing(self) -> Twist2:
        """Correction of distance [m] and heading [rad] to the docked pose, or zero if a nudge cannot correct the error.

        A lateral error cannot be corrected.
        """
        situation, estimate = self._cycles.situation, self._cycles.situation.estimate
        if situation.problem.robot.drive is not Drive.DIFFERENTIAL or situation.dock_type.is_pressed_on:
            return Twist2()
        (along, _, most_along), (across, _, most_across), (yaw, sigma, most) = estimate.errors()
        is_off_axis = abs(across) > _CROSS_SHARE * most_across and not estimate.is_within_tolerances(0.0)
        if is_off_axis or estimate.left > LAST_LOOK or abs(yaw) > _LARGEST_TURN:
            return Twist2()
        is_short = _SHORT * most_along < estimate.gear * -along <= NO_ROOM
        is_turned = abs(yaw) > max(_ALIGNED * most, _NOISE * sigma)
        return Twist2(-along if is_short else 0.0, -yaw if is_turned else 0.0)

    def run(self) -> Generator[Target, None, bool]:
        """Correct the remaining error from rest; return whether the robot was moved."""
        missing = self.missing
        for number in range(_MOST_NUDGES):
            if not (yield from self._once()):
                return number > 0
            if number == 0:
                self._cycles.report("nudged", f"by {missing.linear:.4f} m and {missing.angular:.4f} rad")
        return True

    def _once(self) -> Generator[Target, None, bool]:
        """Make one motion of `run`; return False if no motion is needed or possible.

        The distance lost in the dead band of a wheel is added to the next motion. If the drive has dead bands, one
        wheel moves at a time. If both were commanded together, the wheel with the smaller dead band might move alone
        and turn the robot.
        """
        situation, perception = self._cycles.situation, self._cycles.situation.perception
        footprint = situation.problem.robot.footprint
        missing, robot = self.missing, perception.robot
        has_dead_band = float(self._left_out.max()) > _DEAD_BAND
        if missing == Twist2() or (has_dead_band and situation.estimate.is_within_tolerances(_SURE_SEEN)):
            return False
        # The heading is corrected first, so that the distance is then driven straight and each motion has separate
        # limits.
        way = 0.0 if missing.angular and not has_dead_band else missing.linear
        left, right = self._rims(way, missing.angular)
        if has_dead_band:
            left, right = (left, 0.0) if abs(left) > abs(right) else (0.0, right)
        motion = self._body_motion(left, right)
        reach = footprint.circumscribed_radius + abs(motion.linear) + _MOST_LEFT_OUT
        everything, others = situation.scene.near(robot, reach), situation.scene.near(robot, reach, with_station=False)
        free = free_motion(footprint, everything, robot, motion, 1.0, overlap=situation.estimate.reach_of_contact).free
        ways = np.array([free * left, free * right])
        commanded = self._body_motion(*(ways + np.sign(ways) * self._left_out).tolist())
        # If the assumed dead band does not exist, the robot may press against its station, but not against other
        # obstacles.
        if free < _LEAST_FREE or free_motion(footprint, others, robot, commanded, 1.0).free < 1.0:
            return False
        before = np.array(self._rims(perception.forward, perception.turned))
        try:
            yield from self._roll(commanded)
        except Interrupted as stopped:
            yield from self._cycles.stop_after(stopped)
            return False
        moved = np.array(self._rims(perception.forward, perception.turned)) - before
        self._left_out = np.clip(self._left_out + np.sign(ways) * (ways - moved), 0.0, _MOST_LEFT_OUT)
        return True

    def _roll(self, motion: Twist2) -> Cycles:
        """Command a distance [m] and a rotation [rad] from rest, and wait for the drive to respond.

        The end of the motion is determined by integrating the commands, so it does not depend on the delay of the
        drive.

        Raises:
            Interrupted: If the motion cannot continue.
        """
        situation, limits = self._cycles.situation, self._cycles.situation.problem.robot.limits
        way = max(map(abs, self._rims(motion.linear, motion.angular)))  # of the faster wheel
        straight = limits.max_speed, min(limits.max_acceleration, limits.max_deceleration), limits.max_jerk
        turning = limits.turning.rate, limits.turning.acceleration, math.inf  # the jerk of a rotation is not limited
        shares = max(abs(motion.linear) / way, _INSTANT), max(abs(motion.angular) / way, _INSTANT)
        highest, acceleration, jerk = (
            min(s / shares[0], t / shares[1]) for s, t in zip(straight, turning, strict=True)
        )
        fastest, rolled, was_felt = min(_FASTEST_NUDGE, highest), 0.0, False
        while True:
            situation.require_no_interruption()
            is_felt = situation.contact() is not None and motion.linear * situation.estimate.gear > _INSTANT
            if is_felt and was_felt:  # two cycles, because a switch may flicker before contact
                break
            was_felt = is_felt
            speed = max(map(abs, self._rims(situation.commanded.linear, situation.commanded.angular)))
            rolled += speed * self._cycles.period
            left = way - rolled - 0.5 * speed * braking_time(speed, acceleration, jerk)
            if left <= 0.0:
                break
            rate = min(max(0.5 * left / max(self._cycles.period, _INSTANT), _SLOWEST_NUDGE), fastest) / way
            yield from self._cycles.cycle(Twist2(rate * motion.linear, rate * motion.angular))
        since = self._cycles.now
        while self._cycles.now - since < _ANSWER:
            yield from self._cycles.cycle(STOP)
        yield from self._cycles.stop()
