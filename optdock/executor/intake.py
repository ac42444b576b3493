"""Measurements as drivers send them: what is of no use is left out under a name, and never raises."""

from __future__ import annotations

import math
import numbers
from typing import TYPE_CHECKING, Any, NamedTuple

from optdock.geometry.pose import Pose2, Twist2
from optdock.model.costmap import Costmap
from optdock.model.measurements import Detection, Measurements, OdometryPose

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["Intake", "is_detection", "is_finite", "usable"]


class Intake(NamedTuple):
    """What can be used of a set of measurements.

    Attributes:
        measurements: With None, zero or nothing in the place of what cannot be used; the stamp is then NaN.
        has_twist: Whether there is a body velocity.
        faults: What was left out: names as of events, and what came instead.
    """

    measurements: Measurements
    has_twist: bool
    faults: tuple[tuple[str, str], ...]


def usable(given: object) -> Intake:
    """Leave out what is of the wrong kind or no finite number; anything may be given, None too."""
    if not isinstance(given, Measurements):
        return Intake(Measurements(math.nan, None), has_twist=False, faults=(_fault("measurements", given),))
    kept: dict[str, Any] = given._asdict()
    faults = [_fault(name, kept[name]) for name, (accepts, _) in _ACCEPTED.items() if not accepts(kept[name])]
    kept |= {name: instead for name, (accepts, instead) in _ACCEPTED.items() if not accepts(kept[name])}
    detections = tuple(one for one in kept["detections"] if is_detection(one))
    faults += [_fault("detection", one) for one in kept["detections"] if not is_detection(one)]
    if not _is_none_or(is_finite)(given.pose_stamp):
        kept["pose"] = None
    has_twist = isinstance(given.twist, Twist2)
    return Intake(Measurements(**kept | {"detections": detections}), has_twist, tuple(faults))


def _fault(name: str, value: object) -> tuple[str, str]:
    return f"{name.replace('_', ' ')} not used", f"got {value!r:.80}"


def is_finite(value: object) -> bool:
    """Whether a value is a finite number, and no switch."""
    return type(value) is not bool and isinstance(value, numbers.Real) and math.isfinite(value)


def _is_odometry(value: object) -> bool:
    return isinstance(value, OdometryPose) and isinstance(value.pose, Pose2) and is_finite(value.stamp)


def is_detection(value: object) -> bool:
    """Whether a value is a detection of finite numbers."""
    if not (isinstance(value, Detection) and isinstance(value.pose, Pose2)):
        return False
    return all(is_finite(one) for one in (value.stamp, value.position_sigma, value.yaw_sigma))


def _is_a(*kinds: type) -> Callable[[object], bool]:
    return lambda value: isinstance(value, kinds)


def _is_none_or(accepts: Callable[[object], bool]) -> Callable[[object], bool]:
    return lambda value: value is None or accepts(value)


# Of each field what is accepted, and what stands for anything else.
_ACCEPTED: dict[str, tuple[Callable[[object], bool], object]] = {
    "stamp": (is_finite, math.nan),
    "pose": (_is_none_or(_is_a(Pose2)), None),
    "twist": (_is_a(Twist2), Twist2()),
    "detections": (_is_a(tuple, list), ()),
    "contact": (_is_none_or(_is_a(bool)), None),
    "costmap": (_is_none_or(_is_a(Costmap)), None),
    "odometry": (_is_none_or(_is_odometry), None),
    "pose_stamp": (_is_none_or(is_finite), None),
    "held": (_is_a(bool), True),
    "current": (_is_none_or(is_finite), None),
}
