"""Which near pairs get rows: all of few, the telling ones of many."""

import dataclasses

import numpy as np
import pytest

from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.pose import Pose2, transform_points
from optdock.obstacles import ObstacleSet
from optdock.testing.families import instance
from smoothers._ck.initial import Resolution, Tuning, make_task
from smoothers._ck.nearby import Pairs, frames_at, swept_boxes, swept_pairs
from smoothers._ck.planes import clearance
from smoothers._ck.rollout import roll_out
from smoothers._ck.terms import Weights
from smoothers._ck.watched import local_minima, watched_pairs
from smoothers._ck.world import world_around

MOST = 133


def driven(family, seed, interval=0.08, **changes):
    """The first guess for an instance: its world, layout, drive and gears."""
    case = instance(family, seed)
    positions = case.raw_path.sample(0.1).poses[:, :2]
    world = dataclasses.replace(world_around(case.problem, positions, 1.0), **changes)
    task = make_task(case.raw_path, case.problem, world, Tuning(Resolution(24, 0.8, interval), Weights()), None)
    return world, task.layout, roll_out(task.layout, task.initial, task.ends.start, task.ends.signs), task.ends.signs


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


def test_few_pairs_are_all_watched():
    world, layout, rollout, signs = driven("narrow_gap", 0)
    found = clearance(world, layout, rollout, signs, 0.3)
    watched = watched_pairs(world, found, 200, MOST)
    assert found.margin.size > 20
    assert np.sort(np.concatenate(watched)).tolist() == list(range(found.margin.size))


def test_of_many_pairs_the_closest_of_every_small_obstacle_is_watched():
    world, layout, rollout, signs = driven("clutter", 3)
    found = clearance(world, layout, rollout, signs, 0.3)
    watched = watched_pairs(world, found, layout.num_intervals, MOST)
    assert 10 < watched.planes.size < 60 < found.margin.size
    nearest = {}
    for k in np.setdiff1d(np.arange(found.margin.size), watched.discs):
        rock = found.pairs.obstacle[k]
        if rock not in nearest or found.margin[k] < found.margin[nearest[rock]]:
            nearest[rock] = k
    touched = set(found.pairs.obstacle[watched.discs].tolist())
    assert {k for rock, k in nearest.items() if rock not in touched} <= set(watched.planes.tolist())


def test_a_path_that_is_nearly_clear_slides_along_all_of_them():
    world, layout, rollout, signs = driven("clutter", 3)
    found = clearance(world, layout, rollout, signs, 0.3)
    clear = found._replace(margin=found.margin - found.margin.min())
    assert watched_pairs(world, clear, layout.num_intervals, MOST).planes.size == 80
    thorough = dataclasses.replace(world, is_thinned=False)
    assert watched_pairs(thorough, found, layout.num_intervals, MOST).planes.size == 80


def test_never_more_than_there_is_room_for():
    world, layout, rollout, signs = driven("clutter", 3, is_thinned=False, per_interval=20)
    found = clearance(world, layout, rollout, signs, 0.4)
    watched = watched_pairs(world, found, 1000, MOST)
    assert found.margin.size > 3 * MOST
    assert watched.planes.size == MOST
    left_out = np.setdiff1d(np.arange(found.margin.size), np.concatenate(watched))
    assert found.margin[left_out].min() >= found.margin[watched.planes].max()


def test_a_wall_is_watched_all_along():
    case = instance("clutter", 3)
    goal = case.problem.goal
    along, across = np.array([np.cos(goal.yaw), np.sin(goal.yaw)]), np.array([-np.sin(goal.yaw), np.cos(goal.yaw)])
    corners = [(-3.0, 0.36), (0.6, 0.36), (0.6, 0.46), (-3.0, 0.46)]
    wall = np.array([goal.x, goal.y]) + [x * along + y * across for x, y in corners]
    problem = dataclasses.replace(case.problem, obstacles=case.problem.obstacles + ObstacleSet.from_polygons([wall]))
    world, layout, rollout, signs = driven("clutter", 3, obstacles=problem.obstacles)
    found = clearance(world, layout, rollout, signs, 0.3)
    watched = watched_pairs(world, found, layout.num_intervals, MOST)
    of_wall = np.flatnonzero(found.pairs.obstacle == len(problem.obstacles) - 1)
    free_of_discs = np.setdiff1d(of_wall, watched.discs)
    assert free_of_discs.size > 10
    assert watched.planes.size < 80
    assert set(free_of_discs.tolist()) <= set(watched.planes.tolist())


@pytest.mark.parametrize("family", ["corridor", "car_bay", "parallel", "angled_hexagon"])
def test_the_swept_box_holds_the_body_everywhere_in_its_interval(family):
    world, layout, rollout, signs = driven(family, 1)
    middle, half = swept_boxes(world, layout, rollout, frames_at(world, rollout.poses))
    parts = len(world.body.vertices)
    for interval in range(layout.num_intervals):
        left = layout.left[interval]
        ends, step = rollout.curvature[left : left + 2], rollout.steps[interval]
        spline = ClothoidSpline(Pose2(0.0, 0.0, 0.0), [0.0, step], ends, int(signs[layout.interval_gear[interval]]))
        for part in range(parts):
            swept = transform_points(spline.poses_at(np.linspace(0.0, step, 15)), world.body.vertices[part])
            box = part * layout.num_intervals + interval
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
    world, layout, rollout, _ = driven("long_approach", 0, 0.06, obstacles=obstacles)
    pairs_found = swept_pairs(world, layout, rollout, frames_at(world, rollout.poses), 50.0)
    count = np.bincount(pairs_found.interval, minlength=layout.num_intervals)
    assert layout.num_intervals > 150
    assert count.min() >= min(walls, world.per_interval)
    assert count.max() <= min(walls, 4 * world.per_interval)
