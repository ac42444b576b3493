"""Time of impact: the time after which a footprint at constant body velocity is too close to an obstacle.

Between two evaluations of the scene the bound of `conservative_advancement` holds: along the axis n that attains the
distance d, a footprint vertex v moves by at least `n.v' dt - M dt^2 / 2`. At a constant twist v' is known exactly and M
= |yaw rate| * |v'| is constant in time, so the longest safe step has a closed form. A straight motion needs only one
step.

If pieces may touch, their unions are checked as in `contact_tolerance`: a needle between two adjacent obstacles, or a
post in a fan of thin pieces, must not penetrate them by more than 3 micrometres.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.obstacles import box_distance
from optdock.geometry.pose import transform_points
from optdock.geometry.separation import separation
from optdock.verification.certificate import TOLERANCE
from optdock.verification.contact_tolerance import deep_pairs

if TYPE_CHECKING:
    from collections.abc import Sequence

    from optdock.geometry.arrays import FloatArray
    from optdock.geometry.footprint import Footprint
    from optdock.geometry.obstacles import ObstacleSet
    from optdock.geometry.pose import Pose2, Twist2
    from optdock.geometry.separation import ConvexBody

__all__ = ["Sweep", "free_motion"]

_APART = 2.0 * TOLERANCE  # [m]: pieces at this distance do not overlap, neither individually nor as unions
_SHALLOW = 0.01  # [m]: overlap of a robot at rest in its dock; a motion may reduce it but not increase it
_SHORTEST_STEP = 1e-4  # [s]: if no longer step can be proven, the motion counts as blocked
_MOST_STEPS = 2000


class Sweep(NamedTuple):
    """`free`: proven collision-free duration [s]; `row`: row of the obstacle in the way, -1 if there is none."""

    free: float
    row: int


def free_motion(  # noqa: PLR0913, PLR0917 - robot, scene, motion and tolerances
    footprint: Footprint,
    obstacles: ObstacleSet,
    pose: Pose2,
    twist: Twist2,
    duration: float,
    clearance: float = 0.0,
    overlap: float = _SHALLOW,
) -> Sweep:
    """Return the duration for which the footprint has the required clearance along the continuous motion.

    If an obstacle is closer than `clearance` at the start, or overlaps by up to `overlap`, the motion is only required
    not to come closer, so that a robot can leave its dock. With a deeper overlap the duration is 0.

    Args:
        footprint: Outline of the robot.
        obstacles: The obstacles.
        pose: Initial pose.
        twist: Constant body velocity.
        duration: Horizon [s].
        clearance: Required distance from the obstacles [m].
        overlap: Accepted overlap at the start [m].
    """
    reach = footprint.circumscribed_radius + math.hypot(twist.linear, twist.lateral) * duration + clearance + TOLERANCE
    centre = np.array([pose.x, pose.y])
    near = np.flatnonzero(box_distance(obstacles, centre[None])[0] <= reach)
    if near.size == 0:
        return Sweep(duration, -1)
    scene = obstacles.subset(near)
    start = _distances(footprint.bodies, scene, pose)
    if float(start.min()) < -overlap:
        return Sweep(0.0, int(near[int(np.argmin(start))]))
    pieces = _Group(footprint.bodies, scene, np.minimum(clearance, start))
    may_touch = float(start.min()) < _APART
    if not may_touch and clearance < _APART:
        apart = pieces._replace(required=np.full(near.size, _APART))
        if _march((apart,), pose, twist, duration)[0] >= duration:
            return Sweep(duration, -1)
        may_touch = True
    deep = deep_pairs(footprint, scene, centre - reach, centre + reach) if may_touch else ()
    # The unions must not overlap, or not more than at the start.
    groups = (
        pieces,
        *(_Group(bodies, rocks, np.minimum(0.0, _distances(bodies, rocks, pose))) for bodies, rocks in deep),
    )
    free, end = _march(groups, pose, twist, duration)
    if free >= duration:
        return Sweep(duration, -1)
    ahead = _distances(footprint.bodies, scene, end.moved(twist, _SHORTEST_STEP)) - pieces.required
    return Sweep(free, int(near[int(np.argmin(ahead))]))


class _Group(NamedTuple):
    """Bodies that move together, their obstacles, and the required distance from each obstacle, Shape (m,) [m]."""

    bodies: tuple[ConvexBody, ...]
    scene: ObstacleSet
    required: FloatArray


def _march(groups: Sequence[_Group], pose: Pose2, twist: Twist2, duration: float) -> tuple[float, Pose2]:
    """Return how long [s] every group has the required distances, at most `duration` [s], and the final pose."""
    time = 0.0
    for _ in range(_MOST_STEPS):
        step = min(
            float(_safe_steps(body, group.scene, pose, twist, group.required).min())
            for group in groups
            for body in group.bodies
        )
        if time + step >= duration:
            return duration, pose
        if step < _SHORTEST_STEP:
            break
        time, pose = time + step, pose.moved(twist, step)
    return time, pose


def _distances(bodies: tuple[ConvexBody, ...], scene: ObstacleSet, pose: Pose2) -> FloatArray:
    """Return the signed distance of the nearest body to every obstacle, Shape (m,) [m]."""
    poses = np.repeat(pose.as_array()[None], len(scene), axis=0)
    pieces = scene.pieces(np.arange(len(scene)))
    nearest: FloatArray = np.min([separation(body, poses, pieces).distance for body in bodies], axis=0)
    return nearest


def _safe_steps(body: ConvexBody, scene: ObstacleSet, pose: Pose2, twist: Twist2, required: FloatArray) -> FloatArray:
    """Return for every obstacle the longest step for which the required distance is proven. Shape (m,) [s]."""
    poses = np.repeat(pose.as_array()[None], len(scene), axis=0)
    found = separation(body, poses, scene.pieces(np.arange(len(scene))))
    points = transform_points(poses[:1], body.vertices)[0]  # (k, 2)
    arm = points - np.array([pose.x, pose.y])
    c, s = math.cos(pose.yaw), math.sin(pose.yaw)
    forward = np.array([c * twist.linear - s * twist.lateral, s * twist.linear + c * twist.lateral])
    velocity = forward + twist.angular * np.column_stack((-arm[:, 1], arm[:, 0]))  # (k, 2)
    bend = abs(twist.angular) * float(np.max(np.hypot(velocity[:, 0], velocity[:, 1])))
    height, rise = found.axis @ points.T, found.axis @ velocity.T  # (m, k)
    spare = height - height.min(axis=1, keepdims=True) + np.maximum(found.distance - required + TOLERANCE, 0.0)[:, None]
    steps: FloatArray = _time_until_spent(spare, rise, bend).min(axis=1)
    return steps


def _time_until_spent(spare: FloatArray, rise: FloatArray, bend: float) -> FloatArray:
    """Return the positive root of `spare + rise t - bend t^2 / 2`; infinite if there is none."""
    falling = rise < 0.0
    with np.errstate(divide="ignore"):
        if bend <= 0.0:
            straight: FloatArray = np.where(falling, spare / np.maximum(-rise, 1e-300), np.inf)
            return straight
        root = np.sqrt(rise * rise + 2.0 * bend * spare)
        # Each branch is the form of the root without cancellation for its sign of the rise.
        bent: FloatArray = np.where(falling, 2.0 * spare / (root - rise), (rise + root) / bend)
    return bent
