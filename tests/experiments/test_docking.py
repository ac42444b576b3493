"""Docking study: measurements, and docking at a pushed dock by the executor and by the law."""

import math

import numpy as np
import pytest

from experiments.docking import outcome, tables
from experiments.docking.cases import SPREADS
from experiments.docking.faults import run_fault
from experiments.docking.methods import executed
from experiments.docking.outcome import FollowedPlan
from experiments.docking.run import Task, driven
from experiments.docking.worlds import WORLDS, case_of
from optdock.verification import pose_clearances


@pytest.fixture(scope="module")
def found():
    return [driven(Task(method, "pushed", "nav2", 50.0, 2, 1)) for method in ("graceful law", "executor")]


def test_executor_docks_at_a_pushed_dock_and_the_law_does_not(found):
    law, ours = found
    assert ours.succeeded
    assert not law.succeeded
    assert abs(ours.cross) < 0.006
    assert abs(ours.yaw) < math.radians(0.8)
    assert ours.over <= 1.0 + 1e-6
    assert ours.short <= tables.FORGIVEN
    assert ours.replans > 0


def test_table_has_a_row_per_method(found, tmp_path):
    lines = tables.table_of(found).splitlines()
    assert [next(cell for cell in line.split() if "/1" in cell) for line in lines[1:]] == ["0/1", "1/1"]
    tables.draw_distributions(tmp_path / "cdf.png", found)
    assert (tmp_path / "cdf.png").stat().st_size > 10_000


def test_shortfall_counts_only_within_the_tube():
    world = WORLDS["perfect"]
    case = case_of(0, SPREADS["nav2"], world)
    run = executed(case, world, 50.0)
    record = run.robot.record()
    clearances, _ = pose_clearances(record.poses, case.problem.robot.footprint, case.problem.obstacles, within=1.0)
    short, displacement, _ = outcome._tube(record, run.planning.followed, clearances)
    assert short < -0.05
    assert displacement < 1e-3
    short, _, _ = outcome._tube(record, run.planning.followed, np.full(clearances.shape, 0.03))
    assert short == pytest.approx(0.02, abs=1e-3)
    elsewhere = [FollowedPlan(since, plan) for since, plan in run.planning.followed]
    aside = record.poses + np.array([0.0, 0.0, 0.2])
    beside = type(record)(**{**vars(record), "poses": aside})
    short, displacement, left = outcome._tube(beside, elsewhere, np.full(clearances.shape, 0.03))
    assert short == -math.inf
    assert displacement > 0.05
    assert left == 1


def test_run_with_a_fault():
    found = run_fault("cancel while approaching", 0, "detected")
    assert found.outcome.ending == "cancelled"
    assert found.struck
    assert found.at_rest
    assert found.outcome.clearance > 0.0
