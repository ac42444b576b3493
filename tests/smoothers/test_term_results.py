"""Paths of a smoother with terms: violated without, holds with; no way for a path around the samples of hard terms."""

import concurrent.futures
import dataclasses
import itertools
import math

import casadi
import numpy as np
import pytest

from experiments.benchmarks.ipopt_reference import smooth_by_ipopt
from experiments.families import instance
from optdock.errors import FailedToSmoothPath, SmootherTimedOut
from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.model.limits import MotionLimits
from optdock.model.path import ClothoidSegment, Path, PolylineSegment, TurnSegment
from optdock.model.robot import Robot
from optdock.plugins.interfaces import SmoothingStatus
from optdock.verification import certify_path
from smoothers import CasadiSmoother, HardTerm, SoftTerm
from smoothers.scp.search import Call, PathVerdict
from smoothers.scp.term_samples import SPACING, sampled_cost, samples_of

GOAL = Pose2(4.0, 1.0, 0.0)
RIGHT = HardTerm("right", lambda p: p.ahead - p.y + 0.25 * (p.x - p.at), ahead=0.66, at=2.0)
ROBOT = Robot(
    Footprint.rectangle(0.45, 0.45, 0.6),
    MotionLimits(max_curvature=1.5, max_curvature_rate=6.0, max_yaw_rate=0.8, max_yaw_acceleration=1.5),
    turns_in_place=True,
)


@pytest.fixture(name="scene")
def _scene(cases):
    """A lane change, and an input that changes the lane early."""
    return cases.open_problem(GOAL), cases.kinked((0.0, 0.0), (0.8, 0.0), (1.8, 1.0), (4.0, 1.0))


def smoothed(scene, *terms, **options):
    problem, raw = scene
    return CasadiSmoother(terms=terms, **options).smooth(raw, 30.0, problem=problem)


def least(path, value):
    """The smallest value of a function of x, y, yaw, curvature at samples of 1 mm."""
    return min(
        float(np.min(value(*segment.poses_at(s).T, segment.curvature_at(s))))
        for segment in path.segments
        for s in [np.linspace(0.0, segment.length, 2 + int(segment.length / 1e-3))]
    )


def right(x, y, *_):
    return 0.66 - y + 0.25 * (x - 2.0)


def test_a_line_is_crossed_without_its_term_and_kept_with_it(scene):
    assert least(smoothed(scene).path, right) < -0.02
    found = smoothed(scene, RIGHT)
    assert least(found.path, right) > -1e-5
    (bound,) = found.report.sampled
    assert (bound.name, bound.spacing) == ("right", SPACING)
    assert bound.least == pytest.approx(least(found.path, right), abs=1e-4)
    assert right(*found.path.poses_at(bound.s)[0]) == pytest.approx(bound.least, abs=1e-9)
    assert certify_path(found.path, scene[0]).certified
    assert "sampled every 0.005 m, not proven" in repr(found.report)


def test_a_slow_zone_bounds_the_curvature_inside_it(scene):
    def zone(x, _, __, curvature):
        return np.where(np.abs(x - 0.8) < 0.4, 0.25 - np.abs(curvature), 1.0)

    slow = HardTerm(
        "slow", lambda p: 0.25 - casadi.fabs(p.curvature) + 4.0 * casadi.fmax(0, casadi.fabs(p.x - 0.8) - 0.4)
    )
    assert least(smoothed(scene).path, zone) < -0.05
    assert least(smoothed(scene, slow).path, zone) > -1e-5


def test_ipopt_serves_the_same_terms_and_finds_the_same_optimum(scene):
    problem, raw = scene
    near = SoftTerm("near", lambda p: p.y - 0.2 * p.x, weight=2.0)
    fast = smoothed(scene, RIGHT, near)
    reference = smooth_by_ipopt(raw, 60.0, problem, [RIGHT, near])
    assert reference.report.sampled[0].holds
    assert fast.report.cost == pytest.approx(reference.report.cost, rel=0.01)


def test_more_weight_lowers_the_integral_of_a_soft_term(scene):
    integrals = []
    for weight in (0.0, 0.3, 1.0, 3.0, 10.0):
        term = SoftTerm("low", lambda p: casadi.fmax(0, p.y - 0.2 * p.x), weight=weight)
        found = smoothed(scene, term)
        unit = CasadiSmoother(terms=[term.with_weight(1.0)])._terms
        integrals.append(sampled_cost(unit, found.path, 0.3))
        assert found.path.end.gap_to(GOAL) < 1e-6
    assert all(after < before + 1e-6 for before, after in itertools.pairwise(integrals))
    assert integrals[-1] < 0.5 * integrals[0]


def test_the_integral_is_that_of_the_driven_length():
    line = Path((ClothoidSegment(ClothoidSpline(Pose2(0.0, 0.0, 0.0), np.array([0.0, 2.0]), np.zeros(2), 1)),))
    ramp = CasadiSmoother(terms=[SoftTerm("ramp", lambda p: p.s, weight=3.0)])._terms
    assert sampled_cost(ramp, line, 0.0) == pytest.approx(3.0 * 8.0 / 3.0, rel=1e-4)
    assert sampled_cost(ramp, line, 1.0) == pytest.approx(3.0 / 3.0, rel=1e-2)  # without its last metre


@pytest.mark.parametrize("term", [HardTerm("constant", lambda _: 2.0), SoftTerm("nothing", lambda p: 0.0 * p.x)])
def test_a_term_without_effect_changes_nothing(scene, term):
    plain, found = smoothed(scene).path, smoothed(scene, term).path
    assert found.digest == plain.digest


def assert_refused(error, name):
    """Raised for this term, with everything that locates it."""
    assert error.where["reason"] == "term"
    assert error.where["term"] == name
    assert error.where["amount"] > 0.0
    assert len(error.where["pose"]) == 3
    assert error.where["s"] >= 0.0
    assert name in str(error)


IMPOSSIBLE = {
    "at the start": HardTerm("mine", lambda p: p.x - 0.1),
    "on the final straight": HardTerm("mine", lambda p: 3.9 - p.x),
    "on the whole way": HardTerm("mine", lambda p: 1.0 - p.s),
    "in a strip": HardTerm("mine", lambda p: casadi.fabs(p.x - 1.2345) - 0.1),
    "in a strip between two nodes": HardTerm("mine", lambda p: casadi.fabs(p.x - 1.2345) - 0.003),
    "no number": HardTerm("mine", lambda p: casadi.sqrt(1.0 - p.s)),
    "no number in between": HardTerm("mine", lambda p: casadi.log(casadi.fabs(p.x - 1.2345) - 0.003) + 20.0),
    "by the gear": HardTerm("mine", lambda p: -p.gear),
}


@pytest.mark.parametrize("where", IMPOSSIBLE)
def test_a_term_that_no_path_satisfies_is_refused_by_name(scene, where):
    with pytest.raises(FailedToSmoothPath) as no:
        smoothed(scene, IMPOSSIBLE[where])
    assert_refused(no.value, "mine")


def test_a_soft_term_without_a_value_is_refused_by_name(scene):
    with pytest.raises(FailedToSmoothPath) as no:
        smoothed(scene, SoftTerm("mine", lambda p: casadi.log(p.s - 1.0)))
    assert_refused(no.value, "mine")


def test_a_certified_input_that_breaks_a_term_is_not_kept(scene):
    problem, _ = scene
    certified = smoothed(scene).path
    kept = CasadiSmoother(max_iterations=1).smooth(certified, 30.0, problem=problem)
    assert kept.report.status in {SmoothingStatus.INPUT_KEPT, SmoothingStatus.CONVERGED, SmoothingStatus.STOPPED}
    found = CasadiSmoother(terms=[RIGHT]).smooth(certified, 30.0, problem=problem)
    assert least(found.path, right) > -1e-5
    with pytest.raises(FailedToSmoothPath) as no:
        CasadiSmoother(terms=[IMPOSSIBLE["in a strip"]]).smooth(certified, 30.0, problem=problem)
    assert_refused(no.value, "mine")


def test_an_earlier_result_that_breaks_a_term_is_not_returned(scene):
    problem, raw = scene
    earlier = smoothed(scene).path
    for options in ({}, {"stop_at_first": True}, {"max_iterations": 1}):
        smoother = CasadiSmoother(terms=[IMPOSSIBLE["in a strip between two nodes"]], **options)
        with pytest.raises(FailedToSmoothPath) as no:
            smoother.smooth(raw, 30.0, problem=problem, warm_start=earlier)
        assert_refused(no.value, "mine")
    found = CasadiSmoother(terms=[RIGHT]).smooth(raw, 30.0, problem=problem, warm_start=earlier)
    assert least(found.path, right) > -1e-5


def test_the_direct_line_must_satisfy_the_terms(cases):
    problem, raw = cases.open_problem(Pose2(0.32, 0.0, 0.0)), cases.kinked((0.0, 0.0), (0.32, 0.0))
    assert CasadiSmoother().smooth(raw, 30.0, problem=problem).report.status is SmoothingStatus.STRAIGHT
    with pytest.raises(FailedToSmoothPath) as no:
        CasadiSmoother(terms=[HardTerm("mine", lambda p: 0.1 - p.s)]).smooth(raw, 30.0, problem=problem)
    assert_refused(no.value, "mine")


def around_a_corner(cases):
    """Two lines with a turn in place by half a turn to the left and a quarter to the right between them."""
    corner = Pose2(1.5, 0.0, 0.0)
    first = PolylineSegment(np.column_stack((np.linspace(0.0, 1.5, 9), np.zeros(9), np.zeros(9))))
    turns = TurnSegment(corner, math.pi), TurnSegment(Pose2(1.5, 0.0, math.pi), -0.5 * math.pi)
    y = np.linspace(0.0, 1.5, 9)
    last = PolylineSegment(np.column_stack((np.full(9, 1.5), y, np.full(9, 0.5 * math.pi))))
    raw = Path((first, *turns, last))
    return dataclasses.replace(cases.open_problem(raw.end), robot=ROBOT), raw


@pytest.mark.parametrize(
    ("term", "inside"),
    [
        (HardTerm("mine", lambda p: 1.9 - casadi.fmax(0, 1.0 - casadi.cos(p.yaw))), True),  # never faces backward
        (HardTerm("mine", lambda p: 2.0 - casadi.fabs(p.curvature)), True),  # a turn has no finite curvature
        (HardTerm("mine", lambda p: casadi.fabs(p.gear) - 0.5), True),  # always in gear
        (HardTerm("mine", lambda p: 2.5 - p.s), False),  # the driven length is 3 m
        (HardTerm("mine", lambda p: casadi.fabs(p.y - 0.7) - 0.05), False),
    ],
)
def test_turns_in_place_and_kept_lines_are_sampled(cases, term, inside):
    problem, raw = around_a_corner(cases)
    assert certify_path(CasadiSmoother().smooth(raw, 30.0, problem=problem).path, problem).certified
    with pytest.raises(FailedToSmoothPath) as no:
        CasadiSmoother(terms=[term]).smooth(raw, 30.0, problem=problem)
    assert_refused(no.value, "mine")
    assert (1.5 <= no.value.where["s"] <= 1.5 + 1.5 * math.pi) == inside


def test_lengths_run_on_over_the_pieces_between_turns(cases):
    problem, raw = around_a_corner(cases)
    halves = HardTerm("halves", lambda p: casadi.if_else(p.s < 1.4, 1.45 - p.x, p.remaining + p.s - 2.9))
    searched = SoftTerm("any", lambda p: p.y)  # with a cost, straight pieces are searched as well
    found = CasadiSmoother(terms=[halves, searched]).smooth(raw, 30.0, problem=problem)
    assert found.report.iterations > 0
    points, s = samples_of(found.path)
    assert points[-1, 4] == pytest.approx(found.path.driven)
    assert points[:, 4] + points[:, 5] == pytest.approx(np.full(s.size, found.path.driven))
    assert s[-1] == pytest.approx(found.path.length)


def test_no_result_passes_the_last_gate_whatever_the_search_accepts(scene, monkeypatch):
    monkeypatch.setattr(PathVerdict, "accepted", property(lambda verdict: verdict.certificate.certified))
    with pytest.raises(FailedToSmoothPath) as no:
        smoothed(scene, IMPOSSIBLE["in a strip between two nodes"])
    assert_refused(no.value, "mine")


def test_the_certificate_does_not_depend_on_terms(scene, monkeypatch):
    """A path that is not certified stays refused, and terms are not even looked at."""
    problem, raw = scene
    blocked = dataclasses.replace(problem, obstacles=[[(3.9, 0.0), (4.1, 0.0), (4.1, 2.0), (3.9, 2.0)]])
    with pytest.raises(FailedToSmoothPath) as no:
        CasadiSmoother(terms=[RIGHT]).smooth(raw, 30.0, problem=blocked)
    assert no.value.where["reason"] == "approach_blocked"
    seen = []
    monkeypatch.setattr(
        Call, "judged", lambda call, path, late, was=Call.judged: seen.append(was(call, path, late)) or seen[-1]
    )
    found = smoothed(scene, RIGHT)
    assert repr(found.report.certificate) == repr(certify_path(found.path, problem))
    assert all(not verdict.sampled or verdict.certificate.certified for verdict in seen)


@pytest.mark.parametrize("budget", [0.0, 0.002, 0.005, 0.01, 0.02, 0.05])
def test_little_time_never_returns_a_path_that_breaks_a_term(scene, budget):
    problem, raw = scene
    try:
        found = CasadiSmoother(terms=[RIGHT]).smooth(raw, budget, problem=problem)
    except (SmootherTimedOut, FailedToSmoothPath):
        return
    assert least(found.path, right) > -1e-5


def test_terms_can_be_changed_between_calls_and_shared_by_threads(scene):
    problem, raw = scene
    smoother = CasadiSmoother(terms=[RIGHT])
    before = smoother.smooth(raw, 30.0, problem=problem).path
    with concurrent.futures.ThreadPoolExecutor(2) as pool:
        jobs = [pool.submit(smoother.smooth, raw, 30.0, problem=problem) for _ in range(4)]
        assert {job.result().path.digest for job in jobs} == {before.digest}
    smoother.terms = [RIGHT.with_values(ahead=0.65)]
    after = smoother.smooth(raw, 30.0, problem=problem).path
    assert least(after, lambda x, y, *_: right(x, y) - 0.01) > -1e-5
    assert least(before, lambda x, y, *_: right(x, y) - 0.01) < -0.005
    (bound,) = smoother.sampled_bounds(before)
    assert not bound.holds  # a known path is sampled again for other values
    smoother.terms = []
    assert smoother.sampled_bounds(before) == ()


def test_samples_are_as_close_as_they_are_said_to_be():
    bent = ClothoidSegment(
        ClothoidSpline(Pose2(0.0, 0.0, 0.0), np.array([0.0, 0.7, 1.0]), np.array([0.0, 8.0, -8.0]), -1)
    )
    turn = TurnSegment(Pose2.from_sequence(bent.poses_at(1.0)[0]), -2.0)
    poses = [[0.2 * k, 0.0, 0.3 * k] for k in range(4)]
    path = Path((bent, turn, PolylineSegment(np.array(poses))))
    points, s = samples_of(path)
    steps = np.hypot(*np.diff(points[:, :2], axis=0).T)
    turned = np.abs(np.angle(np.exp(1j * np.diff(points[:, 2]))))
    inside = ~np.isin(s[1:], path.segment_starts[1:-1]) | (np.diff(s) > 0.0)  # not from one segment to the next
    assert steps[inside].max() <= SPACING + 1e-12
    assert turned[inside].max() <= 0.01 + 1e-12
    inner = ~np.isin(s, path.segment_starts)
    poses = path.poses_at(s[inner])
    assert points[inner, :2] == pytest.approx(poses[:, :2], abs=1e-9)
    assert np.exp(1j * points[inner, 2]) == pytest.approx(np.exp(1j * poses[:, 2]), abs=1e-9)
    assert set(points[:, 6].tolist()) == {-1.0, 0.0, 1.0}
    assert np.abs(points[points[:, 6] == 0.0, 3]).min() == 1e9
    assert points[0, 5] == pytest.approx(path.driven)
    assert points[-1, 5] == pytest.approx(0.0, abs=1e-12)


def test_a_hard_term_that_is_not_a_number_on_the_first_path_is_named(scene):
    """Within the path, whose ends have values: the search does not begin."""
    with pytest.raises(FailedToSmoothPath, match="'mine' is not a finite number at s = .* on the first path") as no:
        smoothed(scene, HardTerm("mine", lambda p: casadi.log(casadi.fabs(p.s - 2.0) - 0.5) + 1000.0))
    assert_refused(no.value, "mine")


@pytest.mark.parametrize("share", [0.9999, 0.998])
def test_a_bound_on_the_driven_distance_holds_on_the_final_straight_too(share):
    """It binds at the goal alone, behind the last node."""
    case = instance("open_s", 0)
    free = CasadiSmoother().smooth(case.raw_path, 30.0, problem=case.problem).path
    term = HardTerm("mine", lambda p: p.most - p.s, most=share * free.length)
    found = CasadiSmoother(terms=[term]).smooth(case.raw_path, 30.0, problem=case.problem).path
    assert case.problem.dock.final_straight > 0.0
    assert found.driven <= share * free.length + 1e-6


def test_terms_at_the_ends_have_the_symbols_of_the_ends(scene):
    """Heading in [-pi, pi), gear of the first segment at the start, and the distance left on the final straight."""
    problem, raw = scene
    turned = [Pose2(pose.x, pose.y, pose.yaw + 6.0 * math.pi) for pose in (problem.start, problem.goal)]
    round_again = dataclasses.replace(problem, start=turned[0], dock=dataclasses.replace(problem.dock, pose=turned[1]))
    assert smoothed((round_again, raw), HardTerm("mine", lambda p: math.pi - casadi.fabs(p.yaw))).path.segments
    with pytest.raises(FailedToSmoothPath, match=r"0\.150 m before the goal"):
        smoothed(scene, HardTerm("mine", lambda p: casadi.fabs(p.remaining - 0.15) - 0.001))
    case = instance("reverse_cusp", 0)
    start, first = case.problem.start, int(case.raw_path.segments[0].direction)
    assert first != case.raw_path.segments[-1].direction
    for gear in (first, -first):
        there = HardTerm(
            "mine",
            lambda p, gear=gear: casadi.if_else((p.x - start.x) ** 2 + (p.y - start.y) ** 2 < 1e-8, gear * p.gear, 1.0),
        )
        if gear == first:
            assert smoothed((case.problem, case.raw_path), there).path.segments
        else:
            with pytest.raises(FailedToSmoothPath, match="at the start, where every path in these gears begins"):
                smoothed((case.problem, case.raw_path), there)
