"""One call of a smoother, measured and judged by the certificate and by the dense check."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from experiments.benchmarks.tables import Timer
from experiments.dense_check import dense_check
from optdock.errors import SmootherException, SmootherTimedOut
from optdock.plugins.interfaces import SmoothingReport
from optdock.verification import certify_path

if TYPE_CHECKING:
    from experiments.dense_check import DenseReport
    from optdock.model.path import Path
    from optdock.model.problem import DockingProblem
    from optdock.plugins.interfaces import Smoother
    from optdock.verification import Certificate

__all__ = ["Call", "Verdict", "best_of", "called", "judged"]

GENEROUS = 5.0  # seconds: no limit in practice


@dataclass(frozen=True, eq=False)
class Call:
    """What one call did.

    Args:
        wall: Seconds on the wall clock.
        cpu: CPU seconds.
        path: The result, None without one.
        completed: The smoother's own word.
        reason: Why there is no result: `timed out`, or the smoother's reason; empty with a result.
        report: The smoother's report.
    """

    wall: float
    cpu: float
    path: Path | None
    completed: bool
    reason: str
    report: SmoothingReport

    def number(self, name: str) -> float:
        """A number of the report, NaN where it has none."""
        value = getattr(self.report, name)
        return float(value) if isinstance(value, (int, float)) else math.nan


@dataclass(frozen=True, eq=False)
class Verdict:
    """Both judgements of a path."""

    certificate: Certificate
    dense: DenseReport

    @property
    def is_certified(self) -> bool:
        """The certificate's word."""
        return self.certificate.certified

    @property
    def is_false(self) -> bool:
        """The certificate holds, the dense check shows a violation: must never be."""
        return self.certificate.certified and not self.dense.ok


def called(
    smoother: Smoother,
    raw: Path,
    problem: DockingProblem,
    *,
    budget: float = GENEROUS,
    warm_start: Path | None = None,
) -> Call:
    """Call `smoother` once, with `budget` [s]."""
    timer = Timer()
    try:
        result = smoother.smooth(raw, budget, problem=problem, warm_start=warm_start)
    except SmootherException as error:
        wall, cpu = timer.wall, timer.cpu
        timed_out = isinstance(error, SmootherTimedOut)
        return Call(wall, cpu, None, False, "timed out" if timed_out else _reason(error), SmoothingReport())  # noqa: FBT003 - a field
    return Call(timer.wall, timer.cpu, result.path, result.completed, "", result.report)


def _reason(error: SmootherException) -> str:
    return str(error.where.get("reason", type(error).__name__))


def best_of(calls: list[Call]) -> Call:
    """The call with the least CPU time; all of them did the same work."""
    return min(calls, key=lambda call: call.cpu)


def judged(path: Path, problem: DockingProblem) -> Verdict:
    """Both judgements, not timed."""
    return Verdict(certify_path(path, problem), dense_check(path, problem))
