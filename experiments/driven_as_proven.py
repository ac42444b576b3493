"""Deviation of the driven motion from the certified path, for every plant, drive and gear, without noise.

The executor drives random starts before the dock, forward and backward, with a differential drive, a differential drive
that turns in place, and a car that holds or straightens its wheels at rest, with random initial wheel angles. Each case
runs once with perfect actuators and once with a lag of 0.1 s of speed and yaw rate and a latency of 0.06 s. Reported
are the deviation of the true pose from the active path (minimum over its poses of the larger of distance / 3 mm and
heading error / 0.3 degrees), the number of dockings that failed or needed another attempt, and the time from plan to
docked relative to the duration of the plan. Writes results/driven_as_proven/.

    python experiments/driven_as_proven.py [--starts N] [--seed N] [--controller NAME]
"""

from __future__ import annotations

import argparse
import functools
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from optdock.deadline import set_clock
from optdock.executor import DockingExecutor, ExecutorSettings
from optdock.executor.planning import DrivenMotion, InlinePlanning, PlanResult
from optdock.geometry.arrays import FloatArray
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.io.atomic_file import write_text
from optdock.model.dock import Dock, DockDirection
from optdock.model.limits import MotionLimits
from optdock.model.path import Path as DockPath
from optdock.model.problem import DockingProblem
from optdock.model.robot import Drive, Robot
from optdock.plugins.interfaces import Controller
from optdock.simulation import Actuation, SimulatedRobot, Station, Steering, SteeringAtRest, plant_of

OUT = Path("results") / Path(__file__).stem
GOAL = Pose2(0.0, 0.0, 0.0)
OUTLINE = Footprint.rectangle(0.8, 0.2, 0.6)
# Plates 2 cm before the front and behind the rear of the docked robot: no plan leads through the stop of the station.
PLATES = {
    DockDirection.FORWARD: Footprint([(0.82, -0.4), (1.0, -0.4), (1.0, 0.4), (0.82, 0.4)]),
    DockDirection.BACKWARD: Footprint([(-0.4, -0.4), (-0.22, -0.4), (-0.22, 0.4), (-0.4, 0.4)]),
}
# A drive with lag deviates by `max_yaw_acceleration` * lag^2 / 2 [rad] after a step of the yaw acceleration.
WHEELS = MotionLimits(max_yaw_rate=1.0, max_yaw_acceleration=0.8, max_curvature=1.8, max_curvature_rate=8.0)
STEERED = MotionLimits(wheelbase=0.6, max_steering_angle=0.7, max_steering_rate=0.5, max_yaw_rate=1.0)
CAR = Robot(OUTLINE, STEERED, Drive.ACKERMANN)
ROBOTS: dict[str, tuple[Robot, SteeringAtRest | None]] = {
    "differential": (Robot(OUTLINE, WHEELS), None),
    "turning in place": (Robot(OUTLINE, WHEELS, turns_in_place=True), None),
    "car, holds": (CAR, SteeringAtRest.HOLD),
    "car, straightens": (CAR, SteeringAtRest.STRAIGHTEN),
}
LAG, LATENCY = 0.1, 0.06  # [s]
PLACE, TURN = 0.003, math.radians(0.3)  # [m], [rad]: deviation that counts as 1
SPACING = 5e-4  # [m] between sampled poses of a path
RATE, TIMEOUT = 50.0, 90.0  # [Hz], [s]


class Start(NamedTuple):
    """Initial pose of a robot and initial angle of its wheels [rad]."""

    pose: Pose2
    wheels: float


class DockingRun(NamedTuple):
    """Result of one docking: largest deviation in `PLACE` and `TURN`, time relative to the plan, failure."""

    off: float
    time: float
    is_lost: bool


class MotionRecorder(InlinePlanning):
    """Planning that records the planned motions in order."""

    def __init__(self) -> None:
        super().__init__()
        self.motions: list[DrivenMotion] = []

    def poll(self, stamp: float) -> PlanResult | None:
        """See `Planning.poll`."""
        found = super().poll(stamp)
        if found is not None and found.motion is not None:
            self.motions.append(found.motion)
        return found


def starts(count: int, direction: DockDirection, seed: int = 1) -> list[Start]:
    """Return starts 0.9 to 2.2 m before the dock, up to 0.6 rad aside and turned; wheels straight or fully turned."""
    random, side = np.random.default_rng(seed), 1.0 if direction is DockDirection.BACKWARD else -1.0
    found = []
    for _ in range(count):
        far, aside, yaw = random.uniform(0.9, 2.2), random.uniform(-0.6, 0.6), random.uniform(-0.6, 0.6)
        wheels = float(random.choice([-1.0, 0.0, 1.0])) * STEERED.max_steering_angle
        found.append(Start(Pose2(side * far * math.cos(aside), far * math.sin(aside), yaw), wheels))
    return found


def docked(
    name: str, direction: DockDirection, start: Start, lag: float, latency: float, controller: str | Controller
) -> DockingRun:
    """Run one docking; the station signals contact 3 mm before the end."""
    robot, at_rest = ROBOTS[name]
    dock = Dock(GOAL, direction=direction, final_straight=0.2, footprint=PLATES[direction])
    problem = DockingProblem(start.pose, dock, robot)
    steering = None if at_rest is None else Steering(lag, at_rest=at_rest, start=start.wheels)
    actuation = Actuation(linear_lag=lag, angular_lag=0.0 if steering else lag, latency=latency)
    plant = plant_of(robot, actuation, steering=steering)
    world = SimulatedRobot(plant, start.pose, GOAL, station=Station(direction))
    planning = MotionRecorder()
    settings = ExecutorSettings(use_detections=False, navigate_to_staging_pose=False, time_budget=3.0)
    executor = DockingExecutor(problem, settings, controller=controller, planning=planning)
    driven: list[tuple[int, Pose2]] = []
    now, begun = world.measurements, math.nan
    while executor.ending is None and now.stamp < TIMEOUT:
        command = executor.step(now).command
        if planning.motions:
            begun = now.stamp if math.isnan(begun) else begun
            driven.append((len(planning.motions) - 1, world.state.pose))
        now = world.advance(command, 1.0 / RATE)
    ending = executor.ending
    is_lost = ending is None or "docked by" not in ending.kind.value or ending.num_retries > 0
    if not planning.motions:
        return DockingRun(math.inf, math.inf, is_lost)
    paths = [motion.trajectory.path for motion in planning.motions]
    # A motion planned while driving becomes active slightly later.
    off = max(min(off_path(path, pose) for path in paths[max(0, k - 1) : k + 1]) for k, pose in driven)
    return DockingRun(off, (now.stamp - begun) / planning.motions[0].trajectory.duration, is_lost)


@functools.lru_cache(maxsize=8)
def places_of(path: DockPath) -> FloatArray:
    """Return the poses of a path, every `SPACING`. Shape (n, 3)."""
    return path.poses_at(np.linspace(0.0, path.length, max(2, math.ceil(path.length / SPACING))))


def off_path(path: DockPath, pose: Pose2) -> float:
    """Return the deviation of a pose from a path: the minimum over its poses of the larger of both relative errors."""
    places = places_of(path)
    far = np.hypot(places[:, 0] - pose.x, places[:, 1] - pose.y) / PLACE
    turned = np.abs(np.remainder(places[:, 2] - pose.yaw + math.pi, 2.0 * math.pi) - math.pi) / TURN
    return float(np.min(np.maximum(far, turned)))


def main() -> None:
    """Run all dockings and write the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--starts", type=int, default=40, help="number of starts of each kind")
    parser.add_argument("--seed", type=int, default=1, help="seed of the starts")
    parser.add_argument("--controller", default="TrackingController")
    given = parser.parse_args()
    set_clock("cpu")
    rows = [["plant", "robot", "dock", "off path", "p90", "time / plan", "p90", "lost"]]
    for plant, lag, latency in (("perfect", 0.0, 0.0), ("late", LAG, LATENCY)):
        for name in ROBOTS:
            for direction in (DockDirection.FORWARD, DockDirection.BACKWARD):
                found = [
                    docked(name, direction, start, lag, latency, given.controller)
                    for start in starts(given.starts, direction, given.seed)
                ]
                off, time = np.array([one.off for one in found]), np.array([one.time for one in found])
                numbers = (off.max(), np.percentile(off, 90), time.max(), np.percentile(time, 90))
                lost = sum(one.is_lost for one in found)
                rows.append([plant, name, direction.value, *(f"{number:.3f}" for number in numbers), str(lost)])
                print("  ".join(f"{cell:>16}" for cell in rows[-1]), flush=True)
    text = "\n".join(" | ".join(row) for row in rows) + "\n"
    write_text(OUT / "table.txt", text)


if __name__ == "__main__":
    main()
