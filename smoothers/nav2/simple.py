"""Nav2's SimpleSmoother: every point is pulled towards its neighbours' middle and back to where it was.

It knows no curvature and no heading at the ends, and of obstacles only when it has hit one; it is here as a baseline
and for old parameter files.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field, model_validator

from optdock.deadline import Deadline
from optdock.errors import SmootherCancelled, SmootherTimedOut
from optdock.model.costs import MAX_NON_OBSTACLE, NO_INFORMATION
from optdock.plugins.interfaces import Smoother, SmoothingReport, SmoothingResult, never_cancelled
from optdock.plugins.parameters import PluginParameters, checked_seconds
from smoothers.nav2.pieces import directional_pieces, path_of, poses_of, task_of, with_travel_yaw

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.geometry.arrays import FloatArray
    from optdock.model.costmap import Costmap
    from optdock.model.path import Path
    from optdock.model.problem import DockingProblem

__all__ = ["SimpleParameters", "SimpleSmoother"]

logger = logging.getLogger(__name__)

_UNTOUCHED_POSES = 4  # pieces of so few poses are left alone


class SimpleParameters(PluginParameters):
    """Nav2's names and defaults."""

    tolerance: float = Field(1e-10, gt=0.0, description="summed |change| of a sweep that ends the sweeps [m]")
    max_its: int = Field(1000, ge=1, description="sweeps")
    w_data: float = Field(0.2, ge=0.0, description="pull towards the original point, per sweep")
    w_smooth: float = Field(0.3, ge=0.0, description="pull towards the neighbours, per sweep")
    do_refinement: bool = Field(default=True, description="smooth the smoothed path again")
    refinement_num: int = Field(2, ge=0, description="how often")
    enforce_path_inversion: bool = Field(default=True, description="keep cusps and turns in place where they are")
    check_for_collisions: bool = Field(default=True, description="leave a piece that would touch something as it was")

    @model_validator(mode="after")
    def _converges(self) -> SimpleParameters:
        # The sweeps are successive over-relaxation by this factor: by Ostrowski and Reich they converge below 2 only.
        relaxation = self.w_data + 2.0 * self.w_smooth
        if relaxation >= 2.0:
            raise ValueError(f"w_data + 2 w_smooth: must be < 2, or sweeps grow without end, got {relaxation:g}")
        return self


class _Sweep:
    """One Gauss-Seidel sweep over all points at once.

    The new point i obeys `new_i - w_smooth new_(i-1) = w_data original_i + (1 - w_data - 2 w_smooth) old_i +
    w_smooth old_(i+1)`: a bidiagonal system, solved by forward substitution, which visits the points in the same
    order as the loop and differs from it by rounding only.
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


class _End(str, Enum):
    """What ended the sweeps over a piece."""

    STILL = "tolerance"
    OBSTACLE = "obstacle"
    MAX_ITS = "max_its"
    TIME = "time"
    COLLISION = "collision"


@dataclass
class _Run:
    """One call of `smooth`: when it ends, what it must not enter, what may stop it, the sweeps and ends so far."""

    deadline: Deadline
    costmap: Costmap | None
    cancel_checker: Callable[[], bool]
    sweeps: int = 0
    ends: list[_End] = field(default_factory=list)

    def out_of_time(self) -> bool:
        """Whether the time is over, asked before every sweep.

        Raises:
            SmootherCancelled: The caller does not want it any more.
        """
        if self.cancel_checker():
            raise SmootherCancelled("smoothing was cancelled")
        return self.deadline.passed()


class SimpleSmoother(Smoother):
    """Gauss-Seidel sweeps over the points of a path, as `nav2_smoother::SimpleSmoother` does them.

    A sweep moves each inner point, in order, by `w_data (original - current) + w_smooth (next + previous - 2 current)`
    until a sweep changes less than `tolerance` in sum. A sweep that puts a point into an occupied cell is undone and
    ends the work. Each piece between cusps is smoothed by itself, its end points stay. Its yaws become the directions
    of travel; start and goal keep theirs (Nav2's turns the start), so that the path may begin and end in a kink.

    `completed` is False where the time limit stopped the sweeps; the last whole sweep is returned then, which entered
    nothing either. A piece whose poses would bring the footprint into something that they cleared before stays as it
    was, unless `check_for_collisions` is off; what happens between the poses is not looked at. `ended_by` in the
    report's `extra` says for every piece what ended it: `tolerance`, `obstacle`, `max_its`, `time`, `collision`.

    Args:
        **parameters: Fields of `SimpleParameters`.

    Raises:
        InvalidValue: A parameter is unknown, of the wrong type or out of range.
    """

    Parameters = SimpleParameters
    parameters: SimpleParameters

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
            max_time: Wall-clock seconds for the whole call, looked at before every sweep.
            problem: Where the costmap, the footprint and the obstacles come from; None: the context. Without a costmap
                nothing stops a point, without a footprint no piece is taken back.
            warm_start: Not used.
            cancel_checker: Polled before every sweep.

        Raises:
            InvalidValue: `max_time` is not finite, or negative; `problem` or `warm_start` is of another class.
            InvalidPath: Not a path, another frame than that of the problem, or too few distinct poses afterwards.
            SmootherTimedOut: The time was over before the first sweep. Nav2's raises after later ones as well.
            SmootherCancelled: `cancel_checker` returned True.
        """
        deadline = Deadline(checked_seconds(max_time, "max_time"), self.context.clock)
        self.check_task(path, problem, warm_start)
        path, surroundings = task_of(path, problem, self.context)
        run = _Run(deadline, surroundings.costmap, cancel_checker)
        poses = poses_of(path)
        whole = [(0, len(poses) - 1)]
        for first, last in directional_pieces(poses) if self.parameters.enforce_path_inversion else whole:
            if last - first + 1 > _UNTOUCHED_POSES:
                piece = poses[first : last + 1]
                smoothed, end = self._smooth_piece(piece, run)
                collides = self.parameters.check_for_collisions and surroundings.worsened(piece, smoothed)
                poses[first : last + 1] = piece if collides else smoothed
                run.ends.append(_End.COLLISION if collides and end is not _End.TIME else end)
        completed = _End.TIME not in run.ends
        if not completed and run.sweeps == 0:
            raise SmootherTimedOut(f"no sweep was finished within the allowed {max_time} s; allow more max_time")
        ended_by = tuple(end.value for end in run.ends)
        report = SmoothingReport(iterations=run.sweeps, total_s=deadline.elapsed, extra={"ended_by": ended_by})
        return SmoothingResult(path_of(poses, path), completed, report)

    def _smooth_piece(self, poses: FloatArray, run: _Run) -> tuple[FloatArray, _End]:
        """One piece, Shape (n, 3), with its refinements; each begins only where the pass before it got still."""
        points, end = self._sweep_until_still(poses[:, :2], run)
        for _ in range(self.parameters.refinement_num if self.parameters.do_refinement else 0):
            if end is not _End.STILL:
                break
            points, end = self._sweep_until_still(points, run)
        return with_travel_yaw(np.column_stack((points, poses[:, 2]))), end

    def _sweep_until_still(self, original: FloatArray, run: _Run) -> tuple[FloatArray, _End]:
        """Points after whole sweeps, Shape (n, 2) [m], and what ended these."""
        sweep = _Sweep(original, self.parameters.w_data, self.parameters.w_smooth)
        points = original
        for _ in range(1, self.parameters.max_its):
            if run.out_of_time():
                return points, _End.TIME
            moved = sweep(points)
            if _hits(moved[1:-1], run.costmap):
                logger.debug("%s: a sweep would enter an obstacle; keeping the one before", self.context.name)
                return points, _End.OBSTACLE
            change = float(np.abs(moved - points).sum())
            points = moved
            run.sweeps += 1
            if change < self.parameters.tolerance:
                return points, _End.STILL
        logger.warning("%s: still moving after %d sweeps", self.context.name, self.parameters.max_its)
        return points, _End.MAX_ITS


def _hits(points: FloatArray, costmap: Costmap | None) -> bool:
    """Whether a point lies in a cell with a cost above 252 that is known; off the map nothing is."""
    if costmap is None:
        return False
    costs = costmap.cost_at(points)
    return bool(np.any((costs > MAX_NON_OBSTACLE) & (costs != NO_INFORMATION)))
