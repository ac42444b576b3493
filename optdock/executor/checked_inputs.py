"""Validation of inputs: invalid measurements are dropped, and invalid values of a dock type raise an error."""

from __future__ import annotations

import math
import numbers
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn

import numpy as np

from optdock.errors import PluginError
from optdock.geometry.pose import Pose2, Twist2
from optdock.model.costmap import Costmap
from optdock.model.measurements import Detection, Measurements, OdometryPose
from optdock.plugins.outcomes import Contact

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.model.measurements import AtDock
    from optdock.plugins.interfaces import DockType

__all__ = ["CheckedDockType", "Intake", "usable"]


class Intake(NamedTuple):
    """The valid part of a set of measurements.

    Attributes:
        measurements: Measurements with neutral values in place of invalid fields, and NaN in place of an invalid stamp.
        has_twist: Whether the body velocity is valid.
        faults: Event name and received value of each invalid field.
    """

    measurements: Measurements
    has_twist: bool
    faults: tuple[tuple[str, str], ...]


def usable(given: object) -> Intake:
    """Return the valid part of measurements; any object is accepted, including None."""
    if isinstance(given, Measurements) and _is_usual(given):
        return Intake(given, has_twist=True, faults=())
    if not isinstance(given, Measurements):
        return Intake(Measurements(math.nan, None), has_twist=False, faults=(_fault("measurements", given),))
    kept: dict[str, Any] = given._asdict()
    invalid = [name for name, (accepts, _) in _ACCEPTED.items() if not accepts(kept[name])]
    faults = [_fault(name, kept[name]) for name in invalid]
    kept |= {name: _ACCEPTED[name][1] for name in invalid}
    detections = tuple(one for one in kept["detections"] if _is_detection(one))
    faults += [_fault("detection", one) for one in kept["detections"] if not _is_detection(one)]
    if "pose_stamp" in invalid:
        kept["pose"] = None
    measurements = Measurements(**kept | {"detections": detections})
    return Intake(measurements, "twist" not in invalid, tuple(faults))


def _is_usual(given: Measurements) -> bool:
    """Whether all fields have exactly the usual types and finite values; the checks of single fields accept more."""
    stamp, current, odometry = given.pose_stamp, given.current, given.odometry
    return (
        type(given.stamp) is float
        and math.isfinite(given.stamp)
        and (stamp is None or (type(stamp) is float and math.isfinite(stamp)))
        and (current is None or (type(current) is float and math.isfinite(current)))
        and type(given.pose) in _POSES
        and type(given.twist) is Twist2
        and type(given.detections) is tuple
        and (not given.detections or all(map(_is_detection, given.detections)))
        and type(given.contact) in _SWITCHES
        and type(given.held) is bool
        and type(given.costmap) in _COSTMAPS
        and (odometry is None or _is_odometry(odometry))
    )


def _fault(name: str, value: object) -> tuple[str, str]:
    return f"{name.replace('_', ' ')} not used", f"got {value!r:.80}"


def _is_finite(value: object) -> bool:
    return type(value) is not bool and isinstance(value, numbers.Real) and math.isfinite(value)


def _is_odometry(value: object) -> bool:
    return isinstance(value, OdometryPose) and isinstance(value.pose, Pose2) and _is_finite(value.stamp)


def _is_detection(value: object) -> bool:
    if not (isinstance(value, Detection) and isinstance(value.pose, Pose2)):
        return False
    return all(_is_finite(one) for one in (value.stamp, value.position_sigma, value.yaw_sigma))


def _is_a(*kinds: type) -> Callable[[object], bool]:
    return lambda value: isinstance(value, kinds)


def _is_none_or(accepts: Callable[[object], bool]) -> Callable[[object], bool]:
    return lambda value: value is None or accepts(value)


_POSES, _SWITCHES, _COSTMAPS = (Pose2, type(None)), (bool, type(None)), (Costmap, type(None))
# For each field: the test of validity, and the neutral value that replaces an invalid value.
_ACCEPTED: dict[str, tuple[Callable[[object], bool], object]] = {
    "stamp": (_is_finite, math.nan),
    "pose": (_is_none_or(_is_a(Pose2)), None),
    "twist": (_is_a(Twist2), Twist2()),
    "detections": (_is_a(tuple, list), ()),
    "contact": (_is_none_or(_is_a(bool)), None),
    "costmap": (_is_none_or(_is_a(Costmap)), None),
    "odometry": (_is_none_or(_is_odometry), None),
    "pose_stamp": (_is_none_or(_is_finite), None),
    "held": (_is_a(bool), True),
    "current": (_is_none_or(_is_finite), None),
}


class CheckedDockType:
    """A dock type whose return values are validated; exceptions of the dock type are passed on.

    Raises:
        PluginError: In every method and property, if the returned value violates the contract of `DockType`.
    """

    def __init__(self, dock_type: DockType) -> None:
        self._dock_type = dock_type

    def contact(self, now: AtDock) -> Contact | None:
        """Return the validated result of `DockType.contact`."""
        found = self._dock_type.contact(now)
        return found if found is None or isinstance(found, Contact) else self._refuse("contact", "a Contact", found)

    @property
    def is_pressed_on(self) -> bool:
        """Validated value of `DockType.is_pressed_on`."""
        return self._checked_bool("is_pressed_on", self._dock_type.is_pressed_on)

    @property
    def waits_for_charge(self) -> bool:
        """Validated value of `DockType.waits_for_charge`."""
        return self._checked_bool("waits_for_charge", self._dock_type.waits_for_charge)

    def is_charging(self, measurements: Measurements) -> bool:
        """Return the validated result of `DockType.is_charging`."""
        return self._checked_bool("is_charging", self._dock_type.is_charging(measurements))

    def staging_poses(self, gear: float, distance: float) -> tuple[Pose2, ...]:
        """Return the validated result of `DockType.staging_poses`, at least one pose."""
        found = self._dock_type.staging_poses(gear, distance)
        if not (isinstance(found, Sequence) and found and all(isinstance(pose, Pose2) for pose in found)):
            self._refuse("staging_poses", "a sequence of at least one Pose2", found)
        return tuple(found)

    def detections(self, measurements: Measurements) -> tuple[Detection, ...]:
        """Return the validated result of `DockType.detections`."""
        found = self._dock_type.detections(measurements)
        if type(found) is tuple and found is measurements.detections:  # these are valid
            return found
        if not (isinstance(found, Sequence) and all(_is_detection(one) for one in found)):
            self._refuse("detections", "a sequence of Detection with finite numbers", found)
        return tuple(found)

    @property
    def back_out_distance(self) -> float:
        """Validated value of `DockType.back_out_distance` [m], which is finite and positive."""
        found = self._dock_type.back_out_distance
        if not (_is_finite(found) and found > 0.0):
            self._refuse("back_out_distance", "a finite number > 0", found)
        return float(found)

    def reset(self) -> None:
        """Call `DockType.reset`."""
        self._dock_type.reset()

    def _checked_bool(self, name: str, found: object) -> bool:
        return bool(found) if isinstance(found, bool | np.bool_) else self._refuse(name, "a bool", found)

    def _refuse(self, name: str, wanted: str, found: object) -> NoReturn:
        raise PluginError(f"{type(self._dock_type).__name__}.{name}: must be {wanted}, got {found!r:.80}")
