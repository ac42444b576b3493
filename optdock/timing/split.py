"""From a reference to the exact motion: ruckig moves between its knots, as few as the limits allow.

Level by level every open piece of the reference is tried as one move; a piece whose moves break a limit is split at
the knot nearest the worst place. Between two neighbouring knots the reference itself shows that a move exists.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.timing.motion import Phases, State
from optdock.timing.moves import Box, move

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from optdock.timing.bounds import Bounds
    from optdock.timing.reference import Reference

__all__ = ["Nodes", "Split", "nodes_of", "split_into_moves"]

_SAMPLE = 0.02  # [s]
_GENTLE_BELOW = 1.5  # [s]: shorter pieces are also tried with the reference's own jerk and acceleration
_LONGEST = (1.2, 0.05)  # a move may take this factor and this time [s] more than the reference
_SHIFTS = (0, 1, -1, 2, -2, 3, -3)


class Nodes(NamedTuple):
    """States between which moves are made: both ends of the gear and the knots between.

    Attributes:
        states: One per node.
        time: Reference time at the nodes, Shape (n,) [s].
        jerk: Largest |jerk| of the reference in the cell to the right, Shape (n - 1,) [m/s^3].
        zone: Index of the node at the zone start; 0 without one inside.
    """

    states: list[State]
    time: FloatArray
    jerk: FloatArray
    zone: int


class Piece(NamedTuple):
    """A stretch of nodes that one move drives.

    Args:
        first: Index of the node at its start.
        last: Index of the node at its end.
        phases: The move.
        excess: By how much time would have to be stretched for the checked limits to hold; at most 1 when accepted.
    """

    first: int
    last: int
    phases: Phases
    excess: float


class Split(NamedTuple):
    """Moves over a whole gear.

    Args:
        pieces: In driving order; together they cover all nodes.
        complete: False where a cell has no move at all.
    """

    pieces: list[Piece]
    complete: bool

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
        arcs: Durations of the launch and the stop arc [s]; none where 0.
        zone: Knot at the zone start, or 0.
    """
    states = [State(*row) for row in zip(reference.s.tolist(), reference.v.tolist(), reference.a.tolist(), strict=True)]
    steps = 2.0 * np.diff(reference.s) / (reference.v[:-1] + reference.v[1:])
    jerk = 0.5 * np.abs(reference.curve) * np.maximum(reference.v[:-1], reference.v[1:])
    if arcs[0] > 0.0:
        states, steps, jerk = [start, *states], np.insert(steps, 0, arcs[0]), np.insert(jerk, 0, np.inf)
    states, steps, jerk = [*states, end], np.append(steps, arcs[1]), np.append(jerk, np.inf)
    shift = 1 if arcs[0] > 0.0 else 0
    return Nodes(states, np.concatenate(([0.0], np.cumsum(steps))), jerk, zone + shift if zone else 0)


def split_into_moves(nodes: Nodes, bounds: Bounds) -> Split:
    """The moves that drive the reference within the checked limits, wherever there are such."""
    last = len(nodes.states) - 1
    active = [(0, nodes.zone), (nodes.zone, last)] if 0 < nodes.zone < last else [(0, last)]
    done: list[Piece] = []
    complete = True
    while active:
        tried = _try_pieces(nodes, bounds, active)
        active = []
        for (i, j), best, worst in tried:
            if best is not None and best.excess <= 1.0:
                done.append(best)
            elif j - i > 1:
                active.extend(_halves(nodes, bounds, (i, j), worst))
            elif best is not None:
                done.append(best)
            else:
                complete = False
    return Split(sorted(done), complete)


def _halves(nodes: Nodes, bounds: Bounds, piece: tuple[int, int], worst: float) -> list[tuple[int, int]]:
    """Both parts of a piece, cut near `worst` [m] where possible so that both parts have a move."""
    i, j = piece
    if np.isfinite(worst):
        middle = min(range(i + 1, j), key=lambda n: abs(nodes.states[n].s - worst))
    else:
        middle = (i + j) // 2
    for shift in _SHIFTS:
        cut = middle + shift
        if i < cut < j and _full_move(nodes, bounds, i, cut) and _full_move(nodes, bounds, cut, j):
            return [(i, cut), (cut, j)]
    return [(i, middle), (middle, j)]


def _full_move(nodes: Nodes, bounds: Bounds, i: int, j: int) -> Phases | None:
    """The time-optimal move between two nodes, unless it makes a long detour."""
    limits = bounds.course.limits
    speed = max(state.v for state in nodes.states[i : j + 1])
    box = Box(speed, limits.max_acceleration, limits.max_deceleration, limits.max_jerk)
    return _short_enough(nodes, i, j, move(nodes.states[i], nodes.states[j], box))


def _gentle_move(nodes: Nodes, bounds: Bounds, i: int, j: int) -> Phases | None:
    """A move with hardly more jerk and acceleration than the reference: it follows a stretch that rides its cap."""
    limits = bounds.course.limits
    jerk = 1.05 * float(nodes.jerk[i:j].max()) + 0.01 * limits.max_jerk
    if i == 0 or j == len(nodes.states) - 1 or jerk > 0.95 * limits.max_jerk:
        return None
    if nodes.time[j] - nodes.time[i] > _GENTLE_BELOW:
        return None
    speeds = [state.v for state in nodes.states[i : j + 1]]
    accelerations = [state.a for state in nodes.states[i : j + 1]]
    rise = min(limits.max_acceleration, 1.04 * max(accelerations) + 0.04 * limits.max_acceleration)
    fall = min(limits.max_deceleration, -1.04 * min(accelerations) + 0.04 * limits.max_deceleration)
    least = 0.01 * limits.max_acceleration
    box = Box(max(speeds), max(rise, least), max(fall, least), jerk)
    return _short_enough(nodes, i, j, move(nodes.states[i], nodes.states[j], box))


def _short_enough(nodes: Nodes, i: int, j: int, phases: Phases | None) -> Phases | None:
    if phases is None:
        return None
    longest = _LONGEST[0] * float(nodes.time[j] - nodes.time[i]) + _LONGEST[1]
    return phases if sum(duration for duration, _jerk in phases) <= longest else None


def _try_pieces(
    nodes: Nodes, bounds: Bounds, active: list[tuple[int, int]]
) -> list[tuple[tuple[int, int], Piece | None, float]]:
    """For every piece: itself, its best move, and where that is worst."""
    moves: list[tuple[int, Phases]] = []
    for n, (i, j) in enumerate(active):
        for make in (_gentle_move, _full_move):
            phases = make(nodes, bounds, i, j)
            if phases:
                moves.append((n, phases))
    excess, place = _evaluate(bounds, [(nodes.states[active[n][0]], phases) for n, phases in moves])
    best: list[tuple[Piece | None, float]] = [(None, np.nan)] * len(active)
    for (n, phases), value, s in zip(moves, excess, place, strict=True):
        known = best[n][0]
        if known is None or (known.excess > 1.0 and value < known.excess):
            best[n] = (Piece(*active[n], phases, value), s)
    return [(piece, *found) for piece, found in zip(active, best, strict=True)]


def _evaluate(bounds: Bounds, moves: list[tuple[State, Phases]]) -> tuple[list[float], list[float]]:
    """Largest excess of every move and where it is; all moves at once."""
    if not moves:
        return [], []
    rows, counts = _phase_rows(moves)
    table = np.array(rows)  # (phases, 6): duration, jerk, s, v, a, samples
    samples = table[:, 5].astype(np.int64)
    owner = np.repeat(np.arange(samples.size), samples)
    first = np.cumsum(samples) - samples
    duration, jerk, s, v, a, number = table[owner].T
    t = (np.arange(owner.size) - first[owner]) * (duration / np.maximum(number - 1.0, 1.0))
    half = 0.5 * t * jerk
    distance = np.clip(s + t * (v + t * (0.5 * a + half / 3.0)), 0.0, bounds.course.length)
    excess = bounds.excess_at(distance, v + t * (a + half), a + t * jerk)
    begins = first[np.cumsum(counts) - np.array(counts)]
    worst = np.maximum.reduceat(excess, begins)
    piece = np.repeat(np.arange(begins.size), np.diff(np.append(begins, owner.size)))
    at_worst = np.flatnonzero(excess >= worst[piece])
    place = np.empty(begins.size)
    place[piece[at_worst]] = distance[at_worst]
    return worst.tolist(), place.tolist()


def _phase_rows(moves: list[tuple[State, Phases]]) -> tuple[list[tuple[float, ...]], list[int]]:
    rows: list[tuple[float, ...]] = []
    for (s, v, a), phases in moves:
        for duration, jerk in phases:
            rows.append((duration, jerk, s, v, a, 2 + int(duration / _SAMPLE)))
            s += duration * (v + duration * (a / 2.0 + duration * jerk / 6.0))
            v += duration * (a + duration * jerk / 2.0)
            a += duration * jerk
    return rows, [len(phases) for _state, phases in moves]
