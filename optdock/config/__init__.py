"""Scenario files in, frozen values out."""

from optdock.config.scenario import Scenario, load_scenario

__all__ = ["Scenario", "load_scenario"]
