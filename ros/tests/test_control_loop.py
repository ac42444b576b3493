"""The control loop always stops the robot; the last command is zero."""

from __future__ import annotations

import os
import threading
import time
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from optdock_ros.control_loop import ControlLoop, TaskRun, may_be_preferred

from optdock.executor import Ending, EndingKind, Feedback, FeedbackState, State, Step
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Twist2
from optdock.model.limits import MotionLimits
from optdock.model.measurements import Measurements
from optdock.model.robot import Robot

if TYPE_CHECKING:
    from collections.abc import Callable

PERIOD = 0.01
LIMITS = MotionLimits(
    max_speed=0.5, max_acceleration=2.0, max_deceleration=2.0, max_jerk=20.0, max_yaw_acceleration=4.0
)
ROBOT = Robot(Footprint.rectangle(0.3, 0.3, 0.4), LIMITS)
MOVING = Twist2(0.3, 0.2)


class Driver:
    """A stand-in of the executor that drives until it is cancelled."""

    def __init__(self, cycle: Callable[[int], None] = lambda _: None) -> None:
        self.cycles, self.cancelled, self._cycle = 0, False, cycle

    def cancel(self) -> None:
        """As `DockingExecutor`."""
        self.cancelled = True

    def step(self, measurements: Measurements) -> Step:
        """As `DockingExecutor`."""
        self.cycles += 1
        self._cycle(self.cycles)
        ending = Ending(EndingKind.CANCELLED, "", 0, measurements.stamp) if self.cancelled else None
        feedback = Feedback(FeedbackState.CONTROLLING, 0, 1.0, 0.0)
        return Step(Twist2() if self.cancelled else MOVING, State.APPROACHING, feedback, ending)


class World:
    """A control loop, its commands, and its clock."""

    def __init__(self, driver: Any, now: Callable[[], float] = time.monotonic) -> None:
        self.sent: list[Twist2] = []
        self.seen: list[Step] = []
        self.loop = ControlLoop(ROBOT, PERIOD, now, self.sent.append)
        self.run = TaskRun(driver, lambda stamp: Measurements(stamp, None), lambda _, step: self.seen.append(step))

    def end(self, timeout: float = 5.0) -> Ending:
        """Return the ending."""
        assert self.run.done.wait(timeout)
        assert self.run.ending is not None
        assert self.sent[-1] == Twist2(), "the last command is zero"
        return self.run.ending

    def assert_ramp(self) -> None:
        """The commands ramp down to rest within the limits."""
        speeds = np.array([command.linear for command in self.sent])
        last = int(np.flatnonzero(speeds == MOVING.linear)[-1])
        ramp = np.diff(speeds[last:]) / PERIOD
        assert ramp.min() >= -1.001 * LIMITS.max_deceleration
        assert np.all(speeds[last:] >= 0.0)
        assert len(ramp) > 10, "no jump"


def broken(cycle: int) -> None:
    """Raise in the twentieth cycle."""
    if cycle == 20:
        raise ZeroDivisionError("by a plugin")


def test_exception_in_a_cycle_ends_in_a_ramp() -> None:
    world = World(Driver(broken))
    world.loop.start(world.run)
    ending = world.end()
    assert (ending.kind, ending.reason) == (EndingKind.UNKNOWN, "ZeroDivisionError: by a plugin")
    world.assert_ramp()


def test_exception_while_measuring_ends_in_a_ramp() -> None:
    world = World(Driver())

    def measure(stamp: float) -> Measurements:
        if len(world.sent) > 20:
            raise MemoryError
        return Measurements(stamp, None)

    world.run.measure = measure
    world.loop.start(world.run)
    assert world.end().kind is EndingKind.UNKNOWN
    world.assert_ramp()


def test_task_is_done_even_if_no_command_can_be_sent() -> None:
    world = World(Driver())

    def send(_: Twist2) -> None:
        raise RuntimeError("the publisher is gone")

    world.loop = ControlLoop(ROBOT, PERIOD, time.monotonic, send)
    world.loop.start(world.run)
    assert world.run.done.wait(5.0)
    assert world.run.ending is not None
    assert world.run.ending.reason == "RuntimeError: the publisher is gone"


def test_command_from_before_a_pause_is_not_sent() -> None:
    """The process was suspended within a cycle; bases stop by themselves in that time."""
    world = World(Driver(lambda cycle: time.sleep(0.7) if cycle == 10 else None))
    world.loop.start(world.run)
    time.sleep(0.5)
    count = len(world.sent)
    time.sleep(0.4)
    world.loop.close("the end", 1.0)
    assert len(world.seen) > count + 5
    moving = sum(command != Twist2() for command in world.sent)
    assert moving == len(world.seen) - 2, "without that one, and the last one, which stops"


def test_no_ramp_begins_after_a_pause() -> None:
    def broken_after_a_pause(cycle: int) -> None:
        if cycle == 10:
            time.sleep(0.7)
            raise ZeroDivisionError

    world = World(Driver(broken_after_a_pause))
    world.loop.start(world.run)
    assert world.end().kind is EndingKind.UNKNOWN
    assert [command for command in world.sent if command != MOVING] == [Twist2()]


def test_stopped_clock_ends_in_a_ramp() -> None:
    began = time.monotonic()
    world = World(Driver(), now=lambda: min(time.monotonic(), began + 0.2))
    world.loop.start(world.run)
    assert "the clock stands still" in world.end().reason
    world.assert_ramp()


def test_slow_clock_repeats_commands() -> None:
    driver = Driver()
    world = World(driver, now=lambda: round(time.monotonic(), 1))
    world.loop.start(world.run)
    time.sleep(0.55)
    assert world.loop.close("the end", 1.0)
    assert len(world.sent) > 3 * driver.cycles


def test_closing_stops_by_the_executor() -> None:
    world = World(Driver())
    world.loop.start(world.run)
    time.sleep(0.1)
    assert world.loop.close("deactivated", 1.0)
    assert world.run.stopping == "deactivated"
    assert world.end().kind is EndingKind.CANCELLED
    assert not world.loop.is_running
    assert world.loop.close("again", 1.0)


def test_an_executor_that_does_not_stop_is_stopped() -> None:
    driver = Driver()
    driver.cancel = lambda: None  # type: ignore[method-assign]
    world = World(driver)
    world.loop.start(world.run)
    time.sleep(0.1)
    assert not world.loop.close("deactivated", 0.2), "not in time"
    assert world.end().reason == "deactivated"
    world.assert_ramp()


def test_hanging_cycle_ends_with_a_zero_command() -> None:
    free = threading.Event()
    driver = Driver(lambda cycle: None if cycle < 10 else bool(free.wait(5.0)) and None)
    driver.cancel = lambda: None  # type: ignore[method-assign] # it would drive on
    world = World(driver)
    world.loop.start(world.run)
    time.sleep(0.3)
    assert not world.loop.close("deactivated", 0.2)
    assert "hangs" in world.end().reason
    count = len(world.sent)
    free.set()
    time.sleep(0.3)
    assert world.sent[count:] == [], "whoever hung commands nothing any more"


def test_times_contain_missed_deadlines() -> None:
    world = World(Driver(lambda cycle: time.sleep(0.1) if cycle == 10 else None))
    world.loop.start(world.run)
    time.sleep(0.5)
    world.loop.close("the end", 1.0)
    times = world.loop.times
    assert times.missed >= 8
    assert times.busy_max >= 0.1
    assert times.cycles == len(world.seen)


def test_realtime_scheduling_ends_with_the_task() -> None:
    if not may_be_preferred():
        pytest.skip("not permitted here")
    policies: list[int] = []
    world = World(Driver(lambda _: policies.append(os.sched_getscheduler(0))))
    world.loop = ControlLoop(ROBOT, PERIOD, time.monotonic, world.sent.append, realtime=True)
    world.loop.start(world.run)
    time.sleep(0.1)
    world.loop.close("the end", 1.0)
    assert set(policies) == {os.SCHED_RR | os.SCHED_RESET_ON_FORK}
    assert os.sched_getscheduler(0) == os.SCHED_OTHER
