"""What the benchmark asks: docking problems by family, drawn from seeds, the blocked ones with their known truth.

| family | what |
|---|---|
| tpcap | ten cases of the ITSC 2022 parking competition, required clearance 0 |
| obca | both OBCA scenes, 84 starts each, 5 cm everywhere. The file's bounds of x and y are those of the rear axle's |
|      | position in the paper's optimization, not walls; the walls are among its obstacles |
| dock starts | 60 starts, 1 to 6 m around each of the 29 docks of `real_maps` on Nav2's maps |
| open hall | a square hall of 40 to 70 m with 20 pillars; start and dock are 10 to 60 m apart |
| near dock | a charger at a wall, the start 0 to 30 cm aside and 0.3 to 1.5 m before it |
| blocked | nothing gets in, and where and by how much is known |

The files of tpcap, obca and Nav2's maps are looked for in `$OPTDOCK_DATA`, by default in `../shared/data` beside the
project; every other family needs none.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import os
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from experiments.parking_cases import OBCA_SCENES, load_tpcap, obca_cases
from experiments.real_maps import DRAWN_SCENARIOS, FRONT_CHARGER, REAR_CHARGER, ROBOT, SCENARIOS, problem_of
from optdock.geometry.pose import Pose2, transform_points
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.dock import Dock, DockDirection
from optdock.model.problem import DockingProblem
from optdock.verification import pose_clearances

if TYPE_CHECKING:
    from collections.abc import Iterator

    from optdock.geometry.arrays import FloatArray
    from optdock.model.robot import Robot

__all__ = [
    "Case",
    "Scene",
    "Truth",
    "blocked",
    "data_folder",
    "dock_at",
    "dock_starts",
    "free_starts",
    "is_too_wide",
    "missing_tag",
    "near_dock",
    "obca",
    "open_hall",
    "random_frame",
    "rectangle",
    "side_of",
    "tpcap",
    "wall_with_gap",
    "walls",
]

SEED = 11
OBCA_BOUNDS = (-15.0, 15.0, 1.0, 10.0)  # [m] of the rear axle, in the file too
# Around the docks.
NEAREST, FARTHEST = 1.0, 6.0  # [m] from the docked pose
FREE_START = 0.01  # [m] of clearance that a drawn start has
# The hall.
LENGTHS = (10.0, 20.0, 30.0, 40.0, 50.0, 60.0)  # [m] between start and dock
PILLARS = 20
# [m] between pillars and from pillars to walls, around the start, and around the stretch before the dock: the robot is
# 0.9 m x 0.6 m and turns within 0.67 m, so each leaves room for any turn, and every draw has a solution.
BETWEEN, AROUND_START, AROUND_DOCK = 1.8, 2.5, 2.5
# Blocked scenes.
MISSING = (0.02, 0.05, 0.10, 0.30)  # [m]
ROOM = (6.0, 4.0)  # [m]
RULE = ClearanceRule(required=0.05, at_dock=0.0, taper=0.5)
_NEEDED = ROBOT.footprint.width + 2.0 * RULE.required  # [m] of a gap; the robot's least width is across


ORIGIN = Pose2(0.0, 0.0, 0.0)


class Truth(NamedTuple):
    """Why a blocked scene is blocked, or how little room an open one has.

    Args:
        missing: By how much its narrowest place is narrower than the robot and the required clearance on both sides;
            infinite where there is no gap at all, negative where there is a way with so much to spare [m].
        place: The middle of that place, x and y [m]; None where no single place is the narrowest.
        heading: Along which the robot would have to pass, or the opposite [rad].
        is_body: Whether the body alone does not fit (else it does, and the required clearance does not); None where it
            fits exactly, so that nobody can tell.
    """

    missing: float
    place: tuple[float, float] | None = None
    heading: float | None = None
    is_body: bool | None = False


class Case(NamedTuple):
    """One question to `plan_dock`.

    Args:
        name: Says which, unique within the family.
        family: As in the table above.
        problem: The question.
        tag: The row of the summary that it counts in.
        truth: Of a blocked scene, and of one that is barely open.
        bounds: Least and largest x, least and largest y, that the source has for the robot's origin. They are no walls:
            leaving them is only counted.
    """

    name: str
    family: str
    problem: DockingProblem
    tag: str = ""
    truth: Truth | None = None
    bounds: tuple[float, float, float, float] | None = None


class Scene(NamedTuple):
    """A scene drawn around an origin of its own.

    Args:
        start: Where the robot is.
        dock: Where it must end.
        obstacles: Simple polygons, Shape (n, 2) [m] each.
        truth: Of a blocked scene, and of one that is barely open.
        robot: What drives.
        clearance: How far it must stay away.
    """

    start: Pose2
    dock: Dock
    obstacles: list[FloatArray]
    truth: Truth | None = None
    robot: Robot = ROBOT
    clearance: ClearanceRule = RULE

    def case(self, family: str, tag: str, number: int, frame: Pose2 = ORIGIN) -> Case:
        """The scene put into `frame`; the number makes its name unique within the tag."""
        placed = [transform_points(frame.as_array()[None], polygon)[0] for polygon in self.obstacles]
        dock = dataclasses.replace(self.dock, pose=frame @ self.dock.pose)
        problem = DockingProblem(frame @ self.start, dock, self.robot, placed, self.clearance)
        truth = self.truth
        if truth is not None and truth.place is not None:
            at = frame @ Pose2(*truth.place, truth.heading or 0.0)
            truth = truth._replace(place=(at.x, at.y), heading=at.yaw)
        return Case(f"{tag} {number}", family, problem, tag, truth)


def data_folder() -> Path:
    """Where real data is looked for."""
    return Path(os.environ.get("OPTDOCK_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))


def tpcap() -> list[Case]:
    """The competition's cases 1 to 10.

    Raises:
        InvalidFile: A file is missing or broken.
    """
    folder = data_folder() / "tpcap"
    return [Case(f"case {i}", "tpcap", load_tpcap(folder / f"Case{i}.csv").problem, "tpcap") for i in range(1, 11)]


def obca() -> list[Case]:
    """Both scenes from all their starts.

    Raises:
        InvalidFile: The file is missing or broken.
    """
    source, cases = data_folder() / "obca" / "scenes.json", []
    for scene in OBCA_SCENES:
        found = obca_cases(source, scene)
        first = found[0].problem
        for i, case in enumerate(found):
            name = f"{scene} {i}: from {case.start.x:g}, {case.start.y:g}"
            cases.append(Case(name, "obca", first.starting_at(case.start), scene, bounds=OBCA_BOUNDS))
    return cases


def dock_starts(per_dock: int = 60, seed: int = SEED) -> list[Case]:
    """Random starts around real docks: any bearing, any heading, free by 1 cm, on the map.

    Tags say where the start lies as seen from the dock, against the side that it is entered from: `before` (less than
    45 degrees off), `oblique` (less than 90), `beside or behind`.

    Raises:
        InvalidFile: A map is missing or broken.
    """
    cases = []
    for number, scenario in enumerate(SCENARIOS):
        problem = problem_of(scenario, data_folder() / "nav2" / "maps")
        rng = np.random.default_rng((seed, number))
        starts = np.concatenate(list(free_starts(problem, per_dock, rng)))[:per_dock]
        for i, (x, y, yaw) in enumerate(starts.tolist()):
            start = Pose2(x, y, yaw)
            tag = side_of(problem.dock, start)
            cases.append(Case(f"{scenario.name} {i}", "dock starts", problem.starting_at(start), tag))
    return cases


def free_starts(problem: DockingProblem, wanted: int, rng: np.random.Generator) -> Iterator[FloatArray]:
    """Batches of free poses, at least as many as wanted."""
    found, goal = 0, problem.goal
    while found < wanted:
        distance = rng.uniform(NEAREST, FARTHEST, 4 * wanted)
        bearing, yaw = rng.uniform(-math.pi, math.pi, (2, 4 * wanted))
        poses = np.column_stack((goal.x + distance * np.cos(bearing), goal.y + distance * np.sin(bearing), yaw))
        clearance, _ = pose_clearances(poses, problem.robot.footprint, problem.all_obstacles, within=1.0)
        free = poses[clearance >= FREE_START]
        found += len(free)
        yield free


def side_of(dock: Dock, start: Pose2) -> str:
    """Where a start lies as seen from the dock, against the side that it is entered from: a tag of `dock_starts`."""
    seen = dock.pose.inverse() @ start
    before = -seen.x if dock.direction is not DockDirection.BACKWARD else seen.x
    off = math.degrees(math.atan2(abs(seen.y), before))
    return "before" if off < 45.0 else "oblique" if off < 90.0 else "beside or behind"


def open_hall(length: float, draws: int = 100, seed: int = SEED) -> list[Case]:
    """Long ways through a hall with pillars; odd draws dock at a wall, even ones at a charger that stands free.

    Args:
        length: Distance from the start to the dock [m].
        draws: How many.
        seed: Of the draws.
    """
    side = max(40.0, length + 10.0)
    return [_hall(length, side, i, np.random.default_rng((seed, round(length), i))) for i in range(draws)]


def _hall(length: float, side: float, number: int, rng: np.random.Generator) -> Case:
    at_wall = number % 2 == 1
    goal, start = _ends_in_hall(length, side, rng, at_wall=at_wall)
    # The middle of the stretch before the dock, which stays free as the surroundings of the start do.
    staging = goal @ Pose2(-1.5, 0.0, 0.0)
    keep_out = np.array([[start.x, start.y, AROUND_START], [staging.x, staging.y, AROUND_DOCK]])
    pillars = _pillars(side, keep_out, rng)
    dock = dock_at(goal)
    problem = DockingProblem(start, dock, ROBOT, [*walls(0.0, 0.0, side, side), *pillars], RULE)
    return Case(f"{length:g} m {number}", "open hall", problem, f"{length:g} m")


def _ends_in_hall(length: float, side: float, rng: np.random.Generator, *, at_wall: bool) -> tuple[Pose2, Pose2]:
    """Goal and start `length` apart, both well inside."""
    margin = AROUND_DOCK + 0.5
    while True:
        if at_wall:  # the nose with its charger at one of the four walls
            heading = rng.integers(4) * 0.5 * math.pi
            along, out = rng.uniform(margin, side - margin), side - 0.6
            x, y = _turned(along - 0.5 * side, out - 0.5 * side, heading - 0.5 * math.pi)
            goal = Pose2(x + 0.5 * side, y + 0.5 * side, heading)
        else:
            goal = Pose2(*rng.uniform(margin, side - margin, 2), rng.uniform(-math.pi, math.pi))
        bearing = rng.uniform(-math.pi, math.pi)
        x, y = goal.x + length * math.cos(bearing), goal.y + length * math.sin(bearing)
        if min(x, y) >= margin and max(x, y) <= side - margin:
            return goal, Pose2(x, y, rng.uniform(-math.pi, math.pi))


def _turned(x: float, y: float, angle: float) -> tuple[float, float]:
    c, s = math.cos(angle), math.sin(angle)
    return c * x - s * y, s * x + c * y


def _pillars(side: float, keep_out: FloatArray, rng: np.random.Generator) -> list[FloatArray]:
    """Turned rectangles of 0.4 to 1.2 m, apart from each other, from the walls and from the discs to keep out of."""
    discs, found = keep_out, []
    while len(found) < PILLARS:
        size, middle = rng.uniform(0.4, 1.2, 2), rng.uniform(BETWEEN + 0.85, side - BETWEEN - 0.85, 2)
        reach = 0.5 * math.hypot(*size)
        apart = np.hypot(*(discs[:, :2] - middle).T) - discs[:, 2] - reach
        if np.all(apart >= np.where(np.arange(len(discs)) < len(keep_out), 0.0, BETWEEN)):
            found.append(rectangle(*middle, *size, rng.uniform(0.0, math.pi)))
            discs = np.vstack((discs, [*middle, reach]))
    return found


def rectangle(x: float, y: float, length: float, width: float, yaw: float = 0.0) -> FloatArray:
    """Corners around a middle."""
    corners = 0.5 * np.array([[-length, -width], [length, -width], [length, width], [-length, width]])
    return transform_points(np.array([[x, y, yaw]]), corners)[0]


def walls(x0: float, y0: float, x1: float, y1: float, thickness: float = 0.2) -> list[FloatArray]:
    """Four walls around a room."""
    width, height, middle = x1 - x0 + 2 * thickness, y1 - y0 + 2 * thickness, (0.5 * (x0 + x1), 0.5 * (y0 + y1))
    out = 0.5 * thickness
    return [
        rectangle(middle[0], y0 - out, width, thickness),
        rectangle(middle[0], y1 + out, width, thickness),
        rectangle(x0 - out, middle[1], thickness, height),
        rectangle(x1 + out, middle[1], thickness, height),
    ]


def wall_with_gap(x: float, ends: tuple[float, float, float, float], thick: float) -> list[FloatArray]:
    """A wall across at x, between the outer of four y, open between the inner ones."""
    bottom, low, high, top = ends
    return [
        rectangle(x, 0.5 * (top + high), thick, top - high),
        rectangle(x, 0.5 * (bottom + low), thick, low - bottom),
    ]


def dock_at(goal: Pose2, *, backward: bool = False, charger: bool = True, final_straight: float = 0.3) -> Dock:
    """A dock as those of `real_maps`."""
    outline = (REAR_CHARGER if backward else FRONT_CHARGER) if charger else None
    direction = DockDirection.BACKWARD if backward else DockDirection.FORWARD
    return Dock(goal, outline, direction, final_straight, approach_speed=0.1, approach_distance=0.3)


def near_dock() -> list[Case]:
    """A grid of starts close before a charger at a wall, parallel to the docked robot; tags name the offset."""
    wall = rectangle(0.7, 0.0, 0.2, 20.0)
    problem = DockingProblem(Pose2(-1.0, 0.0, 0.0), dock_at(Pose2(0.0, 0.0, 0.0)), ROBOT, [wall], RULE)
    grid = [(aside, -0.05 * n) for aside in (0.0, 0.03, 0.05, 0.1, 0.3) for n in range(6, 31)]
    return [
        Case(
            f"{100 * aside:g} cm aside, {-x:.2f} m before",
            "near dock",
            problem.starting_at(Pose2(x, aside, 0.0)),
            f"{100 * aside:g} cm aside",
        )
        for aside, x in grid
    ]


def blocked(draws: int = 10, seed: int = SEED) -> list[Case]:
    """Scenes that nothing gets through, and why: gaps, closed doors, short bays, rings.

    Every scene but those on the map is turned by a random angle. Tags say what is blocked and how many centimetres are
    missing.

    Args:
        draws: Of every kind and every missing width.
        seed: Of the draws.
    """
    cases = []
    for i in range(draws):
        rng = np.random.default_rng((seed, 99, i))
        cases += [_gap(missing, i, rng) for missing in MISSING]
        cases += [_bay(missing, i, rng) for missing in (0.02, 0.05, 0.08, 0.30)]
        cases += [_ring(missing, i, rng) for missing in (*MISSING, math.inf)]
        cases += [_door(missing, i, rng) for missing in (0.10, 0.30, math.inf)]
    return cases


def is_too_wide(room: float, size: float) -> bool | None:
    """Whether a body of this size does not fit into the room [m]; None for an exact fit."""
    return None if abs(room - size) < 1e-6 else room < size


def missing_tag(kind: str, missing: float) -> str:
    """The tag of a blocked scene: what is blocked, and by how much."""
    return f"{kind}, closed" if math.isinf(missing) else f"{kind}, {100 * missing:g} cm missing"


def random_frame(rng: np.random.Generator) -> Pose2:
    """Where a scene is put, turned by any angle."""
    return Pose2(*rng.uniform(-5.0, 5.0, 2), rng.uniform(-math.pi, math.pi))


def _gap(missing: float, number: int, rng: np.random.Generator) -> Case:
    """A room with a wall across and a gap in it; a convex body passes a gap that its least width fits, or never."""
    (width, height), thick = ROOM, rng.uniform(0.1, 0.5)
    at, wide, x = rng.uniform(-0.8, 0.8), _NEEDED - missing, rng.uniform(-0.4, 0.4)
    top, bottom = 0.5 * height, -0.5 * height
    high, low = at + 0.5 * wide, at - 0.5 * wide
    across = wall_with_gap(x, (bottom, low, high, top), thick)
    start = Pose2(x - 1.7, rng.uniform(-1.0, 1.0), rng.uniform(-math.pi, math.pi))
    dock = dock_at(Pose2(0.5 * width - 0.6, rng.uniform(-1.0, 1.0), 0.0))
    room = walls(-0.5 * width, bottom, 0.5 * width, top)
    truth = Truth(missing, (x, at), 0.0, is_too_wide(wide, ROBOT.footprint.width))
    return Scene(start, dock, [*room, *across], truth).case(
        "blocked", missing_tag("gap", missing), number, random_frame(rng)
    )


def _bay(missing: float, number: int, rng: np.random.Generator) -> Case:
    """A bay beside an aisle, parallel to it, with the docked robot at its bottom.

    The bay is shorter than the robot and its clearance, and so deep (1.6 m) that all of the robot is still inside where
    the taper asks for the full clearance. There it would have to leave sideways, or turn, for which it needs more.
    Shorter than the body, the docked pose itself collides.
    """
    length, depth, aisle = ROBOT.footprint.length + 2.0 * RULE.required - missing, 1.6, 2.5
    bottom = -0.5 * ROBOT.footprint.width - RULE.required
    mouth = bottom + depth
    beside = [rectangle(side * (0.5 * length + 1.0), bottom + 0.5 * depth, 2.0, depth) for side in (-1.0, 1.0)]
    room = walls(-0.5 * length - 2.0, bottom, 0.5 * length + 2.0, mouth + aisle)
    start = Pose2(rng.uniform(-1.5, 1.5), mouth + 0.5 * aisle, rng.uniform(-0.5, 0.5))
    truth = Truth(missing, is_body=is_too_wide(length, ROBOT.footprint.length))
    dock = Dock(Pose2(0.0, 0.0, 0.0))
    return Scene(start, dock, [*room, *beside], truth).case(
        "blocked", missing_tag("bay", missing), number, random_frame(rng)
    )


def _ring(missing: float, number: int, rng: np.random.Generator) -> Case:
    """A wall of twelve straight pieces all around the dock, closed or with one gap in the middle of a piece."""
    sides, inner, thick = 12, rng.uniform(2.2, 2.8), 0.2
    angles = (np.arange(sides) + 0.5) * 2.0 * math.pi / sides
    corners = [
        r / math.cos(math.pi / sides) * np.column_stack((np.cos(angles), np.sin(angles)))
        for r in (inner, inner + thick)
    ]
    after = [np.roll(ring, -1, axis=0) for ring in corners]
    pieces = list(np.stack((corners[0], corners[1], after[1], after[0]), axis=1))
    if math.isfinite(missing):  # the last piece faces along x; a gap splits it
        half, reach = 0.5 * (_NEEDED - missing), float(corners[1][0, 1])
        middle = rectangle(inner + 0.5 * thick, 0.5 * (half + reach), thick, reach - half)
        pieces[-1:] = [middle, middle * [1.0, -1.0]]
    goal = Pose2(*rng.uniform(-0.3, 0.3, 2), rng.uniform(-math.pi, math.pi))
    bearing = rng.uniform(-math.pi, math.pi)
    start = Pose2(4.5 * math.cos(bearing), 4.5 * math.sin(bearing), rng.uniform(-math.pi, math.pi))
    wide = _NEEDED - missing
    place = (inner + 0.5 * thick, 0.0) if math.isfinite(missing) else None
    truth = Truth(missing, place, 0.0 if place else None, is_too_wide(wide, ROBOT.footprint.width))
    return Scene(start, dock_at(goal), pieces, truth).case(
        "blocked", missing_tag("ring", missing), number, random_frame(rng)
    )


@functools.cache
def _corridor() -> DockingProblem:
    """The side room behind a door on the drawn map of a corridor."""
    return problem_of(next(one for one in DRAWN_SCENARIOS if one.name == "corridor through the door"))


def _door(missing: float, number: int, rng: np.random.Generator) -> Case:
    """The corridor's door, 1.2 m wide, closed or left ajar; the dock is in the side room."""
    middle, y, wide = 7.4, 4.475, 1.2
    left, right = middle - 0.5 * wide - 0.2, middle + 0.5 * wide + 0.2  # into the walls on both sides
    if math.isinf(missing):
        leaves, place = [(left, right)], None
    else:
        opening = _NEEDED - missing
        at = rng.uniform(middle - 0.5 * (wide - opening) + 0.1, middle + 0.5 * (wide - opening) - 0.1)
        leaves, place = [(left, at - 0.5 * opening), (at + 0.5 * opening, right)], (at, y)
    doors = [rectangle(0.5 * (a + b), y, b - a, 0.06) for a, b in leaves]
    problem = _corridor()
    start = Pose2(rng.uniform(6.0, 9.0), rng.uniform(2.9, 3.4), rng.uniform(-0.4, 0.4))
    shut = DockingProblem(
        start, problem.dock, ROBOT, doors, problem.clearance, costmap=problem.costmap, frame=problem.frame
    )
    tag = missing_tag("door", missing)
    is_body = is_too_wide(_NEEDED - missing, ROBOT.footprint.width)
    truth = Truth(missing, place, 0.5 * math.pi if place else None, is_body)
    return Case(f"{tag} {number}", "blocked", shut, tag, truth)
