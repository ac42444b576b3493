"""First call of the smoother in a new process: `python -m experiments.benchmarks first_call`."""

from __future__ import annotations

import argparse
import subprocess
import sys
from typing import TYPE_CHECKING

from experiments.benchmarks.tables import Table, percentile

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["main"]

_PROGRAM = """
import sys, time
from optdock.plugins.interfaces import Smoother
from optdock.plugins.registry import create_plugin
from experiments.families import instance
case, smoother = instance(sys.argv[1], 0), create_plugin(Smoother, "CasadiSmoother")
times = []
for _ in range(4):
    began = time.perf_counter()
    smoother.smooth(case.raw_path, 5.0, problem=case.problem)
    times.append(time.perf_counter() - began)
print(times[0], min(times[1:]))
"""
_FAMILIES = ("open_s", "alcove", "parallel", "clutter", "long_approach")


def main(arguments: Sequence[str]) -> None:
    """Start `--processes` processes per family, each with one first call and three further calls."""
    parser = argparse.ArgumentParser(prog="python -m experiments.benchmarks first_call", description=__doc__)
    parser.add_argument("--processes", type=int, default=5, help="number of processes per family")
    parser.add_argument("--families", default=",".join(_FAMILIES), help="comma-separated names")
    options = parser.parse_args(list(arguments))
    header = ("family", "processes", "first ms p50", "first ms worst", "later ms p50")
    rows = tuple(_row(family, options.processes) for family in options.families.split(","))
    note = "wall clock, after the imports and without `warm_up`; for comparison a later call of the same process"
    print(Table("First call in a fresh process", header, rows, note))


def _row(family: str, processes: int) -> tuple[object, ...]:
    first, later = zip(*(_measured(family) for _ in range(processes)), strict=True)
    return family, processes, 1e3 * percentile(first, 50.0), 1e3 * max(first), 1e3 * percentile(later, 50.0)


def _measured(family: str) -> tuple[float, float]:
    done = subprocess.run([sys.executable, "-c", _PROGRAM, family], capture_output=True, text=True, check=True)
    first, later = (float(word) for word in done.stdout.split())
    return first, later
