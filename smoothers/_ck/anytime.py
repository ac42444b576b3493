"""The search under a deadline: the best candidate so far is certified in time, or nothing is returned."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NamedTuple

from optdock.errors import SmootherCancelled
from optdock.verification import certify_path
from smoothers._ck.scp import search
from smoothers._ck.spline import exact_path

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.path import Path
    from optdock.problem import DockingProblem
    from optdock.verification.certificate import Certificate
    from smoothers._ck.budget import Budget
    from smoothers._ck.qp import ProgramPool
    from smoothers._ck.scp import Iterate
    from smoothers._ck.task import Task

__all__ = ["Incumbent", "Outcome", "Runner"]

# Until one was measured [s]: without obstacles, per obstacle nearby, and per metre, obstacle and part of the body.
_CERTIFY_GUESS = (0.0025, 1.2e-5, 8e-7)
_ITERATION_GUESS = (0.0015, 2e-5, 0.0)
_CERTIFY_PER_ITERATION = 1.2
_GRACE = 0.0015  # [s]: how late the only certificate may be expected to end
_LATEST = 0.0005  # [s] past the end of the budget: what a certificate has not proven by then it leaves
_NEARLY = 5e-3  # [m]: a shortfall that may be due to the cautious bound between nodes
_REPAIRS = 2


class Incumbent(NamedTuple):
    """A certified path, its certificate, its cost, and its origin: `search`, `input`, `line` or `warm_start`."""

    path: Path
    certificate: Certificate
    cost: float
    origin: str = "search"


@dataclass
class Outcome:
    """What a run found.

    Attributes:
        incumbent: The best certified path, or None.
        last: The last iterate.
        converged: Whether the search ended by itself.
        iterations: Steps tried.
        refused: The last certificate that refused a candidate, or None.
        first_certified: Seconds from the start of the call to the first certificate, or None.
        certify_time: Seconds spent on certificates.
    """

    incumbent: Incumbent | None = None
    last: Iterate | None = None
    converged: bool = False
    iterations: int = 0
    refused: Certificate | None = None
    first_certified: float | None = None
    certify_time: float = 0.0


@dataclass
class Runner:
    """Runs searches for one problem within one budget.

    Args:
        problem: What must hold.
        pool: Convex programs.
        budget: Seconds left.
        cancelled: Polled every iteration.
        max_iterations: Of every search.
        first_only: Stop at the first certified path.
    """

    problem: DockingProblem
    pool: ProgramPool
    budget: Budget
    cancelled: Callable[[], bool]
    max_iterations: int = 60
    first_only: bool = False
    outcome: Outcome = field(default_factory=Outcome)
    _candidate: Iterate | None = None
    _longest: float = 0.0
    _certify: float = 0.0

    def run(self, task: Task) -> Outcome:
        """Search, and where nothing is found try what the task offers next; the failure that came closest is kept."""
        self._longest = _guess(task, _ITERATION_GUESS)
        self._certify = self._certify or _guess(task, _CERTIFY_GUESS)
        closest: Iterate | None = None
        following: Task | None = task
        while following is not None:
            self._repaired(following)
            failed = self.outcome.last
            if self.outcome.incumbent is not None or not self.outcome.converged or failed is None:
                return self.outcome
            closest = failed if closest is None or failed.missing < closest.missing else closest
            following = following.restart(failed.on_goal)
        self.outcome.last = closest
        return self.outcome

    def _repaired(self, task: Task) -> None:
        """Search, and search again more cautiously where the certificate refuses the result."""
        for _ in range(_REPAIRS + 1):
            self._search(task)
            rejected = self._settle(task)
            if rejected is None or not self.outcome.converged:
                break
            world = replace(task.world, per_interval=4 * task.world.per_interval, is_thinned=False)
            task = replace(task, initial=rejected.variables, buffer=3.0 * task.buffer, world=world)

    def offer(self, path: Path, cost: float, origin: str) -> None:
        """A first result from elsewhere, if it is certified."""
        certificate = self._judged(path, self.budget.elapsed)
        if certificate.certified:
            self.outcome.incumbent = Incumbent(path, certificate, cost, origin)
            self.outcome.first_certified = self.budget.elapsed

    def finished(self) -> Outcome:
        """The offers alone, where nothing is left to search for."""
        self.outcome.converged = True
        return self.outcome

    def _judged(self, path: Path, began: float) -> Certificate:
        """The certificate of a path; what passed since `began` [s] counts as its time."""
        certificate = certify_path(path, self.problem, is_late=self._is_late)
        self._certify = self.budget.elapsed - began
        self.outcome.certify_time += self._certify
        return certificate

    def _search(self, task: Task) -> None:
        self.outcome.converged = False
        before = self.budget.elapsed
        for progress in search(task, self.pool, self.max_iterations, self._must_settle):
            if self.cancelled():
                raise SmootherCancelled("the smoother was cancelled")
            self.outcome.last, self.outcome.converged = progress.iterate, progress.finished
            self.outcome.iterations += progress.iterations > 0
            self._consider(progress.iterate)
            self._longest = max(0.8 * self._longest, self.budget.elapsed - before)
            if self.outcome.certify_time == 0.0:  # none was measured yet, but how fast this machine is was
                self._certify = max(self._certify, _CERTIFY_PER_ITERATION * self._longest)
            if self._enough(task):
                return
            before = self.budget.elapsed

    def _must_settle(self) -> bool:
        """Whether a step that takes longer than any before must be left unfinished for the sake of what is at hand."""
        return not self.budget.fits(self._reserve)

    @property
    def _reserve(self) -> float:
        """Seconds for the certificate of the candidate, where there is one."""
        return 1.2 * self._certify if self._candidate is not None else 0.0

    def _consider(self, iterate: Iterate) -> None:
        best = self._candidate.cost if self._candidate is not None else float("inf")
        held = self.outcome.incumbent.cost if self.outcome.incumbent is not None else float("inf")
        if iterate.feasible and iterate.cost < min(best, held):
            self._candidate = iterate

    def _enough(self, task: Task) -> bool:
        """Whether to stop; certifies the candidate when time becomes short."""
        step = 1.1 * self._longest
        short = not self.budget.fits(step + self._reserve)
        if self._candidate is not None and (self.first_only or (short and self.outcome.incumbent is None)):
            self._settle(task)
            short = not self.budget.fits(step)
        found = self.first_only and self.outcome.incumbent is not None
        self.outcome.converged = self.outcome.converged or found  # no more was asked for; no time limit ended it
        return short or found

    def _settle(self, task: Task) -> Iterate | None:
        """Certify the candidate; returns it when it was refused."""
        candidate, self._candidate = self._candidate, None
        if candidate is None and self.outcome.incumbent is None and self._nearly_feasible():
            candidate = self.outcome.last
        if candidate is None:
            return None
        if not self.budget.fits(self._certify - (_GRACE if self.outcome.incumbent is None else 0.0)):
            self.outcome.converged = False
            return None
        began = self.budget.elapsed
        path = exact_path(task, candidate.variables, self.problem.dock.final_straight)[0].with_frame(self.problem.frame)
        certificate = self._judged(path, began)
        if not certificate.certified and self._is_late():
            self.outcome.converged = False
            return None
        if not certificate.certified:
            self.outcome.refused = certificate
            return candidate
        self.outcome.incumbent = Incumbent(path, certificate, candidate.cost)
        if self.outcome.first_certified is None:
            self.outcome.first_certified = self.budget.elapsed
        return None

    def _is_late(self) -> bool:
        return self.budget.left < -_LATEST

    def _nearly_feasible(self) -> bool:
        last = self.outcome.last
        if last is None or not self.outcome.converged:
            return False
        return last.on_goal and last.shortfall < _NEARLY


def _guess(task: Task, share: tuple[float, float, float]) -> float:
    """Seconds that something takes."""
    obstacles, parts = len(task.world.obstacles), len(task.world.body.vertices)
    return share[0] + obstacles * (share[1] + share[2] * parts * float(task.initial.lengths.sum()))
