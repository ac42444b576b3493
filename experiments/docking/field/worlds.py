"""Named field worlds: a typical robot with all its imperfections, and worlds with one additional imperfection each."""

from __future__ import annotations

import dataclasses
import math

from experiments.docking.field.camera import Camera
from experiments.docking.field.drive import Drive
from experiments.docking.field.localization import Localization
from experiments.docking.field.odometry import Odometry
from experiments.docking.field.station import Station
from experiments.docking.field.world import FieldWorld
from optdock.geometry.pose import Pose2
from optdock.model.dock import DockDirection

__all__ = ["FIELD", "FIELD_WORLDS"]

FIELD = FieldWorld()
PUSHED = (0.03, math.radians(1.5))
# Calibrated wheels: over 0.4 m without detections, 1 % of one radius alone turns the robot by 0.6 degrees and more.
GOOD_WHEELS = Drive(radius_spread=0.002, track_spread=0.002, slip_rate=0.0)
# Executor settings for a robot that turns around without detections before it backs in.
CALIBRATED = {
    "odometry_yaw_sigma": 0.003,
    "odometry_straight_yaw_sigma": 0.003,
    "odometry_scale_sigma": 0.002,
    "odometry_drift_sigma": 0.004,
}
BLIND = Camera(near_loss=1.0)
AVERAGED = Odometry(window=0.2)

_VARIANTS: dict[str, dict[str, object]] = {
    "blind": {"drive": GOOD_WHEELS, "camera": BLIND},
    "blind, unequal wheels": {"drive": Drive(slip_rate=0.0), "camera": BLIND},
    "blind, slipping wheels": {"camera": BLIND},
    "averaged twist": {"odometry": AVERAGED},
    "averaged twist, no pose": {"odometry": dataclasses.replace(AVERAGED, tells_pose=False)},
    "averaged twist, blind": {"drive": GOOD_WHEELS, "camera": BLIND, "odometry": AVERAGED},
    "no odometry pose": {"odometry": Odometry(tells_pose=False)},
    "outliers": {"camera": Camera(outliers=0.2), "pushed": PUSHED},
    "pushed": {"pushed": PUSHED},
    "dead band": {"drive": Drive(dead_band=(0.03, 0.08))},
    "no signal": {"station": Station(has_switch=False)},
    "station in costmap": {"costmap": True},
    "second tag": {"camera": Camera(second_tag=0.1)},
    "arrival stamps": {"camera": Camera(stamped_on_arrival=True)},
    "localization lost": {"localization": Localization(lost_for=5.0)},
    "raw localization": {"localization": Localization(composed=False)},
    "backward": {"direction": DockDirection.BACKWARD},
    "backward, good wheels": {
        "direction": DockDirection.BACKWARD,
        "drive": GOOD_WHEELS,
        "executor_settings": CALIBRATED,
    },
    "rear camera": {"direction": DockDirection.BACKWARD, "camera": Camera(mount=Pose2(-0.25, 0.0, math.pi))},
}
FIELD_WORLDS: dict[str, FieldWorld] = {
    "field": FIELD,
    **{
        f"field, {name}": dataclasses.replace(FIELD, name=f"field, {name}", **changes)  # type: ignore[arg-type]
        for name, changes in _VARIANTS.items()
    },
}
"""Field worlds by name."""
