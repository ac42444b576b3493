"""Obstacles, and the distance of the true outline from them, by shapely.

Obstacles are solid and closed, and touching obstacles are one: a tip between two touching squares is inside. Occupied
and unknown cells are squares; everything off the grid is an obstacle.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely

if TYPE_CHECKING:
    from experiments.fuzz.case import Case
    from experiments.fuzz.oracle.motion import Floats

__all__ = ["World", "placed"]

_LETHAL = 254
_UNION_CORNERS = 160  # one geometry up to this size, a tree of parts beyond
_MAX_DEPTHS = 24  # overlapping poses with measured depth per call; the others count as touching


def placed(points: Floats, pose: Floats) -> Floats:
    """Return points of a body, Shape (k, 2), at poses, Shape (n, 3). Shape (n, k, 2)."""
    c, s = np.cos(pose[:, 2, None]), np.sin(pose[:, 2, None])
    x = pose[:, 0, None] + c * points[:, 0] - s * points[:, 1]
    y = pose[:, 1, None] + s * points[:, 0] + c * points[:, 1]
    return np.stack((x, y), axis=-1)


@dataclass
class World:
    """The obstacles of a case, and its robot's outline."""

    outline: Floats | None
    radius: float
    solid: Any  # the union of all obstacles except the outside of the grid
    box: tuple[float, float, float, float] | None  # the grid: x0, y0, x1, y1
    _tree: Any = field(default=None, repr=False)
    _parts: Any = field(default=None, repr=False)

    @classmethod
    def of(cls, case: Case) -> World:
        """Return the world of a problem case."""
        shape = case["footprint"]
        outline = np.array(shape["polygon"], dtype=float) if "polygon" in shape else None
        solids = [shapely.Polygon(one) for one in case["obstacles"]]
        if case["dock"].get("footprint"):
            at = np.array([case["dock"]["pose"]], dtype=float)
            solids.append(shapely.Polygon(placed(np.array(case["dock"]["footprint"], dtype=float), at)[0]))
        cells, box = _grid(case.get("grid"))
        solids += cells
        world = cls(outline, float(shape.get("radius", 0.0)), shapely.union_all(solids) if solids else None, box)
        if world.solid is not None and shapely.get_num_coordinates(world.solid) > _UNION_CORNERS:
            world._parts = np.array(cells + solids[: len(solids) - len(cells)])
            world._tree = shapely.STRtree(world._parts)
        return world

    @property
    def reach(self) -> float:
        """Largest distance of a point of the robot from its origin [m]."""
        return self.radius if self.outline is None else float(np.max(np.hypot(*self.outline.T)))

    @property
    def is_empty(self) -> bool:
        """Whether there are no obstacles."""
        return self.solid is None and self.box is None

    def bodies(self, poses: Floats) -> Any:  # noqa: ANN401 - shapely has no types
        """Return the robot at poses: polygons, or the centres of discs."""
        if self.outline is None:
            return shapely.points(poses[:, :2])
        return shapely.polygons(placed(self.outline, poses))

    def clearances(self, poses: Floats) -> Floats:
        """Return the distance to the nearest obstacle, Shape (n,) [m].

        Negative for an overlap beyond rounding: minus a *lower* bound of the displacement that frees the robot, so that
        no shortfall is overstated.
        """
        found = np.full(len(poses), np.inf)
        if self.solid is not None:
            bodies = self.bodies(poses)
            found = self._distances(bodies) - self.radius
            if self.outline is None:
                inside = np.flatnonzero(found <= -self.radius)
                found[inside] = -self.radius - shapely.distance(bodies[inside], shapely.boundary(self.solid))
            else:
                deep = np.flatnonzero(found <= 0.0)
                deep = deep[:: max(1, -(-deep.size // _MAX_DEPTHS))]
                found[deep] = -self._depths(bodies[deep])
        return np.minimum(found, self._inside_box(poses))

    def _distances(self, bodies: Any) -> Floats:  # noqa: ANN401
        if self._tree is None:
            distance: Floats = shapely.distance(bodies, self.solid)
            return distance
        (rows, _), near = self._tree.query_nearest(bodies, return_distance=True, all_matches=False)
        found = np.full(len(bodies), np.inf)
        found[rows] = near
        return found

    def _depths(self, bodies: Any) -> Floats:  # noqa: ANN401
        """Return lower bounds of the displacements that free bodies from the solid, Shape (n,) [m].

        A point of both at distance d from the edge of either has to move by d; a region of area A and perimeter P
        contains a disc of radius A / P, which has to leave by its diameter.
        """
        common = shapely.intersection(bodies, self.solid)
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = np.nan_to_num(2.0 * shapely.area(common) / shapely.length(common), posinf=0.0)
        points, owner = shapely.get_coordinates(common, return_index=True)
        corner = shapely.points(points)
        for edges in (shapely.boundary(self.solid), shapely.boundary(bodies)[owner]):
            np.maximum.at(depth, owner, shapely.distance(corner, edges))
        result: Floats = depth
        return result

    def _inside_box(self, poses: Floats) -> Floats:
        """Return the distance of the robot from the outside of the grid; negative outside. Shape (n,) [m]."""
        if self.box is None:
            return np.full(len(poses), np.inf)
        if self.outline is None:
            low, high = poses[:, :2] - self.radius, poses[:, :2] + self.radius
        else:
            corners = placed(self.outline, poses)
            low, high = corners.min(axis=1), corners.max(axis=1)
        gaps = np.column_stack((low - self.box[:2], np.array(self.box[2:]) - high))
        inside: Floats = gaps.min(axis=1)
        return inside


def _grid(grid: Case | None) -> tuple[list[Any], tuple[float, float, float, float] | None]:
    """Return boxes of the cells that are occupied or unknown, and the box of the whole grid."""
    if grid is None:
        return [], None
    cells, side, (x, y) = np.array(grid["cells"]), grid["resolution"], grid["origin"]
    j, i = np.nonzero(cells >= _LETHAL)
    boxes = shapely.box(x + side * i, y + side * j, x + side * (i + 1), y + side * (j + 1))
    rows, columns = cells.shape
    return list(np.atleast_1d(boxes)), (x, y, x + side * columns, y + side * rows)
