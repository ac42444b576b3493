"""Undock: leave the dock along a certified path instead of reversing blindly."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from pydantic import Field

from optdock.deadline import Deadline
from optdock.errors import BehaviorException, ControllerException, InvalidValue, OptdockError
from optdock.model.path import Path
from optdock.nav2.behaviors.collision import CollisionChecker
from optdock.nav2.behaviors.results import RUNNING, SUCCEEDED, UNDOCK, failed, stopped
from optdock.plugins.interfaces import Behavior, BehaviorResult, Controller, CostmapInfoType
from optdock.plugins.parameters import PluginParameters, parse_parameters
from optdock.plugins.registry import create_plugin

if TYPE_CHECKING:
    from optdock.geometry.pose import Pose2, Twist2
    from optdock.model.problem import DockingProblem
    from optdock.nav2.behaviors.undock_plan import UndockPlan

__all__ = ["Undock", "UndockCommand", "UndockParameters"]

_AT_REST = 0.02  # [m/s], [rad/s]


class UndockParameters(PluginParameters):
    """Nav2's tolerances and staging distance, and how to plan and drive."""

    cycle_frequency: float = Field(default=50.0, gt=0.0, description="calls per second [Hz]")
    undock_linear_tolerance: float = Field(default=0.05, gt=0.0, description="distance from staging [m]")
    undock_angular_tolerance: float = Field(default=0.05, gt=0.0, description="heading error there [rad]")
    staging_distance: float = Field(default=0.7, gt=0.0, description="of the staging pose from the dock [m]")
    dock_tolerance: float = Field(default=0.05, gt=0.0, description="distance from the dock that counts as docked [m]")
    time_budget: float = Field(default=2.0, gt=0.0, description="wall-clock time for planning [s]")
    simulate_ahead_time: float = Field(default=0.3, gt=0.0, description="collision check of each command [s]")
    controller: str = Field(default="TrackingController", description="plugin that drives the trajectory")


class UndockCommand(PluginParameters):
    """How long it may take; the docking path is taken from the command's `path`, if there is one."""

    time_allowance: float = Field(default=60.0, ge=0.0, description="time it may take [s]; 0: no limit")


class Undock(Behavior):
    """Drives from the dock back to the staging pose along a path that was certified first; see `plan_undock`.

    `on_run` plans, so it takes up to `time_budget` per direction. The command may hold `path`, the `Path` that was
    driven into the dock: it is certified among the obstacles of now and reversed.

    Codes: FAILED_TO_STAGE 903 when there is no certified way out, FAILED_TO_CONTROL 905 when it cannot be driven or
    something new stands in the way, TIMEOUT 907, UNKNOWN 999 for a bad command, no problem, a controller that does not
    exist, or a robot that is not in the dock.

    Args:
        **parameters: Fields of `UndockParameters`.

    Attributes:
        plan: The plan being driven, or None.
    """

    Parameters = UndockParameters
    parameters: UndockParameters

    def __init__(self, **parameters: object) -> None:
        super().__init__(**parameters)
        self.plan: UndockPlan | None = None
        self._drive: _Drive | None = None

    @property
    def resource_info(self) -> CostmapInfoType:
        """Needs the local costmap."""
        return CostmapInfoType.LOCAL

    def on_run(self, command: Mapping[str, object]) -> BehaviorResult:
        """Plan the way out; the command is an `UndockCommand` and, optionally, `path`."""
        from optdock.nav2.behaviors.undock_plan import plan_undock

        self.plan = self._drive = None
        try:
            parsed, problem, path = _understood(command, self.context.problem)
        except InvalidValue as error:
            return failed(UNDOCK.unknown, str(error))
        p = self.parameters
        try:
            plan = plan_undock(problem, path, staging_distance=p.staging_distance, time_budget=p.time_budget)
        except OptdockError as error:
            return failed(UNDOCK.no_way, f"{type(error).__name__}: {error}")
        try:
            self._drive = self._prepared(plan, Deadline.of_allowance(parsed.time_allowance, self.context.clock))
        except OptdockError as error:
            code = UNDOCK.control if isinstance(error, ControllerException) else UNDOCK.unknown
            return failed(code, f"{type(error).__name__}: {error}")
        self.plan = plan
        return SUCCEEDED

    def on_cycle_update(self, pose: Pose2, velocity: Twist2) -> tuple[BehaviorResult, Twist2]:
        """One cycle.

        Raises:
            BehaviorException: `on_run` has not succeeded.
        """
        if self._drive is None:
            raise BehaviorException("Undock: on_run must succeed before the cycles begin")
        return self._drive.cycle(pose, velocity)

    def _prepared(self, plan: UndockPlan, deadline: Deadline) -> _Drive:
        controller = create_plugin(Controller, self.parameters.controller)
        controller.configure(self.context)
        controller.set_path(plan.trajectory)
        return _Drive(
            self.parameters, plan, controller, deadline, CollisionChecker(self.context, 0.0, self.resource_info)
        )


def _understood(
    command: Mapping[str, object], problem: DockingProblem | None
) -> tuple[UndockCommand, DockingProblem, Path | None]:
    if not isinstance(command, Mapping):
        raise InvalidValue(f"Undock: the command must be a mapping of names to values, got {command!r}")
    path = command.get("path")
    rest = {name: value for name, value in command.items() if name != "path"}
    parsed = parse_parameters(UndockCommand, rest, "Undock")
    if problem is None:
        raise InvalidValue("Undock: configure it with a problem; it names the dock and the obstacles")
    if not (path is None or isinstance(path, Path)):
        raise InvalidValue(f"Undock.path: must be a Path, got {type(path).__name__}")
    return parsed, problem, path


class _Drive:
    """The state of one run."""

    def __init__(
        self,
        parameters: UndockParameters,
        plan: UndockPlan,
        controller: Controller,
        deadline: Deadline,
        checker: CollisionChecker,
    ) -> None:
        self.parameters, self.plan, self.controller = parameters, plan, controller
        self.deadline, self.checker = deadline, checker
        self.begun = False

    def cycle(self, pose: Pose2, velocity: Twist2) -> tuple[BehaviorResult, Twist2]:
        """How it stands, and the command to send."""
        path = self.plan.trajectory.path
        if self.deadline.passed():
            return stopped(failed(UNDOCK.timeout, "time allowance exceeded before the staging pose was reached"))
        if not self.begun and path.start.distance_to(pose) > self.parameters.dock_tolerance:
            away = path.start.distance_to(pose)
            return stopped(failed(UNDOCK.unknown, f"the robot is not in the dock but {away:.3f} m from it"))
        self.begun = True
        if self._arrived(pose, velocity):
            return stopped(SUCCEEDED)
        try:
            now = self.controller.context.clock()
            twist = self.controller.compute_velocity_commands(pose, velocity, None, stamp=now)
        except ControllerException as error:
            return stopped(failed(UNDOCK.control, str(error)))
        refusal = self.checker.refusal(pose, twist, self.parameters.simulate_ahead_time)
        return stopped(failed(UNDOCK.control, refusal)) if refusal else (RUNNING, twist)

    def _arrived(self, pose: Pose2, velocity: Twist2) -> bool:
        p, left = self.parameters, pose.in_frame_of(self.plan.trajectory.path.end)
        near = left.x**2 + left.y**2 <= p.undock_linear_tolerance**2 and abs(left.yaw) <= p.undock_angular_tolerance
        return near and abs(velocity.linear) <= _AT_REST and abs(velocity.angular) <= _AT_REST
