"""Paths: sequences of gear segments, parameterized by arc length and joined at cusps.

`s` is the travelled distance, which grows in either gear; a turn in place has a length of 1 m per rad (see `segments`).
Curvature is d yaw / d s, positive if the yaw increases along the travel. A path contains no times; see `trajectory`.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from optdock.errors import InvalidPath
from optdock.geometry.arrays import FrozenArrays, digest, frozen_array, readonly, vector
from optdock.geometry.checked import sampling_step
from optdock.geometry.lazy import cached_property
from optdock.geometry.pose import Pose2, check_range, unwrap_yaw
from optdock.model.segments import (
    SAME_POSITION,
    SAME_YAW,
    ClothoidSegment,
    Direction,
    PathSamples,
    PolylineSegment,
    Segment,
    TurnSegment,
    first_pose,
    moved_segment,
    piece_of,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from numpy.typing import ArrayLike

    from optdock.geometry.arrays import FloatArray, IntArray

__all__ = [
    "ClothoidSegment",
    "Direction",
    "Path",
    "PathSamples",
    "PolylineSegment",
    "Segment",
    "TurnSegment",
    "driven_stretches",
    "joint_curvatures",
    "may_be_one_frame",
    "parts_between_turns",
    "place_before_end",
]


@dataclass(frozen=True, eq=False, repr=False)
class Path(FrozenArrays):
    """Gear segments in driving order, separated by cusps.

    Args:
        segments: At least one; each starts where its predecessor ends.
        frame: Name of the coordinate frame; empty if unknown.

    Attributes:
        segment_starts: Arc length at the start of each segment, and the total: Shape (number of segments + 1,) [m].

    Raises:
        InvalidPath: If there is no segment, a segment is not of one of the three segment classes, or the frame is not a
            string.
    """

    segments: tuple[Segment, ...]
    frame: str = ""
    segment_starts: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        segments = tuple(self.segments)
        if not segments:
            raise InvalidPath("path: has no segment")
        if not isinstance(self.frame, str):
            raise InvalidPath(f"path.frame: must be a name, got {self.frame!r}")
        for i, segment in enumerate(segments):
            # Subclasses are rejected too, because they can override the poses that proofs rely on.
            if type(segment) not in (ClothoidSegment, PolylineSegment, TurnSegment):
                kinds, found = "a ClothoidSegment, a PolylineSegment or a TurnSegment", type(segment).__name__
                raise InvalidPath(f"path: segment {i} must be {kinds}, got {found}")
        starts = readonly(np.array([0.0, *itertools.accumulate([segment.length for segment in segments])]))
        # str.__str__ reduces an instance of a subclass to the plain string.
        vars(self).update(segments=segments, frame=str.__str__(self.frame), segment_starts=starts)

    @classmethod
    def from_poses(cls, poses: FloatArray | Iterable[Pose2 | Sequence[float]], frame: str = "") -> Path:
        """Return a polyline path with gears from the sign of (motion . heading) and cusps at changes of gear.

        Repeated poses are dropped. A step that does not change the position has the gear of the previous step.

        Args:
            poses: Shape (n, 3) [m, m, rad] or poses.
            frame: Name of the coordinate frame.

        Raises:
            InvalidPath: If there are fewer than two distinct poses, or a value is not finite or out of range.
        """
        if not isinstance(poses, np.ndarray):
            poses = np.array([pose.as_array() if isinstance(pose, Pose2) else pose for pose in poses])
        try:
            array = np.array(frozen_array(poses, "path", columns=3))
            check_range(array, "path")
        except ValueError as error:
            raise InvalidPath(str(error)) from error
        array[:, 2] = unwrap_yaw(array[:, 2])
        array = array[_distinct(array)] if len(array) else array
        if len(array) < 2:
            raise InvalidPath(f"path: needs at least 2 distinct poses, got {len(array)}")
        gears = _step_gears(array)
        cuts = np.concatenate(([0], np.flatnonzero(np.diff(gears)) + 1, [len(gears)]))
        return cls(
            tuple(PolylineSegment(array[a : b + 1], Direction(int(gears[a]))) for a, b in itertools.pairwise(cuts)),
            frame,
        )

    def with_frame(self, frame: str) -> Path:
        """Return the same path with the given frame name; an empty name has no effect.

        Raises:
            InvalidPath: If the path is in a different frame; poses are not transformed.
        """
        if frame in ("", self.frame):
            return self
        if not may_be_one_frame(self.frame, frame):
            raise InvalidPath(f"path: is in frame {self.frame!r}, not in {frame!r}; transform it first")
        return Path(self.segments, frame)

    def __repr__(self) -> str:
        gears = ", ".join(segment.direction.name.lower().replace("_", " ") for segment in self.segments)
        frame = f" in {self.frame!r}" if self.frame else ""
        return f"<Path {self.driven:.3f} m {gears}, {self.start.brief} -> {self.end.brief}{frame}>"

    @cached_property
    def length(self) -> float:
        """Arc length [m] over all gears and turns in place, which is the largest `s`."""
        return float(self.segment_starts[-1])

    @property
    def driven(self) -> float:
        """Driven distance: the arc length without turns in place [m]."""
        turned = sum(segment.length for segment in self.segments if isinstance(segment, TurnSegment))
        return self.length - turned

    @cached_property
    def turns(self) -> bool:
        """Whether the path contains a turn in place."""
        return any(isinstance(segment, TurnSegment) for segment in self.segments)

    @cached_property
    def gear_lengths(self) -> tuple[float, ...]:
        """Lengths of the segments that are driven, negative in reverse, in driving order [m]."""
        return tuple([int(one.direction) * one.length for one in self.segments if not isinstance(one, TurnSegment)])

    def piece(self, begin: float, end: float = math.inf) -> Path:
        """Return the part of the path from `begin` to `end` [m], clipped to the path; its `s` starts at 0.

        Raises:
            InvalidPath: If the part is empty; parts shorter than `SAME_POSITION` count as empty.
        """
        end = min(end, self.length)
        found = []
        for segment, first, last in zip(
            self.segments, self.segment_starts[:-1].tolist(), self.segment_starts[1:].tolist(), strict=True
        ):
            low, high = max(begin - first, 0.0), min(end, last) - first
            if high - low > SAME_POSITION or (low == 0.0 and high == last - first):
                found.append(piece_of(segment, low, min(high, segment.length)))
        if not found:
            raise InvalidPath(f"path: is empty between s = {begin:.6g} m and {end:.6g} m")
        return Path(tuple(found), self.frame)

    def moved(self, move: Pose2) -> Path:
        """Return the path transformed by a rigid motion of the plane: every pose p becomes `move @ p`."""
        return Path(tuple(moved_segment(segment, move) for segment in self.segments), self.frame)

    @cached_property
    def cusps(self) -> tuple[float, ...]:
        """Arc lengths [m] at which the robot rests: gear changes, and the two ends of turns in place."""
        return tuple(float(s) for s in self.segment_starts[1:-1])

    @cached_property
    def start(self) -> Pose2:
        """Pose at s = 0; if the path begins with a turn in place, the pose before the turn."""
        return first_pose(self.segments[0])

    @cached_property
    def end(self) -> Pose2:
        """Pose at s = length."""
        last = self.segments[-1]
        return Pose2.from_sequence(
            last.poses[-1] if isinstance(last, PolylineSegment) else last.poses_at(last.length)[0]
        )

    @cached_property
    def digest(self) -> str:
        """Digest of the exact curves, which is equal for equal paths."""
        return digest(*(part for segment in self.segments for part in _definition(segment)))

    def pose_at(self, s: float) -> Pose2:
        """Return the pose at arc length `s` [m], clipped to the path."""
        return Pose2.from_sequence(self.poses_at(s)[0])

    def poses_at(self, s: ArrayLike) -> FloatArray:
        """Return the poses at arc lengths `s`, Shape (n,) [m]; at a cusp, the pose for the next gear. Shape (n, 3)."""
        return self._evaluate(s, lambda segment, local: segment.poses_at(local), (3,))

    def curvature_at(self, s: ArrayLike) -> FloatArray:
        """Return the curvature at `s`; at a cusp the value of the next gear. Shape (n,) [1/m]."""
        return self._evaluate(s, lambda segment, local: segment.curvature_at(local), ())

    def curvature_rate_at(self, s: ArrayLike) -> FloatArray:
        """Return d curvature / ds at `s`; at a cusp the value of the next gear. Shape (n,) [1/m^2]."""
        return self._evaluate(s, lambda segment, local: segment.curvature_rate_at(local), ())

    def direction_at(self, s: ArrayLike) -> IntArray:
        """Return the gear at `s`: 1, -1, or 0 in turns in place; at a cusp the next gear. Shape (n,)."""
        gears = np.array([int(segment.direction) for segment in self.segments])
        directions: IntArray = gears[_owners(self, np.atleast_1d(np.asarray(s, dtype=np.float64)))]
        return directions

    def _evaluate(
        self, s: ArrayLike, of: Callable[[Segment, FloatArray], FloatArray], shape: tuple[int, ...]
    ) -> FloatArray:
        points = vector(s)
        if len(self.segments) == 1:
            return of(self.segments[0], points)
        owners, out = _owners(self, points), np.empty((points.size, *shape))
        for i in np.unique(owners):
            mine = owners == i
            out[mine] = of(self.segments[i], points[mine] - self.segment_starts[i])
        return out

    def sample(self, spacing: float) -> PathSamples:
        """Return points at most `spacing` [m] apart, including ends and cusps; a cusp appears once for each gear.

        Raises:
            InvalidValue: If the spacing is not a finite number > 0 or is far too small.
        """
        spacing = sampling_step(spacing, self.length, "spacing")
        blocks = [_sample_segment(segment, spacing) for segment in self.segments]
        shifted = [
            block._replace(s=block.s + start) for block, start in zip(blocks, self.segment_starts[:-1], strict=True)
        ]
        return PathSamples(*(np.concatenate(columns) for columns in zip(*shifted, strict=True)))


def may_be_one_frame(first: str, second: str) -> bool:
    """Whether two names can denote the same frame: either they are equal, or one is empty (unknown)."""
    return first == second or "" in (first, second)


def _definition(segment: Segment) -> tuple[ArrayLike, ...]:
    """Return the numbers that define a segment."""
    if isinstance(segment, ClothoidSegment):
        spline = segment.spline
        return spline.start.as_array(), spline.knots, spline.curvature, spline.sign
    if isinstance(segment, TurnSegment):
        return segment.pose.as_array(), segment.turn
    return segment.poses, int(segment.direction)


def _sample_segment(segment: Segment, spacing: float) -> PathSamples:
    count = max(1, int(np.ceil(segment.length / spacing - 1e-9)))
    s = np.linspace(0.0, segment.length, count + 1, dtype=np.float64)
    if isinstance(segment, PolylineSegment) and np.any(np.diff(segment.knots) <= 0.0):
        return _sample_steps(segment, spacing)
    poses = segment.poses_at(s)
    gear = np.full(s.size, int(segment.direction))
    return PathSamples(s, poses[:, 0], poses[:, 1], poses[:, 2], segment.curvature_at(s), gear)


def _sample_steps(segment: PolylineSegment, spacing: float) -> PathSamples:
    """Sample a polyline by pose number, because arc length does not distinguish the poses of a step of zero length."""
    counts = np.maximum(1, np.ceil(np.diff(segment.knots) / spacing - 1e-9)).astype(np.int64)
    borders = np.arange(segment.knots.size)
    step = np.append(np.concatenate([i + np.arange(n) / n for i, n in enumerate(counts)]), borders[-1])
    s, x, y, yaw = (np.interp(step, borders, column) for column in (segment.knots, *segment.poses.T))
    return PathSamples(s, x, y, yaw, segment.curvature_at(s), np.full(s.size, int(segment.direction)))


def _distinct(poses: FloatArray) -> FloatArray:
    """Return the indices of the poses that differ from their predecessor."""
    step = np.diff(poses, axis=0)
    moved = (np.hypot(step[:, 0], step[:, 1]) > SAME_POSITION) | (np.abs(step[:, 2]) > SAME_YAW)
    return np.concatenate(([0], np.flatnonzero(moved) + 1))


def _step_gears(poses: FloatArray) -> IntArray:
    step = np.diff(poses, axis=0)
    middle = poses[:-1, 2] + 0.5 * step[:, 2]
    ahead = step[:, 0] * np.cos(middle) + step[:, 1] * np.sin(middle)
    moving = np.hypot(step[:, 0], step[:, 1]) > SAME_POSITION
    gears = np.where(moving, np.where(ahead < 0.0, -1, 1), 0)
    if not moving.any():
        return np.ones(gears.size, dtype=np.int64)
    known = np.flatnonzero(moving)
    source = known[np.clip(np.searchsorted(known, np.arange(gears.size), side="right") - 1, 0, None)]
    owned: IntArray = gears[source]
    return owned


def driven_stretches(path: Path) -> tuple[tuple[float, float], ...]:
    """Return the intervals of `s` between turns in place [m], in driving order."""
    if not path.turns:
        return ((0.0, path.length),)
    ends = itertools.pairwise(path.segment_starts.tolist())
    groups = itertools.groupby(zip(path.segments, ends, strict=True), key=lambda one: isinstance(one[0], TurnSegment))
    stretches = ([span for _, span in group] for turn, group in groups if not turn)
    return tuple((spans[0][0], spans[-1][1]) for spans in stretches)


def place_before_end(path: Path, distance: float) -> float:
    """Return the `s` at which `distance` [m] remains to be driven; the result is negative if the path is shorter."""
    s = path.length - distance
    for segment, end in (
        zip(path.segments[::-1], path.segment_starts[:0:-1].tolist(), strict=True) if path.turns else ()
    ):
        if isinstance(segment, TurnSegment) and end > s:
            s -= segment.length
    return s


def parts_between_turns(path: Path) -> tuple[Path | TurnSegment, ...]:
    """Split a path at its turns in place; return the paths without turns and the turns, in driving order."""
    groups = itertools.groupby(path.segments, key=lambda segment: isinstance(segment, TurnSegment))
    cut = [[*segments] if turn else [Path(tuple(segments), path.frame)] for turn, segments in groups]
    return tuple(itertools.chain.from_iterable(cut))  # type: ignore[arg-type]  # by the key of the groups


def joint_curvatures(path: Path) -> FloatArray:
    """Return the curvature just before and just after every cusp, Shape (cusps, 2) [1/m].

    The sign is positive if steered wheels point to the left. The curvature of a segment driven in reverse is therefore
    negated.
    """
    ends = [
        (int(segment.direction) * segment.curvature_at([0.0, segment.length])).tolist() for segment in path.segments
    ]
    joints = [(before[1], after[0]) for before, after in itertools.pairwise(ends)]
    return np.array(joints, dtype=np.float64).reshape(-1, 2)


def _owners(path: Path, s: FloatArray) -> IntArray:
    """Return the index of the segment at each arc length; at a cusp the index of the next segment."""
    return np.searchsorted(path.segment_starts[1:-1], s, side="right")
