"""Return time of `plan_dock`: lateness of whole calls against their budgets, on an idle and on a loaded machine.

With `--among-walls --cpu-clock --calls 500 --budgets 0.005 0.01 0.02 0.05` every call has a new footprint and budgets
count CPU seconds, so that lateness is caused by the library and not by other processes. Late calls are then measured
again, see `repeated_calls`. `--scenes easy --budgets 0.01` gives the share of easy scenes that are certified in 10 ms.
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import gc
import itertools
import math
import os
import subprocess
import sys
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import shapely

from experiments.benchmarks.kernels import EASY
from experiments.benchmarks.repeated_calls import Repetitions, recorded
from experiments.benchmarks.tables import Table, Timer, fixed_work, percentile, yardstick
from experiments.families import FEASIBLE_FAMILIES, instance
from experiments.manoeuvres.cases import rectangle
from experiments.manoeuvres.hard_cases import bays
from experiments.real_maps import SCENARIOS, maps_folder, problem_of
from optdock.deadline import set_clock
from optdock.errors import OptdockError
from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.costmap import Costmap
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.planning.pipeline import plan_dock, warm_up

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

__all__ = ["Answer", "among_walls", "answered", "main", "open_hall"]

_BUDGETS = (0.01, 0.02, 0.05, 0.1)  # [s]
_LATE = 0.0015  # [s] of CPU time after the budget: a call that takes longer counts as late
_BUSY_LOOP = "while True: pass"


class Answer(NamedTuple):
    """Result of one call: wall-clock and CPU seconds, and `certified`, `timed out` or the name of a refusal."""

    wall: float
    cpu: float
    outcome: str


def main(arguments: Sequence[str]) -> None:
    """Call `plan_dock` with hard budgets on problems of every kind, in turn."""
    parser = argparse.ArgumentParser(prog="python -m experiments.benchmarks deadlines", description=__doc__)
    parser.add_argument("--calls", type=int, default=300, help="number of calls per budget")
    parser.add_argument(
        "--seeds", type=int, default=8, help="number of instances per family, 15 times as many in open halls"
    )
    parser.add_argument(
        "--busy", type=int, default=0, help="number of processes that load the machine, 0 for an idle machine"
    )
    parser.add_argument("--budgets", type=float, nargs="+", default=_BUDGETS, help="budgets [s]")
    parser.add_argument("--cpu-clock", action="store_true", help="count budgets in CPU seconds")
    parser.add_argument(
        "--among-walls", action="store_true", help="only rooms with walls, every call with a new footprint"
    )
    parser.add_argument(
        "--scenes",
        choices=tuple(_SCENES),
        default="mixed",
        help="mixed: open halls, all families and real maps; easy: families with at most five obstacles on an open "
        "floor; clutter: the family of this name; parking: bays between cars (default: %(default)s)",
    )
    options = parser.parse_args(list(arguments))
    if options.cpu_clock:
        set_clock("cpu")
    problems = () if options.among_walls else (*_SCENES[options.scenes](options.seeds),)
    warm_up()
    gc.collect()
    gc.freeze()
    header = ("budget ms", "calls", "certified", "timed out", "refused")
    header = (*header, "late ms p50", "p99", "p99.9", "worst", "late cpu ms worst", "over 1.5 ms", "again")
    header = (*header, "host ms p99", "p99.9", "worst")
    again = Repetitions(answered) if options.among_walls and options.cpu_clock else None
    with _busy(options.busy), contextlib.closing(again) if again else contextlib.nullcontext():
        unit, rows = yardstick(), []
        for k, budget in enumerate(options.budgets):
            fresh = (functools.partial(among_walls, seed) for seed in itertools.count(k * options.calls))
            given = (functools.partial(_same, problem) for problem in itertools.cycle(problems))
            rows.append(_row(given if problems else fresh, budget, options.calls, unit, again))
    note = (
        f"{len(problems) or options.calls} problems in turn, {options.busy} busy processes on {os.cpu_count()} cores. "
        f"late: elapsed minus budget, negative when early. host: after every call plain work of as much CPU time, "
        f"the yardstick's {1e3 * unit:.2f} ms as often as fits, and how much longer than its median it takes. "
        "again: late calls that are also late in the quickest of five repetitions with the same readings of the clock."
    )
    print(Table("Deadlines of whole calls", header, tuple(rows), note))


@contextlib.contextmanager
def _busy(count: int) -> Iterator[None]:
    processes = [subprocess.Popen([sys.executable, "-c", _BUSY_LOOP]) for _ in range(count)]
    try:
        yield
    finally:
        for process in processes:
            process.kill()
            process.wait()


def _same(problem: DockingProblem) -> DockingProblem:
    return problem


def _row(
    makers: Iterator[Callable[[], DockingProblem]], budget: float, calls: int, unit: float, again: Repetitions | None
) -> tuple[object, ...]:
    answers, same, late_again = [], [], 0
    for make in itertools.islice(makers, calls):
        problem = make()
        if again is None:
            answers.append(answered(problem, budget))
        else:
            readings = recorded(lambda problem=problem: answers.append(answered(problem, budget)))
            is_late = answers[-1].cpu > budget + _LATE
            late_again += is_late and again.lateness(make, budget, readings) > _LATE
        times = max(1, round(answers[-1].cpu / unit))
        timer = Timer()
        for _ in range(times):
            fixed_work()
        same.append((times, timer.wall))
    usual = {times: float(np.median([wall for n, wall in same if n == times])) for times, _ in same}
    host = [wall - usual[times] for times, wall in same]
    late = [answer.wall - budget for answer in answers]
    certified = sum(answer.outcome == "certified" for answer in answers)
    timed_out = sum(answer.outcome == "timed out" for answer in answers)
    return (
        1e3 * budget,
        len(answers),
        certified,
        timed_out,
        len(answers) - certified - timed_out,
        *(1e3 * percentile(late, share) for share in (50, 99, 99.9, 100)),
        1e3 * max(answer.cpu - budget for answer in answers),
        sum(answer.cpu > budget + _LATE for answer in answers),
        "-" if again is None else late_again,
        *(1e3 * percentile(host, share) for share in (99, 99.9, 100)),
    )


def answered(problem: DockingProblem, budget: float) -> Answer:
    """Run one call of `plan_dock` with `budget` [s]."""
    timer = Timer()
    try:
        plan_dock(problem, time_budget=budget)
        wall, cpu, outcome = timer.wall, timer.cpu, "certified"
    except OptdockError as error:
        wall, cpu, name = timer.wall, timer.cpu, type(error).__name__
        outcome = "timed out" if name.endswith("TimedOut") else name
    return Answer(wall, cpu, outcome)


def _problems(seeds: int) -> Iterator[DockingProblem]:
    """Return open halls, every family, and the real maps if available, mixed."""
    count = len(FEASIBLE_FAMILIES)
    for seed in range(seeds):
        for k, family in enumerate(FEASIBLE_FAMILIES):
            yield instance(family, seed).problem
            yield open_hall(seed * count + k)
    if maps_folder().is_dir():
        yield from (problem_of(scenario) for scenario in SCENARIOS)
    else:
        print(f"no maps at {maps_folder()}; set OPTDOCK_DATA", file=sys.stderr)


def _of_families(names: Sequence[str], seeds: int) -> Iterator[DockingProblem]:
    yield from (instance(family, seed).problem for seed in range(seeds) for family in names)


_SCENES: dict[str, Callable[[int], Iterator[DockingProblem]]] = {
    "mixed": _problems,
    "easy": functools.partial(_of_families, EASY),
    "clutter": functools.partial(_of_families, ("clutter",)),
    "parking": lambda seeds: (case.problem for case in bays(seeds)),
}


def among_walls(seed: int) -> DockingProblem:
    """Return a problem with a dock at a side of a room of 12 m with three to six inner walls and a random footprint.

    Required are 3 cm, at the dock 0. The start is anywhere, so some problems are infeasible.
    """
    rng = np.random.default_rng((seed, 64))
    footprint = _footprint(rng)
    walls = []
    for _ in range(int(rng.integers(3, 7))):
        middle, turn = rng.uniform((-5.0, -4.0), (4.0, 4.0)), rng.uniform(-math.pi, math.pi)
        walls.append(rectangle(*middle, 2.0 * rng.uniform(0.5, 2.0), 0.1, turn))
    walls.append(rectangle(6.1, 0.0, 0.2, 12.0))
    goal = Pose2(6.0 - footprint.vertices[:, 0].max(), rng.uniform(-4.0, 4.0), 0.0)
    start = Pose2(*rng.uniform((-5.5, -5.5), (3.5, 5.5)), rng.uniform(-math.pi, math.pi))
    limits = MotionLimits(max_curvature=rng.uniform(0.7, 2.5), max_curvature_rate=rng.uniform(2.0, 8.0))
    dock = Dock(goal, final_straight=0.3, approach_speed=0.1, approach_distance=0.3)
    obstacles = ObstacleSet.from_polygons(walls, "wall")
    rule = ClearanceRule(required=0.03, at_dock=0.0, taper=0.5)
    return DockingProblem(start, dock, Robot(footprint, limits), obstacles, clearance=rule)


def _footprint(rng: np.random.Generator) -> Footprint:
    """Return a rectangle (one in eight), otherwise up to 64 corners, a third of them with notches as between forks."""
    length, width = rng.uniform(0.3, 0.8), rng.uniform(0.2, 0.5)  # [m] from the middle to the front and to the side
    if rng.random() < 0.125:
        return Footprint.rectangle(length, length, 2.0 * width)
    angles = np.concatenate((rng.uniform(-math.pi, math.pi, rng.integers(1, 61)), [-2.4, -0.8, 0.8, 2.4]))
    angles = np.sort(angles)
    outline = shapely.Polygon(np.stack((length * np.cos(angles), width * np.sin(angles)), axis=1))
    notches = rng.integers(1, 3) if rng.random() < 1.0 / 3.0 else 0
    for side in (1.0, -1.0)[:notches]:
        near, far = sorted((side * 0.5 * length, side * 2.0 * length))
        outline -= shapely.box(near, -0.3 * width, far, 0.3 * width)
    return Footprint(shapely.get_coordinates(outline)[:-1])


def open_hall(seed: int) -> DockingProblem:
    """Return a random dock in an empty hall of 20 m, a start 1 to 8 m before it, and a robot."""
    rng = np.random.default_rng(seed)
    goal = Pose2(*rng.uniform(-3.0, 3.0, 2), rng.uniform(-math.pi, math.pi))
    distance, side = rng.uniform(1.0, 8.0), rng.choice([-1.0, 1.0])
    start = goal @ Pose2(side * distance, rng.uniform(-0.6, 0.6) * distance, rng.uniform(-1.0, 1.0))
    limits = MotionLimits(
        max_curvature=10.0 ** rng.uniform(-0.3, 0.7),
        max_curvature_rate=10.0 ** rng.uniform(0.3, 1.5),
        max_yaw_rate=1.0,
        max_yaw_acceleration=2.0,
    )
    cells = np.full((400, 400), 254, dtype=np.uint8)
    cells[2:-2, 2:-2] = 0
    dock = Dock(goal, final_straight=0.3, approach_speed=0.1, approach_distance=0.3)
    robot = Robot(Footprint.rectangle(0.4, 0.4, 0.6), limits)
    return DockingProblem(start, dock, robot, costmap=Costmap(cells, 0.05, (-10.0, -10.0)))
