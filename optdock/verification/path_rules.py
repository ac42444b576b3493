"""The rules for a path other than clearance: frame, ends, joints, gears, curvature, final straight."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.pose import Pose2, normalize_angle, wrap_angles
from optdock.model.dock import DockDirection
from optdock.model.limits import LIMITS, LimitKind, finite_limits
from optdock.model.path import Direction, PolylineSegment, TurnSegment, may_be_one_frame
from optdock.model.segments import SAME_YAW, first_pose
from optdock.verification.certificate import TOLERANCE, Violation

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from optdock.geometry.arrays import FloatArray
    from optdock.model.path import Path, Segment
    from optdock.model.problem import DockingProblem

__all__ = ["max_curvature", "max_curvature_rate", "path_violations"]

EXACT_RTOL = TOLERANCE  # curvature limits on clothoid splines
SAMPLED_RTOL = 1e-3  # curvature limits on polylines, whose curvature is a difference quotient
SLIP_TOLERANCE = 0.01  # [rad] between heading and motion of a polyline step
BULGE_TOLERANCE = 0.005  # [m] between the straight motion of a polyline step and the arc that wheels drive
DRIFT_TOLERANCE, DRIFT_PER_METRE = 1e-3, 1e-4  # [m], [m/m] of lateral slip; yaws rounded to 1e-4 rad drift as much
LONGEST_STEP = 0.2  # [m], longest step for which one step of full slip is allowed in addition
ROUNDING = TOLERANCE  # [m], [rad] of sampled poses: coordinates in files
_ROUNDED = 1e-9  # [m]: knots are known that well
STRAIGHT_TOLERANCE = 1e-4  # [m], [rad]: final straight of a polyline
_LIMITED = ("max_curvature", "max_curvature_rate", "max_steering_angle")  # the angle is included in max_curvature


def path_violations(path: Path, problem: DockingProblem) -> tuple[Violation, ...]:
    """Return every violation of a rule other than clearance, in the order of the rules below."""
    rules = _RULES if any(isinstance(one, PolylineSegment) for one in path.segments) else _WITHOUT_POLYLINES
    return tuple([violation for rule in rules for violation in rule(path, problem)])


def _without_rule(path: Path, problem: DockingProblem) -> Iterator[Violation]:  # noqa: ARG001 - common signature
    """Yield the finite limits without a rule; the trajectory certificate covers limits of the time law."""
    for name, value in finite_limits(problem.robot.limits).items():
        of_motion = name in LIMITS and LIMITS[name].kind is not LimitKind.PATH
        if not (of_motion or name in _LIMITED):
            yield Violation("unproven", f"no rule proves {name} = {value:.4g}", 0.0, np.inf)


def _frame(path: Path, problem: DockingProblem) -> Iterator[Violation]:
    """Check that the path and the problem have the same frame; a path without a frame name is accepted."""
    if not may_be_one_frame(path.frame, problem.frame):
        message = f"the path is in frame {path.frame!r}, the problem in {problem.frame!r}; transform one of them"
        yield Violation("frame", message, 0.0, 1.0, {"path": path.frame, "problem": problem.frame})


def _ends(path: Path, problem: DockingProblem) -> Iterator[Violation]:
    for kind, found, wanted, s in (
        ("start", path.start, problem.start, 0.0),
        ("goal", path.end, problem.goal, path.length),
    ):
        error = found.gap_to(wanted)
        if not error <= TOLERANCE:
            away = found.distance_to(wanted)
            turned = normalize_angle(found.yaw - wanted.yaw)
            message = f"the path misses the {kind} pose by {away:.3g} m and {turned:.3g} rad"
            yield Violation(kind, message, s, error, {"pose": found.as_array().tolist()})


def _joints(path: Path, problem: DockingProblem) -> Iterator[Violation]:  # noqa: ARG001 - common signature
    """Check that the sum of all jumps is within the tolerance; many small jumps are equivalent to a large jump."""
    total = 0.0
    for i, s in enumerate(path.cusps):
        before, after = path.segments[i], path.segments[i + 1]
        end = Pose2.from_sequence(before.poses_at(before.length)[0])
        gap = end.gap_to(first_pose(after))
        total += gap
        if not total <= TOLERANCE:
            in_all = "" if total == gap else f", {total:.3g} in total up to here"
            yield Violation("joint", f"the path jumps by {gap:.3g} at the cusp s = {s:.3f} m{in_all}", s, total)
            return


def _gears(path: Path, problem: DockingProblem) -> Iterator[Violation]:
    last, wanted = _first_moving(path.segments[::-1]).direction, problem.dock.direction
    required = {DockDirection.FORWARD: Direction.FORWARD, DockDirection.BACKWARD: Direction.REVERSE}.get(wanted, last)
    if last is not required and last is not Direction.IN_PLACE:  # a path of turns only has no gear
        message = f"the path enters the dock in {last.name.lower()} gear, the dock requires {wanted.value}"
        yield Violation("direction", message, path.length, 1.0)
    first = _first_moving(path.segments).direction
    if problem.start_speed * first < 0.0:
        message = f"the robot moves at {problem.start_speed:.3g} m/s but the path begins in {first.name.lower()} gear"
        yield Violation("direction", message, 0.0, abs(problem.start_speed))


def _first_moving(segments: Sequence[Segment]) -> Segment:
    """Return the segment in which the driven distance exceeds the tolerance; shorter motions have no direction."""
    driven = 0.0
    gears = [segment for segment in segments if not isinstance(segment, TurnSegment)]
    for segment in gears:
        driven += segment.length
        if driven > TOLERANCE:
            return segment
    return gears[0] if gears else segments[0]


def _turns(path: Path, problem: DockingProblem) -> Iterator[Violation]:
    """Check that turns in place of any size occur only at rest and only for a robot with `turns_in_place`."""
    for segment, start in zip(path.segments, path.segment_starts[:-1], strict=True):
        if isinstance(segment, TurnSegment) and not problem.robot.turns_in_place:
            message = f"the path turns in place by {segment.turn:.4g} rad at s = {start:.3f} m, but the robot cannot"
            yield Violation("turn", message, float(start), abs(segment.turn))
    speed, gained = problem.start_speed, problem.start_acceleration
    if isinstance(path.segments[0], TurnSegment) and (speed != 0.0 or gained != 0.0):
        moves = f"moves at {speed:.3g} m/s" if speed != 0.0 else f"accelerates at {gained:.3g} m/s^2"
        message = f"the robot {moves} but the path begins with a turn in place"
        yield Violation("turn", message, 0.0, max(abs(speed), abs(gained)))


class _Steps(NamedTuple):
    """Steps of a polyline segment, Shape (n,) each.

    `s`: arc length of the path at the beginning [m]; `chord`, `arc` [m]; `turn` [rad]; `motion`: direction of motion
    [rad]; `slip`: angle from the middle heading along the travel to the direction of motion, within +-pi [rad].
    """

    s: FloatArray
    chord: FloatArray
    arc: FloatArray
    turn: FloatArray
    motion: FloatArray
    slip: FloatArray

    def moving(self) -> _Steps:
        """Return the steps with an arc length > 0."""
        return _Steps(*(column[self.arc > 0.0] for column in self))


def _steps(segment: PolylineSegment, start: float) -> _Steps:
    step = np.diff(segment.poses, axis=0)
    heading = segment.poses[:-1, 2] + 0.5 * step[:, 2] + (np.pi if segment.direction is Direction.REVERSE else 0.0)
    motion = np.arctan2(step[:, 1], step[:, 0])
    slip = wrap_angles(motion - heading)
    chord = np.hypot(step[:, 0], step[:, 1])
    return _Steps(start + segment.knots[:-1], chord, np.diff(segment.knots), step[:, 2], motion, slip)


def _polylines(path: Path) -> Iterator[tuple[PolylineSegment, _Steps]]:
    for segment, start in zip(path.segments, path.segment_starts[:-1], strict=True):
        if isinstance(segment, PolylineSegment):
            yield segment, _steps(segment, float(start))


def _slip(path: Path, problem: DockingProblem) -> Iterator[Violation]:  # noqa: ARG001 - common signature
    """Check that the robot moves along its heading; clothoids satisfy this by construction."""
    for _, steps in _polylines(path):
        error = np.where(steps.arc > 0.0, np.abs(steps.slip), 0.0)
        k = int(np.argmax(error))
        if not error[k] <= SLIP_TOLERANCE:
            s = float(steps.s[k])
            message = f"the path slips sideways: motion and heading differ by {error[k]:.3g} rad at s = {s:.3f} m"
            yield Violation("slip", message, s, float(error[k]))
        # In units of the step the acceleration is arc * turn along the arc and zero along the chord.
        bulge = steps.arc * np.abs(steps.turn) / 8.0
        k = int(np.argmax(bulge))
        if not bulge[k] <= BULGE_TOLERANCE:
            s = float(steps.s[k])
            message = f"the step at s = {s:.3f} m is too long: its arc and its chord are {bulge[k]:.3g} m apart"
            yield Violation("slip", message, s, float(bulge[k]))


def _drift(path: Path, problem: DockingProblem) -> Iterator[Violation]:  # noqa: ARG001 - common signature
    """Check that lateral slip does not add up over any stretch of the path.

    The slip is summed to the left of the body, and in the world along x and y, because a turn between two slips may
    give opposite sides of the body the same direction in the world. The allowance grows with the length of the stretch,
    not of the path. A step of length h on a smooth curve moves laterally by h^2 / 12 times its change of curvature;
    this effect of sampling is subtracted.
    """
    sideways = [np.zeros((1, 3))]
    driven, places = [np.zeros(1)], [np.zeros(1)]
    for segment, steps in _polylines(path):
        moving = steps.moving()
        found = moving.chord * np.sin(moving.slip) + moving.arc**2 / 12.0 * _curvature_changes(moving)
        heading = moving.motion - moving.slip
        parts = (float(segment.direction), -np.sin(heading), np.cos(heading))
        sideways.append(np.column_stack([part * found for part in parts]))
        driven.append(moving.arc)
        places.append(moving.s)
    total = np.cumsum(np.concatenate(sideways), axis=0)
    spared = np.hstack((total, -total)) - DRIFT_PER_METRE * np.cumsum(np.concatenate(driven))[:, None]
    drift = np.max(spared - np.minimum.accumulate(spared, axis=0), axis=1)
    longest = max(float(np.max(steps.arc)) for _, steps in _polylines(path))
    one_step = SLIP_TOLERANCE * min(longest, LONGEST_STEP)  # slip of a step across a kink of the curvature
    allowed = DRIFT_TOLERANCE + one_step
    k = int(np.argmax(drift))
    if not drift[k] <= allowed:
        s = float(np.concatenate(places)[k])
        message = (
            f"the path drifts sideways by {drift[k]:.3g} m up to s = {s:.3f} m; allowed are {allowed:.3g} m "
            f"in addition to {DRIFT_PER_METRE:g} m per metre"
        )
        yield Violation("slip", message, s, float(drift[k] - allowed))


def _curvature_changes(steps: _Steps) -> FloatArray:
    """Return the change of curvature over each step of a sampled curve, from the adjacent steps. Shape (n,) [1/m]."""
    if steps.arc.size < 2:
        return np.zeros(steps.arc.size)
    curvature = steps.turn / steps.arc
    inner = 0.5 * (curvature[:-1] + curvature[1:])
    ends = 2.0 * curvature[[0, -1]] - inner[[0, -1]]
    changes: FloatArray = np.diff(np.concatenate((ends[:1], inner, ends[1:])))
    return changes


def _creep(path: Path, problem: DockingProblem) -> Iterator[Violation]:  # noqa: ARG001 - common signature
    """Check that steps too short to have a direction, and turns below the tolerance, do not add up to a motion."""
    moved = turned = 0.0
    for _, steps in _polylines(path):
        still = steps.arc <= 0.0
        moved += float(np.sum(steps.chord[still]))
        turned += float(np.sum(np.abs(steps.turn[still & (np.abs(steps.turn) <= SAME_YAW)])))
    if not max(moved, turned) <= TOLERANCE:
        message = f"steps too short to have a direction add up to {moved:.3g} m and {turned:.3g} rad"
        yield Violation("slip", message, 0.0, max(moved, turned))


def _winding(path: Path, problem: DockingProblem) -> Iterator[Violation]:
    """Check that a polyline's direction of motion turns no faster than its heading is allowed to, up to rounding."""
    limit = problem.robot.limits.max_curvature
    for _, steps in _polylines(path) if np.isfinite(limit) else ():
        moving = steps.moving()
        turn = np.abs(wrap_angles(np.diff(moving.motion)))
        between = 0.5 * (moving.arc[:-1] + moving.arc[1:])
        rounding = 2.0 * ROUNDING * (1.0 / moving.chord[:-1] + 1.0 / moving.chord[1:])
        excess = turn - limit * (1.0 + SAMPLED_RTOL) * between - rounding
        k = int(np.argmax(excess)) if excess.size else -1
        if k >= 0 and not excess[k] <= 0.0:
            s, found = float(moving.s[k + 1]), float(turn[k] / between[k])
            message = f"the direction of motion turns by {found:.4g} 1/m at s = {s:.3f} m, beyond {limit:.4g} 1/m"
            yield Violation("curvature", message, s, found - limit)


def _curvature_samples(segment: Segment) -> tuple[FloatArray, FloatArray]:
    """Return arc lengths and curvatures that include the extreme curvature of the segment."""
    if isinstance(segment, PolylineSegment):
        return segment.knots[:-1], segment.step_curvature
    if isinstance(segment, TurnSegment):
        return np.zeros(0), np.zeros(0)
    return segment.knots, segment.spline.curvature


def _rate_samples(segment: Segment) -> tuple[FloatArray, FloatArray]:
    """Return arc lengths and curvature rates that include the extreme rate of the segment."""
    if isinstance(segment, PolylineSegment):
        arc, curvature = np.diff(segment.knots), segment.step_curvature
        between = 0.5 * (arc[:-1] + arc[1:])
        with np.errstate(divide="ignore", invalid="ignore"):
            rate = np.where(np.diff(curvature) == 0.0, 0.0, np.diff(curvature) / between)
        return segment.knots[1:-1], np.where(np.isnan(rate), np.inf, rate)
    if isinstance(segment, TurnSegment):
        return np.zeros(0), np.zeros(0)
    return segment.knots[:-1], segment.spline.curvature_rates


def max_curvature(path: Path) -> float:
    """Return the largest driven |curvature| [1/m]; infinite if a polyline turns in place."""
    return max([float(np.abs(_curvature_samples(segment)[1]).max(initial=0.0)) for segment in path.segments])


def max_curvature_rate(path: Path) -> float:
    """Return the largest |d curvature / ds| within a gear [1/m^2]; a difference quotient for polylines."""
    return max([float(np.abs(_rate_samples(segment)[1]).max(initial=0.0)) for segment in path.segments])


def _curvature(path: Path, problem: DockingProblem) -> Iterator[Violation]:
    return _beyond(path, "max_curvature", _curvature_samples, problem.robot.limits.max_curvature)


def _curvature_rate(path: Path, problem: DockingProblem) -> Iterator[Violation]:
    return _beyond(path, "max_curvature_rate", _rate_samples, problem.robot.limits.max_curvature_rate)


def _beyond(
    path: Path, name: str, samples: Callable[[Segment], tuple[FloatArray, FloatArray]], limit: float
) -> Iterator[Violation]:
    """Compare the extreme sample of every segment with the limit."""
    kind, unit = LIMITS[name].quantity, LIMITS[name].unit
    for segment, start in zip(path.segments, path.segment_starts[:-1], strict=True):
        s, values = samples(segment)
        k = int(np.abs(values).argmax()) if values.size else -1
        tolerance = SAMPLED_RTOL if isinstance(segment, PolylineSegment) else EXACT_RTOL
        if k >= 0 and not abs(values[k]) <= limit * (1.0 + tolerance):
            at, found = float(start + s[k]), float(values[k])
            message = f"{kind.replace('_', ' ')} {found:.4g} {unit} at s = {at:.3f} m exceeds {limit:.4g} {unit}"
            yield Violation(kind, message, at, abs(found) - limit)


def _start_curvature(path: Path, problem: DockingProblem) -> Iterator[Violation]:
    wanted, first = problem.start_curvature, path.segments[0]
    if wanted is None or isinstance(first, TurnSegment):  # a turn begins at rest, without steered wheels
        return
    found = float(first.curvature_at(0.0)[0])
    allowed = TOLERANCE
    if isinstance(first, PolylineSegment):
        # The first step's curvature is its mean over the step; at the start it differs by at most rate * step.
        limit = problem.robot.limits.max_curvature_rate
        allowed = float(np.diff(first.knots)[0]) * (limit if np.isfinite(limit) else 10.0)
    if not abs(found - wanted) <= allowed:
        message = f"the path begins with curvature {found:.4g} 1/m, start.curvature is {wanted:.4g} 1/m"
        yield Violation("start_curvature", message, 0.0, abs(found - wanted))


def _final_straight(path: Path, problem: DockingProblem) -> Iterator[Violation]:
    wanted, last = problem.dock.final_straight, path.segments[-1]
    if wanted <= 0.0:
        return
    driven = 0.0 if isinstance(last, TurnSegment) else last.length
    if driven < wanted - TOLERANCE:
        message = f"the last gear is {driven:.3f} m long, the final straight needs {wanted:.3f} m"
        yield Violation("final_straight", message, path.length, wanted - driven)
        return
    # One nanometre further, so that rounding of the knot at the beginning does not count as curvature. Within this
    # nanometre a path must not turn, however sharply it may bend.
    before = max(0.0, last.length - wanted)
    begin = before + _ROUNDED
    if isinstance(last, PolylineSegment):
        # The poses themselves, because arc length cannot distinguish the poses of a turning step.
        poses = np.concatenate((last.poses_at(begin), last.poses[last.knots > begin]))
        error, allowed = _straight_error(poses, problem.goal), STRAIGHT_TOLERANCE
    else:
        s = np.concatenate(([before, begin], last.knots[last.knots > before]))
        error, allowed = np.abs(last.curvature_at(s)) * np.where(s < begin, _ROUNDED, 1.0), TOLERANCE
    worst = float(np.max(error))
    if not worst <= allowed:
        at = path.length - wanted
        message = f"the last {wanted:.3f} m of the path are not straight: off by {worst:.3g}"
        yield Violation("final_straight", message, at, worst)


def _straight_error(poses: FloatArray, goal: Pose2) -> FloatArray:
    """Return the larger of cross-track and heading error to the goal axis, Shape (n,) [m or rad]."""
    dx, dy = poses[:, 0] - goal.x, poses[:, 1] - goal.y
    cross = np.abs(dy * np.cos(goal.yaw) - dx * np.sin(goal.yaw))
    turn = np.abs(wrap_angles(poses[:, 2] - goal.yaw))
    error: FloatArray = np.maximum(cross, turn)
    return error


_RULES = (
    *(_frame, _ends, _joints, _gears, _turns, _slip, _drift, _creep),
    *(_curvature, _winding, _curvature_rate, _start_curvature, _final_straight, _without_rule),
)
_WITHOUT_POLYLINES = tuple(rule for rule in _RULES if rule not in (_slip, _drift, _creep, _winding))
