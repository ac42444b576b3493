"""Readers of public parking cases: what they read, and how they refuse."""

import json
import math

import pytest

from experiments.parking_cases import OBCA_SCENES, load_obca, load_tpcap, main, obca_cases
from optdock.config import load_scenario
from optdock.errors import InvalidFile, InvalidValue
from optdock.model.robot import Drive
from optdock.planning.pipeline import plan_dock

# A square and an L, which is not convex.
CASE = "1,2,0.5, 8,2,-0.5, 2, 4,6, 0,5,1,5,1,6,0,6, 5,5,8,5,8,6,6,6,6,8,5,8"
SCENES = {
    "vehicle": {
        "wheelbase": 2.7, "front_from_rear_axle": 3.7, "rear_from_rear_axle": 1.0, "width": 2.0, "max_steer": 0.6,
        "max_steer_rate": 0.6, "max_acc": 0.4, "v_min": -1, "v_max": 2, "dmin": 0.05,
    },
    "start_grid": {"x": [-1, 0], "y": [6, 7, 8], "yaw": 0.0},
    "backwards": {"obstacles": [[[1.3, 5], [20, 5], [20, -5], [1.3, -5]]], "goal": [0, 1.3, 1.57]},
    "parallel": {"obstacles": [], "goal": [-1.35, 4, 0]},
}  # fmt: skip


@pytest.fixture
def tpcap(tmp_path):
    def refusal_or_case(text):
        (tmp_path / "case.csv").write_text(text)
        try:
            return load_tpcap(tmp_path / "case.csv")
        except InvalidFile as error:
            return str(error).replace(f"{tmp_path}/", "")

    return refusal_or_case


def scenes(folder, **changes):
    (folder / "scenes.json").write_text(json.dumps({**SCENES, **changes}, indent=1))
    return folder / "scenes.json"


def test_a_case_of_the_competition_is_read_as_it_stands(tpcap):
    case = tpcap(CASE)
    assert (case.start.x, case.start.yaw, case.goal.x, case.goal.yaw, case.clearance) == (1.0, 0.5, 8.0, -0.5, 0.0)
    assert case.obstacles[1] == [[5, 5], [8, 5], [8, 6], [6, 6], [6, 8], [5, 8]]
    problem = case.problem
    assert problem.clearance.required == problem.clearance.at_dock == problem.dock.final_straight == 0.0
    assert problem.dock.footprint is None
    assert problem.obstacles.names == ("obstacles[0]", "obstacles[1]")
    assert problem.robot.drive is Drive.ACKERMANN
    assert problem.robot.limits.max_curvature == pytest.approx(math.tan(0.75) / 2.8)
    assert problem.robot.footprint.length == pytest.approx(4.689)


def test_rows_may_be_broken_into_lines(tpcap):
    assert tpcap(CASE.replace("2, 4,6,", "2,\n4,6,\n") + "\n").obstacles == tpcap(CASE).obstacles


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "case.csv: is empty"),
        ("1,2,x,4,5,6,0", "case.csv:1: value 3: must be a finite number, got 'x'"),
        ("1,2,\nnan,4,inf,6,0", "case.csv:2: value 3: must be a finite number, got 'nan'\n"
         "case.csv:2: value 5: must be a finite number, got 'inf'"),
        ("1,2,3,4", "case.csv:1: value 7, the number of obstacles: must be a whole number >= 0, got the end of the "
         "file"),
        ("1,2,3,4,5,6,1.5", "case.csv:1: value 7, the number of obstacles: must be a whole number >= 0, got 1.5"),
        ("1,2,3,4,5,6,1,2", "case.csv:1: value 8, the number of vertices of obstacles[0]: must be a whole number >= 3, "
         "got 2"),
        ("1,2,3,4,5,6,1e99", "case.csv:1: value 7, the number of obstacles: must be a whole number >= 0, got 1e+99"),
        (CASE + ",1", "case.csv: must hold 29 numbers by its counts, got 30"),
        (CASE.replace("0.5", "90", 1), "case.csv:1: value 3, the start pose: yaw 90 is beyond 2 pi; degrees? write "
         "radians, 1.5708"),
        (CASE.replace("1,6,0,6", "0,6,1,6"), "case.csv:1: value 10, obstacles[0]: must not cross or touch itself: "
         "Self-intersection[0.5 5.5]"),
    ],
)  # fmt: skip
def test_a_broken_case_is_refused_by_line_and_value(tpcap, text, told):
    assert tpcap(text) == told


def test_files_that_are_no_text_are_refused(tmp_path):
    with pytest.raises(InvalidFile, match="cannot be read: No such file"):
        load_tpcap(tmp_path / "none.csv")
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InvalidFile, match="as UTF-8 text"):
        load_tpcap(tmp_path / "binary.csv")


def test_every_start_of_a_scene_is_a_case(tmp_path):
    cases = obca_cases(scenes(tmp_path), "backwards")
    assert [(case.start.x, case.start.y) for case in cases] == [(x, y) for x in (-1, 0) for y in (6, 7, 8)]
    problem = load_obca(tmp_path / "scenes.json", "backwards", 4).problem
    assert (problem.start.x, problem.start.y) == (0, 7)
    assert problem.clearance.required == problem.clearance.at_dock == 0.05
    assert problem.robot.limits.max_reverse_speed == 1.0
    assert problem.robot.limits.max_curvature_rate == pytest.approx(0.6 / 2.7 / 0.5)
    assert obca_cases(tmp_path / "scenes.json", "parallel")[0].problem.goal.x == -1.35


def test_scenes_and_starts_that_there_are_not(tmp_path):
    with pytest.raises(
        InvalidValue, match="scene: must be backwards or parallel, got 'paralel'; did you mean parallel"
    ):
        load_obca(scenes(tmp_path), "paralel", 0)
    for start in (-1, 6):
        with pytest.raises(InvalidValue, match=rf"start: must be in 0..5, got {start}"):
            load_obca(tmp_path / "scenes.json", "parallel", start)


def test_broken_scenes_are_refused_with_every_line_and_key(tmp_path):
    vehicle = {**SCENES["vehicle"], "width": -2.0, "max_steer": 1.6, "wheelbas": 1}
    crossed = {"obstacles": [[[0, 0], [1, 1], [1, 0], [0, 1]]], "goal": [0, 0, 90]}
    with pytest.raises(InvalidFile) as refused:
        obca_cases(scenes(tmp_path, vehicle=vehicle, parallel=crossed), "parallel")
    told = str(refused.value).replace(f"{tmp_path}/", "").splitlines()
    assert told[0] == "scenes.json:6: vehicle.width: must be > 0.0, got -2.0"
    assert "scenes.json:13: vehicle.wheelbas: unknown key; did you mean wheelbase?" in told
    assert any("vehicle.max_steer: must be < 1.57" in line for line in told)
    assert any("parallel.goal.2: yaw 90 is beyond 2 pi" in line for line in told)
    assert any(
        "parallel.obstacles.0: polygon: must not cross" in line or "obstacles.0: must not cross" in line
        for line in told
    )


def test_the_true_files_are_read(real_data):
    for number in range(1, 11):
        assert len(load_tpcap(real_data / "tpcap" / f"Case{number}.csv").problem.obstacles) >= 2
    for scene in OBCA_SCENES:
        assert len(obca_cases(real_data / "obca" / "scenes.json", scene)) == 84


def test_a_case_and_a_scene_become_scenarios(tmp_path, capsys):
    (tmp_path / "case.csv").write_text("0,0,0, 6,0,0, 1, 6, 0,2,6,2,6,3,3,3,3,4,0,4")
    assert main([str(tmp_path / "case.csv"), "-o", str(tmp_path / "case.yaml")]) == 0
    assert capsys.readouterr().out == f"written: {tmp_path / 'case.yaml'}\n"
    scenario = load_scenario(tmp_path / "case.yaml")
    assert scenario.time_budget == 1.0
    assert plan_dock(scenario.problem, time_budget=5.0, planner="DockPlanner").certificate.certified
    words = [str(scenes(tmp_path)), "-o", str(tmp_path / "p.yaml"), "--time-budget", "0.5", "--scene"]
    assert main([*words, "backwards", "--start", "4"]) == 0
    scenario = load_scenario(tmp_path / "p.yaml")
    assert (scenario.problem.start.y, scenario.time_budget) == (7, 0.5)
    for asked, told in (("side", "scene: must be"), ("parallel --start 6", "start: must be in 0..5, got 6")):
        assert main([*words, *asked.split()]) == 2
        assert told in capsys.readouterr().err
