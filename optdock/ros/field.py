"""Recorded dockings: path, drive, costmap and outline from a recording, and scenarios for their certificates."""

from __future__ import annotations

import itertools
import math
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import shapely

from optdock.config.scenario import Scenario
from optdock.config.writing import save_scenario
from optdock.errors import InvalidFile, InvalidPath, InvalidValue
from optdock.geometry.arrays import FloatArray, readonly
from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import in_words
from optdock.geometry.pose import Pose2, transform_points, transform_poses, unwrap_yaw
from optdock.io.maps import save_map
from optdock.io.plan_file import PlanFile, save_plan
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.costs import FREE_SPACE, LETHAL
from optdock.model.dock import Dock
from optdock.model.limits import LIMIT_UNITS, MotionLimits
from optdock.model.path import Path as DockPath
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.ros.grids import costmap, patched
from optdock.ros.messages import seconds
from optdock.ros.motion import footprint, odometry, path_poses
from optdock.ros.transforms import TransformError, TransformTree
from optdock.verification.proximity import pose_clearances

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from optdock.model.costmap import Costmap
    from optdock.model.costs import OccupancyRule
    from optdock.ros.bag import BagRecording
    from optdock.ros.messages import Message

__all__ = [
    "FieldDocking",
    "FieldOptions",
    "FieldTopics",
    "JudgedPoses",
    "RecordedDrive",
    "field_docking",
    "judged_poses",
    "kept_poses",
    "save_field_docking",
]

_PATH = ("nav_msgs/msg/Path",)
_GRID = ("nav2_msgs/msg/Costmap", "nav_msgs/msg/OccupancyGrid")
_UPDATE = ("nav2_msgs/msg/CostmapUpdate", "map_msgs/msg/OccupancyGridUpdate")
_POLYGON = ("geometry_msgs/msg/PolygonStamped",)
_ODOMETRY = ("nav_msgs/msg/Odometry",)
_TRANSFORMS = ("tf2_msgs/msg/TFMessage",)

# Distances between the kept poses of a drive: noise of millimetres does not count as a turn, and the path between two
# poses is straight to a millimetre.
_APART, _TURNED = 0.05, 0.1  # [m], [rad]
_REVERSED = 0.01  # [m]: shorter motions back are noise
_OUTLINES = 200  # footprint messages that are compared; at most twice as many
_AT_ONCE = 100  # updates that are applied to one copy of a costmap
_AROUND = 1.0  # [s] of transforms before and after the interval, for interpolation
_REACH = 0.2  # [s] before and after the known transforms: localization sends a transform every ten control cycles
_BASE = "base_link"  # Nav2's default
_BLOCK = 512  # poses whose clearance is computed together; bounds the memory


class FieldTopics(NamedTuple):
    """Topics to read, of each kind the first that exists; a single topic must exist. The defaults are Nav2's."""

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

    def instead(self, topics: Mapping[str, str]) -> FieldTopics:
        """Return a copy in which every non-empty topic in `topics` replaces all topics of its kind."""
        return self._replace(**{kind: (topic,) for kind, topic in topics.items() if topic})  # type: ignore[arg-type]


class RecordedDrive(NamedTuple):
    """Driven poses of a recording.

    Attributes:
        times: Times since the beginning of the recording, Shape (n,) [s].
        poses: Shape (n, 3).
        kept: Rows of the poses that form a path.
    """

    times: FloatArray
    poses: FloatArray
    kept: tuple[int, ...]


class FieldDocking(NamedTuple):
    """A docking from a recording; all poses are in `frame`.

    Attributes:
        frame: Frame of the costmap.
        costmap: Last costmap.
        footprint: Outline of the robot, in the frame of the robot.
        path: Last path, Shape (n, 3); None if the recording has no path.
        drive: Driven poses; None if the recording has no odometry.
        rows: Description of the contents that were read.
    """

    frame: str
    costmap: Costmap
    footprint: Footprint
    path: FloatArray | None
    drive: RecordedDrive | None
    rows: tuple[tuple[str, str], ...]


class FieldOptions(NamedTuple):
    """Options for reading a recording.

    Attributes:
        outline: Outline of the robot; None for the outline in the recording.
        base_frame: Frame of the robot; empty for the child frame of the odometry, or `base_link`.
        rule: Conversion of occupancies to costs; None for the defaults.
        since: Time [s] since the beginning of the recording; earlier messages are ignored.
        until: Time [s] since the beginning of the recording; later messages are ignored.
    """

    outline: Footprint | None = None
    base_frame: str = ""
    rule: OccupancyRule | None = None
    since: float = 0.0
    until: float = math.inf


def field_docking(bag: BagRecording, topics: FieldTopics, options: FieldOptions) -> FieldDocking:
    """Return the docking of a recording, with the last path, costmap (with updates) and outline of the interval.

    Args:
        bag: The recording.
        topics: Topics to read.
        options: Interval, frames and outline.

    Raises:
        InvalidFile: If a topic is missing, empty, of the wrong type or damaged, a message is invalid, or frames are not
            connected; the message names file and topic.
    """
    return _RecordingReader(bag, topics, options).read()


class _RecordingReader:
    """Reader of one recording; every error message contains file and topic."""

    def __init__(self, bag: BagRecording, topics: FieldTopics, options: FieldOptions) -> None:
        self._bag, self._topics, self._options, self._base = bag, topics, options, options.base_frame
        self._interval = bag.begin + options.since, bag.begin + options.until
        self._rows: list[tuple[str, str]] = []
        self._transforms = TransformTree(reach=_REACH)
        self._times: list[tuple[float, float]] = []  # of the odometry: time of reception, stamp
        self._out_of_reach = ""  # the last error of a transform

    def read(self) -> FieldDocking:
        topics = self._topics
        odom = self._find(topics.odometry, _ODOMETRY, "--odom-topic")
        planned = self._find(topics.path, _PATH, "--path-topic")
        if not (odom or planned):
            names, option = (*topics.path, *topics.odometry), "--path-topic, --odom-topic"
            raise self._none_of(names, (*_PATH, *_ODOMETRY), option)
        grid = self._find(topics.costmap, _GRID, "--costmap-topic")
        if not grid:
            raise self._none_of(topics.costmap, _GRID, "--costmap-topic")
        self._read_transforms()
        self._read_odometry(odom)
        frame, known = self._costmap(grid)
        path = self._path(planned, frame) if planned else None
        drive = self._drive(odom, frame) if odom else None
        outline = self._options.outline or self._footprint()
        return FieldDocking(frame, known, outline, path, drive, tuple(self._rows))

    def _find(self, names: tuple[str, ...], kinds: tuple[str, ...], option: str) -> str:
        """Return the first existing topic; empty if several topics were given and no topic exists."""
        found = self._bag.find(names, kinds, option)
        if not found and len(names) == 1:
            raise InvalidFile(f"{self._bag.source}: has no topic {names[0]} ({option}); {self._bag.of_kind(kinds)}")
        return found

    def _none_of(self, names: tuple[str, ...], kinds: tuple[str, ...], option: str, hint: str = "") -> InvalidFile:
        listed = f"has none of the topics {', '.join(names)} ({option}); {self._bag.of_kind(kinds)}"
        return InvalidFile(f"{self._bag.source}: {listed}{hint}")

    @contextmanager
    def _errors_of(self, topic: str) -> Iterator[None]:
        """Convert errors of a message to `InvalidFile` with the file and the topic."""
        try:
            yield
        except (InvalidValue, TransformError) as error:
            raise InvalidFile(f"{self._bag.source}: {topic}: {error}") from error

    def _nothing(self, topic: str, what: str = "no message") -> InvalidFile:
        first, last = (f"{max(time - self._bag.begin, 0.0):.3f}" for time in self._interval)
        length = f"{self._bag.end - self._bag.begin:.3f}"
        return InvalidFile(
            f"{self._bag.source}: {topic}: holds {what} from {first} s to {last} s of {length} s (--since, --until)"
        )

    def _received(self, time: float) -> str:
        return f"received at {time - self._bag.begin:.3f} s"

    def _read_transforms(self) -> None:
        begin, end = self._interval
        for topic, since, always in ((self._topics.tf_static, 0.0, True), (self._topics.tf, begin - _AROUND, False)):
            if self._bag.find((topic,), _TRANSFORMS):
                for _, message in self._bag.messages(topic, since, end + _AROUND):
                    for one in message.transforms:
                        self._transforms.insert(one, is_static=always)

    def _read_odometry(self, topic: str) -> None:
        """Read the times of the odometry, and its poses if there is no transform of its child frame."""
        is_needed = None
        for received, message in self._bag.messages(topic, *self._interval) if topic else ():
            with self._errors_of(topic):
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
        """Return frame and costmap of the last complete message, with all later updates applied."""
        last = self._bag.last(topic, *self._interval)
        if last is None:
            raise self._nothing(topic)
        received, message = last
        with self._errors_of(topic):
            known = costmap(message, self._options.rule)
        updates, count = f"{topic}_updates", 0
        if self._bag.find((updates,), _UPDATE):
            parts = (update for _, update in self._bag.messages(updates, received, self._interval[1]))
            while some := tuple(itertools.islice(parts, _AT_ONCE)):
                with self._errors_of(updates):
                    known, count = patched(known, *some, rule=self._options.rule), count + len(some)
        grid, frame = known.costmap, known.frame.lstrip("/")
        more = f" and {count} updates" if count else ""
        cells = f"{grid.columns} x {grid.rows} cells of {grid.resolution:g} m in {frame!r}"
        self._rows.append(("costmap", f"{topic}: {cells}, {self._received(received)}{more}"))
        return frame, grid

    def _path(self, topic: str, frame: str) -> FloatArray:
        """Return the last path with poses, transformed into a frame."""
        last = None
        for received, message in self._bag.messages(topic, *self._interval):
            last = (received, message) if len(message.poses) else last
        if last is None:
            raise self._nothing(topic, "no path with poses")
        with self._errors_of(topic):
            found = path_poses(last[1])
            source, moved = found.frame.lstrip("/"), Pose2(0.0, 0.0, 0.0)
            if source != frame:
                # A stamp of zero means the newest transform.
                stamp = found.stamp or (self._times[-1][1] if self._times else 0.0)
                moved = self._transforms.lookup(frame, source, stamp).planar()
        self._rows.append(("path", f"{topic}: {len(found.poses)} poses, {self._received(last[0])}"))
        return readonly(transform_poses(moved, found.poses))

    def _drive(self, topic: str, frame: str) -> RecordedDrive:
        """Return the poses of the robot at the times of the odometry for which there are transforms."""
        rows, length = list[tuple[float, ...]](), len(self._times)
        for received, stamp in self._times:
            stood = self._robot_in(frame, stamp)
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

    def _robot_in(self, frame: str, stamp: float) -> Pose2 | None:
        """Return the pose of the robot in a frame; if there is no transform, store the error and return None."""
        try:
            found = self._transforms.lookup(frame, self._base, stamp)
        except TransformError as error:
            self._out_of_reach = f"{self._bag.source}: {self._topics.tf}: {error}"
            return None
        with self._errors_of(self._topics.tf):
            return found.planar()

    def _evenly_spaced(self, topic: str) -> list[Message]:
        """Return the messages of a topic, evenly thinned to `_OUTLINES` to 2 * `_OUTLINES` if there are more."""
        found: list[Message] = []
        every = 1
        for number, (_, message) in enumerate(self._bag.messages(topic, *self._interval)):
            if number % every == 0:
                found.append(message)
            if len(found) == 2 * _OUTLINES:
                found, every = found[::2], 2 * every
        if not found:
            raise self._nothing(topic)
        return found

    def _footprint(self) -> Footprint:
        """Return the median of the outlines in the robot's frame; single poses are only accurate to a control cycle."""
        names, option = self._topics.footprint, "--footprint-topic"
        topic = self._find(names, _POLYGON, option)
        if not topic:
            raise self._none_of(names, _POLYGON, option, "; or set --footprint or --radius")
        outlines = []
        for message in self._evenly_spaced(topic):
            with self._errors_of(topic):
                stamp = seconds(message.header.stamp)
            stood = self._robot_in(message.header.frame_id.lstrip("/"), stamp)
            if stood is not None:
                with self._errors_of(topic):
                    outlines.append(footprint(message, stood).footprint.vertices)
        if not outlines:
            raise InvalidFile(self._out_of_reach)
        alike = [outline for outline in outlines if len(outline) == len(outlines[-1])]
        with self._errors_of(topic):
            found = Footprint(np.median(np.array(alike), axis=0))
        size = f"{found.length:.3f} m x {found.width:.3f} m"
        self._rows.append(("footprint", f"{topic}: {size}, of {len(alike)} messages"))
        return found


def kept_poses(poses: FloatArray) -> tuple[int, ...]:
    """Return the rows of measured poses, Shape (n, 3), that form a path.

    Consecutive rows differ by at least some centimetres or a small turn; the first and the last row and every reversal
    are included.
    """
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
    """Return the rows at which the distance driven forward, Shape (n,) [m], reverses; noise is ignored."""
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


class JudgedPoses(NamedTuple):
    """A planned or driven path, and the problem that it solves.

    Attributes:
        name: `path` or `drive`.
        path: Path through the poses.
        problem: Problem from the first pose to the last, with the costmap.
        closest: Text that states the smallest clearance along the poses, the pose at which it occurs, and the nearest
            obstacle there.
    """

    name: str
    path: DockPath
    problem: DockingProblem
    closest: str


def judged_poses(
    found: FieldDocking, rule: ClearanceRule, contact: float | None = None
) -> tuple[tuple[JudgedPoses, ...], tuple[tuple[str, str], ...]]:
    """Return the paths of a recorded docking with their problems, and rows of a report.

    The limits are the defaults of `MotionLimits`, because a recording contains no limits.

    Args:
        found: The docking.
        rule: Required clearance of the path and the drive.
        contact: Tolerance [m] for contact with the dock at the end of the path: occupied cells within this distance of
            the edge of the outline, inside and outside, are treated as free. None for the diagonal of a cell.
    """
    judged, drive = list[JudgedPoses](), found.drive
    known, rows = _without_contact(found, contact)
    for name, poses in (("path", found.path), ("drive", None if drive is None else drive.poses)):
        if poses is None:
            rows.append((f"{name} to judge", "none"))
            continue
        problem = DockingProblem(
            Pose2(*poses[0].tolist()),
            Dock(Pose2(*poses[-1].tolist())),
            Robot(found.footprint, MotionLimits()),
            clearance=rule,
            costmap=known,
            frame=found.frame,
        )
        distance, worst, closest = _closest(poses, problem)
        if drive is not None and name == "drive":
            closest += f" at {drive.times[worst]:.3f} s"
            # A colliding pose is checked even if it is not kept.
            poses = poses[sorted({*drive.kept, worst} if distance < rule.required else drive.kept)]  # noqa: PLW2901
        try:
            path = DockPath.from_poses(poses, found.frame)
        except InvalidPath as error:
            rows.append((f"{name} to judge", f"none: {error}"))
            continue
        judged.append(JudgedPoses(name, path, problem, closest))
        rows.append((f"{name} closest", closest))
    return tuple(judged), tuple(rows)


def _without_contact(found: FieldDocking, contact: float | None) -> tuple[Costmap, list[tuple[str, str]]]:
    """Return the costmap without the cells that the robot touches at the end of the path, and report rows."""
    grid, near = found.costmap, math.sqrt(2.0) * found.costmap.resolution if contact is None else contact
    if found.path is None or near == 0.0:
        return grid, []
    outline = shapely.Polygon(transform_points(found.path[-1:], found.footprint.vertices)[0])
    rows, columns = np.nonzero(grid.data >= LETHAL)
    centres, half = grid.centre_of(np.column_stack((columns, rows))), 0.5 * grid.resolution
    squares = shapely.box(*(centres - half).T, *(centres + half).T)
    touched = shapely.intersects(squares, outline.buffer(near)) & ~shapely.intersects(squares, outline.buffer(-near))
    if not touched.any():
        return grid, []
    data = grid.data.copy()
    data[rows[touched], columns[touched]] = FREE_SPACE
    count = np.count_nonzero(touched)
    text = f"{count} occupied cells at the edge of the footprint, to within {near:.3f} m, taken as free"
    return grid.with_data(data), [("path's end", text)]


def _closest(poses: FloatArray, problem: DockingProblem) -> tuple[float, int, str]:
    """Return the smallest clearance of the poses [m], its row, and a text with both."""
    if not len(problem.all_obstacles):
        return math.inf, 0, "there are no obstacles"
    footprint, obstacles = problem.robot.footprint, problem.all_obstacles
    blocks = np.array_split(poses, -(-len(poses) // _BLOCK))
    found = [pose_clearances(block, footprint, obstacles) for block in blocks]
    distances, rows = (np.concatenate(columns) for columns in zip(*found, strict=True))
    worst = int(np.argmin(distances))
    least, what = float(distances[worst]), in_words(obstacles.name_of(int(rows[worst])))
    away = f"{least:.4f} m from {what}" if least >= 0.0 else f"{-least:.4f} m into {what}"
    return least, worst, f"{away}, pose {worst} of {len(poses)}, {Pose2(*poses[worst].tolist()).brief}"


def save_field_docking(
    folder: str | Path, judged: tuple[JudgedPoses, ...], found: FieldDocking, note: str
) -> tuple[Path, ...]:
    """Write a plan file `NAME.json` and a scenario `NAME.yaml` for each path, and one map for all paths.

    Args:
        folder: Folder, created if necessary; existing files are replaced.
        judged: Paths to write.
        found: The docking.
        note: Comment of one line for the scenarios.

    Returns:
        The files written.

    Raises:
        InvalidFile: If a file cannot be written.
        InvalidValue: If there is nothing to write.
    """
    if not judged:
        raise InvalidValue("neither path nor drive has two distinct poses")
    folder = Path(folder)
    written = [*save_map(folder / "map.yaml", judged[0].problem.costmap or found.costmap)]
    for one in judged:
        plan = folder / f"{one.name}.json"
        save_plan(plan, PlanFile(status="recorded", completed=True, frame=found.frame, path=one.path))
        scenario = Scenario(one.problem, default_limits=frozenset(LIMIT_UNITS))
        files = save_scenario(
            plan.with_suffix(".yaml"), scenario, map_source=written[0], note=f"{note}, as {one.name} recorded"
        )
        written += [plan, *files]
    return tuple(written)
