"""`plan_dock` on random docking problems: results must be correct, and exceptions typed."""

from __future__ import annotations

import functools
import math
import time
from collections import Counter
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from experiments.fuzz.case import Verdict
from experiments.fuzz.doors import law_spec, path_spec, problem_of, problem_spec
from experiments.fuzz.generators.docking import docking_problem
from experiments.fuzz.kinds import paths, trajectories
from experiments.fuzz.lanes import compares_lanes, is_repeated, motion_differs, repeated
from experiments.fuzz.oracle.motion import motion_of
from experiments.fuzz.oracle.world import World
from experiments.fuzz.truth import says_yes
from optdock.errors import CertificationFailed, OptdockError
from optdock.geometry.pose import Pose2
from optdock.model.clearance_rule import ClearanceRule
from optdock.planning.pipeline import plan_dock, warm_up

if TYPE_CHECKING:
    from experiments.fuzz.case import Case
    from optdock.model.problem import DockingProblem
    from optdock.planning.plan import DockPlan

__all__ = ["draw", "judge", "plan_numbers"]

_OTHERS = 3  # further problems of a case, with another start and another clearance
_FAMILIES = 0.25  # share of problems from `experiments.families`
_LATE = 0.2  # [s] of CPU time past the budget
# [s]: budgets of plans in both lanes, on the counted clock. The lanes read it unequally often, so a budget may end in
# one lane alone before the last guess: plans that differ are compared again with a budget that ends in neither.
_COUNTED = 0.5, 50.0
_AGREEMENT = 1e-6  # [m], [rad] between a trajectory's poses and its path


def draw(rng: np.random.Generator) -> Case:
    """Draw a random docking problem, or an instance of a family."""
    own = rng.spawn(1)[0]
    others = [[*own.normal(0.0, (0.05, 0.05, 0.05)).tolist(), own.uniform(0.5, 1.1)] for _ in range(_OTHERS)]
    case = {**docking_problem(rng), "repeated": is_repeated(own), "others": others}
    if rng.uniform() >= _FAMILIES:
        return case
    from experiments.families import FAMILIES, instance

    family, member = sorted(FAMILIES)[int(rng.integers(len(FAMILIES)))], int(rng.integers(1_000_000))
    scene = problem_spec(instance(family, member).problem)
    if rng.uniform() < 0.5:
        scene["zone"] = case["zone"]
    kept = {key: case[key] for key in ("kind", "budget", "repeated", "others")}
    return {**scene, **kept, "family": [family, member]}


@functools.cache
def _warm() -> None:
    warm_up()


def judge(case: Case) -> Verdict:
    """Plan, and check the result; if there is a plan, also for the further problems of the case."""
    _warm()
    try:
        problem = problem_of(case)
    except OptdockError as error:
        return Verdict(f"input refused: {type(error).__name__}", str(error))
    world = World.of(case)
    first = _judged(_alone(case), problem, world)
    if first.is_fault or not first.checked:
        return first
    checked = Counter(first.checked)
    for *shift, factor in case.get("others", ()):
        clearance = [factor * case["clearance"][0], factor * case["clearance"][1], *case["clearance"][2:]]
        start = [float(one + by) for one, by in zip(case["start"], shift, strict=True)]
        other = {**_alone(case), "start": start, "clearance": clearance, "repeated": False}
        found = _judged(other, replace(problem, start=Pose2(*start), clearance=ClearanceRule(*clearance)), world)
        if found.is_fault:
            return found if found.evidence is not None else Verdict(found.outcome, found.detail, other)
        checked.update(found.checked)
    return Verdict(first.outcome, checked=dict(checked))


def _alone(case: Case) -> Case:
    """Return a case without further problems."""
    return {key: value for key, value in case.items() if key != "others"}


def _judged(case: Case, problem: DockingProblem, world: World) -> Verdict:
    began = time.process_time()
    verdict, plan = Verdict("certified", checked={"plans": 1}), None
    try:
        plan = plan_dock(problem, time_budget=case["budget"])
    except CertificationFailed as error:
        return _failed(case, error)
    except OptdockError as error:
        verdict = Verdict(type(error).__name__)
    spent = time.process_time() - began - case["budget"]
    wrong = None if plan is None else _refuted(case, plan, world)
    if wrong is None and spent > _LATE:
        over = f"{1e3 * spent:.0f} ms of CPU past a budget of {1e3 * case['budget']:.0f} ms"
        wrong = Verdict("late", f"{verdict.outcome}: {over}")
    return wrong or _differs(case, problem, plan, verdict) or verdict


def _differs(case: Case, problem: DockingProblem, plan: DockPlan | None, verdict: Verdict) -> Verdict | None:
    """Return the difference to the twin lane if lanes are compared; count the comparison."""
    if plan is None or not compares_lanes():
        return None
    wrong = motion_differs(plan.trajectory, problem)
    if wrong is None and case.get("repeated"):
        for budget in _COUNTED:
            wrong = repeated(lambda budget=budget: plan_dock(problem_of(case), time_budget=budget), plan_numbers)
            if wrong is None:
                break
        verdict.checked["planned again by NumPy"] = 1
    return wrong


def plan_numbers(plan: DockPlan) -> Case:
    """Return the numbers of a plan that do not depend on the lane."""
    law = plan.trajectory.time_law
    poses = plan.path.poses_at(np.linspace(0.0, plan.path.length, 25))
    return {"price": float(plan.price), "poses": poses.tolist(), "duration": float(law.duration)}


def _failed(case: Case, error: CertificationFailed) -> Verdict:
    """Return the verdict on a solver's result that the certificate refused."""
    what = str(error.where.get("kind", ""))
    return Verdict("CertificationFailed", f"{what}: {error}, family {case.get('family')}")


def _refuted(case: Case, plan: DockPlan, world: World) -> Verdict | None:
    """Return the fault of a plan."""
    if not (says_yes(plan.certificate) and says_yes(plan.trajectory_certificate)):
        return Verdict("uncertified plan", plan.certificate.reason or plan.trajectory_certificate.reason)
    gears, law = path_spec(plan.path), plan.trajectory.time_law
    if path_spec(plan.trajectory.path) != gears:
        return Verdict("uncertified plan", "the trajectory drives another path than the certified one")
    scene = {key: value for key, value in case.items() if key not in ("budget", "family", "repeated", "others")}
    on_path: Case = {**scene, "kind": "paths", "path": gears}
    timed: Case = {
        "kind": "trajectories",
        "path": gears,
        "law": law_spec(law),
        "limits": case["limits"],
        "zone": case["zone"],
        "start_speed": abs(case["start_speed"]),
        "start_acceleration": math.copysign(1.0, case["start_speed"]) * case.get("start_acceleration", 0.0),
        "wheels": "unknown" if case.get("start_curvature") is None else "known",
    }
    for evidence, found in (
        (on_path, paths.refuted(on_path, plan.certificate, world)),
        (timed, trajectories.refuted(timed, plan.trajectory_certificate)),
        (on_path, _disagreement(plan, gears)),
    ):
        if found is not None:
            return Verdict(found.outcome, found.detail, evidence)
    return None


def _disagreement(plan: DockPlan, gears: list[Case]) -> Verdict | None:
    """Return a fault if the trajectory's samples do not lie on the oracle's path."""
    samples, motion = plan.trajectory.sample(0.1), motion_of(gears)
    piece = np.clip(np.searchsorted(motion.s, samples.s, side="right") - 1, 0, motion.s.size - 1)
    share = np.clip((samples.s - motion.s[piece]) / np.maximum(motion.h[piece], 1e-300), 0.0, 1.0)
    poses = motion.poses_at(piece, share)
    off = np.abs(np.column_stack((samples.x, samples.y, samples.yaw)) - poses).max()
    if not off <= _AGREEMENT:
        return Verdict("false certificate", f"samples: {off:.3g} off the path")
    return None
