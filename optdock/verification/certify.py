"""Certification of paths and trajectories; each verdict is computed only once."""

from __future__ import annotations

import weakref
from dataclasses import dataclass, fields
from operator import attrgetter
from typing import TYPE_CHECKING, Generic, TypeVar

import numpy as np

from optdock.deadline import never_late
from optdock.geometry.checked import exactly
from optdock.geometry.obstacles import in_words
from optdock.model.limits import MotionLimits
from optdock.verification.certificate import TOLERANCE, Certificate, Memo, Subject, TrajectoryCertificate, Violation
from optdock.verification.clearance_kernel import end_clearances
from optdock.verification.conservative_advancement import prove_clearance
from optdock.verification.path_rules import max_curvature, max_curvature_rate, path_violations
from optdock.verification.trajectory_rules import trajectory_violations
from optdock.verification.visibility import prove_view

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable

    from optdock.geometry.arrays import FloatArray
    from optdock.model.constant_jerk import TimeLaw
    from optdock.model.limits import SpeedZone
    from optdock.model.path import Path
    from optdock.model.problem import DockingProblem
    from optdock.model.trajectory import Trajectory
    from optdock.verification.conservative_advancement import ClearanceProof

__all__ = ["certify_motion", "certify_path", "certify_trajectory"]

_BOUNDS = attrgetter(*(field.name for field in fields(MotionLimits)))  # all bounds of limits

Verdict = TypeVar("Verdict", Certificate, TrajectoryCertificate)


def certify_path(path: Path, problem: DockingProblem, *, is_late: Callable[[], bool] = never_late) -> Certificate:
    """Prove that `path` solves `problem`, or return the violations with their positions.

    The footprint clearance (second-order `conservative_advancement`) and, if the dock requires it, the visibility of
    the marker (`visibility`) are proven for every point of the continuous path. Start and goal pose (`TOLERANCE`),
    joints, gears, curvature, curvature rate, start curvature and final straight are checked exactly. A polyline
    represents linear motion between its poses, turning in the shorter direction, with the curvature of the arcs through
    the poses. A step whose arc is more than 5 mm away from the linear motion is rejected. Slips and jumps that are
    individually small but add up are also rejected.

    If no clearance is required, shapes in contact may overlap by a micrometre. No point of one shape is deeper than two
    micrometres inside another, regardless of the decomposition into pieces (see `contact_tolerance`).

    At the joint of two segments, even in the same gear, the curvature may jump and the robot must be at rest. A turn in
    place, allowed for robots with `turns_in_place`, is also a segment.

    For a robot that starts closer to an obstacle than required, the clearance must grow with a minimum slope. If only
    this rule is violated, the weaker rule for a robot alongside a wall applies (see `Certificate.start_relief`).

    A complete proof is cached for the lifetime of the path. An interrupted proof is reused only if it certified the
    path and the caller has a deadline. The time law is not considered: see `certify_trajectory`.

    Args:
        path: The path to certify; it may come from any source.
        problem: The problem.
        is_late: Polled after every round of the proof and between the blocks of long rounds; a round takes less than a
            millisecond for a path of a few metres among a hundred obstacles. Once it is True, everything not yet proven
            is `unproven`, and the reported clearance is a lower bound that may be far below the minimum.

    Returns:
        The certificate; `certified` is True only if everything was proven.
    """
    return _made_once(_PATHS, path, _Itself(problem), is_late, lambda checked: _path_verdict(path, problem, checked))


def _path_verdict(path: Path, problem: DockingProblem, is_late: Callable[[], bool]) -> Certificate:
    proof, relief = prove_clearance(path, problem, is_late), 0.0
    if not proof.holds and _only_near_the_start(proof, problem):
        weaker = prove_clearance(path, problem, is_late, problem.start_run)
        if weaker.holds:
            proof, relief = weaker, problem.start_run
    view = prove_view(path, problem, is_late)
    violations = (*path_violations(path, problem), *_clearance_violations(proof, problem), *view.violations)
    return Certificate(
        violations=violations,
        min_clearance=proof.proven,
        required_clearance=proof.required,
        at_s=proof.at_s,
        margin=proof.margin,
        nearest=problem.all_obstacles.name_of(proof.row) if proof.row >= 0 else "",
        max_curvature=max_curvature(path),
        max_curvature_rate=max_curvature_rate(path),
        length=path.driven,
        poses_checked=proof.poses,
        problem=problem.fingerprint,
        path=path.digest,
        start_relief=relief,
        tube=problem.robot.tracking.width(problem.robot.footprint),
        view_margin=None if problem.required_view is None else view.margin,
    )


def _only_near_the_start(proof: ClearanceProof, problem: DockingProblem) -> bool:
    """Whether the start is too close and the weaker rule permits every pose that violates the strict rule.

    If the result is False, a second proof with the weaker rule would certainly fail and is omitted.
    """
    clearance, rule = end_clearances(problem).start, problem.path_clearance
    if clearance >= rule.required:
        return False
    at = proof.violations[:, 4:6]
    from_goal, from_start = (np.hypot(*(at - [end.x, end.y]).T) for end in (problem.goal, problem.start))
    required = rule.required_at(from_goal, from_start, clearance, problem.start_run)
    return bool(np.all(proof.violations[:, 1] >= required - TOLERANCE))


def _clearance_violations(proof: ClearanceProof, problem: DockingProblem) -> tuple[Violation, ...]:
    """Return the violation at the worst pose or, if no pose violates the rule, at the worst unproven cell."""
    if len(proof.violations):
        row = proof.violations[(proof.violations[:, 1] - proof.violations[:, 2]).argmin()]
        return (_too_close(row, problem),)
    if len(proof.unproven):
        s, short = proof.unproven[proof.unproven[:, 1].argmin()]
        message = f"clearance near s = {s:.4f} m cannot be proven; the bound is {-short:.3g} m short"
        return (Violation("unproven", message, float(s), float(-short)),)
    return ()


def _too_close(row: FloatArray, problem: DockingProblem) -> Violation:
    s, clearance, required = (float(value) for value in row[:3])
    obstacle = problem.all_obstacles.name_of(int(row[3]))
    what = f"{'overlaps' if clearance < 0.0 else 'comes too close to'} {in_words(obstacle)}"
    message = f"the footprint {what} at s = {s:.3f} m: clearance {clearance:.4f} m, required {required:.4f} m"
    tube = problem.robot.tracking.width(problem.robot.footprint)
    if tube > 0.0:
        message += f", with the tube of {tube:.4f} m about the path"
    where = {"pose": row[4:].tolist(), "obstacle": obstacle, "clearance": clearance, "required": required}
    return Violation("clearance", message, s, required - clearance, where)


def certify_trajectory(  # noqa: PLR0913 - a motion, its limits and how it begins
    trajectory: Trajectory,
    limits: MotionLimits,
    zone: SpeedZone,
    *,
    start_speed: float | None = None,
    start_acceleration: float | None = None,
    start_wait: float = 0.0,
    is_late: Callable[[], bool] = never_late,
) -> TrajectoryCertificate:
    """Prove that a trajectory satisfies every motion limit, or return the violations.

    Within a step of a polyline, whose curvature is a difference quotient, limits on turning may be exceeded by 5 %. If
    wheels must be steered between two segments or at the start, the robot must be at rest meanwhile.

    A complete proof is cached for the lifetime of the time law, as in `certify_path`. Clearance and the curvature
    limits of the path are not considered: see `certify_path`.

    Args:
        trajectory: The motion to certify.
        limits: Motion limits of the drive.
        zone: Speed zone at the end of the path.
        start_speed: Required initial speed along the travel [m/s]; not checked if None.
        start_acceleration: Required initial acceleration along the travel [m/s^2]; not checked if None.
        start_wait: Required duration [s] of the rest at the start, in which the wheels are steered.
        is_late: Polled every few milliseconds. Once it is True, everything not yet proven is `unproven`.

    Returns:
        The certificate; `certified` is True only if everything was proven, including every finite limit.

    Raises:
        InvalidValue: If `limits` is not exactly a `MotionLimits`; bounds added by a subclass would not be proven.
    """
    exactly(MotionLimits, limits, "limits")
    start = (start_speed, start_acceleration, start_wait)

    def verdict(checked: Callable[[], bool]) -> TrajectoryCertificate:
        violations, ratios = trajectory_violations(trajectory, limits, zone, start, checked)
        return TrajectoryCertificate(violations, ratios, trajectory.time_law.duration, trajectory.path.digest)

    against = (_Itself(trajectory.path), _BOUNDS(limits), (zone.speed, zone.distance), start)
    return _made_once(_TIME_LAWS, trajectory.time_law, against, is_late, verdict)


def certify_motion(
    trajectory: Trajectory, problem: DockingProblem, *, is_late: Callable[[], bool] = never_late
) -> TrajectoryCertificate:
    """Prove that a trajectory satisfies the motion limits of `problem` and begins in the state of the robot.

    If `start_curvature` is None, the angle of steered wheels at the start is unknown. The robot must then be at rest
    until the wheels have been steered from the farthest angle (`DockingProblem.start_wait`); otherwise the motion
    violates the rule `rest`.

    Args:
        trajectory: The motion to certify.
        problem: Problem that defines limits, speed zone and start state.
        is_late: As for `certify_trajectory`.

    Returns:
        The certificate, see `certify_trajectory`.
    """
    limits, zone = problem.robot.limits, problem.dock.approach
    speed, acceleration = problem.start_state(int(trajectory.path.segments[0].direction))
    return certify_trajectory(
        trajectory,
        limits,
        zone,
        start_speed=speed,
        start_acceleration=acceleration,
        start_wait=problem.start_wait(trajectory.path),
        is_late=is_late,
    )


class _Itself(weakref.ref[Subject]):
    """A weak reference that equals another weak reference only if both refer to the same object."""

    __slots__ = ()
    __hash__ = weakref.ref.__hash__

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Itself) and self() is not None and self() is other()


@dataclass(frozen=True)
class _Kept(Generic[Verdict]):
    """A verdict, the inputs on which it depends, and whether the proof was completed."""

    against: Hashable
    verdict: Verdict
    is_whole: bool


_PATHS: Memo[Path, _Kept[Certificate]] = Memo()
_TIME_LAWS: Memo[TimeLaw, _Kept[TrajectoryCertificate]] = Memo()


def _made_once(
    memo: Memo[Subject, _Kept[Verdict]],
    subject: Subject,
    against: Hashable,
    is_late: Callable[[], bool],
    prove: Callable[[Callable[[], bool]], Verdict],
) -> Verdict:
    """Return the cached verdict on `subject` for equal inputs, or compute it.

    An interrupted proof that certified the subject is valid but not sharp, so it is reused only for callers with a
    deadline. An interrupted proof without a certificate is not cached.
    """
    known = memo.recall(subject)
    if known is not None and known.against == against and (known.is_whole or is_late is not never_late):
        return known.verdict
    was_late = False

    def checked() -> bool:
        nonlocal was_late
        was_late = was_late or is_late()
        return was_late

    found = prove(checked)
    if found.certified or not was_late:
        memo.keep(subject, _Kept(against, found, not was_late))
    return found
