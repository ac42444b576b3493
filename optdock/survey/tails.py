"""Poses on a certified motion as answers.

**Theorem.** Let a path be certified for a start whose clearance is at least the one required away from the dock. Then
the rest of the path from any of its poses is certified for a robot that starts at rest at that pose with any steering
angle, if the rest contains the whole final straight.

The certified clearance is that of `ClearanceRule.near_goal`, because the rule for a start that is too close does not
apply. The rule for the new start requires at most this clearance (`ClearanceRule.required_at` is a minimum). The same
holds for the view of the dock. The other rules hold for every point of the path, for its joints and for its end.

The robot accelerates from rest and joins the time law of the original motion, which is followed from then on.
"""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from optdock.geometry.arrays import readonly
from optdock.io.path_columns import path_from_curves
from optdock.model.constant_jerk import TimeLaw
from optdock.model.segments import TURN_RADIUS, TurnSegment
from optdock.planners.manoeuvres.price import CUSP_PRICE
from optdock.timing.jerk_phases import DriveBounds, MotionState
from optdock.timing.ruckig_moves import move
from optdock.verification import end_clearances

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray
    from optdock.model.path import Path
    from optdock.planning.plan import DockPlan
    from optdock.survey.grid import SurveyGrid
    from optdock.survey.questions import SurveyTask

__all__ = ["LawSamples", "PassedCells", "passed_cells", "seconds_from_rest", "time_rests"]

_SHORTEST = 0.01  # [m] of the first gear of a rest
_SPACING = 0.02  # [m] between the poses of a path that are assigned to cells
# Distances [m] after which the robot may have joined the original motion; the first place that is possible is used.
_JOINS_AFTER = readonly(np.array((0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0, 1.5, 2.0, 3.0, 6.0)))
_SAMPLE = 0.02  # [s] between the states of a motion
_FASTER = (1.02, 0.01)  # factor and [m/s] of the error of interpolation between the states
_SHARES = (1.0, 0.5)  # of the limits of acceleration and jerk


class PassedCells(NamedTuple):
    """Cells that motions pass, one row per cell and motion.

    Attributes:
        cell: Flat index of the passed cell, Shape (n,).
        source: Cell of the question whose motion passes it, Shape (n,).
        s: Path coordinate of the pose next to the centre of the cell, Shape (n,) [m].
        price: Estimated price of the rest of the motion [s], Shape (n,).
    """

    cell: IntArray
    source: IntArray
    s: FloatArray
    price: FloatArray

    @classmethod
    def joined(cls, parts: Sequence[PassedCells]) -> PassedCells:
        """Return the rows with the lowest price for each cell, in the order of the cells."""
        if not parts:
            empty = np.zeros(0, dtype=np.int64)
            return cls(empty, empty, np.zeros(0), np.zeros(0))
        cell, source = (np.concatenate([part[axis] for part in parts]) for axis in (0, 1))
        every = cls(
            cell, source, np.concatenate([one.s for one in parts]), np.concatenate([one.price for one in parts])
        )
        order = np.lexsort((every.source, every.price, every.cell))
        _, first = np.unique(every.cell[order], return_index=True)
        return every.rows(order[first])

    def rows(self, kept: IntArray | BoolArray) -> PassedCells:
        """Return selected rows."""
        return PassedCells(self.cell[kept], self.source[kept], self.s[kept], self.price[kept])

    def by_source(self) -> list[PassedCells]:
        """Return the rows of each source, which must follow each other."""
        ends = np.flatnonzero(np.diff(self.source)) + 1
        return [self.rows(rows) for rows in np.split(np.arange(self.cell.size), ends)] if self.cell.size else []

    def as_dict(self) -> dict[str, list[float]]:
        """Return plain values."""
        return {name: column.tolist() for name, column in self._asdict().items()}

    @classmethod
    def from_dict(cls, values: Mapping[str, Sequence[float]]) -> PassedCells:
        """Read the result of `as_dict`."""
        cell, source = (np.array(values[name], dtype=np.int64) for name in ("cell", "source"))
        return cls(cell, source, np.array(values["s"], dtype=np.float64), np.array(values["price"], dtype=np.float64))


def passed_cells(plan: DockPlan, grid: SurveyGrid) -> PassedCells:
    """Return the cells that a plan passes at poses from which the rest of its path is certified, by the theorem."""
    problem, path, law = plan.problem, plan.path, plan.trajectory.time_law
    last = path.length - problem.dock.final_straight
    is_strict = plan.certificate.start_relief == 0.0
    is_strict = is_strict and end_clearances(problem).start >= problem.path_clearance.required
    tube = problem.robot.tracking
    if not is_strict or last <= 0.0 or (problem.required_view is not None and (tube.cross > 0.0 or tube.yaw > 0.0)):
        return PassedCells.joined(())
    s = np.linspace(0.0, last, 2 + int(last / _SPACING))[:-1]
    poses = path.poses_at(s)
    cells = grid.cells(poses)
    t = np.linspace(0.0, law.duration, 2 + int(law.duration / 0.02))
    states = law.at(t)
    left = law.duration - np.interp(s, states[:, 0], t) + _launch_loss(np.interp(s, states[:, 0], states[:, 1]), plan)
    driven, reverse = _left_to_drive(path, s)
    left += CUSP_PRICE * (driven - 1) + problem.robot.reverse_price * reverse
    # Of the poses of a visit, the one next to the centre of the cell.
    borders = path.segment_starts[1:]
    to_go = borders[np.minimum(np.searchsorted(borders, s, side="right"), borders.size - 1)] - s
    inside = np.flatnonzero((cells >= 0) & (to_go >= _SHORTEST))
    if inside.size == 0:
        return PassedCells.joined(())
    gap = poses[inside] - grid.poses(cells[inside])
    turned = (gap[:, 2] + math.pi) % (2.0 * math.pi) - math.pi
    off = np.hypot(gap[:, 0], gap[:, 1]) / grid.resolution + np.abs(turned) * grid.shape[0] / (2.0 * math.pi)
    order = np.lexsort((off, cells[inside]))
    found, first = np.unique(cells[inside][order], return_index=True)
    row = inside[order[first]]
    source = grid.cells(problem.start.as_array()[None])
    limits = problem.robot.limits
    steered = np.array([limits.steering_time_to(bend) for bend in path.curvature_at(s[row]).tolist()])
    return PassedCells(found, np.repeat(source, found.size), s[row], left[row] + steered)


def _left_to_drive(path: Path, s: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the number of segments, except turns in place, that end after `s`, and their length in reverse [m]."""
    drives = [not isinstance(segment, TurnSegment) for segment in path.segments]
    is_reverse = np.array([segment.direction < 0 for segment in path.segments])[drives]
    begins, ends = path.segment_starts[:-1][drives], path.segment_starts[1:][drives]
    left = np.maximum(ends - np.maximum(begins, s[:, None]), 0.0)
    return (left > 0.0).sum(axis=1), (left * is_reverse).sum(axis=1)


def _launch_loss(speed: FloatArray, plan: DockPlan) -> FloatArray:
    """Return the time [s] lost by accelerating from rest to a speed that the motion would keep. Shape (n,)."""
    limits = plan.problem.robot.limits
    full = limits.max_acceleration**2 / limits.max_jerk
    ramp = np.where(
        speed >= full,
        speed / limits.max_acceleration + limits.max_acceleration / limits.max_jerk,
        2.0 * np.sqrt(np.maximum(speed, 0.0) / limits.max_jerk),
    )
    found: FloatArray = 0.5 * ramp
    return found


class LawSamples(NamedTuple):
    """A time law, sampled at its borders and between them.

    `times`: Shape (n,) [s]. `places`, `speeds`, `accelerations`: states at these times, Shape (n,). `borders`: rows of
    the borders of phases.
    """

    times: FloatArray
    places: FloatArray
    speeds: FloatArray
    accelerations: FloatArray
    borders: IntArray

    @classmethod
    def of(cls, law: TimeLaw) -> LawSamples:
        """Return the samples of a law."""
        times = np.union1d(np.arange(0.0, law.duration, _SAMPLE), law.times)
        places, speeds, accelerations, _ = law.at(times).T
        return cls(times, places, speeds, accelerations, np.searchsorted(times, law.times))


def seconds_from_rest(law: LawSamples, s: float, end: float, bounds: DriveBounds) -> float:
    """Return the duration [s] of the rest of a motion for a robot that starts at rest at `s`.

    The robot accelerates from rest to a state of the motion, nowhere faster than the motion itself, and follows the
    motion from there. Turning limits are not checked during the acceleration; the certificate of a plan file does so.

    Args:
        law: Samples of the time law of the motion.
        s: Path coordinate of the start [m].
        end: End of the segment of the path that contains `s` [m].
        bounds: Bounds of the drive on this segment.

    Returns:
        The duration; nan if the motion cannot be joined within the segment.
    """
    times, places, speeds, accelerations, borders = law
    first, until = (int(np.searchsorted(places, place)) for place in (s + 1e-9, end - 1e-9))
    # The motion often becomes slow at the border of a phase, such as the beginning of the speed zone.
    joins = np.concatenate((np.searchsorted(places, s + _JOINS_AFTER), borders, [until]))
    joins = np.unique(joins[(joins >= first) & (joins <= until)])
    # Without a limit of the jerk, a speed v is reached after v^2 / 2 A.
    joins = joins[speeds[joins] ** 2 <= 2.0 * bounds.acceleration * (places[joins] - s) + 1e-9]
    for statistic, join, share in itertools.product((np.max, np.min), joins.tolist(), _SHARES):
        fastest = max(float(statistic(speeds[max(first - 1, 0) : join + 1])), 1e-6)
        target = MotionState(float(places[join]), float(speeds[join]), float(accelerations[join]))
        phases = move(MotionState(s), target, DriveBounds(fastest, *(share * bound for bound in bounds[1:])))
        if not phases:
            continue
        durations, jerks = np.transpose(phases)
        if _is_slower(TimeLaw(durations, jerks, s), places, speeds):
            return float(durations.sum() + times[-1] - times[join])
    return math.nan


def _is_slower(move_: TimeLaw, places: FloatArray, speeds: FloatArray) -> bool:
    """Whether a move is nowhere faster than a motion with speeds [m/s] at places [m], Shape (n,) each."""
    s, v, _, _ = move_.at(np.arange(0.0, move_.duration, _SAMPLE)).T
    factor, more = _FASTER
    return bool(np.all(v <= factor * np.interp(s, places, speeds) + more))


def time_rests(
    task: SurveyTask, motions: Sequence[tuple[Mapping[str, Any], Sequence[float]]]
) -> list[dict[str, list[Any]]]:
    """Return duration [s], pose and number of stops of the rests of several motions.

    Args:
        task: The survey.
        motions: Each motion, as in `Answer.motion`, with the path coordinates at which its rests begin [m].

    Returns:
        One row per motion: `seconds` (None if the motion cannot be joined), `poses` and `stops`, one for each rest.
    """
    return [_timed(task, motion, np.array(places)) for motion, places in motions]


def _timed(task: SurveyTask, motion: Mapping[str, Any], s: FloatArray) -> dict[str, list[Any]]:
    problem = task.scenario.problem
    path, limits = path_from_curves(motion["curves"], problem.frame), problem.robot.limits
    law = LawSamples.of(TimeLaw(np.array(motion["durations"]), np.array(motion["jerks"])))
    borders = path.segment_starts[1:]
    drive = DriveBounds(math.inf, limits.max_acceleration, limits.max_deceleration, limits.max_jerk)
    turn = DriveBounds(math.inf, *(TURN_RADIUS * bound for bound in (*limits.turning[1:2], *limits.turning[1:])))
    turns = [isinstance(segment, TurnSegment) for segment in path.segments]
    within = np.minimum(np.searchsorted(borders, s, side="right"), borders.size - 1).tolist()
    seconds = [
        limits.steering_time_to(bend)
        + seconds_from_rest(law, place, float(borders[segment]), turn if turns[segment] else drive)
        for bend, place, segment in zip(path.curvature_at(s).tolist(), s.tolist(), within, strict=True)
    ]
    driven, _ = _left_to_drive(path, s)
    return {
        "seconds": [one if math.isfinite(one) else None for one in seconds],
        "poses": path.poses_at(s).tolist(),
        "stops": (driven - 1).tolist(),
    }
