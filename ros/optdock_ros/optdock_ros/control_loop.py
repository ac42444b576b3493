"""The control loop: a thread that steps tasks at absolute deadlines, without ROS.

A task ends at rest, and its last command is zero. After an exception in a cycle, or if the clock stops, the command is
reduced to zero in a ramp within the robot's limits. If that also fails, the command is set to zero at once.
"""

from __future__ import annotations

import gc
import logging
import math
import os
import threading
import time
from collections import deque
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.controllers.command_limits import CommandLimiter
from optdock.executor import Ending, EndingKind
from optdock.geometry.pose import Twist2
from optdock.model.constant_jerk import braking_time

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.executor import DockingExecutor, Step
    from optdock.model.measurements import Measurements
    from optdock.model.robot import Robot

__all__ = ["ControlLoop", "CycleTimes", "TaskRun", "may_be_preferred"]

logger = logging.getLogger(__name__)

# Fraction of the period after which a command is sent: nearly every cycle is done by then, so that the times between
# commands do not depend on its duration.
_PHASE = 0.25
_STANDSTILL = 0.5  # [s] of wall clock without progress of the measurements' clock, after which it counts as stopped
_PAUSE = 0.5  # [s] without a command after which bases stop by themselves; the executor's `longest_tick`
_LONGEST_RAMP = 10.0  # [s]: longer than any robot brakes; then the command drops to zero
_SLACK = 0.5  # [s] for late cycles of a braking robot
_KEPT = 3000  # cycles whose times are kept: one minute at 50 Hz
_PRIORITY = 1  # lowest real-time priority
_REALTIME = os.SCHED_RR | os.SCHED_RESET_ON_FORK
_AT_REST = 1e-9  # [m/s], [rad/s]: rounding errors of a command at rest


class CycleTimes(NamedTuple):
    """Cycles and missed deadlines of a task, and statistics over the last `_KEPT` cycles [s].

    `late` is the delay of commands, `busy` the duration of measuring and computing.
    """

    cycles: int
    missed: int
    period: float
    late_p99: float
    late_max: float
    busy_p99: float
    busy_max: float


@dataclass(eq=False)
class TaskRun:
    """The run of a task.

    Args:
        executor: Executor of the task.
        measure: Function that returns the measurements at a time [s]; called once per cycle in the loop's thread.
        observe: Callback with measurements and step of every cycle, in the loop's thread; must return at once.

    Attributes:
        done: Set when the robot is at rest and the last command, zero, has been sent.
        stopping: Reason of a stop from outside; empty otherwise.
    """

    executor: DockingExecutor
    measure: Callable[[float], Measurements]
    observe: Callable[[Measurements, Step], None]
    done: threading.Event = field(default_factory=threading.Event)
    ending: Ending | None = None
    stopping: str = ""

    def stop(self, reason: str) -> None:
        """Stop the robot within its limits and end the task as cancelled. Callable from any thread."""
        self.stopping = self.stopping or reason
        self.executor.cancel()


class ControlLoop:
    """Thread that steps one `TaskRun` at a time.

    Args:
        robot: Robot whose limits the ramps keep.
        period: Period of the cycles [s].
        now: Function that returns the time of the measurements [s].
        send: Function that sends a command; called in the loop's thread.
        realtime: Whether the threads of this process have real-time scheduling while a task runs.
    """

    def __init__(
        self,
        robot: Robot,
        period: float,
        now: Callable[[], float],
        send: Callable[[Twist2], None],
        *,
        realtime: bool = False,
    ) -> None:
        self._robot, self.period, self._now, self._send, self._realtime = robot, period, now, send, realtime
        self._sent, self._sent_at, self._stamp = Twist2(), -math.inf, 0.0
        self._late: deque[float] = deque(maxlen=_KEPT)
        self._busy: deque[float] = deque(maxlen=_KEPT)
        self._count = self._missed = 0
        self._sending = threading.Lock()
        self._thread: threading.Thread | None = None
        self._run: TaskRun | None = None
        self._aborted = self._silent = False

    @property
    def is_running(self) -> bool:
        """Whether a task is running."""
        return self._run is not None and not self._run.done.is_set()

    @property
    def times(self) -> CycleTimes:
        """Statistics of the cycles."""
        late, busy = (np.array(list(kept) or [0.0]) for kept in (self._late, self._busy))
        worst = (float(value) for kept in (late, busy) for value in (np.percentile(kept, 99), kept.max()))
        return CycleTimes(self._count, self._missed, self.period, *worst)

    def start(self, run: TaskRun) -> None:
        """Start a task; the previous one must be done."""
        assert not self.is_running, "one task at a time"
        self._run, self._aborted = run, False
        self._count = self._missed = 0
        self._late.clear()
        self._busy.clear()
        self._thread = threading.Thread(target=self._work, args=(run,), name="docking-control", daemon=True)
        self._thread.start()

    def close(self, reason: str, patience: float) -> bool:
        """Stop the task within the limits of the robot, and abort it if that takes longer than `patience` [s].

        Returns:
            Whether the executor stopped the robot in time.
        """
        run, thread = self._run, self._thread
        if run is None or thread is None:
            return True
        if run.done.is_set():
            thread.join()
            return True
        run.stop(reason)
        in_time = run.done.wait(patience)
        self._aborted = True
        limits = self._robot.limits
        thread.join(braking_time(limits.max_speed, limits.max_deceleration, limits.max_jerk) + _SLACK)
        if not run.done.is_set():  # a cycle hangs; its late command is not sent
            is_free = self._sending.acquire(timeout=_SLACK)  # the middleware may also hang
            self._silent = True
            try:
                self._send(Twist2())
            except Exception:
                logger.exception("the last command, zero, cannot be sent")
            if is_free:
                self._sending.release()
            if run.ending is None:
                run.ending = self._failed(f"{reason}; the control loop hangs")
            run.done.set()
        return in_time

    def _failed(self, reason: str) -> Ending:
        return Ending(EndingKind.UNKNOWN, reason, 0, self._stamp)

    def _work(self, run: TaskRun) -> None:
        gc.collect()
        gc.freeze()  # a garbage collection during the motion skips all existing objects
        try:
            if self._realtime:
                prefer(_REALTIME, _PRIORITY)
            run.ending = self._drive(run)
        except Exception as error:
            logger.exception("the control loop stops the robot")
            if run.ending is None:
                run.ending = self._failed(f"{type(error).__name__}: {error}")
            self._ramp_down()
        finally:
            self._end(run)

    def _end(self, run: TaskRun) -> None:
        """Send zero as the last command and set `done`, also after exceptions."""
        try:
            if not self._silent:
                self._put(Twist2())
        except Exception:
            logger.exception("the last command, zero, cannot be sent")
        try:
            gc.unfreeze()
            if self._realtime:
                prefer(os.SCHED_OTHER, 0)
        finally:
            run.done.set()

    def _drive(self, run: TaskRun) -> Ending:
        deadline, before, moved_at = time.monotonic(), -1.0, time.monotonic()
        while True:
            began = time.monotonic()
            now = self._stamp = self._now()
            if now != before:
                before, moved_at = now, began
                measurements = run.measure(now)
                step = run.executor.step(measurements)
                self._busy.append(time.monotonic() - began)
                due = deadline + _PHASE * self.period
                time.sleep(max(0.0, due - time.monotonic()))
                if time.monotonic() - began < _PAUSE:  # otherwise the command is outdated
                    self._put(step.command)
                self._count += 1
                self._late.append(time.monotonic() - due)
                run.observe(measurements, step)
                if step.ending is not None and step.command == Twist2():
                    return step.ending
            elif began - moved_at > _STANDSTILL:
                self._ramp_down()
                return self._failed(f"the clock stands still at {now:.3f} s")
            else:
                self._put(self._sent)  # a simulated clock may advance more slowly than this loop
            if self._aborted:
                self._ramp_down()
                return self._failed(run.stopping)
            deadline = self._sleep_until(deadline + self.period)

    def _sleep_until(self, deadline: float) -> float:
        """Sleep until a deadline, and return it; missed deadlines are skipped."""
        left = deadline - time.monotonic()
        if left > 0.0:
            time.sleep(left)
        elif left < -self.period:
            skipped = int(-left / self.period)
            self._missed += skipped
            deadline += skipped * self.period
        return deadline

    def _ramp_down(self) -> None:
        """Send commands from the last one to rest within the robot's limits.

        No ramp is sent if no command has been sent for so long that the base has stopped by itself: the ramp would
        accelerate it.
        """
        if time.monotonic() - self._sent_at > _PAUSE:
            return
        try:
            limiter, robot = CommandLimiter(), self._robot
            limiter.restart(self._sent)
            direction, deadline = self._sent, time.monotonic()
            until = deadline + _LONGEST_RAMP
            while time.monotonic() < until:
                command = limiter.follow(Twist2(), direction, self.period, robot.limits, robot.drive, in_place=False)
                if abs(command.linear) < _AT_REST and abs(command.angular) < _AT_REST:
                    break
                self._put(command)
                deadline = self._sleep_until(deadline + self.period)
        except Exception:
            logger.exception("no ramp; the command falls to zero")

    def _put(self, command: Twist2) -> None:
        with self._sending:
            if self._silent:
                raise RuntimeError("the control loop has been abandoned")
            self._sent, self._sent_at = command, time.monotonic()
            self._send(command)


def prefer(policy: int, priority: int) -> None:
    """Set the scheduling of all threads of this process.

    All threads are included, because a thread without priority that holds the interpreter lock delays the others.
    Threads and processes that are started later have the default scheduling.

    Raises:
        PermissionError: If the user has no permission.
    """
    for thread in Path("/proc/self/task").iterdir():
        with suppress(ProcessLookupError):  # the thread has ended
            os.sched_setscheduler(int(thread.name), policy, os.sched_param(priority))


def may_be_preferred() -> bool:
    """Whether the user has the permission for real-time scheduling."""
    try:
        os.sched_setscheduler(0, _REALTIME, os.sched_param(_PRIORITY))
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    except PermissionError:
        return False
    return True
