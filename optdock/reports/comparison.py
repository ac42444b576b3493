"""Figures of raw and smoothed paths for `optdock compare`."""

from __future__ import annotations

import csv
import io
import itertools
import math
import time
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.errors import FailedToTimePath, OptdockError
from optdock.geometry.pose import normalize_angle, wrap_angles
from optdock.model.path import PolylineSegment
from optdock.planning.guess_edits import FEWER_CUSPS
from optdock.planning.plan import PartialPlan, tightest_place
from optdock.planning.refinement import AtWork, Cancellation, plain, returned
from optdock.plugins.interfaces import Smoother, SmoothingResult, never_cancelled
from optdock.plugins.registry import plugin_from, timed_by
from optdock.reports.report import table
from optdock.verification import certify_path

if TYPE_CHECKING:
    from collections.abc import Sequence

    from optdock.config import Scenario
    from optdock.model.path import Path, Segment
    from optdock.planning.plan import DockPlan
    from optdock.plugins.registry import PluginChoice
    from optdock.verification import Certificate
    from optdock.verification.certificate import Violation

__all__ = [
    "PathFigures",
    "comparison_csv",
    "comparison_table",
    "figures_of",
    "planned_figures",
    "raw_path_of",
    "smoothed_figures",
    "worst_joint_angle",
]


class PathFigures(NamedTuple):
    """Figures of one path; figures that do not exist are None.

    Args:
        scenario: Name of the scenario.
        path: `raw` or `smoothed`.
        status: `certified`, `not certified`, or the name of the error.
        length: Driven length [m].
        max_curvature: Largest |curvature| [1/m].
        worst_joint: Largest jump of the direction of motion [deg].
        min_clearance: Smallest distance of the footprint from an obstacle [m].
        duration: Duration under the motion limits [s].
        smoother: Name of the smoother; empty for a raw path.
        cusps: Number of changes of gear.
        max_curvature_rate: Largest |d curvature / ds| [1/m^2].
        margin: Smallest difference between the clearance and the required clearance, away from the start and the
            dock, see `DockPlan.tightest` [m].
        cpu: CPU time of the smoother's call, or of the whole planning call for the path of a plan [ms].
        reason: Message of the smoother's error, or of the largest violation of every rule that the path breaks.
    """

    scenario: str
    path: str
    status: str
    length: float | None = None
    max_curvature: float | None = None
    worst_joint: float | None = None
    min_clearance: float | None = None
    duration: float | None = None
    smoother: str = ""
    cusps: int | None = None
    max_curvature_rate: float | None = None
    margin: float | None = None
    cpu: float | None = None
    reason: str = ""


_UNITS = {
    "length": "m", "max_curvature": "1/m", "worst_joint": "deg", "min_clearance": "m", "duration": "s",
    "max_curvature_rate": "1/m^2", "margin": "m", "cpu": "ms",
}  # fmt: skip
_PRINTED = (
    "scenario", "path", "smoother", "status", "length", "cusps", "max_curvature", "max_curvature_rate", "worst_joint",
    "min_clearance", "margin", "duration", "cpu",
)  # fmt: skip


def figures_of(scenario: Scenario, kind: str, path: Path, duration: float | None = None) -> PathFigures:
    """Compute the figures of a path.

    Args:
        scenario: The scenario that the path must solve.
        kind: `raw` or `smoothed`.
        path: The path.
        duration: Duration of the motion [s]; None: computed by the time parameterizer of the scenario.
    """
    problem = scenario.problem
    certificate = certify_path(path, problem)
    tightest = tightest_place(path, problem, certificate.start_relief)
    return PathFigures(
        scenario=scenario.source.stem,
        path=kind,
        status="certified" if certificate.certified else "not certified",
        length=path.driven,
        max_curvature=certificate.max_curvature,
        worst_joint=math.degrees(worst_joint_angle(path)),
        min_clearance=certificate.min_clearance,
        duration=_duration(path, scenario) if duration is None else duration,
        cusps=len(path.cusps),
        max_curvature_rate=certificate.max_curvature_rate,
        margin=None if tightest is None else tightest.margin,
        reason="; ".join(_worst_of(certificate)),
    )


def _worst_of(certificate: Certificate) -> list[str]:
    """Return the message of the largest violation of every violated rule."""
    worst: dict[str, Violation] = {}
    for one in certificate.violations:
        if one.kind not in worst or one.amount > worst[one.kind].amount:
            worst[one.kind] = one
    return [one.message for one in worst.values()]


def planned_figures(scenario: Scenario, found: DockPlan | OptdockError) -> PathFigures:
    """Compute the figures of the path of a plan, or of the path on which planning failed, if there is one.

    Args:
        scenario: The scenario.
        found: The plan, or the error of planning.
    """
    if isinstance(found, OptdockError):
        left = PartialPlan.left_by(found)
        figures, spent = _refused(scenario, left.path, found), left.timing_ms
    else:
        figures = figures_of(scenario, "smoothed", found.path, found.trajectory.duration)
        spent = dict(found.timing_ms)
    return figures._replace(smoother=scenario.smoother.name, cpu=spent.get("total"))


def _refused(scenario: Scenario, path: Path | None, error: OptdockError) -> PathFigures:
    """Return the figures of an unfinished path, if there is one, with the error as status and reason."""
    found = (
        PathFigures(scenario.source.stem, "smoothed", "") if path is None else figures_of(scenario, "smoothed", path)
    )
    return found._replace(status=type(error).__name__, reason=" ".join(str(error).split()))


def smoothed_figures(scenario: Scenario, raw: Path, choice: PluginChoice) -> PathFigures:
    """Smooth a raw path by one smoother, within the time budget of the scenario, and compute the figures of the result.

    The result does not need to be certified. If the smoother raises an error with an unfinished path, the figures are
    those of the unfinished path.

    Args:
        scenario: The scenario that the path must solve.
        raw: The path before smoothing.
        choice: The smoother.

    Raises:
        PluginError: If the plugin is unknown or cannot be created.
        InvalidValue: If a parameter is wrong.
    """
    smoother, problem = plugin_from(Smoother, choice, "smoother"), scenario.problem
    began = time.process_time()
    try:
        with AtWork(smoother, problem, Cancellation(never_cancelled)):
            result = smoother.smooth(raw, scenario.time_budget, problem=problem)
        path = plain(returned(result, SmoothingResult, smoother).path, smoother, problem.frame)
        cpu = 1e3 * (time.process_time() - began)
        found = figures_of(scenario, "smoothed", path)
    except OptdockError as error:
        cpu = 1e3 * (time.process_time() - began)
        found = _refused(scenario, PartialPlan.left_by(error).path, error)
    return found._replace(smoother=choice.name, cpu=cpu)


def raw_path_of(plan: DockPlan) -> Path:
    """Return the cheapest guess of a planner that became a plan; guesses that were derived from plans do not count."""
    made = [one for one in plan.tried if one.guess is not None and not one.reason and one.stage != FEWER_CUSPS]
    best = min(made, key=lambda one: one.price, default=None)
    return plan.raw_path if best is None or best.guess is None else best.guess


def _duration(path: Path, scenario: Scenario) -> float | None:
    """Return the duration [s], or None if the limits allow no motion along the path, for example at a corner."""
    problem = scenario.problem
    speed, acceleration = problem.start_state(int(path.segments[0].direction))
    wait = problem.start_wait(path)
    try:
        return timed_by(
            scenario.timing, path, problem, start_speed=speed, start_acceleration=acceleration, start_wait=wait
        ).duration
    except FailedToTimePath:
        return None


def worst_joint_angle(path: Path) -> float:
    """Return the largest jump of the direction of motion along the path [rad]; reversals at cusps are ignored.

    In a polyline, the direction jumps between two steps, and between the heading of the first or last pose and the
    adjacent step.
    """
    ends = [(a.poses_at(a.length)[0, 2], b.poses_at(0.0)[0, 2]) for a, b in itertools.pairwise(path.segments)]
    return max(*map(_jump_inside, path.segments), *(abs(normalize_angle(b - a)) for a, b in ends), 0.0)


def _jump_inside(segment: Segment) -> float:
    if not isinstance(segment, PolylineSegment):
        return 0.0
    step = np.diff(segment.poses[:, :2], axis=0) * int(segment.direction)
    moving = np.hypot(step[:, 0], step[:, 1]) > 1e-9
    course = np.arctan2(step[moving, 1], step[moving, 0])
    headings = np.concatenate((segment.poses[:1, 2], course, segment.poses[-1:, 2]))
    return float(np.max(np.abs(wrap_angles(np.diff(headings))), initial=0.0))


def comparison_table(figures: Sequence[PathFigures]) -> str:
    """Return the figures as an aligned table, without the reasons."""
    heads = (f"{name} {_UNITS.get(name, '')}".strip().replace("_", " ") for name in _PRINTED)
    rows = (tuple(_cell(getattr(row, name), 4, "-") for name in _PRINTED) for row in figures)
    return table([tuple(heads), *rows])


def comparison_csv(figures: Sequence[PathFigures]) -> str:
    """Return the figures as CSV; the cells of missing figures are empty."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    units = {name: f"_{unit.replace('1/', '1p').replace('^', '')}" for name, unit in _UNITS.items()}
    writer.writerow(f"{name}{units.get(name, '')}" for name in PathFigures._fields)
    writer.writerows([_cell(value, 9, "") for value in row] for row in figures)
    return buffer.getvalue()


def _cell(value: str | float | None, digits: int, missing: str) -> str:
    if value is None or value == "":
        return missing
    return value if isinstance(value, str) else f"{value:.{digits}g}"
