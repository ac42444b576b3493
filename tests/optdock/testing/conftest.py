"""Check that every test of a contract can fail."""

import pytest

from optdock.testing.contracts import ContractBroken, PluginContract, failures

COMMON = {name for name in dir(PluginContract) if name.startswith("test_")}


def suite_of(contract, plugin, **attributes):
    """The suite of a plugin class; attributes replace those of the contract."""
    return type("Suite", (contract,), {"make_plugin": lambda suite: plugin(), **attributes})


def require_every_gate(contract, good, broken, *, errors=(), is_installed=False, **attributes):
    """`good` passes, and each test of the contract itself fails for every plugin that `broken` lists for it.

    Args:
        contract: The contract.
        good: A plugin class that keeps it.
        broken: Plugin classes, or dicts of suite attributes, by the name of the test that must catch them.
        errors: Exceptions other than ContractBroken with which a test may fail.
        is_installed: Whether `good` is an installed plugin with the attributes of its sample: `test_contracts` runs it.
        attributes: Of the suite.
    """
    own = {name for name in dir(contract) if name.startswith("test_")}
    own -= COMMON if contract is not PluginContract else set()
    assert is_installed or failures(suite_of(contract, good, **attributes)) == {}
    for name, plugin in ((name, plugin) for name, plugins in broken.items() for plugin in plugins):
        suite = suite_of(contract, good if isinstance(plugin, dict) else plugin, **attributes)
        if isinstance(plugin, dict):
            suite = type("Suite", (suite,), plugin)
        assert caught(getattr(suite(), name), errors), f"{name} does not catch {plugin}"
    assert set(broken) == own, "every gate is seen failing"


def caught(gate, errors):
    try:
        gate()
    except (ContractBroken, *errors):
        return True
    return False


@pytest.fixture
def every_gate():
    return require_every_gate
