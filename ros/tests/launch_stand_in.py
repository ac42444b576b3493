"""The part of `launch` and `launch_ros` that the package's launch files use; neither can be installed from PyPI.

It evaluates a launch file to the command lines of its processes, in the order of launch_ros. Substitutions in parameter
files, signals, respawning and events are missing.
"""

from __future__ import annotations

import sys
import types
from dataclasses import dataclass, field
from importlib.machinery import SourceFileLoader
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import pytest
import yaml

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

PACKAGE = Path(__file__).parents[1] / "optdock_ros"


class Started(NamedTuple):
    """A process: its executable and the rest of its command line."""

    executable: str
    arguments: tuple[str, ...]


@dataclass
class Context:
    """The values of the arguments, and the folder of new files."""

    folder: Path
    launch_configurations: dict[str, str] = field(default_factory=dict)


@dataclass
class LaunchDescription:
    """The content of a launch file."""

    initial_entities: Sequence[Any]


@dataclass
class DeclareLaunchArgument:
    """An argument of a launch file; a value that is set already is kept, also that of an including launch file."""

    name: str
    default_value: str
    description: str


@dataclass
class OpaqueFunction:
    """A function that returns further actions."""

    function: Callable[[Context], Sequence[Any]]


@dataclass
class IncludeLaunchDescription:
    """The inclusion of another launch file."""

    launch_description_source: Path
    launch_arguments: Iterable[tuple[str, str]] = ()


@dataclass
class ParameterFile:
    """A parameter file; here without substitutions."""

    param_file: str
    allow_substs: bool = False


@dataclass(kw_only=True)
class Node:
    """A process with a ROS node; name and namespace are given."""

    package: str
    executable: str
    name: str
    namespace: str
    parameters: Sequence[ParameterFile | dict[str, object]]
    remappings: Sequence[tuple[str, str]]
    arguments: Sequence[str]
    output: str

    def started(self, folder: Path) -> Started:
        """Return the process; as in launch_ros, parameters of a dictionary are those of the node's full name."""
        assert self.package == "optdock_ros"
        assert self.namespace.startswith("/"), "a relative namespace is appended to a pushed one"
        found = [*self.arguments, "--ros-args", "-r", f"__node:={self.name}", "-r", f"__ns:={self.namespace}"]
        for number, parameters in enumerate(self.parameters):
            if isinstance(parameters, ParameterFile):
                file = parameters.param_file
                assert parameters.allow_substs == ("$(" in Path(file).read_text())
            else:
                full_name = f"{self.namespace.rstrip('/')}/{self.name}"
                file = str(folder / f"{full_name.replace('/', '-')}-{number}.yaml")
                Path(file).write_text(yaml.safe_dump({full_name: {"ros__parameters": parameters}}))
            found += ["--params-file", file]
        for rule in self.remappings:
            found += ["-r", ":=".join(rule)]
        return Started(self.executable, tuple(found))


MODULES: dict[str, dict[str, Any]] = {
    "launch": {"LaunchDescription": LaunchDescription},
    "launch.actions": {
        kind.__name__: kind for kind in (DeclareLaunchArgument, IncludeLaunchDescription, OpaqueFunction)
    },
    "launch.launch_description_sources": {"PythonLaunchDescriptionSource": Path},
    "launch.substitutions": {"PathJoinSubstitution": lambda parts: Path(*parts)},
    "launch_ros": {},
    "launch_ros.actions": {"Node": Node},
    "launch_ros.parameter_descriptions": {"ParameterFile": ParameterFile},
    "launch_ros.substitutions": {"FindPackageShare": {"optdock_ros": PACKAGE}.__getitem__},
}


def launched(file: str | Path, folder: Path, **arguments: str) -> list[Started]:
    """Return the processes of `ros2 launch optdock_ros FILE NAME:=VALUE ...`; `folder` is for parameter files.

    The argument `ros_namespace` is a namespace that an including launch file has pushed.
    """
    with pytest.MonkeyPatch.context() as patch:
        for name, members in MODULES.items():
            patch.setitem(sys.modules, name, module := types.ModuleType(name))
            module.__dict__.update(members)
        return list(_launched(PACKAGE / "launch" / file, Context(folder, dict(arguments))))


def _launched(file: Path, context: Context) -> Iterator[Started]:
    loader = SourceFileLoader("python_launch_file", str(file))
    module = types.ModuleType(loader.name)
    module.__file__ = str(file)
    loader.exec_module(module)
    entities = list(module.generate_launch_description().initial_entities)
    while entities:
        entity = entities.pop(0)
        if isinstance(entity, DeclareLaunchArgument):
            context.launch_configurations.setdefault(entity.name, entity.default_value)
        elif isinstance(entity, OpaqueFunction):
            entities = [*entity.function(context), *entities]
        elif isinstance(entity, IncludeLaunchDescription):
            context.launch_configurations |= dict(entity.launch_arguments)
            yield from _launched(entity.launch_description_source, context)
        else:
            yield entity.started(context.folder)
