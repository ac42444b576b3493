"""Answer to a request for a simulated drive as plain arrays and texts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from optdock.errors import Cancelled, OptdockError
from optdock.geometry.arrays import FloatArray
from optdock.reports.report import run_rows
from optdock.reports.shown_motion import thinned
from optdock.samples.tube import Tube

if TYPE_CHECKING:
    from optdock.planning.plan import DockPlan
    from optdock.simulation import Run

__all__ = ["DrivenPlan", "driven_plan"]

_MOST_POSES = 800


@dataclass(eq=False)
class DrivenPlan:
    """Everything that the page shows of a simulated drive.

    Args:
        number: Number of the request.
        fingerprint: Fingerprint of the request.
        outcome: `docked`; `failed`: the robot did not dock, collided or left the proven region; `refused`: there is no
            plan to drive, or the simulation is impossible; `cancelled`.
        reason: Reason of an outcome other than `docked`; empty otherwise.
        rows: Summary, each a name and a value.
        times: Shape (n,), at most 800 [s].
        poses: True poses, Shape (n, 3).
        errors: True pose relative to the planned one: along, cross [m] and yaw [rad], Shape (n, 3).
    """

    number: int
    fingerprint: str
    outcome: Literal["docked", "failed", "refused", "cancelled"]
    reason: str
    rows: tuple[tuple[str, str], ...]
    times: FloatArray
    poses: FloatArray
    errors: FloatArray


def driven_plan(asked: tuple[int, str], result: tuple[Run, DockPlan, str] | OptdockError) -> DrivenPlan:
    """Return the content of the page for a drive.

    Args:
        asked: Number and fingerprint of the request.
        result: The run, its plan and the description of `beyond_proof`; or the error that ended the call.
    """
    if isinstance(result, OptdockError):
        none = np.zeros((0, 3))
        outcome: Literal["refused", "cancelled"] = "cancelled" if isinstance(result, Cancelled) else "refused"
        return DrivenPlan(*asked, outcome, f"{type(result).__name__}: {result}", (), np.zeros(0), none, none)
    run, plan, left = result
    deviations = Tube(plan.path, plan.problem, plan.certificate.start_relief).deviations(run.poses)
    faults = [*([run.fault] if run.fault else []), *([f"left the proven range: {left}"] if left else [])]
    summary = tuple((row.name, row.value) for row in run_rows(run, deviations, left))
    rows = thinned(run.times.size, _MOST_POSES)
    columns = run.times[rows], run.poses[rows], run.errors[rows]
    return DrivenPlan(*asked, "failed" if faults else "docked", " and ".join(faults), summary, *columns)
