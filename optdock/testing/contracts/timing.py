"""The contract of time parameterizers."""

from __future__ import annotations

import math
import pickle
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from optdock.errors import InvalidValue, TimingCancelled
from optdock.geometry.pose import Pose2
from optdock.model.limits import LIMITS, LimitKind, MotionLimits, SpeedZone
from optdock.model.path import Path
from optdock.plugins.interfaces import TimeParameterizer, TimingResult, TimingStatus
from optdock.testing.contracts.contract_scene import ORIGIN, moved_path
from optdock.testing.contracts.plugin import PluginContract
from optdock.testing.contracts.rules import require, require_cancellable
from optdock.testing.drives import clothoid, cusp_drive, s_curve_drive, straight_drive
from optdock.verification import certify_trajectory

if TYPE_CHECKING:
    from collections.abc import Iterator

    from optdock.model.trajectory import Trajectory

__all__ = ["TimeParameterizerContract"]

_SHORT = 0.05  # [m]
_TURNING = 0.3  # [m/s], [rad/s], ...: of every limit that depends on curvature; each binds somewhere


class TimeParameterizerContract(PluginContract[TimeParameterizer]):
    """`optdock.plugins.interfaces.TimeParameterizer`: the time law of a path; physics is an outcome, no exception."""

    interface: ClassVar[type[TimeParameterizer]] = TimeParameterizer

    def limits(self) -> tuple[MotionLimits, ...]:
        """Limits to try: the plain ones, and a set in which every bound on the motion is finite."""
        turning = {name: _TURNING for name, limit in LIMITS.items() if limit.kind is LimitKind.TURNING}
        every = MotionLimits(track_width=0.4, wheelbase=0.5, **turning)
        return MotionLimits(), every

    def paths(self) -> tuple[Path, ...]:
        """Paths to time: a line, an S of clothoids, a cusp, and the S as a polyline."""
        curved = s_curve_drive(ORIGIN).path
        return straight_drive(ORIGIN).path, curved, cusp_drive(ORIGIN).path, moved_path(curved, ORIGIN)

    def exercise(self, plugin: TimeParameterizer) -> object:
        """Statuses and phases of all paths under the plain limits."""
        results = [plugin.parameterize(path, MotionLimits(), SpeedZone()) for path in self.paths()]
        return tuple((int(result.status), _phases(result.trajectory)) for result in results)

    def cases(self) -> Iterator[tuple[Path, MotionLimits, SpeedZone, tuple[float, float]]]:
        """Path, limits, speed zone, start speed and acceleration: every path under every set of limits."""
        for path in self.paths():
            for limits in self.limits():
                for zone in (SpeedZone(), SpeedZone(0.15, 0.4)):
                    for start in ((0.0, 0.0), (0.2, 0.0), (0.2, -0.2), (0.15, 0.1)):
                        yield path, limits, zone, start

    def test_what_is_ok_is_certified(self) -> None:
        """`parameterize`: under `limits`, at rest at every cusp and at the end; OK: the whole path, worst ratio <= 1.

        The independent certificate decides. Starting at rest every path here can be driven, so OK is demanded.
        """
        plugin = self.ready_plugin()
        for path, limits, zone, (speed, acceleration) in self.cases():
            result = plugin.parameterize(path, limits, zone, start_speed=speed, start_acceleration=acceleration)
            require(isinstance(result, TimingResult), f"a TimingResult, got {type(result).__name__}")
            require(result.status is TimingStatus.OK or speed > 0.0, f"from rest it is OK, got {result.status!r}")
            if result.status is TimingStatus.OK:
                self._require_start(result.trajectory, speed, acceleration)
                _require_certified(result, path, limits, zone)

    def test_moving_the_path_changes_no_time(self) -> None:
        """`parameterize`: the time law belongs to the shape of the path, wherever it lies."""
        plugin = self.ready_plugin()
        for path in self.paths():
            here = plugin.parameterize(moved_path(path, ORIGIN), MotionLimits(), SpeedZone()).trajectory
            there = plugin.parameterize(moved_path(path, Pose2(3.0, -2.0, 0.8)), MotionLimits(), SpeedZone()).trajectory
            require(here is not None and there is not None, "both can be timed")
            if here is not None and there is not None:
                change = abs(there.duration - here.duration)
                require(change <= 1e-6, f"the duration stays {here.duration} s, changed by {change} s")

    def test_impossible_starts_are_statuses(self) -> None:
        """`TimingStatus`: START_INFEASIBLE, CANNOT_STOP, BAD_START; never OK and never an exception."""
        plugin, path, limits = self.ready_plugin(), straight_drive(ORIGIN).path, MotionLimits()
        starts = {
            "twice the speed limit": (2.0 * limits.max_speed, 0.0),
            "against the travel": (-0.1, 0.0),
            "twice the acceleration limit": (0.1, 2.0 * limits.max_acceleration),
        }
        for what, (speed, acceleration) in starts.items():
            result = plugin.parameterize(path, limits, SpeedZone(), start_speed=speed, start_acceleration=acceleration)
            require(isinstance(result.status, TimingStatus), f"a status, got {result.status!r}")
            require(result.status is not TimingStatus.OK, f"a start {what} is not OK")
            self._require_start(result.trajectory, speed, acceleration)

    def test_a_path_too_short_to_stop_on_says_by_how_much(self) -> None:
        """`TimingResult`: CANNOT_STOP, with the braking motion and its overshoot beyond the end."""
        path, limits = straight_drive(ORIGIN, length=2.0).path, MotionLimits()
        short = Path.from_poses([ORIGIN, Pose2(_SHORT, 0.0, 0.0)])
        result = self.ready_plugin().parameterize(short, limits, SpeedZone(), start_speed=limits.max_speed)
        require(result.status is TimingStatus.CANNOT_STOP, f"5 cm cannot stop 0.5 m/s, got {result.status!r}")
        braking = limits.max_speed**2 / (2.0 * limits.max_deceleration) - _SHORT
        require(result.overshoot >= 0.9 * braking, f"overshoot at least {braking:.3f} m, got {result.overshoot}")
        self._require_start(result.trajectory, limits.max_speed, 0.0)
        longer = self.ready_plugin().parameterize(path, limits, SpeedZone(), start_speed=limits.max_speed)
        require(longer.overshoot == 0.0, f"overshoot 0 unless CANNOT_STOP, got {longer.overshoot}")

    def test_a_turn_in_place_is_no_motion_along_a_path(self) -> None:
        """`TimingStatus.FAIL`: there is no motion to offer where arc length stands still."""
        turn = Path.from_poses([ORIGIN, Pose2(0.0, 0.0, 0.5)])
        result = self.ready_plugin().parameterize(turn, MotionLimits(), SpeedZone())
        require(result.status is TimingStatus.FAIL, f"a turn in place fails, got {result.status!r}")
        require(result.trajectory is None, "FAIL offers no motion")

    def test_a_path_of_almost_no_length_has_a_status(self) -> None:
        """`TimingStatus`: how it ended, never an exception: from a picometre to a millimetre."""
        for exponent in range(-13, -2):
            path = Path((clothoid(ORIGIN, [0.0, 10.0**exponent], [0.0, 0.0]),))
            result = self.ready_plugin().parameterize(path, MotionLimits(), SpeedZone())
            require(isinstance(result.status, TimingStatus), f"a status, got {result.status!r}")
            offered = result.trajectory is not None
            require(offered or result.status is not TimingStatus.OK, "OK comes with a trajectory")

    def test_a_start_that_is_no_number_is_refused_or_bad(self) -> None:
        """`start_speed`, `start_acceleration`: NaN and infinity are InvalidValue or BAD_START."""
        plugin, path = self.ready_plugin(), straight_drive(ORIGIN).path
        for bad in (math.nan, math.inf):
            for v, a in ((bad, 0.0), (0.0, bad)):
                try:
                    result = plugin.parameterize(path, MotionLimits(), SpeedZone(), start_speed=v, start_acceleration=a)
                except InvalidValue:
                    continue
                refused = result.status is TimingStatus.BAD_START
                require(refused, f"speed {v}, acceleration {a} is a bad start, got {result.status!r}")

    def test_what_is_not_ok_says_why(self) -> None:
        """`TimingResult`: a `reason` where it is not OK; of an impossible start `limit` and `at_s` too."""
        plugin, path, limits = self.ready_plugin(), straight_drive(ORIGIN).path, MotionLimits()
        done = plugin.parameterize(path, limits, SpeedZone())
        require(done.reason == "", f"OK needs no reason, got {done.reason!r}")
        fast = plugin.parameterize(path, limits, SpeedZone(), start_speed=1.2 * limits.max_speed)
        require(bool(fast.reason), f"{fast.status!r} has a reason")
        require(fast.limit == "max_speed", f"too fast for max_speed, got {fast.limit!r}")
        inside = fast.at_s is not None and 0.0 <= fast.at_s <= path.length
        require(inside, f"at a place on the path, got {fast.at_s}")

    def test_little_time_is_a_status(self) -> None:
        """`max_time`: none left is TIMED_OUT, without a motion; whatever is OK in little time is certified."""
        plugin = self.ready_plugin()
        for path, limits, zone, _start in self.cases():
            for max_time in (0.0, 0.001, 0.01):
                result = plugin.parameterize(path, limits, zone, max_time=max_time)
                late = result.status is TimingStatus.TIMED_OUT
                require(late or max_time > 0.0, f"no time is TIMED_OUT, got {result.status!r}")
                require(not late or result.trajectory is None, "TIMED_OUT offers no motion")
                if result.status is TimingStatus.OK:
                    _require_certified(result, path, limits, zone)

    def test_it_stops_when_cancelled_and_times_again(self) -> None:
        """`parameterize`: polls `cancel_checker`; TimingCancelled when it returned True."""
        plugin = self.ready_plugin()
        path, limits, zone, _start = next(self.cases())
        before = plugin.parameterize(path, limits, zone)
        require_cancellable(
            lambda cancelled: plugin.parameterize(path, limits, zone, cancel_checker=cancelled), TimingCancelled
        )
        after = plugin.parameterize(path, limits, zone)
        same = after.status is before.status and _law(after) == _law(before)
        require(same, "after a cancellation it times as before")

    def test_trajectories_can_be_sent(self) -> None:
        """`TimingResult.trajectory`: a plain value; pickled and back it is the same motion."""
        for path in self.paths():
            result = self.ready_plugin().parameterize(path, MotionLimits(), SpeedZone())
            require(result.trajectory is not None, "it can be timed")
            if result.trajectory is not None:
                copy = pickle.loads(pickle.dumps(result.trajectory))
                same = np.array_equal(copy.sample(0.1).x, result.trajectory.sample(0.1).x)
                require(same and _phases(copy) == _phases(result.trajectory), "the copy is the same motion")

    @staticmethod
    def _require_start(trajectory: Trajectory | None, speed: float, acceleration: float) -> None:
        if trajectory is not None:
            law = trajectory.time_law
            found, wanted = (law.start_speed, law.start_acceleration), (speed, acceleration)
            require(found == wanted, f"a motion begins as the robot moves, {wanted}, got {found}")


def _require_certified(result: TimingResult, path: Path, limits: MotionLimits, zone: SpeedZone) -> None:
    require(result.trajectory is not None, "OK comes with a trajectory")
    if result.trajectory is None:
        return
    proof = certify_trajectory(result.trajectory, limits, zone)
    require(proof.certified, f"OK is certified: {proof.reason}")
    require(abs(result.trajectory.path.length - path.length) <= 1e-9, "OK drives the whole path")
    require(result.worst_ratio <= 1.0 + 1e-6, f"OK has a worst ratio of at most 1, got {result.worst_ratio}")
    require(result.overshoot == 0.0, f"overshoot 0 unless CANNOT_STOP, got {result.overshoot}")


def _phases(trajectory: Trajectory | None) -> tuple[tuple[float, float], ...]:
    if trajectory is None:
        return ()
    return tuple(zip(trajectory.time_law.durations.tolist(), trajectory.time_law.jerks.tolist(), strict=True))


def _law(result: TimingResult) -> object:
    """The motion, comparable."""
    return None if result.trajectory is None else result.trajectory.time_law.states.tolist()
