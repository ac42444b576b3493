"""The table of Nav2's parameters is complete, by distribution, and the command prints it for a file."""

import csv

import pytest
from typer.testing import CliRunner

from optdock.cli import app
from optdock.nav2 import declared_parameters
from optdock.nav2.controller_settings import controller_settings
from optdock.nav2.declared_parameters import DECLARED, DISTRIBUTIONS, Block, Use, found
from optdock.nav2.parameter_report import nav2_parameter_rows
from optdock.nav2.params import load_nav2_params

# Files of Nav2 that declare the parameters of each block.
FILES = {
    ("opennav_docking", "utils.hpp"): Block.DOCK,
    ("opennav_docking", "controller.cpp"): Block.CONTROLLER,
    **{
        ("opennav_docking", file): Block.DOCKING
        for file in ("dock_database.cpp", "docking_server.cpp", "navigator.cpp", "parameter_handler.cpp")
    },
    **{
        ("opennav_docking", file): Block.DOCK_TYPE
        for file in ("simple_charging_dock.cpp", "simple_non_charging_dock.cpp")
    },
    ("nav2_smoother", "nav2_smoother.cpp"): Block.SMOOTHING,
    ("nav2_smoother", "simple_smoother.cpp"): Block.SMOOTHER,
    ("nav2_smoother", "savitzky_golay_smoother.cpp"): Block.SMOOTHER,
    ("nav2_util", "lifecycle_node.cpp"): Block.ANY_NODE,
    **{
        ("nav2_ros_common", file): Block.ANY_NODE
        for file in ("interface_factories.hpp", "lifecycle_node.hpp", "node_utils.hpp")
    },
}
OF_OTHER_NODES = {("nav2_util", "base_footprint_publisher.hpp"), "nav2_planner"}
# Declared by rclcpp, by other packages, or in a form that the list does not have.
NOT_LISTED = {
    *((Block.ANY_NODE, name) for name in ("use_sim_time", "start_type_description_service", "qos_overrides")),
    (Block.DOCKING, "enable_stamped_cmd_vel"),
    *((Block.DOCKING, name) for name in ("docks", "dock_plugins")),
    (Block.DOCK, "pose"),
    (Block.DOCK_TYPE, "plugin"),
}


def declared_in(rows):
    """Return block, name and distribution of the rows of a list of declarations."""
    names = set()
    for row in rows:
        if row["package"] in OF_OTHER_NODES or (row["package"], row["file"]) in OF_OTHER_NODES:
            continue
        block, name = FILES[row["package"], row["file"]], row["parameter"].removeprefix("controller.")
        block = Block.DOCK_TYPE if (block, name) == (Block.ANY_NODE, "plugin") else block
        block = Block.SMOOTHER if (block, name) == (Block.SMOOTHING, "plugin") else block
        names.add((block, name, row["distribution"]))
    return names


def in_table():
    return {(*key, distribution) for key, row in DECLARED.items() for distribution in row.distributions}


@pytest.fixture
def listed(real_data):
    """Declarations in the code of four distributions; `OPTDOCK_DATA` is their folder."""
    with (real_data / "nav2" / "interfaces" / "declared_parameters.csv").open(encoding="utf-8") as file:
        return declared_in(csv.DictReader(file))


def test_every_declared_parameter_of_every_distribution_is_in_the_table(listed):
    assert {distribution for _, _, distribution in listed} == set(DISTRIBUTIONS)
    assert len(listed) > 200
    assert listed - in_table() == set()
    assert {one for one in in_table() - listed if one[:2] not in NOT_LISTED} == set()


@pytest.mark.parametrize("key", [(Block.CONTROLLER, "deceleration_max"), (Block.DOCKING, "odom_topic")])
def test_a_missing_row_is_found(listed, monkeypatch, key):
    monkeypatch.delitem(declared_parameters.DECLARED, key)
    assert {one[:2] for one in listed - in_table()} == {key}


def test_every_row_has_a_reason_or_a_target():
    assert len(DECLARED) > 85
    for row in DECLARED.values():
        assert row.words or row.use is Use.READ, row
        assert row.distributions in (*(DISTRIBUTIONS[n:] for n in range(3)), ("jazzy",), ()), row


def test_a_parameter_of_every_node_is_found_in_the_block_of_a_server():
    assert found(Block.SMOOTHING, "introspection_mode").use is Use.NO_EFFECT
    assert found(Block.CONTROLLER, "introspection_mode") is None


FILE = """
docking_server:
  ros__parameters:
    max_retries: 3
    stage_by_executor: true
    use_realtime_priority: true
    autostart_node: true
    rotate_to_dock_timeout: 10.0
    max_retrys: 3
    dock_plugins: [bay, own]
    bay:
      plugin: opennav_docking/SimpleChargingDock
      staging_x_offset: -0.9
      filter_coef: 0.2
      backward_blind: true
    own: {plugin: "mine::Dock", reach: 1.0}
    docks: [home]
    home: {type: bay, pose: [0.0, 0.0, 0.0], colour: red}
    controller: {v_linear_min: 0.16, v_linear_max: 0.2, k_phi: 1, deceleration_max: 0.3, dock_collision_threshold: 0.6}
smoother_server:
  ros__parameters:
    smoother_plugins: [simple]
    simple: {plugin: "nav2_smoother::SimpleSmoother", tolerance: 0.001}
    costmap_timeout: 1.0
controller_server:
  ros__parameters: {controller_frequency: 20.0}
"""


def test_the_command_prints_what_a_file_means(tmp_path):
    (tmp_path / "p.yaml").write_text(FILE)
    rows = nav2_parameter_rows(load_nav2_params(tmp_path / "p.yaml"))
    told = {words.split(":")[0]: (node, use, words.partition(": ")[2]) for node, use, words in rows}
    read = [words for _, use, words in rows if use == "read"]
    assert read[0].split(", ") == [
        "max_retries", "dock_plugins", "docks", "controller.v_linear_max", "bay.plugin", "bay.staging_x_offset",
        "home.type", "home.pose",
    ]  # fmt: skip
    assert read[1] == "smoother_plugins"
    assert [words for _, use, words in rows if use == "of optdock"] == [
        "stage_by_executor, use_realtime_priority",
        "costmap_timeout",
    ]
    assert told["autostart_node"] == ("docking_server", "mapped", "autostart")
    assert told["max_retrys"][1:] == ("not in Nav2", "did you mean max_retries?")
    assert told["home.colour"][1] == "not in Nav2"
    assert told["controller.k_phi"][1] == told["bay.filter_coef"][1] == told["rotate_to_dock_timeout"][1] == "no effect"
    assert told["bay.backward_blind"][1] == told["controller.dock_collision_threshold"][1] == "refused"
    assert told["controller.v_linear_min"][1:] == (
        "mapped",
        "tracker.min_speed is 0.16 m/s; dock.approach_speed, executor.contact_speed and executor.back_out_speed are "
        "not less, unless set",
    )
    assert told["controller.deceleration_max"][1:] == (
        "mapped",
        "robot.limits.max_deceleration is at most 0.3 m/s^2, unless it is set",
    )
    assert {node for node, _, _ in rows} == {"docking_server", "smoother_server"}
    printed = CliRunner().invoke(app, ["plugins", "--nav2-params", str(tmp_path / "p.yaml")]).stdout
    for node, use, words in rows:
        assert any(line.startswith(node) and use in line and words in line for line in printed.splitlines()), words


def test_values_that_are_no_numbers_have_no_meaning():
    assert controller_settings({"controller": {"v_linear_min": "slow", "deceleration_max": float("nan")}}) == {}
    assert controller_settings({"controller": 1.0}) == {}
