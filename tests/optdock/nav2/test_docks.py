import math

import pytest

from optdock.errors import InvalidFile
from optdock.geometry.pose import Pose2
from optdock.nav2.docks import load_dock_database


@pytest.fixture
def real(real_data):
    return lambda name: load_dock_database(real_data / "nav2" / "docks" / name)


def written(tmp_path, text):
    (tmp_path / "docks.yaml").write_text(text)
    return tmp_path / "docks.yaml"


def faults(tmp_path, text):
    with pytest.raises(InvalidFile) as caught:
        load_dock_database(written(tmp_path, text))
    return str(caught.value).replace(str(tmp_path) + "/", "").splitlines()


def test_a_real_database_is_read(real):
    docks = real("test_dock_file.yaml")
    assert list(docks) == ["dock1", "dock2"]
    assert (docks["dock1"].type, docks["dock1"].frame, docks["dock1"].id) == ("dockv3", "mapA", None)
    assert docks["dock1"].pose == Pose2(0.3, 0.3, 0.0)
    assert (docks["dock2"].type, docks["dock2"].frame, docks["dock2"].id) == ("dockv1", "map", "2")


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("bad_conversion", ":5: docks.dock1.pose.1: must be a number, got 'map'"),
        ("bad_pose", ":5: docks.dock1.pose: must be [x, y, yaw] in m, m, rad, got [0.3, 0.3]"),
        ("no_pose", ":2: docks.dock1.pose: is required: [x, y, yaw] in m, m, rad"),
        ("no_type", ":2: docks.dock1.type: is required: the name of a dock plugin"),
    ],
)
def test_each_real_broken_database_is_refused_by_its_fault(name, message, real):
    with pytest.raises(InvalidFile) as caught:
        real(f"test_dock_{name}_file.yaml")
    assert str(caught.value).endswith(f"/test_dock_{name}_file.yaml{message}")


def test_a_real_file_without_docks_is_refused(real):
    with pytest.raises(InvalidFile, match=r"docks: must be a mapping of dock names to docks; the file has no_docks$"):
        real("test_no_docks_file.yaml")


def test_an_id_is_not_used_for_the_next_dock(tmp_path):
    text = "docks:\n  a: {type: t, pose: [0, 0, 0], id: tag7, frame: odom}\n  b: {type: t, pose: [1, 0, 0]}\n"
    docks = load_dock_database(written(tmp_path, text))
    assert (docks["a"].id, docks["a"].frame) == ("tag7", "odom")
    assert (docks["b"].id, docks["b"].frame) == (None, "map")


def test_all_faults_of_all_docks_are_listed_at_once(tmp_path):
    text = """docks:
  a:
    type: [t]
    pose: [0, 0, .nan]
  b: 3
  c:
    typ: t
    pose: [true, 0, x]
    id: 1.5
"""
    assert faults(tmp_path, text) == [
        "docks.yaml:3: docks.a.type: must be text, got ['t']",
        "docks.yaml:4: docks.a.pose: pose.yaw: must be finite, got nan",
        "docks.yaml:5: docks.b: must be a mapping with type and pose, got 3",
        "docks.yaml:6: docks.c.type: is required: the name of a dock plugin; typ is not read, did you mean type?",
        "docks.yaml:9: docks.c.id: must be text, got 1.5",
        "docks.yaml:8: docks.c.pose.0: must be a number, got True",
        "docks.yaml:8: docks.c.pose.2: must be a number, got 'x'",
    ]


@pytest.mark.parametrize("text", ["docks: {}\n", "docks: []\n", "docks:\n", "[1, 2]\n"])
def test_a_file_without_any_dock_is_refused(tmp_path, text):
    (line,) = faults(tmp_path, text)
    assert "docks: must be a mapping of dock names to docks" in line


def test_keys_that_nav2_does_not_read_are_listed(tmp_path):
    text = "docks:\n  a: {type: t, pose: [0, 0, 3.14], tolerance: 0.5}\n"
    dock = load_dock_database(written(tmp_path, text))["a"]
    assert dock.unknown == ("tolerance",)
    assert math.isclose(dock.pose.yaw, 3.14)
