"""What was found, as text for people and as keys for files."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import yaml

from optdock.reports.report import table

if TYPE_CHECKING:
    from optdock.calibration.calibrate import Calibration
    from optdock.calibration.statistics import Quantity

__all__ = ["as_text", "as_yaml", "written_values"]

# What has no key is said in the report all the same: the operator can act on it.
_USES = {
    "detections late by": "the executor learns it; take it off the stamps in the detector's driver",
    "twist window": "hand in the odometry's poses (Measurements.odometry): a twist is late by half of it",
    "scale of the way": "the executor learns it; multiply the wheels' radii by 1 + it in the base",
    "dead band, left wheel": "the TrackingController tells such wheels more, bit by bit; its min_speed does so at once",
}
_LEAST = {"position_sigma": 0.001, "yaw_sigma": 0.001}  # [m], [rad]


def as_text(calibration: Calibration) -> str:
    """A table of all quantities, what the recordings cannot tell, and of which files."""
    rows = [("quantity", "estimate", "95 % interval", "unit", "samples", "recordings")]
    known = [one for one in calibration.quantities if one]
    rows += [
        (
            one.name,
            _number(one.value),
            f"{_number(one.low)} .. {_number(one.high)}",
            one.unit,
            str(one.samples),
            str(one.sources),
        )
        for one in known
    ]
    parts = [table(rows)] if known else []
    missing = [one for one in calibration.quantities if not one]
    if missing:
        parts.append("These recordings cannot tell:\n" + "\n".join(f"  {one.name}: {one.reason}" for one in missing))
    notes = [f"  {one.name}: {_USES[one.name]}" for one in known if one.name in _USES and _matters(one)]
    if notes:
        parts.append("Not zero, and no key of a file:\n" + "\n".join(notes))
    if calibration.tube.tube is not None:
        parts.append(f"{100 * calibration.tube.coverage:.1f} % of dockings stay inside the tube, or more.")
    parts.append("Recordings:\n" + "\n".join(f"  {one}" for one in _lines(calibration)))
    return "\n\n".join(parts)


def written_values(calibration: Calibration) -> dict[str, dict[str, object]]:
    """Keys of a scenario (`dock`, `robot`, `controller`) and of `ExecutorSettings` (`executor`), as far as found."""
    executor = _sigmas(calibration)
    values: dict[str, dict[str, object]] = {}
    x, y, yaw = (_found(calibration, f"stored dock, {part}") for part in ("x", "y", "yaw"))
    if x is not None and y is not None and yaw is not None:
        values["dock"] = {"pose": [_rounded(one.value) for one in (x, y, yaw)]}
        # How far from there it will seem to be: by what is uncertain of it, and by the localization of that day.
        place, turn = max(x.half_width, y.half_width) / 1.96, yaw.half_width / 1.96
        executor["stored_position_sigma"] = _rounded(math.hypot(place, _sigma(calibration, "position", 0.02)))
        executor["stored_yaw_sigma"] = _rounded(math.hypot(turn, _sigma(calibration, "yaw", 0.01)))
    tube = calibration.tube.tube
    if tube is not None:
        values["robot"] = {"tracking": {"cross": _rounded(tube.cross), "yaw": _rounded(tube.yaw)}}
    latency, lag = (_found(calibration, f"{part}, linear") for part in ("command latency", "drive lag"))
    if latency is not None and lag is not None:
        values["controller"] = {"plugin": "TrackingController", "preview": _rounded(latency.value + lag.value)}
    if executor:
        values["executor"] = executor
    return values


def _sigmas(calibration: Calibration) -> dict[str, object]:
    """Settings that need nothing but one quantity each.

    `odometry_sigma` is none of them: it is of wheels that do not slip, as the executor expects slip where it sees it,
    and without slip odometry is more exact than detections can tell.
    """
    executor: dict[str, object] = {}
    for key, name in _LEARNED.items():
        found = _found(calibration, name)
        if found is not None:  # of what is learned from 0 on: the value, and what is uncertain of it
            executor[key] = _rounded(math.hypot(found.value, found.half_width / 1.96))
    for key, name in _MEASURED.items():
        found = _found(calibration, name)
        if found is not None:
            executor[key] = _rounded(max(found.value, _LEAST[key]))
    blind = _found(calibration, "blind distance")
    if blind is not None and blind.low > 0.0:
        executor["detection_blind_distance"] = _rounded(blind.high)
    return executor


_LEARNED = {
    "odometry_scale_sigma": "scale of the way",
    "odometry_drift_sigma": "turn per metre",
    "detection_delay_sigma": "detections late by",
}
_MEASURED = {"position_sigma": "localization sigma, position", "yaw_sigma": "localization sigma, yaw"}


def as_yaml(calibration: Calibration) -> str:
    """`written_values` as YAML, with the recordings that they are of."""
    head = "".join(f"#   {line}\n" for line in _lines(calibration))
    body = yaml.safe_dump(written_values(calibration), sort_keys=False, default_flow_style=None)
    meaning = "# dock, robot and controller: keys of a scenario; executor: ExecutorSettings.\n"
    return f"# Made by optdock calibrate, of:\n{head}{meaning}{body}"


def _sigma(calibration: Calibration, name: str, otherwise: float) -> float:
    found = _found(calibration, f"localization sigma, {name}")
    return otherwise if found is None else found.value


def _found(calibration: Calibration, name: str) -> Quantity | None:
    return next((one for one in calibration.quantities if one.name == name and one), None)


def _matters(one: Quantity) -> bool:
    return one.low > 0.0 or one.high < 0.0


def _lines(calibration: Calibration) -> list[str]:
    return [
        f"{one.source}: {float(np.ptp(one.times)) if len(one.times) else 0.0:.1f} s, {len(one.detections)} detections, "
        f"{'not docked' if one.docked_at is None else 'docked'}"
        for one in calibration.recordings
    ]


def _rounded(value: float) -> float:
    return float(f"{value:.4g}")


def _number(value: float) -> str:
    return f"{value:.4f}"
