"""Timed motions that are known only from samples, which can refute a motion but never prove it.

Samples do not determine the motion between them, so `certify_trajectory` needs the time law. But every motion within
the limits satisfies inequalities between any two instants. With signed speed v and acceleration a, acceleration limit
A, deceleration limit D, jerk limit J and steps of h:

    slopes               |a1 - a0| <= J h,  -D h <= |v1| - |v0| <= A h;  also yaw, yaw rate, lateral acceleration
    speed, acceleration  |v1 - v0 - h (a0 + a1) / 2| <= min(J h^2 / 4, (A + D) h)
    place, speed         |s1 - s0 - h (|v0| + |v1|) / 2| <= J h^3 / 12, at rests max(A, D) h^2 / 4

The inequalities are checked between neighbouring samples and between samples 2, 4, 8, ... apart, where rounding has
less effect. In a turn in place they are also checked for yaw, yaw rate and yaw acceleration. At each sample the columns
must satisfy the limits, and yaw rate w and yaw acceleration w' must match the path's curvature k and its rate r: w =
|v| k, w' = a k + v^2 r. Between two parts of the path the robot must rest. The stop after the last sample before the
rest takes at least max(sqrt(2 v / J), a / J), with v and a of that sample. The start before the first sample after the
rest takes at least the same expression with v and a of that sample.

Columns in which all numbers have three to five decimals count as rounded; other columns count as accurate to 1e-6. The
rounding of a value is subtracted before the value is compared with its limit.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.pose import wrap_angles
from optdock.model.limits import LIMITS
from optdock.model.path import ClothoidSegment, PolylineSegment, TurnSegment, joint_curvatures, place_before_end
from optdock.samples.sampled_motion import (
    EXACT,
    ON_PATH,
    REACH,
    Rounding,
    Run,
    SampledMotion,
    gears_of,
    half_unit,
    places_of,
    runs_of,
)
from optdock.verification.certificate import TOLERANCE, Violation
from optdock.verification.clearance_kernel import end_clearances
from optdock.verification.conservative_advancement import prove_clearance
from optdock.verification.turning_rules import STEP_RTOL

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from optdock.geometry.arrays import BoolArray, FloatArray
    from optdock.model.limits import MotionLimits
    from optdock.model.path import Path
    from optdock.model.problem import DockingProblem
    from optdock.model.trajectory import Trajectory

__all__ = ["SampledMotionVerdict", "are_rounded_phases", "check_sampled_motion", "check_samples_of"]

# [m], [rad]: largest deviation from the path, where the clearance covers it. Three decimals move a pose by 0.7 mm;
# along a curve of 2 1/m that is 1.4e-3 rad.
OFF_PATH = 2e-3
_ARITHMETIC = 1e-9  # rounding of sums of numbers around 1
_STEERED = 1e-4  # relative, of a steering time: six decimals of a curvature, and the tolerance of the proof
_DECIMALS = 6  # of rounded phases
_ROUNDED = 1e-5  # [s], [m/s^3], ...: accuracy of rounded phases; ten units, because they may be rounded twice


@dataclass(frozen=True)
class SampledMotionVerdict:
    """Result of a check of samples; true if the samples do not refute the motion, which is not a proof.

    Args:
        violations: Every violated rule; empty if the samples do not refute the motion.
        samples: Number of samples.
        step: Longest time between two consecutive samples [s].
        offset: Largest deviation of the poses from the path: distance [m], turn [rad].
    """

    violations: tuple[Violation, ...]
    samples: int
    step: float
    offset: tuple[float, float] = (0.0, 0.0)

    @property
    def off_path(self) -> bool:
        """Whether the deviation of poses from the path is so large that the clearance must cover it."""
        return max(self.offset) > ON_PATH

    def __bool__(self) -> bool:
        return not self.refuted

    @property
    def refuted(self) -> bool:
        """Whether no motion within the limits has these samples."""
        return bool(self.violations)


def check_sampled_motion(motion: SampledMotion, path: Path, problem: DockingProblem) -> SampledMotionVerdict:
    """Check whether samples refute the motion that they describe, by the rules in the module docstring.

    Poses may deviate from the path by up to 2e-3 m and 2e-3 rad if the clearance of the path exceeds the required
    clearance by the resulting displacement. Otherwise poses may deviate by at most 1e-6 m and 1e-6 rad.

    Args:
        motion: The samples.
        path: The path of the motion; `certify_path` gives the verdict on the path itself.
        problem: The problem with limits, dock and start.

    Returns:
        The verdict; samples never prove a motion.
    """
    rounding, limits, step = Rounding.of(motion), problem.robot.limits, float(np.max(np.diff(motion.t)))
    with np.errstate(over="ignore", invalid="ignore"):
        error = _place_errors(motion, limits, rounding.speed)
        runs = _unjudgeable(path, step, float(np.max(error))) or runs_of(motion, path, limits, rounding)
        if isinstance(runs, Violation):
            return SampledMotionVerdict((runs,), motion.t.size, step)
        rules = _Rules(motion, path, problem, rounding, runs)
        offset = rules.check_poses()
        if max(offset) <= OFF_PATH:
            rules.check_ends()
            rules.check_samples()
            rules.check_curvature()
            rules.check_between(error)
            rules.check_rests()
            rules.check_steering()
    return SampledMotionVerdict(tuple(rules.found), motion.t.size, step, offset)


def _place_errors(motion: SampledMotion, limits: MotionLimits, rest: float) -> FloatArray:
    """Return error bounds of distances integrated from speeds by the trapezoidal rule, Shape (n - 1,) [m].

    At speeds up to `rest` the gear may change within the step, and only the acceleration limits bound the error.
    """
    h, speed, gear = np.diff(motion.t), np.abs(motion.speed), gears_of(motion, rest)
    error = 0.25 * max(limits.max_acceleration, limits.max_deceleration) * h**2
    moves = (gear[1:] == gear[:-1]) & (gear[1:] != 0.0)
    error = np.where(moves, np.minimum(error, limits.max_jerk * h**3 / 12.0), error)
    # The distance driven in the step is between 0 and that at the largest speed.
    return np.minimum(error, h * (max(limits.max_speed, limits.max_reverse_speed) + 0.5 * (speed[1:] + speed[:-1])))


def _unjudgeable(path: Path, step: float, error: float) -> Violation | None:
    """Return a violation if samples are too far apart, or if positions on a polyline are undetermined."""
    if not error <= REACH:
        message = (
            f"samples up to {step:.3g} s apart leave the motion between them uncertain by {error:.3g} m; "
            "sample it finer"
        )
        return Violation("too_coarse", message, 0.0, error)
    for segment, start in zip(path.segments, path.segment_starts[:-1], strict=True):
        still = np.flatnonzero(np.diff(segment.knots) <= 0.0)
        if still.size:
            s = float(start + segment.knots[still[0]])
            message = f"the path turns in place at s = {s:.3f} m, where samples of a motion along it cannot be checked"
            return Violation("coverage", message, s, 1.0)
    return None


def _covers(path: Path, problem: DockingProblem, offset: tuple[float, float]) -> bool:
    """Whether footprints at this distance [m] and turn [rad] from the path have the required clearance.

    Such a pose moves no point of the footprint by more than distance + radius * turn, with the circumscribed radius. If
    the start is closer to an obstacle than required, no deviation is allowed.
    """
    more = offset[0] + problem.robot.footprint.circumscribed_radius * offset[1]
    raised = replace(problem, clearance=problem.clearance.raised(more))
    at_start = end_clearances(problem).start
    return prove_clearance(path, raised).holds and at_start >= raised.path_clearance.required


class _Bends(NamedTuple):
    """Curvature of the path near the samples, within the rounding of their positions.

    `low`, `high`: range of the curvature, Shape (n,) [1/m]; `curvature`, `rate`: curvature and its rate just before, at
    and just after each sample, Shape (3, n) [1/m], [1/m^2];
    `exact`: whether the sample is on a clothoid, Shape (n,).
    """

    low: FloatArray
    high: FloatArray
    curvature: FloatArray
    rate: FloatArray
    exact: BoolArray

    @classmethod
    def of(cls, path: Path, s: FloatArray, near: float) -> _Bends:
        places = [np.clip(s + shift, 0.0, path.length) for shift in (-near, 0.0, near)]
        curvature = np.array([np.clip(path.curvature_at(place), -1e9, 1e9) for place in places])
        rate = np.array([path.curvature_rate_at(place) for place in places])
        low, high, exact = curvature.min(axis=0), curvature.max(axis=0), np.ones(s.size, dtype=np.bool_)
        owners = np.clip(np.searchsorted(path.segment_starts, s, side="right") - 1, 0, len(path.segments) - 1)
        for i, segment in enumerate(path.segments):
            if isinstance(segment, PolylineSegment):
                rows = np.flatnonzero(owners == i)
                least, most = _polyline_curvatures(segment)
                local = s[rows] - path.segment_starts[i]
                step = np.clip(np.searchsorted(segment.knots, local, side="right") - 1, 0, segment.knots.size - 2)
                low[rows], high[rows] = np.minimum(low[rows], least[step]), np.maximum(high[rows], most[step])
                exact[rows] = False
        return cls(low, high, curvature, rate, exact)


def _polyline_curvatures(segment: PolylineSegment) -> tuple[FloatArray, FloatArray]:
    """Return the least and the largest possible curvature [1/m] of the sampled curve on each step, Shape (steps,) each.

    The turn of a step gives only the mean curvature, so the range includes the neighbouring steps, widened by their
    difference and by the rounding of the poses.
    """
    k = segment.step_curvature
    around = np.lib.stride_tricks.sliding_window_view(np.pad(k, 1, mode="edge"), 3)
    low, high = around.min(axis=1), around.max(axis=1)
    longer = math.sqrt(2.0) * half_unit(segment.poses[:, 0], segment.poses[:, 1])
    noise = 2.0 * (half_unit(segment.poses[:, 2]) + longer * np.abs(k)) / np.diff(segment.knots)
    return low - (high - low) - noise, high + (high - low) + noise


class _Rules:
    """The rules for samples on their path; `found` collects the violations."""

    def __init__(
        self, motion: SampledMotion, path: Path, problem: DockingProblem, rounding: Rounding, runs: Sequence[Run]
    ) -> None:
        self.found: list[Violation] = []
        self._motion, self._path, self._problem, self._rounding = motion, path, problem, rounding
        self._limits, self._runs, self._gear = problem.robot.limits, runs, gears_of(motion, rounding.speed)
        self._slack, self._early = math.sqrt(2.0) * rounding.place, 2.0 * rounding.time
        self._h, self._v = np.diff(motion.t), np.maximum(np.abs(motion.speed) - rounding.speed, 0.0)
        self._travelled, turned = (_integral(self._h, c) for c in (np.abs(motion.speed), motion.yaw_rate))
        self._yaw = turned + _sums(wrap_angles(np.diff(motion.yaw - turned))) + motion.yaw[0]
        self._places = places_of(motion, path, runs, self._travelled, self._yaw)

    def _add(self, kind: str, message: str, s: float, amount: float) -> None:
        self.found.append(Violation(kind, message, s, amount))

    def _at_most(
        self, kind: str, values: FloatArray, limit: FloatArray | float, rough: float = 0.0, first: int = 0
    ) -> None:
        """Compare values from sample `first` on, accurate to `rough`, with their limit; report the worst violation."""
        limits = np.broadcast_to(np.asarray(limit, dtype=np.float64), values.shape)
        beyond = values - rough - limits * (1.0 + TOLERANCE) - _ARITHMETIC
        beyond = np.where(np.isnan(beyond), np.inf, beyond)
        i = int(np.argmax(beyond))
        if beyond[i] > 0.0:
            t, s = self._motion.t[first + i], float(self._places.s[first + i])
            message = f"{kind}: {values[i]:.6g} at t = {t:.3f} s, limit {limits[i]:.6g}"
            self._add(kind.partition(" [")[0].replace(" ", "_"), message, s, float(beyond[i]))

    def _limited(self, values: Mapping[str, tuple[FloatArray, float]]) -> None:
        """Compare values with their limits; `values` contains value and rounding by the name of the limit."""
        for name, (value, rough) in values.items():
            if math.isfinite(most := getattr(self._limits, name)):
                self._at_most(LIMITS[name].label, value, most, rough)

    def _slopes(self, kind: str, column: FloatArray, limit: float, rough: float, rows: slice = slice(None)) -> None:
        """Compare mean increases per second between samples 1, 2, 4, ... apart with their limit.

        `rough`: accuracy of a difference of two values. Only violations at the smallest distance are reported.
        """
        column, t, lag = column[rows], self._motion.t[rows], 1
        known, rough = len(self.found), rough + self._early * limit
        while lag < column.size and len(self.found) == known and math.isfinite(limit):
            mean = (column[lag:] - column[:-lag] - rough) / (t[lag:] - t[:-lag])
            self._at_most(kind, mean, limit, first=rows.start or 0)
            lag *= 2

    def _residuals(
        self, kind: str, column: FloatArray, bound: FloatArray, rough: float, rows: slice = slice(None)
    ) -> None:
        """Compare changes of a residual between samples 1, 2, 4, ... apart with the summed bounds of the steps."""
        column, allowed, lag, known = column[rows], _sums(bound)[rows], 1, len(self.found)
        while lag < column.size and len(self.found) == known and np.isfinite(allowed[-1]):
            change, most = np.abs(column[lag:] - column[:-lag]), allowed[lag:] - allowed[:-lag]
            self._at_most(kind, change, most, rough, rows.start or 0)
            lag *= 2

    def check_poses(self) -> tuple[float, float]:
        """Check that poses are on the path, or that the clearance covers their deviations.

        Return the largest distance [m] and the largest angle [rad] from the path.
        """
        motion, apart, turned = self._motion, self._places.apart, self._places.turned
        offset = (float(np.max(apart)), float(np.max(turned)))
        i = int(np.argmax(np.maximum(apart, turned)))
        message = f"pose at t = {motion.t[i]:.3f} s is {apart[i]:.4g} m and {turned[i]:.4g} rad off the path"
        if not max(offset) <= OFF_PATH:
            in_degrees = wrap_angles(np.radians(motion.yaw) - self._path.poses_at(self._places.s)[:, 2])
            if turned[i] > 0.1 and np.max(np.abs(in_degrees)) < 0.1:
                message += "; is yaw in degrees?"
        elif max(offset) <= ON_PATH or _covers(self._path, self._problem, offset):
            return offset
        else:
            message += ", and the clearance does not cover it"
        self._add("off_path", message, float(self._places.s[i]), max(offset))
        return offset

    def check_ends(self) -> None:
        """Check that the motion begins at the start with the robot's state, and ends at rest at the end of the path."""
        motion, rounding, problem, path = self._motion, self._rounding, self._problem, self._path
        first, last = float(self._places.s[0]), float(self._places.s[-1])
        slack = [2.0 * self._slack + OFF_PATH * isinstance(path.segments[i], TurnSegment) for i in (0, -1)]
        if first > slack[0]:
            self._add("coverage", f"begins: at s = {first:.6g} m, the path at 0 m", first, first)
        if last < path.length - slack[1]:
            message = f"travelled: {last:.4f} m, the path is {path.length:.4f} m long"
            self._add("coverage", message, last, path.length - last)
        for name, wanted in (("speed", problem.start_speed), ("acceleration", problem.start_acceleration)):
            found = float(getattr(motion, name)[0])
            if not abs(found - wanted) <= getattr(rounding, name):
                message = f"start {LIMITS[f'max_{name}'].label}: {found:.6g}, the robot has {wanted:.6g}"
                self._add("start_state", message, 0.0, abs(found - wanted))
        yaw = ("yaw_rate", "yaw_acceleration") if isinstance(path.segments[-1], TurnSegment) else ()
        for name in ("speed", "acceleration", *yaw):
            found = float(getattr(motion, name)[-1])
            if not abs(found) <= getattr(rounding, name) + _ARITHMETIC:
                message = f"end {LIMITS[f'max_{name}'].label}: {found:.6g} at t = {motion.t[-1]:.3f} s, must be 0"
                self._add("rest", message, last, abs(found))

    def check_samples(self) -> None:
        """Check the limits of speed, acceleration and jerk; a sample at rest may belong to either gear."""
        motion, limits, zone, v = self._motion, self._limits, self._problem.dock.approach, self._v
        self._at_most("speed [m/s]", v, np.where(motion.speed >= 0.0, limits.max_speed, limits.max_reverse_speed))
        slow = self._places.s > place_before_end(self._path, zone.distance) + self._slack + _ARITHMETIC
        self._at_most("approach speed [m/s]", np.where(slow, v, 0.0), zone.speed)
        along, rough = self._gear * motion.acceleration, self._rounding.acceleration
        self._limited({"max_acceleration": (along, rough), "max_deceleration": (-along, rough)})
        still = np.where(self._gear == 0.0, np.abs(motion.acceleration), 0.0)
        self._at_most(
            "acceleration at rest [m/s^2]", still, max(limits.max_acceleration, limits.max_deceleration), rough
        )
        self._limited({"max_jerk": (np.abs(motion.jerk), self._rounding.jerk)})

    def check_curvature(self) -> None:
        """Check the limits of quantities that depend on curvature, and compare the yaw columns with the curvature."""
        motion, limits, rounding, v = self._motion, self._limits, self._rounding, self._v
        bends = _Bends.of(self._path, self._places.s, self._slack + _ARITHMETIC)
        yaw_rate = np.abs(motion.yaw_rate)
        # The curvature of a polyline is a difference quotient: 5 % beyond a limit are accepted, as for time laws.
        sideways = np.maximum(yaw_rate - rounding.yaw_rate, 0.0) / np.where(bends.exact, 1.0, 1.0 + STEP_RTOL)
        steering = limits.steering_per_metre(np.abs(bends.curvature).max(axis=0), np.abs(bends.rate).min(axis=0))
        self._limited(
            {
                "max_yaw_rate": (yaw_rate, rounding.yaw_rate),
                "max_yaw_acceleration": (np.abs(motion.yaw_acceleration), rounding.yaw_acceleration),
                "max_lateral_acceleration": (v * sideways, 0.0),
                "max_wheel_speed": (v + 0.5 * limits.track_width * sideways, 0.0),
                "max_steering_rate": (np.where(bends.exact, v * steering, 0.0), 0.0),
            }
        )
        # At rest next to a turn in place, the yaw columns may be those of the turn.
        drives = (self._gear != 0.0) | (not self._path.turns)
        speed, a = np.abs(motion.speed), np.abs(motion.acceleration)
        ranges = ((speed - rounding.speed, speed + rounding.speed), (bends.low - EXACT, bends.high + EXACT))
        rates = np.array([one * bend for one in ranges[0] for bend in ranges[1]])
        off = np.maximum(rates.min(axis=0) - motion.yaw_rate, motion.yaw_rate - rates.max(axis=0)) - rounding.yaw_rate
        self._at_most("yaw rate off speed times curvature [rad/s]", np.where(drives, off, 0.0), 0.0)
        k, r = bends.curvature, bends.rate
        rough = rounding.acceleration * np.abs(k) + (2.0 * speed + rounding.speed) * rounding.speed * np.abs(r)
        rough = rough + self._slack * np.abs(a * r) + EXACT * (a + speed**2)
        at_rest = np.where(self._gear == 0.0, 2.0 * np.abs(a * k), 0.0)  # in either gear
        gains = self._gear * motion.acceleration * k + speed**2 * r
        least, most = (gains - rough - at_rest).min(axis=0), (gains + rough + at_rest).max(axis=0)
        off = np.maximum(least - motion.yaw_acceleration, motion.yaw_acceleration - most) - rounding.yaw_acceleration
        self._at_most("yaw acceleration off the path's [rad/s^2]", np.where(bends.exact & drives, off, 0.0), 0.0)

    def check_between(self, error: FloatArray) -> None:
        """Check changes between samples against limits and integrals of derivatives; `error`: see `_place_errors`."""
        motion, limits, rounding, early, h = self._motion, self._limits, self._rounding, self._early, self._h
        v, up, down, jerk = np.abs(motion.speed), limits.max_acceleration, limits.max_deceleration, limits.max_jerk
        self._slopes("mean acceleration [m/s^2]", v, up, 2.0 * rounding.speed)
        self._slopes("mean deceleration [m/s^2]", -v, down, 2.0 * rounding.speed)
        top, turning = float(np.max(v)), float(np.max(np.abs(motion.yaw_rate)))
        lateral = (top + rounding.speed) * rounding.yaw_rate + turning * rounding.speed
        # At a cusp the signs of speed and acceleration change. Time laws rest there to 1e-6, and a sample within 1e-13
        # m of the cusp, where a = J^(2/3) (6e-13 m)^(1/3), may have the signs of the other gear.
        rest = EXACT if len(self._runs) > 1 else 0.0
        wrong_sign = float(np.cbrt(jerk) ** 2 * np.cbrt(6e-13)) if len(self._runs) > 1 else 0.0
        for name, column, rounded in (
            ("max_jerk", motion.acceleration, rounding.acceleration + rest + wrong_sign),
            ("max_yaw_rate", self._yaw, rounding.yaw),
            ("max_yaw_acceleration", motion.yaw_rate, rounding.yaw_rate),
            ("max_lateral_jerk", motion.speed * motion.yaw_rate, lateral),
        ):
            for sign in (1.0, -1.0):
                self._slopes(f"mean {LIMITS[name].label}", sign * column, getattr(limits, name), 2.0 * rounded)
        bound = np.minimum(0.25 * jerk * h**2, (up + down) * h) + rounding.acceleration * h
        rough = 2.0 * (rounding.speed + rest) + early * max(up, down)
        residual = motion.speed - _integral(h, motion.acceleration)
        self._residuals("speed off its accelerations [m/s]", residual, bound, rough)
        # Next to a curve the distance driven differs from that on the curve.
        bound = error + rounding.speed * h + float(np.max(self._places.apart)) * np.abs(np.diff(self._yaw))
        rough = 2.0 * self._slack + early * max(limits.max_speed, limits.max_reverse_speed)
        self._residuals("distance off its speeds [m]", self._places.driven - self._travelled, bound, rough)
        for run in self._runs:
            if run.is_turn:
                self._check_turn(run)

    def _check_turn(self, run: Run) -> None:
        """Check that driving columns are 0 in a turn in place, and check its yaw columns like those of a drive."""
        motion, rounding, early, h = self._motion, self._rounding, self._early, self._h
        fastest, steepest, jerk = self._limits.turning
        rows, w, gain = slice(run.first, run.last + 1), motion.yaw_rate, motion.yaw_acceleration
        for kind, column, rounded, most in (
            ("acceleration in a turn [m/s^2]", motion.acceleration, rounding.acceleration, 0.0),
            ("jerk in a turn [m/s^3]", motion.jerk, rounding.jerk, 0.0),
            ("yaw rate in a turn [rad/s]", w, rounding.yaw_rate, fastest),
            ("yaw acceleration in a turn [rad/s^2]", gain, rounding.yaw_acceleration, steepest),
        ):
            self._at_most(kind, np.abs(column[rows]), most, rounded, run.first)
        for sign in (1.0, -1.0):
            self._slopes("mean yaw acceleration in a turn [rad/s^2]", sign * w, steepest, 2.0 * rounding.yaw_rate, rows)
            self._slopes("mean yaw jerk [rad/s^3]", sign * gain, jerk, 2.0 * rounding.yaw_acceleration, rows)
        bound = np.minimum(0.25 * jerk * h**2, 2.0 * steepest * h) + rounding.yaw_acceleration * h
        rough = 2.0 * rounding.yaw_rate + early * steepest
        self._residuals("yaw rate off its accelerations [rad/s]", w - _integral(h, gain), bound, rough, rows)
        bound = np.minimum(jerk * h**3 / 12.0, 0.25 * steepest * h**2) + rounding.yaw_rate * h
        rough = 2.0 * rounding.yaw + early * fastest
        self._residuals("yaw off its rates [rad]", self._yaw - _integral(h, w), bound, rough, rows)
        missing = run.end - run.begin - abs(float(self._yaw[run.last] - self._yaw[run.first]))
        if missing > np.pi + 2.0 * float(np.max(h)) * fastest:  # one full turn less has the same heading
            message = f"turned: {missing:.4g} rad less than the path at s = {run.begin:.3f} m"
            self._add("coverage", message, run.begin, missing)

    def check_rests(self) -> None:
        """Check that the samples between two parts of the path leave enough time to stop and to start again."""
        t = self._motion.t
        for before, behind in itertools.pairwise(self._runs):
            last, first = before.last, behind.first
            needed, given = self._stop(before, last) + self._stop(behind, first), float(t[first] - t[last])
            message = f"must rest between t = {t[last]:.3f} s and {t[first]:.3f} s, which takes {needed:.3g} s"
            self._check_wait(
                needed, given * (1.0 + TOLERANCE), f"cusp at s = {before.end:.3f} m: {message}", before.end
            )

    def _check_wait(self, needed: float, given: float, message: str, s: float) -> None:
        missing = needed - given - self._early - _ARITHMETIC
        if missing > 0.0:
            self._add("rest", message, s, missing)

    def _stop(self, run: Run, i: int) -> float:
        """Return the least time [s] between sample `i` and a rest."""
        limits, names = self._limits, ("speed", "acceleration")
        steepest, jerk = max(limits.max_acceleration, limits.max_deceleration), limits.max_jerk
        if run.is_turn:
            names, (_, steepest, jerk) = ("yaw_rate", "yaw_acceleration"), limits.turning
        pairs = ((float(getattr(self._motion, name)[i]), getattr(self._rounding, name)) for name in names)
        v, a = (max(abs(value) - rounded, 0.0) for value, rounded in pairs)
        return float(max(math.sqrt(2.0 * v / jerk), a / jerk, v / steepest))

    def check_steering(self) -> None:
        """Check that steered wheels have time to turn at the start and at cusps.

        At the ends of a polyline the curvature is only a difference quotient, so only clothoids are checked.
        """
        path, t, s, slack = self._path, self._motion.t, self._places.s, 2.0 * self._slack
        if not np.isfinite(self._limits.max_steering_rate) or path.turns:
            return
        exact = [isinstance(segment, ClothoidSegment) for segment in path.segments]
        under_way = np.flatnonzero(s > slack)
        waits = [(self._problem.start_wait(path), 0.0, 0, under_way[0])] if exact[0] and under_way.size else []
        needed = self._limits.steering_times(joint_curvatures(path)).tolist()
        for i, cusp in enumerate(path.cusps):
            before, behind = np.flatnonzero(s < cusp - slack), np.flatnonzero(s > cusp + slack)
            if exact[i] and exact[i + 1] and before.size and behind.size:
                waits.append((needed[i], cusp, before[-1], behind[0]))
        for wait, cusp, first, last in waits:
            message = f"s = {cusp:.3f} m: the wheels turn for {wait:.4g} s, the robot moves at t = {t[last]:.3f} s"
            self._check_wait(wait * (1.0 - _STEERED), float(t[last] - t[first]), message, cusp)


def _sums(steps: FloatArray) -> FloatArray:
    """Return the cumulative sums of steps, Shape (n - 1,), beginning with 0. Shape (n,)."""
    return np.concatenate(([0.0], np.cumsum(steps)))


def _integral(h: FloatArray, column: FloatArray) -> FloatArray:
    """Return the integral of a column by the trapezoidal rule with widths `h`. Shape (n,)."""
    return _sums(0.5 * h * (column[:-1] + column[1:]))


def are_rounded_phases(trajectory: Trajectory, motion: SampledMotion) -> bool:
    """Whether differences between phases and samples, or an exceeded limit, can be due to rounding.

    The numbers of the phases have at most six decimals and an error of at most r = 1e-5 each. With n phases of
    durations d and jerks j, the borders have an error of n r. The acceleration has the error e = r (1 + sum |j| + sum
    d) in addition to its change within the error of the borders. The errors of speed and distance are the integrals of
    this error.

    Args:
        trajectory: The path and the motion according to the phases.
        motion: The samples.
    """
    law = trajectory.time_law
    if not np.array_equal(np.round(law.durations, _DECIMALS), law.durations):
        return False
    t, early = law.duration, _ROUNDED * law.durations.size
    by_phases = trajectory.sample_at(motion.t)
    steepest = float(np.max(np.abs(motion.acceleration))) + _ROUNDED
    fastest = float(np.max(np.abs(motion.speed))) + _ROUNDED
    e = _ROUNDED * (1.0 + float(np.sum(np.abs(law.jerks))) + t)
    speed = _ROUNDED + t * e + early * steepest
    place = _ROUNDED + t * speed + early * fastest + OFF_PATH
    apart = np.hypot(motion.x - by_phases.x, motion.y - by_phases.y)
    rough = Rounding.of(motion)
    return bool(
        abs(t - motion.t[-1]) <= early + rough.time
        and np.max(np.abs(motion.acceleration - by_phases.acceleration))
        <= e + early * float(np.max(np.abs(law.jerks))) + rough.acceleration
        and np.max(np.abs(motion.speed - by_phases.speed)) <= speed + rough.speed
        and np.max(apart) <= place + rough.place
    )


def check_samples_of(trajectory: Trajectory, motion: SampledMotion, problem: DockingProblem) -> SampledMotionVerdict:
    """Check whether samples belong to `trajectory`, within 1e-6 or the rounding of their columns.

    The clearance must cover deviations of more than 1e-6. At jumps of jerk and yaw acceleration, the values of both
    sides and all values between them are accepted.

    Args:
        trajectory: The motion; `certify_trajectory` gives the verdict on the motion itself.
        motion: The samples.
        problem: The problem with limits, dock and start.
    """
    step, count, rounding = float(np.max(np.diff(motion.t))), motion.t.size, Rounding.of(motion)
    for name, found, wanted in (("begin", motion.t[0], 0.0), ("end", motion.t[-1], trajectory.duration)):
        if not abs(found - wanted) <= EXACT + rounding.time:
            message = f"the samples {name} at t = {found:.6g} s, the phases at {wanted:.6g} s"
            violation = Violation("phases", message, 0.0, abs(float(found - wanted)))
            return SampledMotionVerdict((violation,), count, step)
    near = EXACT + rounding.time
    exact, *sides = (trajectory.sample_at(motion.t + shift) for shift in (0.0, -near, near))
    violations = []
    for name in SampledMotion._fields[1:]:
        found = getattr(motion, name)
        around = np.array([getattr(samples, name) for samples in (exact, *sides)])
        if name == "yaw":
            around = found + wrap_angles(around - found)
        off = np.maximum(around.min(axis=0) - found, found - around.max(axis=0))
        allowed = rounding.place if name in ("x", "y") else getattr(rounding, name)
        off = off - 4.0 * np.spacing(np.abs(found)) - allowed
        i = int(np.argmax(off))
        if not off[i] <= 0.0:
            message = f"{name} at t = {motion.t[i]:.3f} s is {found[i]:.6g}, by the phases {around[0, i]:.6g}"
            violations.append(Violation("phases", message, float(exact.s[i]), float(off[i] + allowed)))
    apart = float(np.max(np.hypot(motion.x - exact.x, motion.y - exact.y)))
    turned = float(np.max(np.abs(wrap_angles(motion.yaw - exact.yaw))))
    offset = (apart, turned)
    if not violations and max(offset) > ON_PATH and not _covers(trajectory.path, problem, offset):
        message = (
            f"samples are up to {apart:.3g} m and {turned:.3g} rad off the path, and the clearance does not cover it"
        )
        violations.append(Violation("off_path", message, 0.0, max(offset)))
    return SampledMotionVerdict(tuple(violations), count, step, offset)
