"""The smooth control law of Nav2's Graceful controller and docking server ([Park2011]), as pure functions.

It steers by the pose error in polar coordinates and knows neither a largest curvature nor an acceleration; here it is
the baseline to beat.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from optdock.geometry.pose import Twist2, normalize_angle
from optdock.model.path import Direction

if TYPE_CHECKING:
    from optdock.geometry.pose import Pose2

__all__ = ["EgocentricPose", "GracefulLaw", "egocentric"]

_ARRIVED = 1e-9  # [m]: the line of sight to a target this near has no direction


class EgocentricPose(NamedTuple):
    """A target in polar coordinates.

    `r`: distance [m]. `phi`, `delta`: headings of the target and of the robot, relative to the line of sight [rad].
    """

    r: float
    phi: float
    delta: float


def egocentric(target: Pose2, robot: Pose2, direction: Direction = Direction.FORWARD) -> EgocentricPose:
    """The target seen along the line of sight; in reverse the line of sight is looked along backwards."""
    dx, dy = target.x - robot.x, target.y - robot.y
    sight = math.atan2(direction * dy, direction * dx)
    return EgocentricPose(math.hypot(dx, dy), normalize_angle(target.yaw - sight), normalize_angle(robot.yaw - sight))


@dataclass(frozen=True)
class GracefulLaw:
    """Curvature and speed from an egocentric pose.

    curvature = -(k_delta (delta - atan(-k_phi phi)) + (1 + k_phi / (1 + (k_phi phi)^2)) sin(delta)) / r,
    speed = v_max / (1 + beta |curvature|^lambda), at most v_max r / slowdown_radius and sqrt(2 r deceleration_max),
    at least v_min; the yaw rate is cut to v_angular_max and the speed with it.

    Args:
        k_phi: Ratio of the rates of phi and r.
        k_delta: Convergence of the heading to the slow manifold.
        beta: How much curvature slows down.
        lambda_: Exponent of the same.
        slowdown_radius: Distance below which the speed falls linearly [m].
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
        """Curvature [1/m] along the travel; 0 at the target itself."""
        if pose.r < _ARRIVED:
            return 0.0
        manifold = math.atan(-self.k_phi * pose.phi)
        slope = 1.0 + self.k_phi / (1.0 + (self.k_phi * pose.phi) ** 2)
        return -(self.k_delta * (pose.delta - manifold) + slope * math.sin(pose.delta)) / pose.r

    def command(self, target: Pose2, robot: Pose2, direction: Direction = Direction.FORWARD) -> Twist2:
        """The velocity towards `target`; linear is negative in reverse."""
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
