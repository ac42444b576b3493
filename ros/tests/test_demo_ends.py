"""How `make ros-demo` ends after a failure and after an interrupt."""

from __future__ import annotations

import signal
from pathlib import Path

import yaml
from ros_demo import PACKAGE
from test_demo import PATIENCE, started


def test_demo_that_fails_shows_the_logs(tmp_path: Path) -> None:
    values = yaml.safe_load((PACKAGE / "config" / "simulated_docking.yaml").read_text())
    values["docking_server"]["ros__parameters"]["docks"] = []
    (tmp_path / "no_docks.yaml").write_text(yaml.safe_dump(values))
    demo = started("--out", tmp_path, "--params", tmp_path / "no_docks.yaml")
    told, faults = demo.communicate(timeout=PATIENCE)
    assert demo.returncode == 1, told + faults
    assert "dock_robot: error code 901" in told
    assert "--- log of docking_server\n" in faults
    assert "failed (901)" in faults


def test_demo_ends_by_an_interrupt(tmp_path: Path) -> None:
    demo = started("--out", tmp_path)
    assert demo.stdout is not None
    assert "active in ROS domain" in demo.stdout.readline()
    demo.send_signal(signal.SIGINT)
    told, faults = demo.communicate(timeout=PATIENCE)
    assert (demo.returncode, faults) == (130, "interrupted; the processes have ended\n"), told
