"""Moves by ruckig [Berscheid2021]: from state to state, and along the reference, as few as the limits allow.

ruckig's community edition runs offline. It happily drives backwards and accepts start states beyond its limits; both
are seen to here. It never gets an intermediate position: with one it would call a cloud service.

Along the reference, level by level, every open piece is tried as one move; a piece whose move breaks a limit is split
at the knot nearest the worst place. Between two neighbouring knots the reference itself shows that a move exists.
"""

from __future__ import annotations

import importlib
import itertools
import math
import threading
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from optdock.deadline import ENDLESS
from optdock.errors import PluginError
from optdock.model.trajectory import constant_jerk
from optdock.timing.jerk_phases import DriveBounds, MotionState, Phases, duration_of
from optdock.timing.reference_program import spline_phases

if TYPE_CHECKING:
    from types import ModuleType

    from optdock.deadline import Deadline
    from optdock.geometry.arrays import FloatArray, IntArray
    from optdock.timing.path_limits import ReferenceBounds
    from optdock.timing.reference_program import ReferenceStates

__all__ = ["Move", "load_ruckig", "move", "split_into_moves"]

_ABOVE = 1.0 + 1e-9  # ruckig refuses a target exactly at its speed limit
_STILL = 1e-9  # [m/s]: rounding below zero that does not count as driving backwards
_CRAWL = 1e-3  # [m/s]: speeds below it break no limit


def move(start: MotionState, target: MotionState, bounds: DriveBounds, longest: float = math.inf) -> Phases | None:
    """The time-optimal motion between two states; None where there is none without driving backwards.

    The speed bound is raised to what the two states make inevitable; a caller that needs it kept checks the result.

    Args:
        start: First state.
        target: Last state.
        bounds: Of speed, acceleration, deceleration and jerk.
        longest: Motions that take longer count as none [s].
    """
    rise = max(
        target.v + (0.5 * target.a * target.a / bounds.jerk if target.a < 0.0 else 0.0),
        start.v + (0.5 * start.a * start.a / bounds.jerk if start.a > 0.0 else 0.0),
    )
    phases = _tool().position_move(start, target, bounds, max(bounds.speed, rise * _ABOVE), longest)
    return phases if _drives_forward(start, phases) else None


def _drives_forward(start: MotionState, phases: Phases | None) -> bool:
    if phases is None:
        return False
    _s, v, a = start
    for duration, jerk in phases:
        end_a = a + duration * jerk
        if a < 0.0 < end_a and v - 0.5 * a * a / jerk < -_STILL:
            return False
        v += 0.5 * duration * (a + end_a)
        a = end_a
        if v < -_STILL:
            return False
    return True


class _Tool:
    """One set of ruckig's objects; a trajectory object is overwritten by every calculation."""

    def __init__(self, ruckig: ModuleType) -> None:
        self.otg: Any = ruckig.Ruckig(1)  # ruckig ships no types
        self.input: Any = ruckig.InputParameter(1)
        self.output: Any = ruckig.Trajectory(1)
        self.error: type[Exception] = ruckig.RuckigError

    def position_move(
        self, start: MotionState, target: MotionState, bounds: DriveBounds, speed: float, longest: float
    ) -> Phases | None:
        """The phases from state to state, brake phases first; None where ruckig finds none.

        Inputs are copies inside ruckig, so lists are assigned, never changed.
        """
        given = self.input
        given.current_position, given.current_velocity, given.current_acceleration = [start.s], [start.v], [start.a]
        given.target_position, given.target_velocity, given.target_acceleration = [target.s], [target.v], [target.a]
        given.max_velocity, given.max_jerk = [speed], [bounds.jerk]
        given.max_acceleration, given.min_acceleration = [bounds.acceleration], [-bounds.deceleration]
        try:
            self.otg.calculate(given, self.output)
        except self.error:
            return None
        if self.output.duration > longest:
            return None
        profile = self.output.profiles[0][0]
        brake = profile.brake
        times, jerks = profile.t, profile.j
        if brake.duration > 0.0:
            times, jerks = [*brake.t, *times], [*brake.j, *jerks]
        return tuple([phase for phase in zip(times, jerks, strict=True) if phase[0] > 0.0])


def load_ruckig() -> None:
    """Import ruckig now, for this thread.

    Raises:
        PluginError: It is not installed.
    """
    _tool()


class _Local(threading.local):
    tool: _Tool | None = None


_local = _Local()


def _tool() -> _Tool:
    if _local.tool is None:
        _local.tool = _Tool(_ruckig())
    return _local.tool


@cache
def _ruckig() -> ModuleType:
    try:
        return importlib.import_module("ruckig")
    except ImportError as error:
        raise PluginError(f"timing: needs the package ruckig ({error}); install it: pip install ruckig") from error


class _Nodes(NamedTuple):
    """States between which moves are made: both ends of the segment and the knots between.

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

    def state(self, i: int) -> MotionState:
        """The state at node `i`."""
        return MotionState(self.s[i], self.v[i], self.a[i])


class _Piece(NamedTuple):
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


class Move(NamedTuple):
    """One move along the reference.

    Args:
        left: Where it begins [m].
        right: Where it ends [m].
        phases: The motion.
        excess: By how much time would have to be stretched for the checked limits to hold; at most 1 where they do.
    """

    left: float
    right: float
    phases: Phases
    excess: float


def split_into_moves(
    reference: ReferenceStates, bounds: ReferenceBounds, start: MotionState, deadline: Deadline = ENDLESS
) -> list[Move]:
    """The moves that drive the reference within the checked limits, wherever there are such.

    Args:
        reference: What to follow.
        bounds: What it was made for.
        start: State at the start of the segment; the end is at rest.
        deadline: Looked at before every move.

    Returns:
        Moves in driving order over the whole segment.

    Raises:
        OutOfTime: The deadline passed.
    """
    nodes = _nodes_of(reference, start, MotionState(bounds.limits.length))
    active = _first_pieces(nodes, bounds)
    done: list[_Piece] = []
    while active:
        tried = _try_pieces(nodes, bounds, active, deadline)
        active = []
        for (i, j), best in tried.items():
            if best is not None and (best.excess <= 1.0 or j - i == 1):
                done.append(best)
            else:
                active.extend(_parts(nodes, bounds, (i, j), best))
    return [Move(nodes.s[piece.first], nodes.s[piece.last], piece.phases, piece.excess) for piece in sorted(done)]


def _nodes_of(reference: ReferenceStates, start: MotionState, end: MotionState) -> _Nodes:
    """_Nodes of a reference between the start and the end of the segment."""
    s, v, a, zone = reference.s, reference.v, reference.a, reference.grid.zone
    jerk = 0.5 * np.abs(reference.curve) * np.maximum(v[:-1], v[1:])
    launch, stop = duration_of(reference.launch.phases), duration_of(reference.stop.phases)
    head = [launch] if launch > 0.0 else []
    columns = ([*(value for _ in head), *column.tolist()] for value, column in zip(start, (s, v, a), strict=True))
    s_all, v_all, a_all = ([*column, value] for column, value in zip(columns, end, strict=True))
    times = list(itertools.accumulate([*head, *reference.durations.tolist(), stop], initial=0.0))
    jerks = [*(np.inf for _ in head), *jerk.tolist(), np.inf]
    return _Nodes(s_all, v_all, a_all, times, jerks, zone + len(head) if zone else 0)


def _first_pieces(nodes: _Nodes, bounds: ReferenceBounds) -> list[tuple[int, int]]:
    """Before and after the zone start; cut into parts where the speed cap changes on the way."""
    last, settings = len(nodes.s) - 1, bounds.settings.moves
    halves = [(0, nodes.zone), (nodes.zone, last)] if 0 < nodes.zone < last else [(0, last)]
    pieces: list[tuple[int, int]] = []
    for i, j in halves:
        cells = slice(*np.searchsorted(bounds.limits.s, (nodes.s[i] + 1e-9, nodes.s[j] - 1e-9)))
        cap = bounds.speed_squared[cells]
        level = cap.size == 0 or float(cap.min()) > settings.level * float(cap.max())
        pieces.extend([(i, j)] if level else _equal_parts(i, j, -(-(j - i) // settings.middle)))
    return pieces


def _equal_parts(i: int, j: int, count: int) -> list[tuple[int, int]]:
    return list(itertools.pairwise(i + (j - i) * n // count for n in range(count + 1)))


def _parts(
    nodes: _Nodes, bounds: ReferenceBounds, ends: tuple[int, int], tried: _Piece | None
) -> list[tuple[int, int]]:
    """A long piece in equal parts, a short one in two at the knot nearest to where it is worst."""
    (i, j), settings = ends, bounds.settings.moves
    cells = j - i
    if cells > settings.short or tried is None:
        count = -(-cells // settings.middle) if cells > settings.middle else 4 if cells > settings.short else 2
        return _equal_parts(i, j, count)
    s, worst = nodes.s, tried.worst
    middle = min(range(i + 1, j), key=lambda n: abs(s[n] - worst))
    return [(i, middle), (middle, j)]


def _try_pieces(
    nodes: _Nodes, bounds: ReferenceBounds, active: list[tuple[int, int]], deadline: Deadline
) -> dict[tuple[int, int], _Piece | None]:
    """The best move of every piece; the time-optimal one only where the gentle one is missing or the last hope.

    A single cell without a move, by rounding, is driven as the reference drives it.
    """
    moves: list[tuple[tuple[int, int], Phases]] = []
    for i, j in active:
        deadline.look()
        gentle = _gentle_move(nodes, bounds, i, j)
        full = None if gentle and j - i > 1 else _full_move(nodes, bounds, i, j)
        own = _reference_motion(nodes, i) if j - i == 1 and not (gentle or full) else None
        moves.extend(((i, j), phases) for phases in (gentle, full, own) if phases)
    found = _evaluate(bounds, [(nodes.state(ends[0]), phases) for ends, phases in moves])
    best: dict[tuple[int, int], _Piece | None] = dict.fromkeys(active)
    for (ends, phases), (excess, worst) in zip(moves, found, strict=True):
        known = best[ends]
        if known is None or (known.excess > 1.0 and excess < known.excess):
            best[ends] = _Piece(*ends, phases, excess, worst)
    return best


def _full_move(nodes: _Nodes, bounds: ReferenceBounds, i: int, j: int) -> Phases | None:
    """The time-optimal move between two nodes, unless it makes a long detour."""
    drive = bounds.limits.drive
    most = DriveBounds(max(nodes.v[i : j + 1]), drive.max_acceleration, drive.max_deceleration, drive.max_jerk)
    return _short_enough(nodes, bounds, (i, j), most)


def _gentle_move(nodes: _Nodes, bounds: ReferenceBounds, i: int, j: int) -> Phases | None:
    """A move with hardly more jerk and acceleration than the reference: it follows a stretch that rides its cap."""
    settings, drive = bounds.settings.moves, bounds.limits.drive
    if i == 0 or j == len(nodes.s) - 1 or nodes.time[j] - nodes.time[i] > settings.gentle_below:
        return None
    factor, more = settings.gentle_jerk
    jerk = factor * max(nodes.jerk[i:j]) + more * drive.max_jerk
    if jerk > settings.gentle_most_jerk * drive.max_jerk:
        return None
    accelerations, (factor, more) = nodes.a[i : j + 1], settings.gentle_drive
    rise = min(drive.max_acceleration, factor * max(accelerations) + more * drive.max_acceleration)
    fall = min(drive.max_deceleration, -factor * min(accelerations) + more * drive.max_deceleration)
    least = settings.gentle_least_drive * drive.max_acceleration
    gentle = DriveBounds(max(nodes.v[i : j + 1]), max(rise, least), max(fall, least), jerk)
    return _short_enough(nodes, bounds, (i, j), gentle)


def _short_enough(nodes: _Nodes, bounds: ReferenceBounds, ends: tuple[int, int], box: DriveBounds) -> Phases | None:
    (i, j), settings = ends, bounds.settings.moves
    longest = settings.longest_factor * (nodes.time[j] - nodes.time[i]) + settings.longest_more
    return move(nodes.state(i), nodes.state(j), box, longest)


def _reference_motion(nodes: _Nodes, i: int) -> Phases:
    """The motion of the reference in one cell."""
    return spline_phases(*(np.array(column[i : i + 2]) for column in (nodes.s, nodes.v, nodes.a)))


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

    def reached(self, before: IntArray, s: FloatArray, period: float) -> tuple[FloatArray, FloatArray]:
        """Speed and acceleration at distances `s` at most `period` [s] after the samples `before`.

        Two Newton steps for the time.
        """
        v, a, jerk = self.v[before], self.a[before], self.jerk[before]
        behind = self.s[before] - s
        t = -behind / np.maximum(v, _CRAWL)
        for _ in range(2):
            miss, speed, _a = constant_jerk(t, behind, v, a, jerk)
            t = np.clip(t - miss / np.maximum(speed, _CRAWL), 0.0, period)
        _s, speed, acceleration = constant_jerk(t, behind, v, a, jerk)
        return speed, acceleration


def _evaluate(bounds: ReferenceBounds, moves: list[tuple[MotionState, Phases]]) -> list[tuple[float, float]]:
    """Largest excess of every move and where it is; all moves at once."""
    if not moves:
        return []
    period = bounds.settings.moves.sample
    phases, counts = _phase_rows(moves, period)
    number_of = phases[:, 5].astype(np.int64)
    owner = np.repeat(np.arange(number_of.size), number_of)
    first = np.cumsum(number_of) - number_of
    duration, jerk, s, v, a, number = phases[owner].T
    t = (np.arange(owner.size) - first[owner]) * (duration / number)  # the end of a move is a knot
    s, v, a = constant_jerk(t, s, v, a, jerk)
    samples = _Samples(
        np.minimum(np.maximum(s, 0.0), bounds.limits.length), v, a, jerk, first[np.cumsum(counts) - counts]
    )
    excess = bounds.excess_at(samples.s, samples.v, samples.a)
    if bounds.jumps.size:
        _add_jumps(bounds, samples, excess, period)
    worst = np.maximum.reduceat(excess, samples.begins)
    at_worst = np.flatnonzero(excess >= worst[samples.owners])
    place = np.empty(worst.size)
    place[samples.owners[at_worst]] = samples.s[at_worst]
    return list(zip(worst.tolist(), place.tolist(), strict=True))


def _phase_rows(moves: list[tuple[MotionState, Phases]], period: float) -> tuple[FloatArray, FloatArray]:
    """Duration, jerk, s, v, a and number of samples of every phase, and the number of phases of every move."""
    rows: list[tuple[float, float, float, float, float, int]] = []
    for start, phases in moves:
        s, v, a = start
        for duration, jerk in phases:
            rows.append((duration, jerk, s, v, a, 1 + int(duration / period)))
            s, v, a = constant_jerk(duration, s, v, a, jerk)
    return np.array(rows), np.array([len(phases) for _start, phases in moves])


def _add_jumps(bounds: ReferenceBounds, samples: _Samples, excess: FloatArray, period: float) -> None:
    """Raise the excess at the samples before jumps of the curvature rate to what it is at the jumps."""
    places = bounds.limits.s[bounds.jumps]
    ends = np.append(samples.begins[1:], samples.s.size) - 1
    first = np.searchsorted(places, samples.s[samples.begins])
    count = np.maximum(np.searchsorted(places, samples.s[ends], side="right") - first, 0)
    owner = np.repeat(np.arange(count.size), count)
    index = first[owner] + np.arange(owner.size) - (np.cumsum(count) - count)[owner]
    stride = 2.0 * bounds.limits.length  # moves overlap; shifted apart they make one increasing sequence
    key = samples.s + stride * samples.owners
    before = np.maximum(np.searchsorted(key, places[index] + stride * owner) - 1, samples.begins[owner])
    v, a = samples.reached(before, places[index], period)
    np.maximum.at(excess, before, bounds.jump_excess_at(bounds.jumps[index], v, a))
