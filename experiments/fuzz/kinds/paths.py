"""`certify_path` on random paths: no certificate that the oracle refutes, no refusal that is clearly wrong.

A case has further requirements near the least clearance of its path, each with a certificate of its own. Where the
requirement is the same at every pose, the sweep of the path judges all of them.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from experiments.fuzz.case import Verdict
from experiments.fuzz.doors import path_of, problem_of
from experiments.fuzz.generators.problems import path_problem, wanted_margin
from experiments.fuzz.lanes import compares_lanes, path_differs
from experiments.fuzz.oracle.motion import motion_of
from experiments.fuzz.oracle.rules import findings
from experiments.fuzz.oracle.sweep import jumps_at_goal, required_at, start_clearance, start_run, sweep, tube
from experiments.fuzz.oracle.world import World
from experiments.fuzz.truth import says_yes
from optdock.errors import OptdockError
from optdock.model.clearance_rule import ClearanceRule
from optdock.verification import certify_path

if TYPE_CHECKING:
    from experiments.fuzz.case import Case
    from experiments.fuzz.oracle.motion import Motion
    from experiments.fuzz.oracle.rules import Finding
    from experiments.fuzz.oracle.sweep import Sweep
    from optdock.model.path import Path
    from optdock.model.problem import DockingProblem
    from optdock.verification import Certificate

__all__ = ["draw", "judge", "refuted"]

_FORGIVEN = 2e-6  # [m]: twice the tolerance of the certificate
_SPARE = 1e-3  # [m]: a path with more margin must not be refused for its clearance
_ROUND = 0.02  # of the radius: a disc may be approximated by the circumscribed polygon
_EXACTLY = 1e-5  # [m]: by which the clearance of a start must exceed the requirement
_LARGEST = 0.1  # [m]: margin of further requirements
_REFUSED, _KEPT = 2, 8  # further requirements of a case: as drawn for the first one, and with a margin


def draw(rng: np.random.Generator) -> Case:
    """Draw a random path problem, and margins of further requirements."""
    own = rng.spawn(1)[0]
    case = path_problem(rng)
    return {**case, "margins": [wanted_margin(own) for _ in range(_REFUSED)] + _kept_margins(own)}


def _kept_margins(rng: np.random.Generator) -> list[float]:
    """Return margins [m] that certificates have: half of them near the limit."""
    exponents = np.append(rng.uniform(-7.0, -3.0, _KEPT - _KEPT // 2), rng.uniform(-3.0, -1.0, _KEPT // 2))
    return (_LARGEST * 10.0 ** (1.0 + exponents)).tolist()


def judge(case: Case) -> Verdict:
    """Compare the verdicts of the library and the oracle."""
    try:
        path, problem = path_of(case["path"]), problem_of(case)
        certificate = certify_path(path, problem)
    except OptdockError as error:
        return Verdict(f"input refused: {type(error).__name__}", str(error))
    asked = _Asked(path, path_of(case["path"]) if compares_lanes() else None, problem)
    motion, world = motion_of(case["path"]), World.of(case)
    found, seen, word = findings(case, motion), None, "certified"
    if says_yes(certificate):
        seen = _seen(case, motion, world, certificate.start_relief)
        wrong = _refuted(case, found, seen, certificate)
    else:
        word = f"refused: {certificate.violations[0].kind}"
        wrong = _wrongly_refused(case, certificate)
    wrong = wrong or asked.differs(certificate, problem)
    if wrong is not None:
        return Verdict(wrong.outcome, wrong.detail, _alone(case))
    number = int(word == "certified")
    if {violation.kind for violation in certificate.violations} <= {"clearance", "unproven"} and not world.is_empty:
        if seen is None or _varies(case, world):
            seen = sweep({**case, "clearance": [0.0, 0.0, 0.0]}, motion, world)
        wrong, more = _about_others(case, world, found, seen, asked)
        if wrong is not None:
            return wrong
        number += more
    return Verdict(word, checked={"certificates": number} if number else {})


def _varies(case: Case, world: World) -> bool:
    """Whether the required clearance differs between poses, so that its sweep may miss the least clearance."""
    required, at_dock, *_ = case["clearance"]
    return bool(tube(case) > 0.0 or required != at_dock or start_clearance(case, world) <= required + _EXACTLY)


def _alone(case: Case) -> Case:
    """Return a case without further requirements."""
    return {key: value for key, value in case.items() if key != "margins"}


class _Asked(NamedTuple):
    """A path, the same path for the twin lane or None if lanes are not compared, and a problem."""

    path: Path
    again: Path | None
    problem: DockingProblem

    def differs(self, certificate: Certificate, problem: DockingProblem) -> Verdict | None:
        return None if self.again is None else path_differs(certificate, self.again, problem)


def _about_others(
    case: Case, world: World, found: list[Finding], seen: Sweep, asked: _Asked
) -> tuple[Verdict | None, int]:
    """Certify the path with further requirements, which are constant; return a fault, and the number of certificates.

    A requirement is lower than the clearance of the start, because that of a start that is too close is not constant.
    """
    begun, number = start_clearance(case, world), 0
    most = begun - tube(case) - _EXACTLY
    for margin in case.get("margins", ()):
        needed = _needed(margin, float(seen.clearance.min()) - tube(case), most)
        if needed is None:
            continue
        problem = replace(asked.problem, clearance=ClearanceRule(needed, needed, 0.0))
        certificate = certify_path(asked.path, problem)
        other = {**_alone(case), "clearance": [needed, needed, 0.0]}
        judged = replace(seen, margin=seen.clearance - required_at(other, seen.poses, begun, certificate.start_relief))
        wrong = _refuted(other, found, judged, certificate) if says_yes(certificate) else None
        wrong = wrong or asked.differs(certificate, problem)
        if wrong is not None:
            return Verdict(wrong.outcome, wrong.detail, other), number
        number += bool(certificate)
    return None, number


def _needed(margin: float, least: float, most: float) -> float | None:
    """Return the requirement that leaves a margin of `least`, or else a share of the largest possible one [m].

    None if there is none, or none that a negative margin refuses.
    """
    if least - margin <= most and least - margin >= 0.0:
        return least - margin
    top = min(least, most)
    return None if margin < 0.0 or top <= 0.0 else top * (1.0 - min(abs(margin) / _LARGEST, 1.0) ** 0.2)


def _seen(case: Case, motion: Motion, world: World, relief: float) -> Sweep | None:
    """Return the sweep of a certified path; None without obstacles."""
    return None if world.is_empty else sweep(case, motion, world, relief=relief)


def refuted(case: Case, certificate: Certificate, world: World | None = None) -> Verdict | None:
    """Return evidence that a certificate is false, or claims too large bounds.

    Args:
        case: Problem and path.
        certificate: A certificate of the path.
        world: The obstacles of the case, if they are known already.
    """
    motion = motion_of(case["path"])
    seen = _seen(case, motion, World.of(case) if world is None else world, certificate.start_relief)
    return _refuted(case, findings(case, motion), seen, certificate)


def _refuted(case: Case, found: list[Finding], seen: Sweep | None, certificate: Certificate) -> Verdict | None:
    for finding in found:
        if finding.is_broken:
            text = (
                f"{finding.kind}, {_scene(case)}: {finding.ratio:.4g} times what is tolerated at s = {finding.s:.6g} m"
            )
            return Verdict("false certificate", text)
    if seen is None:
        return None
    run, relief = start_run(case), certificate.start_relief
    if relief and abs(relief - run) > _ROUND * run:
        return Verdict(
            "false certificate", f"start relief, {_scene(case)}: {relief:.9g} m, the rule allows {run:.9g} m"
        )
    k, least = seen.worst, int(np.argmin(seen.clearance))
    if not seen.margin[k] >= -_FORGIVEN:
        text = (
            f"clearance, {_scene(case)}: {-seen.margin[k]:.4g} m short at s = {seen.s[k]:.9g} m, "
            f"pose {seen.poses[k].tolist()}; "
            f"clearance there {seen.clearance[k]:.9g} m, proven {certificate.min_clearance:.9g} m"
        )
        return Verdict("false certificate", text)
    for name, claimed, true in (
        ("min_clearance", certificate.min_clearance, seen.clearance[least]),
        ("margin", certificate.margin, seen.margin[k]),
    ):
        if not claimed <= true + _FORGIVEN:
            return Verdict(
                "overclaimed bound", f"{name}, {_scene(case)}: claimed {claimed:.9g} m, a pose has {true:.9g} m"
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
