"""Experiment 5: the certified plan meets the station straight and softly, the law several times as hard."""

import importlib

import pytest

from optdock.geometry.pose import Pose2
from optdock.problem import DockingProblem
from optdock.simulation.mujoco import MujocoDrive

pytest.importorskip("mujoco", reason="needs the extra sim")
experiment = importlib.import_module("experiments.05_contact_forces")


@pytest.mark.parametrize("station", ["plate", "V"])
def test_a_certified_plan_docks_and_the_law_strikes(station):
    robot, place = experiment.stations()[station]
    world = experiment.WORLDS[experiment.NOISY]
    drive = MujocoDrive(robot, place, actuation=world.actuation)
    problem = DockingProblem(Pose2(-0.7, 0.1, 0.1), place, robot)
    law, smoothed = (
        experiment.dock(drive, problem, world, method, 3)[0] for method in ("graceful law", "smoothed path, tracker")
    )
    assert smoothed.fault == ""
    assert law.peak > 2.0 * smoothed.peak > 0.0
