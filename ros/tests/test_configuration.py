"""The servers start with the package's complete parameter file, and with Nav2's unchanged files."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
import yaml
from harness import Client, Lifecycle, Processes
from launch_stand_in import PACKAGE
from rcl_interfaces.srv import ListParameters

if TYPE_CHECKING:
    from collections.abc import Callable

OURS = PACKAGE / "config" / "optdock.yaml"
ROOT = Path(__file__).resolve().parents[2]
STOCK = Path(os.environ.get("OPTDOCK_DATA", ROOT.parent / "shared" / "data")) / "nav2" / "params"
SHARED = ("use_sim_time", "start_type_description_service", "qos_overrides")


def names_in(block: dict[str, object], prefix: str = "") -> set[str]:
    """Return the dotted names of a parameter file."""
    found: set[str] = set()
    for name, value in block.items():
        found |= names_in(value, f"{prefix}{name}.") if isinstance(value, dict) else {f"{prefix}{name}"}
    return found


@pytest.mark.parametrize("server", ["smoother_server", "docking_server"])
def test_package_file_starts_the_servers_and_names_every_parameter(
    process: Processes, client_node: Client, lifecycle: Callable[[str], Lifecycle], server: str
) -> None:
    started = process(server, params=OURS)
    life = lifecycle(server)
    assert life.configure(), started.log()
    listed = client_node.call(ListParameters, f"/{server}/list_parameters").result.names
    block = yaml.safe_load(OURS.read_text())[server]["ros__parameters"]
    known = {name for name in listed if name.partition(".")[0] not in SHARED}
    of_short_blocks = ("simple_non_charging_dock.", "tracker.", "goal_checker.", "executor.", "robot.", "map.")
    assert sorted(name for name in known - names_in(block) if not name.startswith(of_short_blocks)) == []
    assert life.activate()
    assert life.shutdown()
    assert started.stop() == 0
    assert "not read" not in started.log()
    # One that ends without a word is taken for alive for 20 s, and its successor's clients talk to it.
    client_node.until(lambda: server not in client_node.get_node_names(), 5.0, "the end of the node")


def stock(name: str) -> Path:
    """Return one of Nav2's files, which are not part of the project."""
    file = STOCK / name
    if not file.is_file():
        pytest.skip(f"Nav2's own {name} is not at {file} (set OPTDOCK_DATA)")
    return file


@pytest.mark.parametrize(
    ("server", "file"),
    [
        ("smoother_server", "nav2_params.yaml"),
        ("docking_server", "nav2_params.yaml"),
        ("docking_server", "docking_params.yaml"),
    ],
)
def test_stock_files_of_nav2_start_the_servers(
    process: Processes, lifecycle: Callable[[str], Lifecycle], server: str, file: str
) -> None:
    started = process(server, params=stock(file))
    life = lifecycle(server)
    assert life.configure(), started.log()
    assert life.activate(), started.log()
    assert life.state == "active"
    assert life.deactivate()
    assert life.cleanup()
    assert started.stop() == 0
