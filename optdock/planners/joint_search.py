"""Step 6 of the dock planner: where, and how, segment 1 joins the approach axis."""

from __future__ import annotations

from enum import IntEnum
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray, IntArray

__all__ = ["Joint", "JointKind", "find_joint", "interior_angles"]

_SAME_DISTANCE = 1e-9  # [m]; decides ties alike in every frame
_SAME_ANGLE = 1e-9  # [rad]
_ON_AXIS = 1e-6  # [m]
_REVERSE_SLACK = 0.05  # [rad], of the source


class JointKind(IntEnum):
    """The source's `dir`."""

    TOWARD = 1  # turns onto the axis toward the dock, tangent at the end
    AWAY = -1  # turns onto the axis away from the dock, then changes gear
    CORNER = 0  # drives straight to the axis and turns there


class Joint(NamedTuple):
    """How segment 1 reaches the axis.

    `dir`, the index `middle` on the centreline where its middle control point lies (-1 for none), and its three control
    points, Shape (3, 2) [m].
    """

    dir: JointKind
    middle: int
    control_points: FloatArray


def find_joint(start: FloatArray, centreline: FloatArray, angle_threshold: float) -> Joint:
    """The joint of segment 1, tried in the order TOWARD, AWAY, CORNER.

    A start on the axis needs no turn and goes straight to C even where C is too near for the sampled search.

    Args:
        start: Position A, Shape (2,) [m].
        centreline: Samples of the straight line from C to F, Shape (n, 2) [m], n >= 2.
        angle_threshold: Smallest interior angle between the rays from the joint to A and along the axis [rad].
    """
    distance = np.hypot(*(centreline - start).T)
    nearest = int(np.argmax(distance <= distance.min() + _SAME_DISTANCE))
    toward = _first_wide(start, centreline, np.arange(nearest, 0, -1), centreline[0], angle_threshold)
    if toward is not None and _fits(distance[toward], centreline[toward], centreline[0]):
        return _toward(start, centreline, toward, distance[toward])
    if _distance_to_line(start, centreline) <= _ON_AXIS:
        return Joint(JointKind.TOWARD, 0, _straight(start, centreline[0]))
    indices = np.arange(nearest, len(centreline))
    away = _first_wide(start, centreline, indices, centreline[-1], angle_threshold - _REVERSE_SLACK)
    if away is not None and _fits(distance[away], centreline[away], centreline[-1]):
        return Joint(JointKind.AWAY, away, np.array([start, centreline[away], centreline[-1]]))
    return Joint(JointKind.CORNER, -1, _straight(start, centreline[nearest]))


def interior_angles(at: FloatArray, first: FloatArray, second: FloatArray) -> FloatArray:
    """Angles in [0, pi] at points `at`, Shape (n, 2), between the rays to two points; 0 where a ray has no length.

    >>> interior_angles(np.zeros((1, 2)), np.array([0.0, 2.0]), np.array([-1.0, 0.0])) / np.pi
    array([0.5])
    """
    a, b = first - at, second - at
    cross = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    angles: FloatArray = np.arctan2(cross, np.sum(a * b, axis=1))
    return angles


def _first_wide(
    start: FloatArray, centreline: FloatArray, indices: IntArray, end: FloatArray, threshold: float
) -> int | None:
    """The first of `indices` whose angle between the rays to start and to `end` reaches the threshold."""
    at = centreline[indices]
    real = np.hypot(*(at - start).T) > _SAME_DISTANCE  # a ray of rounding noise has no angle
    wide = (interior_angles(at, start, end) >= threshold - _SAME_ANGLE) & real
    return int(indices[np.argmax(wide)]) if wide.any() else None


def _fits(leg: float, joint: FloatArray, end: FloatArray) -> bool:
    """Whether the run-in from the joint to `end` is at least as long as the way to the joint."""
    return bool(np.hypot(*(end - joint)) >= leg - _SAME_DISTANCE)


def _toward(start: FloatArray, centreline: FloatArray, index: int, leg: float) -> Joint:
    """Equal legs, to one sample: an arc that ends tangent to the axis."""
    ahead = centreline[index::-1]
    far = np.hypot(*(ahead - centreline[index]).T) >= leg - _SAME_DISTANCE
    end = ahead[int(np.argmax(far))]
    return Joint(JointKind.TOWARD, index, np.array([start, centreline[index], end]))


def _straight(start: FloatArray, end: FloatArray) -> FloatArray:
    return np.array([start, 0.5 * (start + end), end])


def _distance_to_line(point: FloatArray, line: FloatArray) -> float:
    along = line[-1] - line[0]
    away = point - line[0]
    return abs(float(along[0] * away[1] - along[1] * away[0])) / float(np.hypot(*along))
