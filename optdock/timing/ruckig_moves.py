"""Moves between two states, computed by ruckig [Berscheid2021], and the division of a reference into a few moves.

ruckig's community edition runs offline. Its moves may go backwards, and it accepts start states beyond the limits; both
cases are checked here. Intermediate positions are never passed to ruckig, because it would then call a cloud service.

Every piece of the reference is first tried as one move; a piece whose move violates a limit is split at the knot
nearest to the largest excess. Between two neighbouring knots, the motion of the reference is a move.
"""

from __future__ import annotations

import importlib
import itertools
import math
import threading
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

from optdock.deadline import ENDLESS
from optdock.errors import PluginError
from optdock.kernels import Kernel, twin_of
from optdock.model.constant_jerk import constant_jerk
from optdock.timing.jerk_phases import Phases
from optdock.timing.path_limits import CHECK_MARGIN
from optdock.timing.reference_program import spline_phases

if TYPE_CHECKING:
    from types import ModuleType

    from optdock.deadline import Deadline
    from optdock.geometry.arrays import FloatArray, IntArray
    from optdock.timing.path_limits import ReferenceBounds
    from optdock.timing.reference_program import ReferenceStates

__all__ = ["Move", "load_ruckig", "move", "split_into_moves"]

_State: TypeAlias = tuple[float, float, float]  # a `MotionState`, or a plain tuple of the same numbers
_Bounds: TypeAlias = tuple[float, float, float, float]  # `DriveBounds`, or a plain tuple of the same numbers

_ABOVE = 1.0 + 1e-9  # factor on the speed limit, because ruckig refuses a target exactly at the limit
_STILL = 1e-9  # [m/s]: a negative speed of this size is a rounding error, not a motion backwards
_CRAWL = 1e-3  # [m/s]: lower speeds do not violate a limit

_SAMPLE = 0.02  # [s]: sampling period of the check of a move
_LONGEST_FACTOR, _LONGEST_MORE = 1.2, 0.05  # bound on the duration: factor on the reference's, addition [s]
_GENTLE_BELOW = 1.5  # [s]: shorter pieces are first tried with a jerk slightly above that of the reference
_GENTLE_JERK = (1.05, 0.01)  # factor on the largest jerk of the reference, and share of the limit added to it
_GENTLE_MOST_JERK = 0.95  # share of the limit above which a gentle move has no advantage
_GENTLE_DRIVE = (1.04, 0.04)  # factor on the reference's range of accelerations, and share of the limit added to it
_GENTLE_LEAST_DRIVE = 0.01  # least share of the acceleration for a gentle move
_LEVEL = 0.8  # share of the largest v^2: where the cap stays above it, a single move is tried for any length
_MIDDLE, _SHORT = 16, 6  # cells: longer pieces are split into parts of at most 16, above 6 into four, others into two


def move(start: _State, target: _State, bounds: _Bounds, longest: float = math.inf) -> Phases | None:
    """Return the time-optimal motion between two states, or None if every motion drives backwards.

    The speed bound is raised to the speeds that follow from the two states; the caller checks the result.

    Args:
        start: First state, as `MotionState`.
        target: Last state, as `MotionState`.
        bounds: Bounds of speed, acceleration, deceleration and jerk, as `DriveBounds`.
        longest: Largest duration of a motion [s].
    """
    (s0, v0, a0), (s1, v1, a1), (speed, acceleration, deceleration, jerk) = start, target, bounds
    rise = max(v1 + (0.5 * a1 * a1 / jerk if a1 < 0.0 else 0.0), v0 + (0.5 * a0 * a0 / jerk if a0 > 0.0 else 0.0))
    tool = _tool()
    given = tool.input  # ruckig copies its inputs, so lists are assigned, not modified
    given.current_position, given.current_velocity, given.current_acceleration = [s0], [v0], [a0]
    given.target_position, given.target_velocity, given.target_acceleration = [s1], [v1], [a1]
    given.max_velocity, given.max_jerk = [max(speed, rise * _ABOVE)], [jerk]
    given.max_acceleration, given.min_acceleration = [acceleration], [-deceleration]
    try:
        tool.otg.calculate(given, tool.output)
    except tool.error:
        return None
    if tool.output.duration > longest:
        return None
    profile = tool.output.profiles[0][0]
    brake, times, jerks = profile.brake, profile.t, profile.j
    if brake.duration > 0.0:
        times, jerks = [*brake.t, *times], [*brake.j, *jerks]
    phases = tuple([phase for phase in zip(times, jerks, strict=True) if phase[0] > 0.0])
    return phases if _drives_forward(start, phases) else None


def _drives_forward(start: _State, phases: Phases) -> bool:
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
    """Set of ruckig objects, which every calculation overwrites."""

    def __init__(self, ruckig: ModuleType) -> None:
        self.otg: Any = ruckig.Ruckig(1)  # ruckig has no type annotations
        self.input: Any = ruckig.InputParameter(1)
        self.output: Any = ruckig.Trajectory(1)
        self.error: type[Exception] = ruckig.RuckigError


def load_ruckig() -> None:
    """Import ruckig in advance, for this thread.

    Raises:
        PluginError: If ruckig is not installed.
    """
    _tool()


_local = threading.local()


def _tool() -> _Tool:
    try:
        tool: _Tool = _local.tool
    except AttributeError:
        tool = _local.tool = _Tool(_ruckig())
    return tool


@cache
def _ruckig() -> ModuleType:
    try:
        return importlib.import_module("ruckig")
    except ImportError as error:
        raise PluginError(f"timing: needs the package ruckig ({error}); install it: pip install ruckig") from error


class _Nodes(NamedTuple):
    """States between which moves are computed: both ends of the segment and the knots between them.

    `time`: times of the reference [s]; `jerk`: largest |jerk| in each cell [m/s^3]; `zone`: index of the zone start, or
    0.
    """

    states: list[_State]
    v: list[float]
    a: list[float]
    time: list[float]
    jerk: list[float]
    zone: int


class Move(NamedTuple):
    """One move along the reference."""

    left: float  # start [m]
    right: float  # end [m]
    phases: Phases  # the motion
    excess: float  # factor on time for which the checked limits are kept; at most 1 if the move keeps them
    worst: float  # place of the largest excess [m]


def split_into_moves(
    reference: ReferenceStates, bounds: ReferenceBounds, start: _State, deadline: Deadline = ENDLESS
) -> list[Move]:
    """Return moves along the reference over the whole segment, in driving order, within the limits if possible.

    Args:
        reference: The reference.
        bounds: Bounds of the reference.
        start: State at the start of the segment; the end is at rest.
        deadline: Deadline, checked before every move.

    Raises:
        OutOfTime: If the deadline passed.
    """
    nodes = _nodes_of(reference, start, bounds.limits.length)
    active = _first_pieces(nodes, bounds)
    done: list[Move] = []
    while active:
        tried = _try_pieces(nodes, bounds, active, deadline)
        active = []
        for (i, j), best in tried.items():
            if best is not None and (best.excess <= 1.0 or j - i == 1):
                done.append(best)
            else:
                active.extend(_parts(nodes, (i, j), best))
    return sorted(done)


def _nodes_of(reference: ReferenceStates, start: _State, length: float) -> _Nodes:
    """Return the nodes of a reference between the start and the end of a segment, which is at rest."""
    (s, v, a, times, jerks), zone = reference.table.tolist(), reference.grid.zone
    states, v, a = [*zip(s, v, a, strict=True), (length, 0.0, 0.0)], [*v, 0.0], [*a, 0.0]
    if reference.launch.phases:
        states, v, a = [start, *states], [start[1], *v], [start[2], *a]
        times, jerks, zone = [reference.launch.phases[0][0], *times], [math.inf, *jerks], zone + 1 if zone else 0
    return _Nodes(states, v, a, list(itertools.accumulate(times, initial=0.0)), jerks, zone)


def _first_pieces(nodes: _Nodes, bounds: ReferenceBounds) -> list[tuple[int, int]]:
    """Return the pieces before and after the zone start, split further if they are long and the cap is not level."""
    last = len(nodes.states) - 1
    pieces: list[tuple[int, int]] = []
    for i, j in ((0, nodes.zone), (nodes.zone, last)) if 0 < nodes.zone < last else ((0, last),):
        count = -(-(j - i) // _MIDDLE)
        if count > 1:
            first, end = bounds.limits.s.searchsorted((nodes.states[i][0] + 1e-9, nodes.states[j][0] - 1e-9)).tolist()
            cap = bounds.speed_squared[first:end]
            if first >= end or np.minimum.reduce(cap) > _LEVEL * np.maximum.reduce(cap):
                count = 1
        pieces += _equal_parts(i, j, count) if count > 1 else ((i, j),)
    return pieces


def _equal_parts(i: int, j: int, count: int) -> list[tuple[int, int]]:
    return [(i + (j - i) * n // count, i + (j - i) * (n + 1) // count) for n in range(count)]


def _parts(nodes: _Nodes, ends: tuple[int, int], tried: Move | None) -> list[tuple[int, int]]:
    """Split a long piece into equal parts, and a short piece in two at the knot nearest to the largest excess."""
    i, j = ends
    cells = j - i
    if cells > _SHORT or tried is None:
        count = -(-cells // _MIDDLE) if cells > _MIDDLE else 4 if cells > _SHORT else 2
        return _equal_parts(i, j, count)
    states, worst = nodes.states, tried.worst
    middle = min(range(i + 1, j), key=lambda n: abs(states[n][0] - worst))
    return [(i, middle), (middle, j)]


def _try_pieces(
    nodes: _Nodes, bounds: ReferenceBounds, active: list[tuple[int, int]], deadline: Deadline
) -> dict[tuple[int, int], Move | None]:
    """Return the best move over every piece: a gentle move if there is one, otherwise the time-optimal move.

    The time-optimal move over a single cell is tried in any case. If rounding errors leave no valid move over a single
    cell, the reference's own motion over that cell is used.
    """
    moves: list[tuple[tuple[int, int], Phases]] = []
    for i, j in active:
        deadline.look()
        gentle = _gentle_move(nodes, bounds, i, j)
        full = None if gentle and j - i > 1 else _full_move(nodes, bounds, i, j)
        own = None
        if j - i == 1 and not (gentle or full):
            own = spline_phases(*np.array(nodes.states[i : i + 2]).T)
        for phases in (gentle, full, own):
            if phases:
                moves += (((i, j), phases),)
    best: dict[tuple[int, int], Move | None] = dict.fromkeys(active)
    if not moves:
        return best
    found = _evaluate(bounds, [(nodes.states[ends[0]], phases) for ends, phases in moves])
    for (ends, phases), (excess, worst) in zip(moves, found, strict=True):
        known = best[ends]
        if known is None or (known.excess > 1.0 and excess < known.excess):
            best[ends] = Move(nodes.states[ends[0]][0], nodes.states[ends[1]][0], phases, excess, worst)
    return best


def _full_move(nodes: _Nodes, bounds: ReferenceBounds, i: int, j: int) -> Phases | None:
    """Return the time-optimal move between two nodes, unless it takes much longer than the reference."""
    drive = bounds.limits.drive
    most = max(nodes.v[i : j + 1]), drive.max_acceleration, drive.max_deceleration, drive.max_jerk
    return move(nodes.states[i], nodes.states[j], most, _longest(nodes, i, j))


def _gentle_move(nodes: _Nodes, bounds: ReferenceBounds, i: int, j: int) -> Phases | None:
    """Return a move with slightly more jerk and acceleration than the reference, which stays close to its speeds."""
    drive = bounds.limits.drive
    if i == 0 or j == len(nodes.states) - 1 or nodes.time[j] - nodes.time[i] > _GENTLE_BELOW:
        return None
    factor, more = _GENTLE_JERK
    jerk = factor * max(nodes.jerk[i:j]) + more * drive.max_jerk
    if jerk > _GENTLE_MOST_JERK * drive.max_jerk:
        return None
    accelerations, (factor, more) = nodes.a[i : j + 1], _GENTLE_DRIVE
    rise = min(drive.max_acceleration, factor * max(accelerations) + more * drive.max_acceleration)
    fall = min(drive.max_deceleration, -factor * min(accelerations) + more * drive.max_deceleration)
    least = _GENTLE_LEAST_DRIVE * drive.max_acceleration
    gentle = max(nodes.v[i : j + 1]), max(rise, least), max(fall, least), jerk
    return move(nodes.states[i], nodes.states[j], gentle, _longest(nodes, i, j))


def _longest(nodes: _Nodes, i: int, j: int) -> float:
    """Return the largest duration of a move between two nodes [s]."""
    return _LONGEST_FACTOR * (nodes.time[j] - nodes.time[i]) + _LONGEST_MORE


class _Samples(NamedTuple):
    """States along several moves, move after move; `begins` contains the index of the first state of each move."""

    s: FloatArray
    v: FloatArray
    a: FloatArray
    jerk: FloatArray
    begins: IntArray

    @property
    def owners(self) -> IntArray:
        """Index of the move to which each sample belongs."""
        return np.repeat(np.arange(self.begins.size), np.diff(np.append(self.begins, self.s.size)))

    def reached(self, before: IntArray, s: FloatArray, period: float) -> tuple[FloatArray, FloatArray]:
        """Return speed and acceleration at distances `s`, reached at most `period` [s] after the samples `before`."""
        v, a, jerk = self.v[before], self.a[before], self.jerk[before]
        behind = self.s[before] - s
        t = -behind / np.maximum(v, _CRAWL)
        for _ in range(2):  # Newton steps for the time
            miss, speed, _a = constant_jerk(t, behind, v, a, jerk)
            t = np.clip(t - miss / np.maximum(speed, _CRAWL), 0.0, period)
        _s, speed, acceleration = constant_jerk(t, behind, v, a, jerk)
        return speed, acceleration


_KERNEL = Kernel("optdock_move_excess", sizes=5, numbers=6)


def _evaluate_native(bounds: ReferenceBounds, moves: list[tuple[_State, Phases]]) -> list[tuple[float, float]]:
    n, limits, phases, time = len(moves), bounds.limits, 0, 0.0
    given: list[float] = []
    for start, own in moves:
        given += (len(own), *start)
        for phase in own:
            given += phase
            phases += 1
            time += phase[0]
    bound = limits.turning[0].bound if limits.turning else math.inf
    room = phases + int(time / _SAMPLE) + 1
    found = np.empty(2 * n + 6 * room)
    done = _KERNEL(
        (n, 4 * n + 2 * phases, limits.s.size, bounds.jumps.size, room),
        (_SAMPLE, _CRAWL, bounds.relief, 1.0 / (1.0 - CHECK_MARGIN), bound, limits.caps.steering),
        (
            (np.array(given, dtype=np.float64), 4 * n + 2 * phases),
            (limits.table, limits.table.size),
            (bounds.jumps, bounds.jumps.size),
            (found, found.size),
        ),
    )
    if done < 0:
        raise ValueError("moves: must have phases of finite durations, and limits with jumps at inner nodes")
    return list(zip(*found[: 2 * n].reshape(2, n).tolist(), strict=True))


def _evaluate(bounds: ReferenceBounds, moves: list[tuple[_State, Phases]]) -> list[tuple[float, float]]:
    """Return the largest excess of every move, and its last position, vectorized over all moves."""
    # The last bits of a cube root, which turning limits of order 2 need, depend on the library.
    has_roots = bounds.limits.drive.max_lateral_jerk < math.inf
    return (_evaluate_numpy if has_roots else _evaluate_chosen)(bounds, moves)


def _evaluate_numpy(bounds: ReferenceBounds, moves: list[tuple[_State, Phases]]) -> list[tuple[float, float]]:
    phases, counts = _phase_rows(moves)
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
        _add_jumps(bounds, samples, excess)
    worst = np.maximum.reduceat(excess, samples.begins)
    at_worst = np.flatnonzero(excess >= worst[samples.owners])
    place = np.full(worst.size, np.nan)
    place[samples.owners[at_worst]] = samples.s[at_worst]
    return list(zip(worst.tolist(), place.tolist(), strict=True))


_evaluate_chosen = twin_of(_evaluate_native)(_evaluate_numpy)


def _phase_rows(moves: list[tuple[_State, Phases]]) -> tuple[FloatArray, FloatArray]:
    """Return duration, jerk, s, v, a and number of samples of every phase, and the number of phases of every move."""
    rows: list[tuple[float, float, float, float, float, int]] = []
    for start, phases in moves:
        s, v, a = start
        for duration, jerk in phases:
            rows.append((duration, jerk, s, v, a, 1 + int(duration / _SAMPLE)))
            s, v, a = constant_jerk(duration, s, v, a, jerk)
    return np.array(rows), np.array([len(phases) for _start, phases in moves])


def _add_jumps(bounds: ReferenceBounds, samples: _Samples, excess: FloatArray) -> None:
    """Raise the excess of the last sample before each jump of the curvature rate to the excess at the jump."""
    places = bounds.limits.s[bounds.jumps]
    ends = np.append(samples.begins[1:], samples.s.size) - 1
    first = np.searchsorted(places, samples.s[samples.begins])
    count = np.maximum(np.searchsorted(places, samples.s[ends], side="right") - first, 0)
    owner = np.repeat(np.arange(count.size), count)
    index = first[owner] + np.arange(owner.size) - (np.cumsum(count) - count)[owner]
    stride = 2.0 * bounds.limits.length  # moves overlap; after a shift they form one increasing sequence
    key = np.maximum.accumulate(samples.s + stride * samples.owners)
    before = np.maximum(np.searchsorted(key, places[index] + stride * owner) - 1, samples.begins[owner])
    v, a = samples.reached(before, places[index], _SAMPLE)
    np.maximum.at(excess, before, bounds.jump_excess_at(bounds.jumps[index], v, a))
