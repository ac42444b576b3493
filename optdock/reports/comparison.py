"""Figures of raw and smoothed paths for `optdock compare`."""

from __future__ import annotations

import csv
import io
import itertools
import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.errors import FailedToTimePath
from optdock.geometry.pose import normalize_angle, wrap_angles
from optdock.model.path import PolylineSegment
from optdock.plugins.registry import timed_by
from optdock.reports.report import table
from optdock.verification import certify_path

if TYPE_CHECKING:
    from collections.abc import Sequence

    from optdock.config import Scenario
    from optdock.model.path import Path, Segment

__all__ = ["PathFigures", "comparison_csv", "comparison_table", "figures_of", "worst_joint_angle"]


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
    """

    scenario: str
    path: str
    status: str
    length: float | None = None
    max_curvature: float | None = None
    worst_joint: float | None = None
    min_clearance: float | None = None
    duration: float | None = None


_UNITS = {"length": "m", "max_curvature": "1/m", "worst_joint": "deg", "min_clearance": "m", "duration": "s"}


def figures_of(scenario: Scenario, kind: str, path: Path, duration: float | None = None) -> PathFigures:
    """Compute the figures of a path.

    Args:
        scenario: The scenario that the path must solve.
        kind: `raw` or `smoothed`.
        path: The path.
        duration: Duration of the motion [s]; None: computed by the time parameterizer of the scenario.
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
        duration=_duration(path, scenario) if duration is None else duration,
    )


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
    """Return the figures as an aligned table."""
    heads = (f"{name} {_UNITS.get(name, '')}".strip().replace("_", " ") for name in PathFigures._fields)
    return table([tuple(heads), *(tuple(_cell(value, 4, "-") for value in row) for row in figures)])


def comparison_csv(figures: Sequence[PathFigures]) -> str:
    """Return the figures as CSV; the cells of missing figures are empty."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    units = {name: f"_{unit.replace('1/', '1p')}" for name, unit in _UNITS.items()}
    writer.writerow(f"{name}{units.get(name, '')}" for name in PathFigures._fields)
    writer.writerows([_cell(value, 9, "") for value in row] for row in figures)
    return buffer.getvalue()


def _cell(value: str | float | None, digits: int, missing: str) -> str:
    if value is None:
        return missing
    return value if isinstance(value, str) else f"{value:.{digits}g}"
