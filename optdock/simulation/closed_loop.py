"""The closed loop: a simulated robot, a controller and a goal checker, one control period after the other."""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from optdock.errors import ControllerException, InvalidValue
from optdock.geometry.pose import Pose2
from optdock.model.dock import Dock
from optdock.model.path import PathSamples
from optdock.model.problem import DockingProblem
from optdock.model.robot import Drive
from optdock.model.trajectory import Trajectory
from optdock.plugins.lifecycle import LifecycleState, PluginContext
from optdock.simulation.bicycle import plant_of
from optdock.simulation.plant import Actuation
from optdock.simulation.run import Run
from optdock.simulation.sensors import PoseSensor
from optdock.simulation.world import Sensors, SimulatedRobot
from optdock.verification import proven_for

if TYPE_CHECKING:
    from collections.abc import Sequence

    from optdock.geometry.obstacles import ObstacleSet
    from optdock.model.measurements import Measurements
    from optdock.model.path import Path
    from optdock.model.robot import Robot
    from optdock.plugins.interfaces import Controller, GoalChecker
    from optdock.simulation.bicycle import Steering

__all__ = ["RemainingPath", "SimulationSettings", "run_closed_loop"]

logger = logging.getLogger(__name__)

_LOOK_AHEAD = 20  # samples of the remaining path, 1 m: further off lies another leg, not the robot's place


@dataclass(frozen=True, eq=False)
class SimulationSettings:
    """The world of a run; the default is perfect.

    Args:
        period: Control period [s].
        timeout: Simulated time after which the run is given up [s]; None: 1.5 times the trajectory plus 10 s.
        actuation: Lags, latency and dead band of the drive; the angular lag of a car is that of its steering.
        steering: Of a car; None: perfect but for that lag.
        position_noise: Standard deviation of the measured x and y [m], white.
        yaw_noise: Standard deviation of the measured yaw [rad], white.
        seed: Of the noise; equal seeds give equal runs.
        start: True pose at the beginning; None: the trajectory's start. The robot moves there as the trajectory does.
        obstacles: For the clearance of the driven poses; None leaves it out.

    Raises:
        InvalidValue: The period is not > 0, or a standard deviation or the timeout is negative or not finite.
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


def run_closed_loop(  # noqa: PLR0913 - one parameter for each part of the loop
    trajectory: Trajectory,
    robot: Robot,
    goal: Pose2,
    controller: Controller,
    goal_checker: GoalChecker,
    settings: SimulationSettings | None = None,
    *,
    beside: Sequence[GoalChecker] = (),
) -> Run:
    """Drive `trajectory` in simulation until the goal checker says docked, the controller gives up, or time is out.

    What drives is a `SimulatedRobot` with the plant of the robot's drive, `plant_of`. Controller and checker are reset
    first; in each period the checker is asked before the controller, as Nav2's server does.

    Args:
        trajectory: What to drive; the controller gets it through `set_path`.
        robot: Its drive limits bound the plant; its footprint is used for the clearance.
        goal: Pose handed to the goal checker.
        controller: Ready to use; it is told the time. One that is not configured drives as a differential drive does,
            and so is configured first where the robot is a car.
        goal_checker: Decides.
        settings: The world; perfect by default.
        beside: Goal checkers that are asked once, when the run has ended; they decide nothing.

    Raises:
        InvalidValue: Two goal checkers have the same name, or actuation and steering are not those of the drive.
    """
    settings = settings or SimulationSettings()
    if len({checker.name for checker in (goal_checker, *beside)}) <= len(beside):
        raise InvalidValue(f"simulation: the goal checkers beside {goal_checker.name} need names of their own")
    controller.reset()
    for checker in (goal_checker, *beside):
        checker.reset()
    if controller.state is LifecycleState.UNCONFIGURED and robot.drive is Drive.ACKERMANN:
        task = DockingProblem(trajectory.path.start, Dock(goal), robot, frame=trajectory.frame)
        controller.configure(PluginContext(controller.name, problem=task))
        controller.set_path(Trajectory(trajectory.path, trajectory.time_law))  # what proves it is not told
    else:
        controller.set_path(trajectory)
    loop = _Loop(trajectory, robot, goal, controller, (goal_checker, *beside), settings)
    docked, reason = loop.run()
    return loop.result(docked=docked, reason=reason)


class _Loop:
    """One run."""

    def __init__(
        self,
        trajectory: Trajectory,
        robot: Robot,
        goal: Pose2,
        controller: Controller,
        goal_checkers: Sequence[GoalChecker],
        settings: SimulationSettings,
    ) -> None:
        self.trajectory, self.robot, self.goal = trajectory, robot, goal
        self.controller, self.goal_checkers, self.settings = controller, goal_checkers, settings
        self.remaining = RemainingPath(trajectory.path)
        first = trajectory.at(0.0)
        self.world = SimulatedRobot(
            plant_of(robot, settings.actuation, steering=settings.steering),
            settings.start or first.pose,
            goal,
            Sensors(PoseSensor(settings.position_noise, settings.yaw_noise)),
            obstacles=settings.obstacles or None,
            seed=settings.seed,
            start_twist=first.twist,
        )

    def run(self) -> tuple[bool, str]:
        """Whether docked, and why not."""
        timeout = self.settings.timeout
        timeout = 1.5 * self.trajectory.duration + 10.0 if timeout is None else timeout
        decisive = self.goal_checkers[0]
        for left in range(math.ceil(timeout / self.settings.period), -1, -1):
            now = self.world.measurements
            if self._reached(decisive, now):
                return True, ""
            if left == 0:
                break
            assert now.pose is not None  # the sensor loses none
            try:
                command = self.controller.compute_velocity_commands(now.pose, now.twist, decisive, stamp=now.stamp)
            except ControllerException as error:
                return False, f"{type(error).__name__}: {error}"
            self.world.advance(command, self.settings.period)
        return False, f"timeout: not docked within {timeout:g} s"

    def _reached(self, checker: GoalChecker, now: Measurements) -> bool:
        assert now.pose is not None
        return checker.is_goal_reached(now.pose, self.goal, now.twist, self.remaining.from_pose(now.pose))

    def result(self, *, docked: bool, reason: str) -> Run:
        """The run's record."""
        verdicts = {self.goal_checkers[0].name: docked}
        verdicts |= {
            checker.name: self._reached(checker, self.world.measurements) for checker in self.goal_checkers[1:]
        }
        record = self.world.record()
        reference = self.trajectory.sample_at(record.times)
        return Run(
            times=record.times,
            poses=record.poses,
            measured=record.measured,
            commands=record.commands,
            twists=record.twists[:, :2],
            references=np.column_stack((reference.x, reference.y, reference.yaw)),
            goal=self.goal,
            docked=docked,
            reason=reason,
            differs=_differences(self.trajectory, self.robot, self.settings.obstacles),
            min_clearance=self.world.clearance() if self.settings.obstacles else None,
            verdicts=verdicts,
        )


def _differences(trajectory: Trajectory, robot: Robot, obstacles: ObstacleSet | None) -> tuple[str, ...]:
    """In what the world of a run is not the one that the trajectory was certified for."""
    proven = proven_for(trajectory)
    if proven is None:
        return ()
    here = robot.fingerprint._asdict() | ({} if obstacles is None else {"obstacles": obstacles.digest})
    found = tuple(name for name, value in here.items() if value != getattr(proven, name))
    if found:
        logger.warning("simulated with another %s than the trajectory was certified for", " and ".join(found))
    return found


class RemainingPath:
    """A sampled path that is consumed from its start, monotonically, and never beyond its last two poses.

    The robot's place is the nearest sample among the next few of the present gear segment, turns in place left out; the
    next segment opens once the cusp's sample is reached. So the overlapping legs of a cusp are not mistaken for each
    other, and the path-length rule of the checkers holds them off until the last leg.

    Args:
        path: The whole path.
        spacing: Distance of the samples [m].
    """

    def __init__(self, path: Path, spacing: float = 0.05) -> None:
        samples = path.sample(spacing)
        gears = samples.direction
        legs = np.cumsum(np.diff(gears, prepend=gears[0]) != 0)
        if np.any(gears):  # no place tells where in a turn the robot is
            legs, samples = legs[gears != 0], PathSamples(*(column[gears != 0] for column in samples))
        self._poses = [Pose2.from_sequence(row) for row in samples.poses]
        self._segment_ends = [*np.flatnonzero(np.diff(legs)).tolist(), legs.size - 1]
        self._at = 0

    def from_pose(self, pose: Pose2) -> Sequence[Pose2]:
        """The poses from the robot's place to the end; at least two."""
        if self._at in self._segment_ends[:-1]:
            self._at += 1  # the cusp's second sample, of the next gear
        end = next(i for i in self._segment_ends if i >= self._at)
        window = range(self._at, min(end, self._at + _LOOK_AHEAD) + 1)
        self._at = min(window, key=lambda i: math.hypot(self._poses[i].x - pose.x, self._poses[i].y - pose.y))
        return self._poses[min(self._at, len(self._poses) - 2) :]
