"""A survey in rounds: every round is a set of tiles that are answered independently of each other.

1. One question for every connected component of the free cells. A proof of impossibility is then tried for all cells of
   its component.
2. One question for every block of cells of one heading, see `Spacing`, more if obstacles divide it.
3. The poses that the motions pass are answers of their cells.
4. Questions for the cells where verdicts meet, whose motions pass further cells. The other cells share the answer of
   their block.

The tiles of a round depend only on the results of earlier rounds, so the answers do not depend on the number of workers
or on the order in which tiles are finished.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

from optdock.geometry.pose import wrap_angles
from optdock.plotting.survey_picture import SurveyLayers
from optdock.runner import Case
from optdock.survey.grid import CLEAR, OCCUPIED, TIGHT, SurveyGrid, room_at
from optdock.survey.questions import Answer, SurveyTile, answer_tile
from optdock.survey.tails import PassedCells, time_rests

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from optdock.config import Scenario
    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray
    from optdock.geometry.footprint import Footprint
    from optdock.runner import Outcome
    from optdock.survey.questions import SurveyTask

__all__ = ["CellState", "Spacing", "SurveyAnswers", "survey_dock"]

RunTiles: TypeAlias = "Callable[[Callable[..., object], Sequence[Case]], Iterator[Outcome]]"


class Spacing(NamedTuple):
    """Sizes in cells: side of a block with one question, and side of a tile, a multiple of a block."""

    block: int
    tile: int

    @classmethod
    def of(cls, footprint: Footprint, resolution: float) -> Spacing:
        """Return the sizes for a robot and a distance of neighbouring positions [m]."""
        block = max(1, int(_BLOCK * min(footprint.width, footprint.length) / resolution + 1e-9))
        return cls(block, max(_TILE // block, 1) * block)


class CellState(IntEnum):
    """State of a cell: outside, not answered, or what its row says."""

    OUTSIDE = -1  # of the surveyed region
    UNKNOWN = 0
    CERTIFIED = 1
    IMPOSSIBLE = 2
    NOT_FOUND = 3
    OCCUPIED = 4


VERDICTS = {
    "certified": CellState.CERTIFIED,
    "impossible": CellState.IMPOSSIBLE,
    "not found": CellState.NOT_FOUND,
}
_PASSED_OVER = (CellState.UNKNOWN, CellState.CERTIFIED, CellState.NOT_FOUND)  # answered by a motion that passes them
_VERIFIED = 512  # cells per tile for which a proof of impossibility is checked
_TIMED = 64  # motions per case whose rests are timed
_BETTER = 0.5  # [s] by which the rest of another motion must be cheaper to replace an answer
# Side of a block as a share of the robot's smaller extent. Motions deformed over this distance are 1 % slower than
# those planned anew, and four of five can be certified.
_BLOCK = 0.84
_TILE = 16  # cells along the side of a tile: some hundred questions, seconds of work
_STAGES = 4  # of the questions of blocks: motions of a stage may pass the blocks of later ones
_PASSES = 3  # rounds of questions where verdicts meet


@dataclass
class SurveyAnswers:
    """Answers of all cells of one dock.

    Attributes:
        grid: The cells.
        verdict: State of each cell, Shape (cells,).
        method: Method of each answer: `planned`, `deformed`, `proven`, `inherited`, `shared` or `measured`, Shape
            (cells,).
        seconds: Duration [s], nan without a motion, Shape (cells,).
        stops: Number of stops on the way, Shape (cells,).
        source: Cell whose motion or proof answers the cell, Shape (cells,); -1 if there is none.
        place: Path coordinate on the motion of the source at which the answer begins [m], Shape (cells,).
        start: Pose of the answer, Shape (cells, 3).
        asked: Answers to the questions, by cell.
        proofs: Proofs of impossibility, as plain values.
        cpu_seconds: CPU time of all tiles [s].
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
    cpu_seconds: float = 0.0

    @classmethod
    def unanswered(cls, grid: SurveyGrid, region: BoolArray, scenario: Scenario) -> tuple[SurveyAnswers, IntArray]:
        """Return the answers before the first question, and the room at each cell, see `room_at`."""
        count = math.prod(grid.shape)
        cells = np.flatnonzero(np.broadcast_to(region, grid.shape))
        room = np.full(count, -1)
        room[cells] = room_at(grid.poses(cells), scenario.problem)
        verdict = np.where(
            room < 0, CellState.OUTSIDE, np.where(room == OCCUPIED, CellState.OCCUPIED, CellState.UNKNOWN)
        )
        method = np.where(room == OCCUPIED, "measured", "").astype("<U9")
        nothing, nowhere = np.full(count, np.nan), np.full(count, -1)
        start = grid.poses(np.arange(count))
        found = cls(grid, verdict, method, nothing, np.zeros(count, dtype=np.int64), nowhere, np.zeros(count), start)
        return found, room

    def layers(self) -> SurveyLayers:
        """Return the answers by heading and position, for a picture."""
        _, rows, columns = shape = self.grid.shape
        x, y = (
            self.grid.resolution * (np.arange(count, dtype=np.float64) + first)
            for count, first in zip((columns, rows), self.grid.first, strict=True)
        )
        verdict = self.verdict.reshape(shape)
        impossible, not_found = (verdict == one for one in (CellState.IMPOSSIBLE, CellState.NOT_FOUND))
        return SurveyLayers(
            x=x,
            y=y,
            headings=self.grid.headings,
            seconds=np.where(verdict == CellState.CERTIFIED, self.seconds.reshape(shape), np.nan),
            impossible=impossible,
            not_found=not_found,
            free=(verdict == CellState.CERTIFIED) | impossible | not_found,
        )

    def record(self, answers: Iterable[Answer]) -> None:
        """Enter the answers of cells that had none; their motions begin at the centres of the cells."""
        for answer in answers:
            cell = answer.cell
            self.asked[cell] = answer
            self.verdict[cell], self.method[cell] = VERDICTS[answer.verdict], answer.method
            self.seconds[cell] = math.nan if answer.seconds is None else answer.seconds
            self.stops[cell], self.source[cell] = answer.cusps, cell


def survey_dock(
    task: SurveyTask,
    region: BoolArray,
    run: RunTiles,
    name: str = "",
) -> SurveyAnswers:
    """Answer for every cell whether the robot can dock from it.

    Args:
        task: Scenario, cells and time for one question.
        region: Positions in the surveyed region, Shape (rows, columns).
        run: Function that applies a function to cases and yields their outcomes in the order of the cases, such as
            `run_cases` with `task` as shared argument.
        name: Prefix of the keys of the cases.
    """
    rounds = _Rounds(task, region, run, name)
    rounds.ask_components()
    rounds.ask_blocks()
    rounds.pass_on()
    rounds.ask_left_blocks()
    rounds.refine()
    rounds.share()
    return rounds.found


class _Rounds:
    """State of a survey between its rounds.

    `room`: room at each cell, see `room_at`. `block`: block of each free cell, -1 for others. `questions`: cell of the
    question of each block.
    """

    def __init__(self, task: SurveyTask, region: BoolArray, run: RunTiles, name: str) -> None:
        self.task, self.grid, self.run, self.name = task, task.grid, run, name
        self.spacing = Spacing.of(task.scenario.problem.robot.footprint, task.grid.resolution)
        self.found, self.room = SurveyAnswers.unanswered(task.grid, region, task.scenario)
        self.block, self.questions = np.full(self.room.size, -1), np.zeros(0, dtype=np.int64)
        self.passed = PassedCells.joined(())

    def ask_components(self) -> None:
        """Ask one question per connected component of the free cells, and try its proof for the other cells."""
        component = connected(self.room.reshape(self.grid.shape) > OCCUPIED).ravel()
        every = np.flatnonzero(component >= 0)
        if every.size == 0:
            return
        first = representatives(self.grid, every, component[every], self.room[every] == TIGHT)
        self._ask("components", self._tiles(first))
        for cell in first.tolist():
            answer = self.found.asked[cell]
            if answer.verdict != "impossible":
                continue
            others = every[(component[every] == component[cell]) & (every != cell)]
            proofs = [self.found.proofs[answer.proof]]
            parts = np.array_split(others, -(-others.size // _VERIFIED)) if others.size else []
            tiles = ((str(i), SurveyTile(part.tolist(), proofs=proofs)) for i, part in enumerate(parts))
            self._ask(f"proof of {cell}", tiles)

    def ask_blocks(self) -> None:
        """Ask the questions of the blocks that no earlier motion passes."""
        self.block, self.questions = self._blocks()
        for number in range(_STAGES):
            is_passed = np.isin(np.arange(self.questions.size), self.block[self.passed.cell])
            asked = self.questions[~is_passed & (self._stages() == number)]
            asked = asked[self.found.verdict[asked] == CellState.UNKNOWN]
            self._ask(f"blocks {number}", self._tiles(asked))

    def pass_on(self, stage: str = "rests", over: Sequence[CellState] = _PASSED_OVER) -> None:
        """Answer the cells that certified motions pass, and time the rests of the motions.

        Args:
            stage: Prefix of the keys of the cases.
            over: States of the cells that may be answered.
        """
        found, best = self.found, self.passed
        prices = {cell: answer.price for cell, answer in found.asked.items() if answer.price is not None}
        known = np.array([prices.get(cell, math.inf) for cell in best.cell.tolist()])
        best = best.rows(np.isin(found.verdict[best.cell], over) & (best.price < known - _BETTER))
        best = best.rows(np.argsort(best.source, kind="stable"))
        groups = best.by_source()
        batches = [groups[at : at + _TIMED] for at in range(0, len(groups), _TIMED)]
        cases = [
            Case(f"{self.name}{stage} {i}", ([(self._motion(group), group.s.tolist()) for group in batch],))
            for i, batch in enumerate(batches)
        ]
        for batch, outcome in zip(batches, self.run(time_rests, cases), strict=True):
            found.cpu_seconds += outcome.cpu_seconds
            for group, result in zip(batch, outcome.value or (), strict=False):
                seconds = np.array([math.nan if one is None else one for one in result["seconds"]])
                kept = np.isfinite(seconds)
                cell = group.cell[kept]
                found.verdict[cell], found.method[cell] = CellState.CERTIFIED, "inherited"
                found.seconds[cell], found.stops[cell] = seconds[kept], np.array(result["stops"])[kept]
                found.source[cell], found.place[cell] = group.source[kept], group.s[kept]
                found.start[cell] = np.array(result["poses"])[kept]

    def ask_left_blocks(self) -> None:
        """Ask the questions of the blocks that only motions pass whose rests answer none of their cells."""
        expected = self._expected()
        left = self.questions[expected[self.questions] == CellState.UNKNOWN]
        self._ask("blocks left", self._tiles(left))

    def refine(self) -> None:
        """Ask for cells where verdicts meet, and answer the cells without a motion that the new motions pass."""
        for number in range(_PASSES):
            expected = self._expected()
            meets = meeting(expected.reshape(self.grid.shape)).ravel() | (expected == CellState.IMPOSSIBLE)
            asked = np.flatnonzero(meets & (self.found.verdict == CellState.UNKNOWN))
            if asked.size == 0:
                break
            self._ask(f"cells {number}", self._tiles(asked))
            self.pass_on(f"rests of cells {number}", (CellState.UNKNOWN, CellState.NOT_FOUND))

    def share(self) -> None:
        """Give the cells that are left the answer of the nearest answered cell of their block."""
        from scipy import spatial

        found, apart = self.found, 10.0 * max(self.grid.shape)
        left = np.flatnonzero((found.verdict == CellState.UNKNOWN) & (self.block >= 0))
        expected = self._expected()
        for verdict in np.unique(expected[left]).tolist():
            cells = left[expected[left] == verdict]
            known = np.flatnonzero((found.verdict == verdict) & (found.method != "shared") & (self.block >= 0))
            places = [
                np.column_stack((self.block[some] * apart, *np.unravel_index(some, self.grid.shape)[1:]))
                for some in (known, cells)
            ]
            _, nearest = spatial.cKDTree(places[0]).query(places[1])
            source = known[nearest]
            found.verdict[cells], found.method[cells] = verdict, "shared"
            for column in (found.seconds, found.stops, found.source, found.place, found.start):
                column[cells] = column[source]

    def _ask(self, stage: str, tiles: Iterable[tuple[str, SurveyTile]]) -> None:
        """Let the questions of tiles be answered, and enter the answers."""
        listed = list(tiles)
        cases, passed = [Case(f"{self.name}{stage} {key}", (tile,)) for key, tile in listed], [self.passed]
        for (_, tile), outcome in zip(listed, self.run(answer_tile, cases), strict=True):
            self.found.cpu_seconds += outcome.cpu_seconds
            if outcome.error:
                failed = (Answer(cell, "not found", "planned", reason=outcome.error) for cell in tile.cells)
                self.found.record(failed)
                continue
            result = outcome.value
            numbers = [self._number_of(proof) for proof in result["proofs"]]
            answers = (Answer(**values) for values in result["answers"])
            self.found.record(one._replace(proof=numbers[one.proof]) if one.proof >= 0 else one for one in answers)
            passed.append(PassedCells.from_dict(result["passed"]))
        self.passed = PassedCells.joined(passed)

    def _number_of(self, proof: Mapping[str, Any]) -> int:
        """Return the index of a proof among all proofs of the survey."""
        if proof not in self.found.proofs:
            self.found.proofs.append(proof)
        return self.found.proofs.index(proof)

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
            open_ = (self.room == room) & (self.found.verdict == CellState.UNKNOWN)
            spread[place] = open_.reshape(self.grid.shape)
            labels, more = ndimage.label(spread, structure=across)
            block = np.where(open_, labels[place].ravel() - 1 + count, block)
            count += more
        cells = np.flatnonzero(block >= 0)
        return block, representatives(self.grid, cells, block[cells])

    def _stages(self) -> IntArray:
        """Return the stage of each question: clear blocks by the parity of row and column, then the others."""
        _, j, i = np.unravel_index(self.questions, self.grid.shape)
        rows, columns = j // self.spacing.block % 2, i // self.spacing.block % 2
        stage = np.where(rows != columns, 2, rows)
        found: IntArray = np.where(self.room[self.questions] == TIGHT, 3, stage)
        return found

    def _tiles(self, cells: IntArray) -> Iterator[tuple[str, SurveyTile]]:
        """Yield the tiles of cells; neighbouring headings follow each other, beginning with that of the dock."""
        k, j, i = np.unravel_index(cells, self.grid.shape)
        turned = np.abs(wrap_angles(self.grid.headings[k] - self.task.scenario.problem.goal.yaw))
        tile = self._tile_of(cells)
        order = np.lexsort((i, j, k, turned, tile))
        cells, tile = cells[order], tile[order]
        known = self._answers_by_tile()
        for part in np.split(np.arange(cells.size), np.flatnonzero(np.diff(tile)) + 1) if cells.size else ():
            near = known.get(int(tile[part[0]]), [])
            motions = [one for one in near if one.motion is not None]
            proofs = [self.found.proofs[number] for number in sorted({one.proof for one in near if one.proof >= 0})]
            yield str(int(tile[part[0]])), SurveyTile(cells[part].tolist(), motions, proofs)

    def _tile_of(self, cells: IntArray) -> IntArray:
        """Return the number of the tile of each cell."""
        _, j, i = np.unravel_index(cells, self.grid.shape)
        found: IntArray = j // self.spacing.tile * self.grid.shape[2] + i // self.spacing.tile
        return found

    def _answers_by_tile(self) -> dict[int, list[Answer]]:
        asked = sorted(self.found.asked)
        found: dict[int, list[Answer]] = {}
        for cell, number in zip(asked, self._tile_of(np.array(asked, dtype=np.int64)).tolist(), strict=True):
            found.setdefault(number, []).append(self.found.asked[cell])
        return found

    def _expected(self) -> IntArray:
        """Return the verdict of each cell; that of its block if the cell has none."""
        is_passed = np.isin(np.arange(self.questions.size), self.block[self.found.method == "inherited"])
        of_block = np.where(is_passed, CellState.CERTIFIED, self.found.verdict[self.questions])
        unknown = (self.found.verdict == CellState.UNKNOWN) & (self.block >= 0)
        if not unknown.any():
            return self.found.verdict
        found: IntArray = np.where(unknown, of_block[np.maximum(self.block, 0)], self.found.verdict)
        return found

    def _motion(self, group: PassedCells) -> Mapping[str, Any]:
        motion = self.found.asked[int(group.source[0])].motion
        assert motion is not None
        return motion


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

    counts = np.isin(verdict, (CellState.CERTIFIED, CellState.IMPOSSIBLE, CellState.NOT_FOUND))
    beside = np.pad(verdict, ((1, 1), (0, 0), (0, 0)), mode="wrap")
    inside = np.pad(counts, ((1, 1), (0, 0), (0, 0)), mode="wrap")
    largest = ndimage.maximum_filter(np.where(inside, beside, -1), 3, mode="nearest")[1:-1]
    smallest = ndimage.minimum_filter(np.where(inside, beside, 9), 3, mode="nearest")[1:-1]
    found: BoolArray = counts & (largest != smallest)
    return found
