"""`CasadiSmoother`: a certified clothoid spline near the input path, or the bound that stands in its way."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from pydantic import Field

from optdock.errors import SmootherTimedOut
from optdock.interfaces import Smoother, SmoothingResult, never_cancelled
from optdock.limits import MotionLimits
from optdock.parameters import PluginParameters
from optdock.verification.clearance import pose_clearance
from smoothers._ck.anytime import Runner
from smoothers._ck.budget import Budget
from smoothers._ck.initial import Resolution, make_task
from smoothers._ck.qp import ProgramPool
from smoothers._ck.refusals import refuse_approach, refuse_search, refuse_start
from smoothers._ck.surroundings import problem_between_ends
from smoothers._ck.terms import Weights
from smoothers._ck.world import world_around

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.path import Path
    from optdock.problem import DockingProblem
    from smoothers._ck.anytime import Outcome
    from smoothers._ck.task import Task

__all__ = ["CasadiSmoother", "CasadiSmootherParameters"]


class CasadiSmootherParameters(PluginParameters):
    """Parameters of `CasadiSmoother`; the limits are used only where no problem is given."""

    max_curvature: float = Field(2.5, gt=0, description="1 / smallest turning radius [1/m]")
    max_curvature_rate: float = Field(10.0, gt=0, description="largest |d curvature / ds| [1/m^2]")
    clearance: float = Field(0.0, ge=0, description="required from obstacles where no problem says so [m]")
    final_straight: float = Field(0.0, ge=0, description="straight run at the end where no problem says so [m]")
    length_weight: float = Field(1.0, gt=0, description="cost per metre [1/m]")
    curvature_weight: float = Field(0.4, ge=0, description="cost of curvature, relative to its limit [1/m]")
    curvature_rate_weight: float = Field(0.15, gt=0, description="cost of curvature rate, relative to its limit [1/m]")
    tracking_weight: float = Field(0.3, ge=0, description="cost of squared distance to the input [1/m^3]")
    spans: int = Field(24, ge=8, le=80, description="pieces of linear curvature over the whole path")
    interval: float = Field(0.0625, gt=0, description="distance of collision nodes for a robot of 1 m [m]")
    max_iterations: int = Field(60, ge=1, description="convex steps")
    stop_at_first: bool = Field(default=False, description="return the first certified path")


class CasadiSmoother(Smoother):
    """Minimizes length, curvature, curvature rate and distance to the input under the problem's hard bounds.

    The result is a clothoid spline per gear (curvature piecewise linear in arc length), certified by
    `optdock.verification` before it is returned. Gears keep their order; cusps may move. Not for concurrent use.
    """

    Parameters: ClassVar[type[PluginParameters]] = CasadiSmootherParameters
    parameters: CasadiSmootherParameters

    def __init__(self, **parameters: object) -> None:
        super().__init__(**parameters)
        self._pool = ProgramPool()

    def smooth(
        self,
        path: Path,
        max_time: float,
        *,
        problem: DockingProblem | None = None,
        warm_start: Path | None = None,
        cancel_checker: Callable[[], bool] = never_cancelled,
    ) -> SmoothingResult:
        """A certified clothoid path between the start and the goal of `problem`, near `path`.

        Args:
            path: The input, from any source.
            max_time: Wall-clock seconds for the whole call.
            problem: What must hold. None: from the first pose of `path` to its last, with the footprint and the costmap
                of the context and the limits of the parameters.
            warm_start: An earlier result with the same gears.
            cancel_checker: Polled every iteration.

        Raises:
            FailedToSmoothPath: `where["reason"]` names the bound in the way: `start_in_collision`, `start_curvature`,
                `direction`, `approach_blocked`, `goal_unreachable`, `clearance`, `curvature_rate`; `s` [m], `amount` and
                `obstacle` say where and by how much.
            SmootherTimedOut: No certified path within `max_time`.
            SmootherCancelled: `cancel_checker` returned True.
        """
        budget = Budget(max_time, self.context.clock)
        wanted = problem if problem is not None else self._problem_of(path)
        task = self._prepared(path, wanted)
        setup = budget.elapsed
        runner = Runner(
            wanted, self._pool, budget, cancel_checker, self.parameters.max_iterations, self.parameters.stop_at_first
        )
        outcome = runner.run(task)
        if outcome.incumbent is None:
            _raise_failure(task, outcome, max_time)
        return _result(outcome, setup, budget)

    def _prepared(self, path: Path, problem: DockingProblem) -> Task:
        start_clearance, nearest = pose_clearance(problem.start, problem.robot.footprint, problem.all_obstacles)
        refusal = refuse_start(path, problem, start_clearance, nearest)
        if refusal is None:
            refusal = refuse_approach(path, problem, start_clearance)
        if refusal is not None:
            raise refusal.error()
        shares = np.linspace(0.0, 1.0, 40)
        positions = np.concatenate([segment.poses_at(shares * segment.length)[:, :2] for segment in path.segments])
        world = world_around(problem, positions, start_clearance)
        chosen = self.parameters
        # Longer robots are larger in everything: their obstacles too can be watched at larger distances.
        interval = chosen.interval * max(1.0, world.body.radius / 0.55)
        weights = Weights(
            chosen.length_weight, chosen.curvature_weight, chosen.curvature_rate_weight, chosen.tracking_weight
        )
        return make_task(path, problem, world, Resolution(chosen.spans, interval), weights)

    def _problem_of(self, path: Path) -> DockingProblem:
        chosen = self.parameters
        limits = MotionLimits(max_curvature=chosen.max_curvature, max_curvature_rate=chosen.max_curvature_rate)
        return problem_between_ends(path, self.context, limits, chosen.clearance, chosen.final_straight)


def _raise_failure(task: Task, outcome: Outcome, max_time: float) -> None:
    if not outcome.converged or outcome.last is None:
        raise SmootherTimedOut(
            f"no certified path within {1e3 * max_time:.1f} ms", where={"iterations": outcome.iterations}
        )
    raise refuse_search(task, outcome.last).error()


def _result(outcome: Outcome, setup: float, budget: Budget) -> SmoothingResult:
    assert outcome.incumbent is not None  # the caller has raised otherwise
    report = {
        "status": "converged" if outcome.converged else "budget",
        "cost": outcome.incumbent.cost,
        "iterations": outcome.iterations,
        "setup_s": setup,
        "certify_s": outcome.certify_time,
        "first_certified_s": outcome.first_certified if outcome.first_certified is not None else math.nan,
        "total_s": budget.elapsed,
        "certificate": outcome.incumbent.certificate,
    }
    return SmoothingResult(outcome.incumbent.path, outcome.converged, report)
