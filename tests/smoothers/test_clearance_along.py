"""The kernel of the smoother's clearance: equal to the broad phase and the narrow phase by NumPy."""

import dataclasses
import shutil

import numpy as np
import pytest

from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.kernels import using_kernels
from optdock.model.clearance_rule import ClearanceRule
from smoothers.scp.collision.clearance_along import clearance_along
from smoothers.scp.collision.collision_scene import scene_around
from smoothers.scp.collision.linearization import separating_plane_rows
from smoothers.scp.rollout import roll_out, sensitivity
from smoothers.scp.settings import DEFAULT_SETTINGS

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")

L_SHAPE = np.array([[0.5, 0.3], [0.1, 0.3], [0.1, 0.5], [-0.4, 0.5], [-0.4, -0.3], [0.5, -0.3]])
OCTAGON = 0.4 * np.column_stack((np.cos(np.arange(8) * np.pi / 4), np.sin(np.arange(8) * np.pi / 4)))
CORNERS = (
    np.array([[0, 0], [1, 0], [1, 1], [0, 1]]),
    np.array([[1, 0.1], [0.2, 1], [-1, 0.3], [-0.3, -1], [0.6, -0.8]]),
)
FOOTPRINTS = {
    "box": Footprint.rectangle(0.45, 0.35, 0.6),
    "parts": Footprint(L_SHAPE),
    "octagon": Footprint(OCTAGON),
    "disc": Footprint.from_radius(0.4),
}
RULES = (ClearanceRule(0.0, 0.0, 0.0), ClearanceRule(0.05, 0.0, 0.5), ClearanceRule(0.1, 0.02, 0.3, at_start=0.01))


def flat(found):
    """All arrays of a result."""
    parts = []
    for part in found:
        parts += [np.asarray(one) for one in part] if isinstance(part, tuple) else [np.asarray(part)]
    return parts


@pytest.mark.parametrize("name", FOOTPRINTS)
@pytest.mark.parametrize("seed", range(12))
def test_both_lanes_are_equal_to_the_last_bit(cases, name, seed):
    rng = np.random.default_rng(seed)
    basis, variables, start, signs = cases.random_path(seed, ((6, 2), (5, 2)))
    rollout = roll_out(basis, variables, start, signs)
    places = rollout.poses[rng.integers(0, basis.num_nodes, 14), :2] + rng.uniform(-0.9, 0.9, (14, 2))
    unit = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    boxes = [place + unit * rng.uniform(0.02, 0.5) for place in places]
    goal = cases.open_problem(Pose2.from_sequence(rollout.poses[-1]), obstacles=boxes, footprint=FOOTPRINTS[name])
    problem = dataclasses.replace(goal, clearance=RULES[seed % 3])
    few = dataclasses.replace(DEFAULT_SETTINGS.collision, few_pairs=20 if seed % 2 else 150)
    scene = scene_around(problem, rollout.poses[:, :2], 0.02 * seed, few)
    scene = dataclasses.replace(scene, start_relief=0.5 if seed % 4 == 0 else 0.0)
    found = []
    for lane in ("twin", "native"):
        with using_kernels(lane):
            found.append(flat(clearance_along(scene, basis, rollout, signs, 0.3)))
    assert found[0][0].size > 10
    for a, b in zip(*found, strict=True):
        assert a.shape == b.shape
        assert np.ascontiguousarray(a).tobytes() == np.ascontiguousarray(b).tobytes()


@pytest.mark.parametrize("name", FOOTPRINTS)
@pytest.mark.parametrize("seed", range(6))
def test_rows_of_both_lanes_are_equal_to_the_last_bit(cases, name, seed):
    basis, variables, start, signs = cases.random_path(seed, ((6, 2), (5, 2)))
    rollout, rng = roll_out(basis, variables, start, signs), np.random.default_rng(seed)
    places = rollout.poses[rng.integers(0, basis.num_nodes, 14), :2] + rng.uniform(-0.9, 0.9, (14, 2))
    posts = [place + rng.uniform(0.02, 0.5) * CORNERS[rng.integers(2)] for place in places]
    problem = cases.open_problem(Pose2.from_sequence(rollout.poses[-1]), obstacles=posts, footprint=FOOTPRINTS[name])
    scene = scene_around(problem, rollout.poses[:, :2], 1.0, DEFAULT_SETTINGS.collision)
    with using_kernels("twin"):
        near = clearance_along(scene, basis, rollout, signs, 0.3)
    by = sensitivity(basis, variables, rollout)
    chosen, found = np.flatnonzero(rng.uniform(size=near.margin.size) < 0.7), []
    for lane in ("twin", "native"):
        with using_kernels(lane):
            found.append(separating_plane_rows(basis, rollout, by, near, chosen, scene.settings))
    assert chosen.size < found[0].gap.size < 3 * chosen.size
    for a, b in zip(*found, strict=True):
        assert a.dtype == b.dtype
        assert np.ascontiguousarray(a).tobytes() == np.ascontiguousarray(b).tobytes()


def test_without_obstacles_there_are_no_pairs(cases):
    basis, variables, start, signs = cases.random_path(1, ((6, 2), (5, 2)))
    rollout = roll_out(basis, variables, start, signs)
    problem = cases.open_problem(Pose2.from_sequence(rollout.poses[-1]))
    scene = scene_around(problem, rollout.poses[:, :2], 1.0, DEFAULT_SETTINGS.collision)
    for lane in ("twin", "native"):
        with using_kernels(lane):
            assert clearance_along(scene, basis, rollout, signs, 0.3).margin.size == 0
