"""From a reference to the exact motion: ruckig moves between its knots, as few as the limits allow.

Level by level every open piece of the reference is tried as one move; a piece whose move breaks a limit is split at
the knot nearest the worst place. Between two neighbouring knots the reference itself shows that a move exists.
"""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.deadline import never_late
from optdock.timing.allowance import look
from optdock.timing.motion import Phases, State
from optdock.timing.moves import Box, move
from optdock.timing.smooth import cell_phases

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.geometry.arrays import FloatArray, IntArray
    from optdock.timing.bounds import Bounds
    from optdock.timing.reference import Reference

__all__ = ["Nodes", "Piece", "Split", "nodes_of", "split_into_moves"]

_SAMPLE = 0.02  # [s]
_CRAWL = 1e-3  # [m/s]: speeds below it break no limit
_GENTLE_BELOW = 1.5  # [s]: shorter pieces are tried with the reference's own jerk and acceleration first
_LONGEST = (1.2, 0.05)  # a move may take this factor and this time [s] more than the reference
_LEVEL = 0.8  # of the largest v^2: where the cap stays above, one move may do for any length
_MIDDLE, _SHORT = 16, 6  # cells: longer pieces are cut in parts of at most 16 cells, or in four, at once


class Nodes(NamedTuple):
    """States between which moves are made: both ends of the gear and the knots between.

    Attributes:
        s: Distances, Shape (n,) [m].
        v: Speeds [m/s].
        a: Accelerations [m/s^2].
        time: Reference time [s].
        jerk: Largest |jerk| of the reference in the n - 1 cells [m/s^3].
        zone: Index of the node at the zone start; 0 without one inside.
    """

    s: list[float]
    v: list[float]
    a: list[float]
    time: list[float]
    jerk: list[float]
    zone: int

    def state(self, i: int) -> State:
        """The state at node `i`."""
        return State(self.s[i], self.v[i], self.a[i])


class Piece(NamedTuple):
    """A stretch of nodes that one move drives.

    Args:
        first: Index of the node at its start.
        last: Index of the node at its end.
        phases: The move.
        excess: By how much time would have to be stretched for the checked limits to hold; at most 1 when accepted.
        worst: Where that is decided [m].
    """

    first: int
    last: int
    phases: Phases
    excess: float
    worst: float


class Split(NamedTuple):
    """Moves over a whole gear.

    Args:
        pieces: In driving order; together they cover all nodes.
    """

    pieces: list[Piece]

    @property
    def phases(self) -> Phases:
        """All moves in order."""
        return tuple(phase for piece in self.pieces for phase in piece.phases)


def nodes_of(reference: Reference, start: State, end: State, arcs: tuple[float, float], zone: int) -> Nodes:
    """Nodes of a reference between a start and an end state.

    Args:
        reference: The spline.
        start: State at the start of the gear.
        end: State at its end, at rest.
        arcs: Durations of the launch and the stop arc [s]; no launch where 0.
        zone: Knot at the zone start, or 0.
    """
    s, v, a = reference.s, reference.v, reference.a
    steps = 2.0 * np.diff(s) / (v[:-1] + v[1:])
    jerk = 0.5 * np.abs(reference.curve) * np.maximum(v[:-1], v[1:])
    head = [0.0] if arcs[0] > 0.0 else []
    columns = ([*(value for _ in head), *column.tolist()] for value, column in zip(start, (s, v, a), strict=True))
    s_all, v_all, a_all = ([*column, value] for column, value in zip(columns, end, strict=True))
    durations = [*arcs[: len(head)], *steps.tolist(), arcs[1]]
    jerks = [*(np.inf for _ in head), *jerk.tolist(), np.inf]
    times = list(itertools.accumulate(durations, initial=0.0))
    return Nodes(s_all, v_all, a_all, times, jerks, zone + len(head) if zone else 0)


def split_into_moves(nodes: Nodes, bounds: Bounds, is_late: Callable[[], bool] = never_late) -> Split:
    """The moves that drive the reference within the checked limits, wherever there are such.

    Raises:
        OutOfTime: `is_late` said so.
    """
    active = _first_pieces(nodes, bounds)
    done: list[Piece] = []
    while active:
        tried = _try_pieces(nodes, bounds, active, is_late)
        active = []
        for (i, j), best in tried.items():
            if best is not None and (best.excess <= 1.0 or j - i == 1):
                done.append(best)
            else:
                active.extend(_parts(nodes, (i, j), best))
    return Split(sorted(done))


def _first_pieces(nodes: Nodes, bounds: Bounds) -> list[tuple[int, int]]:
    """Before and after the zone start; at most `_MIDDLE` cells each where the speed cap changes on the way."""
    last = len(nodes.s) - 1
    halves = [(0, nodes.zone), (nodes.zone, last)] if 0 < nodes.zone < last else [(0, last)]
    pieces: list[tuple[int, int]] = []
    for i, j in halves:
        cells = slice(*np.searchsorted(bounds.course.s, (nodes.s[i] + 1e-9, nodes.s[j] - 1e-9)))
        cap = bounds.speed_squared[cells]
        level = cap.size == 0 or float(cap.min()) > _LEVEL * float(cap.max())
        pieces.extend([(i, j)] if level else _equal_parts(i, j, -(-(j - i) // _MIDDLE)))
    return pieces


def _equal_parts(i: int, j: int, count: int) -> list[tuple[int, int]]:
    return list(itertools.pairwise(i + (j - i) * n // count for n in range(count + 1)))


def _parts(nodes: Nodes, ends: tuple[int, int], tried: Piece | None) -> list[tuple[int, int]]:
    """A long piece in equal parts, a short one in two at the knot nearest to where it is worst."""
    i, j = ends
    cells = j - i
    if cells > _SHORT or tried is None:
        count = -(-cells // _MIDDLE) if cells > _MIDDLE else 4 if cells > _SHORT else 2
        return _equal_parts(i, j, count)
    s, worst = nodes.s, tried.worst
    middle = min(range(i + 1, j), key=lambda n: abs(s[n] - worst))
    return [(i, middle), (middle, j)]


def _full_move(nodes: Nodes, bounds: Bounds, i: int, j: int) -> Phases | None:
    """The time-optimal move between two nodes, unless it makes a long detour."""
    limits = bounds.course.limits
    box = Box(max(nodes.v[i : j + 1]), limits.max_acceleration, limits.max_deceleration, limits.max_jerk)
    return _short_enough(nodes, i, j, box)


def _gentle_move(nodes: Nodes, bounds: Bounds, i: int, j: int) -> Phases | None:
    """A move with hardly more jerk and acceleration than the reference: it follows a stretch that rides its cap."""
    if i == 0 or j == len(nodes.s) - 1 or nodes.time[j] - nodes.time[i] > _GENTLE_BELOW:
        return None
    limits = bounds.course.limits
    jerk = 1.05 * max(nodes.jerk[i:j]) + 0.01 * limits.max_jerk
    if jerk > 0.95 * limits.max_jerk:
        return None
    accelerations = nodes.a[i : j + 1]
    rise = min(limits.max_acceleration, 1.04 * max(accelerations) + 0.04 * limits.max_acceleration)
    fall = min(limits.max_deceleration, -1.04 * min(accelerations) + 0.04 * limits.max_deceleration)
    least = 0.01 * limits.max_acceleration
    return _short_enough(nodes, i, j, Box(max(nodes.v[i : j + 1]), max(rise, least), max(fall, least), jerk))


def _reference_motion(nodes: Nodes, i: int) -> Phases:
    """The motion of the reference in one cell."""
    return cell_phases(*(np.array(column[i : i + 2]) for column in (nodes.s, nodes.v, nodes.a)))


def _short_enough(nodes: Nodes, i: int, j: int, box: Box) -> Phases | None:
    return move(nodes.state(i), nodes.state(j), box, _LONGEST[0] * (nodes.time[j] - nodes.time[i]) + _LONGEST[1])


def _try_pieces(
    nodes: Nodes, bounds: Bounds, active: list[tuple[int, int]], is_late: Callable[[], bool]
) -> dict[tuple[int, int], Piece | None]:
    """The best move of every piece; the time-optimal one only where the gentle one is missing or the last hope.

    A single cell without a move, by rounding, is driven as the reference drives it.
    """
    moves: list[tuple[tuple[int, int], Phases]] = []
    for i, j in active:
        look(is_late)
        gentle = _gentle_move(nodes, bounds, i, j)
        full = None if gentle and j - i > 1 else _full_move(nodes, bounds, i, j)
        own = _reference_motion(nodes, i) if j - i == 1 and not (gentle or full) else None
        moves.extend(((i, j), phases) for phases in (gentle, full, own) if phases)
    found = _evaluate(bounds, [(nodes.state(ends[0]), phases) for ends, phases in moves])
    best: dict[tuple[int, int], Piece | None] = dict.fromkeys(active)
    for (ends, phases), (excess, worst) in zip(moves, found, strict=True):
        known = best[ends]
        if known is None or (known.excess > 1.0 and excess < known.excess):
            best[ends] = Piece(*ends, phases, excess, worst)
    return best


def _evaluate(bounds: Bounds, moves: list[tuple[State, Phases]]) -> list[tuple[float, float]]:
    """Largest excess of every move and where it is; all moves at once."""
    if not moves:
        return []
    phases, counts = _phase_rows(moves)
    number_of = phases[:, 5].astype(np.int64)
    owner = np.repeat(np.arange(number_of.size), number_of)
    first = np.cumsum(number_of) - number_of
    duration, jerk, s, v, a, number = phases[owner].T
    t = (np.arange(owner.size) - first[owner]) * (duration / number)  # the end of a move is a knot
    half = 0.5 * t * jerk
    distance = np.minimum(np.maximum(s + t * (v + t * (0.5 * a + half / 3.0)), 0.0), bounds.course.length)
    begins = first[np.cumsum(counts) - counts]
    samples = _Samples(distance, v + t * (a + half), a + t * jerk, jerk, begins)
    excess = bounds.excess_at(samples.s, samples.v, samples.a)
    if bounds.jumps.size:
        _add_jumps(bounds, samples, excess)
    worst = np.maximum.reduceat(excess, samples.begins)
    at_worst = np.flatnonzero(excess >= worst[samples.owners])
    place = np.empty(worst.size)
    place[samples.owners[at_worst]] = distance[at_worst]
    return list(zip(worst.tolist(), place.tolist(), strict=True))


class _Samples(NamedTuple):
    """States along some moves, one after the other; `begins` holds the index of the first of each."""

    s: FloatArray
    v: FloatArray
    a: FloatArray
    jerk: FloatArray
    begins: IntArray

    @property
    def owners(self) -> IntArray:
        """Which move each sample belongs to."""
        return np.repeat(np.arange(self.begins.size), np.diff(np.append(self.begins, self.s.size)))

    def reached(self, before: IntArray, s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Speed and acceleration at distances `s` soon after the samples `before`; two Newton steps for the time."""
        v, a, jerk = self.v[before], self.a[before], self.jerk[before]
        gap = s - self.s[before]
        t = gap / np.maximum(v, _CRAWL)
        for _ in range(2):
            speed = v + t * (a + 0.5 * t * jerk)
            miss = t * (v + t * (0.5 * a + t * jerk / 6.0)) - gap
            t = np.clip(t - miss / np.maximum(speed, _CRAWL), 0.0, _SAMPLE)
        return v + t * (a + 0.5 * t * jerk), a + t * jerk


def _add_jumps(bounds: Bounds, samples: _Samples, excess: FloatArray) -> None:
    """Raise the excess at the samples before jumps of the curvature rate to what it is at the jumps."""
    places = bounds.course.s[bounds.jumps]
    ends = np.append(samples.begins[1:], samples.s.size) - 1
    first = np.searchsorted(places, samples.s[samples.begins])
    count = np.maximum(np.searchsorted(places, samples.s[ends], side="right") - first, 0)
    owner = np.repeat(np.arange(count.size), count)
    index = first[owner] + np.arange(owner.size) - (np.cumsum(count) - count)[owner]
    stride = 2.0 * bounds.course.length  # moves overlap; shifted apart they make one increasing sequence
    key = samples.s + stride * samples.owners
    before = np.maximum(np.searchsorted(key, places[index] + stride * owner) - 1, samples.begins[owner])
    v, a = samples.reached(before, places[index])
    np.maximum.at(excess, before, bounds.jump_excess_at(bounds.jumps[index], v, a))


def _phase_rows(moves: list[tuple[State, Phases]]) -> tuple[FloatArray, FloatArray]:
    """Duration, jerk, s, v, a and number of samples of every phase, and the number of phases of every move."""
    rows: list[tuple[float, float, float, float, float, int]] = []
    for start, phases in moves:
        s, v, a = start
        for duration, jerk in phases:
            rows.append((duration, jerk, s, v, a, 1 + int(duration / _SAMPLE)))
            gain = duration * jerk
            s, v, a = (
                s + duration * (v + duration * (0.5 * a + gain / 6.0)),
                v + duration * (a + 0.5 * gain),
                a + gain,
            )
    return np.array(rows), np.array([len(phases) for _start, phases in moves])
