"""SE(2): poses, twists and angles.

Conventions: SI units, x forward, y left, yaw counter-clockwise in radians. An array of poses has Shape (n, 3) with the
columns x [m], y [m], yaw [rad].
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from optdock.errors import InvalidValue
from optdock.geometry.checked import finite_number

if TYPE_CHECKING:
    from collections.abc import Sequence

    from optdock.geometry.arrays import FloatArray

__all__ = [
    "FARTHEST",
    "MOST_TURNED",
    "Pose2",
    "Twist2",
    "arc_end",
    "check_range",
    "displacement",
    "normalize_angle",
    "pose_errors",
    "transform_points",
    "unwrap_yaw",
    "wrap_angles",
]

Number = TypeVar("Number", float, "FloatArray")

FARTHEST = 1e8  # [m], largest coordinate: the spacing of floats is then 15 nm, and no map on earth is larger
MOST_TURNED = 1e6  # [rad], largest yaw: the spacing of floats is then 1e-10 rad


def check_range(poses: FloatArray, name: str) -> None:
    """Check that poses, Shape (n, 3), are within the range in which floats have sufficient resolution.

    Raises:
        InvalidValue: If a coordinate is beyond 1e8 m or a yaw beyond 1e6 rad.
    """
    x, y, turned = np.abs(poses[:, :3]).max(axis=0, initial=0.0).tolist()
    if x <= FARTHEST and y <= FARTHEST and turned <= MOST_TURNED:
        return
    for found, most, unit in ((x, FARTHEST, "m"), (y, FARTHEST, "m"), (turned, MOST_TURNED, "rad")):
        if not found <= most:
            what = "coordinates" if unit == "m" else "yaws"
            raise InvalidValue(f"{name}: {what} must be within +-{most:g} {unit}, got {found:g}")


def normalize_angle(angle: float) -> float:
    """Return the equivalent angle in (-pi, pi] [rad].

    >>> normalize_angle(3 * math.pi) == math.pi
    True
    """
    wrapped = math.remainder(angle, 2.0 * math.pi)
    return math.pi if wrapped == -math.pi else wrapped


def wrap_angles(angles: FloatArray) -> FloatArray:
    """Return the equivalent angles in [-pi, pi), for an array of any shape [rad]."""
    wrapped: FloatArray = np.remainder(angles + np.pi, 2.0 * np.pi) - np.pi
    return wrapped


def unwrap_yaw(yaw: FloatArray) -> FloatArray:
    """Return yaws shifted by whole turns, such that consecutive values differ by at most pi. Shape (n,) [rad]."""
    if yaw.size < 2 or np.abs(yaw[1:] - yaw[:-1]).max() < np.pi:
        return yaw + 0.0
    return np.asarray(np.unwrap(yaw), dtype=np.float64)


def arc_end(
    x: float, y: float, yaw: float, twist: tuple[float, float, float], duration: float
) -> tuple[float, float, float]:
    """Compute `Pose2.moved` on plain floats; the body velocity is (linear, angular, lateral)."""
    linear, angular, lateral = twist
    turn = angular * duration
    half = 0.5 * turn
    shrink = duration * (math.sin(half) / half if abs(half) > 1e-9 else 1.0)
    chord, side, heading = shrink * linear, shrink * lateral, yaw + half
    c, s = math.cos(heading), math.sin(heading)
    return x + chord * c - side * s, y + chord * s + side * c, yaw + turn


@dataclass(frozen=True, slots=True)
class Pose2:
    """A pose in the plane; `a @ b` is the composition of the transforms a and b.

    Args:
        x: Forward [m], within +-1e8.
        y: Left [m], within +-1e8.
        yaw: Counter-clockwise heading [rad], not normalized, within +-1e6.

    Raises:
        InvalidValue: If a component is NaN, is infinite, is out of range, or is not a number.

    >>> Pose2(1.0, 0.0, math.pi / 2) @ Pose2(1.0, 0.0, 0.0)
    Pose2(x=1.0, y=1.0, yaw=1.5707963267948966)
    """

    x: float
    y: float
    yaw: float

    def __post_init__(self) -> None:
        x, y, yaw = self.x, self.y, self.yaw
        if type(x) is type(y) is type(yaw) is float and (
            -FARTHEST <= x <= FARTHEST and -FARTHEST <= y <= FARTHEST and -MOST_TURNED <= yaw <= MOST_TURNED
        ):
            return  # the usual case; the checks below convert numbers of other types or raise
        for name, most, unit in (("x", FARTHEST, "m"), ("y", FARTHEST, "m"), ("yaw", MOST_TURNED, "rad")):
            value = finite_number(getattr(self, name), f"pose.{name}")
            if abs(value) > most:
                raise InvalidValue(f"pose.{name}: must be within +-{most:g} {unit}, got {value:g}")
            object.__setattr__(self, name, value)

    @property
    def brief(self) -> str:
        """`(x, y, yaw)` rounded to four decimals, for messages."""
        return "({:.7g}, {:.7g}, {:.7g})".format(*(round(value, 4) + 0.0 for value in (self.x, self.y, self.yaw)))

    def __matmul__(self, other: Pose2) -> Pose2:
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return Pose2(self.x + c * other.x - s * other.y, self.y + s * other.x + c * other.y, self.yaw + other.yaw)

    def inverse(self) -> Pose2:
        """Return the inverse transform: `pose @ pose.inverse()` is the identity."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return Pose2(-c * self.x - s * self.y, s * self.x - c * self.y, -self.yaw)

    def distance_to(self, other: Pose2) -> float:
        """Return the distance between the two positions [m]; yaw is ignored."""
        return math.hypot(other.x - self.x, other.y - self.y)

    def gap_to(self, other: Pose2) -> float:
        """Return the larger of the distance [m] and the angle [rad] between two poses."""
        return max(self.distance_to(other), abs(normalize_angle(self.yaw - other.yaw)))

    def in_frame_of(self, reference: Pose2) -> Pose2:
        """Return this pose in the frame of `reference`: along-track, cross-track and heading error in (-pi, pi]."""
        x, y = self.x - reference.x, self.y - reference.y
        c, s = math.cos(reference.yaw), math.sin(reference.yaw)
        return Pose2(c * x + s * y, c * y - s * x, normalize_angle(self.yaw - reference.yaw))

    def moved(self, twist: Twist2, duration: float) -> Pose2:
        """Return the pose after `duration` [s] at a constant body velocity: an exact arc or straight line.

        >>> end = Pose2(0.0, 0.0, 0.0).moved(Twist2(math.pi, math.pi), 0.5)
        >>> round(end.x, 12), round(end.y, 12)
        (1.0, 1.0)
        """
        return Pose2(*arc_end(self.x, self.y, self.yaw, (twist.linear, twist.angular, twist.lateral), duration))

    def as_array(self) -> FloatArray:
        """Return x, y, yaw, Shape (3,)."""
        return np.array([self.x, self.y, self.yaw])

    @classmethod
    def from_sequence(cls, values: Sequence[float] | FloatArray) -> Pose2:
        """Return the pose with the components `[x, y, yaw]`.

        Raises:
            InvalidValue: If there are not exactly three finite numbers.
        """
        if len(values) != 3:
            raise InvalidValue(f"pose: must be [x, y, yaw], got {len(values)} values")
        x, y, yaw = values.tolist() if isinstance(values, np.ndarray) else values
        return cls(x, y, yaw)


@dataclass(frozen=True, slots=True)
class Twist2:
    """A body velocity.

    Args:
        linear: Forward speed [m/s], negative in reverse.
        angular: Counter-clockwise yaw rate [rad/s].
        lateral: Leftward speed [m/s].

    Raises:
        InvalidValue: If a component is NaN, is infinite, or is not a number.
    """

    linear: float = 0.0
    angular: float = 0.0
    lateral: float = 0.0

    def __post_init__(self) -> None:
        kinds = type(self.linear), type(self.angular), type(self.lateral)
        if kinds == (float, float, float) and math.isfinite(self.linear + self.angular + self.lateral):
            return  # the usual case; the checks below convert numbers of other types or raise
        for name in ("linear", "angular", "lateral"):
            object.__setattr__(self, name, finite_number(getattr(self, name), f"twist.{name}"))


def transform_points(poses: FloatArray, points: FloatArray) -> FloatArray:
    """Transform points from the body frame to the world, for every pose.

    Args:
        poses: Shape (n, 3) [m, m, rad].
        points: Shape (k, 2) [m], in the body frame.

    Returns:
        Shape (n, k, 2) [m].
    """
    c, s = np.cos(poses[:, 2, None]), np.sin(poses[:, 2, None])
    found = np.empty((len(poses), len(points), 2))
    found[..., 0] = poses[:, 0, None] + c * points[:, 0] - s * points[:, 1]
    found[..., 1] = poses[:, 1, None] + s * points[:, 0] + c * points[:, 1]
    return found


def transform_poses(frame: Pose2, poses: FloatArray) -> FloatArray:
    """Transform poses from a frame to its parent frame.

    Args:
        frame: Pose of the frame in the parent frame.
        poses: Shape (n, 3), in the frame.

    Returns:
        Shape (n, 3); yaws are not normalized, so continuous yaws stay continuous.
    """
    places = transform_points(frame.as_array()[None], poses[:, :2])[0]
    seen: FloatArray = np.column_stack((places, frame.yaw + poses[:, 2]))
    return seen


def pose_errors(poses: FloatArray, references: FloatArray) -> FloatArray:
    """Return every pose in the frame of its reference, with yaw in (-pi, pi]. Shape (n, 3) each."""
    delta = poses - references
    c, s = np.cos(references[:, 2]), np.sin(references[:, 2])
    yaw = np.pi - np.mod(np.pi - delta[:, 2], 2.0 * np.pi)
    return np.column_stack((c * delta[:, 0] + s * delta[:, 1], c * delta[:, 1] - s * delta[:, 0], yaw))


def displacement(off: Number, turn: Number, radius: float) -> Number:
    """Return an upper bound of the distance [m] that any point within `radius` of the origin moves.

    A rotation moves a point along a chord of at most 2 R |sin(turn / 2)|, so the bound is `off` + 2 R |sin(turn / 2)|.

    Args:
        off: Distance between the positions, a number or an array [m].
        turn: Angle between the headings, which may exceed a whole turn [rad].
        radius: Radius of the body [m].
    """
    moved: Number = off + 2.0 * radius * np.abs(np.sin(0.5 * turn))
    return moved
