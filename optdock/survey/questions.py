"""Answers to questions of one tile of a survey, computed by a worker.

A question is a start pose at rest. It is answered by the first of these methods that succeeds:

1. A proof of impossibility of a neighbour, checked for the new start.
2. The motion of an answered neighbour, or the rest of a motion from the pose on it that is nearest to the new start,
   deformed to the new start, pushed off obstacles (`deformation`), certified and timed.
3. `plan_dock`.

Every certified motion also answers the poses that it passes (`passed_cells`).
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np

from optdock.deadline import Deadline, garbage_collection_paused
from optdock.errors import NoMotionExists, OptdockError
from optdock.geometry.pose import Pose2, wrap_angles
from optdock.impossibility import (
    ImpossibilityProof,
    check_impossibility,
    impossibility_from_dict,
    separated_starts,
)
from optdock.io.path_columns import curves_of, path_from_curves
from optdock.planners.manoeuvres.price import stops
from optdock.planning.plan import PartialPlan
from optdock.planning.refinement import Cancellation, Refinement
from optdock.plugins.interfaces import Smoother, TimeParameterizer, never_cancelled
from optdock.plugins.registry import plugin_from
from optdock.survey.tails import PassedCells, passed_cells

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from optdock.config import Scenario
    from optdock.geometry.arrays import FloatArray
    from optdock.impossibility import NoMotionProof
    from optdock.model.path import Path
    from optdock.model.problem import DockingProblem
    from optdock.planning.plan import DockPlan
    from optdock.survey.grid import SurveyGrid

__all__ = ["Answer", "SurveyTask", "SurveyTile", "answer_tile", "deformed_plan", "proven_plan"]

_DEFORMED_FROM = 5  # nearest motions that are tried
_SPACING = 0.1  # [m] between the poses of a motion from which its rest may be deformed
_FARTHEST = 1.5  # [m] of a neighbour; a step of 22.5 degrees counts as `_TURN` metres
_TURN = 0.5 / (math.pi / 8.0)  # [m/rad]
_MARGIN = 0.1, 0.5  # [m]: distance between the samples of `Answer.margin`, and largest margin that is measured
# Most pushes off obstacles. In 64 blocks of a warehouse, 4 and 8 pushes save 55 % and 60 % of the CPU time.
_PUSHES = 8
_MOST_STEPS = 6  # deformations one after the other; then a motion is planned again
# A deformed motion may cost this much more than that of the neighbour, as a factor and in seconds; then it is planned
# anew. 0.4 m at 0.3 m/s take 1.3 s.
_DEARER = (1.1, 1.5)


class Answer(NamedTuple):
    """Answer to one question.

    Attributes:
        cell: Flat index of the cell.
        verdict: `certified`, `impossible` or `not found`.
        method: `planned`, `deformed` or `proven`; `proven` belongs to `impossible`.
        seconds: Duration of the motion [s]; None without a motion.
        cusps: Number of stops on the way.
        price: Price by which motions are compared [s], see `DockPlan.price`; None without a motion.
        margin: Least clearance beyond the required one, away from start and dock [m], at sampled poses; None if no
            obstacle is near, see `DockPlan.tightest`.
        reason: Reason of a refusal; stage of the guess of a planned motion.
        motion: Curves of the path, and durations and jerks of the phases; None unless certified.
        proof: Index of the proof among the proofs of the tile; -1 unless impossible.
        steps: Number of deformations since the planned motion.
    """

    cell: int
    verdict: str
    method: str
    seconds: float | None = None
    cusps: int = 0
    price: float | None = None
    margin: float | None = None
    reason: str = ""
    motion: Mapping[str, Any] | None = None
    proof: int = -1
    steps: int = 0


class SurveyTask(NamedTuple):
    """What all questions of a survey have in common.

    Args:
        scenario: Problem and plugins; its start is not used.
        grid: The cells.
        time_budget: Time for planning one question [s].
    """

    scenario: Scenario
    grid: SurveyGrid
    time_budget: float


class SurveyTile(NamedTuple):
    """Questions of one part of a survey, and known answers near it.

    Args:
        cells: Flat indices of the cells whose centres are the questions.
        motions: Certified answers near the tile.
        proofs: Proofs of impossibility, as plain values, that are tried.
    """

    cells: Sequence[int]
    motions: Sequence[Answer] = ()
    proofs: Sequence[Mapping[str, object]] = ()


class _Known(NamedTuple):
    """A certified motion: its path with sampled poses, its price, and the number of deformations since its plan.

    `s`: path coordinates of the samples [m]. `poses`: Shape (n, 3).
    """

    path: Path
    price: float
    steps: int
    s: FloatArray
    poses: FloatArray

    @classmethod
    def of(cls, path: Path, price: float, steps: int, last: float) -> _Known:
        """Return a motion with samples before the last `last` metres."""
        s = np.linspace(0.0, max(path.length - last, 0.0), 2 + int(path.length / _SPACING))[:-1]
        return cls(path, price, steps, s, path.poses_at(s))


@dataclass
class _Work:
    """Answers of a tile so far."""

    task: SurveyTask
    cells: Sequence[int]
    known: list[_Known] = field(default_factory=list)
    proofs: list[NoMotionProof] = field(default_factory=list)
    separated: dict[int, int] = field(default_factory=dict)  # number of the proof of a cell
    passed: list[PassedCells] = field(default_factory=list)

    def answer(self, cell: int, pose: FloatArray) -> Answer:
        """Answer one question."""
        scenario = self.task.scenario
        problem = scenario.problem.starting_at(Pose2.from_sequence(pose))
        number = self._proof_for(cell, problem)
        if number >= 0:
            return Answer(cell, "impossible", "proven", reason=self.proofs[number].message, proof=number)
        plan, steps = self._deformed(pose, problem)
        if plan is None:
            try:
                plan = replace(scenario, problem=problem).plan(self.task.time_budget)
            except NoMotionExists as error:
                self.proofs.append(cast("NoMotionProof", error.proof))  # checked by `plan_dock`
                self._apply(len(self.proofs) - 1, problem)
                return Answer(cell, "impossible", "proven", reason=str(error), proof=len(self.proofs) - 1)
            except OptdockError as error:
                return Answer(cell, "not found", "planned", reason=f"{type(error).__name__}: {error}")
        self.known.append(_Known.of(plan.path, plan.price, steps, problem.dock.final_straight))
        self.passed.append(passed_cells(plan, self.task.grid))
        law, tightest = plan.trajectory.time_law, plan.tightest(*_MARGIN)
        return Answer(
            cell,
            "certified",
            "deformed" if steps else "planned",
            law.duration,
            stops(plan.path),
            plan.price,
            None if tightest is None else tightest.margin,
            plan.stage,
            {"curves": curves_of(plan.path), "durations": law.durations.tolist(), "jerks": law.jerks.tolist()},
            steps=steps,
        )

    def _proof_for(self, cell: int, problem: DockingProblem) -> int:
        """Return the number of a known proof that holds for a cell, or -1."""
        if cell in self.separated:
            return self.separated[cell]
        for number, proof in enumerate(self.proofs):
            if check_impossibility(proof, problem):
                self._apply(number, problem)
                return number
        return -1

    def _apply(self, number: int, problem: DockingProblem) -> None:
        """Enter the cells of the tile for which a proof, which holds for `problem`, also holds."""
        proof = self.proofs[number]
        if isinstance(proof, ImpossibilityProof):
            cells = np.array([cell for cell in self.cells if cell not in self.separated], dtype=np.int64)
            held = separated_starts(proof, problem, self.task.grid.poses(cells))
            self.separated.update(dict.fromkeys(cells[held].tolist(), number))

    def _deformed(self, pose: FloatArray, problem: DockingProblem) -> tuple[DockPlan | None, int]:
        """Return a plan along the deformed path of a neighbour, or None, and its number of deformations."""
        near = [one for one in self.known if one.steps < _MOST_STEPS]
        if not near:
            return None, 0
        gaps = np.concatenate([one.poses for one in near]) - pose
        far = np.hypot(gaps[:, 0], gaps[:, 1]) + _TURN * np.abs(wrap_angles(gaps[:, 2]))
        ends = np.cumsum([one.s.size for one in near])
        nearest = [int(part.argmin()) for part in np.split(far, ends[:-1])]
        off = np.array([part[row] for part, row in zip(np.split(far, ends[:-1]), nearest, strict=True)])
        factor, more = _DEARER
        for row in np.argsort(off, kind="stable")[:_DEFORMED_FROM].tolist():
            if off[row] > _FARTHEST:
                break
            one, s = near[row], float(near[row].s[nearest[row]])
            rest = one.path if s == 0.0 else one.path.piece(s)
            plan = deformed_plan(rest, problem, self.task.scenario, self.task.time_budget)
            if plan is not None and plan.price <= factor * one.price + more:
                return plan, one.steps + 1
        return None, 0


def deformed_plan(
    path: Path,
    problem: DockingProblem,
    scenario: Scenario,
    time_budget: float,
    cancel_checker: Callable[[], bool] = never_cancelled,
) -> DockPlan | None:
    """Return the certified plan along a path deformed to start and dock of the problem; None if there is none.

    Args:
        path: Path of clothoids and turns in place.
        problem: The problem.
        scenario: Plugins.
        time_budget: Time for the whole call [s].
        cancel_checker: Polled during the call; if it returns True, the result is None.
    """
    work = _refinement(problem, scenario, time_budget, cancel_checker)
    moved, certificate = work.deformed(path, _PUSHES, steers=False)
    if certificate is None or not certificate.certified:
        return None
    with suppress(OptdockError):
        return work.proven(moved, moved, PartialPlan())
    return None


def proven_plan(path: Path, problem: DockingProblem, scenario: Scenario, time_budget: float) -> DockPlan | None:
    """Return the certified plan along a path that needs no smoothing, or None."""
    with suppress(OptdockError):
        return _refinement(problem, scenario, time_budget).proven(path, path, PartialPlan())
    return None


def _refinement(
    problem: DockingProblem,
    scenario: Scenario,
    time_budget: float,
    cancel_checker: Callable[[], bool] = never_cancelled,
) -> Refinement:
    smoother = plugin_from(Smoother, scenario.smoother, "smoother")
    timing = plugin_from(TimeParameterizer, scenario.timing, "timing")
    limits = Cancellation(cancel_checker), time_budget, Deadline(time_budget), dict[str, float]()
    return Refinement(problem, smoother, timing, None, *limits)


def answer_tile(task: SurveyTask, tile: SurveyTile) -> dict[str, object]:
    """Answer the questions of a tile in their order.

    Returns:
        Plain JSON values: `answers`, the proofs of impossibility, and the passed cells as columns.
    """
    work = _Work(task, tile.cells, proofs=[impossibility_from_dict(values) for values in tile.proofs])
    for answer in tile.motions:
        if answer.motion is not None and answer.price is not None:
            path = path_from_curves(answer.motion["curves"], task.scenario.problem.frame)
            last = task.scenario.problem.dock.final_straight
            work.known.append(_Known.of(path, answer.price, answer.steps, last))
    poses = task.grid.poses(np.asarray(tile.cells, dtype=np.int64))
    with garbage_collection_paused():
        answers = [work.answer(cell, pose) for cell, pose in zip(tile.cells, poses, strict=True)]
    return {
        "answers": [answer._asdict() for answer in answers],
        "proofs": [proof.as_dict() for proof in work.proofs],
        "passed": PassedCells.joined(work.passed).as_dict(),
    }
