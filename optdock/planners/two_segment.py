"""Two-segment docking path: from the start to the approach axis, then along the axis into the dock.

Both segments are NURBS curves through three control points. The path is a raw path: its first tangent does not depend
on the yaw of the start, its curvature is unbounded and jumps at the joint, and the outline of the robot is not checked.

F ------ mid ------ C ------ G      the axis runs from the goal G away from the dock
         D
         A                          start A, its foot D
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from pydantic import Field, field_validator

from optdock.errors import (
    GoalOccupied,
    GoalOutsideMapBounds,
    NoValidPathCouldBeFound,
    PlannerCancelled,
    PlannerException,
    StartOccupied,
    StartOutsideMapBounds,
)
from optdock.geometry.arrays import FrozenArrays, readonly
from optdock.geometry.footprint import Footprint
from optdock.geometry.nurbs import Nurbs, shares
from optdock.geometry.pose import unwrap_yaw
from optdock.model.dock import DockDirection
from optdock.model.path import Direction, Path, PolylineSegment
from optdock.plugins.interfaces import never_cancelled
from optdock.plugins.parameters import PluginParameters

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.geometry.arrays import FloatArray
    from optdock.geometry.pose import Pose2
    from optdock.model.costmap import Costmap

__all__ = [
    "MAX_SAMPLES",
    "ApproachAxis",
    "CurveSampler",
    "DockGeometry",
    "DockPlannerParameters",
    "Joint",
    "JointKind",
    "TwoSegmentPlan",
    "approach_axis",
    "find_joint",
    "interior_angles",
    "plan_two_segment",
]

_SAME_POSITION = 1e-9  # [m]
_SAME_DISTANCE = 1e-9  # [m]; breaks ties in the same way in every frame
_SAME_ANGLE = 1e-9  # [rad]
_ON_AXIS = 1e-6  # [m]
_REVERSE_SLACK = 0.05  # [rad], of the source
MAX_SAMPLES = 200_000  # per curve; a path of 1 km at 5 mm
_CHUNK = 5_000  # samples between two calls of the cancel checker, about 2 ms


class DockPlannerParameters(PluginParameters):
    """Parameters of the two-segment planner; `alpha` to `resolution` are not part of the original method."""

    cost_threshold: int = Field(200, ge=0, le=255, description="cost from which a cell blocks the curve")
    calib_safety_distance: float = Field(0.0, description="distance added to the robot's circumscribed radius [m]")
    check_free_space: bool = Field(
        default=False, description="require free costmap cells under the robot's centre; needs a costmap"
    )
    degree: int = Field(2, ge=1, le=2, description="NURBS degree, at most 2 for three control points")
    step: float = Field(0.02, gt=0.0, le=1.0, description="largest sampling step of u")
    footprint_dock: tuple[tuple[float, float], ...] | None = Field(
        None,
        description="footprint of the dock, Nav2's string or points [m]; null: that of the problem's dock, or length 0",
    )
    alpha: float = Field(1.0, ge=0.0, description="threshold angle of a start on the axis, in units of beta * pi")
    beta: float = Field(0.5, gt=0.0, le=1.0, description="slope of the threshold angle over the scale, in units of pi")
    gamma: float = Field(0.667, gt=0.0, lt=1.0, description="largest threshold angle, in units of pi")
    direction: DockDirection = Field(DockDirection.AUTO, description="gear of the last motion: auto, forward, backward")
    resolution: float = Field(0.05, gt=0.0, description="largest spacing of poses without a costmap [m]")

    @field_validator("footprint_dock", mode="before")
    @classmethod
    def _points(cls, value: object) -> object:
        return [tuple(row) for row in Footprint.from_string(value).vertices] if isinstance(value, str) else value

    @field_validator("footprint_dock")
    @classmethod
    def _is_a_polygon(cls, value: tuple[tuple[float, float], ...] | None) -> tuple[tuple[float, float], ...] | None:
        if value is not None:
            Footprint(np.array(value))
        return value

    @property
    def dock_outline(self) -> Footprint | None:
        """`footprint_dock` as a polygon; None if it is null."""
        return None if self.footprint_dock is None else Footprint(np.array(self.footprint_dock))


class DockGeometry(NamedTuple):
    """Sizes of the robot and the dock [m], and the direction in which the dock is entered.

    `robot_length` and `dock_length` are extents along x, `robot_radius` is the circumscribed radius. The direction of
    the parameters takes precedence unless it is auto.
    """

    robot_length: float
    robot_radius: float
    dock_length: float = 0.0
    direction: DockDirection = DockDirection.AUTO

    @classmethod
    def from_footprints(
        cls, robot: Footprint, dock: Footprint | None = None, direction: DockDirection = DockDirection.AUTO
    ) -> DockGeometry:
        """Return the sizes of two outlines; the length of the dock is 0 if `dock` is None."""
        return cls(robot.length, robot.circumscribed_radius, 0.0 if dock is None else dock.length, direction)


@dataclass(frozen=True, eq=False)
class ApproachAxis(FrozenArrays):
    """The line on which the robot enters the dock, and the position of the start relative to it.

    Args:
        goal: Position G, Shape (2,) [m].
        outward: Unit vector from G away from the dock, Shape (2,).
        direction: Gear of the last motion.
        distance_min_c: Distance from G to C [m].
        along: Distance from G to D [m].
        distance_ad: Distance from the start to the axis [m].
        safety_distance: Twice the padded radius of the robot [m].
        angle_threshold: Smallest interior angle at which segment 1 may turn onto the axis [rad].
    """

    goal: FloatArray
    outward: FloatArray
    direction: Direction
    distance_min_c: float
    along: float
    distance_ad: float
    safety_distance: float
    angle_threshold: float

    def __post_init__(self) -> None:
        vars(self).update(goal=readonly(self.goal), outward=readonly(self.outward))

    def _at(self, distance: float) -> FloatArray:
        return self.goal + distance * self.outward

    @property
    def point_c(self) -> FloatArray:
        """The point in front of the dock, Shape (2,) [m]."""
        return self._at(self.distance_min_c)

    @property
    def point_d(self) -> FloatArray:
        """The foot of the perpendicular from the start, Shape (2,) [m]."""
        return self._at(self.along)

    @property
    def point_f(self) -> FloatArray:
        """The far end of the centreline, Shape (2,) [m].

        Its distance from D, which the original method does not define, is the safety distance, or the distance of the
        start from the axis if that is longer. This is enough for a turn away from the dock up to about 0.6 safety
        distances off the axis.
        """
        return self._at(
            self.distance_min_c + (self.along - self.distance_min_c) + max(self.safety_distance, self.distance_ad)
        )


def approach_axis(start: Pose2, goal: Pose2, geometry: DockGeometry, parameters: DockPlannerParameters) -> ApproachAxis:
    """Return the axis of a docking manoeuvre, on the side of the goal from which the robot comes.

    Raises:
        NoValidPathCouldBeFound: If the robot has no length or no safety distance, if the start is not beyond C, or if
            the start lies on the side that `direction` excludes.
    """
    safety_distance = 2.0 * (geometry.robot_radius + parameters.calib_safety_distance)
    _check_geometry(geometry, safety_distance)
    distance_min_c = 0.5 * (geometry.robot_length + geometry.dock_length)
    c, s, dx, dy = math.cos(goal.yaw), math.sin(goal.yaw), start.x - goal.x, start.y - goal.y
    ahead = c * dx + s * dy
    # The robot comes from behind the docked pose when it drives in forward.
    direction = Direction.REVERSE if ahead > 0.0 else Direction.FORWARD
    wanted = geometry.direction if parameters.direction is DockDirection.AUTO else parameters.direction
    _check_direction(direction, wanted, ahead)
    along = abs(ahead)
    if not along > distance_min_c + _SAME_POSITION:
        raise NoValidPathCouldBeFound(
            f"dock planner: the start is {round(along, 3):g} m from the docked pose along the axis of the dock, and "
            f"must be more than {round(distance_min_c, 3):g} m from it, half the lengths of robot and dock; start "
            "farther out along the axis",
            where={"step": "beyond_c", "along": along, "distance_min_c": distance_min_c, "t": along / distance_min_c},
        )
    distance_ad = abs(c * dy - s * dx)
    scale = distance_ad / (distance_ad + safety_distance)
    threshold = min((parameters.alpha + abs(scale)) * parameters.beta * math.pi, parameters.gamma * math.pi)
    return ApproachAxis(
        goal=np.array([goal.x, goal.y]),
        outward=-int(direction) * np.array([c, s]),
        direction=direction,
        distance_min_c=distance_min_c,
        along=along,
        distance_ad=distance_ad,
        safety_distance=safety_distance,
        angle_threshold=threshold,
    )


def _check_geometry(geometry: DockGeometry, safety_distance: float) -> None:
    if not geometry.robot_length > 0.0:
        raise NoValidPathCouldBeFound(
            f"dock planner: the robot's length must be > 0 m, got {geometry.robot_length:.6g} m; "
            "check the robot's footprint",
            where={"step": "geometry", "robot_length": geometry.robot_length},
        )
    if not safety_distance > 0.0:
        raise NoValidPathCouldBeFound(
            "dock planner: the safety distance, 2 * (robot radius + calib_safety_distance), must be > 0 m, got "
            f"{safety_distance:.6g} m with a radius of {geometry.robot_radius:.6g} m; raise calib_safety_distance",
            where={"step": "geometry", "safety_distance": safety_distance},
        )


def _check_direction(direction: Direction, wanted: DockDirection, ahead: float) -> None:
    possible = DockDirection.FORWARD if direction is Direction.FORWARD else DockDirection.BACKWARD
    if wanted in (DockDirection.AUTO, possible):
        return
    side = "in front of" if ahead > 0.0 else "behind"
    raise NoValidPathCouldBeFound(
        f"dock planner: the start is {round(abs(ahead), 3):g} m {side} the docked robot, so it can only dock "
        f"{possible.value}, but direction is {wanted.value}; start from the other side, or set direction to auto",
        where={"step": "direction", "wanted": wanted.value, "possible": possible.value, "ahead": ahead},
    )


class TwoSegmentPlan(NamedTuple):
    """A raw docking path, its approach axis, and the joint at which segment 1 reaches the axis."""

    path: Path
    axis: ApproachAxis
    joint: Joint


def plan_two_segment(  # noqa: PLR0913 - two poses, what to plan with, and how to name the frame
    start: Pose2,
    goal: Pose2,
    geometry: DockGeometry,
    parameters: DockPlannerParameters,
    costmap: Costmap | None = None,
    cancel_checker: Callable[[], bool] = never_cancelled,
    *,
    frame: str = "",
) -> TwoSegmentPlan:
    """Compute the raw docking path from `start` to `goal`, in the coordinate frame with the name `frame`.

    The resolution of the costmap, or `parameters.resolution` without a costmap, bounds the spacing of poses. If
    `parameters.check_free_space` is set, the cells under the start, the goal and the curves must be free; points
    outside the map are not free. `cancel_checker` is polled at least every 5 ms.

    Raises:
        PlannerException: If `parameters.check_free_space` is set and there is no costmap.
        StartOutsideMapBounds: If `parameters.check_free_space` is set and the start is outside the map.
        StartOccupied: If `parameters.check_free_space` is set and the start is not free.
        GoalOutsideMapBounds: If `parameters.check_free_space` is set and the goal is outside the map.
        GoalOccupied: If `parameters.check_free_space` is set and the goal is not free.
        NoValidPathCouldBeFound: If a rule of the method is violated; the message names the step and the amount.
        PlannerCancelled: If `cancel_checker` returned True.
    """
    if parameters.check_free_space:
        _check_free_ends(start, goal, costmap, parameters.cost_threshold)
    axis = approach_axis(start, goal, geometry, parameters)
    sampler = CurveSampler(
        degree=parameters.degree,
        step=parameters.step,
        resolution=parameters.resolution if costmap is None else costmap.resolution,
        costmap=costmap if parameters.check_free_space else None,
        cost_threshold=parameters.cost_threshold,
        cancel_checker=cancel_checker,
    )
    centreline = sampler.samples(_straight(axis.point_c, axis.point_f), "the centreline")[:, :2]
    joint = find_joint(np.array([start.x, start.y]), centreline, axis.angle_threshold)
    gear = Direction(-axis.direction) if joint.dir is JointKind.AWAY else axis.direction
    first = sampler.poses(joint.control_points, gear, "segment 1")
    last = first[-1, :2]
    second = sampler.poses(_straight(last, axis.goal), axis.direction, "segment 2")
    return TwoSegmentPlan(_assembled(start, goal, (first, second), (gear, axis.direction), frame), axis, joint)


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
            raise off_map(f"dock planner: the {name} ({pose.x:.3f}, {pose.y:.3f}) is outside the map", where=where)
        cost = int(costmap.cost_at(point)[0])
        if cost >= threshold:
            raise occupied(
                f"dock planner: the {name} ({pose.x:.3f}, {pose.y:.3f}) has cost {cost}, must be < cost_threshold = "
                f"{threshold}",
                where={**where, "cost": cost, "cost_threshold": threshold},
            )


class CurveSampler(NamedTuple):
    """Sampling of curves through control points.

    `degree`: degree of the NURBS. `step`: largest step of u. `resolution`: largest distance between neighbouring poses
    [m]. `costmap`: map on which the cost of every sample must be below `cost_threshold`; None for no check.
    """

    degree: int
    step: float
    resolution: float
    costmap: Costmap | None
    cost_threshold: int
    cancel_checker: Callable[[], bool]

    def poses(self, control_points: FloatArray, direction: Direction, name: str) -> FloatArray:
        """Sample poses of a curve from u = 0 to 1, with yaw along the tangent, or against it in reverse. Shape (m, 3).

        Neighbours are at most `resolution` apart: the step of u is `resolution / max |dC/du|`. The original method uses
        the mean of |dC/du| instead, so its spacing is up to twice as large in fast parts of the curve. As in the
        original method, the last pose has the yaw of the previous pose. Samples that are not finite are skipped.
        `control_points`: Shape (n, 2) [m], n > degree, with unit weights.

        Raises:
            NoValidPathCouldBeFound: If a sample is blocked, too few are finite, or more than MAX_SAMPLES are needed.
            PlannerCancelled: If the cancel checker returned True.
        """
        found = self.samples(control_points, name)
        count = len(found)
        if direction is Direction.REVERSE:
            found[:, 2] += math.pi
        is_finite = np.isfinite(found)
        if not is_finite.all():
            found = found[is_finite.all(axis=1)]
        if len(found) < 2:
            raise NoValidPathCouldBeFound(
                f"dock planner: {name} is empty: only {len(found)} of {count} samples are finite; its control points "
                f"are {control_points.tolist()}",
                where={"step": name, "control_points": control_points.tolist()},
            )
        found[-1, 2] = found[-2, 2]
        return found

    def samples(self, control_points: FloatArray, name: str) -> FloatArray:
        """Return poses of a curve from u = 0 to 1 in the direction of travel; see `poses`. Shape (m, 3).

        Raises:
            NoValidPathCouldBeFound: If a sample is blocked, or more than MAX_SAMPLES are needed.
            PlannerCancelled: If the cancel checker returned True.
        """
        curve = Nurbs(control_points, self.degree)
        u, blocks = shares(self._count(curve, name)), []
        for i in range(0, u.size, _CHUNK):
            if self.cancel_checker():
                raise PlannerCancelled(f"dock planner: cancelled while sampling {name}")
            blocks.append(curve.poses_at(u[i : i + _CHUNK]))
            self._check_free(blocks[-1][:, :2], name)
        return blocks[0] if len(blocks) == 1 else np.concatenate(blocks)

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
    """Kind of a joint, the variable `dir` of the original method."""

    TOWARD = 1  # turns onto the axis toward the dock, tangent at the end
    AWAY = -1  # turns onto the axis away from the dock, then changes gear
    CORNER = 0  # drives straight to the axis and turns there


class Joint(NamedTuple):
    """Joint at which segment 1 meets the axis.

    `middle` is the index on the centreline of its middle control point (-1 for none). `control_points`: Shape (3, 2)
    [m].
    """

    dir: JointKind
    middle: int
    control_points: FloatArray


def find_joint(start: FloatArray, centreline: FloatArray, angle_threshold: float) -> Joint:
    """Find the joint of segment 1; the kinds are tried in the order TOWARD, AWAY, CORNER.

    If the start lies on the axis, the robot drives straight to C, even if C is too near for the sampled search.
    `start`: position A, Shape (2,). `centreline`: samples of the line from C to F, Shape (n, 2), n >= 2 [m].
    `angle_threshold`: smallest interior angle between the rays from the joint to A and along the axis [rad].
    """
    distance = np.hypot(*(centreline - start).T)
    nearest = int((distance <= distance.min() + _SAME_DISTANCE).argmax())
    back = slice(nearest, 0, -1)
    steps = _first_wide(start, centreline[back], distance[back], centreline[0], angle_threshold)
    toward = None if steps is None else nearest - steps
    if toward is not None and _fits(distance[toward], centreline[toward], centreline[0]):
        return _toward(start, centreline, toward, distance[toward])
    if _distance_to_line(start, centreline) <= _ON_AXIS:
        return Joint(JointKind.TOWARD, 0, _straight(start, centreline[0]))
    on = slice(nearest, None)
    steps = _first_wide(start, centreline[on], distance[on], centreline[-1], angle_threshold - _REVERSE_SLACK)
    away = None if steps is None else nearest + steps
    if away is not None and _fits(distance[away], centreline[away], centreline[-1]):
        return Joint(JointKind.AWAY, away, np.array([start, centreline[away], centreline[-1]]))
    return Joint(JointKind.CORNER, -1, _straight(start, centreline[nearest]))


def interior_angles(at: FloatArray, first: FloatArray, second: FloatArray) -> FloatArray:
    """Return angles in [0, pi] at points `at`, Shape (n, 2), between the rays to two points; 0 for rays of length 0.

    >>> interior_angles(np.zeros((1, 2)), np.array([0.0, 2.0]), np.array([-1.0, 0.0])) / np.pi
    array([0.5])
    """
    a, b = first - at, second - at
    cross = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    dot = a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1] + 0.0  # -0.0 + 0.0 is 0.0
    angles: FloatArray = np.arctan2(cross, dot)
    return angles


def _first_wide(
    start: FloatArray, line: FloatArray, distance: FloatArray, end: FloatArray, threshold: float
) -> int | None:
    """Return the first point of a line at which the angle between the rays to `start` and `end` reaches the threshold.

    `distance`: distances of the points of the line from `start`, Shape (n,) [m].
    """
    # A ray of rounding noise has no angle.
    wide = (interior_angles(line, start, end) >= threshold - _SAME_ANGLE) & (distance > _SAME_DISTANCE)
    return int(wide.argmax()) if wide.any() else None


def _fits(leg: float, joint: FloatArray, end: FloatArray) -> bool:
    """Whether the distance from the joint to `end` is at least the distance to the joint."""
    return math.dist(joint, end) >= leg - _SAME_DISTANCE


def _toward(start: FloatArray, centreline: FloatArray, index: int, leg: float) -> Joint:
    """Return the joint with equal legs, accurate to one sample, which gives an arc that ends tangent to the axis."""
    ahead = centreline[index::-1]
    far = np.hypot(*(ahead - centreline[index]).T) >= leg - _SAME_DISTANCE
    return Joint(JointKind.TOWARD, index, np.array([start, centreline[index], ahead[far.argmax()]]))


def _straight(start: FloatArray, end: FloatArray) -> FloatArray:
    return np.array([start, 0.5 * (start + end), end])


def _distance_to_line(point: FloatArray, line: FloatArray) -> float:
    along = line[-1] - line[0]
    away = point - line[0]
    return abs(float(along[0] * away[1] - along[1] * away[0])) / float(np.hypot(*along))


def _assembled(
    start: Pose2, goal: Pose2, parts: tuple[FloatArray, FloatArray], gears: tuple[Direction, Direction], frame: str
) -> Path:
    """Join start, both segments and goal; repeated positions are dropped, except for the goal."""
    last, head = goal.as_array(), len(parts[0]) + 1
    poses = np.concatenate((start.as_array()[None], *parts, last[None]))
    kept = np.ones(len(poses), dtype=np.bool_)
    kept[1:-1] = np.hypot(*(poses[1:-1, :2] - poses[:-2, :2]).T) > _SAME_POSITION
    kept[head:-1] &= np.hypot(*(poses[head:-1, :2] - last[:2]).T) > _SAME_POSITION
    poses, joint = poses[kept], int(np.count_nonzero(kept[:head])) - 1
    if gears[0] is gears[1] or joint == 0:
        return Path((PolylineSegment(poses, gears[1]),), frame)
    poses[:, 2] = unwrap_yaw(poses[:, 2])
    return Path((PolylineSegment(poses[: joint + 1], gears[0]), PolylineSegment(poses[joint:], gears[1])), frame)
