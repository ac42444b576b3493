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
from itertools import accumulate, pairwise, product, zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

__all__ = ["Refusal", "Span", "judge", "main"]

TOLERANCE = 1e-6  # [m], [rad], and relative to limits, as in the certificate
_WIDE, _ACCURACY, _SHORTEST = 1.0 + TOLERANCE, 2.0**-50, 1e-9  # limits; sin, cos; parts of the motion [s]
_LINEAR = {"max_speed", "max_reverse_speed", "max_acceleration", "max_deceleration", "max_jerk"}
_TURNING = {"yaw_rate", "yaw_acceleration", "lateral_acceleration", "lateral_jerk", "wheel_speed", "steering_rate"}
_LIMITS = _LINEAR | {f"max_{name}" for name in _TURNING | {"curvature", "curvature_rate", "steering_angle"}}


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
        ends = self.lo * o.lo, self.lo * o.hi, self.hi * o.lo, self.hi * o.hi
        return Span(math.nextafter(min(ends), -math.inf), math.nextafter(max(ends), math.inf))

    def __truediv__(self, other: Span | float) -> Span:
        o = other if isinstance(other, Span) else Span(other)
        _hold(o.lo > 0.0, "arithmetic: a divisor must be positive")
        return self * Span(math.nextafter(1.0 / o.hi, 0.0), math.nextafter(1.0 / o.lo, math.inf))

    __radd__, __rmul__ = __add__, __mul__

    @property
    def size(self) -> float:
        """Largest absolute value."""
        return max(-self.lo, self.hi)

    @classmethod
    def around(cls, spans: Iterable[Span]) -> Span:
        """Return the smallest interval that contains the given ones."""
        lows, highs = zip(*((span.lo, span.hi) for span in spans), strict=True)
        return cls(min(lows), max(highs))

    def root(self) -> Span:
        """Return the square root."""
        return Span(math.nextafter(math.sqrt(self.lo), 0.0), math.nextafter(math.sqrt(self.hi), math.inf))

    def turned(self, x: Span | float, y: Span | float) -> tuple[Span, Span]:
        """Return the vector (x, y) turned by this angle; sin and cos change by no more than the angle."""
        middle = min(max(0.5 * self.lo + 0.5 * self.hi, self.lo), self.hi)
        off = max((Span(self.hi) - middle).hi, (Span(middle) - self.lo).hi) + 2.0 * _ACCURACY
        c, s = (Span(-off, off) + value for value in (math.cos(middle), math.sin(middle)))
        return c * x - s * y, s * x + c * y


_ZERO, _FULL_TURN = Span(0.0), Span(math.pi, math.nextafter(math.pi, 4.0)) * 2.0  # the float pi is below pi


def _length(x: Span, y: Span) -> float:
    return Span(0.0, (x * x + y * y).hi).root().hi  # an upper bound


class _Pose(NamedTuple):
    x: Span
    y: Span
    yaw: Span

    def gap_to(self, other: _Pose) -> float:
        """Return an upper bound of the larger of distance [m] and angle [rad] between two poses."""
        turn = self.yaw - other.yaw
        turn = turn - _FULL_TURN * float(round((turn.lo + turn.hi) / (4.0 * math.pi)))
        return max(_length(self.x - other.x, self.y - other.y), turn.size)

    def after(self, step: Span, bend: Span, rate: Span, gear: float) -> _Pose:
        """Return the pose after a step on a clothoid: Taylor series of cos and sin of the yaw, with their remainder."""
        yaw = (rate * step * 0.5 + bend) * step + self.yaw
        (c, s), before, (x, y), power, n = self.yaw.turned(1.0, 0.0), (_ZERO, _ZERO), (_ZERO, _ZERO), step, 1.0
        most, bound, bound0 = step * rate.size + bend.size, Span(1.0), _ZERO
        while (bound * power).hi > 1e-16 and gear != 0.0:  # this product bounds the rest of both series
            _hold(n < 60.0, "cells: a cell turns too far")
            x, y, power = x + c * power / n, y + s * power / n, power * step
            c0, s0, before = *before, (c, s)
            c, s = -(bend * s + rate * s0) / n, (bend * c + rate * c0) / n
            bound, bound0, n = (most * bound + bound0 * rate.size) / n, bound, n + 1.0
        rest = Span(-(bound * power).hi, (bound * power).hi)
        return _Pose(self.x + (x + rest) * gear, self.y + (y + rest) * gear, yaw)


class _Cell(NamedTuple):
    """Poses of a cell, the velocity (x, y, yaw) in its middle, the bounds of (C4), half its width."""

    poses: tuple[_Pose, _Pose, _Pose]
    velocity: list[Span]
    bend: float
    twist: float
    half: float


class _Segment:
    """Clothoids or poses driven in one gear, or a turn in place, whose coordinate is its angle and whose gear is 0."""

    def __init__(self, curve: dict[str, Any], where: str) -> None:
        self.where, self.poses, turn, start = where, curve.get("poses"), curve.get("turn"), curve.get("start")
        self.gear: float = 0.0 if turn is not None else curve["direction"]
        _hold(turn is not None or self.gear in (1.0, -1.0), f"{where}: the direction must be 1 or -1")
        if self.poses is not None:
            start, self.knots = self.poses[0], [float(i) for i in range(len(self.poses))]
            self.bends = [0.0 * _ for _ in self.knots]
            _hold(all(abs(b[2] - a[2]) <= math.pi for a, b in pairwise(self.poses)), f"{where}: turns by more than pi")
        elif turn is not None:
            self.knots, self.bends = [0.0, abs(turn)], [math.copysign(1.0, turn)] * 2
        else:
            self.knots, self.bends = curve["knots"], curve["curvature"]
        rising = self.knots[0] == 0.0 and len(self.knots) > 1 and all(a < b for a, b in pairwise(self.knots))
        _hold(rising, f"{where}: the knots must increase from 0")
        pieces = zip(pairwise(self.knots), pairwise(self.bends), strict=True)
        self.rates = [(Span(m) - k) / (Span(b) - a) for (a, b), (k, m) in pieces]
        x, y, yaw = start
        self.start, self.length = _Pose(Span(x), Span(y), Span(yaw)), Span(self.knots[-1])

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
            pose = found[-1].poses[2]
        return found

    def _cell(self, index: int, pose: _Pose, u: float, v: float) -> _Cell:
        middle, rate = 0.5 * (u + v), self.rates[index]
        half = max((Span(middle) - u).hi, (Span(v) - middle).hi)
        if self.poses is not None:
            a, b = ([Span(value) for value in one] for one in self.poses[index : index + 2])
            step, shares = [q - p for p, q in zip(a, b, strict=True)], [Span(at) - u for at in (u, middle, v)]
            pose = pose if u != self.knots[index] else _Pose(*a)
            ends = [_Pose(*(p + d * share for p, d in zip(pose, step, strict=True))) for share in shares]
            return _Cell((ends[0], ends[1], ends[2]), step, 0.0, (step[2] * step[2]).hi, half)
        bends = [self.bend_at(index, Span(place)) for place in (u, middle, v)]
        at, end = (pose.after(Span(to) - u, bends[0], rate, self.gear) for to in (middle, v))
        most = Span(max(bend.size for bend in bends))
        velocity, twist = [*at.yaw.turned(self.gear, 0.0), bends[1]], (most * most + rate.size).hi
        return _Cell((pose, at, end), velocity, abs(self.gear) * most.hi, twist, half)


class _Clearance:
    """The footprint, the obstacles, and the required clearance (C2), (C22) with the tracking tube (C17)."""

    def __init__(self, proof: dict[str, Any]) -> None:
        robot, rule, x, y, yaw = proof["robot"], proof["clearance"], *proof["start"]["pose"]
        self.ends = [[Span(value) for value in proof[key]["pose"][:2]] for key in ("dock", "start")]
        outline, self.region, self.obstacles = robot["footprint"], proof["region"], proof["obstacles"]
        self.pieces, edges = robot.get("pieces") or [outline], Counter[Any]()
        for sign, ring in ((1, outline), *((-1, piece) for piece in self.pieces)):
            for a, b in pairwise([(x, y) for x, y in [*ring, ring[0]]]):
                edges[min(a, b), max(a, b)] += sign * ((a < b) - (a > b))
        # All inner edges cancel: every point inside the outline is also inside a piece, by their winding numbers.
        _hold(not any(edges.values()), "footprint: its convex pieces do not cover it")
        self.boxes = [[Span.around(map(Span, one)) for one in zip(*rock, strict=True)] for rock in self.obstacles]
        self.at_dock, self.taper, self.run = (rule[key] for key in ("at_dock", "taper", "dock_run"))
        self.relief, self.at_start, (e, w) = rule["start_relief"], rule["at_start"], robot["tracking"]
        ordered = rule["required"] >= max(self.at_dock, self.at_start or 0.0) and w <= math.pi
        least = min(self.at_dock, self.taper, self.run, self.relief, self.at_start or 0.0, e, w)
        _hold(ordered and least >= 0.0, "clearance: a number of the rule is negative or too large")
        radius, xs = max(_length(Span(x), Span(y)) for x, y in outline), [x for x, _ in outline]
        self.most = (
            (Span(0.5 * w).turned(2.0 * radius, 0.0)[1] + e + rule["required"]).hi if e or w else rule["required"]
        )
        spots = ([Span(yaw).turned(*point) for point in piece] for piece in self.pieces)
        bodies = [[((px + x).lo, (py + y).lo) for px, py in spot] for spot in spots]
        pairs = ((body, rock) for body in bodies for rock in self.obstacles)
        # The clearance of the start is at most the length of some line to an obstacle, up to rounding.
        self.kept = min((min(_gap(a, b), _gap(b, a)) for a, b in pairs), default=1e9) + 1e-14 * (
            radius + abs(x) + abs(y)
        )
        eased = self.relief <= 2.0 * (max(xs) - min(xs)) * _WIDE and self.kept < self.most
        _hold(self.relief == 0.0 or eased, "clearance: start_relief is not allowed (C22)")

    def _tapered(self, distance: float, least: float) -> float:
        beyond = (Span(distance) - self.run).hi
        if beyond <= 0.0 or beyond >= self.taper:
            return float(least if beyond <= 0.0 else self.most)
        return (Span(beyond) / self.taper * (Span(self.most) - least) + least).hi

    def _needed(self, cell: _Cell) -> float:
        """Return an upper bound of the requirement in a cell, from its largest distances from goal and start (C7)."""
        sag, outer = (Span(cell.bend) * cell.half * cell.half * 0.5).hi, (cell.poses[0], cell.poses[2])
        far = [max(_length(at.x - x, at.y - y) for at in outer) for x, y in self.ends]
        goal, start = ((Span(distance) + sag).hi for distance in far)
        kept = max(self.kept - 0.005, 0.5 * self.kept) if self.relief else self.kept
        leaving = (Span(max(0.0, (Span(start) - self.relief).hi)) * 0.5 + kept).hi
        if self.relief and self.at_start is not None:
            leaving = min(leaving, self._tapered(start, self.at_start))
        return min(self._tapered(goal, self.at_dock), leaving)

    def check(self, cell: _Cell, planes: list[Any], where: str) -> None:
        """Check (C8) in a cell: from its middle, every corner of the footprint moves as in (C5)."""
        at, (vx, vy, turn), named = cell.poses[1], cell.velocity, {(o, p): Span(angle) for o, p, angle in planes}
        need, half = (Span(self._needed(cell)) - TOLERANCE).hi, Span(-cell.half, cell.half)
        need = need if len(self.pieces) == 1 else max(need, 1e-12)  # no tolerance for overlaps between pieces
        reach, (x0, y0, x1, y1) = Span(-max(need, 0.0), max(need, 0.0)), self.region
        for number, piece in enumerate(self.pieces):
            corners = []
            for px, py in piece:
                (x, y), arm = at.yaw.turned(px, py), _length(Span(px), Span(py))
                stray = ((Span(cell.twist) * arm + cell.bend) * cell.half * cell.half * 0.5).hi
                corners.append((at.x + x, at.y + y, vx - turn * y, vy + turn * x, Span(-stray, stray)))
            wide, high = (Span.around(one[k] + one[k + 2] * half + one[4] + reach for one in corners) for k in (0, 1))
            inside = x0 <= wide.lo and y0 <= high.lo and wide.hi <= x1 and high.hi <= y1
            _hold(inside, f"clearance: the robot leaves the region {where}")
            for i, (across, along) in enumerate(self.boxes):
                if across.lo > wide.hi or across.hi < wide.lo or along.lo > high.hi or along.hi < high.lo:
                    continue
                _hold((i, number) in named, f"clearance: no direction for obstacle {i} and piece {number} {where}")
                nx, ny = named[i, number].turned(1.0, 0.0)
                near = min((nx * x + ny * y + (nx * u + ny * v) * half + e).lo for x, y, u, v, e in corners)
                far = max((nx * ox + ny * oy).hi for ox, oy in self.obstacles[i])
                _hold((Span(near) - far).lo >= need, f"clearance: obstacle {i} is too close {where}")


def _gap(corners: list[Any], ring: list[Any]) -> float:
    """Return the smallest distance of corners from the edges of a ring, up to rounding."""
    best = math.inf
    for (ax, ay), (bx, by) in pairwise([*ring, ring[0]]):
        dx, dy = bx - ax, by - ay
        square = dx * dx + dy * dy
        for px, py in corners:
            t = min(1.0, max(0.0, ((px - ax) * dx + (py - ay) * dy) / square)) if square > 0.0 else 0.0
            best = min(best, math.hypot(px - ax - t * dx, py - ay - t * dy))
    return best


def _limits(proof: dict[str, Any]) -> dict[str, float]:
    given = proof["robot"]["limits"]
    _hold(
        _LINEAR <= set(given) <= _LIMITS | {"track_width", "wheelbase"}, f"limits: no rule for one of {sorted(given)}"
    )
    return {**dict.fromkeys(_LIMITS, math.inf), "track_width": 0.0, "wheelbase": 0.0, **given}


def _check_path(segments: list[_Segment], ends: list[_Pose], proof: dict[str, Any]) -> None:
    """Check the path rules: ends, joints, gears, turns, curvature, final straight."""
    start, dock, limits = proof["start"], proof["dock"], _limits(proof)
    first, last, driven = segments[0], segments[-1], [one for one in segments if one.gear != 0.0]
    begin, goal = (_Pose(*(Span(value) for value in one["pose"])) for one in (start, dock))
    gaps = [Span(a.gap_to(b.start)) for a, b in zip(ends[:-1], segments[1:], strict=True)]
    _hold(first.start.gap_to(begin) <= TOLERANCE, "start: the path does not begin there")
    _hold(ends[-1].gap_to(goal) <= TOLERANCE, "goal: the path does not end there")
    _hold(sum(gaps, _ZERO).hi <= TOLERANCE, "joint: the path jumps between its segments")
    _hold(all(one.length.lo > 1e-5 for one in segments), "joint: a segment is too short to be judged")
    _hold(proof["robot"]["turns_in_place"] is True or len(driven) == len(segments), "turn: the robot cannot turn")
    at_rest = start["speed"] == start["acceleration"] == 0.0
    _hold(at_rest or first.gear != 0.0, "turn: the path begins with a turn, but the robot is not at rest")
    gears = {"auto": (1.0, -1.0), "forward": (1.0,), "backward": (-1.0,)}[dock["direction"]]
    _hold(not driven or driven[-1].gear in gears, "direction: the gear at the dock is not allowed")
    _hold(not driven or driven[0].gear * start["speed"] >= 0.0, "direction: the robot moves in the other gear")
    for one in (one for one in driven if one.poses is None):
        most, rate = max(map(abs, one.bends)), max(rate.size for rate in one.rates)
        _hold(most <= limits["max_curvature"] * _WIDE, f"curvature: {most:g} 1/m on {one.where}")
        _hold(rate <= limits["max_curvature_rate"] * _WIDE, f"curvature_rate: {rate:g} 1/m^2 on {one.where}")
        angle = math.atan((Span(most) * limits["wheelbase"]).hi) + _ACCURACY
        _hold(angle <= limits["max_steering_angle"] * _WIDE, f"curvature: steering angle on {one.where}")
    if first in driven and first.poses is None and start["curvature"] is not None:
        _hold(abs(first.bends[0] - start["curvature"]) <= TOLERANCE, "start_curvature: differs from that of the start")
    if dock["final_straight"] > 0.0 and last.poses is None:
        _hold(last in driven and last.length.lo >= dock["final_straight"] - TOLERANCE, "final_straight: too short")
        place = max(0.0, last.length.lo - dock["final_straight"]) + 1e-9
        index = max(i for i, knot in enumerate(last.knots[:-1]) if knot <= place)
        bends = [last.bend_at(index, Span(place)).size, *map(abs, last.bends[index + 1 :])]
        _hold(max(bends) <= TOLERANCE, "final_straight: is not straight")


@cache
def _weights(n: int) -> list[list[Span]]:
    return [[Span(float(math.comb(i, k))) / float(math.comb(n, k)) for k in range(i + 1)] for i in range(n + 1)]


class _Polynomial:
    """A polynomial in time with intervals as coefficients, the constant one first."""

    def __init__(self, *terms: Span) -> None:
        self.terms = terms

    def __add__(self, other: _Polynomial) -> _Polynomial:
        return _Polynomial(*(a + b for a, b in zip_longest(self.terms, other.terms, fillvalue=_ZERO)))

    def __mul__(self, other: _Polynomial) -> _Polynomial:
        terms = [_ZERO] * (len(self.terms) + len(other.terms) - 1)
        for (i, a), (k, b) in product(enumerate(self.terms), enumerate(other.terms)):
            terms[i + k] = terms[i + k] + a * b
        return _Polynomial(*terms)

    def over(self, width: float) -> Span:
        """Return its range on [0, width], which lies between its Bernstein coefficients."""
        powers = accumulate([Span(width)] * (len(self.terms) - 1), lambda a, b: a * b, initial=Span(1.0))
        scaled = [term * power for term, power in zip(self.terms, powers, strict=True)]
        rows = _weights(len(scaled) - 1)
        return Span.around(sum((a * b for a, b in zip(row, scaled, strict=False)), _ZERO) for row in rows)


class _Motion:
    """The time law: phases of constant jerk; every segment has those between the rests at its ends (C14)."""

    def __init__(self, proof: dict[str, Any], segments: list[_Segment], phases: dict[str, Any]) -> None:
        self.limits, self.segments, dock, start = _limits(proof), segments, proof["dock"], proof["start"]
        self.begins = [*accumulate((one.length for one in segments), lambda a, b: a + b, initial=_ZERO)]
        s, v, a = phases["start"]
        self.states, self.back = [(Span(s), Span(v), Span(a))], 0.0
        self.phases = [*zip(phases["durations"], phases["jerks"], strict=True)]
        _hold(all(duration >= 0.0 for duration, _ in self.phases), "coverage: a duration is negative")
        for duration, jerk in self.phases:
            self.states.append(_after(self.states[-1], jerk, duration))
        _hold(abs(s) <= TOLERANCE, "coverage: the motion does not begin with the path")
        sign = math.copysign(1.0, start["speed"]) if start["speed"] else segments[0].gear or 1.0
        off = max(abs(v - abs(start["speed"])), abs(a - sign * start["acceleration"]))
        _hold(off <= TOLERANCE, "start_state: speed or acceleration differ from those of the start")
        self.zone, end = math.inf, self.begins[-1] - dock["approach_distance"]
        for one, at in zip(segments[::-1], self.begins[:0:-1], strict=True):
            end = end - one.length if one.gear == 0.0 and at.hi > end.lo else end
        if dock["approach_distance"] > 0.0 and dock["approach_speed"] is not None:
            self.zone, self.zone_speed = end.lo, dock["approach_speed"]
        base, most = self.limits["wheelbase"], min(self.limits["max_steering_angle"], 0.5 * math.pi)
        most = min(most, math.atan(base * self.limits["max_curvature"])) if base else most
        angles = [[math.atan(one.bends[k] * one.gear * base) for k in (0, -1)] for one in segments]
        unknown = most + abs(angles[0][0]) if start["curvature"] is None else 0.0
        self.steered = [unknown, *(abs(b[0] - a[1]) for a, b in pairwise(angles))]  # at the start and at the cusps

    def check(self) -> float:
        """Check rests, waits and every limit over the whole motion; return its duration [s]."""
        rests = [k for k, (_, v, a) in enumerate(self.states) if max(v.size, a.size) <= TOLERANCE]
        near = [[k for k in rests if (self.states[k][0] - place).size <= TOLERANCE] for place in self.begins]
        _hold(len(self.phases) in near[-1], "rest: none at the end of the path")
        cuts, rate = [0], self.limits["max_steering_rate"]
        for i, found in enumerate(near[1:-1]):
            cuts += [k for k in found if k >= cuts[-1]][:1]
            _hold(len(cuts) == i + 2, f"rest: none after segment {i}")
        for found, angle in zip(near, self.steered, strict=False):
            waits = sum((Span(t) for k, (t, _) in enumerate(self.phases) if {k, k + 1} <= set(found)), Span(TOLERANCE))
            _hold(rate == math.inf or angle <= waits.lo * rate * _WIDE, "rest: too short to steer the wheels (C16)")
        for i, (first, last) in enumerate(pairwise([*cuts, len(self.phases)])):
            for k in range(first, last):
                self._check_phase(i, k)
        _hold(self.back <= TOLERANCE, "coverage: the motion runs backwards")
        return math.fsum(t for t, _ in self.phases)

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
        one, (s, v, a), j = self.segments[i], state, Span(jerk)
        at, speed = _Polynomial(s - self.begins[i], v, a * 0.5, j / 6.0).over(width), _Polynomial(v, a, j * 0.5)
        knots, last = one.knots, len(one.rates) - 1
        inside = [k for k in range(last + 1) if (k == 0 or knots[k] <= at.hi) and (k == last or knots[k + 1] >= at.lo)]
        ramp, marks = Span.around(one.rates[k] for k in inside), [self.begins[i].lo + knots[k] for k in inside[1:]]
        if len(inside) == 1:
            bend = _Polynomial(one.bend_at(inside[0], s - self.begins[i]), ramp * v, ramp * a * 0.5, ramp * j / 6.0)
        else:
            parts = [Span(*(min(max(end, knots[k]), knots[k + 1]) for end in (at.lo, at.hi))) for k in inside]
            bend = _Polynomial(Span.around(one.bend_at(k, part) for k, part in zip(inside, parts, strict=True)))
        place = at + self.begins[i]
        for name, terms, least, most in self._quantities(one, place, (speed, _Polynomial(a, j), bend, ramp)):
            found = terms.over(width)
            if not least * _WIDE <= found.lo <= found.hi <= most * _WIDE:
                return name, [*marks, *[self.zone] * (place.lo < self.zone < place.hi)]
        self.back += width * max(0.0, -speed.over(width).lo)
        return "", []

    def _quantities(
        self, one: _Segment, place: Span, motion: tuple[_Polynomial, _Polynomial, _Polynomial, Span]
    ) -> Iterator[tuple[str, _Polynomial, float, float]]:
        """Yield each limited quantity with its bounds; the table after (C12) lists them."""
        (v, a, k, ramp), limits, lever = motion, self.limits, 0.5 * self.limits["track_width"]
        up, down, jerk, rate = (
            limits[f"max_{key}"] for key in ("acceleration", "deceleration", "jerk", "steering_rate")
        )
        top = min(limits["max_speed" if one.gear > 0.0 else "max_reverse_speed"], math.inf)
        if one.gear == 0.0:  # (G3)
            top = min(limits["max_yaw_rate"], limits["max_wheel_speed"] / lever if lever else math.inf)
            gain = min(limits["max_yaw_acceleration"], min(up, down) / lever if lever else math.inf)
            up, down, jerk = gain, gain, gain * jerk / max(up, down)
        elif place.hi > self.zone:
            top = min(top, self.zone_speed)
        yield "speed", v, -TOLERANCE, top
        yield "acceleration", a, -down, up
        yield "jerk", _Polynomial(a.terms[1]), -jerk, jerk
        r, half, base = _Polynomial(ramp), _Polynomial(Span(lever)), limits["wheelbase"]
        for name, terms in (
            ("yaw_rate", lambda: v * k),
            ("yaw_acceleration", lambda: a * k + v * v * r),
            ("lateral_acceleration", lambda: v * v * k),
            ("lateral_jerk", lambda: v * (a * k + a * k + v * v * r)),
            ("wheel_speed", lambda: v + v * k * half),
            ("wheel_speed", lambda: v + v * k * half * _Polynomial(Span(-1.0))),
        ):
            if limits[f"max_{name}"] < math.inf and one.gear != 0.0:
                yield name, terms(), -limits[f"max_{name}"], limits[f"max_{name}"]
        for side in (base, -base) if rate < math.inf and one.gear != 0.0 else ():
            slack = k * k * _Polynomial(Span(base) * base * -rate)
            yield "steering_rate", v * r * _Polynomial(Span(side)) + slack, -math.inf, rate


_State = tuple[Span, Span, Span]


def _after(state: _State, jerk: float, t: float) -> _State:
    """Return distance, speed and acceleration after a time of constant jerk."""
    (s, v, a), gain = state, Span(jerk) * t
    return s + (v + (a * 0.5 + gain / 6.0) * t) * t, v + (a + gain * 0.5) * t, a + gain


def _cut(state: _State, jerk: float, width: float, marks: list[float]) -> float:
    """Return where to divide a part: just before or after it reaches a mark, or in the middle."""
    s, v, a = (one.lo for one in state)
    for mark in marks:
        low, high = 0.0, width
        for _ in range(60):
            t = 0.5 * (low + high)
            low, high = (low, t) if s + t * (v + t * (0.5 * a + t * jerk / 6.0)) >= mark else (t, high)
        for cut in (low - 0.4 * _SHORTEST, low + 0.4 * _SHORTEST):
            if 0.5 * _SHORTEST < cut < width - 0.1 * _SHORTEST:
                return cut
    return 0.5 * width


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


def judge(text: str) -> str:
    """Return a sentence about what was accepted and what was not judged.

    Raises:
        Refusal: If a rule is broken or not proven.
    """
    plan = _read(text)
    proof, motion, clearance = plan["proof"], plan.get("trajectory"), _Clearance(plan["proof"])
    segments, ends = [_Segment(curve, f"segment {i}") for i, curve in enumerate(plan["path"]["segments"])], []
    _hold(0 < len(segments) == len(proof["cells"]), "cells: every segment must have its own")
    for segment, part in zip(segments, proof["cells"], strict=True):
        cells = segment.cells(part["borders"])
        _hold(len(cells) == len(part["planes"]), f"cells: {segment.where} needs a list of planes for every cell")
        for k, (cell, planes) in enumerate(zip(cells, part["planes"], strict=True)):
            clearance.check(cell, planes, f"in cell {k} of {segment.where}")
        ends.append(cells[-1].poses[2])
    _check_path(segments, ends, proof)
    poses = any(one.poses is not None for one in segments)
    left = ["samples", "raw_path", "certificate", "whether the stated problem is the real one"]
    left += ["curvature and slip of poses"] * poses + ["motion"] * (poses or motion is None)
    left += ["view of the dock"] * bool(proof["dock"].get("visible_distance"))
    timed = "" if poses or motion is None else f", {_Motion(proof, segments, motion['phases']).check():.3f} s of motion"
    return f"accepted: path among {len(clearance.obstacles)} obstacles{timed}; not judged: {', '.join(left)}"


def main(arguments: list[str] | None = None) -> int:
    """Judge the file that is named on the command line; return the exit status."""
    try:
        with Path((arguments or sys.argv[1:])[0]).open("rb") as stream:
            sys.stdout.write(judge(stream.read(32_000_000).decode()) + "\n")
    except Refusal as error:
        sys.stderr.write(f"refused: {error}\n")
        return 3
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError, OverflowError) as error:
        sys.stderr.write(f"not a plan file with a proof: {type(error).__name__}: {error}\n")
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
