"""Matplotlib, loaded on first use and without a display."""

from __future__ import annotations

from typing import TYPE_CHECKING

from optdock.errors import InvalidValue, MissingExtra
from optdock.io.atomic_file import replacing

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

__all__ = ["COLOURS", "DPI", "canvas_of", "new_figure", "save_figure"]

DPI = 110
# Okabe and Ito's palette: told apart also by the colour-blind.
COLOURS = {
    "raw": "#E69F00",
    "path": "#0072B2",
    "reverse": "#CC79A7",
    "start": "#009E73",
    "goal": "#D55E00",
    "hot": "#D50000",
    "limit": "#999999",
    "dock": "#8C6D31",
    "obstacle": "#555555",
    "robot": "#56B4E9",
}


def new_figure(width: float, height: float) -> Figure:
    """An empty figure, size in inches.

    Raises:
        MissingExtra: Matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MissingExtra("pictures need matplotlib: pip install 'optdock[plot]'") from error
    return Figure(figsize=(width, height), dpi=DPI, layout="constrained")


def canvas_of(figure: Figure) -> FigureCanvasAgg:
    """The pixels that a figure is drawn on."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    return FigureCanvasAgg(figure)


def save_figure(figure: Figure, target: Path) -> None:
    """Write a picture, whole or not at all; the suffix chooses the format, PNG without one.

    Raises:
        InvalidFile: The file cannot be written.
        InvalidValue: The suffix names no picture format.
    """
    known = canvas_of(figure).get_supported_filetypes()
    kind = target.suffix.removeprefix(".").lower() or "png"
    if kind not in known:
        raise InvalidValue(f"{target}: must end in one of {', '.join(sorted(known))}, got .{kind}")
    with replacing(target) as temporary:
        figure.savefig(temporary, format=kind)
