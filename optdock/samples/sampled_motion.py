"""Motions given by samples, the rounding of the samples, and the position of each sample along the path.

A pose alone does not determine the position along the path, because paths may cross themselves and fold back at cusps.
The signs of speed and yaw rate divide the samples into runs (forward, reverse, turn left, turn right), which must match
the parts of the path in order. Within a part the integrated speed gives the approximate position, and the projection of
the pose gives the exact position.
"""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.pose import wrap_angles
from optdock.model.path import TurnSegment
from optdock.verification.certificate import TOLERANCE, Violation

if TYPE_CHECKING:
    from collections.abc import Sequence

    from optdock.geometry.arrays import FloatArray
    from optdock.model.limits import MotionLimits
    from optdock.model.path import Path

__all__ = [
    "EXACT",
    "ON_PATH",
    "REACH",
    "Places",
    "Rounding",
    "Run",
    "SampledMotion",
    "gears_of",
    "half_unit",
    "places_of",
    "runs_of",
]

EXACT = TOLERANCE  # [m], [rad], ...: accuracy of numbers with more than five decimals
REACH = 0.02  # [m]: accuracy of steps between samples; a projection step is at most twice as long
ON_PATH = float(np.sqrt(2.0)) * EXACT  # [m], [rad]: x and y are accurate to 1e-6 each
_PROJECTIONS = 8
_CONVERGED = 1e-10  # [m]
_BENT = 10.0  # [1/m]: largest curvature by which rounded speeds and places explain yaw rates and turns
_LEFT = 2
_NAMES = {1: "drives forward", -1: "drives in reverse", 2: "turns left", -2: "turns right"}


class SampledMotion(NamedTuple):
    """A timed motion as columns of finite numbers in SI units, Shape (n,) each, n >= 2; t increases.

    Speed, acceleration and jerk are negative in reverse.
    """

    t: FloatArray
    x: FloatArray
    y: FloatArray
    yaw: FloatArray
    speed: FloatArray
    acceleration: FloatArray
    jerk: FloatArray
    yaw_rate: FloatArray
    yaw_acceleration: FloatArray


class Rounding(NamedTuple):
    """Largest rounding error of the written numbers of each kind, in SI units."""

    place: float
    yaw: float
    speed: float
    acceleration: float
    jerk: float
    yaw_rate: float
    yaw_acceleration: float
    time: float

    @classmethod
    def of(cls, motion: SampledMotion) -> Rounding:
        """Return half a unit of the last decimal of each kind; times on an even grid are exact, others within 5e-7."""
        steps = np.diff(motion.t)
        even = bool(np.ptp(steps) <= 1e-9 * steps[0])
        resolution = float(np.spacing(np.max(np.abs(motion.t))))
        time = resolution if even else max(resolution, half_unit(motion.t, most=0.5 * EXACT))
        return cls._make([half_unit(motion.x, motion.y), *map(half_unit, motion[3:]), time])


def half_unit(*columns: FloatArray, most: float = EXACT) -> float:
    """Return half a unit of the last decimal of columns with three to five decimals, `most` for other columns."""
    for decimals in (3, 4, 5):
        if all(np.array_equal(np.round(column, decimals), column) for column in columns):
            return 0.5 * 10.0**-decimals
    return most


def gears_of(motion: SampledMotion, rest: float) -> FloatArray:
    """Return the sign of each speed, or 0 for speeds up to `rest` [m/s]. Shape (n,)."""
    signs: FloatArray = np.where(np.abs(motion.speed) > rest, np.sign(motion.speed), 0.0)
    return signs


class Run(NamedTuple):
    """A part of a path in one gear, or a turn in place, with the samples in it.

    `kind`: 1: forward, -1: in reverse, 2: turn left, -2: turn right; `begin`, `end`: arc lengths of the part [m];
    `first`, `last`: first and last sample that moves in the part.
    """

    kind: int
    begin: float
    end: float
    first: int = 0
    last: int = 0

    @property
    def is_turn(self) -> bool:
        """Whether the robot turns in place."""
        return abs(self.kind) > 1


def runs_of(motion: SampledMotion, path: Path, limits: MotionLimits, rounding: Rounding) -> list[Run] | Violation:
    """Return the parts of the path with their samples, in order, or a violation if the samples do not match.

    Parts that may be driven between two samples have no run.
    """
    kinds = gears_of(motion, rounding.speed)
    if path.turns:
        threshold = rounding.yaw_rate + min(limits.max_curvature, _BENT) * rounding.speed + EXACT
        turning = np.abs(motion.yaw_rate) > threshold
        kinds = np.where((kinds == 0.0) & turning, _LEFT * np.sign(motion.yaw_rate), kinds)
    moving = np.flatnonzero(kinds)
    groups = np.split(moving, np.flatnonzero(np.diff(kinds[moving])) + 1) if moving.size else []
    found = [int(kinds[group[0]]) for group in groups]
    every = parts = _merged(_parts(path))
    if len(parts) != len(found):
        # From rest to rest within h, at most J h^3 / 32 can be driven or turned.
        jerks = {1: limits.max_jerk, 2: limits.turning.jerk}
        hidden = 0.03125 * float(np.max(np.diff(motion.t))) ** 3
        parts = [part for part in parts if part.end - part.begin > jerks[abs(part.kind)] * hidden + EXACT]
        if not found and not parts:
            return [Run(every[0].kind, 0.0, path.length, 0, motion.t.size - 1)]
        parts = _merged(parts)
    if found == [part.kind for part in parts]:
        pairs = zip(parts, groups, strict=True)
        return [part._replace(first=int(group[0]), last=int(group[-1])) for part, group in pairs]
    driven, wanted = (", ".join(_NAMES[kind] for kind in kinds) for kinds in (found, [part.kind for part in every]))
    return Violation("direction", f"direction: the motion {driven or 'rests'}; the path {wanted}", 0.0, 1.0)


def _parts(path: Path) -> list[Run]:
    """Return the segments of a path as runs without samples."""
    kinds = [
        int(np.copysign(_LEFT, segment.turn)) if isinstance(segment, TurnSegment) else int(segment.direction)
        for segment in path.segments
    ]
    spans = itertools.pairwise(path.segment_starts.tolist())
    return [Run(kind, begin, end) for kind, (begin, end) in zip(kinds, spans, strict=True)]


def _merged(parts: Sequence[Run]) -> list[Run]:
    """Merge neighbouring parts of one kind."""
    groups = [list(group) for _, group in itertools.groupby(parts, key=lambda part: part.kind)]
    return [group[0]._replace(end=group[-1].end) for group in groups]


class Places(NamedTuple):
    """Positions of samples along their path, Shape (n,) each.

    `s`: arc length [m]; `driven`: distance driven up to that position, without turns in place [m]; `apart`, `turned`:
    distance [m] and heading difference [rad] from the path.
    """

    s: FloatArray
    driven: FloatArray
    apart: FloatArray
    turned: FloatArray


def places_of(motion: SampledMotion, path: Path, runs: Sequence[Run], travelled: FloatArray, yaw: FloatArray) -> Places:
    """Return the position of every sample along the path; samples at rest between two runs belong to the nearer part.

    `travelled`: integrated speed, Shape (n,) [m]; `yaw`: continuous heading, Shape (n,) [rad].
    """
    n, before = motion.t.size, 0.0  # turned in place before the run
    s, driven, apart, turned = np.zeros(n), np.zeros(n), np.full(n, np.inf), np.full(n, np.inf)
    for i, run in enumerate(runs):
        rows = slice(runs[i - 1].last + 1 if i else 0, runs[i + 1].first if i + 1 < len(runs) else n)
        place = _on_turn(path, run, motion, yaw, rows) if run.is_turn else _on_drive(path, run, motion, travelled, rows)
        nearer = ~(np.maximum(place[1], place[2]) >= np.maximum(apart[rows], turned[rows]))
        here = np.arange(n)[rows][nearer]
        s[here], apart[here], turned[here] = (column[nearer] for column in place)
        driven[here] = (run.begin if run.is_turn else s[here]) - before
        before += (run.end - run.begin) * run.is_turn
    # A pose `ON_PATH` further along the path differs in heading by this angle.
    explained = ON_PATH * np.minimum(np.abs(path.curvature_at(s)), _BENT)
    return Places(s, driven, apart, np.maximum(turned - explained, 0.0))


def _on_turn(
    path: Path, run: Run, motion: SampledMotion, yaw: FloatArray, rows: slice
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the arc lengths of samples in a turn in place, with their distances [m] and angles [rad] from it."""
    at = path.poses_at(0.5 * (run.begin + run.end))[0]
    extent, sign = run.end - run.begin, np.sign(run.kind)
    turned = sign * (yaw[rows] - at[2]) + 0.5 * extent
    middle = 0.5 * sign * (yaw[run.first] + yaw[run.last] - 2.0 * at[2])
    turned -= 2.0 * np.pi * np.rint(middle / (2.0 * np.pi))
    on = np.clip(turned, 0.0, extent)
    return run.begin + on, np.hypot(motion.x[rows] - at[0], motion.y[rows] - at[1]), np.abs(turned - on)


def _on_drive(
    path: Path, run: Run, motion: SampledMotion, travelled: FloatArray, rows: slice
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Project positions onto a driven part, from the integrated distance scaled to its length; see `_on_turn`."""
    x, y, way = motion.x[rows], motion.y[rows], travelled[rows] - travelled[rows][0]
    s = run.begin + way * ((run.end - run.begin) / way[-1] if way[-1] > 0.0 else 1.0)
    s = np.clip(np.where(np.isfinite(s), s, run.begin), run.begin, run.end)
    poses, open_ = path.poses_at(s), np.arange(s.size)
    for _ in range(_PROJECTIONS):
        here = poses[open_]
        ahead = (x[open_] - here[:, 0]) * np.cos(here[:, 2]) + (y[open_] - here[:, 1]) * np.sin(here[:, 2])
        moved = np.clip(s[open_] + run.kind * np.clip(ahead, -2.0 * REACH, 2.0 * REACH), run.begin, run.end)
        changed = np.abs(moved - s[open_]) > _CONVERGED
        open_ = open_[changed]
        if open_.size == 0:
            break
        s[open_] = moved[changed]
        poses[open_] = path.poses_at(s[open_])
    return s, np.hypot(x - poses[:, 0], y - poses[:, 1]), np.abs(wrap_angles(motion.yaw[rows] - poses[:, 2]))
