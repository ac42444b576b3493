"""What every plugin promises, whatever it does: parameters, lifecycle, independence of instances."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from functools import partial
from typing import TYPE_CHECKING, ClassVar, Generic, TypeVar

from optdock.errors import InvalidValue, LifecycleError, OptdockError
from optdock.plugins.lifecycle import LifecycleState, Plugin, PluginContext
from optdock.testing.contracts.contract_scene import scene_context
from optdock.testing.contracts.rules import refused, require

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from optdock.plugins.parameters import PluginParameters

__all__ = ["PluginContract"]

P = TypeVar("P", bound=Plugin)

_ALLOWED: Mapping[LifecycleState, Mapping[str, LifecycleState]] = {
    LifecycleState.UNCONFIGURED: {
        "configure": LifecycleState.INACTIVE,
        "shutdown": LifecycleState.FINALIZED,
    },
    LifecycleState.INACTIVE: {
        "activate": LifecycleState.ACTIVE,
        "cleanup": LifecycleState.UNCONFIGURED,
        "shutdown": LifecycleState.FINALIZED,
    },
    LifecycleState.ACTIVE: {"deactivate": LifecycleState.INACTIVE, "shutdown": LifecycleState.FINALIZED},
    LifecycleState.FINALIZED: {},
}
_ROUTES: Mapping[LifecycleState, tuple[str, ...]] = {
    LifecycleState.UNCONFIGURED: (),
    LifecycleState.INACTIVE: ("configure",),
    LifecycleState.ACTIVE: ("configure", "activate"),
    LifecycleState.FINALIZED: ("shutdown",),
}
_TRANSITIONS = ("configure", "activate", "deactivate", "cleanup", "shutdown")


class PluginContract(ABC, Generic[P]):
    """`optdock.plugins.lifecycle.Plugin` and `optdock.plugins.parameters.PluginParameters`, sentence by sentence.

    Attributes:
        interface: The interface that the plugin implements.
        needs_context: The plugin works only once it is configured.
        unitless: Parameters that are pure numbers, so that no unit stands in their description.
        plugin_parameters: What a suite from `installed_suites` builds the plugin with.
    """

    interface: ClassVar[type[Plugin]]
    needs_context: ClassVar[bool] = False
    unitless: ClassVar[frozenset[str]] = frozenset()
    plugin_parameters: ClassVar[Mapping[str, object]] = {}

    @abstractmethod
    def make_plugin(self) -> P:
        """A fresh plugin, not configured."""

    @abstractmethod
    def exercise(self, plugin: P) -> object:
        """Let the plugin do its work once; what comes out, comparable with `==`."""

    def make_context(self) -> PluginContext:
        """Surroundings for the plugin, new ones at every call."""
        return scene_context()

    def ready_plugin(self) -> P:
        """A fresh plugin, configured and active."""
        plugin = self.make_plugin()
        self._walk(plugin, "configure", "activate")
        return plugin

    def test_it_is_built_in_one_call(self) -> None:
        """`Plugin`: ready to use as soon as it is constructed, and an instance of its interface."""
        plugin = self.make_plugin()
        require(isinstance(plugin, self.interface), f"it is a {self.interface.__name__}")
        require(plugin.state is LifecycleState.UNCONFIGURED, "a new plugin is unconfigured")
        require(self.make_plugin() is not plugin, "make_plugin makes a new one each time")

    def test_an_unknown_parameter_is_refused_with_the_nearest_name(self) -> None:
        """`Plugin`: InvalidValue for an unknown parameter; `PluginParameters`: unknown names are refused."""
        plugin = self.make_plugin()
        for name in _known_names(plugin.parameters) or ("anything",):
            wrong = name + name[-1]
            for call in (type(plugin), plugin.set_parameters):
                error = refused(partial(call, **{wrong: 1}), InvalidValue, f"{wrong} is unknown")
                named = f"did you mean {name}?" in str(error) or name == "anything"
                require(named and wrong in str(error), f"the message names {wrong} and {name}, got: {error}")

    def test_a_number_must_be_finite(self) -> None:
        """`PluginParameters`: non-finite numbers are refused, and so are switches."""
        plugin = self.make_plugin()
        for name in _float_names(plugin.parameters):
            for bad in (math.nan, math.inf, -math.inf, True):
                refused(partial(plugin.set_parameters, **{name: bad}), InvalidValue, f"{name} = {bad}")

    def test_every_parameter_is_described_with_its_unit(self) -> None:
        """`PluginParameters`: the unit stands in each field's description, in brackets."""
        plugin = self.make_plugin()
        numbers = _float_names(plugin.parameters)
        for name, spec in type(plugin.parameters).model_fields.items():
            known, text = spec.alias or name, spec.description or ""
            require(text, f"parameter {known} has a description")
            has_unit = "[" in text and "]" in text
            require(
                has_unit or known not in numbers or known in self.unitless,
                f"parameter {known}: the unit stands in brackets, or `unitless` lists it; got {text!r}",
            )

    def test_parameters_change_one_by_one(self) -> None:
        """`Plugin.set_parameters`: change parameters; those not named stay."""
        plugin = self.make_plugin()
        wanted = plugin.parameters.model_dump(by_alias=True)
        for name, value in _accepted_changes(self.make_plugin).items():
            if _accepts(plugin, name, value):
                wanted[name] = value
            found = plugin.parameters.model_dump(by_alias=True)
            require(found == wanted, f"only {name} changes, to {value}; wanted {wanted}, got {found}")

    def test_a_refused_change_changes_nothing(self) -> None:
        """`Plugin.set_parameters`: all of them or none; nothing has changed after a refusal."""
        for name, value in (_accepted_changes(self.make_plugin) or {"anything": 0}).items():
            plugin = self.make_plugin()
            before = plugin.parameters.model_dump()
            for bad in ("no such parameter", name + name[-1]):
                changes = {bad: 0} if name == "anything" else {name: value, bad: 0}
                refused(partial(plugin.set_parameters, **changes), InvalidValue, f"{changes}")
                require(plugin.parameters.model_dump() == before, f"nothing has changed after {changes}")

    def test_a_change_counts_as_if_it_had_been_built_so(self) -> None:
        """`Plugin.set_parameters`: change parameters; what was read from them earlier changes too."""
        for name, value in _accepted_changes(self.make_plugin).items():
            changed = self.ready_plugin()
            changed.set_parameters(**{name: value})
            built = type(changed)(**changed.parameters.model_dump(by_alias=True))
            self._walk(built, "configure", "activate")
            require(self._outcome(changed) == self._outcome(built), f"{name} = {value} counts from now on")

    def test_it_walks_through_its_whole_life(self) -> None:
        """`Plugin`: configure, activate, deactivate, cleanup, and again; each leaves it in the state it says."""
        plugin = self.make_plugin()
        for _ in range(2):
            context = self.make_context()
            plugin.configure(context)
            require(plugin.context is context, "a configured plugin holds its context")
            self._walk(plugin, "activate", "deactivate", "cleanup")
            require(plugin.context is not context, "cleanup lets go of the context")
        self._walk(plugin, "configure", "activate", "shutdown")
        require(plugin.state is LifecycleState.FINALIZED, "shutdown finalizes")

    def test_every_transition_is_allowed_or_refused(self) -> None:
        """`Plugin`: a transition that its state does not allow is refused with LifecycleError and changes nothing.

        `configure` is tried with other surroundings: with the same ones a plugin may take it for done.
        """
        for state, route in _ROUTES.items():
            for transition in _TRANSITIONS:
                plugin = self.make_plugin()
                self._walk(plugin, *route)
                if transition in _ALLOWED[state]:
                    self._walk(plugin, transition)
                    require(plugin.state is _ALLOWED[state][transition], f"{transition} when {state.value}")
                else:
                    rule = f"{transition} when {state.value}"
                    refused(partial(self._walk, plugin, transition), LifecycleError, rule)
                    require(plugin.state is state, f"a refused {rule} changes nothing")

    def test_it_works_at_every_stage(self) -> None:
        """`Plugin`: ready as soon as constructed (unless `needs_context`: then a named error), and the same after."""
        plugin = self.make_plugin()
        if self.needs_context:
            refused(lambda: self.exercise(plugin), OptdockError, "not configured, it says so")
        else:
            self.exercise(plugin)
        self._walk(plugin, "configure")
        inactive = self.exercise(plugin)
        self._walk(plugin, "activate")
        require(self.exercise(plugin) == inactive, "active, it does as inactive")
        self._walk(plugin, "deactivate", "cleanup", "configure")
        require(self.exercise(plugin) == inactive, "configured again, it does as the first time")

    def test_it_does_the_same_again(self) -> None:
        """Equal questions get equal answers: from another instance, and from one that has been asked before."""
        plugin = self.ready_plugin()
        first = self.exercise(plugin)
        require(self.exercise(plugin) == first, "asked again, it answers the same")
        require(self.exercise(self.ready_plugin()) == first, "another instance answers the same")

    def test_instances_share_nothing(self) -> None:
        """A plugin holds its parameters and state itself: what one does never reaches another."""
        expected, other = self.exercise(self.ready_plugin()), self.ready_plugin()
        defaults = other.parameters.model_dump()
        for name, value in list(_accepted_changes(self.make_plugin).items())[:3]:
            busy = self.ready_plugin()
            self.exercise(busy)
            busy.set_parameters(**{name: value})
            require(other.parameters.model_dump() == defaults, f"a change of {name} stays in its instance")
        require(self.exercise(other) == expected, "an instance answers the same whatever another has done")

    def _outcome(self, plugin: P) -> object:
        """What the plugin does, or the name of its refusal."""
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


def _known_names(parameters: PluginParameters) -> tuple[str, ...]:
    """The names that a file or a caller uses: the alias where there is one."""
    return tuple(spec.alias or name for name, spec in type(parameters).model_fields.items())


def _float_names(parameters: PluginParameters) -> tuple[str, ...]:
    """Names of the parameters that hold a real number now."""
    return tuple(name for name, value in parameters.model_dump(by_alias=True).items() if isinstance(value, float))


def _accepts(plugin: Plugin, name: str, value: object) -> bool:
    """Whether the plugin takes this value; it has it then."""
    try:
        plugin.set_parameters(**{name: value})
    except InvalidValue:
        return False
    return True


def _accepted_changes(make_plugin: Callable[[], Plugin]) -> dict[str, object]:
    """For every number and switch that can be changed alone, a value other than the present one that is accepted."""
    found: dict[str, object] = {}
    for name, value in make_plugin().parameters.model_dump(by_alias=True).items():
        for candidate in _others(value):
            if _accepts(make_plugin(), name, candidate):
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
