"""The strategy: what is tried and in which order, within the time that is given.

`STRATEGY` is the whole list. A search can be stopped at any time: its best feasible iterate is certified when it
converges or when time gets short, and nothing that is not certified is returned.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

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
from smoothers.scp.iteration_times import IterationTimes
from smoothers.scp.loop import search
from smoothers.scp.nlp import formulate, with_intervals
from smoothers.scp.refusals import (
    refuse_approach,
    refuse_certificate,
    refuse_search,
    refuse_start,
    refuse_unseen_approach,
)
from smoothers.scp.visibility_constraint import ViewBound

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.deadline import Deadline
    from optdock.errors import SmootherException
    from optdock.geometry.pose import Pose2
    from optdock.model.problem import DockingProblem
    from optdock.verification import Certificate
    from smoothers.scp.collision.collision_scene import Scene
    from smoothers.scp.loop import Iterate, SearchGuess
    from smoothers.scp.nlp import Formulation, NonlinearProgram
    from smoothers.scp.qp_step import ProgramPool
    from smoothers.scp.settings import AnytimeSettings, Settings, ViewSettings

__all__ = [
    "STRATEGY",
    "Call",
    "Given",
    "Incumbent",
    "Search",
    "SearchOutcome",
    "Solver",
    "direct_line",
    "earlier_answer",
    "input_answer",
    "is_clothoid_answer",
    "straight_line",
]


# Kinds of violations that say something about the ends of a path alone; where the dock must be seen is counted from the
# end of the whole path, which a piece does not know.
_OF_THE_ENDS = ("start", "goal", "direction", "start_curvature", "final_straight")


class Call(NamedTuple):
    """What is asked for.

    Attributes:
        path: The input, in the problem's frame.
        problem: What must hold.
        earlier: An earlier result in the same frame, or None.
        formulation: Weights and resolution.
        max_iterations: Of every search.
        first_only: Stop at the first certified path.
        within: Where the call is about a piece of a path: the problem of the whole, whose rule of clearance counts near
            its own start and goal, not near the ends of the piece.
    """

    path: Path
    problem: DockingProblem
    earlier: Path | None
    formulation: Formulation
    max_iterations: int = 60
    first_only: bool = False
    within: DockingProblem | None = None
    after: float = 0.0

    @property
    def whole(self) -> DockingProblem:
        """The problem whose rule of clearance counts."""
        return self.problem if self.within is None else self.within

    def certified(self, path: Path, is_late: Callable[[], bool]) -> Certificate:
        """The certificate of a path; of a piece, but for the ends that are not its own: those of the whole decide."""
        certificate = certify_path(path, self.whole, is_late=is_late)
        if self.within is None:
            return certificate
        others = _OF_THE_ENDS if self.problem.goal == self.whole.goal else (*_OF_THE_ENDS, "view")
        broken = tuple(violation for violation in certificate.violations if violation.kind not in others)
        return replace(certificate, violations=broken)


class Given(NamedTuple):
    """A path that is an answer as it stands, where it is certified.

    Attributes:
        status: Of the result.
        path: Which one, or None.
        ends_all: Whether nothing is left to search for where there is one and something is certified.
    """

    status: SmoothingStatus
    path: Callable[[Call, AnytimeSettings], Path | None]
    ends_all: bool = False


class Search(NamedTuple):
    """A search from a guess; up to two repairs where the certificate refuses its result.

    A repair begins at the refused variables. Where the search took them for feasible it aims at three times the buffer
    and looks at four times as many obstacles in every interval, small ones included; where only the cautious bound
    between its nodes was in the way, its intervals are half as long.

    Attributes:
        guess: Where it begins, or None.
        thoroughly: With finer nodes and small obstacles looked at everywhere; worth trying among many obstacles only.
        after_the_goal: Only where the search before met the goal: one that is out of reach for the curvature stays so.
        relieved: Under the weaker rule of clearance near the start; for robots that start too close to something.
    """

    guess: Callable[[InitialGuesses], SearchGuess | None]
    thoroughly: bool = False
    after_the_goal: bool = False
    relieved: bool = False


def is_clothoid_answer(path: Path, problem: DockingProblem, settings: AnytimeSettings) -> bool:
    """Whether it is a clothoid path between the right ends and within the limits; the certificate decides the rest."""
    if max(path.start.gap_to(problem.start), path.end.gap_to(problem.goal)) > settings.same_pose:
        return False
    limits = problem.robot.limits
    for segment in path.segments:
        if not isinstance(segment, ClothoidSegment):
            return False
        curvature, knots = segment.spline.curvature, segment.knots
        rate = np.abs(np.diff(curvature) / np.diff(knots)).max()
        if np.abs(curvature).max() > limits.max_curvature or rate > limits.max_curvature_rate:
            return False
    return True


def earlier_answer(call: Call, settings: AnytimeSettings) -> Path | None:
    """The earlier result, where it may be the answer."""
    if call.earlier is None or not is_clothoid_answer(call.earlier, call.problem, settings):
        return None
    return call.earlier


def direct_line(call: Call, settings: AnytimeSettings) -> Path | None:
    """The straight line to the goal, where the robot already stands on its axis and no further than needed; or None.

    From the staging pose nothing is left to optimize but the final straight, which the search takes for granted.
    """
    problem = call.problem
    line = straight_line(call.path, problem.start, problem.goal, settings)
    if line is None or line.length >= problem.dock.final_straight + settings.staging:
        return None
    return Path((line,), problem.frame)


def straight_line(path: Path, start: Pose2, end: Pose2, settings: AnytimeSettings) -> ClothoidSegment | None:
    """The straight line between two poses in the only gear of a path; None where it has more, or they share no axis."""
    if len(path.segments) > 1:
        return None
    sign = int(path.segments[0].direction)
    seen = end.in_frame_of(start)
    length = sign * seen.x
    if length <= 0.0 or max(abs(seen.y), abs(seen.yaw)) > settings.on_axis:
        return None
    return ClothoidSegment(ClothoidSpline(start, np.array([0.0, length]), np.zeros(2), sign))


def input_answer(call: Call, settings: AnytimeSettings) -> Path | None:
    """The input, where it may be the answer: a certified one is never exchanged for a costlier path."""
    return call.path if is_clothoid_answer(call.path, call.problem, settings) else None


STRATEGY: tuple[Given | Search, ...] = (
    Given(SmoothingStatus.INPUT_KEPT, input_answer),
    Given(SmoothingStatus.STRAIGHT, direct_line, ends_all=True),
    # The first search that ends with a certified path, or for want of time, is the last one.
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
    Given(SmoothingStatus.WARM_START_KEPT, earlier_answer),
)
"""Everything that is tried, in this order."""


class Incumbent(NamedTuple):
    """A certified path, its certificate, its cost, and its status where it was given and not searched for."""

    path: Path
    certificate: Certificate
    cost: float
    given: SmoothingStatus | None = None


@dataclass
class SearchOutcome:
    """What was found.

    Attributes:
        incumbent: The best certified path, or None.
        last: The last iterate.
        converged: Whether the search ended by itself.
        iterations: Steps tried.
        refused: The last candidate that a certificate refused, and that certificate, or None.
        setup_time: Seconds from the start of the call to the first search.
        first_certified: Seconds from the start of the call to the first certificate, or None.
        certify_time: Seconds spent on certificates.
    """

    incumbent: Incumbent | None = None
    last: Iterate | None = None
    converged: bool = False
    iterations: int = 0
    refused: tuple[Path, Certificate] | None = None
    setup_time: float = 0.0
    first_certified: float | None = None
    certify_time: float = 0.0


@dataclass
class Solver:
    """Follows the strategy for one call.

    Args:
        pool: Convex programs.
        deadline: Seconds left.
        cancelled: Polled every iteration.
        settings: Constants of the method.
    """

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

    def __post_init__(self) -> None:
        self.times = IterationTimes(self.deadline, self.settings.anytime)

    def follow_strategy(self, call: Call) -> Incumbent:
        """A certified path.

        Args:
            call: What is asked for.

        Raises:
            FailedToSmoothPath: Which bound is in the way.
            SmootherTimedOut: No certified path in time.
            SmootherCancelled: The caller does not want it any more.
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
        """Certify a given path; whether that is the end."""
        path = row.path(self.call, self.settings.anytime)
        if path is None:
            return False
        self._offer(path, row.status)
        if not row.ends_all or self.outcome.incumbent is None:
            return False
        self.outcome.converged = True
        return True

    def _try(self, row: Search) -> bool:
        """Search, where it is worth it; whether that is the end: something is certified, or the time is over."""
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
        """Make the program that a row asks for; False where it would be the one that was searched already."""
        if row.thoroughly and not self._is_thorough:
            if len(self._nlp.scene.obstacles) <= self.settings.resolution.many_obstacles:
                return False
            self._nlp, self._guesses = self._prepared_thoroughly()
            self._is_thorough, self._closest = True, None
        if row.relieved and self._nlp.scene.start_relief == 0.0:
            if self._nlp.scene.start_clearance >= self.call.problem.path_clearance.required:
                return False
            scene = replace(self._nlp.scene, start_relief=self.call.problem.start_run)
            self._nlp = replace(self._nlp, scene=scene)
            self._guesses, self._closest = replace(self._guesses, nlp=self._nlp), None
        return True

    def prepared(self, call: Call) -> tuple[NonlinearProgram, InitialGuesses]:
        """The program of a call, with fewer nodes among many obstacles, and its guesses.

        Raises:
            FailedToSmoothPath: A bound that is in the way of any path.
            SmootherTimedOut: No time is left.
        """
        self._raise_if_late()
        path, problem, resolution = call.path, call.problem, self.settings.resolution
        start_clearance, nearest, *_ = end_clearances(call.whole)
        refusal = refuse_start(path, problem, start_clearance, nearest)
        if refusal is None and problem.goal == call.whole.goal:
            refusal = refuse_approach(path, call.whole, start_clearance) or refuse_unseen_approach(path, call.whole)
        if refusal is not None:
            raise refusal.error()
        self._raise_if_late()
        shares = np.linspace(0.0, 1.0, resolution.input_samples)
        positions = np.concatenate([segment.poses_at(shares * segment.length)[:, :2] for segment in path.segments])
        scene = scene_around(call.whole, positions, start_clearance, self.settings.collision)
        self._raise_if_late()
        many = len(scene.obstacles) > resolution.many_obstacles
        return self._formulated(call, scene, resolution.coarser_among_many if many else 1.0)

    def _prepared_thoroughly(self) -> tuple[NonlinearProgram, InitialGuesses]:
        """The same with finer nodes and small obstacles looked at everywhere."""
        self._raise_if_late()
        scene = self._nlp.scene
        scene = replace(scene, settings=replace(scene.settings, thins_small_obstacles=False))
        return self._formulated(self.call, scene, 1.0)

    def _formulated(self, call: Call, scene: Scene, coarser: float) -> tuple[NonlinearProgram, InitialGuesses]:
        # Longer robots are larger in everything: obstacles can be looked at in larger distances.
        interval = call.formulation.interval * max(1.0, scene.body.radius / self.settings.resolution.body_radius)
        chosen = call.formulation._replace(interval=coarser * interval)
        earlier = rest_of_earlier_result(call.earlier, call.path, call.problem, self.settings.guess)
        lengths = earlier.lengths if earlier is not None else None
        nlp = formulate(call.path, call.problem, scene, chosen, lengths, self.settings)
        nlp = _with_view(nlp, call, self.settings.view)
        self.times.expect(nlp, self.pool.pace)
        return nlp, InitialGuesses(nlp, earlier, self.pool, self.times.no_more_iterations)

    def _raise_if_late(self) -> None:
        if self.deadline.passed():
            raise self._timed_out()

    def _timed_out(self) -> SmootherTimedOut:
        """With the path of the last iterate, from which a later call may go on."""
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
            path, certificate = outcome.refused
            return refuse_certificate(certificate, path).error()
        return refuse_search(self._nlp, closest, self.call.problem, self.call.whole).error()

    def _offer(self, path: Path, status: SmoothingStatus) -> None:
        """A result from elsewhere, if it is certified."""
        certificate = self._judged(path, self.deadline.elapsed)
        if certificate.certified:
            cost = self._nlp.cost.of_clothoids(path, self.call.problem.dock.final_straight)
            self.outcome.incumbent = Incumbent(path, certificate, cost, status)
            self.outcome.first_certified = self.deadline.elapsed

    def _search_and_repair(self, nlp: NonlinearProgram, guess: SearchGuess) -> None:
        """Search, and search again more cautiously where the certificate refuses the result."""
        chosen = self.settings.anytime
        for _ in range(chosen.repairs + 1):
            self._search(nlp, guess)
            refused = self._settle(nlp)
            if refused is None or not self.outcome.converged:
                break
            finer = [chosen.repair_finer * cells for _, cells in nlp.basis.shape]
            nlp = _more_cautious(nlp, chosen) if refused.feasible else with_intervals(nlp, finer)
            guess = guess._replace(variables=refused.variables)

    def _search(self, nlp: NonlinearProgram, guess: SearchGuess) -> None:
        self.outcome.converged = False
        expected = self.times.expected_iteration(nlp)
        before = self.deadline.elapsed
        for progress in search(nlp, guess, self.pool, self.call.max_iterations, self._must_settle):
            if self.cancelled():
                raise SmootherCancelled("the smoother was cancelled")
            self.outcome.last, self.outcome.converged = progress.iterate, progress.finished
            self.outcome.iterations += progress.iterations > 0
            self._consider(progress.iterate)
            self.times.measured(self.deadline.elapsed - before, expected)
            if self._enough(nlp):
                return
            before = self.deadline.elapsed

    def _must_settle(self) -> bool:
        """Whether a step that takes longer than any before must be left unfinished for the sake of what is at hand."""
        return not self.deadline.fits(self.times.reserve(has_candidate=self._candidate is not None))

    def _consider(self, iterate: Iterate) -> None:
        best = self._candidate.cost if self._candidate is not None else math.inf
        held = self.outcome.incumbent.cost if self.outcome.incumbent is not None else math.inf
        if iterate.feasible and iterate.cost < min(best, held):
            self._candidate = iterate

    def _enough(self, nlp: NonlinearProgram) -> bool:
        """Whether to stop; certifies the candidate when time becomes short."""
        step = self.settings.anytime.iteration_reserve * self.times.iteration
        short = not self.deadline.fits(step + self.times.reserve(has_candidate=self._candidate is not None))
        first_only = self.call.first_only
        if self._candidate is not None and (first_only or (short and self.outcome.incumbent is None)):
            self._settle(nlp)
            short = not self.deadline.fits(step)
        found = first_only and self.outcome.incumbent is not None
        self.outcome.converged = self.outcome.converged or found  # no more was asked for; no time limit ended it
        return short or found

    def _settle(self, nlp: NonlinearProgram) -> Iterate | None:
        """Certify the candidate; returns it when it was refused."""
        candidate, self._candidate = self._candidate, None
        if candidate is None and self.outcome.incumbent is None and self._is_nearly_feasible(nlp):
            candidate = self.outcome.last
        if candidate is None:
            return None
        grace = self.settings.anytime.grace if self.outcome.incumbent is None else 0.0
        if not self.deadline.fits(self.times.certificate - grace):
            self.outcome.converged = False
            return None
        began, problem = self.deadline.elapsed, self.call.problem
        path = exact_path(nlp, candidate.variables, problem.dock.final_straight).with_frame(problem.frame)
        certificate = self._judged(path, began)
        if not certificate.certified and self.times.is_late():
            self.outcome.converged = False
            return None
        if not certificate.certified:
            self.outcome.refused = path, certificate
            return candidate
        self.outcome.incumbent = Incumbent(path, certificate, candidate.cost)
        if self.outcome.first_certified is None:
            self.outcome.first_certified = self.deadline.elapsed
        return None

    def _judged(self, path: Path, began: float) -> Certificate:
        """The certificate of a path; what passed since `began` [s] counts as its time."""
        certificate = self.call.certified(path, self.times.is_late)
        self.outcome.certify_time += self.times.certified(began)
        return certificate

    def _is_nearly_feasible(self, nlp: NonlinearProgram) -> bool:
        last = self.outcome.last
        if last is None or not self.outcome.converged:
            return False
        chosen = self.settings.anytime
        lost = most_sag(last.rollout, nlp.scene.body.radius)
        return last.on_goal and last.shortfall < max(chosen.nearly, chosen.nearly_in_sags * lost)


def _with_view(nlp: NonlinearProgram, call: Call, chosen: ViewSettings) -> NonlinearProgram:
    """The program with the view of the dock, where the problem asks for it."""
    view = call.whole.required_view
    if view is None:
        return nlp
    bound = ViewBound(view, call.whole, nlp.ends.signs, call.problem.dock.final_straight + call.after)
    loop = replace(
        nlp.settings.loop, goal_penalty=chosen.goal_penalty, goal_above_clearance=chosen.goal_above_clearance
    )
    settings = replace(nlp.settings, loop=loop)
    return replace(nlp, view=bound, settings=settings)


def _more_cautious(nlp: NonlinearProgram, chosen: AnytimeSettings) -> NonlinearProgram:
    """The program that keeps more off obstacles and looks at more of them."""
    seen = nlp.scene.settings
    seen = replace(seen, nearest=chosen.repair_nearest * seen.nearest, thins_small_obstacles=False)
    step = replace(nlp.settings.step, buffer=chosen.repair_buffer * nlp.settings.step.buffer)
    return replace(nlp, scene=replace(nlp.scene, settings=seen), settings=replace(nlp.settings, step=step))
