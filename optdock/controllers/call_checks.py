"""What every controller checks of its callers."""

from __future__ import annotations

import math
from numbers import Real
from typing import TYPE_CHECKING

from optdock.errors import ControllerInvalidPath, InvalidValue
from optdock.model.path import Path, may_be_one_frame
from optdock.model.trajectory import Trajectory
from optdock.verification import proven_for

if TYPE_CHECKING:
    from optdock.plugins.lifecycle import PluginContext

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


def checked_task(task: Path | Trajectory, context: PluginContext, owner: str) -> Path | Trajectory:
    """`task`, what a controller is to follow.

    It stands in the frame of the configured problem, as far as both are known: poses are measured there. A trajectory
    that was proven must have been proven for the problem that the controller is configured with. Its start may be
    another: a new plan in motion begins where the robot is. What has come since the plan belongs in `local_costmap`,
    which is looked at in every cycle; a controller keeps its state while it is configured anew for the next problem.

    Raises:
        ControllerInvalidPath: It is neither a path nor a trajectory, stands in another frame, or was certified for
            another problem.
    """
    if not isinstance(task, Path | Trajectory):
        raise ControllerInvalidPath(f"{owner}: can follow a Path or a Trajectory, got {type(task).__name__}")
    if context.problem is not None and not may_be_one_frame(task.frame, context.problem.frame):
        raise ControllerInvalidPath(
            f"{owner}: the path stands in frame {task.frame!r}, the configured problem in {context.problem.frame!r}; "
            f"transform one of them",
            where={"path": task.frame, "problem": context.problem.frame},
        )
    proven = proven_for(task) if isinstance(task, Trajectory) else None
    if proven is not None and context.problem is not None:
        differences = proven.differences(context.problem.fingerprint)
        others = [name for name in differences if name not in ("start", "frame")]  # frames: above
        if others:
            raise ControllerInvalidPath(
                f"{owner}: the trajectory was certified for another problem than the configured one: "
                f"{', '.join(others)} differ; configure the controller anew, or plan again",
                where={"differences": others},
            )
    return task
