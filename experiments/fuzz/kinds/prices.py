"""Prices do not rise where less is asked for: half the clearance, wider limits, an obstacle less, twice the budget.

What solves a problem solves the easier one too, so its plan should cost no more; a search may miss that. The rule is
that it costs at most 3 % more.
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
    """A random docking problem, and what is made easier."""
    return {**docking_problem(rng), "kind": "prices", "easier": str(rng.choice(EASIER))}


def easier(case: Case) -> Case:
    """The same problem with less asked for."""
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
    """Plan both."""
    try:
        asked, relaxed = problem_of(case), problem_of(easier(case))
    except OptdockError as error:
        return Verdict(f"input refused: {type(error).__name__}", str(error))
    try:
        price = plan_dock(asked, time_budget=_BUDGET).price
    except OptdockError as error:
        return Verdict(type(error).__name__)
    longer = _BUDGET * (2.0 if case["easier"] == "budget" else 1.0)
    try:
        found = plan_dock(relaxed, time_budget=longer).price
    except OptdockError as error:
        return Verdict("dearer", f"{case['easier']}: {price:.3f} s, then {type(error).__name__}")
    if found > _MORE * price:
        return Verdict("dearer", f"{case['easier']}: {price:.3f} s, then {found:.3f} s")
    return Verdict("no dearer")
