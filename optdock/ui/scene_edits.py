"""The scenario on the page of `optdock ui`, and edits of its start, dock and obstacles.

Coordinates that an edit changes are rounded to 1e-6 m, and headings to 1e-4 degrees. A part that is moved and moved
back, or turned in steps by a whole circle, therefore has its former pose to the last bit if that was a rounded one.
"""

from __future__ import annotations

import dataclasses
import functools
import json
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from optdock.config.writing import scenario_document
from optdock.errors import InvalidValue
from optdock.geometry.arrays import digest
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2, normalize_angle, transform_points
from optdock.io.numbers import MOST_POLYGONS
from optdock.ui.edited_obstacle import EditedObstacle
from optdock.ui.scene_grips import Grip, Handle, checked_place, grip_at, handles_of, part_named

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from optdock.config import Scenario
    from optdock.geometry.arrays import FloatArray
    from optdock.model.problem import DockingProblem

__all__ = ["BOX_SIDE", "WALL_THICKNESS", "EditedScene", "rounded_pose"]

BOX_SIDE = 0.4  # [m] of a new box
WALL_THICKNESS = 0.1  # [m] of a new wall
_PLACE_DIGITS = 6  # of coordinates in metres
_ANGLE_DIGITS = 4  # of headings in degrees
_LEAST_LENGTH = 1e-3  # [m] of a new wall


@dataclass(frozen=True, eq=False)
class EditedScene:
    """A scenario with edits, each of which returns a new scene.

    Args:
        scenario: The scenario.
        map_source: Map file of the costmap, or None if the costmap has none or must be written anew.
    """

    scenario: Scenario
    map_source: Path | None = None

    @property
    def problem(self) -> DockingProblem:
        """The docking problem."""
        return self.scenario.problem

    @functools.cached_property
    def obstacles(self) -> tuple[EditedObstacle, ...]:
        """Whole obstacles; the convex pieces if the scenario has no polygons that match them."""
        given, pieces = self.scenario.polygons, self.problem.obstacles
        if given is not None:
            whole = tuple(EditedObstacle.of(polygon, row) for row, polygon in enumerate(given))
            if _as_set(whole).digest == pieces.digest:
                return whole
        return tuple(EditedObstacle.of(piece, row) for row, piece in enumerate(pieces.vertices))

    @functools.cached_property
    def polygons(self) -> tuple[FloatArray, ...]:
        """Vertices of the obstacles, Shape (n, 2) [m] each."""
        return tuple(obstacle.vertices for obstacle in self.obstacles)

    @functools.cached_property
    def fingerprint(self) -> str:
        """Digest of the problem, the plugins with their parameters, and the time budget.

        Equal scenes have equal fingerprints, and a change of any value on which the result depends gives another one.
        """
        complete = dataclasses.replace(self.scenario, default_limits=frozenset())
        document = json.dumps(_without_negative_zeros(scenario_document(complete, obstacles=())), sort_keys=True)
        return digest(document, *(obstacle.digest for obstacle in self.obstacles), *self.problem.fingerprint)

    def with_problem(self, problem: DockingProblem) -> EditedScene:
        """Return the scene with another problem that has the same obstacles."""
        return self._with(problem, self.obstacles)

    def _with(self, problem: DockingProblem, obstacles: tuple[EditedObstacle, ...]) -> EditedScene:
        """Return the scene with another problem whose obstacles are the given ones."""
        scenario = dataclasses.replace(self.scenario, problem=problem, polygons=tuple(one.points for one in obstacles))
        edited = dataclasses.replace(self, scenario=scenario)
        vars(edited)["obstacles"] = obstacles
        return edited

    @functools.cached_property
    def handles(self) -> tuple[Handle, ...]:
        """The parts, each with a point at which it is grabbed; see `scene_grips.handles_of`."""
        return handles_of(self.problem, self.obstacles)

    def grip_at(self, x: float, y: float, reach: float, selected: str = "") -> Grip | None:
        """Return the part that a pointer grabs, or None if no part is within reach; see `scene_grips.grip_at`.

        Args:
            x: [m].
            y: [m].
            reach: Tolerance of the pointer, >= 0 [m].
            selected: Name of the part that comes before others of its kind.

        Raises:
            InvalidValue: If a number is not finite or out of range.
        """
        return grip_at(self.problem, self.obstacles, (x, y), reach, selected)

    def grip(self, name: str) -> Grip:
        """Return the grip of a part at the point of its handle.

        Raises:
            InvalidValue: If there is no such part.
        """
        part_named(name, self.obstacles)
        return next(Grip(name, one.x, one.y) for one in self.handles if one.name == name)

    def dragged(self, grip: Grip, to: tuple[float, float]) -> EditedScene:
        """Return the scene in which a part was dragged.

        Bodies keep their offset from the pointer, and turning handles their angle. During a drag, the scene at its
        beginning is dragged to the present point of the pointer, so that errors do not accumulate.

        Args:
            grip: The part and the point at which it was grabbed.
            to: Present point of the pointer [m].

        Raises:
            InvalidValue: If there is no such part, a number is not finite or out of range, or the scene would be
                invalid, e.g. if the edges of an obstacle would cross.
        """
        part = part_named(grip.name, self.obstacles)
        (x, y), (x0, y0) = checked_place(to), checked_place((grip.x, grip.y))
        if (x, y) == (x0, y0):
            return self
        if part.is_heading:
            centre = self._pose(part.owner)
            angles = [math.atan2(b - centre.y, a - centre.x) for a, b in ((x0, y0), (x, y))]
            return self.turned(grip, angles[1] - angles[0])
        moved = np.array([x - x0, y - y0])
        if part.owner != "obstacles":
            pose = self._pose(part.owner)
            at = _rounded(moved + np.array([pose.x, pose.y]))
            return self._with_pose(part.owner, Pose2(float(at[0]), float(at[1]), pose.yaw))
        polygon = self.polygons[part.row]
        rows = slice(None) if part.corner is None else part.corner
        vertices = np.array(polygon)
        vertices[rows] = _rounded(vertices[rows] + moved)
        return self._with_polygon(part.row, vertices)

    def turned(self, grip: Grip, angle: float) -> EditedScene:
        """Return the scene in which the owner of a part was turned, an obstacle about its centroid.

        Args:
            grip: The part.
            angle: Counter-clockwise [rad].

        Raises:
            InvalidValue: As for `dragged`; also if the part is a corner.
        """
        part = part_named(grip.name, self.obstacles)
        if part.corner is not None:
            raise InvalidValue(f"{part.name}: a corner cannot be turned")
        turn = normalize_angle(checked_place((angle, 0.0))[0])
        if abs(math.degrees(turn)) < 0.5 * 10.0**-_ANGLE_DIGITS:
            return self
        if part.owner != "obstacles":
            pose = self._pose(part.owner)
            return self._with_pose(part.owner, Pose2(pose.x, pose.y, _rounded_yaw(pose.yaw + turn)))
        import shapely

        polygon = self.polygons[part.row]
        centre = shapely.get_coordinates(shapely.centroid(shapely.Polygon(polygon)))[0]
        about = np.array([[*centre, turn]])
        return self._with_polygon(part.row, _rounded(transform_points(about, polygon - centre)[0]))

    def nudged(self, grip: Grip, dx: float, dy: float) -> EditedScene:
        """Return the scene in which a part was dragged by an offset, e.g. by a key.

        Args:
            grip: The part.
            dx: [m].
            dy: [m].

        Raises:
            InvalidValue: As for `dragged`.
        """
        x, y = checked_place((grip.x, grip.y))
        dx, dy = checked_place((dx, dy))
        return self.dragged(grip, (x + dx, y + dy))

    def added_box(self, x: float, y: float) -> EditedScene:
        """Return the scene with a square obstacle, `BOX_SIDE` wide, around a point [m]; it is the last obstacle.

        Raises:
            InvalidValue: If a number is not finite or out of range, or there are too many obstacles.
        """
        half = 0.5 * BOX_SIDE
        return self._with_added(np.array(checked_place((x, y))) + half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]))

    def added_wall(self, x0: float, y0: float, x1: float, y1: float) -> EditedScene:
        """Return the scene with a wall, `WALL_THICKNESS` thick, along a line [m]; it is the last obstacle.

        Raises:
            InvalidValue: If a number is not finite or out of range, the line is shorter than 1 mm, or there are too
                many obstacles.
        """
        first, last = np.array(checked_place((x0, y0))), np.array(checked_place((x1, y1)))
        length = float(np.hypot(*(last - first)))
        if length < _LEAST_LENGTH:
            raise InvalidValue(f"wall: must be at least {_LEAST_LENGTH} m long, got {length:.6f}")
        along = (last - first) / length
        side = 0.5 * WALL_THICKNESS * np.array([-along[1], along[0]])
        return self._with_added(np.array([first - side, last - side, last + side, first + side]))

    def removed(self, grip: Grip) -> EditedScene:
        """Return the scene without an obstacle; the later obstacles have new names.

        Raises:
            InvalidValue: If there is no such part, or it is not an obstacle or a corner of one.
        """
        part = part_named(grip.name, self.obstacles)
        if part.owner != "obstacles":
            raise InvalidValue(f"{part.name}: start and dock cannot be removed, only obstacles")
        return self._with_obstacles((*self.obstacles[: part.row], *self.obstacles[part.row + 1 :]))

    def _pose(self, owner: str) -> Pose2:
        return self.problem.start if owner == "start" else self.problem.goal

    def _with_pose(self, owner: str, pose: Pose2) -> EditedScene:
        problem = self.problem
        if owner == "dock":
            moved = dataclasses.replace(problem, dock=dataclasses.replace(problem.dock, pose=pose))
        else:
            moved = problem.starting_at(pose, problem.start_speed, problem.start_curvature, problem.start_acceleration)
        return self.with_problem(moved)

    def _with_polygon(self, row: int, vertices: FloatArray) -> EditedScene:
        changed = EditedObstacle.of(vertices, row)
        return self._with_obstacles((*self.obstacles[:row], changed, *self.obstacles[row + 1 :]))

    def _with_added(self, vertices: FloatArray) -> EditedScene:
        count = len(self.obstacles)
        if count >= MOST_POLYGONS:
            raise InvalidValue(f"obstacles: must be at most {MOST_POLYGONS} polygons; draw them into the map")
        return self._with_obstacles((*self.obstacles, EditedObstacle.of(_rounded(vertices), count)))

    def _with_obstacles(self, obstacles: tuple[EditedObstacle, ...]) -> EditedScene:
        return self._with(dataclasses.replace(self.problem, obstacles=_as_set(obstacles)), obstacles)


def _as_set(obstacles: Sequence[EditedObstacle]) -> ObstacleSet:
    return ObstacleSet.from_decomposed(obstacle.pieces for obstacle in obstacles)


def _rounded(places: FloatArray) -> FloatArray:
    # Python's `round` gives the float nearest to the decimal number, unlike NumPy's.
    return np.array([round(value, _PLACE_DIGITS) + 0.0 for value in places.ravel().tolist()]).reshape(places.shape)


def rounded_pose(x: float, y: float, yaw: float) -> Pose2:
    """Return the pose with coordinates [m] and heading [rad] rounded as by an edit.

    Raises:
        InvalidValue: If a number is not finite or out of range.
    """
    place = _rounded(np.array(checked_place((x, y)))).tolist()
    return Pose2(place[0], place[1], _rounded_yaw(yaw))


def _rounded_yaw(yaw: float) -> float:
    return math.radians(round(math.degrees(normalize_angle(yaw)), _ANGLE_DIGITS) + 0.0)


def _without_negative_zeros(value: object) -> object:
    if isinstance(value, dict):
        return {key: _without_negative_zeros(one) for key, one in value.items()}
    if isinstance(value, list):
        return [_without_negative_zeros(one) for one in value]
    return value + 0.0 if isinstance(value, float) else value
