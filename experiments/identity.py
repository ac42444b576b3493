"""Record plans and dockings of this state of the tree, and compare two recordings bit by bit.

    python -m experiments.identity record results/identity/before.json --every 4
    python -m experiments.identity compare results/identity/before.json results/identity/after.json

A refactoring must not change a plan. Recordings use the counted clock, so that time budgets end at the same place on
every machine; the numbers of a plan are stored as digests of their bits. Texts of errors and endings may be reworded:
they are compared too, so read the differences.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from optdock.model.problem import DockingProblem

__all__ = ["main"]

HARD = ("rack_halls", "maze", "wrong_way", "along_a_wall", "contact", "bays", "forklifts", "blocked_straight")


def problems(every: int) -> Iterator[tuple[str, DockingProblem]]:
    """Yield problems by name: of each family one in `every`."""
    from experiments import families
    from experiments.manoeuvres import cases, hard_cases

    for family in families.FAMILIES:
        for seed in range(0, 8, every):
            yield f"{family} {seed}", families.instance(family, seed).problem
    made = {name: getattr(hard_cases, name) for name in HARD}
    for name, make in {"near_dock": cases.near_dock, "blocked": cases.blocked, **made}.items():
        for case in make()[:: 8 * every]:
            yield f"{name}: {case.name}", case.problem


def plan_of(problem: DockingProblem) -> list[object]:
    """Return the digests of a plan, or the class and code of the error."""
    import numpy as np

    from optdock.errors import OptdockError
    from optdock.geometry.arrays import digest
    from optdock.planning.pipeline import plan_dock

    try:
        plan = plan_dock(problem, time_budget=1.0)
    except OptdockError as error:
        return ["refused", type(error).__name__, error.code]
    poses = plan.path.poses_at(np.linspace(0.0, plan.path.length, 201))
    law = plan.trajectory.time_law
    return ["certified", digest(poses), digest(law.durations, law.states), repr(plan.certificate.min_clearance)]


def dockings(every: int) -> Iterator[tuple[str, Callable[[], object]]]:
    """Yield dockings of the studies by name, each as a call."""
    from experiments.docking.field.outcome import FieldTask
    from experiments.docking.field.run import driven_in_field
    from experiments.docking.field.worlds import FIELD_WORLDS
    from experiments.docking.run import PLAN, Task, driven

    for world in PLAN:
        for number in range(0, 4, every):
            yield f"{world} {number}", lambda w=world, n=number: driven(Task("executor", w, "nav2", 50.0, n, 5))
    for world in list(FIELD_WORLDS)[::every]:
        yield world, lambda w=world: driven_in_field(FieldTask("executor", w, "wider", 50.0, 7_000_000))


def record(out: Path, every: int) -> None:
    """Write a recording."""
    from optdock.deadline import set_clock

    found: dict[str, object] = {}
    for name, problem in problems(every):
        set_clock("counted")
        found[f"plan, {name}"] = plan_of(problem)
    for name, docking in dockings(every):
        set_clock("counted")
        found[f"docking, {name}"] = [repr(value) for value in docking()]  # type: ignore[attr-defined]
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(json.dumps(found, indent=0), encoding="utf-8")
    print(f"{len(found)} recorded")


def compare(before: Path, after: Path) -> int:
    """Print what differs; return 1 if anything does."""
    first, second = (json.loads(file.read_text(encoding="utf-8")) for file in (before, after))
    names = [name for name in first if name in second]
    different = [name for name in names if first[name] != second[name]]
    print(f"{len(names)} compared, {len(different)} differ, {len(first.keys() ^ second.keys())} in one only")
    for name in different:
        changes = [f"{a} -> {b}" for a, b in zip(first[name], second[name], strict=False) if a != b]
        print(f"{name}: {'; '.join(changes) or 'another number of values'}")
    return int(bool(different))


def main(arguments: Sequence[str] | None = None) -> int:
    """Record or compare."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    recording = commands.add_parser("record")
    recording.add_argument("out", type=Path)
    recording.add_argument("--every", type=int, default=1, help="one problem in so many (default: %(default)s)")
    comparing = commands.add_parser("compare")
    comparing.add_argument("before", type=Path)
    comparing.add_argument("after", type=Path)
    options = parser.parse_args(arguments)
    if options.command == "compare":
        return compare(options.before, options.after)
    record(options.out, options.every)
    return 0


if __name__ == "__main__":
    sys.exit(main())
