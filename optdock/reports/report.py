"""Plans and runs written as files and tables."""

from __future__ import annotations

import math
import textwrap
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.obstacles import in_words
from optdock.impossibility import NoMotionProof
from optdock.io.plan_file import CERTIFIED, PlanError, PlanFile, finite_or_null, strict_json
from optdock.io.run_file import RUN_FORMAT
from optdock.model.limits import LIMIT_UNITS, STEERING_UNITS
from optdock.planning.plan import PartialPlan

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Sequence

    from optdock.errors import OptdockError
    from optdock.geometry.arrays import FloatArray
    from optdock.model.limits import MotionLimits
    from optdock.planning.plan import DockPlan
    from optdock.samples.tube import Deviations
    from optdock.simulation import Run
    from optdock.verification import Certificate

__all__ = [
    "certificate_rows",
    "failed_plan_file",
    "limit_rows",
    "plan_rows",
    "run_json",
    "run_rows",
    "table",
]

_WIDE = 78  # characters of a value on a line
_NO_BREAK = "\N{NO-BREAK SPACE}"


class Row(NamedTuple):
    """One line of a summary."""

    name: str
    value: str


def failed_plan_file(error: OptdockError, frame: str) -> PlanFile:
    """Return the plan file of a failure, with the name of the error, its reason, and the results so far.

    A path without a certificate is not written, because paths in plan files are intended to be driven.
    """
    so_far, proof = PartialPlan.left_by(error), getattr(error, "proof", None)
    judged = so_far.certificate is not None and proof is None  # no path next to a proof that no path exists
    return PlanFile(
        status=type(error).__name__,
        frame=frame,
        raw_path=so_far.raw_path,
        path=so_far.path if judged else None,
        certificate=so_far.certificate.as_dict() if judged and so_far.certificate is not None else None,
        timing_ms=so_far.timing_ms,
        tried=tuple(attempt.as_dict() for attempt in so_far.tried),
        error=PlanError.from_exception(error),
        impossibility=proof if isinstance(proof, NoMotionProof) else None,
    )


def plan_rows(plan: DockPlan) -> list[Row]:
    """Summarize a certified plan."""
    gears = " ".join(segment.direction.name.lower().replace("_", "-") for segment in plan.path.segments)
    status = CERTIFIED if plan.completed else f"{CERTIFIED}, stopped early by the time budget"
    times = ", ".join(f"{stage} {ms:.1f}" for stage, ms in plan.timing_ms.items())
    return [
        Row("status", status),
        Row("gears", gears),
        *([Row("found by", _tried(plan))] if plan.tried else []),
        Row("duration", f"{plan.trajectory.duration:.3f} s"),
        *certificate_rows(plan.certificate),
        *_tightest_rows(plan),
        *_straight_rows(plan),
        Row("time [ms]", times),
    ]


def _tightest_rows(plan: DockPlan) -> list[Row]:
    """Return the least difference from the required clearance away from the start and the dock."""
    place, required = plan.tightest(), plan.problem.clearance.required
    if place is None:
        return []
    what = in_words(place.obstacle)
    text = f"{place.margin:.4f} m more than the required {required:.4f} m, to {what} at s = {place.s:.3f} m"
    return [Row("least margin", text)]


def _straight_rows(plan: DockPlan) -> list[Row]:
    """Return the length of the straight end of the path."""
    straight = plan.problem.dock.final_straight
    return [Row("final straight", f"{straight:g} m" if straight > 0.0 else "none: dock.final_straight is 0")]


def _tried(plan: DockPlan) -> str:
    """Return the stage that found the plan, and the number of guesses."""
    guesses = [attempt for attempt in plan.tried if attempt.guess is not None]
    made = sum(not attempt.reason for attempt in guesses)
    return f"{plan.stage}, {made} of {len(guesses)} guesses became plans" if len(guesses) > 1 else plan.stage


def certificate_rows(certificate: Certificate) -> list[Row]:
    """Summarize a certificate."""
    rows = [Row("length", f"{certificate.length:.3f} m"), Row("max curvature", f"{certificate.max_curvature:.3f} 1/m")]
    if math.isfinite(certificate.min_clearance):
        where = f"to {in_words(certificate.nearest)} at s = {certificate.at_s:.3f} m"
        required = f"required there {certificate.required_clearance:.4f} m"
        rows.append(Row("min clearance", f"{round(certificate.min_clearance, 4) + 0.0:.4f} m {where}, {required}"))
    if certificate.view_margin is not None and certificate.certified:
        inside = f", at least {certificate.view_margin:.4f} m inside" if math.isfinite(certificate.view_margin) else ""
        rows.append(Row("dock in view", f"where it must be{inside}"))
    return rows


def limit_rows(limits: MotionLimits, defaults: Collection[str] = ()) -> list[Row]:
    """Summarize the motion limits, and name the unlimited quantities.

    Args:
        limits: Limits of the robot.
        defaults: Names of limits that were not given.
    """
    units = LIMIT_UNITS | (STEERING_UNITS if limits.wheelbase > 0.0 else {})
    values = {name: getattr(limits, name) for name in units}
    known = (
        f"{_words(name)} {value:g} {units[name]}" + (" (default)" if name in defaults else "")
        for name, value in values.items()
        if math.isfinite(value)
    )
    unlimited = (_words(name) for name, value in values.items() if not math.isfinite(value))
    return [*_wrapped("limits", known), *_wrapped("unlimited", unlimited)]


def _wrapped(name: str, parts: Iterable[str]) -> list[Row]:
    """Return rows of items, separated by commas and wrapped between items; no rows if there are no items."""
    lines = textwrap.wrap(", ".join(part.replace(" ", _NO_BREAK) for part in parts), _WIDE)
    return [Row(name if i == 0 else "", line.replace(_NO_BREAK, " ")) for i, line in enumerate(lines)]


def _words(name: str) -> str:
    return name.removeprefix("max_").replace("_", " ")


def run_rows(run: Run, deviations: Deviations | None = None, left: str = "") -> list[Row]:
    """Summarize a simulated run.

    Args:
        run: The run.
        deviations: Deviations of its poses from the certified path; None if there is no path.
        left: Description of the poses outside the proven region, see `beyond_proof`; empty if all are inside.
    """
    error = run.final_error
    rows = [
        *([Row("NOT AS PROVEN", left)] if left else []),
        Row("docked", ("yes" if run.docked else f"no: {run.reason}") if not run.collided else f"no, {run.fault}"),
        Row("final error", f"along {1e3 * error.x:+.2f} mm, cross {1e3 * error.y:+.2f} mm, yaw {error.yaw:+.5f} rad"),
        Row("largest error", _largest_error(run.errors)),
        Row("driving time", f"{run.duration:.2f} s"),
    ]
    if run.verdicts:
        text = (f"{name}: {'reached' if reached else 'not reached'}" for name, reached in run.verdicts.items())
        rows.insert(2 if left else 1, Row("goal checkers", ", ".join(text)))
    if run.min_clearance is not None:
        rows.append(Row("min clearance driven", f"{run.min_clearance:.4f} m"))
    if deviations is not None:
        rows += _tube_rows(run, deviations)
    if run.differs:
        rows.append(Row("certified for", f"another {' and '.join(run.differs)}"))
    return rows


def _tube_rows(run: Run, deviations: Deviations) -> list[Row]:
    """Return the deviations of the drive, and whether it stayed in the proven tube."""
    off, yaw = float(np.hypot(deviations.along, deviations.cross).max()), float(np.abs(deviations.yaw).max())
    farthest, width = float(deviations.displacement.max()), float(deviations.width.max())
    needed = f"{1e3 * off:.2f} mm and {yaw:.5f} rad, no point of the robot by more than {1e3 * farthest:.2f} mm"
    outside = deviations.excess > 0.0
    to_go = np.hypot(run.poses[:, 0] - run.goal.x, run.poses[:, 1] - run.goal.y)
    if width == 0.0:
        text = "not certified; set robot.tracking"
    elif not outside.any():
        text = f"kept, {1e3 * width:.1f} mm wide before it tapers"
    else:
        worst = int(np.argmax(deviations.excess))
        text = f"left {to_go[outside].max():.3f} m from the dock, by {1e3 * deviations.excess[worst]:.2f} mm at most"
    return [Row("off the path", needed), Row("tube", text)]


def _largest_error(errors: FloatArray) -> str:
    along, cross, yaw = np.max(np.abs(errors), axis=0)
    return f"along {1e3 * along:.2f} mm, cross {1e3 * cross:.2f} mm, yaw {yaw:.5f} rad"


def run_json(run: Run, seed: int) -> str:
    """Return a simulated run as strict JSON, format `optdock-run/1`, columns in SI units."""
    error = run.final_error
    columns: dict[str, object] = {"t": run.times}
    for name, table_, parts in (
        ("", run.poses, ("x", "y", "yaw")),
        ("measured_", run.measured, ("x", "y", "yaw")),
        ("planned_", run.references, ("x", "y", "yaw")),
        ("error_", run.errors, ("along", "cross", "yaw")),
        ("command_", run.commands, ("speed", "yaw_rate")),
        ("", run.twists, ("speed", "yaw_rate")),
    ):
        columns.update({f"{name}{part}": table_[:, i] for i, part in enumerate(parts)})
    head = {"format": RUN_FORMAT, "docked": run.docked, "reason": run.reason, "seed": seed, "duration": run.duration}
    head["collided"], head["goal_checkers"] = run.collided, dict(run.verdicts)
    final = {"along": error.x, "cross": error.y, "yaw": error.yaw}
    body = {"final_error": final, "min_clearance": run.min_clearance, "columns": columns}
    return strict_json({key: finite_or_null(value) for key, value in {**head, **body}.items()})


def table(rows: Sequence[Sequence[str]]) -> str:
    """Return rows of text as aligned columns."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
    return "\n".join(lines)
