"""Sequences of circular arcs and straight lines: what every stage of the search builds its manoeuvres from.

An arc has a signed length, negative in reverse, and a curvature d yaw / d length of the same sign in either gear:
positive steers left. Sequences are padded with arcs of length zero to one number of columns.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.model.path import Path
from optdock.model.segments import Direction, PolylineSegment

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray, IntArray

__all__ = ["Arcs", "advance"]

_NOTHING = 1e-9  # [m]: shorter arcs lead nowhere


def advance(poses: FloatArray, length: FloatArray, curvature: FloatArray) -> FloatArray:
    """The poses at the ends of arcs that begin at `poses`, Shape (..., 3); the three are broadcast."""
    turn = length * curvature
    chord = length * np.sinc(turn / (2.0 * np.pi))
    middle = poses[..., 2] + 0.5 * turn
    x, y = poses[..., 0] + chord * np.cos(middle), poses[..., 1] + chord * np.sin(middle)
    return np.stack((x, y, poses[..., 2] + turn), axis=-1)


class Arcs(NamedTuple):
    """Sequences of arcs: `start` Shape (n, 3), `lengths` and `curvatures` Shape (n, k) [m, 1/m]."""

    start: FloatArray
    lengths: FloatArray
    curvatures: FloatArray

    @property
    def size(self) -> int:
        """How many there are."""
        return int(self.lengths.shape[0])

    def rows(self, keep: IntArray | slice) -> Arcs:
        """The sequences at `keep`."""
        return Arcs(self.start[keep], self.lengths[keep], self.curvatures[keep])

    def joints(self) -> FloatArray:
        """Poses at the beginning of every arc, and at the end of the last. Shape (n, k + 1, 3)."""
        poses = [self.start]
        for length, curvature in zip(self.lengths.T, self.curvatures.T, strict=True):
            poses.append(advance(poses[-1], length, curvature))
        return np.stack(poses, axis=1)

    def poses_at_shares(self, shares: FloatArray) -> FloatArray:
        """Poses at shares of each sequence's total length, Shape (q,) in [0, 1]. Shape (n, q, 3)."""
        ends = np.cumsum(np.abs(self.lengths), axis=1)
        s = ends[:, -1:] * shares
        owner = (s[:, :, None] > ends[:, None, :]).sum(axis=2).clip(max=self.lengths.shape[1] - 1)
        row = np.arange(self.size)[:, None]
        before = ends[row, owner] - np.abs(self.lengths[row, owner])
        driven = np.copysign(s - before, self.lengths[row, owner])
        return advance(self.joints()[row, owner], driven, self.curvatures[row, owner])

    def poses_every(self, spacing: float) -> FloatArray:
        """Poses at most `spacing` apart along one sequence alone, all joints included. Shape (q, 3)."""
        assert self.size == 1
        joints, lengths, curvatures = self.joints()[0], self.lengths[0], self.curvatures[0]
        counts = np.where(np.abs(lengths) > _NOTHING, np.ceil(np.abs(lengths) / spacing - 1e-9), 0).astype(np.int64)
        owner = np.repeat(np.arange(counts.size), counts)
        rank = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
        inner = advance(joints[owner], lengths[owner] * rank / counts[owner], curvatures[owner])
        return np.concatenate((inner, joints[-1:]))

    def path(self, spacing: float, end: FloatArray, frame: str) -> Path:
        """One sequence alone as a path of polylines, whose last pose is exactly `end`, Shape (3,).

        Args:
            spacing: Largest distance between its poses [m].
            end: Where the arcs lead, but for rounding.
            frame: Name of the coordinate frame.
        """
        assert self.size == 1
        lengths, curvatures, joints = self.lengths[0], self.curvatures[0], self.joints()[0]
        kept = np.flatnonzero(np.abs(lengths) > _NOTHING)
        gears = np.sign(lengths[kept])
        runs = np.split(kept, np.flatnonzero(np.diff(gears)) + 1)
        blocks = [
            Arcs(joints[None, run[0]], lengths[None, run], curvatures[None, run]).poses_every(spacing) for run in runs
        ]
        blocks[-1][-1, :2] = end[:2]
        blocks[-1][-1, 2] = end[2] + 2.0 * np.pi * np.round((blocks[-1][-1, 2] - end[2]) / (2.0 * np.pi))
        signs = [Direction(int(np.sign(lengths[run[0]]))) for run in runs]
        return Path(tuple(PolylineSegment(block, sign) for block, sign in zip(blocks, signs, strict=True)), frame)
