"""`optdock replay`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from optdock.cli.common import VerboseOption, check_picture, reported, spare
from optdock.cli.exit_status import ExitStatus

if TYPE_CHECKING:
    from optdock.executor.log import DockingLog
    from optdock.executor.replay import Replay

__all__ = ["replay"]


def replay(
    log: Annotated[Path, typer.Argument(help="Log of a docking (JSON lines).", show_default=False)],
    *,
    plot: Annotated[
        Path | None,
        typer.Option(metavar="PICTURE", help="Draw the drive; the suffix gives the format.", show_default=False),
    ] = None,
    verbose: VerboseOption = False,
) -> None:
    """Replay the log of a docking: print its events, and whether every command is reproduced bit for bit.

    Exit status 0: all commands are reproduced; 3: a command differs, for example with another version of the library.
    """
    with reported(verbose=verbose):
        from optdock.executor.log import read_log
        from optdock.executor.replay import replay as driven_again
        from optdock.reports.report import table

        check_picture("--plot", plot)
        spare(log, plot)
        found = read_log(log)
        again = driven_again(found)
        typer.echo(table([*_rows(found, again)]))
        if plot is not None:
            from optdock.plotting import save_docking_picture

            save_docking_picture(plot, found.task.problem, found.measured, again.estimates, found.commands)
    if again.differs_at is not None:
        at = again.differs_at
        typer.echo(f"{log}:{at.line}: the command is {at.command}, but in the replay it is {again.command}", err=True)
        raise typer.Exit(ExitStatus.NOT_CERTIFIED)


def _rows(log: DockingLog, again: Replay) -> list[tuple[str, str]]:
    first, last = log.cycles[0], log.cycles[-1]
    lasted = last.measurements.stamp - first.measurements.stamp
    ending = last.ending
    ended = "the log ends before the task" if ending is None else ending.kind.value
    rows = [
        ("task", f"{log.task.task}, {len(log.cycles)} cycles in {lasted:.2f} s"),
        ("ending", ended + (f": {ending.reason}" if ending is not None and ending.reason else "")),
    ]
    if ending is not None:
        rows.append(("error code", f"{ending.kind.code}, {ending.num_retries} retries"))
    rows += [
        ("largest deviation", f"{1e3 * again.off_path[0]:.1f} mm across, {again.off_path[1]:.4f} rad, off the path"),
        ("replay", "every command the same, bit for bit" if again.differs_at is None else "another command"),
    ]
    if log.cut_off:
        rows.append(("log", "the last line is truncated and ignored"))
    began = first.measurements.stamp
    for cycle in log.cycles:
        rows += [
            (
                f"{cycle.measurements.stamp - began:.3f} s",
                f"{event.name}: {event.detail}" if event.detail else event.name,
            )
            for event in cycle.events
        ]
    return rows
