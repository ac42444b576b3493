"""Nav2's SavitzkyGolaySmoother: every point is replaced by the value of a polynomial fitted to its neighbours.

It serves as a baseline and supports old parameter files. The curvature is not bounded, and a piece that would collide
is left unchanged.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field, model_validator

from optdock.plugins.interfaces import SmoothingReport
from smoothers.nav2.pieces import PieceEnd, PieceParameters, PieceRun, PieceSmoother, with_travel_yaw

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray

__all__ = ["SavitzkyGolayParameters", "SavitzkyGolaySmoother", "savitzky_golay_weights"]

_SPARE_POSES = 2  # pieces with at most the window and these poses are left unchanged


class SavitzkyGolayParameters(PieceParameters):
    """Parameters of `SavitzkyGolaySmoother`, with Nav2's names and defaults."""

    window_size: int = Field(7, ge=3, description="points of a fit, odd")
    poly_order: int = Field(3, ge=0, description="degree of the polynomial, less than the window size")

    @model_validator(mode="after")
    def _window_fits(self) -> SavitzkyGolayParameters:
        if self.window_size % 2 == 0:
            raise ValueError("window_size must be odd, so that a fit has a middle")
        if self.poly_order >= self.window_size:
            raise ValueError("poly_order must be less than window_size, or the fit is not unique")
        return self


def savitzky_golay_weights(window_size: int, degree: int) -> FloatArray:
    """Return the weights of the points whose sum is the value of the fitted polynomial at the middle point.

    With V_ij = i^j for i = -m..m, the weights are the first row of the pseudo-inverse of V ([Savitzky1964]).

    Args:
        window_size: Number of points, odd.
        degree: Degree of the polynomial.

    Returns:
        Shape (window_size,), sum 1.

    >>> (21 * savitzky_golay_weights(7, 3)).round(9).tolist()
    [-2.0, 3.0, 6.0, 7.0, 6.0, 3.0, -2.0]
    """
    half = window_size // 2
    powers = np.vander(np.arange(-half, half + 1) / half, degree + 1, increasing=True)
    weights: FloatArray = np.linalg.pinv(powers)[0]
    return weights


class SavitzkyGolaySmoother(PieceSmoother):
    """Smooth a path by polynomial fits in a moving window, as in `nav2_smoother::SavitzkyGolaySmoother`.

    Each piece between cusps is filtered separately, with its end poses repeated beyond the ends and its end points
    fixed. The time limit is checked before every piece; filtering a piece takes microseconds. See `PieceSmoother` for
    yaws and collisions.
    """

    Parameters = SavitzkyGolayParameters
    parameters: SavitzkyGolayParameters

    def smooth_piece(self, poses: FloatArray, run: PieceRun) -> tuple[FloatArray, PieceEnd] | None:
        """Return the smoothed piece after all passes of the filter, Shape (n, 3)."""
        p = self.parameters
        if len(poses) - 1 <= p.window_size + _SPARE_POSES:
            return None
        if run.out_of_time():
            return poses, PieceEnd.TIME
        weights, points = savitzky_golay_weights(p.window_size, p.poly_order), poses[:, :2]
        for _ in range(1 + (p.refinement_num if p.do_refinement else 0)):
            points = _filter_once(points, weights)
        run.steps += 1
        return with_travel_yaw(np.column_stack((points, poses[:, 2]))), PieceEnd.STILL

    def report(self, run: PieceRun) -> SmoothingReport:
        """Return the number of filtered pieces, and of pieces left unchanged to avoid a collision (`kept`)."""
        extra = {"pieces": run.steps, "kept": run.ends.count(PieceEnd.COLLISION)}
        return SmoothingReport(total_s=run.deadline.elapsed, extra=extra)


def _filter_once(points: FloatArray, weights: FloatArray) -> FloatArray:
    half = len(weights) // 2
    padded = np.pad(points, ((half, half), (0, 0)), mode="edge")
    filtered: FloatArray = points.copy()
    for axis in (0, 1):
        # The weights are symmetric, so that convolution is correlation.
        filtered[1:-1, axis] = np.convolve(padded[:, axis], weights, mode="valid")[1:-1]
    return filtered
