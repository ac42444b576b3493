"""Evaluation of a docking in the field world, based on the true state."""

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
    from experiments.docking.field.world import FieldRobot
    from optdock.geometry.arrays import FloatArray

__all__ = ["FieldOutcome", "FieldTask", "SteeringResult", "clearances", "field_outcome"]

_EVERY = 4  # sub-steps between two poses with evaluated clearance: 20 ms, 5 mm at full speed
_DEEP = 0.0075  # [m] of the corners beyond the station's face: travel of its contacts, and 0.6 degrees


class FieldTask(NamedTuple):
    """One docking in the field world, given by names so that any process can run it; `seed` seeds everything."""

    method: str
    world: str
    spread: str
    rate: float
    seed: int


class SteeringResult(NamedTuple):
    """Result as reported by the steering method.

    Attributes:
        ending: Name of the ending.
        reason: Reason of the ending, in a sentence.
        docked: Whether the method reports that the robot is docked.
        ended: Time of the ending [s].
        planned: Planning time of the first plan for the whole way [s]; NaN without one.
        retries: Approaches after the first one.
        busy: 99th percentile of the CPU time of its control cycles without planning [s].
        off: Final error of its estimate of the robot in the dock frame [m]; NaN: unknown.
        turned_off: Final yaw error of that estimate [rad].
        recovered_after: Detections of a pushed dock until the estimate was correct again, see `Belief`.
        commands: Linear and angular, one per control cycle, Shape (n, 2) [m/s, rad/s].
        stamps: Times of the commands, Shape (n,) [s].
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
    """Outcome of one docking.

    Attributes:
        world: Name of the world.
        rate: Control cycles per second [Hz].
        method: Name of the method.
        spread: Name of the distribution of starts.
        seed: Seed of all random numbers.
        ending: Name of the ending.
        reason: Reason of the ending, in a sentence.
        docked: Whether the method reports that the robot is docked.
        at_rest: Whether the robot stands at the end.
        along: Final longitudinal error of the robot in the frame of the true dock [m].
        cross: Final lateral error, positive left [m].
        yaw: Final heading error [rad].
        duration: Time of the ending [s].
        planned: Planning time [s]; NaN without a plan.
        retries: Approaches after the first one.
        clearance: Smallest distance to obstacles other than the station [m].
        station: Smallest distance to the station [m]; negative: penetration depth.
        over: Largest ratio of a commanded quantity to its limit.
        limit: Name of that limit.
        busy: 99th percentile of the CPU time of its control cycles without planning [s].
        off: Final error of its estimate of the robot in the dock frame [m]; NaN: unknown.
        turned_off: Final yaw error of that estimate [rad].
        recovered_after: Detections of a pushed dock until the estimate was correct again, see `Belief`.
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
        """Whether the true final pose is within 10 mm, 10 mm and 1.5 degrees."""
        seen = abs(self.along), abs(self.cross), abs(self.yaw)
        return self.at_rest and all(value <= most for value, most in zip(seen, ACCEPTED, strict=True))

    @property
    def good(self) -> bool:
        """Whether the robot is reported docked and is docked."""
        return self.docked and self.exact

    @property
    def falsely_docked(self) -> bool:
        """Whether the robot is reported docked and is not."""
        return self.docked and not self.exact

    @property
    def collided(self) -> bool:
        """Whether the robot has hit an obstacle, or the station deeper than its contacts yield."""
        return self.clearance < 0.0 or self.station < -_DEEP


def field_outcome(task: FieldTask, layout: Layout, robot: FieldRobot, by: SteeringResult) -> FieldOutcome:
    """Return the outcome of a run.

    Args:
        task: Names of the run.
        layout: Problem and true dock pose.
        robot: Robot after the run.
        by: Result as reported by the steering method.
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
    """Return the smallest distances of the true outline to obstacles and to the station [m], at most 1 m."""
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
