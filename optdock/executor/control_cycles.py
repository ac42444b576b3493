"""State of a task between control cycles, and the generators for one cycle, a stop and a wait for a pose.

Every `yield` of the executor's generators is one control cycle.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

from optdock.executor.dock_estimate import DockEstimate
from optdock.executor.planning_scene import PlanningScene, StagingPoses
from optdock.executor.task_states import HELD, CancelRequested, EndingKind, Interrupted, State, TaskFailed
from optdock.geometry.pose import Twist2
from optdock.model.measurements import AtDock
from optdock.plugins.outcomes import Contact

if TYPE_CHECKING:
    from collections.abc import Callable, Generator

    from optdock.executor.checked_inputs import CheckedDockType
    from optdock.executor.executor_settings import ExecutorSettings
    from optdock.executor.perception import Perception
    from optdock.geometry.pose import Pose2
    from optdock.model.problem import DockingProblem

__all__ = ["REST_PATIENCE", "STOP", "ControlCycles", "Cycles", "Situation", "Target"]

REST_PATIENCE = 2.0  # [s]: longest wait for the odometry to reach zero
_AT_REST = 0.01, 0.02  # [m/s], [rad/s] by odometry, with the noise of encoders
# [m], [s] for which odometry replaces the localization while the dock is detected: with a wheel error of 1 % the error
# is 1 cm, a fifth of a usual clearance, and the last metre before a dock takes less time.
_UNLOCATED = 1.0, 10.0
_LOCATED = 0.01  # [m]: standard deviation up to which odometry may replace the localization
_DOCKED_BY = {Contact.SIGNAL: EndingKind.DOCKED_BY_SIGNAL, Contact.STALL: EndingKind.DOCKED_BY_STALL}

Target: TypeAlias = "Twist2 | None"
"""Target velocity of a cycle; None: stop."""
Cycles: TypeAlias = "Generator[Target, None, None]"
STOP = None


class Situation:
    """Present state of the robot, the dock and the surroundings, derived from the measurements.

    Attributes:
        estimate: Robot relative to the dock.
        scene: Obstacles and planning problems.
        staging: Staging poses.
        interruption: Name and reason of an external interruption, such as a jump of the clock; empty without an
            interruption.
        commanded: The last command; set before every cycle.
        felt: Contact that the dock type reported in this cycle, at any distance from the dock.
    """

    def __init__(
        self,
        problem: DockingProblem,
        settings: ExecutorSettings,
        perception: Perception,
        dock_type: CheckedDockType,
        report: Callable[[str, str], None],
    ) -> None:
        self.problem, self.settings, self.perception, self._report = problem, settings, perception, report
        self.dock_type = dock_type
        self.estimate = DockEstimate(problem, settings, perception)
        self.scene = PlanningScene(problem, settings, perception)
        self.staging = StagingPoses(dock_type, self.estimate, self.scene)
        self.interruption = ("", "")
        self.commanded = Twist2()
        self.felt: Contact | None = None
        self._far_contact_reported = False

    @property
    def is_commanded_to_rest(self) -> bool:
        """Whether the last command is zero."""
        return self.commanded == Twist2()

    @property
    def now(self) -> float:
        """Stamp of the last measurements on the monotonic clock [s]."""
        return self.perception.stamp

    @property
    def twist(self) -> Twist2:
        """Body velocity of the robot by odometry."""
        measurements = self.perception.measurements
        return Twist2() if measurements is None else measurements.twist

    @property
    def stands(self) -> bool:
        """Whether the robot is at rest according to command and odometry."""
        twist = self.twist
        return self.is_commanded_to_rest and abs(twist.linear) <= _AT_REST[0] and abs(twist.angular) <= _AT_REST[1]

    @property
    def braking_time(self) -> float:
        """Braking time from the largest speed [s], see `braking_time_from`."""
        return self.braking_time_from(self.problem.robot.limits.max_speed)

    def braking_time_from(self, speed: float) -> float:
        """Return an upper bound of the braking time [s] from a speed [m/s], exact if full deceleration is reached."""
        limits = self.problem.robot.limits
        return speed / limits.max_deceleration + limits.max_deceleration / limits.max_jerk

    @property
    def has_signal(self) -> bool:
        """Whether a signal indicates contact."""
        return self.felt is Contact.SIGNAL

    @property
    def is_charging(self) -> bool:
        """Whether the battery is being charged."""
        measurements = self.perception.measurements
        return measurements is not None and self.dock_type.is_charging(measurements)

    @property
    def is_located(self) -> bool:
        """Whether the pose is known by localization or, for a short distance near a detected dock, by odometry."""
        perception, patience = self.perception, self.settings.pose_patience
        if not perception.started or perception.twist_age > patience:
            return False
        if perception.pose_age <= patience:
            return True
        is_near = perception.way_unlocated <= _UNLOCATED[0] and perception.pose_age <= _UNLOCATED[1]
        is_seen = self.estimate.is_confirmed and perception.detection_age <= patience
        return is_near and is_seen and perception.sigma[0] <= _LOCATED

    @property
    def is_held(self) -> bool:
        """Whether the robot must stay at rest until it is released."""
        measurements = self.perception.measurements
        return measurements is not None and measurements.held

    @property
    def is_blind(self) -> bool:
        """Whether the costmap is too old for a motion."""
        patience = self.settings.costmap_patience
        return patience is not None and self.perception.costmap_age > patience

    def require_no_interruption(self) -> None:
        """Check that a motion may continue.

        Raises:
            Interrupted: If the robot is held, the clock was interrupted, or the pose, odometry or costmap is missing.
        """
        if self.is_held:
            raise Interrupted(HELD, "the task continues when it is released")
        name, reason = self.interruption
        if name:
            raise Interrupted(name, reason)
        perception = self.perception
        if perception.twist_age > self.settings.pose_patience:
            raise Interrupted("no odometry", f"the last one is {perception.twist_age:.2f} s old")
        if not self.is_located:
            raise Interrupted("no pose", f"the last one is {perception.pose_age:.2f} s old")
        if self.is_blind:
            raise Interrupted("no costmap", f"the last one is {perception.costmap_age:.2f} s old")

    def feel(self) -> None:
        """Update `felt` with the result of the dock type, provided that the pose of the robot is known."""
        found, perception = self.perception.measurements, self.perception
        if found is not None and perception.started:
            at_dock = AtDock(self.now, found, self.commanded, perception.robot_from_dock, self.estimate.is_near)
            self.felt = self.dock_type.contact(at_dock)

    def contact(self) -> EndingKind | None:
        """Return the kind of docking by contact; None if there is no contact or the dock is far away."""
        if self.felt is None:
            self._far_contact_reported = False
            return None
        if self.estimate.is_near:
            return _DOCKED_BY[self.felt]
        if not self._far_contact_reported:
            is_stall = self.felt is Contact.STALL
            self._report(
                "stall far from the dock" if is_stall else "external signal far from the dock", self.estimate.where
            )
        self._far_contact_reported = True
        return None


class ControlCycles:
    """Progress of a task over its control cycles.

    Attributes:
        state: State of the executor.
        cancelled: Set to True to cancel the task.
        is_ending: Set to True during the final stop, which is not interrupted by cancellation or timeout.
        deviation: Pose of the robot relative to the nearest pose of the path; None while no path is driven.
        began: Time at which the task began [s].
        period: Duration of the last cycle [s].
    """

    def __init__(self, situation: Situation, report: Callable[[str, str], None]) -> None:
        self.situation, self.report = situation, report
        self.state = State.READY
        self.cancelled = self.is_ending = False
        self.deviation: Pose2 | None = None
        self.began = self.period = 0.0

    @property
    def now(self) -> float:
        """Stamp of the last measurements on the monotonic clock [s]."""
        return self.situation.now

    def cycle(self, target: Target) -> Cycles:
        """Run one control cycle with a target velocity.

        Raises:
            CancelRequested: If the task was cancelled.
            TaskFailed: If the task exceeds its timeout.
        """
        before = self.now
        yield target
        self.period = self.now - before
        if self.is_ending:
            return
        if self.cancelled:
            raise CancelRequested
        self.situation.feel()
        passed, timeout = self.now - self.began, self.situation.settings.timeout
        if timeout is not None and passed > timeout:
            raise TaskFailed(EndingKind.TIMEOUT, f"{passed:.1f} s passed while {self.state.value}")

    def stop(self) -> Cycles:
        """Brake until the robot is at rest, by command and by odometry."""
        situation, before, since = self.situation, self.state, self.now
        self.deviation = None
        while not situation.stands:
            self.state = State.STOPPING
            if situation.is_commanded_to_rest and self.now - since > REST_PATIENCE + situation.braking_time:
                self.report("odometry does not come to rest", f"{situation.twist.linear:.3f} m/s at the command 0")
                break
            yield from self.cycle(STOP)
        self.state = before

    def locate(self) -> Cycles:
        """Wait at rest until pose and costmap are up to date.

        Raises:
            TaskFailed: If the pose or the costmap is missing for too long.
        """
        situation, settings = self.situation, self.situation.settings
        while situation.is_held:
            self.state = State.HELD
            yield from self.cycle(STOP)
        self.state = State.WAITING_FOR_POSE
        since, perception = self.now, situation.perception
        while not situation.is_located:
            if self.now - since > settings.localization_timeout:
                missing = "odometry" if perception.started and perception.twist_age > settings.pose_patience else "pose"
                raise TaskFailed(EndingKind.UNKNOWN, f"no {missing} for {self.now - since:.1f} s")
            yield from self.cycle(STOP)
        while situation.is_blind:
            self.state = State.WAITING_FOR_COSTMAP
            if self.now - since > settings.costmap_timeout:
                raise TaskFailed(EndingKind.FAILED_TO_CONTROL, f"no costmap for {perception.costmap_age:.1f} s")
            yield from self.cycle(STOP)

    def stop_after(self, stopped: Interrupted) -> Cycles:
        """Report the reason for an interruption, unless it has been reported already, and brake."""
        if stopped.name != self.situation.interruption[0]:
            self.report(stopped.name, stopped.reason)
        yield from self.stop()
