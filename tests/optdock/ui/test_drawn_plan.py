"""The page's content of one answer, against the plan and against independent computations."""

import dataclasses
import math
import pickle

import numpy as np
import pytest
import shapely

import optdock as od
from optdock.config import Scenario
from optdock.errors import Cancelled, NoMotionExists, OptdockError, StartOccupied
from optdock.geometry.pose import transform_points
from optdock.impossibility import check_impossibility
from optdock.io.plan_file import parse_plan
from optdock.reports.plan_file_verdict import judge_plan_file
from optdock.reports.report import failed_plan_file
from optdock.ui.drawn_plan import drawn_plan

SHELF = [(1.4, 0.9), (2.4, 0.9), (2.4, 1.3), (1.4, 1.3)]


def problem_with(**changes):
    robot = od.Robot(od.Footprint.rectangle(0.2, 0.2, 0.2), od.MotionLimits(max_curvature=3.0, max_curvature_rate=12.0))
    dock = od.Dock(od.Pose2(4.0, 0.5, 0.0), od.Footprint.rectangle(0.5, -0.25, 0.3), final_straight=0.3)
    parts = {"start": od.Pose2(0.0, 0.0, 0.2), "dock": dock, "robot": robot, "obstacles": [SHELF], "clearance": 0.02}
    return od.DockingProblem(**{**parts, **changes})


@pytest.fixture(scope="module")
def planned():
    return Scenario(problem_with(), time_budget=10.0).plan()


def test_figures_of_a_plan_are_those_of_its_certificate_and_trajectory(planned):
    drawn = drawn_plan((7, "abc"), planned.problem, planned, seconds=0.5)
    assert (drawn.number, drawn.fingerprint, drawn.outcome, drawn.error) == (7, "abc", "certified", "")
    assert drawn.headline.startswith(f"{planned.path.driven:.3f} m")
    assert [text.title for text in drawn.texts] == ["Proven", "Not proven"]
    assert "Tried guesses" in {table.title for table in drawn.tables}
    assert drawn.path[[0, -1]] == pytest.approx(np.array([planned.path.start.as_array(), planned.path.end.as_array()]))
    assert set(drawn.gears.tolist()) == {int(segment.direction) for segment in planned.path.segments}
    motion = drawn.motion
    assert motion.at[-1] == pytest.approx(planned.trajectory.duration)
    assert motion.panels_at.size <= 240
    speed = next(panel for panel in motion.panels if panel.label.startswith("speed"))
    assert speed.values == pytest.approx(planned.trajectory.sample_at(motion.panels_at).speed)
    assert len(pickle.dumps(drawn)) < 100_000


def test_margins_are_the_distances_of_shapely_beyond_the_required_clearance(planned):
    problem, drawn = planned.problem, drawn_plan((1, ""), planned.problem, planned)
    assert drawn.outlines == pytest.approx(transform_points(drawn.swept, problem.robot.footprint.vertices))
    steps = np.hypot(*np.diff(drawn.swept[:, :2], axis=0).T)
    assert len(drawn.swept) <= 150
    assert steps.max() < 0.101
    station = transform_points(problem.dock.pose.as_array()[None], problem.dock.footprint.vertices)[0]
    around = shapely.union_all([shapely.Polygon(SHELF), shapely.Polygon(station)])
    ends = problem.goal, problem.start
    away = [np.hypot(drawn.swept[:, 0] - end.x, drawn.swept[:, 1] - end.y) for end in ends]
    begun = shapely.Polygon(drawn.outlines[0]).distance(around)
    required = problem.path_clearance.required_at(*away, begun, planned.certificate.start_relief)
    distance = [min(2.0, shapely.Polygon(outline).distance(around)) for outline in drawn.outlines]
    assert drawn.margins == pytest.approx(distance - required, abs=1e-9)
    least = drawn.places[0]
    assert least.clearance == pytest.approx(planned.certificate.min_clearance, abs=1e-6)
    assert math.dist(*least.nearest) == pytest.approx(least.clearance, abs=1e-9)
    tightest = drawn.places[1]
    assert tightest.pose == pytest.approx(drawn.swept[drawn.margins.argmin()])
    assert math.dist(*tightest.nearest) == pytest.approx(tightest.clearance, abs=1e-9)


def test_a_picture_without_words_is_the_same_picture(planned):
    whole, picture = (drawn_plan((1, ""), planned.problem, planned, picture_only=only) for only in (False, True))
    left_out = {"texts": (), "tables": (), "motion": None, "view": None, "file": picture.file}
    expected = dataclasses.replace(whole, **left_out)
    assert pickle.dumps(dataclasses.astuple(picture)) == pickle.dumps(dataclasses.astuple(expected))


def test_the_text_is_the_plan_file_and_certifies(planned, tmp_path):
    drawn = pickle.loads(pickle.dumps(drawn_plan((1, ""), planned.problem, planned)))
    planned.save(tmp_path / "plan.json")
    assert drawn.plan_file(planned.problem).as_json() == (tmp_path / "plan.json").read_text()
    assert judge_plan_file(parse_plan(drawn.plan_file(planned.problem).as_json(), "text"), planned.problem)


def test_a_proof_is_drawn_as_its_region_and_its_bottleneck():
    walls = [
        [(1.5, -3.0), (1.6, -3.0), (1.6, -0.09), (1.5, -0.09)],
        [(1.5, 0.09), (1.6, 0.09), (1.6, 3.0), (1.5, 3.0)],
        [(-2.0, 3.0), (6.0, 3.0), (6.0, 3.2), (-2.0, 3.2)],
        [(-2.0, -3.2), (6.0, -3.2), (6.0, -3.0), (-2.0, -3.0)],
        [(-2.2, -3.2), (-2.0, -3.2), (-2.0, 3.2), (-2.2, 3.2)],
        [(6.0, -3.2), (6.2, -3.2), (6.2, 3.2), (6.0, 3.2)],
    ]
    problem = problem_with(obstacles=walls)
    with pytest.raises(NoMotionExists) as caught:
        Scenario(problem, time_budget=20.0).plan()
    proof = caught.value.proof
    drawn = drawn_plan((1, ""), problem, caught.value)
    assert check_impossibility(proof, problem)
    assert (drawn.outcome, drawn.error, drawn.region_end) == ("impossible", "NoMotionExists", proof.end)
    area = sum(shapely.Polygon(rings[0], rings[1:]).area for rings in drawn.region)
    squares = [shapely.Polygon(square) for square in proof.squares()]
    assert area == pytest.approx(shapely.union_all(squares).area)
    end = problem.goal if proof.end == "goal" else problem.start
    centre = transform_points(end.as_array()[None], np.array([proof.centre]))[0, 0]
    assert any(shapely.Polygon(rings[0], rings[1:]).contains(shapely.Point(centre)) for rings in drawn.region)
    (place,) = drawn.places
    assert place.name == "bottleneck"
    assert place.pose == pytest.approx([proof.bottleneck.x, proof.bottleneck.y, proof.bottleneck.yaw])
    assert drawn.motion is None
    assert judge_plan_file(parse_plan(drawn.plan_file(problem).as_json(), "text"), problem).outcome == "impossible"


def test_refusals_have_their_place_reason_and_code():
    on_shelf = problem_with(start=od.Pose2(1.5, 1.0, 0.0))
    with pytest.raises(StartOccupied) as caught:
        Scenario(on_shelf).plan()
    drawn = drawn_plan((1, ""), on_shelf, caught.value)
    assert (drawn.outcome, drawn.error, drawn.code) == ("refused", "StartOccupied", StartOccupied.code)
    assert drawn.headline == str(caught.value)
    (place,) = drawn.places
    assert place.name == "refused here"
    assert place.pose == pytest.approx(on_shelf.start.as_array())
    assert place.clearance < 0.0
    assert math.dist(*place.nearest) == 0.0
    assert drawn.path.shape == (0, 3)
    assert drawn.plan_file(on_shelf).as_json() == failed_plan_file(caught.value, on_shelf.frame).as_json()
    assert drawn_plan((1, ""), on_shelf, Cancelled("stop")).outcome == "cancelled"
    assert drawn_plan((1, ""), on_shelf, OptdockError("lost")).places == ()


def test_a_required_view_is_drawn_as_cones_that_contain_the_marker():
    plain = problem_with()
    camera = od.Camera(od.Pose2(0.0, 0.0, 0.0), 2.0, 0.05, 5.0)
    seen = plain.robot.footprint, plain.robot.limits
    dock = dataclasses.replace(plain.dock, marker=(0.3, 0.0), visible_distance=0.5, blind_distance=0.1)
    problem = problem_with(robot=od.Robot(*seen, camera=camera), dock=dock)
    drawn = drawn_plan((1, ""), problem, Scenario(problem, time_budget=10.0).plan())
    marker = shapely.Point(problem.required_view.marker)
    assert drawn.cones
    assert all(shapely.Polygon(cone).contains(marker) for cone in drawn.cones)
    assert drawn_plan((1, ""), plain, OptdockError("lost")).cones == ()
