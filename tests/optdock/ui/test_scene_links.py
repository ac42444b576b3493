"""Links: a scene comes back to the last bit, and any other text ends as a message."""

import base64
import dataclasses
import math
import os
import shutil
import zlib
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from optdock.config import demo_scenario, load_scenario
from optdock.errors import InvalidValue
from optdock.io import guarded_file
from optdock.model.dock import DockTolerances
from optdock.ui.edited_obstacle import EditedObstacle
from optdock.ui.scene_edits import EditedScene
from optdock.ui.scene_files import open_scene, worked_scenes
from optdock.ui.scene_links import _content, from_link, to_link

SCENES = [EditedScene(load_scenario(file)) for file in worked_scenes()]
TEXT = worked_scenes()[2].read_text()
NONE = Path()  # folder of links without a map
HALL = demo_scenario().parent


def packed(content, version="1"):
    content = content.encode() if isinstance(content, str) else content
    return f"{version}." + base64.urlsafe_b64encode(zlib.compress(content)).decode().rstrip("=")


@pytest.fixture
def folder(tmp_path):
    """A folder with the hall and its map, which is also in a folder below, beside a folder with the same files."""
    for name in ("inside", "outside"):
        shutil.copytree(HALL, tmp_path / name)
    shutil.copytree(HALL, tmp_path / "inside" / "h\u00f6he")
    return tmp_path / "inside"


def linked(folder, source="hall.yaml"):
    """A scene with a map that was edited, and its link."""
    scene = open_scene(source, folder)
    scene = scene.nudged(scene.grip("start"), 0.1, 0.0).added_box(1.0, 1.0)
    return scene, to_link(scene, folder)


def with_map(name, folder):
    """A link with another map but the right digest."""
    link = linked(folder)[1]
    content = yaml.safe_load(_content(link)[0])
    return f"{packed(yaml.safe_dump({**content, 'map': name}), '2')}.{link.rpartition('.')[2]}"


@pytest.mark.parametrize("scene", SCENES)
def test_a_link_contains_the_whole_scene(scene):
    link = to_link(scene, NONE)
    found = from_link(link, NONE)
    assert found.fingerprint == scene.fingerprint
    assert found.problem.fingerprint == scene.problem.fingerprint
    assert to_link(found, NONE) == link
    assert len(link) < 1000


@settings(max_examples=15)
@given(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3), st.floats(-math.pi, math.pi))
def test_a_link_keeps_every_digit_of_an_edit(x, y, angle):
    scene = SCENES[2].added_box(x, y)
    scene = scene.turned(scene.grip("dock"), angle)
    scene = scene.turned(scene.grip("obstacles[4]"), angle)
    assert from_link(to_link(scene, NONE), NONE).fingerprint == scene.fingerprint


def test_a_polygon_that_is_not_convex_stays_whole():
    dented = np.array([[3.0, 0.0], [4.0, 0.0], [4.0, 1.0], [3.5, 0.5], [3.0, 1.0]])
    scene = SCENES[2]._with_obstacles((EditedObstacle.of(dented, 0),))
    found = from_link(to_link(scene, NONE), NONE)
    assert [polygon.tolist() for polygon in found.polygons] == [dented.tolist()]
    assert found.fingerprint == scene.fingerprint


def test_a_slow_part_without_a_speed_is_kept():
    text = TEXT.replace("  approach_speed: 0.1\n", "")
    scene = from_link(packed(text), NONE)
    assert math.isinf(scene.problem.dock.approach_speed)
    assert scene.problem.dock.approach_distance == 0.3
    assert from_link(to_link(scene, NONE), NONE).fingerprint == scene.fingerprint


def test_scenes_that_a_link_cannot_contain():
    problem = SCENES[2].problem
    dock = dataclasses.replace(problem.dock, tolerances=DockTolerances(0.5, 0.5, 0.5))
    with pytest.raises(InvalidValue, match="tolerances"):
        to_link(SCENES[2].with_problem(dataclasses.replace(problem, dock=dock)), NONE)
    places = np.random.default_rng(1).normal(size=(900, 2)).round(6)
    triangles = [np.add(place, [[0, 0], [0.1, 0], [0, 0.1]]) for place in places]
    many = SCENES[2]._with_obstacles(tuple(map(EditedObstacle.of, triangles, range(900))))
    with pytest.raises(InvalidValue, match="too large"):
        to_link(many, NONE)


@pytest.mark.parametrize(
    ("link", "rule"),
    [
        ("", "base64url"),
        (None, "must be text"),
        (3, "must be text"),
        ("1." + "A" * 20_000, "16000 characters"),
        ("3" + to_link(SCENES[0], NONE)[1:], "its version is 3"),
        ("2" + to_link(SCENES[0], NONE)[1:], "damaged"),
        (to_link(SCENES[0], NONE) + ".0123456789abcdef", "damaged"),
        (packed(TEXT, "2") + ".0123456789abcdef", "names no map"),
        (packed("map: 3\n" + TEXT, "2") + ".0123456789abcdef", "map"),
        (packed(TEXT, "2") + ".0123456789abcdeg", "base64url"),
        ("1.AAAA", "damaged"),
        ("1.A", "damaged"),
        ("1.++++", "base64url"),
        (to_link(SCENES[0], NONE)[:-8], "damaged"),
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
        from_link(link, NONE)
    assert rule in str(caught.value)
    assert len(str(caught.value)) <= 200


def test_a_bomb_is_not_unpacked():
    bomb = packed(b"#" * 10_000_000)
    assert len(bomb) < 16_000
    with pytest.raises(InvalidValue, match="more than 64000 bytes"):
        from_link(bomb, NONE)


@pytest.mark.parametrize("source", ["hall.yaml", "h\u00f6he/hall.yaml", "hall_map.yaml", None])
def test_a_link_names_the_map_of_its_scene(folder, source):
    scene, link = linked(folder, source)
    found = from_link(link, folder)
    assert found.fingerprint == scene.fingerprint
    assert found.problem.fingerprint == scene.problem.fingerprint
    assert found.map_source == scene.map_source
    assert to_link(found, folder) == link
    assert len(link) < 1000


def test_a_link_to_a_changed_map_is_a_message(folder):
    scene, link = linked(folder)
    image = Image.open(folder / "hall_map.png").convert("L")
    image.putpixel((5, 5), 0 if image.getpixel((5, 5)) else 255)
    image.save(folder / "hall_map.png")
    with pytest.raises(InvalidValue, match="map: 'hall_map.yaml' has changed since the link was made"):
        from_link(link, folder)
    shutil.copy(HALL / "hall_map.png", folder)
    assert from_link(link, folder).fingerprint == scene.fingerprint
    text = (folder / "hall_map.yaml").read_text()
    (folder / "hall_map.yaml").write_text(text.replace("0.05", "0.06"))
    with pytest.raises(InvalidValue, match="has changed"):
        from_link(link, folder)
    (folder / "hall_map.yaml").unlink()
    with pytest.raises(InvalidValue, match="No such file"):
        from_link(link, folder)


def test_a_map_outside_the_folder_has_no_link(folder):
    scene = open_scene("hall.yaml", folder.parent / "outside")
    for source in (None, scene.map_source, folder / ("x" * 300)):
        with pytest.raises(InvalidValue, match="link: the map of the scene is not a file of the folder"):
            to_link(dataclasses.replace(scene, map_source=source), folder)


@pytest.mark.parametrize("name", ["hall_map.yaml", "h\u00f6he/../hall_map.yaml", "./h\u00f6he/hall_map.yaml"])
def test_a_link_may_name_any_map_within_the_folder(folder, name):
    assert from_link(with_map(name, folder), folder).fingerprint == linked(folder)[0].fingerprint


@pytest.mark.parametrize(
    "name",
    [
        "../outside/hall_map.yaml",
        "h\u00f6he/../../outside/hall_map.yaml",
        "{outside}/hall_map.yaml",
        "{inside}/hall_map.yaml",  # absolute, within the folder
        "C:\\hall_map.yaml",
        "\\\\server\\share\\hall_map.yaml",
        "link.yaml",
        "up/hall_map.yaml",
        "picture.yaml",
        "picture2.yaml",
        "picture3.yaml",
        "hall.yaml",
        "hall_map.png",
        "pipe.yaml",
        "loop.yaml",
        "",
        ".",
        "..",
        "h\u00e5ll.yaml",
        "hall_map.yaml\x00",
        "a" * 100_000,
        "a/" * 99 + "hall_map.yaml",
        "optdock:../hall_map.yaml",
        "optdock:hall.yaml",
        "/etc/passwd",
        "/dev/zero",
        "~/hall_map.yaml",
        "file:///etc/passwd",
    ],
)
def test_no_map_outside_the_folder_is_read(folder, name, monkeypatch):
    outside, text = folder.parent / "outside", (folder / "hall_map.yaml").read_text()
    (folder / "link.yaml").symlink_to(outside / "hall_map.yaml")
    (folder / "up").symlink_to(outside)
    (folder / "loop.yaml").symlink_to(folder / "loop.yaml")
    os.mkfifo(folder / "pipe.yaml")
    for file, image in (("picture", outside / "hall_map.png"), ("picture2", "up/hall_map.png"), ("picture3", "p.png")):
        (folder / f"{file}.yaml").write_text(text.replace("hall_map.png", str(image)))
    (folder / "p.png").symlink_to(outside / "hall_map.png")
    link = with_map(name.format(outside=outside, inside=folder), folder)
    opened, read = [], os.open
    monkeypatch.setattr(
        guarded_file.os, "open", lambda path, *flags: opened.append(Path(path).resolve()) or read(path, *flags)
    )
    with pytest.raises(InvalidValue) as caught:
        from_link(link, folder)
    assert len(str(caught.value)) <= 200
    assert [file for file in opened if not file.is_relative_to(folder)] == []


@pytest.mark.parametrize("name", [str(HALL / "hall_map.yaml"), "/etc/passwd", "map.yaml", ""])
def test_a_link_without_a_digest_names_no_map_and_reads_no_file(name, monkeypatch):
    monkeypatch.setattr(guarded_file.os, "open", lambda *_: pytest.fail("a file was opened"))
    assert from_link(packed(TEXT), NONE).fingerprint == SCENES[2].fingerprint
    with pytest.raises(InvalidValue, match="map: is not allowed"):
        from_link(packed(f"map: {name!r}\n{TEXT}"), NONE)


@settings(max_examples=60)
@given(st.text() | st.binary().map(packed) | st.text().map(lambda text: packed(text.encode("utf-8", "replace"))))
def test_any_text_ends_as_a_message(text):
    with pytest.raises(InvalidValue):
        from_link(text, NONE)


@settings(max_examples=60)
@given(st.data())
def test_a_damaged_scenario_ends_as_a_scene_or_a_message(data):
    begin = data.draw(st.integers(0, len(TEXT) - 1))
    end = data.draw(st.integers(begin, min(len(TEXT), begin + 40)))
    new = data.draw(st.text("{}[]:,-.0123456789einfa &*!|>'\"\n#", max_size=12))
    try:
        scene = from_link(packed(TEXT[:begin] + new + TEXT[end:]), NONE)
    except InvalidValue:
        return
    assert from_link(to_link(scene, NONE), NONE).fingerprint == scene.fingerprint
