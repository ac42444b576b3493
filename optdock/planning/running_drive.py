"""A robot on its running plan: its state, the joint at which a new plan can take over, and braking."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.lazy import cached_property
from optdock.geometry.pose import Pose2
from optdock.model.constant_jerk import TimeLaw
from optdock.model.limits import SpeedZone
from optdock.model.path import Path
from optdock.model.segments import SAME_POSITION, TURN_RADIUS, ClothoidSegment
from optdock.model.trajectory import Trajectory
from optdock.timing.jerk_phases import DriveBounds, MotionState
from optdock.timing.start_states import full_stop, stopping_distance
from optdock.verification import (
    TOLERANCE,
    WayVerdict,
    certify_trajectory,
    compiled_clearances,
    prove_way,
    unchanged_way,
)

if TYPE_CHECKING:
    from optdock.model.limits import MotionLimits
    from optdock.model.problem import DockingProblem
    from optdock.planning.plan import DockPlan
    from optdock.verification import TrajectoryCertificate

__all__ = ["NO_WAY", "BranchPoint", "DriveState", "RunningDrive", "braking"]

_AT_REST = 1e-6  # [m/s], [m/s^2]: as in the certificate
_BRAKING_ROOM = 1.05  # the time law needs a little more than the shortest braking distance
_REST_SOON = 0.1  # [s]: a rest that follows the joint within this time becomes the joint
NO_WAY = 1e-6  # [m]: shorter rests of a path are empty


class DriveState(NamedTuple):
    """Progress of a robot along its trajectory.

    Attributes:
        time: Time of the reference on the clock of the trajectory [s].
        rate: Rate of that clock, 1 at the planned speed [1].
        pose: Measured pose at that time; None means that the robot is on the trajectory. If the pose is within the tube
            around the running path, the controller corrects the error and a new plan begins on that path. Otherwise a
            new plan begins at the pose of the robot.
        moved: Transform of the whole trajectory after planning: every pose p becomes `moved @ p`, because the dock was
            detected at a different pose. None means identity.
        is_filtered: Whether `pose` is accurate enough for a new plan to begin there, even within the tube.
    """

    time: float
    rate: float = 1.0
    pose: Pose2 | None = None
    moved: Pose2 | None = None
    is_filtered: bool = False


@dataclass(frozen=True, eq=False)
class BranchPoint:
    """A point on the running trajectory, and the state of the robot there.

    `path`: the path ahead. `time`: time on the clock of the trajectory [s]. `s`: arc length on the path [m]. `speed`,
    `acceleration`: state of the robot, signed. `gear`: 1, -1 or 0.
    """

    path: Path
    time: float
    s: float
    speed: float
    acceleration: float
    gear: int

    @cached_property
    def rest(self) -> Path | None:
        """The remaining path from the pose of the robot, or None if no path remains."""
        return None if self.is_at_the_end else self.path.piece(self.s)

    @property
    def is_at_the_end(self) -> bool:
        """Whether no path remains."""
        return self.s >= self.path.length - NO_WAY

    def has_more_than(self, straight: float) -> bool:
        """Whether more gears, or more than a given length [m], are ahead."""
        return self.path.length - self.s > straight or any(cusp > self.s + NO_WAY for cusp in self.path.cusps)

    @cached_property
    def pose(self) -> Pose2:
        """Pose of the robot."""
        return self.path.end if self.rest is None else self.rest.start

    @property
    def rests(self) -> bool:
        """Whether the robot is at rest at this point."""
        return self.speed == 0.0 and self.acceleration == 0.0

    def braking_distance(self, limits: MotionLimits) -> float:
        """Return the distance of full braking with a margin [m], 0 during a turn in place."""
        if self.gear == 0 or self.rests:
            return 0.0
        start = MotionState(0.0, abs(self.speed), self.acceleration * self.gear)
        return _BRAKING_ROOM * stopping_distance(start, limits)


class RunningDrive:
    """The rest of a running plan in the current problem `world`, for a robot on or off the planned path.

    Attributes:
        ahead: The path ahead, which is the running path, or the running path moved as a whole to the robot.
        now: State of the robot on the path ahead.
    """

    def __init__(self, plan: DockPlan, world: DockingProblem, state: DriveState) -> None:
        self.plan, self.world, self.state = plan, world, state
        self.ahead = self.path
        self.now = self.branch_point(0.0)
        if not self.is_on_the_path and (state.is_filtered or not self.is_in_tube(self.reference)):
            self.move_ahead()

    @cached_property
    def path(self) -> Path:
        """The running path, transformed by `moved`."""
        path, moved = self.plan.path, self.state.moved
        return path if moved is None else path.moved(moved)

    def move_ahead(self) -> None:
        """Move the remaining path rigidly, so that it begins at the measured pose of the robot."""
        assert self.state.pose is not None
        self.ahead = self.path.moved(self.state.pose @ self.reference.inverse())
        self.now = self.branch_point(0.0)

    @cached_property
    def reference(self) -> Pose2:
        """Pose on the running trajectory at the present time of its clock."""
        return self.path.pose_at(float(self.plan.trajectory.sample_at(self.state.time).s[0]))

    @cached_property
    def is_on_the_path(self) -> bool:
        """Whether the robot is at the reference pose."""
        return self.state.pose is None or self.state.pose.gap_to(self.reference) <= TOLERANCE

    def is_in_tube(self, place: Pose2) -> bool:
        """Whether the tube around a drive that begins at a given pose of the path covers the robot."""
        pose, footprint = self.state.pose, self.world.robot.footprint
        assert pose is not None
        off = footprint.displacement(pose, self.reference)
        if not off <= self.world.robot.tracking.width(footprint):
            return False
        at = place.as_array()[None]
        clearances, _ = compiled_clearances(at, footprint, self.world.all_obstacles)
        return bool(off <= self.world.tube_widths(at, place, float(clearances[0]))[0])

    def branch_point(self, lead: float, *, at_a_rest: bool = False) -> BranchPoint:
        """Return the state after `lead` seconds.

        If `at_a_rest` is True, the result is the state at the next rest, if that rest is near or the robot turns in
        place.
        """
        running, rate = self.plan.trajectory, self.state.rate
        path, length = self.ahead, self.ahead.length
        time = min(max(self.state.time + rate * lead, 0.0), running.duration)
        if at_a_rest:
            time = self._next_rest(time)
        s, speed, acceleration = running.time_law.state_at(time)
        s, speed, acceleration = min(max(s, 0.0), length), rate * speed, rate * rate * acceleration
        if s > length - NO_WAY:  # the last micrometre of a motion takes a millisecond
            time, s, speed, acceleration = running.duration, length, 0.0, 0.0
        if max(abs(speed), abs(acceleration)) <= _AT_REST:
            speed = acceleration = 0.0
            s = next((cusp for cusp in path.cusps if abs(cusp - s) <= NO_WAY), s)
        gear = int(path.direction_at(s)[0])
        sign = gear or 1
        return BranchPoint(path, time, s, sign * speed, sign * acceleration, gear)

    def _next_rest(self, time: float) -> float:
        """Return `time`, or the time of the next rest if that rest is near or the robot turns in place."""
        running = self.plan.trajectory
        s, speed, acceleration = running.time_law.state_at(time)
        if self.state.rate <= 0.0:
            return time  # the clock does not advance
        if max(abs(speed), abs(acceleration)) <= _AT_REST:
            return self._steered(time)
        turning = running.path.turns and int(running.path.direction_at(s)[0]) == 0
        ends = running.cusp_times.tolist() if running.path.cusps else []
        due = next((end for end in [*ends, running.duration] if end >= time), time)
        return self._steered(due) if turning or due - time <= _REST_SOON * self.state.rate else time

    def _steered(self, rest: float) -> float:
        """Return the time `rest`, or the end of the rest that begins at that time if the wheels are steered in it."""
        law = self.plan.trajectory.time_law
        if not math.isfinite(self.world.robot.limits.max_steering_rate):
            return rest
        phase = int(np.searchsorted(law.times, rest, side="right")) - 1
        while phase < law.durations.size and law.jerks[phase] == 0.0 and max(abs(law.states[phase, 1:])) <= _AT_REST:
            phase, rest = phase + 1, float(law.times[phase + 1])
        return rest

    def way_until(self, joint: BranchPoint) -> WayVerdict | None:
        """Prove the clearance of the path to the joint; None if the robot is at the joint."""
        now = self.now
        if joint.s - now.s <= NO_WAY:
            return None
        if self.ahead is self.plan.path and self.is_on_the_path:
            known = unchanged_way(self.plan.motion, now.s, joint.s, self.world)
            if known is not None:
                return WayVerdict(known)
        return prove_way(self.ahead.piece(now.s, joint.s), self.world, self.state.pose)

    def problem_at(self, joint: BranchPoint) -> DockingProblem:
        """Return the current problem with the joint as its start."""
        limits = self.world.robot.limits
        turning = self._steered(joint.time) > joint.time  # with a standing clock the wheels stay turned
        free = joint.rests and (turning or not math.isfinite(limits.max_steering_rate))
        curvature = None
        if not free and joint.gear != 0:
            curvature = float(self.plan.path.curvature_at(joint.s)[0])
        return self.world.starting_at(joint.pose, joint.speed, curvature, joint.acceleration)


# Shares of the deceleration to try: in a bend the yaw acceleration may allow no more.
_BRAKING = (1.0, 0.8, 0.6, 0.4, 0.25)
_STILL = 0.1  # [s]: duration of the motion of a standing robot


def braking(joint: BranchPoint, limits: MotionLimits, frame: str) -> tuple[Trajectory, TrajectoryCertificate]:
    """Return the fastest certified braking from a point of a trajectory, or the fastest braking if none is certified.

    The result is the trajectory and the certificate of its motion, which may list violations.
    """
    state = MotionState(0.0, abs(joint.speed), joint.acceleration * (joint.gear or 1))
    # A tenth of the certificate's tolerance: the path of a robot at rest.
    standing = ClothoidSegment(ClothoidSpline(joint.pose, np.array([0.0, 0.1 * TOLERANCE]), np.zeros(2)))
    still = Trajectory(Path((standing,), frame), TimeLaw(np.array([_STILL]), np.zeros(1)))
    if joint.rest is None or joint.rests:
        return still, certify_trajectory(still, limits, SpeedZone())
    first = None
    for share in _BRAKING:
        if joint.gear == 0:
            rate, most, jerk = (TURN_RADIUS * limit for limit in limits.turning)
            bounds = DriveBounds(rate, most, share * most, jerk)
        else:
            most = share * limits.max_deceleration
            bounds = DriveBounds(limits.max_speed, limits.max_acceleration, most, limits.max_jerk)
        phases = np.array(full_stop(state, bounds))
        if state.a < 0.0 < state.v and state.a**2 > 2.0 * state.v * bounds.jerk:
            jerk = state.a**2 / (2.0 * state.v)  # the least jerk without rolling back
            phases = np.array([[-state.a / jerk, jerk]])
        law = TimeLaw(phases[:, 0], phases[:, 1], 0.0, state.v, state.a)
        length = float(law.states[-1, 0])
        segment = joint.rest.segments[0]
        if length <= SAME_POSITION:  # it would roll back, or has nearly stopped; a speed jump is not certified
            motion = certify_trajectory(still, limits, SpeedZone(), start_speed=state.v, start_acceleration=state.a)
            return still, motion
        if length > segment.length - NO_WAY:  # the braking ends at the cusp
            length = segment.length
        trajectory = Trajectory(joint.rest.piece(0.0, length), law)
        motion = certify_trajectory(trajectory, limits, SpeedZone())
        first = first or (trajectory, motion)
        if motion.certified:
            return trajectory, motion
    assert first is not None
    return first
