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
# Widths [inch] of a letter in a title, of a letter in a legend, and of the handle and padding of a legend entry.
_TITLE_LETTER, _LEGEND_LETTER, _LEGEND_HANDLE = 0.085, 0.07, 0.65
# The palette of Okabe and Ito, whose colours can be distinguished by colour-blind readers.
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
    """Return an empty figure, size in inches.

    Raises:
        MissingExtra: If Matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MissingExtra("pictures need matplotlib: pip install 'optdock[plot]'") from error
    return Figure(figsize=(width, height), dpi=DPI, layout="constrained")


def canvas_of(figure: Figure) -> FigureCanvasAgg:
    """Return the raster canvas of a figure."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    return FigureCanvasAgg(figure)


def entitle(figure: Figure, title: str) -> None:
    """Write a title above the figure, wrapped to its width; $ signs are literal."""
    columns = max(10, int(figure.get_figwidth() / _TITLE_LETTER))
    figure.suptitle(textwrap.fill(title, columns), fontsize=10, parse_math=False)


def legend_below(figure: Figure, axes: Axes) -> None:
    """Add the legend of `axes` below the figure, at most as wide as the figure; equal labels appear only once."""
    handles = dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    widest = _LEGEND_HANDLE + _LEGEND_LETTER * max(map(len, handles), default=0)
    columns = max(1, min(len(handles), int(figure.get_figwidth() / widest)))
    figure.legend(
        handles.values(), handles.keys(), loc="outside lower center", ncols=columns, fontsize=8, frameon=False
    )


def format_of(target: str | Path) -> str:
    """Return the picture format given by the suffix of `target`; PNG if there is none.

    Raises:
        InvalidValue: If the suffix does not belong to a picture format.
        MissingExtra: If Matplotlib is not installed.
    """
    known = canvas_of(new_figure(1.0, 1.0)).get_supported_filetypes()
    kind = Path(target).suffix.removeprefix(".").lower() or "png"
    if kind not in known:
        raise InvalidValue(f"{target}: must end in one of {', '.join(sorted(known))}, got .{kind}")
    return kind


def save_figure(figure: Figure, target: str | Path) -> None:
    """Write a picture atomically, in the format given by the suffix, or PNG if there is none.

    Raises:
        InvalidFile: If the file cannot be written.
        InvalidValue: If the suffix does not belong to a picture format.
    """
    kind = format_of(target)
    with replacing(target) as temporary:
        figure.savefig(temporary, format=kind)
