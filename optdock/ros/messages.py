"""Common parts of all messages: classes, headers, times, errors."""

from __future__ import annotations

import importlib
import math
from array import array
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NoReturn, TypeAlias

import numpy as np

from optdock.errors import InvalidMessage, InvalidValue
from optdock.geometry.checked import finite_number

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = [
    "Message",
    "MessageTypes",
    "checked_frame",
    "column",
    "header",
    "imported",
    "made",
    "refuse",
    "seconds",
    "stamp",
    "stamped_frame",
    "type_name",
]

Message: TypeAlias = Any  # any object with the fields of the message
MessageTypes: TypeAlias = Callable[[str], type]

_NANOSECONDS = 1_000_000_000
_LATEST = 2**31  # [s]: the seconds of a time are 32 bits with a sign, and end in 2038


def imported(name: str) -> type:
    """Return a message class of a ROS environment: the `MessageTypes` of `rclpy`.

    Args:
        name: Name such as `nav_msgs/msg/Path`.

    Raises:
        ImportError: If the package of the message is not installed.
    """
    package, kind, message = name.split("/")
    found: type = getattr(importlib.import_module(f"{package}.{kind}"), message)
    return found


def type_name(message: Message) -> str:
    """Return the ROS name of a message's type, such as `nav_msgs/msg/Path`."""
    known = getattr(message, "__msgtype__", None)  # rosbags
    if isinstance(known, str):
        return known
    kind = type(message)
    parts = kind.__module__.split(".")
    return f"{parts[0]}/{parts[1]}/{kind.__name__}" if len(parts) > 1 else kind.__name__


def refuse(message: Message, field: str, rule: str, value: object) -> NoReturn:
    """Raise an error about a message.

    Args:
        message: The whole message.
        field: Wrong field, with indices, in Python's syntax.
        rule: Rule that the field violates.
        value: Value of the field.

    Raises:
        InvalidMessage: Always.
    """
    name = type_name(message)
    where = {"message": name, "field": field, "value": str(value)}
    raise InvalidMessage(f"{name}: {field}: {rule}, got {value}", where=where)


def seconds(time: Message) -> float:
    """Return a `builtin_interfaces/Time` in seconds, with a rounding error below 0.3 microseconds.

    Raises:
        InvalidMessage: If the time is negative, or the nanoseconds are a second or more.
    """
    whole, rest = time.sec, time.nanosec
    if whole < 0:
        refuse(time, "sec", "must be >= 0", whole)
    if not 0 <= rest < _NANOSECONDS:
        refuse(time, "nanosec", f"must be in 0..{_NANOSECONDS - 1}", rest)
    return float(whole + rest * 1e-9)


def stamp(types: MessageTypes, time: float) -> Message:
    """Return a time [s] as a `builtin_interfaces/Time`, rounded to nanoseconds.

    Raises:
        InvalidValue: If the time is not finite, negative, or too late for the message.
    """
    checked = finite_number(time, "stamp")
    nanoseconds = round(math.modf(checked)[0] * _NANOSECONDS) + int(checked) * _NANOSECONDS
    if not 0 <= nanoseconds < _LATEST * _NANOSECONDS:
        raise InvalidValue(f"stamp: must be >= 0 s and < {_LATEST} s, got {time}")
    whole, rest = divmod(nanoseconds, _NANOSECONDS)
    return made(types, "builtin_interfaces/msg/Time", sec=whole, nanosec=rest)


def header(types: MessageTypes, frame: str, time: float) -> Message:
    """Return a `std_msgs/Header`.

    Raises:
        InvalidValue: If the frame is empty, or the time does not fit into a message.
    """
    return made(types, "std_msgs/msg/Header", stamp=stamp(types, time), frame_id=checked_frame(frame))


def checked_frame(frame: str, name: str = "frame") -> str:
    """Return the name of a frame.

    Raises:
        InvalidValue: If the name is empty.
    """
    if not frame:
        raise InvalidValue(f"{name}: must be the name of a coordinate frame, got {frame!r}")
    return frame


def stamped_frame(message: Message) -> tuple[str, float]:
    """Return frame and stamp [s] of a message's header.

    Raises:
        InvalidMessage: If the frame is empty, or the stamp is invalid.
    """
    head = message.header
    if not head.frame_id:
        refuse(message, "header.frame_id", "must be the name of a coordinate frame", repr(head.frame_id))
    try:
        return str(head.frame_id), seconds(head.stamp)
    except InvalidMessage as error:
        field, _, rest = str(error).partition(": ")[2].partition(": ")
        raise InvalidMessage(
            f"{type_name(message)}: header.stamp.{field}: {rest}",
            where={**error.where, "message": type_name(message), "field": f"header.stamp.{field}"},
        ) from error


def made(types: MessageTypes, name: str, /, **values: object) -> Message:
    """Return a message with the given values; fields that its class lacks in this ROS distribution are ignored."""
    kind: Any = types(name)
    fields = kind.__dataclass_fields__ if _is_dataclass(kind) else kind.get_fields_and_field_types()
    return kind(**{field: value for field, value in values.items() if field in fields})


def column(types: MessageTypes, name: str, values: NDArray[np.uint8] | NDArray[np.int8]) -> array[int] | NDArray[Any]:
    """Return a copy of bytes for a field of the message `name`: an `array` for `rclpy`, a NumPy array for `rosbags`."""
    flat = np.array(values).reshape(-1)
    if _is_dataclass(types(name)):
        return flat
    found = array("b" if flat.dtype == np.int8 else "B")
    found.frombytes(flat.tobytes())
    return found


def _is_dataclass(kind: type) -> bool:
    """Whether the class belongs to rosbags, in which fields have no defaults."""
    return hasattr(kind, "__dataclass_fields__")
