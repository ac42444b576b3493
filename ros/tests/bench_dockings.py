"""Dockings of the simulated robot through the `dock_robot` action: how many succeed, how exactly, at which rate.

    make bench-ros ARGS='--count 100'          # in real time: 20 minutes
    python ros/tests/bench_dockings.py --speed 4   # on a clock four times as fast, the server at four times its rate
    python ros/tests/bench_dockings.py --robots 2  # one robot without and one in a namespace, at the same time
    python ros/tests/bench_dockings.py --world field   # the study's robot with all imperfections, see field_robot.py

The worlds are those of the docking study, `experiments.docking`, with detections: a bay with posts about, the dock up
to 10 cm and 5 degrees from where it is stored, lag and latency in the drive, noisy localization and pictures, of which
some show nothing. Every second docking is backward, every second pair from further away. What counts is the true pose:
within 10 mm, 10 mm and 1.5 degrees of the true dock, and nothing touched but the station.

In a field world the robot is the one of `experiments.docking --world`, with the same seeds.

The rate is that of the stamps in cmd_vel (with a clock of its own: of their arrival). A command falls into the time of
planning where the server's planning process used the processor since the one before.
"""

from __future__ import annotations

import argparse
import csv
import math
import os
import sys
import tempfile
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TwistStamped
from harness import Client, Lifecycle, Processes, free_domain, ros
from launch_stand_in import launched
from nav2_msgs.action import DockRobot
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from experiments.docking.cases import SPREADS, STATION, Layout
from experiments.docking.field.outcome import FieldTask
from experiments.docking.field.run import set_up
from experiments.docking.field.worlds import FIELD_WORLDS
from experiments.docking.worlds import DETECTED, case_of
from optdock.config import Scenario, save_scenario
from optdock.geometry.pose import Pose2
from optdock.model.dock import DockDirection

if TYPE_CHECKING:
    from collections.abc import Sequence


ALONG, CROSS, YAW = 0.010, 0.010, math.radians(1.5)  # of a docking that counts [m], [m], [rad]
OVERLAP = -0.0075  # [m] with the station, which is touched: the front corners of a robot turned by 1.5 degrees
FREQUENCY = 50.0  # [Hz] of the server, on the simulated clock
SAMPLING = 0.01  # [s]: the kernel counts processor time in such ticks
LONGEST = 120.0  # [s] for one docking, of wall clock
FIELD_ROBOT = Path(__file__).with_name("field_robot.py")
BACKWARD_WORLD = "field, rear camera"  # for every second docking in the world "field", which is forward
SETTLED = 0.5  # [s] after the end, until the report is believed


class Start(NamedTuple):
    """A docking: its number, world and spread by name, and problem and true dock."""

    number: int
    world: str
    spread: str
    layout: Layout


class Docking(NamedTuple):
    """The result of a docking."""

    robot: str
    number: int
    spread: str
    direction: str
    code: int
    success: bool
    retries: int
    along: float
    cross: float
    yaw: float
    clearance: float
    station_clearance: float
    duration: float
    last_command_is_zero: bool
    text: str

    @property
    def is_exact(self) -> bool:
        """Whether the true error is within the limits."""
        return abs(self.along) <= ALONG and abs(self.cross) <= CROSS and abs(self.yaw) <= YAW

    @property
    def collided(self) -> bool:
        """Whether the robot has collided."""
        return self.clearance < 0.0 or self.station_clearance < OVERLAP


class Processor:
    """Samples the processor time of a server and of its planning process."""

    def __init__(self, pid: int) -> None:
        self.pid = pid
        self.samples: list[tuple[float, float, float]] = []
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def end(self) -> None:
        """Join the thread."""
        self._ended.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._ended.wait(SAMPLING):
            with suppress(FileNotFoundError, ProcessLookupError):  # a child has just ended
                inner = sum(spent(child) for child in children(self.pid))
                self.samples.append((time.time(), spent(self.pid), inner))


def children(pid: int) -> list[int]:
    """Return the child processes."""
    tasks = Path(f"/proc/{pid}/task").glob("*/children")
    return [int(word) for task in tasks for word in task.read_text().split()]


def spent(pid: int) -> float:
    """Return the processor time of a process [s]."""
    words = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


def text_of(vertices: Any) -> str:
    """Return an outline in Nav2's syntax."""
    return "[" + ", ".join(f"[{x:.6g}, {y:.6g}]" for x, y in vertices.tolist()) + "]"


def server_parameters(speed: float, world: str) -> dict[str, object]:
    """Return the parameters of the docking server, with a dock type for each gear; goals contain the docks."""
    dock, pose = DETECTED.dock, DETECTED.pose
    assert dock is not None
    executor: dict[str, float] = {"position_sigma": pose.position_sigma, "yaw_sigma": pose.yaw_sigma}
    sigmas = dock.position_sigma, dock.yaw_sigma
    if world in FIELD_WORLDS:  # of the localization: defaults; of the camera: at a distance of 1 m
        executor, sigmas = dict(FIELD_WORLDS[world].executor_settings), FIELD_WORLDS[world].camera.sigmas(1.0)
    kind = {
        "plugin": "opennav_docking::SimpleChargingDock",
        "use_external_detection_pose": True,
        "external_detection_timeout": 1.0,
        "detection_position_sigma": sigmas[0],
        "detection_yaw_sigma": sigmas[1],
        "staging_x_offset": -0.7,
    }
    blocks: dict[str, object] = {
        "use_sim_time": speed > 0.0,
        "enable_stamped_cmd_vel": True,  # whatever ROS_DISTRO is
        "controller_frequency": FREQUENCY * (speed or 1.0),
        "dock_plugins": ["forward", "backward"],
        "forward": {**kind, "dock_direction": "forward", "dock": {"footprint": text_of(STATION.vertices)}},
        "backward": {
            **kind,
            "dock_direction": "backward",
            "staging_yaw_offset": math.pi,
            "dock": {"footprint": text_of(-STATION.vertices)},
        },
        "executor": executor,
        "clearance": {"required": 0.05, "at_dock": 0.0, "taper": 0.5},
    }
    if world in FIELD_WORLDS:
        blocks["dock"] = {"tolerances": {"along": ALONG, "cross": CROSS, "yaw": YAW}}
    return {name: block for name, block in blocks.items() if block != {}}


def robot_parameters(speed: float) -> dict[str, object]:
    """Return the parameters of the simulated robot: the world `detected` of the study, with 5 % drop-outs."""
    dock, pose, drive = DETECTED.dock, DETECTED.pose, DETECTED.actuation
    assert dock is not None
    return {
        "speed": speed,
        "actuation.linear_lag": drive.linear_lag,
        "actuation.angular_lag": drive.angular_lag,
        "actuation.latency": drive.latency,
        "localization.position_sigma": pose.position_sigma,
        "localization.yaw_sigma": pose.yaw_sigma,
        "detection.rate": dock.rate,
        "detection.latency": dock.latency,
        "detection.position_sigma": dock.position_sigma,
        "detection.yaw_sigma": dock.yaw_sigma,
        "detection.drop_out": 0.05,
        "detection.field_of_view": 2.0 * math.pi,
        "costmap.size": 6.0,  # robot and dock in one window: what lies outside is not known to be free
    }


class Bench:
    """A robot and its server, and a client of them, set up once.

    Args:
        processes: Starts the processes.
        namespace: Namespace of the robot, for example "/robot1"; empty for the root.
        options: Command line.
    """

    def __init__(self, processes: Processes, namespace: str, options: argparse.Namespace) -> None:
        self.namespace, self.folder = namespace, processes.folder / (namespace.strip("/") or "root")
        self.folder.mkdir()
        file = self.folder / "parameters.yaml"
        self.world = options.world
        blocks = {"docking_server": server_parameters(options.speed, options.world)}
        if self.world not in FIELD_WORLDS:
            blocks["simulated_robot"] = robot_parameters(options.speed)
        file.write_text(yaml.safe_dump({name: {"ros__parameters": block} for name, block in blocks.items()}))
        found = launched("simulated_docking.launch.py", self.folder, params_file=str(file), namespace=namespace)
        if self.world in FIELD_WORLDS:
            program = self.folder / "field_robot"
            program.write_text(f'#!/bin/sh\nexec "{sys.executable}" "{FIELD_ROBOT}" "$@"\n')
            program.chmod(0o755)
            processes(str(program), args=["-r", f"__ns:={namespace or '/'}", "-r", "/tf:=tf"])
            found = [one for one in found if one.executable != "simulated_robot"]
        own_clock = ["-r", "/clock:=clock"] if namespace else []
        *_, server = [processes(one.executable, args=[*one.arguments, *own_clock]) for one in found]
        self.client = Client(f"client_{self.folder.name}")
        self.commands: list[tuple[float, float, float, float]] = []
        self.reports: list[DiagnosticArray] = self.client.heard(DiagnosticArray, f"{namespace}/simulated_robot/report")
        self.client.create_subscription(TwistStamped, f"{namespace}/cmd_vel", self._take, 200)
        self.client.until(lambda: self.reports)
        life = Lifecycle(self.client, f"{namespace}/docking_server")
        self.client.until(lambda: life.state == "active")
        self.processor = Processor(server.pid)

    def end(self) -> None:
        """End the threads."""
        self.processor.end()
        self.client.end()

    def dockings(self, starts: Sequence[Start]) -> list[Docking]:
        """Run dockings."""
        found = []
        for start in starts:
            found.append(self.dock(start))
            sys.stderr.write(f"{found[-1]}\n")
        return found

    def _take(self, message: TwistStamped) -> None:
        stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        self.commands.append((time.time(), stamp, message.twist.linear.x, message.twist.angular.z))

    def place(self, start: Start) -> None:
        """Put the robot in front of the dock."""
        problem, seed = start.layout.problem, start.number
        if self.world in FIELD_WORLDS:
            values: dict[str, object] = {"world": start.world, "spread": start.spread, "seed": seed}
        else:
            file = self.folder / f"{seed}.yaml"
            save_scenario(file, Scenario(problem))
            offset = start.layout.true_dock.in_frame_of(problem.goal)
            values = {"scenario": str(file), "dock_offset": [offset.x, offset.y, offset.yaw], "seed": seed}
        request = SetParameters.Request(
            parameters=[Parameter(k, value=v).to_parameter_msg() for k, v in values.items()]
        )
        results = self.client.call(SetParameters, f"{self.namespace}/simulated_robot/set_parameters", request).results
        assert all(result.successful for result in results), results
        answer = self.client.call(Trigger, f"{self.namespace}/simulated_robot/reset")
        assert answer.success, answer.message
        time.sleep(SETTLED)

    def dock(self, start: Start) -> Docking:
        """Run one docking."""
        self.place(start)
        direction = start.layout.direction
        backward = direction is DockDirection.BACKWARD
        into = start.layout.problem.goal @ Pose2(0.0, 0.0, math.pi if backward else 0.0)
        goal = DockRobot.Goal(use_dock_id=False, dock_type=direction.value, navigate_to_staging_pose=False)
        goal.dock_pose.header.frame_id = "map"
        goal.dock_pose.pose.position.x, goal.dock_pose.pose.position.y = into.x, into.y
        goal.dock_pose.pose.orientation.z = math.sin(0.5 * into.yaw)
        goal.dock_pose.pose.orientation.w = math.cos(0.5 * into.yaw)
        began = time.monotonic()
        reply = self.client.send(DockRobot, f"{self.namespace}/dock_robot", goal).reply(LONGEST)
        duration = time.monotonic() - began
        time.sleep(SETTLED)
        told = {item.key: item.value for item in self.reports[-1].status[0].values}
        numbers = (float(told[key]) for key in ("along", "cross", "yaw", "clearance", "station_clearance"))
        result = reply.result
        still = not self.commands or self.commands[-1][2:] == (0.0, 0.0)
        return Docking(
            self.namespace, start.number, SPREADS[start.spread].name, direction.value, result.error_code,
            result.success, result.num_retries, *numbers, duration, still, result.error_msg,
        )  # fmt: skip


def table(found: Sequence[Docking]) -> str:
    """Return a summary."""
    good = [one for one in found if one.success and one.is_exact and not one.collided]
    lines = [
        f"{len(good)} of {len(found)} docked within 10 mm, 10 mm, 1.5 degrees; "
        f"{sum(one.success for one in found)} reported as docked, {sum(one.collided for one in found)} collided, "
        f"{sum(not one.last_command_is_zero for one in found)} left a command behind"
    ]
    docked = [one for one in found if one.success] or found
    for name, values, unit in (
        ("|along|", [1e3 * abs(one.along) for one in docked], "mm"),
        ("|cross|", [1e3 * abs(one.cross) for one in docked], "mm"),
        ("|yaw|", [math.degrees(abs(one.yaw)) for one in docked], "degrees"),
        ("duration", [one.duration for one in docked], "s"),
        ("retries", [one.retries for one in docked], ""),
    ):
        p50, p95 = np.percentile(values, [50, 95])
        lines.append(f"{name:10} p50 {p50:.2f}  p95 {p95:.2f}  max {max(values):.2f} {unit}")
    lines.append(f"clearance to obstacles, smallest: {1e3 * min(one.clearance for one in found):.0f} mm")
    lines += [f"  {one.robot} {one.number} {one.spread} {one.direction}: {one}" for one in found if one not in good]
    return "\n".join(lines)


def rates(commands: Sequence[tuple[float, ...]], processor: Processor, speed: float) -> str:
    """Return statistics of the periods of commands, during planning and otherwise."""
    times = np.array([row[0 if speed else 1] for row in commands])
    samples = np.array(processor.samples)
    period = 1.0 / (FREQUENCY * (speed or 1.0))
    steps = np.diff(times)
    within = steps < 10.0 * period  # longer: another docking
    busy = np.diff(np.interp(times, samples[:, 0], samples[:, 2])) > 0.0
    lines = []
    for name, chosen in (("while planning", within & busy), ("else", within & ~busy)):
        off = 1e3 * np.abs(steps[chosen] - period)
        if off.size:
            p50, p99 = np.percentile(off, [50, 99])
            lines.append(
                f"cmd_vel, {name}: {off.size} periods of {1e3 * period:.0f} ms, off by p50 {p50:.2f}  p99 {p99:.2f}  "
                f"max {off.max():.2f} ms"
            )
    lines.append(f"gaps of 10 periods and more within a docking or between: {int(np.sum(~within))}")
    wall = samples[-1, 0] - samples[0, 0]
    server, planner = (float(np.ptp(samples[:, column])) / wall for column in (1, 2))
    lines.append(f"processor: server {100 * server:.0f} %, its planning process {100 * planner:.0f} % of a core")
    return "\n".join(lines)


def starts_of(options: argparse.Namespace) -> list[Start]:
    """Return the dockings of the command line."""
    found: list[Start] = []
    number = options.first
    while len(found) < options.count:
        world, spread = options.world, "nav2" if number // 2 % 2 == 0 else "wider"
        if world in FIELD_WORLDS:
            world = BACKWARD_WORLD if number % 2 and world == "field" else world
            layout = set_up(FieldTask("", world, spread, FREQUENCY, number))[0]
        else:
            layout = Layout(*case_of(number, SPREADS[spread], DETECTED)[1:])
        if options.direction in {"both", layout.direction.value}:
            found.append(Start(number, world, spread, layout))
        number += 1
    return found


def docked(options: argparse.Namespace, folder: Path) -> tuple[list[Docking], str]:
    """Run all dockings, the robots at the same time; return them and the tables of the rates."""
    processes, benches, starts = Processes(folder), list[Bench](), starts_of(options)
    try:
        for number in range(options.robots):
            namespace = f"/robot{number + 1}" if number or options.namespaced else ""
            benches.append(Bench(processes, namespace, options))
        share = math.ceil(len(starts) / options.robots)
        shares = [starts[begin : begin + share] for begin in range(0, len(starts), share)]
        with ThreadPoolExecutor(options.robots) as pool:
            found = [one for part in pool.map(Bench.dockings, benches, shares) for one in part]
        told = [f"{one.namespace}\n{rates(one.commands, one.processor, options.speed)}" for one in benches]
        return found, "\n".join(told).lstrip()
    finally:
        for bench in benches:
            bench.end()
        processes.end()
        for process in processes.started:
            (options.out / process.log_file.name).write_text(process.log())


def main(arguments: Sequence[str] | None = None) -> int:
    """Run and print; return 1 if fewer than 98 % succeed or one collides."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=100, help="dockings (default: %(default)s)")
    parser.add_argument("--robots", type=int, default=1, help="robots that share the dockings, at the same time")
    parser.add_argument("--namespaced", action="store_true", help="the first robot in a namespace, as the others")
    parser.add_argument("--direction", choices=["both", "forward", "backward"], default="both", help="of the dockings")
    parser.add_argument("--first", type=int, default=0, help="number of the first one")
    parser.add_argument("--speed", type=float, default=0.0, help="of the clock; 0: real time (default)")
    parser.add_argument(
        "--world", choices=["detected", *FIELD_WORLDS], default="detected", help="of the robot (default: %(default)s)"
    )
    parser.add_argument("--out", type=Path, default=Path("results") / "ros")
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    domain, keeper = free_domain()
    with keeper, tempfile.TemporaryDirectory() as name:
        ours = {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "OMP_NUM_THREADS": "1"}
        os.environ.update(ours, ROS_LOG_DIR=name)
        with ros(domain):
            found, told = docked(options, Path(name))
    with (options.out / "dockings.csv").open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([Docking._fields, *found])
    print(f"{table(found)}\n{told}")
    good = sum(one.success and one.is_exact for one in found)
    return 0 if good >= 0.98 * len(found) and not any(one.collided for one in found) else 1


if __name__ == "__main__":
    sys.exit(main())
