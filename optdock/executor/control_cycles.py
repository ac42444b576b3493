"""Control cycles: each `yield` is one, and what every step of the procedure needs of them: stop, wait, time out."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

from optdock.executor.interruptions import CancelRequested, TaskFailed
from optdock.executor.task_states import EndingKind, State
from optdock.geometry.pose import Twist2

if TYPE_CHECKING:
    from collections.abc import Callable, Generator

    from optdock.executor.interruptions import Interrupted
    from optdock.executor.situation import Situation
    from optdock.geometry.pose import Pose2

__all__ = ["REST_PATIENCE", "STOP", "ControlCycles", "Cycles", "Wish"]

REST_PATIENCE = 2.0  # [s]: an odometry that never says so must not hold the task up

Wish: TypeAlias = "Twist2 | None"
"""What a cycle asks of the drive: a body velocity; None: stop."""
Cycles: TypeAlias = "Generator[Wish, None, None]"
STOP = None


class ControlCycles:
    """The state of a task from cycle to cycle.

    Args:
        situation: What is known; its `commanded` and `interruption` are to be set before every cycle.
        report: Takes the name of an event and its detail.

    Attributes:
        situation: As given.
        report: As given.
        state: What is being done.
        cancelled: Set it to end the task.
        is_ending: Set it for the last stop, which neither a cancellation nor a timeout ends.
        deviation: The robot as seen from the path that it drives; None where it drives none.
        began: When the task began [s].
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
        """Stamp of the last measurements, on the clock that never goes back [s]."""
        return self.situation.now

    def cycle(self, wish: Wish) -> Cycles:
        """One control cycle.

        Raises:
            CancelRequested: The caller wants an end.
            TaskFailed: The task takes too long.
        """
        before = self.now
        yield wish
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
        """Brake, until commands and odometry say that the robot stands."""
        situation, before, since = self.situation, self.state, self.now
        self.deviation = None
        while not situation.stands:
            self.state = State.STOPPING
            if situation.is_commanded_to_rest and self.now - since > REST_PATIENCE + situation.braking_time:
                self.report("odometry does not come to rest", f"{situation.twist.linear:.3f} m/s commanded 0")
                break
            yield from self.cycle(STOP)
        self.state = before

    def locate(self) -> Cycles:
        """At rest until robot and surroundings are known as they are now.

        Raises:
            TaskFailed: They are not, for too long.
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

    def say_why(self, stopped: Interrupted) -> None:
        """Report why a motion was interrupted, unless that was reported where it was found."""
        if stopped.name != self.situation.interruption[0]:  # that has been said already
            self.report(stopped.name, stopped.reason)
