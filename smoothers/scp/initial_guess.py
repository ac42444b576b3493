"""Initial guesses: a fit to headings or positions, pure pursuit of the input, or an earlier result.

The fit to headings is the cheapest guess and the best start for smooth inputs. It drifts away from inputs whose
curvature changes within centimetres, such as Reeds-Shepp paths; a least-squares fit to positions (`track`, S22) does
not. Inputs that cannot be driven (kinks, a start with a different heading) are followed by pure pursuit with bounded
curvature and curvature rate [Coulter1992].
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.deadline import never_late
from optdock.geometry.arrays import product_of_columns
from optdock.model.path import ClothoidSegment
from smoothers.scp.collision.linearization import ClearanceRows
from smoothers.scp.cost import Quadratic
from smoothers.scp.goal_projection import clipped, end_sensitivity, limit_rate
from smoothers.scp.loop import SearchGuess, evaluated
from smoothers.scp.nlp import with_intervals
from smoothers.scp.qp_step import Penalties, Subproblem, pool_of_this_thread, solve_step, trusted_nodes
from smoothers.scp.rollout import Variables, roll_out, sensitivity

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.geometry.arrays import FloatArray
    from optdock.model.path import Path
    from optdock.model.problem import DockingProblem
    from smoothers.scp.basis import Basis
    from smoothers.scp.loop import Iterate
    from smoothers.scp.nlp import Ends, NonlinearProgram, VariableBounds
    from smoothers.scp.qp_step import ProgramPool
    from smoothers.scp.rollout import Rollout
    from smoothers.scp.settings import GuessSettings

__all__ = ["EarlierResult", "InitialGuesses", "largest_deviation", "pure_pursuit", "rest_of_earlier_result", "track"]


@dataclass(frozen=True, eq=False)
class InitialGuesses:
    """Initial guesses for one nonlinear program."""

    nlp: NonlinearProgram
    earlier: EarlierResult | None = None  # rest of an earlier result, or None
    pool: ProgramPool = field(default_factory=pool_of_this_thread)  # convex programs, for tracking
    # whether there is no time for another iteration; called before and within tracking
    is_late: Callable[[], bool] = never_late

    @property
    def first(self) -> SearchGuess:
        """First guess: the fit, the pursuit or the tracked path."""
        return self._cold(self._first, self.nlp.settings.guess.patience)

    @property
    def on_the_input(self) -> SearchGuess | None:
        """Guess that tracks the input; None if the input cannot be tracked or the first guess is nearly the same."""
        if not self._is_trackable or self.tracked is self._first:
            return None
        settings = self.nlp.settings.guess
        apart = self._apart(self.tracked, self._first)
        return self._cold(self.tracked, settings.patience) if apart > settings.different_on_the_input else None

    @property
    def other(self) -> SearchGuess | None:
        """Second guess, fit or pursuit, for obstacles passed on the wrong side; None if close to the first guess."""
        settings, second = self.nlp.settings.guess, self._untracked
        if self._first is second:
            second = self.pursued if second is self.fitted else self.fitted
        apart = self._apart(self._first, second)
        return self._cold(second, settings.patience_other) if apart > settings.different else None

    @property
    def rest_of_earlier(self) -> SearchGuess | None:
        """Guess that continues an earlier result, or None."""
        if self.earlier is None:
            return None
        settings = self.nlp.settings.guess
        left = clipped(self.earlier.variables(self.nlp.basis), self.nlp.inner_bounds)
        return SearchGuess(
            left, settings.trust_region_near, settings.proximal_near / self.nlp.radius, settings.patience
        )

    @cached_property
    def fitted(self) -> Variables:
        """Smoothed least-squares fit to the input's headings (S9), within the bounds."""
        nlp, lengths = self.nlp, self.nlp.lengths
        turned = nlp.basis.fit @ (nlp.traced.headings - nlp.ends.start[2])
        return clipped(Variables(turned / lengths[nlp.basis.knot_gear], lengths.copy()), nlp.inner_bounds)

    @cached_property
    def pursued(self) -> Variables:
        """Pure pursuit of the input within the bounds (S10)."""
        nlp = self.nlp
        found = pure_pursuit(nlp.basis, nlp.traced.positions, nlp.ends, nlp.inner_bounds, nlp.settings.guess)
        return clipped(found, nlp.inner_bounds)

    @cached_property
    def tracked(self) -> Variables:
        """Drivable path whose positions are nearest to the input in the least-squares sense (S22)."""
        return track(self.nlp, self.pool, self._untracked, self.trust_region, self.is_late)

    @cached_property
    def trust_region(self) -> float:
        """Initial bound on heading changes [rad]; its square times half the length estimates the position errors."""
        settings, nlp = self.nlp.settings.guess, self.nlp
        longest = settings.bold_length * nlp.radius
        return settings.trust_region * math.sqrt(min(1.0, longest / float(nlp.lengths.sum())))

    @cached_property
    def _untracked(self) -> Variables:
        """The fit, or the pursuit if the fit deviates too far from the input."""
        settings, driven = self.nlp.settings.guess, self._fit_driven
        turned = abs(float(driven.poses[-1, 2] - self.nlp.ends.target[2]))
        is_near = largest_deviation(self.nlp, driven) < settings.astray and turned < settings.turned_away
        return self.fitted if is_near else self.pursued

    @cached_property
    def _is_trackable(self) -> bool:
        """Whether the tracked path is near the input, or much nearer than the fit or the pursuit."""
        settings = self.nlp.settings.guess
        tracked, other = (largest_deviation(self.nlp, self._driven(v)) for v in (self.tracked, self._untracked))
        return tracked < max(settings.trackable, settings.much_nearer * other)

    @cached_property
    def _first(self) -> Variables:
        """The fit or the pursuit, unless it collides or misses the goal and the tracked path is better."""
        nlp, first = self.nlp, self._untracked
        is_near = first is self.fitted and largest_deviation(nlp, self._fit_driven) < nlp.settings.guess.off_the_input
        if is_near or self.is_late():
            return first
        begun = self._evaluated(first)
        is_free = begun.shortfall < nlp.scene.settings.deep * nlp.scene.body.width
        if (begun.on_goal and is_free) or self.is_late():
            return first
        loop = nlp.settings.loop
        penalties = Penalties(loop.clearance_penalty, loop.goal_penalty)
        does_better = self._is_trackable and self._evaluated(self.tracked).merit(penalties) < begun.merit(penalties)
        return self.tracked if does_better else first

    def _evaluated(self, variables: Variables) -> Iterate:
        """Return the iterate of variables, which a search that begins with them does not compute again."""
        self._known.append((variables, evaluated(self.nlp, variables)[0]))
        return self._known[-1][1]

    @cached_property
    def _known(self) -> list[tuple[Variables, Iterate]]:
        return []

    @cached_property
    def _fit_driven(self) -> Rollout:
        return self._driven(self.fitted)

    def _driven(self, variables: Variables) -> Rollout:
        return roll_out(self.nlp.basis, variables, self.nlp.ends.start, self.nlp.ends.signs)

    def _apart(self, one: Variables, other: Variables) -> float:
        between = self._driven(one).poses[:, :2] - self._driven(other).poses[:, :2]
        return float(np.abs(between).max())

    def _cold(self, variables: Variables, patience: int) -> SearchGuess:
        """Return a guess without an earlier result; longer paths are allowed more iterations without improvement."""
        settings, spans = self.nlp.settings.guess, self.nlp.basis.span_gear.size
        patience = round(patience * max(1.0, spans / settings.spans_per_patience))
        begun = next((iterate for known, iterate in self._known if known is variables), None)
        return SearchGuess(variables, self.trust_region, settings.proximal / self.nlp.radius, patience, begun)


class EarlierResult(NamedTuple):
    """The part of an earlier result that is ahead of the robot."""

    path: Path  # earlier result
    first: int  # index of the first gear that is left
    begin: float  # arc length within that gear [m]
    lengths: FloatArray  # remaining lengths of the gears without the final straight, Shape (num_gears,) [m]

    def variables(self, basis: Basis) -> Variables:
        """Return the curvatures of the rest at the knots of `basis`, and its lengths."""
        knots = []
        for m, segment in enumerate(self.path.segments[self.first :]):
            share = np.linspace(0.0, 1.0, int(basis.last_knots[m] - basis.first_knots[m]) + 1)
            knots.append(segment.curvature_at((self.begin if m == 0 else 0.0) + share * self.lengths[m]))
        return Variables(np.concatenate(knots), self.lengths.copy())


def rest_of_earlier_result(
    earlier: Path | None, path: Path, problem: DockingProblem, settings: GuessSettings
) -> EarlierResult | None:
    """Return the rest of the clothoid path `earlier`, or None if it is far from the start or has other gears."""
    if earlier is None or not all(isinstance(segment, ClothoidSegment) for segment in earlier.segments):
        return None
    count = len(path.segments)
    first = len(earlier.segments) - count
    if first < 0:
        return None
    left = earlier.segments[first:]
    if any(a.direction is not b.direction for a, b in zip(left, path.segments, strict=True)):
        return None
    s = np.linspace(0.0, left[0].length, max(2, int(left[0].length / settings.earlier_spacing)))
    poses = left[0].poses_at(s)
    away = np.hypot(poses[:, 0] - problem.start.x, poses[:, 1] - problem.start.y)
    nearest = int(np.argmin(away))
    if away[nearest] > settings.earlier_lost:
        return None
    lengths = np.array([segment.length for segment in left])
    lengths[0] -= s[nearest]
    lengths[-1] -= problem.dock.final_straight
    if np.any(lengths < settings.earlier_shortest):
        return None
    return EarlierResult(earlier, first, float(s[nearest]), lengths)


class _Limits(NamedTuple):
    curvature: float
    rate: float
    step: float
    lookahead: float


class _Drive(NamedTuple):
    """A driven gear: yaw at equally spaced points, length [m] and last pose."""

    yaw: list[float]
    length: float
    pose: tuple[float, float, float]


def pure_pursuit(
    basis: Basis, positions: FloatArray, ends: Ends, bounds: VariableBounds, settings: GuessSettings
) -> Variables:
    """Return the variables from pure pursuit of `positions`, Shape (num_nodes, 2) [m], within the bounds."""
    limit = float(bounds.upper[: basis.num_knots].max())
    headings, lengths = np.empty(basis.num_intervals), np.empty(basis.num_gears)
    pose = (float(ends.start[0]), float(ends.start[1]), float(ends.start[2]))
    for m in range(basis.num_gears):
        points = positions[basis.node_gear == m]
        spacing = float(np.hypot(*np.diff(points, axis=0).T).mean())
        step = min(max(spacing, 0.01), settings.pursuit_step / limit)
        limits = _Limits(limit, bounds.rate, step, max(1.0 / limit, 4.0 * step))
        aim = ends.target[2] if m == basis.num_gears - 1 else None
        line = _extended(points, ends.signs[m], aim, limits)
        drive = _pursue(pose, float(ends.signs[m]), line, limits, settings.pursuit_longest)
        mine = basis.interval_gear == m
        middle = (np.arange(mine.sum()) + 0.5) / mine.sum()
        headings[mine] = np.interp(middle * (len(drive.yaw) - 1.0), np.arange(len(drive.yaw)), drive.yaw)
        lengths[m], pose = drive.length, drive.pose
    # A fit of the headings: samples of the curvature at the few knots would drift away.
    turned = basis.fit @ (headings - ends.start[2])
    return Variables(turned / lengths[basis.knot_gear], lengths)


def _extended(points: FloatArray, sign: float, yaw: float | None, limits: _Limits) -> list[tuple[float, float]]:
    """Return the points at the spacing of a step, extended by a straight line that aligns the end of the pursuit."""
    away = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))))
    s = np.arange(0.0, away[-1], limits.step)
    dense = [np.interp(s, away, points[:, i]) for i in (0, 1)]
    last = points[-1] - points[-2]
    angle = math.atan2(last[1], last[0]) if yaw is None else yaw + (0.0 if sign > 0.0 else math.pi)
    beyond = np.arange(0.0, 2.0 * limits.lookahead, limits.step)
    x = np.concatenate((dense[0], points[-1, 0] + beyond * math.cos(angle)))
    y = np.concatenate((dense[1], points[-1, 1] + beyond * math.sin(angle)))
    return list(zip(x.tolist(), y.tolist(), strict=True))


def _pursue(
    pose: tuple[float, float, float], sign: float, line: list[tuple[float, float]], limits: _Limits, longest: float
) -> _Drive:
    """Drive by pure pursuit of `line`, whose tail of two lookahead distances lies beyond the end."""
    x, y, yaw = pose
    tail = math.ceil(2.0 * limits.lookahead / limits.step)
    end, ahead = max(1, len(line) - tail), math.ceil(limits.lookahead / limits.step)
    most = int(longest * len(line) + 2.0 * math.pi / (limits.curvature * limits.step))
    nearest, kappa, driven = 0, 0.0, [yaw]
    for count in range(most):
        nearest = _advanced(line, nearest, x, y)
        if nearest >= end and count > 3:
            break
        target = line[min(nearest + ahead, len(line) - 1)]
        kappa = _steered(kappa, (x, y, yaw), sign, target, limits)
        middle = yaw + 0.5 * kappa * limits.step
        x, y = x + sign * limits.step * math.cos(middle), y + sign * limits.step * math.sin(middle)
        yaw += kappa * limits.step
        driven.append(yaw)
    return _Drive(driven, max(1, len(driven) - 1) * limits.step, (x, y, yaw))


def _advanced(line: list[tuple[float, float]], nearest: int, x: float, y: float) -> int:
    """Return the index of the next local minimum of the distance, starting at `nearest`."""
    best = math.hypot(line[nearest][0] - x, line[nearest][1] - y)
    while nearest + 1 < len(line):
        following = math.hypot(line[nearest + 1][0] - x, line[nearest + 1][1] - y)
        if following > best:
            break
        nearest, best = nearest + 1, following
    return nearest


def _steered(
    kappa: float, pose: tuple[float, float, float], sign: float, target: tuple[float, float], limits: _Limits
) -> float:
    """Return the curvature of the arc through the target, within the limits."""
    dx, dy = target[0] - pose[0], target[1] - pose[1]
    heading = pose[2] + (0.0 if sign > 0.0 else math.pi)
    along, across = dx * math.cos(heading) + dy * math.sin(heading), dy * math.cos(heading) - dx * math.sin(heading)
    distance = max(math.hypot(dx, dy), 1e-6)
    # The arc through a target behind the robot is too flat.
    wanted = 2.0 * across / distance**2 if along > 0.0 else math.copysign(limits.curvature, across)
    change = limits.rate * limits.step
    wanted = min(max(wanted, kappa - change), kappa + change)
    return min(max(wanted, -limits.curvature), limits.curvature)


def largest_deviation(nlp: NonlinearProgram, rollout: Rollout) -> float:
    """Return the largest distance of a node from the input [m]."""
    return float(np.hypot(*(rollout.poses[:, :2] - nlp.traced.positions).T).max())


def track(
    nlp: NonlinearProgram, pool: ProgramPool, variables: Variables, trust_region: float, is_late: Callable[[], bool]
) -> Variables:
    """Return the variables after Gauss-Newton steps towards the input's positions (S22), without regard to obstacles.

        minimize  w integral of (across^2 + a along^2) ds + w a' sum over cusps of |p - p_ref|^2
                  + smoothness + goal error

    within a trust region ([Nocedal2006] ch. 10). The steps use the convex program of the search and take about a
    millisecond in total.

    Args:
        nlp: Input, ends and bounds.
        pool: Convex programs.
        variables: First variables.
        trust_region: First bound of the heading changes of a step [rad].
        is_late: Called before every step; a result of True ends the iteration.
    """
    settings, knots = nlp.settings.tracking, nlp.basis.num_knots
    nlp = with_intervals(nlp, [min(cells, settings.most_intervals) for _, cells in nlp.basis.shape])
    least_squares = _LeastSquares.of(nlp)
    current = least_squares.at(limit_rate(nlp.basis, variables, nlp.inner_bounds))
    penalties = Penalties(0.0, settings.goal_weight)
    around: Subproblem | None = None
    for _ in range(settings.most_steps):
        if is_late():
            break
        around = around or least_squares.linearized(current)
        step = solve_step(nlp, around, pool, trust_region, settings.proximal, penalties)
        if step is None:
            break
        moved = np.concatenate(current.variables) + step.change
        trial = least_squares.at(Variables(moved[:knots], moved[knots:]))
        if trial.merit >= current.merit:
            trust_region *= settings.trust_cut
            continue
        gain, current, around = current.merit - trial.merit, trial, None
        trust_region = min(settings.trust_growth * trust_region, settings.most_trust)
        if gain < settings.small_gain * current.merit or largest_deviation(nlp, current.rollout) < settings.near:
            break
    return current.variables


class _TrackedPath(NamedTuple):
    """Variables of a tracked path, with their roll-out and merit."""

    variables: Variables
    rollout: Rollout
    merit: float


@dataclass(frozen=True, eq=False)
class _LeastSquares:
    """Residuals of one program at every node, across and along the input."""

    nlp: NonlinearProgram
    axes: tuple[FloatArray, FloatArray]  # unit vectors across and along the input, Shape (num_nodes, 2) each
    weights: tuple[FloatArray, FloatArray]  # weights of the squared residuals, Shape (num_nodes,) each
    smoothness: float  # weight of the integral of the squared curvature rate

    @classmethod
    def of(cls, nlp: NonlinearProgram) -> _LeastSquares:
        settings, basis, normals = nlp.settings.tracking, nlp.basis, nlp.cost.reference.normals
        share = settings.weight * float(nlp.lengths.sum()) / basis.num_intervals
        across, along = np.full(basis.num_nodes, share), np.full(basis.num_nodes, share * settings.along)
        cusps = basis.last_nodes[:-1]
        across[cusps] = along[cusps] = share * settings.cusp
        axes = normals, np.column_stack((-normals[:, 1], normals[:, 0]))
        return cls(nlp, axes, (across, along), settings.smoothness * nlp.cost.factors[1])

    def at(self, variables: Variables) -> _TrackedPath:
        """Roll out the variables and compute the merit."""
        nlp, basis = self.nlp, self.nlp.basis
        rollout = roll_out(basis, variables, nlp.ends.start, nlp.ends.signs)
        squares = sum(float(w @ r**2) for w, r in zip(self.weights, self._residuals(rollout), strict=True))
        slopes = variables.curvature * (basis.stiffness @ variables.curvature) / variables.lengths[basis.knot_gear]
        missed = float(np.abs(nlp.ends.error(rollout)).sum())
        merit = squares + self.smoothness * float(slopes.sum()) + nlp.settings.tracking.goal_weight * missed
        return _TrackedPath(variables, rollout, merit)

    def linearized(self, current: _TrackedPath) -> Subproblem:
        """Return the convex model at an iterate, without clearance."""
        nlp, basis, (variables, rollout, _) = self.nlp, self.nlp.basis, current
        by, knots = sensitivity(basis, variables, rollout), basis.num_knots
        stiffness = self.smoothness / variables.lengths[basis.knot_gear] * basis.stiffness
        gradient, hessian = np.zeros(basis.size), np.zeros((basis.size, basis.size))
        gradient[:knots], hessian[:knots, :knots] = 2.0 * (stiffness @ variables.curvature), 2.0 * stiffness
        for axis, weight, residual in zip(self.axes, self.weights, self._residuals(rollout), strict=True):
            moved = axis[:, :1] * by.x + axis[:, 1:] * by.y
            gradient += 2.0 * (weight * residual) @ moved
            hessian += 2.0 * product_of_columns(moved, weight[:, None] * moved)
        goal = end_sensitivity(basis, variables, rollout.moves), nlp.ends.error(rollout)
        headings = by.yaw[trusted_nodes(basis, nlp.settings.step)]
        no_rows = ClearanceRows(np.zeros((0, basis.size)), np.zeros(0), np.zeros(0, dtype=np.int64))
        motion = np.eye(basis.size)
        return Subproblem(variables, Quadratic(gradient, hessian), motion, goal, headings, no_rows)

    def _residuals(self, rollout: Rollout) -> tuple[FloatArray, FloatArray]:
        away = rollout.poses[:, :2] - self.nlp.traced.positions
        across, along = (axis[:, 0] * away[:, 0] + axis[:, 1] * away[:, 1] for axis in self.axes)
        return across, along
