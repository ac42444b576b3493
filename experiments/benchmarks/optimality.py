"""Cost of the smoother relative to its model solved by ipopt: `python -m experiments.benchmarks optimality`."""

from __future__ import annotations

import argparse
import statistics
from typing import TYPE_CHECKING

from experiments.benchmarks.ipopt_reference import smooth_by_ipopt
from experiments.benchmarks.tables import Table
from experiments.families import FEASIBLE_FAMILIES, instance
from optdock.errors import SmootherException
from smoothers.casadi_smoother import CasadiSmoother

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["main"]

_TIME = 60.0  # [s] for each call


def main(arguments: Sequence[str]) -> None:
    """Print the gap of every family over `--seeds` instances each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=2, help="number of instances per family")
    options = parser.parse_args(list(arguments))
    rows = tuple(_row(family, options.seeds) for family in FEASIBLE_FAMILIES)
    note = "cost over ipopt's minus 1, in per cent, for instances that both solve with a certified path"
    print(Table("Cost against ipopt on the same model", ("family", "both", "of", "median %", "worst %"), rows, note))


def _row(family: str, seeds: int) -> tuple[object, ...]:
    gaps = [gap for gap in (_gap(family, seed) for seed in range(seeds)) if gap is not None]
    if not gaps:
        return (family, 0, seeds, "-", "-")
    return (family, len(gaps), seeds, statistics.median(gaps), max(gaps))


def _gap(family: str, seed: int) -> float | None:
    """Return the gap to the reference in per cent; None if one of the two has no certified path."""
    task = instance(family, seed)
    try:
        found = CasadiSmoother().smooth(task.raw_path, _TIME, problem=task.problem)
        reference = smooth_by_ipopt(task.raw_path, _TIME, task.problem)
    except SmootherException:
        return None
    if found.report.cost is None or reference.report.cost is None:
        return None
    return 100.0 * (found.report.cost / reference.report.cost - 1.0)
