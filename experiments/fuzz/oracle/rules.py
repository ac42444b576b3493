"""Rules of a path other than clearance, each with three answers: clearly satisfied, clearly violated, undecided.

Tolerances are those documented by the library; a rule counts as violated beyond twice its tolerance, and as satisfied
within half of it.
"""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

    from experiments.fuzz.case import Case
    from experiments.fuzz.oracle.motion import Floats, Motion, Segment

__all__ = ["Finding", "findings", "gap"]

_POSE = 1e-6  # [m], [rad]: start, goal, joints
_ADDED_UP = 10.0  # ratio to the tolerance of one joint: largest sum of all jumps
_EXACT, _SAMPLED = 1e-6, 1e-3  # relative: curvature of clothoids, of polylines
_ROUNDED = 1e-9  # [1/m]
_SLIP, _BULGE, _STRAIGHT = 0.01, 0.005, 1e-4  # [rad], [m], [m] and [rad]
_DRIFT, _DRIFT_PER_METRE, _LONGEST = 1e-3, 1e-4, 0.2  # [m], [m/m], [m]: accumulated sideways motion of a polyline
_ROUNDING = 1e-6  # [m], rounding of a polyline's positions
_MOVING = 1e-6  # [m]: shorter gears have no direction


class Finding(NamedTuple):
    """Result of one rule: its kind of violation, the value relative to the limit, and its place [m]."""

    kind: str
    ratio: float
    s: float

    @property
    def is_broken(self) -> bool:
        """Whether it is beyond twice the tolerance."""
        return not self.ratio <= 2.0

    @property
    def is_kept(self) -> bool:
        """Whether it is within half of the tolerance."""
        return self.ratio <= 0.5


def gap(first: Floats, second: Floats) -> float:
    """Return the larger of distance [m] and turn [rad] between two poses."""
    turn = math.remainder(float(first[2] - second[2]), 2.0 * math.pi)
    return max(math.hypot(*(first[:2] - second[:2])), abs(turn))


def findings(case: Case, motion: Motion) -> list[Finding]:
    """Yield every rule except clearance. The ratio of a limit is 1 at the limit plus its tolerance."""
    rules = (_ends, _joints, _gears, _turns, _slip, _sums, _winding, _curvature, _start_curvature, _straight)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        return [finding for rule in rules for finding in rule(case, motion)]


def _ends(case: Case, motion: Motion) -> Iterator[Finding]:
    yield Finding("start", gap(motion.start, np.array(case["start"])) / _POSE, 0.0)
    yield Finding("goal", gap(motion.end, np.array(case["dock"]["pose"])) / _POSE, motion.length)


def _joints(_: Case, motion: Motion) -> Iterator[Finding]:
    jumps = []
    for before, after in itertools.pairwise(motion.segments):
        jumps.append(gap(motion.ends_of(before)[1], motion.ends_of(after)[0]))
        yield Finding("joint", jumps[-1] / _POSE, after.start_s)
    yield Finding("joint", sum(jumps) / (_ADDED_UP * _POSE), 0.0)


def _gears(case: Case, motion: Motion) -> Iterator[Finding]:
    gears = [one for one in motion.segments if not one.in_place]
    moving = [one for one in gears if one.length > _MOVING] or gears
    if not moving:
        return  # a path of turns alone has no driving direction
    wanted = {"forward": 1, "backward": -1}.get(case["dock"]["direction"], moving[-1].gear)
    yield Finding("direction", 0.0 if wanted == moving[-1].gear else math.inf, motion.length)
    yield Finding("direction", math.inf if case["start_speed"] * moving[0].gear < 0.0 else 0.0, 0.0)


def _turns(case: Case, motion: Motion) -> Iterator[Finding]:
    """Check turns in place: only for robots that support them, and without translation."""
    for segment in motion.segments:
        if segment.in_place and not case.get("turns_in_place", False):
            yield Finding("turn", math.inf, segment.start_s)
    stands = case["start_speed"] == 0.0 and case.get("start_acceleration", 0.0) == 0.0
    if motion.segments[0].in_place and not stands:
        yield Finding("turn", math.inf, 0.0)


class _Steps(NamedTuple):
    """Moving steps of a polyline, Shape (n,): chord, arc [m]; turn, slip against the heading, direction [rad]."""

    chord: Floats
    arc: Floats
    turn: Floats
    slip: Floats
    direction: Floats


def _steps(segment: Segment) -> _Steps:
    step, arc = np.diff(segment.poses, axis=0), np.diff(segment.knots)
    moves = arc > 0.0
    step, heading = step[moves], (segment.poses[:-1, 2] + 0.5 * np.diff(segment.poses[:, 2]))[moves]
    direction = np.arctan2(step[:, 1], step[:, 0])
    slip = _wrapped(direction - heading - (0.0 if segment.gear > 0 else math.pi))
    return _Steps(np.hypot(step[:, 0], step[:, 1]), arc[moves], step[:, 2], slip, direction)


def _wrapped(angle: Floats) -> Floats:
    wrapped: Floats = np.remainder(angle + math.pi, 2.0 * math.pi) - math.pi
    return wrapped


def _slip(_: Case, motion: Motion) -> Iterator[Finding]:
    """Check that every step is along its heading, and short enough to determine its arc."""
    for segment in motion.segments:
        if not segment.sampled:
            continue
        steps = _steps(segment)
        yield Finding("slip", float(np.max(np.abs(steps.slip), initial=0.0)) / _SLIP, segment.start_s)
        bulge = steps.arc * np.abs(steps.turn) / 8.0
        yield Finding("slip", float(np.max(bulge, initial=0.0)) / _BULGE, segment.start_s)


def _sums(_: Case, motion: Motion) -> Iterator[Finding]:
    """Check that tolerated errors of single steps do not accumulate: slip, and steps too short to have a direction."""
    polylines = [segment for segment in motion.segments if segment.sampled]
    if not polylines:
        return
    sideways, sampling, longest, still, driven = [np.zeros(1)], 0.0, 0.0, 0.0, 0.0
    for segment in polylines:
        steps = _steps(segment)
        sideways.append(segment.gear * steps.chord * np.sin(steps.slip))
        bends = np.abs(np.diff(steps.turn / steps.arc, prepend=steps.turn[:1] / steps.arc[:1]))
        sampling += float(np.sum(steps.arc**2 * np.maximum(bends, np.append(bends[1:], 0.0)))) / 12.0
        longest, driven = max(longest, float(np.max(steps.arc, initial=0.0))), driven + float(np.sum(steps.arc))
        chords = np.hypot(*np.diff(segment.poses[:, :2], axis=0).T)
        still += float(np.sum(chords[np.diff(segment.knots) <= 0.0]))
    drift = float(np.ptp(np.cumsum(np.concatenate(sideways))))
    allowed = _DRIFT + _DRIFT_PER_METRE * driven + _SLIP * min(longest, _LONGEST)
    # Sampling a smooth curve causes drift by itself, which is undecided here.
    least, most = (drift - sampling) / allowed, (drift + sampling) / allowed
    yield Finding("slip", least if least > 2.0 else min(most, 2.0), 0.0)
    yield Finding("slip", still / _POSE, 0.0)


def _winding(case: Case, motion: Motion) -> Iterator[Finding]:
    """Check that the direction of a polyline turns no faster than the heading may, except for rounding."""
    limit = case["limits"].get("max_curvature", math.inf)
    for segment in motion.segments if math.isfinite(limit) else ():
        if not segment.sampled or segment.knots.size < 3:
            continue
        steps = _steps(segment)
        turn = np.abs(_wrapped(np.diff(steps.direction)))
        may = limit * 0.5 * (steps.arc[:-1] + steps.arc[1:])
        rounding = 2.0 * _ROUNDING * (1.0 / steps.chord[:-1] + 1.0 / steps.chord[1:])
        excess = np.maximum(turn - may, 0.0) / (_SAMPLED * may + rounding)
        yield Finding("curvature", float(np.max(excess, initial=0.0)), segment.start_s)


def _curvature(case: Case, motion: Motion) -> Iterator[Finding]:
    limits = case["limits"]
    for segment in (one for one in motion.segments if not one.in_place):
        slack = _EXACT if segment.exact else _SAMPLED
        yield _limit("curvature", segment.curvature, limits.get("max_curvature", math.inf), slack, segment)
        rate = _rates(segment)
        if rate.size:
            yield _limit("curvature_rate", rate, limits.get("max_curvature_rate", math.inf), slack, segment)


def _rates(segment: Segment) -> Floats:
    width = np.diff(segment.knots)
    if segment.exact:
        rate: Floats = np.diff(segment.curvature) / width
        return rate
    between, change = 0.5 * (width[1:] + width[:-1]), np.diff(segment.curvature)
    sampled: Floats = np.where(change == 0.0, 0.0, change / between)
    return np.where(np.isnan(sampled), np.inf, sampled)


def _limit(kind: str, values: Floats, limit: float, slack: float, segment: Segment) -> Finding:
    """Return a bound with a relative tolerance: ratio 1 at the end of the tolerance, 0 at or below the bound."""
    if math.isinf(limit):
        return Finding(kind, 0.0, segment.start_s)
    most = float(np.max(np.abs(values)))
    if most <= _ROUNDED and not segment.exact:
        # A difference of yaws has a rounding error of about 1e-16: such a small curvature of short steps is undecided.
        return Finding(kind, 1.0 if most > limit * (1.0 - slack) else 0.0, segment.start_s)
    excess = (most / limit - 1.0) / slack
    return Finding(kind, max(excess, 0.0) if excess > -0.5 else 0.0, segment.start_s)


def _start_curvature(case: Case, motion: Motion) -> Iterator[Finding]:
    wanted = case.get("start_curvature")
    first = motion.segments[0]
    if wanted is not None and first.exact:
        yield Finding("start_curvature", abs(float(first.curvature[0]) - wanted) / 1e-6, 0.0)
    elif wanted is not None and first.sampled:
        yield Finding("start_curvature", 1.0, 0.0)  # the mean of a step does not determine its start


def _straight(case: Case, motion: Motion) -> Iterator[Finding]:
    wanted, last = float(case["dock"]["final_straight"]), motion.segments[-1]
    if wanted <= 0.0:
        return
    driven = 0.0 if last.in_place else last.length
    if driven < wanted - 0.5e-6:
        yield Finding("final_straight", (wanted - driven) / _POSE, motion.length)
        return
    begin, h = (
        last.length - wanted,
        motion.h[last.first : last.stop],
    )  # from the begin of the gear, as exact as its knots
    places = np.concatenate(([0.0], np.cumsum(h)[:-1]))
    piece = np.repeat(np.arange(last.first, last.stop), 5)
    share = np.tile(np.linspace(0.0, 1.0, 5), last.stop - last.first)
    share = np.maximum(share, (begin - places[piece - last.first]) / np.maximum(motion.h[piece], 1e-300))
    inside = share <= 1.0 - 1e-9
    goal = case["dock"]["pose"]
    poses = motion.poses_at(piece[inside], share[inside])
    dx, dy = poses[:, 0] - goal[0], poses[:, 1] - goal[1]
    cross = np.abs(dy * math.cos(goal[2]) - dx * math.sin(goal[2]))
    turn = np.abs(np.remainder(poses[:, 2] - goal[2] + math.pi, 2.0 * math.pi) - math.pi)
    # A curvature of 1e-6 over the straight and the goal's tolerance move a clothoid by at most this.
    allowed = _POSE * (1.0 + wanted) ** 2 if last.exact else _STRAIGHT
    worst = float(np.max(np.maximum(cross, turn), initial=0.0)) / allowed
    # The knots are more accurate than the poses: a refusal may be based on them.
    entered = np.append(np.interp(last.length - wanted, last.knots, last.curvature) if last.exact else 0.0,
                        last.curvature[last.knots > last.length - wanted] if last.exact else [])  # fmt: skip
    curved = bool(np.any(np.abs(entered) > 0.5e-6))
    yield Finding("final_straight", max(worst, 1.0) if curved else worst, last.start_s + begin)
