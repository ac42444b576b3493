"""CPU time of a term, as a share of a call without terms: `python -m experiments.benchmarks terms`.

Every raw path is smoothed without terms and with each set of terms in turn, several times, and the fastest run of each
counts. Most terms here do not change the path, so that the difference is the time of the terms.
"""

from __future__ import annotations

import argparse
import gc
from typing import TYPE_CHECKING

import casadi
import numpy as np

from experiments.benchmarks.tables import Table, Timer, percentile
from experiments.families import FEASIBLE_FAMILIES, instance
from optdock.deadline import budget_clock
from optdock.errors import OptdockError
from smoothers import CasadiSmoother, HardTerm, SoftTerm

if TYPE_CHECKING:
    from collections.abc import Sequence

    from experiments.families import Instance
    from optdock.geometry.arrays import FloatArray
    from smoothers.terms import PathTerm

__all__ = ["main"]

_TIME = 30.0  # [s] of CPU time for a call
_PLANE = HardTerm("plane", lambda p: p.far - p.y, far=100.0)
_BEND = HardTerm("bend", lambda p: p.most - casadi.fabs(p.curvature), most=10.0)
_DISC = HardTerm("disc", lambda p: casadi.sqrt((p.x - p.at) ** 2 + p.y**2) - 3.0, at=100.0)
_FLOOR = SoftTerm("floor", lambda p: casadi.fmax(0, p.y - p.far), far=100.0)
_WAVE = SoftTerm("wave", lambda p: casadi.sin(3.0 * p.x), weight=0.001)
_SETS: dict[str, tuple[PathTerm, ...]] = {
    "hard: plane": (_PLANE,),
    "hard: curvature": (_BEND,),
    "hard: disc": (_DISC,),
    "soft: floor": (_FLOOR,),
    "soft: wave": (_WAVE,),
    "three hard, two soft": (_PLANE, _BEND, _DISC, _FLOOR, _WAVE),
}


def main(arguments: Sequence[str]) -> None:
    """Time calls without and with terms."""
    parser = argparse.ArgumentParser(prog="python -m experiments.benchmarks terms", description=__doc__)
    parser.add_argument("--repeats", type=int, default=5, help="runs of every call (default: %(default)s)")
    parser.add_argument("--seeds", type=int, default=3, help="instances per family (default: %(default)s)")
    parser.add_argument("--families", default=",".join(FEASIBLE_FAMILIES), help="comma-separated (default: all)")
    options = parser.parse_args(list(arguments))
    smoothers = [CasadiSmoother(), *(CasadiSmoother(terms=terms) for terms in _SETS.values())]
    smoothers[0].warm_up()
    gc.collect()
    gc.freeze()
    cases = [instance(family, seed) for family in options.families.split(",") for seed in range(options.seeds)]
    with budget_clock("cpu"):
        measured = [_seconds(case, smoothers, options.repeats) for case in cases]
    times = np.array([row for row in measured if row is not None])
    rows = [_row("none", times[:, 0], times[:, 0])]
    rows += [_row(name, times[:, k], times[:, 0]) for k, name in enumerate(_SETS, 1)]
    header = ("terms", "calls", "ms p50", "p99", "ratio p50", "p90")
    print(Table("Time of terms", header, tuple(rows), "CPU time, in turn, fastest run; ratio to the call without."))


def _seconds(case: Instance, smoothers: list[CasadiSmoother], repeats: int) -> list[float] | None:
    """Return the fastest time of each smoother [s]; None if the path cannot be smoothed."""
    fastest = [np.inf] * len(smoothers)
    for _ in range(repeats):
        for k, smoother in enumerate(smoothers):
            timer = Timer()
            try:
                smoother.smooth(case.raw_path, _TIME, problem=case.problem)
            except OptdockError:
                return None
            fastest[k] = min(fastest[k], timer.cpu)
    return fastest


def _row(name: str, seconds: FloatArray, without: FloatArray) -> tuple[object, ...]:
    ratios = (seconds / without).tolist()
    milliseconds = (1e3 * seconds).tolist()
    found = [percentile(milliseconds, share) for share in (50.0, 99.0)]
    return (name, len(ratios), *found, *(percentile(ratios, share) for share in (50.0, 90.0)))
