"""A small room with a dock, and surveys of it."""

from unittest import mock

import numpy as np
import pytest

import optdock as od
from optdock.config import Scenario
from optdock.errors import OptdockError
from optdock.geometry.pose import Pose2
from optdock.io.plan_file import load_plan, save_plan
from optdock.model.robot import Drive
from optdock.reports.plan_file_verdict import judge_plan_file
from optdock.reports.report import failed_plan_file
from optdock.runner import Workers, run_cases
from optdock.survey.dock_places import DockPlace
from optdock.survey.grid import Box
from optdock.survey.opened import plan_of_cell
from optdock.survey.rounds import Spacing, survey_dock
from optdock.survey.survey import SurveySettings, _task, docks_of

GOAL = Pose2(3.6, 1.5, 0.0)


def box(left, lower, right, upper):
    return [(left, lower), (right, lower), (right, upper), (left, upper)]


ROOM = (box(-0.2, -0.2, 4.2, 0), box(-0.2, 3, 4.2, 3.2), box(-0.2, 0, 0, 3), box(4, 0, 4.2, 3))
STATION = od.Footprint(box(0.17, -0.2, 0.25, 0.2))
BACK_STATION = od.Footprint(box(-0.25, -0.2, -0.17, 0.2))


def scenario(*obstacles, goal=GOAL, station=STATION, direction="forward", robot=None, limits=None, **options):
    """Return a robot of 0.3 m in a room of 4 x 3 m."""
    limits = {"max_curvature": 4.0, "max_curvature_rate": 30.0, **(limits or {})}
    made = od.Robot(od.Footprint.rectangle(0.15, 0.15, 0.3), od.MotionLimits(**limits), **(robot or {}))
    view = {name: options.pop(name) for name in ("marker", "visible_distance") if name in options}
    dock = od.Dock(goal, station, direction, final_straight=0.2, approach_speed=0.1, approach_distance=0.2, **view)
    clearance = options.pop("clearance", od.ClearanceRule(0.03, 0.0, 0.3))
    return Scenario(od.DockingProblem(goal, dock, made, [*ROOM, *obstacles], clearance=clearance, **options))


CAR = {"robot": {"drive": Drive.ACKERMANN}, "limits": {"wheelbase": 0.2, "max_steering_rate": 1.0}}


def asked(given, region, resolution=0.25, headings=4, time_budget=0.1, run=None, **options):
    """Return task and answers of a survey of a region, without files, in blocks of four cells."""
    with mock.patch.object(Spacing, "of", return_value=Spacing(4, 16)):
        return _asked(given, region, resolution, headings, time_budget, run, **options)


def _asked(given, region, resolution, headings, time_budget, run, **options):
    (dock,) = docks_of("robot", given, [DockPlace("dock", given.problem.goal)])
    settings = SurveySettings(region=Box(*region), resolution=resolution, headings=headings, time_budget=time_budget)
    task, inside = _task(dock, settings)
    if run is not None:
        return task, survey_dock(task, inside, run, **options)
    with Workers(1, clock="counted") as workers:

        def one(function, cases):
            return run_cases(function, cases, workers=workers, shared=(task,))

        return task, survey_dock(task, inside, one, **options)


def judged(answers, cell, given, time_budget, folder):
    """Return the outcome of `optdock certify` on the plan file of a cell."""
    target, problem = folder / "cell.json", given.problem
    try:
        plan = plan_of_cell(answers, cell, given, time_budget)
        problem = plan.problem
        assert answers.grid.cells(problem.start.as_array()[None])[0] == cell
        if answers.method[cell] != "shared":
            assert np.allclose(problem.start.as_array(), answers.start[cell], atol=1e-9)
            assert plan.trajectory.duration == pytest.approx(answers.seconds[cell], rel=0.01)
        plan.save(target)
    except OptdockError as error:
        problem = problem.starting_at(Pose2.from_sequence(answers.grid.poses([cell])[0]))
        save_plan(target, failed_plan_file(error, problem.frame))
    verdict = judge_plan_file(load_plan(target), problem)
    assert verdict.false_claims == ()
    return verdict.outcome
