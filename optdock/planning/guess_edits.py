"""Edits of guesses.

They keep a straight line out of a contact, insert a stop at every bend, and leave out short gears.
"""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING

import numpy as np

from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.pose import Pose2
from optdock.model.path import Path
from optdock.model.segments import ClothoidSegment, PolylineSegment, TurnSegment
from optdock.verification import compiled_clearances, end_clearances

if TYPE_CHECKING:
    from collections.abc import Iterator

    from optdock.geometry.arrays import FloatArray
    from optdock.model.problem import DockingProblem
    from optdock.model.segments import Segment

__all__ = ["FEWER_CUSPS", "begun_straight", "fewer_cusps", "stopping_at_bends", "straight_along_contact"]

FEWER_CUSPS = "fewer cusps"  # stage of the guesses of `fewer_cusps`
# Clearance below which the robot touches an obstacle [m]; spacing of the samples along a path [m]; heading tolerance of
# a straight line [rad].
_CONTACT, _CONTACT_SPACING, _STRAIGHT = 1e-3, 0.02, 1e-6
# Rounding of the curvature of a sampled arc [1/m]; with more bends than this within its gears a path is a curve, or
# would stop too often.
_SAME_BEND, _MOST_BENDS = 1e-5, 12
_SHARPEST = 1e6  # [1/m]: sharper bends are no arcs, and the quotient of turn and length may be infinite
# Most distance between the poses of gears that are joined [m], and their least number: the smoother fits curvatures to
# the directions of the chords.
_JOINED_SPACING, _FEWEST_JOINED = 0.02, 10
_LONGEST_LEFT_OUT = 0.5  # of the robot's length: longer gears cannot be replaced
_DETOUR = 2.0  # least ratio of the lengths of both neighbours of a detour and of the detour
# Largest gap in the heading, as a share of the largest turn of the other short gears, and gap that is always tried
# [rad]. In 36 parking slots the smoother closed gaps up to a share of 0.55, and of 22 larger ones, up to 3.4, not one.
_MADE_UP, _SMALL_GAP = 0.58, 0.05


def straight_along_contact(path: Path, problem: DockingProblem) -> float:
    """Return the length [m] of the straight line on which a robot that starts in contact leaves the obstacle.

    A robot alongside a wall in contact can only drive straight. Smoothers do not reproduce this line exactly, so the
    line of the guess is kept. The length is 0 if the robot touches no obstacle, is in motion or has its wheels turned,
    or if the path begins at another pose or does not lead straight out of the contact.
    """
    first, start = path.segments[0], problem.start.as_array()
    stands = problem.starts_at_rest and not problem.start_curvature
    if not stands or isinstance(first, TurnSegment) or end_clearances(problem).start > _CONTACT:
        return 0.0
    stations = np.arange(0.0, first.length, _CONTACT_SPACING)
    poses = path.poses_at(stations)
    along = np.array([math.cos(start[2]), math.sin(start[2])]) * stations[:, None] * int(first.direction)
    is_straight = np.abs(poses - start - np.column_stack((along, np.zeros(len(poses))))).max(axis=1) < _STRAIGHT
    if not is_straight[:1].any():  # nor if the segment has no length
        return 0.0
    poses = poses[: len(poses) if is_straight.all() else int(is_straight.argmin())]
    clearances, _ = compiled_clearances(poses, problem.robot.footprint, problem.all_obstacles, 2.0 * _CONTACT)
    is_clear = clearances > _CONTACT
    return float(stations[is_clear.argmax()]) if is_clear.any() else 0.0


def begun_straight(start: Pose2, gear: int, length: float, path: Path) -> Path:
    """Return a path preceded by a straight line of a given length [m], from `start` to the beginning of the path.

    If the path begins with a clothoid spline in the same gear, 1 or -1, the line becomes part of the spline.
    """
    first, segments = path.segments[0], path.segments
    knots, curvature = np.array([0.0, length]), np.zeros(2)
    if isinstance(first, ClothoidSegment) and first.spline.sign == gear:
        knots = np.concatenate((knots, length + first.spline.knots[1:]))
        curvature = np.concatenate((curvature[:1], first.spline.curvature))
        segments = segments[1:]
    return Path((ClothoidSegment(ClothoidSpline(start, knots, curvature, gear)), *segments), path.frame)


def stopping_at_bends(path: Path) -> Path | None:
    """Return a path as clothoid segments of constant curvature, with a stop at every jump of the curvature.

    A robot at rest may turn its wheels, so sampled arcs, lines and turns in place can be driven without smoothing. This
    can be the only path if the room is too short for a transition between two curvatures. The result is None if the
    path is not a sequence of arcs, lines and turns in place, turns almost in place, or has too many bends.
    """
    found: list[Segment] = []
    room = _MOST_BENDS
    for segment in path.segments:
        if not isinstance(segment, PolylineSegment):
            found.append(segment)
            continue
        curvature = segment.step_curvature
        bends = np.flatnonzero(~(np.abs(np.diff(curvature)) <= _SAME_BEND)) + 1
        room -= bends.size
        if room < 0:
            return None
        for begin, end in itertools.pairwise((0, *bends.tolist(), curvature.size)):
            length = float(segment.knots[end] - segment.knots[begin])
            turn = float(segment.poses[end, 2] - segment.poses[begin, 2])
            if not (length > 0.0 and abs(turn) <= _SHARPEST * length):
                return None
            bend = turn / length
            pose, gear = Pose2.from_sequence(segment.poses[begin]), int(segment.direction)
            spline = ClothoidSpline(pose, np.array([0.0, length]), np.array([bend, bend]), gear)
            found.append(ClothoidSegment(spline))
    return Path(tuple(found), path.frame)


def fewer_cusps(path: Path, problem: DockingProblem, *, only_detours: bool = False) -> Iterator[Path]:
    """Yield guesses with one fewer stop: first with two segments of one gear joined, then with one gear left out.

    Searches over arcs often return short gears that can be left out. Every stop takes time, while the smoother can
    remove a jump of the curvature. A gear between two gears in the other direction is left out together with the
    stretch that would then be driven twice, and the smoother closes the gap. The gear with the smallest change of
    heading over its gap is left out first, because the other gears must make up for this change. The first gear can be
    left out if the second gear may begin at the start. Turns in place are never left out.

    `only_detours`: whether to leave out only gears that are much shorter than both of their neighbours, and not gears
    that turn the robot in a narrow area.
    """
    segments = path.segments
    for k, (one, following) in enumerate(itertools.pairwise(() if only_detours else segments)):
        if one.direction == following.direction and not isinstance(one, TurnSegment):
            poses = np.concatenate((_poses(one, 0.0, one.length)[:-1], _poses(following, 0.0, following.length)))
            yield _joined(path, segments[:k], poses, following, segments[k + 2 :])
    gaps = [(_gap_without(path, k, problem, only_detours=only_detours), k) for k in range(len(segments) - 1)]
    for gap, k in sorted(gaps):
        if math.isfinite(gap):
            left_out, following = segments[k].length, segments[k + 1]
            before = problem.start.as_array()[None]
            if k > 0:
                before = _poses(segments[k - 1], 0.0, segments[k - 1].length - left_out)
            poses = np.concatenate((before, _poses(following, left_out, following.length)))
            yield _joined(path, segments[: max(k - 1, 0)], poses, following, segments[k + 2 :])


def _gap_without(path: Path, k: int, problem: DockingProblem, *, only_detours: bool) -> float:
    """Return the change of heading [rad] over the gap without gear `k`, inf if the gear cannot be left out."""
    one, following, left_out = path.segments[k], path.segments[k + 1], path.segments[k].length
    longest = _LONGEST_LEFT_OUT * problem.robot.footprint.length
    if isinstance(one, TurnSegment) or left_out > longest or following.direction != -one.direction:
        return math.inf
    begin, shorter = problem.start.yaw, following.length
    if k > 0:
        previous = path.segments[k - 1]
        shorter = min(shorter, previous.length) if previous.direction == following.direction else 0.0
        begin = float(previous.poses_at(np.array([previous.length - left_out]))[0, 2]) if shorter > left_out else 0.0
    elif problem.start_speed * following.direction < 0.0:
        return math.inf
    is_detour = k > 0 and shorter > max(_DETOUR * left_out, 0.5 * longest)
    if shorter <= left_out or (only_detours and not is_detour):
        return math.inf
    end = float(following.poses_at(np.array([left_out]))[0, 2])
    gap = abs(math.remainder(end - begin, 2.0 * math.pi))
    lengths = [other.length for other in path.segments]
    joined = sum(lengths[max(k - 1, 0) : k + 2]) - (3.0 if k > 0 else 2.0) * left_out
    others = (*lengths[: max(k - 1, 0)], joined, *lengths[k + 2 :])
    most = problem.robot.limits.max_curvature * sum(length for length in others if length <= longest)
    is_too_far = gap > max(_MADE_UP * most, _SMALL_GAP)
    return math.inf if is_too_far and not is_detour else gap


def _poses(segment: Segment, begin: float, end: float) -> FloatArray:
    """Return poses of a segment between two arc lengths [m], empty for an empty interval. Shape (n, 3)."""
    if end <= begin:
        return np.zeros((0, 3))
    return segment.poses_at(np.linspace(begin, end, _FEWEST_JOINED + int((end - begin) / _JOINED_SPACING)))


def _joined(
    path: Path, before: tuple[Segment, ...], poses: FloatArray, gear: Segment, after: tuple[Segment, ...]
) -> Path:
    """Return the path of `before`, a polyline through `poses` in the direction of `gear`, and `after`."""
    poses = np.column_stack((poses[:, :2], np.unwrap(poses[:, 2])))
    return Path((*before, PolylineSegment(poses, gear.direction), *after), path.frame)
