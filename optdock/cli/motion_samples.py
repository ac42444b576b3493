"""What the samples of a timed motion disprove.

Samples cannot prove a motion, `optdock.verification.certify_trajectory` does that from its time law. But a file holds
samples only, and a sample beyond a limit, or two that no motion within the limits joins, refute it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

    from optdock.geometry.arrays import FloatArray
    from optdock.io.plan_file import TrajectoryColumns
    from optdock.limits import MotionLimits
    from optdock.path import Path
    from optdock.problem import DockingProblem

__all__ = ["motion_faults"]

_RELATIVE, _ABSOLUTE = 1e-6, 1e-9  # slack on every limit
_POSITION = 1e-3  # [m, rad]: how far samples may be off the path, and steps off their own speeds
_STILL = 1e-6  # [m/s]
_PROJECTIONS, _DRIFT = 4, 0.05  # steps, and the longest step [m], of moving samples along the path


def motion_faults(motion: TrajectoryColumns, path: Path, problem: DockingProblem) -> list[str]:
    """Every rule that the samples break, with the time at which they break it most.

    Args:
        motion: The samples.
        path: The path they claim to follow.
        problem: What must hold.
    """
    coarse = _too_coarse(motion, problem.robot.limits)
    if coarse:
        return [coarse]
    travelled = _travelled(motion, path)
    checks = (*_at_samples(motion, path, problem, travelled), *_between_samples(motion, problem, travelled))
    faults = [fault for name, values, limits in checks for fault in _worst(name, motion.t, values, limits)]
    return [*faults, *_rests(motion, path, problem, travelled), *_off_path(motion, path, travelled)]


def _too_coarse(motion: TrajectoryColumns, limits: MotionLimits) -> str:
    """Why the samples cannot be judged, the robot being anywhere within metres between two of them; empty if not so."""
    dt = float(np.max(np.diff(motion.t)))
    unsure = min(limits.max_jerk * dt**3 / 6.0, max(limits.max_speed, limits.max_reverse_speed) * dt)
    if unsure <= _PROJECTIONS * _DRIFT:
        return ""
    return f"samples up to {dt:.3g} s apart leave the motion between them open by {unsure:.3g} m; sample it finer"


def _worst(name: str, times: FloatArray, values: FloatArray, limits: FloatArray) -> Iterator[str]:
    """The value furthest beyond its limit, if any is."""
    i = int(np.argmax(values - limits))
    if values[i] > limits[i] * (1.0 + _RELATIVE) + _ABSOLUTE:
        yield f"{name}: {values[i]:.6g} at t = {times[i]:.3f} s, limit {limits[i]:.6g}"


def _steps(motion: TrajectoryColumns) -> FloatArray:
    """Distance between samples from speeds and accelerations; exact where the jerk is constant. Shape (n - 1,) [m]."""
    dt = np.diff(motion.t)
    gear = np.where(motion.speed[:-1] + motion.speed[1:] < 0.0, -1.0, 1.0)
    mean = 0.5 * (motion.speed[:-1] + motion.speed[1:])
    steps: FloatArray = gear * (dt * mean - dt**2 / 12.0 * np.diff(motion.acceleration))
    return steps


def _travelled(motion: TrajectoryColumns, path: Path) -> FloatArray:
    """Arc lengths at which the samples lie beside the path: summed steps, then moved along it. Shape (n,) [m]."""
    s = np.clip(np.concatenate(([0.0], np.cumsum(_steps(motion)))), 0.0, path.length)
    for _ in range(_PROJECTIONS):
        poses, gear = path.poses_at(s), path.direction_at(s)
        ahead = (motion.x - poses[:, 0]) * np.cos(poses[:, 2]) + (motion.y - poses[:, 1]) * np.sin(poses[:, 2])
        s = np.clip(s + gear * np.clip(ahead, -_DRIFT, _DRIFT), 0.0, path.length)
    return s


def _at_samples(
    motion: TrajectoryColumns, path: Path, problem: DockingProblem, travelled: FloatArray
) -> Iterator[tuple[str, FloatArray, FloatArray]]:
    """Name, values and limits, Shape (n,) each."""
    limits, zone, v = problem.robot.limits, problem.dock.approach, np.abs(motion.speed)
    bend = np.minimum(np.abs(path.curvature_at(travelled)), 1e9)
    forward = motion.speed >= 0.0
    braking = motion.acceleration * motion.speed < 0.0
    slow = travelled > path.length - zone.distance + _POSITION
    full = np.ones(v.size)
    yield "speed [m/s]", v, np.where(forward, limits.max_speed, limits.max_reverse_speed)
    yield "approach speed [m/s]", np.where(slow, v, 0.0), full * zone.speed
    bound = np.where(braking | (v <= _STILL), max(limits.max_deceleration, limits.max_acceleration), 0.0)
    bound = np.where(braking & (v > _STILL), limits.max_deceleration, np.maximum(bound, limits.max_acceleration))
    yield "acceleration [m/s^2]", np.abs(motion.acceleration), bound
    yield "jerk [m/s^3]", np.abs(motion.jerk), full * limits.max_jerk
    yield "yaw rate [rad/s]", np.maximum(np.abs(motion.yaw_rate), v * bend), full * limits.max_yaw_rate
    yield "yaw acceleration [rad/s^2]", np.abs(motion.yaw_acceleration), full * limits.max_yaw_acceleration
    yield "lateral acceleration [m/s^2]", v**2 * bend, full * limits.max_lateral_acceleration
    yield "wheel speed [m/s]", v * (1.0 + 0.5 * limits.track_width * bend), full * limits.max_wheel_speed


def _between_samples(
    motion: TrajectoryColumns, problem: DockingProblem, travelled: FloatArray
) -> Iterator[tuple[str, FloatArray, FloatArray]]:
    """Mean rates between samples; none can exceed the limit of the rate."""
    limits, dt = problem.robot.limits, np.diff(motion.t)
    fastest = max(limits.max_acceleration, limits.max_deceleration)
    full = np.ones(dt.size)
    # Differences of numbers near one another carry their rounding, divided by dt.
    rounding = 1e-12 / dt
    yield "mean acceleration [m/s^2]", np.abs(np.diff(motion.speed)) / dt - rounding, full * fastest
    yield "mean jerk [m/s^3]", np.abs(np.diff(motion.acceleration)) / dt - rounding, full * limits.max_jerk
    # Within a step the jerk may jump by twice its limit; so much can the distance differ from that of constant jerk.
    jumps = 2.0 * limits.max_jerk * dt**3 / 12.0
    yield "distance off its speeds [m]", np.abs(np.diff(travelled) - _steps(motion)), _POSITION + jumps


def _rests(motion: TrajectoryColumns, path: Path, problem: DockingProblem, travelled: FloatArray) -> Iterator[str]:
    if abs(motion.speed[0] - problem.start_speed) > _STILL:
        yield f"start speed: {motion.speed[0]:.6g} m/s, the robot drives {problem.start_speed:.6g} m/s"
    if abs(motion.speed[-1]) > _STILL:
        yield f"end: {motion.speed[-1]:.6g} m/s at t = {motion.t[-1]:.3f} s, must rest"
    for s in path.cusps:
        i = int(np.argmin(np.abs(travelled - s)))
        if abs(motion.speed[i]) > _STILL:
            yield f"cusp at s = {s:.3f} m: {motion.speed[i]:.6g} m/s at t = {motion.t[i]:.3f} s, must rest"


def _off_path(motion: TrajectoryColumns, path: Path, travelled: FloatArray) -> Iterator[str]:
    if abs(travelled[-1] - path.length) > _POSITION:
        yield f"travelled: {travelled[-1]:.4f} m, the path is {path.length:.4f} m long"
    poses = path.poses_at(travelled)
    apart = np.hypot(motion.x - poses[:, 0], motion.y - poses[:, 1])
    turned = np.abs(np.remainder(motion.yaw - poses[:, 2] + np.pi, 2.0 * np.pi) - np.pi)
    i = int(np.argmax(np.maximum(apart, turned)))
    if max(apart[i], turned[i]) > _POSITION:
        yield f"pose at t = {motion.t[i]:.3f} s is {apart[i]:.4g} m and {turned[i]:.4g} rad off the path"
