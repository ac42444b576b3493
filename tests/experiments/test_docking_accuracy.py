"""Experiment 2 runs, and its certified plans end more exactly than the graceful law."""

import os
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def test_the_certified_plan_ends_more_exactly_than_the_law(tmp_path):
    script = ROOT / "experiments" / "02_docking_accuracy.py"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join((str(ROOT), os.environ.get("PYTHONPATH", "")))}
    done = subprocess.run(
        [sys.executable, script, "--starts", "4"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        env=environment,
    )
    assert done.returncode == 0, done.stderr
    written = (tmp_path / "results" / script.stem / "accuracy.md").read_text()
    assert written.strip() in done.stdout
    rows = [re.split(r"\s{2,}", line) for line in written.splitlines()[1:]]
    assert [row[2] for row in rows] == ["4/4"] * 4
    medians = {(row[0], row[1]): tuple(float(cell.split(" / ")[0]) for cell in row[3:5]) for row in rows}
    for world in ("perfect", "lag, latency, noise"):
        law, plan = medians[world, "graceful law"], medians[world, "certified plan"]
        assert plan[0] < 0.5 * law[0]
        assert plan[1] < 0.2 * law[1]
