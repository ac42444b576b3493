import csv
import dataclasses
import itertools
import json
import logging
import pathlib
import re
import subprocess
import sys
import typing

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from optdock.cli import app
from optdock.config import demo_scenario, load_scenario
from optdock.deadline import budget_clock
from optdock.errors import NoMotionExists
from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.pose import Pose2
from optdock.impossibility import prove_impossible
from optdock.io.plan_file import PlanFile, TrajectoryColumns, load_plan, save_plan
from optdock.model.constant_jerk import TimeLaw
from optdock.model.path import ClothoidSegment, Path
from optdock.model.trajectory import Trajectory
from optdock.plotting import save_plan_picture
from optdock.reports.report import failed_plan_file

pytestmark = pytest.mark.usefixtures("coarse_pictures")
SCENARIO = """\
format: optdock-scenario/1
obstacles:
  - [[1.0, 1.4], [2.0, 1.4], [2.0, 2.4], [1.0, 2.4]]
robot:
  footprint: [[0.4, 0.3], [-0.4, 0.3], [-0.4, -0.3], [0.4, -0.3]]
  limits: {max_speed: 0.5, max_curvature: 2.0, max_curvature_rate: 8.0}
dock:
  pose: [4.0, 1.0, 0.0]
  footprint: [[0.42, -0.4], [0.6, -0.4], [0.6, 0.4], [0.42, 0.4]]
  final_straight: 0.3
  approach_speed: 0.1
  approach_distance: 0.3
start: {pose: [1.0, 0.2, 0.4]}
clearance: {required: 0.05, at_dock: 0.0, taper: 0.5}
time_budget: 5.0
"""
NEAR = SCENARIO.replace("pose: [1.0, 0.2, 0.4]", "pose: [2.8, 1.0, 0.0]")


@pytest.fixture(autouse=True)
def in_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def write(text=SCENARIO, old="", new="", name="bay.yaml"):
    assert not old or text.count(old) == 1, old
    pathlib.Path(name).write_text(text.replace(old, new) if old else text)
    return name


def run(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def planned(tmp_path_factory):
    """The plan file and the output of one successful call."""
    folder = tmp_path_factory.mktemp("planned")
    (folder / "bay.yaml").write_text(SCENARIO)
    result = run("plan", folder / "bay.yaml", "--out", folder / "plan.json", "--spacing", "0.05", "--period", "0.1")
    assert result.exit_code == 0, result.output
    return folder, result.stdout


def test_help_loads_no_heavy_library():
    code = """
import sys
from optdock.cli import app
try:
    app(["--help"])
except SystemExit as stop:
    assert stop.code == 0
heavy = {"scipy", "casadi", "matplotlib", "shapely", "ruckig", "PIL", "numpy", "pydantic"}
print("loaded:", sorted(heavy & set(sys.modules)))
"""
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.splitlines()[-1] == "loaded: []"
    for command in ("plan", "simulate", "certify", "compare", "demo", "plugins", "schema"):
        assert command in result.stdout


def test_every_number_in_the_help_has_its_unit():
    numbers = {}
    for command in app.registered_commands:
        hints = typing.get_type_hints(command.callback, include_extras=True)
        # Python 3.10 puts an Optional of its own around the hint of a parameter whose default is None.
        hints = {
            n: h if hasattr(h, "__metadata__") or n == "return" else typing.get_args(h)[0] for n, h in hints.items()
        }
        for name, (kind, described) in {
            n: h.__args__ + h.__metadata__ for n, h in hints.items() if n != "return"
        }.items():
            if kind in (float, float | None):
                numbers[command.callback.__name__, f"--{name.replace('_', '-')}"] = described.metavar
    assert {option for _, option in numbers} >= {"--time-budget", "--spacing", "--period", "--lag", "--yaw-noise"}
    helps = {command: run(command, "--help").stdout for command, _ in numbers}
    for (command, option), unit in numbers.items():
        assert unit in {"SECONDS", "METRES", "RADIANS"}, (command, option)
        assert re.search(rf"{option} +{unit}\b", helps[command]), (command, option)


def test_no_help_text_holds_what_markup_would_swallow():
    command = typer.main.get_command(app)
    for part in (command, *command.commands.values()):
        texts = [part.help or "", *(getattr(option, "help", None) or "" for option in part.params)]
        assert not [text for text in texts if re.search(r"\[[a-z/]", text)]


def test_the_example_in_the_help_of_plan_is_whole():
    words = " ".join(run("plan", "--help").stdout.split())
    assert "optdock plan demo/scenario.yaml --out plan.json --plot plan.png" in words


def test_verbose_is_accepted_before_and_after_the_command(caplog):
    """Once in a process of its own, whose warm-up must not look like a plan."""
    write()
    command = [sys.executable, "-c", "from optdock.cli import main; main()", "-v", "plan", "bay.yaml"]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 0
    assert result.stdout.splitlines()[0].split() == ["status", "certified"]
    logging.getLogger("optdock").setLevel(logging.NOTSET)
    assert run("plan", "bay.yaml", "-v").exit_code == 0
    for said in (result.stderr, "\n".join(caplog.messages)):
        assert re.findall(r"certified: (\S+) m in ", said) == [f"{load_plan('plan.json').path.length:.2f}"]


def test_plan_says_which_limits_hold_and_which_do_not(planned):
    _, stdout = planned
    words = " ".join(stdout.split())
    assert "limits speed 0.5 m/s, reverse speed 0.3 m/s (default), acceleration 0.5 m/s^2 (default)," in words
    assert "curvature 2 1/m, curvature rate 8 1/m^2 unlimited yaw rate, yaw acceleration, lateral acceleration" in words


def test_plan_writes_a_certified_plan_and_says_so(planned):
    folder, stdout = planned
    document = json.loads((folder / "plan.json").read_text())
    assert (document["format"], document["status"], document["completed"]) == ("optdock-plan/1", "certified", True)
    assert document["certificate"]["certified"] is True
    assert document["certificate"]["trajectory"]["certified"] is True
    assert max(np.diff(document["path"]["s"])) <= 0.05 + 1e-12
    assert max(np.diff(document["trajectory"]["t"])) <= 0.1 + 1e-12
    assert document["trajectory"]["speed"][-1] == pytest.approx(0.0, abs=1e-9)
    assert set(document["timing_ms"]) == {"plan", "smooth", "certify", "time", "first", "total"}
    assert stdout.splitlines()[0].split() == ["status", "certified"]


def test_certify_accepts_what_plan_wrote(planned):
    folder, _ = planned
    result = run("certify", folder / "plan.json", folder / "bay.yaml")
    assert (result.exit_code, result.stderr) == (0, "")
    lines = result.stdout.splitlines()
    assert lines[0].split() == ["verdict", "certified"]
    assert re.search(r"^motion +12 phases, 9\.882 s, certified; 10\d samples agree with them$", lines[-1])


def without_phases(document):
    """The document as a program writes it that knows samples only."""
    changed = json.loads(json.dumps(document))
    del changed["trajectory"]["phases"]
    return changed


def rounded(value, decimals):
    """Every number of a JSON value rounded."""
    if isinstance(value, dict):
        return {key: rounded(item, decimals) for key, item in value.items()}
    if isinstance(value, list):
        return [rounded(item, decimals) for item in value]
    return round(value, decimals) if isinstance(value, float) else value


def test_samples_alone_are_not_called_certified(planned):
    folder, _ = planned
    document = json.loads((folder / "plan.json").read_text())
    for changed in (without_phases(document), rounded(without_phases(document), 6)):
        pathlib.Path("samples.json").write_text(json.dumps(changed))
        result = run("certify", "samples.json", folder / "bay.yaml")
        assert result.exit_code == 3
        lines = result.stdout.splitlines()
        assert lines[0].split(maxsplit=1) == ["verdict", "path certified, motion not refuted and not proven"]
        assert "samples agree with each other, the path and the limits" in lines[-1]
        assert lines[-1].endswith("the motion between them (100 ms) is not proven")
        assert result.stdout.count("certified") == 1


def test_poses_beside_the_path_are_said_to_be(planned):
    folder, _ = planned
    document = without_phases(json.loads((folder / "plan.json").read_text()))
    document["trajectory"] = rounded(document["trajectory"], 4)
    pathlib.Path("samples.json").write_text(json.dumps(document))
    result = run("certify", "samples.json", folder / "bay.yaml")
    assert result.exit_code == 3
    assert re.search(r"with poses up to \S+e-05 m and \S+e-05 rad off it, which its clearance covers", result.stdout)


def test_rounded_phases_prove_nothing_and_refute_nothing(planned):
    folder, _ = planned
    document = json.loads((folder / "plan.json").read_text())
    document["trajectory"] = rounded(document["trajectory"], 6)
    document["trajectory"]["phases"]["durations"][0] += 1e-5
    pathlib.Path("rounded.json").write_text(json.dumps(rounded(document, 6)))
    result = run("certify", "rounded.json", folder / "bay.yaml")
    assert result.exit_code == 3
    assert "the phases are rounded and cannot prove the motion; " in result.stdout.splitlines()[-1]


@pytest.mark.parametrize(
    "phases",
    [
        {"start": [0.0, 0.0, 0.0], "durations": [1.0, 1.0], "jerks": [100.0, -100.0]},
        lambda own: {**own, "durations": [0.5 * one for one in own["durations"]]},
        lambda own: {**own, "jerks": [1.01 * one for one in own["jerks"]]},
    ],
)
def test_phases_of_another_motion_are_not_called_rounded(planned, phases):
    folder, _ = planned
    document = json.loads((folder / "plan.json").read_text())
    own = document["trajectory"]["phases"]
    document["trajectory"]["phases"] = phases(own) if callable(phases) else phases
    pathlib.Path("other.json").write_text(json.dumps(rounded(document, 6)))
    result = run("certify", "other.json", folder / "bay.yaml")
    assert result.exit_code == 3
    assert re.search(r"motion +\d+ phases, .* s, refuted", result.stdout)


def test_phases_that_begin_with_an_acceleration_are_refuted(planned):
    folder, _ = planned
    plan = load_plan(folder / "plan.json")
    jerk, begins, top = 1.0, 0.125, 0.0078125
    ends = top**0.5
    cruise = (plan.path.length - begins**3 * jerk / 3.0 - top * ends) / top
    law = TimeLaw([begins, cruise, ends, ends], [-jerk, 0.0, -jerk, jerk], 0.0, 0.0, 0.125)
    columns = TrajectoryColumns.from_trajectory(Trajectory(plan.path, law), 0.1)
    save_plan("kicked.json", dataclasses.replace(plan, trajectory=columns, time_law=law))
    result = run("certify", "kicked.json", folder / "bay.yaml")
    assert result.exit_code == 3
    assert "the motion begins with acceleration 0.125, the robot has 0" in " ".join(result.stdout.split())


def test_phases_that_break_a_limit_are_refuted(planned):
    folder, _ = planned
    document = json.loads((folder / "plan.json").read_text())
    document["trajectory"]["phases"]["jerks"][0] *= 1.1
    pathlib.Path("jerk.json").write_text(json.dumps(document))
    result = run("certify", "jerk.json", folder / "bay.yaml")
    assert result.exit_code == 3
    assert "12 phases" in result.stdout
    assert "refuted" in result.stdout


@pytest.mark.parametrize(
    ("key", "value", "claim"),
    [
        ("min_clearance", 0.5, "certificate.min_clearance is 0.5 m, proven is 0.02 m"),
        ("max_curvature", 0.1, "certificate.max_curvature is 0.1 1/m, proven is 0.39"),
        ("length", 2.0, "certificate.length is 2 m, proven is 3.13"),
    ],
)
def test_a_false_claim_is_named(planned, key, value, claim):
    folder, _ = planned
    document = json.loads((folder / "plan.json").read_text())
    document["certificate"][key] = value
    pathlib.Path("claim.json").write_text(json.dumps(document))
    result = run("certify", "claim.json", folder / "bay.yaml")
    assert result.exit_code == 3
    assert result.stderr.startswith(f"false claim: {claim}")
    assert re.search(r"^false claim +" + re.escape(claim), result.stdout, re.MULTILINE)


def test_a_path_that_only_says_it_is_certified_is_named(planned):
    folder, _ = planned
    moved = write(SCENARIO, "[[1.0, 1.4], [2.0, 1.4], [2.0, 2.4], [1.0, 2.4]]", "[[2, 0], [2.2, 0], [2.2, 1], [2, 1]]")
    result = run("certify", folder / "plan.json", moved)
    assert result.exit_code == 3
    assert "false claim: status is 'certified', but the path is not certified\n" in result.stderr
    assert "false claim: certificate.certified is true, but the path is not certified\n" in result.stderr


def test_certify_says_that_a_file_holds_no_motion(planned):
    folder, _ = planned
    document = json.loads((folder / "plan.json").read_text())
    del document["trajectory"]
    pathlib.Path("path.json").write_text(json.dumps(document))
    result = run("certify", "path.json", folder / "bay.yaml")
    assert result.exit_code == 0
    assert result.stdout.splitlines()[-1].split(maxsplit=1) == ["motion", "none in the file; only the path is checked"]


def test_certify_judges_a_path_that_optdock_did_not_make(planned):
    folder, _ = planned
    straight = {"x": [1.0, 4.0], "y": [0.2, 1.0], "yaw": [0.26, 0.26]}
    pathlib.Path("foreign.json").write_text(json.dumps({"format": "optdock-plan/1", "path": straight}))
    result = run("certify", "foreign.json", folder / "bay.yaml")
    assert result.exit_code == 3
    assert result.stderr.startswith("not certified: ")
    assert result.stderr.count("\n") == 1


def test_certify_names_what_a_file_was_proven_against(planned):
    folder, _ = planned
    (folder / "nearer.yaml").write_text(SCENARIO.replace("max_speed: 0.5", "max_speed: 0.6").replace("0.05", "0.04"))
    done = run("certify", folder / "plan.json", folder / "nearer.yaml")
    assert done.exit_code == 0
    assert "another problem: limits, clearance differ" in done.stdout


def test_certify_refuses_a_plan_of_another_frame(planned):
    folder, _ = planned
    document = json.loads((folder / "plan.json").read_text())
    pathlib.Path("odom.json").write_text(json.dumps({**document, "frame": "odom"}))
    result = run("certify", "odom.json", folder / "bay.yaml")
    assert result.exit_code == 3
    assert "not certified: the plan is in frame 'odom', the scenario in frame 'map'" in result.stderr
    pathlib.Path("unnamed.json").write_text(json.dumps({**document, "frame": ""}))
    assert run("certify", "unnamed.json", folder / "bay.yaml").exit_code == 0


def test_certify_notices_a_path_through_an_obstacle(planned):
    folder, _ = planned
    problem = load_scenario(folder / "bay.yaml").problem
    plan = load_plan(folder / "plan.json")
    moved = write(SCENARIO, "[[1.0, 1.4], [2.0, 1.4], [2.0, 2.4], [1.0, 2.4]]", "[[2, 0], [2.2, 0], [2.2, 1], [2, 1]]")
    result = run("certify", folder / "plan.json", moved)
    assert result.exit_code == 3
    assert "obstacles[0]" in result.stderr
    assert plan.path.end.distance_to(problem.goal) < 1e-6


@pytest.mark.parametrize(
    ("column", "change", "fault"),
    [
        ("speed", lambda v: [1.02 * x for x in v], "distance off its speeds [m]: "),
        ("acceleration", lambda v: [x + 1.0 for x in v], "acceleration [m/s^2]: "),
        ("jerk", lambda v: [3.0 for x in v], "jerk [m/s^3]: 3 at t = 0.000 s, limit 2"),
        ("x", lambda v: [*v[:9], v[9] + 0.01, *v[10:]], "pose at t = 0.900 s is 0.00"),
        ("speed", lambda v: [*v[:-1], 0.05], "end speed [m/s]: 0.05"),
        ("speed", lambda v: [0.05, *v[1:]], "start speed [m/s]: 0.05, the robot has 0"),
    ],
)
def test_certify_notices_a_motion_that_breaks_its_limits(planned, column, change, fault):
    folder, _ = planned
    document = json.loads((folder / "plan.json").read_text())
    document["trajectory"][column] = change(document["trajectory"][column])
    pathlib.Path("changed.json").write_text(json.dumps(document))
    result = run("certify", "changed.json", folder / "bay.yaml")
    assert result.exit_code == 3
    assert re.search(rf"^violation +{column} at t = \S+ s is ", result.stdout, re.MULTILINE)
    pathlib.Path("changed.json").write_text(json.dumps(without_phases(document)))
    result = run("certify", "changed.json", folder / "bay.yaml")
    assert result.exit_code == 3
    assert fault in result.stdout


def test_certify_refuses_a_file_without_a_path(planned):
    folder, _ = planned
    save_plan("empty.json", PlanFile(status="GoalOccupied"))
    result = run("certify", "empty.json", folder / "bay.yaml")
    assert (result.exit_code, result.stderr) == (
        3,
        "not certified: the file has no path; its status is GoalOccupied\n",
    )


def test_certify_refuses_a_broken_plan_file(planned):
    folder, _ = planned
    pathlib.Path("broken.json").write_text('{"format": "optdock-plan/1", "path": {"x": [1]}}')
    result = run("certify", "broken.json", folder / "bay.yaml")
    assert result.exit_code == 2
    assert result.stderr == "broken.json: path.y: Field required\nbroken.json: path.yaw: Field required\n"


FAILURES = {
    "start in collision": (
        "pose: [1.0, 0.2, 0.4]",
        "pose: [1.5, 1.5, 0.0]",
        "StartOccupied: the footprint at the start overlaps obstacles[0] by 0.4000 m\n",
        205,
    ),
    "goal in collision": (
        "[[0.42, -0.4], [0.6, -0.4], [0.6, 0.4], [0.42, 0.4]]",
        "[[0.35, -0.4], [0.6, -0.4], [0.6, 0.4], [0.35, 0.4]]",
        "GoalOccupied: the footprint at the goal overlaps dock by 0.0500 m\n",
        206,
    ),
    "no way out": (
        "[[1.0, 1.4], [2.0, 1.4], [2.0, 2.4], [1.0, 2.4]]",
        # A wall all around the start but for a slit.
        "[[-0.7, 0], [-0.7, -1.7], [2.7, -1.7], [2.7, 2.1], [-0.7, 2.1], [-0.7, 0.01], [-0.5, 0.01], [-0.5, 1.9],"
        " [2.5, 1.9], [2.5, -1.5], [-0.5, -1.5], [-0.5, 0]]",
        "NoMotionExists: no motion joins start and goal",
        208,
    ),
    "start too close": (
        "start: {pose: [1.0, 0.2, 0.4]}",
        "start: {pose: [3.9, 1.0, 0.0]}\nplanner: {plugin: DockPlanner}",
        "NoValidPathCouldBeFound: ",
        208,
    ),
}


@pytest.mark.parametrize("name", FAILURES)
def test_a_hopeless_problem_ends_with_its_status_a_line_and_a_file(name):
    old, new, message, code = FAILURES[name]
    result = run("plan", write(SCENARIO, old, new), "--out", "out.json")
    assert (result.exit_code, result.stdout) == (4 if message.startswith("NoMotionExists") else 3, "")
    assert result.stderr.startswith(message)
    assert result.stderr.count("\n") == 1
    document = json.loads(pathlib.Path("out.json").read_text())
    assert document["status"] == message.split(":")[0]
    assert document["error"]["code"] == code
    assert document["error"]["message"] == result.stderr.partition(": ")[2].strip()
    assert "path" not in document
    assert "total" in document["timing_ms"]


def test_a_path_that_cannot_be_smoothed_leaves_its_raw_path_and_a_picture(tmp_path):
    text = SCENARIO + "planner: {plugin: DockPlanner}\n"
    wall = write(text, "[[1.0, 1.4], [2.0, 1.4], [2.0, 2.4], [1.0, 2.4]]", "[[2, -9], [2.1, -9], [2.1, 9], [2, 9]]")
    result = run("plan", wall, "--out", "out.json", "--plot", "out.png")
    assert (result.exit_code, result.stdout) == (3, "")
    assert result.stderr.startswith("FailedToSmoothPath: clearance: ")
    left = load_plan(tmp_path / "out.json")
    assert left.error.code == 504
    assert left.error.where["obstacle"] == "obstacles[0]"
    assert left.raw_path.end.distance_to(load_scenario(wall).problem.goal) < 1e-6
    assert (left.path, left.trajectory) == (None, None)
    assert (tmp_path / "out.png").stat().st_size > 1000


def test_the_picture_of_a_failure_that_cannot_be_drawn_hides_no_reason():
    pathlib.Path("file").write_text("")
    write(SCENARIO, "pose: [1.0, 0.2, 0.4]", "pose: [1.5, 1.5, 0.0]")
    result = run("plan", "bay.yaml", "--plot", "file/p.png")
    assert result.exit_code == 3
    lines = result.stderr.splitlines(keepends=True)
    assert lines[0].startswith("file/p.png: cannot be written: ")
    assert lines[1:] == [FAILURES["start in collision"][2]]


@pytest.mark.parametrize("command", ["plan", "simulate"])
def test_every_planning_command_draws_why_there_is_no_plan(command, tmp_path):
    write(SCENARIO, "pose: [1.0, 0.2, 0.4]", "pose: [1.5, 1.5, 0.0]")
    assert run(command, "bay.yaml", "--plot", "p.png").exit_code == 3
    assert (tmp_path / "p.png").stat().st_size > 1000


def test_a_profile_and_an_animation_are_drawn_when_asked_for(tmp_path):
    result = run("plan", write(), "--profile", "profile.svg")
    assert result.exit_code == 0
    assert "yaw rate" in (tmp_path / "profile.svg").read_text()
    assert re.search(r"^written +plan.json, profile.svg$", result.stdout, re.MULTILINE)
    assert run("simulate", write(NEAR), "--gif", "run.gif").exit_code == 0
    assert (tmp_path / "run.gif").read_bytes().startswith(b"GIF89a")
    wrong = run("simulate", "bay.yaml", "--gif", "run.png")
    assert (wrong.exit_code, wrong.stderr) == (2, "--gif: must end in .gif, got run.png\n")


def test_no_time_at_all_is_a_named_failure_with_what_exists():
    result = run("plan", write(), "--out", "out.json", "--time-budget", "1e-6")
    assert result.exit_code == 5
    assert result.stderr == "PlannerTimedOut: DockPlanner ran out of time; raise time_budget, which is 1e-06 s\n"
    assert load_plan("out.json").status == "PlannerTimedOut"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("time_budget: 5.0", "time_budget: [", "bay.yaml:16: is not valid YAML: "),
        ("at_dock: 0.0", "at_dock: 0.1", "bay.yaml:14: clearance.at_dock: must be <= required = 0.05 m, got 0.1\n"),
        ("robot:", "map: no.yaml\nrobot:", "bay.yaml:4: map: no.yaml: cannot be read: No such file or directory\n"),
        (
            "[[0.4, 0.3], [-0.4, 0.3], [-0.4, -0.3], [0.4, -0.3]]",
            "[[0.4, 0.3], [-0.4, 0.3]]",
            "bay.yaml:5: robot.footprint: a polygon needs at least 3 distinct vertices, got 2\n",
        ),
        (
            "[[0.4, 0.3], [-0.4, 0.3], [-0.4, -0.3], [0.4, -0.3]]",
            "[[0, 0], [1, 1], [1, 0], [0, 1]]",
            "bay.yaml:5: robot.footprint: must not cross or touch itself: Self-intersection[0.5 0.5]\n",
        ),
        ("[4.0, 1.0, 0.0]", "[.nan, 1.0, 0.0]", "bay.yaml:8: dock.pose.x: must be finite, got nan\n"),
        (
            "max_curvature: 2.0",
            "max_curvature: -2",
            "bay.yaml:6: robot.limits.max_curvature: must be > 0 1/m, got -2.0\n",
        ),
        ("time_budget: 5.0", "time_budget: 0", "bay.yaml:15: time_budget: must be finite and > 0 s, got 0.0\n"),
        ("time_budget: 5.0", "time_budget: -1", "bay.yaml:15: time_budget: must be finite and > 0 s, got -1.0\n"),
    ],
)
def test_bad_input_ends_with_status_2_and_no_file(old, new, message, tmp_path):
    result = run("plan", write(SCENARIO, old, new), "--out", "out.json")
    assert (result.exit_code, result.stdout) == (2, "")
    assert result.stderr.startswith(message)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bay.yaml"]


def test_a_huge_image_header_ends_with_status_2():
    pathlib.Path("m.pgm").write_bytes(b"P5\n2000000000 2000000000\n255\n0000")
    write("image: m.pgm\nresolution: 0.1\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.2\n", name="m.yaml")  # fmt: skip  # noqa: E501
    result = run("plan", write(SCENARIO, "robot:", "map: m.yaml\nrobot:"))
    assert result.exit_code == 2
    assert result.stderr.startswith("bay.yaml:4: map: m.yaml:1: image: m.pgm: ")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--time-budget", "0"], "--time-budget: must be finite and > 0 s, got 0.0\n"),
        (["--time-budget", "-0.1"], "--time-budget: must be finite and > 0 s, got -0.1\n"),
        (["--time-budget", "nan"], "--time-budget: must be finite and > 0 s, got nan\n"),
        (["--spacing", "0"], "--spacing: must be finite and > 0 m, got 0.0\n"),
        (["--period", "-1"], "--period: must be finite and > 0 s, got -1.0\n"),
        (["--plot", "p.xyz"], "--plot: p.xyz: must end in one of "),
        (["--profile", "p.xyz"], "--profile: p.xyz: must end in one of "),
        (["--spacing", "1e-9"], "spacing: must be >= "),
        (["--period", "1e-9"], "period: must be >= "),
    ],
)
def test_bad_options_end_with_status_2_and_no_file(options, message, tmp_path):
    result = run("plan", write(), *options)
    assert result.exit_code == 2
    assert result.stderr.startswith(message)
    assert result.stderr.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["bay.yaml"]


@pytest.mark.parametrize("option", ["--position-noise", "--yaw-noise", "--lag", "--latency"])
@pytest.mark.parametrize("value", ["-1", "nan", "inf"])
def test_an_impossible_world_ends_with_status_2(option, value):
    result = run("simulate", write(), option, value)
    assert result.exit_code == 2
    assert result.stderr.startswith(f"{option}: must be finite and >= 0, got ")


def test_a_latency_that_cannot_be_simulated_is_refused_by_its_option():
    result = run("simulate", write(), "--latency", "100")
    assert (result.exit_code, result.stderr) == (2, "--latency: must be <= 10.0 s, got 100.0\n")


@pytest.mark.parametrize("arguments", [["fly"], ["plan", "--fast"], ["certify", "plan.json"], ["simulate"]])
def test_wrong_usage_ends_with_status_2(arguments):
    assert run(*arguments).exit_code == 2


def test_an_output_that_cannot_be_written_ends_with_status_2():
    result = run("plan", write(), "--out", "bay.yaml/plan.json")
    assert result.exit_code == 2
    assert result.stderr == "bay.yaml/plan.json: cannot be written: bay.yaml is a file, not a folder\n"


@pytest.mark.parametrize("command", [["plan", "--out"], ["plan", "--profile"], ["simulate", "--out"]])
def test_no_command_writes_over_its_scenario(command):
    write()
    name = "bay.yaml" if command[1] == "--out" else "bay.png"
    pathlib.Path("bay.yaml").replace(name)
    result = run(command[0], name, command[1], f"./{name}")
    assert result.exit_code == 2
    assert result.stderr == f"{name}: is the input file and would be overwritten; choose another name\n"
    assert pathlib.Path(name).read_text() == SCENARIO


@pytest.mark.parametrize("other", ["plan.json", "./plan.json", "folder/../plan.json"])
def test_no_result_overwrites_another(other):
    write()
    result = run("plan", "bay.yaml", "--out", "plan.json", "--csv", other)
    assert result.exit_code == 2
    assert result.stderr.endswith("is given twice, so one result would overwrite the other\n")
    assert not pathlib.Path("plan.json").exists()
    assert run("plan", "bay.yaml", "--out", "/dev/null", "--csv", "/dev/null").exit_code == 0


@pytest.mark.parametrize(
    ("text", "format_"),
    [("image: map.png\nresolution: 0.05\n", ""), ("format: optdock-plan/1\n", "; its format is 'optdock-plan/1'")],
)
def test_a_file_of_another_kind_is_said_to_be_no_scenario(text, format_):
    result = run("plan", write(text))
    assert result.exit_code == 2
    assert result.stderr == f"bay.yaml: is not a scenario: it has none of the keys robot, dock and start{format_}\n"


def test_a_map_of_one_pixel_is_a_map():
    pathlib.Path("m.pgm").write_bytes(b"P5\n1 1\n255\n\xfe")
    write("image: m.pgm\nresolution: 0.1\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.2\n", name="m.yaml")  # fmt: skip  # noqa: E501
    result = run("plan", write(SCENARIO, "robot:", "map: m.yaml\nrobot:"), "--plot", "p.png")
    assert result.exit_code == 3
    assert result.stderr == "StartOutsideMapBounds: the start (1.000, 0.200) is outside the map\n"


def test_names_with_blanks_and_letters_of_any_language_are_names(tmp_path):
    folder = tmp_path / "ein Ordner mit ü"
    folder.mkdir()
    (folder / "Bucht ß.yaml").write_text(SCENARIO)
    (tmp_path / "link.yaml").symlink_to(folder / "Bucht ß.yaml")
    for source in (folder / "Bucht ß.yaml", "link.yaml"):
        assert run("plan", source, "--out", folder / "пла н.json", "--plot", folder / "図.png").exit_code == 0
    assert (folder / "図.png").stat().st_size > 1000


def test_simulate_says_how_exactly_the_robot_ends():
    write(NEAR, "time_budget: 5.0", "time_budget: 5.0\nsmoother: {stop_at_first: true}")
    first = run("simulate", "bay.yaml", "--out", "run.json", "--seed", "3")
    assert first.exit_code == 0, first.output
    document = json.loads(pathlib.Path("run.json").read_text())
    assert (document["format"], document["docked"], document["seed"]) == ("optdock-run/1", True, 3)
    assert abs(document["final_error"]["along"]) < 0.02
    assert abs(document["final_error"]["cross"]) < 0.02
    assert abs(document["final_error"]["yaw"]) < 0.05
    columns = document["columns"]
    assert len({len(column) for column in columns.values()}) == 1
    assert columns["t"][-1] == pytest.approx(document["duration"])
    assert "final error" in first.stdout
    assert document["goal_checkers"] == {"DockGoalChecker": True}
    goal = load_scenario("bay.yaml").problem.goal
    last = Pose2(columns["x"][-1], columns["y"][-1], columns["yaw"][-1]).in_frame_of(goal)
    assert (last.x, last.y, last.yaw) == pytest.approx(
        tuple(document["final_error"][name] for name in ("along", "cross", "yaw"))
    )
    for seed, is_equal in (("3", True), ("4", False)):  # equal seeds give equal runs
        run("simulate", "bay.yaml", "--out", "again.json", "--seed", seed)
        again = json.loads(pathlib.Path("again.json").read_text())["final_error"]
        assert (again == document["final_error"]) is is_equal


def test_a_run_that_does_not_dock_ends_with_status_3():
    text = NEAR + "goal_checker: {plugin: DockGoalChecker, along_tolerance: 0.0}\n"
    result = run("simulate", write(text), "--out", "run.json")
    assert result.exit_code == 3
    assert result.stderr.startswith("not docked: timeout: ")


CORRIDOR = """\
format: optdock-scenario/1
obstacles:
  - [[1.0, 1.304], [5.0, 1.304], [5.0, 2.0], [1.0, 2.0]]
  - [[1.0, 0.0], [5.0, 0.0], [5.0, 0.696], [1.0, 0.696]]
robot: {footprint: [[0.4, 0.3], [-0.4, 0.3], [-0.4, -0.3], [0.4, -0.3]]}
dock: {pose: [4.0, 1.0, 0.0], approach_speed: 0.1, approach_distance: 0.3}
start: {pose: [2.4, 1.0, 0.0]}
clearance: 0.0
time_budget: 5.0
"""


def test_a_run_that_touches_the_walls_ends_with_status_3_although_it_docks():
    noise = ("--position-noise", "0.03", "--yaw-noise", "0.05")
    assert run("simulate", write(CORRIDOR)).exit_code == 0
    watched = run("simulate", "bay.yaml", *noise)
    assert watched.exit_code == 3
    assert "NoValidControl: TrackingController: collision ahead" in watched.stderr or "collided" in watched.stderr
    write(CORRIDOR + "controller: {use_collision_detection: false}\n")
    result = run("simulate", "bay.yaml", "--out", "run.json", *noise)
    assert result.exit_code == 3
    assert result.stderr.startswith("collided: the footprint went 0.0")
    document = json.loads(pathlib.Path("run.json").read_text())
    assert document["collided"] is True
    assert document["min_clearance"] < 0.0


def test_a_run_that_leaves_what_is_proven_says_so_first_and_ends_with_status_3():
    text = """\
format: optdock-scenario/1
robot: {footprint: [[0.4, 0.3], [-0.4, 0.3], [-0.4, -0.3], [0.4, -0.3]], tracking: {cross: 0.002, yaw: 0.002}}
dock: {pose: [4.0, 0.6, 0.0], approach_speed: 0.1, approach_distance: 0.3}
start: {pose: [1.9, 1.0, 0.0]}
time_budget: 5.0
"""
    kept = run("simulate", write(text))
    assert kept.exit_code == 0
    assert "NOT AS PROVEN" not in kept.stdout
    late = run("simulate", "bay.yaml", "--lag", "0.3", "--latency", "0.2")
    assert late.exit_code == 3
    assert late.stdout.startswith("NOT AS PROVEN")
    assert "the tube is" in late.stdout.splitlines()[0]
    assert late.stderr.startswith("left the proven range: ")


def test_compare_lists_raw_and_smoothed_and_draws_each(tmp_path):
    write(name="first.yaml")
    write(SCENARIO, "pose: [1.0, 0.2, 0.4]", "pose: [1.5, 1.5, 0.0]", name="second.yaml")
    result = run("compare", "first.yaml", "second.yaml", "--out", "cmp")
    assert result.exit_code == 3
    assert result.stderr == f"second: {FAILURES['start in collision'][2]}"
    rows = list(csv.DictReader((tmp_path / "cmp" / "comparison.csv").read_text().splitlines()))
    assert [(row["scenario"], row["path"], row["status"]) for row in rows] == [
        ("first", "raw", "not certified"),
        ("first", "smoothed", "certified"),
        ("second", "smoothed", "StartOccupied"),
    ]
    raw, smoothed = rows[:2]
    assert float(smoothed["max_curvature_1pm"]) <= 2.0 < float(raw["max_curvature_1pm"])
    assert float(smoothed["worst_joint_deg"]) < 1e-6 < float(raw["worst_joint_deg"])
    assert float(smoothed["min_clearance_m"]) > 0.0
    assert rows[2]["length_m"] == ""
    assert sorted(path.name for path in (tmp_path / "cmp").glob("*.png")) == ["01_first.png", "02_second.png"]
    assert len(result.stdout.splitlines()) == 5


def test_compare_measures_smoothers_whether_they_are_certified_or_not(tmp_path):
    write(name="bay.yaml")
    names = ("CasadiSmoother", "SimpleSmoother", "SavitzkyGolaySmoother")
    result = run("compare", "bay.yaml", *(word for name in names for word in ("--smoother", name)), "--out", "cmp")
    assert result.exit_code == 0
    raw, *rows = list(csv.DictReader((tmp_path / "cmp" / "comparison.csv").read_text().splitlines()))
    assert [row["smoother"] for row in rows] == [*names]
    assert [row["status"] for row in rows] == ["certified", "not certified", "not certified"]
    for row in (raw, *rows):
        measured = ("length_m", "cusps", "max_curvature_rate_1pm2", "worst_joint_deg", "min_clearance_m", "margin_m")
        assert np.isfinite([float(row[name]) for name in measured]).all()
    assert all(float(row["cpu_ms"]) > 0.0 for row in rows)
    assert raw["cpu_ms"] == rows[0]["reason"] == ""
    assert float(rows[0]["margin_m"]) > -1e-6
    assert "curvature" in rows[1]["reason"]
    assert f"bay, SimpleSmoother: {rows[1]['reason']}" in result.stdout.splitlines()
    unknown = run("compare", "bay.yaml", "--smoother", "SimpelSmoother")
    assert unknown.exit_code == 2
    assert "SimpleSmoother" in unknown.stderr


def test_compare_counts_cpu_time_so_that_load_changes_nothing(monkeypatch):
    """The wall clock is advanced by an hour at each reading."""
    write(name="bay.yaml")
    hours = itertools.count(step=3600.0)
    with budget_clock("wall"):
        monkeypatch.setattr("optdock.deadline._OfProcess.clock.read", lambda: next(hours))
        assert run("plan", "bay.yaml").exit_code == 5
        assert run("compare", "bay.yaml", "--smoother", "CasadiSmoother", "--out", "cmp").exit_code == 0


def test_compare_skips_what_is_no_scenario_and_says_so(tmp_path):
    write(name="bay.yaml")
    pathlib.Path("map.yaml").write_text("image: map.png\nresolution: 0.05\n")
    pathlib.Path("notes.txt").write_text("format: something else")
    pathlib.Path("folder").mkdir()
    result = run("compare", "bay.yaml", "map.yaml", "notes.txt", "folder", "--out", "cmp")
    assert result.exit_code == 0
    why = "skipped, because it has no line 'format: optdock-scenario/1'"
    assert result.stderr.splitlines() == [f"{name}: {why}" for name in ("map.yaml", "notes.txt", "folder")]
    rows = list(csv.DictReader((tmp_path / "cmp" / "comparison.csv").read_text().splitlines()))
    assert [row["scenario"] for row in rows] == ["bay", "bay"]
    result = run("compare", "map.yaml")
    assert result.exit_code == 2
    assert result.stderr.splitlines()[-1].startswith("none of the files is a scenario")
    write(SCENARIO, "required: 0.05", "required: -1", name="broken.yaml")
    for broken, reason in (("broken.yaml", "clearance.required: "), ("missing.yaml", "cannot be read: ")):
        result = run("compare", "bay.yaml", broken)
        assert result.exit_code == 2
        assert reason in result.stderr


def test_the_schema_is_printed_or_written(tmp_path):
    printed = json.loads(run("schema").stdout)
    assert printed["properties"]["format"]["const"] == "optdock-scenario/1"
    assert "CasadiSmoother" in json.dumps(printed)
    written = tmp_path / "scenario.schema.json"
    assert run("schema", "--out", written).stdout == ""
    assert json.loads(written.read_text()) == printed


def test_plugins_lists_what_is_installed_one_line_each():
    result = run("plugins")
    assert result.exit_code == 0
    rows = [line.split() for line in result.stdout.splitlines()]
    assert ["planners", "DockPlanner", "optdock.planners.dock_planner:DockPlanner"] in rows
    assert all(len(row) == 3 for row in rows)


def test_demo_runs_from_start_to_finish(tmp_path):
    result = run("demo", "--out", "demo")
    assert result.exit_code == 0, result.output
    made = {path.name: path.stat().st_size for path in (tmp_path / "demo").iterdir()}
    results = {"plan.json", "run.json", "plan.png", "profile.png", "run.png", "run.gif"}
    assert set(made) == {"scenario.yaml", "hall_map.yaml", "hall_map.png", *results}
    assert min(made[name] for name in results) > 1000
    document = json.loads((tmp_path / "demo" / "run.json").read_text())
    assert document["docked"] is True
    assert document["goal_checkers"] == {"AxisGoalChecker": True, "DockGoalChecker": True}
    assert "AxisGoalChecker: reached, DockGoalChecker: reached\n" in result.stdout
    assert max(abs(document["final_error"]["along"]), abs(document["final_error"]["cross"])) < 0.005
    again = run("plan", "demo/scenario.yaml", "--out", "again.json")
    assert again.exit_code == 0
    assert load_plan("again.json").path.length == pytest.approx(load_plan("demo/plan.json").path.length)


def test_the_demo_keeps_its_budget_on_a_busy_machine():
    """It needs some 20 ms where nobody else works."""
    assert load_scenario(demo_scenario()).time_budget >= 1.0


def test_pictures_without_matplotlib_name_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    result = run("plan", write(), "--plot", "plan.png")
    assert result.exit_code == 2
    assert result.stderr == "pictures need matplotlib: pip install 'optdock[plot]'\n"


def test_a_path_driven_against_its_gear_is_refused(planned):
    folder, _ = planned
    spline = ClothoidSpline(Pose2(1.0, 0.2, 0.4), np.array([0.0, 3.0]), np.zeros(2), -1)
    save_plan("reverse.json", PlanFile(path=Path((ClothoidSegment(spline),))))
    result = run("certify", "reverse.json", folder / "bay.yaml")
    assert result.exit_code == 3


def test_a_warning_is_said_once_and_without_the_name_of_a_module():
    """In a process of its own, whose console nobody has set up, with status and streams as a shell sees them."""
    occupied = SCENARIO.replace("pose: [1.0, 0.2, 0.4]", "pose: [1.5, 1.5, 0.0]")
    write(occupied, "[[0.4, 0.3], [-0.4, 0.3], [-0.4, -0.3], [0.4, -0.3]]", "[[0.4, 0.3], [0.1, 0.3], [0.1, -0.3]]")
    command = [sys.executable, "-c", "from optdock.cli import main; main()", "compare", "bay.yaml", "bay.yaml"]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 3
    assert "StartOccupied" not in result.stderr.splitlines()[0]
    assert result.stderr.count("StartOccupied: the footprint at the start overlaps obstacles[0] by ") == 2
    warnings = [line for line in result.stderr.splitlines() if "does not contain [0, 0]" in line]
    assert len(warnings) == 1
    assert warnings[0].startswith("warning: bay.yaml: robot.footprint ")


WALLED = """  - [[2.4, -2.0], [2.6, -2.0], [2.6, 0.7], [2.4, 0.7]]
  - [[2.4, 1.3], [2.6, 1.3], [2.6, 4.0], [2.4, 4.0]]
  - [[2.4, 3.9], [6.0, 3.9], [6.0, 4.1], [2.4, 4.1]]
  - [[2.4, -2.1], [6.0, -2.1], [6.0, -1.9], [2.4, -1.9]]
  - [[5.8, -2.0], [6.0, -2.0], [6.0, 4.0], [5.8, 4.0]]
"""


@pytest.fixture(scope="module")
def impossible(tmp_path_factory):
    """A scenario whose dock is behind a door that is too narrow, and the plan file of the refusal."""
    folder = tmp_path_factory.mktemp("impossible")
    scenario = folder / "walled.yaml"
    scenario.write_text(SCENARIO.replace("obstacles:\n", "obstacles:\n" + WALLED))
    problem = load_scenario(scenario).problem
    proof = prove_impossible(problem, time_budget=30.0)
    refusal = NoMotionExists(proof.message, proof=proof, where=proof.where)
    save_plan(folder / "plan.json", failed_plan_file(refusal, problem.frame))
    save_plan_picture(folder / "plan.png", problem, refusal=refusal, title=str(refusal))
    return folder


def test_certify_proves_again_that_no_motion_exists(impossible):
    result = run("certify", impossible / "plan.json", impossible / "walled.yaml")
    assert result.exit_code == 4, result.output
    assert re.search(r"verdict +impossible, proven", result.stdout)
    assert "too wide for the gap" in " ".join(result.stdout.split())
    assert (impossible / "plan.png").stat().st_size > 10_000


def test_certify_refuses_a_proof_that_does_not_hold(impossible):
    wider = write((impossible / "walled.yaml").read_text(), "[2.4, 1.3], [2.6, 1.3]", "[2.4, 2.1], [2.6, 2.1]")
    result = run("certify", impossible / "plan.json", wider)
    assert result.exit_code == 3
    assert "is not valid" in result.stderr
    assert re.search(r"verdict +not certified", result.stdout)
    assert "another problem: obstacles differ" in " ".join(result.stdout.split())
