"""Simulated dock detector: late, out of order, with outliers, and with losses near the dock."""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from optdock.geometry.pose import Pose2
from optdock.model.measurements import Detection

if TYPE_CHECKING:
    import numpy as np

__all__ = ["Camera", "CameraState"]

_FRONT = Pose2(0.25, 0.0, 0.0)
_INSTANT = 1e-9  # [s]: rounding of times that are sums of sub-steps


@dataclass(frozen=True)
class Camera:
    """Parameters of a camera with a dock detector. Ranges are (lowest, highest) of a uniform distribution.

    Args:
        mount: Camera pose on the robot; the camera points along its x axis.
        field_of_view: Full angle [rad].
        range: Distances from the marker at which it is visible [m].
        period: Time between two pictures [s].
        latency: Latency of each detection [s]; detections can overtake each other.
        position_sigma: Standard deviation of the docked pose's x and y at distance 0 [m]; reported truthfully.
        position_slope: Increase of the position deviation per metre from the marker [1].
        yaw_sigma: Standard deviation of the yaw at distance 0 [rad].
        yaw_slope: Increase of the yaw deviation per metre from the marker [rad/m].
        outliers: Share of outliers among the detections, which report the sigmas of inliers [1].
        outlier_distance: Position error of outliers, in any direction [m].
        outlier_yaw: Yaw error of outliers, of either sign [rad].
        near: Distance to the docked pose below which pictures are lost [m].
        near_loss: Share of lost pictures within `near` [1]; 1: the camera is blind there.
        hidden_for: Duration of one occlusion of the dock per run [s].
        hidden_from: Start time of the occlusion [s].
        second_tag: Share of pictures in which another tag is detected instead of the dock [1]; all while it is hidden.
        second_tag_aside: Lateral offset of the other tag to the left of the dock [m].
        stamped_on_arrival: Whether a detection has the time of its arrival as stamp instead of the time of the picture.
    """

    mount: Pose2 = _FRONT
    field_of_view: float = math.radians(70.0)
    range: tuple[float, float] = (0.1, 3.0)
    period: float = 0.1
    latency: tuple[float, float] = (0.08, 0.2)
    position_sigma: float = 0.002
    position_slope: float = 0.004
    yaw_sigma: float = math.radians(0.3)
    yaw_slope: float = math.radians(0.7)
    outliers: float = 0.1
    outlier_distance: float = 0.1
    outlier_yaw: float = math.radians(10.0)
    near: float = 0.4
    near_loss: float = 0.5
    hidden_for: float = 2.0
    hidden_from: tuple[float, float] = (1.0, 10.0)
    second_tag: float = 0.0
    second_tag_aside: float = 0.3
    stamped_on_arrival: bool = False

    def sigmas(self, distance: float) -> tuple[float, float]:
        """Return the standard deviations of position [m] and yaw [rad] at a distance from the marker [m]."""
        return (
            self.position_sigma + self.position_slope * distance,
            self.yaw_sigma + self.yaw_slope * distance,
        )


class CameraState:
    """Camera that queues its detections until they arrive.

    Args:
        camera: Camera parameters.
        marker: Marker position in the frame of the docked robot.
        random: Generator of noise, latency and failures.
    """

    def __init__(self, camera: Camera, marker: Pose2, random: np.random.Generator) -> None:
        self.camera, self._marker, self._random = camera, marker, random
        lowest, highest = camera.hidden_from
        self._hidden_from = lowest + float(random.random()) * (highest - lowest)
        self._under_way: list[tuple[float, int, Detection]] = []
        self._pictures = 0

    def take(self, time: float, robot: Pose2, dock: Pose2) -> None:
        """Take a picture.

        Args:
            time: [s].
            robot: True pose of the robot.
            dock: True pose of the docked robot.
        """
        camera = self.camera
        # Always draw the same number of values, so that no parameter changes the noise of another part.
        wrong, bearing, side, missed, confused, wait = self._random.random(6).tolist()
        noise = self._random.standard_normal(3).tolist()
        hidden = 0.0 <= time - self._hidden_from < camera.hidden_for
        confused_now = camera.second_tag > 0.0 and (hidden or confused < camera.second_tag)
        if hidden and not confused_now:
            return
        goal = dock @ Pose2(0.0, camera.second_tag_aside, 0.0) if confused_now else dock
        seen = (robot @ camera.mount).inverse() @ goal @ self._marker
        distance = math.hypot(seen.x, seen.y)
        if not self._in_view(seen, distance):
            return
        found = goal.in_frame_of(robot)
        if math.hypot(found.x, found.y) < camera.near and missed < camera.near_loss:
            return
        if wrong < camera.outliers:
            angle, turn = 2.0 * math.pi * bearing, math.copysign(camera.outlier_yaw, side - 0.5)
            far = camera.outlier_distance
            found = Pose2(found.x + far * math.cos(angle), found.y + far * math.sin(angle), found.yaw + turn)
        position_sigma, yaw_sigma = camera.sigmas(distance)
        measured = Pose2(
            found.x + position_sigma * noise[0],
            found.y + position_sigma * noise[1],
            found.yaw + yaw_sigma * noise[2],
        )
        lowest, highest = camera.latency
        arrival = time + lowest + wait * (highest - lowest)
        stamp = arrival if camera.stamped_on_arrival else time
        self._pictures += 1
        heapq.heappush(
            self._under_way, (arrival, self._pictures, Detection(stamp, measured, position_sigma, yaw_sigma))
        )

    def arrived(self, time: float) -> tuple[Detection, ...]:
        """Return the detections that arrived since the last call, in the order of arrival."""
        found = []
        while self._under_way and self._under_way[0][0] <= time + _INSTANT:
            found.append(heapq.heappop(self._under_way)[2])
        return tuple(found)

    def _in_view(self, seen: Pose2, distance: float) -> bool:
        """Return whether a marker, given in the camera frame, is in view."""
        nearest, farthest = self.camera.range
        bearing = math.atan2(seen.y, seen.x)
        return nearest <= distance <= farthest and abs(bearing) <= 0.5 * self.camera.field_of_view
