"""Recordings of ROS 2, read and written with `rosbags` (extra `bag`), without ROS."""

from __future__ import annotations

import functools
import math
import os
import secrets
import shutil
from collections import deque
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from optdock.errors import InvalidFile, InvalidValue, MissingExtra
from optdock.io.guarded_file import MostBytes, check_regular
from optdock.io.quoting import shortened
from optdock.io.yaml_lines import load_yaml

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator, Sequence

    from rosbags.interfaces import Connection, MessageDefinition
    from rosbags.rosbag2 import Reader
    from rosbags.typesys.store import Typestore

    from optdock.ros.messages import Message

__all__ = ["BagMessage", "BagRecording", "bag_types", "open_bag", "write_bag"]

# Fields of Nav2's costmap messages, which rosbags does not contain, for recordings without message definitions.
_NAV2_FIELDS = {
    "CostmapMetaData": "builtin_interfaces/Time map_load_time; builtin_interfaces/Time update_time; string layer; "
    "float32 resolution; uint32 size_x; uint32 size_y; geometry_msgs/Pose origin",
    "Costmap": "std_msgs/Header header; CostmapMetaData metadata; uint8[] data",
    "CostmapUpdate": "std_msgs/Header header; uint32 x; uint32 y; uint32 size_x; uint32 size_y; uint8[] data",
}
_VERSION: Literal[9] = 9  # of rosbag2's format, as written by Jazzy and Kilted
_LISTED = 20  # topics in an error message


class BagMessage(NamedTuple):
    """A message to write.

    Attributes:
        topic: Topic.
        time: Time of reception [s].
        message: The message, an instance of a class from `bag_types`.
    """

    topic: str
    time: float
    message: Message


@functools.lru_cache(maxsize=1)
def _store() -> Typestore:
    """Return the message classes of a ROS distribution and of Nav2's costmaps."""
    try:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    except ImportError as error:
        raise MissingExtra("recordings need rosbags: pip install 'optdock[bag]'") from error
    store = get_typestore(Stores.ROS2_KILTED)
    for name, fields in _NAV2_FIELDS.items():
        store.register(get_types_from_msg(fields.replace("; ", "\n"), f"nav2_msgs/msg/{name}"))
    return store


@functools.lru_cache(maxsize=64)
def _store_of(kind: str, definition: MessageDefinition) -> Typestore:
    """Return the classes of one message type as defined in a recording; separate stores isolate invalid types."""
    from rosbags.interfaces import MessageDefinitionFormat
    from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

    if definition.format is MessageDefinitionFormat.NONE:
        return _store()
    store = get_typestore(Stores.EMPTY)
    if definition.format is MessageDefinitionFormat.MSG:
        store.register(get_types_from_msg(definition.data, kind))
    else:
        for part in filter(None, definition.data.split("=" * 80 + "\n")):
            store.register(get_types_from_idl(part.partition("\n")[2] if part.startswith("IDL: ") else part))
    return store


def bag_types(name: str) -> type:
    """Return a message class for recordings: the `MessageTypes` of rosbags.

    Args:
        name: Name such as `nav_msgs/msg/Path`.

    Raises:
        MissingExtra: If rosbags is not installed.
    """
    return _store().types[name]


def write_bag(target: str | Path, messages: Iterable[BagMessage], latched: Collection[str] = ()) -> None:
    """Write a recording atomically: one file if the name ends in `.mcap`, otherwise a rosbag2 folder.

    Args:
        target: File, which is replaced, or a folder that does not exist.
        messages: Messages in any order.
        latched: Topics whose last message is sent to late subscribers.

    Raises:
        InvalidFile: If the folder exists, or the target cannot be written.
        InvalidValue: If the name has a different suffix, or a time is negative.
        MissingExtra: If rosbags is not installed.
    """
    target = Path(target)
    if target.suffix not in (".mcap", ""):
        raise InvalidValue(f"{target}: must end in .mcap, or name a folder without a suffix, got {target.suffix}")
    if target.is_dir() or (target.exists() and not target.suffix):
        raise InvalidFile(f"{target}: is an existing folder, which a recording does not replace; choose another name")
    store, nanoseconds = _store(), 1_000_000_000
    rows = sorted(messages, key=lambda one: one.time)
    if rows and not rows[0].time >= 0.0:
        raise InvalidValue(f"{rows[0].topic}: time must be >= 0 s, got {rows[0].time}")
    from rosbags.rosbag2 import StoragePlugin, Writer

    scratch = target.parent / f".{target.stem}.{secrets.token_hex(4)}"
    try:
        scratch.mkdir(parents=True)
        inner = scratch / target.stem
        with Writer(inner, version=_VERSION, storage_plugin=StoragePlugin.MCAP) as writer:
            known: dict[str, Connection] = {}
            for topic, time, message in rows:
                kind = message.__msgtype__
                if topic not in known:
                    offered = [_latched()] if topic in latched else []
                    known[topic] = writer.add_connection(topic, kind, typestore=store, offered_qos_profiles=offered)
                whole = int(time)
                stamp = whole * nanoseconds + round((time - whole) * nanoseconds)
                writer.write(known[topic], stamp, store.serialize_cdr(message, kind))
        source = inner / f"{target.stem}.mcap" if target.suffix else inner
        os.replace(source, target)  # noqa: PTH105 - the atomic replacement, by its well-known name
    except OSError as error:
        raise InvalidFile(f"{target}: cannot be written: {error.strerror or error}") from error
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def _latched() -> Any:  # noqa: ANN401 - a tuple of rosbags
    """Return the quality of service of a latched topic."""
    from rosbags import interfaces as r

    history, reliability, durability = (
        r.QosHistory.KEEP_LAST,
        r.QosReliability.RELIABLE,
        r.QosDurability.TRANSIENT_LOCAL,
    )
    never, liveliness = r.QosTime(0, 0), r.QosLiveliness.SYSTEM_DEFAULT
    return r.Qos(
        history, 1, reliability, durability, never, never, liveliness, never, avoid_ros_namespace_conventions=False
    )


@contextmanager
def open_bag(source: str | Path) -> Iterator[BagRecording]:
    """Open a recording for reading: an `.mcap` or `.db3` file, or its folder.

    Raises:
        InvalidFile: If the recording cannot be read, is damaged, or contains no message.
        MissingExtra: If rosbags is not installed.
    """
    source = Path(source)
    _store()
    from rosbags.rosbag2 import Reader

    _check_recording(source)
    with _reading(source):
        reader = Reader(source)
        reader.open()
    try:
        if not reader.message_count:
            raise InvalidFile(f"{source}: holds no message")
        yield BagRecording(source, reader)
    finally:
        reader.close()


def _check_recording(source: Path) -> None:
    """Reject devices and pipes, on which rosbags would block, and metadata that exceed the limits of `load_yaml`."""
    if not os.path.isdir(source):  # noqa: PTH112 - False also for a name that is too long
        check_regular(source, MostBytes.RECORDING)
        return
    for path in sorted(source.iterdir()):
        if path.name == "metadata.yaml":
            load_yaml(path)
        elif not path.is_dir():
            check_regular(path, MostBytes.RECORDING)


@contextmanager
def _reading(source: Path, topic: str = "") -> Iterator[None]:
    """Convert errors of rosbags to `InvalidFile` with file and topic."""
    try:
        yield
    except InvalidFile:
        raise
    except Exception as error:
        where = f"{source}: {topic}" if topic else f"{source}"
        reason = shortened(" ".join(str(error).split())) or type(error).__name__
        raise InvalidFile(f"{where}: is damaged or no recording: {reason}") from error


class BagRecording:
    """An open recording.

    Args:
        source: File name for error messages.
        reader: Open reader of rosbags.
    """

    def __init__(self, source: Path, reader: Reader) -> None:
        self.source, self._reader = source, reader
        self.begin = 1e-9 * reader.start_time
        self.end = 1e-9 * reader.end_time

    def find(self, topics: Sequence[str], kinds: Collection[str], option: str = "") -> str:
        """Return the first existing topic; empty if no topic exists.

        Args:
            topics: Candidates in order.
            kinds: Allowed message types.
            option: Option of the command for error messages; may be empty.

        Raises:
            InvalidFile: If the topic is of the wrong type.
        """
        known = {connection.topic: connection.msgtype for connection in self._reader.connections}
        for topic in topics:
            kind = known.get(topic)
            if kind is None:
                continue
            if kind not in kinds:
                other = f"; choose another by {option}" if option else ""
                raise InvalidFile(f"{self.source}: {topic}: must be {' or '.join(kinds)}, is {kind}{other}")
            return topic
        return ""

    def of_kind(self, kinds: Collection[str]) -> str:
        """Return a text that lists the topics of some message types."""
        found = sorted({c.topic for c in self._reader.connections if c.msgtype in kinds})
        some = ", ".join(found[:_LISTED]) or "none"
        return f"its topics of type {' or '.join(kinds)}: {some}"

    def messages(self, topic: str, since: float, until: float) -> Iterator[tuple[float, Message]]:
        """Yield the times of reception [s] and the messages of a topic, in order; yield nothing for an empty name.

        Raises:
            InvalidFile: If a message is damaged.
        """
        for time, kind, data in self._raw(topic, since, until):
            yield time, self._read(topic, kind, data)

    def last(self, topic: str, since: float, until: float) -> tuple[float, Message] | None:
        """Return the time of reception [s] and the last message of a topic; None if there is no message.

        Raises:
            InvalidFile: If the message is damaged.
        """
        found = deque(self._raw(topic, since, until), maxlen=1)
        return (found[0][0], self._read(topic, *found[0][1:])) if found else None

    def _raw(self, topic: str, since: float, until: float) -> Iterator[tuple[float, str, bytes]]:
        connections = [c for c in self._reader.connections if c.topic == topic]
        if not connections:
            return
        with _reading(self.source, topic):
            # Bounds for the index of the recording; the rounding of floats is less than 1,000 ns.
            begin = math.floor(since * 1e9) - 1_000 if math.isfinite(since) else None
            end = math.ceil(until * 1e9) + 1_000 if math.isfinite(until) else None
            for connection, time, data in self._reader.messages(connections, begin, end):
                if since <= 1e-9 * time <= until:
                    yield 1e-9 * time, connection.msgtype, data

    def _read(self, topic: str, kind: str, data: bytes) -> Message:
        with _reading(self.source, topic):
            definition = next(c.msgdef for c in self._reader.connections if c.msgtype == kind)
            return _store_of(kind, definition).deserialize_cdr(data, kind)
