"""Files of scenes: what is opened and saved in the folder, and every way out of it."""

import dataclasses
import shutil

import pytest
from PIL import Image

from optdock.config import demo_scenario, load_scenario
from optdock.errors import InvalidFile, InvalidValue, NoMotionExists
from optdock.io.plan_file import save_plan
from optdock.planning.failures import check_ends
from optdock.reports.report import failed_plan_file
from optdock.ui import scene_files, scene_maps
from optdock.ui.scene_edits import EditedScene
from optdock.ui.scene_files import open_scene, saved, worked_scenes
from optdock.ui.scene_maps import known_costmap

FORK, NO_WAY, BAY = worked_scenes()
DEMO = demo_scenario().parent


@pytest.fixture
def folder(tmp_path):
    """A folder with a scenario and a map, beside a folder with secrets."""
    shutil.copytree(DEMO, tmp_path / "inside")
    shutil.copytree(DEMO, tmp_path / "outside")
    shutil.copy(BAY, tmp_path / "inside")
    return tmp_path / "inside"


def test_scenario_map_and_built_in_scene(folder):
    first = open_scene(None, folder)
    assert len(first.polygons) == 1  # a box beside the way
    bare = first.removed(first.grip("obstacles[0]"))
    assert bare.problem.fingerprint == load_scenario(demo_scenario()).problem.fingerprint
    hall = open_scene("hall.yaml", folder)
    assert hall.problem.fingerprint == load_scenario(demo_scenario()).problem.fingerprint
    assert hall.map_source == folder / "hall_map.yaml"
    bay = open_scene(str(folder / "reverse_bay.yaml"), folder)
    assert bay.fingerprint == EditedScene(load_scenario(BAY)).fingerprint
    on_map = open_scene("hall_map.yaml", folder)
    check_ends(on_map.problem)
    assert on_map.scenario.plan(5.0)


def test_on_a_narrow_map_the_robot_is_smaller(folder):
    (folder / "hall_map.yaml").write_text((DEMO / "hall_map.yaml").read_text().replace("0.05", "0.02"))
    scene = open_scene("hall_map.yaml", folder)
    check_ends(scene.problem)
    assert scene.problem.robot.footprint.length < 0.9
    assert (
        scene.nudged(scene.grip("start"), 1.0, 0.0).nudged(scene.grip("start"), -1.0, 0.0).fingerprint
        == scene.fingerprint
    )


def test_a_large_map_gives_places_that_are_free_in_it(folder, monkeypatch):
    """Places are searched in blocks of cells, and in the cells if the blocks have none."""
    searched, search = [], scene_files._with_places_on
    monkeypatch.setattr(
        scene_files, "_with_places_on", lambda cells, problem: searched.append(cells.rows) or search(cells, problem)
    )
    rows = known_costmap("hall_map.yaml", folder).rows
    for most, blocks in ((10_000, 2), (2_000, 3), (10, 40)):
        monkeypatch.setattr(scene_files, "_MOST_CELLS", most)
        scene_files._placed_on.cache_clear()
        scene = open_scene("hall_map.yaml", folder)
        check_ends(scene.problem)
        assert searched[0] == -(-rows // blocks)
        assert searched[-1] == (rows if blocks == 40 else searched[0])
        assert scene.problem.costmap.rows == rows
        searched.clear()


@pytest.mark.parametrize("source", ["hall.yaml", "hall_map.yaml"])
def test_a_map_is_read_again_only_after_a_change(folder, source, monkeypatch):
    read, load = [], scene_maps.load_map
    monkeypatch.setattr(scene_maps, "load_map", lambda file: read.append(file) or load(file))
    first = open_scene(source, folder)
    assert open_scene(source, folder).problem.costmap is first.problem.costmap
    assert len(read) == 1
    image = Image.open(folder / "hall_map.png").convert("L")
    for replaced in (True, False):
        image.putpixel((5, 5), 255 - image.getpixel((5, 5)))
        if replaced:
            image.save(folder / "new.png")
            (folder / "new.png").replace(folder / "hall_map.png")
        else:
            image.save(folder / "hall_map.png")
        costmap = open_scene(source, folder).problem.costmap
        assert costmap.data.tolist() == load(folder / "hall_map.yaml").costmap.data.tolist()
    text = (folder / "hall_map.yaml").read_text()
    (folder / "hall_map.yaml").write_text(text.replace("0.05", "0.06"))
    assert open_scene(source, folder).problem.costmap.resolution == 0.06
    assert len(read) == 4


def test_a_map_without_a_free_place_is_refused(folder):
    (folder / "hall_map.yaml").write_text((DEMO / "hall_map.yaml").read_text().replace("0.05", "0.002"))
    with pytest.raises(InvalidValue, match="no free place"):
        open_scene("hall_map.yaml", folder)


def test_the_scenario_of_a_plan_is_found_by_its_certificate(folder):
    plan = load_scenario(BAY).plan(10.0)
    plan.save(folder / "result.json")
    assert open_scene("result.json", folder).scenario.source.name == "reverse_bay.yaml"
    saved(open_scene("reverse_bay.yaml", folder).added_box(9.0, 9.0), "reverse_bay", folder, overwrite=True)
    with pytest.raises(InvalidValue, match="does not contain its scenario"):
        open_scene("result.json", folder)


@pytest.mark.parametrize("is_proven", [True, False])
def test_the_scenario_of_a_refusal_is_found(folder, is_proven):
    shutil.copy(NO_WAY, folder / ("other.yaml" if is_proven else "refused.yaml"))
    with pytest.raises(NoMotionExists) as caught:
        load_scenario(NO_WAY).plan(10.0)
    found = failed_plan_file(caught.value, "map")
    save_plan(folder / "refused.json", found if is_proven else dataclasses.replace(found, impossibility=None))
    assert open_scene("refused.json", folder).fingerprint == EditedScene(load_scenario(NO_WAY)).fingerprint
    (folder / "refused.yaml").unlink(missing_ok=True)
    (folder / "other.yaml").unlink(missing_ok=True)
    with pytest.raises(InvalidValue, match="does not contain its scenario"):
        open_scene("refused.json", folder)


def test_a_loop_of_links_ends_as_a_message(folder):
    (folder / "loop.yaml").symlink_to(folder / "loop.yaml")
    with pytest.raises((InvalidValue, InvalidFile)):
        open_scene("loop.yaml", folder)


@pytest.mark.parametrize(
    "name",
    [
        "../outside/hall.yaml",
        "sub/../../outside/hall.yaml",
        "{outside}/hall.yaml",
        "/etc/passwd",
        "link.yaml",
        "up/hall.yaml",
        "hall\x00.yaml",
        "\ud800.yaml",
        "../inside2.yaml",
        "~/x.yaml/../../../outside/hall.yaml",
    ],
)
def test_no_file_outside_the_folder_is_opened(folder, name):
    outside = folder.parent / "outside"
    (folder / "sub").mkdir()
    (folder / "link.yaml").symlink_to(outside / "hall.yaml")
    (folder / "up").symlink_to(outside)
    shutil.copy(BAY, folder.parent / "inside2.yaml")
    with pytest.raises(InvalidValue, match="is not in the folder"):
        open_scene(name.format(outside=outside), folder)
    # The same names are good in a larger folder.
    if name in ("../outside/hall.yaml", "link.yaml", "up/hall.yaml", "../inside2.yaml"):
        assert open_scene(folder / name, folder.parent)


@pytest.mark.parametrize("target", ["../outside/hall_map.yaml", "{outside}/hall_map.yaml", "up/hall_map.yaml"])
def test_no_map_outside_the_folder_is_read(folder, target):
    outside = folder.parent / "outside"
    (folder / "up").symlink_to(outside)
    text = (folder / "hall.yaml").read_text().replace("hall_map.yaml", target.format(outside=outside))
    (folder / "bad.yaml").write_text(text)
    with pytest.raises(InvalidFile, match="is not in the folder"):
        open_scene("bad.yaml", folder)
    assert open_scene(folder / "bad.yaml", folder.parent)


@pytest.mark.parametrize("source", ["bad_map.yaml", "bad.yaml"])
@pytest.mark.parametrize("image", ["../outside/hall_map.png", "{outside}/hall_map.png", "picture.png"])
def test_no_image_outside_the_folder_is_read(folder, source, image):
    outside = folder.parent / "outside"
    (folder / "picture.png").symlink_to(outside / "hall_map.png")
    text = (folder / "hall_map.yaml").read_text().replace("hall_map.png", image.format(outside=outside))
    (folder / "bad_map.yaml").write_text(text)
    (folder / "bad.yaml").write_text((folder / "hall.yaml").read_text().replace("hall_map", "bad_map"))
    with pytest.raises((InvalidFile, InvalidValue), match="is not in the folder"):
        open_scene(source, folder)
    assert open_scene(folder / source, folder.parent)


def test_a_link_inside_the_folder_is_followed(folder):
    (folder / "sub").mkdir()
    (folder / "sub" / "same.yaml").symlink_to(folder / "reverse_bay.yaml")
    assert open_scene("sub/same.yaml", folder)
    # The map of a linked scenario is relative to the link, for the check and for the reader.
    (folder / "sub" / "hall.yaml").symlink_to(folder / "hall.yaml")
    with pytest.raises(InvalidFile):
        open_scene("sub/hall.yaml", folder)


def test_other_files_end_as_messages(folder):
    (folder / "plan.json").write_text("{}")
    (folder / "list.yaml").write_text("[1, 2]")
    for name in ("plan.json", "list.yaml", "missing.yaml", "hall_map.png"):
        with pytest.raises(InvalidFile):
            open_scene(name, folder)


def test_a_saved_scene_is_opened_again(folder):
    scene = open_scene("reverse_bay.yaml", folder).added_wall(3.0, 0.0, 3.0, 1.0)
    assert [file.name for file in saved(scene, "my bay 2", folder)] == ["my bay 2.yaml"]
    assert open_scene("my bay 2.yaml", folder).fingerprint == scene.fingerprint
    # A map of the folder is named, and any other map is written.
    hall = open_scene("hall.yaml", folder)
    moved = hall.nudged(hall.grip("start"), 0.1, 0.0)
    assert [file.name for file in saved(moved, "moved.yaml", folder)] == ["moved.yaml"]
    assert open_scene("moved.yaml", folder).fingerprint == moved.fingerprint
    built_in = open_scene(None, folder)
    assert len(saved(built_in, "mine", folder)) == 3
    assert open_scene("mine.yaml", folder).problem.fingerprint == built_in.problem.fingerprint


@pytest.mark.parametrize(
    "name",
    [
        "../x",
        "a/b",
        "a\\b",
        ".hidden",
        "",
        " ",
        "x ",
        "..",
        "/etc/x",
        "a\x00",
        "a\n",
        "é",
        "x" * 200,
        "con:",
        None,
        3,
        "-x",
    ],
)
def test_other_names_are_refused(folder, name):
    before = sorted(folder.parent.rglob("*"))
    with pytest.raises(InvalidValue, match="name: must be"):
        saved(EditedScene(load_scenario(BAY)), name, folder)
    assert sorted(folder.parent.rglob("*")) == before


def test_no_file_is_overwritten_without_being_asked(folder):
    scene = open_scene("reverse_bay.yaml", folder)
    before = (folder / "hall.yaml").read_bytes()
    with pytest.raises(InvalidValue, match="hall.yaml exists"):
        saved(scene, "hall", folder)
    (folder / "hall.yaml").unlink()
    with pytest.raises(InvalidValue, match="hall_map.yaml exists"):
        saved(open_scene(None, folder), "hall", folder)
    assert not (folder / "hall.yaml").exists()
    saved(scene, "hall", folder, overwrite=True)
    assert (folder / "hall.yaml").read_bytes() != before


def test_a_link_out_of_the_folder_is_not_written_through(folder):
    secret = folder.parent / "outside" / "hall.yaml"
    before = secret.read_bytes()
    for name, target in (("out", secret), ("new", secret.with_name("new.yaml"))):
        (folder / f"{name}.yaml").symlink_to(target)
        with pytest.raises(InvalidValue):
            saved(open_scene("reverse_bay.yaml", folder), name, folder, overwrite=True)
    assert secret.read_bytes() == before
    assert not secret.with_name("new.yaml").exists()


def test_the_worked_scenes():
    assert [file.stem for file in worked_scenes()] == ["forklift", "no_way", "reverse_bay"]
    bay = load_scenario(BAY).plan()
    assert [int(one.direction) for one in bay.path.segments] == [1, -1]
    fork = load_scenario(FORK).plan()
    assert [int(one.direction) for one in fork.path.segments] == [1]
    with pytest.raises(NoMotionExists, match="0.04 m too wide for the gap"):
        load_scenario(NO_WAY).plan()
    # The gap with 4 cm more is wide enough.
    scene = EditedScene(load_scenario(NO_WAY))
    wider = scene.nudged(scene.grip("obstacles[4]"), 0.0, -0.05)
    assert wider.scenario.plan()
    assert dataclasses.replace(wider.scenario, problem=scene.problem).problem.fingerprint == scene.problem.fingerprint
