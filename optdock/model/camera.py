"""The robot's camera: mount, field of view, and the part of a path on which the dock's marker must be visible.

The field of view is a cone truncated by two circles. The margin of a point is a length and not an angle: the smallest
of its signed distances to the edges of the cone and to the circles. This length is 1-Lipschitz in the position of the
point. It remains regular near the camera, where bearings are singular.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.errors import InvalidValue
from optdock.geometry.checked import exactly, non_negative, number
from optdock.geometry.pose import Pose2, transform_points
from optdock.model.path import place_before_end

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from optdock.model.path import Path

__all__ = ["Camera", "RequiredView", "ViewMargins", "ViewQuantity"]

_WHOLE_TURN = 2.0 * math.pi


@dataclass(frozen=True)
class Camera:
    """A camera on the robot, or another sensor that detects the dock within a cone.

    Args:
        mount: Pose of the camera in the robot frame; the optical axis is the x axis of this pose.
        field_of_view: Full angle of the cone, > 0 and <= 2 pi [rad].
        min_range: Smallest distance at which the marker is detected, >= 0 [m].
        max_range: Largest distance [m] at which the marker is detected, > min_range; may be infinite.

    Raises:
        InvalidValue: If a value is out of range or the mount is not a `Pose2`.
    """

    mount: Pose2
    field_of_view: float
    min_range: float = 0.0
    max_range: float = math.inf

    def __post_init__(self) -> None:
        exactly(Pose2, self.mount, "robot.camera.mount")
        view = number(self.field_of_view, "robot.camera.field_of_view")
        nearest = non_negative(self.min_range, "robot.camera.min_range", "m")
        farthest = number(self.max_range, "robot.camera.max_range")
        if not 0.0 < view <= _WHOLE_TURN:
            raise InvalidValue(f"robot.camera.field_of_view: must be > 0 and <= 2 pi rad, got {view}")
        if not farthest > nearest:
            raise InvalidValue(f"robot.camera.max_range: must be > min_range = {nearest} m, got {farthest}")
        vars(self).update(field_of_view=view, min_range=nearest, max_range=farthest)

    @property
    def sees_all_around(self) -> bool:
        """Whether the field of view is a whole turn, which contains every bearing."""
        return self.field_of_view >= _WHOLE_TURN

    def points_seen(self, poses: FloatArray, point: FloatArray) -> FloatArray:
        """Return the position of a world point in the camera frame, for every pose of the robot.

        Args:
            poses: Robot poses, Shape (n, 3).
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
        """Compute the margins of points in the camera frame, Shape (n, 2) [m], to the boundary of the view.

        With bearing b, distance r and half-angle h, the distance to the edges of the cone is r sin(min(h - b, pi / 2)),
        which is the distance to the nearer edge line, or to the apex if the apex is nearer.
        """
        bearing = np.abs(np.arctan2(points[:, 1], points[:, 0]))
        distance = np.hypot(points[:, 0], points[:, 1])
        inside = np.minimum(0.5 * self.field_of_view - bearing, 0.5 * np.pi)
        cone = np.full(distance.size, np.inf) if self.sees_all_around else distance * np.sin(inside)
        near = distance - self.min_range if self.min_range > 0.0 else np.full(distance.size, np.inf)
        return ViewMargins(cone, near, self.max_range - distance, bearing, distance)


class ViewMargins(NamedTuple):
    """Margins of points to the boundary of a camera's view, Shape (n,) each; negative outside.

    Attributes:
        cone: Signed distance to the edges of the cone [m]; inf if the field of view is a whole turn.
        near: Distance minus `min_range` [m]; inf if `min_range` is 0.
        far: `max_range` minus distance [m].
        bearing: |angle| from the optical axis [rad].
        distance: Distance from the camera [m].
    """

    cone: FloatArray
    near: FloatArray
    far: FloatArray
    bearing: FloatArray
    distance: FloatArray

    @property
    def smallest(self) -> FloatArray:
        """Signed distance to the boundary of the view, or a smaller value for points outside. Shape (n,) [m]."""
        smallest: FloatArray = np.minimum(self.cone, np.minimum(self.near, self.far))
        return smallest


class ViewQuantity(NamedTuple):
    """The quantity of a view that is violated most, `bearing` [rad] or `distance` [m], with its value and limit."""

    name: str
    unit: str
    value: float
    limit: float

    @property
    def excess(self) -> float:
        """Amount by which the value violates the limit."""
        return abs(self.value - self.limit)

    def __str__(self) -> str:
        if self.name == "bearing":
            return f"bearing {math.degrees(self.value):.1f} degrees, at most {math.degrees(self.limit):.1f} degrees"
        bound = "at least" if self.value < self.limit else "at most"
        return f"distance {self.value:.3f} m, {bound} {self.limit:.3f} m"


class RequiredView(NamedTuple):
    """The part of a path on which a marker must be visible.

    Attributes:
        camera: Camera of the robot.
        marker: Position of the marker in the world, Shape (2,) [m].
        visible_distance: Distance from the beginning of the part to the end of the path, along the path [m].
        blind_distance: Distance from the end of the part to the end of the path, along the path [m].
    """

    camera: Camera
    marker: FloatArray
    visible_distance: float
    blind_distance: float

    def stretch(self, path: Path) -> tuple[float, float] | None:
        """Return the interval of `s` on which the marker must be visible [m], or None if it is empty.

        A turn in place has no length. It belongs to the part if the distance that remains after the turn is less than
        `visible_distance` and at least `blind_distance`.
        """
        begin = max(0.0, place_before_end(path, self.visible_distance))
        end = place_before_end(path, self.blind_distance)
        return (begin, end) if end > begin else None

    def margins(self, poses: FloatArray) -> ViewMargins:
        """Compute the margins of the marker for robot poses, Shape (n, 3)."""
        return self.camera.margins(self.camera.points_seen(poses, self.marker))

    def worst(self, margins: ViewMargins, at: int, required: float) -> ViewQuantity:
        """Return the quantity that violates a required margin at row `at`, with the limit that follows from the margin.

        Args:
            margins: Margins of the poses.
            at: Row of the violation.
            required: Required margin at this pose [m]; 0 if the robot has no tracking tube.
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
