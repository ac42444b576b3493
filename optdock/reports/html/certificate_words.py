"""The certificate or refusal of a plan file in words and tables."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from optdock.geometry.obstacles import in_words
from optdock.impossibility import BlockedStraight
from optdock.io.quoting import in_digits
from optdock.model.limits import QUANTITY_UNITS
from optdock.reports.html.page import Table, Text

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from optdock.io.plan_file import PlanFile
    from optdock.model.problem import DockingProblem
    from optdock.reports.plan_file_verdict import PlanFileVerdict

__all__ = ["claimed", "plan_tables", "plan_texts"]

_NOT_PROVEN = (
    "Perception: whether the obstacles, the map and the dock are where the scenario states them, and whether the pose "
    "of the robot is measured correctly.",
    "Obstacles that move or that are not in the scenario.",
    "Execution: whether the drive follows the trajectory. The proof holds only for poses within the tracking tube.",
    "Functional safety: a certificate does not replace a safety function of the robot.",
)
_OF_SCENE = 2  # of these sentences, which also apply to refusals
_UNITS = {
    "length": "m", "min_clearance": "m", "required_clearance": "m", "at_s": "m", "margin": "m", "tube": "m",
    "start_relief": "m", "view_margin": "m", "max_curvature": "1/m", "max_curvature_rate": "1/m^2",
}  # fmt: skip


def claimed(plan: PlanFile, name: str, otherwise: float) -> float:
    """Return a number of the certificate in the file, or `otherwise` if it is missing or infinite."""
    value = (plan.certificate or {}).get(name)
    return float(value) if isinstance(value, int | float) else otherwise


def plan_texts(plan: PlanFile, problem: DockingProblem | None, verdict: PlanFileVerdict | None) -> Iterator[Text]:
    """Generate the texts: what is proven or why the plan was refused, and what is not proven.

    Args:
        plan: The file.
        problem: Its problem; None if it is not known.
        verdict: Verdict on the file; None if it was not checked.
    """
    if plan.impossibility is not None:
        yield Text(_heading("Proof that no motion exists", verdict, "impossible"), [*_impossibility_words(plan)])
    elif plan.error is not None:
        where = [f"{key}: {in_digits(value)}" for key, value in plan.error.where.items()]
        yield Text("Reason of the refusal", [f"{plan.status} (code {plan.error.code}): {plan.error.message}", *where])
    if plan.certificate is not None and plan.certificate.get("certified"):
        is_sampled = verdict is not None and verdict.outcome == "unproven"
        sentences = [*_path_words(plan, problem)]
        sentences += (
            _motion_words(plan.certificate) if not is_sampled else ["The motion between samples is not proven."]
        )
        yield Text(_heading("Proven", verdict, "unproven" if is_sampled else "certified"), sentences)
    yield Text("Not proven", _NOT_PROVEN if plan.certificate is not None else _NOT_PROVEN[:_OF_SCENE])


def _heading(words: str, verdict: PlanFileVerdict | None, wanted: str) -> str:
    """Return a heading that states whether the claims of the file were checked."""
    if verdict is None:
        return f"{words}, as the file states; not checked for this report"
    return words if verdict.outcome == wanted else f"{words}, as the file states; refuted by the check"


def _impossibility_words(plan: PlanFile) -> Iterator[str]:
    proof = plan.impossibility
    assert proof is not None
    yield f"{proof.message[0].upper()}{proof.message[1:]}."
    if isinstance(proof, BlockedStraight):
        yield "Every motion into the dock ends on its final straight, and these poses on the straight are blocked."
        return
    yield (
        f"No motion leaves the area around the {proof.end} in the scene, at any heading, with any curvature, in "
        "both gears: all cells of poses at its rim are blocked, because at each of their poses an obstacle is nearer "
        "than the required clearance."
    )
    yield f"The proof consists of {len(proof.tiles) + len(proof.whole)} tiles; optdock certify checks it again."
    if proof.bottleneck is not None:
        yield "The bottleneck is a diagnosis and not part of the proof."


def _path_words(plan: PlanFile, problem: DockingProblem | None) -> Iterator[str]:
    certificate = plan.certificate or {}
    least, required = claimed(plan, "min_clearance", math.inf), claimed(plan, "required_clearance", 0.0)
    nearest, at = in_words(str(certificate.get("nearest", ""))), claimed(plan, "at_s", math.nan)
    if math.isfinite(least):
        yield (
            f"At every point of the path, not only at samples, the footprint is at least {least:.4f} m from every "
            f"obstacle; this minimum is to {nearest} at s = {at:.3f} m, where {max(required, 0.0):.4f} m is required."
        )
    margin, tube = claimed(plan, "margin", math.inf), claimed(plan, "tube", 0.0)
    if math.isfinite(margin):
        more = (
            f"exceeds the required one by at least {margin:.4f} m" if margin >= 1e-4 else "is at least the required one"
        )
        yield f"Everywhere, the clearance {more}."
    if tube > 0.0 and problem is not None:
        tracking = problem.robot.tracking
        yield (
            f"The clearance is kept by every pose within the tracking tube: up to {tracking.cross:.4f} m off the path "
            f"and {tracking.yaw:.4f} rad off its heading, which moves the footprint by up to {tube:.4f} m; the tube "
            "tapers at the dock."
        )
    elif tube == 0.0:
        yield "There is no tracking tube: the proof holds for the robot exactly on its path."
    if certificate.get("view_margin") is not None:
        margin = claimed(plan, "view_margin", 0.0)
        yield f"The marker of the dock is in view where required, by at least {margin:.4f} m."


def _motion_words(certificate: Mapping[str, object]) -> Iterator[str]:
    motion = certificate.get("trajectory")
    if not isinstance(motion, dict) or not motion.get("certified"):
        yield "The file has no certificate of the motion limits."
        return
    ratios = {name: ratio for name, ratio in (motion.get("ratios") or {}).items() if ratio is not None}
    used = ", ".join(f"{name.replace('_', ' ')} {100.0 * ratio:.1f} %" for name, ratio in ratios.items())
    yield f"At every instant, the motion keeps its limits; largest share of each limit: {used or 'no limit is finite'}."


def plan_tables(plan: PlanFile, verdict: PlanFileVerdict | None) -> Iterator[Table]:
    """Generate the tables: verdict, certificate, tried guesses, times."""
    if verdict is not None:
        yield Table("Checked for this report", (), verdict.rows)
    certificate = [*_certificate_rows(plan.certificate or {})]
    if certificate:
        yield Table("Certificate in the file", ("quantity", "value", "unit"), certificate)
    if plan.timing_ms:
        rows = [(stage, f"{value:.1f}") for stage, value in plan.timing_ms.items()]
        yield Table("Time of the call", ("stage", "time [ms]"), rows)
    if plan.tried:
        head = ("guess of", "length [m]", "cusps", "time [ms]", "price [s]", "result")
        yield Table("Tried guesses", head, [_tried_row(one) for one in plan.tried])


def _certificate_rows(certificate: Mapping[str, object]) -> Iterator[tuple[str, str, str]]:
    for name, unit in _UNITS.items():
        if name in certificate:
            value = certificate[name]
            yield name.replace("_", " "), "unlimited" if value is None else f"{value:.6f}", unit
    motion = certificate.get("trajectory")
    if isinstance(motion, dict):
        for name, ratio in (motion.get("ratios") or {}).items():
            of = f"% of the limit [{QUANTITY_UNITS.get(name, '')}]"
            yield f"largest {name.replace('_', ' ')}", "" if ratio is None else f"{100.0 * ratio:.2f}", of


def _tried_row(one: Mapping[str, object]) -> tuple[str, ...]:
    columns = (("length", 1.0, 3), ("cusps", 1.0, 0), ("seconds", 1e3, 1), ("price", 1.0, 3))
    cells = []
    for name, scale, digits in columns:
        value = one.get(name)
        cells.append(f"{scale * value:.{digits}f}" if isinstance(value, int | float) else "")
    # A guess may have run out of its share of the time long before the end of the call, so its advice is left out.
    reason = str(one.get("reason") or "certified").partition("; raise time_budget")[0]
    return (str(one.get("stage", "")), *cells, reason)
