"""A proof that no motion exists: cells of poses that are blocked separate the start from the goal.

**Theorem.** Let `check_impossibility(proof, problem)` be proven. Then no continuous motion of the robot from the start
to the goal keeps the clearance that the problem requires: not along any path, with or without reversing or turning in
place, however curved. It is one-sided: no proof does not mean that there is a motion.

*Cells.* Poses are cut into closed cells, [x +- h] x [y +- h] x [yaw +- a], where x and y are those of one point of the
robot, `centre`. A cell is blocked if some disc of the robot, at p from the centre with radius r, has an obstacle nearer
than r + c - e at the middle of the cell: within the cell the disc's centre moves by no more than
e = sqrt(2) h + 2 |p| sin(a / 2), c is the least clearance required of any pose in it, and so at every pose in it
something lies nearer to the footprint than required, or inside it where no clearance is. All other cells count as free.

*Faces suffice.* Let a motion keep the clearance. No cell that holds any of its poses is blocked. Where it goes over
from one cell into another it has a pose in both; all cells that hold this pose are free, and they are joined by faces,
as cells around a point are. So start and goal lie in cells that a chain of free cells joins face to face. Where no
chain does, there is no motion. Cells may be of different sizes: tiles of a quadtree over the plane hold 16 x 16 cells
for every heading, each level with cells half as large. What lies in no tile counts as free, as one cell of its own.

*Certified paths.* A certificate accepts a micrometre less than required, and two micrometres of depth at a contact. A
cell is blocked only if it is so with ten micrometres to spare (`SLACK`), which covers the rounding of arithmetic as
well. Near the start the weakest relief counts that a certificate may grant.

The proof holds its tiles and discs; whoever checks it judges every cell again, by exact distances of its own.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.errors import InvalidFile
from optdock.fingerprint import ProblemFingerprint
from optdock.obstacles import in_words
from optdock.verification.proximity import end_clearances

if TYPE_CHECKING:
    from collections.abc import Mapping

    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray
    from optdock.geometry.pose import Pose2
    from optdock.problem import DockingProblem

__all__ = [
    "CELLS",
    "SLACK",
    "Bottleneck",
    "ImpossibilityProof",
    "ImpossibilityVerdict",
    "check_impossibility",
    "least_required",
]

CELLS = 16  # along each side of a tile
# [m]: five times the deepest contact that a certificate accepts, and more than the rounding of single precision over
# ten metres, in which distances within a tile are kept.
SLACK = 1e-5
_LEVELS = 12  # above and below 0 that a proof may have; a file with more is none
_MOST_TILES = 100_000


@dataclass(frozen=True)
class Bottleneck:
    """The narrowest place of the widest route.

    Args:
        x: Where the robot's origin is [m].
        y: Likewise [m].
        yaw: Its heading [rad].
        missing_width: By how much the robot, with the clearance required on both sides, is too wide for it [m].
        missing_without_clearance: Likewise where no clearance is required [m]; not above 0 where the body itself fits.
        accuracy: How far the two may be from the truth [m].
        between: Names of the nearest obstacles on both sides, one or two.
    """

    x: float
    y: float
    yaw: float
    missing_width: float
    missing_without_clearance: float
    accuracy: float
    between: tuple[str, ...]

    @property
    def body_fits(self) -> bool:
        """Whether the body fits, and the required clearance does not."""
        return self.missing_without_clearance <= 0.0

    def __str__(self) -> str:
        what = "the robot with its clearance" if self.body_fits else "the robot"
        missing = self.missing_width if self.body_fits else self.missing_without_clearance
        between = " and ".join(in_words(name) for name in self.between)
        return (
            f"{what} is {max(missing, 0.001):.2g} m too wide for the gap at ({self.x:.2f}, {self.y:.2f}), heading "
            f"{math.degrees(self.yaw):.0f} degrees{f', between {between}' if len(self.between) > 1 else ''}"
        )


@dataclass(frozen=True, eq=False, repr=False)
class ImpossibilityProof:
    """Tiles of cells that separate the start from the goal, and where the widest route is too narrow.

    Args:
        origin: Lower left corner of the tile (0, 0) of every level [m].
        cell: Half the side of a cell of level 0 [m]; of level k it is 2^-k of that.
        headings: How many cells of level 0 make a full turn; of level k 2^k times as many.
        centre: The point of the robot whose place the cells speak of, in the robot's frame [m].
        discs: Discs within the footprint, Shape (n, 3): x, y from the centre, radius [m].
        tiles: Tiles that were looked at, Shape (m, 3): level, column, row.
        unseen: Tiles that count as free, Shape (k, 3); levels below 0 are larger.
        bottleneck: Where it is too narrow; None where the start or the goal itself is blocked, or time was up.
        problem: Digests of what it was proven for.
    """

    origin: tuple[float, float]
    cell: float
    headings: int
    centre: tuple[float, float]
    discs: FloatArray
    tiles: IntArray
    unseen: IntArray
    bottleneck: Bottleneck | None
    problem: ProblemFingerprint

    def __repr__(self) -> str:
        return f"<ImpossibilityProof: {self.message}; {len(self.tiles)} tiles>"

    @property
    def message(self) -> str:
        """One sentence for people."""
        why = self.bottleneck or "start or goal is shut in, or blocked itself"
        return f"no motion exists between start and goal, reversing and turning in place included: {why}"

    def as_dict(self) -> dict[str, object]:
        """Plain values for a plan file."""
        return {
            "origin": list(self.origin),
            "cell": self.cell,
            "headings": self.headings,
            "centre": list(self.centre),
            "discs": self.discs.tolist(),
            "tiles": self.tiles.tolist(),
            "unseen": self.unseen.tolist(),
            "bottleneck": None if self.bottleneck is None else asdict(self.bottleneck),
            "problem": self.problem._asdict(),
        }

    @classmethod
    def from_dict(cls, values: Mapping[str, object]) -> ImpossibilityProof:
        """What `as_dict` gave.

        Raises:
            InvalidFile: Something is missing, or of another kind.
        """
        try:
            return cls._read(values)
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise InvalidFile(f"impossibility: {type(error).__name__}: {error}") from error

    @classmethod
    def _read(cls, values: Mapping[str, object]) -> ImpossibilityProof:
        numbers = {name: np.array(values[name], dtype=np.float64) for name in ("origin", "centre", "discs")}
        tiles, unseen = (np.array(values[name], dtype=np.int64).reshape(-1, 3) for name in ("tiles", "unseen"))
        found = values["bottleneck"]
        if isinstance(found, dict):
            found = Bottleneck(**{**found, "between": tuple(found["between"])})
        elif found is not None:
            raise TypeError("bottleneck")
        return cls(
            _pair(numbers["origin"]),
            float(np.array(values["cell"], dtype=np.float64)),
            int(np.array(values["headings"], dtype=np.int64)),
            _pair(numbers["centre"]),
            numbers["discs"].reshape(-1, 3),
            tiles,
            unseen,
            found,
            ProblemFingerprint(**values["problem"]),  # type: ignore[arg-type]
        )


def _pair(values: FloatArray) -> tuple[float, float]:
    x, y = values.tolist()
    return float(x), float(y)


def least_required(
    problem: DockingProblem, x: FloatArray, y: FloatArray, reach: FloatArray | float, start_clearance: float
) -> FloatArray:
    """The least clearance that any certificate requires of a robot whose origin is within `reach` of a place [m].

    The rule grows with the distance from the goal and from the start. A certificate may grant that a robot gains
    clearance only beyond its own length from the start.

    Args:
        problem: Its rule.
        x: Places, any shape [m].
        y: Likewise.
        reach: How far around each [m].
        start_clearance: Clearance of the start pose [m].
    """
    relief = 2.0 * problem.robot.footprint.circumscribed_radius
    from_goal, from_start = (
        np.maximum(np.hypot(x - end.x, y - end.y) - (reach + SLACK + near), 0.0)
        for end, near in ((problem.goal, 0.0), (problem.start, relief))
    )
    return problem.clearance.required_at(from_goal, from_start, start_clearance)


class ImpossibilityVerdict(NamedTuple):
    """Whether a proof holds, and if not why.

    `proven`: it does. `reason`: why not, empty if it does. `cells`: how many were judged.
    """

    proven: bool
    reason: str
    cells: int


def check_impossibility(proof: ImpossibilityProof, problem: DockingProblem) -> ImpossibilityVerdict:
    """Judge a proof, by whomever, for `problem`: nothing of it is believed but what is computed again.

    Args:
        proof: What somebody claims.
        problem: What the robot must do.
    """
    fault = _fault(proof, problem)
    if fault:
        return ImpossibilityVerdict(proven=False, reason=fault, cells=0)
    judge = _Judge(proof, problem)
    free = [judge.free_cells(tile) for tile in proof.tiles.tolist()]
    cells = sum(some.size for some in free)
    graph = _Components(proof, free)
    start, goal = (graph.of_pose(_middle(pose, proof)) for pose in (problem.start, problem.goal))
    joined = bool(start & goal)
    return ImpossibilityVerdict(not joined, "free cells join start and goal" if joined else "", cells)


def _fault(proof: ImpossibilityProof, problem: DockingProblem) -> str:
    """What is wrong with a proof before any cell is looked at: empty where nothing is."""
    import shapely

    numbers = (*proof.origin, proof.cell, *proof.centre, *proof.discs.ravel().tolist())
    tiles = np.concatenate((proof.tiles, proof.unseen))
    if not (np.all(np.isfinite(numbers)) and proof.cell > 0.0 and 3 <= proof.headings <= 10_000):
        return "the grid is none"
    if len(tiles) > _MOST_TILES or np.any(np.abs(tiles[:, 0]) > _LEVELS) or np.any(np.abs(tiles[:, 1:]) > 2**30):
        return "the tiles are out of range"
    if np.any(proof.tiles[:, 0] < 0):
        return "the tiles are out of range"
    known = set(map(tuple, tiles.tolist()))
    ancestors = {(level - up, i >> up, j >> up) for level, i, j in known for up in range(1, level + _LEVELS + 1)}
    if len(known) < len(tiles) or known & ancestors:
        return "tiles overlap"
    outline = shapely.Polygon(problem.robot.footprint.vertices)
    middles = shapely.points(proof.discs[:, :2] + proof.centre)
    inside = np.where(shapely.covers(outline, middles), shapely.distance(outline.exterior, middles), 0.0)
    if np.any(proof.discs[:, 2] > inside + 1e-9):
        return "a disc is not within the footprint"
    return ""


def _middle(pose: Pose2, proof: ImpossibilityProof) -> tuple[float, float, float]:
    """Where the robot's centre is at a pose."""
    (x, y), c, s = proof.centre, math.cos(pose.yaw), math.sin(pose.yaw)
    return pose.x + c * x - s * y, pose.y + s * x + c * y, pose.yaw


class _Judge:
    """Which cells of a tile are free, by exact distances of discs from obstacles."""

    def __init__(self, proof: ImpossibilityProof, problem: DockingProblem) -> None:
        import shapely

        self.proof, self.problem = proof, problem
        # Near the origin of the tiles floats are finest.
        self.tree = shapely.STRtree(shapely.polygons(problem.all_obstacles.vertices - np.array(proof.origin)))
        self.start_clearance = end_clearances(problem).start

    def free_cells(self, tile: list[int]) -> BoolArray:
        """Shape (headings, rows, columns) of the tile."""
        import shapely

        proof, (level, column, row) = self.proof, tile
        half, count = proof.cell / 2**level, proof.headings * 2**level
        turn = math.pi / count
        yaw, y, x = (
            axis.ravel()
            for axis in np.meshgrid(
                turn * (2.0 * np.arange(count) + 1.0),
                2.0 * half * (CELLS * row + np.arange(CELLS) + 0.5),
                2.0 * half * (CELLS * column + np.arange(CELLS) + 0.5),
                indexing="ij",
            )
        )
        c, s = np.cos(yaw), np.sin(yaw)
        required = self._required(x, y, (c, s), half, turn)
        free = np.arange(yaw.size)
        for px, py, radius in proof.discs[np.argsort(-proof.discs[:, 2])].tolist():
            moved = math.sqrt(2.0) * half + 2.0 * math.hypot(px, py) * math.sin(turn / 2.0)
            within = radius + required[free] - moved - SLACK
            asked = free[within > 0.0]
            if asked.size == 0:
                continue
            points = shapely.points(x[asked] + c[asked] * px - s[asked] * py, y[asked] + s[asked] * px + c[asked] * py)
            met = self.tree.query(points, predicate="dwithin", distance=within[within > 0.0])[0]
            free = np.setdiff1d(free, asked[met], assume_unique=False)
        found = np.zeros(yaw.size, dtype=np.bool_)
        found[free] = True
        return found.reshape(count, CELLS, CELLS)

    def _required(
        self, x: FloatArray, y: FloatArray, turned: tuple[FloatArray, FloatArray], half: float, turn: float
    ) -> FloatArray:
        (mx, my), (ox, oy), (c, s) = self.proof.centre, self.proof.origin, turned
        reach = math.sqrt(2.0) * half + 2.0 * math.hypot(mx, my) * math.sin(turn / 2.0)
        at = ox + x - (c * mx - s * my), oy + y - (s * mx + c * my)
        return least_required(self.problem, *at, reach, self.start_clearance)


class _Components:
    """Components of the free cells: within tiles, joined over headings and over the sides of tiles."""

    def __init__(self, proof: ImpossibilityProof, free: list[BoolArray]) -> None:
        from scipy import ndimage, sparse
        from scipy.sparse import csgraph

        self.proof = proof
        self.tiles = [*proof.tiles.tolist(), *proof.unseen.tolist()]
        cells = [*free, *(np.ones((1, 1, 1), dtype=np.bool_) for _ in proof.unseen)]
        self.labels: list[IntArray] = []
        count = 1  # the outside is component 0
        for some in cells:
            labels, more = ndimage.label(some)
            self.labels.append(np.where(labels > 0, labels + (count - 1), -1))
            count += more
        # Boxes in cells of the finest level: left, lower, right and upper side.
        self.finest = max((level for level, _, _ in self.tiles), default=0)
        table = np.array(self.tiles, dtype=np.int64).reshape(-1, 3)
        side = CELLS * 2 ** (self.finest - table[:, 0])
        lower = table[:, 1:] * side[:, None]
        self.boxes = np.column_stack((lower, lower + side[:, None]))
        joints = [np.zeros((0, 2), dtype=np.int64), *self._over_headings(), *self._over_sides()]
        pairs = np.concatenate(joints)
        pairs = pairs[(pairs >= 0).all(axis=1)]
        joined = sparse.coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
        self.component = csgraph.connected_components(joined, directed=False)[1]

    def of_pose(self, pose: tuple[float, float, float]) -> set[int]:
        """The components of the free cells that a pose of the centre is in, or less than `SLACK` from."""
        unit = 2.0 * self.proof.cell / 2**self.finest
        at = (np.array(pose[:2]) - self.proof.origin) / unit
        near = 2.0 * SLACK / unit
        found: set[int] = set()
        in_boxes = np.all((self.boxes[:, :2] <= at + near) & (self.boxes[:, 2:] >= at - near), axis=1)
        for k in np.flatnonzero(in_boxes).tolist():
            labels = self.labels[k]
            headings, n, _ = labels.shape
            cell = (self.boxes[k, 2] - self.boxes[k, 0]) / n
            spans = [
                np.arange(
                    max(0, math.floor((v - near - low) / cell)), min(n - 1, math.floor((v + near - low) / cell)) + 1
                )
                for v, low in zip(at[::-1].tolist(), self.boxes[k, 1::-1].tolist(), strict=True)
            ]
            per_turn = headings / (2.0 * math.pi)
            turned = (math.floor((pose[2] - SLACK) * per_turn), math.floor((pose[2] + SLACK) * per_turn))
            layers = np.unique(np.arange(turned[0], turned[1] + 1) % headings)
            found.update(labels[np.ix_(layers, *spans)].ravel().tolist())
        around = at + near * np.array([(-1, -1), (-1, 1), (1, -1), (1, 1)])
        inside = (self.boxes[:, None, :2] <= around) & (around <= self.boxes[:, None, 2:])
        if not inside.all(axis=2).any(axis=0).all():
            found.add(0)
        return {int(self.component[label]) for label in found if label >= 0}

    def _over_headings(self) -> list[IntArray]:
        """The last heading borders on the first."""
        return [np.column_stack((labels[-1].ravel(), labels[0].ravel())) for labels in self.labels]

    def _over_sides(self) -> list[IntArray]:
        """Over the right and upper sides to other tiles; over sides with none beyond, to the outside."""
        joints = []
        for axis in (0, 1):
            low, high = self.boxes[:, axis], self.boxes[:, axis + 2]
            along_low, along_high = self.boxes[:, 1 - axis], self.boxes[:, 3 - axis]
            overlap = np.minimum.outer(along_high, along_high) - np.maximum.outer(along_low, along_low)
            beside = np.where((high[:, None] == low[None]) & (overlap > 0), overlap, 0)  # second beyond the first
            for first, second in np.argwhere(beside > 0).tolist():
                joints.append(self._over_side(first, second, axis))
            size = along_high - along_low
            for edge, covered in ((-1, beside.sum(axis=1)), (0, beside.sum(axis=0))):
                for k in np.flatnonzero(covered < size).tolist():
                    face = np.take(self.labels[k], edge, axis=2 - axis).ravel()
                    joints.append(np.column_stack((face, np.zeros_like(face))))
        return joints

    def _over_side(self, first: int, second: int, axis: int) -> IntArray:
        """Labels that meet where the upper side of `first` along `axis` is the lower one of `second`."""
        low = max(self.boxes[k, 1 - axis] for k in (first, second))
        high = min(self.boxes[k, 3 - axis] for k in (first, second))
        sizes = [int(self.boxes[k, 2] - self.boxes[k, 0]) // self.labels[k].shape[1] for k in (first, second)]
        at = np.arange(low, high, min(sizes))
        headings = max(self.labels[k].shape[0] for k in (first, second))
        faces = []
        for k, edge, size in ((first, -1, sizes[0]), (second, 0, sizes[1])):
            face = np.take(self.labels[k], edge, axis=2 - axis)
            layer = np.arange(headings) * face.shape[0] // headings
            faces.append(face[np.ix_(layer, (at - self.boxes[k, 1 - axis]) // size)].ravel())
        return np.unique(np.column_stack(faces), axis=0)
