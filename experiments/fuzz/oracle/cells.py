"""Check of a set of cells of poses that is said to separate the start from the goal.

If the set contains one end of a motion and not the other one, every motion leaves it through a face of one of its
cells. Poses just outside of random faces must therefore lack the required clearance, by shapely's distances.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from experiments.fuzz.oracle.sweep import required_at, start_clearance, start_run
from experiments.fuzz.oracle.world import World

if TYPE_CHECKING:
    import numpy.typing as npt

    from experiments.fuzz.case import Case
    from experiments.fuzz.oracle.motion import Floats, Ints

__all__ = ["Cells", "leak"]

_FACES = 3000  # random faces of cells in the set
_POSES = 400  # of these, poses outside of the set whose clearance is measured
_FREE = 1e-6  # [m]: a pose with more clearance than this beyond the requirement is free
_ACROSS = 1e-7  # [m]: distance of the poses from the face


class Cells(NamedTuple):
    """Cells of positions (x, y) of a point of the robot and of headings.

    `origin`: corner of the tile (0, 0) of every level [m]. `side`: side of a cell of level 0, halved with each level
    [m]. `headings`: number of headings of level 0, doubled with each level. `centre`: the point, in the robot's frame
    [m]. `tiles`: level, column and row of each tile, Shape (n, 3). `inside`: the cells of each tile that are in the
    set, Shape (headings, rows, columns) each.
    """

    origin: tuple[float, float]
    side: float
    headings: int
    centre: tuple[float, float]
    tiles: Ints
    inside: tuple[npt.NDArray[np.bool_], ...]

    def side_of(self, k: int) -> float:
        """Return the side of the cells of a tile [m]."""
        return float(self.side / 2.0 ** self.tiles[k, 0])

    def corner_of(self, k: int) -> Floats:
        """Return the lower left corner of a tile, relative to the origin, Shape (2,) [m]."""
        corner: Floats = self.tiles[k, 1:] * self.inside[k].shape[1] * self.side_of(k)
        return corner

    def contains(self, points: Floats) -> npt.NDArray[np.bool_]:
        """Return whether points (x and y relative to the origin, heading) are in the set. Shape (n,)."""
        found = np.zeros(len(points), dtype=np.bool_)
        for k, inside in enumerate(self.inside):
            layers, rows, columns = inside.shape
            i, j = np.floor((points[:, :2] - self.corner_of(k)) / self.side_of(k)).astype(np.int64).T
            here = np.flatnonzero((i >= 0) & (i < columns) & (j >= 0) & (j < rows))
            layer = np.floor(points[here, 2] * layers / (2.0 * math.pi)).astype(np.int64) % layers
            found[here] |= inside[layer, j[here], i[here]]
        return found

    def point_of(self, pose: list[float]) -> Floats:
        """Return the point of a pose of the robot, Shape (1, 3)."""
        c, s = math.cos(pose[2]), math.sin(pose[2])
        x, y = self.centre
        return np.array([[pose[0] + c * x - s * y - self.origin[0], pose[1] + s * x + c * y - self.origin[1], pose[2]]])

    def poses_of(self, points: Floats) -> Floats:
        """Return the poses of the robot at points, Shape (n, 3)."""
        c, s = np.cos(points[:, 2]), np.sin(points[:, 2])
        x, y = self.centre
        at_x, at_y = points[:, 0] + self.origin[0] - (c * x - s * y), points[:, 1] + self.origin[1] - (s * x + c * y)
        return np.column_stack((at_x, at_y, points[:, 2]))

    def across_faces(self, rng: np.random.Generator, count: int) -> Floats:
        """Return points just across random faces of random cells of the set, Shape (count, 3)."""
        sizes = np.array([inside.sum() for inside in self.inside], dtype=float)
        found = []
        for k, number in zip(
            *np.unique(rng.choice(sizes.size, count, p=sizes / sizes.sum()), return_counts=True), strict=True
        ):
            cells = np.argwhere(self.inside[k])
            layer, j, i = cells[rng.integers(len(cells), size=number)].T
            within = rng.uniform(0.0, 1.0, (number, 3))
            axis, sign = rng.integers(0, 3, number), rng.choice([0.0, 1.0], number)
            rows = np.arange(number)
            side, turn = self.side_of(int(k)), 2.0 * math.pi / self.inside[k].shape[0]
            units = np.array([side, side, turn])
            within[rows, axis] = sign + (2.0 * sign - 1.0) * _ACROSS / units[axis]
            found.append((np.column_stack((i, j, layer)) + within) * units + [*self.corner_of(int(k)), 0.0])
        return np.concatenate(found)


def leak(case: Case, cells: Cells, ends: tuple[list[float], list[float]], rng: np.random.Generator) -> str:
    """Return why a set of cells does not separate two poses; empty if no reason is found.

    Args:
        case: Problem, as read by `World` and `required_at`.
        cells: The set.
        ends: The pose that the set contains, and the other end of the motion.
        rng: Random generator.
    """
    if not cells.inside or not cells.contains(cells.point_of(ends[0]))[0]:
        # The pose itself is blocked, or in a cell outside of the set.
        points = cells.point_of(ends[0])
    else:
        points = cells.across_faces(rng, _FACES)
        points = points[~cells.contains(points)][:_POSES]
    if cells.contains(cells.point_of(ends[1]))[0]:
        return "the set contains both ends"
    world = World.of(case)
    poses = cells.poses_of(points)
    spare = world.clearances(poses) - required_at(case, poses, start_clearance(case, world), start_run(case))
    if not spare.size or spare.max() <= _FREE:
        return ""
    k = int(np.argmax(spare))
    return f"a pose outside of the set and next to it is free: {poses[k].tolist()}, {spare[k]:.6g} m to spare"
