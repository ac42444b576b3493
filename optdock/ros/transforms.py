"""Recorded transforms: where one frame was in another at any moment of a recording."""

from __future__ import annotations

import bisect
import math
from typing import TYPE_CHECKING

from optdock.errors import InvalidValue
from optdock.geometry.pose import Pose2, normalize_angle
from optdock.ros.messages import refuse, seconds
from optdock.ros.motion import plain_pose

if TYPE_CHECKING:
    from optdock.ros.messages import Message

__all__ = ["RecordedTransforms"]

# [s] by which a transform may be asked for beyond what is known of it: localization sends one in ten control cycles.
_LATE = 0.2
_DEEPEST = 50  # frames above one another; more are a loop


class _Edge:
    """A frame in its parent: poses over time, or one that always holds."""

    def __init__(self, parent: str, *, always: bool) -> None:
        self.parent, self.always = parent, always
        self.times: list[float] = []
        self.values: list[Message] = []


class _Upright:
    """The fields of a `geometry_msgs/Transform` under the names of a `geometry_msgs/Pose`."""

    __msgtype__ = "tf2_msgs/msg/TFMessage"  # what messages call it

    def __init__(self, transform: Message) -> None:
        self.position, self.orientation = transform.translation, transform.rotation


class RecordedTransforms:
    """A tree of frames over time, in the plane.

    Transforms between frames that are never asked for may lean as they like: of the others the rule of poses holds.
    """

    def __init__(self) -> None:
        self._edges: dict[str, _Edge] = {}

    def add(self, message: Message, *, always: bool = False) -> None:
        """Note a `tf2_msgs/TFMessage`; `always` for one of `/tf_static`.

        Raises:
            InvalidMessage: A stamp is none, or a frame has no name.
        """
        for one in message.transforms:
            frame, child = one.header.frame_id.lstrip("/"), one.child_frame_id.lstrip("/")
            if not (frame and child):
                refuse(message, "transforms", "must name both frames", f"{frame!r}, {child!r}")
            self._note(frame, child, seconds(one.header.stamp), _Upright(one.transform), always=always)

    def add_pose(self, frame: str, child: str, time: float, pose: Message) -> None:
        """Note where a frame was, as a `geometry_msgs/Pose`, such as that of odometry."""
        self._note(frame, child, time, pose, always=False)

    def knows(self, child: str) -> bool:
        """Whether anything says where this frame is."""
        return child in self._edges

    def _note(self, frame: str, child: str, time: float, value: Message, *, always: bool) -> None:
        edge = self._edges.get(child)
        if edge is None or edge.parent != frame:
            edge = self._edges[child] = _Edge(frame, always=always)
        if edge.times and time <= edge.times[-1]:
            place = bisect.bisect_left(edge.times, time)
            if edge.times[place] == time:
                return
            edge.times.insert(place, time)
            edge.values.insert(place, value)
        else:
            edge.times.append(time)
            edge.values.append(value)

    def lookup(self, target: str, source: str, time: float) -> Pose2:
        """The pose of frame `source` in frame `target`, between the moments at which it is known.

        Raises:
            InvalidValue: Nothing joins the frames, or a transform on the way is not known at that time.
            InvalidMessage: A transform on the way is no turn about the vertical.
        """
        above_source, above_target = self._above(source), self._above(target)
        common = next((frame for frame in above_source if frame in above_target), None)
        if common is None:
            known = ", ".join(sorted({*self._edges, *(edge.parent for edge in self._edges.values())})) or "none"
            raise InvalidValue(f"no transform from {source!r} to {target!r}; frames known: {known}")
        return self._pose_in(common, target, time).inverse() @ self._pose_in(common, source, time)

    def _above(self, frame: str) -> list[str]:
        """A frame and all those that it stands in."""
        found = [frame]
        while found[-1] in self._edges and len(found) < _DEEPEST:
            found.append(self._edges[found[-1]].parent)
        return found

    def _pose_in(self, ancestor: str, frame: str, time: float) -> Pose2:
        pose = Pose2(0.0, 0.0, 0.0)
        while frame != ancestor:
            edge = self._edges[frame]
            pose = self._at(edge, frame, time) @ pose
            frame = edge.parent
        return pose

    def _at(self, edge: _Edge, frame: str, time: float) -> Pose2:
        name = f"{edge.parent} -> {frame}"
        if edge.always:
            return _planar(edge.values[-1], name)
        first, last = edge.times[0], edge.times[-1]
        if not first - _LATE <= time <= last + _LATE:
            raise InvalidValue(f"{name}: not known at {time:.3f} s, only from {first:.3f} s to {last:.3f} s")
        after = bisect.bisect_left(edge.times, time)
        if after in (0, len(edge.times)):
            return _planar(edge.values[min(after, len(edge.times) - 1)], name)
        low, high = _planar(edge.values[after - 1], name), _planar(edge.values[after], name)
        share = (time - edge.times[after - 1]) / (edge.times[after] - edge.times[after - 1])
        turn = normalize_angle(high.yaw - low.yaw)
        x, y = low.x + share * (high.x - low.x), low.y + share * (high.y - low.y)
        return Pose2(x, y, math.remainder(low.yaw + share * turn, 2.0 * math.pi))


def _planar(value: Message, name: str) -> Pose2:
    return plain_pose(value, value, name)
