"""MpcController: feed-forward, symmetries, limits under any error, and failures."""

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from checkers.dock_goal import DockGoalChecker
from optdock.controllers import mpc
from optdock.controllers.mpc import CycleOutcome, MpcController
from optdock.controllers.tracking_controller import TrackingController
from optdock.errors import NoValidControl
from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2, Twist2
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.path import Direction
from optdock.model.problem import DockingProblem
from optdock.model.robot import Drive, Robot, TrackingTube
from optdock.plugins.interfaces import PluginContext
from optdock.simulation import Actuation, DifferentialDrive, SimulationSettings, run_closed_loop
from optdock.testing.drives import clothoid, cusp_drive, rest_to_rest, s_curve_drive, straight_drive

START = Pose2(0.0, 0.0, 0.3)
LIMITS = MotionLimits(max_reverse_speed=0.5)
FOOTPRINT = Footprint.rectangle(0.4, 0.3, 0.5)
ROBOT = Robot(FOOTPRINT, LIMITS)
NARROW = MotionLimits(
    max_reverse_speed=0.5, max_yaw_rate=0.7, max_yaw_acceleration=2.0, max_lateral_acceleration=0.25,
    max_wheel_speed=0.52, track_width=0.3,
)  # fmt: skip
STEERED = MotionLimits(max_reverse_speed=0.5, max_curvature=2.0, wheelbase=0.3, max_steering_rate=0.6)
PERIOD = 0.04


def ready(trajectory, robot=ROBOT, controller=MpcController, **parameters):
    made = controller(**parameters)
    made.configure(PluginContext(problem=DockingProblem(START, Dock(trajectory.path.end), robot)))
    made.set_path(trajectory)
    return made


def drive(controller, trajectory, cycles, *, disturbance=None, robot=ROBOT, start=None, period=PERIOD):
    """Commands, true states and outcomes of perfect actuation; `disturbance(k)` is put between pose and controller."""
    plant = DifferentialDrive(robot, period=period)
    state = plant.at_rest(trajectory.path.start if start is None else start)
    commands, states, outcomes = [], [state], []
    for k in range(cycles):
        seen = state.pose if disturbance is None else state.pose @ disturbance(k)
        command = controller.compute_velocity_commands(seen, state.twist, None, stamp=k * period)
        state = plant.step(state, command)
        commands.append((command.linear, command.angular))
        states.append(state)
        outcomes.append(controller.status.outcome)
    return np.array(commands), states, outcomes


@pytest.mark.parametrize(("make", "rate"), [(lambda p: s_curve_drive(p, Direction.REVERSE), 15), (cusp_drive, 20)])
def test_on_the_reference_the_command_is_its_mean_motion(make, rate):
    trajectory = make(START)
    period, plant, controller = 1.0 / rate, DifferentialDrive(ROBOT, period=1.0 / rate), ready(trajectory)
    state = plant.at_rest(START)
    for k in range(round(trajectory.duration * rate)):
        command = controller.compute_velocity_commands(state.pose, state.twist, None, stamp=k * period)
        state = plant.step(state, command)
        now, then = (trajectory.at(controller.progress.time + later) for later in (0.0, period))
        assert controller.status.outcome is CycleOutcome.SOLVED
        if k > 40:  # the first period is unknown, which causes an error of 0.1 mm
            assert command.angular == pytest.approx((then.pose.yaw - now.pose.yaw) / period, abs=3e-4)
            assert abs(command.linear) == pytest.approx((then.s - now.s) / period, abs=1e-4)
            assert state.pose.distance_to(then.pose) < 5e-5


def curve(sign, direction):
    return rest_to_rest([clothoid(Pose2(0.0, 0.0, 0.0), [0.0, 0.6, 1.2], [0.0, 1.2 * sign, 0.0], direction)])


def test_left_and_right_and_both_gears_are_mirror_images():
    """Mirroring at the robot's axis changes the sign of the turns; at the dock's front that of speeds and turns."""
    error = Pose2(0.01, 0.02, 0.1)
    forward, reverse = Direction.FORWARD, Direction.REVERSE
    left, *_ = drive(ready(curve(1.0, forward)), curve(1.0, forward), 25, disturbance=lambda k: error)
    mirrored = Pose2(error.x, -error.y, -error.yaw)
    right, *_ = drive(ready(curve(-1.0, forward)), curve(-1.0, forward), 25, disturbance=lambda k: mirrored)
    assert np.abs(left - right * (1.0, -1.0)).max() < 1e-6
    back = Pose2(-error.x, error.y, -error.yaw)
    path = curve(-1.0, reverse)  # y over x mirrored at the y axis: headings too
    backward, *_ = drive(ready(path), path, 25, disturbance=lambda k: back)
    assert np.abs(left - backward * (-1.0, -1.0)).max() < 1e-6


def exceeded(commands, limits, period=PERIOD):
    """Excess of each limit, without the first command, whose period is another."""
    v, w = commands[1:].T
    gained, a = np.diff(np.abs(v)) / period, np.diff(v) / period
    same = v[1:] * v[:-1] >= 0.0
    return {
        "speed": np.abs(v).max() - 0.5,
        "rise": np.max(gained[same]) - limits.max_acceleration,
        "fall": -np.min(gained[same]) - limits.max_deceleration,
        "jerk": np.abs(np.diff(a)).max() / period - limits.max_jerk,
        "yaw rate": np.abs(w).max() - limits.max_yaw_rate,
        "yaw acceleration": np.abs(np.diff(w)).max() / period - limits.max_yaw_acceleration,
        "wheels": np.max(np.abs(v) + 0.5 * limits.track_width * np.abs(w)) - limits.max_wheel_speed,
        "lateral": np.abs(v * w).max() - limits.max_lateral_acceleration,
    }


errors = st.builds(Pose2, st.floats(-0.04, 0.04), st.floats(-0.04, 0.04), st.floats(-0.2, 0.2))


@settings(max_examples=3, phases=[Phase.generate])  # shrinking takes minutes
@given(jumps=st.lists(errors, min_size=4, max_size=4), reverse=st.booleans())
def test_the_limits_hold_for_any_errors(jumps, reverse):
    trajectory = s_curve_drive(START, Direction.REVERSE if reverse else Direction.FORWARD)
    robot = Robot(FOOTPRINT, NARROW)
    commands, _, outcomes = drive(
        ready(trajectory, robot), trajectory, 60, disturbance=lambda k: jumps[k // 15], robot=robot
    )
    over = exceeded(commands, NARROW)
    assert {name: value for name, value in over.items() if value > 2e-3} == {}, set(outcomes)


@settings(max_examples=2, phases=[Phase.generate])  # shrinking takes minutes
@given(jumps=st.lists(errors, min_size=4, max_size=4))
def test_steered_wheels_turn_no_further_and_no_faster_than_they_can(jumps):
    trajectory, robot = cusp_drive(START), Robot(FOOTPRINT, STEERED, Drive.ACKERMANN)
    commands, *_ = drive(ready(trajectory, robot), trajectory, 60, disturbance=lambda k: jumps[k // 15], robot=robot)
    moving = commands[np.abs(commands[:, 0]) > 1e-5]
    curvature = moving[:, 1] / moving[:, 0]
    assert np.abs(curvature).max() <= 2.0 + 1e-6
    both = np.abs(commands[1:, 0]) * np.abs(commands[:-1, 0]) > 1e-10
    angle = np.arctan(
        0.3
        * np.where(commands[:, 0] == 0.0, 0.0, commands[:, 1] / np.where(commands[:, 0] == 0.0, 1.0, commands[:, 0]))
    )
    assert np.abs(np.diff(angle))[both].max() / PERIOD <= 0.6 + 1e-3


def test_steering_rate_bounds_the_whole_horizon():
    """With a bound on the next command only, the robot ends with an offset of 9 cm."""
    trajectory = s_curve_drive(START)
    slow = MotionLimits(max_reverse_speed=0.5, max_curvature=2.0, wheelbase=0.3, max_steering_rate=0.5)
    robot, start = Robot(FOOTPRINT, slow, Drive.ACKERMANN), START @ Pose2(-0.02, 0.04, 0.05)
    checker = DockGoalChecker(along_tolerance=0.005, cross_tolerance=0.002)
    world = SimulationSettings(period=0.04, start=start)
    run = run_closed_loop(trajectory, robot, trajectory.path.end, ready(trajectory, robot), checker, world)
    assert run.docked, run.reason


def test_a_jump_before_the_end_is_corrected():
    """3 cm aside with 0.6 m left, of which the TrackingController leaves a quarter."""
    trajectory = straight_drive(START)
    period = PERIOD
    begin = 1.4 / 0.4 / period + 12
    jumped = Pose2(0.0, -0.03, 0.0)
    left = {}
    for controller in (MpcController, TrackingController):
        made = ready(trajectory, controller=controller)
        made.status = MpcController().status
        plant = DifferentialDrive(ROBOT, period=period)
        state = plant.at_rest(trajectory.path.start)
        for k in range(165):
            if k == round(begin):
                state = state._replace(pose=state.pose @ jumped)
            command = made.compute_velocity_commands(state.pose, state.twist, None, stamp=k * period)
            state = plant.step(state, command)
        left[controller] = abs(trajectory.path.end.in_frame_of(state.pose).y)
    assert left[MpcController] < 0.004
    assert left[TrackingController] > left[MpcController]


@pytest.mark.parametrize("known", [True, False])
def test_a_late_drive_is_predicted(known):
    """With lag and latency, known or identified, the robot stays on the path."""
    trajectory = s_curve_drive(START)
    late = Actuation(linear_lag=0.1, angular_lag=0.1, latency=0.06)
    given_values = {"latency": 0.06, "lag": 0.1} if known else {}
    controller = ready(trajectory, **given_values)
    checker = DockGoalChecker(along_tolerance=0.005)
    world = SimulationSettings(period=0.04, actuation=late)
    run = run_closed_loop(trajectory, ROBOT, trajectory.path.end, controller, checker, world)
    assert run.docked, run.reason
    path = trajectory.path.sample(0.001)
    off = [np.hypot(path.x - x, path.y - y).min() for x, y, _ in run.poses]
    assert max(off) < (0.001 if known else 0.003)


class TestTheTube:
    def outside(self, width, error):
        trajectory = straight_drive(START)
        controller = ready(trajectory, Robot(FOOTPRINT, LIMITS, tracking=TrackingTube(width, 0.05)))
        drive(controller, trajectory, 30)
        for k in range(30, 34):
            pose = trajectory.at(k * PERIOD).pose @ error
            controller.compute_velocity_commands(pose, Twist2(0.4, 0.0), None, stamp=k * PERIOD)
        return controller.status

    def test_no_excess_inside(self):
        assert self.outside(0.02, Pose2(0.0, 0.005, 0.0)).outside_tube < 1e-6

    def test_excess_outside_in_metres(self):
        status = self.outside(0.02, Pose2(0.0, 0.05, 0.0))
        assert 0.01 < status.outside_tube < 0.035
        assert status.outcome is CycleOutcome.SOLVED


def test_without_a_solution_previous_commands_continue_then_error(monkeypatch):
    trajectory = straight_drive(START)
    controller = ready(trajectory)
    drive(controller, trajectory, 30)
    monkeypatch.setattr(controller._program, "solve", lambda cycle: None)
    followed, k, refused = [], 30, None
    while refused is None:
        pose = trajectory.at(k * PERIOD).pose
        try:
            command = controller.compute_velocity_commands(pose, Twist2(0.4, 0.0), None, stamp=k * PERIOD)
        except NoValidControl as error:
            refused = error
        assert controller.status.outcome is CycleOutcome.SHIFTED
        followed.append(command.linear)
        k += 1
    assert "no commands were found" in str(refused)
    horizon = 0.4 / 0.6 + 0.6 / 2.0  # [s]: braking from 0.4 m/s takes longer than the parameter
    assert horizon - 0.2 < len(followed) * PERIOD < horizon + 0.2
    assert followed[0] == pytest.approx(trajectory.at(31 * PERIOD).twist.linear, abs=0.02)


def test_it_stops_before_an_obstacle():
    trajectory = straight_drive(Pose2(0.0, 0.0, 0.0), length=1.05)
    wall = ObstacleSet.from_polygons([np.array([[1.4, -1.0], [1.6, -1.0], [1.6, 1.0], [1.4, 1.0]])])
    controller = MpcController()
    problem = DockingProblem(Pose2(0.0, 0.0, 0.0), Dock(trajectory.path.end), ROBOT, obstacles=wall)
    controller.configure(PluginContext(problem=problem))
    controller.set_path(trajectory)
    with pytest.raises(NoValidControl, match="collision ahead"):
        drive(controller, trajectory, 125)


class TestFastAndLate:
    """1 m/s, a lag of 0.15 s, a latency of 0.1 s: braking takes longer than the default horizon."""

    ROBOT = Robot(FOOTPRINT, MotionLimits(max_speed=1.0, max_reverse_speed=1.0))
    LINE = rest_to_rest([clothoid(Pose2(0.0, 0.0, 0.0), [0.0, 3.0], [0.0, 0.0])], speed=1.0, acceleration=0.5)

    def run(self, **parameters):
        controller = ready(self.LINE, self.ROBOT, **parameters)
        world = SimulationSettings(period=0.04, actuation=Actuation(linear_lag=0.15, angular_lag=0.15, latency=0.1))
        return run_closed_loop(self.LINE, self.ROBOT, self.LINE.path.end, controller, DockGoalChecker(), world)

    def test_it_brakes_before_the_end(self, monkeypatch):
        run = self.run()
        assert run.docked, run.reason
        assert run.poses[:, 0].max() < 3.02
        monkeypatch.setattr(mpc, "braking_time", lambda *_: 0.0)
        assert self.run().poses[:, 0].max() > 3.05


def test_omitting_a_tiny_turn_does_not_slow_down():
    """The speed of such a command is the program's."""
    speeds = []
    for turn in (1e-6, 0.0):
        limiter = mpc._ProgramLimiter()
        limiter.follow(Twist2(), Twist2(), PERIOD, LIMITS, Drive.DIFFERENTIAL, in_place=True)
        for _ in range(25):
            acceleration = min(limiter.acceleration + LIMITS.max_jerk * PERIOD, LIMITS.max_acceleration)
            limiter.allowed = Twist2(limiter.command.linear + acceleration * PERIOD, 1e-6)
            wanted = Twist2(limiter.allowed.linear, turn)
            limiter.follow(wanted, Twist2(), PERIOD, LIMITS, Drive.DIFFERENTIAL, in_place=True)
        speeds.append(limiter.command.linear)
    assert speeds[0] == pytest.approx(speeds[1])
    assert speeds[0] == pytest.approx(0.5 * (1.0 - 0.5 * 0.5 / 2.0), abs=0.01)
