"""Proven motions: path, time law, problem and the robot's pose, tied together by the proofs that were made of them.

Certificates are plain values, which any program can write. What the rest of the library acts on are `ProvenMotion` and
`ProvenWay`, which only the functions of this module make. Such an object holds nothing itself: what it speaks of is
looked up in the proofs that were made here. One that was built or changed by other means speaks of nothing.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple, final

import numpy as np

from optdock.deadline import never_late
from optdock.errors import CertificationFailed, InvalidValue
from optdock.geometry.checked import exactly
from optdock.geometry.obstacles import ObstacleSet, in_words
from optdock.model.path import Path
from optdock.model.problem import ClearanceRule, DockingProblem
from optdock.model.robot import TrackingTube
from optdock.model.trajectory import Trajectory
from optdock.verification.certificate import TOLERANCE, Certificate, TrajectoryCertificate, where_broken
from optdock.verification.certify import certify_motion, certify_path
from optdock.verification.conservative_advancement import Begun, prove_clearance
from optdock.verification.memo import Memo
from optdock.verification.proximity import end_clearances, pose_clearance

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.geometry.fingerprint import ProblemFingerprint
    from optdock.geometry.pose import Pose2

__all__ = [
    "ProvenMotion",
    "ProvenWay",
    "WayVerdict",
    "prove_motion",
    "prove_way",
    "proven_for",
    "proven_way",
    "unchanged_way",
]

_SPACING = 0.05  # [m] between the places of a way by which the obstacles near it are found


class _Motion(NamedTuple):
    trajectory: Trajectory
    problem: DockingProblem
    certificate: Certificate
    trajectory_certificate: TrajectoryCertificate


class _Way(NamedTuple):
    path: Path
    pose: Pose2
    problem: DockingProblem


@final
class ProvenMotion:
    """A motion that is proven for a problem: its path, its time law, and that it begins as the robot does.

    It speaks of a robot that is at `pose` when the time law begins, and from then on within the tracking tube of the
    problem's robot around the path. Made by `prove_motion` alone. Pickles are believed, as Python believes all pickles.

    Raises:
        InvalidValue: It is constructed, or asked for a proof that was not made here.
    """

    __slots__ = ("__weakref__",)

    def __init__(self) -> None:
        raise InvalidValue("ProvenMotion: cannot be constructed, only proven: prove_motion(trajectory, problem)")

    def __repr__(self) -> str:
        return f"<ProvenMotion {self.trajectory!r} from {self.pose.brief}>"

    def __reduce__(self) -> tuple[object, ...]:
        return _restored_motion, (*self._content,)

    @property
    def trajectory(self) -> Trajectory:
        """Path and time law."""
        return self._content.trajectory

    @property
    def problem(self) -> DockingProblem:
        """What they are proven for."""
        return self._content.problem

    @property
    def pose(self) -> Pose2:
        """Where the robot is at time 0."""
        return self._content.trajectory.path.start

    @property
    def certificate(self) -> Certificate:
        """The certificate of the path."""
        return self._content.certificate

    @property
    def trajectory_certificate(self) -> TrajectoryCertificate:
        """The certificate of the motion limits."""
        return self._content.trajectory_certificate

    @property
    def _content(self) -> _Motion:
        found = _MOTIONS.recall(self)
        if found is None:
            raise InvalidValue("ProvenMotion: no proof was made of this one")
        return found


@final
class ProvenWay:
    """The way of a robot under way, from where it is now, whose clearance is proven; it says nothing about time.

    Made by `prove_way`, `proven_way` and `unchanged_way` alone.

    Raises:
        InvalidValue: It is constructed, or asked for a proof that was not made here.
    """

    __slots__ = ("__weakref__",)

    def __init__(self) -> None:
        raise InvalidValue("ProvenWay: cannot be constructed, only proven: prove_way(path, problem)")

    def __repr__(self) -> str:
        return f"<ProvenWay {self.path.driven:.3f} m from {self.pose.brief}>"

    def __reduce__(self) -> tuple[object, ...]:
        return _restored_way, (*self._content,)

    @property
    def path(self) -> Path:
        """What is driven."""
        return self._content.path

    @property
    def pose(self) -> Pose2:
        """Where the robot is: at the start of the path, or within the tube that was proven around it."""
        return self._content.pose

    @property
    def problem(self) -> DockingProblem:
        """The world that it is proven in; its start plays no part."""
        return self._content.problem

    @property
    def _content(self) -> _Way:
        found = _WAYS.recall(self)
        if found is None:
            raise InvalidValue("ProvenWay: no proof was made of this one")
        return found


_MOTIONS: Memo[ProvenMotion, _Motion] = Memo()
_WAYS: Memo[ProvenWay, _Way] = Memo()
_PROVEN_FOR: Memo[Trajectory, ProblemFingerprint] = Memo()


def _restored_motion(*parts: object) -> ProvenMotion:
    return _kept_motion(_Motion(*parts))  # type: ignore[arg-type]  # the parts of a pickle


def _restored_way(*parts: object) -> ProvenWay:
    return _kept_way(_Way(*parts))  # type: ignore[arg-type]  # the parts of a pickle


def _kept_motion(content: _Motion) -> ProvenMotion:
    motion: ProvenMotion = object.__new__(ProvenMotion)
    _MOTIONS.keep(motion, content)
    _PROVEN_FOR.keep(content.trajectory, content.problem.fingerprint)
    return motion


def _kept_way(content: _Way) -> ProvenWay:
    way: ProvenWay = object.__new__(ProvenWay)
    _WAYS.keep(way, content)
    return way


def prove_motion(
    trajectory: Trajectory, problem: DockingProblem, *, is_late: Callable[[], bool] = never_late
) -> ProvenMotion:
    """Prove that a trajectory solves a problem: its path by `certify_path`, its time law by `certify_motion`.

    What was proven before of the same path, time law and problem is not proven again.

    Args:
        trajectory: The motion to prove, from any source.
        problem: What must hold.
        is_late: As of `certify_path` and `certify_trajectory`.

    Raises:
        CertificationFailed: A rule is broken, or its proof was cut short; the message is the first violation's.
        InvalidValue: Trajectory or problem is of another class, or of a subclass, of which a proof would not know all.
    """
    exactly(Trajectory, trajectory, "trajectory")
    exactly(DockingProblem, problem, "problem")
    path = certify_path(trajectory.path, problem, is_late=is_late)
    if not path.certified:
        raise CertificationFailed(f"the path is not certified: {path.reason}", where=where_broken(path))
    motion = certify_motion(trajectory, problem, is_late=is_late)
    if not motion.certified:
        raise CertificationFailed(f"the motion is not certified: {motion.reason}", where=where_broken(motion))
    return _kept_motion(_Motion(trajectory, problem, path, motion))


def proven_for(trajectory: Trajectory) -> ProblemFingerprint | None:
    """Digests of the problem that this very trajectory was last proven for; None where no proof was made of it."""
    return _PROVEN_FOR.recall(trajectory)


class WayVerdict(NamedTuple):
    """What `prove_way` found; it counts as true where the way is proven.

    Attributes:
        way: The way; None: it is not proven.
        reason: Why not; empty where it is.
    """

    way: ProvenWay | None
    reason: str = ""

    def __bool__(self) -> bool:
        return self.way is not None


def prove_way(
    path: Path,
    problem: DockingProblem,
    pose: Pose2 | None = None,
    *,
    at: float = 0.0,
    begun: Begun | None = None,
    start_relief: float = 0.0,
) -> WayVerdict:
    """Prove the clearance of a way that is driven from now on, for the robot where it is now.

    The rule is `problem.path_clearance`. It tapers at the problem's goal, and where the drive set off.

    A robot beside the path, by a displacement e of its outline, goes back to it. Within the tube around the path that
    is what the tube is for. Beyond it every pose that is displaced by no more than e must keep `problem.clearance`, so
    the path is proven to keep e more. The station alone is spared that where the robot would count as docked as far
    off: it ends in contact with it.

    Args:
        path: What is driven, from its start on.
        problem: The robot, the obstacles and the rule of clearance; its start plays no part.
        pose: Where the robot is; None: at the start of the path.
        at: The place of the path that `pose` belongs to, in its first gear [m].
        begun: Where the drive set off of which this is the rest; None: here, so that a robot that is too close to
            something has to leave it only.
        start_relief: Of the rule where `begun` is given, see `ClearanceRule.required_at` [m].

    Raises:
        InvalidValue: Path or problem is of another class, or of a subclass.
    """
    exactly(Path, path, "path")
    exactly(DockingProblem, problem, "problem")
    start, place, footprint = path.start, path.pose_at(at), problem.robot.footprint
    weaker = False
    if begun is None:
        begun, start_relief = Begun(start, pose_clearance(start, footprint, problem.all_obstacles)[0]), 0.0
        weaker = begun.clearance < problem.path_clearance.required
    pose = pose or start
    off = footprint.displacement(pose, place)
    width = float(problem.tube_widths(place.as_array()[None], begun.start, begun.clearance, start_relief)[0])
    if off <= width + TOLERANCE:
        blocked = _not_clear(path, problem, begun, start_relief)
        if blocked and weaker:
            blocked = _not_clear(path, problem, begun, problem.start_run)
    else:
        is_docked = problem.dock.tolerances.accept(pose, place)
        blocked = _not_clear_by(off, path, problem, begun, start_relief, spares_station=is_docked)
    return WayVerdict(None, blocked) if blocked else WayVerdict(_kept_way(_Way(path, pose, problem)))


def _not_clear(path: Path, problem: DockingProblem, begun: Begun, relief: float) -> str:
    """What of the clearance of a path is not proven; empty: all is."""
    rule = problem.path_clearance
    count = max(2, int(np.ceil(path.length / _SPACING)) + 1)
    places = path.poses_at(np.linspace(0.0, path.length, count))[:, :2]
    reach = problem.robot.footprint.circumscribed_radius + rule.required + _SPACING
    near = problem.all_obstacles.near(places, reach)
    proof = prove_clearance(path, problem, start_relief=relief, obstacles=near, begun=begun, sharp=False)
    if proof.holds:
        return ""
    if not len(proof.violations):
        return "the clearance of the way is not proven"
    s, clearance, required, row = proof.violations[np.argmin(proof.violations[:, 0]), :4].tolist()
    return f"{clearance:.4f} m from {in_words(near.name_of(int(row)))} after {s:.3f} m, required {required:.4f} m"


def _not_clear_by(
    more: float, path: Path, problem: DockingProblem, begun: Begun, relief: float, *, spares_station: bool
) -> str:
    """Likewise of `more` than `problem.clearance` [m]; of a station that is spared, what the path must keep."""
    dock, robot = problem.dock, replace(problem.robot, tracking=TrackingTube())
    raised = replace(
        problem,
        robot=robot,
        dock=replace(dock, footprint=None) if spares_station else dock,
        clearance=problem.clearance.raised(more),
    )
    kept = ClearanceRule.raised_start(more, begun.clearance, relief)
    blocked = _not_clear(path, raised, begun._replace(clearance=kept), relief)
    if blocked or not spares_station or dock.footprint is None:
        return blocked and f"{blocked} with the {more:.4f} m that the robot is off with its outline"
    alone = replace(problem, robot=robot, obstacles=ObstacleSet.empty(), costmap=None)
    return _not_clear(path, alone, begun, relief)


def proven_way(motion: ProvenMotion, pose: Pose2 | None = None) -> ProvenWay | None:
    """The way of a robot that is about to drive a proven motion; None where the tube around it does not cover the pose.

    Args:
        motion: What is driven, from its start on.
        pose: Where the robot is; None: at the start.
    """
    problem, start, path = motion.problem, motion.pose, motion.trajectory.path
    if pose is not None:
        relief, clearance = motion.certificate.start_relief, end_clearances(problem).start
        width = float(problem.tube_widths(start.as_array()[None], start, clearance, relief)[0])
        if not problem.robot.footprint.displacement(pose, start) <= width + TOLERANCE:
            return None
    return _kept_way(_Way(path, pose or start, problem))


def unchanged_way(motion: ProvenMotion, begin: float, end: float, problem: DockingProblem) -> ProvenWay | None:
    """A stretch of a proven path, where its proof holds in another problem too; None where that is not obvious.

    It does where nothing but the dock differs and the old dock and the new one are so far from the stretch that neither
    the taper of the clearance nor the station reaches it.

    Args:
        motion: What is being driven.
        begin: Where on its path the stretch begins [m].
        end: Where it ends [m].
        problem: The problem now.
    """
    before, path = motion.problem, motion.trajectory.path
    same = before.obstacles is problem.obstacles and before.costmap is problem.costmap
    same = same and before.robot is problem.robot and before.clearance == problem.clearance
    if not same or before.unknown_is_obstacle != problem.unknown_is_obstacle or before.frame != problem.frame:
        return None
    reach = problem.robot.footprint.circumscribed_radius + problem.path_clearance.required
    for dock in (before.dock, problem.dock):
        station = 0.0 if dock.footprint is None else dock.footprint.circumscribed_radius
        far = max(reach + station, problem.clearance.dock_run + problem.clearance.taper) + end - begin
        if path.pose_at(begin).distance_to(dock.pose) <= far:
            return None
    stretch = path.piece(begin, end)
    return _kept_way(_Way(stretch, stretch.start, problem))
