"""Robots of the field world with hidden properties that stay constant in all of their runs."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from experiments.docking.cases import ROBOT, SPREADS, layout_of
from experiments.docking.field.camera import Camera
from experiments.docking.field.drive import Drive
from experiments.docking.field.localization import Localization
from experiments.docking.field.odometry import Odometry
from experiments.docking.field.world import FieldRobot, FieldWorld
from experiments.docking.outcome import ACCEPTED
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.model.dock import DockTolerances

if TYPE_CHECKING:
    from experiments.docking.cases import Layout

__all__ = ["TRACK_WIDTH", "HiddenRobot", "hidden_robot", "set_down"]

TRACK_WIDTH = 0.4  # [m]: value assumed by the base, see `Drive`
# [m/s]: required by the limits of a robot with a track width; a rim reaches 0.4 at full speed and yaw rate.
_WHEEL_SPEED = 0.5
_APART = 100_000  # offset between the seeds of two robots, so that their runs differ


class HiddenRobot(NamedTuple):
    """One robot at one dock.

    Attributes:
        number: Number of the robot.
        world: Imperfections of the robot.
        radii: True radii of the wheels, left and right [m].
        track_width: True distance between the wheels [m].
        dead_bands: Left and right [m/s].
        layout: Problem and true dock pose; its start is not used.
    """

    number: int
    world: FieldWorld
    radii: tuple[float, float]
    track_width: float
    dead_bands: tuple[float, float]
    layout: Layout


def hidden_robot(number: int) -> HiddenRobot:
    """Return the robot of a number, which determines all hidden properties."""
    random = np.random.default_rng([number, 2021])
    late, wait = random.uniform(0.04, 0.12), random.uniform(0.08, 0.2)
    is_dead, is_late, is_blind = random.random(3) < (0.5, 0.5, 0.3)
    band = tuple(random.uniform(0.01, 0.06, 2).tolist()) if is_dead else (0.0, 0.0)
    drive = Drive(lag=float(random.uniform(0.05, 0.15)), latency=(late - 0.03, late + 0.03))
    camera = Camera(
        latency=(wait - 0.04, wait + 0.04),
        position_sigma=float(random.uniform(0.001, 0.004)),
        position_slope=float(random.uniform(0.002, 0.008)),
        yaw_sigma=math.radians(float(random.uniform(0.1, 0.5))),
        yaw_slope=math.radians(float(random.uniform(0.3, 1.2))),
        outliers=float(random.uniform(0.02, 0.15)),
        near=float(random.uniform(0.15, 0.3)),
        near_loss=1.0 if is_blind else 0.0,
        stamped_on_arrival=bool(is_late),
    )
    localization = Localization(
        drift=float(random.uniform(0.005, 0.025)),
        drift_yaw=math.radians(float(random.uniform(0.1, 0.5))),
        jump_pause=float(random.uniform(8.0, 30.0)),
    )
    odometry = Odometry(window=float(random.choice([0.02, 0.04, 0.1, 0.2])))
    world = FieldWorld(f"robot {number}", drive, odometry, localization, camera)
    left, right, track = random.uniform(-0.01, 0.01, 3).tolist()
    limits = dataclasses.replace(ROBOT.limits, max_wheel_speed=_WHEEL_SPEED, track_width=TRACK_WIDTH)
    robot = dataclasses.replace(ROBOT, footprint=Footprint.rectangle(0.3, 0.3, 0.45), limits=limits)
    layout = layout_of(
        random, SPREADS["wider"], world.direction, world.moved, robot=robot, tolerances=DockTolerances(*ACCEPTED)
    )
    radii = drive.wheel_radius * (1.0 + left), drive.wheel_radius * (1.0 + right)
    return HiddenRobot(number, world, radii, drive.track_width * (1.0 + track), band, layout)


def set_down(hidden: HiddenRobot, run: int) -> tuple[Layout, FieldRobot]:
    """Return the robot at the start of a run; only start and noise differ between runs."""
    seed = _APART * (hidden.number + 1) + run
    random = np.random.default_rng([seed, 1])
    spread, goal = SPREADS["wider"], hidden.layout.problem.goal
    radius, angle = spread.radius * math.sqrt(random.uniform()), random.uniform(-math.pi, math.pi)
    start = Pose2(
        radius * math.cos(angle) - spread.staging,
        radius * math.sin(angle),
        float(random.uniform(-spread.turn, spread.turn)),
    )
    layout = hidden.layout._replace(problem=dataclasses.replace(hidden.layout.problem, start=goal @ start))
    robot = FieldRobot(hidden.world, layout, seed)
    robot.drive.radii, robot.drive.width = hidden.radii, hidden.track_width
    robot.drive.dead_bands = hidden.dead_bands
    return layout, robot
