"""Parameter files as public robots have them are read with their meaning."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import pytest
import yaml
from optdock_ros.docking_parameters import DockingParameters, DockingSettings, docking_settings
from optdock_ros.nested_parameters import nested

from optdock.errors import InvalidValue
from optdock.model.dock import DockDirection

FILES = Path(__file__).parent / "public_robots"


def flat(block: dict[str, Any], prefix: str = "") -> dict[str, object]:
    """Return the dotted names of a parameter file, as ROS passes them to a node."""
    found: dict[str, object] = {}
    for name, value in block.items():
        found |= flat(value, f"{prefix}{name}.") if isinstance(value, dict) else {f"{prefix}{name}": value}
    return found


def settings_of(robot: str) -> DockingSettings:
    """Return the settings of a docking server with the file of a robot."""
    document = yaml.safe_load((FILES / f"{robot}.yaml").read_text(encoding="utf-8"))
    block = nested(flat(document.get("docking_server", document.get("/**"))["ros__parameters"]))
    own = {name: value for name, value in block.items() if name in DockingParameters.model_fields}
    return docking_settings(block, DockingParameters.model_validate(own))


class Meaning(NamedTuple):
    """Meaning of a file: dock type, staging [m], contact [m], speed [m/s], yaw rate [rad/s], dead band, slow zone."""

    bay: str
    offset: float
    threshold: float
    fastest: float
    turning: float
    dead_band: float
    zone: float


MEANINGS = {
    "turtlebot4": Meaning("simple_charging_dock", 0.7, 0.05, 0.15, 0.75, 0.0, 0.1),
    "rosbot_xl": Meaning("simple_charging_dock", 0.5, 0.02, 0.05, 0.75, 0.0, 0.1),
    "mowgli": Meaning("simple_charging_dock", 1.5, 0.05, 0.18, 0.85, 0.16, 0.16),
    "nova_carter": Meaning("nova_carter_dock", 0.7, 0.05, 0.15, 0.75, 0.0, 0.1),
}


@pytest.mark.parametrize("robot", MEANINGS)
def test_gear_staging_speeds_and_thresholds(robot: str) -> None:
    found, meaning = settings_of(robot), MEANINGS[robot]
    plugin, limits = found.plugins[meaning.bay], found.robot.document.limits
    made = found.executor_settings(plugin)
    assert plugin.direction is DockDirection.FORWARD
    assert (made.staging_distance, made.contact_range, made.max_retries) == (meaning.offset, meaning.threshold, 3)
    assert (made.undock_linear_tolerance, made.undock_angular_tolerance) == (0.05, 0.1)
    assert (limits.max_speed, limits.max_reverse_speed) == (meaning.fastest, meaning.fastest)
    assert limits.max_yaw_rate == meaning.turning
    assert (limits.max_deceleration, limits.max_yaw_acceleration) == (0.5, 1.5), "Nav2's are larger"
    assert found.tracker.parameters.get("min_speed", 0.0) == meaning.dead_band
    of_dock = found.dock_parameters[meaning.bay]
    assert (of_dock.approach_speed, of_dock.contact_margin) == (meaning.zone, 0.05)
    assert set(found.docks) <= {"home_dock"}


def test_names_without_an_effect_are_listed() -> None:
    law = {"controller.k_phi", "controller.k_delta"}
    dock = "simple_charging_dock.filter_coef"
    assert set(settings_of("turtlebot4").not_read) == {*law, dock}
    assert set(settings_of("rosbot_xl").not_read) == {*law, dock, "controller.slowdown_radius"}
    assert set(settings_of("mowgli").not_read) == {
        *law, dock, "controller.slowdown_radius", "simple_charging_dock.battery_topic"
    }  # fmt: skip
    assert set(settings_of("nova_carter").not_read) == {
        *law, "nova_carter_dock.filter_coef",
        "controller.slowdown_radius", "controller.projection_time", "controller.simulation_time_step",
    }  # fmt: skip


def test_a_c_plus_plus_plugin_of_another_package_is_refused_by_name() -> None:
    with pytest.raises(InvalidValue, match=r"^charging_dock\.plugin: .*husarion_ugv_docking::ChargingDock[^\n]*$"):
        settings_of("panther")
