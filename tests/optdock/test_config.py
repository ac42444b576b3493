import math
import struct
import zlib

import numpy as np
import pytest

from optdock.config import load_scenario
from optdock.errors import InvalidFile
from optdock.geometry.pose import Pose2
from optdock.model.dock import DockDirection
from optdock.model.limits import MotionLimits
from optdock.model.robot import Drive
from optdock.plugins.registry import PluginChoice

COMPLETE = """\
format: optdock-scenario/1
frame: depot
obstacles:
  - [[1.0, 2.0], [3.0, 2.0], [3.0, 2.4], [1.0, 2.4]]
robot:
  footprint: [[0.4, 0.3], [-0.4, 0.3], [-0.4, -0.3], [0.4, -0.3]]
  drive: ackermann
  limits: {max_speed: 0.7, max_curvature: 2.0, max_yaw_rate: .inf}
dock:
  pose: [4.0, 1.0, 0.5]
  footprint: [[0.42, -0.4], [0.6, -0.4], [0.6, 0.4], [0.42, 0.4]]
  direction: backward
  final_straight: 0.3
  approach_speed: 0.1
  approach_distance: 0.4
start: {pose: [1.0, 0.2, 0.4], speed: -0.1, curvature: 0.2, acceleration: 0.05}
clearance: {required: 0.06, at_dock: 0.01, taper: 1e-1}
time_budget: 0.25
controller: {plugin: TrackingController}
"""
MINIMAL = """\
format: optdock-scenario/1
robot: {radius: 0.3}
dock: {pose: [1, 0, 0]}
start: {pose: [0, 0, 0]}
"""


def scenario(tmp_path, text):
    (tmp_path / "bay.yaml").write_text(text)
    return load_scenario(tmp_path / "bay.yaml")


def faults(tmp_path, text):
    with pytest.raises(InvalidFile) as caught:
        scenario(tmp_path, text)
    return str(caught.value).replace(str(tmp_path) + "/", "").splitlines()


def with_change(old, new, text=COMPLETE):
    assert text.count(old) == 1, old
    return text.replace(old, new)


def write_map(folder, grey, resolution=0.1, header=None):
    """A map_server map; row 0 of `grey` is the top of the picture."""
    folder.mkdir(exist_ok=True)
    head = header or f"P5\n{grey.shape[1]} {grey.shape[0]}\n255\n"
    (folder / "hall.pgm").write_bytes(head.encode() + grey.astype(np.uint8).tobytes())
    (folder / "hall.yaml").write_text(
        f"image: hall.pgm\nresolution: {resolution}\norigin: [0, 0, 0]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )


def test_every_key_reaches_its_value(tmp_path):
    loaded = scenario(tmp_path, COMPLETE)
    problem = loaded.problem
    assert problem.frame == "depot"
    assert problem.start == Pose2(1.0, 0.2, 0.4)
    assert (problem.start_speed, problem.start_curvature, problem.start_acceleration) == (-0.1, 0.2, 0.05)
    assert problem.goal == Pose2(4.0, 1.0, 0.5)
    assert problem.dock.direction is DockDirection.BACKWARD
    assert (problem.dock.final_straight, problem.dock.approach.speed, problem.dock.approach.distance) == (0.3, 0.1, 0.4)
    assert problem.robot.drive is Drive.ACKERMANN
    limits = problem.robot.limits
    assert (limits.max_speed, limits.max_curvature, limits.max_yaw_rate) == (0.7, 2.0, math.inf)
    assert (problem.clearance.required, problem.clearance.at_dock, problem.clearance.taper) == (0.06, 0.01, 0.1)
    assert (len(problem.obstacles), len(problem.all_obstacles)) == (1, 2)
    assert loaded.time_budget == 0.25
    assert loaded.controller.name == "TrackingController"
    assert loaded.source == tmp_path / "bay.yaml"


def test_defaults_hold_where_the_file_is_silent(tmp_path):
    loaded = scenario(tmp_path, MINIMAL)
    assert loaded.time_budget == 1.0
    assert loaded.problem.frame == "map"
    assert loaded.problem.robot.footprint.inscribed_radius == pytest.approx(0.3)
    assert loaded.problem.dock.direction is DockDirection.AUTO
    names = [choice.name for choice in (*loaded.planner, loaded.smoother, loaded.goal_checker)]
    assert names == ["DockPlanner", "ManoeuvrePlanner", "CasadiSmoother", "DockGoalChecker"]


@pytest.mark.parametrize(
    ("start", "curvature"),
    [
        ("pose: [0, 0, 0]", None),
        ("pose: [0, 0, 0], speed: 0.0", None),
        ("pose: [0, 0, 0], curvature: 0.0", 0.0),
        ("pose: [0, 0, 0], speed: 0.2", 0.0),
        ("pose: [0, 0, 0], speed: 0.2, curvature: 0.5", 0.5),
    ],
)
def test_start_curvature_is_free_only_at_rest(tmp_path, start, curvature):
    assert scenario(tmp_path, with_change("pose: [0, 0, 0]", start, MINIMAL)).problem.start_curvature == curvature


@pytest.mark.parametrize(
    "robot",
    [
        "footprint: [[0.4, 0.3], [-0.4, 0.3], [-0.4, -0.3], [0.4, -0.3]]",
        "footprint: '[[0.4, 0.3], [-0.4, 0.3], [-0.4, -0.3], [0.4, -0.3]]'",
        "footprint: [[0.4, -0.3], [-0.4, -0.3], [-0.4, 0.3], [0.4, 0.3]]",
    ],
)
def test_a_footprint_is_a_list_or_navs_text_in_either_orientation(tmp_path, robot):
    footprint = scenario(tmp_path, with_change("radius: 0.3", robot, MINIMAL)).problem.robot.footprint
    assert (footprint.length, footprint.width) == (0.8, 0.6)
    assert sorted(map(tuple, footprint.vertices)) == [(-0.4, -0.3), (-0.4, 0.3), (0.4, -0.3), (0.4, 0.3)]


def test_a_radius_may_stand_under_footprint(tmp_path):
    loaded = scenario(tmp_path, with_change("radius: 0.3", "footprint: {radius: 0.2}", MINIMAL))
    assert loaded.problem.robot.footprint.inscribed_radius == pytest.approx(0.2)


def test_one_number_is_the_clearance_everywhere(tmp_path):
    rule = scenario(tmp_path, MINIMAL + "clearance: 0.08\n").problem.clearance
    near_and_far = rule.required_at(np.array([0.0, 0.1, 5.0]), np.array([5.0, 5.0, 5.0]), 1.0)
    np.testing.assert_array_equal(near_and_far, [0.08, 0.08, 0.08])


def test_a_map_is_found_relative_to_the_scenario(tmp_path):
    grey = np.full((30, 40), 254)
    grey[:5] = 0
    write_map(tmp_path / "maps", grey)
    problem = scenario(tmp_path, MINIMAL + "map: maps/hall.yaml\n").problem
    assert (problem.costmap.rows, problem.costmap.columns, problem.costmap.resolution) == (30, 40, 0.1)
    obstacles = problem.all_obstacles
    occupied = [i for i in range(len(obstacles)) if obstacles.name_of(i) == "map"]
    lower, upper = obstacles.lower[occupied].min(axis=0), obstacles.upper[occupied].max(axis=0)
    np.testing.assert_allclose([*lower, *upper], [0.0, 2.5, 4.0, 3.0], atol=1e-12)


def test_the_example_of_the_format_is_reported_word_for_word(tmp_path):
    text = "format: optdock-scenario/1\nstart: {pose: [0, 0, 0]}\ndock: {pose: [1, 0, 0]}\nrobot:\n  radius: 0.3\n"
    text += "  limits:\n    max_speed: -1.0\n"
    assert faults(tmp_path, text) == ["bay.yaml:7: robot.limits.max_speed: must be > 0 m/s, got -1.0"]


WRONG_VALUES = [
    ("max_speed: 0.7", "max_speed: .nan", "8: robot.limits.max_speed: must be finite and > 0 m/s, got nan"),
    ("max_speed: 0.7", "max_speed: .inf", "8: robot.limits.max_speed: must be finite and > 0 m/s, got inf"),
    ("max_speed: 0.7", "max_speed: fast", "8: robot.limits.max_speed: must be a number, got 'fast'"),
    ("max_speed: 0.7", "max_speed: true", "8: robot.limits.max_speed: must be a number, got True"),
    ("max_speed: 0.7", "max_sped: 0.7", "8: robot.limits.max_sped: unknown key; did you mean max_speed?"),
    (
        "max_curvature: 2.0",
        "min_turning_radius: 0.6",
        "8: robot.limits.min_turning_radius: unknown key; write max_curvature: 1.6667, that is 1 / radius",
    ),
    (
        "max_curvature: 2.0",
        "minimum_turning_radius: 0",
        "8: robot.limits.minimum_turning_radius: unknown key; write max_curvature",
    ),
    ("max_speed: 0.7", "min_vel_x: -0.3", "8: robot.limits.min_vel_x: unknown key; write max_reverse_speed: 0.3"),
    ("frame: depot", "max_vel_x: 0.3", "2: max_vel_x: unknown key"),
    ("max_curvature: 2.0", "max_curvature: 0", "8: robot.limits.max_curvature: must be > 0 1/m, got 0.0"),
    ("max_curvature: 2.0", "max_curvature: -2", "8: robot.limits.max_curvature: must be > 0 1/m, got -2.0"),
    ("drive: ackermann", "drive: omni", "7: robot.drive: must be differential or ackermann, got 'omni'"),
    ("[4.0, 1.0, 0.5]", "[4.0, .nan, 0.5]", "10: dock.pose.y: must be finite, got nan"),
    ("[4.0, 1.0, 0.5]", "[4.0, 1.0]", "10: dock.pose: must be [x, y, yaw] in m, m, rad, got [4.0, 1.0]"),
    ("backward", "sideways", "12: dock.direction: must be forward, backward or auto, got 'sideways'"),
    ("final_straight: 0.3", "final_straight: -1", "13: dock.final_straight: must be finite and >= 0 m, got -1.0"),
    ("approach_speed: 0.1", "approach_speed: 0", "14: dock.approach_speed: must be > 0 m/s, got 0.0"),
    ("speed: -0.1, ", "speed: .nan, ", "16: start.speed: must be finite, got nan"),
    ("at_dock: 0.01", "at_dock: 0.1", "17: clearance.at_dock: must be <= required = 0.06 m, got 0.1"),
    ("required: 0.06", "required: -0.1", "17: clearance.required: must be finite and >= 0 m, got -0.1"),
    ("time_budget: 0.25", "time_budget: 0", "18: time_budget: must be finite and > 0 s, got 0.0"),
    ("time_budget: 0.25", "time_budget: -0.1", "18: time_budget: must be finite and > 0 s, got -0.1"),
    ("time_budget: 0.25", "time_buget: 0.25", "18: time_buget: unknown key; did you mean time_budget?"),
    ("scenario/1", "scenario/2", "1: format: must be optdock-scenario/1, got 'optdock-scenario/2'"),
    ("[1.0, 2.4]]", "[2.0, 1.9]]", "4: obstacles.0: must not cross or touch itself: Self-intersection"),
    ("frame: depot", "frame: 7", "2: frame: must be text, got 7"),
    ("frame: depot", "map: none.yaml", "2: map: none.yaml: cannot be read: No such file or directory"),
    (
        "  approach_distance: 0.4\n",
        "",
        "9: dock: approach_speed has no effect without approach_distance > 0 m",
    ),
    (
        "TrackingController",
        "TrakingController",
        "19: controller.plugin: controllers: unknown plugin 'TrakingController'; did you mean TrackingController?",
    ),
]


def test_a_wrong_value_is_named_with_line_key_and_rule(tmp_path):
    for old, new, message in WRONG_VALUES:
        start = f"bay.yaml:{message}"
        assert [line[: len(start)] for line in faults(tmp_path, with_change(old, new))] == [start]


WRONG_STEERING = [
    (
        "drive: ackermann, limits: {max_steering_angle: 0.6}",
        ".limits.max_steering_angle: 0.6 rad requires wheelbase > 0 m",
    ),
    (
        "drive: ackermann, limits: {wheelbase: 2.8, max_steering_angle: 35}",
        ".limits.max_steering_angle: must be > 0 and < pi / 2 rad, or inf, got 35",
    ),
    (
        "limits: {wheelbase: 2.8, max_steering_rate: 0.5}",
        ".limits.max_steering_rate: 0.5 rad/s is for drive: ackermann; this one is differential",
    ),
    ("limits: {wheel_base: 2.8}", ".limits.wheel_base: unknown key; write wheelbase: 2.8"),
]


def test_a_steering_that_is_none_is_refused(tmp_path):
    for limits, message in WRONG_STEERING:
        start = f"bay.yaml:2: robot{message}"
        found = faults(tmp_path, with_change("radius: 0.3", f"radius: 0.3, {limits}", MINIMAL))
        assert [line[: len(start)] for line in found] == [start]


def test_a_steering_is_read(tmp_path):
    steered = "radius: 0.3, drive: ackermann, limits: {wheelbase: 2.8, max_steering_angle: 0.6, max_steering_rate: .5}"
    (tmp_path / "bay.yaml").write_text(with_change("radius: 0.3", steered, MINIMAL))
    limits = load_scenario(tmp_path / "bay.yaml").problem.robot.limits
    assert limits == MotionLimits(wheelbase=2.8, max_steering_angle=0.6, max_steering_rate=0.5)


WRONG_OUTLINES = [
    ("footprint: [[0.4, 0.3], [-0.4, 0.3]]", ".footprint: a polygon needs at least 3 distinct vertices, got 2"),
    ("footprint: '[[0.4, 0.3], [-0.4, 0.3]]'", ".footprint: a polygon needs at least 3 distinct vertices, got 2"),
    (
        "footprint: [[0, 0], [1, 1], [1, 0], [0, 1]]",
        ".footprint: must not cross or touch itself: Self-intersection",
    ),
    ("footprint: [[0, 0], [1, 0], [2, 0]]", ".footprint: "),
    ("footprint: [[0, 0], [1, 0], [.nan, 1]]", ".footprint: must be finite, got nan at index [2, 0]"),
    ("footprint: [[0, 0], [1, 0], [a, 1]]", ".footprint: must be numbers, got "),
    ("footprint: '[[0, 0], [1, 0]'", ".footprint: must look like [[x, y], [x, y], [x, y], ...], got "),
    ("footprint: 3", ".footprint: must be a list of points [x, y], a text like it, or {radius: r}, got 3"),
    ("radius: -0.3", ".radius: must be finite and > 0 m, got -0.3"),
    ("radius: 0.3, footprint: {radius: 0.3}", ": needs either footprint or radius, got both"),
    ("drive: differential", ": needs either footprint or radius, got neither"),
]


def test_a_robot_without_a_proper_outline_is_refused(tmp_path):
    for robot, message in WRONG_OUTLINES:
        start = f"bay.yaml:2: robot{message}"
        found = faults(tmp_path, with_change("radius: 0.3", robot, MINIMAL))
        assert [line[: len(start)] for line in found] == [start]


def test_all_faults_are_listed_at_once_in_the_order_of_the_file(tmp_path):
    text = with_change("max_speed: 0.7, max_curvature: 2.0", "max_speed: -1.0, max_curvature: 0")
    text = with_change("frame: depot", "map: none.yaml", text)
    text = with_change("time_budget: 0.25", "time_budget: soon\nsmoother: {plugin: Smooth}", text)
    text = with_change("  pose: [4.0, 1.0, 0.5]\n", "", text)
    assert [line.split(": ")[1] for line in faults(tmp_path, text)] == [
        "map",
        "robot.limits.max_speed",
        "robot.limits.max_curvature",
        "dock.pose",
        "time_budget",
        "smoother.plugin",
    ]


def test_a_misspelt_parameter_of_a_plugin_is_named_with_its_line(tmp_path):
    text = MINIMAL + "planner:\n  plugin: DockPlanner\n  cost_treshold: 3\n  degree: 7\n"
    assert faults(tmp_path, text) == [
        "bay.yaml:7: planner.cost_treshold: unknown key; did you mean cost_threshold?",
        "bay.yaml:8: planner.degree: must be <= 2, got 7",
    ]


NO_SCENARIOS = [
    ("{", "bay.yaml:2: is not valid YAML"),
    ("", "bay.yaml: is empty"),
    ("- 1\n", "bay.yaml: must be a mapping with the key format: optdock-scenario/1"),
    (MINIMAL + "1: 2\n", "bay.yaml:5: 1: a key must be text, got 1"),
    (MINIMAL + "planner: {step: fine}\n", "bay.yaml:5: planner.step: must be a number, got 'fine'"),
    (MINIMAL + "smoother: {plugin: }\n", "bay.yaml:5: smoother.plugin: must be text, got None"),
    (MINIMAL + "dock: {pose: [2, 0, 0]}\n", "bay.yaml:5: dock: is repeated; first in line 3"),
    ("\x00", "bay.yaml: is not valid YAML"),
]


def test_text_that_is_no_scenario_is_refused(tmp_path):
    for text, message in NO_SCENARIOS:
        assert faults(tmp_path, text)[0][: len(message)] == message


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(InvalidFile, match=r"none\.yaml: cannot be read: No such file or directory"):
        load_scenario(tmp_path / "none.yaml")


def test_a_huge_image_header_is_refused_before_any_memory_is_taken(tmp_path):
    write_map(tmp_path / "maps", np.full((2, 2), 254), header="P5\n2000000000 2000000000\n255\n")
    (line,) = faults(tmp_path, MINIMAL + "map: maps/hall.yaml\n")
    assert line.startswith("bay.yaml:5: map: maps/hall.yaml:1: image: maps/hall.pgm: ")


def test_a_huge_png_header_is_refused_too(tmp_path):
    def chunk(name, body):
        return struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))

    write_map(tmp_path / "maps", np.full((2, 2), 254))
    header = chunk(b"IHDR", struct.pack(">IIBBBBB", 2**31 - 1, 2**31 - 1, 8, 0, 0, 0, 0))
    (tmp_path / "maps" / "hall.png").write_bytes(b"\x89PNG\r\n\x1a\n" + header + chunk(b"IDAT", b""))
    (tmp_path / "maps" / "hall.yaml").write_text(
        (tmp_path / "maps" / "hall.yaml").read_text().replace("hall.pgm", "hall.png")
    )
    (line,) = faults(tmp_path, MINIMAL + "map: maps/hall.yaml\n")
    assert "hall.png" in line


def test_a_real_map_becomes_obstacles_with_its_border(tmp_path, real_data):
    text = MINIMAL + f"map: {real_data / 'nav2' / 'maps' / 'depot.yaml'}\n"
    problem = scenario(tmp_path, text).problem
    assert (problem.costmap.columns, problem.costmap.rows) == (604, 307)
    assert "map border" in problem.all_obstacles.names


STATION_ON_THE_MAP = """\
format: optdock-scenario/1
robot: {footprint: [[0.95, 0.4], [-0.25, 0.4], [-0.25, -0.4], [0.95, -0.4]]}
dock:
  pose: [1.52, 7.6, 3.141592653589793]
  footprint: [[0.15, 7.2], [0.55, 7.2], [0.55, 8.0], [0.15, 8.0]]
start: {pose: [6.0, 5.2, 2.0]}
"""


def test_a_station_in_coordinates_of_the_map_is_refused_with_what_was_meant(tmp_path):
    (said,) = faults(tmp_path, STATION_ON_THE_MAP)
    assert said.startswith("bay.yaml:5: dock.footprint: is 6.800 m away from the docked robot, which is 1.442 m long: ")
    meant = said.removesuffix("?").partition("meant as ")[2]
    assert meant == "[[1.37, 0.4], [0.97, 0.4], [0.97, -0.4], [1.37, -0.4]]"
    outline = "[[0.15, 7.2], [0.55, 7.2], [0.55, 8.0], [0.15, 8.0]]"
    corrected = scenario(tmp_path, with_change(outline, meant, STATION_ON_THE_MAP)).problem
    station = corrected.all_obstacles
    assert np.vstack((station.lower, station.upper)) == pytest.approx(np.array([[0.15, 7.2], [0.55, 8.0]]))


@pytest.mark.parametrize(
    ("outline", "inside"),
    [
        ("[[0.3, 0.2], [-0.3, 0.2], [-0.3, -0.2], [0.3, -0.2]]", True),
        ("[[0.6, 0.2], [0.0, 0.2], [0.0, -0.2], [0.6, -0.2]]", True),
        ("[[0.6, 0.4], [-0.6, 0.4], [-0.6, -0.4], [0.6, -0.4], [0.6, -0.3], [-0.2, -0.3], [-0.2, 0.3], [0.6, 0.3]]",
         False),
        ("[[0.9, 0.2], [0.3, 0.2], [0.3, -0.2], [0.9, -0.2]]", False),
    ],
)  # fmt: skip
def test_an_outline_beside_its_own_origin_is_warned_of(tmp_path, caplog, outline, inside):
    scenario(tmp_path, with_change("radius: 0.3", f"footprint: {outline}", MINIMAL))
    said = [record.getMessage() for record in caplog.records if "does not contain [0, 0]" in record.getMessage()]
    assert len(said) == (0 if inside else 1)


def test_a_scenario_knows_which_limits_its_file_does_not_give(tmp_path):
    given = scenario(tmp_path, with_change("radius: 0.3", "radius: 0.3, limits: {max_speed: 0.5}", MINIMAL))
    assert "max_speed" not in given.default_limits  # given, though it is the default's value
    assert {"max_deceleration", "max_jerk", "max_curvature"} <= given.default_limits


def test_a_planner_that_is_named_is_the_only_one(tmp_path):
    named = scenario(tmp_path, MINIMAL + "planner: {plugin: ManoeuvrePlanner, turning_radius_factor: 2.0}\n")
    assert named.planner == (PluginChoice("ManoeuvrePlanner", {"turning_radius_factor": 2.0}),)
    told = scenario(tmp_path, MINIMAL + "planner: {alpha: 0.5}\n")
    assert told.planner == (PluginChoice("DockPlanner", {"alpha": 0.5}), PluginChoice("ManoeuvrePlanner"))
