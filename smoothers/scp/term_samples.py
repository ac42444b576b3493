"""Terms at dense samples of a path, independently of the search.

Every path that is returned passes this check. It evaluates the hard terms at samples of the final curves, including
the final straight and turns in place, and does not prove anything between the samples.
"""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING

import numpy as np

from optdock.deadline import never_late
from optdock.geometry.pose import wrap_angles
from optdock.kernels import Kernel, twin_of
from optdock.model.segments import ClothoidSegment, PolylineSegment, TurnSegment
from optdock.plugins.outcomes import SampledBound
from optdock.verification.certificate import Memo
from smoothers.terms import SYMBOLS

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

    from optdock.geometry.arrays import FloatArray
    from optdock.geometry.clothoid import ClothoidSpline
    from optdock.model.path import Path
    from optdock.model.segments import Segment
    from smoothers.scp.term_functions import TermSet

__all__ = ["SPACING", "sampled_cost", "sampled_terms", "samples_of"]

SPACING = 0.005  # [m] between samples
_TURNING = 0.01  # [rad] between samples
_PLACES = frozenset(("x", "y", "yaw"))
_SAMPLES = Kernel("optdock_clothoid_samples", sizes=3, numbers=3)
_BENT = 1e9  # [1/m]: curvature of a turn in place
_AT_ONCE = 4096  # samples between two looks at the clock, in about a millisecond
# The last result on each path: paths and terms are immutable, and every stage asks again.
_KEPT: Memo[Path, tuple[TermSet, tuple[SampledBound, ...]]] = Memo()


def sampled_terms(
    terms: TermSet,
    path: Path,
    before: float = 0.0,
    after: float = 0.0,
    is_late: Callable[[], bool] = never_late,
) -> tuple[SampledBound, ...]:
    """Return the smallest sampled value of every hard term along a path; -inf where a value is not finite.

    Args:
        terms: Terms.
        path: Path.
        before: Distance driven before the path [m].
        after: Distance left to drive after the path [m].
        is_late: Polled between blocks of samples. If it returns True, all values are -inf.
    """
    if not terms.hard:
        return ()
    is_whole = before == after == 0.0
    known = _KEPT.recall(path) if is_whole else None
    if known is not None and known[0] is terms:
        return known[1]
    hard = terms.only_hard
    points, stations = samples_of(path, before, after, hard.reads)
    values = hard.values(points[:_AT_ONCE])
    for begin in range(_AT_ONCE, len(points), _AT_ONCE):
        if is_late():
            is_whole, values = False, np.full((1, len(terms.hard)), np.nan)
            break
        values = np.concatenate((values, hard.values(points[begin : begin + _AT_ONCE])))
    lowest = zip(terms.hard, values.argmin(axis=0).tolist(), strict=True)  # the first that is not a number, if any is
    found = tuple(
        SampledBound(term.name, -math.inf if math.isnan(least) else least, stations.item(row), SPACING)
        for k, (term, row) in enumerate(lowest)
        for least in (values.item(row, k),)
    )
    if is_whole:
        _KEPT.keep(path, (terms, found))
    return found


def sampled_cost(terms: TermSet, path: Path, without: float, before: float = 0.0, after: float = 0.0) -> float:
    """Return the cost of the soft terms along a path without its last part, by the trapezoidal rule.

    Args:
        terms: Terms.
        path: Path.
        without: Length of the last part, the final straight [m].
        before: As in `sampled_terms` [m].
        after: As in `sampled_terms` [m].
    """
    if not terms.soft:
        return 0.0
    points, _ = samples_of(path, before, after)
    residuals = terms.values(points)[:, len(terms.hard) :]
    cost = residuals**2 @ terms.weights
    steps = np.where(points[1:, 5] >= without + after, np.diff(points[:, 4]), 0.0)
    return float(0.5 * steps @ (cost[1:] + cost[:-1]))


def samples_of(
    path: Path, before: float = 0.0, after: float = 0.0, reads: Collection[str] = SYMBOLS
) -> tuple[FloatArray, FloatArray]:
    """Return the values of the symbols at samples of a path, Shape (n, 7), and their path coordinates, Shape (n,) [m].

    The ends of all segments are samples. `before` and `after` are as in `sampled_terms`. Positions and headings are 0
    if none of them is in `reads`.
    """
    lengths = (0.0 if isinstance(segment, TurnSegment) else segment.length for segment in path.segments)
    driven = list(itertools.accumulate(lengths, initial=before))
    parts, whole, has_places = [], driven[-1] + after, not _PLACES.isdisjoint(reads)
    for segment, start, done in zip(path.segments, path.segment_starts.tolist(), driven, strict=False):
        if isinstance(segment, ClothoidSegment):
            s, points = _clothoid_samples(segment.spline, _steps(segment), done, whole, has_places=has_places)
        else:
            s, points = _other_samples(segment, done, whole)
        parts.append((start + s, points))
    stations, points = parts[0] if len(parts) == 1 else map(np.concatenate, zip(*parts, strict=True))
    return points, stations


def _steps(segment: Segment) -> int:
    """Return the number of steps between the samples of a segment."""
    if isinstance(segment, PolylineSegment):
        turned = float(np.abs(np.diff(segment.poses[:, 2])).sum())
    elif isinstance(segment, TurnSegment):
        turned = abs(segment.turn)
    else:
        turned = segment.length * max(map(abs, segment.spline.curvature.tolist()))
    return math.ceil(max(segment.length / SPACING, turned / _TURNING, 1.0))


def _clothoid_samples_native(
    spline: ClothoidSpline, steps: int, driven: float, whole: float, *, has_places: bool
) -> tuple[FloatArray, FloatArray]:
    n, table = steps + 1, spline.table
    s, points = np.empty(n), np.empty((n, len(SYMBOLS)))
    arrays = (table, table.size), (s, n), (points, points.size)
    _SAMPLES((n, len(table), has_places), (spline.sign, driven, whole), arrays)
    return s, points


@twin_of(_clothoid_samples_native)
def _clothoid_samples(
    spline: ClothoidSpline, steps: int, driven: float, whole: float, *, has_places: bool
) -> tuple[FloatArray, FloatArray]:
    """Return arc lengths, and the symbols there; `driven` and `whole` are those before the spline and of the path.

    Positions are integrated from the last break by (S26), the trapezoidal rule with the derivatives at both ends of a
    step ([Abramowitz1964] eq. 23.1.30). The error is 1/720 of the fourth power of the turn of a step, at most 0.01 rad,
    times the length, unless the curvature changes its sign within a step.
    """
    s = np.linspace(0.0, spline.length, steps + 1)
    points = np.zeros((s.size, len(SYMBOLS)))
    if has_places:
        breaks = spline.table[1:-1, 0].searchsorted(s, side="right")
        base, along = spline.table[breaks], s - spline.table[breaks, 0]
        before = np.maximum(np.concatenate(([0.0], s[:-1])) - base[:, 0], 0.0)
        (first, bends), (second, others) = _directions(base, before), _directions(base, along)
        moved = (along - before)[:, None]
        moves = spline.sign * moved * (0.5 * (first + second) + moved / 12.0 * (bends - others))
        passed = np.concatenate((np.zeros((1, 2)), np.cumsum(moves, axis=0)))
        points[:, :2] = base[:, 1:3] + passed[1:] - passed[breaks.searchsorted(breaks)]
        points[:, 2] = wrap_angles(base[:, 3] + along * (base[:, 4] + 0.5 * along * base[:, 5]))
    points[:, 3], points[:, 4], points[:, 6] = spline.curvature_at(s), driven + s, spline.sign
    points[:, 5] = whole - points[:, 4]
    return s, points


def _directions(base: FloatArray, s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the unit vectors of the headings at `s` behind breaks, and their derivatives, Shape (n, 2) each."""
    yaw, curvature = base[:, 3] + s * (base[:, 4] + 0.5 * s * base[:, 5]), base[:, 4] + s * base[:, 5]
    cosine, sine = np.cos(yaw), np.sin(yaw)
    return np.column_stack((cosine, sine)), np.column_stack((-curvature * sine, curvature * cosine))


def _other_samples(
    segment: PolylineSegment | TurnSegment, driven: float, whole: float
) -> tuple[FloatArray, FloatArray]:
    """Return arc lengths, and the symbols there, as `_clothoid_samples`."""
    s = np.linspace(0.0, segment.length, _steps(segment) + 1)
    poses = segment.poses_at(s)
    if isinstance(segment, PolylineSegment):  # steps without length have more than one pose at an arc length
        s, poses = np.concatenate((s, segment.knots)), np.concatenate((poses, segment.poses))
        order = np.argsort(s, kind="stable")
        s, poses = s[order], poses[order]
    points = np.empty((s.size, len(SYMBOLS)))
    points[:, :2], points[:, 2], points[:, 6] = poses[:, :2], wrap_angles(poses[:, 2]), int(segment.direction)
    if isinstance(segment, TurnSegment):
        points[:, 3], points[:, 4] = math.copysign(_BENT, segment.turn), driven
    else:
        points[:, 3], points[:, 4] = segment.curvature_at(s), driven + s
    points[:, 5] = whole - points[:, 4]
    return s, points
