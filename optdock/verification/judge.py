"""Second judge of plan files: `python judge.py plan.json` accepts or refuses path, clearance and motion limits.

This file uses the standard library only and imports no other module of this project; it may be copied anywhere. It
calculates with intervals that are rounded outwards, so a verdict holds for real numbers. Numbers in parentheses refer
to docs/theory/certificate.md. A plan file states the robot, the start, the dock, the rules, and all obstacles that meet
a box (`proof.region`). `proof.cells` divides the path, and names a separating direction for every obstacle nearby.
Trusted are this statement of the problem, the interpreter, IEEE 754, and `math.sin`, `cos`, `atan` within 2^-50.
Exit status: 0 accepted; 3 refused, with the broken rule and its place on stderr; 2 not a plan file with a proof.
"""

from __future__ import annotations

import json
import math
import sys
from collections import Counter
from functools import cache
from itertools import accumulate, pairwise, zip_longest
from typing import Any, NamedTuple

__all__ = ["Refusal", "Span", "judge", "main"]

TOLERANCE = 1e-6  # [m], [rad], and relative to limits, as in the certificate
_ACCURACY, _SHORTEST = 2.0**-50, 1e-9  # of mathematical functions; of cells of the motion [s]
_LINEAR = ("max_speed", "max_reverse_speed", "max_acceleration", "max_deceleration", "max_jerk")
_TURNING = ("max_yaw_rate", "max_yaw_acceleration", "max_lateral_acceleration", "max_lateral_jerk", "max_wheel_speed")
_PATH = ("max_curvature", "max_curvature_rate", "max_steering_angle", "max_steering_rate")
_DIMENSIONS = ("track_width", "wheelbase")


class Refusal(Exception):
    """A rule that is broken or not proven."""


def _hold(holds: bool, message: str) -> None:  # noqa: FBT001 - a condition
    if not holds:
        raise Refusal(message)


class Span:
    """The interval [lo, hi]. Operations round outwards: they contain the results for all numbers of their operands."""

    __slots__ = ("hi", "lo")

    def __init__(self, lo: float, hi: float | None = None) -> None:
        self.lo, self.hi = lo, lo if hi is None else hi
        if not (type(lo) is type(self.hi) is float and -math.inf < lo <= self.hi < math.inf):  # also false for NaN
            raise Refusal("arithmetic: a number overflows or is no number")

    def __add__(self, other: Span | float) -> Span:
        o = other if isinstance(other, Span) else Span(other)
        return Span(math.nextafter(self.lo + o.lo, -math.inf), math.nextafter(self.hi + o.hi, math.inf))

    def __neg__(self) -> Span:
        return Span(-self.hi, -self.lo)

    def __sub__(self, other: Span | float) -> Span:
        return self + -other

    def __mul__(self, other: Span | float) -> Span:
        o = other if isinstance(other, Span) else Span(other)
        products = self.lo * o.lo, self.lo * o.hi, self.hi * o.lo, self.hi * o.hi
        return Span(math.nextafter(min(products), -math.inf), math.nextafter(max(products), math.inf))

    def __truediv__(self, other: Span | float) -> Span:
        o = other if isinstance(other, Span) else Span(other)
        _hold(o.lo > 0.0, "arithmetic: the divisor must be positive")
        return self * Span(math.nextafter(1.0 / o.hi, 0.0), math.nextafter(1.0 / o.lo, math.inf))

    __radd__, __rmul__ = __add__, __mul__

    @property
    def size(self) -> float:
        """Largest absolute value."""
        return max(-self.lo, self.hi)


_ZERO, _TURN = Span(0.0), Span(math.pi, math.nextafter(math.pi, 4.0)) * 2.0  # the float pi is below pi


def _around(values: list[Span]) -> Span:
    return Span(min(value.lo for value in values), max(value.hi for value in values))


def _length(x: Span, y: Span) -> float:
    """Return an upper bound of the length of a vector."""
    return math.nextafter(math.sqrt((x * x + y * y).hi), math.inf)


def _cos_sin(angle: Span) -> list[Span]:
    """Return cosine and sine: between two angles they change by no more than the angle."""
    middle = min(max(0.5 * angle.lo + 0.5 * angle.hi, angle.lo), angle.hi)
    spread = Span(-1.0, 1.0) * (max((Span(angle.hi) - middle).hi, (Span(middle) - angle.lo).hi) + 2.0 * _ACCURACY)
    return [spread + math.cos(middle), spread + math.sin(middle)]


def _read(text: str) -> dict[str, Any]:
    """Return the object of a strict JSON text, in which every number is a finite float."""

    def number(digits: str) -> float:
        if not math.isfinite(float(digits)):
            raise ValueError(f"{digits[:20]} is not a finite number")
        return float(digits)

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        if len(dict(pairs)) != len(pairs):
            raise ValueError(f"a key is repeated among {[key for key, _ in pairs][:20]}")
        return dict(pairs)

    return dict(json.loads(text, parse_int=number, parse_float=number, parse_constant=number, object_pairs_hook=unique))


class _Rule:
    """Required clearance (C2), (C22), with the tracking tube (C17), and the convex pieces of the footprint."""

    def __init__(self, proof: dict[str, Any]) -> None:
        robot, rule, ends = proof["robot"], proof["clearance"], (proof["start"]["pose"], proof["dock"]["pose"])
        outline, self.start, self.goal = robot["footprint"], *(_Pose(*map(Span, end)) for end in ends)
        self.pieces, self.relief, self.at_start = (
            robot.get("pieces") or [outline],
            rule["start_relief"],
            rule["at_start"],
        )
        edges: Counter[Any] = Counter()  # if all edges inside cancel, the winding numbers agree: the hulls cover
        for sign, ring in ((1, outline), *((-1, piece) for piece in self.pieces)):
            for a, b in pairwise([(x, y) for x, y in [*ring, ring[0]]]):
                edges[min(a, b), max(a, b)] += sign * ((a < b) - (a > b))
        _hold(not any(edges.values()), "footprint: its convex pieces do not cover it")
        radius, xs = max(_length(Span(x), Span(y)) for x, y in outline), [x for x, _ in outline]
        (cross, yaw), self.at_dock, self.taper, self.run = (
            robot["tracking"],
            rule["at_dock"],
            rule["taper"],
            rule["dock_run"],
        )
        numbers = [rule["required"], self.at_dock, self.taper, self.run, self.relief, cross, yaw, self.at_start or 0.0]
        _hold(min(numbers) >= 0.0 and max(numbers[1], numbers[-1]) <= numbers[0], "clearance: negative or inverted")
        self.most = (
            (_cos_sin(Span(min(0.5 * yaw, 1.6)))[1] * (2.0 * radius) + cross + numbers[0]).hi
            if cross or yaw
            else numbers[0]
        )
        (c, s), (x, y) = _cos_sin(self.start.yaw), ends[0][:2]
        bodies = [[[(c * px - s * py + x).lo, (s * px + c * py + y).lo] for px, py in piece] for piece in self.pieces]
        gaps = (_gap(*pair) for rock in proof["obstacles"] for body in bodies for pair in ((body, rock), (rock, body)))
        # The clearance of the start is at most the length of some line to an obstacle, and its rounding.
        self.kept = min(gaps, default=1e9) + 1e-14 * (radius + abs(x) + abs(y))
        short = self.relief <= 2.0 * (max(xs) - min(xs)) * (1.0 + TOLERANCE) and self.kept < self.most
        _hold(self.relief == 0.0 or short, "clearance: start_relief is not allowed (C22)")

    def _tapered(self, distance: float, least: float) -> float:
        beyond = (Span(distance) - self.run).hi
        if beyond <= 0.0 or beyond >= self.taper:
            return least if beyond <= 0.0 else self.most
        return (Span(beyond) / self.taper * (Span(self.most) - least) + least).hi

    def needed(self, cell: _Cell) -> float:
        """Return an upper bound of the requirement in a cell, from its largest distances from goal and start (C7)."""
        sag = (Span(cell.bend) * cell.half * cell.half * 0.5).hi
        ends = [
            [_length(at.x - end.x, at.y - end.y) for at in (cell.first, cell.last)] for end in (self.goal, self.start)
        ]
        goal, start = ((Span(max(pair)) + sag).hi for pair in ends)
        kept = max(self.kept - 0.005, 0.5 * self.kept) if self.relief else self.kept
        leaving = (Span(max(0.0, (Span(start) - self.relief).hi)) * 0.5 + kept).hi
        if self.relief and self.at_start is not None:
            leaving = min(leaving, self._tapered(start, self.at_start))
        return min(self._tapered(goal, self.at_dock), leaving)


def _gap(corners: list[list[float]], ring: list[list[float]]) -> float:
    """Return the smallest distance of corners from the edges of a ring, up to rounding."""
    best = math.inf
    for (ax, ay), (bx, by) in pairwise([*ring, ring[0]]):
        dx, dy = bx - ax, by - ay
        square = dx * dx + dy * dy
        for px, py in corners:
            t = min(1.0, max(0.0, ((px - ax) * dx + (py - ay) * dy) / square)) if square > 0.0 else 0.0
            best = min(best, math.hypot(px - ax - t * dx, py - ay - t * dy))
    return best


class _Pose(NamedTuple):
    x: Span
    y: Span
    yaw: Span

    def gap_to(self, other: _Pose) -> float:
        """Return an upper bound of the larger of distance [m] and angle [rad] between two poses."""
        turn = self.yaw - other.yaw
        turn = turn - _TURN * float(round((turn.lo + turn.hi) / (4.0 * math.pi)))
        return max(_length(self.x - other.x, self.y - other.y), turn.size)


class _Cell(NamedTuple):
    """Poses of a cell, the velocity (x, y, yaw) in its middle, the bounds of (C4), half its width."""

    first: _Pose
    middle: _Pose
    last: _Pose
    velocity: list[Span]
    bend: float
    twist: float
    half: float


class _Segment:
    """Clothoids or poses driven in one gear, or a turn in place, whose coordinate is its angle and whose gear is 0."""

    def __init__(self, curve: dict[str, Any], where: str) -> None:
        self.where, self.poses, turn = where, curve.get("poses"), curve.get("turn")
        self.gear, start = (0.0, curve["start"]) if turn is not None else (curve["direction"], curve.get("start"))
        _hold(turn is not None or self.gear in (1.0, -1.0), f"{where}: the direction must be 1 or -1")
        if self.poses is not None:
            start, self.knots, self.bends = (
                self.poses[0],
                [float(i) for i in range(len(self.poses))],
                [0.0] * len(self.poses),
            )
            _hold(all(abs(b[2] - a[2]) <= math.pi for a, b in pairwise(self.poses)), f"{where}: turns by more than pi")
        elif turn is not None:
            self.knots, self.bends = [0.0, abs(turn)], [math.copysign(1.0, turn)] * 2
        else:
            self.knots, self.bends = curve["knots"], curve["curvature"]
        rising = self.knots[0] == 0.0 and len(self.knots) > 1 and all(a < b for a, b in pairwise(self.knots))
        _hold(rising, f"{where}: the knots must increase from 0")
        spans = zip(pairwise(self.knots), pairwise(self.bends), strict=True)
        self.rates = [(Span(m) - k) / (Span(b) - a) for (a, b), (k, m) in spans]
        self.start, self.length = _Pose(*map(Span, start)), Span(self.knots[-1])

    def bend_at(self, index: int, place: Span) -> Span:
        """Return the curvature at a place on the piece after knot `index`."""
        return self.rates[index] * (place - self.knots[index]) + self.bends[index]

    def cells(self, borders: list[float]) -> list[_Cell]:
        """Return the cells between the borders, which must go from end to end through all knots."""
        whole = borders[0] == self.knots[0] and borders[-1] == self.knots[-1] and set(self.knots) <= set(borders)
        _hold(whole and all(a < b for a, b in pairwise(borders)), f"cells: they do not cover {self.where} in order")
        found, pose, index = [], self.start, 0
        for u, v in pairwise(borders):
            index += u >= self.knots[index + 1]
            found.append(self._cell(index, pose, u, v))
            pose = found[-1].last
        return found

    def _cell(self, index: int, pose: _Pose, u: float, v: float) -> _Cell:
        middle, rate = 0.5 * (u + v), self.rates[index]
        half = max((Span(middle) - u).hi, (Span(v) - middle).hi)
        if self.poses is not None:
            a, b = (_Pose(*map(Span, one)) for one in self.poses[index : index + 2])
            step = [q - p for p, q in zip(a, b, strict=True)]
            shares = [Span(place) - self.knots[index] for place in (u, middle, v)]
            ends = (_Pose(*(p + d * share for p, d in zip(a, step, strict=True))) for share in shares)
            return _Cell(*ends, step, 0.0, (step[2] * step[2]).hi, half)
        bends = [self.bend_at(index, Span(place)) for place in (u, middle, v)]
        at, end = (_advanced(pose, bends[0], rate, Span(to) - u, self.gear) for to in (middle, v))
        (c, s), most = _cos_sin(at.yaw), Span(max(bend.size for bend in bends))
        velocity, twist = [c * self.gear, s * self.gear, bends[1]], (most * most + rate.size).hi
        return _Cell(pose, at, end, velocity, abs(self.gear) * most.hi, twist, half)


def _advanced(pose: _Pose, bend: Span, rate: Span, step: Span, gear: float) -> _Pose:
    """Return the pose after a step, from the Taylor series of cos and sin of the yaw, with a bound of the remainder."""
    yaw = (rate * step * 0.5 + bend) * step + pose.yaw
    if gear == 0.0:
        return pose._replace(yaw=yaw)
    (c, s), (c0, s0), (x, y), power, n = _cos_sin(pose.yaw), (_ZERO, _ZERO), (_ZERO, _ZERO), step, 1.0
    most, bound, bound0 = step * rate.size + bend.size, Span(1.0), _ZERO
    while (bound * power).hi > 1e-16:  # this product bounds the rest of both series
        _hold(n < 60.0, "cells: a cell turns too far")
        x, y, power = x + c * power / n, y + s * power / n, power * step
        (c, c0), (s, s0) = (-(bend * s + rate * s0) / n, c), ((bend * c + rate * c0) / n, s)
        bound, bound0, n = (most * bound + bound0 * rate.size) / n, bound, n + 1.0
    rest = (bound * power).hi
    return _Pose(pose.x + (x + Span(-rest, rest)) * gear, pose.y + (y + Span(-rest, rest)) * gear, yaw)


def _clear(
    cell: _Cell, rule: _Rule, proof: dict[str, Any], boxes: list[tuple[float, ...]], planes: list[Any], where: str
) -> None:
    """Check (C8) in a cell: from its middle, every corner of the footprint moves as in (C5)."""
    (c, s), (vx, vy, turn), named = _cos_sin(cell.middle.yaw), cell.velocity, {(o, p): a for o, p, a in planes}
    need, half = (Span(rule.needed(cell)) - TOLERANCE).hi, Span(-cell.half, cell.half)
    need = need if len(rule.pieces) == 1 else max(need, 1e-12)  # no tolerance for overlaps between pieces
    for number, piece in enumerate(rule.pieces):
        corners = []
        for px, py in piece:
            x, y = c * px - s * py, s * px + c * py
            stray = ((Span(cell.twist) * _length(Span(px), Span(py)) + cell.bend) * cell.half * cell.half * 0.5).hi
            corners.append((cell.middle.x + x, cell.middle.y + y, vx - turn * y, vy + turn * x, Span(-stray, stray)))
        reach = Span(-max(need, 0.0), max(need, 0.0))
        wide, high = (_around([one[k] + one[k + 2] * half + one[4] + reach for one in corners]) for k in (0, 1))
        x0, y0, x1, y1 = proof["region"]
        _hold(
            x0 <= wide.lo and y0 <= high.lo and wide.hi <= x1 and high.hi <= y1, f"clearance: leaves the region {where}"
        )
        for i, (left, low, right, top) in enumerate(boxes):
            if left > wide.hi or right < wide.lo or low > high.hi or top < high.lo:
                continue
            _hold((i, number) in named, f"clearance: no plane between obstacle {i} and piece {number} {where}")
            nx, ny = Span(math.cos(named[i, number])), Span(math.sin(named[i, number]))  # any direction is valid
            square = nx * nx + ny * ny
            norm = Span(math.nextafter(math.sqrt(square.lo), 0.0), math.nextafter(math.sqrt(square.hi), 2.0))
            near = min((nx * x + ny * y + (nx * u + ny * v) * half + norm * e).lo for x, y, u, v, e in corners)
            far = max((nx * ox + ny * oy).hi for ox, oy in proof["obstacles"][i])
            _hold((Span(near) - far - norm * need).lo >= 0.0, f"clearance: obstacle {i} is too close {where}")


def _check_path(segments: list[_Segment], ends: list[_Pose], rule: _Rule, proof: dict[str, Any]) -> None:
    """Check the path rules: ends, joints, gears, turns, curvature, final straight."""
    start, dock, limits = proof["start"], proof["dock"], _limits(proof)
    driven = [one for one in segments if one.gear != 0.0]
    _hold(all(one.length.lo > 1e-5 for one in segments), "joint: a segment is too short to be judged")
    gaps = [Span(a.gap_to(b.start)) for a, b in zip(ends[:-1], segments[1:], strict=True)]
    _hold(sum(gaps, _ZERO).hi <= TOLERANCE, "joint: the path jumps between its segments")
    _hold(segments[0].start.gap_to(rule.start) <= TOLERANCE, "start: the path does not begin at the start")
    _hold(ends[-1].gap_to(rule.goal) <= TOLERANCE, "goal: the path does not end at the dock")
    _hold(proof["robot"]["turns_in_place"] is True or len(driven) == len(segments), "turn: the robot cannot turn")
    at_rest = start["speed"] == start["acceleration"] == 0.0
    _hold(at_rest or segments[0].gear != 0.0, "turn: the path begins with a turn, but the robot is not at rest")
    gears = {"auto": (1.0, -1.0), "forward": (1.0,), "backward": (-1.0,)}[dock["direction"]]
    _hold(not driven or driven[-1].gear in gears, "direction: the gear at the dock is not allowed")
    _hold(not driven or driven[0].gear * start["speed"] >= 0.0, "direction: the robot moves in the other gear")
    for one in (one for one in driven if one.poses is None):
        most, rate = max(map(abs, one.bends)), max(rate.size for rate in one.rates)
        _hold(most <= limits["max_curvature"] and rate <= limits["max_curvature_rate"], f"curvature: of {one.where}")
        angle = math.atan((Span(most) * limits["wheelbase"]).hi) + _ACCURACY
        _hold(angle <= limits["max_steering_angle"], f"curvature: steering angle of {one.where}")
    first, last, wanted = segments[0], segments[-1], dock["final_straight"]
    if first.gear != 0.0 and first.poses is None and start["curvature"] is not None:
        _hold(abs(first.bends[0] - start["curvature"]) <= TOLERANCE, "start_curvature: differs")
    if wanted > 0.0 and last.poses is None:
        _hold(last.gear != 0.0 and last.length.lo >= wanted - TOLERANCE, "final_straight: the last gear is too short")
        begin = max(0.0, last.knots[-1] - wanted) + 1e-9
        index = max(i for i, knot in enumerate(last.knots[:-1]) if knot <= begin)
        bends = [last.bend_at(index, Span(begin)).size, *map(abs, last.bends[index + 1 :])]
        _hold(max(bends) <= TOLERANCE, "final_straight: is not straight")


def _limits(proof: dict[str, Any]) -> dict[str, float]:
    """Return the limits, widened by the tolerance, and the dimensions of the robot; infinite if they are absent."""
    given, known = proof["robot"]["limits"], (*_LINEAR, *_TURNING, *_PATH)
    _hold(set(_LINEAR) <= set(given) <= {*known, *_DIMENSIONS}, f"limits: no rule for one of {sorted(given)}")
    wide = {name: (Span(value) * (1.0 + TOLERANCE)).lo for name, value in given.items()}
    return {**dict.fromkeys(known, math.inf), **wide, **{name: given.get(name, 0.0) for name in _DIMENSIONS}}


@cache
def _weights(n: int) -> list[list[Span]]:
    return [[Span(float(math.comb(i, k))) / float(math.comb(n, k)) for k in range(i + 1)] for i in range(n + 1)]


def _range(terms: list[Span], width: float) -> Span:
    """Return the range of a polynomial on [0, width]: it lies between its Bernstein coefficients."""
    powers = accumulate([Span(1.0), *[Span(width)] * (len(terms) - 1)], lambda a, b: a * b)
    scaled = [term * power for term, power in zip(terms, powers, strict=True)]
    rows = _weights(len(terms) - 1)
    return _around([sum((w * one for w, one in zip(row, scaled)), _ZERO) for row in rows])  # noqa: B905 - a prefix


def _product(first: list[Span], *others: list[Span]) -> list[Span]:
    for other in others:
        terms = [_ZERO] * (len(first) + len(other) - 1)
        for i, a in enumerate(first):
            for k, b in enumerate(other):
                terms[i + k] = terms[i + k] + a * b
        first = terms
    return first


_State = tuple[Span, Span, Span]


def _after(state: _State, jerk: float, t: float) -> _State:
    """Return distance, speed and acceleration after a time of constant jerk."""
    (s, v, a), gain = state, Span(jerk) * t
    return s + (v + (a * 0.5 + gain / 6.0) * t) * t, v + (a + gain * 0.5) * t, a + gain


class _Motion:
    """The time law: phases of constant jerk; every segment has those between the rests at its ends (C14)."""

    def __init__(self, proof: dict[str, Any], segments: list[_Segment], phases: dict[str, Any]) -> None:
        self.proof, self.limits, self.segments, dock = proof, _limits(proof), segments, proof["dock"]
        self.begins = [*accumulate((one.length for one in segments), lambda a, b: a + b, initial=_ZERO)]
        s, v, a = phases["start"]
        self.states: list[_State] = [(Span(s), Span(v), Span(a))]
        self.phases = [*zip(phases["durations"], phases["jerks"], strict=True)]
        for duration, jerk in self.phases:
            _hold(duration >= 0.0, "coverage: a duration is negative")
            self.states.append(_after(self.states[-1], jerk, duration))
        _hold(abs(s) <= TOLERANCE, "coverage: the motion does not begin with the path")
        speed, gain = proof["start"]["speed"], proof["start"]["acceleration"]
        sign = math.copysign(1.0, speed) if speed else segments[0].gear or 1.0
        _hold(max(abs(v - abs(speed)), abs(a - sign * gain)) <= TOLERANCE, "start_state: speed or acceleration differ")
        left = dock["approach_distance"] if dock["approach_speed"] is not None else 0.0
        self.zone, end = math.inf, self.begins[-1] - left
        for one, begin in zip(segments[::-1], self.begins[::-1], strict=False):
            end = end - one.length if one.gear == 0.0 and begin.hi > end.lo else end
        if left > 0.0:
            self.zone, self.zone_speed = end.lo, (Span(dock["approach_speed"]) * (1.0 + TOLERANCE)).lo
        self.back = 0.0

    def check(self) -> float:
        """Check rests, waits and every limit over the whole motion; return its duration [s]."""
        rests = [k for k, (_, v, a) in enumerate(self.states) if max(v.size, a.size) <= TOLERANCE]
        near = [[k for k in rests if (self.states[k][0] - place).size <= TOLERANCE] for place in self.begins]
        cuts, rate = [0], self.limits["max_steering_rate"]
        for i, found in enumerate(near[1:], start=1):
            later = [k for k in found if k >= cuts[-1]]
            is_end = i == len(self.segments)
            _hold(bool(later) and (not is_end or later[-1] == len(self.phases)), f"rest: none after segment {i - 1}")
            cuts.append(later[-1] if is_end else later[0])
        for found, angle in zip(near, self._steered(), strict=False):
            waits = [Span(t) for k, (t, _) in enumerate(self.phases) if {k, k + 1} <= set(found)]
            _hold(rate == math.inf or angle <= (sum(waits, Span(TOLERANCE)) * rate).lo, "rest: too short to steer")
        for i, (first, last) in enumerate(pairwise(cuts)):
            for k in range(first, last):
                self._check_phase(i, k)
        _hold(self.back <= TOLERANCE, "coverage: the motion runs backwards")
        return math.fsum(t for t, _ in self.phases)

    def _steered(self) -> list[float]:
        """Return upper bounds of the angles by which the wheels are steered at the start and at the cusps [rad]."""
        base, given = self.limits["wheelbase"], self.proof["robot"]["limits"]
        turned = [[math.atan(one.bends[k] * one.gear * base) for k in (0, -1)] for one in self.segments]
        farthest = given.get("max_steering_angle") or math.atan(base * given.get("max_curvature", math.inf))
        first = farthest + abs(turned[0][0]) if self.proof["start"]["curvature"] is None else 0.0
        return [one + 1e-12 for one in (first, *(abs(b[0] - a[1]) for a, b in pairwise(turned)))]

    def _check_phase(self, i: int, k: int) -> None:
        """Divide a phase until every limit is proven on all parts."""
        parts, jerk = [(self.states[k], self.phases[k][0])], self.phases[k][1]
        while parts:
            state, width = parts.pop()
            broken, marks = self._broken(i, state, jerk, width)
            if broken:
                _hold(width > _SHORTEST, f"{broken}: beyond its limit, or unproven, near s = {state[0].lo:.4f} m")
                cut = _cut(state, jerk, width, marks)
                parts += [(state, cut), (_after(state, jerk, cut), (Span(width) - cut).hi)]

    def _broken(self, i: int, state: _State, jerk: float, width: float) -> tuple[str, list[float]]:
        """Return the first limit that is not proven on a part of a phase, and the borders inside the part [m]."""
        one, (s, v, a), j, n = self.segments[i], state, Span(jerk), len(self.segments[i].rates)
        speed, gain, knots = [v, a, j * 0.5], [a, j], [self.begins[i] + knot for knot in one.knots]
        place = _range([s, v, a * 0.5, j / 6.0], width)
        inside = [
            k for k in range(n) if (k == 0 or knots[k].lo <= place.hi) and (k == n - 1 or knots[k + 1].hi >= place.lo)
        ]
        ramp = _around([one.rates[k] for k in inside])
        if len(inside) == 1:
            bend = [one.bend_at(inside[0], s - self.begins[i]), ramp * v, ramp * a * 0.5, ramp * j / 6.0]
        else:
            ends = (place - self.begins[i]).lo, (place - self.begins[i]).hi
            clipped = [Span(*(min(max(end, one.knots[k]), one.knots[k + 1]) for end in ends)) for k in inside]
            bend = [_around([one.bend_at(k, at) for k, at in zip(inside, clipped, strict=True)])]
        for name, terms, least, most in self._quantities(one, speed, gain, j, bend, ramp, place.hi > self.zone):
            found = _range(terms, width)
            if not least <= found.lo <= found.hi <= most:
                return name, [*(knots[k].lo for k in inside[1:]), *[self.zone] * (place.lo < self.zone < place.hi)]
        self.back += width * max(0.0, -_range(speed, width).lo)
        return "", []

    def _quantities(self, one, speed, gain, j, bend, ramp, in_zone):
        """Yield the name, polynomial and bounds of each limited quantity; the table in the theory page lists them."""
        limits, lever = self.limits, 0.5 * self.limits["track_width"]
        top = limits["max_speed" if one.gear > 0.0 else "max_reverse_speed"]
        up, down, jerk = limits["max_acceleration"], limits["max_deceleration"], limits["max_jerk"]
        if one.gear == 0.0:  # (G3)
            weak, strong = sorted((up, down))
            top = min(limits["max_yaw_rate"], limits["max_wheel_speed"] / lever if lever else math.inf)
            up = down = min(limits["max_yaw_acceleration"], weak / lever if lever else math.inf)
            jerk = up * jerk / strong
        elif in_zone:
            top = min(top, self.zone_speed)
        yield "speed", speed, -TOLERANCE, top
        yield "acceleration", gain, -down, up
        yield "jerk", [j], -jerk, jerk
        if one.gear == 0.0:
            return
        turn, squared = _product(speed, bend), _product(speed, speed)
        for name, terms in (
            ("yaw_rate", lambda: turn),
            ("yaw_acceleration", lambda: _sum(_product(gain, bend), _product(squared, [ramp]))),
            ("lateral_acceleration", lambda: _product(speed, turn)),
            ("lateral_jerk", lambda: _sum(_product(gain, turn, [Span(2.0)]), _product(squared, speed, [ramp]))),
            ("wheel_speed", lambda: _sum(speed, _product(turn, [Span(lever)]))),
            ("wheel_speed", lambda: _sum(speed, _product(turn, [Span(-lever)]))),
        ):
            if limits[f"max_{name}"] < math.inf:
                yield name, terms(), -limits[f"max_{name}"], limits[f"max_{name}"]
        rate, base = limits["max_steering_rate"], Span(limits["wheelbase"])
        for side in (1.0, -1.0) if rate < math.inf else ():
            slack = _product(bend, bend, [base * base * -rate])
            yield "steering_rate", _sum(_product(speed, [base * ramp * side]), slack), -math.inf, rate


def _sum(first: list[Span], second: list[Span]) -> list[Span]:
    return [a + b for a, b in zip_longest(first, second, fillvalue=_ZERO)]


def _cut(state: _State, jerk: float, width: float, marks: list[float]) -> float:
    """Return where to divide a part: just before or after it reaches a mark, or in the middle."""
    s, v, a = (0.5 * (one.lo + one.hi) for one in state)
    for mark in marks:
        low, high = 0.0, width
        for _ in range(60):
            t = 0.5 * (low + high)
            low, high = (low, t) if s + t * (v + t * (0.5 * a + t * jerk / 6.0)) >= mark else (t, high)
        for cut in (low - 0.4 * _SHORTEST, low + 0.4 * _SHORTEST):
            if 0.5 * _SHORTEST < cut < width - 0.1 * _SHORTEST:
                return cut
    return 0.5 * width


def judge(text: str) -> str:
    """Return a sentence about what was accepted and what was not judged.

    Raises:
        Refusal: If a rule is broken or not proven.
    """
    plan = _read(text)
    proof, curves, motion = plan["proof"], plan["path"]["segments"], plan.get("trajectory")
    segments, rule, ends = [_Segment(curve, f"path segment {i}") for i, curve in enumerate(curves)], _Rule(proof), []
    boxes = [
        (x.lo, y.lo, x.hi, y.hi)
        for x, y in (map(_around, zip(*[map(Span, p) for p in rock])) for rock in proof["obstacles"])
    ]
    _hold(len(proof["cells"]) == len(segments), "cells: a segment has none")
    for segment, part in zip(segments, proof["cells"], strict=True):
        cells = segment.cells(part["borders"])
        _hold(len(cells) == len(part["planes"]), f"cells: {segment.where} needs a list of planes for every cell")
        for k, (cell, planes) in enumerate(zip(cells, part["planes"], strict=True)):
            _clear(cell, rule, proof, boxes, planes, f"in cell {k} of {segment.where}")
        ends.append(cells[-1].last)
    _check_path(segments, ends, rule, proof)
    sampled = any(one.poses is not None for one in segments)
    open_points = ["samples", "raw_path", "certificate", "whether the problem is the real one"]
    open_points += ["curvature, slip and final straight of poses"] * sampled
    open_points += ["motion"] * (motion is None or sampled) + ["view of the dock"] * bool(
        proof["dock"].get("visible_distance")
    )
    said = f"path of {ends[-1].x.lo:.3f}"
    if motion is not None and not sampled:
        said += f", motion of {_Motion(proof, segments, motion['phases']).check():.3f} s"
    return f"accepted: {said}, {len(boxes)} obstacles; not judged: {', '.join(open_points)}"


def main(arguments: list[str] | None = None) -> int:
    """Judge the file that is named on the command line; return the exit status."""
    names = sys.argv[1:] if arguments is None else arguments
    try:
        with open(names[0], "rb") as stream:
            sys.stdout.write(judge(stream.read(32_000_000).decode()) + "\n")
        return 0
    except Refusal as error:
        sys.stderr.write(f"refused: {error}\n")
        return 3
    except (
        OSError,
        ValueError,
        KeyError,
        TypeError,
        IndexError,
        AttributeError,
        RecursionError,
        OverflowError,
    ) as error:
        sys.stderr.write(f"not a plan file with a proof: {type(error).__name__}: {error}\n")
        return 2


if __name__ == "__main__":
    sys.exit(main())
