"""Plugins found by name from entry points; Nav2's class names are aliases."""

from __future__ import annotations

import pathlib
import sys
from dataclasses import dataclass, field
from functools import cache
from importlib.machinery import PathFinder
from importlib.metadata import EntryPoint, entry_points
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar, cast

from optdock.errors import InvalidValue, OptdockError, PluginError
from optdock.geometry.checked import instance
from optdock.model.limits import MotionLimits, SpeedZone
from optdock.plugins.interfaces import (
    Behavior,
    Controller,
    DockType,
    GlobalPlanner,
    GoalChecker,
    Layer,
    Plugin,
    Smoother,
    TimeParameterizer,
)
from optdock.plugins.lifecycle import PluginContext
from optdock.plugins.outcomes import TimingStatus
from optdock.plugins.parameters import closest, parse_parameters

if TYPE_CHECKING:
    from collections.abc import Mapping

    from optdock.model.path import Path
    from optdock.model.problem import DockingProblem
    from optdock.model.trajectory import Trajectory

__all__ = [
    "INTERFACES",
    "PluginChoice",
    "PluginInfo",
    "available_plugins",
    "create_plugin",
    "load_plugin",
    "plugin_class",
    "plugin_from",
    "timed_by",
]

INTERFACES: Mapping[str, type[Plugin]] = {
    "planners": GlobalPlanner,
    "smoothers": Smoother,
    "timing": TimeParameterizer,
    "controllers": Controller,
    "goal_checkers": GoalChecker,
    "behaviors": Behavior,
    "layers": Layer,
    "docks": DockType,
}

# Names in Nav2's pluginlib, without namespace, that differ from entry point names.
_NAV2_ALIASES: Mapping[str, Mapping[str, str]] = {
    "smoothers": {"ConstrainedSmoother": "CasadiSmoother"},
}

_KINDS: Mapping[type[Plugin], str] = {interface: kind for kind, interface in INTERFACES.items()}

P = TypeVar("P", bound=Plugin)


class PluginInfo(NamedTuple):
    """Kind, name and target (`module:Class`) of an installed plugin."""

    kind: str
    name: str
    target: str


@dataclass(frozen=True)
class PluginChoice:
    """Name and parameters of a plugin in a file.

    Raises:
        InvalidValue: If the name is not text.
    """

    name: str
    parameters: Mapping[str, object] = field(default_factory=dict)

    def __post_init__(self) -> None:
        instance(str, self.name, "plugin choice: name")


@cache
def _installed() -> Mapping[str, tuple[EntryPoint, ...]]:
    """Return the entry points of every plugin kind; the files of all installed packages are read once."""
    found = entry_points()
    return {kind: tuple(found.select(group=f"optdock.{kind}")) for kind in INTERFACES}


@cache
def _found(kind: str) -> Mapping[str, EntryPoint]:
    if kind not in INTERFACES:
        raise PluginError(f"plugin kind {kind!r}: must be one of {', '.join(INTERFACES)}")
    found: dict[str, EntryPoint] = {}
    for point in sorted(_installed()[kind], key=lambda p: (p.name, p.value)):
        known = found.setdefault(point.name, point)
        if known.value != point.value:
            raise PluginError(f"{kind}: two plugins are named {point.name}: {known.value} and {point.value}")
    return found


def available_plugins() -> tuple[PluginInfo, ...]:
    """Return every installed plugin, sorted, without importing it."""
    return tuple(PluginInfo(kind, name, point.value) for kind in INTERFACES for name, point in _found(kind).items())


def load_plugin(interface: type[P], name: str) -> type[P]:
    """Return the plugin class called `name`.

    Args:
        interface: One of the interfaces in `INTERFACES`.
        name: Entry point name, or Nav2's `namespace::Class` (old files: `namespace/Class`).

    Raises:
        PluginError: If the name is unknown, the import fails, or the class is not an `interface`.
    """
    kind = _KINDS.get(interface, "")
    if not isinstance(name, str):
        raise PluginError(f"{kind}: a plugin's name must be text, got {name!r}")
    return cast("type[P]", _loaded(kind, name))


@cache  # of the classes found; after an error, the next call tries again
def _loaded(kind: str, name: str) -> type[Plugin]:
    """Return the class of a plugin; see `load_plugin`."""
    found = _found(kind)
    short = name.replace("/", "::").rsplit("::", 1)[-1]
    short = _NAV2_ALIASES.get(kind, {}).get(short, short) if short not in found else short
    if short not in found:
        raise PluginError(f"{kind}: unknown plugin {name!r}{closest(short, found)}; available: {', '.join(found)}")
    point = found[short]
    try:
        loaded: object = point.load()
    except (Exception, SystemExit) as error:  # code of plugins may raise any exception
        why = f"cannot be imported: {error}{_hidden_by(point)}"
        raise PluginError(f"{kind}: plugin {short} ({point.value}) {why}") from error
    if not (isinstance(loaded, type) and issubclass(loaded, INTERFACES[kind])):
        why = f"is not a {INTERFACES[kind].__name__}{_hidden_by(point)}"
        raise PluginError(f"{kind}: plugin {short} ({point.value}) {why}")
    return loaded


def _hidden_by(point: EntryPoint) -> str:
    """Return a hint if a file or folder on Python's path, e.g. next to the script, hides the package of a plugin."""
    package, *inside = point.module.split(".")
    specs = (PathFinder.find_spec(package, [entry]) for entry in sys.path)
    places = [place for spec in specs if spec for place in spec.submodule_search_locations or [spec.origin or ""]]
    found = [pathlib.Path(place).resolve() for place in places]
    modules = {place: place.joinpath(*inside) for place in found}
    holding = [place for place, at in modules.items() if at.is_dir() or at.with_suffix(".py").is_file()]
    if not holding or holding[-1] == found[0]:
        return ""
    what = "folder" if found[0].is_dir() else "file"
    return f"; the {what} {found[0]} hides the package {holding[-1]}: rename that {what}, or start Python elsewhere"


def create_plugin(interface: type[P], name: str, parameters: Mapping[str, object] | None = None) -> P:
    """Return a new plugin.

    Raises:
        PluginError: See `load_plugin`; also if the class is abstract or its constructor fails.
        InvalidValue: If a parameter is unknown, of the wrong type or out of range.
    """
    plugin_class = load_plugin(interface, name)
    values = {} if parameters is None else parameters
    if values:  # validated before the call, because not every name in a file is a valid keyword argument
        parse_parameters(plugin_class.Parameters, values, plugin_class.__name__)
    try:
        return plugin_class(**values)
    except OptdockError:
        raise
    except Exception as error:  # code of plugins may raise any exception
        target = f"{plugin_class.__module__}:{plugin_class.__qualname__}"
        raise PluginError(f"plugin {name} ({target}) cannot be built: {error}") from error


def plugin_from(interface: type[P], asked: str | PluginChoice | P, role: str) -> P:
    """Return a plugin given by name, by name with parameters, or as an object.

    Args:
        interface: Required interface.
        asked: Name, choice, or plugin.
        role: Name of the argument, for messages.

    Raises:
        PluginError: See `create_plugin`.
        InvalidValue: If `asked` is neither a name nor a choice nor a plugin, or a parameter is wrong.
    """
    if isinstance(asked, str):
        return create_plugin(interface, asked)
    if isinstance(asked, interface):
        return asked
    if isinstance(asked, PluginChoice):
        return create_plugin(interface, asked.name, asked.parameters)
    if isinstance(asked, type):
        raise InvalidValue(
            f"{role}: must be a {interface.__name__}, got the class {asked.__name__}; write {asked.__name__}()"
        )
    raise InvalidValue(f"{role}: must be a {interface.__name__} or its name, got {type(asked).__name__}")


def timed_by(  # noqa: PLR0913 - method, path, limits and start state
    timing: str | PluginChoice | TimeParameterizer,
    path: Path,
    problem: DockingProblem | None,
    *,
    zone: SpeedZone | None = None,
    start_speed: float = 0.0,
    start_acceleration: float = 0.0,
    start_wait: float = 0.0,
) -> Trajectory:
    """Return the motion that a time parameterizer computes along a path, without a certificate.

    Args:
        timing: Name, name with parameters, or an unconfigured plugin.
        path: Path.
        problem: Problem with the limits and the dock; None: default limits.
        zone: Speed zone at the end of the path; None: the speed zone of the problem's dock.
        start_speed: Speed in the direction of travel, >= 0 in both gears [m/s].
        start_acceleration: Acceleration in the direction of travel [m/s^2].
        start_wait: Time at rest at the start, for steering [s].

    Raises:
        FailedToTimePath: If the method finds no motion from this start that satisfies the limits.
        PluginError: See `create_plugin`.
        LifecycleError: If the plugin is already configured.
        InvalidValue: If a parameter or the start state is wrong.
    """
    parameterizer = plugin_from(TimeParameterizer, timing, "timing")
    limits, approach = (problem.robot.limits, problem.dock.approach) if problem else (MotionLimits(), SpeedZone())
    waits: dict[str, Any] = {"start_wait": start_wait} if start_wait > 0.0 else {}
    parameterizer.configure(PluginContext(name=parameterizer.name, problem=problem))
    try:
        result = parameterizer.parameterize(
            path,
            limits,
            approach if zone is None else zone,
            start_speed=start_speed,
            start_acceleration=start_acceleration,
            **waits,
        )
    finally:
        parameterizer.cleanup()
    if result.status is not TimingStatus.OK or result.trajectory is None:
        raise result.failure()
    return result.trajectory


def plugin_class(name: str) -> type[Plugin]:
    """Return the installed plugin class called `name`, of any kind.

    Raises:
        PluginError: If there is no such plugin of any kind, or it cannot be imported.
    """
    for kind, interface in INTERFACES.items():
        if name in _found(kind):
            return load_plugin(interface, name)
    raise PluginError(f"unknown plugin {name!r}: no installed distribution has an entry point of that name")
