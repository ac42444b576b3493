"""How a robot docks and undocks, from top to bottom: each `yield` is one control cycle.

What ends an attempt or the whole task early is raised and caught where it can be answered (`interruptions`). Every wait
has a name and a limit, and so has every motion.
"""

from __future__ import annotations

import dataclasses
import logging
import math
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from optdock.executor.drive import TrajectoryDrive
from optdock.executor.interruptions import (
    HELD,
    NOT_DOCKED,
    SHORTER_WAY,
    TOO_FAR_OFF,
    AttemptFailed,
    CancelRequested,
    Interrupted,
    NoWay,
    TaskFailed,
)
from optdock.executor.outcomes import EndingKind, State
from optdock.executor.plan_requests import PlanRequests
from optdock.executor.planning import Job, Outcome, PlanResult
from optdock.executor.situation import Situation
from optdock.geometry.pose import Pose2, Twist2
from optdock.model.trajectory import braking_time
from optdock.verification import pose_clearance
from optdock.verification.time_of_impact import free_motion

if TYPE_CHECKING:
    from collections.abc import Callable, Generator

    from optdock.executor.checked_dock_type import CheckedDockType
    from optdock.executor.perception import Perception
    from optdock.executor.planning import DrivenMotion, Planning
    from optdock.executor.settings import ExecutorSettings
    from optdock.geometry.arrays import FloatArray
    from optdock.model.problem import DockingProblem
    from optdock.plugins.interfaces import Controller, GoalChecker

__all__ = ["Procedure", "Wish"]

logger = logging.getLogger(__name__)

_REST_PATIENCE = 2.0  # [s]: an odometry that never says so must not hold the task up
_PLANNING_PATIENCE = 5.0  # [s] beyond its budget: a thread that shares its core is late, not dead
_CLEAR_OF_CONTACT = 0.005  # [m]: a way back is planned from there; nearer, noise could make an overlap of it
_BACK_OUT_SPEED = 0.1  # [m/s]: more than the dead band of either wheel, or the robot turns in contact
_SURELY_OUT = 0.03  # [m] more than the way in which nothing may turn: by what the estimate and the braking may be wrong
_BACK_OUT_LOOK = 0.5  # [s] ahead, of straight motions that no plan covers
# [m/s] of a wheel: in one period at 20 Hz by half a millimetre; and more than the dead bands of usual drives.
_SLOWEST_NUDGE, _FASTEST_NUDGE = 0.012, 0.12
_MOST_NUDGES = 10  # by each of which the part that a dead band leaves out grows by what is missing
_LEAST_FREE = 0.3  # of what is missing: less is not worth a motion
_DEAD_BAND = 0.004  # [m] left out of a motion: more than is left out by chance
_MOST_LEFT_OUT = 0.05  # [m]: a wheel that does not answer to that moves by no more
_ANSWER = 0.3  # [s], in which the drive and its odometry have answered to the last command
_CREEP = 1e-6  # [m/s]: no drive moves at it; steered wheels turn as its arc says
# [s] for a detection at rest in the dock: of ten a second, half of them lost, one of 1000 takes longer.
_CONFIRMATION = 1.0
_HIDDEN_FOR = 2.5  # [s] for whoever stands before a dock that has been seen from near, to walk on
# Standard deviations within its tolerances at which a robot stands in the dock: where it was seen there, and where it
# was not, as every detection of a camera that is blind there is from before.
_SURE_SEEN, _SURE_UNSEEN = 2.0, 1.0
_UNSURE_WAY = 0.04  # [m], on which it is to be seen twice: one detection may be wrong by less than is noticed
_UNSEEN_WAY = 0.015  # [m]: on less than that no wheel that slips turns a robot by a degree
_MOST_BLOCKS = 5  # stops on one approach, until it counts as failed
_INSTANT = 1e-9  # [s]

Wish: TypeAlias = "Twist2 | None"
"""What a cycle asks of the drive: a body velocity; None: stop."""
Cycles: TypeAlias = "Generator[Wish, None, None]"
_STOP = None


class Procedure:
    """One task.

    Args:
        problem: Robot, dock as stored, obstacles, clearance; its start plays no part.
        settings: How.
        perception: Brought up to date before every cycle.
        controller: Drives the motions.
        goal_checker: Says when the robot is docked.
        dock_type: Says where approaches begin, and what contact and charge are.
        planning: Makes them.
        report: Takes the name of an event and its detail.

    Attributes:
        situation: What is known; its `commanded` and `interruption` are to be set before every cycle.
        state: What is being done.
        num_retries: Approaches after the first one.
        cancelled: Set it to end the task.
        deviation: The robot as seen from the path that it drives; None where it drives none.
    """

    def __init__(  # noqa: PLR0913, PLR0917 - the parts that an executor joins
        self,
        problem: DockingProblem,
        settings: ExecutorSettings,
        perception: Perception,
        controller: Controller,
        goal_checker: GoalChecker,
        dock_type: CheckedDockType,
        planning: Planning,
        report: Callable[[str, str], None],
    ) -> None:
        self.situation = Situation(problem, settings, perception, dock_type, report)
        self._settings, self._dock_type, self._report = settings, dock_type, report
        self._controller, self._goal_checker = controller, goal_checker
        self._requests = PlanRequests(planning, report)
        self.state, self.num_retries = State.READY, 0
        self.cancelled = False
        self.deviation: Pose2 | None = None
        # Of short motions, by the dead bands of the left and the right wheel [m].
        self._left_out: FloatArray = np.zeros(2)
        self._ending, self._began, self._period = False, 0.0, 0.0

    # The whole.

    def run(self, *, undock: bool) -> Generator[Wish, None, tuple[EndingKind, str]]:
        """The task; its value is how it ended, the robot being at rest."""
        self._began = self._now
        try:
            self._dock_type.reset()
            self.situation.feel()
            kind, reason = yield from self._undock() if undock else self._dock()
        except CancelRequested:
            kind, reason = EndingKind.CANCELLED, f"while {self.state.value}"
        except TaskFailed as failure:
            kind, reason = failure.kind, failure.reason
        except Exception as error:  # whatever a plugin raises, the robot must come to rest under a name
            logger.exception("the task ends")
            kind, reason = EndingKind.UNKNOWN, f"{type(error).__name__}: {error}"
        self._ending = True
        yield from self._stop()
        return kind, reason

    def _dock(self) -> Generator[Wish, None, tuple[EndingKind, str]]:
        situation, settings = self.situation, self._settings
        yield from self._stop()
        yield from self._locate()
        if situation.has_signal and situation.is_near:
            return EndingKind.ALREADY_DOCKED, "the external signal says so"
        if (yield from self._stands_docked()):
            return EndingKind.ALREADY_DOCKED, situation.where
        if settings.navigate_to_staging_pose and situation.from_staging() > settings.prestaging_tolerance:
            yield from self._drive_to(situation.staging_poses, State.STAGING, EndingKind.FAILED_TO_STAGE)
        while True:
            try:
                yield from self._perceive_from_somewhere()
                kind = yield from self._approach()
                if self._dock_type.waits_for_charge:
                    yield from self._wait_for_charge()
                return kind, ""
            except AttemptFailed as failure:
                if self.num_retries >= settings.max_retries:
                    raise
                self._report("attempt failed", f"{failure.kind.value}: {failure.reason}")
                yield from self._stop()
                self.num_retries += 1
                is_blocked = isinstance(failure, NoWay)
            yield from self._back_out()
            yield from self._return(is_blocked=is_blocked)

    def _undock(self) -> Generator[Wish, None, tuple[EndingKind, str]]:
        situation = self.situation
        yield from self._stop()
        yield from self._locate()
        if not situation.is_near and not situation.has_signal:
            return EndingKind.NOT_DOCKED, f"the robot is {situation.distance:.3f} m from the dock"
        straight = max(self._dock_type.back_out_distance, situation.problem.dock.final_straight)
        yield from self._back_out(straight + _SURELY_OUT)
        yield from self._drive_to(situation.staging_poses, State.UNDOCKING, EndingKind.FAILED_TO_STAGE)
        return EndingKind.UNDOCKED, ""

    # Its parts, in the order in which they come.

    @property
    def _now(self) -> float:
        return self.situation.now

    def _cycle(self, wish: Wish) -> Cycles:
        """One control cycle.

        Raises:
            Cancelled: The caller wants an end.
            TaskFailed: The task takes too long.
        """
        before = self._now
        yield wish
        self._period = self._now - before
        if self._ending:
            return
        if self.cancelled:
            raise CancelRequested
        self.situation.feel()
        passed, timeout = self._now - self._began, self._settings.timeout
        if timeout is not None and passed > timeout:
            raise TaskFailed(EndingKind.TIMEOUT, f"{passed:.1f} s passed while {self.state.value}")

    def _stop(self) -> Cycles:
        """Brake, until commands and odometry say that the robot stands."""
        situation, before, since = self.situation, self.state, self._now
        self.deviation = None
        while not situation.stands:
            self.state = State.STOPPING
            if situation.is_commanded_to_rest and self._now - since > _REST_PATIENCE + situation.braking_time:
                self._report("odometry does not come to rest", f"{situation.twist.linear:.3f} m/s commanded 0")
                break
            yield from self._cycle(_STOP)
        self.state = before

    def _locate(self) -> Cycles:
        """At rest until robot and surroundings are known as they are now.

        Raises:
            TaskFailed: They are not, for too long.
        """
        situation, settings = self.situation, self._settings
        while situation.is_held:
            self.state = State.HELD
            yield from self._cycle(_STOP)
        self.state = State.WAITING_FOR_POSE
        since, perception = self._now, situation.perception
        while not situation.is_located:
            if self._now - since > settings.localization_timeout:
                missing = "odometry" if perception.started and perception.twist_age > settings.pose_patience else "pose"
                raise TaskFailed(EndingKind.UNKNOWN, f"no {missing} for {self._now - since:.1f} s")
            yield from self._cycle(_STOP)
        while situation.is_blind:
            self.state = State.WAITING_FOR_COSTMAP
            if self._now - since > settings.costmap_timeout:
                raise TaskFailed(EndingKind.FAILED_TO_CONTROL, f"no costmap for {perception.costmap_age:.1f} s")
            yield from self._cycle(_STOP)

    def _stands_docked(self) -> Generator[Wish, None, bool]:
        """Whether the robot stands in its dock before anything is done, as a dock without a signal cannot tell."""
        situation, settings = self.situation, self._settings
        needs_signal = self._dock_type.is_pressed_on or self._dock_type.waits_for_charge
        if needs_signal or not situation.is_near:
            return False
        self.state, since = State.PERCEIVING, self._now
        while settings.use_detections and not situation.is_dock_known:
            if self._now - since >= _CONFIRMATION:
                return False
            yield from self._cycle(_STOP)
        return situation.will_know(0.0) and situation.stands_in_dock(0.0) and not situation.may_have_turned

    def _perceive_from_somewhere(self) -> Cycles:
        """Look at the dock from here; where it is not seen, from a staging pose.

        A dock that is entered in reverse is behind a camera in front. So it is looked at from a staging pose turned
        round as well; from there the way in is the odometry's, as far as that is good enough.

        Raises:
            TaskFailed: It is not seen from anywhere, or the robot does not get there.
        """
        situation = self.situation
        views = [situation.staging_poses, *([situation.facing_poses] if situation.gear < 0.0 else [])]
        while True:
            views = [places for places in views if situation.may_see_dock_from(places())]
            is_worth_it = situation.may_see_dock_from((situation.perception.robot,))
            try:
                if is_worth_it or situation.is_dock_found or not views:
                    return (yield from self._perceive())
            except TaskFailed as failure:
                while views and situation.has_arrived_at(views[0]()):
                    views.pop(0)
                if not views:
                    raise
                self._report("dock not seen from here", failure.reason)
            yield from self._drive_to(views.pop(0), State.STAGING, EndingKind.FAILED_TO_STAGE)

    def _perceive(self) -> Cycles:
        """Look at the dock, at rest, until it has been seen often enough.

        Raises:
            TaskFailed: It is not seen.
        """
        settings, perception = self._settings, self.situation.perception
        if not settings.use_detections or self.situation.is_dock_found:
            return
        self.state = State.PERCEIVING
        since, before = self._now, perception.detections
        while perception.detections - before < settings.least_detections:
            if self._now - since > settings.initial_perception_timeout:
                found, far = perception.detections - before, perception.too_far
                raise TaskFailed(
                    EndingKind.FAILED_TO_DETECT_DOCK,
                    f"{found} detections in {self._now - since:.1f} s, needed are {settings.least_detections}; "
                    f"{perception.rejected} were rejected so far"
                    + (f"; the last was {far:.3f} m from the stored dock, which is another one" if far else ""),
                )
            yield from self._cycle(_STOP)

    def _approach(self) -> Generator[Wish, None, EndingKind]:
        """Plan from rest and drive; from wherever something stops the robot, plan again.

        Raises:
            AttemptFailed: It is stopped too often.
        """
        blocks, blocked_since = 0, self._now
        self._dock_type.reset()
        while True:
            result = yield from self._planned_from_rest(blocked_since)
            if result.motion is None:
                continue
            try:
                return (yield from self._attempt(result.motion))
            except Interrupted as stopped:
                self._say_why(stopped)
                yield from self._stop()
                is_off = stopped.name in {TOO_FAR_OFF, NOT_DOCKED}
                is_moved = stopped.name != HELD and (yield from self._nudge())
                if (stopped.name != NOT_DOCKED or is_moved) and (yield from self._has_arrived()):
                    return EndingKind.DOCKED_BY_DISTANCE
                if blocks == 0 or self._now - blocked_since > 2.0 * self._settings.obstacle_patience:
                    blocked_since = self._now
                blocks += stopped.name not in {HELD, SHORTER_WAY}
                if blocks > _MOST_BLOCKS:
                    reason = f"stopped {blocks} times on one approach, last: {stopped.name}: {stopped.reason}"
                    raise AttemptFailed(EndingKind.FAILED_TO_CONTROL, reason) from None
                if is_off:
                    yield from self._back_out()  # where the robot may touch the station
                yield from self._wait_for_detection()

    def _planned_from_rest(self, since: float) -> Generator[Wish, None, PlanResult]:
        """A plan into the dock; where there is none, after a wait for the obstacle in the way.

        Args:
            since: When there was a way last [s].

        Raises:
            NoWay: There has been none for too long.
        """
        yield from self._locate()
        result = yield from self._planned(self.situation.to_dock())
        if result.motion is None:
            if self.situation.is_near:
                yield from self._back_out()  # in contact with the station nothing can be planned
            yield from self._wait_for_obstacle(result, since)
        return result

    def _attempt(self, motion: DrivenMotion) -> Generator[Wish, None, EndingKind]:
        """Drive a motion into the dock, and see that the robot stands in it.

        Raises:
            Interrupted: It does not.
            AttemptFailed: Nobody knows.
        """
        docked = yield from self._drive(motion, State.APPROACHING)
        if docked is None and self._dock_type.is_pressed_on:
            return (yield from self._press())
        yield from self._stop()
        if docked is EndingKind.DOCKED_BY_SIGNAL and not self.situation.has_signal:
            self._report("contact lost again", self.situation.where)  # the feedback was taking the robot back
            docked = yield from self._press()
        if not self._dock_type.is_pressed_on:
            yield from self._confirm()
            if (yield from self._nudge()):
                yield from self._confirm()
        return docked or EndingKind.DOCKED_BY_DISTANCE

    def _has_arrived(self) -> Generator[Wish, None, bool]:
        """Whether a robot that was stopped on its way into the dock stands in it, as one does that rolls on."""
        situation = self.situation
        if self._dock_type.is_pressed_on or situation.is_held:
            return False
        if not (situation.will_know(0.0) and situation.stands_in_dock(_SURE_SEEN)):
            return False
        try:
            yield from self._confirm()
        except (Interrupted, AttemptFailed):
            return False
        return True

    def _confirm(self) -> Cycles:
        """Look once more, at rest: a wheel that slipped on the last centimetres is seen by the detector alone.

        Raises:
            Interrupted: The robot stands elsewhere.
            AttemptFailed: Nobody knows where.
        """
        situation, perception, since = self.situation, self.situation.perception, self._now
        if self._settings.use_detections:
            while (
                perception.moved_since_seen() > _UNSEEN_WAY
                or perception.moved_since_seen(2) > _UNSURE_WAY
                or situation.is_in_doubt
            ):
                patience = _HIDDEN_FOR if situation.sees_from_near else _CONFIRMATION
                if situation.may_have_turned:
                    patience = self._settings.initial_perception_timeout
                if self._now - since >= patience:
                    break
                yield from self._cycle(_STOP)
        self._require_certainty()
        is_seen = perception.moved_since_seen() <= _UNSEEN_WAY
        if not situation.stands_in_dock(_SURE_SEEN if is_seen else _SURE_UNSEEN):
            raise Interrupted(NOT_DOCKED, situation.where)

    def _nudge(self) -> Generator[Wish, None, bool]:
        """Move by what is missing, at rest before or in the dock, where no way is left to correct an error on.

        Returns:
            Whether the robot was moved.
        """
        missing = self.situation.nudge_to_dock
        for number in range(_MOST_NUDGES):
            if not (yield from self._nudge_once()):
                return number > 0
            if number == 0:
                self._report("nudged", f"by {missing.linear:.4f} m and {missing.angular:.4f} rad")
        return True

    def _nudge_once(self) -> Generator[Wish, None, bool]:
        """As `_nudge`, one motion of it.

        What the dead band of a wheel leaves out of one motion is added to the next. A drive that has left something out
        moves one wheel at a time: the wheel with the smaller dead band would else answer alone, and turn the robot.
        """
        situation, perception, footprint = self.situation, self.situation.perception, self.situation.footprint
        missing, robot = situation.nudge_to_dock, perception.robot
        has_dead_band = float(self._left_out.max()) > _DEAD_BAND
        if missing == Twist2() or (has_dead_band and situation.stands_in_dock(_SURE_SEEN)):
            return False
        # First the turn: the way ahead is then straight, and the limits of the two do not mix.
        way = 0.0 if missing.angular and not has_dead_band else missing.linear
        left, right = situation.rims(way, missing.angular)
        if has_dead_band:
            left, right = (left, 0.0) if abs(left) > abs(right) else (0.0, right)
        motion = situation.body_motion(left, right)
        reach = footprint.circumscribed_radius + abs(motion.linear) + _MOST_LEFT_OUT
        everything, others = situation.near(robot, reach), situation.near(robot, reach, with_station=False)
        free = free_motion(footprint, everything, robot, motion, 1.0, overlap=situation.reach_of_contact).free
        ways = np.array([free * left, free * right])
        asked = situation.body_motion(*(ways + np.sign(ways) * self._left_out).tolist())
        # If nothing is left out this time, the robot presses against its station, and against nothing else.
        if free < _LEAST_FREE or free_motion(footprint, others, robot, asked, 1.0).free < 1.0:
            return False
        before = np.array(situation.rims(perception.forward, perception.turned))
        try:
            yield from self._roll(asked)
        except Interrupted as stopped:
            self._say_why(stopped)
            yield from self._stop()
            return False
        moved = np.array(situation.rims(perception.forward, perception.turned)) - before
        self._left_out = np.clip(self._left_out + np.sign(ways) * (ways - moved), 0.0, _MOST_LEFT_OUT)
        return True

    def _roll(self, motion: Twist2) -> Cycles:
        """Command a short motion from rest, and wait until the drive has answered.

        Its end is found by integrating the commands, so the delay of the drive has no part in it.

        Args:
            motion: Way [m] and turn [rad] as a whole.

        Raises:
            Interrupted: The robot cannot go on.
        """
        situation, limits = self.situation, self.situation.problem.robot.limits
        way = max(map(abs, situation.rims(motion.linear, motion.angular)))  # of the faster wheel
        straight = limits.max_speed, min(limits.max_acceleration, limits.max_deceleration), limits.max_jerk
        turning = limits.turning.rate, limits.turning.acceleration, math.inf  # the jerk of a turn is not limited
        shares = max(abs(motion.linear) / way, _INSTANT), max(abs(motion.angular) / way, _INSTANT)
        highest, acceleration, jerk = (
            min(s / shares[0], t / shares[1]) for s, t in zip(straight, turning, strict=True)
        )
        fastest, rolled, was_felt = min(_FASTEST_NUDGE, highest), 0.0, False
        while True:
            situation.require_no_interruption()
            is_felt = situation.contact() is not None and motion.linear * situation.gear > _INSTANT
            if is_felt and was_felt:  # a switch that flickers farther out is no reason to stay there
                break
            was_felt = is_felt
            speed = max(map(abs, situation.rims(situation.commanded.linear, situation.commanded.angular)))
            rolled += speed * self._period
            left = way - rolled - 0.5 * speed * braking_time(speed, acceleration, jerk)
            if left <= 0.0:
                break
            rate = min(max(0.5 * left / max(self._period, _INSTANT), _SLOWEST_NUDGE), fastest) / way
            yield from self._cycle(Twist2(rate * motion.linear, rate * motion.angular))
        since = self._now
        while self._now - since < _ANSWER:
            yield from self._cycle(_STOP)
        yield from self._stop()

    def _require_certainty(self) -> None:
        """Raises AttemptFailed if nobody knows whether the robot stands in its dock."""
        situation, perception = self.situation, self.situation.perception
        kind, unknown = EndingKind.FAILED_TO_DETECT_DOCK, "it cannot be known whether the robot is docked"
        if perception.is_contradicted:
            raise AttemptFailed(kind, "the last detections contradict where the dock was")
        if situation.may_have_turned:
            raise AttemptFailed(
                kind,
                f"{unknown}: the localization has turned by {perception.unseen_turn:.3f} rad against the odometry, and "
                f"the dock was not seen since",
            )
        if not situation.will_know(0.0):
            sigma = perception.sigma_after(0.0)
            raise AttemptFailed(
                kind,
                f"{unknown}: not seen for {perception.detection_age:.1f} s, standard deviations {sigma.along:.4f} m "
                f"along, {sigma.cross:.4f} m across, {sigma.yaw:.4f} rad",
            )

    def _wait_for_detection(self) -> Cycles:
        """Where the dock has not been seen for long, look for it again.

        Raises:
            AttemptFailed: It is not seen.
        """
        situation, perception, settings = self.situation, self.situation.perception, self._settings
        is_needed = situation.detection_is_old
        if not settings.use_detections or not (is_needed or situation.is_dock_hidden):
            return
        since, before, self.state = self._now, perception.detections, State.WAITING_FOR_DETECTION
        while perception.detections - before < (settings.least_detections if is_needed else 1):
            waited = self._now - since
            if waited > settings.initial_perception_timeout:
                reason = f"the dock has not been seen for {perception.detection_age:.1f} s"
                raise AttemptFailed(EndingKind.FAILED_TO_DETECT_DOCK, reason)
            if not (is_needed or situation.is_dock_hidden):
                return
            yield from self._cycle(_STOP)

    def _wait_for_obstacle(self, result: PlanResult, since: float) -> Cycles:
        """No way from here: wait for another picture of the surroundings, or some time, and try again.

        Raises:
            NoWay: There has been none for too long.
        """
        patience, perception = self._settings.obstacle_patience, self.situation.perception
        if self._now - since >= patience:
            raise NoWay(EndingKind.FAILED_TO_CONTROL, f"no way to the dock: {result.reason}")
        self.state = State.WAITING_FOR_OBSTACLE
        seen, until = perception.costmap, min(self._now + 1.0, since + patience)
        self._report("no way", result.reason)
        while self._now < until and perception.costmap is seen:
            yield from self._cycle(_STOP)

    def _planned(self, problem: DockingProblem) -> Generator[Wish, None, PlanResult]:
        """The result of a plan from rest."""
        self.state = State.PLANNING
        since, budget = self._now, self._settings.time_budget
        number = self._requests.submit(Job(0, since, problem, budget))
        while True:
            yield from self._cycle(_STOP)
            result = self._requests.result(self._now)
            if result is not None:
                return result
            if self._now - since > budget + _PLANNING_PATIENCE:
                return PlanResult(number, Outcome.FAILED, reason="planning does not answer")

    def _planned_to(self, places: tuple[Pose2, ...]) -> Generator[Wish, None, PlanResult]:
        """The result of a plan to the first pose to which there is one; else that of the last."""
        *others, last = places
        for number, place in enumerate(others, start=1):
            result = yield from self._planned(self.situation.to(place))
            if result.motion is not None:
                return result
            self._report("no way to a staging pose", f"number {number} of {len(others) + 1}: {result.reason}")
        return (yield from self._planned(self.situation.to(last)))

    def _return(self, *, is_blocked: bool) -> Cycles:
        """To a staging pose; where no way led into the dock, only if one leads to a staging pose and from there in.

        Raises:
            TaskFailed: The robot does not get there.
        """
        if not is_blocked:
            yield from self._drive_to(self.situation.staging_poses, State.RETURNING, EndingKind.FAILED_TO_CONTROL)
            return
        found = yield from self._staging_pose_on_a_way()
        if found is None:
            self._report("no way from a staging pose", "the next attempt begins here")
        else:
            yield from self._drive_to(lambda: (found,), State.RETURNING, EndingKind.FAILED_TO_CONTROL)

    def _staging_pose_on_a_way(self) -> Generator[Wish, None, Pose2 | None]:
        """The first staging pose to which there is a plan, and from there one into the dock; None if there is none."""
        situation = self.situation
        for place in situation.staging_poses():
            if (yield from self._planned(situation.to(place))).motion is None:
                continue
            into_dock = dataclasses.replace(situation.to_dock(), start=place)
            if (yield from self._planned(into_dock)).motion is not None:
                return place
        return None

    def _drive(self, motion: DrivenMotion, state: State) -> Generator[Wish, None, EndingKind | None]:
        """Drive a motion to its end, replanned on the way where that is worth it.

        Returns:
            How the robot got into its dock; None where it is not known to stand there.

        Raises:
            Interrupted: It cannot go on.
            AttemptFailed: An approach that cannot succeed any more.
            TaskFailed: Another drive that takes too long.
        """
        self.state = state
        drive = TrajectoryDrive(
            motion,
            state,
            situation=self.situation,
            controller=self._controller,
            goal_checker=self._goal_checker,
            requests=self._requests,
            report=self._report,
        )
        try:
            while not drive.is_over():
                self.deviation = drive.deviation
                yield from self._cycle(drive.command())
        finally:
            drive.end()
        return drive.docked

    def _press(self) -> Generator[Wish, None, EndingKind]:
        """Straight on along the dock's axis, slowly, until contact is felt and lasts.

        Raises:
            Interrupted: It cannot go on.
            AttemptFailed: No contact is felt.
        """
        situation, settings = self.situation, self._settings
        self.state = State.PRESSING
        gear, speed = situation.gear, settings.contact_speed
        allowed = settings.contact_overrun + abs(situation.perception.robot_from_dock.x)
        until = self._now + _REST_PATIENCE + 2.0 * allowed / speed
        while True:
            situation.require_no_interruption()
            kind = situation.contact()
            if kind is not None:
                yield from self._stop()
                if kind is not EndingKind.DOCKED_BY_SIGNAL or situation.has_signal:
                    return kind
            beyond = gear * situation.perception.robot_from_dock.x
            if beyond > settings.contact_overrun or self._now > until:
                raise AttemptFailed(EndingKind.FAILED_TO_CONTROL, f"no contact: {situation.where}")
            yield from self._cycle(Twist2(gear * speed))

    def _wait_for_charge(self) -> Cycles:
        """At rest until the battery is charged.

        Raises:
            AttemptFailed: It does not.
        """
        self.state, since = State.WAITING_FOR_CHARGE, self._now
        while not self.situation.is_charging:
            if self._now - since > self._settings.wait_charge_timeout:
                raise AttemptFailed(
                    EndingKind.FAILED_TO_CHARGE, f"no signal for {self._now - since:.1f} s: {self.situation.where}"
                )
            yield from self._cycle(_STOP)

    def _back_out(self, least: float = 0.0) -> Cycles:
        """Straight out of contact, no deeper into anything, until a way back can be planned.

        Args:
            least: So far in any case, if nothing is in the way [m].
        """
        situation = self.situation
        direction, footprint = -situation.gear, situation.footprint
        begun_at, begun, is_straight = situation.perception.way, self._now, False
        braking = 0.5 * _BACK_OUT_SPEED * situation.braking_time_from(_BACK_OUT_SPEED)
        farthest = max(least, self._dock_type.back_out_distance)
        limit = 2.0 * farthest / _BACK_OUT_SPEED + _REST_PATIENCE
        while True:
            yield from self._locate()
            robot = situation.perception.robot
            driven = situation.perception.way - begun_at  # the dock may be seen elsewhere meanwhile
            near = situation.near(robot, footprint.circumscribed_radius + _CLEAR_OF_CONTACT)
            if driven >= least - braking and pose_clearance(robot, footprint, near)[0] >= _CLEAR_OF_CONTACT:
                break
            self.state = State.BACKING_OUT
            if driven >= farthest - braking or self._now - begun > limit:
                break
            twist = Twist2(direction * _BACK_OUT_SPEED)
            deepest = situation.reach_of_contact  # by estimates and bumpers that yield, or pressed in by late commands
            if free_motion(footprint, near, robot, twist, _BACK_OUT_LOOK, overlap=deepest).free < _BACK_OUT_LOOK:
                self._report("backing out is blocked", f"after {driven:.3f} m")
                break
            if not is_straight:
                yield from self._straighten(direction)
                begun, is_straight = self._now, True
                continue
            yield from self._cycle(twist)
        yield from self._stop()

    def _straighten(self, gear: float) -> Cycles:
        """At rest until the wheels of a robot that steers stand straight, wherever they may stand now."""
        until = self._now + self.situation.problem.robot.limits.steering_time_to(0.0)
        while self._now < until - _INSTANT:
            yield from self._cycle(Twist2(gear * _CREEP))

    def _drive_to(self, places: Callable[[], tuple[Pose2, ...]], state: State, failure: EndingKind) -> Cycles:
        """Along a certified path to one of some poses; what stops the robot is planned around, or ends the task.

        Args:
            places: In the fixed frame, the preferred one first, as the dock is known now.
            state: What for.
            failure: What it is if the robot does not get there.

        Raises:
            TaskFailed: The robot does not get there; of the kind `failure`.
        """
        situation = self.situation
        blocks, since = 0, self._now
        while True:
            yield from self._locate()
            if situation.has_arrived_at(places()):
                return
            result = yield from self._planned_to(places())
            if result.motion is None:
                if self._now - since > self._settings.obstacle_patience:
                    raise TaskFailed(failure, f"no way to the staging pose: {result.reason}")
                try:
                    yield from self._wait_for_obstacle(result, since)
                except AttemptFailed as over:
                    raise TaskFailed(failure, over.reason) from None
                continue
            try:
                yield from self._drive(result.motion, state)
                yield from self._stop()
                return
            except Interrupted as stopped:
                self._say_why(stopped)
                yield from self._stop()
                blocks += stopped.name not in {HELD, SHORTER_WAY}
                since = self._now
                if blocks > _MOST_BLOCKS:
                    raise TaskFailed(failure, f"{stopped.name}: {stopped.reason}") from None

    def _say_why(self, stopped: Interrupted) -> None:
        if stopped.name != self.situation.interruption[0]:  # that has been said already
            self._report(stopped.name, stopped.reason)
