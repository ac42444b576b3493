"""Check of a report in a browser, and its picture in the documentation: `python docs/tools/browser_check.py`.

Plans, drives and compares the example scenario, writes a report of all files, and opens it from its file on a wide and
a narrow page, light and dark. On every page the sliders are moved. Messages of the console, requests
and content wider than the page are faults. `--assets` writes the picture of the how-to guide.

Requires Playwright for Python (`pip install playwright`) and a Chromium: that in PATH, or that of `playwright install
chromium`.
"""

from __future__ import annotations

import argparse
import io
import shutil
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from PIL import Image
from typer.testing import CliRunner

from optdock.cli import app

if TYPE_CHECKING:
    from collections.abc import Iterator

    from playwright.sync_api import Browser, Page

ROOT = Path(__file__).resolve().parents[2]
SIZES = {"desktop": (1280, 900), "phone": (390, 844)}
SCHEMES = ("light", "dark")
WAITS = 120  # half seconds until all figures are drawn
SLOW = 300_000  # [ms], time limit of a picture of a whole page
MOVED = 0.6  # of the way of every slider


def make_report(folder: Path) -> Path:
    """Return a report of a plan, a run and a comparison, written into a folder."""
    scenario, target = str(ROOT / "examples" / "data" / "bay.yaml"), folder / "report.html"
    plan, run, table = (str(folder / name) for name in ("plan.json", "run.json", "compared"))
    for command in (
        ["plan", scenario, "--out", plan],
        ["simulate", scenario, "--out", run],
        ["compare", scenario, "--out", table],
        ["report", plan, run, f"{table}/comparison.csv", "--scenario", scenario, "--out", str(target)],
    ):
        done = CliRunner().invoke(app, command)
        if done.exit_code != 0:
            raise SystemExit(f"optdock {' '.join(command)}:\n{done.output}")
    return target


def faults_of(page: Page, report: Path) -> Iterator[str]:
    """Open a report, move all sliders, and yield its faults."""
    found: list[str] = []
    page.on("console", lambda message: found.append(message.text) if message.type in ("error", "warning") else None)
    page.on("pageerror", lambda error: found.append(str(error)))
    page.on("request", lambda request: None if request.url.startswith("file:") else found.append(request.url))
    page.goto(report.resolve().as_uri())
    page.wait_for_selector("html[data-drawn]", state="attached")
    for chapter in page.query_selector_all("details:not([open])"):
        chapter.evaluate("chapter => { chapter.open = true; }")
    for _ in range(WAITS):
        page.wait_for_timeout(500)
        undrawn = page.evaluate("[...document.querySelectorAll('.plot, .scene')].filter(one => !one.firstChild).length")
        if not undrawn:
            break
    else:
        found.append("not all figures are drawn")
    for slider in page.query_selector_all("input[type=range]"):
        slider.evaluate(
            f"one => {{ one.value = Math.round({MOVED} * one.max); one.dispatchEvent(new Event('input')); }}"
        )
    page.wait_for_timeout(500)
    wider = page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")
    if wider > 0:
        found.append(f"the content is {wider} px wider than the page")
    yield from (one for one in found if not one.startswith("data:"))


def check(browser: Browser, report: Path, pictures: Path) -> int:
    """Print the faults of a report at all sizes and in all schemes, write a picture of each, and count the faults."""
    count = 0
    for scheme in SCHEMES:
        for size, (width, height) in SIZES.items():
            phone = size == "phone"
            context = browser.new_context(
                viewport={"width": width, "height": height}, color_scheme=scheme, has_touch=phone, is_mobile=phone
            )
            page = context.new_page()
            for fault in faults_of(page, report):
                count += 1
                print(f"{report}: {size}, {scheme}: {fault}")
            page.screenshot(path=str(pictures / f"{report.stem}-{size}-{scheme}.png"), full_page=True, timeout=SLOW)
            context.close()
    return count


def draw_assets(browser: Browser, report: Path) -> None:
    """Write the picture of the first section of a report, light and dark."""
    for scheme in SCHEMES:
        page = browser.new_page(viewport={"width": 1000, "height": 760}, color_scheme=scheme)
        list(faults_of(page, report))
        page.evaluate("window.scrollTo(0, document.querySelector('.player').getBoundingClientRect().top + scrollY)")
        page.wait_for_timeout(300)
        picture = Image.open(io.BytesIO(page.screenshot())).convert("RGB").quantize(128)
        picture.save(ROOT / "docs" / "assets" / f"report-{scheme}.png", optimize=True)
        page.close()


def main() -> None:
    """Check the reports that are given, or a report of the example."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("reports", nargs="*", type=Path)
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "report", help="folder for reports and pictures")
    parser.add_argument("--assets", action="store_true")
    arguments = parser.parse_args()
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        sys.exit(
            "the check needs Playwright: pip install playwright, and Chromium in PATH or playwright install chromium"
        )
    arguments.out.mkdir(parents=True, exist_ok=True)
    reports = arguments.reports or [make_report(arguments.out)]
    found = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=found, args=["--no-sandbox"])
        if arguments.assets:
            draw_assets(browser, reports[0])
        faults = sum(check(browser, report, arguments.out) for report in reports)
    print(f"{len(reports)} reports at {len(SIZES)} sizes in {len(SCHEMES)} schemes: {faults} faults")
    sys.exit(faults > 0)


if __name__ == "__main__":
    main()
