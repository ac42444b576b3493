"""Map matching: a timed motion that is given by samples, and where on its path each of them is.

A pose alone does not tell: paths cross themselves, pass the same pose twice, and fold back at cusps. So samples are
matched in the order of driving. The sign of the speed tells the gear: the runs of one sign must be the gears of the
path, one after the other. Within a gear the distance driven between two samples follows from speeds and accelerations,
see `step_lengths`; a place found this way is then moved along the path to where the pose is beside it. Where the
errors of such steps could add up to more than `REACH`, the distance counts on from the place of the sample there.
"""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.model.path import TurnSegment, parts_between_turns
from optdock.verification.certificate import TOLERANCE, Violation

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray
    from optdock.model.limits import MotionLimits
    from optdock.model.path import Path

__all__ = [
    "EXACT",
    "REACH",
    "Places",
    "Rounding",
    "SampledMotion",
    "Steps",
    "Stretch",
    "half_unit",
    "places_of",
    "step_lengths",
    "stretches_of",
]

EXACT = TOLERANCE  # [m], [rad], ...: numbers with more decimals than five are taken to this
CORRECTED_TRAPEZOID = np.sqrt(3.0) / 54.0  # the error of that rule is at most this * |second derivative| * width^3
REACH = 0.02  # [m]: a sample is looked for so far around where it should be
_MAX_BLOCKS = 2000  # times that the distance counts on anew
_PROJECTIONS = 8
_BESIDE = 1e-10  # [m]: such a sample needs no further projection
_DRIVES = 2  # beside 1 and -1, which turn left and right
_BENT = 10.0  # [1/m]: no more of a curvature counts beside a turn


class SampledMotion(NamedTuple):
    """A timed motion in columns of Shape (n,), n >= 2, SI units, finite; t increases.

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
    """By how much a number of each kind may differ from what it stands for."""

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
        """Half a unit of the last decimal of each kind of column; times on an even grid are exact."""
        steps = np.diff(motion.t)
        even = bool(np.ptp(steps) <= 1e-9 * steps[0])
        resolution = float(np.spacing(np.max(np.abs(motion.t))))
        return cls(
            place=half_unit(motion.x, motion.y),
            yaw=half_unit(motion.yaw),
            speed=half_unit(motion.speed),
            acceleration=half_unit(motion.acceleration),
            jerk=half_unit(motion.jerk),
            yaw_rate=half_unit(motion.yaw_rate),
            yaw_acceleration=half_unit(motion.yaw_acceleration),
            time=resolution if even else max(resolution, half_unit(motion.t, most=0.0)),
        )


def half_unit(*columns: FloatArray, most: float = EXACT) -> float:
    """Half a unit of the last decimal of these numbers, if they have three to five decimals; `most` otherwise."""
    for decimals in (3, 4, 5):
        if all(np.array_equal(np.round(column, decimals), column) for column in columns):
            return 0.5 * 10.0**-decimals
    return most


class Places(NamedTuple):
    """Where the samples are, Shape (n,) each: arc length `s` [m] and gear, 1 or -1; `poses` of the path there, (n, 3).

    `sure`: False where a sample rests between two gears and accelerates, so that it may be on either side of the cusp.
    """

    s: FloatArray
    gear: FloatArray
    poses: FloatArray
    sure: BoolArray


class Steps(NamedTuple):
    """Distances between samples, Shape (n - 1,) [m]: what speeds say, and by how much a motion may differ from it."""

    length: FloatArray
    error: FloatArray


class _Gear(NamedTuple):
    direction: int
    begin: float
    end: float


def step_lengths(t: FloatArray, v: FloatArray, a: FloatArray, limits: MotionLimits) -> Steps:
    """Distance between samples by the corrected trapezoid rule, and a bound of its error for every lawful motion.

    With v' = a and |v''| <= J, partial integration gives

        int v dt = h (v0 + v1) / 2 - h^2 (a1 - a0) / 12 + E,   E = -int (u (h - u) / 2 - h^2 / 12) v'' du

    so |E| <= J h^3 sqrt(3) / 54. With |v'| <= A alone the trapezoid is off by at most A h^2 / 4; and no motion drives
    backwards or further than V h. The smallest of the three bounds holds.

    Args:
        t: Times, increasing, Shape (n,) [s].
        v: Speeds along the travel [m/s].
        a: Accelerations along the travel [m/s^2].
        limits: What the motion keeps.
    """
    h, change = np.diff(t), np.diff(a)
    length = h * 0.5 * (v[:-1] + v[1:]) - h**2 / 12.0 * change
    steepest = max(limits.max_acceleration, limits.max_deceleration)
    fastest = max(limits.max_speed, limits.max_reverse_speed)
    by_jerk = CORRECTED_TRAPEZOID * limits.max_jerk * h**3
    by_acceleration = 0.25 * steepest * h**2 + h**2 / 12.0 * np.abs(change)
    return Steps(length, np.minimum(np.minimum(by_jerk, by_acceleration), fastest * h + np.abs(length)))


def places_of(motion: SampledMotion, path: Path, limits: MotionLimits, rest: tuple[float, float]) -> Places | Violation:
    """The place of every sample, or why there is none.

    Args:
        motion: The samples.
        path: What they claim to follow.
        limits: What the motion keeps.
        rest: Speeds and accelerations up to these count as none [m/s, m/s^2].
    """
    still, steady = rest
    gears = _gears(path)
    run = _runs(motion, gears, limits, still)
    if isinstance(run, Violation):
        return run
    s, sign, poses = np.empty(motion.t.size), np.empty(motion.t.size), np.empty((motion.t.size, 3))
    for index, (first, last) in _spans(run):
        gear, rows = gears[index], slice(first, last)
        sign[rows] = gear.direction
        steps = step_lengths(
            motion.t[rows], gear.direction * motion.speed[rows], gear.direction * motion.acceleration[rows], limits
        )
        blocks = _blocks(steps, np.diff(motion.t[rows]) * still)
        if len(blocks) > _MAX_BLOCKS:
            message = f"the samples leave their places on the path open {len(blocks)} times; sample the motion finer"
            return Violation("too_coarse", message, gear.begin, float(len(blocks)))
        travelled = np.concatenate(([0.0], np.cumsum(steps.length)))
        at = gear.begin
        for a, b in blocks:
            part = slice(first + a, first + b)
            expected = np.clip(at + travelled[a:b] - travelled[a], gear.begin, gear.end)
            s[part], poses[part] = _beside(path, gear, expected, motion.x[part], motion.y[part])
            at = s[first + b - 1]
    unsure = (
        (np.abs(motion.speed) <= still) & (np.abs(motion.acceleration) > steady) & _between_gears(motion, run, still)
    )
    return Places(s, sign, poses, ~unsure)


class Stretch(NamedTuple):
    """A part of a path, between turns in place or one of them; where it begins [m]; its first sample, and one after.

    One sample at rest before it and one behind it belong to it. What only stands still, as a robot does that is about
    to move, may belong to either side and is left out.
    """

    part: Path | TurnSegment
    begin: float
    rows: tuple[int, int]


def stretches_of(
    motion: SampledMotion, path: Path, limits: MotionLimits, rounding: Rounding
) -> list[Stretch] | Violation:
    """Which samples drive and which turn in place, in the order of the path; or why they cannot follow it.

    A sample turns where its yaw rate is more than what rounding hides of its speed could make. The runs of one kind
    (driving, turning left, turning right) must be those of the path, one after the other, but for those that fit
    between two samples.

    Args:
        motion: The samples.
        path: What they claim to follow.
        limits: What the motion keeps.
        rounding: Of the samples.
    """
    parts = parts_between_turns(path)
    kinds = [int(np.sign(part.turn)) if isinstance(part, TurnSegment) else _DRIVES for part in parts]
    h = float(np.max(np.diff(motion.t)))
    hidden = [
        part.length <= (limits.turning.jerk if kind != _DRIVES else limits.max_jerk) * h**3 / 32.0 + EXACT
        for part, kind in zip(parts, kinds, strict=True)
    ]
    bend = min(limits.max_curvature, _BENT)
    turning = np.abs(motion.yaw_rate) > rounding.yaw_rate + bend * rounding.speed + EXACT
    drives = np.abs(motion.speed) > rounding.speed
    found = np.where(drives, _DRIVES, np.where(turning, np.sign(motion.yaw_rate), 0)).astype(np.int64)
    shown = np.flatnonzero(found)
    begins = shown[np.concatenate(([True], np.diff(found[shown]) != 0))] if shown.size else shown
    wanted = _merged(list(range(len(parts))), kinds)
    if len(wanted) != begins.size:
        wanted = _merged([i for i in range(len(parts)) if not hidden[i]], kinds)
    if found[begins].tolist() != [kinds[group[0]] for group in wanted]:
        names = {_DRIVES: "drives", 1: "turns left", -1: "turns right"}
        does, asked = (", ".join(names[k] for k in ks) for ks in (found[begins].tolist(), kinds))
        message = f"direction: the motion {does or 'rests'}; the path {asked}"
        return Violation("direction", message, 0.0, 1.0)
    at_rest = found == 0
    at_rest &= np.abs(motion.acceleration) <= rounding.acceleration
    at_rest &= np.abs(motion.yaw_acceleration) <= rounding.yaw_acceleration
    ends = shown[np.concatenate((np.diff(found[shown]) != 0, [True]))] if shown.size else shown
    firsts, lasts = begins - at_rest[begins - 1], ends + 1 + np.append(at_rest, False)[ends + 1]
    if shown.size:
        firsts[0], lasts[-1] = 0, motion.t.size
    starts = [0.0, *itertools.accumulate(part.length for part in parts)]
    spans = zip(wanted, firsts.tolist(), lasts.tolist(), strict=True)
    return [Stretch(parts[i], starts[i], (first, last)) for (i, *more), first, last in spans if not more]


def _merged(numbers: Sequence[int], kinds: Sequence[int]) -> list[list[int]]:
    """Numbers of parts, those of one kind that follow each other in one group: no sample tells them apart."""
    return [list(group) for _, group in itertools.groupby(numbers, key=lambda i: kinds[i])]


def _gears(path: Path) -> list[_Gear]:
    """The stretches of one direction each, in driving order."""
    gears: list[_Gear] = []
    for segment, begin, end in zip(path.segments, path.segment_starts[:-1], path.segment_starts[1:], strict=True):
        if gears and gears[-1].direction == segment.direction:
            gears[-1] = gears[-1]._replace(end=float(end))
        else:
            gears.append(_Gear(int(segment.direction), float(begin), float(end)))
    return gears


def _runs(motion: SampledMotion, gears: Sequence[_Gear], limits: MotionLimits, rest: float) -> IntArray | Violation:
    """The gear of every sample, as an index, Shape (n,); a sample at rest has that of the one before it."""
    moving = np.flatnonzero(np.abs(motion.speed) > rest)
    if moving.size == 0:
        return np.zeros(motion.t.size, dtype=np.int64)
    sign = np.sign(motion.speed[moving])
    begins = np.concatenate(([True], np.diff(sign) != 0.0))
    found = sign[begins]
    # A gear shorter than what can be driven from rest to rest within a step may have no moving sample.
    hidden = limits.max_jerk * float(np.max(np.diff(motion.t))) ** 3 / 32.0
    wanted = list(range(len(gears)))
    if found.size != len(wanted):
        wanted = [i for i in wanted if gears[i].end - gears[i].begin > hidden + rest]
        wanted = [i for k, i in enumerate(wanted) if k == 0 or gears[i].direction != gears[wanted[k - 1]].direction]
    directions = np.array([gears[i].direction for i in wanted])
    common = min(found.size, directions.size)
    wrong = np.flatnonzero(found[:common] != directions[:common])
    if wrong.size or found.size != directions.size:
        k = int(wrong[0]) if wrong.size else common
        return _wrong_gear(motion, moving[begins], found, directions, k)
    number = np.zeros(motion.t.size, dtype=np.int64)
    number[moving[begins][1:]] = 1
    runs: IntArray = np.array(wanted)[np.cumsum(number)]
    return runs


def _between_gears(motion: SampledMotion, run: IntArray, rest: float) -> BoolArray:
    """Whether the moving samples before and after a sample are of different gears, Shape (n,)."""
    moving = np.flatnonzero(np.abs(motion.speed) > rest)
    if moving.size == 0:
        return np.zeros(run.size, dtype=np.bool_)
    after = np.clip(np.searchsorted(moving, np.arange(run.size)), 0, moving.size - 1)
    between: BoolArray = run[moving[after]] != run
    return between


def _wrong_gear(
    motion: SampledMotion, begins: IntArray, found: FloatArray, directions: FloatArray, k: int
) -> Violation:
    """What run number `k` does against the gears of the path."""
    names = {1: "forward", -1: "in reverse"}
    if k >= found.size:
        message = f"direction: the motion ends before gear {k + 1} of the path, which goes {names[int(directions[k])]}"
        return Violation("direction", message, 0.0, 1.0)
    i = int(begins[k])
    does = f"speed {motion.speed[i]:.4g} m/s at t = {motion.t[i]:.3f} s goes {names[int(found[k])]}"
    where = (
        f"gear {k + 1} of the path goes {names[int(directions[k])]}" if k < directions.size else "the path has ended"
    )
    return Violation("direction", f"direction: {does}, {where}", 0.0, abs(float(motion.speed[i])))


def _spans(run: IntArray) -> Iterator[tuple[int, tuple[int, int]]]:
    """Every gear with its first sample and the one after its last."""
    edges = np.concatenate(([0], np.flatnonzero(np.diff(run)) + 1, [run.size]))
    for first, last in itertools.pairwise(edges.tolist()):
        yield int(run[first]), (first, last)


def _blocks(steps: Steps, rounding: FloatArray) -> list[tuple[int, int]]:
    """Samples, from and to, over which the errors of the steps add up to no more than `REACH`; neighbours share one."""
    count = steps.length.size + 1
    number = np.floor(np.cumsum(steps.error + rounding) / REACH).astype(np.int64)
    cuts = np.flatnonzero(np.diff(number, prepend=0)).tolist()
    borders = [0, *(cut for cut in cuts if cut > 0), count - 1]
    return [(a, b + 1) for a, b in itertools.pairwise(borders)]


def _beside(path: Path, gear: _Gear, s: FloatArray, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Arc lengths near `s`, Shape (n,), at which the path has the points beside it, and its poses there, (n, 3)."""
    s, rows = s.copy(), np.arange(s.size)
    poses = path.poses_at(s)
    for _ in range(_PROJECTIONS):
        here = poses[rows]
        ahead = (x[rows] - here[:, 0]) * np.cos(here[:, 2]) + (y[rows] - here[:, 1]) * np.sin(here[:, 2])
        moved = np.clip(s[rows] + gear.direction * np.clip(ahead, -2.0 * REACH, 2.0 * REACH), gear.begin, gear.end)
        changed = np.abs(moved - s[rows]) > _BESIDE
        rows = rows[changed]
        if rows.size == 0:
            break
        s[rows] = moved[changed]
        poses[rows] = path.poses_at(s[rows])
    return s, poses
