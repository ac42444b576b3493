"""`optdock simulate`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from optdock.cli.exits import NOT_CERTIFIED, reported
from optdock.cli.options import PlotOption, ScenarioArgument, check_picture
from optdock.errors import InvalidValue

if TYPE_CHECKING:
    from optdock.config import Scenario
    from optdock.plan import DockPlan
    from optdock.simulation import Run

__all__ = ["World", "driven", "refuse_fault", "simulate"]


class World(NamedTuple):
    """How the simulated world differs from the plan.

    Args:
        position_noise: Standard deviation of the measured x and y [m]; a docking sensor at close range has about this.
        yaw_noise: Standard deviation of the measured yaw [rad].
        lag: Time constant with which speed and yaw rate follow their commands [s].
        latency: Delay of the commands [s], taken to the nearest quarter of the control period.
    """

    position_noise: float = 0.001
    yaw_noise: float = 0.001
    lag: float = 0.06
    latency: float = 0.04


_USUAL = World()


def simulate(  # noqa: PLR0913 - one parameter per option
    scenario: ScenarioArgument,
    *,
    out: Annotated[Path, typer.Option(help="Run file to write (JSON).")] = Path("run.json"),
    seed: Annotated[int, typer.Option(help="Of the measurement noise; equal seeds give equal runs.", min=0)] = 0,
    position_noise: Annotated[float, typer.Option(help="Of the measured x and y, standard deviation [m].")] = (
        _USUAL.position_noise
    ),
    yaw_noise: Annotated[float, typer.Option(help="Of the measured yaw, standard deviation [rad].")] = _USUAL.yaw_noise,
    lag: Annotated[float, typer.Option(help="Time constant of the drive [s].")] = _USUAL.lag,
    latency: Annotated[float, typer.Option(help="Delay of the commands [s].")] = _USUAL.latency,
    plot: PlotOption = None,
) -> None:
    """Plan, then drive the plan in closed loop with lag, latency and noise; say how exactly the robot ends."""
    with reported():
        from optdock.cli.solving import solved
        from optdock.config import load_scenario
        from optdock.io.atomic_file import write_text
        from optdock.report import run_json, run_rows, table

        world = _checked(World(position_noise, yaw_noise, lag, latency))
        check_picture(plot)
        loaded = load_scenario(scenario)
        run = driven(loaded, solved(loaded), seed, world)
        write_text(out, run_json(run, seed))
        typer.echo(table(run_rows(run)))
        if plot is not None:
            from optdock.plotting import save_run_picture

            save_run_picture(plot, loaded.problem, run, title=f"{loaded.source.stem}: run with seed {seed}")
        refuse_fault(run)


def refuse_fault(run: Run) -> None:
    """Leave with a line on stderr where a run did not dock, or collided on its way.

    Raises:
        Exit: There is a fault.
    """
    if run.fault:
        typer.echo(run.fault, err=True)
        raise typer.Exit(NOT_CERTIFIED)


def driven(scenario: Scenario, plan: DockPlan, seed: int, world: World = _USUAL) -> Run:
    """The plan driven in closed loop by the scenario's controller until its goal checker says docked.

    What the DockGoalChecker says at the end stands beside it: it alone judges the heading as well.

    Args:
        scenario: Names controller and goal checker.
        plan: What to drive.
        seed: Of the noise.
        world: Noise, lag and latency.

    Raises:
        InvalidValue: A parameter of a plugin or of the world is wrong.
    """
    from optdock.interfaces import Controller, GoalChecker
    from optdock.lifecycle import PluginContext
    from optdock.plugins import create_plugin
    from optdock.simulation import Actuation, SimulationSettings, run_closed_loop

    problem = scenario.problem
    controller = create_plugin(Controller, scenario.controller.name, scenario.controller.parameters)
    checker = create_plugin(GoalChecker, scenario.goal_checker.name, scenario.goal_checker.parameters)
    second = create_plugin(GoalChecker, "DockGoalChecker")
    beside = [] if isinstance(checker, type(second)) else [second]
    for plugin in (controller, checker, *beside):
        plugin.configure(PluginContext(type(plugin).__name__, problem=problem))
    period = float(controller.parameters.model_dump().get("period", 0.02))
    step = period / Actuation().substeps
    settings = SimulationSettings(
        period=period,
        actuation=Actuation(world.lag, world.lag, step * round(world.latency / step)),
        position_noise=world.position_noise,
        yaw_noise=world.yaw_noise,
        seed=seed,
        obstacles=problem.all_obstacles,
    )
    return run_closed_loop(plan.trajectory, problem.robot, problem.goal, controller, checker, settings, beside=beside)


def _checked(world: World) -> World:
    from optdock.io.numbers import unit_fault

    for name, value in world._asdict().items():
        if not (math.isfinite(value) and value >= 0.0):
            raise InvalidValue(f"--{name.replace('_', '-')}: must be finite and >= 0, got {value}")
    fault = unit_fault(world.yaw_noise, "rad")
    if fault:
        raise InvalidValue(f"--yaw-noise: {fault}")
    return world
