"""Scene of the collision constraints: convex obstacles, convex parts of the body, and required clearance, as arrays."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.arrays import frozen, readonly
from optdock.geometry.lazy import cached_property
from optdock.model.clearance_rule import START_RELIEF_SLOPE
from smoothers.scp.settings import DEFAULT_SETTINGS, CollisionSettings

if TYPE_CHECKING:
    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray
    from optdock.geometry.footprint import Footprint
    from optdock.geometry.obstacles import ObstacleSet
    from optdock.model.clearance_rule import ClearanceRule
    from optdock.model.problem import DockingProblem

__all__ = [
    "DOCKING",
    "FULL",
    "LEAVING",
    "RULE_NUMBERS",
    "UNDOCKING",
    "Body",
    "BodyAtNodes",
    "Discs",
    "Points",
    "Requirement",
    "Scene",
    "body_at_nodes",
    "covering_discs",
    "scene_around",
]


class Points(NamedTuple):
    """Points or directions as x and y, Shape (k, p) each, with one column per pair."""

    x: FloatArray
    y: FloatArray

    def columns(self, chosen: IntArray | BoolArray) -> Points:
        """Return the columns of the chosen pairs."""
        return Points(self.x[:, chosen], self.y[:, chosen])

    def along(self, axis: Points) -> FloatArray:
        """Return the coordinates of points along the `axis` of each pair, Shape (1, p). Shape (k, p)."""
        heights: FloatArray = axis.x * self.x + axis.y * self.y
        return heights

    def across(self, axis: Points) -> FloatArray:
        """Return the coordinates along the axis turned left by 90 degrees. Shape (k, p)."""
        coordinates: FloatArray = axis.x * self.y - axis.y * self.x
        return coordinates

    def at(self, row: IntArray) -> Points:
        """Return the point in row `row` of every pair. Shape (1, p)."""
        columns = np.arange(row.size)
        return Points(self.x[row, columns][None], self.y[row, columns][None])


class Discs(NamedTuple):
    """The covering discs of every part."""

    counts: IntArray  # Shape (parts,)
    radii: FloatArray  # Shape (parts,) [m]
    centres: FloatArray  # Shape (parts, most, 2) [m]; those beyond the number of a part are 0


class Body(NamedTuple):
    """Convex parts of the footprint, padded to equal vertex counts: vertices, normals (parts, v, 2), boxes (parts, 2).

    `reach`: distance of every vertex from the origin (parts, v). `radius`: the largest of these distances. `width`:
    thickness [m].
    """

    vertices: FloatArray
    normals: FloatArray
    lower: FloatArray
    upper: FloatArray
    reach: FloatArray
    radius: float
    width: float
    discs: Discs


# The part of the clearance rule that applies.
DOCKING, FULL, LEAVING, UNDOCKING = range(4)
RULE_NUMBERS = 12  # in `Scene.packed`


class Requirement(NamedTuple):
    """Required clearance at given positions."""

    value: FloatArray  # Shape (n,) [m]
    gradient: FloatArray  # by position, Shape (n, 2)
    rule: IntArray  # part that decides, Shape (n,): `DOCKING`, `FULL`, `LEAVING`, or `UNDOCKING`
    leaving: FloatArray  # requirement by the growth from the start alone, Shape (n,) [m]


@dataclass(frozen=True, eq=False)
class Scene:
    """Obstacles near the path, the body, and the clearance rule."""

    obstacles: ObstacleSet  # obstacles near the input path
    body: Body
    rule: ClearanceRule
    start: FloatArray  # positions, Shape (2,) [m]
    goal: FloatArray
    start_clearance: float  # clearance of the start pose [m]
    settings: CollisionSettings = DEFAULT_SETTINGS.collision  # selection of pairs
    start_relief: float = 0.0  # length of the weaker rule near the start [m]

    @cached_property
    def packed(self) -> FloatArray:
        """Body, obstacles and rule as one array, in the order of the kernel's `Scene` and `Rule`."""
        body, obstacles = self.body, self.obstacles
        of_body = (body.vertices, body.normals, body.reach, body.lower, body.upper)
        parts = (*of_body, obstacles.vertices, obstacles.normals, obstacles.lower, obstacles.upper, self._rule_numbers)
        return readonly(np.concatenate(parts, axis=None))

    @property
    def _rule_numbers(self) -> FloatArray:
        rule, relief = self.rule, self.start_relief
        at_start = np.inf if rule.at_start is None or relief <= 0.0 else rule.at_start
        least = rule.least_leaving(self.start_clearance, relief)
        numbers = rule.required, rule.at_dock, rule.taper, rule.dock_run, at_start, least, relief, START_RELIEF_SLOPE
        return np.array([*self.goal, *self.start, *numbers])

    @cached_property
    def outline(self) -> Points:
        """Obstacle vertices, one column per obstacle, Shape (k, m) [m]."""
        return _in_columns(self.obstacles.vertices)

    @cached_property
    def edge_normals(self) -> Points:
        """Outward normals of the obstacles' edges, Shape (k, m)."""
        return _in_columns(self.obstacles.normals)

    @cached_property
    def boxes(self) -> tuple[Points, Points]:
        """Middle and half extent of the bounding box of each obstacle, Shape (1, m) each [m]."""
        lower, upper = self.obstacles.lower.T[:, None], self.obstacles.upper.T[:, None]
        return Points(*(0.5 * (lower + upper))), Points(*(0.5 * (upper - lower)))

    def required(self, positions: FloatArray) -> Requirement:
        """Return the required clearance at robot positions, Shape (n, 2) [m]."""
        to_goal, to_start = positions - self.goal, positions - self.start
        from_goal, from_start = np.hypot(to_goal[:, 0], to_goal[:, 1]), np.hypot(to_start[:, 0], to_start[:, 1])
        docking = self.rule.near_goal(from_goal)
        leaving = self.rule.leaving(from_start, self.start_clearance, self.start_relief)
        value, near = np.minimum(docking, leaving), from_goal < self.rule.dock_run + self.rule.taper
        rule = np.where(leaving <= docking, LEAVING, np.where(near, DOCKING, FULL))
        rising = np.where(from_start > self.start_relief, START_RELIEF_SLOPE, 0.0)
        if self.start_relief > 0.0 and self.rule.at_start is not None:
            undocking = self.rule.undocking(from_start)
            is_undocking = undocking < value
            value, rule = np.where(is_undocking, undocking, value), np.where(is_undocking, UNDOCKING, rule)
            rising = np.where(is_undocking, self._taper_slope(from_start, self.rule.at_start or 0.0), rising)
        toward = (self._taper_slope(from_goal, self.rule.at_dock) / np.maximum(from_goal, 1e-9))[:, None] * to_goal
        away = (rising / np.maximum(from_start, 1e-9))[:, None] * to_start
        return Requirement(value, np.where((rule >= LEAVING)[:, None], away, toward), rule, leaving)

    def _taper_slope(self, distance: FloatArray, least: float) -> FloatArray:
        """Return the slope of the required clearance over the distance from an end requiring `least`. Shape (n,)."""
        rule = self.rule
        rises = (rule.dock_run <= distance) & (distance < rule.dock_run + rule.taper)
        return np.where(rises, (rule.required - least) / rule.taper if rule.taper > 0.0 else 0.0, 0.0)


def _in_columns(points: FloatArray) -> Points:
    return Points(*(np.ascontiguousarray(points[..., i].T) for i in (0, 1)))


@lru_cache(maxsize=16)
def body_of(footprint: Footprint, most_discs: int) -> Body:
    """Return the padded parts of a footprint, computed once per footprint, with at most so many discs each."""
    width = max(len(part.vertices) for part in footprint.bodies)
    vertices = np.stack([_padded(part.vertices, width) for part in footprint.bodies])
    normals = np.stack([_padded(part.normals, width) for part in footprint.bodies])
    thickness = 2.0 * max(footprint.inscribed_radius, 0.25 * min(footprint.width, footprint.length))
    reach = np.hypot(vertices[..., 0], vertices[..., 1])
    lower, upper = vertices.min(axis=1), vertices.max(axis=1)
    discs = Discs(np.zeros(len(vertices), np.int64), np.zeros(len(vertices)), np.zeros((len(vertices), most_discs, 2)))
    for i, part in enumerate(footprint.bodies):
        centres, discs.radii[i] = covering_discs(part.vertices, most_discs)
        discs.counts[i], discs.centres[i, : len(centres)] = len(centres), centres
    return frozen(Body(vertices, normals, lower, upper, reach, footprint.circumscribed_radius, thickness, discs))


def covering_discs(vertices: FloatArray, most: int) -> tuple[FloatArray, float]:
    """Return centres, Shape (d, 2), and radius [m] of at most `most` discs along the box of `vertices` (v, 2)."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    extent, middle = high - low, 0.5 * (low + high)
    short, long = sorted(extent.tolist())
    radius = 0.5 * short
    half = 0.5 * long - radius
    count = min(math.ceil(2.0 * half / max(radius, 1e-9)) + 1, most)
    centres = np.empty((count, 2))
    centres[:] = middle
    centres[:, extent.argmax()] += np.linspace(-half, half, count)
    return centres, radius


def _padded(rows: FloatArray, count: int) -> FloatArray:
    return np.concatenate((rows, np.repeat(rows[-1:], count - len(rows), axis=0)))


def scene_around(
    problem: DockingProblem, positions: FloatArray, start_clearance: float, settings: CollisionSettings
) -> Scene:
    """Return the scene within reach of a path through `positions`, Shape (n, 2) [m]."""
    body = body_of(problem.robot.footprint, settings.most_discs)
    reach = body.radius + problem.path_clearance.required + settings.crop
    lower, upper = np.minimum.reduce(positions) - reach, np.maximum.reduce(positions) + reach
    near, start, goal = problem.all_obstacles.in_box(lower, upper), problem.start, problem.goal
    ends = np.array(((start.x, start.y), (goal.x, goal.y)))
    return Scene(near, body, problem.path_clearance, ends[0], ends[1], start_clearance, settings)


class BodyAtNodes(NamedTuple):
    """Vertices and normals of the body's parts, and the required clearance, at every node."""

    corners: Points  # scene positions of all body vertices, one column per part and node, Shape (v, parts * nodes) [m]
    inward: Points  # inward normals of the body's edges, same shape
    required: Requirement  # required clearance at the nodes
    cosine: FloatArray  # of the yaw, Shape (nodes,)
    sine: FloatArray


def body_at_nodes(scene: Scene, poses: FloatArray) -> BodyAtNodes:
    """Return the body at all poses, Shape (nodes, 3)."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    shape = (scene.body.vertices.shape[1], -1)
    turned = []
    for points, sign in ((scene.body.vertices, 1.0), (scene.body.normals, -1.0)):
        x, y = sign * points[..., 0].T[..., None], sign * points[..., 1].T[..., None]  # (v, parts, 1)
        turned.append((c * x - s * y, s * x + c * y))
    corners = Points((poses[:, 0] + turned[0][0]).reshape(shape), (poses[:, 1] + turned[0][1]).reshape(shape))
    inward = Points(turned[1][0].reshape(shape), turned[1][1].reshape(shape))
    return BodyAtNodes(corners, inward, scene.required(poses[:, :2]), c, s)
