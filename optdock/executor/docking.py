"""`DockingExecutor`: computes one command per set of measurements, at any rate, until the task ends."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Literal, TypeAlias

from optdock.controllers.command_limits import CommandLimiter
from optdock.errors import InvalidValue
from optdock.executor.checked_inputs import CheckedDockType, Intake, usable
from optdock.executor.executor_settings import ExecutorSettings
from optdock.executor.log import LoggedPlanning, LogWriter, Task, plugin_choice
from optdock.executor.perception import Perception
from optdock.executor.planning import InlinePlanning
from optdock.executor.procedure import Procedure
from optdock.executor.simple_dock import SimpleDock
from optdock.executor.task_states import Ending, Event, Feedback, FeedbackState, State, Step
from optdock.geometry.checked import instance
from optdock.geometry.pose import Pose2, Twist2
from optdock.model.problem import DockingProblem
from optdock.model.robot import admissible
from optdock.plugins.interfaces import Controller, DockType, GoalChecker
from optdock.plugins.lifecycle import PluginContext
from optdock.plugins.registry import PluginChoice, plugin_from

if TYPE_CHECKING:
    from optdock.executor.planning import Planning
    from optdock.model.measurements import Measurements

__all__ = ["DockingExecutor"]

ControllerLike: TypeAlias = "str | PluginChoice | Controller"
GoalCheckerLike: TypeAlias = "str | PluginChoice | GoalChecker"
DockTypeLike: TypeAlias = "str | PluginChoice | DockType"

_FEEDBACK = {
    State.STAGING: FeedbackState.NAV_TO_STAGING_POSE,
    State.PERCEIVING: FeedbackState.INITIAL_PERCEPTION,
    State.APPROACHING: FeedbackState.CONTROLLING,
    State.PRESSING: FeedbackState.CONTROLLING,
    State.WAITING_FOR_DETECTION: FeedbackState.INITIAL_PERCEPTION,
    State.WAITING_FOR_CHARGE: FeedbackState.WAIT_FOR_CHARGE,
    State.BACKING_OUT: FeedbackState.RETRY,
    State.RETURNING: FeedbackState.RETRY,
}


# Settings that are parameters of the default `SimpleDock`; any other dock type has its own.
_SIMPLE_DOCK_SETTINGS = ("contact", "stall_speed", "stall_time", "wait_for_charge", "back_out_distance")
_STILL = 1e-8  # [m/s], [rad/s]: rounding of a completed stop, below the effect of any jerk limit
_TURNING = 0.005  # [m/s]: a robot that turns at a lower target speed counts as turning in place
_MOST_REPEATS = 25  # cycles with the same stamp: 20 for measurements at 10 Hz and control at 200 Hz, and a reserve
_LATE = 1.5  # factor on the usual period above which a cycle is late
_FIRST_PERIOD = 0.005  # [s] assumed until two cycles have passed: the period at 200 Hz, for small changes


class DockingExecutor:
    """Dock or undock a robot, one control cycle at a time; the caller provides the clock and the thread.

    Args:
        problem: Robot, stored dock, obstacles and clearance; the start of the problem is not used.
        settings: Settings of the executor; None: the default values.
        task: `dock` or `undock`.
        controller: Controller, given as a name, as a name with parameters, or as an unconfigured plugin.
        goal_checker: Goal checker that decides whether the robot is docked, given in the same ways as `controller`.
        dock_type: Dock type, given in the same ways as `controller`; None: a `SimpleDock` with parameters from the
            settings.
        planning: Planning interface that runs the jobs; None: `InlinePlanning`, whose results arrive after 20 ms on the
            clock of the stamps.
        log: Log to write; None: no log.
        last_command: Last command before the task, if the robot is in motion; None: the first measured velocity.

    Raises:
        InvalidValue: If an argument has the wrong type, the task is unknown, a parameter of a plugin is invalid, or a
            setting duplicates a parameter of the given `dock_type`.
        PluginError: If a plugin is unknown.
    """

    def __init__(  # noqa: PLR0913 - the parts of a task
        self,
        problem: DockingProblem,
        settings: ExecutorSettings | None = None,
        *,
        task: Literal["dock", "undock"] = "dock",
        controller: ControllerLike = "TrackingController",
        goal_checker: GoalCheckerLike = "DockGoalChecker",
        dock_type: DockTypeLike | None = None,
        planning: Planning | None = None,
        log: LogWriter | None = None,
        last_command: Twist2 | None = None,
    ) -> None:
        instance(DockingProblem, problem, "problem")
        self.settings = settings if settings is not None else ExecutorSettings()
        instance(ExecutorSettings, self.settings, "settings")
        if task not in ("dock", "undock"):
            raise InvalidValue(f"task: must be 'dock' or 'undock', got {task!r}")
        self.problem, self.task = problem, task
        driver = plugin_from(Controller, controller, "controller")
        checker = plugin_from(GoalChecker, goal_checker, "goal_checker")
        checker.configure(PluginContext(name=checker.name, problem=problem))
        kind = _dock_type(dock_type, self.settings)
        kind.configure(PluginContext(name=kind.name, problem=problem))
        self._dock_type = CheckedDockType(kind)
        self._events: list[Event] = []
        self._perception = Perception(problem.goal, self.settings, self._report)
        self._limiter = CommandLimiter()
        self._last_command = None if last_command is None else instance(Twist2, last_command, "last_command")
        self._moving = Twist2()  # the last target that was not a stop
        self._planning: Planning = planning if planning is not None else InlinePlanning()
        if log is not None:
            logged_kind = None if dock_type is None else plugin_choice(kind)
            choices = plugin_choice(driver), plugin_choice(checker), logged_kind
            log.begin(Task(problem, self.settings, task, *choices, last_command))
            self._planning = LoggedPlanning(self._planning, log, problem.frame)
        self._procedure = Procedure(
            problem, self.settings, self._perception, driver, checker, self._dock_type, self._planning, self._report
        )
        self._cycles = self._procedure.run(undock=task == "undock")
        self._log = log
        self._began: float | None = None
        self._last_stamp = -math.inf
        self._offset = 0.0
        self._usual_period, self._cycle_count = _FIRST_PERIOD, -1
        self._late: list[float] = []  # periods of the late cycles [s]
        self._repeats = 0
        self._faults: set[str] = set()  # of the last cycle
        self._detections_fail = False
        self._ending: Ending | None = None

    @property
    def ending(self) -> Ending | None:
        """Ending of the task; None while it runs."""
        return self._ending

    @property
    def state(self) -> State:
        """State of the task."""
        return State.ENDED if self._ending is not None else self._procedure.cycles.state

    @property
    def robot(self) -> Pose2 | None:
        """Estimated pose of the robot; None before the first measured pose."""
        return self._perception.robot if self._perception.started else None

    @property
    def dock(self) -> Pose2:
        """Estimated docked pose in the fixed frame."""
        return self._perception.dock

    def cancel(self) -> None:
        """Cancel the task: stop within the limits and end with `cancelled`."""
        if not self._procedure.cycles.cancelled:
            self._procedure.cycles.cancelled = True
            if self._log is not None:
                self._log.cancel()

    def step(self, measurements: Measurements) -> Step:
        """Run one control cycle; invalid measurements raise no exception.

        Args:
            measurements: Measurements since the last cycle, whose stamps may have any rate from 10 to 200 Hz. Fields of
                a wrong type or without a finite value are ignored and reported by the event `... not used`.
        """
        self._events.clear()
        robot, intake = self.problem.robot, usable(measurements)
        measurements = self._completed(intake)
        if self._began is None:
            before = measurements.twist if self._last_command is None else self._last_command
            self._limiter.restart(admissible(before, robot.limits, robot.drive))
            if self._limiter.command == Twist2():
                self._limiter.stop(_FIRST_PERIOD)
        self._watch_log()
        passed, period = self._tick(measurements.stamp)
        if passed > period:  # bases stop by themselves without commands
            self._limiter.restart(admissible(measurements.twist, robot.limits, robot.drive))
        now = max(self._perception.stamp, measurements.stamp + self._offset)  # against rounding of large stamps
        self._perception.update(self._with_dock_detections(measurements), now, self._offset)
        command = self._command(period)
        state = self.state
        deviation = self._procedure.cycles.deviation if self._ending is None else None
        step = Step(command, state, self._feedback(state), self._ending, tuple(self._events), deviation)
        if self._log is not None:
            self._log.cycle(measurements, step)
        return step

    def _completed(self, intake: Intake) -> Measurements:
        """Replace a missing stamp by the last stamp plus a period, and a missing twist by the last command."""
        found = intake.measurements
        if intake.faults or self._faults:
            for name, detail in intake.faults:
                if name not in self._faults:
                    self._report(name, detail)
            self._faults = {name for name, _ in intake.faults}
        if math.isnan(found.stamp):
            before = self._last_stamp if self._began is not None else 0.0
            found = found._replace(stamp=before + self._usual_period)
        if not intake.has_twist:
            found = found._replace(twist=self._limiter.command)
        self._perception.has_twist = intake.has_twist
        return found

    def _with_dock_detections(self, measurements: Measurements) -> Measurements:
        """Keep the detections that the dock type selects, or no detection if the dock type raises an exception."""
        failure = ""
        try:
            chosen = self._dock_type.detections(measurements)
        except Exception as error:  # the control cycle continues after any exception of a plugin
            chosen, failure = (), f"{type(error).__name__}: {error}"
        if failure and not self._detections_fail:
            self._report("detections not used", failure)
        self._detections_fail = bool(failure)
        return measurements if chosen is measurements.detections else measurements._replace(detections=chosen)

    def _watch_log(self) -> None:
        """Report once that the log can no longer be written; the task continues."""
        if self._log is not None and self._log.failure:
            self._report("log failed", self._log.failure)
            self._log = None

    def _report(self, name: str, detail: str = "") -> None:
        self._events.append(Event(self._perception.stamp if self._began is not None else 0.0, name, detail))

    def _tick(self, stamp: float) -> tuple[float, float]:
        """Return the time since the last cycle on the monotonic clock, and the time for changes of the command [s]."""
        before, self._last_stamp = self._last_stamp, stamp
        self._procedure.cycles.situation.interruption = ("", "")
        self._cycle_count += 1
        if self._began is None:
            self._began = stamp
            return 0.0, 0.0
        period, usual, longest = stamp - before, self._usual_period, self.settings.longest_tick
        self._repeats = self._repeats + 1 if period == 0.0 else 0
        if self._repeats > _MOST_REPEATS:
            self._offset += usual
            self._interrupt("clock stands still", f"the same stamp {self._repeats} times; now it increases again")
            return usual, usual
        if period < 0.0:
            self._offset += usual - period
            self._interrupt("clock went back", f"by {-period:.3f} s; the task continues with an internal clock")
            return usual, usual
        if period > longest:
            self._offset += longest - period
            self._interrupt("no cycle for long", f"{period:.3f} s passed since the last one")
            return longest, usual
        if period == 0.0:
            return 0.0, 0.0
        if self._cycle_count == 1:
            self._usual_period = period
        elif period > max(self.settings.late_tick, _LATE * usual):
            self._count_late(period)
        self._usual_period = min(period, _LATE * self._usual_period)  # one late cycle does not change the rate
        return period, period

    def _count_late(self, period: float) -> None:
        """Report the first late cycle; the number of all is reported at the end."""
        self._late.append(period)
        if len(self._late) == 1:
            self._report("late cycle", f"{period:.3f} s passed since the last one; further ones are counted")

    def _interrupt(self, name: str, reason: str) -> None:
        self._report(name, reason)
        self._procedure.cycles.situation.interruption = (name, reason)

    def _command(self, period: float) -> Twist2:
        procedure, target = self._procedure, None
        if self._ending is None:
            procedure.cycles.situation.commanded = self._limiter.command
            try:
                target = next(self._cycles)
            except StopIteration as over:
                kind, reason = over.value
                if len(self._late) > 1:
                    self._report("late cycles", f"{len(self._late)}, the longest of {max(self._late):.3f} s")
                self._ending = Ending(kind, reason, procedure.num_retries, self._perception.stamp)
                self._report(kind.value, reason)
                self._planning.close()
        return self._limited(target, period)

    def _limited(self, target: Twist2 | None, period: float) -> Twist2:
        """Limit the target, or a stop along the present curvature, to the robot's limits."""
        limiter, robot = self._limiter, self.problem.robot
        if period <= 0.0:
            return limiter.command
        if target is None and limiter.command == Twist2():
            limiter.stop(period)
            return limiter.command
        # A stop keeps the last target as its direction.
        self._moving = target if target is not None else self._moving
        turns = target is not None and abs(target.linear) < _TURNING and target.angular != 0.0
        wanted = target if target is not None else Twist2()
        command = limiter.follow(wanted, self._moving, period, robot.limits, robot.drive, in_place=turns)
        if target is None and abs(command.linear) < _STILL and abs(command.angular) < _STILL:
            limiter.round_to_rest()
        return limiter.command

    def _feedback(self, state: State) -> Feedback:
        perception = self._perception
        distance = math.inf
        if perception.started:
            relative = perception.robot_from_dock
            distance = math.hypot(relative.x, relative.y)
        passed = perception.stamp - (self._began or 0.0)
        return Feedback(_FEEDBACK.get(state, FeedbackState.NONE), self._procedure.num_retries, distance, passed)


def _dock_type(choice: DockTypeLike | None, settings: ExecutorSettings) -> DockType:
    """Return the chosen dock type, or a `SimpleDock` with the settings; raise InvalidValue if both are given."""
    described = {name: getattr(settings, name) for name in _SIMPLE_DOCK_SETTINGS}
    if choice is None:
        return SimpleDock(**described)
    kind = plugin_from(DockType, choice, "dock_type")
    fields = ExecutorSettings.model_fields
    twice = [name for name, value in described.items() if value != fields[name].default]
    if twice:
        raise InvalidValue(f"settings.{twice[0]}: must be a parameter of the given dock type, {type(kind).__name__}")
    return kind
