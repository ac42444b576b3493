"""Docking study: the same dockings by every method, in every world, at every control rate.

    python -m experiments.docking                                # 1,000 by the executor, 100 by the others: 30 min
    python -m experiments.docking --count 50 --world detected --method executor
    python -m experiments.docking --faults                       # the table of faults
    python -m experiments.docking --world field --count 40       # the field world, by the executor and by Nav2's law
    python -m experiments.docking --world "field, blind" --method executor --rate 50 --count 40
    python -m experiments.docking --undock --world field --rate 50 --count 40

Writes results/docking/: runs.csv, table.md, cdf.png and a film of the worst executor run; for the field worlds
field.csv, field.md and field.png of the worst executor run.
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
from typing import TYPE_CHECKING, TypeVar

from experiments.docking.field.run import driven_in_field, field_tasks
from experiments.docking.field.worlds import FIELD_WORLDS
from experiments.docking.run import PLAN, driven, tasks
from optdock.deadline import set_clock

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from experiments.docking.field.outcome import FieldOutcome
    from experiments.docking.field.undocking import Undocking
    from experiments.docking.outcome import Outcome
    from experiments.docking.run import Task

OUT = Path("results") / "docking"
Given = TypeVar("Given")
Result = TypeVar("Result")
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study, write and print the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--count", type=int, default=1000, help="number of dockings of each kind by the executor (default: %(default)s)"
    )
    parser.add_argument(
        "--world", action="append", choices=[*sorted(PLAN), *FIELD_WORLDS], help="run only this world; may be repeated"
    )
    parser.add_argument("--method", action="append", help="run only this method; may be repeated")
    parser.add_argument("--rate", action="append", type=float, help="run only this control rate [Hz]; may be repeated")
    parser.add_argument(
        "--spread",
        choices=("nav2", "wider"),
        help="distribution of starts (default: nav2; wider for the executor in the field worlds)",
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2, help="number of processes (default: %(default)s)")
    parser.add_argument("--faults", action="store_true", help="run the table of faults instead")
    parser.add_argument("--undock", action="store_true", help="run undockings in the field worlds instead")
    parser.add_argument("--out", type=Path, default=OUT)
    options = parser.parse_args(arguments)
    for name in THREADS:  # before NumPy is imported, here and in the worker processes
        os.environ.setdefault(name, "1")
    set_clock("cpu")
    options.out.mkdir(parents=True, exist_ok=True)
    if options.faults:
        from experiments.docking.faults import fault_table

        text, is_sound = fault_table(options.jobs)
        (options.out / "faults.md").write_text(text + "\n", encoding="utf-8")
        sys.stdout.write(text + "\n")
        return 0 if is_sound else 1
    in_field = [world for world in options.world or () if world in FIELD_WORLDS]
    if options.undock:
        return undocking_study(options, in_field or ["field"])
    if in_field:
        field_study(options, in_field)
    return study(options) if not options.world or len(in_field) < len(options.world) else 0


def study(options: argparse.Namespace) -> int:
    """Run all tasks. Return 1 if a certificate was violated within the tube."""
    todo = tasks(options)
    found = results_of(driven, todo, options.jobs)
    from experiments.docking import tables

    write_rows(options.out / "runs.csv", found)
    text = tables.table_of(found)
    (options.out / "table.md").write_text(text + "\n", encoding="utf-8")
    sys.stdout.write(text + "\n")
    tables.draw_distributions(options.out / "cdf.png", found)
    replanned = [(abs(one.cross), task) for one, task in zip(found, todo, strict=True) if task.method == "executor"]
    if replanned:
        film(options.out / "worst.gif", max(replanned)[1])
    return 1 if any(outcome.short > tables.FORGIVEN for outcome in found) else 0


def field_study(options: argparse.Namespace, worlds: list[str]) -> None:
    """Run all tasks of the field worlds."""
    from experiments.docking.field.picture import draw_run
    from experiments.docking.field.tables import field_table

    todo = field_tasks(options, worlds)
    found = results_of(driven_in_field, todo, options.jobs)
    write_rows(options.out / "field.csv", found)
    text = field_table(found)
    (options.out / "field.md").write_text(text + "\n", encoding="utf-8")
    sys.stdout.write(text + "\n")
    docked = [(one.falsely_docked, abs(one.cross), task) for one, task in zip(found, todo, strict=True) if one.docked]
    ours = [entry for entry in docked if entry[2].method == "executor"]
    if ours:
        draw_run(options.out / "field.png", max(ours)[2])


def undocking_study(options: argparse.Namespace, worlds: list[str]) -> int:
    """Run undockings by the executor in the field worlds."""
    from experiments.docking.field.undocking import undocked_in_field, undocking_table

    options.method = ["executor"]
    found = results_of(undocked_in_field, field_tasks(options, worlds), options.jobs)
    write_rows(options.out / "undocking.csv", found)
    text = undocking_table(found)
    (options.out / "undocking.md").write_text(text + "\n", encoding="utf-8")
    sys.stdout.write(text + "\n")
    return 0


def results_of(drive: Callable[[Given], Result], todo: Sequence[Given], jobs: int) -> list[Result]:
    """Return the results of the tasks in their order, computed by several processes."""
    found: list[Result] = []
    with ProcessPoolExecutor(jobs, get_context("spawn"), initializer=set_clock, initargs=("cpu",)) as pool:
        for outcome in pool.map(drive, todo, chunksize=8):
            found.append(outcome)
            if len(found) % 100 == 0:
                sys.stderr.write(f"\r{len(found)} of {len(todo)}")
    sys.stderr.write("\n")
    return found


def write_rows(target: Path, found: Sequence[Outcome | FieldOutcome | Undocking]) -> None:
    """Write one CSV row per outcome, with the field names as header."""
    with target.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(type(found[0])._fields)
        writer.writerows(found)


def film(target: Path, task: Task) -> None:
    """Write a film of a docking by the executor."""
    from experiments.docking.cases import SPREADS
    from experiments.docking.methods import executed
    from experiments.docking.worlds import WORLDS, case_of
    from optdock.geometry.pose import Pose2
    from optdock.plotting import save_animation

    world = WORLDS[task.world]
    case = case_of(task.number, SPREADS[task.spread], world, task.seed)
    record = executed(case, world, task.rate).robot.record()
    dock = dataclasses.replace(case.problem.dock, pose=Pose2.from_sequence(record.docks[-1]))
    save_animation(target, dataclasses.replace(case.problem, dock=dock), record.times, record.poses)


if __name__ == "__main__":
    sys.exit(main())
