"""The near-optimal method: a realizable reference, ruckig moves along it, a check that decides, repair."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from pydantic import Field

from optdock.deadline import Deadline
from optdock.interfaces import TimeParameterizer
from optdock.parameters import PluginParameters
from optdock.timing.attempt import Settings
from optdock.timing.gears import time_path
from optdock.timing.moves import load_ruckig
from optdock.timing.reference import load_lapack
from optdock.timing.repair import plan_gear

if TYPE_CHECKING:
    from collections.abc import Iterator

    from optdock.interfaces import TimingResult
    from optdock.limits import MotionLimits, SpeedZone
    from optdock.path import Path
    from optdock.timing.allowance import Allowance
    from optdock.timing.course import Course
    from optdock.timing.motion import State
    from optdock.timing.start import GearPlan

__all__ = ["NearOptimal"]


class NearOptimalParameters(PluginParameters):
    """Parameters of `NearOptimal`."""

    step: float = Field(default=0.08, gt=0.01, le=0.5, description="knot spacing of the reference [s]")
    smooth: bool = Field(default=False, description="jerk that hardly changes between knots, instead of +-max_jerk")


class NearOptimal(TimeParameterizer):
    """Time laws within about 1 % of the jerk-limited optimum, in a few milliseconds."""

    Parameters = NearOptimalParameters
    parameters: NearOptimalParameters

    def on_configure(self) -> None:
        """Import what the first call would import.

        Raises:
            PluginError: The package ruckig is not installed.
        """
        load_ruckig()
        load_lapack()

    def parameterize(
        self,
        path: Path,
        limits: MotionLimits,
        zone: SpeedZone,
        *,
        start_speed: float = 0.0,
        start_acceleration: float = 0.0,
        max_time: float = math.inf,
    ) -> TimingResult:
        """See `TimeParameterizer.parameterize`.

        Raises:
            InvalidValue: The start state is not finite, or `max_time` is NaN.
            PluginError: The package ruckig is not installed.
        """
        deadline = Deadline(max_time)
        return time_path(path, limits, zone, (start_speed, start_acceleration), self._plan, deadline)

    def _plan(self, course: Course, start: State, allowance: Allowance) -> Iterator[GearPlan]:
        return plan_gear(course, start, Settings(self.parameters.step, self.parameters.smooth), allowance)
