import csv
import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from optdock.config import demo_scenario, load_scenario
from optdock.errors import FailedToSmoothPath
from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.pose import Pose2
from optdock.model.path import ClothoidSegment, Path
from optdock.planning.plan import Attempt, PartialPlan
from optdock.plugins.interfaces import Smoother
from optdock.plugins.registry import PluginChoice
from optdock.reports.comparison import (
    PathFigures,
    comparison_csv,
    comparison_table,
    figures_of,
    raw_path_of,
    smoothed_figures,
    worst_joint_angle,
)
from optdock.verification import certify_path


@given(st.floats(-3.0, 3.0), st.floats(0.1, 2.0))
def test_a_corner_is_as_sharp_as_its_steps_say(angle, length):
    rows = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.5 * angle]]
    rows.append([1.0 + length * math.cos(angle), length * math.sin(angle), angle])
    if abs(angle) < 2.0:  # beyond that the middle pose drives the last step backward
        assert worst_joint_angle(Path.from_poses(np.array(rows))) == pytest.approx(abs(angle), abs=1e-9)


def test_a_heading_that_ignores_the_first_step_is_a_joint():
    path = Path.from_poses(np.array([[0.0, 0.0, 0.4], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]))
    assert worst_joint_angle(path) == pytest.approx(0.4)


def test_clothoids_have_no_joint_and_a_cusp_is_none():
    first = ClothoidSpline(Pose2(0.0, 0.0, 0.0), np.array([0.0, 1.0]), np.array([0.0, 2.0]))
    second = ClothoidSpline(first.end, np.array([0.0, 1.0]), np.array([0.0, 1.0]), -1)
    assert worst_joint_angle(Path((ClothoidSegment(first), ClothoidSegment(second)))) == 0.0


def test_gears_that_meet_at_an_angle_have_a_joint():
    first = ClothoidSpline(Pose2(0.0, 0.0, 0.0), np.array([0.0, 1.0]), np.zeros(2))
    second = ClothoidSpline(Pose2(1.0, 0.0, 0.3), np.array([0.0, 1.0]), np.zeros(2), -1)
    assert worst_joint_angle(Path((ClothoidSegment(first), ClothoidSegment(second)))) == pytest.approx(0.3)


def test_a_straight_reverse_path_has_no_joint():
    path = Path.from_poses(np.array([[0.0, 0.0, 1.0], [-math.cos(1.0), -math.sin(1.0), 1.0]]))
    assert worst_joint_angle(path) == pytest.approx(0.0, abs=1e-12)


def test_figures_become_rows_and_missing_ones_stay_empty():
    figures = [
        PathFigures("bay", "raw", "not certified", 3.25, 16.5, 35.5, -0.125, None),
        PathFigures("bay", "smoothed", "SmootherTimedOut"),
    ]
    rows = list(csv.DictReader(comparison_csv(figures).splitlines()))
    assert rows[0]["min_clearance_m"] == "-0.125"
    assert rows[0]["duration_s"] == rows[1]["length_m"] == ""
    lines = comparison_table(figures).splitlines()
    shown = ["bay", "raw", "-", "not", "certified", "3.25", "-", "16.5", "-", "35.5", "-0.125", "-", "-", "-"]
    assert lines[1].split() == shown
    assert lines[2].split() == ["bay", "smoothed", "-", "SmootherTimedOut", *["-"] * 9]


class Half(Smoother):
    """Raise a refusal with an unfinished path, or any other error."""

    error: Exception

    def smooth(self, path, max_time, **_):
        raise self.error


@pytest.mark.parametrize("kind", [FailedToSmoothPath, ZeroDivisionError])
def test_a_refused_smoother_has_a_row_with_its_reason_and_its_unfinished_path(kind, monkeypatch):
    scenario = load_scenario(demo_scenario())
    problem = scenario.problem
    unfinished = Path.from_poses(np.array([problem.start.as_array(), problem.goal.as_array()]))
    error = kind("no\nroom")
    error.partial = PartialPlan(path=unfinished)
    monkeypatch.setattr(Half, "error", error, raising=False)
    monkeypatch.setattr("optdock.reports.comparison.plugin_from", lambda *_: Half())
    found = smoothed_figures(scenario, unfinished, PluginChoice("Half"))
    assert found.smoother == "Half"
    assert "no room" in found.reason
    assert found.cpu >= 0.0
    if kind is FailedToSmoothPath:
        assert (found.status, found.length) == ("FailedToSmoothPath", pytest.approx(unfinished.driven))
    else:
        assert (found.status, found.length) == ("PluginError", None)


def test_every_violated_rule_is_a_reason_with_its_largest_violation():
    scenario = load_scenario(demo_scenario())
    problem = scenario.problem
    straight = Path.from_poses(np.array([problem.start.as_array(), problem.goal.as_array()]))
    figures, certificate = figures_of(scenario, "raw", straight), certify_path(straight, problem)
    kinds = {one.kind for one in certificate.violations}
    assert len(figures.reason.split("; ")) >= len(kinds) > 1
    worst = max((one for one in certificate.violations if one.kind == "slip"), key=lambda one: one.amount)
    assert worst.message in figures.reason


def test_raw_path_is_no_guess_that_was_derived_from_a_plan():
    scenario = load_scenario(demo_scenario())
    plan = scenario.plan(20.0)
    planned = plan.tried[0]
    derived = Attempt("fewer cusps", plan.path, price=0.0)
    assert raw_path_of(dataclasses.replace(plan, raw_path=plan.path, tried=(planned, derived))) is planned.guess
