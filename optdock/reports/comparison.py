"""Raw paths against smoothed ones, in figures."""

from __future__ import annotations

import csv
import io
import itertools
import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.errors import FailedToTimePath
from optdock.geometry.pose import normalize_angle, wrap_angles
from optdock.model.path import ClothoidSegment, TurnSegment
from optdock.plugins.registry import timed_by
from optdock.reports.report import table
from optdock.verification import certify_path

if TYPE_CHECKING:
    from collections.abc import Sequence

    from optdock.config import Scenario
    from optdock.model.path import Path, Segment
    from optdock.model.problem import DockingProblem
    from optdock.plugins.registry import PluginChoice

__all__ = ["PathFigures", "comparison_csv", "comparison_table", "figures_of", "worst_joint_angle"]


class PathFigures(NamedTuple):
    """One path in figures; None where there is no such figure.

    Args:
        scenario: Name of the scenario.
        path: `raw` or `smoothed`.
        status: `certified`, `not certified`, or the name of the error.
        length: [m].
        max_curvature: Largest |curvature| [1/m].
        worst_joint: Largest jump of the direction of motion [deg].
        min_clearance: Smallest distance of the footprint to an obstacle on the way [m].
        duration: Time it takes under the motion limits [s].
    """

    scenario: str
    path: str
    status: str
    length: float | None = None
    max_curvature: float | None = None
    worst_joint: float | None = None
    min_clearance: float | None = None
    duration: float | None = None


_HEADS = [
    "scenario",
    "path",
    "status",
    "length_m",
    "max_curvature_1pm",
    "worst_joint_deg",
    "min_clearance_m",
    "duration_s",
]


def figures_of(scenario: Scenario, kind: str, path: Path, duration: float | None = None) -> PathFigures:
    """Judge and measure one path.

    Args:
        scenario: What it must solve.
        kind: `raw` or `smoothed`.
        path: The path.
        duration: How long it takes [s]; None: ask the scenario's time parameterizer.
    """
    certificate = certify_path(path, scenario.problem)
    return PathFigures(
        scenario=scenario.source.stem,
        path=kind,
        status="certified" if certificate.certified else "not certified",
        length=path.driven,
        max_curvature=certificate.max_curvature,
        worst_joint=math.degrees(worst_joint_angle(path)),
        min_clearance=certificate.min_clearance,
        duration=_duration(path, scenario.problem, scenario.timing) if duration is None else duration,
    )


def _duration(path: Path, problem: DockingProblem, choice: PluginChoice) -> float | None:
    """None where the limits allow no motion along the path, as at a corner."""
    try:
        speed, acceleration = problem.start_state(int(path.segments[0].direction))
        wait = problem.start_wait(path)
        return timed_by(
            choice, path, problem, start_speed=speed, start_acceleration=acceleration, start_wait=wait
        ).duration
    except FailedToTimePath:
        return None


def worst_joint_angle(path: Path) -> float:
    """Largest jump of the direction of motion at a point of the path [rad]; the reversal at a cusp is none.

    A clothoid spline has no jump inside. A polyline jumps at every pose: between two steps, and between the heading
    of its first or last pose and the step beside it.
    """
    inside = [_jump_inside(segment) for segment in path.segments]
    cusps = [_turn(a.poses_at(a.length)[0, 2], b.poses_at(0.0)[0, 2]) for a, b in itertools.pairwise(path.segments)]
    return max(*inside, *cusps, 0.0)


def _turn(first: float, second: float) -> float:
    return abs(normalize_angle(second - first))


def _jump_inside(segment: Segment) -> float:
    if isinstance(segment, ClothoidSegment | TurnSegment):
        return 0.0
    poses = segment.poses_at(segment.knots)
    step = np.diff(poses[:, :2], axis=0) * int(segment.direction)
    moving = np.hypot(step[:, 0], step[:, 1]) > 1e-9
    course = np.arctan2(step[moving, 1], step[moving, 0])
    headings = np.concatenate((poses[:1, 2], course, poses[-1:, 2]))
    jumps = np.abs(wrap_angles(np.diff(headings)))
    return float(np.max(jumps, initial=0.0))


def comparison_table(figures: Sequence[PathFigures]) -> str:
    """The figures as aligned text."""
    heads = ("scenario", "path", "status", "length m", "max curvature 1/m", "worst joint deg", "min clearance m")
    return table([(*heads, "duration s"), *(_cells(row, digits=4, nothing="-") for row in figures)])


def comparison_csv(figures: Sequence[PathFigures]) -> str:
    """The figures as CSV, empty where there is none."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(_HEADS)
    writer.writerows(_cells(row, digits=9, nothing="") for row in figures)
    return buffer.getvalue()


def _cells(row: PathFigures, *, digits: int, nothing: str) -> tuple[str, ...]:
    return tuple(_cell(value, digits, nothing) for value in row)


def _cell(value: str | float | None, digits: int, nothing: str) -> str:
    if value is None:
        return nothing
    return value if isinstance(value, str) else f"{value:.{digits}g}"
