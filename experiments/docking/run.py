"""Which dockings the study drives, and each of them by its names."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    import argparse

    from experiments.docking.outcome import Outcome

__all__ = ["PLAN", "Task", "driven", "tasks"]

ALL = ("graceful law", "raw + tracker", "smoothed + tracker", "replanning", "MPC")
PLAN = {
    "perfect": ((20.0, 50.0, 100.0), ALL),
    "noisy": ((20.0, 50.0, 100.0), ALL),
    "detected": ((50.0,), ALL),
    "pushed": ((50.0,), ("graceful law", "replanning", "MPC")),
}
"""Rates and methods of every world."""


class Task(NamedTuple):
    """One docking to be driven, by names, so that any process can."""

    method: str
    world: str
    spread: str
    rate: float
    number: int
    seed: int


def driven(task: Task) -> Outcome:
    """The outcome of a task."""
    from experiments.docking.methods import METHODS
    from experiments.docking.worlds import SPREADS, WORLDS, case_of

    world, spread = WORLDS[task.world], SPREADS[task.spread]
    return METHODS[task.method](case_of(task.number, spread, world, task.seed), world, spread.name, task.rate)


def tasks(options: argparse.Namespace) -> list[Task]:
    """Everything that was asked for."""
    found = []
    for world, (rates, methods) in PLAN.items():
        if options.world and world not in options.world:
            continue
        for method in methods:
            if options.method and method not in options.method:
                continue
            for rate in options.rate or rates:
                numbers = range(options.count)
                found += [Task(method, world, options.spread, rate, number, options.seed) for number in numbers]
    return found
