"""The log of a docking on the page: measured poses with their states, detections, and its scene."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.config import Scenario
from optdock.errors import InvalidFile
from optdock.executor.log import read_log
from optdock.reports.html.drive_chapters import detected_docks
from optdock.reports.shown_motion import thinned
from optdock.ui.scene_edits import EditedScene
from optdock.ui.scene_maps import inside

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray

__all__ = ["RecordedDocking", "recorded_docking"]

_MOST_POSES = 800


class RecordedDocking(NamedTuple):
    """A docking that was recorded.

    Attributes:
        scene: Scene of the task, with the first measured pose as start.
        times: Times since the first cycle, Shape (n,), at most 800 [s].
        poses: Measured poses, Shape (n, 3).
        states: State of the task at each of these times.
        detections: Detected docked poses in the frame of the scene, Shape (m, 3).
        ending: Outcome of the task in words.
    """

    scene: EditedScene
    times: FloatArray
    poses: FloatArray
    states: list[str]
    detections: FloatArray
    ending: str


def recorded_docking(source: str | Path, folder: str | Path) -> RecordedDocking:
    """Return the docking of a log.

    Args:
        source: The log.
        folder: Folder that must contain it.

    Raises:
        InvalidFile: If the file is no log, or contains no pose.
        InvalidValue: If the file is outside the folder.
    """
    log = read_log(inside(source, folder))
    posed = [cycle for cycle in log.cycles if cycle.measurements.pose is not None]
    if not posed:
        raise InvalidFile(f"{source}: contains no pose of the robot")
    every = log.commands[:, 0]
    times = np.array([t for t, cycle in zip(every, log.cycles, strict=True) if cycle.measurements.pose is not None])
    rows = thinned(times.size, _MOST_POSES)
    first = posed[0].measurements.pose
    assert first is not None
    problem, ending = log.task.problem.starting_at(first), log.cycles[-1].ending
    words = "the log ends before the task" if ending is None else f"{ending.kind.value}. {ending.reason}".rstrip(". ")
    return RecordedDocking(
        EditedScene(Scenario(problem, source=Path(source))),
        times[rows],
        log.measured[rows],
        [posed[row].state.value for row in rows.tolist()],
        detected_docks(log, every, log.measured),
        f"{log.task.task} in {times[-1]:.1f} s: {words}",
    )
