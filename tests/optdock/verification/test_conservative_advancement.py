"""The proof of clearance: thin posts, corners, cusps, turns in place, long steps, contact."""

import functools
import itertools
import tracemalloc

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from optdock.deadline import never_late
from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.polygon import is_convex
from optdock.geometry.pose import Pose2, transform_points
from optdock.kernels import using_kernels
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.path import ClothoidSegment, Direction, Path, PolylineSegment
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.verification import (
    certify_path,
    clearance_rounds,
    conservative_advancement,
    pose_clearance,
    stretch_bounds,
)
from optdock.verification.clearance_rounds import Rule, World
from optdock.verification.conservative_advancement import _Subdivision
from optdock.verification.motion_bounds import PathMotion
from optdock.verification.proximity import bounded_footprint
from optdock.verification.stretch_bounds import AdvanceBounds, Advances, advance_bounds

ROBOT = Robot(Footprint.rectangle(0.45, 0.45, 0.6), MotionLimits())
REQUIRED = 0.05


def problem_for(path, obstacles, robot=ROBOT, clearance=None):
    rule = clearance or ClearanceRule(REQUIRED, REQUIRED, 0.0)
    return DockingProblem(path.start, Dock(path.end), robot, obstacles, rule)


def clothoid(knots, curvature, start=None, sign=1):
    return Path((ClothoidSegment(ClothoidSpline(start or Pose2(0.0, 0.0, 0.0), knots, curvature, sign)),))


def square(x, y, half=0.001):
    return [[x - half, y - half], [x + half, y - half], [x + half, y + half], [x - half, y + half]]


def squares(centres, half=0.001):
    """Many squares at once."""
    centres = np.array(centres)
    return ObstacleSet.from_rectangles(centres - half, centres + half, "obstacles")


def dense_clearance(path, obstacles, footprint, step=0.001):
    """Return the smallest clearance at poses `step` apart, by shapely."""
    world = shapely.union_all(shapely.polygons(obstacles.vertices))
    s = np.linspace(0.0, path.length, int(path.length / step) + 2)
    outlines = shapely.polygons(transform_points(path.poses_at(s), footprint.vertices))
    return float(np.min(shapely.distance(outlines, world)))


def kinds(certificate):
    return {violation.kind for violation in certificate.violations}


@pytest.mark.parametrize("x", np.linspace(0.2, 2.8, 7))
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_thin_post_beside_a_straight_run_is_found_2_mm_inside_and_passed_2_mm_outside(x, side):
    path = clothoid([0.0, 3.0], [0.0, 0.0])
    for shift, certified in ((-0.002, False), (0.002, True)):
        y = side * (0.3 + REQUIRED + shift + 0.001)
        certificate = certify_path(path, problem_for(path, ObstacleSet.from_polygons([square(x, y)])))
        # Beside a post at its start the robot may keep what it has, by the weaker rule.
        assert (certificate.certified and certificate.start_relief == 0.0) is certified
        assert certificate.min_clearance == pytest.approx(REQUIRED + shift, abs=1e-3)


@pytest.mark.parametrize("gap", [0.002, 0.01, 0.03])
def test_the_reported_requirement_is_that_of_the_reported_place(gap):
    path, rule = clothoid([0.0, 3.0], [0.0, 0.0]), ClearanceRule(0.05, 0.0, 0.5)
    ahead = ObstacleSet.from_polygons([square(3.45 + gap + 0.001, 0.0)])
    certificate = certify_path(path, problem_for(path, ahead, clearance=rule))
    assert certificate.certified
    assert certificate.required_clearance == pytest.approx(0.05 * (3.0 - certificate.at_s) / 0.5, abs=1e-12)


def curved_path():
    return clothoid([0.0, 1.0, 2.5, 4.0], [0.0, 1.2, -1.4, 0.3])


@functools.cache
def swept_area(digest):
    path = SWEPT[digest]
    s = np.linspace(0.0, path.length, int(path.length / 0.002) + 2)
    return shapely.union_all(shapely.polygons(transform_points(path.poses_at(s), ROBOT.footprint.vertices)))


SWEPT = {}


def beside(path, s, gap, side):
    """Return a post at the distance `gap` from the swept area, near s on one side, by bisection."""
    area = swept_area(SWEPT.setdefault(path.digest, path).digest)
    x, y, yaw = path.poses_at([s])[0]
    normal = side * np.array([-np.sin(yaw), np.cos(yaw)])
    low, high = 0.0, 1.2
    for _ in range(25):
        middle = 0.5 * (low + high)
        if area.distance(shapely.Polygon(square(*(np.array([x, y]) + middle * normal)))) < gap:
            low = middle
        else:
            high = middle
    return ObstacleSet.from_polygons([square(*(np.array([x, y]) + high * normal))])


@pytest.mark.parametrize(("s", "side"), list(itertools.product([0.8, 1.7, 3.3], [1, -1])))
def test_a_thin_post_beside_a_curve_is_found_2_mm_inside_and_passed_2_mm_outside(s, side):
    path = curved_path()
    near = certify_path(path, problem_for(path, beside(path, s, REQUIRED - 0.002, side)))
    far = certify_path(path, problem_for(path, beside(path, s, REQUIRED + 0.002, side)))
    assert kinds(near) == {"clearance"}
    assert far.certified
    assert far.min_clearance == pytest.approx(REQUIRED + 0.002, abs=1.2e-3)


def test_the_violation_names_a_pose_that_shows_it():
    path = curved_path()
    obstacles = beside(path, 1.7, REQUIRED - 0.01, 1)
    problem = problem_for(path, obstacles)
    violation = certify_path(path, problem).violations[0]
    clearance, _ = pose_clearance(Pose2.from_sequence(violation.where["pose"]), ROBOT.footprint, obstacles)
    assert clearance == pytest.approx(violation.where["clearance"], abs=1e-12)
    assert clearance < REQUIRED
    assert violation.where["obstacle"] == "obstacles[0]"


def test_the_violating_pose_of_a_turn_in_place_shows_it():
    path = Path.from_poses(np.array([[-1.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, np.pi / 2]]))
    corner = (np.hypot(0.45, 0.3) + 0.01) * np.array([np.cos(1.0), np.sin(1.0)])
    obstacles = ObstacleSet.from_polygons([square(*corner)])
    violation = certify_path(path, problem_for(path, obstacles)).violations[0]
    clearance, _ = pose_clearance(Pose2.from_sequence(violation.where["pose"]), ROBOT.footprint, obstacles)
    assert violation.s == pytest.approx(1.0)
    assert clearance == pytest.approx(violation.where["clearance"], abs=1e-12)


def test_unproven_cells_still_bound_the_clearance(monkeypatch):
    path = curved_path()
    obstacles = beside(path, 1.7, REQUIRED + 0.0001, 1)
    monkeypatch.setattr("optdock.verification.conservative_advancement._MAX_LEVELS", 0)
    certificate = certify_path(path, problem_for(path, obstacles))
    assert kinds(certificate) == {"unproven"}
    assert certificate.min_clearance < REQUIRED
    assert certificate.margin == pytest.approx(-certificate.violations[0].amount)
    assert certificate.nearest == "obstacles[0]"


def test_a_proof_without_poses_left_for_sharpness_is_valid(monkeypatch):
    monkeypatch.setattr("optdock.verification.conservative_advancement._MAX_POSES", 0)
    path = curved_path()
    certificate = certify_path(path, problem_for(path, beside(path, 1.7, REQUIRED + 0.03, 1)))
    assert certificate.certified
    assert REQUIRED < certificate.min_clearance < REQUIRED + 0.03


def late_after(rounds):
    """Return a deadline that passes after this number of polls."""
    looks = itertools.count(1)
    return lambda: next(looks) > rounds


def test_a_late_certificate_is_certified_only_if_everything_is_proven():
    path = curved_path()
    tight = problem_for(path, beside(path, 1.7, REQUIRED + 0.0001, 1))
    late = certify_path(path, tight, is_late=late_after(0))
    assert kinds(late) == {"unproven"}
    assert certify_path(path, tight).certified
    roomy = problem_for(path, beside(path, 1.7, REQUIRED + 0.03, 1))
    unsharp, sharp = certify_path(path, roomy, is_late=late_after(0)), certify_path(path, roomy)
    assert unsharp.certified
    assert REQUIRED < unsharp.min_clearance < sharp.min_clearance - 0.001


def test_more_time_proves_more():
    path = curved_path()
    problem = problem_for(path, beside(path, 1.7, REQUIRED + 0.0001, 1))
    margins = [
        certify_path(Path(path.segments), problem, is_late=late_after(rounds)).margin  # nothing is kept of it
        for rounds in range(8)
    ]
    assert margins == sorted(margins)
    assert margins[0] < -1e-6 < margins[-1]


@pytest.mark.parametrize("rounds", range(4))
def test_a_deadline_never_hides_a_violation(rounds):
    path = curved_path()
    for amount in (1e-5, 1e-3, 0.03):
        problem = problem_for(path, beside(path, 1.7, REQUIRED - amount, 1))
        assert not certify_path(path, problem, is_late=late_after(rounds)).certified


@settings(max_examples=25)
@given(st.integers(0, 10_000))
def test_proven_clearance_never_exceeds_the_dense_truth(seed):
    rng = np.random.default_rng(seed)
    knots = np.concatenate(([0.0], np.cumsum(rng.uniform(0.2, 0.8, 4))))
    path = clothoid(knots, rng.uniform(-2.0, 2.0, 5), sign=int(rng.choice([-1, 1])))
    polygons = [rng.normal(size=2) * 1.2 + 0.3 * _convex(rng) for _ in range(4)]
    obstacles = ObstacleSet.from_polygons(polygons)
    truth = dense_clearance(path, obstacles, ROBOT.footprint, 0.004)
    certificate = certify_path(path, problem_for(path, obstacles, clearance=ClearanceRule(0.02, 0.02, 0.0)))
    if truth <= 0.0:
        assert not certificate.certified
    elif certificate.certified:
        assert certificate.min_clearance <= truth + 1e-9
        assert certificate.min_clearance >= truth - 0.0015


def _convex(rng):
    angles = np.sort(rng.uniform(0.0, 2.0 * np.pi, 6))
    return np.column_stack((np.cos(angles), np.sin(angles)))


def test_driving_along_a_wall_at_exactly_the_required_distance_is_proven():
    path = clothoid([0.0, 5.0], [0.0, 0.0])
    wall = ObstacleSet.from_polygons([[[-2.0, 0.3 + REQUIRED], [9.0, 0.3 + REQUIRED], [9.0, 1.0], [-2.0, 1.0]]])
    certificate = certify_path(path, problem_for(path, wall))
    assert certificate.certified
    assert certificate.min_clearance == pytest.approx(REQUIRED, abs=1e-9)
    assert certificate.poses_checked < 100


def test_a_wall_one_micron_and_a_bit_too_close_is_refused():
    path = clothoid([0.0, 5.0], [0.0, 0.0])
    edge = 0.3 + REQUIRED - 2.0e-6
    wall = ObstacleSet.from_polygons([[[-2.0, edge], [9.0, edge], [9.0, 1.0], [-2.0, 1.0]]])
    assert kinds(certify_path(path, problem_for(path, wall))) == {"clearance"}


def test_a_long_step_of_a_polyline_hides_no_post():
    path = Path.from_poses(np.array([[0.0, 0.0, 0.0], [5.0, 0.0, 0.0]]))
    for y, certified in ((0.349, False), (0.3521, True)):
        certificate = certify_path(path, problem_for(path, ObstacleSet.from_polygons([square(2.345, y)])))
        assert certificate.certified is certified


def test_a_post_at_the_far_end_of_a_long_last_step_is_found_among_nearer_obstacles():
    beside_the_start = square(0.0, 0.8)
    for poses in ([[0.0, 0.0, 0.0], [5.0, 0.0, 0.0]], [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [-5.0, 0.0, 0.0]]):
        path = Path.from_poses(np.array(poses))
        in_the_way = square(0.9 * poses[-1][0], 0.0)
        certificate = certify_path(path, problem_for(path, ObstacleSet.from_polygons([beside_the_start, in_the_way])))
        assert kinds(certificate) == {"clearance"}


def test_a_post_swept_only_by_the_corner_in_an_in_place_turn_is_found():
    path = Path.from_poses(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, np.pi / 2]]))
    corner = np.hypot(0.45, 0.3)
    direction = np.array([np.cos(1.0), np.sin(1.0)])
    for radius, certified in ((corner + REQUIRED - 0.002, False), (corner + REQUIRED + 0.005, True)):
        obstacles = ObstacleSet.from_polygons([square(*(radius * direction))])
        assert ("clearance" in kinds(certify_path(path, problem_for(path, obstacles)))) is not certified


def test_a_post_swept_by_the_tail_between_two_gears_is_found():
    first = ClothoidSpline(Pose2(0.0, 0.0, 0.0), [0.0, 1.5], [1.0, 1.0])
    second = ClothoidSpline(first.end, [0.0, 1.0], [-1.0, -1.0], -1)
    path = Path((ClothoidSegment(first), ClothoidSegment(second)))
    for gap, certified in ((REQUIRED - 0.002, False), (REQUIRED + 0.002, True)):
        obstacles = beside(path, 1.9, gap, -1)
        assert certify_path(path, problem_for(path, obstacles)).certified is certified


def test_contact_is_allowed_only_where_zero_is_required():
    path = clothoid([0.0, 2.0], [0.0, 0.0])
    dock = Footprint(np.array([[0.45, -0.4], [0.6, -0.4], [0.6, 0.4], [0.45, 0.4]]))
    for at_dock, certified in ((0.0, True), (0.001, False)):
        problem = DockingProblem(
            path.start, Dock(path.end, dock), ROBOT, clearance=ClearanceRule(REQUIRED, at_dock, 0.5)
        )
        certificate = certify_path(path, problem)
        assert certificate.certified is certified
        assert certificate.nearest == "dock"


def test_driving_one_millimetre_into_the_dock_is_refused():
    path = clothoid([0.0, 2.0], [0.0, 0.0])
    dock = Footprint(np.array([[0.449, -0.4], [0.6, -0.4], [0.6, 0.4], [0.449, 0.4]]))
    problem = DockingProblem(path.start, Dock(path.end, dock), ROBOT, clearance=ClearanceRule(REQUIRED, 0.0, 0.5))
    assert kinds(certify_path(path, problem)) == {"clearance"}


def test_a_start_beside_a_wall_may_leave_it_at_the_stated_slope_but_not_slower():
    wall = ObstacleSet.from_polygons([[[-2.0, 0.31], [9.0, 0.31], [9.0, 1.0], [-2.0, 1.0]]])
    along = clothoid([0.0, 2.0], [0.0, 0.0])
    assert kinds(certify_path(along, problem_for(along, wall))) == {"clearance"}
    behind = ObstacleSet.from_polygons([[[-2.0, -1.0], [-0.46, -1.0], [-0.46, 1.0], [-2.0, 1.0]]])
    assert certify_path(along, problem_for(along, behind)).certified


def peak_memory(call):
    tracemalloc.start()
    try:
        result = call()
        return result, tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_a_path_of_any_length_fits_into_memory():
    path = clothoid([0.0, 9e7], [0.0, 0.0])
    for y, expected in ((0.7, set()), (0.2, {"clearance"})):
        posts = ObstacleSet.from_polygons([square(1e6 + 0.3, y, 0.1), square(10.0, 5.0)])
        certificate, memory = peak_memory(lambda posts=posts: certify_path(path, problem_for(path, posts)))
        assert kinds(certificate) == expected
        assert memory < 200e6


def test_many_samples_beside_many_obstacles_fit_into_memory():
    s = np.linspace(0.0, 200.0, 30_000)
    path = Path((PolylineSegment(np.column_stack((s, 0.0 * s, 0.0 * s))),))
    posts = squares([(x, 0.7) for x in np.linspace(1.0, 199.0, 100)], 0.1)
    certificate, memory = peak_memory(lambda: certify_path(path, problem_for(path, posts)))
    assert certificate.certified
    assert certificate.min_clearance == pytest.approx(0.3, abs=1e-3)
    assert memory < 80e6


def test_many_samples_in_collision_fit_into_memory():
    s = np.linspace(0.0, 20.0, 10_000)
    path = Path((PolylineSegment(np.column_stack((s, 0.0 * s, 0.0 * s))),))
    wall = ObstacleSet.from_polygons([[[-9.0, 0.2], [40.0, 0.2], [40.0, 0.6], [-9.0, 0.6]]])
    certificate, memory = peak_memory(lambda: certify_path(path, problem_for(path, wall)))
    assert kinds(certificate) == {"clearance"}
    assert memory < 100e6


def test_outlines_of_many_corners_fit_into_memory():
    angle = 2.0 * np.pi * np.arange(200) / 200
    circle = np.column_stack((np.cos(angle), np.sin(angle)))
    robot = Robot(Footprint(0.4 * circle), MotionLimits())
    path = clothoid([0.0, 6.0], [1.0, 1.0])
    discs = ObstacleSet.from_polygons([0.4 * circle + [0.0, 1.0], 0.3 * circle + [3.0, 1.0]])
    problem = problem_for(path, discs, robot, ClearanceRule(0.19, 0.19, 0.0))
    certificate, memory = peak_memory(lambda: certify_path(path, problem))
    assert certificate.certified
    assert certificate.min_clearance == pytest.approx(0.2, abs=1e-3)
    assert memory < 200e6


def test_a_path_of_more_poses_than_refinement_may_add_can_still_be_proven(monkeypatch):
    monkeypatch.setattr("optdock.verification.conservative_advancement._MAX_POSES", 60)
    path = curved_path()
    obstacles = beside(path, 1.7, REQUIRED + 0.0001, 1)
    fine = Path((PolylineSegment(path.sample(0.005).poses),))
    for one in (path, fine):
        assert certify_path(one, problem_for(one, obstacles)).certified


def test_an_obstacle_wholly_inside_the_footprint_is_a_collision():
    path = clothoid([0.0, 1.0], [0.0, 0.0])
    certificate = certify_path(path, problem_for(path, ObstacleSet.from_polygons([square(0.9, 0.0)])))
    assert kinds(certificate) == {"clearance"}
    assert certificate.min_clearance < -0.2


def test_a_footprint_wholly_inside_an_obstacle_is_a_collision():
    path = clothoid([0.0, 1.0], [0.0, 0.0])
    obstacles = ObstacleSet.from_polygons([square(0.5, 0.0, 50.0)])
    assert kinds(certify_path(path, problem_for(path, obstacles))) == {"clearance"}


def test_a_non_convex_footprint_may_straddle_a_post_that_its_hull_would_hit():
    fork = Footprint(
        np.array(
            [[0.4, 0.3], [-0.4, 0.3], [-0.4, -0.3], [0.4, -0.3], [0.4, -0.2], [-0.2, -0.2], [-0.2, 0.2], [0.4, 0.2]]
        )
    )
    path = clothoid([0.0, 0.3], [0.0, 0.0])
    robot = Robot(fork, MotionLimits())
    post = ObstacleSet.from_polygons([square(0.5, 0.0)])
    certificate = certify_path(path, problem_for(path, post, robot))
    assert certificate.certified
    assert certificate.min_clearance == pytest.approx(0.199, abs=1e-3)
    hull = Robot(Footprint.rectangle(0.4, 0.4, 0.6), MotionLimits())
    assert kinds(certify_path(path, problem_for(path, post, hull))) == {"clearance"}


def test_a_post_of_a_micrometre_does_not_slip_through_the_seam_of_two_pieces():
    dart = Footprint(np.array([[0.4, 0.0], [-0.4, 0.3], [-0.2, 0.0], [-0.4, -0.3]]))
    robot, path = Robot(dart, MotionLimits()), clothoid([0.0, 1.0], [0.0, 0.0])
    touching_allowed = ClearanceRule(0.0, 0.0, 0.0)
    on_the_seam = ObstacleSet.from_polygons([square(0.8, 0.0, 0.5e-6)])
    certificate = certify_path(path, problem_for(path, on_the_seam, robot, touching_allowed))
    assert kinds(certificate) == {"clearance"}
    clearance, _ = pose_clearance(Pose2(0.8, 0.0, 0.0), dart, on_the_seam)
    assert clearance < -2e-6
    beside = ObstacleSet.from_polygons([square(0.8, 0.301, 0.5e-6)])
    assert certify_path(path, problem_for(path, beside, robot, touching_allowed)).certified


@settings(max_examples=25)
@given(st.integers(0, 10_000))
def test_pieces_cover_exactly_the_footprint(seed):
    rng = np.random.default_rng(seed)
    angle = np.sort(rng.uniform(0.0, 2.0 * np.pi, 9))
    radius = rng.uniform(0.2, 1.0, 9)
    star = shapely.Polygon(np.column_stack((radius * np.cos(angle), radius * np.sin(angle))))
    if np.max(np.diff(angle, append=angle[0] + 2.0 * np.pi)) > 3.0 or np.min(np.diff(angle)) < 1e-3:
        return
    bodies = Footprint(np.array(star.exterior.coords)[:-1]).bodies
    assert all(is_convex(body.vertices) for body in bodies)
    shapes = [shapely.Polygon(body.vertices) for body in bodies]
    # One by one: a union of shapes that share edges but for rounding is more than the other library can do.
    assert all(shapely.difference(shape, star).area < 1e-9 for shape in shapes)
    assert sum(shape.area for shape in shapes) == pytest.approx(star.area, rel=1e-9)


def test_without_obstacles_the_clearance_is_infinite():
    path = clothoid([0.0, 1.0], [0.0, 0.0])
    certificate = certify_path(path, problem_for(path, ObstacleSet.empty()))
    assert certificate.certified
    assert certificate.min_clearance == np.inf


def test_far_obstacles_are_reported_with_their_true_distance():
    path = clothoid([0.0, 1.0], [0.0, 0.0])
    certificate = certify_path(path, problem_for(path, ObstacleSet.from_polygons([square(30.0, 0.0, 0.5)])))
    assert certificate.min_clearance == pytest.approx(30.0 - 0.5 - 1.0 - 0.45, abs=1e-9)


@settings(max_examples=10)
@given(st.integers(0, 10_000))
def test_only_obstacles_that_can_be_the_nearest_are_evaluated(seed):
    """The proof equals that among the near obstacles alone, and agrees with dense sampling."""
    rng = np.random.default_rng(seed)
    path = clothoid(np.linspace(0.0, 4.0, 5), rng.uniform(-1.0, 1.0, 5))
    angles, apart = rng.uniform(0.0, 2.0 * np.pi, 30), rng.uniform(8.0, 12.0, 30)
    near = squares(np.column_stack((apart * np.cos(angles), apart * np.sin(angles))), 0.5)
    far = squares([(300.0 + 2.0 * i, 40.0) for i in range(100)], 0.5)
    among_all, alone = (certify_path(path, problem_for(path, obstacles)) for obstacles in (near + far, near))
    assert among_all.min_clearance == alone.min_clearance > 1.0
    assert among_all.margin == alone.margin
    truth = dense_clearance(path, near, ROBOT.footprint, 0.01)
    assert truth - 0.0015 <= among_all.min_clearance <= truth + 1e-9


@pytest.mark.parametrize("start", [Pose2(0.0, 60.0, 0.0), Pose2(12.0, 0.0, 0.0), Pose2(-40.0, -40.0, 2.0)])
def test_a_path_with_another_start_is_rejected_with_its_own_clearance(start):
    """The clearance at the start of the problem is no clearance of the path."""
    path, obstacles = clothoid([0.0, 1.0], [0.0, 0.0]), ObstacleSet.from_polygons([square(12.0, 0.0, 0.5)])
    problem = DockingProblem(start, Dock(path.end), ROBOT, obstacles, ClearanceRule(0.0))
    certificate = certify_path(path, problem)
    assert not certificate.certified
    assert "start" in kinds(certificate)
    assert certificate.min_clearance <= 12.0 - 0.5 - 1.0 - 0.45 + 1e-9


@pytest.mark.parametrize("sharp", [True, False])
def test_more_time_never_proves_less_among_far_obstacles(sharp):
    path = clothoid([0.0, 3.0], [0.0, 0.0])
    problem = problem_for(path, squares([(x, 2.0) for x in np.linspace(-0.3, 3.3, 500)]))
    begun = conservative_advancement.Begun(path.start, 1.0)
    found = []
    for rounds in range(6):
        clock = iter(range(10**6))
        proof = conservative_advancement.prove_clearance(
            path, problem, lambda clock=clock, rounds=rounds: next(clock) >= rounds, begun=begun, sharp=sharp
        )
        found.append(proof.holds)
        if proof.holds:
            assert proof.proven <= 2.0 - 0.001 - 0.3 + 1e-9
            assert proof.required == REQUIRED
            assert 0.0 < proof.margin <= proof.proven
    assert found == sorted(found)


def test_distant_obstacles_are_not_evaluated(monkeypatch):
    path, pieces = clothoid([0.0, 1.0], [0.0, 0.0]), []
    monkeypatch.setattr(
        clearance_rounds,
        "advance_bounds",
        lambda bodies, advances, obstacles, *rest: (
            pieces.append(len(obstacles)) or advance_bounds(bodies, advances, obstacles, *rest)
        ),
    )
    many = squares([(5.0, 0.0), *((20.0 + i, 40.0) for i in range(1000))])
    with using_kernels("twin"):
        assert certify_path(path, problem_for(path, many)).certified
    assert set(pieces) == {1}


@settings(max_examples=25)
@given(st.floats(-50.0, 50.0), st.floats(-50.0, 50.0), st.floats(-3.0, 3.0), st.sampled_from([-0.002, 0.002]))
def test_the_verdict_does_not_depend_on_the_frame(x, y, yaw, shift):
    frame = Pose2(x, y, yaw)
    knots, curvature = [0.0, 1.0, 2.0], [0.0, 1.0, 0.0]
    plain = clothoid(knots, curvature)
    top = plain.poses_at([1.0])[0]
    post = top[:2] + (0.3 + REQUIRED + shift + 0.02) * np.array([np.sin(top[2]), -np.cos(top[2])])
    moved_post = (frame @ Pose2(*post, 0.0)).as_array()[:2]
    moved = clothoid(knots, curvature, frame)
    polygons = [square(*post, 0.01)]
    rotated = [[(frame @ Pose2(*corner, 0.0)).as_array()[:2] for corner in polygons[0]]]
    first = certify_path(plain, problem_for(plain, ObstacleSet.from_polygons(polygons)))
    second = certify_path(moved, problem_for(moved, ObstacleSet.from_polygons(rotated)))
    assert np.allclose(np.mean(rotated[0], axis=0), moved_post)
    assert first.certified is second.certified
    assert first.min_clearance == pytest.approx(second.min_clearance, abs=1e-9)


def test_a_polyline_and_the_clothoid_it_samples_agree():
    path = curved_path()
    samples = path.sample(0.005)
    polyline = Path((PolylineSegment(samples.poses, Direction.FORWARD),))
    obstacles = beside(path, 1.7, 0.1, 1)
    exact = certify_path(path, problem_for(path, obstacles)).min_clearance
    sampled = certify_path(polyline, problem_for(polyline, obstacles)).min_clearance
    assert sampled == pytest.approx(exact, abs=1.5e-3)


@settings(max_examples=25)
@given(st.integers(0, 3000))
def test_the_reported_minimum_is_true_however_far_the_obstacles_are(seed):
    rng = np.random.default_rng(seed)
    path = clothoid([0.0, 1.0, 2.0], rng.uniform(-1.0, 1.0, 3))
    polygons = [rng.normal(size=2) * 4.0 + 0.3 * _convex(rng) for _ in range(6)]
    obstacles = ObstacleSet.from_polygons(polygons)
    truth = dense_clearance(path, obstacles, ROBOT.footprint, 0.004)
    certificate = certify_path(path, problem_for(path, obstacles, clearance=ClearanceRule(0.0, 0.0, 0.0)))
    if certificate.certified:
        assert truth - 0.0015 <= certificate.min_clearance <= truth + 1e-9


def among_far_boxes(path, obstacle):
    """Return a problem with the obstacle and five distant boxes."""
    far = ObstacleSet.from_polygons([square(50.0 + k, 50.0, 0.3) for k in range(5)])
    return problem_for(path, far + ObstacleSet.from_polygons([obstacle], "near"))


def test_obstacles_keep_their_names_when_far_ones_are_left_out():
    path = clothoid([0.0, 3.0], [0.0, 0.0])
    violated = certify_path(path, among_far_boxes(path, square(1.5, 0.3)))
    assert violated.violations[0].where["obstacle"] == "near[0]"
    kept = certify_path(path, among_far_boxes(path, square(1.5, 0.5)))
    assert kept.certified
    assert kept.nearest == "near[0]"


@pytest.mark.parametrize("s", [0.4, 2.2])
def test_the_smallest_clearance_is_at_the_reported_place(s):
    path = curved_path()
    problem = problem_for(path, beside(path, s, REQUIRED + 0.02, 1))
    certificate = certify_path(path, problem)
    clearance, _ = pose_clearance(path.pose_at(certificate.at_s), ROBOT.footprint, problem.all_obstacles)
    assert clearance == pytest.approx(certificate.min_clearance, abs=0.006)


@settings(max_examples=25)
@given(st.integers(0, 10_000))
def test_the_requirement_of_a_cell_holds_for_all_of_its_poses(seed):
    rng = np.random.default_rng(seed)
    path = clothoid([0.0, 0.9], rng.uniform(-6.0, 6.0, 2))
    rule = ClearanceRule(0.3, 0.0, float(rng.uniform(0.2, 1.5)))
    problem = problem_for(path, ObstacleSet.from_polygons([square(5.0, 5.0)]), clearance=rule)
    start_clearance = float(rng.uniform(0.0, 0.4))
    relief = float(rng.choice([0.0, rng.uniform(0.0, 0.9)]))
    asked = Rule(rule, start_clearance, relief)
    world = World(ROBOT.footprint, problem.all_obstacles, problem.goal, problem.start, asked)
    prover = _Subdivision(PathMotion(path), world, 0.0, np.inf, never_late)
    cells = prover.motion.cells(0.3)
    ends = cells.ends()
    nodes = prover.motion.nodes(ends.segment, ends.u)
    bounds = prover.motion.bounds(cells, nodes.poses[ends.first], nodes.poses[ends.last])
    required = world.rule(*(bounds.farthest(ends, one) for one in world.distances(nodes.poses)))
    for first, last, most in zip(cells.first, cells.last, required, strict=True):
        at = path.poses_at(np.linspace(first, last, 40))[:, :2]
        away = [np.hypot(*(at - np.array([end.x, end.y])).T) for end in (problem.goal, problem.start)]
        assert rule.required_at(*away, start_clearance, relief).max() <= most + 1e-12


def test_an_overflowing_curvature_is_never_certified():
    blade = Footprint(np.array([[2.0, -0.005], [2.0, 0.005], [-0.1, 0.005], [-0.1, -0.005]]))
    ell = Footprint(np.array([[2.0, -0.1], [2.0, 0.1], [0.1, 0.1], [0.1, 2.0], [-0.1, 2.0], [-0.1, -0.1]]))
    path = clothoid([0.0, 1e-170], [1e170, 1e170])
    touching_allowed = ClearanceRule(0.0, 0.0, 0.0)
    for outline, angle, radius, half in ((blade, 0.011, 1.9, 0.001), (ell, 0.3, 1.5, 0.01)):
        post = square(radius * np.cos(angle), radius * np.sin(angle), half)
        problem = problem_for(path, ObstacleSet.from_polygons([post]), Robot(outline, MotionLimits()), touching_allowed)
        with np.errstate(all="ignore"):
            assert not certify_path(path, problem).certified


@pytest.mark.parametrize("late", [False, True])
def test_far_from_everything_the_clearance_is_a_bound(late):
    """An obstacle in a corner of the bounding box of the path is farther than one outside the crop."""
    path = clothoid([0.0, 6.0], [0.0, 0.0], Pose2(0.0, 0.0, np.pi / 4))
    problem = problem_for(path, ObstacleSet.from_polygons([square(0.0, 4.2, 0.01), square(6.05, 4.2, 0.01)]))
    certificate = certify_path(path, problem, is_late=late_after(0 if late else 99))
    truth = dense_clearance(path, problem.all_obstacles, ROBOT.footprint)
    assert certificate.certified
    assert 1.0 <= certificate.min_clearance <= truth + 1e-9
    assert certificate.margin <= truth - REQUIRED + 1e-9


@pytest.fixture
def by_rounds(monkeypatch):
    """Every proof round by round in Python, as that of a path that the kernel cannot prove alone."""
    monkeypatch.setattr(conservative_advancement, "_quick", lambda *_, **__: None)


@pytest.mark.usefixtures("by_rounds")
@pytest.mark.parametrize(("far", "runs"), [(0, 1), (9, 2)])
def test_one_subdivision_is_enough_if_no_obstacle_was_cropped(monkeypatch, far, runs):
    path, made, run = curved_path(), [], _Subdivision.run
    monkeypatch.setattr(_Subdivision, "run", lambda self: made.append(1) or run(self))
    boxes = [square(1.0, 3.0, 0.3), *(square(50.0 + k, 50.0, 0.3) for k in range(far))]
    certificate = certify_path(path, problem_for(path, ObstacleSet.from_polygons(boxes)))
    assert certificate.min_clearance > 1.0
    assert len(made) == runs


@pytest.mark.usefixtures("by_rounds")
def test_the_deadline_is_polled_between_blocks_of_a_long_path(monkeypatch):
    path = clothoid([0.0, 20.0], [0.0, 0.0])
    problem = problem_for(path, ObstacleSet.from_polygons([square(10.0, 1.0, 0.3), square(14.0, -0.7, 0.1)]))
    whole = certify_path(path, problem)
    monkeypatch.setattr(conservative_advancement, "_BLOCK", 16)
    parts = certify_path(Path(path.segments), problem)
    assert parts.certified
    assert parts.min_clearance == pytest.approx(whole.min_clearance, abs=1e-3)
    late = certify_path(Path(path.segments), problem, is_late=late_after(1))
    assert kinds(late) == {"unproven"}
    assert late.poses_checked < 100


@pytest.mark.usefixtures("by_rounds")
def test_the_deadline_is_polled_between_blocks_of_obstacles(monkeypatch):
    rng = np.random.default_rng(4)
    path = clothoid([0.0, 3.0], [0.0, 0.0])
    posts = [square(x, y, 0.02) for x, y in zip(rng.uniform(0, 3, 80), rng.choice([-1, 1], 80) * 0.6, strict=True)]
    problem = problem_for(path, ObstacleSet.from_polygons(posts))
    assert certify_path(path, problem).certified
    monkeypatch.setattr(stretch_bounds, "_MAX_PAIRS", 100)
    assert certify_path(Path(path.segments), problem).certified
    assert kinds(certify_path(Path(path.segments), problem, is_late=late_after(3))) == {"unproven"}


class Named(Path):
    """Paths that are equal if their frames are."""

    def __eq__(self, other):
        return isinstance(other, Path) and self.frame == other.frame

    def __hash__(self):
        return hash(self.frame)


def test_verdicts_are_cached_by_identity_of_the_path():
    straight, detour = (Named(clothoid([0.0, 3.0], [0.0, bend]).segments, "map") for bend in (0.0, 1.0))
    assert straight == detour
    problem = problem_for(straight, ObstacleSet.from_polygons([square(1.5, 1.0)]))
    assert certify_path(straight, problem).certified
    assert not certify_path(detour, problem).certified
    assert certify_path(straight, problem) is certify_path(straight, problem)


# One advance from a pose, against dense sampling.

BAR = Footprint.rectangle(0.9, 0.3, 0.4)
DART = Footprint(np.array([[0.4, 0.0], [-0.4, 0.3], [-0.2, 0.0], [-0.4, -0.3]]))


def stretch_of(spline, width):
    """Return the first half of the cell from 0 to 2 `width` on a spline with one piece."""
    at, last = spline.poses_at(0.0), 2.0 * width
    kappa = np.abs(spline.curvature_at([0.0, last])).max()
    velocity = np.array([[np.cos(at[0, 2]), np.sin(at[0, 2]), spline.curvature_at(0.0)[0]]])
    rate = abs(float(spline.curvature_rate_at(0.0)[0]))
    columns = (width, 1.0, kappa, kappa, rate + kappa**2)
    return Advances(at, np.array([0]), velocity, *(np.array([value]) for value in columns))


def dense_distance(spline, width, footprint, rocks):
    outlines = shapely.polygons(transform_points(spline.poses_at(np.linspace(0.0, width, 80)), footprint.vertices))
    return float(shapely.distance(outlines[:, None], shapely.polygons(rocks)).min())


@settings(max_examples=25)
@given(st.integers(0, 100_000))
def test_the_bound_holds_along_sharply_curved_stretches(seed):
    rng = np.random.default_rng(seed)
    footprint, width = (BAR, DART)[seed % 2], rng.uniform(0.02, 0.3)
    spline = ClothoidSpline(Pose2(*rng.uniform(-1.0, 1.0, 3)), [0.0, 2.0 * width], rng.uniform(-6.0, 6.0, 2))
    rocks = [rng.uniform(-1.5, 1.5, 2) + 0.01 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) for _ in range(40)]
    distances = [dense_distance(spline, width, footprint, [rock]) for rock in rocks]
    free = [rock for rock, distance in zip(rocks, distances, strict=True) if distance > 0.0]
    found = advance_bounds(
        bounded_footprint(footprint), stretch_of(spline, width), ObstacleSet.from_polygons(free), np.array([3.0])
    )
    assert found.bound[0] <= dense_distance(spline, width, footprint, free) + 1e-9


def test_a_body_that_swings_towards_a_post_is_detected():
    # A quarter of a metre on a circle of 0.4 m: the front swings 8 cm further to the left than its tangent says.
    spline = ClothoidSpline(Pose2(0.0, 0.0, 0.0), [0.0, 0.5], [2.5, 2.5])
    post = np.array([0.9, 0.7]) + 0.001 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    truth = dense_distance(spline, 0.25, BAR, [post])
    bound = advance_bounds(
        bounded_footprint(BAR), stretch_of(spline, 0.25), ObstacleSet.from_polygons([post]), np.array([3.0])
    ).bound[0]
    assert truth < 0.1
    assert bound <= truth


@pytest.mark.parametrize("most", [1, 7, 50, 10_000])
def test_blocks_change_nothing(monkeypatch, most):
    rng = np.random.default_rng(1)
    poses = rng.uniform(-1.0, 1.0, (9, 3))
    pose = rng.integers(0, 9, 14)
    columns = [np.full(14, value) for value in (0.05, 1.0, 0.5, 0.5, 0.5)]
    many = Advances(poses, pose, rng.normal(size=(14, 3)), *columns)
    rocks = ObstacleSet.from_polygons(
        [rng.uniform(-2.0, 2.0, 2) + np.array([[0, 0], [0.1, 0], [0, 0.2]]) for _ in range(6)]
    )
    care = np.full(14, 0.4)
    whole = advance_bounds(bounded_footprint(DART), many, rocks, care)
    monkeypatch.setattr(stretch_bounds, "_MAX_PAIRS", most)
    parts = advance_bounds(bounded_footprint(DART), many, rocks, care)
    assert parts.bound.tolist() == whole.bound.tolist()
    assert parts.row.tolist() == whole.row.tolist()
    seen = [set(zip(one.pose, one.obstacle, one.distance, strict=True)) for one in (whole, parts)]
    assert seen[0] == seen[1]


def test_the_bound_falls_as_fast_as_a_point_on_a_circle():
    """A body of a millimetre on a circle with a post inside needs the whole second-order term."""
    speck, width = Footprint.rectangle(0.0005, 0.0005, 0.001), 0.1
    spline = ClothoidSpline(Pose2(0.0, 0.0, 0.0), [0.0, 2.0 * width], [2.5, 2.5])
    wall = np.array([[-1.0, 0.05], [1.0, 0.05], [1.0, 0.06], [-1.0, 0.06]])
    truth = dense_distance(spline, width, speck, [wall])
    found = advance_bounds(
        bounded_footprint(speck), stretch_of(spline, width), ObstacleSet.from_polygons([wall]), np.array([1.0])
    )
    assert truth - 5e-4 < found.bound[0] <= truth


def test_nan_proves_nothing():
    one = stretch_of(ClothoidSpline(Pose2(0.0, 0.0, 0.0), [0.0, 0.1], [0.0, 0.0]), 0.05)
    endless = one._replace(twist=np.array([np.inf]), width=np.array([0.0]))  # inf * 0
    post = ObstacleSet.from_polygons([np.array([[1.2, 0.3], [1.3, 0.3], [1.3, 0.4]])])
    with np.errstate(invalid="ignore"):
        for footprint in (BAR, DART):
            assert advance_bounds(bounded_footprint(footprint), endless, post, np.array([3.0])).bound.tolist() == [
                -np.inf
            ]


def test_the_smaller_of_two_bounds_is_kept_and_minus_infinity_first():
    def bounds(*values):
        count = len(values)
        none = np.zeros(0, dtype=np.int64)
        return AdvanceBounds(np.array(values), np.arange(count), none, none, np.zeros(0))

    first, second = bounds(1.0, -np.inf, 2.0), bounds(0.5, 3.0, -np.inf)
    assert first.merged(second).bound.tolist() == [0.5, -np.inf, -np.inf]
    assert second.merged(first).bound.tolist() == [0.5, -np.inf, -np.inf]
