"""Estimates of robot and dock after jumps, rotations and gaps."""

import numpy as np
import pytest

from optdock.executor import ExecutorSettings
from optdock.executor.perception import Perception
from optdock.geometry.pose import Pose2, Twist2
from optdock.model.measurements import Detection, Measurements

DOCK, HERE, PUSHED = Pose2(0.0, 0.0, 0.0), Pose2(-0.6, 0.0, 0.0), Pose2(-0.6, 0.08, 0.0)
PERIOD = 0.05


def resting(until, events=None):
    """A robot at rest with detections until a time, and that time [s]."""
    said = events if events is not None else []
    perception = Perception(DOCK, ExecutorSettings(), lambda name, detail: said.append(name))
    stamps = PERIOD * np.arange(round(until / PERIOD) + 1)
    for stamp in stamps:
        perception.update(Measurements(stamp, HERE, detections=(seen(HERE, stamp),)), stamp, 0.0)
    return perception, float(stamps[-1])


def seen(robot, stamp):
    return Detection(stamp, DOCK.in_frame_of(robot), 0.003, 0.005)


def jumped():
    """The same robot pushed by 8 cm, after the jump of its localization, and the time of that jump."""
    events = []
    perception, stamp = resting(1.0, events)
    while "pose jumped" not in events:
        stamp += PERIOD
        perception.update(Measurements(stamp, PUSHED), stamp, 0.0)
    return perception, stamp


def test_detection_from_before_a_jump_has_no_effect():
    perception, at = jumped()
    before = perception.robot_from_dock
    late = Measurements(at + PERIOD, PUSHED, detections=(seen(HERE, at - 0.5 * PERIOD),))
    perception.update(late, at + PERIOD, 0.0)
    assert perception.robot_from_dock.gap_to(before) < 1e-4
    stamp = at + 2.0 * PERIOD
    perception.update(Measurements(stamp, PUSHED, detections=(seen(PUSHED, stamp),)), stamp, 0.0)
    assert perception.robot_from_dock.gap_to(PUSHED.in_frame_of(DOCK)) < 1e-3


def test_jump_of_the_localization_keeps_the_estimate_of_the_dock():
    """Odometry shows no motion."""
    perception, _ = jumped()
    assert perception.robot_from_dock.gap_to(HERE) < 1e-3
    assert perception.sigma[0] < 0.005


@pytest.mark.parametrize("robot", [PUSHED, HERE], ids=["the robot was moved", "the localization was"])
def test_first_detection_after_a_jump_decides_whether_the_robot_moved(robot):
    perception, at = jumped()
    stamp = at + PERIOD
    perception.update(Measurements(stamp, PUSHED, detections=(seen(robot, stamp),)), stamp, 0.0)
    assert perception.robot_from_dock.gap_to(robot.in_frame_of(DOCK)) < 1e-3
    assert perception.sigma[0] < 0.005


def test_rotation_of_the_localization_is_reported_until_a_detection():
    """A wheel slip in the filtered localization, but not in the odometry."""
    perception, stamp = resting(1.0)
    for k in range(1, 81):
        stamp += PERIOD
        perception.update(Measurements(stamp, Pose2(HERE.x, HERE.y, 0.0005 * k)), stamp, 0.0)
    assert perception.unseen_turn == pytest.approx(0.035, abs=0.006)
    for _ in range(40):
        stamp += PERIOD
        robot = Pose2(HERE.x, HERE.y, 0.04)
        perception.update(Measurements(stamp, robot, detections=(seen(robot, stamp),)), stamp, 0.0)
    assert abs(perception.unseen_turn) < 0.002


@pytest.mark.parametrize(("left", "believed"), [(0.06, True), (0.6, False)], ids=["at the dock", "far away"])
def test_detection_after_a_gap_near_the_dock_has_more_weight(left, believed):
    """After a wheel slip of 8 mm on the last 5 cm."""
    perception, stamp, place = Perception(DOCK, ExecutorSettings(), lambda *_: None), 0.0, Pose2(-left - 0.05, 0.0, 0.0)
    for _ in range(41):
        perception.update(Measurements(stamp, place, detections=(seen(place, stamp),)), stamp, 0.0)
        stamp += PERIOD
    for _ in range(10):  # the odometry tells 5 cm
        place = Pose2(place.x + 0.005, 0.0, 0.0)
        perception.update(Measurements(stamp, place, Twist2(0.1)), stamp, 0.0)
        stamp += PERIOD
    slipped = Pose2(place.x - 0.008, 0.0, 0.0)
    perception.update(Measurements(stamp, place, detections=(seen(slipped, stamp),)), stamp, 0.0)
    moved = (place.x - perception.robot_from_dock.x) / 0.008
    assert moved > 0.75 if believed else moved < 0.6
