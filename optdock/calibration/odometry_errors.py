"""Systematic errors of the odometry against detections of a dock that stands still, and how late these are.

With p the pose by odometry, its increments are corrected,

    way' = (1 + scale + a) way,    turn' = (1 + turn_scale) turn + drift way + b |way|,

where a and b are random and change every 0.2 s (slip), and the dock D, at rest, must be seen at p(stamp - delay)^-1 D.
Unknown are scale, drift, turn scale and delay, common to all recordings, and of each recording D and all a and b; it is
one nonlinear least squares problem, the maximum a posteriori estimate of a smoother ([BarShalom2001]). The spread of a
and b and of the detections is estimated from what is left, and the problem solved again.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.calibration.detections import noise_of
from optdock.calibration.recorded_motion import Noise, RecordedMotion, Seen, Smoothed
from optdock.calibration.statistics import Quantity, student, unknown
from optdock.geometry.arrays import readonly
from optdock.geometry.pose import wrap_angles

if TYPE_CHECKING:
    from collections.abc import Sequence

    from optdock.calibration.recording import Recording
    from optdock.geometry.arrays import FloatArray

__all__ = ["odometry_quantities", "smoothed"]

_CELL = 0.2  # [s]: no slip is shorter than that by much
_LEAST_WAY = 1e-3  # [m] in a cell, below which the robot stands and nothing slips
_LEAST_DETECTIONS = 8  # twice as many numbers as there are unknowns of one recording at least
_LEVER = 0.2  # [m]: half of a usual track width, by which turning counts as way of the wheels
_CAUCHY = 2.5  # standard deviations from which on a detection counts less
_EVALUATIONS = 40  # most of a recording's problem, which is nearly linear
_PRIOR = readonly(np.array([0.1, 0.5, 0.2, 0.5]))  # of scale [1], drift [rad/m], turn scale [1], delay [s]: hardly any
_ROUNDS = 2  # of estimating the spreads, after which they change by less than their own uncertainty


def smoothed(recordings: Sequence[Recording]) -> RecordedMotion | None:
    """Smooth the motion of all recordings that have detections enough; None where none has."""
    problems = [_Problem(one) for one in recordings if _can_be_used(one)]
    problems = [one for one in problems if len(one.stamps) >= _LEAST_DETECTIONS]
    if not problems:
        return None
    noise = _FIRST
    solutions = [problem.solve(noise, np.zeros(4)) for problem in problems]
    for _ in range(_ROUNDS):
        noise = noise_of([solution.seen for solution in solutions])._replace(**_slip_of(solutions))
        values, _ = _together(solutions)
        solutions = [problem.solve(noise, values) for problem in problems]
    values, covariance = _together(solutions)
    found = tuple(problem.smoothed(solution) for problem, solution in zip(problems, solutions, strict=True))
    return RecordedMotion(values, covariance, noise, found)


_FIRST = Noise()


def _can_be_used(recording: Recording) -> bool:
    path = recording.path
    return len(path.times) > 20 and len(recording.detections) >= _LEAST_DETECTIONS


class _Solution(NamedTuple):
    """Of one recording: parameters, information and score of the four that are common to all, what is left."""

    parameters: FloatArray
    information: FloatArray
    score: FloatArray
    seen: Seen
    slip: FloatArray  # squares of a and b, each times the way of its cell, with what is uncertain of them, Shape (c, 2)


class _Problem:
    """The least squares problem of one recording."""

    def __init__(self, recording: Recording) -> None:
        self.recording = recording
        self.times, poses = recording.path
        step = np.diff(poses, axis=0)
        middle = poses[:-1, 2] + 0.5 * step[:, 2]
        c, s = np.cos(middle), np.sin(middle)
        self._along, self._aside = c * step[:, 0] + s * step[:, 1], c * step[:, 1] - s * step[:, 0]
        self._turn = step[:, 2]
        self._first_yaw = float(poses[0, 2])
        self._worn = np.abs(self._along) + _LEVER * np.abs(self._turn)  # way of the wheels
        rows = recording.detections
        inside = (rows[:, 0] > self.times[0] + 0.1) & (rows[:, 0] < self.times[-1])
        self.stamps, self._detected = rows[inside, 0], rows[inside, 1:4]
        grid = np.arange(self.times[0], self.times[-1] + _CELL, _CELL)
        worn = np.diff(np.interp(grid, self.times, np.concatenate(([0.0], np.cumsum(self._worn)))))
        moving = worn > _LEAST_WAY
        self._begins, self._ends, self._ways = grid[:-1][moving], grid[1:][moving], worn[moving]

    def solve(self, noise: Noise, guess: FloatArray) -> _Solution:
        """The parameters that fit best: the four common ones, the dock, and slip along and in yaw of every cell."""
        from scipy.optimize import least_squares

        start = np.concatenate((guess, np.zeros(3 + 2 * len(self._ways))))
        start[4:7] = self._first_dock(start)
        relative, velocity = self._expected(start)[:2]
        sigmas = noise.sigmas(np.hypot(relative[:, 0], relative[:, 1]), velocity)
        count = 3 * len(self.stamps)

        def residuals(x: FloatArray) -> FloatArray:
            plain = self._residuals(x, sigmas, noise)
            return np.concatenate((_robust(plain[:count])[0], plain[count:]))

        def slopes(x: FloatArray) -> FloatArray:
            plain = self._slopes(x, sigmas, noise)
            plain[:count] *= _robust(self._residuals(x, sigmas, noise)[:count])[1][:, None]
            return plain

        found = least_squares(residuals, start, slopes, x_scale="jac", max_nfev=_EVALUATIONS)
        return self._solution(found.x, sigmas, noise)

    def smoothed(self, solution: _Solution) -> Smoothed:
        """The motion as corrected."""
        poses, dock = self._poses(solution.parameters), solution.parameters[4:7]
        c, s = math.cos(dock[2]), math.sin(dock[2])
        x, y = poses[:, 0] - dock[0], poses[:, 1] - dock[1]
        rows = np.column_stack((c * x + s * y, c * y - s * x, poses[:, 2] - dock[2]))
        rows[:, 2] = wrap_angles(rows[:, 2])
        return Smoothed(self.recording, self.times, rows, solution.seen)

    def _solution(self, x: FloatArray, sigmas: FloatArray, noise: Noise) -> _Solution:
        count = 3 * len(self.stamps)
        residuals, slopes = self._residuals(x, sigmas, noise), self._slopes(x, sigmas, noise)
        weights = np.ones(len(residuals))
        weights[:count] = 1.0 / (1.0 + (residuals[:count] / _CAUCHY) ** 2)
        weighted = slopes * weights[:, None]
        normal = slopes.T @ weighted
        inverse = np.linalg.pinv(normal)
        # The four common ones, with all others solved for: a Schur complement.
        own, others = normal[:4, :4], normal[4:, 4:]
        coupling = np.linalg.solve(others, normal[4:, :4])
        information = own - normal[:4, 4:] @ coupling
        relative, velocity = self._expected(x)[:2]
        leverage = np.einsum("ij,jk,ik->i", slopes[:count], inverse, slopes[:count]).reshape(-1, 3)
        seen = Seen(
            self.stamps,
            self._detected,
            sigmas,
            np.hypot(relative[:, 0], relative[:, 1]),
            velocity,
            residuals[:count].reshape(-1, 3) * sigmas,
            np.minimum(leverage, 0.95),
        )
        cells = len(self._ways)
        squares = x[7:] ** 2 + np.diag(inverse)[7:]
        slip = np.column_stack((squares[:cells], squares[cells:])) * self._ways[:, None]
        return _Solution(x, information, information @ x[:4], seen, slip)

    def _first_dock(self, x: FloatArray) -> FloatArray:
        """The dock by the median of all detections, with nothing corrected."""
        poses = self._at(self._poses(x), self.stamps - x[3])
        c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        seen = self._detected
        yaw = poses[:, 2] + seen[:, 2]
        turn = math.atan2(float(np.median(np.sin(yaw))), float(np.median(np.cos(yaw))))
        places = poses[:, 0] + c * seen[:, 0] - s * seen[:, 1], poses[:, 1] + s * seen[:, 0] + c * seen[:, 1]
        return np.array([*(float(np.median(place)) for place in places), turn])

    def _poses(self, x: FloatArray) -> FloatArray:
        """Corrected, at the times of the odometry, Shape (n, 3)."""
        cells = len(self._ways)
        slip, bend = (self._spread(part) for part in (x[7 : 7 + cells], x[7 + cells :]))
        way = self._along * (1.0 + x[0]) + self._worn * np.sign(self._along) * slip
        turn = self._turn * (1.0 + x[2]) + x[1] * self._along + self._worn * bend
        yaw = self._first_yaw + np.concatenate(([0.0], np.cumsum(turn)))
        middle = 0.5 * (yaw[1:] + yaw[:-1])
        c, s = np.cos(middle), np.sin(middle)
        steps = c * way - s * self._aside, s * way + c * self._aside
        return np.column_stack((*(np.concatenate(([0.0], np.cumsum(step))) for step in steps), yaw))

    def _spread(self, cells: FloatArray) -> FloatArray:
        """Values of the cells at the steps of the odometry, each for the cell of its middle, Shape (n - 1,)."""
        middle = 0.5 * (self.times[1:] + self.times[:-1])
        row = np.searchsorted(self._begins, middle, side="right") - 1
        inside = (row >= 0) & (middle < self._ends[np.maximum(row, 0)]) if len(self._ends) else np.zeros(0, dtype=bool)
        return np.where(inside, cells[np.maximum(row, 0)], 0.0) if len(cells) else np.zeros(len(middle))

    def _at(self, poses: FloatArray, stamps: FloatArray) -> FloatArray:
        return np.column_stack([np.interp(stamps, self.times, poses[:, k]) for k in range(3)])

    def _expected(self, x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """The dock as it must be seen, how that changes [1/s], the poses it is seen from; of all odometry too."""
        all_poses = self._poses(x)
        stamps, half = self.stamps - x[3], 0.03
        poses = self._at(all_poses, stamps)
        ahead, back = (_seen_from(self._at(all_poses, stamps + sign * half), x[4:7]) for sign in (1.0, -1.0))
        return _seen_from(poses, x[4:7]), (ahead - back) / (2.0 * half), poses, all_poses

    def _residuals(self, x: FloatArray, sigmas: FloatArray, noise: Noise) -> FloatArray:
        off = self._detected - self._expected(x)[0]
        off[:, 2] = wrap_angles(off[:, 2])
        cells = len(self._ways)
        grow = np.sqrt(self._ways)
        return np.concatenate(
            ((off / sigmas).ravel(), x[7 : 7 + cells] * grow / noise.slip, x[7 + cells :] * grow / noise.slip_yaw)
        )

    def _slopes(self, x: FloatArray, sigmas: FloatArray, noise: Noise) -> FloatArray:
        """Derivatives of the residuals, Shape (3 n + 2 c, 7 + 2 c)."""
        _, velocity, poses, all_poses = self._expected(x)
        stamps, cells = self.stamps - x[3], len(self._ways)
        moved = np.zeros((len(stamps), 3, 7 + 2 * cells))  # of the poses that the dock is seen from
        middle = 0.5 * (all_poses[1:, 2] + all_poses[:-1, 2])
        heading = np.column_stack((np.cos(middle), np.sin(middle)))
        whole = np.full((1,), self.times[0]), np.full((1,), self.times[-1])
        signed = self._worn * np.sign(self._along)
        places = 0.5 * (all_poses[1:, :2] + all_poses[:-1, :2])
        parts = (
            (slice(0, 1), whole, self._along, None),
            (slice(1, 2), whole, None, self._along),
            (slice(2, 3), whole, None, self._turn),
            (slice(7, 7 + cells), (self._begins, self._ends), signed, None),
            (slice(7 + cells, 7 + 2 * cells), (self._begins, self._ends), None, self._worn),
        )
        for columns, (begins, ends), along, turn in parts:
            if along is not None:
                for k in range(2):
                    moved[:, k, columns] = self._summed(along * heading[:, k], stamps, begins, ends)
            elif turn is not None:
                turned = self._summed(turn, stamps, begins, ends)
                moved[:, 2, columns] = turned
                for k, other, sign in ((0, 1, -1.0), (1, 0, 1.0)):
                    arm = self._summed(turn * places[:, other], stamps, begins, ends)
                    moved[:, k, columns] = sign * (turned * poses[:, other, None] - arm)
        c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        dx, dy = x[4] - poses[:, 0], x[5] - poses[:, 1]
        seen = np.zeros_like(moved)
        mx, my, mt = moved[:, 0], moved[:, 1], moved[:, 2]
        seen[:, 0] = -c[:, None] * mx - s[:, None] * my + (c * dy - s * dx)[:, None] * mt
        seen[:, 1] = s[:, None] * mx - c[:, None] * my - (c * dx + s * dy)[:, None] * mt
        seen[:, 2] = -mt
        seen[:, :, 3] = -velocity
        seen[:, 0, 4], seen[:, 0, 5], seen[:, 1, 4], seen[:, 1, 5], seen[:, 2, 6] = c, s, -s, c, 1.0
        slopes = np.zeros((3 * len(stamps) + 2 * cells, 7 + 2 * cells))
        slopes[: 3 * len(stamps)] = (-seen / sigmas[:, :, None]).reshape(-1, 7 + 2 * cells)
        rows, grow = 3 * len(stamps) + np.arange(cells), np.sqrt(self._ways)
        slopes[rows, 7 + np.arange(cells)] = grow / noise.slip
        slopes[rows + cells, 7 + cells + np.arange(cells)] = grow / noise.slip_yaw
        return slopes

    def _summed(self, steps: FloatArray, stamps: FloatArray, begins: FloatArray, ends: FloatArray) -> FloatArray:
        """Sums of what each step of the odometry adds, from each beginning to each end or stamp, Shape (n, c)."""
        total = np.concatenate(([0.0], np.cumsum(steps)))
        until = np.clip(stamps[:, None], begins, ends)
        found: FloatArray = np.interp(until, self.times, total) - np.interp(begins, self.times, total)
        return found


def _robust(residuals: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Numbers whose squares are Cauchy's loss of residuals, and their derivatives, Shape (n,) each."""
    ratio = residuals / _CAUCHY
    found = np.sign(ratio) * _CAUCHY * np.sqrt(np.log1p(ratio**2))
    small = np.abs(ratio) < 1e-6
    slopes = residuals / (1.0 + ratio**2) / np.where(small, 1.0, found)
    return np.where(small, residuals, found), np.where(small, 1.0, slopes)


def _seen_from(poses: FloatArray, dock: FloatArray) -> FloatArray:
    """A dock in the frames of poses, Shape (n, 3); yaw is not normalized."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    x, y = dock[0] - poses[:, 0], dock[1] - poses[:, 1]
    return np.column_stack((c * x + s * y, c * y - s * x, dock[2] - poses[:, 2]))


def _together(solutions: list[_Solution]) -> tuple[FloatArray, FloatArray]:
    """The four common parameters of all recordings, and their covariance.

    The standard deviations are those of the model, or what the recordings show by disagreeing with each other, by
    Student's t, whichever are larger.
    """
    information = np.sum([one.information for one in solutions], axis=0) + np.diag(_PRIOR**-2.0)
    covariance = np.linalg.inv(information)
    values: FloatArray = covariance @ np.sum([one.score for one in solutions], axis=0)
    count = len(solutions)
    if count < 3:
        return values, covariance
    scores = np.array([one.score - one.information @ values for one in solutions])
    shown = covariance @ (scores.T @ scores) @ covariance * (count / (count - 1.0))
    by_model, by_scores = np.sqrt(np.diag(covariance)), np.sqrt(np.diag(shown))
    grow = np.maximum(1.0, student(count - 1.0) / 1.96 * by_scores / by_model)
    return values, covariance * np.multiply.outer(grow, grow)


def _slip_of(solutions: list[_Solution]) -> dict[str, float]:
    """Standard deviations of slip after a metre: the mean square of what the cells were given."""
    cells = np.concatenate([one.slip for one in solutions])
    if len(cells) == 0:  # the robot stood all the time
        return {}
    along, yaw = np.sqrt(np.mean(cells, axis=0)).tolist()
    return {"slip": max(along, 1e-3), "slip_yaw": max(yaw, 1e-3)}


def odometry_quantities(motion: RecordedMotion, track_width: float) -> list[Quantity]:
    """Scale of the way, turn per metre and scale of turns; with a track width what they say of wheels and base."""
    ways = [np.diff(one.seen_from_dock, axis=0) for one in motion.of]
    way = sum(float(np.sum(np.hypot(step[:, 0], step[:, 1]))) for step in ways)
    turned = sum(float(np.sum(np.abs(wrap_angles(step[:, 2])))) for step in ways)
    scale, drift, turn_scale, delay = motion.values.tolist()
    rows = [
        ("scale of the way", "1", scale, np.eye(4)[:1]),
        ("turn per metre", "rad/m", drift, np.eye(4)[1:2]),
        ("scale of turns", "1", turn_scale, np.eye(4)[2:3]),
        ("detections late by", "s", delay, np.eye(4)[3:]),
    ]
    half = 0.5 * track_width
    # A wheel's radius: of the way +- of the turn per metre times half the track; the track: of turns against the way.
    left, right = np.array([[1.0, -half, 0.0, 0.0]]), np.array([[1.0, half, 0.0, 0.0]])
    base = np.array([[1.0, 0.0, -1.0, 0.0]])
    for name, slope in (("left wheel's radius", left), ("right wheel's radius", right), ("track width", base)):
        rows.append((f"{name} beyond what is believed", "1", float((slope @ motion.values)[0]), slope))
    count = 3 * sum(len(one.seen.ranges) for one in motion.of)
    found = []
    for name, unit, value, slope in rows:
        reason = _missing(name, way, turned, track_width)
        spread = 1.96 * math.sqrt(float((slope @ motion.covariance @ slope.T)[0, 0]))
        found.append(
            unknown(name, unit, reason, count)
            if reason
            else Quantity(name, unit, value, value - spread, value + spread, count, len(motion.of))
        )
    return found


_LEAST_TRIP, _LEAST_TURN = 0.3, 0.3  # [m], [rad] in all: of less an odometry with 10 % of error is wrong by nothing


def _missing(name: str, way: float, turned: float, track_width: float) -> str:
    """Why a quantity is unknown; empty where it is known."""
    if way < _LEAST_TRIP:
        return f"the robot drove {way:.2f} m only while it saw the dock"
    if turned < _LEAST_TURN and name in ("scale of turns", "track width beyond what is believed"):
        return f"the robot turned by {turned:.2f} rad only while it saw the dock"
    if track_width == 0.0 and name.endswith("is believed"):
        return "the distance between the wheels, robot.limits.track_width, is not known"
    return ""
