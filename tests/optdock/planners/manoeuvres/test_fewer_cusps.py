"""A gear less: ends and the other gears stay, the smallest gap goes first, and a plan gets cheaper by it."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optdock.errors import FailedToSmoothPath
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.path import Path
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.model.segments import PolylineSegment, TurnSegment
from optdock.planners.manoeuvres.arcs import advance
from optdock.planning.guess_edits import fewer_cusps
from optdock.planning.pipeline import plan_dock
from optdock.plugins.interfaces import GlobalPlanner
from smoothers.casadi_smoother import CasadiSmoother

LIMITS = MotionLimits(max_curvature=1.5, max_curvature_rate=6.0, max_yaw_rate=1.0, max_yaw_acceleration=1.0)
ROBOT = Robot(Footprint.rectangle(0.45, 0.45, 0.6), LIMITS, turns_in_place=True)


def driven(*gears):
    """Gears of a length and a curvature each, one after the other; a gear of length 0 turns in place by its second."""
    segments, pose = [], Pose2(0.0, 0.0, 0.2)
    for length, bend in gears:
        if length == 0.0:
            segments.append(TurnSegment(pose, bend))
            pose = segments[-1].end
            continue
        poses = advance(pose.as_array()[None], np.linspace(0.0, length, 30), np.array([bend]))
        segments.append(PolylineSegment(poses, 1 if length > 0.0 else -1))
        pose = Pose2.from_sequence(poses[-1])
    return Path(tuple(segments))


def asked(path, **start):
    return DockingProblem(path.start, Dock(path.end), ROBOT, (), ClearanceRule(0.05, 0.0, 0.5), **start)


GEARS = st.lists(st.tuples(st.floats(0.01, 2.0), st.floats(-1.0, 1.0)), min_size=1, max_size=5)


@settings(max_examples=20)
@given(GEARS, st.sampled_from([1.0, -1.0]))
def test_ends_stay_and_gears_alternate(gears, first):
    path = driven(*((first * (-1.0) ** k * length, bend) for k, (length, bend) in enumerate(gears)))
    lengths = [segment.length for segment in path.segments]
    for simpler in fewer_cusps(path, asked(path)):
        assert simpler.start == path.start
        assert simpler.end == path.end
        assert len(simpler.segments) < len(path.segments)
        assert all(a.direction == -b.direction for a, b in itertools.pairwise(simpler.segments))
        assert simpler.segments[-1].direction == path.segments[-1].direction
        assert simpler.length <= sum(lengths) + 0.5


def test_gear_with_the_smallest_gap_is_left_out_first():
    path = driven((1.0, 0.0), (-0.2, 0.2), (1.0, 0.0), (-0.05, 1.5), (2.0, 0.0))
    first, second = itertools.islice(fewer_cusps(path, asked(path)), 2)
    assert [segment.length for segment in first.segments] == pytest.approx([1.8, 0.05, 2.0], abs=0.03)
    assert [segment.length for segment in second.segments] == pytest.approx([1.0, 0.2, 2.95], abs=0.03)


def test_gap_that_the_other_strokes_cannot_make_up_for_is_not_left():
    """Without the stroke of 6 cm the heading lacks 0.25 rad; at full lock 0.28 m of strokes turn by 0.42 rad."""
    for more, found in (((), False), (((0.2, 1.4), (-0.2, -1.4)), True)):
        path = driven((1.0, 0.0), (-0.2, -1.4), (0.06, 1.4), (-0.2, -1.4), *more)
        assert any(True for _ in fewer_cusps(path, asked(path))) is found


def test_detours_are_short_and_between_long_gears():
    path = driven((1.0, 0.0), (-0.2, 0.2), (1.0, 0.0), (-0.2, 0.2), (0.25, 0.0), (-0.2, 0.0))
    detour, *rest = fewer_cusps(path, asked(path), only_detours=True)
    assert rest == []
    assert [segment.length for segment in detour.segments] == pytest.approx([1.8, 0.2, 0.25, 0.2], abs=0.03)


def test_gears_that_are_long_or_beside_a_turn_stay():
    for path in (
        driven((1.0, 0.0), (-0.6, 0.0), (1.0, 0.0)),
        driven((0.1, 0.0), (0.0, 1.0), (1.0, 0.0)),
        driven((1.0, 0.3)),
    ):
        assert list(fewer_cusps(path, asked(path))) == []


def test_robot_in_motion_keeps_its_first_gear():
    path = driven((0.1, 0.0), (-1.0, 0.3))
    assert [len(one.segments) for one in fewer_cusps(path, asked(path))] == [1]
    assert [len(one.segments) for one in fewer_cusps(path, asked(path, start_speed=-0.1))] == [1]
    assert list(fewer_cusps(path, asked(path, start_speed=0.1))) == []


def test_second_gear_shorter_than_the_first_cannot_go_on_alone():
    path = driven((0.1, 0.0), (-0.05, 0.0))
    assert list(fewer_cusps(path, asked(path))) == []


class Offers(GlobalPlanner):
    """Offers one path."""

    def __init__(self, path):
        super().__init__()
        self.path = path

    def create_plan(self, start, goal, cancel_checker=None):
        return self.path


SHORT_GEAR = pytest.mark.parametrize("last", [0.08, 2.0])  # a gear of 3 cm before it is a detour if this one is long


@SHORT_GEAR
def test_plan_has_no_unnecessary_gear_of_centimetres(last):
    path = driven((1.0, 0.4), (-0.03, 0.4), (last, -0.2))
    plan = plan_dock(asked(path), planner=Offers(path), time_budget=20.0)
    assert not plan.path.cusps
    (only,) = plan.tried
    assert len(only.guess.segments) == 1


@SHORT_GEAR
def test_guess_is_tried_if_no_path_has_fewer_gears(monkeypatch, last):
    path, smooth = driven((1.0, 0.4), (-0.03, 0.4), (last, -0.2)), CasadiSmoother.smooth

    def failing(self, raw, *args, **kwargs):
        if len(raw.segments) < len(path.segments):
            raise FailedToSmoothPath("no")
        return smooth(self, raw, *args, **kwargs)

    monkeypatch.setattr(CasadiSmoother, "smooth", failing)
    plan = plan_dock(asked(path), planner=Offers(path), time_budget=20.0)
    assert len(plan.path.segments) == 3
    assert [len(attempt.guess.segments) for attempt in plan.tried[:2]] == [1, 3]
    assert {attempt.stage for attempt in plan.tried[2:]} <= {"fewer cusps"}


def test_plan_without_gears_is_given_up_after_two_failures(monkeypatch):
    smooth, given = CasadiSmoother.smooth, []

    def failing(self, raw, *args, **kwargs):
        given.append(raw)
        if len(given) > 1:
            raise FailedToSmoothPath("no")
        return smooth(self, raw, *args, **kwargs)

    monkeypatch.setattr(CasadiSmoother, "smooth", failing)
    path = driven((1.5, 0.2), *(((-0.4, 0.0), (0.6, 0.0)) * 4), (-0.4, 0.0))
    plan = plan_dock(asked(path), guesses=[path], planner=Offers(path), time_budget=20.0)
    assert [attempt.stage for attempt in plan.tried[:3]] == ["given", "fewer cusps", "fewer cusps"]
    assert [attempt.stage for attempt in plan.tried].count("fewer cusps") == 2


def test_stop_within_a_gear_is_left_out_before_a_gear_is():
    path = driven((1.0, 0.8), (0.8, -0.8), (-0.4, 0.3), (0.0, 0.5), (1.5, 0.0), (0.5, 1.0))
    first, second, *rest = fewer_cusps(path, asked(path))
    assert [int(one.direction) for one in first.segments] == [1, -1, 0, 1, 1]
    assert [int(one.direction) for one in second.segments] == [1, 1, -1, 0, 1]
    for simpler in (first, second):
        assert simpler.start == path.start
        assert simpler.end == path.end
        assert simpler.length == pytest.approx(path.length, abs=1e-3)
        stations = np.linspace(0.0, path.length, 200)
        assert np.abs(simpler.poses_at(stations * simpler.length / path.length) - path.poses_at(stations)).max() < 2e-3
    assert all(len(simpler.segments) == 5 for simpler in rest)


def test_unnecessary_stop_is_left_out():
    """Both curvatures fit into one gear where there is room."""
    path = driven((1.5, 0.6), (1.5, -0.6))
    simpler = next(iter(fewer_cusps(path, asked(path))))
    assert len(simpler.segments) == 1
    plan = plan_dock(asked(path), guesses=[simpler], time_budget=10.0)
    assert len(plan.path.segments) == 1
