"""A docking out of a recording from a robot: what was planned, what was driven, and among what, in one frame."""

from __future__ import annotations

import itertools
import math
from contextlib import contextmanager
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.errors import InvalidFile, InvalidValue
from optdock.geometry.arrays import FloatArray, readonly
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2, transform_poses, unwrap_yaw
from optdock.ros.grids import costmap, patched
from optdock.ros.messages import seconds
from optdock.ros.motion import footprint, odometry, path_poses
from optdock.ros.transforms import TransformError, TransformTree

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from optdock.model.costmap import Costmap
    from optdock.model.costs import OccupancyRule
    from optdock.ros.bag import BagRecording
    from optdock.ros.messages import Message

__all__ = ["FieldDocking", "FieldOptions", "FieldTopics", "RecordedDrive", "field_docking", "kept_poses"]

_PATH = ("nav_msgs/msg/Path",)
_GRID = ("nav2_msgs/msg/Costmap", "nav_msgs/msg/OccupancyGrid")
_UPDATE = ("nav2_msgs/msg/CostmapUpdate", "map_msgs/msg/OccupancyGridUpdate")
_POLYGON = ("geometry_msgs/msg/PolygonStamped",)
_ODOMETRY = ("nav_msgs/msg/Odometry",)
_TRANSFORMS = ("tf2_msgs/msg/TFMessage",)

# Poses of a drive that are kept: far enough apart that millimetres of noise are no turns, near enough that what lies
# between them is straight to a millimetre.
_APART, _TURNED = 0.05, 0.1  # [m], [rad]
_REVERSED = 0.01  # [m] that a robot comes back before that is a gear of its own
_OUTLINES = 200  # footprint messages that are compared, and up to twice as many
_AT_ONCE = 100  # updates of a costmap that cost one copy of it
_AROUND = 1.0  # [s] of transforms beside the stretch, for times between them
# [s] by which a transform may be asked for beyond what is known of it: localization sends one in ten control cycles.
_REACH = 0.2
_BASE = "base_link"  # Nav2's default


class FieldTopics(NamedTuple):
    """Which topics to read: of each kind the first that is there; one alone must be there.

    The defaults are the names of Nav2's nodes.
    """

    path: tuple[str, ...] = ("/docking_trajectory", "/plan_smoothed", "/plan")
    costmap: tuple[str, ...] = (
        "/global_costmap/costmap_raw",
        "/local_costmap/costmap_raw",
        "/global_costmap/costmap",
        "/local_costmap/costmap",
        "/map",
    )
    footprint: tuple[str, ...] = ("/local_costmap/published_footprint", "/global_costmap/published_footprint")
    odometry: tuple[str, ...] = ("/odom", "/odometry/filtered")
    tf: str = "/tf"
    tf_static: str = "/tf_static"

    def instead(self, asked: Mapping[str, str]) -> FieldTopics:
        """The same with single topics where one is asked for by name; an empty name asks for nothing."""
        return self._replace(**{kind: (topic,) for kind, topic in asked.items() if topic})  # type: ignore[arg-type]


class RecordedDrive(NamedTuple):
    """Where the robot was: times, Shape (n,), since the beginning of the recording [s], and poses, Shape (n, 3).

    `kept` are the rows that make a path of it.
    """

    times: FloatArray
    poses: FloatArray
    kept: tuple[int, ...]


class FieldDocking(NamedTuple):
    """A docking out of a recording, all in `frame`.

    Attributes:
        frame: The costmap's.
        costmap: What was known of the surroundings in the end.
        footprint: The robot's outline, in its own frame.
        path: The last path that was sent, Shape (n, 3); None where the recording has none.
        drive: What was driven; None where the recording has no odometry.
        rows: What was read where, in words.
    """

    frame: str
    costmap: Costmap
    footprint: Footprint
    path: FloatArray | None
    drive: RecordedDrive | None
    rows: tuple[tuple[str, str], ...]


class FieldOptions(NamedTuple):
    """What is known of a recording beside itself.

    Attributes:
        outline: The robot's; None: that of the recording, taken back from where the robot stood.
        base_frame: The robot's frame; empty: the child frame of the odometry, or `base_link`.
        rule: How occupancies become costs; None for the defaults.
        since: Leave out what was received earlier, since the beginning of the recording [s].
        until: Leave out what was received later, likewise.
    """

    outline: Footprint | None = None
    base_frame: str = ""
    rule: OccupancyRule | None = None
    since: float = 0.0
    until: float = math.inf


def field_docking(bag: BagRecording, topics: FieldTopics, options: FieldOptions) -> FieldDocking:
    """The content of a recording of a docking.

    Path, costmap and outline are the last ones in the stretch that is asked for; the costmap with its updates.

    Args:
        bag: The recording.
        topics: Where to look.
        options: What else is known.

    Raises:
        InvalidFile: A topic is missing, empty, of another type or damaged, a message breaks a rule, or frames are not
            joined; the message names file and topic.
    """
    return _RecordingReader(bag, topics, options).read()


class _RecordingReader:
    """Reads one recording; every error names file and topic."""

    def __init__(self, bag: BagRecording, topics: FieldTopics, options: FieldOptions) -> None:
        self._bag, self._topics, self._options, self._base = bag, topics, options, options.base_frame
        self._stretch = bag.begin + options.since, bag.begin + options.until
        self._rows: list[tuple[str, str]] = []
        self._transforms = TransformTree(reach=_REACH)
        self._times: list[tuple[float, float]] = []  # of the odometry: received, stamp
        self._out_of_reach = ""

    def read(self) -> FieldDocking:
        """Everything, in the frame of the costmap."""
        topics = self._topics
        odom = self._find(topics.odometry, _ODOMETRY, "--odom-topic")
        planned = self._find(topics.path, _PATH, "--path-topic")
        if not (odom or planned):
            names, option = (*topics.path, *topics.odometry), "--path-topic, --odom-topic"
            raise InvalidFile(self._none_of(names, (*_PATH, *_ODOMETRY), option))
        grid = self._find(topics.costmap, _GRID, "--costmap-topic")
        if not grid:
            raise InvalidFile(self._none_of(topics.costmap, _GRID, "--costmap-topic"))
        self._note_transforms()
        self._note_odometry(odom)
        frame, known = self._costmap(grid)
        path = self._path(planned, frame) if planned else None
        drive = self._drive(odom, frame) if odom else None
        found = self._options.outline or self._footprint()
        return FieldDocking(frame, known, found, path, drive, tuple(self._rows))

    def _find(self, names: tuple[str, ...], kinds: tuple[str, ...], option: str) -> str:
        """The first topic that is there; empty where none is, and none was asked for by name."""
        found = self._bag.find(names, kinds, option)
        if not found and len(names) == 1:
            raise InvalidFile(f"{self._bag.source}: has no topic {names[0]} ({option}); {self._bag.of_kind(kinds)}")
        return found

    def _none_of(self, names: tuple[str, ...], kinds: tuple[str, ...], option: str) -> str:
        return f"{self._bag.source}: has none of the topics {', '.join(names)} ({option}); {self._bag.of_kind(kinds)}"

    @contextmanager
    def _said_of(self, topic: str) -> Iterator[None]:
        """Raise errors of a message with file and topic."""
        try:
            yield
        except (InvalidValue, TransformError) as error:
            raise InvalidFile(f"{self._bag.source}: {topic}: {error}") from error

    def _nothing(self, topic: str, what: str = "no message") -> InvalidFile:
        first, last = (f"{max(time - self._bag.begin, 0.0):.3f}" for time in self._stretch)
        length = f"{self._bag.end - self._bag.begin:.3f}"
        return InvalidFile(
            f"{self._bag.source}: {topic}: holds {what} from {first} s to {last} s of {length} s (--since, --until)"
        )

    def _ago(self, time: float) -> str:
        return f"{time - self._bag.begin:.3f} s"

    def _note_transforms(self) -> None:
        begin, end = self._stretch
        for topic, since, always in ((self._topics.tf_static, 0.0, True), (self._topics.tf, begin - _AROUND, False)):
            if self._bag.find((topic,), _TRANSFORMS):
                for _, message in self._bag.messages(topic, since, end + _AROUND):
                    for one in message.transforms:
                        self._transforms.insert(one, is_static=always)

    def _note_odometry(self, topic: str) -> None:
        """Its times; and its poses where no transform says the same."""
        is_needed = None
        for received, message in self._bag.messages(topic, *self._stretch) if topic else ():
            with self._said_of(topic):
                found = odometry(message)
            child = found.child_frame.lstrip("/") or self._base or _BASE
            if is_needed is None:
                is_needed, self._base = child not in self._transforms.frames, self._base or child
            if is_needed:
                at, turn = message.pose.pose.position, message.pose.pose.orientation
                place, turned = (at.x, at.y, at.z), (turn.x, turn.y, turn.z, turn.w)
                self._transforms.put(found.frame, child, found.stamp, place, turned)
            self._times.append((received - self._bag.begin, found.stamp))
        if topic and not self._times:
            raise self._nothing(topic)
        self._base = self._base or _BASE

    def _costmap(self, topic: str) -> tuple[str, Costmap]:
        """The last whole costmap with every update after it, and its frame."""
        last = self._bag.last(topic, *self._stretch)
        if last is None:
            raise self._nothing(topic)
        received, message = last
        with self._said_of(topic):
            known = costmap(message, self._options.rule)
        updates, count = f"{topic}_updates", 0
        if self._bag.find((updates,), _UPDATE):
            parts = (update for _, update in self._bag.messages(updates, received, self._stretch[1]))
            while some := tuple(itertools.islice(parts, _AT_ONCE)):
                with self._said_of(updates):
                    known, count = patched(known, *some, rule=self._options.rule), count + len(some)
        grid, frame = known.costmap, known.frame.lstrip("/")
        more = f" and {count} updates" if count else ""
        cells = f"{grid.columns} x {grid.rows} cells of {grid.resolution:g} m in {frame!r}"
        self._rows.append(("costmap", f"{topic}: {cells}, received at {self._ago(received)}{more}"))
        return frame, grid

    def _path(self, topic: str, frame: str) -> FloatArray:
        """The last path that has poses, in a frame."""
        last = None
        for received, message in self._bag.messages(topic, *self._stretch):
            last = (received, message) if len(message.poses) else last
        if last is None:
            raise self._nothing(topic, "no path with poses")
        with self._said_of(topic):
            found = path_poses(last[1])
            # A stamp of zero stands for the newest transform.
            stamp = found.stamp or (self._times[-1][1] if self._times else 0.0)
            moved = self._in_frame(frame, found.frame.lstrip("/"), stamp)
        self._rows.append(("path", f"{topic}: {len(found.poses)} poses, received at {self._ago(last[0])}"))
        return readonly(transform_poses(moved, found.poses))

    def _drive(self, topic: str, frame: str) -> RecordedDrive:
        """Where the robot was at the times of the odometry, as far as transforms reach."""
        rows, length = list[tuple[float, ...]](), len(self._times)
        for received, stamp in self._times:
            stood = self._placed(frame, self._base, stamp)
            if stood is not None:
                rows.append((received, stood.x, stood.y, stood.yaw))
        if not rows:
            raise InvalidFile(self._out_of_reach)
        table = np.array(rows)
        left_out = f"; {length - len(rows)} left out, as {self._out_of_reach}" if len(rows) < length else ""
        span = f"{table[0, 0]:.3f} s to {table[-1, 0]:.3f} s"
        self._rows.append(("drive", f"{topic}: {len(rows)} poses of {self._base!r}, {span}{left_out}"))
        poses = readonly(np.array(table[:, 1:]))
        return RecordedDrive(readonly(np.array(table[:, 0])), poses, kept_poses(poses))

    def _in_frame(self, target: str, source: str, stamp: float) -> Pose2:
        if target == source:
            return Pose2(0.0, 0.0, 0.0)
        return self._transforms.lookup(target, source, stamp).planar()

    def _placed(self, target: str, source: str, stamp: float) -> Pose2 | None:
        """As `_in_frame`; None where transforms do not reach, and why is kept."""
        try:
            found = self._transforms.lookup(target, source, stamp)
        except TransformError as error:
            self._out_of_reach = f"{self._bag.source}: {self._topics.tf}: {error}"
            return None
        with self._said_of(self._topics.tf):
            return found.planar()

    def _some(self, topic: str) -> list[Message]:
        """Messages of a topic, evenly spread over the stretch: `_OUTLINES` to twice as many, or all of fewer."""
        found: list[Message] = []
        every = 1
        for number, (_, message) in enumerate(self._bag.messages(topic, *self._stretch)):
            if number % every == 0:
                found.append(message)
            if len(found) == 2 * _OUTLINES:
                found, every = found[::2], 2 * every
        return found

    def _footprint(self) -> Footprint:
        """The outline in the robot's frame: the median of many, as each is only where the robot was to a tick."""
        topic = self._find(self._topics.footprint, _POLYGON, "--footprint-topic")
        if not topic:
            raise InvalidFile(
                self._none_of(self._topics.footprint, _POLYGON, "--footprint-topic")
                + "; or give the outline by --footprint or --radius"
            )
        messages = self._some(topic)
        if not messages:
            raise self._nothing(topic)
        outlines = []
        for message in messages:
            with self._said_of(topic):
                stamp = seconds(message.header.stamp)
            stood = self._placed(message.header.frame_id.lstrip("/"), self._base, stamp)
            if stood is not None:
                with self._said_of(topic):
                    outlines.append(footprint(message, stood).footprint.vertices)
        if not outlines:
            raise InvalidFile(self._out_of_reach)
        alike = [outline for outline in outlines if len(outline) == len(outlines[-1])]
        with self._said_of(topic):
            found = Footprint(np.median(np.array(alike), axis=0))
        self._rows.append(
            ("footprint", f"{topic}: {found.length:.3f} m x {found.width:.3f} m, of {len(alike)} messages")
        )
        return found


def kept_poses(poses: FloatArray) -> tuple[int, ...]:
    """Rows of measured poses, Shape (n, 3), that make a path: some centimetres apart, both ends, every reversal."""
    yaw = unwrap_yaw(poses[:, 2])
    step = np.diff(poses[:, :2], axis=0)
    middle = 0.5 * (yaw[1:] + yaw[:-1])
    ahead = np.concatenate(([0.0], np.cumsum(step[:, 0] * np.cos(middle) + step[:, 1] * np.sin(middle))))
    forced = {*_reversals(ahead), len(poses) - 1}
    kept = [0]
    for row in range(1, len(poses)):
        apart = math.hypot(*(poses[row, :2] - poses[kept[-1], :2]).tolist())
        is_far = apart >= _APART or abs(yaw[row] - yaw[kept[-1]]) >= _TURNED
        if row in forced and not is_far and len(kept) > 1 and kept[-1] not in forced:
            kept.pop()
        if row in forced or is_far:
            kept.append(row)
    return tuple(kept)


def _reversals(ahead: FloatArray) -> list[int]:
    """Rows at which the way driven forward, Shape (n,) [m], turns around by more than noise does."""
    found, trend, low, high = list[int](), 0, 0, 0
    for row, way in enumerate(ahead.tolist()):
        high, low = (row if way > ahead[high] else high), (row if way < ahead[low] else low)
        if trend >= 0 and way < ahead[high] - _REVERSED:
            found += [high] if trend else []
            trend, low = -1, row
        elif trend <= 0 and way > ahead[low] + _REVERSED:
            found += [low] if trend else []
            trend, high = 1, row
    return found
