"""Paths as columns of numbers in plan files.

Samples alone are read as a polyline. If exact curves (`segments`) are given in addition, they define the path, and the
samples must lie on it. If the curves miss the samples because their numbers were rounded, the samples are used.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Literal, TypeAlias

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, TypeAdapter, ValidationError

from optdock.errors import InvalidFile
from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.pose import Pose2, wrap_angles
from optdock.model.path import ClothoidSegment, Direction, Path, PolylineSegment, Segment, TurnSegment
from optdock.samples.sampled_motion import half_unit

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from optdock.geometry.arrays import FloatArray

__all__ = [
    "Number",
    "PathColumns",
    "check_sampled_curvature",
    "curves_of",
    "path_columns",
    "path_from_columns",
    "path_from_curves",
]

logger = logging.getLogger(__name__)

# Samples of an exact path may differ from it by this much [m, rad].
AGREEMENT = 1e-6
_ROUNDED = 1e-4  # [m, rad]: largest deviation of rounded curves from their samples
_STILL = 1e-9  # [m]: shorter steps carry no direction
_CURVATURE = 0.01  # [1/m] and relative: tolerance of sampled curvatures
_ENOUGH = 3  # steps needed to determine the unit of yaws
_ALIGNED = 0.05  # largest sine of the angle between motion and heading of a rolling robot


def _no_boolean(value: object) -> object:
    """Reject booleans, which Python treats as equal to 0 and 1."""
    return repr(value) if isinstance(value, bool) else value


Gear: TypeAlias = Annotated[Literal[1, -1], BeforeValidator(_no_boolean)]
GearOrTurn: TypeAlias = Annotated[Literal[1, -1, 0], BeforeValidator(_no_boolean)]  # 0: turn in place
# The curvature of a polyline that turns in place is 1e9.
Number: TypeAlias = Annotated[float, Field(ge=-1e9, le=1e9)]
Json: TypeAlias = Mapping[str, object]


class _Columns(BaseModel):
    model_config = ConfigDict(strict=True, frozen=True, extra="ignore", allow_inf_nan=False, defer_build=True)


class _Clothoid(_Columns):
    """Curvature linear between knots: start [m, m, rad], knots [m], curvature [1/m]."""

    start: Annotated[list[Number], Field(min_length=3, max_length=3)]
    knots: list[Number]
    curvature: list[Number]
    direction: Gear


class _Polyline(_Columns):
    """Poses [m, m, rad] in driving order."""

    poses: list[Annotated[list[Number], Field(min_length=3, max_length=3)]]
    direction: Gear


class _TurnColumns(_Columns):
    """A turn in place: start pose [m, m, rad] and angle [rad]."""

    start: Annotated[list[Number], Field(min_length=3, max_length=3)]
    turn: Number


_Curve: TypeAlias = _Clothoid | _Polyline | _TurnColumns
_CURVES: TypeAdapter[list[_Curve]] = TypeAdapter(list[_Curve], config=ConfigDict(defer_build=True))


class PathColumns(_Columns):
    """A path in a plan file; s [m], curvature [1/m] and direction are optional."""

    s: list[Number] | None = None
    x: list[Number]
    y: list[Number]
    yaw: list[Number]
    curvature: list[Number] | None = None
    direction: list[GearOrTurn] | None = None
    segments: list[_Curve] | None = None


def path_columns(path: Path, spacing: float) -> dict[str, object]:
    """Return samples of a path, at most `spacing` [m] apart, and its exact curves as plain JSON values."""
    samples = path.sample(spacing)
    columns: dict[str, object] = {name: column.tolist() for name, column in samples._asdict().items()}
    return {**columns, "segments": curves_of(path)}


def curves_of(path: Path) -> list[Json]:
    """Return the exact curves of a path as plain JSON values."""
    return [_curve(segment) for segment in path.segments]


def path_from_curves(curves: Sequence[object], frame: str = "") -> Path:
    """Return the path of the result of `curves_of`.

    Raises:
        InvalidFile: If a curve is invalid.
    """
    try:
        parsed = _CURVES.validate_python(curves)
    except ValidationError as error:
        raise InvalidFile(f"curves of a path: {error.errors()[0]['msg']}") from error
    return Path(tuple(_segment(curve) for curve in parsed), frame)


def _curve(segment: Segment) -> Json:
    """Return the parameters of an exact curve."""
    if isinstance(segment, ClothoidSegment):
        spline = segment.spline
        return {
            "start": spline.start.as_array().tolist(),
            "knots": spline.knots.tolist(),
            "curvature": spline.curvature.tolist(),
            "direction": spline.sign,
        }
    if isinstance(segment, PolylineSegment):
        return {"poses": segment.poses.tolist(), "direction": int(segment.direction)}
    return {"start": segment.pose.as_array().tolist(), "turn": segment.turn}


def path_from_columns(columns: PathColumns, name: str) -> tuple[Path, bool]:
    """Return the exact path if the columns contain its curves, otherwise the polyline through the samples.

    Args:
        columns: Samples and optional curves.
        name: Name of the path in messages.

    Returns:
        The path, and whether it is exact.

    Raises:
        InvalidFile: If columns differ in length, there are fewer than two samples, the arc length is too short or too
            long, a direction is opposite to the motion, or samples are not on the curves.
        InvalidValue: If the curves are invalid.
    """
    _check_lengths(columns, name)
    poses = np.column_stack((columns.x, columns.y, columns.yaw))
    _check_arc_length(columns, poses, name)
    if not columns.segments:
        _check_radians(poses, name)
        _check_directions(columns, poses, name)
        return Path.from_poses(poses), False
    path = Path(tuple(_segment(curve) for curve in columns.segments))
    try:
        _check_agreement(columns, poses, path, name)
    except InvalidFile as error:
        if not _are_rounded(columns, columns.segments, path, poses):
            raise
        logger.warning("%s; the segments are rounded, so the samples are used", error)
        return path_from_columns(columns.model_copy(update={"segments": None}), name)
    return path, True


def _are_rounded(columns: PathColumns, curves: Sequence[_Curve], path: Path, poses: FloatArray) -> bool:
    """Whether the numbers of the curves have at most six decimals, and only rounding separates curves and samples."""
    if columns.s is None or abs(columns.s[-1] - path.length) > _ROUNDED:
        return False
    apart, turned = _off_curves(np.array(columns.s), poses, path, _ROUNDED)
    if max(np.max(apart), np.max(turned)) > _ROUNDED:
        return False
    numbers = np.fromiter((number for curve in curves for number in _numbers(curve)), dtype=np.float64)
    ends = np.stack((path.start.as_array(), path.end.as_array())) - poses[[0, -1]]
    ends[:, 2] = wrap_angles(ends[:, 2])
    return bool(np.array_equal(np.round(numbers, 6), numbers) and np.max(np.abs(ends)) <= _ROUNDED)


def _numbers(curve: _Curve) -> Iterator[float]:
    if isinstance(curve, _Clothoid):
        yield from (*curve.start, *curve.knots, *curve.curvature)
    elif isinstance(curve, _TurnColumns):
        yield from (*curve.start, curve.turn)
    else:
        yield from (number for pose in curve.poses for number in pose)


def _segment(curve: _Curve) -> Segment:
    if isinstance(curve, _TurnColumns):
        return TurnSegment(Pose2.from_sequence(curve.start), curve.turn)
    if isinstance(curve, _Polyline):
        return PolylineSegment(np.array(curve.poses).reshape(-1, 3), Direction(curve.direction))
    start = Pose2.from_sequence(curve.start)
    return ClothoidSegment(ClothoidSpline(start, np.array(curve.knots), np.array(curve.curvature), curve.direction))


def _check_lengths(columns: PathColumns, name: str) -> None:
    count = len(columns.x)
    if count < 2:
        raise InvalidFile(f"{name}: needs at least 2 samples, got {count}")
    for key in ("s", "y", "yaw", "curvature", "direction"):
        column = getattr(columns, key)
        if column is not None and len(column) != count:
            raise InvalidFile(f"{name}.{key}: must have as many values as {name}.x = {count}, got {len(column)}")


def _check_arc_length(columns: PathColumns, poses: FloatArray, name: str) -> None:
    if columns.s is None:
        return
    if abs(columns.s[0]) > AGREEMENT:
        raise InvalidFile(f"{name}.s: must start at 0 m, got {columns.s[0]}")
    chord = np.hypot(np.diff(poses[:, 0]), np.diff(poses[:, 1]))
    rounding = AGREEMENT
    if not columns.segments:  # samples alone may be rounded
        rounding = half_unit(np.array(columns.s)) + np.sqrt(2.0) * half_unit(poses[:, 0], poses[:, 1])
    short = np.flatnonzero(np.diff(columns.s) < chord - 2.0 * rounding)
    if short.size:
        i = int(short[0])
        step = columns.s[i + 1] - columns.s[i]
        raise InvalidFile(f"{name}.s: grows by {step:.6g} m over {chord[i]:.6g} m from sample {i} to {i + 1}")
    if columns.segments:  # otherwise the length is compared with the length of the curves
        return
    turn = np.abs(wrap_angles(np.diff(poses[:, 2])))
    # A step of a polyline is at most a half circle; a turn in place may count its radians as length.
    longest = 0.5 * np.pi * chord + turn * (chord <= _STILL) + 2.0 * rounding
    long = np.flatnonzero(np.diff(columns.s) > longest)
    if long.size:
        i = int(long[0])
        step = columns.s[i + 1] - columns.s[i]
        raise InvalidFile(f"{name}.s: grows by {step:.6g} m over {chord[i]:.6g} m from sample {i} to {i + 1}")


def _check_radians(poses: FloatArray, name: str) -> None:
    """Reject yaws beyond 2 pi that agree with the direction of motion only if they are read as degrees."""
    step = np.diff(poses[:, :2], axis=0)
    moving = np.hypot(step[:, 0], step[:, 1]) > _STILL
    if np.count_nonzero(moving) < _ENOUGH or np.max(np.abs(poses[:, 2])) <= 2.0 * np.pi:
        return
    way = np.arctan2(step[moving, 1], step[moving, 0])
    ends = poses[:-1, 2][moving], poses[1:, 2][moving]
    # Forward or reverse.
    in_radians, in_degrees = (
        float(np.median(np.abs(np.sin(way - 0.5 * factor * (ends[0] + ends[1]))))) for factor in (1.0, np.pi / 180.0)
    )
    if in_degrees < _ALIGNED < in_radians:
        worst = float(poses[np.argmax(np.abs(poses[:, 2])), 2])
        raise InvalidFile(
            f"{name}.yaw: {worst:g} is beyond 2 pi, and the robot moves along its yaws in degrees; write radians"
        )


def _check_directions(columns: PathColumns, poses: FloatArray, name: str) -> None:
    if columns.direction is None:
        return
    step, middle = np.diff(poses[:, :2], axis=0), 0.5 * (poses[1:, 2] + poses[:-1, 2])
    ahead = step[:, 0] * np.cos(middle) + step[:, 1] * np.sin(middle)
    given, moves = np.array(columns.direction), np.hypot(step[:, 0], step[:, 1]) > _STILL
    gears, moving = np.where(ahead < 0.0, -1, 1), np.flatnonzero(moves)
    if not moving.size:
        return
    # Gears of the nearest moving steps before and after every sample.
    sample = np.arange(given.size)
    before = gears[moving[np.clip(np.searchsorted(moving, sample - 1, side="right") - 1, 0, None)]]
    after = gears[moving[np.clip(np.searchsorted(moving, sample), None, moving.size - 1)]]
    still = np.append(~moves, False) | np.append(False, ~moves)
    right = (given == before) | (given == after) | ((given == 0) & still)
    if not np.all(right):
        i = int(np.argmin(right))
        does = "moves in the other gear there" if given[i] else "moves there"
        raise InvalidFile(f"{name}.direction: {given[i]} at sample {i}, but the robot {does}")


def check_sampled_curvature(columns: PathColumns, name: str) -> None:
    """Check the curvature at each sample against the ratio of heading change to chord length in the neighbouring steps.

    The accepted range covers the ratios of the two steps before and the two steps after a sample, widened by its width
    and by the rounding. Samples near a turn in place are not checked. The check applies only to drivable paths, because
    raw paths may have corners between samples.

    Args:
        columns: Samples of a path without curves.
        name: Name of the path in messages.

    Raises:
        InvalidFile: If a curvature is outside the accepted range.
    """
    if columns.curvature is None:
        return
    poses = np.column_stack((columns.x, columns.y, columns.yaw))
    given, chord = np.array(columns.curvature), np.hypot(*np.diff(poses[:, :2], axis=0).T)
    turn = wrap_angles(np.diff(poses[:, 2]))
    moves = chord > _STILL
    with np.errstate(divide="ignore", invalid="ignore"):
        quotient = np.where(moves, turn * np.sinc(0.5 * turn / np.pi) / chord, np.inf)
        rounding = np.where(moves, (2.0 * half_unit(poses[:, 2]) + AGREEMENT) / chord, np.inf)
    fenced, rough = (np.pad(values, 2, mode="edge") for values in (quotient, rounding))
    around, rough = (np.lib.stride_tricks.sliding_window_view(values, 4) for values in (fenced, rough))
    least, most = around.min(axis=1), around.max(axis=1)
    with np.errstate(invalid="ignore"):
        off = (
            np.maximum(least - given, given - most)
            - (most - least)
            - rough.max(axis=1)
            - _CURVATURE * (1 + np.abs(given))
        )
    if np.any(wrong := off > 0.0):
        i = int(np.argmax(wrong))
        raise InvalidFile(
            f"{name}.curvature: {given[i]:.6g} 1/m at sample {i}, the samples turn by {least[i]:.6g} to {most[i]:.6g}"
        )


def _check_agreement(columns: PathColumns, poses: FloatArray, path: Path, name: str) -> None:
    if columns.s is None:
        raise InvalidFile(f"{name}.s: is required with {name}.segments")
    if abs(columns.s[-1] - path.length) > AGREEMENT:
        raise InvalidFile(f"{name}: samples end at s = {columns.s[-1]:.9g} m, segments at {path.length:.9g} m")
    apart, turned = _off_curves(np.array(columns.s), poses, path)
    worst = int(np.argmax(np.maximum(apart, turned)))
    if max(apart[worst], turned[worst]) > AGREEMENT:
        raise InvalidFile(
            f"{name}: sample {worst} is {apart[worst]:.3g} m and {turned[worst]:.3g} rad off the segments, "
            f"allowed is {AGREEMENT:g}"
        )
    _check_gears(columns, path, name)
    _check_curvature(columns, path, name)


def _check_gears(columns: PathColumns, path: Path, name: str) -> None:
    """Compare the gears of samples with the curves; the first sample at a cusp belongs to the segment before it."""
    if columns.direction is None:
        return
    s, given = np.array(columns.s), np.array(columns.direction)
    before, after = path.direction_at(np.concatenate((s - AGREEMENT, s + AGREEMENT))).reshape(2, -1)
    again = np.diff(s) <= _STILL
    follows, is_followed = np.append(False, again), np.append(again, False)
    right = ((given == before) & ~(follows & ~is_followed)) | ((given == after) & ~(is_followed & ~follows))
    if not np.all(right):
        i = int(np.argmin(right))
        raise InvalidFile(f"{name}.direction: differs from that of the segments, {given[i]} at sample {i}")


def _check_curvature(columns: PathColumns, path: Path, name: str) -> None:
    """Compare the curvature of samples with the curves; at a jump, any value between both sides is accepted."""
    if columns.curvature is None:
        return
    s, given = np.array(columns.s), np.array(columns.curvature)
    places = np.concatenate([s + shift for shift in (-AGREEMENT, 0.0, AGREEMENT)])
    around = path.curvature_at(places).reshape(3, -1)
    steepest = np.abs(path.curvature_rate_at(places)).reshape(3, -1).max(axis=0)
    allowed = AGREEMENT * (1.0 + np.abs(given) + steepest)
    off = np.maximum(around.min(axis=0) - given, given - around.max(axis=0)) - allowed
    i = int(np.argmax(off))
    if not off[i] <= 0.0:
        raise InvalidFile(f"{name}.curvature: {given[i]:.9g} 1/m at sample {i}, the segments have {around[1, i]:.9g}")


def _off_curves(s: FloatArray, poses: FloatArray, path: Path, near: float = _STILL) -> tuple[FloatArray, FloatArray]:
    """Return distances [m] and turns [rad] of samples from the curves at `s`, accurate to `near` [m], Shape (n,)."""
    exact = path.poses_at(s)
    apart = np.hypot(poses[:, 0] - exact[:, 0], poses[:, 1] - exact[:, 1])
    turned = np.abs(wrap_angles(poses[:, 2] - exact[:, 2]))
    # At a turn in place of a polyline, many headings have the same arc length.
    turned[_distances_to(_turns_in_place(path), s) <= near] = 0.0
    return apart, turned


def _turns_in_place(path: Path) -> FloatArray:
    """Return the increasing arc lengths of turns in place in polylines, Shape (k,) [m]."""
    still = [
        segment.knots[1:][np.diff(segment.knots) <= _STILL] + start
        for segment, start in zip(path.segments, path.segment_starts[:-1], strict=True)
        if isinstance(segment, PolylineSegment)
    ]
    return np.concatenate(still) if still else np.zeros(0)


def _distances_to(places: FloatArray, s: FloatArray) -> FloatArray:
    """Return the distance of every `s` from the nearest of increasing `places`, or infinity, Shape (n,) [m]."""
    fenced = np.concatenate(([-np.inf], places, [np.inf]))
    after = np.clip(np.searchsorted(fenced, s), 1, fenced.size - 1)
    distances: FloatArray = np.minimum(s - fenced[after - 1], fenced[after] - s)
    return distances
