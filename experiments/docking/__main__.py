"""The docking study: the same dockings by every method, in every world, at every rate; tables, distributions, a film.

    python -m experiments.docking                                # 1,000 by the executor, 100 by the others: 30 min
    python -m experiments.docking --count 50 --world detected --method executor
    python -m experiments.docking --faults                       # the table of faults

Writes results/docking/: runs.csv, table.md, cdf.png and, of the worst run by the executor, a film.
"""

from __future__ import annotations

import argparse
import csv
import dataclasses
import os
import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING

from experiments.docking.run import PLAN, driven, tasks

if TYPE_CHECKING:
    from collections.abc import Sequence

    from experiments.docking.outcome import Outcome
    from experiments.docking.run import Task

OUT = Path("results") / "docking"
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def main(arguments: Sequence[str] | None = None) -> int:
    """Drive, write, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--count", type=int, default=1000, help="dockings of each kind by the executor (default: %(default)s)"
    )
    parser.add_argument("--world", action="append", choices=sorted(PLAN), help="only this one; may be repeated")
    parser.add_argument("--method", action="append", help="only this one; may be repeated")
    parser.add_argument("--rate", action="append", type=float, help="only this one [Hz]; may be repeated")
    parser.add_argument("--spread", default="nav2", choices=("nav2", "wider"), help="starts (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2, help="processes (default: %(default)s)")
    parser.add_argument("--faults", action="store_true", help="the table of faults instead")
    parser.add_argument("--out", type=Path, default=OUT)
    options = parser.parse_args(arguments)
    for name in THREADS:  # before NumPy is loaded, here and in the processes
        os.environ.setdefault(name, "1")
    options.out.mkdir(parents=True, exist_ok=True)
    if options.faults:
        from experiments.docking.faults import fault_table

        text, is_sound = fault_table(options.jobs)
        (options.out / "faults.md").write_text(text + "\n", encoding="utf-8")
        sys.stdout.write(text + "\n")
        return 0 if is_sound else 1
    return study(options)


def study(options: argparse.Namespace) -> int:
    """All tasks; 1 where a certificate was wrong within the tube."""
    todo = tasks(options)
    found: list[Outcome] = []
    with ProcessPoolExecutor(options.jobs, get_context("spawn")) as pool:
        for outcome in pool.map(driven, todo, chunksize=8):
            found.append(outcome)
            if len(found) % 100 == 0:
                sys.stderr.write(f"\r{len(found)} of {len(todo)}")
    sys.stderr.write("\n")
    from experiments.docking import tables

    with (options.out / "runs.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(type(found[0])._fields)
        writer.writerows(found)
    text = tables.table_of(found)
    (options.out / "table.md").write_text(text + "\n", encoding="utf-8")
    sys.stdout.write(text + "\n")
    tables.draw_distributions(options.out / "cdf.png", found)
    replanned = [(abs(one.cross), task) for one, task in zip(found, todo, strict=True) if task.method == "executor"]
    if replanned:
        film(options.out / "worst.gif", max(replanned)[1])
    return 1 if any(outcome.short > tables.FORGIVEN for outcome in found) else 0


def film(target: Path, task: Task) -> None:
    """A docking by the executor, as the robot drove it."""
    from experiments.docking.methods import executed
    from experiments.docking.worlds import SPREADS, WORLDS, case_of
    from optdock.geometry.pose import Pose2
    from optdock.plotting import save_animation

    world = WORLDS[task.world]
    case = case_of(task.number, SPREADS[task.spread], world, task.seed)
    record = executed(case, world, task.rate).robot.record()
    dock = dataclasses.replace(case.problem.dock, pose=Pose2.from_sequence(record.docks[-1]))
    save_animation(target, dataclasses.replace(case.problem, dock=dock), record.times, record.poses)


if __name__ == "__main__":
    sys.exit(main())
