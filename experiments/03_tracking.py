"""Study 3: errors of the TrackingController at the end and on the way, over the quality of drive and localization.

Four drives run from rest to rest in eleven worlds, until the DockGoalChecker (5 mm, 10 mm, 0.02 rad, at rest) reports
docked; every noisy world has its own seed for every run. Errors on the way are relative to the trajectory delayed by
the drive's response, which is the delay of the reference. Commands are differentiated per period; 1 is the robot's
limit.

    python experiments/03_tracking.py [--scale S] [--jobs N]
"""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from experiments.study_run import Report, median_interval, run, scaled, share_text
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.path import Direction
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.plotting.canvas import COLOURS
from optdock.plugins.interfaces import Controller, GoalChecker, PluginContext
from optdock.plugins.registry import create_plugin
from optdock.reports.report import table
from optdock.simulation import Actuation, SimulationSettings, pose_errors, run_closed_loop
from optdock.testing.drives import cusp_drive, s_curve_drive, straight_drive

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from matplotlib.figure import Figure

    from optdock.model.trajectory import Trajectory
    from optdock.simulation import Run

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
SIZE = (9.5, 4.2)


class World(NamedTuple):
    """Actuation, localization noise, `preview` of the controller (None: identified) and rate [Hz]."""

    actuation: Actuation
    noise: bool
    preview: float | None
    rate: float = 50.0

    @property
    def delay(self) -> float:
        """Delay of the reference [s]."""
        return 0.0 if self.preview == 0.0 else self.actuation.linear_lag + self.actuation.latency


WORLDS = {
    "perfect": World(Actuation(), noise=False, preview=None),
    "noise": World(Actuation(), noise=True, preview=None),
    "lag, ignored": World(SLUGGISH, noise=False, preview=0.0),
    "lag, identified": World(SLUGGISH, noise=False, preview=None),
    "lag, known": World(SLUGGISH, noise=False, preview=0.15),
    "lag and noise, identified": World(SLUGGISH, noise=True, preview=None),
    "perfect, 20 Hz": World(Actuation(), noise=False, preview=None, rate=20.0),
    "lag and noise, 20 Hz": World(SLUGGISH, noise=True, preview=None, rate=20.0),
    "lag and noise, 100 Hz": World(SLUGGISH, noise=True, preview=None, rate=100.0),
    "dead band": World(DEAD, noise=False, preview=None),
    "dead band and noise, 20 Hz": World(DEAD, noise=True, preview=None, rate=20.0),
}


class Task(NamedTuple):
    """A drive in a world, and the number of runs."""

    world: str
    drive: str
    runs: int


class Row(NamedTuple):
    """Result of one run: errors at the end and the largest on the way [mm], [degrees], and the rest."""

    world: str
    drive: str
    seed: int
    is_docked: bool
    along: float
    cross: float
    yaw: float
    way_along: float
    way_cross: float
    way_yaw: float
    beyond: float  # [mm] beyond the goal in the last two seconds
    late: float  # [s] after the end of the trajectory
    acceleration: float  # of the commands, in units of the limit
    jerk: float


def tasks(scale: float) -> list[Task]:
    """Return every drive in every world; worlds without noise need one run."""
    runs = scaled(scale, 10, 2)
    return [Task(world, drive, runs if WORLDS[world].noise else 1) for world in WORLDS for drive in DRIVES]


def work(task: Task) -> Iterator[Row]:
    """Drive once per seed."""
    world, name, runs = task
    for seed in range(runs):
        yield row_of(world, name, seed, driven(DRIVES[name], WORLDS[world], seed))


def driven(drive: Trajectory, world: World, seed: int) -> Run:
    """Return one run."""
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
    return run_closed_loop(drive, ROBOT, drive.path.end, controller, checker, settings)


def row_of(world: str, name: str, seed: int, run: Run) -> Row:
    """Return the figures of a run."""
    drive, settings = DRIVES[name], WORLDS[world]
    then = drive.sample_at(run.times - settings.delay)
    way = np.abs(pose_errors(run.poses, np.column_stack((then.x, then.y, then.yaw)))).max(axis=0)
    end = np.abs(run.final_error.as_array())
    gear = int(drive.path.segments[-1].direction)
    last = run.poses[run.times >= run.duration - 2.0]
    beyond = np.max(gear * pose_errors(last, np.tile(run.goal.as_array(), (len(last), 1)))[:, 0])
    acceleration = np.diff(run.commands[:-1, 0], prepend=0.0) * settings.rate
    jerk = np.diff(acceleration, prepend=0.0) * settings.rate
    most = max(LIMITS.max_acceleration, LIMITS.max_deceleration)
    numbers = (*_readable(end), *_readable(way), 1e3 * max(0.0, float(beyond)), run.duration - drive.duration)
    exerted = float(np.abs(acceleration).max()) / most, float(np.abs(jerk).max()) / LIMITS.max_jerk
    return Row(world, name, seed, run.docked, *numbers, *exerted)


def _readable(error: np.ndarray) -> tuple[float, float, float]:
    return 1e3 * float(error[0]), 1e3 * float(error[1]), math.degrees(float(error[2]))


def report(rows: Sequence[Row]) -> Report:
    """Return one line per world, with medians over drives and seeds and the worst."""
    lines = [
        (
            "world",
            "docked",
            "end across mm, median",
            "worst",
            "end yaw deg, worst",
            "way across mm, worst",
            "beyond mm",
            "jerk / limit",
        )
    ]
    worst = dict.fromkeys(WORLDS, math.nan)
    for world in dict.fromkeys(row.world for row in rows):
        group = [row for row in rows if row.world == world]
        middle, low, high = median_interval([row.cross for row in group])
        most = [max(getattr(row, name) for row in group) for name in ("cross", "yaw", "way_cross", "beyond", "jerk")]
        worst[world] = most[0]
        share = share_text(sum(row.is_docked for row in group), len(group))
        lines.append((world, share, f"{middle:.2f} ({low:.2f} to {high:.2f})", *(f"{value:.2f}" for value in most)))
    name = max(worst, key=lambda world: worst[world])
    docked = share_text(sum(row.is_docked for row in rows), len(rows))
    closing = (
        f"{docked} runs dock; the error across at the end is at most {worst['lag, known']:.1f} mm if the lag is known, "
        f"{worst['lag, ignored']:.1f} mm if it is ignored, and at most {worst[name]:.1f} mm in any world ({name})."
    )
    return Report(table(lines), closing)


def draw(figure: Figure, rows: Sequence[Row]) -> None:
    """Draw the error across of every run, at the end and on the way."""
    worlds = list(WORLDS)
    colours = dict(zip(DRIVES, (COLOURS["limit"], COLOURS["path"], COLOURS["reverse"], COLOURS["goal"]), strict=True))
    panels = figure.subplots(1, 2, sharey=True)
    for axes, (column, text) in zip(
        panels, {"cross": "at the end", "way_cross": "on the way, largest"}.items(), strict=True
    ):
        for k, (drive, colour) in enumerate(colours.items()):
            group = [row for row in rows if row.drive == drive]
            at = [worlds.index(row.world) + 0.16 * (k - 1.5) for row in group]
            axes.plot([getattr(row, column) for row in group], at, ".", color=colour, label=drive, alpha=0.7)
        axes.set_xlabel(f"error across {text}, mm")
        axes.grid(axis="x", alpha=0.25)
        axes.set_xlim(0.0, None)
    panels[0].set_yticks(range(len(worlds)), worlds)
    panels[0].set_ylim(len(worlds) - 0.5, -0.5)
    figure.legend(
        *panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=8, frameon=False
    )


if __name__ == "__main__":
    sys.exit(run(__file__))
