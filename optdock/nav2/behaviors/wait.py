"""Wait: stand still for a while."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from optdock.deadline import Deadline
from optdock.errors import BehaviorException, InvalidValue
from optdock.nav2.behaviors.results import RUNNING, SUCCEEDED, WAIT, failed, stopped
from optdock.plugins.interfaces import Behavior, BehaviorResult, CostmapInfoType
from optdock.plugins.parameters import PluginParameters, parse_parameters

if TYPE_CHECKING:
    from collections.abc import Mapping

    from optdock.geometry.pose import Pose2, Twist2

__all__ = ["Wait", "WaitCommand"]


class WaitCommand(PluginParameters):
    """What to wait for."""

    time: float = Field(ge=0.0, description="how long [s]")


class Wait(Behavior):
    """Succeeds once the commanded `time` has passed on the context's clock; commands rest meanwhile.

    Codes: UNKNOWN 740 for a command that cannot be understood.
    """

    def __init__(self, **parameters: object) -> None:
        super().__init__(**parameters)
        self._running: Deadline | None = None

    @property
    def resource_info(self) -> CostmapInfoType:
        """Needs no costmap."""
        return CostmapInfoType.NONE

    def on_run(self, command: Mapping[str, object]) -> BehaviorResult:
        """Begin to wait; the command is a `WaitCommand`."""
        self._running = None
        try:
            parsed = parse_parameters(WaitCommand, command, "Wait")
        except InvalidValue as error:
            return failed(WAIT.invalid_input, str(error))
        self._running = Deadline(parsed.time, self.context.clock)
        return SUCCEEDED

    def on_cycle_update(self, pose: Pose2, velocity: Twist2) -> tuple[BehaviorResult, Twist2]:  # noqa: ARG002 - part of the interface
        """RUNNING until the time has passed.

        Raises:
            BehaviorException: `on_run` has not succeeded.
        """
        if self._running is None:
            raise BehaviorException("Wait: on_run must succeed before the cycles begin")
        return stopped(SUCCEEDED if self._running.passed() else RUNNING)
