"""ROS parameters as nested blocks, validated by the models of the plugins and of the scenario format.

ROS stores parameters under flat, dotted names with one type each. This module nests them as in the parameter file and
collects the faults of all blocks, so that a server reports them together.
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

from optdock.config.scenario_keys import ClearanceDocument, RobotDocument, known_keys, synonym
from optdock.errors import InvalidValue, OptdockError
from optdock.io.faults import faults_of
from optdock.model.robot import Robot
from optdock.nav2.declared_parameters import Block, names_of
from optdock.plugins.parameters import PluginParameters, closest

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from rclpy.node import Node

    from optdock.geometry.footprint import Footprint
    from optdock.model.clearance_rule import ClearanceRule

T = TypeVar("T")

__all__ = [
    "BlockReader",
    "RobotParameters",
    "ServerParameters",
    "clearance_parameters",
    "declare",
    "declare_overrides",
    "nested",
    "parameters_of",
    "plain",
    "robot_parameters",
    "undeclare",
    "unknown_names",
]


class ServerParameters(PluginParameters):
    """Parameters of every server, at the top of a node's parameters."""

    autostart: bool = Field(default=False, description="configure and activate at once, without a lifecycle manager")
    autostart_node: bool = Field(default=False, description="Nav2's name of autostart")
    bond_heartbeat_period: float = Field(
        0.1, ge=0, description="period of the heartbeat to the lifecycle manager; 0: no bond [s]"
    )


# difflib ratio: one letter in ten. Nav2's own names stay below it: `map_topic` and `costmap_topic` have 0.82,
# `local_footprint_topic` and `footprint_topic` 0.83.
_MISSPELT = 0.86


class BlockReader:
    """Reader of nested parameters that collects `faults`, one line each, and `ignored`, names that are not read."""

    def __init__(self, block: Mapping[str, object]) -> None:
        self.block = block
        self.faults: list[str] = []
        self.ignored: list[str] = []

    def inner(self, name: str, block: Mapping[str, object] | None = None) -> Mapping[str, object]:
        """Return the block `name` of the parameters or of `block`; empty if it is missing."""
        found = (self.block if block is None else block).get(name, {})
        if isinstance(found, Mapping):
            return found
        self.faults.append(f"{name}: must be a block of parameters, got {found!r}")
        return {}

    def attempt(self, make: Callable[[], T], default: T) -> T:
        """Return the result of `make`, or the default after an `OptdockError`, whose lines become faults."""
        try:
            return make()
        except OptdockError as error:
            self.faults.extend(str(error).splitlines())
            return default

    def known(
        self, given: Mapping[str, object], fields: Iterable[str], place: Block, owner: str = ""
    ) -> dict[str, object]:
        """Return the entries of a block with known names; misspelt names become faults, the others are ignored."""
        names, prefix = set(fields), owner and f"{owner}."
        wrong, ignored = unknown_names(given, names, place)
        self.faults.extend(f"{prefix}{line}" for line in wrong)
        self.ignored.extend(f"{prefix}{key}" for key in ignored)
        return {key: value for key, value in given.items() if key in names}

    def check(self) -> None:
        """Raise `InvalidValue` if there are faults, with one line per fault."""
        if self.faults:
            raise InvalidValue("\n".join(dict.fromkeys(self.faults)))


def plain(value: object) -> object:
    """Return a ROS parameter's value as plain Python; YAML's `[]` has no ROS type and becomes an empty list."""
    if value is None:
        return []
    return list(value) if isinstance(value, array.array | np.ndarray | tuple) else value


def nested(flat: Mapping[str, object]) -> dict[str, object]:
    """Return nested blocks from dotted names; raise `InvalidValue` if a name is both a value and a block.

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
                raise InvalidValue(f"{'.'.join(path[: n + 1])}: is both a value and a block with {name}")
            place = inner
        if isinstance(place.get(last), dict):
            raise InvalidValue(f"{name}: is both a value and a block")
        place[last] = value
    return block


def parameters_of(node: Node, changes: Iterable[Parameter[Any]] = ()) -> dict[str, object]:
    """Return all parameters of a node after changes, as by `nested`; a parameter that is unset is left out."""
    names = list(node.list_parameters([], 0).names)
    flat = {parameter.name: plain(parameter.value) for parameter in node.get_parameters(names)}
    for parameter in changes:
        if parameter.type_ == Parameter.Type.NOT_SET:
            flat.pop(parameter.name, None)
        else:
            flat[parameter.name] = plain(parameter.value)
    return nested(flat)


def declare_overrides(node: Node, given: Sequence[Parameter[Any]] = ()) -> None:
    """Declare all parameters of files and command line, and those given to the node's constructor, with any type."""
    names = {*node.handle.get_parameters(Parameter), *(parameter.name for parameter in given)}
    for name in sorted(names):
        if not node.has_parameter(name):
            node.declare_parameter(name, None, ParameterDescriptor(dynamic_typing=True))


def declare(node: Node, model: type[BaseModel], prefix: str = "") -> dict[str, object]:
    """Declare the fields of a model with description and default, and return those that were not declared before.

    A default without a ROS type, such as None, is not declared; the parameter can still be set.
    """
    added: dict[str, object] = {}
    for name, spec in model.model_fields.items():
        full, default = f"{prefix}{spec.alias or name}", spec.get_default(call_default_factory=True)
        value = default.value if isinstance(default, Enum) else default
        descriptor = ParameterDescriptor(name=full, description=spec.description or "", dynamic_typing=True)
        if node.has_parameter(full):
            node.set_descriptor(full, descriptor)
        elif _has_ros_type(value):
            added[full] = node.declare_parameter(full, plain(value), descriptor).value
    return added


def undeclare(node: Node, added: Mapping[str, object]) -> None:
    """Undeclare the parameters that `declare` added and whose values have not changed."""
    for name, value in added.items():
        if node.has_parameter(name) and node.get_parameter(name).value == value:
            node.undeclare_parameter(name)


def _has_ros_type(value: object) -> bool:
    if isinstance(value, list | tuple):
        return bool(value) and any(all(type(v) is kind for v in value) for kind in (bool, int, float, str))
    return type(value) in {bool, int, float, str}


def unknown_names(block: Mapping[str, object], known: Iterable[str], place: Block) -> tuple[list[str], list[str]]:
    """Return fault lines for the misspelt names of a block, and the other names that are not read.

    A misspelt name is a fault, because a limit or a topic that is silently ignored is dangerous. Other names, such as
    parameters of Nav2 without an effect at this place, are only listed; those of every node are not.
    """
    ours, everywhere = set(known), names_of(Block.ANY_NODE)
    others = everywhere | names_of(place)
    faults, ignored = [], []
    for name in block:
        if name in ours:
            continue
        hint = closest(name, ours, _MISSPELT) if name not in others else ""
        if hint:
            faults.append(f"{name}: unknown parameter{hint}")
        elif name not in everywhere:
            ignored.append(name)
    return faults, ignored


def _validated(model: type[BaseModel], block: object, owner: str) -> Any:
    """Return a section of the scenario format from a block of parameters, or raise `InvalidValue`."""
    try:
        return model.model_validate(block)
    except ValidationError as error:
        faults = faults_of(
            error,
            lambda key: known_keys((owner, *key)),
            (owner,),
            lambda key, value: synonym((owner, *key), value),
        )
        raise InvalidValue("\n".join(f"{'.'.join(map(str, key))}: {message}" for key, message in faults)) from error


@dataclasses.dataclass(frozen=True)
class RobotParameters:
    """Parameters of the block `robot`; the outline in `document` is a placeholder if `footprint` is None."""

    document: RobotDocument
    footprint: Footprint | None

    def robot(self, footprint: Footprint) -> Robot:
        """Return the robot with this outline, or raise `InvalidValue` as `Robot`."""
        return dataclasses.replace(self.document.value(), footprint=footprint)


def robot_parameters(block: object) -> RobotParameters:
    """Return the block `robot` in the names of the scenario format; all keys are optional, `footprint` is text.

    Raises:
        InvalidValue: If the block breaks the scenario format; one line per fault.
    """
    if not isinstance(block, Mapping):
        raise InvalidValue(f"robot: must be a block of parameters, got {block!r}")
    has_outline = "footprint" in block or "radius" in block
    document = _validated(RobotDocument, dict(block) if has_outline else {**block, "radius": 1.0}, "robot")
    return RobotParameters(document, document.value().footprint if has_outline else None)


def clearance_parameters(block: object) -> ClearanceRule:
    """Return the clearance of a block `clearance`, or of one number, which also holds at the dock.

    Raises:
        InvalidValue: If the block breaks the scenario format; one line per fault.
    """
    is_number = isinstance(block, int | float) and not isinstance(block, bool)
    whole = {"required": block, "at_dock": block} if is_number else block
    document: ClearanceDocument = _validated(ClearanceDocument, whole, "clearance")
    return document.value()
