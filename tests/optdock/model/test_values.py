"""Frozen values: limits, dock, clearance rule, problem, obstacles."""

import copy
import math
import pickle

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from optdock.errors import InvalidPath, InvalidValue
from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet, box_distance
from optdock.geometry.pose import Pose2
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.constant_jerk import TimeLaw
from optdock.model.costmap import Costmap
from optdock.model.dock import Dock, DockDirection, DockTolerances
from optdock.model.limits import MotionLimits, SpeedZone
from optdock.model.path import ClothoidSegment, Direction, Path, PolylineSegment, TurnSegment
from optdock.model.problem import DockingProblem
from optdock.model.robot import Drive, Robot
from optdock.model.trajectory import Trajectory


@pytest.mark.parametrize(
    ("name", "value", "rule"),
    [
        ("max_speed", 0.0, "> 0 m/s"),
        ("max_speed", math.inf, ".*finite"),
        ("max_jerk", -1.0, "> 0 m/s^3"),
        ("max_curvature", 0.0, "> 0 1/m"),
        ("max_curvature", math.nan, "> 0 1/m"),
        ("track_width", -0.1, ".*>= 0 m"),
        ("wheelbase", math.inf, ".*finite and >= 0 m"),
        ("max_steering_angle", 1.6, "> 0 and < pi / 2 rad"),
        ("max_steering_rate", 0.0, "> 0 rad/s"),
    ],
)
def test_limits_name_the_bound_and_its_rule(name, value, rule):
    with pytest.raises(InvalidValue, match=f"limits.{name}: must be {rule}".replace("^", r"\^")):
        MotionLimits(**{name: value})


@pytest.mark.parametrize(("name", "unit"), [("max_steering_angle", "rad"), ("max_steering_rate", "rad/s")])
def test_steering_limits_need_a_wheelbase(name, unit):
    with pytest.raises(InvalidValue, match=f"limits.{name}: 0.5 {unit} requires wheelbase > 0 m"):
        MotionLimits(**{name: 0.5})
    limits = MotionLimits(wheelbase=2.8, **{name: 0.5})
    Robot(Footprint.from_radius(0.3), limits, Drive.ACKERMANN)
    with pytest.raises(InvalidValue, match=f"robot.limits.{name}: 0.5 {unit} is for drive: ackermann"):
        Robot(Footprint.from_radius(0.3), limits)


def test_the_steering_angle_bounds_the_curvature():
    steered = {"wheelbase": 2.8, "max_steering_angle": 0.75}
    tightest = math.tan(0.75) / 2.8
    assert MotionLimits(**steered).max_curvature == pytest.approx(tightest)
    assert MotionLimits(max_curvature=0.2, **steered).max_curvature == 0.2
    assert MotionLimits(**steered).steering_angle(np.array(tightest)) == pytest.approx(0.75)


def test_digests_without_steering_limits_are_unchanged():
    """These digests are older than the steering limits, and plan files must stay valid."""
    box = Footprint.rectangle(0.4, 0.4, 0.6)
    assert Robot(box, MotionLimits(max_curvature=2.0)).fingerprint.limits == "a715eb726bf84520"
    turning = MotionLimits(max_yaw_rate=1.0, track_width=0.3)
    assert Robot(box, turning, Drive.ACKERMANN).fingerprint.limits == "d41a009c2195fe0b"
    seen = {Robot(box, limits, Drive.ACKERMANN).fingerprint.limits for limits in STEERED}
    assert len(seen) == len(STEERED)


STEERED = [
    MotionLimits(max_curvature=0.3),
    MotionLimits(max_curvature=0.3, wheelbase=2.8),
    MotionLimits(max_curvature=0.3, wheelbase=2.8, max_steering_rate=0.5),
    MotionLimits(max_curvature=0.3, wheelbase=2.8, max_steering_rate=0.6),
    MotionLimits(max_curvature=0.3, wheelbase=2.8, max_steering_angle=1.2),
]


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


@settings(max_examples=40)
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


@settings(max_examples=40)
@given(st.integers(0, 1000))
def test_box_distance_agrees_with_shapely(seed):
    rng = np.random.default_rng(seed)
    lower = rng.normal(size=(4, 2))
    obstacles = ObstacleSet.from_rectangles(lower, lower + rng.uniform(0.1, 1.0, (4, 2)), "map")
    points = rng.normal(size=(6, 2)) * 2.0
    truth = shapely.distance(shapely.points(points)[:, None], shapely.polygons(obstacles.vertices)[None])
    assert np.allclose(box_distance(obstacles, points), truth, atol=1e-12)


POSE = Pose2(0.0, 0.0, 0.0)
SQUARE = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]
POSES = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.1, 0.1]]


def test_a_copied_problem_keeps_its_fingerprint():
    problem = DockingProblem(POSE, Dock(POSE), Robot(Footprint(SQUARE), MotionLimits()))
    assert copy.deepcopy(problem) is problem
    restored = pickle.loads(pickle.dumps(problem))
    assert restored is not problem
    assert restored.fingerprint == problem.fingerprint


@pytest.mark.parametrize(
    ("made", "message"),
    [
        (
            lambda: Dock(POSE, direction="reverse"),
            "dock.direction: must be one of forward, backward, auto, got 'reverse'",
        ),
        (lambda: Dock(POSE, direction="BACKWARD"), "dock.direction"),
        (lambda: Dock(POSE, direction=None), "dock.direction"),
        (lambda: Dock([0.0, 0.0, 0.0]), "dock.pose: must be a Pose2"),
        (lambda: Dock(POSE, footprint=SQUARE), "dock.footprint: must be a Footprint"),
        (lambda: Dock(POSE, final_straight="0.3"), "dock.final_straight: must be a number"),
        (lambda: Dock(POSE, final_straight=True), "dock.final_straight: must be a number"),
        (lambda: Dock(POSE, approach_speed=0.0), "approach_speed must be > 0 m/s"),
        (lambda: Dock(POSE, approach_distance="0.3"), "approach_distance: must be a number"),
        (lambda: Dock(POSE, tolerances=0.1), "dock.tolerances: must be a DockTolerances"),
        (lambda: DockTolerances(along="1"), "dock.tolerances.along: must be a number"),
        (lambda: Robot(SQUARE, MotionLimits()), "robot.footprint: must be a Footprint"),
        (lambda: Robot(Footprint(SQUARE), {}), "robot.limits: must be a MotionLimits"),
        (
            lambda: Robot(Footprint(SQUARE), MotionLimits(), "tank"),
            "robot.drive: must be one of differential, ackermann",
        ),
        (lambda: MotionLimits(max_speed="1.0"), "limits.max_speed: must be a number"),
        (lambda: MotionLimits(max_curvature=True), "limits.max_curvature: must be a number"),
        (lambda: SpeedZone("0.1", 1.0), "approach_speed: must be a number"),
        (lambda: SpeedZone(0.1, None), "approach_distance: must be a number"),
        (lambda: ClearanceRule(True, 0.0, 0.5), "clearance.required: must be a number"),
        (lambda: ClearanceRule("0.05"), "clearance.required: must be a number"),
        (lambda: PolylineSegment(POSES, 5), "direction: must be one of 1, -1, 0, got 5"),
        (lambda: PolylineSegment(POSES, True), "direction: must be one of 1, -1, 0, got True"),
        (lambda: PolylineSegment(POSES, "reverse"), "direction: must be one of 1, -1, 0"),
        (lambda: PolylineSegment([["0", "0", "0"], ["1", "0", "0"]]), "path: must be numbers"),
        (lambda: PolylineSegment([[0.0, 0.0, 0.0], [2e8, 0.0, 0.0]]), "path: coordinates must be within"),
        (lambda: PolylineSegment([[0.0, 0.0, 1e14], [1.0, 0.0, 1e14]]), "path: yaws must be within"),
        (
            lambda: ClothoidSpline(Elsewhere(0.0, 0.0, 0.0), [0.0, 1.0], [0.0, 0.0]),
            "clothoid.start: must be a Pose2, got Elsewhere",
        ),
        (lambda: TurnSegment(Elsewhere(0.0, 0.0, 0.0), 1.0), "a turn's pose: must be a Pose2, got Elsewhere"),
        (lambda: ClothoidSegment(None), "spline: must be a ClothoidSpline"),
        (lambda: ClothoidSegment(Hop(POSE, [0.0, 1.0], [0.0, 0.0])), "must be a ClothoidSpline, got Hop"),
        (lambda: TimeLaw([True], [1.0]), "time law.durations: must be numbers"),
        (lambda: TimeLaw([1.0], [1.0], start_speed="0"), "time law.start_speed: must be a number"),
        (lambda: Trajectory(POSES, TimeLaw([1.0], [1.0])), "trajectory.path: must be a Path"),
        (lambda: ObstacleSet(np.zeros((1, 4)), ("a",), np.zeros(1)), "obstacles: need vertices of shape"),
        (lambda: ObstacleSet(np.full((1, 3, 2), np.nan), ("a",), np.zeros(1)), "obstacles.vertices: must be finite"),
        (lambda: ObstacleSet(np.array([SQUARE]), ("a",), np.ones(1)), "obstacles.group: must be in"),
        (lambda: Costmap(np.zeros((2, 2), dtype=int), "0.1"), "costmap.resolution: must be a number"),
        (lambda: Costmap(np.zeros((2, 2), dtype=int), 0.1, ("0", "0")), "costmap.origin: must be a number"),
    ],
)
def test_arguments_of_other_types_are_rejected(made, message):
    with pytest.raises(InvalidValue, match=message):
        made()


def test_exact_words_become_members():
    assert Dock(POSE, direction="backward").direction is DockDirection.BACKWARD
    assert Robot(Footprint(SQUARE), MotionLimits(), "ackermann").drive is Drive.ACKERMANN
    assert PolylineSegment(POSES, -1).direction is Direction.REVERSE


class Elsewhere(Pose2):
    """Overrides the attributes of a pose."""

    def __getattribute__(self, name):
        return 5.0 if name == "y" else super().__getattribute__(name)


class Hop(ClothoidSpline):
    """Overrides the poses of a clothoid spline."""

    def poses_at(self, s):
        return super().poses_at(s) + 1.0


class Detour(PolylineSegment):
    """Overrides the poses of a polyline."""

    def poses_at(self, s):
        return super().poses_at(s) + 1.0


@pytest.mark.parametrize("segment", [object(), ClothoidSpline(POSE, [0.0, 1.0], [0.0, 0.0]), Detour(POSES)])
def test_a_path_rejects_other_segment_classes(segment):
    with pytest.raises(InvalidPath, match="path: segment 1 must be a ClothoidSegment, a PolylineSegment or a"):
        Path((PolylineSegment(POSES), segment))


def test_a_frame_name_is_reduced_to_a_plain_string():
    class Any(str):
        def __eq__(self, other):
            return True

        __hash__ = str.__hash__

    assert Path((PolylineSegment(POSES),), Any("map")).frame != "odom"


@pytest.mark.parametrize("poses", [[[0.0, 0.0, 0.0], [3e8, 0.0, 0.0]], [[0.0, 0.0, 2e6], [1.0, 0.0, 2e6]]])
def test_poses_out_of_range_make_no_path(poses):
    with pytest.raises(InvalidPath, match="path: (coordinates|yaws) must be within"):
        Path.from_poses(np.array(poses))


def test_a_trajectory_rejects_subclasses_of_path_and_time_law():
    class Elsewhere(Path):
        def poses_at(self, s):
            return super().poses_at(s) + 1.0

    class Sooner(TimeLaw):
        def at(self, t):
            return super().at(2.0 * np.asarray(t))

    path, law = Path.from_poses([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), TimeLaw([1.0], [1.0])
    Trajectory(path, law)
    for wrong in ((Elsewhere(path.segments), law), (path, Sooner([1.0], [1.0]))):
        with pytest.raises(InvalidValue, match="must be a"):
            Trajectory(*wrong)
