"""MpcController against TrackingController: `python -m experiments.benchmarks tracking`.

Both drive the same certified dockings, forward and backward, and the same S-curves, in worlds with one disturbance
each, at 20, 50 and 100 Hz. Without `--identified` both are configured with the delay of the drive. Errors are true
errors: at the end relative to the goal, along the way relative to the nearest point of the path, from half a second
after the start or after the jump, which displaces the robot at once.
"""

from __future__ import annotations

import argparse
import math
import time
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from experiments.benchmarks.tables import Table
from optdock.controllers.mpc import MpcControllerParameters
from optdock.errors import OptdockError
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2, Twist2
from optdock.model.dock import Dock, DockDirection
from optdock.model.limits import MotionLimits
from optdock.model.path import Direction
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.planning.pipeline import plan_dock
from optdock.plugins.interfaces import Controller, GoalChecker
from optdock.plugins.lifecycle import PluginContext
from optdock.plugins.registry import create_plugin
from optdock.simulation import Actuation, SimulationSettings, run_closed_loop
from optdock.testing.drives import s_curve_drive

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from optdock.model.path import Path
    from optdock.model.trajectory import Trajectory
    from optdock.simulation import Run

__all__ = ["Case", "World", "cases", "drive", "main", "worlds"]

_STAGING, _SPREAD, _TURN = 0.7, 0.25, 0.25  # [m], [m], [rad]: default tolerances of Nav2's SimpleGoalChecker
_LIMITS = MotionLimits(
    max_speed=0.25, max_reverse_speed=0.25, max_acceleration=0.5, max_deceleration=0.5, max_yaw_rate=0.75,
    max_curvature=3.0, max_curvature_rate=30.0,
)  # fmt: skip
_DOCKING = Robot(Footprint.rectangle(0.3, 0.3, 0.5), _LIMITS)
_FASTER = Robot(Footprint.rectangle(0.4, 0.3, 0.5), MotionLimits(max_speed=0.5, max_reverse_speed=0.5))
_GOAL = Pose2(0.0, 0.0, 0.0)
_ACCEPTED = {"along_tolerance": 0.005, "cross_tolerance": 0.02, "yaw_goal_tolerance": 0.05}
_SETTLED = 0.5  # [s]
_NEAR = 1.5  # [s] before and after the reference: search window of the nearest point of the path
_RATES = (20, 50, 100)  # [Hz]


class World(NamedTuple):
    """A disturbance of the drive, of the measured poses, or once along the way; and the configured delay."""

    name: str
    actuation: Actuation
    position_noise: float = 0.0
    yaw_noise: float = 0.0
    jump: tuple[float, float] | None = None


class Case(NamedTuple):
    """A trajectory, and its robot."""

    name: str
    trajectory: Trajectory
    robot: Robot
    context: PluginContext


def worlds() -> tuple[World, ...]:
    """Return the worlds."""
    yaw = math.radians(0.1)
    late = Actuation(linear_lag=0.1, angular_lag=0.1, latency=0.06)
    return (
        World("perfect", Actuation()),
        World("lag, latency", late),
        World("lag, latency, noise", late, 0.002, yaw),
        World("dead band", Actuation(linear_dead_band=0.02, angular_dead_band=0.04)),
        World("wheel gains", Actuation(linear_gain=1.05, angular_gain=0.93)),
        World("jump, 0.6 m left", late, 0.002, yaw, jump=(0.03, 0.6)),
        World("jump, 0.27 m left", late, 0.002, yaw, jump=(0.03, 0.27)),
    )


def cases(starts: int) -> Iterator[Case]:
    """Return dockings from starts around the staging pose, forward and backward, and S-curves."""
    random = np.random.default_rng(1)
    radius, angle = _SPREAD * np.sqrt(random.uniform(size=starts)), random.uniform(-math.pi, math.pi, starts)
    turn = random.uniform(-_TURN, _TURN, starts)
    for k in range(starts):
        x, y = radius[k] * math.cos(angle[k]) - _STAGING, radius[k] * math.sin(angle[k])
        for direction, gear in ((DockDirection.FORWARD, 1.0), (DockDirection.BACKWARD, -1.0)):
            dock = Dock(_GOAL, direction=direction, approach_speed=0.1, approach_distance=0.1)
            problem = DockingProblem(Pose2(gear * float(x), gear * float(y), float(turn[k])), dock, _DOCKING)
            try:
                plan = plan_dock(problem, time_budget=1.0)
            except OptdockError:
                continue
            yield Case(f"docking {direction.value}", plan.trajectory, _DOCKING, PluginContext(problem=problem))
    for name, gear in (("S-curve", Direction.FORWARD), ("S-curve backward", Direction.REVERSE)):
        trajectory = s_curve_drive(Pose2(0.0, 0.0, 0.3), gear)
        problem = DockingProblem(trajectory.path.start, Dock(trajectory.path.end), _FASTER)
        yield Case(name, trajectory, _FASTER, PluginContext(problem=problem))


class _Observed(Controller):
    """A controller with timed calls and a lateral measurement error until the jump."""

    def __init__(self, inner: Controller, goal: Pose2, jump: tuple[float, float] | None) -> None:
        super().__init__()
        self.inner, self.goal, self.jump = inner, goal, jump
        self.cpu: list[float] = []
        self.jumped_at = 0 if jump is None else -1

    def set_path(self, path: Path | Trajectory, *, start_stamp: float | None = None) -> None:
        self.inner.set_path(path, start_stamp=start_stamp)

    def compute_velocity_commands(
        self, pose: Pose2, velocity: Twist2, goal_checker: GoalChecker | None, *, stamp: float | None = None
    ) -> Twist2:
        if self.jump is not None and self.jumped_at < 0:
            aside, left = self.jump
            if pose.distance_to(self.goal) > left:
                pose = pose @ Pose2(0.0, aside, 0.0)
            else:
                self.jumped_at = len(self.cpu)
        began = time.thread_time()
        try:
            return self.inner.compute_velocity_commands(pose, velocity, goal_checker, stamp=stamp)
        finally:
            self.cpu.append(time.thread_time() - began)

    def set_speed_limit(self, limit: float, percentage: bool) -> None:  # noqa: FBT001 - Nav2's order of arguments
        self.inner.set_speed_limit(limit, percentage)

    def reset(self) -> None:
        self.inner.reset()


class TrackedRun(NamedTuple):
    """A run, the CPU time of every call [s], and the time from which it counts."""

    run: Run
    cpu: list[float]
    since: int


def controller_of(method: str, world: World, *, known: bool, **parameters: object) -> Controller:
    """Return the tracking controller or the MPC, configured with the known delay of the drive."""
    drive, given = world.actuation, dict(parameters)
    given |= {"min_speed": drive.linear_dead_band, "min_yaw_rate": drive.angular_dead_band}
    if method == "MpcController":
        given |= {"latency": drive.latency, "lag": drive.linear_lag} if known else {}
    elif known:
        given["preview"] = drive.latency + drive.linear_lag
    return create_plugin(Controller, method, given)


def drive(case: Case, world: World, period: float, controller: Controller, seed: int) -> TrackedRun:
    """Return one run."""
    controller.configure(case.context)
    observed = _Observed(controller, case.trajectory.path.end, world.jump)
    start = case.trajectory.path.start
    settings = SimulationSettings(
        period=period,
        actuation=world.actuation,
        position_noise=world.position_noise,
        yaw_noise=world.yaw_noise,
        seed=seed,
        start=start @ Pose2(0.0, -world.jump[0], 0.0) if world.jump else start,
    )
    checker = create_plugin(GoalChecker, "DockGoalChecker", _ACCEPTED)
    run = run_closed_loop(case.trajectory, case.robot, case.trajectory.path.end, observed, checker, settings)
    return TrackedRun(run, observed.cpu, max(observed.jumped_at, 0))


def _off_path(trajectory: Trajectory, run: Run, first: int) -> tuple[float, float]:
    """Return the deviation from the path from row `first` on, across [m] and in heading [rad]."""
    t = np.arange(0.0, trajectory.duration, 0.002)
    row = trajectory.sample_at(t)
    path, window = np.column_stack((row.x, row.y, row.yaw)), round(_NEAR / 0.002)
    across = turned = 0.0
    for now, pose in zip(run.times[first:], run.poses[first:], strict=True):
        middle = round(min(now, trajectory.duration) / 0.002)
        near = path[max(0, middle - window) : middle + window]
        gap = pose - near
        k = int(np.argmin(np.hypot(gap[:, 0], gap[:, 1])))
        across = max(across, abs(math.cos(near[k, 2]) * gap[k, 1] - math.sin(near[k, 2]) * gap[k, 0]))
        turned = max(turned, abs(math.remainder(gap[k, 2], 2.0 * math.pi)))
    return across, turned


def _row(method: str, world: World, rate: int, driven: Sequence[tuple[Case, TrackedRun]]) -> tuple[object, ...]:
    period = 1.0 / rate
    final = np.abs([d.run.final_error.as_array() for _, d in driven]) * (1e3, 1e3, 180.0 / math.pi)
    off = [_off_path(case.trajectory, d.run, d.since + round(_SETTLED / period)) for case, d in driven]
    across, turned = 1e3 * np.array([a for a, _ in off]), np.degrees([b for _, b in off])
    over_a, over_j = [], []
    for case, d in driven:
        limits, v = case.robot.limits, np.append(0.0, d.run.commands[:-1, 0])
        a = np.diff(v) / period
        over_a.append(np.max(np.abs(a)) / max(limits.max_acceleration, limits.max_deceleration))
        over_j.append(np.max(np.abs(np.diff(a, prepend=0.0))) / period / limits.max_jerk)
    cpu = 1e3 * np.concatenate([d.cpu for _, d in driven])

    def spread(values: np.ndarray, digits: int) -> str:
        return " / ".join(f"{value:.{digits}f}" for value in (*np.percentile(values, [50, 95]), np.max(values)))

    return (
        world.name,
        rate,
        method.removesuffix("Controller"),
        f"{sum(d.run.docked for _, d in driven)}/{len(driven)}",
        spread(final[:, 1], 1),
        spread(final[:, 2], 2),
        spread(final[:, 0], 1),
        spread(across, 1),
        spread(turned, 1),
        f"{np.median([d.run.duration - case.trajectory.duration for case, d in driven]):+.2f}",
        f"{max(over_a):.2f}",
        f"{max(over_j):.1f}",
        f"{np.percentile(cpu, 50):.2f}/{np.percentile(cpu, 99):.2f}",
    )


_TUNED = {  # ranges, searched uniformly in the logarithm
    "horizon": (0.5, 1.0),
    "along_error": (0.005, 0.05),
    "cross_error": (0.003, 0.03),
    "yaw_error": (0.02, 0.3),
    "speed_effort": (0.03, 0.3),
    "yaw_rate_effort": (0.05, 0.5),
    "smoothness": (0.05, 0.6),
    "final_weight": (1.0, 100.0),
}
_TUNING_PERIOD = 1.0 / 30.0  # [s]
_TUNING_WORLDS = ("lag, latency", "lag, latency, noise", "wheel gains", "jump, 0.6 m left", "jump, 0.27 m left")


def _badness(parameters: dict[str, float], drives: Sequence[Case]) -> float:
    """Return the mean over worlds: errors at the end over 3 mm, 3 mm and 0.3 degrees, and along the way over 10 mm."""
    parts = []
    for world in (world for world in worlds() if world.name in _TUNING_WORLDS):
        driven = [
            (
                case,
                drive(case, world, _TUNING_PERIOD, controller_of("MpcController", world, known=True, **parameters), k),
            )
            for k, case in enumerate(drives)
        ]
        final = np.abs([d.run.final_error.as_array() for _, d in driven]) / (0.003, 0.003, math.radians(0.3))
        settled = round(_SETTLED / _TUNING_PERIOD)
        way = [_off_path(case.trajectory, d.run, d.since + settled)[0] / 0.01 for case, d in driven]
        failed = sum(not d.run.docked for _, d in driven)
        parts.append(float(np.percentile(final, 95, axis=0).sum() + np.mean(way)) + 10.0 * failed)
    return float(np.mean(parts))


def tune(samples: int, drives: Sequence[Case]) -> None:
    """Search weights at random, then around the best; print every improvement."""
    random, best = np.random.default_rng(0), math.inf
    found = {name: float(MpcControllerParameters.model_fields[name].default) for name in _TUNED}
    for k in range(samples):
        parameters: dict[str, float] = {}
        for name, (low, high) in _TUNED.items():
            value = low * (high / low) ** random.uniform()
            if k > samples // 2:
                value = float(np.clip(found[name] * math.exp(random.normal(0.0, 0.3)), low, high))
            parameters[name] = value
        if k == 0:
            parameters = dict(found)
        badness = _badness(parameters, drives)
        if badness < best:
            best, found = badness, parameters
            print(
                f"{k}: {badness:.3f}", {name: float(f"{value:.3g}") for name, value in parameters.items()}, flush=True
            )


_HEADER = (
    "world", "Hz", "controller", "docked", "across, mm", "yaw, degrees", "along, mm", "way, mm",
    "way, degrees", "time, s", "acc/limit", "jerk/limit", "CPU ms p50/p99",
)  # fmt: skip


def main(arguments: Sequence[str]) -> None:
    """Run everything; print the tables, dockings and S-curves apart."""
    parser = argparse.ArgumentParser(prog="python -m experiments.benchmarks tracking", description=__doc__)
    parser.add_argument(
        "--starts", type=int, default=20, help="number of dockings in either direction (default: %(default)s)"
    )
    parser.add_argument(
        "--rates", default=",".join(map(str, _RATES)), help="control rates in Hz (default: %(default)s)"
    )
    parser.add_argument(
        "--identified", action="store_true", help="let both controllers identify the delay of the drive"
    )
    parser.add_argument("--worlds", default="", help="comma-separated parts of world names; default: all")
    parser.add_argument("--tune", type=int, default=0, help="search the weights of the MPC with this number of samples")
    options = parser.parse_args(list(arguments))
    if options.tune:
        tune(options.tune, list(cases(options.starts))[:-2])
        return
    drives = list(cases(options.starts))
    chosen = [w for w in worlds() if any(part in w.name for part in options.worlds.split(","))]
    for title, group in (
        ("Dockings", [case for case in drives if case.robot is _DOCKING]),
        ("S-curves", [case for case in drives if case.robot is _FASTER]),
    ):
        rows = []
        for world in chosen:
            for rate in map(int, options.rates.split(",")):
                for method in ("TrackingController", "MpcController"):
                    found = [
                        (
                            case,
                            drive(
                                case,
                                world,
                                1.0 / rate,
                                controller_of(method, world, known=not options.identified),
                                k,
                            ),
                        )
                        for k, case in enumerate(group)
                    ]
                    rows.append(_row(method, world, rate, found))
        print(Table(title, _HEADER, tuple(rows), "errors p50/p95/max"), flush=True)
