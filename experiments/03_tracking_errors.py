"""Experiment 3: tracking errors and commands of the TrackingController on four drives in eleven worlds.

Every drive runs from rest to rest until the DockGoalChecker (5 mm, 10 mm, 0.02 rad, at rest) reports docked; noisy
worlds run with several seeds, of which the worst counts. Errors on the way are relative to the trajectory delayed by
the drive's response, which is the delay of the reference. Commands are differentiated per period; 1 is the robot's
limit. Writes results/03_tracking_errors/.

    python experiments/03_tracking_errors.py [--seeds N]
"""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.io.atomic_file import write_text
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.path import Direction
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.plugins.interfaces import Controller, GoalChecker, PluginContext
from optdock.plugins.registry import create_plugin
from optdock.reports.report import table
from optdock.simulation import Actuation, SimulationSettings, pose_errors, run_closed_loop
from optdock.testing.drives import cusp_drive, s_curve_drive, straight_drive

if TYPE_CHECKING:
    from optdock.model.trajectory import Trajectory
    from optdock.simulation import Run

OUT = Path("results") / Path(__file__).stem
START = Pose2(0.0, 0.0, 0.3)
DRIVES = {
    "straight": straight_drive(START),
    "S-curve": s_curve_drive(START),
    "reverse S-curve": s_curve_drive(START, Direction.REVERSE),
    "cusp": cusp_drive(START),
}
LIMITS = MotionLimits(max_speed=0.5, max_reverse_speed=0.5)
ROBOT = Robot(Footprint.rectangle(0.4, 0.3, 0.5), LIMITS)
CHECKER = {"along_tolerance": 0.005, "cross_tolerance": 0.01, "yaw_goal_tolerance": 0.02}
SLUGGISH = Actuation(linear_lag=0.1, angular_lag=0.1, latency=0.05)
DEAD = replace(SLUGGISH, linear_dead_band=0.03, angular_dead_band=0.05)


class World(NamedTuple):
    """Name, actuation, localization noise, `preview` of the controller (None: identified) and rate [Hz]."""

    name: str
    actuation: Actuation
    noise: bool
    preview: float | None
    rate: float = 50.0


WORLDS = (
    World("perfect", Actuation(), noise=False, preview=None),
    World("noise", Actuation(), noise=True, preview=None),
    World("lag, ignored", SLUGGISH, noise=False, preview=0.0),
    World("lag, identified", SLUGGISH, noise=False, preview=None),
    World("lag, known", SLUGGISH, noise=False, preview=0.15),
    World("lag and noise, identified", SLUGGISH, noise=True, preview=None),
    World("perfect, 20 Hz", Actuation(), noise=False, preview=None, rate=20.0),
    World("lag and noise, 20 Hz", SLUGGISH, noise=True, preview=None, rate=20.0),
    World("lag and noise, 100 Hz", SLUGGISH, noise=True, preview=None, rate=100.0),
    World("dead band", DEAD, noise=False, preview=None),
    World("dead band and noise, 20 Hz", DEAD, noise=True, preview=None, rate=20.0),
)


def runs(drive: Trajectory, world: World, seeds: int) -> list[Run]:
    """The drive in the world, once per seed."""
    found = []
    for seed in range(seeds if world.noise else 1):
        settings = SimulationSettings(
            period=1.0 / world.rate,
            actuation=world.actuation,
            position_noise=0.002 if world.noise else 0.0,
            yaw_noise=0.003 if world.noise else 0.0,
            seed=seed,
        )
        controller = create_plugin(Controller, "TrackingController", {"preview": world.preview})
        controller.configure(PluginContext(problem=DockingProblem(START, Dock(drive.path.end), ROBOT)))
        checker = create_plugin(GoalChecker, "DockGoalChecker", CHECKER)
        found.append(run_closed_loop(drive, ROBOT, drive.path.end, controller, checker, settings))
    return found


def overshoot(drive: Trajectory, run: Run) -> float:
    """How far the robot went beyond the goal in the last two seconds [m]."""
    gear = int(drive.path.segments[-1].direction)
    poses = run.poses[run.times >= run.duration - 2.0]
    return float(np.max(gear * pose_errors(poses, np.tile(run.goal.as_array(), (len(poses), 1)))[:, 0]))


def on_the_way(drive: Trajectory, run: Run, delay: float) -> np.ndarray:
    """Largest errors along, across and in yaw against the trajectory that is `delay` seconds late."""
    then = drive.sample_at(run.times - delay)
    errors = pose_errors(run.poses, np.column_stack((then.x, then.y, then.yaw)))
    largest: np.ndarray = np.abs(errors).max(axis=0)
    return largest


def exertion(run: Run, rate: float) -> tuple[float, float]:
    """Largest acceleration and jerk of the commands, in units of their limits."""
    acceleration = np.diff(run.commands[:-1, 0], prepend=0.0) * rate
    jerk = np.diff(acceleration, prepend=0.0) * rate
    most = max(LIMITS.max_acceleration, LIMITS.max_deceleration)
    return float(np.abs(acceleration).max()) / most, float(np.abs(jerk).max()) / LIMITS.max_jerk


def row(name: str, drive: Trajectory, world: World, seeds: int) -> list[str]:
    """The worst of every number over the seeds."""
    found = runs(drive, world, seeds)
    final = np.max([np.abs(run.final_error.as_array()) for run in found], axis=0)
    delay = 0.0 if world.preview == 0.0 else world.actuation.linear_lag + world.actuation.latency
    tracking = np.max([on_the_way(drive, run, delay) for run in found], axis=0)
    acceleration, jerk = np.max([exertion(run, world.rate) for run in found], axis=0)
    beyond = max(0.0, *(overshoot(drive, run) for run in found))
    return [
        name,
        world.name,
        f"{sum(run.docked for run in found)}/{len(found)}",
        f"{1e3 * final[0]:.1f} / {1e3 * final[1]:.1f} / {math.degrees(final[2]):.2f}",
        f"{1e3 * tracking[0]:.1f} / {1e3 * tracking[1]:.1f} / {math.degrees(tracking[2]):.2f}",
        f"{1e3 * beyond:.1f}",
        f"{max(run.duration for run in found) - drive.duration:+.2f}",
        f"{acceleration:.2f} / {jerk:.2f}",
    ]


def main() -> None:
    """Drive everything; print and write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=10, help="runs in every noisy world (default: %(default)s)")
    seeds = parser.parse_args().seeds
    head = [
        "drive",
        "world",
        "docked",
        "end mm/mm/deg",
        "on the way mm/mm/deg",
        "beyond mm",
        "time s",
        "acceleration / jerk",
    ]
    text = table([head, *(row(name, drive, world, seeds) for name, drive in DRIVES.items() for world in WORLDS)])
    OUT.mkdir(parents=True, exist_ok=True)
    write_text(OUT / "tracking.md", text + "\n")
    print(f"errors along / across / yaw, the worst of {seeds} seeds\n\n{text}")


if __name__ == "__main__":
    main()
