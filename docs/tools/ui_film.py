"""Film of `optdock ui` in the documentation: `python docs/tools/ui_film.py`.

Starts the program on a scene with a wall, a wide gap and a pallet, opens its page in a browser, drags the robot around
the pallet, turns it, pushes the pallet into the gap until no motion exists, and undoes this. Every step of the pointer
is a frame; the film is `docs/assets/ui.webp`, its frame with the closed gap `docs/assets/ui.png`.

Requires Playwright for Python (`pip install playwright`) and a Chromium: that in PATH, or that of `playwright install
chromium`.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import itertools
import math
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import yaml
from PIL import Image

if TYPE_CHECKING:
    from collections.abc import Sequence

    from playwright.sync_api import Page

ROOT = Path(__file__).resolve().parents[2]
ASSETS = ROOT / "docs" / "assets"
SIZE = (720, 560)  # [px]
FRAME = 80  # [ms]
PAUSE = 10  # frames
SETTLED = """() => {
  const status = document.querySelector("#status p");
  return status && status.dataset.scene === status.dataset.shown && status.dataset.doing === "";
}"""
PIXEL = """([x, y]) => {
  const view = Object.values(Bokeh.index).find((one) => one.model.name === "scene");
  const {x_scale, y_scale} = view.frame, box = view.el.getBoundingClientRect();
  return [box.left + x_scale.compute(x), box.top + y_scale.compute(y)];
}"""
HAND = """() => {
  const hand = document.createElement("div");
  hand.style.cssText = "position: fixed; width: 18px; height: 18px; margin: -9px; border-radius: 9px; z-index: 9;"
    + "background: #0008; border: 2px solid white; pointer-events: none; left: -50px";
  document.body.append(hand);
  window.addEventListener("pointermove", (event) => {
    hand.style.left = `${event.clientX}px`; hand.style.top = `${event.clientY}px`;
  }, true);
}"""
# The pallet, and points of the pointer [m]: around the pallet, in front of the robot, and into the gap.
PALLET = [[-1.2, -1.2], [-0.6, -1.2], [-0.6, -0.5], [-1.2, -0.5]]
ROUND = ((-2.1, 1.2), (-2.2, 0.6), (-2.2, 0.0), (-2.2, -0.5))
TURN = 60.0  # degrees
INTO = ((-0.9, -0.85), (-0.7, -0.3), (0.0, 0.0))


def write_scene(folder: Path) -> Path:
    """Write the worked scene `no_way` with a wide gap and a pallet, and return the file."""
    content = yaml.safe_load((ROOT / "optdock" / "ui" / "scenes" / "no_way.yaml").read_text(encoding="utf-8"))
    for row, side in ((4, -0.85), (5, 0.85)):
        content["obstacles"][row] = [[x, side if abs(y) < 1.0 else y] for x, y in content["obstacles"][row]]
    content["obstacles"].append(PALLET)
    content["start"] = {"pose": [*ROUND[0], 0.0]}
    file = folder / "pallet.yaml"
    file.write_text(yaml.safe_dump(content), encoding="utf-8")
    return file


class Film:
    """Frames of a page."""

    def __init__(self, page: Page) -> None:
        self.page, self.frames = page, list[Image.Image]()

    def shoot(self, count: int = 1) -> None:
        """Add the page as a number of frames."""
        self.frames += [Image.open(io.BytesIO(self.page.screenshot())).convert("RGB")] * count

    def settle(self) -> None:
        """Wait until the answer that is shown belongs to the scene."""
        self.page.wait_for_function(SETTLED)
        self.page.wait_for_timeout(FRAME)

    def drag(self, places: Sequence[tuple[float, float]], steps: int) -> None:
        """Drag through places in metres, with a frame after every step."""
        from playwright.sync_api import TimeoutError as PlaywrightTimeout

        self.page.mouse.move(*self.page.evaluate(PIXEL, places[0]))
        self.page.mouse.down()
        for (x0, y0), (x1, y1) in itertools.pairwise(places):
            for step in range(1, steps + 1):
                share = step / steps
                at = (x0 + share * (x1 - x0), y0 + share * (y1 - y0))
                self.page.mouse.move(*self.page.evaluate(PIXEL, at))
                self.page.wait_for_timeout(FRAME)
                with contextlib.suppress(PlaywrightTimeout):  # a slow answer is shown as such
                    self.page.wait_for_function(SETTLED, timeout=4 * FRAME)
                self.shoot()
        self.page.mouse.up()
        self.page.wait_for_timeout(4 * FRAME)  # until the release has been noticed
        self.settle()
        self.shoot(PAUSE)


def act(film: Film) -> Image.Image:
    """Drag, turn, close the gap and undo; return the frame with the closed gap."""
    film.shoot(PAUSE)
    film.drag(ROUND, steps=7)
    x, y = ROUND[-1]
    angles = [math.radians(TURN * step / 8) for step in range(9)]
    ahead = film.page.evaluate(
        "() => { const {x, y} = Bokeh.documents[0].get_model_by_name('grips data').data; return [x[0], y[0]]; }"
    )
    reach = math.hypot(ahead[0] - x, ahead[1] - y)
    film.drag([(x + reach * math.cos(angle), y + reach * math.sin(angle)) for angle in angles], steps=1)
    film.drag(INTO, steps=9)
    closed = film.frames[-1]
    film.shoot(PAUSE)
    film.page.get_by_role("button", name="Undo", exact=True).evaluate("button => button.click()")
    film.page.wait_for_timeout(2 * FRAME)
    film.settle()
    film.shoot(2 * PAUSE)
    return closed


def main() -> None:
    """Write the film and the picture."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=ASSETS, help="folder of the film and the picture")
    folder = parser.parse_args().out
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        sys.exit(
            "the film needs Playwright: pip install playwright, and Chromium in PATH or playwright install chromium"
        )
    found = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    with tempfile.TemporaryDirectory() as temporary, sync_playwright() as playwright:
        scene = write_scene(Path(temporary))
        command = [sys.executable, "-c", "from optdock.cli import main; main()", "ui", "--no-browser", "--port", "0"]
        program = subprocess.Popen([*command, str(scene)], stdout=subprocess.PIPE, text=True)
        assert program.stdout is not None
        try:
            browser = playwright.chromium.launch(executable_path=found, args=["--no-sandbox"])
            page = browser.new_page(viewport={"width": SIZE[0], "height": SIZE[1]})
            page.goto(program.stdout.readline().split()[0])
            page.wait_for_function("document.documentElement.dataset.ready === 'yes'")
            page.add_style_tag(
                content="header p { display: none; } #status { height: 5rem; } #figure { height: 24rem; }"
            )
            page.evaluate(HAND)
            film = Film(page)
            film.settle()
            closed = act(film)
            browser.close()
        finally:
            program.terminate()
            program.wait()
    first, *others = film.frames
    first.save(folder / "ui.webp", save_all=True, append_images=others, duration=FRAME, loop=0, quality=55, method=4)
    closed.quantize(128).save(folder / "ui.png", optimize=True)
    print(f"{len(film.frames)} frames, {(folder / 'ui.webp').stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
