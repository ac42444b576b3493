"""The docking problem: everything a planner, a smoother and the certificate need to know, as one frozen value."""

from __future__ import annotations

import dataclasses
import functools
import math
import numbers
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from optdock.errors import InvalidValue
from optdock.geometry.arrays import FrozenArrays
from optdock.geometry.checked import exactly, finite_number, instance, number
from optdock.geometry.fingerprint import ProblemFingerprint, digest
from optdock.geometry.obstacles import ObstacleSet, without_repeated
from optdock.geometry.pose import Pose2, transform_points
from optdock.geometry.separation import separation
from optdock.model.camera import RequiredView
from optdock.model.cell_obstacles import mapped_obstacles
from optdock.model.costmap import Costmap
from optdock.model.costs import FREE_SPACE, LETHAL, NO_INFORMATION
from optdock.model.dock import Dock
from optdock.model.robot import Robot

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import ArrayLike

    from optdock.geometry.arrays import FloatArray
    from optdock.geometry.footprint import Footprint
    from optdock.model.costs import CostArray
    from optdock.model.path import Path

__all__ = ["ClearanceRule", "DockingProblem"]

OCCUPIED_FROM = 65  # of 100: map_server's default `occupied_thresh`
# [m]: also from a robot that is smaller, what belongs to a station, such as a marker on a wall, may stand so far.
BESIDE_THE_ROBOT = 1.0
# A robot that starts closer to an obstacle than required must leave it at least at this slope, from its start on or,
# under the weaker rule, from `DockingProblem.start_run` on.
START_RELIEF_SLOPE = 0.5
# [m]: by how much nearer than its start the robot may come under the weaker rule, to turn away from a wall, and at most
# by half of what it has. With it a robot of 0.9 m leaves a wall that is 1 cm away without a cusp.
START_SLACK = 0.005
# [m/s], [m/s^2]: what rounding leaves of rest, or of the end of a braking, where a state is evaluated from a time law
# over kilometres and hours; far less than the 1e-6 that the certificate accepts.
_ROUNDING = 1e-10


@dataclass(frozen=True)
class ClearanceRule:
    """How far the footprint must stay from the nearest obstacle, the dock included.

    Args:
        required: Away from the goal [m].
        at_dock: At the goal [m].
        taper: Distance over which it grows linearly from `at_dock` to `required` [m].
        dock_run: Distance from the goal within which `at_dock` is enough; from there it grows [m]. For docks beside
            something: a robot that stands along a wall cannot turn away from it without its tail or nose coming nearer.
        at_start: As `at_dock`, for a start that is itself closer to something than required, as one in a dock is: from
            there it grows likewise. Without it such a robot may come nearer by `START_SLACK` and no more [m].

    Raises:
        InvalidValue: A value is negative or not finite, or at_dock or at_start exceeds required.
    """

    required: float = 0.05
    at_dock: float = 0.0
    taper: float = 0.5
    dock_run: float = 0.0
    at_start: float | None = None

    @classmethod
    def of(cls, value: float | ClearanceRule, name: str = "clearance") -> ClearanceRule:
        """The rule itself; or that of one number [m], which holds everywhere, also at the dock.

        Raises:
            InvalidValue: Neither a rule nor a finite number >= 0.
        """
        if isinstance(value, cls):
            return value
        if isinstance(value, bool) or not isinstance(value, numbers.Real):
            raise InvalidValue(f"{name}: must be a ClearanceRule or one number [m], got {type(value).__name__}")
        same = number(value, name)
        return cls(same, same)

    def __post_init__(self) -> None:
        for name in ("required", "at_dock", "taper", "dock_run", *(("at_start",) if self.at_start is not None else ())):
            value = number(getattr(self, name), f"clearance.{name}")
            object.__setattr__(self, name, value)
            if not (math.isfinite(value) and value >= 0.0):
                raise InvalidValue(f"clearance.{name}: must be finite and >= 0 m, got {value}")
        for name, least in (("at_dock", self.at_dock), ("at_start", self.at_start)):
            if least is not None and least > self.required:
                raise InvalidValue(f"clearance.{name}: must be <= required = {self.required} m, got {least}")

    def required_at(
        self, from_goal: FloatArray, from_start: FloatArray, start_clearance: float, start_relief: float = 0.0
    ) -> FloatArray:
        """Required clearance, Shape (n,) [m].

        Args:
            from_goal: Distances of the poses from the goal position, Shape (n,) [m].
            from_start: Distances from the start position, Shape (n,) [m].
            start_clearance: Clearance of the start pose itself [m].
            start_relief: 0 is the strict rule; else the distance from the start within which the weaker rule asks for
                hardly more than there, because the robot stands along a wall, say [m].
        """
        return np.minimum(self.near_goal(from_goal), self.near_start(from_start, start_clearance, start_relief))

    def near_goal(self, from_goal: FloatArray) -> FloatArray:
        """What is asked for at distances from the goal, wherever the start is, Shape (n,) [m]."""
        return self._tapered(from_goal, self.at_dock)

    def near_start(self, from_start: FloatArray, start_clearance: float, start_relief: float = 0.0) -> FloatArray:
        """What a start that is too close asks for at distances from it, Shape (n,) [m]; arguments as `required_at`."""
        leaving = self.leaving(from_start, start_clearance, start_relief)
        return np.minimum(leaving, self.undocking(from_start)) if start_relief > 0.0 else leaving

    @staticmethod
    def leaving(from_start: FloatArray, start_clearance: float, start_relief: float = 0.0) -> FloatArray:
        """The growth from what the start has: at once, or beyond `start_relief` from a little less than that."""
        kept = max(0.0, start_clearance)
        least = kept if start_relief == 0.0 else _relieved(kept)
        return least + START_RELIEF_SLOPE * np.maximum(0.0, from_start - start_relief)

    def undocking(self, from_start: FloatArray) -> FloatArray:
        """What `at_start` asks for at distances from the start, Shape (n,); infinite where it is not given [m]."""
        return np.full_like(from_start, np.inf) if self.at_start is None else self._tapered(from_start, self.at_start)

    def _tapered(self, distance: FloatArray, least: float) -> FloatArray:
        beyond = np.maximum(distance - self.dock_run, 0.0)
        share = np.minimum(beyond, self.taper) / self.taper if self.taper > 0.0 else np.where(beyond > 0.0, 1.0, 0.0)
        wanted: FloatArray = least + (self.required - least) * share
        return wanted

    def raised(self, more: float) -> ClearanceRule:
        """The rule that asks for `more` everywhere [m], of a robot that starts with `raised_start`.

        Raises:
            InvalidValue: Less than nothing would be asked for.
        """
        least = None if self.at_start is None else self.at_start + more
        return dataclasses.replace(self, required=self.required + more, at_dock=self.at_dock + more, at_start=least)

    @staticmethod
    def raised_start(more: float, start_clearance: float, start_relief: float = 0.0) -> float:
        """The clearance of a start of which `leaving` asks for `more` than of `start_clearance` [m]."""
        kept = max(0.0, start_clearance)
        if start_relief == 0.0:
            return kept + more
        least = _relieved(kept) + more
        return min(least + START_SLACK, 2.0 * least)  # the inverse of `_relieved`

    @property
    def parts(self) -> tuple[float, ...]:
        """The numbers that a digest speaks of; rules that were possible before `dock_run` have the same ones."""
        least = () if self.at_start is None else (self.at_start,)
        return self.required, self.at_dock, self.taper, *((self.dock_run, *least) if self.dock_run or least else ())


def _relieved(kept: float) -> float:
    """What the weaker rule asks for beside a start with this clearance [m]."""
    return max(kept - START_SLACK, 0.5 * kept)


@dataclass(frozen=True, eq=False, init=False, repr=False)
class DockingProblem(FrozenArrays):
    """From where, to where, with what, among what.

    What the robot must not touch is everything that is given: the obstacles, the occupied and unknown cells of the
    costmap and the world beyond its edge, and the station. None of them replaces another.

    Args:
        start: Where the robot is.
        dock: Where it must end; its station is an obstacle.
        robot: What drives.
        obstacles: What it must not touch: an `ObstacleSet`, or simple polygons, convex or not, Shape (n, 2) [m] each;
            the i-th is called `obstacles[i]`.
        clearance: How far it must stay away, wherever in its tracking tube it is: a `ClearanceRule`, or one number [m]
            that holds everywhere, also at the dock.
        start_speed: Speed at the start, signed, negative in reverse [m/s].
        start_curvature: Curvature at the start along the travel [1/m], with which the path begins. None leaves it free:
            steered wheels may then stand at any angle, and the motion waits for them at rest (`start_wait`).
        start_acceleration: Derivative of the signed speed at the start [m/s^2]: below 0 it slows down in forward gear,
            or speeds up in reverse. Paths are planned without it; the motion begins with it. What is left of rest by
            rounding counts as rest.
        costmap: What is known of the surroundings as a grid; None where only obstacles are. Read when the problem is
            made, a grid that layers write into is copied.
        frame: Name of the coordinate frame.
        unknown_is_obstacle: Whether unknown cells of the costmap are obstacles.

    Attributes:
        all_obstacles: The obstacles, the cells of the costmap, and the station last.

    Raises:
        InvalidValue: start_speed, start_acceleration or start_curvature is not finite, a polygon is none (the message
            says which), the station stands farther from the docked robot than the robot is long, and than 1 m, as one
            in coordinates of the map does; the dock must be seen by a robot without a camera; or a part is of another
            class.
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

    # Written out, because it takes more kinds of values than the fields hold.
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
            known = self.costmap.frozen()  # one that layers write into could change under the proof
            object.__setattr__(self, "costmap", known)
            mapped = mapped_obstacles(known, unknown_is_obstacle=self.unknown_is_obstacle)
            everything = without_repeated(everything + mapped) if len(everything) else mapped
        if self.dock.footprint is not None:
            _check_station(self.dock.footprint, self.goal, self.robot)
            everything = everything + ObstacleSet.from_footprint(self.dock.footprint, self.dock.pose, "dock")
        object.__setattr__(self, "all_obstacles", everything)

    def _check_parts(self) -> None:
        # No subclasses: what overrides a pose or an outline is another one, of which no proof would know.
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
        object.__setattr__(self, "start_speed", speed)
        object.__setattr__(self, "start_acceleration", acceleration)
        if self.dock.visible_distance > 0.0 and self.robot.camera is None:
            asked = f"the dock must be in view over the last {self.dock.visible_distance:g} m"
            raise InvalidValue(f"dock.visible_distance: {asked}, but robot.camera is not given")
        if self.start_curvature is not None:
            object.__setattr__(self, "start_curvature", finite_number(self.start_curvature, "start.curvature"))

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
        """A problem among the cells of a grid: the grid goes in once, and everybody sees it.

        Args:
            occupancy: Shape (rows, columns): row 0 lies at the lowest y, column 0 at the lowest x, as in ROS's
                OccupancyGrid (an image has its row 0 at the top: hand in `image[::-1]`). Either booleans, True is
                occupied; or integers as in ROS, 0 (free) to 100 (occupied) and -1 (unknown).
            resolution: Side of a cell [m].
            origin: Lower left corner of the cell in row 0 and column 0, x and y [m].
            start: Where the robot is.
            dock: Where it must end; its station is an obstacle.
            robot: What drives.
            obstacles: What it must not touch beside the cells.
            clearance: How far it must stay away.
            occupied_from: Cells of this occupancy and more are obstacles, 1..100; map_server's `occupied_thresh` is
                0.65 by default.
            unknown_is_obstacle: Whether unknown cells are.
            frame: Name of the coordinate frame.

        Raises:
            InvalidValue: As the constructor, or the array is none of the two, is masked, or has no cell; or no integer
                exceeds 1, which is a mask of ones and zeros rather than occupancies, unless `occupied_from` is 1.
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
        """The same problem from another start.

        Args:
            start: Where the robot is.
            speed: Its speed there, signed, negative in reverse [m/s].
            curvature: Its curvature there along the travel [1/m]; None leaves it free.
            acceleration: Derivative of the signed speed there [m/s^2].

        Raises:
            InvalidValue: As the constructor.
        """
        moved = object.__new__(type(self))
        # Among the same obstacles, which need not be put together again; only the digests are others.
        vars(moved).update({name: value for name, value in vars(self).items() if name != "fingerprint"})
        vars(moved).update(start=start, start_speed=speed, start_curvature=curvature, start_acceleration=acceleration)
        moved._check_parts()
        return moved

    def start_state(self, gear: int) -> tuple[float, float]:
        """Speed [m/s] and acceleration [m/s^2] at the start along the travel of a motion in `gear`, 1 or -1.

        In motion the speed says which gear that is; only at rest it is the motion's own.
        """
        sign = math.copysign(1.0, self.start_speed) if self.start_speed != 0.0 else float(gear or 1)
        return abs(self.start_speed), sign * self.start_acceleration

    def start_wait(self, path: Path) -> float:
        """How long a motion along `path` must rest at its start until steered wheels stand as the path begins [s].

        0 where `start_curvature` says how they stand, which the path then begins with; see `MotionLimits.start_wait`.
        """
        return self.robot.limits.start_wait(path) if self.start_curvature is None else 0.0

    @functools.cached_property
    def path_clearance(self) -> ClearanceRule:
        """What the path itself must keep, so that every pose within the robot's tracking tube keeps `clearance`."""
        wider = self.clearance.required + self.robot.tracking.width(self.robot.footprint)
        return dataclasses.replace(self.clearance, required=wider)

    def tube_widths(
        self, poses: FloatArray, start: Pose2, start_clearance: float, start_relief: float = 0.0
    ) -> FloatArray:
        """How far any point of the footprint may be off where a path has it and keep `clearance` all the same.

        What `path_clearance` asks for beyond `clearance`: it falls to zero at the dock, which the robot is to touch,
        and near a start that has no more clearance to spare.

        Args:
            poses: Of the path, Shape (n, 3).
            start: Where the drive set off.
            start_clearance: Of the robot there [m].
            start_relief: Of the certificate of the path, see `ClearanceRule.required_at` [m].

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

    @functools.cached_property
    def required_view(self) -> RequiredView | None:
        """What the robot must see on which part of its path; None: nothing."""
        dock, camera, marker = self.dock, self.robot.camera, self.dock.marker_in_world
        if dock.visible_distance == 0.0 or marker is None or camera is None:
            return None
        return RequiredView(camera, marker, dock.visible_distance, dock.blind_distance)

    def required_view_margin(self, from_goal: FloatArray, from_start: FloatArray, to_marker: FloatArray) -> FloatArray:
        """How far inside the view the marker must be, so that every pose within the tracking tube sees it.

        A pose that is off by e and turned by w moves a point at distance r of the robot by at most e + 2 r sin(w / 2)
        in the camera's frame. The tube tapers at the dock as the clearance does. A start that has less is left at the
        slope that `ClearanceRule.leaving` has.

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
        """The pose of the robot when docked."""
        return self.dock.pose

    @property
    def start_run(self) -> float:
        """The start relief of the weaker rule [m]: twice the robot's length.

        A robot that stands along a wall closer than required cannot gain clearance at once: its tail swings towards the
        wall as its nose leaves it, so it may keep about what it has over this run. Over its length alone one of 0.9 m
        cannot leave a wall that is 1 cm away without a cusp.
        """
        footprint = self.robot.footprint
        return 2.0 * min(footprint.length, 2.0 * footprint.circumscribed_radius)

    def among(self, costmap: Costmap) -> DockingProblem:
        """The same problem with a costmap's cells among its obstacles, beside whatever it knows already."""
        if costmap is self.costmap:
            return self
        if self.costmap is None:
            return dataclasses.replace(self, costmap=costmap)
        more = mapped_obstacles(costmap.frozen(), unknown_is_obstacle=self.unknown_is_obstacle)
        return dataclasses.replace(self, obstacles=self.obstacles + more)

    @functools.cached_property
    def fingerprint(self) -> ProblemFingerprint:
        """Digests of what a certificate for this problem is proven against."""
        dock, rule = self.dock, self.path_clearance
        station = digest("none") if dock.footprint is None else digest(dock.footprint.vertices)
        steered = "free" if self.start_curvature is None else str(float(self.start_curvature))
        zone, accepted = dock.approach, dock.tolerances
        # Likewise a dock that need not be seen; the tube counts by its two numbers, as the clearance by its width.
        tube = self.robot.tracking
        seen = (
            ("seen", (*dock.marker, dock.visible_distance, dock.blind_distance, tube.cross, tube.yaw))
            if dock.marker is not None and dock.visible_distance > 0.0
            else ()
        )
        # A start without acceleration has the digest that it had before there was one.
        pressed = (self.start_acceleration,) if self.start_acceleration != 0.0 else ()
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
            start=digest(self.start.as_array(), self.start_speed, steered, *pressed),
            frame=self.frame,
        )


def _without_rounding(speed: float, acceleration: float, jerk: float) -> tuple[float, float]:
    """A start state, both signed, without what rounding leaves of rest or of the end of a braking.

    From such a state the robot would roll backwards by less than can be measured. So it is at rest; or it has just the
    speed that is left when its acceleration is led to rest.
    """
    if max(abs(speed), abs(acceleration)) <= _ROUNDING:
        return 0.0, 0.0
    least = 0.5 * acceleration * acceleration / jerk
    is_braking = speed * acceleration < 0.0
    return (
        math.copysign(least, speed) if is_braking and 0.0 < least - abs(speed) <= _ROUNDING else speed
    ), acceleration


def _check_station(station: Footprint, goal: Pose2, robot: Robot) -> None:
    """Refuse a station that stands so far from the docked robot that it can only be meant otherwise.

    A real one touches the robot or stands within its length; an outline far off proves nothing about the true one.
    """
    outline = robot.footprint.vertices
    length = _farthest_corners(outline, outline)
    allowed = max(BESIDE_THE_ROBOT, length)
    # Corners are near at nearly every dock; only at others the edges between them need to be looked at.
    if _nearest_corners(outline, station.vertices) <= allowed:
        return
    pieces = ObstacleSet.from_footprint(station, Pose2(0.0, 0.0, 0.0), "dock")
    rows = np.arange(len(pieces))
    docked = np.zeros((rows.size, 3))
    gap = min(float(separation(body, docked, pieces.pieces(rows)).distance.min()) for body in robot.footprint.bodies)
    if gap <= allowed:
        return
    seen = transform_points(goal.inverse().as_array()[None], station.vertices)[0]
    corners = ", ".join(f"[{x:.4g}, {y:.4g}]" for x, y in np.round(seen, 3) + 0.0)
    meant = f"; meant as [{corners}]?" if _nearest_corners(outline, seen) <= allowed else ""
    raise InvalidValue(
        f"dock.footprint: is {gap:.3f} m away from the docked robot, which is {length:.3f} m long: the outline of the "
        f"station is seen from the docked robot, not on the map{meant}"
    )


def _nearest_corners(first: FloatArray, second: FloatArray) -> float:
    return float(np.hypot(*(first[:, None] - second).T).min())


def _farthest_corners(first: FloatArray, second: FloatArray) -> float:
    return float(np.hypot(*(first[:, None] - second).T).max())


def _costs(occupancy: ArrayLike, occupied_from: int) -> CostArray:
    """Costs of a grid of booleans, or of occupancies -1 and 0..100: free, occupied or unknown."""
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
    wrong = grid[(grid < -1) | (grid > 100)]
    if wrong.size:
        raise InvalidValue(f"occupancy: must be -1 (unknown) or 0..100, got {int(wrong[0])}")
    if occupied_from > 1 and grid.size and int(grid.max()) == 1:
        # Percents that nowhere exceed one are the ones and zeros of a mask; its walls would be free.
        raise InvalidValue("occupancy: holds 1 at most, of 100; give a mask as booleans, or occupied_from = 1")
    return np.select([grid < 0, grid >= occupied_from], [NO_INFORMATION, LETHAL], FREE_SPACE).astype(np.uint8)
