"""Nav2's SimpleSmoother: every point is moved towards the middle of its neighbours and towards its original position.

It serves as a baseline and supports old parameter files. The curvature is not bounded. Obstacles do not deform the
path; they only end the sweeps.
"""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field, model_validator

from optdock.model.costs import MAX_NON_OBSTACLE, NO_INFORMATION
from optdock.plugins.interfaces import SmoothingReport
from smoothers.nav2.pieces import PieceEnd, PieceParameters, PieceRun, PieceSmoother, with_travel_yaw

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from optdock.model.costmap import Costmap

__all__ = ["SimpleParameters", "SimpleSmoother"]

logger = logging.getLogger(__name__)

_UNTOUCHED_POSES = 4  # pieces of at most so many poses are left unchanged


class SimpleParameters(PieceParameters):
    """Parameters of `SimpleSmoother`, with Nav2's names and defaults."""

    tolerance: float = Field(1e-10, gt=0.0, description="sum of |change| of a sweep below which the sweeps end [m]")
    max_its: int = Field(1000, ge=1, description="sweeps")
    w_data: float = Field(0.2, ge=0.0, description="weight of the original point, per sweep")
    w_smooth: float = Field(0.3, ge=0.0, description="weight of the neighbours, per sweep")

    @model_validator(mode="after")
    def _converges(self) -> SimpleParameters:
        # The sweeps are successive over-relaxation by this factor, which converges below 2 only (Ostrowski, Reich).
        relaxation = self.w_data + 2.0 * self.w_smooth
        if relaxation >= 2.0:
            raise ValueError(f"w_data + 2 w_smooth: must be < 2, or sweeps grow without end, got {relaxation:g}")
        return self


class _Sweep:
    """One Gauss-Seidel sweep over all points, computed as the solution of one linear system.

    The new point i satisfies `new_i - w_smooth new_(i-1) = w_data original_i + (1 - w_data - 2 w_smooth) old_i +
    w_smooth old_(i+1)`, which is a bidiagonal system. Its solution by forward substitution differs from a loop over the
    points only by rounding.
    """

    def __init__(self, original: FloatArray, w_data: float, w_smooth: float) -> None:
        self._pull = w_data * original[1:-1]
        self._keep, self._w_smooth = 1.0 - w_data - 2.0 * w_smooth, w_smooth
        self._band = np.vstack((np.ones(len(original) - 2), np.full(len(original) - 2, -w_smooth)))

    def __call__(self, points: FloatArray) -> FloatArray:
        from scipy.linalg.blas import dtbsv

        right = self._pull + self._keep * points[1:-1] + self._w_smooth * points[2:]
        right[0] += self._w_smooth * points[0]
        moved: FloatArray = points.copy()
        for axis in (0, 1):
            moved[1:-1, axis] = dtbsv(1, self._band, right[:, axis], lower=1, diag=1)
        return moved


class SimpleSmoother(PieceSmoother):
    """Smooth a path by Gauss-Seidel sweeps over its points, as in `nav2_smoother::SimpleSmoother`.

    Each sweep moves the inner points, in order, by `w_data (original - current) + w_smooth (next + previous - 2
    current)`. The sweeps end when the sum of the changes in one sweep is less than `tolerance`. A sweep that moves a
    point into an occupied cell is undone, and no further sweep follows; without a costmap, this is not checked. Each
    piece between cusps is smoothed separately, with fixed end points. The time limit is checked before every sweep. See
    `PieceSmoother` for yaws and collisions.
    """

    Parameters = SimpleParameters
    parameters: SimpleParameters

    def smooth_piece(self, poses: FloatArray, run: PieceRun) -> tuple[FloatArray, PieceEnd] | None:
        """Return the smoothed piece, Shape (n, 3); a refinement begins only if the pass before it converged."""
        if len(poses) <= _UNTOUCHED_POSES:
            return None
        points, end = self._sweep_until_still(poses[:, :2], run)
        for _ in range(self.parameters.refinement_num if self.parameters.do_refinement else 0):
            if end is not PieceEnd.STILL:
                break
            points, end = self._sweep_until_still(points, run)
        return with_travel_yaw(np.column_stack((points, poses[:, 2]))), end

    def report(self, run: PieceRun) -> SmoothingReport:
        """Return the number of sweeps, and in `extra` the reason why each piece ended (`ended_by`)."""
        extra = {"ended_by": tuple(end.value for end in run.ends)}
        return SmoothingReport(iterations=run.steps, total_s=run.deadline.elapsed, extra=extra)

    def _sweep_until_still(self, original: FloatArray, run: PieceRun) -> tuple[FloatArray, PieceEnd]:
        """Return the points after complete sweeps, Shape (n, 2) [m], and the reason why the sweeps ended."""
        sweep = _Sweep(original, self.parameters.w_data, self.parameters.w_smooth)
        points = original
        for _ in range(1, self.parameters.max_its):
            if run.out_of_time():
                return points, PieceEnd.TIME
            moved = sweep(points)
            if _hits(moved[1:-1], run.costmap):
                logger.debug("%s: a sweep would enter an obstacle; keeping the one before", self.context.name)
                return points, PieceEnd.OBSTACLE
            change = float(np.abs(moved - points).sum())
            points = moved
            run.steps += 1
            if change < self.parameters.tolerance:
                return points, PieceEnd.STILL
        logger.warning("%s: still moving after %d sweeps", self.context.name, self.parameters.max_its)
        return points, PieceEnd.MAX_ITS


def _hits(points: FloatArray, costmap: Costmap | None) -> bool:
    """Whether a point lies in a known cell with a cost above 252; cells outside the map are unknown."""
    if costmap is None:
        return False
    costs = costmap.cost_at(points)
    return bool(np.any((costs > MAX_NON_OBSTACLE) & (costs != NO_INFORMATION)))
