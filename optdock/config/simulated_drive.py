"""Closed-loop simulation of a plan with the controller and the goal checker of its scenario."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from optdock.plugins.interfaces import Controller, GoalChecker, never_cancelled
from optdock.plugins.lifecycle import PluginContext
from optdock.plugins.registry import create_plugin
from optdock.simulation import Actuation, SimulationSettings, run_closed_loop

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.config.scenario import Scenario
    from optdock.planning.plan import DockPlan
    from optdock.simulation import Run

__all__ = ["WorldDeviations", "driven"]


class WorldDeviations(NamedTuple):
    """Disturbances in the simulation.

    Args:
        position_noise: Standard deviation of the measured x and y [m]; the default is typical of a docking sensor.
        yaw_noise: Standard deviation of the measured yaw [rad].
        lag: Time constant with which speed and yaw rate, or a car's steering angle, follow their commands [s].
        latency: Delay of the commands [s], rounded to the nearest quarter of the control period.
    """

    position_noise: float = 0.001
    yaw_noise: float = 0.001
    lag: float = 0.06
    latency: float = 0.04


_USUAL = WorldDeviations()


def driven(
    scenario: Scenario,
    plan: DockPlan,
    seed: int,
    world: WorldDeviations = _USUAL,
    cancel_checker: Callable[[], bool] = never_cancelled,
) -> Run:
    """Simulate the plan with the controller of the scenario until its goal checker reports docked.

    The result of the DockGoalChecker, which also checks the heading, is added at the end.

    Args:
        scenario: Scenario with a controller and a goal checker.
        plan: The plan.
        seed: Seed of the noise.
        world: Noise, lag and latency.
        cancel_checker: Polled in every control period.

    Raises:
        Cancelled: If `cancel_checker` returned True.
        InvalidValue: If a parameter is invalid.
    """
    problem = scenario.problem
    controller = create_plugin(Controller, scenario.controller.name, scenario.controller.parameters)
    checker = create_plugin(GoalChecker, scenario.goal_checker.name, scenario.goal_checker.parameters)
    second = create_plugin(GoalChecker, "DockGoalChecker")
    beside = [] if isinstance(checker, type(second)) else [second]
    for plugin in (controller, checker, *beside):
        plugin.configure(PluginContext(type(plugin).__name__, problem=problem))
    # A controller that has a configured period is called with that period.
    period = float(controller.parameters.model_dump().get("period") or SimulationSettings.period)
    settings = SimulationSettings(
        period=period,
        actuation=Actuation(world.lag, world.lag, world.latency),
        position_noise=world.position_noise,
        yaw_noise=world.yaw_noise,
        seed=seed,
        obstacles=problem.all_obstacles,
    )
    return run_closed_loop(
        plan.trajectory,
        problem.robot,
        problem.goal,
        controller,
        checker,
        settings,
        beside=beside,
        cancel_checker=cancel_checker,
    )
