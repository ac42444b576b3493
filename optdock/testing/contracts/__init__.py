"""Contract suites: the rules that a plugin must satisfy, as tests for its author.

There is one suite per interface, a plain class with methods `test_...`. pytest collects a subclass that constructs the
plugin. This package imports no test runner.

    from optdock.testing.contracts import GoalCheckerContract

    class TestMyChecker(GoalCheckerContract):
        def make_plugin(self):
            return MyChecker(tolerance=0.1)

Class attributes and methods adapt a suite to a plugin. `installed_suites` returns a suite for every installed plugin;
`failures` runs a suite without a test runner.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from optdock.errors import InvalidValue
from optdock.plugins.parameters import closest
from optdock.plugins.registry import INTERFACES, available_plugins, create_plugin
from optdock.testing.contracts.drive_contracts import (
    BehaviorContract,
    ControllerContract,
    DockTypeContract,
    GoalCheckerContract,
)
from optdock.testing.contracts.layer import LayerContract
from optdock.testing.contracts.path_contracts import (
    GlobalPlannerContract,
    SmootherContract,
    TimeParameterizerContract,
)
from optdock.testing.contracts.plugin import ContractBroken, PluginContract

if TYPE_CHECKING:
    from collections.abc import Mapping

    from optdock.plugins.lifecycle import Plugin

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
"""Suite for every kind of plugin in `optdock.plugins.registry.INTERFACES`."""


def installed_suites(samples: Mapping[str, Mapping[str, object]] | None = None) -> dict[str, type]:
    """Return a suite for every installed plugin, by class name, such as `TestLayersStaticLayer`.

    In a test module, `globals().update(installed_suites(SAMPLES))` lets pytest collect all of them.

    Args:
        samples: Attributes and methods of the suite by `kind.name` of the plugin, such as `layers.StaticLayer`:
            `plugin_parameters` for constructing the plugin, `needs_context`, `feed` and others.

    Raises:
        InvalidValue: If a sample has an attribute that its suite does not have.
    """
    suites: dict[str, type] = {}
    for info in available_plugins():
        contract, sample = CONTRACTS[info.kind], (samples or {}).get(f"{info.kind}.{info.name}", {})
        unknown = next((name for name in sample if not hasattr(contract, name)), None)
        if unknown is not None:
            near = closest(unknown, dir(contract))
            raise InvalidValue(f"sample of {info.kind}.{info.name}: {contract.__name__} has no {unknown}{near}")

        def make_plugin(suite: PluginContract[Plugin], kind: str = info.kind, plugin: str = info.name) -> Plugin:
            return create_plugin(INTERFACES[kind], plugin, suite.plugin_parameters)

        name = f"Test{info.kind.title().replace('_', '')}{info.name}"
        members = {"make_plugin": make_plugin, **sample, "__doc__": f"{info.kind}: {info.target}."}
        suites[name] = type(name, (contract,), members)
    return suites


def failures(suite: type) -> dict[str, str]:
    """Return the messages of the failing tests of a suite, by test name.

    Args:
        suite: A subclass of a contract that can be constructed without arguments.
    """
    broken: dict[str, str] = {}
    for name in sorted(name for name in dir(suite) if name.startswith("test_")):
        try:
            getattr(suite(), name)()
        except Exception as error:  # noqa: PERF203 - every test is run; any exception of a plugin is a finding
            broken[name] = f"{type(error).__name__}: {error}"
    return broken
