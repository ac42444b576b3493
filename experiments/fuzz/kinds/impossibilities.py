"""`prove_impossible` on feasible scenes: there must be no proof. A proof must also pass its check."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from experiments.fuzz.case import Verdict
from experiments.fuzz.generators.carved import carved_scene
from optdock.errors import InvalidValue
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.impossibility import ImpossibilitySearch, check_impossibility
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
    x, y = case["moved"]
    start, goal = (Pose2(pose[0] + x, pose[1] + y, pose[2]) for pose in (case["start"], case["goal"]))
    robot = Robot(Footprint(np.array(case["footprint"]["polygon"])), _LIMITS)
    obstacles = [np.array(polygon) + np.array(case["moved"]) for polygon in case["obstacles"]]
    return DockingProblem(start, Dock(goal), robot, obstacles, ClearanceRule(*case["clearance"]))


def judge(case: Case) -> Verdict:
    """Try to prove that the scene, which was carved around a motion, is infeasible."""
    try:
        problem = problem_of(case)
    except InvalidValue as error:
        return Verdict("input refused: InvalidValue", str(error))
    search = ImpossibilitySearch(problem)
    proof = search.proof(case["budget"])
    if proof is None:
        return Verdict("not proven", checked={"open" if search.ended else "open, interrupted": 1})
    return Verdict("false proof", f"{proof.message}; its check: {check_impossibility(proof, problem)}")
