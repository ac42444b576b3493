"""The tracking tube: deviations of poses from a certified path, and the largest allowed deviations.

A pose at a distance e and an angle w from the path displaces no point of the footprint by more than e + 2 R sin(|w| /
2), where R is the circumscribed radius. The certificate proves the clearance for displacements up to the width of the
tube, `DockingProblem.tube_widths`.
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

_SPACING = 0.002  # [m] between the first candidates; next to a cusp, coarser ones may select the wrong gear
# Candidates of two rounds, the second one fifth as wide, in units of the spacing. A single pose is compared with all of
# them at once, because a round of few candidates takes as long as one of many.
_AROUND = readonly(np.linspace(-1.0, 1.0, 11))
_ALL_AROUND = readonly(np.linspace(-1.2, 1.2, 61))


class Deviations(NamedTuple):
    """Deviations of poses from a path, Shape (n,) each.

    Attributes:
        s: Arc length at which the excess over the tube is smallest [m].
        along: Error along the heading of the path at `s` [m]; small except for poses beyond an end or a cusp.
        cross: Error to the left of the path at `s` [m].
        yaw: Heading error [rad].
        displacement: Bound of the displacement of the footprint from the path at `s` [m].
        width: Width of the tube at `s` [m].
    """

    s: FloatArray
    along: FloatArray
    cross: FloatArray
    yaw: FloatArray
    displacement: FloatArray
    width: FloatArray

    @property
    def excess(self) -> FloatArray:
        """Distance outside of the tube, Shape (n,) [m]; <= 0 inside."""
        return self.displacement - self.width


class Tube:
    """The tube around a certified path.

    Args:
        path: The path.
        problem: Problem of the certificate.
        start_relief: Start relief of the certificate [m].

    Attributes:
        places: Arc lengths of sampled poses of the path, in equal distances of at most 2 mm, Shape (n,) [m].
        poses: These poses, Shape (n, 3).
        widths: Widths of the tube there, Shape (n,) [m].
    """

    def __init__(self, path: Path, problem: DockingProblem, start_relief: float = 0.0) -> None:
        self.path, self.problem, self.start_relief = path, problem, start_relief
        self._radius = problem.robot.footprint.circumscribed_radius
        self._start_clearance = end_clearances(problem).start
        count = max(1, math.ceil(path.length / _SPACING))
        self.places = readonly(np.linspace(0.0, path.length, count + 1))
        self.poses = readonly(path.poses_at(self.places))
        self.widths = readonly(self._widths(self.poses))

    def width_at(self, s: FloatArray) -> FloatArray:
        """Return the largest displacement of the footprint at arc lengths `s` [m]. Shape (n,) [m]."""
        return self._widths(self.path.poses_at(s))

    def _widths(self, poses: FloatArray) -> FloatArray:
        return self.problem.tube_widths(poses, self.problem.start, self._start_clearance, self.start_relief)

    def deviations(self, poses: FloatArray, near: float | None = None, within: float = 0.5) -> Deviations:
        """Return the deviations of poses from the path.

        Args:
            poses: Poses, Shape (n, 3).
            near: Approximate arc length of the poses [m]; None if unknown.
            within: Search range around `near` [m].
        """
        rows = slice(None)
        if near is not None:
            low, high = np.searchsorted(self.places, (near - within, near + within))
            rows = slice(max(0, int(low) - 1), int(high) + 1)
        places, known, widths = self.places[rows], self.poses[rows], self.widths[rows]
        first = [int(np.argmin(self._displacements(pose, known) - widths)) for pose in poses]
        s, step, every = places[first], self.places[1] - self.places[0], np.arange(len(poses))
        at, moved, width = known[first], self._displacements(poses, known[first]), widths[first]
        for around in (_ALL_AROUND,) if len(poses) == 1 else (_AROUND, 0.2 * _AROUND):
            tried = np.minimum(np.maximum(s[:, None] + step * around, 0.0), self.path.length)
            candidates = self.path.poses_at(tried.ravel()).reshape(*tried.shape, 3)
            off = self._displacements(poses[:, None], candidates)
            wide = self._widths(candidates.reshape(-1, 3)).reshape(tried.shape)
            best = every, np.argmin(off - wide, axis=1)
            s, at, moved, width = tried[best], candidates[best], off[best], wide[best]
        error = pose_errors(poses, at)
        return Deviations(s, error[:, 0], error[:, 1], error[:, 2], moved, width)

    def _displacements(self, poses: FloatArray, references: FloatArray) -> FloatArray:
        off = np.hypot(references[..., 0] - poses[..., 0], references[..., 1] - poses[..., 1])
        return displacement(off, references[..., 2] - poses[..., 2], self._radius)
