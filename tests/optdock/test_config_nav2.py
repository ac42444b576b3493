import json
import math

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from optdock.cli import app
from optdock.config import nav2_costmap_rows, nav2_plugin_rows, nav2_plugins, nav2_scenario
from optdock.config.nav2_scenario import nav2_limits
from optdock.dock import DockDirection
from optdock.errors import InvalidFile, InvalidValue
from optdock.geometry.pose import Pose2
from optdock.io.nav2_params import load_nav2_params

PARAMS = """\
global_costmap:
  global_costmap:
    ros__parameters:
      footprint: "[[0.3, 0.2], [-0.3, 0.2], [-0.3, -0.2], [0.3, -0.2]]"
      footprint_padding: 0.02
velocity_smoother:
  ros__parameters: {max_velocity: [0.4, 0.0, 0.9], min_velocity: [-0.2, 0.0, -0.9], max_accel: [0.7, 0.0, 1.1],
                    max_decel: [-0.8, 0.0, -1.1]}
docking_server:
  ros__parameters:
    controller: {v_linear_max: 0.15}
    dock_plugins: [charger]
    charger: {plugin: "opennav_docking::SimpleChargingDock", staging_x_offset: -0.6, dock_direction: backward}
    docks: [home]
    home: {type: charger, pose: [1.0, 2.0, 0.0]}
"""


@pytest.fixture
def files(tmp_path):
    """Parameters, map and a dock database of a 6 x 4 m hall without anything in it."""
    (tmp_path / "params.yaml").write_text(PARAMS)
    Image.fromarray(np.full((80, 120), 254, np.uint8)).save(tmp_path / "hall.png")
    (tmp_path / "hall.yaml").write_text(
        "image: hall.png\nresolution: 0.05\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    (tmp_path / "docks.yaml").write_text(
        "docks:\n  left: {type: charger, pose: [1.0, 2.5, 0.0]}\n  right: {type: chargr, pose: [5.0, 2.0, 0.0]}\n"
        "  far: {type: charger, pose: [0, 0, 0], frame: odom}\n"
    )
    return tmp_path


def scenario(files, **options):
    return nav2_scenario(files / "params.yaml", files / "hall.yaml", "3.5, 1.5, 0.1", **options)


def test_the_problem_carries_what_the_files_say(files):
    problem = scenario(files).problem
    assert problem.start == Pose2(3.5, 1.5, 0.1)
    assert problem.goal == Pose2(1.0, 2.0, 0.0)
    assert problem.dock.direction is DockDirection.BACKWARD
    assert (problem.dock.approach.speed, problem.dock.approach.distance) == (0.15, 0.6)
    assert problem.robot.footprint.length == pytest.approx(0.64)
    assert problem.robot.footprint.width == pytest.approx(0.44)
    limits = problem.robot.limits
    assert (limits.max_speed, limits.max_reverse_speed, limits.max_yaw_rate) == (0.4, 0.2, 0.9)
    assert (limits.max_acceleration, limits.max_deceleration, limits.max_yaw_acceleration) == (0.7, 0.8, 1.1)
    assert problem.costmap.columns == 120


def test_a_dock_of_a_type_that_the_parameters_do_not_know_is_refused_not_entered_with_the_wrong_end(files):
    with pytest.raises(InvalidFile) as caught:
        scenario(files, docks_source=files / "docks.yaml", dock_name="right")
    text = "params.yaml: has no dock type 'chargr', which right is of; did you mean charger?; its dock types: charger"
    assert str(caught.value).endswith(text)


def test_without_any_dock_type_in_the_parameters_docks_are_entered_forward(files):
    (files / "params.yaml").write_text(PARAMS.replace("    dock_plugins: [charger]\n", "").replace("plugin: ", "was: "))
    problem = scenario(files, docks_source=files / "docks.yaml", dock_name="right").problem
    assert problem.goal == Pose2(5.0, 2.0, 0.0)
    assert problem.dock.direction is DockDirection.FORWARD


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("lef", "has no dock 'lef'; did you mean left?; its docks: left, right, far"),
        (None, "--dock: is required; its docks: left, right, far"),
    ],
)
def test_an_unknown_dock_is_refused_with_the_list(files, name, message):
    with pytest.raises(InvalidValue) as caught:
        scenario(files, docks_source=files / "docks.yaml", dock_name=name)
    assert str(caught.value).endswith(message)


def test_a_dock_in_another_frame_is_refused(files):
    with pytest.raises(InvalidFile, match=r"far\.frame: must be the frame of global_costmap, 'map', got 'odom'"):
        scenario(files, docks_source=files / "docks.yaml", dock_name="far")


@pytest.mark.parametrize("start", ["1,2", "a,b,c", "1,2,nan", ""])
def test_a_start_that_is_no_pose_is_refused(files, start):
    with pytest.raises(InvalidValue, match="--start: must be x,y,yaw in m, m, rad"):
        nav2_scenario(files / "params.yaml", files / "hall.yaml", start)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[0.4, 0.0, 0.9]", "[0.0, 0.0, 0.9]", "velocity_smoother.max_velocity: x must be finite and > 0, got 0.0"),
        (
            "[-0.2, 0.0, -0.9]",
            "[0.0, 0.0, -0.9]",
            "min_velocity: x must be finite and < 0, got 0.0; a robot that cannot",
        ),
        ("[-0.8, 0.0, -1.1]", "[0.8, 0.0, 1.1]", "max_decel: x must be finite and < 0, got 0.8"),
        ("[0.7, 0.0, 1.1]", "[0.7, 0.0, .inf]", "max_accel: yaw must be finite and > 0, got inf"),
        ("[0.4, 0.0, 0.9]", "0.4", r"velocity_smoother.max_velocity: must be \[x, y, yaw\], three numbers, got 0.4"),
        (
            "v_linear_max: 0.15",
            "v_linear_max: -1",
            "docking_server.controller.v_linear_max: must be finite and > 0 m/s, got -1",
        ),
        ("v_linear_max: 0.15", "v_linear_max: .inf", "v_linear_max: must be finite and > 0 m/s, got inf"),
        ("{v_linear_max: 0.15}", "[0.15]", r"docking_server.controller: must be a mapping, got \[0.15\]"),
    ],
)
def test_impossible_numbers_in_the_parameters_are_refused(files, old, new, message):
    (files / "params.yaml").write_text(PARAMS.replace(old, new, 1))
    with pytest.raises(InvalidFile, match=message):
        scenario(files)


def test_of_two_yaw_limits_the_smaller_holds_and_six_components_are_read_as_nav2_does(files):
    text = PARAMS.replace("[-0.2, 0.0, -0.9]", "[-0.2, 0.0, -0.3]").replace("[0.7, 0.0, 1.1]", "[0.7, 0, 0, 0, 0, 5.0]")
    (files / "params.yaml").write_text(text)
    limits = scenario(files).problem.robot.limits
    assert (limits.max_yaw_rate, limits.max_acceleration, limits.max_yaw_acceleration) == (0.3, 0.7, 1.1)


def test_without_a_velocity_smoother_the_defaults_hold(files):
    (files / "params.yaml").write_text(PARAMS.replace("velocity_smoother", "something_else"))
    limits = nav2_limits(load_nav2_params(files / "params.yaml"))
    assert limits.max_speed == 0.5
    assert math.isinf(limits.max_yaw_rate)


def test_parameters_without_a_costmap_are_refused(files):
    (files / "params.yaml").write_text(PARAMS.replace("global_costmap", "robot"))
    with pytest.raises(InvalidFile, match="names no costmap, so the robot has no footprint"):
        scenario(files)


def test_plan_runs_from_nav2_files_alone(files):
    options = ["--nav2-params", "params.yaml", "--map", "hall.yaml", "--docks", "docks.yaml", "--dock", "left"]
    paths = [str(files / part) if part.endswith(".yaml") else part for part in options]
    result = CliRunner().invoke(app, ["plan", *paths, "--start", "3.5,1.5,0.1", "--time-budget", "5", "--out", str(files / "p.json")])  # fmt: skip  # noqa: E501
    assert result.exit_code == 0, result.output
    document = json.loads((files / "p.json").read_text())
    assert document["status"] == "certified"
    assert document["path"]["direction"][-1] == -1
    ends = [document["path"][key][-1] for key in ("x", "y", "yaw")]
    np.testing.assert_allclose(ends, [1.0, 2.5, 0.0], atol=1e-6)


@pytest.mark.parametrize(
    "arguments", [["plan"], ["plan", "bay.yaml", "--dock", "home"], ["plan", "--nav2-params", "params.yaml"]]
)
def test_a_scenario_and_nav2_files_exclude_each_other(arguments):
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 2
    assert result.stderr == "give either a scenario file, or --nav2-params with --map, --dock and --start\n"


def plugins_of(tmp_path, text):
    (tmp_path / "p.yaml").write_text(text)
    return {plugin.instance.name: plugin for plugin in nav2_plugins(load_nav2_params(tmp_path / "p.yaml"))}


def test_known_plugins_are_built_and_unknown_parameters_listed_with_the_nearest_name(tmp_path):
    found = plugins_of(
        tmp_path,
        """
controller_server:
  ros__parameters:
    goal_checker_plugins: [fine, old, odd, bad]
    fine: {plugin: "nav2_controller::SimpleGoalChecker", xy_goal_tolerance: 0.1, xy_gaol_tolerance: 3, cheese: 1}
    old: {plugin: "nav2_controller/StoppedGoalChecker"}
    odd: {plugin: "my_company::OddGoalChecker"}
    bad: {plugin: "nav2_controller::SimpleGoalChecker", xy_goal_tolerance: -1.0}
smoother_server:
  ros__parameters:
    smoother_plugins: [s]
    s: {plugin: "nav2_constrained_smoother::ConstrainedSmoother", w_smooth: 3000.0}
""",
    )
    assert type(found["fine"].plugin).__name__ == "SimpleGoalChecker"
    assert found["fine"].plugin.tolerances.x == 0.1
    assert found["fine"].unknown == ("xy_gaol_tolerance; did you mean xy_goal_tolerance?", "cheese")
    assert type(found["old"].plugin).__name__ == "StoppedGoalChecker"
    assert found["odd"].plugin is None
    assert found["odd"].reason == "optdock has no goal checker of this class"
    assert found["bad"].plugin is None
    assert "xy_goal_tolerance" in found["bad"].reason
    assert type(found["s"].plugin).__name__ == "CasadiSmoother"
    assert found["s"].unknown[0].startswith("w_smooth")


def test_every_parameter_of_nav2s_graceful_controller_loads_and_those_without_counterpart_are_listed(tmp_path):
    found = plugins_of(
        tmp_path,
        """
controller_server:
  ros__parameters:
    controller_plugins: [FollowPath]
    FollowPath.plugin: "nav2_graceful_controller::GracefulController"
    FollowPath.v_linear_max: 0.4
    FollowPath:
      {lambda: 2.5, k_phi: 2.0, footprint_scaling_linear_vel: 0.5, footprint_scaling_factor: 0.25,
       footprint_scaling_step: 0.1, obstacle_cost_margin: 1, final_rotation_search_step: 0.1,
       in_place_collision_resolution: 0.1, self: 1, 3: 4}
""",
    )["FollowPath"]
    assert (found.plugin.law.v_linear_max, found.plugin.law.lambda_) == (0.4, 2.5)
    assert {name.split(";")[0] for name in found.unknown} == {
        *("footprint_scaling_linear_vel", "footprint_scaling_factor", "footprint_scaling_step"),
        *("obstacle_cost_margin", "final_rotation_search_step", "in_place_collision_resolution", "self", "3"),
    }


def test_a_layer_with_several_sources_is_built(tmp_path):
    found = plugins_of(
        tmp_path,
        """
local_costmap:
  local_costmap:
    ros__parameters:
      plugins: [obstacles]
      obstacles:
        plugin: "nav2_costmap_2d::ObstacleLayer"
        observation_sources: scan depth
        scan: {topic: /scan, clearing: true}
        depth: {topic: /depth, marking: false, colour: red}
""",
    )["obstacles"]
    assert {name: rules.marking for name, rules in found.plugin.parameters.sources.items()} == {
        "scan": True,
        "depth": False,
    }
    assert found.unknown == ("colour", "topic")


def test_behaviors_and_layers_take_from_their_node_what_nav2s_do(tmp_path):
    found = plugins_of(
        tmp_path,
        """
behavior_server:
  ros__parameters:
    behavior_plugins: [spin, back, wait]
    spin: {plugin: "nav2_behaviors::Spin", simulate_ahead_time: 1.5}
    back: {plugin: "nav2_behaviors::BackUp"}
    wait: {plugin: "nav2_behaviors::Wait"}
    simulate_ahead_time: 3.0
    max_rotational_vel: 0.7
    transform_tolerance: 0.1
global_costmap:
  global_costmap:
    ros__parameters:
      track_unknown_space: false
      lethal_cost_threshold: 80
      plugins: [map, scan, inflation]
      map: {plugin: "nav2_costmap_2d::StaticLayer", lethal_cost_threshold: 90}
      scan: {plugin: "nav2_costmap_2d::ObstacleLayer"}
      inflation: {plugin: "nav2_costmap_2d::InflationLayer"}
""",
    )
    assert found["spin"].taken == {"simulate_ahead_time": 1.5, "max_rotational_vel": 0.7}
    assert found["back"].plugin.parameters.simulate_ahead_time == 3.0
    assert found["wait"].taken == found["inflation"].taken == {}
    assert found["map"].plugin.parameters.lethal_cost_threshold == 90
    assert not found["map"].plugin.parameters.track_unknown_space
    assert not found["scan"].plugin.parameters.track_unknown_space


@pytest.mark.parametrize("value", ["'0.5'", "yes", "[0.5]", "{a: 1}"])
def test_a_value_of_the_wrong_type_is_the_reason_why_a_plugin_is_not_built(tmp_path, value):
    checker = f"{{plugin: 'n::SimpleGoalChecker', xy_goal_tolerance: {value}}}"
    text = f"controller_server:\n  ros__parameters:\n    goal_checker_plugins: [a]\n    a: {checker}\n"
    found = plugins_of(tmp_path, text)["a"]
    assert found.plugin is None
    assert found.reason.startswith("SimpleGoalChecker.xy_goal_tolerance: ")


def test_every_plugin_of_the_bringup_file_is_built_or_has_a_reason(real_data):
    params = load_nav2_params(real_data / "nav2" / "params" / "nav2_params.yaml")
    found = nav2_plugins(params)
    assert len(found) == len(params.plugins) == 32
    assert all((plugin.plugin is None) == bool(plugin.reason) for plugin in found)
    built = {plugin.instance.name: plugin.plugin for plugin in found if plugin.plugin is not None}
    assert type(built["general_goal_checker"]).__name__ == "SimpleGoalChecker"
    assert built["general_goal_checker"].parameters.model_dump()["path_length_tolerance"] == 1.0
    assert built["route_smoother"].parameters.model_dump()["refinement_num"] == 5
    rows = {row[1]: row for row in nav2_plugin_rows(params)}
    assert rows["FollowPath.diff_drive"][3] == "not provided: no list of plugins names it"
    assert rows["inflation_layer"][3] == "InflationLayer(cost_scaling_factor=3.0, inflation_radius=0.7)"
    assert rows["obstacle_layer"][3].endswith("; not read: topic, max_obstacle_height, data_type")
    assert rows["FollowPath"][3] == "not provided: optdock has no controller of this class"
    assert rows["simple_smoother"][3].startswith("SimpleSmoother(tolerance=1e-10, max_its=1000, refinement_num=2, ")
    assert nav2_costmap_rows(params) == [
        (
            "local_costmap",
            "0.05 m",
            "radius 0.22 m, padded by 0.01 m",
            "layers: voxel_layer, inflation_layer; filters: keepout_filter",
        ),
        (
            "global_costmap",
            "0.05 m",
            "radius 0.22 m, padded by 0.01 m",
            "layers: static_layer, obstacle_layer, inflation_layer; filters: keepout_filter, speed_filter",
        ),
    ]
    assert rows["simple_smoother"][:3] == ("smoother_server", "simple_smoother", "nav2_smoother::SimpleSmoother")


def test_plugins_lists_what_a_nav2_file_asks_for(files):
    result = CliRunner().invoke(app, ["plugins", "--nav2-params", str(files / "params.yaml")])
    assert result.exit_code == 0
    first, second = result.stdout.splitlines()
    assert first.startswith("docking_server  charger  opennav_docking::SimpleChargingDock  not provided: ")
    assert second.startswith("global_costmap  0.1 m  footprint 0.6 m x 0.4 m, padded by 0.02 m")
