"""`optdock import tpcap | obca | nav2`: what others describe, as scenario files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

import typer

from optdock.cli.common import SECONDS, VerboseOption, checked_positive, reported, spare
from optdock.errors import InvalidValue

if TYPE_CHECKING:
    from optdock.io.parking_cases import ParkingCase

__all__ = ["app"]

# [s]: what a manoeuvre with cusps may take; a file can be changed.
_BUDGET = 1.0

app = typer.Typer(help="Make a scenario file of a public parking case, or of Nav2's files.", no_args_is_help=True)

OutOption: TypeAlias = Annotated[
    Path, typer.Option("--out", "-o", help="Scenario file to write (YAML).", show_default=False)
]
BudgetOption: TypeAlias = Annotated[
    float, typer.Option(metavar=SECONDS, help="Wall clock for planning, written into the scenario.")
]


@app.command()
def tpcap(
    file: Annotated[Path, typer.Argument(help="Case of the competition (CSV).", show_default=False)],
    *,
    out: OutOption,
    time_budget: BudgetOption = _BUDGET,
    verbose: VerboseOption = False,
) -> None:
    """A case of the ITSC 2022 competition of automated parking, with the competition's car; clearance 0.

    For example: optdock import tpcap Case1.csv -o case1.yaml
    """
    with reported(verbose=verbose):
        from optdock.io.parking_cases import load_tpcap

        spare(file, out)
        _write_parking(out, load_tpcap(file), time_budget, f"TPCAP, {file.name}")


@app.command()
def obca(
    file: Annotated[Path, typer.Argument(help="Scenes (JSON): vehicle, start_grid, scenes.", show_default=False)],
    *,
    scene: Annotated[str, typer.Option(help="backwards or parallel.", show_default=False)],
    start: Annotated[int, typer.Option(help="Which start of the grid, from 0: y by y, for each x.")] = 0,
    out: OutOption,
    time_budget: BudgetOption = _BUDGET,
    verbose: VerboseOption = False,
) -> None:
    """A scene of the OBCA paper from one of its starts, with the file's car and clearance.

    For example: optdock import obca scenes.json --scene parallel --start 3 -o parallel3.yaml
    """
    with reported(verbose=verbose):
        spare(file, out)
        _write_parking(out, _asked(file, scene, start), time_budget, f"OBCA, {file.name}, scene {scene}, start {start}")


def _asked(file: Path, scene: str, start: int) -> ParkingCase:
    from optdock.io.parking_cases import load_obca

    try:
        return load_obca(file, scene, start)
    except InvalidValue as error:
        raise InvalidValue(f"--{error}") from error


def _write_parking(out: Path, case: ParkingCase, time_budget: float, note: str) -> None:
    from optdock.config import Scenario, save_scenario

    checked_positive("--time-budget", time_budget, "s")
    _tell(save_scenario(out, Scenario(case.problem, time_budget), obstacles=case.obstacles, note=note))


@app.command()
def nav2(  # noqa: PLR0913 - one parameter per option
    *,
    nav2_params: Annotated[
        Path, typer.Option(help="Nav2 parameter file: footprint, limits, dock types.", show_default=False)
    ],
    map_: Annotated[Path, typer.Option("--map", help="Map (map_server YAML).", show_default=False)],
    start: Annotated[str, typer.Option(metavar="X,Y,YAW", help="Start pose, in m, m, rad.", show_default=False)],
    docks: Annotated[Path | None, typer.Option(help="Dock database; default: docks in the parameters.")] = None,
    dock: Annotated[str | None, typer.Option(help="Name of the dock; needed where there are several.")] = None,
    out: OutOption,
    time_budget: BudgetOption = _BUDGET,
    verbose: VerboseOption = False,
) -> None:
    """The way into a dock that Nav2's files describe: parameters, map and dock database.

    The scenario names the map where its cells block the same as the parameters' global costmap; else a map is drawn
    beside it. For example: optdock import nav2 --nav2-params nav2_params.yaml --map depot.yaml --docks docks.yaml
    --dock home --start 3.5,1.5,0.1 -o home.yaml
    """
    with reported(verbose=verbose):
        import dataclasses

        from optdock.config import save_scenario
        from optdock.nav2.scenario import nav2_scenario
        from optdock.report import table

        checked_positive("--time-budget", time_budget, "s")
        for read in (nav2_params, map_, docks):
            spare(read, out)
        found = nav2_scenario(nav2_params, map_, start, docks_source=docks, dock_name=dock)
        typer.echo(table(found.costmap_rows))
        note = f"{nav2_params.name}, {map_.name}, dock {dock or 'the only one'}"
        _tell(save_scenario(out, dataclasses.replace(found, time_budget=time_budget), map_source=map_, note=note))


def _tell(written: tuple[Path, ...]) -> None:
    typer.echo(f"written: {', '.join(map(str, written))}")
