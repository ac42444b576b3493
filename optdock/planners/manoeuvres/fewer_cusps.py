"""Paths with a stop less: a search over arcs often offers short gears that can be left out.

Every change of gear costs a stop, and so does every jump of the curvature within a gear. Such a jump is left to a
smoother. Where a gear lies between two in the other direction, these can be driven as one: the
stretch that the short one drives twice is left out, and the gap, which is as wide as that one turns, is left to a
smoother. The first gear can go where the next may begin at the start.
"""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np

from optdock.model.path import Path
from optdock.model.segments import PolylineSegment, TurnSegment

if TYPE_CHECKING:
    from collections.abc import Iterator

    from optdock.geometry.arrays import FloatArray
    from optdock.model.problem import DockingProblem
    from optdock.model.segments import Segment

__all__ = ["fewer_cusps"]

_SPACING = 0.02  # [m] between the poses of gears that are joined
_LONGEST = 0.5  # of the robot's length: longer gears do what shorter ones cannot


def fewer_cusps(path: Path, problem: DockingProblem) -> Iterator[Path]:
    """Guesses with one stop less each, the shortest gear left out first; turns in place stay where they are.

    Args:
        path: With cusps or without.
        problem: Whose start must be kept, and which robot drives.
    """
    segments = path.segments
    yield from _without_stops_within_gears(path)
    longest = _LONGEST * problem.robot.footprint.length
    rows = [k for k, one in enumerate(segments[:-1]) if not isinstance(one, TurnSegment) and one.length <= longest]
    for k in sorted(rows, key=lambda row: float(segments[row].length)):
        following = segments[k + 1]
        if following.direction != -segments[k].direction:
            continue
        if k == 0:
            after = _poses(following, segments[0].length, following.length)
            if problem.start_speed * following.direction >= 0.0 and len(after):
                first = np.concatenate((problem.start.as_array()[None], after))
                yield _joined(path, (), first, following, segments[2:])
        elif segments[k - 1].direction == following.direction:
            left_out, previous = segments[k].length, segments[k - 1]
            before, after = (
                _poses(previous, 0.0, previous.length - left_out),
                _poses(following, left_out, following.length),
            )
            if len(before) and len(after):
                yield _joined(path, segments[: k - 1], np.concatenate((before, after)), following, segments[k + 2 :])


def _without_stops_within_gears(path: Path) -> Iterator[Path]:
    """Two segments in the same gear as one."""
    for k, (one, following) in enumerate(itertools.pairwise(path.segments)):
        if one.direction == following.direction and not isinstance(one, TurnSegment):
            poses = np.concatenate((_poses(one, 0.0, one.length)[:-1], _poses(following, 0.0, following.length)))
            yield _joined(path, path.segments[:k], poses, following, path.segments[k + 2 :])


def _poses(segment: Segment, begin: float, end: float) -> FloatArray:
    """Poses of a segment between two arc lengths [m], none where nothing is left. Shape (n, 3)."""
    if end <= begin:
        return np.zeros((0, 3))
    return segment.poses_at(np.linspace(begin, end, 2 + int((end - begin) / _SPACING)))


def _joined(
    path: Path,
    before: tuple[Segment, ...],
    poses: FloatArray,
    gear: Segment,
    after: tuple[Segment, ...],
) -> Path:
    """Segments, a polyline in the direction of another one, and segments; headings go on without a whole turn."""
    poses = np.column_stack((poses[:, :2], np.unwrap(poses[:, 2])))
    return Path((*before, PolylineSegment(poses, gear.direction), *after), path.frame)
