"""Evaluation of a docking: final pose, ending, and compliance with limits and certificates."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.pose import pose_errors
from optdock.samples.tube import Tube
from optdock.verification import end_clearances, pose_clearances

if TYPE_CHECKING:
    from collections.abc import Sequence

    from experiments.docking.worlds import Case
    from optdock.geometry.arrays import FloatArray
    from optdock.model.limits import MotionLimits
    from optdock.planning.plan import DockPlan
    from optdock.simulation import Record

__all__ = ["ACCEPTED", "FollowedPlan", "Outcome", "outcome_of", "worst_ratio"]

# along, cross [m], yaw [rad] relative to the true dock: tolerances of success
ACCEPTED = 0.010, 0.010, math.radians(1.5)
_MOVING = 0.02  # [m/s]: below this speed the commanded curvature is noise
_ROUNDING = 1e-6  # relative tolerance of limits


class FollowedPlan(NamedTuple):
    """A certified plan and the time from which it was followed [s]; None: no plan from then on."""

    since: float
    plan: DockPlan | None


class Outcome(NamedTuple):
    """Outcome of one docking.

    Attributes:
        method: Name of the method.
        world: Name of the world.
        spread: Name of the distribution of starts.
        rate: Control cycles per second [Hz].
        seed: Seed of the case.
        direction: Gear into the dock.
        ending: Description of the ending; empty if the method reports success.
        docked: Whether the method reports success.
        along: Final longitudinal error of the robot in the frame of the true dock [m].
        cross: Final lateral error, positive left [m].
        yaw: Final heading error [rad].
        duration: [s].
        replans: Number of plans adopted in motion.
        retries: Approaches after the first one.
        curvature: Largest commanded curvature above 0.02 m/s [1/m].
        over: Largest ratio of a commanded quantity to its limit.
        limit: Name of that limit.
        clearance: Smallest distance to obstacles other than the station [m].
        short: Largest shortfall of the clearance of a pose within the tube from the proven clearance [m]; <= 0: none.
        displacement: Largest displacement of a footprint point from the followed path [m].
        left: Number of times that the true robot left the tube.
        reported: Number of times that the method reported leaving the tube.
        busy: 99th percentile of the CPU time of a control cycle without planning [s].
    """

    method: str
    world: str
    spread: str
    rate: float
    seed: int
    direction: str
    ending: str
    docked: bool
    along: float
    cross: float
    yaw: float
    duration: float
    replans: int
    retries: int
    curvature: float
    over: float
    limit: str
    clearance: float
    short: float
    displacement: float
    left: int
    reported: int
    busy: float

    @property
    def succeeded(self) -> bool:
        """Whether the robot is reported docked and is within the tolerances of the true dock."""
        seen = abs(self.along), abs(self.cross), abs(self.yaw)
        return self.docked and all(value <= most for value, most in zip(seen, ACCEPTED, strict=True))


def outcome_of(  # noqa: PLR0913 - what a run leaves behind
    case: Case,
    record: Record,
    followed: Sequence[FollowedPlan],
    *,
    names: tuple[str, str, str, float],
    ending: str,
    counts: tuple[int, int, int],
    busy: float,
) -> Outcome:
    """Return the outcome of a run.

    Args:
        case: The docking.
        record: Recorded run.
        followed: The followed plans, in order.
        names: Method, world, spread, and rate.
        ending: Description of the ending; empty if the method reports success.
        counts: Numbers of replans, retries and reported departures from the tube.
        busy: CPU time of a control cycle [s].
    """
    error = pose_errors(record.poses[-1:], record.docks[-1:])[0]
    moving = np.abs(record.commands[:, 0]) > _MOVING
    curvature = np.abs(record.commands[moving, 1] / record.commands[moving, 0])
    given, h = record.commands[:-1], np.diff(record.times[:-1])  # the last row is no command
    over, limit = worst_ratio(given, h, case.problem.robot.limits)
    clearances, _ = pose_clearances(record.poses, case.problem.robot.footprint, case.problem.obstacles, within=1.0)
    short, displacement, left = _tube(record, followed, clearances)
    replans, retries, reported = counts
    return Outcome(
        *names,
        case.seed,
        case.direction.value,
        ending,
        not ending,
        *error.tolist(),
        float(record.times[-1]),
        replans,
        retries,
        float(np.max(curvature, initial=0.0)),
        over,
        limit,
        float(clearances.min()),
        short,
        displacement,
        left,
        reported,
        busy,
    )


def worst_ratio(commands: FloatArray, periods: FloatArray, limits: MotionLimits) -> tuple[float, str]:
    """Return the largest ratio of a commanded quantity to its limit and the limit's name, from command differences.

    Args:
        commands: Linear and angular, Shape (n, 2) [m/s, rad/s].
        periods: Time between successive commands, Shape (n - 1,) [s].
        limits: Limits of the robot.
    """
    (v, w), h = commands.T, periods
    a, turned = np.diff(v) / h, np.diff(w) / h
    speeding = np.where(np.abs(v[1:]) > np.abs(v[:-1]), limits.max_acceleration, limits.max_deceleration)
    apart = np.concatenate((h[:1], 0.5 * (h[:-1] + h[1:])))  # an acceleration belongs to the middle of its period
    jerk = np.diff(np.concatenate(([0.0], a))) / apart
    ratios = {
        "speed": np.abs(v) / np.where(v >= 0.0, limits.max_speed, limits.max_reverse_speed),
        "yaw rate": np.abs(w) / limits.max_yaw_rate,
        "acceleration": np.abs(a) / speeding,
        "yaw acceleration": np.abs(turned) / limits.max_yaw_acceleration,
        "jerk": np.abs(jerk) / limits.max_jerk,
    }
    worst = max(ratios, key=lambda name: float(np.max(ratios[name], initial=0.0)))
    return float(np.max(ratios[worst], initial=0.0)), worst


def _tube(record: Record, followed: Sequence[FollowedPlan], clearances: FloatArray) -> tuple[float, float, int]:
    """Return the largest shortfall within the tube, the largest displacement, and the number of exits."""
    short, displacement, left = -math.inf, 0.0, 0
    ends = [*(one.since for one in followed[1:]), math.inf]
    for (since, plan), until in zip(followed, ends, strict=False):
        rows = np.flatnonzero((record.times >= since) & (record.times < until))
        if plan is None or rows.size == 0:
            continue
        problem = plan.problem
        tube = Tube(plan.path, problem, plan.certificate.start_relief)
        found = tube.deviations(record.poses[rows])
        inside = found.excess <= 0.0
        at = plan.path.poses_at(found.s)
        ends = problem.goal, problem.start, end_clearances(problem).start
        required = problem.clearance.required_for(at, *ends, plan.certificate.start_relief)
        short = max(short, float(np.max((required - clearances[rows])[inside], initial=-math.inf)))
        displacement = max(displacement, float(found.displacement.max()))
        left += int(np.count_nonzero(np.diff(np.concatenate(([True], inside)).astype(int)) < 0))
    return short, displacement, left
