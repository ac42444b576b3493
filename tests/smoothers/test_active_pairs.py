"""Which near pairs get rows: all of few, the telling ones of many."""

import dataclasses

import numpy as np
import pytest

from experiments.families import instance
from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2, transform_points
from smoothers.scp.collision.broad_phase import Pairs, broad_phase, swept_boxes
from smoothers.scp.collision.collision_scene import body_at_nodes, scene_around
from smoothers.scp.collision.linearization import active_pairs, local_minima
from smoothers.scp.collision.narrow_phase import narrow_phase
from smoothers.scp.cost import Weights
from smoothers.scp.initial_guess import InitialGuesses
from smoothers.scp.nlp import Formulation, formulate
from smoothers.scp.rollout import roll_out
from smoothers.scp.settings import DEFAULT_SETTINGS

MOST = 133


def clearance(scene, basis, rollout, signs, reach):
    """Both phases."""
    body = body_at_nodes(scene, rollout.poses)
    return narrow_phase(scene, basis, rollout, signs, body, broad_phase(scene, basis, rollout, body, reach))


def driven(family, seed, interval=0.08, obstacles=None, **changes):
    """The first guess for an instance: its scene, basis, drive and gears."""
    case = instance(family, seed)
    positions = case.raw_path.sample(0.1).poses[:, :2]
    settings = dataclasses.replace(DEFAULT_SETTINGS.collision, **changes)
    scene = scene_around(case.problem, positions, 1.0, settings)
    scene = scene if obstacles is None else dataclasses.replace(scene, obstacles=obstacles)
    nlp = formulate(case.raw_path, case.problem, scene, Formulation(Weights(), 24, interval), None, DEFAULT_SETTINGS)
    variables = InitialGuesses(nlp).first.variables
    return scene, nlp.basis, roll_out(nlp.basis, variables, nlp.ends.start, nlp.ends.signs), nlp.ends.signs


def pairs(*rows):
    return Pairs(*np.array(rows).T)


def test_a_local_minimum_is_per_part_and_obstacle_along_the_path():
    near = pairs((3, 0, 0), (4, 0, 0), (5, 0, 0), (4, 0, 1), (5, 0, 1), (4, 1, 0), (9, 0, 0))
    margin = np.array([0.3, 0.1, 0.2, 0.5, 0.4, 0.6, 0.9])
    assert local_minima(near, margin).tolist() == [False, True, False, False, True, True, True]
    two_parts = pairs((3, 0, 0), (4, 1, 0))
    assert local_minima(two_parts, np.array([0.3, 0.1])).all()


@pytest.mark.parametrize("seed", range(4))
def test_the_order_of_pairs_does_not_matter(seed):
    rng = np.random.default_rng(seed)
    rows = np.unique(rng.integers(0, 6, (60, 3)), axis=0)
    margin, shuffled = rng.normal(size=len(rows)), rng.permutation(len(rows))
    found = local_minima(pairs(*rows), margin)
    assert (local_minima(pairs(*rows[shuffled]), margin[shuffled]) == found[shuffled]).all()
    for row, value, lowest in zip(rows, margin, found, strict=True):
        beside = np.abs(rows[:, 0] - row[0]) == 1
        same = (rows[:, 1:] == row[1:]).all(axis=1)
        assert lowest == bool((margin[beside & same] >= value).all())


def test_few_pairs_are_all_active():
    scene, basis, rollout, signs = driven("narrow_gap", 0)
    found = clearance(scene, basis, rollout, signs, 0.3)
    active = active_pairs(scene, found, 200, MOST)
    assert found.margin.size > 20
    assert np.sort(np.concatenate(active)).tolist() == list(range(found.margin.size))


def test_of_many_pairs_the_closest_of_every_small_obstacle_is_active():
    scene, basis, rollout, signs = driven("clutter", 3)
    found = clearance(scene, basis, rollout, signs, 0.3)
    active = active_pairs(scene, found, basis.num_intervals, MOST)
    assert 10 < active.separated.size < found.margin.size / 4
    nearest = {}
    for k in np.setdiff1d(np.arange(found.margin.size), active.penetrating):
        rock = found.pairs.obstacle[k]
        if rock not in nearest or found.margin[k] < found.margin[nearest[rock]]:
            nearest[rock] = k
    touched = set(found.pairs.obstacle[active.penetrating].tolist())
    assert {k for rock, k in nearest.items() if rock not in touched} <= set(active.separated.tolist())


def test_a_path_that_is_nearly_clear_slides_along_all_of_them():
    scene, basis, rollout, signs = driven("clutter", 3)
    found = clearance(scene, basis, rollout, signs, 0.3)
    clear = found._replace(margin=found.margin - found.margin.min())
    assert active_pairs(scene, clear, basis.num_intervals, MOST).separated.size == 80
    settings = dataclasses.replace(scene.settings, thins_small_obstacles=False)
    thorough = dataclasses.replace(scene, settings=settings)
    assert active_pairs(thorough, found, basis.num_intervals, MOST).separated.size == 80


def test_never_more_than_there_is_room_for():
    scene, basis, rollout, signs = driven("clutter", 3, thins_small_obstacles=False, nearest=20)
    found = clearance(scene, basis, rollout, signs, 0.4)
    active = active_pairs(scene, found, 1000, MOST)
    assert found.margin.size > 3 * MOST
    assert active.separated.size == MOST
    left_out = np.setdiff1d(np.arange(found.margin.size), np.concatenate(active))
    assert found.margin[left_out].min() >= found.margin[active.separated].max()


def test_a_wall_is_active_all_along():
    case = instance("clutter", 3)
    goal = case.problem.goal
    along, across = np.array([np.cos(goal.yaw), np.sin(goal.yaw)]), np.array([-np.sin(goal.yaw), np.cos(goal.yaw)])
    corners = [(-3.0, 0.36), (0.6, 0.36), (0.6, 0.46), (-3.0, 0.46)]
    wall = np.array([goal.x, goal.y]) + [x * along + y * across for x, y in corners]
    problem = dataclasses.replace(case.problem, obstacles=case.problem.obstacles + ObstacleSet.from_polygons([wall]))
    scene, basis, rollout, signs = driven("clutter", 3, obstacles=problem.obstacles)
    found = clearance(scene, basis, rollout, signs, 0.3)
    active = active_pairs(scene, found, basis.num_intervals, MOST)
    of_wall = np.flatnonzero(found.pairs.obstacle == len(problem.obstacles) - 1)
    free_of_discs = np.setdiff1d(of_wall, active.penetrating)
    assert free_of_discs.size > 10
    assert active.separated.size < 80
    assert set(free_of_discs.tolist()) <= set(active.separated.tolist())


@pytest.mark.parametrize("family", ["corridor", "car_bay", "parallel", "angled_hexagon"])
def test_the_swept_box_holds_the_body_everywhere_in_its_interval(family):
    scene, basis, rollout, signs = driven(family, 1)
    middle, half = swept_boxes(scene, basis, rollout, body_at_nodes(scene, rollout.poses))
    parts = len(scene.body.vertices)
    for interval in range(basis.num_intervals):
        left = basis.left[interval]
        ends, step = rollout.curvature[left : left + 2], rollout.steps[interval]
        spline = ClothoidSpline(Pose2(0.0, 0.0, 0.0), [0.0, step], ends, int(signs[basis.interval_gear[interval]]))
        for part in range(parts):
            swept = transform_points(spline.poses_at(np.linspace(0.0, step, 15)), scene.body.vertices[part])
            box = part * basis.num_intervals + interval
            assert (np.abs(swept[..., 0] - middle.x[box]) <= half.x[box] + 1e-8).all()
            assert (np.abs(swept[..., 1] - middle.y[box]) <= half.y[box] + 1e-8).all()
            # And it is tight: a few centimetres at most beyond what is swept.
            assert 2.0 * half.x[box] <= np.ptp(swept[..., 0]) + 0.02
            assert 2.0 * half.y[box] <= np.ptp(swept[..., 1]) + 0.02


@pytest.mark.parametrize("walls", [1, 2, 3, 12, 13])
def test_a_long_path_between_few_walls_keeps_the_nearest(walls):
    """Hundreds of near pairs, and hardly more obstacles than are watched in each interval."""
    case = instance("long_approach", 0)
    start = case.raw_path.start
    offsets = (0.1 * (1 + k // 2) * (-1.0) ** k for k in range(walls))
    bars = np.array([[-1.0, 0.0], [14.0, 0.0], [14.0, 0.01], [-1.0, 0.01]])
    obstacles = ObstacleSet.from_polygons([bars + np.array([start.x, start.y + offset]) for offset in offsets])
    scene, basis, rollout, _ = driven("long_approach", 0, 0.06, obstacles=obstacles)
    pairs_found = broad_phase(scene, basis, rollout, body_at_nodes(scene, rollout.poses), 50.0)
    count = np.bincount(pairs_found.interval, minlength=basis.num_intervals)
    assert basis.num_intervals > 150
    assert count.min() >= min(walls, scene.settings.nearest)
    assert count.max() <= min(walls, 4 * scene.settings.nearest)
