"""Names in the documentation exist: citations, modules, equations, errors, reasons, keys."""

import ast
import functools
import importlib
import inspect
import re
import sys
from pathlib import Path

import pytest

import optdock
from experiments.families import FAMILIES, instance
from optdock import errors
from optdock.executor.executor_settings import ExecutorSettings
from optdock.executor.planning import Outcome as PlanOutcome
from optdock.executor.task_states import EndingKind, State
from optdock.plugins.outcomes import TimingStatus

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
PACKAGES = ("optdock", "smoothers", "checkers")
ROS = ROOT / "ros" / "optdock_ros" / "optdock_ros"
CODE = sorted(path for folder in (*(ROOT / package for package in PACKAGES), ROS) for path in folder.rglob("*.py"))
API = "\n\n".join(page.read_text(encoding="utf-8") for page in sorted((DOCS / "reference" / "api").glob("*.md")))
WRITTEN = [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))]
KEY = re.compile(r"\[([A-Z][A-Za-z]+\d{4}[a-z]?)\](?!\()")
EQUATION = re.compile(
    r"^\$\$\n(?:% *(?P<path>[^:\n]+):? *(?P<names>[^\n]*)\n)?(?P<tex>.+?)\n\$\$$", re.MULTILINE | re.DOTALL
)

sys.path.insert(0, str(DOCS / "tools"))
generated, sources = importlib.import_module("generated"), importlib.import_module("sources")


@functools.cache
def parsed(path):
    return ast.parse(path.read_text(encoding="utf-8"))


def calls_of(name):
    """Return the constant first arguments of all calls of `name` in the code."""
    calls = (node for path in CODE for node in ast.walk(parsed(path)) if isinstance(node, ast.Call) and node.args)
    first = (call.args[0] for call in calls if getattr(call.func, "id", "") == name)
    return {argument.value for argument in first if isinstance(argument, ast.Constant)}


def keys_in(paths):
    return {key: path.name for path in paths for key in KEY.findall(path.read_text(encoding="utf-8"))}


def defined_keys():
    return re.findall(r"^\[([A-Z][A-Za-z]+\d{4}[a-z]?)\] ", (DOCS / "bibliography.md").read_text(), re.MULTILINE)


def test_every_citation_is_in_the_bibliography_and_every_entry_is_cited():
    defined = defined_keys()
    assert len(defined) == len(set(defined))
    written = [*(ROOT / "tests").rglob("*.py"), *(ROOT / "experiments").rglob("*.py")]
    citing = [*CODE, *sorted(written), ROOT / "DESIGN.md", *WRITTEN]
    cited = keys_in(path for path in citing if path.name != "bibliography.md" and path != Path(__file__))
    assert {key: where for key, where in cited.items() if key not in defined} == {}
    assert sorted(set(defined) - set(cited)) == []


def equations():
    return [(page, found) for page in sorted(DOCS.rglob("*.md")) for found in EQUATION.finditer(page.read_text())]


@functools.cache
def defined_names(path):
    return set(sources.defined_in(str(path)))


def test_every_equation_is_numbered_once_and_names_a_module_that_has_what_it_names():
    numbers = [re.search(r"\\tag\{(\w+)\}", found["tex"]) for _, found in equations()]
    assert all(numbers)
    assert len({number[1] for number in numbers}) == len(numbers) > 50
    wrong = [
        (page.name, found["path"], name)
        for page, found in equations()
        for name in re.split(r",\s*", found["names"] or "")
        if not (found["path"] and name and name in defined_names(found["path"].strip()))
    ]
    assert wrong == []


def test_every_reference_to_an_equation_has_one():
    known = {re.search(r"\\tag\{(\w+)\}", found["tex"])[1] for _, found in equations()}
    referred = {number for page in WRITTEN for number in re.findall(r"\(([DEGMPRNSCTK]\d+)\)", page.read_text())}
    assert referred - known == set()


NAMED = re.compile(r"`((?:optdock|smoothers|checkers|examples|tests|experiments|docs|ros)[/.][\w/.]*\w)/?`")


def exists(name):
    """Return whether a path or a dotted name exists."""
    if "/" in name or (ROOT / name).is_file():
        return (ROOT / name).exists()
    parts = name.split(".")
    for length in range(len(parts), 0, -1):
        try:
            found = importlib.import_module(".".join(parts[:length]))
        except ModuleNotFoundError:
            continue
        for part in parts[length:]:
            found = getattr(found, part, None)
        return found is not None
    return False


GROUPS = {"optdock.planners", "optdock.smoothers", "optdock.goal_checkers", "optdock.behaviors", "optdock.layers"}
GROUPS |= {"optdock.docks"}


def test_every_path_and_module_that_is_named_exists():
    named = {name: page.name for page in WRITTEN for name in NAMED.findall(page.read_text(encoding="utf-8"))}
    assert len(named) > 20
    assert {name: page for name, page in named.items() if name not in GROUPS and not exists(name)} == {}


def test_the_map_has_every_module_once():
    marks = re.findall(r"<!-- made: map (\S+) -->", (DOCS / "map.md").read_text())
    assert len(marks) == len(set(marks))
    shown = [path for package in marks for path in generated.modules_of(package)]
    assert sorted(shown) == [path.relative_to(ROOT) for path in CODE]


def index_rows():
    """Return the rows of the map's index: topic, module, names."""
    return re.findall(r"^\| ([^|]+) \| `([\w/]+\.py)`: ([^|]+) \|$", (DOCS / "map.md").read_text(), re.MULTILINE)


def test_the_index_of_the_map_names_what_exists_and_what_the_tree_below_it_lists():
    assert len(index_rows()) > 50
    named = {(path, name) for _, path, names in index_rows() for name in re.findall(r"`([\w.]+)`", names)}
    assert {(path, name) for path, name in named if name not in defined_names(path)} == set()
    listed = {path: generated.public_names(parsed(ROOT / path)) for path, _ in named}
    assert {(path, name) for path, name in named if name.split(".")[0] not in listed[path]} == set()


def test_every_equation_is_in_the_index_at_the_module_that_computes_it():
    homes = {re.search(r"\\tag\{(\w+)\}", found["tex"])[1]: found["path"].strip() for _, found in equations()}
    indexed = [
        (number, path) for said, path, _ in index_rows() for number in re.findall(r"\(([DEGMPRNSCTK]\d+)\)", said)
    ]
    assert sorted(indexed) == sorted(homes.items())


def test_the_figures_are_small_and_in_both_schemes():
    used = {name for page in WRITTEN for name in re.findall(r"assets/([\w-]+\.svg)", page.read_text(encoding="utf-8"))}
    drawn = {path.name: path.stat().st_size for path in (DOCS / "assets").glob("*.svg")}
    assert used == set(drawn) >= {"taper-light.svg", "taper-dark.svg"}
    assert {name: size for name, size in drawn.items() if size > 150_000} == {}


def test_the_page_of_the_library_shows_no_inner_life_of_python():
    made = generated.on_page_markdown(API)
    assert re.findall(r"<function|<factory>|PosixPath|<class|\ba [AEIO]\w+\n```", made) == []
    assert "cancel_checker=never_cancelled" in made.replace(" = ", "=")


def test_every_module_says_in_its_first_line_what_it_is():
    first = {path: (ast.get_docstring(parsed(path)) or "").split("\n")[0] for path in CODE}
    assert [path.name for path, line in first.items() if not line.endswith(".") and path.name != "__init__.py"] == []


REFUSALS = (DOCS / "reference" / "refusals.md").read_text(encoding="utf-8")
TOLD = set(re.findall(r"`([^`\n]+)`", REFUSALS))


def test_every_error_is_explained_with_its_code():
    found = {
        name: value
        for name, value in vars(errors).items()
        if inspect.isclass(value) and issubclass(value, errors.OptdockError)
    }
    assert sorted(set(found) - TOLD) == []
    rows = dict(re.findall(r"^\| `(\w+)` \| (\d+) \|", REFUSALS, re.MULTILINE))
    assert {name: code for name, code in rows.items() if found[name].code != int(code)} == {}
    families = {"OptdockError", "TimedOut", "Cancelled"}
    written = {*rows, *re.findall(r"`(\w+)` \(code \d+\)", REFUSALS)}
    assert sorted(set(found) - written - families) == []


def test_every_reason_of_a_refusal_is_explained():
    reasons = calls_of("Refusal")
    assert {"goal_unreachable", "clearance", "approach_blocked"} <= reasons
    assert reasons | {status.name for status in TimingStatus if status.value} <= TOLD


def test_every_kind_of_violation_is_explained():
    kinds = calls_of("Violation")
    assert {"clearance", "slip", "rest", "coverage"} <= kinds <= TOLD


DOCKING = (DOCS / "howto" / "dock-with-a-detector.md").read_text(encoding="utf-8")


def test_every_ending_of_a_docking_is_explained_with_its_code():
    rows = re.findall(r"^\| (`[^|]+`) \| (\d+) \|", DOCKING, re.MULTILINE)
    told = {kind: int(code) for kinds, code in rows for kind in re.findall(r"`([^`]+)`", kinds)}
    assert {kind.value: kind.code for kind in EndingKind} == {kind.value: told.get(kind.value) for kind in EndingKind}


def test_every_state_and_every_event_of_a_docking_is_explained():
    told = set(re.findall(r"`([^`\n]+)`", DOCKING))
    assert {state.value for state in State} - {"ready", "ended"} <= told
    said = {
        node.value
        for path in (ROOT / "optdock" / "executor").glob("*.py")
        for call in ast.walk(parsed(path))
        if isinstance(call, ast.Call) and call.args
        if getattr(call.func, "attr", getattr(call.func, "id", "")) in {"_report", "_interrupt", "Interrupted"}
        for node in ([call.args[0].body, call.args[0].orelse] if isinstance(call.args[0], ast.IfExp) else call.args[:1])
        if isinstance(node, ast.Constant)
    }
    assert {"tube left", "tube entered", "no way on", "clock went back"} <= said <= told
    assert {f"plan {outcome.value}" for outcome in PlanOutcome} <= told


def test_every_setting_of_a_docking_is_on_its_page():
    heads = re.findall(r"^\| `(\w+)` \|", generated.on_page_markdown(DOCKING), re.MULTILINE)
    assert set(ExecutorSettings.model_fields) <= set(heads)


def test_steps_of_the_planner_are_explained():
    steps = {
        value.value
        for path in (ROOT / "optdock" / "planners").glob("*.py")
        for node in ast.walk(parsed(path))
        if isinstance(node, ast.Dict)
        for key, value in zip(node.keys, node.values, strict=True)
        if isinstance(key, ast.Constant) and key.value == "step" and isinstance(value, ast.Constant)
    }
    assert {"beyond_c", "direction"} <= steps <= TOLD


def test_every_parameter_of_the_ros_servers_is_on_their_page():
    page = (DOCS / "reference" / "ros2.md").read_text(encoding="utf-8")
    heads = re.findall(r"^\| `([\w.]+)` \|", generated.on_page_markdown(page), re.MULTILINE)
    models = {
        value for path in ROS.glob("[!_]*.py") for value in generated.ros_models(path.stem).values()
        if inspect.isclass(value) and value.__module__.startswith("optdock_ros.") and hasattr(value, "model_fields")
    }  # fmt: skip
    assert len(models) > 8
    told = {*heads, *(head.rpartition(".")[2] for head in heads)}
    assert {name for model in models for name in model.model_fields} - told == set()
    assert set(generated.ros_models("simulation_parameters")["PARAMETERS"]) <= set(heads)


def test_the_stops_of_a_robot_are_told_with_the_defaults():
    page = (DOCS / "howto" / "ros2.md").read_text(encoding="utf-8")
    stops = page[page.index("## What stops the robot") : page.index("## Diagnostics")]
    models = generated.ros_models("docking_parameters")
    own, controller, executor = models["DockingParameters"](), models["ControllerParameters"](), ExecutorSettings()
    cycles = max(0.1, 5.0 / own.controller_frequency)
    told = {
        "no new transform": f"{controller.transform_tolerance} + {executor.pose_patience} s",
        "no new odometry": f"{own.odom_duration} + {executor.pose_patience} s",
        "no new local costmap": f"{controller.costmap_timeout} + {cycles} s",
        "a new obstacle": f"{executor.obstacle_patience:g} s",
        "no detections": "uncertainty at the dock",
        "no motion despite": f"{executor.progress_time:g} s",
        "a cycle more than": f"{executor.longest_tick} s",
    }
    rows = {what: next(row for row in stops.splitlines() if row.startswith(f"| {what}")) for what in told}
    assert {what: row for what, row in rows.items() if told[what] not in row} == {}
    assert executor.detection_patience is None
    assert f"{executor.localization_timeout:g} s at rest" in rows["no new transform"]
    assert f"{executor.costmap_timeout:g} s at rest" in rows["no new local costmap"]


def test_the_topics_of_recordings_are_on_their_page():
    from optdock.ros.field import FieldTopics

    page = (DOCS / "howto" / "bags.md").read_text(encoding="utf-8")
    written = {
        node.value
        for node in ast.walk(parsed(ROOT / "optdock" / "ros" / "contents.py"))
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and re.fullmatch(r"/\w[\w/]*", node.value)
    }
    assert {"/plan", "/cmd_vel", "/map"} <= written
    assert {topic for topic in written if f"`{topic}`" not in page} == set()
    assert {topic for topic in FieldTopics().path if f"`{topic}`" not in page} == set()


def test_everything_at_the_front_door_is_on_the_page_of_the_library():
    shown = {name for names in re.findall(r"<!-- made: api ([^\n]+) -->", API) for name in names.split()}
    assert set(optdock.__all__) - shown == set()


@pytest.mark.parametrize(
    "kind", ["planners", "smoothers", "timing", "controllers", "goal_checkers", "behaviors", "layers", "docks"]
)
def test_every_installed_plugin_is_on_the_page_of_plugins(kind):
    from optdock.plugins.registry import available_plugins

    made = generated.on_page_markdown(f"<!-- made: plugins {kind} -->")
    own = [info for info in available_plugins() if info.kind == kind and info.target.split(".")[0] in PACKAGES]
    assert [f"### {info.name}" in made for info in own] == [True] * len(own) != []
    assert "made: plugins " + kind in (DOCS / "reference" / "plugins.md").read_text()


def test_every_command_is_on_its_page_with_its_options():
    import typer

    from optdock.cli import app

    made = generated.on_page_markdown((DOCS / "reference" / "commands.md").read_text())
    names = set(typer.main.get_command(app).commands)
    shown = re.findall(r"^## optdock (\w+)((?: \w+)?)$", made, re.MULTILINE)
    assert {name for name, _ in shown} == names >= {"plan", "certify"}
    assert {"".join(words) for words in shown} >= {"import bag", "import nav2"}
    assert {"out", "seed", "dock"} <= set(re.findall(r"^\| `--([\w-]+)", made, re.MULTILINE))


def test_every_key_of_a_scenario_is_on_its_page():
    from optdock.config import scenario_reference

    page = generated.on_page_markdown((DOCS / "reference" / "scenario.md").read_text())
    heads = re.findall(r"^\| `([\w.]+)`", page, re.MULTILINE)
    assert len(heads) == len(scenario_reference())


def test_infeasible_families_have_their_reasons_explained():
    reasons = {instance(family, 0).expected_reason for family in FAMILIES} - {"", None}
    assert reasons
    assert reasons <= TOLD
