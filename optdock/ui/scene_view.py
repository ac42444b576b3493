"""Figure of the scene: obstacles, start and dock, which follow the hand, and the last answer to a request."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, Any

import numpy as np

from optdock.geometry.pose import transform_points
from optdock.plotting.scene import View, view_of
from optdock.reports.html.figures import PALETTE, axes_of, draw_map
from optdock.ui.data_post import DataPost

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from bokeh.models import ColumnDataSource, GlyphRenderer

    from optdock.geometry.arrays import BoolArray, FloatArray
    from optdock.ui.drawn_plan import DrawnPlan
    from optdock.ui.edited_obstacle import EditedObstacle
    from optdock.ui.scene_edits import EditedScene

__all__ = ["GHOSTS", "SceneView", "margin_colours", "named_obstacles", "view_around"]

GHOSTS = ("ghost", "ghost cone", "ghost tube")  # layers that the player moves: robot, view of its camera, tube
_WIDE = 0.3  # [m]: margins from here on have the colour of a free robot
_SCALE = ("#C8102E", "#E8730C", "#E8C20C", "#56B45D", "#2F89BD")  # of margins from 0 to `_WIDE`
_USUAL_WIDTH = 800  # [px]
_VEIL = 0.65  # opacity of the veil over an answer to another scene
_STATUS = """document.getElementById("status").innerHTML = status.data.html[0];"""
_AROUND = 0.5  # obstacles within this share of the size of the view beyond its sides are shown
_BESIDE = 0.15  # [m] between such an obstacle and the side of the figure
_NAMED = re.compile(r"obstacles\[(\d{1,6})\]")
_GRIPS = {"start": "start", "dock": "goal", "obstacles": "muted"}


def margin_colours(margins: FloatArray) -> list[str]:
    """Return the colour of each margin [m], Shape (n,): from red at 0 to blue from 0.3 m on."""
    share = np.clip(margins / _WIDE, 0.0, 1.0) * (len(_SCALE) - 1)
    rgb = np.array([[int(colour[k : k + 2], 16) for k in (1, 3, 5)] for colour in _SCALE], dtype=float)
    mixed = [np.interp(share, np.arange(len(_SCALE)), rgb[:, channel]).round().astype(int) for channel in range(3)]
    return [f"#{r:02X}{g:02X}{b:02X}" for r, g, b in zip(*mixed, strict=True)]


def view_around(scene: EditedScene) -> View:
    """Return a view that contains start, dock and the obstacles around them; cells of the map do not widen it."""
    near = view_of(scene.problem, [])
    lower, upper = np.array([near.left, near.bottom]), np.array([near.right, near.top])
    reach = _AROUND * (upper - lower)
    least, most = lower - reach, upper + reach
    for polygon in scene.polygons:
        low, high = polygon.min(axis=0), polygon.max(axis=0)
        if np.all(high > least) and np.all(low < most):
            lower = np.minimum(lower, np.maximum(low - _BESIDE, least))
            upper = np.maximum(upper, np.minimum(high + _BESIDE, most))
    return View(float(lower[0]), float(upper[0]), float(lower[1]), float(upper[1]))


def named_obstacles(drawn: DrawnPlan) -> tuple[int, ...]:
    """Return the numbers of the obstacles that the headline and the places of an answer name."""
    words = [drawn.headline, *(place.obstacle for place in drawn.places)]
    return tuple(sorted({int(row) for text in words for row in _NAMED.findall(text)}))


class SceneView:
    """Figure in metres with equal scales; changes are sent by `data.send`, once for every message to the browser.

    Args:
        scene: Scene whose map and surroundings are drawn.
        variant: Variant of the colours of `PALETTE`: 0 for light, 1 for dark pages.
    """

    def __init__(self, scene: EditedScene, variant: int) -> None:
        from bokeh.models import ColumnDataSource, CustomJS

        self._variant = variant
        self._mark = self.ink("ink")  # colour of the places of the answer
        self._obstacles: tuple[EditedObstacle, ...] | None = None  # that are drawn
        self.axes = axes_of(
            "x [m]",
            "y [m]",
            sizing_mode="stretch_both",
            match_aspect=True,
            tools="wheel_zoom,pan,reset,save",
            variant=variant,
        )
        self.axes.toolbar.autohide = False
        # Without an active tool for drags, a finger scrolls the page; where it touches a part, the script of the page
        # prevents this.
        self.axes.toolbar.active_drag = None
        # On a canvas of their own, which a change of the layers does not paint again.
        self.axes.axis.level = "overlay"
        self.axes.min_border_left = 60  # [px]; the figure does not move when the labels get wider
        self.view = view_around(scene)
        self._sources: dict[str, ColumnDataSource] = {}
        self._frame = self._add("frame", "Quad", ("left", "right", "bottom", "top"), fill_alpha=0.0, line_alpha=0.0)
        for side in (self.axes.x_range, self.axes.y_range):
            side.renderers = [self._frame]
            side.range_padding = 0.0
        costmap = scene.problem.costmap
        if costmap is not None:
            (x0, y0), (x1, y1) = costmap.lower, costmap.upper
            draw_map(self.axes, costmap, View(float(x0), float(x1), float(y0), float(y1)))
        self._map = [one for one in self.axes.renderers if one is not self._frame]
        for layer in self._map:
            layer.glyph.color_mapper.palette = [self.ink(name) for name in ("paper", "unknown", "occupied")]
        self._draw_all()
        status = self._sources["status"] = ColumnDataSource({"html": [""]})
        status.js_on_change("data", CustomJS(args={"status": status}, code=_STATUS))
        self.data = DataPost(self._sources)
        self.show(scene)
        self.look_at(self.view)

    def source(self, name: str) -> ColumnDataSource:
        """Return the data of a layer."""
        return self._sources[name]

    def ink(self, name: str) -> str:
        """Return a colour of the palette on this page."""
        return PALETTE[name][self._variant]

    def look_at(self, view: View, *, extends: bool = True) -> None:
        """Show another rectangle; with `extends` also the one that is shown."""
        old = self.view if extends else view
        self.view = View(
            min(old.left, view.left), max(old.right, view.right), min(old.bottom, view.bottom), max(old.top, view.top)
        )
        if self.view != old or not extends or not self.data.columns["frame"]:
            self.data.put("frame", {name: [value] for name, value in self.view._asdict().items()})

    def metres(self, pixels: float) -> float:
        """Return the length of a number of pixels [m]."""
        from bokeh.core.property.descriptors import UnsetValueError

        try:
            pixels_across = self.axes.inner_width or _USUAL_WIDTH
        except UnsetValueError:  # until the browser has drawn the figure
            pixels_across = _USUAL_WIDTH
        left, right = self.axes.x_range.start, self.axes.x_range.end
        if not (isinstance(left, float) and isinstance(right, float) and math.isfinite(right - left)):
            left, right = self.view.left, self.view.right
        return pixels * abs(right - left) / float(pixels_across)

    def show(self, scene: EditedScene, selected: str = "") -> None:
        """Draw start, dock, obstacles and grips of a scene.

        Args:
            scene: The scene.
            selected: Name of the part that is marked.
        """
        problem = scene.problem
        for cells in self._map:  # a worked scene has no map
            cells.visible = problem.costmap is not None
        outline = problem.robot.footprint.vertices
        nose = np.array([[0.0, 0.0], [float(outline[:, 0].max()), 0.0]])
        for name, pose in (("start", problem.start), ("dock", problem.goal)):
            at = pose.as_array()[None]
            self.data.put(f"{name} body", _shapes(transform_points(at, outline)))
            self.data.put(f"{name} nose", _shapes(transform_points(at, nose)))
        station = problem.dock.footprint
        at = problem.goal.as_array()[None]
        self.data.put("station", _shapes([] if station is None else transform_points(at, station.vertices)))
        if scene.obstacles is not self._obstacles:  # converting hundreds of them takes 5 ms
            self._obstacles = scene.obstacles
            self.data.put("obstacles", _shapes(scene.polygons))
        handles = [one for one in scene.handles if one.name.endswith(("heading", "]")) or one.name == selected]
        inks = [self.ink(_GRIPS[one.name.partition(".")[0].partition("[")[0]]) for one in handles]
        self.data.put(
            "grips",
            {
                "x": np.array([one.x for one in handles]),
                "y": np.array([one.y for one in handles]),
                "radius": np.array([min(one.radius, 0.12) for one in handles]),
                "fill": inks,
                "line": [
                    self.ink("ink") if one.name == selected else ink for one, ink in zip(handles, inks, strict=True)
                ],
            },
        )

    def show_names(self, scene: EditedScene, selected: str, named: Sequence[int]) -> None:
        """Draw names of obstacles.

        Args:
            scene: The scene.
            selected: Name of the selected part, which has its name if it is an obstacle or a corner of one.
            named: Numbers of the obstacles that the answer names; they have their names and thick outlines.
        """
        known = [row for row in named if row < len(scene.obstacles)]
        chosen = {int(row) for row in _NAMED.findall(selected)} - {*known}
        self.data.put("named", {**_shapes([scene.polygons[row] for row in known]), "line": [self._mark] * len(known)})
        rows = [*known, *sorted(chosen)]
        places = np.array([scene.obstacles[row].disc[:2] for row in rows]).reshape(-1, 2)
        self.data.put("names", {**_line(places), "text": [f"obstacles[{row}]" for row in rows]})

    def show_answer(self, drawn: DrawnPlan) -> None:
        """Draw an answer of the planning process."""
        self.data.put("raw", _line(drawn.raw))
        forward, reverse = (_broken(drawn.path, drawn.gears == gear) for gear in (1, -1))
        self.data.put("forward", _line(forward))
        self.data.put("reverse", _line(reverse))
        self.data.put("swept", {**_shapes(drawn.outlines), "fill": margin_colours(drawn.margins)})
        self.data.put("cusps", _line(drawn.cusps))
        self.data.put("region", _rings(drawn.region))
        self.data.put("cones", _shapes(drawn.cones))
        marked = [place.pose for place in drawn.places]
        self._mark, width = (self.ink("ink"), 2.0) if drawn.outcome == "certified" else (self.ink("hot"), 6.0)
        outlines = _shapes(transform_points(np.array(marked), drawn.outline) if marked else [])
        self.data.put("places", {**outlines, "line": [self._mark] * len(marked), "width": [width] * len(marked)})
        nearest = [place.nearest for place in drawn.places if len(place.nearest)]
        self.data.put("nearest", {**_shapes(nearest), "line": [self._mark] * len(nearest)})
        self.data.put("drive", _line(np.zeros((0, 2))))
        self.fade(faded=False)

    def show_status(self, html: str) -> None:
        """Change the line above the figure, with the next message to the browser."""
        self.data.put("status", {"html": [html]})

    def show_drive(self, poses: FloatArray, detections: FloatArray | None = None) -> None:
        """Draw the way of a robot, Shape (n, 3), and detected docked poses, Shape (m, 3)."""
        self.data.put("drive", _line(poses))
        if detections is not None:
            self.data.put("detections", _line(detections))

    def show_ghost(self, *, visible: bool) -> None:
        """Show or hide the robot that the player moves, with the view of its camera and its tube."""
        for ghost in self._ghosts:
            ghost.visible = visible

    def fade(self, *, faded: bool) -> None:
        """Draw the answer faintly, because it belongs to another scene, or normally."""
        self._veil.visible = faded

    def _draw_all(self) -> None:
        """Add the layers from the lowest to the highest; the veil lies between the answer and the scene in the hand."""
        from bokeh.models import BoxAnnotation

        area, line = ("xs", "ys"), ("x", "y")
        ink = self.ink
        faint: dict[str, Any] = {"fill_color": "fill", "fill_alpha": 0.16, "line_color": "fill", "line_alpha": 0.35}
        self._add("obstacles", "Patches", area, "image", fill_color=ink("obstacle"), line_color=ink("ink"))
        self._add("station", "Patches", area, "image", fill_color=ink("dock"), line_color=ink("dock"))
        closed: dict[str, Any] = {"fill_color": ink("impossible"), "fill_alpha": 0.45, "line_alpha": 0.0}
        self._add("region", "MultiPolygons", area, "underlay", **closed)
        self._add("cones", "Patches", area, "underlay", fill_color=ink("muted"), fill_alpha=0.12, line_alpha=0.0)
        self._add("swept", "Patches", (*area, "fill"), "underlay", **faint)
        self._add("raw", "Line", line, "underlay", line_color=ink("raw"), line_dash="dashed", line_width=1.5)
        self._add("forward", "Line", line, "underlay", line_color=ink("path"), line_width=3.0)
        self._add("reverse", "Line", line, "underlay", line_color=ink("reverse"), line_width=3.0)
        self._add("drive", "Line", line, "underlay", line_color=ink("ink"), line_width=1.5)
        seen: dict[str, Any] = {"size": 7, "marker": "x", "line_color": ink("goal"), "line_width": 1.5}
        self._add("detections", "Scatter", line, "underlay", **seen)
        cusp: dict[str, Any] = {"size": 9, "marker": "diamond", "fill_color": ink("paper"), "line_color": ink("ink")}
        self._add("cusps", "Scatter", line, "underlay", **cusp)
        label: dict[str, Any] = {"text_align": "center", "text_baseline": "middle", "y_offset": -22, "padding": 2}
        label |= {"text_font_size": "13px", "text_color": ink("ink"), "background_fill_color": ink("paper")}
        self._add("names", "Text", (*line, "text"), "underlay", **label)  # below the places
        # Wide lines are visible beside the outline of the docked robot.
        marked: dict[str, Any] = {"line_color": "line", "line_width": "width", "line_dash": "dashed"}
        self._add("places", "Patches", (*area, "line", "width"), "underlay", fill_alpha=0.0, **marked)
        self._add("nearest", "MultiLine", (*area, "line"), "underlay", line_color="line", line_width=2.0)
        self._veil = BoxAnnotation(fill_color=ink("paper"), fill_alpha=_VEIL, level="underlay", visible=False)
        self.axes.add_layout(self._veil)
        self._draw_bodies()

    def _draw_bodies(self) -> None:
        """Add the layers of the player and of the scene in the hand."""
        area, line, ink = ("xs", "ys"), ("x", "y"), self.ink
        robot: dict[str, Any] = {"fill_color": ink("robot"), "fill_alpha": 0.6, "line_color": ink("ink")}
        cone: dict[str, Any] = {"fill_color": ink("muted"), "fill_alpha": 0.2, "line_color": ink("muted")}
        tube: dict[str, Any] = {"fill_alpha": 0.0, "line_color": ink("ink"), "line_dash": "dotted"}
        styles = zip(GHOSTS, (robot, cone, tube), strict=True)
        self._ghosts = [self._add(name, "Patch", line, **style) for name, style in styles]
        for name, colour in (("start", "start"), ("dock", "goal")):
            edge: dict[str, Any] = {"line_color": ink(colour), "line_width": 2.0}
            self._add(f"{name} body", "Patches", area, fill_color=ink(colour), fill_alpha=0.25, **edge)
            self._add(f"{name} nose", "MultiLine", area, **edge)
        self._add("named", "Patches", (*area, "line"), fill_alpha=0.0, line_color="line", line_width=4.0)
        disc: dict[str, Any] = {"fill_color": "fill", "fill_alpha": 0.7, "line_color": "line", "line_width": 2.0}
        self._add("grips", "Circle", (*line, "radius", "fill", "line"), **disc)

    def _add(
        self,
        name: str,
        kind: str,
        columns: Sequence[str],
        level: str = "glyph",
        **style: Any,  # noqa: ANN401 - properties of Bokeh
    ) -> GlyphRenderer:
        from bokeh import models

        source = self._sources[name] = models.ColumnDataSource({column: [] for column in columns}, name=f"{name} data")
        places = {column: column for column in columns if column not in ("fill", "line", "width")}
        glyph = getattr(models, kind)(**places, **style)
        renderer: GlyphRenderer = self.axes.add_glyph(source, glyph, name=name, level=level)
        return renderer


def _shapes(polygons: FloatArray | Iterable[FloatArray]) -> dict[str, FloatArray | list[FloatArray]]:
    if isinstance(polygons, np.ndarray):  # equal numbers of corners
        return {"xs": polygons[:, :, 0], "ys": polygons[:, :, 1]}
    shapes = [*polygons]
    return {"xs": [shape[:, 0] for shape in shapes], "ys": [shape[:, 1] for shape in shapes]}


def _rings(polygons: Sequence[Sequence[FloatArray]]) -> dict[str, list[list[list[list[float]]]]]:
    """Return polygons with holes as one multi-polygon each."""
    return {
        name: [[[ring[:, axis].tolist() for ring in rings]] for rings in polygons]
        for axis, name in enumerate(("xs", "ys"))
    }


def _line(points: FloatArray) -> dict[str, FloatArray]:
    return {"x": points[:, 0], "y": points[:, 1]}


def _broken(poses: FloatArray, shown: BoolArray) -> FloatArray:
    """Return the points of a path, of which those that are not shown are nan. Shape (n, 2)."""
    near = shown.copy()
    near[:-1] |= shown[1:]
    return np.where(near[:, None], poses[:, :2], math.nan)
