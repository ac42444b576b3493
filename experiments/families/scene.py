"""Docking scenes in the frame of the docked robot, before they are placed in the world."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from experiments.families.motion import Gear, Kink, Piece, motion_to, straight, turn
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2, transform_points
from optdock.model.costmap import FREE_SPACE, LETHAL, Costmap
from optdock.model.dock import Dock, DockDirection
from optdock.model.limits import MotionLimits
from optdock.model.path import Direction, Path
from optdock.model.robot import Drive, Robot

if TYPE_CHECKING:
    from collections.abc import Sequence

    from optdock.geometry.arrays import FloatArray

__all__ = [
    "AMR",
    "AMR_BACK",
    "AMR_FRONT",
    "CAR",
    "FINAL_STRAIGHT",
    "GAP",
    "Scene",
    "amr_turn",
    "box",
    "drawn_costmap",
    "forward",
    "post",
    "random_kinks",
    "reverse",
    "straight",
    "swept_area",
]

GAP = 0.005  # between the docked robot and the dock [m]
FINAL_STRAIGHT = 0.3  # [m]
ORIGIN = Pose2(0.0, 0.0, 0.0)
_AMR_RATE = 5.0  # of the ramps of constructed motions; the limit is 6 [1/m^2]
_CLEAR_OF_MOTION = 0.08  # minimum distance of random obstacles from the motion; 0.05 is required [m]
_MAP_BORDER = 1.5  # margin of free cells around the motion and the polygons of a drawn map [m]


def _limits(curvature: float, rate: float) -> MotionLimits:
    return MotionLimits(max_curvature=curvature, max_curvature_rate=rate)


AMR = Robot(Footprint.rectangle(0.45, 0.45, 0.6), _limits(1.5, 6.0))
CAR = Robot(Footprint.rectangle(3.8, 0.9, 2.0), _limits(0.2, 0.35), Drive.ACKERMANN)


def box(low_x: float, low_y: float, high_x: float, high_y: float, at: Pose2 = ORIGIN) -> FloatArray:
    """Return a rectangle at a pose. Shape (4, 2) [m]."""
    corners = np.array([[low_x, low_y], [high_x, low_y], [high_x, high_y], [low_x, high_y]])
    placed: FloatArray = transform_points(at.as_array()[None], corners)[0]
    return placed


def post(x: float, y: float, radius: float, sides: int, phase: float) -> FloatArray:
    """Return a regular polygon with its corners at `radius` [m]. Shape (sides, 2) [m]."""
    angle = phase + 2.0 * math.pi * np.arange(sides) / sides
    return np.column_stack((x + radius * np.cos(angle), y + radius * np.sin(angle)))


AMR_FRONT = box(0.45 + GAP, -0.3, 0.65, 0.3)  # touched by the front of the robot
AMR_BACK = box(-0.65, -0.3, -0.45 - GAP, 0.3)  # touched by the rear of the robot


@dataclass(frozen=True, eq=False)
class Scene:
    """A docking scene in the frame of the docked robot.

    Args:
        gears: A motion to the goal. In a feasible scene it satisfies every bound; in an infeasible one it is only the
            reference of the raw path.
        dock: Outline of the dock, Shape (n, 2) [m].
        obstacles: Polygons, Shape (n, 2) [m] each.
        kinks: Deviations of the raw path, one per gear.
        robot: The robot.
        feasible: Whether a path with these gears satisfies every bound.
        reason: Reason of infeasibility; None if feasible.
        cell: Size of the grid cells that represent the obstacles [m]; None keeps the polygons.
        spacing: Distance between the poses of the raw path [m].
    """

    gears: tuple[Gear, ...]
    dock: FloatArray
    kinks: tuple[Kink, ...]
    obstacles: tuple[FloatArray, ...] = ()
    robot: Robot = field(default_factory=lambda: AMR)
    feasible: bool = True
    reason: str | None = None
    cell: float | None = None
    spacing: float = 0.05

    @property
    def motion(self) -> Path:
        """The motion, ending at the origin."""
        return motion_to(ORIGIN, self.gears)

    def mirrored(self) -> Scene:
        """Return the scene mirrored at the x axis; the robot is symmetric."""
        flip = np.array([1.0, -1.0])
        return Scene(
            tuple(Gear(g.direction, tuple(Piece(p.length, -p.curvature) for p in g.pieces)) for g in self.gears),
            self.dock * flip,
            tuple(Kink(-kink.angle, -kink.shift) for kink in self.kinks),
            tuple(polygon * flip for polygon in self.obstacles),
            self.robot,
            self.feasible,
            self.reason,
            self.cell,
            self.spacing,
        )

    def dock_at(self, goal: Pose2) -> Dock:
        """Return the dock with the docked robot at `goal`."""
        reverse = self.gears[-1].direction is Direction.REVERSE
        return Dock(
            goal,
            Footprint(self.dock),
            DockDirection.BACKWARD if reverse else DockDirection.FORWARD,
            FINAL_STRAIGHT,
            approach_speed=0.1,
            approach_distance=FINAL_STRAIGHT,
        )


def amr_turn(angle: float, curvature: float = 1.2) -> tuple[Piece, ...]:
    """Return a turn within the limits of the small robot."""
    return turn(angle, curvature, _AMR_RATE)


def random_kinks(rng: np.random.Generator, count: int = 1, shift: float = 0.06) -> tuple[Kink, ...]:
    """Return kinks of 15 to 35 degrees to either side with a lateral shift of up to `shift` [m]."""
    return tuple(
        Kink(
            math.copysign(math.radians(rng.uniform(15.0, 35.0)), rng.uniform(-1.0, 1.0)),
            rng.uniform(-shift, shift),
        )
        for _ in range(count)
    )


def forward(*pieces: tuple[Piece, ...]) -> Gear:
    """Return a forward gear of straights and turns."""
    return Gear(Direction.FORWARD, tuple(piece for group in pieces for piece in group))


def reverse(*pieces: tuple[Piece, ...]) -> Gear:
    """Return a reverse gear of straights and turns."""
    return Gear(Direction.REVERSE, tuple(piece for group in pieces for piece in group))


def swept_area(robot: Robot, motion: Path) -> object:
    """Return the swept area of a motion, grown by 8 cm, as a shapely geometry prepared for queries."""
    import shapely

    poses = motion.sample(0.02).poses
    outlines = shapely.polygons(transform_points(poses, robot.footprint.vertices))
    area = shapely.union_all(shapely.buffer(outlines, _CLEAR_OF_MOTION, quad_segs=4))
    shapely.prepare(area)
    return area


def drawn_costmap(polygons: Sequence[FloatArray], robot: Robot, motion: Path, cell: float) -> Costmap:
    """Return a map, with a margin around the motion, on which the cells that touch a polygon are occupied.

    Cells near the swept area of the motion stay free.

    Args:
        polygons: Shape (n, 2) [m] each.
        robot: The robot.
        motion: Motion that must stay feasible.
        cell: Side of a cell [m].
    """
    import shapely

    points = np.vstack((*polygons, motion.sample(0.1).poses[:, :2]))
    first = np.floor((points.min(axis=0) - _MAP_BORDER) / cell).astype(np.int64)
    size = np.ceil((points.max(axis=0) + _MAP_BORDER) / cell).astype(np.int64) - first
    x, y = ((first[axis] + np.arange(size[axis])) * cell for axis in (0, 1))
    left, low = np.meshgrid(x, y)
    cells = shapely.box(left, low, left + cell, low + cell)
    solid = shapely.union_all([shapely.Polygon(polygon) for polygon in polygons])
    shapely.prepare(solid)
    occupied = shapely.intersects(solid, cells) & ~shapely.intersects(swept_area(robot, motion), cells)
    costs = np.where(occupied, LETHAL, FREE_SPACE).astype(np.uint8)
    return Costmap(costs, cell, (float(first[0] * cell), float(first[1] * cell)))
