"""Nav2's plugin interfaces in Python, with names in snake case, results instead of output arguments, and exceptions."""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import TYPE_CHECKING

from optdock.errors import InvalidPath
from optdock.geometry.checked import instance
from optdock.geometry.pose import Pose2
from optdock.model.path import Path
from optdock.model.problem import DockingProblem
from optdock.plugins.lifecycle import LifecycleState, Plugin, PluginContext
from optdock.plugins.outcomes import (
    BehaviorResult,
    BehaviorStatus,
    Bounds,
    Contact,
    CostmapInfoType,
    Guess,
    SampledBound,
    SmoothingReport,
    SmoothingResult,
    SmoothingStatus,
    TimingReport,
    TimingResult,
    TimingStatus,
    Tolerances,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from optdock.geometry.pose import Twist2
    from optdock.model.costmap import Costmap
    from optdock.model.limits import MotionLimits, SpeedZone
    from optdock.model.measurements import AtDock, Detection, Measurements
    from optdock.model.trajectory import Trajectory

__all__ = [
    "Behavior",
    "BehaviorResult",
    "BehaviorStatus",
    "Bounds",
    "Contact",
    "Controller",
    "CostmapInfoType",
    "DockType",
    "GlobalPlanner",
    "GoalChecker",
    "Guess",
    "Layer",
    "LifecycleState",
    "Plugin",
    "PluginContext",
    "SampledBound",
    "Smoother",
    "SmoothingReport",
    "SmoothingResult",
    "SmoothingStatus",
    "TimeParameterizer",
    "TimingReport",
    "TimingResult",
    "TimingStatus",
    "Tolerances",
    "never_cancelled",
]


def never_cancelled() -> bool:
    """Return False; this is the default `cancel_checker`."""
    return False


class GlobalPlanner(Plugin):
    """Plan a path from start to goal."""

    @abstractmethod
    def create_plan(self, start: Pose2, goal: Pose2, cancel_checker: Callable[[], bool] = never_cancelled) -> Path:
        """Return a non-empty path from `start` to `goal` in the costmap's frame.

        `cancel_checker` is polled at least every 5 ms.

        Raises:
            PlannerException: If no path is found.
            PlannerCancelled: If `cancel_checker` returned True.
        """

    def create_plans(
        self,
        start: Pose2,
        goal: Pose2,
        cancel_checker: Callable[[], bool] = never_cancelled,
        better_than: Callable[[], float] = lambda: math.inf,  # noqa: ARG002 - used by overrides
    ) -> Iterator[Guess | None]:
        """Yield one or more paths, the most promising first; by default only the path of `create_plan`.

        The next path is computed when it is requested. The iterator ends when no further path can have a lower price.
        None marks a pause: the next path takes longer, and the caller may do other work first.

        Args:
            start: As in `create_plan`.
            goal: As in `create_plan`.
            cancel_checker: As in `create_plan`.
            better_than: Function that returns the price [s] that a guess must be able to beat, apart from the time that
                the steering takes at the start: nearly the price of the best plan; inf without a plan.

        Raises:
            PlannerException: If no path is found.
            PlannerCancelled: If `cancel_checker` returned True.
        """
        yield Guess(self.create_plan(start, goal, cancel_checker))


class Smoother(Plugin):
    """Smooth a path."""

    @abstractmethod
    def smooth(
        self,
        path: Path,
        max_time: float,
        *,
        problem: DockingProblem | None = None,
        warm_start: Path | None = None,
        cancel_checker: Callable[[], bool] = never_cancelled,
    ) -> SmoothingResult:
        """Return a smoother path between the same two poses, in the same frame.

        If `problem` is given, a smoother that certifies its results returns a path from the problem's start to its
        goal, and raises InvalidPath if the ends of `path` are too far from them.

        Args:
            path: Raw path, from any source.
            max_time: Wall-clock time for the whole call [s].
            problem: Constraints; the configured costmap is added if the problem has none. None: the configured problem,
                but with the ends of `path` if they differ. Without a configured problem, the path leads from the first
                to the last pose of `path`, among the obstacles of the configured costmap.
            warm_start: Earlier result for a similar problem.
            cancel_checker: Polled at least every 5 ms.

        Raises:
            InvalidValue: If `max_time` is not finite or negative, or `problem` or `warm_start` has a wrong type.
            InvalidPath: If `path` is not a Path, is too short, is not in the frame of the problem, or has other ends.
            SmootherTimedOut: If the time ran out before there was a usable result.
            FailedToSmoothPath: If no result satisfies every bound; the message names the violated bound.
            SmootherCancelled: If `cancel_checker` returned True.
        """

    def sampled_bounds(self, path: Path, *, before: float = 0.0) -> tuple[SampledBound, ...]:  # noqa: ARG002 - a hook
        """Return the smoother's own bounds, which no certificate covers, at samples of any path; by default none.

        The pipeline returns no path that violates one of these bounds, also if the path is not a result of `smooth`.

        Args:
            path: Path in the frame of the problem.
            before: Distance driven before the path [m].
        """
        return ()

    @staticmethod
    def check_task(path: Path, problem: DockingProblem | None, warm_start: Path | None) -> None:
        """Check the types of the arguments of `smooth`.

        Raises:
            InvalidPath: If `path` is not a Path.
            InvalidValue: If `problem` or `warm_start` has a wrong type.
        """
        if not isinstance(path, Path):
            raise InvalidPath(f"path: must be a Path, got {type(path).__name__}; Path.from_poses(poses) returns a Path")
        if problem is not None:
            instance(DockingProblem, problem, "problem")
        if warm_start is not None:
            instance(Path, warm_start, "warm_start")

    def warm_up(self) -> None:
        """Load libraries and compute data in advance, so that the first call is as fast as later calls."""


class TimeParameterizer(Plugin):
    """Compute the time law of a path."""

    @abstractmethod
    def parameterize(  # noqa: PLR0913 - path, limits, start state and time limit
        self,
        path: Path,
        limits: MotionLimits,
        zone: SpeedZone,
        *,
        start_speed: float = 0.0,
        start_acceleration: float = 0.0,
        start_wait: float = 0.0,
        max_time: float = math.inf,
        cancel_checker: Callable[[], bool] = never_cancelled,
    ) -> TimingResult:
        """Return the motion along `path` under `limits`, at rest at every cusp and at the end.

        A motion with status OK passes `certify_trajectory`. If there is little time, the motion is slower or the status
        is TIMED_OUT. Callers pass `start_wait` only if it is positive.

        Args:
            path: Path.
            limits: Motion limits.
            zone: Speed zone at the end of the path.
            start_speed: Speed in the direction of travel at the start, >= 0 in both gears [m/s].
            start_acceleration: Acceleration in the direction of travel at the start [m/s^2].
            start_wait: Time at rest at the start, for steering [s]; if the robot moves at the start, the status is
                FAIL.
            max_time: Wall-clock time for the whole call [s]; with 0 or less the status is TIMED_OUT.
            cancel_checker: Polled at least every 5 ms.

        Raises:
            InvalidValue: If `max_time`, the start state or `start_wait` is NaN, or the wait is negative.
            TimingCancelled: If `cancel_checker` returned True.
        """


class Controller(Plugin):
    """Compute velocity commands along a path or a trajectory."""

    @abstractmethod
    def set_path(self, path: Path | Trajectory, *, start_stamp: float | None = None) -> None:
        """Set the path or trajectory to be followed.

        Args:
            path: Path or trajectory.
            start_stamp: Time at which a trajectory begins, on the clock of the stamps [s], for a change of plan while
                the robot moves. None: the trajectory begins with the next command.

        Raises:
            ControllerInvalidPath: If the path or trajectory cannot be followed.
        """

    @abstractmethod
    def compute_velocity_commands(
        self, pose: Pose2, velocity: Twist2, goal_checker: GoalChecker | None, *, stamp: float | None = None
    ) -> Twist2:
        """Return the command of this control cycle.

        Args:
            pose: Measured pose in the path's frame.
            velocity: Measured body velocity.
            goal_checker: Goal checker whose tolerances are used, or None.
            stamp: Time of the measured pose, on any monotonic clock [s]; None: now, on the context's clock.

        Raises:
            NoValidControl: If no command is admissible in this cycle.
            ControllerException: For any other failure.
        """

    @abstractmethod
    def set_speed_limit(self, limit: float, percentage: bool) -> None:  # noqa: FBT001 - Nav2's order of arguments
        """Limit the speed; 0 removes the limit.

        Args:
            limit: Limit in percent of the maximum (values above 100 are reduced to 100) or in m/s.
            percentage: Whether `limit` is in percent.

        Raises:
            InvalidValue: If `limit` is negative or not finite, or `percentage` is not a bool.
        """

    def reset(self) -> None:
        """Clear the task; called when it ends."""

    def cancel(self) -> bool:
        """Request a graceful stop; return True when stopped, False to be called again after more commands."""
        return True


class Behavior(Plugin):
    """Drive a recovery or auxiliary motion."""

    @property
    @abstractmethod
    def resource_info(self) -> CostmapInfoType:
        """Costmaps used in the collision checks, which always include the obstacles of the problem."""

    @abstractmethod
    def on_run(self, command: Mapping[str, object]) -> BehaviorResult:
        """Start the behavior; cycles may follow only if the result is SUCCEEDED."""

    @abstractmethod
    def on_cycle_update(self, pose: Pose2, velocity: Twist2) -> tuple[BehaviorResult, Twist2]:
        """Return the result of one cycle and its command."""


class Layer(Plugin):
    """Write the costs from one source into a layered costmap."""

    _is_current = True

    @abstractmethod
    def reset(self) -> None:
        """Remove all observations."""

    @abstractmethod
    def update_bounds(self, robot: Pose2, bounds: Bounds) -> Bounds:
        """Return `bounds`, extended by the area that this layer will write."""

    @abstractmethod
    def update_costs(self, master: Costmap, min_i: int, min_j: int, max_i: int, max_j: int) -> None:
        """Write costs into `master`, only in columns [min_i, max_i) and rows [min_j, max_j)."""

    def is_clearable(self) -> bool:
        """Whether a clearing behavior may reset the layer."""
        return False

    def is_current(self) -> bool:
        """Whether the costs of the layer are up to date; servers wait until this is the case.

        An override must call this method to respect `set_current(False)`.
        """
        return self._is_current

    def set_current(self, current: bool) -> None:  # noqa: FBT001 - Nav2's only argument
        """Set whether the layer is up to date."""
        self._is_current = bool(current)

    def is_enabled(self) -> bool:
        """Whether the layer is used."""
        return True

    def match_size(self) -> None:
        """Adapt to a new size of the master grid."""

    def on_footprint_changed(self) -> None:
        """Adapt to a new footprint of the robot."""


class GoalChecker(Plugin):
    """Decide whether the robot has arrived."""

    @abstractmethod
    def is_goal_reached(self, query_pose: Pose2, goal_pose: Pose2, velocity: Twist2, path: Sequence[Pose2]) -> bool:
        """Whether the robot at `query_pose` has arrived.

        Args:
            query_pose: Pose of the robot.
            goal_pose: Goal, in the same frame.
            velocity: Body velocity.
            path: Remaining path, any sequence of poses, possibly empty.
        """

    def is_goal_xy_reached(self, query_pose: Pose2, goal_pose: Pose2, velocity: Twist2, path: Sequence[Pose2]) -> bool:
        """Whether the position is accepted, now or by a latch; by default the result of `is_goal_reached`."""
        return self.is_goal_reached(query_pose, goal_pose, velocity, path)

    @property
    @abstractmethod
    def tolerances(self) -> Tolerances:
        """Errors that are accepted at the goal."""

    def reset(self) -> None:
        """Clear latched arrivals before a new path."""


class DockType(Plugin):
    """Define the staging poses, detections, contact and charging of a kind of dock.

    The executor calls each method within a control cycle.
    """

    @abstractmethod
    def contact(self, now: AtDock) -> Contact | None:
        """Return the present contact, or None.

        Called once in every control cycle with a known pose, in order of the stamps. Contact that is reported while
        `now.is_near` is False counts as a fault.
        """

    @property
    def is_pressed_on(self) -> bool:
        """Whether the robot drives on until contact; if False, the drive also ends when the goal checker accepts."""
        return False

    @property
    def waits_for_charge(self) -> bool:
        """Whether docking ends only when the robot charges."""
        return False

    def is_charging(self, measurements: Measurements) -> bool:
        """Whether the battery is being charged; by default, whether the contact signal is True."""
        return measurements.contact is True

    def staging_poses(self, gear: float, distance: float) -> Sequence[Pose2]:
        """Return poses at which an approach may begin, relative to the docked pose, the preferred pose first.

        If a pose cannot be reached, the next pose is tried. The default is one pose at `distance` on the axis of the
        dock.

        Args:
            gear: Gear of the last motion into the dock: 1 forward, -1 in reverse.
            distance: Distance from the docked pose [m], either from the settings or long enough to correct an
                inaccurate dock pose.
        """
        return (Pose2(-gear * distance, 0.0, 0.0),)

    def detections(self, measurements: Measurements) -> Sequence[Detection]:
        """Return the detections of the dock, as poses of the docked robot; by default all measured detections.

        Called once for every set of measurements, before `contact`.
        """
        return measurements.detections

    @property
    def back_out_distance(self) -> float:
        """Largest straight distance [m] out of contact before a path is planned; for undocking, the final straight."""
        return 0.1  # twice the 5 cm within which contact is accepted

    def reset(self) -> None:
        """Clear the state before a task or another approach."""
