"""Plans for a scene that changes in small steps while the hand drags: deformed first, planned anew at rest.

While the hand moves, the previous result is carried over to the new scene if that is possible: the last proof of
impossibility is checked for the new scene, or the last certified path is deformed to the new start and dock, pushed off
obstacles and certified. Otherwise, and always when the hand is at rest, the scene is planned without regard to earlier
results, so that the result at rest depends only on the scenario.
"""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple, cast

from optdock.config.simulated_drive import WorldDeviations, driven
from optdock.deadline import garbage_collection_paused
from optdock.errors import Cancelled, InvalidPath, NoMotionExists, OptdockError
from optdock.impossibility import ImpossibilityProof, check_impossibility
from optdock.planning.plan import DockPlan
from optdock.simulation import beyond_proof
from optdock.survey.questions import deformed_plan
from optdock.ui.drawn_plan import drawn_plan
from optdock.ui.driven_plan import driven_plan

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.config import Scenario
    from optdock.impossibility import NoMotionProof
    from optdock.model.path import Path
    from optdock.model.problem import ProblemFingerprint
    from optdock.ui.drawn_plan import DrawnPlan, Method
    from optdock.ui.driven_plan import DrivenPlan

__all__ = ["HandPlanning", "PlanRequest"]

# A deformed motion may cost this much more than the motion that was planned last, as a factor and in seconds.
_DEARER = (1.1, 1.0)
_DEFORMING = 0.1  # [s], longest time for a deformation with all its pushes


class PlanRequest(NamedTuple):
    """Request of the page.

    Attributes:
        number: Number of the request, which increases.
        fingerprint: Fingerprint of the scene on the page, returned with the answer.
        scenario: The scenario.
        in_hand: Whether the scene is being dragged.
        picture_only: Whether words, tables and curves of the answer are left out.
        drive: Disturbances of a simulated drive and the seed of its noise; None: the scenario is planned.
    """

    number: int
    fingerprint: str
    scenario: Scenario
    in_hand: bool = False
    picture_only: bool = False
    drive: tuple[WorldDeviations, int] | None = None


class HandPlanning:
    """Answers to successive requests; keeps the last certified path, the last proof and the last plan."""

    def __init__(self) -> None:
        self._path: Path | None = None
        self._price = 0.0  # of the motion that was planned last
        self._proof: NoMotionProof | None = None  # of the previous answer
        self._proven_in: ProblemFingerprint | None = None  # fingerprint of its problem without the start
        self._plan: DockPlan | None = None
        self._planned_for = ""

    def answer(self, request: PlanRequest, is_cancelled: Callable[[], bool]) -> DrawnPlan | DrivenPlan:
        """Return the answer to a request; errors are part of the answer.

        Args:
            request: The request.
            is_cancelled: Whether to end the call; polled at least every 5 ms by most stages.
        """
        began = time.monotonic()
        if request.drive is not None:
            return self._driven(request, is_cancelled)
        method, result = self.planned(request.scenario, is_cancelled, in_hand=request.in_hand)
        self._plan = result if isinstance(result, DockPlan) else None
        self._planned_for = request.fingerprint
        asked, seconds = (request.number, request.fingerprint), time.monotonic() - began
        problem, only = request.scenario.problem, request.picture_only
        return drawn_plan(asked, problem, result, method, seconds, picture_only=only)

    def planned(
        self, scenario: Scenario, is_cancelled: Callable[[], bool], *, in_hand: bool
    ) -> tuple[Method, DockPlan | OptdockError]:
        """Return the origin of a result, and the plan or the error."""
        if in_hand:
            with garbage_collection_paused():
                proof = self._checked_proof(scenario)
                if proof is not None:
                    return "proven", proof
                plan = self._deformed(scenario, is_cancelled)
            if plan is not None:
                self._path, self._proof = plan.path, None
                return "deformed", plan
        result = _planned(scenario, is_cancelled)
        if isinstance(result, DockPlan):
            self._path, self._price, self._proof = result.path, result.price, None
        elif isinstance(result, NoMotionExists):
            self._proof = cast("NoMotionProof", result.proof)  # checked by `plan_dock`
            self._proven_in = _world(scenario)
        elif not isinstance(result, Cancelled):
            self._proof = None
        return "planned", result

    def _checked_proof(self, scenario: Scenario) -> NoMotionExists | None:
        """Return the error with the proof of the previous answer, if it also holds for this scenario.

        The bottleneck of the proof is left out if anything but the start has changed, because it may have another width
        or place.
        """
        proof = self._proof
        # That the straight into the dock is blocked is found anew in milliseconds, with the present clearance.
        if not isinstance(proof, ImpossibilityProof) or not check_impossibility(proof, scenario.problem):
            return None
        world = _world(scenario)
        if world != self._proven_in:
            self._proof = proof = replace(proof, bottleneck=None)
            self._proven_in = world
        return NoMotionExists(proof.message, proof=proof, where=proof.where)

    def _deformed(self, scenario: Scenario, is_cancelled: Callable[[], bool]) -> DockPlan | None:
        """Return the plan along the deformed last path, unless it costs much more than the one that was planned."""
        problem = scenario.problem
        if self._path is None or not problem.starts_at_rest or problem.start_curvature:
            return None
        with suppress(InvalidPath):  # of another frame
            path = self._path.with_frame(problem.frame)
            plan = deformed_plan(path, problem, scenario, min(_DEFORMING, scenario.time_budget), is_cancelled)
            factor, more = _DEARER
            if plan is not None and plan.price <= factor * self._price + more:
                return plan
        return None

    def _driven(self, request: PlanRequest, is_cancelled: Callable[[], bool]) -> DrivenPlan:
        """Return the simulated drive of the last plan, or of a new plan if the last one belongs to another scene."""
        assert request.drive is not None
        scenario, asked = request.scenario, (request.number, request.fingerprint)
        plan: DockPlan | OptdockError | None = self._plan if self._planned_for == request.fingerprint else None
        if plan is None:
            plan = _planned(scenario, is_cancelled)
        if isinstance(plan, OptdockError):
            return driven_plan(asked, plan)
        world, seed = request.drive
        try:
            run = driven(scenario, plan, seed, world, is_cancelled)
        except OptdockError as error:
            return driven_plan(asked, error)
        return driven_plan(asked, (run, plan, beyond_proof(plan.path, plan.problem, plan.certificate, run.poses)))


def _planned(scenario: Scenario, is_cancelled: Callable[[], bool]) -> DockPlan | OptdockError:
    """Return the plan of a scenario, or the error."""
    try:
        return scenario.plan(cancel_checker=is_cancelled)
    except OptdockError as error:
        return error


def _world(scenario: Scenario) -> ProblemFingerprint:
    return scenario.problem.fingerprint._replace(start="")
