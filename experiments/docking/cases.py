"""Random docking layouts: a robot, a bay with a station, posts around it, and the start of the robot."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2, transform_points
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.dock import Dock, DockDirection, DockTolerances
from optdock.model.limits import MotionLimits
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot, TrackingTube

__all__ = ["ROBOT", "SPREADS", "STATION", "Layout", "Spread", "layout_of"]

ROBOT = Robot(
    Footprint.rectangle(0.3, 0.3, 0.5),
    MotionLimits(
        max_speed=0.25, max_reverse_speed=0.25, max_acceleration=0.5, max_deceleration=0.5, max_jerk=2.0,
        max_yaw_rate=0.75, max_yaw_acceleration=1.5, max_curvature=3.0, max_curvature_rate=30.0,
    ),
    tracking=TrackingTube(cross=0.02, yaw=0.03),
)  # fmt: skip
# touches the front of the docked robot
STATION = Footprint(np.array([[0.3, -0.3], [0.45, -0.3], [0.45, 0.3], [0.3, 0.3]]))
CLEARANCE = ClearanceRule(0.05, 0.0, 0.5)
POSTS, POST_SIDE = 20, 0.06  # number; side length [m]


class Spread(NamedTuple):
    """Uniform distribution of starts around the staging pose.

    `staging`: distance of the staging pose from the dock [m]. `radius`: radius of the disc [m]. `turn`: largest heading
    error [rad].
    """

    name: str
    staging: float
    radius: float
    turn: float


SPREADS = {
    # Default tolerances of SimpleGoalChecker, around Nav2's staging_x_offset.
    "nav2": Spread("Nav2's goal checker", 0.7, 0.25, 0.25),
    "wider": Spread("wider", 1.2, 0.5, 0.5),
}


class Layout(NamedTuple):
    """Problem and true dock pose of one docking.

    Attributes:
        direction: Gear into the dock.
        problem: Problem with the stored dock pose, as known to the robot.
        true_dock: True pose of the docked robot.
    """

    direction: DockDirection
    problem: DockingProblem
    true_dock: Pose2


def layout_of(
    random: np.random.Generator,
    spread: Spread,
    direction: DockDirection,
    moved: tuple[float, float] = (0.0, 0.0),
    *,
    robot: Robot = ROBOT,
    tolerances: DockTolerances | None = None,
) -> Layout:
    """Return a random docking; equal generators give equal layouts.

    Args:
        random: Source of all random numbers.
        spread: Distribution of the starts.
        direction: Gear into the dock, forward or backward.
        moved: Largest distance [m] and largest angle [rad] of the true dock from the stored dock.
        robot: The robot.
        tolerances: Tolerances of the dock; None: the defaults.
    """
    gear = 1.0 if direction is DockDirection.FORWARD else -1.0
    goal = Pose2(*random.uniform(-1.0, 1.0, 2), float(random.uniform(-math.pi, math.pi)))
    radius, angle = spread.radius * math.sqrt(random.uniform()), random.uniform(-math.pi, math.pi)
    seen = Pose2(
        gear * (radius * math.cos(angle) - spread.staging),
        radius * math.sin(angle),
        float(random.uniform(-spread.turn, spread.turn)),
    )
    off, turn = moved
    shift, bearing = off * math.sqrt(random.uniform()), random.uniform(-math.pi, math.pi)
    offset = Pose2(shift * math.cos(bearing), shift * math.sin(bearing), float(random.uniform(-turn, turn)))
    station = Footprint(gear * STATION.vertices) if gear > 0.0 else Footprint(-STATION.vertices)
    dock = Dock(
        goal, station, direction, approach_speed=0.1, approach_distance=0.15, tolerances=tolerances or DockTolerances()
    )
    problem = DockingProblem(goal @ seen, dock, robot, _posts(random, goal, gear), CLEARANCE)
    return Layout(direction, problem, goal @ offset)


def _posts(random: np.random.Generator, goal: Pose2, gear: float) -> ObstacleSet:
    """Return two side walls of a bay and posts around it, clear of the straight approach and of every start."""
    found = [[[0.45, side * 0.55], [0.0, side * 0.55], [0.0, side * 0.6], [0.45, side * 0.6]] for side in (1.0, -1.0)]
    while len(found) < POSTS + 2:
        x, y = random.uniform(-2.6, 0.5), random.uniform(-1.6, 1.6)
        if abs(y) < 0.75 + 0.15 * abs(x):  # a robot turned by up to 0.5 rad, 0.5 m off at 1.7 m
            continue
        s = POST_SIDE
        found.append([[x, y], [x + s, y], [x + s, y + s], [x, y + s]])
    corners = transform_points(goal.as_array()[None], gear * np.array(found).reshape(-1, 2))[0]
    return ObstacleSet.from_polygons(list(corners.reshape(-1, 4, 2)))
