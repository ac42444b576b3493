"""Straight motions along the axis of the dock that no plan covers: pressed against the contacts, and out of them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from optdock.executor.control_cycles import REST_PATIENCE
from optdock.executor.interruptions import AttemptFailed
from optdock.executor.task_states import EndingKind, State
from optdock.geometry.pose import Twist2
from optdock.verification import pose_clearance
from optdock.verification.time_of_impact import free_motion

if TYPE_CHECKING:
    from collections.abc import Generator

    from optdock.executor.control_cycles import ControlCycles, Cycles, Wish

__all__ = ["back_out", "press"]

_CLEAR_OF_CONTACT = 0.005  # [m]: a way back is planned from there; nearer, noise could make an overlap of it
_BACK_OUT_SPEED = 0.1  # [m/s]: more than the dead band of either wheel, or the robot turns in contact
_BACK_OUT_LOOK = 0.5  # [s] ahead, of straight motions that no plan covers
_CREEP = 1e-6  # [m/s]: no drive moves at it; steered wheels turn as its arc says
_INSTANT = 1e-9  # [s]


def press(cycles: ControlCycles) -> Generator[Wish, None, EndingKind]:
    """Straight on along the dock's axis, slowly, until contact is felt and lasts.

    Raises:
        Interrupted: It cannot go on.
        AttemptFailed: No contact is felt.
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
    """Straight out of contact, no deeper into anything, until a way back can be planned.

    Args:
        cycles: Of the task.
        least: So far in any case, if nothing is in the way [m].
    """
    situation = cycles.situation
    direction, footprint = -situation.estimate.gear, situation.problem.robot.footprint
    begun_at, begun, is_straight = situation.perception.way, cycles.now, False
    braking = 0.5 * _BACK_OUT_SPEED * situation.braking_time_from(_BACK_OUT_SPEED)
    farthest = max(least, cycles.situation.dock_type.back_out_distance)
    limit = 2.0 * farthest / _BACK_OUT_SPEED + REST_PATIENCE
    while True:
        yield from cycles.locate()
        robot = situation.perception.robot
        driven = situation.perception.way - begun_at  # the dock may be seen elsewhere meanwhile
        near = situation.scene.near(robot, footprint.circumscribed_radius + _CLEAR_OF_CONTACT)
        if driven >= least - braking and pose_clearance(robot, footprint, near)[0] >= _CLEAR_OF_CONTACT:
            break
        cycles.state = State.BACKING_OUT
        if driven >= farthest - braking or cycles.now - begun > limit:
            break
        twist = Twist2(direction * _BACK_OUT_SPEED)
        deepest = (
            situation.estimate.reach_of_contact
        )  # by estimates and bumpers that yield, or pressed in by late commands
        if free_motion(footprint, near, robot, twist, _BACK_OUT_LOOK, overlap=deepest).free < _BACK_OUT_LOOK:
            cycles.report("backing out is blocked", f"after {driven:.3f} m")
            break
        if not is_straight:
            yield from _straighten(cycles, direction)
            begun, is_straight = cycles.now, True
            continue
        yield from cycles.cycle(twist)
    yield from cycles.stop()


def _straighten(cycles: ControlCycles, gear: float) -> Cycles:
    """At rest until the wheels of a robot that steers stand straight, wherever they may stand now."""
    until = cycles.now + cycles.situation.problem.robot.limits.steering_time_to(0.0)
    while cycles.now < until - _INSTANT:
        yield from cycles.cycle(Twist2(gear * _CREEP))
