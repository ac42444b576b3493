"""One motion being driven: the controller is asked in every cycle, and the motion replanned where that is worth it."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING

from optdock.errors import ControllerException
from optdock.executor.approach import DECAY, SHORTEST_DECAY, can_be_planned_away, left_at_dock
from optdock.executor.dock_estimate import LONGEST_HIDDEN, NO_ROOM
from optdock.executor.interruptions import TOO_FAR_OFF, AttemptFailed, Interrupted, TaskFailed
from optdock.executor.planning import Job, Outcome
from optdock.executor.shorter_way import ShorterWay
from optdock.executor.task_states import EndingKind, State
from optdock.executor.tube_monitor import TubeMonitor
from optdock.geometry.pose import Pose2
from optdock.model.segments import TurnSegment
from optdock.plugins.lifecycle import LifecycleState, PluginContext

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.executor.plan_requests import PlanRequests
    from optdock.executor.planning import DrivenMotion, PlanResult
    from optdock.executor.situation import Situation
    from optdock.geometry.pose import Twist2
    from optdock.plugins.interfaces import Controller, GoalChecker

__all__ = ["TrajectoryDrive"]

_PROGRESS = 0.05  # [s] on the trajectory's own clock that count as progress
_INSTANT = 1e-9  # [s]
_SETTLED = 3e-4, 5e-4  # [m/s], [rad/s] commanded at the end of the path: by the usual gains 0.15 mm and 0.03 degrees
_OF_NOISE = 1.5  # standard deviations: a smaller error cannot be told from noise
_NOISE_GAIN = 1.0  # [1/s]: what noise makes of the commands, by the usual gains
_LOOK = 0.1  # [s] between two looks at what is left to be corrected
_AFTER_REFUSAL = 3.0  # times the usual pause: what could not be planned now cannot be planned a moment later
_LEAD = 0.06  # [s] beyond the budget: a period at 20 Hz until the result is asked for, and some
_LATE = 0.05  # [s]: a reference that jumps by so much at the speeds near a dock jumps by millimetres
_SLOWEST = 0.2  # of the planned speed: most drives still move at a fifth of the speed before a dock
_STALE_STOP = 0.3  # [s]: a motion that is proven wrong from later on than this may go on while another is planned

_LATE_ENDINGS = {State.STAGING: EndingKind.FAILED_TO_STAGE, State.UNDOCKING: EndingKind.TIMEOUT}


class TrajectoryDrive:
    """A motion that is driven; it becomes another one where replanning is worth it.

    Args:
        motion: To be driven, from rest.
        state: What for; `State.APPROACHING`: into the dock.
        situation: Of the robot, brought up to date before every cycle.
        controller: Drives.
        goal_checker: Says whether the robot stands in its dock.
        requests: Of other motions.
        report: Takes the name of an event and its detail.

    Raises:
        AttemptFailed: The controller cannot follow such a motion.

    Attributes:
        motion: What is driven now.
        docked: How the robot got into its dock, at the end of an approach; None: it is not known to stand there.
        deviation: The robot as seen from the path; None before the first cycle.
    """

    def __init__(  # noqa: PLR0913 - what it joins
        self,
        motion: DrivenMotion,
        state: State,
        *,
        situation: Situation,
        controller: Controller,
        goal_checker: GoalChecker,
        requests: PlanRequests,
        report: Callable[[str, str], None],
    ) -> None:
        self._state, self._is_approach = state, state is State.APPROACHING
        self._situation, self._controller, self._goal_checker = situation, controller, goal_checker
        self._requests, self._report = requests, report
        self.docked: EndingKind | None = None
        self.deviation: Pose2 | None = None
        self._goal = motion.problem.goal
        self._next_goal: tuple[float, Pose2] | None = None  # from when on [s]
        self._is_urgent = self._is_stop = False
        self._costmap = motion.problem.costmap  # a newer one is looked at in the first cycle
        self._shorter_way = ShorterWay(situation, motion.problem.costmap)
        self._is_from_rest = False  # what the last job was for
        self._blocked = math.inf, ""  # when the motion meets what was not there when it was planned, and what that is
        self._looked_at, self._where = -math.inf, ""
        self._submitted_at, self._pause = -math.inf, situation.settings.replan_pause
        self._finished_since: float | None = None
        self._speed_share, self._is_hidden_said = 1.0, False
        self._until = situation.now + motion.trajectory.duration + self._allowance
        requests.forget()
        goal_checker.reset()
        self._give(motion, None)
        self._become(motion)

    def _give(self, motion: DrivenMotion, start_stamp: float | None) -> None:
        """Hand a motion to the controller.

        Raises:
            AttemptFailed: It cannot follow such a one.
        """
        self._configure(motion)
        try:
            self._controller.set_path(motion.trajectory, start_stamp=start_stamp)
        except ControllerException as error:
            raise AttemptFailed(EndingKind.FAILED_TO_CONTROL, f"{type(error).__name__}: {error}") from error

    def _become(self, motion: DrivenMotion) -> None:
        """What is driven from now on."""
        self.motion, self._progress = motion, (-math.inf, self._situation.now)
        self._place = TubeMonitor(motion, self._situation.problem.robot, is_stop=self._is_stop, report=self._report)
        if self._is_approach and not self._is_stop:
            gears = [int(segment.direction) for segment in motion.trajectory.path.segments]
            self._situation.estimate.approach_gear = next((float(gear) for gear in reversed(gears) if gear), None)

    @property
    def _allowance(self) -> float:
        settings, state = self._situation.settings, self._state
        if state is State.STAGING:
            return settings.max_staging_time
        return settings.max_undocking_time if state is State.UNDOCKING else settings.dock_approach_timeout

    def is_over(self) -> bool:
        """Whether the motion ends in this cycle: its end is reached, or the robot is docked.

        Raises:
            Interrupted: It cannot go on.
            AttemptFailed: An approach takes too long.
            TaskFailed: Another drive does.
        """
        situation, settings = self._situation, self._situation.settings
        situation.require_no_interruption()
        if self._next_goal is not None and situation.now >= self._next_goal[0] - _INSTANT:
            self._goal, self._next_goal = self._next_goal[1], None
        if self._is_approach:
            self.docked = self._contact()
            if self.docked is not None:
                return True
            is_hidden = settings.use_detections and situation.estimate.is_hidden
            self._limit_speed(self._share_while_hidden() if is_hidden else 1.0)
            if (
                settings.use_detections
                and situation.estimate.detection_is_old
                and not is_hidden
                and situation.estimate.left > NO_ROOM
            ):
                place, turn = situation.perception.sigma
                reason = (
                    f"not seen for {situation.perception.detection_age:.1f} s, sigma {place:.4f} m and {turn:.4f} rad"
                )
                raise Interrupted("detection missing", reason)
        if situation.now > self._until:
            reason = f"timeout while {self._state.value}: {situation.estimate.where}"
            if self._is_approach:
                raise AttemptFailed(EndingKind.FAILED_TO_CONTROL, reason)
            raise TaskFailed(_LATE_ENDINGS.get(self._state, EndingKind.FAILED_TO_CONTROL), reason)
        self._look_around()
        self._stop_in_time()
        time, _ = self._reference
        if time >= 0.0:
            has_left = self._place.update(situation.perception.robot, time)
            self.deviation = self._place.deviation
            self._is_urgent = self._is_urgent or has_left
        return self._is_finished()

    def command(self) -> Twist2:
        """What the controller asks for.

        Raises:
            Interrupted: It has no command, or the motion cannot go on.
        """
        situation = self._situation
        measurements = situation.perception.measurements
        assert measurements is not None
        try:
            target = self._controller.compute_velocity_commands(
                self._pose, measurements.twist, self._goal_checker, stamp=situation.now
            )
        except ControllerException as error:
            raise Interrupted("no valid control", f"{type(error).__name__}: {error}") from error
        self._replan()
        return target

    def end(self) -> None:
        """Take back what the controller was asked for that is not part of the motion."""
        self._limit_speed(1.0)

    def _share_while_hidden(self) -> float:
        """At which share of the planned speed the dock may be seen again before it is too late for corrections.

        The way on which they are possible is stretched over the time for which a hidden dock is waited for.
        """
        trajectory, age = self.motion.trajectory, self._situation.perception.detection_age
        until = self._place.time_at(trajectory.path.length - NO_ROOM)
        left = max(until - self._reference[0], 0.0)
        share = min(max(left / max(LONGEST_HIDDEN - age, _LOOK), _SLOWEST), 1.0)
        if not self._is_hidden_said and share < 1.0:
            self._report("dock hidden", f"not seen for {age:.1f} s: at {100.0 * share:.0f} % of the speed")
            self._is_hidden_said = True
        return share

    def _limit_speed(self, share: float) -> None:
        if share != self._speed_share:
            self._speed_share = share
            self._controller.set_speed_limit(100.0 * share if share < 1.0 else 0.0, True)  # noqa: FBT003 - Nav2's order

    @property
    def _pose(self) -> Pose2:
        """The pose for the controller: that relative to the dock, which may have moved since the plan was made."""
        perception = self._situation.perception
        return self._goal @ perception.robot_from_dock if self._is_approach else perception.robot

    def _configure(self, motion: DrivenMotion) -> None:
        controller = self._controller
        if controller.state is LifecycleState.INACTIVE:
            controller.cleanup()
        costmap = self._situation.scene.costmap if self._situation.perception.costmap is not None else None
        controller.configure(PluginContext(name=controller.name, problem=motion.problem, local_costmap=costmap))

    @property
    def _reference(self) -> tuple[float, float]:
        """Time of the reference on the trajectory's own clock [s], and its rate.

        A controller that follows no trajectory in time has none: there it is when the plan would be where the robot is.
        """
        progress = getattr(self._controller, "progress", None)
        return (self._place.time, 1.0) if progress is None else (float(progress.time), float(progress.rate))

    def _contact(self) -> EndingKind | None:
        """How the robot is docked: contact is felt, or the goal checker says so once the robot has settled."""
        situation, settings = self._situation, self._situation.settings
        kind = situation.contact()
        if kind is not None:
            return kind
        if self._finished_since is None or situation.dock_type.is_pressed_on:
            return None
        still = [
            max(least, _NOISE_GAIN * sigma) for least, sigma in zip(_SETTLED, situation.perception.sigma, strict=True)
        ]
        moves = abs(situation.commanded.linear) > still[0] or abs(situation.commanded.angular) > still[1]
        relative, goal = situation.perception.robot_from_dock, Pose2(0.0, 0.0, 0.0)
        along, _, yaw = situation.estimate.errors()  # no way is left on which the error across could be corrected
        is_noise = all(abs(error) <= _OF_NOISE * sigma for error, sigma, _ in (along, yaw))
        if moves and not is_noise and situation.now - self._finished_since < 0.5 * settings.settling_time:
            return None  # what is left is still being corrected
        path = [Pose2(-0.1 * situation.estimate.gear, 0.0, 0.0), goal]
        is_reached = self._goal_checker.is_goal_reached(relative, goal, situation.twist, path)
        return EndingKind.DOCKED_BY_DISTANCE if is_reached else None

    def _is_finished(self) -> bool:
        situation, settings = self._situation, self._situation.settings
        now, (time, _) = situation.now, self._reference
        if time >= self.motion.trajectory.duration - _INSTANT:
            if self._is_stop:
                raise Interrupted("stopped", "nothing that is certified leads on from here")
            self._finished_since = self._finished_since if self._finished_since is not None else now
            if not self._is_approach:
                return True
            return now - self._finished_since > settings.settling_time
        self._finished_since = None
        best, since = self._progress
        if time > best + _PROGRESS:
            self._progress = time, now
        elif now - since > settings.progress_time:
            raise Interrupted("no progress", f"the motion stands at {time:.2f} s of its time since {now - since:.1f} s")
        return False

    def _look_around(self) -> None:
        """A new picture of the surroundings: does the rest of the motion still hold?"""
        situation = self._situation
        costmap = situation.scene.costmap
        if costmap is None or costmap is self._costmap:
            return
        self._costmap = costmap
        self._configure(self.motion)
        time, _ = self._reference
        verdict = self._requests.still_holds(self.motion, costmap, max(0.0, time))
        if verdict.holds:
            self._blocked = math.inf, ""
            self._shorter_way.look_again()
            return
        self._report("motion does not hold any more", verdict.reason)
        self._blocked = verdict.at_time, verdict.reason
        self._is_urgent = True
        self._requests.forget()

    def _stop_in_time(self) -> None:
        """Stop the robot in time before what is ahead, while a way round is being planned."""
        at_time, reason = self._blocked
        if at_time - self._reference[0] < self._situation.braking_time + _STALE_STOP:
            raise Interrupted("obstacle ahead", reason)

    def _replan(self) -> None:
        """Hand in a job where one is worth it, and take over what the last one gave."""
        situation, settings = self._situation, self._situation.settings
        if self._requests.pending:
            result = self._requests.result(situation.now)
            if result is not None:
                self._take(result)
            return
        if self._is_stop or self._next_goal is not None or not settings.replanning:
            return
        time, rate = self._reference
        if not self._is_urgent:
            if self._shorter_way.may_exist(self.motion, time, self._pose, self._costmap):
                here = situation.scene.to_dock() if self._is_approach else self.motion.problem
                self._report("plan asked for", "from rest: something that was in the way has gone")
                self._is_from_rest = True
                self._requests.submit(self._shorter_way.job(self.motion, time, here, self._costmap))
                return
            if not self._is_approach or situation.now - self._looked_at < _LOOK - _INSTANT:
                return
            self._looked_at = situation.now
            if not self._is_worth_it(time) or situation.now - self._submitted_at < self._pause:
                return
            self._report("plan asked for", self._where)
        problem = (
            situation.scene.to_dock()
            if self._is_approach
            else dataclasses.replace(self.motion.problem, costmap=self._costmap)
        )
        self._submitted_at, self._is_from_rest = situation.now, False
        budget = settings.replan_budget
        self._requests.submit(
            Job(
                0,
                situation.now,
                problem,
                budget,
                running=self.motion,
                time=time,
                rate=rate,
                pose=situation.perception.robot,
                lead=budget + _LEAD,
                # The controller is told where the robot is relative to the dock, so it follows the motion there.
                moved=situation.perception.dock @ self._goal.inverse() if self._is_approach else None,
            )
        )

    def _is_worth_it(self, time: float) -> bool:
        """Whether feedback would leave more of the present error at the dock than is worth a plan.

        Raises:
            Interrupted: More than the dock accepts would be left without another gear.
        """
        situation, settings = self._situation, self._situation.settings
        trajectory = self.motion.trajectory
        perception = situation.perception
        if settings.use_detections and not perception.sees_dock:
            return False
        if not 0.0 <= time < trajectory.duration or isinstance(trajectory.path.segments[-1], TurnSegment):
            return False  # a turn at the end takes back the heading, and no way is left for an offset
        now = trajectory.at(time)
        left = trajectory.path.length - now.s
        error = self._pose.in_frame_of(now.pose)
        limits, dock, sigma = situation.problem.robot.limits, situation.problem.dock, perception.sigma
        if not can_be_planned_away(error.y, error.yaw, left - dock.final_straight, situation.estimate.gear, limits):
            cusps, accepted = trajectory.path.cusps, dock.tolerances
            left_over = [
                abs(part) for part in left_at_dock(error.y, error.yaw, left, situation.estimate.gear, SHORTEST_DECAY)
            ]
            off = left_over[0] > max(accepted.cross, 3.0 * sigma[0])
            turned = left_over[1] > max(accepted.yaw, 3.0 * sigma[1])
            if (off or turned) and (not cusps or now.s >= cusps[-1]):
                raise Interrupted(
                    TOO_FAR_OFF, f"{error.y:.3f} m and {error.yaw:.3f} rad off the path, {left:.3f} m left"
                )
            return False
        left_over = [abs(part) for part in left_at_dock(error.y, error.yaw, left, situation.estimate.gear, DECAY)]
        off = left_over[0] > settings.worth_position and abs(error.y) > sigma[0]
        turned = left_over[1] > settings.worth_yaw and abs(error.yaw) > sigma[1]
        self._where = f"{error.y:.4f} m and {error.yaw:.4f} rad off, {left:.3f} m before the end"
        return off or turned

    def _take(self, result: PlanResult) -> None:
        """Take over what was planned, if it is of use.

        Raises:
            Interrupted: There is no way on, or a much shorter one from rest.
        """
        situation, settings = self._situation, self._situation.settings
        if self._is_from_rest:
            self._shorter_way.take(result, self.motion, self._reference[0])
            return
        was_urgent, self._is_urgent = self._is_urgent, False
        self._pause = settings.replan_pause
        if result.motion is None or (result.outcome is Outcome.STOP and not was_urgent):
            self._pause *= _AFTER_REFUSAL
            if was_urgent and result.outcome is Outcome.FAILED:
                raise Interrupted("no way on", result.reason)
            return
        time, rate = self._reference
        ahead = result.starts_at - time
        if ahead < -_LATE:
            self._report("plan came too late", f"{-ahead:.3f} s after it was to take over")
            self._is_urgent = was_urgent
            return
        start = situation.now + (ahead / rate if rate > 0.0 else 0.0)
        self._is_stop = result.outcome is Outcome.STOP
        self._give(result.motion, start)
        self._next_goal = start, result.motion.problem.goal
        self._become(result.motion)
        self._costmap, self._blocked = result.motion.problem.costmap, (math.inf, "")  # a newer one: in the next cycle
