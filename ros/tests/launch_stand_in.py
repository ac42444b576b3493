"""As much of `launch` and `launch_ros` as the package's launch files use, to run them where neither can be installed.

It takes the arguments that those take and refuses others, resolves substitutions as they do, and says which processes
would be started with which arguments. What `ros2 launch` adds (signals, respawning, events) is not here.
"""

from __future__ import annotations

import importlib.util
import sys
import types
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import pytest
import yaml

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

PACKAGE = Path(__file__).parents[1] / "optdock_ros"


class Started(NamedTuple):
    """A process that would be started: its executable, and everything behind it on the command line."""

    executable: str
    arguments: tuple[str, ...]


class Substitution:
    """Text that is known when the launch file runs."""

    def text(self, values: Mapping[str, str]) -> str:
        """With the values of the launch arguments."""
        raise NotImplementedError


class LaunchConfiguration(Substitution):
    """The value of a launch argument."""

    def __init__(self, variable_name: str) -> None:
        self.name = variable_name

    def text(self, values: Mapping[str, str]) -> str:
        """Of the argument, which must have been declared."""
        return values[self.name]


class FindPackageShare(Substitution):
    """Where a package's files are; here in the sources."""

    def __init__(self, package: str) -> None:
        assert package == "optdock_ros"

    def text(self, values: Mapping[str, str]) -> str:  # noqa: ARG002 - as the others
        """Of the only package there is."""
        return str(PACKAGE)


class PathJoinSubstitution(Substitution):
    """A path of parts."""

    def __init__(self, substitutions: Iterable[Any]) -> None:
        self.parts = tuple(substitutions)

    def text(self, values: Mapping[str, str]) -> str:
        """Joined."""
        return str(Path(*(text(part, values) for part in self.parts)))


class ParameterValue:
    """A parameter of a certain type."""

    def __init__(self, value: Any, *, value_type: type) -> None:
        self.value, self.type = value, value_type

    def resolved(self, values: Mapping[str, str]) -> Any:
        """Of its type, or it is an error."""
        found = yaml.safe_load(text(self.value, values))
        assert isinstance(found, self.type), f"{found!r} is no {self.type.__name__}"
        return found


class IfCondition:
    """Whether an action is carried out."""

    def __init__(self, predicate_expression: Any) -> None:
        self.expression = predicate_expression

    def holds(self, values: Mapping[str, str]) -> bool:
        """True or false, in words."""
        return {"true": True, "1": True, "false": False, "0": False}[text(self.expression, values).lower()]


class DeclareLaunchArgument:
    """An argument of a launch file."""

    def __init__(self, name: str, *, default_value: Any = None, description: str = "", choices: Any = None) -> None:
        self.name, self.default, self.description, self.choices = name, default_value, description, choices


class PythonLaunchDescriptionSource:
    """Another launch file."""

    def __init__(self, launch_file_path: Any) -> None:
        self.path = launch_file_path


class IncludeLaunchDescription:
    """All of another launch file."""

    def __init__(self, launch_description_source: Any, *, launch_arguments: Iterable[tuple[str, Any]] = ()) -> None:
        self.source, self.arguments = launch_description_source, tuple(launch_arguments)


class Node:
    """A process with a ROS node."""

    def __init__(
        self,
        *,
        package: str,
        executable: str,
        name: str | None = None,
        namespace: Any = "",
        parameters: Sequence[Any] = (),
        remappings: Sequence[tuple[str, Any]] = (),
        arguments: Sequence[Any] = (),
        output: str = "log",
        condition: IfCondition | None = None,
    ) -> None:
        assert package == "optdock_ros"
        assert output in {"log", "screen", "both", "own_log", "full"}
        self.executable, self.name, self.namespace = executable, name, namespace
        self.parameters, self.remappings, self.arguments = parameters, remappings, arguments
        self.condition = condition

    def started(self, values: Mapping[str, str], folder: Path) -> Started:
        """In the order of launch_ros: own arguments, then name, namespace, parameters and remappings."""
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


class LaunchDescription:
    """What a launch file does."""

    def __init__(self, initial_entities: Iterable[Any]) -> None:
        self.entities = tuple(initial_entities)


def text(value: Any, values: Mapping[str, str]) -> str:
    """Of a substitution or a text."""
    if isinstance(value, Substitution):
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
    """What `ros2 launch optdock_ros FILE NAME:=VALUE ...` would start.

    Args:
        file: Name of a launch file of the package, or a path.
        folder: For files of parameters that it writes.
        **arguments: Launch arguments.
    """
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
    entities = module.generate_launch_description().entities
    declared = [entity for entity in entities if isinstance(entity, DeclareLaunchArgument)]
    assert set(arguments) <= {argument.name for argument in declared}, "no such launch argument"
    values: dict[str, str] = {}
    for argument in declared:
        assert argument.description, f"{argument.name}: has no description"
        values[argument.name] = arguments.get(argument.name) or text(argument.default, values)
    for entity in entities:
        if isinstance(entity, Node) and (entity.condition is None or entity.condition.holds(values)):
            yield entity.started(values, folder)
        elif isinstance(entity, IncludeLaunchDescription):
            inner = {name: text(value, values) for name, value in entity.arguments}
            yield from _launched(Path(text(entity.source.path, values)), folder, inner)
