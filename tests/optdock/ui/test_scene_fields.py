"""The table of fields: every one is read and written, and any text ends as a value or a message."""

import dataclasses
import math
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optdock.config import load_scenario, scenario_reference
from optdock.errors import InvalidValue
from optdock.geometry.pose import Pose2
from optdock.model.camera import Camera
from optdock.model.limits import LIMITS
from optdock.model.robot import Drive
from optdock.plugins.registry import PluginChoice
from optdock.ui.scene_edits import EditedScene
from optdock.ui.scene_fields import FIELDS, LONGEST_MESSAGE, UNLIMITED, with_field
from optdock.ui.scene_files import worked_scenes
from optdock.ui.scene_links import from_link, to_link

FORK, NO_WAY, BAY = (EditedScene(load_scenario(file)) for file in worked_scenes())


def watching(scene):
    """The scene with a camera and a marker."""
    camera = Camera(Pose2(-0.4, 0.0, math.pi), 2.0, 0.0, 5.0)
    robot = dataclasses.replace(scene.problem.robot, camera=camera)
    dock = dataclasses.replace(scene.problem.dock, marker=(-0.6, 0.0), visible_distance=0.5)
    return scene.with_problem(dataclasses.replace(scene.problem, robot=robot, dock=dock))


SCENES = {"bay": BAY, "fork": FORK, "camera": watching(BAY)}
GIVEN = [(name, key) for name, scene in SCENES.items() for key in FIELDS if FIELDS[key].read(scene) is not None]


def others(field, scene):
    """Texts of other values of a field that the scene accepts."""
    if field.slider is None:
        return [choice for choice in field.choices() if choice != field.read(scene)]
    value, step = field.read(scene), field.slider[2]
    if math.isinf(value):
        return [repr(field.slider[1])]
    near = [repr(round(value - step, 9)), repr(value + step)] if value > step else [repr(value + step)]
    is_steered = field.key == "robot.limits.max_curvature" and scene.problem.robot.drive is Drive.ACKERMANN
    return near + ([UNLIMITED] if field.can_be_unlimited and not is_steered else [])


def test_every_field_is_in_one_of_the_scenes():
    assert {key for _, key in GIVEN} == set(FIELDS)


@pytest.mark.parametrize(("name", "key"), GIVEN)
def test_a_field_is_read_and_written(name, key):
    scene, field = SCENES[name], FIELDS[key]
    assert with_field(scene, key, field.text(scene)) is scene
    accepted, last = 0, scene
    for text in others(field, scene):
        try:
            edited = with_field(scene, key, text)
        except InvalidValue:
            continue
        accepted += 1
        assert edited.fingerprint != scene.fingerprint
        found = field.read(edited)
        assert found == (text if isinstance(found, str) else pytest.approx(float(text.replace(UNLIMITED, "inf"))))
        last = edited
    assert accepted, others(field, scene)
    # A scenario file keeps the value.
    assert from_link(to_link(last, Path()), Path()).fingerprint == last.fingerprint


@pytest.mark.parametrize(("name", "key"), [pair for pair in GIVEN if FIELDS[pair[1]].slider])
def test_a_value_that_is_written_back_restores_the_scene(name, key):
    scene, field = SCENES[name], FIELDS[key]
    if key in ("dock.approach_distance", "robot.footprint.length"):
        return  # see below
    text = others(field, scene)[0]
    assert with_field(with_field(scene, key, text), key, field.text(scene)).fingerprint == scene.fingerprint


@pytest.mark.parametrize("key", [key for name, key in GIVEN if name == "camera" and FIELDS[key].slider])
def test_a_text_is_short_and_keeps_the_value_until_it_is_edited(key):
    scene, field = SCENES["camera"], FIELDS[key]
    value = min(field.read(scene), 10.0)  # some are infinite
    noisy = with_field(scene, key, repr(0.9 * value + 1 / 300))
    text = field.text(noisy)
    assert len(text) <= 10
    assert field.read(noisy) == pytest.approx(float(text), rel=1e-5)
    assert repr(field.read(noisy)) != text
    assert with_field(noisy, key, text) is noisy
    edited = with_field(noisy, key, f"{float(text) - 1e-4:.4f}")
    assert field.read(edited) != field.read(noisy)


def test_the_reduced_curvature_is_kept_when_it_is_entered():
    key = "robot.limits.max_curvature"
    value, text = FIELDS[key].read(FORK), FIELDS[key].text(FORK)
    assert float(text) > value  # rounded up
    again = with_field(with_field(FORK, key, "1.2"), key, text)
    assert FIELDS[key].read(again) == value
    with pytest.raises(InvalidValue, match="the curvature at max_steering_angle"):
        with_field(FORK, key, "1.2603")


def test_the_texts_of_the_table_come_from_the_scenario_keys():
    units = {row.key: row.unit for row in scenario_reference()}
    for key, field in FIELDS.items():
        assert field.label
        assert field.words
        assert units.get(key, field.unit or units.get(key.rpartition(".")[0])) == field.unit
        if field.slider:
            low, high, step = field.slider
            assert low < high
            assert 0.0 < step <= high - low
    for name, limit in LIMITS.items():
        assert FIELDS[f"robot.limits.{name}"].unit == limit.unit
        assert FIELDS[f"robot.limits.{name}"].words == limit.words


hostile = (
    st.text(max_size=400)
    | st.floats().map(repr)
    | st.integers().map(str)
    | st.sampled_from(
        [
            "",
            " ",
            "nan",
            "inf",
            "-inf",
            "1e999",
            "1e308",
            "-0",
            "1_0",
            "٣",
            "0x1",
            "1e-320",
            "9" * 5000,
            "unlimited",
            "1,5",
            "<script>alert(1)</script>",
            "../../etc/passwd",
            "\x00",
            "\ud800",
            "{{7*7}}",
            "1e100",
            "1e8",
            "1e-9",
        ]
    )
)


@settings(max_examples=60)
@given(st.sampled_from([*FIELDS]), hostile)
def test_any_text_ends_as_a_value_or_a_message(key, text):
    for scene in (BAY, FORK):
        before = scene.fingerprint
        message = ""
        try:
            edited = with_field(scene, key, text)
        except InvalidValue as error:
            message = str(error)
        if message:
            assert message.startswith(f"{key}: ")
            assert message.isprintable()
            assert len(message) <= LONGEST_MESSAGE
        else:
            assert from_link(to_link(edited, Path()), Path()).fingerprint == edited.fingerprint
        assert scene.fingerprint == before


@pytest.mark.parametrize("text", [None, 3, 0.5, b"0.5", ["0.5"], {}])
def test_only_text_is_read(text):
    with pytest.raises(InvalidValue, match="must be text"):
        with_field(BAY, "clearance.required", text)
    with pytest.raises(InvalidValue, match="no field"):
        with_field(BAY, text, "0.5")


@pytest.mark.parametrize(
    ("key", "text", "rule"),
    [
        ("time_budget", "60.1", "<= 60 s"),
        ("time_budget", "0", "> 0"),
        ("robot.limits.max_speed", "-1", "> 0 m/s"),
        ("robot.limits.max_speed", "500", "beyond 50 m/s"),
        ("robot.limits.max_jerk", "unlimited", "must be a number"),
        ("robot.footprint.front", "800", "beyond 50 m"),
        ("robot.footprint.width", "0", "3 distinct vertices"),
        ("robot.limits.wheelbase", "2", "no such value"),
        ("clearance.at_dock", "0.06", "<= required = 0.05 m"),
        ("dock.direction", "sideways", "one of forward, backward, auto"),
        ("smoother", "os.system", "one of CasadiSmoother"),
        ("dock.visible_distance", "1", "no such value"),
    ],
)
def test_a_message_names_field_value_and_rule(key, text, rule):
    with pytest.raises(InvalidValue) as caught:
        with_field(BAY, key, text)
    assert key in str(caught.value)
    assert repr(text) in str(caught.value)
    assert rule in str(caught.value)


def test_a_long_message_is_shortened():
    with pytest.raises(InvalidValue) as caught:
        with_field(with_field(BAY, "robot.footprint.front", "48"), "robot.footprint.rear", "-45.000000000")
    assert len(str(caught.value)) == LONGEST_MESSAGE
    assert str(caught.value).endswith("...")


def test_a_limit_that_is_written_is_no_default():
    assert "max_lateral_jerk" in BAY.scenario.default_limits
    assert "max_lateral_jerk" not in with_field(BAY, "robot.limits.max_lateral_jerk", "2").scenario.default_limits


def test_another_outline_than_a_rectangle_has_a_length_only():
    assert FIELDS["robot.footprint.front"].read(FORK) is None
    longer = with_field(FORK, "robot.footprint.length", "3.9")
    assert longer.problem.robot.footprint.vertices == pytest.approx(1.5 * FORK.problem.robot.footprint.vertices)
    for text in ("0", "-1", "1e-300", "1e300"):
        with pytest.raises(InvalidValue):
            with_field(FORK, "robot.footprint.length", text)


def test_a_drive_leaves_out_the_limits_that_it_cannot_have():
    wheels = with_field(FORK, "robot.drive", "differential")
    assert math.isinf(wheels.problem.robot.limits.max_steering_angle)
    assert FIELDS["robot.limits.wheelbase"].read(wheels) is None
    assert with_field(wheels, "robot.drive", "ackermann").problem.robot.drive is Drive.ACKERMANN


def test_the_slow_part_has_a_length_and_a_speed_or_neither():
    fast = with_field(BAY, "dock.approach_distance", "0")
    assert math.isinf(fast.problem.dock.approach_speed)
    assert FIELDS["dock.approach_speed"].read(fast) is None
    slow = with_field(fast, "dock.approach_distance", "0.3")
    assert slow.problem.dock.approach_speed == 0.4
    assert with_field(slow, "dock.approach_speed", "0.1").fingerprint == BAY.fingerprint


def test_a_plugin_with_parameters_is_kept_until_another_one_is_chosen():
    chosen = dataclasses.replace(BAY.scenario, smoother=PluginChoice("CasadiSmoother", {"max_iterations": 20}))
    scene = EditedScene(chosen)
    assert scene.fingerprint != BAY.fingerprint
    assert with_field(scene, "smoother", "CasadiSmoother") is scene
    assert with_field(scene, "smoother", "SimpleSmoother").scenario.smoother == PluginChoice("SimpleSmoother")
    planner = with_field(BAY, "planner", "ManoeuvrePlanner")
    assert [one.name for one in planner.scenario.planner] == ["ManoeuvrePlanner"]
    assert with_field(planner, "planner", FIELDS["planner"].text(BAY)).fingerprint == BAY.fingerprint


def test_a_curvature_that_follows_from_the_steering_follows_it():
    assert FORK.problem.robot.limits.max_curvature == math.tan(0.9)
    less = with_field(FORK, "robot.limits.max_steering_angle", "0.2")
    assert less.problem.robot.limits.max_curvature == math.tan(0.2)
    assert with_field(less, "robot.limits.max_steering_angle", "0.9").fingerprint == FORK.fingerprint
    with pytest.raises(InvalidValue, match="the curvature at max_steering_angle"):
        with_field(FORK, "robot.limits.max_curvature", "2")
    own = with_field(FORK, "robot.limits.max_curvature", "0.5")
    assert with_field(own, "robot.limits.wheelbase", "0.9").problem.robot.limits.max_curvature == 0.5
    assert with_field(own, "robot.limits.max_curvature", UNLIMITED).fingerprint == FORK.fingerprint
