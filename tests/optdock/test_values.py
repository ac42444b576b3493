"""The small frozen values: limits, dock, clearance rule, problem, obstacles."""

import math

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from optdock.dock import Dock, DockTolerances
from optdock.errors import InvalidValue
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.limits import MotionLimits, SpeedZone
from optdock.obstacles import ObstacleSet
from optdock.problem import ClearanceRule, DockingProblem
from optdock.robot import Robot


@pytest.mark.parametrize(
    ("name", "value", "rule"),
    [
        ("max_speed", 0.0, "> 0 m/s"),
        ("max_speed", math.inf, ".*finite"),
        ("max_jerk", -1.0, "> 0 m/s^3"),
        ("max_curvature", 0.0, "> 0 1/m"),
        ("max_curvature", math.nan, "> 0 1/m"),
        ("track_width", -0.1, ".*>= 0 m"),
    ],
)
def test_limits_name_the_bound_and_its_rule(name, value, rule):
    with pytest.raises(InvalidValue, match=f"limits.{name}: must be {rule}".replace("^", r"\^")):
        MotionLimits(**{name: value})


def test_unlimited_is_infinity():
    assert MotionLimits(max_curvature=math.inf).max_curvature == math.inf


@pytest.mark.parametrize(
    ("speed", "distance"), [(0.0, 1.0), (-1.0, 1.0), (math.nan, 1.0), (0.1, -1.0), (0.1, math.inf)]
)
def test_a_speed_zone_is_checked(speed, distance):
    with pytest.raises(InvalidValue, match="speed zone"):
        SpeedZone(speed, distance)


def test_a_dock_is_checked():
    with pytest.raises(InvalidValue, match="dock.final_straight"):
        Dock(Pose2(0, 0, 0), final_straight=-0.1)
    with pytest.raises(InvalidValue, match="dock.tolerances.yaw"):
        DockTolerances(yaw=0.0)


@pytest.mark.parametrize("values", [(-0.1, 0.0, 0.5), (0.05, 0.06, 0.5), (0.05, 0.0, math.nan)])
def test_a_clearance_rule_is_checked(values):
    with pytest.raises(InvalidValue, match="clearance"):
        ClearanceRule(*values)


def test_the_clearance_rule_of_the_format():
    rule = ClearanceRule(0.05, 0.01, 0.5)
    from_goal = np.array([0.0, 0.25, 0.5, 3.0])
    assert rule.required_at(from_goal, np.full(4, 9.0), 1.0) == pytest.approx([0.01, 0.03, 0.05, 0.05])
    assert rule.required_at(np.full(3, 9.0), np.array([0.0, 0.02, 9.0]), 0.02) == pytest.approx([0.02, 0.03, 0.05])
    assert ClearanceRule(0.05, 0.0, 0.0).required_at(np.array([0.0, 1e-9]), np.ones(2), 1.0) == pytest.approx([0, 0.05])


@given(st.floats(0.0, 3.0), st.floats(0.0, 3.0), st.floats(0.0, 3.0), st.floats(0.0, 3.0))
def test_the_requirement_never_falls_with_either_distance(a, b, c, d):
    rule = ClearanceRule(0.05, 0.0, 0.5)
    low = rule.required_at(np.array([min(a, b)]), np.array([min(c, d)]), 0.01)
    high = rule.required_at(np.array([max(a, b)]), np.array([max(c, d)]), 0.01)
    assert low[0] <= high[0]


def test_a_problem_adds_the_dock_to_its_obstacles():
    dock = Footprint(np.array([[0.5, -0.4], [0.7, -0.4], [0.7, 0.4], [0.5, 0.4]]))
    robot = Robot(Footprint.from_radius(0.3), MotionLimits())
    problem = DockingProblem(Pose2(0, 0, 0), Dock(Pose2(2.0, 1.0, math.pi / 2), dock), robot)
    assert len(problem.obstacles) == 0
    assert problem.all_obstacles.name_of(0) == "dock"
    assert np.allclose(problem.all_obstacles.lower[0], [1.6, 1.5])
    assert np.allclose(problem.all_obstacles.upper[0], [2.4, 1.7])
    with pytest.raises(InvalidValue, match="start.speed"):
        DockingProblem(Pose2(0, 0, 0), Dock(Pose2(1, 0, 0)), robot, start_speed=math.nan)


def test_obstacle_sets_join_keep_names_and_crop():
    first = ObstacleSet.from_polygons([[[0, 0], [1, 0], [0, 1]]], "shelf")
    second = ObstacleSet.from_rectangles(np.array([[5.0, 5.0]]), np.array([[6.0, 7.0]]), "map")
    both = first + second
    assert [both.name_of(i) for i in range(2)] == ["shelf[0]", "map"]
    assert len(both.in_box(np.array([4.0, 4.0]), np.array([9.0, 9.0]))) == 1
    assert both.in_box(np.array([4.0, 4.0]), np.array([9.0, 9.0])).name_of(0) == "map"
    assert len(ObstacleSet.empty() + both) == 2
    with pytest.raises(InvalidValue, match="upper > lower"):
        ObstacleSet.from_rectangles(np.array([[5.0, 5.0]]), np.array([[5.0, 7.0]]), "map")


@given(st.integers(0, 1000))
def test_box_distance_agrees_with_shapely(seed):
    rng = np.random.default_rng(seed)
    lower = rng.normal(size=(4, 2))
    obstacles = ObstacleSet.from_rectangles(lower, lower + rng.uniform(0.1, 1.0, (4, 2)), "map")
    points = rng.normal(size=(6, 2)) * 2.0
    truth = shapely.distance(shapely.points(points)[:, None], shapely.polygons(obstacles.vertices)[None])
    assert np.allclose(obstacles.box_distance(points), truth, atol=1e-12)
