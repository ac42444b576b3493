"""A proof that no motion exists: a set of poses around the goal or the start whose whole rim is blocked.

**Theorem.** Let `check_cells(proof, problem)` be proven. Then no continuous motion of the robot from the start to the
goal has the clearance that the problem requires, along any path of any curvature, with or without reversing or turning
in place. The converse does not hold: without a proof a motion may or may not exist.

*Cells.* The poses are divided into closed cells, [x +- h] x [y +- h] x [yaw +- a], where x and y are the position of
one point of the robot, `centre`. A cell is blocked if, with the robot at the middle of the cell, an obstacle is nearer
than r + c - e to the middle of some disc of the robot. Here r is the radius of the disc, p its position relative to
`centre`, e = sqrt(2) h + 2 |p| sin(a / 2) the largest motion of its middle within the cell, and c the least clearance
required of any pose in the cell. Therefore, at every pose in the cell, an obstacle is nearer to the footprint than
required, or inside it if no clearance is required.

*The rim.* The proof names a set of cells, `inside`. The set lies around the inner end of the motion, which is the goal
or the start. Every cell outside the set is blocked if it shares a face with a cell of the set or contains the inner
end, and no cell of the set contains the other end. Suppose that a motion has the required clearance. No cell that
contains a pose of this motion is blocked, so one end of the motion is in the set and the other is outside. At the
border of the set the motion has a pose that is both in a cell of the set and in a cell outside. The cells around that
pose are joined by faces, so one of these cells inside the set shares a face with one of these cells outside the set.
The cell outside the set is blocked, which is a contradiction. Cells may differ in size. Tiles of a quadtree over the
plane contain 16 x 16 cells for every heading, and the cells of each level are half as large as the cells of the
previous level.

*Certified paths.* A certificate accepts a clearance one micrometre below the required one, and a depth of two
micrometres at a contact. A cell counts as blocked only if the inequality holds with a margin of ten micrometres
(`SLACK`), which also covers rounding. Near the start the weakest clearance rule that a certificate may apply is used.

The checker examines the rim again, with exact distances.
"""

from __future__ import annotations

import base64
import math
import zlib
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, NamedTuple, TypeAlias

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from optdock.errors import InvalidFile
from optdock.geometry.arrays import FrozenArrays
from optdock.geometry.obstacles import in_words
from optdock.geometry.pose import Pose2
from optdock.model.problem import ProblemFingerprint
from optdock.verification.proximity import pose_clearance, pose_clearances

if TYPE_CHECKING:
    from collections.abc import Mapping

    from shapely import STRtree

    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray
    from optdock.model.problem import DockingProblem

__all__ = [
    "CELLS",
    "SLACK",
    "Bottleneck",
    "ImpossibilityProof",
    "ImpossibilityVerdict",
    "check_cells",
    "least_required",
    "separated_starts",
]

CELLS = 16  # along each side of a tile
# [m]: five times the deepest contact that a certificate accepts, and more than the rounding of single precision over
# ten metres, in which distances within a tile are kept.
SLACK = 1e-5
_FARTHEST = 2**30  # column or row
_LEVELS = 12  # above and below 0 that tiles in a file may have
# A proof that is made within a second has hundreds of tiles, some dozen discs, and packed cells of 1 MB.
_MOST_TILES, _MOST_DISCS, _MOST_HEADINGS = 10_000, 500, 10_000
_MOST_CELLS = 1 << 26
_Number: TypeAlias = Annotated[float, Field(ge=-1e10, le=1e10)]


@dataclass(frozen=True)
class Bottleneck:
    """The narrowest point of the widest route.

    Args:
        x: Position of the robot's origin [m].
        y: Position of the robot's origin [m].
        yaw: Heading [rad].
        missing_width: Width [m] by which the gap is too narrow for the robot with the required clearance on both sides.
        missing_without_clearance: Width [m] by which the gap is too narrow for the robot without clearance; at most 0
            if the robot fits.
        accuracy: Largest error of the two widths [m].
        between: Names of the nearest obstacles on both sides, one or two.
    """

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(extra="ignore", allow_inf_nan=False)

    x: _Number
    y: _Number
    yaw: _Number
    missing_width: _Number
    missing_without_clearance: _Number
    accuracy: _Number
    between: tuple[str, ...]

    @property
    def body_fits(self) -> bool:
        """Whether the body alone fits, up to a millimetre, but does not fit with the required clearance."""
        return self.missing_without_clearance <= 0.001 < self.missing_width

    def __str__(self) -> str:
        what = "the robot with its clearance" if self.body_fits else "the robot"
        missing = self.missing_width if self.body_fits else self.missing_without_clearance
        names = [in_words(name) for name in dict.fromkeys(self.between)]
        between = f", between {' and '.join(names)}" if len(names) > 1 else ""
        kept = -0.5 * self.missing_without_clearance
        spare = f"; up to {kept:.3f} m of clearance can be kept there" if self.body_fits else ""
        return (
            f"{what} is {max(missing, 0.001):.2g} m too wide for the gap at ({self.x:.2f}, {self.y:.2f}), heading "
            f"{math.degrees(self.yaw):.0f} degrees{between}{spare}"
        )


@dataclass(frozen=True, eq=False, repr=False)
class ImpossibilityProof(FrozenArrays):
    """Set of cells around start or goal whose rim is blocked, and the bottleneck of the widest way out.

    Args:
        end: The end that the cells surround, `goal` or `start`.
        origin: Lower left corner of the tile (0, 0) of every level [m].
        cell: Half the side of a cell of level 0 [m]; multiplied by 2^-k for level k.
        headings: Number of headings of level 0; multiplied by 2^k for level k.
        centre: The point of the robot whose position the cells describe, in the robot's frame [m].
        discs: Discs within the footprint, Shape (n, 3): x, y from the centre, radius [m].
        tiles: The tiles that contain cells of the set or of its rim, Shape (m, 3): level >= 0, column, row.
        inside: For each tile, the mask of its cells that are in the set, Shape (headings, rows, columns).
        whole: Tiles of any level that are in the set as a whole, Shape (k, 3).
        bottleneck: The bottleneck; None if the start or the goal itself is blocked, or the time ran out.
        problem: Digests of the problem.
    """

    end: str
    origin: tuple[float, float]
    cell: float
    headings: int
    centre: tuple[float, float]
    discs: FloatArray
    tiles: IntArray
    inside: tuple[BoolArray, ...]
    whole: IntArray
    bottleneck: Bottleneck | None
    problem: ProblemFingerprint

    def __repr__(self) -> str:
        return f"<ImpossibilityProof: {self.message}; {len(self.tiles)} tiles>"

    @property
    def message(self) -> str:
        """The result in one sentence."""
        why = self.bottleneck or f"the {self.end} is enclosed"
        return f"no motion joins start and goal, reversing and turning in place included: {why}"

    @property
    def where(self) -> dict[str, object]:
        """The details of the error: pose, missing width and obstacle of the bottleneck, if the bottleneck is known."""
        found = self.bottleneck
        if found is None:
            return {}
        pose = [found.x, found.y, found.yaw]
        missing = {"missing_width": found.missing_width, "missing_without_clearance": found.missing_without_clearance}
        return {"pose": pose, **missing, "obstacle": found.between[0] if found.between else ""}

    def squares(self) -> list[FloatArray]:
        """Return the positions that are in the set at some heading, as squares, Shape (4, 2) each [m]."""
        found = []
        corners = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)])
        for (level, column, row), cells in zip(self.tiles.tolist(), self.inside, strict=True):
            side = 2.0 * self.cell / 2**level
            for j, i in np.argwhere(cells.any(axis=0)).tolist():
                found.append(self.origin + side * (corners + np.array([CELLS * column + i, CELLS * row + j])))
        for level, column, row in self.whole.tolist():
            found.append(self.origin + 2.0 * CELLS * self.cell * 2.0**-level * (corners + np.array([column, row])))
        return found

    def as_dict(self) -> dict[str, object]:
        """Return plain values for a plan file; the cells are bits, compressed by zlib and encoded in base 64."""
        bits = b"".join(np.packbits(cells).tobytes() for cells in self.inside)
        return {
            "end": self.end,
            "origin": list(self.origin),
            "cell": self.cell,
            "headings": self.headings,
            "centre": list(self.centre),
            "discs": self.discs.tolist(),
            "tiles": self.tiles.tolist(),
            "inside": base64.b64encode(zlib.compress(bits, 9)).decode(),
            "whole": self.whole.tolist(),
            "bottleneck": None if self.bottleneck is None else asdict(self.bottleneck),
            "problem": self.problem._asdict(),
        }

    @classmethod
    def from_dict(cls, values: Mapping[str, object]) -> ImpossibilityProof:
        """Read the result of `as_dict`.

        Raises:
            InvalidFile: If an entry is missing or has the wrong type.
        """
        try:
            return cls._read(_ProofDocument.model_validate(values))
        except (ValueError, TypeError, zlib.error) as error:  # pydantic's errors are ValueErrors
            raise InvalidFile(f"impossibility: {error}") from error

    @classmethod
    def _read(cls, document: _ProofDocument) -> ImpossibilityProof:
        tiles = np.array(document.tiles, dtype=np.int64).reshape(-1, 3)
        shapes = [(document.headings << level, CELLS, CELLS) for level in tiles[:, 0].tolist()]
        sizes = [math.prod(shape) // 8 for shape in shapes]
        if 8 * sum(sizes) > _MOST_CELLS:
            raise ValueError(f"inside: holds more than {_MOST_CELLS} cells")
        packed = base64.b64decode(document.inside, validate=True)
        bits = zlib.decompressobj().decompress(packed, sum(sizes) + 1)
        if len(bits) != sum(sizes):
            raise ValueError(f"inside: must hold {sum(sizes)} bytes, got {len(bits)}")
        parts = np.split(np.unpackbits(np.frombuffer(bits, dtype=np.uint8)), 8 * np.cumsum(sizes)[:-1]) if sizes else []
        return cls(
            document.end,
            document.origin,
            document.cell,
            document.headings,
            document.centre,
            np.array(document.discs, dtype=np.float64).reshape(-1, 3),
            tiles,
            tuple(part.astype(np.bool_).reshape(shape) for part, shape in zip(parts, shapes, strict=True)),
            np.array(document.whole, dtype=np.int64).reshape(-1, 3),
            document.bottleneck,
            ProblemFingerprint(**document.problem),
        )


_Level: TypeAlias = Annotated[int, Field(ge=-_LEVELS, le=_LEVELS)]
_Index: TypeAlias = Annotated[int, Field(ge=-_FARTHEST, le=_FARTHEST)]


class _ProofDocument(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False, defer_build=True)

    end: Literal["goal", "start"]
    origin: tuple[_Number, _Number]
    cell: Annotated[float, Field(gt=0.0, le=1e6)]
    headings: Annotated[int, Field(ge=1, le=_MOST_HEADINGS)]
    centre: tuple[_Number, _Number]
    discs: Annotated[list[tuple[_Number, _Number, _Number]], Field(max_length=_MOST_DISCS)]
    tiles: Annotated[
        list[tuple[Annotated[int, Field(ge=0, le=_LEVELS)], _Index, _Index]], Field(max_length=_MOST_TILES)
    ]
    inside: str
    whole: Annotated[list[tuple[_Level, _Index, _Index]], Field(max_length=_MOST_TILES)]
    bottleneck: Bottleneck | None = None
    problem: dict[str, str]


def least_required(
    problem: DockingProblem, x: FloatArray, y: FloatArray, reach: FloatArray | float, start_clearance: float
) -> FloatArray:
    """Return the least clearance [m] that any certificate requires of a robot within `reach` of a position.

    The required clearance grows with the distance from the goal and from the start. For a start that is too close to an
    obstacle a certificate may use the weaker rule.

    Args:
        problem: The planning problem.
        x: Positions of the robot's origin, any shape [m].
        y: Positions of the robot's origin, same shape [m].
        reach: Radius around each position [m].
        start_clearance: Clearance of the start pose [m].
    """
    from_goal, from_start = (
        np.maximum(np.hypot(x - end.x, y - end.y) - (reach + SLACK), 0.0) for end in (problem.goal, problem.start)
    )
    # A start with enough clearance has no relief, up to the rounding of the certificate's distances.
    rule, is_too_close = problem.path_clearance, start_clearance < problem.path_clearance.required + SLACK
    relief = 4.0 * problem.robot.footprint.circumscribed_radius if is_too_close else 0.0
    return rule.required_at(from_goal, from_start, start_clearance, relief)


class ImpossibilityVerdict(NamedTuple):
    """Verdict on a proof; its truth value is `proven`.

    `proven`: whether the proof holds. `reason`: fault of the proof, empty if it holds. `cells`: number of checked cells
    of the rim.
    """

    proven: bool
    reason: str
    cells: int

    def __bool__(self) -> bool:
        return self.proven


def check_cells(proof: ImpossibilityProof, problem: DockingProblem) -> ImpossibilityVerdict:
    """Check a proof from any source against `problem`; every claim of the proof is computed again.

    Args:
        proof: Proof to be checked.
        problem: The planning problem.
    """
    import shapely

    fault = _fault(proof, problem)
    if fault:
        return ImpossibilityVerdict(proven=False, reason=fault, cells=0)
    rim = _Rim(proof)
    inner, outer = (problem.goal, problem.start) if proof.end == "goal" else (problem.start, problem.goal)
    fault = rim.fault(_middle(inner, proof), _middle(outer, proof))
    # Floats have the highest resolution near the origin of the tiles.
    tree = shapely.STRtree(shapely.polygons(problem.all_obstacles.vertices - np.array(proof.origin)))
    start_clearance, _ = pose_clearance(problem.start, problem.robot.footprint, problem.all_obstacles)
    count = 0
    for tile, cells in zip(proof.tiles.tolist(), rim.blocked, strict=False):  # no cell of a whole tile is on the rim
        if fault:
            break
        count += int(cells.sum())
        if not _are_blocked(proof, problem, start_clearance, tree, tile, cells):
            fault = "a cell on the rim is not blocked"
    return ImpossibilityVerdict(proven=not fault, reason=fault, cells=count)


def separated_starts(proof: ImpossibilityProof, problem: DockingProblem, poses: FloatArray) -> BoolArray:
    """Return whether a proof that holds for `problem` also holds for other starts at rest.

    If the clearance of a start is at least the one required away from the dock, `least_required` does not depend on the
    start. The blocked cells are then the same for every such start, which only has to be on the same side of them.

    Args:
        proof: Proof for which `check_cells` is true.
        problem: The planning problem.
        poses: Other start poses, Shape (n, 3).

    Returns:
        Shape (n,); False if a start needs a check of its own.
    """
    required, footprint = problem.path_clearance.required + SLACK, problem.robot.footprint
    found = np.zeros(len(poses), dtype=np.bool_)
    if len(poses) == 0 or pose_clearance(problem.start, footprint, problem.all_obstacles)[0] < required:
        return found
    clearances, _ = pose_clearances(poses, footprint, problem.all_obstacles, within=required + SLACK)
    rim = _Rim(proof)
    for row in np.flatnonzero(clearances >= required).tolist():
        cells, is_covered = rim.cells_at(_middle(Pose2.from_sequence(poses[row]), proof))
        inside = [rim.inside[k][places] for k, places in cells]
        enclosed = is_covered and all(part.all() for part in inside)
        found[row] = enclosed if proof.end == "start" else not any(part.any() for part in inside)
    return found


def _fault(proof: ImpossibilityProof, problem: DockingProblem) -> str:
    """Return a fault of a proof that can be found without examining cells; empty if no fault is found."""
    import shapely

    every = np.concatenate((proof.tiles, proof.whole))
    counts = len(every), len(proof.discs), sum(cells.size for cells in proof.inside)
    if any(count > most for count, most in zip(counts, (2 * _MOST_TILES, _MOST_DISCS, _MOST_CELLS), strict=True)):
        return "it exceeds the size of a proof"
    levels, far = proof.tiles[:, 0].tolist(), every[np.abs(every).max(axis=1, initial=0) > _FARTHEST]
    is_grid = (
        (proof.end in ("goal", "start") and math.isfinite(proof.cell) and proof.cell > 0.0 and far.size == 0)
        and (isinstance(proof.headings, int) and 1 <= proof.headings <= _MOST_HEADINGS)
        and (all(0 <= level <= _LEVELS for level in levels) and bool(np.all(np.abs(every[:, 0]) <= _LEVELS)))
        and (proof.tiles.dtype.kind == proof.whole.dtype.kind == "i")
        and bool(np.isfinite([*proof.origin, *proof.centre]).all() and np.isfinite(proof.discs).all())
    )
    if not is_grid:
        return "the tiles are invalid"
    shapes = [(proof.headings << level, CELLS, CELLS) for level in levels]
    if [cells.shape for cells in proof.inside] != shapes or any(cells.dtype != np.bool_ for cells in proof.inside):
        return "the cells do not fit the tiles"
    known = [tuple(tile) for tile in np.concatenate((proof.tiles, proof.whole)).tolist()]
    ancestors = {(level - up, i >> up, j >> up) for level, i, j in known for up in range(1, level + _LEVELS + 1)}
    if len(set(known)) < len(known) or set(known) & ancestors:
        return "tiles overlap"
    outline = shapely.Polygon(problem.robot.footprint.vertices)
    middles = shapely.points(proof.discs[:, :2] + proof.centre)
    deep = np.where(shapely.covers(outline, middles), shapely.distance(outline.exterior, middles), 0.0)
    return "" if np.all(proof.discs[:, 2] <= deep + 0.1 * SLACK) else "a disc is not within the footprint"


def _middle(pose: Pose2, proof: ImpossibilityProof) -> FloatArray:
    """Return the position of the robot's centre at a pose, in the frame of the tiles, and its heading. Shape (3,)."""
    (x, y), c, s = proof.centre, math.cos(pose.yaw), math.sin(pose.yaw)
    at = pose.x - proof.origin[0] + (c * x - s * y), pose.y - proof.origin[1] + (s * x + c * y)
    return np.array([*at, pose.yaw])


class _Rim:
    """The cells of a proof that must be blocked: one mask per tile, Shape (headings, rows, columns) each."""

    def __init__(self, proof: ImpossibilityProof) -> None:
        self.cell = proof.cell
        self.inside = (*proof.inside, *(np.ones((1, 1, 1), dtype=np.bool_) for _ in proof.whole))
        tiles = np.concatenate((proof.tiles, proof.whole))
        # Boxes in cells of the finest level: left, lower, right and upper side.
        self.finest = int(tiles[:, 0].max(initial=0))
        side = CELLS * 2 ** (self.finest - tiles[:, 0])
        lower = tiles[:, 1:] * side[:, None]
        self.boxes = np.column_stack((lower, lower + side[:, None]))
        self.blocked = [np.zeros(cells.shape, dtype=np.bool_) for cells in self.inside]

    def fault(self, inner: FloatArray, outer: FloatArray) -> str:
        """Mark the rim of the set, given both end poses; return a fault of the set itself, or an empty string."""
        within, is_covered = self.cells_at(inner)
        for k, cells in within:
            self.blocked[k][cells] |= ~self.inside[k][cells]
        if not is_covered:
            return "the set of cells does not contain its end pose"
        if any(self.inside[k][cells].any() for k, cells in self.cells_at(outer)[0]):
            return "the set holds both ends"
        for inside, rim in zip(self.inside, self.blocked, strict=True):
            for axis in (1, 2):
                first, second = np.swapaxes(inside, 0, axis), np.swapaxes(rim, 0, axis)
                second[1:] |= first[:-1] & ~first[1:]
                second[:-1] |= first[1:] & ~first[:-1]
            for turned in (-1, 1):
                np.logical_or(rim, np.roll(inside, turned, axis=0) & ~inside, out=rim)
        return "" if self._is_closed_at_sides() else "the set continues beyond the tiles"

    def cells_at(self, pose: FloatArray) -> tuple[list[tuple[int, tuple[IntArray, ...]]], bool]:
        """Return the cells that contain a pose of the centre, up to `SLACK`, and whether tiles surround it."""
        unit = 2.0 * self.cell / 2**self.finest
        near = 2.0 * SLACK / unit
        at = pose[:2] / unit
        found = []
        for k in np.flatnonzero(np.all((self.boxes[:, :2] <= at + near) & (self.boxes[:, 2:] >= at - near), axis=1)):
            headings, n, _ = self.inside[k].shape
            size = (self.boxes[k, 2] - self.boxes[k, 0]) / n
            first, last = (np.clip((at + sign * near - self.boxes[k, :2]) // size, 0, n - 1) for sign in (-1, 1))
            turned = np.floor((pose[2] + np.array([-SLACK, SLACK])) * headings / (2.0 * math.pi))
            layers = np.unique(np.arange(turned[0], turned[1] + 1) % headings)
            spans = (layers, np.arange(first[1], last[1] + 1), np.arange(first[0], last[0] + 1))
            found.append((int(k), np.ix_(*(span.astype(np.int64) for span in spans))))
        around = at + near * np.array([(-1, -1), (-1, 1), (1, -1), (1, 1)])
        is_in = (self.boxes[:, None, :2] <= around) & (around <= self.boxes[:, None, 2:])
        return found, bool(is_in.all(axis=2).any(axis=0).all())

    def _is_closed_at_sides(self) -> bool:
        """Whether every side that the set reaches has a neighbouring tile; its outside cells join the rim."""
        for axis in (0, 1):
            lower, upper = self.boxes[:, axis], self.boxes[:, axis + 2]
            low, high = self.boxes[:, 1 - axis], self.boxes[:, 3 - axis]
            covered_below, covered_above = np.zeros_like(low), np.zeros_like(low)
            for first in range(len(self.boxes)):
                overlap = np.minimum(high[first], high) - np.maximum(low[first], low)
                above = np.flatnonzero((lower == upper[first]) & (overlap > 0))
                covered_above[first] = overlap[above].sum()
                covered_below[above] += overlap[above]
                for second in above.tolist():
                    self._meet(first, second, axis)
            for edge, covered in ((-1, covered_above), (0, covered_below)):
                for k in np.flatnonzero(covered < high - low):
                    if np.take(self.inside[k], edge, axis=2 - axis).any():
                        return False
        return all(cells.size > 1 or not cells.any() for cells in self.blocked)

    def _meet(self, first: int, second: int, axis: int) -> None:
        """Mark the rim across the common side of two tiles, which is the upper side of `first` along an axis."""
        both = (first, second)
        low, high = max(self.boxes[k, 1 - axis] for k in both), min(self.boxes[k, 3 - axis] for k in both)
        sizes = [(self.boxes[k, 2] - self.boxes[k, 0]) // self.inside[k].shape[1] for k in both]
        headings = [self.inside[k].shape[0] for k in both]
        at, layer = np.arange(low, high, min(sizes)), np.arange(max(headings))
        places = []
        for k, edge, size, count in zip(both, (-1, 0), sizes, headings, strict=True):
            across = (at - self.boxes[k, 1 - axis]) // size
            face = np.array([edge % self.inside[k].shape[1]])
            spans = (layer * count // len(layer), *((across, face) if axis == 0 else (face, across)))
            places.append(np.ix_(*spans))
        here, there = (self.inside[k][place] for k, place in zip(both, places, strict=True))
        # A larger cell may be marked several times.
        np.logical_or.at(self.blocked[first], places[0], there & ~here)
        np.logical_or.at(self.blocked[second], places[1], here & ~there)


def _are_blocked(
    proof: ImpossibilityProof,
    problem: DockingProblem,
    start_clearance: float,
    tree: STRtree,
    tile: list[int],
    cells: BoolArray,
) -> bool:
    """Whether the selected cells of a tile, Shape (headings, rows, columns), are blocked by obstacles of `tree`."""
    import shapely

    (level, column, row), (layer, j, i) = tile, np.nonzero(cells)
    half = proof.cell / 2**level
    turn = math.pi / cells.shape[0]
    x, y = 2.0 * half * (CELLS * column + i + 0.5), 2.0 * half * (CELLS * row + j + 0.5)
    yaw = turn * (2.0 * layer + 1.0)
    c, s = np.cos(yaw), np.sin(yaw)
    (mx, my), (ox, oy) = proof.centre, proof.origin
    reach = math.sqrt(2.0) * half + 2.0 * math.hypot(mx, my) * math.sin(turn / 2.0)
    place = ox + x - (c * mx - s * my), oy + y - (s * mx + c * my)
    required = least_required(problem, *place, reach, start_clearance)
    left = np.ones(yaw.size, dtype=np.bool_)
    for px, py, radius in proof.discs[np.argsort(-proof.discs[:, 2])].tolist():
        moved = math.sqrt(2.0) * half + 2.0 * math.hypot(px, py) * math.sin(turn / 2.0)
        within = radius + required - moved - SLACK
        asked = np.flatnonzero(left & (within > 0.0))
        if asked.size:
            at = (x + c * px - s * py)[asked], (y + s * px + c * py)[asked]
            met = tree.query(shapely.points(*at), predicate="dwithin", distance=within[asked])[0]
            left[asked[met]] = False
    return not left.any()
