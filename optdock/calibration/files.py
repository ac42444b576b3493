"""Recordings out of files: logs of dockings, simulated runs, recordings of ROS 2."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.calibration.recording import Recording, recording_of_log
from optdock.errors import InvalidFile, OptdockError
from optdock.io.guarded_file import MostBytes, read_text
from optdock.io.run_file import RUN_FORMAT, load_run

if TYPE_CHECKING:
    from optdock.executor.log import DockingLog
    from optdock.io.run_file import RunColumns

__all__ = ["ReadFile", "read_recording", "recording_of_run"]


class ReadFile(NamedTuple):
    """A recording, and how far its docking was off its path.

    Attributes:
        recording: The drive.
        deviation: Largest distance across the path [m] and largest turn off it [rad], driven again; None: no docking,
            one that has not ended or that drove along no path, or not driven again as it was.
    """

    recording: Recording
    deviation: tuple[float, float] | None


def read_recording(source: str | Path) -> ReadFile:
    """Read a log, a run file or a recording of ROS 2.

    Raises:
        InvalidFile: It cannot be read, is none of these, or is damaged.
        MissingExtra: A recording of ROS 2 needs the extra `bag`.
    """
    source = Path(source)
    if source.is_dir() or source.suffix in (".mcap", ".db3"):
        from optdock.calibration.bags import recording_of_bag

        return ReadFile(recording_of_bag(source), None)
    kind = _format_of(source)
    if kind == RUN_FORMAT:
        run = load_run(source)
        return ReadFile(recording_of_run(str(source), run), _deviation_of_run(run))
    from optdock.executor.log import LOG_FORMAT, read_log

    if kind != LOG_FORMAT:
        raise InvalidFile(
            f"{source}: must be a log ({LOG_FORMAT}), a run file ({RUN_FORMAT}) or a recording (.mcap, .db3)"
        )
    log = read_log(source)
    return ReadFile(recording_of_log(log), _deviation_of_log(log))


def recording_of_run(source: str, run: RunColumns) -> Recording:
    """The drive of a simulated run: its true motion stands for the odometry, its measured poses for localization."""
    return Recording(
        source,
        run.times,
        run.commands,
        run.twists,
        np.column_stack((run.times, run.poses)),
        run.twists,
        np.zeros(0),
        np.column_stack((run.times, run.measured)),
        np.zeros((0, 6)),
        None,
        float(run.times[-1]) if run.docked else None,
        None,
    )


def _deviation_of_run(run: RunColumns) -> tuple[float, float] | None:
    from optdock.geometry.pose import pose_errors

    if not run.docked:
        return None
    off = np.abs(pose_errors(run.poses, run.planned))
    return float(np.max(off[:, 1])), float(np.max(off[:, 2]))


def _deviation_of_log(log: DockingLog) -> tuple[float, float] | None:
    from optdock.executor.replay import replay

    if log.task.task != "dock" or log.cycles[-1].ending is None:
        return None
    try:
        again = replay(log)
    except OptdockError:  # of a plugin that is not installed here, or another version of it
        return None
    return again.off_path if again and again.off_path != (0.0, 0.0) else None


def _format_of(source: Path) -> str:
    """What a file says of its format in its first line, or as a whole; empty where it says nothing."""
    text = read_text(source, MostBytes.LOG)
    for part in (text.partition("\n")[0], text):
        try:
            found = json.loads(part)
        except ValueError:
            continue
        if isinstance(found, dict):
            return str(found.get("format", ""))
    return ""
