"""The manoeuvre planner as a plugin."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, ClassVar

from pydantic import Field

from optdock.errors import InvalidValue, LifecycleError, NoValidPathCouldBeFound, PlannerCancelled
from optdock.planners.manoeuvres.stages import Stages
from optdock.plugins.interfaces import GlobalPlanner, LifecycleState, never_cancelled
from optdock.plugins.parameters import PluginParameters

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from optdock.geometry.pose import Pose2
    from optdock.model.path import Path
    from optdock.model.problem import DockingProblem
    from optdock.plugins.outcomes import Guess

__all__ = ["ManoeuvrePlanner", "ManoeuvrePlannerParameters"]


class ManoeuvrePlannerParameters(PluginParameters):
    """Parameters of the manoeuvre planner."""

    turning_radius_factor: float = Field(
        1.25, ge=1.0, le=3.0, description="radius of the arcs tried first, in smallest turning radii of the robot"
    )


class ManoeuvrePlanner(GlobalPlanner):
    """Plans manoeuvres with cusps among obstacles: Reeds-Shepp words between trees of arcs around start and goal.

    Every path keeps the clearance that the problem asks for and the turning radius of the robot; its curvature jumps
    where arcs meet, which is left to a smoother. It needs a problem, so it must be configured before it plans.

    Args:
        **parameters: See `ManoeuvrePlannerParameters`.

    Raises:
        InvalidValue: A parameter is unknown, of the wrong type or out of range.
    """

    Parameters: ClassVar[type[PluginParameters]] = ManoeuvrePlannerParameters
    parameters: ManoeuvrePlannerParameters

    def on_configure(self) -> None:
        """Check the surroundings.

        Raises:
            InvalidValue: The context holds no problem.
        """
        if self.context.problem is None:
            raise InvalidValue(f"{self.context.name}: needs a problem; configure it with PluginContext(problem=...)")

    def create_plan(self, start: Pose2, goal: Pose2, cancel_checker: Callable[[], bool] = never_cancelled) -> Path:
        """The first of `create_plans`.

        Raises:
            LifecycleError: The planner is not configured.
            NoValidPathCouldBeFound: Nothing was found; that is not a proof that there is nothing.
            PlannerCancelled: `cancel_checker` returned True.
        """
        return next(guess for guess in self.create_plans(start, goal, cancel_checker) if guess is not None).path

    def create_plans(
        self,
        start: Pose2,
        goal: Pose2,
        cancel_checker: Callable[[], bool] = never_cancelled,
        better_than: Callable[[], float] = lambda: math.inf,
    ) -> Iterator[Guess | None]:
        """Collision-free manoeuvres, stage by stage, within a stage the cheapest first.

        Raises:
            LifecycleError: The planner is not configured.
            NoValidPathCouldBeFound: Nothing was found; that is not a proof that there is nothing.
            PlannerCancelled: `cancel_checker` returned True.
        """
        problem = self._problem(start, goal)

        def _poll() -> None:
            if cancel_checker():
                raise PlannerCancelled("cancelled while a manoeuvre was searched for")

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
                f"manoeuvre planner: {_why_not(problem, runs)}",
                where={"start": start.as_array().tolist(), "goal": goal.as_array().tolist(), "straight_run": runs},
            )

    def _problem(self, start: Pose2, goal: Pose2) -> DockingProblem:
        problem = self.context.problem_at_hand(None)
        if self.state not in (LifecycleState.INACTIVE, LifecycleState.ACTIVE) or problem is None:
            raise LifecycleError(
                f"{self.context.name}: cannot plan when {self.state.value}; call configure(PluginContext(...)) first"
            )
        if start == problem.start and goal == problem.goal:
            return problem
        return dataclasses.replace(problem, start=start, dock=dataclasses.replace(problem.dock, pose=goal))


def _why_not(problem: DockingProblem, runs: Mapping[str, float]) -> str:
    """What is known when nothing was found: whether the dock can be entered at all in the gear that it asks for."""
    dock = problem.dock
    wanted = [gear for gear in runs if dock.direction.value in (gear, "auto")]
    if all(runs[gear] < dock.final_straight for gear in wanted):
        sides = " and ".join(f"{runs[gear]:.2f} m {gear}" for gear in wanted)
        other = [gear for gear in runs if gear not in wanted and runs[gear] >= dock.final_straight]
        hint = f"; {other[0]} it can be entered" if other else ""
        return (
            f"the dock asks for {dock.direction.value} with a final straight of {dock.final_straight:.2f} m, of which "
            f"the clearance leaves {sides}{hint}"
        )
    return (
        f"no free manoeuvre found from {problem.start.brief} to {problem.goal.brief}; that is not a proof, there may "
        "still be one"
    )
