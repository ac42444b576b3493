"""First variables by driving: a robot with bounded curvature and curvature rate pursues the input path.

For inputs that no bounded curvature can follow (turns in place, a start that looks the wrong way), where curvatures
fitted to the input's headings and cut to the limit lead far away from it.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from smoothers._ck.rollout import Variables

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from smoothers._ck.closing import Bounds, Ends
    from smoothers._ck.layout import Layout

__all__ = ["pursued_variables"]

_STEP = 0.25  # of the smallest radius, at most
_LONGEST = 3.0  # times the input and a loop


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


def pursued_variables(layout: Layout, positions: FloatArray, ends: Ends, bounds: Bounds) -> Variables:
    """Curvatures and lengths of a drive along `positions`.

    Args:
        layout: Shape of the path.
        positions: The input at the nodes, Shape (num_nodes, 2) [m].
        ends: Start, target, gears.
        bounds: Of curvature and rate.
    """
    limit = float(bounds.upper[: layout.num_knots].max())
    headings, lengths = np.empty(layout.num_intervals), np.empty(layout.num_gears)
    pose = (float(ends.start[0]), float(ends.start[1]), float(ends.start[2]))
    for m in range(layout.num_gears):
        points = positions[layout.node_gear == m]
        spacing = float(np.hypot(*np.diff(points, axis=0).T).mean())
        step = min(max(spacing, 0.01), _STEP / limit)
        limits = _Limits(limit, bounds.rate, step, max(1.0 / limit, 4.0 * step))
        aim = ends.target[2] if m == layout.num_gears - 1 else None
        drive = _pursue(pose, float(ends.signs[m]), _extended(points, ends.signs[m], aim, limits), limits)
        mine = layout.interval_gear == m
        middle = (np.arange(mine.sum()) + 0.5) / mine.sum()
        headings[mine] = np.interp(middle * (len(drive.yaw) - 1.0), np.arange(len(drive.yaw)), drive.yaw)
        lengths[m], pose = drive.length, drive.pose
    # Curvatures at the few knots that reproduce the headings, not samples of the curvature: those would drift away.
    turned = layout.fit @ (headings - ends.start[2])
    return Variables(turned / layout.per_knot(lengths), lengths)


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


def _pursue(pose: tuple[float, float, float], sign: float, line: list[tuple[float, float]], limits: _Limits) -> _Drive:
    """Pure pursuit of `line`, whose tail of two lookaheads lies beyond the end."""
    x, y, yaw = pose
    tail = math.ceil(2.0 * limits.lookahead / limits.step)
    end, ahead = max(1, len(line) - tail), math.ceil(limits.lookahead / limits.step)
    most = int(_LONGEST * len(line) + 2.0 * math.pi / (limits.curvature * limits.step))
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
