"""Field study: the tasks, and their execution."""

from __future__ import annotations

from typing import TYPE_CHECKING

from experiments.docking.field.outcome import FieldTask

if TYPE_CHECKING:
    import argparse

    from experiments.docking.cases import Layout
    from experiments.docking.field.outcome import FieldOutcome
    from experiments.docking.field.world import FieldRobot

__all__ = ["DEFAULT_METHODS", "RATES", "driven_in_field", "field_tasks", "set_up"]

RATES = 10.0, 20.0, 50.0, 100.0
DEFAULT_METHODS = "executor", "Nav2's law"
_APART = 1_000_000  # offset between seeds, so that the runs of two seeds differ


def set_up(task: FieldTask) -> tuple[Layout, FieldRobot]:
    """Return the layout, and the robot at its start."""
    import dataclasses

    import numpy as np

    from experiments.docking.cases import ROBOT, SPREADS, layout_of
    from experiments.docking.field.world import FieldRobot
    from experiments.docking.field.worlds import FIELD_WORLDS
    from experiments.docking.outcome import ACCEPTED
    from optdock.geometry.footprint import Footprint
    from optdock.model.dock import DockTolerances

    world = FIELD_WORLDS[task.world]
    robot = dataclasses.replace(ROBOT, footprint=Footprint.rectangle(0.3, 0.3, 0.45))
    layout = layout_of(
        np.random.default_rng(task.seed),
        SPREADS[task.spread],
        world.direction,
        world.moved,
        robot=robot,
        tolerances=DockTolerances(*ACCEPTED),
    )
    return layout, FieldRobot(world, layout, task.seed)


def driven_in_field(task: FieldTask) -> FieldOutcome:
    """Return the outcome of a task."""
    from experiments.docking.field.methods import FIELD_METHODS
    from experiments.docking.field.outcome import field_outcome

    layout, robot = set_up(task)
    steered = FIELD_METHODS[task.method][0](layout, robot, task.rate)
    return field_outcome(task, layout, robot, steered)


def field_tasks(options: argparse.Namespace, worlds: list[str]) -> list[FieldTask]:
    """Return the selected tasks, in the order of the table."""
    from experiments.docking.field.methods import FIELD_METHODS

    return [
        FieldTask(method, world, options.spread or FIELD_METHODS[method][1], rate, _APART * options.seed + number)
        for world in worlds
        for method in options.method or DEFAULT_METHODS
        for rate in options.rate or RATES
        for number in range(options.count)
    ]
