"""Maps of a survey below the scene, and the slider that selects the heading."""

from __future__ import annotations

from typing import TYPE_CHECKING

from optdock.reports.html.figures import PALETTE, draw_layers

if TYPE_CHECKING:
    from bokeh import plotting

    from optdock.ui.surveyed_floor import SurveyedFloor

__all__ = ["FloorView"]

_NOTHING, _ALPHA = "#FFFFFF00", 0.6  # colour of empty cells, opacity of the others
_SELECT = """
layers.forEach((layer, k) => { layer.visible = k === slider.value; });
heading.text = `start heading ${headings[slider.value]} degrees`;
"""


class FloorView:
    """Maps of a survey, of which one is shown.

    Attribute `box`: the slider and the summary of the survey; empty without a survey.

    Args:
        axes: Figure of the scene.
        floor: The survey; None: nothing is drawn.
        variant: Variant of the colours of `PALETTE`.
    """

    def __init__(self, axes: plotting.figure, floor: SurveyedFloor | None, variant: int) -> None:
        from html import escape

        from bokeh.layouts import column
        from bokeh.models import CustomJS, Div, Slider

        self.box = column([Div(text="")], sizing_mode="stretch_width")
        if floor is None:
            self.box.visible = False
            return
        marks = [PALETTE[name][variant] for name in ("impossible", "hot", "occupied")]
        layers = draw_layers(axes, floor.x, floor.y, floor.layers, [_NOTHING, *marks])
        for layer in layers:
            layer.level, layer.glyph.global_alpha = "image", _ALPHA
        slider = Slider(
            start=0, end=max(1, len(layers) - 1), value=0, step=1, show_value=False, sizing_mode="stretch_width",
            title=None, disabled=len(layers) < 2,
        )  # fmt: skip
        heading = Div(text=f"start heading {floor.headings[0]} degrees", render_as_text=True)
        known = {"layers": layers, "headings": floor.headings, "slider": slider, "heading": heading}
        slider.js_on_change("value", CustomJS(args=known, code=_SELECT))
        words = f"{floor.summary}. Colours: 0 s (dark) to {floor.longest:.1f} s (bright)."
        self.box.children = [Div(text=f"<p>{escape(words)}</p>", sizing_mode="stretch_width"), heading, slider]
