"""Whether a plan from rest pays while another motion is driven: something that this one leads round has gone."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING

import numpy as np

from optdock.executor.interruptions import SHORTER_WAY, Interrupted
from optdock.executor.planning import Job
from optdock.executor.planning_scene import AT_A_STAND
from optdock.geometry.pose import Pose2
from optdock.model.costs import LETHAL, NO_INFORMATION

if TYPE_CHECKING:
    from optdock.executor.planning import DrivenMotion, PlanResult
    from optdock.executor.situation import Situation
    from optdock.geometry.arrays import FloatArray
    from optdock.model.costmap import Costmap
    from optdock.model.problem import DockingProblem

__all__ = ["ShorterWay"]

# An obstacle has gone: is a plan from rest so much shorter that stopping for it pays? Usual ones take 30 to 90 ms.
_FROM_REST_BUDGET = 0.2  # [s]
_SHORTER, _STOPPING = 0.8, 1.0  # of what is left of the motion; [s] for the stop and a plan
_BESIDE = 1.0  # [m] beside the straight way: what stands there leads a robot round
_PAUSE = 3.0  # times the usual pause between two plans: what did not pay a moment ago does not pay now


class ShorterWay:
    """The search for a shorter way from rest, beside a motion that is driven.

    Args:
        situation: Of the robot.
        planned_among: The costmap that the way round was chosen for; None: there was none.
    """

    def __init__(self, situation: Situation, planned_among: Costmap | None) -> None:
        self._situation, self._planned_among = situation, planned_among
        self._is_new = False
        self._asked_at = -math.inf

    def look_again(self) -> None:
        """Compare the next costmap with that which the motion was planned among."""
        self._is_new = True

    def may_exist(self, motion: DrivenMotion, time: float, pose: Pose2, costmap: Costmap | None) -> bool:
        """Whether something has gone that the motion leads round, and a plan from rest may pay.

        Args:
            motion: That is driven.
            time: Of the reference, on the motion's own clock [s].
            pose: Of the robot, in the frame of the motion.
            costmap: The newest one.
        """
        situation, end = self._situation, motion.trajectory.path.end
        pause = _PAUSE * situation.settings.replan_pause
        if not self._is_new or situation.now - self._asked_at < pause:
            return False
        self._is_new = False
        least = pose.distance_to(end) / situation.problem.robot.limits.max_speed  # no plan takes less
        before = self._planned_among
        if before is None or costmap is None or not self._pays(least, motion, time):
            return False
        between = np.stack((situation.perception.robot.as_array()[:2], end.as_array()[:2]))
        return _has_gone(before, costmap, between, situation.problem.robot.footprint.circumscribed_radius + _BESIDE)

    def job(self, motion: DrivenMotion, time: float, here: DockingProblem, costmap: Costmap | None) -> Job:
        """The job that plans from where the robot would stop, as if the motion were not there.

        Args:
            motion: That is driven.
            time: Of the reference, on the motion's own clock [s].
            here: The problem, but for its start and its costmap.
            costmap: The newest one.
        """
        situation, trajectory = self._situation, motion.trajectory
        now = trajectory.at(min(max(time, 0.0), trajectory.duration))
        speed = abs(situation.twist.linear)
        stop = min(now.s + 0.5 * speed * situation.braking_time_from(speed), trajectory.path.length)
        start = Pose2.from_sequence(trajectory.path.poses_at(np.array([stop]))[0])
        self._asked_at = situation.now
        problem = dataclasses.replace(here, start=start, costmap=costmap, **AT_A_STAND)
        return Job(0, situation.now, problem, _FROM_REST_BUDGET)

    def take(self, result: PlanResult, motion: DrivenMotion, time: float) -> None:
        """Stop the motion where the result of the job is so much shorter that it pays.

        Raises:
            Interrupted: It is.
        """
        if result.motion is not None and self._pays(result.motion.trajectory.duration, motion, time):
            left = motion.trajectory.duration - time
            reason = f"{result.motion.trajectory.duration:.1f} s from rest, {left:.1f} s of this one are left"
            raise Interrupted(SHORTER_WAY, reason)

    def _pays(self, duration: float, motion: DrivenMotion, time: float) -> bool:
        """Whether a plan from rest that takes so long [s] is worth a stop."""
        left = motion.trajectory.duration - time
        return self._situation.braking_time + _STOPPING + duration < _SHORTER * left


def _has_gone(before: Costmap, now: Costmap, places: FloatArray, reach: float) -> bool:
    """Whether a cell in which something stood is seen to be free, in the box around places, Shape (n, 2) [m].

    Args:
        before: Where something stood.
        now: What is seen.
        places: Of the robot and its goal.
        reach: How far the box reaches beyond them [m].
    """
    low, high = before.cell_of(np.stack((places.min(axis=0) - reach, places.max(axis=0) + reach)))
    (i, j), (i1, j1) = np.maximum(low, 0).tolist(), np.maximum(high + 1, 0).tolist()
    rows, columns = np.nonzero(before.data[j:j1, i:i1] == LETHAL)
    costs = now.cost_at(before.centre_of(np.column_stack((columns + i, rows + j))))
    return bool(np.any((costs != LETHAL) & (costs != NO_INFORMATION)))
