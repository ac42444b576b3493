"""Scenario files that are written read back as the same problem; `optdock import` writes them."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from typer.testing import CliRunner

from optdock.cli import app
from optdock.config import Scenario, load_scenario, save_scenario
from optdock.errors import InvalidFile, InvalidValue
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.io.maps import load_map, save_map
from optdock.model.camera import Camera
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.costmap import Costmap
from optdock.model.dock import Dock, DockTolerances
from optdock.model.limits import MotionLimits
from optdock.model.problem import DockingProblem
from optdock.model.robot import Drive, Robot
from optdock.nav2.docking_problem import nav2_scenario
from optdock.planning.pipeline import plan_dock
from optdock.plugins.registry import PluginChoice

# An L-shaped robot, an L-shaped obstacle: nothing here is convex.
ELL = [[0.4, 0.3], [-0.4, 0.3], [-0.4, -0.3], [0.1, -0.3], [0.1, 0.1], [0.4, 0.1]]
CORNER = [[3.0, 0.0], [4.0, 0.0], [4.0, 2.0], [3.5, 2.0], [3.5, 0.5], [3.0, 0.5]]
CHARGER = Footprint(np.array([[0.41, -0.2], [0.6, -0.2], [0.6, 0.2], [0.41, 0.2]]))


def invoke(*words):
    return CliRunner().invoke(app, ["import", *map(str, words)])


def problem(**changes):
    limits = MotionLimits(max_curvature=1.7, max_yaw_rate=0.1 + 0.2, track_width=0.4)
    parts = {
        "start": Pose2(0.1, 0.2, 0.3),
        "dock": Dock(Pose2(1.0, -1.0, 1e-3), CHARGER, "backward", 0.25, 0.1, 0.3),
        "robot": Robot(Footprint(np.array(ELL)), limits, Drive.ACKERMANN),
        "obstacles": [CORNER],
        "clearance": ClearanceRule(0.04, 0.01, 0.3),
        "start_speed": 0.1,
        "start_curvature": -0.2,
        "frame": "hall",
    }
    return DockingProblem(**{**parts, **changes})


@settings(max_examples=20)
@given(number=st.floats(-1e3, 1e3), curvature=st.floats(1e-6, 1e6), budget=st.floats(1e-3, 1e3))
def test_what_is_written_reads_back_number_by_number(tmp_path_factory, number, curvature, budget):
    target = tmp_path_factory.mktemp("written") / "scene.yaml"
    robot = Robot(Footprint(np.array(ELL)), MotionLimits(max_curvature=curvature))
    asked = problem(start=Pose2(number, 0.2, number / 1e3), robot=robot)
    save_scenario(target, Scenario(asked, budget), obstacles=[CORNER])
    found = load_scenario(target)
    assert found.problem.fingerprint == asked.fingerprint
    assert found.time_budget == budget


def test_every_part_of_a_scenario_is_written(tmp_path):
    timing = PluginChoice("Windowed", {})
    asked = Scenario(problem(), controller=PluginChoice("TrackingController", {"preview": 0.1}), timing=timing)
    assert save_scenario(tmp_path / "a" / "b.yaml", asked, note="one\ntwo") == (tmp_path / "a" / "b.yaml",)
    text = (tmp_path / "a" / "b.yaml").read_text()
    assert text.startswith("# one\n# two\nformat: optdock-scenario/1\n")
    found = load_scenario(tmp_path / "a" / "b.yaml")
    assert found.problem.fingerprint == asked.problem.fingerprint
    assert (found.controller, found.timing) == (asked.controller, timing)
    assert (found.planner, found.smoother) == (Scenario.planner, Scenario.smoother)


def test_every_limit_is_written_or_stays_unsaid(tmp_path):
    values = {spec.name: 0.05 * (3 + i) for i, spec in enumerate(dataclasses.fields(MotionLimits))}
    robot = Robot(CHARGER, MotionLimits(**values), Drive.ACKERMANN)
    save_scenario(tmp_path / "all.yaml", Scenario(problem(robot=robot)))
    assert load_scenario(tmp_path / "all.yaml").problem.robot.limits == robot.limits
    usual = Scenario(problem(robot=Robot(CHARGER, MotionLimits())), default_limits=frozenset({"max_speed", "max_jerk"}))
    save_scenario(tmp_path / "usual.yaml", usual)
    assert {"max_speed", "max_jerk"} <= load_scenario(tmp_path / "usual.yaml").default_limits
    assert load_scenario(tmp_path / "usual.yaml").problem.fingerprint == usual.problem.fingerprint


@pytest.mark.parametrize(
    "camera", [Camera(Pose2(0.3, 0.0, 0.1), 1.0, 0.2, 3.0), Camera(Pose2(0.0, 0.0, 0.0), 2.0 * math.pi)]
)
def test_camera_and_view_are_written(tmp_path, camera):
    dock = dataclasses.replace(problem().dock, marker=(0.5, 0.1), visible_distance=1.5, blind_distance=0.25)
    asked = problem(dock=dock, robot=dataclasses.replace(problem().robot, camera=camera))
    save_scenario(tmp_path / "seen.yaml", Scenario(asked))
    found = load_scenario(tmp_path / "seen.yaml").problem
    assert found.fingerprint == asked.fingerprint
    assert found.robot.camera == camera
    assert (found.dock.marker, found.dock.visible_distance, found.dock.blind_distance) == ((0.5, 0.1), 1.5, 0.25)
    plain, *_ = save_scenario(tmp_path / "plain.yaml", Scenario(problem()))
    assert not any(word in plain.read_text() for word in ("camera", "marker", "visible", "blind"))


def grid(*, unknown=True):
    cells = np.full((30, 40), 0, dtype=np.uint8)
    cells[0], cells[:, 0], cells[10:12, 30:33] = 254, 253, 254
    cells[20:25, 5:9] = 255 if unknown else 0
    return Costmap(cells, 0.1, (-2.0, -1.55))


def test_a_map_is_drawn_beside_the_scenario_where_no_file_says_the_same(tmp_path):
    asked = Scenario(problem(start=Pose2(0.0, 0.5, 0.0), costmap=grid()))
    written = save_scenario(tmp_path / "deep" / "scene.yaml", asked)
    assert [file.name for file in written] == ["scene.yaml", "scene_map.yaml", "scene_map.pgm"]
    assert load_scenario(written[0]).problem.fingerprint == asked.problem.fingerprint
    save_map(tmp_path / "same.yaml", grid())
    save_map(tmp_path / "other.yaml", grid(unknown=False))
    named = save_scenario(tmp_path / "deep" / "named.yaml", asked, map_source=tmp_path / "same.yaml")
    assert [file.name for file in named] == ["named.yaml"]
    assert "map: ../same.yaml\n" in named[0].read_text()
    assert load_scenario(named[0]).problem.fingerprint == asked.problem.fingerprint
    drawn = save_scenario(tmp_path / "deep" / "drawn.yaml", asked, map_source=tmp_path / "other.yaml")
    assert len(drawn) == 3


def test_a_map_that_is_written_reads_back_cell_by_cell(tmp_path):
    save_map(tmp_path / "map.yaml", grid())
    found = load_map(tmp_path / "map.yaml").costmap
    assert (found.resolution, found.origin) == (0.1, (-2.0, -1.55))
    assert np.array_equal(found.data, np.where(grid().data == 253, 0, grid().data))


def test_what_a_scenario_file_cannot_say_is_refused(tmp_path):
    free = problem(start=Pose2(0.0, 0.5, 0.0), costmap=grid(), unknown_is_obstacle=False)
    loose = problem(dock=Dock(Pose2(1.0, -1.0, 0.0), tolerances=DockTolerances(along=0.1)))
    for asked, told in ((free, "unknown_is_obstacle"), (loose, "tolerances")):
        with pytest.raises(InvalidValue, match=told):
            save_scenario(tmp_path / "scene.yaml", Scenario(asked))
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_left_of_a_file_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InvalidFile, match="cannot be written"):
        save_scenario(tmp_path / "file" / "scene.yaml", Scenario(problem()))
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.fixture
def nav2_files(tmp_path):
    from tests.optdock.nav2.test_docking_problem import PARAMS

    (tmp_path / "params.yaml").write_text(PARAMS)
    (tmp_path / "maps").mkdir()
    picture = np.full((80, 120), 254, np.uint8)
    picture[10:20, 10:20], picture[60:70, 10:20] = 0, 205
    Image.fromarray(picture).save(tmp_path / "maps" / "hall.png")
    (tmp_path / "maps" / "hall.yaml").write_text(
        "image: hall.png\nresolution: 0.05\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    return tmp_path


def test_files_of_nav2_become_a_scenario_of_the_same_problem(nav2_files):
    words = ("nav2", "--nav2-params", nav2_files / "params.yaml", "--map", nav2_files / "maps" / "hall.yaml")
    done = invoke(*words, "--dock", "home", "--start", "3.5,1.5,0.1", "-o", nav2_files / "home.yaml")
    assert done.exit_code == 0, done.output
    assert "map: maps/hall.yaml\n" in (nav2_files / "home.yaml").read_text()
    direct = nav2_scenario(nav2_files / "params.yaml", nav2_files / "maps" / "hall.yaml", "3.5,1.5,0.1")
    scenario = load_scenario(nav2_files / "home.yaml")
    assert scenario.problem.fingerprint == direct.problem.fingerprint
    assert scenario.default_limits == direct.default_limits
    assert plan_dock(scenario.problem, time_budget=5.0, planner="DockPlanner").certificate.certified
    refused = invoke(*words, "--dock", "hme", "--start", "3.5,1.5,0.1", "-o", nav2_files / "other.yaml")
    assert refused.exit_code != 0
    assert "has no dock 'hme'; did you mean home?" in refused.stderr
    assert not (nav2_files / "other.yaml").exists()
