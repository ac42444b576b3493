"""What the smoother server and the planner server share: plugins, what is known of the surroundings, a worker."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar, overload

import numpy as np
from nav_msgs.msg import Path as PathMessage
from pydantic import Field

from optdock import ros
from optdock.model.costmap import Costmap
from optdock.model.path import Path, PolylineSegment
from optdock.model.problem import ClearanceRule
from optdock.plugins.lifecycle import Plugin
from optdock_ros.frame_lookup import TransformBuffer
from optdock_ros.goals import GoalAction, JobEnded, Worker
from optdock_ros.nested_parameters import (
    Faults,
    RobotParameters,
    ServerParameters,
    clearance_parameters,
    declare,
    robot_parameters,
    undeclare,
)
from optdock_ros.plugins import NamedPlugin, named_plugins
from optdock_ros.server import Server
from optdock_ros.surroundings import CostmapTopic, FootprintTopic, SurroundingsError, now

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from optdock.geometry.arrays import FloatArray
    from optdock.geometry.footprint import Footprint
    from optdock.model.robot import Robot
    from optdock_ros.goals import WorkerJob

__all__ = [
    "PluginServer",
    "PluginServerParameters",
    "ServerSettings",
    "compact_path",
    "cropped",
    "failed",
    "poses_of",
]

P = TypeVar("P", bound=Plugin)


class PluginServerParameters(ServerParameters):
    """Nav2's names and defaults; `costmap_timeout` is ours."""

    costmap_topic: str = Field("global_costmap/costmap_raw", description="costmap, nav2_msgs/Costmap; empty: none")
    footprint_topic: str = Field("global_costmap/published_footprint", description="outline of the robot; empty: none")
    robot_base_frame: str = Field("base_link", min_length=1, description="the robot's own frame")
    transform_tolerance: float = Field(0.1, ge=0, description="how old a transform may be [s]")
    action_server_result_timeout: float = Field(10.0, gt=0, description="how long results are kept [s]")
    costmap_timeout: float = Field(0.0, ge=0, description="oldest costmap that is believed; 0: any, as Nav2 [s]")


@dataclass(frozen=True)
class ServerSettings(Generic[P]):
    """What the parameters of the server mean.

    Args:
        parameters: Those of the node itself.
        plugins: By the names of their instances.
        limits: The block `robot`, None where there is none.
        clearance: The block `clearance`, None where there is none.
    """

    parameters: Any
    plugins: Mapping[str, NamedPlugin[P]]
    limits: RobotParameters | None
    clearance: ClearanceRule | None

    @property
    def rule(self) -> ClearanceRule:
        """The clearance to be kept; none where the parameters name none."""
        return self.clearance if self.clearance is not None else ClearanceRule(0.0, 0.0, 0.0)

    def robot(self, footprint: Footprint) -> Robot:
        """The robot with this outline."""
        return (self.limits or robot_parameters({})).robot(footprint)


class PluginServer(Server[ServerSettings[P]], Generic[P]):
    """A server of plugins of one kind, with one worker for all it is asked for.

    Attributes:
        transforms: Where frames stand.
        worker: Does what is asked for, one after the other.
    """

    kind: ClassVar[str]
    """`smoother`, `planner`, ..., as in `smoother_plugins`."""
    interface: ClassVar[type[Plugin]]
    default_plugins: ClassVar[tuple[str, ...]]
    default_class: ClassVar[str]
    """Of the default plugins where the parameters name none, as Nav2 has it."""
    fixed = frozenset({"costmap_topic", "footprint_topic", "robot_base_frame", "action_server_result_timeout"})

    transforms: TransformBuffer
    worker: Worker

    def __init__(self, name: str, **kwargs: Any) -> None:
        super().__init__(name, **kwargs)
        self._costmap: CostmapTopic | None = None
        self._footprint: FootprintTopic | None = None
        self._ends: list[Callable[[], object]] = []

    def check(self, block: dict[str, object]) -> ServerSettings[P]:
        """As `Server.check`.

        Raises:
            InvalidValue: What is wrong with any of the parameters, one line per fault.
        """
        given = block.get(f"{self.kind}_plugins", list(self.default_plugins))
        names = tuple(map(str, given)) if isinstance(given, list | tuple) else ()
        if names == self.default_plugins:
            own = block.get(names[0], {})
            block = {**block, names[0]: {"plugin": self.default_class, **own}} if isinstance(own, dict) else block
        interface: type[P] = self.interface  # type: ignore[assignment]  # a subclass names the one of P
        plugins, lines = named_plugins(self.get_name(), self.kind, interface, names, block)
        faults = Faults(lines)
        parameters = faults.attempt(lambda: self.own_parameters(block, (*names, "robot", "clearance")))
        limits = faults.attempt(lambda: robot_parameters(block["robot"]) if "robot" in block else None)
        clearance = faults.attempt(lambda: clearance_parameters(block["clearance"]) if "clearance" in block else None)
        faults.look()
        return ServerSettings(parameters, plugins, limits, clearance)

    def set_up(self) -> None:
        """Subscribe, and make the worker; whatever is made is noted, to be given back."""
        told = self.settings.parameters
        for plugin in self.settings.plugins.values():
            added = declare(self, plugin.plugin_class.Parameters, f"{plugin.name}.")
            # Or they would be unknown parameters of another class that takes its place after a cleanup.
            self._ends.append(partial(undeclare, self, added))
            self.get_logger().info(f"Created {self.kind}: {plugin.name} of type {plugin.choice.name}")
            if plugin.not_read:
                self.get_logger().info(f"{plugin.name}: not read: {', '.join(plugin.not_read)}")
        self.transforms = TransformBuffer(self)
        self._ends.append(self.transforms.close)
        if told.costmap_topic:
            self._costmap = CostmapTopic(self, told.costmap_topic)
            self._ends.append(self._costmap.close)
        else:
            self.get_logger().warning("costmap_topic is empty: nothing is known of obstacles")
        if told.footprint_topic:
            base, tolerance = told.robot_base_frame, told.transform_tolerance
            self._footprint = FootprintTopic(self, told.footprint_topic, self.transforms, base, tolerance)
            self._ends.append(self._footprint.close)
        self.worker = Worker(f"{self.get_name()} goals")
        self._ends.append(self._close_worker)

    def changed(self, before: ServerSettings[P]) -> None:  # noqa: ARG002 - whatever it was
        """What was made at configure reads the new settings; the rest is read by every goal."""
        if self._footprint is not None:
            self._footprint.tolerance = self.settings.parameters.transform_tolerance

    def offer(self, kind: Any, name: str, work: Callable[[Any, WorkerJob], tuple[Any, bool]]) -> None:
        """Offer an action, whose goals the worker does."""

        def _ended(why: str) -> Any:
            return failed(kind.Result(), why, 0)

        def _work(goal: Any, job: WorkerJob) -> tuple[Any, bool]:
            try:
                return work(goal, job)
            except JobEnded:
                raise
            except BaseException as error:  # foreign code may raise anything, SystemExit too
                self.say(error, name)
                return failed(kind.Result(), f"{type(error).__name__}: {error}", kind.Result.UNKNOWN), False

        action = GoalAction(
            self,
            kind,
            name,
            worker=self.worker,
            work=_work,
            ended=_ended,
            is_open=lambda: self.is_active,
            result_timeout=self.settings.parameters.action_server_result_timeout,
        )
        self._ends.append(action.close)

    def path_publisher(self, topic: str) -> Any:
        """A publisher of paths, which are heard while the server is active."""
        publisher = self.create_lifecycle_publisher(PathMessage, topic, 1)
        self._ends.append(lambda: self.destroy_lifecycle_publisher(publisher))
        return publisher

    def start(self) -> None:
        """Build and load in advance what would make the first goal slower than the next."""
        # Solvers belong to the thread that made them.
        self.worker.do(self.warm_up)

    def warm_up(self) -> None:
        """In the worker's thread, before the first goal: the first message of a kind loads its type support."""
        ros.path_poses(ros.path_message(ros.imported, np.zeros((1, 3)), "map", 0.0))

    def stop(self) -> None:
        """End what the worker is at."""
        if not self.worker.end_all("the server was deactivated"):
            self.get_logger().error(f"a {self.kind} does not end its work; its goal is given up")

    def tear_down(self) -> None:
        """Take the actions away, then the thread, then what it worked with."""
        while self._ends:
            self._ends.pop()()
        self._costmap = self._footprint = None

    def _close_worker(self) -> None:
        if not self.worker.close():
            self.get_logger().error(f"a {self.kind} does not end; its thread is left behind")

    # What a goal asks for, in the worker's thread.

    def chosen(self, asked: str, settings: ServerSettings[P]) -> NamedPlugin[P] | None:
        """The plugin of that name; the only one where none is named; else None."""
        known = settings.plugins
        if not asked and len(known) == 1:
            return next(iter(known.values()))
        return known.get(asked)

    def newest_costmap(self, settings: ServerSettings[P]) -> ros.StampedCostmap | None:
        """What is known of the surroundings; None where the parameters name no topic.

        Raises:
            SurroundingsError: Nothing has come, it is none, or it is too old.
        """
        if self._costmap is None:
            return None
        seen = self._costmap.newest()
        self._check_age(self._costmap.topic, seen.stamp, settings)
        return seen

    def outline(self, settings: ServerSettings[P]) -> Footprint | None:
        """The robot's outline: of the parameters, or of the topic; None where nothing has come.

        Raises:
            OptdockError: What came is not an outline, is too old, or was published in an unknown frame.
        """
        if settings.limits is not None and settings.limits.footprint is not None:
            return settings.limits.footprint
        if self._footprint is None or not self._footprint.is_heard:
            return None
        footprint, stamp = self._footprint.newest()
        self._check_age(self._footprint.topic, stamp, settings)
        return footprint

    def no_footprint(self, settings: ServerSettings[P]) -> SurroundingsError:
        """What to say where the outline is needed."""
        topic = settings.parameters.footprint_topic
        return SurroundingsError(f"{topic or 'footprint_topic'}: no footprint yet; or give robot.footprint")

    def _check_age(self, topic: str, stamp: float, settings: ServerSettings[P]) -> None:
        age, most = now(self) - stamp, settings.parameters.costmap_timeout
        if 0.0 < most < abs(age):
            # One from the future would count as new for as long as the clocks differ.
            said = f"is {age:.2f} s old" if age > 0.0 else f"is dated {-age:.2f} s into the future"
            where = {"topic": topic, "age": age}
            raise SurroundingsError(f"{topic}: {said}, more than costmap_timeout = {most:g} s", where=where)


def failed(result: Any, why: str, code: int) -> Any:
    """A result that says why there is none; older distributions have no field for the words."""
    result.error_code = code
    if hasattr(result, "error_msg"):
        result.error_msg = why
    return result


class _Poses(Sequence[Any]):
    """Poses of a message that are made when they are looked at.

    An action server keeps every result for seconds. As messages, 200 poses are 800 objects, and collections of garbage
    that look at all of them stop all threads for tens of milliseconds; as numbers they are one.
    """

    def __init__(self, poses: FloatArray, frame: str, stamp: float) -> None:
        self._poses, self._frame, self._stamp = poses, frame, stamp

    def __len__(self) -> int:
        return len(self._poses)

    @overload
    def __getitem__(self, index: int) -> Any: ...
    @overload
    def __getitem__(self, index: slice) -> list[Any]: ...
    def __getitem__(self, index: int | slice) -> Any:
        return self._made()[index]

    def __iter__(self) -> Iterator[Any]:
        return iter(self._made())

    def _made(self) -> list[Any]:
        made: list[Any] = ros.path_message(ros.imported, self._poses, self._frame, self._stamp).poses
        return made


def compact_path(poses: FloatArray, frame: str, stamp: float) -> PathMessage:
    """A nav_msgs/Path for the result of an action, which is kept for a while.

    Args:
        poses: Shape (n, 3).
        frame: In which they stand.
        stamp: Of all of them [s].

    Raises:
        InvalidValue: As `optdock.ros.path_message`.
    """
    message: PathMessage = ros.path_message(ros.imported, poses[:0], frame, stamp)
    message.poses = _Poses(poses, frame, stamp)
    return message


def poses_of(path: Path, spacing: float) -> FloatArray:
    """The poses to tell of a path, Shape (n, 3): those of a polyline, of a curve some.

    Args:
        path: Any.
        spacing: Of the poses of a curve [m].
    """
    blocks = [
        segment.poses if isinstance(segment, PolylineSegment) else Path((segment,)).sample(spacing).poses
        for segment in path.segments
    ]
    # At a cusp one segment ends where the next begins; a controller has no use for a step of no length.
    return np.vstack([blocks[0], *(block[1:] for block in blocks[1:])])


def cropped(costmap: Costmap, poses: FloatArray, reach: float) -> Costmap:
    """The part of a costmap around poses; what lies beyond its edge counts as obstacles, as beyond the map's.

    Every cell of a hall would be looked at for every new costmap, and those far away do not matter.

    Args:
        costmap: All of it.
        poses: Shape (n, 3).
        reach: How far around them [m].
    """
    size = np.array([costmap.columns, costmap.rows])
    first = np.clip(costmap.cell_of(poses[:, :2].min(axis=0, keepdims=True) - reach)[0], 0, size - 1)
    last = np.clip(costmap.cell_of(poses[:, :2].max(axis=0, keepdims=True) + reach)[0], 0, size - 1)
    if np.array_equal(first, (0, 0)) and np.array_equal(last, size - 1):
        return costmap
    x, y = (np.array(costmap.origin) + first * costmap.resolution).tolist()
    window = costmap.data[first[1] : last[1] + 1, first[0] : last[0] + 1]
    return Costmap(window, costmap.resolution, (x, y))
