"""Rules that all plugins share, and assertions of the suites."""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import partial
from typing import TYPE_CHECKING, ClassVar, Generic, TypeVar

from optdock.errors import InvalidValue, OptdockError
from optdock.geometry.pose import Pose2, normalize_angle
from optdock.plugins.lifecycle import LifecycleState, Plugin, PluginContext
from optdock.testing.contracts.contract_scene import scene_context

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from optdock.model.path import Path

__all__ = [
    "ContractBroken",
    "PluginContract",
    "attempted",
    "refused",
    "require",
    "require_cancellable",
    "require_same_ends",
    "sampled",
]

P = TypeVar("P", bound=Plugin)
T = TypeVar("T")

_CANCEL_AT = (1, 2, 100)  # numbers of polls; numbers that a plugin never reaches are skipped
_SAME = 1e-6  # [m], [rad]


class ContractBroken(AssertionError):
    """A plugin violates a rule of its interface; the message names the rule and the values."""


def require(holds: object, rule: str) -> None:
    """Raise ContractBroken with the text of the rule if `holds` is false.

    Raises:
        ContractBroken: If `holds` is false.

    >>> require(1.0 <= 2.0, "one is at most two")
    """
    if not holds:
        raise ContractBroken(rule)


def refused(call: Callable[[], object], error: type[Exception], rule: str) -> Exception:
    """Return the exception of type `error` that `call` raises.

    Raises:
        ContractBroken: If the call returns, or raises a different exception.

    >>> str(refused(lambda: int("x"), ValueError, "text is not a number"))[:15]
    'invalid literal'
    """
    try:
        returned = call()
    except error as found:
        return found
    except Exception as found:
        raise ContractBroken(f"{rule}: wanted {error.__name__}, got {type(found).__name__}: {found}") from found
    raise ContractBroken(f"{rule}: wanted {error.__name__}, got the result {returned!r}")


def attempted(call: Callable[[], T], error: type[Exception]) -> T | None:
    """Return the result of a call, or None if it raises `error`, which must have a message."""
    try:
        return call()
    except error as refusal:
        require(str(refusal), f"{type(refusal).__name__} has a message")
        return None


class _PollCounter:
    """Cancel checker that returns True at poll number `cancel_at` and later; 0: never."""

    def __init__(self, cancel_at: int = 0) -> None:
        self.polls, self._cancel_at = 0, cancel_at

    def __call__(self) -> bool:
        self.polls += 1
        return 0 < self._cancel_at <= self.polls


def require_cancellable(run: Callable[[Callable[[], bool]], object], error: type[Exception]) -> None:
    """Require that `run(cancel_checker)` polls, and raises `error` after a first, second or hundredth poll."""
    patient = _PollCounter()
    run(patient)
    require(patient.polls >= 1, "the cancel checker is polled at least once")
    for poll in _CANCEL_AT:
        if poll <= patient.polls:
            counter = _PollCounter(poll)
            refused(partial(run, counter), error, f"if poll {poll} returns True, the call ends")
            require(counter.polls == poll, f"if poll {poll} returns True, no poll follows, got {counter.polls} polls")


def require_same_ends(path: Path, start: Pose2, end: Pose2) -> None:
    """Require that a path leads from `start` to `end`, within 1e-6 m and 1e-6 rad."""
    for which, found, wanted in (("begins", path.start, start), ("ends", path.end, end)):
        turn = abs(normalize_angle(found.yaw - wanted.yaw))
        same = found.distance_to(wanted) <= _SAME and turn <= _SAME  # False for NaN
        require(same, f"the path {which} at {wanted}, got {found}")


def sampled(path: Path) -> tuple[tuple[float, ...], ...]:
    """Return the poses of a path every 10 cm, comparable with `==`."""
    return tuple(map(tuple, path.sample(0.1).poses.tolist()))


class PluginContract(ABC, Generic[P]):
    """Rules of `optdock.plugins.lifecycle.Plugin` and `optdock.plugins.parameters.PluginParameters`.

    Attributes:
        interface: Interface that the plugin implements.
        needs_context: Whether the plugin works only after it is configured.
        unitless: Names of parameters that are dimensionless, whose descriptions have no unit.
        plugin_parameters: Parameters of the plugin in a suite from `installed_suites`.
    """

    interface: ClassVar[type[Plugin]]
    needs_context: ClassVar[bool] = False
    unitless: ClassVar[frozenset[str]] = frozenset()
    plugin_parameters: ClassVar[Mapping[str, object]] = {}

    @abstractmethod
    def make_plugin(self) -> P:
        """Return a new plugin, not configured."""

    @abstractmethod
    def exercise(self, plugin: P) -> object:
        """Use the plugin once and return its results, comparable with `==`."""

    def make_context(self) -> PluginContext:
        """Return a new context for the plugin in every call."""
        return scene_context()

    def ready_plugin(self) -> P:
        """Return a new plugin, configured and active."""
        plugin = self.make_plugin()
        self._walk(plugin, "configure", "activate")
        return plugin

    def test_it_is_built_in_one_call(self) -> None:
        """`Plugin`: it implements its interface, is unconfigured after construction, and rejects unknown parameters."""
        plugin = self.make_plugin()
        require(isinstance(plugin, self.interface), f"it is a {self.interface.__name__}")
        require(plugin.state is LifecycleState.UNCONFIGURED, "a new plugin is unconfigured")
        require(self.make_plugin() is not plugin, "make_plugin returns a new plugin in every call")
        refused(lambda: type(plugin)(no_such_parameter=1), InvalidValue, "an unknown parameter is refused")

    def test_every_parameter_is_described_with_its_unit(self) -> None:
        """`PluginParameters`: every field has a description with the unit in brackets."""
        plugin = self.make_plugin()
        values = plugin.parameters.model_dump(by_alias=True)
        for name, spec in type(plugin.parameters).model_fields.items():
            known, text = spec.alias or name, spec.description or ""
            require(text, f"parameter {known} has a description")
            has_unit = ("[" in text and "]" in text) or known in self.unitless or not isinstance(values[known], float)
            require(has_unit, f"parameter {known}: the unit is in brackets, or `unitless` has its name; got {text!r}")

    def test_a_change_has_the_effect_of_the_constructor(self) -> None:
        """`Plugin.set_parameters`: values that were derived from the parameters are updated."""
        for name, value in _accepted_changes(self.make_plugin).items():
            changed = self.ready_plugin()
            changed.set_parameters(**{name: value})
            built = type(changed)(**changed.parameters.model_dump(by_alias=True))
            self._walk(built, "configure", "activate")
            require(self._outcome(changed) == self._outcome(built), f"{name} = {value} takes effect")

    def test_it_works_at_every_stage(self) -> None:
        """`Plugin`: results are equal at every stage; without a required context, the plugin raises an OptdockError."""
        plugin = self.make_plugin()
        if self.needs_context:
            refused(lambda: self.exercise(plugin), OptdockError, "an unconfigured plugin raises an OptdockError")
        else:
            self.exercise(plugin)
        context = self.make_context()
        plugin.configure(context)
        require(plugin.context is context, "a configured plugin has its context")
        inactive = self.exercise(plugin)
        plugin.activate()
        require(self.exercise(plugin) == inactive, "an active plugin has the same results as an inactive plugin")
        self._walk(plugin, "deactivate", "cleanup")
        require(plugin.context is not context, "cleanup releases the context")
        plugin.configure(self.make_context())
        require(self.exercise(plugin) == inactive, "a plugin configured again has the same results as before")

    def test_equal_calls_have_equal_results(self) -> None:
        """`Plugin`: a second call and another instance give equal results; instances share no state."""
        plugin, other = self.ready_plugin(), self.ready_plugin()
        expected, defaults = self.exercise(plugin), other.parameters.model_dump()
        require(self.exercise(plugin) == expected, "a second call has the same result")
        for name, value in list(_accepted_changes(self.make_plugin).items())[:3]:
            busy = self.ready_plugin()
            self.exercise(busy)
            busy.set_parameters(**{name: value})
            require(other.parameters.model_dump() == defaults, f"a change of {name} stays in its instance")
        require(self.exercise(other) == expected, "other instances have no influence on the result")

    def _outcome(self, plugin: P) -> object:
        """Return the result of the plugin, or the name of its error."""
        try:
            return self.exercise(plugin)
        except OptdockError as error:
            return type(error).__name__

    def _walk(self, plugin: Plugin, *transitions: str) -> None:
        for transition in transitions:
            if transition == "configure":
                plugin.configure(self.make_context())
            else:
                getattr(plugin, transition)()


def _accepted_changes(make_plugin: Callable[[], Plugin]) -> dict[str, object]:
    """Return another accepted value for every number and switch that can be changed separately."""
    found: dict[str, object] = {}
    for name, value in make_plugin().parameters.model_dump(by_alias=True).items():
        for candidate in _others(value):
            try:
                make_plugin().set_parameters(**{name: candidate})
            except InvalidValue:
                continue
            found[name] = candidate
            break
    return found


def _others(value: object) -> Sequence[object]:
    if isinstance(value, bool):
        return (not value,)
    if isinstance(value, int):
        return (value + 1, value - 1, value + 2, value - 2)
    if isinstance(value, float):
        return (1.25 * value, 0.8 * value, value + 0.1, value - 0.1) if value else (0.1, -0.1)
    return ()
