"""Calibration of a robot, its sensors and its dock from a set of recordings."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.calibration.conformal_tube import conformal_tube
from optdock.calibration.detections import detection_quantities
from optdock.calibration.drive_response import drive_response
from optdock.calibration.localization import localization_errors, stored_dock
from optdock.calibration.motion_smoother import smoothed
from optdock.calibration.odometry import odometry_age, odometry_quantities, twist_window
from optdock.calibration.statistics import Quantity, unknown
from optdock.errors import InvalidValue

if TYPE_CHECKING:
    from collections.abc import Sequence

    from optdock.calibration.conformal_tube import DrivenTube
    from optdock.calibration.drive_response import DriveResponse
    from optdock.calibration.localization import LocalizationErrors
    from optdock.calibration.motion_smoother import RecordedMotion
    from optdock.calibration.recording import Recording

__all__ = ["Calibration", "calibrate"]

_SAME_DOCK = 0.01, 0.01  # [m], [rad]: stored docks that differ by less are the same
_BY_DETECTIONS = (
    ("scale of the distance", "1"),
    ("turn per metre", "rad/m"),
    ("scale of turns", "1"),
    ("detections late by", "s"),
    ("detection sigma, position, at range 0", "m"),
    ("detection sigma, yaw, at range 0", "rad"),
    ("wrong detections", "1"),
    ("blind distance", "m"),
    ("localization sigma, position", "m"),
    ("stored dock, x", "m"),
    ("stored dock, y", "m"),
    ("stored dock, yaw", "rad"),
)


class Calibration(NamedTuple):
    """Result of a calibration.

    Attributes:
        quantities: All quantities, in the order of the report.
        recordings: Recordings used.
        response: Drive response.
        motion: Smoothed motion; None if there are too few detections.
        localization: Errors of the localization; None if there are too few detections.
        tube: Tracking tube.
    """

    quantities: tuple[Quantity, ...]
    recordings: tuple[Recording, ...]
    response: DriveResponse
    motion: RecordedMotion | None
    localization: LocalizationErrors | None
    tube: DrivenTube

    def quantity(self, name: str) -> Quantity:
        """Return the quantity with this name in the report.

        Raises:
            InvalidValue: If there is no quantity of that name.
        """
        for one in self.quantities:
            if one.name == name:
                return one
        raise InvalidValue(f"calibration: no quantity is named {name!r}; see Calibration.quantities")


def calibrate(
    recordings: Sequence[Recording],
    deviations: Sequence[tuple[float, float]] = (),
    *,
    coverage: float = 0.99,
) -> Calibration:
    """Estimate all quantities, each with a 95 % confidence interval or the reason why it is unknown.

    Args:
        recordings: Drives of one robot at one dock.
        deviations: Largest lateral deviation [m] and largest heading deviation [rad] from the path in each docking.
        coverage: Probability that a further docking stays inside the tube.

    Raises:
        InvalidValue: If there is no recording, the coverage is not between 0 and 1, robots or docks differ, or a drive
            is given twice.
    """
    if not recordings:
        raise InvalidValue("calibrate: at least one recording is required")
    if not 0.0 < coverage < 1.0:
        raise InvalidValue(f"coverage: must be > 0 and < 1, got {coverage}")
    _check_robots(recordings)
    _check_docks(recordings)
    _check_drives(recordings)
    response = drive_response(recordings)
    motion = smoothed(recordings)
    robots = [one.robot for one in recordings if one.robot is not None]
    radius = robots[0].footprint.circumscribed_radius if robots else 0.0
    tube = conformal_tube(deviations, radius, coverage)
    quantities = [*response.quantities, twist_window(recordings), odometry_age(recordings)]
    localization = None
    if motion is None:
        quantities += [unknown(name, unit, "the dock was not detected often enough") for name, unit in _BY_DETECTIONS]
    else:
        localization = localization_errors(motion)
        width = max((one.track_width for one in recordings), default=0.0)
        quantities += [*odometry_quantities(motion, width), *detection_quantities(motion)]
        quantities += [*localization.quantities, *stored_dock(motion)]
    return Calibration((*quantities, *tube.quantities), tuple(recordings), response, motion, localization, tube)


def _check_robots(recordings: Sequence[Recording]) -> None:
    """Check that drive, outline and track width are the same; limits may differ between drives."""
    known = [(one.source, one.robot) for one in recordings if one.robot is not None]
    for source, robot in known[1:]:
        first, other = known[0]
        if robot.drive is not other.drive or not np.array_equal(robot.footprint.vertices, other.footprint.vertices):
            raise InvalidValue(f"{source}: its robot differs in drive or footprint from the robot of {first}")
        width, others = robot.limits.track_width, other.limits.track_width
        if width != others:
            raise InvalidValue(f"{source}: its robot has a track width of {width:g} m, not {others:g} m as in {first}")


def _check_docks(recordings: Sequence[Recording]) -> None:
    known = [(one.source, one.stored) for one in recordings if one.stored is not None]
    for source, stored in known[1:]:
        first, other = known[0]
        off = stored.in_frame_of(other)
        if math.hypot(off.x, off.y) > _SAME_DOCK[0] or abs(off.yaw) > _SAME_DOCK[1]:
            raise InvalidValue(
                f"{source}: its dock is stored at {stored.brief}, not at {other.brief} as in {first}; calibrate one "
                "dock at a time"
            )


def _check_drives(recordings: Sequence[Recording]) -> None:
    """Check that no drive is given twice; duplicates would make the intervals too narrow."""
    seen: dict[bytes, str] = {}
    for one in recordings:
        key = one.times.tobytes() + one.commands.tobytes() + one.twists.tobytes() + one.odometry.tobytes()
        if key in seen:
            raise InvalidValue(f"{one.source}: contains the same drive as {seen[key]}")
        seen[key] = one.source
