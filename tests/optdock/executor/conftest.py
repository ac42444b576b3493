"""A simulated robot before a station, and the checks of every finished task."""

import math
from typing import NamedTuple

import numpy as np
import pytest

from optdock.executor import DockingExecutor, State
from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2, Twist2
from optdock.model.dock import Dock, DockTolerances
from optdock.model.limits import MotionLimits
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.simulation import (
    Actuation,
    DifferentialDrive,
    DockSensor,
    Odometry,
    PoseSensor,
    Sensors,
    SimulatedRobot,
)

LIMITS = MotionLimits(
    max_speed=0.4, max_curvature=2.0, max_curvature_rate=8.0, max_yaw_rate=1.5, max_yaw_acceleration=3.0
)
ROBOT = Robot(Footprint.rectangle(0.3, 0.3, 0.5), LIMITS)
JERK_SLACK = 1.0 + 1e-6
STATION = Footprint.rectangle(0.6, -0.3, 0.6)
TRUE_DOCK, BEFORE_DOCK = Pose2(0.0, 0.0, 0.0), Pose2(-0.9, 0.1, 0.1)
SLUGGISH = Actuation(0.1, 0.1, 0.06)
NOISY = Sensors(
    PoseSensor(0.005, math.radians(0.5)),
    Odometry(linear_sigma=0.002, angular_sigma=0.002),
    DockSensor(15.0, 0.06, 0.003, math.radians(0.3), growth=0.5),
)
PERFECT = Sensors(dock=DockSensor(20.0))


def problem_with(stored=TRUE_DOCK, obstacles=()):
    """The robot and its stored dock."""
    dock = Dock(
        stored,
        STATION,
        direction="forward",
        final_straight=0.1,
        approach_speed=0.15,
        approach_distance=0.3,
        tolerances=DockTolerances(0.01, 0.01, math.radians(1.5)),
    )
    return DockingProblem(Pose2(-1.0, 0.0, 0.0), dock, ROBOT, obstacles)


class Docking(NamedTuple):
    """Result of a simulated task."""

    executor: DockingExecutor
    world: SimulatedRobot
    times: list
    steps: list
    events: list

    @property
    def ending(self):
        return self.executor.ending

    @property
    def states(self):
        return [step.state for step in self.steps]

    def said(self, name):
        """The events of this name."""
        return [event for event in self.events if event.name == name]


def simulated(start=BEFORE_DOCK, sensors=NOISY, actuation=SLUGGISH, **kwargs):
    """A robot with the true dock at the origin."""
    kwargs.setdefault("plant", DifferentialDrive(ROBOT, actuation))
    station = ObstacleSet.from_footprint(STATION, TRUE_DOCK, "dock")
    return SimulatedRobot(start=start, dock_pose=TRUE_DOCK, sensors=sensors, obstacles=station, **kwargs)


def run(world, problem=None, settings=None, *, rate=12.5, timeout=90.0, before=None, **kwargs):
    """Run executor and world until the task ends; `before` may change both, and the measurements."""
    executor = DockingExecutor(problem or problem_with(Pose2(0.03, -0.05, 0.03)), settings, **kwargs)
    times, steps, events, measurements = [], [], [], world.measurements
    while world.time < timeout and executor.ending is None:
        if before is not None:
            measurements = before(executor, world, measurements) or measurements
        times.append(world.time)
        steps.append(executor.step(measurements))
        events += steps[-1].events
        world.last = steps[-1].command
        measurements = world.advance(steps[-1].command, 1.0 / rate)
    return Docking(executor, world, times, steps, events)


def once(condition, act):
    """A `before` that acts in the first cycle in which the condition holds."""
    done = []

    def before(executor, world, measurements):
        if not done and condition(executor, world):
            done.append(True)
            return act(executor, world, measurements)
        return None

    return before


def within(distance):
    """Whether the robot approaches within this distance of the dock."""
    return lambda executor, world: (
        math.hypot(world.error.x, world.error.y) < distance and executor.state is State.APPROACHING
    )


def assert_lawful(stamps, commands, limits=LIMITS):
    """No command beyond the limits of speed, acceleration and jerk."""
    if len(stamps) < 3:
        assert not np.any(commands)
        return
    periods, speeds = np.diff(stamps), commands[:, 0]
    slopes = np.diff(speeds) / periods
    growing = np.diff(np.abs(speeds)) / periods
    jerks = np.diff(slopes) / (0.5 * (periods[1:] + periods[:-1]))
    slack = 1e-6
    assert speeds.max() <= limits.max_speed + slack
    assert speeds.min() >= -limits.max_reverse_speed - slack
    assert growing.max() <= limits.max_acceleration + slack
    assert growing.min() >= -max(limits.max_deceleration, limits.max_acceleration) - slack
    assert np.abs(jerks).max() <= limits.max_jerk * JERK_SLACK + slack
    assert np.abs(commands[:, 1]).max() <= limits.max_yaw_rate + slack
    assert np.abs(np.diff(commands[:, 1]) / periods).max() <= limits.max_yaw_acceleration + slack


@pytest.fixture
def lawful():
    """Check that a task ended at rest, with commands within the limits, without a collision."""

    def check(docking, touch=0.004):
        assert docking.ending is not None
        record = docking.world.record()
        assert np.abs(record.twists[-1]).max() <= 0.03
        assert docking.steps[-1].command == Twist2()
        commands = np.array([(step.command.linear, step.command.angular) for step in docking.steps])
        assert_lawful(np.array(docking.times), commands)
        assert docking.world.clearance() >= -touch
        return docking.ending

    return check
