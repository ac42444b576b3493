"""Report of a calibration as text, and its values under the keys of scenarios and settings."""

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

# Advice for quantities without a key in a file.
_USES = {
    "detections late by": "estimated by the executor; subtract it from the stamps in the detector's driver",
    "twist window": "use the odometry's poses (Measurements.odometry), as a twist is delayed by half of this window",
    "scale of the distance": "estimated by the executor; multiply the wheels' radii in the base by 1 + this value",
    "dead band, left wheel": "the TrackingController raises their commands gradually; min_speed does so at once",
}
_LEARNED = {
    "odometry_scale_sigma": "scale of the distance",
    "odometry_drift_sigma": "turn per metre",
    "detection_delay_sigma": "detections late by",
}
_MEASURED = {"position_sigma": "localization sigma, position", "yaw_sigma": "localization sigma, yaw"}
_LEAST_SIGMA = 0.001  # [m], [rad]


def as_text(calibration: Calibration) -> str:
    """Return a table of all known quantities, the reasons why others are unknown, advice and the recordings."""
    known = [one for one in calibration.quantities if one]
    missing = [one for one in calibration.quantities if not one]
    parts = []
    if known:
        rows = [("quantity", "estimate", "95 % interval", "unit", "samples", "recordings")]
        for one in known:
            interval = f"{one.low:.4f} .. {one.high:.4f}"
            rows.append((one.name, f"{one.value:.4f}", interval, one.unit, str(one.samples), str(one.sources)))
        parts.append(table(rows))
    if missing:
        parts.append("Unknown from these recordings:\n" + "\n".join(f"  {one.name}: {one.reason}" for one in missing))
    not_zero = [one for one in known if one.low > 0.0 or one.high < 0.0]
    notes = [f"  {one.name}: {_USES[one.name]}" for one in not_zero if one.name in _USES]
    if notes:
        parts.append("Significant values without a key in a file:\n" + "\n".join(notes))
    if calibration.tube.tube is not None:
        parts.append(f"{100 * calibration.tube.coverage:.1f} % of dockings or more stay inside the tube.")
    parts.append("Recordings:\n" + "\n".join(f"  {one}" for one in _recording_lines(calibration)))
    return "\n\n".join(parts)


def written_values(calibration: Calibration) -> dict[str, dict[str, object]]:
    """Return known values as keys of a scenario (`dock`, `robot`, `controller`) and `ExecutorSettings` (`executor`)."""
    known = {one.name: one for one in calibration.quantities if one}
    executor = _settings(known)
    values: dict[str, dict[str, object]] = {}
    dock = [known[name] for name in ("stored dock, x", "stored dock, y", "stored dock, yaw") if name in known]
    if len(dock) == 3:
        x, y, yaw = dock
        values["dock"] = {"pose": [_rounded(one.value) for one in dock]}
        # Uncertainty of the mean, and of the localization on another day.
        place, turn = max(x.half_width, y.half_width) / 1.96, yaw.half_width / 1.96
        position_sigma, yaw_sigma = (
            known[name].value if name in known else otherwise
            for name, otherwise in zip(_MEASURED.values(), (0.02, 0.01), strict=True)
        )
        executor["stored_position_sigma"] = _rounded(math.hypot(place, position_sigma))
        executor["stored_yaw_sigma"] = _rounded(math.hypot(turn, yaw_sigma))
    tube = calibration.tube.tube
    if tube is not None:
        values["robot"] = {"tracking": {"cross": _rounded(tube.cross), "yaw": _rounded(tube.yaw)}}
    delays = [known[name].value for name in ("command latency, linear", "drive lag, linear") if name in known]
    if len(delays) == 2:
        values["controller"] = {"plugin": "TrackingController", "preview": _rounded(sum(delays))}
    if executor:
        values["executor"] = executor
    return values


def _settings(known: dict[str, Quantity]) -> dict[str, object]:
    """Return the settings of the executor that depend on a single quantity.

    `odometry_sigma` is omitted. It applies to wheels without slip, because the executor models slip separately, and
    without slip the odometry is more accurate than the detections that would have to measure it.
    """
    executor: dict[str, object] = {}
    for key, name in _LEARNED.items():
        if name in known:  # the executor starts from 0: value and uncertainty together
            executor[key] = _rounded(math.hypot(known[name].value, known[name].half_width / 1.96))
    for key, name in _MEASURED.items():
        if name in known:
            executor[key] = _rounded(max(known[name].value, _LEAST_SIGMA))
    blind = known.get("blind distance")
    if blind is not None and blind.low > 0.0:
        executor["detection_blind_distance"] = _rounded(blind.high)
    return executor


def as_yaml(calibration: Calibration) -> str:
    """Return `written_values` as YAML, with the recordings in a comment."""
    head = "".join(f"#   {line}\n" for line in _recording_lines(calibration))
    body = yaml.safe_dump(written_values(calibration), sort_keys=False, default_flow_style=None)
    meaning = "# dock, robot and controller: keys of a scenario; executor: ExecutorSettings.\n"
    return f"# Made by optdock calibrate from:\n{head}{meaning}{body}"


def _recording_lines(calibration: Calibration) -> list[str]:
    return [
        f"{one.source}: {float(np.ptp(one.times)) if len(one.times) else 0.0:.1f} s, {len(one.detections)} detections, "
        f"{'not docked' if one.docked_at is None else 'docked'}"
        for one in calibration.recordings
    ]


def _rounded(value: float) -> float:
    return float(f"{value:.4g}")
