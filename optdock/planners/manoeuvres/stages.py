"""The stages of the search, cheapest first: each joins more poses near the start to more poses near the goal."""

from __future__ import annotations

import functools
import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.dock import DockDirection
from optdock.outcomes import Guess
from optdock.planners.manoeuvres.connections import Nodes, connections, free_manoeuvres
from optdock.planners.manoeuvres.free_space import FreeSpace
from optdock.planners.manoeuvres.hybrid_a_star import hybrid_a_star
from optdock.planners.manoeuvres.price import least_price
from optdock.planners.manoeuvres.tree import ArcTree, Moves

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from optdock.geometry.arrays import FloatArray, IntArray
    from optdock.planners.manoeuvres.arcs import Arcs
    from optdock.problem import DockingProblem

__all__ = ["Stages"]

_RUNS = np.array([0.0, 0.25, 0.5, 1.0, 1.5, 2.0, 3.0])  # straight runs beyond the shortest one, in turning radii
_ENTRY_TURNS = np.array([0.25, 0.5, 0.75, 1.0, 1.25, 1.57])  # [rad] of entry arcs
_EXIT_TURNS = np.array([0.3, 0.7, 1.2])  # [rad] of exit arcs; straight ones are as long
_ENTRY_ROWS, _EXIT_ROWS = 64, 19  # nodes that are joined at most
_NODES = 2000
_TRIES = 4  # different ways that one stage offers at most
_WORDS_PER_PAIR = 12
_LOOKS = 300  # words that one stage looks at most
_SAMPLING = 40.0  # poses of a path per turning radius


class _Effort(NamedTuple):
    """How much room a way must leave for the smoother: turning radius and margin beside the clearance [m]."""

    radius: float
    margin: float


class Stages:
    """One search.

    Args:
        problem: From where, to where, among what.
        slack: Radius of the first words in smallest turning radii.
        poll: Raises where the caller wants no more.
        better_than: See `GlobalPlanner.create_plans`.
    """

    def __init__(
        self, problem: DockingProblem, slack: float, poll: Callable[[], None], better_than: Callable[[], float]
    ) -> None:
        self.problem, self._better_than = problem, better_than
        self.space = FreeSpace(problem, poll)
        limits, footprint = problem.robot.limits, problem.robot.footprint
        self.radius = turning_radius(problem)
        rate = limits.max_curvature_rate
        # Half of the way on which the steering angle builds up lies before the arc.
        self._wind_up = 0.5 / (self.radius * rate) if math.isfinite(rate) else 0.0
        margin = 0.02 * footprint.width
        self._efforts = tuple(_Effort(factor * self.radius, keep) for keep in (margin, 0.0) for factor in (slack, 1.0))
        self._known: list[FloatArray] = []

    def guesses(self) -> Iterator[Guess]:
        """The guesses of all stages."""
        for stage in (self._words, self._entry_arcs, self._exit_arcs):
            yield from stage()
        if math.isinf(self._better_than()):
            yield from self._hybrid_a_star()

    @property
    def _gears(self) -> tuple[float, ...]:
        """Signs of the lengths of the last motion."""
        wanted = self.problem.dock.direction
        return {DockDirection.FORWARD: (1.0,), DockDirection.BACKWARD: (-1.0,)}.get(wanted, (1.0, -1.0))

    @functools.cached_property
    def _start(self) -> Nodes:
        return Nodes(ArcTree(self.problem.start.as_array(), self.problem.robot.limits, 1), np.zeros(1, dtype=np.int64))

    @functools.cache  # noqa: B019 - a search lives as long as its call
    def _staging(self, effort: _Effort) -> Nodes:
        """Straight runs out of the dock, as far as they are free, and where the final straight may begin."""
        tree = ArcTree(self.problem.goal.as_array(), self.problem.robot.limits, -1)
        moves = Moves.of(tuple(-gear for gear in self._gears), (0.0,))
        straight = self.problem.dock.final_straight
        stations = np.unique(straight + self._wind_up + self.radius * _RUNS)
        if straight > 0.0:
            stations = np.concatenate(([straight], stations))
        rows = self._grown(tree, np.zeros(1, dtype=np.int64), moves, stations, effort)
        rows = rows[np.abs(tree.lengths[rows]) >= straight]
        return Nodes(tree, rows if straight > 0.0 else np.concatenate(([0], rows)))

    @functools.cache  # noqa: B019
    def _entries(self, effort: _Effort) -> Nodes:
        """Arcs out of the staging poses, in the gear of the run."""
        tree, staging = self._staging(effort)
        found = [staging]
        kappa = 1.0 / effort.radius
        for gear in self._gears:
            mine = staging[(tree.signs[staging] != gear) & (np.abs(tree.lengths[staging]) <= 2.0 * self.radius)]
            moves = Moves.of((-gear,), (kappa, -kappa))
            found.append(self._grown(tree, mine, moves, effort.radius * _ENTRY_TURNS, effort))
        rows = np.concatenate(found)
        return Nodes(tree, rows[np.argsort(tree.prices[rows], kind="stable")][:_ENTRY_ROWS])

    @functools.cache  # noqa: B019
    def _exits(self, effort: _Effort) -> Nodes:
        """Arcs and lines out of the start."""
        tree = ArcTree(self.problem.start.as_array(), self.problem.robot.limits, 1)
        speed, kappa = self.problem.start_speed, 1.0 / effort.radius
        moves = Moves.of((1.0, -1.0) if speed == 0.0 else (math.copysign(1.0, speed),), (0.0, kappa, -kappa))
        root = np.zeros(1, dtype=np.int64)
        rows = self._grown(tree, root, moves, effort.radius * _EXIT_TURNS, effort)
        return Nodes(tree, rows[np.argsort(tree.prices[rows], kind="stable")][:_EXIT_ROWS])

    def _grown(self, tree: ArcTree, rows: IntArray, moves: Moves, stations: FloatArray, effort: _Effort) -> IntArray:
        return tree.grow(rows, moves, stations, self.space, effort.margin)

    def _words(self) -> Iterator[Guess]:
        """Words from the start to the staging poses."""
        for effort in self._efforts:
            yield from self._joined("Reeds-Shepp", self._start, self._staging(effort), effort)

    def _entry_arcs(self) -> Iterator[Guess]:
        """Words from the start to the ends of entry arcs."""
        for effort in self._efforts:
            yield from self._joined("entry arcs", self._start, self._entries(effort), effort)

    def _exit_arcs(self) -> Iterator[Guess]:
        """Words from the ends of exit arcs to the ends of entry arcs."""
        for effort in self._efforts:
            yield from self._joined("exit arcs", self._exits(effort), self._entries(effort), effort)

    def _hybrid_a_star(self) -> Iterator[Guess]:
        wavefront = self.space.wavefront(self.problem.start.as_array()[:2])
        for effort in self._efforts:
            self._staging.cache_clear()
            ways = hybrid_a_star(
                self._start, self._staging(effort), self.space, effort.radius, effort.margin, _NODES, wavefront
            )
            yield from self._offered("hybrid A*", ways)

    def _joined(self, stage: str, exits: Nodes, entries: Nodes, effort: _Effort) -> Iterator[Guess]:
        if exits.rows.size == 0 or entries.rows.size == 0:
            return
        found = connections(exits, entries, effort.radius, self.space, _WORDS_PER_PAIR).rows(slice(_LOOKS))
        yield from self._offered(stage, free_manoeuvres(found, exits.tree, entries.tree, self.space, effort.margin))

    def _offered(self, stage: str, found: Iterator[tuple[float, Arcs]]) -> Iterator[Guess]:
        """The first few of the ways found that are unlike those offered before and may beat the best plan."""
        offered = 0
        for price, arcs in found:
            if price >= self._better_than():
                continue
            path = arcs.path(self.radius / _SAMPLING, self.problem.goal.as_array(), self.problem.frame)
            if least_price(path, self.problem) >= self._better_than() or not self._is_another_way(arcs):
                continue
            offered += 1
            yield Guess(path, stage)
            if offered == _TRIES:
                return

    def _is_another_way(self, arcs: Arcs) -> bool:
        """Whether a way is not one that has been offered, but for a little."""
        places = arcs.poses_at_shares(np.linspace(0.0, 1.0, 17))[0, :, :2]
        near = 0.5 * self.problem.robot.footprint.width
        if any(np.abs(places - other).max() < near for other in self._known):
            return False
        self._known.append(places)
        return True


def turning_radius(problem: DockingProblem) -> float:
    """The smallest turning radius that a search makes use of [m].

    A robot that may turn more sharply than it can change its curvature on a turn of a radian, or than within itself,
    gains little by it.
    """
    limits = problem.robot.limits
    sharpest = min(limits.max_curvature, 2.0 / problem.robot.footprint.circumscribed_radius)
    return 1.0 / min(sharpest, math.sqrt(2.0 * limits.max_curvature_rate))
