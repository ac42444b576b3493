"""A dock type's answers, checked: what it returns steers a moving robot."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NoReturn

import numpy as np

from optdock.errors import PluginError
from optdock.executor.intake import is_detection, is_finite
from optdock.geometry.pose import Pose2
from optdock.plugins.outcomes import Contact

if TYPE_CHECKING:
    from optdock.model.measurements import AtDock, Detection, Measurements
    from optdock.plugins.interfaces import DockType

__all__ = ["CheckedDockType"]


class CheckedDockType:
    """Asks a dock type, and refuses answers that are not what `DockType` says; what it raises is passed on.

    Args:
        dock_type: Whom to ask.

    Raises:
        PluginError: From every method and property: the answer is of another kind; the message names it.
    """

    def __init__(self, dock_type: DockType) -> None:
        self._asked = dock_type

    def contact(self, now: AtDock) -> Contact | None:
        """`DockType.contact`."""
        found = self._asked.contact(now)
        return found if found is None or isinstance(found, Contact) else self._refuse("contact", "a Contact", found)

    @property
    def is_pressed_on(self) -> bool:
        """`DockType.is_pressed_on`."""
        return self._switch("is_pressed_on", self._asked.is_pressed_on)

    @property
    def waits_for_charge(self) -> bool:
        """`DockType.waits_for_charge`."""
        return self._switch("waits_for_charge", self._asked.waits_for_charge)

    def is_charging(self, measurements: Measurements) -> bool:
        """`DockType.is_charging`."""
        return self._switch("is_charging", self._asked.is_charging(measurements))

    def staging_poses(self, gear: float, distance: float) -> tuple[Pose2, ...]:
        """`DockType.staging_poses`; at least one."""
        found = self._asked.staging_poses(gear, distance)
        if not (isinstance(found, Sequence) and found and all(isinstance(pose, Pose2) for pose in found)):
            self._refuse("staging_poses", "a sequence of at least one Pose2", found)
        return tuple(found)

    def detections(self, measurements: Measurements) -> tuple[Detection, ...]:
        """`DockType.detections`."""
        found = self._asked.detections(measurements)
        if not (isinstance(found, Sequence) and all(is_detection(one) for one in found)):
            self._refuse("detections", "a sequence of Detection with finite numbers", found)
        return tuple(found)

    @property
    def back_out_distance(self) -> float:
        """`DockType.back_out_distance` [m]; finite and positive."""
        found = self._asked.back_out_distance
        if not (is_finite(found) and found > 0.0):
            self._refuse("back_out_distance", "a finite number > 0", found)
        return float(found)

    def reset(self) -> None:
        """`DockType.reset`."""
        self._asked.reset()

    def _switch(self, name: str, found: object) -> bool:
        return bool(found) if isinstance(found, bool | np.bool_) else self._refuse(name, "a bool", found)

    def _refuse(self, name: str, wanted: str, found: object) -> NoReturn:
        raise PluginError(f"{type(self._asked).__name__}.{name}: must be {wanted}, got {found!r:.80}")
