"""Figures of the quantities of a motion with their limits, and the player with the common time cursor."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Any

import numpy as np

from optdock.reports.html.figures import PALETTE, axes_of
from optdock.ui.data_post import DataPost

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bokeh import plotting
    from bokeh.models import ColumnDataSource, Span

    from optdock.geometry.arrays import FloatArray
    from optdock.plotting.profile_picture import MotionPanel
    from optdock.reports.shown_motion import ShownMotion
    from optdock.ui.moved_shapes import MovedShapes

__all__ = ["CurveView"]

# Moves the robot with its camera and tube, and the cursors, to the row of the slider.
_MOVE = """
const {at, x, y, yaw, width} = motion.data, k = Math.min(slider.value, at.length - 1);
if (k < 0) { clock.text = ""; for (const ghost of ghosts) ghost.data = {x: [], y: []}; return; }
const c = Math.cos(yaw[k]), s = Math.sin(yaw[k]);
shapes.forEach((shape, row) => {
  const xs = [], ys = [], {x: along, y: across, dx, dy} = shape.data;
  for (let i = 0; i < along.length; i++) {
    const u = along[i] + width[k] * dx[i], v = across[i] + width[k] * dy[i];
    xs.push(x[k] + c * u - s * v);
    ys.push(y[k] + s * u + c * v);
  }
  ghosts[row].data = {x: xs, y: ys};
});
for (const cursor of cursors) cursor.location = at[k];
clock.text = `${at[k].toFixed(2)} s ${motion.data.words[k] ?? ""}`;
"""
# Advances the slider in real time until its end, or until the button is released.
_PLAY = """
button.label = button.active ? "Pause" : "Play";
if (!button.active) return;
if (slider.value >= slider.end) slider.value = 0;
const begun = performance.now(), from = motion.data.at[slider.value] ?? 0;
const advance = () => {
  if (!button.active) return;
  const at = motion.data.at, wanted = from + (performance.now() - begun) / 1000;
  let k = slider.value;
  while (k < at.length - 1 && at[k] < wanted) k++;
  slider.value = k;
  if (k >= at.length - 1) button.active = false; else requestAnimationFrame(advance);
};
requestAnimationFrame(advance);
"""

_COLUMNS = ("at", "value", "upper", "lower")


class CurveView:
    """Curves of a motion, and a player that moves a robot along it.

    Args:
        ghosts: Data of the shapes that the player moves: robot, cone of its camera, and its tube.
        variant: Variant of the colours of `PALETTE`.
    """

    def __init__(self, ghosts: Sequence[ColumnDataSource], variant: int) -> None:
        from bokeh.layouts import column
        from bokeh.models import ColumnDataSource, CustomJS, Div, Slider, Toggle

        self._variant = variant
        self._charts: dict[str, tuple[plotting.figure, ColumnDataSource, Span]] = {}
        self.data = DataPost({})
        self.holder = Div(visible=False, tags=[self.data.post])  # data without a figure are in no document otherwise
        self.charts = column([Div(text="")], sizing_mode="stretch_width")
        self.slider = Slider(
            start=0, end=1, value=0, step=1, title=None, show_value=False, sizing_mode="stretch_width", name="player"
        )
        self.clock = Div(text="", render_as_text=True)  # the title of a slider ends with a colon
        self.play = Toggle(label="Play", width=80, name="play")
        self._motion = ColumnDataSource({name: [] for name in ("at", "x", "y", "yaw", "words", "width")})
        self._shapes = [ColumnDataSource({name: [] for name in ("x", "y", "dx", "dy")}) for _ in ghosts]
        known: dict[str, Any] = {"motion": self._motion, "slider": self.slider}
        moved = {**known, "clock": self.clock, "shapes": self._shapes, "ghosts": [*ghosts], "cursors": []}
        self._move = CustomJS(args=moved, code=_MOVE)
        self.slider.js_on_change("value", self._move)
        self._motion.js_on_change("data", self._move)
        self.play.js_on_change("active", CustomJS(args={**known, "button": self.play}, code=_PLAY))

    def show(self, motion: ShownMotion | None, shapes: MovedShapes) -> None:
        """Show the curves of a motion, and put the player at its beginning."""
        panels = {} if motion is None else {panel.label: panel for panel in motion.panels}
        is_new = not panels.keys() <= self._charts.keys()
        if is_new:
            self._add_charts([panel for panel in panels.values() if panel.label not in self._charts])
        for label, (axes, _, _) in self._charts.items():
            axes.visible = label in panels
            if motion is not None and label in panels:
                self._show_panel(motion, panels[label])
        if is_new:
            self.data.connect()
        self.data.send()
        if motion is None:
            self.show_player(np.zeros(0), np.zeros((0, 3)), shapes)
        else:
            self.show_player(motion.at, motion.poses, shapes)

    def show_player(
        self, at: FloatArray, poses: FloatArray, shapes: MovedShapes, words: Sequence[str] | None = None
    ) -> None:
        """Let the player move along poses, Shape (n, 3), at times, Shape (n,) [s], with a word for each of them."""
        outline, has_tube = shapes.outline, bool(len(shapes.widths))
        tube = (outline, shapes.growth) if has_tube else (outline[:0], outline[:0])
        moved = [(outline, 0.0 * outline), (shapes.cone, 0.0 * shapes.cone), tube]
        for source, (points, growth) in zip(self._shapes, moved, strict=True):
            source.data = {"x": points[:, 0], "y": points[:, 1], "dx": growth[:, 0], "dy": growth[:, 1]}
        self.play.active = False
        self.slider.update(end=max(1, len(at) - 1), value=0, disabled=len(at) < 2)
        shown = [""] * len(at) if words is None else [*words]
        width = shapes.widths if has_tube else np.zeros(len(at))
        self._motion.data = {
            "at": at,
            "x": poses[:, 0],
            "y": poses[:, 1],
            "yaw": poses[:, 2],
            "words": shown,
            "width": width,
        }

    def _add_charts(self, panels: Sequence[MotionPanel]) -> None:
        """Add figures, which stay in the document: Bokeh does not release removed ones in the browser."""
        self._charts |= {panel.label: self._chart(panel) for panel in panels}
        self.data = DataPost({label: source for label, (_, source, _) in self._charts.items()})
        document = self.charts.document
        with contextlib.nullcontext() if document is None else document.models.freeze():  # collects the models once
            self._move.args = {**self._move.args, "cursors": [cursor for _, _, cursor in self._charts.values()]}
            self.charts.children = [axes for axes, _, _ in self._charts.values()]
            self.holder.tags = [self.data.post]

    def _chart(self, panel: MotionPanel) -> tuple[plotting.figure, ColumnDataSource, Span]:
        """Return an empty figure, its data and its cursor."""
        from bokeh.models import ColumnDataSource, Line, Span

        source = ColumnDataSource({name: [] for name in _COLUMNS})
        sizes: dict[str, Any] = {"height": 165, "x_range": (0.0, 1.0), "y_range": panel.axis_range, "tools": ""}
        axes = axes_of("time [s]", "", variant=self._variant, title=panel.label, **sizes)
        axes.title.text_font_style, axes.title.text_color = "normal", PALETTE["ink"][self._variant]
        axes.toolbar_location = None
        limit = {"line_color": PALETTE["limit"][self._variant], "line_dash": "dashed", "line_width": 1.5}
        for name in ("upper", "lower"):
            axes.add_glyph(source, Line(x="at", y=name, **limit))
        axes.add_glyph(source, Line(x="at", y="value", line_color=PALETTE["path"][self._variant], line_width=2.0))
        ink = PALETTE["ink"][self._variant]
        cursor = Span(location=0.0, dimension="height", line_color=ink, line_width=1.0)
        axes.add_layout(cursor)
        return axes, source, cursor

    def _show_panel(self, motion: ShownMotion, panel: MotionPanel) -> None:
        axes, _, _ = self._charts[panel.label]
        axes.xaxis.axis_label = motion.label
        axes.x_range.update(start=float(motion.panels_at[0]), end=float(motion.panels_at[-1]))
        axes.y_range.update(**dict(zip(("start", "end"), map(float, panel.axis_range), strict=True)))
        upper, lower = (np.where(np.isfinite(bound), bound, np.nan) for bound in (panel.upper, panel.lower))
        columns = {"at": motion.panels_at, "value": panel.values, "upper": upper, "lower": lower}
        self.data.put(panel.label, columns)
