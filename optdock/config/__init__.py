"""Scenario files and Nav2's files in, frozen values out."""

from optdock.config.nav2_plugins import Nav2Plugin, nav2_costmap_rows, nav2_plugin_rows, nav2_plugins
from optdock.config.nav2_scenario import nav2_scenario
from optdock.config.scenario import Scenario, load_scenario

__all__ = [
    "Nav2Plugin",
    "Scenario",
    "load_scenario",
    "nav2_costmap_rows",
    "nav2_plugin_rows",
    "nav2_plugins",
    "nav2_scenario",
]
