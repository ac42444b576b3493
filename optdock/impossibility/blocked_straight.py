"""Proof that no motion exists because the final straight, with which every certified path ends, is blocked.

**Theorem.** Let `check_blocked_straight(proof, problem)` be proven. Then no path to the dock is certified for the
problem, because a certificate requires that the last `final_straight` metres lead straight into the dock, in a gear
that the dock allows (`path_rules`). A certified path therefore passes every pose on one of these straights, up to the
tolerance of the certificate. For each straight the proof names a pose that violates the certificate: the footprint
overlaps an obstacle, or its clearance is below the least clearance that any certificate requires at that pose
(`least_required`), by more than the tolerance.

The checker measures the clearances of these poses again, with shapely.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar, TypeAlias

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, Strict

from optdock.errors import InvalidFile
from optdock.geometry.obstacles import in_words
from optdock.geometry.pose import transform_points
from optdock.impossibility.proof import SLACK, ImpossibilityVerdict, least_required
from optdock.model.dock import DockDirection
from optdock.model.problem import ProblemFingerprint
from optdock.verification.clearance_kernel import compiled_clearances, end_clearances
from optdock.verification.path_rules import STRAIGHT_TOLERANCE
from optdock.verification.proximity import pose_clearance

if TYPE_CHECKING:
    from collections.abc import Mapping

    from optdock.geometry.arrays import FloatArray
    from optdock.model.problem import DockingProblem

__all__ = ["BlockedPose", "BlockedStraight", "check_blocked_straight", "prove_straight_blocked"]

_SPACING = 0.01  # [m] between the poses
_Number: TypeAlias = Annotated[float, Strict()]
_GEARS = {DockDirection.FORWARD: (1,), DockDirection.BACKWARD: (-1,), DockDirection.AUTO: (1, -1)}


@dataclass(frozen=True)
class BlockedPose:
    """A blocked pose on the straight of one gear.

    Args:
        gear: Gear in which the dock is entered, 1 or -1.
        before: Distance from the docked pose, along the straight [m].
        x: Position of the robot's origin [m].
        y: Position of the robot's origin [m].
        yaw: Heading [rad].
        clearance: Clearance of the robot, negative for an overlap [m].
        required: The least clearance that any certificate requires at this pose [m].
        obstacle: Name of the nearest obstacle.
    """

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(extra="ignore", allow_inf_nan=False)

    gear: Annotated[int, Strict(), Field(ge=-1, le=1)]
    before: _Number
    x: _Number
    y: _Number
    yaw: _Number
    clearance: _Number
    required: _Number
    obstacle: str

    def __str__(self) -> str:
        gear, met = "forward" if self.gear > 0 else "backward", in_words(self.obstacle)
        kept = f"overlaps {met} by {-self.clearance:.4f} m" if self.clearance < 0.0 else ""
        kept = kept or f"is {self.clearance:.4f} m from {met}, required {self.required:.4f} m"
        return f"{gear}, {self.before:.3f} m before it, the footprint {kept}"


@dataclass(frozen=True)
class BlockedStraight:
    """A blocked pose on each straight along which the dock may be entered.

    Args:
        poses: One pose for every gear that the dock allows.
        problem: Digests of the problem.
    """

    poses: tuple[BlockedPose, ...]
    problem: ProblemFingerprint

    @property
    def message(self) -> str:
        """The result in one sentence."""
        blocked = "; ".join(map(str, self.poses))
        message = f"no motion ends in the dock, because its final straight is blocked: {blocked}"
        if all(pose.clearance >= 0.0 for pose in self.poses):
            kept = max(pose.clearance for pose in self.poses)
            message += f"; up to {kept:.4f} m can be kept there, see clearance.dock_run"
        return message

    @property
    def where(self) -> dict[str, object]:
        """Details of the error: the pose with the least violation, its obstacle, clearance and required clearance."""
        least = min(self.poses, key=lambda pose: pose.required - pose.clearance)
        measured = {"clearance": least.clearance, "required": least.required}
        pose = [least.x, least.y, least.yaw]
        return {"reason": "approach_blocked", "pose": pose, "obstacle": least.obstacle, **measured}

    @property
    def bottleneck(self) -> None:
        """Always None, because the proof gives blocked poses instead of a bottleneck."""
        return

    def as_dict(self) -> dict[str, object]:
        """Return plain values for a plan file."""
        return {"straight": [vars(pose) for pose in self.poses], "problem": self.problem._asdict()}

    @classmethod
    def from_dict(cls, values: Mapping[str, object]) -> BlockedStraight:
        """Read the result of `as_dict`.

        Raises:
            InvalidFile: If an entry is missing or has the wrong type.
        """
        try:
            document = _Document.model_validate(values)
            return cls(document.straight, ProblemFingerprint(**document.problem))
        except (ValueError, TypeError) as error:  # pydantic's errors are ValueErrors
            raise InvalidFile(f"impossibility: {error}") from error


class _Document(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore", defer_build=True)

    straight: Annotated[tuple[BlockedPose, ...], Field(max_length=2)]
    problem: dict[str, str]


def prove_straight_blocked(problem: DockingProblem) -> BlockedStraight | None:
    """Return the proof that the final straight is blocked in every gear that the dock allows, or None.

    The clearances are measured at poses one centimetre apart, which takes about a millisecond.
    """
    straight, slack = problem.dock.final_straight, _slack(problem)
    if straight <= 0.0 or len(problem.all_obstacles) == 0:
        return None
    before = np.linspace(0.0, straight, math.ceil(straight / _SPACING) + 1)
    footprint, obstacles, found = problem.robot.footprint, problem.all_obstacles, []
    start_clearance = end_clearances(problem).start
    for gear in _GEARS[problem.dock.direction]:
        poses = _poses(gear, before, problem)
        required = least_required(problem, poses[:, 0], poses[:, 1], slack, start_clearance)
        clearance, row = compiled_clearances(poses, footprint, obstacles, float(required.max()) + slack)
        k = int((required - clearance).argmax())
        if not required[k] - clearance[k] > 2.0 * slack:
            return None
        name = obstacles.name_of(int(row[k]))
        (x, y, yaw), kept = poses[k].tolist(), float(clearance[k])
        found.append(BlockedPose(gear, float(before[k]), x, y, yaw, kept, float(required[k]), name))
    return BlockedStraight(tuple(found), problem.fingerprint)


def check_blocked_straight(proof: BlockedStraight, problem: DockingProblem) -> ImpossibilityVerdict:
    """Check a proof from any source against `problem`; all distances are measured again.

    Args:
        proof: Proof to be checked.
        problem: The planning problem.

    Returns:
        The verdict, in which `cells` is the number of checked poses.
    """
    import shapely

    fault = ""
    if not 0.0 < problem.dock.final_straight < math.inf:
        fault = "the dock requires no final straight"
    elif set(_GEARS[problem.dock.direction]) - {pose.gear for pose in proof.poses}:
        fault = "a gear that the dock allows is missing"
    elif not all(0.0 <= pose.before <= problem.dock.final_straight for pose in proof.poses):
        fault = "a pose is not on the final straight"
    if fault:
        return ImpossibilityVerdict(proven=False, reason=fault, cells=0)
    slack = _slack(problem)
    start_clearance, _ = pose_clearance(problem.start, problem.robot.footprint, problem.all_obstacles)
    tree = shapely.STRtree(shapely.polygons(problem.all_obstacles.vertices))
    for blocked in proof.poses:
        pose = _poses(blocked.gear, np.array([blocked.before]), problem)
        required = least_required(problem, pose[:, 0], pose[:, 1], slack, start_clearance)[0]
        outline = shapely.Polygon(transform_points(pose, problem.robot.footprint.vertices)[0])
        # Grown by the required clearance, or shrunk if that is less than the tolerance.
        within = float(required) - slack
        body = outline if within > 0.0 else outline.buffer(within, join_style="mitre")
        met = tree.query(body, predicate="dwithin", distance=within) if within > 0.0 else tree.query(body, "intersects")
        if body.is_empty or met.size == 0:
            reason = f"at {blocked.before:.3f} m from the dock the robot is free"
            return ImpossibilityVerdict(proven=False, reason=reason, cells=0)
    return ImpossibilityVerdict(proven=True, reason="", cells=len(proof.poses))


def _poses(gear: int, before: FloatArray, problem: DockingProblem) -> FloatArray:
    """Return the poses, Shape (n, 3), on the axis at the distances `before` from the dock, Shape (n,) [m]."""
    goal, back = problem.goal, -gear * before
    poses = np.empty((before.size, 3))
    poses[:, 0], poses[:, 1] = goal.x + back * math.cos(goal.yaw), goal.y + back * math.sin(goal.yaw)
    poses[:, 2] = goal.yaw
    return poses


def _slack(problem: DockingProblem) -> float:
    """Return the largest accepted deviation [m] of a point of the robot from its position on the exact straight."""
    return STRAIGHT_TOLERANCE * (1.0 + problem.robot.footprint.circumscribed_radius) + SLACK
