"""The proof of visibility compared with closed forms, dense samples and symmetries."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.model.camera import Camera
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.path import ClothoidSegment, Path, PolylineSegment, TurnSegment, place_before_end
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot, TrackingTube
from optdock.verification import certify_path
from optdock.verification.visibility import prove_view

CENTRE = Pose2(0.0, 0.0, 0.0)
LIMITS = MotionLimits(max_yaw_rate=1.0, max_yaw_acceleration=1.0)
OUTLINE = Footprint.rectangle(0.4, 0.4, 0.6)
NO_TUBE = TrackingTube()


def asked(path, camera, marker, visible=100.0, blind=0.0, tracking=NO_TUBE):
    """Return a problem that `path` solves, with the marker at a world point."""
    seen = path.end.inverse() @ Pose2(*marker, 0.0)
    dock = Dock(path.end, marker=(seen.x, seen.y), visible_distance=visible, blind_distance=blind)
    robot = Robot(OUTLINE, LIMITS, turns_in_place=True, tracking=tracking, camera=camera)
    return DockingProblem(path.start, dock, robot)


def straight(length=3.0, sign=1, start=CENTRE):
    return Path((ClothoidSegment(ClothoidSpline(start, [0.0, length], [0.0, 0.0], sign)),))


def winding(rng, gears=2):
    """Return clothoid gears with turns in place between some of them."""
    segments, pose, sign = [], Pose2(*rng.uniform(-1.0, 1.0, 2), rng.uniform(-3.0, 3.0)), 1
    for _ in range(gears):
        if rng.random() < 0.4:
            turn = TurnSegment(pose, rng.uniform(0.2, 2.5) * rng.choice([-1, 1]))
            segments.append(turn)
            pose = turn.end
        knots = np.concatenate(([0.0], np.cumsum(rng.uniform(0.1, 0.6, 3))))
        spline = ClothoidSpline(pose, knots, rng.uniform(-2.0, 2.0, 4), sign)
        segments.append(ClothoidSegment(spline))
        pose, sign = spline.end, -sign
    return Path(tuple(segments))


def loss(path, camera, marker, s):
    """Return the excess of bearing [rad] and distance [m] over the view along a path. Shape (n,)."""
    found = []
    for pose in path.poses_at(s):
        at = Pose2.from_sequence(pose) @ camera.mount
        dx, dy = marker[0] - at.x, marker[1] - at.y
        bearing = math.remainder(math.atan2(dy, dx) - at.yaw, 2.0 * math.pi)
        distance = math.hypot(dx, dy)
        outside = abs(bearing) - 0.5 * camera.field_of_view if distance > 1e-4 else -1.0
        found.append(max(outside, camera.min_range - distance, distance - camera.max_range))
    return np.array(found)


@pytest.mark.parametrize("gear", [1, -1])
@pytest.mark.parametrize("beside", [0.5, -0.5])
def test_driving_past_a_marker_loses_it_where_the_tangent_says(gear, beside):
    # Straight along x, the marker 2 m ahead and to the side: the bearing is atan2(0.5, 2 - x).
    path, half = straight(2.4, gear, CENTRE if gear > 0 else Pose2(2.4, 0.0, 0.0)), math.radians(30.0)
    lost = 2.0 - 0.5 / math.tan(half)
    camera = Camera(CENTRE, 2.0 * half)
    seen = path.piece(0.0, lost - 1e-3) if gear > 0 else path.piece(2.4 - lost + 1e-3)
    assert prove_view(seen, asked(seen, camera, (2.0, beside)))
    gone = path.piece(0.0, lost + 1e-3) if gear > 0 else path.piece(2.4 - lost - 1e-3)
    assert not prove_view(gone, asked(gone, camera, (2.0, beside)))


def test_turning_steps_at_the_end_of_a_polyline_are_checked_despite_rounding():
    """The last poses share one arc length, which rounding reduces in the sum over the segments."""
    lost = 0
    for seed in range(200):
        steps = np.random.default_rng(seed).uniform(0.01, 0.3, 30)
        way = np.concatenate(([0.0], np.cumsum(steps)))[:, None]
        poses = way * [math.cos(0.3), math.sin(0.3), 0.0] + [0.0, 0.0, 0.3]
        last = np.concatenate((poses[20:], poses[-1] + np.arange(1, 11)[:, None] * [0.0, 0.0, 0.3]))
        path = Path(tuple(PolylineSegment(some, 1) for some in (poses[:11], poses[10:21], last)))
        if place_before_end(path, 0.0) - path.segment_starts[2] < path.segments[2].knots[-1]:
            lost += 1
            seen = asked(path, Camera(CENTRE, 1.0), (9.0 * math.cos(0.3), 9.0 * math.sin(0.3)), visible=0.05)
            assert [violation.kind for violation in prove_view(path, seen).violations] == ["view"]
    assert lost > 0


def test_a_turn_in_place_loses_the_marker_at_the_angle_of_the_cone():
    camera = Camera(CENTRE, 1.0)
    for turn, holds in ((0.4999, True), (0.5001, False), (-0.4999, True), (-0.5001, False)):
        path = Path((TurnSegment(CENTRE, turn),))
        # A turn in place is no distance: all of it belongs to the last metre.
        assert bool(prove_view(path, asked(path, camera, (1.0, 0.0), visible=1.0))) is holds


def test_the_marker_may_be_passed_at_no_distance_at_all():
    path, marker = straight(2.0), (1.0, 0.0)
    for camera in (Camera(CENTRE, 2.0 * math.pi), Camera(Pose2(0.0, 0.0, 0.5), 2.0 * math.pi)):
        assert prove_view(path, asked(path, camera, marker))
    # Ahead it is seen until the camera stands in it, behind it is not.
    before, after = path.piece(0.0, 1.0), path.piece(0.999)
    assert prove_view(before, asked(before, Camera(CENTRE, 0.2), marker))
    assert not prove_view(after, asked(after, Camera(CENTRE, 0.2), marker))


@pytest.mark.parametrize(
    ("camera", "holds"),
    [
        (Camera(CENTRE, 3.0, 0.0, 3.0), True),
        (Camera(CENTRE, 3.0, 0.0, 2.999), False),
        (Camera(CENTRE, 3.0, 1.0), True),
        (Camera(CENTRE, 3.0, 1.001), False),
    ],
)
def test_ranges_are_distances_from_the_camera(camera, holds):
    path = straight(2.0)
    assert bool(prove_view(path, asked(path, camera, (3.0, 0.0)))) is holds


def test_only_the_required_part_is_checked():
    # The marker is beyond the range in the first metre, and too near in the last half metre.
    path, camera = straight(3.0), Camera(CENTRE, 1.0, 0.6, 2.1)
    assert prove_view(path, asked(path, camera, (3.1, 0.0), visible=2.0, blind=0.5))
    assert not prove_view(path, asked(path, camera, (3.1, 0.0), visible=2.01, blind=0.5))
    assert not prove_view(path, asked(path, camera, (3.1, 0.0), visible=2.0, blind=0.49))
    shorter = path.piece(2.6)  # all of it is blind
    assert prove_view(shorter, asked(shorter, camera, (3.1, 0.0), visible=2.0, blind=0.5)).margin == math.inf


def test_a_loss_far_shorter_than_the_cells_is_found():
    # On a circle about the marker's side the bearing peaks at one place: the cone is narrower by a hair.
    knots, curvature = [0.0, 0.53, 1.1], [0.0, 0.9, -0.8]
    path, marker = Path((ClothoidSegment(ClothoidSpline(CENTRE, knots, curvature)),)), (3.0, 0.1)
    s = np.linspace(0.0, path.length, 200_001)
    poses = path.poses_at(s)
    bearing = np.abs(np.arctan2(marker[1] - poses[:, 1], marker[0] - poses[:, 0]) - poses[:, 2])
    most = float(bearing.max())
    assert prove_view(path, asked(path, Camera(CENTRE, 2.0 * (most + 1e-6)), marker))
    lost = prove_view(path, asked(path, Camera(CENTRE, 2.0 * (most - 2e-6)), marker))
    assert lost.violations[0].kind == "view"
    assert np.ptp(s[bearing > most - 2e-6]) < 0.01
    assert lost.violations[0].s == pytest.approx(s[np.argmax(bearing)], abs=5e-3)


@pytest.mark.parametrize("seed", range(14))
def test_a_proof_holds_at_dense_samples_and_a_refusal_at_its_place(seed):
    rng = np.random.default_rng(seed)
    path = winding(rng)
    camera = Camera(
        Pose2(*rng.uniform(-0.5, 0.5, 2), rng.uniform(-3.0, 3.0)), rng.uniform(0.3, 6.2), rng.choice([0.0, 0.3]), 3.0
    )
    s = np.linspace(0.0, path.length, 1500)
    marker = path.end.as_array()[:2] + rng.uniform(-1.5, 1.5, 2)
    proof = prove_view(path, asked(path, camera, marker))
    beyond = loss(path, camera, marker, s)
    if proof:
        assert beyond.max() <= 1e-5
    else:
        found = proof.violations[0]
        assert found.kind == "view"
        assert loss(path, camera, marker, [found.s])[0] > 0.0
        assert found.amount > 0.0
        if found.where["quantity"] == "bearing":
            assert found.amount == pytest.approx(abs(found.where["value"]) - 0.5 * camera.field_of_view)


def test_motions_that_keep_the_view_are_proven():
    # Whatever the motion: a cone and ranges that the dense samples keep by a hair are proven.
    rng, proven = np.random.default_rng(7), 0
    for _ in range(30):
        path = winding(rng)
        marker = path.end.as_array()[:2] + rng.uniform(-2.0, 2.0, 2)
        s = np.linspace(0.0, path.length, 500)
        mount = Pose2(*rng.uniform(-0.3, 0.3, 2), rng.uniform(-3.0, 3.0))
        eyes = [Pose2.from_sequence(pose) @ mount for pose in path.poses_at(s)]
        seen = np.array([[p.x, p.y] for p in (e.inverse() @ Pose2(*marker, 0.0) for e in eyes)])
        bearing, distance = np.abs(np.arctan2(seen[:, 1], seen[:, 0])).max(), np.hypot(*seen.T)
        if bearing > 3.0:
            continue
        camera = Camera(mount, 2.0 * bearing + 0.02, max(0.0, distance.min() - 0.01), distance.max() + 0.01)
        assert prove_view(path, asked(path, camera, marker))
        proven += 1
    assert proven >= 5


@settings(max_examples=25)
@given(
    seed=st.integers(0, 10_000),
    x=st.floats(-50, 50),
    y=st.floats(-50, 50),
    yaw=st.floats(-4, 4),
    wide=st.floats(0.2, 6),
)
def test_the_verdict_does_not_depend_on_the_frame_nor_on_left_and_right(seed, x, y, yaw, wide):
    rng = np.random.default_rng(seed)
    path, camera = winding(rng), Camera(Pose2(0.2, 0.1, rng.uniform(-1.0, 1.0)), wide, 0.0, 4.0)
    task = asked(path, camera, path.end.as_array()[:2] + rng.uniform(-2.0, 2.0, 2))
    proof = prove_view(path, task)
    move = Pose2(x, y, yaw)
    moved = prove_view(
        path.moved(move),
        dataclasses.replace(task, start=move @ task.start, dock=dataclasses.replace(task.dock, pose=move @ task.goal)),
    )
    mirrored = prove_view(mirror(path), mirrored_problem(task))
    for other in (moved, mirrored):
        if abs(proof.margin) > 1e-4 and abs(other.margin) > 1e-4:
            assert bool(other) is bool(proof)
            assert other.margin == pytest.approx(proof.margin, abs=1e-6)


def mirror_pose(pose):
    return Pose2(pose.x, -pose.y, -pose.yaw)


def mirror(path):
    def one(segment):
        if isinstance(segment, TurnSegment):
            return TurnSegment(mirror_pose(segment.pose), -segment.turn)
        spline = segment.spline
        return ClothoidSegment(ClothoidSpline(mirror_pose(spline.start), spline.knots, -spline.curvature, spline.sign))

    return Path(tuple(map(one, path.segments)))


def mirrored_problem(task):
    camera = dataclasses.replace(task.robot.camera, mount=mirror_pose(task.robot.camera.mount))
    dock = dataclasses.replace(
        task.dock, pose=mirror_pose(task.goal), marker=(task.dock.marker[0], -task.dock.marker[1])
    )
    robot = dataclasses.replace(task.robot, camera=camera)
    return dataclasses.replace(task, start=mirror_pose(task.start), dock=dock, robot=robot)


@pytest.mark.parametrize("kind", ["polyline", "clothoid"])
def test_sampled_and_exact_curves_have_one_verdict(kind):
    spline = ClothoidSpline(CENTRE, [0.0, 1.0, 2.0], [0.0, 0.8, 0.0])
    exact = Path((ClothoidSegment(spline),))
    path = exact if kind == "clothoid" else Path((PolylineSegment(spline.poses_at(np.linspace(0.0, 2.0, 401))),))
    marker = np.add(path.end.as_array()[:2], (1.0, 0.6))
    most = float(np.max(loss(exact, Camera(CENTRE, 1e-9), marker, np.linspace(0.0, 2.0, 2001))))
    assert prove_view(path, asked(path, Camera(CENTRE, 2.0 * most + 1e-3), marker))
    assert not prove_view(path, asked(path, Camera(CENTRE, 2.0 * most - 1e-3), marker))


def test_the_certificate_names_the_place_the_value_and_the_limit():
    path, camera = straight(3.0), Camera(CENTRE, math.radians(60.0))
    certificate = certify_path(path, asked(path, camera, (4.0, 0.9), visible=1.0))
    (violation,) = certificate.violations
    assert violation.kind == "view"
    assert violation.message == (
        "the dock leaves the camera's view at s = 3.000 m: bearing 42.0 degrees, at most 30.0 degrees"
    )
    where = violation.where
    assert (where["quantity"], where["unit"]) == ("bearing", "rad")
    assert where["value"] == pytest.approx(math.atan2(0.9, 1.0))
    assert where["limit"] == pytest.approx(math.radians(30.0))
    assert certificate.as_dict()["view_margin"] == pytest.approx(certificate.view_margin)


@pytest.mark.parametrize(
    ("camera", "said"),
    [
        (Camera(CENTRE, 1.0, 0.0, 3.5), "distance 4.000 m, at most 3.500 m"),
        (Camera(CENTRE, 1.0, 1.5), "distance 1.000 m, at least 1.500 m"),
    ],
)
def test_violated_ranges_are_named(camera, said):
    path = straight(3.0)
    assert said in certify_path(path, asked(path, camera, (4.0, 0.0))).reason


def test_without_a_view_the_certificate_is_unchanged():
    path = straight(1.0)
    certificate = certify_path(path, DockingProblem(path.start, Dock(path.end), Robot(OUTLINE, LIMITS)))
    assert certificate.view_margin is None
    assert "view_margin" not in certificate.as_dict()


def test_with_a_tube_every_pose_within_it_sees():
    path, tube = straight(2.0), TrackingTube(0.08, 0.15)
    camera, marker = Camera(CENTRE, math.radians(60.0)), (4.0, 1.1)
    assert prove_view(path, asked(path, camera, marker))
    task = asked(path, camera, marker, tracking=tube)
    (violation,) = prove_view(path, task).violations
    assert violation.kind == "view"
    assert "kept for the tube" in violation.message
    # From one pose of the tube about the place that is named, narrower near the dock, the marker is not seen.
    share = min(1.0, (path.length - violation.s) / task.clearance.taper)
    pose = path.pose_at(violation.s)
    off = [pose @ Pose2(0.0, y * share, turn * share) for y in (-tube.cross, tube.cross) for turn in (-0.15, 0.15)]
    assert max(abs(bearing_of(one, marker)) for one in off) > math.pi / 6
    narrower = asked(path, camera, marker, tracking=TrackingTube(0.02, 0.04))
    assert prove_view(path, narrower)


def bearing_of(pose, point):
    seen = pose.inverse() @ Pose2(*point, 0.0)
    return math.atan2(seen.y, seen.x)


def test_after_the_deadline_the_view_is_unproven():
    path = winding(np.random.default_rng(3), gears=4)
    marker, s = np.add(path.end.as_array()[:2], (0.4, 0.3)), np.linspace(0.0, path.length, 2001)
    most = float(loss(path, Camera(CENTRE, 1e-9, 0.0, 100.0), marker, s).max())
    task = asked(path, Camera(CENTRE, min(2.0 * most + 1e-4, 6.28), 0.0, 100.0), marker)
    assert prove_view(path, task)
    late = prove_view(path, task, is_late=lambda: True)
    assert late.violations[0].kind == "unproven"
    assert "view" in late.violations[0].message
