"""How a robot docks and undocks, from top to bottom: each `yield` is one control cycle.

What ends an attempt or the whole task early is raised and caught where it
can be answered. Every wait has a name and a limit, and so has every motion: nothing stands still without a reason.
"""

from __future__ import annotations

import dataclasses
import logging
import math
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from optdock.costmap.cell_obstacles import obstacles_from_costmap
from optdock.costmap.contact_zone import with_contact_zone
from optdock.dock import Dock, DockDirection
from optdock.errors import ControllerException
from optdock.executor.approach import can_be_planned_away, left_at_dock, staging_distance
from optdock.executor.log import RecordedPlanning
from optdock.executor.outcomes import EndingKind, State
from optdock.executor.planning import Job, Motion, Outcome, PlanResult
from optdock.geometry.pose import Pose2, Twist2, displacement, normalize_angle
from optdock.lifecycle import LifecycleState, PluginContext
from optdock.obstacles import ObstacleSet
from optdock.problem import ClearanceRule
from optdock.tube import Tube
from optdock.verification import pose_clearance
from optdock.verification.time_of_impact import free_motion

if TYPE_CHECKING:
    from collections.abc import Callable, Generator

    from optdock.costmap.costmap import Costmap
    from optdock.executor.perception import Perception
    from optdock.executor.planning import Planning
    from optdock.executor.settings import ExecutorSettings
    from optdock.interfaces import Controller, GoalChecker
    from optdock.path import Path
    from optdock.problem import DockingProblem

__all__ = ["Procedure", "Wish"]

logger = logging.getLogger(__name__)

_AT_REST = 0.01, 0.02  # [m/s], [rad/s] by odometry: a robot that stands, its encoders not quite
_REST_PATIENCE = 2.0  # [s]: an odometry that never says so must not hold the task up
_PLANNING_PATIENCE = 5.0  # [s] beyond its budget: a thread that shares its core is late, not dead
_SAME_DOCK = 0.01  # [m], [rad]: a dock that is seen elsewhere by less stands in the same cells
_CLEAR_OF_CONTACT = 0.005  # [m]: a way back is planned from there; nearer, noise could make an overlap of it
# Standard deviations that the accepted errors of the dock must hold: one docking in 400 is then off by one more, were
# the robot believed to stand at the edge of what is accepted; it is believed to stand in the middle.
_CERTAINTY = 2.0
_BLINK = 0.5  # [s] without a detection that nothing is made of
_LONG = 3.0  # [s] without one, after which a robot that is not sure looks for it before it drives on
_LAST_LOOK = 0.2  # [m] before the dock: as near it drives without being sure, for a detection may come on the way
_BACK_OUT_SPEED = 0.05  # [m/s]
_CREEP = 1e-6  # [m/s]: no drive moves at it; steered wheels turn as its arc says
_BACK_OUT_LOOK = 0.5  # [s] ahead, of straight motions that no plan covers
_ARRIVED = 0.05, 0.05  # [m], [rad] from the staging pose: Nav2's undock_linear_tolerance and undock_angular_tolerance

_TOO_FAR_OFF, _BESIDE = "too far off to correct", "not docked"
_AT_THE_DOCK = (_TOO_FAR_OFF, _BESIDE)  # what stops the robot where it may be in contact with the station
# [s] for a detection at rest in the dock: of ten a second, half of them lost, one of 1000 takes longer.
_CONFIRMATION = 1.0
_HELD = "held"
_UNSEEN_WAY = 0.015  # [m]: on less than that no wheel that slips turns a robot by a degree
_MOST_BLOCKS = 5  # stops on one approach, until it counts as failed
_PROGRESS = 0.05  # [s] on the trajectory's own clock that count as progress
_INSTANT = 1e-9  # [s]
_SETTLED = 3e-4, 5e-4  # [m/s], [rad/s] commanded at the end of the path: by the usual gains 0.15 mm and 0.03 degrees
_OF_NOISE = 1.5  # standard deviations: of a smaller error nobody knows whether it is one
_NOISE_GAIN = 1.0  # [1/s]: what noise makes of the commands, by the usual gains
_WATCHED = 0.005  # [m]: a tube that is narrower, where it begins and ends in contact, is left by any noise
_LAST_REPLAN = 0.15  # [m] before the dock: nearer, no robot can be moved sideways by more than a millimetre
_LOOK = 0.1  # [s] between two looks at what is left to be corrected
_AFTER_REFUSAL = 3.0  # times the usual pause: what could not be planned now cannot be planned a moment later
_LEAP = 0.25  # [m] from its reference, farther off another stretch of the path may be nearer
_LEAD = 0.06  # [s] beyond the budget: a period at 20 Hz until the result is asked for, and some
_LATE = 0.05  # [s]: a reference that jumps by so much at the speeds near a dock jumps by millimetres
_STALE_STOP = 0.3  # [s]: a motion that is proven wrong from later on than this may go on while another is planned


_LATE_ENDINGS = {State.STAGING: EndingKind.FAILED_TO_STAGE, State.UNDOCKING: EndingKind.TIMEOUT}
_AT_A_STAND: dict[str, Any] = {"start_speed": 0.0, "start_acceleration": 0.0, "start_curvature": None}


Wish: TypeAlias = "Twist2 | None"
"""What a cycle asks of the drive: a body velocity; None: stop."""
Cycles: TypeAlias = "Generator[Wish, None, None]"
_STOP = None


class _Cancelled(Exception):
    """Somebody wants an end."""


class _Failed(Exception):
    """The task has failed."""

    def __init__(self, kind: EndingKind, reason: str) -> None:
        super().__init__(reason)
        self.kind, self.reason = kind, reason


class _AttemptFailed(_Failed):
    """This approach has failed; another one may do."""


class _Interrupted(Exception):
    """The motion cannot go on; another one from here may."""

    def __init__(self, name: str, reason: str) -> None:
        super().__init__(reason)
        self.name, self.reason = name, reason


class Procedure:
    """One task.

    Args:
        problem: Robot, dock as stored, obstacles, clearance; its start plays no part.
        settings: How.
        perception: Brought up to date before every cycle.
        controller: Drives the motions.
        goal_checker: Says when the robot is docked.
        planning: Makes them.
        report: Takes the name of an event and its detail.

    Attributes:
        state: What is being done.
        num_retries: Approaches after the first one.
        cancelled: Set it to end the task.
        interruption: Name and reason of what stops a motion from outside, such as a clock that jumped; empty: nothing.
        commanded: The last command; set before every cycle.
        deviation: The robot as seen from the path that it drives; None where it drives none.
    """

    def __init__(  # noqa: PLR0913, PLR0917 - the parts that an executor joins
        self,
        problem: DockingProblem,
        settings: ExecutorSettings,
        perception: Perception,
        controller: Controller,
        goal_checker: GoalChecker,
        planning: Planning,
        report: Callable[[str, str], None],
    ) -> None:
        self._base, self._settings, self._perception = problem, settings, perception
        self._controller, self._goal_checker, self._planning = controller, goal_checker, planning
        self._report = report
        self.state, self.num_retries = State.READY, 0
        self.cancelled = False
        self.interruption = ("", "")
        self.commanded = Twist2()
        self.deviation: Pose2 | None = None
        self._ending, self._began = False, 0.0
        self._jobs = 0
        self._signal_seen = False
        self._stalled_since: float | None = None
        self._cleared: tuple[Costmap | None, Costmap | None, Pose2] = (None, None, problem.goal)

    # The whole.

    def run(self, *, undock: bool) -> Generator[Wish, None, tuple[EndingKind, str]]:
        """The task; its value is how it ended, the robot being at rest."""
        self._began = self._now
        try:
            kind, reason = yield from self._undock() if undock else self._dock()
        except _Cancelled:
            kind, reason = EndingKind.CANCELLED, f"while {self.state.value}"
        except _Failed as failure:
            kind, reason = failure.kind, failure.reason
        except Exception as error:  # whatever a plugin raises, the robot must come to rest under a name
            logger.exception("the task ends")
            kind, reason = EndingKind.UNKNOWN, f"{type(error).__name__}: {error}"
        self._ending = True
        yield from self._stop()
        return kind, reason

    def _dock(self) -> Generator[Wish, None, tuple[EndingKind, str]]:
        yield from self._stop()
        yield from self._locate()
        if self._measured_contact and self._distance <= self._reach_of_contact:
            return EndingKind.ALREADY_DOCKED, "the external signal says so"
        if (yield from self._stands_docked()):
            return EndingKind.ALREADY_DOCKED, self._where
        if self._settings.navigate_to_staging_pose and self._from_staging() > self._settings.prestaging_tolerance:
            yield from self._drive_to_staging(State.STAGING, EndingKind.FAILED_TO_STAGE)
        while True:
            try:
                yield from self._perceive_from_staging()
                kind = yield from self._approach()
                if self._settings.wait_for_charge:
                    yield from self._wait_for_charge()
                return kind, ""
            except _AttemptFailed as failure:
                if self.num_retries >= self._settings.max_retries:
                    raise
                self._report("attempt failed", f"{failure.kind.value}: {failure.reason}")
                yield from self._stop()
                self.num_retries += 1
            yield from self._back_out()
            yield from self._drive_to_staging(State.RETURNING, EndingKind.FAILED_TO_CONTROL)

    def _stands_docked(self) -> Generator[Wish, None, bool]:
        """Whether the robot stands in its dock before anything is done, as a dock without a signal cannot tell."""
        settings = self._settings
        needs_signal = settings.contact == "touch" or settings.wait_for_charge
        if needs_signal or self._distance > self._reach_of_contact:
            return False
        self.state, since = State.PERCEIVING, self._now
        while settings.use_detections and not self._is_dock_known:
            if self._now - since >= _CONFIRMATION:
                return False
            yield from self._cycle(_STOP)
        return self._will_know(0.0) and self._may_stand_in_dock and not self._may_have_turned

    def _undock(self) -> Generator[Wish, None, tuple[EndingKind, str]]:
        yield from self._stop()
        yield from self._locate()
        if self._distance > self._reach_of_contact and not self._measured_contact:
            return EndingKind.NOT_DOCKED, f"the robot is {self._distance:.3f} m from the dock"
        yield from self._back_out(max(self._settings.back_out_distance, self._base.dock.final_straight))
        yield from self._drive_to_staging(State.UNDOCKING, EndingKind.FAILED_TO_STAGE)
        return EndingKind.UNDOCKED, ""

    # Its parts, in the order in which they come.

    def _cycle(self, wish: Wish) -> Cycles:
        """One control cycle."""
        yield wish
        if self._ending:
            return
        if self.cancelled:
            raise _Cancelled
        if self._settings.timeout is not None and self._now - self._began > self._settings.timeout:
            raise _Failed(EndingKind.TIMEOUT, f"{self._now - self._began:.1f} s passed while {self.state.value}")

    def _stop(self) -> Cycles:
        """Brake, until commands and odometry say that the robot stands."""
        before, since = self.state, self._now
        self.deviation = None
        moving = not self._standing or not self._odometry_at_rest
        if moving:
            self.state = State.STOPPING
        while not self._standing or not self._odometry_at_rest:
            if self._standing and self._now - since > _REST_PATIENCE + self._braking_time:
                self._report("odometry does not come to rest", f"{self._twist.linear:.3f} m/s commanded 0")
                break
            yield from self._cycle(_STOP)
        self.state = before

    def _locate(self) -> Cycles:
        """At rest until robot and surroundings are known as they are now."""
        while self._is_held:
            self.state = State.HELD
            yield from self._cycle(_STOP)
        self.state = State.WAITING_FOR_POSE
        since = self._now
        while not self._perception.started or self._oldest > self._settings.pose_patience:
            if self._now - since > self._settings.localization_timeout:
                missing = "odometry" if self._perception.started and self._perception.twist_age > 0.0 else "pose"
                raise _Failed(EndingKind.UNKNOWN, f"no {missing} for {self._now - since:.1f} s")
            yield from self._cycle(_STOP)
        while self._is_blind:
            self.state = State.WAITING_FOR_COSTMAP
            if self._now - since > self._settings.costmap_timeout:
                reason = f"no costmap for {self._perception.costmap_age:.1f} s"
                raise _Failed(EndingKind.FAILED_TO_CONTROL, reason)
            yield from self._cycle(_STOP)

    def _perceive_from_staging(self) -> Cycles:
        """Look at the dock from here; where it is not seen, from the staging pose, which faces it."""
        try:
            yield from self._perceive()
        except _Failed as failure:
            if self._gap(self._staging()) <= 1.0:
                raise
            self._report("dock not seen from here", failure.reason)
            yield from self._drive_to_staging(State.STAGING, EndingKind.FAILED_TO_STAGE)
            yield from self._perceive()

    def _perceive(self) -> Cycles:
        """Look at the dock, at rest, until it has been seen often enough."""
        if not self._settings.use_detections or self._is_dock_known:
            return
        self.state = State.PERCEIVING
        since, before = self._now, self._perception.detections
        while self._perception.detections - before < self._settings.least_detections:
            if self._now - since > self._settings.initial_perception_timeout:
                found = self._perception.detections - before
                rejected = self._perception.rejected
                far = self._perception.too_far
                raise _Failed(
                    EndingKind.FAILED_TO_DETECT_DOCK,
                    f"{found} detections in {self._now - since:.1f} s, needed are {self._settings.least_detections}; "
                    f"{rejected} were rejected so far"
                    + (f"; the last was {far:.3f} m from the stored dock, which is another one" if far else ""),
                )
            yield from self._cycle(_STOP)

    def _approach(self) -> Generator[Wish, None, EndingKind]:
        """Plan from rest and drive; from wherever something stops the robot, plan again."""
        blocks, blocked_since = 0, self._now
        while True:
            yield from self._locate()
            result = yield from self._planned(self._to_dock(), self._settings.time_budget)
            if result.motion is None:
                yield from self._wait_for_obstacle(result, blocked_since)
                continue
            try:
                return (yield from self._attempt(result.motion))
            except _Interrupted as stopped:
                self._say_why(stopped)
                yield from self._stop()
                if blocks == 0 or self._now - blocked_since > 2.0 * self._settings.obstacle_patience:
                    blocked_since = self._now
                blocks += stopped.name != _HELD
                if blocks > _MOST_BLOCKS:
                    reason = f"stopped {blocks} times on one approach, last: {stopped.name}: {stopped.reason}"
                    raise _AttemptFailed(EndingKind.FAILED_TO_CONTROL, reason) from None
                if stopped.name in _AT_THE_DOCK:
                    yield from self._back_out()
                yield from self._wait_for_detection()

    def _attempt(self, motion: Motion) -> Generator[Wish, None, EndingKind]:
        """Drive a motion into the dock, and see that the robot stands in it."""
        try:
            yield from self._drive(motion, State.APPROACHING, is_approach=True)
            return (yield from self._make_contact())
        except _Docked as docked:
            yield from self._stop()
            if docked.kind is EndingKind.DOCKED_BY_SIGNAL and not self._measured_contact:
                self._report("contact lost again", self._where)  # the feedback was taking the robot back
                return (yield from self._press())
            if self._settings.contact == "distance":
                yield from self._confirm()
            return docked.kind

    def _confirm(self) -> Cycles:
        """Look once more, at rest: a wheel that slipped on the last centimetres is seen by the detector alone.

        Raises:
            _Interrupted: The robot stands elsewhere.
        """
        if self._settings.use_detections:
            since = self._now
            while self._perception.moved_since_seen > _UNSEEN_WAY or self._may_have_turned or self._is_on_the_edge:
                patience = self._settings.initial_perception_timeout if self._may_have_turned else _CONFIRMATION
                if self._now - since >= patience:
                    break
                yield from self._cycle(_STOP)
        self._require_certainty()
        if not self._may_stand_in_dock:
            raise _Interrupted(_BESIDE, self._where)

    def _wait_for_detection(self) -> Cycles:
        """Where the dock has not been seen for long, look for it again."""
        if not self._settings.use_detections or not self._detection_is_old:
            return
        before = self._perception.detections
        since, self.state = self._now, State.WAITING_FOR_DETECTION
        while self._perception.detections - before < self._settings.least_detections:
            if self._now - since > self._settings.initial_perception_timeout:
                reason = f"the dock has not been seen for {self._perception.detection_age:.1f} s"
                raise _AttemptFailed(EndingKind.FAILED_TO_DETECT_DOCK, reason)
            yield from self._cycle(_STOP)

    def _wait_for_obstacle(self, result: PlanResult, since: float) -> Cycles:
        """No way from here: wait for another picture of the surroundings, or some time, and try again."""
        patience = self._settings.obstacle_patience
        if self._now - since >= patience:
            raise _AttemptFailed(EndingKind.FAILED_TO_CONTROL, f"no way to the dock: {result.reason}")
        self.state = State.WAITING_FOR_OBSTACLE
        seen, until = self._perception.costmap, min(self._now + 1.0, since + patience)
        self._report("no way", result.reason)
        while self._now < until and self._perception.costmap is seen:
            yield from self._cycle(_STOP)

    def _planned(self, problem: DockingProblem, budget: float) -> Generator[Wish, None, PlanResult]:
        """The result of a plan from rest."""
        self.state = State.PLANNING
        job = self._job(problem, budget)
        self._planning.submit(job)
        since = self._now
        while True:
            yield from self._cycle(_STOP)
            result = self._planning.poll(self._now)
            if result is not None and result.number == job.number:
                self._take(result)
                return result
            if self._now - since > budget + _PLANNING_PATIENCE:
                return PlanResult(job.number, Outcome.FAILED, reason="planning does not answer")

    def _drive(self, motion: Motion, state: State, *, is_approach: bool) -> Cycles:
        """Drive a motion to its end, replanned on the way where that is worth it.

        Raises:
            _Docked: Contact was made on the way, or the goal checker is content.
            _Interrupted: It cannot go on.
            _AttemptFailed: An approach that cannot succeed any more.
        """
        self.state = state
        drive = _Drive(self, motion, is_approach=is_approach)
        self._goal_checker.reset()
        while not drive.is_over():
            yield from self._cycle(drive.wish())

    def _straighten(self, gear: float) -> Cycles:
        """At rest until the wheels of a robot that steers stand straight, wherever they may stand now."""
        limits = self._base.robot.limits
        until = self._now + limits.steering_time_to(0.0)
        while self._now < until - _INSTANT:
            yield from self._cycle(Twist2(gear * _CREEP))

    def _make_contact(self) -> Generator[Wish, None, EndingKind]:
        """At the end of the path, not docked yet: press on until contact is felt.

        Raises:
            _Interrupted: The robot stands beside the dock, and there is no contact to press on for.
            _AttemptFailed: Nobody knows where it stands.
        """
        if self._settings.contact == "distance":
            self._require_certainty()
            raise _Interrupted(_BESIDE, self._where)
        return (yield from self._press())

    def _require_certainty(self) -> None:
        """Raises _AttemptFailed if nobody knows whether the robot stands in its dock."""
        perception = self._perception
        if perception.is_contradicted:
            raise _AttemptFailed(EndingKind.FAILED_TO_DETECT_DOCK, "the last detections contradict where the dock was")
        if self._may_have_turned:
            raise _AttemptFailed(
                EndingKind.FAILED_TO_DETECT_DOCK,
                f"it cannot be known whether the robot is docked: the localization has turned by "
                f"{perception.unseen_turn:.3f} rad against the odometry, and the dock was not seen since",
            )
        if not self._will_know(0.0):
            sigma = perception.sigma_after(0.0)
            raise _AttemptFailed(
                EndingKind.FAILED_TO_DETECT_DOCK,
                f"it cannot be known whether the robot is docked: not seen for {perception.detection_age:.1f} s, "
                f"standard deviations {sigma.along:.4f} m along, {sigma.cross:.4f} m across, {sigma.yaw:.4f} rad",
            )

    def _press(self) -> Generator[Wish, None, EndingKind]:
        """Straight on along the dock's axis, slowly, until contact is felt and lasts."""
        self.state = State.PRESSING
        gear, speed = self._gear, self._settings.contact_speed
        allowed = self._settings.contact_overrun + abs(self._perception.robot_from_dock.x)
        until = self._now + _REST_PATIENCE + 2.0 * allowed / speed
        while True:
            self._require_no_interruption()
            kind = self._contact()
            if kind is not None:
                yield from self._stop()
                if kind is not EndingKind.DOCKED_BY_SIGNAL or self._measured_contact:
                    return kind
            beyond = gear * self._perception.robot_from_dock.x
            if beyond > self._settings.contact_overrun or self._now > until:
                raise _AttemptFailed(EndingKind.FAILED_TO_CONTROL, f"no contact: {self._where}")
            yield from self._cycle(Twist2(gear * speed))

    def _wait_for_charge(self) -> Cycles:
        self.state = State.WAITING_FOR_CHARGE
        since = self._now
        while not self._measured_contact:
            if self._now - since > self._settings.wait_charge_timeout:
                raise _AttemptFailed(
                    EndingKind.FAILED_TO_CHARGE, f"no signal for {self._now - since:.1f} s: {self._where}"
                )
            yield from self._cycle(_STOP)

    def _back_out(self, least: float = 0.0) -> Cycles:
        """Straight out of contact, no deeper into anything, until a way back can be planned.

        Args:
            least: So far in any case, if nothing is in the way [m].
        """
        direction, footprint = -self._gear, self._base.robot.footprint
        origin, begun, is_straight = self._perception.robot_from_dock, self._now, False
        farthest = max(least, self._settings.back_out_distance)
        limit = 2.0 * farthest / _BACK_OUT_SPEED + _REST_PATIENCE
        while True:
            yield from self._locate()
            robot, driven = self._perception.robot, origin.distance_to(self._perception.robot_from_dock)
            near = self._near(robot, footprint.circumscribed_radius + _CLEAR_OF_CONTACT)
            if driven >= least and pose_clearance(robot, footprint, near)[0] >= _CLEAR_OF_CONTACT:
                break
            self.state = State.BACKING_OUT
            if driven >= farthest or self._now - begun > limit:
                break
            twist = Twist2(direction * _BACK_OUT_SPEED)
            deepest = self._reach_of_contact  # by estimates and bumpers that yield, or pressed in by late commands
            if free_motion(footprint, near, robot, twist, _BACK_OUT_LOOK, overlap=deepest).free < _BACK_OUT_LOOK:
                self._report("backing out is blocked", f"after {driven:.3f} m")
                break
            if not is_straight:
                yield from self._straighten(direction)
                begun, is_straight = self._now, True
                continue
            yield from self._cycle(twist)
        yield from self._stop()

    def _drive_to_staging(self, state: State, failure: EndingKind) -> Cycles:
        """Along a certified path to the staging pose; what stops the robot is planned around, or ends the task."""
        blocks, since = 0, self._now
        while True:
            yield from self._locate()
            staging = self._staging()
            if self._gap(staging) <= 1.0:
                return
            result = yield from self._planned(self._to(staging), self._settings.time_budget)
            if result.motion is None:
                if self._now - since > self._settings.obstacle_patience:
                    raise _Failed(failure, f"no way to the staging pose: {result.reason}")
                try:
                    yield from self._wait_for_obstacle(result, since)
                except _AttemptFailed as over:
                    raise _Failed(failure, over.reason) from None
                continue
            try:
                yield from self._drive(result.motion, state, is_approach=False)
                yield from self._stop()
                return
            except _Interrupted as stopped:
                self._say_why(stopped)
                yield from self._stop()
                blocks += stopped.name != _HELD
                since = self._now
                if blocks > _MOST_BLOCKS:
                    raise _Failed(failure, f"{stopped.name}: {stopped.reason}") from None

    # What they are made of.

    @property
    def _standing(self) -> bool:
        """Whether the commands have come to rest."""
        return self.commanded == Twist2()

    @property
    def _now(self) -> float:
        return self._perception.stamp

    @property
    def _twist(self) -> Twist2:
        measurements = self._perception.measurements
        return Twist2() if measurements is None else measurements.twist

    @property
    def _odometry_at_rest(self) -> bool:
        return abs(self._twist.linear) <= _AT_REST[0] and abs(self._twist.angular) <= _AT_REST[1]

    @property
    def _braking_time(self) -> float:
        limits = self._base.robot.limits
        return limits.max_speed / limits.max_deceleration + limits.max_deceleration / limits.max_jerk

    @property
    def _measured_contact(self) -> bool:
        measurements = self._perception.measurements
        return measurements is not None and measurements.contact is True

    @property
    def _distance(self) -> float:
        relative = self._perception.robot_from_dock
        return math.hypot(relative.x, relative.y)

    @property
    def _reach_of_contact(self) -> float:
        """As far from the estimated dock contact may be made: what the estimate may be wrong comes on top [m]."""
        return self._settings.contact_range + 3.0 * self._perception.sigma[0]

    @property
    def _where(self) -> str:
        relative = self._perception.robot_from_dock
        return f"{relative.x:.4f} m along, {relative.y:.4f} m across and {relative.yaw:.4f} rad from the docked pose"

    @property
    def _detection_is_old(self) -> bool:
        """Whether the dock has not been seen for so long that the robot would not know at the dock where it stands."""
        age, settings = self._perception.detection_age, self._settings
        left = abs(self._perception.robot_from_dock.x)
        if age <= _BLINK or self._distance <= settings.detection_blind_distance:
            return False
        patience = settings.detection_patience
        if patience is not None and age > patience:
            return True
        return (left <= _LAST_LOOK or age > _LONG) and not self._will_know(left)

    @property
    def _is_dock_known(self) -> bool:
        """Whether the dock was seen on the way here, often and well enough to be driven to."""
        perception, accepted = self._perception, self._base.dock.tolerances
        seen = perception.detections >= self._settings.least_detections and not self._detection_is_old
        (place, turn), most = perception.sigma, min(accepted.along, accepted.cross)
        is_sure = _CERTAINTY * place <= most and _CERTAINTY * turn <= accepted.yaw
        return seen and is_sure and not perception.is_contradicted

    @property
    def _is_on_the_edge(self) -> bool:
        """Whether the robot may stand within the tolerances of the dock as well as beside them, by what is known."""
        accepted, found = self._base.dock.tolerances, self._perception.robot_from_dock
        asked = zip(
            (found.x, found.y, found.yaw),
            self._perception.sigma_after(0.0),
            (accepted.along, accepted.cross, accepted.yaw),
            strict=True,
        )
        return any(abs(abs(error) - most) < _CERTAINTY * sigma for error, sigma, most in asked)

    @property
    def _may_have_turned(self) -> bool:
        """Whether the localization says that the robot has turned out of its dock since that was seen."""
        return self._settings.use_detections and abs(self._perception.unseen_turn) > self._base.dock.tolerances.yaw

    @property
    def _may_stand_in_dock(self) -> bool:
        """False where it is known that the robot stands outside the tolerances of the dock."""
        origin = Pose2(0.0, 0.0, 0.0)
        return not self._will_know(0.0) or self._base.dock.tolerances.accept(self._perception.robot_from_dock, origin)

    def _will_know(self, left: float) -> bool:
        """Whether the tolerances of the dock can be told from the noise after so much more of the way [m]."""
        sigma, accepted = self._perception.sigma_after(self._gear * left), self._base.dock.tolerances
        asked = zip(sigma, (accepted.along, accepted.cross, accepted.yaw), strict=True)
        return all(_CERTAINTY * found <= most for found, most in asked)

    @property
    def _gear(self) -> float:
        """Of the last motion into the dock."""
        direction = self._base.dock.direction
        if direction is DockDirection.AUTO:
            return 1.0 if self._perception.robot_from_dock.x <= 0.0 else -1.0
        return 1.0 if direction is DockDirection.FORWARD else -1.0

    def _staging(self) -> Pose2:
        distance = self._settings.staging_distance or staging_distance(self._base)
        return self._perception.dock @ Pose2(-self._gear * distance, 0.0, 0.0)

    def _from_staging(self) -> float:
        """Nav2's norm of the way to the staging pose, metres and radians mixed."""
        gap = self._perception.robot.in_frame_of(self._staging())
        return math.sqrt(gap.x**2 + gap.y**2 + gap.yaw**2)

    def _gap(self, staging: Pose2) -> float:
        """How far the staging pose is, in tolerances."""
        gap = self._perception.robot.in_frame_of(staging)
        return max(math.hypot(gap.x, gap.y) / _ARRIVED[0], abs(gap.yaw) / _ARRIVED[1])

    @property
    def _costmap(self) -> Costmap | None:
        """The newest picture of the surroundings, without what it shows of the station where the docked robot touches.

        A station that scanners see stands a cell or two too fat in it.
        """
        seen, dock = self._perception.costmap or self._base.costmap, self._perception.dock
        if seen is None:
            return None
        known, cleared, place = self._cleared
        if seen is not known or dock.gap_to(place) > _SAME_DOCK:
            cleared = with_contact_zone(
                seen,
                dataclasses.replace(self._base.dock, pose=dock),
                self._base.robot.footprint,
                self._settings.contact_margin,
            )
            self._cleared = seen, cleared, dock
        return cleared

    @property
    def _station(self) -> ObstacleSet:
        """The station where the dock is seen."""
        station = self._base.dock.footprint
        return (
            ObstacleSet.empty()
            if station is None
            else ObstacleSet.from_footprint(station, self._perception.dock, "dock")
        )

    def _to_dock(self) -> DockingProblem:
        """From where the robot is to where the dock is seen."""
        return dataclasses.replace(
            self._base,
            start=self._perception.robot,
            dock=dataclasses.replace(self._base.dock, pose=self._perception.dock),
            costmap=self._costmap,
            **_AT_A_STAND,
        )

    def _to(self, place: Pose2) -> DockingProblem:
        """From where the robot is to a place before the dock, among everything and the station.

        There is nothing to be touched at that place: the whole clearance is kept up to it.
        """
        kept = self._base.clearance.required
        return dataclasses.replace(
            self._base,
            start=self._perception.robot,
            dock=Dock(place),
            obstacles=self._base.obstacles + self._station,
            clearance=ClearanceRule(kept, kept, 0.0),
            costmap=self._costmap,
            **_AT_A_STAND,
        )

    def _near(self, robot: Pose2, reach: float) -> ObstacleSet:
        """Whatever stands within reach of a pose, the station included."""
        centre = np.array([robot.x, robot.y])
        found = self._base.obstacles.in_box(centre - reach, centre + reach) + self._station
        costmap = self._costmap
        if costmap is None:
            return found
        return found + obstacles_from_costmap(costmap, region=(centre - reach, centre + reach))

    def _job(self, problem: DockingProblem, budget: float) -> Job:
        self._jobs += 1
        return Job(self._jobs, self._now, problem, budget)

    def _take(self, result: PlanResult) -> None:
        """Report a result.

        Raises:
            _Failed: It is a motion that leads on, and no proven one; a log is believed, for it drives no robot.
        """
        unproven = result.motion is not None and result.motion.plan is None
        if result.outcome is Outcome.NEW and unproven and not isinstance(self._planning, RecordedPlanning):
            raise _Failed(EndingKind.UNKNOWN, "planning returned a motion that is not proven")
        if result.motion is None:
            self._report(f"plan {result.outcome.value}", result.reason)
        else:
            trajectory = result.motion.trajectory
            self._report(
                f"plan {result.outcome.value}", f"{trajectory.path.driven:.3f} m in {trajectory.duration:.2f} s"
            )

    def _say_why(self, stopped: _Interrupted) -> None:
        if stopped.name != self.interruption[0]:  # that has been said already
            self._report(stopped.name, stopped.reason)

    @property
    def _oldest(self) -> float:
        """Age of the pose or of the odometry, the larger one [s]."""
        return max(self._perception.pose_age, self._perception.twist_age)

    @property
    def _is_held(self) -> bool:
        measurements = self._perception.measurements
        return measurements is not None and measurements.held

    @property
    def _is_blind(self) -> bool:
        """Whether the picture of the surroundings is too old to be moved in."""
        patience = self._settings.costmap_patience
        return patience is not None and self._perception.costmap_age > patience

    def _require_no_interruption(self) -> None:
        if self._is_held:
            raise _Interrupted(_HELD, "it goes on from here when it is released")
        name, reason = self.interruption
        if name:
            raise _Interrupted(name, reason)
        if self._perception.pose_age > self._settings.pose_patience:
            raise _Interrupted("no pose", f"the last one is {self._perception.pose_age:.2f} s old")
        if self._perception.twist_age > self._settings.pose_patience:
            raise _Interrupted("no odometry", f"the last one is {self._perception.twist_age:.2f} s old")
        if self._is_blind:
            raise _Interrupted("no costmap", f"the last one is {self._perception.costmap_age:.2f} s old")

    def _contact(self) -> EndingKind | None:
        """Contact that is felt: by the external signal, or by a stall."""
        is_near = self._distance <= self._reach_of_contact
        if self._measured_contact:
            if is_near:
                return EndingKind.DOCKED_BY_SIGNAL
            if not self._signal_seen:
                self._report("external signal far from the dock", self._where)
        self._signal_seen = self._measured_contact
        if not self._is_stalled():
            self._stalled_since = None
            return None
        if self._stalled_since is None:
            self._stalled_since = self._now
        if self._now - self._stalled_since < self._settings.stall_time or not is_near:
            return None
        return EndingKind.DOCKED_BY_STALL if self._settings.contact == "touch" else None

    def _is_stalled(self) -> bool:
        wanted = abs(self.commanded.linear) > 2.0 * self._settings.stall_speed
        return wanted and abs(self._twist.linear) < self._settings.stall_speed


class _Docked(Exception):
    """The robot is in its dock."""

    def __init__(self, kind: EndingKind) -> None:
        super().__init__(kind.value)
        self.kind = kind


class _Way:
    """The poses of a path every centimetre, to find one quickly: between them it bends by micrometres."""

    def __init__(self, path: Path) -> None:
        count = max(1, math.ceil(path.length / _CENTIMETRE))
        places = np.linspace(0.0, path.length, count + 1)
        self._step = path.length / count
        self._poses: list[list[float]] = path.poses_at(places).tolist()
        self._gears: list[float] = path.direction_at(places).astype(np.float64).tolist()

    def at(self, s: float) -> tuple[Pose2, float]:
        """The pose at a place [m] of the path, and the gear."""
        i = min(max(int(s / self._step), 0), len(self._poses) - 2)
        share = s / self._step - i
        (x, y, yaw), (far_x, far_y, far_yaw) = self._poses[i : i + 2]
        turned = normalize_angle(far_yaw - yaw)
        pose = Pose2(x + share * (far_x - x), y + share * (far_y - y), yaw + share * turned)
        return pose, self._gears[i]


_CENTIMETRE = 0.01


class _Drive:
    """One motion being driven; it becomes another one where replanning is worth it."""

    def __init__(self, owner: Procedure, motion: Motion, *, is_approach: bool) -> None:
        self.owner, self.is_approach = owner, is_approach
        self._goal = motion.problem.goal
        self._next_goal: tuple[float, Pose2] | None = None  # from when on [s]
        self._job: Job | None = None
        self._is_urgent = self._is_stop = False
        self._costmap = motion.problem.costmap  # a newer one is looked at in the first cycle
        self._blocked = math.inf, ""  # when the motion meets what was not there when it was planned, and what that is
        self._looked_at, self._where = -math.inf, ""
        self._submitted_at, self._pause = -math.inf, owner._settings.replan_pause
        self._finished_since: float | None = None
        self._until = owner._now + motion.trajectory.duration + self._allowance
        self._give(motion, None)
        self._become(motion)

    def _give(self, motion: Motion, start_stamp: float | None) -> None:
        """Hand a motion to the controller.

        Raises:
            _AttemptFailed: It cannot follow such a one.
        """
        self._configure(motion)
        try:
            self.owner._controller.set_path(motion.trajectory, start_stamp=start_stamp)
        except ControllerException as error:
            raise _AttemptFailed(EndingKind.FAILED_TO_CONTROL, f"{type(error).__name__}: {error}") from error

    def _become(self, motion: Motion) -> None:
        """What is driven from now on."""
        law, tracking = motion.trajectory.time_law, self.owner._base.robot.tracking
        self.motion, self._progress = motion, (-math.inf, self.owner._now)
        self._way = _Way(motion.trajectory.path)
        self._times_of_places, self._time_of_place = (law.states[:, 0], law.times), 0.0
        proven = not self._is_stop and (tracking.cross > 0.0 or tracking.yaw > 0.0)
        self._tube = Tube(motion.trajectory.path, motion.problem, motion.start_relief) if proven else None
        self._is_outside = False

    @property
    def _allowance(self) -> float:
        settings, state = self.owner._settings, self.owner.state
        if state is State.STAGING:
            return settings.max_staging_time
        return settings.max_undocking_time if state is State.UNDOCKING else settings.dock_approach_timeout

    def is_over(self) -> bool:
        """Whether the end is reached; what makes it unreachable is raised."""
        owner = self.owner
        owner._require_no_interruption()
        if self._next_goal is not None and owner._now >= self._next_goal[0] - _INSTANT:
            self._goal, self._next_goal = self._next_goal[1], None
        if self.is_approach:
            self._check_contact()
            if owner._settings.use_detections and owner._detection_is_old:
                place, turn = owner._perception.sigma
                reason = f"not seen for {owner._perception.detection_age:.1f} s, sigma {place:.4f} m and {turn:.4f} rad"
                raise _Interrupted("detection missing", reason)
        if owner._now > self._until:
            reason = f"timeout while {owner.state.value}: {owner._where}"
            if self.is_approach:
                raise _AttemptFailed(EndingKind.FAILED_TO_CONTROL, reason)
            raise _Failed(_LATE_ENDINGS.get(owner.state, EndingKind.FAILED_TO_CONTROL), reason)
        self._look_around()
        self._stop_in_time()
        self._watch_place()
        return self._is_finished()

    def wish(self) -> Wish:
        """What the controller asks for."""
        owner = self.owner
        measurements = owner._perception.measurements
        assert measurements is not None
        try:
            target = owner._controller.compute_velocity_commands(
                self._pose, measurements.twist, owner._goal_checker, stamp=owner._now
            )
        except ControllerException as error:
            raise _Interrupted("no valid control", f"{type(error).__name__}: {error}") from error
        self._replan()
        return target

    @property
    def _pose(self) -> Pose2:
        """The robot as the controller is told: where it stands relative to the dock, of which the plan may be older."""
        perception = self.owner._perception
        return self._goal @ perception.robot_from_dock if self.is_approach else perception.robot

    def _configure(self, motion: Motion) -> None:
        controller = self.owner._controller
        if controller.state is LifecycleState.INACTIVE:
            controller.cleanup()
        costmap = self.owner._costmap if self.owner._perception.costmap is not None else None
        controller.configure(PluginContext(name=controller.name, problem=motion.problem, local_costmap=costmap))

    @property
    def _reference(self) -> tuple[float, float]:
        """Time of the reference on the trajectory's own clock [s], and its rate.

        A controller that follows no trajectory in time has none: there it is when the plan would be where the robot is.
        """
        progress = getattr(self.owner._controller, "progress", None)
        return (self._time_of_place, 1.0) if progress is None else (float(progress.time), float(progress.rate))

    def _check_contact(self) -> None:
        owner = self.owner
        kind = owner._contact()
        if kind is not None:
            raise _Docked(kind)
        if self._finished_since is None or owner._settings.contact == "touch":
            return
        still = [
            max(least, _NOISE_GAIN * sigma) for least, sigma in zip(_SETTLED, owner._perception.sigma, strict=True)
        ]
        moves = abs(owner.commanded.linear) > still[0] or abs(owner.commanded.angular) > still[1]
        relative, goal = owner._perception.robot_from_dock, Pose2(0.0, 0.0, 0.0)
        errors = zip(relative.as_array(), owner._perception.sigma_after(0.0), strict=True)
        is_noise = all(abs(error) <= _OF_NOISE * sigma for error, sigma in errors)
        if moves and not is_noise and owner._now - self._finished_since < 0.5 * owner._settings.settling_time:
            return  # what is left is still being corrected
        path = [Pose2(-0.1 * owner._gear, 0.0, 0.0), goal]
        if not owner._goal_checker.is_goal_reached(relative, goal, owner._twist, path):
            return
        if not owner._perception.is_contradicted and owner._will_know(0.0):
            raise _Docked(EndingKind.DOCKED_BY_DISTANCE)

    def _is_finished(self) -> bool:
        owner, settings = self.owner, self.owner._settings
        now, (time, _) = owner._now, self._reference
        if time >= self.motion.trajectory.duration - _INSTANT:
            if self._is_stop:
                raise _Interrupted("stopped", "nothing that is certified leads on from here")
            self._finished_since = self._finished_since if self._finished_since is not None else now
            if not self.is_approach:
                return True
            return now - self._finished_since > settings.settling_time
        self._finished_since = None
        best, since = self._progress
        if time > best + _PROGRESS:
            self._progress = time, now
        elif now - since > settings.progress_time:
            raise _Interrupted(
                "no progress", f"the motion stands at {time:.2f} s of its time since {now - since:.1f} s"
            )
        return False

    def _look_around(self) -> None:
        """A new picture of the surroundings: does the rest of the motion still hold?"""
        owner = self.owner
        costmap = owner._costmap
        if costmap is None or costmap is self._costmap:
            return
        self._costmap = costmap
        self._configure(self.motion)
        time, _ = self._reference
        verdict = owner._planning.still_holds(self.motion, costmap, max(0.0, time))
        if verdict.holds:
            self._blocked = math.inf, ""
            return
        owner._report("motion does not hold any more", verdict.reason)
        self._blocked = verdict.at_time, verdict.reason
        self._is_urgent, self._job = True, None

    def _stop_in_time(self) -> None:
        """Whoever plans the way round what is ahead may take his time; the robot does not."""
        at_time, reason = self._blocked
        if at_time - self._reference[0] < self.owner._braking_time + _STALE_STOP:
            raise _Interrupted("obstacle ahead", reason)

    def _watch_place(self) -> None:
        """Where on its path the robot is, and whether it is within the tube that was proven around it."""
        owner, trajectory, path = self.owner, self.motion.trajectory, self.motion.trajectory.path
        time, _ = self._reference
        if time < 0.0:
            return
        robot, way = owner._perception.robot, self._way
        begin = float(trajectory.time_law.at(time)[0, 0])
        place, gear = way.at(begin)
        ahead = gear * robot.in_frame_of(place).x
        s = min(max(begin + min(max(ahead, -_LEAP), _LEAP), 0.0), path.length)
        owner.deviation = off = robot.in_frame_of(way.at(s)[0])
        if not hasattr(owner._controller, "progress"):
            self._time_of_place = max(time, float(np.interp(s, *self._times_of_places)))
        if self._tube is None:
            return
        radius = owner._base.robot.footprint.circumscribed_radius
        moved = float(displacement(math.hypot(off.x, off.y), off.yaw, radius))
        width = float(self._tube.width_at(np.array([s]))[0])
        if moved > width:  # from there; another place may be the better one
            found = self._tube.deviations(robot.as_array()[None], near=s, within=_LEAP)
            moved, width = float(found.displacement[0]), float(found.width[0])
        is_outside = moved > width
        if is_outside != self._is_outside:
            self._is_outside = is_outside
            said = f"{off.y:.4f} m and {off.yaw:.4f} rad off, {moved:.4f} m with its outline; proven: {width:.4f} m"
            owner._report("tube left" if is_outside else "tube entered", said)
            is_worth_it = width >= _WATCHED and path.length - s > _LAST_REPLAN
            self._is_urgent = self._is_urgent or (is_outside and is_worth_it)

    def _replan(self) -> None:
        """Hand in a job where one is worth it, and take over what the last one gave."""
        owner = self.owner
        if self._job is not None:
            result = owner._planning.poll(owner._now)
            if result is not None and result.number == self._job.number:
                self._job = None
                self._take(result)
            return
        if self._is_stop or self._next_goal is not None or not owner._settings.replanning:
            return
        time, rate = self._reference
        if not self._is_urgent:
            if not self.is_approach or owner._now - self._looked_at < _LOOK - _INSTANT:
                return
            self._looked_at = owner._now
            if not self._is_worth_it(time) or owner._now - self._submitted_at < self._pause:
                return
            owner._report("plan asked for", self._where)
        problem = (
            owner._to_dock() if self.is_approach else dataclasses.replace(self.motion.problem, costmap=self._costmap)
        )
        self._submitted_at = owner._now
        budget = owner._settings.replan_budget
        self._job = owner._job(problem, budget)._replace(
            running=self.motion,
            time=time,
            rate=rate,
            pose=owner._perception.robot,
            lead=budget + _LEAD,
            # The controller is told where the robot is relative to the dock, so it follows the motion there.
            moved=owner._perception.dock @ self._goal.inverse() if self.is_approach else None,
        )
        owner._planning.submit(self._job)

    def _is_worth_it(self, time: float) -> bool:
        """Whether feedback would leave more of the present error at the dock than is worth a plan.

        Raises:
            _Interrupted: More than the dock accepts would be left without another gear.
        """
        owner, trajectory = self.owner, self.motion.trajectory
        perception, settings = owner._perception, owner._settings
        if settings.use_detections and not perception.sees_dock:
            return False
        if not 0.0 <= time < trajectory.duration:
            return False
        now = trajectory.at(time)
        left = trajectory.path.length - now.s
        error = self._pose.in_frame_of(now.pose)
        limits, dock, sigma = owner._base.robot.limits, owner._base.dock, perception.sigma
        left_over = [abs(part) for part in left_at_dock(error.y, error.yaw, left, owner._gear)]
        if not can_be_planned_away(error.y, error.yaw, left - dock.final_straight, owner._gear, limits):
            cusps, accepted = trajectory.path.cusps, dock.tolerances
            off = left_over[0] > max(accepted.cross, 3.0 * sigma[0])
            turned = left_over[1] > max(accepted.yaw, 3.0 * sigma[1])
            if (off or turned) and (not cusps or now.s >= cusps[-1]):
                raise _Interrupted(
                    _TOO_FAR_OFF, f"{error.y:.3f} m and {error.yaw:.3f} rad off the path, {left:.3f} m left"
                )
            return False
        off = left_over[0] > settings.worth_position and abs(error.y) > sigma[0]
        turned = left_over[1] > settings.worth_yaw and abs(error.yaw) > sigma[1]
        self._where = f"{error.y:.4f} m and {error.yaw:.4f} rad off, {left:.3f} m before the end"
        return off or turned

    def _take(self, result: PlanResult) -> None:
        owner = self.owner
        owner._take(result)
        was_urgent, self._is_urgent = self._is_urgent, False
        self._pause = owner._settings.replan_pause
        if result.motion is None or (result.outcome is Outcome.STOP and not was_urgent):
            self._pause *= _AFTER_REFUSAL
            if was_urgent and result.outcome is Outcome.FAILED:
                raise _Interrupted("no way on", result.reason)
            return
        time, rate = self._reference
        ahead = result.starts_at - time
        if ahead < -_LATE:
            owner._report("plan came too late", f"{-ahead:.3f} s after it was to take over")
            self._is_urgent = was_urgent
            return
        start = owner._now + (ahead / rate if rate > 0.0 else 0.0)
        self._is_stop = result.outcome is Outcome.STOP
        self._give(result.motion, start)
        self._next_goal = start, result.motion.problem.goal
        self._become(result.motion)
        self._costmap, self._blocked = result.motion.problem.costmap, (math.inf, "")  # a newer one: in the next cycle
