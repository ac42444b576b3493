"""Study 5: contact forces and alignment of dockings in a physics simulation.

The same random starts around the staging pose (a disc of 0.25 m radius, 0.85 m before the dock, headings within 0.25
rad) are driven into a flat contact plate and into a V with wings, until contact, by four methods: the graceful law as
in Nav2's docking server (target 0.25 m behind the dock, Nav2's default parameters), the planner's raw path with the
TrackingController, the certified plan with the TrackingController, and the executor. After contact the robot presses on
at 2 cm/s for 1 s, to seat the contacts, and stops. A robot that arrives without contact creeps straight ahead at 3
cm/s. A run counts as docked if the robot rests in contact within 10 mm laterally and 1.5 degrees. Every start has its
own seed of the measurement noise. The table shows p50 / p95 / max over the runs with contact.

    python experiments/05_contact_forces.py [--scale S] [--jobs N]
"""

from __future__ import annotations

import functools
import math
import sys
from collections import Counter
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from experiments.graceful_law import nav2_command, random_starts
from experiments.mujoco import MujocoDrive, VShape, flat_station
from experiments.study_run import Report, median_interval, run, scaled, share_text
from optdock.errors import ControllerException, MissingExtra, OptdockError
from optdock.executor import DockingExecutor, ExecutorSettings
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2, Twist2
from optdock.model.dock import Dock, DockDirection
from optdock.model.limits import MotionLimits
from optdock.model.measurements import Measurements
from optdock.model.path import Path
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.model.trajectory import Trajectory
from optdock.planning.pipeline import plan_dock
from optdock.planning.plan import DockPlan
from optdock.plotting.canvas import COLOURS
from optdock.plugins.interfaces import Controller, GoalChecker
from optdock.plugins.registry import create_plugin
from optdock.reports.report import table
from optdock.simulation import Actuation, PlantState, PoseSensor, RemainingPath, Sensors, SimulatedRobot

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from matplotlib.figure import Figure

GOAL = Pose2(0.0, 0.0, 0.0)
STAGING = 0.85  # [m]
PERIOD, TIMEOUT = 0.02, 60.0  # [s]
TIME_BUDGET = 5.0  # [s] of CPU time; all but one plan need less than 0.3 s
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


class Task(NamedTuple):
    """A station and the number of a start, of so many."""

    station: str
    number: int
    starts: int


class Row(NamedTuple):
    """Result of one docking; without contact, the peak force is 0."""

    station: str
    world: str
    method: str
    number: int
    fault: str
    across: float  # [mm]
    yaw: float  # [degrees]
    peak: float  # [N]
    impulse: float  # [N s]
    duration: float  # [s]


COLUMNS = {
    "across, mm": ("across", 1),
    "yaw, degrees": ("yaw", 2),
    "peak force, N": ("peak", 0),
    "impulse across, N s": ("impulse", 1),
    "time, s": ("duration", 1),
}
SIZE = (11.0, 6.6)


def tasks(scale: float) -> list[Task]:
    """Return every start at every station; no task without MuJoCo."""
    try:
        drive_of("plate", NOISY)
    except MissingExtra:
        return []
    count = scaled(scale, 25)
    return [Task(station, number, count) for station in stations() for number in range(count)]


@functools.cache
def drive_of(station: str, world: str) -> MujocoDrive:
    """Return the simulated drive at a station."""
    robot, place = stations()[station]
    return MujocoDrive(robot, place, actuation=WORLDS[world].actuation)


def work(task: Task) -> Iterator[Row]:
    """Dock from one start in every world by every method."""
    station, number, count = task
    robot, place = stations()[station]
    problem = DockingProblem(random_starts(count, STAGING)[number], place, robot)
    for world, parts in WORLDS.items():
        for method in METHODS:
            ending, _ = dock(drive_of(station, world), problem, parts, method, number)
            errors = 1e3 * abs(ending.pose.y), math.degrees(abs(ending.pose.yaw))
            yield Row(
                station, world, method, number, ending.fault, *errors, ending.peak, ending.impulse, ending.duration
            )


def groups(rows: Sequence[Row]) -> dict[tuple[str, str, str], list[Row]]:
    """Return the rows of every station, world and method, in the order of the table."""
    keys = [(station, world, method) for station in stations() for world in WORLDS for method in METHODS]
    found = {key: [row for row in rows if row[:3] == key] for key in keys}
    return {key: group for key, group in found.items() if group}


def line(key: tuple[str, str, str], group: Sequence[Row]) -> list[str]:
    """Return one line of the table; its figures are of the runs with contact."""

    def spread(column: str, digits: int) -> str:
        values = [getattr(row, column) for row in group if row.peak > 0.0]
        found = (*np.percentile(values, [50, 95]), max(values)) if values else ()
        return " / ".join(f"{value:.{digits}f}" for value in found) or "-"

    faults = Counter(row.fault for row in group if row.fault)
    return [
        *key,
        f"{sum(not row.fault for row in group)}/{len(group)}",
        *(spread(column, digits) for column, digits in COLUMNS.values()),
        ", ".join(f"{count} {fault}" for fault, count in faults.most_common()) or "-",
    ]


def report(rows: Sequence[Row]) -> Report:
    """Return the table and the comparison of the peak forces."""
    if not rows:
        return Report("skipped: needs MuJoCo", "Without MuJoCo, no docking was simulated.")
    found = groups(rows)
    head = ["station", "world", "method", "docked", *COLUMNS, "faults"]
    late = {m: [row for row in rows if row.method == m and row.world == NOISY] for m in METHODS}
    docked = {m: share_text(sum(not row.fault for row in group), len(group)) for m, group in late.items()}
    peaks = {m: median_interval([row.peak for row in group if row.peak > 0.0]) for m, group in late.items()}
    ours, law = (
        f"{middle:.0f} N ({low:.0f} to {high:.0f})" for middle, low, high in (peaks["executor"], peaks["graceful law"])
    )
    closing = (
        f"With lag, latency and noise, the executor docks in {docked['executor']} runs with a median peak force of "
        f"{ours}, and the graceful law in {docked['graceful law']} with {law}."
    )
    return Report(table([head, *(line(key, group) for key, group in found.items())]), closing)


def draw(figure: Figure, rows: Sequence[Row]) -> None:
    """Draw the distributions of peak force, lateral error and yaw error, one row per station."""
    found = groups(rows)
    columns = {label: COLUMNS[label][0] for label in ("peak force, N", "across, mm", "yaw, degrees")}
    methods = ("graceful law", "raw path, tracker", "smoothed path, tracker", "executor")
    colours = dict(zip(methods, (COLOURS["goal"], COLOURS["raw"], COLOURS["path"], COLOURS["start"]), strict=True))
    lines = {"perfect": "-", NOISY: "--"}
    names = list(dict.fromkeys(station for station, _, _ in found)) or ["no MuJoCo"]
    axes: Any = figure.subplots(len(names), len(columns), squeeze=False)
    for (station, world, method), group in found.items():
        for axis, (label, column) in zip(axes[names.index(station)], columns.items(), strict=True):
            values = np.sort([getattr(row, column) for row in group if row.peak > 0.0])
            share = np.arange(1, len(values) + 1) / len(group)
            axis.step(
                values, share, where="post", color=colours[method], linestyle=lines[world], label=f"{method}, {world}"
            )
            axis.set_xlabel(label)
            axis.set_ylabel(f"{station}: share of runs")
            axis.set_ylim(0.0, 1.02)
            axis.grid(visible=True, color="#dddddd", linewidth=0.5)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=8, frameon=False)


if __name__ == "__main__":
    sys.exit(run(__file__))
