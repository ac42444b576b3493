"""`optdock ui` in a browser: the program, a page with the errors that it reports, and its figure in metres."""

import contextlib
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PATIENCE = 60.0  # [s]: longest wait for a state, on a busy machine
_PROGRAM = "from optdock.cli import main; main()"
# Notes the state at each paint of the figure: fingerprints of the scene and of the answer, their layers and the time.
_RECORD = """() => {
  const of = (name) => Bokeh.documents[0].get_model_by_name(`${name} data`).data;
  const shapes = ({xs, ys}) => xs.map((x, i) => Array.from(x, (_, k) => [x[k], ys[i][k]]));
  const view = Object.values(Bokeh.index).find((one) => one.model.name === "scene");
  window.recorded = {paints: [], moves: []};
  window.addEventListener("pointermove", (event) => {
    if (event.buttons) recorded.moves.push([performance.now(), event.clientX, event.clientY]);
  }, true);
  const paint = view.paint.bind(view);
  view.paint = (...given) => {
    const done = paint(...given), status = document.querySelector("#status p");
    const [forward, reverse] = [of("forward"), of("reverse")], path = [];
    for (let i = 0; i < forward.x.length; i++) {
      const line = Number.isNaN(forward.x[i] ?? NaN) ? reverse : forward;
      if (!Number.isNaN(line.x[i] ?? NaN)) path.push([line.x[i], line.y[i]]);
    }
    const [robot, dock] = [shapes(of("start nose"))[0][0], shapes(of("dock nose"))[0][0]];
    const one = {
      scene: status.dataset.scene, shown: status.dataset.shown, outcome: status.classList[0], robot, dock,
      obstacles: shapes(of("obstacles")), first: path[0] ?? null, last: path[path.length - 1] ?? null,
      swept: shapes(of("swept")),
    };
    requestAnimationFrame(() => recorded.paints.push({...one, at: performance.now()}));
    return done;
  };
}"""
_PLACE = """([x, y]) => {
  const view = Object.values(Bokeh.index).find((one) => one.model.name === "scene");
  const {x_scale, y_scale} = view.frame, box = view.el.getBoundingClientRect();
  return [box.left + x_scale.compute(x), box.top + y_scale.compute(y)];
}"""


def missing():
    """Return the reason why no browser can be started; empty if one can."""
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        return "needs Playwright: pip install playwright"
    with sync_playwright() as playwright:
        if _installed() or Path(playwright.chromium.executable_path).exists():
            return ""
    return "needs Chromium in PATH, or playwright install chromium"


def _installed():
    return next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


@contextlib.contextmanager
def launched():
    """Start Chromium with exact memory figures, and end it with the context."""
    from playwright.sync_api import sync_playwright

    arguments = ["--no-sandbox", "--enable-precise-memory-info"]
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=_installed(), args=arguments)
        yield browser
        browser.close()


class Program:
    """`optdock ui` on a free port of localhost.

    Args:
        folder: Folder of its files; the log is written beside it.
        source: Arguments of the command.
        prepared: Statements that are executed first.
    """

    def __init__(self, folder, *source, prepared=""):
        self.folder = Path(folder)
        self.log = self.folder.with_name(f"{self.folder.name}.log")
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONUNBUFFERED": "1"}
        command = [sys.executable, "-c", prepared + _PROGRAM, "ui", "--no-browser", "--port", "0", *source]
        with self.log.open("wb") as log:
            self.process = subprocess.Popen(command, cwd=folder, env=environment, stdout=log, stderr=log)
        self.url = self._address()

    def _address(self):
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end and self.process.poll() is None:
            found = re.search(r"http://\S+", self.log.read_text())
            if found:
                return found[0].rstrip("/") + "/"
            time.sleep(0.1)
        self.end()
        raise RuntimeError(f"optdock ui has not started:\n{self.log.read_text()}")

    def kill(self):
        """Kill the program as a crash would."""
        self.process.kill()
        self.process.wait()

    def end(self):
        """Interrupt the program as Ctrl-C does."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        try:
            self.process.wait(timeout=30)
        except subprocess.TimeoutExpired:
            self.kill()


class OpenedPage:
    """A page with the messages of errors that it reported.

    Args:
        context: Context of the browser.
        url: Address of the page.
    """

    def __init__(self, context, url):
        self.page = context.new_page()
        self.page.set_default_timeout(1e3 * PATIENCE)
        self.errors = []
        self.console = []  # all lines, those of `errors` among them
        self.page.on("pageerror", lambda error: self.errors.append(f"page: {error}"))
        self.page.on("console", self._said)
        self.page.on("request", lambda one: None if self.is_own(one.url) else self.errors.append(f"request: {one.url}"))
        self.url = url
        self.page.goto(url)
        self.wait("() => document.documentElement.dataset.ready === 'yes'")
        self.settle()

    def _said(self, line):
        self.console.append(line.text)
        if line.type in ("error", "warning"):
            self.errors.append(line.text)

    def is_own(self, url):
        return url.startswith((self.url.partition("?")[0], "data:", "blob:"))

    # States.

    @property
    def state(self):
        """Fingerprint of the scene."""
        return self.status("scene")

    @property
    def outcome(self):
        return self.page.inner_text("#status b").partition(";")[0]

    @property
    def message(self):
        """The message above the figure; empty without one."""
        return self.text("message")

    def text(self, name):
        """Return the HTML text of a part of the page."""
        return self.page.evaluate("(name) => Bokeh.documents[0].get_model_by_name(name).text", name)

    def status(self, name):
        return self.page.get_attribute("#status p", f"data-{name}")

    def settle(self):
        """Wait until the answer that is shown belongs to the scene, and is painted."""
        self.wait(
            "() => { const p = document.querySelector('#status p');"
            " return p && p.dataset.shown && p.dataset.scene === p.dataset.shown && p.dataset.doing === ''; }"
        )
        self.wait_for_paint()

    def wait_for_paint(self):
        """Wait until the browser has painted what the page shows now."""
        self.page.evaluate(
            "() => { window.framed = false;"
            " requestAnimationFrame(() => requestAnimationFrame(() => { framed = true; })); }"
        )
        self.wait("() => framed")

    def settle_after(self, state):
        """Wait until the scene has another fingerprint and its answer is shown."""
        self.wait("(old) => document.querySelector('#status p').dataset.scene !== old", state)
        self.settle()

    def wait(self, condition, argument=None):
        """Wait for a condition in JavaScript; a failure names the state of the page.

        The condition is evaluated by a timer, not with each frame: a browser without a GPU may paint none for long.
        """
        from playwright.sync_api import TimeoutError as PlaywrightTimeoutError

        try:
            self.page.wait_for_function(condition, arg=argument, timeout=1e3 * PATIENCE, polling=50)
        except PlaywrightTimeoutError as error:
            state = self.page.evaluate("() => ({ ...(document.querySelector('#status p') ?? {}).dataset })")
            told = f"{state}, errors: {self.errors}, console: {self.console}"
            raise AssertionError(f"{condition} is not met: {told}") from error

    def wait_for_message(self, part):
        self.wait("(part) => Bokeh.documents[0].get_model_by_name('message').text.includes(part)", part)

    # The figure.

    def data(self, name):
        """Return the columns of a layer."""
        return self.page.evaluate(
            "(name) => JSON.parse(JSON.stringify(Bokeh.documents[0].get_model_by_name(`${name} data`).data,"
            " (key, value) => ArrayBuffer.isView(value) ? Array.from(value) : value))",
            name,
        )

    def robot(self, name="start"):
        """Return the position of the robot at the start, or at the dock [m]."""
        nose = self.data(f"{name} nose")
        return [nose["xs"][0][0], nose["ys"][0][0]]

    def nose(self):
        """Return origin and front of the robot at the start [m], Shape (2, 2)."""
        nose = self.data("start nose")
        return [list(point) for point in zip(nose["xs"][0], nose["ys"][0], strict=True)]

    def path_start(self):
        """Return the first point of the path that is shown [m], or None."""
        forward, reverse = self.data("forward"), self.data("reverse")
        points = zip(forward["x"], forward["y"], reverse["x"], reverse["y"], strict=True)
        shown = ((x, y) if x is not None else (u, v) for x, y, u, v in points)
        return next((point for point in shown if point[0] is not None), None)

    def pixel(self, place):
        """Return the pixel of the window at a place in metres."""
        self.page.evaluate("document.getElementById('figure').scrollIntoView({block: 'center'})")
        return self.page.evaluate(_PLACE, list(place))

    def record(self):
        """Note the state at each paint of the figure and each move of the pointer from now on."""
        self.page.evaluate(_RECORD)

    @property
    def recorded(self):
        return self.page.evaluate("recorded")

    # Actions.

    def drag(self, place, to, steps=12):
        """Drag from a place to another one, both in metres."""
        self.press(place)
        self.page.mouse.move(*self.pixel(to), steps=steps)
        self.page.mouse.up()

    def press(self, place):
        self.page.mouse.move(*self.pixel(place))
        self.page.mouse.down()

    def click(self, label):
        self.page.get_by_role("button", name=label, exact=True).click()

    def field(self, label):
        """Return the text of a field, whose group is opened."""
        self.page.evaluate("for (const one of document.querySelectorAll('details')) one.open = true")
        return self.page.get_by_role("textbox", name=label, exact=True)

    def slider(self, label):
        """Return the handle of the slider beside a field."""
        return self.page.locator(".bk-Row").filter(has=self.field(label)).get_by_role("slider").last

    def pull(self, handle, pixels):
        """Drag the handle of a slider to the right."""
        handle.scroll_into_view_if_needed()
        box = handle.bounding_box()
        x, y = box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"]
        self.page.mouse.move(x, y)
        self.page.mouse.down()
        self.page.mouse.move(x + pixels, y, steps=8)
        self.page.mouse.up()

    def enter(self, label, text):
        """Enter a text in a field."""
        field = self.field(label)
        field.fill(text)
        field.press("Enter")

    def choose(self, title, value):
        """Choose a value of a menu."""
        self.page.get_by_role("combobox", name=title, exact=True).select_option(value)
