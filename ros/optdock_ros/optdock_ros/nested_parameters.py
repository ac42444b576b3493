"""ROS parameters as nested blocks, judged by the models of the plugins and of the scenario format.

ROS keeps parameters flat, by dotted names, and one type each. Here they are nested, as in the file they came from, and
every value is judged by the model that will read it: YAML's `1` may stand for 1.0, and what is wrong is said for the
whole block at once.
"""

from __future__ import annotations

import array
import dataclasses
from collections.abc import Mapping
from enum import Enum
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from pydantic import BaseModel, Field, ValidationError
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.parameter import Parameter

from optdock.config.document import ClearanceDocument, RobotDocument, synonym
from optdock.errors import InvalidValue, OptdockError
from optdock.io.faults import faults_of
from optdock.model.robot import Robot
from optdock.plugins.parameters import PluginParameters, closest

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from rclpy.node import Node

    from optdock.geometry.footprint import Footprint
    from optdock.model.problem import ClearanceRule

T = TypeVar("T")

__all__ = [
    "Faults",
    "RobotParameters",
    "ServerParameters",
    "clearance_parameters",
    "declare",
    "declare_overrides",
    "flattened",
    "merged",
    "nested",
    "parameters_of",
    "plain",
    "robot_parameters",
    "undeclare",
    "unknown_names",
]


class ServerParameters(PluginParameters):
    """Parameters of every server; the names beside plugins and blocks at the top of a node's parameters."""

    autostart: bool = Field(default=False, description="configure and activate at once, without a lifecycle manager")
    bond_heartbeat_period: float = Field(0.1, ge=0, description="to the lifecycle manager; 0: no bond [s]")


# Names that rclpy declares, or that Nav2's nodes have and that mean nothing in a process of Python.
OF_EVERY_NODE = frozenset(
    {
        *("use_sim_time", "start_type_description_service", "qos_overrides"),
        *("autostart_node", "use_realtime_priority", "introspection_mode"),
        *("service_introspection_mode", "action_introspection_mode", "allow_parameter_qos_overrides"),
    }
)


# Of difflib: one letter in ten. Below it are names of Nav2's own, which may stand in a block for all nodes: `map_topic`
# is like `costmap_topic` by 0.82, `local_footprint_topic` like `footprint_topic` by 0.83.
_MISSPELT = 0.86


class Faults:
    """What is wrong with several things that are read one after the other, told at once.

    Args:
        lines: What is wrong already, one line per fault.
    """

    def __init__(self, lines: Iterable[str] = ()) -> None:
        self.lines = list(lines)

    def attempt(self, read: Callable[[], T]) -> T | None:
        """What `read` returns; None where it says what is wrong."""
        try:
            return read()
        except OptdockError as error:
            self.lines += str(error).splitlines()
            return None

    def look(self) -> None:
        """Go on only where nothing is wrong.

        Raises:
            InvalidValue: Something is; one line per fault.
        """
        if self.lines:
            raise InvalidValue("\n".join(self.lines))


def plain(value: object) -> object:
    """A ROS parameter's value in plain Python; what YAML writes `[]` has no type in ROS and is an empty list."""
    if value is None:
        return []
    if isinstance(value, array.array | np.ndarray | tuple):
        return list(value)
    return value


def nested(flat: Mapping[str, object]) -> dict[str, object]:
    """Blocks from dotted names.

    Raises:
        InvalidValue: A name is a value and a block at once.

    >>> nested({"a": 1, "b.c": 2, "b.d.e": 3})
    {'a': 1, 'b': {'c': 2, 'd': {'e': 3}}}
    """
    block: dict[str, object] = {}
    for name, value in flat.items():
        *path, last = name.split(".")
        place = block
        for n, part in enumerate(path):
            inner = place.setdefault(part, {})
            if not isinstance(inner, dict):
                raise InvalidValue(f"{'.'.join(path[: n + 1])}: is a value, and a block with {name}, at once")
            place = inner
        if isinstance(place.get(last), dict):
            raise InvalidValue(f"{name}: is a value and a block at once")
        place[last] = value
    return block


def flattened(block: Mapping[str, object], prefix: str = "") -> dict[str, object]:
    """Dotted names from blocks; an empty block has none.

    >>> flattened({"a": 1, "b": {"c": 2}})
    {'a': 1, 'b.c': 2}
    """
    flat: dict[str, object] = {}
    for name, value in block.items():
        if isinstance(value, Mapping):
            flat |= flattened(value, f"{prefix}{name}.")
        else:
            flat[f"{prefix}{name}"] = value
    return flat


def merged(block: Mapping[str, object], changes: Iterable[Parameter[Any]]) -> dict[str, object]:
    """The block after a set of parameters; one that is unset is gone.

    Raises:
        InvalidValue: As `nested`.
    """
    flat = flattened(block)
    for parameter in changes:
        if parameter.type_ == Parameter.Type.NOT_SET:
            flat.pop(parameter.name, None)
        else:
            flat[parameter.name] = plain(parameter.value)
    return nested(flat)


def declare_overrides(node: Node, given: Sequence[Parameter[Any]] = ()) -> None:
    """Declare whatever a parameter file or a command line says about a node, of any type.

    Args:
        node: The node.
        given: Overrides beside those, as its constructor got them.
    """
    names = {*node.handle.get_parameters(Parameter), *(parameter.name for parameter in given)}
    for name in sorted(names):
        if not node.has_parameter(name):
            node.declare_parameter(name, None, ParameterDescriptor(dynamic_typing=True))


def declare(node: Node, model: type[BaseModel], prefix: str = "") -> dict[str, object]:
    """Declare the fields of a model, described, and with their defaults where they were not given.

    A default that ROS has no type for, such as none at all, cannot be declared; it can be set all the same.

    Args:
        node: The node.
        model: Whose fields.
        prefix: Before every name, with its dot.

    Returns:
        Names and values of those that were not given.
    """
    added: dict[str, object] = {}
    for name, spec in model.model_fields.items():
        full, default = f"{prefix}{spec.alias or name}", spec.get_default(call_default_factory=True)
        value = default.value if isinstance(default, Enum) else default
        descriptor = ParameterDescriptor(name=full, description=spec.description or "", dynamic_typing=True)
        if node.has_parameter(full):
            node.set_descriptor(full, descriptor)
        elif _fits(value):
            added[full] = node.declare_parameter(full, plain(value), descriptor).value
    return added


def undeclare(node: Node, added: Mapping[str, object]) -> None:
    """Take back what `declare` added, but for what has been changed meanwhile."""
    for name, value in added.items():
        if node.has_parameter(name) and node.get_parameter(name).value == value:
            node.undeclare_parameter(name)


def _fits(value: object) -> bool:
    """Whether ROS has a type for it."""
    if isinstance(value, list | tuple):
        return bool(value) and any(all(type(v) is kind for v in value) for kind in (bool, int, float, str))
    return type(value) in {bool, int, float, str}


def parameters_of(node: Node) -> dict[str, object]:
    """All parameters of a node, nested.

    Raises:
        InvalidValue: As `nested`.
    """
    names = node.list_parameters([], 0).names
    return nested({p.name: plain(p.value) for p in node.get_parameters(list(names))})


def unknown_names(
    block: Mapping[str, object], known: Iterable[str], accepted: Iterable[str] = ()
) -> tuple[list[str], list[str]]:
    """The names at the top of a node's parameters that nothing reads.

    One that looks like a misspelt name of ours is a fault: a limit or a topic that is silently not read is a danger.
    Others, such as whole blocks and parameters of other versions of Nav2, are only listed.

    Args:
        block: All parameters of the node.
        known: What is read: parameters, plugins and blocks.
        accepted: What Nav2 has and what means nothing here.

    Returns:
        The faults, one line each, and the names that are not read.
    """
    ours, others = set(known), {*accepted, *OF_EVERY_NODE}
    faults, ignored = [], []
    for name in block:
        if name in ours:
            continue
        hint = closest(name, ours - others, _MISSPELT) if name not in others else ""
        if hint:
            faults.append(f"{name}: unknown parameter{hint}")
        elif name not in OF_EVERY_NODE:
            ignored.append(name)
    return faults, ignored


def _validated(model: type[BaseModel], block: object, owner: str) -> Any:
    """A part of the scenario format from a block of parameters.

    Raises:
        InvalidValue: What breaks its rules, one line per fault.
    """

    def _known(key: tuple[str | int, ...]) -> Iterable[str]:
        place: type[BaseModel] | None = model
        for part in key:
            field = place.model_fields.get(str(part)) if place else None
            inner: Any = field.annotation if field else None
            place = inner if isinstance(inner, type) and issubclass(inner, BaseModel) else None
        return tuple(place.model_fields) if place else ()

    try:
        return model.model_validate(block)
    except ValidationError as error:
        faults = faults_of(error, _known, (owner,), lambda key, value: synonym((owner, *key), value))
        raise InvalidValue("\n".join(f"{'.'.join(map(str, key))}: {message}" for key, message in faults)) from error


@dataclasses.dataclass(frozen=True)
class RobotParameters:
    """The block `robot`: the names of the scenario format, all of them optional.

    Args:
        document: What it says; its outline only counts where `footprint` is not None.
        footprint: The outline that it gives, or None.
    """

    document: RobotDocument
    footprint: Footprint | None

    def robot(self, footprint: Footprint) -> Robot:
        """The robot with this outline.

        Raises:
            InvalidValue: As `Robot`.
        """
        return dataclasses.replace(self.document.value(), footprint=footprint)


def robot_parameters(block: object, owner: str = "robot") -> RobotParameters:
    """What a block `robot` says; the outline may come from elsewhere, a footprint topic.

    Args:
        block: The block, with `footprint` as text or `radius`, `drive`, `turns_in_place`, `tracking.*` and `limits.*`.
        owner: Its name, for messages.

    Raises:
        InvalidValue: What breaks the rules of the scenario format, one line per fault.
    """
    if not isinstance(block, Mapping):
        raise InvalidValue(f"{owner}: must be a block of parameters, got {block!r}")
    has_outline = "footprint" in block or "radius" in block
    document = _validated(RobotDocument, dict(block) if has_outline else {**block, "radius": 1.0}, owner)
    return RobotParameters(document, document.value().footprint if has_outline else None)


def clearance_parameters(block: object, owner: str = "clearance") -> ClearanceRule:
    """What a block `clearance` says; one number holds everywhere, also at the dock.

    Raises:
        InvalidValue: What breaks the rules of the scenario format, one line per fault.
    """
    is_number = isinstance(block, int | float) and not isinstance(block, bool)
    whole = {"required": block, "at_dock": block} if is_number else block
    document: ClearanceDocument = _validated(ClearanceDocument, whole, owner)
    return document.value()
