"""Certified paths, motions and plans, written with a proof: the second judge accepts them, and refuses damaged files.

A damaged file that is accepted is a `false certificate`, unless the damage left a true statement, which
`generators.damaged_proofs` excludes by an independent evaluation. A certified plan that is refused is a `false
refusal`. A path that cannot be written with a proof is only counted.
"""

from __future__ import annotations

import functools
import json
from typing import TYPE_CHECKING

import numpy as np

from experiments.fuzz.case import Verdict, rng_of
from experiments.fuzz.doors import law_of, path_of, problem_of
from experiments.fuzz.generators.damaged_proofs import DAMAGES, damaged
from experiments.fuzz.generators.motions import motion_problem
from experiments.fuzz.generators.problems import path_problem
from experiments.fuzz.kinds import plans
from experiments.fuzz.oracle.motion import motion_of
from optdock.errors import OptdockError
from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.io.path_columns import curves_of
from optdock.io.proof_cells import proof_of
from optdock.model.constant_jerk import TimeLaw
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.path import ClothoidSegment, Path, PolylineSegment
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.model.trajectory import Trajectory
from optdock.planning.pipeline import plan_dock
from optdock.verification import certify_motion, certify_path
from optdock.verification.judge import Refusal
from optdock.verification.judge import judge as judged

if TYPE_CHECKING:
    from experiments.fuzz.case import Case

__all__ = ["another_file", "draw", "judge", "plan_text", "refusal_of"]

_PLANS, _MOTIONS = 0.05, 0.4  # shares of planned and of timed cases; the others are paths
_EASED = 0.6  # share of paths and motions with weaker rules, so that more of them are certified
_DAMAGES = 2  # per file; every damage costs as much as the file itself
_LONG = 1e6  # [s]: intervals of a longer motion are too wide
_OTHERS = ("hostile", "repeated", "swapped")


def draw(rng: np.random.Generator) -> Case:
    """Draw a path, a motion or a docking problem, and the seed of the damages."""
    share = rng.uniform()
    seed = int(rng.integers(1 << 31))
    if share < _PLANS:
        return {**plans.draw(rng), "kind": "judged", "damages": seed}
    if share < _PLANS + _MOTIONS:
        case = motion_problem(rng)
        while any(gear["type"] == "polyline" for gear in case["path"]):
            case = motion_problem(rng)
        if rng.uniform() < _EASED:
            case["limits"] = {name: 1.05 * value for name, value in case["limits"].items()}
        return {**_empty_floor(case), "kind": "judged", "damages": seed}
    case = path_problem(rng)
    while any(gear["type"] == "polyline" for gear in case["path"]):
        case = path_problem(rng)
    if rng.uniform() < _EASED:
        required, at_dock, *others = case["clearance"]
        case["clearance"] = [0.7 * required, min(at_dock, 0.7 * required), *others]
    return {**case, "kind": "judged", "damages": seed}


def _empty_floor(case: Case) -> Case:
    """Return a docking problem without obstacles that a motion solves."""
    motion = motion_of(case["path"])
    return {
        "footprint": {"polygon": [[0.4, 0.3], [-0.4, 0.3], [-0.4, -0.3], [0.4, -0.3]]},
        "obstacles": [],
        "dock": {"pose": motion.end.tolist(), "footprint": None, "direction": "auto", "final_straight": 0.0},
        "start": motion.start.tolist(),
        "clearance": [0.05, 0.0, 0.5],
        **case,
        "start_speed": case["start_speed"] * (-1.0 if case["path"][0].get("gear", 1) < 0 else 1.0),
        "start_acceleration": case["law"]["start_acceleration"] * (-1.0 if case["path"][0].get("gear", 1) < 0 else 1.0),
        "turns_in_place": any(gear["type"] == "turn" for gear in case["path"]) and "drive" not in case,
    }


def plan_text(path: Path, law: TimeLaw | None, proof: dict[str, object]) -> str:
    """Return a plan file without samples."""
    document: Case = {"format": "optdock-plan/1", "path": {"segments": curves_of(path)}, "proof": proof}
    if law is not None:
        start = [law.start_s, law.start_speed, law.start_acceleration]
        phases = {"start": start, "durations": law.durations.tolist(), "jerks": law.jerks.tolist()}
        document["trajectory"] = {"phases": phases}
    return json.dumps(document)


@functools.cache
def another_file() -> str:
    """Return an accepted file of a straight path of 1.234 m, of which parts are swapped into other files."""
    spline = ClothoidSpline(Pose2(5.0, 5.0, 0.3), np.array([0.0, 1.234]), np.zeros(2))
    path = Path((ClothoidSegment(spline),))
    robot = Robot(Footprint.rectangle(0.4, 0.4, 0.6), MotionLimits(max_acceleration=0.8, max_deceleration=0.8))
    problem = DockingProblem(path.start, Dock(path.end), robot)
    ramp = 0.5, 0.5
    law = TimeLaw(np.array([*ramp, 0.834 / 0.4, *ramp]), np.array([1.6, -1.6, 0.0, -1.6, 1.6]))
    proof = proof_of(path, problem, 0.0)
    assert proof is not None
    return plan_text(path, law, proof)


def refusal_of(text: str) -> str:
    """Return the reason why the second judge refuses a file, or an empty string."""
    try:
        judged(text)
    except Refusal as refusal:
        return str(refusal)
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError, OverflowError) as error:
        return f"{type(error).__name__}: {error}"
    return ""


def _certified(case: Case) -> tuple[Path, TimeLaw | None, DockingProblem, float] | str:
    """Return a certified path with its time law and its start relief, or the reason why there is none."""
    problem = problem_of(case)
    if "path" not in case:
        plan = plan_dock(problem, time_budget=case["budget"])
        return plan.path, plan.trajectory.time_law, problem, plan.certificate.start_relief
    path, law = path_of(case["path"]), law_of(case["law"]) if "law" in case else None
    if any(isinstance(segment, PolylineSegment) for segment in path.segments):
        return "poses"
    certificate = certify_path(path, problem)
    if not certificate.certified:
        return f"path refused: {certificate.violations[0].kind}"
    if law is not None and not (motion := certify_motion(Trajectory(path, law), problem)).certified:
        return f"motion refused: {motion.violations[0].kind}"
    if law is not None and law.duration > _LONG:
        return "too long to be judged"
    return path, law, problem, certificate.start_relief


def judge(case: Case) -> Verdict:
    """Write a file, let the second judge accept it, and damage it."""
    try:
        found = _certified(case)
    except OptdockError as error:
        return Verdict(f"no plan: {type(error).__name__}", str(error))
    if isinstance(found, str):
        return Verdict(found)
    path, law, problem, relief = found
    proof = proof_of(path, problem, relief)
    if proof is None:
        return Verdict("no proof in cells")
    text = plan_text(path, law, proof)
    reason = refusal_of(text)
    if reason:
        return Verdict("false refusal", reason)
    refused = 0
    rng = rng_of("damages", case["damages"], 0)
    for _ in range(_DAMAGES):
        name = str(rng.choice([*DAMAGES, *_OTHERS]))
        broken = damaged(text, name, rng, another_file())
        if broken is None:
            continue
        if not refusal_of(broken):
            return Verdict("false certificate", f"{name}: the damaged file is accepted")
        refused += 1
    return Verdict(f"accepted, {refused} damaged refused")
