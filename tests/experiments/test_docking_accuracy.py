"""Experiment 2: certified plans end closer to the dock than the graceful law."""

import importlib
import re
import sys


def test_certified_plan_ends_closer_than_the_law(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["02_docking_accuracy", "--starts", "2"])
    importlib.import_module("experiments.02_docking_accuracy").main()
    written = (tmp_path / "results" / "02_docking_accuracy" / "accuracy.md").read_text()
    assert written.strip() in capsys.readouterr().out
    rows = [re.split(r"\s{2,}", line) for line in written.splitlines()[1:]]
    assert [row[2] for row in rows] == ["2/2"] * 4
    medians = {(row[0], row[1]): tuple(float(cell.split(" / ")[0]) for cell in row[3:5]) for row in rows}
    for world in ("perfect", "lag, latency, noise"):
        law, plan = medians[world, "graceful law"], medians[world, "certified plan"]
        assert plan[0] < 0.5 * law[0]
        assert plan[1] < 0.2 * law[1]
