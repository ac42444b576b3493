"""Run files: simulated drives written by `optdock simulate`."""

from __future__ import annotations

from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from optdock.errors import InvalidFile
from optdock.io.guarded_file import MostBytes, parse_json, read_text
from optdock.io.quoting import shortened

if TYPE_CHECKING:
    from collections.abc import Mapping

    from optdock.geometry.arrays import FloatArray

__all__ = ["RUN_FORMAT", "RunColumns", "load_run", "parse_run"]

RUN_FORMAT = "optdock-run/1"

_POSE, _TWIST = ("x", "y", "yaw"), ("speed", "yaw_rate")
_NAMES = (
    "t",
    *(f"{of}{part}" for of in ("", "measured_", "planned_") for part in _POSE),
    *(f"{of}{part}" for of in ("command_", "") for part in _TWIST),
)
_Value = Annotated[float, Field(ge=-1e9, le=1e9)]
_Column = list[_Value]


class RunColumns(NamedTuple):
    """A simulated drive: true, measured and planned poses, Shape (n, 3); commands and twists, Shape (n, 2).

    Attributes:
        times: Times in increasing order, Shape (n,) [s].
        poses: True poses [m, m, rad].
        measured: Poses measured for the controller.
        planned: Poses of the plan.
        commands: Commanded speed and yaw rate [m/s, rad/s].
        twists: Driven speed and yaw rate [m/s, rad/s].
        docked: Whether the robot docked.
        reason: Reason why the robot did not dock.
        collided: Whether the robot collided.
        goal_checkers: Verdicts of the goal checkers at the end, by name.
        final_error: Last pose relative to the goal: along, cross [m], yaw [rad]; None if the file does not state it.
        min_clearance: Smallest clearance of the true poses [m]; None without obstacles.
    """

    times: FloatArray
    poses: FloatArray
    measured: FloatArray
    planned: FloatArray
    commands: FloatArray
    twists: FloatArray
    docked: bool
    reason: str
    collided: bool = False
    goal_checkers: Mapping[str, bool] = MappingProxyType({})
    final_error: tuple[float, float, float] | None = None
    min_clearance: float | None = None

    def __bool__(self) -> bool:
        return self.docked


class _RunModel(BaseModel):
    model_config = ConfigDict(strict=True, frozen=True, extra="ignore", allow_inf_nan=False, defer_build=True)


class _FinalError(_RunModel):
    along: _Value
    cross: _Value
    yaw: _Value


class _RunDocument(_RunModel):
    format: Literal["optdock-run/1"]
    docked: bool
    reason: str = ""
    collided: bool = False
    goal_checkers: dict[str, bool] = {}
    final_error: _FinalError | None = None
    min_clearance: _Value | None = None
    columns: dict[str, _Column]


def load_run(source: str | Path) -> RunColumns:
    """Read a run file.

    Raises:
        InvalidFile: If the file cannot be read, is not a run file, lacks a column, or its columns differ in length.
    """
    return parse_run(read_text(Path(source), MostBytes.JSON), str(source))


def parse_run(text: str, source: str) -> RunColumns:
    """Parse the text of a run file.

    Args:
        text: Text of the file.
        source: Name of the file for messages.

    Raises:
        InvalidFile: If the text is not that of a run file, lacks a column, or its columns differ in length.
    """
    try:
        document = _RunDocument.model_validate(parse_json(text))
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = shortened(".".join(str(part) for part in first["loc"]))
        raise InvalidFile(f"{source}: {place}: {first['msg']}") from error
    except ValueError as error:
        raise InvalidFile(f"{source}: is not a run file: {shortened(str(error))}") from error
    columns, wanted = document.columns, len(document.columns.get("t", ()))
    for name in _NAMES:
        found = len(columns.get(name, ()))
        if not found or found != wanted:
            raise InvalidFile(
                f"{source}: columns.{name}: must have as many values as columns.t = {wanted}, got {found}"
            )
    times = np.array(columns["t"])
    if not np.all(np.diff(times) > 0.0):
        raise InvalidFile(f"{source}: columns.t: must increase strictly")
    poses, measured, planned = (
        np.column_stack([columns[f"{of}{part}"] for part in _POSE]) for of in ("", "measured_", "planned_")
    )
    commands, twists = (np.column_stack([columns[f"{of}{part}"] for part in _TWIST]) for of in ("command_", ""))
    final = document.final_error
    return RunColumns(
        times,
        poses,
        measured,
        planned,
        commands,
        twists,
        document.docked,
        document.reason,
        document.collided,
        document.goal_checkers,
        None if final is None else (final.along, final.cross, final.yaw),
        document.min_clearance,
    )
