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

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from optdock.io.path_columns import path_from_curves
from optdock.model.constant_jerk import TimeLaw
from optdock.planners.manoeuvres.price import CUSP_PRICE
from optdock.timing.jerk_phases import DriveBounds, MotionState
from optdock.timing.ruckig_moves import move
from optdock.verification import end_clearances

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray
    from optdock.model.limits import MotionLimits
    from optdock.planning.plan import DockPlan
    from optdock.survey.grid import SurveyGrid
    from optdock.survey.questions import SurveyTask

__all__ = ["PassedCells", "passed_cells", "seconds_from_rest", "time_rests"]

_SHORTEST = 0.01  # [m] of the first gear of a rest
_SPACING = 0.02  # [m] between the poses of a path that are assigned to cells
# Distances [m] after which the robot is to have joined the original motion; the first one that is possible is used.
_JOINS_AFTER = (0.05, 0.1, 0.2, 0.4, 0.8, 1.5, 3.0, 6.0)
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
    starts = np.array(path.cusps)
    left += CUSP_PRICE * (starts.size - np.searchsorted(starts, s, side="right"))
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
    return PassedCells(found, np.repeat(source, found.size), s[row], left[row])


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


def seconds_from_rest(law: TimeLaw, s: float, end: float, limits: MotionLimits) -> float:
    """Return the duration [s] of the rest of a motion for a robot that starts at rest at `s`.

    The robot accelerates from rest to a state of the motion, at most as fast as the motion itself drives between `s`
    and that state, and follows the motion from there. Turning limits are not checked during the acceleration; the
    certificate of a plan file does so.

    Args:
        law: Time law of the motion.
        s: Path coordinate of the start [m].
        end: End of the segment of the path that contains `s` [m].
        limits: Limits of the drive.

    Returns:
        The duration; nan if the motion cannot be joined within the segment.
    """
    borders, times = law.states[:, 0], law.times
    first = int(np.searchsorted(borders, s + 1e-9))
    until = int(np.searchsorted(borders, end - 1e-9))
    now = max(first - 1, 0)
    for after in _JOINS_AFTER:
        join = min(max(int(np.searchsorted(borders, s + after)), first), until)
        # The speed reaches its maximum within a phase only if the acceleration changes its sign there.
        fastest = float(law.at(np.linspace(times[now], times[join], 4 * (join - now) + 1))[:, 1].max())
        target = MotionState(*law.states[join].tolist())
        for share in _SHARES:
            bounds = DriveBounds(
                max(fastest, 1e-6),
                share * limits.max_acceleration,
                share * limits.max_deceleration,
                share * limits.max_jerk,
            )
            phases = move(MotionState(s), target, bounds)
            if phases is not None:
                return sum(duration for duration, _ in phases) + law.duration - float(times[join])
        if join == until:
            break
    return math.nan


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
    law = TimeLaw(np.array(motion["durations"]), np.array(motion["jerks"]))
    borders = path.segment_starts[1:]
    ends = borders[np.minimum(np.searchsorted(borders, s, side="right"), borders.size - 1)]
    seconds = [
        limits.steering_time_to(bend) + seconds_from_rest(law, place, end, limits)
        for bend, place, end in zip(path.curvature_at(s).tolist(), s.tolist(), ends.tolist(), strict=True)
    ]
    stops_left = len(path.cusps) - np.searchsorted(path.cusps, s, side="right")
    return {
        "seconds": [one if math.isfinite(one) else None for one in seconds],
        "poses": path.poses_at(s).tolist(),
        "stops": stops_left.tolist(),
    }
