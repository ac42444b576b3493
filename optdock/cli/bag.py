"""`optdock bag`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from optdock.cli.common import SECONDS, VerboseOption, reported, spare
from optdock.errors import InvalidFile, InvalidValue

if TYPE_CHECKING:
    from collections.abc import Iterator

    from optdock.model.problem import DockingProblem
    from optdock.ros.bag import BagMessage
    from optdock.ros.contents import Names

__all__ = ["bag"]


def bag(  # noqa: PLR0913 - one parameter per option
    source: Annotated[
        Path, typer.Argument(help="Plan file, run file (JSON) or log of a docking (JSON lines).", show_default=False)
    ],
    out: Annotated[Path, typer.Argument(help="Recording to write: a file .mcap, or a new folder.", show_default=False)],
    *,
    scenario: Annotated[
        Path | None,
        typer.Option(help="Scenario of a plan or run, for the map, the swept area and the closest point."),
    ] = None,
    frame: Annotated[
        str, typer.Option(help="Name of the coordinate frame; default: the frame of the file or the scenario.")
    ] = "",
    base_frame: Annotated[str, typer.Option(help="Frame of the robot.")] = "base_link",
    start: Annotated[float, typer.Option(metavar=SECONDS, help="Start time since 1970; for a log, an offset.")] = 0.0,
    unstamped: Annotated[
        bool, typer.Option("--unstamped", help="Write commands as Twist instead of TwistStamped.")
    ] = False,
    verbose: VerboseOption = False,
) -> None:
    """Record a plan, a simulated run or the log of a docking for RViz, Foxglove or PlotJuggler.

    Topics: plan and docking_trajectory (Path), odom, cmd_vel, tf, markers, diagnostics, map; for runs measured_pose and
    reference_pose; for logs detected_dock_pose and the costmap. The motion of a plan is recorded without tracking
    errors. Recordings are read by optdock import bag.
    """
    with reported(verbose=verbose):
        from optdock.ros.bag import write_bag
        from optdock.ros.contents import LATCHED, Names

        names = _checked(Names(frame, base_frame, start, not unstamped))
        for read in (source, scenario):
            spare(read, out)
        problem = None
        if scenario is not None:
            from optdock.config import load_scenario

            problem = load_scenario(scenario).problem
        messages = [*_messages(source, names, problem)]
        was_there = out.exists()
        write_bag(out, messages, LATCHED)
        topics = len({message.topic for message in messages})
        instead = ", replacing the previous recording" if was_there else ""
        typer.echo(f"written: {out}, {len(messages)} messages on {topics} topics{instead}")


def _checked(names: Names) -> Names:
    if not (math.isfinite(names.start) and names.start >= 0.0):
        raise InvalidValue(f"--start: must be finite and >= 0 s, got {names.start}")
    if not names.base.strip():
        raise InvalidValue(f"--base-frame: must be the name of a coordinate frame, got {names.base!r}")
    return names


def _messages(source: Path, names: Names, problem: DockingProblem | None) -> Iterator[BagMessage]:
    """Generate the messages of a plan file, run file or log."""
    from optdock.ros.contents import log_messages, plan_messages, run_messages

    kind = _format_of(source)
    if kind.startswith("optdock-log/"):
        from optdock.executor.log import read_log

        if problem is not None:
            raise InvalidValue("--scenario: is only for plans and runs; the log of a docking contains its problem")
        yield from log_messages(read_log(source), names)
    elif kind.startswith("optdock-run/"):
        from optdock.io.run_file import load_run

        yield from run_messages(load_run(source), names, problem)
    else:
        from optdock.io.plan_file import load_plan

        try:
            yield from plan_messages(load_plan(source), names, problem)
        except (InvalidFile, InvalidValue) as error:
            text = str(error)
            raise InvalidFile(text if text.startswith(str(source)) else f"{source}: {text}") from error


def _format_of(source: Path) -> str:
    """Return the name of the format stated in a file, or an empty string if there is none."""
    from optdock.io.guarded_file import MostBytes, parse_json, read_text

    try:
        text = read_text(source, MostBytes.LOG)
    except InvalidFile:
        return ""
    for part in (text.partition("\n")[0], text):
        try:
            found = parse_json(part)
        except ValueError:
            continue
        if isinstance(found, dict):
            return str(found.get("format", ""))
    return ""
