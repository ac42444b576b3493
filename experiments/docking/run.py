"""Tasks of the docking study, and their execution."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    import argparse

    from experiments.docking.outcome import Outcome

__all__ = ["PLAN", "Task", "driven", "tasks"]

_USUAL, _ALL = (50.0,), (20.0, 50.0, 100.0)
_OTHERS = {
    "graceful law": (_USUAL, 0.1),
    "raw path, tracker": (_USUAL, 0.1),
    "smoothed path, tracker": (_USUAL, 0.1),
}
_WITH_MPC = {"executor with the MPC": (_USUAL, 0.1)}
PLAN: dict[str, dict[str, tuple[tuple[float, ...], float]]] = {
    "perfect": {"executor": (_ALL, 1.0)},
    "noisy": {"executor": (_ALL, 1.0), **_OTHERS, **_WITH_MPC},
    "detected": {**_OTHERS, "executor": (_USUAL, 1.0), **_WITH_MPC},
    "pushed": {"executor": (_USUAL, 0.3)},
}
"""Methods of every world, each with its rates [Hz] and its share of the dockings."""


class Task(NamedTuple):
    """One docking of the study, given by names so that any process can run it."""

    method: str
    world: str
    spread: str
    rate: float
    number: int
    seed: int


def driven(task: Task) -> Outcome:
    """Return the outcome of a task."""
    from experiments.docking.cases import SPREADS
    from experiments.docking.methods import METHODS
    from experiments.docking.worlds import WORLDS, case_of

    world, spread = WORLDS[task.world], SPREADS[task.spread]
    return METHODS[task.method](case_of(task.number, spread, world, task.seed), world, spread.name, task.rate)


def tasks(options: argparse.Namespace) -> list[Task]:
    """Return the selected tasks."""
    found = []
    for world, methods in PLAN.items():
        if options.world and world not in options.world:
            continue
        for method, (rates, share) in methods.items():
            if options.method and method not in options.method:
                continue
            for rate in options.rate or rates:
                numbers = range(max(1, round(share * options.count)))
                found += [
                    Task(method, world, options.spread or "nav2", rate, number, options.seed) for number in numbers
                ]
    return found
