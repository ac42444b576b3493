"""Smoothing benchmark: CasadiSmoother on random instances of every family, compared with Nav2's smoothers.

python -m experiments.benchmarks smoothing --seeds 30
"""

from __future__ import annotations

import argparse
import json
import platform
from pathlib import Path as FilePath
from typing import TYPE_CHECKING

from experiments.benchmarks.smoothing_calls import Call, judged
from experiments.benchmarks.smoothing_tables import (
    Run,
    baseline_table,
    budget_table,
    family_table,
    reasons_table,
    solved,
    warm_table,
)
from experiments.benchmarks.tables import Table, yardstick
from experiments.families import FAMILIES, FEASIBLE_FAMILIES, INFEASIBLE_FAMILIES, instance
from optdock.plugins.interfaces import Smoother, SmoothingReport
from optdock.plugins.registry import create_plugin, load_plugin

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

__all__ = ["main"]

SECTIONS = ("families", "infeasible", "warm", "budgets", "baselines")


def main(arguments: list[str]) -> None:
    """Measure and print; `--help` lists the options."""
    options = _parser().parse_args(arguments)
    unit = yardstick()
    print(f"\n# Smoothing benchmark: {options.seeds} seeds per family, one thread, yardstick {1e3 * unit:.2f} ms CPU")
    tables: list[Table] = []
    for table in _tables(options, unit):
        print(table, flush=True)
        tables.append(table)
    after = yardstick()
    print(f"\nyardstick at the end: {1e3 * after:.2f} ms CPU")
    if options.out is not None:
        machine = {"python": platform.python_version(), "machine": platform.machine(), "yardstick_s": [unit, after]}
        options.out.write_text(json.dumps({**machine, "tables": [table.as_dict() for table in tables]}, indent=1))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m experiments.benchmarks smoothing")
    parser.add_argument("--seeds", type=int, default=30, help="number of instances per family")
    parser.add_argument("--families", type=_families, default=list(FAMILIES), help="comma-separated names")
    parser.add_argument(
        "--sections", type=_sections, default=list(SECTIONS), help=f"comma-separated, from {','.join(SECTIONS)}"
    )
    parser.add_argument("--repeats", type=int, default=3, help="number of calls per instance; the fastest counts")
    parser.add_argument("--calls", type=int, default=2000, help="number of calls with a time budget, over all budgets")
    parser.add_argument("--budgets", type=_milliseconds, default=[5.0, 10.0, 20.0, 50.0], help="budgets [ms]")
    parser.add_argument("--smoother", default="CasadiSmoother", help="plugin to measure")
    parser.add_argument("--out", type=FilePath, default=None, help="JSON file to write")
    return parser


def _choice(text: str, known: Sequence[str]) -> list[str]:
    names = text.split(",")
    unknown = [name for name in names if name not in known]
    if unknown:
        raise argparse.ArgumentTypeError(f"unknown {', '.join(unknown)}; known: {', '.join(known)}")
    return names


def _families(text: str) -> list[str]:
    return _choice(text, list(FAMILIES))


def _sections(text: str) -> list[str]:
    return _choice(text, SECTIONS)


def _milliseconds(text: str) -> list[float]:
    return [float(value) for value in text.split(",")]


def _tables(options: argparse.Namespace, unit: float) -> Iterator[Table]:
    smoother = create_plugin(Smoother, options.smoother)
    feasible = [name for name in options.families if name in FEASIBLE_FAMILIES]
    infeasible = [name for name in options.families if name in INFEASIBLE_FAMILIES]
    runs = solved(smoother, feasible, options.seeds, options.repeats, _stopping_early(options))
    if "families" in options.sections and feasible:
        yield family_table(runs, unit)
    if "infeasible" in options.sections and infeasible:
        yield reasons_table(solved(smoother, infeasible, options.seeds, options.repeats))
    if "warm" in options.sections and feasible:
        yield warm_table(smoother, runs, options.repeats)
    if "budgets" in options.sections and feasible:
        yield budget_table(smoother, runs, [1e-3 * budget for budget in options.budgets], options.calls)
    if "baselines" in options.sections and feasible:
        yield baseline_table(_baselines(options.smoother, runs, feasible, options), unit)


def _stopping_early(options: argparse.Namespace) -> Smoother | None:
    """Return the smoother with early termination at the first certified path, if supported and selected."""
    able = "stop_at_first" in load_plugin(Smoother, options.smoother).Parameters.model_fields
    wanted = able and "families" in options.sections
    return create_plugin(Smoother, options.smoother, {"stop_at_first": True}) if wanted else None


def _baselines(
    name: str, runs: Sequence[Run], feasible: Sequence[str], options: argparse.Namespace
) -> dict[str, Sequence[Run]]:
    others = ("SimpleSmoother", "SavitzkyGolaySmoother")
    as_in_nav2 = {"check_for_collisions": False}
    plain = {other: create_plugin(Smoother, other, as_in_nav2) for other in others}
    measured = {other: solved(plugin, feasible, options.seeds, options.repeats) for other, plugin in plain.items()}
    return {
        "raw": [_untouched(family, seed) for family in feasible for seed in range(options.seeds)],
        **measured,
        name: runs,
    }


def _untouched(family: str, seed: int) -> Run:
    drawn = instance(family, seed)
    call = Call(0.0, 0.0, drawn.raw_path, completed=True, reason="", report=SmoothingReport())
    return Run(drawn, call, judged(drawn.raw_path, drawn.problem))
