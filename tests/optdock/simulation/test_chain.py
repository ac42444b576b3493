"""The whole chain: path, smoothing, certificate, ruckig timing, controller, axis goal checker."""

import dataclasses
import inspect

import numpy as np
import pytest

from checkers.axis import AxisGoalChecker
from checkers.dock_goal import DockGoalChecker
from optdock.cli.simulate import simulate
from optdock.config import demo_scenario, load_scenario
from optdock.config.simulated_drive import WorldDeviations, driven
from optdock.controllers.tracking_controller import TrackingController
from optdock.errors import InvalidValue
from optdock.geometry.pose import Pose2
from optdock.planning.pipeline import plan_dock
from optdock.plugins.interfaces import PluginContext
from optdock.plugins.registry import PluginChoice
from optdock.simulation import Actuation, SimulationSettings, run_closed_loop

DOCKING = {"along_path_tolerance": 0.02, "cross_track_tolerance": 0.02, "stopped": True}


@pytest.fixture(scope="module")
def scenario():
    return load_scenario(demo_scenario())


@pytest.fixture(scope="module")
def plan(scenario):
    return plan_dock(scenario.problem, time_budget=5.0)


def drive(trajectory, problem, checker, *, beside=(), goal=None, **world):
    controller = TrackingController()
    for plugin in (controller, checker, *beside):
        plugin.configure(PluginContext(type(plugin).__name__, problem=problem))
    settings = SimulationSettings(obstacles=problem.all_obstacles, **{"period": 0.05} | world)
    target = goal or problem.goal
    return run_closed_loop(trajectory, problem.robot, target, controller, checker, settings, beside=beside)


@pytest.mark.parametrize("timing", ["NearOptimal", "Windowed"])
def test_whole_chain_docks_the_robot(scenario, plan, timing):
    if timing != "NearOptimal":
        plan = plan_dock(scenario.problem, time_budget=5.0, timing=timing)
    assert plan.certificate.certified
    assert plan.trajectory_certificate.certified
    assert plan.trajectory_certificate.ratios["jerk"] <= 1.0
    run = drive(
        plan.trajectory,
        scenario.problem,
        AxisGoalChecker(**DOCKING),
        beside=[DockGoalChecker()],
        actuation=Actuation(linear_lag=0.06, angular_lag=0.06, latency=0.04),
        position_noise=0.001,
        yaw_noise=0.001,
        seed=1,
    )
    assert run.docked, run.reason
    assert run.verdicts == {"AxisGoalChecker": True, "DockGoalChecker": True}
    assert max(abs(run.final_error.x), abs(run.final_error.y)) < 0.005
    assert np.all(np.abs(run.twists[-1]) <= (0.01, 0.02))
    assert not run.collided


def test_without_stopped_the_axis_goal_checker_ends_the_run_in_motion(scenario, plan):
    moving = {**DOCKING, "stopped": False}
    run = drive(plan.trajectory, scenario.problem, AxisGoalChecker(**moving), beside=[DockGoalChecker()], period=0.02)
    assert run.docked
    assert run.verdicts == {"AxisGoalChecker": True, "DockGoalChecker": False}
    assert run.final_error.x == pytest.approx(-0.02, abs=0.002)
    assert run.twists[-1, 0] > 0.01


@pytest.mark.parametrize("off", [Pose2(0.03, 0.0, 0.0), Pose2(0.0, 0.03, 0.0)])
def test_dock_three_centimetres_from_the_end_of_the_plan_is_not_reached(scenario, plan, off):
    goal = scenario.problem.goal @ off
    run = drive(plan.trajectory, scenario.problem, AxisGoalChecker(**DOCKING), goal=goal, timeout=15.0)
    assert not run.docked
    assert run.verdicts == {"AxisGoalChecker": False}


def test_second_checker_checks_the_heading(scenario, plan):
    goal = scenario.problem.goal @ Pose2(0.0, 0.0, 0.1)
    run = drive(plan.trajectory, scenario.problem, AxisGoalChecker(**DOCKING), goal=goal, beside=[DockGoalChecker()])
    assert run.verdicts == {"AxisGoalChecker": True, "DockGoalChecker": False}
    assert run.final_error.yaw == pytest.approx(-0.1, abs=0.02)


def test_demo_scenario_has_both_goal_checkers(scenario, plan):
    assert scenario.goal_checker == PluginChoice("AxisGoalChecker", DOCKING)
    run = driven(scenario, plan, 0)
    assert list(run.verdicts) == ["AxisGoalChecker", "DockGoalChecker"]
    assert all(run.verdicts.values())


def test_default_goal_checker_gives_one_verdict(scenario):
    near = scenario.problem.starting_at(scenario.problem.goal @ Pose2(-0.6, 0.0, 0.0))
    plain = dataclasses.replace(scenario, problem=near, goal_checker=PluginChoice("DockGoalChecker"))
    run = driven(plain, plan_dock(near, time_budget=5.0), 0, WorldDeviations(0.0, 0.0, 0.0, 0.0))
    assert run.verdicts == {"DockGoalChecker": True}


def test_two_goal_checkers_with_one_name_are_an_error(plan, scenario):
    with pytest.raises(InvalidValue, match="goal checkers must have different names, got DockGoalChecker"):
        drive(plan.trajectory, scenario.problem, DockGoalChecker(), beside=[DockGoalChecker()])


def test_the_command_has_the_usual_disturbances_as_defaults():
    usual = WorldDeviations()._asdict()
    assert {name: inspect.signature(simulate).parameters[name].default for name in usual} == usual
