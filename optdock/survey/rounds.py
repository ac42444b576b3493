"""A survey in rounds: every round is a set of tiles that are answered independently of each other.

1. One question for every connected component of the free cells. A proof of impossibility is then tried for all cells of
   its component.
2. One question for every block of `Spacing.block` x `Spacing.block` cells of one heading, more if obstacles divide it.
3. The poses that the motions pass are answers of their cells.
4. Questions for the cells where verdicts meet. The other cells share the answer of their block.

The tiles of a round depend only on the results of earlier rounds, so the answers do not depend on the number of workers
or on the order in which tiles are finished.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

from optdock.geometry.pose import wrap_angles
from optdock.io.path_columns import path_from_curves
from optdock.model.constant_jerk import TimeLaw
from optdock.survey.grid import CLEAR, OCCUPIED, TIGHT, SurveyGrid, room_at
from optdock.survey.questions import Answer, Tile, answer_tile
from optdock.survey.tails import PassedCells, seconds_from_rest

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from optdock.config import Scenario
    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray

__all__ = ["Spacing", "SurveyAnswers", "Verdict", "survey_dock"]

# Function and cases with their keys -> results in the order of the cases.
RunTiles: TypeAlias = "Callable[[Callable[[Any], Any], Iterable[tuple[str, Any]]], Iterator[Any]]"


class Spacing(NamedTuple):
    """Sizes in cells: side of a block with one question, and side of a tile, a multiple of a block."""

    block: int = 4
    tile: int = 16


class Verdict(IntEnum):
    """Verdict on a cell."""

    OUTSIDE = -1  # of the surveyed region
    UNKNOWN = 0
    CERTIFIED = 1
    IMPOSSIBLE = 2
    NOT_FOUND = 3
    OCCUPIED = 4


VERDICTS = {"certified": Verdict.CERTIFIED, "impossible": Verdict.IMPOSSIBLE, "not found": Verdict.NOT_FOUND}
_VERIFIED = 64  # cells per tile for which a proof of impossibility is checked
_TAILED = 64  # motions per tile whose rests are timed
_BETTER = 0.5  # [s] by which the rest of another motion must be cheaper to replace an answer
_STAGES = 4  # of the questions of blocks: motions of a stage may pass the blocks of later ones
_PASSES = 3  # rounds of questions where verdicts meet


@dataclass(frozen=True)
class Rests:
    """Rests of one motion, see `seconds_from_rest`: place in driving order and the cells that they answer."""

    scenario: Scenario
    motion: Mapping[str, Any]
    places: Sequence[float]


def time_rests(motions: Sequence[Rests]) -> list[dict[str, list[Any]]]:
    """Return duration [s], pose and number of stops of every rest of several motions."""
    return [_timed(one) for one in motions]


def _timed(rests: Rests) -> dict[str, list[Any]]:
    problem = rests.scenario.problem
    path = path_from_curves(rests.motion["curves"], problem.frame)
    law = TimeLaw(np.array(rests.motion["durations"]), np.array(rests.motion["jerks"]))
    s, ends, limits = np.array(rests.places), path.segment_starts[1:], problem.robot.limits
    poses = path.poses_at(s)
    stops_left = len(path.cusps) - np.searchsorted(path.cusps, s, side="right")
    end_of = ends[np.minimum(np.searchsorted(ends, s, side="right"), ends.size - 1)]
    waits = [limits.steering_time_to(float(curvature)) for curvature in np.abs(path.curvature_at(s))]
    seconds = [
        wait + seconds_from_rest(law, place, end, limits)
        for wait, place, end in zip(waits, s.tolist(), end_of.tolist(), strict=True)
    ]
    return {"seconds": seconds, "poses": poses.tolist(), "stops": stops_left.tolist()}


@dataclass
class SurveyAnswers:
    """Answers of all cells of one dock.

    Attributes:
        grid: The cells.
        verdict: Verdict of each cell, Shape (cells,).
        method: Method of each answer: `planned`, `deformed`, `proven`, `passed`, `shared`, `measured`; Shape (cells,).
        seconds: Duration [s], nan without a motion, Shape (cells,).
        stops: Number of stops on the way, Shape (cells,).
        source: Cell whose motion or proof answers the cell, Shape (cells,); -1 if there is none.
        place: Path coordinate on the motion of the source at which the answer begins [m], Shape (cells,).
        start: Pose of the answer, Shape (cells, 3).
        asked: Answers to the questions, by cell.
        proofs: Proofs of impossibility, as plain values.
        cpu_seconds: CPU time of the questions [s].
    """

    grid: SurveyGrid
    verdict: IntArray
    method: NDArray[np.str_]
    seconds: FloatArray
    stops: IntArray
    source: IntArray
    place: FloatArray
    start: FloatArray
    asked: dict[int, Answer] = field(default_factory=dict)
    proofs: list[Mapping[str, Any]] = field(default_factory=list)

    @classmethod
    def unanswered(cls, grid: SurveyGrid, region: BoolArray, scenario: Scenario) -> tuple[SurveyAnswers, IntArray]:
        """Return the answers before the first question, and the room at each cell, see `room_at`."""
        count = math.prod(grid.shape)
        cells = np.flatnonzero(np.broadcast_to(region, grid.shape))
        room = np.full(count, -1)
        room[cells] = room_at(grid.poses(cells), scenario.problem)
        verdict = np.where(room < 0, Verdict.OUTSIDE, np.where(room == OCCUPIED, Verdict.OCCUPIED, Verdict.UNKNOWN))
        method = np.where(room == OCCUPIED, "measured", "").astype("<U8")
        nothing, nowhere = np.full(count, np.nan), np.full(count, -1)
        start = grid.poses(np.arange(count))
        found = cls(grid, verdict, method, nothing, np.zeros(count, dtype=np.int64), nowhere, np.zeros(count), start)
        return found, room

    def record(self, answers: Iterable[Answer]) -> None:
        """Enter the answers to questions."""
        for answer in answers:
            cell = answer.cell
            self.asked[cell] = answer
            self.verdict[cell], self.method[cell] = VERDICTS[answer.verdict], answer.method
            self.seconds[cell], self.stops[cell], self.source[cell] = answer.seconds, answer.cusps, cell
            self.place[cell], self.start[cell] = 0.0, self.grid.poses(np.array([cell]))[0]


def survey_dock(
    scenario: Scenario,
    grid: SurveyGrid,
    region: BoolArray,
    run: RunTiles,
    *,
    time_budget: float = 1.0,
    spacing: Spacing = Spacing(),
    name: str = "",
) -> SurveyAnswers:
    """Answer for every cell whether the robot can dock from it.

    Args:
        scenario: Problem and plugins; its start is not used.
        grid: The cells.
        region: Positions in the surveyed region, Shape (rows, columns).
        run: Function that applies a function to cases and yields the results in the order of the cases.
        time_budget: Time for one question [s].
        spacing: Sizes of blocks and tiles.
        name: Prefix of the keys of the cases.
    """
    return _Rounds(scenario, grid, region, run, time_budget, spacing, name).answers()


class _Rounds:
    def __init__(  # noqa: PLR0913, PLR0917 - the arguments of `survey_dock`
        self,
        scenario: Scenario,
        grid: SurveyGrid,
        region: BoolArray,
        run: RunTiles,
        time_budget: float,
        spacing: Spacing,
        name: str,
    ) -> None:
        self.scenario, self.grid, self.run, self.time_budget = scenario, grid, run, time_budget
        self.spacing, self.name = spacing, name
        self.found, self.room = SurveyAnswers.unanswered(grid, region, scenario)
        self.passed: list[PassedCells] = []

    def answers(self) -> SurveyAnswers:
        """Run all rounds."""
        self._components()
        blocks, questions = self._blocks()
        for number in range(_STAGES):
            is_passed = np.isin(np.arange(questions.size), blocks[PassedCells.joined(self.passed).cell])
            asked = questions[~is_passed & (self._stages(questions) == number)]
            asked = asked[self.found.verdict[asked] == Verdict.UNKNOWN]
            self._ask(f"blocks {number}", ((key, self._near(tile)) for key, tile in self._tiles(asked)))
        self._pass()
        self._refine(blocks, questions)
        self._share(blocks, questions)
        return self.found

    def _ask(self, stage: str, tiles: Iterable[tuple[str, Tile]]) -> None:
        cases = ((f"{self.name}{stage} {key}", tile) for key, tile in tiles)
        for result in self.run(answer_tile, cases):
            numbers = [self._number_of(proof) for proof in result["proofs"]]
            answers = (Answer(**values) for values in result["answers"])
            self.found.record(one._replace(proof=numbers[one.proof]) if one.proof >= 0 else one for one in answers)
            self.passed.append(PassedCells.from_dict(result["passed"]))

    def _number_of(self, proof: Mapping[str, Any]) -> int:
        """Return the index of a proof among all proofs of the survey."""
        if proof not in self.found.proofs:
            self.found.proofs.append(proof)
        return self.found.proofs.index(proof)

    def _tile(self, cells: IntArray, **known: Any) -> Tile:
        return Tile(self.scenario, self.grid, cells.tolist(), self.time_budget, **known)

    def _components(self) -> None:
        """Ask one question per connected component of the free cells, and try its proof for the other cells."""
        component = connected(self.room.reshape(self.grid.shape) > OCCUPIED).ravel()
        every = np.flatnonzero(component >= 0)
        if every.size == 0:
            return
        first = representatives(self.grid, every, component[every], self.room[every] == TIGHT)
        self._ask("components", [("0", self._tile(first, passes=False))])
        for cell in first.tolist():
            answer = self.found.asked[cell]
            if answer.verdict != "impossible":
                continue
            others = every[(component[every] == component[cell]) & (every != cell)]
            known = {"proofs": [self.found.proofs[answer.proof]], "passes": False}
            parts = np.array_split(others, -(-others.size // _VERIFIED)) if others.size else []
            self._ask(f"proof {cell}", ((str(i), self._tile(part, **known)) for i, part in enumerate(parts)))

    def _blocks(self) -> tuple[IntArray, IntArray]:
        """Return the block of each free cell, -1 for others, and the cell of the question of each block.

        A block is divided by obstacles, and into clear cells and cells too close to an obstacle.
        """
        from scipy import ndimage

        side, (n, rows, columns) = self.spacing.block, self.grid.shape
        spread = np.zeros((n, rows + rows // side + 1, columns + columns // side + 1), dtype=np.bool_)
        at_rows, at_columns = np.arange(rows), np.arange(columns)
        place = np.ix_(np.arange(n), at_rows + at_rows // side, at_columns + at_columns // side)
        across = [[[0] * 3] * 3, [[0, 1, 0], [1, 1, 1], [0, 1, 0]], [[0] * 3] * 3]  # not to other headings
        block, count = np.full(self.room.size, -1), 0
        for room in (CLEAR, TIGHT):
            open_ = (self.room == room) & (self.found.verdict == Verdict.UNKNOWN)
            spread[place] = open_.reshape(self.grid.shape)
            labels, more = ndimage.label(spread, structure=across)
            block = np.where(open_, labels[place].ravel() - 1 + count, block)
            count += more
        cells = np.flatnonzero(block >= 0)
        return block, representatives(self.grid, cells, block[cells])

    def _stages(self, questions: IntArray) -> IntArray:
        """Return the stage of each question: clear blocks by the parity of row and column, then the others."""
        _, j, i = np.unravel_index(questions, self.grid.shape)
        rows, columns = j // self.spacing.block % 2, i // self.spacing.block % 2
        stage = np.where(rows != columns, 2, rows)
        return np.where(self.room[questions] == TIGHT, 3, stage)

    def _tiles(self, cells: IntArray, **known: Any) -> Iterator[tuple[str, Tile]]:
        """Yield the tiles of cells; neighbouring headings follow each other, beginning with that of the dock."""
        k, j, i = np.unravel_index(cells, self.grid.shape)
        turned = np.abs(wrap_angles(self.grid.headings[k] - self.scenario.problem.goal.yaw))
        tile = j // self.spacing.tile * self.grid.shape[2] + i // self.spacing.tile
        order = np.lexsort((i, j, k, turned, tile))
        cells, tile = cells[order], tile[order]
        for part in np.split(cells, np.flatnonzero(np.diff(tile)) + 1) if cells.size else ():
            yield str(int(part.min())), self._tile(part, **known)

    def _pass(self) -> None:
        """Answer the cells that certified motions pass, and time the rests of the motions."""
        found = self.found
        best = PassedCells.joined(self.passed)
        known = np.array([found.asked[cell].price if cell in found.asked else math.inf for cell in best.cell.tolist()])
        is_free = np.isin(found.verdict[best.cell], (Verdict.UNKNOWN, Verdict.CERTIFIED))
        best = best.rows(is_free & (best.price < known - _BETTER))
        order = np.argsort(best.source, kind="stable")
        best = best.rows(order)
        groups = [best.rows(rows) for rows in np.split(np.arange(best.cell.size), np.flatnonzero(np.diff(best.source)) + 1)]
        groups = [group for group in groups if group.cell.size]
        batches = [groups[at : at + _TAILED] for at in range(0, len(groups), _TAILED)]
        cases = ((f"{self.name}rests {i}", [self._rests(group) for group in batch]) for i, batch in enumerate(batches))
        for batch, results in zip(batches, self.run(time_rests, cases), strict=True):
            for group, result in zip(batch, results, strict=True):
                cell = group.cell
                found.verdict[cell], found.method[cell] = Verdict.CERTIFIED, "passed"
                found.seconds[cell], found.stops[cell] = result["seconds"], result["stops"]
                found.source[cell], found.place[cell], found.start[cell] = group.source, group.s, result["poses"]

    def _rests(self, group: PassedCells) -> Rests:
        motion = self.found.asked[int(group.source[0])].motion
        assert motion is not None
        return Rests(self.scenario, motion, group.s.tolist())

    def _refine(self, blocks: IntArray, questions: IntArray) -> None:
        """Ask for cells where verdicts meet."""
        for number in range(_PASSES):
            expected = self._expected(blocks, questions)
            meets = meeting(expected.reshape(self.grid.shape)).ravel() | (expected == Verdict.IMPOSSIBLE)
            asked = np.flatnonzero(meets & (self.found.verdict == Verdict.UNKNOWN))
            if asked.size == 0:
                break
            tiles = self._tiles(asked, passes=False)
            self._ask(f"cells {number}", ((key, self._near(tile)) for key, tile in tiles))

    def _near(self, tile: Tile) -> Tile:
        """Return a tile with the answers in it: motions that may be deformed, and proofs that may hold."""
        _, j, i = np.unravel_index(np.array(tile.cells), self.grid.shape)
        side = self.spacing.tile
        corner = int(j[0]) // side * side, int(i[0]) // side * side
        rows, columns = (range(at, min(at + side, size)) for at, size in zip(corner, self.grid.shape[1:], strict=True))
        n, height, width = self.grid.shape
        cells = (np.arange(n)[:, None, None] * height + np.array(rows)[:, None]) * width + np.array(columns)
        known = [self.found.asked[cell] for cell in cells.ravel().tolist() if cell in self.found.asked]
        proofs = [self.found.proofs[number] for number in sorted({one.proof for one in known if one.proof >= 0})]
        return replace(tile, motions=[one for one in known if one.motion is not None], proofs=proofs)

    def _expected(self, blocks: IntArray, questions: IntArray) -> IntArray:
        """Return the verdict of each cell; that of its block if the cell has none."""
        is_passed = np.isin(np.arange(questions.size), blocks[self.found.method == "passed"])
        of_block = np.where(is_passed, Verdict.CERTIFIED, self.found.verdict[questions])
        unknown = (self.found.verdict == Verdict.UNKNOWN) & (blocks >= 0)
        return np.where(unknown, of_block[np.maximum(blocks, 0)], self.found.verdict)

    def _share(self, blocks: IntArray, questions: IntArray) -> None:
        """Give the cells that are left the answer of the nearest answered cell with the same heading."""
        from scipy import spatial

        found, apart = self.found, 10.0 * max(self.grid.shape)
        left = np.flatnonzero((found.verdict == Verdict.UNKNOWN) & (blocks >= 0))
        expected = self._expected(blocks, questions)
        for verdict in np.unique(expected[left]).tolist():
            cells = left[expected[left] == verdict]
            known = np.flatnonzero((found.verdict == verdict) & (found.method != "shared"))
            places = [np.column_stack(np.unravel_index(some, self.grid.shape)) * [apart, 1, 1] for some in (known, cells)]
            _, nearest = spatial.cKDTree(places[0]).query(places[1])
            source = known[nearest]
            found.verdict[cells], found.method[cells] = verdict, "shared"
            for column in (found.seconds, found.stops, found.source, found.place, found.start):
                column[cells] = column[source]


def connected(free: BoolArray) -> IntArray:
    """Return the component of each free cell, Shape (headings, rows, columns); -1 for others.

    Cells are neighbours across faces, edges and corners; the last heading is next to the first.
    """
    from scipy import ndimage, sparse

    labels, count = ndimage.label(free, structure=np.ones((3, 3, 3)))
    first, last = np.pad(labels[0], 1), labels[-1]
    rows, columns = last.shape
    pairs = [
        np.column_stack((last.ravel(), first[1 + dy : 1 + dy + rows, 1 + dx : 1 + dx + columns].ravel()))
        for dy, dx in itertools.product((-1, 0, 1), repeat=2)
    ]
    joined = np.concatenate(pairs)
    joined = joined[(joined > 0).all(axis=1)]
    graph = sparse.coo_array((np.ones(len(joined)), joined.T), shape=(count + 1, count + 1))
    _, merged = sparse.csgraph.connected_components(graph, directed=False)
    found: IntArray = np.where(labels > 0, merged[labels], -1)
    return found


def representatives(grid: SurveyGrid, cells: IntArray, label: IntArray, avoided: BoolArray | None = None) -> IntArray:
    """Return for each label the cell next to the mean of its cells, if possible not among the avoided ones.

    Args:
        grid: The cells.
        cells: Flat indices, Shape (n,).
        label: Label of each cell, Shape (n,).
        avoided: Cells that are used only if a label has no others, Shape (n,).
    """
    _, number = np.unique(label, return_inverse=True)
    at = np.column_stack(np.unravel_index(cells, grid.shape)).astype(np.float64)
    counts = np.bincount(number)
    means = np.column_stack([np.bincount(number, axis) / counts for axis in at.T])
    off = ((at - means[number]) ** 2).sum(axis=1)
    order = np.lexsort((cells, off, np.zeros(cells.size) if avoided is None else avoided, number))
    _, first = np.unique(number[order], return_index=True)
    found: IntArray = cells[order[first]]
    return found


def meeting(verdict: IntArray) -> BoolArray:
    """Return the cells with a neighbour of another verdict, Shape (headings, rows, columns).

    Only certified, impossible and not found count. Cells are neighbours across faces, edges and corners.
    """
    from scipy import ndimage

    counts = np.isin(verdict, (Verdict.CERTIFIED, Verdict.IMPOSSIBLE, Verdict.NOT_FOUND))
    modes = ("wrap", "nearest", "nearest")
    largest = ndimage.maximum_filter(np.where(counts, verdict, -1), 3, mode=modes)
    smallest = ndimage.minimum_filter(np.where(counts, verdict, 9), 3, mode=modes)
    found: BoolArray = counts & (largest != smallest)
    return found
