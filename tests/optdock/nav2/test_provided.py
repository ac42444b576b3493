"""Plugins of a Nav2 parameter file: parameters, and reasons if they are not provided."""

import pytest

from optdock.nav2.params import load_nav2_params
from optdock.nav2.provided_plugins import nav2_costmap_rows, nav2_plugin_rows, nav2_plugins


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


def test_behaviors_and_layers_inherit_parameters_of_their_node(tmp_path):
    found = plugins_of(
        tmp_path,
        """
behavior_server:
  ros__parameters:
    behavior_plugins: [drive, back, wait]
    drive: {plugin: "nav2_behaviors::DriveOnHeading", simulate_ahead_time: 1.5}
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
      plugins: [map]
      map: {plugin: "nav2_costmap_2d::StaticLayer", lethal_cost_threshold: 90}
""",
    )
    assert found["drive"].taken == {"simulate_ahead_time": 1.5}
    assert found["back"].plugin.parameters.simulate_ahead_time == 3.0
    assert found["wait"].reason == "optdock has no behavior of this class"
    assert found["map"].plugin.parameters.lethal_cost_threshold == 90
    assert not found["map"].plugin.parameters.track_unknown_space


@pytest.mark.parametrize("value", ["'0.5'", "yes", "[0.5]", "{a: 1}"])
def test_a_value_of_the_wrong_type_prevents_a_plugin(tmp_path, value):
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
    assert rows["FollowPath.diff_drive"][3] == "not provided: it is in no list of plugins"
    assert rows["inflation_layer"][3].startswith("not provided: the clearance is proven with the exact footprint")
    assert rows["obstacle_layer"][3] == "not provided: there is no sensor data yet"
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
