"""`SimpleDock`: the kind of dock that most are: contact by distance, switch, stall or current, staged on the axis."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field, Strict, model_validator

from optdock.geometry.pose import Pose2
from optdock.plugins.interfaces import DockType
from optdock.plugins.outcomes import Contact
from optdock.plugins.parameters import PluginParameters

if TYPE_CHECKING:
    from collections.abc import Sequence

    from optdock.model.measurements import AtDock, Measurements

__all__ = ["SimpleDock", "SimpleDockParameters"]

_COMMANDED = 2.0  # times the speed of a stall: a slower command may be answered by no motion at all

_Number = Annotated[float, Strict()]


class SimpleDockParameters(PluginParameters):
    """Parameters of `SimpleDock`."""

    contact: Literal["distance", "touch"] = Field(
        default="distance",
        description="distance: docked where the goal checker says so; touch: the robot presses on until it is felt",
    )
    stall_speed: float = Field(default=0.005, gt=0.0, description="slower than this by odometry is standing [m/s]")
    stall_time: float = Field(default=0.4, gt=0.0, description="no motion against a command for so long is a stall [s]")
    wait_for_charge: bool = Field(default=False, description="docked is not enough: it must charge")
    charging_current: float | None = Field(
        default=None,
        description="a larger current into the battery charges, and is contact [A]; None: the external signal tells",
    )
    staging_distance: float | None = Field(
        default=None,
        gt=0.0,
        description="of the staging pose from the docked one, on its axis [m]; None: what the executor asks for",
    )
    staging_poses: tuple[tuple[_Number, _Number, _Number], ...] = Field(
        default=(),
        description="[[x, y, yaw], ...] seen from the docked pose, the preferred one first, instead [m, m, rad]",
    )
    back_out_distance: float = Field(
        default=0.1, gt=0.0, description="straight out of contact at most, before a way back is planned [m]"
    )

    @model_validator(mode="after")
    def _fits(self) -> SimpleDockParameters:
        if self.staging_poses and self.staging_distance is not None:
            raise ValueError("staging_poses and staging_distance exclude each other")
        return self


class SimpleDock(DockType):
    """Contact is felt by the external signal, by a charging current, and (with `contact: touch`) by a stall.

    A stall is a command of more than twice `stall_speed` that lasts for `stall_time` and moves the robot no faster
    than `stall_speed` by its odometry.

    Args:
        **parameters: Fields of `SimpleDockParameters`.

    Raises:
        InvalidValue: A parameter is unknown, of the wrong type or out of range.

    >>> SimpleDock(staging_distance=0.9).staging_poses(1.0, 0.7)
    (Pose2(x=-0.9, y=0.0, yaw=0.0),)
    """

    Parameters = SimpleDockParameters
    parameters: SimpleDockParameters

    def __init__(self, **parameters: object) -> None:
        super().__init__(**parameters)
        self._stalled_since: float | None = None

    def contact(self, now: AtDock) -> Contact | None:
        """A signal wherever the robot is; a stall only near the dock, for other things stop robots elsewhere."""
        p = self.parameters
        if not self._is_stalled(now):
            self._stalled_since = None
        elif self._stalled_since is None:
            self._stalled_since = now.stamp
        if now.measurements.contact is True or self._is_charged(now.measurements):
            return Contact.SIGNAL
        lasts = self._stalled_since is not None and now.stamp - self._stalled_since >= p.stall_time
        return Contact.STALL if p.contact == "touch" and lasts and now.is_near else None

    @property
    def is_pressed_on(self) -> bool:
        """With `contact: touch`."""
        return self.parameters.contact == "touch"

    @property
    def waits_for_charge(self) -> bool:
        """As the parameter says."""
        return self.parameters.wait_for_charge

    def is_charging(self, measurements: Measurements) -> bool:
        """By the current where one is given, else by the external signal."""
        if self.parameters.charging_current is None:
            return measurements.contact is True
        return self._is_charged(measurements)

    def staging_poses(self, gear: float, distance: float) -> Sequence[Pose2]:
        """Those of the parameters, whatever the gear; else one on the axis of the dock."""
        p = self.parameters
        if p.staging_poses:
            return tuple(Pose2(*pose) for pose in p.staging_poses)
        return super().staging_poses(gear, distance if p.staging_distance is None else p.staging_distance)

    @property
    def back_out_distance(self) -> float:
        """As the parameter says."""
        return self.parameters.back_out_distance

    def reset(self) -> None:
        """Forget since when the robot stalls."""
        self._stalled_since = None

    def _is_charged(self, measurements: Measurements) -> bool:
        threshold, current = self.parameters.charging_current, measurements.current
        return threshold is not None and current is not None and current > threshold

    def _is_stalled(self, now: AtDock) -> bool:
        slow = self.parameters.stall_speed
        return abs(now.commanded.linear) > _COMMANDED * slow and abs(now.measurements.twist.linear) < slow
