"""The rest of a certified path is certified from each of its poses, and its duration is that of a planned time law."""

import dataclasses
import math

import numpy as np
import pytest

import optdock as od
from optdock.config.plugin_sections import PLUGIN_DEFAULTS
from optdock.deadline import budget_clock
from optdock.geometry.pose import Pose2
from optdock.io.path_columns import curves_of
from optdock.model.segments import TurnSegment
from optdock.planners.manoeuvres.price import stops
from optdock.plugins.interfaces import TimeParameterizer
from optdock.plugins.registry import PluginChoice, plugin_from
from optdock.survey.grid import SurveyGrid
from optdock.survey.questions import SurveyTask
from optdock.survey.tails import PassedCells, passed_cells, time_rests
from optdock.verification import certify_path
from tests.optdock.survey.scenes import BACK_STATION, CAR, box, scenario

FINE = SurveyGrid((-10, -10), (36, 140, 180), 0.025)
BACK = {"goal": Pose2(3.6, 1.5, math.pi), "station": BACK_STATION, "direction": "backward"}
TUBE = {"robot": {"tracking": od.TrackingTube(0.02, 0.02)}}
TURNS = {
    "robot": {"turns_in_place": True},
    "limits": {"max_curvature": 0.6, "max_yaw_rate": 1.0, "max_yaw_acceleration": 2.0},
}
VIEW = {
    "robot": {"camera": od.Camera(Pose2(0.1, 0.0, 0.0), 1.6, 0.02, 3.0)},
    "marker": (0.17, 0.0),
    "visible_distance": 1.0,
}
GAP = (box(1.9, 0, 2.1, 1.2), box(1.9, 1.75, 2.1, 3))

KINDS = {
    "free": ((), {}, (1.0, 1.0, 0.4)),
    "gap": (GAP, {}, (0.7, 0.7, 2.0)),
    "cusp": ((), {}, (3.3, 0.9, 1.6)),
    "tube": (GAP, TUBE, (0.8, 2.2, -0.5)),
    "camera": ((), VIEW, (1.0, 1.0, 0.2)),
    "turns in place": ((), TURNS, (1.0, 1.0, math.pi)),
    "backward": ((), BACK, (1.5, 2.0, 2.5)),
    "steered wheels": ((), CAR, (1.0, 0.8, 0.9)),
    "at start": (GAP, {"clearance": od.ClearanceRule(0.03, 0.0, 0.3, at_start=0.0)}, (0.7, 1.7, 1.0)),
}


def planned(kind):
    obstacles, options, start = KINDS[kind]
    given = scenario(*obstacles, **options)
    with budget_clock("counted"):
        return given, dataclasses.replace(given, problem=given.problem.starting_at(Pose2(*start))).plan(1.0)


@pytest.fixture(scope="module", params=KINDS)
def plan(request):
    return planned(request.param)


def places_of(plan, count, seed):
    last = plan.path.length - plan.problem.dock.final_straight
    return np.sort(np.random.default_rng(seed).uniform(0.0, last, count))


def test_the_theorem_at_random_places(plan):
    given, found = plan
    for s in (*places_of(found, 8, 1), *(cusp for cusp in found.path.cusps)):
        rest = found.path.piece(float(s))
        certificate = certify_path(rest, given.problem.starting_at(rest.start))
        assert certificate.certified, (s, certificate.violations)


def test_every_passed_cell_contains_the_pose_and_is_certified(plan):
    """Sources, path coordinates and prices belong to the plan; the last passed cell is before the final straight."""
    given, found = plan
    passed = passed_cells(found, FINE)
    assert passed.cell.size > 20
    assert np.array_equal(FINE.cells(found.path.poses_at(passed.s)), passed.cell)
    assert np.unique(passed.cell).size == passed.cell.size
    assert set(passed.source.tolist()) == set(FINE.cells(found.problem.start.as_array()[None]).tolist())
    assert passed.s.max() < found.path.length - given.problem.dock.final_straight
    first = int(np.argmin(passed.s))
    assert passed.price[first] == pytest.approx(found.price, abs=0.6)
    for row in range(0, passed.cell.size, 1 + passed.cell.size // 4):
        rest = found.path.piece(float(passed.s[row]))
        assert certify_path(rest, given.problem.starting_at(rest.start)).certified


def test_durations_of_rests_are_those_of_the_time_parameterizer(plan):
    given, found = plan
    law = found.trajectory.time_law
    motion = {"curves": curves_of(found.path), "durations": law.durations.tolist(), "jerks": law.jerks.tolist()}
    places = places_of(found, 12, 2)
    (row,) = time_rests(SurveyTask(given, FINE, 0.1), [(motion, places.tolist())])
    timing = plugin_from(TimeParameterizer, PluginChoice(PLUGIN_DEFAULTS["timing"]), "timing")
    ratios = []
    for s, seconds, pose, count in zip(places.tolist(), row["seconds"], row["poses"], row["stops"], strict=True):
        rest = found.path.piece(s)
        assert np.allclose(pose, rest.start.as_array(), atol=1e-9)
        assert count == stops(rest)
        problem = given.problem.starting_at(rest.start)
        wait = problem.start_wait(rest)
        waits = {"start_wait": wait} if wait > 0.0 else {}
        timed = timing.parameterize(rest, problem.robot.limits, problem.dock.approach, **waits)
        ratios.append(seconds / timed.trajectory.duration)
    assert max(abs(ratio - 1.0) for ratio in ratios) < 0.01, ratios


@pytest.mark.parametrize("gap", [0.01, 0.029])
def test_a_start_that_is_too_close_has_no_rests(gap):
    """Its relief belongs to this start, also if the path is certified without the weaker rule."""
    close = box(0.5, 1.15 + gap, 1.5, 1.25 + gap)
    given = scenario(close)
    with budget_clock("counted"):
        found = dataclasses.replace(given, problem=given.problem.starting_at(Pose2(1.0, 1.0, 0.0))).plan(1.0)
    assert passed_cells(found, FINE).cell.size == 0
    far = scenario(close + np.array([0.0, 0.04]))
    with budget_clock("counted"):
        found = dataclasses.replace(far, problem=far.problem.starting_at(Pose2(1.0, 1.0, 0.0))).plan(1.0)
    assert passed_cells(found, FINE).cell.size > 20


def test_a_camera_with_a_tube_has_no_rests():
    options = {**VIEW, "robot": {**VIEW["robot"], **TUBE["robot"]}}
    given = scenario(**options)
    with budget_clock("counted"):
        found = dataclasses.replace(given, problem=given.problem.starting_at(Pose2(1.0, 1.3, 0.1))).plan(1.0)
    assert passed_cells(found, FINE).cell.size == 0


def test_stops_and_price_count_a_turn_in_place_once():
    """A turn has two ends, at which the robot rests, but it is one stop."""
    _, found = planned("turns in place")
    assert any(isinstance(segment, TurnSegment) for segment in found.path.segments)
    assert len(found.path.cusps) > stops(found.path)


def test_the_cheapest_row_of_each_cell_is_kept():
    """The smaller source decides between equal prices, so that the result does not depend on the order."""
    parts = [
        PassedCells(np.array([4, 2]), np.array([9, 9]), np.array([0.1, 0.2]), np.array([5.0, 3.0])),
        PassedCells(np.array([2, 4, 7]), np.array([8, 8, 8]), np.array([0.3, 0.4, 0.5]), np.array([3.0, 5.5, 1.0])),
    ]
    for order in (parts, parts[::-1]):
        found = PassedCells.joined(order)
        assert found.cell.tolist() == [2, 4, 7]
        assert found.source.tolist() == [8, 9, 8]
        assert found.s.tolist() == [0.3, 0.1, 0.5]
    again = PassedCells.from_dict(found.as_dict())
    assert all(np.array_equal(a, b) for a, b in zip(again, found, strict=True))
    assert [group.source.tolist() for group in found.rows(np.array([0, 2, 1])).by_source()] == [[8, 8], [9]]
    assert PassedCells.joined([]).by_source() == []
