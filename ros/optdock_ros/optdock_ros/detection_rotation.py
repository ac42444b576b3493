"""Rotation from a detection to the dock, whose convention depends on the distribution of Nav2.

Up to Kilted, Nav2 turns about the fixed axes z (yaw), x (roll) and y (pitch), in this order; since Lyrical about x, y
and z (Nav2 #6047). The results are equal if the yaw is zero, or roll and pitch are; otherwise they differ by up to half
a turn.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from optdock.errors import InvalidValue
from optdock.nav2.declared_parameters import DISTRIBUTIONS
from optdock.ros.transforms import quaternion_product

if TYPE_CHECKING:
    from collections.abc import Mapping

    from optdock.ros.transforms import Quaternion

__all__ = ["detection_rotation", "distribution_of"]

_YAW_FIRST = DISTRIBUTIONS[: DISTRIBUTIONS.index("lyrical")]
_EQUAL = 1e-3  # [rad] between the two conventions, below the error of a detection


def distribution_of(environment: Mapping[str, str]) -> str:
    """Return Nav2's distribution of a ROS environment; empty if it is unknown."""
    name = environment.get("ROS_DISTRO", "").lower()
    name = "main" if name == "rolling" else name
    return name if name in DISTRIBUTIONS else ""


def detection_rotation(roll: float, pitch: float, yaw: float, distribution: str) -> Quaternion:
    """Return the rotation from a detection to the dock, as x, y, z, w.

    Args:
        roll: Angle about x [rad].
        pitch: Angle about y [rad].
        yaw: Angle about z [rad].
        distribution: Distribution of Nav2; empty if it is unknown.

    Raises:
        InvalidValue: If the distribution is unknown and the conventions differ.
    """
    about_x, about_y, about_z = (_turn(axis, angle) for axis, angle in enumerate((roll, pitch, yaw)))
    yaw_first = quaternion_product(about_y, quaternion_product(about_x, about_z))
    roll_first = quaternion_product(about_z, quaternion_product(about_y, about_x))
    cosine = abs(sum(a * b for a, b in zip(yaw_first, roll_first, strict=True)))
    apart = 2.0 * math.acos(min(1.0, cosine))
    if not distribution and apart > _EQUAL:
        raise InvalidValue(
            f"external_detection_rotation_*: roll {roll:g}, pitch {pitch:g} and yaw {yaw:g} rad mean rotations "
            f"{apart:.3g} rad apart up to Kilted and since Lyrical, and ROS_DISTRO is none of "
            f"{', '.join(DISTRIBUTIONS[:-1])}, rolling: set nav2_distribution"
        )
    return yaw_first if distribution in _YAW_FIRST else roll_first


def _turn(axis: int, angle: float) -> Quaternion:
    """Return the rotation about x (0), y (1) or z (2)."""
    part = [0.0, 0.0, 0.0]
    part[axis] = math.sin(0.5 * angle)
    return part[0], part[1], part[2], math.cos(0.5 * angle)
