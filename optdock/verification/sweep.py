"""How long a footprint can move at a constant body velocity before it comes too close to an obstacle.

Between two looks at the scene the same bound holds as in `clearance`: along the axis n that attains the distance d, a
footprint vertex v moves by at least `n.v' dt - M dt^2 / 2`. At a constant twist v' is known exactly and
M = |yaw rate| * |v'|, constant in time, so the longest safe step has a closed form. A straight motion needs one step.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.pose import transform_points
from optdock.geometry.separation import separation
from optdock.verification.seams import joined_bodies

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from optdock.geometry.footprint import Footprint
    from optdock.geometry.pose import Pose2, Twist2
    from optdock.geometry.separation import ConvexBody
    from optdock.obstacles import ObstacleSet

__all__ = ["Sweep", "free_motion"]

_SLACK = 1e-6  # [m]: lets a motion run along an obstacle at exactly the required clearance
_SHALLOW = 0.01  # [m]: overlap of a robot at rest in its dock; a motion may lead out of it, not deeper
_SHORTEST_STEP = 1e-4  # [s]: when no longer step can be proven, the motion counts as blocked
_MOST_STEPS = 2000


class Sweep(NamedTuple):
    """`free`: how long the motion is proven free [s]; `row`: the obstacle in the way, -1 when there is none."""

    free: float
    row: int


def free_motion(
    footprint: Footprint, obstacles: ObstacleSet, pose: Pose2, twist: Twist2, duration: float, clearance: float = 0.0
) -> Sweep:
    """How long the footprint keeps its clearance from every obstacle, everywhere along the continuous motion.

    An obstacle that is closer than `clearance` at the start, or overlaps by up to 1 cm, must not come any closer
    instead: a robot in its dock may leave. With a deeper overlap nothing is free.

    Args:
        footprint: The robot's outline.
        obstacles: What it must not touch.
        pose: Where it starts.
        twist: Its body velocity, constant.
        duration: How long to look [s].
        clearance: Distance to keep [m].
    """
    reach = footprint.circumscribed_radius + math.hypot(twist.linear, twist.lateral) * duration + clearance + _SLACK
    near = np.flatnonzero(obstacles.box_distance(pose.as_array()[None, :2])[0] <= reach)
    if near.size == 0:
        return Sweep(duration, -1)
    scene = obstacles.subset(near)
    start = np.min([_distances(body, scene, pose) for body in joined_bodies(footprint)], axis=0)
    required = np.minimum(clearance, start)
    if float(required.min()) < -_SHALLOW:
        return Sweep(0.0, int(near[int(np.argmin(required))]))
    time, blocking = 0.0, -1
    for _ in range(_MOST_STEPS):
        steps = np.min([_safe_steps(body, scene, pose, twist, required) for body in joined_bodies(footprint)], axis=0)
        blocking = int(np.argmin(steps))
        step = float(steps[blocking])
        if time + step >= duration:
            return Sweep(duration, -1)
        if step < _SHORTEST_STEP:
            break
        time, pose = time + step, pose.moved(twist, step)
    return Sweep(time, int(near[blocking]))


def _distances(body: ConvexBody, scene: ObstacleSet, pose: Pose2) -> FloatArray:
    poses = np.repeat(pose.as_array()[None], len(scene), axis=0)
    return separation(body, poses, scene.pieces(np.arange(len(scene)))).distance


def _safe_steps(body: ConvexBody, scene: ObstacleSet, pose: Pose2, twist: Twist2, required: FloatArray) -> FloatArray:
    """For every obstacle the longest step that provably keeps its required distance, Shape (m,) [s]."""
    poses = np.repeat(pose.as_array()[None], len(scene), axis=0)
    found = separation(body, poses, scene.pieces(np.arange(len(scene))))
    points = transform_points(poses[:1], body.vertices)[0]  # (k, 2)
    arm = points - np.array([pose.x, pose.y])
    c, s = math.cos(pose.yaw), math.sin(pose.yaw)
    forward = np.array([c * twist.linear - s * twist.lateral, s * twist.linear + c * twist.lateral])
    velocity = forward + twist.angular * np.column_stack((-arm[:, 1], arm[:, 0]))  # (k, 2)
    bend = abs(twist.angular) * float(np.max(np.hypot(velocity[:, 0], velocity[:, 1])))
    height, rise = found.axis @ points.T, found.axis @ velocity.T  # (m, k)
    spare = height - height.min(axis=1, keepdims=True) + np.maximum(found.distance - required + _SLACK, 0.0)[:, None]
    steps: FloatArray = _time_until_spent(spare, rise, bend).min(axis=1)
    return steps


def _time_until_spent(spare: FloatArray, rise: FloatArray, bend: float) -> FloatArray:
    """The positive root of `spare + rise t - bend t^2 / 2`; infinite where there is none."""
    falling = rise < 0.0
    with np.errstate(divide="ignore"):
        if bend <= 0.0:
            straight: FloatArray = np.where(falling, spare / np.maximum(-rise, 1e-300), np.inf)
            return straight
        root = np.sqrt(rise * rise + 2.0 * bend * spare)
        # Each branch is the form of the root that does not cancel for its sign of the rise.
        bent: FloatArray = np.where(falling, 2.0 * spare / (root - rise), (rise + root) / bend)
    return bent
