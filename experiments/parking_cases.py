"""Public parking cases: the files of the TPCAP competition and the scenes of OBCA, read as docking problems.

Both are facts about a car, obstacles, a start and a goal pose of the middle of the rear axle. The goal pose is the
dock: there is no station, no last straight stretch, and either gear may end in it.

- TPCAP, the Trajectory Planning Competition of Automated Parking (ITSC 2022) [Li2023]: one row of comma-separated
  numbers: start x, y, yaw; goal x, y, yaw [m, rad]; the number n of obstacles; n vertex counts; then x, y of every
  vertex, obstacle after obstacle.
- OBCA, the scenes of the optimization-based collision avoidance paper [Zhang2021]: a JSON file of a car,
  the scenes `backwards` and `parallel`, and the grid of starts that both share. Its bounds of x and y hold for the rear
  axle, not for the body: they are not walls, and every wall that the scenes have is an obstacle in the file.

    python -m experiments.parking_cases Case1.csv -o case1.yaml
    python -m experiments.parking_cases scenes.json --scene parallel --start 3 -o parallel3.yaml
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from optdock.config import Scenario, save_scenario
from optdock.errors import InvalidFile, InvalidValue, OptdockError
from optdock.geometry.footprint import Footprint
from optdock.geometry.polygon import simple_polygon
from optdock.geometry.pose import Pose2
from optdock.io.faults import faults_of, report
from optdock.io.guarded_file import MostBytes, read_text
from optdock.io.numbers import MOST_POLYGONS, check_vertices, check_yaw
from optdock.io.quoting import shown
from optdock.io.yaml_lines import listed, load_yaml
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.problem import DockingProblem
from optdock.model.robot import Drive, Robot
from optdock.plugins.parameters import closest

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["OBCA_SCENES", "ParkingCase", "load_obca", "load_tpcap", "obca_cases"]

OBCA_SCENES = ("backwards", "parallel")
# The wheels turn while the car creeps: curvature may change by steering rate / wheelbase per second at this speed. It
# is a planner's choice, not a limit of the car, and leaves enough time for every motion up to it.
STEERING_SPEED = 0.5  # [m/s]
# Neither source bounds the jerk, and an unbounded one does not exist; this reaches 1 m/s^2 in 0.1 s.
JERK = 10.0  # [m/s^3]


class Car(NamedTuple):
    """A car as the sources describe it; its frame lies in the middle of the rear axle. All [m], [rad], [s]."""

    wheelbase: float
    front: float  # from the rear axle to the bumper
    rear: float
    width: float
    max_steering_angle: float
    max_steering_rate: float
    max_acceleration: float
    max_speed: float
    max_reverse_speed: float

    @property
    def robot(self) -> Robot:
        """The robot: the steering angle bounds its curvature; the rate its motion and, at a creep, its path."""
        limits = MotionLimits(
            max_speed=self.max_speed,
            max_reverse_speed=self.max_reverse_speed,
            max_acceleration=self.max_acceleration,
            max_deceleration=self.max_acceleration,
            max_jerk=JERK,
            wheelbase=self.wheelbase,
            max_steering_angle=self.max_steering_angle,
            max_steering_rate=self.max_steering_rate,
            max_curvature_rate=self.max_steering_rate / self.wheelbase / STEERING_SPEED,
        )
        return Robot(Footprint.rectangle(self.front, self.rear, self.width), limits, Drive.ACKERMANN)


TPCAP_CAR = Car(2.8, 3.76, 0.929, 1.942, 0.75, 0.5, 1.0, 2.5, 2.5)


class ParkingCase(NamedTuple):
    """One case: `obstacles` are simple polygons, convex or not, Shape (n, 2) [m] each, as the file has them."""

    start: Pose2
    goal: Pose2
    robot: Robot
    obstacles: tuple[list[list[float]], ...]
    clearance: float

    @property
    def problem(self) -> DockingProblem:
        """The docking problem."""
        rule = ClearanceRule.of(self.clearance)
        return DockingProblem(self.start, Dock(self.goal), self.robot, self.obstacles, rule)


def load_tpcap(source: str | Path) -> ParkingCase:
    """Read a case of the competition; the required clearance is 0, as there.

    Raises:
        InvalidFile: Unreadable, not numbers, too few or too many of them, or a polygon is none; the message lists every
            fault with its line and what the value stands for.
    """
    row = _Row.read(Path(source))
    count = row.count(6, "the number of obstacles", least=0, most=MOST_POLYGONS)
    sizes = [row.count(7 + i, f"the number of vertices of obstacles[{i}]", least=3) for i in range(count)]
    row.check_length(7 + count + 2 * sum(sizes))
    start, goal = row.pose(0, "the start pose"), row.pose(3, "the goal pose")
    at, obstacles = 7 + count, []
    for i, size in enumerate(sizes):
        obstacles.append(row.polygon(at, size, f"obstacles[{i}]"))
        at += 2 * size
    row.refuse()
    return ParkingCase(start, goal, TPCAP_CAR.robot, tuple(obstacles), 0.0)


class _Row:
    """The numbers of a file, each with the line it stands in; faults are collected until `refuse`."""

    def __init__(self, source: Path, values: list[float], lines: list[int], faults: list[str]) -> None:
        self._source, self._values, self._lines, self._faults = source, values, lines, faults

    @classmethod
    def read(cls, source: Path) -> _Row:
        text = read_text(source, MostBytes.CSV)
        row = cls(source, [], [], [])
        for line, words in enumerate(text.splitlines(), start=1):
            for word in words.strip().rstrip(",").split(",") if words.strip() else ():
                row._take(word.strip(), line)
        row.refuse()
        if not row._values:
            raise InvalidFile(f"{source}: is empty")
        return row

    def _take(self, word: str, line: int) -> None:
        try:
            value = float(word)
        except ValueError:
            value = math.nan
        self._values.append(value)
        self._lines.append(line)
        if not math.isfinite(value):
            self._fault(len(self._values) - 1, "", f"must be a finite number, got {shown(word)}")

    def _fault(self, at: int, what: str, rule: str) -> None:
        line = self._lines[min(at, len(self._lines) - 1)]
        meant = f", {what}" if what else ""
        self._faults.append(f"{self._source}:{line}: value {at + 1}{meant}: {rule}")

    def refuse(self) -> None:
        """Say every fault so far.

        Raises:
            InvalidFile: There is one.
        """
        if self._faults:
            raise InvalidFile(listed(str(self._source), self._faults))

    def count(self, at: int, what: str, least: int, most: float = math.inf) -> int:
        """A whole number; without it, what follows cannot be read."""
        value = self._values[at] if at < len(self._values) else None
        if value is None or value != round(value) or not least <= value <= len(self._values):
            got = "the end of the file" if value is None else f"{value:g}"
            self._fault(at, what, f"must be a whole number >= {least}, got {got}")
            self.refuse()
        elif value > most:
            self._fault(at, what, f"must be at most {most}, got {value:g}")
            self.refuse()
        return round(value or 0)

    def check_length(self, wanted: int) -> None:
        """As many numbers as the counts say."""
        if len(self._values) != wanted:
            raise InvalidFile(f"{self._source}: must hold {wanted} numbers by its counts, got {len(self._values)}")

    def pose(self, at: int, what: str) -> Pose2:
        """A pose."""
        x, y, yaw = self._values[at : at + 3]
        try:
            check_yaw(yaw)
        except InvalidValue as error:
            self._fault(at + 2, what, str(error))
        return Pose2(x, y, yaw)

    def polygon(self, at: int, size: int, what: str) -> list[list[float]]:
        """Vertices, as they stand there."""
        flat = self._values[at : at + 2 * size]
        vertices = [list(pair) for pair in zip(flat[::2], flat[1::2], strict=True)]
        try:
            check_vertices(vertices)
            simple_polygon(vertices, what)
        except InvalidValue as error:
            self._fault(at, what, str(error).removeprefix(f"{what}: "))
        return vertices


class _CaseModel(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


def _yaw_checked(yaw: float) -> float:
    check_yaw(yaw)
    return yaw


def _simple(vertices: list[list[float]]) -> list[list[float]]:
    check_vertices(vertices)
    simple_polygon(vertices, "polygon")
    return vertices


_Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
_Positive = Annotated[_Number, Field(gt=0.0)]
_Yaw = Annotated[_Number, AfterValidator(_yaw_checked)]
_Polygon = Annotated[list[list[_Number]], AfterValidator(_simple)]


class _Vehicle(_CaseModel):
    wheelbase: _Positive
    front_from_rear_axle: _Positive
    rear_from_rear_axle: _Positive
    width: _Positive
    max_steer: Annotated[_Positive, Field(lt=0.5 * math.pi)]
    max_steer_rate: _Positive
    max_acc: _Positive
    v_min: Annotated[_Number, Field(lt=0.0)]
    v_max: _Positive
    dmin: Annotated[_Number, Field(ge=0.0)]

    @property
    def robot(self) -> Robot:
        return Car(
            self.wheelbase,
            self.front_from_rear_axle,
            self.rear_from_rear_axle,
            self.width,
            self.max_steer,
            self.max_steer_rate,
            self.max_acc,
            self.v_max,
            -self.v_min,
        ).robot


class _OccupancyGrid(_CaseModel):
    x: list[_Number]
    y: list[_Number]
    yaw: _Yaw
    note: str = ""


class _Scene(_CaseModel):
    obstacles: Annotated[list[_Polygon], Field(max_length=MOST_POLYGONS)]
    goal: tuple[_Number, _Number, _Yaw]


class _Scenes(_CaseModel):
    vehicle: _Vehicle
    start_grid: _OccupancyGrid
    backwards: _Scene
    parallel: _Scene
    xy_bounds: object = None
    Ts: object = None  # of the paper's own optimization


def obca_cases(source: str | Path, scene: str) -> list[ParkingCase]:
    """Every start of one scene, x by x and for each y by y; the required clearance is the file's, also at the goal.

    Raises:
        InvalidValue: There is no such scene.
        InvalidFile: The file breaks its format; the message lists every fault with its line and key.
    """
    if scene not in OBCA_SCENES:
        raise InvalidValue(
            f"scene: must be {' or '.join(OBCA_SCENES)}, got {shown(scene)}{closest(scene, OBCA_SCENES)}"
        )
    document = load_yaml(source)  # JSON is YAML, and this reader knows lines
    try:
        scenes = _Scenes.model_validate(document.value)
    except ValidationError as error:
        raise InvalidFile(report(faults_of(error, _known_keys), document)) from error
    chosen, grid = (scenes.backwards if scene == "backwards" else scenes.parallel), scenes.start_grid
    goal, robot, obstacles = Pose2(*chosen.goal), scenes.vehicle.robot, tuple(chosen.obstacles)
    starts = [Pose2(x, y, grid.yaw) for x in grid.x for y in grid.y]
    return [ParkingCase(start, goal, robot, obstacles, scenes.vehicle.dmin) for start in starts]


def load_obca(source: str | Path, scene: str, start: int) -> ParkingCase:
    """One start of a scene.

    Args:
        source: The file.
        scene: `backwards` or `parallel`.
        start: Which of `obca_cases`, from 0.

    Raises:
        InvalidValue: There is no such scene or start.
        InvalidFile: As `obca_cases`.
    """
    cases = obca_cases(source, scene)
    if not 0 <= start < len(cases):
        raise InvalidValue(f"start: must be in 0..{len(cases) - 1}, got {start}")
    return cases[start]


def _known_keys(key: tuple[str | int, ...]) -> tuple[str, ...]:
    parts: dict[str, type[BaseModel]] = {"vehicle": _Vehicle, "start_grid": _OccupancyGrid}
    parts |= dict.fromkeys(OBCA_SCENES, _Scene)
    model = parts.get(str(key[0])) if key else _Scenes
    return tuple(model.model_fields) if model and len(key) < 2 else ()


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the scenario file of a case; returns the exit status."""
    parser = argparse.ArgumentParser(description="Write a scenario file of a public parking case.")
    parser.add_argument("file", type=Path, help="TPCAP case (CSV), or OBCA scenes (JSON) with --scene")
    parser.add_argument("--scene", help="backwards or parallel")
    parser.add_argument("--start", type=int, default=0, help="start in the grid, from 0: y by y, for each x")
    parser.add_argument("--out", "-o", type=Path, required=True, help="scenario file to write (YAML)")
    parser.add_argument("--time-budget", type=float, default=1.0, help="wall clock for planning [s]")
    given = parser.parse_args(arguments)
    try:
        if given.scene is None:
            case, name = load_tpcap(given.file), "TPCAP"
        else:
            case = load_obca(given.file, given.scene, given.start)
            name = f"OBCA, scene {given.scene}, start {given.start}"
        scenario = Scenario(case.problem, given.time_budget)
        written = save_scenario(given.out, scenario, obstacles=case.obstacles, note=f"{name}, {given.file.name}")
    except OptdockError as error:
        print(error, file=sys.stderr)
        return 2
    print("written:", *written)
    return 0


if __name__ == "__main__":
    sys.exit(main())
