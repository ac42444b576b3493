"""Experiment 2: final docking accuracy of certified plans, compared with Nav2's docking control law.

The same random starts around the staging pose, 0.7 m before the dock, are driven twice: by the graceful law as in
Nav2's docking server (target 0.25 m behind the dock, stop within 5 cm of it, Nav2's default parameters), and by a
certified plan with the TrackingController until the DockGoalChecker reports success. Both run in a perfect world, and
with lag, latency and measurement noise. Starts without a plan count as failures. Writes results/02_docking_accuracy/.

    python experiments/02_docking_accuracy.py [--starts N]
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import NamedTuple

import numpy as np

from experiments.graceful_law import NAV2_LAW, egocentric, random_starts
from optdock.errors import OptdockError
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.io.atomic_file import write_text
from optdock.model.dock import Dock, DockDirection
from optdock.model.limits import MotionLimits
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.planning.pipeline import plan_dock
from optdock.plugins.interfaces import Controller, GoalChecker
from optdock.plugins.registry import create_plugin
from optdock.reports.report import table
from optdock.simulation import (
    Actuation,
    PoseSensor,
    Sensors,
    SimulatedRobot,
    SimulationSettings,
    plant_of,
    run_closed_loop,
)

OUT = Path("results") / Path(__file__).stem
GOAL = Pose2(0.0, 0.0, 0.0)
STAGING = 0.7  # [m]
PROJECTION, ACCEPTED = 0.25, 0.05  # [m]
LIMITS = MotionLimits(
    max_speed=0.25, max_reverse_speed=0.25, max_acceleration=0.5, max_deceleration=0.5, max_yaw_rate=0.75,
    max_curvature=3.0, max_curvature_rate=30.0,
)  # fmt: skip
ROBOT = Robot(Footprint.rectangle(0.3, 0.3, 0.5), LIMITS)
DOCK = Dock(GOAL, direction=DockDirection.FORWARD, approach_speed=0.1, approach_distance=0.1)
WORLDS = {
    "perfect": SimulationSettings(),
    "lag, latency, noise": SimulationSettings(
        actuation=Actuation(linear_lag=0.06, angular_lag=0.06, latency=0.04), position_noise=0.002, yaw_noise=0.0017
    ),
}


class Ending(NamedTuple):
    """Result of one docking: |lateral| [m], |yaw| [rad], maximum commanded curvature [1/m], duration [s]."""

    lateral: float
    yaw: float
    curvature: float
    duration: float


def by_law(start: Pose2, world: SimulationSettings) -> Ending:
    """Run the loop of the docking server: the law towards the projected dock until within 5 cm of the dock."""
    sensors = Sensors(PoseSensor(world.position_noise, world.yaw_noise))
    robot, curvatures = SimulatedRobot(plant_of(ROBOT, world.actuation), start, GOAL, sensors, seed=world.seed), []
    target = GOAL @ Pose2(PROJECTION, 0.0, 0.0)
    while len(curvatures) < 3000:
        measured = robot.measurements.pose
        assert measured is not None
        if measured.distance_to(GOAL) < ACCEPTED:
            break
        curvatures.append(abs(NAV2_LAW.curvature(egocentric(target, measured))))
        robot.advance(NAV2_LAW.command(target, measured), world.period)
    return Ending(abs(robot.error.y), abs(robot.error.yaw), max(curvatures), robot.time)


def by_plan(start: Pose2, world: SimulationSettings) -> Ending | None:
    """Track a certified plan; None if there is no plan or the run does not dock."""
    try:
        plan = plan_dock(DockingProblem(start, DOCK, ROBOT), time_budget=1.0)
    except OptdockError:
        return None
    run = run_closed_loop(
        plan.trajectory,
        ROBOT,
        GOAL,
        create_plugin(Controller, "TrackingController"),
        create_plugin(GoalChecker, "DockGoalChecker", {"along_tolerance": 0.01}),
        world,
    )
    if not run.docked:
        return None
    return Ending(abs(run.final_error.y), abs(run.final_error.yaw), plan.certificate.max_curvature, run.duration)


def row(world: str, method: str, endings: list[Ending | None]) -> list[str]:
    """Return one row of the table."""
    done = np.array([ending for ending in endings if ending is not None])

    def spread(values: np.ndarray, digits: int) -> str:
        return " / ".join(f"{value:.{digits}f}" for value in (*np.percentile(values, [50, 95]), values.max()))

    columns = (spread(1e3 * done[:, 0], 1), spread(np.degrees(done[:, 1]), 2), spread(done[:, 2], 1))
    return [world, method, f"{len(done)}/{len(endings)}", *columns, spread(done[:, 3], 1)]


def main() -> None:
    """Run all dockings; print and write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--starts", type=int, default=100, help="number of starts (default: %(default)s)")
    poses = random_starts(parser.parse_args().starts, STAGING)
    rows = []
    for name, world in WORLDS.items():
        rows.append(row(name, "graceful law", [by_law(pose, world) for pose in poses]))
        rows.append(row(name, "certified plan", [by_plan(pose, world) for pose in poses]))
    head = ["world", "method", "docked", "|lateral| mm", "|yaw| deg", "curvature 1/m", "time s"]
    text = table([head, *rows])
    OUT.mkdir(parents=True, exist_ok=True)
    write_text(OUT / "accuracy.md", text + "\n")
    print(f"p50 / p95 / max of {len(poses)} starts\n\n{text}")


if __name__ == "__main__":
    main()
