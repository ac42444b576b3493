"""Random edits in one page of a browser: `python tests/browser/random_drag.py --minutes 10`.

Drags, turns, adds and removes parts, changes fields and undoes, and counts exceptions of page, console and program,
wrong pictures, and the memory after the first minute and at the end. The program writes every scene with its
fingerprint; a picture is wrong if start, dock and obstacles are not those of the scene of its first fingerprint, or if
its answer does not fit the scene of its second one: a path must lead from the start to the dock, a certified one
without touching an obstacle. The exit status is 1 if there was an exception or a wrong picture.
"""

import argparse
import itertools
import json
import math
import random
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import shapely

from tests.browser.opened_page import OpenedPage, Program, launched, missing

WARM = 60.0  # [s] until the first measurement of memory
SAME = 2e-3  # [m]
OVERLAP = 1e-6  # [m²] of the outline of the robot with an obstacle, from the rounding of the picture
# Writes every scene of which the fingerprint is asked.
WRITING = """
import functools, json
from optdock.geometry.pose import transform_points
from optdock.ui.scene_edits import EditedScene
digest_of = EditedScene.fingerprint.func
def fingerprint(scene):
    found, problem = digest_of(scene), scene.problem
    station, dock = problem.dock.footprint, problem.goal.as_array()
    with open({file!r}, "a") as file:
        file.write(json.dumps([found, {{
            "start": list(problem.start.as_array()), "dock": list(dock),
            "obstacles": [one.tolist() for one in scene.polygons],
            "station": [] if station is None else transform_points(dock[None], station.vertices)[0].tolist(),
        }}]) + chr(10))
    return found
EditedScene.fingerprint = functools.cached_property(fingerprint)
EditedScene.fingerprint.__set_name__(EditedScene, "fingerprint")
"""


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


class Pictures:
    """Checks of recorded pictures against the scenes that the program has written.

    Args:
        file: File of the scenes.
    """

    def __init__(self, file):
        self.file, self.scenes, self.read, self.wrong = file, {}, 0, []
        self.count = dict.fromkeys(("certified", "another path", "no path", "no answer"), 0)

    def check(self, paints):
        """Count pictures, and note the wrong ones."""
        with self.file.open() as file:
            file.seek(self.read)
            for line in file.read().splitlines():
                fingerprint, scene = json.loads(line)
                self.scenes[fingerprint] = scene
            self.read = file.tell()
        for paint in paints:
            fault = self.fault_of_scene(paint) or self.fault_of_answer(paint)
            if fault:
                self.wrong.append(f"{paint['scene'][:8]} {paint['shown'][:8]} {paint['outcome']}: {fault}")

    def fault_of_scene(self, paint):
        scene = self.scenes[paint["scene"]]
        drawn = [paint["robot"], paint["dock"], *itertools.chain(*paint["obstacles"])]
        given = [scene["start"][:2], scene["dock"][:2], *itertools.chain(*scene["obstacles"])]
        same = len(drawn) == len(given) and all(map(is_near, drawn, given))
        return "" if same else "start, dock or obstacles of another scene"

    def fault_of_answer(self, paint):
        kind = paint["outcome"] if paint["outcome"] == "certified" else "another path" if paint["first"] else "no path"
        self.count[kind if paint["shown"] else "no answer"] += 1
        if not paint["shown"]:
            return ""
        scene, is_certified = self.scenes[paint["shown"]], kind == "certified"
        if paint["first"] is not None and not is_near(paint["first"], scene["start"][:2]):
            return "the path does not begin at the start"
        if is_certified and not is_near(paint["last"] or [math.inf, 0.0], scene["dock"][:2]):
            return "the path does not end at the dock"
        if not is_certified:
            return ""
        swept = shapely.polygons(paint["swept"])
        bodies = [shapely.Polygon(one) for one in [*scene["obstacles"], scene["station"]] if one]
        overlap = max((shapely.area(shapely.intersection(swept, body)).max() for body in bodies), default=0.0)
        return f"the robot overlaps an obstacle by {overlap:.1g} m²" if overlap > OVERLAP else ""


def is_near(place, other):
    return math.dist(place, other) < SAME


class RandomHand:
    """Random edits of a page.

    Args:
        page: The page.
        pictures: The checks.
        seed: Seed of the random numbers.
    """

    def __init__(self, page, pictures, seed):
        self.page, self.pictures, self.random, self.failures = page, pictures, random.Random(seed), 0
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
        """Edit the scene; load a worked scene after five edits in a row that left no plan."""
        if self.failures == 5:
            self.page.choose("scene", "")
            self.page.choose("scene", self.random.choice(["reverse_bay", "forklift"]))
        else:
            self.random.choice(self.actions)()
        if self.random.random() < 0.3:
            self.page.settle()
        self.failures = 0 if self.page.outcome == "certified" or self.failures == 5 else self.failures + 1
        self.check()

    def check(self):
        """Check the pictures since the last call."""
        self.pictures.check(self.page.page.evaluate("() => (recorded.moves.length = 0, recorded.paints.splice(0))"))

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
        own, scenes = Path(folder) / "own", Path(folder) / "scenes"
        own.mkdir()
        program = Program(own, prepared=WRITING.format(file=str(scenes)))
        try:
            page = OpenedPage(browser.new_context(viewport={"width": 1280, "height": 900}), program.url)
            page.record()
            pictures = Pictures(scenes)
            hand, begun, actions, first = RandomHand(page, pictures, arguments.seed), time.monotonic(), 0, {}
            while time.monotonic() - begun < 60.0 * arguments.minutes:
                hand.act()
                actions += 1
                if not first and time.monotonic() - begun > WARM:
                    first = memory(page, program)
            page.settle()
            hand.check()
            last, errors = memory(page, program), [*page.errors]  # before it loses the connection
        finally:
            program.end()
        tracebacks = program.log.read_text().count("Traceback")
    counted = ", ".join(f"{kind} {count}" for kind, count in pictures.count.items())
    sys.stdout.write(f"{arguments.minutes:g} minutes, {actions} actions, pictures checked: {counted}\n")
    sys.stdout.write(
        f"wrong pictures {len(pictures.wrong)}, errors of the page {len(errors)}, of the program {tracebacks}\n"
    )
    for name, end in last.items():
        sys.stdout.write(f"{name}: {first.get(name, math.nan):.1f} MB after {WARM:.0f} s, {end:.1f} MB at the end\n")
    for error in [*errors[:10], *pictures.wrong[:10]]:
        sys.stdout.write(f"{error[:300]}\n")
    sys.exit(bool(pictures.wrong or errors or tracebacks))


if __name__ == "__main__":
    main()
