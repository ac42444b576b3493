"""`CasadiSmoother`: a certified clothoid spline near the input path, or an error that names the violated bound."""

from __future__ import annotations

import contextlib
import dataclasses
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
from pydantic import Field, field_validator

from optdock.deadline import Deadline, garbage_collection_paused
from optdock.errors import FailedToSmoothPath, InvalidPath, InvalidValue, SmootherException
from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2
from optdock.model.cell_obstacles import obstacles_from_costmap
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.dock import Dock, DockDirection
from optdock.model.limits import MotionLimits
from optdock.model.path import Path, may_be_one_frame
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.plugins.interfaces import (
    SampledBound,
    Smoother,
    SmoothingReport,
    SmoothingResult,
    SmoothingStatus,
    never_cancelled,
)
from optdock.plugins.parameters import PluginParameters, checked_seconds
from optdock.verification import certify_path, compiled_clearances
from smoothers.scp.cost import Weights
from smoothers.scp.nlp import Formulation
from smoothers.scp.pieces_between_turns import TurningSolver, with_turns
from smoothers.scp.qp_step import pool_of_this_thread, prepare_programs
from smoothers.scp.refusals import refuse_certificate, refuse_term
from smoothers.scp.search import Call, Solver
from smoothers.scp.settings import DEFAULT_SETTINGS, Settings
from smoothers.scp.term_functions import term_set
from smoothers.scp.term_samples import sampled_terms
from smoothers.terms import SYMBOLS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from smoothers.terms import PathTerm


__all__ = ["CasadiSmoother", "CasadiSmootherParameters"]

_SAME_POSE = 1e-6  # [m], [rad]: as the certificate's
_READ_AROUND = 1.5  # [m] beyond the footprint: region of the costmap around the path
_SPACING = 0.2  # [m] between the points that represent a path
_CLEARANCE_SPACING = 0.02  # [m] between the poses whose clearance is measured
_TAPER = 0.5  # [m] before the goal, over which the required clearance falls to that of the input
_NO_OBSTACLES = "no obstacle is known: configure a costmap, or pass a problem; no clearance is kept"
# Largest distance of an input from the start or the goal of the problem of the call: [m], or share of its length.
# Detected docks are within decimetres of their map positions; a path farther away belongs to another problem.
_ELSEWHERE, _ELSEWHERE_SHARE = 1.0, 0.2


class CasadiSmootherParameters(PluginParameters):
    """Parameters of `CasadiSmoother`; its limits apply only if no problem is given or configured."""

    max_curvature: float = Field(2.5, gt=0, description="1 / smallest turning radius [1/m]")
    max_curvature_rate: float = Field(10.0, gt=0, description="largest |d curvature / ds| [1/m^2]")
    clearance: float = Field(0.0, ge=0, description="required clearance without a problem [m]")
    kept_clearance: float = Field(
        0.3, ge=0, description="without a problem, the clearance of the input is required, up to this value [m]"
    )
    final_straight: float = Field(0.0, ge=0, description="length of the straight end without a problem [m]")
    length_weight: float = Field(1.0, gt=0, description="cost per metre [1/m]")
    curvature_weight: float = Field(0.4, ge=0, description="cost of curvature, relative to its limit [1/m]")
    curvature_rate_weight: float = Field(0.15, gt=0, description="cost of curvature rate, relative to its limit [1/m]")
    tracking_weight: float = Field(0.3, ge=0, description="cost of squared distance to the input [1/m^3]")
    spans: int = Field(24, ge=8, le=80, description="least number of pieces of linear curvature over the whole path")
    interval: float = Field(0.0625, gt=0, description="distance of collision nodes for a robot of 1 m [m]")
    max_iterations: int = Field(60, ge=1, description="largest number of convex steps")
    backend: Literal["scp"] = Field("scp", description="solver: sequential convex programming")
    stop_at_first: bool = Field(default=False, description="return the first certified path")

    @field_validator("backend", mode="before")
    @classmethod
    def _no_reference(cls, value: object) -> object:
        if value == "ipopt":
            message = "the ipopt reference is not part of the smoother any more; call"
            raise ValueError(f"{message} smooth_by_ipopt in experiments/benchmarks/ipopt_reference.py")
        return value


class CasadiSmoother(Smoother):
    """Minimize length, curvature, curvature rate and distance to the input under the problem's hard bounds.

    The result is a clothoid spline per gear (curvature piecewise linear in arc length), certified by
    `optdock.verification`. The order of the gears is kept. Cusps may move, but turns in place keep their positions.
    One instance can be used in several threads.

    Args:
        terms: Costs and constraints of the user, see `smoothers.terms`. Hard terms are rows of the same program. Every
            returned path satisfies them at samples, and the report states the smallest values: they are not proven.
        **parameters: Values of the fields of `Parameters`.

    Raises:
        InvalidValue: If a parameter or a term is wrong, or two terms have the same name.
    """

    Parameters: ClassVar[type[PluginParameters]] = CasadiSmootherParameters
    parameters: CasadiSmootherParameters
    settings: Settings = DEFAULT_SETTINGS

    def __init__(self, /, *, terms: Iterable[PathTerm] = (), **parameters: object) -> None:
        super().__init__(**parameters)
        self.terms = terms

    @property
    def terms(self) -> tuple[PathTerm, ...]:
        """Costs and constraints of the user; a new value is used from the next call on."""
        chosen = self._terms
        return () if chosen is None else (*chosen.hard, *chosen.soft)

    @terms.setter
    def terms(self, terms: Iterable[PathTerm]) -> None:
        self._terms = term_set(terms)

    def sampled_bounds(self, path: Path, *, before: float = 0.0) -> tuple[SampledBound, ...]:
        """Return the hard terms at samples of a path, see `Smoother.sampled_bounds`."""
        chosen = self._terms
        return () if chosen is None else sampled_terms(chosen, path, before)

    def smooth(
        self,
        path: Path,
        max_time: float,
        *,
        problem: DockingProblem | None = None,
        warm_start: Path | None = None,
        cancel_checker: Callable[[], bool] = never_cancelled,
    ) -> SmoothingResult:
        """Return a certified clothoid path between the start and the goal of `problem`, near `path`.

        If `problem` is given, the result leads from its start to its goal; `path` may begin behind the robot or end at
        an earlier estimate of the dock. A path is rejected if its distance from the start, or the distance of its end
        from the goal, exceeds both 1 m and a fifth of its length.

        Args:
            path: Input path, from any source.
            max_time: Wall-clock time for the whole call [s].
            problem: Constraints; the configured costmap is added if the problem has none. If None, the configured
                problem is used, with the ends of `path` if they differ. Without a configured problem, the result leads
                from the first to the last pose of `path` with the footprint and costmaps of the context and the limits
                of the parameters. The smallest clearance of the result is then at least the smallest clearance of
                `path`, within the limits of `kept_clearance`. Without a costmap no obstacle is known, and the report
                has a `warning`.
            warm_start: Earlier result with the same gears, which is returned if it is still certified and no other path
                is found.
            cancel_checker: Polled in every iteration.

        Raises:
            InvalidPath: If `path` is not a Path, is not in the frame of the problem, or is too far from the start or
                the goal.
            InvalidValue: If `max_time` is not finite or negative, there is neither a problem nor a footprint, or
                `problem` or `warm_start` has the wrong class.
            FailedToSmoothPath: If a bound cannot be satisfied. `where["reason"]` is `start_in_collision`,
                `start_curvature`, `direction`, `turn`, `approach_blocked`, `goal_unreachable`, `clearance` or `term`;
                `where` also has `s` [m], `pose`, `amount`, `obstacle`, for clearance the measured `clearance` and the
                clearance `required`, and for a hard term its name as `term`. The best path found is the `path` of
                `partial`.
            SmootherTimedOut: If no path is certified within `max_time`. The path of the last iterate is the `path` of
                `partial` and can be the `warm_start` of a later call.
            SmootherCancelled: If `cancel_checker` returned True.
        """
        deadline = Deadline(checked_seconds(max_time, "max_time"), self.context.clock)
        self.check_task(path, problem, warm_start)
        with garbage_collection_paused():
            wanted = self.context.problem_at_hand(problem)
            if wanted is None:
                return self._smooth_alone(path, warm_start, deadline, cancel_checker)
            if problem is None:
                wanted = configured_problem(path, wanted)
            else:
                _check_way(path, wanted)
            return self._solve(self.call_for(path, wanted, warm_start), deadline, cancel_checker)

    def _smooth_alone(
        self, path: Path, warm_start: Path | None, deadline: Deadline, cancel_checker: Callable[[], bool]
    ) -> SmoothingResult:
        """Smooth a path without a problem, with the cells of the costmap around it as obstacles."""
        chosen, context = self.parameters, self.context
        free = self._between_ends(path, ClearanceRule(0.0), max(chosen.clearance, chosen.kept_clearance))
        is_known = context.costmap is not None or context.local_costmap is not None
        rule = kept_clearance(path, free, chosen.clearance, chosen.kept_clearance if is_known else 0.0)
        call = self.call_for(path, dataclasses.replace(free, clearance=rule), warm_start)
        try:
            result = self._solve(call, deadline, cancel_checker)
        except FailedToSmoothPath as error:
            if rule.required > chosen.clearance:
                kept = f"as much as the input keeps, up to kept_clearance = {chosen.kept_clearance:g} m"
                error.args = (f"{error}; {rule.required:.4f} m are required, {kept}",)
            raise
        if not covers(path, result.path):
            certificate = certify_path(result.path, self._between_ends(result.path, rule, rule.required))
            if not certificate.certified:
                raise refuse_certificate(certificate, result.path).error()
        if is_known:
            return result
        context.logger.warning("%s: %s", context.name, _NO_OBSTACLES)
        return dataclasses.replace(result, report=dataclasses.replace(result.report, warning=_NO_OBSTACLES))

    def _solve(self, call: Call, deadline: Deadline, cancel_checker: Callable[[], bool]) -> SmoothingResult:
        """Run the strategy for each piece between turns in place."""
        pool, robot = pool_of_this_thread(), call.problem.robot
        built = pool.build_time
        if robot.turns_in_place and call.problem.start_speed == 0.0:
            call = call._replace(path=with_turns(call.path))
        chosen = TurningSolver if call.path.turns else Solver
        solver = chosen(pool, deadline, cancel_checker, self.settings)
        best, outcome = solver.follow_strategy(call), solver.outcome
        sampled = () if call.terms is None else sampled_terms(call.terms, best.path)
        broken = next((bound for bound in sampled if not bound.holds), None)
        if broken is not None:  # also of results that were not searched
            raise refuse_term(broken, best.path).error()
        report = SmoothingReport(
            status=best.given or (SmoothingStatus.CONVERGED if outcome.converged else SmoothingStatus.STOPPED),
            cost=best.cost,
            iterations=outcome.iterations,
            setup_s=outcome.setup_time - (pool.build_time - built),
            build_s=pool.build_time - built,
            certify_s=outcome.certify_time,
            first_certified_s=outcome.first_certified,
            total_s=deadline.elapsed,
            certificate=best.certificate,
            sampled=sampled,
        )
        return SmoothingResult(best.path, outcome.converged, report)

    def call_for(self, path: Path, problem: DockingProblem, earlier: Path | None = None) -> Call:
        """Return the smoothing task, with weights and resolution from the parameters."""
        chosen = self.parameters
        weights = Weights(
            chosen.length_weight, chosen.curvature_weight, chosen.curvature_rate_weight, chosen.tracking_weight
        )
        # An earlier result in another frame is left out.
        usable = earlier is not None and may_be_one_frame(earlier.frame, problem.frame)
        earlier = earlier.with_frame(problem.frame) if earlier is not None and usable else None
        formulation = Formulation(weights, chosen.spans, chosen.interval)
        path = path.with_frame(problem.frame)
        most, first_only = chosen.max_iterations, chosen.stop_at_first
        return Call(path, problem, earlier, formulation, most, first_only, terms=self._terms)

    def warm_up(self) -> None:
        """Build the programs that a first call needs, load the solvers, and measure the speed of this machine."""
        start, goal = Pose2(0.0, 0.0, 0.0), Pose2(3.0, 0.3, 0.0)
        low, high = np.array([[0.0, 0.6], [1.4, -0.2]]), np.array([[4.0, 0.9], [1.6, -0.1]])
        limits = MotionLimits(max_curvature=1.5, max_curvature_rate=6.0)
        robot = Robot(Footprint.rectangle(0.4, 0.4, 0.5), limits)
        # A wall next to the input and a post on it, so that the code of the push-out is also loaded.
        obstacles = ObstacleSet.from_rectangles(low, high, "warm-up")
        problem = DockingProblem(start, Dock(goal, final_straight=0.2), robot, obstacles)
        path = Path.from_poses([start, Pose2(1.5, 0.0, 0.1), goal])
        pool, chosen, paces = pool_of_this_thread(), self.settings.anytime, []
        for _ in range(3):  # the first call builds, the others are measured
            deadline = Deadline(10.0, self.context.clock)
            solver = Solver(pool, deadline, never_cancelled, self.settings)
            with contextlib.suppress(SmootherException):  # with unusual parameters the call may fail, after building
                solver.follow_strategy(self.call_for(path, problem)._replace(terms=None))
            paces.append(solver.times.pace)
        prepare_programs(pool, self.settings.step)
        if self._terms is not None:
            self._terms.values(np.zeros((1, len(SYMBOLS))))
            self._terms.with_slopes(np.zeros((1, len(SYMBOLS))))
            sampled_terms(self._terms, path)
        pool.pace = float(np.clip(min(paces[1:]) / chosen.pace_at_warm_up, *chosen.pace_range))

    def _between_ends(self, path: Path, rule: ClearanceRule, reach: float) -> DockingProblem:
        """Return the problem from the start to the end of `path`, with the occupied cells within `reach` [m].

        See `covers`.
        """
        chosen, context = self.parameters, self.context
        if context.footprint is None:
            raise InvalidValue(f"{context.name}: configure it with a footprint, or pass a problem to smooth()")
        points = path.sample(_SPACING).poses[:, :2]
        around = context.footprint.circumscribed_radius + reach + _READ_AROUND
        region = points.min(axis=0) - around, points.max(axis=0) + around
        obstacles = ObstacleSet.empty()
        if context.costmap is not None:
            obstacles = obstacles_from_costmap(context.costmap, region=region)
        if context.local_costmap is not None and context.local_costmap is not context.costmap:
            obstacles = obstacles + obstacles_from_costmap(context.local_costmap, region=region, border=False)
        limits = MotionLimits(max_curvature=chosen.max_curvature, max_curvature_rate=chosen.max_curvature_rate)
        dock, robot = Dock(path.end, final_straight=chosen.final_straight), Robot(context.footprint, limits)
        return DockingProblem(path.start, dock, robot, obstacles, rule, frame=path.frame)


def _check_way(path: Path, problem: DockingProblem) -> None:
    """Raise InvalidPath if a path is too far from the start or the goal of the problem."""
    off, off_start = path.end.distance_to(problem.goal), path.start.distance_to(problem.start)
    if off <= _ELSEWHERE and off_start <= _ELSEWHERE:
        return
    allowed = max(_ELSEWHERE, _ELSEWHERE_SHARE * path.driven)
    what = f"ends {off:.2f} m from the goal"
    if off <= allowed < off_start:
        points = path.sample(_SPACING).poses[:, :2]
        off = float(np.hypot(*(points - problem.start.as_array()[:2]).T).min())
        what = f"stays at least {off:.2f} m from the start"
    if off > allowed:
        message = f"path: {what} of the problem, allowed are {allowed:.2f} m"
        raise InvalidPath(f"{message}; without `problem` the path keeps its own ends")


def configured_problem(path: Path, problem: DockingProblem) -> DockingProblem:
    """Return the configured problem, with the ends of `path` if they differ.

    If the start differs, the robot is at rest there and its steering is free. If the end differs, it is not a dock: the
    station is then only an obstacle, and no gear, final straight or slow approach is required.
    """
    if path.start.gap_to(problem.start) > _SAME_POSE:
        problem = problem.starting_at(path.start)
    if path.end.gap_to(problem.goal) > _SAME_POSE:
        elsewhere = Dock(path.end, direction=DockDirection.AUTO)
        problem = dataclasses.replace(problem, obstacles=problem.all_obstacles, dock=elsewhere)
    return problem


def kept_clearance(path: Path, problem: DockingProblem, least: float, most: float) -> ClearanceRule:
    """Return a clearance rule that requires the smallest clearance along `path` and accepts the clearance at its ends.

    Args:
        path: Path.
        problem: Robot and obstacles.
        least: Lower bound of the required clearance [m].
        most: Upper bound of the required clearance [m].
    """
    poses = path.sample(_CLEARANCE_SPACING).poses
    kept, _ = compiled_clearances(poses, problem.robot.footprint, problem.all_obstacles, within=most)
    from_goal, from_start = (
        np.hypot(poses[:, 0] - end.x, poses[:, 1] - end.y) for end in (problem.goal, problem.start)
    )
    # The rule may fall to the clearance near the goal; near the start it requires little anyway.
    at_goal = max(0.0, float(kept[from_goal < _TAPER].min()))
    counts = (kept < ClearanceRule.leaving(from_start, float(kept[0]))) & (from_goal > _SAME_POSE)
    share = np.minimum(1.0, from_goal[counts] / _TAPER)
    required = max(least, float(np.min(at_goal + (kept[counts] - at_goal) / share, initial=most)))
    return ClearanceRule(required, min(at_goal, required), _TAPER)


def covers(path: Path, result: Path) -> bool:
    """Whether the map region that was read around `path` contains every cell that the footprint reaches on `result`."""
    points, reached = path.sample(_SPACING).poses[:, :2], result.sample(_SPACING).poses[:, :2]
    slack = _READ_AROUND - _SPACING
    inside = (reached >= points.min(axis=0) - slack) & (reached <= points.max(axis=0) + slack)
    return bool(inside.all())
