"""The contract of smoothers."""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from optdock.errors import InvalidValue, SmootherCancelled, SmootherException, SmootherTimedOut
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2, normalize_angle
from optdock.model.path import Path
from optdock.plugins.interfaces import PluginContext, Smoother, SmoothingReport, SmoothingResult
from optdock.testing.contracts.contract_scene import (
    GOAL,
    bent_path,
    cusp_path,
    post_inside_the_bend,
    raw_path,
    scene_context,
    scene_problem,
)
from optdock.testing.contracts.plugin import PluginContract
from optdock.testing.contracts.rules import refused, require, require_cancellable
from optdock.verification import certify_path, pose_clearances

if TYPE_CHECKING:
    from optdock.model.problem import DockingProblem

__all__ = ["SmootherContract"]

_SAME = 1e-6  # [m], [rad]
_AMPLE = 20.0  # [s]
_MOTION = Pose2(1.3, -0.7, 2.5)
_MOVED = 1e-5  # [m]: an iteration may stop elsewhere by rounding


def _numbers(path: Path) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(float(value) for value in row) for row in path.sample(0.1).poses)


class SmootherContract(PluginContract[Smoother]):
    """`optdock.plugins.interfaces.Smoother`: makes a path smoother, within its time, between the same two poses."""

    interface: ClassVar[type[Smoother]] = Smoother

    def tasks(self) -> tuple[tuple[Path, DockingProblem | None], ...]:
        """Paths, and what must hold for them; None: whatever the configured surroundings say."""
        return ((raw_path(), scene_problem()), (raw_path(), None), (cusp_path(), None))

    def exercise(self, plugin: Smoother) -> object:
        """The first task's path, as numbers; time plays no part."""
        path, problem = self.tasks()[0]
        result = plugin.smooth(path, _AMPLE, problem=problem)
        return result.completed, _numbers(result.path)

    def test_the_ends_stay(self) -> None:
        """`smooth`: a smoother path between the same two poses."""
        smoother = self.ready_plugin()
        for path, problem in self.tasks():
            self._require_same_ends(smoother.smooth(path, _AMPLE, problem=problem).path, path)

    def test_the_frame_stays(self) -> None:
        """`smooth`: in the same frame: a result that names one names that of the input."""
        smoother = self.ready_plugin()
        for path, problem in self.tasks():
            named = path.with_frame(scene_problem().frame)
            found = smoother.smooth(named, _AMPLE, problem=problem).path.frame
            require(found in ("", named.frame), f"the result names no other frame than {named.frame!r}, got {found!r}")

    def test_it_drives_into_nothing_that_the_path_cleared(self) -> None:
        """`smooth`: what the problem says must not be touched, or what the context knows: refused, or kept clear."""
        path, post = bent_path(), post_inside_the_bend()
        with_post = scene_problem(obstacles=post)
        smoother = self.make_plugin()
        smoother.configure(scene_context(with_post))
        before = self._deepest(path, with_post)
        for problem in (with_post, None):
            try:
                result = smoother.smooth(path, _AMPLE, problem=problem).path
            except SmootherException as error:  # noqa: PERF203 - both ways are tried
                require(str(error), "a refusal says why")
            else:
                after = self._deepest(result, with_post)
                require(after >= before - _SAME, f"a path that cleared all obstacles touches one by {-after:.4f} m")

    def test_a_problem_counts_the_same_configured_and_in_the_call(self) -> None:
        """`problem`: None means the configured one, with all its obstacles; a certificate in the report is true."""
        for top in (-0.08, 0.12):  # beside the path, and in its way
            rock = [[1.4, -0.3], [1.6, -0.3], [1.6, top], [1.4, top]]
            problem = scene_problem(obstacles=ObstacleSet.from_polygons([rock]))
            configured, called = self.make_plugin(), self.make_plugin()
            configured.configure(PluginContext(name="contract", problem=problem))
            called.configure(PluginContext(name="contract", footprint=problem.robot.footprint))
            mine, theirs = self._smoothed(configured, problem, None), self._smoothed(called, problem, problem)
            require(mine == theirs, f"a configured problem gives {theirs}, as in the call; got {mine}")

    def _smoothed(self, smoother: Smoother, problem: DockingProblem, in_call: DockingProblem | None) -> object:
        """What comes out between the ends of `problem`, comparable; where it claims a certificate, that must hold."""
        try:
            result = smoother.smooth(raw_path(), _AMPLE, problem=in_call)
        except SmootherException as error:
            return type(error), str(error)
        claim = result.report.certificate
        if claim is not None and claim.certified:
            verdict = certify_path(result.path, problem)
            require(verdict.certified, f"what is reported as certified is: {verdict.reason}")
        return _numbers(result.path)

    def test_a_rigid_motion_of_the_task_moves_the_result(self) -> None:
        """`smooth`: path and problem in one frame, whichever: moved together they give the same path there."""
        smoother = self.ready_plugin()
        here = smoother.smooth(raw_path(), _AMPLE, problem=scene_problem()).path.sample(0.1).poses
        goal = _MOTION @ GOAL
        moved = smoother.smooth(raw_path(_MOTION, goal), _AMPLE, problem=scene_problem(_MOTION, goal)).path
        there = np.array([(_MOTION.inverse() @ Pose2.from_sequence(row)).as_array() for row in moved.sample(0.1).poses])
        same = there.shape == here.shape and bool(np.max(np.abs(there - here)[:, :2]) <= _MOVED)
        require(same, f"moved by {_MOTION}, the task gives the moved path within {_MOVED} m")

    def test_the_result_says_what_it_is(self) -> None:
        """`SmoothingResult`: a usable path, whether it was completed, and a report for people and logs."""
        smoother = self.ready_plugin()
        for path, problem in self.tasks():
            result = smoother.smooth(path, _AMPLE, problem=problem)
            require(isinstance(result, SmoothingResult), f"a SmoothingResult, got {type(result).__name__}")
            require(isinstance(result.path, Path) and result.path.length > 0.0, "its path is a Path with a length")
            require(isinstance(result.completed, bool), f"completed is a bool, got {result.completed!r}")
            require(isinstance(result.report, SmoothingReport), f"a SmoothingReport, got {result.report!r}")

    def test_the_input_is_not_touched(self) -> None:
        """`smooth`: the result is returned; unlike Nav2's, the input stays what it was."""
        smoother = self.ready_plugin()
        for path, problem in self.tasks():
            segments, before = path.segments, _numbers(path)
            smoother.smooth(path, _AMPLE, problem=problem)
            require(path.segments is segments and _numbers(path) == before, "the input path is left as it was")

    def test_gears_stay_in_order(self) -> None:
        """`smooth`: a smoother path, not another manoeuvre: the gears and their order stay."""
        smoother = self.ready_plugin()
        for path, problem in self.tasks():
            wanted = [segment.direction for segment in path.segments]
            found = [segment.direction for segment in smoother.smooth(path, _AMPLE, problem=problem).path.segments]
            require(found == wanted, f"the gears stay {wanted}, got {found}")

    def test_a_path_too_short_is_refused_or_returned(self) -> None:
        """`smooth`: InvalidPath where the path is too short to smooth; a result, or another named refusal, is fine."""
        smoother = self.ready_plugin()
        ahead = [Pose2(length, 0.0, 0.0) for length in (1e-6, 1e-3, 0.3)]
        for end in (*ahead, Pose2(0.0, 0.0, 0.5)):
            path = Path.from_poses([Pose2(0.0, 0.0, 0.0), end])
            try:
                result = smoother.smooth(path, _AMPLE)
            except SmootherException as error:
                require(str(error), f"a refusal says why, to {end}")
            else:
                self._require_same_ends(result.path, path)

    def test_no_time_is_time_out_or_a_usable_path(self) -> None:
        """`smooth`: SmootherTimedOut when the limit came before any usable result."""
        smoother = self.ready_plugin()
        for path, problem in self.tasks():
            for max_time in (1e-9, 1e-4):
                try:
                    result = smoother.smooth(path, max_time, problem=problem)
                except SmootherTimedOut as error:  # noqa: PERF203 - every limit is tried
                    require(str(error), "a time-out says so")
                else:
                    self._require_same_ends(result.path, path)

    def test_a_time_limit_is_a_finite_number_that_is_not_negative(self) -> None:
        """`max_time`: wall-clock seconds for the whole call; NaN, infinity and negative values are not seconds."""
        smoother = self.ready_plugin()
        path, problem = self.tasks()[0]
        for bad in (math.nan, math.inf, -math.inf, -1.0):
            rule = f"max_time {bad} is refused"
            refused(partial(smoother.smooth, path, bad, problem=problem), InvalidValue, rule)

    def test_it_stops_when_cancelled_and_smooths_again(self) -> None:
        """`smooth`: polls `cancel_checker`; SmootherCancelled when it returned True."""
        smoother = self.ready_plugin()
        path, problem = self.tasks()[0]
        before = self.exercise(smoother)
        require_cancellable(
            lambda cancelled: smoother.smooth(path, _AMPLE, problem=problem, cancel_checker=cancelled),
            SmootherCancelled,
        )
        require(self.exercise(smoother) == before, "after a cancellation it smooths as before")

    def test_an_earlier_result_helps_or_is_ignored(self) -> None:
        """`warm_start`: an earlier result for a problem much like this one; one for another must do no harm."""
        smoother = self.ready_plugin()
        path, problem = self.tasks()[0]
        earlier = smoother.smooth(path, _AMPLE, problem=problem).path
        for warm in (earlier, cusp_path(), raw_path(goal=GOAL @ Pose2(-1.0, -0.3, 0.0))):
            self._require_same_ends(smoother.smooth(path, _AMPLE, problem=problem, warm_start=warm).path, path)

    def _deepest(self, path: Path, problem: DockingProblem) -> float:
        """Clearance of the poses of `path`, 0 where they touch nothing [m]."""
        poses = path.sample(0.02).poses
        return float(pose_clearances(poses, problem.robot.footprint, problem.all_obstacles, within=0.0)[0].min())

    def _require_same_ends(self, found: Path, wanted: Path) -> None:
        for what, mine, theirs in (("start", found.start, wanted.start), ("end", found.end, wanted.end)):
            apart, turn = mine.distance_to(theirs), abs(normalize_angle(mine.yaw - theirs.yaw))
            same = np.isfinite(apart) and apart <= _SAME and turn <= _SAME
            require(same, f"the {what} stays {theirs}, got {mine}")
