"""Parts of a scene that a pointer can grab: turning handles, corners, the robot at the start, the dock and obstacles.

Parts have the names of their scenario keys: `start` and `dock`, each with a turning handle, `start.heading` and
`dock.heading`, and the obstacles, `obstacles[3]`, with their corners, `obstacles[3].corners[1]`. The cells of a costmap
are no parts.
"""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.errors import InvalidValue
from optdock.geometry.checked import finite_number
from optdock.geometry.pose import Pose2, transform_points
from optdock.io.quoting import shown
from optdock.ui.edited_obstacle import disc_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from shapely.geometry.base import BaseGeometry

    from optdock.geometry.arrays import FloatArray
    from optdock.geometry.footprint import Footprint
    from optdock.model.problem import DockingProblem
    from optdock.ui.edited_obstacle import EditedObstacle

__all__ = ["Grip", "Handle", "ScenePart", "checked_place", "grip_at", "handles_of", "part_named"]

# Fractions of the robot's circumscribed radius: gap between its front and its turning handle; radius of the handle.
_HANDLE_GAP, _HANDLE_RADIUS = 0.4, 0.12
_CORNER_RADIUS = 0.04  # [m]
_NAME = re.compile(r"(start|dock)(\.heading)?|obstacles\[(\d{1,6})\](?:\.corners\[(\d{1,4})\])?")


class Grip(NamedTuple):
    """A part and the point at which it is grabbed.

    Attributes:
        name: Name of the part.
        x: [m].
        y: [m].
    """

    name: str
    x: float
    y: float


class Handle(NamedTuple):
    """A part, a point at which it can be grabbed, and its size.

    Attributes:
        name: Name of the part.
        x: [m].
        y: [m].
        radius: Of a turning handle or a corner, the radius of its disc; of a body, the largest distance of its outline
            from the point [m].
    """

    name: str
    x: float
    y: float
    radius: float


class ScenePart(NamedTuple):
    """A part of a scene.

    Attributes:
        owner: `start`, `dock` or `obstacles`.
        is_heading: Whether the part is the turning handle of its owner.
        row: Number of the obstacle, from 0.
        corner: Number of the corner of the obstacle, from 0; None for the obstacle.
    """

    owner: str
    is_heading: bool = False
    row: int = 0
    corner: int | None = None

    @property
    def name(self) -> str:
        """Name of the part."""
        if self.owner != "obstacles":
            return f"{self.owner}.heading" if self.is_heading else self.owner
        return f"obstacles[{self.row}]" + ("" if self.corner is None else f".corners[{self.corner}]")


class _Candidate(NamedTuple):
    """A part within reach: `rank` is lower for smaller kinds of parts, `distance` from the pointer in metres."""

    rank: int
    distance: float
    part: ScenePart


def part_named(name: str, obstacles: Sequence[EditedObstacle]) -> ScenePart:
    """Return the part of a name, which may be any text from the page.

    Args:
        name: Name of the part.
        obstacles: Obstacles of the scene.

    Raises:
        InvalidValue: If the scene has no such part.
    """
    match = _NAME.fullmatch(name) if isinstance(name, str) else None
    part = None if match is None else ScenePart(match[1] or "obstacles", bool(match[2]), *_numbers(match))
    if part is None or (part.owner == "obstacles" and not _exists(part, obstacles)):
        raise InvalidValue(f"grip: the scene has no part {shown(name)}")
    return part


def _numbers(match: re.Match[str]) -> tuple[int, int | None]:
    return int(match[3] or 0), None if match[4] is None else int(match[4])


def _exists(part: ScenePart, obstacles: Sequence[EditedObstacle]) -> bool:
    return part.row < len(obstacles) and (part.corner is None or part.corner < len(obstacles[part.row].points))


def handles_of(problem: DockingProblem, obstacles: Sequence[EditedObstacle]) -> tuple[Handle, ...]:
    """Return the parts of a scene, the smallest kinds first, each with a point at which it is grabbed.

    A part whose point is covered by an earlier part is grabbed at its other points.

    Args:
        problem: The problem.
        obstacles: Its obstacles.
    """
    turning = (_turning_handle(problem, owner) for owner in ("start", "dock"))
    corners = (
        Handle(f"obstacles[{row}].corners[{i}]", x, y, radius)
        for row, obstacle in enumerate(obstacles)
        for i, ((x, y), radius) in enumerate(zip(obstacle.points, _corner_radii(obstacle).tolist(), strict=True))
    )
    robots = (Handle(owner, *disc_of(shape)) for owner, shape in _robots(problem))
    bodies = (Handle(f"obstacles[{row}]", *obstacle.disc) for row, obstacle in enumerate(obstacles))
    return (*turning, *corners, *robots, *bodies)


def grip_at(
    problem: DockingProblem,
    obstacles: Sequence[EditedObstacle],
    place: tuple[float, float],
    reach: float,
    selected: str = "",
) -> Grip | None:
    """Return the part that a pointer grabs, or None if no part is within reach.

    Turning handles come before corners, corners before the robot at the start, and then the dock and the obstacles; the
    selected part comes first among handles and corners, and among bodies;
    among parts of one kind the nearest is returned. The reach of a turning handle ends outside the robot, and that of a
    corner at a third of the longer adjacent edge, so that a coarse pointer can grab bodies, too.

    Args:
        problem: The problem.
        obstacles: Its obstacles.
        place: Pointer [m].
        reach: Tolerance of the pointer, >= 0 [m].
        selected: Name of the selected part.

    Raises:
        InvalidValue: If a number is not finite or out of range.
    """
    x, y = checked_place(place)
    if finite_number(reach, "reach") < 0.0:
        raise InvalidValue(f"reach: must be >= 0 m, got {reach}")
    small = [*_turning_within(problem, x, y, reach), *_corners_within(obstacles, x, y, reach)]
    found = small or [*_bodies_within(problem, obstacles, x, y, reach)]
    chosen = [one for one in found if one.part.name == selected] or found
    return Grip(min(chosen, key=lambda one: one[:2]).part.name, x, y) if chosen else None


def checked_place(point: tuple[float, float]) -> tuple[float, float]:
    """Return a point after checking that it is finite and in the range of coordinates.

    Raises:
        InvalidValue: If it is not.
    """
    place = Pose2(finite_number(point[0], "x"), finite_number(point[1], "y"), 0.0)
    return place.x, place.y


def _turning_handle(problem: DockingProblem, owner: str) -> Handle:
    footprint, pose = problem.robot.footprint, problem.start if owner == "start" else problem.goal
    ahead = float(footprint.vertices[:, 0].max()) + _HANDLE_GAP * footprint.circumscribed_radius
    at = pose @ Pose2(ahead, 0.0, 0.0)
    return Handle(f"{owner}.heading", at.x, at.y, _HANDLE_RADIUS * footprint.circumscribed_radius)


def _turning_within(problem: DockingProblem, x: float, y: float, reach: float) -> Iterator[_Candidate]:
    most = 0.5 * _HANDLE_GAP * problem.robot.footprint.circumscribed_radius
    for owner in ("start", "dock"):
        handle = _turning_handle(problem, owner)
        distance = math.hypot(handle.x - x, handle.y - y)
        if distance <= handle.radius + min(reach, most):
            yield _Candidate(0, distance, ScenePart(owner, is_heading=True))


def _corners_within(obstacles: Sequence[EditedObstacle], x: float, y: float, reach: float) -> Iterator[_Candidate]:
    for row, obstacle in enumerate(obstacles):
        distances = np.hypot(obstacle.vertices[:, 0] - x, obstacle.vertices[:, 1] - y)
        within = np.minimum(reach + _corner_radii(obstacle), obstacle.longer_edges / 3.0)
        for corner in np.flatnonzero(distances <= within).tolist():
            yield _Candidate(1, float(distances[corner]), ScenePart("obstacles", row=row, corner=corner))


def _bodies_within(
    problem: DockingProblem, obstacles: Sequence[EditedObstacle], x: float, y: float, reach: float
) -> Iterator[_Candidate]:
    import shapely

    robots = [(ScenePart(owner), shape) for owner, shape in _robots(problem)]
    bodies = [(ScenePart("obstacles", row=row), obstacle.shape) for row, obstacle in enumerate(obstacles)]
    parts, shapes = zip(*robots, *bodies, strict=True)
    distances = shapely.distance(np.array(shapes), shapely.Point(x, y))
    for row in np.flatnonzero(distances <= reach).tolist():
        # Later obstacles are drawn above earlier ones, so of those under the pointer the last one is grabbed.
        rank = {"start": 2, "dock": 3}.get(parts[row].owner, 4)
        yield _Candidate(rank, float(distances[row]) or -float(row), parts[row])


def _robots(problem: DockingProblem) -> Iterator[tuple[str, BaseGeometry]]:
    """Yield the robot at the start, and the docked robot with its station."""
    import shapely

    robot, station = problem.robot.footprint, problem.dock.footprint
    yield "start", _placed(robot, problem.start)
    docked = _placed(robot, problem.goal)
    yield "dock", docked if station is None else shapely.union(docked, _placed(station, problem.goal))


def _corner_radii(obstacle: EditedObstacle) -> FloatArray:
    radii: FloatArray = np.minimum(_CORNER_RADIUS, obstacle.longer_edges / 6.0)
    return radii


def _placed(footprint: Footprint, pose: Pose2) -> BaseGeometry:
    import shapely

    return shapely.Polygon(transform_points(pose.as_array()[None], footprint.vertices)[0])
