"""BackUp and DriveOnHeading: straight motions with a collision check ahead."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, ClassVar

from optdock.behaviors._collision import CollisionGate
from optdock.behaviors._results import BACK_UP, DRIVE_ON_HEADING, SUCCEEDED, Codes, failed
from optdock.behaviors._straight import DriveCommand, DriveParameters, StraightMotion
from optdock.deadline import Deadline
from optdock.errors import BehaviorException, InvalidValue
from optdock.interfaces import Behavior, BehaviorResult, CostmapInfoType
from optdock.parameters import parse_parameters

if TYPE_CHECKING:
    from collections.abc import Mapping

    from optdock.geometry.pose import Pose2, Twist2

__all__ = ["BackUp", "DriveOnHeading"]


class _StraightBehavior(Behavior, ABC):
    """What both have in common; a child says which commands it takes, and with which codes it fails."""

    Parameters = DriveParameters
    parameters: DriveParameters
    codes: ClassVar[Codes]

    def __init__(self, **parameters: object) -> None:
        super().__init__(**parameters)
        self._motion: StraightMotion | None = None

    @property
    def resource_info(self) -> CostmapInfoType:
        """Needs the local costmap."""
        return CostmapInfoType.LOCAL

    @abstractmethod
    def ruled(self, command: DriveCommand) -> DriveCommand:
        """The command as it will be driven.

        Raises:
            InvalidValue: It cannot be.
        """

    def on_run(self, command: Mapping[str, object]) -> BehaviorResult:
        """Begin; the command is a `DriveCommand`."""
        self._motion = None
        try:
            parsed = self.ruled(parse_parameters(DriveCommand, command, self.context.name))
        except InvalidValue as error:
            return failed(self.codes.invalid_input, str(error))
        try:
            gate = None if parsed.disable_collision_checks else self._gate()
        except BehaviorException as error:
            return failed(self.codes.unknown, str(error))
        deadline = Deadline.of_allowance(parsed.time_allowance, self.context.clock)
        self._motion = StraightMotion(self.codes, self.parameters, parsed, deadline, gate)
        return SUCCEEDED

    def on_cycle_update(self, pose: Pose2, velocity: Twist2) -> tuple[BehaviorResult, Twist2]:
        """One cycle.

        Raises:
            BehaviorException: `on_run` has not succeeded.
        """
        if self._motion is None:
            raise BehaviorException(f"{type(self).__name__}: on_run must succeed before the cycles begin")
        return self._motion.cycle(pose, velocity)

    def _gate(self) -> CollisionGate:
        return CollisionGate(self.context, self.parameters.clearance, self.resource_info)


class DriveOnHeading(_StraightBehavior):
    """Drives `target` metres along the heading, forwards or (both negative) backwards, as Nav2's behavior.

    Codes: TIMEOUT 721, COLLISION_AHEAD 723, INVALID_INPUT 724, UNKNOWN 720.

    Args:
        **parameters: Fields of `DriveParameters`.
    """

    codes = DRIVE_ON_HEADING

    def ruled(self, command: DriveCommand) -> DriveCommand:
        """Target and speed have the same sign, which is the direction of travel.

        Raises:
            InvalidValue: They have not, or one is 0.
        """
        if not command.target * command.speed > 0.0:
            raise InvalidValue(
                f"DriveOnHeading: target and speed must have the same sign, not 0, got {command.target} and "
                f"{command.speed}"
            )
        return command


class BackUp(_StraightBehavior):
    """Reverses by `target` metres; the signs of target and speed do not matter, as in Nav2.

    Codes: TIMEOUT 711, INVALID_INPUT 713, COLLISION_AHEAD 714, UNKNOWN 710.

    Args:
        **parameters: Fields of `DriveParameters`.
    """

    codes = BACK_UP

    def ruled(self, command: DriveCommand) -> DriveCommand:
        """Both made negative.

        Raises:
            InvalidValue: One is 0.
        """
        if command.target == 0.0 or command.speed == 0.0:
            raise InvalidValue(f"BackUp: target and speed must not be 0, got {command.target} and {command.speed}")
        return command.model_copy(update={"target": -abs(command.target), "speed": -abs(command.speed)})
