"""Files with one number or part damaged: plans that optdock made, and the scenarios, maps, docks and cases it reads."""

from __future__ import annotations

import contextlib
import functools
import json
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import yaml

from optdock.config import load_scenario
from optdock.errors import OptdockError
from optdock.reports.report import failed_plan_file

if TYPE_CHECKING:
    from collections.abc import Iterator

    import numpy as np

    from experiments.fuzz.case import Case

__all__ = ["DAMAGES", "SCENES", "PlanText", "damaged_case", "damaged_document", "places_of", "planned"]

Rng: TypeAlias = "np.random.Generator"
Keys: TypeAlias = "tuple[str | int, ...]"

_ROBOT = """{footprint: [[0.4, 0.25], [-0.4, 0.25], [-0.4, -0.25], [0.4, -0.25]],
  limits: {max_curvature: 1.5, max_curvature_rate: 6.0}}"""
_TURNING = _ROBOT.replace("limits: {", "turns_in_place: true, limits: {max_yaw_rate: 1.0, max_yaw_acceleration: 2.0, ")
_BOX = """- [[-2.0, -2.0], [6.0, -2.0], [6.0, -2.2], [-2.0, -2.2]]
- [[-2.0, 2.0], [6.0, 2.0], [6.0, 2.2], [-2.0, 2.2]]
"""
_SHUT = """- [[1.9, -2.1], [2.1, -2.1], [2.1, 2.1], [1.9, 2.1]]
- [[-2.2, -2.2], [-2.0, -2.2], [-2.0, 2.2], [-2.2, 2.2]]
"""
_HEAD = "format: optdock-scenario/1\ntime_budget: 5.0\n"
_CLEAR = "clearance: {required: 0.05, at_dock: 0.0, taper: 0.5}\n"


def _scene(robot: str, dock: str, start: str, obstacles: str) -> str:
    return f"{_HEAD}robot: {robot}\ndock: {{{dock}}}\nstart: {{{start}}}\n{_CLEAR}obstacles:\n{obstacles}"


SCENES = {
    "straight": _scene(_ROBOT, "pose: [4.0, 0.0, 0.0], final_straight: 0.3", "pose: [0.0, 0.0, 0.0]", _BOX),
    "bend": _scene(
        _ROBOT,
        "pose: [4.0, 0.9, 0.2], final_straight: 0.3, approach_speed: 0.1, approach_distance: 0.3",
        "pose: [0.0, -0.3, 0.3]",
        _BOX + "- [[1.0, 0.9], [2.0, 0.9], [2.0, 1.9], [1.0, 1.9]]\n",
    ),
    "backward": _scene(
        _ROBOT, "pose: [3.0, 0.4, 0.1], direction: backward", "pose: [5.0, 0.0, 0.0], speed: 0.0, curvature: 0.0", _BOX
    ),
    "cusps": _scene(_ROBOT, "pose: [4.0, 0.0, 3.14], direction: forward", "pose: [3.0, 0.2, 0.0]", _BOX),
    "turning": _scene(_TURNING, "pose: [3.0, 0.5, 0.0]", "pose: [1.0, -0.5, 2.5]", _BOX),
    "shut": _scene(_ROBOT, "pose: [4.0, 0.0, 0.0]", "pose: [0.0, 0.0, 0.0]", _BOX + _SHUT),
}
_MAP = {"image": "hall.pgm", "resolution": 0.05, "origin": [-3.0, -3.0, 0.0], "negate": 0, "occupied_thresh": 0.65,
        "free_thresh": 0.25, "mode": "trinary"}  # fmt: skip
_DOCKS = {"docks": {"a": {"type": "t", "frame": "map", "pose": [0.5, 1.0, 2.0], "id": "7"}, "b": {
    "type": "u", "pose": [1.0, -1.0, 0.25]}}}  # fmt: skip
_CASE = [
    0.0,
    0.5,
    0.1,
    4.0,
    1.5,
    3.0,
    2,
    3,
    4,
    1.0,
    3.0,
    2.0,
    3.0,
    1.5,
    4.0,
    5.0,
    -2.0,
    6.0,
    -2.0,
    6.0,
    -1.0,
    5.0,
    -1.0,
]
# What is made of a number or a part; a number has all of them, another part the last ones.
DAMAGES = ("x 10", "x -1", "x 1.001", "x 1e-6", "+ 1e-3", "0", "1e308", "-1e6", "1e999", "NaN", "10**400", "90",
           "null", "text", "true", "list", "mapping", "drop", "double")  # fmt: skip
_OF_NUMBERS = 12
_TARGETS = {"plan": 0.7, "scenario": 0.18, "map": 0.04, "docks": 0.04, "case": 0.04}


class PlanText(NamedTuple):
    """A scene, and what planning it wrote."""

    scenario: str
    plan: str


@functools.cache
def planned(name: str) -> PlanText:
    """The plan file of a scene, made once in every process."""
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "bay.yaml"
        source.write_text(SCENES[name], encoding="utf-8")
        scenario = load_scenario(source)
        try:
            found = scenario.plan().as_file(period=0.1)
        except OptdockError as error:
            found = failed_plan_file(error, scenario.problem.frame)
    return PlanText(SCENES[name], found.as_json(spacing=0.05))


def damaged_case(rng: Rng) -> Case:
    """A file with one damage."""
    target = str(rng.choice(list(_TARGETS), p=list(_TARGETS.values())))
    scene = str(rng.choice(sorted(SCENES)))
    case: Case = {"kind": "damaged_files", "target": target, **planned(scene)._asdict()}
    if target not in case:
        case[target] = _others(target)
    places = _places(case[target], target)
    # Of a part first: a column of a thousand numbers counts as much as a number alone.
    part = places[int(rng.integers(len(places)))] if rng.uniform() < 0.5 else None
    kinds = sorted({_part(place) for place in places})
    chosen = kinds[int(rng.integers(len(kinds)))]
    same = [place for place in places if _part(place) == chosen]
    place = part or same[int(rng.integers(len(same)))]
    damages = DAMAGES if _is_number(_value(_document(case[target], target), place)) else DAMAGES[_OF_NUMBERS:]
    return {**case, "place": list(place), "damage": str(rng.choice(damages))}


def _part(place: Keys) -> Keys:
    """The place without its indices."""
    return tuple("#" if isinstance(key, int) else key for key in place)


def _others(target: str) -> str:
    if target == "case":
        return json.dumps(_CASE)
    return yaml.safe_dump(_MAP if target == "map" else _DOCKS)


@functools.lru_cache(maxsize=64)
def _document(text: str, target: str) -> Any:  # noqa: ANN401 - JSON of any shape
    return json.loads(text) if target in ("plan", "case") else yaml.safe_load(text)


@functools.lru_cache(maxsize=64)
def _places(text: str, target: str) -> list[Keys]:
    return [*places_of(_document(text, target))]


def places_of(value: object, above: Keys = ()) -> Iterator[Keys]:
    """The keys of every part of a document, but for the document itself."""
    children = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, child in children:
        yield (*above, key)
        yield from places_of(child, (*above, key))


def _value(document: Any, place: Keys) -> Any:  # noqa: ANN401
    for key in place:
        document = document[key]
    return document


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def damaged_document(case: Case) -> tuple[Any, Any, Any]:
    """The document of a case with its damage, and the value there before and after; None where it is dropped.

    The original is shared between cases, so only the lists and mappings on the way to the damage are copied.
    """
    original, place = _document(case[case["target"]], case["target"]), case["place"]
    document = original.copy()
    holder = document
    for key in place[:-1]:
        holder[key] = holder[key].copy()
        holder = holder[key]
    before = holder[place[-1]]
    if case["damage"] == "drop":
        del holder[place[-1]]
        return document, before, None
    if case["damage"] == "double":
        if isinstance(holder, list):
            holder.insert(place[-1], before)
        else:
            holder[f"{place[-1]}x"] = before
        return document, before, before
    holder[place[-1]] = after = _damaged(before, case["damage"])
    return document, before, after


def _damaged(value: Any, damage: str) -> Any:  # noqa: ANN401
    fixed = {"0": 0.0, "1e308": 1e308, "-1e6": -1e6, "1e999": float("inf"), "NaN": float("nan"), "10**400": 10**400,
             "90": 90, "null": None, "text": "0.5", "true": True, "list": [], "mapping": {}}  # fmt: skip
    if damage in fixed:
        return fixed[damage]
    sign, amount = damage.split()
    with contextlib.suppress(OverflowError):
        return value + float(amount) if sign == "+" else value * float(amount)
    return value
