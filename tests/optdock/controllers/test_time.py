"""Time base of the controller: rates and stamps of the calls, and changes of trajectory."""

import functools
import math

import numpy as np
import pytest

from checkers.dock_goal import DockGoalChecker
from optdock.controllers.delay_estimate import ControlClock
from optdock.controllers.moving_reference import ReferenceProgress, TrajectoryReference
from optdock.controllers.tracking_controller import TrackingController
from optdock.errors import InvalidValue, NoValidControl
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2, Twist2
from optdock.model.constant_jerk import TimeLaw
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.path import Direction, Path
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.model.trajectory import Trajectory
from optdock.plugins.interfaces import PluginContext
from optdock.simulation import SimulationSettings, run_closed_loop
from optdock.testing.drives import clothoid, cusp_drive, rest_to_rest, s_curve_drive, straight_drive

START = Pose2(0.0, 0.0, 0.3)
ROBOT = Robot(Footprint.rectangle(0.4, 0.3, 0.5), MotionLimits(max_reverse_speed=0.5))

DRIVES = {
    "S": s_curve_drive(START),
    "reverse": s_curve_drive(START, Direction.REVERSE),
    "cusp": cusp_drive(START),
    "short": rest_to_rest([clothoid(START, [0.0, 0.15, 0.3, 0.45], [0.0, 1.0, -1.0, 0.0])], speed=0.3),
}


def configured(**parameters):
    controller = TrackingController(**parameters)
    controller.configure(PluginContext(problem=DockingProblem(START, Dock(START), ROBOT)))
    return controller


def driven(controller, gaps, pose=START, stamp=100.0, twist=Twist2()):  # noqa: B008 - frozen
    """Poses of a perfect drive with a command at every stamp, held until the next."""
    found = []
    for gap in gaps:
        twist = controller.compute_velocity_commands(pose, twist, None, stamp=stamp)
        pose, stamp = pose.moved(twist, gap), stamp + gap
        found.append((stamp, pose, twist))
    return found


@pytest.mark.parametrize(("rate", "drive"), [(10, "S"), (20, "reverse"), (25, "cusp"), (200, "short")])
def test_a_drive_takes_as_long_as_planned_at_any_rate(rate, drive):
    trajectory = DRIVES[drive]
    checker = DockGoalChecker(along_tolerance=0.002, cross_tolerance=0.002, yaw_goal_tolerance=0.01)
    world = SimulationSettings(period=1.0 / rate)
    run = run_closed_loop(trajectory, ROBOT, trajectory.path.end, configured(), checker, world)
    assert run.docked, run.reason
    assert run.duration == pytest.approx(trajectory.duration, abs=0.15)
    assert np.abs(run.errors[:, :2]).max() < 0.002


@pytest.mark.parametrize("seed", range(2))
def test_irregular_calls_follow_the_time_that_passes(seed):
    trajectory, controller = s_curve_drive(START), configured()
    controller.set_path(trajectory)
    gaps = np.random.default_rng(seed).choice([0.005, 0.01, 0.02, 0.05, 0.1], 300).tolist()
    for stamp, pose, _ in driven(controller, gaps):
        assert pose.distance_to(trajectory.at(stamp - 100.0).pose) < 0.02
    assert controller.progress.time == pytest.approx(min(trajectory.duration, sum(gaps[:-1])), abs=0.05)


def test_a_late_call_lets_the_reference_catch_up():
    trajectory, controller = straight_drive(START), configured()
    controller.set_path(trajectory)
    *_, (_, pose, twist) = driven(controller, [0.02] * 100 + [0.1] + [0.02] * 50)
    assert controller.progress.time == pytest.approx(150 * 0.02 + 0.08, abs=0.01)
    assert pose.distance_to(trajectory.at(151 * 0.02 + 0.08).pose) < 0.004
    assert twist.linear == pytest.approx(0.4, abs=0.002)


def test_a_call_of_the_same_stamp_changes_nothing():
    trajectory = straight_drive(START)
    once, twice = configured(), configured()
    for controller in (once, twice):
        controller.set_path(trajectory)
    pose, twist = START, Twist2()
    for k in range(60):
        command = once.compute_velocity_commands(pose, twist, None, stamp=0.02 * k)
        for _ in range(2):
            again = twice.compute_velocity_commands(pose, twist, None, stamp=0.02 * k)
            assert again == command
        pose, twist = pose.moved(command, 0.02), command


@pytest.mark.parametrize("make", [configured])
def test_a_clock_that_goes_back_is_refused_until_it_has_caught_up(make):
    controller = make()
    controller.set_path(straight_drive(START))
    for stamp in (5.0, 5.02):
        controller.compute_velocity_commands(START, Twist2(), None, stamp=stamp)
    for stamp in (4.9, 5.01):
        with pytest.raises(NoValidControl, match=f"clock went back from 5.02 s to {stamp} s"):
            controller.compute_velocity_commands(START, Twist2(), None, stamp=stamp)
    controller.compute_velocity_commands(START, Twist2(), None, stamp=5.04)
    controller.reset()
    controller.set_path(straight_drive(START))
    controller.compute_velocity_commands(START, Twist2(), None, stamp=1.0)


def test_stamp_is_checked_and_defaults_to_the_clock():
    controller, time = TrackingController(), [7.0]
    controller.configure(PluginContext(clock=lambda: time[0]))
    controller.set_path(straight_drive(START))
    with pytest.raises(InvalidValue, match="stamp"):
        controller.compute_velocity_commands(START, Twist2(), None, stamp=math.nan)
    for _ in range(6):
        controller.compute_velocity_commands(START, Twist2(), None)
        time[0] += 0.02
    assert controller.progress.time == pytest.approx(0.1)


def test_after_a_long_silence_commands_restart_at_the_measured_velocity():
    controller = configured()
    controller.set_path(straight_drive(START))
    stamp, pose, twist = driven(controller, [0.02] * 150)[-1]
    assert twist.linear > 0.39
    stopped = controller.compute_velocity_commands(pose, Twist2(), None, stamp=stamp + 5.0)
    assert 0.0 <= stopped.linear <= 0.5 * 0.5 + 1e-9


def test_period_is_filtered():
    clock, context = ControlClock(), PluginContext()
    for k in range(50):
        clock.tick(0.02 * k, context)
    assert clock.period == pytest.approx(0.02)
    clock.tick(0.02 * 49 + 0.1, context)
    assert clock.elapsed == pytest.approx(0.1)
    assert clock.period <= 0.024 + 1e-9


def rest_of(trajectory, time):
    """The rest of a straight drive from `time` on, as a trajectory."""
    law, now = trajectory.time_law, trajectory.at(time)
    _, v, a, _ = law.at(time)[0]
    phase = int(np.searchsorted(law.times, time, side="right")) - 1
    durations = np.concatenate(([law.times[phase + 1] - time], law.durations[phase + 1 :]))
    gear = Direction(trajectory.path.segments[0].direction)
    left = clothoid(now.pose, [0.0, trajectory.path.length - now.s], [0.0, 0.0], gear)
    return Trajectory(Path((left,)), TimeLaw(durations, law.jerks[phase:], 0.0, v, a))


@functools.cache
def undisturbed(gear):
    """A straight drive, with stamps, poses and commands."""
    trajectory, controller = straight_drive(START, gear), configured()
    controller.set_path(trajectory)
    return trajectory, driven(controller, [0.02] * 330, stamp=50.0)


@pytest.mark.parametrize(("gear", "at"), [(Direction.FORWARD, 0.1), (Direction.FORWARD, 5.6), (Direction.REVERSE, 2.0)])
def test_change_of_trajectory_in_motion_does_not_change_the_commands(at, gear):
    trajectory, plain = undisturbed(gear)
    newer, joined = rest_of(trajectory, at), configured()
    joined.set_path(trajectory)
    stamp, pose, twist = 50.0, START, Twist2()
    for k, (following, moved, there) in enumerate(plain):
        if k == max(1, int((at - 0.15) / 0.02)):
            joined.set_path(newer, start_stamp=50.0 + at)
            assert joined.progress == ReferenceProgress(pytest.approx(stamp - 0.02 - 50.0 - at), 1.0)
        here = joined.compute_velocity_commands(pose, twist, None, stamp=stamp)
        assert max(abs(here.linear - there.linear), abs(here.angular - there.angular)) <= 2e-5
        stamp, pose, twist = following, moved, there
    assert joined.progress.time == pytest.approx(newer.duration)


def test_change_of_trajectory_at_a_low_rate():
    trajectory = straight_drive(START)
    reference = TrajectoryReference(trajectory)
    reference.time, reference.rate = 2.0, 0.5
    begin = trajectory.at(2.05)
    slower = Trajectory(straight_drive(begin.pose).path, TimeLaw(np.array([1.0, 9.0]), np.zeros(2), 0.0, 0.2))
    reference.joined_by(slower, 0.1)
    before, seen = reference.state().ahead.twist.linear, []
    for k in range(10):
        reference.look_ahead(0.02 * k, at_once=True)
        seen.append(reference.state().ahead.twist.linear)
    assert seen == pytest.approx([before] * 10, abs=1e-12)
    reference.look_ahead(0.0, at_once=True)
    for _ in range(10):
        reference.advance(
            reference.state(), 0.02, 0.5 if reference.trajectory is trajectory else 1.0, ROBOT.limits, 0.2
        )
    assert reference.progress.time == pytest.approx(0.1)
    assert reference.rate == pytest.approx(1.0)


def test_later_trajectories_are_replaced_or_appended():
    first, second, third = (straight_drive(START) for _ in range(3))
    reference = TrajectoryReference(first)
    reference.joined_by(second, 1.0)
    reference.joined_by(third, 2.0)
    assert reference.progress.time == pytest.approx(-2.0)
    assert reference.last is third
    reference.joined_by(second, 0.5)
    assert reference.progress.time == pytest.approx(-0.5)
    assert reference.last is second


def test_start_stamp_in_the_future_or_past():
    trajectory = straight_drive(START)
    early, late = configured(), configured()
    early.set_path(trajectory, start_stamp=100.5)
    assert all(twist == Twist2() for _, _, twist in driven(early, [0.02] * 20))
    assert early.progress.time == pytest.approx(100.38 - 100.5)
    late.set_path(trajectory, start_stamp=98.0)
    late.compute_velocity_commands(trajectory.at(2.0).pose, trajectory.at(2.0).twist, None, stamp=100.0)
    assert late.progress == ReferenceProgress(pytest.approx(2.0), 1.0)


def test_commands_restart_from_rest_after_a_clock_error():
    controller = configured()
    controller.set_path(straight_drive(START))
    stamp, pose, twist = driven(controller, [0.02] * 100)[-1]
    with pytest.raises(NoValidControl, match="clock went back"):
        controller.compute_velocity_commands(pose, twist, None, stamp=stamp - 1.0)
    assert controller.compute_velocity_commands(pose, Twist2(), None, stamp=stamp).linear < 0.02


def test_cancel_before_the_start_stamp():
    controller = configured()
    controller.set_path(straight_drive(START), start_stamp=200.0)
    driven(controller, [0.02] * 5)
    controller.cancel()
    driven(controller, [0.02] * 2, stamp=101.0)
    assert controller.cancel()


def test_replanning_does_not_reset_the_stall_detection():
    controller, trajectory, refusals = configured(), straight_drive(START), 0
    controller.set_path(trajectory)
    for k in range(300):
        if k % 25 == 24:
            now = controller.progress.time
            controller.set_path(rest_of(trajectory, max(now, 0.0) + 0.02), start_stamp=0.02 * k + 100.0)
            trajectory = controller._reference.last
        try:
            controller.compute_velocity_commands(START, Twist2(), None, stamp=100.0 + 0.02 * k)
        except NoValidControl as error:
            refusals += "does not follow" in str(error)
    assert refusals >= 1


def test_reference_at_its_end_stays_with_varying_periods():
    reference = TrajectoryReference(straight_drive(START))
    reference.time = reference.trajectory.duration
    for period in (0.020, 0.0201, 0.0199, 0.035, 0.02):
        reference.advance(reference.state(), period, 1.0, ROBOT.limits, 0.2)
        reference.look_ahead(0.06 + 0.5 * period)
        assert reference.finished
        assert reference.progress.time == reference.trajectory.duration
