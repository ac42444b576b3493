"""Time from the pointer to the picture in the browser: `python tests/browser/drag_latency.py`.

Drags the robot of the built-in scenario, 5 m from its dock, at 30 Hz in a Chromium. The picture of a move is the first
paint of the figure whose path begins at the place of the pointer in that move.
"""

import argparse
import math
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.browser.opened_page import OpenedPage, Program, launched, missing

PACE = 1e3 / 30.0  # [ms] between moves
SAME = 3e-3  # [m]


def latencies(page, moves):
    """Drag the robot along a figure of eight; return the time of each picture [ms]."""
    place = page.robot()
    x, y = page.pixel(place)
    scale = page.pixel([place[0] + 1.0, place[1]])[0] - x  # [px/m]
    page.record()
    page.press(place)
    for k in range(moves):
        angle = 2.0 * math.pi * k / 100
        page.page.mouse.move(x + 45.0 * math.sin(angle), y - 27.0 * math.sin(2.0 * angle))
        page.page.wait_for_timeout(PACE)
    page.page.mouse.up()
    page.settle()
    recorded = page.recorded
    events = [(at, [place[0] + (u - x) / scale, place[1] - (v - y) / scale]) for at, u, v in recorded["moves"]]
    found, last = [], None
    for paint in recorded["paints"]:
        if paint["first"] is None or paint["first"] == last:
            continue
        last = paint["first"]
        at = max((at for at, to in events if at <= paint["at"] and math.dist(to, last) < SAME), default=None)
        if at is not None:
            found.append(paint["at"] - at)
    return found


def main():
    """Print percentiles of the latency."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--moves", type=int, default=300)
    arguments = parser.parse_args()
    if missing():
        sys.exit(f"the measurement {missing()}")
    with tempfile.TemporaryDirectory() as folder, launched() as browser:
        (Path(folder) / "own").mkdir()
        program = Program(Path(folder) / "own")
        try:
            page = OpenedPage(browser.new_context(viewport={"width": 1280, "height": 900}), program.url)
            latencies(page, 30)  # warm
            page.page.reload()
            page.settle()
            found = sorted(latencies(page, arguments.moves))
        finally:
            program.end()
    p50, p95 = (found[min(int(share * len(found)), len(found) - 1)] for share in (0.5, 0.95))
    sys.stdout.write(f"{arguments.moves} moves at 30 Hz, {len(found)} pictures\n")
    sys.stdout.write(f"drag to picture: p50 {p50:.0f} ms, p95 {p95:.0f} ms, max {found[-1]:.0f} ms\n")


if __name__ == "__main__":
    main()
