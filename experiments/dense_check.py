"""Independent path check by dense sampling; it shares no code with `verification`.

Samples poses every 2 mm; outlines and distances by shapely, required clearance by a separate formula, curvature by
finite differences of yaw. It proves nothing between samples; its purpose is to detect wrong certificates.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.model.path import place_before_end

if TYPE_CHECKING:
    from shapely import STRtree

    from optdock.geometry.arrays import FloatArray
    from optdock.geometry.obstacles import ObstacleSet
    from optdock.geometry.pose import Pose2
    from optdock.model.path import Path, Segment
    from optdock.model.problem import DockingProblem

__all__ = ["DenseReport", "Fault", "clearance_at", "dense_check"]

_POSE_TOLERANCE = 1e-5  # start and goal [m, rad]
_STRAIGHT_TOLERANCE = 1e-5  # lateral [m] and in yaw [rad]
_CLEARANCE_TOLERANCE = 2e-6  # [m]: twice the tolerance of the certificate, as the next two
_CURVATURE_TOLERANCE = 2e-6  # relative; differences of yaw are exact for linear curvature, except for rounding
_RATE_TOLERANCE = 2e-6  # relative
_SLIP_PER_SQUARED_STEP = 2.0  # lateral motion over distance [1/m^2]
_SLIP_PER_RATE = 0.1  # share of the curvature rate: a clothoid shows up to its rate / 12 * step^2
_BEARING_TOLERANCE = 1e-5  # [rad]: 1e-6 m at a distance of 0.1 m
_IN_THE_CAMERA = 0.1  # [m]: no bearing is checked at smaller distances
_RANGE_TOLERANCE = 2e-6  # [m]
_JOINT_TOLERANCE = 1e-6  # between the end of a gear and the start of the next [m, rad]


class Fault(NamedTuple):
    """One violated bound: its name, arc length along the path [m], the value and the limit."""

    bound: str
    s: float
    value: float
    limit: float


@dataclass(frozen=True)
class DenseReport:
    """Result of a dense check; true if no bound is violated.

    Args:
        faults: The worst violation of every violated bound.
        min_clearance: Smallest distance of the outline to an obstacle, negative for overlap [m].
        worst_margin: Smallest difference of clearance and required clearance [m].
        worst_s: Arc length of the worst margin [m].
        max_curvature: Largest |curvature| [1/m].
        max_curvature_rate: Largest |d curvature / ds| [1/m^2].
        length: Length of the path [m].
        start_relief: Start relief of the clearance rule that `faults` refers to [m]: 0 (strict rule), or the relief of
            the weaker rule if only the weaker rule holds.
    """

    faults: tuple[Fault, ...]
    min_clearance: float
    worst_margin: float
    worst_s: float
    max_curvature: float
    max_curvature_rate: float
    length: float
    start_relief: float

    def __bool__(self) -> bool:
        return self.ok

    @property
    def ok(self) -> bool:
        """Whether no bound is violated at any sample."""
        return not self.faults

    @property
    def broken(self) -> tuple[str, ...]:
        """Names of the violated bounds."""
        return tuple(fault.bound for fault in self.faults)


class _Samples(NamedTuple):
    """One evenly sampled gear: s (n,) along the whole path, poses (n, 3), step [m], gear (1 or -1)."""

    s: FloatArray
    poses: FloatArray
    step: float
    sign: int


def dense_check(path: Path, problem: DockingProblem, step: float = 0.002) -> DenseReport:
    """Check every bound of `problem` at samples of `path` at most `step` [m] apart.

    Bounds: start and goal pose, joints of gears, curvature, curvature rate inside a gear, motion along the heading, the
    final straight, clearance, and bearing and distance of the dock's marker where visibility is required (of the path,
    not of the tube around it).

    Args:
        path: Any path, clothoid or polyline.
        problem: The problem that defines the bounds.
        step: Largest distance between samples [m].
    """
    gears = _gears(path, step)
    s, poses = np.concatenate([g.s for g in gears]), np.vstack([g.poses for g in gears])
    clearance = _clearances(poses, problem)
    margin, relief = clearance - _required(poses, float(clearance[0]), problem, 0.0), 0.0
    is_too_close = float(clearance[0]) < problem.path_clearance.required
    if is_too_close and margin.min() < -_CLEARANCE_TOLERANCE:
        run = float(np.ptp(problem.robot.footprint.vertices[:, 0]))
        run = 2.0 * min(run, 2.0 * float(np.hypot(*problem.robot.footprint.vertices.T).max()))
        weaker = clearance - _required(poses, float(clearance[0]), problem, run)
        margin, relief = (weaker, run) if weaker.min() >= -_CLEARANCE_TOLERANCE else (margin, relief)
    curvature = [_curvature(g) for g in gears]
    rates = [np.abs(np.diff(k)) / g.step for k, g in zip(curvature, gears, strict=True)]
    worst = int(np.argmin(margin))
    found = (
        *_end_faults(path, problem),
        *_motion_faults(gears, curvature, rates, problem),
        *_straight_faults(path, problem, step),
        *_above("clearance", s, -margin, _CLEARANCE_TOLERANCE),
        *_view_faults(s, poses, path, problem),
    )
    return DenseReport(
        faults=found,
        min_clearance=float(clearance.min()),
        worst_margin=float(margin[worst]),
        worst_s=float(s[worst]),
        max_curvature=max(
            (float(np.abs(k).max()) for k, g in zip(curvature, gears, strict=True) if g.sign), default=0.0
        ),
        max_curvature_rate=max((float(r.max()) for r in rates if r.size), default=0.0),
        length=path.driven,
        start_relief=relief,
    )


def clearance_at(pose: Pose2, problem: DockingProblem) -> float:
    """Return the distance of the outline at one pose to the nearest obstacle [m]; negative for overlap."""
    return float(_clearances(pose.as_array()[None], problem)[0])


def _gears(path: Path, step: float) -> list[_Samples]:
    return [
        _gear(segment, float(start), step) for segment, start in zip(path.segments, path.segment_starts, strict=False)
    ]


def _gear(segment: Segment, start: float, step: float) -> _Samples:
    count = max(2, math.ceil(segment.length / step))
    s = np.linspace(0.0, segment.length, count + 1, dtype=np.float64)
    return _Samples(start + s, segment.poses_at(s), segment.length / count, int(segment.direction))


def _curvature(gear: _Samples) -> FloatArray:
    """Return the change of yaw over distance between neighbouring samples. Shape (n - 1,) [1/m]."""
    curvature: FloatArray = np.diff(np.unwrap(gear.poses[:, 2])) / gear.step
    return curvature


def _slip(gear: _Samples) -> FloatArray:
    """Return the lateral part of every step over its length; the chord of an arc has the heading of its middle."""
    move = np.diff(gear.poses[:, :2], axis=0)
    yaw = np.unwrap(gear.poses[:, 2])
    middle = 0.5 * (yaw[1:] + yaw[:-1])
    slip: FloatArray = np.abs(move[:, 1] * np.cos(middle) - move[:, 0] * np.sin(middle)) / gear.step
    return slip


def _backwards(gear: _Samples) -> FloatArray:
    """Return the part of every step against the gear direction over its length."""
    move = np.diff(gear.poses[:, :2], axis=0)
    yaw = gear.poses[:-1, 2]
    against: FloatArray = -gear.sign * (move[:, 0] * np.cos(yaw) + move[:, 1] * np.sin(yaw)) / gear.step
    return against


def _above(bound: str, s: FloatArray, value: FloatArray, limit: float) -> tuple[Fault, ...]:
    """Return the worst excess of `value` over `limit`; NaN counts as an excess."""
    if value.size == 0 or bool(np.all(value <= limit)):
        return ()
    worst = int(np.argmax(np.where(np.isnan(value), np.inf, value)))
    return (Fault(bound, float(s[worst]), float(value[worst]), limit),)


def _view_faults(s: FloatArray, poses: FloatArray, path: Path, problem: DockingProblem) -> tuple[Fault, ...]:
    """Return bearings [rad] beyond half the field of view and distances [m] beyond the camera's ranges."""
    dock, camera = problem.dock, problem.robot.camera
    if dock.visible_distance == 0.0 or dock.marker is None or camera is None:
        return ()
    begin, end = place_before_end(path, dock.visible_distance), place_before_end(path, dock.blind_distance)
    judged = (s >= begin) & (s <= end)
    x, y, yaw = poses[judged].T
    ahead, left, turned = dock.marker[0], dock.marker[1], problem.goal.yaw
    mx = problem.goal.x + ahead * math.cos(turned) - left * math.sin(turned)
    my = problem.goal.y + ahead * math.sin(turned) + left * math.cos(turned)
    dx = mx - x - camera.mount.x * np.cos(yaw) + camera.mount.y * np.sin(yaw)
    dy = my - y - camera.mount.x * np.sin(yaw) - camera.mount.y * np.cos(yaw)
    distance = np.hypot(dx, dy)
    bearing = np.remainder(np.arctan2(dy, dx) - yaw - camera.mount.yaw + math.pi, 2.0 * math.pi) - math.pi
    outside = np.where(distance > _IN_THE_CAMERA, np.abs(bearing) - 0.5 * camera.field_of_view, -math.inf)
    return (
        *_above("bearing", s[judged], outside, _BEARING_TOLERANCE),
        *_above("min_range", s[judged], camera.min_range - distance, _RANGE_TOLERANCE),
        *_above("max_range", s[judged], distance - camera.max_range, _RANGE_TOLERANCE),
    )


def _motion_faults(
    gears: list[_Samples], curvature: list[FloatArray], rates: list[FloatArray], problem: DockingProblem
) -> tuple[Fault, ...]:
    limits = problem.robot.limits
    found: list[Fault] = []
    for gear, kappa, rate in zip(gears, curvature, rates, strict=True):
        at = gear.s[:-1]
        if gear.sign == 0:
            moved = np.hypot(*(gear.poses[1:, :2] - gear.poses[:1, :2]).T)
            found += _above("turn", at, moved, 0.0 if problem.robot.turns_in_place else -1.0)
            continue
        found += _above("curvature", at, np.abs(kappa), limits.max_curvature * (1.0 + _CURVATURE_TOLERANCE))
        found += _above("curvature rate", at[1:], rate, limits.max_curvature_rate * (1.0 + _RATE_TOLERANCE))
        steepest = min(limits.max_curvature_rate, float(np.max(rate, initial=0.0)))
        slip_limit = max(_SLIP_PER_SQUARED_STEP, _SLIP_PER_RATE * steepest) * gear.step**2
        found += _above("slip", at, _slip(gear), slip_limit)
        found += _above("direction", at, _backwards(gear), 0.0)
    return tuple(found)


def _pose_gap(first: FloatArray, second: FloatArray) -> float:
    turn = math.remainder(float(first[2] - second[2]), 2.0 * math.pi)
    return max(math.hypot(*(first[:2] - second[:2])), abs(turn))


def _end_faults(path: Path, problem: DockingProblem) -> tuple[Fault, ...]:
    ends = [segment.poses_at([0.0, segment.length]) for segment in path.segments]
    joints = [
        ("joint", float(s), _pose_gap(before[-1], after[0]), _JOINT_TOLERANCE)
        for s, before, after in zip(path.segment_starts[1:], ends, ends[1:], strict=False)
    ]
    checks = (
        ("start", 0.0, _pose_gap(ends[0][0], problem.start.as_array()), _POSE_TOLERANCE),
        ("goal", path.length, _pose_gap(ends[-1][-1], problem.dock.pose.as_array()), _POSE_TOLERANCE),
        *joints,
    )
    return tuple(Fault(*check) for check in checks if not check[2] <= check[3])


def _straight_faults(path: Path, problem: DockingProblem, step: float) -> tuple[Fault, ...]:
    """Check the last `final_straight` metres against the line through the goal along its heading."""
    length, goal, last = problem.dock.final_straight, problem.dock.pose, path.segments[-1]
    if length <= 0.0:
        return ()
    if last.length < length - _STRAIGHT_TOLERANCE:
        return (Fault("final straight", path.length, last.length, length),)
    count = max(2, math.ceil(length / step)) + 1
    s = np.linspace(last.length - length, last.length, count, dtype=np.float64)
    poses = last.poses_at(s)
    sideways = np.abs((poses[:, 1] - goal.y) * math.cos(goal.yaw) - (poses[:, 0] - goal.x) * math.sin(goal.yaw))
    turned = np.abs(np.mod(poses[:, 2] - goal.yaw + math.pi, 2.0 * math.pi) - math.pi)
    at = path.length - last.length + s
    return _above("final straight", at, np.maximum(sideways, turned), _STRAIGHT_TOLERANCE)


def _required(poses: FloatArray, start_clearance: float, problem: DockingProblem, run: float) -> FloatArray:
    """Return `at_dock + (required - at_dock) min(1, (d - dock_run) / taper)`, relaxed near a start that is too close.

    `required` includes the displacement of the outline by the robot's tube.

    The strict rule (`run` 0) grows from the clearance of the start at once. The weaker rule starts 5 mm lower, or at
    half, and grows only beyond `run` metres; if `at_start` is given, it also grows from the start as it does from the
    goal.
    """
    rule, goal, start = problem.clearance, problem.dock.pose, problem.start
    from_goal = np.hypot(poses[:, 0] - goal.x, poses[:, 1] - goal.y)
    from_start = np.hypot(poses[:, 0] - start.x, poses[:, 1] - start.y)
    tube, corners = problem.robot.tracking, problem.robot.footprint.vertices
    moved = tube.cross + math.sqrt(2.0 - 2.0 * math.cos(tube.yaw)) * float(np.hypot(*corners.T).max())
    has = max(start_clearance, 0.0)
    enough = has if run == 0.0 else max(0.5 * has, has - 0.005)
    terms, ends = [enough + 0.5 * np.clip(from_start - run, 0.0, None)], [(from_goal, rule.at_dock)]
    if run > 0.0 and rule.at_start is not None:
        ends.append((from_start, rule.at_start))
    for distance, least in ends:
        beyond = np.maximum(distance - rule.dock_run, 0.0)
        grown = np.clip(beyond / rule.taper, 0.0, 1.0) if rule.taper > 0.0 else (beyond > 0.0).astype(np.float64)
        terms.append(least + (rule.required + moved - least) * grown)
    required: FloatArray = np.min(terms, axis=0)
    return required


def _clearances(poses: FloatArray, problem: DockingProblem) -> FloatArray:
    """Return the distance of the outline to the nearest obstacle per pose [m]; negative for overlap. Shape (n,)."""
    import shapely

    if len(problem.all_obstacles) == 0:
        return np.full(len(poses), np.inf)
    tree = _tree(problem.all_obstacles)
    c, s = np.cos(poses[:, 2, None]), np.sin(poses[:, 2, None])
    outline = problem.robot.footprint.vertices
    x = poses[:, 0, None] + c * outline[:, 0] - s * outline[:, 1]
    y = poses[:, 1, None] + s * outline[:, 0] + c * outline[:, 1]
    bodies = shapely.polygons(np.stack((x, y), axis=-1))
    (rows, _), distance = tree.query_nearest(bodies, return_distance=True, all_matches=False)
    clearance = np.empty(len(poses))
    clearance[rows] = distance
    for row in np.flatnonzero(clearance <= 0.0):
        clearance[row] = -_overlap_depth(bodies[row], tree)
    return clearance


def _tree(obstacles: ObstacleSet) -> STRtree:
    import shapely

    return shapely.STRtree(shapely.polygons(obstacles.vertices))


def _overlap_depth(body: object, tree: STRtree) -> float:
    """Return an estimate of the penetration depth: area over half the perimeter of the overlap [m]."""
    import shapely

    hits = tree.geometries[tree.query(body, predicate="intersects")]
    overlap = shapely.intersection(body, shapely.union_all(hits))
    return 2.0 * float(shapely.area(overlap)) / max(float(shapely.length(overlap)), 1e-12)
