"""Exit statuses, and how errors become them."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

import typer

from optdock.errors import InvalidFile, InvalidValue, MissingExtra, OptdockError, PluginError

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["BAD_INPUT", "NOT_CERTIFIED", "refuse", "reported", "status_of"]

BAD_INPUT = 2
NOT_CERTIFIED = 3

_INPUT_ERRORS = (InvalidFile, InvalidValue, PluginError, MissingExtra)


def status_of(error: OptdockError) -> int:
    """2 when the input is to blame, 3 when there is no certified plan."""
    return BAD_INPUT if isinstance(error, _INPUT_ERRORS) else NOT_CERTIFIED


@contextmanager
def reported() -> Iterator[None]:
    """Turn every error of the library into a message on stderr and an exit status."""
    try:
        yield
    except OptdockError as error:
        refuse(error)


def refuse(error: OptdockError) -> None:
    """Say on stderr why, and leave: faults of files line by line, failures in one line with their name.

    Raises:
        Exit: Always.
    """
    status = status_of(error)
    text = str(error) if status == BAD_INPUT else f"{type(error).__name__}: {' '.join(str(error).split())}"
    typer.echo(text, err=True)
    raise typer.Exit(status)
