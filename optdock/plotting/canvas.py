"""Matplotlib, loaded on first use and without a display."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING

from optdock.errors import InvalidValue, MissingExtra
from optdock.io.atomic_file import replacing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

__all__ = ["COLOURS", "DPI", "canvas_of", "entitle", "format_of", "legend_below", "new_figure", "save_figure"]

DPI = 110
# Widths of text [inch]: a letter of a title and of a legend, and what a legend puts before and after a label.
_TITLE_LETTER, _LEGEND_LETTER, _LEGEND_HANDLE = 0.085, 0.07, 0.65
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


def entitle(figure: Figure, title: str) -> None:
    """Write a title above the figure, on as many lines as it needs, letter by letter: a $ in a file's name is a $."""
    columns = max(10, int(figure.get_figwidth() / _TITLE_LETTER))
    figure.suptitle(textwrap.fill(title, columns), fontsize=10, parse_math=False)


def legend_below(figure: Figure, axes: Axes) -> None:
    """What the colours of `axes` mean, below the figure and never wider than it; equal labels once."""
    handles = dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    widest = _LEGEND_HANDLE + _LEGEND_LETTER * max(map(len, handles), default=0)
    columns = max(1, min(len(handles), int(figure.get_figwidth() / widest)))
    figure.legend(
        handles.values(), handles.keys(), loc="outside lower center", ncols=columns, fontsize=8, frameon=False
    )


def format_of(target: str | Path) -> str:
    """The picture format that the suffix of `target` names, PNG without one.

    Raises:
        InvalidValue: The suffix names no picture format.
        MissingExtra: Matplotlib is not installed.
    """
    known = canvas_of(new_figure(1.0, 1.0)).get_supported_filetypes()
    kind = Path(target).suffix.removeprefix(".").lower() or "png"
    if kind not in known:
        raise InvalidValue(f"{target}: must end in one of {', '.join(sorted(known))}, got .{kind}")
    return kind


def save_figure(figure: Figure, target: str | Path) -> None:
    """Write a picture, whole or not at all; the suffix chooses the format, PNG without one.

    Raises:
        InvalidFile: The file cannot be written.
        InvalidValue: The suffix names no picture format.
    """
    kind = format_of(target)
    with replacing(target) as temporary:
        figure.savefig(temporary, format=kind)
