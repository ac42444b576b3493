"""Nonlinear program that smooths an input path for a docking problem.

    minimize    J(K, L)                                      (`cost`)
    subject to  |K| <= k_max, |K_(j+1) - K_j| <= s_max L / q, L > 0
                pose at the end = goal, moved back by the final straight
                clearance of the swept footprint >= required clearance       (`collision`)
                marker of the dock inside the camera's view                  (`visibility_constraint`)
                hard terms of the user >= 0; soft terms add to J             (`term_rows`)

K: curvatures at the knots, L: lengths of the gears. The final straight is given and has no variables.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.arrays import frozen, readonly
from optdock.geometry.lazy import cached_property
from optdock.geometry.pose import unwrap_yaw, wrap_angles
from optdock.model.constant_jerk import border_states, braking_phases
from optdock.model.path import PolylineSegment
from smoothers.scp.basis import basis_for, blocks_of
from smoothers.scp.cost import CostModel, InputNodes
from smoothers.scp.packed_program import packed

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from optdock.geometry.arrays import FloatArray, IntArray
    from optdock.model.limits import MotionLimits
    from optdock.model.path import Path
    from optdock.model.problem import DockingProblem
    from smoothers.scp.basis import Basis, Shape
    from smoothers.scp.collision.collision_scene import Scene
    from smoothers.scp.cost import Weights
    from smoothers.scp.packed_program import PackedProgram
    from smoothers.scp.rollout import Rollout
    from smoothers.scp.settings import BoundSettings, ResolutionSettings, Settings
    from smoothers.scp.term_rows import TermBound
    from smoothers.scp.visibility_constraint import ViewBound

__all__ = [
    "Ends",
    "Formulation",
    "NonlinearProgram",
    "TracedInput",
    "VariableBounds",
    "enclosing_positions",
    "formulate",
    "free_lengths",
]

_BRAKING_ROOM = 1.02  # times the braking distance: slack for the timing
_EASED_MOST = 0.0025  # least weight of the curvature rate: splines stay smooth even where the robot is at rest
# [1/m]: for a smaller largest curvature, lateral distances from the input are weighted in turning radii instead of
# metres.
_TRACKED = 1.5


@dataclass(frozen=True, eq=False)
class Ends:
    """Start pose, target pose and gears of the path."""

    start: FloatArray  # poses, Shape (3,) [m, m, rad]
    target: FloatArray
    signs: FloatArray  # gears, Shape (num_gears,)
    reach: float = 0.5  # largest goal error for Newton steps [m, rad]

    def error(self, rollout: Rollout) -> FloatArray:
        """Return the last pose minus the target, Shape (3,)."""
        difference: FloatArray = rollout.poses[-1] - self.target
        return difference


@dataclass(frozen=True, eq=False)
class VariableBounds:
    """Bounds of the variables and of the curvature rate."""

    lower: FloatArray  # bounds of knot curvatures and gear lengths, Shape (size,)
    upper: FloatArray
    rate: float  # largest curvature rate [1/m^2]; may be infinite


class TracedInput(NamedTuple):
    """The input path at the nodes, without its final straight."""

    positions: FloatArray  # Shape (num_nodes, 2) [m]
    headings: FloatArray  # direction of each chord, continuous, Shape (num_intervals,) [rad]
    end_yaw: float  # yaw of the input's last pose, continuous with the headings [rad]


@dataclass(frozen=True, eq=False)
class NonlinearProgram:
    """Cost and constraints of one smoothing problem."""

    basis: Basis
    ends: Ends  # start, target before the final straight, gears
    bounds: VariableBounds  # bounds that iterates keep exactly
    inner_bounds: VariableBounds  # slightly tighter bounds of the steps
    cost: CostModel
    scene: Scene  # obstacles and clearance rule
    traced: TracedInput  # input at the nodes
    lengths: FloatArray  # first gear lengths, Shape (num_gears,) [m]
    radius: float  # smallest turning radius, at least 0.5 m [m]
    settings: Settings
    view: ViewBound | None = None  # required view along the path, or None
    terms: TermBound | None = None  # costs and constraints of the user, or None

    @cached_property
    def packed(self) -> PackedProgram:
        """Constants of the program for kernels."""
        return packed(self)


class Formulation(NamedTuple):
    """Weights, smallest number of spans, and length of a collision interval [m], from the parameters."""

    weights: Weights
    spans: int
    interval: float


def formulate(  # noqa: PLR0913 - a problem, its scene, choices and a clock
    path: Path,
    problem: DockingProblem,
    scene: Scene,
    chosen: Formulation,
    lengths: FloatArray | None,
    settings: Settings,
    *,
    view: ViewBound | None = None,
    terms: TermBound | None = None,
    look: Callable[[], None] = lambda: None,
) -> NonlinearProgram:
    """Return the nonlinear program that smooths `path` for `problem`.

    Args:
        path: Input.
        problem: Constraints.
        scene: Obstacles around the input.
        chosen: Weights and resolution.
        lengths: First gear lengths, Shape (num_gears,) [m]; None means the lengths of the input.
        settings: Constants of the method.
        view: Required view along the path, or None.
        terms: Costs and constraints of the user, or None.
        look: Checks the deadline; called twice during the basis, which takes a millisecond if its shape is new.
    """
    limits, straight = problem.robot.limits, problem.dock.final_straight
    traced_lengths = free_lengths(path, straight)
    lengths = traced_lengths if lengths is None else lengths
    scales = _reference_scales(limits, settings.bounds)
    longest = settings.resolution.longest_span / scales[0]
    shape = shape_for(lengths, chosen, longest, settings.resolution)
    blocks_of(shape)
    look()
    basis = basis_for(shape, settings.resolution.fit_smoothing)
    look()
    start = problem.start
    yaw = start.yaw + 2.0 * math.pi * round((path.start.yaw - start.yaw) / (2.0 * math.pi))
    signs = np.array([float(segment.direction) for segment in path.segments])
    traced = trace(path, basis, traced_lengths, signs, yaw)
    most = min(limits.max_curvature, settings.bounds.curvature_cap)
    radius = 1.0 / min(most, 2.0)
    target = _target(problem, float(signs[-1]), traced.end_yaw)
    ends = Ends(np.array((start.x, start.y, yaw)), target, signs, settings.projection.reach * radius)
    cost = CostModel(
        basis,
        _scaled(chosen.weights, scales[0]),
        scales,
        _reference_of(traced, basis),
        _turning_at_cusps(limits, scales[0]),
        _easing(limits, basis, lengths),
    )
    bounds, inner = _variable_bounds(basis, problem, lengths, most, settings.bounds)
    return NonlinearProgram(basis, ends, bounds, inner, cost, scene, traced, lengths, radius, settings, view, terms)


@lru_cache(maxsize=4)
def _even_shares(count: int) -> FloatArray:
    return readonly(np.linspace(0.0, 1.0, count))


def enclosing_positions(path: Path, count: int) -> FloatArray:
    """Return positions whose box is that of a path: the poses of polylines, and `count` of every clothoid.

    Shape (n, 2) [m].
    """
    shares = _even_shares(count)
    poses = [
        part.poses if isinstance(part, PolylineSegment) else part.poses_at(shares * part.length)
        for part in path.segments
    ]
    return (poses[0] if len(poses) == 1 else np.concatenate(poses))[:, :2]


def with_intervals(nlp: NonlinearProgram, cells: Sequence[int]) -> NonlinearProgram:
    """Return the program with `cells` collision intervals in every span of each gear, and the same variables."""
    shape = tuple((spans, count) for (spans, _), count in zip(nlp.basis.shape, cells, strict=True))
    if shape == nlp.basis.shape:
        return nlp
    old, basis = nlp.basis, basis_for(shape, nlp.settings.resolution.fit_smoothing)
    # Fractional index of every new node among the old ones, which are evenly spaced in every gear.
    old_cells = old.divisions[:, 1]
    node = (old.last_nodes - old_cells)[basis.node_gear] + basis.fraction * old_cells[basis.node_gear]
    before = node.astype(np.int64)
    after, share = np.minimum(before + 1, old.num_nodes - 1), (node - before)[:, None]
    positions, normals = (values[before] + share * (values[after] - values[before]) for values in nlp.cost.reference)
    middles = 0.5 * (node[basis.left] + node[basis.left + 1])
    headings = np.interp(middles, old.left + 0.5, nlp.traced.headings)
    traced = TracedInput(positions, headings, nlp.traced.end_yaw)
    cost = replace(nlp.cost, basis=basis, reference=InputNodes(positions, normals))
    terms = None if nlp.terms is None else replace(nlp.terms, margins=None)
    return replace(nlp, basis=basis, cost=cost, traced=traced, terms=terms)


def free_lengths(path: Path, final_straight: float) -> FloatArray:
    """Return the gear lengths of the input without its final straight. Shape (num_gears,) [m]."""
    lengths = np.array([segment.length for segment in path.segments])
    lengths[-1] = max(lengths[-1] - final_straight, 0.25 * lengths[-1], 0.01)
    kept: FloatArray = np.maximum(lengths, 0.01)
    return kept


def shape_for(lengths: FloatArray, chosen: Formulation, longest: float, settings: ResolutionSettings) -> Shape:
    """Return the number of spans of each gear (at least four, proportional to length) and of intervals per span.

    Args:
        lengths: Lengths of the gears, Shape (num_gears,) [m].
        chosen: Least number of spans of all gears together, and length of a collision interval.
        longest: Longest span [m].
        settings: Limits of the numbers of spans and intervals.
    """
    total, shape = float(np.add.reduce(lengths)), []
    wanted = max(chosen.spans, min(settings.most_spans, math.ceil(total / longest)))
    for length in lengths.tolist():
        spans = max(settings.fewest_spans, 2 * round(0.5 * wanted * length / total))
        cells = math.ceil(length / (spans * chosen.interval))
        shape.append((spans, min(max(cells, settings.fewest_intervals), settings.most_intervals)))
    return tuple(shape)


class _NodesOfGears(NamedTuple):
    """Indices of nodes and intervals that depend only on the basis."""

    shares: tuple[FloatArray, ...]  # per gear, `Basis.fraction` of its nodes
    inner: IntArray  # nodes between two intervals of one gear
    last: IntArray  # last interval of each gear


@lru_cache(maxsize=16)  # as many as bases
def _nodes_of_gears(basis: Basis) -> _NodesOfGears:
    shares = tuple(basis.fraction[basis.node_gear == m] for m in range(basis.num_gears))
    inner = basis.left[basis.fraction[basis.left] > 0.0]
    return frozen(_NodesOfGears(shares, inner, basis.last_nodes - np.arange(basis.num_gears) - 1))


def trace(path: Path, basis: Basis, lengths: FloatArray, signs: FloatArray, start_yaw: float) -> TracedInput:
    """Return the input at the nodes of `basis`; headings are directions of chords in the gears `signs`, not yaws."""
    shares, left, yaws = _nodes_of_gears(basis).shares, basis.left, np.empty(basis.num_nodes + 1)
    poses = [
        segment.poses_at(share * min(length, segment.length))
        for segment, share, length in zip(path.segments, shares, lengths.tolist(), strict=True)
    ]
    nodes = poses[0] if len(poses) == 1 else np.concatenate(poses)
    yaws[0], yaws[1:] = start_yaw, nodes[:, 2]
    node_yaw = unwrap_yaw(yaws)[1:]
    dx, dy, _ = (nodes[1:] - nodes[:-1])[left].T
    sign = signs[basis.interval_gear]
    yaw = (0.5 * (node_yaw[:-1] + node_yaw[1:]))[left]
    turned = wrap_angles(np.arctan2(sign * dy, sign * dx) - yaw)
    turned[np.hypot(dx, dy) <= 1e-6] = 0.0
    return TracedInput(nodes[:, :2], yaw + turned, float(node_yaw[-1]))


def _reference_of(traced: TracedInput, basis: Basis) -> InputNodes:
    """Return positions and normals at the nodes; the heading of a node is the mean of the neighbouring headings."""
    indices, heading, normals = _nodes_of_gears(basis), np.empty(basis.num_nodes), np.empty((basis.num_nodes, 2))
    heading[basis.left], heading[basis.last_nodes] = traced.headings, traced.headings[indices.last]
    inner = indices.inner
    heading[inner] = 0.5 * (heading[inner] + heading[inner - 1])
    normals[:, 0], normals[:, 1] = -np.sin(heading), np.cos(heading)
    return InputNodes(traced.positions, normals)


def _target(problem: DockingProblem, sign: float, end_yaw: float) -> FloatArray:
    """Return the goal moved back by the final straight, with a yaw that is continuous with the input."""
    goal = problem.goal
    yaw, back = goal.yaw, sign * problem.dock.final_straight
    turned = yaw + 2.0 * math.pi * round((end_yaw - yaw) / (2.0 * math.pi))
    return np.array((goal.x - back * np.cos(yaw), goal.y - back * np.sin(yaw), turned))


def _reference_scales(limits: MotionLimits, settings: BoundSettings) -> tuple[float, float]:
    """Return the reference curvature [1/m] and the reference curvature rate [1/m^2] of the cost."""
    curvature = limits.max_curvature if math.isfinite(limits.max_curvature) else settings.unlimited_curvature
    rate = limits.max_curvature_rate
    if limits.wheelbase > 0.0:  # the rate that the wheels can follow at full speed
        rate = min(rate, limits.max_steering_rate / (limits.wheelbase * limits.max_speed))
    return curvature, rate if math.isfinite(rate) else settings.unlimited_rate * curvature


def _turning_at_cusps(limits: MotionLimits, curvature: float) -> float:
    """Return the cost [m] of steering from 0 to `curvature` at rest: the distance driven at full speed in that time."""
    if limits.wheelbase <= 0.0:
        return 0.0
    return math.atan(limits.wheelbase * curvature) / limits.max_steering_rate * limits.max_speed


def _easing(limits: MotionLimits, basis: Basis, lengths: FloatArray) -> FloatArray | None:
    """Return the weight of a steered robot's curvature rate in each span: the squared ratio of speed to full speed.

    The speed is taken from the fastest motion along gears of these lengths under the acceleration limits.
    """
    if limits.wheelbase <= 0.0:
        return None
    spans = np.array([count for count, _ in basis.shape])
    driven = np.concatenate([(np.arange(count) + 0.5) / count for count in spans]) * lengths[basis.span_gear]
    left = lengths[basis.span_gear] - driven
    squared = 2.0 * np.minimum(limits.max_acceleration * driven, limits.max_deceleration * left) / limits.max_speed**2
    easing: FloatArray = np.clip(squared, _EASED_MOST, 1.0)
    return easing


def _scaled(weights: Weights, curvature: float) -> Weights:
    """Return the weights for a largest curvature [1/m]; robots with wide turns may deviate farther from the input."""
    if curvature >= _TRACKED:
        return weights
    return weights._replace(tracking=weights.tracking * (curvature / _TRACKED) ** 2)


def _braking_distance(problem: DockingProblem) -> float:
    """Return the distance [m] of full braking from the start state."""
    (speed, acceleration), limits = problem.start_state(1), problem.robot.limits
    if speed == 0.0:
        return 0.0
    phases = braking_phases(speed, acceleration, limits.max_deceleration, limits.max_jerk)
    durations, jerks = (np.array(column) for column in zip(*phases, strict=True))
    return float(border_states(durations, jerks, (0.0, speed, acceleration))[0, -1])


def _variable_bounds(
    basis: Basis, problem: DockingProblem, lengths: FloatArray, most: float, settings: BoundSettings
) -> tuple[VariableBounds, VariableBounds]:
    """Return the exact bounds for a largest curvature `most` [1/m], and the tighter bounds of the steps."""
    found, limits = [], problem.robot.limits
    shortest = np.minimum(settings.shortest_gear, 0.5 * lengths)
    longest = settings.longest_gear[0] * lengths + settings.longest_gear[1]
    if basis.num_gears > 1:  # a robot in motion needs the first gear for stopping
        shortest[0] = max(shortest[0], min(_BRAKING_ROOM * _braking_distance(problem), longest[0]))
    for inside, rate_inside in ((1.0, 1.0), (settings.curvature_inside, settings.rate_inside)):
        upper = np.empty(basis.size)
        upper[: basis.num_knots], upper[basis.num_knots :] = inside * most, longest
        lower = -upper
        lower[basis.num_knots :] = shortest
        if problem.start_curvature is not None:
            lower[0] = upper[0] = problem.start_curvature
        if problem.dock.final_straight > 0.0:
            lower[basis.num_knots - 1] = upper[basis.num_knots - 1] = 0.0
        found.append(VariableBounds(lower, upper, rate_inside * limits.max_curvature_rate))
    return found[0], found[1]
