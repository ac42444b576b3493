"""Experiment 5: how hard and how straight robots meet their stations, in a physics simulation; needs the extra `sim`.

The same random starts around the staging pose (a disc of 0.25 m around 0.85 m before the dock, headings within 0.25 rad)
are driven into a flat contact plate and into a V with wings, until contact: by the graceful law as Nav2's docking
server runs it (target 0.25 m behind the dock, Nav2's default parameters), by the planner's raw path and the
TrackingController, and by the certified plan and the TrackingController. Whoever touches presses on at 2 cm/s for
0.3 s, so that the contacts seat, and stops; whoever has arrived without touching creeps straight on at 3 cm/s.
Writes results/05_contact_forces/.

    python experiments/05_contact_forces.py [--starts N]
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from optdock.dock import Dock, DockDirection
from optdock.errors import ControllerException, MissingExtra, OptdockError
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2, Twist2
from optdock.interfaces import Controller, GoalChecker
from optdock.io.atomic_file import write_text
from optdock.limits import MotionLimits
from optdock.measurements import Measurements
from optdock.nav2.graceful_law import GracefulLaw
from optdock.pipeline import plan_dock
from optdock.plan import DockPlan
from optdock.plotting import save_mujoco_animation
from optdock.plotting.canvas import COLOURS, new_figure, save_figure
from optdock.plugins import create_plugin
from optdock.problem import DockingProblem
from optdock.report import table
from optdock.robot import Robot
from optdock.simulation import Actuation, PlantState, PoseSensor, RemainingPath, Sensors, SimulatedRobot
from optdock.simulation.mujoco import MujocoDrive, VShape, flat_station

OUT = Path("results") / Path(__file__).stem
GOAL = Pose2(0.0, 0.0, 0.0)
STAGING, SPREAD, TURN = 0.85, 0.25, 0.25  # [m], [m], [rad]
LAW = GracefulLaw(3.0, 2.0, 0.4, 2.0, 0.25, 2.5, 0.1, 0.25, 0.75)  # the docking server's defaults
PROJECTION = 0.25  # [m]
PERIOD, TIMEOUT = 0.02, 60.0  # [s]
CREEP, PRESS, PRESSING = 0.03, 0.02, 0.3  # [m/s], [m/s], [s]
SETTLING = 0.5  # [s] after the stop; who moves then is not at rest
TRAVEL, CROSS, YAW = 0.003, 0.01, math.radians(1.5)  # [m] of spring contacts, [m], [rad]: success
AT_REST = 0.002  # [m/s]
LIMITS = MotionLimits(
    max_speed=0.25, max_reverse_speed=0.25, max_acceleration=0.5, max_deceleration=0.5, max_yaw_rate=0.75,
    max_curvature=3.0, max_curvature_rate=30.0,
)  # fmt: skip


class World(NamedTuple):
    """What stands between the commands and the motors, and the noise of localization."""

    actuation: Actuation
    sensors: Sensors


WORLDS = {
    "perfect": World(Actuation(), Sensors()),
    "lag, latency, noise": World(
        Actuation(linear_lag=0.1, angular_lag=0.1, latency=0.06), Sensors(PoseSensor(0.002, math.radians(0.1)))
    ),
}


def stations() -> dict[str, tuple[Robot, Dock]]:
    """Each with the robot that fits it."""
    v, flat = VShape(), Footprint.rectangle(0.3, 0.3, 0.5)
    nosed = v.with_nose(0.3, 0.3, 0.5)
    outlines = {"flat plate": (flat, flat_station(flat)), "V": (nosed, v.station(nosed))}
    return {
        name: (
            Robot(robot, LIMITS),
            Dock(GOAL, station, DockDirection.FORWARD, approach_speed=0.1, approach_distance=0.1),
        )
        for name, (robot, station) in outlines.items()
    }


def starts(count: int) -> list[Pose2]:
    """Poses uniform in a disc around the staging pose, headings uniform around the dock's."""
    random = np.random.default_rng(1)
    radius, angle = SPREAD * np.sqrt(random.uniform(size=count)), random.uniform(-math.pi, math.pi, count)
    turn = random.uniform(-TURN, TURN, count)
    columns = (radius * np.cos(angle) - STAGING, radius * np.sin(angle), turn)
    return [Pose2(*row) for row in np.column_stack(columns).tolist()]


class Docking(NamedTuple):
    """How one docking ended: the robot seen from the dock, forces [N], impulse across [N s], time [s], and its states."""

    error: Pose2
    rested: bool
    touched: bool
    peak: float
    peak_across: float
    impulse_across: float
    duration: float
    states: tuple[PlantState, ...]

    @property
    def docked(self) -> bool:
        """In touch, straight, at rest."""
        placed = abs(self.error.x) <= TRAVEL and abs(self.error.y) <= CROSS and abs(self.error.yaw) <= YAW
        return self.touched and self.rested and placed


Steering = Callable[[Measurements], "Twist2 | None"]  # None: arrived, creep on


def by_law(_plan: DockPlan) -> Steering:
    """The docking server's law towards the projected dock."""
    target = GOAL @ Pose2(PROJECTION, 0.0, 0.0)
    return lambda measured: LAW.command(target, measured.pose or GOAL)


def by_raw_path(plan: DockPlan) -> Steering:
    """What the planner made, tracked."""
    return _tracked(plan, smoothed=False)


def by_smoothed_path(plan: DockPlan) -> Steering:
    """The certified plan, tracked."""
    return _tracked(plan, smoothed=True)


def _tracked(plan: DockPlan, *, smoothed: bool) -> Steering:
    controller = create_plugin(Controller, "TrackingController")
    checker = create_plugin(GoalChecker, "DockGoalChecker", {"along_tolerance": TRAVEL})
    controller.reset()
    checker.reset()
    controller.set_path(plan.trajectory if smoothed else plan.raw_path)
    remaining = RemainingPath(plan.path if smoothed else plan.raw_path)
    arrived = False

    def steer(measured: Measurements) -> Twist2 | None:
        nonlocal arrived
        pose = measured.pose or GOAL
        path = remaining.from_pose(pose)
        arrived = arrived or checker.is_goal_reached(pose, GOAL, measured.twist, path)
        if arrived:
            return None
        return controller.compute_velocity_commands(pose, measured.twist, checker, stamp=measured.stamp)

    return steer


METHODS = {"graceful law": by_law, "raw path": by_raw_path, "smoothed path": by_smoothed_path}


def dock(drive: MujocoDrive, start: Pose2, world: World, steer: Steering, seed: int) -> Docking:
    """Drive until contact, press, stop, rest."""
    robot = SimulatedRobot(drive, start, GOAL, world.sensors, seed=seed)
    states = [robot.state]
    touched_at: float | None = None
    measured = robot.measurements
    while robot.time < TIMEOUT and (touched_at is None or robot.time < touched_at + PRESSING + SETTLING):
        if touched_at is None and measured.contact:
            touched_at = robot.time
        if touched_at is None:
            command = steer(measured) or Twist2(CREEP, 0.0)
        else:
            command = Twist2(PRESS if robot.time < touched_at + PRESSING else 0.0, 0.0)
        measured = robot.advance(command, PERIOD)
        states.append(robot.state)
        if touched_at is None and robot.error.x > TRAVEL:
            break  # past the station
    forces = np.concatenate([state.physics.force for state in states])
    return Docking(
        error=robot.error,
        rested=math.hypot(robot.state.twist.linear, robot.state.twist.lateral) <= AT_REST,
        touched=touched_at is not None,
        peak=float(np.max(np.hypot(forces[:, 0], forces[:, 1]), initial=0.0)),
        peak_across=float(np.max(np.abs(forces[:, 1]), initial=0.0)),
        impulse_across=float(np.sum(np.abs(forces[:, 1]))) * drive.timestep,
        duration=touched_at or robot.time,
        states=tuple(states),
    )


def row(station: str, world: str, method: str, endings: list[Docking | None]) -> list[str]:
    """One line of the table."""
    done = [ending for ending in endings if ending is not None]

    def spread(values: list[float], digits: int) -> str:
        found = (*np.percentile(values, [50, 95]), max(values))
        return " / ".join(f"{value:.{digits}f}" for value in found)

    return [
        station,
        world,
        method,
        f"{sum(ending.docked for ending in done)}/{len(endings)}",
        spread([1e3 * abs(ending.error.y) for ending in done], 1),
        spread([math.degrees(abs(ending.error.yaw)) for ending in done], 2),
        spread([ending.peak for ending in done], 0),
        spread([ending.peak_across for ending in done], 0),
        spread([ending.impulse_across for ending in done], 2),
        spread([ending.duration for ending in done], 1),
    ]


def driven(drive: MujocoDrive, plans: list[DockPlan | None], world: World, method: str) -> list[Docking | None]:
    """Every start once; None where there is no plan, or the controller gave up."""
    endings: list[Docking | None] = []
    for seed, plan in enumerate(plans):
        try:
            ending = plan and dock(drive, plan.problem.start, world, METHODS[method](plan), seed)
        except ControllerException:
            ending = None
        endings.append(ending)
    return endings


def planned(robot: Robot, station: Dock, start: Pose2) -> DockPlan | None:
    """A certified plan; None where there is none."""
    try:
        return plan_dock(DockingProblem(start, station, robot), time_budget=1.0)
    except OptdockError:
        return None


def draw(found: dict[tuple[str, str, str], list[Docking | None]], target: Path) -> None:
    """Shares of the runs over peak force, lateral error and yaw error, a row for each station."""
    columns = {
        "peak force [N]": lambda ending: ending.peak,
        "|cross| [mm]": lambda ending: 1e3 * abs(ending.error.y),
        "|yaw| [deg]": lambda ending: math.degrees(abs(ending.error.yaw)),
    }
    colours = dict(zip(METHODS, (COLOURS["goal"], COLOURS["raw"], COLOURS["path"]), strict=True))
    lines = dict(zip(WORLDS, ("-", "--"), strict=True))
    names = list(dict.fromkeys(station for station, _, _ in found))
    figure = new_figure(11.0, 3.2 * len(names) + 0.6)
    axes = figure.subplots(len(names), len(columns), squeeze=False)
    for (station, world, method), endings in found.items():
        for axis, (label, value) in zip(axes[names.index(station)], columns.items(), strict=True):
            values = np.sort([value(ending) for ending in endings if ending is not None])
            share = np.arange(1, len(values) + 1) / len(endings)
            axis.step(
                values, share, where="post", color=colours[method], linestyle=lines[world], label=f"{method}, {world}"
            )
            axis.set_xlabel(label)
            axis.set_ylabel(f"{station}: share of runs")
            axis.set_ylim(0.0, 1.02)
            axis.grid(visible=True, color="#dddddd", linewidth=0.5)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, fontsize=8, frameon=False)
    save_figure(figure, target)


def main() -> None:
    """Drive everything; print and write the table, draw the picture and the animation."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--starts", type=int, default=100, help="how many (default: %(default)s)")
    poses = starts(parser.parse_args().starts)
    found = {}
    for station, (robot, place) in stations().items():
        plans = [planned(robot, place, pose) for pose in poses]
        for name, world in WORLDS.items():
            try:
                drive = MujocoDrive(robot, place, actuation=world.actuation)
            except MissingExtra as error:
                print(f"skipped: {error}")
                return
            for method in METHODS:
                found[station, name, method] = driven(drive, plans, world, method)
    head = ["station", "world", "method", "docked", "|cross| mm", "|yaw| deg", "peak force N", "peak across N"]
    text = table([[*head, "impulse across N s", "time s"], *(row(*key, endings) for key, endings in found.items())])
    OUT.mkdir(parents=True, exist_ok=True)
    write_text(OUT / "forces.md", text + "\n")
    print(f"p50 / p95 / max of {len(poses)} starts\n\n{text}")
    draw(found, OUT / "forces.png")


if __name__ == "__main__":
    main()
