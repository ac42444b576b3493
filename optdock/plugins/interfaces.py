"""Nav2's plugin interfaces in Python: method names in snake case, results returned instead of written out.

Every interface is abstract and holds no data of its own beyond `Plugin`'s, but for the flag that `Layer.set_current`
sets. Exceptions keep Nav2's nouns (`errors`).
"""

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
    """The cancel checker of a caller that never cancels."""
    return False


class GlobalPlanner(Plugin):
    """Makes a path from start to goal."""

    @abstractmethod
    def create_plan(self, start: Pose2, goal: Pose2, cancel_checker: Callable[[], bool] = never_cancelled) -> Path:
        """A path from `start` to `goal`, both in the costmap's frame, which the path names where it is known.

        Long work polls `cancel_checker` at least every 5 ms.

        Raises:
            PlannerException: Or one of its children; an empty path is never returned.
            PlannerCancelled: `cancel_checker` returned True.
        """

    def create_plans(
        self,
        start: Pose2,
        goal: Pose2,
        cancel_checker: Callable[[], bool] = never_cancelled,
        better_than: Callable[[], float] = lambda: math.inf,  # noqa: ARG002 - one path is the best of one
    ) -> Iterator[Guess | None]:
        """Several paths to try in turn, the most promising first; by default the one of `create_plan`.

        It works only while it is asked for the next one. A planner that knows many stops when none that could follow
        can have a lower price, and looks far afield only while nothing has been found. None is a pause: what follows
        takes longer than what went before, and the caller may do something else first.

        Args:
            start: As of `create_plan`.
            goal: As of `create_plan`.
            cancel_checker: As of `create_plan`.
            better_than: The price below which a path is worth a try [s]: duration, and what cusps cost; inf while no
                plan has been made of any.

        Raises:
            PlannerException: Or one of its children: there is no path, not even a first one.
            PlannerCancelled: `cancel_checker` returned True.
        """
        yield Guess(self.create_plan(start, goal, cancel_checker))


class Smoother(Plugin):
    """Makes a path smoother."""

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
        """A smoother path between the same two poses, in the same frame.

        Where `problem` is given and `path` begins or ends elsewhere, a smoother that proves its results goes from the
        problem's start to its goal: the path only shows the way, and one that shows another way is refused.

        Args:
            path: The raw path, from any source.
            max_time: Wall-clock seconds for the whole call.
            problem: What must hold; the configured costmap counts as well where the problem has none. None: the
                configured problem, with the ends of `path` where they are others; where none is configured, from the
                first pose of `path` to its last, among the obstacles of the configured costmap.
            warm_start: An earlier result for a problem much like this one.
            cancel_checker: Polled at least every 5 ms.

        Raises:
            InvalidValue: `max_time` is not finite, or negative; `problem` or `warm_start` is of another class.
            InvalidPath: The path is none, is too short to smooth, names another frame than the problem, or leads
                elsewhere.
            SmootherTimedOut: The time limit came before any usable result.
            FailedToSmoothPath: No result keeps every bound; the message names the one in the way.
            SmootherCancelled: `cancel_checker` returned True.
        """

    @staticmethod
    def check_task(path: Path, problem: DockingProblem | None, warm_start: Path | None) -> None:
        """Refuse arguments of `smooth` that are of another class, by name.

        Raises:
            InvalidPath: `path` is no Path.
            InvalidValue: `problem` or `warm_start` is of another class.
        """
        if not isinstance(path, Path):
            raise InvalidPath(f"path: must be a Path, got {type(path).__name__}; Path.from_poses(poses) makes one")
        if problem is not None:
            instance(DockingProblem, problem, "problem")
        if warm_start is not None:
            instance(Path, warm_start, "warm_start")

    def warm_up(self) -> None:
        """Build and load in advance whatever makes a first call slower than the next."""


class TimeParameterizer(Plugin):
    """Gives a path its time law."""

    @abstractmethod
    def parameterize(  # noqa: PLR0913 - what to time, and how long to try
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
        """The time law of `path` under `limits`, at rest at every cusp and at the end.

        What is OK passes `certify_trajectory`. Little time makes slower motions, too little none: TIMED_OUT. Callers
        pass `start_wait` only where it is more than 0.

        Args:
            path: Where to drive.
            limits: What the drive can do.
            zone: Slow stretch at the end of the path.
            start_speed: Speed along the travel at the start, >= 0 in either gear [m/s].
            start_acceleration: Acceleration along the travel at the start [m/s^2].
            start_wait: How long the motion rests at its start before it sets off, because steered wheels are turned
                there [s]; a start in motion then has no motion, FAIL.
            max_time: Wall-clock seconds for the whole call; none left, 0 or less, is TIMED_OUT.
            cancel_checker: Polled at least every 5 ms.

        Raises:
            InvalidValue: `max_time`, the start state or `start_wait` is not a number, or the wait negative.
            TimingCancelled: `cancel_checker` returned True.
        """


class Controller(Plugin):
    """Turns a path or a trajectory into velocity commands."""

    @abstractmethod
    def set_path(self, path: Path | Trajectory, *, start_stamp: float | None = None) -> None:
        """Follow this from now on.

        Args:
            path: What to follow.
            start_stamp: When a trajectory begins, on the clock of the stamps [s]: a new plan takes over in motion just
                then. None: with the next command, from where the robot is.

        Raises:
            ControllerInvalidPath: It cannot be followed.
        """

    @abstractmethod
    def compute_velocity_commands(
        self, pose: Pose2, velocity: Twist2, goal_checker: GoalChecker | None, *, stamp: float | None = None
    ) -> Twist2:
        """The command of this control cycle.

        Args:
            pose: Measured pose in the path's frame.
            velocity: Measured body velocity.
            goal_checker: May be asked for its tolerances; None when there is none.
            stamp: When the pose was measured, on any monotonic clock [s]; None: now, on the context's clock.

        Raises:
            NoValidControl: No command is admissible in this cycle.
            ControllerException: Any other failure.
        """

    @abstractmethod
    def set_speed_limit(self, limit: float, percentage: bool) -> None:  # noqa: FBT001 - Nav2's order of arguments
        """Limit the speed; 0 removes the limit. `set_speed_limit(50.0, True)` halves it, as Nav2 writes it.

        Args:
            limit: Percent of the maximum (100 and more: all of it), or m/s.
            percentage: Whether `limit` is in percent.

        Raises:
            InvalidValue: `limit` is negative or not finite, or `percentage` is not a bool.
        """

    def reset(self) -> None:
        """Forget the task; called when it ends."""

    def cancel(self) -> bool:
        """Ask for a graceful stop; True when stopped, False to be asked again after more commands."""
        return True


class Behavior(Plugin):
    """A timed recovery or auxiliary motion."""

    @property
    @abstractmethod
    def resource_info(self) -> CostmapInfoType:
        """Which costmaps it needs: its collision checks see these; the problem's obstacles count in any case."""

    @abstractmethod
    def on_run(self, command: Mapping[str, object]) -> BehaviorResult:
        """Begin; SUCCEEDED lets the cycles start."""

    @abstractmethod
    def on_cycle_update(self, pose: Pose2, velocity: Twist2) -> tuple[BehaviorResult, Twist2]:
        """One cycle: how it stands, and the command to send."""


class Layer(Plugin):
    """One source of costs in a layered costmap."""

    _is_said_current = True

    @abstractmethod
    def reset(self) -> None:
        """Forget everything observed."""

    @abstractmethod
    def update_bounds(self, robot: Pose2, bounds: Bounds) -> Bounds:
        """`bounds` grown, never shrunk, to what this layer will write."""

    @abstractmethod
    def update_costs(self, master: Costmap, min_i: int, min_j: int, max_i: int, max_j: int) -> None:
        """Write costs into `master`, inside columns [min_i, max_i) and rows [min_j, max_j) only."""

    def is_clearable(self) -> bool:
        """Whether a clearing behavior may reset it."""
        return False

    def is_current(self) -> bool:
        """Whether what it writes is up to date; servers wait while it is not.

        A layer that knows better, from its sensors or its map, asks this as well: `set_current(False)` holds.
        """
        return self._is_said_current

    def set_current(self, current: bool) -> None:  # noqa: FBT001 - Nav2's only argument
        """Declare the layer out of date, or current again."""
        self._is_said_current = bool(current)

    def is_enabled(self) -> bool:
        """Whether it takes part."""
        return True

    def match_size(self) -> None:
        """The master grid changed its size."""

    def on_footprint_changed(self) -> None:
        """The robot's footprint changed."""


class GoalChecker(Plugin):
    """Decides whether the robot has arrived."""

    @abstractmethod
    def is_goal_reached(self, query_pose: Pose2, goal_pose: Pose2, velocity: Twist2, path: Sequence[Pose2]) -> bool:
        """Whether the robot at `query_pose` has arrived.

        Args:
            query_pose: Where the robot is.
            goal_pose: Where it should be, in the same frame.
            velocity: Its body velocity.
            path: The remaining path, any sequence of poses, possibly empty.
        """

    def is_goal_xy_reached(self, query_pose: Pose2, goal_pose: Pose2, velocity: Twist2, path: Sequence[Pose2]) -> bool:
        """Whether the position alone is accepted, a latched one included; by default the whole verdict.

        A checker that asks for more than the position overrides it; the default errs towards False.
        """
        return self.is_goal_reached(query_pose, goal_pose, velocity, path)

    @property
    @abstractmethod
    def tolerances(self) -> Tolerances:
        """What it accepts."""

    def reset(self) -> None:
        """A new path begins: forget latches."""


class DockType(Plugin):
    """A kind of dock: where approaches begin, what counts as a detection, when there is contact, when it charges.

    The executor asks it; it drives nothing itself, and each answer takes a small part of a control cycle.
    """

    @abstractmethod
    def contact(self, now: AtDock) -> Contact | None:
        """The contact that is felt now, as far as this kind of dock tells; None: none.

        It is called once in every control cycle in which it is known where the robot is, moving and at rest, in order
        of the stamps, so that it may count cycles. Contact counts where `now.is_near` only; what is felt farther off is
        a fault, and reported as one.

        Args:
            now: The cycle.
        """

    @property
    def is_pressed_on(self) -> bool:
        """Whether the robot is to press on until contact is felt; False: it is docked where the goal checker says so.

        Contact that is felt counts as docked in either case.
        """
        return False

    @property
    def waits_for_charge(self) -> bool:
        """Whether a robot that stands in the dock has docked only once it charges."""
        return False

    def is_charging(self, measurements: Measurements) -> bool:
        """Whether the battery is being charged; by default, whether the external signal says that there is contact.

        Args:
            measurements: The newest.
        """
        return measurements.contact is True

    def staging_poses(self, gear: float, distance: float) -> Sequence[Pose2]:
        """Where an approach may begin, the preferred one first: poses of the robot seen from the docked pose.

        Where there is no way to one, the next is tried. By default one, at `distance` on the axis of the dock.

        Args:
            gear: Of the last motion into the dock: 1 forward, -1 in reverse.
            distance: From the docked pose that the robot needs to correct a dock that is stored wrongly, or that the
                settings ask for [m].
        """
        return (Pose2(-gear * distance, 0.0, 0.0),)

    def detections(self, measurements: Measurements) -> Sequence[Detection]:
        """What of the measurements is a detection of the dock, as poses of the docked robot; by default all.

        Called once for every set of measurements, before `contact`.

        Args:
            measurements: As they came.
        """
        return measurements.detections

    @property
    def back_out_distance(self) -> float:
        """Straight out of contact at most, before a way back is planned [m]; when undocking, the final straight too."""
        return 0.1  # twice the 5 cm within which contact counts, so that nothing of it is left

    def reset(self) -> None:
        """A task or another approach begins: forget what was felt."""
