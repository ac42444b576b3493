"""A docking problem for a caller that gives only a path: ends from the path, everything else from the context."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

from optdock.costmap.cell_obstacles import obstacles_from_costmap
from optdock.dock import Dock, DockDirection
from optdock.errors import InvalidValue
from optdock.limits import MotionLimits
from optdock.obstacles import ObstacleSet
from optdock.problem import ClearanceRule, DockingProblem
from optdock.robot import Robot

if TYPE_CHECKING:
    from optdock.lifecycle import PluginContext
    from optdock.path import Path

__all__ = ["configured_problem", "covers", "problem_between_ends"]

_MARGIN = 1.5  # [m]: how far around the path the costmap is read, beyond the footprint
_SPACING = 0.2  # [m] between the points that say where a path is


_SAME_POSE = 1e-6  # [m], [rad]: as the certificate's


def configured_problem(path: Path, problem: DockingProblem) -> DockingProblem:
    """The configured problem; where `path` begins or ends elsewhere, with that end instead.

    A path that begins elsewhere begins at rest with free steering. One that ends elsewhere does not dock: the station
    is an obstacle like others, and no gear, final straight or slow approach is asked for.
    """
    if path.start.gap_to(problem.start) > _SAME_POSE:
        problem = dataclasses.replace(problem, start=path.start, start_speed=0.0, start_curvature=None)
    if path.end.gap_to(problem.goal) > _SAME_POSE:
        elsewhere = Dock(path.end, direction=DockDirection.AUTO)
        problem = dataclasses.replace(problem, obstacles=problem.all_obstacles, dock=elsewhere)
    return problem


def problem_between_ends(
    path: Path, context: PluginContext, limits: MotionLimits, clearance: float, final_straight: float
) -> DockingProblem:
    """From the first pose of `path` to its last, among the occupied cells of the context's costmaps around it.

    The problem holds the cells that were read, not the grid; `covers` tells whether a result stayed among them.

    Raises:
        InvalidValue: The context has no footprint.
    """
    if context.footprint is None:
        raise InvalidValue(f"{context.name}: configure it with a footprint, or pass a problem to smooth()")
    points = path.sample(_SPACING).poses[:, :2]
    reach = context.footprint.circumscribed_radius + clearance + _MARGIN
    region = points.min(axis=0) - reach, points.max(axis=0) + reach
    obstacles = ObstacleSet.empty()
    if context.costmap is not None:
        obstacles = obstacles_from_costmap(context.costmap, region=region)
    if context.local_costmap is not None and context.local_costmap is not context.costmap:
        obstacles = obstacles + obstacles_from_costmap(context.local_costmap, region=region, border=False)
    rule = ClearanceRule(required=clearance, at_dock=0.0, taper=0.5 if clearance > 0.0 else 0.0)
    dock = Dock(path.end, final_straight=final_straight)
    robot = Robot(context.footprint, limits)
    return DockingProblem(path.start, dock, robot, obstacles, rule, frame=path.frame)


def covers(path: Path, result: Path) -> bool:
    """Whether the costmap read around `path` holds every cell that the footprint can meet on `result`."""
    points, reached = path.sample(_SPACING).poses[:, :2], result.sample(_SPACING).poses[:, :2]
    slack = _MARGIN - _SPACING
    inside = (reached >= points.min(axis=0) - slack) & (reached <= points.max(axis=0) + slack)
    return bool(inside.all())
