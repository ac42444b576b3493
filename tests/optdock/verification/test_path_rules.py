"""Every path rule except clearance, satisfied and violated."""

import dataclasses
import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.model.dock import Dock, DockDirection
from optdock.model.limits import MotionLimits
from optdock.model.path import ClothoidSegment, Direction, Path, PolylineSegment, TurnSegment
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.verification import certify_path

LIMITS = MotionLimits(max_curvature=1.0, max_curvature_rate=2.0)
TURNING = Robot(
    Footprint.from_radius(0.3), MotionLimits(max_yaw_rate=1.0, max_yaw_acceleration=1.0), turns_in_place=True
)


def spline(knots=(0.0, 1.0, 2.0, 2.5), curvature=(0.0, 1.0, 0.0, 0.0), start=None, sign=1):
    return ClothoidSpline(start or Pose2(0.0, 0.0, 0.3), list(knots), list(curvature), sign)


def path_of(*splines):
    return Path(tuple(ClothoidSegment(one) for one in splines))


def problem(path, limits=LIMITS, **changes):
    dock = {"final_straight": 0.5, "direction": DockDirection.AUTO}
    dock.update({key: changes.pop(key) for key in tuple(changes) if key in dock})
    goal = changes.pop("goal", path.end)
    start = changes.pop("start", path.start)
    return DockingProblem(start, Dock(goal, **dock), Robot(Footprint.from_radius(0.3), limits), **changes)


def kinds(path, wanted):
    return [violation.kind for violation in certify_path(path, wanted).violations]


def test_a_path_that_keeps_every_rule_is_certified():
    path = path_of(spline())
    certificate = certify_path(path, problem(path, start_curvature=0.0, direction=DockDirection.FORWARD))
    assert certificate.certified
    assert certificate.reason == ""
    assert certificate.max_curvature == 1.0
    assert certificate.max_curvature_rate == 1.0


@pytest.mark.parametrize("shift", [Pose2(2e-6, 0, 0), Pose2(0, -2e-6, 0), Pose2(0, 0, 2e-6), Pose2(1, 0, 0)])
def test_a_missed_end_pose_is_named(shift):
    path = path_of(spline())
    assert kinds(path, problem(path, goal=path.end @ shift)) == ["goal"]
    assert kinds(path, problem(path, start=path.start @ shift)) == ["start"]


def test_full_turns_of_yaw_do_not_matter():
    path = path_of(spline())
    turned = dataclasses.replace(path.end, yaw=path.end.yaw + 4.0 * np.pi)
    assert kinds(path, problem(path, goal=turned)) == []


@pytest.mark.parametrize(
    ("limits", "kind"), [({"max_curvature": 0.999}, "curvature"), ({"max_curvature_rate": 0.999}, "curvature_rate")]
)
def test_a_bound_just_below_the_path_is_broken(limits, kind):
    path = path_of(spline())
    tight = dataclasses.replace(LIMITS, **limits)
    violation = certify_path(path, problem(path, tight)).violations[0]
    assert violation.kind == kind
    assert violation.amount == pytest.approx(0.001)


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("sampled", [False, True])
@pytest.mark.parametrize(
    ("knots", "curvature", "limits"),
    [
        ((0.0, 1.0, 2.0, 2.5), (0.0, 1.0, 0.0, 0.0), {"max_curvature": 0.9}),
        ((0.0, 1.0, 1.2, 2.0), (0.0, 1.0, 0.0, 0.0), {"max_curvature_rate": 4.0}),  # falls more quickly than it rises
        ((0.0, 0.2, 1.2, 2.0), (0.0, 1.0, 0.0, 0.0), {"max_curvature_rate": 4.0}),
    ],
)
def test_bounds_hold_to_either_side(knots, curvature, limits, side, sampled):
    """A path and its mirror image violate the same rules by the same amounts."""
    path = path_of(spline(knots, side * np.array(curvature), Pose2(0.0, 0.0, 0.0)))
    if sampled:
        path = Path((PolylineSegment(path.sample(0.01).poses, Direction.FORWARD),))
    violations = certify_path(path, problem(path, MotionLimits(**limits), final_straight=0.0)).violations
    assert {f"max_{one.kind}" for one in violations} == set(limits)  # the motion of samples bends as their heading does
    assert violations[0].amount == pytest.approx(0.1 if "max_curvature" in limits else 1.0, rel=0.1)


def test_curvature_that_peaks_between_samples_but_on_a_knot_is_seen():
    path = path_of(spline((0.0, 0.0101, 0.0102, 0.0103, 1.0), (0.0, 0.0, 5.0, 0.0, 0.0)))
    wanted = problem(path, MotionLimits(max_curvature=4.9))
    assert kinds(path, wanted) == ["curvature"]


def test_the_start_curvature_binds_when_it_is_given():
    path = path_of(spline())
    assert kinds(path, problem(path, start_curvature=None)) == []
    assert kinds(path, problem(path, start_curvature=0.1)) == ["start_curvature"]


@pytest.mark.parametrize(
    ("asked", "expected"), [(1.0, []), (0.99, []), (0.9, ["start_curvature"]), (-1.0, ["start_curvature"])]
)
def test_the_start_curvature_of_samples_is_checked_within_one_step(asked, expected):
    """The mean over the first step differs by the change of curvature over the step: 0.01 m * 2 1/m^2."""
    arc = path_of(spline((0.0, 1.0), (1.0, 1.0)))
    path = Path((PolylineSegment(arc.sample(0.01).poses, Direction.FORWARD),))
    assert kinds(path, problem(path, start_curvature=asked, final_straight=0.0)) == expected


def test_a_final_straight_lies_on_the_dock_s_axis():
    """Straight, with the heading of the goal, but 0.4 mm off its axis half a metre before it."""
    x = np.linspace(0.0, 1.0, 101)
    for slope, expected in ((0.0, []), (1e-4, []), (8e-4, ["final_straight"]), (-8e-4, ["final_straight"])):
        path = polyline(x, slope * x)
        assert kinds(path, problem(path, final_straight=0.5)) == expected


def test_a_robot_in_motion_does_not_begin_with_a_turn_in_place():
    path = Path(
        (
            TurnSegment(Pose2(0.0, 0.0, 0.0), 0.5),
            *path_of(spline((0.0, 1.0), (0.0, 0.0), Pose2(0.0, 0.0, 0.5))).segments,
        )
    )
    for state, expected in (
        ({}, []),
        ({"start_speed": 0.1}, ["turn"]),
        ({"start_speed": 1e-9}, ["turn"]),
        ({"start_acceleration": 0.1}, ["turn"]),
        ({"start_speed": 0.1, "start_acceleration": -0.1}, ["turn"]),
    ):
        wanted = problem(path, final_straight=0.0, **state)
        assert kinds(path, dataclasses.replace(wanted, robot=TURNING)) == expected


def test_a_curved_end_breaks_the_final_straight():
    path = path_of(spline())
    assert kinds(path, problem(path, final_straight=0.5)) == []
    assert kinds(path, problem(path, final_straight=0.52)) == ["final_straight"]
    assert kinds(path, problem(path, final_straight=3.0)) == ["final_straight"]


@pytest.mark.parametrize("place", [-1e-9, -1e-12, 1e-13, 1e-12, 5e-10, 0.9e-9])
def test_a_turn_in_the_first_nanometre_of_the_final_straight_is_seen(place):
    """0.2 rad by a curvature of 2e12 1/m, which robots without a limit may have."""
    half = 1e-13
    middle = 0.64 + place - half
    path = path_of(spline((0.0, middle - half, middle, middle + half, 1.28), (0.0, 0.0, 2e12, 0.0, 0.0)))
    sharp = MotionLimits(max_curvature=np.inf, max_curvature_rate=np.inf)
    found = kinds(path, problem(path, sharp, final_straight=0.64))
    assert found == ([] if place < 0.0 else ["final_straight"])


def test_a_sharp_bend_may_end_where_the_straight_begins():
    path = path_of(spline((0.0, 0.5, 0.5001, 1.0), (0.0, -3000.0, 0.0, 0.0)))
    sharp = MotionLimits(max_curvature=np.inf, max_curvature_rate=np.inf)
    assert kinds(path, problem(path, sharp, final_straight=0.4999)) == []


def test_a_kink_of_curvature_inside_the_final_straight_is_seen():
    path = path_of(spline((0.0, 2.0, 2.2, 2.21, 2.22, 2.5), (0.0, 0.0, 0.0, 0.01, 0.0, 0.0)))
    assert kinds(path, problem(path, final_straight=0.5)) == ["final_straight"]


@pytest.mark.parametrize("share", [0.25, 0.5, 0.75, 0.999, 1.0, 1.001])
@pytest.mark.parametrize("sampled", [False, True])
def test_the_final_straight_is_driven_in_one_gear(share, sampled):
    """A straight path in reverse and then forward is too short, regardless of the cusp."""
    back = spline((0.0, 1.0), (0.0, 0.0), Pose2(0.0, 0.0, 0.0), sign=-1)
    path = path_of(back, spline((0.0, 0.5 * share), (0.0, 0.0), back.end))
    if sampled:
        path = Path(tuple(PolylineSegment(part.poses_at(np.linspace(0.0, part.length, 9)), part.direction)
                          for part in path.segments))  # fmt: skip
    expected = [] if share >= 1.0 else ["final_straight"]
    violations = certify_path(path, problem(path, final_straight=0.5)).violations
    assert [violation.kind for violation in violations] == expected
    assert all(violation.amount == pytest.approx(0.5 * (1.0 - share)) for violation in violations)


def test_the_gear_into_the_dock_is_the_one_asked_for():
    backward = path_of(spline(sign=-1))
    assert kinds(backward, problem(backward, direction=DockDirection.BACKWARD)) == []
    assert kinds(backward, problem(backward, direction=DockDirection.FORWARD)) == ["direction"]


def test_a_moving_robot_keeps_its_gear():
    path = path_of(spline())
    assert kinds(path, problem(path, start_speed=0.2)) == []
    assert kinds(path, problem(path, start_speed=-0.2)) == ["direction"]


def test_a_last_nanometre_does_not_define_the_gear_into_the_dock():
    back = spline((0.0, 1.0), (0.0, 0.0), sign=-1)
    path = path_of(back, spline((0.0, 1e-9), (0.0, 0.0), back.end))
    for asked, expected in ((DockDirection.FORWARD, ["direction"]), (DockDirection.BACKWARD, [])):
        assert kinds(path, problem(path, direction=asked, final_straight=0.0)) == expected


def test_a_first_nanometre_does_not_define_the_gear_of_a_moving_robot():
    first = spline((0.0, 1e-9), (0.0, 0.0))
    path = path_of(first, spline((0.0, 1.0), (0.0, 0.0), first.end, -1))
    assert kinds(path, problem(path, start_speed=0.2)) == ["direction"]
    assert kinds(path, problem(path, start_speed=-0.2)) == []


@pytest.mark.parametrize(("count", "is_motion"), [(2, False), (200, True)])
def test_short_gears_add_up_to_a_motion(count, is_motion):
    """Two steps of 0.4 micrometres have no direction, two hundred are a motion in reverse."""
    s = 0.4e-6 * np.arange(count + 1)
    tiny = [polyline([-a, -b], [0.0, 0.0]).segments[0].poses for a, b in itertools.pairwise(s)]
    crawl = [PolylineSegment(poses, Direction.REVERSE) for poses in tiny]
    last = PolylineSegment([[-1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    expected = ["direction"] if is_motion else []
    path = Path((last, *crawl))
    assert kinds(path, problem(path, direction=DockDirection.FORWARD, final_straight=0.0)) == expected
    first = PolylineSegment([[-float(s[-1]), 0.0, 0.0], [1.0, 0.0, 0.0]])
    path = Path((*crawl, first))
    assert kinds(path, problem(path, start_speed=0.1, final_straight=0.0)) == expected


def test_gears_that_do_not_meet_are_a_joint_violation():
    first = spline()
    whole = path_of(first, spline((0.0, 1.0), (0.0, 0.0), first.end, -1))
    assert kinds(whole, problem(whole)) == []
    gap = path_of(first, spline((0.0, 1.0), (0.0, 0.0), first.end @ Pose2(0.0, 1e-5, 0.0), -1))
    assert kinds(gap, problem(gap)) == ["joint"]


def test_curvature_may_jump_at_a_cusp():
    first = spline((0.0, 1.0), (1.0, 1.0))
    path = path_of(first, spline((0.0, 1.0), (-1.0, 0.0), first.end, -1))
    assert kinds(path, problem(path, final_straight=0.0)) == []


def test_a_polyline_that_samples_a_legal_clothoid_passes():
    samples = path_of(spline()).sample(0.01)
    path = Path((PolylineSegment(samples.poses, Direction.FORWARD),))
    assert kinds(path, problem(path, start_curvature=0.0)) == []


def test_a_polyline_corner_breaks_curvature_and_slips():
    poses = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.5, np.pi / 2], [1.0, 2.0, np.pi / 2]])
    path = Path.from_poses(poses)
    found = kinds(path, problem(path))
    assert "curvature" in found
    assert "slip" in found


def test_turning_in_place_breaks_any_finite_curvature_bound():
    path = Path.from_poses(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.0, 0.4]]))
    certificate = certify_path(path, problem(path, MotionLimits(max_curvature=1e6), final_straight=0.0))
    assert [violation.kind for violation in certificate.violations] == ["curvature"]
    assert certificate.max_curvature == np.inf
    free = certify_path(path, problem(path, MotionLimits(), final_straight=0.0))
    assert free.certified


def test_a_path_that_begins_with_a_turn_in_place_begins_before_the_turn():
    path = Path.from_poses(np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]))
    for yaw, expected in ((0.0, ["start"]), (1.0, [])):
        wanted = problem(path, MotionLimits(), start=Pose2(0.0, 0.0, yaw), final_straight=0.0)
        assert kinds(path, wanted) == expected


@pytest.mark.parametrize("at", [1.0, 2.0])
def test_a_turn_in_place_and_back_is_not_straight(at):
    poses = np.array([[0.0, 0.0, 0.0], [at, 0.0, 0.0], [at, 0.0, 0.5], [at, 0.0, 0.0], [2.0 + at, 0.0, 0.0]])
    for path, expected in ((Path.from_poses(poses), []), (Path.from_poses(poses[:4]), ["final_straight"])):
        assert kinds(path, problem(path, MotionLimits(), final_straight=0.5)) == expected
        whole = problem(path, MotionLimits(), final_straight=path.length)
        assert kinds(path, whole) == ["final_straight"]


def test_a_spike_of_curvature_in_the_first_micrometre_of_the_final_straight_is_seen():
    path = path_of(spline((0.0, 2.0, 2.0000002, 2.0000004, 2.0000006, 2.5), (0.0, 0.0, 0.0, 900.0, 0.0, 0.0)))
    assert kinds(path, problem(path, MotionLimits(), final_straight=0.5)) == ["final_straight"]


def test_a_half_circle_in_one_step_is_rejected():
    """The arc of the step has the curvature and its chord the clearance, but no motion has both."""
    for count, expected in ((2, ["slip"]), (16, [])):
        angle = np.linspace(-np.pi / 2, np.pi / 2, count)
        path = Path.from_poses(np.column_stack((0.5 * np.cos(angle), 0.5 * np.sin(angle), angle + np.pi / 2)))
        wanted = problem(path, MotionLimits(max_curvature=2.1), final_straight=0.0)
        assert kinds(path, wanted) == expected


def test_sliding_sideways_is_a_slip():
    path = Path.from_poses(np.array([[0.0, 0.0, 0.0], [0.5, 0.5, 0.0], [1.0, 1.0, 0.0]]))
    assert set(kinds(path, problem(path, final_straight=0.0))) == {"slip"}


def test_a_certificate_is_plain_data():
    path = path_of(spline())
    data = certify_path(path, problem(path, final_straight=0.52)).as_dict()
    assert data["certified"] is False
    assert data["min_clearance"] is None
    assert data["violations"][0]["kind"] == "final_straight"


def test_jumps_at_joints_add_up():
    """A hundred jumps of a hundredth of the tolerance are accepted, of three hundredths they are not."""
    for jump, expected in ((0.9e-8, []), (3e-8, ["joint"])):
        pieces = [spline((0.0, 0.01), (0.0, 0.0), Pose2(0.01 * k, jump * k, 0.0)) for k in range(101)]
        path = path_of(*pieces)
        assert kinds(path, problem(path, final_straight=0.0)) == expected


def polyline(x, y, yaw=0.0):
    return Path((PolylineSegment(np.column_stack((x, y, np.zeros(len(x)) + yaw))),))


@pytest.mark.parametrize(("slope", "expected"), [(0.0099, ["slip"]), (-0.0099, ["slip"]), (0.0003, [])])
def test_slips_of_steps_add_up(slope, expected):
    """Every step slips by less than its tolerance; in total the robot drifts 3 cm."""
    x = np.linspace(0.0, 3.0, 301)
    path = polyline(x, slope * x)
    assert kinds(path, problem(path, final_straight=0.0)) == expected
    there_and_back = polyline(x, slope * 1.5 / np.pi * np.sin(np.pi * x / 3.0) * 2.0)
    assert kinds(there_and_back, problem(there_and_back, final_straight=0.0)) == expected


@pytest.mark.parametrize(("slope", "expected"), [(0.9e-4, []), (3e-4, ["slip"]), (-3e-4, ["slip"])])
def test_a_long_path_may_slip_by_a_tenth_of_a_millimetre_per_metre_more(slope, expected):
    """Over 10 m the tolerance is 2 mm."""
    x = np.linspace(0.0, 10.0, 1001)
    path = polyline(x, slope * x)
    assert kinds(path, problem(path, final_straight=0.0)) == expected


def test_slips_of_several_gears_add_up():
    x = np.linspace(0.0, 0.1, 11)
    gears = []
    for k in range(30):  # forth and back, always to the same side of the body
        y = 0.0099 * (0.1 * k + x)
        along = x if k % 2 == 0 else x[::-1]
        gears.append(PolylineSegment(np.column_stack((along, y, 0.0 * x)), Direction(1 if k % 2 == 0 else -1)))
    path = Path(tuple(gears))
    assert kinds(path, problem(path, final_straight=0.0)) == ["slip"]


def test_slips_add_up_in_the_world_where_the_robot_turns_round_between_them():
    x = np.linspace(0.0, 0.1, 11)
    rows = []
    for k in range(40):  # to the left of the body, turn round in place, to its right, turn back
        forth = np.column_stack((x if k % 2 == 0 else x[::-1], 0.0099 * (0.1 * k + x), np.full(11, np.pi * (k % 2))))
        rows += [forth, forth[-1:] + np.array([0.0, 0.0, 0.5 * np.pi])]
    path = Path.from_poses(np.concatenate(rows))
    assert kinds(path, problem(path, MotionLimits(), final_straight=0.0)) == ["slip"]


def test_a_long_way_before_allows_no_more_slip():
    loops = ClothoidSegment(spline((0.0, 200.0 * np.pi), (1.0, 1.0), Pose2(0.0, 0.0, 0.0)))
    x = np.linspace(0.0, 3.0, 301)
    crab = Path((loops, *polyline(x, 0.0099 * x).segments))
    assert kinds(crab, problem(crab, final_straight=0.0)) == ["slip"]


def test_creeping_in_steps_too_short_to_count_is_a_slip():
    step, count = 0.95e-9, 2000
    y = np.concatenate((np.zeros(100), step * np.arange(count), np.full(100, step * (count - 1))))
    x = np.concatenate((np.linspace(0.0, 1.0, 100), np.ones(count), np.linspace(1.0, 2.0, 100)))
    path = polyline(x, y)
    assert kinds(path, problem(path, final_straight=0.0)) == ["slip"]
    turning = polyline(x, 0.0 * x, y)
    assert "slip" in kinds(turning, problem(turning, MotionLimits(), final_straight=0.0))
    few = polyline(x[:400], y[:400])
    assert kinds(few, problem(few, final_straight=0.0)) == []


@pytest.mark.parametrize(("spacing", "aside"), [(1e-3, 9.9e-6), (5e-3, 40e-6), (0.02, 160e-6)])
def test_a_zigzag_of_motion_is_a_curvature(spacing, aside):
    """The heading is constant but the direction of motion oscillates by 20, 3 and 0.8 1/m with a limit of 0.5."""
    count = int(2.0 / spacing) + 1
    path = polyline(spacing * np.arange(count), np.where(np.arange(count) % 2, aside, 0.0))
    tight = problem(path, dataclasses.replace(LIMITS, max_curvature=0.5), final_straight=0.0)
    assert kinds(path, tight) == ["curvature"]
    assert kinds(path, problem(path, MotionLimits(), final_straight=0.0)) == []


SUMS = ("drifts sideways", "add up", "in total", "direction of motion")


@settings(max_examples=25)
@given(st.integers(0, 100_000), st.sampled_from([0.01, 0.02, 0.05, 0.1]), st.sampled_from([0.0, 1e-9, 1e-6]))
def test_exact_samples_satisfy_the_rules_of_sums(seed, spacing, rounding):
    rng = np.random.default_rng(seed)
    knots = np.concatenate(([0.0], np.cumsum(rng.uniform(0.3, 1.0, rng.integers(2, 9)))))
    curvature = rng.uniform(0.1, 1.5) * rng.uniform(-1.0, 1.0, knots.size)
    exact = path_of(spline(knots, curvature, Pose2(*rng.uniform(-9.0, 9.0, 2), 1.0), int(rng.choice([1, -1]))))
    poses = exact.sample(spacing).poses
    poses = np.round(poses / rounding) * rounding if rounding else poses
    path = Path((PolylineSegment(poses, exact.segments[0].direction),))
    limits = MotionLimits(max_curvature=float(np.max(np.abs(curvature))))
    found = certify_path(path, problem(path, limits, final_straight=0.0)).violations
    # A coarse step across a kink may still slip or bulge by itself.
    assert [v.message for v in found if any(part in v.message for part in SUMS)] == []
