import json
import math

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from optdock.cli import app
from optdock.errors import DockNotInDB, DockNotValid, InvalidFile, InvalidValue
from optdock.geometry.pose import Pose2
from optdock.model.dock import DockDirection
from optdock.model.limits import LIMIT_UNITS
from optdock.nav2.docking_problem import nav2_limits, nav2_scenario
from optdock.nav2.params import load_nav2_params

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
    home: {type: charger, pose: [1.0, 2.0, -3.141592653589793]}
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
        "docks:\n  left: {type: charger, pose: [1.0, 2.5, 3.141592653589793]}\n"
        "  right: {type: chargr, pose: [5.0, 2.0, 0.0]}\n"
        "  far: {type: charger, pose: [0, 0, 0], frame: odom}\n"
    )
    return tmp_path


def scenario(files, **options):
    return nav2_scenario(files / "params.yaml", files / "hall.yaml", "3.5, 1.5, 0.1", **options)


def test_the_problem_has_the_values_of_the_files(files):
    problem = scenario(files).problem
    assert problem.start == Pose2(3.5, 1.5, 0.1)
    assert nav2_scenario(files / "params.yaml", files / "hall.yaml", problem.start).problem.start == problem.start
    assert problem.goal == Pose2(1.0, 2.0, 0.0)
    assert problem.dock.direction is DockDirection.BACKWARD
    assert (problem.dock.approach.speed, problem.dock.approach.distance) == (0.15, 0.6)
    assert problem.robot.footprint.length == pytest.approx(0.64)
    assert problem.robot.footprint.width == pytest.approx(0.44)
    limits = problem.robot.limits
    assert (limits.max_speed, limits.max_reverse_speed, limits.max_yaw_rate) == (0.4, 0.2, 0.9)
    assert (limits.max_acceleration, limits.max_deceleration, limits.max_yaw_acceleration) == (0.7, 0.8, 1.1)
    assert problem.costmap.columns == 120
    given = {f"max_{name}" for name in ("speed", "reverse_speed", "yaw_rate", "acceleration", "deceleration")}
    assert scenario(files).default_limits == LIMIT_UNITS.keys() - given - {"max_yaw_acceleration"}


def test_a_dock_of_an_unknown_type_is_refused(files):
    with pytest.raises(DockNotValid) as caught:
        scenario(files, docks_source=files / "docks.yaml", dock_name="right")
    text = "params.yaml: has no dock type 'chargr', the type of right; did you mean charger?; its dock types: charger"
    assert str(caught.value).endswith(text)


def test_without_dock_types_docks_are_entered_forward(files):
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
    with pytest.raises(DockNotInDB) as caught:
        scenario(files, docks_source=files / "docks.yaml", dock_name=name)
    assert str(caught.value).endswith(message)
    assert caught.value.code == 901


def test_a_dock_in_another_frame_is_refused(files):
    with pytest.raises(DockNotValid, match=r"far\.frame: must be the frame of global_costmap, 'map', got 'odom'"):
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
            "min_velocity: x must be finite and < 0, got 0.0; robots that cannot",
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


def test_the_smaller_yaw_limit_is_used_and_vectors_may_have_six_components(files):
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
    ("dock", "start", "gear", "yaw"), [("nose", "-12.8,0.54,3.0", 1, math.pi), ("tail", "-12.8,0.54,0.1", -1, 0.0)]
)
def test_plan_runs_from_nav2s_own_parameters_and_map(tmp_path, real_data, dock, start, gear, yaw):
    own = (real_data / "nav2" / "params" / "nav2_params.yaml").read_text()
    rear = '    rear: {plugin: "opennav_docking::SimpleChargingDock", dock_direction: backward}\n'
    listed = own.replace('dock_plugins: ["simple_charging_dock"]', 'dock_plugins: ["simple_charging_dock", "rear"]')
    (tmp_path / "params.yaml").write_text(listed.replace("    # Dock instances\n", rear, 1))
    (tmp_path / "docks.yaml").write_text(
        "docks:\n  nose: {type: simple_charging_dock, pose: [-14.5, 0.24, 3.14159265358979], id: tag}\n"
        "  tail: {type: rear, pose: [-14.5, 0.24, 3.14159265358979]}\n"
    )
    files = [
        "--nav2-params",
        tmp_path / "params.yaml",
        "--docks",
        tmp_path / "docks.yaml",
        "--out",
        tmp_path / "p.json",
    ]
    files += ["--map", real_data / "nav2" / "maps" / "warehouse.yaml"]
    options = [*map(str, files), "--dock", dock, f"--start={start}", "--time-budget", "5"]
    result = CliRunner().invoke(app, ["plan", *options])
    assert result.exit_code == 0, result.output
    document = json.loads((tmp_path / "p.json").read_text())
    assert (document["status"], document["path"]["direction"][-1]) == ("certified", gear)
    ends = [document["path"][key][-1] for key in ("x", "y", "yaw")]
    assert ends[:2] == pytest.approx([-14.5, 0.24], abs=1e-6)
    assert math.remainder(ends[2] - yaw, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    "arguments", [["plan"], ["plan", "bay.yaml", "--dock", "home"], ["plan", "--nav2-params", "params.yaml"]]
)
def test_a_scenario_and_nav2_files_exclude_each_other(arguments):
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 2
    assert result.stderr == "give either a scenario file, or --nav2-params with --map, --dock and --start\n"


def test_plugins_lists_the_plugins_of_a_nav2_file(files):
    result = CliRunner().invoke(app, ["plugins", "--nav2-params", str(files / "params.yaml")])
    assert result.exit_code == 0
    first, second, *parameters = result.stdout.splitlines()
    assert first.startswith("docking_server  charger  opennav_docking::SimpleChargingDock  not provided: ")
    assert second.startswith("global_costmap  0.1 m  footprint 0.6 m x 0.4 m, padded by 0.02 m")
    assert parameters
    assert all(line.startswith("docking_server  read  ") for line in parameters)
