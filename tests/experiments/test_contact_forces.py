"""Study 5: contact of the certified plan is straight and soft, that of the law several times as hard."""

import importlib

import pytest

from experiments.graceful_law import random_starts
from experiments.mujoco import MujocoDrive
from optdock.geometry.pose import Pose2
from optdock.model.problem import DockingProblem
from tests.docs.snippets import ROOT, measured

pytest.importorskip("mujoco", reason="needs mujoco")
experiment = importlib.import_module("experiments.05_contact_forces")


@pytest.mark.parametrize("station", ["plate", "V"])
def test_certified_plan_docks_softer_than_the_law(station):
    robot, place = experiment.stations()[station]
    world = experiment.WORLDS[experiment.NOISY]
    drive = MujocoDrive(robot, place, actuation=world.actuation)
    problem = DockingProblem(Pose2(-0.7, 0.1, 0.1), place, robot)
    law, smoothed = (
        experiment.dock(drive, problem, world, method, 3)[0] for method in ("graceful law", "smoothed path, tracker")
    )
    assert smoothed.fault == ""
    assert law.peak > 2.0 * smoothed.peak > 0.0


def documented(column):
    """Return the figures of a column of the documented table, by station, world and method."""
    tables = measured.measured_in(ROOT / "docs" / "benchmark.md")
    (rows,) = (one.rows for one in tables if "05_contact_forces.py" in one.command)
    return {tuple(row[:3]): [float(value) for value in row[rows[0].index(column)].split(" / ")] for row in rows[1:]}


@pytest.mark.parametrize("station", ["plate", "V"])
def test_lateral_error_is_within_the_documented_maximum(station):
    """Run one of the starts with the largest lateral error, as a sample of the full run of `make figures`."""
    robot, place = experiment.stations()[station]
    world, method, seed = experiment.WORLDS[experiment.NOISY], "executor", 6
    drive = MujocoDrive(robot, place, actuation=world.actuation)
    problem = DockingProblem(random_starts(100, experiment.STAGING)[seed], place, robot)
    ending, _ = experiment.dock(drive, problem, world, method, seed)
    _, _, largest = documented("across, mm")[station, experiment.NOISY, method]
    assert ending.fault == ""
    assert 1e3 * abs(ending.pose.y) <= 1.1 * largest + 0.05  # as `make figures` compares
