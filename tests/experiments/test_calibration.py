"""Calibration study: constant hidden properties, true values of the plant, tables."""

import dataclasses

import numpy as np
import pytest

from experiments.calibration import truths as module
from experiments.calibration.robots import hidden_robot, set_down
from experiments.calibration.study import QuantityResult
from experiments.calibration.tables import coverage_table, tube_table
from experiments.calibration.truths import truths
from optdock.calibration import calibrate
from tests.optdock.calibration.conftest import drive


@pytest.fixture(autouse=True)
def few_cycles(monkeypatch):
    monkeypatch.setattr(module, "_CYCLES", 2000)
    monkeypatch.setattr(module, "_MESSAGES", 2000)


def with_drive(hidden, **changes):
    return hidden._replace(world=dataclasses.replace(hidden.world, **changes))


def test_only_start_and_noise_differ_between_runs():
    hidden = hidden_robot(3)
    (first, robot), (second, other) = (set_down(hidden, run) for run in (0, 1))
    assert robot.drive.radii == other.drive.radii == hidden.radii
    assert robot.drive.dead_bands == other.drive.dead_bands
    assert first.true_dock == second.true_dock
    assert first.problem.start != second.problem.start
    assert set_down(hidden, 0)[0].problem.start == first.problem.start
    assert hidden_robot(4).radii != hidden.radii


def test_mean_latency_of_constant_latency():
    hidden = hidden_robot(0)
    even = dataclasses.replace(hidden.world.drive, latency=(0.05, 0.05), command_loss=0.0)
    stamped = 0.5 * hidden.world.odometry.stamp_jitter
    assert truths(with_drive(hidden, drive=even), 50.0)["command latency, linear"] == pytest.approx(
        0.05 + stamped, abs=1e-3
    )
    # Commands wait for late predecessors, so a spread of the latency increases the mean.
    spread = dataclasses.replace(even, latency=(0.0, 0.1))
    assert truths(with_drive(hidden, drive=spread), 50.0)["command latency, linear"] > 0.06


def test_scales_without_slip_are_those_of_the_wheels():
    hidden = hidden_robot(0)
    known = truths(with_drive(hidden, drive=dataclasses.replace(hidden.world.drive, slip_rate=1e-9)), 50.0)
    assert known["left wheel's radius outside the plausible range"] == pytest.approx(hidden.radii[0] / 0.1 - 1.0)
    assert known["scale of the distance"] == pytest.approx(np.mean(hidden.radii) / 0.1 - 1.0)
    assert known["track width outside the plausible range"] == pytest.approx(hidden.track_width / 0.4 - 1.0)


def test_every_truth_belongs_to_a_quantity():
    named = {one.name for one in calibrate([drive(seed=4, duration=5.0)]).quantities}
    assert set(truths(hidden_robot(0), 50.0)) <= named


def test_tables_count():
    rows = [
        QuantityResult(0, "a", 1.0, 1.1, 0.9, 1.3, ""),
        QuantityResult(1, "a", 1.0, 1.4, 1.2, 1.6, ""),
        QuantityResult(2, "a", 1.0, np.nan, np.nan, np.nan, "never turned"),
    ]
    text = coverage_table(rows)
    assert "1/2" in text
    assert "all" in text.splitlines()[-1]
    assert "50.0 %" in text.splitlines()[-1]
    tubes = tube_table([[(0.01, 0.01)] * 10, [(0.005, 0.005)] * 4], [(0.01, 0.01)] * 2 + [(0.02, 0.01)], 0.4)
    assert "2/3 = 66.7 %" in tubes
    assert "4/4 = 100.0 %" in tubes
    assert "14 dockings are too few" in tubes
    assert "10 dockings are too few" in tubes
