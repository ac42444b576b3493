"""The compared docking methods; each runs a case in a world and returns its outcome."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from experiments.docking.outcome import FollowedPlan, Outcome, outcome_of
from experiments.docking.watched import Cycles, WatchedPlanning
from experiments.graceful_law import nav2_command, nav2_filtered
from optdock.deadline import now as clock
from optdock.errors import ControllerException
from optdock.executor import DockingExecutor, ExecutorSettings
from optdock.executor.perception import Perception
from optdock.geometry.pose import Pose2, Twist2
from optdock.model.dock import DockDirection
from optdock.model.path import Direction
from optdock.planning.pipeline import plan_dock
from optdock.plugins.interfaces import Controller, GoalChecker
from optdock.plugins.lifecycle import PluginContext
from optdock.plugins.registry import PluginChoice, create_plugin, timed_by
from optdock.simulation import RemainingPath

if TYPE_CHECKING:
    from experiments.docking.worlds import Case, World
    from optdock.model.measurements import Measurements
    from optdock.model.trajectory import Trajectory
    from optdock.simulation import SimulatedRobot

__all__ = ["METHODS", "executed"]

STALL, PATIENCE = 0.005, 1.0  # [m/s], [s]: stall that counts as contact
TIMEOUT = 60.0  # [s]
CHECKER = {"along_tolerance": 0.01}


def by_law(case: Case, world: World, spread: str, rate: float) -> Outcome:
    """Run Nav2's docking law towards the detected dock until contact or stall, its only end conditions."""
    robot = case.world(world)
    now, goal, cycles = robot.measurements, case.problem.goal, Cycles()
    gear = Direction.FORWARD if case.direction is DockDirection.FORWARD else Direction.REVERSE
    standing = 0.0
    while robot.time < TIMEOUT and not now.contact and standing < PATIENCE:
        assert now.pose is not None
        for seen in now.detections:
            goal = nav2_filtered(goal, now.pose @ seen.pose)
        now = robot.advance(cycles.timed(partial(nav2_command, goal, now.pose, gear)), 1.0 / rate)
        case.push(robot, world)
        standing = standing + 1.0 / rate if abs(now.twist.linear) < STALL and robot.time > PATIENCE else 0.0
    ending = "" if now.contact else "stalled without contact" if standing >= PATIENCE else "timeout"
    names = ("graceful law", world.name, spread, rate)
    return outcome_of(case, robot.record(), [], names=names, ending=ending, counts=(0, 0, 0), busy=cycles.busy)


def _settings(world: World, *, use_detections: bool) -> ExecutorSettings:
    """Return the default settings with the known noise of the localization."""
    return ExecutorSettings(
        use_detections=use_detections,
        position_sigma=max(world.pose.position_sigma, 1e-4),
        yaw_sigma=max(world.pose.yaw_sigma, 1e-4),
    )


def by_plan(case: Case, world: World, spread: str, rate: float, *, smoothed: bool) -> Outcome:
    """Track one plan to the stored dock to its end, with the raw path or the smoothed and certified path."""
    names = (f"{'smoothed' if smoothed else 'raw'} + tracker", world.name, spread, rate)
    plan = plan_dock(case.problem)
    trajectory: Trajectory = (
        plan.trajectory
        if smoothed
        else timed_by("Windowed", plan.raw_path.with_frame(case.problem.frame), case.problem)
    )
    controller = create_plugin(Controller, "TrackingController")
    checker = create_plugin(GoalChecker, "DockGoalChecker", CHECKER)
    for plugin in (controller, checker):
        plugin.configure(PluginContext(plugin.name, problem=case.problem))
    controller.set_path(trajectory)
    robot, cycles, ending = case.world(world, has_switch=world.dock is not None), Cycles(), "timeout"
    filtered = Perception(case.problem.goal, _settings(world, use_detections=False), lambda *_: None)
    remaining, now = RemainingPath(trajectory.path), robot.measurements
    while robot.time < trajectory.duration + TIMEOUT:
        filtered.update(now, now.stamp, 0.0)
        pose, twist = filtered.robot, now.twist
        if checker.is_goal_reached(pose, case.problem.goal, twist, remaining.from_pose(pose)):
            ending = ""
            break
        if now.contact and smoothed is not None and abs(twist.linear) < STALL and robot.time > 1.0:
            ending = ""
            break
        try:
            command = cycles.timed(partial(_commanded, controller, checker, pose, now))
        except ControllerException as error:
            ending = f"{type(error).__name__}: {error}"
            break
        now = robot.advance(command, 1.0 / rate)
        case.push(robot, world)
    followed = [FollowedPlan(0.0, plan)] if smoothed else []
    return outcome_of(case, robot.record(), followed, names=names, ending=ending, counts=(0, 0, 0), busy=cycles.busy)


def _commanded(controller: Controller, checker: GoalChecker, pose: Pose2, now: Measurements) -> Twist2:
    return controller.compute_velocity_commands(pose, now.twist, checker, stamp=now.stamp)


class ExecutorRun(NamedTuple):
    """Record of an executor run; `reported`: how often it reported that the tube was left."""

    robot: SimulatedRobot
    executor: DockingExecutor
    planning: WatchedPlanning
    cycles: Cycles
    reported: int


def executed(case: Case, world: World, rate: float, controller: str = "TrackingController") -> ExecutorRun:
    """Dock by the executor: detections, replanning in motion, contact, retries."""
    robot, cycles, planning = case.world(world, has_switch=world.dock is not None), Cycles(), WatchedPlanning()
    executor = DockingExecutor(
        case.problem,
        _settings(world, use_detections=world.dock is not None),
        controller=controller,
        goal_checker=PluginChoice("DockGoalChecker", CHECKER),
        planning=planning,
    )
    now, reported = robot.measurements, 0
    while robot.time < 5.0 * TIMEOUT:
        planned_before, began = sum(planning.spent), clock()
        step = executor.step(now)
        cycles.spent.append(clock() - began - sum(planning.spent) + planned_before)
        reported += sum(event.name == "tube left" for event in step.events)
        if step.ending is not None and step.command == Twist2():
            break
        now = robot.advance(step.command, 1.0 / rate)
        case.push(robot, world)
    return ExecutorRun(robot, executor, planning, cycles, reported)


def by_executor(
    case: Case, world: World, spread: str, rate: float, *, name: str, controller: str = "TrackingController"
) -> Outcome:
    """Return the outcome of the executor."""
    run = executed(case, world, rate, controller)
    ended = run.executor.ending
    ending = "never ended" if ended is None else "" if ended.kind.succeeded else f"{ended.kind.value}: {ended.reason}"
    return outcome_of(
        case,
        run.robot.record(),
        run.planning.followed,
        names=(name, world.name, spread, rate),
        ending=ending,
        counts=(run.planning.replans, 0 if ended is None else ended.num_retries, run.reported),
        busy=run.cycles.busy,
    )


METHODS: dict[str, Callable[[Case, World, str, float], Outcome]] = {
    "graceful law": by_law,
    "raw path, tracker": partial(by_plan, smoothed=False),
    "smoothed path, tracker": partial(by_plan, smoothed=True),
    "executor": partial(by_executor, name="executor"),
    "executor with the MPC": partial(by_executor, name="executor with the MPC", controller="MpcController"),
}
