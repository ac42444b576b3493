"""The control loop: a thread that steps one task after another at absolute deadlines, without ROS.

Whatever happens, the last command is zero: a task ends at rest; what is raised in a cycle, and a clock that stands
still, end in a ramp within the robot's limits. Only where even that fails does the command fall to zero at once.
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
from optdock.model.trajectory import braking_time

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.executor import DockingExecutor, Step
    from optdock.model.measurements import Measurements
    from optdock.model.robot import Robot

__all__ = ["ControlLoop", "CycleTimes", "TaskRun", "may_be_preferred"]

logger = logging.getLogger(__name__)

# Of a period, after which a command goes out: nearly every cycle is done by then, so what it took does not show in the
# times between commands.
_PHASE = 0.25
_STANDSTILL = 0.5  # [s] of wall clock in which the clock of the measurements stands still: nothing can be timed by it
_PAUSE = 0.5  # [s] without a command, after which bases have stopped by themselves; the executor's `longest_tick`
_LONGEST_RAMP = 10.0  # [s]: no robot brakes for longer; then the command falls to zero
_SLACK = 0.5  # [s] for cycles that are late while a robot brakes
_KEPT = 3000  # cycles whose times are kept: a minute at 50 Hz
_PRIORITY = 1  # the least of them: beyond everything that is not realtime, below whatever else is
_REALTIME = os.SCHED_RR | os.SCHED_RESET_ON_FORK
_NEVER = 1e-9  # [m/s], [rad/s]: slower is at rest, left by rounding


class CycleTimes(NamedTuple):
    """How well the loop kept its rate, over the last minute or so.

    Attributes:
        cycles: Since the task began.
        missed: Deadlines that passed before the cycle began.
        period: Wanted [s].
        late_p99: 99th percentile of how late a command was sent [s].
        late_max: The latest [s].
        busy_p99: 99th percentile of what measuring and deciding took [s].
        busy_max: The longest [s].
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
    """One task, to be stepped until it has ended.

    Args:
        executor: Of the task.
        measure: What is known at a time [s]: called once in every cycle, in the thread of the loop.
        observe: Takes what came of every cycle, in the thread of the loop; must return at once.

    Attributes:
        done: Set once the robot stands and the last command, zero, is out.
        ending: How it ended; None before.
        stopping: Why it is being stopped from outside; empty: it is not.
    """

    executor: DockingExecutor
    measure: Callable[[float], Measurements]
    observe: Callable[[Measurements, Step], None]
    done: threading.Event = field(default_factory=threading.Event)
    ending: Ending | None = None
    stopping: str = ""

    def stop(self, reason: str) -> None:
        """Stop the robot within its limits, and end the task as cancelled for this reason; from any thread."""
        self.stopping = self.stopping or reason
        self.executor.cancel()


class ControlLoop:
    """Steps a `TaskRun` at a time.

    Args:
        robot: Whose limits the ramps keep.
        period: Of the cycles [s].
        now: The clock of the measurements [s].
        send: Sends a command; called in the thread of the loop alone.
        realtime: Whether the kernel prefers the threads of this process to those of others while a task is at work.
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
    def run(self) -> TaskRun | None:
        """The one at work, or the last one."""
        return self._run

    @property
    def is_running(self) -> bool:
        """Whether a task is at work."""
        return self._run is not None and not self._run.done.is_set()

    @property
    def times(self) -> CycleTimes:
        """How well the rate was kept."""
        late, busy = (np.array(list(kept) or [0.0]) for kept in (self._late, self._busy))
        worst = (float(value) for kept in (late, busy) for value in (np.percentile(kept, 99), kept.max()))
        return CycleTimes(self._count, self._missed, self.period, *worst)

    def start(self, run: TaskRun) -> None:
        """Begin; one that is at work must have been waited for."""
        assert not self.is_running, "one task at a time"
        self._run, self._aborted = run, False
        self._count = self._missed = 0
        self._late.clear()
        self._busy.clear()
        self._thread = threading.Thread(target=self._work, args=(run,), name="docking-control", daemon=True)
        self._thread.start()

    def close(self, reason: str, patience: float) -> bool:
        """Stop what is at work, within the limits, or at once where that takes longer than `patience` [s].

        Returns:
            Whether the robot was stopped within its limits.
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
        if not run.done.is_set():  # it hangs in a cycle; whatever that gives when it comes back is not sent
            is_free = self._sending.acquire(timeout=_SLACK)  # or it hangs in a middleware that takes nothing
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
        # Nothing that exists now will be garbage within this task: a collection in mid-motion need not walk over it.
        gc.collect()
        gc.freeze()
        try:
            if self._realtime:
                prefer(_REALTIME, _PRIORITY)
            run.ending = self._drive(run)
        except Exception as error:  # whatever it is, the robot must come to rest
            logger.exception("the control loop stops the robot")
            if run.ending is None:
                run.ending = self._failed(f"{type(error).__name__}: {error}")
            self._ramp_down()
        finally:
            self._end(run)

    def _end(self, run: TaskRun) -> None:
        """The last command is zero; the end is signalled whatever fails here."""
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
                if time.monotonic() - began < _PAUSE:  # else the next cycle begins anew, and decides for then
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
                self._put(self._sent)  # a simulated clock ticks more slowly than this loop
            if self._aborted:
                self._ramp_down()
                return self._failed(run.stopping)
            deadline = self._sleep_until(deadline + self.period)

    def _sleep_until(self, deadline: float) -> float:
        """Sleep until a deadline; one that has passed by more than a period is given up for the next one."""
        left = deadline - time.monotonic()
        if left > 0.0:
            time.sleep(left)
        elif left < -self.period:
            skipped = int(-left / self.period)
            self._missed += skipped
            deadline += skipped * self.period
        return deadline

    def _ramp_down(self) -> None:
        """From the last command to rest within the robot's limits.

        It falls to zero at once where that fails, and where nothing has been sent for so long that the base has stopped
        by itself: a ramp would throw a robot forward that stands.
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
                if abs(command.linear) < _NEVER and abs(command.angular) < _NEVER:
                    break
                self._put(command)
                deadline = self._sleep_until(deadline + self.period)
        except Exception:
            logger.exception("no ramp; the command falls to zero")

    def _put(self, command: Twist2) -> None:
        with self._sending:
            if self._silent:
                raise RuntimeError("the control loop has been given up")
            self._sent, self._sent_at = command, time.monotonic()
            self._send(command)


def prefer(policy: int, priority: int) -> None:
    """Have the kernel schedule all threads of this process so.

    All of them, because a thread that holds the interpreter and is not preferred lets the one that waits for it wait
    for everybody. Threads and processes that are started meanwhile are as any other.

    Raises:
        PermissionError: The user may not.
    """
    for thread in Path("/proc/self/task").iterdir():
        with suppress(ProcessLookupError):  # it has just ended
            os.sched_setscheduler(int(thread.name), policy, os.sched_param(priority))


def may_be_preferred() -> bool:
    """Whether this user's processes may be realtime ones."""
    try:
        os.sched_setscheduler(0, _REALTIME, os.sched_param(_PRIORITY))
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    except PermissionError:
        return False
    return True
