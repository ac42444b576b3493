"""The tracking tube: how far poses are off a certified path, and how far they may be.

A pose that is off by a distance e and turned by w moves no point of the footprint by more than e + 2 R sin(|w| / 2), R
the circumscribed radius: its displacement. The certificate proves clearance enough for displacements up to the width of
the tube, `DockingProblem.tube_widths`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.arrays import FloatArray, readonly
from optdock.geometry.pose import displacement, pose_errors
from optdock.verification import end_clearances

if TYPE_CHECKING:
    from optdock.model.path import Path
    from optdock.model.problem import DockingProblem

__all__ = ["Deviations", "Tube"]

_SPACING = 0.002  # [m] between the places looked at first: beside a cusp two legs are as near, so coarse ones mislead
_CLOSE = 2e-4  # [m]: where the search ends; a displacement is then too large by as much at most
_AROUND = readonly(np.linspace(-1.0, 1.0, 11))


class Deviations(NamedTuple):
    """How far poses are off a path; every column of Shape (n,).

    Attributes:
        s: The place on the path in whose tube each is deepest, or which it is nearest to [m].
        along: Seen from there, in its heading [m]: small but beyond an end or a cusp.
        cross: Likewise to the left [m].
        yaw: Heading error [rad].
        displacement: Largest way of a point of the footprint from where the path has it at `s` [m], or a bound of it.
        width: Of the tube at `s` [m].
    """

    s: FloatArray
    along: FloatArray
    cross: FloatArray
    yaw: FloatArray
    displacement: FloatArray
    width: FloatArray

    @property
    def excess(self) -> FloatArray:
        """By how much each pose is outside the tube, Shape (n,) [m]; not above 0 within."""
        return self.displacement - self.width


class Tube:
    """The tube around a path that was proven for a problem.

    Args:
        path: The path.
        problem: What it was proven for.
        start_relief: Of its certificate [m].
    """

    def __init__(self, path: Path, problem: DockingProblem, start_relief: float = 0.0) -> None:
        self.path, self.problem, self.start_relief = path, problem, start_relief
        self._radius = problem.robot.footprint.circumscribed_radius
        self._start_clearance = end_clearances(problem).start
        count = max(1, math.ceil(path.length / _SPACING))
        self._s = readonly(np.linspace(0.0, path.length, count + 1))
        self._poses = readonly(path.poses_at(self._s))
        self._known_widths = readonly(self._widths(self._poses))

    def width_at(self, s: FloatArray) -> FloatArray:
        """How far any point of the footprint may be off at places `s` [m] of the path. Shape (n,) [m]."""
        return self._widths(self.path.poses_at(s))

    def _widths(self, poses: FloatArray) -> FloatArray:
        return self.problem.tube_widths(poses, self.problem.start, self._start_clearance, self.start_relief)

    def deviations(self, poses: FloatArray, near: float | None = None, within: float = 0.5) -> Deviations:
        """How far poses are off the path.

        Args:
            poses: Shape (n, 3).
            near: Where on the path they are about [m]; None: anywhere.
            within: How far around `near` to look [m].
        """
        rows = slice(None)
        if near is not None:
            low, high = np.searchsorted(self._s, (near - within, near + within))
            rows = slice(max(0, int(low) - 1), int(high) + 1)
        places, known, widths = self._s[rows], self._poses[rows], self._known_widths[rows]
        first = [int(np.argmin(self._displacements(pose, known) - widths)) for pose in poses]
        s, step = places[first], self._s[1] - self._s[0]
        while step > _CLOSE:
            around = np.clip(s[:, None] + step * _AROUND, 0.0, self.path.length)
            candidates = self.path.poses_at(around.ravel()).reshape(*around.shape, 3)
            excess = self._displacements(poses[:, None], candidates)
            excess -= self._widths(candidates.reshape(-1, 3)).reshape(around.shape)
            s, step = around[np.arange(len(s)), np.argmin(excess, axis=1)], 0.2 * step
        at = self.path.poses_at(s)
        error = pose_errors(poses, at)
        return Deviations(s, error[:, 0], error[:, 1], error[:, 2], self._displacements(poses, at), self._widths(at))

    def _displacements(self, poses: FloatArray, references: FloatArray) -> FloatArray:
        off = np.hypot(references[..., 0] - poses[..., 0], references[..., 1] - poses[..., 1])
        return displacement(off, references[..., 2] - poses[..., 2], self._radius)
