"""The driven motion stays within the tolerance of its certified path."""

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

experiment = importlib.import_module("experiments.driven_as_proven")
START = Pose2(-1.6, 0.4, 0.3)
COMBINATIONS = [
    ("differential", DockDirection.FORWARD, True),
    ("differential", DockDirection.BACKWARD, False),
    ("turning in place", DockDirection.FORWARD, False),
    ("turning in place", DockDirection.BACKWARD, True),
    ("car, holds", DockDirection.FORWARD, True),
    ("car, holds", DockDirection.BACKWARD, False),
    ("car, straightens", DockDirection.BACKWARD, True),
]


def docked(name, direction, start, late, controller="TrackingController"):
    lag, latency = (experiment.LAG, experiment.LATENCY) if late else (0.0, 0.0)
    return experiment.docked(name, direction, start, lag, latency, controller)


@pytest.mark.parametrize(("name", "direction", "late"), COMBINATIONS)
def test_executor_stays_on_the_certified_path_and_in_its_duration(name, direction, late):
    drove = docked(name, direction, experiment.starts(3, direction, seed=5)[0 if late else 2], late)
    assert drove.off <= 1.0
    assert drove.time <= 1.05
    assert not drove.is_lost


@pytest.mark.parametrize(
    ("name", "number", "late", "without"),
    [("differential", 21, True, 1.5), ("turning in place", 0, True, 1.0), ("car, holds", 28, False, 1.5)],
)
def test_executor_stays_on_a_path_at_the_limits_because_of_the_reserve(name, number, late, without, monkeypatch):
    """Without the reserve of feedback, errors are not corrected while the plan uses the limits."""
    start = experiment.starts(number + 1, DockDirection.FORWARD)[number]
    drove = docked(name, DockDirection.FORWARD, start, late)
    assert drove.off <= 1.0
    assert drove.time <= 1.05
    assert not drove.is_lost
    monkeypatch.setattr(moving_reference, "_STEERED_RATE", 1.0)
    greedy = TrackingController(turn_reserve=0.0)
    assert docked(name, DockDirection.FORWARD, start, late, greedy).off > without


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
    [(TrackingController, "hold"), (MpcController, "straighten")],
)
def test_a_car_waits_at_its_start_until_its_wheels_are_turned(controller, at_rest):
    """With wheels at the opposite limit, the car follows its path only because of the wait."""
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


def test_deviation_from_the_path():
    path = car_plan().path
    on = path.pose_at(0.6)
    assert experiment.off_path(path, on) < 0.1
    assert experiment.off_path(path, on @ Pose2(0.0, 0.006, 0.0)) == pytest.approx(2.0, abs=0.05)
    assert experiment.off_path(path, path.end @ Pose2(0.03, 0.0, 0.0)) == pytest.approx(10.0)
    assert experiment.off_path(path, path.end @ Pose2(0.0, 0.0, np.radians(0.6))) == pytest.approx(2.0, abs=0.05)
