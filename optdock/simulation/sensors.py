"""The sensors of a simulated robot: localization, odometry and the detector of the dock.

Each sensor class is an immutable description of a sensor. Its `reader(seed)` contains the state, such as a random walk,
counted ticks, or detections that have not been delivered yet. A reader draws the same random numbers with and without
faults, so a fault does not change the other errors.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from optdock.errors import InvalidValue
from optdock.geometry.checked import instance, number
from optdock.geometry.pose import Pose2, Twist2, arc_end, normalize_angle
from optdock.model.measurements import Detection
from optdock.simulation.plant import check_not_negative

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = [
    "DockSensor",
    "DockSensorReader",
    "Odometry",
    "OdometryReader",
    "PoseSensor",
    "PoseSensorReader",
]

_BLOCK = 512  # random numbers drawn per call, because a call of NumPy takes as long as a hundred of them
_INSTANT = 1e-9  # [s]: rounding of times that are sums of periods
_ORIGIN = Pose2(0.0, 0.0, 0.0)
Seed = int | np.random.SeedSequence


@dataclass(frozen=True)
class PoseSensor:
    """Localization: the true pose plus errors in x, y (of the fixed frame) and yaw.

    Args:
        position_sigma: Standard deviation of the white noise of x and y, each [m].
        yaw_sigma: Standard deviation of the white noise of yaw [rad].
        position_walk: Standard deviation of the random walk of x and y, each [m/sqrt(s)].
        yaw_walk: Standard deviation of the random walk of yaw [rad/sqrt(s)].

    Raises:
        InvalidValue: If a value is not a number, is negative, or is not finite.
    """

    position_sigma: float = 0.0
    yaw_sigma: float = 0.0
    position_walk: float = 0.0
    yaw_walk: float = 0.0

    def __post_init__(self) -> None:
        check_not_negative(self, "pose_sensor", ("position_sigma", "yaw_sigma", "position_walk", "yaw_walk"))

    def reader(self, seed: Seed = 0) -> PoseSensorReader:
        """Return a reader with a separate random stream."""
        return PoseSensorReader(self, seed)


class PoseSensorReader:
    """Readings of a `PoseSensor`."""

    def __init__(self, sensor: PoseSensor, seed: Seed) -> None:
        self.sensor = sensor
        self._normal = _normals(seed)
        self._error = (0.0, 0.0, 0.0)
        self._time: float | None = None

    def jump(self, offset: Pose2) -> None:
        """Increase the error by `offset` permanently."""
        x, y, yaw = self._error
        self._error = x + offset.x, y + offset.y, yaw + offset.yaw

    def measure(self, time: float, pose: Pose2) -> Pose2:
        """Return the measured pose for the true pose at `time` [s]."""
        sensor, normal = self.sensor, self._normal
        root = math.sqrt(max(0.0, time - self._time)) if self._time is not None else 0.0
        self._time = time
        x, y, yaw = self._error
        walk, turn = sensor.position_walk * root, sensor.yaw_walk * root
        x, y, yaw = x + walk * next(normal), y + walk * next(normal), yaw + turn * next(normal)
        self._error = x, y, yaw
        x += pose.x + sensor.position_sigma * next(normal)
        y += pose.y + sensor.position_sigma * next(normal)
        yaw += pose.yaw + sensor.yaw_sigma * next(normal)
        return Pose2(x, y, yaw)


@dataclass(frozen=True)
class Odometry:
    """Body velocity from the encoders of the wheels.

    Args:
        linear_gain: Gain of the speed [1].
        angular_gain: Gain of the yaw rate [1].
        linear_sigma: Standard deviation of the white noise of the speed [m/s].
        angular_sigma: Standard deviation of the white noise of the yaw rate [rad/s].
        tick: Distance travelled by a wheel per encoder tick [m]; the speed is then measured in ticks per period. 0:
            continuous.
        track_width: Track width for the conversion of ticks [m]; required if `tick` is not 0.

    Raises:
        InvalidValue: If a value is not a number, is negative, or is not finite, or there are ticks without a track
            width.
    """

    linear_gain: float = 1.0
    angular_gain: float = 1.0
    linear_sigma: float = 0.0
    angular_sigma: float = 0.0
    tick: float = 0.0
    track_width: float = 0.0

    def __post_init__(self) -> None:
        keys = ("linear_gain", "angular_gain", "linear_sigma", "angular_sigma", "tick", "track_width")
        check_not_negative(self, "odometry", keys)
        if self.tick > 0.0 and self.track_width == 0.0:
            raise InvalidValue(f"odometry.track_width: must be > 0 m where tick is, {self.tick} m; got 0.0")

    def reader(self, seed: Seed = 0) -> OdometryReader:
        """Return a reader with a separate random stream."""
        return OdometryReader(self, seed)


class OdometryReader:
    """Readings of an `Odometry`."""

    def __init__(self, sensor: Odometry, seed: Seed) -> None:
        self.sensor = sensor
        self._normal = _normals(seed)
        self._before: Twist2 | None = None
        self._travel = (0.0, 0.0)

    def measure(self, encoders: Twist2, duration: float) -> Twist2:
        """Return the measured velocity for the present encoder velocity, `duration` [s] after the last measurement."""
        sensor = self.sensor
        linear, angular = encoders.linear, encoders.angular
        if sensor.tick > 0.0:
            linear, angular = self._counted(encoders, duration)
        return Twist2(
            sensor.linear_gain * linear + sensor.linear_sigma * next(self._normal),
            sensor.angular_gain * angular + sensor.angular_sigma * next(self._normal),
        )

    def _counted(self, encoders: Twist2, duration: float) -> tuple[float, float]:
        before, self._before = self._before or encoders, encoders
        if duration <= 0.0:
            return encoders.linear, encoders.angular
        tick, lever = self.sensor.tick, 0.5 * self.sensor.track_width
        way, turn = before.linear + encoders.linear, before.angular + encoders.angular
        left, right = self._travel
        self._travel = left + 0.5 * duration * (way - lever * turn), right + 0.5 * duration * (way + lever * turn)
        ticks_left, ticks_right = (
            math.floor(new / tick) - math.floor(old / tick)
            for old, new in zip((left, right), self._travel, strict=True)
        )
        return (
            0.5 * tick * (ticks_left + ticks_right) / duration,
            0.5 * tick * (ticks_right - ticks_left) / (lever * duration),
        )


@dataclass(frozen=True)
class DockSensor:
    """A detector of the dock in camera images.

    Images are taken at multiples of 1 / rate. A detection is the docked pose relative to the true pose of the robot,
    plus white noise with the standard deviations below, which grow by the fraction `growth` per metre beyond `near`.
    Each detection contains its true standard deviations.

    Args:
        rate: Images per second [Hz].
        latency: Time from an image to its detection [s].
        position_sigma: Standard deviation of x and y in the frame of the robot, each [m].
        yaw_sigma: Standard deviation of yaw [rad].
        near: Distance of the marker up to which the standard deviations are constant [m].
        growth: Relative growth of the standard deviations beyond `near` [1/m].
        marker: Marker in the frame of the docked pose; its yaw is not used.
        camera: Camera in the frame of the robot.
        field_of_view: Full angle [rad].
        min_range: Smallest distance of a detected marker [m].
        max_range: Largest distance of a detected marker [m].
        drop_out: Probability that an image gives no detection.

    Raises:
        InvalidValue: If a value is not a number, is negative, or is not finite, the rate is 0, the drop-out is above 1,
            or the smallest range is not below the largest range.
    """

    rate: float = 15.0
    latency: float = 0.0
    position_sigma: float = 0.0
    yaw_sigma: float = 0.0
    near: float = 1.0
    growth: float = 1.0
    marker: Pose2 = _ORIGIN
    camera: Pose2 = _ORIGIN
    field_of_view: float = 2.0 * math.pi
    min_range: float = 0.0
    max_range: float = math.inf
    drop_out: float = 0.0

    def __post_init__(self) -> None:
        keys = ("rate", "latency", "position_sigma", "yaw_sigma", "near", "growth", "field_of_view", "min_range")
        check_not_negative(self, "dock_sensor", (*keys, "drop_out"))
        for name in ("marker", "camera"):
            instance(Pose2, getattr(self, name), f"dock_sensor.{name}")
        if self.rate == 0.0:
            raise InvalidValue("dock_sensor.rate: must be > 0 Hz, got 0.0")
        if self.drop_out > 1.0:
            raise InvalidValue(f"dock_sensor.drop_out: must be a probability from 0 to 1, got {self.drop_out}")
        object.__setattr__(self, "max_range", number(self.max_range, "dock_sensor.max_range"))
        if not self.max_range > self.min_range:
            raise InvalidValue(f"dock_sensor.max_range: must be > min_range, {self.min_range}, got {self.max_range}")

    def sigmas(self, distance: float) -> tuple[float, float]:
        """Return the standard deviations of the position [m] and the yaw [rad] at a distance of the marker [m]."""
        share = 1.0 + self.growth * max(0.0, distance - self.near)
        return share * self.position_sigma, share * self.yaw_sigma

    def reader(self, seed: Seed = 0) -> DockSensorReader:
        """Return a reader with a separate random stream."""
        return DockSensorReader(self, seed)


class DockSensorReader:
    """Detections of a `DockSensor`."""

    def __init__(self, sensor: DockSensor, seed: Seed) -> None:
        self.sensor = sensor
        noise, luck = _sequence(seed).spawn(2)
        self._normal, self._uniform = _normals(noise), np.random.default_rng(luck)
        self._outliers: deque[Pose2] = deque()
        self._images = 0
        self._before: tuple[float, Pose2] | None = None
        self._under_way: deque[Detection] = deque()
        self._lost_until = -math.inf

    def lose(self, until: float) -> None:
        """Suppress detections in images before `until` [s]."""
        self._lost_until = until

    def displace_next(self, offset: Pose2) -> None:
        """Displace the next detection by `offset` in the frame of the robot."""
        self._outliers.appendleft(offset)

    def measure(self, time: float, pose: Pose2, dock: Pose2) -> tuple[Detection, ...]:
        """Return the detections delivered until `time` [s], the oldest first, after a motion along an arc to `pose`.

        Args:
            time: Time [s], not before the time of the last call.
            pose: True pose of the robot.
            dock: True pose of the docked robot.
        """
        began, start = self._before or (time, pose)
        self._before = time, pose
        sensor = self.sensor
        while (stamp := self._images / sensor.rate) <= time + _INSTANT:
            self._images += 1
            if stamp >= began - _INSTANT:
                share = (stamp - began) / (time - began) if time > began else 1.0
                self._take(stamp, _on_the_way(start, pose, min(max(share, 0.0), 1.0)), dock)
        arrived = []
        while self._under_way and self._under_way[0].stamp + sensor.latency <= time + _INSTANT:
            arrived.append(self._under_way.popleft())
        return tuple(arrived)

    def _take(self, stamp: float, robot: Pose2, dock: Pose2) -> None:
        sensor = self.sensor
        noise = [next(self._normal) for _ in range(3)]
        dropped = float(self._uniform.random()) < sensor.drop_out
        seen = (robot @ sensor.camera).inverse() @ dock @ sensor.marker
        distance, bearing = math.hypot(seen.x, seen.y), math.atan2(seen.y, seen.x)
        in_sight = sensor.min_range <= distance <= sensor.max_range and abs(bearing) <= 0.5 * sensor.field_of_view
        if dropped or not in_sight or stamp < self._lost_until:
            return
        position_sigma, yaw_sigma = sensor.sigmas(distance)
        offset = self._outliers.popleft() if self._outliers else _ORIGIN
        found = dock.in_frame_of(robot)
        measured = Pose2(
            found.x + offset.x + position_sigma * noise[0],
            found.y + offset.y + position_sigma * noise[1],
            found.yaw + offset.yaw + yaw_sigma * noise[2],
        )
        self._under_way.append(Detection(stamp, measured, position_sigma, yaw_sigma))


def _on_the_way(start: Pose2, end: Pose2, share: float) -> Pose2:
    """Return the pose at a share of the arc from one pose to another."""
    if share == 1.0:
        return end
    way = start.inverse() @ end
    turn = normalize_angle(way.yaw)
    half = 0.5 * turn
    stretch = half / math.sin(half) if abs(half) > 1e-9 else 1.0
    c, s = stretch * math.cos(half), stretch * math.sin(half)
    return Pose2(*arc_end(start.x, start.y, start.yaw, (c * way.x + s * way.y, turn, c * way.y - s * way.x), share))


def _normals(seed: Seed) -> Iterator[float]:
    """Yield an infinite sequence of standard normal numbers."""
    generator = np.random.default_rng(seed)
    while True:
        yield from generator.standard_normal(_BLOCK).tolist()


def _sequence(seed: Seed) -> np.random.SeedSequence:
    return seed if isinstance(seed, np.random.SeedSequence) else np.random.SeedSequence(seed)
