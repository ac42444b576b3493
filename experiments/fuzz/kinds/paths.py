"""`certify_path` on random paths: no certificate that the oracle refutes, no refusal that is clearly wrong."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from experiments.fuzz.case import Verdict
from experiments.fuzz.doors import path_of, problem_of
from experiments.fuzz.generators.problems import path_problem
from experiments.fuzz.oracle.motion import motion_of
from experiments.fuzz.oracle.rules import findings
from experiments.fuzz.oracle.sweep import jumps_at_goal, required_at, start_clearance, start_run, sweep, tube
from experiments.fuzz.oracle.world import World
from experiments.fuzz.truth import says_yes
from optdock.errors import OptdockError
from optdock.verification import certify_path

if TYPE_CHECKING:
    from experiments.fuzz.case import Case
    from experiments.fuzz.oracle.motion import Motion
    from optdock.verification import Certificate

__all__ = ["draw", "judge", "refuted"]

_FORGIVEN = 2e-6  # [m]: twice the tolerance of the certificate
_SPARE = 1e-3  # [m]: a path with more margin must not be refused for its clearance
_ROUND = 0.02  # of the radius: a disc may be approximated by the circumscribed polygon


def draw(rng: np.random.Generator) -> Case:
    """Draw a random path problem."""
    return path_problem(rng)


def judge(case: Case) -> Verdict:
    """Compare the verdicts of the library and the oracle."""
    try:
        path, problem = path_of(case["path"]), problem_of(case)
        certificate = certify_path(path, problem)
    except OptdockError as error:
        return Verdict(f"input refused: {type(error).__name__}", str(error))
    if says_yes(certificate):
        return refuted(case, certificate) or Verdict("certified")
    return _wrongly_refused(case, certificate) or Verdict(f"refused: {certificate.violations[0].kind}")


def refuted(case: Case, certificate: Certificate) -> Verdict | None:
    """Return evidence that a certificate is false, or claims too large bounds."""
    motion = motion_of(case["path"])
    for finding in findings(case, motion):
        if finding.is_broken:
            text = (
                f"{finding.kind}, {_scene(case)}: {finding.ratio:.4g} times what is tolerated at s = {finding.s:.6g} m"
            )
            return Verdict("false certificate", text)
    world = World.of(case)
    if world.is_empty:
        return None
    run, relief = start_run(case), certificate.start_relief
    if relief and abs(relief - run) > _ROUND * run:
        return Verdict(
            "false certificate", f"start relief, {_scene(case)}: {relief:.9g} m, the rule allows {run:.9g} m"
        )
    seen = sweep(case, motion, world, relief=relief)
    k, least = seen.worst, int(np.argmin(seen.clearance))
    if not seen.margin[k] >= -_FORGIVEN:
        text = (
            f"clearance, {_scene(case)}: {-seen.margin[k]:.4g} m short at s = {seen.s[k]:.9g} m, "
            f"pose {seen.poses[k].tolist()}; "
            f"clearance there {seen.clearance[k]:.9g} m, proven {certificate.min_clearance:.9g} m"
        )
        return Verdict("false certificate", text)
    for name, claimed, found in (
        ("min_clearance", certificate.min_clearance, seen.clearance[least]),
        ("margin", certificate.margin, seen.margin[k]),
    ):
        if not claimed <= found + _FORGIVEN:
            return Verdict(
                "overclaimed bound", f"{name}, {_scene(case)}: claimed {claimed:.9g} m, a pose has {found:.9g} m"
            )
    return None


def _wrongly_refused(case: Case, certificate: Certificate) -> Verdict | None:
    """Return evidence that every reason of a refusal is clearly unfounded."""
    kinds = {violation.kind for violation in certificate.violations}
    motion = motion_of(case["path"])
    doubtful = {finding.kind for finding in findings(case, motion) if not finding.is_kept}
    unfounded = kinds - doubtful - {"clearance", "unproven"}
    if unfounded:
        message = next(v.message for v in certificate.violations if v.kind in unfounded)
        return Verdict("false refusal", f"{sorted(unfounded)[0]}, {_scene(case)}: {message}")
    if not kinds <= {"clearance", "unproven"} or not _has_room(case, motion, certificate):
        return None
    return Verdict("false refusal", f"clearance, {_scene(case)}: {certificate.reason}")


def _scene(case: Case) -> str:
    """Return a description that distinguishes failures: the path, the robot, and the obstacles."""
    path = "polyline" if any(gear["type"] == "polyline" for gear in case["path"]) else "clothoid"
    grid = "" if case.get("grid") is None else (", grid alone" if case.get("grid_alone") else ", grid")
    contact = ", contact" if case["clearance"][1] == 0.0 else ""
    return path + (", disc" if "radius" in case["footprint"] else "") + grid + contact


def _has_room(case: Case, motion: Motion, certificate: Certificate) -> bool:
    """Whether the margin exceeds a millimetre everywhere, including the place named by the certificate."""
    if jumps_at_goal(case):
        return False
    world = World.of(case)
    spare, kept = _SPARE + _ROUND * world.radius, start_clearance(case, world)
    # A start with nearly the required clearance may be checked by the strict rule alone.
    run = start_run(case) if kept < case["clearance"][0] + tube(case) - _SPARE else 0.0
    shown = [violation.where["pose"] for violation in certificate.violations if "pose" in violation.where]
    if shown and not world.is_empty:
        poses = np.array(shown, dtype=float)
        spared = world.clearances(poses) - required_at(case, poses, kept, run)
        if float(spared.min()) <= spare:
            return False
    if float(sweep(case, motion, world, refine=False, relief=run).margin.min()) <= spare:
        return False
    return bool(sweep(case, motion, world, relief=run).margin.min() > spare)
