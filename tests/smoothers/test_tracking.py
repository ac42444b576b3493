"""Tracking: the drivable path nearest to the input's positions, and programs with finer intervals."""

import functools
import math

import numpy as np
import pytest

from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import transform_points
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.path import Path
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.verification import pose_clearances
from smoothers.scp.collision.collision_scene import scene_around
from smoothers.scp.cost import Weights
from smoothers.scp.goal_projection import rate_is_kept
from smoothers.scp.initial_guess import InitialGuesses, largest_deviation, track
from smoothers.scp.loop import evaluated
from smoothers.scp.nlp import Formulation, formulate, with_intervals
from smoothers.scp.qp_step import pool_of_this_thread
from smoothers.scp.rollout import roll_out
from smoothers.scp.settings import DEFAULT_SETTINGS

CAR = Robot(Footprint.rectangle(3.7, 1.0, 2.0), MotionLimits(max_curvature=0.25, max_curvature_rate=0.44))
# Gear, curvature [1/m] and length [m]: words of full arcs, as Reeds-Shepp paths are, with pieces of a few decimetres.
WORDS = (
    ((1, 0.25, 5.0), (1, -0.25, 0.3), (1, 0.0, 9.0), (1, -0.25, 5.3), (1, 0.25, 0.4), (1, 0.0, 8.0)),
    ((1, -0.25, 5.0), (-1, 0.25, 0.5), (-1, 0.0, 7.5), (-1, -0.25, 6.0), (-1, 0.25, 0.5), (-1, 0.0, 6.0)),
    ((-1, 0.25, 3.0), (1, -0.25, 2.0), (-1, 0.25, 2.5), (-1, -0.25, 0.3), (-1, 0.0, 9.0), (-1, 0.25, 0.4)),
)


def driven_word(word, sign=1.0, spacing=0.02):
    """Poses along arcs; `sign` -1 mirrors it."""
    poses = [np.zeros(3)]
    for gear, curvature, length in word:
        for _ in range(round(length / spacing)):
            x, y, yaw = poses[-1]
            turned = yaw + 0.5 * sign * curvature * spacing
            step = gear * spacing
            poses.append(np.array([x + step * math.cos(turned), y + step * math.sin(turned), yaw]))
            poses[-1][2] += sign * curvature * spacing
    return np.array(poses)


def program_of(poses, obstacles=()):
    path = Path.from_poses(poses)
    problem = DockingProblem(path.start, Dock(path.end), CAR, obstacles)
    scene = scene_around(problem, poses[:, :2], 1.0, DEFAULT_SETTINGS.collision)
    return formulate(path, problem, scene, Formulation(Weights(), 24, 0.4), None, DEFAULT_SETTINGS)


def driven(nlp, variables):
    return roll_out(nlp.basis, variables, nlp.ends.start, nlp.ends.signs)


def tracked(nlp):
    return track(nlp, pool_of_this_thread(), InitialGuesses(nlp).fitted, 0.45, lambda: False)


@pytest.mark.parametrize("word", WORDS)
def test_tracking_stays_on_words_of_full_arcs_where_a_fit_of_headings_drifts(word):
    nlp = program_of(driven_word(word))
    variables = tracked(nlp)
    assert largest_deviation(nlp, driven(nlp, variables)) < 0.1
    assert largest_deviation(nlp, driven(nlp, variables)) < 0.5 * largest_deviation(
        nlp, driven(nlp, InitialGuesses(nlp).fitted)
    )
    assert np.abs(variables.curvature).max() <= 0.25
    assert rate_is_kept(nlp.basis, variables, nlp.bounds)


@pytest.mark.parametrize("word", WORDS)
def test_a_mirrored_input_is_tracked_by_the_mirrored_path(word):
    left, right = (tracked(program_of(driven_word(word, sign))) for sign in (1.0, -1.0))
    assert right.curvature == pytest.approx(-left.curvature, abs=1e-6)
    assert right.lengths == pytest.approx(left.lengths, abs=1e-6)


def test_a_drivable_input_is_not_moved():
    turned = np.linspace(0.0, 0.5, 60)
    poses = np.column_stack((8.0 * np.sin(turned), 8.0 - 8.0 * np.cos(turned), turned))
    nlp = program_of(poses)
    assert largest_deviation(nlp, driven(nlp, tracked(nlp))) < 1e-3


def test_it_stops_at_once_when_it_is_late():
    nlp = program_of(driven_word(WORDS[0]))
    fitted = InitialGuesses(nlp).fitted
    late = track(nlp, pool_of_this_thread(), fitted, 0.45, lambda: True)
    assert largest_deviation(nlp, driven(nlp, late)) > largest_deviation(nlp, driven(nlp, tracked(nlp)))


def test_the_tracked_guess_is_first_where_the_others_collide():
    poses = driven_word(WORDS[1])
    free = InitialGuesses(program_of(poses))
    begun = evaluated(free.nlp, np.concatenate(free.first.variables)).rollout.poses
    assert free.first.variables is free.pursued
    # Boxes where corners of the drive pass and the input does not.
    corners = transform_points(begun[::2], CAR.footprint.vertices).reshape(-1, 2)
    boxes = [ObstacleSet.from_rectangles(at[None] - 0.15, at[None] + 0.15, "box") for at in corners]
    beside = [box for box in boxes if pose_clearances(poses, CAR.footprint, box)[0].min() > 0.02]
    obstacles = functools.reduce(ObstacleSet.__add__, beside)
    guesses = InitialGuesses(program_of(poses, obstacles))
    assert guesses.first.variables is guesses.tracked
    assert guesses.on_the_input is None


def test_an_input_that_cannot_be_driven_is_not_tracked():
    straight = np.linspace(0.0, 6.0, 100)
    poses = np.column_stack((straight, np.where(straight > 3.0, 2.0 * (straight - 3.0), 0.0), np.zeros(100)))
    guesses = InitialGuesses(program_of(poses))
    assert guesses.first.variables is not guesses.tracked
    assert guesses.on_the_input is None


def test_finer_intervals_keep_the_path_and_the_input():
    nlp = program_of(driven_word(WORDS[1]))
    finer, variables = with_intervals(nlp, [3 * cells for _, cells in nlp.basis.shape]), tracked(nlp)
    same = np.concatenate([np.flatnonzero(finer.basis.node_gear == m)[::3] for m in range(finer.basis.num_gears)])
    np.testing.assert_allclose(driven(finer, variables).poses[same], driven(nlp, variables).poses, atol=1e-5)
    np.testing.assert_allclose(finer.traced.positions[same], nlp.traced.positions, atol=1e-12)
    assert finer.basis.num_intervals == 3 * nlp.basis.num_intervals
