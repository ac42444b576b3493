"""The measurements of the newest messages, and the rejected ones."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from optdock_ros.measuring import MeasurementRules, Measuring

from optdock.geometry.pose import Pose2, Twist2
from optdock.model.costmap import Costmap
from optdock.model.measurements import Detection
from optdock.ros.transforms import Transform, TransformError

RULES = MeasurementRules("odom", "base_link", 0.1, 0.3, 1.0, 1.0)


class Frames:
    """A robot that moves along the x axis at 0.2 m/s from 100 s, with transforms until `newest`, and a camera."""

    newest = 100.0
    tilted = False

    def lookup(self, target: str, source: str, stamp: float | None = None, tolerance: float = 0.0) -> Transform:
        """As `TransformBuffer.lookup`."""
        assert tolerance == 0.0
        if source == "camera":
            return Transform(target, source, stamp or 0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
        at = self.newest if stamp is None else stamp
        if at > self.newest:
            raise TransformError("in the future")
        rotation = (0.5, 0.5, 0.5, 0.5) if self.tilted else (0.0, 0.0, 0.0, 1.0)
        x = 0.2 * (at - 100.0)
        return Transform(target, source, at, (-x if target == "base_link" else x, 0.0, 0.0), rotation)


def stamp(seconds: float) -> Time:
    """Return a time message."""
    return Time(sec=int(seconds), nanosec=round(1e9 * (seconds - int(seconds))))


def odometry(at: float, speed: float = 0.2) -> Odometry:
    """Return a message with the robot's velocity."""
    message = Odometry(child_frame_id="base_link")
    message.header.frame_id, message.header.stamp = "odom", stamp(at)
    message.pose.pose.position.x = 0.2 * (at - 100.0)
    message.pose.pose.orientation.w = 1.0
    message.twist.twist.linear.x = speed
    return message


def detected(at: float, frame: str = "camera") -> PoseStamped:
    """Return a detection of the dock."""
    message = PoseStamped()
    message.header.frame_id, message.header.stamp = frame, stamp(at)
    return message


def measuring(frames: Frames, rules: MeasurementRules = RULES) -> Measuring:
    """Return measurements whose detections are at the origin of their frame."""

    def detect(message: Any, base: Transform) -> Detection:
        seconds = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        return Detection(seconds, Pose2(base.translation[0], 0.0, 0.0), 0.001, 0.001)

    return Measuring(rules, frames, detect, lambda _: None)


def test_pose_and_odometry_have_their_stamps() -> None:
    frames = Frames()
    told = measuring(frames)
    for k in range(6):
        told.take_odometry(odometry(100.0 + 0.02 * k))
    found = told.measurements(100.1)
    assert (found.pose, found.pose_stamp) == (Pose2(0.0, 0.0, 0.0), 100.0)
    assert found.odometry is not None
    assert found.odometry.stamp == pytest.approx(100.1)
    assert found.odometry.pose.x == pytest.approx(0.02)
    assert found.twist == Twist2(0.2)
    assert set(told.faults) == {"costmap"}
    found = told.measurements(100.12)
    assert (found.pose, found.pose_stamp) == (None, None), "the same transform says nothing new"
    frames.newest = 100.12
    found = told.measurements(100.14)
    assert found.pose is not None
    assert found.pose.x == pytest.approx(0.024, abs=1e-6)
    assert found.pose_stamp == 100.12


def test_contact_and_current_are_those_of_the_time() -> None:
    told = Measuring(RULES, Frames(), None, contact=lambda now: now > 100.0, current=lambda now: 0.01 * now)
    assert [told.measurements(now).contact for now in (99.0, 101.0)] == [False, True]
    assert told.measurements(102.0).current == pytest.approx(1.02)
    assert measuring(Frames()).measurements(100.0).current is None


def test_odometry_of_another_frame_is_transformed_to_the_base() -> None:
    told = measuring(Frames())
    message = odometry(100.0)
    message.child_frame_id = "camera"
    message.pose.pose.position.x = 3.0
    told.take_odometry(message)
    found = told.measurements(100.0).odometry
    assert found is not None
    assert found.pose == Pose2(3.0, 0.0, 0.0)


def test_old_tilted_and_future_poses_are_rejected() -> None:
    frames = Frames()
    told = measuring(frames)
    told.take_odometry(odometry(100.05))
    assert told.measurements(100.05).pose is not None
    for newest, tilted in ((99.9, False), (100.3, False), (100.06, True)):
        frames.newest, frames.tilted = newest, tilted
        told.take_odometry(odometry(100.06))
        assert told.measurements(100.07).pose is None
        assert "transform" in told.faults


def test_a_robot_that_stands_begins_at_rest() -> None:
    told = measuring(Frames())
    told.take_odometry(odometry(100.0, 0.004))
    assert told.measurements(100.0).twist == Twist2()
    assert told.measurements(100.02).twist == Twist2(0.004)


def test_old_velocity_and_its_pose_are_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    frames = Frames()
    told = measuring(frames)
    assert told.measurements(100.0).pose is None, "none has come"
    told.take_odometry(odometry(100.0))
    frames.newest = 100.2
    found = told.measurements(100.2)
    assert (found.twist, found.pose) == (Twist2(0.2), None), "held, but no new pose is made of it"
    frames.newest = 100.4
    found = told.measurements(100.4)
    assert (found.twist, found.pose) == (Twist2(0.2), None), "heard just now: a clock that was set lets no command fall"
    assert "0.40 s old" in told.faults["odometry"]
    later = time.monotonic() + 0.4
    monkeypatch.setattr("optdock_ros.measuring.monotonic", lambda: later)
    told.take_odometry(odometry(100.4, math.nan))
    assert told.measurements(100.4).twist == Twist2()


@pytest.mark.parametrize("speed", [math.nan, math.inf])
def test_velocity_that_is_not_finite_is_rejected(speed: float) -> None:
    told = measuring(Frames())
    told.take_odometry(odometry(100.0))
    told.take_odometry(odometry(100.02, speed))
    assert told.measurements(100.03).twist == Twist2(0.2)
    assert "twist.twist" in told.faults["odometry"]


def test_future_and_duplicate_velocities_are_rejected() -> None:
    told = measuring(Frames())
    for at, speed in ((100.0, 0.2), (100.0, 0.9), (99.9, 0.9), (200.0, 0.9)):
        told.take_odometry(odometry(at, speed))
    assert told.measurements(100.02).twist == Twist2(0.2)
    assert "ahead of this clock" in told.faults["odometry"]


def test_clock_that_jumps_back_invalidates_measurements() -> None:
    frames = Frames()
    frames.newest = 105.0
    told = measuring(frames)
    told.take_odometry(odometry(105.0))
    assert told.measurements(105.0).twist == Twist2(0.2)
    frames.newest = 100.0
    found = told.measurements(100.0)
    assert (found.twist, found.pose) == (Twist2(0.2), None)
    told.take_odometry(odometry(100.01))
    frames.newest = 100.01
    assert told.measurements(100.02).pose is not None


def test_detection_waits_for_its_transform_and_expires() -> None:
    frames = Frames()
    told = measuring(frames)
    told.measurements(100.0)
    told.take_detection(detected(100.05, "odom"))
    assert told.measurements(100.06).detections == ()
    assert "detection" not in told.faults, "it may still come"
    frames.newest = 100.1
    (found,) = told.measurements(100.12).detections
    assert found.pose.x == pytest.approx(-0.01)
    told.take_detection(detected(100.2, "odom"))
    assert told.measurements(100.5).detections == ()
    assert "future" in told.faults["detection"]
    assert told.measurements(100.52).detections == ()
    wrong = detected(100.5)
    wrong.header.stamp.sec = -1
    for message in (detected(100.5, ""), wrong):
        told.take_detection(message)
        assert told.measurements(100.55).detections == ()
        assert "PoseStamped" in told.faults["detection"] or "sec" in told.faults["detection"]
    told.take_detection(detected(100.54))
    told.take_detection(detected(100.50))
    assert [one.stamp for one in told.measurements(100.56).detections] == [100.5, 100.54], "the oldest first"


def test_detections_from_before_the_first_cycle_are_ignored() -> None:
    told = measuring(Frames())
    told.take_detection(detected(99.95))
    assert told.measurements(100.0).detections == ()
    told.take_detection(detected(99.99))
    told.take_detection(detected(100.01))
    assert [one.stamp for one in told.measurements(100.05).detections] == [100.01]
    assert "detection" not in told.faults


def test_costmap_is_returned_until_it_is_old() -> None:
    told = measuring(Frames())
    grid = Costmap(np.zeros((2, 2), dtype=np.uint8), 0.1)
    told.take_surroundings(grid, 100.0)
    assert told.measurements(100.5).costmap is grid
    assert told.measurements(100.9).costmap is grid
    assert told.measurements(101.1).costmap is None
    assert "1.10 s old" in told.faults["costmap"]
    without = measuring(Frames(), RULES._replace(costmap_timeout=None))
    without.take_surroundings(grid, 100.0)
    assert without.measurements(100.5).costmap is None
    assert "costmap" not in without.faults
