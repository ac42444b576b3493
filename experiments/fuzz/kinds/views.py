"""The view of the dock by `certify_path`: no proof of a view that the oracle sees lost, no refusal of a clear view.

Other faults of a path (slips, jumps, curvature) are independent of the view: the view counts as certified if the
certificate reports neither the view nor anything unproven.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from experiments.fuzz.case import Verdict
from experiments.fuzz.doors import path_of, problem_of
from experiments.fuzz.generators.views import view_problem
from experiments.fuzz.oracle.motion import motion_of
from experiments.fuzz.oracle.views import views
from experiments.fuzz.truth import says_yes
from optdock.errors import OptdockError
from optdock.geometry.pose import Pose2
from optdock.model.camera import Camera
from optdock.verification import certify_path

if TYPE_CHECKING:
    from experiments.fuzz.case import Case
    from optdock.model.problem import DockingProblem
    from optdock.verification import Certificate

__all__ = ["draw", "judge"]

_FORGIVEN = 2e-6  # [m]: twice the tolerance of the certificate
_SPARE = 1e-4  # [m]: a path with more reserve must not be refused


def draw(rng: np.random.Generator) -> Case:
    """Draw a random motion with a random camera."""
    return view_problem(rng)


def judge(case: Case) -> Verdict:
    """Compare the verdicts of the library and the oracle."""
    try:
        certificate = certify_path(path_of(case["path"]), _seeing(case))
    except OptdockError as error:
        return Verdict(f"input refused: {type(error).__name__}", str(error))
    whole, kinds = says_yes(certificate), {violation.kind for violation in certificate.violations}
    if kinds & {"view", "unproven"}:
        return _wrongly_refused(case, certificate) or Verdict(f"refused: {min(kinds & {'view', 'unproven'})}")
    return _refuted(case, certificate) or Verdict("certified" if whole else "seen, another rule is broken")


def _seeing(case: Case) -> DockingProblem:
    problem, camera = problem_of(case), case["camera"]
    farthest = math.inf if camera["max_range"] is None else camera["max_range"]
    eye = Camera(Pose2(*camera["mount"]), camera["field_of_view"], camera["min_range"], farthest)
    dock = replace(
        problem.dock,
        marker=tuple(case["marker"]),
        visible_distance=case["visible_distance"],
        blind_distance=case["blind_distance"],
    )
    return replace(problem, dock=dock, robot=replace(problem.robot, camera=eye))


def _refuted(case: Case, certificate: Certificate) -> Verdict | None:
    """Return evidence that the view is lost, or that the claimed bounds are too large."""
    seen = views(case, motion_of(case["path"]))
    if not seen.s.size:
        return None
    k, least = int(np.argmin(seen.spare)), float(seen.inside.min())
    if not seen.spare[k] >= -_FORGIVEN:
        text = (
            f"view, {_scene(case)}: {-seen.spare[k]:.4g} m short at s = {seen.s[k]:.9g} m, bearing "
            f"{seen.bearing[k]:.9g} rad, distance {seen.distance[k]:.9g} m"
        )
        return Verdict("false certificate", text)
    claimed = certificate.view_margin
    if claimed is None or not claimed <= least + _FORGIVEN:
        return Verdict("overclaimed bound", f"view, {_scene(case)}: claimed {claimed} m, a pose has {least:.9g} m")
    return None


def _wrongly_refused(case: Case, certificate: Certificate) -> Verdict | None:
    """Return evidence that a refusal is clearly unfounded: reserve everywhere by the oracle, and at the named place."""
    seen = views(case, motion_of(case["path"]))
    named = next(v for v in certificate.violations if v.kind in ("view", "unproven"))
    least = float(seen.spare.min()) if seen.s.size else math.inf
    if least > _SPARE and not (case.get("tracking") and case["clearance"][2] == 0.0):
        return Verdict("false refusal", f"view, {_scene(case)}: {named.message}; by the oracle {least:.6g} m to spare")
    return None


def _scene(case: Case) -> str:
    """Return a description that distinguishes failures of different origin."""
    kinds = sorted({gear["type"] for gear in case["path"]})
    wide = "wide" if case["camera"]["field_of_view"] > math.pi else "narrow"
    return f"{' and '.join(kinds)}, {wide}{', tube' if case.get('tracking') else ''}"
