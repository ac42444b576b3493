"""Links: a scene comes back to the last bit, and any other text ends as a message."""

import base64
import dataclasses
import math
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optdock.config import demo_scenario, load_scenario
from optdock.errors import InvalidValue
from optdock.io import guarded_file
from optdock.model.dock import DockTolerances
from optdock.ui.scene_edits import EditedScene
from optdock.ui.scene_files import worked_scenes
from optdock.ui.scene_links import from_link, to_link

SCENES = [EditedScene(load_scenario(file)) for file in worked_scenes()]
TEXT = worked_scenes()[2].read_text()


def packed(content, version="1"):
    content = content.encode() if isinstance(content, str) else content
    return f"{version}." + base64.urlsafe_b64encode(zlib.compress(content)).decode().rstrip("=")


@pytest.mark.parametrize("scene", SCENES)
def test_a_link_contains_the_whole_scene(scene):
    link = to_link(scene)
    found = from_link(link)
    assert found.fingerprint == scene.fingerprint
    assert found.problem.fingerprint == scene.problem.fingerprint
    assert to_link(found) == link
    assert len(link) < 1000


@settings(max_examples=15)
@given(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3), st.floats(-math.pi, math.pi))
def test_a_link_keeps_every_digit_of_an_edit(x, y, angle):
    scene = SCENES[2].added_box(x, y)
    scene = scene.turned(scene.grip("dock"), angle)
    scene = scene.turned(scene.grip("obstacles[4]"), angle)
    assert from_link(to_link(scene)).fingerprint == scene.fingerprint


def test_a_polygon_that_is_not_convex_stays_whole():
    dented = np.array([[3.0, 0.0], [4.0, 0.0], [4.0, 1.0], [3.5, 0.5], [3.0, 1.0]])
    scene = SCENES[2]._with_polygons([dented])
    found = from_link(to_link(scene))
    assert [polygon.tolist() for polygon in found.polygons] == [dented.tolist()]
    assert found.fingerprint == scene.fingerprint


def test_a_slow_part_without_a_speed_is_kept():
    text = TEXT.replace("  approach_speed: 0.1\n", "")
    scene = from_link(packed(text))
    assert math.isinf(scene.problem.dock.approach_speed)
    assert scene.problem.dock.approach_distance == 0.3
    assert from_link(to_link(scene)).fingerprint == scene.fingerprint


def test_scenes_that_a_link_cannot_contain():
    with pytest.raises(InvalidValue, match="link: the scene has a map"):
        to_link(EditedScene(load_scenario(demo_scenario())))
    problem = SCENES[2].problem
    dock = dataclasses.replace(problem.dock, tolerances=DockTolerances(0.5, 0.5, 0.5))
    with pytest.raises(InvalidValue, match="tolerances"):
        to_link(SCENES[2].with_problem(dataclasses.replace(problem, dock=dock)))
    places = np.random.default_rng(1).normal(size=(900, 2)).round(6)
    many = SCENES[2]._with_polygons([np.add(place, [[0, 0], [0.1, 0], [0, 0.1]]) for place in places])
    with pytest.raises(InvalidValue, match="too large"):
        to_link(many)


@pytest.mark.parametrize(
    ("link", "rule"),
    [
        ("", "base64url"),
        (None, "must be text"),
        (3, "must be text"),
        ("1." + "A" * 20_000, "16000 characters"),
        ("2" + to_link(SCENES[0])[1:], "its version is 2"),
        ("1.AAAA", "damaged"),
        ("1.A", "damaged"),
        ("1.++++", "base64url"),
        (to_link(SCENES[0])[:-8], "damaged"),
        (packed(b"\xff\xfe"), "damaged"),
        (packed("x" * 70_000), "more than 64000 bytes"),
        (packed("a: " + "[" * 200), "nested too deeply"),
        (packed("&a [1]\n" * 2), "link"),
        (packed("format: optdock-scenario/1"), "link"),
        (packed("!!python/object/apply:os.system [ls]"), "link"),
        (packed(TEXT.replace("time_budget: 2.0", "time_budget: 61.0")), "<= 60 s"),
        (packed(TEXT + "smoother: {plugin: os.system}\n"), "unknown plugin"),
        (packed(TEXT.replace("max_jerk: 2.0", "max_jerk: -2.0")), "max_jerk"),
    ],
)
def test_other_texts_are_refused(link, rule):
    with pytest.raises(InvalidValue) as caught:
        from_link(link)
    assert rule in str(caught.value)
    assert len(str(caught.value)) <= 200


def test_a_bomb_is_not_unpacked():
    bomb = packed(b"#" * 10_000_000)
    assert len(bomb) < 16_000
    with pytest.raises(InvalidValue, match="more than 64000 bytes"):
        from_link(bomb)


@pytest.mark.parametrize("name", [str(demo_scenario().with_name("hall_map.yaml")), "/etc/passwd", "map.yaml", ""])
def test_a_link_names_no_map_and_reads_no_file(name, monkeypatch):
    monkeypatch.setattr(guarded_file.os, "open", lambda *_: pytest.fail("a file was opened"))
    assert from_link(packed(TEXT)).fingerprint == SCENES[2].fingerprint
    with pytest.raises(InvalidValue, match="map: is not allowed"):
        from_link(packed(f"map: {name!r}\n{TEXT}"))


@settings(max_examples=60)
@given(st.text() | st.binary().map(packed) | st.text().map(lambda text: packed(text.encode("utf-8", "replace"))))
def test_any_text_ends_as_a_message(text):
    with pytest.raises(InvalidValue):
        from_link(text)


@settings(max_examples=60)
@given(st.data())
def test_a_damaged_scenario_ends_as_a_scene_or_a_message(data):
    begin = data.draw(st.integers(0, len(TEXT) - 1))
    end = data.draw(st.integers(begin, min(len(TEXT), begin + 40)))
    new = data.draw(st.text("{}[]:,-.0123456789einfa &*!|>'\"\n#", max_size=12))
    try:
        scene = from_link(packed(TEXT[:begin] + new + TEXT[end:]))
    except InvalidValue:
        return
    assert from_link(to_link(scene)).fingerprint == scene.fingerprint
