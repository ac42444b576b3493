"""Paths of a case, evaluated piece by piece.

A place on a path is (piece, share): pieces are so short that none turns by more than a radian, and within a piece the
share runs from 0 to 1. Arc length alone is insufficient: a robot that turns in place has many poses at one arc length,
and a piece of 1e-14 m has no inner point after its arc length is added to a metre.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import numpy.typing as npt

    from experiments.fuzz.case import Case

    Floats = npt.NDArray[np.float64]
    Ints = npt.NDArray[np.int64]

__all__ = ["Motion", "Segment", "cut", "motion_of", "step_arc"]

# Twelve Gauss points over at most a radian of turn: exact to rounding.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(12)
_NODES, _WEIGHTS = 0.5 * (1.0 + _NODES), 0.5 * _WEIGHTS
_TURN_PER_PIECE = 1.0
_MOST_PIECES = 10_000_000  # of a clothoid
_SAME_POSITION = 1e-9  # [m]: the documented length below which a step has no direction


@dataclass(frozen=True)
class Segment:
    """One gear or turn in place: its rows of the motion's pieces, its gear, its knots and their values."""

    exact: bool
    gear: int
    first: int
    stop: int
    start_s: float
    length: float
    knots: Floats
    curvature: Floats  # exact: at the knots; polyline: of the steps; empty for a turn
    poses: Floats  # exact: the start pose; polyline: all poses, unwrapped; turn: first and last pose

    @property
    def in_place(self) -> bool:
        """Whether the robot turns in place."""
        return self.gear == 0

    @property
    def sampled(self) -> bool:
        """Whether it is a polyline."""
        return not (self.exact or self.in_place)


@dataclass(frozen=True)
class Motion:
    """Pieces of a path, all columns Shape (n,) or (n, 3).

    `pose`: at the start of the piece. `step`: polyline: change of the pose. `exact`: whether it is a clothoid. `h`: arc
    length, or the angle of a turn in place. `k0`, `k1`: curvature at both ends, along the travel. `gear`: 1, -1, or 0
    in a turn. `s`: path coordinate at its start.
    """

    pose: Floats
    step: Floats
    exact: npt.NDArray[np.bool_]
    h: Floats
    k0: Floats
    k1: Floats
    gear: Floats
    s: Floats
    segments: tuple[Segment, ...]

    @property
    def length(self) -> float:
        """Largest path coordinate [m]: arc length of all gears, plus 1 m for every radian of a turn in place."""
        return float(self.s[-1] + self.h[-1])

    def driven_before(self, piece: Ints, share: Floats) -> Floats:
        """Return the distance driven up to these places, Shape (n,) [m]."""
        driven = np.where(self.gear == 0.0, 0.0, self.h)
        before: Floats = np.cumsum(driven)[piece] - driven[piece] * (1.0 - share)
        return before

    @property
    def turn(self) -> Floats:
        """Upper bound of |change of yaw| within each piece [rad]."""
        with np.errstate(invalid="ignore"):  # a turn in place has no length and infinite curvature
            bent = self.h * np.maximum(np.abs(self.k0), np.abs(self.k1))
        turn: Floats = np.where(self.exact, bent, np.abs(self.step[:, 2]))
        return turn

    @property
    def way(self) -> Floats:
        """Distance of the origin's motion within each piece [m]."""
        way: Floats = np.where(self.exact, self.h, np.hypot(self.step[:, 0], self.step[:, 1]))
        return way

    def poses_at(self, piece: Ints, share: Floats) -> Floats:
        """Return poses, Shape (n, 3)."""
        base, h, k0, k1 = self.pose[piece], self.h[piece], self.k0[piece], self.k1[piece]
        out = base + share[:, None] * self.step[piece]
        rows = np.flatnonzero(self.exact[piece])
        if rows.size:
            u = share[rows, None] * _NODES
            theta = base[rows, 2, None] + h[rows, None] * (k0[rows, None] * u + 0.5 * (k1 - k0)[rows, None] * u * u)
            reach = self.gear[piece[rows]] * h[rows] * share[rows]
            out[rows, 0] = base[rows, 0] + reach * (np.cos(theta) @ _WEIGHTS)
            out[rows, 1] = base[rows, 1] + reach * (np.sin(theta) @ _WEIGHTS)
            last = share[rows]
            out[rows, 2] = base[rows, 2] + h[rows] * (k0[rows] * last + 0.5 * (k1 - k0)[rows] * last * last)
        return out

    def s_at(self, piece: Ints, share: Floats) -> Floats:
        """Return arc lengths, Shape (n,) [m]."""
        return self.s[piece] + share * self.h[piece]

    @property
    def start(self) -> Floats:
        """First pose."""
        return self.pose[0]

    @property
    def end(self) -> Floats:
        """Last pose."""
        return self.poses_at(np.array([self.h.size - 1]), np.array([1.0]))[0]

    def ends_of(self, segment: Segment) -> tuple[Floats, Floats]:
        """Return first and last pose of a gear."""
        places = np.array([segment.first, segment.stop - 1])
        both = self.poses_at(places, np.array([0.0, 1.0]))
        return both[0], both[1]


@dataclass(frozen=True)
class _Rows:
    """Columns of pieces, as in `Motion`, before they are concatenated."""

    pose: Floats
    step: Floats
    h: Floats
    k0: Floats
    k1: Floats


def step_arc(step: Floats) -> Floats:
    """Return arc lengths of steps (dx, dy, turn), Shape (n, 3): of arcs with this chord and turn. Shape (n,) [m]."""
    chord, half = np.hypot(step[:, 0], step[:, 1]), np.minimum(0.5 * np.abs(step[:, 2]), 0.5 * math.pi)
    with np.errstate(invalid="ignore", divide="ignore"):
        arc = np.where(half > 1e-8, chord * half / np.sin(half), chord)
    return np.where(chord > _SAME_POSITION, arc, 0.0)


def motion_of(path: list[Case]) -> Motion:
    """Return the motion of a case's path, a list of gears."""
    rows, segments, s, first = [], [], 0.0, 0
    for gear in path:
        made, knots, curvature, poses = _KINDS[gear["type"]](gear)
        length = float(np.sum(made.h))
        stop = first + made.h.size
        exact = gear["type"] == "clothoid"
        segments.append(Segment(exact, int(gear["gear"]), first, stop, s, length, knots, curvature, poses))
        rows.append(made)
        s, first = s + length, stop
    h = np.concatenate([one.h for one in rows])
    counts = [one.h.size for one in rows]
    return Motion(
        pose=np.vstack([one.pose for one in rows]),
        step=np.vstack([one.step for one in rows]),
        exact=np.repeat([one.exact for one in segments], counts),
        h=h,
        k0=np.concatenate([one.k0 for one in rows]),
        k1=np.concatenate([one.k1 for one in rows]),
        gear=np.repeat([float(one.gear) for one in segments], counts),
        s=np.concatenate(([0.0], np.cumsum(h)[:-1])),
        segments=tuple(segments),
    )


def _clothoid(gear: Case) -> tuple[_Rows, Floats, Floats, Floats]:
    knots, curvature = np.array(gear["knots"], dtype=float), np.array(gear["curvature"], dtype=float)
    h, k0, k1 = np.diff(knots), curvature[:-1], curvature[1:]
    parts = np.maximum(1, np.ceil(h * np.maximum(np.abs(k0), np.abs(k1)) / _TURN_PER_PIECE)).astype(np.int64)
    if parts.sum() > _MOST_PIECES:
        raise ValueError(f"a clothoid turns by {float(np.sum(parts)) * _TURN_PER_PIECE:.3g} rad")
    owner = np.repeat(np.arange(h.size), parts)
    rank = np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)
    rise = (k1 - k0) / parts
    low = k0[owner] + rise[owner] * rank
    short = (h / parts)[owner]
    high = np.where(rank + 1 == parts[owner], k1[owner], low + rise[owner])
    turn = 0.5 * short * (low + high)
    yaw = gear["start"][2] + np.concatenate(([0.0], np.cumsum(turn)))
    pose = np.column_stack((np.zeros((owner.size, 2)), yaw[:-1]))
    blank = np.zeros((owner.size, 3))
    # Each piece's displacement from its start, then their sum.
    theta = yaw[:-1, None] + short[:, None] * (low[:, None] * _NODES + 0.5 * (high - low)[:, None] * _NODES**2)
    reach = gear["gear"] * short
    move = np.column_stack((reach * (np.cos(theta) @ _WEIGHTS), reach * (np.sin(theta) @ _WEIGHTS)))
    pose[:, :2] = np.array(gear["start"][:2]) + np.vstack((np.zeros((1, 2)), np.cumsum(move, axis=0)[:-1]))
    return _Rows(pose, blank, short, low, high), knots, curvature, np.array([gear["start"]], dtype=float)


def _polyline(gear: Case) -> tuple[_Rows, Floats, Floats, Floats]:
    poses = np.array(gear["poses"], dtype=float)
    turns = np.diff(poses[:, 2])
    turns = np.remainder(turns + math.pi, 2.0 * math.pi) - math.pi  # the short way round
    poses[:, 2] = poses[0, 2] + np.concatenate(([0.0], np.cumsum(turns)))
    step = np.diff(poses, axis=0)
    arc = step_arc(step)
    with np.errstate(divide="ignore", invalid="ignore"):
        curvature = np.where(step[:, 2] == 0.0, 0.0, step[:, 2] / arc)
    knots = np.concatenate(([0.0], np.cumsum(arc)))
    return _Rows(poses[:-1], step, arc, curvature, curvature), knots, curvature, poses


def _turn(gear: Case) -> tuple[_Rows, Floats, Floats, Floats]:
    x, y, yaw = gear["start"]
    whole = float(gear["turn"])
    count = max(1, math.ceil(abs(whole) / _TURN_PER_PIECE))
    yaws = yaw + whole * np.arange(count + 1) / count
    poses = np.column_stack((np.full(count + 1, x), np.full(count + 1, y), yaws))
    h, k = np.full(count, abs(whole) / count), np.full(count, math.copysign(1.0, whole))
    rows = _Rows(poses[:-1], np.diff(poses, axis=0), h, k, k)
    return rows, np.array([0.0, abs(whole)]), np.zeros(0), poses[[0, -1]]


_KINDS = {"clothoid": _clothoid, "polyline": _polyline, "turn": _turn}


def cut(path: list[Case], begin: float, end: float = math.inf) -> list[Case]:
    """Return the gears of the part of a path between two places [m]; an empty part becomes one of a nanometre."""
    motion = motion_of(path)
    begin = min(max(begin, 0.0), motion.length - 2.0 * _SAME_POSITION)
    end = min(max(end, begin + 2.0 * _SAME_POSITION), motion.length)
    found = []
    for gear, segment in zip(path, motion.segments, strict=True):
        low, high = max(begin - segment.start_s, 0.0), min(end - segment.start_s, segment.length)
        if high - low > _SAME_POSITION or (low == 0.0 and high == segment.length):
            found.append(_CUTS[gear["type"]](gear, segment, motion, low, high))
    return found


def _pose_at(motion: Motion, segment: Segment, local: float) -> Floats:
    """Return the pose at an arc length of a gear [m]."""
    s = motion.s[segment.first : segment.stop] - segment.start_s
    piece = int(np.clip(np.searchsorted(s, local, side="right") - 1, 0, s.size - 1))
    share = np.clip((local - s[piece]) / max(float(motion.h[segment.first + piece]), 1e-300), 0.0, 1.0)
    return motion.poses_at(np.array([segment.first + piece]), np.array([share]))[0]


def _cut_clothoid(gear: Case, segment: Segment, motion: Motion, low: float, high: float) -> Case:
    knots = segment.knots
    inner = knots[(knots > low) & (knots < high)]
    inner = inner[(inner - low > _SAME_POSITION) & (high - inner > _SAME_POSITION)]
    at = np.concatenate(([low], inner, [high]))
    curvature = np.interp(at, knots, segment.curvature)
    start = _pose_at(motion, segment, low).tolist()
    return {**gear, "start": start, "knots": (at - low).tolist(), "curvature": curvature.tolist()}


def _cut_polyline(gear: Case, segment: Segment, _: Motion, low: float, high: float) -> Case:
    knots, poses = segment.knots, segment.poses
    inner = poses[(knots > low) & (knots < high)]
    ends = [[float(np.interp(s, knots, column)) for column in poses.T] for s in (low, high)]
    return {**gear, "poses": [ends[0], *inner.tolist(), ends[1]]}


def _cut_turn(gear: Case, _: Segment, __: Motion, low: float, high: float) -> Case:
    x, y, yaw = gear["start"]
    sign = math.copysign(1.0, gear["turn"])
    return {**gear, "start": [x, y, yaw + sign * low], "turn": sign * (high - low)}


_CUTS = {"clothoid": _cut_clothoid, "polyline": _cut_polyline, "turn": _cut_turn}
