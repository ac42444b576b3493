"""Searches for proofs that no motion exists: none in a scene carved around a motion; elsewhere the proof must hold.

The second question of a case is the same scene with a fence around the goal. A proof must pass its check, and the
oracle must not find a free pose just outside of its cells.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from experiments.fuzz.case import Verdict
from experiments.fuzz.generators.carved import carved_scene
from experiments.fuzz.lanes import compares_lanes
from experiments.fuzz.oracle.cells import Cells, leak
from experiments.fuzz.truth import says_yes
from optdock.errors import InvalidValue
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.impossibility import ImpossibilitySearch, check_impossibility, prove_impossible
from optdock.impossibility.proof import CELLS
from optdock.kernels import using_kernels
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot

if TYPE_CHECKING:
    from experiments.fuzz.case import Case

__all__ = ["draw", "judge", "problem_of"]

_LIMITS = MotionLimits(max_curvature=2.0, max_curvature_rate=8.0)


def draw(rng: np.random.Generator) -> Case:
    """Draw a scene carved around a motion."""
    return carved_scene(rng)


def problem_of(case: Case) -> DockingProblem:
    """Return the problem of a case."""
    scene = _scene(case)
    robot = Robot(Footprint(np.array(case["footprint"]["polygon"])), _LIMITS)
    obstacles = [np.array(polygon) for polygon in scene["obstacles"]]
    dock = Dock(Pose2(*scene["dock"]["pose"]))
    return DockingProblem(Pose2(*scene["start"]), dock, robot, obstacles, ClearanceRule(*case["clearance"]))


def _scene(case: Case) -> Case:
    """Return the problem as read by the oracle."""
    (x, y), by = case["moved"], np.array(case["moved"])
    start, goal = ([pose[0] + x, pose[1] + y, pose[2]] for pose in (case["start"], case["goal"]))
    obstacles = [(np.array(polygon) + by).tolist() for polygon in case["obstacles"]]
    shared = {key: case[key] for key in ("footprint", "clearance")}
    return {**shared, "obstacles": obstacles, "start": start, "dock": {"pose": goal}}


def judge(case: Case) -> Verdict:
    """Try to prove that the scene, which was carved around a motion, is infeasible; then with the fence."""
    alone = {key: value for key, value in case.items() if key not in ("fenced", "seed")}
    try:
        problem = problem_of(alone)
    except InvalidValue as error:
        return Verdict("input refused: InvalidValue", str(error))
    search = ImpossibilitySearch(problem)
    proof = search.proof(case["budget"])
    if proof is not None:
        return Verdict("false proof", f"{proof.message}; its check: {check_impossibility(proof, problem)}")
    checked = {"open" if search.ended else "open, interrupted": 1}
    if "fenced" not in case:
        return Verdict("not proven", checked=checked)
    wrong, number = _about_the_fence({**case, **case["fenced"]})
    return wrong or Verdict("not proven", checked=checked | ({"proofs": number} if number else {}))


def _about_the_fence(case: Case) -> tuple[Verdict | None, int]:
    """Return a fault, and the number of proofs that were checked."""
    problem = problem_of(case)
    proof = prove_impossible(problem, time_budget=case["budget"])
    if proof is None:
        return None, 0
    verdict = check_impossibility(proof, problem)
    if not says_yes(verdict):
        return Verdict("false proof", f"fence: {verdict.reason}; {proof.message}"), 0
    if compares_lanes():
        with using_kernels("twin"):
            other = check_impossibility(proof, replace(problem))
        if other != verdict:
            return Verdict("kernel differs", f"check_impossibility: {verdict} in C, {other} by NumPy"), 0
    scene, tiles = _scene(case), np.concatenate((proof.tiles, proof.whole))
    inside = (*proof.inside, *(np.ones((1, CELLS, CELLS), dtype=np.bool_) for _ in proof.whole))
    cells = Cells(proof.origin, 2.0 * proof.cell, proof.headings, proof.centre, tiles, inside)
    ends = scene["dock"]["pose"], scene["start"]
    fault = leak(scene, cells, ends if proof.end == "goal" else ends[::-1], np.random.default_rng(case["seed"]))
    return (Verdict("false proof", f"fence: {fault}; {proof.message}") if fault else None), 1
