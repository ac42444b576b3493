"""The contract of goal checkers."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from optdock.geometry.pose import Pose2, Twist2
from optdock.plugins.interfaces import GoalChecker, Tolerances
from optdock.testing.contracts.contract_scene import GOAL
from optdock.testing.contracts.plugin import PluginContract
from optdock.testing.contracts.rules import require

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

__all__ = ["GoalCheckerContract"]

_MOTION = Pose2(2.0, -1.0, 0.7)
_FAR = 100.0  # [m]
_REST = Twist2()


def _remaining(length: float, goal: Pose2 = GOAL) -> list[Pose2]:
    """A straight remaining path of `length` [m] that ends at the goal."""
    return [goal @ Pose2(-length * share, 0.0, 0.0) for share in (1.0, 0.5, 0.0)]


class GoalCheckerContract(PluginContract[GoalChecker]):
    """`optdock.plugins.interfaces.GoalChecker`: decides whether the robot has arrived."""

    interface: ClassVar[type[GoalChecker]] = GoalChecker

    def exercise(self, plugin: GoalChecker) -> object:
        """Verdicts over a run of queries near the goal, from a reset on."""
        plugin.reset()
        return tuple(plugin.is_goal_reached(*query) for query in self.queries())

    def queries(self, motion: Pose2 | None = None) -> Iterator[tuple[Pose2, Pose2, Twist2, list[Pose2]]]:
        """Query pose, goal, velocity, path: 60 drawn around the goal, all carried along by `motion`."""
        draw, place = np.random.default_rng(5), motion or Pose2(0.0, 0.0, 0.0)
        for _ in range(60):
            dx, dy, turn = draw.normal(size=3) * (0.2, 0.2, 0.3)
            v, w, length = draw.choice([0.0, 0.3]), draw.choice([0.0, 0.3]), draw.choice([0.0, 0.2, 0.6])
            goal = place @ GOAL
            yield goal @ Pose2(dx, dy, turn), goal, Twist2(v, w), _remaining(length, goal) if length else []

    def test_a_robot_at_rest_at_the_goal_has_arrived(self) -> None:
        """`is_goal_reached`: whether the robot has arrived; the remaining path may be empty."""
        for path in ([], [GOAL], [GOAL, GOAL], _remaining(0.05), tuple(_remaining(0.05))):
            checker = self.ready_plugin()
            checker.reset()
            reached = checker.is_goal_reached(GOAL, GOAL, _REST, path)
            require(reached is True, f"at the goal, at rest, it is reached (path of {len(path)} poses), got {reached}")

    def test_a_robot_far_away_has_not(self) -> None:
        """`is_goal_reached`: 100 m away in eight directions, at rest, with any path that ends at the goal."""
        for eighth in range(8):
            angle = eighth * math.pi / 4.0
            query = GOAL @ Pose2(_FAR * math.cos(angle), _FAR * math.sin(angle), 0.0)
            for path in ([], [GOAL], _remaining(0.05)):
                self._require_not_reached(query, path, f"100 m away at {angle:.2f} rad")

    def test_repeated_and_single_poses_are_judged(self) -> None:
        """`path`: any sequence of poses; coincident ones give no direction and must not give NaN either."""
        for path in ([GOAL] * 5, [GOAL @ Pose2(1e-12, 0.0, 0.0), GOAL], _remaining(1e-9)):
            reached = self.ready_plugin().is_goal_reached(GOAL, GOAL, _REST, path)
            require(reached is True, f"at the goal with coincident poses it is reached, got {reached}")

    def test_a_long_remaining_path_is_not_the_end(self) -> None:
        """`Tolerances.path_length`: where it is measured, the goal is not reached with more path to drive."""
        longest = self.ready_plugin().tolerances.path_length
        if longest is not None:
            self._require_not_reached(GOAL, _remaining(1.01 * longest + 0.01), f"more than {longest} m remain")

    def test_a_measured_heading_is_measured(self) -> None:
        """`Tolerances.yaw`: where it is not None, a robot at the goal but turned by 90 degrees has not arrived."""
        accepted = self.ready_plugin().tolerances.yaw
        if accepted is not None and accepted < 0.5 * math.pi:
            for turn in (0.5 * math.pi, -0.5 * math.pi):
                self._require_not_reached(GOAL @ Pose2(0.0, 0.0, turn), [], f"turned by {turn:.2f} rad")

    def test_tolerances_are_numbers_or_none(self) -> None:
        """`tolerances`: what it accepts; None where it does not measure, else finite and not negative."""
        found = self.ready_plugin().tolerances
        require(isinstance(found, Tolerances), f"tolerances are Tolerances, got {type(found).__name__}")
        for name, value in found._asdict().items():
            require(value is None or (math.isfinite(value) and value >= 0.0), f"tolerances.{name}, got {value}")
        require((found.x is None) == (found.y is None), "a position is measured along both axes or not at all")

    def test_verdicts_are_booleans_and_inputs_stay(self) -> None:
        """`is_goal_reached`: returns a bool and changes nothing that it was given."""
        checker = self.ready_plugin()
        for query, goal, velocity, path in self.queries():
            given = list(path)
            reached = checker.is_goal_reached(query, goal, velocity, path)
            require(isinstance(reached, bool), f"the verdict is a bool, got {type(reached).__name__}")
            require(path == given, "the path is left as it was")

    def test_reset_forgets_every_latch(self) -> None:
        """`reset`: a new path begins: a checker that has been reset answers as a new one does."""
        checker, verdicts = self.ready_plugin(), self.exercise(self.ready_plugin())
        checker.is_goal_reached(GOAL, GOAL, _REST, [])
        checker.reset()
        far = checker.is_goal_reached(GOAL @ Pose2(-_FAR, 0.0, 0.0), GOAL, _REST, [])
        require(far is False, "after a reset an earlier arrival counts for nothing")
        require(self.exercise(checker) == verdicts, "after a reset it answers as a new one")

    def test_who_has_arrived_is_in_position(self) -> None:
        """`is_goal_xy_reached`: the position alone: a bool, and True right after an arrival with the same arguments."""
        checker = self.ready_plugin()
        for query in self.queries():
            checker.reset()
            reached = checker.is_goal_reached(*query)
            in_position = checker.is_goal_xy_reached(*query)
            require(isinstance(in_position, bool), f"the verdict is a bool, got {type(in_position).__name__}")
            require(in_position or not reached, f"arrived, so in position, at {query[0]}")

    def test_arrival_does_not_depend_on_where_the_world_begins(self) -> None:
        """`is_goal_reached`: poses in the same frame, whichever: moving all of them changes no verdict."""
        for motion in (_MOTION, Pose2(0.0, 0.0, 2.0 * math.pi)):
            here, there = self.ready_plugin(), self.ready_plugin()
            for query, moved in zip(self.queries(), self.queries(motion), strict=True):
                verdicts = here.is_goal_reached(*query), there.is_goal_reached(*moved)
                require(verdicts[0] == verdicts[1], f"the verdict of {query[0]} stays under the motion {motion}")

    def _require_not_reached(self, query: Pose2, path: Sequence[Pose2], why: str) -> None:
        checker = self.ready_plugin()
        checker.reset()
        require(checker.is_goal_reached(query, GOAL, _REST, path) is False, f"not reached: {why}")
