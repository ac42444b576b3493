"""Undocking in the field world: contacts bend where the robot turns before it is out of them."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from experiments.cpu_budgets import count_cpu
from experiments.docking.field.methods import by_executor
from experiments.docking.field.outcome import clearances
from experiments.docking.field.run import set_up
from experiments.docking.field.task import FieldTask
from experiments.docking.field.world import FieldRobot
from experiments.docking.outcome import worst_ratio
from optdock.geometry.pose import Pose2
from optdock.reports.report import table

if TYPE_CHECKING:
    from collections.abc import Sequence

    from experiments.docking.cases import Layout
    from experiments.docking.field.outcome import Steered
    from optdock.geometry.arrays import FloatArray

__all__ = ["Undocking", "asked_in_contact", "turned_in_contact", "undocked_in_field", "undocking_table"]

DOCKED_WITHIN = 0.0025, 0.003, math.radians(0.4)  # along, across [m] and turned: how well a docked robot stands
CONTACT = 0.1  # [m]: so far out of the dock the robot is to drive straight
STRAIGHT = math.radians(0.3)  # what counts as straight


class Undocking(NamedTuple):
    """One undocking.

    Attributes:
        world: In which world.
        rate: Control cycles per second [Hz].
        seed: Of everything in it.
        ending: Its name.
        reason: Of the ending, in a sentence.
        undocked: Whether the executor says that the robot is undocked.
        at_rest: Whether it stands in the end.
        turned: By how much it was turned from where it stood in the first 10 cm, at most [rad].
        asked: By how much its commands were to turn it there; the rest is wheels and slip [rad].
        clearance: Smallest distance to what is not the station [m].
        duration: [s].
        over: Largest ratio of a commanded quantity to its limit.
        limit: Which that is.
    """

    world: str
    rate: float
    seed: int
    ending: str
    reason: str
    undocked: bool
    at_rest: bool
    turned: float
    asked: float
    clearance: float
    duration: float
    over: float
    limit: str


def undocked_in_field(task: FieldTask) -> Undocking:
    """Undock a robot that stands in the dock, as well as dockings end."""
    count_cpu()
    layout, robot = _docked(task)
    by = by_executor(layout, robot, task.rate, task="undock")
    over, limit = worst_ratio(by.commands, np.diff(by.stamps), layout.problem.robot.limits)
    clearance, _ = clearances(layout, robot)
    rows = robot.record()
    turned, asked = turned_in_contact(rows), asked_in_contact(rows, by)
    return Undocking(
        task.world, task.rate, task.seed, by.ending, by.reason, by.docked, robot.drive.at_rest, turned, asked,
        clearance, by.ended, over, limit,
    )  # fmt: skip


def _docked(task: FieldTask) -> tuple[Layout, FieldRobot]:
    """A robot in its dock."""
    layout, before = set_up(task)
    along, across, turned = np.random.default_rng((task.seed, 1)).uniform(-1.0, 1.0, 3) * DOCKED_WITHIN
    start = layout.true_dock @ Pose2(float(along), float(across), float(turned))
    there = layout._replace(problem=dataclasses.replace(layout.problem, start=start))
    return there, FieldRobot(before.world, there, task.seed)


def _out_of_contact(rows: FloatArray) -> int:
    """The first row that is more than 10 cm away from the first one; how many there are where none is."""
    far = np.flatnonzero(np.hypot(*(rows[:, 1:3] - rows[0, 1:3]).T) > CONTACT)
    return int(far[0]) if far.size else len(rows)


def turned_in_contact(rows: FloatArray) -> float:
    """By how much a robot was turned at most until it was 10 cm away from where it began [rad].

    Args:
        rows: Time, x, y and continuous yaw, Shape (n, 4) [s, m, m, rad].
    """
    return float(np.max(np.abs(rows[: _out_of_contact(rows), 3] - rows[0, 3])))


def asked_in_contact(rows: FloatArray, by: Steered) -> float:
    """By how much the commands were to turn it at most until then [rad]."""
    until = rows[min(_out_of_contact(rows), len(rows) - 1), 0]
    given = by.stamps < until
    lasted = np.diff(np.append(by.stamps[given], until))
    return float(np.max(np.abs(np.cumsum(by.commands[given, 1] * lasted)), initial=0.0))


def undocking_table(outcomes: Sequence[Undocking]) -> str:
    """One line per world and rate."""
    head = [
        "world", "Hz", "undocked", "straight", "turned p50 / p95 / max, degrees", "asked for", "collisions",
        "time p50, s", "over limit", "of", "others end",
    ]  # fmt: skip
    groups: dict[tuple[str, float], list[Undocking]] = {}
    for one in outcomes:
        groups.setdefault((one.world, one.rate), []).append(one)
    return table([head, *(_row(key, found) for key, found in groups.items())])


def _row(key: tuple[str, float], found: list[Undocking]) -> list[str]:
    turned, asked = np.degrees([one.turned for one in found]), np.degrees([one.asked for one in found])
    over = max(found, key=lambda one: one.over)
    return [
        key[0],
        f"{key[1]:g}",
        f"{sum(one.undocked and one.at_rest for one in found)}/{len(found)}",
        f"{sum(one.turned <= STRAIGHT for one in found)}",
        _spread(turned),
        _spread(asked),
        f"{sum(one.clearance < 0.0 for one in found)}",
        f"{np.median([one.duration for one in found]):.1f}",
        f"{over.over:.3f}",
        over.limit,
        ", ".join(sorted({one.ending for one in found if not one.undocked})) or "-",
    ]


def _spread(values: FloatArray) -> str:
    return " / ".join(f"{value:.2f}" for value in (*np.percentile(values, [50, 95]), values.max()))
