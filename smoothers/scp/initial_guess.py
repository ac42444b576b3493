"""Initial guesses: a fit to headings or positions, pure pursuit of the input, or an earlier result.

The fit to headings is the cheapest guess and the best start for smooth inputs. It drifts away from inputs whose
curvature changes within centimetres, such as Reeds-Shepp paths; a least-squares fit to positions (`track`, S22) does
not. Inputs that cannot be driven (kinks, a start with a different heading) are followed by pure pursuit with bounded
curvature and curvature rate [Coulter1992].
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.deadline import never_late
from optdock.geometry.arrays import readonly
from optdock.geometry.lazy import cached_property
from optdock.kernels import Kernel, twin_of
from optdock.model.path import ClothoidSegment
from smoothers.scp.collision.linearization import ClearanceRows
from smoothers.scp.cost import Quadratic
from smoothers.scp.goal_projection import clipped, limit_rate
from smoothers.scp.loop import SearchGuess, evaluated
from smoothers.scp.nlp import with_intervals
from smoothers.scp.qp_step import (
    Linearization,
    Penalties,
    StepBounds,
    Subproblem,
    numbers_before_rows,
    pool_of_this_thread,
    solve_step,
    trusted_nodes,
)
from smoothers.scp.rollout import Rollout, Variables, in_order, roll_out, sensitivity

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from optdock.geometry.arrays import FloatArray, IntArray
    from optdock.model.path import Path
    from optdock.model.problem import DockingProblem
    from smoothers.scp.basis import Basis
    from smoothers.scp.loop import Iterate
    from smoothers.scp.nlp import Ends, NonlinearProgram, VariableBounds
    from smoothers.scp.qp_step import ProgramPool
    from smoothers.scp.settings import GuessSettings

__all__ = [
    "EarlierResult",
    "InitialGuesses",
    "LeastSquares",
    "TrackedPath",
    "largest_deviation",
    "linearized_tracking",
    "pure_pursuit",
    "rest_of_earlier_result",
    "track",
    "tracked_path",
]


@dataclass(frozen=True, eq=False)
class InitialGuesses:
    """Initial guesses for one nonlinear program."""

    nlp: NonlinearProgram
    earlier: EarlierResult | None = None  # rest of an earlier result, or None
    pool: ProgramPool = field(default_factory=pool_of_this_thread)  # convex programs, for tracking
    # whether there is no time for another iteration; called before and within tracking
    is_late: Callable[[], bool] = never_late
    # iterates of guesses, which a search that begins with one of them does not compute again
    _known: list[tuple[Variables, Iterate]] = field(default_factory=list, init=False, repr=False)

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

    @property
    def fitted(self) -> Variables:
        """Smoothed least-squares fit to the input's headings (S9), within the bounds."""
        return self._fit.variables

    @cached_property
    def _fit(self) -> _Fit:
        nlp, lengths = self.nlp, self.nlp.lengths
        turned = nlp.basis.fit @ (nlp.traced.headings - nlp.ends.start[2])
        variables = clipped(Variables(turned / lengths[nlp.basis.knot_gear], lengths.copy()), nlp.inner_bounds)
        driven = self._driven(variables)
        missed = abs(float(driven.poses[-1, 2] - nlp.ends.target[2]))
        return _Fit(variables, largest_deviation(nlp, driven), missed)

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

    @property
    def trust_region(self) -> float:
        """Initial bound on heading changes [rad]; its square times half the length estimates the position errors."""
        settings, nlp = self.nlp.settings.guess, self.nlp
        longest = settings.bold_length * nlp.radius
        return settings.trust_region * math.sqrt(min(1.0, longest / float(np.add.reduce(nlp.lengths))))

    @cached_property
    def _untracked(self) -> Variables:
        """The fit, or the pursuit if the fit deviates too far from the input."""
        settings, fit = self.nlp.settings.guess, self._fit
        is_near = fit.deviation < settings.astray and fit.turned < settings.turned_away
        return fit.variables if is_near else self.pursued

    @cached_property
    def _is_trackable(self) -> bool:
        """Whether the tracked path is near the input, or much nearer than the fit or the pursuit."""
        settings = self.nlp.settings.guess
        tracked, untracked = largest_deviation(self.nlp, self._driven(self.tracked)), self._untracked
        is_fitted = untracked is self.fitted
        other = self._fit.deviation if is_fitted else largest_deviation(self.nlp, self._driven(untracked))
        return tracked < max(settings.trackable, settings.much_nearer * other)

    @cached_property
    def _first(self) -> Variables:
        """The fit or the pursuit, unless it collides or misses the goal and the tracked path is better."""
        nlp, first = self.nlp, self._untracked
        is_near = first is self.fitted and self._fit.deviation < nlp.settings.guess.off_the_input
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
        found = evaluated(self.nlp, np.concatenate(variables))
        self._known.append((variables, found))
        return found

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


class _Fit(NamedTuple):
    """The fit to the headings."""

    variables: Variables
    deviation: float  # largest distance from the input [m]
    turned: float  # error of the heading at the goal [rad]


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


class _Pursuit(NamedTuple):
    """The pursuit of one gear: the input at equal steps, followed by a straight line."""

    points: FloatArray  # input, Shape (n, 2) [m]
    away: FloatArray  # arc lengths of its points, Shape (n,) [m]
    start: FloatArray  # pose, Shape (3,)
    sign: float  # gear
    angle: float  # direction of the straight line [rad]
    step: float  # [m]
    limits: tuple[float, float]  # largest curvature [1/m] and its largest change in a step [1/m]
    # numbers of steps: inside the input, on the line, of the lookahead distance, and the most that are driven
    counts: tuple[int, int, int, int]


class _Drive(NamedTuple):
    """A driven gear: yaws at the middles of its intervals, Shape (cells,), number of steps, last pose, Shape (3,)."""

    yaw: FloatArray
    steps: int
    pose: FloatArray


def pure_pursuit(
    basis: Basis, positions: FloatArray, ends: Ends, bounds: VariableBounds, settings: GuessSettings
) -> Variables:
    """Return the variables from pure pursuit of `positions`, Shape (num_nodes, 2) [m], within the bounds."""
    limit = float(np.maximum.reduce(bounds.upper[: basis.num_knots]))
    drives, lengths, pose = [], np.empty(basis.num_gears), ends.start
    for m, (last, cells) in enumerate(zip(basis.last_nodes.tolist(), basis.divisions[:, 1].tolist(), strict=True)):
        points, away = positions[last - cells : last + 1], np.zeros(cells + 1)
        steps = points[1:] - points[:-1]
        chords = np.hypot(steps[:, 0], steps[:, 1])
        chords.cumsum(out=away[1:])
        step = min(max(float(np.add.reduce(chords)) / cells, 0.01), settings.pursuit_step / limit)
        lookahead, sign = max(1.0 / limit, 4.0 * step), float(ends.signs[m])
        if m == basis.num_gears - 1:  # the line aligns the end of the pursuit with the target
            angle = float(ends.target[2]) + (0.0 if sign > 0.0 else math.pi)
        else:
            angle = math.atan2(points[-1, 1] - points[-2, 1], points[-1, 0] - points[-2, 0])
        inside, beyond = math.ceil(float(away[-1]) / step), math.ceil(2.0 * lookahead / step)
        most = int(settings.pursuit_longest * (inside + beyond) + 2.0 * math.pi / (limit * step))
        counts = inside, beyond, math.ceil(lookahead / step), most
        drive = _drive_of(_Pursuit(points, away, pose, sign, angle, step, (limit, bounds.rate * step), counts), cells)
        drives.append(drive.yaw)
        lengths[m], pose = max(1, drive.steps) * step, drive.pose
    # A fit of the headings: samples of the curvature at the few knots would drift away.
    turned = basis.fit @ (np.concatenate(drives) - ends.start[2])
    return Variables(turned / lengths[basis.knot_gear], lengths)


_PURSUE = Kernel("optdock_pursue", sizes=6, numbers=5)


def _drive_natively(task: _Pursuit, cells: int) -> _Drive:
    pose, headings, count, most = task.start.copy(), np.empty(cells), len(task.points), task.counts[-1]
    arrays = (
        (np.ascontiguousarray(task.points), 2 * count),
        (task.away, count),
        (pose, 3),
        (headings, cells),
        (np.empty(most + 1), most + 1),
    )
    numbers = task.sign, task.angle, *task.limits, task.step
    return _Drive(headings, _PURSUE((count, *task.counts, cells), numbers, arrays), pose)


@twin_of(_drive_natively)
def _drive_of(task: _Pursuit, cells: int) -> _Drive:
    """Drive one gear by pure pursuit, and return its yaws at the middles of `cells` equal intervals."""
    (x, y, yaw), (inside, _, ahead, most) = task.start.tolist(), task.counts
    line = _pursued_line(task)
    nearest, kappa, driven = 0, 0.0, [yaw]
    for count in range(most):
        nearest = _advanced(line, nearest, x, y)
        if nearest >= max(1, inside) and count > 3:
            break
        kappa = _steered(kappa, (x, y, yaw), line[min(nearest + ahead, len(line) - 1)], task)
        middle = yaw + 0.5 * kappa * task.step
        x, y = x + task.sign * task.step * math.cos(middle), y + task.sign * task.step * math.sin(middle)
        yaw += kappa * task.step
        driven.append(yaw)
    middles = (np.arange(cells) + 0.5) / cells
    yaws = np.interp(middles * (len(driven) - 1.0), np.arange(len(driven)), driven)
    return _Drive(yaws, len(driven) - 1, np.array([x, y, yaw]))


def _pursued_line(task: _Pursuit) -> list[tuple[float, float]]:
    """Return the points of the input at the spacing of a step, and those of the straight line beyond it."""
    inside, beyond = (task.step * np.arange(count) for count in task.counts[:2])
    columns = []
    for i, slope in enumerate((math.cos(task.angle), math.sin(task.angle))):
        dense = np.interp(inside, task.away, task.points[:, i])
        columns.append(np.concatenate((dense, task.points[-1, i] + beyond * slope)).tolist())
    return list(zip(*columns, strict=True))


def _distance(point: tuple[float, float], x: float, y: float) -> float:
    return float(np.hypot(point[0] - x, point[1] - y))  # of the C library, unlike `math.hypot`


def _advanced(line: list[tuple[float, float]], nearest: int, x: float, y: float) -> int:
    """Return the index of the next local minimum of the distance, starting at `nearest`."""
    best = _distance(line[nearest], x, y)
    while nearest + 1 < len(line):
        following = _distance(line[nearest + 1], x, y)
        if following > best:
            break
        nearest, best = nearest + 1, following
    return nearest


def _steered(kappa: float, pose: tuple[float, float, float], target: tuple[float, float], task: _Pursuit) -> float:
    """Return the curvature of the arc through the target, within the limits."""
    limit, change = task.limits
    dx, dy = target[0] - pose[0], target[1] - pose[1]
    heading = pose[2] + (0.0 if task.sign > 0.0 else math.pi)
    along, across = dx * math.cos(heading) + dy * math.sin(heading), dy * math.cos(heading) - dx * math.sin(heading)
    distance = max(_distance(target, *pose[:2]), 1e-6)
    # The arc through a target behind the robot is too flat.
    wanted = 2.0 * across / (distance * distance) if along > 0.0 else math.copysign(limit, across)
    return min(max(min(max(wanted, kappa - change), kappa + change), -limit), limit)


def largest_deviation(nlp: NonlinearProgram, rollout: Rollout) -> float:
    """Return the largest distance of a node from the input [m]."""
    away = rollout.poses[:, :2] - nlp.traced.positions
    return float(np.maximum.reduce(np.hypot(away[:, 0], away[:, 1])))


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
    least_squares = LeastSquares.of(nlp)
    current = tracked_path(least_squares, np.concatenate(limit_rate(nlp.basis, variables, nlp.inner_bounds)))
    penalties = Penalties(0.0, settings.goal_weight)
    around: Linearization | None = None
    for _ in range(settings.most_steps):
        if is_late():
            break
        around = around or linearized_tracking(least_squares, current)
        if is_late():
            break
        step = solve_step(nlp, around, pool, StepBounds(trust_region, settings.proximal, penalties))
        if step is None:
            break
        trial = tracked_path(least_squares, current.variables + step.change)
        if trial.merit >= current.merit:
            trust_region *= settings.trust_cut
            continue
        current, around = trial, None
        trust_region = min(settings.trust_growth * trust_region, settings.most_trust)
        is_small = step.gain < settings.small_gain * current.merit
        if is_small or largest_deviation(nlp, current.rollout) < settings.near:
            break
    return Variables(current.variables[:knots], current.variables[knots:])


class TrackedPath(NamedTuple):
    """Variables of a tracked path, Shape (size,), with their roll-out and merit."""

    variables: FloatArray
    rollout: Rollout
    merit: float


@dataclass(frozen=True, eq=False)
class LeastSquares:
    """Residuals of one program at every node, across and along the input."""

    nlp: NonlinearProgram
    # Shape (num_nodes, 6): position of the input, its normal, weights of the squared residuals across and along it
    reference: FloatArray
    smoothness: float  # weight of the integral of the squared curvature rate
    trusted: IntArray  # nodes whose headings the trust region bounds

    @classmethod
    def of(cls, nlp: NonlinearProgram) -> LeastSquares:
        """Return the residuals of a program."""
        settings, basis = nlp.settings.tracking, nlp.basis
        share = settings.weight * float(np.add.reduce(nlp.lengths)) / basis.num_intervals
        reference = np.empty((basis.num_nodes, 6))
        reference[:, :2], reference[:, 2:4] = nlp.cost.reference
        reference[:, 4:] = share, share * settings.along
        reference[basis.last_nodes[:-1], 4:] = share * settings.cusp
        smoothness = settings.smoothness * nlp.cost.factors[1]
        return cls(nlp, reference, smoothness, trusted_nodes(basis, nlp.settings.step))

    def residuals(self, rollout: Rollout) -> Iterator[tuple[FloatArray, FloatArray, FloatArray]]:
        """Yield the axis, Shape (num_nodes, 2), the residuals and their weights, across the input and along it."""
        x, y = (rollout.poses[:, :2] - self.reference[:, :2]).T
        across = self.reference[:, 2:4]
        along = np.column_stack((-across[:, 1], across[:, 0]))
        for i, axis in enumerate((across, along)):
            yield axis, axis[:, 0] * x + axis[:, 1] * y, self.reference[:, 4 + i]


_TRACK = Kernel("optdock_track", sizes=4, numbers=2)
_LINEARIZE = Kernel("optdock_track_linearized", sizes=5, numbers=1)
_NO_ROWS = readonly(np.empty(0, dtype=np.int64))


def _arrays(least: LeastSquares) -> tuple[tuple[FloatArray | IntArray, int], ...]:
    """Return the arrays that both kernels read."""
    basis = least.nlp.basis
    return (
        (basis.packed, 2 * (basis.num_intervals + basis.num_nodes) * basis.num_knots),
        (basis.divisions, 2 * basis.num_gears),
        (least.reference, 6 * basis.num_nodes),
        (basis.stiffness, basis.num_knots**2),
    )


def _track_natively(least: LeastSquares, variables: FloatArray) -> TrackedPath:
    nlp, basis = least.nlp, least.nlp.basis
    count = 4 * basis.num_nodes + 6 * basis.num_intervals
    out, given = np.empty(count + 1), np.concatenate((variables, nlp.ends.start, nlp.ends.signs))
    arrays = (
        *_arrays(least),
        (given, basis.size + 3 + basis.num_gears),
        (nlp.ends.target, 3),
        (out, count + 1),
        (np.empty(basis.num_knots), basis.num_knots),
    )
    sizes = basis.num_gears, basis.num_knots, basis.num_nodes, basis.num_intervals
    _TRACK(sizes, (least.smoothness, nlp.settings.tracking.goal_weight), arrays)
    return TrackedPath(variables, Rollout.within(out[:count], basis), out.item(count))


@twin_of(_track_natively)
def tracked_path(least: LeastSquares, variables: FloatArray) -> TrackedPath:
    """Return the path of variables, Shape (size,), and its merit.

    The merit is the sum of the weighted squares, the smoothness and the error at the goal.
    """
    nlp, basis, knots = least.nlp, least.nlp.basis, least.nlp.basis.num_knots
    curvature, lengths = variables[:knots], variables[knots:]
    rollout = roll_out(basis, Variables(curvature, lengths), nlp.ends.start, nlp.ends.signs)
    across, along = (float(in_order(w * (r * r))) for _, r, w in least.residuals(rollout))
    slopes = in_order(basis.stiffness * curvature, 1)
    bent = float(in_order(curvature * slopes / lengths[basis.knot_gear]))
    missed = float(in_order(np.abs(nlp.ends.error(rollout))))
    merit = across + along + least.smoothness * bent + nlp.settings.tracking.goal_weight * missed
    return TrackedPath(variables, rollout, merit)


def _linearize_natively(least: LeastSquares, current: TrackedPath) -> Linearization:
    nlp, basis, size, trusted = least.nlp, least.nlp.basis, least.nlp.basis.size, least.trusted.size
    count, work = numbers_before_rows(size, trusted), size * (3 * basis.num_nodes + size + 4)
    values = np.empty(count)
    arrays = (
        *_arrays(least),
        (least.trusted, trusted),
        (current.variables, size),
        (current.rollout.packed, 4 * basis.num_nodes + 6 * basis.num_intervals),
        (nlp.ends.target, 3),
        (values, count),
        (np.empty(work), work),
    )
    sizes = basis.num_gears, basis.num_knots, basis.num_nodes, basis.num_intervals, trusted
    _LINEARIZE(sizes, (least.smoothness,), arrays)
    return Linearization(values, _NO_ROWS, basis, trusted)


@twin_of(_linearize_natively)
def linearized_tracking(least: LeastSquares, current: TrackedPath) -> Linearization:
    """Return the linearization at a path: the Gauss-Newton model of the merit without the error at the goal.

    There are no rows of clearance.
    """
    basis, knots, rollout = least.nlp.basis, least.nlp.basis.num_knots, current.rollout
    variables = Variables(current.variables[:knots], current.variables[knots:])
    by = sensitivity(basis, variables, rollout)
    stiffness = least.smoothness / variables.lengths[basis.knot_gear] * basis.stiffness
    gradient, hessian = np.zeros(basis.size), np.zeros((basis.size, basis.size))
    gradient[:knots], hessian[:knots, :knots] = 2.0 * in_order(stiffness * variables.curvature, 1), 2.0 * stiffness
    for axis, residual, weight in least.residuals(rollout):
        moved = axis[:, :1] * by.x + axis[:, 1:] * by.y
        gradient += 2.0 * in_order((weight * residual)[:, None] * moved)
        hessian += 2.0 * in_order(weight[:, None, None] * (moved[:, :, None] * moved[:, None]))
    goal = np.array((by.x[-1], by.y[-1], by.yaw[-1])), least.nlp.ends.error(rollout)
    model, no_rows = Quadratic(gradient, hessian), ClearanceRows(np.empty((0, basis.size)), np.empty(0), _NO_ROWS)
    parts = Subproblem(variables, model, np.eye(basis.size), goal, by.yaw[least.trusted], no_rows)
    return Linearization.of(basis, parts)
