"""From an input path, of any kind, to the solver's terms: reference, first variables, shape."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.pose import unwrap_yaw
from smoothers._ck.closing import Ends, clipped
from smoothers._ck.guesses import Guesses
from smoothers._ck.layout import layout_for
from smoothers._ck.task import Task, curvature_bound, reference_scales, variable_bounds
from smoothers._ck.terms import CostModel, Reference

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from optdock.path import Path
    from optdock.problem import DockingProblem
    from smoothers._ck.layout import Layout, Shape
    from smoothers._ck.terms import Weights
    from smoothers._ck.warm import Remaining
    from smoothers._ck.world import World

__all__ = ["Resolution", "Traced", "Tuning", "make_task", "shape_for", "trace"]


_MOST_SPANS = 80
_LESS_PATIENCE = 3  # with a second guess: most problems that got here have no answer
_PROX = 0.67  # [m]: first weight of squared motion, times the smallest radius
_WARM_TRUST, _WARM_PROX = 0.2, 0.067  # an earlier result is near the new one


class Resolution(NamedTuple):
    """Least number of spans of all gears together, longest span [m], and length of a collision interval [m]."""

    spans: int
    longest: float
    interval: float


class Tuning(NamedTuple):
    """How finely to solve, and what to prefer."""

    resolution: Resolution
    weights: Weights


class Traced(NamedTuple):
    """The input path at a layout's nodes, without its final straight.

    Attributes:
        positions: Shape (num_nodes, 2) [m].
        headings: Shape (num_intervals,) [rad], direction of each chord, continuous.
        end_yaw: Yaw of the input's last pose, continuous with the headings [rad].
    """

    positions: FloatArray
    headings: FloatArray
    end_yaw: float


def free_lengths(path: Path, final_straight: float) -> FloatArray:
    """Gear lengths of the input without its final straight. Shape (num_gears,) [m]."""
    lengths = np.array([segment.length for segment in path.segments])
    lengths[-1] = max(lengths[-1] - final_straight, 0.25 * lengths[-1], 0.01)
    kept: FloatArray = np.maximum(lengths, 0.01)
    return kept


def shape_for(lengths: FloatArray, resolution: Resolution) -> Shape:
    """Spans by share of length, at least 4 per gear, even where there are several gears; intervals per span."""
    total = float(lengths.sum())
    wanted = max(resolution.spans, min(_MOST_SPANS, math.ceil(total / resolution.longest)))
    spans = [max(4, 2 * round(0.5 * wanted * length / total)) for length in lengths]
    cells = [math.ceil(length / (q * resolution.interval)) for length, q in zip(lengths, spans, strict=True)]
    return tuple((q, min(max(r, 2), 12)) for q, r in zip(spans, cells, strict=True))


def trace(path: Path, layout: Layout, lengths: FloatArray, start_yaw: float) -> Traced:
    """The input at the nodes of `layout`; headings follow its motion, not its yaws."""
    poses = []
    for m, segment in enumerate(path.segments):
        share = layout.fraction[layout.node_gear == m]
        poses.append(segment.poses_at(share * min(lengths[m], segment.length)))
    nodes = np.concatenate(poses)
    nodes[:, 2] = unwrap_yaw(np.concatenate(([start_yaw], nodes[:, 2])))[1:]
    left = layout.left
    chord = nodes[left + 1, :2] - nodes[left, :2]
    signs = np.array([int(segment.direction) for segment in path.segments])[layout.interval_gear]
    direction = np.arctan2(signs * chord[:, 1], signs * chord[:, 0])
    yaw = 0.5 * (nodes[left, 2] + nodes[left + 1, 2])
    turned = np.remainder(direction - yaw + np.pi, 2.0 * np.pi) - np.pi
    moved = np.hypot(chord[:, 0], chord[:, 1]) > 1e-6
    return Traced(nodes[:, :2], yaw + np.where(moved, turned, 0.0), float(nodes[-1, 2]))


def reference_of(traced: Traced, layout: Layout) -> Reference:
    """Positions, and normals at the nodes from the mean of the neighbouring headings."""
    heading = np.empty(layout.num_nodes)
    heading[layout.left] = traced.headings
    heading[layout.last_nodes] = traced.headings[layout.last_nodes - np.arange(layout.num_gears) - 1]
    inner = layout.left[layout.fraction[layout.left] > 0.0]
    heading[inner] = 0.5 * (heading[inner] + heading[inner - 1])
    return Reference(traced.positions, np.column_stack((-np.sin(heading), np.cos(heading))))


def make_task(path: Path, problem: DockingProblem, world: World, tuning: Tuning, left: Remaining | None) -> Task:
    """The task of smoothing `path` for `problem`, from what is `left` of an earlier result if there is any."""
    limits, straight = problem.robot.limits, problem.dock.final_straight
    traced_lengths = free_lengths(path, straight)
    lengths = traced_lengths if left is None else left.lengths
    layout = layout_for(shape_for(lengths, tuning.resolution))
    start = problem.start.as_array()
    start[2] += 2.0 * np.pi * round((path.start.yaw - start[2]) / (2.0 * np.pi))
    traced = trace(path, layout, traced_lengths, start[2])
    radius = 1.0 / min(curvature_bound(limits), 2.0)
    ends = Ends(start, _target(problem, path, traced.end_yaw), _signs(path), 0.5 * radius)
    bounds, inner = variable_bounds(
        layout, limits, lengths, start_curvature=problem.start_curvature, straight_end=straight > 0.0
    )
    cost = CostModel(layout, tuning.weights, reference_scales(limits), reference_of(traced, layout))
    guesses = Guesses(layout, traced, lengths, ends, inner)
    cold = _restartable(
        Task(layout, ends, bounds, inner, cost, world, guesses.first, radius, prox=_PROX / radius), guesses
    )
    if left is None:
        return cold
    warm = clipped(left.variables(layout), inner)
    return replace(cold, initial=warm, restart=lambda _: cold, trust=_WARM_TRUST, prox=_WARM_PROX / radius)


def _restartable(task: Task, guesses: Guesses) -> Task:
    """The task with its other guess, for where an obstacle was met on its wrong side.

    A goal that is out of reach for the curvature stays so from elsewhere.
    """

    def again(on_goal: bool) -> Task | None:  # noqa: FBT001 - the form of Task.restart
        second = guesses.other() if on_goal else None
        return None if second is None else replace(task, initial=second, patience=_LESS_PATIENCE)

    return replace(task, restart=again)


def _signs(path: Path) -> FloatArray:
    return np.array([float(segment.direction) for segment in path.segments])


def _target(problem: DockingProblem, path: Path, end_yaw: float) -> FloatArray:
    """The goal moved back by the final straight, its yaw on the branch of the input's."""
    goal = problem.goal.as_array()
    back = float(path.segments[-1].direction) * problem.dock.final_straight
    goal[:2] -= back * np.array([np.cos(goal[2]), np.sin(goal[2])])
    goal[2] += 2.0 * np.pi * round((end_yaw - goal[2]) / (2.0 * np.pi))
    return goal
