"""Docking logs, format `optdock-log/1`: one JSON value per line, written during the task and read back exactly.

The first line contains the task: the problem as a scenario, its costmap, settings and plugins. The next lines contain,
for every cycle, the results of planning, the measurements, the command and the events. A crash truncates at most the
last line.
"""

from __future__ import annotations

import base64
import dataclasses
import json
import zlib
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple, TextIO

import numpy as np
from pydantic import BaseModel, ConfigDict, JsonValue, TypeAdapter, ValidationError

from optdock.config.scenario import problem_of
from optdock.config.scenario_keys import ScenarioDocument
from optdock.config.writing import problem_document
from optdock.errors import InvalidFile, InvalidValue, OptdockError
from optdock.executor.executor_settings import ExecutorSettings
from optdock.executor.planning import MotionStart, Outcome, Planned, PlanResult, Verdict
from optdock.executor.task_states import Ending, EndingKind, Event, State
from optdock.geometry.pose import Pose2, Twist2
from optdock.io.guarded_file import MostBytes, check_json_size, read_text
from optdock.io.map_image import MAX_PIXELS
from optdock.io.plan_file import PlanFile, TrajectoryColumns, parse_plan
from optdock.model.costmap import Costmap
from optdock.model.dock import DockTolerances
from optdock.model.measurements import Detection, Measurements, OdometryPose
from optdock.model.trajectory import Trajectory
from optdock.plugins.registry import PluginChoice

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from optdock.executor.planning import DrivenMotion, Job, Planning
    from optdock.executor.task_states import Step
    from optdock.geometry.arrays import FloatArray
    from optdock.model.problem import DockingProblem
    from optdock.plugins.lifecycle import Plugin

__all__ = ["LOG_FORMAT", "Cycle", "DockingLog", "LogWriter", "LoggedPlanning", "Task", "plugin_choice", "read_log"]

LOG_FORMAT = "optdock-log/1"
_SPACING, _PERIOD = 0.2, 0.5  # [m], [s] of the samples of a plan, in addition to its exact curves and phases
_MOST_VALUES = 300_000  # JSON values of a line: a plan of 300 m has 20,000; this number of empty lists takes 150 MB


class Task(NamedTuple):
    """The task of a log; if there is no dock type, the settings describe the dock."""

    problem: DockingProblem
    settings: ExecutorSettings
    task: Literal["dock", "undock"]
    controller: PluginChoice
    goal_checker: PluginChoice
    dock_type: PluginChoice | None = None
    last_command: Twist2 | None = None


class Cycle(NamedTuple):
    """One control cycle of a log.

    Attributes:
        line: Line number in the file.
        planned: Results of planning in this cycle, in order.
        cancelled: Whether the task was cancelled before this cycle.
        measurements: Measurements.
        command: Command.
        state: State of the executor.
        ending: Ending of the task; None while it runs.
        events: Events.
    """

    line: int
    planned: tuple[Planned, ...]
    cancelled: bool
    measurements: Measurements
    command: Twist2
    state: State
    ending: Ending | None
    events: tuple[Event, ...]


@dataclass(frozen=True, eq=False)
class DockingLog:
    """A docking log that has been read from a file.

    Args:
        source: File name.
        task: The task.
        cycles: The control cycles.
        cut_off: Whether the last line was incomplete and omitted.
    """

    source: str
    task: Task
    cycles: tuple[Cycle, ...]
    cut_off: bool

    @property
    def measured(self) -> FloatArray:
        """Measured poses, Shape (n, 3)."""
        poses = [cycle.measurements.pose for cycle in self.cycles]
        return np.array([(pose.x, pose.y, pose.yaw) for pose in poses if pose is not None]).reshape(-1, 3)

    @property
    def commands(self) -> FloatArray:
        """Time since the first cycle, linear and angular velocity, Shape (n, 3) [s, m/s, rad/s]."""
        began = self.cycles[0].measurements.stamp if self.cycles else 0.0
        rows = [(c.measurements.stamp - began, c.command.linear, c.command.angular) for c in self.cycles]
        return np.array(rows).reshape(-1, 3)


class LogWriter(AbstractContextManager["LogWriter"]):
    """Context manager that writes a log line by line.

    Args:
        target: File to write; an existing file is replaced.
        flush: Whether to flush the file in every cycle, so that a crash of the program loses no cycle.

    Raises:
        InvalidFile: If the file cannot be written.

    Attributes:
        failure: Reason why writing has ended, such as a full disk; empty without a failure. The task continues after a
            failure.
    """

    def __init__(self, target: str | Path, *, flush: bool = True) -> None:
        self._target, self._flush = Path(target), flush
        self.failure = ""
        self._file: TextIO | None = None
        try:
            self._target.parent.mkdir(parents=True, exist_ok=True)
            self._file = self._target.open("w", encoding="utf-8")
        except OSError as error:
            raise InvalidFile(f"{target}: cannot be written: {error.strerror or error}") from error

    def __exit__(self, *_: object) -> None:
        """Close the file."""
        self.close()

    def begin(self, task: Task) -> None:
        """Write the first line."""
        problem, kind, last = task.problem, task.dock_type, task.last_command
        self._write(
            {
                "format": LOG_FORMAT,
                "task": task.task,
                "problem": problem_document(problem),
                "tolerances": dataclasses.asdict(problem.dock.tolerances),
                "unknown_is_obstacle": problem.unknown_is_obstacle,
                "costmap": _costmap_values(problem.costmap),
                "fingerprint": problem.fingerprint._asdict(),
                "settings": task.settings.model_dump(),
                "controller": [task.controller.name, dict(task.controller.parameters)],
                "goal_checker": [task.goal_checker.name, dict(task.goal_checker.parameters)],
                **({} if kind is None else {"dock_type": [kind.name, dict(kind.parameters)]}),
                **({} if last is None else {"last_command": [last.linear, last.angular]}),
            }
        )

    def cancel(self) -> None:
        """Record that the task is cancelled before the next cycle."""
        self._write({"cancel": True})

    def planned(self, result: PlanResult, frame: str) -> None:
        """Write a planning result that belongs to the next cycle."""
        value: dict[str, object] = {
            "number": result.number,
            "outcome": result.outcome.value,
            "starts_at": result.starts_at,
            "reason": result.reason,
            "code": result.code,
        }
        if result.motion is not None:
            value |= {"start": _start_values(result.motion.problem), "start_relief": result.motion.start_relief}
            value["plan"] = _plan_values(result.motion, frame)
        self._write({"planned": value})

    def verdict(self, verdict: Verdict) -> None:
        """Write a planning verdict that belongs to the next cycle."""
        self._write({"verdict": list(verdict)})

    def cycle(self, measurements: Measurements, step: Step) -> None:
        """Write one control cycle."""
        ending = step.ending
        value: dict[str, object] = {
            **_measured_values(measurements),
            "command": [step.command.linear, step.command.angular],
            "state": step.state.value,
        }
        if step.events:
            value["events"] = [list(event) for event in step.events]
        if ending is not None:
            value["ending"] = [ending.kind.value, ending.reason, ending.num_retries, ending.stamp]
        self._write(value)
        if self._flush and self._file is not None:
            self._file.flush()

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def _write(self, value: Mapping[str, object]) -> None:
        if self._file is None:
            return
        try:
            self._file.write(json.dumps(value) + "\n")
        except OSError as error:
            self.failure = f"{self._target}: cannot be written: {error.strerror or error}"
            with suppress(OSError):
                self._file.close()
            self._file = None


class LoggedPlanning:
    """Planning whose results are logged when they are polled."""

    def __init__(self, planning: Planning, log: LogWriter, frame: str) -> None:
        self._planning, self._log, self._frame = planning, log, frame

    def submit(self, job: Job) -> None:
        """Submit a job; see `Planning.submit`."""
        self._planning.submit(job)

    def poll(self, stamp: float) -> PlanResult | None:
        """Return and log the result of a job; see `Planning.poll`."""
        result = self._planning.poll(stamp)
        if result is not None:
            self._log.planned(result, self._frame)
        return result

    def still_holds(self, motion: DrivenMotion, costmap: Costmap, from_time: float) -> Verdict:
        """Return and log the verdict on a motion; see `Planning.still_holds`."""
        verdict = self._planning.still_holds(motion, costmap, from_time)
        self._log.verdict(verdict)
        return verdict

    def close(self) -> None:
        """Release all resources; see `Planning.close`."""
        self._planning.close()


def plugin_choice(plugin: Plugin) -> PluginChoice:
    """Return name and parameters of a plugin."""
    return PluginChoice(type(plugin).__name__, plugin.parameters.model_dump())


def _measured_values(m: Measurements) -> dict[str, object]:
    value: dict[str, object] = {
        "stamp": m.stamp,
        "pose": None if m.pose is None else [m.pose.x, m.pose.y, m.pose.yaw],
        "twist": [m.twist.linear, m.twist.angular, m.twist.lateral],
    }
    if m.detections:
        value["detections"] = [
            [d.stamp, d.pose.x, d.pose.y, d.pose.yaw, d.position_sigma, d.yaw_sigma] for d in m.detections
        ]
    if m.contact is not None:
        value["contact"] = m.contact
    if m.costmap is not None:
        value["costmap"] = _costmap_values(m.costmap)
    if m.odometry is not None:
        value["odometry"] = [m.odometry.stamp, m.odometry.pose.x, m.odometry.pose.y, m.odometry.pose.yaw]
    if m.pose_stamp is not None:
        value["pose_stamp"] = m.pose_stamp
    if m.held:
        value["held"] = True
    if m.current is not None:
        value["current"] = float(m.current)
    return value


def _costmap_values(costmap: Costmap | None) -> dict[str, object] | None:
    if costmap is None:
        return None
    cells = base64.b64encode(zlib.compress(costmap.data.tobytes())).decode("ascii")
    return {
        "rows": costmap.rows,
        "columns": costmap.columns,
        "resolution": costmap.resolution,
        "origin": list(costmap.origin),
        "cells": cells,
    }


def _start_values(problem: DockingProblem) -> list[float | None]:
    start = problem.start
    return [start.x, start.y, start.yaw, problem.start_speed, problem.start_acceleration, problem.start_curvature]


def _plan_values(motion: DrivenMotion, frame: str) -> object:
    trajectory = motion.trajectory
    found = PlanFile(
        status="planned",
        frame=frame,
        path=trajectory.path,
        trajectory=TrajectoryColumns.from_trajectory(trajectory, _PERIOD),
        time_law=trajectory.time_law,
    )
    return json.loads(found.as_json(spacing=_SPACING))


def read_log(source: str | Path) -> DockingLog:
    """Read a log; a last line that was truncated by a crash is omitted.

    Raises:
        InvalidFile: If the file cannot be read, is not a log, or is damaged; the message names file and line.
    """
    source = Path(source)
    lines = read_text(source, MostBytes.LOG).split("\n")
    cut_off = bool(lines.pop())  # the text after the last end of line
    if not lines:
        raise InvalidFile(f"{source}:1: is not a log: it has no complete line")
    with _errors_located(source, 1):
        check_json_size(lines[0], _MOST_VALUES)
        task = _TaskLine.model_validate_json(lines[0]).read()
    cycles = tuple(_cycles(source, lines))
    if not cycles:
        raise InvalidFile(f"{source}: contains no complete cycle")
    return DockingLog(str(source), task, cycles, cut_off)


def _cycles(source: Path, lines: list[str]) -> Iterator[Cycle]:
    planned: list[Planned] = []
    cancelled = False
    for number, text in enumerate(lines[1:], start=2):
        cycle: Cycle | None = None
        with _errors_located(source, number):
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
def _errors_located(source: Path, line: int) -> Iterator[None]:
    """Raise errors of a line as `InvalidFile`, with the file name and the line number."""
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
        """Return the task; raise InvalidValue if the fingerprint of its problem differs from the logged fingerprint."""
        costmap = None if self.costmap is None else self.costmap.costmap()
        problem = problem_of(ScenarioDocument.model_validate(self.problem), costmap)
        dock = dataclasses.replace(problem.dock, tolerances=DockTolerances(**self.tolerances.model_dump()))
        problem = dataclasses.replace(problem, dock=dock, unknown_is_obstacle=self.unknown_is_obstacle)
        known = problem.fingerprint._asdict()
        others = [name for name, digest in self.fingerprint.items() if known.get(name) != digest]
        if others:
            raise InvalidValue(f"problem: differs from the logged one: {', '.join(others)}")
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
        """Return the result of planning; raise InvalidValue if its plan has no path or no phases."""
        result = PlanResult(self.number, Outcome(self.outcome), None, self.starts_at, self.reason, self.code)
        if self.plan is None or self.start is None:
            return Planned(result)
        found = parse_plan(json.dumps(self.plan), source)
        if found.path is None or found.time_law is None:
            raise InvalidValue("plan: contains no path or no phases")
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
