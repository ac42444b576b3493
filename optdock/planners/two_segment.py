"""The two-segment docking path as a pure function: steps 5 to 8 of the dock planner.

Segment 1 takes the robot from the start to the approach axis, segment 2 runs along the axis into the dock. Both are
NURBS curves through three control points. The result is a raw path: its first tangent ignores the yaw of the start,
curvature is unbounded where the control legs are short and jumps at the joint, there is a corner for `dir` 0, and the
robot's outline is not checked. Making it drivable is the smoother's work.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from optdock.errors import (
    GoalOccupied,
    GoalOutsideMapBounds,
    PlannerCancelled,
    PlannerException,
    StartOccupied,
    StartOutsideMapBounds,
)
from optdock.geometry.arrays import readonly
from optdock.geometry.pose import unwrap_yaw
from optdock.interfaces import never_cancelled
from optdock.path import Direction, Path, PolylineSegment
from optdock.planners.approach_axis import ApproachAxis, DockGeometry, approach_axis
from optdock.planners.curve_sampling import CurveSampler
from optdock.planners.joint_search import Joint, JointKind, find_joint

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.costmap.costmap import Costmap
    from optdock.geometry.arrays import FloatArray
    from optdock.geometry.pose import Pose2
    from optdock.planners.dock_parameters import DockPlannerParameters

__all__ = ["TwoSegmentPlan", "plan_two_segment"]

_SAME_POSITION = 1e-9  # [m]


@dataclass(frozen=True, eq=False)
class TwoSegmentPlan:
    """A raw docking path and how it came about.

    Args:
        path: From the start pose to the goal pose; a cusp where `dir` is -1.
        axis: Where the robot enters: C, D, F, distances, threshold angle, gear of the last motion.
        joint: How segment 1 reaches the axis.
        centreline: Samples of the axis from C to F, Shape (n, 3) [m, m, rad].
        control_points_1: Of segment 1, Shape (3, 2) [m].
        control_points_2: Of segment 2, Shape (3, 2) [m].
    """

    path: Path
    axis: ApproachAxis
    joint: Joint
    centreline: FloatArray
    control_points_1: FloatArray
    control_points_2: FloatArray

    @property
    def direction(self) -> Direction:
        """Gear of the last motion: REVERSE docks backward."""
        return self.axis.direction

    @property
    def dir(self) -> JointKind:
        """1 turns toward the dock, -1 away from it with a cusp, 0 drives to the axis and turns there."""
        return self.joint.dir


def plan_two_segment(
    start: Pose2,
    goal: Pose2,
    geometry: DockGeometry,
    parameters: DockPlannerParameters,
    costmap: Costmap | None = None,
    cancel_checker: Callable[[], bool] = never_cancelled,
) -> TwoSegmentPlan:
    """The raw docking path from `start` to `goal`.

    Args:
        start: Where the robot is.
        goal: Where it must end, nose along the yaw.
        geometry: Sizes of robot and dock.
        parameters: Of the dock planner.
        costmap: Its resolution bounds the spacing of poses (without one, `parameters.resolution` does), and with
            `parameters.check_free_space` the cells under start, goal and curves must be free. Off the map nothing is.
        cancel_checker: Polled at least every 5 ms.

    Raises:
        PlannerException: `parameters.check_free_space` is on, and there is no costmap to check.
        StartOutsideMapBounds: Also StartOccupied, GoalOutsideMapBounds, GoalOccupied: an end is not free.
        NoValidPathCouldBeFound: A rule of the method is broken; the message says in which step and by how much.
        PlannerCancelled: `cancel_checker` returned True.
    """
    if cancel_checker():
        raise PlannerCancelled("dock planner: cancelled before it began")
    if parameters.check_free_space:
        _check_free_ends(start, goal, costmap, parameters.cost_threshold)
    axis = approach_axis(start, goal, geometry, parameters)
    sampler = _sampler(parameters, costmap, cancel_checker)
    middle = 0.5 * (axis.point_c + axis.point_f)
    centreline = sampler.poses(np.array([axis.point_c, middle, axis.point_f]), Direction.FORWARD, "the centreline")
    joint = find_joint(np.array([start.x, start.y]), centreline[:, :2], axis.angle_threshold)
    gear = Direction(-axis.direction) if joint.dir is JointKind.AWAY else axis.direction
    first = sampler.poses(joint.control_points, gear, "segment 1")
    last = first[-1, :2]
    control_points_2 = np.array([last, 0.5 * (last + axis.goal), axis.goal])
    second = sampler.poses(control_points_2, axis.direction, "segment 2")
    return TwoSegmentPlan(
        path=_assembled(start, goal, (first, second), (gear, axis.direction)),
        axis=axis,
        joint=joint,
        centreline=readonly(centreline),
        control_points_1=readonly(joint.control_points),
        control_points_2=readonly(control_points_2),
    )


def _check_free_ends(start: Pose2, goal: Pose2, costmap: Costmap | None, threshold: int) -> None:
    if costmap is None:
        raise PlannerException(
            "dock planner: check_free_space is true, but there is no costmap to check; configure the planner with one, "
            "or set check_free_space: false",
            where={"parameter": "check_free_space"},
        )
    for name, pose, off_map, occupied in (
        ("start", start, StartOutsideMapBounds, StartOccupied),
        ("goal", goal, GoalOutsideMapBounds, GoalOccupied),
    ):
        point = np.array([[pose.x, pose.y]])
        where: dict[str, object] = {"pose": [pose.x, pose.y]}
        if not bool(costmap.contains(point)[0]):
            raise off_map(f"dock planner: the {name} ({pose.x:.3f}, {pose.y:.3f}) lies off the map", where=where)
        cost = int(costmap.cost_at(point)[0])
        if cost >= threshold:
            raise occupied(
                f"dock planner: the {name} ({pose.x:.3f}, {pose.y:.3f}) has cost {cost}, must be < cost_threshold = "
                f"{threshold}",
                where={**where, "cost": cost, "cost_threshold": threshold},
            )


def _sampler(
    parameters: DockPlannerParameters, costmap: Costmap | None, cancel_checker: Callable[[], bool]
) -> CurveSampler:
    return CurveSampler(
        degree=parameters.degree,
        step=parameters.step,
        resolution=parameters.resolution if costmap is None else costmap.resolution,
        costmap=costmap if parameters.check_free_space else None,
        cost_threshold=parameters.cost_threshold,
        cancel_checker=cancel_checker,
    )


def _assembled(
    start: Pose2, goal: Pose2, parts: tuple[FloatArray, FloatArray], gears: tuple[Direction, Direction]
) -> Path:
    """Start + segment 1 + segment 2 + goal; of poses in one place the first stays, and always the goal's."""
    head = _without_repeats(np.vstack((start.as_array(), parts[0])))
    tail = _without_repeats(np.vstack((head[-1], parts[1])))[1:]
    apart = np.hypot(*(tail[:, :2] - goal.as_array()[:2]).T) > _SAME_POSITION
    poses = np.vstack((head, tail[apart], goal.as_array()))
    poses[:, 2] = unwrap_yaw(poses[:, 2])
    joint = len(head) - 1
    if gears[0] is gears[1] or joint == 0:
        return Path((PolylineSegment(poses, gears[1]),))
    return Path((PolylineSegment(poses[: joint + 1], gears[0]), PolylineSegment(poses[joint:], gears[1])))


def _without_repeats(poses: FloatArray) -> FloatArray:
    step = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    kept: FloatArray = poses[np.concatenate(([True], step > _SAME_POSITION))]
    return kept
