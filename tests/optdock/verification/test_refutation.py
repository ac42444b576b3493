"""Samples of honest motions are not refuted at any period and rounding; samples of other motions are."""

import dataclasses

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from experiments.families import FEASIBLE_FAMILIES, instance
from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2
from optdock.io.plan_file import TrajectoryColumns
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.constant_jerk import TimeLaw
from optdock.model.dock import Dock
from optdock.model.limits import DIMENSIONS, LimitKind, MotionLimits, SpeedZone
from optdock.model.limits import LIMITS as KINDS
from optdock.model.path import ClothoidSegment, Path, TurnSegment, joint_curvatures
from optdock.model.problem import DockingProblem
from optdock.model.robot import Drive, Robot
from optdock.model.trajectory import Trajectory
from optdock.planning.pipeline import plan_dock
from optdock.plugins.interfaces import TimeParameterizer
from optdock.plugins.registry import create_plugin
from optdock.samples import check_sampled_motion, check_samples_of
from optdock.verification import certify_path, certify_trajectory

LIMITS = MotionLimits(
    max_yaw_rate=0.6, max_yaw_acceleration=1.2, max_lateral_acceleration=0.2, max_wheel_speed=0.5, track_width=0.4,
    max_lateral_jerk=0.25,
)  # fmt: skip
ZONE = SpeedZone(0.1, 0.3)
TIMER = create_plugin(TimeParameterizer, "Windowed")


def two_gears(bend, first_length=1.2, second_length=1.0):
    first = ClothoidSpline(Pose2(1.0, -1.0, 0.7), np.array([0.0, first_length]), np.array([0.0, bend]))
    second = ClothoidSpline(first.end, np.array([0.0, second_length]), np.array([-bend, 0.0]), -1)
    return Path((ClothoidSegment(first), ClothoidSegment(second)))


ORIGIN = Pose2(0.0, 0.0, 0.0)


def curve(knots, curvature, start=ORIGIN, sign=1):
    return Path((ClothoidSegment(ClothoidSpline(start, np.array(knots), np.array(curvature), sign)),))


def problem_of(path, limits=LIMITS, zone=ZONE, **options):
    robot = Robot(Footprint.rectangle(0.4, 0.4, 0.6), limits)
    return DockingProblem(
        path.start, Dock(path.end, approach_speed=zone.speed, approach_distance=zone.distance), robot, **options
    )


def timed(path, limits=LIMITS, zone=ZONE, start_speed=0.0):
    trajectory = TIMER.parameterize(path, limits, zone, start_speed=start_speed).trajectory
    assert certify_trajectory(trajectory, limits, zone, start_speed=start_speed).certified
    return trajectory


def motion_of(path, period=0.02, **options):
    return TrajectoryColumns.from_trajectory(timed(path, **options), period)


def rounded(motion, decimals):
    return TrajectoryColumns(motion.t, *(np.round(column, decimals) for column in motion[1:]))


def messages(motion, path, problem):
    return [violation.message for violation in check_sampled_motion(motion, path, problem).violations]


def rest_to_rest(path, speed=0.3, acceleration=0.15, jerk=0.5, period=0.02):
    """Columns of a motion with seven phases of constant jerk along `path`."""
    ramp, hold = acceleration / jerk, speed / acceleration - acceleration / jerk
    cruise = path.length / speed - 2.0 * ramp - hold
    durations = np.array([ramp, hold, ramp, cruise, ramp, hold, ramp])
    law = TimeLaw(durations, jerk * np.array([1.0, 0.0, -1.0, 0.0, -1.0, 0.0, 1.0]))
    return TrajectoryColumns.from_trajectory(Trajectory(path, law), period)


# Honest motions.


@settings(max_examples=15)
@example(5e-324, 1.0, 0.7, 0.02, None)
@example(-1e-310, 0.5, 1.2, 0.02, 6)
@given(
    st.floats(-1.5, 1.5),
    st.floats(0.3, 2.0),
    st.floats(0.4, 2.0),
    st.floats(0.005, 0.2),
    st.sampled_from([None, 9, 6, 5, 4, 3]),
)
def test_samples_of_a_certified_motion_refute_nothing(bend, first, second, period, decimals):
    path = two_gears(bend, first, second)
    motion = motion_of(path, period)
    assert messages(motion if decimals is None else rounded(motion, decimals), path, problem_of(path)) == []


STEERED = dataclasses.replace(LIMITS, wheelbase=0.6, max_steering_rate=0.4)


def steered_problem(path, zone=ZONE):
    robot = Robot(Footprint.rectangle(0.4, 0.4, 0.6), STEERED, Drive.ACKERMANN)
    dock = Dock(path.end, approach_speed=zone.speed, approach_distance=zone.distance)
    return DockingProblem(path.start, dock, robot, start_curvature=float(path.curvature_at(0.0)[0]))


def unsteered_gears(bend, kept=0.5):
    """Two gears between which the wheels turn: along the travel the curvature stays what it was."""
    first = ClothoidSpline(Pose2(1.0, -1.0, 0.7), np.array([0.0, 1.2]), np.array([0.0, bend]))
    second = ClothoidSpline(first.end, np.array([0.0, 1.0]), np.array([kept * bend, 0.0]), -1)
    return Path((ClothoidSegment(first), ClothoidSegment(second)))


@settings(max_examples=15)
@given(st.floats(0.1, 1.5), st.floats(-1.0, 1.0), st.floats(0.005, 0.3), st.sampled_from([None, 9, 6, 5, 4, 3]))
def test_samples_of_a_steered_motion_refute_nothing(bend, kept, period, decimals):
    path = unsteered_gears(bend, kept)
    motion = motion_of(path, period, limits=STEERED)
    assert messages(motion if decimals is None else rounded(motion, decimals), path, steered_problem(path)) == []


@pytest.mark.parametrize("late", [0.0, 1e-4, 7e-4, 5e-3])
def test_a_sample_just_behind_a_cusp_is_not_judged_by_the_gear_before_it(late):
    path = unsteered_gears(1.0, 1.0)
    trajectory = timed(path, limits=STEERED)
    wait = STEERED.steering_times(joint_curvatures(path))[0]
    times = np.union1d(trajectory.sample(0.02).t, trajectory.cusp_times + wait + late)
    samples = trajectory.sample_at(times)
    motion = TrajectoryColumns(**{name: getattr(samples, name) for name in TrajectoryColumns._fields})
    assert messages(motion, path, steered_problem(path)) == []


@pytest.mark.parametrize("period", [0.005, 0.05, 0.2])
def test_samples_of_wheels_that_turn_too_fast_are_refuted(period):
    path = curve([0.0, 0.5, 1.0, 1.5], [0.0, 1.4, -1.0, 0.0])
    found = messages(motion_of(path, period), path, steered_problem(path))
    assert any(message.startswith("steering rate") for message in found)
    path = curve([0.0, 1.0], [-1.4, 1.4])  # the wheels turn fastest midway, where no knot is
    found = messages(motion_of(path, period), path, steered_problem(path))
    assert any(message.startswith("steering rate [rad/s]") for message in found)
    path = unsteered_gears(0.5)
    found = check_sampled_motion(motion_of(path, period), path, steered_problem(path)).violations
    assert "rest" in [violation.kind for violation in found]


@pytest.mark.parametrize("number", range(len(FEASIBLE_FAMILIES)))
def test_no_family_is_refuted_at_any_period(number):
    drawn = instance(sorted(FEASIBLE_FAMILIES)[number], number % 3)
    timer = create_plugin(TimeParameterizer, ("NearOptimal", "Windowed")[number % 2])
    limits = dataclasses.replace(
        drawn.problem.robot.limits,
        max_yaw_rate=0.5,
        max_yaw_acceleration=1.0,
        max_lateral_acceleration=0.2,
        max_wheel_speed=0.5,
        track_width=0.5,
        max_lateral_jerk=0.1,
    )
    speed = 0.05 * (number % 3)
    problem = dataclasses.replace(
        drawn.problem,
        robot=dataclasses.replace(drawn.problem.robot, limits=limits),
        dock=dataclasses.replace(drawn.problem.dock, approach_speed=ZONE.speed, approach_distance=ZONE.distance),
        start_speed=speed * int(drawn.witness.segments[0].direction),
    )
    for path in (drawn.witness, drawn.raw_path)[: 2 - number % 2]:
        result = timer.parameterize(path, limits, ZONE, start_speed=speed)
        assert result.trajectory is not None
        for period, decimals in ((0.005, 12), (0.02, 6), (0.2, 12)):
            motion = rounded(TrajectoryColumns.from_trajectory(result.trajectory, period), decimals)
            if decimals == 12 or path is drawn.witness:
                assert messages(motion, path, problem) == [], (period, decimals)


@pytest.mark.parametrize("spacing", [0.005, 0.02])
def test_a_path_given_by_samples_with_the_motion_of_the_curve_they_are_of_refutes_nothing(spacing):
    path = curve([0.0, 0.4, 1.0, 1.6, 2.2, 3.0], [0.0, 1.1, 0.2, -0.9, 0.0, 0.0])
    sampled = Path.from_poses(np.round(path.sample(spacing).poses, 6))
    found = messages(rounded(motion_of(path), 6), sampled, problem_of(path))
    assert found == []


def test_samples_on_a_clock_of_its_own_refute_nothing():
    path = two_gears(0.8)
    motion = motion_of(path)
    assert messages(motion._replace(t=motion.t + 1.7e9), path, problem_of(path)) == []


def test_a_circle_driven_twice_is_followed_twice():
    path = curve([0.0, 4.0 * np.pi], [1.0, 1.0])
    motion = rest_to_rest(path)
    problem = problem_of(path, MotionLimits())
    assert messages(motion, path, dataclasses.replace(problem, dock=Dock(path.end))) == []
    jump = (motion.t > 20.0) & (motion.t < 41.0)
    skipped = TrajectoryColumns(motion.t[~jump], *(column[~jump] for column in motion[1:]))
    assert check_sampled_motion(skipped, path, problem).refuted


def test_a_rest_on_the_way_refutes_nothing():
    path = curve([0.0, 1.5], [0.0, 0.0])
    first, second = rest_to_rest(path), rest_to_rest(curve([0.0, 1.5], [0.0, 0.0], path.end))
    columns = [np.concatenate((a, b)) for a, b in zip(first, second, strict=True)]
    columns[0] = np.concatenate((first.t, second.t + first.t[-1] + 7.3))
    both = curve([0.0, 3.0], [0.0, 0.0])
    assert messages(TrajectoryColumns(*columns), both, problem_of(both, zone=SpeedZone())) == [
        "samples up to 7.3 s apart leave the motion between them uncertain by 3.65 m; sample it finer"
    ]
    wait = np.linspace(first.t[-1], columns[0][first.t.size], 300)[1:-1]
    still = first._replace(jerk=0.0 * first.t)
    resting = (np.full(wait.size, column[-1]) for column in still[1:])
    columns = [np.concatenate((a, b, c[a.size :])) for a, b, c in zip(first, (wait, *resting), columns, strict=True)]
    assert messages(TrajectoryColumns(*columns), both, problem_of(both, zone=SpeedZone())) == []


# Verdicts.


@pytest.mark.parametrize(("decimals", "period"), [(None, 0.02), (3, 0.02), (6, 0.003)])
def test_a_robot_that_waits_at_a_cusp_does_not_accelerate(decimals, period):
    """Samples at rest between two gears may be on either side of the cusp."""
    path = two_gears(0.5)
    law = timed(path).time_law
    arrives = int(np.argmin(np.abs(law.states[:, 0] - path.cusps[0])))
    waiting = TimeLaw(np.insert(law.durations, arrives, 2.0), np.insert(law.jerks, arrives, 0.0))
    motion = TrajectoryColumns.from_trajectory(Trajectory(path, waiting), period)
    motion = motion if decimals is None else rounded(motion, decimals)
    assert messages(motion, path, problem_of(path)) == []
    began = waiting.times[arrives]
    waits = (motion.t > began + 0.5) & (motion.t < began + 1.5)
    lie = motion._replace(acceleration=np.where(waits, 0.2, motion.acceleration))
    assert any("speed off its accelerations" in fault for fault in messages(lie, path, problem_of(path)))


def test_samples_too_far_apart_are_called_so_and_nothing_else():
    path = two_gears(0.5)
    (fault,) = messages(motion_of(path, 3.0), path, problem_of(path))
    assert fault == "samples up to 3 s apart leave the motion between them uncertain by 1.35 m; sample it finer"


def test_a_turn_in_place_cannot_be_judged():
    path = Path.from_poses(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.0, 1.0], [1.5, 0.8, 1.0]]))
    straight = rest_to_rest(curve([0.0, 2.0], [0.0, 0.0]))
    assert messages(straight, path, problem_of(path))[0].startswith("the path turns in place at s = 1.000 m")


# Limits.


TIGHTER = {
    "max_speed": 0.2,
    "max_reverse_speed": 0.05,
    "max_acceleration": 0.1,
    "max_deceleration": 0.1,
    "max_jerk": 1.0,
    "max_yaw_rate": 0.05,
    "max_yaw_acceleration": 0.05,
    "max_lateral_acceleration": 0.01,
    "max_lateral_jerk": 0.005,
    "max_wheel_speed": 0.1,
}


@pytest.mark.parametrize(
    "limit",
    [
        field.name
        for field in dataclasses.fields(MotionLimits)
        if field.name not in DIMENSIONS
        and not (field.name in KINDS and (KINDS[field.name].kind is LimitKind.PATH or KINDS[field.name].steered))
    ],
)
def test_every_limit_is_checked(limit):
    """Limits of steered wheels: see `test_steering`; limits of the path cannot be broken by a motion."""
    path = two_gears(0.8)
    tighter = dataclasses.replace(LIMITS, **{limit: TIGHTER[limit]})
    faults = messages(motion_of(path), path, problem_of(path, tighter))
    kinds = (f"{KINDS[limit].label}: ", f"mean {KINDS[limit].label}: ")
    assert any(message.startswith(kinds) for message in faults), faults


def test_on_an_arc_the_lateral_jerk_is_twice_speed_times_acceleration_times_curvature():
    path = curve([0.0, 3.0], [0.8, 0.8])
    motion = rest_to_rest(path)
    peak = float(np.max(np.abs(2.0 * motion.speed * motion.acceleration * 0.8)))
    open_ = MotionLimits()
    for share, fault in ((0.95, True), (1.01, False)):
        limits = dataclasses.replace(open_, max_lateral_jerk=share * peak)
        faults = messages(motion, path, problem_of(path, limits, SpeedZone()))
        assert any(message.startswith("mean lateral jerk [m/s^3]: ") for message in faults) is fault, faults


def trapezoid(acceleration, deceleration, period, speed=0.5, length=3.0):
    """Straight motion with jumps of the acceleration; the columns of acceleration and jerk are 0."""
    up, down = speed / acceleration, speed / deceleration
    cruise = (length - speed * (up + down) / 2.0) / speed
    end = up + cruise + down
    t = np.append(np.arange(0.0, end, period), end)
    v = np.clip(np.minimum(acceleration * t, np.minimum(speed, deceleration * (end - t))), 0.0, None)
    x = np.where(t < up, acceleration * t**2 / 2.0, speed * up / 2.0 + speed * (t - up))
    x = np.where(t < up + cruise, x, length - deceleration * (end - t) ** 2 / 2.0)
    zero = np.zeros(t.size)
    return TrajectoryColumns(t, x, zero, zero, v, zero, zero, zero, zero)


STRAIGHT = curve([0.0, 3.0], [0.0, 0.0])


@pytest.mark.parametrize("period", [0.005, 0.02, 0.1])
def test_speeding_up_and_slowing_down_have_limits_of_their_own(period):
    """Only slowing down may be done with 1.0 m/s^2; the column of accelerations says 0."""
    limits = MotionLimits(max_acceleration=0.2, max_deceleration=1.0, max_jerk=1.0)
    problem = problem_of(STRAIGHT, limits, SpeedZone())
    faults = messages(trapezoid(1.0, 1.0, period), STRAIGHT, problem)
    assert any(fault.startswith("mean acceleration [m/s^2]: ") for fault in faults), faults
    assert not any(fault.startswith("mean deceleration") for fault in faults)
    faults = messages(trapezoid(0.19, 0.9, period), STRAIGHT, problem)
    assert any(fault.startswith("speed off its accelerations [m/s]: ") for fault in faults), faults


def test_a_jump_of_the_positions_is_found_although_the_speeds_are_smooth():
    motion = rest_to_rest(STRAIGHT, period=2.5e-4)
    k = np.arange(motion.t.size) - motion.t.size // 2
    hop = np.clip(k, 0, 150) * 9e-4 - np.clip(k - 2000, 0, 150) * 9e-4
    faults = messages(motion._replace(x=motion.x + hop), STRAIGHT, problem_of(STRAIGHT, MotionLimits(), SpeedZone()))
    assert faults[0].startswith("distance off its speeds [m]: ")


def test_a_drift_below_every_rounding_is_found_over_time():
    """Half a micrometre per step is 0.5 mm/s at a period of a millisecond."""
    motion = rest_to_rest(STRAIGHT, period=1e-3)
    drift = 5e-7 * np.minimum(np.arange(motion.t.size), 4000)
    problem = problem_of(STRAIGHT, MotionLimits(), SpeedZone())
    assert messages(motion, STRAIGHT, problem) == []
    faults = messages(motion._replace(x=motion.x + drift - drift[-1] * motion.x / 3.0), STRAIGHT, problem)
    assert faults[0].startswith("distance off its speeds [m]: ")


BURST = curve([0.0, 1.0, 1.05, 2.0, 2.05, 3.0], [0.0, 0.0, 1.0, 1.0, 0.0, 0.0])


def test_wrong_yaw_accelerations_are_found_by_the_path():
    """True yaw acceleration 1.8 rad/s^2 where 0.5 are allowed; the column says 0."""
    motion = rest_to_rest(BURST)
    denied = motion._replace(yaw_acceleration=0.0 * motion.t)
    problem = problem_of(BURST, MotionLimits(max_yaw_acceleration=0.5), SpeedZone())
    faults = messages(denied, BURST, problem)
    assert any(fault.startswith("mean yaw acceleration [rad/s^2]: 1.") for fault in faults), faults
    assert any(fault.startswith("yaw acceleration off the path's [rad/s^2]: ") for fault in faults), faults


def test_a_turn_between_two_samples_is_found_by_the_path():
    """The curvature changes within 0.17 s, and no sample is there."""
    motion = rest_to_rest(BURST, period=0.2)
    samples = Trajectory(BURST, TimeLaw(np.array([1.0]), np.array([0.0])))
    assert samples.path is BURST
    keep = np.abs(motion.yaw_acceleration) < 1e-9
    sparse = TrajectoryColumns(*(column[keep] for column in motion))
    problem = problem_of(BURST, MotionLimits(max_yaw_acceleration=0.5, max_jerk=0.5), SpeedZone())
    faults = messages(sparse, BURST, problem)
    assert any(fault.startswith("mean yaw acceleration [rad/s^2]: ") for fault in faults), faults


def test_forward_motion_with_negative_speeds_is_refuted():
    """Judged by the limit of the reverse gear, 0.5 m/s, the forward motion would pass: its own limit is 0.1 m/s."""
    motion = rest_to_rest(STRAIGHT)
    names = ("speed", "acceleration", "jerk")
    negated = motion._replace(**{name: -getattr(motion, name) for name in names})
    limits = MotionLimits(max_speed=0.1, max_reverse_speed=0.5)
    (fault,) = messages(negated, STRAIGHT, problem_of(STRAIGHT, limits, SpeedZone()))
    assert fault == "direction: the motion drives in reverse; the path drives forward"


def test_a_cusp_passed_between_two_samples_takes_its_time():
    """Both sides of the cusp are as they should be, but the time for the rest between them is cut out."""
    path = two_gears(0.8)
    motion = motion_of(path)
    cusp = int(np.flatnonzero(motion.speed < -1e-6)[0])
    for cut in (2, 3, 6):
        keep = np.ones(motion.t.size, dtype=bool)
        keep[cusp - cut : cusp + cut] = False
        gone = motion.t[cusp + cut] - motion.t[cusp - cut - 1]
        sparse = TrajectoryColumns(*(column[keep] for column in motion))
        assert messages(sparse, path, problem_of(path)) == []
        hurried = sparse._replace(t=np.where(sparse.t > motion.t[cusp], sparse.t - 0.3 * gone, sparse.t))
        faults = messages(hurried, path, problem_of(path))
        assert any(fault.startswith("cusp at s = 1.200 m: ") for fault in faults), faults


# Damaged columns.

DAMAGES = {
    "faster clock": ({"t": lambda v: 0.97 * v}, "distance off its speeds [m]: "),
    "twice as fast a clock": ({"t": lambda v: 0.5 * v}, "mean acceleration [m/s^2]: "),
    "slower clock": ({"t": lambda v: 1.05 * v}, "distance off its speeds [m]: "),
    "ragged accelerations": (
        {"acceleration": lambda v: np.where(np.arange(v.size) % 2, v, 0.0)},
        "mean jerk [m/s^3]: ",
    ),
    "smaller accelerations": ({"acceleration": lambda v: 0.9 * v}, "speed off its accelerations [m/s]: "),
    "smaller yaw rates": ({"yaw_rate": lambda v: 0.99 * v}, "yaw rate off speed times curvature [rad/s]: "),
    "smaller yaw accelerations": (
        {"yaw_acceleration": lambda v: 0.95 * v},
        "yaw acceleration off the path's [rad/s^2]: ",
    ),
    "beside the path": ({"x": lambda v: v + 0.004}, "pose at t = "),
    "turned": ({"yaw": lambda v: v + 0.004}, "pose at t = "),
    "in degrees": ({"yaw": np.degrees}, "pose at t = "),
    "short": ({name: lambda v: v[:-30] for name in TrajectoryColumns._fields}, "travelled: "),
    "late": ({name: lambda v: v[30:] for name in TrajectoryColumns._fields}, "begins: at s = "),
    "not at rest in the end": (
        {"speed": lambda v: np.where(np.arange(v.size) < v.size - 1, v, -0.01)},
        "end speed [m/s]: -0.01",
    ),
    "braking in the end": (
        {"acceleration": lambda v: np.where(np.arange(v.size) < v.size - 1, v, 0.3)},
        "end acceleration [m/s^2]: 0.3",
    ),
    "moving at the start": (
        {"speed": lambda v: np.where(np.arange(v.size) > 0, v, 0.01)},
        "start speed [m/s]: 0.01, the robot has 0",
    ),
    "backwards in time": (
        {name: lambda v: v[::-1] for name in TrajectoryColumns._fields if name != "t"},
        "direction: the motion drives in reverse, ",
    ),
    "one speed": ({"speed": lambda v: np.where(np.arange(v.size) == 40, v + 0.01, v)}, "speed off its accelerations"),
    "one place": ({"x": lambda v: np.where(np.arange(v.size) == 40, v + 0.001, v)}, "distance off its speeds [m]: "),
}


@pytest.mark.parametrize("lie", sorted(DAMAGES))
def test_every_damage_is_refuted(lie):
    change, fault = DAMAGES[lie]
    path = two_gears(0.8)
    motion = motion_of(path)
    motion = motion._replace(**{name: alter(getattr(motion, name)) for name, alter in change.items()})
    faults = messages(motion, path, problem_of(path))
    assert any(message.startswith(fault) for message in faults), faults


def test_phases_shorter_than_a_step_are_not_refuted():
    """The jerk acts for 0.05 s within every step of 0.2 s and is 0 at all samples."""
    durations, jerks = [], []
    for sign in (1.0,) * 5 + (-1.0,) * 10 + (1.0,) * 5:
        durations += [0.06, 0.05, 0.2 - 0.06 - 0.05]
        jerks += [0.0, sign, 0.0]
    law = TimeLaw(np.array(durations), np.array(jerks))
    path = curve([0.0, float(law.states[-1, 0])], [0.0, 0.0])
    columns = TrajectoryColumns.from_trajectory(Trajectory(path, law), 0.2)
    assert not columns.jerk.any()
    assert messages(columns, path, problem_of(path, MotionLimits(), SpeedZone())) == []


def test_yaws_in_degrees_are_recognized():
    path = two_gears(0.8)
    motion = motion_of(path)
    (fault,) = messages(motion._replace(yaw=np.degrees(motion.yaw)), path, problem_of(path))
    assert fault.endswith("off the path; is yaw in degrees?")


def test_a_speed_in_the_approach_zone_is_found():
    path = two_gears(0.8)
    motion = motion_of(path, zone=SpeedZone())
    faults = messages(motion, path, problem_of(path))
    assert any(fault.startswith("approach speed [m/s]: ") for fault in faults), faults


# Beside the path.


@pytest.mark.parametrize(("gap", "passes"), [(0.0502, False), (0.052, True)])
def test_poses_beside_the_path_need_the_clearance_to_cover_them(gap, passes):
    """0.9 mm off, towards a wall; the path itself keeps the required 0.05 m."""
    y = 0.3 + gap
    wall = ObstacleSet.from_polygons([[[-1.0, y], [4.0, y], [4.0, 1.0], [-1.0, 1.0]]])
    problem = problem_of(
        STRAIGHT, MotionLimits(), SpeedZone(), obstacles=wall, clearance=ClearanceRule(0.05, 0.05, 0.0)
    )
    assert certify_path(STRAIGHT, problem).certified
    motion = rest_to_rest(STRAIGHT)
    verdict = check_sampled_motion(motion._replace(y=motion.y + 9e-4), STRAIGHT, problem)
    assert verdict.offset[0] == pytest.approx(9e-4)
    assert verdict.refuted is not passes
    assert verdict.off_path
    if not passes:
        assert verdict.violations[0].message.endswith("off the path, and the clearance does not cover it")
    assert not check_sampled_motion(motion, STRAIGHT, problem).off_path


def test_the_corners_of_a_turned_footprint_count():
    """Turned by 1.9 mrad, the corners of a robot 0.8 m long are 0.9 mm off."""
    wall = ObstacleSet.from_polygons([[[-1.0, 0.3505], [4.0, 0.3505], [4.0, 1.0], [-1.0, 1.0]]])
    problem = problem_of(
        STRAIGHT, MotionLimits(), SpeedZone(), obstacles=wall, clearance=ClearanceRule(0.05, 0.05, 0.0)
    )
    motion = rest_to_rest(STRAIGHT)
    assert check_sampled_motion(motion._replace(yaw=motion.yaw + 1.9e-3), STRAIGHT, problem).refuted


# Exact phases beside the samples.


def test_samples_are_compared_with_the_phases_they_are_of():
    path = two_gears(0.8)
    trajectory, problem = timed(path), problem_of(path)
    motion = TrajectoryColumns.from_trajectory(trajectory, 0.02)
    for honest in (motion, rounded(motion, 6), rounded(motion, 4)):
        assert check_samples_of(trajectory, honest, problem).violations == ()
    for name in TrajectoryColumns._fields[1:]:
        column = getattr(motion, name).copy()
        column[40] += 0.03
        (violation, *_) = check_samples_of(trajectory, motion._replace(**{name: column}), problem).violations
        assert violation.message.startswith(f"{name} at t = 0.800 s is ")
    (violation,) = check_samples_of(trajectory, motion._replace(t=1.01 * motion.t), problem).violations
    assert violation.message.startswith("the samples end at t = ")


# Hostile columns.


def hostile(motion):
    """Hostile columns by name."""
    n, rng = motion.t.size, np.random.default_rng(0)
    rest = {name: np.zeros(n) for name in TrajectoryColumns._fields[4:]}
    pose = {name: np.full(n, getattr(motion, name)[0]) for name in ("x", "y", "yaw")}
    yield "huge", TrajectoryColumns(motion.t, *(np.full(n, 1e9) for _ in motion[1:]))
    yield "denormal", TrajectoryColumns(motion.t, *(np.full(n, 5e-324) for _ in motion[1:]))
    yield "noise", TrajectoryColumns(motion.t, *(rng.normal(size=n) for _ in motion[1:]))
    yield "wild positions", motion._replace(x=motion.x + 0.02 * rng.normal(size=n))
    yield "no time", motion._replace(t=np.arange(n) * 1e-12)
    yield "denormal times", motion._replace(t=np.arange(n) * 5e-324)
    yield "all time", motion._replace(t=np.linspace(-1e11, 1e11, n))
    yield "slow", motion._replace(t=3e4 * motion.t)
    yield "standing", motion._replace(**rest, **pose)
    yield "flapping", motion._replace(speed=np.where(np.arange(n) % 2, 0.1, -0.1))
    yield "two of them", TrajectoryColumns(*(column[:2] for column in motion))


@pytest.mark.parametrize("limits", [MotionLimits(), MotionLimits(1e300, 1e300, 1e300, 1e300, 1e300)])
def test_hostile_columns_are_refuted(limits):
    path = two_gears(0.8)
    motion = motion_of(path)
    for name, columns in hostile(motion):
        assert check_sampled_motion(columns, path, problem_of(path, limits)).refuted, name


def test_many_samples_are_looked_for_a_bounded_number_of_times(monkeypatch):
    path, looked_at, poses_at = two_gears(0.8), [], Path.poses_at
    monkeypatch.setattr(Path, "poses_at", lambda self, s: looked_at.append(np.size(s)) or poses_at(self, s))
    trajectory = timed(path)
    samples = trajectory.sample_at(np.linspace(0.0, trajectory.duration, 4_000))
    motion = TrajectoryColumns(*(getattr(samples, name) for name in TrajectoryColumns._fields))
    for name, columns in (("honest", motion), *hostile(motion)):
        looked_at.clear()
        check_sampled_motion(columns, path, problem_of(path))
        assert sum(looked_at) <= 9 * motion.t.size, name


def test_plans_of_the_whole_pipeline_are_not_refuted():
    problem = instance("clutter", 3).problem
    plan = plan_dock(problem, time_budget=2.0)
    for period in (0.005, 0.05, 0.2):
        motion = TrajectoryColumns.from_trajectory(plan.trajectory, period)
        for columns in (motion, rounded(motion, 6)):
            assert messages(columns, plan.path, problem) == []


UNEVEN_TURNS = {
    "up": ([1.0, 1.0, 2.0, 2.0], [0.4, -0.4, -0.1, 0.1]),
    "down": ([2.0, 2.0, 1.0, 1.0], [0.1, -0.1, -0.4, 0.4]),
    "jerk down": ([2.0, 0.5, 0.5, 2.0], [0.1, -0.4, -0.4, 0.1]),
    "jerk up": ([0.5, 2.0, 2.0, 0.5], [0.4, -0.1, -0.1, 0.4]),
}


def turned(name, sign):
    """Samples of an uneven turn in place, the problem, and the largest rate, acceleration and jerk."""
    law = TimeLaw(*UNEVEN_TURNS[name])
    path = Path((TurnSegment(ORIGIN, sign * float(law.states[-1, 0])),))
    most = np.max(np.abs(law.at(np.linspace(0.0, law.duration, 60_001))[:, 1:]), axis=0)

    def problem(rate=1.0, acceleration=1.0, jerk=1.0):
        rate, acceleration, jerk = most * (rate, acceleration, jerk) * (1.0 + 1e-4)
        limits = MotionLimits(max_yaw_rate=rate, max_yaw_acceleration=acceleration, max_jerk=0.6 * jerk / acceleration)
        robot = Robot(Footprint.rectangle(0.4, 0.4, 0.6), limits, turns_in_place=True)
        return DockingProblem(path.start, Dock(path.end), robot)

    return TrajectoryColumns.from_trajectory(Trajectory(path, law), 0.02), path, problem


@pytest.mark.parametrize("name", UNEVEN_TURNS)
@pytest.mark.parametrize("sign", [1, -1])
def test_a_turn_beyond_a_limit_is_refuted_whichever_way_it_gains(name, sign):
    motion, path, problem = turned(name, sign)
    assert not check_sampled_motion(motion, path, problem()).refuted
    assert check_sampled_motion(motion, path, problem(rate=0.97)).refuted
    assert check_sampled_motion(motion, path, problem(acceleration=0.97)).refuted
    kinds = {violation.kind for violation in check_sampled_motion(motion, path, problem(jerk=0.9)).violations}
    assert "mean_yaw_jerk" in kinds


@pytest.mark.parametrize("name", ["up", "down"])
@pytest.mark.parametrize("sign", [1, -1])
def test_wrong_columns_of_a_turn_are_refuted(name, sign):
    """For any jerk, the mean acceleration follows from the rates, and the yaw from their sum."""
    motion, path, problem = turned(name, sign)
    modest = motion._replace(yaw_acceleration=0.9 * motion.yaw_acceleration)
    found = check_sampled_motion(modest, path, problem(acceleration=0.92, jerk=900.0)).violations
    assert "mean_yaw_acceleration" in {violation.kind for violation in found}
    weak = motion._replace(yaw_acceleration=0.8 * motion.yaw_acceleration)
    warped = motion._replace(yaw=motion.yaw + 0.01 * np.sin(np.pi * motion.t / motion.t[-1]) ** 2)
    for lying, kind in ((weak, "yaw_rate_off_its_accelerations"), (warped, "yaw_off_its_rates")):
        assert kind in {violation.kind for violation in check_sampled_motion(lying, path, problem()).violations}


@pytest.mark.parametrize(("distance", "refuted"), [(0.05, False), (0.4, True), (0.7, True)])
def test_the_slow_zone_of_samples_reaches_across_a_turn(distance, refuted):
    """The last drive ends slowly, the one before the turn does not: it is in the zone only where metres say so."""
    first = ClothoidSpline(ORIGIN, np.array([0.0, 1.5]), np.zeros(2))
    turn = TurnSegment(first.end, 1.0)
    last = ClothoidSpline(turn.end, np.array([0.0, 0.5]), np.zeros(2))
    path = Path((ClothoidSegment(first), turn, ClothoidSegment(last)))
    limits = MotionLimits(max_yaw_rate=1.0, max_yaw_acceleration=1.0)
    timer = create_plugin(TimeParameterizer, "NearOptimal")
    for slow_until, judged_by in ((distance, distance), (0.5, distance)):
        motion = timer.parameterize(path, limits, SpeedZone(0.1, slow_until)).trajectory
        robot = Robot(Footprint.rectangle(0.4, 0.4, 0.6), limits, turns_in_place=True)
        dock = Dock(path.end, approach_speed=0.1, approach_distance=judged_by)
        columns = TrajectoryColumns.from_trajectory(motion, 0.02)
        found = check_sampled_motion(columns, path, DockingProblem(path.start, dock, robot))
        assert found.refuted is (judged_by > slow_until)
    fast = timer.parameterize(path, limits, SpeedZone(0.1, 0.05)).trajectory
    found = check_sampled_motion(
        TrajectoryColumns.from_trajectory(fast, 0.02), path, DockingProblem(path.start, dock, robot)
    )
    assert found.refuted is refuted


@pytest.mark.parametrize(("share", "refuted"), [(1.0, False), (0.8, True), (0.3, True)])
def test_waits_too_short_for_the_wheels_are_refuted(share, refuted):
    bend = 1.2
    path = two_gears(bend)
    mirrored = ClothoidSpline(path.segments[0].spline.end, np.array([0.0, 1.0]), np.array([bend, 0.0]), -1)
    path = Path((path.segments[0], ClothoidSegment(mirrored)))
    limits = MotionLimits(wheelbase=0.8, max_steering_rate=1.0)
    law = create_plugin(TimeParameterizer, "NearOptimal").parameterize(path, limits, SpeedZone()).trajectory.time_law
    waits = (law.jerks == 0.0) & np.all(np.abs(law.states[:-1, 1:]) < 1e-9, axis=1)
    assert law.durations[waits].sum() == pytest.approx(2.0 * np.arctan(0.8 * bend))
    hasty = Trajectory(path, TimeLaw(law.durations * np.where(waits, share, 1.0), law.jerks))
    robot = Robot(Footprint.rectangle(0.4, 0.4, 0.6), limits, Drive.ACKERMANN)
    begins = float(path.curvature_at(0.0)[0])
    problem = DockingProblem(path.start, Dock(path.end), robot, start_curvature=begins)
    found = check_sampled_motion(TrajectoryColumns.from_trajectory(hasty, 0.02), path, problem)
    assert {violation.kind for violation in found.violations} == ({"rest"} if refuted else set())


@pytest.mark.parametrize(("share", "refuted"), [(1.0, False), (1.2, False), (0.9, True), (0.0, True)])
def test_starts_too_early_for_the_wheels_are_refuted(share, refuted):
    path = curve([0.0, 0.5, 1.5], [0.4, 0.3, 0.0])
    known = steered_problem(path)
    free = known.starting_at(known.start)
    wait = STEERED.start_wait(path)
    assert known.start_wait(path) == 0.0
    assert free.start_wait(path) == wait
    motion = TIMER.parameterize(path, STEERED, ZONE, start_wait=share * wait).trajectory
    columns = TrajectoryColumns.from_trajectory(motion, 0.02)
    assert messages(columns, path, known) == []
    kinds = {violation.kind for violation in check_sampled_motion(columns, path, free).violations}
    assert kinds == ({"rest"} if refuted else set())
