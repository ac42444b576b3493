"""`still_holds` checks in every cycle whether the rest of a running plan has the required clearance in a changed world.

The proof of the plan need not be repeated. While the clearance rule is the same, only new obstacles near the rest of
the path are examined: cells that have become blocked, and new polygons. The clearance rule is the rule of the plan's
    certificate.
"""

from __future__ import annotations

import functools
import operator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from optdock.deadline import never_late
from optdock.geometry.checked import exactly, finite_number
from optdock.geometry.obstacles import ObstacleSet, in_words
from optdock.model.cell_obstacles import added_obstacles, is_same_grid
from optdock.model.constant_jerk import constant_jerk
from optdock.model.costmap import Costmap
from optdock.model.problem import DockingProblem
from optdock.planning.plan import DockPlan
from optdock.verification import end_clearances
from optdock.verification.conservative_advancement import Begun, prove_clearance

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.geometry.arrays import FloatArray
    from optdock.model.trajectory import Trajectory
    from optdock.verification.conservative_advancement import ClearanceProof

__all__ = ["StillHolds", "still_holds"]

_NO_WAY = 1e-6  # [m]: shorter rests of a path are empty
_SPACING = 0.1  # [m] between the places by which near obstacles are found
_HALVINGS = 30  # of a phase: below a microsecond
_RULES = {"clearance", "footprint", "dock"}  # the proof does not hold if one of these has changed


@dataclass(frozen=True)
class StillHolds:
    """Result of `still_holds`; true if the clearance of the rest of the path is proven.

    Args:
        holds: Whether the clearance is proven.
        changed: Names of the parts that differ from the world of the plan's proof, out of `obstacles`, `costmap`,
            `dock`, `clearance`, `footprint`, `limits`, `frame`.
        at_s: Arc length of the first conflict on the plan's path [m]; None if there is no conflict.
        at_time: Time at which the plan's trajectory reaches that arc length [s].
        obstacle: The obstacle that is too close; empty if the proof was not completed.
        clearance: Clearance to that obstacle [m].
        required: Required clearance at that point [m].
        reason: Explanation of the conflict in one sentence; empty if the clearance is proven.
    """

    holds: bool
    changed: tuple[str, ...] = ()
    at_s: float | None = None
    at_time: float | None = None
    obstacle: str = ""
    clearance: float | None = None
    required: float | None = None
    reason: str = ""

    def __bool__(self) -> bool:
        return self.holds


def still_holds(
    plan: DockPlan,
    world: DockingProblem | Costmap | ObstacleSet,
    from_time: float = 0.0,
    *,
    is_late: Callable[[], bool] = never_late,
) -> StillHolds:
    """Check whether the rest of a running path has the required clearance in a new world.

    Only clearance is proven. If `changed` contains `dock` or `limits`, the caller must check whether the plan ends at
    the dock and whether its motion satisfies the limits.

    Args:
        plan: The running plan.
        world: A costmap, which replaces the plan's costmap including its border; or obstacles, which replace the plan's
            obstacles; or a whole problem, whose start is not used.
        from_time: Progress of the robot on the plan's trajectory [s].
        is_late: Polled between the rounds of the proof; parts not proven before it returns True remain unproven.

    Raises:
        InvalidValue: If an argument has the wrong class, which includes subclasses, or is not finite.
    """
    exactly(DockPlan, plan, "plan")
    from_time, known = finite_number(from_time, "from_time"), plan.problem
    obstacles, costmap, later = known.obstacles, known.costmap, known
    # Subclasses are refused, as in a problem: they may override the outline or the digest.
    if isinstance(world, Costmap):
        costmap = exactly(Costmap, world, "world")
    elif isinstance(world, ObstacleSet):
        obstacles = exactly(ObstacleSet, world, "world")
    else:
        exactly(DockingProblem, world, "world (a DockingProblem, a Costmap or an ObstacleSet)")
        obstacles, costmap, later = world.obstacles, world.costmap, world
    changed = _changed(known, later, obstacles, costmap)
    if "frame" in changed:
        reason = f"the world is in frame {later.frame!r}, the plan in {plan.frame!r}"
        return StillHolds(holds=False, changed=changed, reason=reason)
    if not set(changed) - {"limits"}:
        return StillHolds(holds=True, changed=changed)
    # At the end of the plan the pose of the robot at rest must also be clear.
    begin = min(float(plan.trajectory.sample_at(from_time).s[0]), max(0.0, plan.path.length - _NO_WAY))
    return _Change(plan, later, obstacles, costmap, changed).judged(begin, is_late)


@dataclass(frozen=True)
class _Change:
    """A running plan, and the new world with its differences from the world of the plan's proof."""

    plan: DockPlan
    later: DockingProblem
    obstacles: ObstacleSet
    costmap: Costmap | None
    changed: tuple[str, ...]

    def judged(self, begin: float, is_late: Callable[[], bool]) -> StillHolds:
        """Check the rest of the path, beyond `begin` [m], against the relevant obstacles."""
        known, later = self.plan.problem, self.later
        rest = self.plan.path.piece(begin)
        count = max(2, int(np.ceil(rest.length / _SPACING)) + 1)
        places = rest.poses_at(np.linspace(0.0, rest.length, count))[:, :2]
        reach = later.robot.footprint.circumscribed_radius + later.path_clearance.required + _SPACING
        is_ruled_anew = bool(set(self.changed) & _RULES)
        near = later.all_obstacles.near(places, reach) if is_ruled_anew else self._new(places, reach)
        if len(near) == 0:
            return StillHolds(holds=True, changed=self.changed)
        begun, relief = Begun(known.start, end_clearances(known).start), self.plan.certificate.start_relief
        proof = prove_clearance(rest, later, is_late, relief, obstacles=near, begun=begun, sharp=False)
        if proof.holds and proof.proven < 0.0 and not is_ruled_anew:
            # A new obstacle is touched; together with known ones it may hide an overlap.
            near = near + known.all_obstacles.near(places, reach)
            proof = prove_clearance(rest, later, is_late, relief, obstacles=near, begun=begun, sharp=False)
        return StillHolds(holds=True, changed=self.changed) if proof.holds else self._conflict(proof, begin, near)

    def _new(self, places: FloatArray, reach: float) -> ObstacleSet:
        """Return the obstacles near the path that did not exist when the plan was proven."""
        known, later, found = self.plan.problem, self.later, list[ObstacleSet]()
        if "obstacles" in self.changed:
            found.append(_without(self.obstacles.near(places, reach), known.obstacles))
        if "costmap" in self.changed and self.costmap is not None:
            unknown = later.unknown_is_obstacle
            before = known.costmap if unknown == known.unknown_is_obstacle else None
            found.append(added_obstacles(self.costmap, before, places, reach, unknown_is_obstacle=unknown))
        found = [some for some in found if len(some)]
        return functools.reduce(operator.add, found) if found else ObstacleSet.empty()

    def _conflict(self, proof: ClearanceProof, begin: float, near: ObstacleSet) -> StillHolds:
        """Return the first conflict of a proof that failed."""
        found = StillHolds(holds=False, changed=self.changed)
        if len(proof.violations):
            s, clearance, required, row = proof.violations[np.argmin(proof.violations[:, 0]), :4].tolist()
            obstacle = near.name_of(int(row))
            found = replace(found, obstacle=obstacle, clearance=clearance, required=required)
            reason = f"{clearance:.4f} m from {in_words(obstacle)} at s = {begin + s:.3f} m, required {required:.4f} m"
        else:
            s, short = proof.unproven[np.argmin(proof.unproven[:, 0])].tolist()
            reason = f"the clearance near s = {begin + s:.3f} m is not proven; the bound is {-short:.3g} m short"
        when = _time_at(self.plan.trajectory, begin + s)
        return replace(found, at_s=begin + s, at_time=when, reason=reason)


def _changed(
    known: DockingProblem, later: DockingProblem, obstacles: ObstacleSet, costmap: Costmap | None
) -> tuple[str, ...]:
    """Return the names of the differences, in the order of `StillHolds.changed`."""
    differs = {
        "obstacles": obstacles is not known.obstacles and obstacles.digest != known.obstacles.digest,
        "costmap": _is_another(costmap, known.costmap)
        or (costmap is not None and later.unknown_is_obstacle != known.unknown_is_obstacle),
    }
    if later is not known:
        before, after = known.dock, later.dock
        outlines = [dock.footprint and dock.footprint.vertices.tobytes() for dock in (before, after)]
        differs["dock"] = before is not after and (before.pose != after.pose or outlines[0] != outlines[1])
        differs["clearance"] = known.path_clearance != later.path_clearance  # with the tube
        if known.robot is not later.robot:
            was, now = known.robot.fingerprint, later.robot.fingerprint
            differs |= {"footprint": was.footprint != now.footprint, "limits": was.limits != now.limits}
        differs["frame"] = known.frame != later.frame
    return tuple(name for name, differ in differs.items() if differ)


def _is_another(first: Costmap | None, second: Costmap | None) -> bool:
    if first is None or second is None or first is second:
        return first is not second
    return not (is_same_grid(first, second) and np.array_equal(first.data, second.data))


def _without(obstacles: ObstacleSet, known: ObstacleSet) -> ObstacleSet:
    """Return the pieces that are not among the known pieces, compared by their corners."""
    if obstacles.vertices.shape[1] != known.vertices.shape[1]:
        return obstacles
    pieces = {piece.tobytes() for piece in known.vertices}
    return obstacles.subset(np.array([piece.tobytes() not in pieces for piece in obstacles.vertices], dtype=np.bool_))


def _time_at(trajectory: Trajectory, s: float) -> float:
    """Return the time [s] at which a trajectory first reaches an arc length of its path."""
    law = trajectory.time_law
    phase = int(np.clip(np.searchsorted(law.states[:, 0], s) - 1, 0, law.durations.size - 1))
    low, high = 0.0, float(law.durations[phase])
    at, speed, acceleration = law.states[phase].tolist()
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        reached = constant_jerk(middle, at, speed, acceleration, float(law.jerks[phase]))[0]
        low, high = (middle, high) if reached < s else (low, middle)
    return float(law.times[phase]) + high
