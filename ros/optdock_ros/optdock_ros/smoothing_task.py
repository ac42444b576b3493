"""One goal of `smooth_path` in the frame of the costmap, and the checks of its result."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from optdock.errors import SmootherException
from optdock.model.path import Path, PolylineSegment, may_be_one_frame
from optdock.plugins.outcomes import SmoothingResult
from optdock.verification import certify_path
from optdock_ros.surroundings import SurroundingsError, first_collision

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from optdock.geometry.footprint import Footprint
    from optdock.geometry.pose import Pose2
    from optdock.model.costmap import Costmap
    from optdock.model.problem import DockingProblem

__all__ = ["InvalidSmoother", "SmoothedPathInCollision", "SmoothingTask", "mean_spacing", "with_headings"]

_SPACINGS = 0.01, 0.1  # [m]: bounds on the spacing of the poses of a curve
_END_TOLERANCE = 1e-3  # [m]: above rounding errors
_NO_HEADING = 1.0  # [rad] between heading and travel: more than a raw path has in one step


class InvalidSmoother(SmootherException):
    """The goal names an unknown smoother."""

    code = 501


class SmoothedPathInCollision(SmootherException):
    """The smoothed path is in collision."""

    code = 503


@dataclass(frozen=True, eq=False)
class SmoothingTask:
    """A path to smooth, and what is known of the robot and its surroundings.

    Args:
        path: Path in the frame of the costmap.
        problem: Constraints on the path; None if neither robot nor clearance are given.
        footprint: Outline of the robot, or None.
        costmap: Part of the costmap around the path, or None.
        whole: The whole costmap, or None.
        frame: Frame of the goal's path.
        seen: Pose of that frame in the frame of the costmap. Its inverse in the plane is the way back, also for a frame
            that is tilted.
        spacing: Spacing of the poses that are returned of a curve [m].
    """

    path: Path
    problem: DockingProblem | None
    footprint: Footprint | None
    costmap: Costmap | None
    whole: Costmap | None
    frame: str
    seen: Pose2
    spacing: float

    def check_answer(self, found: SmoothingResult, name: str) -> None:
        """Raise `SmootherException` if the type, the frame or the ends of a smoother's result are wrong."""
        if not (isinstance(found, SmoothingResult) and isinstance(found.path, Path)):
            raise SmootherException(f"{name}: returned no smoothed path, but {found!r}")
        if not may_be_one_frame(found.path.frame, self.path.frame):
            raise SmootherException(f"{name}: returned a path in {found.path.frame!r}, not in {self.path.frame!r}")
        away = max(found.path.start.distance_to(self.path.start), found.path.end.distance_to(self.path.end))
        if away > _END_TOLERANCE:
            raise SmootherException(f"{name}: returned a path that begins or ends {away:.3g} m off the one to smooth")

    def check_collisions(self, poses: FloatArray, found: SmoothingResult) -> None:
        """Check that a result is free of collisions.

        As in Nav2, the edges of the outline at every pose must not meet a lethal cell, an unknown cell or the border of
        the map. If the smoother has certified its result, the certificate is computed again.

        Raises:
            SmoothedPathInCollision: If the path is in collision, or not certified.
            SurroundingsError: If there is no costmap or no footprint.
        """
        if self.whole is None or self.footprint is None:
            what = "costmap" if self.whole is None else "footprint"
            raise SurroundingsError(f"check_for_collisions: there is no {what} to check with")
        certificate = found.report.certificate
        at = first_collision(poses, self.footprint, self.whole)
        if at >= 0:
            x, y, yaw = poses[at].tolist()
            hint = ""
            if certificate is not None and certificate.certified:
                proven, side = certificate.min_clearance, self.whole.resolution
                hint = f"; its certified clearance is {proven:.3f} m, less than a cell of {side:g} m: ask for that much"
            raise SmoothedPathInCollision(
                f"Smoothed Path collided at X: {x:.3f} Y: {y:.3f} Theta: {yaw:.3f} (pose {at} of {len(poses)}){hint}",
                where={"pose": [x, y, yaw], "index": at},
            )
        if certificate is not None and self.problem is not None:
            certificate = certify_path(found.path, self.problem)
        if certificate is not None and not certificate.certified:
            broken = certificate.violations[0]
            raise SmoothedPathInCollision(f"Smoothed Path is not certified: {broken.message}", where={"s": broken.s})

    def poses_of(self, path: Path) -> FloatArray:
        """Return the poses of a result, shape (n, 3): those of polylines, and samples of curves."""
        blocks = [
            segment.poses if isinstance(segment, PolylineSegment) else Path((segment,)).sample(self.spacing).poses
            for segment in path.segments
        ]
        # At a cusp one segment ends where the next one begins; controllers cannot use a step of length zero.
        return np.vstack([blocks[0], *(block[1:] for block in blocks[1:])])


def with_headings(poses: FloatArray) -> FloatArray:
    """Return poses, shape (n, 3), whose headings follow the travel if no headings were given.

    Nav2's grid planners leave the identity in all poses but the last one. Equal headings, except for the last one, are
    regarded as missing if a step leads aside of them or if the last heading differs.
    """
    if len(poses) < 3 or not np.all(poses[:-1, 2] == poses[0, 2]):
        return poses
    step = np.diff(poses[:, :2], axis=0)
    moves = np.hypot(step[:, 0], step[:, 1]) > 0.0
    travel = np.arctan2(step[:, 1], step[:, 0])
    aside = np.abs(np.sin(travel - poses[0, 2]))[moves]
    leads_aside = bool(aside.size) and aside.max() > math.sin(_NO_HEADING)
    if not leads_aside and math.cos(poses[-1, 2] - poses[0, 2]) > math.cos(_NO_HEADING):
        return poses
    out: FloatArray = poses.copy()
    out[:-1, 2] = np.where(moves, travel, out[:-1, 2])
    return out


def mean_spacing(poses: FloatArray) -> float:
    """Return the mean distance of consecutive poses, shape (n, 3), clipped to a practical range [m]."""
    length = float(np.hypot(*np.diff(poses[:, :2], axis=0).T).sum())
    return min(max(length / max(len(poses) - 1, 1), _SPACINGS[0]), _SPACINGS[1])
