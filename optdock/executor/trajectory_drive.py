"""Drive one motion: call the controller in every cycle, monitor the tube, and replan when a new motion is better."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING

import numpy as np

from optdock.controllers.motion_table import motion_table
from optdock.errors import ControllerException
from optdock.executor.dock_estimate import (
    DECAY,
    LONGEST_HIDDEN,
    NO_ROOM,
    SHORTEST_DECAY,
    can_be_planned_away,
    left_at_dock,
)
from optdock.executor.planning import Job, Outcome
from optdock.executor.planning_scene import FROM_REST
from optdock.executor.task_states import (
    SHORTER_WAY,
    TOO_FAR_OFF,
    AttemptFailed,
    EndingKind,
    Interrupted,
    State,
    TaskFailed,
)
from optdock.executor.tube_monitor import TubeMonitor
from optdock.geometry.pose import Pose2
from optdock.model.costs import LETHAL, NO_INFORMATION
from optdock.model.segments import TurnSegment
from optdock.plugins.lifecycle import LifecycleState, PluginContext

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.executor.control_cycles import Situation
    from optdock.executor.planning import DrivenMotion, PlanRequests, PlanResult
    from optdock.geometry.arrays import FloatArray
    from optdock.geometry.pose import Twist2
    from optdock.model.costmap import Costmap
    from optdock.model.problem import DockingProblem
    from optdock.plugins.interfaces import Controller, GoalChecker

__all__ = ["ShorterWay", "TrajectoryDrive"]

_PROGRESS = 0.05  # [s] on the clock of the trajectory that count as progress
_INSTANT = 1e-9  # [s]
_SETTLED = 3e-4, 5e-4  # [m/s], [rad/s] commanded at the end of the path: with usual gains 0.15 mm and 0.03 degrees
_NOISE_SIGMAS = 1.5  # standard deviations below which an error counts as noise
_NOISE_GAIN = 1.0  # [1/s]: noise of the commands over noise of the pose, with usual gains
_CHECK_PERIOD = 0.1  # [s] between two checks of the remaining error
_AFTER_REFUSAL = 3.0  # factor on the pause between plans after a failed plan
_LEAD = 0.06  # [s] beyond the budget: a period at 20 Hz until the result is polled, and a reserve
_LATE = 0.05  # [s]: a later takeover would move the reference by millimetres
_SLOWEST = 0.2  # of the planned speed: most drives still move at a fifth of the speed before a dock
_STALE_STOP = 0.3  # [s] beyond the braking time before an obstacle, at which waiting for a new plan ends

# A plan from rest after an obstacle has gone.
_FROM_REST_BUDGET = 0.2  # [s]; usual plans take 30 to 90 ms
_SHORTER, _STOPPING = 0.8, 1.0  # share of the remaining duration; [s] for the stop and a plan
_AROUND = 1.0  # [m] around the straight line to the goal in which obstacles are considered
_PAUSE = 3.0  # factor on the usual pause between two plans

_LATE_ENDINGS = {State.STAGING: EndingKind.FAILED_TO_STAGE, State.UNDOCKING: EndingKind.TIMEOUT}


class TrajectoryDrive:
    """Drive one motion, and replace it when replanning gives a better motion.

    Raises:
        AttemptFailed: If the controller cannot follow the motion.

    Attributes:
        motion: Motion being driven.
        docked: Kind of docking at the end of an approach; None if the robot is not known to be docked.
        deviation: Pose of the robot relative to the nearest pose of the path; None before the first cycle.
    """

    def __init__(  # noqa: PLR0913 - the parts of a drive
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
        self._next_goal: tuple[float, Pose2] | None = None  # and the time of its takeover [s]
        self._is_urgent = self._is_stop = False
        self._costmap = motion.problem.costmap
        self._shorter_way = ShorterWay(situation, motion.problem.costmap)
        self._is_from_rest = False  # whether the last job plans from rest
        self._blocked = math.inf, ""  # time on the motion's clock at which it reaches a new obstacle, and the obstacle
        self._checked_at, self._error_text = -math.inf, ""
        self._submitted_at, self._pause = -math.inf, situation.settings.replan_pause
        self._finished_since: float | None = None
        self._speed_share, self._hidden_reported = 1.0, False
        self._until = situation.now + motion.trajectory.duration + self._allowance
        requests.forget()
        goal_checker.reset()
        self._set_path(motion, None)
        self._become(motion)

    def _set_path(self, motion: DrivenMotion, start_stamp: float | None) -> None:
        """Configure the controller for a motion; raise AttemptFailed if the controller cannot follow the motion."""
        self._configure(motion)
        try:
            self._controller.set_path(motion.trajectory, start_stamp=start_stamp)
        except ControllerException as error:
            raise AttemptFailed(EndingKind.FAILED_TO_CONTROL, f"{type(error).__name__}: {error}") from error

    def _become(self, motion: DrivenMotion) -> None:
        """Replace the motion being driven."""
        self.motion, self._progress = motion, (-math.inf, self._situation.now)
        self._place = TubeMonitor(motion, self._situation.problem.robot, is_stop=self._is_stop, report=self._report)
        if self._is_approach and not self._is_stop:
            gears = [int(segment.direction) for segment in motion.trajectory.path.segments]
            self._situation.estimate.approach_gear = next((float(gear) for gear in reversed(gears) if gear), None)

    @property
    def _allowance(self) -> float:
        """Time [s] by which the drive may exceed the duration of its plan."""
        settings, state = self._situation.settings, self._state
        if state is State.STAGING:
            return settings.max_staging_time
        return settings.max_undocking_time if state is State.UNDOCKING else settings.dock_approach_timeout

    def is_over(self) -> bool:
        """Whether the motion ends in this cycle because its end is reached or the robot is docked.

        Raises:
            Interrupted: If the motion cannot continue.
            AttemptFailed: If an approach takes too long.
            TaskFailed: If a drive other than an approach takes too long.
        """
        situation = self._situation
        situation.require_no_interruption()
        if self._next_goal is not None and situation.now >= self._next_goal[0] - _INSTANT:
            self._goal, self._next_goal = self._next_goal[1], None
        if self._is_approach:
            self.docked = self._contact()
            if self.docked is not None:
                return True
            self._require_detection()
        if situation.now > self._until:
            reason = f"timeout while {self._state.value}: {situation.estimate.where}"
            if self._is_approach:
                raise AttemptFailed(EndingKind.FAILED_TO_CONTROL, reason)
            raise TaskFailed(_LATE_ENDINGS.get(self._state, EndingKind.FAILED_TO_CONTROL), reason)
        self._check_costmap()
        at_time, reason = self._blocked  # stop in time, even while another motion is being planned
        time, _ = self._reference
        if at_time - time < situation.braking_time + _STALE_STOP:
            raise Interrupted("obstacle ahead", reason)
        if time >= 0.0:
            has_left = self._place.update(situation.perception.robot, time)
            self.deviation = self._place.deviation
            self._is_urgent = self._is_urgent or has_left
        return self._is_finished(time)

    def command(self) -> Twist2:
        """Return the command of the controller.

        Raises:
            Interrupted: If there is no valid command, or the motion cannot continue.
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
        """Remove the speed limit of the controller."""
        self._limit_speed(1.0)

    def _require_detection(self) -> None:
        """Slow down while the dock is hidden; raise Interrupted if the last detection is too old."""
        situation, estimate = self._situation, self._situation.estimate
        uses_detections = situation.settings.use_detections
        is_hidden = uses_detections and estimate.is_hidden
        self._limit_speed(self._share_while_hidden() if is_hidden else 1.0)
        if uses_detections and estimate.detection_is_old and not is_hidden and estimate.left > NO_ROOM:
            place, turn = situation.perception.sigma
            age = situation.perception.detection_age
            reason = f"not detected for {age:.1f} s, sigma {place:.4f} m and {turn:.4f} rad"
            raise Interrupted("detection missing", reason)

    def _share_while_hidden(self) -> float:
        """Return the share of the planned speed at which corrections stay possible while the dock is hidden."""
        trajectory, age = self.motion.trajectory, self._situation.perception.detection_age
        until = self._place.time_at(trajectory.path.length - NO_ROOM)
        left = max(until - self._reference[0], 0.0)
        share = min(max(left / max(LONGEST_HIDDEN - age, _CHECK_PERIOD), _SLOWEST), 1.0)
        if not self._hidden_reported and share < 1.0:
            self._report("dock hidden", f"not detected for {age:.1f} s: at {100.0 * share:.0f} % of the speed")
            self._hidden_reported = True
        return share

    def _limit_speed(self, share: float) -> None:
        if share != self._speed_share:
            self._speed_share = share
            self._controller.set_speed_limit(100.0 * share if share < 1.0 else 0.0, True)  # noqa: FBT003 - Nav2's order

    @property
    def _pose(self) -> Pose2:
        """Pose for the controller; in an approach, relative to the dock, which may have moved since planning."""
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
        """Time of the reference on the clock of the trajectory [s], and its rate.

        For a controller that does not follow a time-based reference, this is the time at which the plan passes the
        position of the robot.
        """
        progress = getattr(self._controller, "progress", None)
        return (self._place.time, 1.0) if progress is None else (float(progress.time), float(progress.rate))

    def _contact(self) -> EndingKind | None:
        """Return the kind of docking: by contact, or by the goal checker once the robot has settled."""
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
        along, _, yaw = situation.estimate.errors()  # a lateral error can no longer be corrected
        is_noise = all(abs(error) <= _NOISE_SIGMAS * sigma for error, sigma, _ in (along, yaw))
        if moves and not is_noise and situation.now - self._finished_since < 0.5 * settings.settling_time:
            return None  # the feedback is still correcting the error
        path = [Pose2(-0.1 * situation.estimate.gear, 0.0, 0.0), goal]
        is_reached = self._goal_checker.is_goal_reached(relative, goal, situation.twist, path)
        return EndingKind.DOCKED_BY_DISTANCE if is_reached else None

    def _is_finished(self, time: float) -> bool:
        """Whether the motion ends at the time of the reference [s]."""
        situation, settings = self._situation, self._situation.settings
        now = situation.now
        if time >= self.motion.trajectory.duration - _INSTANT:
            if self._is_stop:
                raise Interrupted("stopped", "no certified continuation exists from the current state")
            self._finished_since = self._finished_since if self._finished_since is not None else now
            settles = self._is_approach or (
                self._state is State.UNDOCKING
                and not situation.staging.has_arrived_at((self._goal,), is_undocking=True)
            )
            return not settles or now - self._finished_since > settings.settling_time
        self._finished_since = None
        best, since = self._progress
        if time > best + _PROGRESS:
            self._progress = time, now
        elif now - since > settings.progress_time:
            raise Interrupted("no progress", f"the motion has stayed at its time {time:.2f} s for {now - since:.1f} s")
        return False

    def _check_costmap(self) -> None:
        """Check the rest of the motion against a new costmap."""
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
            self._shorter_way.check_next_costmap()
            return
        self._report("motion no longer valid", verdict.reason)
        self._blocked = verdict.at_time, verdict.reason
        self._is_urgent = True
        self._requests.forget()

    def _replan(self) -> None:
        """Take over the result of the last job, or submit a job if a new plan is useful."""
        situation, settings = self._situation, self._situation.settings
        if self._requests.pending:
            result = self._requests.result(situation.now)
            if result is not None:
                self._take_over(result)
            return
        is_asked = self._is_urgent or self._shorter_way.is_due or self._is_check_due
        if self._is_stop or self._next_goal is not None or not (settings.replanning and is_asked):
            return
        time, rate = self._reference
        if not self._is_urgent:
            if self._shorter_way.may_exist(self.motion, time, self._pose, self._costmap):
                here = situation.scene.to_dock() if self._is_approach else self.motion.problem
                self._report("plan requested", "from rest: an obstacle has gone")
                self._is_from_rest = True
                self._requests.submit(self._shorter_way.job(self.motion, time, here, self._costmap))
                return
            if not self._is_check_due:
                return
            self._checked_at = situation.now
            if not self._leaves_error(time) or situation.now - self._submitted_at < self._pause:
                return
            self._report("plan requested", self._error_text)
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
                # The poses passed to the controller are relative to the dock, so the motion ends at the present
                # estimate of the dock.
                moved=situation.perception.dock @ self._goal.inverse() if self._is_approach else None,
            )
        )

    @property
    def _is_check_due(self) -> bool:
        """Whether the error that an approach leaves at the dock has to be checked."""
        return self._is_approach and self._situation.now - self._checked_at >= _CHECK_PERIOD - _INSTANT

    def _leaves_error(self, time: float) -> bool:
        """Whether feedback would leave an error at the dock that is large enough to justify a new plan.

        Raises:
            Interrupted: If the remaining error would exceed the tolerances, and only a change of gear could correct it.
        """
        situation, settings = self._situation, self._situation.settings
        trajectory, perception = self.motion.trajectory, situation.perception
        if settings.use_detections and not perception.sees_dock:
            return False
        if not 0.0 <= time < trajectory.duration or isinstance(trajectory.path.segments[-1], TurnSegment):
            return False  # a turn at the end corrects the heading and leaves no distance for an offset
        (now,), gear = motion_table(trajectory).rows(time), situation.estimate.gear
        left = trajectory.path.length - now.s
        error = self._pose.in_frame_of(Pose2(now.x, now.y, now.yaw))
        limits, dock, sigma = situation.problem.robot.limits, situation.problem.dock, perception.sigma
        if not can_be_planned_away(error.y, error.yaw, left - dock.final_straight, gear, limits):
            cusps, accepted = trajectory.path.cusps, dock.tolerances
            left_over = [abs(part) for part in left_at_dock(error.y, error.yaw, left, gear, SHORTEST_DECAY)]
            off = left_over[0] > max(accepted.cross, 3.0 * sigma[0])
            turned = left_over[1] > max(accepted.yaw, 3.0 * sigma[1])
            if (off or turned) and (not cusps or now.s >= cusps[-1]):
                raise Interrupted(
                    TOO_FAR_OFF, f"{error.y:.3f} m and {error.yaw:.3f} rad off the path, {left:.3f} m left"
                )
            return False
        left_over = [abs(part) for part in left_at_dock(error.y, error.yaw, left, gear, DECAY)]
        off = left_over[0] > settings.worth_position and abs(error.y) > sigma[0]
        turned = left_over[1] > settings.worth_yaw and abs(error.yaw) > sigma[1]
        self._error_text = f"{error.y:.4f} m and {error.yaw:.4f} rad off, {left:.3f} m before the end"
        return off or turned

    def _take_over(self, result: PlanResult) -> None:
        """Take over a planned motion if it is useful.

        Raises:
            Interrupted: If there is no continuation, or a motion from rest is much shorter.
        """
        situation, settings = self._situation, self._situation.settings
        if self._is_from_rest:
            self._shorter_way.require_none(result, self.motion, self._reference[0])
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
            self._report("plan came too late", f"{-ahead:.3f} s after its takeover")
            self._is_urgent = was_urgent
            return
        start = situation.now + (ahead / rate if rate > 0.0 else 0.0)
        self._is_stop = result.outcome is Outcome.STOP
        self._set_path(result.motion, start)
        self._next_goal = start, result.motion.problem.goal
        self._become(result.motion)
        if was_urgent:  # other plans in motion follow the present way, which may avoid an obstacle that has gone
            self._shorter_way.compare_with(result.motion.problem.costmap)
        self._costmap, self._blocked = result.motion.problem.costmap, (math.inf, "")


class ShorterWay:
    """Search for a shorter motion from rest while a motion avoids an obstacle that has since disappeared."""

    def __init__(self, situation: Situation, planned_among: Costmap | None) -> None:
        self._situation, self._planned_among = situation, planned_among
        self._is_new = False
        self._submitted_at = -math.inf

    def compare_with(self, planned_among: Costmap | None) -> None:
        """Set the costmap whose obstacles the present motion avoids."""
        self._planned_among = planned_among

    def check_next_costmap(self) -> None:
        """Make the next call of `may_exist` compare its costmap with the costmap of the plan."""
        self._is_new = True

    @property
    def is_due(self) -> bool:
        """Whether a new costmap has to be compared, and enough time has passed since the last job."""
        pause = _PAUSE * self._situation.settings.replan_pause
        return self._is_new and self._situation.now - self._submitted_at >= pause

    def may_exist(self, motion: DrivenMotion, time: float, pose: Pose2, costmap: Costmap | None) -> bool:
        """Whether an obstacle has disappeared from the newest costmap and a plan from rest may be shorter.

        Args:
            motion: Motion being driven.
            time: Time of the reference on the clock of the motion [s].
            pose: Robot in the frame of the motion.
            costmap: Newest costmap; None without one.
        """
        situation, end = self._situation, motion.trajectory.path.end
        if not self.is_due:
            return False
        self._is_new = False
        least = pose.distance_to(end) / situation.problem.robot.limits.max_speed  # lower bound of any plan's duration
        before = self._planned_among
        if before is None or costmap is None or not self._is_better(least, motion, time):
            return False
        between = np.stack((situation.perception.robot.as_array()[:2], end.as_array()[:2]))
        return _has_gone(before, costmap, between, situation.problem.robot.footprint.circumscribed_radius + _AROUND)

    def job(self, motion: DrivenMotion, time: float, here: DockingProblem, costmap: Costmap | None) -> Job:
        """Return a job that plans from the pose of a stop, with this start and a new costmap in the problem `here`."""
        situation, trajectory = self._situation, motion.trajectory
        now = trajectory.at(min(max(time, 0.0), trajectory.duration))
        speed = abs(situation.twist.linear)
        stop = min(now.s + 0.5 * speed * situation.braking_time_from(speed), trajectory.path.length)
        start = Pose2.from_sequence(trajectory.path.poses_at(np.array([stop]))[0])
        self._submitted_at = situation.now
        problem = dataclasses.replace(here, start=start, costmap=costmap, **FROM_REST)
        return Job(0, situation.now, problem, _FROM_REST_BUDGET)

    def require_none(self, result: PlanResult, motion: DrivenMotion, time: float) -> None:
        """Check that the result of the job is not a reason to stop the motion.

        Raises:
            Interrupted: If the new motion is so much shorter that a stop is justified.
        """
        if result.motion is not None and self._is_better(result.motion.trajectory.duration, motion, time):
            left = motion.trajectory.duration - time
            reason = f"{result.motion.trajectory.duration:.1f} s from rest, {left:.1f} s of this one are left"
            raise Interrupted(SHORTER_WAY, reason)

    def _is_better(self, duration: float, motion: DrivenMotion, time: float) -> bool:
        """Whether a plan from rest of this duration [s] justifies a stop."""
        left = motion.trajectory.duration - time
        return self._situation.braking_time + _STOPPING + duration < _SHORTER * left


def _has_gone(before: Costmap, now: Costmap, places: FloatArray, reach: float) -> bool:
    """Whether an occupied cell has become free within `reach` [m] of the box around points, Shape (n, 2) [m]."""
    low, high = before.cell_of(np.stack((places.min(axis=0) - reach, places.max(axis=0) + reach)))
    (i, j), (i1, j1) = np.maximum(low, 0).tolist(), np.maximum(high + 1, 0).tolist()
    rows, columns = np.nonzero(before.data[j:j1, i:i1] == LETHAL)
    costs = now.cost_at(before.centre_of(np.column_stack((columns + i, rows + j))))
    return bool(np.any((costs != LETHAL) & (costs != NO_INFORMATION)))
