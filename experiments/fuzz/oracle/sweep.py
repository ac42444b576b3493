"""Clearance along a whole path: sampled, then refined where it could be smaller than at the samples."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from experiments.fuzz.case import Case
    from experiments.fuzz.oracle.motion import Floats, Ints, Motion
    from experiments.fuzz.oracle.world import World

__all__ = [
    "AROUND",
    "Sweep",
    "clearance_rule",
    "jumps_at_goal",
    "required_at",
    "start_clearance",
    "start_run",
    "sweep",
    "taper_share",
    "tube",
]

_STEP, _TURN = 0.04, 0.08  # [m], [rad] between initial samples
_MOST = 1500  # initial samples
_SURELY = 1e-9  # [m]: distances of other programs may differ by less
_PARTS = 6  # parts of a refined interval
_ROUNDS = 20
_KEPT = 40  # intervals refined per round
AROUND = 1.0 / np.cos(np.pi / 32.0) - 1.0  # relative: excess of the circumscribed polygon over the radius of a disc
_ENOUGH = 1e-7  # [m]: largest undetected decrease within an interval


@dataclass(frozen=True)
class Sweep:
    """Samples of a path; all Shape (n,) except `poses`, Shape (n, 3). `clearance` and `margin` [m]."""

    s: Floats
    poses: Floats
    clearance: Floats
    margin: Floats

    @property
    def worst(self) -> int:
        """Index of the smallest margin."""
        return int(np.argmin(self.margin))


def start_run(case: Case) -> float:
    """Return the distance over which the weaker rule requires no more than at the start of a robot along a wall [m]."""
    footprint = case["footprint"]
    if "radius" in footprint:
        return 4.0 * float(footprint["radius"])
    outline = np.array(footprint["polygon"], dtype=float)
    return 2.0 * min(float(np.ptp(outline[:, 0])), 2.0 * float(np.hypot(outline[:, 0], outline[:, 1]).max()))


def tube(case: Case) -> float:
    """Return the largest displacement of an outline point from the path: that of the outermost point [m]."""
    off, turn = case.get("tracking", [0.0, 0.0])
    shape = case["footprint"]
    outline = np.array(shape["polygon"] if "polygon" in shape else [[shape["radius"] * (1.0 + AROUND), 0.0]], float)
    c, s = np.cos(turn), np.sin(turn)
    way = outline @ np.array([[c, s], [-s, c]]) - outline
    return float(off) + float(np.hypot(way[:, 0], way[:, 1]).max())


def clearance_rule(case: Case) -> tuple[float, float, float, float, float | None]:
    """Return required, at the dock, taper, run at the dock [m], and at a start that is too close, if given."""
    required, at_dock, taper, *more = case["clearance"]
    dock_run, at_start = (*more, *(0.0, None)[len(more) :])
    return required, at_dock, taper, dock_run, at_start


def taper_share(case: Case, distance: Floats) -> Floats:
    """Return 0 at the dock to 1 at the full requirement, Shape as `distance`, from the dock [m]."""
    _, _, taper, run, _ = clearance_rule(case)
    return np.clip((distance - run) / taper, 0.0, 1.0) if taper > 0.0 else (distance > run).astype(float)


def required_at(case: Case, poses: Floats, start_clearance: float, relief: float = 0.0) -> Floats:
    """Return the required clearance: a taper to the goal; growth from a start that is too close. Shape (n,) [m].

    The growth begins `relief` [m] from the start: 0 is the strict rule, `start_run` the weaker one, by which slightly
    less than the clearance of the start is sufficient, and with `at_start` it grows as from the dock. A start with the
    required clearance has no relief.
    """
    required, at_dock, _, _, at_start = clearance_rule(case)
    required += tube(case)
    goal, start = case["dock"]["pose"], case["start"]
    from_goal = np.hypot(poses[:, 0] - goal[0], poses[:, 1] - goal[1])
    from_start = np.hypot(poses[:, 0] - start[0], poses[:, 1] - start[1])
    has = max(start_clearance, 0.0)
    is_relieved = relief > 0.0 and has <= required + _SURELY
    enough = max(0.5 * has, has - 0.005) if is_relieved else has
    terms = [at_dock + (required - at_dock) * taper_share(case, from_goal)]
    terms.append(enough + 0.5 * np.clip(from_start - (relief if is_relieved else 0.0), 0.0, None))
    if is_relieved and at_start is not None:
        terms.append(at_start + (required - at_start) * taper_share(case, from_start))
    required_there: Floats = np.min(terms, axis=0)
    return required_there


def jumps_at_goal(case: Case) -> bool:
    """Whether the requirement at the goal itself is lower than arbitrarily close to it, which samples cannot show."""
    required, at_dock, taper, run, _ = clearance_rule(case)
    return bool(taper == 0.0 and run == 0.0 and required + tube(case) > at_dock)


def start_clearance(case: Case, world: World) -> float:
    """Return the clearance of the start, which determines the relief [m].

    For a round robot that of the circumscribed polygon, which the library uses: at most slightly smaller.
    """
    return float(world.clearances(np.array([case["start"]], dtype=float))[0]) - AROUND * world.radius


def sweep(
    case: Case,
    motion: Motion,
    world: World,
    *,
    refine: bool = True,
    relief: float = 0.0,
    begun_with: float | None = None,
) -> Sweep:
    """Return clearance and margin along the path.

    Args:
        case: Contains the clearance rule.
        motion: The path.
        world: The obstacles and the outline.
        relief: Relief of the clearance rule, see `required_at` [m].
        refine: Whether to search for minima between the initial samples; otherwise minima may be missed.
        begun_with: Clearance of the start [m]; None: in this world.
    """
    return _Search(case, motion, world, relief, begun_with).run(rounds=_ROUNDS if refine else 0)


class _Search:
    """Samples by (piece, share), in order of the path; intervals between neighbours of one piece."""

    def __init__(
        self, case: Case, motion: Motion, world: World, relief: float, begun_with: float | None = None
    ) -> None:
        self.case, self.motion, self.world, self.relief = case, motion, world, relief
        self.start_clearance = start_clearance(case, world) if begun_with is None else begun_with
        reach = world.reach
        self.travel = motion.way + reach * motion.turn  # of any outline point within each piece
        bend = np.where(motion.exact, motion.h * motion.turn, 0.0)  # |p''| for a share from 0 to 1
        with np.errstate(invalid="ignore"):  # a polyline that turns in place has infinite curvature
            rate = np.where(motion.exact, motion.h * np.abs(motion.k1 - motion.k0), 0.0)
        self.accel = bend + reach * (rate + motion.turn**2)

    def run(self, rounds: int) -> Sweep:
        piece, low, high = self._first()
        share = np.concatenate((low, [1.0]))
        at = np.concatenate((piece, piece[-1:]))
        first = self._measured(at, share)
        clearance, margin = first.clearance, first.margin
        found = [first]
        # The end of an interval is the start of the next: pieces are contiguous, but gears may jump, so measure those.
        last = np.append(clearance[1:-1], clearance[-1]), np.append(margin[1:-1], margin[-1])
        table: tuple[Floats, ...] = (piece.astype(float), low, high, clearance[:-1], last[0], margin[:-1], last[1])
        best = float(margin.min())
        for _ in range(rounds):
            hopeful = self._promising(table, best)
            if hopeful.size == 0 or best < -1e-2:
                break
            finer, measured = self._refined(tuple(column[hopeful[:_KEPT]] for column in table))
            left = hopeful[_KEPT:]  # beside a wall, many intervals look more promising than that with the minimum
            table = tuple(np.concatenate((new, column[left])) for new, column in zip(finer, table, strict=True))
            found.append(measured)
            best = min(best, float(measured.margin.min()))
        return Sweep(
            *(np.concatenate([getattr(one, spec.name) for one in found]) for spec in fields(Sweep)),
        )

    def _first(self) -> tuple[Ints, Floats, Floats]:
        way, turn = self.motion.way, self.motion.turn
        wanted = np.maximum(1, np.ceil(np.maximum(way / _STEP, turn / _TURN)))
        scale = min(1.0, _MOST / float(wanted.sum()))
        parts = np.maximum(1, np.floor(wanted * scale)).astype(np.int64)
        piece = np.repeat(np.arange(parts.size), parts)
        rank = np.arange(piece.size) - np.repeat(np.cumsum(parts) - parts, parts)
        low = rank / parts[piece]
        high = np.where(rank + 1 == parts[piece], 1.0, (rank + 1) / parts[piece])
        return piece, low, high

    def _measured(self, piece: Ints, share: Floats) -> Sweep:
        poses = self.motion.poses_at(piece, share)
        clearance = self.world.clearances(poses)
        margin = clearance - required_at(self.case, poses, self.start_clearance, self.relief)
        return Sweep(self.motion.s_at(piece, share), poses, clearance, margin)

    def _promising(self, table: tuple[Floats, ...], best: float) -> Ints:
        """Return intervals that could contain less than `best`, the most promising first."""
        piece, low, high, c0, c1, m0, m1 = table
        width = high - low
        piece = piece.astype(np.int64)
        travel = self.travel[piece] * width
        near = np.maximum(np.minimum(c0, c1), 1e-12)
        # Between two samples a distance decreases by at most half the travel, and, once the direction of the nearest
        # point is known, by a parabola with the acceleration along it and the rotation of that direction.
        with np.errstate(over="ignore"):
            dip = 0.125 * (self.accel[piece] * width**2 + travel**2 / near)
        dip = np.minimum(dip, 0.5 * travel)
        # A requirement that rises from the start and falls towards the goal exceeds its chord most where both meet.
        slope = self._slope()
        peak = 0.5 * slope / (0.5 + slope) * self.motion.way[piece] * width
        least = np.minimum(m0, m1) - dip - peak
        hopeful = np.flatnonzero((least < best - _ENOUGH) & (width > 1e-9))
        return hopeful[np.argsort(least[hopeful], kind="stable")]

    def _slope(self) -> float:
        """Return the slope of the requirement towards the goal; 0 if it jumps there."""
        required, at_dock, taper, _, _ = clearance_rule(self.case)
        return (required + tube(self.case) - at_dock) / taper if taper > 0.0 else 0.0

    def _refined(self, rows: tuple[Floats, ...]) -> tuple[tuple[Floats, ...], Sweep]:
        """Split every interval into parts: return the new table of intervals, and the samples."""
        piece, low, high, c0, c1, m0, m1 = rows
        inner = low[:, None] + (high - low)[:, None] * (np.arange(1, _PARTS) / _PARTS)
        owner = np.repeat(piece.astype(np.int64), _PARTS - 1)
        measured = self._measured(owner, inner.ravel())
        edges = np.column_stack((low, inner, high))
        c = np.column_stack((c0, measured.clearance.reshape(inner.shape), c1))
        m = np.column_stack((m0, measured.margin.reshape(inner.shape), m1))
        table = (np.repeat(piece, _PARTS), *(block.ravel() for a in (edges, c, m) for block in (a[:, :-1], a[:, 1:])))
        return table, measured
