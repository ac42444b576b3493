"""The table of Nav2's parameters describes what the servers do with them; dead band, limits and margin follow it."""

from __future__ import annotations

import math
from typing import Any

import pytest
from optdock_ros import docking_parameters
from optdock_ros.dock_plugins import OwnDockParameters, SimpleChargingDockParameters
from optdock_ros.docking_parameters import (
    ControllerParameters,
    DockingParameters,
    DockingSettings,
    docking_settings,
)
from optdock_ros.nested_parameters import ServerParameters
from optdock_ros.smoother_server import SmootherServerParameters

from optdock.errors import InvalidValue
from optdock.nav2.declared_parameters import NAV2_DOCKS, OURS, Block, Use, names_of
from optdock.plugins.parameters import PluginParameters
from smoothers.nav2.savitzky_golay import SavitzkyGolaySmoother
from smoothers.nav2.simple import SimpleSmoother

CHARGER = {"plugin": NAV2_DOCKS[0]}
EVERYWHERE = set(ServerParameters.model_fields)
FIELDS = {
    Block.ANY_NODE: EVERYWHERE,
    Block.DOCKING: set(DockingParameters.model_fields) - EVERYWHERE,
    Block.CONTROLLER: set(ControllerParameters.model_fields),
    Block.DOCK_TYPE: set(SimpleChargingDockParameters.model_fields) | set(OwnDockParameters.model_fields),
    Block.SMOOTHING: set(SmootherServerParameters.model_fields) - EVERYWHERE,
    Block.SMOOTHER: set(SimpleSmoother.Parameters.model_fields) | set(SavitzkyGolaySmoother.Parameters.model_fields),
}
# Read by rclpy, by the reader of plugins, or blocks.
NO_FIELDS = {
    "use_sim_time",
    "plugin",
    "controller",
    "robot",
    "clearance",
    "executor",
    "tracker",
    "goal_checker",
    "dock",
}


@pytest.mark.parametrize("block", FIELDS, ids=lambda block: block.name)
def test_names_that_are_read_are_fields_and_fields_are_in_the_table(block: Block) -> None:
    read = names_of(block, Use.READ, Use.MAPPED)
    ours = set(OURS.get(block, ())) | ({"check_for_collisions"} if block is Block.SMOOTHER else set())
    assert (read | ours) - NO_FIELDS == FIELDS[block]
    assert read & ours == set()
    assert names_of(block, Use.NO_EFFECT, Use.REFUSED) & (FIELDS[block] - ours) == set()


def settings(controller: dict[str, object], **block: object) -> DockingSettings:
    """Return the settings of a block with one dock type, `bay`."""
    whole: dict[str, Any] = {"dock_plugins": ["bay"], "bay": CHARGER, "controller": controller, **block}
    own = {name: value for name, value in whole.items() if name in DockingParameters.model_fields}
    return docking_settings(whole, DockingParameters.model_validate(own))


def slowest(found: DockingSettings) -> tuple[object, float, float, float]:
    """Return the dead band of the controller, and the speeds before, at and out of the dock [m/s]."""
    made = found.executor_settings(found.plugins["bay"])
    band = found.tracker.parameters.get("min_speed")
    return band, found.dock_parameters["bay"].approach_speed, made.contact_speed, made.back_out_speed


def test_a_least_speed_is_a_dead_band_unless_it_is_the_only_speed() -> None:
    usual = (None, 0.1, 0.03, 0.1)
    assert slowest(settings({})) == usual, "Nav2's default of 0.1 states no dead band"
    assert slowest(settings({"v_linear_min": 0.16, "v_linear_max": 0.18})) == (0.16, 0.16, 0.16, 0.16)
    assert slowest(settings({"v_linear_min": 0.05})) == (0.05, 0.1, 0.05, 0.1)
    assert slowest(settings({"v_linear_min": 0.15, "v_linear_max": 0.15})) == usual
    assert slowest(settings({"v_linear_min": 0.0})) == usual
    own = settings(
        {"v_linear_min": 0.16},
        tracker={"min_speed": 0.02},
        dock={"approach_speed": 0.05},
        executor={"contact_speed": 0.04, "back_out_speed": 0.06},
    )
    assert slowest(own) == (0.02, 0.05, 0.04, 0.06)
    other = settings({"v_linear_min": 0.16}, tracker={"plugin": "MpcController"})
    assert slowest(other) == (0.16, 0.16, 0.16, 0.16)
    with pytest.raises(InvalidValue, match=r"controller\.v_linear_min: must be at most v_linear_max = 0.25 m/s"):
        settings({"v_linear_min": 0.3})


def test_a_controller_without_a_dead_band_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    bare = type("Bare", (), {"Parameters": PluginParameters})
    monkeypatch.setattr(docking_parameters, "load_plugin", lambda *_: bare)
    found = settings({"v_linear_min": 0.16})
    assert found.not_read == ("controller.v_linear_min for the tracker TrackingController",)
    assert slowest(found)[:2] == (None, 0.16)


@pytest.mark.parametrize(
    ("name", "limit", "usual"),
    [
        ("deceleration_max", "max_deceleration", 0.5),
        ("rotate_to_heading_angular_vel", "max_yaw_rate", 0.75),
        ("rotate_to_heading_max_angular_accel", "max_yaw_acceleration", 1.5),
    ],
)
def test_limits_of_nav2_are_upper_bounds_of_the_defaults(name: str, limit: str, usual: float) -> None:
    assert getattr(settings({name: 0.2}).robot.document.limits, limit) == 0.2
    assert getattr(settings({name: 9.0}).robot.document.limits, limit) == usual
    own = settings({name: 0.2}, robot={"limits": {limit: 0.6}})
    assert getattr(own.robot.document.limits, limit) == 0.6
    assert name in "".join(own.mapped)
    with pytest.raises(InvalidValue, match=rf"controller\.{name}"):
        settings({name: -1.0})


def margin(found: DockingSettings) -> float:
    """Return the distance within which costmap cells are freed [m]."""
    return found.executor_settings(found.plugins["bay"]).contact_margin


def test_the_collision_threshold_is_measured_from_the_target_behind_the_dock() -> None:
    assert margin(settings({})) == margin(settings({"dock_collision_threshold": 0.3})) == 0.05
    assert margin(settings({"dock_collision_threshold": 0.27})) == pytest.approx(0.02)
    assert margin(settings({"dock_collision_threshold": 0.1})) == 0.0
    wide = {"dock_collision_threshold": 0.5}
    with pytest.raises(InvalidValue, match=r"controller\.dock_collision_threshold: 0.5 m would free .* within 0.25 m"):
        settings(wide)
    assert margin(settings(wide, dock={"contact_margin": 0.2})) == 0.2
    assert margin(settings(wide, bay={**CHARGER, "dock": {"contact_margin": 0.1}})) == 0.1
    assert margin(settings({**wide, "use_collision_detection": False})) == 0.05


def test_undocking_tolerances_reach_the_executor() -> None:
    found = settings({}, undock_linear_tolerance=0.19, undock_angular_tolerance=0.08)
    made = found.executor_settings(found.plugins["bay"])
    assert (made.undock_linear_tolerance, made.undock_angular_tolerance) == (0.19, 0.08)
    with pytest.raises(InvalidValue, match=r"executor\.undock_linear_tolerance: is undock_linear_tolerance of this"):
        settings({}, executor={"undock_linear_tolerance": 0.1})


def test_names_of_development_versions_are_refused_if_they_change_the_motion() -> None:
    with pytest.raises(InvalidValue, match=r"bay\.backward_blind: .*set rotate_to_dock and dock_direction: backward"):
        settings({}, bay={**CHARGER, "backward_blind": True})
    with pytest.raises(InvalidValue, match=r"backward_blind: .*set <dock type>.rotate_to_dock"):
        settings({}, backward_blind=True)
    assert settings({}, bay={**CHARGER, "backward_blind": False}).not_read == ("bay.backward_blind",)


TURNED = {**CHARGER, "external_detection_rotation_yaw": 0.5 * math.pi}


def test_a_rotation_with_two_meanings_needs_a_distribution(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ROS_DISTRO", raising=False)
    assert settings({}).plugins
    with pytest.raises(InvalidValue, match=r"^bay\.external_detection_rotation_\*: .*rad apart.*set nav2_distribution"):
        settings({}, bay=TURNED)
    assert settings({}, bay=TURNED, nav2_distribution="jazzy").plugins
    monkeypatch.setenv("ROS_DISTRO", "rolling")
    assert settings({}, bay=TURNED).plugins
    monkeypatch.setenv("ROS_DISTRO", "humble")
    with pytest.raises(InvalidValue, match="set nav2_distribution"):
        settings({}, bay=TURNED)
    with pytest.raises(ValueError, match="nav2_distribution"):
        settings({}, nav2_distribution="humble")


def test_the_type_of_commands_is_that_of_the_distribution(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DISTRO", "jazzy")
    assert not settings({}).sends_stamps
    assert settings({}, enable_stamped_cmd_vel=True).sends_stamps
    assert settings({}, nav2_distribution="kilted").sends_stamps
    monkeypatch.delenv("ROS_DISTRO")
    assert settings({}).sends_stamps
    assert not settings({}, enable_stamped_cmd_vel=False).sends_stamps
