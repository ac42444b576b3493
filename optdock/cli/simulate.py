"""`optdock simulate`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from optdock.cli.exits import NOT_CERTIFIED, reported
from optdock.cli.options import PlotOption, ScenarioArgument, check_picture
from optdock.errors import InvalidValue

if TYPE_CHECKING:
    from optdock.config import Scenario
    from optdock.pipeline import DockPlan
    from optdock.simulation import Run

__all__ = ["driven", "simulate"]

# White noise on the measured pose; a docking sensor at close range measures about this well.
POSITION_NOISE = 0.001  # [m]
YAW_NOISE = 0.001  # [rad]


def simulate(
    scenario: ScenarioArgument,
    *,
    out: Annotated[Path, typer.Option(help="Run file to write (JSON).")] = Path("run.json"),
    seed: Annotated[int, typer.Option(help="Of the measurement noise; equal seeds give equal runs.", min=0)] = 0,
    position_noise: Annotated[float, typer.Option(help="Of the measured x and y, standard deviation [m].")] = (
        POSITION_NOISE
    ),
    yaw_noise: Annotated[float, typer.Option(help="Of the measured yaw, standard deviation [rad].")] = YAW_NOISE,
    plot: PlotOption = None,
) -> None:
    """Plan, then drive the plan in closed loop with noise, and say how exactly the robot ends in the dock."""
    with reported():
        from optdock.cli.solving import solved
        from optdock.config import load_scenario
        from optdock.io.atomic_file import write_text
        from optdock.report import run_json, run_rows, table

        noise = checked_noise("--position-noise", position_noise, "m"), checked_noise("--yaw-noise", yaw_noise, "rad")
        check_picture(plot)
        loaded = load_scenario(scenario)
        run = driven(loaded, solved(loaded), seed, noise)
        write_text(out, run_json(run, seed))
        typer.echo(table(run_rows(run)))
        if plot is not None:
            from optdock.plotting import save_run_picture

            save_run_picture(plot, loaded.problem, run, title=f"{loaded.source.stem}: run with seed {seed}")
        if not run.docked:
            typer.echo(f"not docked: {run.reason}", err=True)
            raise typer.Exit(NOT_CERTIFIED)


def driven(scenario: Scenario, plan: DockPlan, seed: int, noise: tuple[float, float]) -> Run:
    """The plan driven in closed loop by the scenario's controller.

    Args:
        scenario: Names controller and goal checker.
        plan: What to drive.
        seed: Of the noise.
        noise: Standard deviations of the measured position [m] and yaw [rad].

    Raises:
        InvalidValue: A parameter of a plugin or of the noise is wrong.
    """
    from optdock.interfaces import Controller, GoalChecker
    from optdock.lifecycle import PluginContext
    from optdock.plugins import create_plugin
    from optdock.simulation import SimulationSettings, run_closed_loop

    problem = scenario.problem
    controller = create_plugin(Controller, scenario.controller.name, scenario.controller.parameters)
    checker = create_plugin(GoalChecker, scenario.goal_checker.name, scenario.goal_checker.parameters)
    controller.configure(PluginContext("controller", problem.costmap, problem.robot.footprint, problem))
    settings = SimulationSettings(
        period=float(controller.parameters.model_dump().get("period", 0.02)),
        position_noise=noise[0],
        yaw_noise=noise[1],
        seed=seed,
        obstacles=problem.all_obstacles,
    )
    return run_closed_loop(plan.trajectory, problem.robot, problem.goal, controller, checker, settings)


def checked_noise(option: str, value: float, unit: str) -> float:
    """`value`, which must be finite and >= 0.

    Raises:
        InvalidValue: It is not.
    """
    if not (math.isfinite(value) and value >= 0.0):
        raise InvalidValue(f"{option}: must be finite and >= 0 {unit}, got {value}")
    return value
