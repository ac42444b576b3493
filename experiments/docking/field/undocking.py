"""Undocking in the field world: a robot that turns before it has left the contacts bends them."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from experiments.docking.field.methods import by_executor
from experiments.docking.field.outcome import FieldTask, clearances
from experiments.docking.field.run import set_up
from experiments.docking.field.world import FieldRobot
from experiments.docking.outcome import worst_ratio
from optdock.geometry.pose import Pose2
from optdock.reports.report import table

if TYPE_CHECKING:
    from collections.abc import Sequence

    from experiments.docking.cases import Layout
    from experiments.docking.field.outcome import SteeringResult
    from optdock.geometry.arrays import FloatArray

__all__ = ["Undocking", "commanded_in_contact", "turned_in_contact", "undocked_in_field", "undocking_table"]

DOCKED_WITHIN = 0.0025, 0.003, math.radians(0.4)  # initial error of a docked robot: along, across [m] and in yaw
CONTACT = 0.1  # [m]: distance out of the dock over which the robot must drive straight
STRAIGHT = math.radians(0.3)  # tolerance of straight motion


class Undocking(NamedTuple):
    """Result of one undocking.

    Attributes:
        world: Name of the world.
        rate: Control cycles per second [Hz].
        seed: Seed of all random numbers.
        ending: Name of the ending.
        reason: Reason of the ending, in a sentence.
        undocked: Whether the executor reports that the robot is undocked.
        at_rest: Whether the robot stands at the end.
        turned: Largest rotation from the initial heading in the first 10 cm [rad].
        commanded: Largest rotation that the commands imply there; the difference is due to wheels and slip [rad].
        clearance: Smallest distance to obstacles other than the station [m].
        duration: [s].
        over: Largest ratio of a commanded quantity to its limit.
        limit: Name of that limit.
    """

    world: str
    rate: float
    seed: int
    ending: str
    reason: str
    undocked: bool
    at_rest: bool
    turned: float
    commanded: float
    clearance: float
    duration: float
    over: float
    limit: str


def undocked_in_field(task: FieldTask) -> Undocking:
    """Undock a docked robot whose pose has the errors of a finished docking."""
    layout, robot = _docked(task)
    by = by_executor(layout, robot, task.rate, task="undock")
    over, limit = worst_ratio(by.commands, np.diff(by.stamps), layout.problem.robot.limits)
    clearance, _ = clearances(layout, robot)
    rows = robot.record()
    turned, commanded = turned_in_contact(rows), commanded_in_contact(rows, by)
    return Undocking(
        task.world, task.rate, task.seed, by.ending, by.reason, by.docked, robot.drive.at_rest, turned, commanded,
        clearance, by.ended, over, limit,
    )  # fmt: skip


def _docked(task: FieldTask) -> tuple[Layout, FieldRobot]:
    """Return a robot in its dock."""
    layout, before = set_up(task)
    along, across, turned = np.random.default_rng((task.seed, 1)).uniform(-1.0, 1.0, 3) * DOCKED_WITHIN
    start = layout.true_dock @ Pose2(float(along), float(across), float(turned))
    there = layout._replace(problem=dataclasses.replace(layout.problem, start=start))
    return there, FieldRobot(before.world, there, task.seed)


def _out_of_contact(rows: FloatArray) -> int:
    """Return the index of the first row more than 10 cm from the first row, or the number of rows."""
    far = np.flatnonzero(np.hypot(*(rows[:, 1:3] - rows[0, 1:3]).T) > CONTACT)
    return int(far[0]) if far.size else len(rows)


def turned_in_contact(rows: FloatArray) -> float:
    """Return the largest rotation of a robot until it was 10 cm away from its first pose [rad].

    Args:
        rows: Time, x, y and continuous yaw, Shape (n, 4) [s, m, m, rad].
    """
    return float(np.max(np.abs(rows[: _out_of_contact(rows), 3] - rows[0, 3])))


def commanded_in_contact(rows: FloatArray, by: SteeringResult) -> float:
    """Return the largest rotation that the commands imply within the contact distance [rad]."""
    until = rows[min(_out_of_contact(rows), len(rows) - 1), 0]
    given = by.stamps < until
    lasted = np.diff(np.append(by.stamps[given], until))
    return float(np.max(np.abs(np.cumsum(by.commands[given, 1] * lasted)), initial=0.0))


def undocking_table(outcomes: Sequence[Undocking]) -> str:
    """Return one row per world and rate."""
    head = [
        "world", "Hz", "undocked", "straight", "turned p50 / p95 / max, degrees", "commanded", "collisions",
        "time p50, s", "over limit", "of", "others end",
    ]  # fmt: skip
    groups: dict[tuple[str, float], list[Undocking]] = {}
    for one in outcomes:
        groups.setdefault((one.world, one.rate), []).append(one)
    return table([head, *(_row(key, found) for key, found in groups.items())])


def _row(key: tuple[str, float], found: list[Undocking]) -> list[str]:
    turned, commanded = np.degrees([one.turned for one in found]), np.degrees([one.commanded for one in found])
    over = max(found, key=lambda one: one.over)
    return [
        key[0],
        f"{key[1]:g}",
        f"{sum(one.undocked and one.at_rest for one in found)}/{len(found)}",
        f"{sum(one.turned <= STRAIGHT for one in found)}",
        _spread(turned),
        _spread(commanded),
        f"{sum(one.clearance < 0.0 for one in found)}",
        f"{np.median([one.duration for one in found]):.1f}",
        f"{over.over:.3f}",
        over.limit,
        ", ".join(sorted({one.ending for one in found if not one.undocked})) or "-",
    ]


def _spread(values: FloatArray) -> str:
    return " / ".join(f"{value:.2f}" for value in (*np.percentile(values, [50, 95]), values.max()))
