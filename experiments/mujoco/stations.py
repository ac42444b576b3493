"""Docking stations for contact simulation: a flat contact plate, and a V that fits a nose on the robot.

Both are outlines in the docked robot's frame, as for `Dock.footprint`: planning, certificate and physics use the same
polygon.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from optdock.errors import InvalidValue
from optdock.geometry.checked import finite_number
from optdock.geometry.footprint import Footprint
from optdock.model.dock import DockDirection

__all__ = ["VShape", "flat_station"]


def flat_station(
    robot: Footprint, *, width: float = 0.4, depth: float = 0.1, direction: DockDirection = DockDirection.FORWARD
) -> Footprint:
    """Return a plate across the robot's front, or rear, in contact with the docked robot.

    Args:
        robot: Outline of the robot.
        width: Width of the plate, centred on the robot's axis [m].
        depth: Depth of the plate along that axis [m].
        direction: Docking gear, forward or backward.

    Raises:
        InvalidValue: If a size is not > 0, or the direction is auto.
    """
    half, depth = 0.5 * _positive(width, "width"), _positive(depth, "depth")
    gear = _gear(direction)
    front = float(np.max(gear * robot.vertices[:, 0]))
    plate = [[front, -half], [front + depth, -half], [front + depth, half], [front, half]]
    return Footprint(np.array(plate) * (gear, 1.0))


class VShape(NamedTuple):
    """A V that opens towards the robot, and the nose that fits it.

    Attributes:
        half_angle: Angle between the axis and either wing [rad].
        mouth: Half the distance between the ends of the wings [m]: largest lateral offset at which the nose is caught.
        wall: Thickness of the station around the V [m]. The nose is wider than the mouth by this on either side, so
            that it touches the wings before the robot's front does.
        direction: Docking gear, forward or backward; the nose is at that end.
    """

    half_angle: float = math.radians(45.0)
    mouth: float = 0.12
    wall: float = 0.04
    direction: DockDirection = DockDirection.FORWARD

    def with_nose(self, front: float, rear: float, width: float) -> Footprint:
        """Return a rectangular robot with the nose in the middle of its front, or rear.

        Args:
            front: Distance from the axle to the front, without the nose [m].
            rear: Distance from the axle to the rear, without the nose [m].
            width: Width of the robot [m], at least that of the nose.

        Raises:
            InvalidValue: If the V is invalid, or the nose is wider than the robot.
        """
        self._check()
        half, base = 0.5 * finite_number(width, "footprint: width"), self.mouth + self.wall
        if half < base:
            raise InvalidValue(f"station: the nose of {2.0 * base:g} m is wider than the robot of {width:g} m")
        gear = _gear(self.direction)
        near, far = (front, rear) if gear > 0.0 else (rear, front)
        nose = [[near, -base], [near + base / math.tan(self.half_angle), 0.0], [near, base]]
        outline = [[-far, half], [-far, -half], [near, -half], *nose, [near, half]]
        return Footprint(np.array(outline) * (gear, 1.0))

    def station(self, robot: Footprint) -> Footprint:
        """Return the V around the nose of a docked robot made by `with_nose`.

        Raises:
            InvalidValue: If the V is invalid.
        """
        self._check()
        gear = _gear(self.direction)
        apex = float(np.max(gear * robot.vertices[:, 0]))
        mouth, back = apex - self.mouth / math.tan(self.half_angle), apex + self.wall
        half = self.mouth + self.wall
        wings = [[mouth, self.mouth], [apex, 0.0], [mouth, -self.mouth]]
        outline = [*wings, [mouth, -half], [back, -half], [back, half], [mouth, half]]
        return Footprint(np.array(outline) * (gear, 1.0))

    def _check(self) -> None:
        for name in ("mouth", "wall"):
            _positive(getattr(self, name), name)
        if not 0.0 < finite_number(self.half_angle, "station.half_angle") < 0.5 * math.pi:
            raise InvalidValue(f"station.half_angle: must be > 0 and < pi / 2 rad, got {self.half_angle}")


def _gear(direction: DockDirection) -> float:
    if direction is DockDirection.AUTO:
        raise InvalidValue("station.direction: must be forward or backward, got auto")
    return 1.0 if direction is DockDirection.FORWARD else -1.0


def _positive(value: float, name: str) -> float:
    checked = finite_number(value, f"station.{name}")
    if not checked > 0.0:
        raise InvalidValue(f"station.{name}: must be > 0 m, got {value}")
    return checked
