"""Field of view and margins of a camera, and validation of docks and problems with a marker."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optdock.errors import InvalidValue
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.model.camera import Camera
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot, TrackingTube

AHEAD = Pose2(0.3, 0.0, 0.0)
ANGLES = st.floats(0.05, 2.0 * math.pi - 0.01)
PLACES = st.tuples(st.floats(-4.0, 4.0), st.floats(-4.0, 4.0))
OUTLINE = Footprint.rectangle(0.4, 0.4, 0.6)
NO_TUBE, PLAIN = TrackingTube(), Dock(Pose2(0.0, 0.0, 0.0))


def robot(camera=None, tracking=NO_TUBE):
    return Robot(OUTLINE, MotionLimits(max_curvature=1.5), tracking=tracking, camera=camera)


def problem(dock=PLAIN, camera=None, tracking=NO_TUBE):
    return DockingProblem(Pose2(-2.0, 0.3, 0.0), dock, robot(camera, tracking))


SEEN = Dock(Pose2(0.0, 0.0, 0.0), marker=(0.5, 0.0), visible_distance=1.5)


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("field_of_view", {"field_of_view": 0.0}),
        ("field_of_view", {"field_of_view": 6.3}),
        ("field_of_view", {"field_of_view": math.nan}),
        ("field_of_view", {"field_of_view": "1.0"}),
        ("min_range", {"min_range": -0.1}),
        ("min_range", {"min_range": math.inf}),
        ("max_range", {"min_range": 1.0, "max_range": 1.0}),
        ("max_range", {"max_range": math.nan}),
        ("mount", {"mount": (0.3, 0.0, 0.0)}),
    ],
)
def test_invalid_cameras_are_rejected_by_name(name, values):
    with pytest.raises(InvalidValue, match=rf"robot\.camera\.{name}"):
        Camera(**{"mount": AHEAD, "field_of_view": 1.0, **values})


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("marker", {"marker": (0.5,)}),
        ("marker", {"marker": (0.5, math.nan)}),
        ("marker", {"marker": "ab"}),
        ("visible_distance", {"visible_distance": 1.0}),
        ("visible_distance", {"marker": (0.5, 0.0), "visible_distance": -1.0}),
        ("blind_distance", {"marker": (0.5, 0.0), "visible_distance": 1.0, "blind_distance": 1.0}),
        ("blind_distance", {"blind_distance": 0.1}),
        ("blind_distance", {"blind_distance": math.inf}),
    ],
)
def test_invalid_view_requirements_are_rejected_by_name(name, values):
    with pytest.raises(InvalidValue, match=rf"dock\.{name}"):
        Dock(Pose2(0.0, 0.0, 0.0), **values)


def test_a_required_view_needs_a_camera():
    with pytest.raises(InvalidValue, match=r"dock\.visible_distance.*robot\.camera"):
        problem(SEEN)
    assert problem(SEEN, Camera(AHEAD, 1.0)).required_view is not None
    assert problem(dataclasses.replace(SEEN, visible_distance=0.0, blind_distance=0.0)).required_view is None


@settings(max_examples=20)
@given(place=PLACES, angle=ANGLES)
def test_a_point_is_inside_exactly_where_bearing_and_distance_are(place, angle):
    camera = Camera(AHEAD, angle, 0.4, 2.5)
    found = camera.margins(np.array([place]))
    distance, bearing = math.hypot(*place), abs(math.atan2(place[1], place[0]))
    excess = min(0.5 * angle - bearing, distance - 0.4, 2.5 - distance)
    if abs(excess) > 1e-9:
        assert (found.smallest[0] > 0.0) == (excess > 0.0)


@settings(max_examples=20)
@given(place=PLACES, angle=ANGLES, move=PLACES)
def test_margins_change_no_faster_than_the_point_moves(place, angle, move):
    camera = Camera(AHEAD, angle, 0.4, 2.5)
    here, there = camera.margins(np.array([place, np.add(place, move)])).smallest
    assert there >= here - math.hypot(*move) - 1e-12 or here < 0.0


@settings(max_examples=20)
@given(place=PLACES, angle=ANGLES)
def test_the_margin_of_a_point_inside_is_its_distance_from_the_boundary(place, angle):
    camera = Camera(AHEAD, angle)
    inside = camera.margins(np.array([place])).smallest[0]
    if inside > 0.0:
        # The nearest point outside: among points of the two edges, dense about the foot of each, and the apex.
        along = np.linspace(0.0, 6.0, 2001)
        edges = [np.column_stack((along * math.cos(h), along * math.sin(h))) for h in (0.5 * angle, -0.5 * angle)]
        nearest = np.hypot(*(np.concatenate(edges) - place).T).min()
        assert inside <= nearest + 1e-12
        assert inside == pytest.approx(nearest, abs=4e-3)


@settings(max_examples=20)
@given(x=st.floats(-5, 5), y=st.floats(-5, 5), yaw=st.floats(-4, 4), place=PLACES, turn=st.floats(-3, 3))
def test_a_point_seen_is_the_point_in_the_frame_of_the_mount(x, y, yaw, place, turn):
    camera = Camera(Pose2(0.3, -0.1, turn), 1.0)
    seen = camera.points_seen(np.array([[x, y, yaw]]), np.array(place))[0]
    wanted = (Pose2(x, y, yaw) @ camera.mount).inverse() @ Pose2(*place, 0.0)
    assert seen == pytest.approx([wanted.x, wanted.y], abs=1e-12)


def test_the_marker_is_given_in_the_frame_of_the_docked_robot():
    dock = Dock(Pose2(2.0, 1.0, math.pi / 2), marker=(0.5, 0.1), visible_distance=1.0)
    view = problem(dock, Camera(AHEAD, 1.0)).required_view
    assert view.marker == pytest.approx([1.9, 1.5])


def test_fingerprints_without_a_view_are_unchanged():
    # Written down from the version before there were cameras.
    assert problem().fingerprint.limits == "c0620f2f53587318"
    assert problem().fingerprint.dock == "06a8df8e0765c19c"


def test_every_parameter_of_the_view_is_in_the_fingerprint():
    camera, tube = Camera(AHEAD, 1.0, 0.2, 3.0), TrackingTube(0.01, 0.02)
    base = problem(SEEN, camera, tube)
    others = [
        problem(dataclasses.replace(SEEN, marker=(0.5, 0.1)), camera, tube),
        problem(dataclasses.replace(SEEN, visible_distance=1.0), camera, tube),
        problem(dataclasses.replace(SEEN, blind_distance=0.1), camera, tube),
        problem(SEEN, dataclasses.replace(camera, mount=Pose2(0.3, 0.0, 0.1)), tube),
        problem(SEEN, dataclasses.replace(camera, field_of_view=1.1), tube),
        problem(SEEN, dataclasses.replace(camera, min_range=0.1), tube),
        problem(SEEN, dataclasses.replace(camera, max_range=2.0), tube),
        # A tube as wide as the other one, of other numbers.
        problem(SEEN, camera, TrackingTube(tube.width(OUTLINE), 0.0)),
    ]
    for other in others:
        assert other.fingerprint != base.fingerprint
    assert problem(SEEN, Camera(AHEAD, 1, 0.2, 3), tube).fingerprint == base.fingerprint


def test_the_required_margin_covers_every_pose_within_the_tube():
    camera, tube = Camera(AHEAD, 1.0, 0.2, 3.0), TrackingTube(0.04, 0.06)
    task, rng = problem(SEEN, camera, tube), np.random.default_rng(5)
    view = task.required_view
    poses = np.column_stack((rng.uniform(-2.5, 0, 400), rng.uniform(-1, 1, 400), rng.uniform(-0.6, 0.6, 400)))
    from_marker = np.hypot(*(poses[:, :2] - view.marker).T)
    far = np.full(400, 10.0)  # from the goal, where the tube has its whole width, and from the start
    required = task.required_view_margin(far, far, from_marker)
    enough = view.margins(poses).smallest >= required
    direction, turn = rng.uniform(-np.pi, np.pi, 400), rng.choice([-tube.yaw, tube.yaw], 400)
    off = poses + np.column_stack((tube.cross * np.cos(direction), tube.cross * np.sin(direction), turn))
    seen = view.margins(off).smallest
    assert enough.sum() > 50
    assert np.all(seen[enough] >= 0.0)
    assert np.any(seen[view.margins(poses).smallest >= 0.0] < 0.0)  # without the margin some lose it


def test_the_tube_tapers_at_the_dock_and_near_a_tight_start():
    camera, tube = Camera(AHEAD, 1.0), TrackingTube(0.04, 0.06)
    task = problem(SEEN, camera, tube)
    far, none = np.array([10.0]), np.zeros(1)
    whole = task.required_view_margin(far, far, np.ones(1))[0]
    assert whole == pytest.approx(0.04 + 2.0 * math.sin(0.03))
    assert task.required_view_margin(none, far, np.ones(1)) == pytest.approx(0.0)
    blind = task.starting_at(Pose2(-2.0, 0.3, 3.0))
    assert blind.required_view_margin(far, none, np.ones(1)) == pytest.approx(0.0)
    assert blind.required_view_margin(far, np.array([0.02]), np.ones(1)) == pytest.approx(0.01)
