"""`smoother_server`: Nav2's action `smooth_path` with the smoothers of this library.

Parameters, topics, action and error codes are those of Nav2's server. Beside it: a path in another frame than the
costmap is transformed, the robot's limits (`robot`) and the clearance (`clearance`) may be given, a costmap that is too
old is refused (`costmap_timeout`), cancelling ends the work within milliseconds, and what a smoother has certified is
certified once more by `check_for_collisions`.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from nav2_msgs.action import SmoothPath
from pydantic import Field
from rclpy.duration import Duration

from optdock import ros
from optdock.errors import Cancelled, InvalidPath, InvalidValue, OptdockError, SmootherException
from optdock.geometry.pose import Pose2, transform_poses
from optdock.model.dock import Dock
from optdock.model.path import Path, may_be_one_frame
from optdock.model.problem import DockingProblem
from optdock.plugins.interfaces import PluginContext, Smoother
from optdock.plugins.outcomes import SmoothingResult
from optdock.plugins.registry import create_plugin
from optdock.verification import certify_path
from optdock_ros.goals import JobEnded, WorkerJob
from optdock_ros.plugin_server import (
    PluginServer,
    PluginServerParameters,
    ServerSettings,
    compact_path,
    cropped,
    failed,
    poses_of,
)
from optdock_ros.server import run
from optdock_ros.surroundings import SurroundingsError, first_collision, now

if TYPE_CHECKING:
    from nav_msgs.msg import Path as PathMessage

    from optdock.geometry.arrays import FloatArray
    from optdock.geometry.footprint import Footprint
    from optdock.model.costmap import Costmap

__all__ = ["SmootherServer", "SmootherServerParameters", "main"]

# [m]: how far around the path, and beyond the robot, the costmap is handed to a smoother. Smoothers move a path by
# decimetres; what would leave this part is refused.
_AROUND = 2.0
_SPACINGS = 0.01, 0.1  # [m]: of the poses taken from a curve, in which the input's own spacing counts
_ELSEWHERE = 1e-3  # [m]: more than rounding, less than matters
_NO_HEADING = 1.0  # [rad] off the travel: more than any raw path slips in one step


class SmootherServerParameters(PluginServerParameters):
    """Nav2's names and defaults."""

    smoother_plugins: tuple[str, ...] = Field(("simple_smoother",), description="names of the smoothers")


class InvalidSmoother(SmootherException):
    """The goal asks for a smoother that there is not."""

    code = 501


class SmoothedPathInCollision(SmootherException):
    """The smoothed path touches something."""

    code = 503


class SmootherServer(PluginServer[Smoother]):
    """See the module."""

    Parameters = SmootherServerParameters
    kind: ClassVar[str] = "smoother"
    interface = Smoother
    default_plugins: ClassVar[tuple[str, ...]] = ("simple_smoother",)
    default_class: ClassVar[str] = "nav2_smoother::SimpleSmoother"
    fixed = PluginServer.fixed | {"smoother_plugins"}

    def __init__(self, name: str = "smoother_server", **kwargs: Any) -> None:
        super().__init__(name, **kwargs)

    def set_up(self) -> None:
        """Subscribe, and offer the action."""
        super().set_up()
        self._plan_publisher = self.path_publisher("plan_smoothed")
        self.offer(SmoothPath, "smooth_path", self._smooth)

    def warm_up(self) -> None:
        """Build what the smoothers' first calls would build."""
        super().warm_up()
        for smoother in self.settings.plugins.values():
            create_plugin(Smoother, smoother.choice.name, smoother.choice.parameters).warm_up()

    def _smooth(self, goal: SmoothPath.Goal, job: WorkerJob) -> tuple[SmoothPath.Result, bool]:
        """A goal, in the worker's thread."""
        try:
            return self._smoothed(goal, job), True
        except JobEnded:
            raise
        except Cancelled as error:
            job.look()
            why, code = f"a smoother ended its work unasked: {error}", SmootherException.code
        except OptdockError as error:
            why, code = str(error), error.code if 500 <= error.code <= 505 else SmootherException.code
        self.get_logger().error(why)
        return failed(SmoothPath.Result(), why, code), False

    def _smoothed(self, goal: SmoothPath.Goal, job: WorkerJob) -> SmoothPath.Result:
        began, settings, result = now(self), self.settings, SmoothPath.Result()
        smoother = self.chosen(goal.smoother_id, settings)
        if smoother is None:
            raise InvalidSmoother(f"Invalid Smoother: {goal.smoother_id!r}; available: {', '.join(settings.plugins)}")
        task = self._task(goal.path, settings)
        goal.path.poses = []  # read; the request is kept for as long as its result
        seconds = goal.max_smoothing_duration.sec + 1e-9 * goal.max_smoothing_duration.nanosec
        with smoother.made(PluginContext(smoother.name, task.costmap, task.footprint)) as plugin:
            found = plugin.smooth(task.path, seconds, problem=task.problem, cancel_checker=job.should_end)
        job.look()
        task.check_answer(found, smoother.name)
        poses = poses_of(found.path, task.spacing)
        result.path = compact_path(transform_poses(task.seen.inverse(), poses), task.frame, began)
        result.was_completed = bool(found.completed)
        if self._plan_publisher.get_subscription_count():  # saves half a millisecond
            self._plan_publisher.publish(result.path)
        if goal.check_for_collisions:
            task.check_collisions(poses, found)
        if not result.was_completed:
            self.get_logger().info(f"{smoother.name}: its time, {seconds:g} s, was over first; this is what it had")
        result.smoothing_duration = Duration(seconds=max(0.0, now(self) - began)).to_msg()
        return result

    def _task(self, message: PathMessage, settings: ServerSettings[Smoother]) -> _Task:
        """What the goal asks for, among what is known of the surroundings.

        Raises:
            OptdockError: The path is none, or the surroundings are not known, too old or in a frame that is not.
        """
        if not message.poses:
            raise InvalidPath("path: has no poses")
        try:
            given = ros.path_poses(message)
        except InvalidValue as error:
            raise InvalidPath(str(error)) from error
        known = self.newest_costmap(settings)
        frame = given.frame if known is None else known.frame
        seen = Pose2(0.0, 0.0, 0.0)
        if frame.lstrip("/") != given.frame.lstrip("/"):
            tolerance = settings.parameters.transform_tolerance
            seen = self.transforms.lookup(frame, given.frame, now(self), tolerance).planar()
        poses = _with_headings(transform_poses(seen, given.poses))
        path, footprint = Path.from_poses(poses, frame), self.outline(settings)
        rule = settings.rule
        reach = _AROUND + rule.required + (footprint.circumscribed_radius if footprint is not None else 0.0)
        near = None if known is None else cropped(known.costmap, poses, reach)
        problem = None
        if settings.limits is not None or settings.clearance is not None:
            if footprint is None:
                raise self.no_footprint(settings)
            robot = settings.robot(footprint)
            problem = DockingProblem(path.start, Dock(path.end), robot, (), rule, costmap=near, frame=frame)
        whole = None if known is None else known.costmap
        return _Task(path, problem, footprint, near, whole, given.frame, seen, _spacing(poses))


@dataclass(frozen=True, eq=False)
class _Task:
    """One goal, in the costmap's frame.

    Args:
        path: What to smooth.
        problem: What must hold, where robot or clearance are given.
        footprint: The robot's outline, where it is known.
        costmap: The part of it around the path.
        whole: All of it.
        frame: Of the goal's path.
        seen: That frame seen from the costmap's, in the plane: there and back is the same place, also where it leans.
        spacing: Of the poses to return of a curve [m].
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
        """Refuse what no smoother may return.

        Raises:
            SmootherException: It is none, stands in another frame, or begins or ends elsewhere.
        """
        if not (isinstance(found, SmoothingResult) and isinstance(found.path, Path)):
            raise SmootherException(f"{name}: returned no smoothed path, but {found!r}")
        if not may_be_one_frame(found.path.frame, self.path.frame):
            raise SmootherException(f"{name}: returned a path in {found.path.frame!r}, not in {self.path.frame!r}")
        away = max(found.path.start.distance_to(self.path.start), found.path.end.distance_to(self.path.end))
        if away > _ELSEWHERE:
            raise SmootherException(f"{name}: returned a path that begins or ends {away:.3g} m off the one to smooth")

    def check_collisions(self, poses: FloatArray, found: SmoothingResult) -> None:
        """Refuse a result that touches something.

        As Nav2 does: at every pose the edges of the outline must meet neither a lethal nor an unknown cell nor one off
        the map. What a smoother has certified, between the poses and inside the outline as well, must be certified
        here.

        Raises:
            SmoothedPathInCollision: It does.
            SurroundingsError: There is no costmap or no footprint to judge by.
        """
        if self.whole is None or self.footprint is None:
            what = "costmap" if self.whole is None else "footprint"
            raise SurroundingsError(f"check_for_collisions: there is no {what} to check with")
        certificate = found.report.certificate
        at = first_collision(poses, self.footprint, self.whole)
        if at >= 0:
            x, y, yaw = poses[at].tolist()
            said = ""
            if certificate is not None and certificate.certified:
                proven, side = certificate.min_clearance, self.whole.resolution
                said = f"; its certified clearance is {proven:.3f} m, less than a cell of {side:g} m: ask for that much"
            raise SmoothedPathInCollision(
                f"Smoothed Path collided at X: {x:.3f} Y: {y:.3f} Theta: {yaw:.3f} (pose {at} of {len(poses)}){said}",
                where={"pose": [x, y, yaw], "index": at},
            )
        if certificate is not None and self.problem is not None:
            certificate = certify_path(found.path, self.problem)
        if certificate is not None and not certificate.certified:
            broken = certificate.violations[0]
            raise SmoothedPathInCollision(f"Smoothed Path is not certified: {broken.message}", where={"s": broken.s})


def _with_headings(poses: FloatArray) -> FloatArray:
    """The poses, looking along the travel where headings were not given.

    Nav2's grid planners leave the identity in all poses but the last; taken for headings, that would be a path that
    slides sideways. So headings that are all the same, but for the last, are none where a step leads aside of them, or
    where the last is another one: a robot that never turned does not end turned.
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


def _spacing(poses: FloatArray) -> float:
    """The mean spacing of poses, within reason [m]."""
    length = float(np.hypot(*np.diff(poses[:, :2], axis=0).T).sum())
    return min(max(length / max(len(poses) - 1, 1), _SPACINGS[0]), _SPACINGS[1])


def main() -> int:
    """The console script."""
    return run(SmootherServer)


if __name__ == "__main__":
    sys.exit(main())
