import math

import pytest

from optdock.errors import InvalidFile
from optdock.geometry.pose import Pose2
from optdock.model.dock import DockDirection
from optdock.nav2.docks import docked_pose
from optdock.nav2.params import load_nav2_params


@pytest.fixture
def real(real_data):
    return lambda name: load_nav2_params(real_data / "nav2" / "params" / name)


def loaded(tmp_path, text):
    (tmp_path / "p.yaml").write_text(text)
    return load_nav2_params(tmp_path / "p.yaml")


def faults(tmp_path, text):
    with pytest.raises(InvalidFile) as caught:
        loaded(tmp_path, text)
    return str(caught.value).replace(str(tmp_path) + "/", "").splitlines()


def test_the_bringup_file_is_read_completely(real):
    params = real("nav2_params.yaml")
    found = {}
    for plugin in params.plugins:
        found.setdefault((plugin.node, plugin.kind), []).append(plugin.name)
    assert found == {
        ("bt_navigator", "navigators"): ["navigate_to_pose", "navigate_through_poses"],
        ("controller_server", "progress_checker"): ["progress_checker"],
        ("controller_server", "goal_checker"): ["general_goal_checker"],
        ("controller_server", "controller"): ["FollowPath"],
        ("controller_server", "path_handler"): ["PathHandler"],
        ("local_costmap/local_costmap", "layer"): ["voxel_layer", "inflation_layer"],
        ("local_costmap/local_costmap", "filter"): ["keepout_filter"],
        ("global_costmap/global_costmap", "layer"): ["static_layer", "obstacle_layer", "inflation_layer"],
        ("global_costmap/global_costmap", "filter"): ["keepout_filter", "speed_filter"],
        ("planner_server", "planner"): ["GridBased"],
        ("smoother_server", "smoother"): ["simple_smoother", "route_smoother"],
        ("behavior_server", "behavior"): ["spin", "backup", "drive_on_heading", "assisted_teleop", "wait"],
        ("route_server", "operations"): ["AdjustSpeedLimit", "ReroutingService", "CollisionMonitor"],
        ("route_server", "edge_cost_functions"): ["DistanceScorer", "CostmapScorer"],
        ("docking_server", "dock"): ["simple_charging_dock"],
        ("waypoint_follower", "waypoint_task_executor"): ["wait_at_waypoint"],
        # Blocks with a class that Nav2's own servers do not load by a list.
        ("controller_server", "unlisted"): ["FollowPath.diff_drive", "FollowPath.TrajectoryValidator"],
        ("local_costmap/local_costmap", "unlisted"): ["static_layer"],
    }
    assert len(params.nodes) == 20


def test_a_plugin_carries_its_class_parameters_and_line(real):
    (checker,) = (p for p in real("nav2_params.yaml").plugins if p.kind == "goal_checker")
    assert checker.nav2_class == "nav2_controller::SimpleGoalChecker"
    assert checker.parameters == {
        "stateful": True,
        "xy_goal_tolerance": 0.25,
        "yaw_goal_tolerance": 0.25,
        "path_length_tolerance": 1.0,
    }
    assert checker.line == 120


def test_the_costmaps_nested_twice_are_read(real):
    costmaps = real("nav2_params.yaml").costmaps
    assert {name: c.global_frame for name, c in costmaps.items()} == {"local_costmap": "odom", "global_costmap": "map"}
    costmap = costmaps["global_costmap"]
    assert (costmap.robot_radius, costmap.footprint_padding, costmap.resolution) == (0.22, 0.01, 0.05)
    assert costmap.layers == ("static_layer", "obstacle_layer", "inflation_layer")
    # The polygon around the circle, padded: Nav2's own has its corners on the circle, 0.2255 m inside.
    assert costmap.outline.inscribed_radius == pytest.approx(0.23, abs=1e-9)
    assert costmap.outline.circumscribed_radius == pytest.approx(0.2351, abs=1e-4)


def test_a_bare_costmap_file_is_one_costmap(real):
    (costmap,) = real("costmap_params.yaml").costmaps.values()
    assert costmap.name == "costmap_params"
    assert len(costmap.footprint.vertices) == 5
    assert costmap.outline.length == pytest.approx(0.325 + 0.46 + 0.02)


def test_dock_types_and_docks_of_a_server_file_are_read(real):
    params = real("docking_params.yaml")
    assert params.docks["test_dock"].pose == Pose2(10.0, 0.0, 0.0)
    assert params.docks["test_dock"].unknown == ("tolerance",)
    assert params.dock_types["test_dock_plugin"].dock_direction is DockDirection.FORWARD


@pytest.mark.parametrize("direction", list(DockDirection)[:2])
def test_a_robot_that_backs_into_its_dock_looks_the_other_way(direction):
    dock = Pose2(1.0, 2.0, 0.4)
    docked = docked_pose(dock, direction)
    turned = 0.0 if direction is DockDirection.FORWARD else math.pi
    assert (docked.x, docked.y, math.remainder(docked.yaw - 0.4 - turned, math.tau)) == pytest.approx((1.0, 2.0, 0.0))
    assert docked_pose(docked, direction).distance_to(dock) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(("backwards", "other"), [("true", "forward"), ("false", "backward")])
def test_dock_backwards_is_the_gear_of_all_dock_types(tmp_path, backwards, other):
    """The only way to state it on Jazzy."""
    text = f"docking_server: {{ros__parameters: {{dock_backwards: {backwards}, dock_plugins: [a], a: {{plugin: D}}}}}}"
    gear = DockDirection.BACKWARD if backwards == "true" else DockDirection.FORWARD
    assert loaded(tmp_path, text).dock_types["a"].dock_direction is gear
    with pytest.raises(InvalidFile, match=r"a\.dock_direction: contradicts dock_backwards, which means"):
        loaded(tmp_path, text.replace("plugin: D", f"plugin: D, dock_direction: {other}"))


def test_a_namespace_before_the_node_is_kept(tmp_path):
    params = loaded(tmp_path, "robot1:\n  planner_server:\n    ros__parameters: {tolerance: 0.5}\n")
    assert dict(params.nodes) == {"robot1/planner_server": {"tolerance": 0.5}}
    assert params.node("planner_server") == {"tolerance": 0.5}
    assert params.node("smoother_server") == {}


@pytest.mark.parametrize("text", ['footprint: "[]"', "footprint: ''", "{}"])
def test_without_a_footprint_the_radius_holds(tmp_path, text):
    body = "" if text == "{}" else f"      {text}\n"
    source = f"a_costmap:\n  a_costmap:\n    ros__parameters:\n      robot_radius: 0.5\n{body}"
    costmap = loaded(tmp_path, source).costmaps["a_costmap"]
    assert costmap.footprint is None
    assert costmap.outline.inscribed_radius == pytest.approx(0.5 + 0.01, abs=1e-9)


def test_all_faults_are_listed_at_once(tmp_path):
    text = """local_costmap:
  local_costmap:
    ros__parameters:
      footprint: "[[0.1, 0.1], [0.2, 0.2]]"
      resolution: 0
      footprint_padding: .nan
      plugins: [static_layer]
planner_server:
  ros__parameters:
    planner_plugins: [GridBased]
    GridBased: {tolerance: 0.5}
docking_server:
  ros__parameters:
    docks: [home]
    dock_plugins: [charger]
    charger: {plugin: x::SimpleChargingDock, dock_direction: foward, rotate_to_dock: true, docking_threshold: -1}
"""
    assert faults(tmp_path, text) == [
        "p.yaml:3: local_costmap.local_costmap.ros__parameters.static_layer.plugin: is required: plugins lists "
        "static_layer",
        "p.yaml:11: planner_server.ros__parameters.GridBased.plugin: is required: planner_plugins lists GridBased",
        "p.yaml:4: local_costmap.local_costmap.ros__parameters.footprint: a polygon needs at least 3 distinct "
        "vertices, got 2",
        "p.yaml:6: local_costmap.local_costmap.ros__parameters.footprint_padding: must be a finite number, got nan",
        "p.yaml:5: local_costmap.local_costmap.ros__parameters.resolution: must be a number > 0, got 0",
        "p.yaml:13: docking_server.ros__parameters.home: must be a mapping with type and pose, got None",
        "p.yaml:16: docking_server.ros__parameters.charger.dock_direction: must be forward or backward, got 'foward'; "
        "did you mean forward?",
        "p.yaml:16: docking_server.ros__parameters.charger.rotate_to_dock: needs dock_direction: backward",
        "p.yaml:16: docking_server.ros__parameters.charger.docking_threshold: must be a number > 0, got -1",
    ]


def test_a_file_without_parameters_is_refused(tmp_path):
    assert faults(tmp_path, "a: 1\n") == ["p.yaml: contains no ros__parameters and no costmap parameters"]


WRONG_LISTS = [
    ("[a, a]", "names a more than once"),
    ("[]", "must name at least one plugin"),
    ("a", "must be a list of names, got 'a'"),
    ("{a: 1}", "must be a list of names, got {'a': 1}"),
    ("", "must be a list of names, got None"),
    ("[a, 3]", "must be a list of names, got 3 in it"),
    ("[a, '']", "must be a list of names, got '' in it"),
]


def test_a_list_of_plugins_or_docks_holds_different_names(tmp_path):
    a = "{plugin: x::SimpleGoalChecker, type: t, pose: [0, 0, 0]}"
    for key in ("goal_checker_plugins", "plugins", "docks"):
        for value, rule in WRONG_LISTS:
            text = f"server:\n  ros__parameters:\n    {key}: {value}\n    a: {a}\n"
            if value == "[]" and key != "goal_checker_plugins":  # no layers, or docks in their own file
                assert loaded(tmp_path, text).docks == {}
            else:
                assert faults(tmp_path, text) == [f"p.yaml:3: server.ros__parameters.{key}: {rule}"]


@pytest.mark.parametrize("value", ["&x [*x]", "&x [a, [*x]]"])
def test_a_list_that_contains_itself_is_refused(tmp_path, value):
    (line,) = faults(tmp_path, f"server:\n  ros__parameters:\n    goal_checker_plugins: {value}\n")
    assert "contains itself" in line


def test_dotted_names_are_nested_blocks_with_their_lines(tmp_path):
    text = """controller_server:
  ros__parameters:
    goal_checker_plugins: [a]
    a.plugin: "nav2_controller::SimpleGoalChecker"
    a.xy_goal_tolerance: 0.1
    a: {stateful: false}
    map..topic: x
docking_server:
  ros__parameters:
    docks: [home]
    home.type: t
    home.pose: [1, 2, x]
"""
    assert faults(tmp_path, text) == [
        "p.yaml:12: docking_server.ros__parameters.home.pose.2: must be a number, got 'x'"
    ]
    params = loaded(tmp_path, text.replace("2, x", "2, 3"))
    (checker,) = params.plugins
    assert (checker.parameters, checker.line) == ({"xy_goal_tolerance": 0.1, "stateful": False}, 4)
    assert params.docks["home"].pose == Pose2(1.0, 2.0, 3.0)
    assert params.node("controller_server")["map..topic"] == "x"


def test_the_first_of_several_namespaces_is_used(tmp_path):
    robot = "  global_costmap:\n    global_costmap:\n      ros__parameters: {robot_radius: %s}\n"
    params = loaded(tmp_path, "r1:\n" + robot % 0.3 + "r2:\n" + robot % 0.6)
    assert params.costmaps["global_costmap"].robot_radius == params.node("global_costmap")["robot_radius"] == 0.3


def test_padding_that_turns_the_outline_inside_out_is_refused(tmp_path):
    text = "a_costmap:\n  a_costmap:\n    ros__parameters: {robot_radius: 0.2, footprint_padding: -1.0}\n"
    (line,) = faults(tmp_path, text)
    assert line.startswith("p.yaml:3: a_costmap.a_costmap.ros__parameters.footprint_padding: leaves no footprint: ")
