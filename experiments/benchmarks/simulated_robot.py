"""CPU time of a simulated robot: `python -m experiments.benchmarks simulated_robot`; microseconds per `advance`.

With plant, localization, odometry, a dock detector at 15 Hz, contact and record. Best of several runs.
"""

from __future__ import annotations

import argparse
import math
import time

from experiments.benchmarks.tables import Table
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2, Twist2
from optdock.model.limits import MotionLimits
from optdock.model.robot import Drive, Robot
from optdock.simulation import (
    Actuation,
    Bicycle,
    DifferentialDrive,
    DockSensor,
    Odometry,
    Plant,
    PoseSensor,
    Sensors,
    SimulatedRobot,
    Slip,
    Station,
    Steering,
    StuckWheel,
    Wheel,
    Wheels,
)

FOOTPRINT = Footprint.rectangle(0.4, 0.3, 0.5)
ROBOT = Robot(FOOTPRINT, MotionLimits())
CAR = Robot(FOOTPRINT, MotionLimits(wheelbase=0.5, max_steering_angle=0.6, max_steering_rate=0.8), Drive.ACKERMANN)
LATE = Actuation(linear_lag=0.1, angular_lag=0.1, latency=0.06)
PLANTS: dict[str, Plant] = {
    "perfect differential drive": DifferentialDrive(ROBOT),
    "lag, latency": DifferentialDrive(ROBOT, LATE),
    "lag, latency, wheels, slip": DifferentialDrive(
        ROBOT,
        LATE,
        wheels=Wheels(0.4, 0.98, 1.01, stuck=(StuckWheel(Wheel.LEFT, 1.0, 2.0),)),
        slip=Slip(0.02, lost_sigma=0.01, turn_sigma=0.01),
    ),
    "car: lags, latency": Bicycle(CAR, Actuation(linear_lag=0.1, latency=0.06), steering=Steering(0.1)),
}
SENSORS = Sensors(
    PoseSensor(0.005, 0.009, position_walk=0.001),
    Odometry(linear_sigma=0.003, angular_sigma=0.01),
    DockSensor(15.0, 0.06, 0.003, 0.005, drop_out=0.02),
)
RATES = (20, 50, 100)  # [Hz]


def microseconds(plant: Plant, rate: float, steps: int) -> float:
    """Return the CPU time of one `advance` [us]."""
    robot = SimulatedRobot(plant, Pose2(-2.0, 0.1, 0.1), Pose2(0.0, 0.0, 0.0), SENSORS, station=Station())
    commands = [Twist2(0.2 * math.sin(0.01 * k), 0.3 * math.cos(0.013 * k)) for k in range(steps)]
    start = time.thread_time()
    for command in commands:
        robot.advance(command, 1.0 / rate)
    return 1e6 * (time.thread_time() - start) / steps


def main(arguments: list[str]) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="simulated_robot", description=__doc__)
    parser.add_argument("--steps", type=int, default=2000, help="number of steps of each of 5 runs")
    steps = parser.parse_args(arguments).steps
    rows = tuple(
        (name, *(min(microseconds(plant, rate, steps) for _ in range(5)) for rate in RATES))
        for name, plant in PLANTS.items()
    )
    print(Table("One step of a simulated robot [us of CPU]", ("plant", *(f"{rate} Hz" for rate in RATES)), rows))
