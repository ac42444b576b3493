"""Hard docking problems by family, drawn from seeds: long routes, little room, starts and docks at walls.

| family | content |
|---|---|
| rack halls | halls of 20 to 100 m full of racks; from one aisle to the end of another, to a wall or to a rack's end |
| maze | four rooms in a row, doors of 0.9, 1.1 or 1.4 m that do not face each other; from the first into the last |
| wrong way | a corridor whose end is behind the robot; it turns in a niche, in a junction, or with many cusps |
| along a wall | a long wall 2 to 30 mm from the start, the dock or both; 5 cm are required elsewhere |
| contact | starts in contact or nearly so: ahead, at a corner, along one side, in a corner of two walls |
| bays | a small car parks between cars, across or along the aisle, and leaves a bay along the aisle |
| buildings | the docks of `real_maps` on Nav2's maps from a route of 10 to 40 m, for a wide robot |
| forklifts | 10 to 20 m along an aisle into a bay between pallets, forks first or last |
| blocked straight | the straight before the dock is obstructed in an otherwise open scene; infeasible |
| open straight | the same with the obstacles 1 to 20 mm farther apart than necessary |
| barely open | walls around the swept area of a driven motion, 1 to 20 mm farther away than required |

All scenes except the blocked ones are feasible: places to turn are sized from turning radius and outline.

Nav2's maps are searched as in `cases`; the other families need no files.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from experiments.manoeuvres.cases import (
    MISSING,
    RULE,
    SEED,
    Case,
    Scene,
    Truth,
    data_folder,
    dock_at,
    is_too_wide,
    missing_tag,
    random_frame,
    rectangle,
    wall_with_gap,
    walls,
)
from experiments.real_maps import ROBOT, SCENARIOS, problem_of
from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2, transform_points
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.dock import Dock, DockDirection
from optdock.model.limits import MotionLimits
from optdock.model.robot import Drive, Robot
from optdock.verification import pose_clearances

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

    from experiments.real_maps import MapScenario
    from optdock.geometry.arrays import BoolArray, FloatArray
    from optdock.model.problem import DockingProblem

__all__ = [
    "CAR",
    "FORKLIFT",
    "Witness",
    "along_a_wall",
    "barely_open",
    "bays",
    "blocked_straight",
    "buildings",
    "contact",
    "forklifts",
    "maze",
    "open_straight",
    "rack_halls",
    "witnesses",
    "wrong_way",
]

HALLS = (20.0, 30.0, 45.0, 60.0, 80.0, 100.0)  # [m], sides of the halls with racks
RACK, CROSS_AISLE = 1.0, 3.0  # [m]: depth of a row of racks; width of a cross aisle
DOORS = (0.9, 1.1, 1.4)  # [m]
BESIDE = (0.002, 0.03)  # [m]: distance of start or dock from a wall
PARALLEL = (1.2, 1.3, 1.5)  # bay lengths along the aisle, in car lengths
ALONG_RULE = dataclasses.replace(RULE, dock_run=2.0)
CURB = 0.15  # [m] from a parked car to a wall: room for the swing-out of the tail when the car leaves the bay
ROUTE = (10.0, 40.0)  # [m] of free route through a building
SPARE = (0.001, 0.002, 0.005, 0.01, 0.02)  # [m]
_LENGTH, _WIDTH = ROBOT.footprint.length, ROBOT.footprint.width
_NOSE = 0.6  # [m] from the robot's origin to the wall with the charger
_HALF = 0.5 * _WIDTH + RULE.required  # [m]: half the width that the robot needs for straight motion

# A car of 1.0 m x 0.5 m with a turning radius of 0.88 m; bays are given in its lengths and widths. Its origin is the
# middle of the rear axle.
CAR = Robot(
    Footprint.rectangle(0.8, 0.2, 0.5),
    MotionLimits(
        max_speed=0.5,
        max_reverse_speed=0.4,
        max_acceleration=0.5,
        max_deceleration=0.6,
        max_jerk=2.0,
        wheelbase=0.6,
        max_steering_angle=0.6,
        max_steering_rate=1.5,
        max_curvature_rate=5.0,
    ),
    Drive.ACKERMANN,
)
CAR_RULE = ClearanceRule(required=0.03, at_dock=0.0, taper=0.3)
# A forklift of 2.6 m x 1.0 m, forks behind, with a turning radius of 1.2 m around its load axle, which is its origin.
FORKLIFT = Robot(
    Footprint.rectangle(1.7, 0.9, 1.0),
    MotionLimits(
        max_speed=1.5,
        max_reverse_speed=0.8,
        max_acceleration=0.6,
        max_deceleration=0.8,
        max_jerk=2.0,
        wheelbase=1.5,
        max_steering_angle=0.9,
        max_steering_rate=1.0,
        max_curvature_rate=1.5,
        max_lateral_acceleration=0.8,
    ),
    Drive.ACKERMANN,
)
FORKLIFT_RULE = ClearanceRule(required=0.1, at_dock=0.02, taper=0.8)


def _rng(seed: int, family: int, *numbers: int) -> np.random.Generator:
    return np.random.default_rng((seed, 1000 + family, *numbers))


def _sign(rng: np.random.Generator) -> float:
    return 1.0 if rng.integers(2) else -1.0


def rack_halls(per_length: int = 5, seed: int = SEED) -> list[Case]:
    """From one aisle of a hall of racks to the end of another, to a wall, or to the end face of a rack.

    Rows of racks run along y in blocks with cross aisles between them; the last block stands at the wall, so its aisles
    are dead ends. The robot starts along its aisle in either direction. Tags give the side length of the hall.

    Args:
        per_length: Number of cases per hall size.
        seed: Seed of the cases.
    """
    return [
        _rack_hall(side, number, _rng(seed, 1, round(side), number)) for side in HALLS for number in range(per_length)
    ]


class _Racks(NamedTuple):
    """Blocks of racks.

    Args:
        rows: Middles of the rows, x [m].
        aisle: Width of the aisles between rows [m].
        blocks: Least and largest y of each block [m].
    """

    rows: FloatArray
    aisle: float
    blocks: list[tuple[float, float]]

    @property
    def aisles(self) -> FloatArray:
        """Middles of the aisles between the rows, x, Shape (n,) [m]."""
        middles: FloatArray = 0.5 * (self.rows[1:] + self.rows[:-1])
        return middles

    @property
    def polygons(self) -> list[FloatArray]:
        """Return a rectangle per row and block."""
        return [
            rectangle(x, 0.5 * (low + high), RACK, high - low) for x in self.rows.tolist() for low, high in self.blocks
        ]


def _racks(side: float, rng: np.random.Generator) -> _Racks:
    aisle = rng.uniform(2.2, 3.0)
    count = int((side - 2.0 * CROSS_AISLE + aisle) // (RACK + aisle))
    rows: FloatArray = CROSS_AISLE + 0.5 * RACK + (RACK + aisle) * np.arange(count, dtype=np.float64)
    blocks = max(2, round(side / 18.0))
    length = side / blocks - CROSS_AISLE
    lows = CROSS_AISLE + (length + CROSS_AISLE) * np.arange(blocks)
    return _Racks(rows, aisle, [(low, low + length) for low in lows.tolist()])


def _rack_hall(side: float, number: int, rng: np.random.Generator) -> Case:
    racks = _racks(side, rng)
    goal = (_at_aisle_end, _at_side_wall, _at_rack_end)[number % 3](racks, side, rng)
    others = racks.aisles[np.abs(racks.aisles - goal.x) > racks.aisle]
    low, high = racks.blocks[rng.integers(len(racks.blocks))]
    heading = 0.5 * math.pi * _sign(rng) + rng.uniform(-0.1, 0.1)
    start = Pose2(float(rng.choice(others)) + rng.uniform(-0.2, 0.2), rng.uniform(low + 1.0, high - 1.5), heading)
    scene = Scene(start, dock_at(goal), [*walls(0.0, 0.0, side, side), *racks.polygons])
    return scene.case("rack halls", f"{side:g} m", number)


def _at_aisle_end(racks: _Racks, side: float, rng: np.random.Generator) -> Pose2:
    return Pose2(float(rng.choice(racks.aisles)), side - _NOSE, 0.5 * math.pi)


def _at_side_wall(racks: _Racks, side: float, rng: np.random.Generator) -> Pose2:
    low, high = racks.blocks[rng.integers(len(racks.blocks))]
    y, is_left = rng.uniform(low + 1.0, high - 1.0), bool(rng.integers(2))
    return Pose2(_NOSE, y, math.pi) if is_left else Pose2(side - _NOSE, y, 0.0)


def _at_rack_end(racks: _Racks, _: float, rng: np.random.Generator) -> Pose2:
    low, _ = racks.blocks[rng.integers(len(racks.blocks))]
    return Pose2(float(rng.choice(racks.rows)), low - _NOSE, 0.5 * math.pi)


def maze(per_door: int = 8, seed: int = SEED) -> list[Case]:
    """Four rooms in a row with doors on alternating sides; from any heading in the first to the end of the last.

    Tags give the width of the doors.

    Args:
        per_door: Number of cases per door width.
        seed: Seed of the cases.
    """
    return [
        _maze(wide, number, _rng(seed, 2, round(100 * wide), number)) for wide in DOORS for number in range(per_door)
    ]


def _maze(wide: float, number: int, rng: np.random.Generator) -> Case:
    lengths, top = rng.uniform(3.5, 5.0, 4), 0.5 * rng.uniform(4.5, 6.0)
    ends = np.cumsum(lengths)
    first, doors = _sign(rng), []
    for i, x in enumerate(ends[:-1].tolist()):
        middle = first * (-1) ** i * rng.uniform(0.5, top - 0.5 * wide - 0.4)
        doors += wall_with_gap(x, (-top, middle - 0.5 * wide, middle + 0.5 * wide, top), 0.15)
    start = Pose2(
        rng.uniform(1.0, float(lengths[0]) - 1.2), rng.uniform(1.0 - top, top - 1.0), rng.uniform(-math.pi, math.pi)
    )
    goal = Pose2(float(ends[-1]) - _NOSE, rng.uniform(1.0 - top, top - 1.0), 0.0)
    scene = Scene(start, dock_at(goal), [*walls(0.0, -top, float(ends[-1]), top), *doors])
    return scene.case("maze", f"{100 * wide:g} cm doors", number, random_frame(rng))


def wrong_way(per_kind: int = 8, seed: int = SEED) -> list[Case]:
    """A corridor with the dock at its end, behind the robot.

    Tags give the place to turn: a `niche` 1.3 to 1.6 m wide and as deep, or a `junction` with a side corridor, both
    next to a corridor of 1.35 to 1.6 m; or only the corridor itself, `wide`, of 1.8 to 2.2 m.

    Args:
        per_kind: Number of cases per tag.
        seed: Seed of the cases.
    """
    return [
        _wrong_way(kind, number, _rng(seed, 3, place, number))
        for place, kind in enumerate(("niche", "junction", "wide"))
        for number in range(per_kind)
    ]


def _wrong_way(kind: str, number: int, rng: np.random.Generator) -> Case:
    length, half = rng.uniform(10.0, 14.0), 0.5 * (rng.uniform(1.8, 2.2) if kind == "wide" else rng.uniform(1.35, 1.6))
    goal = Pose2(length - _NOSE, rng.uniform(-0.1, 0.1), 0.0)
    start = Pose2(rng.uniform(1.2, 0.6 * length), rng.uniform(-0.15, 0.15), math.pi + rng.uniform(-0.1, 0.1))
    if kind == "wide":
        around = walls(0.0, -half, length, half)
    else:
        around = _side_room(length, half, rng.uniform(3.0, 4.0) if kind == "junction" else rng.uniform(1.3, 1.6), rng)
    scene = Scene(start, dock_at(goal), around)
    return scene.case("wrong way", kind, number, random_frame(rng))


def _side_room(length: float, half: float, depth: float, rng: np.random.Generator) -> list[FloatArray]:
    """Return a corridor of given length and half width with a room on one side, left or right as seen from the dock."""
    at, wide, top = rng.uniform(2.5, length - 3.0), rng.uniform(1.3, 1.6), half + depth
    low, high = at - 0.5 * wide, at + 0.5 * wide
    beside = [
        rectangle(0.5 * low, half + 0.5 * depth, low, depth),
        rectangle(0.5 * (high + length), half + 0.5 * depth, length - high, depth),
    ]
    side = _sign(rng)
    return [polygon * [1.0, side] for polygon in (*walls(0.0, -half, length, top), *beside)]


def along_a_wall(draws: int = 8, seed: int = SEED) -> list[Case]:
    """A long wall 2 to 30 mm from the robot, parallel to it, at the start, at the dock or at both.

    A docked robot stands as at a conveyor that is loaded from the side, and arrives along the wall by a straight of 0.3
    m; its clearance rule has a `dock_run` of 2 m. Tags give the variant. With `wall ends` (half as many cases) the wall
    ends where the robot must begin to increase its distance, so that straight motion is a solution. `dock, tapered` has
    no `dock_run` and is infeasible: 0.3 m before the dock 3 cm are required.

    Args:
        draws: Number of cases per tag without `wall ends`.
        seed: Seed of the cases.
    """
    makers = {
        "start": (_start_along, draws),
        "dock": (_dock_along, draws),
        "both": (_both_along, draws),
        "start, wall ends": (_start_at_end, draws // 2),
        "dock, wall ends": (_dock_at_end, draws // 2),
        "dock, tapered": (_dock_tapered, draws // 2),
    }
    cases = []
    for place, (tag, (make, count)) in enumerate(makers.items()):
        for number in range(count):
            rng = _rng(seed, 4, place, number)
            cases.append(make(rng).case("along a wall", tag, number, random_frame(rng)))
    return cases


def _gap_beside(rng: np.random.Generator) -> float:
    return float(np.exp(rng.uniform(*np.log(BESIDE))))


def _wall_below(begin: float, end: float) -> FloatArray:
    """Return a wall under the x axis between two x."""
    return rectangle(0.5 * (begin + end), -0.1, end - begin, 0.2)


def _away(rng: np.random.Generator) -> Pose2:
    """Return a pose 3 to 6 m away from the origin, well above the x axis, any heading."""
    distance, bearing = rng.uniform(3.0, 6.0), rng.uniform(0.6, math.pi - 0.6)
    return Pose2(distance * math.cos(bearing), distance * math.sin(bearing), rng.uniform(-math.pi, math.pi))


def _beside(gap: float, rng: np.random.Generator) -> Pose2:
    """Return a pose at the origin, parallel to a wall under the x axis, in either direction."""
    return Pose2(0.0, 0.5 * _WIDTH + gap, 0.0 if rng.integers(2) else math.pi)


def _start_along(rng: np.random.Generator) -> Scene:
    """Start along a wall; the dock is free, or at an opposite wall."""
    start, wall = _beside(_gap_beside(rng), rng), _wall_below(-15.0, 15.0)
    if rng.integers(2):
        return Scene(start, dock_at(_away(rng)), [wall])
    y = rng.uniform(3.5, 6.0)
    goal = Pose2(rng.uniform(-4.0, 4.0), y - _NOSE, 0.5 * math.pi)
    return Scene(start, dock_at(goal), [wall, rectangle(0.0, y + 0.1, 30.0, 0.2)])


def _dock_along(rng: np.random.Generator) -> Scene:
    goal = _beside(_gap_beside(rng), rng)
    return Scene(_away(rng), dock_at(goal, charger=False), [_wall_below(-15.0, 15.0)], clearance=ALONG_RULE)


def _dock_tapered(rng: np.random.Generator) -> Scene:
    return _dock_along(rng)._replace(clearance=RULE, truth=Truth(math.inf))


def _both_along(rng: np.random.Generator) -> Scene:
    goal, start = _beside(_gap_beside(rng), rng), _beside(_gap_beside(rng), rng)
    moved = Pose2(_sign(rng) * rng.uniform(3.0, 6.0), start.y, start.yaw)
    return Scene(moved, dock_at(goal, charger=False), [_wall_below(-15.0, 15.0)], clearance=ALONG_RULE)


def _start_at_end(rng: np.random.Generator) -> Scene:
    """Start along a wall that ends after one robot length of straight motion."""
    start = Pose2(0.0, 0.5 * _WIDTH + _gap_beside(rng), 0.0)
    return Scene(start, dock_at(_away(rng)), [_wall_below(-15.0, rng.uniform(-0.2, 0.5 * _LENGTH - 0.05))])


def _dock_at_end(rng: np.random.Generator) -> Scene:
    """Dock along a wall that begins at the front of the docked robot, so that straight motion is a solution."""
    gap = _gap_beside(rng)
    begin = 0.5 * _LENGTH - 0.9 * gap / RULE.required * RULE.taper
    goal = Pose2(0.0, 0.5 * _WIDTH + gap, 0.0)
    return Scene(_away(rng), dock_at(goal, charger=False), [_wall_below(begin, 15.0)])


def contact(per_kind: int = 6, seed: int = SEED) -> list[Case]:
    """Starts in contact, or (every other case) with up to 1 mm of clearance, in an otherwise open field.

    Tags give the obstacle: a wall at the `nose`, a `post` at the side, a wall `flush` along the side, or both walls,
    `corner`. The dock is free, 2.5 to 5 m away on the open side. A car with a wall along its side cannot turn away: it
    drives on beyond the end of the wall, as out of a dock (`at_start` 0, `dock_run` 3 m).

    Args:
        per_kind: Number of cases per tag.
        seed: Seed of the cases.
    """
    open_sides = {"nose": (math.pi, 1.0), "post": (0.0, math.pi), "flush": (-0.5 * math.pi, 1.0)}
    open_sides["corner"] = (-0.75 * math.pi, 0.6)
    cases = []
    for place, (kind, (middle, spread)) in enumerate(open_sides.items()):
        for number in range(per_kind):
            rng = _rng(seed, 5, place, number)
            gap = 0.0 if number % 2 == 0 else rng.uniform(0.0, 0.001)
            distance, bearing = rng.uniform(2.5, 5.0), middle + rng.uniform(-spread, spread)
            goal = Pose2(distance * math.cos(bearing), distance * math.sin(bearing), rng.uniform(-math.pi, math.pi))
            rule = dataclasses.replace(RULE, at_start=0.0, dock_run=3.0) if kind in ("flush", "corner") else RULE
            scene = Scene(Pose2(0.0, 0.0, 0.0), dock_at(goal), _touching(kind, gap, rng), clearance=rule)
            cases.append(scene.case("contact", kind, number, random_frame(rng)))
    return cases


def _touching(kind: str, gap: float, rng: np.random.Generator) -> list[FloatArray]:
    """Return obstacles at distance `gap` from the robot at the origin [m]."""
    nose, side = 0.5 * _LENGTH + gap, 0.5 * _WIDTH + gap
    size = rng.uniform(0.06, 0.2)
    ahead, left = rectangle(nose + 0.1, 0.0, 0.2, 4.0), rectangle(0.0, side + 0.1, 4.0, 0.2)
    post = rectangle(rng.uniform(-0.3, 0.3), side + 0.5 * size, size, size)
    return {"nose": [ahead], "post": [post], "flush": [left], "corner": [ahead, left]}[kind]


def bays(per_kind: int = 6, seed: int = SEED) -> list[Case]:
    """A small car (`CAR`) and bays between cars of the same size, next to an aisle of 1.8 to 2.2 m.

    Tags: `perpendicular`, into bays of 1.3 or 1.5 car widths; `parallel` with the bay's length in car lengths, and `at
    a wall` if the wall is 5 cm instead of 15 cm from the parked car; and `out of 1.2`, from such a bay to a dock along
    the aisle. For bays the last gear is forward, backward or either, in turn, and there is no final straight.

    Args:
        per_kind: Number of cases per tag.
        seed: Seed of the cases.
    """
    directions = tuple(DockDirection)
    cases = []
    for number in range(per_kind):
        direction = directions[number % len(directions)]
        rng = _rng(seed, 6, number)
        scenes = {"perpendicular": _perpendicular(direction, rng)}
        scenes |= {f"parallel {share:g}": _parallel(share, direction, rng) for share in PARALLEL}
        scenes[f"out of {PARALLEL[0]:g}"] = _out_of_bay(rng)
        cases += [scene.case("bays", tag, number, random_frame(rng)) for tag, scene in scenes.items()]
        rng = _rng(seed, 6, number, 1)
        scene = _parallel(PARALLEL[1], direction, rng, 0.05)
        cases.append(scene.case("bays", f"parallel {PARALLEL[1]:g}, at a wall", number, random_frame(rng)))
    return sorted(cases, key=lambda case: case.tag)


def _parked(gap: float, size: tuple[float, float], aisle: float, behind: float) -> list[FloatArray]:
    """Return cars on both sides of a gap, a wall `behind` them, and one across the aisle, which begins at y = 0.

    `size`: extent of a car along x and y [m].
    """
    along, deep = size
    middles = [side * (0.5 * gap + 0.5 * along + n * (along + 0.15)) for side in (-1.0, 1.0) for n in (0, 1)]
    cars = [rectangle(x, -0.5 * deep, along, deep) for x in middles]
    return [*cars, rectangle(0.0, -deep - behind - 0.1, 14.0, 0.2), rectangle(0.0, aisle + 0.1, 14.0, 0.2)]


def _in_aisle(aisle: float, rng: np.random.Generator) -> Pose2:
    """Return a pose along the aisle in either direction, 1.5 to 4 m from the bay."""
    x, y = _sign(rng) * rng.uniform(1.5, 4.0), 0.5 * aisle + rng.uniform(-0.2, 0.2)
    return Pose2(x, y, (0.0 if rng.integers(2) else math.pi) + rng.uniform(-0.1, 0.1))


def _perpendicular(direction: DockDirection, rng: np.random.Generator) -> Scene:
    """Park nose in for a forward last gear, tail in for a backward one, otherwise at random."""
    length, wide, aisle = CAR.footprint.length, CAR.footprint.width, rng.uniform(1.8, 2.2)
    nose_in = direction is DockDirection.FORWARD or (direction is DockDirection.AUTO and bool(rng.integers(2)))
    goal = Pose2(0.0, -0.2, -0.5 * math.pi) if nose_in else Pose2(0.0, 0.2 - length, 0.5 * math.pi)
    parked = _parked(wide * (1.3, 1.5)[rng.integers(2)], (wide, length), aisle, 0.05)
    return Scene(_in_aisle(aisle, rng), Dock(goal, None, direction), parked, robot=CAR, clearance=CAR_RULE)


def _parallel(share: float, direction: DockDirection, rng: np.random.Generator, curb: float = CURB) -> Scene:
    """Park along the aisle; the car starts beyond or before the bay, with its final heading."""
    length, wide, aisle = CAR.footprint.length, CAR.footprint.width, rng.uniform(1.8, 2.2)
    start, goal = _in_aisle(aisle, rng), Pose2(0.2 - 0.5 * length, -0.5 * wide, 0.0)
    aligned = Pose2(start.x, start.y, rng.uniform(-0.1, 0.1))
    parked = _parked(share * length, (length, wide), aisle, curb)
    return Scene(aligned, Dock(goal, None, direction), parked, robot=CAR, clearance=CAR_RULE)


def _out_of_bay(rng: np.random.Generator) -> Scene:
    into = _parallel(PARALLEL[0], DockDirection.AUTO, rng)
    goal = Pose2(_sign(rng) * rng.uniform(3.0, 5.0), rng.uniform(0.7, 1.1), 0.0)
    return into._replace(start=into.dock.pose, dock=Dock(goal, final_straight=0.3))


def buildings(per_dock: int = 1, seed: int = SEED) -> list[Case]:
    """To the docks of `real_maps` on Nav2's maps from other places of the building, any heading. Tags give the map.

    The route from the start to the scenario's start, for a disc of 0.6 m radius in which the robot can turn, is 10 to
    40 m long: drawn uniformly by length among the available routes.

    Args:
        per_dock: Number of starts per dock.
        seed: Seed of the cases.

    Raises:
        InvalidFile: If a map is missing or broken.
    """
    cases = []
    for number, scenario in enumerate(SCENARIOS):
        problem = problem_of(scenario, data_folder() / "nav2" / "maps")
        places, lengths = _routes(scenario, problem)
        rng = _rng(seed, 7, number)
        for i in range(per_dock):
            start = _far_start(places, lengths, problem, rng)
            cases.append(Case(f"{scenario.name} {i}", "buildings", problem.starting_at(start), scenario.map_name))
    return sorted(cases, key=lambda case: case.tag)


_DISC = 0.6  # [m]
_COARSE = 0.15  # [m]: largest step of the routes through a building


@functools.cache
def _room_map(source: str) -> tuple[FloatArray, BoolArray]:
    """Return the cell centres of a map, Shape (rows, columns, 2) [m], and whether the disc is free there."""
    from scipy import ndimage

    costmap = problem_of(next(one for one in SCENARIOS if one.map_name == source), data_folder() / "nav2/maps").costmap
    assert costmap is not None
    away = ndimage.distance_transform_edt(costmap.data == 0) * costmap.resolution
    every = int(_COARSE / costmap.resolution)
    rows, columns = np.mgrid[0 : costmap.rows : every, 0 : costmap.columns : every]
    middles = np.stack((columns, rows), axis=-1) * costmap.resolution + np.array(costmap.origin)
    return middles + 0.5 * costmap.resolution, away[::every, ::every] >= _DISC + costmap.resolution


def _routes(scenario: MapScenario, problem: DockingProblem) -> tuple[FloatArray, FloatArray]:
    """Return free places of the disc, Shape (n, 2) [m], and the length of the route from each [m].

    Routes end at the scenario's start and are 8-connected on a coarse grid: at most 8 % longer than the shortest route.
    """
    from scipy import sparse

    middles, free = _room_map(scenario.map_name)
    number = np.cumsum(free).reshape(free.shape) - 1
    step = float(middles[0, 1, 0] - middles[0, 0, 0])
    first, second, length = [], [], []
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
        here = (slice(0, -down or None), slice(max(0, -right), -right if right > 0 else None))
        there = (slice(down, None), slice(max(0, right), right if right < 0 else None))
        both = free[here] & free[there]
        first.append(number[here][both])
        second.append(number[there][both])
        length.append(np.full(int(both.sum()), step * math.hypot(down, right)))
    count = int(free.sum())
    ends = (np.concatenate(first), np.concatenate(second))
    graph = sparse.csr_matrix((np.concatenate(length), ends), shape=(count, count))
    places = middles[free]
    nearest = int(np.argmin(np.hypot(*(places - [problem.start.x, problem.start.y]).T)))
    ways: FloatArray = sparse.csgraph.dijkstra(graph, directed=False, indices=[nearest])[0]
    return places, ways


def _far_start(places: FloatArray, lengths: FloatArray, problem: DockingProblem, rng: np.random.Generator) -> Pose2:
    """Return a place whose route has a drawn length or, if all are shorter, is longer than 10 m."""
    low, high = ROUTE
    longest = min(high, float(lengths[np.isfinite(lengths)].max()))
    wanted = rng.uniform(low, longest)
    near = np.flatnonzero(np.abs(lengths - wanted) <= 0.3)
    while True:
        x, y = places[rng.choice(near)].tolist()
        start = Pose2(x, y, rng.uniform(-math.pi, math.pi))
        clearance, _ = pose_clearances(start.as_array()[None], problem.robot.footprint, problem.all_obstacles, 1.0)
        if clearance[0] >= RULE.required:
            return start


def forklifts(per_heading: int = 8, seed: int = SEED) -> list[Case]:
    """A forklift (`FORKLIFT`), 10 to 20 m along an aisle of 4.4 to 5.2 m, into a bay between pallets next to the aisle.

    It enters the bay forks first (backward) or last. Tags give the heading in the aisle at the start: `towards` the
    bay, `away` from it, or `across`.

    Args:
        per_heading: Number of cases per heading.
        seed: Seed of the cases.
    """
    turned = {"towards": math.pi, "away": 0.0, "across": 0.5 * math.pi}
    cases = []
    for place, (tag, heading) in enumerate(turned.items()):
        for number in range(per_heading):
            rng = _rng(seed, 8, place, number)
            scene = _pallet_bay(heading, DockDirection.BACKWARD if number % 2 == 0 else DockDirection.FORWARD, rng)
            cases.append(scene.case("forklifts", tag, number, random_frame(rng)))
    return cases


def _pallet_bay(heading: float, direction: DockDirection, rng: np.random.Generator) -> Scene:
    """Return a bay 1.35 to 1.5 m wide, below the x axis at x = 0; the aisle above it leads to the start at x > 0."""
    aisle, half, deep = rng.uniform(4.4, 5.2), 0.5 * rng.uniform(1.35, 1.5), 1.3
    reach = rng.uniform(10.0, 20.0)
    backward = direction is DockDirection.BACKWARD
    bottom = -deep + 0.05  # position of the end of the forks, or of the front
    goal = Pose2(0.0, bottom + 0.9, 0.5 * math.pi) if backward else Pose2(0.0, bottom + 1.7, -0.5 * math.pi)
    x, y = reach, 0.5 * aisle
    if abs(math.cos(heading)) < 0.5:  # across the aisle, in its middle, in either direction
        heading = _sign(rng) * heading
        y -= 0.4 * math.copysign(1.0, heading)
    else:
        y += rng.uniform(-0.5, 0.5)
    start = Pose2(x, y, heading + rng.uniform(-0.1, 0.1))
    left, right = -6.0, reach + 6.0
    pallets = [
        rectangle(0.5 * (left - half), -0.5 * deep, -half - left, deep),
        rectangle(0.5 * (half + right), -0.5 * deep, right - half, deep),
    ]
    dock = Dock(goal, None, direction, final_straight=0.5, approach_speed=0.3, approach_distance=0.5)
    around = [*walls(left, -deep, right, aisle), *pallets]
    return Scene(start, dock, around, robot=FORKLIFT, clearance=FORKLIFT_RULE)


def blocked_straight(draws: int = 4, seed: int = SEED) -> list[Case]:
    """The straight before the dock is obstructed in an otherwise open scene: infeasible.

    Tags give the obstacle: a `post` on one side, a `gate` of two, or a `box` in the middle; and by how many centimetres
    the strip is narrower than the robot plus the required clearance on both sides.

    Args:
        draws: Number of cases per obstacle and missing width.
        seed: Seed of the cases.
    """
    cases = []
    for number in range(draws):
        rng = _rng(seed, 9, number)
        some = [(kind, missing) for kind in ("post", "gate") for missing in MISSING]
        for kind, missing in (*some, ("box", math.inf)):
            scene = _straight(kind, missing, rng, backward=number % 2 == 1)
            cases.append(scene.case("blocked straight", missing_tag(kind, missing), number, random_frame(rng)))
    return cases


def open_straight(draws: int = 4, seed: int = SEED) -> list[Case]:
    """The posts and gates of `blocked_straight`, 1 to 20 mm farther apart than necessary. Tags give this width.

    Args:
        draws: Number of cases per obstacle and spare width.
        seed: Seed of the cases.
    """
    cases = []
    for number in range(draws):
        rng = _rng(seed, 10, number)
        for kind in ("post", "gate"):
            for spare in (0.001, 0.005, 0.02):
                scene = _straight(kind, -spare, rng, backward=number % 2 == 1)
                tag = f"{kind}, {1e3 * spare:g} mm to spare"
                cases.append(scene.case("open straight", tag, number, random_frame(rng)))
    return cases


def _straight(kind: str, missing: float, rng: np.random.Generator, *, backward: bool) -> Scene:
    """Return obstacles along the part of the straight where the full clearance is required."""
    straight, before = rng.uniform(0.6, 1.0), -1.0 if not backward else 1.0
    size = rng.uniform(0.1, 0.3)
    # At least 10 cm behind the docked robot, and laterally next to the straight.
    away = rng.uniform(0.5 * _LENGTH + 0.1 + 0.5 * size, straight + 0.5 * _LENGTH - 0.1)
    posts, side = _posts(kind, missing, size), _sign(rng)
    placed = [post * [1.0, side] + [before * away, 0.0] for post in posts]
    body = {
        "post": is_too_wide(RULE.required, missing),
        "gate": is_too_wide(2.0 * RULE.required, missing),
        "box": True,
    }[kind]
    truth = Truth(missing, (before * away, 0.0), 0.0, body)
    dock = dock_at(Pose2(0.0, 0.0, 0.0), backward=backward, final_straight=straight)
    distance, bearing = rng.uniform(2.8, 5.0), rng.uniform(-1.2, 1.2)
    x, y = before * distance * math.cos(bearing), distance * math.sin(bearing)
    return Scene(Pose2(x, y, rng.uniform(-math.pi, math.pi)), dock, placed, truth)


def _posts(kind: str, missing: float, size: float) -> list[FloatArray]:
    """Return square posts around x = 0 at the strip, or a box in its middle."""
    if kind == "box":
        return [rectangle(0.0, 0.0, size, size)]
    reach = _HALF - (missing if kind == "post" else 0.5 * missing)
    post = rectangle(0.0, reach + 0.5 * size, size, size)
    return [post] if kind == "post" else [post, post * [1.0, -1.0]]


class Witness(NamedTuple):
    """A feasible motion around which a scene is built.

    Args:
        case: The scene.
        poses: Poses of the motion to the docked pose, Shape (n, 3), from the end of the open part on.
        spare: Spare width on each side [m].
    """

    case: Case
    poses: FloatArray
    spare: float


def barely_open(draws: int = 2, seed: int = SEED) -> list[Case]:
    """Walls around the swept area of a driven motion, 1 to 20 mm farther away than required: always feasible.

    Tags: a `straight slot` or an `arc slot` around the last 2 to 3 m, or a wall across the only room with a `gap` that
    admits an arc; and the spare width on each side. The room before it is open.

    Args:
        draws: Number of cases per obstacle and spare width.
        seed: Seed of the cases.
    """
    return [one.case for one in witnesses(draws, seed)]


def witnesses(draws: int = 2, seed: int = SEED) -> list[Witness]:
    """Return the cases of `barely_open` with their motions."""
    found = []
    for place, kind in enumerate(("straight slot", "arc slot", "gap")):
        for spare in SPARE:
            for number in range(draws):
                rng = _rng(seed, 11, place, round(1e4 * spare), number)
                found.append(_witness(kind, spare, number, rng))
    return found


def _witness(kind: str, spare: float, number: int, rng: np.random.Generator) -> Witness:
    """Return a scene whose motion begins at the origin along x; the start lies up to 2.5 m before it."""
    drive = _drive(kind, rng)
    poses = drive.poses_at(np.linspace(0.0, drive.length, math.ceil(drive.length / 0.01) + 1))
    goal = Pose2(*poses[-1].tolist())
    around = _gap_wall(poses, spare) if kind == "gap" else _slot(poses, spare)
    start = Pose2(rng.uniform(-2.5, -1.0), rng.uniform(-0.8, 0.8), rng.uniform(-0.6, 0.6))
    dock = dock_at(goal, charger=False)
    frame = random_frame(rng)
    truth = Truth(-2.0 * spare)
    case = Scene(start, dock, around, truth).case("barely open", f"{kind}, {1e3 * spare:g} mm to spare", number, frame)
    return Witness(case, np.array([(frame @ Pose2(*pose)).as_array() for pose in poses.tolist()]), spare)


def _drive(kind: str, rng: np.random.Generator) -> ClothoidSpline:
    """Return a motion: 1 m straight, an arc with its transitions, and straight; or straight only."""
    bend, turn = _sign(rng) * rng.uniform(0.6, 1.1), rng.uniform(0.7, 1.2)
    if kind == "straight slot":
        bend = turn = 0.0
    run = 0.35  # [m]: transition of the curvature, up and down; half of the rate limit
    arc = max(turn / abs(bend) - run, 0.1) if bend else 1.0
    knots = np.cumsum([0.0, 1.0, run, arc, run, 0.5])
    return ClothoidSpline(Pose2(0.0, 0.0, 0.0), knots, np.array([0.0, 0.0, bend, bend, 0.0, 0.0]))


# [m]: additional width of the polygons around the swept area, for chords of arcs, corners between two poses, and
# omitted corners.
_ROUNDNESS, _LEFT_OUT = 4e-4, 2e-4


def _sweep(poses: FloatArray, spare: float) -> BaseGeometry:
    """Return the swept area of the outline, grown by the required clearance and the spare width."""
    import shapely

    goal = poses[-1, :2]
    outlines = transform_points(poses, ROBOT.footprint.vertices)
    needed = RULE.near_goal(np.hypot(*(poses[:, :2] - goal).T))
    steps = shapely.convex_hull(shapely.multipoints(np.concatenate((outlines[:-1], outlines[1:]), axis=1)))
    wide = np.maximum(needed[:-1], needed[1:]) + spare + _ROUNDNESS
    return shapely.union_all(shapely.buffer(steps, wide, quad_segs=16)).simplify(_LEFT_OUT)


def _slot(poses: FloatArray, spare: float) -> list[FloatArray]:
    """Return a wall around the swept area, open towards the start."""
    import shapely

    sweep = _sweep(poses, spare)
    _, low_y, high_x, high_y = shapely.bounds(sweep).tolist()
    beyond = shapely.box(0.8, low_y - 1.0, high_x + 1.0, high_y + 1.0)
    around = shapely.buffer(sweep, 0.2, join_style="mitre").simplify(0.02)
    return _polygons(shapely.intersection(shapely.difference(around, sweep), beyond))


def _gap_wall(poses: FloatArray, spare: float) -> list[FloatArray]:
    """Return a room with a wall across; its gap is the swept area in the middle of the bend."""
    import shapely

    low, high = poses[:, :2].min(axis=0) - [4.0, 2.0], poses[:, :2].max(axis=0) + 1.5
    high[1] += 0.5
    middle = float(poses[round(0.55 * (len(poses) - 1)), 0])
    wall = shapely.box(middle - 0.1, low[1] - 0.1, middle + 0.1, high[1] + 0.1)
    return [*walls(*low.tolist(), *high.tolist()), *_polygons(shapely.difference(wall, _sweep(poses, spare)))]


def _polygons(shape: BaseGeometry) -> list[FloatArray]:
    import shapely

    return [np.array(part.exterior.coords)[:-1] for part in shapely.get_parts(shape) if part.area > 1e-6]
