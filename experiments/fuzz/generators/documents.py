"""Scenario, map and plan files: valid ones, damaged ones, and plans whose columns contradict their motion."""

from __future__ import annotations

import contextlib
import copy
import json
import math
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import yaml

from experiments.fuzz.doors import law_of, path_of
from experiments.fuzz.generators.motions import _double_s
from experiments.fuzz.generators.shapes import log_uniform
from experiments.fuzz.oracle.motion import motion_of
from optdock.io.plan_file import PlanFile, TrajectoryColumns
from optdock.model.trajectory import Trajectory

if TYPE_CHECKING:
    from collections.abc import Callable

    from experiments.fuzz.case import Case

__all__ = ["FORGERIES", "files_case"]

Rng: TypeAlias = np.random.Generator
_LIMITS = {
    "max_speed": 0.6, "max_reverse_speed": 0.6, "max_acceleration": 0.5, "max_deceleration": 0.5, "max_jerk": 2.0,
    "max_yaw_rate": 0.5, "max_yaw_acceleration": 1.0, "max_curvature": 2.5, "max_curvature_rate": 12.0,
}  # fmt: skip
_MAP = {"image": "hall.pgm", "resolution": 0.05, "origin": [-5.0, -5.0, 0.0], "negate": 0, "occupied_thresh": 0.65,
        "free_thresh": 0.25}  # fmt: skip
_HOSTILE: tuple[Any, ...] = (
    None, True, "", "abc", "0.5", -1.0, 0, 1e308, -1e308, 1e-320, math.nan, math.inf, -math.inf, [], {}, [[]], 10**400,
    [1.0], [1.0, 2.0, 90.0], {"a": 1}, [[0, 0], [1, 0], [1, 0]], "2026-11-22", "\x00", "é" * 300, 2**63, [None] * 3,
)  # fmt: skip


def files_case(rng: Rng) -> Case:
    """Return texts of a scenario, its map and a plan, and the modification applied to them."""
    gears, law = _drive(rng)
    scenario = _scenario(rng, gears)
    case: Case = {"kind": "files", "expected": "any", "map": yaml.safe_dump(_MAP), "pixels": int(rng.integers(1, 40))}
    if rng.uniform() < 0.35:
        name = str(rng.choice(sorted(FORGERIES)))
        plan, scenario = FORGERIES[name](rng, gears, law, scenario)
        case["expected"], case["forgery"] = ("certified" if name == "honest" else "not certified"), name
        return {**case, "scenario": yaml.safe_dump(scenario), "plan": plan}
    if rng.uniform() < 0.25:
        scenario["map"] = "hall.yaml"
    case["scenario"], case["plan"] = yaml.safe_dump(scenario), _plan_text(gears, law)
    target = str(rng.choice(["scenario", "plan", "map"], p=[0.5, 0.4, 0.1]))
    if target == "scenario" and rng.uniform() < 0.15:
        case["scenario"], case["expected"] = yaml.safe_dump(_in_degrees(rng, scenario)), "refused as degrees"
        return case
    case[target] = _damaged(rng, case[target], as_json=target == "plan")
    return case


def _drive(rng: Rng) -> tuple[list[Case], Case]:
    """Return a smooth path of one gear with a law well within the limits."""
    count = int(rng.integers(3, 8))
    knots = np.concatenate(([0.0], np.cumsum(rng.uniform(0.3, 0.7, count - 1))))
    curvature = np.where(np.arange(count) % 2, rng.uniform(0.3, 0.6, count), 0.0) * rng.choice([1.0, -1.0])
    curvature[-1] = 0.0
    gear = int(rng.choice([1, -1]))
    start = [float(rng.uniform(-1, 1)), float(rng.uniform(-1, 1)), float(rng.uniform(-3, 3))]
    gears = [
        {"type": "clothoid", "start": start, "knots": knots.tolist(), "curvature": curvature.tolist(), "gear": gear}
    ]
    return gears, _law(float(knots[-1]), 0.3, 0.3, 1.0)


def _law(length: float, v: float, a: float, j: float) -> Case:
    phases, _ = _double_s(length, v, a, j)
    return {
        "durations": [h for h, _ in phases],
        "jerks": [jerk for _, jerk in phases],
        "start_speed": 0.0,
        "start_acceleration": 0.0,
    }


def _scenario(rng: Rng, gears: list[Case]) -> Case:
    motion = motion_of(gears)
    scenario: Case = {
        "format": "optdock-scenario/1",
        "robot": {"footprint": [[0.4, 0.3], [-0.4, 0.3], [-0.4, -0.3], [0.4, -0.3]], "limits": dict(_LIMITS)},
        "dock": {"pose": motion.end.tolist(), "direction": "forward" if gears[0]["gear"] > 0 else "backward"},
        "start": {"pose": motion.start.tolist()},
        "clearance": {"required": 0.05, "at_dock": 0.0, "taper": 0.5},
        "time_budget": 0.1,
    }
    if rng.uniform() < 0.5:
        scenario["obstacles"] = [[[20.0, 20.0], [21.0, 20.0], [21.0, 21.0]]]
    return scenario


def _columns(gears: list[Case], law: Case, period: float = 0.005) -> dict[str, np.ndarray]:
    trajectory = Trajectory(path_of(gears), law_of(law))
    return {
        name: np.array(column)
        for name, column in TrajectoryColumns.from_trajectory(trajectory, period)._asdict().items()
    }


def _written(gears: list[Case], columns: dict[str, np.ndarray]) -> str:
    return PlanFile(path=path_of(gears), trajectory=TrajectoryColumns(**columns)).as_json()


def _plan_text(gears: list[Case], law: Case) -> str:
    return _written(gears, _columns(gears, law, 0.05))


_Forgery: TypeAlias = "tuple[str, Case]"


def _honest(_: Rng, gears: list[Case], law: Case, scenario: Case) -> _Forgery:
    return _written(gears, _columns(gears, law)), scenario


def _hidden_acceleration(rng: Rng, gears: list[Case], _: Case, scenario: Case) -> _Forgery:
    """Three times the allowed acceleration, with columns of zeros."""
    length = motion_of(gears).length
    columns = _columns(gears, _law(length, 0.5, float(rng.uniform(1.5, 2.5)), 1.9e1))
    columns["acceleration"] = 0.0 * columns["acceleration"]
    columns["jerk"] = 0.0 * columns["jerk"]
    return _written(gears, columns), scenario


def _hidden_jerk(_: Rng, gears: list[Case], __: Case, scenario: Case) -> _Forgery:
    """Ten times the allowed jerk; the column contains the allowed jerk."""
    columns = _columns(gears, _law(motion_of(gears).length, 0.5, 0.45, 20.0))
    columns["jerk"] = np.clip(columns["jerk"], -2.0, 2.0)
    return _written(gears, columns), scenario


def _hidden_speed(rng: Rng, gears: list[Case], _: Case, scenario: Case) -> _Forgery:
    """Positions advance faster than the speed column."""
    columns = _columns(gears, _law(motion_of(gears).length, 0.55, 0.45, 2.0))
    scenario["robot"]["limits"]["max_speed"] = scenario["robot"]["limits"]["max_reverse_speed"] = 0.4
    columns["speed"] = columns["speed"] * float(rng.uniform(0.2, 0.7))
    return _written(gears, columns), scenario


def _hidden_yaw(rng: Rng, gears: list[Case], law: Case, scenario: Case) -> _Forgery:
    """Yaw rate or yaw acceleration beyond its limit, with columns of zeros."""
    columns = _columns(gears, law)
    name = str(rng.choice(["yaw_rate", "yaw_acceleration"]))
    top = float(np.max(np.abs(columns[name])))
    scenario["robot"]["limits"][f"max_{name}"] = max(top * 0.5, 1e-3)
    columns[name] = 0.0 * columns[name]
    return _written(gears, columns), scenario


def _wrong_sign(_: Rng, gears: list[Case], law: Case, scenario: Case) -> _Forgery:
    """The speed of the other gear, whose limit is higher."""
    columns = _columns(gears, law)
    name = "max_speed" if gears[0]["gear"] > 0 else "max_reverse_speed"
    scenario["robot"]["limits"][name] = 0.1
    for column in ("speed", "acceleration", "jerk"):
        columns[column] = -columns[column]
    return _written(gears, columns), scenario


def _beside_the_path(rng: Rng, gears: list[Case], law: Case, scenario: Case) -> _Forgery:
    """Every pose up to a millimetre off a path without spare clearance."""
    columns = _columns(gears, law)
    side = log_uniform(rng, 2e-5, 0.9e-3)
    columns["x"] = columns["x"] - side * np.sin(columns["yaw"])
    columns["y"] = columns["y"] + side * np.cos(columns["yaw"])
    goal = motion_of(gears).end
    c, s = math.cos(goal[2]), math.sin(goal[2])
    wall = [[-0.4, 0.3 + 1e-6], [0.4, 0.3 + 1e-6], [0.4, 0.35], [-0.4, 0.35]]
    scenario["obstacles"] = [[[float(goal[0] + c * x - s * y), float(goal[1] + s * x + c * y)] for x, y in wall]]
    scenario["clearance"] = {"required": 0.0, "at_dock": 0.0, "taper": 0.0}
    return _written(gears, columns), scenario


def _one_sample(rng: Rng, gears: list[Case], law: Case, scenario: Case) -> _Forgery:
    """One value of one column beyond its limit."""
    columns = _columns(gears, law)
    name = str(rng.choice(["speed", "acceleration", "jerk", "yaw_rate", "yaw_acceleration"]))
    columns[name][int(rng.integers(1, columns[name].size - 1))] = _LIMITS[f"max_{name}"] * float(rng.uniform(1.5, 50.0))
    return _written(gears, columns), scenario


def _faster_clock(rng: Rng, gears: list[Case], law: Case, scenario: Case) -> _Forgery:
    """All times scaled down, inconsistent with the other columns."""
    columns = _columns(gears, law)
    columns["t"] = columns["t"] * float(rng.uniform(0.05, 0.6))
    return _written(gears, columns), scenario


def _hop(rng: Rng, gears: list[Case], law: Case, scenario: Case) -> _Forgery:
    """Positions jump ahead along the path and wait there, while the speed column is unchanged."""
    columns = _columns(gears, law)
    n = columns["t"].size
    first = int(rng.integers(n // 4, n // 2))
    last = min(n - 2, first + int(rng.integers(20, 80)))
    for name in ("x", "y", "yaw"):
        columns[name][first:last] = columns[name][last]
    return _written(gears, columns), scenario


FORGERIES: dict[str, Callable[[Rng, list[Case], Case, Case], _Forgery]] = {
    "honest": _honest,
    "hidden acceleration": _hidden_acceleration,
    "hidden jerk": _hidden_jerk,
    "hidden speed": _hidden_speed,
    "hidden yaw": _hidden_yaw,
    "wrong sign": _wrong_sign,
    "beside the path": _beside_the_path,
    "one sample": _one_sample,
    "faster clock": _faster_clock,
    "hop": _hop,
}


def _in_degrees(rng: Rng, scenario: Case) -> Case:
    wrong = copy.deepcopy(scenario)
    place = wrong[str(rng.choice(["dock", "start"]))]
    place["pose"][2] = float(rng.choice([90.0, -90.0, 180.0, 45.0, 270.0]))
    return wrong


def _damaged(rng: Rng, text: str, *, as_json: bool) -> str:
    """Change bytes or values."""
    if rng.uniform() < 0.4:
        return _scratched(rng, text)
    document = json.loads(text) if as_json else yaml.safe_load(text)
    for _ in range(int(rng.choice([1, 1, 1, 2, 4]))):
        _mutate(rng, document)
    try:
        return json.dumps(document) if as_json else yaml.safe_dump(document)
    except (yaml.YAMLError, ValueError):
        return text


def _scratched(rng: Rng, text: str) -> str:
    """Delete, duplicate or replace a few characters, or cut off the end."""
    characters = list(text)
    for _ in range(int(rng.choice([1, 1, 2, 5]))):
        if not characters:
            break
        at, style = int(rng.integers(len(characters))), int(rng.integers(5))
        if style == 0:
            del characters[at : at + int(rng.integers(1, 30))]
        elif style == 1:
            characters[at:at] = characters[at : at + int(rng.integers(1, 30))]
        elif style == 2:
            characters[at] = chr(int(rng.choice([0, 9, 10, 34, 35, 45, 58, 91, 93, 123, 125, 0xFFFD, 0x1F600, 0x2028])))
        elif style == 3:
            characters[at] = str(rng.choice(list("0123456789eE.-+:,[]{}&*!|>'\"%@`")))
        elif rng.uniform() < 0.2:
            del characters[at:]
    return "".join(characters)


def _mutate(rng: Rng, document: Any) -> None:  # noqa: ANN401 - JSON of any shape
    """Change one place of a document: its value replaced, dropped, duplicated or under another key."""
    holder, depth = document, 0
    while isinstance(holder, dict | list) and len(holder):
        keys = list(holder) if isinstance(holder, dict) else list(range(len(holder)))
        key = keys[int(rng.integers(len(keys)))]
        inner = holder[key]
        if isinstance(inner, dict | list) and len(inner) and depth < 6 and rng.uniform() < 0.75:
            holder, depth = inner, depth + 1
            continue
        _replace(rng, holder, key)
        return


def _replace(rng: Rng, holder: Any, key: Any) -> None:  # noqa: ANN401
    style = rng.uniform()
    if style < 0.2:
        del holder[key]
    elif style < 0.3 and isinstance(holder, dict):
        holder[f"{key}x"] = holder.pop(key)
    elif style < 0.35 and isinstance(holder, list):
        holder.append(holder[key])
    elif style < 0.55 and isinstance(holder[key], int | float) and not isinstance(holder[key], bool):
        with contextlib.suppress(OverflowError):  # an earlier mutation may have made the value too large for floats
            holder[key] = holder[key] * float(rng.choice([-1.0, 57.29578, 1e6, 1e-6, 1.001]))
    else:
        holder[key] = copy.deepcopy(_HOSTILE[int(rng.integers(len(_HOSTILE)))])
