"""Nav2's SavitzkyGolaySmoother: every point becomes the value of a polynomial fitted to the points around it.

It knows no curvature and no heading at the ends, and of obstacles only when it has hit one; it is here as a baseline
and for old parameter files.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field, model_validator

from optdock.deadline import Deadline
from optdock.errors import SmootherCancelled, SmootherTimedOut
from optdock.plugins.interfaces import Smoother, SmoothingReport, SmoothingResult, never_cancelled
from optdock.plugins.parameters import PluginParameters, checked_seconds
from smoothers.nav2.pieces import directional_pieces, path_of, poses_of, task_of, with_travel_yaw

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.geometry.arrays import FloatArray
    from optdock.model.path import Path
    from optdock.model.problem import DockingProblem

__all__ = ["SavitzkyGolayParameters", "SavitzkyGolaySmoother", "savitzky_golay_weights"]

_SPARE_POSES = 2  # pieces that span no more than the window and these are left alone


class SavitzkyGolayParameters(PluginParameters):
    """Nav2's names and defaults."""

    window_size: int = Field(7, ge=3, description="points of a fit, odd")
    poly_order: int = Field(3, ge=0, description="degree of the polynomial, less than the window size")
    do_refinement: bool = Field(default=True, description="filter the filtered path again")
    refinement_num: int = Field(2, ge=0, description="how often")
    enforce_path_inversion: bool = Field(default=True, description="keep cusps and turns in place where they are")
    check_for_collisions: bool = Field(default=True, description="leave a piece that would touch something as it was")

    @model_validator(mode="after")
    def _window_fits(self) -> SavitzkyGolayParameters:
        if self.window_size % 2 == 0:
            raise ValueError("window_size must be odd, so that a fit has a middle")
        if self.poly_order >= self.window_size:
            raise ValueError("poly_order must be less than window_size, or the fit is not unique")
        return self


def savitzky_golay_weights(window_size: int, degree: int) -> FloatArray:
    """Weights of the points whose sum is the value, at the middle point, of the polynomial fitted to all of them.

    With V_ij = i^j for i = -m..m, they are the first row of the pseudo-inverse of V ([Savitzky1964]).

    Args:
        window_size: Number of points, odd.
        degree: Of the polynomial.

    Returns:
        Shape (window_size,), sum 1.

    >>> (21 * savitzky_golay_weights(7, 3)).round(9).tolist()
    [-2.0, 3.0, 6.0, 7.0, 6.0, 3.0, -2.0]
    """
    half = window_size // 2
    powers = np.vander(np.arange(-half, half + 1) / half, degree + 1, increasing=True)
    weights: FloatArray = np.linalg.pinv(powers)[0]
    return weights


class SavitzkyGolaySmoother(Smoother):
    """Polynomial fits in a moving window, as `nav2_smoother::SavitzkyGolaySmoother` does them.

    Each piece between cusps is filtered by itself: beyond its ends the end pose is repeated, its end points stay. Its
    yaws become the directions of travel; start and goal keep theirs (Nav2's turns the start). `completed` is False
    where the time limit came before the last piece, which then stays as it was. So does a piece whose poses would bring
    the footprint into something that they cleared before, unless `check_for_collisions` is off; what happens between
    the poses is not looked at.

    Args:
        **parameters: Fields of `SavitzkyGolayParameters`.

    Raises:
        InvalidValue: A parameter is unknown, of the wrong type or out of range; the window is even.
    """

    Parameters = SavitzkyGolayParameters
    parameters: SavitzkyGolayParameters

    def smooth(
        self,
        path: Path,
        max_time: float,
        *,
        problem: DockingProblem | None = None,
        warm_start: Path | None = None,
        cancel_checker: Callable[[], bool] = never_cancelled,
    ) -> SmoothingResult:
        """A smoother polyline between the same two poses.

        Args:
            path: The raw path, from any source.
            max_time: Wall-clock seconds for the whole call, looked at before every piece; one takes microseconds.
            problem: Where the footprint and the obstacles come from; None: the context.
            warm_start: Not used.
            cancel_checker: Polled before every piece.

        Raises:
            InvalidValue: `max_time` is not finite, or negative; `problem` or `warm_start` is of another class.
            InvalidPath: Not a path, another frame than that of the problem, or too few distinct poses afterwards.
            SmootherTimedOut: The time was over before the first piece. Nav2's raises after later ones as well.
            SmootherCancelled: `cancel_checker` returned True.
        """
        deadline = Deadline(checked_seconds(max_time, "max_time"), self.context.clock)
        self.check_task(path, problem, warm_start)
        path, surroundings = task_of(path, problem, self.context)
        poses, filtered, kept, completed = poses_of(path), 0, 0, True
        whole = [(0, len(poses) - 1)]
        for first, last in directional_pieces(poses) if self.parameters.enforce_path_inversion else whole:
            if last - first <= self.parameters.window_size + _SPARE_POSES:
                continue
            if cancel_checker():
                raise SmootherCancelled("smoothing was cancelled")
            if deadline.passed():
                completed = False
                break
            piece = poses[first : last + 1]
            smoothed = self._filtered(piece)
            collides = self.parameters.check_for_collisions and surroundings.worsened(piece, smoothed)
            poses[first : last + 1] = piece if collides else smoothed
            filtered, kept = filtered + 1, kept + collides
        if not completed and filtered == 0:
            raise SmootherTimedOut(f"no piece was filtered within the allowed {max_time} s; allow more max_time")
        report = SmoothingReport(total_s=deadline.elapsed, extra={"pieces": filtered, "kept": kept})
        return SmoothingResult(path_of(poses, path), completed, report)

    def _filtered(self, poses: FloatArray) -> FloatArray:
        """One piece, Shape (n, 3), after all passes."""
        weights = savitzky_golay_weights(self.parameters.window_size, self.parameters.poly_order)
        points = poses[:, :2]
        for _ in range(1 + (self.parameters.refinement_num if self.parameters.do_refinement else 0)):
            points = _filter_once(points, weights)
        return with_travel_yaw(np.column_stack((points, poses[:, 2])))


def _filter_once(points: FloatArray, weights: FloatArray) -> FloatArray:
    half = len(weights) // 2
    padded = np.pad(points, ((half, half), (0, 0)), mode="edge")
    filtered: FloatArray = points.copy()
    for axis in (0, 1):
        # The weights are symmetric, so that convolution is correlation.
        filtered[1:-1, axis] = np.convolve(padded[:, axis], weights, mode="valid")[1:-1]
    return filtered
