"""TrackingController: time base, limits, speed limit, cancel, finish."""

import itertools
import math

import numpy as np
import pytest

from checkers.axis import AxisGoalChecker
from checkers.dock_goal import DockGoalChecker
from optdock.controllers import tracking_law
from optdock.controllers.tracking_controller import TrackingController
from optdock.controllers.tracking_law import DelayBounds, Gains
from optdock.errors import ControllerInvalidPath, InvalidValue, NoValidControl
from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2, Twist2
from optdock.model.costmap import Costmap
from optdock.model.dock import Dock, DockTolerances
from optdock.model.limits import MotionLimits
from optdock.model.path import Direction, Path
from optdock.model.problem import DockingProblem
from optdock.model.robot import Drive, Robot
from optdock.plugins.interfaces import PluginContext
from optdock.simulation import Actuation, DifferentialDrive, SimulatedRobot, SimulationSettings, run_closed_loop
from optdock.testing.drives import clothoid, cusp_drive, rest_to_rest, s_curve_drive, straight_drive
from optdock.verification import pose_clearances

START = Pose2(0.0, 0.0, 0.3)
LIMITS = MotionLimits(max_acceleration=0.5, max_deceleration=0.6)
ROBOT = Robot(Footprint.rectangle(0.4, 0.3, 0.5), LIMITS)
PERIOD = 0.04
STAMPS = itertools.count(0.0, PERIOD)  # of every call in this file


def context(robot=ROBOT, goal=START):
    return PluginContext(problem=DockingProblem(START, Dock(goal), robot))


def drive(controller, trajectory, cycles, on_cycle=None, state=None, robot=ROBOT):
    """Commands and poses of `cycles` periods of perfect actuation."""
    plant = DifferentialDrive(robot, period=PERIOD)
    state = state or plant.at_rest(trajectory.path.start)
    commands, states = [], [state]
    for k in range(cycles):
        if on_cycle:
            on_cycle(k)
        command = controller.compute_velocity_commands(state.pose, state.twist, None, stamp=next(STAMPS))
        state = plant.step(state, command)
        commands.append(command)
        states.append(state)
    return commands, states


def ready(trajectory, robot=ROBOT, **parameters):
    controller = TrackingController(**parameters)
    controller.configure(context(robot))
    controller.set_path(trajectory)
    return controller


def accelerations(commands):
    return np.diff([c.linear for c in commands], prepend=0.0) / PERIOD


def test_error_without_a_path():
    with pytest.raises(ControllerInvalidPath, match="call set_path first"):
        TrackingController().compute_velocity_commands(START, Twist2(), None, stamp=next(STAMPS))
    controller = ready(straight_drive(START))
    controller.reset()
    with pytest.raises(ControllerInvalidPath, match="no path"):
        controller.compute_velocity_commands(START, Twist2(), None, stamp=next(STAMPS))


def test_given_period():
    trajectory = straight_drive(START)
    for period in (0.02, 0.05):
        plant = DifferentialDrive(ROBOT, period=period)
        controller, state = ready(trajectory, period=period), plant.at_rest(START)
        for _ in range(round(2.0 / period)):
            state = plant.step(state, controller.compute_velocity_commands(state.pose, state.twist, None))
        assert state.pose.distance_to(trajectory.at(2.0).pose) < 2e-4


@pytest.mark.parametrize("direction", [Direction.FORWARD, Direction.REVERSE])
def test_commands_keep_the_acceleration_limits_from_a_bad_start_and_with_noise(direction):
    trajectory = s_curve_drive(START, direction)
    checker = AxisGoalChecker(along_path_tolerance=0.003, cross_track_tolerance=0.03)
    world = SimulationSettings(
        period=PERIOD, position_noise=0.005, yaw_noise=0.01, start=START @ Pose2(0.04, -0.05, 0.2)
    )
    controller = ready(trajectory)
    found = run_closed_loop(trajectory, ROBOT, trajectory.path.end, controller, checker, world)
    assert found.docked, found.reason
    v = np.append(0.0, found.commands[:-1, 0])
    gained = np.diff(np.abs(v)) / PERIOD
    assert gained.max() <= 0.5 + 1e-9
    assert gained.min() >= -0.6 - 1e-9
    assert np.abs(v).max() <= (0.5 if direction is Direction.FORWARD else 0.3) + 1e-12


def test_an_ackermann_robot_gets_no_command_tighter_than_its_smallest_radius():
    robot = Robot(ROBOT.footprint, MotionLimits(max_curvature=1.3), Drive.ACKERMANN)
    trajectory = s_curve_drive(START)
    commands, _ = drive(
        ready(trajectory, robot), trajectory, 60, state=DifferentialDrive(robot).at_rest(START @ Pose2(0, 0.04, 0))
    )
    assert all(abs(c.angular) <= 1.3 * abs(c.linear) + 1e-12 for c in commands)


def test_an_ackermann_robot_arrives_from_an_offset():
    robot = Robot(ROBOT.footprint, MotionLimits(max_curvature=2.0), Drive.ACKERMANN)
    trajectory = s_curve_drive(START)
    checker = AxisGoalChecker(along_path_tolerance=0.003, cross_track_tolerance=0.02)
    world = SimulationSettings(period=PERIOD, start=START @ Pose2(-0.02, 0.04, 0.05))
    controller = ready(trajectory, robot)
    found = run_closed_loop(trajectory, robot, trajectory.path.end, controller, checker, world)
    assert found.docked, found.reason
    assert abs(found.final_error.y) < 0.001


class TestSpeedLimit:
    def test_as_a_percentage_scales_the_whole_drive(self):
        trajectory = straight_drive(START, length=0.6)
        controller = ready(trajectory)
        controller.set_speed_limit(50.0, percentage=True)
        commands, states = drive(controller, trajectory, math.ceil(2.0 * trajectory.duration / PERIOD) + 3)
        peak = np.abs(trajectory.time_law.states[:, 1]).max()
        assert max(c.linear for c in commands) == pytest.approx(0.5 * peak, abs=1e-3)
        assert states[-1].pose.distance_to(trajectory.path.end) < 1e-4

    def test_in_metres_per_second_bounds_the_peak_in_either_gear(self):
        trajectory = s_curve_drive(START, Direction.REVERSE)
        controller = ready(trajectory, Robot(ROBOT.footprint, MotionLimits(max_reverse_speed=0.5)))
        controller.set_speed_limit(0.1, percentage=False)
        commands, _ = drive(controller, trajectory, 100)
        assert min(c.linear for c in commands) == pytest.approx(-0.1, abs=1e-3)

    def test_set_and_lifted_on_the_way_keeps_the_acceleration_limits_and_the_path(self):
        trajectory = s_curve_drive(START)
        controller = ready(trajectory)

        def change(k):
            if k == 60:
                controller.set_speed_limit(0.15, percentage=False)
            if k == 130:
                controller.set_speed_limit(0.0, percentage=False)

        commands, states = drive(controller, trajectory, 250, change)
        assert commands[120].linear == pytest.approx(0.15, abs=2e-3)
        gained = accelerations(commands)
        assert gained.max() <= 0.5 + 1e-9
        assert gained.min() >= -0.6 - 1e-9
        assert states[-1].pose.distance_to(trajectory.path.end) < 1e-4
        path = trajectory.path.sample(0.001)
        off = [np.hypot(path.x - q.pose.x, path.y - q.pose.y).min() for q in states]
        assert max(off) < 0.002

    def test_above_the_trajectory_changes_nothing(self):
        trajectory = straight_drive(START)
        limited, free = ready(trajectory), ready(trajectory)
        limited.set_speed_limit(5.0, percentage=False)
        assert drive(limited, trajectory, 30)[0] == drive(free, trajectory, 30)[0]

    def test_negative_is_refused(self):
        with pytest.raises(InvalidValue, match="speed limit"):
            TrackingController().set_speed_limit(-0.1, percentage=False)


class TestCancel:
    @pytest.mark.parametrize(
        ("make", "cycle"),
        [
            (s_curve_drive, 5),
            (s_curve_drive, 75),
            (lambda p: s_curve_drive(p, Direction.REVERSE), 30),
            (cusp_drive, 75),
        ],
    )
    def test_brakes_along_the_path_within_the_limits(self, make, cycle):
        trajectory, robot = make(START), Robot(ROBOT.footprint, MotionLimits(max_reverse_speed=0.5))
        controller = ready(trajectory, robot)
        stopped = []

        def cancelling(k):
            if k >= cycle:
                stopped.append(controller.cancel())

        commands, states = drive(controller, trajectory, cycle + 40, cancelling, robot=robot)
        assert not stopped[0]
        assert stopped[-1]
        first = stopped.index(True)
        assert all(c == Twist2() for c in commands[cycle + first :])
        assert commands[cycle + first - 2] != Twist2()
        assert first * PERIOD <= 0.4 / 0.6 + (0.4 + 0.6) / 2.0 + 0.35  # the jerk is limited too
        gained = np.diff(np.abs([c.linear for c in commands])) / PERIOD
        assert gained.min() >= -0.6 - 1e-9
        path = trajectory.path.sample(0.001)
        assert np.hypot(path.x - states[-1].pose.x, path.y - states[-1].pose.y).min() < 0.001

    def test_before_the_first_command_there_is_nothing_to_stop(self):
        assert TrackingController().cancel()
        assert ready(straight_drive(START)).cancel()


def test_reference_waits_for_a_blocked_robot_then_error():
    trajectory = straight_drive(START)
    controller = ready(trajectory)
    for _ in range(75):
        command = controller.compute_velocity_commands(START, Twist2(), None, stamp=next(STAMPS))
    assert 0.0 < command.linear <= 0.5
    assert controller.progress.rate < 0.1
    error = refusal(controller, lambda now: START, 100)
    assert "does not follow: for 3 s the reference has waited" in str(error)
    assert 0.08 < error.where["along"] < 0.12
    _, states = drive(controller, trajectory, 200)
    assert states[-1].pose.distance_to(trajectory.path.end) < 1e-4


def refusal(controller, pose_at, cycles, checker=None):
    """The error that ends a run of a robot held at `pose_at`."""

    def hold():
        for _ in range(cycles):
            pose = pose_at(controller.progress)
            controller.compute_velocity_commands(pose, Twist2(), checker, stamp=next(STAMPS))

    with pytest.raises(NoValidControl) as caught:
        hold()
    return caught.value


def test_error_far_from_the_reference():
    controller = ready(straight_drive(START), max_error=0.3)
    with pytest.raises(NoValidControl, match=r"0\.400 m and 0\.000 rad from the reference") as caught:
        controller.compute_velocity_commands(START @ Pose2(0.0, 0.4, 0.0), Twist2(), None, stamp=next(STAMPS))
    assert caught.value.where["cross"] == pytest.approx(-0.4)


def test_error_at_a_large_heading_error():
    with pytest.raises(NoValidControl, match=r"1\.500 rad from the reference"):
        ready(straight_drive(START)).compute_velocity_commands(
            START @ Pose2(0.0, 0.0, 1.5), Twist2(), None, stamp=next(STAMPS)
        )


def test_robot_in_the_middle_joins_the_trajectory_there():
    trajectory = s_curve_drive(START)
    middle = trajectory.at(3.0).pose
    controller = ready(trajectory)
    commands, states = drive(controller, trajectory, 150, state=DifferentialDrive(ROBOT).at_rest(middle))
    assert accelerations(commands).max() <= 0.5 + 1e-9
    assert states[-1].pose.distance_to(trajectory.path.end) < 1e-3


class TestTheFinish:
    dead = SimulationSettings(
        period=PERIOD, actuation=Actuation(linear_dead_band=0.08, angular_dead_band=0.05), timeout=20.0
    )

    def run(self, checker, settings, **parameters):
        trajectory = straight_drive(START)
        controller = ready(trajectory, **parameters)
        return run_closed_loop(trajectory, ROBOT, trajectory.path.end, controller, checker, settings)

    @pytest.mark.parametrize("known", [{}, {"min_speed": 0.08, "min_yaw_rate": 0.05}])
    def test_a_dead_band_does_not_keep_it_from_its_goal(self, known):
        checker = AxisGoalChecker(along_path_tolerance=0.008, cross_track_tolerance=0.05)
        run = self.run(checker, self.dead, **known)
        assert run.docked, run.reason

    @pytest.mark.parametrize("gear", [Direction.FORWARD, Direction.REVERSE])
    def test_lateral_error_that_stays_is_an_error(self, gear):
        trajectory = straight_drive(START, gear, 0.6)
        controller, checker = ready(trajectory), DockGoalChecker(cross_tolerance=0.01)
        aside = trajectory.path.end @ Pose2(0.0, 0.022, 0.0)
        ends = trajectory.duration - 0.1

        def held(now):
            return trajectory.at(max(0.0, now.time)).pose if now.time < ends else aside

        error = refusal(controller, held, round((trajectory.duration + 6.0) / PERIOD), checker)
        assert "cannot get any closer" in str(error)
        assert "0.022 m across" in str(error)
        assert error.where["cross"] == pytest.approx(-0.022)

    def test_errors_at_the_end_decay_to_zero(self):
        trajectory = straight_drive(START)
        controller = ready(trajectory)
        late = DifferentialDrive(ROBOT).at_rest(trajectory.path.end @ Pose2(-0.04, 0.0, 0.1))
        _, states = drive(controller, trajectory, 250, state=late)
        left = trajectory.path.end.in_frame_of(states[-1].pose)
        assert abs(left.x) < 1e-4
        assert abs(left.yaw) < 1e-4

    def test_the_smallest_speed_rests_within_half_the_checkers_tolerance(self):
        trajectory = straight_drive(START, length=0.6)
        checker = AxisGoalChecker(along_path_tolerance=0.02, cross_track_tolerance=0.02)
        controller = ready(trajectory, min_speed=0.03)
        near = trajectory.path.end @ Pose2(-0.009, 0.0, 0.0)
        assert abs(finishing(controller, trajectory, near, checker).linear) < 0.03
        off = trajectory.path.end @ Pose2(-0.011, 0.0, 0.0)
        assert finishing(controller, trajectory, off, checker).linear >= 0.03


def finishing(controller, trajectory, pose, checker):
    """The command soon after the trajectory's end, with the robot held at `pose`."""
    controller.set_path(trajectory)
    for _ in range(round(trajectory.duration / PERIOD) + 10):
        command = controller.compute_velocity_commands(pose, Twist2(), checker, stamp=next(STAMPS))
    return command


def test_a_path_is_timed_before_it_is_followed():
    path = s_curve_drive(START).path
    controller = TrackingController()
    controller.configure(context(goal=path.end))
    controller.set_path(path)
    checker = AxisGoalChecker(along_path_tolerance=0.003, cross_track_tolerance=0.02)
    plant = DifferentialDrive(ROBOT, period=PERIOD)
    state = plant.at_rest(START)
    for _ in range(400):
        if checker.is_goal_reached(state.pose, path.end, state.twist, [path.pose_at(path.length - 0.1), path.end]):
            break
        state = plant.step(
            state, controller.compute_velocity_commands(state.pose, state.twist, checker, stamp=next(STAMPS))
        )
    assert state.pose.distance_to(path.end) < 0.004


class TestCollisions:
    """A wall 1 m ahead of the robot, and a drive that ends 5 cm inside it."""

    WALL = np.array([[1.4, -1.0], [1.6, -1.0], [1.6, 1.0], [1.4, 1.0]])
    AHEAD = straight_drive(Pose2(0.0, 0.0, 0.0), length=1.05)

    def worlds(self):
        def task(**known):
            return DockingProblem(Pose2(0.0, 0.0, 0.0), Dock(self.AHEAD.path.end), ROBOT, **known)

        free = Costmap(np.zeros((80, 120), dtype=np.uint8), 0.05, (-3.0, -2.0))
        cells = free.data.copy()
        cells[20:60, 88:92] = 254
        walled, outline = free.with_data(cells), ROBOT.footprint
        return {
            "polygon": PluginContext(problem=task(obstacles=ObstacleSet.from_polygons([self.WALL]))),
            "costmap of the problem": PluginContext(problem=task(costmap=walled)),
            "costmap and outline": PluginContext(costmap=walled, footprint=outline),
            "local costmap": PluginContext(problem=task(costmap=free), local_costmap=walled),
            "behind a local costmap": PluginContext(costmap=walled, local_costmap=free, footprint=outline),
        }

    def driven(self, surroundings, trajectory=AHEAD, **parameters):
        """The final state, and the error that ended the drive; None without one."""
        controller = TrackingController(**parameters)
        controller.configure(surroundings)
        controller.set_path(trajectory)
        plant = DifferentialDrive(ROBOT, period=PERIOD)
        state = plant.at_rest(trajectory.path.start)
        for _ in range(200):
            try:
                command = controller.compute_velocity_commands(state.pose, state.twist, None, stamp=next(STAMPS))
            except NoValidControl as error:
                return state, error
            state = plant.step(state, command)
        return state, None

    @pytest.mark.parametrize(
        "world", ["polygon", "costmap of the problem", "costmap and outline", "local costmap", "behind a local costmap"]
    )
    def test_it_stops_before_contact(self, world):
        state, error = self.driven(self.worlds()[world])
        assert error is not None
        rest = state.pose.x + state.twist.linear**2 / (2.0 * LIMITS.max_deceleration)
        assert 0.97 < rest <= 1.0 + 1e-9  # the nose stands at the wall where x is 1 m
        assert error.where["depth"] > 0.0
        assert "collision ahead" in str(error)

    def tried(self, surroundings, trajectory, aside, noise):
        """Poses of a robot that begins aside and tries again after every error, and the number of errors."""
        controller = TrackingController()
        controller.configure(surroundings)
        controller.set_path(trajectory)
        plant, rng, refused = DifferentialDrive(ROBOT, period=PERIOD), np.random.default_rng(1), 0
        state, poses = plant.at_rest(trajectory.path.start @ Pose2(0.0, aside, 0.0)), []
        for _ in range(125):
            seen = state.pose @ Pose2(*rng.normal(0.0, noise, 2).tolist(), 0.0)
            try:
                command = controller.compute_velocity_commands(seen, state.twist, None, stamp=next(STAMPS))
            except NoValidControl:
                command, refused = Twist2(), refused + 1
            state = plant.step(state, command)
            poses.append(state.pose.as_array())
        return np.array(poses), refused

    def test_lateral_error_does_not_count_as_noise(self):
        poses, refused = self.tried(self.worlds()["polygon"], self.AHEAD, 0.2, 0.0)
        assert refused > 0
        wall = ObstacleSet.from_polygons([self.WALL])
        assert pose_clearances(poses, ROBOT.footprint, wall)[0].min() > -1e-4

    def test_noise_does_not_block_a_passage(self):
        sides = [np.array([[0.9, y], [1.2, y], [1.2, y + 0.1], [0.9, y + 0.1]]) for y in (0.252, -0.352)]
        target = DockingProblem(
            Pose2(0.0, 0.0, 0.0), Dock(self.AHEAD.path.end), ROBOT, ObstacleSet.from_polygons(sides)
        )
        poses, refused = self.tried(PluginContext(problem=target), self.AHEAD, 0.0, 0.001)
        assert refused == 0
        assert poses[-1, 0] == pytest.approx(1.05, abs=0.005)

    def test_collision_detection_can_be_switched_off(self):
        state, error = self.driven(self.worlds()["polygon"], use_collision_detection=False)
        assert error is None
        assert state.pose.x == pytest.approx(1.05, abs=0.002)

    def test_trajectory_ending_in_contact_with_noise(self):
        touching = straight_drive(Pose2(0.0, 0.0, 0.0), length=1.0)
        surroundings = self.worlds()["polygon"]
        for seed in range(2):
            controller = TrackingController()
            controller.configure(surroundings)
            world = SimulationSettings(
                position_noise=0.002, yaw_noise=0.002, seed=seed, actuation=Actuation(0.06, 0.06)
            )
            checker = DockGoalChecker(along_tolerance=0.005)
            run = run_closed_loop(touching, ROBOT, touching.path.end, controller, checker, world)
            assert run.docked, run.reason

    def test_a_robot_that_is_too_deep_may_drive_out(self):
        out = straight_drive(Pose2(1.05, 0.0, 0.0), Direction.REVERSE, length=0.9)
        state, error = self.driven(self.worlds()["polygon"], out)
        assert error is None
        assert state.pose.x == pytest.approx(0.15, abs=0.002)

    def test_it_continues_from_rest_once_the_way_is_free(self):
        worlds = self.worlds()
        live = worlds["costmap and outline"].costmap
        grid = Costmap.writable(live.data.shape, live.resolution, live.origin)
        grid.data[:] = live.data
        controller = TrackingController()
        controller.configure(PluginContext(costmap=grid, footprint=ROBOT.footprint))
        controller.set_path(self.AHEAD)
        plant = DifferentialDrive(ROBOT, period=PERIOD)
        state, refusals = plant.at_rest(Pose2(0.0, 0.0, 0.0)), 0
        for _ in range(225):
            try:
                command = controller.compute_velocity_commands(state.pose, state.twist, None, stamp=next(STAMPS))
            except NoValidControl:
                refusals += 1
                command = Twist2()
                if refusals == 20:
                    grid.data[:] = 0
            assert not (refusals and command.linear - state.twist.linear > LIMITS.max_acceleration * PERIOD + 1e-9)
            state = plant.step(state, command)
        assert refusals == 20
        assert state.pose.x == pytest.approx(1.05, abs=0.003)


def test_a_new_path_in_motion_is_taken_up_without_a_stop():
    trajectory = straight_drive(START)
    controller = ready(trajectory)
    commands, states = drive(controller, trajectory, 40)
    ahead = Path.from_poses([states[-1].pose, trajectory.path.end @ Pose2(1.0, 0.0, 0.0)])
    controller.set_path(ahead)
    more, _ = drive(controller, trajectory, 25, state=states[-1])
    assert commands[-1].linear == pytest.approx(0.4, abs=1e-3)
    assert min(command.linear for command in more) > 0.39
    assert abs(np.diff([commands[-1].linear, *(c.linear for c in more)])).max() <= 0.5 * PERIOD + 1e-9


@pytest.mark.parametrize("reserve", [0.0, 0.2])
def test_the_reference_leaves_feedback_a_share_of_the_yaw_acceleration(reserve):
    trajectory = s_curve_drive(START)
    times = np.linspace(0.0, trajectory.duration, 2000)
    peak = float(np.max(np.abs(trajectory.sample_at(times).yaw_acceleration)))
    robot = Robot(ROBOT.footprint, MotionLimits(max_yaw_acceleration=peak))
    controller, used, times = ready(trajectory, robot, turn_reserve=reserve, preview=0.0), [], []

    def look(_):
        time, rate = controller.progress
        times.append(time)
        used.append(rate**2 * abs(trajectory.sample_at(time).yaw_acceleration[0]) / peak)

    cycles = math.ceil(1.2 * trajectory.duration / PERIOD)
    drive(controller, trajectory, cycles, look, robot=robot)
    assert max(used) == pytest.approx(1.0 - reserve, abs=0.02 + 0.1 * reserve)  # the rate comes down smoothly
    slowest = trajectory.duration / math.sqrt(1.0 - reserve) + 0.1
    assert times[math.ceil(slowest / PERIOD)] == trajectory.duration


def test_reference_rate_of_steered_wheels():
    trajectory = s_curve_drive(START)
    for kind, rate in ((Drive.ACKERMANN, 0.99), (Drive.DIFFERENTIAL, 1.0)):
        robot = Robot(ROBOT.footprint, LIMITS, kind)
        controller = ready(trajectory, robot)
        drive(controller, trajectory, 30, robot=robot)
        assert controller.progress.rate == pytest.approx(rate, abs=1e-3)


class TestLateDrive:
    """A lag of 0.15 s, a latency of 0.1 s, poses with 1 cm and 0.02 rad of noise, a robot that turns slowly."""

    def off_line(self, seed):
        """Largest deviation from a straight line of 5 m at 0.8 m/s [m]."""
        limits = MotionLimits(max_speed=1.0, max_yaw_acceleration=0.8)
        robot, origin = Robot(ROBOT.footprint, limits), Pose2(0.0, 0.0, 0.0)
        trajectory = rest_to_rest([clothoid(origin, [0.0, 5.0], [0.0, 0.0])], speed=0.8)
        controller = TrackingController()
        controller.configure(PluginContext(problem=DockingProblem(origin, Dock(trajectory.path.end), robot)))
        world = SimulationSettings(
            period=0.1,
            actuation=Actuation(linear_lag=0.15, angular_lag=0.15, latency=0.1),
            position_noise=0.01,
            yaw_noise=0.02,
            seed=seed,
        )
        checker = AxisGoalChecker(along_path_tolerance=0.05, cross_track_tolerance=0.05)
        run = run_closed_loop(trajectory, robot, trajectory.path.end, controller, checker, world)
        return float(np.abs(run.poses[:, 1]).max())

    def test_it_does_not_weave(self, monkeypatch):
        assert max(self.off_line(seed) for seed in range(2)) < 0.02
        monkeypatch.setattr(tracking_law, "delay_bounds", lambda *_: DelayBounds(math.inf, 0.0))
        assert self.off_line(0) > 0.1


class TestBeforeTheEnd:
    """A push shortly before the end of a straight line at 0.1 m/s, in a drive that is 0.15 s late."""

    LINE = rest_to_rest([clothoid(Pose2(0.0, 0.0, 0.0), [0.0, 0.6], [0.0, 0.0])], speed=0.1)

    def left(self, push, at):
        """Lateral [m] and heading error [rad] at the end of the reference, after a push `at` metres before it."""
        controller = TrackingController()
        dock = Dock(self.LINE.path.end, tolerances=DockTolerances(0.01, 0.01, math.radians(1.5)))
        controller.configure(PluginContext(problem=DockingProblem(Pose2(0.0, 0.0, 0.0), dock, ROBOT)))
        controller.set_path(self.LINE)
        world = SimulatedRobot(DifferentialDrive(ROBOT, Actuation(0.05, 0.05, 0.1)), Pose2(0.0, 0.0, 0.0), dock.pose)
        pushed = False
        while controller.progress is None or controller.progress.time < self.LINE.duration:
            if not pushed and world.error.x > -at:
                world.state, pushed = world.state._replace(pose=world.state.pose @ push), True
            command = controller.compute_velocity_commands(
                world.state.pose, world.measurements.twist, DockGoalChecker(), stamp=world.time
            )
            world.advance(command, 0.04)
        return abs(world.error.y), abs(world.error.yaw)

    def test_late_offset_does_not_turn_the_robot(self, monkeypatch):
        across, turned = self.left(Pose2(0.0, 0.004, 0.0), 0.05)
        assert across < 0.0045
        assert turned < math.radians(0.3)
        shortest = Gains(2.0, 0.05, 1.0, 1.0)
        monkeypatch.setattr(tracking_law.FeedbackGains, "update", lambda *_, **__: shortest)
        assert self.left(Pose2(0.0, 0.004, 0.0), 0.05)[1] > math.radians(0.8)

    def test_late_turn_is_corrected_fast(self, monkeypatch):
        across, turned = self.left(Pose2(0.0, 0.0, math.radians(3.0)), 0.1)
        assert across < 0.005
        assert turned < math.radians(0.3)
        monkeypatch.setattr(tracking_law, "_LEFT", math.inf)
        monkeypatch.setattr(tracking_law, "_QUICKEST_TURN", 1.0)
        assert self.left(Pose2(0.0, 0.0, math.radians(3.0)), 0.1)[1] > math.radians(0.6)
