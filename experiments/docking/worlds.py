"""What is driven: a robot, a bay with a station, posts about, starts, and what the sensors are like."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from optdock.dock import Dock, DockDirection
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2, transform_points
from optdock.limits import MotionLimits
from optdock.obstacles import ObstacleSet
from optdock.problem import ClearanceRule, DockingProblem
from optdock.robot import Robot, TrackingTube
from optdock.simulation import (
    Actuation,
    DockSensor,
    PoseSensor,
    Sensors,
    SimulatedRobot,
    Station,
    plant_of,
)

__all__ = ["SPREADS", "WORLDS", "Case", "Spread", "World", "case_of"]

ROBOT = Robot(
    Footprint.rectangle(0.3, 0.3, 0.5),
    MotionLimits(
        max_speed=0.25, max_reverse_speed=0.25, max_acceleration=0.5, max_deceleration=0.5, max_jerk=2.0,
        max_yaw_rate=0.75, max_yaw_acceleration=1.5, max_curvature=3.0, max_curvature_rate=30.0,
    ),
    tracking=TrackingTube(cross=0.02, yaw=0.03),
)  # fmt: skip
STATION = Footprint(np.array([[0.3, -0.3], [0.45, -0.3], [0.45, 0.3], [0.3, 0.3]]))  # touches the docked robot's front
CLEARANCE = ClearanceRule(0.05, 0.0, 0.5)
POSTS, POST_SIDE = 20, 0.06  # how many; [m]
PUSHED_AT = 0.6  # [m] before the dock


class Spread(NamedTuple):
    """Starts around the staging pose, uniform.

    `staging`: its distance from the dock [m]. `radius`: of the disc [m]. `turn`: largest heading error [rad].
    """

    name: str
    staging: float
    radius: float
    turn: float


SPREADS = {
    # What SimpleGoalChecker accepts by default, around Nav2's staging_x_offset.
    "nav2": Spread("Nav2's goal checker", 0.7, 0.25, 0.25),
    "wider": Spread("wider", 1.2, 0.5, 0.5),
}


class World(NamedTuple):
    """What differs from a perfect world.

    Attributes:
        name: As in the tables.
        actuation: Of the drive.
        pose: Localization.
        dock: Detector of the dock; None: the dock stands where it is stored.
        moved: How far the true dock is from the stored one at most [m], and how far turned [rad].
        pushed: How far it is pushed, and turned, when the robot is 0.6 m away from it.
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
        seed: Of everything random in it.
        direction: Gear into the dock.
        problem: As the robot knows it: the dock as stored.
        true_dock: Where the docked robot really stands.
    """

    seed: int
    direction: DockDirection
    problem: DockingProblem
    true_dock: Pose2

    def push(self, robot: SimulatedRobot, world: World) -> None:
        """Push the dock once, when the robot has come near it."""
        near = math.hypot(robot.error.x, robot.error.y) < PUSHED_AT
        if world.pushed == (0.0, 0.0) or not near or robot.dock_pose != self.true_dock:
            return
        random = np.random.default_rng((7, self.seed))
        bearing, (far, turn) = random.uniform(-math.pi, math.pi), world.pushed
        by = Pose2(far * math.cos(bearing), far * math.sin(bearing), float(random.uniform(-turn, turn)))
        robot.dock_pose = self.true_dock @ by

    def obstacles(self) -> ObstacleSet:
        """What really stands there."""
        assert self.problem.dock.footprint is not None
        station = ObstacleSet.from_footprint(self.problem.dock.footprint, self.true_dock, "dock")
        return self.problem.obstacles + station

    def world(self, kind: World, *, has_switch: bool = True) -> SimulatedRobot:
        """The robot at its start, at rest; a station without a switch does not stop it either."""
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
    """A random docking, forward where `number` is even; equal numbers and seeds give equal cases."""
    random = np.random.default_rng((seed, number))
    direction = (DockDirection.FORWARD, DockDirection.BACKWARD)[number % 2]
    gear = 1.0 if direction is DockDirection.FORWARD else -1.0
    goal = Pose2(*random.uniform(-1.0, 1.0, 2), float(random.uniform(-math.pi, math.pi)))
    radius, angle = spread.radius * math.sqrt(random.uniform()), random.uniform(-math.pi, math.pi)
    seen = Pose2(
        gear * (radius * math.cos(angle) - spread.staging),
        radius * math.sin(angle),
        float(random.uniform(-spread.turn, spread.turn)),
    )
    off, turn = world.moved
    shift, bearing = off * math.sqrt(random.uniform()), random.uniform(-math.pi, math.pi)
    moved = Pose2(shift * math.cos(bearing), shift * math.sin(bearing), float(random.uniform(-turn, turn)))
    station = Footprint(gear * STATION.vertices) if gear > 0.0 else Footprint(-STATION.vertices)
    dock = Dock(goal, station, direction, approach_speed=0.1, approach_distance=0.15)
    problem = DockingProblem(goal @ seen, dock, ROBOT, _posts(random, goal, gear), CLEARANCE)
    return Case(number, direction, problem, goal @ moved)


def _posts(random: np.random.Generator, goal: Pose2, gear: float) -> ObstacleSet:
    """A bay's two side walls, and posts around, all clear of the straight approach and of every start."""
    found = [[[0.45, side * 0.55], [0.0, side * 0.55], [0.0, side * 0.6], [0.45, side * 0.6]] for side in (1.0, -1.0)]
    while len(found) < POSTS + 2:
        x, y = random.uniform(-2.6, 0.5), random.uniform(-1.6, 1.6)
        if abs(y) < 0.75 + 0.15 * abs(x):  # a robot turned by up to 0.5 rad, off by 0.5 m at 1.7 m
            continue
        s = POST_SIDE
        found.append([[x, y], [x + s, y], [x + s, y + s], [x, y + s]])
    corners = transform_points(goal.as_array()[None], gear * np.array(found).reshape(-1, 2))[0]
    return ObstacleSet.from_polygons(list(corners.reshape(-1, 4, 2)))
