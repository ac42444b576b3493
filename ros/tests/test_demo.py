"""`make ros-demo`: what it prints and writes."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

from demo_recorder import TOPICS

from optdock.ros.bag import open_bag

DEMO = Path(__file__).with_name("ros_demo.py")
PATIENCE = 240.0  # [s] for the whole demo on a busy computer
PNG = b"\x89PNG"


def started(*arguments: object) -> subprocess.Popen[str]:
    """Start the demo."""
    command = [sys.executable, str(DEMO), *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def test_demo_docks_undocks_records_and_draws(tmp_path: Path) -> None:
    demo = started("--out", tmp_path)
    told, faults = demo.communicate(timeout=PATIENCE)
    assert demo.returncode == 0, told + faults
    assert re.findall(r"^(\w+): error code (\d+)", told, re.MULTILINE) == [("dock_robot", "0"), ("undock_robot", "0")]
    errors = re.search(r"docked pose: (\S+) mm along, (\S+) mm across, (\S+) degrees", told)
    assert errors is not None, told
    assert all(abs(float(error)) < 10.0 for error in errors.groups()[:2]), told
    with open_bag(tmp_path / "docking.mcap") as bag:
        assert [topic for topic in TOPICS if bag.last(topic, 0.0, bag.end) is None] == []
    for name in ("plan.png", "drive.png"):
        assert (tmp_path / name).read_bytes().startswith(PNG)
