"""BackUp and DriveOnHeading: straight motions with a collision check ahead."""

from __future__ import annotations

from typing import TYPE_CHECKING

from optdock.behaviors._collision import CollisionGate
from optdock.behaviors._deadline import Deadline
from optdock.behaviors._results import BACK_UP, DRIVE_ON_HEADING, SUCCEEDED, Codes, failed
from optdock.behaviors._straight import DriveCommand, DriveParameters, StraightMotion
from optdock.errors import BehaviorException, InvalidValue
from optdock.interfaces import Behavior, BehaviorResult, CostmapInfoType
from optdock.parameters import parse_parameters

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from optdock.geometry.pose import Pose2, Twist2
    from optdock.lifecycle import PluginContext

__all__ = ["BackUp", "DriveOnHeading"]


class DriveOnHeading(Behavior):
    """Drives `target` metres along the heading, forwards or (both negative) backwards, as Nav2's behavior.

    Codes: TIMEOUT 721, COLLISION_AHEAD 723, INVALID_INPUT 724, UNKNOWN 720.

    Args:
        **parameters: Fields of `DriveParameters`.
    """

    Parameters = DriveParameters
    parameters: DriveParameters

    def __init__(self, **parameters: object) -> None:
        super().__init__(**parameters)
        self._motion: StraightMotion | None = None

    @property
    def resource_info(self) -> CostmapInfoType:
        """Needs the local costmap."""
        return CostmapInfoType.LOCAL

    def on_run(self, command: Mapping[str, object]) -> BehaviorResult:
        """Begin; the command is a `DriveCommand` whose target and speed have the same sign."""
        self._motion, result = _begin(DRIVE_ON_HEADING, self.parameters, self.context, command, _same_sign)
        return result

    def on_cycle_update(self, pose: Pose2, velocity: Twist2) -> tuple[BehaviorResult, Twist2]:
        """One cycle.

        Raises:
            BehaviorException: `on_run` has not succeeded.
        """
        return _running(self._motion, "DriveOnHeading").cycle(pose, velocity)


class BackUp(Behavior):
    """Reverses by `target` metres; the signs of target and speed do not matter, as in Nav2.

    Codes: TIMEOUT 711, INVALID_INPUT 713, COLLISION_AHEAD 714, UNKNOWN 710.

    Args:
        **parameters: Fields of `DriveParameters`.
    """

    Parameters = DriveParameters
    parameters: DriveParameters

    def __init__(self, **parameters: object) -> None:
        super().__init__(**parameters)
        self._motion: StraightMotion | None = None

    @property
    def resource_info(self) -> CostmapInfoType:
        """Needs the local costmap."""
        return CostmapInfoType.LOCAL

    def on_run(self, command: Mapping[str, object]) -> BehaviorResult:
        """Begin; the command is a `DriveCommand`."""
        self._motion, result = _begin(BACK_UP, self.parameters, self.context, command, _backwards)
        return result

    def on_cycle_update(self, pose: Pose2, velocity: Twist2) -> tuple[BehaviorResult, Twist2]:
        """One cycle.

        Raises:
            BehaviorException: `on_run` has not succeeded.
        """
        return _running(self._motion, "BackUp").cycle(pose, velocity)


def _begin(
    codes: Codes,
    parameters: DriveParameters,
    context: PluginContext,
    command: Mapping[str, object],
    ruled: Callable[[DriveCommand], DriveCommand],
) -> tuple[StraightMotion | None, BehaviorResult]:
    try:
        parsed = ruled(parse_parameters(DriveCommand, command, context.name))
    except InvalidValue as error:
        return None, failed(codes.invalid_input, str(error))
    try:
        gate = None if parsed.disable_collision_checks else CollisionGate(context, parameters.clearance)
    except BehaviorException as error:
        return None, failed(codes.unknown, str(error))
    deadline = Deadline(context.clock, parsed.time_allowance)
    return StraightMotion(codes, parameters, parsed, deadline, gate), SUCCEEDED


def _same_sign(command: DriveCommand) -> DriveCommand:
    if not command.target * command.speed > 0.0:
        raise InvalidValue(
            f"DriveOnHeading: target and speed must have the same sign, not 0, got {command.target} and {command.speed}"
        )
    return command


def _backwards(command: DriveCommand) -> DriveCommand:
    if command.target == 0.0 or command.speed == 0.0:
        raise InvalidValue(f"BackUp: target and speed must not be 0, got {command.target} and {command.speed}")
    return command.model_copy(update={"target": -abs(command.target), "speed": -abs(command.speed)})


def _running(motion: StraightMotion | None, name: str) -> StraightMotion:
    if motion is None:
        raise BehaviorException(f"{name}: on_run must succeed before the cycles begin")
    return motion
