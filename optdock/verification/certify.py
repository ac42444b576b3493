"""`certify_path` and `certify_trajectory`: the two verdicts, each made once."""

from __future__ import annotations

import weakref
from dataclasses import astuple, dataclass
from typing import TYPE_CHECKING, Generic, TypeVar

import numpy as np

from optdock.deadline import never_late
from optdock.geometry.checked import exactly
from optdock.geometry.obstacles import in_words
from optdock.model.limits import MotionLimits
from optdock.verification.certificate import TOLERANCE, Certificate, TrajectoryCertificate, Violation
from optdock.verification.conservative_advancement import prove_clearance
from optdock.verification.memo import Memo
from optdock.verification.path_rules import max_curvature, max_curvature_rate, path_violations
from optdock.verification.proximity import end_clearances
from optdock.verification.trajectory_rules import trajectory_violations
from optdock.verification.visibility import prove_view

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable

    from optdock.geometry.arrays import FloatArray
    from optdock.model.limits import SpeedZone
    from optdock.model.path import Path
    from optdock.model.problem import DockingProblem
    from optdock.model.trajectory import TimeLaw, Trajectory
    from optdock.verification.conservative_advancement import ClearanceProof

__all__ = ["certify_motion", "certify_path", "certify_trajectory"]

Subject = TypeVar("Subject")
Verdict = TypeVar("Verdict", Certificate, TrajectoryCertificate)


def certify_path(path: Path, problem: DockingProblem, *, is_late: Callable[[], bool] = never_late) -> Certificate:
    """Prove that `path` solves `problem`, or name what is broken and where.

    Proven for every point of the continuous path: footprint clearance (second-order `conservative_advancement`), and
    where the dock asks for it that its marker is in the camera's view (`visibility`, likewise).
    Checked exactly: start and goal pose (`TOLERANCE`), joints, gears, curvature, curvature rate, start curvature,
    final straight. A polyline is judged as linear motion between its poses, turning the short way, with the
    curvature of the arcs through them; a step whose arc is more than 5 mm from that motion is refused, and so are slips
    and jumps that are small one by one but add up.

    Where no clearance is required contact may overlap by a micrometre, and nothing lies deeper than two micrometres
    inside anything, however the shapes are made of pieces (see `contact_tolerance`).

    Wherever two segments meet, also two of one gear, the curvature may jump: the robot must rest there. A turn in place
    is such a segment, for robots that do so; it is swept as any other.

    A proof is kept for as long as the path lives: paths and problems are frozen, so the same two have the same verdict.
    One that was cut short serves callers with a deadline, and only where it is certified all the same.

    A robot that starts closer to something than required must leave it at a slope; where the path breaks only that, it
    is judged once more by the weaker rule of a robot along a wall, and `Certificate.start_relief` says so.

    It does NOT look at time: see `certify_trajectory`.

    Args:
        path: The path to judge, from any source.
        problem: What must hold.
        is_late: For callers with a deadline, asked after every round of the proof, each below a millisecond for a path
            of some metres among a hundred obstacles, and between the blocks of long rounds. Once it is True whatever is
            not proven yet is refused as `unproven`, and the reported clearance is a bound that may be far from sharp.

    Returns:
        The certificate; `certified` is True only if everything was proven.
    """
    return _made_once(_PATHS, path, _Itself(problem), is_late, lambda asked: _path_verdict(path, problem, asked))


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
    """Whether the robot starts too close to something and the weaker rule allows every pose that broke the strict one.

    Proofs that the weaker rule is broken as well are not made twice.
    """
    clearance, rule = end_clearances(problem).start, problem.path_clearance
    if clearance >= rule.required:
        return False
    at = proof.violations[:, 4:6]
    from_goal, from_start = (np.hypot(*(at - [end.x, end.y]).T) for end in (problem.goal, problem.start))
    required = rule.required_at(from_goal, from_start, clearance, problem.start_run)
    return bool(np.all(proof.violations[:, 1] >= required - TOLERANCE))


def _clearance_violations(proof: ClearanceProof, problem: DockingProblem) -> tuple[Violation, ...]:
    """The worst violating pose, and the worst cell given up."""
    found = []
    if len(proof.violations):
        found.append(_too_close(proof.violations[(proof.violations[:, 1] - proof.violations[:, 2]).argmin()], problem))
    elif len(proof.unproven):
        s, short = proof.unproven[proof.unproven[:, 1].argmin()]
        message = f"clearance near s = {s:.4f} m cannot be proven; the bound is {-short:.3g} m short"
        found.append(Violation("unproven", message, float(s), float(-short)))
    return tuple(found)


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
    """Prove that a trajectory keeps every motion limit, or name what is broken, when and by how much.

    Within a step of a polyline, whose curvature is a difference quotient, 5 % beyond a limit on turning are accepted.
    Where steered wheels have to be turned, between two segments or at the start, the motion must rest for as long as
    that takes.

    A proof is kept for as long as the time law lives, as those of paths are.

    It does NOT look at clearance or at the path's own curvature bounds: see `certify_path`.

    Args:
        trajectory: The motion to judge.
        limits: What the drive can do.
        zone: Slow stretch at the end of the path.
        start_speed: Speed along the travel that the motion must begin with [m/s]; None: not checked.
        start_acceleration: Likewise [m/s^2].
        start_wait: How long the wheels take to turn before the motion leaves its start [s].
        is_late: For callers with a deadline, asked every few milliseconds. Once it is True whatever is not proven yet
            is refused as `unproven`.

    Returns:
        The certificate; `certified` is True only if everything was proven, every finite limit included.

    Raises:
        InvalidValue: `limits` is of another class than `MotionLimits`; a subclass may bound more than is known here.
    """
    exactly(MotionLimits, limits, "limits")
    start = (start_speed, start_acceleration, start_wait)

    def verdict(asked: Callable[[], bool]) -> TrajectoryCertificate:
        violations, ratios = trajectory_violations(trajectory, limits, zone, start, asked)
        return TrajectoryCertificate(violations, ratios, trajectory.time_law.duration, trajectory.path.digest)

    against = (_Itself(trajectory.path), astuple(limits), astuple(zone), start)
    return _made_once(_TIME_LAWS, trajectory.time_law, against, is_late, verdict)


def certify_motion(
    trajectory: Trajectory, problem: DockingProblem, *, is_late: Callable[[], bool] = never_late
) -> TrajectoryCertificate:
    """Prove that a trajectory keeps the motion limits of `problem` and begins as the robot does.

    Steered wheels whose angle at the start is unknown (no `start_curvature`) may have to be turned from anywhere: the
    motion must rest for that first (`DockingProblem.start_wait`), or it is refused as `rest`.

    Args:
        trajectory: The motion to judge.
        problem: Its robot's limits, its dock's slow stretch and its whole start state count.
        is_late: As of `certify_trajectory`.

    Returns:
        The certificate, as of `certify_trajectory`.
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
    """A weak reference that equals another only where both are to the same thing, whatever that calls its equal."""

    __slots__ = ()
    __hash__ = weakref.ref.__hash__

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Itself) and self() is not None and self() is other()


@dataclass(frozen=True)
class _Kept(Generic[Verdict]):
    """A verdict, what it was judged against, and whether the proof was made to its end."""

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
    """The verdict that is kept, or a new one.

    A proof that was cut short may be certified all the same, only not sharp: then it serves callers that have a
    deadline themselves. One that was cut short and is not certified is forgotten.

    Args:
        memo: Where verdicts of this kind are kept.
        subject: What is judged.
        against: What it is judged against; equal where the verdict must be the same.
        is_late: The caller's deadline; `never_late` without one.
        prove: Makes the proof, asking the callable that it is given whether it is late.
    """
    known = memo.recall(subject)
    if known is not None and known.against == against and (known.is_whole or is_late is not never_late):
        return known.verdict
    was_late = False

    def asked() -> bool:
        nonlocal was_late
        was_late = was_late or is_late()
        return was_late

    found = prove(asked)
    if found.certified or not was_late:
        memo.keep(subject, _Kept(against, found, not was_late))
    return found
