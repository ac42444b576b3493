"""Why no guess became a plan, and which of the reasons is reported."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from optdock.errors import (
    CertificationFailed,
    FailedToTimePath,
    NoValidPathCouldBeFound,
    OptdockError,
    PlannerException,
    PlannerTimedOut,
    SmootherException,
    SmootherTimedOut,
    TimedOut,
    TimingTimedOut,
)
from optdock.model.dock import DockDirection
from optdock.model.path import Direction
from optdock.planning.refinement import ran_out_of_time

if TYPE_CHECKING:
    from collections.abc import Iterator

    from optdock.model.path import Path
    from optdock.model.problem import DockingProblem
    from optdock.planning.plan import PartialPlan

__all__ = ["Failure", "Failures", "stage_of"]

# How far a guess came that ended in such an error: the further, the more its reason tells.
_STAGES: tuple[tuple[type[OptdockError], int], ...] = (
    (FailedToTimePath, 3),
    (CertificationFailed, 2),
    (SmootherException, 1),
    (PlannerException, 0),
)


def stage_of(error: OptdockError) -> int | None:
    """How far a guess came that ended in an error; None where that says nothing of the guess."""
    return next((stage for kind, stage in _STAGES if isinstance(error, kind)), None)


class Failure(NamedTuple):
    """A guess, or a planner, that came to nothing: why, what existed by then, and how far it came."""

    error: OptdockError
    left: PartialPlan
    stage: int


class Failures:
    """The guesses and planners of one call that came to nothing.

    Args:
        problem: That is planned.
        budget: Of the call [s].
    """

    def __init__(self, problem: DockingProblem, budget: float) -> None:
        self._problem, self._budget = problem, budget
        self._all: list[Failure] = []

    def __len__(self) -> int:
        return len(self._all)

    def __iter__(self) -> Iterator[Failure]:
        return iter(self._all)

    def add(self, failure: Failure) -> None:
        """Take in one more."""
        self._all.append(failure)

    def forget(self, raw_path: Path) -> None:
        """Forget that of a guess, which is tried once more."""
        self._all = [failure for failure in self._all if failure.left.raw_path is not raw_path]

    def furthest(self) -> Failure:
        """The failure that tells most: of the guess that came furthest, the earliest; time-outs tell least.

        Where no planner had a guess the last one, which searched, tells more than the first.
        """
        if not any(failure.stage for failure in self._all):
            return self._all[-1]
        return max(self._all, key=lambda failure: (failure.stage, not isinstance(failure.error, TimedOut)))

    def refusal(self, *, is_cut_off: bool, is_late: bool) -> OptdockError:
        """What is raised when nothing was found and nothing proven.

        That there was too little time wherever more of it might have found a plan; else the failure that tells most.

        Args:
            is_cut_off: By the clock, with guesses not made, or not tried, yet.
            is_late: Whether no time is left for another guess.
        """
        late = [failure for failure in self._all if isinstance(failure.error, TimedOut)]
        if not self._all:
            if is_cut_off or is_late:
                return PlannerTimedOut(ran_out_of_time("the search for a first guess", self._budget))
            return NoValidPathCouldBeFound("no planner offers a path")
        found = self.furthest()
        for_good = self._no_guess_can_help()
        if for_good is None and (late or is_cut_off):
            return self._time_out(late, found)
        error = (for_good or found).error
        if len(self._all) > 1:
            error.args = (f"{error} ({self._attempts})", *error.args[1:])
        return error

    def _time_out(self, late: list[Failure], found: Failure) -> TimedOut:
        """The time-out that came furthest, and what became of the guess that says most."""
        last = max(reversed(late), key=lambda failure: failure.stage, default=None)
        if last is not None:
            kind = next(kind for kind in (TimingTimedOut, SmootherTimedOut, TimedOut) if isinstance(last.error, kind))
            error = (PlannerTimedOut if kind is TimedOut else kind)(str(last.error), where=last.error.where)
            error.__cause__ = last.error
        else:
            kind = SmootherTimedOut if found.stage else PlannerTimedOut
            error = kind(ran_out_of_time("the search for other guesses", self._budget))
        if len(self._all) > 1 or last is None:
            error.args = (f"{error} ({self._attempts})",)
        if not isinstance(found.error, TimedOut):
            error.args = (f"{error}; until then {type(found.error).__name__}: {found.error}",)
        return error

    @property
    def _attempts(self) -> str:
        return f"{len(self._all)} attempts failed; that there is no way is not proven"

    def _no_guess_can_help(self) -> Failure | None:
        """A failure for a reason that every guess has, whichever and however much time there were; or None."""
        gears = {Direction.FORWARD, Direction.REVERSE}
        if self._problem.dock.direction is not DockDirection.AUTO:
            gears = {Direction.FORWARD if self._problem.dock.direction is DockDirection.FORWARD else Direction.REVERSE}
        for failure in self._all:
            reason, raw = failure.error.where.get("reason"), failure.left.raw_path
            if reason == "start_curvature":
                return failure
            if reason in ("approach_blocked", "approach_unseen") and raw is not None:
                gears.discard(raw.segments[-1].direction)
                if not gears:
                    return failure
        return None
