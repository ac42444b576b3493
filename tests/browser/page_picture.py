"""Pictures of the page: what is painted at places of a figure, and how its elements lie and contrast."""

import io
import itertools
import math

import numpy as np
from PIL import Image

SAME = 14  # of 255, difference of colours that count as equal
# Ranges of a figure, and its frame in pixels of the window.
_FRAME = """(name) => {
  const of = (view) => view.model.name === name || view.model.title?.text === name;
  const view = Object.values(Bokeh.index).flatMap((root) => [root, ...(root.child_views ?? [])]).find(of);
  const {x_range, y_range} = view.model, box = view.el.getBoundingClientRect(), {bbox} = view.frame;
  return {
    x: [x_range.start, x_range.end], y: [y_range.start, y_range.end], left: box.left + bbox.left,
    top: box.top + bbox.top, width: bbox.width, height: bbox.height,
  };
}"""
# Visible elements with their boxes, also inside widgets; parents by their numbers.
_BOXES = """() => {
  const kinds = "button, input, select, summary, table, .noUi-target, #status, #figure, .legend, footer, h1, header p";
  const found = [];
  const walk = (node, parents) => {
    for (const one of [...node.children, ...(node.shadowRoot?.children ?? [])]) {
      const box = one.getBoundingClientRect(), within = [...parents];
      if (one.matches(kinds) && box.width > 1 && box.height > 1 && one.checkVisibility({visibilityProperty: true})) {
        const name = one.id || one.innerText?.trim().slice(0, 30) || one.className || one.tagName;
        found.push({name, parents, box: [box.left, box.top + scrollY, box.right, box.bottom + scrollY]});
        within.push(found.length - 1);
      }
      walk(one, within);
    }
  };
  walk(document.body, []);
  return found;
}"""
# Colours of texts and of the surface behind each of them.
_TEXTS = """() => {
  const found = [];
  const surface = (node) => {
    for (let one = node; one; one = one.parentElement ?? one.getRootNode().host) {
      const colour = getComputedStyle(one).backgroundColor;
      if (!/, 0\\)$/.test(colour)) return colour;
    }
    return "rgb(255, 255, 255)";
  };
  const walk = (node) => {
    for (const one of [...node.children, ...(node.shadowRoot?.children ?? [])]) {
      const own = [...one.childNodes].filter((part) => part.nodeType === 3).map((part) => part.data);
      const text = one.value ?? own.join(""), isHidden = ["SCRIPT", "STYLE", "OPTION"].includes(one.tagName);
      const isShown = !isHidden && one.type !== "checkbox" && one.checkVisibility({visibilityProperty: true});
      if (/\\w/.test(text) && isShown && !one.disabled)
        found.push([String(text).trim().slice(0, 30), getComputedStyle(one).color, surface(one)]);
      walk(one);
    }
  };
  walk(document.body);
  return found;
}"""


class Picture:
    """The window with one figure in it.

    Args:
        page: The page.
        name: Name of the figure, or its title.
    """

    def __init__(self, page, name):
        shown = page.page.evaluate(_FRAME, name)
        height = page.page.viewport_size["height"]
        page.page.evaluate("(by) => scrollBy(0, by)", shown["top"] + 0.5 * shown["height"] - 0.5 * height)
        page.wait_for_paint()
        self.frame = page.page.evaluate(_FRAME, name)
        image = Image.open(io.BytesIO(page.page.screenshot())).convert("RGB")
        self.pixels = np.asarray(image).astype(int)

    def at(self, points):
        """Return the pixels of points, Shape (n, 2) each, without those outside of the frame of the figure."""
        f, points = self.frame, np.asarray(points, dtype=float)
        share = np.column_stack([(points[:, k] - f[a][0]) / (f[a][1] - f[a][0]) for k, a in enumerate("xy")])
        inside = np.all((share > 0.01) & (share < 0.99), axis=1)
        u, v = f["left"] + share[inside, 0] * f["width"], f["top"] + (1.0 - share[inside, 1]) * f["height"]
        pixels = np.column_stack((u, v)).round().astype(int)
        rows, columns = self.pixels.shape[:2]
        return pixels[
            (pixels[:, 0] > 3) & (pixels[:, 1] > 3) & (pixels[:, 0] < columns - 4) & (pixels[:, 1] < rows - 4)
        ]

    def share_of(self, colour, points, reach=2):
        """Return the share of points with a pixel of a colour within a reach of pixels."""
        wanted, found = rgb(colour), []
        for u, v in self.at(points):
            part = self.pixels[v - reach : v + reach + 1, u - reach : u + reach + 1]
            found.append(bool((np.abs(part - wanted).max(axis=2) <= SAME).any()))
        assert len(found) > 3, "the points are not in the picture"
        return sum(found) / len(found)


def rgb(colour):
    return np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)])


def along(xs, ys, spacing=0.02):
    """Return points along a closed line, Shape (n, 2)."""
    corners = np.column_stack((xs, ys))
    return np.concatenate(
        [
            np.linspace(start, end, 2 + int(math.dist(start, end) / spacing))
            for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True)
        ]
    )


def crowded(page):
    """Return the elements that overlap each other, or leave the page to the side."""
    boxes, width = page.page.evaluate(_BOXES), page.page.evaluate("document.documentElement.clientWidth")
    assert len(boxes) > 30
    outside = [one["name"] for one in boxes if one["box"][0] < 0 or one["box"][2] > width + 0.5]
    pairs = [
        (first["name"], second["name"])
        for (row, first), second in ((pair[0], pair[1][1]) for pair in itertools.combinations(enumerate(boxes), 2))
        if row not in second["parents"] and _overlap(first["box"], second["box"])
    ]
    return outside + pairs


def _overlap(first, second):
    return all(min(first[k + 2], second[k + 2]) - max(first[k], second[k]) > 1.0 for k in (0, 1))


def faint(page, least=4.5):
    """Return the texts whose contrast to their surface is less than that of WCAG 2 for body text."""
    texts = page.page.evaluate(_TEXTS)
    assert len(texts) > 30
    return [one for one in texts if _contrast(*one[1:]) < least]


def _contrast(ink, paper):
    low, high = sorted(map(_luminance, (ink, paper)))
    return (high + 0.05) / (low + 0.05)


def _luminance(colour):
    parts = [float(part) / 255.0 for part in colour[colour.index("(") + 1 : -1].split(",")[:3]]
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    return float(np.dot(linear, (0.2126, 0.7152, 0.0722)))
