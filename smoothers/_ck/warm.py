"""First variables from an earlier result for a problem much like this one."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.path import ClothoidSegment
from smoothers._ck.rollout import Variables

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from optdock.path import Path
    from optdock.problem import DockingProblem
    from smoothers._ck.layout import Layout

__all__ = ["Remaining", "remaining"]

_SPACING = 0.02  # [m], of the search for the robot on the earlier path
_LOST = 0.5  # [m]: a robot further from the earlier path does not follow it


class Remaining(NamedTuple):
    """What is left of an earlier result: its last gears, where in the first of them it begins, and free lengths.

    Attributes:
        path: The earlier result.
        first: Index of the first gear that is left.
        begin: Arc length within that gear [m].
        lengths: What is left of every gear, without the final straight, Shape (num_gears,) [m].
    """

    path: Path
    first: int
    begin: float
    lengths: FloatArray

    def variables(self, layout: Layout) -> Variables:
        """Its curvatures at the knots of `layout`."""
        knots = []
        for m, segment in enumerate(self.path.segments[self.first :]):
            share = np.linspace(0.0, 1.0, int(layout.last_knots[m] - layout.first_knots[m]) + 1)
            knots.append(segment.curvature_at((self.begin if m == 0 else 0.0) + share * self.lengths[m]))
        return Variables(np.concatenate(knots), self.lengths.copy())


def remaining(earlier: Path | None, path: Path, problem: DockingProblem) -> Remaining | None:
    """What is left of `earlier` for a robot at the problem's start, or None where it is of no use.

    It is of use when it is a clothoid path whose last gears are those of `path` and the robot is near it.
    """
    if earlier is None or not all(isinstance(segment, ClothoidSegment) for segment in earlier.segments):
        return None
    count = len(path.segments)
    first = len(earlier.segments) - count
    if first < 0:
        return None
    left = earlier.segments[first:]
    if any(a.direction is not b.direction for a, b in zip(left, path.segments, strict=True)):
        return None
    s = np.linspace(0.0, left[0].length, max(2, int(left[0].length / _SPACING)))
    poses = left[0].poses_at(s)
    away = np.hypot(poses[:, 0] - problem.start.x, poses[:, 1] - problem.start.y)
    nearest = int(np.argmin(away))
    if away[nearest] > _LOST:
        return None
    lengths = np.array([segment.length for segment in left])
    lengths[0] -= s[nearest]
    lengths[-1] -= problem.dock.final_straight
    if np.any(lengths < 0.02):
        return None
    return Remaining(earlier, first, float(s[nearest]), lengths)
