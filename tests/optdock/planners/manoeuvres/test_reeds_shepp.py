"""Words reach their goal, obey the symmetries of the problem, and none is shorter than the shortest known."""

import math

import numpy as np
import pytest

from optdock.planners.manoeuvres.arcs import Arcs, advance
from optdock.planners.manoeuvres.reeds_shepp import TURNS, reeds_shepp_words

RADIUS = 1.5
# Goal x, y, yaw seen from the start, and the length that OMPL 2.0.1 gives for a turning radius of 1.5 m.
OMPL = (
    (2, 0, 0, 2.000000000),
    (-2, 0, 0, 2.000000000),
    (0, 1, 0, 3.284031798),
    (0, 0, 3.1, 4.650000000),
    (1, 1, 1.6, 2.400000000),
    (0.2, 0.3, 0.4, 1.311599622),
    (5, 3, -2.5, 7.508533553),
    (-4, 2, 2, 6.158878339),
    (0.5, -2.5, -1, 3.656205561),
    (3, -3, 3, 5.905131254),
    (-1, -1, -1, 3.080380816),
    (0.05, 0.4, 0, 2.093713821),
    (10, -7, 0.3, 12.479519169),
    (1.0, 0.1, -3.0, 4.500000000),
)


def shortest_length(starts, goals, radius):
    return np.nanmin(np.abs(reeds_shepp_words(starts, goals, radius)).sum(axis=2), axis=0)


def random_poses(count, seed):
    draw = np.random.default_rng(seed)
    return np.column_stack((draw.uniform(-5.0, 5.0, (count, 2)), draw.uniform(-7.0, 7.0, count)))


def folded(angle):
    return np.abs(angle - 2.0 * np.pi * np.round(angle / (2.0 * np.pi)))


def test_shortest_word_has_the_length_of_ompl():
    *goals, lengths = np.array(OMPL, dtype=float).T
    found = shortest_length(np.zeros((len(OMPL), 3)), np.column_stack(goals), RADIUS)
    np.testing.assert_allclose(found, lengths, atol=1e-8, rtol=0.0)


def test_every_word_leads_to_its_goal_and_every_form_occurs():
    starts, goals = random_poses(600, 1), random_poses(600, 2)
    lengths = reeds_shepp_words(starts, goals, 0.8)
    occurs = ~np.isnan(lengths).any(axis=2)
    assert lengths.shape == (44, 600, 5)
    assert occurs.any(axis=1).all()
    assert occurs.any(axis=0).all()
    form, pair = np.nonzero(occurs)
    arcs = Arcs(starts[pair], lengths[form, pair], TURNS[form] / 0.8)
    miss = arcs.joints()[:, -1] - goals[pair]
    assert np.abs(miss[:, :2]).max() <= 1e-9
    assert folded(miss[:, 2]).max() <= 1e-9


def test_no_path_of_few_arcs_that_is_drawn_at_random_is_shorter():
    draw = np.random.default_rng(3)
    starts = random_poses(3000, 4)
    lengths, curvatures = draw.uniform(-2.0, 2.0, (3000, 5)), draw.choice((-1.0, 0.0, 1.0), (3000, 5)) / RADIUS
    goals = Arcs(starts, lengths, curvatures).joints()[:, -1]
    assert np.all(shortest_length(starts, goals, RADIUS) <= np.abs(lengths).sum(axis=1) + 1e-9)


def test_lengths_obey_the_symmetries():
    goals = random_poses(300, 5)
    origin = np.zeros_like(goals)
    plain = shortest_length(origin, goals, RADIUS)
    for signs in ((-1.0, 1.0, -1.0), (1.0, -1.0, -1.0)):  # time reversal, reflection
        assert shortest_length(origin, goals * signs, RADIUS) == pytest.approx(plain, abs=1e-9)
    assert shortest_length(goals, origin, RADIUS) == pytest.approx(plain, abs=1e-9)


def test_lengths_scale_with_the_radius_and_grow_with_it():
    starts, goals = random_poses(200, 6), random_poses(200, 7)
    scale = np.array([2.0, 2.0, 1.0])
    plain = shortest_length(starts, goals, 1.0)
    assert shortest_length(starts * scale, goals * scale, 2.0) == pytest.approx(2.0 * plain)
    assert np.all(shortest_length(starts, goals, 1.25) >= plain - 1e-9)
    assert np.all(plain >= np.hypot(*(goals - starts)[:, :2].T) - 1e-9)


def test_arc_ends_where_many_small_steps_lead():
    start, length, curvature = np.array([[1.0, -2.0, 0.7]]), -1.7, 0.9
    steps = 100_000
    turn = length * curvature / steps
    middle = start[0, 2] + turn * (np.arange(steps) + 0.5)
    x, y = start[0, 0] + length / steps * np.cos(middle).sum(), start[0, 1] + length / steps * np.sin(middle).sum()
    pose = advance(start, np.array([length]), np.array([curvature]))[0]
    assert pose == pytest.approx((x, y, start[0, 2] + length * curvature), abs=1e-9)


def test_shares_and_even_spacing_show_the_same_way():
    arcs = Arcs(np.array([[0.0, 0.0, 0.3]]), np.array([[1.0, 0.0, -0.7, 2.0]]), np.array([[0.5, 0.5, -1.0, 0.0]]))
    ends = arcs.joints()[0]
    assert arcs.poses_at_shares(np.array([0.0, 1.0]))[0] == pytest.approx(ends[[0, -1]])
    assert arcs.poses_at_shares(np.array([1.7 / 3.7]))[0, 0] == pytest.approx(ends[3])
    dense = arcs.poses_every(0.01)
    assert np.hypot(*np.diff(dense[:, :2], axis=0).T).max() <= 0.01 + 1e-12
    for joint in ends:
        assert np.abs(dense - joint).sum(axis=1).min() <= 1e-12


def test_path_of_arcs_has_their_gears_lengths_and_curvature():
    arcs = Arcs(np.array([[0.0, 0.0, 0.0]]), np.array([[1.0, 0.5, -0.7, -0.3]]), np.array([[0.5, 0.0, -1.0, 1.0]]))
    path = arcs.path(0.02, arcs.joints()[0, -1] + (0.0, 0.0, 2.0 * math.pi), "hall")
    assert [int(segment.direction) for segment in path.segments] == [1, -1]
    assert [segment.length for segment in path.segments] == pytest.approx([1.5, 1.0])
    assert path.frame == "hall"
    # Along the travel, so that what steers right in reverse turns left.
    assert path.curvature_at([0.5, 1.25, 1.8, 2.4]) == pytest.approx([0.5, 0.0, 1.0, -1.0], abs=1e-6)
