"""The closed loop of a simulated robot, a controller and a goal checker, and the record of a run."""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from optdock.errors import Cancelled, ControllerException, InvalidValue
from optdock.geometry.arrays import FloatArray, FrozenArrays, frozen_array, readonly
from optdock.geometry.obstacles import in_words
from optdock.geometry.pose import Pose2, pose_errors
from optdock.model.dock import Dock
from optdock.model.path import PathSamples
from optdock.model.problem import DockingProblem
from optdock.model.robot import Drive
from optdock.model.trajectory import Trajectory
from optdock.plugins.interfaces import never_cancelled
from optdock.plugins.lifecycle import LifecycleState, PluginContext
from optdock.samples.tube import Tube
from optdock.simulation.bicycle import plant_of
from optdock.simulation.plant import Actuation
from optdock.simulation.sensors import PoseSensor
from optdock.simulation.world import Sensors, SimulatedRobot
from optdock.verification import TOLERANCE, end_clearances, pose_clearances, proven_for

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from optdock.geometry.obstacles import ObstacleSet
    from optdock.model.path import Path
    from optdock.model.robot import Robot
    from optdock.plugins.interfaces import Controller, GoalChecker
    from optdock.simulation.bicycle import Steering
    from optdock.verification import Certificate

__all__ = ["RemainingPath", "Run", "SimulationSettings", "beyond_proof", "run_closed_loop"]

logger = logging.getLogger(__name__)

_WINDOW = 20  # samples of the remaining path, 1 m, in which the nearest one is searched
_BUMPER = 0.002  # [m]: allowed penetration of a dock that is planned to be touched
_BLOCK = 256  # poses per round, which bounds the memory


@dataclass(frozen=True, eq=False)
class SimulationSettings:
    """Settings of a run; by default, the robot is perfect.

    Args:
        period: Control period [s].
        timeout: Simulated time after which the run ends [s]; None: 1.5 times the trajectory plus 10 s.
        actuation: Lags, latency and dead bands of the drive; the angular lag of a car is the lag of its steering.
        steering: Steering of a car; None: perfect except for the angular lag.
        position_noise: Standard deviation of the white noise of the measured x and y [m].
        yaw_noise: Standard deviation of the white noise of the measured yaw [rad].
        seed: Seed of the noise.
        start: True pose at the beginning; None: start of the trajectory. The robot begins at the initial velocity of
            the trajectory.
        obstacles: Obstacles for the clearance of the driven poses; None: the clearance is not computed.

    Raises:
        InvalidValue: If the period is not > 0, or a standard deviation or the timeout is negative or not finite.
    """

    period: float = 0.02
    timeout: float | None = None
    actuation: Actuation = field(default_factory=Actuation)
    steering: Steering | None = None
    position_noise: float = 0.0
    yaw_noise: float = 0.0
    seed: int = 0
    start: Pose2 | None = None
    obstacles: ObstacleSet | None = None

    def __post_init__(self) -> None:
        if not (math.isfinite(self.period) and self.period > 0.0):
            raise InvalidValue(f"simulation.period: must be finite and > 0 s, got {self.period}")
        for name in ("timeout", "position_noise", "yaw_noise"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value >= 0.0):
                raise InvalidValue(f"simulation.{name}: must be finite and >= 0, got {value}")


@dataclass(frozen=True, eq=False)
class Run(FrozenArrays):
    """Record of a closed-loop run; true if the robot docked.

    Row k contains the state at `times[k]` and the command given at that time.

    Args:
        times: Shape (n,) [s].
        poses: True poses, Shape (n, 3).
        measured: Measured poses, Shape (n, 3).
        commands: Linear and angular commands, Shape (n, 2) [m/s, rad/s]; zero in the last row.
        twists: True body velocities, Shape (n, 2) [m/s, rad/s].
        references: Poses of the trajectory at the same times, Shape (n, 3).
        goal: Goal pose.
        docked: Verdict of the goal checker.
        reason: Reason why the robot did not dock; empty if it docked.
        verdicts: Verdicts of the goal checkers at the end, by name; the first verdict decides.
        min_clearance: Smallest clearance of the true poses [m]; None without obstacles.
        differs: Differences from the certified problem: `footprint`, `limits`, `obstacles`; empty without a difference
            or a certificate.

    Attributes:
        errors: True pose relative to the reference: along, cross [m] and yaw [rad], Shape (n, 3).
        final_error: Last true pose relative to the goal: along, cross [m], yaw [rad].
    """

    times: FloatArray
    poses: FloatArray
    measured: FloatArray
    commands: FloatArray
    twists: FloatArray
    references: FloatArray
    goal: Pose2
    docked: bool
    reason: str = ""
    min_clearance: float | None = None
    verdicts: Mapping[str, bool] = field(default_factory=dict)
    differs: tuple[str, ...] = ()
    errors: FloatArray = field(init=False, repr=False)
    final_error: Pose2 = field(init=False)

    def __post_init__(self) -> None:
        columns = {"poses": 3, "measured": 3, "commands": 2, "twists": 2, "references": 3}
        object.__setattr__(self, "times", frozen_array(self.times, "run.times"))
        for name, count in columns.items():
            object.__setattr__(self, name, frozen_array(getattr(self, name), f"run.{name}", columns=count))
        object.__setattr__(self, "errors", readonly(pose_errors(self.poses, self.references)))
        last = pose_errors(self.poses[-1:], self.goal.as_array()[None])[0]
        object.__setattr__(self, "final_error", Pose2(*last.tolist()))

    def __bool__(self) -> bool:
        return self.docked

    @property
    def collided(self) -> bool:
        """Whether the footprint penetrated an obstacle deeper than the travel of a bumper."""
        return self.min_clearance is not None and self.min_clearance < -_BUMPER

    @property
    def fault(self) -> str:
        """Description of a collision or of a failed docking; empty if neither occurred."""
        if self.collided:
            return f"collided: the footprint went {-(self.min_clearance or 0.0):.4f} m into an obstacle"
        return "" if self.docked else f"not docked: {self.reason}"

    @property
    def duration(self) -> float:
        """Duration of the run [s]."""
        return float(self.times[-1])


def run_closed_loop(  # noqa: PLR0913 - one parameter for each part of the loop
    trajectory: Trajectory,
    robot: Robot,
    goal: Pose2,
    controller: Controller,
    goal_checker: GoalChecker,
    settings: SimulationSettings | None = None,
    *,
    beside: Sequence[GoalChecker] = (),
    cancel_checker: Callable[[], bool] = never_cancelled,
) -> Run:
    """Drive a trajectory in simulation until the goal checker accepts, the controller fails, or the timeout is reached.

    The robot is a `SimulatedRobot` with the plant of its drive, `plant_of`. Controller and checkers are reset first. In
    each period the checker is called before the controller, as in Nav2's server.

    Args:
        trajectory: Trajectory for the controller's `set_path`.
        robot: Robot with limits and footprint.
        goal: Goal pose for the goal checker.
        controller: Controller; for a car, an unconfigured controller is configured with the robot.
        goal_checker: Goal checker that decides when the run ends.
        settings: Settings; None: a perfect robot.
        beside: Additional goal checkers that are called once at the end of the run and do not affect the run.
        cancel_checker: Polled in every period.

    Raises:
        Cancelled: If `cancel_checker` returned True.
        InvalidValue: If two goal checkers have the same name, or actuation and steering do not fit the drive.
    """
    settings, checkers = settings or SimulationSettings(), (goal_checker, *beside)
    if len({checker.name for checker in checkers}) <= len(beside):
        raise InvalidValue(
            f"simulation: goal checkers must have different names, got {goal_checker.name} twice or more"
        )
    controller.reset()
    for checker in checkers:
        checker.reset()
    if controller.state is LifecycleState.UNCONFIGURED and robot.drive is Drive.ACKERMANN:
        task = DockingProblem(trajectory.path.start, Dock(goal), robot, frame=trajectory.frame)
        controller.configure(PluginContext(controller.name, problem=task))
        controller.set_path(Trajectory(trajectory.path, trajectory.time_law))  # the trajectory without its certificate
    else:
        controller.set_path(trajectory)
    first = trajectory.at(0.0)
    world = SimulatedRobot(
        plant_of(robot, settings.actuation, steering=settings.steering),
        settings.start or first.pose,
        goal,
        Sensors(PoseSensor(settings.position_noise, settings.yaw_noise)),
        obstacles=settings.obstacles or None,
        seed=settings.seed,
        start_twist=first.twist,
    )
    remaining = RemainingPath(trajectory.path)
    timeout = 1.5 * trajectory.duration + 10.0 if settings.timeout is None else settings.timeout
    rounds = settings.period, timeout, cancel_checker
    docked, reason = _drive(world, remaining, controller, goal_checker, rounds)
    verdicts = {goal_checker.name: docked}
    verdicts |= {checker.name: _is_reached(checker, world, remaining) for checker in beside}
    record = world.record()
    reference = trajectory.sample_at(record.times)
    return Run(
        times=record.times,
        poses=record.poses,
        measured=record.measured,
        commands=record.commands,
        twists=record.twists[:, :2],
        references=np.column_stack((reference.x, reference.y, reference.yaw)),
        goal=goal,
        docked=docked,
        reason=reason,
        differs=_differences(trajectory, robot, settings.obstacles),
        min_clearance=world.clearance() if settings.obstacles else None,
        verdicts=verdicts,
    )


def _drive(
    world: SimulatedRobot,
    remaining: RemainingPath,
    controller: Controller,
    goal_checker: GoalChecker,
    rounds: tuple[float, float, Callable[[], bool]],
) -> tuple[bool, str]:
    """Run the loop; return whether the robot docked, and if not, the reason.

    Raises:
        Cancelled: If the cancel checker, the last of `rounds` after period and timeout [s], returned True.
    """
    period, timeout, cancel_checker = rounds
    for left in range(math.ceil(timeout / period), -1, -1):
        if cancel_checker():
            raise Cancelled("simulation: cancelled")
        if _is_reached(goal_checker, world, remaining):
            return True, ""
        if left == 0:
            break
        now = world.measurements
        assert now.pose is not None
        try:
            command = controller.compute_velocity_commands(now.pose, now.twist, goal_checker, stamp=now.stamp)
        except ControllerException as error:
            return False, f"{type(error).__name__}: {error}"
        world.advance(command, period)
    return False, f"timeout: not docked within {timeout:g} s"


def _is_reached(checker: GoalChecker, world: SimulatedRobot, remaining: RemainingPath) -> bool:
    now = world.measurements
    assert now.pose is not None
    return checker.is_goal_reached(now.pose, world.dock_pose, now.twist, remaining.from_pose(now.pose))


def _differences(trajectory: Trajectory, robot: Robot, obstacles: ObstacleSet | None) -> tuple[str, ...]:
    """Return the differences between a run and the problem for which the trajectory was certified."""
    proven = proven_for(trajectory)
    if proven is None:
        return ()
    here = robot.fingerprint._asdict() | ({} if obstacles is None else {"obstacles": obstacles.digest})
    found = tuple(name for name, value in here.items() if value != getattr(proven, name))
    if found:
        logger.warning("simulated with another %s than the trajectory was certified for", " and ".join(found))
    return found


class RemainingPath:
    """A sampled path with the monotonic progress of the robot along the path, up to the last two poses.

    Among the next samples of the present gear segment, without turns in place, the nearest one is the position of the
    robot; the next segment begins at the sample of the cusp. Overlapping segments at a cusp are thus distinguished, and
    the path-length rule of the checkers applies only to the last segment.

    Args:
        path: The whole path.
        spacing: Distance of the samples [m].
    """

    def __init__(self, path: Path, spacing: float = 0.05) -> None:
        samples = path.sample(spacing)
        gears = samples.direction
        legs = np.cumsum(np.diff(gears, prepend=gears[0]) != 0)
        if np.any(gears):  # the position does not determine the progress in a turn
            legs, samples = legs[gears != 0], PathSamples(*(column[gears != 0] for column in samples))
        self._poses = [Pose2.from_sequence(row) for row in samples.poses]
        self._segment_ends = [*np.flatnonzero(np.diff(legs)).tolist(), legs.size - 1]
        self._at = 0

    def from_pose(self, pose: Pose2) -> Sequence[Pose2]:
        """Return the poses from the position of the robot to the end; at least two."""
        if self._at in self._segment_ends[:-1]:
            self._at += 1  # the second sample of the cusp, of the next gear
        end = next(i for i in self._segment_ends if i >= self._at)
        window = range(self._at, min(end, self._at + _WINDOW) + 1)
        self._at = min(window, key=lambda i: math.hypot(self._poses[i].x - pose.x, self._poses[i].y - pose.y))
        return self._poses[min(self._at, len(self._poses) - 2) :]


def beyond_proof(path: Path, problem: DockingProblem, certificate: Certificate, poses: FloatArray) -> str:
    """Return a description of how driven poses left the certified tube or clearance; empty if all poses are inside.

    A pose is outside if a tracking tube (`Robot.tracking`) is given and the displacement exceeds the width of the tube,
    or if the footprint is closer to an obstacle than the problem's clearance requires. Without a tube only the
    clearance is checked. Near the dock the certificate reserves less than the width of the tube, so a pose within the
    tube can still violate the clearance. Within the dock's tolerances the robot may penetrate its station by the travel
    of a bumper.

    Args:
        path: Path to be driven.
        problem: Problem of the certificate.
        certificate: Certificate of the path.
        poses: True poses, Shape (n, 3).
    """
    width, faults = certificate.tube, []
    to_go = np.hypot(poses[:, 0] - problem.goal.x, poses[:, 1] - problem.goal.y)
    if width > 0.0:
        moved = Tube(path, problem, certificate.start_relief).deviations(poses).displacement
        worst = int(np.argmax(moved))
        if moved[worst] > width:
            off, wide = f"{1e3 * moved[worst]:.1f} mm off the path", f"the tube is {1e3 * width:.1f} mm wide"
            faults.append(f"{off} {to_go[worst]:.3f} m from the dock, {wide}")
    from_start = np.hypot(poses[:, 0] - problem.start.x, poses[:, 1] - problem.start.y)
    begun, relief = end_clearances(problem).start, certificate.start_relief
    required = problem.clearance.required_at(to_go, from_start, begun, relief)
    obstacles, within = problem.all_obstacles, float(np.max(required)) + TOLERANCE
    blocks = np.array_split(poses, -(-len(poses) // _BLOCK))
    found = [pose_clearances(block, problem.robot.footprint, obstacles, within) for block in blocks]
    clearance, nearest = (np.concatenate(columns) for columns in zip(*found, strict=True))
    is_station = np.array([row >= 0 and obstacles.name_of(row) == "dock" for row in nearest.tolist()])
    accepted = problem.dock.tolerances
    pressed = is_station & (to_go <= math.hypot(accepted.along, accepted.cross))
    required = np.where(pressed, problem.clearance.at_dock, required)
    short = required - clearance - np.where(pressed, _BUMPER, TOLERANCE)
    worst = int(np.argmax(short))
    if short[worst] > 0.0:
        near = in_words(obstacles.name_of(int(nearest[worst])))
        rule = f"required {required[worst]:.4f} m"
        faults.append(f"{clearance[worst]:.4f} m from {near}, {to_go[worst]:.3f} m from the dock, {rule}")
    return " and ".join(faults)
