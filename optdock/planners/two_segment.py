"""The two-segment docking path as a pure function: steps 5 to 8 of the dock planner.

Segment 1 takes the robot from the start to the approach axis, segment 2 runs along the axis into the dock. Both are
NURBS curves through three control points. The result is a raw path: its first tangent ignores the yaw of the start,
curvature is unbounded where the control legs are short and jumps at the joint, there is a corner for `dir` 0, and the
robot's outline is not checked. Making it drivable is the smoother's work.

Told in the order of the method: the plan, how its curves are sampled (step 5), where and how segment 1 joins the axis
(step 6), and how the parts become a path (steps 7 and 8).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.errors import (
    GoalOccupied,
    GoalOutsideMapBounds,
    NoValidPathCouldBeFound,
    PlannerCancelled,
    PlannerException,
    StartOccupied,
    StartOutsideMapBounds,
)
from optdock.geometry.arrays import FrozenArrays
from optdock.geometry.nurbs import Nurbs
from optdock.geometry.pose import unwrap_yaw
from optdock.model.path import Direction, Path, PolylineSegment
from optdock.planners.approach_axis import ApproachAxis, DockGeometry, approach_axis
from optdock.plugins.interfaces import never_cancelled

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.geometry.arrays import FloatArray, IntArray
    from optdock.geometry.pose import Pose2
    from optdock.model.costmap import Costmap
    from optdock.planners.dock_parameters import DockPlannerParameters

__all__ = [
    "MAX_SAMPLES",
    "CurveSampler",
    "Joint",
    "JointKind",
    "TwoSegmentPlan",
    "find_joint",
    "interior_angles",
    "plan_two_segment",
]

_SAME_POSITION = 1e-9  # [m]
_SAME_DISTANCE = 1e-9  # [m]; decides ties alike in every frame
_SAME_ANGLE = 1e-9  # [rad]
_ON_AXIS = 1e-6  # [m]
_REVERSE_SLACK = 0.05  # [rad], of the source
MAX_SAMPLES = 200_000  # of one curve; a path of 1 km at 5 mm
_CHUNK = 5_000  # samples between two looks at the cancel checker, about 2 ms


@dataclass(frozen=True, eq=False)
class TwoSegmentPlan(FrozenArrays):
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
        centreline=centreline,
        control_points_1=joint.control_points,
        control_points_2=control_points_2,
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


@dataclass(frozen=True, eq=False)
class CurveSampler:
    """Samples curves through control points.

    Args:
        degree: NURBS degree.
        step: Coarsest step of u.
        resolution: Largest distance of neighbouring poses [m].
        costmap: Where every sample must be free, or None to check nothing.
        cost_threshold: A cost at or above this blocks.
        cancel_checker: Polled while sampling.
    """

    degree: int
    step: float
    resolution: float
    costmap: Costmap | None
    cost_threshold: int
    cancel_checker: Callable[[], bool]

    def poses(self, control_points: FloatArray, direction: Direction, name: str) -> FloatArray:
        """Poses from u = 0 to 1, yaw along the tangent, or against it in reverse.

        Neighbours are at most `resolution` apart: the step of u is `resolution / max |dC/du|`. The source takes the
        mean of |dC/du|, the length, and so spaces poses up to twice too far where the curve is fast. As in the source
        the last pose takes the yaw of the one before it. Samples that are not finite are skipped.

        Args:
            control_points: Shape (n, 2) [m], n > degree; unit weights.
            direction: Gear.
            name: What to call the curve in a message.

        Returns:
            Shape (m, 3) [m, m, rad], m >= 2.

        Raises:
            NoValidPathCouldBeFound: A sample is blocked, too few are finite, or it would take over MAX_SAMPLES.
            PlannerCancelled: The cancel checker returned True.
        """
        curve = Nurbs(control_points, degree=self.degree)
        u = np.linspace(0.0, 1.0, self._count(curve, name) + 1, dtype=np.float64)
        chunks = [self._chunk(curve, u[i : i + _CHUNK], direction, name) for i in range(0, u.size, _CHUNK)]
        found = np.concatenate(chunks)
        if len(found) < 2:
            raise NoValidPathCouldBeFound(
                f"dock planner: {name} is empty: only {len(found)} of {u.size} samples are finite; its control points "
                f"are {control_points.tolist()}",
                where={"step": name, "control_points": control_points.tolist()},
            )
        found[-1, 2] = found[-2, 2]
        return found

    def _count(self, curve: Nurbs, name: str) -> int:
        steps = max(curve.speed_bound / self.resolution, (1.0 - 1e-6) / self.step)
        if not steps <= MAX_SAMPLES:
            raise NoValidPathCouldBeFound(
                f"dock planner: {name} would take {steps:.3g} samples, at most {MAX_SAMPLES}: its control points span "
                f"{np.ptp(curve.control_points, axis=0).max():.6g} m at a resolution of {self.resolution:.6g} m; start "
                "nearer",
                where={"step": name, "samples": steps, "resolution": self.resolution},
            )
        return math.ceil(steps * (1.0 + 1e-9))  # rounding must not lift a spacing above the resolution

    def _chunk(self, curve: Nurbs, u: FloatArray, direction: Direction, name: str) -> FloatArray:
        if self.cancel_checker():
            raise PlannerCancelled(f"dock planner: cancelled while sampling {name}")
        points = curve.points_at(u)
        self._check_free(points, name)
        yaw = curve.tangent_yaw_at(u) + (math.pi if direction is Direction.REVERSE else 0.0)
        poses = np.column_stack((points, yaw))
        return poses[np.all(np.isfinite(poses), axis=1)]

    def _check_free(self, points: FloatArray, name: str) -> None:
        if self.costmap is None:
            return
        costs = self.costmap.cost_at(points)
        blocked = np.flatnonzero(costs >= self.cost_threshold)
        if blocked.size:
            x, y = (float(value) for value in points[blocked[0]])
            cost = int(costs[blocked[0]])
            raise NoValidPathCouldBeFound(
                f"dock planner: {name} is blocked at ({x:.3f}, {y:.3f}): cost {cost} there, must be < cost_threshold "
                f"= {self.cost_threshold}",
                where={"step": name, "x": x, "y": y, "cost": cost, "cost_threshold": self.cost_threshold},
            )


class JointKind(IntEnum):
    """The source's `dir`."""

    TOWARD = 1  # turns onto the axis toward the dock, tangent at the end
    AWAY = -1  # turns onto the axis away from the dock, then changes gear
    CORNER = 0  # drives straight to the axis and turns there


class Joint(NamedTuple):
    """How segment 1 reaches the axis.

    `dir`, the index `middle` on the centreline where its middle control point lies (-1 for none), and its three control
    points, Shape (3, 2) [m].
    """

    dir: JointKind
    middle: int
    control_points: FloatArray


def find_joint(start: FloatArray, centreline: FloatArray, angle_threshold: float) -> Joint:
    """The joint of segment 1, tried in the order TOWARD, AWAY, CORNER.

    A start on the axis needs no turn and goes straight to C even where C is too near for the sampled search.

    Args:
        start: Position A, Shape (2,) [m].
        centreline: Samples of the straight line from C to F, Shape (n, 2) [m], n >= 2.
        angle_threshold: Smallest interior angle between the rays from the joint to A and along the axis [rad].
    """
    distance = np.hypot(*(centreline - start).T)
    nearest = int(np.argmax(distance <= distance.min() + _SAME_DISTANCE))
    toward = _first_wide(start, centreline, np.arange(nearest, 0, -1), centreline[0], angle_threshold)
    if toward is not None and _fits(distance[toward], centreline[toward], centreline[0]):
        return _toward(start, centreline, toward, distance[toward])
    if _distance_to_line(start, centreline) <= _ON_AXIS:
        return Joint(JointKind.TOWARD, 0, _straight(start, centreline[0]))
    indices = np.arange(nearest, len(centreline))
    away = _first_wide(start, centreline, indices, centreline[-1], angle_threshold - _REVERSE_SLACK)
    if away is not None and _fits(distance[away], centreline[away], centreline[-1]):
        return Joint(JointKind.AWAY, away, np.array([start, centreline[away], centreline[-1]]))
    return Joint(JointKind.CORNER, -1, _straight(start, centreline[nearest]))


def interior_angles(at: FloatArray, first: FloatArray, second: FloatArray) -> FloatArray:
    """Angles in [0, pi] at points `at`, Shape (n, 2), between the rays to two points; 0 where a ray has no length.

    >>> interior_angles(np.zeros((1, 2)), np.array([0.0, 2.0]), np.array([-1.0, 0.0])) / np.pi
    array([0.5])
    """
    a, b = first - at, second - at
    cross = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    angles: FloatArray = np.arctan2(cross, np.sum(a * b, axis=1))
    return angles


def _first_wide(
    start: FloatArray, centreline: FloatArray, indices: IntArray, end: FloatArray, threshold: float
) -> int | None:
    """The first of `indices` whose angle between the rays to start and to `end` reaches the threshold."""
    at = centreline[indices]
    real = np.hypot(*(at - start).T) > _SAME_DISTANCE  # a ray of rounding noise has no angle
    wide = (interior_angles(at, start, end) >= threshold - _SAME_ANGLE) & real
    return int(indices[np.argmax(wide)]) if wide.any() else None


def _fits(leg: float, joint: FloatArray, end: FloatArray) -> bool:
    """Whether the run-in from the joint to `end` is at least as long as the way to the joint."""
    return bool(np.hypot(*(end - joint)) >= leg - _SAME_DISTANCE)


def _toward(start: FloatArray, centreline: FloatArray, index: int, leg: float) -> Joint:
    """Equal legs, to one sample: an arc that ends tangent to the axis."""
    ahead = centreline[index::-1]
    far = np.hypot(*(ahead - centreline[index]).T) >= leg - _SAME_DISTANCE
    end = ahead[int(np.argmax(far))]
    return Joint(JointKind.TOWARD, index, np.array([start, centreline[index], end]))


def _straight(start: FloatArray, end: FloatArray) -> FloatArray:
    return np.array([start, 0.5 * (start + end), end])


def _distance_to_line(point: FloatArray, line: FloatArray) -> float:
    along = line[-1] - line[0]
    away = point - line[0]
    return abs(float(along[0] * away[1] - along[1] * away[0])) / float(np.hypot(*along))


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
