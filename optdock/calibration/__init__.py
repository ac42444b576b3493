"""Calibration of a robot, its sensors and its dock from recorded drives, with confidence intervals."""

from optdock.calibration.calibrate import Calibration, calibrate
from optdock.calibration.findings import as_text, as_yaml, written_values
from optdock.calibration.picture import save_calibration_picture
from optdock.calibration.recording import ReadFile, Recording, read_recording
from optdock.calibration.statistics import Quantity

__all__ = [
    "Calibration",
    "Quantity",
    "ReadFile",
    "Recording",
    "as_text",
    "as_yaml",
    "calibrate",
    "read_recording",
    "save_calibration_picture",
    "written_values",
]
