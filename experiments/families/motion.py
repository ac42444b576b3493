"""Constructed motions: straights and turns that satisfy the curvature bounds, and raw paths next to them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.pose import Pose2
from optdock.model.path import ClothoidSegment, Direction, Path, PolylineSegment

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray

__all__ = ["Gear", "Kink", "motion_to", "raw_beside", "straight", "turn"]

_FINE_SAMPLES = 400  # points per Bezier curve before it is resampled by arc length
_HANDLE = 0.4  # length of a Bezier handle over its chord


class Piece(NamedTuple):
    """Curvature that changes linearly to `curvature` [1/m] over `length` [m]."""

    length: float
    curvature: float


class Gear(NamedTuple):
    """Motion in one gear; begins and ends with curvature 0."""

    direction: Direction
    pieces: tuple[Piece, ...]


class Kink(NamedTuple):
    """Deviation of a raw path in the middle of a gear.

    Args:
        angle: Jump of the heading [rad].
        shift: Lateral distance of the middle from the motion, positive left [m].
    """

    angle: float
    shift: float


def straight(length: float) -> tuple[Piece, ...]:
    """Return a straight of `length` [m]."""
    return (Piece(length, 0.0),)


def turn(angle: float, curvature: float, rate: float) -> tuple[Piece, ...]:
    """Return a turn by `angle` [rad] from straight to straight: clothoid, arc, clothoid.

    Args:
        angle: Change of yaw, positive left.
        curvature: Largest |curvature| [1/m].
        rate: |d curvature / ds| of the ramps [1/m^2].
    """
    peak = min(curvature, math.sqrt(abs(angle) * rate))  # a triangle of area |angle| has the peak sqrt(|angle| rate)
    ramp, signed = peak / rate, math.copysign(peak, angle)
    hold = abs(angle) / peak - ramp
    arc = (Piece(hold, signed),) if hold > 1e-9 else ()
    return (Piece(ramp, signed), *arc, Piece(ramp, 0.0))


def _spline(start: Pose2, gear: Gear) -> ClothoidSpline:
    knots = np.concatenate(([0.0], np.cumsum([piece.length for piece in gear.pieces])))
    curvature = np.array([0.0, *(piece.curvature for piece in gear.pieces)])
    return ClothoidSpline(start, knots, curvature, int(gear.direction))


def _drive(start: Pose2, gears: tuple[Gear, ...]) -> tuple[ClothoidSpline, ...]:
    splines: list[ClothoidSpline] = []
    for gear in gears:
        splines.append(_spline(splines[-1].end if splines else start, gear))
    return tuple(splines)


def motion_to(goal: Pose2, gears: tuple[Gear, ...]) -> Path:
    """Return the path of `gears` that ends at `goal`; its start follows from the gears."""
    end = _drive(Pose2(0.0, 0.0, 0.0), gears)[-1].end
    return Path(tuple(ClothoidSegment(spline) for spline in _drive(goal @ end.inverse(), gears)))


def raw_beside(motion: Path, kinks: tuple[Kink, ...], spacing: float) -> Path:
    """Return a raw path near `motion`: two cubic Bezier curves per gear that meet at a kink.

    Args:
        motion: Motion whose gear ends and directions are kept.
        kinks: One per gear.
        spacing: Largest distance between poses [m].
    """
    return Path(
        tuple(
            _raw_segment(motion, i, kink, spacing) for i, kink in zip(range(len(motion.segments)), kinks, strict=True)
        )
    )


def _raw_segment(motion: Path, index: int, kink: Kink, spacing: float) -> PolylineSegment:
    segment = motion.segments[index]
    first, middle, last = segment.poses_at([0.0, 0.5 * segment.length, segment.length])
    join = middle[:2] + kink.shift * np.array([-math.sin(middle[2]), math.cos(middle[2])])
    sign = int(segment.direction)
    arriving = _bezier(first[:2], first[2], join, middle[2] + 0.5 * kink.angle, sign)
    leaving = _bezier(join, middle[2] - 0.5 * kink.angle, last[:2], last[2], sign)
    head, tail = _resampled(arriving, sign, spacing), _resampled(leaving, sign, spacing)
    poses = np.vstack((head[:-1], [[*join, middle[2]]], tail[1:]))
    poses[0], poses[-1] = first, last
    poses[:, 2] = middle[2] + np.mod(poses[:, 2] - middle[2] + math.pi, 2.0 * math.pi) - math.pi
    poses[:, 2] = np.unwrap(poses[:, 2])
    return PolylineSegment(poses, segment.direction)


def _bezier(start: FloatArray, start_yaw: float, end: FloatArray, end_yaw: float, sign: int) -> FloatArray:
    handle = sign * _HANDLE * float(np.hypot(*(end - start)))
    inner = start + handle * np.array([math.cos(start_yaw), math.sin(start_yaw)])
    outer = end - handle * np.array([math.cos(end_yaw), math.sin(end_yaw)])
    u = np.linspace(0.0, 1.0, _FINE_SAMPLES)[:, None]
    v = 1.0 - u
    points: FloatArray = v**3 * start + 3.0 * v * v * u * inner + 3.0 * v * u * u * outer + u**3 * end
    return points


def _resampled(points: FloatArray, sign: int, spacing: float) -> FloatArray:
    """Return poses along a fine polyline, evenly spaced by at most `spacing`, with yaw along the motion."""
    step = np.diff(points, axis=0)
    s = np.concatenate(([0.0], np.cumsum(np.hypot(step[:, 0], step[:, 1]))))
    at = np.linspace(0.0, s[-1], max(2, math.ceil(s[-1] / spacing)) + 1)
    yaw = np.unwrap(np.arctan2(sign * step[:, 1], sign * step[:, 0]))
    columns = (points[:, 0], points[:, 1], np.interp(s, 0.5 * (s[1:] + s[:-1]), yaw))
    return np.column_stack([np.interp(at, s, column) for column in columns])
