"""The moving reference: a trajectory played back at a rate between 0 and 1 that changes smoothly.

A new trajectory may take over while the robot moves; the reference then continues at the beginning of the new
trajectory.
"""

from __future__ import annotations

import functools
import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.controllers.command_limits import smooth_slope
from optdock.controllers.motion_table import MotionRow, motion_table
from optdock.geometry.arrays import readonly
from optdock.geometry.pose import Pose2, Twist2
from optdock.model.robot import Drive

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from optdock.model.limits import MotionLimits
    from optdock.model.trajectory import Trajectory

__all__ = ["ReferenceProgress", "ReferenceState", "TrajectoryReference", "peaks", "rate_for_turning", "waiting_rate"]

_AT_REST = 1e-6  # [m/s]: a reference at rest may change its rate at once
_STEADY = 1e-3  # [1/s]: a slower change of the rate counts as zero
_AT_START = 0.05  # [m]: a robot within this distance of the start begins there
_BEYOND = 1e-6  # [m]: after a cusp
_WAY_STEP = 0.03  # [m]
_YAW_ACCELERATION = MotionRow._fields.index("yaw_acceleration")
_LOOK_AHEAD = readonly(np.linspace(0.0, 0.3, 7))  # [s] beyond the commands, in which the rate can decrease
_NO_TIMES = readonly(np.zeros(0))
_SAMPLES = 400  # for the nearest point
_STEERED_RATE = 0.99  # of steered wheels: leaves feedback 3 % of the jerk and 1 % of the steering rate


class ReferenceProgress(NamedTuple):
    """Progress of a controller along its trajectory.

    `time`: time of the reference on the clock of the last given trajectory [s]; negative until its takeover.
    `rate`: rate of the reference [1].
    """

    time: float
    rate: float


class Ahead(NamedTuple):
    """The reference after the preview, from which the feed-forward is taken.

    `twist`: velocity, scaled by the rate; zero beyond the end. `speed`, `acceleration`: values of the trajectory along
    the direction of travel, at rate 1 [m/s, m/s^2]; in a turn in place, values of the yaw [rad/s, rad/s^2]. `gear`: 1
    or -1, 0 in a turn in place. `left`: distance to the end [m]. `to_rest`: distance to the next rest, a cusp or the
    end [m].
    """

    twist: Twist2
    speed: float
    acceleration: float
    gear: float
    left: float
    to_rest: float


class ReferenceState(NamedTuple):
    """The reference at one instant.

    `gear`: 1 or -1, 0 in a turn in place. `turn`: 1 or -1 in a turn in place, 0 elsewhere. `ahead`: the reference after
    the preview.
    """

    pose: Pose2
    gear: float
    turn: float
    ahead: Ahead

    def lag_of(self, error: Pose2) -> float:
        """Return the lead of the reference along the travel or turn [m or rad]; `error` is in the robot's frame."""
        return error.x * self.gear + error.yaw * self.turn


class _Joint(NamedTuple):
    """Change to `trajectory` at `time` [s] of the previous trajectory, whose speed is `faster` times the new speed."""

    time: float
    trajectory: Trajectory
    faster: float

    def rate_after(self, before: float) -> float:
        """Return the rate at which the new trajectory is as fast as the previous trajectory at the rate `before`."""
        return min(1.0, before * self.faster) if math.isfinite(self.faster) else 1.0


def _joint(before: Trajectory, time: float, trajectory: Trajectory) -> _Joint:
    begins = abs(trajectory.time_law.start_speed)
    speed = abs(motion_table(before).rows(time)[0].speed) if 0.0 <= time < before.duration else 0.0
    return _Joint(time, trajectory, speed / begins if begins > _AT_REST else math.inf)


class TrajectoryReference:
    """Present set-point: the state of `trajectory` at `time`, which advances by `rate` seconds per second.

    The commands are ahead of the reference by a preview that compensates the delay of the drive. If the preview or the
    rate changes, the reference shifts and the commands stay continuous. A rate below 1 scales the speed by the rate and
    every acceleration by its square. A change of rate adds `speed * d rate/dt`. The change begins and ends smoothly,
    and is bounded so that the sum `rate^2 * acceleration + speed * d rate/dt` satisfies the limits.
    """

    def __init__(self, trajectory: Trajectory) -> None:
        self.trajectory = trajectory
        self.time = 0.0
        self.rate = 1.0
        self._preview = 0.0
        self._slope = 0.0  # of the rate [1/s]
        self._joints: list[_Joint] = []
        # Results of the last call of `state`: poses at its previews, and the yaw accelerations after the preview.
        self._horizon = _NO_TIMES, np.zeros((0, 3))
        self._later: tuple[Trajectory, float, FloatArray] = (trajectory, math.nan, _NO_TIMES)

    @property
    def finished(self) -> bool:
        """Whether the end of the last trajectory is reached."""
        return self.time >= self.trajectory.duration and not self._joints

    @property
    def last(self) -> Trajectory:
        """The last given trajectory."""
        return self._joints[-1].trajectory if self._joints else self.trajectory

    @property
    def progress(self) -> ReferenceProgress:
        """Progress on the clock of the last given trajectory."""
        if not self._joints:
            return ReferenceProgress(self.time, self.rate)
        left = self._joints[0].time - self.time + sum(joint.time for joint in self._joints[1:])
        return ReferenceProgress(-left, self.rate)

    @property
    def ends(self) -> FloatArray:
        """Start and end pose of the present trajectory and end pose of the last trajectory, Shape (3, 3)."""
        poses = self.trajectory.path.start, self.trajectory.path.end, self.last.path.end
        return np.array([pose.as_array() for pose in poses])

    def joined_by(self, trajectory: Trajectory, lead: float) -> None:
        """Schedule a takeover by `trajectory` in `lead` seconds, and cancel later takeovers.

        The point of the takeover on the trajectory is determined by the present rate. If the rate changes later, the
        time of the takeover changes, and the reference does not jump. A reference at rest changes immediately and waits
        at the new start.
        """
        if self.rate == 0.0 or lead <= 0.0:
            self._joints.clear()
            self._take_over(_joint(self.trajectory, self.time, trajectory), -lead)
            return
        shown, at, _ = self._at(lead)
        kept = [joint.trajectory for joint in self._joints]
        self._joints = self._joints[: kept.index(shown) + 1 if shown in kept else 0]
        self._joints.append(_joint(shown, at, trajectory))

    def look_ahead(self, preview: float, *, at_once: bool = False) -> None:
        """Set the lead of the commands [s]; before its end, the reference is shifted by the change unless `at_once`."""
        if self.time + self._preview > 0.0 and not at_once and not self.finished:
            self.time -= (self.rate if self.time > 0.0 else 1.0) * (preview - self._preview)
        self._preview = preview

    def state(self, previews: FloatArray = _NO_TIMES) -> ReferenceState:
        """Return the reference now and after the preview, at the present rate.

        Args:
            previews: Times ahead [s] for which `poses_ahead` will be called; they are evaluated in the same pass.
        """
        shown, ahead, rate = self._at(self._preview)
        later = ahead + _LOOK_AHEAD
        if shown is self.trajectory and not self._joints:
            horizon = self.time + (self.rate if self.time >= 0.0 else 1.0) * previews
            motion = motion_table(shown).at(np.concatenate(((self.time, ahead), later, horizon)))
            row, then = (MotionRow(*one) for one in motion[:2].tolist())
            self._horizon = previews, motion[2 + later.size :, 1:4]
        else:
            (row,), motion = (
                motion_table(self.trajectory).rows(self.time),
                motion_table(shown).at(np.concatenate(((0.0, ahead), later))),
            )
            then = MotionRow(*motion[1].tolist())
            self._horizon = _NO_TIMES, motion[:0, 1:4]
        self._later = shown, ahead, motion[2 : 2 + later.size, _YAW_ACCELERATION]
        gear, turn = _travel(row)
        gear_then, turn_then = _travel(then)
        share = rate if 0.0 <= ahead < shown.duration else 0.0
        return ReferenceState(
            pose=Pose2(row.x, row.y, row.yaw),
            gear=gear,
            turn=turn,
            ahead=Ahead(
                twist=Twist2(share * then.speed, share * then.yaw_rate),
                speed=abs(then.speed) + turn_then * then.yaw_rate if share else 0.0,
                acceleration=gear_then * then.acceleration + turn_then * then.yaw_acceleration,
                gear=gear_then,
                left=shown.path.length - then.s,
                to_rest=_next_rest(shown, then.s) - then.s,
            ),
        )

    def poses_ahead(self, previews: FloatArray) -> FloatArray:
        """Return the poses after `previews`, Shape (n,) [s], at the present rate. Shape (n, 3)."""
        if self._horizon[0] is previews:
            known: FloatArray = self._horizon[1].copy()
            return known
        if not self._joints:
            times = self.time + (self.rate if self.time >= 0.0 else 1.0) * previews
            found: FloatArray = motion_table(self.trajectory).at(times)[:, 1:4].copy()
            return found
        poses = np.empty((previews.size, 3))
        shown = [self._at(preview) for preview in previews.tolist()]
        for trajectory in dict.fromkeys(each for each, _, _ in shown):
            mine = [k for k, (each, _, _) in enumerate(shown) if each is trajectory]
            poses[mine] = motion_table(trajectory).at(np.array([shown[k][1] for k in mine]))[:, 1:4]
        return poses

    def trajectory_ahead(self, preview: float) -> tuple[Trajectory, float]:
        """Return the trajectory in force `preview` seconds from now, and the time on its clock at that moment [s]."""
        trajectory, time, _ = self._at(preview)
        return trajectory, time

    def peak_yaw_acceleration(self) -> float:
        """Return the largest yaw acceleration [rad/s^2], at rate 1, of the commands now and in the next 0.3 s."""
        shown, time, _ = self._at(self._preview)
        known, at, found = self._later
        if known is not shown or at != time:  # unless `state` has evaluated them
            found = motion_table(shown).at(time + _LOOK_AHEAD)[:, _YAW_ACCELERATION]
        return float(np.abs(found).max())

    def next_arc(self) -> Twist2:
        """Return direction and curvature of the path at the commands as a twist; at a cusp, values of the next gear."""
        shown, time, _ = self._at(self._preview)
        s = np.array([min(self._place(shown, time) + _BEYOND, shown.path.length)])
        return Twist2(float(shown.path.direction_at(s)[0]), float(shown.path.curvature_at(s)[0]))

    def way(self, distance: float, now: Pose2, pose: Pose2) -> FloatArray | None:
        """Return poses over the next `distance` [m], offset by `pose` relative to `now`; None beyond the path.

        Shape (n, 3).
        """
        count = 2 + math.ceil(distance / _WAY_STEP)
        ahead = self._place(self.trajectory, self.time) + np.linspace(0.0, distance, count)
        path, ends = self.trajectory.path, self.trajectory.path.length
        if self._joints:
            ends = self._place(self.trajectory, self._joints[0].time)
        poses = path.poses_at(np.minimum(ahead, ends))
        beyond = ahead > ends
        if beyond[-1]:
            newer = self._joints[0].trajectory.path if self._joints else None
            if newer is None or ahead[-1] - ends > newer.length:
                return None
            poses[beyond] = newer.poses_at(ahead[beyond] - ends)
        x, y, yaw = poses.T
        offset = now.inverse() @ pose
        c, s = np.cos(yaw), np.sin(yaw)
        return np.column_stack((x + c * offset.x - s * offset.y, y + s * offset.x + c * offset.y, yaw + offset.yaw))

    @staticmethod
    def _place(trajectory: Trajectory, time: float) -> float:
        """Return the distance [m] along a trajectory at a time on its clock."""
        return trajectory.time_law.state_at(time)[0]

    def join(self, pose: Pose2, linear: float, delay: float) -> None:
        """Begin at the trajectory's start, or at the nearest point of the first gear if the robot is not at the start.

        At the first rate the reference is no faster than the robot, whose speed is `linear` [m/s]. If the robot is at
        rest, the reference begins later by the drive's `delay` [s], so that no command is omitted.
        """
        times, cusps = np.linspace(0.0, self.trajectory.duration, _SAMPLES), self.trajectory.cusp_times
        if cusps.size:
            times = times[times <= cusps[0]]
        motion = motion_table(self.trajectory).at(times)
        distance = np.hypot(motion[:, 1] - pose.x, motion[:, 2] - pose.y)
        first = 0 if distance[0] <= _AT_START else int(np.argmin(distance))
        self.time, speed = times.item(first), motion.item(first, 4)
        if abs(speed) > _AT_REST:
            self.rate = min(1.0, max(0.0, linear / speed))
        elif first == 0:
            self.time = -delay

    def advance(
        self, now: ReferenceState, period: float, target_rate: float, limits: MotionLimits, settling: float
    ) -> None:
        """Advance by `period` [s] while the rate approaches `target_rate` with the time constant `settling` [s].

        `now` is the last result of `state`.
        """
        if self.time < 0.0:  # before the start of the trajectory the rate has no effect
            if target_rate == 0.0:
                self.rate = 0.0
                return
            passed = self.time + period
            self.time = passed if passed <= 0.0 else self.rate * passed
            return
        before, ahead = self.rate, now.ahead
        if ahead.speed <= _AT_REST or (abs(target_rate - before) < 1e-6 and abs(self._slope) < _STEADY):
            self.rate = before = target_rate
            self._slope = 0.0
        else:
            turning = limits.turning
            rise, fall, jerk = (
                (turning.acceleration, turning.acceleration, turning.jerk)
                if ahead.gear == 0.0
                else (limits.max_acceleration, limits.max_deceleration, limits.max_jerk)
            )
            lowest, highest = _rate_bounds(ahead.speed, before**2 * ahead.acceleration, (rise, fall))
            missing = target_rate - before
            wanted = smooth_slope(missing, 0.0, self._slope, jerk / ahead.speed, (period,) * 3)
            if settling > 0.0:
                most = abs(missing) / settling
                wanted = min(max(wanted, -most), most)
            self._slope = min(max(wanted, lowest), highest)
            self.rate = min(1.0, max(0.0, before + period * self._slope))
            self.time -= (self.rate - before) * self._preview
        self.time += 0.5 * (before + self.rate) * period
        while self._joints and self.time >= self._joints[0].time:
            joint = self._joints.pop(0)
            self._take_over(joint, (self.time - joint.time) / self.rate if self.rate > 0.0 else 0.0)
        if not self._joints:
            self.time = min(self.time, self.trajectory.duration)

    def _take_over(self, joint: _Joint, since: float) -> None:
        """Change to the next trajectory, which began `since` seconds ago, at the present speed."""
        self.rate = joint.rate_after(self.rate)
        self.trajectory = joint.trajectory
        self.time = self.rate * since if since > 0.0 else since

    def _at(self, preview: float) -> tuple[Trajectory, float, float]:
        """Return the trajectory in force `preview` seconds from now, with its time and its rate at that moment."""
        shown, rate = self.trajectory, self.rate
        time = self.time + (rate if self.time >= 0.0 else 1.0) * preview
        for joint in self._joints:
            if time < joint.time:
                break
            left = (time - joint.time) / rate if rate > 0.0 else 0.0
            shown, rate = joint.trajectory, joint.rate_after(rate)
            time = rate * left
        return shown, time, rate


def _next_rest(trajectory: Trajectory, s: float) -> float:
    """Return the arc length of the next cusp beyond `s`, or of the end [m]."""
    return next((cusp for cusp in trajectory.path.cusps if cusp > s + _BEYOND), trajectory.path.length)


def _travel(row: MotionRow) -> tuple[float, float]:
    """Return the gear and the turn of a `ReferenceState`."""
    gear = math.copysign(1.0, row.speed) if abs(row.speed) > _AT_REST else row.gear
    return gear, math.copysign(1.0, row.curvature) if gear == 0.0 else 0.0


@functools.lru_cache(maxsize=8)
def peaks(trajectory: Trajectory) -> tuple[float, float]:
    """Return the largest speed and acceleration outside of turns in place [m/s, m/s^2].

    The peaks occur at the borders of the phases; the largest speed may also occur at a zero of the acceleration within
    a phase.
    """
    law = trajectory.time_law
    middle = law.phase_middles(0.5 * (law.times[:-1] + law.times[1:]))
    driven = trajectory.path.direction_at(middle) != 0
    v, a = law.states[:-1, 1][driven], law.states[:-1, 2][driven]
    jerk, duration = law.jerks[driven], law.durations[driven]
    with np.errstate(divide="ignore", invalid="ignore"):
        turning = np.where(jerk != 0.0, -a / jerk, 0.0)
    turning = np.clip(turning, 0.0, duration)

    def largest(values: FloatArray) -> float:
        return float(np.max(np.abs(values), initial=0.0))

    end_v, end_a = law.states[1:, 1][driven], law.states[1:, 2][driven]
    inside = v + turning * (a + 0.5 * jerk * turning)
    return max(largest(v), largest(end_v), largest(inside)), max(largest(a), largest(end_a))


def _rate_bounds(speed: float, acceleration: float, limits: tuple[float, float]) -> tuple[float, float]:
    """Return the bounds of d rate/dt [1/s] within which playback satisfies acceleration and deceleration limits."""
    rise, fall = limits
    return min(0.0, -(fall + acceleration) / speed), max(0.0, (rise - acceleration) / speed)


def rate_for_turning(reference: TrajectoryReference, reserve: float, limits: MotionLimits, drive: Drive) -> float:
    """Return the largest rate [1] that reserves a share of the yaw acceleration (proportional to rate^2) for feedback.

    Args:
        reference: The moving reference.
        reserve: Share of `max_yaw_acceleration` left to feedback [1].
        limits: Limits of the robot.
        drive: Kind of drive; for steered wheels, every limit has a reserve.
    """
    most = _STEERED_RATE if drive is Drive.ACKERMANN else 1.0
    kept = (1.0 - reserve) * limits.max_yaw_acceleration
    if math.isinf(kept):
        return most
    planned = reference.peak_yaw_acceleration()
    return min(most, math.sqrt(kept / planned)) if planned > 0.0 else most


def waiting_rate(lag: float, slow_down_lag: float, stop_lag: float) -> float:
    """Return the rate for a robot that lags: 1 up to `slow_down_lag`, 0 above `stop_lag` [m], linear in between."""
    return min(1.0, max(0.0, (stop_lag - lag) / max(1e-9, stop_lag - slow_down_lag)))
