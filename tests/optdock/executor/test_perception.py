"""Robot and dock brought up to date: what is believed after the pose has jumped."""

import numpy as np
import pytest

from optdock.executor import ExecutorSettings
from optdock.executor.perception import Perception
from optdock.geometry.pose import Pose2, Twist2
from optdock.model.measurements import Detection, Measurements

DOCK, HERE, PUSHED = Pose2(0.0, 0.0, 0.0), Pose2(-0.6, 0.0, 0.0), Pose2(-0.6, 0.08, 0.0)
PERIOD = 0.05


def resting(until, events=None):
    """A robot at rest that has seen its dock until then, and when that is [s]."""
    said = events if events is not None else []
    perception = Perception(DOCK, ExecutorSettings(), lambda name, detail: said.append(name))
    stamps = PERIOD * np.arange(round(until / PERIOD) + 1)
    for stamp in stamps:
        perception.update(Measurements(stamp, HERE, detections=(seen(HERE, stamp),)), stamp, 0.0)
    return perception, float(stamps[-1])


def seen(robot, stamp):
    return Detection(stamp, DOCK.in_frame_of(robot), 0.003, 0.005)


def jumped():
    """The same one, pushed aside 8 cm with its wheels at rest until its localization has said so; and when that was."""
    events = []
    perception, stamp = resting(1.0, events)
    while "pose jumped" not in events:
        stamp += PERIOD
        perception.update(Measurements(stamp, PUSHED), stamp, 0.0)
    return perception, stamp


def test_a_detection_from_before_a_jump_of_the_pose_decides_nothing():
    """It shows the dock as seen from where the robot stood before; the one after the jump says that it was pushed."""
    perception, at = jumped()
    before = perception.robot_from_dock
    late = Measurements(at + PERIOD, PUSHED, detections=(seen(HERE, at - 0.5 * PERIOD),))
    perception.update(late, at + PERIOD, 0.0)
    assert perception.robot_from_dock.gap_to(before) < 1e-4
    stamp = at + 2.0 * PERIOD
    perception.update(Measurements(stamp, PUSHED, detections=(seen(PUSHED, stamp),)), stamp, 0.0)
    assert perception.robot_from_dock.gap_to(PUSHED.in_frame_of(DOCK)) < 1e-3


def test_a_jump_of_the_localization_alone_takes_nothing_from_what_is_known_of_the_dock():
    """As when a blind robot stands close to the dock: its odometry has seen no motion."""
    perception, _ = jumped()
    assert perception.robot_from_dock.gap_to(HERE) < 1e-3
    assert perception.sigma[0] < 0.005


@pytest.mark.parametrize("robot", [PUSHED, HERE], ids=["the robot was moved", "the localization was"])
def test_the_first_detection_after_a_jump_says_which_of_the_two_has_moved(robot):
    perception, at = jumped()
    stamp = at + PERIOD
    perception.update(Measurements(stamp, PUSHED, detections=(seen(robot, stamp),)), stamp, 0.0)
    assert perception.robot_from_dock.gap_to(robot.in_frame_of(DOCK)) < 1e-3
    assert perception.sigma[0] < 0.005


def test_a_turn_that_the_localization_alone_sees_is_told_until_the_dock_is_seen():
    """A wheel slips: the localization turns little by little, as it is filtered, and the odometry does not."""
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


@pytest.mark.parametrize(("left", "believed"), [(0.06, True), (0.6, False)], ids=["at the dock", "before it"])
def test_after_a_gap_near_the_dock_a_detection_counts_for_more(left, believed):
    """A wheel has slipped unseen by 8 mm on the last 5 cm: no mean of many detections will show it there."""
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
