"""Answers to single questions of a survey."""

from dataclasses import replace

from optdock.geometry.pose import Pose2
from optdock.survey import questions
from optdock.survey.questions import deformed_plan
from optdock.verification import certify_path
from tests.optdock.survey.scenes import box, scenario


def test_a_deformed_motion_is_pushed_off_an_obstacle(monkeypatch):
    """Beside an obstacle at which the motion deformed without pushes is refused."""
    free, walled = scenario(), scenario(box(1.6, 1.72, 2.4, 1.82))
    path = replace(free, problem=free.problem.starting_at(Pose2(1.0, 1.5, 0.0))).plan(1.0).path
    problem = walled.problem.starting_at(Pose2(0.6, 1.8, 0.0))
    plan = deformed_plan(path, problem, walled, 1.0)
    assert plan is not None
    assert certify_path(plan.path, problem)
    monkeypatch.setattr(questions, "_PUSHES", 0)
    assert deformed_plan(path, problem, walled, 1.0) is None
    assert deformed_plan(path, free.problem.starting_at(problem.start), free, 1.0) is not None
