"""SE(2): poses, twists and angles.

Conventions: SI units, x forward, y left, yaw counter-clockwise in radians. An array of poses has Shape (n, 3) with
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

FARTHEST = 1e8  # [m] of any coordinate: beyond it squares overflow or millimetres vanish; no map on earth is that large
MOST_TURNED = 1e6  # [rad] of any yaw: its last digit is then 1e-10 rad, a tenth of a nanometre at one metre


def check_range(poses: FloatArray, name: str) -> None:
    """Refuse poses, Shape (n, 3), so far off or turned so often that floats cannot tell them apart.

    Raises:
        InvalidValue: A coordinate beyond 1e8 m or a yaw beyond 1e6 rad.
    """
    for column, most, unit in ((poses[:, :2], FARTHEST, "m"), (poses[:, 2], MOST_TURNED, "rad")):
        found = float(np.max(np.abs(column), initial=0.0))
        if not found <= most:
            what = "coordinates" if unit == "m" else "yaws"
            raise InvalidValue(f"{name}: {what} must be within +-{most:g} {unit}, got {found:g}")


def normalize_angle(angle: float) -> float:
    """The same direction in (-pi, pi].

    >>> normalize_angle(3 * math.pi) == math.pi
    True
    """
    wrapped = math.remainder(angle, 2.0 * math.pi)
    return math.pi if wrapped == -math.pi else wrapped


def wrap_angles(angles: FloatArray) -> FloatArray:
    """The same directions in [-pi, pi), of angles of any shape [rad]."""
    wrapped: FloatArray = np.remainder(angles + np.pi, 2.0 * np.pi) - np.pi
    return wrapped


def unwrap_yaw(yaw: FloatArray) -> FloatArray:
    """Yaws made continuous: consecutive values differ by at most pi. Shape (n,) [rad]."""
    return np.asarray(np.unwrap(yaw), dtype=np.float64)


def arc_end(
    x: float, y: float, yaw: float, twist: tuple[float, float, float], duration: float
) -> tuple[float, float, float]:
    """`Pose2.moved` on bare floats; the body velocity is (linear, angular, lateral)."""
    linear, angular, lateral = twist
    turn = angular * duration
    half = 0.5 * turn
    shrink = duration * (math.sin(half) / half if abs(half) > 1e-9 else 1.0)
    chord, side, heading = shrink * linear, shrink * lateral, yaw + half
    c, s = math.cos(heading), math.sin(heading)
    return x + chord * c - side * s, y + chord * s + side * c, yaw + turn


@dataclass(frozen=True, slots=True)
class Pose2:
    """A pose in the plane; `a @ b` is b expressed through a (compose), as with matrices.

    Args:
        x: Forward [m], within +-1e8.
        y: Left [m], within +-1e8.
        yaw: Counter-clockwise heading [rad]; kept as given, not normalized; within +-1e6.

    Raises:
        InvalidValue: A component is not a number, NaN, infinite or out of range.

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
            return  # as nearly always; the rest converts numbers of other kinds, or names what is wrong
        for name, most, unit in (("x", FARTHEST, "m"), ("y", FARTHEST, "m"), ("yaw", MOST_TURNED, "rad")):
            value = finite_number(getattr(self, name), f"pose.{name}")
            if abs(value) > most:
                raise InvalidValue(f"pose.{name}: must be within +-{most:g} {unit}, got {value:g}")
            object.__setattr__(self, name, value)

    @property
    def brief(self) -> str:
        """`(x, y, yaw)` to a tenth of a millimetre, for people."""
        return "({:.7g}, {:.7g}, {:.7g})".format(*(round(value, 4) + 0.0 for value in (self.x, self.y, self.yaw)))

    def __matmul__(self, other: Pose2) -> Pose2:
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return Pose2(self.x + c * other.x - s * other.y, self.y + s * other.x + c * other.y, self.yaw + other.yaw)

    def inverse(self) -> Pose2:
        """The pose with `pose @ pose.inverse()` the identity."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return Pose2(-c * self.x - s * self.y, s * self.x - c * self.y, -self.yaw)

    def distance_to(self, other: Pose2) -> float:
        """Distance between the two positions [m]; yaw plays no part."""
        return math.hypot(other.x - self.x, other.y - self.y)

    def gap_to(self, other: Pose2) -> float:
        """The larger of distance [m] and turn [rad] between two poses that should be one."""
        return max(self.distance_to(other), abs(normalize_angle(self.yaw - other.yaw)))

    def in_frame_of(self, reference: Pose2) -> Pose2:
        """This pose seen from `reference`, yaw in (-pi, pi]: x is along, y is cross, yaw is the heading error."""
        x, y = self.x - reference.x, self.y - reference.y
        c, s = math.cos(reference.yaw), math.sin(reference.yaw)
        return Pose2(c * x + s * y, c * y - s * x, normalize_angle(self.yaw - reference.yaw))

    def moved(self, twist: Twist2, duration: float) -> Pose2:
        """The pose after `duration` [s] at a constant body velocity: an exact arc, straight lines included.

        >>> end = Pose2(0.0, 0.0, 0.0).moved(Twist2(math.pi, math.pi), 0.5)
        >>> round(end.x, 12), round(end.y, 12)
        (1.0, 1.0)
        """
        return Pose2(*arc_end(self.x, self.y, self.yaw, (twist.linear, twist.angular, twist.lateral), duration))

    def as_array(self) -> FloatArray:
        """Shape (3,): x, y, yaw."""
        return np.array([self.x, self.y, self.yaw])

    @classmethod
    def from_sequence(cls, values: Sequence[float] | FloatArray) -> Pose2:
        """A pose from `[x, y, yaw]`.

        Raises:
            InvalidValue: Not exactly three finite numbers.
        """
        if len(values) != 3:
            raise InvalidValue(f"pose: must be [x, y, yaw], got {len(values)} values")
        return cls(values[0], values[1], values[2])


@dataclass(frozen=True, slots=True)
class Twist2:
    """A body velocity.

    Args:
        linear: Forward speed [m/s], negative in reverse.
        angular: Counter-clockwise yaw rate [rad/s].
        lateral: Leftward speed [m/s].

    Raises:
        InvalidValue: A component is not a number, NaN or infinite.
    """

    linear: float = 0.0
    angular: float = 0.0
    lateral: float = 0.0

    def __post_init__(self) -> None:
        kinds = type(self.linear), type(self.angular), type(self.lateral)
        if kinds == (float, float, float) and math.isfinite(self.linear + self.angular + self.lateral):
            return  # as nearly always; the rest converts numbers of other kinds, or names what is wrong
        for name in ("linear", "angular", "lateral"):
            object.__setattr__(self, name, finite_number(getattr(self, name), f"twist.{name}"))


def transform_points(poses: FloatArray, points: FloatArray) -> FloatArray:
    """Body points moved into the world at every pose.

    Args:
        poses: Shape (n, 3) [m, m, rad].
        points: Shape (k, 2) [m], in the body frame.

    Returns:
        Shape (n, k, 2) [m].
    """
    c, s = np.cos(poses[:, 2, None]), np.sin(poses[:, 2, None])
    x = poses[:, 0, None] + c * points[:, 0] - s * points[:, 1]
    y = poses[:, 1, None] + s * points[:, 0] + c * points[:, 1]
    return np.stack((x, y), axis=-1)


def transform_poses(frame: Pose2, poses: FloatArray) -> FloatArray:
    """Poses of a frame in the frame in which that one is seen.

    Args:
        frame: Pose of the frame.
        poses: Shape (n, 3).

    Returns:
        Shape (n, 3); yaws are turned by one angle, not normalized, so that continuous ones stay so.
    """
    places = transform_points(frame.as_array()[None], poses[:, :2])[0]
    seen: FloatArray = np.column_stack((places, frame.yaw + poses[:, 2]))
    return seen


def pose_errors(poses: FloatArray, references: FloatArray) -> FloatArray:
    """Poses seen from their references, yaw in (-pi, pi]. Shape (n, 3) each."""
    delta = poses - references
    c, s = np.cos(references[:, 2]), np.sin(references[:, 2])
    yaw = np.pi - np.mod(np.pi - delta[:, 2], 2.0 * np.pi)
    return np.column_stack((c * delta[:, 0] + s * delta[:, 1], c * delta[:, 1] - s * delta[:, 0], yaw))


def displacement(off: Number, turn: Number, radius: float) -> Number:
    """How far a pose that is off and turned moves any point within a radius of its origin, at most [m].

    A turn moves a point by a chord, off + 2 R sin(|turn| / 2).

    Args:
        off: Distance of the poses, a number or an array [m].
        turn: Angle between them, likewise; of any number of whole turns [rad].
        radius: Of the body [m].
    """
    moved: Number = off + 2.0 * radius * np.abs(np.sin(0.5 * turn))
    return moved
