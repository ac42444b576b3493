"""Prices of easier problems: half the clearance, wider limits, one obstacle less, twice the budget.

A solution of a problem solves the easier one too, so the plan of the easier problem should not cost more; the search is
not exhaustive, so up to 3 % more is accepted.
"""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING

from experiments.fuzz.case import Verdict
from experiments.fuzz.doors import problem_of
from experiments.fuzz.generators.docking import docking_problem
from optdock.errors import OptdockError
from optdock.planning.pipeline import plan_dock

if TYPE_CHECKING:
    import numpy as np

    from experiments.fuzz.case import Case

__all__ = ["draw", "easier", "judge"]

EASIER = ("clearance", "curvature", "speed", "obstacle", "budget")
_BUDGET = 2.0  # [s]
_MORE = 1.03  # relative
_WIDER = 1.1


def draw(rng: np.random.Generator) -> Case:
    """Draw a random docking problem, and the requirement to relax."""
    return {**docking_problem(rng), "kind": "prices", "easier": str(rng.choice(EASIER))}


def easier(case: Case) -> Case:
    """Return the same problem with one requirement relaxed."""
    made = copy.deepcopy(case)
    limits, what = made["limits"], case["easier"]
    if what == "clearance":
        made["clearance"][:2] = [0.5 * value for value in case["clearance"][:2]]
    elif what == "obstacle":
        made["obstacles"] = case["obstacles"][1:]
    names = {"curvature": ("max_curvature", "max_curvature_rate"), "speed": ("max_speed", "max_reverse_speed")}
    for name in names.get(what, ()):
        if limits.get(name) is not None:
            limits[name] = _WIDER * limits[name]
    return made


def judge(case: Case) -> Verdict:
    """Plan both problems."""
    try:
        original, relaxed = problem_of(case), problem_of(easier(case))
    except OptdockError as error:
        return Verdict(f"input refused: {type(error).__name__}", str(error))
    try:
        price = plan_dock(original, time_budget=_BUDGET).price
    except OptdockError as error:
        return Verdict(type(error).__name__)
    longer = _BUDGET * (2.0 if case["easier"] == "budget" else 1.0)
    try:
        found = plan_dock(relaxed, time_budget=longer).price
    except OptdockError as error:
        return Verdict("more expensive", f"{case['easier']}: {price:.3f} s, then {type(error).__name__}")
    if found > _MORE * price:
        return Verdict("more expensive", f"{case['easier']}: {price:.3f} s, then {found:.3f} s")
    return Verdict("no more expensive")
