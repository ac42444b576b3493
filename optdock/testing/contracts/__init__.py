"""Contracts that a plugin keeps, ready to be run by its author.

One suite per interface, each a plain class with methods `test_...`; a test runner such as pytest collects a subclass
that says how to make the plugin. No test runner is imported here.

    from optdock.testing.contracts import GoalCheckerContract

    class TestMyChecker(GoalCheckerContract):
        def make_plugin(self):
            return MyChecker(tolerance=0.1)

Class attributes and small methods adapt a suite to a plugin (see each suite). `installed_suites` makes a suite for
every plugin that an installed distribution announces; `failures` runs one without any test runner.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from optdock.errors import InvalidValue
from optdock.plugins.parameters import closest
from optdock.plugins.registry import INTERFACES, available_plugins, create_plugin
from optdock.testing.contracts.behavior import BehaviorContract
from optdock.testing.contracts.checker import GoalCheckerContract
from optdock.testing.contracts.controller import ControllerContract
from optdock.testing.contracts.dock_type import DockTypeContract
from optdock.testing.contracts.layer import LayerContract
from optdock.testing.contracts.planner import GlobalPlannerContract
from optdock.testing.contracts.plugin import PluginContract
from optdock.testing.contracts.rules import ContractBroken
from optdock.testing.contracts.smoother import SmootherContract
from optdock.testing.contracts.timing import TimeParameterizerContract

if TYPE_CHECKING:
    from collections.abc import Mapping

    from optdock.plugins.lifecycle import Plugin
    from optdock.plugins.registry import PluginInfo

__all__ = [
    "CONTRACTS",
    "BehaviorContract",
    "ContractBroken",
    "ControllerContract",
    "DockTypeContract",
    "GlobalPlannerContract",
    "GoalCheckerContract",
    "LayerContract",
    "PluginContract",
    "SmootherContract",
    "TimeParameterizerContract",
    "failures",
    "installed_suites",
]

CONTRACTS: Mapping[str, type] = {
    "planners": GlobalPlannerContract,
    "smoothers": SmootherContract,
    "timing": TimeParameterizerContract,
    "controllers": ControllerContract,
    "goal_checkers": GoalCheckerContract,
    "behaviors": BehaviorContract,
    "layers": LayerContract,
    "docks": DockTypeContract,
}
"""The suite of every kind of plugin in `optdock.plugins.registry.INTERFACES`."""


def installed_suites(samples: Mapping[str, Mapping[str, object]] | None = None) -> dict[str, type]:
    """A suite for every installed plugin, of whichever distribution, found through its entry point.

    In a test module, `globals().update(installed_suites(SAMPLES))` hands all of them to pytest.

    Args:
        samples: By `kind.name`, such as `layers.StaticLayer`, the attributes and methods of the suite that adapt it to
            the plugin: `plugin_parameters` to build it with, `needs_context`, `feed` and so on.

    Returns:
        The suites by class name, such as `TestLayersStaticLayer`.

    Raises:
        InvalidValue: A sample adapts what its suite does not have.
    """
    adapted = samples or {}
    suites = [_suite(info, adapted.get(f"{info.kind}.{info.name}", {})) for info in available_plugins()]
    return {suite.__name__: suite for suite in suites}


def _suite(info: PluginInfo, sample: Mapping[str, object]) -> type:
    contract = CONTRACTS[info.kind]
    unknown = [name for name in sample if not hasattr(contract, name)]
    if unknown:
        near = closest(unknown[0], dir(contract))
        raise InvalidValue(f"sample of {info.kind}.{info.name}: {contract.__name__} has no {unknown[0]}{near}")

    def make_plugin(self: PluginContract[Plugin]) -> Plugin:
        return create_plugin(INTERFACES[info.kind], info.name, self.plugin_parameters)

    name = f"Test{info.kind.title().replace('_', '')}{info.name}"
    return type(name, (contract,), {"make_plugin": make_plugin, **sample, "__doc__": f"{info.kind}: {info.target}."})


def failures(suite: type) -> dict[str, str]:
    """What a plugin breaks: the messages of the failing tests of a suite, by the tests' names.

    Args:
        suite: A subclass of one of the contracts that can be built without arguments.
    """
    broken: dict[str, str] = {}
    for name in sorted(name for name in dir(suite) if name.startswith("test_")):
        try:
            getattr(suite(), name)()
        except Exception as error:  # noqa: PERF203 - every test is run; whatever a plugin raises is a finding
            broken[name] = f"{type(error).__name__}: {error}"
    return broken
