"""What the commands share: options, errors on stderr, a progress bar."""

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
    "PlotOption",
    "ScenarioArgument",
    "VerboseOption",
    "check_picture",
    "checked_positive",
    "listen",
    "one_line",
    "reported",
    "spare",
    "working",
]

# The unit of a number stands where its value will: a unit in square brackets would be taken for markup, and not shown.
SECONDS, METRES, RADIANS = "SECONDS", "METRES", "RADIANS"
_SLOW = 2.0  # [s], after which a command shows its progress

ScenarioArgument: TypeAlias = Annotated[Path, typer.Argument(help="Scenario file (YAML).", show_default=False)]
BudgetOption: TypeAlias = Annotated[
    float | None,
    typer.Option(metavar=SECONDS, help="Wall clock for planning; instead of the scenario's.", show_default=False),
]
PlotOption: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        metavar="PICTURE",
        help="Draw what was found, or what stands in the way; the suffix chooses the format, such as .png or .svg.",
        show_default=False,
    ),
]
VerboseOption: TypeAlias = Annotated[
    bool, typer.Option("--verbose", "-v", help="Say on stderr what is done; before or after the command.")
]


class _Console(logging.Formatter):
    """A warning as such, and what the library does with the name of the module."""

    def format(self, record: logging.LogRecord) -> str:
        """The line of a record."""
        begin = record.levelname.lower() if record.levelno >= logging.WARNING else record.name
        return f"{begin}: {super().format(record)}"


class _Once(logging.Filter):
    """Lets every warning through once: a file that is read twice has the same fault twice."""

    def __init__(self) -> None:
        super().__init__()
        self._said: set[str] = set()

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether it is new."""
        said = record.getMessage()
        is_new = record.levelno < logging.WARNING or said not in self._said
        self._said.add(said)
        return is_new


def listen(*, verbose: bool) -> None:
    """Show warnings of the library on stderr, each once, and what it does where that is asked for."""
    handler = logging.StreamHandler()
    handler.setFormatter(_Console())
    handler.addFilter(_Once())
    logging.basicConfig(level=logging.WARNING, handlers=[handler])
    if verbose:
        for package in ("optdock", "smoothers", "checkers"):
            logging.getLogger(package).setLevel(logging.INFO)


@contextmanager
def reported(*, verbose: bool) -> Iterator[None]:
    """Turn every error of the library into a message on stderr and an exit status.

    Raises:
        Exit: The block raised an `OptdockError`. Faults of files are said line by line, failures in one line that
            begins with their name.
    """
    listen(verbose=verbose)
    try:
        yield
    except OptdockError as error:
        status = status_of(error)
        typer.echo(str(error) if status is ExitStatus.BAD_INPUT else one_line(error), err=True)
        raise typer.Exit(status) from None


def one_line(error: OptdockError) -> str:
    """A failure by its name and reason."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"


def check_picture(option: str, picture: Path | None) -> None:
    """Refuse a picture that could not be drawn, before the work that it would show.

    Raises:
        InvalidValue: Its suffix names no picture format.
        MissingExtra: Matplotlib is not installed.
    """
    if picture is not None:
        from optdock.plotting.canvas import format_of

        try:
            format_of(picture)
        except InvalidValue as error:
            raise InvalidValue(f"{option}: {error}") from error


def spare(source: Path | None, *targets: Path | None) -> None:
    """Refuse to write over the file that is read, and to write two results into one file.

    Raises:
        InvalidValue: A target is that file, or that of another result; devices such as /dev/null take any number.
    """
    files = [target for target in targets if target is not None and (target.is_file() or not target.exists())]
    for i, file in enumerate(files):
        if file.resolve() in [other.resolve() for other in files[:i]]:
            raise InvalidValue(f"{file}: is asked for twice, and one result would overwrite the other")
    for target in targets:
        if (
            source is not None
            and target is not None
            and target.exists()
            and source.exists()
            and target.samefile(source)
        ):
            raise InvalidValue(f"{target}: is the file to read, and would be overwritten; choose another name")


def checked_positive(option: str, value: float | None, unit: str) -> None:
    """Refuse a value that is given and not finite and > 0.

    Raises:
        InvalidValue: It is not.
    """
    if value is not None and not (math.isfinite(value) and value > 0.0):
        raise InvalidValue(f"{option}: must be finite and > 0 {unit}, got {value}")


@contextmanager
def working(what: str, total: int) -> Iterator[Callable[[str], None]]:
    """A progress bar with the estimated time left on stderr, on terminals only and after two seconds.

    It advances by one at every call of the function it yields, which takes the name of the finished item.
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
