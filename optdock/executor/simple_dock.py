"""`SimpleDock`, the default dock type: contact by distance, switch, stall or current; staging on the axis."""

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

_COMMANDED = 2.0  # factor on the stall speed: slower commands may be within the dead band of the drive

_Number = Annotated[float, Strict()]


class SimpleDockParameters(PluginParameters):
    """Parameters of `SimpleDock`."""

    contact: Literal["distance", "touch"] = Field(
        default="distance",
        description="distance: docked by the goal checker; touch: docked by contact, for which the robot presses on",
    )
    stall_speed: float = Field(default=0.005, gt=0.0, description="odometry speed below which the robot stalls [m/s]")
    stall_time: float = Field(default=0.4, gt=0.0, description="duration of a stall that is contact [s]")
    wait_for_charge: bool = Field(default=False, description="docked only while the battery is charging")
    charging_current: float | None = Field(
        default=None,
        description="battery current above which the robot charges and is in contact [A]; None: by the external signal",
    )
    staging_distance: float | None = Field(
        default=None,
        gt=0.0,
        description="distance of the staging pose from the docked pose, on its axis [m]; None: from the executor",
    )
    staging_poses: tuple[tuple[_Number, _Number, _Number], ...] = Field(
        default=(),
        description="[[x, y, yaw], ...] relative to the docked pose, the preferred one first [m, m, rad]",
    )
    back_out_distance: float = Field(
        default=0.1, gt=0.0, description="largest straight distance out of contact before a path back is planned [m]"
    )

    @model_validator(mode="after")
    def _fits(self) -> SimpleDockParameters:
        if self.staging_poses and self.staging_distance is not None:
            raise ValueError("staging_poses and staging_distance exclude each other")
        return self


class SimpleDock(DockType):
    """Dock type that detects contact by the external signal, a charging current, and (with `contact: touch`) a stall.

    A stall is detected if, for at least `stall_time`, the commanded speed is above twice `stall_speed` and the odometry
    speed is below `stall_speed`.

    Args:
        **parameters: Fields of `SimpleDockParameters`.

    Raises:
        InvalidValue: If a parameter is unknown, of the wrong type or out of range.

    >>> SimpleDock(staging_distance=0.9).staging_poses(1.0, 0.7)
    (Pose2(x=-0.9, y=0.0, yaw=0.0),)
    """

    Parameters = SimpleDockParameters
    parameters: SimpleDockParameters

    def __init__(self, **parameters: object) -> None:
        super().__init__(**parameters)
        self._stalled_since: float | None = None

    def contact(self, now: AtDock) -> Contact | None:
        """Return a signal at any position, but a stall only near the dock; elsewhere, an obstacle may be its cause."""
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
        """Whether `contact` is `touch`."""
        return self.parameters.contact == "touch"

    @property
    def waits_for_charge(self) -> bool:
        """Value of the parameter `wait_for_charge`."""
        return self.parameters.wait_for_charge

    def is_charging(self, measurements: Measurements) -> bool:
        """Whether the current exceeds its threshold; without a threshold, whether the external signal is on."""
        if self.parameters.charging_current is None:
            return measurements.contact is True
        return self._is_charged(measurements)

    def staging_poses(self, gear: float, distance: float) -> Sequence[Pose2]:
        """Return the staging poses of the parameters, for both gears; without any, one pose on the axis of the dock."""
        p = self.parameters
        if p.staging_poses:
            return tuple(Pose2(*pose) for pose in p.staging_poses)
        return super().staging_poses(gear, distance if p.staging_distance is None else p.staging_distance)

    @property
    def back_out_distance(self) -> float:
        """Value of the parameter `back_out_distance` [m]."""
        return self.parameters.back_out_distance

    def reset(self) -> None:
        """Discard the beginning of a stall in progress."""
        self._stalled_since = None

    def _is_charged(self, measurements: Measurements) -> bool:
        threshold, current = self.parameters.charging_current, measurements.current
        return threshold is not None and current is not None and current > threshold

    def _is_stalled(self, now: AtDock) -> bool:
        slow = self.parameters.stall_speed
        return abs(now.commanded.linear) > _COMMANDED * slow and abs(now.measurements.twist.linear) < slow
