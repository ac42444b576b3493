"""`optdock import nav2 | bag`: scenario files from Nav2's files and from recordings."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from optdock.cli.common import METRES, SECONDS, VerboseOption, checked_positive, reported, spare
from optdock.errors import InvalidValue

if TYPE_CHECKING:
    from optdock.geometry.footprint import Footprint
    from optdock.model.clearance_rule import ClearanceRule
    from optdock.model.costs import OccupancyRule

__all__ = ["app"]

app = typer.Typer(help="Make scenario files from Nav2's files or from recordings.", no_args_is_help=True)


@app.command()
def nav2(  # noqa: PLR0913 - one parameter per option
    *,
    nav2_params: Annotated[
        Path, typer.Option(help="Nav2 parameter file: footprint, limits, dock types.", show_default=False)
    ],
    map_: Annotated[Path, typer.Option("--map", help="Map (map_server YAML).", show_default=False)],
    start: Annotated[str, typer.Option(metavar="X,Y,YAW", help="Start pose, in m, m, rad.", show_default=False)],
    docks: Annotated[Path | None, typer.Option(help="Dock database; default: docks in the parameters.")] = None,
    dock: Annotated[str | None, typer.Option(help="Name of the dock; required if there are several.")] = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="Scenario file to write (YAML).", show_default=False)],
    time_budget: Annotated[
        float, typer.Option(metavar=SECONDS, help="Wall-clock time for planning in the scenario.")
    ] = 1.0,
    verbose: VerboseOption = False,
) -> None:
    """Write a scenario of a docking from Nav2's parameters, map and dock database.

    The scenario refers to the map if the same cells are occupied as in the global costmap of the parameters; otherwise
    a map is written next to it. For example: optdock import nav2 --nav2-params nav2_params.yaml --map depot.yaml
    --docks docks.yaml --dock home --start 3.5,1.5,0.1 -o home.yaml
    """
    with reported(verbose=verbose):
        import dataclasses

        from optdock.config import save_scenario
        from optdock.nav2.docking_problem import nav2_scenario
        from optdock.reports.report import table

        checked_positive("--time-budget", time_budget, "s")
        for read in (nav2_params, map_, docks):
            spare(read, out)
        found = nav2_scenario(nav2_params, map_, start, docks_source=docks, dock_name=dock)
        typer.echo(table(found.costmap_rows))
        note = f"{nav2_params.name}, {map_.name}, dock {dock or 'the only dock'}"
        _print_files(
            save_scenario(out, dataclasses.replace(found, time_budget=time_budget), map_source=map_, note=note)
        )


@app.command()
def bag(  # noqa: PLR0913 - one parameter per option
    file: Annotated[Path, typer.Argument(help="Recording: .mcap, .db3, or a recorded folder.", show_default=False)],
    *,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder to write into.", show_default=False)],
    path_topic: Annotated[
        str, typer.Option(metavar="TOPIC", help="Default: /docking_trajectory, else /plan_smoothed, else /plan.")
    ] = "",
    costmap_topic: Annotated[
        str,
        typer.Option(
            metavar="TOPIC", help="Default: costmap_raw of /global_costmap, of /local_costmap, their costmap, or /map."
        ),
    ] = "",
    footprint_topic: Annotated[
        str, typer.Option(metavar="TOPIC", help="Default: published_footprint of /local_costmap or /global_costmap.")
    ] = "",
    odom_topic: Annotated[str, typer.Option(metavar="TOPIC", help="Default: /odom, else /odometry/filtered.")] = "",
    base_frame: Annotated[str, typer.Option(help="The robot's frame; default: the odometry's child frame.")] = "",
    footprint: Annotated[
        str, typer.Option(help="Outline as a list of corners in Nav2's syntax, instead of the recorded footprint.")
    ] = "",
    radius: Annotated[
        float | None,
        typer.Option(metavar=METRES, help="Radius of a round robot, instead of the recorded footprint."),
    ] = None,
    clearance: Annotated[float, typer.Option(metavar=METRES, help="Required clearance of path and drive.")] = 0.0,
    contact: Annotated[
        float | None,
        typer.Option(
            metavar=METRES,
            help="Occupied cells within this distance of the footprint at the end of the path belong to the dock and "
            "are free; default: the diagonal of a cell.",
            show_default=False,
        ),
    ] = None,
    occupied_from: Annotated[
        int, typer.Option(help="Occupancy from which a cell of an OccupancyGrid is occupied; 65 for many SLAM maps.")
    ] = 100,
    since: Annotated[float, typer.Option(metavar=SECONDS, help="Ignore messages received earlier.")] = 0.0,
    until: Annotated[
        float | None, typer.Option(metavar=SECONDS, help="Ignore messages received later.", show_default=False)
    ] = None,
    verbose: VerboseOption = False,
) -> None:
    """Extract map, planned path and driven poses of a docking from a recording, for optdock certify.

    The last path, the last costmap and the driven poses are written in the frame of the costmap. To find collisions:
    optdock import bag failed.mcap -o failed; optdock certify failed/path.json failed/path.yaml; the same for
    failed/drive.json
    """
    with reported(verbose=verbose):
        from optdock.reports.report import table
        from optdock.ros.bag import open_bag
        from optdock.ros.field import FieldOptions, FieldTopics, field_docking, judged_poses, save_field_docking

        end = math.inf if until is None else until
        _check_interval(since, end)
        _check_distance("--contact", contact)
        asked = {"path": path_topic, "costmap": costmap_topic, "footprint": footprint_topic, "odometry": odom_topic}
        topics = FieldTopics().instead(asked)
        rule, occupied = _rules(clearance, occupied_from)
        outline = _outline(footprint, radius)
        with open_bag(file) as recording:
            options = FieldOptions(outline, base_frame, occupied, since, end)
            found = field_docking(recording, topics, options)
        judged, rows = judged_poses(found, rule, contact)
        written = save_field_docking(out, judged, found, file.name)
        typer.echo(table([*found.rows, *rows]))
        _print_files(written)


def _check_interval(since: float, until: float) -> None:
    if not 0.0 <= since < until:
        raise InvalidValue(f"--since: must be >= 0 s and before --until, got {since} and {until}")


def _check_distance(option: str, value: float | None) -> None:
    if value is not None and not (math.isfinite(value) and value >= 0.0):
        raise InvalidValue(f"{option}: must be finite and >= 0 m, got {value}")


def _rules(clearance: float, occupied_from: int) -> tuple[ClearanceRule, OccupancyRule]:
    from optdock.model.clearance_rule import ClearanceRule
    from optdock.model.costs import OccupancyRule

    _check_distance("--clearance", clearance)
    if not 1 <= occupied_from <= 100:
        raise InvalidValue(f"--occupied-from: must be in 1..100, got {occupied_from}")
    return ClearanceRule(clearance), OccupancyRule(lethal_cost_threshold=occupied_from)


def _outline(text: str, radius: float | None) -> Footprint | None:
    """Return the outline given by an option, or None."""
    from optdock.geometry.footprint import Footprint

    if text and radius is not None:
        raise InvalidValue("--radius: cannot be given with --footprint")
    if radius is not None:
        return Footprint.from_radius(radius)
    return Footprint.from_string(text) if text else None


def _print_files(written: tuple[Path, ...]) -> None:
    typer.echo(f"written: {', '.join(map(str, written))}")
