"""Second judge of plan files: `python judge.py plan.json` accepts or refuses path, clearance and motion limits.

Only the standard library is imported. Intervals are rounded outwards, so a verdict holds for real numbers. Numbers in
parentheses refer to docs/theory/certificate.md. A plan file states the problem, with all obstacles that meet a box
(`region`). `cells` divides the path, and names a separating direction for every obstacle nearby. Trusted are this
statement, the interpreter, IEEE 754, and sin and cos within 2^-50. Exit status: 0 accepted, 3 refused, 2 no proof.
"""

from __future__ import annotations

import json
import math
import sys
from itertools import accumulate, chain, pairwise, product, zip_longest
from pathlib import Path
from typing import Any, NamedTuple

__all__ = ["Refusal", "judge", "main"]

TOLERANCE = 1e-6  # [m], [rad], and relative to limits, as in the certificate
_WIDE, _ACCURACY = 1.0 + TOLERANCE, 2.0**-50  # of limits; of sin and cos
_LIMITS = {"max_speed", "max_reverse_speed", "max_acceleration", "max_deceleration", "max_jerk", "max_yaw_rate"}
_LIMITS |= {"max_yaw_acceleration", "max_lateral_acceleration", "max_lateral_jerk", "max_wheel_speed", "track_width"}
_LIMITS |= {"max_steering_rate", "wheelbase", "max_curvature", "max_curvature_rate"}


class Refusal(Exception):
    """A rule that is broken or not proven."""


def _hold(holds: bool, message: str) -> bool:  # noqa: FBT001 - a condition
    if not holds:
        raise Refusal(message)
    return holds


class _Span:
    """The interval [lo, hi]. Operations round outwards: they contain the results for all numbers of their operands."""

    def __init__(self, lo: float, hi: float | None = None) -> None:
        self.lo, self.hi = lo, lo if hi is None else hi
        if not (type(lo) is type(self.hi) is float and -math.inf < lo <= self.hi < math.inf):  # also true for NaN
            raise Refusal(f"arithmetic: a number overflows or is no number: {type(lo).__name__}")

    def __add__(self, other: _Span | float) -> _Span:
        o = other if isinstance(other, _Span) else _Span(other)
        return _Span(math.nextafter(self.lo + o.lo, -math.inf), math.nextafter(self.hi + o.hi, math.inf))

    def __sub__(self, other: _Span | float) -> _Span:
        o = other if isinstance(other, _Span) else _Span(other)
        return _Span(math.nextafter(self.lo - o.hi, -math.inf), math.nextafter(self.hi - o.lo, math.inf))

    def __mul__(self, other: _Span | float) -> _Span:
        o = other if isinstance(other, _Span) else _Span(other)
        ends = self.lo * o.lo, self.lo * o.hi, self.hi * o.lo, self.hi * o.hi
        return _Span(math.nextafter(min(ends), -math.inf), math.nextafter(max(ends), math.inf))

    def __truediv__(self, other: _Span | float) -> _Span:
        o = other if isinstance(other, _Span) else _Span(other)
        _hold(o.lo > 0.0, "arithmetic: a divisor must be positive")
        return self * _Span(math.nextafter(1.0 / o.hi, 0.0), math.nextafter(1.0 / o.lo, math.inf))

    @property
    def size(self) -> float:
        return max(-self.lo, self.hi)  # largest absolute value

    @classmethod
    def around(cls, spans: list[_Span]) -> _Span:
        return cls(min(span.lo for span in spans), max(span.hi for span in spans))

    def turned(self, x: _Span | float, y: _Span | float) -> tuple[_Span, _Span]:
        """Return the vector (x, y) turned by this angle; sin and cos change by no more than the angle."""
        middle = min(max(0.5 * self.lo + 0.5 * self.hi, self.lo), self.hi)
        off = max((_Span(self.hi) - middle).hi, (_Span(middle) - self.lo).hi) + 2.0 * _ACCURACY
        c, s = (_Span(-off, off) + value for value in (math.cos(middle), math.sin(middle)))
        return c * x - s * y, s * x + c * y


_ZERO, _FULL_TURN = _Span(0.0), _Span(math.pi, math.nextafter(math.pi, 4.0)) * 2.0  # the float pi is below pi


def _length(x: _Span, y: _Span) -> float:
    return math.nextafter(math.sqrt((x * x + y * y).hi), math.inf)  # an upper bound


class _Pose(NamedTuple):
    x: _Span
    y: _Span
    yaw: _Span

    def gap_to(self, other: _Pose) -> float:
        turn = self.yaw - other.yaw - _FULL_TURN * float(round((self.yaw.lo - other.yaw.lo) / (2.0 * math.pi)))
        return max(_length(self.x - other.x, self.y - other.y), turn.size)  # distance [m] or angle [rad], if larger

    def after(self, step: _Span, bend: _Span, rate: _Span, gear: float) -> _Pose:
        """Return the pose after a step on a clothoid: Taylor series of cos and sin of the yaw, with their remainder."""
        yaw = (rate * step * 0.5 + bend) * step + self.yaw
        (c, s), before, (x, y), power, n = self.yaw.turned(1.0, 0.0), (_ZERO, _ZERO), (_ZERO, _ZERO), step, 1.0
        most, bound, bound0 = step * rate.size + bend.size, _Span(1.0), _ZERO
        while (bound * power).hi > 1e-16 and gear != 0.0:  # this product bounds the rest of both series
            _hold(n < 60.0, "cells: a cell turns too far")
            x, y, power = x + c * power / n, y + s * power / n, power * step
            c0, s0, before = *before, (c, s)
            c, s = _ZERO - (bend * s + rate * s0) / n, (bend * c + rate * c0) / n
            bound, bound0, n = (most * bound + bound0 * rate.size) / n, bound, n + 1.0
        rest = _Span(-(bound * power).hi, (bound * power).hi)
        return _Pose(self.x + (x + rest) * gear, self.y + (y + rest) * gear, yaw)


class _Segment:
    """Clothoids driven in one gear, or a turn in place, whose coordinate is its angle and whose gear is 0 (G3)."""

    def __init__(self, curve: dict[str, Any], name: str) -> None:
        _hold("poses" not in curve and ("turn" in curve) != ("knots" in curve), f"{name}: no clothoids and no turn")
        self.name, (x, y, yaw), turn = name, curve["start"], curve.get("turn")
        if turn is not None:
            curve = {"direction": 0.0, "knots": [0.0, abs(turn)], "curvature": [math.copysign(1.0, turn)] * 2}
        numbers: tuple[float, list[float], list[float]] = curve["direction"], curve["knots"], curve["curvature"]
        self.gear, self.knots, self.bends = numbers
        _hold(self.knots[0] == 0.0 and all(a < b for a, b in pairwise(self.knots)), f"{name}: knots must rise from 0")
        _hold(turn is not None or self.gear in (1.0, -1.0), f"{name}: the direction must be 1 or -1")
        pieces = zip(pairwise(self.knots), pairwise(self.bends), strict=True)
        self.rates: list[_Span] = [(_Span(m) - k) / (_Span(b) - a) for (a, b), (k, m) in pieces]
        self.start, self.length = _Pose(_Span(x), _Span(y), _Span(yaw)), _Span(self.knots[-1])

    def bend_at(self, index: int, place: _Span) -> _Span:
        return self.rates[index] * (place - self.knots[index]) + self.bends[index]

    def cells(self, borders: list[float]) -> list[tuple[Any, ...]]:
        """Return poses, velocity in the middle, bounds (C4) and half widths of the cells between all the borders."""
        whole = borders[0] == self.knots[0] and borders[-1] == self.knots[-1] and set(self.knots) <= set(borders)
        _hold(whole and all(a < b for a, b in pairwise(borders)), f"cells: they do not cover {self.name} in order")
        found, pose, index = [], self.start, 0
        for u, v in pairwise(borders):
            index += u >= self.knots[index + 1]
            middle, rate = 0.5 * (u + v), self.rates[index]
            bends = [self.bend_at(index, _Span(place)) for place in (u, middle, v)]
            at, end = (pose.after(_Span(to) - u, bends[0], rate, self.gear) for to in (middle, v))
            velocity, most = (*at.yaw.turned(self.gear, 0.0), bends[1]), _Span(max(bend.size for bend in bends))
            half = max((_Span(middle) - u).hi, (_Span(v) - middle).hi)
            found.append(
                ((pose, at, end), velocity, most * abs(self.gear), most * most + rate.size, _Span(-half, half))
            )
            pose = end
        return found


class _Clearance:
    """The footprint, the obstacles, and the required clearance (C2), (C22) with the tracking tube (C17)."""

    def __init__(self, proof: dict[str, Any]) -> None:
        robot, rule, (x, y, yaw) = proof["robot"], proof["clearance"], proof["start"]["pose"]
        self.ends, outline = [proof["dock"]["pose"], proof["start"]["pose"]], robot["footprint"]
        self.region, rocks, pieces = proof["region"], proof["obstacles"], robot.get("pieces") or [outline]
        self.obstacles, shapes = ([[(_Span(x), _Span(y)) for x, y in one] for one in some] for some in (rocks, pieces))
        self.arms = [[(px, py, _Span(_length(px, py))) for px, py in shape] for shape in shapes]
        edges: dict[Any, int] = {}
        for sign, ring in ((1, outline), *((-1, piece) for piece in pieces)):
            for a, b in pairwise([(px, py) for px, py in [*ring, ring[0]]]):
                edges[min(a, b), max(a, b)] = edges.get((min(a, b), max(a, b)), 0) + sign * ((a < b) - (a > b))
        # Inner edges cancel, so winding numbers agree: a point inside the outline is inside the hull of a piece.
        _hold(not any(edges.values()), "footprint: its convex pieces do not cover it")
        self.boxes = [[_Span.around([point[k] for point in rock]) for k in (0, 1)] for rock in self.obstacles]
        numbers: list[float] = [rule[name] for name in ("required", "at_dock", "taper", "dock_run", "start_relief")]
        most, self.at_dock, self.taper, self.run, self.relief = numbers
        self.at_start, (e, w) = rule["at_start"], robot["tracking"]
        least = min(*numbers, self.at_start or 0.0, e, w)
        _hold(least >= 0.0 and most >= max(self.at_dock, self.at_start or 0.0) and w <= math.pi, "clearance: bad rule")
        radius, length = max(_length(_Span(px), _Span(py)) for px, py in outline), [px for px, _ in outline]
        self.most: float = (_Span(0.5 * w).turned(2.0 * radius, 0.0)[1] + e + most).hi if e or w else most  # (C17)
        bodies = [[((p + x).lo, (q + y).lo) for p, q in (_Span(yaw).turned(*at) for at in one)] for one in shapes]
        # The clearance of the start is at most the length of some line to an obstacle, up to rounding.
        gaps = [min(_gap(body, rock), _gap(rock, body)) for body in bodies for rock in rocks]
        self.kept: float = min(gaps, default=1e9) + 1e-14 * (radius + abs(x) + abs(y))
        eased = self.relief <= 2.0 * (max(length) - min(length)) * _WIDE and self.kept < self.most
        _hold(self.relief == 0.0 or eased, "clearance: start_relief is not allowed (C22)")

    def _tapered(self, distance: float, least: float) -> float:  # an upper bound of D in (C2)
        beyond = (_Span(distance) - self.run).hi - 1e-9  # a rounded distance; with a taper of 0 the rule jumps
        if not 0.0 < beyond < self.taper:
            return least if beyond <= 0.0 else self.most
        return (_Span(beyond) / self.taper * (_Span(self.most) - least) + least).hi

    def needed(self, first: _Pose, last: _Pose, sag: _Span) -> float:
        """Return an upper bound of the requirement in a cell, from its largest distances from dock and start (C7)."""
        dock, start = ((sag + max(_length(at.x - x, at.y - y) for at in (first, last))).hi for x, y, _ in self.ends)
        kept = max(self.kept - 0.005, 0.5 * self.kept) if self.relief else self.kept  # (C22), else (C2)
        leaving = (_Span(max(0.0, (_Span(start) - self.relief).hi)) * 0.5 + kept).hi
        eased = self._tapered(start, self.at_start) if self.relief and self.at_start is not None else math.inf
        return min(self._tapered(dock, self.at_dock), leaving, eased)

    def check(self, cell: tuple[Any, ...], planes: list[Any], where: str) -> None:
        """Check (C8) in a cell: from its middle, every corner of the footprint moves as in (C5)."""
        (first, at, last), (vx, vy, turn), bend, twist, half = cell
        square, named = half * half * 0.5, {(o, p): _Span(angle) for o, p, angle in planes}
        need = (_Span(self.needed(first, last, bend * square)) - TOLERANCE).hi
        reach, (x0, y0, x1, y1) = _Span(-max(need, 0.0), max(need, 0.0)), self.region

        def clear(i: int, number: int, body: list[Any], least: float) -> bool:  # (C5), along a direction of the file
            nx, ny = named[i, number].turned(1.0, 0.0)
            near = min((nx * x + ny * y + (nx * u + ny * v) * half + e).lo for x, y, u, v, e in body)
            return bool((_Span(near) - max((nx * x + ny * y).hi for x, y in self.obstacles[i])).lo >= least)

        c, s = at.yaw.turned(1.0, 0.0)  # then for every corner v and v' of (C4), and M d^2 / 2 of (C5)
        arms = [[(c * px - s * py, s * px + c * py, twist * r + bend) for px, py, r in arm] for arm in self.arms]
        pieces = [[(at.x + x, at.y + y, vx - turn * y, vy + turn * x, m * square) for x, y, m in arm] for arm in arms]
        for number, corners in enumerate(pieces):
            wide, high = (_Span.around([c[k] + c[k + 2] * half + c[4] + reach for c in corners]) for k in (0, 1))
            inside = x0 <= wide.lo and y0 <= high.lo and wide.hi <= x1 and high.hi <= y1
            _hold(inside, f"clearance: the robot leaves the region {where}")
            for i, (u, v) in enumerate(self.boxes):
                if u.lo > wide.hi or u.hi < wide.lo or v.lo > high.hi or v.hi < high.lo:
                    continue
                _hold((i, number) in named, f"clearance: no direction for obstacle {i} and piece {number} {where}")
                # A piece may overlap by the tolerance only along a direction in which the whole footprint does.
                far = clear(i, number, corners, max(need, 1e-12)) or clear(i, number, [*chain(*pieces)], need)
                _hold(far, f"clearance: obstacle {i} is too close {where}")  # (C8)


def _gap(corners: list[Any], ring: list[Any]) -> float:
    best = math.inf  # distance of corners from the edges of a ring, up to rounding
    for (ax, ay), (bx, by) in pairwise([*ring, ring[0]]):
        dx, dy, square = bx - ax, by - ay, (bx - ax) * (bx - ax) + (by - ay) * (by - ay)
        for px, py in corners:
            t = min(1.0, max(0.0, ((px - ax) * dx + (py - ay) * dy) / square)) if square > 0.0 else 0.0
            best = min(best, math.hypot(px - ax - t * dx, py - ay - t * dy))
    return best


def _check_path(segments: list[_Segment], ends: list[_Pose], proof: dict[str, Any]) -> None:
    """Check the path rules of (C1): ends, joints, gears, turns, curvature, final straight."""
    start, dock, limits = proof["start"], proof["dock"], proof["robot"]["limits"]
    first, last, driven = segments[0], segments[-1], [one for one in segments if one.gear != 0.0]
    gaps = [_Span(a.gap_to(b.start)) for a, b in zip(ends[:-1], segments[1:], strict=True)]
    _hold(first.start.gap_to(_Pose(*map(_Span, start["pose"]))) <= TOLERANCE, "start: the path does not begin there")
    _hold(ends[-1].gap_to(_Pose(*map(_Span, dock["pose"]))) <= TOLERANCE, "goal: the path does not end there")
    _hold(sum(gaps, _ZERO).hi <= TOLERANCE, "joint: the path jumps between its segments")
    _hold(proof["robot"]["turning"] is not None or len(driven) == len(segments), "turn: the robot cannot turn")
    _hold(first in driven or start["speed"] == start["acceleration"] == 0.0, "turn: the robot begins at speed")
    orders = [(order, accumulate(one.length.lo for one in order)) for order in (driven, driven[::-1])]
    begun, ended = (next((one.gear for one, s in zip(*order, strict=True) if s > TOLERANCE), 0.0) for order in orders)
    _hold(ended != {"forward": -1, "backward": 1, "auto": None}[dock["direction"]], "direction: the gear at the dock")
    _hold(begun * start["speed"] >= 0.0, "direction: the robot moves in the other gear")
    for one in driven:
        most, rate = max(map(abs, one.bends)), max(rate.size for rate in one.rates)
        _hold(most <= limits["max_curvature"] * _WIDE, f"curvature: {most:g} 1/m on {one.name}")
        _hold(rate <= limits["max_curvature_rate"] * _WIDE, f"curvature_rate: {rate:g} 1/m^2 on {one.name}")
    if first in driven and start["curvature"] is not None:
        _hold(abs(first.bends[0] - start["curvature"]) <= TOLERANCE, "start_curvature: differs from that of the start")
    if (wanted := dock["final_straight"]) > 0.0:
        _hold(last in driven and last.length.lo >= wanted - TOLERANCE, "final_straight: the last gear is too short")
        begin, place = (max(0.0, last.length.lo - wanted) + d for d in (0.0, 1e-9))  # a rounded knot is no curvature
        far, near = (max(i for i, knot in enumerate(last.knots[:-1]) if knot <= at) for at in (begin, place))
        bends = [last.bend_at(near, _Span(min(place, last.length.lo))).size, *map(abs, last.bends[near + 1 :])]
        turns = [last.bend_at(far, _Span(begin)).size, *map(abs, last.bends[far + 1 : near + 1])]
        _hold(max(bends) <= TOLERANCE >= 1e-9 * max(turns), "final_straight: it bends")


class _Polynomial:  # in time, with intervals as coefficients, the constant one first
    def __init__(self, *terms: _Span) -> None:
        self.terms = terms

    def __add__(self, other: _Polynomial) -> _Polynomial:
        return _Polynomial(*(a + b for a, b in zip_longest(self.terms, other.terms, fillvalue=_ZERO)))

    def __mul__(self, other: _Polynomial) -> _Polynomial:
        terms = [_ZERO] * (len(self.terms) + len(other.terms) - 1)
        for (i, a), (k, b) in product(enumerate(self.terms), enumerate(other.terms)):
            terms[i + k] = terms[i + k] + a * b
        return _Polynomial(*terms)

    def over(self, width: float) -> _Span:
        """Return its range on [0, width], which lies between its Bernstein coefficients."""
        n = len(self.terms) - 1
        powers = [*accumulate([_Span(width)] * n, _Span.__mul__, initial=_Span(1.0))]
        row = [term * powers[k] / float(math.comb(n, k)) for k, term in enumerate(self.terms)]
        return _Span.around([sum((row[k] * float(math.comb(i, k)) for k in range(i + 1)), _ZERO) for i in range(n + 1)])


class _Motion:
    """The time law: phases of constant jerk; every segment has those between the rests at its ends (C14)."""

    def __init__(self, proof: dict[str, Any], segments: list[_Segment], phases: dict[str, Any]) -> None:
        self.limits, self.segments, dock, start = proof["robot"]["limits"], segments, proof["dock"], proof["start"]
        self.begins = [*accumulate((one.length for one in segments), _Span.__add__, initial=_ZERO)]
        (s, v, a), self.phases = phases["start"], [*zip(phases["durations"], phases["jerks"], strict=True)]
        self.states, self.budget = [(_Span(s), _Span(v), _Span(a))], iter(range(10_000, 0, -1))  # of divisions
        for duration, jerk in self.phases:
            _hold(duration >= 0.0, "coverage: a duration is negative")
            self.states.append(_after(self.states[-1], jerk, duration))
        sign = math.copysign(1.0, start["speed"]) if start["speed"] else segments[0].gear or 1.0
        off = max(abs(s), abs(v - abs(start["speed"])), abs(a - sign * start["acceleration"]))
        _hold(off <= TOLERANCE, "start_state: place, speed or acceleration differ from those of the start")
        self.zone, self.slow = self.begins[-1] - dock["approach_distance"], dock.get("approach_speed", math.inf)
        for one, at in zip(segments[::-1], self.begins[:0:-1], strict=True):
            self.zone = self.zone - one.length if one.gear == 0.0 and at.hi > self.zone.lo else self.zone
        rate, gain, jerk = proof["robot"]["turning"] or (0.0, 0.0, 0.0)  # limits of turns in place (G3)
        turning = {"max_reverse_speed": rate, "max_acceleration": gain, "max_deceleration": gain, "max_jerk": jerk}
        self.turning = {**dict.fromkeys(self.limits, math.inf), "track_width": 0.0, "wheelbase": 0.0, **turning}

    def check(self) -> float:
        """Check rests (C14) and every limit over the whole motion; return its duration [s]."""
        rests = [(s, k) for k, (s, v, a) in enumerate(self.states) if max(v.size, a.size) <= TOLERANCE]
        # A segment has the phases between the rests nearest to its ends, even if these are almost one place.
        near = [min((((s - place).size, k) for s, k in rests), default=(math.inf, -1)) for place in self.begins[1:-1]]
        near += [((s - self.begins[-1]).size, k) for s, k in rests if k == len(self.phases)] or [(math.inf, -1)]
        cuts = [0, *(k for _, k in near)]
        _hold(max(near)[0] <= TOLERANCE and cuts == sorted(cuts), f"rest: none at the end of a segment, {cuts}")
        for i, (first, last) in enumerate(pairwise(cuts)):
            parts = [(state, *phase) for state, phase in zip(self.states, self.phases, strict=False)][first:last]
            while parts:  # divided until every limit is proven
                state, width, jerk = parts.pop()
                if broken := self._broken(i, state, jerk, width):
                    _hold(width > 1e-9 < next(self.budget, 0), f"{broken}: beyond its limit at s = {state[0].lo:.3f} m")
                    parts += [(at, 0.5 * width, jerk) for at in (state, _after(state, jerk, 0.5 * width))]
        return math.fsum(t for t, _ in self.phases)

    def _broken(self, i: int, state: tuple[_Span, _Span, _Span], jerk: float, width: float) -> str:
        """Return the first limit that is not proven on a part of a phase."""
        one, (s, v, a), j = self.segments[i], state, _Span(jerk)
        here, knots, n = s - self.begins[i], one.knots, len(one.rates)
        place, speed = _Polynomial(here, v, a * 0.5, j / 6.0), _Polynomial(v, a, j * 0.5)
        at = place.over(width)
        inside = [k for k in range(n) if not ((k and knots[k] > at.hi) or (k < n - 1 and knots[k + 1] < at.lo))]
        ramp = _Span.around([one.rates[k] for k in inside])
        if len(inside) == 1:
            bend = _Polynomial(one.bend_at(inside[0], here), ramp * v, ramp * a * 0.5, ramp * j / 6.0)
        else:
            parts = {k: _Span(*(min(max(end, knots[k]), knots[k + 1]) for end in (at.lo, at.hi))) for k in inside}
            bend = _Polynomial(_Span.around([one.bend_at(k, part) for k, part in parts.items()]))
        top = self.slow if one.gear and (at + self.begins[i]).hi > self.zone.lo else math.inf
        limited = self._quantities(one, top, (speed, _Polynomial(a, j), bend, _Polynomial(ramp)))
        every = [("place", place, -2e-6, knots[-1] + 2e-6), *limited]
        ranges = ((name, terms.over(width), least * _WIDE, most * _WIDE) for name, terms, least, most in every)
        return next((name for name, found, least, most in ranges if not least <= found.lo <= found.hi <= most), "")

    def _quantities(self, one: _Segment, top: float, motion: tuple[_Polynomial, ...]) -> list[Any]:
        """Return each limited quantity with its bounds: those of (C13) and of the table after (C12), or of (G3)."""
        (v, a, k, r), limits = motion, self.limits if one.gear else self.turning
        lever, base, steep = 0.5 * limits["track_width"], limits["wheelbase"], limits["max_steering_rate"]
        slack = k * k * _Polynomial(_Span(base) * base * -min(steep, 1e9))
        symmetric = [
            ("max_jerk", _Polynomial(a.terms[1])),
            ("max_yaw_rate", v * k),
            ("max_yaw_acceleration", a * k + v * v * r),
            ("max_lateral_acceleration", v * v * k),
            ("max_lateral_jerk", v * (a * k + a * k + v * v * r)),
            *(("max_wheel_speed", v + v * k * _Polynomial(_Span(side))) for side in (lever, -lever)),
        ]
        return [
            ("speed", v, -TOLERANCE, min(top, limits["max_speed" if one.gear > 0.0 else "max_reverse_speed"])),
            ("acceleration", a, -limits["max_deceleration"], limits["max_acceleration"]),
            *((name, terms, -limits[name], limits[name]) for name, terms in symmetric),
            # Steering rate: |base * r * v| <= steep * (1 + (base * k)^2)
            *(("steering_rate", v * r * _Polynomial(_Span(side)) + slack, -math.inf, steep) for side in (base, -base)),
        ]


def _after(state: tuple[_Span, _Span, _Span], jerk: float, t: float) -> tuple[_Span, _Span, _Span]:
    (s, v, a), gain = state, _Span(jerk) * t  # after a time t of constant jerk
    return s + (v + (a * 0.5 + gain / 6.0) * t) * t, v + (a + gain * 0.5) * t, a + gain


def judge(text: str) -> str:
    """Return a sentence about what was accepted and what was not judged; raise `Refusal` if a rule is not proven."""
    numbers: Any = dict.fromkeys(("parse_int", "parse_float", "parse_constant"), lambda digits: _Span(float(digits)).lo)
    once = lambda pairs: _hold(len(dict(pairs)) == len(pairs), "JSON: a key is repeated") and dict(pairs)  # noqa: E731
    plan: Any = json.loads(text, object_pairs_hook=once, **numbers)
    proof, motion, limits = plan["proof"], plan.get("trajectory"), plan["proof"]["robot"]["limits"]
    known = (name in _LIMITS and type(most) is float and most >= 0.0 for name, most in limits.items())
    _hold(all(known), f"limits: no rule for one of {sorted(limits)}, or no number >= 0")
    proof["robot"]["limits"] = {**dict.fromkeys(_LIMITS, math.inf), "wheelbase": 0.0, "track_width": 0.0, **limits}
    segments, ends = [_Segment(curve, f"segment {i}") for i, curve in enumerate(plan["path"]["segments"])], []
    clearance, cells = _Clearance(proof), proof["cells"]
    _hold(0 < len(segments) == len(cells), "cells: every segment needs its own")
    for segment, part in zip(segments, cells, strict=True):
        found = segment.cells(part["borders"])
        for k, (cell, planes) in enumerate(zip(found, part["planes"], strict=True)):
            clearance.check(cell, planes, f"in cell {k} of {segment.name}")
        ends.append(found[-1][0][2])
    _check_path(segments, ends, proof)
    timed = "no motion" if motion is None else f"{_Motion(proof, segments, motion['phases']).check():.3f} s of motion"
    left = "samples, raw_path, certificate, view of the dock, steering at rest, and whether this is the real problem"
    return f"accepted: path among {len(clearance.obstacles)} obstacles, {timed}; not judged: {left}"


def main(arguments: list[str] | None = None) -> int:
    """Judge the file that is named on the command line; return the exit status."""
    try:
        status, said = 0, judge(Path((arguments or sys.argv[1:])[0]).read_text(encoding="utf-8"))
    except Refusal as error:
        status, said = 3, f"refused: {error}"
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError, OverflowError) as error:
        status, said = 2, f"not a plan file with a proof: {type(error).__name__}: {error}"
    (sys.stderr if status else sys.stdout).write(f"{said}\n")
    return status


if __name__ == "__main__":
    sys.exit(main())
