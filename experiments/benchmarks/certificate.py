"""CPU time of certificates: `python -m experiments.benchmarks certificate`."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING, NamedTuple

from experiments.benchmarks.tables import Table, Timer, percentile, yardstick
from experiments.families import FEASIBLE_FAMILIES, instance
from experiments.real_maps import SCENARIOS, maps_folder, problem_of
from optdock.errors import OptdockError
from optdock.model.path import Path
from optdock.planning.pipeline import plan_dock
from optdock.plugins.interfaces import Smoother
from optdock.plugins.registry import create_plugin
from optdock.verification import certify_path

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from optdock.model.problem import DockingProblem

__all__ = ["main"]

_TIME = 10.0  # [s] for every plan
_REPEATS = 5  # the fastest run counts


class _Case(NamedTuple):
    group: str
    path: Path
    problem: DockingProblem


def main(arguments: Sequence[str]) -> None:
    """Certify smoothed paths of every family, and of the real maps if available."""
    parser = argparse.ArgumentParser(prog="python -m experiments.benchmarks certificate", description=__doc__)
    parser.add_argument("--seeds", type=int, default=10, help="number of instances per family")
    options = parser.parse_args(list(arguments))
    cases = [*_random_cases(options.seeds), *_map_cases()]
    groups = {case.group: [one for one in cases if one.group == case.group] for case in cases}
    header = ("paths of", "count", "obstacles, most", "path m, longest", "ms p50", "ms worst", "units p50")
    unit = yardstick()
    rows = tuple(_row(group, members, unit) for group, members in groups.items())
    note = f"CPU time of certify_path, fastest of {_REPEATS}. units: over the yardstick's {1e3 * unit:.2f} ms."
    print(Table("Certificates of smoothed paths", header, rows, note))


def _row(group: str, cases: Sequence[_Case], unit: float) -> tuple[object, ...]:
    times = [_fastest(case) for case in cases]
    most = max(len(case.problem.all_obstacles) for case in cases)
    middle = percentile(times, 50.0)
    return (
        group,
        len(cases),
        most,
        max(case.path.length for case in cases),
        1e3 * middle,
        1e3 * max(times),
        middle / unit,
    )


def _fastest(case: _Case) -> float:
    times = []
    for _ in range(_REPEATS):
        path = Path(case.path.segments)  # a new path object, because complete proofs are cached per path
        timer = Timer()
        certify_path(path, case.problem)
        times.append(timer.cpu)
    return min(times)


def _random_cases(seeds: int) -> Iterator[_Case]:
    smoother = create_plugin(Smoother, "CasadiSmoother")
    for family in FEASIBLE_FAMILIES:
        for task in (instance(family, seed) for seed in range(seeds)):
            yield _Case(family, smoother.smooth(task.raw_path, _TIME, problem=task.problem).path, task.problem)


def _map_cases() -> Iterator[_Case]:
    """Return docking scenarios on the maps of `real_maps`."""
    if not maps_folder().is_dir():
        print(f"no maps at {maps_folder()}; set OPTDOCK_DATA", file=sys.stderr)
        return
    for scenario in SCENARIOS:
        problem = problem_of(scenario)
        try:
            yield _Case(f"map {scenario.map_name}", plan_dock(problem, time_budget=_TIME).path, problem)
        except OptdockError as error:
            print(f"{scenario.name}: {error}", file=sys.stderr)
