"""Nav2's published defaults (reference commit of 2026-08-21), and intended differences.

The tables contain the values of Nav2's documentation; other parameters must be listed as optdock's own.
"""

import dataclasses

from optdock.nav2.docking_problem import nav2_scenario
from optdock.nav2.docks import DockTypeParams
from optdock.nav2.params import CostmapParams
from optdock.plugins.interfaces import GoalChecker
from optdock.plugins.registry import INTERFACES, load_plugin

POSITION = {
    "xy_goal_tolerance": 0.25,
    "path_length_tolerance": 1.0,
    "stateful": True,
    "xy_goal_tolerance_buffer": 0.0,
}
SIMPLE = {**POSITION, "yaw_goal_tolerance": 0.25, "symmetric_yaw_tolerance": False}
NAV2 = {
    "goal_checkers.PositionGoalChecker": POSITION,
    "goal_checkers.SimpleGoalChecker": SIMPLE,
    "goal_checkers.StoppedGoalChecker": {**SIMPLE, "trans_stopped_velocity": 0.25, "rot_stopped_velocity": 0.25},
    "goal_checkers.AdaptiveToleranceGoalChecker": {
        "fine_xy_goal_tolerance": 0.10,
        "coarse_xy_goal_tolerance": 0.25,
        "xy_goal_tolerance_buffer": 0.0,
        "yaw_goal_tolerance": 0.25,
        "path_length_tolerance": 1.0,
        "stateful": True,
        "symmetric_yaw_tolerance": False,
        "trans_stopped_velocity": 0.10,
        "rot_stopped_velocity": 0.10,
    },
    "goal_checkers.AxisGoalChecker": {
        "along_path_tolerance": 0.25,
        "cross_track_tolerance": 0.25,
        "path_length_tolerance": 1.0,
        "is_overshoot_valid": False,
        "direction_estimation_distance": 0.15,
        "fallback_radial_goal_tolerance": None,  # the smaller of the two tolerances
    },
    "smoothers.SimpleSmoother": {
        "tolerance": 1e-10,
        "max_its": 1000,
        "w_data": 0.2,
        "w_smooth": 0.3,
        "do_refinement": True,
        "refinement_num": 2,
        "enforce_path_inversion": True,
    },
    "smoothers.SavitzkyGolaySmoother": {
        "window_size": 7,
        "poly_order": 3,
        "do_refinement": True,
        "refinement_num": 2,
        "enforce_path_inversion": True,
    },
    "layers.StaticLayer": {
        "track_unknown_space": False,
        "lethal_cost_threshold": 100,
        "trinary_costmap": True,
        "unknown_cost_value": 255,
        "inscribed_obstacle_cost_value": 99,
        "use_maximum": False,
    },
}
# The document that the axis checker follows has no such distance; unknown space is an obstacle until it is seen.
OTHERWISE = {
    "goal_checkers.AxisGoalChecker": {"direction_estimation_distance": 0.0},
    "layers.StaticLayer": {"track_unknown_space": True},
}
OWN = {
    "goal_checkers.AdaptiveToleranceGoalChecker": {"required_stagnation_cycles"},
    "goal_checkers.AxisGoalChecker": {"axis_end", "stopped", "trans_stopped_velocity", "rot_stopped_velocity"},
    "smoothers.SimpleSmoother": {"check_for_collisions"},
    "smoothers.SavitzkyGolaySmoother": {"check_for_collisions"},
    "layers.StaticLayer": {"enabled", "footprint_clearing_enabled"},
}


def test_plugins_have_nav2s_parameters_and_defaults():
    found = {}
    for name in NAV2:
        kind, plugin = name.split(".")
        found[name] = load_plugin(INTERFACES[kind], plugin)().parameters.model_dump(by_alias=True)
    nav2s = {name: {**NAV2[name], **OTHERWISE.get(name, {})} for name in NAV2}
    own = {name: set(OWN.get(name, ())) for name in NAV2}
    assert {n: {k: v for k, v in values.items() if k not in own[n]} for n, values in found.items()} == nav2s
    assert [n for n, values in found.items() if own[n] - set(values)] == []


def test_every_goal_checker_of_nav2_is_in_the_table():
    nav2s = {name.split(".")[1] for name in NAV2 if name.startswith("goal_checkers.")}
    assert all(issubclass(load_plugin(GoalChecker, f"nav2_controller::{name}"), GoalChecker) for name in nav2s)
    assert len(nav2s) == 5


def test_simple_docks_have_nav2s_defaults():
    found = dataclasses.asdict(DockTypeParams("dock"))
    assert found == {
        "name": "dock",
        "dock_direction": "forward",
        "staging_x_offset": -0.7,
        "staging_yaw_offset": 0.0,
        "docking_threshold": 0.05,
    }


def test_costmaps_have_nav2s_defaults():
    costmap = CostmapParams("global_costmap")
    assert (costmap.footprint, costmap.footprint_padding, costmap.robot_radius) == (None, 0.01, 0.1)
    assert (costmap.global_frame, costmap.resolution) == ("map", 0.1)


def test_the_default_speed_is_that_of_the_docking_server(tmp_path, real_data):
    (tmp_path / "p.yaml").write_text(
        "global_costmap:\n  global_costmap:\n    ros__parameters: {robot_radius: 0.2}\n"
        "docking_server:\n  ros__parameters:\n    docks: [home]\n    home: {type: any, pose: [5.0, 6.0, 0.0]}\n"
    )
    zone = nav2_scenario(
        tmp_path / "p.yaml", real_data / "nav2" / "maps" / "warehouse.yaml", "3,6,0"
    ).problem.dock.approach
    assert (zone.speed, zone.distance) == (0.25, 0.7)
