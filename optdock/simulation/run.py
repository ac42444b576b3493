"""What a simulated run leaves behind: its record, its errors, the clearance of its poses."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from optdock.geometry.arrays import FloatArray, FrozenArrays, frozen_array, readonly
from optdock.geometry.obstacles import box_distance, in_words
from optdock.geometry.pose import pose_errors
from optdock.geometry.separation import separation
from optdock.samples.tube import Tube
from optdock.verification import TOLERANCE, end_clearances, pose_clearances

if TYPE_CHECKING:
    from collections.abc import Mapping

    from optdock.geometry.arrays import IntArray
    from optdock.geometry.footprint import Footprint
    from optdock.geometry.obstacles import ObstacleSet
    from optdock.geometry.pose import Pose2
    from optdock.model.path import Path
    from optdock.model.problem import DockingProblem
    from optdock.verification import Certificate

__all__ = ["Run", "beyond_proof", "executed_clearance"]

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
            `obstacles`; empty where it is the same, or the trajectory is not certified.

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


def beyond_proof(path: Path, problem: DockingProblem, certificate: Certificate, poses: FloatArray) -> str:
    """In what poses that were driven left what is proven of a path, in words; empty where they did not.

    They left it where any is displaced by more than the tracking tube is wide, `Robot.tracking`, if there is one; or
    where the outline is nearer to something than the problem's clearance requires there. In front of the dock the tube
    is narrower than that, as the required clearance is; there, and without a tube, the clearance alone decides. Where
    the dock's tolerances count the robot as docked, it may press its station as far as a bumper yields.

    Args:
        path: What was to be driven.
        problem: What it was proven for.
        certificate: The proof.
        poses: True, Shape (n, 3).
    """
    width, said = certificate.tube, []
    to_go = np.hypot(poses[:, 0] - problem.goal.x, poses[:, 1] - problem.goal.y)
    if width > 0.0:
        moved = Tube(path, problem, certificate.start_relief).deviations(poses).displacement
        worst = int(np.argmax(moved))
        if moved[worst] > width:
            off, wide = f"{1e3 * moved[worst]:.1f} mm off the path", f"the tube is {1e3 * width:.1f} mm wide"
            said.append(f"{off} {to_go[worst]:.3f} m before the dock, {wide}")
    from_start = np.hypot(poses[:, 0] - problem.start.x, poses[:, 1] - problem.start.y)
    begun, relief = end_clearances(problem).start, certificate.start_relief
    required = problem.clearance.required_at(to_go, from_start, begun, relief)
    obstacles, within = problem.all_obstacles, float(np.max(required)) + TOLERANCE
    blocks = np.array_split(poses, -(-len(poses) // _BLOCK))
    found = [pose_clearances(block, problem.robot.footprint, obstacles, within) for block in blocks]
    clearance, nearest = (np.concatenate(columns) for columns in zip(*found, strict=True))
    is_station = np.array([row >= 0 and obstacles.name_of(row) == "dock" for row in nearest.tolist()])
    accepted = problem.dock.tolerances
    pressed = is_station & (to_go <= math.hypot(accepted.along, accepted.cross))
    required = np.where(pressed, problem.clearance.at_dock, required)
    short = required - clearance - np.where(pressed, _BUMPER, TOLERANCE)
    worst = int(np.argmax(short))
    if short[worst] > 0.0:
        near = in_words(obstacles.name_of(int(nearest[worst])))
        asked = f"required are {required[worst]:.4f} m"
        said.append(f"{clearance[worst]:.4f} m from {near} {to_go[worst]:.3f} m before the dock, {asked}")
    return " and ".join(said)


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
        at_least = box_distance(obstacles, block[:, :2]) - footprint.circumscribed_radius
        nearest = np.unravel_index([int(np.argmin(at_least))], at_least.shape)
        best = min(best, _smallest(footprint, block, obstacles, nearest))
        best = min(best, _smallest(footprint, block, obstacles, np.nonzero(at_least < best)))
    return best


def _smallest(footprint: Footprint, poses: FloatArray, obstacles: ObstacleSet, pairs: tuple[IntArray, ...]) -> float:
    """Smallest distance over (pose, obstacle) pairs; infinite without pairs."""
    rows, pieces = pairs[0], obstacles.pieces(pairs[1])
    found = [separation(body, poses[rows], pieces).distance for body in footprint.bodies]
    return float(np.min(np.concatenate(found), initial=np.inf))
