"""`smoother_server`: Nav2's action `smooth_path` with the smoothers of this library.

Parameters, topics, action and error codes are those of Nav2's server. In addition a path in another frame than that of
the costmap is transformed, the limits of the robot (`robot`) and a clearance (`clearance`) can be set, an old costmap
is rejected (`costmap_timeout`), cancelling takes milliseconds, and `check_for_collisions` checks certificates again.
"""

from __future__ import annotations

import math
import sys
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any

import numpy as np
from nav2_msgs.action import SmoothPath
from nav_msgs.msg import Path as PathMessage
from pydantic import Field
from rclpy.duration import Duration

from optdock import ros
from optdock.errors import Cancelled, InvalidPath, InvalidValue, OptdockError, SmootherException
from optdock.geometry.pose import Pose2, transform_poses
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.dock import Dock
from optdock.model.path import Path, PolylineSegment, may_be_one_frame
from optdock.model.problem import DockingProblem
from optdock.nav2.declared_parameters import Block
from optdock.nav2.params import Nav2Params
from optdock.nav2.plugin_lists import PluginInstance
from optdock.nav2.provided_plugins import provided
from optdock.plugins.interfaces import PluginContext, Smoother
from optdock.plugins.outcomes import SmoothingResult
from optdock.plugins.parameters import parse_parameters
from optdock.plugins.registry import PluginChoice, create_plugin, load_plugin
from optdock.verification import certify_path
from optdock_ros.frame_lookup import TransformBuffer, now
from optdock_ros.goal_queue import Goal, GoalAction, GoalOutcome, GoalQueue, done, failed
from optdock_ros.merged_costmap import cropped
from optdock_ros.nested_parameters import (
    BlockReader,
    RobotParameters,
    ServerParameters,
    clearance_parameters,
    declare,
    robot_parameters,
    undeclare,
)
from optdock_ros.server import Server, run
from optdock_ros.surroundings import CostmapTopic, FootprintTopic, SurroundingsError, first_collision

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from optdock.geometry.arrays import FloatArray
    from optdock.geometry.footprint import Footprint
    from optdock.model.costmap import Costmap

__all__ = ["SmootherServer", "SmootherServerParameters", "SmoothingTask", "main"]

# [m]: extent of the costmap around path and robot that a smoother gets. Smoothers move a path by decimetres; its border
# is an obstacle.
_AROUND = 2.0
_DEFAULT = "simple_smoother"  # Nav2's default plugin, and its class
_DEFAULT_CLASS = "nav2_smoother::SimpleSmoother"
_SPACINGS = 0.01, 0.1  # [m]: bounds on the spacing of the poses of a curve
_END_TOLERANCE = 1e-3  # [m]: above rounding errors
_NO_HEADING = 1.0  # [rad] between heading and travel: larger than in any step of a raw path
_JOIN = 5.0  # [s] for a smoother to return once its goal is ended; those of this library check every 5 ms


class InvalidSmoother(SmootherException):
    """The goal names an unknown smoother."""

    code = 501


class SmoothedPathInCollision(SmootherException):
    """The smoothed path is in collision."""

    code = 503


class SmootherServerParameters(ServerParameters):
    """Nav2's names and defaults, and `costmap_timeout`."""

    costmap_topic: str = Field(
        "global_costmap/costmap_raw", description="topic of the costmap, nav2_msgs/Costmap; empty: none"
    )
    footprint_topic: str = Field(
        "global_costmap/published_footprint", description="topic of the robot's footprint; empty: none"
    )
    robot_base_frame: str = Field("base_link", min_length=1, description="frame of the robot")
    transform_tolerance: float = Field(0.1, ge=0, description="largest age of a transform [s]")
    action_server_result_timeout: float = Field(10.0, gt=0, description="time for which results are kept [s]")
    costmap_timeout: float = Field(0.0, ge=0, description="largest age of the costmap; 0: unlimited, as in Nav2 [s]")
    smoother_plugins: tuple[str, ...] = Field((_DEFAULT,), description="names of the smoothers")


@dataclass(frozen=True)
class NamedSmoother:
    """A smoother of the parameters, with hints for those that are not read; a new instance is made for each goal."""

    name: str
    choice: PluginChoice
    not_read: tuple[str, ...] = ()

    def made(self) -> Smoother:
        """Return a new instance."""
        return create_plugin(Smoother, self.choice.name, self.choice.parameters)

    @contextmanager
    def active(self, context: PluginContext) -> Iterator[Smoother]:
        """Return a new instance, configured and active, and shut it down at the end."""
        plugin = self.made()
        try:
            plugin.configure(context)
            plugin.activate()
            yield plugin
        finally:
            plugin.shutdown()


@dataclass(frozen=True)
class SmootherSettings:
    """The validated parameters of the server; None for a block that is missing."""

    own: SmootherServerParameters
    plugins: Mapping[str, NamedSmoother]
    robot: RobotParameters | None
    clearance: ClearanceRule | None


@dataclass(frozen=True, eq=False)
class SmoothingTask:
    """A path to smooth, and the robot and its surroundings.

    Args:
        path: Path in the frame of the costmap.
        problem: Constraints on the path; None if neither robot nor clearance are given.
        footprint: Outline of the robot, or None.
        costmap: Part of the costmap around the path, or None.
        whole: The whole costmap, or None.
        frame: Frame of the goal's path.
        seen: Pose of that frame in the frame of the costmap. The inverse of its projection onto the plane transforms
            results back, even if the frame is tilted.
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
                hint = f"; its certified clearance is {proven:.3f} m, less than a cell of {side:g} m: require that much"
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


def _with_headings(poses: FloatArray) -> FloatArray:
    """Return poses, shape (n, 3), whose headings follow the travel if no headings were given.

    Nav2's grid planners leave the identity in all poses but the last one. Equal headings, except for the last one, are
    regarded as missing if a step has another direction, or if the last heading differs.
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


def _mean_spacing(poses: FloatArray) -> float:
    """Return the mean distance of consecutive poses, shape (n, 3), clipped to a practical range [m]."""
    length = float(np.hypot(*np.diff(poses[:, :2], axis=0).T).sum())
    return min(max(length / max(len(poses) - 1, 1), _SPACINGS[0]), _SPACINGS[1])


class SmootherServer(Server[SmootherSettings]):
    """The node."""

    Parameters = SmootherServerParameters
    place = Block.SMOOTHING
    fixed = frozenset(
        {
            *("costmap_topic", "footprint_topic", "robot_base_frame"),
            *("action_server_result_timeout", "smoother_plugins"),
        }
    )

    def __init__(self, name: str = "smoother_server", **kwargs: Any) -> None:
        super().__init__(name, **kwargs)
        self._parts = ExitStack()
        self._costmap: CostmapTopic | None = None
        self._footprint: FootprintTopic | None = None

    def check(self, block: dict[str, object]) -> SmootherSettings:
        """Return all parameters, as described for `Server.check`."""
        given = block.get("smoother_plugins", [_DEFAULT])
        names = tuple(map(str, given)) if isinstance(given, list | tuple) else ()
        if names == (_DEFAULT,):
            own = block.get(_DEFAULT, {})
            block = {**block, _DEFAULT: {"plugin": _DEFAULT_CLASS, **own}} if isinstance(own, dict) else block
        reader = BlockReader(block)
        plugins = _named_smoothers(reader, self.get_name(), names)
        parameters = reader.attempt(lambda: self.own_parameters(block, (*names, "robot", "clearance")), None)
        robot = reader.attempt(lambda: robot_parameters(block["robot"]) if "robot" in block else None, None)
        clearance = reader.attempt(
            lambda: clearance_parameters(block["clearance"]) if "clearance" in block else None, None
        )
        reader.check()
        assert isinstance(parameters, SmootherServerParameters)
        return SmootherSettings(parameters, plugins, robot, clearance)

    def set_up(self) -> None:
        """Create subscriptions, the publisher and the action server."""
        own, parts = self.settings.own, self._parts
        if own.smoother_plugins == (_DEFAULT,) and not self.get_parameters_by_prefix(_DEFAULT):
            self.get_logger().warning(f"smoother_plugins: is not set; the only smoother is {_DEFAULT_CLASS}")
        for plugin in self.settings.plugins.values():
            # Undeclared at the end: they would be unknown parameters of a class that is configured later.
            added = declare(self, load_plugin(Smoother, plugin.choice.name).Parameters, f"{plugin.name}.")
            parts.callback(undeclare, self, added)
            self.get_logger().info(f"Created smoother: {plugin.name} of type {plugin.choice.name}")
            if plugin.not_read:
                self.get_logger().info(f"{plugin.name}: not read: {', '.join(plugin.not_read)}")
        self._transforms = parts.enter_context(closing(TransformBuffer(self)))
        if own.costmap_topic:
            self._costmap = parts.enter_context(closing(CostmapTopic(self, own.costmap_topic)))
        else:
            self.get_logger().warning("costmap_topic is empty: obstacles are not checked")
        if own.footprint_topic:
            base, tolerance = own.robot_base_frame, own.transform_tolerance
            outline = FootprintTopic(self, own.footprint_topic, self._transforms, base, tolerance)
            self._footprint = parts.enter_context(closing(outline))
        self._publisher = self.create_lifecycle_publisher(PathMessage, "plan_smoothed", 1)
        parts.callback(self.destroy_lifecycle_publisher, self._publisher)
        action = GoalAction("smooth_path", self._smooth, 0)
        self._goals = GoalQueue(self, {SmoothPath: action}, own.action_server_result_timeout)
        parts.callback(self._goals.destroy)

    def changed(self) -> None:
        """Update the tolerance of the footprint's transforms; goals read all other settings."""
        if self._footprint is not None:
            self._footprint.tolerance = self.settings.own.transform_tolerance

    def start(self) -> None:
        """Warm up the smoothers in the thread that executes goals, to which solvers are bound; then accept goals."""
        self._goals.call(self._warm_up)
        self._goals.accept_goals()

    def _warm_up(self) -> None:
        ros.path_poses(ros.path_message(ros.imported, np.zeros((1, 3)), "map", 0.0))  # loads the type support
        for smoother in self.settings.plugins.values():
            smoother.made().warm_up()

    def stop(self) -> None:
        """End the goals."""
        self._goals.close("the server was deactivated")
        if not self._goals.join(_JOIN):
            self.get_logger().error("a smoother does not return; its goal is aborted")

    def tear_down(self) -> None:
        """Destroy everything that was created."""
        self._parts.close()
        self._costmap = self._footprint = None

    # Called in the thread of the goals.

    def _smooth(self, goal: Goal) -> GoalOutcome:
        try:
            return done(result=self._smoothed(goal))
        except Cancelled as error:
            goal.check_end()
            why, code = f"a smoother was cancelled without a request: {error}", SmootherException.code
        except OptdockError as error:
            why, code = str(error), error.code if 500 <= error.code <= 505 else SmootherException.code
        self.get_logger().error(why)
        return failed(code, why)

    def _smoothed(self, goal: Goal) -> SmoothPath.Result:
        began, settings, request, result = now(self), self.settings, goal.request, SmoothPath.Result()
        asked, known = request.smoother_id, settings.plugins
        smoother = next(iter(known.values())) if not asked and len(known) == 1 else known.get(asked)
        if smoother is None:
            raise InvalidSmoother(f"Invalid Smoother: {asked!r}; available: {', '.join(known)}")
        task = self._task(request.path, settings)
        request.path.poses = []  # rclpy keeps the request until the result expires
        seconds = request.max_smoothing_duration.sec + 1e-9 * request.max_smoothing_duration.nanosec
        with smoother.active(PluginContext(smoother.name, task.costmap, task.footprint)) as plugin:
            found = plugin.smooth(task.path, seconds, problem=task.problem, cancel_checker=goal.should_end)
        goal.check_end()
        task.check_answer(found, smoother.name)
        poses = task.poses_of(found.path)
        result.path = ros.path_message(ros.imported, transform_poses(task.seen.inverse(), poses), task.frame, began)
        result.was_completed = bool(found.completed)
        if self._publisher.get_subscription_count():  # saves half a millisecond
            self._publisher.publish(result.path)
        if request.check_for_collisions:
            task.check_collisions(poses, found)
        if not result.was_completed:
            self.get_logger().info(f"{smoother.name}: stopped after {seconds:g} s with an intermediate result")
        result.smoothing_duration = Duration(seconds=max(0.0, now(self) - began)).to_msg()
        return result

    def _task(self, message: PathMessage, settings: SmootherSettings) -> SmoothingTask:
        """Return the task of a goal; raise if its path is invalid, or messages are missing or too old."""
        if not message.poses:
            raise InvalidPath("path: has no poses")
        try:
            given = ros.path_poses(message)
        except InvalidValue as error:
            raise InvalidPath(str(error)) from error
        known = None
        if self._costmap is not None:
            known = self._costmap.newest()
            self._check_age(self._costmap.topic, known.stamp, settings)
        frame = given.frame if known is None else known.frame
        seen = Pose2(0.0, 0.0, 0.0)
        if frame.lstrip("/") != given.frame.lstrip("/"):
            tolerance = settings.own.transform_tolerance
            seen = self._transforms.lookup(frame, given.frame, now(self), tolerance).planar()
        poses = _with_headings(transform_poses(seen, given.poses))
        path, footprint = Path.from_poses(poses, frame), self._outline(settings)
        rule = settings.clearance or ClearanceRule(0.0, 0.0, 0.0)
        near = None
        if known is not None:
            reach = _AROUND + rule.required + (footprint.circumscribed_radius if footprint is not None else 0.0)
            low, high = poses[:, :2].min(axis=0) - reach, poses[:, :2].max(axis=0) + reach
            near = cropped(known.costmap, (*low.tolist(), *high.tolist()))
        problem = None
        if settings.robot is not None or settings.clearance is not None:
            if footprint is None:
                topic = settings.own.footprint_topic or "footprint_topic"
                raise SurroundingsError(f"{topic}: no footprint yet; or give robot.footprint")
            robot = (settings.robot or robot_parameters({})).robot(footprint)
            problem = DockingProblem(path.start, Dock(path.end), robot, (), rule, costmap=near, frame=frame)
        whole = None if known is None else known.costmap
        return SmoothingTask(path, problem, footprint, near, whole, given.frame, seen, _mean_spacing(poses))

    def _outline(self, settings: SmootherSettings) -> Footprint | None:
        """Return the outline of the parameters or of the topic; None if no message has been received."""
        if settings.robot is not None and settings.robot.footprint is not None:
            return settings.robot.footprint
        if self._footprint is None or not self._footprint.is_heard:
            return None
        footprint, stamp = self._footprint.newest()
        self._check_age(self._footprint.topic, stamp, settings)
        return footprint

    def _check_age(self, topic: str, stamp: float, settings: SmootherSettings) -> None:
        """Raise `SurroundingsError` for a stamp that is too old, or too far in the future."""
        age, most = now(self) - stamp, settings.own.costmap_timeout
        if 0.0 < most < abs(age):
            fault = f"is {age:.2f} s old" if age > 0.0 else f"is dated {-age:.2f} s into the future"
            where = {"topic": topic, "age": age}
            raise SurroundingsError(f"{topic}: {fault}, more than costmap_timeout = {most:g} s", where=where)


def _named_smoothers(reader: BlockReader, node: str, names: tuple[str, ...]) -> dict[str, NamedSmoother]:
    """Return the smoothers of the list `smoother_plugins`.

    Unknown parameters of Nav2's classes are ignored, because Nav2's files contain them; those of plugin names of this
    library are faults.
    """
    params = Nav2Params(FilePath(), {node: dict(reader.block)}, (), {}, {}, {})
    found: dict[str, NamedSmoother] = {}
    if not names:
        reader.faults.append("smoother_plugins: must name at least one plugin")
    for name in dict.fromkeys(names):
        if names.count(name) > 1:
            reader.faults.append(f"smoother_plugins: names {name} more than once")
        own = reader.block.get(name)
        kind = own.get("plugin") if isinstance(own, dict) else None
        if not isinstance(own, dict) or not isinstance(kind, str):
            reader.faults.append(f"{name}.plugin: is required: smoother_plugins lists {name}")
            continue
        rest = {key: value for key, value in own.items() if key != "plugin"}
        answer = provided(PluginInstance(node, "smoother", name, kind, rest, (name,), 0), params)
        count = len(reader.faults)
        if not {":", "/"} & set(kind) and (answer.unknown or answer.refused):
            reader.attempt(partial(parse_parameters, load_plugin(Smoother, kind).Parameters, rest, name), None)
        if len(reader.faults) > count:
            continue
        if answer.plugin is None:
            reader.faults.append(f"Failed to create smoother {name} of type {kind}: {answer.outcome}")
        found[name] = NamedSmoother(name, PluginChoice(kind, dict(answer.taken)), answer.unknown)
    return found


def main() -> int:
    """Run the console script."""
    return run(SmootherServer)


if __name__ == "__main__":
    sys.exit(main())
