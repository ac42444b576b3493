"""`optdock plan`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from optdock.cli.exits import reported
from optdock.cli.options import BudgetOption, PeriodOption, PlotOption, SpacingOption, check_picture, checked_positive
from optdock.errors import InvalidValue

if TYPE_CHECKING:
    from optdock.config import Scenario

__all__ = ["plan"]

_NAV2 = "Instead of a scenario"


def plan(  # noqa: PLR0913 - one parameter per option
    scenario: Annotated[Path | None, typer.Argument(help="Scenario file (YAML).", show_default=False)] = None,
    *,
    out: Annotated[Path, typer.Option(help="Plan file to write (JSON).")] = Path("plan.json"),
    time_budget: BudgetOption = None,
    spacing: SpacingOption = 0.02,
    period: PeriodOption = 0.02,
    plot: PlotOption = None,
    nav2_params: Annotated[
        Path | None, typer.Option(help="Nav2 parameter file: footprint, limits, dock types.", rich_help_panel=_NAV2)
    ] = None,
    map_: Annotated[Path | None, typer.Option("--map", help="Map (map_server YAML).", rich_help_panel=_NAV2)] = None,
    docks: Annotated[
        Path | None, typer.Option(help="Dock database; default: docks in the parameters.", rich_help_panel=_NAV2)
    ] = None,
    dock: Annotated[str | None, typer.Option(help="Name of the dock.", rich_help_panel=_NAV2)] = None,
    start: Annotated[str | None, typer.Option(help="Start pose x,y,yaw [m, m, rad].", rich_help_panel=_NAV2)] = None,
) -> None:
    """Plan one docking and write a certified plan file, or the reason why there is none."""
    with reported():
        checked_positive("--spacing", spacing, "m")
        checked_positive("--period", period, "s")
        if time_budget is not None:
            checked_positive("--time-budget", time_budget, "s")
        check_picture(plot)
        nav2 = _Nav2Sources(nav2_params, map_, docks, dock, start)
        _plan_and_write(_loaded(scenario, nav2), out, time_budget, (spacing, period), plot)


class _Nav2Sources(NamedTuple):
    params: Path | None
    map: Path | None
    docks: Path | None
    dock: str | None
    start: str | None


def _loaded(scenario: Path | None, nav2: _Nav2Sources) -> Scenario:
    from optdock.config import load_scenario
    from optdock.nav2.scenario import nav2_scenario
    from optdock.report import table

    given = [name for name, value in nav2._asdict().items() if value is not None]
    if scenario is not None and not given:
        return load_scenario(scenario)
    if scenario is None and nav2.params is not None and nav2.map is not None and nav2.start is not None:
        found = nav2_scenario(nav2.params, nav2.map, nav2.start, docks_source=nav2.docks, dock_name=nav2.dock)
        typer.echo(table(found.costmap_rows))
        return found
    raise InvalidValue("give either a scenario file, or --nav2-params with --map, --dock and --start")


def _plan_and_write(
    scenario: Scenario, out: Path, time_budget: float | None, steps: tuple[float, float], plot: Path | None
) -> None:
    from optdock.cli.pictures import draw_plan
    from optdock.cli.solving import solved_or_saved
    from optdock.errors import OptdockError
    from optdock.io.plan_file import save_plan
    from optdock.plan import PartialPlan
    from optdock.report import plan_file, plan_rows, table

    spacing, period = steps
    name, problem = scenario.source.stem, scenario.problem
    try:
        found = solved_or_saved(scenario, out, time_budget, spacing)
    except OptdockError as error:
        if plot is not None:
            draw_plan(plot, problem, PartialPlan.left_by(error), f"{name}: {type(error).__name__}")
        raise
    save_plan(out, plan_file(found, problem.frame, period), spacing=spacing)
    typer.echo(table(plan_rows(found)))
    if plot is not None:
        draw_plan(plot, problem, found, f"{name}: certified, {found.trajectory.duration:.1f} s")
