"""The parameters of the docking server, and the faults of invalid ones."""

from __future__ import annotations

import math

import pytest
from optdock_ros.docking_parameters import DockingParameters, DockingSettings, docking_settings

from optdock.errors import InvalidValue
from optdock.executor import DockingExecutor
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.model.dock import Dock, DockDirection
from optdock.model.limits import MotionLimits
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.plugins.interfaces import DockType

CHARGER = {"plugin": "opennav_docking::SimpleChargingDock"}


def settings(**block: object) -> DockingSettings:
    """Return the settings of a block with one dock type, `bay`."""
    whole = {"dock_plugins": ["bay"], "bay": CHARGER, **block}
    own = {name: value for name, value in whole.items() if name in DockingParameters.model_fields}
    return docking_settings(whole, DockingParameters.model_validate(own))


def test_nav2s_names_reach_the_executor() -> None:
    found = settings(
        max_retries=7,
        initial_perception_timeout=2,
        wait_charge_timeout=3.5,
        dock_prestaging_tolerance=0.4,
        bay={**CHARGER, "docking_threshold": 0.03, "staging_x_offset": -0.9, "use_external_detection_pose": True},
        executor={"replanning": False},
    )
    made = found.executor_settings(found.plugins["bay"], navigate_to_staging_pose=False, max_staging_time=9.0)
    assert (made.max_retries, made.initial_perception_timeout, made.wait_charge_timeout) == (7, 2.0, 3.5)
    assert (made.contact_range, made.staging_distance, made.prestaging_tolerance) == (0.03, 0.9, 0.4)
    assert made.use_detections
    assert found.dock_type(found.plugins["bay"]).waits_for_charge
    assert (made.replanning, made.navigate_to_staging_pose, made.max_staging_time) == (False, False, 9.0)
    assert made.costmap_patience is not None
    felt = {**CHARGER, "use_stall_detection": True, "stall_joint_names": ["left"]}
    assert dock_type(settings(bay=felt)).is_pressed_on
    assert not dock_type(settings(bay={**felt, "contact": "distance"})).is_pressed_on
    blind = settings(controller={"use_collision_detection": False})
    assert blind.executor_settings(blind.plugins["bay"]).costmap_patience is None


@pytest.mark.parametrize(("backwards", "direction"), [(True, DockDirection.BACKWARD), (False, DockDirection.FORWARD)])
def test_dock_backwards_sets_the_direction_of_all_docks(*, backwards: bool, direction: DockDirection) -> None:
    """The only way to state it on Jazzy, whose docks have no `dock_direction`."""
    assert settings(dock_backwards=backwards).plugins["bay"].direction is direction
    same = settings(dock_backwards=backwards, bay={**CHARGER, "dock_direction": direction.value})
    assert same.plugins["bay"].direction is direction
    other = "forward" if backwards else "backward"
    with pytest.raises(InvalidValue, match=f"bay.dock_direction: '{other}' contradicts dock_backwards"):
        settings(dock_backwards=backwards, bay={**CHARGER, "dock_direction": other})


def test_without_dock_backwards_the_type_decides() -> None:
    assert settings().plugins["bay"].direction is DockDirection.FORWARD
    assert settings(bay={**CHARGER, "dock_direction": "backward"}).plugins["bay"].direction is DockDirection.BACKWARD


def dock_type(found: DockingSettings) -> DockType:
    """Return the dock type `bay` of the executor."""
    return found.dock_type(found.plugins["bay"])


def test_settings_of_the_dock_type_are_not_settings_of_the_executor() -> None:
    """For Nav2's dock types the block `executor` has the parameters of stalls."""
    said = {"stall_speed": 0.01, "stall_time": 0.6, "back_out_distance": 0.25}
    found = settings(executor=said)
    assert dock_type(found).back_out_distance == 0.25
    assert dock_type(found).parameters.model_dump().items() >= said.items()
    made = found.executor_settings(found.plugins["bay"])
    assert (made.stall_speed, made.contact, made.wait_for_charge) == (0.005, "distance", False), "the defaults"
    problem = DockingProblem(
        Pose2(0.0, 0.0, 0.0), Dock(Pose2(1.0, 0.0, 0.0)), Robot(Footprint.from_radius(0.2), MotionLimits())
    )
    DockingExecutor(problem, made, dock_type=dock_type(found))
    own = settings(bay={"plugin": "SimpleDock", "contact": "touch", "use_battery_status": True}, executor=said)
    assert dock_type(own).is_pressed_on
    assert dock_type(own).back_out_distance == 0.1, "it says itself what it does"
    with pytest.raises(InvalidValue, match=r"bay\.charging_curent: unknown parameter; did you mean charging_current"):
        settings(bay={"plugin": "SimpleDock", "charging_curent": 1.0})
    with pytest.raises(InvalidValue, match=r"bay\.plugin: docks: unknown plugin 'MyDock'"):
        settings(bay={"plugin": "MyDock"})


def test_controller_block_has_the_default_limits() -> None:
    found = settings(
        controller={"v_linear_max": 0.15, "v_angular_max": 0.5, "k_phi": 3.0, "simulation_step": 0.1},
        robot={"limits": {"max_reverse_speed": 0.1, "max_curvature": math.inf}, "tracking": {"cross": 0.01}},
    )
    limits = found.robot.document.limits
    assert (limits.max_speed, limits.max_reverse_speed, limits.max_yaw_rate) == (0.15, 0.1, 0.5)
    assert (limits.max_curvature, limits.max_jerk) == (math.inf, 2.0)
    assert (found.robot.document.tracking.cross, found.robot.document.tracking.yaw) == (0.01, 0.03)
    assert found.robot.footprint is None
    assert set(found.not_read) == {"controller.k_phi", "controller.simulation_step"}


def test_a_type_of_docks_overrides_what_all_docks_have() -> None:
    found = settings(
        dock={"final_straight": 0.2, "tolerances": {"cross": 0.005, "yaw": 0.02}},
        bay={**CHARGER, "dock_direction": "backward", "dock": {"approach_speed": 0.05, "tolerances": {"yaw": 0.01}}},
    )
    dock = found.dock_parameters["bay"].dock(found.plugins["bay"], Pose2(1.0, 2.0, 3.0))
    assert (dock.final_straight, dock.approach_speed, dock.direction) == (0.2, 0.05, DockDirection.BACKWARD)
    assert (dock.tolerances.along, dock.tolerances.cross, dock.tolerances.yaw) == (0.01, 0.005, 0.01)


def test_all_faults_are_raised_together() -> None:
    with pytest.raises(InvalidValue) as told:
        settings(
            bay={**CHARGER, "docking_treshold": 0.05, "staging_x_offset": "far"},
            controller={"transform_tolerence": 0.1, "costmap_timeout": 0.0},
            executor={"max_retries": 1, "time_budgett": 1.0},
            robot={"limits": {"max_sped": 1.0}},
            clearance={"required": -0.1},
            tracker={"plugin": "TrackingContoller"},
            goal_checker={"plugin": "DockGoalChecker", "along_tolerance": -1.0},
            dock={"final_strait": 0.1},
            footprint="[[0, 0]]",
            docks=["home"],
            home={"type": "bay", "pose": [0.0]},
        )
    words = (
        "bay.docking_treshold: unknown parameter; did you mean docking_threshold?",
        "bay.staging_x_offset",
        "controller.transform_tolerence: unknown parameter; did you mean transform_tolerance?",
        "controller.costmap_timeout",
        "executor.max_retries: is max_retries of this server",
        "executor.time_budgett: unknown parameter; did you mean time_budget?",
        "max_sped",
        "clearance.required",
        "TrackingContoller",
        "along_tolerance",
        "bay.dock.final_strait: unknown parameter; did you mean final_straight?",
        "footprint",
        "home.pose: must be [x, y, yaw]",
    )
    missing = [word for word in words if word not in str(told.value)]
    assert not missing, str(told.value)
    with pytest.raises(InvalidValue, match="dock_plugins: needs at least one name"):
        settings(dock_plugins=[])
