"""A robot stays where its plan is proven: the executor on every plant, drive and gear, and how that is measured."""

from __future__ import annotations

import functools
import importlib
import math

import numpy as np
import pytest

from checkers.dock_goal import DockGoalChecker
from optdock.controllers import moving_reference
from optdock.controllers.mpc import MpcController
from optdock.controllers.tracking_controller import TrackingController
from optdock.geometry.pose import Pose2
from optdock.model.constant_jerk import TimeLaw
from optdock.model.dock import Dock, DockDirection
from optdock.model.problem import DockingProblem
from optdock.model.trajectory import Trajectory
from optdock.planning.pipeline import plan_dock
from optdock.plugins.lifecycle import PluginContext
from optdock.simulation import Actuation, SimulationSettings, Steering, run_closed_loop

experiment = importlib.import_module("experiments.06_driven_as_proven")
START = Pose2(-1.6, 0.4, 0.3)


@pytest.mark.parametrize("late", [False, True])
@pytest.mark.parametrize("direction", [DockDirection.FORWARD, DockDirection.BACKWARD])
@pytest.mark.parametrize("name", experiment.ROBOTS)
def test_the_executor_stays_where_its_plan_is_proven_and_takes_as_long(name, direction, late):
    start = experiment.starts(3, direction, seed=5)[0 if late else 2]
    lag, latency = (experiment.LAG, experiment.LATENCY) if late else (0.0, 0.0)
    drove = experiment.docked(name, direction, start, lag, latency, "TrackingController")
    assert drove.off <= 1.0
    assert drove.time <= 1.05
    assert not drove.is_lost


@pytest.mark.parametrize(
    ("name", "number", "late", "without"),
    [("differential", 21, True, 1.5), ("turning in place", 0, True, 1.0), ("car, holds", 28, False, 1.5)],
)
def test_it_stays_there_where_the_plan_is_at_its_limits(name, number, late, without, monkeypatch):
    """With the reserve of feedback; without it, what is off is never made good while the plan uses all there is."""
    start = experiment.starts(number + 1, DockDirection.FORWARD)[number]
    lag, latency = (experiment.LAG, experiment.LATENCY) if late else (0.0, 0.0)
    drove = experiment.docked(name, DockDirection.FORWARD, start, lag, latency, "TrackingController")
    assert drove.off <= 1.0
    assert drove.time <= 1.05
    assert not drove.is_lost
    monkeypatch.setattr(moving_reference, "_STEERED_RATE", 1.0)
    greedy = TrackingController(turn_reserve=0.0)
    assert experiment.docked(name, DockDirection.FORWARD, start, lag, latency, greedy).off > without


@functools.cache
def car_plan():
    problem = DockingProblem(START, Dock(Pose2(0.0, 0.0, 0.0), final_straight=0.2), experiment.CAR)
    return plan_dock(problem, time_budget=30.0)


def driven(plan, trajectory, controller, steering):
    checker = DockGoalChecker(along_tolerance=0.005)
    for plugin in (controller, checker):
        plugin.configure(PluginContext(plugin.name, problem=plan.problem))
    late = Actuation(linear_lag=0.1, latency=0.06)
    world = SimulationSettings(actuation=late, steering=steering)
    run = run_closed_loop(trajectory, plan.problem.robot, plan.problem.goal, controller, checker, world)
    return run, max(experiment.off_path(plan.path, Pose2.from_sequence(pose)) for pose in run.poses)


@pytest.mark.parametrize(
    ("controller", "at_rest"),
    [(TrackingController, "hold"), (TrackingController, "straighten"), (MpcController, "hold")],
)
def test_a_car_waits_at_its_start_until_its_wheels_are_turned(controller, at_rest):
    """Wheels that stand at the other end: with the wait it drives its path, without it leaves it."""
    plan = car_plan()
    begins = float(experiment.CAR.limits.steering_angle(plan.path.curvature_at(0.0))[0])
    assert abs(begins) > 0.6
    steering = Steering(0.1, at_rest=at_rest, start=-math.copysign(0.7, begins))
    run, off = driven(plan, plan.trajectory, controller(), steering)
    assert run.docked, run.reason
    assert off <= 1.0
    law = plan.trajectory.time_law
    hasty = Trajectory(plan.path, TimeLaw(law.durations[1:], law.jerks[1:]))
    assert plan.trajectory.duration - hasty.duration == pytest.approx(plan.problem.start_wait(plan.path))
    _, off = driven(plan, hasty, controller(), steering)
    assert off > 3.0


def test_what_is_off_the_path_is_measured():
    path = car_plan().path
    on = path.pose_at(0.6)
    assert experiment.off_path(path, on) < 0.1
    assert experiment.off_path(path, on @ Pose2(0.0, 0.006, 0.0)) == pytest.approx(2.0, abs=0.05)
    assert experiment.off_path(path, path.end @ Pose2(0.03, 0.0, 0.0)) == pytest.approx(10.0)
    assert experiment.off_path(path, path.end @ Pose2(0.0, 0.0, np.radians(0.6))) == pytest.approx(2.0, abs=0.05)
