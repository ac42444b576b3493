"""Pose estimation: dead reckoning, corrected by measured poses that may be late, noisy or wrong.

`DeadReckoning` integrates poses and twists of the odometry. `PoseFilter` is an extended Kalman filter ([Thrun2005] ch.
3 and 7, [BarShalom2001]) of the pose in a fixed frame, the map or the frame of a dock. Its state also contains
systematic errors: a scale error of the distance, a rotation per distance, and the delay of the measurements relative to
the odometry.

Measurements outside the gate are stored separately; if a few of them agree within a short time, the estimate moves to
them. Innovations with a persistent sign contradict the model, and the covariance is then increased.
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from optdock.errors import InvalidValue
from optdock.geometry.arrays import readonly
from optdock.geometry.checked import finite_number
from optdock.geometry.pose import Pose2, Twist2, arc_end, normalize_angle
from optdock.kernels import Kernel, twin_of

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from optdock.model.measurements import OdometryPose

__all__ = ["AHEAD", "DeadReckoning", "OdometryErrors", "PoseFilter"]

_ORIGIN = Pose2(0.0, 0.0, 0.0)
_IDENTITY, _SEEN = readonly(np.eye(6)), readonly(np.eye(3, 6))
AHEAD = 0.01  # [s]: rounding and jitter of stamps; stamps further ahead come from another clock
# A larger difference between the pose of the odometry and the integrated twists means that the odometry's frame has
# restarted. The bounds are far above the error of the twists, and include the motion of a fast robot without twists.
_LEAP = 0.3, 0.5  # [m], [rad]
_FASTEST = 3.0, 6.0  # [m/s], [rad/s]
_IDLE = 0.05, 0.1  # [m], [rad] by the twists at a constant pose: beyond, the driver does not fill in the pose


class DeadReckoning:
    """Pose of the robot by odometry, relative to its first pose.

    Increments of the odometry's poses are accumulated, so a restart of the odometry's frame has no effect. Twists are
    integrated from the newest pose to the present, or over the whole time if there are no poses.

    Args:
        stamp: Stamp of the first reading [s].
        twist: Body velocity.
        odometry: Pose of the odometry; None without a pose.

    Attributes:
        pose: Present pose.
        restarts: Number of restarts of the odometry's frame.
    """

    def __init__(self, stamp: float, twist: Twist2, odometry: OdometryPose | None = None) -> None:
        self.pose = _ORIGIN
        self.restarts = 0
        self._stamp, self._twist = stamp, twist
        self._known, self._at_known = odometry, _ORIGIN  # newest pose of the odometry, and the robot then
        self._since: list[tuple[float, Pose2]] = [(stamp, _ORIGIN)]  # motion since then, by the twists
        self._idle = _ORIGIN  # motion by the twists since the odometry's pose changed

    def advance(self, stamp: float, twist: Twist2, odometry: OdometryPose | None = None) -> Pose2:
        """Advance to `stamp` [s] and return the motion since the last reading, in the frame of the last pose.

        Args:
            stamp: Stamp of the reading, not before the last one [s].
            twist: Body velocity.
            odometry: Newest pose; repeated and older poses are ignored.
        """
        before, period, step = self.pose, stamp - self._stamp, _ORIGIN
        if period > 0.0:
            # Trapezoidal rule.
            old, new = self._twist, twist
            v, w, u = old.linear + new.linear, old.angular + new.angular, old.lateral + new.lateral
            step = Pose2(*arc_end(0.0, 0.0, 0.0, (0.5 * v, 0.5 * w, 0.5 * u), period))
            self.pose = before @ step
            if self._known is not None:
                self._idle = self._idle @ step
            self._since.append((stamp, self.pose))
        self._stamp, self._twist = stamp, twist
        if odometry is not None and math.isfinite(odometry.stamp) and odometry.stamp <= stamp + AHEAD:
            moved = self.pose
            self._join(odometry)
            if self.pose is not moved:
                step = before.inverse() @ self.pose
        if self._known is None:
            del self._since[:-1]
        return step

    def _join(self, odometry: OdometryPose) -> None:
        known, then = self._known, _between(self._since, odometry.stamp)
        if known is None:
            found, self._idle = then, self.pose
        elif odometry.stamp <= known.stamp:
            return
        elif odometry.pose == known.pose and _is_beyond(self._idle, _IDLE):
            found = self._at_known @ self._idle  # the pose is not filled in
            self._since, self.pose = [(self._stamp, found)], found
            return
        else:
            found, passed = self._at_known @ (known.pose.inverse() @ odometry.pose), odometry.stamp - known.stamp
            if _is_beyond(found.in_frame_of(then), (_LEAP[0] + _FASTEST[0] * passed, _LEAP[1] + _FASTEST[1] * passed)):
                self.restarts += 1
                found = then
            if odometry.pose != known.pose:
                self._idle = _ORIGIN
        self._known, self._at_known = odometry, found
        moved = found @ then.inverse()
        later = [(stamp, moved @ pose) for stamp, pose in self._since if stamp > odometry.stamp]
        self._since = [(odometry.stamp, found), *later]
        self.pose = self._since[-1][1]


def _is_beyond(gap: Pose2, most: tuple[float, float]) -> bool:
    """Whether a gap is larger than a distance [m] or an angle [rad]."""
    return math.hypot(gap.x, gap.y) > most[0] or abs(gap.yaw) > most[1]


def _between(readings: list[tuple[float, Pose2]] | deque[tuple[float, Pose2]], stamp: float) -> Pose2:
    """Return the pose at a stamp, interpolated along arcs; constant before the first and after the last reading."""
    after = _count_until(readings, stamp)
    if after == 0:
        return readings[0][1]
    if after == len(readings):
        return readings[-1][1]
    (begin, before), (end, pose) = readings[after - 1], readings[after]
    return before.moved(_arc(pose.in_frame_of(before)), (stamp - begin) / (end - begin))


def _count_until(readings: list[tuple[float, Pose2]] | deque[tuple[float, Pose2]], stamp: float) -> int:
    """Return the number of readings up to a stamp, which is usually one of the last."""
    count = len(readings)
    while count > 0 and readings[count - 1][0] > stamp:
        count -= 1
    return count


def _arc(step: Pose2) -> Twist2:
    """Return the constant twist that moves by `step` in one second; the inverse of `Pose2.moved`."""
    half = 0.5 * normalize_angle(step.yaw)
    grow = half / math.sin(half) if abs(half) > 1e-9 else 1.0
    c, s = math.cos(half), math.sin(half)
    return Twist2(grow * (c * step.x + s * step.y), 2.0 * half, grow * (c * step.y - s * step.x))


class OdometryErrors(NamedTuple):
    """Standard deviations of errors in dead reckoning and in the stamps of measurements.

    Attributes:
        along: Random error of the distance after one metre [m/m^0.5].
        yaw_per_way: Random error of yaw after one metre [rad/m^0.5].
        yaw_per_turn: Random error of yaw after a rotation by 1 rad [rad/rad^0.5].
        wander: Random walk of the fixed frame, x and y each [m/s^0.5].
        yaw_wander: Random walk of the fixed frame's yaw [rad/s^0.5].
        scale: Systematic error of the distance, such as a wrong wheel radius [1].
        drift: Systematic rotation per distance, such as unequal wheels [rad/m].
        delay: Systematic delay of the measurements relative to the odometry [s].
        jitter: Random delay of the measurements [s].
    """

    along: float = 0.003
    yaw_per_way: float = 0.003
    yaw_per_turn: float = 0.01
    wander: float = 5e-4
    yaw_wander: float = 5e-4
    scale: float = 0.0
    drift: float = 0.0
    delay: float = 0.0
    jitter: float = 0.0


Verdict = Literal["accepted", "rejected", "moved", "forgotten"]
GATE = 16.27  # squared Mahalanobis distance in three dimensions, exceeded by one measurement in 1000
_ALWAYS_NEAR = 0.005, 0.01  # [m], [rad]: no measurement closer than this is rejected
_MEMORY = 2.0  # [s] for which motion is stored for late measurements, and rejected measurements are kept
_LONGEST_DELAY = 0.5  # [s]: bound of the estimated delay
_INNOVATIONS = 8  # number of innovations whose mean is tested
_SUDDEN, _SUDDEN_GATE = 3, 11.34  # innovations after a wheel slip; the gate is exceeded by one mean in 100
_SLIPPED = 0.05  # [m] driven in the last two seconds below which a jump does not count as wheel slip
_CLOSE_GATE = 4.11  # 75 % quantile of chi-squared with three degrees of freedom
_ESTABLISHED = 8  # accepted measurements; an earlier jump may correct a wrong first pose
_SLIP_MEMORY = 2.0  # [m] after which the expectation of another slip has decayed to a third
_DOUBT = 3.0  # factor on the prior of the systematic errors after innovations with a persistent sign


class PoseFilter:
    """Filter of the robot's pose in a fixed frame, from dead reckoning and measured poses at any rate.

    Args:
        errors: Errors of the odometry.
        confirmations: Number of rejected measurements that must agree with each other to move the estimate.
        fewer_when_close: Reduction of `confirmations` if the measurements agree within the 75 % bound of their noise.

    Attributes:
        covariance: Covariance of x, y [m], yaw [rad] in the fixed frame, and of scale [1], drift [rad/m] and delay [s];
            Shape (6, 6).
        systematic: Estimated scale [1], drift [rad/m] and delay [s], Shape (3,).
        accepted: Number of accepted measurements.
        jump: Displacement of the estimate, in the frame of the earlier estimate, if the last correction moved it to
            rejected measurements; None otherwise.
        rejected: Number of consecutive rejected measurements.
        doubts: Number of increases of the covariance by innovations with a persistent sign.
        measured_at: Stamp of the newest accepted measurement [s]; -inf before the first accepted measurement.

    Raises:
        InvalidValue: If a standard deviation is negative or not finite.
    """

    def __init__(self, errors: OdometryErrors, *, confirmations: int = 4, fewer_when_close: int = 0) -> None:
        for name, value in errors._asdict().items():
            if not finite_number(value, f"pose filter: {name}") >= 0.0:
                raise InvalidValue(f"pose filter: {name}: must be >= 0, got {value}")
        self._errors, self._confirmations, self._fewer_when_close = errors, confirmations, fewer_when_close
        self._expected = errors  # of the next step: increased for a while after wheel slip
        self.covariance: FloatArray = np.zeros((6, 6))
        self.systematic: FloatArray = np.zeros(3)
        self.jump: Pose2 | None = None
        self.accepted = self.rejected = self.doubts = 0
        self.measured_at = -math.inf
        self._estimate: Pose2 | None = None
        # Corrected dead reckoning; past poses are the present estimate moved back along it.
        self._reckoned: deque[tuple[float, Pose2]] = deque()
        self._outside: list[_Outside] = []
        self._whitened: deque[tuple[float, float, float]] = deque(maxlen=_INNOVATIONS)

    @property
    def started(self) -> bool:
        """Whether the filter has an estimate."""
        return self._estimate is not None

    @property
    def pose(self) -> Pose2:
        """Present estimate.

        Raises:
            InvalidValue: If the filter was not started.
        """
        if self._estimate is None:
            raise InvalidValue("pose filter: has no pose yet; start it with one")
        return self._estimate

    @property
    def stamp(self) -> float:
        """Stamp of the last prediction [s]; -inf before the start."""
        return self._reckoned[-1][0] if self._reckoned else -math.inf

    @property
    def remembered_from(self) -> float:
        """Earliest stamp with a stored pose [s]; infinite before the start."""
        return self._reckoned[0][0] if self._reckoned else math.inf

    def start(self, stamp: float, pose: Pose2, covariance: FloatArray) -> None:
        """Start the filter, or restart it without a change of the estimated systematic errors.

        Args:
            stamp: Present time [s].
            pose: Initial estimate.
            covariance: Covariance of the estimate, Shape (3, 3) [m, m, rad].

        Raises:
            InvalidValue: If the stamp is not finite, or earlier than the last one.
        """
        self._check_clock(stamp)
        if not self.started:
            scale, drift, delay = self._errors.scale, self._errors.drift, self._errors.delay
            self.covariance[3:, 3:] = np.diag([scale**2, drift**2, delay**2])
            self._reckoned.append((stamp, _ORIGIN))
        self.place(pose, covariance)

    def place(self, pose: Pose2, covariance: FloatArray) -> None:
        """Replace the estimate of the pose; systematic errors and past motion are kept."""
        self._estimate = pose
        self._outside.clear()
        self._whitened.clear()
        self.covariance[:3, :] = 0.0
        self.covariance[:, :3] = 0.0
        self.covariance[:3, :3] = covariance

    def predict(self, stamp: float, step: Pose2) -> Pose2:
        """Return the estimate predicted for `stamp`.

        Args:
            stamp: Present time [s].
            step: Motion by odometry since the last stamp, in the frame of the last pose.

        Raises:
            InvalidValue: If the stamp is not finite or earlier than the last one, or the filter was not started.
        """
        before, last = self.pose, self.stamp
        if not (type(stamp) is float and last <= stamp < math.inf):
            self._check_clock(stamp)
        scale, drift, _ = self.systematic.tolist()
        corrected = step
        if scale != 0.0 or drift != 0.0:
            corrected = Pose2(step.x * (1.0 + scale), step.y, step.yaw + drift * step.x)
        after = self._estimate = before @ corrected
        self.covariance = _grown(self.covariance, before, after, step, stamp - last, self._expected)
        usual, slipped = self._errors, self._expected
        if slipped is not usual:
            left = math.exp(-math.hypot(step.x, step.y) / _SLIP_MEMORY)
            self._expected = usual._replace(
                along=usual.along + left * (slipped.along - usual.along),
                yaw_per_way=usual.yaw_per_way + left * (slipped.yaw_per_way - usual.yaw_per_way),
            )
        reckoned = self._reckoned
        if stamp > last:
            reckoned.append((stamp, reckoned[-1][1] @ corrected))
            while len(reckoned) > 2 and reckoned[1][0] <= stamp - _MEMORY:
                reckoned.popleft()
        elif step != _ORIGIN:  # a newer pose of the odometry with the same stamp
            reckoned[-1] = (stamp, reckoned[-1][1] @ corrected)
        self.jump = None
        return after

    def pose_at(self, stamp: float) -> Pose2:
        """Return the present estimate of the pose at a past `stamp` [s]; constant after the last prediction.

        Raises:
            InvalidValue: If the stamp is older than the stored motion, or the filter was not started.
        """
        pose, reckoned = self.pose, self._reckoned
        if stamp < reckoned[0][0]:
            raise InvalidValue(f"pose filter: motion is stored from {reckoned[0][0]} s on, got {stamp} s")
        if stamp >= reckoned[-1][0]:
            return pose
        return pose @ (reckoned[-1][1].inverse() @ _between(reckoned, stamp))

    def correct(
        self,
        stamp: float,
        measured: Pose2,
        noise: FloatArray,
        *,
        may_move: bool = True,
        slip: tuple[float, float] = (0.0, 0.0),
    ) -> Verdict:
        """Correct the estimate by a measured pose.

        Args:
            stamp: Time of the measurement [s]; it may be late.
            measured: Pose of the robot in the fixed frame.
            noise: Covariance, Shape (3, 3) [m, m, rad].
            may_move: Whether the measurement may move the estimate if it is outside the gate.
            slip: Standard deviations of distance [m] and rotation [rad] lost to wheel slip since the last measurement;
                applied only if the measurement is accepted.

        Returns:
            `accepted`; `rejected` if the measurement is outside the gate; `moved` if the estimate moved to this and
            other agreeing measurements; `forgotten` if the measurement is older than the stored motion or in the
            future.
        """
        pose, delay, first, last = self.pose, self.systematic.item(2), self.remembered_from, self.stamp
        if not first <= stamp <= last + AHEAD:
            return "forgotten"
        velocity = self._velocity_at(stamp - delay)
        then, ahead = self.pose_at(max(stamp - delay, first)), max(stamp - delay - last, 0.0)
        if ahead > 0.0:  # the odometry is later than the measurement
            x, y, yaw = velocity
            then = Pose2(then.x + ahead * x, then.y + ahead * y, then.yaw + ahead * yaw)
        miss = measured.x - then.x, measured.y - then.y, normalize_angle(measured.yaw - then.yaw)
        lever, jitter = (pose.y - then.y, then.x - pose.x), self._errors.jitter
        covariance, change, whitened = corrected(self._with_slip(*slip), lever, velocity, noise, jitter, miss)
        near = math.hypot(miss[0], miss[1]) <= _ALWAYS_NEAR[0] and abs(miss[2]) <= _ALWAYS_NEAR[1]
        first, second, third = whitened.tolist()
        if not near and first * first + second * second + third * third > GATE:
            if not may_move:
                return "rejected"
            return self._put_aside(stamp, measured, then, noise + jitter**2 * np.multiply.outer(velocity, velocity))
        self.covariance = covariance
        self._shift(change)
        self.accepted, self.rejected = self.accepted + 1, 0
        self.measured_at = max(self.measured_at, stamp)
        if self._outside:
            self._outside = [one._replace(accepted_since=one.accepted_since + 1) for one in self._outside]
        self._check_innovations((first, second, third), miss)
        return "accepted"

    def suppose(self, pose: Pose2, covariance: FloatArray) -> None:
        """Add an alternative pose; a single measurement that agrees with this pose moves the estimate to it.

        Args:
            pose: Alternative present pose.
            covariance: Its covariance, Shape (3, 3) [m, m, rad].
        """
        self._outside.append(_Outside(self.stamp, pose, self._reckoned[-1][1], covariance, 0, is_measured=False))

    @property
    def is_contradicted(self) -> bool:
        """Whether two or more of the newest measurements agree with each other but not with the estimate."""
        since = self.stamp - _MEMORY
        newest = [o for o in self._outside if o.is_measured and o.accepted_since == 0 and o.stamp > since]
        return any(_agree(one, newest[-1]) for one in newest[:-1])

    def after(self, way: float) -> FloatArray:
        """Return the covariance of x, y, yaw after a straight motion by `way` [m], < 0 in reverse, Shape (3, 3)."""
        covariance, pose = self.covariance, self.pose
        for _ in range(_STEPS):
            step = Pose2(way / _STEPS, 0.0, 0.0)
            after = pose @ step
            covariance = _grown(covariance, pose, after, step, 0.0, self._errors)
            pose = after
        found: FloatArray = covariance[:3, :3].copy()
        return found

    def _with_slip(self, along: float, yaw: float) -> FloatArray:
        """Return the covariance increased by a slip along the heading [m] and in yaw [rad], Shape (6, 6)."""
        if along == yaw == 0.0:
            return self.covariance
        c, s = math.cos(self.pose.yaw), math.sin(self.pose.yaw)
        found: FloatArray = self.covariance.copy()
        found[:2, :2] += along**2 * np.array([[c * c, c * s], [c * s, s * s]])
        found[2, 2] += yaw**2
        return found

    def _check_clock(self, stamp: float) -> None:
        stamp = finite_number(stamp, "pose filter: stamp")
        if stamp < self.stamp:
            raise InvalidValue(f"pose filter: the clock went back, from {self.stamp} s to {stamp} s")

    def _shift(self, change: FloatArray) -> None:
        pose = self.pose
        x, y, yaw, scale, drift, delay = change.tolist()
        self._estimate = Pose2(pose.x + x, pose.y + y, pose.yaw + yaw)
        known_scale, known_drift, known_delay = self.systematic.tolist()
        delay = min(max(known_delay + delay, -_LONGEST_DELAY), _LONGEST_DELAY)
        self.systematic = np.array((known_scale + scale, known_drift + drift, delay))

    def _velocity_at(self, stamp: float) -> tuple[float, float, float]:
        """Return the velocity in the fixed frame at a stamp [m/s, m/s, rad/s]."""
        reckoned = self._reckoned
        after = last = len(reckoned) - 1
        if last < 1:
            return 0.0, 0.0, 0.0
        if stamp < reckoned[-1][0]:
            after = min(max(_count_until(reckoned, stamp), 1), last)
        (begin, before), (end, pose) = reckoned[after - 1], reckoned[after]
        turn = self.pose.yaw - reckoned[-1][1].yaw
        c, s = math.cos(turn), math.sin(turn)
        x, y = (pose.x - before.x) / (end - begin), (pose.y - before.y) / (end - begin)
        return c * x - s * y, s * x + c * y, normalize_angle(pose.yaw - before.yaw) / (end - begin)

    def _put_aside(self, stamp: float, measured: Pose2, then: Pose2, noise: FloatArray) -> Verdict:
        """Store a measurement outside the gate, and move the estimate if enough such measurements agree."""
        now = measured @ (then.inverse() @ self.pose)
        one = _Outside(stamp, now, self._reckoned[-1][1], noise, 0, is_measured=True)
        self._outside = [other for other in self._outside if other.stamp > self.stamp - _MEMORY]
        agreeing = [other for other in self._outside if _agree(other, one)]
        self._outside.append(one)
        self.rejected += 1
        measured_there = [other for other in agreeing if other.is_measured]
        count, is_supposed = len(measured_there) + 1, len(measured_there) < len(agreeing)
        is_close = all(_agree(other, one, _CLOSE_GATE) for other in measured_there)
        needed = self._confirmations - (self._fewer_when_close if is_close else 0)
        is_confirmed = is_supposed or count >= max(needed, 2)
        if not is_confirmed or max((other.accepted_since for other in measured_there), default=-1) >= count - 1:
            return "rejected"
        before, driven = self.pose, self._driven()
        offsets = [_difference(other.moved_to(one.reckoned), now) for other in measured_there]
        x, y, yaw = (np.sum(offsets, axis=0) / count).tolist() if offsets else (0.0, 0.0, 0.0)
        self.place(Pose2(now.x + x, now.y + y, now.yaw + yaw), noise / count)
        self.jump = self.pose.in_frame_of(before)
        if driven > _SLIPPED and not is_supposed and self.accepted >= _ESTABLISHED:
            expected, root = self._expected, math.sqrt(driven)
            self._expected = expected._replace(
                along=max(expected.along, math.hypot(self.jump.x, self.jump.y) / root),
                yaw_per_way=max(expected.yaw_per_way, abs(self.jump.yaw) / root),
            )
        self.accepted, self.rejected = self.accepted + count, 0
        self.measured_at = max(self.measured_at, stamp)
        return "moved"

    def _driven(self) -> float:
        """Return the distance driven in the stored motion [m]."""
        poses = [pose for _, pose in self._reckoned]
        return sum(before.distance_to(after) for before, after in itertools.pairwise(poses))

    def _check_innovations(self, whitened: tuple[float, float, float], miss: tuple[float, float, float]) -> None:
        """Increase the covariance if the innovations have a persistent sign; a correct model has white innovations."""
        newest = self._whitened
        newest.append(whitened)
        for count in range(2, min(_SUDDEN, len(newest)) + 1):
            if _mean_square(newest, count) > _SUDDEN_GATE and self._driven() > _SLIPPED:
                self.covariance[:3, :3] += np.multiply.outer(miss, miss)
                self._whitened.clear()
                return
        if len(newest) < _INNOVATIONS or _mean_square(newest, _INNOVATIONS) <= GATE:
            return
        self._whitened.clear()
        self.doubts += 1
        self.covariance[:3, :3] += np.multiply.outer(miss, miss)
        for k, sigma in enumerate((self._errors.scale, self._errors.drift, self._errors.delay), 3):
            self.covariance[k, :] = self.covariance[:, k] = 0.0
            self.covariance[k, k] = (_DOUBT * sigma) ** 2


class _Outside(NamedTuple):
    """A measured or alternative pose outside the gate.

    Attributes:
        stamp: Stamp of the measurement [s].
        now: Pose of the robot at the arrival of the measurement, according to the measurement.
        reckoned: Pose according to dead reckoning at the arrival of the measurement.
        noise: Covariance, Shape (3, 3).
        accepted_since: Number of measurements accepted since then.
        is_measured: False for an alternative pose given to `suppose`.
    """

    stamp: float
    now: Pose2
    reckoned: Pose2
    noise: FloatArray
    accepted_since: int
    is_measured: bool

    def moved_to(self, reckoned: Pose2) -> Pose2:
        """Return the measured pose advanced by dead reckoning to `reckoned`."""
        return self.now @ (self.reckoned.inverse() @ reckoned)


_INDEFINITE = "the covariance of a measurement is not positive definite"
_STEPS = 4  # of the prediction over a straight motion: the covariance couples yaw and position to second order


_GROW = Kernel("optdock_grown_covariance", sizes=0, numbers=5)
_CORRECT = Kernel("optdock_corrected_state", sizes=0, numbers=1)


def _grown(
    covariance: FloatArray, before: Pose2, after: Pose2, step: Pose2, period: float, errors: OdometryErrors
) -> FloatArray:
    """Return the covariance after a step of odometry, Shape (6, 6)."""
    turn = step.yaw if -math.pi < step.yaw <= math.pi else normalize_angle(step.yaw)
    driven, middle = math.hypot(step.x, step.y), before.yaw + 0.5 * turn
    added = (
        errors.along**2 * driven,
        errors.wander**2 * period,
        errors.yaw_per_way**2 * driven + errors.yaw_per_turn**2 * abs(turn) + errors.yaw_wander**2 * period,
    )
    return grown(covariance, (after.x - before.x, after.y - before.y), step.x, middle, added)


def _grown_natively(
    covariance: FloatArray, moved: tuple[float, float], way: float, heading: float, added: tuple[float, float, float]
) -> FloatArray:
    out = np.empty((6, 6))
    numbers = math.cos(heading), math.sin(heading), *moved, way
    _GROW((), numbers, ((covariance, 36), (np.array(added), 3), (out, 36)))
    return out


@twin_of(_grown_natively)
def grown(
    covariance: FloatArray, moved: tuple[float, float], way: float, heading: float, added: tuple[float, float, float]
) -> FloatArray:
    """Return the covariance of the state after a step of odometry, Shape (6, 6).

    Args:
        covariance: Covariance before the step, Shape (6, 6).
        moved: Displacement in the fixed frame [m].
        way: Distance along the heading [m].
        heading: Heading in the middle of the step [rad].
        added: Variances added along the heading and to x and y each [m^2], and to yaw [rad^2].
    """
    c, s = math.cos(heading), math.sin(heading)
    slope = _IDENTITY.copy()
    slope[0, 2], slope[1, 2] = -moved[1], moved[0]
    slope[0, 3], slope[1, 3], slope[2, 4] = c * way, s * way, way
    found: FloatArray = slope @ covariance @ slope.T
    along, wander, turned = added
    found[0, 0] += c * c * along + wander
    found[1, 1] += s * s * along + wander
    found[0, 1] += c * s * along
    found[1, 0] += c * s * along
    found[2, 2] += turned
    return found


def _corrected_natively(
    covariance: FloatArray,
    lever: tuple[float, float],
    velocity: tuple[float, float, float],
    noise: FloatArray,
    jitter: float,
    miss: tuple[float, float, float],
) -> tuple[FloatArray, FloatArray, FloatArray]:
    measured, out = np.array((*lever, *velocity, *miss)), np.empty(45)
    if _CORRECT((), (jitter,), ((covariance, 36), (noise, 9), (measured, 8), (out, 45))) < 0:
        raise np.linalg.LinAlgError(_INDEFINITE)
    return out[:36].reshape(6, 6), out[36:42], out[42:]


@twin_of(_corrected_natively)
def corrected(
    covariance: FloatArray,
    lever: tuple[float, float],
    velocity: tuple[float, float, float],
    noise: FloatArray,
    jitter: float,
    miss: tuple[float, float, float],
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the covariance after a measured pose, Shape (6, 6), the change of the state, and the whitened innovation.

    Args:
        covariance: Covariance of the state, Shape (6, 6).
        lever: Change of the measured x and y per yaw of the present pose [m].
        velocity: Velocity at the time of the measurement, in the fixed frame [m/s, m/s, rad/s].
        noise: Covariance of the measured pose, Shape (3, 3).
        jitter: Standard deviation of the time of the measurement [s].
        miss: Measured minus expected pose, the yaw in (-pi, pi].

    Raises:
        LinAlgError: If the covariance of the innovation is not positive definite.
    """
    seen = _SEEN.copy()
    seen[0, 2], seen[1, 2], seen[:, 5] = *lever, velocity
    seen[:, 5] *= -1.0
    noise = noise + jitter**2 * np.multiply.outer(velocity, velocity)
    shared = seen @ covariance
    white = _whitening(shared @ seen.T + noise)
    whitened, white_shared = white @ np.array(miss), white @ shared
    gain = white_shared.T @ white
    rest = _IDENTITY - gain @ seen
    return rest @ covariance @ rest.T + gain @ noise @ gain.T, white_shared.T @ whitened, whitened


def _whitening(spread: FloatArray) -> FloatArray:
    """Return the inverse W of the Cholesky factor of a covariance, W' W = inverse of `spread`. Shape (3, 3).

    Raises:
        LinAlgError: If the covariance is not positive definite.
    """
    (a, _, _), (b, d, _), (c, e, f) = spread.tolist()
    first = _root(a)
    b, c = b / first, c / first
    second = _root(d - b * b)
    e = (e - b * c) / second
    third = _root(f - c * c - e * e)
    lower = -b / (first * second)
    return np.array(
        (
            (1.0 / first, 0.0, 0.0),
            (lower, 1.0 / second, 0.0),
            (-(c / first + e * lower) / third, -e / (second * third), 1.0 / third),
        )
    )


def _root(pivot: float) -> float:
    if not pivot > 0.0:
        raise np.linalg.LinAlgError(_INDEFINITE)
    return math.sqrt(pivot)


def _mean_square(innovations: deque[tuple[float, float, float]], count: int) -> float:
    """Return the squared norm of the sum of the newest `count` innovations, divided by their number."""
    x = y = z = 0.0
    for k in range(-count, 0):
        one = innovations[k]
        x, y, z = x + one[0], y + one[1], z + one[2]
    return (x * x + y * y + z * z) / count


def _difference(pose: Pose2, reference: Pose2) -> FloatArray:
    return np.array([pose.x - reference.x, pose.y - reference.y, normalize_angle(pose.yaw - reference.yaw)])


def _agree(one: _Outside, other: _Outside, gate: float = GATE) -> bool:
    """Whether two measurements agree within the noise of both."""
    off = _difference(one.moved_to(other.reckoned), other.now)
    near = math.hypot(off[0], off[1]) <= _ALWAYS_NEAR[0] and abs(off[2]) <= _ALWAYS_NEAR[1]
    return near or float(off @ np.linalg.solve(one.noise + other.noise, off)) <= gate
