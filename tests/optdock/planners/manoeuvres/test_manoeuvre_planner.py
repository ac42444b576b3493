"""Every guess is free, drivable and ends in the dock as it asks; and there is one where others give up."""

import dataclasses
import functools
import itertools
import math

import numpy as np
import pytest
import ruckig
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from optdock.errors import InvalidValue, LifecycleError, NoValidPathCouldBeFound, PlannerCancelled
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.constant_jerk import braking_time
from optdock.model.dock import Dock, DockDirection
from optdock.model.limits import MotionLimits
from optdock.model.path import Path
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.planners.manoeuvres import turns
from optdock.planners.manoeuvres.arcs import Arcs
from optdock.planners.manoeuvres.free_space import Effort, FreeSpace
from optdock.planners.manoeuvres.manoeuvre_planner import ManoeuvrePlanner, Stages, turning_radius
from optdock.planners.manoeuvres.price import CUSP_PRICE, gear_changes, least_price, least_prices
from optdock.plugins.interfaces import GlobalPlanner, PluginContext
from optdock.plugins.registry import timed_by
from optdock.verification import certify_path

LIMITS = MotionLimits(max_curvature=1.5, max_curvature_rate=6.0)
ROBOT = Robot(Footprint.rectangle(0.45, 0.45, 0.6), LIMITS)
CAR = Robot(Footprint.rectangle(3.7, 1.0, 2.0), MotionLimits(max_speed=2.0, max_reverse_speed=1.0, max_curvature=0.25))
CHARGER = Footprint(np.array([[0.455, -0.25], [0.595, -0.25], [0.595, 0.25], [0.455, 0.25]]))


def box(x0, y0, x1, y1):
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]], dtype=float)


def at_a_wall(start, **dock):
    station = Dock(Pose2(0.0, 0.0, 0.0), CHARGER, **{"direction": "forward", "final_straight": 0.3, **dock})
    return DockingProblem(start, station, ROBOT, [box(0.6, -6.0, 0.8, 6.0)])


def parallel_slot(start):
    walls = [
        box(-15.0, 0.0, -3.0, 5.0),
        box(3.0, 0.0, 15.0, 5.0),
        box(-3.0, 0.0, 3.0, 2.5),
        box(-15.0, 11.0, 15.0, 15.0),
    ]
    return DockingProblem(start, Dock(Pose2(-1.35, 4.0, 0.0)), CAR, walls, 0.05)


def behind_a_rack(start):
    return DockingProblem(start, Dock(Pose2(0.0, 0.0, 0.0)), ROBOT, [box(0.6, -3.0, 1.6, 3.0)], 0.05)


SCENES = {
    "before the dock": at_a_wall(Pose2(-2.0, 0.5, 0.3)),
    "beside the dock, the wrong way": at_a_wall(Pose2(-0.4, 2.0, math.pi)),
    "5 cm aside, close": at_a_wall(Pose2(-0.6, 0.05, 0.0)),
    "moving": dataclasses.replace(at_a_wall(Pose2(-3.0, 0.4, 0.0)), start_speed=-0.2),
    "backward": DockingProblem(Pose2(-2.0, 1.0, 0.0), Dock(Pose2(0.0, 0.0, 0.0), direction="backward"), ROBOT),
    "parallel slot": parallel_slot(Pose2(-6.0, 9.5, 0.0)),
    "around a rack": behind_a_rack(Pose2(3.0, 0.5, 0.0)),
}


def guesses(problem, **options):
    planner = ManoeuvrePlanner()
    planner.configure(PluginContext(name="manoeuvres", problem=problem))
    found = planner.create_plans(problem.start, problem.goal, **options)
    return (guess for guess in found if guess is not None)


@functools.cache
def first_guesses(name):
    """The first three of a scene."""
    return list(itertools.islice(guesses(SCENES[name]), 3))


@pytest.mark.parametrize("name", SCENES)
def test_guesses_violate_only_the_curvature_between_arcs(name):
    problem, found = SCENES[name], first_guesses(name)
    assert found
    for guess in found:
        broken = {violation.kind for violation in certify_path(guess.path, problem).violations}
        assert broken <= {"curvature_rate"}, guess
        assert guess.path.start == problem.start
        assert guess.path.end.gap_to(problem.goal) <= 1e-9


def test_scenes_need_every_stage():
    stages = {name: first_guesses(name)[0].stage for name in SCENES}
    assert stages["before the dock"] == "Reeds-Shepp"
    assert stages["parallel slot"] == "hybrid A*"
    assert stages["around a rack"] == "roadmap"


def test_guesses_are_different_ways():
    paths = [guess.path for guess in itertools.islice(guesses(SCENES["before the dock"]), 6)]
    shares = np.linspace(0.0, 1.0, 17)
    seen = [path.poses_at(shares * path.length)[:, :2] for path in paths]
    assert len(paths) == 6
    assert all(np.abs(a - b).max() > 0.2 for a, b in itertools.combinations(seen, 2))


def test_search_ends_when_no_later_guess_can_be_better():
    problem, best = SCENES["before the dock"], [math.inf]
    offered = []
    for guess in guesses(problem, better_than=lambda: best[0]):
        assert least_price(guess.path, problem) < best[0]
        offered.append(guess)
        best[0] = least_price(guess.path, problem) * 1.1
    assert len(offered) < 4 < len(list(itertools.islice(guesses(problem), 6)))
    assert list(guesses(problem, better_than=lambda: 0.0)) == []


def test_manoeuvre_with_stops_must_be_cheaper_by_the_time_that_plans_need_there():
    problem = SCENES["parallel slot"]
    first = first_guesses("parallel slot")[0].path
    price, stops = least_price(first, problem), len(first.cusps)
    assert stops > 0
    for spare, is_offered in ((0.1, False), (1.0, True)):
        most = price + stops * spare
        found = [guess.path.digest for guess in guesses(problem, better_than=lambda most=most: most)]
        assert (first.digest in found) is is_offered


def test_closed_room_is_refused_and_the_message_claims_no_proof():
    ring = [box(-1, -1, 1, -0.8), box(-1, 0.8, 1, 1), box(-1, -1, -0.8, 1), box(0.8, -1, 1, 1)]
    problem = DockingProblem(Pose2(3.0, 0.0, 0.0), Dock(Pose2(0.0, 0.0, 0.0)), ROBOT, ring, ClearanceRule(0.05, 0.0))
    with pytest.raises(NoValidPathCouldBeFound, match="there may still be one"):
        list(guesses(problem))


def test_message_names_the_gear_in_which_the_dock_can_be_entered():
    problem = at_a_wall(Pose2(-2.0, 0.5, 0.3), direction=DockDirection.BACKWARD)
    with pytest.raises(NoValidPathCouldBeFound, match=r"backward.*0\.00 m.*forward"):
        next(guesses(problem))
    both = at_a_wall(Pose2(-2.0, 0.5, 0.3), direction=DockDirection.AUTO)
    assert int(next(guesses(both)).path.segments[-1].direction) == 1


def test_search_is_cancelled():
    count = itertools.count()
    with pytest.raises(PlannerCancelled):
        list(guesses(SCENES["around a rack"], cancel_checker=lambda: next(count) == 40))


def test_planner_needs_a_problem_and_configuration():
    with pytest.raises(InvalidValue, match="needs a problem"):
        ManoeuvrePlanner().configure(PluginContext(footprint=ROBOT.footprint))
    with pytest.raises(LifecycleError):
        ManoeuvrePlanner().create_plan(Pose2(0.0, 0.0, 0.0), Pose2(1.0, 0.0, 0.0))


def test_create_plans_of_a_planner_with_one_path():
    class One(GlobalPlanner):
        def create_plan(self, start, goal, cancel_checker=None):
            return Path.from_poses([start, goal])

    (guess,) = One().create_plans(Pose2(0.0, 0.0, 0.0), Pose2(1.0, 0.0, 0.0))
    assert guess.path.length == pytest.approx(1.0)


def ruckig_duration(length, speed, limits):
    """Of a straight drive of one gear from `speed` to rest."""
    calculator, profile, drive = ruckig.Ruckig(1), ruckig.Trajectory(1), ruckig.InputParameter(1)
    drive.current_velocity, drive.target_position = [speed], [length]
    drive.max_velocity, drive.min_velocity = [limits.max_speed], [-1e-3]
    drive.max_acceleration, drive.min_acceleration = [limits.max_acceleration], [-limits.max_deceleration]
    drive.max_jerk = [limits.max_jerk]
    calculator.calculate(drive, profile)
    return profile.duration


@settings(max_examples=20)
@given(
    length=st.floats(0.001, 30.0),
    speed=st.floats(0.0, 1.0),
    limits=st.builds(
        MotionLimits,
        max_speed=st.floats(0.1, 2.0),
        max_acceleration=st.floats(0.1, 2.0),
        max_deceleration=st.floats(0.1, 2.0),
        max_jerk=st.floats(0.3, 20.0),
    ),
)
def test_least_price_of_one_gear_is_what_ruckig_needs(length, speed, limits):
    speed = min(speed, limits.max_speed)
    assume(length > 1.05 * speed * 0.5 * braking_time(speed, limits.max_deceleration, limits.max_jerk))
    problem = DockingProblem(
        Pose2(-length, 0.0, 0.0), Dock(Pose2(0.0, 0.0, 0.0)), Robot(ROBOT.footprint, limits), start_speed=speed
    )
    found = least_price(Path.from_poses([problem.start, problem.goal]), problem)
    assert found == pytest.approx(ruckig_duration(length, speed, limits), rel=1e-3, abs=1e-4)


def test_every_gear_has_its_price_and_every_cusp():
    problem = DockingProblem(Pose2(-3.0, 0.0, 0.0), Dock(Pose2(0.0, 0.0, 0.0)), ROBOT)
    lengths = np.array([[1.0, 0.5, -0.2, 0.0, -0.3, 2.0], [0.0, 3.0, 0.0, 1e-9, 0.0, 0.0]])
    gears = [[Pose2(x, 0.0, 0.0) for x in (0.0, 1.5, 1.0, 3.0)], [Pose2(x, 0.0, 0.0) for x in (0.0, 3.0)]]
    expected = [least_price(Path.from_poses(poses), problem) for poses in gears]
    assert least_prices(lengths, problem) == pytest.approx(expected)
    one, two, three = (least_prices(np.array([[length]]), problem)[0] for length in (1.5, -0.5, 2.0))
    assert expected[0] == pytest.approx(one + two + three + 2.0 * CUSP_PRICE)


def test_price_of_a_way_depends_on_no_other_even_of_one_that_leaves_no_room_to_brake():
    problem = DockingProblem(Pose2(-3.0, 0.0, 0.0), Dock(Pose2(0.0, 0.0, 0.0)), ROBOT, start_speed=0.4)
    ways = np.array([[3.0, 0.0, 0.0], [0.01, -0.1, 0.2], [1.0, -0.1, 0.3], [0.0002, 4.0, 0.0]])
    together, alone = least_prices(ways, problem), [least_prices(way[None], problem)[0] for way in ways]
    assert together == pytest.approx(alone, rel=1e-5)
    driven = least_prices(ways[1:2, 1:], dataclasses.replace(problem, start_speed=0.0))[0] + CUSP_PRICE
    assert driven < together[1] < driven + 3.0


@settings(max_examples=20)
@given(
    length=st.floats(0.01, 6.0),
    zone=st.tuples(st.floats(0.05, 0.7), st.floats(0.05, 1.0)),
    limits=st.builds(
        MotionLimits, max_speed=st.floats(0.1, 1.5), max_acceleration=st.floats(0.2, 1.5), max_jerk=st.floats(0.5, 10.0)
    ),
)
def test_no_motion_is_cheaper_than_its_least_price(length, zone, limits):
    """The dock's slow zone included, however short gear or zone are; 2 % where braking goes on in the zone."""
    dock = Dock(Pose2(0.0, 0.0, 0.0), approach_speed=zone[0], approach_distance=zone[1])
    problem = DockingProblem(Pose2(-length, 0.0, 0.0), dock, Robot(ROBOT.footprint, limits))
    path = Path.from_poses([problem.start, problem.goal])
    driven = timed_by("NearOptimal", path, problem).duration
    assert 0.5 * driven <= least_price(path, problem) <= 1.025 * driven + 1e-3


def test_gear_changes_ignore_zero_lengths():
    lengths = np.array([[1.0, 0.0, -1.0, 1e-9, -2.0], [0.0, -1.0, 2.0, -1.0, 0.0], [1.0, 1.0, 0.0, 0.0, 1.0]])
    assert gear_changes(lengths).tolist() == [1.0, 2.0, 0.0]


def test_turning_radius_stays_finite_where_nothing_bounds_the_curvature():
    free = dataclasses.replace(ROBOT, limits=MotionLimits())
    problem = dataclasses.replace(SCENES["before the dock"], robot=free)
    assert 0.0 < turning_radius(problem) < ROBOT.footprint.circumscribed_radius
    assert turning_radius(SCENES["before the dock"]) == pytest.approx(1.0 / 1.5)


def test_no_guesses_of_turns_without_a_free_line():
    """No place to turn at is not an error: it ended the search of robots that turn in place."""
    space = FreeSpace(at_a_wall(Pose2(-2.0, 0.5, 0.3)), lambda: None)
    none = np.zeros(0, dtype=np.int64)
    found = turns._allowed_turns(np.zeros((0, 3)), np.zeros(0), none, space, Effort(1.0, 0.0, 4, 100))
    assert found.shape == (0,)


def test_paths_have_enough_poses_per_arc_to_fit_curvatures():
    arcs = Arcs(np.zeros((1, 3)), np.array([[0.01, -0.02, 3.0]]), np.array([[1.0, 1.0, 0.0]]))
    path = arcs.path(0.5, arcs.joints()[0, -1], "map")
    assert [len(segment.poses) - 1 for segment in path.segments] == [8, 8, 8]


def test_plan_into_a_tight_dock_is_not_followed_by_a_search_along_routes(monkeypatch):
    """Routes are only tried while there is no plan, however expensive the plan is."""
    called = []
    monkeypatch.setattr(Stages, "_along_routes", lambda self: iter(called.append(1) or ()))
    problem = parallel_slot(Pose2(-10.0, 7.8, 0.0))
    for price, expected in ((math.inf, [1]), (1000.0, [])):
        called.clear()
        best = [math.inf]
        for guess in Stages(problem, 1.25, lambda: None, lambda best=best: best[0]).guesses():
            best[0] = price if guess is not None else best[0]
        assert called == expected
