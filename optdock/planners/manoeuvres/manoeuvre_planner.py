"""`ManoeuvrePlanner`: the plugin, and the stages of its search in ascending order of cost.

Each stage joins more poses near the start to more poses near the goal.
"""

from __future__ import annotations

import dataclasses
import heapq
import itertools
import math
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from pydantic import Field

from optdock.errors import InvalidValue, LifecycleError, NoValidPathCouldBeFound, PlannerCancelled
from optdock.geometry.arrays import readonly
from optdock.geometry.lazy import cached_property
from optdock.geometry.pose import Pose2
from optdock.planners.manoeuvres.connections import (
    TreeNodes,
    all_pairs,
    connections,
    free_manoeuvres,
    with_last,
    words_between,
)
from optdock.planners.manoeuvres.disc_routes import elastic_band
from optdock.planners.manoeuvres.end_trees import (
    BOTH,
    EXIT_TURN,
    GENTLE,
    ROOT,
    EndTrees,
    gears_into,
    sharpest_arcs,
    turning_radius,
)
from optdock.planners.manoeuvres.free_space import Effort, FreeSpace
from optdock.planners.manoeuvres.hybrid_a_star import hybrid_a_star
from optdock.planners.manoeuvres.price import ends_cost, gear_changes, least_price, least_prices
from optdock.planners.manoeuvres.reeds_shepp import TURNS
from optdock.planners.manoeuvres.roadmap import roadmap_ways
from optdock.planners.manoeuvres.turns import routes, turning_places, turns_and_drives
from optdock.plugins.interfaces import GlobalPlanner, LifecycleState, never_cancelled
from optdock.plugins.outcomes import Guess
from optdock.plugins.parameters import PluginParameters
from optdock.verification import end_clearances

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from optdock.geometry.arrays import FloatArray
    from optdock.model.path import Path
    from optdock.model.problem import DockingProblem
    from optdock.planners.manoeuvres.arcs import Arcs
    from optdock.planners.manoeuvres.disc_routes import Wavefront
    from optdock.planners.manoeuvres.turns import TurnSearch

__all__ = ["ManoeuvrePlanner", "ManoeuvrePlannerParameters", "Stages"]

_TIGHT = 0.5  # free share of the last arcs below which the dock is tight
# A better plan is searched for where the price exceeds this multiple of the price of the cheapest word without
# obstacles, and of the shortest way around the obstacles at full speed; and the number of nodes of that search. In 352
# cases a multiple of 1.6 makes plans 0.4 % dearer on average and one 41 %, at the same CPU time; three times as many
# nodes make one plan 2 % cheaper.
_DEAR, _NODES_FOR_A_BETTER_ONE = 1.3, 300
_TURN_TRIES = 4  # most guesses of turns and straight lines
_STAGED = 4  # most straight runs out of a dock along a wall at whose ends arcs begin
_TRIES = 4  # most different guesses per stage
_SLOW_STOP = 0.6  # [s] by which plans exceed the least price per stop, 0.4 to 1 s in 36 parking slots
_WORDS_PER_PAIR = 12  # words from the start to each staging pose
_SAMPLING = 40.0  # poses of a path per turning radius
_PLACES = readonly(np.linspace(0.0, 1.0, 17))  # shares of manoeuvres at which they are compared


class ManoeuvrePlannerParameters(PluginParameters):
    """Parameters of the manoeuvre planner."""

    turning_radius_factor: float = Field(
        1.25, ge=1.0, le=3.0, description="radius of the arcs tried first, in smallest turning radii of the robot"
    )


class ManoeuvrePlanner(GlobalPlanner):
    """Plan manoeuvres with cusps among obstacles: Reeds-Shepp words between trees of arcs around start and goal.

    Every path satisfies the required clearance of the problem and the turning radius of the robot. Its curvature jumps
    between arcs, so the path must be smoothed. The planner needs a problem in its context.

    Args:
        **parameters: See `ManoeuvrePlannerParameters`.

    Raises:
        InvalidValue: If a parameter is unknown, of the wrong type or out of range.
    """

    Parameters: ClassVar[type[PluginParameters]] = ManoeuvrePlannerParameters
    parameters: ManoeuvrePlannerParameters

    def on_configure(self) -> None:
        """Check the context.

        Raises:
            InvalidValue: If the context contains no problem.
        """
        if self.context.problem is None:
            raise InvalidValue(f"{self.context.name}: needs a problem; configure it with PluginContext(problem=...)")

    def create_plan(self, start: Pose2, goal: Pose2, cancel_checker: Callable[[], bool] = never_cancelled) -> Path:
        """Return the first path of `create_plans`.

        Raises:
            LifecycleError: If the planner is not configured.
            NoValidPathCouldBeFound: If the search found nothing, which does not prove that no path exists.
            PlannerCancelled: If `cancel_checker` returned True.
        """
        return next(guess for guess in self.create_plans(start, goal, cancel_checker) if guess is not None).path

    def create_plans(
        self,
        start: Pose2,
        goal: Pose2,
        cancel_checker: Callable[[], bool] = never_cancelled,
        better_than: Callable[[], float] = lambda: math.inf,
    ) -> Iterator[Guess | None]:
        """Yield collision-free manoeuvres stage by stage, in ascending order of price within each stage.

        Raises:
            LifecycleError: If the planner is not configured.
            NoValidPathCouldBeFound: If the search found nothing, which does not prove that no path exists.
            PlannerCancelled: If `cancel_checker` returned True.
        """
        problem = self.context.problem_at_hand(None)
        if self.state not in (LifecycleState.INACTIVE, LifecycleState.ACTIVE) or problem is None:
            raise LifecycleError(
                f"{self.context.name}: cannot plan when {self.state.value}; call configure(PluginContext(...)) first"
            )
        if start != problem.start or goal != problem.goal:
            problem = dataclasses.replace(problem, start=start, dock=dataclasses.replace(problem.dock, pose=goal))

        def _poll() -> None:
            if cancel_checker():
                raise PlannerCancelled("cancelled during the search for a manoeuvre")

        _poll()
        count, stages = 0, Stages(problem, self.parameters.turning_radius_factor, _poll, better_than)
        for guess in stages.guesses():
            if guess is not None:
                count += 1
                self.context.logger.debug("%s: %s, %r", self.context.name, guess.stage, guess.path)
            yield guess
        if count == 0 and math.isinf(better_than()):
            runs = stages.straight_runs()
            raise NoValidPathCouldBeFound(
                f"manoeuvre planner: {_reason(problem, runs)}",
                where={"start": start.as_array().tolist(), "goal": goal.as_array().tolist(), "straight_run": runs},
            )


def _reason(problem: DockingProblem, runs: Mapping[str, float]) -> str:
    """Return the message of a search without a result, including whether the dock can be entered on a straight line."""
    dock = problem.dock
    wanted = [gear for gear in runs if dock.direction.value in (gear, "auto")]
    if all(runs[gear] < dock.final_straight for gear in wanted):
        sides = " and ".join(f"{runs[gear]:.2f} m {gear}" for gear in wanted)
        other = [gear for gear in runs if gear not in wanted and runs[gear] >= dock.final_straight]
        hint = f"; it can be entered {other[0]}" if other else ""
        return (
            f"the dock requires direction {dock.direction.value} with a final straight of {dock.final_straight:.2f} m; "
            f"free are only {sides}{hint}"
        )
    return (
        f"no free manoeuvre found from {problem.start.brief} to {problem.goal.brief}; that is not a proof, there may "
        "still be one"
    )


class Stages:
    """One search in stages.

    `slack`: radius of the first words, as a multiple of the smallest turning radius. `poll`: raises an exception to end
    the search.
    """

    def __init__(
        self, problem: DockingProblem, slack: float, poll: Callable[[], None], better_than: Callable[[], float]
    ) -> None:
        self.problem, self._poll, self._better_than = problem, poll, better_than
        self.radius, self._slack = turning_radius(problem), slack
        self._known: list[_Way] = []

    @cached_property
    def _efforts(self) -> tuple[Effort, ...]:
        problem, margin = self.problem, 0.02 * self.problem.robot.footprint.width
        eased, sharp = self._slack * self.radius, self.radius
        # The weaker clearance rule of a start along a wall comes last; the certificate also tries the strict one first.
        is_too_close = end_clearances(problem).start < problem.path_clearance.required
        relief = problem.start_run if is_too_close else 0.0
        return (
            Effort(eased, margin, 12, 4000),
            Effort(sharp, margin, 12, 4000),
            Effort(eased, 0.0, 24, 4000, relief),
            Effort(sharp, 0.0, 80, 8000, relief),
        )

    def guesses(self) -> Iterator[Guess | None]:
        """Yield the guesses of all stages, the first of them after a few milliseconds."""
        turns = self.problem.may_turn_first
        most = self._better_than()
        if math.isfinite(most):
            distance = self.problem.start.distance_to(self.problem.goal)
            straight_on = float(least_prices(np.array([[distance], [-distance]]), self.problem).min())
            if straight_on >= most or (not turns and self._cheapest_word >= most):
                return  # no plan is cheaper, even without obstacles
        words = self._words(self._efforts[0])
        yield from self._cheaper_first(self._turn_and_drive(turns_and_drives), words) if turns else words
        yield from self._words(self._efforts[1])  # words without a margin are tried by hybrid A*
        if turns and math.isinf(self._better_than()):
            yield from self._turn_and_drive(routes)
        if not self._is_worth_a_search():
            return
        if math.isinf(self._better_than()):
            yield from self._along_walls()
        # If the dock itself is tight, its surroundings are the difficult part, and the search by poses goes first.
        is_tight = self.trees.room_before_dock(self._efforts[0]) < _TIGHT * EXIT_TURN * self._efforts[0].radius
        first, second = (self._along_routes, self._hybrid_a_star)[:: -1 if is_tight else 1]
        yield from first()
        if math.isinf(self._better_than()) or (not is_tight and self._is_worth_a_search()):
            yield from second()

    def _cheaper_first(self, *stages: Iterator[Guess]) -> Iterator[Guess]:
        for guess in heapq.merge(*stages, key=lambda one: least_price(one.path, self.problem)):
            if least_price(guess.path, self.problem) < self._better_than():
                yield guess

    @cached_property
    def space(self) -> FreeSpace:
        """Free space for collision checks."""
        return FreeSpace(self.problem, self._poll)

    @cached_property
    def trees(self) -> EndTrees:
        """Trees of straight lines and arcs at the start and at the dock."""
        return EndTrees(self.problem, self.space)

    def straight_runs(self) -> dict[str, float]:
        """Return the free straight length [m] in front of the dock for entering the dock in each gear."""
        return self.trees.straight_runs(self._efforts[-1])

    @cached_property
    def _ends_cost(self) -> float:
        return ends_cost(self.problem)

    @cached_property
    def _cheapest_word(self) -> float:
        """The least price [s] of a word to the final straight, without regard to obstacles."""
        straights = self.problem.dock.final_straight * np.array(gears_into(self.problem.dock))
        ends = [self.problem.goal @ Pose2(-straight, 0.0, 0.0) for straight in straights.tolist()]
        starts, goals = (
            np.array([pose.as_array() for pose in some]) for some in ([self.problem.start] * len(ends), ends)
        )
        words = words_between(starts, goals, self.radius, self.problem.robot, len(TURNS))
        ways = with_last(words.lengths, straights[words.pair])
        return float(least_prices(ways, self.problem).min(initial=math.inf))

    def _turn_and_drive(self, search: TurnSearch) -> Iterator[Guess]:
        """Yield manoeuvres of turns in place and straight lines, with and without rounded corners."""
        known: set[str] = set()
        for effort in (self._efforts[0], self._efforts[-1]):
            if effort.margin == 0.0 and math.isfinite(self._better_than()):
                return
            start, goal = self.problem.start.as_array(), self.problem.goal.as_array()
            exits = self.trees.straight_exits(effort, turning_places(start, goal, self.space))
            entries = self.trees.staging(effort, turning_places(goal, start, self.space))
            found = search(exits, entries, self.space, effort, self._worthwhile)
            for way in itertools.islice(found, _TURN_TRIES):
                path = way.path(self.radius / _SAMPLING, self.problem.goal, self.problem.frame)
                if path is None or path.digest in known:
                    continue
                if least_price(path, self.problem) < self._better_than():
                    known.add(path.digest)
                    yield Guess(path, "turn and drive")

    @cached_property
    def _staging(self) -> TreeNodes:
        return self.trees.staging(self._efforts[0])

    def _words(self, effort: Effort) -> Iterator[Guess]:
        """Yield words from the start to the staging poses that satisfy the margin of `effort`."""
        staging = self._staging
        if staging.rows.size == 0:
            return
        start = self.trees.from_start()
        found = connections(*all_pairs(TreeNodes(start, ROOT), staging), effort.radius, self.space, _WORDS_PER_PAIR)
        found = found.rows(slice(int(found.prices.searchsorted(self._worthwhile()))))
        # The price excludes most words and is checked first: the poses of a word take a hundred times as long.
        ways = with_last(found.lengths, -staging.tree.lengths[found.entries])
        found = found.at_prices(least_prices(ways, self.problem), self._better_than())
        ways_in = free_manoeuvres(
            found, start, staging.tree, self.space, effort, self._better_than, per_change=_SLOW_STOP
        )
        yield from self._offered("Reeds-Shepp", ways_in)

    def _is_worth_a_search(self) -> bool:
        """Whether there is no plan, or the plan costs much more than the shortest route around the obstacles."""
        best = self._better_than()
        if math.isinf(best):
            return True
        if best <= _DEAR * self._cheapest_word:
            return False
        limits, goal = self.problem.robot.limits, self.problem.goal.as_array()[None, :2]
        longest = (best / _DEAR - self._ends_cost) * max(limits.max_speed, limits.max_reverse_speed)
        # The search needs the route of the wider disc; it is the longer one.
        return bool(
            self._wave_for_routes.lengths(goal)[0] < longest or self._wave_from_start.lengths(goal)[0] < longest
        )

    @cached_property
    def _wave_for_routes(self) -> Wavefront:
        return self.space.wavefront(self.problem.start.as_array()[:2], self._route_radius)

    @property
    def _route_radius(self) -> float:
        return 0.5 * self.space.footprint.width + self.problem.path_clearance.required

    @cached_property
    def _wave_from_start(self) -> Wavefront:
        return self.space.wavefront(self.problem.start.as_array()[:2])

    def _along_routes(self) -> Iterator[Guess]:
        """Yield sequences of words between poses along the shortest route of a disc around the obstacles."""
        start, radius = self.problem.start.as_array(), self._route_radius
        for effort in self._efforts[:2]:
            if not self._is_worth_a_search():
                return
            exits, (tree, rows) = self.trees.exits(effort).nodes, self.trees.staging(effort)
            entries = TreeNodes(tree, rows[rows > 0])
            if entries.rows.size == 0:
                return
            target = tree.poses[entries.rows[0], :2]
            way = self._wave_for_routes.way(target)
            if way is None:
                return
            route = np.concatenate((start[None, :2], way[1:-1], target[None]))
            route = elastic_band(route, self.space, effort.radius + radius)
            ways = roadmap_ways(exits, entries, self.space, effort, route, self._worthwhile)
            yield from self._offered("roadmap", ways)

    def _along_walls(self) -> Iterator[Guess]:
        """Yield words from arcs that leave a wall next to the start to arcs that leave a wall next to the dock."""
        exits, effort, gears = self.trees.from_start(), self._efforts[2], np.array(self.trees.start_gears)
        away = sharpest_arcs(exits, np.zeros(gears.size, dtype=np.int64), gears, self.space, effort)
        if away.size == 0:
            return
        entries, rows = self.trees.staging(effort)
        before, rows = len(entries), rows[rows > 0][:_STAGED]
        there = sharpest_arcs(entries, rows, entries.signs[rows], self.space, effort)
        if len(exits) - 1 == away.size and len(entries) - before == there.size:
            return  # full lock is free from the beginning
        pairs = all_pairs(TreeNodes(exits, np.append(0, away)), TreeNodes(entries, np.concatenate((rows, there))))
        found = connections(*pairs, effort.radius, self.space, _WORDS_PER_PAIR)
        ways = free_manoeuvres(found, exits, entries, self.space, effort, self._worthwhile)
        yield from itertools.islice(self._offered("sharpest arcs", ways), 1)  # all tries share the arcs along the walls

    def _hybrid_a_star(self) -> Iterator[Guess | None]:
        """Yield manoeuvres of hybrid A* with increasing effort, and None after each effort without a plan."""
        goal, efforts = self.problem.goal.as_array()[:2], self._efforts
        if math.isfinite(self._better_than()):
            efforts = (self._efforts[0]._replace(nodes=_NODES_FOR_A_BETTER_ONE),)
        self._poll()
        from_ends = self._wave_from_start, self.space.wavefront(goal)
        self._poll()
        if math.isinf(self._wave_from_start.lengths(goal[None])[0]):
            yield None
            return
        for effort in efforts:
            exits, entries = self.trees.exits(effort), self.trees.entries(effort)
            if exits.nodes.rows.size < 2 and effort.start_relief > 0.0:
                exits = self.trees.exits(effort, GENTLE)  # along a wall
            if exits.nodes.rows.size < 2 or entries.rows.size == 0:
                continue  # no arc leads away from the start, or no straight run out of the dock
            # The search begins at the tighter end; words reach the other one.
            from_start = exits.room < self.trees.room_before_dock(effort)
            if from_start:
                more, _ = self.trees.grown(entries, BOTH, effort)
                entries = TreeNodes(entries.tree, np.append(entries.rows, more))
            ways = hybrid_a_star(
                exits.nodes,
                entries,
                self.space,
                effort,
                from_ends[from_start],
                self._worthwhile,
                from_start=from_start,
                bends=exits.bends,
            )
            yield from self._offered("hybrid A*", ways)
            if math.isfinite(self._better_than()):
                return
            yield None

    def _offered(self, stage: str, found: Iterator[Arcs]) -> Iterator[Guess]:
        """Yield the first few paths that differ from all earlier paths and may be cheaper than the best plan."""
        offered = 0
        for arcs in found:
            if not self._may_be_cheaper(arcs) or not self._is_another_way(arcs):
                continue
            offered += 1
            path = arcs.path(self.radius / _SAMPLING, self.problem.goal.as_array(), self.problem.frame)
            yield Guess(path, stage)
            if offered == _TRIES:
                return

    def _may_be_cheaper(self, arcs: Arcs) -> bool:
        """Whether the expected price of a manoeuvre is below the price to beat."""
        best = self._better_than()
        if math.isinf(best):
            return True
        stops = gear_changes(arcs.lengths)
        return bool(least_prices(arcs.lengths, self.problem)[0] + _SLOW_STOP * stops[0] < best)

    def _worthwhile(self) -> float:
        """Return the estimated price at or above which a manoeuvre cannot be cheaper than the best plan."""
        return self._better_than() - self._ends_cost

    def _is_another_way(self, arcs: Arcs) -> bool:
        """Whether a manoeuvre differs from all manoeuvres yielded before by more than half the width of the robot."""
        way, near = _Way(arcs), 0.5 * self.problem.robot.footprint.width
        if any(np.abs(way.places - other.places).max() < near for other in self._known):
            return False
        self._known.append(way)
        return True


class _Way:
    """A manoeuvre that was yielded, with the positions at which others are compared with it, computed on demand."""

    def __init__(self, arcs: Arcs) -> None:
        self._arcs = arcs

    @cached_property
    def places(self) -> FloatArray:
        """Shape (17, 2) [m]."""
        return self._arcs.poses_at_shares(_PLACES)[0, :, :2]
