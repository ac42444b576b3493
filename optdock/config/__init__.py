"""Reading, writing and reference of scenario files."""

from optdock.config.reference import KeyReference, plugin_reference, scenario_reference, scenario_schema
from optdock.config.scenario import Scenario, demo_scenario, load_scenario
from optdock.config.writing import save_scenario

__all__ = [
    "KeyReference",
    "Scenario",
    "demo_scenario",
    "load_scenario",
    "plugin_reference",
    "save_scenario",
    "scenario_reference",
    "scenario_schema",
]
