import copy
import json
import math

import jsonschema
import pytest
import yaml

from optdock.config import load_scenario, plugin_reference, scenario_reference, scenario_schema
from optdock.config.scenario_keys import SECTIONS, ScenarioDocument, known_keys
from optdock.errors import InvalidFile, PluginError
from optdock.plugins.registry import available_plugins

MINIMAL = {
    "format": "optdock-scenario/1",
    "robot": {"radius": 0.3},
    "dock": {"pose": [1.0, 0.0, 0.0]},
    "start": {"pose": [0.0, 0.0, 0.0]},
}
CAMERA = {"robot.camera": {"mount": [0.0, 0.0, 0.0], "field_of_view": 1.0}}
SEEN = {**CAMERA, "dock.marker": [0.5, 0.0]}
# What a key needs beside it.
STEERED = {"robot.drive": "ackermann", "robot.limits.wheelbase": 1.0}
COMPANIONS = {
    "dock.approach_speed": {"dock.approach_distance": 0.5},
    "robot.camera.field_of_view": CAMERA,
    "robot.camera.min_range": CAMERA,
    "robot.camera.max_range": CAMERA,
    "dock.visible_distance": SEEN,
    "dock.blind_distance": {**SEEN, "dock.visible_distance": 1e9},
    "clearance.at_dock": {"clearance.required": 1e9},
    "robot.limits.max_steering_angle": STEERED,
    "robot.limits.max_steering_rate": STEERED,
}


@pytest.fixture(scope="module")
def validator():
    schema = scenario_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


def with_key(key, value):
    document = json.loads(json.dumps(MINIMAL))
    for name, given in {**COMPANIONS.get(key, {}), key: value}.items():
        *outer, last = name.split(".")
        block = document
        for part in outer:
            block = block.setdefault(part, {})
        block[last] = copy.deepcopy(given)
        if name == "robot.footprint":
            del block["radius"]
    return document


def accepts(tmp_path, document):
    (tmp_path / "bay.yaml").write_text(yaml.safe_dump(document))
    try:
        load_scenario(tmp_path / "bay.yaml")
    except InvalidFile:
        return False
    return True


def bounds(row):
    """Number and whether it may be reached, from a rule such as `finite and > 0`."""
    return [(float(part.split()[1]), "=" in part) for part in row.rule.split(" and ") if part[0] in "<>"]


def test_the_reference_names_every_key_that_the_reader_knows_and_no_other():
    named = {row.key for row in scenario_reference()}
    parts = [("robot", part) for part in ("limits", "tracking", "camera")]
    mappings = [(), ("robot",), *parts, ("dock",), ("start",), ("clearance",)]
    assert named == {".".join((*mapping, key)) for mapping in mappings for key in known_keys(mapping)}


def test_every_key_says_what_it_is_and_every_optional_one_what_its_absence_means():
    rows = scenario_reference()
    assert [row.key for row in rows if not (row.description and row.type)] == []
    assert [row.key for row in rows if not (row.required or row.absent)] == []
    numbers = [row for row in rows if row.type == "number"]
    assert [row.key for row in numbers if not row.unit] == []


def test_what_the_reference_says_of_a_number_is_what_the_reader_does(tmp_path):
    wrong = []
    for row in (row for row in scenario_reference() if "number" in row.type and not row.type.startswith("list")):
        finite = "finite" in row.rule or row.key in ("robot.radius", "clearance")
        if accepts(tmp_path, with_key(row.key, math.inf)) is finite:
            wrong.append((row.key, "inf"))
        for bound, reached in bounds(row):
            outside = with_key(row.key, math.nextafter(bound, -math.inf))
            inside = with_key(row.key, bound + 1e-3)
            expected = (reached, False, True)
            if tuple(accepts(tmp_path, d) for d in (with_key(row.key, bound), outside, inside)) != expected:
                wrong.append((row.key, row.rule))
        if not bounds(row) and not accepts(tmp_path, with_key(row.key, -1e-3)):
            wrong.append((row.key, "negative"))
    assert wrong == []


def test_defaults_of_the_reference_are_those_of_the_models():
    document = ScenarioDocument.model_validate(with_key("robot.camera", CAMERA["robot.camera"]))
    wrong = []
    for row in (row for row in scenario_reference() if row.default):
        value = document
        for part in row.key.split("."):
            value = getattr(value, part)
        if yaml.safe_load(row.default) != (getattr(value, "value", value)):
            wrong.append((row.key, row.default, value))
    assert wrong == []


def test_plugins_are_described_completely():
    silent = [
        (plugin.name, row.key)
        for plugin in available_plugins()
        for row in plugin_reference(plugin.kind, plugin.name)
        if not row.description
    ]
    assert silent == []


def test_a_plugin_that_does_not_exist_has_no_reference():
    with pytest.raises(PluginError, match="plugin kind 'smoother'"):
        plugin_reference("smoother", "CasadiSmoother")
    with pytest.raises(PluginError, match="unknown plugin"):
        plugin_reference("smoothers", "Nothing")


ACCEPTED = [
    {},
    {"robot.footprint": [[0.4, 0.3], [-0.4, 0.3], [-0.4, -0.3], [0.4, -0.3]]},
    {"robot.footprint": "[[0.4, 0.3], [-0.4, 0.3], [-0.4, -0.3]]"},
    {"robot.footprint": {"radius": 0.3}},
    {"robot.limits": {"max_speed": 0.3, "max_curvature": math.inf}},
    {"dock.direction": "backward"},
    {"dock.marker": [0.5, 0]},
    {"robot.camera": {"mount": [0.3, 0, 0], "field_of_view": 1.0, "max_range": math.inf}},
    {"clearance": 0.1},
    {"clearance": {"required": 0.1}},
    {"obstacles": [[[0, 3], [1, 3], [1, 4]]]},
    {"smoother": {"max_iterations": 20}},
    {"smoother": {"plugin": "SimpleSmoother", "max_its": 7}},
    {"goal_checker": {"plugin": "nav2_controller::SimpleGoalChecker", "xy_goal_tolerance": 0.1}},
    {"controller": {"plugin": "MpcController", "steps": 8}},
]


def test_the_schema_accepts_what_the_reader_accepts(tmp_path, validator):
    for change in ACCEPTED:
        document = with_key(*next(iter(change.items()))) if change else MINIMAL
        assert accepts(tmp_path, document), change
        assert [error.message for error in validator.iter_errors(document)] == [], change


REFUSED = [
    ("format", "optdock-scenario/2"),
    ("robt", {}),
    ("robot.limits", {"max_sped": 0.3}),
    ("robot.limits", {"max_speed": 0}),
    ("robot.limits", {"max_speed": "fast"}),
    ("robot.drive", "omni"),
    ("dock.pose", [1.0, 0.0]),
    ("dock.final_straight", -0.1),
    ("dock.marker", [1.0]),
    ("robot.camera", {"mount": [0.0, 0.0, 0.0], "field_of_view": 0}),
    ("robot.camera", {"mount": [0.0, 0.0, 0.0], "field_of_vew": 1.0}),
    ("clearance", -0.1),
    ("obstacles", [[[0, 3], [1, 3]]]),
    ("smoother", {"max_iteration": 20}),
    ("smoother", {"plugin": "SimpleSmoother", "max_iterations": 20}),
    ("smoother", {"plugin": "Nothing"}),
    ("time_budget", 0),
]


def test_the_schema_refuses_what_the_reader_refuses(tmp_path, validator):
    for key, value in REFUSED:
        document = with_key(key, value)
        assert not accepts(tmp_path, document), (key, value)
        assert list(validator.iter_errors(document)), (key, value)


def test_the_schema_is_json_and_knows_units_and_sections():
    schema = json.loads(json.dumps(scenario_schema(), allow_nan=False))
    assert schema["$defs"]["LimitsDocument"]["properties"]["max_jerk"]["x-unit"] == "m/s^3"
    assert [section for section in SECTIONS if "allOf" not in schema["properties"][section]] == []
