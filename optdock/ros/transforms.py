"""Transforms between frames over time, from live messages or recordings.

A transform `target <- source` is the pose of the source frame in the target frame. Transforms are 3-D, are interpolated
between two messages, and are not extrapolated.
"""

from __future__ import annotations

import math
from array import array
from bisect import bisect_left
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

from optdock.errors import InvalidMessage, OptdockError
from optdock.geometry.pose import Pose2
from optdock.ros.messages import seconds
from optdock.ros.motion import MOST_TILTED, QUATERNION_NORM

if TYPE_CHECKING:
    from collections.abc import Mapping

    from optdock.ros.messages import Message

__all__ = ["Quaternion", "Transform", "TransformError", "TransformTree", "quaternion_product", "rotated"]

Vector: TypeAlias = tuple[float, float, float]
Quaternion: TypeAlias = tuple[float, float, float, float]

_LONGEST_CHAIN = 100  # frames: more than any robot has; ends a search in a cycle
# [s]: stamps are nanoseconds, and seconds since 1970 as a float resolve 2.4e-7 s.
_SAME_TIME = 1e-6
_WIDTH = 7  # numbers of a sample: translation and quaternion


class TransformError(OptdockError):
    """No transform exists: frames are unknown or not connected, or the known transforms are too old or too new."""


@dataclass(frozen=True)
class Transform:
    """The pose of one frame in another frame.

    Args:
        target: Frame in which the pose is given.
        source: Frame whose pose is given.
        stamp: Time of the transform on the clock of the messages [s]; for static frames the requested time, or inf if
            no time was requested.
        translation: Origin of the source frame in the target frame [m].
        rotation: Unit quaternion x, y, z, w.
    """

    target: str
    source: str
    stamp: float
    translation: Vector
    rotation: Quaternion

    def planar(self) -> Pose2:
        """Return the pose in the plane.

        Raises:
            TransformError: If the source frame is tilted by more than `MOST_TILTED`.
        """
        x, y, z, w = self.rotation
        tilt = 2.0 * math.asin(min(math.hypot(x, y), 1.0))
        if tilt > MOST_TILTED:
            raise TransformError(
                f"{self.target} <- {self.source}: is tilted by {tilt:.3f} rad, more than {MOST_TILTED} rad of roll and "
                f"pitch; it is not a pose in the plane",
                where={"target": self.target, "source": self.source, "tilt": tilt},
            )
        yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        return Pose2(self.translation[0], self.translation[1], yaw)

    def __matmul__(self, other: Transform) -> Transform:
        moved = rotated(self.rotation, other.translation)
        (ax, ay, az), (bx, by, bz) = self.translation, moved
        rotation = quaternion_product(self.rotation, other.rotation)
        stamp = min(self.stamp, other.stamp)
        return Transform(self.target, other.source, stamp, (ax + bx, ay + by, az + bz), rotation)

    def inverse(self) -> Transform:
        """Return the pose of the target frame in the source frame."""
        x, y, z, w = self.rotation
        back = (-x, -y, -z, w)
        tx, ty, tz = rotated(back, self.translation)
        return Transform(self.source, self.target, self.stamp, (-tx, -ty, -tz), back)


_Sample: TypeAlias = tuple[Vector, Quaternion]


class _Track:
    """Parent of one frame, and the poses of the frame over time.

    Samples are stored compactly, in two arrays with 64 bytes per sample, because a recording can contain millions of
    samples. Samples are only appended, and the time is appended after the values, so other threads read only complete
    samples. Any other change creates a new track.
    """

    __slots__ = ("is_static", "parent", "times", "values")

    def __init__(self, parent: str, *, is_static: bool, times: array[float], values: array[float]) -> None:
        self.parent, self.is_static, self.times, self.values = parent, is_static, times, values

    def sample(self, row: int) -> _Sample:
        x, y, z, qx, qy, qz, qw = self.values[_WIDTH * row : _WIDTH * row + _WIDTH]
        return (x, y, z), (qx, qy, qz, qw)

    def inserted(self, time: float, sample: array[float], first: int) -> _Track:
        """Return a track with one more sample and no samples before `first`; a sample at the same time is replaced."""
        row = bisect_left(self.times, time)
        after = row + (row < len(self.times) and self.times[row] == time)
        times = self.times[first:row] + array("d", [time]) + self.times[after:]
        values = self.values[_WIDTH * first : _WIDTH * row] + sample + self.values[_WIDTH * after :]
        return _Track(self.parent, is_static=False, times=times, values=values)


class TransformTree:
    """Tree of frames with their transforms over time.

    Only one thread at a time may store messages; lookups from any thread never block. A frame with a new parent loses
    its previous transforms.

    Args:
        history: Duration for which transforms are kept [s].
        reach: Duration [s] before the first and after the last message of a frame for which the frame is assumed not to
            move.
    """

    def __init__(self, history: float = math.inf, reach: float = 0.0) -> None:
        self._history, self._reach = history, reach
        self._tracks: dict[str, _Track] = {}
        self.refused: dict[tuple[str, str], str] = {}
        """Reason for the first rejected transform of each parent and child."""

    @property
    def frames(self) -> Mapping[str, str]:
        """Parent of every known frame."""
        return {name: track.parent for name, track in list(self._tracks.items())}

    def forget(self) -> None:
        """Remove the moving frames."""
        self._tracks = {name: track for name, track in list(self._tracks.items()) if track.is_static}

    def insert(self, message: Message, *, is_static: bool = False) -> bool:
        """Store a geometry_msgs/TransformStamped; see `put`."""
        parent, child = message.header.frame_id.lstrip("/"), message.child_frame_id.lstrip("/")
        t, q = message.transform.translation, message.transform.rotation
        try:
            stamp = seconds(message.header.stamp)
        except InvalidMessage as error:
            return self.refuse(parent, child, str(error))
        return self.put(parent, child, stamp, (t.x, t.y, t.z), (q.x, q.y, q.z, q.w), is_static=is_static)

    def put(
        self, parent: str, child: str, stamp: float, place: Vector, turn: Quaternion, *, is_static: bool = False
    ) -> bool:
        """Store the pose of a frame in its parent.

        Args:
            parent: Parent frame.
            child: The frame.
            stamp: Time of the pose [s].
            place: Position of the origin of the frame [m].
            turn: Quaternion x, y, z, w.
            is_static: Whether the pose is valid at all times.

        Returns:
            Whether the pose was stored; otherwise the reason is in `refused`.
        """
        parent, child = parent.lstrip("/"), child.lstrip("/")
        norm = math.hypot(*turn)
        fault = ""
        if not (math.isfinite(norm) and all(map(math.isfinite, place))):
            fault = f"must be finite, got {place}, {turn}"
        elif abs(norm - 1.0) > QUATERNION_NORM:
            fault = f"its quaternion must be of length 1 within {QUATERNION_NORM}, got {norm:.4g}"
        elif not parent or not child or parent == child:
            fault = "needs two different frames"
        elif child in _to_root(self._tracks, parent):
            fault = f"would form a loop: {child} is above {parent} already"
        if fault:
            return self.refuse(parent, child, fault)
        sample = array("d", (*place, *(part / norm for part in turn)))
        known = self._tracks.get(child)
        if known is None or known.parent != parent or is_static or known.is_static:
            self._tracks[child] = _Track(parent, is_static=is_static, times=array("d", [stamp]), values=sample)
        else:
            self._add(child, known, stamp, sample)
        return True

    def _add(self, child: str, known: _Track, stamp: float, sample: array[float]) -> None:
        """Store one more sample of a moving frame."""
        first, last = known.times[0], known.times[-1]
        if stamp > last and stamp - first <= 2.0 * self._history:  # old samples are dropped in batches
            known.values.extend(sample)
            known.times.append(stamp)  # written last, for readers in other threads
        elif stamp >= last - self._history:
            oldest = bisect_left(known.times, max(stamp, last) - self._history)
            self._tracks[child] = known.inserted(stamp, sample, oldest)

    def refuse(self, parent: str, child: str, why: str) -> bool:
        """Record the reason for rejecting a transform and return False."""
        self.refused.setdefault((parent, child), why)
        return False

    def lookup(self, target: str, source: str, stamp: float | None = None, tolerance: float = 0.0) -> Transform:
        """Return the pose of the frame `source` in the frame `target`.

        Args:
            target: Frame in which the pose is given.
            source: Frame whose pose is given.
            stamp: Time [s]; None for the newest time at which all frames between the two are known.
            tolerance: Largest age of the newest message relative to `stamp` [s]; the result then has the pose and the
                stamp of that message.

        Raises:
            TransformError: If a frame is unknown, the frames are not connected, or no transform is known for `stamp`.
        """
        target, source = target.lstrip("/"), source.lstrip("/")
        tracks = self._tracks
        seen, seeing = _to_root(tracks, source), _to_root(tracks, target)
        common = next((frame for frame in seen if frame in seeing), None)
        if common is None:
            raise self._unconnected(target, source)
        down, up = seen[: seen.index(common)], seeing[: seeing.index(common)]
        moving = ((tracks[name].times[-1], name) for name in (*down, *up) if not tracks[name].is_static)
        newest, frame = min(moving, default=(math.inf, ""))
        at = newest if stamp is None else stamp
        if at > newest + self._reach + _SAME_TIME:
            if at - newest > tolerance:
                raise TransformError(
                    f"{target} <- {source}: requested {at:.3f} s, but the newest of {frame} is {at - newest:.3f} s "
                    f"older, more than {tolerance:g} s",
                    where={"target": target, "source": source, "frame": frame, "stamp": at, "behind": at - newest},
                )
            at = newest
        from_source, from_target = self._along(tracks, down, source, at), self._along(tracks, up, target, at)
        found = from_target.inverse() @ from_source
        return Transform(target, source, at, found.translation, found.rotation)

    def _along(self, tracks: Mapping[str, _Track], chain: list[str], frame: str, at: float) -> Transform:
        """Return the pose of `frame` in the last frame of its chain of parents."""
        found = Transform(frame, frame, at, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
        for name in chain:
            place, turn = self._at(name, tracks[name], at)
            found = Transform(tracks[name].parent, name, at, place, turn) @ found
        return found

    def _at(self, name: str, track: _Track, at: float) -> _Sample:
        """Return the pose of a frame in its parent; at later times the last pose, whose age the caller checks."""
        times, count = track.times, len(track.times)
        if track.is_static or at >= times[count - 1]:
            return track.sample(count - 1)
        first = bisect_left(times, times[count - 1] - self._history, 0, count)
        row = bisect_left(times, at, first, count)
        if times[row] == at:
            return track.sample(row)
        if row == first:
            if times[first] - at <= self._reach + _SAME_TIME:
                return track.sample(first)
            raise TransformError(
                f"{track.parent} <- {name}: requested {at:.3f} s, but the oldest known is {times[first] - at:.3f} s "
                f"newer",
                where={"frame": name, "stamp": at, "before": times[first] - at},
            )
        share = (at - times[row - 1]) / (times[row] - times[row - 1])
        ((ax, ay, az), before), ((bx, by, bz), after) = track.sample(row - 1), track.sample(row)
        moved = (ax + share * (bx - ax), ay + share * (by - ay), az + share * (bz - az))
        return moved, _slerp(before, after, share)

    def stamp_text(self, newest: float) -> str:
        """Return the text of error messages for the stamp of a frame's newest transform."""
        return f"until {newest:.3f} s"

    def _unconnected(self, target: str, source: str) -> TransformError:
        tracks = dict(self._tracks)
        heard = {*tracks, *(track.parent for track in tracks.values())}
        unknown = [frame for frame in dict.fromkeys((target, source)) if frame not in heard]
        what = f"there is no transform of {' or '.join(map(repr, unknown))}" if unknown else "they are not connected"
        known = [
            f"{track.parent} <- {name} ({'static' if track.is_static else self.stamp_text(track.times[-1])})"
            for name, track in sorted(tracks.items(), key=lambda item: (item[1].parent, item[0]))
        ]
        refused = [f"{parent} <- {child} ({why})" for (parent, child), why in list(self.refused.items())]
        more = f"; refused: {', '.join(refused)}" if refused else ""
        return TransformError(
            f"{target} <- {source}: {what}; known: {', '.join(known) or 'nothing'}{more}",
            where={"target": target, "source": source, "unknown": unknown},
        )


def _to_root(tracks: Mapping[str, _Track], frame: str) -> list[str]:
    """Return the frame, its parent, and all further ancestors."""
    chain = [frame]
    while (track := tracks.get(chain[-1])) is not None and len(chain) < _LONGEST_CHAIN:
        chain.append(track.parent)
    return chain


def quaternion_product(a: Quaternion, b: Quaternion) -> Quaternion:
    """Return the product a b of two quaternions x, y, z, w."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def rotated(q: Quaternion, v: Vector) -> Vector:
    """Return a vector rotated by a quaternion x, y, z, w."""
    x, y, z, _w = quaternion_product(quaternion_product(q, (*v, 0.0)), (-q[0], -q[1], -q[2], q[3]))
    return x, y, z


def _slerp(a: Quaternion, b: Quaternion, share: float) -> Quaternion:
    """Return the spherical linear interpolation of two quaternions along the shorter arc."""
    dot = sum(p * q for p, q in zip(a, b, strict=True))
    sign = -1.0 if dot < 0.0 else 1.0
    angle = math.acos(min(1.0, abs(dot)))
    if angle < 1e-6:  # [rad]: linear interpolation, without a division by zero
        first, second = 1.0 - share, sign * share
    else:
        first = math.sin((1.0 - share) * angle) / math.sin(angle)
        second = sign * math.sin(share * angle) / math.sin(angle)
    x, y, z, w = (first * p + second * q for p, q in zip(a, b, strict=True))
    norm = math.hypot(x, y, z, w)
    return x / norm, y / norm, z / norm, w / norm
