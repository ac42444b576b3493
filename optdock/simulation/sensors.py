"""The sensors of a simulated robot: localization, odometry and the detector of the dock, with their errors.

Each sensor is a frozen description with a `reader(seed)` that remembers: a random walk, ticks counted, pictures not yet
delivered. A reader draws the same random numbers whatever it shows, so that a fault switched on changes nothing else.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.errors import InvalidValue
from optdock.geometry.checked import finite_number, instance, number
from optdock.geometry.pose import Pose2, Twist2, arc_end, normalize_angle
from optdock.model.measurements import Detection
from optdock.simulation.plant import check_not_negative

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = [
    "Displaced",
    "DockSensor",
    "DockSensorReader",
    "Odometry",
    "OdometryReader",
    "PoseSensor",
    "PoseSensorReader",
    "Span",
]

_BLOCK = 512  # random numbers drawn in one go: NumPy's call costs as much as a hundred of them
_INSTANT = 1e-9  # [s]: rounding of times that are sums of periods
_ORIGIN = Pose2(0.0, 0.0, 0.0)
Seed = int | np.random.SeedSequence


class Span(NamedTuple):
    """From `start` to `end` [s], the end left out."""

    start: float
    end: float = math.inf


class Displaced(NamedTuple):
    """A fault at `time` [s]: what is measured is displaced by `offset`."""

    time: float
    offset: Pose2


@dataclass(frozen=True)
class PoseSensor:
    """Localization in the fixed frame: the true pose plus errors in x, y (of the fixed frame) and yaw.

    Args:
        position_sigma: Standard deviation of the white noise of x and y, each [m].
        yaw_sigma: Of the white noise of yaw [rad].
        bias: Error that never changes.
        position_walk: Standard deviation of what x and y, each, have wandered after 1 s [m/sqrt(s)].
        yaw_walk: Likewise yaw [rad/sqrt(s)].
        jumps: Faults: from each `time` on the error is larger by `offset`.
        lost: Faults: when there is no pose.

    Raises:
        InvalidValue: A sigma or a walk is not a number, negative or not finite; a time not a number.
    """

    position_sigma: float = 0.0
    yaw_sigma: float = 0.0
    bias: Pose2 = _ORIGIN
    position_walk: float = 0.0
    yaw_walk: float = 0.0
    jumps: tuple[Displaced, ...] = ()
    lost: tuple[Span, ...] = ()

    def __post_init__(self) -> None:
        check_not_negative(self, "pose_sensor", ("position_sigma", "yaw_sigma", "position_walk", "yaw_walk"))
        instance(Pose2, self.bias, "pose_sensor.bias")
        object.__setattr__(self, "jumps", _displacements(self.jumps, "pose_sensor.jumps"))
        object.__setattr__(self, "lost", _spans(self.lost, "pose_sensor.lost"))

    def reader(self, seed: Seed = 0) -> PoseSensorReader:
        """A sensor switched on."""
        return PoseSensorReader(self, seed)


class PoseSensorReader:
    """A `PoseSensor` at work."""

    def __init__(self, sensor: PoseSensor, seed: Seed) -> None:
        self.sensor = sensor
        self._normal = _normals(seed)
        self._error = (sensor.bias.x, sensor.bias.y, sensor.bias.yaw)
        self._jumps = deque(sensor.jumps)
        self._time: float | None = None

    def jump(self, offset: Pose2) -> None:
        """From now on the error is larger by `offset`."""
        x, y, yaw = self._error
        self._error = x + offset.x, y + offset.y, yaw + offset.yaw

    def measure(self, time: float, pose: Pose2) -> Pose2 | None:
        """What localization says of the true `pose` at `time` [s]; None where it is lost."""
        sensor, normal = self.sensor, self._normal
        root = math.sqrt(max(0.0, time - self._time)) if self._time is not None else 0.0
        self._time = time
        while self._jumps and self._jumps[0].time <= time + _INSTANT:
            self.jump(self._jumps.popleft().offset)
        x, y, yaw = self._error
        walk, turn = sensor.position_walk * root, sensor.yaw_walk * root
        x, y, yaw = x + walk * next(normal), y + walk * next(normal), yaw + turn * next(normal)
        self._error = x, y, yaw
        x += pose.x + sensor.position_sigma * next(normal)
        y += pose.y + sensor.position_sigma * next(normal)
        yaw += pose.yaw + sensor.yaw_sigma * next(normal)
        return None if _within(sensor.lost, time) else Pose2(x, y, yaw)


@dataclass(frozen=True)
class Odometry:
    """Body velocity from the wheels' encoders.

    Args:
        linear_gain: Of the speed [1].
        angular_gain: Of the yaw rate [1].
        linear_sigma: White noise of the speed [m/s].
        angular_sigma: White noise of the yaw rate [rad/s].
        tick: Way of a wheel between two ticks of its encoder [m]; the speed is then ticks per period. 0: continuous.
        track_width: Distance of the wheels that the ticks are counted at [m]; needed with ticks.

    Raises:
        InvalidValue: A value is not a number, negative or not finite; ticks without a track width.
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
        """A sensor switched on."""
        return OdometryReader(self, seed)


class OdometryReader:
    """An `Odometry` at work."""

    def __init__(self, sensor: Odometry, seed: Seed) -> None:
        self.sensor = sensor
        self._normal = _normals(seed)
        self._before: Twist2 | None = None
        self._travel = (0.0, 0.0)

    def measure(self, encoders: Twist2, duration: float) -> Twist2:
        """The measurements `duration` [s] after the last ones, the encoders turning at `encoders` now."""
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
    """A detector that finds the dock in pictures, and tells it late.

    A picture is taken at multiples of 1 / rate. It shows where the docked robot would stand, seen from where the robot
    truly is, plus white noise: position_sigma and yaw_sigma as long as the marker is within `near`, and larger by the
    share `growth` for each metre beyond. The sigmas that it tells with a detection are the true ones.

    Args:
        rate: Pictures per second [Hz].
        latency: From the picture to its delivery [s].
        position_sigma: Of x and y in the robot's frame, each [m].
        yaw_sigma: [rad].
        near: Distance of the marker within which the sigmas hold [m].
        growth: [1/m].
        marker: What the camera looks for, in the docked robot's frame; of its yaw no use is made.
        camera: In the robot's frame.
        field_of_view: Whole angle [rad].
        min_range: Nearest marker that is found [m].
        max_range: Farthest marker that is found [m].
        drop_out: Probability that nothing is found in a picture.
        lost: Faults: nothing is found in pictures taken then.
        outliers: Faults: the first picture taken at `time` or later is displaced by `offset`, in the robot's frame.

    Raises:
        InvalidValue: A value is not a number, negative or not finite, the rate 0, a drop-out more than 1, or the
            smallest range not below the largest.
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
    lost: tuple[Span, ...] = ()
    outliers: tuple[Displaced, ...] = ()

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
        object.__setattr__(self, "lost", _spans(self.lost, "dock_sensor.lost"))
        object.__setattr__(self, "outliers", _displacements(self.outliers, "dock_sensor.outliers"))

    def sigmas(self, distance: float) -> tuple[float, float]:
        """Of position [m] and yaw [rad] with the marker at this distance [m]."""
        share = 1.0 + self.growth * max(0.0, distance - self.near)
        return share * self.position_sigma, share * self.yaw_sigma

    def reader(self, seed: Seed = 0) -> DockSensorReader:
        """A sensor switched on."""
        return DockSensorReader(self, seed)


class DockSensorReader:
    """A `DockSensor` at work."""

    def __init__(self, sensor: DockSensor, seed: Seed) -> None:
        self.sensor = sensor
        noise, luck = _sequence(seed).spawn(2)
        self._normal, self._uniform = _normals(noise), np.random.default_rng(luck)
        self._outliers = deque(sensor.outliers)
        self._pictures = 0
        self._before: tuple[float, Pose2] | None = None
        self._under_way: deque[Detection] = deque()
        self._lost_until = -math.inf

    def lose(self, until: float) -> None:
        """Nothing is found in pictures before `until` [s]."""
        self._lost_until = until

    def displace_next(self, offset: Pose2) -> None:
        """The next picture is an outlier."""
        self._outliers.appendleft(Displaced(-math.inf, offset))

    def measure(self, time: float, pose: Pose2, dock: Pose2) -> tuple[Detection, ...]:
        """What is delivered until `time` [s], the oldest first, the robot having driven an arc to `pose`.

        Args:
            time: Not before that of the last call.
            pose: True pose of the robot.
            dock: True pose of the docked robot.
        """
        began, start = self._before or (time, pose)
        self._before = time, pose
        sensor = self.sensor
        while (stamp := self._pictures / sensor.rate) <= time + _INSTANT:
            self._pictures += 1
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
        if dropped or not in_sight or stamp < self._lost_until or _within(sensor.lost, stamp):
            return
        position_sigma, yaw_sigma = sensor.sigmas(distance)
        offset = _ORIGIN
        if self._outliers and self._outliers[0].time <= stamp + _INSTANT:
            offset = self._outliers.popleft().offset
        found = dock.in_frame_of(robot)
        measured = Pose2(
            found.x + offset.x + position_sigma * noise[0],
            found.y + offset.y + position_sigma * noise[1],
            found.yaw + offset.yaw + yaw_sigma * noise[2],
        )
        self._under_way.append(Detection(stamp, measured, position_sigma, yaw_sigma))


def _on_the_way(start: Pose2, end: Pose2, share: float) -> Pose2:
    """The pose at a share of the arc from one pose to another."""
    if share == 1.0:
        return end
    way = start.inverse() @ end
    turn = normalize_angle(way.yaw)
    half = 0.5 * turn
    stretch = half / math.sin(half) if abs(half) > 1e-9 else 1.0
    c, s = stretch * math.cos(half), stretch * math.sin(half)
    return Pose2(*arc_end(start.x, start.y, start.yaw, (c * way.x + s * way.y, turn, c * way.y - s * way.x), share))


def _within(spans: tuple[Span, ...], time: float) -> bool:
    return any(span.start - _INSTANT <= time < span.end - _INSTANT for span in spans)


def _spans(values: tuple[Span, ...], name: str) -> tuple[Span, ...]:
    spans = tuple(Span(*value) for value in values)
    for span in spans:
        if not finite_number(span.start, f"{name}.start") < number(span.end, f"{name}.end"):
            raise InvalidValue(f"{name}: must start before they end, got {span.start} and {span.end}")
    return spans


def _displacements(values: tuple[Displaced, ...], name: str) -> tuple[Displaced, ...]:
    found = tuple(Displaced(*value) for value in values)
    for one in found:
        finite_number(one.time, f"{name}.time")
        instance(Pose2, one.offset, f"{name}.offset")
    return tuple(sorted(found, key=lambda one: one.time))


def _normals(seed: Seed) -> Iterator[float]:
    """Standard normal numbers without end."""
    generator = np.random.default_rng(seed)
    while True:
        yield from generator.standard_normal(_BLOCK).tolist()


def _sequence(seed: Seed) -> np.random.SeedSequence:
    return seed if isinstance(seed, np.random.SeedSequence) else np.random.SeedSequence(seed)
