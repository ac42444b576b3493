"""Run files: simulated drives written by `optdock simulate`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from optdock.errors import InvalidFile
from optdock.io.guarded_file import MostBytes, parse_json, read_text
from optdock.io.quoting import shortened

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray

__all__ = ["RUN_FORMAT", "RunColumns", "load_run"]

RUN_FORMAT = "optdock-run/1"

_POSE, _TWIST = ("x", "y", "yaw"), ("speed", "yaw_rate")
_NAMES = (
    "t",
    *(f"{of}{part}" for of in ("", "measured_", "planned_") for part in _POSE),
    *(f"{of}{part}" for of in ("command_", "") for part in _TWIST),
)
_Column = list[Annotated[float, Field(ge=-1e9, le=1e9)]]


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
    """

    times: FloatArray
    poses: FloatArray
    measured: FloatArray
    planned: FloatArray
    commands: FloatArray
    twists: FloatArray
    docked: bool
    reason: str

    def __bool__(self) -> bool:
        return self.docked


class _RunModel(BaseModel):
    model_config = ConfigDict(strict=True, frozen=True, extra="ignore", allow_inf_nan=False)


class _RunDocument(_RunModel):
    format: Literal["optdock-run/1"]
    docked: bool
    reason: str = ""
    columns: dict[str, _Column]


def load_run(source: str | Path) -> RunColumns:
    """Read a run file.

    Raises:
        InvalidFile: If the file cannot be read, is not a run file, lacks a column, or its columns differ in length.
    """
    source = Path(source)
    try:
        document = _RunDocument.model_validate(parse_json(read_text(source, MostBytes.JSON)))
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
    return RunColumns(times, poses, measured, planned, commands, twists, document.docked, document.reason)
