"""Without required clearance no deep overlap is hidden in the seams of footprints, obstacles and maps."""

import itertools

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2, transform_points
from optdock.model.cell_obstacles import obstacles_from_costmap
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.costmap import Costmap
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.path import ClothoidSegment, Path
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.verification import certify_path, contact_tolerance, pose_clearance, pose_clearances
from optdock.verification.certificate import TOLERANCE

TOUCHING = ClearanceRule(0.0, 0.0, 0.0)


def box(x0, y0, x1, y1):
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])


def map_with(rows):
    """Cells of 1 m, row 0 the lowest; two rectangles meet where runs of one row end otherwise than in the next."""
    return obstacles_from_costmap(Costmap(np.array(rows) * 254, 1.0, (0.0, -1.0)), border=False)


# Walls whose front is x = 0 around the origin, each with a seam there.
FRONTS = {
    "two boxes": ObstacleSet.from_polygons([box(0, -1, 1, 0), box(0, 0, 1, 1)]),
    "a crack of rounding": ObstacleSet.from_polygons([box(0, -1, 1, -1e-15), box(0, 1e-15, 1, 1)]),
    "boxes of two sets": ObstacleSet.from_polygons([box(0, -1, 1, 0)]) + ObstacleSet.from_polygons([box(0, 0, 1, 1)]),
    "rows of a map": map_with([[1, 1], [1, 0]]),
    "thin plates": ObstacleSet.from_polygons([box(0, 1e-5 * k, 1, 1e-5 * (k + 1)) for k in range(-20, 20)]),
    "one that is not convex": ObstacleSet.from_polygons([[[0, -1], [1, -1], [1, 1], [0.5, 1], [0.5, 0.3], [0, 0.3]]]),
}


def straight_in(depth, footprint, obstacles, y=0.0):
    """Certify a straight drive until the body's x = 0.3 is `depth` behind the front."""
    spline = ClothoidSpline(Pose2(-1.3 + depth, y, 0.0), [0.0, 1.0], [0.0, 0.0])
    path = Path((ClothoidSegment(spline),))
    return certify_path(
        path, DockingProblem(path.start, Dock(path.end), Robot(footprint, MotionLimits()), obstacles, TOUCHING)
    )


def needle(degrees):
    half = 0.3 * np.tan(np.radians(degrees) / 2.0)
    return Footprint([[0.3, 0.0], [0.0, half], [-0.3, 0.2], [-0.3, -0.2], [0.0, -half]])


@pytest.mark.parametrize("degrees", [90.0, 2.0, 0.01])
@pytest.mark.parametrize("front", sorted(FRONTS))
def test_no_needle_enters_along_a_seam(front, degrees):
    for y in (0.0,) if front != "one that is not convex" else (0.0, 0.2999, -0.3333):
        assert straight_in(0.0, needle(degrees), FRONTS[front], y).certified
        assert straight_in(0.9e-6, needle(degrees), FRONTS[front], y).certified
        refused = straight_in(3e-6, needle(degrees), FRONTS[front], y)
        assert [violation.kind for violation in refused.violations] == ["clearance"]
        assert refused.violations[0].where["obstacle"]
        assert pose_clearance(refused_pose(refused), needle(degrees), FRONTS[front])[0] < -1e-6


def refused_pose(certificate):
    return Pose2(*certificate.violations[0].where["pose"])


def test_a_needle_that_crosses_a_seam_during_the_motion_is_found():
    """The needle swings through the seam; the overlap is shallow at both ends of the path."""
    thin = Footprint([[1.0, 0.0], [0.0, 2e-7], [-0.1, 0.1], [-0.1, -0.1], [0.0, -2e-7]])
    spline = ClothoidSpline(Pose2(0.0, -0.01, -0.2), [0.0, 0.02], [20.0, 20.0])
    path = Path((ClothoidSegment(spline),))
    rocks = ObstacleSet.from_polygons([box(0.9999, -0.3, 1.5, -0.1), box(0.9999, -0.1, 1.5, 0.1)])
    problem = DockingProblem(path.start, Dock(path.end), Robot(thin, MotionLimits()), rocks, TOUCHING)
    assert "clearance" in [violation.kind for violation in certify_path(path, problem).violations]


@pytest.mark.parametrize("count", [8, 60])
def test_no_post_hides_in_a_fan_of_slivers(count):
    """A notch opposite a far corner decomposes the footprint into thin triangles that meet there."""
    angle = np.linspace(-0.4, 0.4, count)
    arc = np.column_stack((3.0 - 2.6 * np.cos(angle), 2.6 * np.sin(angle)))
    fan = Footprint(np.vstack((arc, [[-0.5, arc[-1, 1]], [-0.5, arc[0, 1]]])))
    outline = shapely.Polygon(fan.vertices)
    rng = np.random.default_rng(count)
    tried = 0
    for corner in fan.vertices[[0, count - 1, count, count + 1]]:
        for _ in range(25):
            post = corner + 10.0 ** rng.uniform(-5.0, -2.0) * rng.normal(size=2)
            if outline.contains(shapely.Point(post)) and outline.exterior.distance(shapely.Point(post)) > 3e-6:
                rock = ObstacleSet.from_polygons([post + 10.0 ** rng.uniform(-9.0, -6.0) * box(-0.5, -0.5, 0.5, 0.5)])
                assert pose_clearance(Pose2(0.0, 0.0, 0.0), fan, rock)[0] < -1e-6
                tried += 1
    assert tried > 8


@pytest.mark.parametrize("front", sorted(FRONTS))
@pytest.mark.parametrize("into", [0.0, 0.9e-6])
def test_contact_with_a_front_is_no_overlap(front, into):
    """The side slides along the front, across corners and seams."""
    body = Footprint.rectangle(0.2, 0.2, 0.4)
    ell = Footprint([[0.2, 0.2], [-0.2, 0.2], [-0.2, -0.2], [0.1, -0.2], [0.1, 0.0], [0.2, 0.0]])
    for footprint in (body, ell):
        spline = ClothoidSpline(Pose2(-0.2 + into, -0.5, np.pi / 2), [0.0, 0.6], [0.0, 0.0])
        path = Path((ClothoidSegment(spline),))
        problem = DockingProblem(path.start, Dock(path.end), Robot(footprint, MotionLimits()), FRONTS[front], TOUCHING)
        certificate = certify_path(path, problem)
        assert certificate.certified, certificate.reason


@settings(max_examples=25)
@given(st.integers(0, 1_000_000))
def test_accepted_poses_have_no_deep_overlap(seed):
    """Random touching triangles and a star in contact with them, compared with shapely's offset curves."""
    rng = np.random.default_rng(seed)
    centre, ring = rng.uniform(-0.2, 0.2, 2), rng.uniform(0.0, 2.0 * np.pi, 5)
    corners = (
        centre + rng.uniform(0.3, 1.0, 5)[:, None] * np.column_stack((np.cos(ring), np.sin(ring)))[np.argsort(ring)]
    )
    rocks = [np.array([centre, a, b]) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
    rocks = [rock for rock in rocks if shapely.Polygon(rock).area > 1e-4]
    if not rocks:
        return
    angle = np.sort(rng.uniform(0.0, 2.0 * np.pi, 7))
    star = rng.uniform(0.1, 0.6, 7)[:, None] * np.column_stack((np.cos(angle), np.sin(angle)))
    if not shapely.Polygon(star).is_valid or shapely.Polygon(star).area < 1e-3:
        return
    footprint, obstacles = Footprint(star), ObstacleSet.from_polygons(rocks)
    heading, yaw = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.0, 2.0 * np.pi)
    low, high = 0.0, 3.0  # distance from the middle of the rocks along the heading, until just free
    for _ in range(24):
        middle = 0.5 * (low + high)
        pose = Pose2(*(centre + middle * np.array([np.cos(heading), np.sin(heading)])), yaw)
        low, high = (low, middle) if pose_clearance(pose, footprint, obstacles)[0] >= -1e-6 else (middle, high)
    pose = Pose2(*(centre + high * np.array([np.cos(heading), np.sin(heading)])), yaw)
    robot = shapely.Polygon(transform_points(pose.as_array()[None], footprint.vertices)[0])
    rock = shapely.union_all([shapely.Polygon(one).buffer(1e-8, join_style="mitre") for one in rocks])
    assert robot.buffer(-2.2e-6).intersection(rock.buffer(-1e-8)).area < 1e-18
    assert robot.intersection(rock.buffer(-2.3e-6)).area < 1e-18


def test_accepted_contact_does_not_reach_the_core():
    """The core of a footprint is twice as deep as the tolerance of certificates."""
    assert contact_tolerance.DEPTH == 2.0 * TOLERANCE


@given(st.integers(0, 2**32))
@settings(max_examples=5)
def test_cached_cores_give_the_clearance_of_a_single_pose(seed):
    """Poses near each other share a core, also at the borders of its lattice; a subset has cores of its own."""
    random = np.random.default_rng(seed)
    lattice = contact_tolerance._LATTICE
    corner = lattice * random.integers(-3, 4) + random.choice([0.0, 1e-9, -1e-9, 0.4 * lattice])
    seams = np.concatenate(([corner], corner + np.cumsum(random.uniform(0.02, 0.4, 6))))
    walls = [box(0.0, low, 1.0, high) for low, high in itertools.pairwise(seams)]
    footprint = needle(random.uniform(0.1, 2.0))  # shallow in each wall
    depths = random.choice([0.0, 0.5e-6, 1.5e-6, 1e-4], 8)
    poses = np.column_stack((depths - 0.3, random.choice(seams, 8), np.zeros(8)))
    every = ObstacleSet.from_polygons(walls)
    for obstacles, pieces in ((every, walls), (every.subset(np.arange(0, 6, 2)), walls[::2])):
        together, _ = pose_clearances(poses, footprint, obstacles)
        again, _ = pose_clearances(poses[::-1], footprint, obstacles)
        assert np.array_equal(together, again[::-1])
        for pose, found in zip(poses, together, strict=True):
            alone, _ = pose_clearances(pose[None], footprint, ObstacleSet.from_polygons(pieces))
            assert found == pytest.approx(alone[0], abs=1e-7)
            assert (found >= -TOLERANCE) == (alone[0] >= -TOLERANCE)


def test_guesses_may_omit_the_check_of_unions():
    """The needle is a tenth of a micrometre in each box, but 0.1 mm in their union."""
    pose, footprint = np.array([[-0.3 + 1e-4, 0.0, 0.0]]), needle(0.1)
    checked, _ = pose_clearances(pose, footprint, FRONTS["two boxes"])
    omitted, _ = pose_clearances(pose, footprint, FRONTS["two boxes"], checks_unions=False)
    assert -TOLERANCE < omitted[0] < 0.0
    assert checked[0] < -TOLERANCE
