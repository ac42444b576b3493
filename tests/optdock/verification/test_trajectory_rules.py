"""The proof of motion limits: every limit violated and satisfied, compared with dense sampling."""

import dataclasses

import numpy as np
import pytest
import ruckig
from hypothesis import given, settings
from hypothesis import strategies as st

from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.model.constant_jerk import TimeLaw
from optdock.model.dock import Dock
from optdock.model.limits import DIMENSIONS, LIMITS, Limit, LimitKind, MotionLimits, SpeedZone
from optdock.model.path import ClothoidSegment, Path, PolylineSegment, TurnSegment
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.model.trajectory import Trajectory
from optdock.verification import certify_trajectory, path_rules, trajectory_rules, turning_rules

OPEN = MotionLimits(1.0, 1.0, 1.0, 1.0, 4.0, track_width=0.5, wheelbase=0.8)
QUANTITIES = {
    "max_yaw_rate": lambda r: np.abs(r.yaw_rate),
    "max_yaw_acceleration": lambda r: np.abs(r.yaw_acceleration),
    "max_lateral_acceleration": lambda r: np.abs(r.yaw_rate * r.speed),
    "max_lateral_jerk": lambda r: np.abs(np.gradient(r.yaw_rate * r.speed, r.t)),
    "max_wheel_speed": lambda r: np.abs(r.speed) + 0.25 * np.abs(r.yaw_rate),
    "max_steering_rate": lambda r: np.abs(np.gradient(np.arctan(0.8 * path().curvature_at(r.s)), r.t)),
    "max_speed": lambda r: np.abs(r.speed),
    "max_acceleration": lambda r: r.acceleration,
    "max_deceleration": lambda r: -r.acceleration,
    "max_jerk": lambda r: np.abs(r.jerk),
}


def move(length, speed=0.5, acceleration=0.4, jerk=1.5, start_speed=0.0):
    """Return the phases of a straight move to rest."""
    one = ruckig.InputParameter(1)
    one.current_velocity, one.target_position = [start_speed], [length]
    one.max_velocity, one.max_acceleration, one.max_jerk = [speed], [acceleration], [jerk]
    found = ruckig.Trajectory(1)
    ruckig.Ruckig(1).calculate(one, found)
    profile = found.profiles[0][0]
    t, j = np.array(profile.t), np.array(profile.j)
    return t[t > 0.0], j[t > 0.0]


def path(curvature=(0.0, 1.5, -1.0, 0.5, 0.0)):
    knots = np.linspace(0.0, 3.0, len(curvature))
    return Path((ClothoidSegment(ClothoidSpline(Pose2(0.0, 0.0, 0.0), knots, list(curvature))),))


def trajectory(**kwargs):
    t, j = move(3.0, **kwargs)
    return Trajectory(path(), TimeLaw(t, j, start_speed=kwargs.get("start_speed", 0.0)))


def kinds(motion, limits, zone=None, **start):
    return [violation.kind for violation in certify_trajectory(motion, limits, zone or SpeedZone(), **start).violations]


def test_a_legal_motion_is_certified():
    certificate = certify_trajectory(trajectory(), OPEN, SpeedZone(), start_speed=0.0, start_acceleration=0.0)
    assert certificate.certified
    assert certificate.ratios["speed"] == pytest.approx(0.5)


PROVEN_OF_MOTIONS = [
    field.name
    for field in dataclasses.fields(MotionLimits)
    if not (field.name in DIMENSIONS or field.name == "max_reverse_speed")
    and not (field.name in LIMITS and LIMITS[field.name].kind is LimitKind.PATH)
]


@pytest.mark.parametrize("name", PROVEN_OF_MOTIONS)
def test_each_limit_is_broken_just_below_the_motion_and_kept_just_above(name):
    motion = trajectory()
    peak = float(np.max(QUANTITIES[name](motion.sample(1e-4))))
    assert kinds(motion, dataclasses.replace(OPEN, **{name: 0.998 * peak})) == [name.removeprefix("max_")]
    assert kinds(motion, dataclasses.replace(OPEN, **{name: 1.002 * peak})) == []


@settings(max_examples=25)
@given(st.integers(0, 10_000))
def test_a_proven_ratio_is_never_below_the_dense_truth(seed):
    rng = np.random.default_rng(seed)
    t, j = move(3.0, *rng.uniform(0.2, 1.0, 2), rng.uniform(0.5, 3.0))
    motion = Trajectory(path(np.append(rng.uniform(-2.0, 2.0, 8), 0.0)), TimeLaw(t, j))
    curved = {"max_yaw_rate": 0.6, "max_yaw_acceleration": 1.0, "max_lateral_acceleration": 0.4, "max_wheel_speed": 0.7}
    limits = dataclasses.replace(OPEN, **curved, max_lateral_jerk=0.8)
    certificate = certify_trajectory(motion, limits, SpeedZone())
    dense = motion.sample(2e-3)
    along = motion.time_law.at(dense.t)[:, 2]
    bend, rate = motion.path.curvature_at(dense.s), motion.path.curvature_rate_at(dense.s)
    sideways = np.abs(2.0 * dense.speed * along * bend + dense.speed**3 * rate)  # no mean over a jump of the rate
    for name in (*curved, "max_lateral_jerk"):
        values = sideways if name == "max_lateral_jerk" else QUANTITIES[name](dense)
        truth = float(np.max(values)) / getattr(limits, name)
        kind = name.removeprefix("max_")
        assert certificate.ratios[kind] >= min(truth, 1.0) - 1e-9
        if truth > 1.0 + 1e-5:
            assert kind in [violation.kind for violation in certificate.violations]


def cruise(path, speed=0.5):
    """Return a motion from rest to rest with constant speed except for the first and last half metre."""
    ramp = 0.5 / speed  # of two phases each: half the speed times the time of both is half a metre
    jerk, steady = speed / ramp**2, (path.length - 1.0) / speed
    return Trajectory(path, TimeLaw([ramp, ramp, steady, ramp, ramp], [jerk, -jerk, 0.0, -jerk, jerk]))


def is_the_lateral_jerk(motion, exact):
    """Check that the motion is certified just above, rejected just below, and has the exact ratio."""
    above, below = (dataclasses.replace(OPEN, max_lateral_jerk=exact * (1.0 + e)) for e in (1e-5, -1e-5))
    certificate = certify_trajectory(motion, above, SpeedZone())
    assert certificate.certified, certificate.reason
    assert certificate.ratios["lateral_jerk"] == pytest.approx(1.0, abs=2.1e-5)
    assert kinds(motion, below) == ["lateral_jerk"]


@pytest.mark.parametrize(("speed", "bend", "length"), [(0.5, 1.5, 0.5), (0.3, -0.4, 0.25), (0.7, 2.0, 1.0)])
def test_lateral_jerk_on_a_clothoid_at_constant_speed_is_speed_cubed_times_the_rate(speed, bend, length):
    spline = ClothoidSpline(
        Pose2(0.0, 0.0, 0.0), np.cumsum([0.0, 0.6, length, length, 0.6]), [0.0, 0.0, bend, 0.0, 0.0]
    )
    is_the_lateral_jerk(cruise(Path((ClothoidSegment(spline),)), speed), speed**3 * abs(bend) / length)


@pytest.mark.parametrize("gear", [1, -1])
def test_lateral_jerk_on_an_arc_is_twice_speed_times_acceleration_times_curvature(gear):
    """From rest at constant jerk j it is j^2 t^3 k, with its maximum after the sign change of the jerk."""
    spline = ClothoidSpline(Pose2(0.0, 0.0, 0.0), [0.0, 3.0], [0.8, 0.8], gear)
    motion = cruise(Path((ClothoidSegment(spline),)), 0.4)
    ramp, jerk = motion.time_law.durations[0], motion.time_law.jerks[0]
    # After the turn, t later: 2 k (v + a t - j t^2 / 2) (a - j t), largest where its derivative is none.
    v, a = 0.5 * jerk * ramp**2, jerk * ramp
    t = min(t for t in np.roots([1.5 * jerk**2, -3.0 * a * jerk, a * a - v * jerk]).real if t > 0.0)
    exact = 2.0 * 0.8 * (v + a * t - 0.5 * jerk * t * t) * (a - jerk * t)
    assert exact > jerk**2 * ramp**3 * 0.8
    is_the_lateral_jerk(motion, exact)


def test_the_lateral_jerk_is_zero_at_rest_and_in_turns_in_place():
    turn = Path((TurnSegment(Pose2(0.0, 0.0, 0.0), 1.2),))
    limits = dataclasses.replace(OPEN, max_yaw_rate=5.0, max_yaw_acceleration=10.0, max_lateral_jerk=1e-9)
    motion = Trajectory(turn, TimeLaw(*move(turn.length, speed=0.1, acceleration=0.1, jerk=0.1)))
    certificate = certify_trajectory(motion, limits, SpeedZone())
    assert certificate.certified, certificate.reason
    assert certificate.ratios["lateral_jerk"] == 0.0


def test_a_limit_that_no_rule_proves_is_a_violation(monkeypatch):
    """A field that is added to the limits without a rule certifies nothing, with or without a row in the table."""
    planted = dataclasses.make_dataclass("Planted", [("max_foo", float, np.inf)], bases=(MotionLimits,), frozen=True)
    asked = trajectory(), planted(), SpeedZone(), (None, None, 0.0), lambda: False

    def refusals(limits):
        found, _ratios = trajectory_rules.trajectory_violations(asked[0], limits, *asked[2:])
        object.__setattr__(problem.robot, "limits", limits)
        path_found = path_rules.path_violations(asked[0].path, problem)
        return [one.message for one in found], [one.message for one in path_found]

    problem = DockingProblem(asked[0].path.start, Dock(asked[0].path.end), Robot(Footprint.from_radius(0.3), OPEN))
    open_, limited = planted(**dataclasses.asdict(OPEN)), planted(**dataclasses.asdict(OPEN), max_foo=2.0)
    assert refusals(open_) == ([], [])
    said = "no rule proves max_foo = 2"
    assert refusals(limited) == ([said], [said])
    for kind, expected in (
        (LimitKind.TURNING, ([said], [])),
        (LimitKind.TIME_LAW, ([said], [])),
        (LimitKind.PATH, ([], [said])),
    ):
        row = Limit("max_foo", "m", kind, "", "", lambda at, _: at.v)
        for module in (trajectory_rules, turning_rules, path_rules):
            monkeypatch.setattr(module, "LIMITS", {**LIMITS, "max_foo": row})
        assert refusals(limited) == expected


def test_the_place_of_a_violation_shows_it():
    """The curvature rises to a knot: the worst instant is the end of a cell and not its beginning."""
    motion = Trajectory(path((0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0)), TimeLaw(*move(3.0)))
    peak = float(np.max(np.abs(motion.sample(1e-4).yaw_rate)))
    limits = dataclasses.replace(OPEN, max_yaw_rate=0.9 * peak)
    violation = certify_trajectory(motion, limits, SpeedZone()).violations[0]
    speed = np.interp(violation.s, *motion.time_law.at(np.linspace(0.0, motion.duration, 100_000)).T[:2])
    shown = abs(speed * motion.path.curvature_at(violation.s)[0])
    assert shown == pytest.approx(limits.max_yaw_rate + violation.amount, rel=1e-4)


def test_the_reverse_gear_has_its_own_speed_limit():
    t, j = move(3.0)
    back = Path((ClothoidSegment(ClothoidSpline(Pose2(0.0, 0.0, 0.0), [0.0, 3.0], [0.0, 0.0], -1)),))
    motion = Trajectory(back, TimeLaw(t, j))
    assert kinds(motion, dataclasses.replace(OPEN, max_speed=0.1)) == []
    assert kinds(motion, dataclasses.replace(OPEN, max_reverse_speed=0.49)) == ["speed"]


def test_the_speed_zone_binds_from_its_first_millimetre():
    motion = trajectory()
    s, v = motion.time_law.at(np.linspace(0, motion.duration, 20000))[:, :2].T
    speed = float(np.interp(2.9, s, v))
    assert kinds(motion, OPEN, SpeedZone(speed * 1.001, 0.1)) == []
    assert kinds(motion, OPEN, SpeedZone(speed * 0.99, 0.1)) == ["speed"]
    assert kinds(motion, OPEN, SpeedZone(0.4, 100.0)) == ["speed"]


def two_gears():
    first = ClothoidSpline(Pose2(0.0, 0.0, 0.0), [0.0, 1.0], [0.5, 1.0])
    second = ClothoidSpline(first.end, [0.0, 2.0], [-1.0, 0.0], -1)
    return Path((ClothoidSegment(first), ClothoidSegment(second)))


def test_rest_at_a_cusp_is_required():
    through = Trajectory(two_gears(), TimeLaw(*move(3.0)))
    assert "rest" in kinds(through, OPEN)
    (t1, j1), (t2, j2) = move(1.0), move(2.0)
    stopping = Trajectory(two_gears(), TimeLaw(np.append(t1, t2), np.append(j1, j2)))
    assert kinds(stopping, OPEN) == []


def test_a_motion_that_ends_early_late_or_moving_is_refused():
    t, j = move(2.9)
    assert kinds(Trajectory(path(), TimeLaw(t, j)), OPEN) == ["coverage", "rest"]
    t, j = move(3.0)
    assert "rest" in kinds(Trajectory(path(), TimeLaw(t[:-1], j[:-1])), OPEN)


def test_a_motion_that_backs_up_inside_a_phase_is_refused():
    # v(t) = 0.1 - 0.4 t + t^2 / 2 * 1.0 dips below zero between two positive borders.
    law = TimeLaw([0.8], [1.0], start_speed=0.07, start_acceleration=-0.4)
    flat = Path((ClothoidSegment(ClothoidSpline(Pose2(0, 0, 0), [0.0, float(law.states[-1, 0])], [0.0, 0.0])),))
    assert law.states[-1, 1] > 0.0
    assert "coverage" in kinds(Trajectory(flat, law), OPEN)


def test_the_start_state_must_be_the_robots():
    t, j = move(3.0, start_speed=0.2)
    motion = Trajectory(path(), TimeLaw(t, j, start_speed=0.2))
    assert kinds(motion, OPEN, start_speed=0.2) == []
    assert kinds(motion, OPEN, start_speed=0.0) == ["start_state"]
    assert kinds(motion, OPEN, start_acceleration=0.3) == ["start_state"]


def test_riding_a_limit_exactly_is_proven():
    circle = Path((ClothoidSegment(ClothoidSpline(Pose2(0, 0, 0), [0.0, 3.0], [1.0, 1.0])),))
    motion = Trajectory(circle, TimeLaw(*move(3.0, speed=0.5)))
    assert kinds(motion, dataclasses.replace(OPEN, max_yaw_rate=0.5, max_lateral_acceleration=0.25)) == []


def test_a_curvature_jump_between_gears_does_not_leak_into_the_gear_before():
    first = ClothoidSpline(Pose2(0.0, 0.0, 0.0), [0.0, 1.0], [0.0, 0.0])
    second = ClothoidSpline(first.end, [0.0, 2.0], [2.0, 2.0], -1)
    gears = Path((ClothoidSegment(first), ClothoidSegment(second)))
    (t1, j1), (t2, j2) = move(1.0, speed=0.5), move(2.0, speed=0.2)
    motion = Trajectory(gears, TimeLaw(np.append(t1, t2), np.append(j1, j2)))
    assert kinds(motion, dataclasses.replace(OPEN, max_yaw_rate=0.41)) == []
    assert kinds(motion, dataclasses.replace(OPEN, max_yaw_rate=0.39)) == ["yaw_rate"]


def test_the_rest_at_a_cusp_may_follow_a_phase_too_short_to_move():
    (t1, j1), (t2, j2) = move(1.0), move(2.0)
    last = 1e-4  # of the braking: the robot is at the cusp, but not yet at rest, when it begins
    durations = np.concatenate((t1[:-1], [t1[-1] - last, last, 0.5], t2))
    jerks = np.concatenate((j1, [j1[-1], 0.0], j2))
    for shift in (-1e-12, 0.0, 1e-12):
        assert kinds(Trajectory(two_gears(), TimeLaw(durations, jerks, start_s=shift)), OPEN) == []


@pytest.mark.parametrize("angle", [3e-6, 0.02, 1.5])
@pytest.mark.parametrize("gear", [1, -1])
def test_rests_at_joints_are_long_enough_for_steering(angle, gear):
    """The curvature jumps at a cusp and at a joint within one gear."""
    bend = np.tan(0.5 * angle) / 0.7
    first = ClothoidSpline(Pose2(0.0, 0.0, 0.0), [0.0, 1.0], [bend, bend])
    second = ClothoidSpline(first.end, [0.0, 1.0], [-gear * bend] * 2, gear)
    joined = Path((ClothoidSegment(first), ClothoidSegment(second)))
    drive = dataclasses.replace(OPEN, wheelbase=0.7, max_steering_rate=0.5)
    t, j = move(1.0)
    for rest, found in ((angle / 0.5 * (1.0 + 1e-9), []), (angle / 0.5 * (1.0 - 1e-3), ["rest"]), (1e-9, ["rest"])):
        waiting = TimeLaw(np.concatenate((t, [rest], t)), np.concatenate((j, [0.0], j)))
        assert kinds(Trajectory(joined, waiting), drive) == found
        elsewhere = TimeLaw(np.concatenate(([9.0], t, [rest], t, [9.0])), np.concatenate(([0.0], j, [0.0], j, [0.0])))
        assert kinds(Trajectory(joined, elsewhere), drive) == found


UNEVEN = {
    "deceleration": ([2.0, 2.0, 1.0, 1.0], [0.1, -0.1, -0.4, 0.4]),
    "acceleration": ([1.0, 1.0, 2.0, 2.0], [0.4, -0.4, -0.1, 0.1]),
    "peak inside a phase": ([1.0, 2.0, 1.0], [0.4, -0.4, 0.4]),
    "jerk down": ([2.0, 0.5, 0.5, 2.0], [0.1, -0.4, -0.4, 0.1]),
    "jerk up": ([0.5, 2.0, 2.0, 0.5], [0.4, -0.1, -0.1, 0.4]),
}


@pytest.mark.parametrize("name", UNEVEN)
@pytest.mark.parametrize("sign", [1, -1])
def test_the_extremes_of_a_turn_are_found_in_every_phase(name, sign):
    """Deceleration and acceleration, jerk of either sign, and a yaw rate with its maximum inside a phase."""
    law = TimeLaw(*UNEVEN[name])
    turn = Path((TurnSegment(Pose2(1.0, 2.0, 3.0), sign * float(law.states[-1, 0])),))
    dense = law.at(np.linspace(0.0, law.duration, 60_001))
    rate, acceleration, jerk = np.max(np.abs(dense[:, 1:]), axis=0)
    # A turn's jerk is bounded by acceleration * max_jerk / max(max_acceleration, max_deceleration).
    fits = {"max_yaw_rate": rate, "max_yaw_acceleration": acceleration, "max_jerk": jerk / acceleration * 0.6}
    fits = {name: value * (1.0 + 1e-4) for name, value in fits.items()}
    assert kinds(Trajectory(turn, law), MotionLimits(**fits)) == []
    for limit, kind in (("max_yaw_rate", "yaw_rate"), ("max_jerk", "yaw_jerk")):
        assert kinds(Trajectory(turn, law), MotionLimits(**{**fits, limit: fits[limit] * 0.999})) == [kind]
    less = {**fits, "max_yaw_acceleration": acceleration * 0.999, "max_jerk": 9.0}
    assert kinds(Trajectory(turn, law), MotionLimits(**less)) == ["yaw_acceleration"]


@pytest.mark.parametrize("turns", [(), (0.7,), (-0.4, 1.2), (1e-8,)], ids=str)
@pytest.mark.parametrize("last", [(), (3.0,)], ids=str)
def test_the_speed_zone_counts_metres_driven_across_turns(turns, last):
    """The zone covers driven metres, in all gears; turns in place have no length in it."""
    phases, segments, pose = [], [], Pose2(0.0, 0.0, 0.0)
    for length, then in ((2.0, turns), (0.5, last)):
        segments.append(ClothoidSegment(ClothoidSpline(pose, [0.0, length], [0.0, 0.0])))
        phases.append(move(length, speed=0.5 if length > 1.0 else 0.2))
        pose = segments[-1].spline.end
        for angle in then:
            segments.append(TurnSegment(pose, angle))
            phases.append(move(abs(angle)))
            pose = segments[-1].end
    motion = Trajectory(Path(tuple(segments)), TimeLaw(*map(np.concatenate, zip(*phases, strict=True))))
    first = TimeLaw(*phases[0]).at(np.linspace(0.0, phases[0][0].sum(), 200_001))
    slow_from = float(first[np.flatnonzero(first[:, 1] > 0.2)[-1], 0])
    assert kinds(motion, OPEN, SpeedZone(0.2001, 2.5 - slow_from - 1e-3)) == []
    assert kinds(motion, OPEN, SpeedZone(0.1999, 2.5 - slow_from + 1e-3)) == ["speed"]
    assert kinds(motion, OPEN, SpeedZone(0.2001, 2.5 - slow_from + 2e-3)) == ["speed"]


def straight(length):
    return Path((ClothoidSegment(ClothoidSpline(Pose2(0, 0, 0), [0.0, length], [0.0, 0.0])),))


def law(*phases):
    """Concatenate phases, each (durations, jerks)."""
    return TimeLaw(*(np.concatenate([np.atleast_1d(phase[i]) for phase in phases]) for i in (0, 1)))


def test_creeping_on_after_the_stop_is_no_rest_at_the_end():
    jerk, beyond = 4.0, 0.9e-6
    creeping = law(move(1.0), ((6.0 * beyond / jerk) ** (1.0 / 3.0), jerk))
    assert creeping.states[-1, 0] == pytest.approx(1.0 + beyond, abs=1e-9)
    assert creeping.states[-1, 1] > 2e-4
    assert kinds(Trajectory(straight(1.0), creeping), OPEN) == ["rest"]


def test_a_long_drift_backwards_is_refused_however_slow():
    slow, ramp = 0.45e-6, 1e-3
    jerk = slow / ramp**2
    back = ([ramp, ramp, 1e5, ramp, ramp], [-jerk, jerk, 0.0, jerk, -jerk])
    halfway = law(move(0.5), back).states[-1, 0]
    assert halfway < 0.46
    drifting = Trajectory(straight(1.0), law(move(0.5), back, move(1.0 - halfway)))
    assert kinds(drifting, OPEN) == ["coverage"]
    waiting = Trajectory(straight(1.0), law(move(0.5), ([1e5], [0.0]), move(0.5)))
    assert kinds(waiting, OPEN) == []


def test_a_wait_of_years_costs_no_memory():
    half_metre = (np.ones(4), 0.25 * np.array([1.0, -1.0, -1.0, 1.0]))  # at rest without rounding
    arc = Path((ClothoidSegment(ClothoidSpline(Pose2(0, 0, 0), [0.0, 1.0], [1.0, 1.0])),))
    waiting = Trajectory(arc, law(half_metre, ([1e9], [0.0]), half_metre))
    for limit, expected in ((0.251, []), (0.249, ["yaw_rate"])):
        assert kinds(waiting, dataclasses.replace(OPEN, max_yaw_rate=limit)) == expected


@pytest.mark.parametrize("limit", [0.5, np.inf])
@pytest.mark.parametrize("gears", [True, False])
def test_a_polyline_step_that_only_turns_is_not_covered(gears, limit):
    there = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    turn = np.array([[1.0, 0.0, 0.0], [1.0, 0.0, 3.0]])
    back = np.array([[1.0, 0.0, 3.0], [1.0 + np.cos(3.0), np.sin(3.0), 3.0]])
    parts = (there, turn, back) if gears else (np.concatenate((there, turn[1:], back[1:])),)
    turning = Path(tuple(PolylineSegment(part) for part in parts))
    motion = Trajectory(turning, law(move(1.0), move(1.0)))
    assert "coverage" in kinds(motion, dataclasses.replace(OPEN, max_yaw_rate=limit))


def test_a_zigzag_of_headings_turns_as_fast_as_its_steps():
    yaw = np.tile([0.0, 0.02], 100)
    steps = 0.01 * np.column_stack((np.cos(np.full(199, 0.01)), np.sin(np.full(199, 0.01))))
    poses = np.column_stack((np.vstack(([[0.0, 0.0]], np.cumsum(steps, axis=0))), yaw))
    zigzag = Path((PolylineSegment(poses),))
    motion = Trajectory(zigzag, TimeLaw(*move(zigzag.length, speed=0.5)))
    for limit, expected in ((0.9, ["yaw_rate"]), (1.01, [])):
        assert kinds(motion, dataclasses.replace(OPEN, max_yaw_rate=limit)) == expected


@pytest.mark.parametrize("kind", ["yaw_acceleration", "steering_rate"])
@pytest.mark.parametrize("curvature", [0.004, 0.1, 0.3])
def test_an_oscillating_curvature_is_detected(curvature, kind):
    """The means at the poses hide an oscillation that requires 12 rad/s^2."""
    n, h = 200, 0.01
    swing = 2.0 * curvature / h
    needed = {"yaw_acceleration": 0.5**2 * swing, "steering_rate": 0.4 * 0.5 * swing}[kind]
    bends = curvature * np.sin(np.pi * np.arange(n) / (n - 1)) ** 2 * (-1.0) ** np.arange(n)
    yaw = np.concatenate(([0.0], np.cumsum(bends * h)))
    middle = 0.5 * (yaw[1:] + yaw[:-1])
    x, y = (np.concatenate(([0.0], np.cumsum(h * along(middle)))) for along in (np.cos, np.sin))
    swinging = Path((PolylineSegment(np.column_stack((x, y, yaw))),))
    motion = Trajectory(swinging, TimeLaw(*move(swinging.length)))
    for share, broken in ((0.9, [kind]), (1.0, [])):
        assert kinds(motion, MotionLimits(**{f"max_{kind}": share * needed}, wheelbase=0.4)) == broken


def test_sampling_a_curve_does_not_raise_its_yaw_rate_beyond_the_tolerance_of_samples():
    exact = path((0.0, 2.0, 0.0, -2.0, 0.0))
    sampled = Path((PolylineSegment(exact.sample(0.05).poses),))
    limits = dataclasses.replace(OPEN, max_yaw_rate=1.0)
    ratios = [
        certify_trajectory(Trajectory(one, TimeLaw(*move(one.length, speed=0.45))), limits, SpeedZone()).ratios
        for one in (exact, sampled)
    ]
    assert 0.95 * ratios[0]["yaw_rate"] < ratios[1]["yaw_rate"] <= ratios[0]["yaw_rate"]


TURNING = dataclasses.replace(OPEN, max_yaw_rate=0.6, max_yaw_acceleration=1.0)


def spike(width, at=1.0, turn=0.4):
    """Return a path whose curvature rises to a peak and falls again within twice `width`."""
    knots = [0.0, at, at + width, at + 2.0 * width, 3.0]
    return Path((ClothoidSegment(ClothoidSpline(Pose2(0.0, 0.0, 0.0), knots, [0.0, 0.0, turn / width, 0.0, 0.0])),))


@pytest.mark.parametrize("width", [1e-2, 1e-10, 2.3e-16])
@pytest.mark.parametrize("resting", [False, True])
def test_a_turn_within_any_distance_is_detected(width, resting):
    motion = Trajectory(spike(width), law(move(1.0), move(2.0)) if resting else law(move(3.0)))
    found = kinds(motion, TURNING)
    assert "yaw_acceleration" in found
    assert kinds(motion, dataclasses.replace(TURNING, max_yaw_acceleration=np.inf)) == ["yaw_rate"]


@pytest.mark.parametrize("width", [1e-1, 1e-8, 2.3e-16])
def test_a_jump_of_curvature_within_any_distance_is_a_jump_of_yaw_rate(width):
    knots = [0.0, 1.0, 1.0 + width, 2.0, 3.0]
    jump = Path((ClothoidSegment(ClothoidSpline(Pose2(0.0, 0.0, 0.0), knots, [0.0, 0.0, 1.0, 1.0, 1.0])),))
    assert "yaw_acceleration" in kinds(Trajectory(jump, law(move(3.0))), TURNING)


@pytest.mark.parametrize("wait", [1.0, 1e17])
def test_the_motion_after_a_wait_of_any_length_is_judged(wait):
    circle = Path((ClothoidSegment(ClothoidSpline(Pose2(0.0, 0.0, 0.0), [0.0, 3.0], [2.0, 2.0])),))
    motion = Trajectory(circle, law(([wait], [0.0]), move(3.0)))
    assert kinds(motion, dataclasses.replace(OPEN, max_yaw_rate=0.9)) == ["yaw_rate"]
    assert kinds(motion, dataclasses.replace(OPEN, max_yaw_rate=1.1)) == []
    assert kinds(motion, OPEN, SpeedZone(0.1, 1.5)) == ["speed"]
    assert kinds(motion, dataclasses.replace(OPEN, max_speed=0.4)) == ["speed"]


@pytest.mark.parametrize("at_end", [True, False])
def test_a_turn_beyond_the_ends_of_the_motion_is_a_violation(at_end):
    width, short = 1e-9, 0.9e-6
    knots = [0.0, width, 3.0] if not at_end else [0.0, 3.0 - width, 3.0]
    curvature = [0.8 / width, 0.0, 0.0] if not at_end else [0.0, 0.0, 0.8 / width]
    turning = Path((ClothoidSegment(ClothoidSpline(Pose2(0.0, 0.0, 0.0), knots, curvature)),))
    t, j = move(3.0 - short)
    assert "coverage" in kinds(Trajectory(turning, TimeLaw(t, j, start_s=0.0 if at_end else short)), TURNING)


def test_after_the_deadline_nothing_more_is_proven():
    motion, asked = Trajectory(path(), law(move(3.0))), []
    limits = dataclasses.replace(OPEN, max_yaw_rate=2.0)
    late = certify_trajectory(motion, limits, SpeedZone(), is_late=lambda: asked.append(1) is None)
    assert [violation.kind for violation in late.violations] == ["unproven"]
    assert late.ratios["yaw_rate"] == np.inf
    assert certify_trajectory(motion, limits, SpeedZone(), is_late=lambda: False).certified


def test_too_many_cells_are_given_up(monkeypatch):
    """The lateral acceleration reaches its limit while speed and curvature rise, so no coarse cell can be cleared."""
    motion = Trajectory(path((0.0, 2.0)), law(move(3.0)))
    peak = float(np.max(motion.sample(1e-4).speed ** 2 * motion.path.curvature_at(motion.sample(1e-4).s)))
    limits = dataclasses.replace(OPEN, max_lateral_acceleration=peak * (1.0 + 1e-6))
    assert certify_trajectory(motion, limits, SpeedZone()).certified
    monkeypatch.setattr(turning_rules, "_MAX_CELLS", -1)
    again = Trajectory(motion.path, TimeLaw(motion.time_law.durations, motion.time_law.jerks))  # nothing is kept of it
    assert kinds(again, limits) == ["unproven"]


def test_blocks_of_cells_change_nothing(monkeypatch):
    motion = trajectory()
    limits = dataclasses.replace(OPEN, max_yaw_rate=0.7, max_yaw_acceleration=0.8, max_lateral_acceleration=0.3)
    whole = certify_trajectory(motion, limits, SpeedZone())
    monkeypatch.setattr(turning_rules, "_BLOCK", 7)
    again = Trajectory(motion.path, TimeLaw(motion.time_law.durations, motion.time_law.jerks))  # nothing is kept of it
    parts = certify_trajectory(again, limits, SpeedZone())
    assert parts is not whole
    assert parts.ratios == whole.ratios
    assert [one.message for one in parts.violations] == [one.message for one in whole.violations]


@pytest.mark.parametrize("seed", range(4))
def test_second_derivatives_stay_within_their_bounds(seed):
    """For every quantity that depends on curvature, with all combinations of nonzero v, a, j, k and r."""
    for which in range(1, 32):
        rng = np.random.default_rng([seed, which])
        scales = np.where([which >> i & 1 for i in range(5)], 10.0 ** rng.uniform(-1.0, 1.0, 5), 0.0)
        v, a, j, k, r = (scales * [1, *rng.choice([-1, 1], 4)]).tolist()
        width, h = 1e-2, 1e-3
        if v + a * width + 0.5 * j * width**2 < 0.0:
            continue
        drive = MotionLimits(track_width=0.7, wheelbase=1.3, max_steering_rate=1.0)
        columns = (0.0, width, 0.0, v, a, j, k, r, -np.inf, np.inf)
        first = turning_rules.Cells(*(np.array([value]) for value in columns))
        sizes = turning_rules.Sizes.over(first, first.advanced(first.width))
        t = np.arange(0.0, width + 0.5 * h, h)
        along = first.rows(np.zeros(t.size, dtype=int)).advanced(t)
        signed = {
            "yaw_rate": along.v * along.k,
            "lateral_acceleration": along.v**2 * along.k,
            "lateral_jerk": 2.0 * along.v * along.a * along.k + along.v**3 * along.r,
            "yaw_acceleration": along.a * along.k + along.v**2 * along.r,
            "wheel_speed": along.v * (1.0 + 0.35 * along.k),
            "steering_rate": 1.3 * along.r * along.v / (1.0 + (1.3 * along.k) ** 2),
        }
        for name, bend in turning_rules._BENDS.items():
            values = signed[LIMITS[name].quantity]
            bent = np.max(np.abs(np.diff(values, 2))) / h**2
            assert bent <= float(bend(sizes, drive)[0]) * (1.0 + 1e-9) + 1e-6, name
            either = np.abs(2.0 * along.v - values) if name == "max_wheel_speed" else 0.0  # the other wheel
            assert LIMITS[name].size(along, drive) == pytest.approx(np.maximum(np.abs(values), either)), name
