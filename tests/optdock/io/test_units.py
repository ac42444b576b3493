"""Numbers in the wrong unit are asked about at every door through which people give them."""

import math
import pathlib

import pytest
from typer.testing import CliRunner

from optdock.cli import app
from optdock.config import load_scenario
from optdock.errors import InvalidFile
from optdock.io.maps import load_map
from optdock.io.numbers import unit_fault
from optdock.nav2.docking_problem import nav2_scenario
from optdock.nav2.docks import load_dock_database
from optdock.nav2.params import load_nav2_params

SCENARIO = """\
format: optdock-scenario/1
robot:
  footprint: [[0.4, 0.3], [-0.4, 0.3], [-0.4, -0.3], [0.4, -0.3]]
  limits: {max_speed: 0.5, max_reverse_speed: 0.3, max_wheel_speed: 0.8, track_width: 0.5}
dock:
  pose: [4.0, 1.0, 0.0]
  footprint: [[0.42, -0.4], [0.6, -0.4], [0.6, 0.4]]
  approach_speed: 0.1
  approach_distance: 0.3
start: {pose: [1.0, 0.2, 0.4], speed: 0.0}
goal_checker: {plugin: SimpleGoalChecker, yaw_goal_tolerance: 0.1}
controller: {plugin: TrackingController, min_speed: 0.4}
"""
PARAMS = """\
global_costmap:
  global_costmap:
    ros__parameters:
      robot_radius: 0.3
      footprint_padding: 0.01
      plugins: []
velocity_smoother:
  ros__parameters: {max_velocity: [0.5, 0.0, 2.0], min_velocity: [-0.5, 0.0, -2.0]}
docking_server:
  ros__parameters:
    controller: {v_linear_max: 0.15}
    dock_plugins: [rack]
    rack: {plugin: "opennav_docking::SimpleChargingDock", staging_yaw_offset: 0.0}
    docks: [home]
    home: {type: rack, pose: [2.0, 0.0, 1.5]}
"""


@pytest.fixture(autouse=True)
def in_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def written(name, text, old="", new=""):
    assert not old or text.count(old) == 1, old
    pathlib.Path(name).write_text(text.replace(old, new) if old else text)
    return name


def test_the_files_are_good_as_they_stand():
    load_scenario(written("bay.yaml", SCENARIO))
    load_nav2_params(written("params.yaml", PARAMS.replace("      plugins: []\n", "")))


SCENARIOS_IN_OTHER_UNITS = [
    ("[1.0, 0.2, 0.4]", "[1, 0.2, 90]", "10: start.pose: yaw 90 is beyond 2 pi; degrees? write radians, 1.5708"),
    ("[4.0, 1.0, 0.0]", "[4, 1, -180]", "6: dock.pose: yaw -180 is beyond 2 pi; degrees? write radians, -3.1416"),
    ("[-0.4, -0.3]", "[-400, -300]", "3: robot.footprint: a vertex at 500 is beyond 50 m; mm or cm? write m, 0.5"),
    ("[0.6, 0.4]", "[600, 400]", "7: dock.footprint: a vertex at 721.11 is beyond 50 m; mm or cm? write m"),
    ("max_speed: 0.5", "max_speed: 500", "4: robot.limits.max_speed: speed 500 is beyond 50 m/s; mm/s or km/h?"),
    ("max_reverse_speed: 0.3", "max_reverse_speed: 300", "4: robot.limits.max_reverse_speed: speed 300 is beyond"),
    ("max_wheel_speed: 0.8", "max_wheel_speed: 800", "4: robot.limits.max_wheel_speed: speed 800 is beyond 50"),
    ("approach_speed: 0.1", "approach_speed: 100", "8: dock.approach_speed: speed 100 is beyond 50 m/s"),
    ("speed: 0.0}", "speed: -100.0}", "10: start.speed: speed -100 is beyond 50 m/s"),
    ("yaw_goal_tolerance: 0.1", "yaw_goal_tolerance: 10", "11: goal_checker.yaw_goal_tolerance: 10 is beyond 2 pi"),
    ("min_speed: 0.4", "min_speed: 400", "12: controller.min_speed: 400 is beyond 50 m/s"),
]


def test_a_scenario_in_other_units_is_asked_about():
    for old, new, message in SCENARIOS_IN_OTHER_UNITS:
        with pytest.raises(InvalidFile) as caught:
            load_scenario(written("bay.yaml", SCENARIO, old, new))
        start = f"bay.yaml:{message}"
        assert str(caught.value)[: len(start)] == start


def test_a_radius_in_millimetres_is_asked_about():
    outline = "footprint: [[0.4, 0.3], [-0.4, 0.3], [-0.4, -0.3], [0.4, -0.3]]"
    for given, key in (("radius: 300", "robot.radius"), ("footprint: {radius: 300}", "robot.footprint")):
        with pytest.raises(InvalidFile, match=rf"bay\.yaml:3: {key}: a vertex at 3[0-9.]+ is beyond 50 m; mm or cm\?"):
            load_scenario(written("bay.yaml", SCENARIO, outline, given))


PARAMETERS_IN_OTHER_UNITS = [
    ("pose: [2.0, 0.0, 1.5]", "pose: [2, 0, 90]", "home.pose: yaw 90 is beyond 2 pi; degrees? write radians"),
    ("staging_yaw_offset: 0.0", "staging_yaw_offset: 180", "rack.staging_yaw_offset: 180 is beyond 2 pi; degrees?"),
    ("robot_radius: 0.3", "robot_radius: 300", "robot_radius: 300 is beyond 50 m; mm or cm?"),
    ("robot_radius: 0.3", 'footprint: "[[400, 300], [-400, 300], [-400, -300]]"', "footprint: a vertex at 500 is"),
    ("footprint_padding: 0.01", "footprint_padding: 100", "footprint_padding: 100 is beyond 50 m"),
]


def test_nav2_parameters_in_other_units_are_asked_about():
    text = PARAMS.replace("      plugins: []\n", "")
    for old, new, message in PARAMETERS_IN_OTHER_UNITS:
        with pytest.raises(InvalidFile) as caught:
            load_nav2_params(written("params.yaml", text, old, new))
        assert message in str(caught.value)
        assert str(caught.value).startswith("params.yaml:")


def test_a_dock_database_in_degrees_is_asked_about():
    with pytest.raises(InvalidFile, match=r"docks\.yaml:3: docks\.a\.pose: yaw 90 is beyond 2 pi; degrees\?"):
        load_dock_database(written("docks.yaml", "docks:\n  a:\n    pose: [1, 2, 90]\n    type: t\n"))


MAP = "image: m.pgm\nresolution: 0.5\norigin: [-5, -5, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.2\n"


def hall():
    pathlib.Path("m.pgm").write_bytes(b"P5\n20 20\n255\n" + bytes([254]) * 400)
    return written("m.yaml", MAP)


def test_a_map_turned_in_degrees_is_asked_about():
    hall()
    with pytest.raises(InvalidFile, match=r"m\.yaml:3: origin: yaw 90 is beyond 2 pi; degrees\?.*; but it must be 0: "):
        load_map(written("m.yaml", MAP, "[-5, -5, 0]", "[-5, -5, 90]"))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "max_velocity: [0.5",
            "max_velocity: [500.0",
            "params.yaml: velocity_smoother.max_velocity: x 500 is beyond 50",
        ),
        ("min_velocity: [-0.5", "min_velocity: [-500", "params.yaml: velocity_smoother.min_velocity: x -500 is beyond"),
        (
            "v_linear_max: 0.15",
            "v_linear_max: 150",
            "params.yaml: docking_server.controller.v_linear_max: 150 is beyond",
        ),
    ],
)
def test_nav2_speeds_in_other_units_are_asked_about(old, new, message):
    text = PARAMS.replace("      plugins: []\n", "")
    params = written("params.yaml", text, old, new)
    with pytest.raises(InvalidFile) as caught:
        nav2_scenario(params, hall(), "0,0,0")
    assert str(caught.value).startswith(message)


def test_a_start_in_degrees_is_asked_about():
    params = written("params.yaml", PARAMS.replace("      plugins: []\n", ""))
    command = ["plan", "--nav2-params", params, "--map", hall(), "--dock", "home", "--start", "0,0,90"]
    result = CliRunner().invoke(app, command)
    assert result.exit_code == 2
    assert result.stderr == "--start: yaw 90 is beyond 2 pi; degrees? write radians, 1.5708\n"


def test_noise_in_degrees_is_asked_about():
    result = CliRunner().invoke(app, ["simulate", written("bay.yaml", SCENARIO), "--yaw-noise", "10"])
    assert result.exit_code == 2
    assert result.stderr.startswith("--yaw-noise: 10 is beyond 2 pi; degrees?")


@pytest.mark.parametrize(("value", "unit"), [(6.2832, "rad"), (-2 * math.pi, "rad"), (50.0, "m/s"), (math.inf, "m/s")])
def test_what_is_plausible_passes(value, unit):
    assert unit_fault(value, unit) == ""


def test_the_library_itself_asks_nothing():
    from optdock.geometry.pose import Pose2
    from optdock.model.limits import MotionLimits

    assert Pose2(0.0, 0.0, 90.0).yaw == 90.0
    assert MotionLimits(max_speed=500.0).max_speed == 500.0
