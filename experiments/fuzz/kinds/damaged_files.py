"""Files with one number or part damaged, through the readers and the judge of plan files, in this process.

A damaged plan may be certified only if what was damaged means the same as before: within the rounding of files, a claim
left out, or one that the judge names as not judged. A damaged scenario may certify an honest plan only if the oracle
cannot refute its path there and its samples keep the limits. Whatever is read ends in a typed error or a value, within
a second and half a gigabyte.
"""

from __future__ import annotations

import atexit
import functools
import json
import math
import resource
import shutil
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from experiments.fuzz.case import Verdict
from experiments.fuzz.doors import path_spec, problem_spec
from experiments.fuzz.generators.damages import damaged_case, damaged_document
from experiments.fuzz.kinds.paths import refuted
from experiments.fuzz.oracle.motion import motion_of
from experiments.parking_cases import load_tpcap
from optdock.config import load_scenario
from optdock.errors import OptdockError
from optdock.io.maps import load_map
from optdock.io.plan_file import load_plan, parse_plan
from optdock.nav2.docks import load_dock_database
from optdock.reports.plan_file_verdict import judge_plan_file
from optdock.verification import certify_path

if TYPE_CHECKING:
    from collections.abc import Callable

    from experiments.fuzz.case import Case
    from optdock.io.plan_file import PlanFile
    from optdock.model.problem import DockingProblem

__all__ = ["draw", "judge"]

_SECONDS, _MEGABYTES = 1.0, 500
_ROUNDING = 2e-6  # times 1 + |value|
_SHARPNESS = 1.1e-3  # [m], of clearances
_SAME_CURVE = 1e-5  # [m], [rad]
_SAME_GUESS = 1e-3  # of a guess, which nobody drives, and whose curves are held against its samples only
_FORGIVEN = 1.0 + 1e-4  # of a limit
# Places, `*` any key, that no judge can know, or that name what a certificate was made for, which the judge says.
_NOT_JUDGED = (
    "timing_ms", "tried", "error", "completed", "certificate.poses_checked", "certificate.problem", "certificate.path",
    "certificate.trajectory.path", "certificate.violations", "certificate.trajectory.violations",
)  # fmt: skip
_CLEARANCES = ("certificate.min_clearance", "certificate.required_clearance", "certificate.margin")
_JUMPING = ("trajectory.jerk", "trajectory.yaw_acceleration")


def draw(rng: np.random.Generator) -> Case:
    """A file with one damage."""
    return damaged_case(rng)


def judge(case: Case) -> Verdict:
    """Read the file, judge the plan, and hold the verdict against what was damaged."""
    document, before, after = damaged_document(case)
    began, peak = time.process_time(), _peak()
    outcome = _outcome(case, document)
    seconds = time.process_time() - began
    where = f"{case['damage']} at {'.'.join(map(str, case['place']))} of a {case['target']}"
    if seconds > _SECONDS:
        return Verdict("late", f"{where}: {seconds:.2f} s of CPU")
    if _peak() > max(peak, _MEGABYTES):
        return Verdict("late", f"{where}: {_peak()} MB")
    if case["target"] == "plan" and outcome == "certified" and not _means_the_same(case, document, before, after):
        return Verdict("accepted forgery", f"{where}: {before!r} is {after!r}, and certified")
    if case["target"] == "scenario" and outcome == "certified":
        return _refuted(case, document) or Verdict("scenario: certified")
    return Verdict(f"{case['target']}: {outcome}")


def _peak() -> int:
    """Largest memory of this process so far [MB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024


def _outcome(case: Case, document: Any) -> str:  # noqa: ANN401 - JSON of any shape
    """What the library says; anything but an error of its own is raised on."""
    try:
        if case["target"] not in ("plan", "scenario"):
            _READERS[case["target"]](_written(case["target"], document))
            return "read"
        if case["target"] == "plan":
            _written("plan", document)
            plan, problem = load_plan(_folder() / _NAMES["plan"]), _problem(case["scenario"])
        else:
            plan, problem = _plan(case["plan"]), load_scenario(_written("scenario", document)).problem
        return judge_plan_file(plan, problem).outcome
    except OptdockError as error:
        return type(error).__name__


_NAMES = {"plan": "plan.json", "scenario": "bay.yaml", "map": "hall.yaml", "docks": "docks.yaml", "case": "case.csv"}
_READERS: dict[str, Callable[[Path], object]] = {
    "map": load_map,
    "docks": load_dock_database,
    "case": lambda source: load_tpcap(source).problem,
}


@functools.cache
def _folder() -> Path:
    """Where this process writes its files."""
    folder = Path(tempfile.mkdtemp())
    (folder / "hall.pgm").write_bytes(b"P5 120 120 255 " + bytes([254]) * 120 * 120)
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


def _written(target: str, document: Any) -> Path:  # noqa: ANN401
    source = _folder() / _NAMES[target]
    source.write_text(_text(target, document), encoding="utf-8")
    return source


def _text(target: str, document: Any) -> str:  # noqa: ANN401
    if target == "case":
        return ",".join(map(str, document))
    return json.dumps(document).replace("Infinity", "1e999") if target == "plan" else yaml.safe_dump(document)


@functools.lru_cache(maxsize=16)
def _problem(text: str) -> DockingProblem:
    source = _folder() / "undamaged.yaml"
    source.write_text(text, encoding="utf-8")
    return load_scenario(source).problem


@functools.lru_cache(maxsize=16)
def _plan(text: str) -> PlanFile:
    return parse_plan(text, "plan.json")


def _means_the_same(case: Case, document: Any, before: Any, after: Any) -> bool:  # noqa: ANN401
    """Whether a plan with this damage says what the undamaged one says, or less of it."""
    place = ".".join(str(key) for key in case["place"] if not isinstance(key, int))
    return (
        place.startswith(_NOT_JUDGED)
        or (before == after and type(before) is type(after) and case["damage"] != "double")
        or _is_left_out(case, before, after)
        or _is_one_curve(case, document)
        or (place == "status" and isinstance(after, str))  # one that others gave; not that of a refusal, see the judge
        or (place in ("certificate.nearest", "frame") and after in _names(case["scenario"]))
        or (_is_number(before) and _is_number(after) and _is_rounding(case, document, place, (before, after)))
    )


def _is_left_out(case: Case, before: Any, after: Any) -> bool:  # noqa: ANN401
    """Whether a part or a claim is left out, or something unknown is added."""
    if not isinstance(case["place"][-1], str):
        return False
    return case["damage"] in ("drop", "double") or (not _is_number(before) and (after is None or after in ({}, [])))


def _is_rounding(case: Case, document: Any, place: str, values: tuple[float, float]) -> bool:  # noqa: ANN401
    """Whether one number stands for what the other does; of a place the judge asks for the clearance there."""
    before, after = values
    if place == "certificate.at_s" or (place in _JUMPING and _is_between(document, case["place"], after)):
        return True
    return abs(after - before) <= (_SHARPNESS if place in _CLEARANCES else _ROUNDING * (1.0 + abs(before)))


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _names(scenario: str) -> list[str]:
    """What the nearest obstacle may be called, or a frame that nobody knows."""
    return ["", *(f"obstacles[{i}]" for i in range(len(yaml.safe_load(scenario)["obstacles"])))]


def _is_between(document: Any, place: list[Any], value: float) -> bool:  # noqa: ANN401
    """Whether a value lies between those of the samples around it, as where a column jumps."""
    column, i = document[place[0]][place[1]], place[2]
    around = column[max(i - 1, 0) : i] + column[i + 1 : i + 2]
    return min(around) - _ROUNDING <= value <= max(around) + _ROUNDING


def _is_one_curve(case: Case, document: Any) -> bool:  # noqa: ANN401
    """Whether the damaged curves of a path, and the gears along them, are the same, told by other points."""
    if "segments" not in case["place"]:
        return False
    if not document[case["place"][0]].get("segments"):
        return True  # the samples are the path, and are proven as such
    first, second = json.loads(case["plan"])[case["place"][0]], document[case["place"][0]]
    near = _SAME_GUESS if case["place"][0] == "raw_path" else _SAME_CURVE
    motions = [motion_of([_gear(segment) for segment in path["segments"]]) for path in (first, second)]
    if abs(motions[0].length - motions[1].length) > near:
        return False
    poses = [_poses(motion) for motion in motions]
    turned = np.abs(np.remainder(poses[0][:, 2] - poses[1][:, 2] + math.pi, 2.0 * math.pi) - math.pi)
    apart = np.hypot(*(poses[0][:, :2] - poses[1][:, :2]).T)
    gears = [[segment.gear for segment in motion.segments] for motion in motions]
    return bool(max(apart.max(), turned.max()) <= near) and gears[0] == gears[1]


def _gear(segment: Case) -> Case:
    kind = "polyline" if "poses" in segment else "turn" if "turn" in segment else "clothoid"
    return {"type": kind, "gear": segment.get("direction", 0), **segment}


def _poses(motion: Any) -> Any:  # noqa: ANN401 - a Motion of the oracle
    """Poses of a motion, evenly by its length."""
    ends = np.concatenate((motion.s_at(np.arange(motion.way.size), np.zeros(motion.way.size)), [motion.length]))
    s = np.linspace(0.0, motion.length, 400)
    piece = np.clip(np.searchsorted(ends, s, side="right") - 1, 0, motion.way.size - 1)
    width = ends[piece + 1] - ends[piece]
    return motion.poses_at(piece, np.where(width > 0.0, (s - ends[piece]) / np.where(width > 0.0, width, 1.0), 0.0))


def _refuted(case: Case, document: Any) -> Verdict | None:  # noqa: ANN401
    """What shows that the undamaged plan does not solve the damaged scenario."""
    plan, problem = _plan(case["plan"]), load_scenario(_written("scenario", document)).problem
    assert plan.path is not None  # it is certified
    found = refuted({**problem_spec(problem), "path": path_spec(plan.path)}, certify_path(plan.path, problem))
    if found is not None or plan.trajectory is None:
        return found
    motion, limits = plan.trajectory, problem.robot.limits
    for name, values, limit in (
        ("speed", motion.speed, limits.max_speed),
        ("reverse speed", -motion.speed, limits.max_reverse_speed),
        ("jerk", np.abs(motion.jerk), limits.max_jerk),
        ("acceleration", np.abs(motion.acceleration), max(limits.max_acceleration, limits.max_deceleration)),
        ("yaw rate", np.abs(motion.yaw_rate), limits.max_yaw_rate),
        ("lateral acceleration", np.abs(motion.speed * motion.yaw_rate), limits.max_lateral_acceleration),
    ):
        if float(np.max(values)) > _FORGIVEN * limit + _ROUNDING:
            return Verdict("false certificate", f"{name}: {float(np.max(values)):.6g}, the limit is {limit:.6g}")
    return None
