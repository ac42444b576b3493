"""Sequential convex programming with an L1 merit function and a trust region.

A step minimizes a convex quadratic model of the cost within the trust region, subject to linear bounds on curvature and
curvature rate. L1 penalties represent the linearized goal and clearance constraints. Every iterate is rolled out
exactly and projected onto the goal if possible. A step is accepted if it lowers the merit `J + rho * shortfalls + rho_T
* goal error` ([Fletcher1985], [Nocedal2006] ch. 18).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.deadline import never_late
from optdock.kernels import Kernel, twin_of
from smoothers.scp.collision.clearance_along import clearance_along
from smoothers.scp.collision.linearization import active_pairs, linearized_clearance
from smoothers.scp.goal_projection import project_and_roll_out
from smoothers.scp.qp_step import (
    NOTHING_ADDED,
    Additions,
    Linearization,
    Penalties,
    QpStep,
    StepBounds,
    Subproblem,
    linearize_and_solve_natively,
    pool_of_this_thread,
    solve_step,
    trusted_nodes,
    zone_of,
)
from smoothers.scp.rollout import Rollout, Variables, in_order, sensitivity, squared_motion
from smoothers.scp.term_rows import linearized_terms, require_numbers, term_points, terms_along
from smoothers.scp.visibility_constraint import linearized_view, view_along

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from optdock.geometry.arrays import FloatArray, IntArray
    from smoothers.scp.collision.narrow_phase import Clearance
    from smoothers.scp.nlp import NonlinearProgram
    from smoothers.scp.qp_step import ProgramPool
    from smoothers.scp.settings import LoopSettings
    from smoothers.scp.term_rows import TermsAlong
    from smoothers.scp.visibility_constraint import SeenPlaces

__all__ = [
    "Iterate",
    "Progress",
    "SearchGuess",
    "additions",
    "evaluated",
    "judged",
    "linearized",
    "linearized_step",
    "search",
]

_EVALUATE = Kernel("optdock_evaluate", sizes=1, numbers=0)


class SearchGuess(NamedTuple):
    """Initial variables of a search, and initial bounds on its steps."""

    variables: Variables  # curvatures and lengths
    trust_region: float  # first bound of the heading changes of a step [rad]
    proximal: float  # first weight of the squared motion of a step
    patience: int  # iterations within which the shortfall of an infeasible iterate must shrink
    begun: Iterate | None = None  # iterate of the variables if it is known, see `evaluated`


class Iterate(NamedTuple):
    """Variables with their roll-out and constraint values.

    The arrays are views of `values` and `pairs`, which are the memory of the kernels. `values` has, in this order:
    variables, roll-out (see `Rollout.packed`), end error, zones, the six numbers `cost` to `moved`, required clearance
    (nodes,), its gradient (nodes, 2), the requirement by the growth from the start alone (nodes,), `Clearance.table`,
    and `term_points` if the program has terms. `pairs` has the part of the rule at every node, and `Pairs`.
    """

    nlp: NonlinearProgram
    values: FloatArray
    pairs: IntArray
    cost: float  # value of the cost
    shortfall: float  # largest shortfall of clearance, view or a hard term [m]
    short: float  # sum of the shortfalls in all zones [m]
    missed: float  # sum of the absolute end errors [m, rad]
    moved: float  # largest change of a heading [rad] or length [m] since the iterate before, or 0
    on_goal: bool  # whether the path ends at the target
    feasible: bool  # whether the path may be certified
    view: SeenPlaces | None = None  # view margins, or None without a required view
    terms: TermsAlong | None = None  # terms of the user, or None

    @classmethod
    def of(
        cls,
        nlp: NonlinearProgram,
        values: FloatArray,
        pairs: IntArray,
        view: SeenPlaces | None = None,
        terms: TermsAlong | None = None,
    ) -> Iterate:
        """Return the iterate of these arrays."""
        end, settings = nlp.packed.results, nlp.settings.loop
        cost, shortfall, short, missed, off, moved = values[end : end + 6].tolist()
        on_goal = off <= settings.goal_tolerance  # not so if an error is NaN
        feasible = on_goal and shortfall <= settings.clearance_tolerance
        return cls(nlp, values, pairs, cost, shortfall, short, missed, moved, on_goal, feasible, view, terms)

    @property
    def flat(self) -> FloatArray:
        """Knot curvatures and gear lengths, Shape (size,)."""
        return self.values[: self.nlp.basis.size]

    @property
    def variables(self) -> Variables:
        """Knot curvatures and gear lengths."""
        basis = self.nlp.basis
        return Variables(self.values[: basis.num_knots], self.values[basis.num_knots : basis.size])

    @property
    def rollout(self) -> Rollout:
        """The path at the nodes."""
        basis = self.nlp.basis
        length = 4 * basis.num_nodes + 6 * basis.num_intervals
        return Rollout.within(self.values[basis.size : basis.size + length], basis)

    @property
    def zones(self) -> FloatArray:
        """Largest shortfall of clearance, view and hard terms in each zone, >= 0, Shape (zones,) [m]."""
        end = self.nlp.packed.results
        return self.values[end - self.nlp.settings.step.zones : end]

    @property
    def end_error(self) -> FloatArray:
        """Last pose minus the target, Shape (3,) [m, m, rad]."""
        end = self.nlp.packed.results - self.nlp.settings.step.zones
        return self.values[end - 3 : end]

    @property
    def clearance(self) -> Clearance:
        """Near pairs."""
        packed = self.nlp.packed
        return packed.room.clearance(self.pairs, self.values[packed.results + 6 : self.values.size - packed.points])

    @property
    def term_points(self) -> FloatArray:
        """Symbols of the terms at the nodes, see `term_points`; only of a program with terms."""
        return self.values[-self.nlp.packed.points :].reshape(self.nlp.basis.num_nodes, -1)

    @property
    def missing(self) -> float:
        """Sum of the goal error and the shortfalls in all zones [m, rad]."""
        return self.short + self.missed

    def merit(self, penalties: Penalties) -> float:
        """Return the cost plus penalties."""
        return self.cost + penalties.clearance * self.short + penalties.goal * self.missed


class Progress(NamedTuple):
    """The current iterate after an iteration, and whether the search has converged."""

    iterate: Iterate
    iterations: int
    finished: bool
    is_stuck: bool = False  # whether no step improves the iterate until the penalties are raised


def search(
    nlp: NonlinearProgram,
    guess: SearchGuess,
    pool: ProgramPool,
    max_iterations: int = 60,
    is_late: Callable[[], bool] = never_late,
) -> Iterator[Progress]:
    """Yield the progress for the initial iterate and after every iteration; the last progress is `finished`.

    Args:
        nlp: Program.
        guess: First variables.
        pool: Convex programs.
        max_iterations: Largest number of steps.
        is_late: Called within every iteration; a result of True ends the search without a further iterate.
    """
    settings = nlp.settings.loop
    penalties = Penalties(settings.clearance_penalty, settings.goal_penalty)
    state = _State(settings, guess.trust_region, guess.proximal, guess.patience, penalties)
    if is_late():
        return
    current = evaluated(nlp, np.concatenate(guess.variables)) if guess.begun is None else guess.begun
    yield Progress(current, 0, finished=False)
    around: Linearization | None = None
    for iteration in range(1, max_iterations + 1):
        within = StepBounds(state.trust_region, state.proximal, state.penalties)
        if around is None:
            state.found = state.found or current.feasible
            buffer = nlp.settings.step.buffer
            if not state.found:
                buffer += state.overshoot(current)
            around, step = linearized_step(current, buffer, additions(current, buffer), pool, within)
        else:
            step = solve_step(nlp, around, pool, within)
        if is_late():
            return
        finished = current.feasible and step is not None and step.gain < state.settings.small_gain * current.cost
        better = None if finished else _improved(current, around, step, state)
        if better is not None:
            finished = state.has_settled(current, better)
            current, around = better, None
        penalties = state.penalties
        finished = finished or state.is_hopeless(current) or iteration == max_iterations
        yield Progress(current, iteration, finished=finished, is_stuck=state.penalties is not penalties)
        if finished:
            return


def _evaluate_natively(
    nlp: NonlinearProgram, variables: FloatArray, before: Iterate | None
) -> tuple[FloatArray, IntArray]:
    packed, basis, size, nodes = nlp.packed, nlp.basis, nlp.basis.size, nlp.basis.num_nodes
    room, table = packed.room, packed.results + 6 + 4 * nodes
    pairs = np.empty(nodes + 3 * room.pairs, dtype=np.int64)
    values = np.empty(table + room.width * room.pairs + packed.points)
    work, indices = pool_of_this_thread().work(packed.work, room.indices)
    earlier = variables if before is None else before.values
    arrays = (
        (packed.counts, packed.counts.size),
        (packed.numbers, packed.numbers.size),
        (basis.packed, 2 * (basis.num_intervals + nodes) * basis.num_knots),
        (nlp.scene.packed, room.scene),
        (variables, size),
        (earlier, earlier.size),
        (pairs, pairs.size),
        (values, values.size),
        (work, work.size),
        (indices, indices.size),
    )
    p = _EVALUATE((before is not None,), (), arrays)
    return values[: table + room.width * p + packed.points], pairs[: nodes + 3 * p]


@twin_of(_evaluate_natively)
def _evaluated(nlp: NonlinearProgram, variables: FloatArray, before: Iterate | None) -> tuple[FloatArray, IntArray]:
    """Return the arrays of the result of `evaluated`, without the required view and terms."""
    settings, knots = nlp.settings.loop, nlp.basis.num_knots
    projected, rollout = project_and_roll_out(nlp, Variables(variables[:knots], variables[knots:]))
    moved, reach = 0.0, settings.reach
    if before is not None:
        turned = np.maximum.reduce(np.abs(rollout.poses[:, 2] - before.rollout.poses[:, 2]))
        stretched = np.maximum.reduce(np.abs(projected.lengths - before.variables.lengths))
        moved = max(float(turned), float(stretched))
        reach = min(settings.most_reach, settings.reach_per_motion * moved + settings.least_reach)
    return _judged(nlp, projected, rollout, reach, moved)


def _judged(
    nlp: NonlinearProgram, variables: Variables, rollout: Rollout, reach: float, moved: float
) -> tuple[FloatArray, IntArray]:
    """Return the arrays of the result of `judged`, without the required view and terms."""
    settings, scene, basis, count = nlp.settings.loop, nlp.scene, nlp.basis, nlp.settings.step.zones
    found = clearance_along(scene, basis, rollout, nlp.ends.signs, reach + scene.rule.required)
    pairs, zones = found.pairs, np.zeros(count)
    if found.margin.size:
        # The end poses are given and were checked; the lower bound in the intervals next to them is conservative.
        at_ends = (pairs.interval == 0) | (pairs.interval == basis.num_intervals - 1)
        short = np.where(at_ends, -settings.end_allowance, 0.0) - found.margin
        np.maximum.at(zones, zone_of(basis, basis.left[pairs.interval], count), short)
    error, required = nlp.ends.error(rollout), found.required
    missed = np.abs(error)
    cost = nlp.cost.value(variables, rollout)
    results = cost, zones.max(), in_order(zones), in_order(missed), missed.max(), moved
    parts = *variables, rollout.packed, error, zones, np.array(results), required.value, required.gradient
    points = () if nlp.terms is None else (term_points(nlp.terms, basis, variables, rollout),)
    values = np.concatenate((*parts, required.leaving, found.table, *points), axis=None)
    return values, np.concatenate((required.rule, *pairs))


def judged(nlp: NonlinearProgram, variables: Variables, rollout: Rollout, reach: float) -> Iterate:
    """Return the iterate of a roll-out; pairs with more than `reach` [m] above the required clearance are left out."""
    return _with_view_and_terms(nlp, *_judged(nlp, variables, rollout, reach, 0.0))


def evaluated(nlp: NonlinearProgram, variables: FloatArray, before: Iterate | None = None) -> Iterate:
    """Return the projected iterate of `variables`, Shape (size,); `moved` is its change since the iterate `before`."""
    return _with_view_and_terms(nlp, *_evaluated(nlp, variables, before))


def _with_view_and_terms(nlp: NonlinearProgram, values: FloatArray, pairs: IntArray) -> Iterate:
    """Return the iterate of two arrays, with the shortfalls of the required view and the terms of the user."""
    basis, packed, view, terms = nlp.basis, nlp.packed, None, None
    if nlp.terms is not None:
        points = values[-packed.points :].reshape(basis.num_nodes, -1)
        terms = terms_along(nlp.terms, basis, values[basis.num_knots : basis.size], points)
        values[packed.results] += terms.cost
        if terms.worst > 0.0:
            _add_shortfalls(nlp, values, np.arange(basis.num_nodes), terms.short)
    if nlp.view is not None:
        found = Iterate.of(nlp, values, pairs)
        view = view_along(nlp.view, basis, found.variables, found.rollout)
        _add_shortfalls(nlp, values, view.node, -view.margin.min(axis=0, initial=np.inf))
    return Iterate.of(nlp, values, pairs, view, terms)


def _add_shortfalls(nlp: NonlinearProgram, values: FloatArray, node: IntArray, short: FloatArray) -> None:
    """Add shortfalls at nodes, Shape (n,) [m], to the arrays of an iterate."""
    end, zones = nlp.packed.results, nlp.settings.step.zones
    largest = values[end - zones : end]
    # The end poses are given, as in `_judged`.
    allowed = np.where((node == 0) | (node == nlp.basis.num_nodes - 1), nlp.settings.loop.end_allowance, 0.0)
    np.maximum.at(largest, zone_of(nlp.basis, node, zones), short - allowed)
    values[end + 1 : end + 3] = largest.max(), in_order(largest)


@twin_of(linearize_and_solve_natively)
def linearized_step(
    current: Iterate, buffer: float, more: Additions, pool: ProgramPool, within: StepBounds
) -> tuple[Linearization, QpStep | None]:
    """Return the linearization at an iterate and its best step.

    Args:
        current: Iterate.
        buffer: Added to the required clearance [m].
        more: Result of `additions`.
        pool: Programs.
        within: Trust region, proximal weight and penalties.
    """
    around = linearized(current, buffer, more)
    return around, solve_step(current.nlp, around, pool, within)


def linearized(current: Iterate, buffer: float, more: Additions = NOTHING_ADDED) -> Linearization:
    """Return the linearization of `linearized_step`, whose arguments are the same, by NumPy."""
    nlp = current.nlp
    basis, settings, rollout, found = nlp.basis, nlp.settings.step, current.rollout, current.clearance
    variables = current.variables
    by = sensitivity(basis, variables, rollout)
    goal = np.array((by.x[-1], by.y[-1], by.yaw[-1])), current.end_error
    share = float(in_order(variables.lengths)) / basis.num_intervals
    motion = share * squared_motion(by, settings.yaw_motion)
    most = settings.clearance_rows[-1]
    active = active_pairs(nlp.scene, found, basis.num_intervals, most // 3)
    rows = linearized_clearance(nlp.scene, basis, rollout, by, found, active).lowest(most)
    quadratic, headings = nlp.cost.quadratic(variables, rollout, by), by.yaw[trusted_nodes(basis, settings)]
    rows = rows._replace(gap=rows.gap - _buffers(nlp, rollout, rows.node, buffer))
    quadratic, rows = more.to(quadratic, rows)
    return Linearization.of(basis, Subproblem(variables, quadratic, motion, goal, headings, rows.lowest(most)))


def _buffers(nlp: NonlinearProgram, rollout: Rollout, node: IntArray, buffer: float) -> FloatArray:
    """Return the buffer at some nodes [m], which vanishes at the ends of the path, where the pose cannot move."""
    place, start, target = rollout.poses[node], nlp.ends.start, nlp.ends.target
    from_start = np.hypot(place[:, 0] - start[0], place[:, 1] - start[1])
    to_target = np.hypot(place[:, 0] - target[0], place[:, 1] - target[1])
    found: FloatArray = buffer * np.minimum(1.0, np.minimum(from_start, to_target) / nlp.settings.step.buffer_taper)
    return found


def additions(current: Iterate, buffer: float) -> Additions:
    """Return the rows of the required view and of terms, with a buffer [m], and the costs of soft terms."""
    nlp, found = current.nlp, NOTHING_ADDED
    if nlp.terms is not None and current.terms is not None and current.terms.acts:
        require_numbers(nlp.terms, current.term_points, current.terms)
        found = linearized_terms(nlp.terms, nlp.basis, current.variables, current.rollout, current.terms)
    if nlp.view is not None and current.view is not None:
        rows = linearized_view(nlp.view, nlp.basis, current.variables, current.rollout, current.view)
        found = found if rows is None else found.with_rows(rows)
    if found.node.size:
        found.rows[:, 0] -= _buffers(nlp, current.rollout, found.node, buffer)
    return found


def _improved(current: Iterate, around: Linearization, step: QpStep | None, state: _State) -> Iterate | None:
    """Return the iterate after a step if its merit is lower, else None; adapt trust region and proximal weight.

    If a step from a feasible iterate lowers the cost but violates bounds, which are linear only to first order, their
    rows are corrected once by these violations instead ([Nocedal2006] ch. 18.3).
    """
    if step is None:
        state.reject(state.trust_region)
        return None
    nlp, settings = current.nlp, state.settings
    trial = evaluated(nlp, current.flat + step.change, current)
    if trial.merit(state.penalties) < current.merit(state.penalties):
        state.accept()
        return trial
    is_short = trial.on_goal and not trial.feasible and trial.cost < current.cost
    if is_short and current.feasible and state.rejections == 0:
        around.tighten(settings.corrected * trial.zones)
        state.rejections = 1
    else:
        state.reject(trial.moved)
    return None


@dataclass
class _State:
    """Trust region, penalties and history of a search."""

    settings: LoopSettings
    trust_region: float
    proximal: float
    patience: int
    penalties: Penalties
    rejections: int = 0
    gain: float = math.inf
    shortfalls: list[float] = field(default_factory=list)
    found: bool = False

    def overshoot(self, current: Iterate) -> float:
        """Clearance [m] added to the buffer before the first feasible iterate.

        While a side of the body pivots around the corner of an obstacle, the shortfall hardly changes from step to
        step.
        """
        return current.shortfall if current.shortfall < self.settings.overshot else 0.0

    def accept(self) -> None:
        """Enlarge the trust region after an accepted step, unless a longer step was rejected just before."""
        if self.rejections == 0:
            self.trust_region = min(self.settings.trust_growth * self.trust_region, self.settings.most_trust)
        self.proximal = max(self.settings.proximal_cut * self.proximal, self.settings.least_proximal)
        self.rejections = 0

    def reject(self, moved: float) -> None:
        """Shrink the trust region after a rejected step of size `moved`."""
        self.trust_region = self.settings.trust_cut * min(self.trust_region, max(moved, 1e-6))
        self.proximal *= self.settings.proximal_growth
        self.rejections += 1

    def has_settled(self, before: Iterate, after: Iterate) -> bool:
        """Whether the gain of a feasible iterate, or the extrapolated next gain, is small."""
        gain = before.merit(self.penalties) - after.merit(self.penalties)
        previous, self.gain = self.gain, gain if before.feasible else math.inf
        expected = gain * min(1.0, gain / previous) if math.isfinite(previous) else gain
        small = self.settings.small_gain * after.cost
        return after.feasible and before.feasible and min(gain, 2.0 * expected) < small

    def is_hopeless(self, current: Iterate) -> bool:
        """Whether no step improves the iterate, or the shortfall of an infeasible iterate no longer shrinks.

        If the shortfall costs less than the path itself, the penalties are raised first.
        """
        settings, penalties = self.settings, self.penalties
        if current.feasible:
            return self.rejections > settings.max_rejections or self.trust_region < settings.small_step
        self.shortfalls.append(current.missing)
        recent = self.shortfalls[-self.patience :]
        is_stuck = self.rejections > settings.max_rejections_infeasible
        if not is_stuck and (len(recent) < self.patience or recent[-1] < settings.shrinking * recent[0]):
            return False
        if penalties.clearance >= settings.most_penalty or penalties.clearance * current.missing > current.cost:
            return True
        clearance = settings.raised * penalties.clearance
        self.penalties = Penalties(clearance, max(penalties.goal, settings.goal_above_clearance * clearance))
        self.trust_region = max(self.trust_region, settings.raised_trust)
        self.proximal = min(self.proximal, settings.raised_proximal)
        self.rejections = 0
        self.shortfalls.clear()
        return False
