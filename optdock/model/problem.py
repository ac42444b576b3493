"""The docking problem: the input of planners, smoothers and certificates as one immutable object."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.errors import InvalidValue
from optdock.geometry.arrays import FrozenArrays, digest
from optdock.geometry.checked import exactly, finite_number, instance
from optdock.geometry.lazy import cached_property
from optdock.geometry.obstacles import ObstacleSet, without_repeated
from optdock.geometry.pose import Pose2, transform_points
from optdock.geometry.separation import separation
from optdock.model.camera import RequiredView
from optdock.model.cell_obstacles import mapped_obstacles
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.costmap import Costmap
from optdock.model.costs import FREE_SPACE, LETHAL, OccupancyRule, costs_from_occupancy
from optdock.model.dock import Dock
from optdock.model.robot import Robot

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import ArrayLike

    from optdock.geometry.arrays import FloatArray
    from optdock.geometry.footprint import Footprint
    from optdock.model.costs import CostArray
    from optdock.model.path import Path

__all__ = ["DockingProblem", "ProblemFingerprint"]

OCCUPIED_FROM = 65  # of 100: map_server's default `occupied_thresh`
STATION_DISTANCE = 1.0  # [m]: allowed distance of a station, e.g. a marker on a wall, also for robots shorter than this
# [m/s], [m/s^2]: rounding error of rest, or of the end of braking, of a time law over kilometres and hours; far below
# the tolerance of certificates, 1e-6.
_ROUNDING = 1e-10


class ProblemFingerprint(NamedTuple):
    """Hexadecimal digests of the parts of a docking problem, and the name of its frame.

    `footprint`: outline of the robot. `limits`: motion limits, drive and camera. `obstacles`: all obstacles including
    the station. `clearance`: the clearance rule. `dock`: pose, station, gear, final straight, speed zone, tolerances
    and view. `start`: pose, speed, curvature and acceleration.
    """

    footprint: str
    limits: str
    obstacles: str
    clearance: str
    dock: str
    start: str
    frame: str

    def differences(self, other: ProblemFingerprint) -> tuple[str, ...]:
        """Return the names of the parts that differ."""
        return tuple(name for name in self._fields if getattr(self, name) != getattr(other, name))


@dataclass(frozen=True, eq=False, init=False, repr=False)
class DockingProblem(FrozenArrays):
    """A docking task: start, dock, robot and obstacles.

    The obstacles are the union of the given obstacles, the occupied and unknown cells of the costmap, the outside of
    the map, and the station.

    Args:
        start: Start pose of the robot.
        dock: Dock; its station is an obstacle.
        robot: Robot.
        obstacles: An `ObstacleSet`, or simple polygons, convex or not, Shape (n, 2) [m] each; polygon i is named
            `obstacles[i]`.
        clearance: Required clearance for every pose in the tracking tube: a `ClearanceRule`, or one number [m] that
            applies everywhere, including at the dock.
        start_speed: Signed speed at the start, negative in reverse [m/s].
        start_curvature: Curvature at the start of the path along the travel [1/m]. None means any curvature: steered
            wheels may then have any angle, and the robot waits at rest until they are steered (`start_wait`).
        start_acceleration: Derivative of the signed speed at the start [m/s^2]. Path planning does not use this value.
            Start states that differ from rest only by rounding count as rest.
        costmap: Grid of the surroundings, or None. The grid is read on construction; a writable grid is copied.
        frame: Name of the coordinate frame.
        unknown_is_obstacle: Whether unknown cells of the costmap are obstacles.

    Attributes:
        all_obstacles: The obstacles, the cells of the costmap and, last, the station.

    Raises:
        InvalidValue: If start_speed, start_acceleration or start_curvature is not finite, a polygon is invalid (the
            message names it), the station is farther from the docked robot than both the robot length and 1 m (usually
            because it is given in map coordinates), the dock must be visible but the robot has no camera, or an
            argument has the wrong class.
    """

    start: Pose2
    dock: Dock
    robot: Robot
    obstacles: ObstacleSet
    clearance: ClearanceRule
    start_speed: float
    start_curvature: float | None
    costmap: Costmap | None
    frame: str
    unknown_is_obstacle: bool
    start_acceleration: float
    all_obstacles: ObstacleSet = field(init=False)

    # Explicit, because the argument types are wider than the field types.
    def __init__(  # noqa: PLR0913, PLR0917 - a problem has as many parts
        self,
        start: Pose2,
        dock: Dock,
        robot: Robot,
        obstacles: ObstacleSet | Iterable[ArrayLike] = (),
        clearance: ClearanceRule | float = ClearanceRule(),
        start_speed: float = 0.0,
        start_curvature: float | None = None,
        costmap: Costmap | None = None,
        frame: str = "map",
        unknown_is_obstacle: bool = True,  # noqa: FBT001, FBT002 - far down the list
        start_acceleration: float = 0.0,
    ) -> None:
        vars(self).update(
            start=start,
            dock=dock,
            robot=robot,
            obstacles=ObstacleSet.of(obstacles),
            clearance=ClearanceRule.of(clearance),
            start_speed=start_speed,
            start_curvature=start_curvature,
            costmap=costmap,
            frame=frame,
            unknown_is_obstacle=unknown_is_obstacle,
            start_acceleration=start_acceleration,
        )
        self._check_parts()
        everything = self.obstacles
        if self.costmap is not None:
            known = self.costmap.frozen()  # a writable grid could change after the proof
            vars(self).update(costmap=known)
            mapped = mapped_obstacles(known, unknown_is_obstacle=self.unknown_is_obstacle)
            everything = without_repeated(everything + mapped) if len(everything) else mapped
        if self.dock.footprint is not None:
            _check_station(self.dock.footprint, self.goal, self.robot)
            everything = everything + ObstacleSet.from_footprint(self.dock.footprint, self.dock.pose, "dock")
        vars(self).update(all_obstacles=everything)

    def _check_parts(self) -> None:
        # Subclasses are rejected, because they can override poses or outlines that proofs rely on.
        parts = (
            (Pose2, "start"),
            (Dock, "dock"),
            (Robot, "robot"),
            (ObstacleSet, "obstacles"),
            (ClearanceRule, "clearance"),
            (bool, "unknown_is_obstacle"),
        )
        for kind, name in parts:
            exactly(kind, getattr(self, name), f"problem.{name}")
        instance(str, self.frame, "problem.frame")
        if self.costmap is not None:
            exactly(Costmap, self.costmap, "problem.costmap")
        speed = finite_number(self.start_speed, "start.speed")
        acceleration = finite_number(self.start_acceleration, "start.acceleration")
        speed, acceleration = _without_rounding(speed, acceleration, self.robot.limits.max_jerk)
        vars(self).update(start_speed=speed, start_acceleration=acceleration)
        if self.dock.visible_distance > 0.0 and self.robot.camera is None:
            asked = f"the dock must be in view over the last {self.dock.visible_distance:g} m"
            raise InvalidValue(f"dock.visible_distance: {asked}, but robot.camera is not given")
        if self.start_curvature is not None:
            vars(self).update(start_curvature=finite_number(self.start_curvature, "start.curvature"))

    @classmethod
    def from_grid(  # noqa: PLR0913 - a grid and a problem
        cls,
        occupancy: ArrayLike,
        resolution: float,
        origin: tuple[float, float],
        *,
        start: Pose2,
        dock: Dock,
        robot: Robot,
        obstacles: ObstacleSet | Iterable[ArrayLike] = (),
        clearance: ClearanceRule | float = ClearanceRule(),
        occupied_from: int = OCCUPIED_FROM,
        unknown_is_obstacle: bool = True,
        frame: str = "map",
    ) -> DockingProblem:
        """Return a problem with the cells of an occupancy grid as obstacles.

        Args:
            occupancy: Shape (rows, columns): row 0 has the lowest y, column 0 the lowest x, as in ROS's OccupancyGrid
                (row 0 of an image is at the top: pass `image[::-1]`). The elements are booleans, with True for
                occupied, or integers as in ROS: 0 (free) to 100 (occupied) and -1 (unknown).
            resolution: Side of a cell [m].
            origin: Lower left corner of the cell in row 0 and column 0, x and y [m].
            start: Start pose of the robot.
            dock: Dock; its station is an obstacle.
            robot: Robot.
            obstacles: Obstacles in addition to the cells.
            clearance: Required clearance.
            occupied_from: Smallest occupancy of an obstacle, 1..100; map_server's `occupied_thresh` is 0.65 by default.
            unknown_is_obstacle: Whether unknown cells are obstacles.
            frame: Name of the coordinate frame.

        Raises:
            InvalidValue: As for the constructor; also if the array has the wrong type, is masked or has no cell, or if
                no integer exceeds 1 although `occupied_from` does, which indicates a mask of ones and zeros.
        """
        return cls(
            start=start,
            dock=dock,
            robot=robot,
            obstacles=obstacles,
            clearance=clearance,
            costmap=Costmap(_costs(occupancy, occupied_from), resolution, origin),
            frame=frame,
            unknown_is_obstacle=unknown_is_obstacle,
        )

    def __repr__(self) -> str:
        counted = f"{len(self.obstacles)} obstacle pieces" + (f", {self.costmap!r}" if self.costmap else "")
        ends = f"{self.start.brief} -> {self.goal.brief} in {self.frame!r}"
        return f"<DockingProblem {ends}, {counted}, clearance {self.clearance.required:g} m>"

    def starting_at(
        self, start: Pose2, speed: float = 0.0, curvature: float | None = None, acceleration: float = 0.0
    ) -> DockingProblem:
        """Return the same problem with a different start.

        Args:
            start: Start pose of the robot.
            speed: Signed speed, negative in reverse [m/s].
            curvature: Curvature along the travel [1/m]; None means any curvature.
            acceleration: Derivative of the signed speed [m/s^2].

        Raises:
            InvalidValue: As for the constructor.
        """
        moved = object.__new__(type(self))
        # The obstacles are shared; only the cached digests are dropped.
        vars(moved).update({name: value for name, value in vars(self).items() if name != "fingerprint"})
        vars(moved).update(start=start, start_speed=speed, start_curvature=curvature, start_acceleration=acceleration)
        moved._check_parts()
        return moved

    def start_state(self, gear: int) -> tuple[float, float]:
        """Return the start speed [m/s] and acceleration [m/s^2] in the direction of travel in `gear`, 1 or -1.

        The gear is used only at rest; otherwise the sign of the speed determines it.
        """
        sign = math.copysign(1.0, self.start_speed) if self.start_speed != 0.0 else float(gear or 1)
        return abs(self.start_speed), sign * self.start_acceleration

    def start_wait(self, path: Path) -> float:
        """Return the time [s] for which the robot waits at the start of `path` until its wheels are steered.

        The time is 0 if `start_curvature` is given; see `MotionLimits.start_wait`.
        """
        return self.robot.limits.start_wait(path) if self.start_curvature is None else 0.0

    @property
    def starts_at_rest(self) -> bool:
        """Whether the robot has no speed and no acceleration at the start."""
        return self.start_speed == 0.0 and self.start_acceleration == 0.0

    @property
    def may_turn_first(self) -> bool:
        """Whether a path may begin with a turn in place, to which the curvature at the start does not apply."""
        return self.robot.turns_in_place and self.starts_at_rest

    @cached_property
    def path_clearance(self) -> ClearanceRule:
        """Clearance rule of the path, which ensures `clearance` for every pose in the robot's tracking tube."""
        wider = self.clearance.required + self.robot.tracking.width(self.robot.footprint)
        return dataclasses.replace(self.clearance, required=wider)

    def tube_widths(
        self, poses: FloatArray, start: Pose2, start_clearance: float, start_relief: float = 0.0
    ) -> FloatArray:
        """Return the largest displacements of the footprint from poses of a path that satisfy `clearance`.

        The displacements are the differences between `path_clearance` and `clearance`, which are zero at the dock,
        where the robot comes to rest in contact, and near a start without additional clearance.

        Args:
            poses: Poses of the path, Shape (n, 3).
            start: Pose at which the drive began.
            start_clearance: Clearance of that pose [m].
            start_relief: Start relief used by the path certificate [m]; see `ClearanceRule.required_at`.

        Returns:
            Shape (n,) [m].
        """
        from_goal, from_start = (np.hypot(poses[:, 0] - end.x, poses[:, 1] - end.y) for end in (self.goal, start))
        with_tube, without = (
            rule.required_at(from_goal, from_start, start_clearance, start_relief)
            for rule in (self.path_clearance, self.clearance)
        )
        widths: FloatArray = with_tube - without
        return widths

    @cached_property
    def required_view(self) -> RequiredView | None:
        """Marker and the part of the path on which it must be visible; None if visibility is not required."""
        dock, camera, marker = self.dock, self.robot.camera, self.dock.marker_in_world
        if dock.visible_distance == 0.0 or marker is None or camera is None:
            return None
        return RequiredView(camera, marker, dock.visible_distance, dock.blind_distance)

    def required_view_margin(self, from_goal: FloatArray, from_start: FloatArray, to_marker: FloatArray) -> FloatArray:
        """Return the margin in the view that keeps the marker visible from every pose in the tracking tube.

        A position error e and a heading error w move a point at distance r from the robot by at most e + 2 r sin(w / 2)
        in the camera frame. Near the dock the tube tapers like the clearance. If the start has a smaller margin, the
        required margin grows from that value with the slope of `ClearanceRule.leaving`.

        Args:
            from_goal: Distances of the poses from the goal position, Shape (n,) [m].
            from_start: Distances from the start position, Shape (n,) [m].
            to_marker: Distances from the marker, Shape (n,) [m].

        Returns:
            Shape (n,) [m]; 0 without a tube.
        """
        tube, view = self.robot.tracking, self.required_view
        if view is None or (tube.cross == 0.0 and tube.yaw == 0.0):
            return np.zeros(from_goal.size)
        taper = dataclasses.replace(self.clearance, at_dock=0.0, required=1.0)
        at_start = float(view.margins(self.start.as_array()[None]).smallest[0])
        moved = tube.cross + 2.0 * math.sin(0.5 * tube.yaw) * to_marker
        margin: FloatArray = np.minimum(taper.near_goal(from_goal) * moved, taper.leaving(from_start, at_start))
        return margin

    @property
    def goal(self) -> Pose2:
        """Pose of the docked robot."""
        return self.dock.pose

    @property
    def start_run(self) -> float:
        """Start relief of the weaker clearance rule [m], which is twice the length of the robot.

        A robot alongside a wall that is closer than the required clearance cannot move away at once, because its tail
        swings towards the wall. Over this distance, the rule therefore requires no more than the clearance at the
        start. With a relief of one robot length, a robot of 0.9 m cannot leave a wall at 1 cm without a cusp.
        """
        footprint = self.robot.footprint
        return 2.0 * min(footprint.length, 2.0 * footprint.circumscribed_radius)

    def among(self, costmap: Costmap) -> DockingProblem:
        """Return the same problem with the cells of a costmap as additional obstacles."""
        if costmap is self.costmap:
            return self
        if self.costmap is None:
            return dataclasses.replace(self, costmap=costmap)
        more = mapped_obstacles(costmap.frozen(), unknown_is_obstacle=self.unknown_is_obstacle)
        return dataclasses.replace(self, obstacles=self.obstacles + more)

    @cached_property
    def fingerprint(self) -> ProblemFingerprint:
        """Digests of the data on which a certificate for this problem depends."""
        dock, rule = self.dock, self.path_clearance
        station = digest("none") if dock.footprint is None else digest(dock.footprint.vertices)
        steered = "free" if self.start_curvature is None else str(float(self.start_curvature))
        zone, accepted = dock.approach, dock.tolerances
        # View and start acceleration are digested only if set, so that older digests stay valid.
        tube = self.robot.tracking
        seen = (
            ("seen", (*dock.marker, dock.visible_distance, dock.blind_distance, tube.cross, tube.yaw))
            if dock.marker is not None and dock.visible_distance > 0.0
            else ()
        )
        accelerated = (self.start_acceleration,) if self.start_acceleration != 0.0 else ()
        return ProblemFingerprint(
            *self.robot.fingerprint,
            obstacles=self.all_obstacles.digest,
            clearance=digest(rule.parts),
            dock=digest(
                dock.pose.as_array(),
                station,
                dock.direction.value,
                (dock.final_straight, zone.speed, zone.distance, accepted.along, accepted.cross, accepted.yaw),
                *seen,
            ),
            start=digest(self.start.as_array(), self.start_speed, steered, *accelerated),
            frame=self.frame,
        )


def _without_rounding(speed: float, acceleration: float, jerk: float) -> tuple[float, float]:
    """Return a signed start state without the rounding errors that occur at rest or at the end of braking.

    From a state with such errors, the motion would reverse by an unmeasurably small distance. The state is replaced by
    rest, or its speed is replaced by the lowest speed from which the braking can end without reversing.
    """
    if max(abs(speed), abs(acceleration)) <= _ROUNDING:
        return 0.0, 0.0
    least = 0.5 * acceleration * acceleration / jerk
    is_braking = speed * acceleration < 0.0
    return (
        math.copysign(least, speed) if is_braking and 0.0 < least - abs(speed) <= _ROUNDING else speed
    ), acceleration


def _check_station(station: Footprint, goal: Pose2, robot: Robot) -> None:
    """Check that the station is close to the docked robot; a distant station is probably in the wrong frame."""
    outline = robot.footprint.vertices
    length = float(_corner_distances(outline, outline).max())
    allowed = max(STATION_DISTANCE, length)
    # The corners are close for nearly every dock; only otherwise the distance of the edges is needed.
    if _corner_distances(outline, station.vertices).min() <= allowed:
        return
    pieces = ObstacleSet.from_footprint(station, Pose2(0.0, 0.0, 0.0), "dock")
    rows = np.arange(len(pieces))
    docked = np.zeros((rows.size, 3))
    gap = min(float(separation(body, docked, pieces.pieces(rows)).distance.min()) for body in robot.footprint.bodies)
    if gap <= allowed:
        return
    seen = transform_points(goal.inverse().as_array()[None], station.vertices)[0]
    corners = ", ".join(f"[{x:.4g}, {y:.4g}]" for x, y in np.round(seen, 3) + 0.0)
    meant = f"; meant as [{corners}]?" if _corner_distances(outline, seen).min() <= allowed else ""
    raise InvalidValue(
        f"dock.footprint: is {gap:.3f} m away from the docked robot, which is {length:.3f} m long: the footprint of "
        f"the station is given in the frame of the docked robot, not of the map{meant}"
    )


def _corner_distances(first: FloatArray, second: FloatArray) -> FloatArray:
    distances: FloatArray = np.hypot(*(first[:, None] - second).T)
    return distances


def _costs(occupancy: ArrayLike, occupied_from: int) -> CostArray:
    """Return the costs of a grid of booleans, or of occupancies -1 and 0..100: free, occupied or unknown."""
    if isinstance(occupancy, np.ma.MaskedArray):
        raise InvalidValue("occupancy: must not be masked; give unknown cells as -1, with .filled(-1)")
    try:
        grid = np.asarray(occupancy)
    except ValueError as error:
        raise InvalidValue("occupancy: every row must have as many cells") from error
    if grid.dtype.kind not in "biu":
        raise InvalidValue(f"occupancy: must be booleans, or integers -1 (unknown) and 0..100, got {grid.dtype}")
    if isinstance(occupied_from, bool) or not (isinstance(occupied_from, int) and 1 <= occupied_from <= 100):
        raise InvalidValue(f"occupied_from: must be an integer in 1..100, got {occupied_from!r}")
    if grid.dtype.kind == "b":
        return np.where(grid, LETHAL, FREE_SPACE).astype(np.uint8)
    costs = costs_from_occupancy(
        grid, OccupancyRule(lethal_cost_threshold=occupied_from, inscribed_obstacle_cost_value=200)
    )
    if occupied_from > 1 and grid.size and int(grid.max()) == 1:
        # Occupancies of at most 1 % are most likely a mask of ones and zeros, whose walls would be free.
        raise InvalidValue(
            "occupancy: the largest value is 1 of 100; pass a mask as booleans, or set occupied_from = 1"
        )
    return costs
