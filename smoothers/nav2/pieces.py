"""What both of Nav2's smoothers share: a path as poses, its pieces between cusps, and what these must not run into."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from optdock.geometry.pose import normalize_angle
from optdock.model.path import Path, PolylineSegment
from optdock.verification import pose_clearances

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from optdock.geometry.footprint import Footprint
    from optdock.geometry.obstacles import ObstacleSet
    from optdock.model.costmap import Costmap
    from optdock.model.problem import DockingProblem
    from optdock.plugins.lifecycle import PluginContext

__all__ = ["Surroundings", "directional_pieces", "path_of", "poses_of", "task_of", "with_travel_yaw"]

_SAME_PLACE = 1e-4  # [m], along each axis
_TURNED = 1e-4  # [rad]
_CURVE_SPACING = 0.05  # of the poses taken from a curve [m]
_TOLERANCE = 1e-6  # [m]: as the certificate's
_MARGIN = 0.5  # [m]: how far beside a path its smoothed form may run and still be judged among all obstacles


def poses_of(path: Path) -> FloatArray:
    """The poses that a path was made of, each once; of a curve, samples 5 cm apart. Shape (n, 3)."""
    blocks = [
        np.array(segment.poses)
        if isinstance(segment, PolylineSegment)
        else Path((segment,)).sample(_CURVE_SPACING).poses
        for segment in path.segments
    ]
    return np.vstack([blocks[0], *(block[1:] for block in blocks[1:])])


def path_of(poses: FloatArray, like: Path) -> Path:
    """The smoothed poses as a path in the frame of `like` that begins with the very pose that `like` begins with.

    Gears are read from headings along the travel. The start may look anywhere, as that of a raw path does, so its own
    heading, which Nav2's smoothers turn, is put back once the gears are known.

    Args:
        poses: Shape (n, 3), headings as `with_travel_yaw` makes them.
        like: The path that was smoothed.

    Raises:
        InvalidPath: Fewer than two distinct poses are left.
    """
    path = Path.from_poses(poses)
    first = path.segments[0]
    assert isinstance(first, PolylineSegment)
    turned = np.array(first.poses)
    turned[0, 2] += normalize_angle(like.start.yaw - turned[0, 2])
    return Path((PolylineSegment(turned, first.direction), *path.segments[1:]), like.frame)


def directional_pieces(poses: FloatArray) -> list[tuple[int, int]]:
    """First and last index of every piece between cusps and turns in place; neighbours share an index.

    A cusp is where consecutive steps point against each other; a turn in place is a step without motion but with a
    change of yaw.

    Args:
        poses: Shape (n, 3).
    """
    step = np.diff(poses[:, :2], axis=0)
    reverses = np.sum(step[:-1] * step[1:], axis=1) < 0.0
    turn = np.abs(np.mod(np.diff(poses[1:, 2]) + np.pi, 2.0 * np.pi) - np.pi)
    rotates = np.all(np.abs(step[1:]) < _SAME_PLACE, axis=1) & (turn > _TURNED)
    cuts = [0, *(np.flatnonzero(reverses | rotates) + 1).tolist(), len(poses) - 1]
    return list(itertools.pairwise(cuts))


def with_travel_yaw(poses: FloatArray) -> FloatArray:
    """Every yaw along the step that follows it, or against it in reverse; the last yaw stays.

    The piece runs in reverse if the second pose looks more than 90 degrees away from the step that follows it. A pose
    without a step of at least 0.1 mm keeps its yaw.

    Args:
        poses: Shape (n, 3), n >= 3.
    """
    step = np.diff(poses[:, :2], axis=0)
    travel = np.arctan2(step[:, 1], step[:, 0])
    is_reverse = np.cos(poses[1, 2] - travel[1]) < 0.0
    moves = np.any(np.abs(step) >= _SAME_PLACE, axis=1)
    out: FloatArray = poses.copy()
    out[:-1, 2] = np.where(moves, travel + (np.pi if is_reverse else 0.0), out[:-1, 2])
    return out


@dataclass(frozen=True, eq=False)
class Surroundings:
    """What stands around a path.

    Args:
        costmap: The grid whose cells stop a point, or None.
        footprint: The robot's outline; None where it was not given.
        obstacles: Everything near the path that the robot must not touch.
    """

    costmap: Costmap | None
    footprint: Footprint | None
    obstacles: ObstacleSet | None

    def worsened(self, before: FloatArray, after: FloatArray) -> bool:
        """Whether the poses `after` touch something deeper than the poses `before` do; Shape (n, 3) each.

        Judged at the poses, as Nav2's smoother server does with `check_for_collisions`, but with the whole footprint.
        """
        if self.footprint is None or self.obstacles is None:
            return False
        deepest = [
            float(pose_clearances(poses, self.footprint, self.obstacles, within=0.0)[0].min())
            for poses in (before, after)
        ]
        return deepest[1] < deepest[0] - _TOLERANCE


def task_of(path: Path, problem: DockingProblem | None, context: PluginContext) -> tuple[Path, Surroundings]:
    """The path, in the frame of the problem at hand, and what stands around it.

    Raises:
        InvalidPath: It stands in another frame.
    """
    wanted = context.problem_at_hand(problem)
    footprint = context.footprint if wanted is None else wanted.robot.footprint
    if footprint is None:
        return path, Surroundings(context.costmap, None, None)
    points = path.sample(0.5).poses[:, :2]
    reach = footprint.circumscribed_radius + 0.5 + _MARGIN
    lower, upper = points.min(axis=0) - reach, points.max(axis=0) + reach
    if wanted is None:
        return path, Surroundings(context.costmap, footprint, context.obstacles_near(lower, upper))
    near = wanted.all_obstacles.in_box(np.asarray(lower), np.asarray(upper))
    return path.with_frame(wanted.frame), Surroundings(wanted.costmap, footprint, near)
