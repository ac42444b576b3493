"""The pictures of the demo, drawn from its recording."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import yaml
from optdock_ros.simulation_parameters import PARAMETERS, SimulationParameters

from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2
from optdock.plotting.canvas import COLOURS, legend_below, new_figure, save_figure
from optdock.plotting.marker_picture import draw_marker_array
from optdock.plotting.scene import OutlineStyle, draw_footprints, draw_scene, draw_sweep, view_of
from optdock.ros.bag import open_bag
from optdock.ros.motion import plain_pose

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from optdock.geometry.arrays import FloatArray
    from optdock.model.problem import DockingProblem
    from optdock.plotting.scene import View
    from optdock.ros.messages import Message

EVERY = 0.1  # [m] between drawn outlines, as between those of the markers
ALL = (-math.inf, math.inf)  # times
AT_REST = 0.001  # [m/s]


class Drive(NamedTuple):
    """Contents of the recording.

    Attributes:
        truth: Time and true pose in the map, Shape (n, 4).
        commands: Time, speed and yaw rate, Shape (n, 3).
        markers: Of the first plan.
        frame: True pose of the markers' frame in the map.
        docked: Time and report of the docked robot at rest.
    """

    truth: FloatArray
    commands: FloatArray
    markers: Message
    frame: Pose2
    docked: tuple[float, dict[str, str]]


def draw(recording: Path, parameters: Path, out: Path) -> Iterator[str]:
    """Draw plan and drive; yield the true error and the names of the pictures."""
    values = yaml.safe_load(parameters.read_text(encoding="utf-8"))["simulated_robot"]["ros__parameters"]
    world = SimulationParameters({name: default for name, (default, _) in PARAMETERS.items()} | values)
    drive = read(recording)
    _, told = drive.docked
    along, cross = (round(1e3 * float(told[name]), 1) + 0.0 for name in ("along", "cross"))  # without -0.0
    yaw, clearance = round(math.degrees(float(told["yaw"])), 2) + 0.0, round(1e3 * float(told["clearance"]))
    errors = f"{along} mm along, {cross} mm across, {yaw} degrees"
    yield f"true error of the docked pose: {errors}; closest to an obstacle: {clearance} mm"
    problem = dataclasses.replace(world.problem, dock=dataclasses.replace(world.problem.dock, pose=world.dock))
    for name, drawing, height in (("plan.png", draw_plan, 6.9), ("drive.png", draw_drive, 8.5)):
        figure = new_figure(10.0, height)
        axes = drawing(figure, problem, drive)
        station = problem.dock.footprint
        if station is not None:
            stored = OutlineStyle(edge=COLOURS["dock"], line=":", width=1.5, order=4.0, label="dock, as stored")
            draw_footprints(axes, station, world.problem.goal.as_array()[None], stored)
        legend_below(figure, axes)
        save_figure(figure, out / name)
        yield f"written: {out / name}"


def read(recording: Path) -> Drive:
    """Read what the pictures need.

    Raises:
        AssertionError: If the robot was never at rest in contact.
    """
    with open_bag(recording) as bag:
        truth = [(stamp(m), *pose(m).as_array()) for _, m in bag.messages("/simulated_robot/truth", *ALL)]
        odometry = {stamp(m): pose(m) for _, m in bag.messages("/odom", *ALL)}
        commands = [(stamp(m), m.twist.linear.x, m.twist.angular.z) for _, m in bag.messages("/cmd_vel", *ALL)]
        plans = bag.messages("/docking_server/markers", *ALL)
        markers = next(message for _, message in plans if len(message.markers) > 1)
        reports = [message for _, message in bag.messages("/simulated_robot/report", *ALL)]
    # The markers are in the frame of the odometry, whose true pose in the map follows from both poses of the robot.
    planned, *here = next(row for row in truth if row[0] >= stamp(markers.markers[0]) and row[0] in odometry)
    frame = Pose2(*here) @ odometry[planned].inverse()
    told = [(stamp(message), {item.key: item.value for item in message.status[0].values}) for message in reports]
    docked = [row for row in told if row[1]["contact"] == "True" and abs(float(row[1]["speed"])) < AT_REST]
    assert docked, "the robot was never at rest in contact with the station"
    return Drive(np.array(truth), np.array(commands), markers, frame, docked[-1])


def pose(message: Message) -> Pose2:
    """Return the pose of an `Odometry`."""
    return plain_pose(message, message.pose.pose, "pose.pose")


def stamp(message: Message) -> float:
    """Return the stamp of a message [s]."""
    return float(message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec)


def draw_plan(figure: Figure, problem: DockingProblem, drive: Drive) -> Axes:
    """Draw the markers of the first plan as in RViz, and the driven path."""
    axes = figure.add_subplot()
    docking = drive.truth[drive.truth[:, 0] <= drive.docked[0], 1:]
    draw_scene(axes, problem, close_view(problem, docking))
    axes.plot(docking[:, 0], docking[:, 1], color=COLOURS["raw"], linewidth=5.0, alpha=0.6, label="driven")
    draw_marker_array(axes, drive.markers, drive.frame, points_per_metre=100.0)
    axes.set_title("Markers of the first plan, and the driven path")
    return axes


def draw_drive(figure: Figure, problem: DockingProblem, drive: Drive) -> Axes:
    """Draw the swept area of docking and undocking, and the commands."""
    grid = figure.add_gridspec(2, 1, height_ratios=(2.2, 1.0))
    axes, below = figure.add_subplot(grid[0]), figure.add_subplot(grid[1])
    times, poses = drive.truth[:, 0], drive.truth[:, 1:]
    draw_scene(axes, problem, close_view(problem, poses))
    driven = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))))
    rows = np.searchsorted(driven, np.arange(0.0, driven[-1], EVERY))
    draw_sweep(axes, problem.robot.footprint, poses[rows])
    last = int(np.searchsorted(times, drive.docked[0]))
    for part, colour, label in ((poses[:last], "path", "docking"), (poses[last:], "reverse", "undocking")):
        axes.plot(part[:, 0], part[:, 1], color=COLOURS[colour], linewidth=1.8, label=label, zorder=5)
    style = OutlineStyle(edge="black", width=1.2, order=4.0, label="docked robot")
    draw_footprints(axes, problem.robot.footprint, poses[last : last + 1], style)
    start = drive.commands[0, 0]
    for column, colour, label in ((1, "path", "speed [m/s]"), (2, "goal", "yaw rate [rad/s]")):
        below.plot(drive.commands[:, 0] - start, drive.commands[:, column], color=COLOURS[colour], label=label)
    below.axvline(drive.docked[0] - start, color="black", linestyle=":", label="end of contact")
    below.set(xlabel="time since the first command [s]", ylabel="cmd_vel")
    below.grid(visible=True, color="#e5e5e5", linewidth=0.5)
    below.legend(loc="best", fontsize=8)
    axes.set_title("Area swept by the robot at its true poses, and the commands")
    return axes


def close_view(problem: DockingProblem, poses: FloatArray) -> View:
    """Return a view of robot and dock; obstacles do not widen it."""
    return view_of(dataclasses.replace(problem, obstacles=ObstacleSet.empty()), [poses])
