"""Short motions at rest before or in the dock, where no way is left on which a path could correct the error."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.executor.control_cycles import STOP
from optdock.executor.dock_checks import SURE_SEEN
from optdock.executor.dock_estimate import LAST_LOOK, NO_ROOM
from optdock.executor.interruptions import Interrupted
from optdock.geometry.pose import Twist2
from optdock.model.robot import Drive
from optdock.model.trajectory import braking_time
from optdock.verification.time_of_impact import free_motion

if TYPE_CHECKING:
    from collections.abc import Generator

    from optdock.executor.control_cycles import ControlCycles, Cycles, Wish
    from optdock.geometry.arrays import FloatArray
    from optdock.model.robot import Robot

__all__ = ["Nudge"]

_ALIGNED, _NOISE = 0.3, 1.0  # of the tolerance, standard deviations: a heading that is less off stays as it is
_SHORT = 0.5  # of the tolerance: most robots that falsely called themselves docked believed to stand so far before it
_BESIDE = 0.4  # of the tolerance: with more a robot that is straight again is better off with another approach
_LARGEST_TURN = 0.1  # [rad] at a dock: the corners of a usual robot then move by 3 cm
_WHEELS_WITHIN = 0.9  # of the radius of the inscribed circle, if the robot has no track width
# [m/s] of a wheel: in one period at 20 Hz by half a millimetre; and more than the dead bands of usual drives.
_SLOWEST_NUDGE, _FASTEST_NUDGE = 0.012, 0.12
_MOST_NUDGES = 10  # by each of which the part that a dead band leaves out grows by what is missing
_LEAST_FREE = 0.3  # of what is missing: less is not worth a motion
_DEAD_BAND = 0.004  # [m] left out of a motion: more than is left out by chance
_MOST_LEFT_OUT = 0.05  # [m]: a wheel that does not answer to that moves by no more
_ANSWER = 0.3  # [s], in which the drive and its odometry have answered to the last command
_INSTANT = 1e-9  # [s]


class _Wheels(NamedTuple):
    """Half of the distance between the wheels [m]."""

    lever: float

    @classmethod
    def of(cls, robot: Robot) -> _Wheels:
        """Those of a robot, as far as they are known."""
        width = robot.limits.track_width
        return cls(0.5 * width if width > 0.0 else _WHEELS_WITHIN * robot.footprint.inscribed_radius)

    def rims(self, linear: float, angular: float) -> tuple[float, float]:
        """Ways or speeds of the left and the right wheel [m], [m/s] in a motion of the robot [m, rad], [m/s, rad/s]."""
        return linear - self.lever * angular, linear + self.lever * angular

    def body_motion(self, left: float, right: float) -> Twist2:
        """The motion of the robot whose wheels roll so far, or so fast; see `rims`."""
        return Twist2(0.5 * (left + right), 0.5 * (right - left) / self.lever)


class Nudge:
    """Moves the robot by what is missing, and learns what the dead bands of its wheels leave out.

    Args:
        cycles: Of the task.
    """

    def __init__(self, cycles: ControlCycles) -> None:
        self._cycles, self._wheels = cycles, _Wheels.of(cycles.situation.problem.robot)
        # Of short motions, by the dead bands of the left and the right wheel [m].
        self._left_out: FloatArray = np.zeros(2)

    @property
    def missing(self) -> Twist2:
        """The way [m] and the turn [rad] after which the robot stands in its dock, where no more than these is missing.

        An error across neither of them takes back.
        """
        situation, estimate = self._cycles.situation, self._cycles.situation.estimate
        if situation.problem.robot.drive is not Drive.DIFFERENTIAL or situation.dock_type.is_pressed_on:
            return Twist2()
        (along, _, most_along), (across, _, most_across), (yaw, sigma, most) = estimate.errors()
        is_beside = abs(across) > _BESIDE * most_across and not estimate.is_within_tolerances(0.0)
        if is_beside or estimate.left > LAST_LOOK or abs(yaw) > _LARGEST_TURN:
            return Twist2()
        is_short = _SHORT * most_along < estimate.gear * -along <= NO_ROOM
        is_turned = abs(yaw) > max(_ALIGNED * most, _NOISE * sigma)
        return Twist2(-along if is_short else 0.0, -yaw if is_turned else 0.0)

    def run(self) -> Generator[Wish, None, bool]:
        """Move by what is missing, at rest before or in the dock, where no way is left to correct an error on.

        Returns:
            Whether the robot was moved.
        """
        missing = self.missing
        for number in range(_MOST_NUDGES):
            if not (yield from self._once()):
                return number > 0
            if number == 0:
                self._cycles.report("nudged", f"by {missing.linear:.4f} m and {missing.angular:.4f} rad")
        return True

    def _once(self) -> Generator[Wish, None, bool]:
        """One motion of `run`; False if there is none to make.

        What the dead band of a wheel leaves out of one motion is added to the next. A drive that has left something out
        moves one wheel at a time: the wheel with the smaller dead band would else answer alone, and turn the robot.
        """
        situation, perception, footprint = (
            self._cycles.situation,
            self._cycles.situation.perception,
            self._cycles.situation.problem.robot.footprint,
        )
        wheels = self._wheels
        missing, robot = self.missing, perception.robot
        has_dead_band = float(self._left_out.max()) > _DEAD_BAND
        if missing == Twist2() or (has_dead_band and situation.estimate.is_within_tolerances(SURE_SEEN)):
            return False
        # First the turn: the way ahead is then straight, and the limits of the two do not mix.
        way = 0.0 if missing.angular and not has_dead_band else missing.linear
        left, right = wheels.rims(way, missing.angular)
        if has_dead_band:
            left, right = (left, 0.0) if abs(left) > abs(right) else (0.0, right)
        motion = wheels.body_motion(left, right)
        reach = footprint.circumscribed_radius + abs(motion.linear) + _MOST_LEFT_OUT
        everything, others = situation.scene.near(robot, reach), situation.scene.near(robot, reach, with_station=False)
        free = free_motion(footprint, everything, robot, motion, 1.0, overlap=situation.estimate.reach_of_contact).free
        ways = np.array([free * left, free * right])
        asked = wheels.body_motion(*(ways + np.sign(ways) * self._left_out).tolist())
        # If nothing is left out this time, the robot presses against its station, and against nothing else.
        if free < _LEAST_FREE or free_motion(footprint, others, robot, asked, 1.0).free < 1.0:
            return False
        before = np.array(wheels.rims(perception.forward, perception.turned))
        try:
            yield from self._roll(asked)
        except Interrupted as stopped:
            self._cycles.say_why(stopped)
            yield from self._cycles.stop()
            return False
        moved = np.array(wheels.rims(perception.forward, perception.turned)) - before
        self._left_out = np.clip(self._left_out + np.sign(ways) * (ways - moved), 0.0, _MOST_LEFT_OUT)
        return True

    def _roll(self, motion: Twist2) -> Cycles:
        """Command a short motion from rest, and wait until the drive has answered.

        Its end is found by integrating the commands, so the delay of the drive has no part in it.

        Args:
            motion: Way [m] and turn [rad] as a whole.

        Raises:
            Interrupted: The robot cannot go on.
        """
        situation, limits, wheels = self._cycles.situation, self._cycles.situation.problem.robot.limits, self._wheels
        way = max(map(abs, wheels.rims(motion.linear, motion.angular)))  # of the faster wheel
        straight = limits.max_speed, min(limits.max_acceleration, limits.max_deceleration), limits.max_jerk
        turning = limits.turning.rate, limits.turning.acceleration, math.inf  # the jerk of a turn is not limited
        shares = max(abs(motion.linear) / way, _INSTANT), max(abs(motion.angular) / way, _INSTANT)
        highest, acceleration, jerk = (
            min(s / shares[0], t / shares[1]) for s, t in zip(straight, turning, strict=True)
        )
        fastest, rolled, was_felt = min(_FASTEST_NUDGE, highest), 0.0, False
        while True:
            situation.require_no_interruption()
            is_felt = situation.contact() is not None and motion.linear * situation.estimate.gear > _INSTANT
            if is_felt and was_felt:  # a switch that flickers farther out is no reason to stay there
                break
            was_felt = is_felt
            speed = max(map(abs, wheels.rims(situation.commanded.linear, situation.commanded.angular)))
            rolled += speed * self._cycles.period
            left = way - rolled - 0.5 * speed * braking_time(speed, acceleration, jerk)
            if left <= 0.0:
                break
            rate = min(max(0.5 * left / max(self._cycles.period, _INSTANT), _SLOWEST_NUDGE), fastest) / way
            yield from self._cycles.cycle(Twist2(rate * motion.linear, rate * motion.angular))
        since = self._cycles.now
        while self._cycles.now - since < _ANSWER:
            yield from self._cycles.cycle(STOP)
        yield from self._cycles.stop()
