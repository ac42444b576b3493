"""The rules of a path other than clearance: frame, ends, joints, gears, curvature, final straight."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from optdock.dock import DockDirection
from optdock.geometry.pose import Pose2, normalize_angle
from optdock.path import Direction, PolylineSegment, may_be_one_frame
from optdock.verification.certificate import Violation

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from optdock.geometry.arrays import FloatArray
    from optdock.path import Path, Segment
    from optdock.problem import DockingProblem

__all__ = ["max_curvature", "max_curvature_rate", "path_violations"]

POSE_TOLERANCE = 1e-6  # [m], [rad]: start, goal and joints
EXACT_RTOL = 1e-6  # curvature bounds on clothoid splines
SAMPLED_RTOL = 1e-3  # curvature bounds on polylines, whose curvature is a difference quotient
SLIP_TOLERANCE = 0.01  # [rad] between heading and motion of a polyline step
BULGE_TOLERANCE = 0.005  # [m] between the straight motion of a polyline step and the arc that wheels would drive
STRAIGHT_TOLERANCE = 1e-4  # [m], [rad]: a polyline's final straight


def path_violations(path: Path, problem: DockingProblem) -> tuple[Violation, ...]:
    """Every broken rule but clearance, in driving order of the rules below."""
    rules = (_frame, _ends, _joints, _gears, _slip, _curvature, _curvature_rate, _start_curvature, _final_straight)
    return tuple(violation for rule in rules for violation in rule(path, problem))


def _frame(path: Path, problem: DockingProblem) -> Iterator[Violation]:
    """Numbers of one frame say nothing about obstacles in another; a path that names no frame is taken at its word."""
    if not may_be_one_frame(path.frame, problem.frame):
        message = f"the path stands in frame {path.frame!r}, the problem in {problem.frame!r}; transform one of them"
        yield Violation("frame", message, 0.0, 1.0, {"path": path.frame, "problem": problem.frame})


def _ends(path: Path, problem: DockingProblem) -> Iterator[Violation]:
    for kind, found, wanted, s in (
        ("start", path.start, problem.start, 0.0),
        ("goal", path.end, problem.goal, path.length),
    ):
        error = found.gap_to(wanted)
        if not error <= POSE_TOLERANCE:
            away = found.distance_to(wanted)
            turned = normalize_angle(found.yaw - wanted.yaw)
            message = f"the path misses the {kind} pose by {away:.3g} m and {turned:.3g} rad"
            yield Violation(kind, message, s, error, {"pose": found.as_array().tolist()})


def _joints(path: Path, problem: DockingProblem) -> Iterator[Violation]:  # noqa: ARG001 - one shape for all rules
    for i, s in enumerate(path.cusps):
        before, after = path.segments[i], path.segments[i + 1]
        end = Pose2.from_sequence(before.poses_at(before.length)[0])
        gap = end.gap_to(Pose2.from_sequence(_first_pose(after)))
        if not gap <= POSE_TOLERANCE:
            yield Violation("joint", f"the path jumps by {gap:.3g} at the cusp s = {s:.3f} m", s, gap)


def _first_pose(segment: Segment) -> FloatArray:
    first: FloatArray = segment.poses[0] if isinstance(segment, PolylineSegment) else segment.poses_at(0.0)[0]
    return first


def _gears(path: Path, problem: DockingProblem) -> Iterator[Violation]:
    moving = _moving_segments(path)
    last, wanted = moving[-1].direction, problem.dock.direction
    required = {DockDirection.FORWARD: Direction.FORWARD, DockDirection.BACKWARD: Direction.REVERSE}.get(wanted, last)
    if last is not required:
        message = f"the path enters the dock in {last.name.lower()} gear, the dock asks for {wanted.value}"
        yield Violation("direction", message, path.length, 1.0)
    first = moving[0].direction
    if problem.start_speed * first < 0.0:
        message = f"the robot moves at {problem.start_speed:.3g} m/s but the path begins in {first.name.lower()} gear"
        yield Violation("direction", message, 0.0, abs(problem.start_speed))


def _moving_segments(path: Path) -> Sequence[Segment]:
    """The gears that lead anywhere; a motion within the tolerance of a pose has no direction."""
    return [segment for segment in path.segments if segment.length > POSE_TOLERANCE] or path.segments


def _slip(path: Path, problem: DockingProblem) -> Iterator[Violation]:  # noqa: ARG001 - one shape for all rules
    """A wheeled robot moves along its heading; a clothoid does so by construction."""
    for segment, start in zip(path.segments, path.segment_starts[:-1], strict=True):
        if not isinstance(segment, PolylineSegment):
            continue
        step = np.diff(segment.poses, axis=0)
        heading = segment.poses[:-1, 2] + 0.5 * step[:, 2]
        if segment.direction is Direction.REVERSE:
            heading = heading + np.pi
        error = np.abs(np.remainder(np.arctan2(step[:, 1], step[:, 0]) - heading + np.pi, 2.0 * np.pi) - np.pi)
        error = np.where(np.diff(segment.knots) > 0.0, error, 0.0)
        k = int(np.argmax(error))
        if not error[k] <= SLIP_TOLERANCE:
            s = float(start + segment.knots[k])
            message = f"the path slips sideways: motion and heading differ by {error[k]:.3g} rad at s = {s:.3f} m"
            yield Violation("slip", message, s, float(error[k]))
        # Position moves with acceleration arc * turn along the arc, in units of the step, and with none straight on.
        bulge = np.diff(segment.knots) * np.abs(step[:, 2]) / 8.0
        k = int(np.argmax(bulge))
        if not bulge[k] <= BULGE_TOLERANCE:
            s = float(start + segment.knots[k])
            message = (
                f"the step at s = {s:.3f} m is too long to tell its motion: arc and chord are {bulge[k]:.3g} m apart"
            )
            yield Violation("slip", message, s, float(bulge[k]))


def _curvature_samples(segment: Segment) -> tuple[FloatArray, FloatArray]:
    """Arc lengths and curvatures among which the segment's extreme curvature is."""
    if isinstance(segment, PolylineSegment):
        return segment.knots[:-1], segment.step_curvature
    return segment.knots, segment.curvature_at(segment.knots)


def _rate_samples(segment: Segment) -> tuple[FloatArray, FloatArray]:
    """Arc lengths and curvature rates among which the segment's extreme rate is."""
    if isinstance(segment, PolylineSegment):
        arc, curvature = np.diff(segment.knots), segment.step_curvature
        between = 0.5 * (arc[:-1] + arc[1:])
        with np.errstate(divide="ignore", invalid="ignore"):
            rate = np.where(np.diff(curvature) == 0.0, 0.0, np.diff(curvature) / between)
        return segment.knots[1:-1], np.where(np.isnan(rate), np.inf, rate)
    # The rate is constant between knots, and takes its right-hand value at one.
    return segment.knots[:-1], segment.curvature_rate_at(segment.knots[:-1])


def max_curvature(path: Path) -> float:
    """Largest |curvature| of the path [1/m]; infinite where it turns in place."""
    return max(float(np.max(np.abs(_curvature_samples(segment)[1]))) for segment in path.segments)


def max_curvature_rate(path: Path) -> float:
    """Largest |d curvature / ds| within a gear [1/m^2]; a polyline's is a difference quotient."""
    return max(float(np.max(np.abs(_rate_samples(segment)[1]), initial=0.0)) for segment in path.segments)


def _tolerance(segment: Segment) -> float:
    return SAMPLED_RTOL if isinstance(segment, PolylineSegment) else EXACT_RTOL


def _curvature(path: Path, problem: DockingProblem) -> Iterator[Violation]:
    limit = problem.robot.limits.max_curvature
    for segment, start in zip(path.segments, path.segment_starts[:-1], strict=True):
        s, curvature = _curvature_samples(segment)
        k = int(np.argmax(np.abs(curvature)))
        if not abs(curvature[k]) <= limit * (1.0 + _tolerance(segment)):
            at, found = float(start + s[k]), float(curvature[k])
            message = f"curvature {found:.4g} 1/m at s = {at:.3f} m exceeds {limit:.4g} 1/m"
            yield Violation("curvature", message, at, abs(found) - limit)


def _curvature_rate(path: Path, problem: DockingProblem) -> Iterator[Violation]:
    limit = problem.robot.limits.max_curvature_rate
    for segment, start in zip(path.segments, path.segment_starts[:-1], strict=True):
        s, rate = _rate_samples(segment)
        if rate.size == 0:
            continue
        k = int(np.argmax(np.abs(rate)))
        if not abs(rate[k]) <= limit * (1.0 + _tolerance(segment)):
            at, found = float(start + s[k]), float(rate[k])
            message = f"curvature rate {found:.4g} 1/m^2 at s = {at:.3f} m exceeds {limit:.4g} 1/m^2"
            yield Violation("curvature_rate", message, at, abs(found) - limit)


def _start_curvature(path: Path, problem: DockingProblem) -> Iterator[Violation]:
    wanted = problem.start_curvature
    if wanted is None:
        return
    first = path.segments[0]
    found = float(first.curvature_at(0.0)[0])
    allowed = 1e-6
    if isinstance(first, PolylineSegment):
        # The first step's curvature is its mean over the step; at the start it differs by at most rate * step.
        limit = problem.robot.limits.max_curvature_rate
        allowed = float(np.diff(first.knots)[0]) * (limit if np.isfinite(limit) else 10.0)
    if not abs(found - wanted) <= allowed:
        message = f"the path begins with curvature {found:.4g} 1/m, the robot steers {wanted:.4g} 1/m"
        yield Violation("start_curvature", message, 0.0, abs(found - wanted))


def _final_straight(path: Path, problem: DockingProblem) -> Iterator[Violation]:
    wanted, last = problem.dock.final_straight, path.segments[-1]
    if wanted <= 0.0:
        return
    if last.length < wanted - POSE_TOLERANCE:
        message = f"the last gear is {last.length:.3f} m long, the final straight needs {wanted:.3f} m"
        yield Violation("final_straight", message, path.length, wanted - last.length)
        return
    # A nanometre in, so that rounding of the knot where the straight begins does not count as a curve.
    begin = max(0.0, last.length - wanted) + 1e-9
    inside = last.knots > begin
    if isinstance(last, PolylineSegment):
        # The poses themselves: where the robot turns in place, arc length cannot tell them apart.
        poses = np.concatenate((last.poses_at(begin), last.poses[inside]))
        error, allowed = _straight_error(poses, problem.goal), STRAIGHT_TOLERANCE
    else:
        s = np.concatenate(([begin], last.knots[inside]))
        error, allowed = np.abs(last.curvature_at(s)), POSE_TOLERANCE
    worst = float(np.max(error))
    if not worst <= allowed:
        at = path.length - wanted
        message = f"the last {wanted:.3f} m of the path are not straight: off by {worst:.3g}"
        yield Violation("final_straight", message, at, worst)


def _straight_error(poses: FloatArray, goal: Pose2) -> FloatArray:
    """Larger of cross-track and heading error to the goal axis, Shape (n,) [m or rad]."""
    dx, dy = poses[:, 0] - goal.x, poses[:, 1] - goal.y
    cross = np.abs(dy * np.cos(goal.yaw) - dx * np.sin(goal.yaw))
    turn = np.abs(np.remainder(poses[:, 2] - goal.yaw + np.pi, 2.0 * np.pi) - np.pi)
    error: FloatArray = np.maximum(cross, turn)
    return error
