"""Refusals: faults that are certain before any search, and the bound that a failed search ran into."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.dock import DockDirection
from optdock.errors import FailedToSmoothPath
from optdock.obstacles import in_words
from optdock.path import Direction
from optdock.verification import pose_clearances

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from optdock.path import Path
    from optdock.problem import DockingProblem
    from optdock.verification import Certificate
    from smoothers.scp.loop import Iterate
    from smoothers.scp.problem import NonlinearProgram

__all__ = ["Refusal", "refuse_approach", "refuse_certificate", "refuse_search", "refuse_start"]

_TOLERANCE = 1e-6  # [m], as the certificate's
_STRAIGHT_SAMPLES = 13


class Refusal(NamedTuple):
    """One bound in the way: its name, where along the path, by how much, at which obstacle, a sentence, the pose."""

    reason: str
    s: float
    amount: float
    obstacle: str
    message: str
    pose: FloatArray | None = None

    def error(self, **more: object) -> FailedToSmoothPath:
        """The exception that says so."""
        where = {"reason": self.reason, "s": self.s, "amount": self.amount, "obstacle": self.obstacle, **more}
        if self.pose is not None:
            where["pose"] = self.pose.tolist()
        return FailedToSmoothPath(f"{self.reason}: {self.message}", where=where)


def refuse_start(path: Path, problem: DockingProblem, start_clearance: float, nearest: int) -> Refusal | None:
    """What makes any path with these gears impossible from the start on, or None."""
    if start_clearance < -_TOLERANCE:
        name = problem.all_obstacles.name_of(nearest)
        message = f"the footprint overlaps {in_words(name)} by {-start_clearance:.3f} m where the robot stands"
        return Refusal("start_in_collision", 0.0, -start_clearance, name, message)
    limit, steered = problem.robot.limits.max_curvature, problem.start_curvature
    if steered is not None and abs(steered) > limit:
        message = f"the robot steers {steered:.4g} 1/m at the start, the limit is {limit:.4g} 1/m"
        return Refusal("start_curvature", 0.0, abs(steered) - limit, "", message)
    first, last = path.segments[0].direction, path.segments[-1].direction
    wanted = {DockDirection.FORWARD: Direction.FORWARD, DockDirection.BACKWARD: Direction.REVERSE}
    if wanted.get(problem.dock.direction, last) is not last:
        asked = problem.dock.direction.value
        message = f"the raw path enters the dock in {last.name.lower()} gear, the dock asks for {asked}"
        return Refusal("direction", path.length, 1.0, "", message)
    if problem.start_speed * first < 0.0:
        message = f"the robot moves at {problem.start_speed:.3g} m/s, the raw path begins in {first.name.lower()} gear"
        return Refusal("direction", 0.0, abs(problem.start_speed), "", message)
    return None


def refuse_approach(path: Path, problem: DockingProblem, start_clearance: float) -> Refusal | None:
    """A pose of the final straight, the goal included, that is closer to an obstacle than allowed; or None.

    Every answer must drive these poses, so one that breaks the clearance rule is a proof.
    """
    goal, straight = problem.goal, problem.dock.final_straight
    back = float(path.segments[-1].direction) * np.linspace(straight, 0.0, _STRAIGHT_SAMPLES if straight > 0.0 else 1)
    poses = np.column_stack(
        (goal.x - back * math.cos(goal.yaw), goal.y - back * math.sin(goal.yaw), np.full(back.size, goal.yaw))
    )
    from_start = np.hypot(poses[:, 0] - problem.start.x, poses[:, 1] - problem.start.y)
    required = problem.clearance.required_at(np.abs(back), from_start, start_clearance)
    distance, rows = pose_clearances(poses, problem.robot.footprint, problem.all_obstacles, float(required.max()))
    short = required - distance
    k = int(np.argmax(short))
    if not short[k] > _TOLERANCE:
        return None
    name = problem.all_obstacles.name_of(int(rows[k]))
    s = path.length - abs(float(back[k]))
    what = "at the goal" if back[k] == 0.0 else f"on the final straight, {abs(back[k]):.3f} m before the goal,"
    met = in_words(name)
    does = f"overlaps {met} by {-distance[k]:.4f} m" if distance[k] < 0.0 else f"is {distance[k]:.4f} m from {met}"
    message = f"{what} the footprint {does}, required are {required[k]:.4f} m"
    return Refusal("approach_blocked", s, float(short[k]), name, message, poses[k])


def refuse_search(nlp: NonlinearProgram, last: Iterate, final_straight: float) -> Refusal:
    """Which bound the search could not satisfy: the goal (through curvature and rate) or clearance.

    Args:
        nlp: What was searched for.
        last: How far it came.
        final_straight: Length of the straight run between the target of the search and the goal [m].
    """
    if not last.on_goal or last.clearance.margin.size == 0:
        return _unreachable(nlp, last, final_straight)
    k = int(np.argmin(last.clearance.margin))
    name = nlp.scene.obstacles.name_of(int(last.clearance.pairs.obstacle[k]))
    at = int(last.clearance.pairs.interval[k])
    s = float(last.rollout.steps[:at].sum())
    message = (
        f"the best path found comes {last.shortfall:.4f} m closer to {in_words(name)} than required at s = {s:.3f} m"
    )
    return Refusal("clearance", s, last.shortfall, name, message, last.rollout.poses[at])


def refuse_certificate(certificate: Certificate) -> Refusal:
    """The first violation that a certificate found in the result of a search."""
    broken = certificate.violations[0]
    obstacle = str(broken.where.get("obstacle", ""))
    return Refusal(broken.kind, broken.s, broken.amount, obstacle, broken.message)


def _unreachable(nlp: NonlinearProgram, last: Iterate, final_straight: float) -> Refusal:
    missed, turned = float(np.hypot(*last.end_error[:2])), abs(float(last.end_error[2]))
    bound = float(nlp.bounds.upper[: nlp.basis.num_knots].max())
    used = float(np.abs(last.variables.curvature).max()) / bound
    steered = float(np.abs(last.rollout.rate).max()) / nlp.bounds.rate
    tight = [name for name, share in (("curvature", used), ("curvature rate", steered)) if share > 0.97]
    tight += ["clearance"] if last.clearance.margin.size and last.clearance.margin.min() < 2e-3 else []
    target = f"the final straight, {final_straight:.3f} m before the goal," if final_straight > 0.0 else "the goal"
    message = f"the best path found in the gears of the raw path misses {target} by {missed:.3f} m and {turned:.3f} rad"
    message += f"; at the limit: {', '.join(tight)}" if tight else ""
    length = float(last.variables.lengths.sum())
    return Refusal("goal_unreachable", length, missed, "", message, last.rollout.poses[-1])
