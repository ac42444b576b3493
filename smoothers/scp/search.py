"""The strategy: searches from several guesses, in the order of `STRATEGY`, within a time limit.

The best feasible iterate of a search is certified when the search converges or little time remains. Only certified
paths are returned.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.deadline import clock_name
from optdock.errors import SmootherCancelled, SmootherTimedOut
from optdock.geometry.clothoid import ClothoidSpline
from optdock.model.path import ClothoidSegment, Path
from optdock.planning.plan import PartialPlan
from optdock.plugins.interfaces import SmoothingStatus
from optdock.verification import certify_path, end_clearances
from smoothers.scp.collision.collision_scene import scene_around
from smoothers.scp.collision.narrow_phase import most_sag
from smoothers.scp.goal_projection import driven_path, exact_path
from smoothers.scp.initial_guess import InitialGuesses, rest_of_earlier_result
from smoothers.scp.loop import search
from smoothers.scp.nlp import Formulation, enclosing_positions, formulate, with_intervals
from smoothers.scp.refusals import (
    refuse_approach,
    refuse_certificate,
    refuse_search,
    refuse_start,
    refuse_term,
    refuse_terms_at_ends,
    refuse_unseen_approach,
)
from smoothers.scp.term_rows import TermBound, tightened
from smoothers.scp.term_samples import sampled_cost, sampled_terms
from smoothers.scp.visibility_constraint import ViewBound

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.deadline import Deadline
    from optdock.errors import SmootherException
    from optdock.geometry.pose import Pose2
    from optdock.model.problem import DockingProblem
    from optdock.plugins.outcomes import SampledBound
    from optdock.verification import Certificate
    from smoothers.scp.collision.collision_scene import Scene
    from smoothers.scp.loop import Iterate, SearchGuess
    from smoothers.scp.nlp import NonlinearProgram
    from smoothers.scp.qp_step import ProgramPool
    from smoothers.scp.refusals import Refusal
    from smoothers.scp.settings import AnytimeSettings, Settings
    from smoothers.scp.term_functions import TermSet

__all__ = [
    "STRATEGY",
    "Call",
    "Given",
    "Incumbent",
    "IterationTimes",
    "PathVerdict",
    "Search",
    "SearchOutcome",
    "Solver",
    "direct_line",
    "is_clothoid_answer",
    "straight_line",
]


# Violations that concern the ends of a path only. The stretch in view is measured from the end of the whole path.
_OF_THE_ENDS = ("start", "goal", "direction", "start_curvature", "final_straight")


class PathVerdict(NamedTuple):
    """Certificate of a path, and the hard terms at samples of a certified path; its truth value is `accepted`."""

    certificate: Certificate
    sampled: tuple[SampledBound, ...] = ()

    def __bool__(self) -> bool:
        return self.accepted

    @property
    def accepted(self) -> bool:
        """Whether the path is certified and no hard term is negative at a sample."""
        certified = self.certificate.certified
        return certified and all(bound.holds for bound in self.sampled) if self.sampled else certified

    def refusal(self, path: Path) -> Refusal:
        """Return the refusal for the first violation on `path`."""
        if not self.certificate.certified:
            return refuse_certificate(self.certificate, path)
        return refuse_term(next(bound for bound in self.sampled if not bound.holds), path)


class Call(NamedTuple):
    """A smoothing task."""

    path: Path  # input, in the problem's frame
    problem: DockingProblem
    earlier: Path | None  # earlier result in the same frame, or None
    formulation: Formulation  # weights and resolution
    max_iterations: int = 60  # limit of every search
    first_only: bool = False  # whether to stop at the first certified path
    # for a piece of a path, the problem of the whole path, whose clearance rule applies; else None
    within: DockingProblem | None = None
    after: float = 0.0  # length of the path after the piece [m]
    before: float = 0.0  # length of the path before the piece [m]
    terms: TermSet | None = None  # costs and constraints of the user, or None

    @property
    def whole(self) -> DockingProblem:
        """Problem of the whole path, whose clearance rule applies."""
        return self.problem if self.within is None else self.within

    def judged(self, path: Path, is_late: Callable[[], bool]) -> PathVerdict:
        """Return the verdict on a path; for a piece, violations that concern ends of the whole path are removed."""
        certificate = certify_path(path, self.whole, is_late=is_late)
        if self.within is not None:
            others = _OF_THE_ENDS if self.problem.goal == self.whole.goal else (*_OF_THE_ENDS, "view")
            broken = tuple(violation for violation in certificate.violations if violation.kind not in others)
            certificate = replace(certificate, violations=broken)
        if self.terms is None or not certificate.certified:
            return PathVerdict(certificate)
        return PathVerdict(certificate, sampled_terms(self.terms, path, self.before, self.after, is_late))


class Given(NamedTuple):
    """A given path, which is returned without a search if it is certified."""

    status: SmoothingStatus
    path: Callable[[Call, AnytimeSettings], Path | None]  # the path, or None
    ends_all: bool = False  # whether no search follows once the path is certified


class Search(NamedTuple):
    """A search from a guess, with up to two repairs if its result is not certified.

    A repair begins at the rejected variables. If these were feasible, the repair uses three times the buffer and
    considers four times as many obstacles per interval, including small ones. If only the bound between nodes was
    violated, the repair uses intervals of half the length.
    """

    guess: Callable[[InitialGuesses], SearchGuess | None]  # the first variables, or None
    thoroughly: bool = False  # whether nodes are finer and small obstacles active everywhere; only among many obstacles
    after_the_goal: bool = False  # whether the search is only run if the search before it reached the goal
    # whether the weaker clearance rule near the start applies; only for starts with too little clearance
    relieved: bool = False


def is_clothoid_answer(path: Path, problem: DockingProblem, settings: AnytimeSettings) -> bool:
    """Whether `path` is a clothoid path between the ends of the problem and within its curvature limits."""
    limits = problem.robot.limits
    for segment in path.segments:
        if not isinstance(segment, ClothoidSegment):
            return False
        curvature, knots = segment.spline.curvature, segment.knots
        rate = np.abs(np.diff(curvature) / np.diff(knots)).max()
        if np.abs(curvature).max() > limits.max_curvature or rate > limits.max_curvature_rate:
            return False
    return max(path.start.gap_to(problem.start), path.end.gap_to(problem.goal)) <= settings.same_pose


def direct_line(call: Call, settings: AnytimeSettings) -> Path | None:
    """Return the line from a start on the goal's axis, if it is little longer than the final straight, or None."""
    problem = call.problem
    if problem.start.distance_to(problem.goal) >= problem.dock.final_straight + settings.staging:
        return None
    line = straight_line(call.path, problem.start, problem.goal, settings)
    return None if line is None else Path((line,), problem.frame)


def straight_line(path: Path, start: Pose2, end: Pose2, settings: AnytimeSettings) -> ClothoidSegment | None:
    """Return the straight line between two poses on one axis, in the gear of a path with a single gear, or None."""
    if len(path.segments) > 1:
        return None
    sign = int(path.segments[0].direction)
    seen = end.in_frame_of(start)
    length = sign * seen.x
    if length <= 0.0 or max(abs(seen.y), abs(seen.yaw)) > settings.on_axis:
        return None
    return ClothoidSegment(ClothoidSpline(start, np.array([0.0, length]), np.zeros(2), sign))


def _if_answer(path: Path | None, call: Call, settings: AnytimeSettings) -> Path | None:
    return path if path is not None and is_clothoid_answer(path, call.problem, settings) else None


STRATEGY: tuple[Given | Search, ...] = (
    # A certified input is never replaced by a costlier path.
    Given(SmoothingStatus.INPUT_KEPT, lambda call, settings: _if_answer(call.path, call, settings)),
    Given(SmoothingStatus.STRAIGHT, direct_line, ends_all=True),
    # The first search that ends with a certified path, or at the time limit, is the last one.
    Search(lambda guesses: guesses.rest_of_earlier),
    Search(lambda guesses: guesses.first),
    Search(lambda guesses: guesses.on_the_input),
    Search(lambda guesses: guesses.other, after_the_goal=True),
    Search(lambda guesses: guesses.rest_of_earlier, thoroughly=True),
    Search(lambda guesses: guesses.first, thoroughly=True),
    Search(lambda guesses: guesses.on_the_input, thoroughly=True),
    Search(lambda guesses: guesses.other, thoroughly=True, after_the_goal=True),
    Search(lambda guesses: guesses.first, relieved=True),
    Search(lambda guesses: guesses.on_the_input, relieved=True),
    Search(lambda guesses: guesses.other, relieved=True, after_the_goal=True),
    Given(SmoothingStatus.WARM_START_KEPT, lambda call, settings: _if_answer(call.earlier, call, settings)),
)
"""Candidates and searches, in order."""


class Incumbent(NamedTuple):
    """A certified path with its certificate and cost, and its status if it was not found by a search."""

    path: Path
    certificate: Certificate
    cost: float
    given: SmoothingStatus | None = None


@dataclass
class SearchOutcome:
    """State and statistics of a call."""

    incumbent: Incumbent | None = None  # best certified path, or None
    last: Iterate | None = None
    converged: bool = False  # whether the search ended without a time limit
    iterations: int = 0  # number of steps
    # last candidate that was not accepted, and the verdict on it, or None
    refused: tuple[Path, PathVerdict] | None = None
    setup_time: float = 0.0  # time from the start of the call to the first search [s]
    first_certified: float | None = None  # time from the start of the call to the first certificate [s], or None
    certify_time: float = 0.0  # time for certificates [s]


class IterationTimes:
    """Predicted times of the next iteration and the next certificate (S21), corrected by measured times.

    Attributes:
        iteration: Predicted time of the next iteration [s].
        certificate: Predicted time of the next certificate [s]; 0 until known.
        margin: Time reserved for later stages [s].
        pace: Smallest ratio of a measured iteration time to its prediction.
    """

    def __init__(self, deadline: Deadline, settings: AnytimeSettings) -> None:
        self.deadline, self._settings = deadline, settings
        self.iteration = self.certificate = 0.0
        self._certificate_was_measured = False
        self._expected = self.pace = math.inf
        share, most = settings.margin
        self.margin = min(share * deadline.seconds, most)

    def expect(self, nlp: NonlinearProgram, pace: float) -> None:
        """Predict the times of a program on a machine slower than the benchmark machine by the factor `pace`."""
        chosen, (parts, v, _) = self._settings, nlp.scene.body.vertices.shape
        obstacles, length = len(nlp.scene.obstacles.vertices), float(np.add.reduce(nlp.lengths))
        iteration, certificate = (
            once + obstacles * (each + per_metre * parts * length)
            for once, each, per_metre in (chosen.iteration_seconds, chosen.certificate_seconds)
        )
        self._expected = iteration + chosen.iteration_per_corner * (parts * v * nlp.basis.num_intervals)
        self.iteration = pace * self._expected
        if nlp.terms is not None and nlp.terms.terms.hard:
            once, per_metre = chosen.term_seconds
            certificate += once + per_metre * length
        self.certificate = self.certificate or pace * certificate

    def measured(self, seconds: float) -> None:
        """Update the predictions with the measured time of an iteration [s]."""
        fading = self._settings.longest_fades * self.iteration
        self.iteration = seconds if seconds > fading else fading
        if seconds < self.pace * self._expected:
            self.pace = seconds / self._expected
        if not self._certificate_was_measured:
            self.certificate = max(self.certificate, self._settings.certificate_per_iteration * self.iteration)

    def certified(self, since: float) -> float:
        """Update the prediction with the time of a certificate that began at `since` [s]; return this time [s]."""
        self.certificate, self._certificate_was_measured = self.deadline.elapsed - since, True
        return self.certificate

    def no_more_iterations(self) -> bool:
        """Whether the remaining time is too short for an iteration."""
        return not self.deadline.fits(self.iteration)

    def is_late(self) -> bool:
        """Whether a running certificate must be abandoned because it is too late."""
        return self.deadline.left < -self._settings.latest


@dataclass
class Solver:
    """Run of the strategy for one call; `cancelled` is polled in every iteration."""

    pool: ProgramPool
    deadline: Deadline
    cancelled: Callable[[], bool]
    settings: Settings
    outcome: SearchOutcome = field(default_factory=SearchOutcome)
    times: IterationTimes = field(init=False)
    call: Call = field(init=False)
    _nlp: NonlinearProgram = field(init=False)
    _guesses: InitialGuesses = field(init=False)
    _is_thorough: bool = False
    _closest: Iterate | None = None  # of the failed searches for this program
    _candidate: Iterate | None = None
    _refused: Iterate | None = None  # the last candidate that was not accepted

    def __post_init__(self) -> None:
        self.times = IterationTimes(self.deadline, self.settings.anytime)

    def follow_strategy(self, call: Call) -> Incumbent:
        """Return a certified path.

        Raises:
            FailedToSmoothPath: If a bound cannot be satisfied.
            SmootherTimedOut: If no path is certified in time.
            SmootherCancelled: If `cancelled` returned True.
        """
        self.call = call
        self._nlp, self._guesses = self.prepared(call)
        self.outcome.setup_time = self.deadline.elapsed
        self._raise_if_late()
        for row in STRATEGY:
            if self._take(row) if isinstance(row, Given) else self._try(row):
                break
        if self.outcome.incumbent is None:
            raise self._failure()
        return self.outcome.incumbent

    def _take(self, row: Given) -> bool:
        """Certify a given path, and return whether the strategy ends."""
        path = row.path(self.call, self.settings.anytime)
        if path is None:
            return False
        self._offer(path, row.status)
        if not row.ends_all or self.outcome.incumbent is None:
            return False
        self.outcome.converged = True
        return True

    def _try(self, row: Search) -> bool:
        """Search if the row of `STRATEGY` applies; return whether the strategy ends, certified or at the time limit."""
        if not self._prepare_for(row):
            return False
        failed = self.outcome.last
        if row.after_the_goal and not (failed is not None and failed.on_goal):
            return False
        guess = row.guess(self._guesses)
        if guess is None:
            return False
        if self.times.no_more_iterations():
            raise self._timed_out()
        self._search_and_repair(self._nlp, guess)
        failed, closest = self.outcome.last, self._closest
        if self.outcome.incumbent is not None or not self.outcome.converged or failed is None:
            return True
        self._closest = failed if closest is None or failed.missing < closest.missing else closest
        return False

    def _prepare_for(self, row: Search) -> bool:
        """Set the program of a row of `STRATEGY`; return False if the same program was searched before."""
        if row.thoroughly and not self._is_thorough:
            if len(self._nlp.scene.obstacles) <= self.settings.resolution.many_obstacles:
                return False
            self._raise_if_late()
            scene = self._nlp.scene
            scene = replace(scene, settings=replace(scene.settings, thins_small_obstacles=False))
            self._nlp, self._guesses = self._formulated(self.call, scene, 1.0)
            self._is_thorough, self._closest = True, None
        if row.relieved and self._nlp.scene.start_relief == 0.0:
            if self._nlp.scene.start_clearance >= self.call.problem.path_clearance.required:
                return False
            scene = replace(self._nlp.scene, start_relief=self.call.problem.start_run)
            self._nlp = replace(self._nlp, scene=scene)
            self._guesses, self._closest = replace(self._guesses, nlp=self._nlp), None
        return True

    def prepared(self, call: Call) -> tuple[NonlinearProgram, InitialGuesses]:
        """Return the program of a call, with fewer nodes among many obstacles, and its guesses.

        Raises:
            FailedToSmoothPath: If no path can satisfy a bound.
            SmootherTimedOut: If no time is left.
        """
        self._raise_if_late()
        path, problem, whole, resolution = call.path, call.problem, call.whole, self.settings.resolution
        is_last = problem is whole or problem.goal == whole.goal
        start_clearance, nearest, *_ = end_clearances(whole)
        refusal = refuse_start(path, problem, start_clearance, nearest)
        if refusal is None and is_last:
            refusal = refuse_approach(path, whole, start_clearance) or refuse_unseen_approach(path, whole)
        if refusal is None and call.terms is not None:
            after = call.after if is_last else None
            refusal = refuse_terms_at_ends(path, problem, call.terms, after, is_whole=call.within is None)
        if refusal is not None:
            raise refusal.error()
        self._raise_if_late()
        positions = enclosing_positions(path, resolution.input_samples)
        scene = scene_around(whole, positions, start_clearance, self.settings.collision)
        self._raise_if_late()
        many = len(scene.obstacles.vertices) > resolution.many_obstacles
        return self._formulated(call, scene, resolution.coarser_among_many if many else 1.0)

    def _formulated(self, call: Call, scene: Scene, coarser: float) -> tuple[NonlinearProgram, InitialGuesses]:
        weights, spans, interval = call.formulation
        # Larger robots need less resolution.
        interval *= max(1.0, scene.body.radius / self.settings.resolution.body_radius)
        chosen = Formulation(weights, spans, coarser * interval)
        earlier = rest_of_earlier_result(call.earlier, call.path, call.problem, self.settings.guess)
        lengths = earlier.lengths if earlier is not None else None
        is_bounded = call.whole.required_view is not None or (call.terms is not None and call.terms.bounds_places)
        settings = self.settings.goal_first if is_bounded else self.settings
        view, terms = _bounds_of(call, settings)
        nlp = formulate(
            call.path, call.problem, scene, chosen, lengths, settings, view=view, terms=terms, look=self._raise_if_late
        )
        self.times.expect(nlp, self.pool.pace if clock_name() != "counted" else 1.0)
        return nlp, InitialGuesses(nlp, earlier, self.pool, self.times.no_more_iterations)

    def _raise_if_late(self) -> None:
        if self.deadline.passed():
            raise self._timed_out()

    def _timed_out(self) -> SmootherTimedOut:
        """Return the time-out error, with the path of the last iterate as warm start for a later call."""
        message = f"no certified path within {1e3 * self.deadline.seconds:.1f} ms"
        error, last = SmootherTimedOut(message, where={"iterations": self.outcome.iterations}), self.outcome.last
        if last is not None:
            problem = self.call.problem
            path = driven_path(self._nlp, last.variables, problem.dock.final_straight)
            error.partial = PartialPlan(path=path.with_frame(problem.frame))
        return error

    def _failure(self) -> SmootherException:
        outcome, closest = self.outcome, self._closest
        if not outcome.converged or closest is None:
            return self._timed_out()
        if outcome.refused is not None and closest.feasible:
            path, verdict = outcome.refused
            return verdict.refusal(path).error()
        return refuse_search(self._nlp, closest, self.call.problem, self.call.whole).error()

    def _offer(self, path: Path, status: SmoothingStatus) -> None:
        """Accept a given path if it is certified and satisfies the hard terms."""
        verdict, call = self._judged(path, self.deadline.elapsed), self.call
        if verdict.accepted:
            straight = call.problem.dock.final_straight
            cost = self._nlp.cost.of_clothoids(path, straight)
            if call.terms is not None:
                cost += sampled_cost(call.terms, path, straight, call.before, call.after)
            self.outcome.incumbent = Incumbent(path, verdict.certificate, cost, status)
            self.outcome.first_certified = self.deadline.elapsed

    def _search_and_repair(self, nlp: NonlinearProgram, guess: SearchGuess) -> None:
        """Search, and repair a result that is not certified."""
        for _ in range(self.settings.anytime.repairs + 1):
            self._search(nlp, guess)
            refused = self._settle(nlp)
            if refused is None or not self.outcome.converged or self._comes_too_close(refused):
                break
            nlp, guess = self._repaired(nlp, refused), guess._replace(variables=refused.variables, begun=None)

    def _comes_too_close(self, refused: Iterate) -> bool:
        """Whether a candidate comes too close to an obstacle at a pose, by more than the buffer of the steps.

        Its shortfall is then not due to the bound between nodes, and finer intervals do not help.
        """
        judged, share = self.outcome.refused, self.settings.anytime.violated_at_poses
        if judged is None or refused.shortfall < self.settings.step.buffer:
            return False
        broken = judged[1].certificate.violations
        return any(one.kind == "clearance" and one.amount > share * refused.shortfall for one in broken)

    def _repaired(self, nlp: NonlinearProgram, refused: Iterate) -> NonlinearProgram:
        """Return the program of the next search after a refused candidate."""
        chosen, judged = self.settings.anytime, self.outcome.refused
        if nlp.terms is not None and refused.terms is not None and judged is not None:
            path, verdict = judged
            if verdict.certificate.certified:  # a hard term is violated
                allowance = nlp.settings.loop.end_allowance
                return replace(nlp, terms=tightened(nlp.terms, nlp.basis, refused.variables, path, allowance))
        if refused.feasible:
            return _more_cautious(nlp, chosen)
        return with_intervals(nlp, [chosen.repair_finer * cells for _, cells in nlp.basis.shape])

    def _search(self, nlp: NonlinearProgram, guess: SearchGuess) -> None:
        self.outcome.converged = False
        before = self.deadline.elapsed
        for progress in search(nlp, guess, self.pool, self.call.max_iterations, self._must_settle):
            if self.cancelled():
                raise SmootherCancelled("the smoother was cancelled")
            self.outcome.last, self.outcome.converged = progress.iterate, progress.finished
            self.outcome.iterations += progress.iterations > 0
            rival = self._candidate or self.outcome.incumbent
            if progress.iterate.feasible and (rival is None or progress.iterate.cost < rival.cost):
                self._candidate = progress.iterate
            if progress.is_stuck and self._candidate is None and self._is_nearly_feasible(nlp):
                self._settle(nlp, progress.iterate)
                self.outcome.converged = self.outcome.incumbent is not None
            if self.outcome.converged and progress.is_stuck:
                return
            elapsed = self.deadline.elapsed
            if progress.iterations > 0:
                self.times.measured(elapsed - before)
            if self._enough(nlp, elapsed):
                return
            before = elapsed

    def _must_settle(self, seconds: float = 0.0, elapsed: float | None = None) -> bool:
        """Whether no time is left for this work [s] besides that for the certificate of a candidate, if it is due.

        With an incumbent, a certificate is due for a path that is better. `elapsed`: the time of the call [s], or None.
        """
        if self._candidate is not None or self.outcome.incumbent is not None:
            seconds += self.settings.anytime.certificate_reserve * self.times.certificate + self.times.margin
        return (self.deadline.elapsed if elapsed is None else elapsed) + seconds > self.deadline.seconds

    def _enough(self, nlp: NonlinearProgram, elapsed: float) -> bool:
        """Certify the candidate when little time remains, `elapsed` [s] after the start; return whether to stop."""
        step = self.settings.anytime.iteration_reserve * self.times.iteration
        short = self._must_settle(step, elapsed)
        first_only = self.call.first_only
        if self._candidate is not None and (first_only or (short and self.outcome.incumbent is None)):
            self._settle(nlp)
            short = self._must_settle(step)
        found = first_only and self.outcome.incumbent is not None
        self.outcome.converged = self.outcome.converged or found
        return short or found

    def _settle(self, nlp: NonlinearProgram, nearly: Iterate | None = None) -> Iterate | None:
        """Certify the candidate, or a nearly feasible iterate, and return it if the certificate fails."""
        candidate, self._candidate = self._candidate if nearly is None else nearly, None
        is_last = candidate is None and self.outcome.converged and self.outcome.incumbent is None
        if is_last and self._is_nearly_feasible(nlp):
            candidate = self.outcome.last
        if candidate is None or candidate is self._refused:
            return candidate
        began, problem = self.deadline.elapsed, self.call.problem
        grace = self.settings.anytime.grace if self.outcome.incumbent is None else 0.0
        if began + self.times.certificate - grace > self.deadline.seconds:
            self.outcome.converged = False
            return None
        path = exact_path(nlp, candidate.variables, problem.dock.final_straight, problem.frame)
        verdict = self._judged(path, began)
        if not verdict.accepted and self.times.is_late():
            self.outcome.converged = False
            return None
        if not verdict.accepted:
            self.outcome.refused, self._refused = (path, verdict), candidate
            return candidate
        self.outcome.incumbent = Incumbent(path, verdict.certificate, candidate.cost)
        if self.outcome.first_certified is None:
            self.outcome.first_certified = began + self.times.certificate
        return None

    def _judged(self, path: Path, began: float) -> PathVerdict:
        """Return the verdict on a path; its time is measured from `began` [s]."""
        verdict = self.call.judged(path, self.times.is_late)
        self.outcome.certify_time += self.times.certified(began)
        return verdict

    def _is_nearly_feasible(self, nlp: NonlinearProgram) -> bool:
        last = self.outcome.last
        if last is None:
            return False
        chosen = self.settings.anytime
        lost = most_sag(last.rollout, nlp.scene.body.radius)
        return last.on_goal and last.shortfall < max(chosen.nearly, chosen.nearly_in_sags * lost)


def _bounds_of(call: Call, settings: Settings) -> tuple[ViewBound | None, TermBound | None]:
    """Return the required view and the terms of the user along the path, if there are any."""
    seen, terms = call.whole.required_view, call.terms
    if seen is None and terms is None:
        return None, None
    after = call.problem.dock.final_straight + call.after
    signs = np.array([float(segment.direction) for segment in call.path.segments])
    bend = 2.0 * min(call.problem.robot.limits.max_curvature, settings.bounds.curvature_cap)
    return (
        None if seen is None else ViewBound(seen, call.whole, signs, after, settings.view.reach),
        None if terms is None else TermBound(terms, signs, call.before, after, settings.view.reach, bend),
    )


def _more_cautious(nlp: NonlinearProgram, chosen: AnytimeSettings) -> NonlinearProgram:
    """Return the program with a larger clearance buffer and more collision pairs."""
    seen = nlp.scene.settings
    seen = replace(seen, nearest=chosen.repair_nearest * seen.nearest, thins_small_obstacles=False)
    step = replace(nlp.settings.step, buffer=chosen.repair_buffer * nlp.settings.step.buffer)
    return replace(nlp, scene=replace(nlp.scene, settings=seen), settings=replace(nlp.settings, step=step))
