"""Initial guesses: fitted to the input's headings or positions, driven along it by pure pursuit, or an earlier result.

The fit of headings is the cheapest, and the best start where the input is smooth. Where the input is drivable but for
its curvature, which switches within centimetres, the fit drifts away from it, and `tracking` stays on it. Where it is
not drivable at all (turns in place, a start that looks the wrong way), a robot with bounded curvature and curvature
rate pursues it [Coulter1992].
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.deadline import never_late
from optdock.model.path import ClothoidSegment
from smoothers.scp.goal_projection import clipped
from smoothers.scp.loop import SearchGuess, evaluated
from smoothers.scp.qp_step import Penalties, pool_of_this_thread
from smoothers.scp.rollout import Variables, roll_out
from smoothers.scp.tracking import strayed, track

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.geometry.arrays import FloatArray
    from optdock.model.path import Path
    from optdock.model.problem import DockingProblem
    from smoothers.scp.basis import Basis
    from smoothers.scp.nlp import Ends, NonlinearProgram, VariableBounds
    from smoothers.scp.qp_step import ProgramPool
    from smoothers.scp.rollout import Rollout
    from smoothers.scp.settings import GuessSettings

__all__ = ["EarlierResult", "InitialGuesses", "pure_pursuit", "rest_of_earlier_result"]


@dataclass(frozen=True, eq=False)
class InitialGuesses:
    """The guesses for one program.

    Args:
        nlp: The program.
        earlier: What is left of an earlier result, or None.
        pool: Convex programs, for tracking.
        is_late: Asked before and within tracking: whether there is no time for another iteration.
    """

    nlp: NonlinearProgram
    earlier: EarlierResult | None = None
    pool: ProgramPool = field(default_factory=pool_of_this_thread)
    is_late: Callable[[], bool] = never_late

    @property
    def first(self) -> SearchGuess:
        """The most promising one."""
        return self._cold(self._first, self.nlp.settings.guess.patience)

    @property
    def on_the_input(self) -> SearchGuess | None:
        """The tracked one, where the input can be tracked and it was not the first; None where both are alike."""
        if not self._is_trackable or self.tracked is self._first:
            return None
        settings = self.nlp.settings.guess
        apart = self._apart(self.tracked, self._first)
        return self._cold(self.tracked, settings.patience) if apart > settings.different_on_the_input else None

    @property
    def other(self) -> SearchGuess | None:
        """The second of fit and drive, for an obstacle met on its wrong side; None where it is like the first."""
        settings, second = self.nlp.settings.guess, self._untracked
        if self._first is second:
            second = self.pursued if second is self.fitted else self.fitted
        apart = self._apart(self._first, second)
        return self._cold(second, settings.patience_other) if apart > settings.different else None

    @property
    def rest_of_earlier(self) -> SearchGuess | None:
        """What is left of the earlier result, or None."""
        if self.earlier is None:
            return None
        settings = self.nlp.settings.guess
        left = clipped(self.earlier.variables(self.nlp.basis), self.nlp.inner_bounds)
        return SearchGuess(
            left, settings.trust_region_near, settings.proximal_near / self.nlp.radius, settings.patience
        )

    @cached_property
    def fitted(self) -> Variables:
        """Curvatures whose headings fit the input's in the least-squares sense, smoothed and cut to the limit."""
        nlp, lengths = self.nlp, self.nlp.lengths
        turned = nlp.basis.fit @ (nlp.traced.headings - nlp.ends.start[2])
        return clipped(Variables(turned / lengths[nlp.basis.knot_gear], lengths.copy()), nlp.inner_bounds)

    @cached_property
    def pursued(self) -> Variables:
        """A drive along the input within the limits."""
        nlp = self.nlp
        found = pure_pursuit(nlp.basis, nlp.traced.positions, nlp.ends, nlp.inner_bounds, nlp.settings.guess)
        return clipped(found, nlp.inner_bounds)

    @cached_property
    def tracked(self) -> Variables:
        """The drivable path whose positions are nearest to the input's."""
        return track(self.nlp, self.pool, self._untracked, self.trust_region, self.is_late)

    @cached_property
    def trust_region(self) -> float:
        """How far headings may turn in a first step [rad]: positions err by its square times half the length."""
        settings, nlp = self.nlp.settings.guess, self.nlp
        longest = settings.bold_length * nlp.radius
        return settings.trust_region * math.sqrt(min(1.0, longest / float(nlp.lengths.sum())))

    @cached_property
    def _untracked(self) -> Variables:
        """The fit, or the drive where the fit leads away from the input."""
        settings, driven = self.nlp.settings.guess, self._fit_driven
        turned = abs(float(driven.poses[-1, 2] - self.nlp.ends.target[2]))
        is_near = strayed(self.nlp, driven) < settings.astray and turned < settings.turned_away
        return self.fitted if is_near else self.pursued

    @cached_property
    def _is_trackable(self) -> bool:
        """Whether it stays near the input, or at least much nearer than the others do: on long paths spans are long."""
        settings = self.nlp.settings.guess
        tracked, other = (strayed(self.nlp, self._driven(v)) for v in (self.tracked, self._untracked))
        return tracked < max(settings.trackable, settings.much_nearer * other)

    @cached_property
    def _first(self) -> Variables:
        """The fit or the drive; the tracked one where they lead off the input into obstacles or past the goal."""
        nlp, first = self.nlp, self._untracked
        is_near = first is self.fitted and strayed(nlp, self._fit_driven) < nlp.settings.guess.off_the_input
        if is_near or self.is_late():
            return first
        begun, _ = evaluated(nlp, first)
        is_free = begun.shortfall < nlp.scene.settings.deep * nlp.scene.body.width
        if (begun.on_goal and is_free) or self.is_late():
            return first
        loop = nlp.settings.loop
        penalties = Penalties(loop.clearance_penalty, loop.goal_penalty)
        does_better = self._is_trackable and evaluated(nlp, self.tracked)[0].merit(penalties) < begun.merit(penalties)
        return self.tracked if does_better else first

    @cached_property
    def _fit_driven(self) -> Rollout:
        return self._driven(self.fitted)

    def _driven(self, variables: Variables) -> Rollout:
        return roll_out(self.nlp.basis, variables, self.nlp.ends.start, self.nlp.ends.signs)

    def _apart(self, one: Variables, other: Variables) -> float:
        between = self._driven(one).poses[:, :2] - self._driven(other).poses[:, :2]
        return float(np.abs(between).max())

    def _cold(self, variables: Variables, patience: int) -> SearchGuess:
        """A guess of this call; the longer the path, the more steps are refused until they are small enough."""
        settings, spans = self.nlp.settings.guess, self.nlp.basis.span_gear.size
        patience = round(patience * max(1.0, spans / settings.spans_per_patience))
        return SearchGuess(variables, self.trust_region, settings.proximal / self.nlp.radius, patience)


class EarlierResult(NamedTuple):
    """What is left of an earlier result: its last gears, where in the first of them it begins, and free lengths.

    Attributes:
        path: The earlier result.
        first: Index of the first gear that is left.
        begin: Arc length within that gear [m].
        lengths: What is left of every gear, without the final straight, Shape (num_gears,) [m].
    """

    path: Path
    first: int
    begin: float
    lengths: FloatArray

    def variables(self, basis: Basis) -> Variables:
        """Its curvatures at the knots of `basis`."""
        knots = []
        for m, segment in enumerate(self.path.segments[self.first :]):
            share = np.linspace(0.0, 1.0, int(basis.last_knots[m] - basis.first_knots[m]) + 1)
            knots.append(segment.curvature_at((self.begin if m == 0 else 0.0) + share * self.lengths[m]))
        return Variables(np.concatenate(knots), self.lengths.copy())


def rest_of_earlier_result(
    earlier: Path | None, path: Path, problem: DockingProblem, settings: GuessSettings
) -> EarlierResult | None:
    """What is left of `earlier` for a robot at the problem's start, or None where it is of no use.

    It is of use when it is a clothoid path whose last gears are those of `path` and the robot is near it.
    """
    if earlier is None or not all(isinstance(segment, ClothoidSegment) for segment in earlier.segments):
        return None
    count = len(path.segments)
    first = len(earlier.segments) - count
    if first < 0:
        return None
    left = earlier.segments[first:]
    if any(a.direction is not b.direction for a, b in zip(left, path.segments, strict=True)):
        return None
    s = np.linspace(0.0, left[0].length, max(2, int(left[0].length / settings.earlier_spacing)))
    poses = left[0].poses_at(s)
    away = np.hypot(poses[:, 0] - problem.start.x, poses[:, 1] - problem.start.y)
    nearest = int(np.argmin(away))
    if away[nearest] > settings.earlier_lost:
        return None
    lengths = np.array([segment.length for segment in left])
    lengths[0] -= s[nearest]
    lengths[-1] -= problem.dock.final_straight
    if np.any(lengths < settings.earlier_shortest):
        return None
    return EarlierResult(earlier, first, float(s[nearest]), lengths)


class _Limits(NamedTuple):
    curvature: float
    rate: float
    step: float
    lookahead: float


class _Drive(NamedTuple):
    """A driven gear: yaw at equally spaced points, its length, and where it ends."""

    yaw: list[float]
    length: float
    pose: tuple[float, float, float]


def pure_pursuit(
    basis: Basis, positions: FloatArray, ends: Ends, bounds: VariableBounds, settings: GuessSettings
) -> Variables:
    """Curvatures and lengths of a drive along `positions`, by pure pursuit with bounded curvature and rate.

    Args:
        basis: Shape of the path.
        positions: The input at the nodes, Shape (num_nodes, 2) [m].
        ends: Start, target, gears.
        bounds: Of curvature and rate.
        settings: Length of a step and of the whole.
    """
    limit = float(bounds.upper[: basis.num_knots].max())
    headings, lengths = np.empty(basis.num_intervals), np.empty(basis.num_gears)
    pose = (float(ends.start[0]), float(ends.start[1]), float(ends.start[2]))
    for m in range(basis.num_gears):
        points = positions[basis.node_gear == m]
        spacing = float(np.hypot(*np.diff(points, axis=0).T).mean())
        step = min(max(spacing, 0.01), settings.pursuit_step / limit)
        limits = _Limits(limit, bounds.rate, step, max(1.0 / limit, 4.0 * step))
        aim = ends.target[2] if m == basis.num_gears - 1 else None
        line = _extended(points, ends.signs[m], aim, limits)
        drive = _pursue(pose, float(ends.signs[m]), line, limits, settings.pursuit_longest)
        mine = basis.interval_gear == m
        middle = (np.arange(mine.sum()) + 0.5) / mine.sum()
        headings[mine] = np.interp(middle * (len(drive.yaw) - 1.0), np.arange(len(drive.yaw)), drive.yaw)
        lengths[m], pose = drive.length, drive.pose
    # Curvatures at the few knots that reproduce the headings, not samples of the curvature: those would drift away.
    turned = basis.fit @ (headings - ends.start[2])
    return Variables(turned / lengths[basis.knot_gear], lengths)


def _extended(points: FloatArray, sign: float, yaw: float | None, limits: _Limits) -> list[tuple[float, float]]:
    """The points at about the step's spacing, continued straight at the end so that the pursuit lines up with it."""
    away = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))))
    s = np.arange(0.0, away[-1], limits.step)
    dense = [np.interp(s, away, points[:, i]) for i in (0, 1)]
    last = points[-1] - points[-2]
    angle = math.atan2(last[1], last[0]) if yaw is None else yaw + (0.0 if sign > 0.0 else math.pi)
    beyond = np.arange(0.0, 2.0 * limits.lookahead, limits.step)
    x = np.concatenate((dense[0], points[-1, 0] + beyond * math.cos(angle)))
    y = np.concatenate((dense[1], points[-1, 1] + beyond * math.sin(angle)))
    return list(zip(x.tolist(), y.tolist(), strict=True))


def _pursue(
    pose: tuple[float, float, float], sign: float, line: list[tuple[float, float]], limits: _Limits, longest: float
) -> _Drive:
    """Pure pursuit of `line`, whose tail of two lookaheads lies beyond the end."""
    x, y, yaw = pose
    tail = math.ceil(2.0 * limits.lookahead / limits.step)
    end, ahead = max(1, len(line) - tail), math.ceil(limits.lookahead / limits.step)
    most = int(longest * len(line) + 2.0 * math.pi / (limits.curvature * limits.step))
    nearest, kappa, driven = 0, 0.0, [yaw]
    for count in range(most):
        nearest = _advanced(line, nearest, x, y)
        if nearest >= end and count > 3:
            break
        target = line[min(nearest + ahead, len(line) - 1)]
        kappa = _steered(kappa, (x, y, yaw), sign, target, limits)
        middle = yaw + 0.5 * kappa * limits.step
        x, y = x + sign * limits.step * math.cos(middle), y + sign * limits.step * math.sin(middle)
        yaw += kappa * limits.step
        driven.append(yaw)
    return _Drive(driven, max(1, len(driven) - 1) * limits.step, (x, y, yaw))


def _advanced(line: list[tuple[float, float]], nearest: int, x: float, y: float) -> int:
    """The nearest point from here on, without jumping past a farther one."""
    best = math.hypot(line[nearest][0] - x, line[nearest][1] - y)
    while nearest + 1 < len(line):
        following = math.hypot(line[nearest + 1][0] - x, line[nearest + 1][1] - y)
        if following > best:
            break
        nearest, best = nearest + 1, following
    return nearest


def _steered(
    kappa: float, pose: tuple[float, float, float], sign: float, target: tuple[float, float], limits: _Limits
) -> float:
    """Curvature of the arc through the target, within the limits."""
    dx, dy = target[0] - pose[0], target[1] - pose[1]
    heading = pose[2] + (0.0 if sign > 0.0 else math.pi)
    along, across = dx * math.cos(heading) + dy * math.sin(heading), dy * math.cos(heading) - dx * math.sin(heading)
    distance = max(math.hypot(dx, dy), 1e-6)
    # Behind the robot the arc through the target is too flat: turn as sharply as possible.
    wanted = 2.0 * across / distance**2 if along > 0.0 else math.copysign(limits.curvature, across)
    change = limits.rate * limits.step
    wanted = min(max(wanted, kappa - change), kappa + change)
    return min(max(wanted, -limits.curvature), limits.curvature)
