"""`plan_dock` on random docking problems: results must be correct, and exceptions typed."""

from __future__ import annotations

import functools
import math
import time
from typing import TYPE_CHECKING

import numpy as np

from experiments.fuzz.case import Verdict
from experiments.fuzz.doors import law_spec, path_spec, problem_of, problem_spec
from experiments.fuzz.generators.docking import docking_problem
from experiments.fuzz.kinds import paths, trajectories
from experiments.fuzz.oracle.motion import motion_of
from experiments.fuzz.truth import says_yes
from optdock.errors import CertificationFailed, OptdockError
from optdock.planning.pipeline import plan_dock, warm_up

if TYPE_CHECKING:
    from experiments.fuzz.case import Case
    from optdock.planning.plan import DockPlan

__all__ = ["draw", "judge"]

_FAMILIES = 0.25  # share of problems from `experiments.families`
_LATE_CPU, _LATE = 0.2, 2.0  # [s] of CPU time, and of wall clock on a loaded machine, past the budget
_AGREEMENT = 1e-6  # [m], [rad] between a trajectory's poses and its path


def draw(rng: np.random.Generator) -> Case:
    """Draw a random docking problem, or an instance of a family."""
    case = docking_problem(rng)
    if rng.uniform() >= _FAMILIES:
        return case
    from experiments.families import FAMILIES, instance

    family, member = sorted(FAMILIES)[int(rng.integers(len(FAMILIES)))], int(rng.integers(1_000_000))
    scene = problem_spec(instance(family, member).problem)
    if rng.uniform() < 0.5:
        scene["zone"] = case["zone"]
    return {**scene, "kind": "plans", "budget": case["budget"], "family": [family, member]}


@functools.cache
def _warm() -> None:
    warm_up()


def judge(case: Case) -> Verdict:
    """Plan, and check the result."""
    _warm()
    try:
        problem = problem_of(case)
    except OptdockError as error:
        return Verdict(f"input refused: {type(error).__name__}", str(error))
    began, cpu = time.monotonic(), time.process_time()
    verdict, plan = Verdict("certified"), None
    try:
        plan = plan_dock(problem, time_budget=case["budget"])
    except CertificationFailed as error:
        return _failed(case, error)
    except OptdockError as error:
        verdict = Verdict(type(error).__name__)
    spent, cpu = time.monotonic() - began - case["budget"], time.process_time() - cpu - case["budget"]
    refuted = None if plan is None else _refuted(case, plan)
    if refuted is None and (cpu > _LATE_CPU or spent > _LATE):
        over = f"{1e3 * spent:.0f} ms past a budget of {1e3 * case['budget']:.0f} ms, {1e3 * cpu:.0f} ms of them busy"
        return Verdict("late", f"{verdict.outcome}: {over}")
    return refuted or verdict


def _failed(case: Case, error: CertificationFailed) -> Verdict:
    """Return the verdict on a solver's result that the certificate refused."""
    what = str(error.where.get("kind", ""))
    return Verdict("CertificationFailed", f"{what}: {error}, family {case.get('family')}")


def _refuted(case: Case, plan: DockPlan) -> Verdict | None:
    """Return the fault of a plan."""
    if not (says_yes(plan.certificate) and says_yes(plan.trajectory_certificate)):
        return Verdict("uncertified plan", plan.certificate.reason or plan.trajectory_certificate.reason)
    gears, law = path_spec(plan.path), plan.trajectory.time_law
    if path_spec(plan.trajectory.path) != gears:
        return Verdict("uncertified plan", "the trajectory drives another path than the certified one")
    scene = {key: value for key, value in case.items() if key not in ("budget", "family")}
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
        (on_path, paths.refuted(on_path, plan.certificate)),
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
