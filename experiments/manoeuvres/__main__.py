"""Manoeuvre benchmark: `plan_dock` on the cases of `cases` and `hard_cases`, one thread, fixed settings.

    python -m experiments.manoeuvres                                   # every family
    python -m experiments.manoeuvres --family obca --family "dock starts" --every 20
    python -m experiments.manoeuvres --budget 0.25 --figures
    python -m experiments.manoeuvres budgets --every 20                # 50 to 1000 ms on the same cases

Writes results/manoeuvres/cases.csv (or budgets.csv), versions.json and, with --figures, a picture per case.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from optdock.deadline import set_clock

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from experiments.manoeuvres.cases import Case
    from experiments.manoeuvres.run import Record
    from optdock.deadline import ClockName

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
STEPS = (0.05, 0.1, 0.25, 0.5, 1.0)  # [s], budgets of the budget experiment
FAMILIES = (
    *("tpcap", "obca", "dock starts", "open hall", "near dock", "blocked"),
    *("rack halls", "maze", "wrong way", "along a wall", "contact", "bays", "buildings", "forklifts"),
    *("blocked straight", "open straight", "barely open"),
)


def families(seed: int) -> dict[str, Callable[[], list[Case]]]:
    """Return the constructor of each family."""
    from experiments.manoeuvres import cases, hard_cases

    return {
        "tpcap": cases.tpcap,
        "obca": cases.obca,
        "dock starts": lambda: cases.dock_starts(seed=seed),
        "open hall": lambda: [case for length in cases.LENGTHS for case in cases.open_hall(length, seed=seed)],
        "near dock": cases.near_dock,
        "blocked": lambda: cases.blocked(seed=seed),
        "rack halls": lambda: hard_cases.rack_halls(seed=seed),
        "maze": lambda: hard_cases.maze(seed=seed),
        "wrong way": lambda: hard_cases.wrong_way(seed=seed),
        "along a wall": lambda: hard_cases.along_a_wall(seed=seed),
        "contact": lambda: hard_cases.contact(seed=seed),
        "bays": lambda: hard_cases.bays(seed=seed),
        "buildings": lambda: hard_cases.buildings(seed=seed),
        "forklifts": lambda: hard_cases.forklifts(seed=seed),
        "blocked straight": lambda: hard_cases.blocked_straight(seed=seed),
        "open straight": lambda: hard_cases.open_straight(seed=seed),
        "barely open": lambda: hard_cases.barely_open(seed=seed),
    }


def chosen(options: argparse.Namespace) -> list[Case]:
    """Return the selected cases: a random subset of each family, because tags repeat periodically within a family."""
    import numpy as np

    makers, found = families(options.seed), []
    for name in options.family or FAMILIES:
        made = [case for case in _made(name, makers[name]) if options.only in case.name]
        some = np.random.default_rng(options.seed).permutation(len(made))[: -(-len(made) // options.every)]
        found += [made[i] for i in sorted(some.tolist())]
    return found


def _made(name: str, make: Callable[[], list[Case]]) -> list[Case]:
    """Return the cases of a family; none, with a message on stderr, if its files are missing."""
    from optdock.errors import InvalidFile

    try:
        return make()
    except InvalidFile as error:
        print(f"{name}: left out, {str(error).splitlines()[0]}; set OPTDOCK_DATA", file=sys.stderr)
        return []


def measured(options: argparse.Namespace, cases: Sequence[Case], budget: float | None) -> list[Record]:
    """Return all records; print progress on stderr."""
    from experiments.manoeuvres.run import run_cases

    records = []
    figures = options.out / "figures" if options.figures else None
    for record in run_cases(cases, budget, figures, options.jobs):
        records.append(record)
        if len(records) % 50 == 0:
            print(f"{len(records)} of {len(cases)}: {record.family}", file=sys.stderr, flush=True)
    return records


def cases_command(options: argparse.Namespace) -> list[Record]:
    """Run every case once."""
    from experiments.manoeuvres.tables import report

    records = measured(options, chosen(options), options.budget)
    if records:
        print("\n".join(report(records)))
    return records


def budgets_command(options: argparse.Namespace) -> list[Record]:
    """Run the same cases with each of the budgets."""
    from experiments.manoeuvres.tables import budget_table

    cases = chosen(options)
    by_budget = {budget: measured(options, cases, budget) for budget in STEPS}
    if cases:
        print(budget_table(by_budget))
    return [one for records in by_budget.values() for one in records]


def parser() -> argparse.ArgumentParser:
    """Return the argument parser."""
    made = argparse.ArgumentParser(
        prog="python -m experiments.manoeuvres",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    made.add_argument("command", nargs="?", default="cases", choices=("cases", "budgets"))
    made.add_argument(
        "--family", action="append", choices=FAMILIES, help="family to run; may be repeated; default: all"
    )
    made.add_argument("--only", default="", help="run only the cases whose name contains this text")
    made.add_argument("--every", type=int, default=1, help="run one of N cases, drawn by the seed")
    made.add_argument("--budget", type=float, help="time budget [s]; default: that of each family")
    made.add_argument("--seed", type=int, default=11, help="seed of the drawn families (default: %(default)s)")
    made.add_argument("--jobs", type=int, default=1, help="number of processes; times are comparable only with one")
    made.add_argument("--cpu-clock", action="store_true", help="count budgets in CPU seconds, for a loaded machine")
    made.add_argument("--figures", action="store_true", help="draw a picture of every case")
    made.add_argument(
        "--out", type=Path, default=Path("results/manoeuvres"), help="output directory (default: %(default)s)"
    )
    return made


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; exit status 1 if the independent check refuted a plan."""
    options = parser().parse_args(arguments)
    os.environ.update(dict.fromkeys(THREADS, "1"))  # numpy reads them only when it is imported
    clock: ClockName = "cpu" if options.cpu_clock else "wall"
    set_clock(clock)
    from experiments.manoeuvres.run import csv_text, versions
    from optdock.io.atomic_file import write_text

    ran = {**versions(), "seed": str(options.seed), "command": options.command, "clock": clock}
    print(", ".join(f"{name} {value}" for name, value in ran.items()))
    write_text(options.out / "versions.json", json.dumps(ran, indent=1) + "\n")
    records = {"cases": cases_command, "budgets": budgets_command}[options.command](options)
    write_text(options.out / f"{options.command}.csv", csv_text(records))
    return 1 if any(one.faults for one in records) else 0


if __name__ == "__main__":
    sys.exit(main())
