"""Shared parts of Nav2's smoothers: paths as poses, pieces between cusps, time limit, and collision check."""

from __future__ import annotations

import itertools
from abc import abstractmethod
from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field

from optdock.deadline import Deadline
from optdock.errors import SmootherCancelled, SmootherTimedOut
from optdock.geometry.pose import normalize_angle
from optdock.model.path import Path, PolylineSegment
from optdock.plugins.interfaces import Smoother, SmoothingReport, SmoothingResult, never_cancelled
from optdock.plugins.parameters import PluginParameters, checked_seconds
from optdock.verification import pose_clearances

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.geometry.arrays import FloatArray
    from optdock.geometry.footprint import Footprint
    from optdock.geometry.obstacles import ObstacleSet
    from optdock.model.costmap import Costmap
    from optdock.model.problem import DockingProblem
    from optdock.plugins.lifecycle import PluginContext

__all__ = [
    "PieceEnd",
    "PieceParameters",
    "PieceRun",
    "PieceSmoother",
    "Surroundings",
    "directional_pieces",
    "path_of",
    "poses_of",
    "task_of",
    "with_travel_yaw",
]

_SAME_PLACE = 1e-4  # [m], along each axis
_TURNED = 1e-4  # [rad]
_CURVE_SPACING = 0.05  # [m] between the poses of a curve
_TOLERANCE = 1e-6  # [m]: as the certificate's
_MARGIN = 0.5  # [m]: largest distance of a smoothed path from the input at which all obstacles are checked


def poses_of(path: Path) -> FloatArray:
    """Return the poses of a path without repetition; curves are sampled every 5 cm. Shape (n, 3)."""
    blocks = [
        np.array(segment.poses)
        if isinstance(segment, PolylineSegment)
        else Path((segment,)).sample(_CURVE_SPACING).poses
        for segment in path.segments
    ]
    return np.vstack([blocks[0], *(block[1:] for block in blocks[1:])])


def path_of(poses: FloatArray, like: Path) -> Path:
    """Return smoothed poses as a path with the frame and the first pose of `like`.

    The gears are determined from the headings and the directions of travel; afterwards the heading of the start pose is
    restored.

    Args:
        poses: Shape (n, 3), with headings from `with_travel_yaw`.
        like: Path before smoothing.

    Raises:
        InvalidPath: If fewer than two distinct poses are left.
    """
    path = Path.from_poses(poses)
    first = path.segments[0]
    assert isinstance(first, PolylineSegment)
    turned = np.array(first.poses)
    turned[0, 2] += normalize_angle(like.start.yaw - turned[0, 2])
    return Path((PolylineSegment(turned, first.direction), *path.segments[1:]), like.frame)


def directional_pieces(poses: FloatArray) -> list[tuple[int, int]]:
    """Return the first and last index of every piece between cusps and turns in place; adjacent pieces share an index.

    At a cusp consecutive steps of `poses`, Shape (n, 3), have opposite directions; a turn in place is a step that
    changes the yaw but not the position.
    """
    step = np.diff(poses[:, :2], axis=0)
    reverses = np.sum(step[:-1] * step[1:], axis=1) < 0.0
    turn = np.abs(np.mod(np.diff(poses[1:, 2]) + np.pi, 2.0 * np.pi) - np.pi)
    rotates = np.all(np.abs(step[1:]) < _SAME_PLACE, axis=1) & (turn > _TURNED)
    cuts = [0, *(np.flatnonzero(reverses | rotates) + 1).tolist(), len(poses) - 1]
    return list(itertools.pairwise(cuts))


def with_travel_yaw(poses: FloatArray) -> FloatArray:
    """Return poses, Shape (n, 3), n >= 3, with yaws along the next step, or against it in reverse, except the last yaw.

    A piece is in reverse if the heading of the second pose is more than 90 degrees from its step. A pose whose step is
    shorter than 0.1 mm keeps its yaw.
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
    """Surroundings of a path: costmap, footprint and nearby obstacles, each None if unknown."""

    costmap: Costmap | None
    footprint: Footprint | None
    obstacles: ObstacleSet | None

    def worsened(self, before: FloatArray, after: FloatArray) -> bool:
        """Whether poses `after` overlap obstacles more than poses `before`, Shape (n, 3) each.

        Nav2's smoother server also checks poses with `check_for_collisions`, but not the whole footprint.
        """
        if self.footprint is None or self.obstacles is None:
            return False
        deepest = [
            float(pose_clearances(poses, self.footprint, self.obstacles, within=0.0)[0].min())
            for poses in (before, after)
        ]
        return deepest[1] < deepest[0] - _TOLERANCE


def task_of(path: Path, problem: DockingProblem | None, context: PluginContext) -> tuple[Path, Surroundings]:
    """Return the path in the frame of the given or configured problem, and the surroundings of the path.

    Raises:
        InvalidPath: If the path is not in the frame of the problem.
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


class PieceParameters(PluginParameters):
    """Parameters common to both smoothers, with Nav2's names and defaults."""

    do_refinement: bool = Field(default=True, description="smooth the smoothed path again")
    refinement_num: int = Field(2, ge=0, description="number of refinements")
    enforce_path_inversion: bool = Field(default=True, description="keep cusps and turns in place where they are")
    check_for_collisions: bool = Field(default=True, description="keep a piece unchanged if it would collide")


class PieceEnd(str, Enum):
    """Reason why the smoothing of a piece ended."""

    STILL = "tolerance"
    OBSTACLE = "obstacle"
    MAX_ITS = "max_its"
    TIME = "time"
    COLLISION = "collision"


@dataclass
class PieceRun:
    """One call of `smooth`: its limits, the number of finished steps, and the reason why each piece ended."""

    deadline: Deadline
    costmap: Costmap | None
    cancel_checker: Callable[[], bool]
    steps: int = 0
    ends: list[PieceEnd] = field(default_factory=list)

    def out_of_time(self) -> bool:
        """Whether the time limit has passed; called before every step.

        Raises:
            SmootherCancelled: If the cancel checker returned True.
        """
        if self.cancel_checker():
            raise SmootherCancelled("smoothing was cancelled")
        return self.deadline.passed()


class PieceSmoother(Smoother):
    """Base of smoothers that move the inner points of each piece between cusps.

    Yaws are set to the directions of travel. Start and goal keep their yaw (Nav2 changes the yaw of the start), so a
    path may begin and end with a kink. A piece whose smoothed poses would bring the footprint into an obstacle that it
    did not touch before is left unchanged, unless `check_for_collisions` is off; the motion between poses is not
    checked. `completed` is False if the time limit stopped the work.
    """

    parameters: PieceParameters

    @abstractmethod
    def smooth_piece(self, poses: FloatArray, run: PieceRun) -> tuple[FloatArray, PieceEnd] | None:
        """Return the smoothed poses of a piece, Shape (n, 3), and the reason for the end, or None if left unchanged."""

    @abstractmethod
    def report(self, run: PieceRun) -> SmoothingReport:
        """Return the report of a call."""

    def smooth(
        self,
        path: Path,
        max_time: float,
        *,
        problem: DockingProblem | None = None,
        warm_start: Path | None = None,
        cancel_checker: Callable[[], bool] = never_cancelled,
    ) -> SmoothingResult:
        """Return a smoother polyline between the same two poses.

        Args:
            path: Raw path, from any source.
            max_time: Wall-clock time for the whole call [s], checked before every step.
            problem: Source of the costmap, the footprint and the obstacles; if None, the context is used. Without a
                footprint, collisions are not checked.
            warm_start: Not used.
            cancel_checker: Polled before every step.

        Raises:
            InvalidValue: If `max_time` is not finite or negative, or `problem` or `warm_start` has the wrong class.
            InvalidPath: If `path` is not a Path, is not in the frame of the problem, or too few distinct poses remain.
            SmootherTimedOut: If the time ran out before the first step. Nav2 also raises this error after later steps.
            SmootherCancelled: If `cancel_checker` returned True.
        """
        deadline = Deadline(checked_seconds(max_time, "max_time"), self.context.clock)
        self.check_task(path, problem, warm_start)
        path, surroundings = task_of(path, problem, self.context)
        run = PieceRun(deadline, surroundings.costmap, cancel_checker)
        poses = poses_of(path)
        whole = [(0, len(poses) - 1)]
        for first, last in directional_pieces(poses) if self.parameters.enforce_path_inversion else whole:
            piece = poses[first : last + 1]
            found = self.smooth_piece(piece, run)
            if found is not None:
                smoothed, end = found
                collides = self.parameters.check_for_collisions and surroundings.worsened(piece, smoothed)
                poses[first : last + 1] = piece if collides else smoothed
                run.ends.append(PieceEnd.COLLISION if collides and end is not PieceEnd.TIME else end)
        completed = PieceEnd.TIME not in run.ends
        if not completed and run.steps == 0:
            raise SmootherTimedOut(f"no step was finished within the allowed {max_time} s; allow more max_time")
        return SmoothingResult(path_of(poses, path), completed, self.report(run))
