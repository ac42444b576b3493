"""The plan behind the answer of one cell, certified on its own."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from optdock.errors import CertificationFailed, InvalidValue, NoMotionExists, NoValidPathCouldBeFound, StartOccupied
from optdock.geometry.pose import Pose2
from optdock.impossibility import check_impossibility, impossibility_from_dict
from optdock.io.path_columns import path_from_curves
from optdock.model.constant_jerk import TimeLaw
from optdock.model.trajectory import Trajectory
from optdock.planning.plan import DockPlan
from optdock.survey.questions import deformed_plan, proven_plan
from optdock.survey.rounds import CellState, SurveyAnswers
from optdock.verification import prove_motion

if TYPE_CHECKING:
    from optdock.config import Scenario
    from optdock.model.problem import DockingProblem
    from optdock.survey.questions import Answer

__all__ = ["plan_of_cell"]

_PATIENCE = 10.0  # times as long as for a question of the survey, because there is one cell


def plan_of_cell(answers: SurveyAnswers, cell: int, scenario: Scenario, time_budget: float) -> DockPlan:
    """Return the certified plan of a cell.

    The plan begins at the pose of the answer, which lies in the cell: the centre of the cell, or a pose on the motion
    that passes it. A cell that shares the answer of another cell gets a plan of its own from its centre.

    Args:
        answers: Answers of a survey.
        cell: Flat index of the cell.
        scenario: Scenario of the survey.
        time_budget: Time for planning, if it is necessary [s].

    Raises:
        StartOccupied: If the robot overlaps an obstacle at the centre of the cell.
        NoMotionExists: With the proof, if the cell is impossible.
        NoValidPathCouldBeFound: If no motion was found from the cell.
        OptdockError: As `plan_dock`, if a shared answer does not hold at this cell.
        InvalidValue: If the cell is outside the surveyed region.
    """
    centre = Pose2.from_sequence(answers.grid.poses(np.array([cell]))[0])
    problem = scenario.problem.starting_at(centre)
    source = answers.asked.get(int(answers.source[cell]))
    _raise_refusal(CellState(answers.verdict[cell]), answers, source, problem)
    assert source is not None
    assert source.motion is not None
    path, place = path_from_curves(source.motion["curves"], problem.frame), float(answers.place[cell])
    method, rest = answers.method[cell], path.piece(place) if place > 0.0 else path
    if method == "shared":
        moved = deformed_plan(rest, problem, scenario, time_budget)
        return moved or replace(scenario, problem=problem).plan(_PATIENCE * time_budget)
    if method == "inherited":
        plan = proven_plan(rest, problem.starting_at(rest.start), scenario, time_budget)
        if plan is None:
            raise CertificationFailed(f"the rest of the motion from {rest.start.brief} is not certified")
        return plan
    law = TimeLaw(np.array(source.motion["durations"]), np.array(source.motion["jerks"]))
    return DockPlan(prove_motion(Trajectory(path, law), problem), path)


def _raise_refusal(verdict: CellState, answers: SurveyAnswers, source: Answer | None, problem: DockingProblem) -> None:
    """Raise the error of a cell that is not certified."""
    at = problem.start.brief
    if verdict is CellState.OCCUPIED:
        raise StartOccupied(f"the robot overlaps or touches an obstacle at {at}")
    if verdict in (CellState.OUTSIDE, CellState.UNKNOWN) or source is None:
        raise InvalidValue(f"survey: the cell at {at} is outside the surveyed region")
    if verdict is CellState.NOT_FOUND:
        raise NoValidPathCouldBeFound(source.reason)
    if verdict is CellState.IMPOSSIBLE:
        proof = impossibility_from_dict(answers.proofs[source.proof])
        if not check_impossibility(proof, problem):
            raise CertificationFailed(f"the proof of impossibility does not hold for a start at {at}")
        raise NoMotionExists(proof.message, proof=proof, where=proof.where)
