"""Smoother of recorded motions, which corrects the odometry by the detections of a dock whose pose is constant.

The increments of the odometry are corrected by

    way' = (1 + scale + a) way,    turn' = (1 + turn_scale) turn + drift way + b |way|,

where a and b are random and change every 0.2 s (slip). With the corrected pose p(t) and the pose D of the dock, a
detection is expected at p(stamp - delay)^-1 D. Scale, drift, turn scale and delay are common to all recordings; each
recording has a separate D and separate values a and b. The solution of this nonlinear least squares problem is the
maximum a posteriori estimate of a smoother ([BarShalom2001]). The standard deviations of a, b and the detections are
then estimated from the residuals, and the problem is solved again.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.calibration.statistics import clusters_of, likelihood_covariance, student
from optdock.geometry.arrays import readonly
from optdock.geometry.pose import wrap_angles

if TYPE_CHECKING:
    from collections.abc import Sequence

    from optdock.calibration.recording import Recording
    from optdock.geometry.arrays import FloatArray

__all__ = [
    "DetectionNoise",
    "Noise",
    "RecordedMotion",
    "Seen",
    "Smoothed",
    "detection_noise",
    "relative_poses",
    "smoothed",
]

_CELL = 0.2  # [s]: slip is rarely shorter
_LEAST_WAY = 1e-3  # [m] in a cell, below which the robot is at rest without slip
_LEAST_DETECTIONS = 8  # detections: twice as many values as one recording has unknowns
_LEVER = 0.2  # [m]: half of a usual track width, converts turns to distance travelled by the wheels
_CAUCHY = 2.5  # standard deviations beyond which the weight of a detection decreases
_EVALUATIONS = 40  # limit for the problem of one recording, which is nearly linear
_PRIOR = readonly(np.array([0.1, 0.5, 0.2, 0.5]))  # weak: scale [1], drift [rad/m], turn scale [1], delay [s]
_ROUNDS = 2  # of estimating the noise, after which the noise changes by less than its uncertainty
_LEAST_SIGMA = 2e-4  # [m], [rad]: no detector is more exact
_WRONG = 0.08, 0.15  # [m], [rad]: initial standard deviations of wrong detections
_FLOOR = 1e-12
_STRETCH = 1.0  # [s]: slip is shorter


class Noise(NamedTuple):
    """Standard deviations of detections and of slip.

    Attributes:
        position: Detected x and y at a range of 0, each [m].
        position_slope: Increase of `position` per metre of range [1].
        yaw: Detected yaw at range 0 [rad].
        yaw_slope: Increase of `yaw` per metre of range [rad/m].
        jitter: Stamps [s].
        slip: Error of the distance travelled after one metre [m/m^0.5].
        slip_yaw: Error of the heading after one metre [rad/m^0.5].
    """

    position: float = 0.004
    position_slope: float = 0.005
    yaw: float = 0.008
    yaw_slope: float = 0.01
    jitter: float = 0.01
    slip: float = 0.02
    slip_yaw: float = 0.04

    def sigmas(self, ranges: FloatArray, velocity: FloatArray) -> FloatArray:
        """Return the standard deviations of detected x, y [m] and yaw [rad], Shape (n, 3).

        Args:
            ranges: Distance of the dock, Shape (n,) [m].
            velocity: Velocity of the dock in the robot's frame, Shape (n, 3) [m/s, m/s, rad/s].
        """
        position = np.maximum(self.position + self.position_slope * ranges, _LEAST_SIGMA)
        yaw = np.maximum(self.yaw + self.yaw_slope * ranges, _LEAST_SIGMA)
        found: FloatArray = np.sqrt(np.column_stack((position, position, yaw)) ** 2 + (self.jitter * velocity) ** 2)
        return found


class Seen(NamedTuple):
    """Detections of one recording compared with the smoothed motion.

    Attributes:
        stamps: Recorded stamps, Shape (n,) [s].
        detected: Docked pose in the robot's frame, Shape (n, 3).
        sigmas: Estimated standard deviations of x, y [m], yaw [rad], Shape (n, 3).
        ranges: Distance of the docked pose, Shape (n,) [m].
        velocity: Velocity of the dock in the robot's frame, Shape (n, 3) [m/s, m/s, rad/s].
        residuals: Detected minus expected x [m], y [m] and yaw [rad] in the robot's frame, Shape (n, 3).
        leverage: Share of the variance of each residual that the fit has removed, Shape (n, 3).
    """

    stamps: FloatArray
    detected: FloatArray
    sigmas: FloatArray
    ranges: FloatArray
    velocity: FloatArray
    residuals: FloatArray
    leverage: FloatArray


class Smoothed(NamedTuple):
    """One recording with corrected odometry.

    Attributes:
        recording: The recording.
        times: Times of the odometry, Shape (n,) [s].
        seen_from_dock: Poses of the robot in the frame of the dock, Shape (n, 3).
        seen: Detections.
    """

    recording: Recording
    times: FloatArray
    seen_from_dock: FloatArray
    seen: Seen


class RecordedMotion(NamedTuple):
    """Smoothed recordings and the parameters common to all of them.

    Attributes:
        values: Scale [1], drift [rad/m], turn scale [1], delay [s], Shape (4,).
        covariance: Covariance of `values`, Shape (4, 4); 1.96 standard deviations give the 95 % confidence interval.
        noise: Standard deviations of detections and slip.
        of: Smoothed recordings.
    """

    values: FloatArray
    covariance: FloatArray
    noise: Noise
    of: tuple[Smoothed, ...]

    @property
    def delay(self) -> float:
        """Delay of the detections [s]."""
        return float(self.values[3])


def smoothed(recordings: Sequence[Recording]) -> RecordedMotion | None:
    """Smooth the motion of all recordings with enough detections; return None if there is no such recording."""
    usable = [one for one in recordings if len(one.detections) >= _LEAST_DETECTIONS and len(one.path.times) > 20]
    problems = [one for one in map(_Problem, usable) if len(one.stamps) >= _LEAST_DETECTIONS]
    if not problems:
        return None
    noise = _FIRST
    solutions = [problem.solve(noise, np.zeros(4)) for problem in problems]
    for _ in range(_ROUNDS):
        noise = detection_noise([one.seen for one in solutions]).noise._replace(**_slip_of(solutions))
        values, _ = _combined(solutions)
        solutions = [problem.solve(noise, values) for problem in problems]
    values, covariance = _combined(solutions)
    found = tuple(problem.smoothed(solution) for problem, solution in zip(problems, solutions, strict=True))
    return RecordedMotion(values, covariance, noise, found)


_FIRST = Noise()


class DetectionNoise(NamedTuple):
    """Maximum likelihood estimate of the noise of detections.

    Attributes:
        noise: Standard deviations.
        covariance: Covariance of position, position slope, yaw, yaw slope and the square of the jitter, Shape (5, 5).
        wrong: Probability that each detection is wrong, Shape (n,).
    """

    noise: Noise
    covariance: FloatArray
    wrong: FloatArray


def detection_noise(seen: Sequence[Seen]) -> DetectionNoise:
    """Estimate the standard deviations of detections by maximum likelihood.

    The probability density of a detection is a mixture. Correct detections have standard deviations that grow with the
    range and, due to the jitter of the stamps, with the speed; wrong detections have large standard deviations. The
    covariance is clustered by intervals of one second, because slip that is missing from the smoothed motion affects
    all detections in an interval.
    """
    from scipy.optimize import minimize

    residuals = np.concatenate([one.residuals for one in seen])
    ranges = np.concatenate([one.ranges for one in seen])
    velocity = np.concatenate([one.velocity for one in seen])
    left = 1.0 - np.concatenate([one.leverage for one in seen])

    def parts(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the log densities of correct and wrong detections, Shape (n,) each."""
        spread = _variances(x, ranges, velocity) * left + _FLOOR
        far = np.array([x[5], x[5], x[6]]) ** 2 + spread
        share = 1.0 / (1.0 + np.exp(-x[7]))
        right, wrong = (-0.5 * np.sum(residuals**2 / var + np.log(2.0 * np.pi * var), axis=1) for var in (spread, far))
        return right + np.log1p(-share), wrong + np.log(share)

    scale = np.array([1e-3, 1e-3, 1e-3, 1e-3, 1e-4, 0.1, 0.1, 1.0])
    start = np.array([3e-3, 4e-3, 6e-3, 8e-3, 1e-4, *_WRONG, -3.0]) / scale
    lower = np.array([_LEAST_SIGMA, -0.05, _LEAST_SIGMA, -0.05, 0.0, 0.02, 0.03, -7.0]) / scale
    upper = np.array([0.2, 0.2, 0.5, 0.5, 0.04, 0.5, 1.0, 0.0]) / scale

    def log_densities(z: FloatArray) -> FloatArray:
        return np.logaddexp(*parts(z * scale))

    def misfit(z: FloatArray) -> float:
        return -float(np.sum(log_densities(z)))

    bounds = list(zip(lower.tolist(), upper.tolist(), strict=True))
    z = minimize(misfit, start, method="L-BFGS-B", bounds=bounds).x
    right, wrong = parts(z * scale)
    clusters = np.concatenate(clusters_of((one.stamps - np.min(one.stamps) for one in seen), _STRETCH))
    covariance = likelihood_covariance(log_densities, z, clusters)[:5, :5] * np.outer(scale[:5], scale[:5])
    position, position_slope, yaw, yaw_slope, square = (z * scale)[:5].tolist()
    noise = Noise(position, position_slope, yaw, yaw_slope, max(square, 0.0) ** 0.5)
    return DetectionNoise(noise, covariance, 1.0 / (1.0 + np.exp(np.clip(right - wrong, -50, 50))))


def _variances(x: FloatArray, ranges: FloatArray, velocity: FloatArray) -> FloatArray:
    """Return the variances of correct x, y and yaw, Shape (n, 3), extended smoothly to negative slopes and jitter."""
    position, yaw = (np.maximum(x[k] + x[k + 1] * ranges, _LEAST_SIGMA) for k in (0, 2))
    found: FloatArray = np.column_stack((position, position, yaw)) ** 2 + x[4] * velocity**2
    return np.maximum(found, _LEAST_SIGMA**2)


class _Solution(NamedTuple):
    """Solution for one recording: parameters, information and score of the common parameters, detections, slip."""

    parameters: FloatArray
    information: FloatArray
    score: FloatArray
    seen: Seen
    slip: FloatArray  # expected squares of a and b times the distance of the cell, Shape (c, 2)


class _Problem:
    """Least squares problem of one recording."""

    def __init__(self, recording: Recording) -> None:
        self.recording = recording
        path = recording.path
        self.times, self._first_yaw = path.times, float(path.poses[0, 2])
        self._along, self._aside, self._turn = path.increments
        self._worn = np.abs(self._along) + _LEVER * np.abs(self._turn)  # distance travelled by the wheels
        rows = recording.detections
        inside = (rows[:, 0] > self.times[0] + 0.1) & (rows[:, 0] < self.times[-1])
        self.stamps, self._detected = rows[inside, 0], rows[inside, 1:4]
        grid = np.arange(self.times[0], self.times[-1] + _CELL, _CELL)
        worn = np.diff(np.interp(grid, self.times, np.concatenate(([0.0], np.cumsum(self._worn)))))
        moving = worn > _LEAST_WAY
        self._begins, self._ends, self._ways = grid[:-1][moving], grid[1:][moving], worn[moving]

    def solve(self, noise: Noise, guess: FloatArray) -> _Solution:
        """Estimate the four common parameters, the dock, and the slip in distance and yaw in every cell."""
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
        """Return the corrected motion."""
        rows = relative_poses(solution.parameters[None, 4:7], self._poses(solution.parameters))
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
        # Schur complement: information of the common parameters with the others eliminated.
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
        """Return the median pose of the dock over all detections, with the initial parameters."""
        poses = self._at(self._poses(x), self.stamps - x[3])
        c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        seen = self._detected
        yaw = poses[:, 2] + seen[:, 2]
        turn = math.atan2(float(np.median(np.sin(yaw))), float(np.median(np.cos(yaw))))
        places = poses[:, 0] + c * seen[:, 0] - s * seen[:, 1], poses[:, 1] + s * seen[:, 0] + c * seen[:, 1]
        return np.array([*(float(np.median(place)) for place in places), turn])

    def _poses(self, x: FloatArray) -> FloatArray:
        """Return the corrected poses at the times of the odometry, Shape (n, 3)."""
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
        """Return values of the cells at the midpoints of the odometry's steps, 0 outside of cells, Shape (n - 1,)."""
        middle = 0.5 * (self.times[1:] + self.times[:-1])
        row = np.searchsorted(self._begins, middle, side="right") - 1
        inside = (row >= 0) & (middle < self._ends[np.maximum(row, 0)]) if len(self._ends) else np.zeros(0, dtype=bool)
        return np.where(inside, cells[np.maximum(row, 0)], 0.0) if len(cells) else np.zeros(len(middle))

    def _at(self, poses: FloatArray, stamps: FloatArray) -> FloatArray:
        return np.column_stack([np.interp(stamps, self.times, poses[:, k]) for k in range(3)])

    def _expected(self, x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return expected detections, their rates [1/s], and poses of the robot at the detections and at all times."""
        all_poses = self._poses(x)
        stamps, half = self.stamps - x[3], 0.03
        poses = self._at(all_poses, stamps)
        ahead, back = (relative_poses(self._at(all_poses, stamps + sign * half), x[None, 4:7]) for sign in (1.0, -1.0))
        return relative_poses(poses, x[None, 4:7]), (ahead - back) / (2.0 * half), poses, all_poses

    def _residuals(self, x: FloatArray, sigmas: FloatArray, noise: Noise) -> FloatArray:
        off = self._detected - self._expected(x)[0]
        off[:, 2] = wrap_angles(off[:, 2])
        cells = len(self._ways)
        grow = np.sqrt(self._ways)
        return np.concatenate(
            ((off / sigmas).ravel(), x[7 : 7 + cells] * grow / noise.slip, x[7 + cells :] * grow / noise.slip_yaw)
        )

    def _slopes(self, x: FloatArray, sigmas: FloatArray, noise: Noise) -> FloatArray:
        """Return the derivatives of the residuals, Shape (3 n + 2 c, 7 + 2 c)."""
        _, velocity, poses, all_poses = self._expected(x)
        stamps, cells = self.stamps - x[3], len(self._ways)
        moved = np.zeros((len(stamps), 3, 7 + 2 * cells))  # derivatives of the robot's poses
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
        """Return sums of `steps` from each beginning to the end or the stamp, whichever is earlier, Shape (n, c)."""
        total = np.concatenate(([0.0], np.cumsum(steps)))
        until = np.clip(stamps[:, None], begins, ends)
        found: FloatArray = np.interp(until, self.times, total) - np.interp(begins, self.times, total)
        return found


def _robust(residuals: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the signed square roots of the Cauchy loss of the residuals, and their derivatives, Shape (n,) each."""
    ratio = residuals / _CAUCHY
    found = np.sign(ratio) * _CAUCHY * np.sqrt(np.log1p(ratio**2))
    small = np.abs(ratio) < 1e-6
    slopes = residuals / (1.0 + ratio**2) / np.where(small, 1.0, found)
    return np.where(small, residuals, found), np.where(small, 1.0, slopes)


def relative_poses(frames: FloatArray, poses: FloatArray) -> FloatArray:
    """Return poses relative to frames, with yaw not normalized, Shape (n, 3).

    Args:
        frames: Shape (n, 3), or (1, 3) for one frame.
        poses: Shape (n, 3), or (1, 3) for one pose.
    """
    c, s = np.cos(frames[:, 2]), np.sin(frames[:, 2])
    x, y = poses[:, 0] - frames[:, 0], poses[:, 1] - frames[:, 1]
    return np.column_stack((c * x + s * y, c * y - s * x, poses[:, 2] - frames[:, 2]))


def _combined(solutions: list[_Solution]) -> tuple[FloatArray, FloatArray]:
    """Return the common parameters of all recordings, and their covariance.

    Each standard deviation is the larger of the model's standard deviation and the scatter between recordings, scaled
    by Student's t.
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
    """Return the standard deviations of slip after one metre, which are root mean squares over the cells."""
    cells = np.concatenate([one.slip for one in solutions])
    if len(cells) == 0:  # the robot never moved
        return {}
    along, yaw = np.sqrt(np.mean(cells, axis=0)).tolist()
    return {"slip": max(along, 1e-3), "slip_yaw": max(yaw, 1e-3)}
