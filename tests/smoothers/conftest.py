"""Small problems for the tests of the sequential convex smoother."""

import itertools
from types import SimpleNamespace

import numpy as np
import pytest

from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.path import Path
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from smoothers.scp.basis import basis_for
from smoothers.scp.rollout import Variables

FORWARD_TWICE = ((6, 2), (5, 3))
L_SHAPE = np.array([[0.5, 0.3], [0.1, 0.3], [0.1, 0.5], [-0.4, 0.5], [-0.4, -0.3], [0.5, -0.3]])


def random_variables(basis, rng, bend=1.0):
    curvature = rng.uniform(-bend, bend, basis.num_knots)
    return Variables(curvature, rng.uniform(0.8, 2.0, basis.num_gears))


def random_path(seed, shape=FORWARD_TWICE, signs=(1.0, -1.0)):
    rng = np.random.default_rng(seed)
    basis = basis_for(shape)
    start = np.array([*rng.uniform(-1.0, 1.0, 2), rng.uniform(-3.0, 3.0)])
    return basis, random_variables(basis, rng), start, np.array(signs)


def open_problem(goal, *, obstacles=(), footprint=None, start=None, start_curvature=None, **limits):
    """A robot of 0.9 m x 0.6 m from the origin to `goal`, with a final straight of 0.3 m."""
    bounds = {"max_curvature": 1.5, "max_curvature_rate": 6.0, **limits}
    robot = Robot(footprint or Footprint.rectangle(0.45, 0.45, 0.6), MotionLimits(**bounds))
    return DockingProblem(
        start or Pose2(0.0, 0.0, 0.0),
        Dock(goal, final_straight=0.3),
        robot,
        ObstacleSet.from_polygons(obstacles),
        ClearanceRule(0.05, 0.0, 0.5),
        start_curvature=start_curvature,
    )


def kinked(*points):
    """A polyline path through points (x, y), with the yaw of each step and kinks between them."""
    points = np.array(points, dtype=float)
    poses = []
    for a, b in itertools.pairwise(points):
        yaw = np.arctan2(b[1] - a[1], b[0] - a[0])
        poses += [[*(a + share * (b - a)), yaw] for share in np.linspace(0.0, 1.0, 12)]
    return Path.from_poses(np.array(poses))


@pytest.fixture(scope="session")
def cases():
    """Builders of small problems."""
    return SimpleNamespace(
        random_variables=random_variables, random_path=random_path, open_problem=open_problem, kinked=kinked
    )
