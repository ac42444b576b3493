"""The contract of global planners."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from optdock.errors import PlannerCancelled, PlannerException
from optdock.geometry.pose import Pose2, normalize_angle
from optdock.model.path import Path
from optdock.plugins.interfaces import GlobalPlanner
from optdock.testing.contracts.contract_scene import GOAL, ORIGIN, scene_context, scene_problem
from optdock.testing.contracts.plugin import PluginContract
from optdock.testing.contracts.rules import require, require_cancellable

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray

__all__ = ["GlobalPlannerContract"]

_SAME = 1e-6  # [m], [rad]
_MOTION = Pose2(0.7, -1.3, 2.1)


def _require_same_pose(found: Pose2, wanted: Pose2, what: str) -> None:
    turn = normalize_angle(found.yaw - wanted.yaw)
    require(found.distance_to(wanted) <= _SAME and abs(turn) <= _SAME, f"the path {what} at {wanted}, got {found}")


def _numbers(path: Path) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(float(value) for value in row) for row in path.sample(0.1).poses)


class GlobalPlannerContract(PluginContract[GlobalPlanner]):
    """`optdock.plugins.interfaces.GlobalPlanner`: makes a path from start to goal.

    Attributes:
        is_equivariant: Start and goal moved together move the path; not so for planners on a grid.
    """

    interface: ClassVar[type[GlobalPlanner]] = GlobalPlanner
    is_equivariant: ClassVar[bool] = True

    def queries(self) -> tuple[tuple[Pose2, Pose2], ...]:
        """Starts and goals that the planner must find a path between."""
        return ((ORIGIN, GOAL), (Pose2(0.2, -0.8, 0.3), GOAL), (Pose2(-0.5, 1.2, -0.2), Pose2(2.8, 0.0, 0.1)))

    def exercise(self, plugin: GlobalPlanner) -> object:
        """The paths of all queries, as numbers."""
        return tuple(_numbers(plugin.create_plan(start, goal)) for start, goal in self.queries())

    def test_the_path_begins_at_the_start_and_ends_at_the_goal(self) -> None:
        """`create_plan`: a path from `start` to `goal`; an empty path is never returned."""
        planner = self.ready_plugin()
        for start, goal in self.queries():
            path = planner.create_plan(start, goal)
            require(isinstance(path, Path) and path.length > 0.0, f"a Path with a length, got {path!r}")
            _require_same_pose(path.start, start, "begins")
            _require_same_pose(path.end, goal, "ends")

    def test_the_path_stands_in_the_frame_of_the_problem(self) -> None:
        """`create_plan`: in the frame of start and goal; a path that names its frame names that of the problem."""
        planner = self.make_plugin()
        planner.configure(scene_context(dataclasses.replace(scene_problem(), frame="contract frame")))
        for start, goal in self.queries():
            found = planner.create_plan(start, goal).frame
            require(found in ("", "contract frame"), f"the path names no other frame than the problem, got {found!r}")

    def test_yaws_a_full_turn_apart_are_the_same(self) -> None:
        """`create_plan`: yaw is a direction: full turns added to start or goal change no position."""
        planner, turn = self.ready_plugin(), 2.0 * math.pi
        for start, goal in self.queries():
            plain = planner.create_plan(start, goal).sample(0.1)
            turned = planner.create_plan(Pose2(start.x, start.y, start.yaw + turn), goal @ Pose2(0.0, 0.0, -turn))
            _require_close(turned.sample(0.1).poses[:, :2], plain.poses[:, :2], "full turns move no position")

    def test_a_rigid_motion_of_the_task_moves_the_path(self) -> None:
        """`create_plan`: both poses in one frame, whichever: see `is_equivariant`."""
        planner = self.ready_plugin()
        for start, goal in self.queries() if self.is_equivariant else ():
            plain = planner.create_plan(start, goal).sample(0.1).poses
            wanted = np.array([(_MOTION @ Pose2.from_sequence(row)).as_array()[:2] for row in plain])
            found = planner.create_plan(_MOTION @ start, _MOTION @ goal).sample(0.1).poses[:, :2]
            _require_close(found, wanted, "the path moves with its ends")

    def test_it_stops_when_cancelled_and_plans_again(self) -> None:
        """`create_plan`: polls `cancel_checker`; PlannerCancelled when it returned True."""
        planner = self.ready_plugin()
        start, goal = self.queries()[0]
        before = self.exercise(planner)
        require_cancellable(lambda cancelled: planner.create_plan(start, goal, cancelled), PlannerCancelled)
        require(self.exercise(planner) == before, "after a cancellation it plans as before")

    def test_it_fails_by_name(self) -> None:
        """`create_plan`: PlannerException or one of its children where there is no path; nothing else."""
        planner, draw = self.ready_plugin(), np.random.default_rng(3)
        odd = [(GOAL, GOAL), (GOAL @ Pose2(1e-9, 0.0, 0.0), GOAL), (Pose2(1e6, -1e6, 9.0), GOAL)]
        odd += [(GOAL @ Pose2(*draw.normal(size=3)), GOAL) for _ in range(40)]
        for start, goal in odd:
            try:
                path = planner.create_plan(start, goal)
            except PlannerException as error:  # noqa: PERF203 - every query is tried
                require(str(error), f"a failure says why, from {start}")
            else:
                _require_same_pose(path.start, start, "begins")
                _require_same_pose(path.end, goal, "ends")


def _require_close(found: FloatArray, wanted: FloatArray, rule: str) -> None:
    require(found.shape == wanted.shape, f"{rule}: {len(wanted)} samples, got {len(found)}")
    worst = float(np.max(np.abs(found - wanted)))
    require(worst <= 1e-6, f"{rule}: within 1e-6 m, got {worst:.3g} m")
