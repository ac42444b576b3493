"""`optdock survey`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from optdock.cli.common import (
    METRES,
    SECONDS,
    JobsOption,
    SchedulerOption,
    VerboseOption,
    check_picture,
    reported,
    spare,
    working,
)
from optdock.errors import InvalidValue

if TYPE_CHECKING:
    from collections.abc import Iterator

    from optdock.runner import Workers
    from optdock.survey.grid import Box
    from optdock.survey.survey import DockSurvey, SurveyedDock, SurveySettings

__all__ = ["survey"]

_CELL = "Open one cell of a finished survey"


def survey(  # noqa: PLR0913 - one parameter per option
    scenarios: Annotated[
        list[Path],
        typer.Argument(help="Scenario files (YAML), one per robot; with --cell the folder.", show_default=False),
    ],
    *,
    out: Annotated[Path, typer.Option(help="Folder for the results; continues a survey that was interrupted.")] = Path(
        "survey"
    ),
    within: Annotated[float, typer.Option(metavar=METRES, help="Radius of the region around each dock.")] = 6.0,
    region: Annotated[
        str | None,
        typer.Option(metavar="LEFT,LOWER,RIGHT,UPPER", help="One region for all docks, in m.", show_default=False),
    ] = None,
    resolution: Annotated[float, typer.Option(metavar=METRES, help="Distance between neighbouring positions.")] = 0.1,
    headings: Annotated[int, typer.Option(help="Number of start headings.")] = 16,
    docks: Annotated[
        Path | None, typer.Option(help="Survey the docks of this Nav2 dock database.", show_default=False)
    ] = None,
    along_walls: Annotated[
        float | None,
        typer.Option(metavar=METRES, help="Survey docks along all walls, this far apart.", show_default=False),
    ] = None,
    time_budget: Annotated[
        float, typer.Option(metavar=SECONDS, help="Time for planning one question, on the counted clock.")
    ] = 0.5,
    jobs: JobsOption = None,
    scheduler: SchedulerOption = None,
    cell: Annotated[
        str | None,
        typer.Option(metavar="X,Y,YAW", help="Pose in the cell, in m, m, rad.", rich_help_panel=_CELL),
    ] = None,
    dock: Annotated[
        str | None, typer.Option(help="Name of the dock; default: the best.", rich_help_panel=_CELL)
    ] = None,
    plan: Annotated[
        Path, typer.Option(help="Plan file to write; its scenario is written next to it.", rich_help_panel=_CELL)
    ] = Path("cell.json"),
    verbose: VerboseOption = False,
) -> None:
    """Survey from where robots can dock, and compare places for the dock.

    Every start pose on a grid is certified, proven impossible, or not found. Writes survey.parquet with one row per
    pose, survey.json and a picture of each dock. For example, after `optdock demo`: optdock survey demo/scenario.yaml
    --within 3 --resolution 0.2
    """
    with reported(verbose=verbose):
        if cell is not None:
            _open_cell(scenarios, cell, dock, plan)
            return
        from optdock.runner import Workers
        from optdock.survey.survey import SurveySettings

        spare(*scenarios, out)
        box = None if region is None else _box(region)
        settings = SurveySettings(within, box, resolution, headings, time_budget)
        surveyed = list(_docks(scenarios, docks, along_walls, box))
        _survey(surveyed, settings, out, Workers(jobs, scheduler, clock="counted"))


def _survey(docks: list[SurveyedDock], settings: SurveySettings, out: Path, workers: Workers) -> None:
    """Survey docks, and print and draw the results."""
    from optdock.reports.report import table
    from optdock.survey.survey import file_stems, run_survey

    check_picture("survey", Path("survey.png"))
    stems = file_stems(docks)
    with workers:
        found = run_survey(docks, settings, out, workers, working)
    for one in found:
        typer.echo(str(one.summary))
        _draw(out / f"{stems[one.surveyed.key]}.png", one)
    if len(found) > 1:
        heads = ("dock", "certified %", "floor %", "p95 s", "margin m", "x m", "y m", "yaw rad")
        typer.echo(table([heads, *(_row(one) for one in found)]))
    typer.echo(f"survey.parquet, survey.json and pictures are in {out}")


def _row(one: DockSurvey) -> tuple[str, ...]:
    summary = one.summary
    numbers = (100.0 * summary.share, 100.0 * summary.floor, summary.p95, summary.margin, *summary.pose)
    places = (1, 1, 1, 3, 2, 2, 3)
    shown = (
        f"{round(value, digits) + 0.0:.{digits}f}" if math.isfinite(value) else "-"
        for value, digits in zip(numbers, places, strict=True)
    )
    return one.surveyed.key, *shown


def _docks(
    scenarios: list[Path], database: Path | None, spacing: float | None, region: Box | None
) -> Iterator[SurveyedDock]:
    """Yield the docks of every scenario: its own, those of a database, or those along the walls."""
    from optdock.config import load_scenario
    from optdock.nav2.docks import docked_pose, load_dock_database
    from optdock.survey.dock_places import DockPlace, along_walls
    from optdock.survey.survey import docks_of

    if database is not None and spacing is not None:
        raise InvalidValue("give either --docks or --along-walls")
    if len({source.stem for source in scenarios}) < len(scenarios):
        raise InvalidValue("survey: the scenario files must have different names, which are the names of the robots")
    for source in scenarios:
        scenario = load_scenario(source)
        problem = scenario.problem
        if database is not None:
            entries = load_dock_database(database).values()
            other = next((entry for entry in entries if entry.frame != problem.frame), None)
            if other is not None:
                raise InvalidValue(f"{database}: {other.name}: frame: must be {problem.frame}, got {other.frame}")
            places = [DockPlace(entry.name, docked_pose(entry.pose, problem.dock.direction)) for entry in entries]
        elif spacing is not None:
            places = along_walls(problem, spacing, region)
        else:
            places = [DockPlace("dock", problem.goal)]
        yield from docks_of(source.stem, scenario, places)


def _draw(target: Path, one: DockSurvey) -> None:
    from optdock.plotting.survey_picture import save_survey_picture

    save_survey_picture(target, one.task.scenario.problem, one.answers.layers(), title=str(one.summary))


def _numbers(option: str, text: str, count: int) -> list[float]:
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) != count or not all(map(math.isfinite, values)):
        raise InvalidValue(f"{option}: must be {count} numbers separated by commas, got {text!r}")
    return values


def _box(text: str) -> Box:
    from optdock.survey.grid import Box

    return Box(*_numbers("--region", text, 4))


def _open_cell(folders: list[Path], cell: str, dock: str | None, target: Path) -> None:
    """Write the plan of a cell and its scenario."""
    import dataclasses

    import numpy as np

    from optdock.cli.plan import PlanOutputs, written_failure
    from optdock.config import save_scenario
    from optdock.deadline import budget_clock
    from optdock.errors import OptdockError
    from optdock.geometry.pose import Pose2
    from optdock.reports.report import plan_rows, table
    from optdock.survey.opened import plan_of_cell
    from optdock.survey.survey import open_survey

    if len(folders) != 1:
        raise InvalidValue("--cell needs one folder of a survey")
    spare(None, target, target.with_suffix(".yaml"), *(file for file in folders[0].glob("*") if file.is_file()))
    pose = np.array(_numbers("--cell", cell, 3))
    found = open_survey(folders[0], dock)
    row = int(found.task.grid.cells(pose[None])[0])
    scenario = found.surveyed.scenario
    if row < 0:
        raise InvalidValue(f"--cell: {cell} is outside the surveyed region")
    try:
        with budget_clock("counted"):
            plan = plan_of_cell(found.answers, row, scenario, found.task.time_budget)
    except OptdockError as error:
        start = Pose2.from_sequence(found.task.grid.poses(np.array([row]))[0])
        problem = scenario.problem.starting_at(start)
        save_scenario(target.with_suffix(".yaml"), dataclasses.replace(scenario, problem=problem))
        written_failure(error, problem.frame, PlanOutputs(target))
        raise
    save_scenario(target.with_suffix(".yaml"), dataclasses.replace(scenario, problem=plan.problem))
    plan.save(target)
    typer.echo(table([*plan_rows(plan), ("written", f"{target}, {target.with_suffix('.yaml')}")]))
