"""The part of `launch` and `launch_ros` that the package's launch files use; neither can be installed from PyPI.

It rejects unknown arguments, resolves substitutions, and returns the processes with their arguments. Signals,
respawning and events of `ros2 launch` are missing.
"""

from __future__ import annotations

import importlib.util
import sys
import types
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import pytest
import yaml

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

PACKAGE = Path(__file__).parents[1] / "optdock_ros"


class Started(NamedTuple):
    """A process: its executable and the rest of its command line."""

    executable: str
    arguments: tuple[str, ...]


@dataclass
class LaunchConfiguration:
    """The value of a declared launch argument."""

    variable_name: str

    def text(self, values: Mapping[str, str]) -> str:
        """Return the value."""
        return values[self.variable_name]


@dataclass
class FindPackageShare:
    """The folder of this package; here that of the sources."""

    package: str

    def text(self, values: Mapping[str, str]) -> str:  # noqa: ARG002 - as the others
        """Return the folder."""
        assert self.package == "optdock_ros"
        return str(PACKAGE)


@dataclass
class PathJoinSubstitution:
    """A path of parts."""

    substitutions: Sequence[Any]

    def text(self, values: Mapping[str, str]) -> str:
        """Return the joined path."""
        return str(Path(*(text(part, values) for part in self.substitutions)))


class ParameterValue:
    """A parameter of a given type."""

    def __init__(self, value: Any, *, value_type: type) -> None:
        self.value, self.type = value, value_type

    def resolved(self, values: Mapping[str, str]) -> Any:
        """Return the value, which must be of the type."""
        found = yaml.safe_load(text(self.value, values))
        assert isinstance(found, self.type), f"{found!r} is no {self.type.__name__}"
        return found


@dataclass
class IfCondition:
    """A condition of an action."""

    predicate_expression: Any

    def holds(self, values: Mapping[str, str]) -> bool:
        """Whether the action is carried out."""
        return {"true": True, "1": True, "false": False, "0": False}[text(self.predicate_expression, values).lower()]


@dataclass
class DeclareLaunchArgument:
    """An argument of a launch file."""

    name: str
    default_value: Any = None
    description: str = ""
    choices: Any = None


@dataclass
class PythonLaunchDescriptionSource:
    """A launch file."""

    launch_file_path: Any


@dataclass
class IncludeLaunchDescription:
    """The inclusion of another launch file."""

    launch_description_source: Any
    launch_arguments: Iterable[tuple[str, Any]] = ()


@dataclass(kw_only=True)
class Node:
    """A process with a ROS node."""

    package: str
    executable: str
    name: str | None = None
    namespace: Any = ""
    parameters: Sequence[Any] = ()
    remappings: Sequence[tuple[str, Any]] = ()
    arguments: Sequence[Any] = ()
    output: str = "log"
    condition: IfCondition | None = None

    def __post_init__(self) -> None:
        assert self.package == "optdock_ros"
        assert self.output in {"log", "screen", "both", "own_log", "full"}

    def started(self, values: Mapping[str, str], folder: Path) -> Started:
        """Return the process, with its arguments in the order of launch_ros."""
        found = [text(argument, values) for argument in self.arguments]
        found += ["--ros-args"]
        found += ["-r", f"__node:={self.name}"] if self.name else []
        namespace = text(self.namespace, values)
        found += ["-r", f"__ns:=/{namespace.strip('/')}"] if namespace else []
        for number, parameters in enumerate(self.parameters):
            if isinstance(parameters, dict):
                resolved = {
                    key: value.resolved(values) if isinstance(value, ParameterValue) else value
                    for key, value in parameters.items()
                }
                file = folder / f"{self.executable}-{number}.yaml"
                file.write_text(yaml.safe_dump({"/**": {"ros__parameters": resolved}}))
                found += ["--params-file", str(file)]
            else:
                found += ["--params-file", text(parameters, values)]
        for origin, target in self.remappings:
            found += ["-r", f"{origin}:={text(target, values)}"]
        return Started(self.executable, tuple(found))


@dataclass
class LaunchDescription:
    """The content of a launch file."""

    initial_entities: Sequence[Any]


def text(value: Any, values: Mapping[str, str]) -> str:
    """Return a text, or the text of a substitution."""
    if isinstance(value, LaunchConfiguration | FindPackageShare | PathJoinSubstitution):
        return value.text(values)
    assert isinstance(value, str), f"{value!r}: must be text or a substitution"
    return value


MODULES = {
    "launch": (LaunchDescription,),
    "launch.actions": (DeclareLaunchArgument, IncludeLaunchDescription),
    "launch.conditions": (IfCondition,),
    "launch.launch_description_sources": (PythonLaunchDescriptionSource,),
    "launch.substitutions": (LaunchConfiguration, PathJoinSubstitution),
    "launch_ros": (),
    "launch_ros.actions": (Node,),
    "launch_ros.parameter_descriptions": (ParameterValue,),
    "launch_ros.substitutions": (FindPackageShare,),
}


def launched(file: str | Path, folder: Path, **arguments: str) -> list[Started]:
    """Return the processes of `ros2 launch optdock_ros FILE NAME:=VALUE ...`; `folder` is for parameter files."""
    with pytest.MonkeyPatch.context() as patch:
        for name, members in MODULES.items():
            module = types.ModuleType(name)
            module.__dict__.update({member.__name__: member for member in members})
            patch.setitem(sys.modules, name, module)
        return list(_launched(PACKAGE / "launch" / file, folder, arguments))


def _launched(file: Path, folder: Path, arguments: Mapping[str, str]) -> Iterator[Started]:
    spec = importlib.util.spec_from_file_location(f"launch_file_{file.name.partition('.')[0]}", file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    entities = module.generate_launch_description().initial_entities
    declared = [entity for entity in entities if isinstance(entity, DeclareLaunchArgument)]
    assert set(arguments) <= {argument.name for argument in declared}, "no such launch argument"
    values: dict[str, str] = {}
    for argument in declared:
        assert argument.description, f"{argument.name}: has no description"
        values[argument.name] = arguments.get(argument.name) or text(argument.default_value, values)
    for entity in entities:
        if isinstance(entity, Node) and (entity.condition is None or entity.condition.holds(values)):
            yield entity.started(values, folder)
        elif isinstance(entity, IncludeLaunchDescription):
            inner = {name: text(value, values) for name, value in entity.launch_arguments}
            yield from _launched(Path(text(entity.launch_description_source.launch_file_path, values)), folder, inner)
