"""What a simulated run leaves behind: its record, its errors, the clearance of its poses."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from optdock.geometry.arrays import FloatArray, FrozenArrays, frozen_array, readonly
from optdock.geometry.pose import pose_errors
from optdock.geometry.separation import separation

if TYPE_CHECKING:
    from collections.abc import Mapping

    from optdock.geometry.arrays import IntArray
    from optdock.geometry.footprint import Footprint
    from optdock.geometry.pose import Pose2
    from optdock.obstacles import ObstacleSet

__all__ = ["Run", "executed_clearance"]

_BUMPER = 0.002  # [m]: a dock that is planned to be touched is pressed by so much without harm
_BLOCK = 256  # poses per round, bounds the memory


@dataclass(frozen=True, eq=False)
class Run(FrozenArrays):
    """One closed-loop run; it counts as true where it docked.

    Row k is the state at `times[k]` and the command given there.

    Args:
        times: Shape (n,) [s].
        poses: True poses, Shape (n, 3).
        measured: What the controller was told, Shape (n, 3).
        commands: Linear and angular, Shape (n, 2) [m/s, rad/s]; zero in the last row.
        twists: True body velocities, Shape (n, 2) [m/s, rad/s].
        references: Poses of the trajectory at the same times, Shape (n, 3).
        goal: Where the robot should end.
        docked: Whether the goal checker said so.
        reason: Why not; empty when docked.
        verdicts: What each goal checker said at the end, the one that decides first, by name.
        min_clearance: Smallest clearance of the true poses [m]; None where no obstacles were given.
        differs: In what the run's world is not the one that the trajectory was certified for: `footprint`, `limits`,
            `obstacles`; empty where it is the same, or nobody certified the trajectory.

    Attributes:
        errors: True pose minus reference in the reference's frame: along, cross [m] and yaw [rad], Shape (n, 3).
        final_error: The last true pose seen from the goal: along, cross [m], yaw [rad].
    """

    times: FloatArray
    poses: FloatArray
    measured: FloatArray
    commands: FloatArray
    twists: FloatArray
    references: FloatArray
    goal: Pose2
    docked: bool
    reason: str = ""
    min_clearance: float | None = None
    verdicts: Mapping[str, bool] = field(default_factory=dict)
    differs: tuple[str, ...] = ()
    errors: FloatArray = field(init=False, repr=False)
    final_error: Pose2 = field(init=False)

    def __post_init__(self) -> None:
        columns = {"poses": 3, "measured": 3, "commands": 2, "twists": 2, "references": 3}
        object.__setattr__(self, "times", frozen_array(self.times, "run.times"))
        for name, count in columns.items():
            object.__setattr__(self, name, frozen_array(getattr(self, name), f"run.{name}", columns=count))
        object.__setattr__(self, "errors", readonly(pose_errors(self.poses, self.references)))
        last = pose_errors(self.poses[-1:], self.goal.as_array()[None])[0]
        object.__setattr__(self, "final_error", type(self.goal)(*last.tolist()))

    def __bool__(self) -> bool:
        return self.docked

    @property
    def collided(self) -> bool:
        """Whether the footprint went into an obstacle deeper than a bumper yields."""
        return self.min_clearance is not None and self.min_clearance < -_BUMPER

    @property
    def fault(self) -> str:
        """What is wrong with the run, a collision before all else; empty when the robot docked without one."""
        if self.collided:
            return f"collided: the footprint went {-(self.min_clearance or 0.0):.4f} m into an obstacle"
        return "" if self.docked else f"not docked: {self.reason}"

    @property
    def duration(self) -> float:
        """Time until docked, or until the run was given up [s]."""
        return float(self.times[-1])


def executed_clearance(footprint: Footprint, poses: FloatArray, obstacles: ObstacleSet) -> float:
    """Smallest signed distance between the footprint at any of the poses and any obstacle [m].

    Exact at the poses; what happens between them is not looked at (a certificate's duty).

    Args:
        footprint: The robot's outline.
        poses: Shape (n, 3).
        obstacles: What it must not touch; without any the clearance is infinite.
    """
    best = np.inf
    if len(obstacles) == 0:
        return best
    for block in np.array_split(poses, max(1, -(-len(poses) // _BLOCK))):
        at_least = obstacles.box_distance(block[:, :2]) - footprint.circumscribed_radius
        nearest = np.unravel_index([int(np.argmin(at_least))], at_least.shape)
        best = min(best, _smallest(footprint, block, obstacles, nearest))
        best = min(best, _smallest(footprint, block, obstacles, np.nonzero(at_least < best)))
    return best


def _smallest(footprint: Footprint, poses: FloatArray, obstacles: ObstacleSet, pairs: tuple[IntArray, ...]) -> float:
    """Smallest distance over (pose, obstacle) pairs; infinite without pairs."""
    rows, pieces = pairs[0], obstacles.pieces(pairs[1])
    found = [separation(body, poses[rows], pieces).distance for body in footprint.bodies]
    return float(np.min(np.concatenate(found), initial=np.inf))
