"""What is known of the task at this moment: where the robot stands, what it sees and touches, what may be asked for."""

from __future__ import annotations

from typing import TYPE_CHECKING

from optdock.executor.dock_estimate import DockEstimate
from optdock.executor.interruptions import HELD, Interrupted
from optdock.executor.planning_scene import PlanningScene
from optdock.executor.staging import StagingPoses
from optdock.executor.task_states import EndingKind
from optdock.geometry.pose import Twist2
from optdock.model.measurements import AtDock
from optdock.plugins.outcomes import Contact

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.executor.checked_dock_type import CheckedDockType
    from optdock.executor.executor_settings import ExecutorSettings
    from optdock.executor.perception import Perception
    from optdock.model.problem import DockingProblem

__all__ = ["Situation"]

_AT_REST = 0.01, 0.02  # [m/s], [rad/s] by odometry: a robot that stands, its encoders not quite
# [m], [s] for which odometry takes the robot among the obstacles of the map while the dock is in view: by wheels of 1 %
# it is then 1 cm off, a fifth of a usual clearance; the last metre before a dock takes less time.
_UNLOCATED = 1.0, 10.0
_LOCATED = 0.01  # [m], standard deviation: what the odometry of that way may add
_DOCKED_BY = {Contact.SIGNAL: EndingKind.DOCKED_BY_SIGNAL, Contact.STALL: EndingKind.DOCKED_BY_STALL}


class Situation:
    """Questions about robot, dock and surroundings, answered from the measurements so far.

    Args:
        problem: Robot, dock as stored, obstacles, clearance; its start plays no part.
        settings: How the task is to be done.
        perception: Brought up to date before every cycle.
        dock_type: Says where approaches begin, and what contact and charge are.
        report: Takes the name of an event and its detail.

    Attributes:
        estimate: Where the robot stands relative to the dock.
        scene: What stands around it.
        staging: Where approaches begin.
        interruption: Name and reason of what stops a motion from outside, such as a clock that jumped; empty: nothing.
        commanded: The last command; set before every cycle.
        felt: The contact that the dock type feels in this cycle, wherever the robot is.
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
        self._is_far_contact_said = False

    @property
    def is_commanded_to_rest(self) -> bool:
        """Whether the commands have come to rest."""
        return self.commanded == Twist2()

    @property
    def now(self) -> float:
        """Stamp of the last measurements, on the clock that never goes back [s]."""
        return self.perception.stamp

    @property
    def twist(self) -> Twist2:
        """The robot's body velocity by odometry."""
        measurements = self.perception.measurements
        return Twist2() if measurements is None else measurements.twist

    @property
    def stands(self) -> bool:
        """Whether the robot stands, by its commands and its odometry."""
        return (
            self.is_commanded_to_rest
            and abs(self.twist.linear) <= _AT_REST[0]
            and abs(self.twist.angular) <= _AT_REST[1]
        )

    @property
    def braking_time(self) -> float:
        """From the largest speed to rest [s], see `braking_time_from`."""
        return self.braking_time_from(self.problem.robot.limits.max_speed)

    def braking_time_from(self, speed: float) -> float:
        """From a speed [m/s] to rest, at most: exact where the deceleration reaches its limit on the way [s]."""
        limits = self.problem.robot.limits
        return speed / limits.max_deceleration + limits.max_deceleration / limits.max_jerk

    @property
    def has_signal(self) -> bool:
        """Whether a signal says that the robot is docked."""
        return self.felt is Contact.SIGNAL

    @property
    def is_charging(self) -> bool:
        """Whether the battery is being charged."""
        measurements = self.perception.measurements
        return measurements is not None and self.dock_type.is_charging(measurements)

    @property
    def is_located(self) -> bool:
        """Whether it is known where the robot is: by localization, or for a short way by odometry, the dock in view."""
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
        """Whether the robot must stand until it is released."""
        measurements = self.perception.measurements
        return measurements is not None and measurements.held

    @property
    def is_blind(self) -> bool:
        """Whether the picture of the surroundings is too old to be moved in."""
        patience = self.settings.costmap_patience
        return patience is not None and self.perception.costmap_age > patience

    def require_no_interruption(self) -> None:
        """See that a motion may go on.

        Raises:
            Interrupted: The robot is held, or does not know where it is or what is around it.
        """
        if self.is_held:
            raise Interrupted(HELD, "it goes on from here when it is released")
        name, reason = self.interruption
        if name:
            raise Interrupted(name, reason)
        if self.perception.twist_age > self.settings.pose_patience:
            raise Interrupted("no odometry", f"the last one is {self.perception.twist_age:.2f} s old")
        if not self.is_located:
            raise Interrupted("no pose", f"the last one is {self.perception.pose_age:.2f} s old")
        if self.is_blind:
            raise Interrupted("no costmap", f"the last one is {self.perception.costmap_age:.2f} s old")

    def feel(self) -> None:
        """Ask the dock type what is felt in this cycle, once it is known where the robot is."""
        perception = self.perception
        if perception.measurements is not None and perception.started:
            self.felt = self.dock_type.contact(
                AtDock(
                    self.now, perception.measurements, self.commanded, perception.robot_from_dock, self.estimate.is_near
                )
            )

    def contact(self) -> EndingKind | None:
        """How the robot is docked by what is felt; far from the dock it is by nothing."""
        if self.felt is None:
            self._is_far_contact_said = False
            return None
        if self.estimate.is_near:
            return _DOCKED_BY[self.felt]
        if not self._is_far_contact_said:
            is_stall = self.felt is Contact.STALL
            self._report(
                "stall far from the dock" if is_stall else "external signal far from the dock", self.estimate.where
            )
        self._is_far_contact_said = True
        return None
