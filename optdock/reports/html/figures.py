"""Bokeh figures of scenes, motions, drives, comparisons and surveys: results in, figure out.

A figure has no text from files, because BokehJS interprets some characters as formulas. Every colour is one of
`PALETTE`, in its variant for light pages; the page exchanges the colours on dark pages.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import shapely

from optdock.errors import MissingExtra
from optdock.geometry.pose import transform_points
from optdock.model.costs import LETHAL, NO_INFORMATION
from optdock.plotting.canvas import COLOURS
from optdock.plotting.scene import DRAWN_BY_THE_MAP

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from bokeh import plotting
    from bokeh.models import GlyphRenderer
    from numpy.typing import NDArray

    from optdock.geometry.arrays import FloatArray
    from optdock.geometry.footprint import Footprint
    from optdock.model.costmap import Costmap
    from optdock.model.problem import DockingProblem
    from optdock.plotting.scene import View

__all__ = [
    "PALETTE",
    "Curve",
    "LegendEntry",
    "Outline",
    "axes_of",
    "band_figure",
    "bar_figure",
    "check_bokeh",
    "curve_figure",
    "draw_area",
    "draw_curve",
    "draw_layers",
    "draw_map",
    "draw_outlines",
    "draw_point",
    "draw_robot",
    "layer_figure",
    "rings_of",
    "scene_figure",
    "swept_area",
]

# Colours on light and on dark pages; the light variants differ from each other.
PALETTE: Mapping[str, tuple[str, str]] = {
    "raw": (COLOURS["raw"], "#FFB733"),
    "path": (COLOURS["path"], "#58B0F0"),
    "reverse": (COLOURS["reverse"], "#F0A3CD"),
    "start": (COLOURS["start"], "#3FD0A4"),
    "goal": (COLOURS["goal"], "#FF8A3D"),
    "hot": (COLOURS["hot"], "#FF6B6B"),
    "dock": (COLOURS["dock"], "#C9A45A"),
    "obstacle": (COLOURS["obstacle"], "#8A929B"),
    "robot": (COLOURS["robot"], "#2F89BD"),
    "limit": ("#8A5200", "#E0B070"),
    "paper": ("#FFFFFF", "#15181C"),
    "ink": ("#1B1F24", "#E6E8EB"),
    "muted": ("#5C6670", "#9AA4AF"),
    "grid": ("#E3E6EA", "#2B3138"),
    "unknown": ("#D9DDE1", "#2E353C"),
    "occupied": ("#464B50", "#AAB2BA"),
    "impossible": ("#5B1F4A", "#7D3A6C"),
}
_MOST_CELLS = 400  # of a drawn map along each side
_SWEPT = 0.02  # [m] between outlines of the swept area
_SMOOTH = 0.002  # [m]: tolerance of the outline of the swept area
_CURSOR, _ROBOT, _LAYER = "cursor", "robot", "layer"  # names of the models that the page moves or shows


class Curve(NamedTuple):
    """One line of a figure.

    Attributes:
        label: Text of the legend.
        x: Shape (n,).
        y: Shape (n,); nan interrupts the line.
        colour: Name in `PALETTE`.
        dash: `solid`, `dashed` or `dotted`.
        width: Width of the line [px].
    """

    label: str
    x: FloatArray
    y: FloatArray
    colour: str = "path"
    dash: str = "solid"
    width: float = 2.0


class LegendEntry(NamedTuple):
    """Entry of a legend: text, colour in `PALETTE`, and `line`, `dashed`, `dotted`, `area`, `faint` or `point`."""

    label: str
    colour: str
    kind: str = "line"


class Outline(NamedTuple):
    """Style of polygons; colours are names in `PALETTE`, an empty name draws nothing."""

    face: str = ""
    edge: str = ""
    alpha: float = 1.0
    dash: str = "solid"
    width: float = 1.5


def check_bokeh() -> None:
    """Check that reports can be made, before the computation of their content.

    Raises:
        MissingExtra: If Bokeh is not installed.
    """
    try:
        import bokeh.plotting  # noqa: F401
    except ImportError as error:
        raise MissingExtra("reports need Bokeh: pip install 'optdock[report]'") from error


def axes_of(
    x_label: str,
    y_label: str,
    *,
    variant: int = 0,
    **options: Any,  # noqa: ANN401 - options of Bokeh
) -> plotting.figure:
    """Return an empty figure that is as wide as its place on the page.

    Args:
        x_label: Label of the horizontal axis, with its unit.
        y_label: Label of the vertical axis, with its unit.
        variant: Variant of the colours of `PALETTE`.
        **options: Options of `bokeh.plotting.figure`.

    Raises:
        MissingExtra: If Bokeh is not installed.
    """
    check_bokeh()
    from bokeh.plotting import figure

    ink, muted, grid, paper = (PALETTE[name][variant] for name in ("ink", "muted", "grid", "paper"))
    options = {"height": 230, "sizing_mode": "stretch_width", "tools": "pan,wheel_zoom,box_zoom,reset"} | options
    axes = figure(
        x_axis_label=x_label,
        y_axis_label=y_label,
        toolbar_location="above",
        active_drag=None,  # a finger on the figure scrolls the page until a tool is chosen
        active_scroll=None,
        background_fill_color=paper,
        border_fill_color=paper,
        outline_line_color=grid,
        **options,
    )
    axes.toolbar.logo = None
    axes.toolbar.autohide = True
    axes.axis.axis_label_text_color = ink
    axes.axis.axis_label_text_font_style = "normal"
    axes.axis.major_label_text_color = muted
    for lines in ("axis_line_color", "major_tick_line_color", "minor_tick_line_color"):
        setattr(axes.axis, lines, muted)
    axes.grid.grid_line_color = grid
    return axes


def curve_figure(
    curves: Sequence[Curve],
    labels: tuple[str, str],
    span: tuple[float, float],
    y_range: tuple[float, float] | None = None,
    marks: Sequence[float] = (),
) -> plotting.figure:
    """Return a figure of curves over time or arc length, with a cursor that the page moves.

    Args:
        curves: The lines.
        labels: Labels of the two axes, with units.
        span: Range of the horizontal axis.
        y_range: Range of the vertical axis; None: that of the curves.
        marks: Places of vertical lines, such as cusps.

    Raises:
        MissingExtra: If Bokeh is not installed.
    """
    ranges: dict[str, Any] = {"x_range": span} if y_range is None else {"x_range": span, "y_range": y_range}
    axes = axes_of(labels[0], labels[1], **ranges)
    from bokeh.models import HoverTool, Span

    for curve in curves:
        draw_curve(axes, curve)
    for mark in marks:
        line = {"line_color": PALETTE["muted"][0], "line_dash": "dotted", "line_width": 1.0}
        axes.add_layout(Span(location=mark, dimension="height", **line))
    axes.add_layout(
        Span(name=_CURSOR, location=span[0], dimension="height", line_color=PALETTE["ink"][0], line_width=1.0)
    )
    if axes.renderers:
        tooltips = [(labels[0], "$snap_x{0.000}"), (labels[1], "$snap_y{0.0000}")]
        axes.add_tools(HoverTool(tooltips=tooltips, mode="vline", renderers=axes.renderers[:1]))
    return axes


def _draw(
    axes: plotting.figure,
    kind: str,
    columns: Mapping[str, Any],
    name: str | None = None,
    **style: Any,  # noqa: ANN401 - properties of Bokeh
) -> GlyphRenderer:
    """Add glyphs without the variants for selections, which would double the size of the page."""
    from bokeh import models

    glyph = getattr(models, kind)(**{column: column for column in columns}, **style)
    return axes.add_glyph(models.ColumnDataSource(dict(columns)), glyph, name=name)


def draw_curve(axes: plotting.figure, curve: Curve) -> None:
    """Draw a line."""
    x, y = (np.asarray(values, dtype=np.float32) for values in (curve.x, curve.y))
    style: dict[str, Any] = {"line_color": PALETTE[curve.colour][0], "line_dash": curve.dash, "line_width": curve.width}
    _draw(axes, "Line", {"x": x, "y": y}, line_join="round", **style)


def band_figure(
    names: Sequence[str], bands: Sequence[tuple[int, float, float]], events: Sequence[float]
) -> plotting.figure:
    """Return a time line with one row for each name, and a cursor that the page moves.

    Args:
        names: Names of the rows, from the top.
        bands: Row, begin and end of each band [s].
        events: Times of events [s].

    Raises:
        MissingExtra: If Bokeh is not installed.
    """
    height, span = 90 + 26 * len(names), (0.0, max((end for _, _, end in bands), default=1.0))
    axes = axes_of("time [s]", "", x_range=span, y_range=(len(names) - 0.4, -0.9), height=height)
    from bokeh.models import FixedTicker, Span

    rows, begins, ends = (np.array(column, dtype=float) for column in zip(*bands, strict=True))
    columns = {"y": rows, "left": begins, "right": ends}
    _draw(axes, "HBar", columns, height=0.6, fill_color=PALETTE["path"][0], line_color=PALETTE["paper"][0])
    draw_point(axes, np.array([(event, -0.65) for event in events]).reshape(-1, 2), "hot", "inverted_triangle")
    axes.yaxis.ticker = FixedTicker(ticks=list(range(len(names))))
    axes.yaxis.major_label_overrides = dict(enumerate(names))
    axes.add_layout(Span(name=_CURSOR, location=0.0, dimension="height", line_color=PALETTE["ink"][0]))
    return axes


def bar_figure(groups: Sequence[str], values: Mapping[str, Sequence[float]], label: str) -> plotting.figure:
    """Return a figure with one group of bars per row and one bar per series; nan draws no bar.

    Args:
        groups: Names of the groups, from the left.
        values: For each colour of `PALETTE`, the values of all groups.
        label: Label of the vertical axis, with its unit.

    Raises:
        MissingExtra: If Bokeh is not installed.
    """
    axes = axes_of("", label, x_range=(-0.5, len(groups) - 0.5))
    from bokeh.models import FixedTicker

    width = 0.8 / max(len(values), 1)
    for i, (colour, column) in enumerate(values.items()):
        middle = np.arange(len(groups)) - 0.4 + width * (i + 0.5)
        tops, fill = np.asarray(column, dtype=float), PALETTE[colour][0]
        _draw(axes, "VBar", {"x": middle, "top": tops}, width=0.92 * width, fill_color=fill, line_color=fill)
    axes.xaxis.ticker = FixedTicker(ticks=list(range(len(groups))))
    axes.xaxis.major_label_overrides = dict(enumerate(groups))
    axes.xaxis.major_label_orientation = 0.0 if len(groups) < 8 else 0.9
    axes.xgrid.grid_line_color = None
    return axes


def scene_figure(view: View, problem: DockingProblem | None = None) -> tuple[plotting.figure, list[LegendEntry]]:
    """Return a figure in metres with equal scales, and its legend: the map, the obstacles and the dock.

    Args:
        view: Visible rectangle.
        problem: The docking problem; None if the scene is not known.

    Raises:
        MissingExtra: If Bokeh is not installed.
    """
    axes = axes_of("x [m]", "y [m]", sizing_mode="stretch_both", match_aspect=True)
    left, right, bottom, top = view
    corners = {"left": [left], "right": [right], "bottom": [bottom], "top": [top]}
    frame = _draw(axes, "Quad", corners, fill_alpha=0.0, line_alpha=0.0)
    for side in (axes.x_range, axes.y_range):
        side.renderers = [frame]  # the view does not change while the robot moves
        side.range_padding = 0.0
    legend: list[LegendEntry] = []
    if problem is None:
        return axes, legend
    box = shapely.box(left, bottom, right, top)
    if problem.costmap is not None:
        legend += draw_map(axes, problem.costmap, view)
        beyond = box - shapely.box(*problem.costmap.lower, *problem.costmap.upper)
        draw_area(axes, beyond, Outline("unknown"))
        legend += [] if beyond.is_empty else [LegendEntry("beyond the map", "unknown", "area")]
    obstacles = problem.all_obstacles.in_box(np.array([left, bottom]), np.array([right, top]))
    hidden = DRAWN_BY_THE_MAP if problem.costmap is not None else ()
    shapes: dict[str, list[FloatArray]] = {"obstacle": [], "dock": []}
    for row in range(len(obstacles)):
        name = obstacles.name_of(row)
        if name not in hidden:
            shapes["dock" if name == "dock" else "obstacle"].append(obstacles.vertices[row])
    for colour, polygons in shapes.items():
        merged = shapely.union_all([shapely.Polygon(corners).buffer(0.0) for corners in polygons])
        draw_area(axes, shapely.intersection(merged, box), Outline(colour, colour))
        legend += [LegendEntry(colour, colour, "area")] if polygons else []
    return axes, legend


def layer_figure(x: FloatArray, y: FloatArray, layers: Sequence[NDArray[np.uint8]], longest: float) -> plotting.figure:
    """Return maps of a grid, one on top of the other, of which the page shows one.

    Args:
        x: Positions of the columns, increasing [m].
        y: Positions of the rows, increasing [m].
        layers: Codes of the cells, Shape (rows, columns) each: 0 to 249 for durations from 0 to `longest`, 250 empty,
            251 impossible, 252 not found, 253 occupied.
        longest: Largest duration of the colour scale [s].

    Raises:
        MissingExtra: If Bokeh is not installed.
    """
    axes = axes_of("x [m]", "y [m]", sizing_mode="stretch_both", match_aspect=True)
    from bokeh.models import ColorBar, LinearColorMapper

    draw_layers(axes, x, y, layers)
    ink, paper = PALETTE["muted"][0], PALETTE["paper"][0]
    seconds = LinearColorMapper(palette=_seconds_scale(), low=0.0, high=longest)
    bar = ColorBar(color_mapper=seconds, title="time [s]", title_text_color=ink, major_label_text_color=ink, width=12)
    bar.background_fill_color = paper
    axes.add_layout(bar, "right")
    return axes


def draw_layers(
    axes: plotting.figure,
    x: FloatArray,
    y: FloatArray,
    layers: Sequence[NDArray[np.uint8]],
    colours: Sequence[str] | None = None,
) -> list[GlyphRenderer]:
    """Draw maps of a grid, one on top of the other, of which the first one is visible.

    Args:
        axes: Figure in metres.
        x: Positions of the columns, increasing [m].
        y: Positions of the rows, increasing [m].
        layers: Codes of the cells, see `layer_figure`.
        colours: Colours of empty, impossible, not found and occupied cells; None: those of light pages.
    """
    from bokeh.models import LinearColorMapper

    marks = [PALETTE[name][0] for name in ("paper", "impossible", "hot", "occupied")] if colours is None else colours
    palette = [*_seconds_scale(), *marks]
    mapper = LinearColorMapper(palette=palette, low=-0.5, high=len(palette) - 0.5)
    wide, high = (float(np.diff(axis).min()) if axis.size > 1 else 1.0 for axis in (x, y))
    place = {
        "x": [x[0] - 0.5 * wide],
        "y": [y[0] - 0.5 * high],
        "dw": [x[-1] - x[0] + wide],
        "dh": [y[-1] - y[0] + high],
    }
    drawn = []
    for number, codes in enumerate(layers):
        image = _draw(axes, "Image", {"image": [codes], **place}, f"{_LAYER}-{number}", color_mapper=mapper)
        image.visible = number == 0
        drawn.append(image)
    return drawn


def _seconds_scale() -> list[str]:
    from bokeh.palettes import viridis

    return list(viridis(250))


def draw_map(axes: plotting.figure, costmap: Costmap, view: View) -> list[LegendEntry]:
    """Draw the cells of the map in the view; blocks of cells of large maps show their worst cell."""
    from bokeh.models import LinearColorMapper

    (x0, y0), side = costmap.lower, costmap.resolution
    first = np.maximum(0, np.floor((np.array([view.bottom, view.left]) - (y0, x0)) / side).astype(int))
    last = np.minimum(costmap.data.shape, np.ceil((np.array([view.top, view.right]) - (y0, x0)) / side).astype(int))
    if np.any(last <= first):
        return []
    costs = costmap.data[first[0] : last[0], first[1] : last[1]]
    grade = np.zeros(costs.shape, dtype=np.uint8)
    grade[costs == NO_INFORMATION] = 1
    grade[costs == LETHAL] = 2
    block = int(np.ceil(max(costs.shape) / _MOST_CELLS))
    rows, columns = (-(-count // block) for count in costs.shape)
    padded = np.zeros((rows * block, columns * block), dtype=np.uint8)
    padded[: costs.shape[0], : costs.shape[1]] = grade
    cells = padded.reshape(rows, block, columns, block).max(axis=(1, 3))
    palette = [PALETTE[name][0] for name in ("paper", "unknown", "occupied")]
    place = {"x": [x0 + side * int(first[1])], "y": [y0 + side * int(first[0])]}
    size = {"dw": [side * block * columns], "dh": [side * block * rows]}
    mapper = LinearColorMapper(palette=palette, low=-0.5, high=2.5)
    _draw(axes, "Image", {"image": [cells], **place, **size}, color_mapper=mapper).level = "image"
    shown = [name for grade_of, name in ((2, "occupied"), (1, "unknown")) if np.any(cells == grade_of)]
    return [LegendEntry(f"map, {name}", name, "area") for name in shown]


def draw_area(axes: plotting.figure, area: shapely.Geometry, style: Outline) -> None:
    """Draw a polygon or several, with holes."""
    rings = rings_of(area)
    if not rings:
        return
    xs, ys = ([[[np.round(ring[:, i], 4).tolist() for ring in part] for part in rings]] for i in (0, 1))
    _draw(axes, "MultiPolygons", {"xs": xs, "ys": ys}, **_inks(style))


def rings_of(area: shapely.Geometry) -> list[list[FloatArray]]:
    """Return the outline and the holes of every polygon of an area, Shape (n, 2) each [m]."""
    parts = [part for part in shapely.get_parts(area) if part.geom_type == "Polygon" and not part.is_empty]
    return [[shapely.get_coordinates(ring) for ring in (part.exterior, *part.interiors)] for part in parts]


def draw_outlines(axes: plotting.figure, footprint: Footprint, poses: FloatArray, style: Outline) -> None:
    """Draw the outline of the robot at poses, Shape (n, 3), and a line to its front.

    Args:
        axes: Figure in metres.
        footprint: Outline of the robot.
        poses: Poses [m, m, rad].
        style: Style of the outline.
    """
    corners = transform_points(poses, footprint.vertices)
    _draw(axes, "Patches", _columns(corners), **_inks(style))
    if style.edge:
        nose = transform_points(poses, np.array([[0.0, 0.0], [float(footprint.vertices[:, 0].max()), 0.0]]))
        lines: dict[str, Any] = {"line_color": PALETTE[style.edge][0], "line_width": style.width}
        _draw(axes, "MultiLine", _columns(nose), **lines)


def draw_robot(axes: plotting.figure, footprint: Footprint, pose: FloatArray) -> None:
    """Draw the robot that the page moves, at a pose, Shape (3,)."""
    nose = np.array([[0.0, 0.0], [float(footprint.vertices[:, 0].max()), 0.0]])
    body, line = (transform_points(pose[None], points)[0] for points in (footprint.vertices, nose))
    ink = PALETTE["ink"][0]
    style: dict[str, Any] = {
        "fill_color": PALETTE["robot"][0],
        "fill_alpha": 0.75,
        "line_color": ink,
        "line_width": 1.5,
    }
    _draw(axes, "Patch", {"x": body[:, 0], "y": body[:, 1]}, _ROBOT, **style)
    _draw(axes, "Line", {"x": line[:, 0], "y": line[:, 1]}, f"{_ROBOT}-nose", line_color=ink, line_width=2.0)


def _columns(shapes: FloatArray) -> dict[str, list[FloatArray]]:
    return {"xs": list(shapes[:, :, 0]), "ys": list(shapes[:, :, 1])}


def draw_point(axes: plotting.figure, points: FloatArray, colour: str, marker: str = "circle", size: int = 9) -> None:
    """Draw markers at points, Shape (n, 2)."""
    ink = PALETTE[colour][0]
    style: dict[str, Any] = {"marker": marker, "size": size, "fill_color": ink, "line_color": ink, "line_width": 2}
    _draw(axes, "Scatter", {"x": points[:, 0], "y": points[:, 1]}, **style)


def swept_area(footprint: Footprint, poses: FloatArray) -> shapely.Geometry:
    """Return the union of the outlines at poses, Shape (n, 3), simplified by at most 2 mm."""
    turned = footprint.circumscribed_radius * np.abs(np.diff(np.unwrap(poses[:, 2])))
    moved = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T) + turned)))
    rows = np.union1d(np.searchsorted(moved, np.arange(0.0, moved[-1], _SWEPT)), len(poses) - 1)
    outlines = shapely.polygons(transform_points(poses[rows], footprint.vertices))
    return shapely.simplify(shapely.union_all(shapely.buffer(outlines, 0.0)), _SMOOTH)


def _inks(style: Outline) -> dict[str, Any]:
    face, edge = (PALETTE[name][0] if name else None for name in (style.face, style.edge))
    return {
        "fill_color": face,
        "fill_alpha": style.alpha,
        "line_color": edge,
        "line_dash": style.dash,
        "line_width": style.width,
    }
