"""Robots of the field world, each with hidden properties of its own that stay the same in all of its drives."""

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

TRACK_WIDTH = 0.4  # [m]: what the base believes in, see `Drive`
# [m/s]: the limits of the robot need one where they have a track width; at full speed and yaw rate a rim has 0.4.
_WHEEL_SPEED = 0.5
_APART = 100_000  # seeds between two robots: the runs of two are different ones


class HiddenRobot(NamedTuple):
    """One robot at one dock.

    Attributes:
        number: Which.
        world: What is wrong with it.
        radii: True radii of the wheels, left and right [m].
        track_width: True distance between them [m].
        dead_bands: Left and right [m/s].
        layout: Where everything stands; the start is that of no run.
    """

    number: int
    world: FieldWorld
    radii: tuple[float, float]
    track_width: float
    dead_bands: tuple[float, float]
    layout: Layout


def hidden_robot(number: int) -> HiddenRobot:
    """The robot with a number; everything hidden is drawn from it."""
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
    """The robot at the start of a run: of all that is random only the start and the noise differ between two."""
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
