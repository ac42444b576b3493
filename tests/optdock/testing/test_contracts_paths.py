"""The contracts of planners, smoothers and time parameterizers catch every plugin that breaks a sentence of theirs."""

import dataclasses
import math

import numpy as np
from pydantic import Field

from optdock.errors import NoValidPathCouldBeFound, PlannerCancelled, SmootherCancelled, SmootherTimedOut
from optdock.geometry.pose import normalize_angle
from optdock.model.path import Direction, Path, PolylineSegment
from optdock.plugins.interfaces import (
    GlobalPlanner,
    Smoother,
    SmoothingResult,
    TimeParameterizer,
    TimingResult,
    TimingStatus,
    never_cancelled,
)
from optdock.plugins.parameters import PluginParameters, checked_seconds
from optdock.plugins.registry import create_plugin
from optdock.testing.contracts import GlobalPlannerContract, SmootherContract, TimeParameterizerContract


class LineParameters(PluginParameters):
    spacing: float = Field(0.02, gt=0.0, description="distance between poses [m]")


class Line(GlobalPlanner):
    """Straight to the goal, turning on the way."""

    Parameters = LineParameters
    parameters: LineParameters

    def create_plan(self, start, goal, cancel_checker=lambda: False):
        length = start.distance_to(goal)
        if length < 1e-6:
            raise NoValidPathCouldBeFound("the goal is where the robot is")
        turn = normalize_angle(goal.yaw - start.yaw)
        poses = []
        for share in np.linspace(0.0, 1.0, min(1000, 2 + int(length / self.parameters.spacing))):
            if cancel_checker():
                raise PlannerCancelled("cancelled")
            poses.append([*self.point(start, goal, share), start.yaw + share * turn])
        return self.joined(poses, goal)

    def point(self, start, goal, share):
        return start.x + share * (goal.x - start.x), start.y + share * (goal.y - start.y)

    def joined(self, poses, goal):
        return Path.from_poses([*poses[:-1], goal])


def planner(**methods):
    return type("Broken", (Line,), methods)


def bulging(scale):
    def point(self, start, goal, share):
        x, y = Line.point(self, start, goal, share)
        return x, y + share * (1.0 - share) * scale(start)

    return point


def foreign_error(self, start, goal, cancel_checker=lambda: False):
    if start.distance_to(goal) < 1e-6:
        raise ZeroDivisionError
    return Line.create_plan(self, start, goal, cancel_checker)


def test_every_gate_of_planners_can_fail(every_gate):
    broken = {
        "test_the_path_leads_from_start_to_goal_in_their_frame": [
            planner(joined=lambda self, poses, goal: Path.from_poses(poses[:-1])),
            planner(joined=lambda self, poses, goal: Path.from_poses([*poses[:-1], goal], "map")),
        ],
        "test_a_motion_of_the_task_moves_the_path": [
            planner(point=bulging(lambda start: math.sin(0.5 * start.yaw + 1))),
            planner(point=bulging(lambda start: start.x)),
        ],
        "test_it_stops_when_cancelled_and_plans_again": [
            planner(create_plan=lambda self, start, goal, cancel_checker=None: Line.create_plan(self, start, goal))
        ],
        "test_it_fails_by_name": [planner(create_plan=foreign_error)],
    }
    every_gate(GlobalPlannerContract, Line, broken, errors=(ZeroDivisionError,))


class Same(Smoother):
    """The input again."""

    def smooth(self, path, max_time, *, problem=None, warm_start=None, cancel_checker=lambda: False):
        if checked_seconds(max_time, "max_time") < 1e-6:
            raise SmootherTimedOut("no time")
        for _ in range(3):
            if cancel_checker():
                raise SmootherCancelled("cancelled")
        return self.result(path, max_time, warm_start)

    def result(self, path, max_time, warm_start):
        return SmoothingResult(path)


def smoother(result):
    return type("Broken", (Same,), {"result": result})


def poses_of(path):
    return np.vstack([segment.poses for segment in path.segments])


def shortened(self, path, max_time, warm_start):
    return SmoothingResult(Path.from_poses(poses_of(path)[:-1]))


def touching(self, path, max_time, warm_start):
    object.__setattr__(path, "segments", (*path.segments,))
    return SmoothingResult(path)


def on_a_grid(self, path, max_time, warm_start):
    poses = poses_of(path)
    poses[1:-1, :2] = poses[1:-1, :2].round(2)
    return SmoothingResult(Path.from_poses(poses))


def sagging(self, path, max_time, warm_start):
    poses = poses_of(path)
    poses[1:-1, 1] -= 0.002
    return SmoothingResult(Path.from_poses(poses))


def one_gear(self, path, max_time, warm_start):
    return SmoothingResult(Path((PolylineSegment(poses_of(path), Direction.FORWARD),)))


def dividing(self, path, max_time, warm_start):
    return SmoothingResult(path) if path.length else 1.0 / path.length


def halved_in_haste(self, path, max_time, warm_start):
    return shortened(self, path, max_time, warm_start) if max_time < 1e-3 else SmoothingResult(path)


class Timeless(Same):
    def smooth(self, path, max_time, **rest):
        return super().smooth(path, 1.0, **rest)


class Deaf(Same):
    def smooth(self, path, max_time, *, cancel_checker=None, **rest):
        return super().smooth(path, max_time, **rest)


class CallOnly(Same):
    """Heeds the problem of the call, and forgets the configured one."""

    def smooth(self, path, max_time, *, problem=None, warm_start=None, cancel_checker=lambda: False):
        if problem is not None and len(problem.obstacles):
            path = Path.from_poses(np.delete(poses_of(path), 1, axis=0))
        return super().smooth(path, max_time, warm_start=warm_start, cancel_checker=cancel_checker)


def test_every_gate_of_smoothers_can_fail(every_gate):
    broken = {
        "test_a_problem_counts_the_same_configured_and_in_the_call": [CallOnly],
        "test_the_result_replaces_the_input": [
            smoother(shortened),
            smoother(lambda self, path, *_: SmoothingResult(Path(path.segments, "odom"))),
            smoother(lambda self, path, *_: SmoothingResult(path, completed=1)),
            smoother(touching),
            smoother(one_gear),
        ],
        "test_obstacles_that_the_path_clears_stay_clear": [smoother(sagging)],
        "test_a_rigid_motion_of_the_task_moves_the_result": [smoother(on_a_grid)],
        "test_a_path_too_short_is_refused_or_returned": [smoother(dividing)],
        "test_little_time_is_a_time_out_or_a_usable_path": [smoother(halved_in_haste), Timeless],
        "test_it_stops_when_cancelled_and_smooths_again": [Deaf],
        "test_a_warm_start_keeps_the_ends": [smoother(lambda self, path, _, warm: SmoothingResult(warm or path))],
    }
    every_gate(SmootherContract, Same, broken, errors=(ZeroDivisionError,))


class Delegating(TimeParameterizer):
    """The built-in method, with a place to spoil question and answer."""

    def parameterize(
        self,
        path,
        limits,
        zone,
        *,
        start_speed=0.0,
        start_acceleration=0.0,
        max_time=math.inf,
        cancel_checker=never_cancelled,
    ):
        limits, start_speed = self.question(path, limits, start_speed)
        result = create_plugin(TimeParameterizer, "Windowed").parameterize(
            path,
            limits,
            zone,
            start_speed=start_speed,
            start_acceleration=start_acceleration,
            max_time=self.patience(max_time),
            cancel_checker=self.hearing(cancel_checker),
        )
        return self.answer(result)

    def patience(self, max_time):
        return max_time

    def hearing(self, cancel_checker):
        return cancel_checker

    def question(self, path, limits, start_speed):
        return limits, start_speed

    def answer(self, result):
        return result


def timing(**methods):
    return type("Broken", (Delegating,), methods)


def slower_far_away(self, path, limits, start_speed):
    share = 0.9 if path.start.x > 1.0 else 1.0
    return dataclasses.replace(limits, max_speed=share * limits.max_speed), start_speed


def test_every_gate_of_time_parameterizers_can_fail(every_gate):
    def change(**values):
        return timing(answer=lambda self, result: dataclasses.replace(result, **values))

    broken = {
        "test_a_motion_that_is_ok_is_certified": [
            timing(
                question=lambda self, path, limits, v: (dataclasses.replace(limits, max_jerk=2 * limits.max_jerk), v)
            )
        ],
        "test_moving_the_path_changes_no_time": [timing(question=slower_far_away)],
        "test_infeasible_starts_are_statuses": [change(status=TimingStatus.OK), change(reason="")],
        "test_a_path_too_short_to_stop_on_has_an_overshoot": [change(overshoot=0.0)],
        "test_degenerate_paths_and_starts_have_a_status": [
            timing(answer=lambda self, result: TimingResult(TimingStatus.OK, result.trajectory)),
            timing(answer=lambda self, result: TimingResult(TimingStatus.OK, None)),
            timing(question=lambda self, path, limits, v: (limits, v if math.isfinite(v) else 0.0)),
        ],
        "test_it_stops_when_cancelled_and_times_again": [timing(hearing=lambda self, _: never_cancelled)],
        "test_little_time_is_a_status": [timing(patience=lambda self, max_time: math.inf)],
    }
    every_gate(TimeParameterizerContract, Delegating, broken)
