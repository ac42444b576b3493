"""The files that the package installs beside its parameters: RViz configuration, behaviour tree, example."""

from __future__ import annotations

import re
import runpy
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import TYPE_CHECKING, Any

import setuptools
import yaml
from demo_recorder import KEPT, TOPICS
from nav2_msgs.action import DockRobot, SmoothPath, UndockRobot
from ros_demo import CLIENT, PACKAGE

if TYPE_CHECKING:
    import pytest

HOWTO = (Path(__file__).parents[2] / "docs" / "howto" / "ros2.md").read_text(encoding="utf-8")
TREE = PACKAGE / "behavior_trees" / "dock_and_undock.xml"
RVIZ = PACKAGE / "rviz" / "docking.rviz"
# Of a costmap of Nav2; `simulated_robot` has only its cells.
OF_NAV2 = {f"/{name}_costmap/costmap{kind}" for name in ("local", "global") for kind in ("", "_updates")}
PORTS = {"error_code_id", "error_msg", "server_name", "server_timeout"}  # of every action node


def page_block(language: str, content: str) -> str:
    """Return the only code block of the page with this content."""
    (found,) = (body for body in re.findall(rf"^```{language}.*\n((?:.*\n)*?)```$", HOWTO, re.M) if content in body)
    return str(found)


def test_snippets_of_the_page_are_the_files_of_the_package() -> None:
    assert page_block("python", "DockRobot") == CLIENT.read_text()
    assert page_block("xml", "SmoothPath") in TREE.read_text()


def test_behaviour_tree_has_ports_of_the_actions_and_names_of_the_parameter_file() -> None:
    nodes = {node.tag: node.attrib for node in ET.parse(TREE).iter()}
    kinds: dict[str, Any] = {"DockRobot": DockRobot, "UndockRobot": UndockRobot}
    for name, kind in kinds.items():
        fields = set(kind.Goal.get_fields_and_field_types()) | set(kind.Result.get_fields_and_field_types())
        assert set(nodes[name]) <= fields | PORTS
    renamed = {"unsmoothed_path", "smoothed_path", "max_smoothing_duration"}
    assert set(nodes["SmoothPath"]) <= set(SmoothPath.Goal.get_fields_and_field_types()) | renamed | PORTS
    parameters = yaml.safe_load(page_block("yaml", "docking_server:"))
    docking, smoothing = (parameters[name]["ros__parameters"] for name in ("docking_server", "smoother_server"))
    assert nodes["DockRobot"]["dock_id"] in docking["docks"]
    assert nodes["UndockRobot"]["dock_type"] in docking["dock_plugins"]
    assert nodes["SmoothPath"]["smoother_id"] in smoothing["smoother_plugins"]


def test_rviz_shows_topics_of_the_demo_with_their_durability() -> None:
    """Every topic of the demo has messages, by its own test."""
    manager = yaml.safe_load(RVIZ.read_text())["Visualization Manager"]
    shown = [value for display in manager["Displays"] for value in display.values() if isinstance(value, dict)]
    assert {one["Value"] for one in shown} - OF_NAV2 <= set(TOPICS)
    latched = {one["Value"] for one in shown if one.get("Durability Policy") == "Transient Local"}
    assert latched - OF_NAV2 == {one["Value"] for one in shown} & set(KEPT)


def test_all_files_are_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    given: dict[str, Any] = {}
    monkeypatch.setattr(setuptools, "setup", lambda **values: given.update(values))
    monkeypatch.chdir(PACKAGE)
    runpy.run_path("setup.py")
    installed = {file for _, files in given["data_files"] for file in files}
    folders = (TREE.parent, RVIZ.parent, CLIENT.parent, PACKAGE / "launch", PACKAGE / "config")
    assert installed >= {str(file.relative_to(PACKAGE)) for folder in folders for file in folder.glob("*.*")}
