"""Running plans in a changing world: the state of the robot, and the differences of the world."""

from __future__ import annotations

import copy
import math
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from experiments.fuzz.generators.docking import docking_problem
from experiments.fuzz.generators.problems import path_problem
from experiments.fuzz.generators.shapes import log_uniform
from experiments.fuzz.oracle.motion import motion_of

if TYPE_CHECKING:
    from experiments.fuzz.case import Case

__all__ = ["running_plan"]

Rng: TypeAlias = np.random.Generator
_BUDGETS, _ORDINARY, _QUICK = [0.02, 0.05, 0.2, 0.001], [0.5, 0.35, 0.1, 0.05], [0.5, 0.1, 0.0, 0.4]  # [s]
_MORE = 5  # further questions about a plan
_PATHS = 0.45  # share of cases with a given path, whose margins are near the limit; the others are planned
_PATHS_ASKED = 0.9  # the same share if the question is given: these cases cost a tenth
# Limits that `_simple_law` satisfies on any path.
_NO_LIMITS = dict.fromkeys(("max_speed", "max_reverse_speed", "max_acceleration", "max_deceleration", "max_jerk"), 1e6)
_FAST_TURNS = {"max_yaw_rate": 1e6, "max_yaw_acceleration": 1e6}


def running_plan(rng: Rng, question: str | None = None, *, is_beside: bool = False) -> Case:
    """Return a plan, or a problem to be planned first; a world; the progress of the robot; `kind` is `replans`.

    `more` holds the differences of further questions about the same plan.

    `world` holds the differences from the case itself. `beside` names obstacles that are placed next to the rest of the
    path once it is known: a seed and gaps [m]. `offset` is the measured robot relative to its reference; `moved` a
    rigid motion of the running plan, as requested by robots that steer relative to the dock.

    Args:
        rng: Random generator.
        question: `holds`, `replan`, or `decide` by the executor's planning; None: one of the first two.
        is_beside: Whether the robot is always measured off its plan; otherwise only sometimes.
    """
    if rng.uniform() < (_PATHS if question is None else _PATHS_ASKED):
        case = path_problem(rng)
        case["law"] = _simple_law(case["path"])
        case["limits"] = {**_NO_LIMITS, **case["limits"], **(_FAST_TURNS if "max_yaw_rate" in case["limits"] else {})}
        case["start_speed"], case["start_curvature"], case["start_acceleration"] = 0.0, None, 0.0
        case["zone"] = [None, 0.0]
        case["world"] = _revealed(rng, case)
        forms = ["problem", "obstacles"] if case["world"].get("grid") is None else ["problem", "problem", "costmap"]
        if question is not None:
            forms = ["problem"]
        case["question"] = question or "holds"
    else:
        case = docking_problem(rng)
        case["budget"] = 0.1
        case["start_speed"], case["start_curvature"] = 0.0, None
        _steered(rng, case)
        case["world"] = _another_world(rng, case)
        case["beside"] = [int(rng.integers(2**31)), [_gap(rng, case) for _ in range(int(rng.choice([0, 1, 3])))]]
        forms = ["problem"] if set(case["world"]) - {"dock"} or case["beside"][1] else ["problem", "pose"]
        case["question"] = question or "replan"
    case |= {"kind": "replans", **_moment(rng, forms, question, is_beside=is_beside)}
    own = rng.spawn(1)[0]
    case["more"] = [_another_question(own, case, question, is_beside=is_beside) for _ in range(_MORE)]
    return case


def _moment(rng: Rng, forms: list[str], question: str | None, *, is_beside: bool) -> Case:
    """Return the present time, the robot's state, and the form and budget of the question."""
    asked = str(rng.choice(forms))
    shares = [rng.uniform(0.0, 0.9), rng.uniform(-0.1, 1.1), 0.0, 1.0]
    return {
        "asked": asked,
        "share": float(rng.choice(shares, p=[0.7, 0.2, 0.05, 0.05])),
        "rate": float(rng.choice([1.0, rng.uniform(0.0, 1.0), 0.0, rng.uniform(1.0, 1.3)], p=[0.6, 0.25, 0.05, 0.1])),
        "delay": float(rng.choice([0.0, rng.uniform(0.0, 0.2)])),
        "lead": None if rng.uniform() < 0.6 else float(rng.uniform(0.0, 0.3)),
        "moved": None if rng.uniform() < 0.9 else [float(rng.normal(0.0, 0.05)) for _ in range(3)],
        "offset": None if not is_beside and rng.uniform() < 0.5 else _offset(rng),
        "replan_budget": float(rng.choice(_BUDGETS, p=_ORDINARY if question is None else _QUICK)),
    }


def _another_question(rng: Rng, case: Case, question: str | None, *, is_beside: bool) -> Case:
    """Return the parts of a case that differ in another question about the same plan."""
    if "path" in case:
        return _moment(rng, [case["asked"]], question, is_beside=is_beside)
    plain = {**case, "grid": None}  # another grid takes long to be drawn
    world, gaps = _another_world(rng, plain), [_gap(rng, case) for _ in range(int(rng.choice([0, 1, 3])))]
    forms = ["problem"] if set(world) - {"dock"} or gaps else ["problem", "pose"]
    beside = [int(rng.integers(2**31)), gaps]
    return {"world": world, "beside": beside, **_moment(rng, forms, question, is_beside=is_beside)}


def _simple_law(path: list[Case]) -> Case:
    """Return a time law of four seconds per gear, from rest to rest, in four phases of one jerk: distance 2 j T^3."""
    lengths = [segment.length for segment in motion_of(path).segments]
    jerks = [0.5 * length * sign for length in lengths for sign in (1.0, -1.0, -1.0, 1.0)]
    return {"durations": [1.0] * len(jerks), "jerks": jerks, "start_speed": 0.0, "start_acceleration": 0.0}


def _offset(rng: Rng) -> list[float]:
    far = log_uniform(rng, 1e-4, 0.15)
    angle = rng.uniform(-math.pi, math.pi)
    return [far * math.cos(angle), far * math.sin(angle), float(rng.normal(0.0, 0.03))]


def _gap(rng: Rng, case: Case) -> float:
    """Return a gap from the swept area to a new obstacle: about the required clearance, or well inside."""
    required = float(case["clearance"][0])
    style = rng.uniform()
    if style < 0.5:
        return required + float(rng.normal(0.0, 0.02))
    return required + log_uniform(rng, 1e-6, 0.3) if style < 0.8 else -log_uniform(rng, 1e-3, 0.2)


def _revealed(rng: Rng, case: Case) -> Case:
    """Make the case the previous world; the returned world, the case before this call, has appeared since."""
    world: Case = {}
    if case["obstacles"] and rng.uniform() < 0.9:
        world["obstacles"] = case["obstacles"]
        case["obstacles"] = [one for one in case["obstacles"] if rng.uniform() < 0.4]
        if rng.uniform() < 0.2:
            world["obstacles"] = world["obstacles"][1:]
    if case["grid"] is not None:
        world["grid"], case["grid_alone"] = case["grid"], True
        case["grid"] = _before(rng, case["grid"])
    style = rng.uniform()
    if style < 0.08:
        world["dock"] = copy.deepcopy(case["dock"])
        world["dock"]["pose"] = _shifted(rng, case["dock"]["pose"])
    elif style < 0.16:
        world["tracking"] = [log_uniform(rng, 1e-4, 0.3), float(rng.uniform(0.0, 0.3))]
    elif style < 0.24:
        world["clearance"] = [case["clearance"][0] * float(rng.uniform(1.0, 1.5)), *case["clearance"][1:]]
    return world


def _before(rng: Rng, grid: Case) -> Case | None:
    """Return an earlier state of a grid: fewer cells, another window, another resolution, or none."""
    cells, side = np.array(grid["cells"]), grid["resolution"]
    style = rng.uniform()
    if style < 0.15:
        return None
    before = np.where(rng.uniform(size=cells.shape) < 0.5, 0, cells)
    origin = np.array(grid["origin"])
    if style < 0.35:  # a rolling window that moved on
        rows, columns = rng.integers(-3, 4, 2)
        origin, before = origin + side * np.array([columns, rows]), np.roll(before, (-rows, -columns), (0, 1))
    elif style < 0.5 and cells.size < 6000:
        before, side = np.kron(before, np.ones((2, 2), dtype=int)), 0.5 * side
    elif style < 0.6:
        origin = origin + side * rng.uniform(-1.0, 1.0, 2)
    return {"cells": before.tolist(), "resolution": side, "origin": origin.tolist()}


def _shifted(rng: Rng, pose: list[float]) -> list[float]:
    far = log_uniform(rng, 1e-4, 0.3)
    angle = rng.uniform(-math.pi, math.pi)
    turn = float(rng.normal(0.0, 0.3 * far + 0.01))
    return [pose[0] + far * math.cos(angle), pose[1] + far * math.sin(angle), pose[2] + turn]


def _steered(rng: Rng, case: Case) -> None:
    """Sometimes make the robot a car, or a robot that turns in place."""
    style, limits = rng.uniform(), case["limits"]
    if style < 0.15:
        case["drive"] = "ackermann"
        limits["wheelbase"] = float(rng.uniform(0.3, 1.0))
        limits["max_steering_rate"] = float(rng.uniform(0.3, 2.0))
        limits.setdefault("max_curvature", 1.5)
        limits.setdefault("max_curvature_rate", 6.0)
    elif style < 0.3:
        case["turns_in_place"] = True
        limits.setdefault("max_yaw_rate", 1.0)
        limits.setdefault("max_yaw_acceleration", 1.0)


def _another_world(rng: Rng, case: Case) -> Case:
    world: Case = {}
    if rng.uniform() < 0.6:
        world["dock"] = copy.deepcopy(case["dock"])
        world["dock"]["pose"] = _shifted(rng, case["dock"]["pose"])
    if case["obstacles"] and rng.uniform() < 0.2:
        world["obstacles"] = case["obstacles"][1:]
    if case["grid"] is not None:
        case["grid_alone"] = True
        if rng.uniform() < 0.5:
            cells = np.array(case["grid"]["cells"])
            new = rng.choice([0, 254, 255], size=cells.shape, p=[0.995, 0.004, 0.001])
            world["grid"] = {**case["grid"], "cells": np.maximum(cells, new).tolist()}
    style = rng.uniform()
    if style < 0.08:
        slower = float(rng.uniform(0.3, 1.2))
        names = ("max_speed", "max_reverse_speed", "max_acceleration", "max_deceleration", "max_jerk")
        world["limits"] = {**case["limits"], **{name: slower * case["limits"][name] for name in names}}
    elif style < 0.16:
        world["tracking"] = [log_uniform(rng, 1e-3, 0.05), float(rng.uniform(0.0, 0.05))]
    elif style < 0.2:
        world["zone"] = [log_uniform(rng, 0.02, 0.4), float(rng.uniform(0.05, 1.5))]
    return world
