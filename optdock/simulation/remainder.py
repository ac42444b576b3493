"""The path that is still ahead, as a goal checker wants it every cycle."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from optdock.geometry.pose import Pose2

if TYPE_CHECKING:
    from collections.abc import Sequence

    from optdock.path import Path

__all__ = ["RemainingPath"]

_LOOK_AHEAD = 20  # samples


class RemainingPath:
    """A sampled path that is consumed from its start, monotonically, and never beyond its last two poses.

    The robot's place is the nearest sample among the next few of the present gear segment; the next segment opens
    once the cusp's sample is reached. So the overlapping legs of a cusp are not mistaken for each other, and the
    path-length rule of the checkers holds them off until the last leg.

    Args:
        path: The whole path.
        spacing: Distance of the samples [m].
    """

    def __init__(self, path: Path, spacing: float = 0.05) -> None:
        samples = path.sample(spacing)
        self._poses = [Pose2.from_sequence(row) for row in samples.poses]
        gears = samples.direction
        self._segment_ends = [i for i in range(len(gears) - 1) if gears[i] != gears[i + 1]] + [len(gears) - 1]
        self._at = 0

    def from_pose(self, pose: Pose2) -> Sequence[Pose2]:
        """The poses from the robot's place to the end; at least two."""
        if self._at in self._segment_ends[:-1]:
            self._at += 1  # the cusp's second sample, of the next gear
        end = next(i for i in self._segment_ends if i >= self._at)
        window = range(self._at, min(end, self._at + _LOOK_AHEAD) + 1)
        self._at = min(window, key=lambda i: math.hypot(self._poses[i].x - pose.x, self._poses[i].y - pose.y))
        return self._poses[min(self._at, len(self._poses) - 2) :]
