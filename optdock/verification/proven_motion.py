"""Proven motions: path, time law, problem and pose of the robot, connected by their proofs.

Certificates are plain values that any program can create. The library acts only on `ProvenMotion` and `ProvenWay`
objects, which only the functions of this module can create. Such an object has no attributes. Its content is looked up
in the table of proofs made by this module, so forged or modified objects have no content.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar, Generic, NamedTuple, TypeVar, final

import numpy as np

from optdock.deadline import never_late
from optdock.errors import CertificationFailed, InvalidValue
from optdock.geometry.checked import exactly
from optdock.geometry.obstacles import ObstacleSet, in_words
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.path import Path
from optdock.model.problem import DockingProblem
from optdock.model.robot import TrackingTube
from optdock.model.trajectory import Trajectory
from optdock.verification.certificate import TOLERANCE, Certificate, Memo, TrajectoryCertificate, where_broken
from optdock.verification.certify import certify_motion, certify_path
from optdock.verification.clearance_kernel import compiled_clearances, end_clearances
from optdock.verification.conservative_advancement import Begun, prove_clearance

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.geometry.pose import Pose2
    from optdock.model.problem import ProblemFingerprint

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


Content = TypeVar("Content")
Kind = TypeVar("Kind", bound="_Proven[Any]")


class _Motion(NamedTuple):
    trajectory: Trajectory
    problem: DockingProblem
    certificate: Certificate
    trajectory_certificate: TrajectoryCertificate


class _Way(NamedTuple):
    path: Path
    pose: Pose2
    problem: DockingProblem


class _Proven(Generic[Content]):
    """An object without data, whose content is looked up by its identity."""

    __slots__ = ("__weakref__",)
    _proofs: ClassVar[Memo[Any, Any]]

    def __reduce__(self) -> tuple[object, ...]:
        return self._keep, (self._content,)

    def __init__(self) -> None:
        raise InvalidValue(f"{type(self).__name__}: cannot be constructed directly; use `prove_motion`")

    @classmethod
    def _keep(cls: type[Kind], content: Content) -> Kind:
        proven: Kind = object.__new__(cls)
        cls._proofs.keep(proven, content)
        return proven

    @property
    def _content(self) -> Content:
        found: Content | None = self._proofs.recall(self)
        if found is None:
            raise InvalidValue(f"{type(self).__name__}: no proof was made of this object")
        return found


@final
class ProvenMotion(_Proven[_Motion]):
    """A motion certified for a problem, with its path, its time law, and its initial state.

    It is valid for a robot at `pose` at the beginning of the time law and within the tracking tube of the problem's
    robot afterwards. Only `prove_motion` creates such objects. Pickles are trusted, because unpickling can execute
    arbitrary code anyway.

    Raises:
        InvalidValue: If it is constructed directly, or accessed without a proof.
    """

    __slots__ = ()
    _proofs: ClassVar[Memo[ProvenMotion, _Motion]] = Memo()

    def __repr__(self) -> str:
        return f"<ProvenMotion {self.trajectory!r} from {self.pose.brief}>"

    @classmethod
    def _keep(cls, content: _Motion) -> ProvenMotion:
        _PROVEN_FOR.keep(content.trajectory, content.problem.fingerprint)
        return super()._keep(content)

    @property
    def trajectory(self) -> Trajectory:
        """Path and time law."""
        return self._content.trajectory

    @property
    def problem(self) -> DockingProblem:
        """The problem for which the motion is proven."""
        return self._content.problem

    @property
    def pose(self) -> Pose2:
        """Pose of the robot at time 0."""
        return self._content.trajectory.path.start

    @property
    def certificate(self) -> Certificate:
        """The certificate of the path."""
        return self._content.certificate

    @property
    def trajectory_certificate(self) -> TrajectoryCertificate:
        """The certificate of the motion limits."""
        return self._content.trajectory_certificate


@final
class ProvenWay(_Proven[_Way]):
    """The remaining path of a moving robot with proven clearance, without a time law.

    Only `prove_way`, `proven_way` and `unchanged_way` create such objects.

    Raises:
        InvalidValue: If it is constructed directly, or accessed without a proof.
    """

    __slots__ = ()
    _proofs: ClassVar[Memo[ProvenWay, _Way]] = Memo()

    def __repr__(self) -> str:
        return f"<ProvenWay {self.path.driven:.3f} m from {self.pose.brief}>"

    @property
    def path(self) -> Path:
        """The path with proven clearance."""
        return self._content.path

    @property
    def pose(self) -> Pose2:
        """Pose of the robot: at the start of the path, or within the tube proven around it."""
        return self._content.pose

    @property
    def problem(self) -> DockingProblem:
        """The problem for which the path is proven; its start is not used."""
        return self._content.problem


_PROVEN_FOR: Memo[Trajectory, ProblemFingerprint] = Memo()


def prove_motion(
    trajectory: Trajectory, problem: DockingProblem, *, is_late: Callable[[], bool] = never_late
) -> ProvenMotion:
    """Certify a trajectory for a problem: its path by `certify_path`, and its time law by `certify_motion`.

    Earlier proofs of the same path, time law and problem are reused.

    Args:
        trajectory: The motion to certify, from any source.
        problem: The problem.
        is_late: As for `certify_path` and `certify_trajectory`.

    Raises:
        CertificationFailed: If a rule is violated or a proof was interrupted, with the message of the first violation.
        InvalidValue: If the class of `trajectory` or `problem` is not exactly the expected one.
    """
    exactly(Trajectory, trajectory, "trajectory")
    exactly(DockingProblem, problem, "problem")
    path = certify_path(trajectory.path, problem, is_late=is_late)
    if not path.certified:
        raise CertificationFailed(f"the path is not certified: {path.reason}", where=where_broken(path))
    motion = certify_motion(trajectory, problem, is_late=is_late)
    if not motion.certified:
        raise CertificationFailed(f"the motion is not certified: {motion.reason}", where=where_broken(motion))
    return ProvenMotion._keep(_Motion(trajectory, problem, path, motion))


def proven_for(trajectory: Trajectory) -> ProblemFingerprint | None:
    """Return the digests of the problem for which this trajectory object was last proven, or None."""
    return _PROVEN_FOR.recall(trajectory)


class WayVerdict(NamedTuple):
    """Result of `prove_way`; its truth value tells whether the clearance of the path is proven.

    Attributes:
        way: The way; None if it is not proven.
        reason: Reason for the failure; empty if the clearance is proven.
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
    """Prove the clearance of a path that is about to be driven, for the current pose of the robot.

    The rule is `problem.path_clearance`, which tapers at the goal and at the beginning of the drive.

    A robot next to the path, with its outline displaced by e, is controlled back to the path. If e is within the tube
    around the path, the clearance of the tube covers the displacement. Otherwise every pose displaced by at most e must
    satisfy `problem.clearance`, so the clearance of the path is proven with an additional distance e. The station is
    exempt from the additional distance if the robot counts as docked at this displacement, because the robot ends in
    contact with the station.

    Args:
        path: The path, driven from its start.
        problem: Problem with robot, obstacles and clearance rule; its start is not used.
        pose: Pose of the robot; None for the start of the path.
        at: Arc length on the path that corresponds to `pose`, in the first gear [m].
        begun: Beginning of the drive if `path` is the rest of a longer path. None means the start of `path`; a robot
            that is too close to an obstacle then only has to move away from the obstacle.
        start_relief: Start relief of the clearance rule if `begun` is given [m]; see `ClearanceRule.required_at`.

    Raises:
        InvalidValue: If the class of `path` or `problem` is not exactly the expected one.
    """
    exactly(Path, path, "path")
    exactly(DockingProblem, problem, "problem")
    start, place, footprint = path.start, path.pose_at(at), problem.robot.footprint
    weaker = False
    if begun is None:
        clearances, _ = compiled_clearances(start.as_array()[None], footprint, problem.all_obstacles)
        begun, start_relief = Begun(start, float(clearances[0])), 0.0
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
    return WayVerdict(None, blocked) if blocked else WayVerdict(ProvenWay._keep(_Way(path, pose, problem)))


def _not_clear(path: Path, problem: DockingProblem, begun: Begun, relief: float) -> str:
    """Return a message that locates the point where clearance is not proven; empty if clearance is proven."""
    proof = prove_clearance(path, problem, start_relief=relief, begun=begun, sharp=False)
    if proof.holds:
        return ""
    if not len(proof.violations):
        return "the clearance of the path is not proven"
    s, clearance, required, row = proof.violations[np.argmin(proof.violations[:, 0]), :4].tolist()
    nearest = in_words(problem.all_obstacles.name_of(int(row)))
    return f"{clearance:.4f} m from {nearest} after {s:.3f} m, required {required:.4f} m"


def _not_clear_by(
    more: float, path: Path, problem: DockingProblem, begun: Begun, relief: float, *, spares_station: bool
) -> str:
    """Apply `_not_clear` with the clearance increased by `more` [m], except for an exempt station."""
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
        return blocked and f"{blocked} with the {more:.4f} m by which the footprint is off the path"
    alone = replace(problem, robot=robot, obstacles=ObstacleSet.empty(), costmap=None)
    return _not_clear(path, alone, begun, relief)


def proven_way(motion: ProvenMotion, pose: Pose2 | None = None) -> ProvenWay | None:
    """Return the remaining path of a robot at the beginning of a proven motion, or None if it is outside the tube.

    Args:
        motion: The motion, driven from its start.
        pose: Pose of the robot; None for the start.
    """
    problem, start, path = motion.problem, motion.pose, motion.trajectory.path
    if pose is not None:
        relief, clearance = motion.certificate.start_relief, end_clearances(problem).start
        width = float(problem.tube_widths(start.as_array()[None], start, clearance, relief)[0])
        if not problem.robot.footprint.displacement(pose, start) <= width + TOLERANCE:
            return None
    return ProvenWay._keep(_Way(path, pose or start, problem))


def unchanged_way(motion: ProvenMotion, begin: float, end: float, problem: DockingProblem) -> ProvenWay | None:
    """Return a stretch of a proven path if its proof remains valid for a different problem, otherwise None.

    The proof remains valid if only the dock differs and both docks are so far away that neither the taper of the
    clearance nor the station reaches the stretch.

    Args:
        motion: The current motion.
        begin: Beginning of the stretch on the path of `motion` [m].
        end: End of the stretch [m].
        problem: The current problem.
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
    return ProvenWay._keep(_Way(stretch, stretch.start, problem))
