"""The scene of the contract suites: a robot, a dock 3 m ahead, a free map, and raw paths to the dock."""

from __future__ import annotations

import numpy as np

from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet, box_distance
from optdock.geometry.pose import Pose2
from optdock.model.costmap import FREE_SPACE, LETHAL, Costmap
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.path import Path
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.plugins.lifecycle import PluginContext
from optdock.testing.drives import cusp_drive

__all__ = [
    "GOAL",
    "ORIGIN",
    "ROBOT",
    "bent_path",
    "cusp_path",
    "free_costmap",
    "moved_path",
    "post_inside_the_bend",
    "raw_path",
    "room",
    "room_costmap",
    "scene_context",
    "scene_problem",
]

ORIGIN = Pose2(0.0, 0.0, 0.0)
GOAL = Pose2(3.0, 0.4, 0.0)
ROBOT = Robot(
    Footprint.rectangle(front=0.4, rear=0.3, width=0.5),
    MotionLimits(max_speed=0.5, max_yaw_rate=1.0, max_curvature=2.5, max_curvature_rate=10.0),
)
_DOCK = Footprint.rectangle(front=0.8, rear=-0.45, width=0.8)
_FREE = Costmap(np.zeros((120, 200), dtype=np.uint8), resolution=0.05, origin=(-4.0, -3.0))


def scene_problem(start: Pose2 = ORIGIN, goal: Pose2 = GOAL, obstacles: ObstacleSet | None = None) -> DockingProblem:
    """Return a problem from `start` into a dock whose station begins 5 cm in front of the docked robot."""
    return DockingProblem(start, Dock(goal, _DOCK), ROBOT, obstacles or ObstacleSet.empty())


def scene_context(problem: DockingProblem | None = None) -> PluginContext:
    """Return a context with a problem, a footprint, and a free map of 10 m x 6 m."""
    found = problem or scene_problem()
    return PluginContext(name="contract", costmap=free_costmap(), footprint=found.robot.footprint, problem=found)


def free_costmap() -> Costmap:
    """Return a free map of 10 m x 6 m around the scene."""
    return _FREE


def room_costmap() -> Costmap:
    """Return the same map with the walls of `room`."""
    free, walls = free_costmap(), room()
    rows, columns = np.indices(free.data.shape)
    centres = np.array(free.origin) + free.resolution * (np.column_stack((columns.ravel(), rows.ravel())) + 0.5)
    inside = np.any(box_distance(walls, centres) == 0.0, axis=1).reshape(free.data.shape)
    return free.with_data(np.where(inside, LETHAL, FREE_SPACE).astype(np.uint8))


def room() -> ObstacleSet:
    """Return walls around the origin, so close that a robot there can neither turn nor drive a metre."""
    low = np.array([(-3.0, 0.3), (-3.0, -0.6), (0.7, -0.3), (-1.2, -0.3)])
    high = np.array([(3.0, 0.6), (3.0, -0.3), (1.4, 0.3), (-0.6, 0.3)])
    return ObstacleSet.from_rectangles(low, high, "wall")


def raw_path(start: Pose2 = ORIGIN, goal: Pose2 = GOAL) -> Path:
    """Return a polyline from `start` to a `goal` ahead of it, an S with a zigzag of 1 cm, in steps of 5 cm."""
    end = goal.in_frame_of(start)
    x = np.linspace(0.0, end.x, 1 + round(abs(end.x) / 0.05))
    share = x / end.x
    y = end.y * share**2 * (3.0 - 2.0 * share)
    y[2:-2] += 0.005 * (-1.0) ** np.arange(y.size - 4)
    yaw = np.arctan2(np.gradient(y), np.gradient(x))
    yaw[0], yaw[-1] = 0.0, end.yaw
    return Path.from_poses([start @ Pose2(*row) for row in zip(x, y, yaw, strict=True)])


def bent_path() -> Path:
    """Return a polyline from the origin to the goal with a corner 1 m to the left."""
    x = np.linspace(0.0, GOAL.x, 61)
    y = np.interp(x, [0.0, 0.4 * GOAL.x, GOAL.x], [0.0, 1.0, GOAL.y])
    yaw = np.arctan2(np.diff(y, append=2.0 * y[-1] - y[-2]), np.diff(x, append=2.0 * x[-1] - x[-2]))
    yaw[0], yaw[-1] = 0.0, GOAL.yaw
    return Path.from_poses(np.column_stack((x, y, yaw)))


def post_inside_the_bend() -> ObstacleSet:
    """Return a post of 20 cm inside the corner of `bent_path`, whose distance from the passing robot is below 1 mm."""
    return ObstacleSet.from_rectangles(np.array([[1.2, 0.469]]), np.array([[1.4, 0.669]]), "post")


def cusp_path() -> Path:
    """Return a polyline through a left turn forward and a right turn in reverse."""
    return moved_path(cusp_drive(ORIGIN).path, ORIGIN)


def moved_path(path: Path, motion: Pose2) -> Path:
    """Return a polyline through the poses of a path, every 5 cm, moved by a rigid motion."""
    return Path.from_poses([motion @ Pose2.from_sequence(row) for row in path.sample(0.05).poses])
