"""What every controller checks of its callers."""

from __future__ import annotations

import math
from numbers import Real

from optdock.errors import ControllerInvalidPath, InvalidValue
from optdock.path import Path
from optdock.trajectory import Trajectory

__all__ = ["checked_speed_limit", "checked_task"]


def checked_speed_limit(limit: object, percentage: object, owner: str) -> float:
    """`limit`, in percent or m/s.

    Raises:
        InvalidValue: It is not a finite number >= 0, or `percentage` does not say which of the two it is.
    """
    if not isinstance(percentage, bool):
        raise InvalidValue(f"{owner}: percentage must be True (percent) or False (m/s), got {percentage!r}")
    if isinstance(limit, bool) or not isinstance(limit, Real) or not (math.isfinite(limit) and float(limit) >= 0.0):
        raise InvalidValue(f"{owner}: the speed limit must be finite and >= 0, got {limit!r}")
    return float(limit)


def checked_task(task: Path | Trajectory, owner: str) -> Path | Trajectory:
    """`task`, what a controller is to follow.

    Raises:
        ControllerInvalidPath: It is neither a path nor a trajectory.
    """
    if not isinstance(task, Path | Trajectory):
        raise ControllerInvalidPath(f"{owner}: can follow a Path or a Trajectory, got {type(task).__name__}")
    return task
