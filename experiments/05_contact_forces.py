"""Experiment 5: contact forces and alignment of dockings in a physics simulation.

The same random starts around the staging pose (a disc of 0.25 m radius, 0.85 m before the dock, headings within 0.25
rad) are driven into a flat contact plate and into a V with wings, until contact, by four methods: the graceful law as
in Nav2's docking server (target 0.25 m behind the dock, Nav2's default parameters), the planner's raw path with the
TrackingController, the certified plan with the TrackingController, and the executor. After contact the robot presses on
at 2 cm/s for 1 s, to seat the contacts, and stops. A robot that arrives without contact creeps straight ahead at 3
cm/s. A run counts as docked if the robot rests in contact within 10 mm laterally and 1.5 degrees. Writes
results/05_contact_forces/.

    python experiments/05_contact_forces.py [--starts N]
"""

from __future__ import annotations

import argparse
import functools
import math
from collections import Counter
from collections.abc import Callable
from pathlib import Path as FilePath
from typing import NamedTuple

import numpy as np

from experiments.graceful_law import nav2_command, random_starts
from experiments.mujoco import MujocoDrive, VShape, flat_station
from experiments.mujoco.animation import save_mujoco_animation
from optdock.errors import ControllerException, InvalidValue, MissingExtra, OptdockError
from optdock.executor import DockingExecutor, ExecutorSettings
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2, Twist2
from optdock.io.atomic_file import write_text
from optdock.model.dock import Dock, DockDirection
from optdock.model.limits import MotionLimits
from optdock.model.measurements import Measurements
from optdock.model.path import Path
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.model.trajectory import Trajectory
from optdock.planning.pipeline import plan_dock
from optdock.planning.plan import DockPlan
from optdock.plotting.canvas import COLOURS, new_figure, save_figure
from optdock.plugins.interfaces import Controller, GoalChecker
from optdock.plugins.registry import create_plugin
from optdock.reports.report import table
from optdock.simulation import Actuation, PlantState, PoseSensor, RemainingPath, Sensors, SimulatedRobot

OUT = FilePath("results") / FilePath(__file__).stem
GOAL = Pose2(0.0, 0.0, 0.0)
STAGING = 0.85  # [m]
PERIOD, TIMEOUT = 0.02, 60.0  # [s]
TIME_BUDGET = 5.0  # [s] of wall clock, for loaded machines; all but one plan need less than 0.3 s
CREEP, PRESS, PRESSING = 0.03, 0.02, 1.0  # [m/s], [m/s], [s]
SETTLING = 0.5  # [s] after the stop; a robot that still moves then is not at rest
MEETING = 0.2  # [s] from the first contact: the impact, without the pressing phase
TRAVEL, CROSS, YAW = 0.003, 0.01, math.radians(1.5)  # travel of the spring contacts [m], tolerances [m], [rad]
AT_REST = 0.002  # [m/s]
LIMITS = MotionLimits(
    max_speed=0.25, max_reverse_speed=0.25, max_acceleration=0.5, max_deceleration=0.5, max_yaw_rate=0.75,
    max_curvature=3.0, max_curvature_rate=30.0,
)  # fmt: skip


class World(NamedTuple):
    """Actuation between commands and motors, and localization noise."""

    actuation: Actuation
    sensors: Sensors


NOISY = "late, noisy"
WORLDS = {
    "perfect": World(Actuation(), Sensors()),
    NOISY: World(
        Actuation(linear_lag=0.1, angular_lag=0.1, latency=0.06), Sensors(PoseSensor(0.002, math.radians(0.1)))
    ),
}


def stations() -> dict[str, tuple[Robot, Dock]]:
    """Return each station with the robot that fits it."""
    v, flat = VShape(), Footprint.rectangle(0.3, 0.3, 0.5)
    nosed = v.with_nose(0.3, 0.3, 0.5)
    outlines = {"plate": (flat, flat_station(flat)), "V": (nosed, v.station(nosed))}
    return {
        name: (
            Robot(robot, LIMITS),
            Dock(GOAL, station, DockDirection.FORWARD, approach_speed=0.1, approach_distance=0.1),
        )
        for name, (robot, station) in outlines.items()
    }


class Docking(NamedTuple):
    """Result of one docking.

    Attributes:
        pose: Robot pose in the frame of the dock.
        impulse: Impulse of the absolute lateral force in the first 0.2 s of contact [N s].
        peak: Largest contact force [N]; 0 without contact.
        duration: Time until the first contact, or until the end without contact [s].
        fault: Reason why the robot did not end at the dock; empty on success.
    """

    pose: Pose2
    impulse: float
    peak: float
    duration: float
    fault: str


Steering = Callable[[Measurements], "Twist2 | None"]  # None: finished, stand still


def by_law(_problem: DockingProblem) -> Steering:
    """Steer by the law of the docking server towards the projected dock."""
    return until_contact(lambda measured: nav2_command(GOAL, measured.pose or GOAL))


def by_raw_path(problem: DockingProblem) -> Steering:
    """Track the raw path of the planner, including heading jumps at its corners."""
    return until_contact(tracked(planned(problem).raw_path, {"max_yaw_error": math.pi}))


def by_smoothed_path(problem: DockingProblem) -> Steering:
    """Track the certified plan."""
    return until_contact(tracked(planned(problem).trajectory, {}))


def by_executor(problem: DockingProblem) -> Steering:
    """Run the executor as a server does, from the current robot pose until the task ends."""
    settings = ExecutorSettings(
        contact="touch",
        use_detections=False,
        navigate_to_staging_pose=False,
        max_retries=0,
        time_budget=TIME_BUDGET,
    )
    executor = DockingExecutor(problem, settings)
    docked_at: float | None = None

    def steer(measured: Measurements) -> Twist2 | None:
        nonlocal docked_at
        step = executor.step(measured)
        if step.ending is None:
            return step.command
        if docked_at is None and step.ending.kind.succeeded:
            docked_at = measured.stamp
        return pressing(measured.stamp, docked_at)

    return steer


@functools.cache
def planned(problem: DockingProblem) -> DockPlan:
    """Return the certified plan from a start."""
    return plan_dock(problem, time_budget=TIME_BUDGET)


def tracked(motion: Path | Trajectory, parameters: dict[str, object]) -> Steering:
    """Run the TrackingController until arrival; then creep straight ahead."""
    controller = create_plugin(Controller, "TrackingController", parameters)
    checker = create_plugin(GoalChecker, "DockGoalChecker", {"along_tolerance": TRAVEL})
    controller.reset()
    checker.reset()
    controller.set_path(motion)
    remaining = RemainingPath(motion.path if isinstance(motion, Trajectory) else motion)
    arrived = False

    def steer(measured: Measurements) -> Twist2:
        nonlocal arrived
        pose = measured.pose or GOAL
        arrived = arrived or checker.is_goal_reached(pose, GOAL, measured.twist, remaining.from_pose(pose))
        if arrived:
            return Twist2(CREEP, 0.0)
        return controller.compute_velocity_commands(pose, measured.twist, checker, stamp=measured.stamp)

    return steer


def until_contact(steer: Steering) -> Steering:
    """Wrap a steering function: press on for a moment after contact, then finish."""
    touched_at: float | None = None

    def steer_or_press(measured: Measurements) -> Twist2 | None:
        nonlocal touched_at
        if touched_at is None and measured.contact:
            touched_at = measured.stamp
        return steer(measured) if touched_at is None else pressing(measured.stamp, touched_at)

    return steer_or_press


def pressing(now: float, since: float | None) -> Twist2 | None:
    """Return the pressing command; None before contact and after the pressing phase."""
    return Twist2(PRESS, 0.0) if since is not None and now < since + PRESSING else None


METHODS = {
    "graceful law": by_law,
    "raw path, tracker": by_raw_path,
    "smoothed path, tracker": by_smoothed_path,
    "executor": by_executor,
}


def dock(
    drive: MujocoDrive, problem: DockingProblem, world: World, method: str, seed: int
) -> tuple[Docking, list[PlantState]]:
    """Drive until the steering has finished and the robot has had time to come to rest."""
    robot = SimulatedRobot(drive, problem.start, GOAL, world.sensors, seed=seed)
    states = [robot.state]
    try:
        steer = METHODS[method](problem)
    except OptdockError:
        return Docking(robot.error, 0.0, 0.0, 0.0, "no plan"), states
    reason, over_at = "", math.inf
    while robot.time < min(TIMEOUT, over_at + SETTLING):
        try:
            command = steer(robot.measurements) if over_at == math.inf else None
        except ControllerException as error:
            command, reason = None, type(error).__name__
        if command is None:
            over_at = min(over_at, robot.time)
        robot.advance(command or Twist2(), PERIOD)
        states.append(robot.state)
    forces = np.concatenate([state.physics.force for state in states])
    strength = np.hypot(forces[:, 0], forces[:, 1])
    first = int(np.argmax(strength > 0.0))
    meeting = slice(first, first + round(MEETING / drive.timestep))
    ending = Docking(
        pose=robot.error,
        impulse=float(np.sum(np.abs(forces[meeting, 1]))) * drive.timestep,
        peak=float(strength.max()),
        duration=next((state.time for state in states if state.contact), robot.time),
        fault=reason or fault_of(robot),
    )
    return ending, states


def fault_of(robot: SimulatedRobot) -> str:
    """Return why the robot does not rest at its dock; empty on success."""
    error, twist = robot.error, robot.state.twist
    faults = {
        "moves": math.hypot(twist.linear, twist.lateral) > AT_REST,
        "turned": abs(error.yaw) > YAW,
        "aside": abs(error.y) > CROSS,
        "out of touch": abs(error.x) > TRAVEL,
    }
    return next((name for name, is_so in faults.items() if is_so), "")


COLUMNS: dict[str, tuple[Callable[[Docking], float], int]] = {
    "across, mm": (lambda ending: 1e3 * abs(ending.pose.y), 1),
    "yaw, degrees": (lambda ending: math.degrees(abs(ending.pose.yaw)), 2),
    "peak force, N": (lambda ending: ending.peak, 0),
    "impulse across, N s": (lambda ending: ending.impulse, 1),
    "time, s": (lambda ending: ending.duration, 1),
}


def row(station: str, world: str, method: str, endings: list[Docking]) -> list[str]:
    """Return one row of the table; its figures are of the runs with contact."""
    touched = [ending for ending in endings if ending.peak > 0.0]

    def spread(value: Callable[[Docking], float], digits: int) -> str:
        values = [value(ending) for ending in touched]
        found = (*np.percentile(values, [50, 95]), max(values)) if values else ()
        return " / ".join(f"{value:.{digits}f}" for value in found) or "-"

    faults = Counter(ending.fault for ending in endings if ending.fault)
    return [
        station,
        world,
        method,
        f"{sum(not ending.fault for ending in endings)}/{len(endings)}",
        *(spread(value, digits) for value, digits in COLUMNS.values()),
        ", ".join(f"{count} {fault}" for fault, count in faults.most_common()) or "-",
    ]


def draw(found: dict[tuple[str, str, str], list[Docking]], target: FilePath) -> None:
    """Draw the distributions of peak force, lateral error and yaw error, one row per station."""
    columns = {label: COLUMNS[label][0] for label in ("peak force, N", "across, mm", "yaw, degrees")}
    colours = dict(zip(METHODS, (COLOURS["goal"], COLOURS["raw"], COLOURS["path"], COLOURS["start"]), strict=True))
    lines = dict(zip(WORLDS, ("-", "--"), strict=True))
    names = list(dict.fromkeys(station for station, _, _ in found))
    figure = new_figure(11.0, 3.2 * len(names) + 0.6)
    axes = figure.subplots(len(names), len(columns), squeeze=False)
    for (station, world, method), endings in found.items():
        for axis, (label, value) in zip(axes[names.index(station)], columns.items(), strict=True):
            values = np.sort([value(ending) for ending in endings if ending.peak > 0.0])
            share = np.arange(1, len(values) + 1) / len(endings)
            axis.step(
                values, share, where="post", color=colours[method], linestyle=lines[world], label=f"{method}, {world}"
            )
            axis.set_xlabel(label)
            axis.set_ylabel(f"{station}: share of runs")
            axis.set_ylim(0.0, 1.02)
            axis.grid(visible=True, color="#dddddd", linewidth=0.5)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=8, frameon=False)
    save_figure(figure, target)


def main() -> None:
    """Run all dockings; print and write the table, draw the picture and the animations."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--starts", type=int, default=100, help="number of starts (default: %(default)s)")
    poses = random_starts(parser.parse_args().starts, STAGING)
    try:
        drives = {
            (station, world): MujocoDrive(robot, place, actuation=parts.actuation)
            for station, (robot, place) in stations().items()
            for world, parts in WORLDS.items()
        }
    except MissingExtra as error:
        print(f"skipped: {error}")
        return
    problems = {
        station: [DockingProblem(pose, place, robot) for pose in poses]
        for station, (robot, place) in stations().items()
    }
    found = {
        (station, world, method): [
            dock(drive, problem, WORLDS[world], method, seed)[0] for seed, problem in enumerate(problems[station])
        ]
        for (station, world), drive in drives.items()
        for method in METHODS
    }
    head = ["station", "world", "method", "docked", *COLUMNS, "faults"]
    text = table([head, *(row(*key, endings) for key, endings in found.items())])
    OUT.mkdir(parents=True, exist_ok=True)
    write_text(OUT / "forces.md", text + "\n")
    print(f"p50 / p95 / max of {len(poses)} starts\n\n{text}")
    draw(found, OUT / "forces.png")
    animate(drives["V", NOISY], problems["V"])


def animate(drive: MujocoDrive, problems: list[DockingProblem]) -> None:
    """Animate the start with the largest lateral offset in the noisy world, for every method."""
    seed = max(range(len(problems)), key=lambda i: abs(problems[i].start.y))
    for method in METHODS:
        _, states = dock(drive, problems[seed], WORLDS[NOISY], method, seed)
        try:
            save_mujoco_animation(OUT / f"{method.replace(', ', '_').replace(' ', '_')}.gif", drive, states)
        except (MissingExtra, InvalidValue) as error:
            print(f"no animation: {error}")


if __name__ == "__main__":
    main()
