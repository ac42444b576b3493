"""Docking logs, read; see `log` for the format."""

from __future__ import annotations

import base64
import dataclasses
import json
import zlib
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, JsonValue, TypeAdapter, ValidationError

from optdock.config.document import ScenarioDocument
from optdock.config.scenario import problem_of
from optdock.errors import InvalidFile, InvalidValue, OptdockError
from optdock.executor.executor_settings import ExecutorSettings
from optdock.executor.log import Cycle, DockingLog, MotionStart, Planned, Task
from optdock.executor.planning import Outcome, PlanResult, Verdict
from optdock.executor.task_states import Ending, EndingKind, Event, State
from optdock.geometry.pose import Pose2, Twist2
from optdock.io.guarded_file import MostBytes, check_json_size, read_text
from optdock.io.map_image import MAX_PIXELS
from optdock.io.plan_file import parse_plan
from optdock.model.costmap import Costmap
from optdock.model.dock import DockTolerances
from optdock.model.measurements import Detection, Measurements, OdometryPose
from optdock.model.trajectory import Trajectory
from optdock.plugins.registry import PluginChoice

if TYPE_CHECKING:
    from collections.abc import Iterator


__all__ = ["read_log"]

_MOST_VALUES = 300_000


def read_log(source: str | Path) -> DockingLog:
    """Read a log.

    A last line that is cut off, as a crash leaves it, is left out.

    Raises:
        InvalidFile: The file cannot be read, is not a log, or is damaged; the message names file and line.
    """
    source = Path(source)
    lines = read_text(source, MostBytes.LOG).split("\n")
    cut_off = bool(lines.pop())  # what comes after the last end of line
    if not lines:
        raise InvalidFile(f"{source}:1: is not a log: it has not a single whole line")
    with _said_of(source, 1):
        check_json_size(lines[0], _MOST_VALUES)
        task = _TaskLine.model_validate_json(lines[0]).read()
    cycles = tuple(_cycles(source, lines))
    if not cycles:
        raise InvalidFile(f"{source}: holds no whole cycle")
    return DockingLog(str(source), task, cycles, cut_off)


def _cycles(source: Path, lines: list[str]) -> Iterator[Cycle]:
    planned: list[Planned] = []
    cancelled = False
    for number, text in enumerate(lines[1:], start=2):
        cycle: Cycle | None = None
        with _said_of(source, number):
            check_json_size(text, _MOST_VALUES)
            line = _LINE.validate_json(text)
            if isinstance(line, _CycleLine):
                cycle = line.cycle(number, tuple(planned), cancelled=cancelled)
            elif isinstance(line, _CancelLine):
                cancelled = True
            elif isinstance(line, _VerdictLine):
                planned.append(Planned(verdict=Verdict(*line.verdict)))
            else:
                planned.append(line.planned.read(f"{source}:{number}"))
        if cycle is not None:
            yield cycle
            planned.clear()
            cancelled = False


@contextmanager
def _said_of(source: Path, line: int) -> Iterator[None]:
    """Raise errors of a line with file and line."""
    try:
        yield
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(str(part) for part in first["loc"])
        raise InvalidFile(f"{source}:{line}: is damaged: {f'{place}: ' if place else ''}{first['msg']}") from error
    except (OptdockError, ValueError, TypeError, zlib.error) as error:
        raise InvalidFile(f"{source}:{line}: is damaged: {error}") from error


class _Line(BaseModel):
    model_config = ConfigDict(strict=True, frozen=True, extra="forbid")


class _CostmapValues(_Line):
    rows: int
    columns: int
    resolution: float
    origin: list[float]
    cells: str

    def costmap(self) -> Costmap:
        """The grid."""
        if not 0 < self.rows * self.columns <= MAX_PIXELS:
            raise ValueError(f"costmap: must have 1..{MAX_PIXELS} cells, got {self.rows} x {self.columns}")
        packed = base64.b64decode(self.cells)
        cells = np.frombuffer(zlib.decompressobj().decompress(packed, self.rows * self.columns + 1), dtype=np.uint8)
        x, y = self.origin
        return Costmap(cells.reshape(self.rows, self.columns), self.resolution, (x, y))


class _Tolerances(_Line):
    along: float
    cross: float
    yaw: float


class _TaskLine(_Line):
    format: Literal["optdock-log/1"]
    task: Literal["dock", "undock"]
    problem: dict[str, JsonValue]
    tolerances: _Tolerances
    unknown_is_obstacle: bool
    costmap: _CostmapValues | None
    fingerprint: dict[str, str]
    settings: dict[str, JsonValue]
    controller: tuple[str, dict[str, JsonValue]]
    goal_checker: tuple[str, dict[str, JsonValue]]
    dock_type: tuple[str, dict[str, JsonValue]] | None = None
    last_command: tuple[float, float] | None = None

    def read(self) -> Task:
        """The task, if its problem is the one that the log was written for.

        Raises:
            InvalidValue: It is another one.
        """
        costmap = None if self.costmap is None else self.costmap.costmap()
        problem = problem_of(ScenarioDocument.model_validate(self.problem), costmap)
        dock = dataclasses.replace(problem.dock, tolerances=DockTolerances(**self.tolerances.model_dump()))
        problem = dataclasses.replace(problem, dock=dock, unknown_is_obstacle=self.unknown_is_obstacle)
        known = problem.fingerprint._asdict()
        others = [name for name, digest in self.fingerprint.items() if known.get(name) != digest]
        if others:
            raise InvalidValue(f"problem: another one than when the log was written: {', '.join(others)} differ")
        return Task(
            problem,
            ExecutorSettings(**self.settings),
            self.task,
            PluginChoice(*self.controller),
            PluginChoice(*self.goal_checker),
            None if self.dock_type is None else PluginChoice(*self.dock_type),
            None if self.last_command is None else Twist2(*self.last_command),
        )


class _CancelLine(_Line):
    cancel: Literal[True]


class _VerdictLine(_Line):
    verdict: tuple[bool, str, float]


class _PlannedValues(_Line):
    number: int
    outcome: str
    starts_at: float
    reason: str
    code: int
    start: tuple[float, float, float, float, float, float | None] | None = None
    start_relief: float = 0.0
    plan: dict[str, JsonValue] | None = None

    def read(self, source: str) -> Planned:
        """What planning gave; `source` is what the plan is called in messages.

        Raises:
            InvalidFile: The plan breaks its format.
            InvalidValue: It holds no path or no phases.
        """
        result = PlanResult(self.number, Outcome(self.outcome), None, self.starts_at, self.reason, self.code)
        if self.plan is None or self.start is None:
            return Planned(result)
        found = parse_plan(json.dumps(self.plan), source)
        if found.path is None or found.time_law is None:
            raise InvalidValue("plan: holds no path or no phases")
        x, y, yaw, speed, acceleration, curvature = self.start
        trajectory = Trajectory(found.path, found.time_law)
        start = MotionStart(Pose2(x, y, yaw), speed, acceleration, curvature)
        return Planned(result, trajectory, start, self.start_relief)


class _PlannedLine(_Line):
    planned: _PlannedValues


class _CycleLine(_Line):
    stamp: float
    pose: tuple[float, float, float] | None
    twist: tuple[float, float, float]
    command: tuple[float, float]
    state: str
    detections: list[tuple[float, float, float, float, float, float]] = []
    contact: bool | None = None
    costmap: _CostmapValues | None = None
    odometry: tuple[float, float, float, float] | None = None
    pose_stamp: float | None = None
    held: bool = False
    current: float | None = None
    events: list[tuple[float, str, str]] = []
    ending: tuple[str, str, int, float] | None = None

    def cycle(self, line: int, planned: tuple[Planned, ...], *, cancelled: bool) -> Cycle:
        """The control cycle in this line, with what came since the one before."""
        measurements = Measurements(
            self.stamp,
            None if self.pose is None else Pose2(*self.pose),
            Twist2(*self.twist),
            tuple(Detection(d[0], Pose2(d[1], d[2], d[3]), d[4], d[5]) for d in self.detections),
            self.contact,
            None if self.costmap is None else self.costmap.costmap(),
            None if self.odometry is None else OdometryPose(self.odometry[0], Pose2(*self.odometry[1:])),
            self.pose_stamp,
            self.held,
            self.current,
        )
        return Cycle(
            line,
            planned,
            cancelled,
            measurements,
            Twist2(*self.command),
            State(self.state),
            None if self.ending is None else Ending(EndingKind(self.ending[0]), *self.ending[1:]),
            tuple(Event(*event) for event in self.events),
        )


_LINE: TypeAdapter[_CycleLine | _CancelLine | _VerdictLine | _PlannedLine] = TypeAdapter(
    _CycleLine | _CancelLine | _VerdictLine | _PlannedLine
)
