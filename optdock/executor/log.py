"""Docking logs, format `optdock-log/1`: one JSON value per line, written as it happens.

The first line says what was asked for: the problem in the words of a scenario file, its costmap, the settings, the
plugins. Then, for every cycle, what planning delivered in it, and what was measured, commanded and said. Numbers read
back as they were, to the last bit. A crash leaves at most the last line cut off.
"""

from __future__ import annotations

import base64
import dataclasses
import json
import zlib
from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple, TextIO

import numpy as np

from optdock.config.writing import problem_document
from optdock.errors import InvalidFile, InvalidValue
from optdock.executor.executor_settings import ExecutorSettings
from optdock.executor.planning import DrivenMotion, PlanResult, Verdict
from optdock.executor.task_states import Ending, Event, State
from optdock.geometry.pose import Pose2, Twist2
from optdock.io.plan_file import PlanFile, TrajectoryColumns
from optdock.model.costmap import Costmap
from optdock.model.measurements import Measurements
from optdock.model.trajectory import Trajectory
from optdock.plugins.registry import PluginChoice

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from types import TracebackType

    from optdock.executor.planning import Job, Planning
    from optdock.executor.task_states import Step
    from optdock.geometry.arrays import FloatArray
    from optdock.model.problem import DockingProblem
    from optdock.plugins.lifecycle import Plugin

__all__ = [
    "LOG_FORMAT",
    "Cycle",
    "DockingLog",
    "LogWriter",
    "LoggedPlanning",
    "MotionStart",
    "Planned",
    "RecordedPlanning",
    "Task",
    "plugin_choice",
]

LOG_FORMAT = "optdock-log/1"
_SPACING, _PERIOD = 0.2, 0.5  # [m], [s] of the samples of a plan: the exact curves and phases stand beside them
# JSON values of a line; a plan of 300 m has twenty thousand, and of so many empty lists 150 MB are taken.


class Task(NamedTuple):
    """What was asked for, as the first line of a log says it; without a dock type the settings describe it."""

    problem: DockingProblem
    settings: ExecutorSettings
    task: Literal["dock", "undock"]
    controller: PluginChoice
    goal_checker: PluginChoice
    dock_type: PluginChoice | None = None
    last_command: Twist2 | None = None


class MotionStart(NamedTuple):
    """Where a planned motion begins: pose, speed and acceleration along the heading, and curvature, None where free."""

    pose: Pose2
    speed: float
    acceleration: float
    curvature: float | None


class Planned(NamedTuple):
    """What planning delivered, as far as a replay needs it.

    Attributes:
        result: Of a job; its motion's problem is filled in by the sender of the job.
        trajectory: Of the motion; None where there is none.
        start: Of the motion's problem.
        start_relief: Of the motion.
        verdict: The answer to a question, instead of a result.
    """

    result: PlanResult | None = None
    trajectory: Trajectory | None = None
    start: MotionStart | None = None
    start_relief: float = 0.0
    verdict: Verdict | None = None


class Cycle(NamedTuple):
    """One control cycle.

    Attributes:
        line: Where it stands in the file.
        planned: What planning delivered in it, in this order.
        cancelled: Whether the task was cancelled before it.
        measurements: What went in.
        command: What came out.
        state: What the executor was doing.
        ending: How the task ended; None while it went on.
        events: What happened.
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
    """A log that has been read.

    Args:
        source: The file.
        task: What was asked for.
        cycles: What happened.
        cut_off: Whether the last line was left out because it is not whole.
    """

    source: str
    task: Task
    cycles: tuple[Cycle, ...]
    cut_off: bool

    @property
    def measured(self) -> FloatArray:
        """Poses as measured, Shape (n, 3)."""
        poses = [cycle.measurements.pose for cycle in self.cycles]
        return np.array([(pose.x, pose.y, pose.yaw) for pose in poses if pose is not None]).reshape(-1, 3)

    @property
    def commands(self) -> FloatArray:
        """Time since the first cycle, linear and angular, Shape (n, 3) [s, m/s, rad/s]."""
        began = self.cycles[0].measurements.stamp if self.cycles else 0.0
        rows = [(c.measurements.stamp - began, c.command.linear, c.command.angular) for c in self.cycles]
        return np.array(rows).reshape(-1, 3)


class LogWriter:
    """Writes a log, line by line; use it as a context, or close it.

    Args:
        target: The file; one that exists is replaced.
        flush: Hand every cycle to the operating system at once, so that a crash of the program loses none.

    Raises:
        InvalidFile: The file cannot be written.

    Attributes:
        failure: Why nothing is written any more; empty while all is well. A full disk must not stop a robot.
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

    def __enter__(self) -> LogWriter:
        """The log itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close it."""
        self.close()

    def begin(self, task: Task) -> None:
        """The first line."""
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
        """The task is cancelled before the next cycle."""
        self._write({"cancel": True})

    def planned(self, result: PlanResult, frame: str) -> None:
        """What planning delivers in the cycle that is written next."""
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
        """What planning answers in the cycle that is written next."""
        self._write({"verdict": list(verdict)})

    def cycle(self, measurements: Measurements, step: Step) -> None:
        """One control cycle."""
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
        """Nothing more will be written."""
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
    """Planning whose results are written down as they are delivered.

    Args:
        planning: Does the work.
        log: Where.
        frame: Name of the coordinate frame.
    """

    def __init__(self, planning: Planning, log: LogWriter, frame: str) -> None:
        self._planning, self._log, self._frame = planning, log, frame

    def submit(self, job: Job) -> None:
        """As the planning."""
        self._planning.submit(job)

    def poll(self, stamp: float) -> PlanResult | None:
        """As the planning."""
        result = self._planning.poll(stamp)
        if result is not None:
            self._log.planned(result, self._frame)
        return result

    def still_holds(self, motion: DrivenMotion, costmap: Costmap, from_time: float) -> Verdict:
        """As the planning."""
        verdict = self._planning.still_holds(motion, costmap, from_time)
        self._log.verdict(verdict)
        return verdict

    def close(self) -> None:
        """As the planning."""
        self._planning.close()


class RecordedPlanning:
    """Planning out of a log: everything is delivered in the cycle in which it was; nothing of it is proven."""

    def __init__(self) -> None:
        self._results: deque[Planned] = deque()
        self._verdicts: deque[Verdict] = deque()
        self._job: Job | None = None

    def deliver(self, planned: Iterable[Planned]) -> None:
        """Deliver what the coming cycle polls."""
        self._results.clear()
        self._verdicts.clear()
        for one in planned:
            if one.verdict is not None:
                self._verdicts.append(one.verdict)
            else:
                self._results.append(one)

    def submit(self, job: Job) -> None:
        """Nothing is planned; the log knows the result."""
        self._job = job

    def poll(self, stamp: float) -> PlanResult | None:  # noqa: ARG002 - part of the interface
        """What was delivered in this cycle."""
        if not self._results:
            return None
        found = self._results.popleft()
        assert found.result is not None
        if found.trajectory is None or self._job is None:
            return found.result
        return found.result._replace(
            motion=DrivenMotion(found.trajectory, self._problem(found, self._job), None, found.start_relief)
        )

    def still_holds(self, motion: DrivenMotion, costmap: Costmap, from_time: float) -> Verdict:  # noqa: ARG002 - interface
        """What was answered in this cycle.

        Raises:
            InvalidValue: Nothing was: the replay does something else than what was recorded.
        """
        if not self._verdicts:
            raise InvalidValue("replay: asks what was not asked when the log was written")
        return self._verdicts.popleft()

    def close(self) -> None:
        """Nothing to do."""

    @staticmethod
    def _problem(found: Planned, job: Job) -> DockingProblem:
        start = found.start
        assert start is not None
        return dataclasses.replace(
            job.problem,
            start=start.pose,
            start_speed=start.speed,
            start_acceleration=start.acceleration,
            start_curvature=start.curvature,
        )


def plugin_choice(plugin: Plugin) -> PluginChoice:
    """A plugin by name and parameters."""
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
