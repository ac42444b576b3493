"""Options that several commands share."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, TypeAlias

import typer

from optdock.errors import InvalidValue

__all__ = [
    "BudgetOption",
    "PeriodOption",
    "PlotOption",
    "ScenarioArgument",
    "SpacingOption",
    "check_picture",
    "checked_positive",
]

ScenarioArgument: TypeAlias = Annotated[Path, typer.Argument(help="Scenario file (YAML).", show_default=False)]
BudgetOption: TypeAlias = Annotated[
    float | None, typer.Option(help="Wall-clock seconds for planning; instead of the scenario's.", show_default=False)
]
SpacingOption: TypeAlias = Annotated[float, typer.Option(help="Largest distance of path samples in the file [m].")]
PeriodOption: TypeAlias = Annotated[float, typer.Option(help="Largest step of trajectory samples in the file [s].")]
PlotOption: TypeAlias = Annotated[
    Path | None, typer.Option(help="Draw a picture; the suffix chooses the format.", show_default=False)
]


def check_picture(plot: Path | None) -> None:
    """Refuse a picture that could not be drawn, before the work that it would show.

    Raises:
        InvalidValue: Its suffix names no picture format.
        MissingExtra: Matplotlib is not installed.
    """
    if plot is not None:
        from optdock.plotting.canvas import format_of

        format_of(plot)


def checked_positive(option: str, value: float, unit: str) -> float:
    """`value`, which must be finite and > 0.

    Raises:
        InvalidValue: It is not.
    """
    if not (math.isfinite(value) and value > 0.0):
        raise InvalidValue(f"{option}: must be finite and > 0 {unit}, got {value}")
    return value
