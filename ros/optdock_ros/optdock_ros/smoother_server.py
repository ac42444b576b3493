"""`smoother_server`: Nav2's action `smooth_path` with the smoothers of this library.

Parameters, topics, action and error codes are those of Nav2's server. Beside it: a path in another frame than the
costmap is transformed, the robot's limits (`robot`) and the clearance (`clearance`) may be given, a costmap that is too
old is refused (`costmap_timeout`), cancelling ends the work within milliseconds, and a result that was certified where
it was made must be certified here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from nav2_msgs.action import SmoothPath
from nav_msgs.msg import Path as PathMessage
from pydantic import Field
from rclpy.duration import Duration

from optdock import ros
from optdock.costmap.costmap import Costmap
from optdock.costmap.costs import LETHAL
from optdock.dock import Dock
from optdock.errors import Cancelled, InvalidPath, InvalidValue, OptdockError, SmootherException
from optdock.geometry.pose import transform_points
from optdock.interfaces import PluginContext, Smoother
from optdock.nav2.layers.raster import cells_of_lines
from optdock.path import Path, PolylineSegment
from optdock.plugins import create_plugin
from optdock.problem import ClearanceRule, DockingProblem
from optdock.verification import certify_path
from optdock_ros.goals import GoalAction, Job, JobEnded, Worker
from optdock_ros.parameters import (
    Faults,
    RobotParameters,
    ServerParameters,
    clearance_parameters,
    declare,
    robot_parameters,
)
from optdock_ros.plugins import NamedPlugin, named_plugins
from optdock_ros.server import Server, run
from optdock_ros.surroundings import CostmapTopic, FootprintTopic, SurroundingsError, now
from optdock_ros.transforms import Transform, TransformBuffer

if TYPE_CHECKING:
    from collections.abc import Mapping

    from optdock.geometry.arrays import FloatArray
    from optdock.geometry.footprint import Footprint
    from optdock.outcomes import SmoothingResult

__all__ = ["SmootherServer", "SmootherServerParameters", "main"]

_DEFAULT_PLUGINS = ("simple_smoother",)
_DEFAULT_CLASS = "nav2_smoother::SimpleSmoother"  # of that one, where the parameters name none, as Nav2 has it
# [m]: how far around the path, and beyond the robot, the costmap is handed to a smoother; its edge is a wall, so that
# what leaves it is refused and nothing is believed free that was not looked at. Smoothers move a path by decimetres.
_AROUND = 2.0
_SPACINGS = 0.01, 0.1  # [m]: of the poses taken from a curve, in which the input's own spacing counts
_NO_HEADING = 1.0  # [rad]: a heading of zero that is this far off the travel says that there are none


class SmootherServerParameters(ServerParameters):
    """Nav2's names and defaults; those below `action_server_result_timeout` are ours."""

    costmap_topic: str = Field("global_costmap/costmap_raw", description="costmap, nav2_msgs/Costmap; empty: none")
    footprint_topic: str = Field("global_costmap/published_footprint", description="outline of the robot")
    robot_base_frame: str = Field("base_link", min_length=1, description="the robot's own frame")
    transform_tolerance: float = Field(0.1, ge=0, description="how old a transform may be [s]")
    smoother_plugins: tuple[str, ...] = Field(_DEFAULT_PLUGINS, description="names of the smoothers")
    action_server_result_timeout: float = Field(10.0, gt=0, description="how long results are kept [s]")
    costmap_timeout: float = Field(0.0, ge=0, description="oldest costmap that is believed; 0: any, as Nav2 [s]")


@dataclass(frozen=True)
class Settings:
    """What the parameters of the server mean."""

    parameters: SmootherServerParameters
    smoothers: Mapping[str, NamedPlugin[Smoother]]
    robot: RobotParameters | None
    clearance: ClearanceRule | None


class InvalidSmoother(SmootherException):
    """The goal asks for a smoother that there is not."""

    code = 501


class SmoothedPathInCollision(SmootherException):
    """The smoothed path touches something."""

    code = 503


class SmootherServer(Server[Settings]):
    """See the module."""

    Parameters: ClassVar[type[ServerParameters]] = SmootherServerParameters
    fixed = frozenset({"costmap_topic", "footprint_topic", "robot_base_frame", "smoother_plugins"})

    def __init__(self, name: str = "smoother_server", **kwargs: Any) -> None:
        super().__init__(name, **kwargs)
        self._worker: Worker | None = None
        self._action: GoalAction | None = None
        self._topics: list[Any] = []

    def check(self, block: dict[str, object]) -> Settings:
        """As `Server.check`.

        Raises:
            InvalidValue: What is wrong with any of the parameters, one line per fault.
        """
        given = block.get("smoother_plugins", list(_DEFAULT_PLUGINS))
        names = tuple(map(str, given)) if isinstance(given, list | tuple) else ()
        if names == _DEFAULT_PLUGINS:
            own = block.get(names[0], {})
            block = {**block, names[0]: {"plugin": _DEFAULT_CLASS, **own}} if isinstance(own, dict) else block
        smoothers, faults = named_plugins(self.get_name(), "smoother", Smoother, names, block)
        found = Faults(faults)
        own = found.attempt(lambda: self.own_parameters(block, (*names, "robot", "clearance")))
        robot = found.attempt(lambda: robot_parameters(block["robot"]) if "robot" in block else None)
        clearance = found.attempt(lambda: clearance_parameters(block["clearance"]) if "clearance" in block else None)
        found.look()
        assert isinstance(own, SmootherServerParameters)
        return Settings(own, smoothers, robot, clearance)

    def set_up(self) -> None:
        """Subscribe, and offer the action."""
        told = self.settings.parameters
        for smoother in self.settings.smoothers.values():
            declare(self, smoother.plugin_class.Parameters, f"{smoother.name}.")
            self.get_logger().info(f"Created smoother: {smoother.name} of type {smoother.choice.name}")
            if smoother.not_read:
                self.get_logger().info(f"{smoother.name}: not read: {', '.join(smoother.not_read)}")
        self._transforms = TransformBuffer(self)
        self._topics.append(self._transforms)
        self._costmap = self._footprint = None
        if told.costmap_topic:
            self._costmap = CostmapTopic(self, told.costmap_topic)
            self._topics.append(self._costmap)
        else:
            self.get_logger().warning("costmap_topic is empty: nothing is known of obstacles")
        if told.footprint_topic:
            self._footprint = FootprintTopic(
                self, told.footprint_topic, self._transforms, told.robot_base_frame, told.transform_tolerance
            )
            self._topics.append(self._footprint)
        self._plan_publisher = self.create_lifecycle_publisher(PathMessage, "plan_smoothed", 1)
        self._worker = Worker(f"{self.get_name()} goals")
        self._action = GoalAction(
            self,
            SmoothPath,
            "smooth_path",
            worker=self._worker,
            work=self._smooth,
            ended=lambda why: _failure(why, 0),
            is_open=lambda: self.is_active,
            result_timeout=told.action_server_result_timeout,
        )

    def start(self) -> None:
        """Build and load in advance what would make the first goal slower than the next."""
        assert self._worker is not None
        # Solvers belong to the thread that made them.
        self._worker.do(self._warm_up)

    def stop(self) -> None:
        """End the goal at work."""
        if self._worker is not None and not self._worker.end_all("the server was deactivated"):
            self.get_logger().error("a smoother does not end its work; its goal is given up")

    def tear_down(self) -> None:
        """Take the action away, and end the subscriptions and the thread."""
        if self._action is not None:
            self._action.close()
        if self._worker is not None and not self._worker.close():
            self.get_logger().error("a smoother does not end; its thread is left behind")
        self._action = self._worker = None
        for topic in reversed(self._topics):
            topic.close()
        self._topics = []
        if hasattr(self, "_plan_publisher"):
            self.destroy_lifecycle_publisher(self._plan_publisher)
            del self._plan_publisher

    def _warm_up(self) -> None:
        for smoother in self.settings.smoothers.values():
            plugin = create_plugin(Smoother, smoother.choice.name, smoother.choice.parameters)
            plugin.warm_up()
        # The first message of a kind loads its type support.
        ros.path_poses(ros.path_message(ros.imported, np.zeros((1, 3)), "map", 0.0))

    # A goal, in the worker's thread.

    def _smooth(self, goal: SmoothPath.Goal, job: Job) -> tuple[SmoothPath.Result, bool]:
        began, settings, result = now(self), self.settings, SmoothPath.Result()
        try:
            smoother = _chosen(goal.smoother_id, settings.smoothers)
            task = self._task(goal.path, settings)
            goal.path.poses = []  # read; the request is kept for as long as its result
            seconds = goal.max_smoothing_duration.sec + 1e-9 * goal.max_smoothing_duration.nanosec
            plugin = smoother.made(PluginContext(smoother.name, task.costmap, task.footprint))
            found = plugin.smooth(task.path, seconds, problem=task.problem, cancel_checker=job.should_end)
            plugin.shutdown()
            job.look()
            poses = task.poses_of(found.path)
            result.path = ros.path_message(ros.imported, task.seen.inverse().poses(poses), task.asked_frame, began)
            result.was_completed = bool(found.completed)
            self._plan_publisher.publish(result.path)
            if goal.check_for_collisions:
                task.check_collisions(poses, found)
        except Cancelled as error:
            job.look()
            raise SmootherException(f"{smoother.name} says it was cancelled: {error}") from error
        except JobEnded:
            raise
        except OptdockError as error:
            self.get_logger().error(str(error))
            return _failure(str(error), error.code if 500 <= error.code <= 505 else 500), False
        if not result.was_completed:
            self.get_logger().info(f"{smoother.name}: its time, {seconds:g} s, was over first; this is what it had")
        result.smoothing_duration = Duration(seconds=now(self) - began).to_msg()
        return result, True

    def _task(self, message: PathMessage, settings: Settings) -> _Task:
        """What the goal asks for, among what is known of the surroundings.

        Raises:
            OptdockError: The path is none, or the surroundings are not known, too old or in a frame that is not.
        """
        told = settings.parameters
        if not message.poses:
            raise InvalidPath("path: has no poses")
        try:
            given = ros.path_poses(message)
        except InvalidValue as error:
            raise InvalidPath(str(error)) from error
        costmap, frame = None, given.frame
        if self._costmap is not None:
            seen = self._costmap.newest()
            self._check_age(self._costmap.topic, seen.stamp, told)
            costmap, frame = seen.costmap, seen.frame
        move = Transform(frame, given.frame, given.stamp, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
        if frame.lstrip("/") != given.frame.lstrip("/"):
            move = self._transforms.lookup(frame, given.frame, now(self), told.transform_tolerance)
        poses = _with_headings(move.poses(given.poses))
        path, footprint = Path.from_poses(poses, frame), self._outline(settings)
        near = None if costmap is None else _cropped(costmap, poses, footprint, settings.clearance)
        problem = None
        if settings.robot is not None or settings.clearance is not None:
            if footprint is None:
                raise SurroundingsError(f"{told.footprint_topic}: no footprint yet, which the robot needs")
            robot = (settings.robot or robot_parameters({})).robot(footprint)
            rule = settings.clearance if settings.clearance is not None else ClearanceRule(0.0, 0.0, 0.0)
            problem = DockingProblem(path.start, Dock(path.end), robot, (), rule, costmap=near, frame=frame)
        return _Task(path, problem, footprint, near, costmap, given.frame, move, _spacing(poses))

    def _outline(self, settings: Settings) -> Footprint | None:
        """The robot's outline: of the parameters, or of the topic; None where nothing has come.

        Raises:
            OptdockError: What came is no outline, is too old, or was published where nobody knows.
        """
        if settings.robot is not None and settings.robot.footprint is not None:
            return settings.robot.footprint
        if self._footprint is None or not self._footprint.is_heard:
            return None
        footprint, stamp = self._footprint.newest()
        self._check_age(self._footprint.topic, stamp, settings.parameters)
        return footprint

    def _check_age(self, topic: str, stamp: float, told: SmootherServerParameters) -> None:
        age = now(self) - stamp
        if 0.0 < told.costmap_timeout < age:
            raise SurroundingsError(
                f"{topic}: is {age:.2f} s old, more than costmap_timeout = {told.costmap_timeout:g} s",
                where={"topic": topic, "age": age},
            )


@dataclass(frozen=True, eq=False)
class _Task:
    """One goal, in the costmap's frame.

    Args:
        path: What to smooth.
        problem: What must hold, where robot or clearance are given.
        footprint: The robot's outline, where it is known.
        costmap: The part of it around the path.
        whole: All of it.
        asked_frame: The frame of the goal's path.
        seen: That frame, seen from the costmap's.
        spacing: Of the poses to return of a curve [m].
    """

    path: Path
    problem: DockingProblem | None
    footprint: Footprint | None
    costmap: Costmap | None
    whole: Costmap | None
    asked_frame: str
    seen: Transform
    spacing: float

    def poses_of(self, found: Path) -> FloatArray:
        """The poses to return, Shape (n, 3): those of a polyline, of a curve some."""
        blocks = [
            segment.poses if isinstance(segment, PolylineSegment) else Path((segment,)).sample(self.spacing).poses
            for segment in found.segments
        ]
        # At a cusp one segment ends where the next begins; a controller has no use for a step of no length.
        return np.vstack([blocks[0], *(block[1:] for block in blocks[1:])])

    def check_collisions(self, poses: FloatArray, found: SmoothingResult) -> None:
        """Refuse a result that touches something.

        As Nav2 does: at every pose the edges of the outline must meet neither a lethal nor an unknown cell nor one off
        the map. And what a smoother has certified, between the poses and inside the outline as well, is certified
        against the surroundings of this task, not taken from its report.

        Raises:
            SmoothedPathInCollision: It does.
            SurroundingsError: There is no costmap or no footprint to judge by.
        """
        if self.whole is None or self.footprint is None:
            what = "costmap" if self.whole is None else "footprint"
            raise SurroundingsError(f"check_for_collisions: there is no {what} to check with")
        at = first_collision(poses, self.footprint, self.whole)
        if at >= 0:
            x, y, yaw = poses[at]
            raise SmoothedPathInCollision(
                f"Smoothed Path collided at X: {x:.3f} Y: {y:.3f} Theta: {yaw:.3f} (pose {at} of {len(poses)})",
                where={"pose": poses[at].tolist(), "index": at},
            )
        certificate = found.report.certificate
        if certificate is not None and self.problem is not None:
            certificate = certify_path(found.path, self.problem)
        if certificate is not None and not certificate.certified:
            broken = certificate.violations[0]
            raise SmoothedPathInCollision(f"Smoothed Path is not certified: {broken.message}", where={"s": broken.at_s})


def first_collision(poses: FloatArray, footprint: Footprint, costmap: Costmap) -> int:
    """The first pose whose outline's edges meet a lethal or unknown cell or one off the map, or -1.

    Args:
        poses: Shape (n, 3).
        footprint: The outline.
        costmap: Where to look.
    """
    corners = transform_points(poses, footprint.vertices)
    count = corners.shape[1]
    starts = costmap.cell_of(corners.reshape(-1, 2))
    ends = costmap.cell_of(np.roll(corners, -1, axis=1).reshape(-1, 2))
    on_map = costmap.has_cell(starts).reshape(-1, count).all(axis=1)
    if not on_map.all():
        # Cells are looked up where all corners are on the map; a line between two such is there too.
        inside = np.flatnonzero(on_map)
        first_off = int(np.flatnonzero(~on_map)[0])
        before = first_collision(poses[inside[inside < first_off]], footprint, costmap) if first_off else -1
        return before if before >= 0 else first_off
    cells, owner = cells_of_lines(starts, ends)
    hit = owner[costmap.data[cells[:, 1], cells[:, 0]] >= LETHAL]
    return int(hit.min() // count) if hit.size else -1


def _chosen(asked: str, known: Mapping[str, NamedPlugin[Smoother]]) -> NamedPlugin[Smoother]:
    """The smoother of that name; the only one where none is named.

    Raises:
        InvalidSmoother: There is none.
    """
    if asked in known:
        return known[asked]
    if not asked and len(known) == 1:
        return next(iter(known.values()))
    raise InvalidSmoother(f"Invalid Smoother: {asked!r}; available: {', '.join(known)}")


def _failure(why: str, code: int) -> SmoothPath.Result:
    result = SmoothPath.Result()
    result.error_code = code
    if hasattr(result, "error_msg"):
        result.error_msg = why
    return result


def _with_headings(poses: FloatArray) -> FloatArray:
    """The poses, looking along the travel where nobody has given headings.

    Nav2's grid planners leave the identity in all poses but the last: as a heading that would be a path that slides
    sideways. A path is taken for such a one where all its poses but the last look the same way and a step leads
    elsewhere by more than 1 rad.
    """
    if len(poses) < 3 or not np.all(poses[:-1, 2] == poses[0, 2]):
        return poses
    step = np.diff(poses[:, :2], axis=0)
    moves = np.hypot(step[:, 0], step[:, 1]) > 0.0
    travel = np.arctan2(step[:, 1], step[:, 0])
    aside = np.abs(np.sin(travel - poses[0, 2]))[moves]
    if not aside.size or aside.max() <= math.sin(_NO_HEADING):
        return poses
    out: FloatArray = poses.copy()
    out[:-1, 2] = np.where(moves, travel, out[:-1, 2])
    return out


def _spacing(poses: FloatArray) -> float:
    """The mean spacing of poses, within reason [m]."""
    length = float(np.hypot(*np.diff(poses[:, :2], axis=0).T).sum())
    return min(max(length / max(len(poses) - 1, 1), _SPACINGS[0]), _SPACINGS[1])


def _cropped(
    costmap: Costmap, poses: FloatArray, footprint: Footprint | None, clearance: ClearanceRule | None
) -> Costmap:
    """The part of a costmap around a path; what lies beyond its edge counts as obstacles, as beyond the map's.

    A cost of what is far away: the cells of a hall are looked at for every new costmap, and each is an obstacle.
    """
    reach = _AROUND + (footprint.circumscribed_radius if footprint is not None else 0.0)
    reach += clearance.required if clearance is not None else 0.0
    size = np.array([costmap.columns, costmap.rows])
    first = np.clip(costmap.cell_of(poses[:, :2].min(axis=0, keepdims=True) - reach)[0], 0, size - 1)
    last = np.clip(costmap.cell_of(poses[:, :2].max(axis=0, keepdims=True) + reach)[0], 0, size - 1)
    if np.array_equal(first, (0, 0)) and np.array_equal(last, size - 1):
        return costmap
    x, y = (np.array(costmap.origin) + first * costmap.resolution).tolist()
    window = costmap.data[first[1] : last[1] + 1, first[0] : last[0] + 1]
    return Costmap(window, costmap.resolution, (x, y))


def main() -> int:
    """The console script."""
    return run(SmootherServer)
