"""Options, error messages and the progress bar of all commands."""

from __future__ import annotations

import logging
import math
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

import typer

from optdock.cli.exit_status import ExitStatus, status_of
from optdock.errors import InvalidValue, OptdockError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

__all__ = [
    "METRES",
    "RADIANS",
    "SECONDS",
    "BudgetOption",
    "JobsOption",
    "PlotOption",
    "ScenarioArgument",
    "SchedulerOption",
    "VerboseOption",
    "check_picture",
    "checked_positive",
    "listen",
    "one_line",
    "reported",
    "spare",
    "working",
]

# Units as metavars: a unit in square brackets would be parsed as markup.
SECONDS, METRES, RADIANS = "SECONDS", "METRES", "RADIANS"
_SLOW = 2.0  # [s], after which a command shows its progress

ScenarioArgument: TypeAlias = Annotated[Path, typer.Argument(help="Scenario file (YAML).", show_default=False)]
BudgetOption: TypeAlias = Annotated[
    float | None,
    typer.Option(metavar=SECONDS, help="Wall-clock time for planning; default: the scenario's.", show_default=False),
]
PlotOption: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        metavar="PICTURE",
        help="Draw the plan, or the obstacle in the way; the suffix gives the format, such as .png or .svg.",
        show_default=False,
    ),
]
JobsOption: TypeAlias = Annotated[
    int | None,
    typer.Option(min=1, help="Number of processes for several tasks; default: one per core.", show_default=False),
]
SchedulerOption: TypeAlias = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS",
        help="Address of a dask scheduler, such as tcp://10.0.0.1:8786, whose workers are used instead of processes of "
        "this machine.",
        show_default=False,
    ),
]
VerboseOption: TypeAlias = Annotated[
    bool, typer.Option("--verbose", "-v", help="Log to stderr; may be given before or after the command.")
]


class _Console(logging.Formatter):
    """Log format, in which warnings begin with their level and other records with their module."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the line of a record."""
        begin = record.levelname.lower() if record.levelno >= logging.WARNING else record.name
        return f"{begin}: {super().format(record)}"


class _Once(logging.Filter):
    """Filter that passes every warning only once, because a file may be read twice."""

    def __init__(self) -> None:
        super().__init__()
        self._seen: set[str] = set()

    def filter(self, record: logging.LogRecord) -> bool:
        """Return False for a warning that was logged before, True for all other records."""
        message = record.getMessage()
        is_new = record.levelno < logging.WARNING or message not in self._seen
        self._seen.add(message)
        return is_new


def listen(*, verbose: bool) -> None:
    """Log every warning of the library once to stderr; with `verbose`, also log information."""
    handler = logging.StreamHandler()
    handler.setFormatter(_Console())
    handler.addFilter(_Once())
    logging.basicConfig(level=logging.WARNING, handlers=[handler])
    if verbose:
        for package in ("optdock", "smoothers", "checkers"):
            logging.getLogger(package).setLevel(logging.INFO)


@contextmanager
def reported(*, verbose: bool) -> Iterator[None]:
    """Convert errors of the library to messages on stderr and exit statuses.

    Raises:
        Exit: If the block raises an `OptdockError`. Faults of files are printed line by line, other failures in one
            line that begins with the name of the error.
    """
    listen(verbose=verbose)
    try:
        yield
    except OptdockError as error:
        status = status_of(error)
        typer.echo(str(error) if status is ExitStatus.BAD_INPUT else one_line(error), err=True)
        raise typer.Exit(status) from None


def one_line(error: OptdockError) -> str:
    """Return the name and the message of an error on one line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"


def check_picture(option: str, picture: Path | None) -> None:
    """Check the format of a picture before the computation.

    Raises:
        InvalidValue: If the suffix does not belong to a picture format.
        MissingExtra: If Matplotlib is not installed.
    """
    if picture is not None:
        from optdock.plotting.canvas import format_of

        try:
            format_of(picture)
        except InvalidValue as error:
            raise InvalidValue(f"{option}: {error}") from error


def spare(source: Path | None, *targets: Path | None) -> None:
    """Check that no output file is the input file or another output file.

    Raises:
        InvalidValue: If a file is named twice; devices such as /dev/null may be named several times.
    """
    files = [target for target in targets if target is not None and (target.is_file() or not target.exists())]
    for i, file in enumerate(files):
        if file.resolve() in [other.resolve() for other in files[:i]]:
            raise InvalidValue(f"{file}: is given twice, so one result would overwrite the other")
    for target in targets:
        if (
            source is not None
            and target is not None
            and target.exists()
            and source.exists()
            and target.samefile(source)
        ):
            raise InvalidValue(f"{target}: is the input file and would be overwritten; choose another name")


def checked_positive(option: str, value: float | None, unit: str) -> None:
    """Check that a given value is finite and > 0.

    Raises:
        InvalidValue: If the value is not finite and > 0.
    """
    if value is not None and not (math.isfinite(value) and value > 0.0):
        raise InvalidValue(f"{option}: must be finite and > 0 {unit}, got {value}")


@contextmanager
def working(what: str, total: int) -> Iterator[Callable[[str], None]]:
    """Show a progress bar with the estimated remaining time on stderr, only on terminals and after two seconds.

    The yielded function advances the bar by one; its argument is the name of the finished item.
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task(what, total=total, visible=False)

        def advance(done: str) -> None:
            is_slow = (progress.tasks[0].elapsed or 0.0) > _SLOW
            progress.update(task, advance=1, description=f"{what}: {done}", visible=is_slow)

        yield advance
