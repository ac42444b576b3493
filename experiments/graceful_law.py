"""Smooth control law of Nav2's Graceful controller and docking server ([Park2011]), as pure functions.

The law steers by the pose error in polar coordinates, without limits of curvature or acceleration. It is the baseline
of the experiments.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from optdock.geometry.pose import Pose2, Twist2, normalize_angle
from optdock.model.path import Direction

__all__ = ["NAV2_LAW", "EgocentricPose", "GracefulLaw", "egocentric", "nav2_command", "nav2_filtered", "random_starts"]

_ARRIVED = 1e-9  # [m]: the line of sight to a target at a smaller distance has no defined direction


class EgocentricPose(NamedTuple):
    """Target pose in polar coordinates.

    `r`: distance [m]. `phi`, `delta`: headings of the target and of the robot, relative to the line of sight [rad].
    """

    r: float
    phi: float
    delta: float


def egocentric(target: Pose2, robot: Pose2, direction: Direction = Direction.FORWARD) -> EgocentricPose:
    """Return the target relative to the line of sight, which is reversed for backward motion."""
    dx, dy = target.x - robot.x, target.y - robot.y
    sight = math.atan2(direction * dy, direction * dx)
    return EgocentricPose(math.hypot(dx, dy), normalize_angle(target.yaw - sight), normalize_angle(robot.yaw - sight))


@dataclass(frozen=True)
class GracefulLaw:
    """Graceful control law: curvature and speed from an egocentric pose.

    curvature = -(k_delta (delta - atan(-k_phi phi)) + (1 + k_phi / (1 + (k_phi phi)^2)) sin(delta)) / r, speed = v_max
    / (1 + beta |curvature|^lambda), at most v_max r / slowdown_radius and sqrt(2 r deceleration_max), at least v_min;
    the yaw rate is limited to v_angular_max, and the speed is scaled with it.

    Args:
        k_phi: Ratio of the rates of phi and r.
        k_delta: Gain of the convergence of the heading to the slow manifold.
        beta: Gain of the slowdown with curvature.
        lambda_: Exponent of the slowdown with curvature.
        slowdown_radius: Distance below which the speed decreases linearly [m].
        deceleration_max: [m/s^2].
        v_linear_min: [m/s].
        v_linear_max: [m/s].
        v_angular_max: [rad/s].
    """

    k_phi: float = 2.0
    k_delta: float = 1.0
    beta: float = 0.4
    lambda_: float = 2.0
    slowdown_radius: float = 1.5
    deceleration_max: float = 2.5
    v_linear_min: float = 0.1
    v_linear_max: float = 0.5
    v_angular_max: float = 1.0

    def curvature(self, pose: EgocentricPose) -> float:
        """Return the curvature along the direction of travel [1/m]; 0 at the target."""
        if pose.r < _ARRIVED:
            return 0.0
        manifold = math.atan(-self.k_phi * pose.phi)
        slope = 1.0 + self.k_phi / (1.0 + (self.k_phi * pose.phi) ** 2)
        return -(self.k_delta * (pose.delta - manifold) + slope * math.sin(pose.delta)) / pose.r

    def command(self, target: Pose2, robot: Pose2, direction: Direction = Direction.FORWARD) -> Twist2:
        """Return the velocity command towards `target`; the linear velocity is negative in reverse."""
        pose = egocentric(target, robot, direction)
        curvature = self.curvature(pose)
        speed = self.v_linear_max / (1.0 + self.beta * abs(curvature) ** self.lambda_)
        near = self.v_linear_max * pose.r / self.slowdown_radius if self.slowdown_radius > 0.0 else math.inf
        braking = math.sqrt(2.0 * pose.r * self.deceleration_max)
        speed = min(max(min(speed, near, braking), self.v_linear_min), self.v_linear_max)
        angular = min(max(curvature * speed, -self.v_angular_max), self.v_angular_max)
        if curvature != 0.0:
            speed = angular / curvature
        return Twist2(direction * speed, angular)


NAV2_LAW = GracefulLaw(3.0, 2.0, 0.4, 2.0, 0.25, 2.5, 0.1, 0.25, 0.75)
"""The law with the default parameters of Nav2's docking server."""

_PROJECTION = 0.25  # [m]: distance of the server's target behind the dock
_FILTER = 0.1  # the server's filter_coef of detected poses
_SPREAD, _TURN = 0.25, 0.25  # [m], [rad]: default tolerances of Nav2's SimpleGoalChecker


def nav2_command(dock: Pose2, robot: Pose2, direction: Direction = Direction.FORWARD) -> Twist2:
    """Return the velocity command of Nav2's docking server towards a dock."""
    return NAV2_LAW.command(dock @ Pose2(int(direction) * _PROJECTION, 0.0, 0.0), robot, direction)


def nav2_filtered(before: Pose2, seen: Pose2) -> Pose2:
    """Return the dock pose of Nav2's first-order filter after a detection."""
    return Pose2(
        before.x + _FILTER * (seen.x - before.x),
        before.y + _FILTER * (seen.y - before.y),
        before.yaw + _FILTER * normalize_angle(seen.yaw - before.yaw),
    )


def random_starts(count: int, staging: float) -> list[Pose2]:
    """Return poses uniform in a disc around the staging pose, `staging` [m] before the dock at the origin.

    The headings are uniform around the heading of the dock; the same count gives the same poses.
    """
    random = np.random.default_rng(1)
    radius, angle = _SPREAD * np.sqrt(random.uniform(size=count)), random.uniform(-math.pi, math.pi, count)
    turn = random.uniform(-_TURN, _TURN, count)
    columns = (radius * np.cos(angle) - staging, radius * np.sin(angle), turn)
    return [Pose2(*row) for row in np.column_stack(columns).tolist()]
