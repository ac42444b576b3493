"""Single smoother calls: their times, and their verdicts by the certificate and by the dense check."""

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
    """Result of one call.

    Args:
        wall: Wall-clock seconds.
        cpu: CPU seconds.
        path: The result; None without one.
        completed: Whether the smoother reports completion.
        reason: Reason of a missing result: `timed out`, or the smoother's reason; empty with a result.
        report: Report of the smoother.
    """

    wall: float
    cpu: float
    path: Path | None
    completed: bool
    reason: str
    report: SmoothingReport

    def number(self, name: str) -> float:
        """Return a number of the report; NaN if it is missing."""
        value = getattr(self.report, name)
        return float(value) if isinstance(value, (int, float)) else math.nan


@dataclass(frozen=True, eq=False)
class Verdict:
    """Both verdicts on a path."""

    certificate: Certificate
    dense: DenseReport

    @property
    def is_certified(self) -> bool:
        """Whether the certificate holds."""
        return self.certificate.certified

    @property
    def is_false(self) -> bool:
        """Whether the certificate holds although the dense check finds a violation; must never be true."""
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
    """Return the call with the least CPU time; all calls do the same work."""
    return min(calls, key=lambda call: call.cpu)


def judged(path: Path, problem: DockingProblem) -> Verdict:
    """Return both verdicts; not timed."""
    return Verdict(certify_path(path, problem), dense_check(path, problem))
