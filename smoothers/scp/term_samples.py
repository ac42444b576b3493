"""Terms at dense samples of a path, independently of the search.

Every path that is returned passes this check. It evaluates the hard terms at samples of the final curves, including
the final straight and turns in place, and does not prove anything between the samples.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from optdock.deadline import never_late
from optdock.geometry.pose import wrap_angles
from optdock.model.segments import PolylineSegment, TurnSegment
from optdock.plugins.outcomes import SampledBound
from optdock.verification.certificate import Memo
from smoothers.terms import SYMBOLS

if TYPE_CHECKING:
    from collections.abc import Callable, Container

    from optdock.geometry.arrays import FloatArray
    from optdock.model.path import Path
    from optdock.model.segments import Segment
    from smoothers.scp.term_functions import TermSet

__all__ = ["SPACING", "sampled_cost", "sampled_terms", "samples_of"]

SPACING = 0.005  # [m] between samples
_TURNING = 0.01  # [rad] between samples
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
        is_late: Polled between blocks of samples. If it returns True, values that are not evaluated count as -inf.
    """
    if not terms.hard:
        return ()
    is_whole = before == after == 0.0
    known = _KEPT.recall(path) if is_whole else None
    if known is not None and known[0] is terms:
        return known[1]
    hard = terms.only_hard
    points, stations = samples_of(path, before, after, hard.reads)
    values = np.full((len(points), len(terms.hard)), -np.inf)
    for begin in range(0, len(points), _AT_ONCE):
        if begin and is_late():
            is_whole = False
            break
        block = slice(begin, begin + _AT_ONCE)
        values[block] = hard.values(points[block])
    values[~np.isfinite(values)] = -np.inf
    lowest = np.argmin(values, axis=0)
    found = tuple(
        SampledBound(term.name, float(values[row, k]), float(stations[row]), SPACING)
        for k, (term, row) in enumerate(zip(terms.hard, lowest.tolist(), strict=True))
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
    path: Path, before: float = 0.0, after: float = 0.0, reads: Container[str] = SYMBOLS
) -> tuple[FloatArray, FloatArray]:
    """Return the values of the symbols at samples of a path, Shape (n, 7), and their path coordinates, Shape (n,) [m].

    The ends of all segments are samples. `before` and `after` are as in `sampled_terms`. The heading and the curvature
    are 0 if they are not in `reads`.
    """
    parts, stations, driven = [], [], before
    for segment, start in zip(path.segments, path.segment_starts[:-1].tolist(), strict=True):
        s, poses = _stations(segment)
        points = np.zeros((s.size, len(SYMBOLS)))
        points[:, :2] = poses[:, :2]
        if "yaw" in reads:
            points[:, 2] = wrap_angles(poses[:, 2])
        points[:, 6] = int(segment.direction)
        if isinstance(segment, TurnSegment):
            points[:, 3], points[:, 4] = math.copysign(_BENT, segment.turn), driven
        else:
            if "curvature" in reads:
                points[:, 3] = segment.curvature_at(s)
            points[:, 4] = driven + s
            driven += segment.length
        parts.append(points)
        stations.append(start + s)
    joined = np.concatenate(parts)
    joined[:, 5] = driven + after - joined[:, 4]
    return joined, np.concatenate(stations)


def _stations(segment: Segment) -> tuple[FloatArray, FloatArray]:
    """Return the arc lengths and the poses of the samples of a segment."""
    if isinstance(segment, PolylineSegment):
        turned = float(np.abs(np.diff(segment.poses[:, 2])).sum())
    else:
        turned = segment.length * float(np.abs(segment.curvature_at(segment.knots)).max())
    steps = math.ceil(max(segment.length / SPACING, turned / _TURNING, 1.0))
    s = np.linspace(0.0, segment.length, steps + 1)
    poses = segment.poses_at(s)
    if isinstance(segment, PolylineSegment):  # steps without length have more than one pose at an arc length
        s, poses = np.concatenate((s, segment.knots)), np.concatenate((poses, segment.poses))
        order = np.argsort(s, kind="stable")
        s, poses = s[order], poses[order]
    return s, poses
