"""`CasadiSmoother`: a certified clothoid spline near the input path, or the bound that stands in its way."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
from pydantic import Field

from optdock.deadline import garbage_collection_paused
from optdock.dock import Dock
from optdock.errors import SmootherException, SmootherTimedOut
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.interfaces import Smoother, SmoothingReport, SmoothingResult, SmoothingStatus, never_cancelled
from optdock.limits import MotionLimits
from optdock.obstacles import ObstacleSet
from optdock.parameters import PluginParameters
from optdock.path import Path, may_be_one_frame
from optdock.problem import DockingProblem
from optdock.robot import Robot
from optdock.verification import certify_path, pose_clearance
from smoothers._ck.anytime import Incumbent, Outcome, Runner
from smoothers._ck.budget import Budget
from smoothers._ck.initial import Resolution, Tuning, make_task
from smoothers._ck.kept import direct_line, input_cost, may_be_kept
from smoothers._ck.qp import pool_of_this_thread
from smoothers._ck.refusals import refuse_approach, refuse_certificate, refuse_search, refuse_start
from smoothers._ck.spline import exact_path
from smoothers._ck.steps import prepare_programs
from smoothers._ck.surroundings import configured_problem, covers, problem_between_ends
from smoothers._ck.task import reference_scales
from smoothers._ck.terms import Weights
from smoothers._ck.warm import remaining
from smoothers._ck.world import world_around

if TYPE_CHECKING:
    from collections.abc import Callable

    from smoothers._ck.task import Task
    from smoothers._ck.world import World

__all__ = ["CasadiSmoother", "CasadiSmootherParameters"]

_LONGEST_SPAN = 1.2  # of the smallest turning radius
_MANY_OBSTACLES, _AMONG_MANY = 60, 1.3


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
    spans: int = Field(24, ge=8, le=80, description="least number of pieces of linear curvature over the whole path")
    interval: float = Field(0.0625, gt=0, description="distance of collision nodes for a robot of 1 m [m]")
    max_iterations: int = Field(60, ge=1, description="convex steps")
    backend: Literal["scp", "ipopt"] = Field("scp", description="ipopt: slow reference, not for production")
    stop_at_first: bool = Field(default=False, description="return the first certified path")


class CasadiSmoother(Smoother):
    """Minimizes length, curvature, curvature rate and distance to the input under the problem's hard bounds.

    The result is a clothoid spline per gear (curvature piecewise linear in arc length), certified by
    `optdock.verification` before it is returned. Gears keep their order; cusps may move. Every thread has solvers of
    its own.
    """

    Parameters: ClassVar[type[PluginParameters]] = CasadiSmootherParameters
    parameters: CasadiSmootherParameters

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
            problem: What must hold; the configured costmap counts as well where the problem has none. None: the
                configured problem, with the ends of `path` where they are others; where none is configured, from the
                first pose of `path` to its last, with the footprint and the costmap of the context and the limits of
                the parameters.
            warm_start: An earlier result with the same gears; returned where it is an answer still and none is found.
            cancel_checker: Polled every iteration.

        Raises:
            InvalidPath: The path names another frame than the problem.
            FailedToSmoothPath: `where["reason"]` names the bound in the way: `start_in_collision`, `start_curvature`,
                `direction`, `approach_blocked`, `goal_unreachable`, `clearance`; `s` [m], `amount` and `obstacle` say
                where and by how much.
            SmootherTimedOut: No certified path within `max_time`.
            SmootherCancelled: `cancel_checker` returned True.
        """
        with garbage_collection_paused():
            return self._smoothed(path, Budget(max_time, self.context.clock), problem, warm_start, cancel_checker)

    def _smoothed(
        self,
        path: Path,
        budget: Budget,
        problem: DockingProblem | None,
        warm_start: Path | None,
        cancel_checker: Callable[[], bool],
    ) -> SmoothingResult:
        pool = pool_of_this_thread()
        built = pool.build_time
        wanted = self._wanted(path, problem)
        path, warm_start = path.with_frame(wanted.frame), _in_frame(warm_start, wanted.frame)
        task = self._prepared(path, wanted, warm_start, budget)
        setup, chosen = budget.elapsed, self.parameters
        if chosen.backend == "ipopt":
            return self._reference(task, wanted, budget)
        runner = Runner(wanted, pool, budget, cancel_checker, chosen.max_iterations, chosen.stop_at_first)
        if may_be_kept(path, wanted):
            runner.offer(path, input_cost(path, task.cost, wanted.dock.final_straight), "input")
        line = direct_line(path, wanted)
        if line is not None:
            runner.offer(line, input_cost(line, task.cost, wanted.dock.final_straight), "line")
        outcome = runner.run(task) if line is None or runner.outcome.incumbent is None else runner.finished()
        if outcome.incumbent is None and outcome.converged and len(task.world.obstacles) > _MANY_OBSTACLES:
            task = self._prepared(path, wanted, warm_start, budget, thoroughly=True)
            outcome = runner.run(task)
        if outcome.incumbent is None and outcome.converged and warm_start and may_be_kept(warm_start, wanted):
            runner.offer(warm_start, input_cost(warm_start, task.cost, wanted.dock.final_straight), "warm_start")
        if outcome.incumbent is None:
            raise _failure(task, outcome, budget.seconds, wanted.dock.final_straight)
        if problem is None and self.context.problem is None and not covers(path, outcome.incumbent.path):
            self._confirm(outcome.incumbent.path)
        return _result(outcome, budget, setup, pool.build_time - built)

    def warm_up(self) -> None:
        """Build what the first call would build, and load the solvers."""
        start, goal = Pose2(0.0, 0.0, 0.0), Pose2(3.0, 0.3, 0.0)
        low, high = np.array([[0.0, 0.6], [1.4, -0.2]]), np.array([[4.0, 0.9], [1.6, -0.1]])
        limits = MotionLimits(max_curvature=1.5, max_curvature_rate=6.0)
        robot = Robot(Footprint.rectangle(0.4, 0.4, 0.5), limits)
        # A wall beside the input and a post on it: pushing out is warmed up too.
        obstacles = ObstacleSet.from_rectangles(low, high, "warm-up")
        problem = DockingProblem(start, Dock(goal, final_straight=0.2), robot, obstacles)
        with contextlib.suppress(SmootherException):  # unusual parameters may fail here, and build all the same
            self.smooth(Path.from_poses([start, Pose2(1.5, 0.0, 0.1), goal]), 10.0, problem=problem)
        prepare_programs(pool_of_this_thread())

    def _prepared(
        self,
        path: Path,
        problem: DockingProblem,
        earlier: Path | None,
        budget: Budget,
        *,
        thoroughly: bool = False,
    ) -> Task:
        budget.look()
        start_clearance, nearest = pose_clearance(problem.start, problem.robot.footprint, problem.all_obstacles)
        refusal = refuse_start(path, problem, start_clearance, nearest)
        if refusal is None:
            refusal = refuse_approach(path, problem, start_clearance)
        if refusal is not None:
            raise refusal.error()
        budget.look()
        shares = np.linspace(0.0, 1.0, 40)
        positions = np.concatenate([segment.poses_at(shares * segment.length)[:, :2] for segment in path.segments])
        world = world_around(problem, positions, start_clearance)
        tuning = self._tuning(world, problem.robot.limits, 1.0 if thoroughly else _AMONG_MANY)
        if thoroughly:
            world = replace(world, is_thinned=False)
        budget.look()
        return make_task(path, problem, world, tuning, remaining(earlier, path, problem))

    def _tuning(self, world: World, limits: MotionLimits, among_many: float) -> Tuning:
        chosen = self.parameters
        # Longer robots are larger in everything: their obstacles too can be watched at larger distances.
        interval = chosen.interval * max(1.0, world.body.radius / 0.55)
        # Every node meets every obstacle: among many, fewer nodes save a sixth of the time for 0.3 % of the cost.
        interval *= among_many if len(world.obstacles) > _MANY_OBSTACLES else 1.0
        weights = Weights(
            chosen.length_weight, chosen.curvature_weight, chosen.curvature_rate_weight, chosen.tracking_weight
        )
        return Tuning(Resolution(chosen.spans, _LONGEST_SPAN / reference_scales(limits)[0], interval), weights)

    def _wanted(self, path: Path, called_with: DockingProblem | None) -> DockingProblem:
        problem = self.context.problem_at_hand(called_with)
        if problem is None:
            return self._problem_of(path)
        return problem if called_with is not None else configured_problem(path, problem)

    def _problem_of(self, path: Path) -> DockingProblem:
        chosen = self.parameters
        limits = MotionLimits(max_curvature=chosen.max_curvature, max_curvature_rate=chosen.max_curvature_rate)
        return problem_between_ends(path, self.context, limits, chosen.clearance, chosen.final_straight)

    def _confirm(self, result: Path) -> None:
        """Certify a result that left the part of the costmap which was read around its input."""
        certificate = certify_path(result, self._problem_of(result))
        if not certificate.certified:
            raise refuse_certificate(certificate).error()

    def _reference(self, task: Task, problem: DockingProblem, budget: Budget) -> SmoothingResult:
        from smoothers._ck.ipopt_backend import solve_reference

        iterate, settled = solve_reference(task, budget)
        path = exact_path(task, iterate.variables, problem.dock.final_straight)[0].with_frame(problem.frame)
        certificate = certify_path(path, problem)
        if not certificate.certified:
            raise refuse_search(task, iterate, problem.dock.final_straight).error(certificate=certificate.reason)
        outcome = Outcome(Incumbent(path, certificate, iterate.cost), iterate, converged=settled)
        return _result(outcome, budget, 0.0, 0.0)


def _in_frame(earlier: Path | None, frame: str) -> Path | None:
    """An earlier result, where it can stand in this frame; one that cannot is none for this problem."""
    return earlier.with_frame(frame) if earlier is not None and may_be_one_frame(earlier.frame, frame) else None


def _failure(task: Task, outcome: Outcome, max_time: float, final_straight: float) -> SmootherException:
    if not outcome.converged or outcome.last is None:
        message = f"no certified path within {1e3 * max_time:.1f} ms"
        return SmootherTimedOut(message, where={"iterations": outcome.iterations})
    if outcome.refused is not None and outcome.last.feasible:
        return refuse_certificate(outcome.refused).error()
    return refuse_search(task, outcome.last, final_straight).error()


def _result(outcome: Outcome, budget: Budget, setup: float, build: float) -> SmoothingResult:
    best = outcome.incumbent
    assert best is not None  # the caller has raised otherwise
    kept = {
        "input": SmoothingStatus.INPUT_KEPT,
        "line": SmoothingStatus.STRAIGHT,
        "warm_start": SmoothingStatus.WARM_START_KEPT,
    }
    searched = SmoothingStatus.CONVERGED if outcome.converged else SmoothingStatus.STOPPED
    report = SmoothingReport(
        status=kept.get(best.origin, searched),
        cost=best.cost,
        iterations=outcome.iterations,
        setup_s=setup - build,
        build_s=build,
        certify_s=outcome.certify_time,
        first_certified_s=outcome.first_certified,
        total_s=budget.elapsed,
        certificate=best.certificate,
    )
    return SmoothingResult(best.path, outcome.converged, report)
