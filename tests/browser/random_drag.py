"""Random edits in one page of a browser: `python tests/browser/random_drag.py --minutes 10`.

Drags, turns, adds and removes parts, changes fields and undoes, and counts exceptions of page, console and program,
pictures whose path does not begin at the start of the scene they belong to, and the memory after the first minute and
at the end. The exit status is 1 if there was an exception or a wrong picture.
"""

import argparse
import math
import random
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.browser.opened_page import OpenedPage, Program, launched, missing

WARM = 60.0  # [s] until the first measurement of memory


def resident(pid):
    """Return the resident memory of a process [MB]; 0 if it has ended."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    except OSError:
        return 0.0
    return next((int(line.split()[1]) / 1024 for line in lines if line.startswith("VmRSS")), 0.0)


def children_of(pid):
    found = Path(f"/proc/{pid}/task").glob("*/children")
    return [int(child) for listed in found for child in listed.read_text().split()]


class RandomHand:
    """Random edits of a page.

    Args:
        page: The page.
        seed: Seed of the random numbers.
    """

    def __init__(self, page, seed):
        self.page, self.random = page, random.Random(seed)
        self.starts, self.wrong, self.pictures = {}, 0, 0
        self.actions = [self.drag_part] * 6 + [
            self.drag_far,
            self.undo,
            self.undo,
            self.add,
            self.remove,
            self.field,
            self.key,
        ]

    def act(self):
        self.random.choice(self.actions)()
        self.check()

    def check(self):
        """Count the pictures since the last call of which the path begins elsewhere."""
        recorded = self.page.page.evaluate("() => recorded.paints.splice(0)")
        self.page.page.evaluate("() => { recorded.moves.length = 0; }")
        for paint in recorded:
            self.starts[paint["scene"]] = paint["robot"]
        for paint in recorded:
            start = self.starts.get(paint["shown"])
            if start is None or paint["first"] is None:
                continue
            self.pictures += 1
            self.wrong += math.dist(start, paint["first"]) > 2e-3

    def drag_part(self, reach=0.4):
        grips = self.page.data("grips")
        points = [*zip(grips["x"], grips["y"], strict=True), self.page.robot(), self.page.robot("dock")]
        self.drag(self.random.choice(points), reach)

    def drag_far(self):
        self.drag(self.page.robot(), 2.0)

    def drag(self, place, reach):
        self.page.press(place)
        x, y = self.page.pixel(place)
        for _ in range(self.random.randint(1, 12)):
            x += self.random.uniform(-60.0, 60.0) * reach
            y += self.random.uniform(-60.0, 60.0) * reach
            self.page.page.mouse.move(x, y)
            self.page.page.wait_for_timeout(33)
        self.page.page.mouse.up()

    def undo(self):
        self.page.click("Undo")

    def add(self):
        self.page.click(self.random.choice(["Add box", "Add wall"]))

    def remove(self):
        self.page.click("Remove")

    def field(self):
        self.page.enter("clearance [m]", self.random.choice(["0.0", "0.02", "0.05", "nonsense", "0.1"]))

    def key(self):
        self.page.page.focus("#figure")
        self.page.page.keyboard.press(self.random.choice(["ArrowLeft", "ArrowUp", "q", "e", "z", "Delete", "Escape"]))


def memory(page, program):
    """Return the memory of program, planning processes and JavaScript heap [MB]."""
    session = page.page.context.new_cdp_session(page.page)
    session.send("HeapProfiler.collectGarbage")
    heap = session.send("Runtime.getHeapUsage")["usedSize"] / 2**20
    session.detach()
    planning = sum(resident(child) for child in children_of(program.process.pid))
    return {"program": resident(program.process.pid), "planning": planning, "browser heap": heap}


def main():
    """Run the random edits and print the counts."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    if missing():
        sys.exit(f"the test {missing()}")
    with tempfile.TemporaryDirectory() as folder, launched() as browser:
        (Path(folder) / "own").mkdir()
        program = Program(Path(folder) / "own")
        try:
            page = OpenedPage(browser.new_context(viewport={"width": 1280, "height": 900}), program.url)
            page.record()
            hand, begun, actions, first = RandomHand(page, arguments.seed), time.monotonic(), 0, {}
            while time.monotonic() - begun < 60.0 * arguments.minutes:
                hand.act()
                actions += 1
                if not first and time.monotonic() - begun > WARM:
                    first = memory(page, program)
            page.settle()
            hand.check()
            last = memory(page, program)
        finally:
            program.end()
        tracebacks = program.log.read_text().count("Traceback")
    sys.stdout.write(f"{arguments.minutes:g} minutes, {actions} actions, {hand.pictures} pictures checked\n")
    sys.stdout.write(
        f"wrong pictures {hand.wrong}, errors of the page {len(page.errors)}, of the program {tracebacks}\n"
    )
    for name, end in last.items():
        sys.stdout.write(f"{name}: {first.get(name, math.nan):.1f} MB after {WARM:.0f} s, {end:.1f} MB at the end\n")
    for error in page.errors[:10]:
        sys.stdout.write(f"{error[:300]}\n")
    sys.exit(bool(hand.wrong or page.errors or tracebacks))


if __name__ == "__main__":
    main()
