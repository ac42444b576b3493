"""The plan of an undocking: a certified docking path, driven the other way."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, NamedTuple

from optdock.errors import CertificationFailed, FailedToTimePath, OptdockError
from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.pose import Pose2
from optdock.model.dock import DockDirection
from optdock.model.limits import SpeedZone
from optdock.model.path import Path
from optdock.model.segments import ClothoidSegment, Direction, PolylineSegment, TurnSegment
from optdock.planning.pipeline import DEFAULT_TIMING, TimingLike, plan_dock
from optdock.plugins.registry import timed_by
from optdock.verification import certify_path, certify_trajectory

if TYPE_CHECKING:
    from optdock.model.problem import DockingProblem
    from optdock.model.segments import Segment
    from optdock.model.trajectory import Trajectory
    from optdock.verification import Certificate, TrajectoryCertificate

__all__ = ["UndockPlan", "plan_undock", "reversed_path"]


class UndockPlan(NamedTuple):
    """The trajectory out of the dock, the certificate of its poses and that of its motion."""

    trajectory: Trajectory
    certificate: Certificate
    trajectory_certificate: TrajectoryCertificate


def plan_undock(
    problem: DockingProblem,
    path: Path | None = None,
    *,
    staging_distance: float = 0.7,
    time_budget: float = 2.0,
    timing: TimingLike = DEFAULT_TIMING,
) -> UndockPlan:
    """A certified motion from the dock to where the docking path began.

    A path and its reversal hold the same poses, so a docking path that keeps its clearance among the problem's
    obstacles proves its reversal. Either the given path is certified anew, or one is planned from the staging pose:
    `staging_distance` straight before the dock, on the side that the dock's direction says (either, if AUTO).

    Args:
        problem: The dock, the robot, the obstacles as they are now; its start plays no part.
        path: The path that was driven into the dock, or None.
        staging_distance: Distance of the staging pose from the dock [m]; used without a path.
        time_budget: Wall-clock seconds per planned direction.
        timing: Times the way out, and a way in that is planned.

    Raises:
        CertificationFailed: The given path does not keep its clearance any more, or the motion breaks a limit.
        FailedToTimePath: The way out cannot be timed.
        OptdockError: No way was found; see `plan_dock`.
    """
    if path is None:
        path, certificate = _planned(problem, staging_distance, time_budget, timing)
    else:
        certificate = certify_path(path, _from(problem, path.start))
        if not certificate.certified:
            raise CertificationFailed(f"the way out is not certified: {certificate.reason}")
    trajectory = _timed(reversed_path(path), problem, timing)
    limits = problem.robot.limits
    proof = certify_trajectory(trajectory, limits, SpeedZone(), start_wait=limits.start_wait(trajectory.path))
    if not proof.certified:
        raise CertificationFailed(f"the motion out of the dock is not certified: {proof.reason}")
    return UndockPlan(trajectory, certificate, proof)


def _planned(
    problem: DockingProblem, distance: float, time_budget: float, timing: TimingLike
) -> tuple[Path, Certificate]:
    """The first docking path that can be planned from a staging pose, or the first reason why not."""
    auto = problem.dock.direction is DockDirection.AUTO
    directions = (DockDirection.FORWARD, DockDirection.BACKWARD) if auto else (problem.dock.direction,)
    failure: OptdockError | None = None
    for direction in directions:
        side = -1.0 if direction is DockDirection.FORWARD else 1.0
        staging = problem.goal @ Pose2(side * distance, 0.0, 0.0)
        dock = dataclasses.replace(problem.dock.without_view, direction=direction)
        try:
            plan = plan_dock(
                dataclasses.replace(_from(problem, staging), dock=dock), time_budget=time_budget, timing=timing
            )
        except OptdockError as error:
            failure = failure or error
        else:
            return plan.path, plan.certificate
    assert failure is not None
    raise failure


def _from(problem: DockingProblem, start: Pose2) -> DockingProblem:
    """The problem from another start; on the way out of the dock nothing must be seen."""
    begun = problem.starting_at(start)
    return begun if begun.required_view is None else dataclasses.replace(begun, dock=begun.dock.without_view)


def _timed(path: Path, problem: DockingProblem, timing: TimingLike) -> Trajectory:
    try:
        wait = problem.robot.limits.start_wait(path)
        return timed_by(timing, path, problem, zone=SpeedZone(), start_wait=wait)
    except FailedToTimePath as error:
        raise FailedToTimePath(f"the way out of the dock: {error}", where=error.where) from error


def reversed_path(path: Path) -> Path:
    """The path from its end to its start; every pose is the same, so its clearance is too.

    With s' = length - s the gear changes its sign and so does the curvature along the travel.
    """
    return Path(tuple(_reversed_segment(segment) for segment in reversed(path.segments)), path.frame)


def _reversed_segment(segment: Segment) -> Segment:
    if isinstance(segment, ClothoidSegment):
        spline = segment.spline
        knots = (spline.length - spline.knots)[::-1]
        return ClothoidSegment(ClothoidSpline(spline.end, knots, -spline.curvature[::-1], -spline.sign))
    if isinstance(segment, TurnSegment):
        return TurnSegment(segment.end, -segment.turn)
    assert isinstance(segment, PolylineSegment)  # a path holds no other kind
    return PolylineSegment(segment.poses[::-1], Direction(-segment.direction))
