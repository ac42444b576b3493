"""Docks of a survey: of the scenario, of a dock database, or proposed along the walls of a map.

A proposed dock stands with the back of its station against a wall. The walls are the outlines of the union of all
obstacles, simplified ([Douglas1973]) so that the steps of the cells of a map become straight lines.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.errors import InvalidValue, OptdockError
from optdock.geometry.pose import Pose2, transform_points
from optdock.impossibility import prove_straight_blocked
from optdock.model.dock import DockDirection
from optdock.planning.failures import check_ends

if TYPE_CHECKING:
    from collections.abc import Iterator

    from optdock.geometry.arrays import FloatArray
    from optdock.geometry.footprint import Footprint
    from optdock.model.problem import DockingProblem
    from optdock.survey.grid import Box

__all__ = ["DockPlace", "along_walls"]

_SIMPLIFIED = 1.5  # cells of the map: a wall may deviate from its line by the steps of its cells
_SIMPLIFIED_LEAST = 0.01  # [m], without a map
_OUTSIDE = 1e6  # [m]: larger pieces are the outside of a map, whose border is no wall
_BEHIND = 0.002  # [m] between a proposed dock and its wall, at least the deviation of the wall from its line


class DockPlace(NamedTuple):
    """Name of a dock and pose of the docked robot."""

    name: str
    pose: Pose2


def along_walls(problem: DockingProblem, spacing: float, region: Box | None = None) -> list[DockPlace]:
    """Return docks along the walls at which the docked robot has the required clearance and a free final straight.

    Their stations overlap no obstacle.

    Args:
        problem: Robot, obstacles and a dock, whose station, direction and rules every proposed dock has.
        spacing: Distance between neighbouring docks along a wall [m].
        region: Region of the docked robot; None for the whole plane.

    Raises:
        InvalidValue: If the spacing is not > 0.
    """
    if not (math.isfinite(spacing) and spacing > 0.0):
        raise InvalidValue(f"along walls: the spacing must be > 0 m, got {spacing}")
    depth, width = _extent(problem)
    free = dataclasses.replace(problem, dock=dataclasses.replace(problem.dock, footprint=None))
    found: list[DockPlace] = []
    for point, outward in _wall_points(free, spacing, width):
        gear = -1.0 if problem.dock.direction is DockDirection.BACKWARD else 1.0
        back = depth + _off_the_wall(free)
        x, y = (point + back * outward).tolist()
        pose = Pose2(x, y, math.atan2(-gear * outward[1], -gear * outward[0]))
        inside = region is None or (region.left <= x <= region.right and region.lower <= y <= region.upper)
        if inside and _station_fits(problem.dock.footprint, pose, free) and _can_stand(free, pose):
            found.append(DockPlace(f"wall {len(found) + 1}", pose))
    return found


def _extent(problem: DockingProblem) -> tuple[float, float]:
    """Return the distance [m] from the docked robot's origin to the back of the station, and the station's width.

    Without a station, those of the robot's own outline with the clearance at the dock.
    """
    dock = problem.dock
    gear = -1.0 if dock.direction is DockDirection.BACKWARD else 1.0
    outline = problem.robot.footprint.vertices if dock.footprint is None else dock.footprint.vertices
    more = problem.clearance.at_dock if dock.footprint is None else 0.0
    return float((gear * outline[:, 0]).max()) + more, float(np.ptp(outline[:, 1]))


def _off_the_wall(problem: DockingProblem) -> float:
    """Return the largest deviation [m] of a wall from its line, plus `_BEHIND`."""
    return _BEHIND + _tolerance(problem)


def _tolerance(problem: DockingProblem) -> float:
    cells = 0.0 if problem.costmap is None else _SIMPLIFIED * problem.costmap.resolution
    return max(cells, _SIMPLIFIED_LEAST)


def _wall_points(problem: DockingProblem, spacing: float, width: float) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield points on walls and their unit normals into the free space; walls narrower than `width` are left out."""
    import shapely

    pieces = problem.all_obstacles.vertices
    pieces = pieces[np.abs(pieces).max(axis=(1, 2)) < _OUTSIDE]
    union = shapely.union_all(shapely.polygons(pieces))
    # A hair's breadth closes the seams between pieces that touch.
    union = union.buffer(1e-4, join_style="mitre").simplify(_tolerance(problem))
    for body in shapely.get_parts(union):
        for number_of_ring, ring in enumerate((body.exterior, *body.interiors)):
            corners = np.asarray(shapely.get_coordinates(ring))
            is_left = ring.is_ccw == (number_of_ring == 0)
            for start, end in itertools.pairwise(corners):
                along = end - start
                length = float(np.hypot(*along))
                if length < max(width, 1e-9):
                    continue
                tangent = along / length
                # The body is to the left of a counter-clockwise exterior, and the free space to the right.
                outward = np.array([tangent[1], -tangent[0]]) * (1.0 if is_left else -1.0)
                count = int((length - width) / spacing) + 1
                first = 0.5 * (length - (count - 1) * spacing)
                for number in range(count):
                    yield start + (first + number * spacing) * tangent, outward


def _station_fits(station: Footprint | None, goal: Pose2, problem: DockingProblem) -> bool:
    """Whether a station in front of a docked robot at `goal` overlaps no obstacle."""
    import shapely

    if station is None:
        return True
    outline = transform_points(goal.as_array()[None], station.vertices)[0]
    near = problem.all_obstacles.in_box(outline.min(axis=0), outline.max(axis=0))
    return not bool(shapely.intersects(shapely.Polygon(outline), shapely.polygons(near.vertices)).any())


def _can_stand(problem: DockingProblem, goal: Pose2) -> bool:
    """Whether a docked robot at `goal` has the required clearance, and the straight into the dock is free."""
    moved = dataclasses.replace(problem, dock=dataclasses.replace(problem.dock, pose=goal), start=goal)
    try:
        check_ends(moved)
    except OptdockError:
        return False
    return prove_straight_blocked(moved) is None
