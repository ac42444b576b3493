"""The robot's camera: where it is mounted, what it sees, and which part of a path must see the dock's marker.

The field of view is a cone cut off by two circles. How far a point lies inside is measured as a length, not as an
angle: the smallest of its signed distances to the edges of the cone and to the circles. A length is 1-Lipschitz in the
position of the point and has no singularity where the point is near the camera; bearings have one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.errors import InvalidValue
from optdock.geometry.checked import exactly, number
from optdock.geometry.pose import Pose2, transform_points
from optdock.model.path import place_before_end

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from optdock.model.path import Path

__all__ = ["Camera", "RequiredView", "ViewMargins", "ViewQuantity"]

_WHOLE_TURN = 2.0 * math.pi


@dataclass(frozen=True)
class Camera:
    """A camera on the robot, or any other sensor that detects the dock within a cone.

    Args:
        mount: Pose of the camera in the robot's frame; it looks along the x axis of this pose.
        field_of_view: Whole angle of the cone, > 0 and <= 2 pi; 2 pi sees all around [rad].
        min_range: Nearest distance at which the marker is detected, >= 0 [m].
        max_range: Farthest such distance, > min_range; may be infinite [m].

    Raises:
        InvalidValue: A value is out of these ranges, or the mount is not a pose.
    """

    mount: Pose2
    field_of_view: float
    min_range: float = 0.0
    max_range: float = math.inf

    def __post_init__(self) -> None:
        exactly(Pose2, self.mount, "robot.camera.mount")
        for name in ("field_of_view", "min_range", "max_range"):
            object.__setattr__(self, name, number(getattr(self, name), f"robot.camera.{name}"))
        if not 0.0 < self.field_of_view <= _WHOLE_TURN:
            raise InvalidValue(f"robot.camera.field_of_view: must be > 0 and <= 2 pi rad, got {self.field_of_view}")
        if not (math.isfinite(self.min_range) and self.min_range >= 0.0):
            raise InvalidValue(f"robot.camera.min_range: must be finite and >= 0 m, got {self.min_range}")
        if not self.max_range > self.min_range:
            raise InvalidValue(
                f"robot.camera.max_range: must be > min_range = {self.min_range} m, got {self.max_range}"
            )

    @property
    def sees_all_around(self) -> bool:
        """Whether the field of view is a whole turn, so that no bearing is out of it."""
        return self.field_of_view >= _WHOLE_TURN

    def points_seen(self, poses: FloatArray, point: FloatArray) -> FloatArray:
        """A point of the world in the camera's frame, seen from every pose of the robot.

        Args:
            poses: Of the robot, Shape (n, 3).
            point: Shape (2,) [m].

        Returns:
            Shape (n, 2) [m].
        """
        cameras = poses[:, 2] + self.mount.yaw
        at = transform_points(poses, np.array([[self.mount.x, self.mount.y]]))[:, 0]
        dx, dy = point[0] - at[:, 0], point[1] - at[:, 1]
        c, s = np.cos(cameras), np.sin(cameras)
        return np.column_stack((c * dx + s * dy, c * dy - s * dx))

    def margins(self, points: FloatArray) -> ViewMargins:
        """How far points in the camera's frame, Shape (n, 2) [m], lie inside its view.

        With bearing b, distance r and half-angle h the distance to the edges of the cone is r sin(min(h - b, pi / 2)):
        the distance to the nearer edge line, or to the apex where that is nearer.
        """
        bearing = np.abs(np.arctan2(points[:, 1], points[:, 0]))
        distance = np.hypot(points[:, 0], points[:, 1])
        inside = np.minimum(0.5 * self.field_of_view - bearing, 0.5 * np.pi)
        cone = np.full(distance.size, np.inf) if self.sees_all_around else distance * np.sin(inside)
        near = distance - self.min_range if self.min_range > 0.0 else np.full(distance.size, np.inf)
        return ViewMargins(cone, near, self.max_range - distance, bearing, distance)


class ViewMargins(NamedTuple):
    """How far points lie inside the view of a camera, Shape (n,) each; negative outside.

    Attributes:
        cone: Signed distance to the edges of the cone [m]; inf where the camera sees all around.
        near: Distance beyond `min_range` [m]; inf without one.
        far: Distance short of `max_range` [m].
        bearing: |angle| from the camera's axis [rad].
        distance: From the camera [m].
    """

    cone: FloatArray
    near: FloatArray
    far: FloatArray
    bearing: FloatArray
    distance: FloatArray

    @property
    def smallest(self) -> FloatArray:
        """Signed distance to the boundary of the view, or less outside of it. Shape (n,) [m]."""
        smallest: FloatArray = np.minimum(self.cone, np.minimum(self.near, self.far))
        return smallest


class ViewQuantity(NamedTuple):
    """What of a view is worst: `bearing` [rad] or `distance` [m], its value and the limit that it breaks."""

    name: str
    unit: str
    value: float
    limit: float

    @property
    def excess(self) -> float:
        """By how much the value is beyond the limit."""
        return abs(self.value - self.limit)

    def __str__(self) -> str:
        if self.name == "bearing":
            return f"bearing {math.degrees(self.value):.1f} of {math.degrees(self.limit):.1f} degrees"
        bound = "at least" if self.value < self.limit else "at most"
        return f"distance {self.value:.3f} m, {bound} {self.limit:.3f} m"


class RequiredView(NamedTuple):
    """Which part of a path must see which point.

    Attributes:
        camera: Of the robot.
        marker: Shape (2,), in the world [m].
        visible_distance: The part begins so far before the end of the path [m], along the path.
        blind_distance: It ends so far before the end [m].
    """

    camera: Camera
    marker: FloatArray
    visible_distance: float
    blind_distance: float

    def stretch(self, path: Path) -> tuple[float, float] | None:
        """Where on a path the marker must be in view, from `s` to `s` [m]; None: nowhere, all of it is blind.

        Turns in place count no distance. A turn belongs to the part where less than `visible_distance` and at least
        `blind_distance` are left to drive after it.
        """
        begin, end = (
            max(0.0, place_before_end(path, self.visible_distance)),
            place_before_end(path, self.blind_distance),
        )
        return (begin, end) if end > begin else None

    def margins(self, poses: FloatArray) -> ViewMargins:
        """How far the marker is inside the view from poses of the robot, Shape (n, 3)."""
        return self.camera.margins(self.camera.points_seen(poses, self.marker))

    def worst(self, margins: ViewMargins, at: int, required: float) -> ViewQuantity:
        """The quantity that breaks a required margin at row `at`, with the limit that the requirement leaves of it.

        Args:
            margins: What was found.
            at: Which of them.
            required: Margin required there [m]; 0 where the robot has no tracking tube.
        """
        distance, camera = float(margins.distance[at]), self.camera
        if margins.far[at] <= min(margins.cone[at], margins.near[at]):
            return ViewQuantity("distance", "m", distance, camera.max_range - required)
        if margins.near[at] <= margins.cone[at]:
            return ViewQuantity("distance", "m", distance, camera.min_range + required)
        if distance < required:
            return ViewQuantity("distance", "m", distance, required)
        lost = math.asin(required / distance) if required > 0.0 else 0.0
        return ViewQuantity("bearing", "rad", float(margins.bearing[at]), 0.5 * camera.field_of_view - lost)
