"""Calibration study: recordings of hidden robots, coverage of the intervals, paired fresh dockings."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from experiments.calibration.robots import hidden_robot, set_down
from experiments.calibration.truths import truths
from experiments.docking.field.methods import by_executor
from experiments.docking.field.outcome import FieldTask, field_outcome
from optdock.calibration import calibrate, read_recording, written_values
from optdock.executor import ExecutorSettings
from optdock.executor.log import LogWriter
from optdock.geometry.pose import Pose2
from optdock.plugins.registry import PluginChoice

if TYPE_CHECKING:
    from experiments.docking.field.outcome import FieldOutcome
    from optdock.calibration import Calibration, ReadFile

__all__ = ["RATE", "PairedDocking", "QuantityResult", "RobotResult", "RobotTask", "studied"]

RATE = 50.0  # [Hz]
_FRESH = 1000  # number of the first run that is not used for calibration


class RobotTask(NamedTuple):
    """Task of one robot: its number, number of recordings, number of fresh dockings, and directory of the logs."""

    number: int
    recordings: int
    fresh: int
    folder: str


class QuantityResult(NamedTuple):
    """One quantity of one robot: truth, estimate, interval, and the reason of a missing interval."""

    robot: int
    name: str
    truth: float
    value: float
    low: float
    high: float
    reason: str

    @property
    def inside(self) -> bool:
        """Whether the interval contains the truth."""
        return self.low <= self.truth <= self.high


class PairedDocking(NamedTuple):
    """A fresh docking of one robot, with the defaults and with the calibrated settings.

    Attributes:
        robot: Number of the robot.
        run: Number of the run, which determines start and noise.
        before: Outcome with the defaults.
        after: Outcome with the calibrated settings.
        deviation: Deviation from the path with the defaults, see `ReadFile`.
    """

    robot: int
    run: int
    before: FieldOutcome
    after: FieldOutcome
    deviation: tuple[float, float] | None

    @property
    def outcomes(self) -> tuple[tuple[str, FieldOutcome], tuple[str, FieldOutcome]]:
        """Both outcomes, by the names of their settings."""
        return ("defaults", self.before), ("calibrated", self.after)


class RobotResult(NamedTuple):
    """Result of one robot.

    Attributes:
        deviations: Deviations of its recordings, see `ReadFile`; recordings that could not be repeated are missing.
        judged: All quantities with known truth.
        pairs: Its fresh dockings.
    """

    deviations: list[tuple[float, float]]
    judged: list[QuantityResult]
    pairs: list[PairedDocking]


def studied(task: RobotTask) -> RobotResult:
    """Record missing runs, calibrate, compare with the truth, and run paired dockings."""
    hidden, read = hidden_robot(task.number), [_recorded(task, run) for run in range(task.recordings)]
    deviations = [one.deviation for one in read if one.deviation is not None]
    found = calibrate([one.recording for one in read], deviations)
    known = truths(hidden, RATE)
    judged = [
        QuantityResult(task.number, one.name, known[one.name], one.value, one.low, one.high, one.reason)
        for one in found.quantities
        if one.name in known
    ]
    return RobotResult(deviations, judged, [_paired(task, _FRESH + run, found) for run in range(task.fresh)])


def _recorded(task: RobotTask, run: int) -> ReadFile:
    file = Path(task.folder) / f"robot-{task.number:03d}-{run:02d}.jsonl"
    if not file.exists():
        layout, robot = set_down(hidden_robot(task.number), run)
        part = file.with_suffix(".part")
        with LogWriter(part) as log:
            by_executor(layout, robot, RATE, log=log)
        part.rename(file)
    return read_recording(file)


def _paired(task: RobotTask, run: int, found: Calibration) -> PairedDocking:
    file = Path(task.folder) / f"fresh-{task.number:03d}-{run:02d}.jsonl"
    with LogWriter(file) as log:
        before = _docked(task.number, run, None, log)
    after = _docked(task.number, run, found)
    return PairedDocking(task.number, run, before, after, read_recording(file).deviation)


def _docked(number: int, run: int, found: Calibration | None, log: LogWriter | None = None) -> FieldOutcome:
    """Run a fresh docking: with calibrated settings, or with the defaults and the stored dock."""
    layout, robot = set_down(hidden_robot(number), run)
    settings, controller = None, None
    if found is not None:
        values = written_values(found)
        settings = ExecutorSettings(**values.get("executor", {}))
        if "controller" in values:
            plugin, *parameters = values["controller"].items()
            controller = PluginChoice(str(plugin[1]), dict(parameters))
        problem = layout.problem
        if "dock" in values:
            pose = values["dock"]["pose"]
            assert isinstance(pose, list)
            problem = dataclasses.replace(problem, dock=dataclasses.replace(problem.dock, pose=Pose2(*pose)))
        if found.tube.tube is not None:
            problem = dataclasses.replace(problem, robot=dataclasses.replace(problem.robot, tracking=found.tube.tube))
        layout = layout._replace(problem=problem)
    steered = by_executor(layout, robot, RATE, controller=controller, settings=settings, log=log)
    task = FieldTask("executor", robot.world.name, "wider", RATE, run)
    return field_outcome(task, layout, robot, steered)
