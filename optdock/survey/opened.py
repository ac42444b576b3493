"""The plan behind the answer of one cell, certified on its own."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from optdock.errors import CertificationFailed, InvalidValue, NoMotionExists, NoValidPathCouldBeFound, StartOccupied
from optdock.geometry.pose import Pose2
from optdock.impossibility import check_impossibility, impossibility_from_dict
from optdock.io.path_columns import path_from_curves
from optdock.model.constant_jerk import TimeLaw
from optdock.model.trajectory import Trajectory
from optdock.planning.pipeline import plan_dock
from optdock.planning.plan import DockPlan
from optdock.survey.questions import deformed_plan, proven_plan
from optdock.survey.rounds import SurveyAnswers, Verdict
from optdock.verification import prove_motion

if TYPE_CHECKING:
    from optdock.config import Scenario

__all__ = ["plan_of_cell"]


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
    verdict, centre = Verdict(answers.verdict[cell]), Pose2.from_sequence(answers.grid.poses(np.array([cell]))[0])
    problem = scenario.problem.starting_at(centre)
    if verdict in (Verdict.OUTSIDE, Verdict.UNKNOWN):
        raise InvalidValue(f"survey: the cell at {centre.brief} is outside the surveyed region")
    if verdict is Verdict.OCCUPIED:
        raise StartOccupied(f"the robot overlaps an obstacle at {centre.brief}")
    source = answers.asked.get(int(answers.source[cell]))
    if source is None:
        raise InvalidValue(f"survey: the cell at {centre.brief} has no answer")
    if verdict is Verdict.IMPOSSIBLE:
        proof = impossibility_from_dict(answers.proofs[source.proof])
        if not check_impossibility(proof, problem):
            raise CertificationFailed(f"the proof of impossibility does not hold for a start at {centre.brief}")
        raise NoMotionExists(proof.message, proof=proof, where=proof.where)
    if verdict is Verdict.NOT_FOUND:
        raise NoValidPathCouldBeFound(source.reason)
    assert source.motion is not None
    path = path_from_curves(source.motion["curves"], problem.frame)
    method = answers.method[cell]
    if method == "passed":
        start = Pose2.from_sequence(answers.start[cell])
        rest = path.piece(float(answers.place[cell]))
        plan = proven_plan(rest, scenario.problem.starting_at(rest.start), scenario, time_budget)
        if plan is None:
            raise CertificationFailed(f"the rest of the motion from {start.brief} is not certified")
        return plan
    if method == "shared":
        if answers.place[cell] > 0.0:
            path = path.piece(float(answers.place[cell]))
        return deformed_plan(path, problem, scenario, time_budget) or plan_dock(
            problem,
            time_budget=time_budget,
            planner=scenario.planner,
            smoother=scenario.smoother,
            timing=scenario.timing,
        )
    law = TimeLaw(np.array(source.motion["durations"]), np.array(source.motion["jerks"]))
    return DockPlan(prove_motion(Trajectory(path, law), problem), path)


