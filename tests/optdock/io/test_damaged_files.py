"""Reading any file content gives a value or a named error."""

import copy
import json

import pytest
import yaml
from hypothesis import example, given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from optdock.cli import app
from optdock.config import Scenario, load_scenario
from optdock.errors import InvalidFile
from optdock.io.plan_file import PlanFile, load_plan
from optdock.nav2.docks import load_dock_database
from optdock.nav2.params import Nav2Params, load_nav2_params

SCENARIO = {
    "format": "optdock-scenario/1",
    "frame": "map",
    "obstacles": [[[1.0, 2.0], [3.0, 2.0], [3.0, 2.4], [1.0, 2.4]]],
    "robot": {
        "footprint": [[0.4, 0.3], [-0.4, 0.3], [-0.4, -0.3], [0.4, -0.3]],
        "drive": "differential",
        "limits": {"max_speed": 0.5, "max_curvature": 2.0},
    },
    "dock": {
        "pose": [4.0, 1.0, 0.0],
        "footprint": [[0.42, -0.4], [0.6, -0.4], [0.6, 0.4]],
        "direction": "auto",
        "final_straight": 0.3,
        "approach_speed": 0.1,
        "approach_distance": 0.3,
    },
    "start": {"pose": [1.0, 0.2, 0.4], "speed": 0.0, "curvature": 0.0},
    "clearance": {"required": 0.05, "at_dock": 0.0, "taper": 0.5},
    "time_budget": 0.1,
    "planner": {"plugin": "DockPlanner", "degree": 2},
}
COLUMNS = {name: [0.0, 0.5, 1.0] for name in ("s", "x")}
COLUMNS |= {"y": [0.0] * 3, "yaw": [0.0] * 3, "curvature": [0.0] * 3, "direction": [1, 1, 1]}
EXACT = {"start": [0.0, 0.0, 0.0], "knots": [0.0, 1.0], "curvature": [0.0, 0.0], "direction": 1}
PLAN = {
    "format": "optdock-plan/1",
    "status": "certified",
    "completed": True,
    "frame": "map",
    "raw_path": {**COLUMNS, "segments": [{"poses": [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]], "direction": 1}]},
    "path": {**COLUMNS, "segments": [EXACT]},
    "trajectory": {
        **{
            name: [0.0, 1.0]
            for name in ("t", "x", "y", "yaw", "speed", "acceleration", "jerk", "yaw_rate", "yaw_acceleration")
        },
        "phases": {"start": [0.0, 0.0, 0.0], "durations": [0.5, 0.5], "jerks": [1.0, -1.0]},
    },
    "certificate": {"min_clearance": 0.1},
    "timing_ms": {"plan": 1.0},
    "error": {"code": 208, "message": "m", "where": {"s": 1.0}},
}
DOCKS = {"docks": {"a": {"type": "t", "frame": "map", "pose": [0.0, 1.0, 2.0], "id": "7"}, "b": {"type": "t"}}}
PARAMS = {
    "global_costmap": {
        "global_costmap": {
            "ros__parameters": {
                "footprint": "[[1, 1], [-1, 1], [-1, -1], [1, -1]]",
                "robot_radius": 0.2,
                "resolution": 0.05,
                "plugins": ["s"],
                "s": {"plugin": "nav2_costmap_2d::StaticLayer"},
            }
        }
    },
    "docking_server": {
        "ros__parameters": {
            "dock_plugins": ["c"],
            "c": {"plugin": "x::SimpleChargingDock", "staging_x_offset": -0.7, "dock_direction": "forward"},
            "docks": ["home"],
            "home": {"type": "c", "pose": [0.0, 0.0, 0.0]},
        }
    },
}
numbers = st.one_of(
    st.floats(), st.integers(-(10**6), 10**6), st.sampled_from([0, -1, 10**400, -0.0, 1e308, 5e-324, 1e-9, 2**63])
)
scalars = st.one_of(
    st.none(), st.booleans(), numbers, st.text(max_size=5), st.sampled_from(["[[1, 1]", "9e999", "1e-3"])
)
junk = st.recursive(
    scalars,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=4), inner, max_size=3),
    max_leaves=6,
)


def places(value, path=()):
    """Keys of every part of a document, the document itself included."""
    yield path
    children = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, child in children:
        yield from places(child, (*path, key))


@st.composite
def damaged(draw, document):
    """The document with up to three of its parts replaced or removed."""
    spoilt = copy.deepcopy(document)
    for _ in range(draw(st.integers(1, 3))):
        place = draw(st.sampled_from([path for path in places(spoilt) if path] or [()]))
        if not place:
            return draw(junk)
        holder = spoilt
        for key in place[:-1]:
            holder = holder[key]
        if draw(st.booleans()):
            holder[place[-1]] = draw(junk)
        else:
            del holder[place[-1]]
    return spoilt


def outcome(load, source):
    """What loading gives; a named error must name the file in every line."""
    try:
        return load(source)
    except InvalidFile as error:
        message = str(error)
    assert message
    assert all(str(source) in line for line in message.splitlines()), message
    return None


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("damaged")


def as_yaml(folder, document):
    (folder / "d.yaml").write_text(yaml.safe_dump(document, allow_unicode=True), encoding="utf-8")
    return folder / "d.yaml"


@pytest.fixture(scope="module")
def scenario(tmp_path_factory):
    return as_yaml(tmp_path_factory.mktemp("good"), SCENARIO)


def changed(document, place, value):
    """The document with one part replaced."""
    spoilt = copy.deepcopy(document)
    holder = spoilt
    for key in place[:-1]:
        holder = holder[key]
    holder[place[-1]] = value
    return spoilt


@settings(max_examples=20)
@given(document=damaged(SCENARIO))
@example(document=changed(SCENARIO, ("dock", "pose", 0), 10**400))
@example(document=changed(SCENARIO, ("obstacles", 0, 0, 0), 10**400))
@example(document=changed(SCENARIO, ("obstacles", 0, 0, 0), 1.3407807929942597e154))
def test_any_scenario(folder, document):
    assert isinstance(outcome(load_scenario, as_yaml(folder, document)), Scenario | None)


@settings(max_examples=20)
@given(document=damaged(PLAN))
@example(document=changed(PLAN, ("path", "segments", 0, "curvature", 1), 4.6e18))
def test_any_plan(folder, document):
    (folder / "d.json").write_text(json.dumps(document), encoding="utf-8")
    assert isinstance(outcome(load_plan, folder / "d.json"), PlanFile | None)


@settings(max_examples=15)
@given(document=damaged(PLAN))
@example(document=changed(PLAN, ("trajectory", "t"), [0.0, 5e-324]))
@example(document=changed(PLAN, ("trajectory", "t"), [-1e11, 1e11]))
@example(document=changed(PLAN, ("trajectory", "phases", "durations"), [1e9, 1e9]))
@example(document=changed(PLAN, ("trajectory", "phases"), None))
@example(document=changed(PLAN, ("path",), None))
@example(document=changed(PLAN, ("certificate",), {"min_clearance": 10**400, "length": "long"}))
def test_any_plan_is_judged(folder, scenario, document):
    """The program ends with 0, 2, 3 or 4, and says why it does not end with 0."""
    (folder / "d.json").write_text(json.dumps(document), encoding="utf-8")
    result = CliRunner().invoke(app, ["certify", str(folder / "d.json"), str(scenario)])
    assert result.exit_code in (0, 2, 3, 4), result.exception
    assert result.exception is None or isinstance(result.exception, SystemExit)
    assert (result.exit_code == 0) or result.stderr.strip()


@settings(max_examples=20)
@given(document=damaged(DOCKS))
@example(document={"\x1e0": None})
def test_any_dock_database(folder, document):
    assert isinstance(outcome(load_dock_database, as_yaml(folder, document)), dict | None)


@settings(max_examples=20)
@given(document=damaged(PARAMS))
@example(document=changed(PARAMS, ("docking_server", "ros__parameters", "dock_plugins", 0), "\r"))
@example(document=changed(PARAMS, ("docking_server", "ros__parameters", "c", "staging_x_offset"), 10**400))
def test_any_nav2_parameter_file(folder, document):
    assert isinstance(outcome(load_nav2_params, as_yaml(folder, document)), Nav2Params | None)


@settings(max_examples=20)
@given(data=st.binary(max_size=60))
@pytest.mark.parametrize("load", [load_scenario, load_plan, load_dock_database, load_nav2_params])
def test_any_bytes(folder, load, data):
    (folder / "d.bin").write_bytes(data)
    assert outcome(load, folder / "d.bin") is None


def test_the_undamaged_documents_are_good(folder):
    good = {**DOCKS, "docks": {"a": DOCKS["docks"]["a"]}}
    (folder / "d.json").write_text(json.dumps(PLAN))
    assert load_plan(folder / "d.json").path is not None
    assert isinstance(load_scenario(as_yaml(folder, SCENARIO)), Scenario)
    assert isinstance(load_nav2_params(as_yaml(folder, PARAMS)), Nav2Params)
    assert len(load_dock_database(as_yaml(folder, good))) == 1
