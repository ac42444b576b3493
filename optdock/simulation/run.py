"""What a simulated run leaves behind."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from optdock.geometry.arrays import FloatArray, frozen_array, readonly

if TYPE_CHECKING:
    from collections.abc import Mapping

    from optdock.geometry.pose import Pose2

__all__ = ["Run", "pose_errors"]

_BUMPER = 0.002  # [m]: a dock that is planned to be touched is pressed by so much without harm


@dataclass(frozen=True, eq=False)
class Run:
    """One closed-loop run; row k is the state at `times[k]` and the command given there.

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


def pose_errors(poses: FloatArray, references: FloatArray) -> FloatArray:
    """Poses seen from their references, yaw in (-pi, pi]. Shape (n, 3) each."""
    delta = poses - references
    c, s = np.cos(references[:, 2]), np.sin(references[:, 2])
    yaw = np.pi - np.mod(np.pi - delta[:, 2], 2.0 * np.pi)
    return np.column_stack((c * delta[:, 0] + s * delta[:, 1], c * delta[:, 1] - s * delta[:, 0], yaw))
