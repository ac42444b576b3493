"""Lanes of the kernels in which the cases of a campaign are judged.

- `own`: the lane of the process (see `optdock.kernels`), by default the kernels in C;
- `twin`: NumPy alone;
- `both`: the lane of the process, and every certificate once more by NumPy alone. The path and the time law are built
  again for that, so that no value of the first lane is used, except the convex pieces of outlines and obstacles. Both
  lanes must return equal verdicts, and bounds that differ by at most 1e-9. Planning by NumPy takes several times as
  long as the rest of a case and is repeated in a share of the cases only (`is_repeated`), on the counted clock: both
  lanes must then have the same outcome, and plans that differ by at most 1e-9. Of replans, new motions and answers
  of `still_holds` are compared, and of proofs that no motion exists the checks; searches and stops are not.
"""

from __future__ import annotations

import contextlib
import math
from dataclasses import replace
from typing import TYPE_CHECKING, Literal, TypeAlias, TypeVar, get_args

from experiments.fuzz.case import Verdict
from experiments.fuzz.doors import law_of, law_spec, path_of, path_spec
from experiments.fuzz.truth import says_yes
from optdock.deadline import budget_clock
from optdock.errors import OptdockError
from optdock.kernels import kernels_lane, using_kernels
from optdock.model.trajectory import Trajectory
from optdock.verification import certify_motion, certify_path

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    import numpy as np

    from experiments.fuzz.case import Case
    from optdock.model.path import Path
    from optdock.model.problem import DockingProblem
    from optdock.verification import Certificate, TrajectoryCertificate

__all__ = ["LANES", "compares_lanes", "is_repeated", "motion_differs", "path_differs", "repeated", "using_lanes"]

Lanes: TypeAlias = Literal["own", "twin", "both"]
LANES: tuple[str, ...] = get_args(Lanes)

_AGREEMENT = 1e-9  # relative to the larger of 1 and the value
_REPEATED = 0.08  # share of the cases that are planned again by NumPy
_BOUNDS = ("min_clearance", "required_clearance", "margin", "start_relief", "tube", "max_curvature", "length")
_Found = TypeVar("_Found")


class _OfProcess:
    lanes: Lanes = "own"


@contextlib.contextmanager
def using_lanes(lanes: Lanes) -> Iterator[None]:
    """Judge cases in these lanes within the context, and then in those before."""
    before, _OfProcess.lanes = _OfProcess.lanes, lanes
    try:
        with using_kernels("twin") if lanes == "twin" else contextlib.nullcontext():
            yield
    finally:
        _OfProcess.lanes = before


def compares_lanes() -> bool:
    """Return whether certificates are compared with those of the twin lane."""
    return _OfProcess.lanes == "both"


def is_repeated(rng: np.random.Generator) -> bool:
    """Draw whether a case is planned again by the twin lane if lanes are compared."""
    return bool(rng.uniform() < _REPEATED)


def path_differs(found: Certificate, path: Path, problem: DockingProblem) -> Verdict | None:
    """Return the difference between a certificate and that of the twin lane.

    Args:
        found: A certificate without a time limit.
        path: The same path, but another object than in the call that returned `found`.
        problem: The problem.
    """
    with using_kernels("twin"):
        other = certify_path(path, replace(problem))  # another object: proofs are cached
    return _differs(
        "certify_path", found, other, ((name, getattr(found, name), getattr(other, name)) for name in _BOUNDS)
    )


def motion_differs(motion: Trajectory, problem: DockingProblem) -> Verdict | None:
    """Return the difference between the certificates of a motion in this lane and in the twin lane.

    Args:
        motion: A motion for the problem.
        problem: The problem.
    """
    gears, law = path_spec(motion.path), law_spec(motion.time_law)
    found = []
    for lane in (kernels_lane(), "twin"):
        with using_kernels(lane):
            same, asked = path_of(gears).with_frame(problem.frame), replace(problem)
            found.append((certify_path(same, asked), certify_motion(Trajectory(same, law_of(law)), asked)))
    (path, timed), (other_path, other_timed) = found
    bounds = ((name, getattr(path, name), getattr(other_path, name)) for name in _BOUNDS)
    ratios = ((name, timed.ratios[name], other_timed.ratios.get(name, math.nan)) for name in timed.ratios)
    return _differs("certify_path", path, other_path, bounds) or _differs("certify_motion", timed, other_timed, ratios)


def _differs(
    what: str,
    found: Certificate | TrajectoryCertificate,
    other: Certificate | TrajectoryCertificate,
    bounds: Iterable[tuple[str, float, float]],
) -> Verdict | None:
    kinds = [[violation.kind for violation in one.violations] for one in (found, other)]
    if says_yes(found) != says_yes(other) or kinds[0] != kinds[1]:
        return Verdict("kernel differs", f"{what}: {kinds[0] or 'certified'} in C, {kinds[1] or 'certified'} by NumPy")
    for name, first, second in bounds:
        if not (first == second or abs(first - second) <= _AGREEMENT * max(1.0, abs(first))):
            return Verdict("kernel differs", f"{what} {name}: {first:.17g} in C, {second:.17g} by NumPy")
    return None


def repeated(ask: Callable[[], _Found], numbers: Callable[[_Found], Case]) -> Verdict | None:
    """Ask the library in both lanes on the counted clock, and return the difference.

    Args:
        ask: Builds its arguments from a case and calls the library.
        numbers: Returns the parts of a result that must be equal: lists of numbers, or words.
    """
    results: list[Case] = []
    for lane in (kernels_lane(), "twin"):
        with using_kernels(lane), budget_clock("counted"):
            try:
                results.append(numbers(ask()))
            except OptdockError as error:
                results.append({"outcome": type(error).__name__})
    first, second = results
    if first.keys() != second.keys():
        return Verdict("kernel differs", f"outcome: {first.get('outcome')} in C, {second.get('outcome')} by NumPy")
    for name, value in first.items():
        if not _is_near(value, second[name]):
            return Verdict("kernel differs", f"{name}: {str(value)[:80]} in C, {str(second[name])[:80]} by NumPy")
    return None


def _is_near(first: object, second: object) -> bool:
    """Whether two nested lists of numbers and words are equal, numbers up to `_AGREEMENT`."""
    if isinstance(first, list) and isinstance(second, list):
        return len(first) == len(second) and all(map(_is_near, first, second))
    if isinstance(first, float) and isinstance(second, float):
        return first == second or abs(first - second) <= _AGREEMENT * max(1.0, abs(first))
    return first == second
