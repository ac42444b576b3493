"""Where frames stand to each other: a buffer of what /tf and /tf_static say.

A transform `target <- source` is the pose of the source frame seen from the target frame. Transforms are full 3-D, kept
for 10 s, interpolated between two messages, and never carried on beyond the newest message by more than the caller
tolerates.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import JumpThreshold
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from tf2_msgs.msg import TFMessage

from optdock.errors import OptdockError
from optdock.geometry.pose import Pose2

if TYPE_CHECKING:
    from collections.abc import Mapping

    from geometry_msgs.msg import TransformStamped
    from numpy.typing import ArrayLike
    from rclpy.node import Node

    from optdock.geometry.arrays import FloatArray

__all__ = ["Transform", "TransformBuffer", "TransformError"]

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]

_HISTORY = 10.0  # [s]: as tf2's buffer
_DEPTH = 100  # messages: as tf2's listener; a burst of a hundred publishers gets through
_TILTED = 0.1  # [rad]: a floor robot's base leans less on any ramp; more says that the frames are mixed up
_NORMALISED = 1e-3  # of a quaternion's length; messages in float32 are good to 1e-6, hand-written ones to 1e-4
_LONGEST_CHAIN = 100  # frames: more than any robot has; frames in a circle are noticed
# [s]: stamps are nanoseconds, and seconds since 1970 as a float resolve 2.4e-7 s.
_SAME_TIME = 1e-6


class TransformError(OptdockError):
    """A transform cannot be told: a frame is unknown, two are not connected, or what is known is too old or too new."""


@dataclass(frozen=True)
class Transform:
    """The pose of one frame seen from another.

    Args:
        target: The frame that looks.
        source: The frame that is seen.
        stamp: When that holds [s], on the clock of the messages; of frames that never move, when it was asked for.
        translation: Origin of the source frame in the target frame [m].
        rotation: Unit quaternion x, y, z, w.
    """

    target: str
    source: str
    stamp: float
    translation: Vector
    rotation: Quaternion

    def planar(self) -> Pose2:
        """The pose in the plane.

        Raises:
            TransformError: The source frame leans by more than 0.1 rad: a plane says nothing about it.
        """
        x, y, z, w = self.rotation
        # The angle between the two z axes.
        tilt = math.acos(max(-1.0, min(1.0, 1.0 - 2.0 * (x * x + y * y))))
        if tilt > _TILTED:
            raise TransformError(
                f"{self.target} <- {self.source}: leans by {tilt:.3f} rad, more than {_TILTED} rad of roll and pitch; "
                f"it is no pose in the plane",
                where={"target": self.target, "source": self.source, "tilt": tilt},
            )
        yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        return Pose2(self.translation[0], self.translation[1], yaw)

    def poses(self, poses: ArrayLike) -> FloatArray:
        """Planar poses of the source frame seen from the target frame.

        Args:
            poses: Shape (n, 3) [m, m, rad].

        Returns:
            Shape (n, 3); yaws are turned by one angle, not normalized, so that continuous ones stay so.

        Raises:
            TransformError: As `planar`.
        """
        given, frame = np.asarray(poses, dtype=np.float64).reshape(-1, 3), self.planar()
        c, s = math.cos(frame.yaw), math.sin(frame.yaw)
        x, y, yaw = given.T
        moved: FloatArray = np.column_stack((frame.x + c * x - s * y, frame.y + s * x + c * y, frame.yaw + yaw))
        return moved

    def __matmul__(self, other: Transform) -> Transform:
        moved = _rotated(self.rotation, other.translation)
        (ax, ay, az), (bx, by, bz) = self.translation, moved
        rotation = _product(self.rotation, other.rotation)
        stamp = min(self.stamp, other.stamp)
        return Transform(self.target, other.source, stamp, (ax + bx, ay + by, az + bz), rotation)

    def inverse(self) -> Transform:
        """The pose of the target frame seen from the source frame."""
        x, y, z, w = self.rotation
        back = (-x, -y, -z, w)
        tx, ty, tz = _rotated(back, self.translation)
        return Transform(self.source, self.target, self.stamp, (-tx, -ty, -tz), back)


class _Sample(NamedTuple):
    stamp: float
    translation: Vector
    rotation: Quaternion


class _Track(NamedTuple):
    """What is known of one frame: its parent, and where it stood when; replaced as a whole, never written into."""

    parent: str
    is_static: bool
    samples: tuple[_Sample, ...]

    @property
    def newest(self) -> float:
        return self.samples[-1].stamp


class TransformBuffer:
    """Transforms between frames, as /tf and /tf_static tell them.

    Messages are stored by one thread at a time, lookups from any thread take what is there and never wait. A clock that
    jumps back forgets the moving frames.

    Args:
        node: Whose subscriptions they are; a node of `use_sim_time` has the simulation's clock.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._tracks: dict[str, _Track] = {}
        self._refused: set[tuple[str, str]] = set()
        group = MutuallyExclusiveCallbackGroup()
        # Best effort takes from publishers of either kind; what is lost is told again a moment later.
        moving = QoSProfile(depth=_DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
        fixed = QoSProfile(depth=_DEPTH, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._subscriptions = [
            node.create_subscription(TFMessage, "/tf", self._take_moving, moving, callback_group=group),
            node.create_subscription(TFMessage, "/tf_static", self._take_fixed, fixed, callback_group=group),
        ]
        backwards = JumpThreshold(min_forward=None, min_backward=Duration(nanoseconds=-1), on_clock_change=True)
        self._jumps = node.get_clock().create_jump_callback(backwards, post_callback=lambda _: self.forget())

    def close(self) -> None:
        """End the subscriptions; what is known stays."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        self._subscriptions = []
        self._jumps.unregister()

    def forget(self) -> None:
        """Forget the frames that move."""
        self._tracks = {name: track for name, track in self._tracks.items() if track.is_static}

    @property
    def frames(self) -> Mapping[str, str]:
        """The parent of every frame that is known."""
        return {name: track.parent for name, track in self._tracks.items()}

    def lookup(self, target: str, source: str, stamp: float | None = None, tolerance: float = 0.0) -> Transform:
        """The pose of the frame `source` seen from the frame `target`.

        Args:
            target: The frame that looks.
            source: The frame that is seen.
            stamp: When [s]; None: the newest time for which everything between the two is known.
            tolerance: How much older than `stamp` the newest message may be [s]; the frame is then where that message
                says, and the transform has its stamp. It is never guessed where it went.

        Raises:
            TransformError: One of them is unknown, they are not connected, or nothing is known for `stamp`.
        """
        target, source = target.lstrip("/"), source.lstrip("/")
        tracks = self._tracks
        seen, seeing = _to_root(tracks, source), _to_root(tracks, target)
        common = next((frame for frame in seen if frame in seeing), None)
        if common is None:
            raise self._unconnected(tracks, target, source)
        down, up = seen[: seen.index(common)], seeing[: seeing.index(common)]
        newest = [(tracks[f].newest, f) for f in (*down, *up) if not tracks[f].is_static]
        now = self._now()
        at = min(newest)[0] if stamp is None and newest else (now if stamp is None else stamp)
        if newest and at > min(newest)[0] + _SAME_TIME:
            at = self._held(target, source, at, min(newest), tolerance)
        from_source = self._along(tracks, down, source, at)
        from_target = self._along(tracks, up, target, at)
        found = from_target.inverse() @ from_source
        return Transform(target, source, at, found.translation, found.rotation)

    def _held(self, target: str, source: str, at: float, newest: tuple[float, str], tolerance: float) -> float:
        """The stamp of the newest message where it is near enough."""
        stamp, frame = newest
        if at - stamp <= tolerance:
            return stamp
        raise TransformError(
            f"{target} <- {source}: asked for {at:.3f} s, but the newest of {frame} is {at - stamp:.3f} s older, more "
            f"than {tolerance:g} s",
            where={"target": target, "source": source, "frame": frame, "stamp": at, "behind": at - stamp},
        )

    def _along(self, tracks: Mapping[str, _Track], chain: list[str], frame: str, at: float) -> Transform:
        """The pose of `frame` seen from the end of the chain of its parents."""
        found = Transform(frame, frame, at, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
        for name in chain:
            sample = _at(tracks[name], at)
            if sample is None:
                oldest = tracks[name].samples[0].stamp
                raise TransformError(
                    f"{tracks[name].parent} <- {name}: asked for {at:.3f} s, but the oldest known is "
                    f"{oldest - at:.3f} s newer",
                    where={"frame": name, "stamp": at, "before": oldest - at},
                )
            found = Transform(tracks[name].parent, name, at, sample.translation, sample.rotation) @ found
        return found

    def _unconnected(self, tracks: Mapping[str, _Track], target: str, source: str) -> TransformError:
        heard = {*tracks, *(track.parent for track in tracks.values())}
        unknown = [frame for frame in dict.fromkeys((target, source)) if frame not in heard]
        what = f"nobody has told of {' or '.join(map(repr, unknown))}" if unknown else "they are not connected"
        now = self._now()
        known = [
            f"{track.parent} <- {name} ({'static' if track.is_static else f'{now - track.newest:.2f} s old'})"
            for name, track in sorted(tracks.items())
        ]
        return TransformError(
            f"{target} <- {source}: {what}; known: {', '.join(known) or 'nothing'}",
            where={"target": target, "source": source, "unknown": unknown},
        )

    def _now(self) -> float:
        return float(self._node.get_clock().now().nanoseconds) * 1e-9

    def _take_moving(self, message: TFMessage) -> None:
        for transform in message.transforms:
            self.insert(transform)

    def _take_fixed(self, message: TFMessage) -> None:
        for transform in message.transforms:
            self.insert(transform, is_static=True)

    def insert(self, message: TransformStamped, *, is_static: bool = False) -> bool:
        """Store one transform; one that cannot be is refused, and said so in the log once per pair of frames.

        Args:
            message: A geometry_msgs/TransformStamped.
            is_static: Whether it holds at all times.

        Returns:
            Whether it was stored.
        """
        parent, child = message.header.frame_id.lstrip("/"), message.child_frame_id.lstrip("/")
        fault, sample = _sample(message)
        if sample is not None and not is_static and 0.0 < self._now() < sample.stamp - _HISTORY:
            # As the newest it would stand for ever, and everything before it would be forgotten.
            fault = f"is dated {sample.stamp - self._now():.1f} s into the future"
        if not fault and (not parent or not child or parent == child):
            fault = "needs two different frames"
        if not fault and child in _to_root(self._tracks, parent):
            fault = f"would close a circle: {child} is above {parent} already"
        if fault or sample is None:
            if (parent, child) not in self._refused:
                self._refused.add((parent, child))
                self._node.get_logger().error(f"{parent} <- {child}: {fault}; not used")
            return False
        known = self._tracks.get(child)
        if is_static or known is None or known.parent != parent or known.is_static:
            self._tracks[child] = _Track(parent, is_static, (sample,))
        else:
            self._tracks[child] = known._replace(samples=_inserted(known.samples, sample))
        return True


def _sample(message: TransformStamped) -> tuple[str, _Sample | None]:
    """What is wrong with a message, or what it says."""
    t, q, stamp = message.transform.translation, message.transform.rotation, message.header.stamp
    place, turn = (float(t.x), float(t.y), float(t.z)), (float(q.x), float(q.y), float(q.z), float(q.w))
    if not all(map(math.isfinite, (*place, *turn))):
        return f"must be finite, got {place}, {turn}", None
    norm = math.sqrt(sum(part * part for part in turn))
    if abs(norm - 1.0) > _NORMALISED:
        return f"its quaternion must have the length 1, got {norm:.6g}", None
    x, y, z, w = (part / norm for part in turn)
    return "", _Sample(stamp.sec + 1e-9 * stamp.nanosec, place, (x, y, z, w))


def _inserted(samples: tuple[_Sample, ...], sample: _Sample) -> tuple[_Sample, ...]:
    """The samples with one more, in order; of one time the last told counts, what is too old goes."""
    if sample.stamp > samples[-1].stamp:
        first = bisect_left(samples, sample.stamp - _HISTORY, key=lambda s: s.stamp)
        return (*samples[first:], sample)
    if sample.stamp < samples[-1].stamp - _HISTORY:
        return samples
    place = bisect_left(samples, sample.stamp, key=lambda s: s.stamp)
    same = samples[place].stamp == sample.stamp
    return (*samples[:place], sample, *samples[place + same :])


def _to_root(tracks: Mapping[str, _Track], frame: str) -> list[str]:
    """The frame, its parent, the parent's parent..."""
    chain = [frame]
    while (track := tracks.get(chain[-1])) is not None and len(chain) < _LONGEST_CHAIN:
        chain.append(track.parent)
    return chain


def _at(track: _Track, at: float) -> _Sample | None:
    """Where a frame stood; None before the first that is known. Later than the last, by rounding: as the last."""
    samples = track.samples
    if track.is_static or at >= samples[-1].stamp:
        return samples[-1]
    if at < samples[0].stamp:
        return samples[0] if samples[0].stamp - at <= _SAME_TIME else None
    place = bisect_left(samples, at, key=lambda s: s.stamp)
    after = samples[place]
    if after.stamp == at:
        return after
    before = samples[place - 1]
    share = (at - before.stamp) / (after.stamp - before.stamp)
    (ax, ay, az), (bx, by, bz) = before.translation, after.translation
    moved = (ax + share * (bx - ax), ay + share * (by - ay), az + share * (bz - az))
    return _Sample(at, moved, _between(before.rotation, after.rotation, share))


def _product(a: Quaternion, b: Quaternion) -> Quaternion:
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def _rotated(q: Quaternion, v: Vector) -> Vector:
    x, y, z, _w = _product(_product(q, (*v, 0.0)), (-q[0], -q[1], -q[2], q[3]))
    return x, y, z


def _between(a: Quaternion, b: Quaternion, share: float) -> Quaternion:
    """The rotation between two, the short way at constant speed."""
    dot = sum(p * q for p, q in zip(a, b, strict=True))
    sign = -1.0 if dot < 0.0 else 1.0
    angle = math.acos(min(1.0, abs(dot)))
    if angle < 1e-6:  # [rad]: a straight line is as good and divides by nothing
        first, second = 1.0 - share, sign * share
    else:
        first = math.sin((1.0 - share) * angle) / math.sin(angle)
        second = sign * math.sin(share * angle) / math.sin(angle)
    x, y, z, w = (first * p + second * q for p, q in zip(a, b, strict=True))
    norm = math.sqrt(x * x + y * y + z * z + w * w)
    return x / norm, y / norm, z / norm, w / norm
