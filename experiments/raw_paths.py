"""Raw paths from sources that do not smooth: OMPL, hybrid A*, a recorded drive, and waypoints set by hand.

Every source returns a polyline from the start to the dock, as planners publish it, or None if it finds none.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from experiments.study_cases import EXAMPLES
from optdock.errors import MissingExtra, OptdockError
from optdock.geometry.pose import Pose2
from optdock.model.dock import DockDirection
from optdock.model.path import Path
from optdock.model.problem import DockingProblem
from optdock.planners.manoeuvres.manoeuvre_planner import ManoeuvrePlanner
from optdock.planning.pipeline import plan_dock
from optdock.plugins.interfaces import Controller, GoalChecker, PluginContext
from optdock.plugins.registry import create_plugin
from optdock.simulation import Actuation, SimulationSettings, run_closed_loop
from optdock.verification import end_clearances, pose_clearances

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray

__all__ = ["NEEDS_OMPL", "SOURCES", "has_ompl", "hybrid_a_star_path", "ompl_path", "recorded_path", "waypoint_path"]

SPACING, FINE = 0.05, 0.002  # [m] between poses: one cell of a usual costmap; of OMPL's curves, to find their cusps
RECORDED_SPACING = 0.1  # [m]
STAGING = 0.7  # [m] from the staging pose to the dock, as in Nav2's docking server
CHECKS = 20_000  # validity checks of OMPL, after which it has found no path
AROUND = 3.0  # [m]: OMPL samples in a box around start and dock, with this margin
BUDGET = 5.0  # [s] of the drives that are recorded
NEEDS_OMPL = "OMPL is not installed, so its paths are missing; pip install 'optdock[ompl]' (Python < 3.14)"
# The operator of a recorded drive: lag and latency of the drive, and a localization with 5 mm and 0.3 degrees of noise.
RECORDING = SimulationSettings(
    actuation=Actuation(linear_lag=0.1, angular_lag=0.1, latency=0.05), position_noise=0.005, yaw_noise=0.005
)


def has_ompl() -> bool:
    """Whether OMPL can be imported."""
    try:
        _ompl()
    except MissingExtra:
        return False
    return True


def _ompl() -> tuple[Any, Any, Any]:
    try:
        from ompl import base, geometric, util
    except ImportError as error:
        raise MissingExtra(NEEDS_OMPL) from error
    return base, geometric, util


def before_dock(problem: DockingProblem, distance: float) -> Pose2:
    """Return the pose `distance` [m] before the dock on its axis, on the side from which the robot arrives."""
    sign = -1.0 if problem.dock.direction is DockDirection.BACKWARD else 1.0
    return problem.goal @ Pose2(-sign * distance, 0.0, 0.0)


def straight(begin: Pose2, end: Pose2, spacing: float = SPACING) -> FloatArray:
    """Return poses on a line, with the headings of `end`, without the first pose. Shape (n, 3)."""
    count = max(1, math.ceil(begin.distance_to(end) / spacing))
    share = np.linspace(0.0, 1.0, count + 1)[1:, None]
    return np.column_stack(
        (
            (1.0 - share) * (begin.x, begin.y) + share * (end.x, end.y),
            np.full(count, end.yaw),
        )
    )


def ompl_path(problem: DockingProblem, seed: int) -> Path | None:
    """Return a path by OMPL's RRT-Connect on Reeds-Shepp curves, shortened by OMPL's path simplifier.

    The curves have the smallest turning radius of the robot, and every state satisfies the clearance rule.

    Raises:
        MissingExtra: If OMPL is not installed.
    """
    base, geometric, util = _ompl()
    util.noOutputHandler()
    util.RNG.setSeed(seed + 1)
    space = base.ReedsSheppStateSpace(1.0 / problem.robot.limits.max_curvature)
    goal = before_dock(problem, problem.dock.final_straight)
    ends = np.array([[end.x, end.y] for end in (problem.start, goal)])
    bounds = base.RealVectorBounds(2)
    for axis in range(2):
        bounds.setLow(axis, float(ends[:, axis].min() - AROUND))
        bounds.setHigh(axis, float(ends[:, axis].max() + AROUND))
    space.setBounds(bounds)
    setup, is_valid = geometric.SimpleSetup(space), _Validity(problem)
    setup.setStateValidityChecker(is_valid)
    setup.setStartAndGoalStates(_state(space, problem.start), _state(space, goal))
    information = setup.getSpaceInformation()
    information.setStateValidityCheckingResolution(SPACING / space.getMaximumExtent())
    setup.setPlanner(geometric.RRTConnect(information))
    setup.solve(base.PlannerTerminationCondition(is_valid.has_done_enough))
    if not setup.haveExactSolutionPath():
        return None
    is_valid.checked = 0
    setup.simplifySolution(base.PlannerTerminationCondition(is_valid.has_done_enough))
    found = setup.getSolutionPath()
    found.interpolate(max(3, math.ceil(found.length() / FINE)))
    poses = np.array([[state.getX(), state.getY(), state.getYaw()] for state in found.getStates()])
    thinned = Path.from_poses(poses).sample(SPACING).poses  # every gear from end to end
    return _as_path(np.concatenate((thinned, straight(goal, problem.goal))), problem)


class _Validity:
    """Predicate of OMPL states, and the end of OMPL's work after a number of checks, independent of the clock."""

    def __init__(self, problem: DockingProblem) -> None:
        self.checked = 0
        self._problem, self._start = problem, end_clearances(problem).start
        self._ends = np.array([[problem.goal.x, problem.goal.y], [problem.start.x, problem.start.y]])

    def has_done_enough(self) -> bool:
        """Whether OMPL has used up its checks."""
        self.checked += 1  # OMPL may wait for an end without checking states
        return self.checked > CHECKS

    def __call__(self, state: Any) -> bool:  # noqa: ANN401 - OMPL has no types
        self.checked += 1
        pose, problem = np.array([[state.getX(), state.getY(), state.getYaw()]]), self._problem
        from_goal, from_start = np.hypot(*(self._ends - pose[:, :2]).T)
        required = problem.clearance.required_at(np.array([from_goal]), np.array([from_start]), self._start)
        clearance, _ = pose_clearances(pose, problem.robot.footprint, problem.all_obstacles, within=1.0)
        return bool(clearance[0] >= required[0] - 1e-6)


def _state(space: Any, pose: Pose2) -> Any:  # noqa: ANN401 - OMPL has no types
    state = space.allocState()
    state.setXY(pose.x, pose.y)
    state.setYaw((pose.yaw + math.pi) % (2.0 * math.pi) - math.pi)  # in [-pi, pi)
    return state


def hybrid_a_star_path(problem: DockingProblem, seed: int) -> Path | None:  # noqa: ARG001 - common signature
    """Return the first path of `ManoeuvrePlanner`, a hybrid A* with Reeds-Shepp shots, as poses every 5 cm."""
    planner = ManoeuvrePlanner()
    planner.configure(PluginContext("hybrid A*", problem=problem))
    try:
        return _as_path(planner.create_plan(problem.start, problem.goal).sample(SPACING).poses, problem)
    except OptdockError:
        return None


def recorded_path(problem: DockingProblem, seed: int) -> Path | None:
    """Return the measured poses of a drive in simulation, every 10 cm.

    `TrackingController` drives along a certified plan with lag, latency and a noisy localization.
    """
    try:
        plan = plan_dock(problem, time_budget=BUDGET)
    except OptdockError:
        return None
    world = dataclasses.replace(RECORDING, seed=seed)
    controller = create_plugin(Controller, "TrackingController")
    checker = create_plugin(GoalChecker, "DockGoalChecker", {"along_tolerance": 0.02})
    run = run_closed_loop(plan.trajectory, problem.robot, problem.goal, controller, checker, world)
    kept, last = [problem.start.as_array()], problem.start.as_array()
    for pose in run.measured:
        away = [np.hypot(*(pose[:2] - end[:2])) for end in (last, problem.goal.as_array())]
        if min(away) >= RECORDED_SPACING:
            kept.append(pose)
            last = pose
    return _as_path(np.array([*kept, problem.goal.as_array()]), problem)


def waypoint_path(problem: DockingProblem, seed: int) -> Path | None:  # noqa: ARG001 - common signature
    """Return lines from the start to the staging pose and on to the dock, as waypoints are set by hand.

    For the bay of the examples, the waypoints are those of the file that comes with it.
    """
    written = np.loadtxt(EXAMPLES / "waypoints.csv", delimiter=",", skiprows=1)
    if np.allclose(written[[0, -1]], [problem.start.as_array(), problem.goal.as_array()]):
        return _as_path(written, problem)
    staging = before_dock(problem, STAGING)
    backward = problem.dock.direction is DockDirection.BACKWARD
    heading = math.atan2(staging.y - problem.start.y, staging.x - problem.start.x) + (math.pi if backward else 0.0)
    lines = (
        problem.start.as_array()[None],
        straight(problem.start, Pose2(staging.x, staging.y, heading)),
        straight(staging, problem.goal),
    )
    return _as_path(np.concatenate(lines), problem)


def _as_path(poses: FloatArray, problem: DockingProblem) -> Path:
    """Return poses as a path that begins and ends exactly at the ends of the problem."""
    poses = np.array(poses)
    poses[0], poses[-1] = problem.start.as_array(), problem.goal.as_array()
    return Path.from_poses(poses, problem.frame)


SOURCES: Mapping[str, Callable[[DockingProblem, int], Path | None]] = {
    "OMPL": ompl_path,
    "hybrid A*": hybrid_a_star_path,
    "recorded drive": recorded_path,
    "waypoints": waypoint_path,
}
"""Sources of raw paths: functions of the problem and a seed."""
