"""Worlds of the docking study: robot and sensor models, and random dockings in them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from experiments.docking.cases import Spread, layout_of
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2
from optdock.model.dock import DockDirection
from optdock.model.problem import DockingProblem
from optdock.simulation import (
    Actuation,
    DockSensor,
    PoseSensor,
    Sensors,
    SimulatedRobot,
    Station,
    plant_of,
)

__all__ = ["WORLDS", "Case", "World", "case_of"]

PUSHED_AT = 0.6  # [m] before the dock: distance of the robot at which the dock is pushed


class World(NamedTuple):
    """Differences from a perfect world.

    Attributes:
        name: Name in the tables.
        actuation: Actuation of the drive.
        pose: Localization.
        dock: Dock detector; None: the dock stands at its stored pose.
        moved: Largest distance [m] and largest angle [rad] of the true dock from the stored dock.
        pushed: Displacement and rotation of the dock when the robot is 0.6 m away from it.
    """

    name: str
    actuation: Actuation
    pose: PoseSensor
    dock: DockSensor | None = None
    moved: tuple[float, float] = (0.0, 0.0)
    pushed: tuple[float, float] = (0.0, 0.0)


LATE = Actuation(linear_lag=0.1, angular_lag=0.1, latency=0.06)
DETECTED = World(
    "detected",
    LATE,
    PoseSensor(position_sigma=0.005, yaw_sigma=math.radians(0.5)),
    DockSensor(rate=15.0, latency=0.06, position_sigma=0.003, yaw_sigma=math.radians(0.3), near=1.0),
    (0.1, math.radians(5.0)),
)
WORLDS = {
    "perfect": World("perfect", Actuation(), PoseSensor()),
    "noisy": World("noisy", LATE, PoseSensor(position_sigma=0.002, yaw_sigma=math.radians(0.1))),
    "detected": DETECTED,
    "pushed": DETECTED._replace(name="pushed", pushed=(0.03, math.radians(1.5))),
}


class Case(NamedTuple):
    """One docking.

    Attributes:
        seed: Seed of all random numbers.
        direction: Gear into the dock.
        problem: Problem with the stored dock pose, as known to the robot.
        true_dock: True pose of the docked robot.
    """

    seed: int
    direction: DockDirection
    problem: DockingProblem
    true_dock: Pose2

    def push(self, robot: SimulatedRobot, world: World) -> None:
        """Push the dock once, when the robot is close to it."""
        near = math.hypot(robot.error.x, robot.error.y) < PUSHED_AT
        if world.pushed == (0.0, 0.0) or not near or robot.dock_pose != self.true_dock:
            return
        random = np.random.default_rng((7, self.seed))
        bearing, (far, turn) = random.uniform(-math.pi, math.pi), world.pushed
        by = Pose2(far * math.cos(bearing), far * math.sin(bearing), float(random.uniform(-turn, turn)))
        robot.dock_pose = self.true_dock @ by

    def obstacles(self) -> ObstacleSet:
        """Obstacles at their true poses."""
        assert self.problem.dock.footprint is not None
        station = ObstacleSet.from_footprint(self.problem.dock.footprint, self.true_dock, "dock")
        return self.problem.obstacles + station

    def world(self, kind: World, *, has_switch: bool = True) -> SimulatedRobot:
        """Return the robot at its start, at rest; a station without a switch does not stop it."""
        detector = kind.dock
        return SimulatedRobot(
            plant_of(self.problem.robot, kind.actuation),
            self.problem.start,
            self.true_dock,
            Sensors(pose=kind.pose, dock=detector),
            self.obstacles(),
            station=Station(direction=self.direction) if has_switch else None,
            seed=self.seed,
        )


def case_of(number: int, spread: Spread, world: World, seed: int = 1) -> Case:
    """Return a random docking, forward for even `number`; equal numbers and seeds give equal cases."""
    random = np.random.default_rng((seed, number))
    direction = (DockDirection.FORWARD, DockDirection.BACKWARD)[number % 2]
    return Case(number, *layout_of(random, spread, direction, world.moved))
