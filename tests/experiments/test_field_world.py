"""Field world: one test per imperfection, and whole runs."""

import argparse
import ast
import dataclasses
import itertools
import math
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from experiments.docking import field
from experiments.docking.cases import SPREADS, layout_of
from experiments.docking.field.camera import Camera, CameraState
from experiments.docking.field.drive import SUBSTEP, Drive, DriveState
from experiments.docking.field.localization import Localization, LocalizationState
from experiments.docking.field.methods import Belief
from experiments.docking.field.nav2 import VelocitySmoother
from experiments.docking.field.odometry import Odometry, OdometryState
from experiments.docking.field.outcome import FieldTask, SteeringResult
from experiments.docking.field.picture import draw_run
from experiments.docking.field.run import driven_in_field, field_tasks
from experiments.docking.field.station import Station, deepest, shown_in_costmap
from experiments.docking.field.tables import field_table
from experiments.docking.field.undocking import (
    commanded_in_contact,
    turned_in_contact,
    undocked_in_field,
    undocking_table,
)
from experiments.docking.field.world import FieldRobot, FieldWorld
from experiments.docking.field.worlds import FIELD_WORLDS
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2, Twist2
from optdock.model.costmap import LETHAL
from optdock.model.dock import DockDirection

IDEAL = Drive(
    radius_spread=0.0, track_spread=0.0, lag=0.0, latency=(0.0, 0.0), command_loss=0.0, slip_rate=0.0, watchdog=math.inf
)
ORIGIN = Pose2(0.0, 0.0, 0.0)
RADIUS = IDEAL.wheel_radius
EXACT = Odometry(delay=(0.0, 0.0), stamp_jitter=0.0, repeats=0.0)
CLEAR = Camera(outliers=0.0, near_loss=0.0, hidden_for=0.0)


def random(seed=0):
    return np.random.default_rng(seed)


def set_down(drive, seed=0):
    return DriveState(drive, ORIGIN, (random(seed), random(seed + 1), random(seed + 2)))


def driven(drive, command, duration, seed=0):
    state = set_down(drive, seed)
    state.send(command)
    for _ in range(round(duration / SUBSTEP)):
        state.advance()
    return state


# Drive


def test_ideal_drive_follows_the_unicycle():
    v, w, duration = 0.2, 0.5, 6.0
    state = driven(IDEAL, Twist2(v, w), duration)
    expected = v / w * math.sin(w * duration), v / w * (1.0 - math.cos(w * duration)), w * duration
    assert (state.x, state.y, state.yaw) == pytest.approx(expected, abs=1e-12)


def test_first_order_lag():
    v, lag, duration = 0.2, 0.1, 0.3
    state = driven(dataclasses.replace(IDEAL, lag=lag), Twist2(v, 0.0), duration)
    assert state.x == pytest.approx(v * (duration - lag * (1.0 - math.exp(-duration / lag))), abs=1e-12)
    assert state.wheel_speeds[0] * RADIUS == pytest.approx(v * (1.0 - math.exp(-duration / lag)), abs=1e-12)


def test_unequal_wheels_turn_the_robot():
    state = driven(dataclasses.replace(IDEAL, radius_spread=0.01, track_spread=0.01), Twist2(0.2, 0.0), 5.0)
    assert all(abs(radius / RADIUS - 1.0) <= 0.01 for radius in state.radii)
    left, right = (0.2 * 5.0 * radius / RADIUS for radius in state.radii)
    assert state.yaw == pytest.approx((right - left) / state.width, rel=1e-9)
    assert state.radii != set_down(state.drive, seed=7).radii


def test_dead_band_per_wheel():
    drive = dataclasses.replace(IDEAL, dead_band=(0.03, 0.08))
    low, high = sorted(set_down(drive).dead_bands)
    assert 0.03 <= low < high <= 0.08
    assert driven(drive, Twist2(0.99 * low, 0.0), 1.0).x == 0.0
    assert driven(drive, Twist2(1.01 * high, 0.0), 1.0).x == pytest.approx(1.01 * high)
    between = driven(drive, Twist2(0.5 * (low + high), 0.0), 1.0)
    assert sorted((between.left, between.right))[0] == 0.0
    assert between.yaw != 0.0


def test_command_latency():
    state = driven(dataclasses.replace(IDEAL, latency=(0.07, 0.07)), Twist2(0.2, 0.0), 1.0)
    assert state.x == pytest.approx(0.2 * (1.0 - 0.07), abs=1e-12)


def test_command_delays_losses_and_order():
    state = set_down(dataclasses.replace(Drive(), command_loss=0.05))
    sent = 1500
    arrived, delays = [], []
    for number in range(1, sent + 1):
        before = len(state._under_way)
        state.send(Twist2(float(number), 0.0))
        if len(state._under_way) > before:
            delays.append(state._under_way[-1][0] - state.time)
        for _ in range(20):
            state.advance()
        now = state._targets[0] * RADIUS
        if now and (not arrived or arrived[-1] != now):
            arrived.append(now)
    assert arrived == sorted(arrived)
    assert 0.04 <= min(delays) < 0.05
    assert 0.11 < max(delays) <= 0.12
    assert 1.0 - len(delays) / sent == pytest.approx(0.05, abs=4.0 * math.sqrt(0.05 * 0.95 / sent))


def test_watchdog_stops_the_base():
    state = driven(dataclasses.replace(IDEAL, watchdog=0.5), Twist2(0.2, 0.0), 3.0)
    assert state.x == pytest.approx(0.2 * 0.5, abs=2.0 * 0.2 * SUBSTEP)
    assert state.at_rest


def test_slip_reduces_distance_and_not_ticks():
    rate, share, lost, duration = 5.0, 0.3, 0.4, 60.0
    slipping = dataclasses.replace(IDEAL, slip_rate=rate, slip_duration=(share, share), slip_share=(lost, lost))
    state, way = set_down(slipping), 0.0
    state.send(Twist2(0.1, 0.0))
    for _ in range(round(duration / SUBSTEP)):
        x, y = state.x, state.y
        state.advance()
        way += math.hypot(state.x - x, state.y - y)
    assert (state.left, state.right) == pytest.approx((0.1 * duration / RADIUS,) * 2)
    # In a burst the left, the right or both wheels slip: the robot loses half, half, or all of their share.
    in_bursts = rate * share / (1.0 + rate * share)
    assert 1.0 - way / (0.1 * duration) == pytest.approx(lost * in_bursts * 2.0 / 3.0, rel=0.15)
    assert abs(state.yaw) > 0.01


# Odometry


@given(st.floats(-1e4, 1e4))
def test_encoders_count_whole_ticks(angle):
    ticks = OdometryState(Odometry(), IDEAL, random()).ticks_of(angle)
    assert -1e-9 <= angle * 4096 / (2.0 * math.pi) - ticks <= 1.0


def test_odometry_integrates_all_ticks():
    state, odometry = set_down(IDEAL), OdometryState(EXACT, IDEAL, random())
    state.send(Twist2(0.2, 0.3))
    for count in range(1, 1001):
        state.advance()
        if count % 2 == 0:
            odometry.read(state.time, state.left, state.right)
    tick = 2.0 * math.pi * RADIUS / 4096
    assert odometry.pose.yaw == pytest.approx(state.yaw, abs=2.0 * tick / IDEAL.track_width)
    assert math.hypot(odometry.pose.x - state.x, odometry.pose.y - state.y) < 4.0 * tick


@pytest.mark.parametrize("window", [0.01, 0.04, 0.2])
def test_twist_of_a_ramp_is_delayed_by_half_the_window(window):
    acceleration = 0.5
    odometry = OdometryState(dataclasses.replace(EXACT, window=window, ticks=10**9), IDEAL, random())
    for count in range(1, 101):
        time = 0.01 * count
        angle = 0.5 * acceleration * time**2 / RADIUS
        odometry.read(time, angle, angle)
    late = acceleration * time - odometry.newest(time).twist.linear
    assert late == pytest.approx(0.5 * acceleration * window, rel=1e-4)


def test_twist_is_quantised_to_ticks_per_window():
    odometry = OdometryState(EXACT, IDEAL, random())
    found = set()
    for count in range(1, 200):
        angle = 0.1 * 0.01 * count / RADIUS
        odometry.read(0.01 * count, angle, angle)
        if count > 4:
            found.add(round(odometry.newest(0.01 * count).twist.linear * 0.04 / (2.0 * math.pi * RADIUS / 4096), 9))
    assert found == {26.0, 27.0}


def test_odometry_delay_order_and_repeats():
    odometry = OdometryState(Odometry(repeats=0.1), IDEAL, random())
    stamps, ages = [], []
    for count in range(1, 3001):
        odometry.read(0.01 * count, 0.0, 0.0)
        stamps.append(odometry.newest(0.01 * count).stamp)
        ages.append(0.01 * count - stamps[-1])
    assert stamps == sorted(stamps)
    assert sum(a == b for a, b in itertools.pairwise(stamps)) > 0.1 * len(stamps)
    assert 0.01 - 0.004 - 1e-9 <= min(ages) < 0.01
    assert 0.02 < max(ages) < 0.06
    assert len({round(stamp % 0.01, 6) for stamp in stamps}) > 100


# Localization


def localized(localization, count, seed=0):
    """Return the errors of estimates of a standing robot, as reported one period later."""
    state = LocalizationState(dataclasses.replace(localization, composed=False, latency=0.0), random(seed))
    found = []
    for index in range(count):
        time = localization.period * index
        state.estimate(time, ORIGIN, ORIGIN)
        pose, stamp = state.reported(time, ORIGIN)
        assert stamp == time
        found.append(pose.as_array())
    return np.array(found)


def test_drift_is_stationary_and_correlated():
    errors = localized(Localization(jump_pause=math.inf), 12_000)
    assert errors.std(axis=0) == pytest.approx([0.015, 0.015, math.radians(0.3)], rel=0.2)
    lag = round(10.0 / 0.2)
    for column in errors.T:
        assert np.corrcoef(column[:-lag], column[lag:])[0, 1] == pytest.approx(math.exp(-1.0), abs=0.15)


def test_jumps_are_reverted_by_the_next_jump():
    errors = localized(Localization(drift=0.0, drift_yaw=0.0), 10_000)
    steps = np.hypot(*np.diff(errors[:, :2], axis=0).T)
    sizes = steps[steps > 0.0]
    assert 0.03 - 1e-9 <= sizes.min() < sizes.max() <= 0.05 + 1e-9
    assert len(sizes) == pytest.approx(10_000 * 0.2 / 12.0, rel=0.25)
    assert np.abs(errors[:, 2]).max() <= math.radians(1.0)
    assert np.hypot(*errors[:, :2].T).max() <= 0.05 + 1e-9


def test_composed_pose_uses_the_newest_odometry():
    flawless = Localization(drift=0.0, drift_yaw=0.0, jump_pause=math.inf)
    state, start = LocalizationState(flawless, random()), Pose2(1.0, 2.0, 0.7)
    for count in range(60):
        time, odometry = 0.2 * count, Pose2(0.03 * count, 0.01 * count, 0.05 * count)
        state.estimate(time, start @ odometry, odometry)
        pose, stamp = state.reported(time, odometry)
        assert stamp is None
        assert pose.as_array() == pytest.approx((start @ odometry).as_array(), abs=1e-12)


def test_raw_pose_is_reported_once_with_its_measurement_stamp():
    state = LocalizationState(Localization(composed=False), random())
    found = []
    for count in range(400):
        time = 0.01 * count
        if count % 20 == 0:
            state.estimate(time, ORIGIN, ORIGIN)
        pose, stamp = state.reported(time, ORIGIN)
        if pose is not None:
            found.append((time, stamp))
    assert len(found) == 20
    assert [time - stamp for time, stamp in found] == pytest.approx([0.15] * len(found), abs=0.011)


def test_lost_localization_reports_no_pose():
    state = LocalizationState(Localization(lost_for=5.0), random())
    state.estimate(0.0, ORIGIN, ORIGIN)
    silent = [state.reported(0.01 * count, ORIGIN)[0] is None for count in range(2000)]
    assert sum(silent) == pytest.approx(500, abs=1)
    assert 200 <= silent.index(True) <= 800


# Camera


def seen(camera, count=2500, robot=ORIGIN, dock=None, seed=0):
    """Return the detections of a dock in a number of pictures: (arrival, detection)."""
    state = CameraState(camera, Pose2(0.45, 0.0, 0.0), random(seed))
    found = []
    for index in range(20 * count):
        if index % 20 == 0:
            state.take(SUBSTEP * index, robot, dock or Pose2(1.0, 0.1, 0.2))
        if index % 4 == 0:
            found += [(SUBSTEP * index, one) for one in state.arrived(SUBSTEP * index)]
    return found


def test_noise_agrees_with_the_sigmas():
    found = [one for _, one in seen(CLEAR)]
    distance = math.hypot(1.0 + 0.45 * math.cos(0.2) - 0.25, 0.1 + 0.45 * math.sin(0.2))
    assert found[0].position_sigma == pytest.approx(0.002 + 0.004 * distance)
    assert found[0].yaw_sigma == pytest.approx(math.radians(0.3 + 0.7 * distance))
    offs = np.array([[one.pose.x - 1.0, one.pose.y - 0.1, one.pose.yaw - 0.2] for one in found])
    sigmas = np.array([[one.position_sigma, one.position_sigma, one.yaw_sigma] for one in found])
    assert (offs / sigmas).mean(axis=0) == pytest.approx(np.zeros(3), abs=4.0 / math.sqrt(len(found)))
    assert (offs / sigmas).std(axis=0) == pytest.approx(np.ones(3), abs=4.0 / math.sqrt(2.0 * len(found)))


def test_detections_overtake_each_other_with_true_stamps():
    found = seen(CLEAR)
    stamps = [one.stamp for _, one in found]
    assert stamps != sorted(stamps)
    assert all(stamp / 0.1 == pytest.approx(round(stamp / 0.1), abs=1e-6) for stamp in stamps)
    delays = [arrival - one.stamp for arrival, one in found]
    assert min(delays) >= 0.08 - 1e-9
    assert max(delays) <= 0.2 + 4 * SUBSTEP


def test_stamp_on_arrival_changes_only_the_stamps():
    true = {one.pose: one.stamp for _, one in seen(CLEAR, 300)}
    found = seen(dataclasses.replace(CLEAR, stamped_on_arrival=True), 300)
    late = np.array([one.stamp - true[one.pose] for _, one in found])
    assert 0.08 <= late.min() < 0.09
    assert 0.19 < late.max() <= 0.2
    assert [one.stamp for _, one in found] == sorted(one.stamp for _, one in found)


def test_share_and_distance_of_outliers():
    right, wrong = ({one.stamp: one for _, one in seen(dataclasses.replace(CLEAR, outliers=s))} for s in (0.0, 0.1))
    off = [right[stamp].pose.distance_to(one.pose) for stamp, one in wrong.items()]
    turned = [abs(right[stamp].pose.yaw - one.pose.yaw) for stamp, one in wrong.items()]
    far = np.array(off) > 1e-9
    assert far.mean() == pytest.approx(0.1, abs=0.02)
    assert np.array(off)[far] == pytest.approx(0.1)
    assert np.array(turned)[far] == pytest.approx(math.radians(10.0))
    assert all(wrong[stamp].position_sigma == right[stamp].position_sigma for stamp in wrong)


@pytest.mark.parametrize(("loss", "expected"), [(0.0, 1.0), (0.5, 0.5), (1.0, 0.0)])
def test_pictures_are_lost_near_the_dock(loss, expected):
    camera = dataclasses.replace(CLEAR, near_loss=loss)
    near, far = (len(seen(camera, 1000, dock=Pose2(x, 0.0, 0.0))) / 1000 for x in (0.39, 0.41))
    assert near == pytest.approx(expected, abs=0.06)
    assert far > 0.99


def test_occlusion():
    stamps = [one.stamp for _, one in seen(dataclasses.replace(CLEAR, hidden_for=2.0), 300)]
    missing = sorted(set(range(298)) - {round(stamp / 0.1) for stamp in stamps})
    assert len(missing) == pytest.approx(20, abs=1)
    assert missing == list(range(missing[0], missing[-1] + 1))


def test_no_detection_out_of_view():
    assert seen(CLEAR, 20, robot=Pose2(0.0, 0.0, math.pi)) == []
    assert seen(CLEAR, 20, dock=Pose2(5.0, 0.0, 0.0)) == []
    assert seen(CLEAR, 20, robot=Pose2(0.0, 0.0, 1.0)) == []


def test_second_tag():
    camera = dataclasses.replace(CLEAR, second_tag=0.1, hidden_for=2.0)
    dock = Pose2(1.0, 0.1, 0.2)
    found = {round(one.stamp / 0.1): one.pose.in_frame_of(dock) for _, one in seen(camera, dock=dock)}
    aside = {number for number, pose in found.items() if pose.y > 0.15}
    assert all(found[number].y == pytest.approx(0.3, abs=0.05) for number in aside)
    assert len(aside) / len(found) == pytest.approx(0.1, abs=0.02)
    hidden = [number for number in range(2500) if set(range(number, number + 20)) <= aside]
    assert hidden


# Station

BOX = [(0.3, 0.225), (-0.3, 0.225), (-0.3, -0.225), (0.3, -0.225)]


@given(st.floats(-0.2, 0.2), st.floats(-0.02, 0.02), st.sampled_from([1.0, -1.0]))
def test_foremost_corner_touches(yaw, x, gear):
    expected = gear * x + 0.225 * abs(math.sin(yaw)) + 0.3 * (math.cos(yaw) - 1.0)
    assert deepest((x, 0.0, yaw), BOX, gear) == pytest.approx(expected, abs=1e-12)


def test_switch_closes_before_the_docked_pose():
    station = Station()
    assert station.touched(Pose2(-0.0029, 0.0, 0.0), 1.0)
    assert not station.touched(Pose2(-0.0031, 0.0, 0.0), 1.0)
    assert station.touched(Pose2(0.0029, 0.0, 0.0), -1.0)
    assert not station.touched(Pose2(0.0, 0.021, 0.0), 1.0)
    assert not station.touched(Pose2(0.0, 0.0, 0.11), 1.0)


@settings(max_examples=30)
@given(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), st.floats(-4.0, 4.0))
def test_costmap_shows_only_the_outline(x, y, yaw):
    outline = Footprint(np.array([[0.3, -0.3], [0.45, -0.3], [0.45, 0.3], [0.3, 0.3]]))
    pose = Pose2(x, y, yaw)
    costmap = shown_in_costmap(outline, pose, 0.05, 1.5)
    corners = [pose @ Pose2(u, v, 0.0) for u, v in outline.vertices.tolist()]
    rounding = 1e-9 * np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]])  # a corner may lie where cells meet
    assert all(LETHAL in costmap.cost_at(np.array([one.x, one.y]) + rounding) for one in corners)
    rows, columns = np.nonzero(costmap.data)
    for row, column in zip(rows.tolist(), columns.tolist(), strict=True):
        centre = Pose2(costmap.origin[0] + 0.05 * (column + 0.5), costmap.origin[1] + 0.05 * (row + 0.5), 0.0)
        seen_there = centre.in_frame_of(pose)
        outside = max(0.3 - seen_there.x, seen_there.x - 0.45, abs(seen_there.y) - 0.3)
        assert outside <= 0.5 * math.sqrt(2.0) * 0.05 + 1e-9


# Whole world


def placed(world, seed=1, spread="nav2"):
    layout = layout_of(random(seed), SPREADS[spread], world.direction, world.moved)
    return layout, FieldRobot(world, layout, seed)


def before_the_dock(world, off, seed=1):
    """Return a robot that stands at a distance [m] before the true dock, facing it."""
    layout, _ = placed(world, seed)
    gear = 1.0 if world.direction is DockDirection.FORWARD else -1.0
    start = layout.true_dock @ Pose2(-gear * off, 0.0, 0.0)
    problem = dataclasses.replace(layout.problem, start=start)
    return FieldRobot(world, layout._replace(problem=problem), seed)


@pytest.mark.parametrize("direction", [DockDirection.FORWARD, DockDirection.BACKWARD])
def test_station_stops_the_robot_and_signals_contact(direction):
    gear = 1.0 if direction is DockDirection.FORWARD else -1.0
    robot = before_the_dock(FieldWorld(drive=IDEAL, direction=direction, dropped_cycles=0.0), 0.1)
    assert robot.measurements.contact is False
    for _ in range(100):
        robot.advance(Twist2(gear * 0.1, 0.0), 50.0)
    assert gear * robot.error.x == pytest.approx(0.005, abs=1e-9)
    assert robot.measurements.contact
    counted = robot.drive.left
    robot.advance(Twist2(gear * 0.1, 0.0), 50.0)
    assert robot.drive.left == pytest.approx(counted, abs=0.1 * SUBSTEP / RADIUS * 4 + 1e-9)
    for _ in range(100):
        robot.advance(Twist2(-gear * 0.1, 0.0), 50.0)
    assert gear * robot.error.x < -0.15
    assert robot.measurements.contact is False


def test_dock_is_pushed_once():
    robot = before_the_dock(FieldWorld(drive=IDEAL, pushed=(0.03, 0.02)), 0.7)
    for _ in range(150):
        robot.advance(Twist2(0.2, 0.0), 50.0)
    assert len(robot.docks) == 2
    (_, before), (since, after) = robot.docks
    row = robot.poses[round(since / SUBSTEP)]
    assert math.hypot(row[1] - before.x, row[2] - before.y) == pytest.approx(0.6, abs=0.002)
    assert before.distance_to(after) == pytest.approx(0.03)
    assert abs(after.yaw - before.yaw) <= 0.02


def test_dropped_cycles():
    _, robot = placed(FieldWorld())
    periods = [robot.cycle(50.0) for _ in range(5000)]
    assert set(np.round(periods, 9)) == {0.02, 0.04}
    assert np.mean(np.array(periods) > 0.03) == pytest.approx(0.01, abs=0.006)
    with pytest.raises(ValueError, match="multiple"):
        robot.cycle(30.0)


def test_seeds_and_independence_of_the_parts():
    def run(world):
        _, robot = placed(world)
        found = [robot.advance(Twist2(0.1, 0.1), 50.0) for _ in range(150)]
        return robot.poses, [one.odometry for one in found], [one.detections for one in found]

    usual = FIELD_WORLDS["field"]
    first, again = run(usual), run(usual)
    assert first == again
    blind = run(dataclasses.replace(usual, camera=dataclasses.replace(usual.camera, outliers=0.5)))
    assert blind[:2] == first[:2]
    assert blind[2] != first[2]
    slower = run(dataclasses.replace(usual, odometry=Odometry(delay=(0.0, 0.0))))
    assert slower[0] == first[0]
    assert slower[2] == first[2]


@pytest.mark.parametrize("name", sorted(FIELD_WORLDS))
def test_measurements_of_every_world(name):
    world = FIELD_WORLDS[name]
    _, robot = placed(world)
    found = [robot.measurements, *(robot.advance(Twist2(0.0, 0.1), 50.0) for _ in range(60))]
    assert all((one.odometry is None) == ("no odometry pose" in name or "no pose" in name) for one in found)
    assert all((one.contact is None) == ("no signal" in name) for one in found)
    assert any(one.costmap is not None for one in found) == ("costmap" in name)
    assert any(one.pose_stamp is not None for one in found) == ("raw" in name)
    assert any(one.detections for one in found) == (not name.startswith("field, backward"))


def test_late_detections_agree_with_the_pose_at_their_stamp():
    _, robot = placed(FieldWorld(drive=IDEAL, camera=CLEAR, dropped_cycles=0.0))
    for _ in range(150):
        robot.advance(Twist2(0.2, 0.3), 50.0)
    rows = robot.record()
    assert rows[:, 0] == pytest.approx(SUBSTEP * np.arange(len(rows)))
    assert len(robot.detections) > 10
    for _, one in robot.detections:
        at = Pose2.from_sequence(rows[round(one.stamp / SUBSTEP), 1:])
        off = (at @ one.pose).in_frame_of(robot.dock)
        assert math.hypot(off.x, off.y) < 6.0 * one.position_sigma
        assert abs(off.yaw) < 5.0 * one.yaw_sigma


# Methods


def test_velocity_smoother_limits_each_step():
    smoother = VelocitySmoother(acceleration=2.0, yaw_acceleration=1.0, period=0.05)
    found = [smoother.smoothed(Twist2(0.25, -0.2)) for _ in range(6)]
    assert [one.linear for one in found] == pytest.approx([0.1, 0.2, 0.25, 0.25, 0.25, 0.25])
    assert [one.angular for one in found] == pytest.approx([-0.05, -0.1, -0.15, -0.2, -0.2, -0.2])
    assert smoother.smoothed(Twist2()).linear == pytest.approx(0.15)


@pytest.fixture(scope="module")
def outcomes():
    tasks = [FieldTask(method, "field", "nav2", 50.0, 3) for method in ("executor", "Nav2's law")]
    return [driven_in_field(task) for task in tasks]


def test_outcomes_of_executor_and_law(outcomes):
    ours, law = outcomes
    assert ours.good
    assert not ours.collided
    assert ours.duration > ours.planned > 3.0
    assert ours.busy > 0.0
    assert law.docked
    assert math.isnan(law.planned)
    assert not law._replace(along=0.011).good
    assert law._replace(along=0.011).falsely_docked
    assert law._replace(at_rest=False, along=0.0, cross=0.0, yaw=0.0).falsely_docked
    assert not law._replace(docked=False).falsely_docked
    assert law._replace(station=-0.008).collided
    assert law._replace(clearance=-1e-6).collided


def test_docking_with_dead_bands():
    """One wheel stops a centimetre before the other; short motions per wheel are needed to finish."""
    outcome = driven_in_field(FieldTask("executor", "field, dead band", "wider", 10.0, 3000015))
    assert outcome.good
    assert outcome.retries == 0


def test_field_table_counts(outcomes):
    ours, law = outcomes
    failed = ours._replace(docked=False, ending="timeout", cross=1.0, duration=99.0)
    wrong = ours._replace(cross=0.02, clearance=-0.1)
    lines = field_table([ours, wrong, failed, law]).splitlines()
    cells = [cell for cell in lines[1].split("  ") if cell]
    assert [cell.strip() for cell in cells[:7]] == ["field", "50", "executor", "1/3", "1", "1 timeout", "1"]
    assert float(cells[7]) == 20.0
    assert "99" in cells
    assert len(lines) == 3


def test_selected_tasks():
    options = argparse.Namespace(spread=None, method=None, rate=[20.0, 50.0], count=2, seed=3)
    tasks = field_tasks(options, ["field", "field, blind"])
    assert len(tasks) == len(set(tasks)) == 2 * 2 * 2 * 2
    assert {(task.method, task.spread) for task in tasks} == {("executor", "wider"), ("Nav2's law", "nav2")}
    assert {task.seed for task in tasks} == {3_000_000, 3_000_001}


def test_picture_of_a_run(tmp_path):
    draw_run(tmp_path / "run.png", FieldTask("Nav2's law", "field", "nav2", 50.0, 3))
    assert (tmp_path / "run.png").stat().st_size > 20_000


def test_turn_in_contact_and_its_commanded_part():
    way = 0.007 * np.arange(30)
    rows = np.column_stack((10.0 * way, 1.0 - way, 0.0 * way, np.where(way <= 0.05, -way, way - 0.1)))
    assert turned_in_contact(rows) == pytest.approx(0.049)
    stamps = np.array([0.0, 0.5, 1.5])
    commands = np.array([[-0.1, 0.02], [-0.1, -0.06], [-0.1, 9.0]])
    by = SteeringResult("", "", True, 0.0, 0.0, 0, 0.0, 0.0, 0.0, 0.0, commands, stamps)
    assert commanded_in_contact(rows, by) == pytest.approx(
        0.06 * 0.55 - 0.02 * 0.5
    )  # out of contact at 0.105 m, 1.05 s


def test_belief_recovers_near_the_truth():
    robot = before_the_dock(FieldWorld(drive=IDEAL, camera=CLEAR, pushed=(0.03, 0.02)), 0.62)
    belief, executor = Belief(), SimpleNamespace(robot=None, dock=robot.dock)
    belief.compare(executor, robot)
    assert math.isnan(belief.off)
    for _ in range(60):
        executor.robot = robot.pose  # localized exactly, with the dock at its old pose
        belief.compare(executor, robot)
        robot.advance(Twist2(0.1, 0.0), 50.0)
    assert belief.recovered_after == math.inf
    assert belief.off == pytest.approx(0.03, abs=0.02 * 0.6)  # and the effect of the rotation at the robot
    assert belief.turned_off == pytest.approx(abs(robot.docks[1][1].yaw - robot.docks[0][1].yaw))
    executor.robot, executor.dock = robot.pose, robot.dock
    belief.compare(executor, robot)
    fresh = [one for _, one in robot.detections if one.stamp >= robot.docks[1][0]]
    assert belief.off == pytest.approx(0.0, abs=1e-12)
    assert belief.recovered_after == len(fresh) > 3


def test_undocking():
    found = undocked_in_field(FieldTask("executor", "field", "nav2", 50.0, 3))
    assert found.undocked
    assert found.at_rest
    assert found.turned < math.radians(5.0)
    assert "1/1" in undocking_table([found])


def test_field_world_shares_no_code_with_the_simulation():
    folder = Path(field.__file__).parent
    for file in folder.glob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            names = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            names += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            assert not any("simulation" in name for name in names), file.name
    code = (
        "import sys; from experiments.docking.field import worlds;"
        "sys.exit(any(name.startswith('optdock.simulation') for name in sys.modules))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False, cwd=folder.parents[2]).returncode == 0
