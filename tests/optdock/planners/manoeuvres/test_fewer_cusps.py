"""A gear less: ends and the other gears stay, the shortest goes first, and a plan gets cheaper by it."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

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


def test_shortest_gear_is_left_out_first():
    path = driven((1.0, 0.0), (-0.3, 0.2), (1.0, 0.0), (-0.02, 0.5), (2.0, 0.0))
    first, second = itertools.islice(fewer_cusps(path, asked(path)), 2)
    assert [segment.length for segment in first.segments] == pytest.approx([1.0, 0.3, 2.98], abs=0.03)
    assert [segment.length for segment in second.segments] == pytest.approx([1.7, 0.02, 2.0], abs=0.03)


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

    path = driven((1.0, 0.4), (-0.03, 0.4), (2.0, -0.2))

    def create_plan(self, start, goal, cancel_checker=None):
        return self.path


def test_plan_has_no_unnecessary_gear_of_centimetres():
    plan = plan_dock(asked(Offers.path), planner=Offers(), time_budget=20.0)
    offered, simpler = plan.tried
    assert simpler.stage == "fewer cusps"
    assert not plan.path.cusps
    assert plan.price == simpler.price < offered.price - 2.0


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
