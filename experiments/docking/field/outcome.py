"""What is measured of a docking in the field world, all of it by what is true."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from experiments.docking.outcome import ACCEPTED, worst_ratio
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2, pose_errors
from optdock.verification import pose_clearances

if TYPE_CHECKING:
    from experiments.docking.cases import Layout
    from experiments.docking.field.task import FieldTask
    from experiments.docking.field.world import FieldRobot
    from optdock.geometry.arrays import FloatArray

__all__ = ["FieldOutcome", "Steered", "clearances", "field_outcome"]

_EVERY = 4  # sub-steps between two poses whose clearance is looked at: 20 ms, 5 mm at full speed
_DEEP = 0.0075  # [m] of the corners beyond the station's face: what its contacts give, and 0.6 degrees


class Steered(NamedTuple):
    """What whoever steered leaves behind.

    Attributes:
        ending: Its name.
        reason: Of the ending, in a sentence.
        docked: Whether it says so.
        ended: When it said how it ended [s].
        planned: How long the plan for the whole way takes that it began with [s]; NaN where it made none.
        retries: Approaches after the first one.
        busy: 99th percentile of the CPU of its control cycles without planning [s].
        off: How far its belief of the robot seen from the dock was from the truth in the end [m]; NaN: not known.
        turned_off: And how far turned [rad].
        recovered_after: Detections of a pushed dock until it believed the truth again, see `Belief`.
        commands: Linear and angular, one for each control cycle, Shape (n, 2) [m/s, rad/s].
        stamps: When they were given, Shape (n,) [s].
    """

    ending: str
    reason: str
    docked: bool
    ended: float
    planned: float
    retries: int
    busy: float
    off: float
    turned_off: float
    recovered_after: float
    commands: FloatArray
    stamps: FloatArray


class FieldOutcome(NamedTuple):
    """One docking.

    Attributes:
        world: In which world.
        rate: Control cycles per second [Hz].
        method: How.
        spread: From which starts.
        seed: Of everything in it.
        ending: Its name.
        reason: Of the ending, in a sentence.
        docked: Whether the method says that the robot is docked.
        at_rest: Whether the robot stands in the end.
        along: The robot seen from the true dock in the end [m].
        cross: Likewise to the left [m].
        yaw: Likewise [rad].
        duration: Until the method said how it ended [s].
        planned: How long its plan takes [s]; NaN: there was none.
        retries: Approaches after the first one.
        clearance: Smallest distance to what is not the station [m].
        station: Smallest distance to the station [m]; negative: how deep the outlines overlapped.
        over: Largest ratio of a commanded quantity to its limit.
        limit: Which that is.
        busy: 99th percentile of the CPU of its control cycles without planning [s].
        off: How far its belief of the robot seen from the dock was from the truth in the end [m]; NaN: not known.
        turned_off: And how far turned [rad].
        recovered_after: Detections of a pushed dock until it believed the truth again, see `Belief`.
    """

    world: str
    rate: float
    method: str
    spread: str
    seed: int
    ending: str
    reason: str
    docked: bool
    at_rest: bool
    along: float
    cross: float
    yaw: float
    duration: float
    planned: float
    retries: int
    clearance: float
    station: float
    over: float
    limit: str
    busy: float
    off: float
    turned_off: float
    recovered_after: float

    @property
    def exact(self) -> bool:
        """Whether the robot truly stands within 10 mm, 10 mm and 1.5 degrees."""
        seen = abs(self.along), abs(self.cross), abs(self.yaw)
        return self.at_rest and all(value <= most for value, most in zip(seen, ACCEPTED, strict=True))

    @property
    def good(self) -> bool:
        """Said docked, and truly docked."""
        return self.docked and self.exact

    @property
    def falsely_docked(self) -> bool:
        """Said docked, and is not."""
        return self.docked and not self.exact

    @property
    def collided(self) -> bool:
        """Whether the robot has hit something, or the station deeper than contact is."""
        return self.clearance < 0.0 or self.station < -_DEEP


def field_outcome(task: FieldTask, layout: Layout, robot: FieldRobot, by: Steered) -> FieldOutcome:
    """The outcome of a run.

    Args:
        task: Its names.
        layout: Where everything stood.
        robot: As the run has left it.
        by: What whoever steered it has left.
    """
    error = robot.error
    clearance, station = clearances(layout, robot)
    over, limit = worst_ratio(by.commands, np.diff(by.stamps), layout.problem.robot.limits)
    return FieldOutcome(
        task.world, task.rate, task.method, task.spread, task.seed, by.ending, by.reason, by.docked,
        robot.drive.at_rest, error.x, error.y, error.yaw, by.ended, by.planned, by.retries, clearance, station, over,
        limit, by.busy, by.off, by.turned_off,
        by.recovered_after,
    )  # fmt: skip


def clearances(layout: Layout, robot: FieldRobot) -> tuple[float, float]:
    """Smallest distances of the true outline to obstacles and to the station [m], at most 1 m."""
    rows = robot.record()[::_EVERY]
    problem = layout.problem
    assert problem.dock.footprint is not None
    others, _ = pose_clearances(rows[:, 1:], problem.robot.footprint, problem.obstacles, within=1.0)
    outline = ObstacleSet.from_footprint(problem.dock.footprint, Pose2(0.0, 0.0, 0.0), "station")
    nearest = math.inf
    ends = [*(since for since, _ in robot.docks[1:]), math.inf]
    for (since, dock), until in zip(robot.docks, ends, strict=True):
        there = rows[(rows[:, 0] >= since) & (rows[:, 0] < until), 1:]
        if len(there):
            seen = pose_errors(there, np.broadcast_to(dock.as_array(), there.shape))
            found, _ = pose_clearances(seen, problem.robot.footprint, outline, within=1.0)
            nearest = min(nearest, float(found.min()))
    return float(others.min()), nearest
