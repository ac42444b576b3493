"""Table of faults: faults injected during docking, and how the executor ends."""

from __future__ import annotations

import collections
import itertools
import math
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from multiprocessing import get_context
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from experiments.docking.cases import SPREADS
from experiments.docking.methods import CHECKER
from experiments.docking.outcome import outcome_of
from experiments.docking.watched import WatchedPlanning
from experiments.docking.worlds import WORLDS, Case, World, case_of
from optdock.deadline import set_clock
from optdock.executor import DockingExecutor, ExecutorSettings, State
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2, Twist2, transform_points
from optdock.model.costmap import Costmap
from optdock.model.costs import LETHAL
from optdock.model.measurements import Measurements, OdometryPose
from optdock.plugins.registry import PluginChoice
from optdock.reports.report import table
from optdock.samples.tube import Tube
from optdock.simulation import (
    DifferentialDrive,
    Sensors,
    SimulatedRobot,
    Station,
    StuckWheel,
    Wheel,
    Wheels,
    executed_clearance,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from experiments.docking.outcome import Outcome
    from optdock.executor import Step
    from optdock.geometry.arrays import FloatArray

__all__ = ["FAULTS", "FaultOutcome", "fault_table"]

COUNT, RATE, TIMEOUT = 20, 50.0, 240.0  # runs of each fault; [Hz]; [s]
TRACK = 0.4  # [m]
BOX = np.array([[0.0, -0.1], [0.1, -0.1], [0.1, 0.1], [0.0, 0.1]])  # [m], obstacle on the path
STAGING = 1.4  # [m]: far enough from the dock for an obstacle 0.5 m ahead
FRONT = 0.3  # [m]: distance of the robot's front from its origin in either gear
DRIVING = (State.STAGING, State.APPROACHING, State.RETURNING, State.BACKING_OUT, State.PRESSING, State.UNDOCKING)
STILL = 1e-3  # [m/s], [rad/s]
LONGEST_STILL = 5.0  # [s]: longest allowed standstill in a driving state
OVERLAP = -0.0075  # [m]: allowed overlap with the touched station: the front corners of a robot turned by 1.5 degrees


class FaultOutcome(NamedTuple):
    """Result of one run with a fault.

    Attributes:
        outcome: Outcome as in the docking study.
        standing: Longest time without motion in a driving state [s].
        station: Smallest clearance to the station [m].
        at_rest: Whether the robot stands at the end.
        struck: Whether the fault occurred.
    """

    outcome: Outcome
    standing: float
    station: float
    at_rest: bool
    struck: bool


@dataclass
class Run:
    """State of one run that a fault can modify before every cycle."""

    case: Case
    robot: SimulatedRobot
    executor: DockingExecutor
    planning: WatchedPlanning
    step: Step | None = None
    period: float = 1.0 / RATE
    clock: float = 0.0  # [s] added to every stamp
    struck: bool = False
    blind: bool = False
    # modification of the measurements while the fault is active
    change: Callable[[Measurements], Measurements] | None = None
    lost_commands: bool = False
    box: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))
    memory: dict[str, float] = field(default_factory=dict)

    @property
    def to_go(self) -> float:
        """Distance from the true dock [m]."""
        return math.hypot(self.robot.error.x, self.robot.error.y)

    def once(self, *, when: bool) -> bool:
        """Return True the first time that the condition `when` holds."""
        if self.struck or not when:
            return False
        self.struck = True
        return True

    def is_within(self, distance: float) -> bool:
        """Return True the first time that the approach is within the distance."""
        approaching = self.step is not None and self.step.state is State.APPROACHING
        return self.once(when=approaching and self.to_go < distance)


def no_fault(run: Run) -> None:
    """No fault, for comparison."""
    run.struck = True


def lost(run: Run) -> None:
    """Lose all detections for 2 s."""
    if run.is_within(0.5) and run.robot.dock_sensor is not None:
        run.robot.dock_sensor.lose(run.robot.time + 2.0)


def outlier(run: Run) -> None:
    """Shift one detection by 30 cm laterally."""
    if run.is_within(0.5) and run.robot.dock_sensor is not None:
        run.robot.dock_sensor.displace_next(Pose2(0.0, 0.3, 0.1))


def jump(distance: float, off: float) -> Callable[[Run], None]:
    """Let the localization jump laterally."""

    def fault(run: Run) -> None:
        if run.is_within(distance):
            yaw = run.robot.state.pose.yaw
            run.robot.pose_sensor.jump(Pose2(-off * math.sin(yaw), off * math.cos(yaw), 0.0))

    return fault


def late(run: Run) -> None:
    """Delay one cycle per second by 100 ms."""
    run.struck = True
    run.period = 0.1 + 1.0 / RATE if math.floor(run.robot.time) > run.memory.get("late", 0.0) else 1.0 / RATE
    run.memory["late"] = float(math.floor(run.robot.time))


def clock_back(run: Run) -> None:
    """Set the clock back by half a second."""
    if run.is_within(0.4):
        run.clock -= 0.5


def obstacle(stays: float) -> Callable[[Run], None]:
    """Place a box on the path, 0.5 m ahead of the front; the robot detects it at once, and it disappears later."""

    def fault(run: Run) -> None:
        if run.step is not None and run.step.state is State.APPROACHING and not run.struck:
            plan = run.planning.followed[-1].plan
            assert plan is not None
            s = Tube(plan.path, plan.problem).deviations(run.robot.state.pose.as_array()[None]).s[0]
            ahead = Pose2.from_sequence(plan.path.poses_at(s + FRONT + 0.5)[0])
            if run.once(when=s > 0.05 and s + FRONT + 0.5 <= plan.path.length):
                box = transform_points(ahead.as_array()[None], BOX)[0]
                run.box, run.memory["box since"] = box, run.robot.time
                run.memory["until"] = run.robot.time + stays
                run.robot.put(run.case.obstacles() + ObstacleSet.from_polygons([box]), _grid(run.case, box))
        elif run.struck and "gone" not in run.memory and run.robot.time >= run.memory["until"]:
            run.memory["gone"] = 1.0
            run.robot.put(run.case.obstacles(), _grid(run.case, None))

    return fault


def _grid(case: Case, box: np.ndarray | None) -> Costmap:
    """Return a local costmap: 2 cm cells, 3 m around the dock, containing only the box."""
    side, cell = 300, 0.02
    origin = case.true_dock.x - 0.5 * side * cell, case.true_dock.y - 0.5 * side * cell
    data = np.zeros((side, side), dtype=np.uint8)
    if box is not None:
        steps = np.linspace(0.0, 1.0, 30)
        inside = [box[0] + u * (box[1] - box[0]) + v * (box[3] - box[0]) for u in steps for v in steps]
        columns, rows = np.floor((np.array(inside) - origin) / cell).astype(int).T
        data[rows, columns] = LETHAL
    return Costmap(data, cell, origin)


def pose_lost(run: Run) -> None:
    """Lose the localization."""
    if run.is_within(0.6):
        run.blind = True


def detections_lost(run: Run) -> None:
    """Lose the dock detections."""
    if run.is_within(0.6) and run.robot.dock_sensor is not None:
        run.robot.dock_sensor.lose(math.inf)


def changed_measurements(
    distance: float, lasts: float, change: Callable[[Run], Callable[[Measurements], Measurements]]
) -> Callable[[Run], None]:
    """Return a fault that changes the measurements from a distance to the dock [m], for a duration [s]."""

    def fault(run: Run) -> None:
        if run.is_within(distance):
            run.memory["until"] = run.robot.time + lasts
            run.change = change(run)
        elif run.change is not None and run.robot.time >= run.memory["until"]:
            run.change = None

    return fault


def no_number(_: Run) -> Callable[[Measurements], Measurements]:
    """Let localization and odometry return NaN."""
    return lambda now: now._replace(pose=math.nan, twist=math.nan)  # type: ignore[arg-type]  # on purpose


def same_stamp(run: Run) -> Callable[[Measurements], Measurements]:
    """Stop the clock."""
    stamp = run.robot.time + run.clock
    return lambda now: now._replace(stamp=stamp)


def held(_: Run) -> Callable[[Measurements], Measurements]:
    """Engage the emergency stop."""
    return lambda now: now._replace(held=True)


def other_dock(_: Run) -> Callable[[Measurements], Measurements]:
    """Report another dock, 30 cm to the left, in every detection."""
    return lambda now: now._replace(
        detections=tuple(one._replace(pose=one.pose @ Pose2(0.0, 0.3, 0.0)) for one in now.detections)
    )


def late_stamps(_: Run) -> Callable[[Measurements], Measurements]:
    """Stamp detections 150 ms after the picture."""
    return lambda now: now._replace(detections=tuple(one._replace(stamp=one.stamp + 0.15) for one in now.detections))


def glare(run: Run) -> Callable[[Measurements], Measurements]:
    """Make the costmap lethal everywhere for 1 s, and empty afterwards."""
    empty, until = _grid(run.case, None), run.robot.time + 1.0
    full = Costmap(np.full_like(empty.data, LETHAL), empty.resolution, empty.origin)
    return lambda now: now._replace(costmap=full if run.robot.time < until else empty)


def signal(*, flickers: bool) -> Callable[[Run], Callable[[Measurements], Measurements]]:
    """Report contact by the switch, all the time or in every other cycle."""

    def change(_: Run) -> Callable[[Measurements], Measurements]:
        count = itertools.count()
        return lambda now: now._replace(contact=not flickers or next(count) % 2 == 0)

    return change


def no_twist(_: Run) -> Callable[[Measurements], Measurements]:
    """Remove the velocity from the odometry."""
    return lambda now: now._replace(twist=None)  # type: ignore[arg-type]  # as a driver that has stopped


def odometry_restarted(run: Run) -> Callable[[Measurements], Measurements]:
    """Restart the pose of an otherwise perfect odometry at its origin."""
    begins = run.robot.time
    origin = run.robot.state.pose

    def change(now: Measurements) -> Measurements:
        pose = run.robot.state.pose
        seen = pose.in_frame_of(origin) if run.robot.time > begins + 0.5 else pose
        return now._replace(odometry=OdometryPose(now.stamp, seen))

    return change


def pushed(run: Run) -> None:
    """Push the robot 3 cm to its left."""
    if run.is_within(0.4):
        run.robot.state = run.robot.state._replace(pose=run.robot.state.pose @ Pose2(0.0, 0.03, 0.0))


def commands_lost(run: Run) -> None:
    """Lose all commands for 0.6 s; the base stops."""
    if run.is_within(0.4):
        run.memory["until"] = run.robot.time + 0.6
        run.lost_commands = True
    elif run.lost_commands and run.robot.time >= run.memory["until"]:
        run.lost_commands = False


def cancel_in(state: State, provoked: Callable[[Run], None] | None = None) -> Callable[[Run], None]:
    """Cancel in the first cycle of a state, which a fault may cause."""

    def fault(run: Run) -> None:
        if provoked is not None:
            provoked(run)
        if run.step is not None and run.step.state is state and "cancelled" not in run.memory:
            run.memory["cancelled"] = run.robot.time
            run.executor.cancel()

    return fault


FAULTS: dict[str, Callable[[Run], None]] = {
    "none": no_fault,
    "detection lost for 2 s": lost,
    "outlier of 30 cm": outlier,
    "obstacle at 0.5 m, goes after 3 s": obstacle(3.0),
    "obstacle at 0.5 m, stays": obstacle(math.inf),
    "stuck wheel": no_fault,
    "cycles late by 100 ms": late,
    "pose jumps by 3 cm, 0.6 m before the dock": jump(0.6, 0.03),
    "pose jumps by 5 cm, 0.6 m before the dock": jump(0.6, 0.05),
    "pose jumps by 3 cm, 0.27 m before the dock": jump(0.27, 0.03),
    "pose jumps by 5 cm, 0.27 m before the dock": jump(0.27, 0.05),
    "clock goes back by 0.5 s": clock_back,
    "pose lost": pose_lost,
    "dock not seen any more": detections_lost,
    "pose and velocity no numbers for 1 s": changed_measurements(0.5, 1.0, no_number),
    "velocity missing for 2 s": changed_measurements(0.5, 2.0, no_twist),
    "stamps stand still for 1 s": changed_measurements(0.5, 1.0, same_stamp),
    "held for 3 s": changed_measurements(0.4, 3.0, held),
    "another dock is seen for 2 s": changed_measurements(0.5, 2.0, other_dock),
    "detections stamped 150 ms late": changed_measurements(2.0, math.inf, late_stamps),
    "costmap lethal everywhere for 1 s": changed_measurements(0.6, math.inf, glare),
    "switch closed 0.6 m before the dock": changed_measurements(0.6, 1.0, signal(flickers=False)),
    "switch flickers 0.1 m before the dock": changed_measurements(0.1, math.inf, signal(flickers=True)),
    "odometry begins anew": changed_measurements(0.6, math.inf, odometry_restarted),
    "robot pushed by 3 cm": pushed,
    "commands lost for 0.6 s": commands_lost,
}
PROVOKED: dict[State, Callable[[Run], None]] = {
    State.WAITING_FOR_DETECTION: detections_lost,
    State.WAITING_FOR_OBSTACLE: obstacle(math.inf),
    State.WAITING_FOR_POSE: pose_lost,
    State.HELD: changed_measurements(0.4, 3.0, held),
}
UNCHARGED = (State.WAITING_FOR_CHARGE, State.BACKING_OUT, State.RETURNING)  # reached if no charging signal arrives
CANCELLED = {f"cancel while {state.value}": state for state in State if state not in (State.READY, State.ENDED)}
FAULTS |= {name: cancel_in(state, PROVOKED.get(state)) for name, state in CANCELLED.items()}


def run_fault(name: str, number: int, world_name: str) -> FaultOutcome:
    """Run one docking with a fault."""
    world, state = WORLDS[world_name], CANCELLED.get(name)
    case = case_of(number, SPREADS["wider"], world, seed=2)
    planning = WatchedPlanning()
    settings = ExecutorSettings(
        use_detections=world.dock is not None,
        position_sigma=world.pose.position_sigma,
        yaw_sigma=world.pose.yaw_sigma,
        wait_for_charge=state in UNCHARGED,
        contact="touch" if state is State.PRESSING else "distance",
        staging_distance=STAGING,
    )
    executor = DockingExecutor(
        case.problem,
        settings,
        task="undock" if state is State.UNDOCKING else "dock",
        goal_checker=PluginChoice("DockGoalChecker", CHECKER),
        planning=planning,
    )
    run = Run(case, _robot(case, world, name), executor, planning)
    standing = longest = 0.0
    while run.robot.time < TIMEOUT:
        FAULTS[name](run)
        run.step = executor.step(_measured(run))
        command = run.step.command
        is_still = max(abs(command.linear), abs(command.angular)) < STILL and run.step.state in DRIVING
        standing = standing + run.period if is_still else 0.0
        longest = max(longest, standing)
        if run.step.ending is not None and command == Twist2():
            break
        run.robot.advance(Twist2() if run.lost_commands else command, run.period)
    for _ in range(25):
        run.robot.advance(Twist2(), run.period)
    return _outcome(run, name, longest)


def _measured(run: Run) -> Measurements:
    """Return the measurements of the executor, with the faults of clock and localization applied."""
    now = run.robot.measurements
    seen = tuple(one._replace(stamp=one.stamp + run.clock) for one in now.detections)
    found = now._replace(stamp=now.stamp + run.clock, detections=seen, pose=None if run.blind else now.pose)
    return found if run.change is None else run.change(found)


def _outcome(run: Run, name: str, longest: float) -> FaultOutcome:
    ended, record, case = run.executor.ending, run.robot.record(), run.case
    ending = "never ended" if ended is None else ended.kind.value
    counts = run.planning.replans, 0 if ended is None else ended.num_retries, 0
    followed = [] if run.clock else run.planning.followed
    names = ("executor", "detected", name, RATE)
    outcome = outcome_of(case, record, followed, names=names, ending=ending, counts=counts, busy=0.0)
    footprint = case.problem.robot.footprint
    assert case.problem.dock.footprint is not None
    station = ObstacleSet.from_footprint(case.problem.dock.footprint, case.true_dock, "dock")
    closest = outcome.clearance
    if "box since" in run.memory:
        there = (record.times >= run.memory["box since"]) & (record.times < run.memory["until"])
        box = ObstacleSet.from_polygons([run.box])
        closest = min(closest, executed_clearance(footprint, record.poses[there], box))
    twist = run.robot.state.twist
    return FaultOutcome(
        outcome._replace(clearance=closest),
        longest,
        executed_clearance(footprint, record.poses, station),
        abs(twist.linear) < STILL and abs(twist.angular) < STILL,
        "cancelled" in run.memory if name in CANCELLED else run.struck,
    )


def _robot(case: Case, world: World, name: str) -> SimulatedRobot:
    """Return the robot: docked for undocking tasks, with a wheel that sticks for 4 s, or without a switch."""
    start = case.true_dock if name == f"cancel while {State.UNDOCKING.value}" else case.problem.start
    stuck = (StuckWheel(Wheel.LEFT, 2.0, 6.0),) if name == "stuck wheel" else ()
    plant = DifferentialDrive(case.problem.robot, world.actuation, wheels=Wheels(TRACK, stuck=stuck))
    deeper = 0.02 if State.PRESSING.value in name else 0.0  # pressed deeper than planned, so that contact is detected
    station = None if CANCELLED.get(name) in UNCHARGED else Station(direction=case.direction, depth=deeper)
    sensors = Sensors(pose=world.pose, dock=world.dock)
    return SimulatedRobot(plant, start, case.true_dock, sensors, case.obstacles(), station=station, seed=case.seed)


def fault_table(jobs: int) -> tuple[str, bool]:
    """Return the table and whether all runs are safe: no collision, no unnamed standstill, every robot at rest."""
    todo = [(name, number, "detected") for name in FAULTS for number in range(COUNT)]
    with ProcessPoolExecutor(jobs, get_context("spawn"), initializer=set_clock, initargs=("cpu",)) as pool:
        found = list(pool.map(run_fault, *zip(*todo, strict=True), chunksize=4))
    by_name: dict[str, list[FaultOutcome]] = {}
    for (name, _, _), run in zip(todo, found, strict=True):
        by_name.setdefault(name, []).append(run)
    head = [
        "fault", "came", "ends", "within 10 mm, 1.5 degrees", "retries", "closest, mm", "into station, mm",
        "still, s", "longest, s",
        "over limit", "at rest",
    ]  # fmt: skip
    is_sound = all(
        run.outcome.clearance >= 0.0
        and run.station >= OVERLAP
        and run.standing <= LONGEST_STILL
        and run.at_rest
        and run.outcome.ending != "never ended"
        for run in found
    )
    return table([head, *(_row(name, runs) for name, runs in by_name.items())]), is_sound


def _row(name: str, runs: list[FaultOutcome]) -> list[str]:
    endings = collections.Counter(run.outcome.ending for run in runs)
    exact = sum(run.outcome._replace(docked=True).succeeded for run in runs)
    return [
        name,
        f"{sum(run.struck for run in runs)}/{len(runs)}",
        ", ".join(f"{count} {ending}" for ending, count in endings.most_common()),
        f"{exact}",
        f"{max(run.outcome.retries for run in runs)}",
        f"{1e3 * min(run.outcome.clearance for run in runs):.0f}",
        f"{-1e3 * min(0.0, *(run.station for run in runs)):.1f}",
        f"{max(run.standing for run in runs):.1f}",
        f"{max(run.outcome.duration for run in runs):.0f}",
        f"{max(run.outcome.over for run in runs):.3f}",
        "all" if all(run.at_rest for run in runs) else f"{sum(not run.at_rest for run in runs)} not",
    ]
