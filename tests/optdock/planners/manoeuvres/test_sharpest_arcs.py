"""Ways away from a wall: every arc is free, none could be much sharper, full lock is reached, and mirrors agree."""

import math

import numpy as np
import pytest

from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.planners.manoeuvres.arcs import ArcTree, advance
from optdock.planners.manoeuvres.end_trees import sharpest_arcs
from optdock.planners.manoeuvres.manoeuvre_planner import Stages

CAR = Robot(Footprint.rectangle(0.7, 0.2, 0.6), MotionLimits(max_curvature=1.2, max_curvature_rate=6.0))


def beside(gap, side=1.0, wall=True):
    """A robot along a wall on its right, or on its left where `side` is -1."""
    y = -side * (0.3 + gap)
    corners = [[-20.0, y], [20.0, y], [20.0, y - side], [-20.0, y - side]]
    dock = Dock(Pose2(3.0, side * 5.0, side * 0.5 * math.pi))
    return DockingProblem(Pose2(0.0, 0.0, 0.0), dock, CAR, [corners] if wall else [], ClearanceRule(0.05, 0.0, 0.5))


def chains(problem):
    """The tree, the ends of the chains, and how closely they were looked at."""
    stages = Stages(problem, 1.25, lambda: None, lambda: math.inf)
    tree = ArcTree(problem.start.as_array(), CAR, 1)
    effort = stages._efforts[2]
    ends = sharpest_arcs(tree, np.zeros(2, dtype=np.int64), np.array([1.0, -1.0]), stages.space, effort)
    return tree, ends, stages.space, effort


@pytest.mark.parametrize("gap", [0.01, 0.02, 0.04])
def test_robot_along_a_wall_gets_away_from_it(gap):
    tree, ends, space, effort = chains(beside(gap))
    full = 1.0 / effort.radius
    signs = set()
    for end in ends.tolist():
        assert abs(tree.curvatures[end]) == full
        assert tree.poses[end, 2] * tree.signs[end] * np.sign(tree.curvatures[end]) > 0.0
        assert tree.poses[end, 1] > 0.05 - gap
        signs.add(tree.signs[end])
        row = end
        while row > 0:
            parent = int(tree.parents[row])
            lengths = np.linspace(0.0, tree.lengths[row], 200)
            poses = advance(tree.poses[parent][None], lengths, np.full(200, tree.curvatures[row]))
            assert space.is_free(poses, 0.0, effort.start_relief).all()
            if abs(tree.curvatures[row]) < 0.8 * full:  # the sharpest but for the steps in which it is looked for
                poses = advance(tree.poses[parent][None], lengths, np.full(200, 1.2 * tree.curvatures[row]))
                assert not space.is_free(poses, 1.1e-4, effort.start_relief).all()
            row = parent
    assert 1.0 in signs  # backward the nose swings out, which is further from the axle


def test_wall_on_the_other_side_gives_the_mirrored_arcs():
    (one, ends, _, _), (other, mirrored, _, _) = chains(beside(0.02)), chains(beside(0.02, side=-1.0))
    assert ends.size == mirrored.size > 0

    def found(tree, rows, side):
        return sorted(map(tuple, (tree.poses[rows] * [1.0, side, side]).round(9).tolist()))

    assert found(one, ends, 1.0) == found(other, mirrored, -1.0)


def test_in_the_open_full_lock_is_free_at_once():
    tree, ends, _, effort = chains(beside(0.02, wall=False))
    assert len(tree) - 1 == ends.size == 12  # three arcs to either side in either gear
    assert np.allclose(np.abs(tree.curvatures[1:]), 1.0 / effort.radius)


def test_no_chain_leads_out_without_slack():
    tree, ends, _, _ = chains(beside(0.0))
    assert ends.size == 0
    assert len(tree) == 1
