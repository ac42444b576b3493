"""Footprint of the robot as a polygon, with a parser of Nav2's syntax."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from optdock.errors import InvalidValue
from optdock.geometry.arrays import FrozenArrays, readonly
from optdock.geometry.checked import finite_number, positive
from optdock.geometry.lazy import cached_property
from optdock.geometry.polygon import convex_cover, convex_pieces, edge_planes, simple_polygon
from optdock.geometry.pose import displacement, normalize_angle
from optdock.geometry.separation import ConvexBody

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from optdock.geometry.arrays import FloatArray
    from optdock.geometry.pose import Pose2

__all__ = ["CORE_DEPTH", "Footprint", "convex_body"]

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_POINT = re.compile(rf"\[\s*({_NUMBER})[\s,]+({_NUMBER})\s*\]")
CORE_DEPTH = 2e-6  # [m]: distance of the core from the outline
_CORE_ARC = 4  # segments of a quarter circle in the outline of a core
_RADIUS_SIDES = 32  # of the polygon around a circle; its corners exceed the radius by 0.5 %


@dataclass(frozen=True, eq=False, repr=False)
class Footprint(FrozenArrays):
    """A simple polygon around the robot in the robot's frame (x forward, y left).

    Args:
        vertices: Shape (n, 2) [m], either orientation, n >= 3.

    Attributes:
        bodies: Convex pieces that exactly cover the polygon; a single piece if the polygon is convex.
        core: Convex pieces that cover all points at least `CORE_DEPTH` inside a non-convex polygon; empty for a convex
            polygon (see `optdock.verification.contact_tolerance`). Rounded corners of the core are approximated by
            chords that lie outside it, so the pieces contain the exact core, with an error of at most one hundredth of
            `CORE_DEPTH`.

    Raises:
        InvalidValue: If the polygon has fewer than three distinct vertices, no area, crossing edges or NaN.
    """

    vertices: FloatArray
    bodies: tuple[ConvexBody, ...] = field(init=False, repr=False)
    core: tuple[ConvexBody, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        vertices = simple_polygon(self.vertices, "footprint")
        bodies = tuple(convex_body(piece) for piece in convex_pieces(vertices))
        vars(self).update(vertices=vertices, bodies=bodies, core=_core(vertices) if len(bodies) > 1 else ())

    def __repr__(self) -> str:
        return f"<Footprint {self.length:.4g} m x {self.width:.4g} m, {len(self.vertices)} corners>"

    @classmethod
    def from_radius(cls, radius: float) -> Footprint:
        """Return the regular polygon of 32 sides circumscribed about the circle of `radius` [m], for a round robot.

        The distance of the corners from the centre exceeds the radius by 0.5 %. Sides face forward, left, backward and
        right, so length and width equal the diameter, and padding moves every side outwards by at least the padding.
        (Nav2's polygon is inscribed in the circle and therefore smaller than the robot.)

        Raises:
            InvalidValue: If the radius is not a finite number > 0.
        """
        angle = 2.0 * np.pi * (np.arange(_RADIUS_SIDES) + 0.5) / _RADIUS_SIDES
        # 1e-15 more than needed, so that rounding does not move a side into the circle.
        corner = positive(radius, "footprint.radius", "m") * (1.0 + 1e-15) / np.cos(np.pi / _RADIUS_SIDES)
        return cls(corner * np.column_stack((np.cos(angle), np.sin(angle))))

    @classmethod
    def from_string(cls, text: str) -> Footprint:
        """Parse Nav2's `"[[x, y], [x, y], ...]"`; separators are commas, spaces and tabs.

        Raises:
            InvalidValue: If the text is not a list of at least three pairs of numbers.
        """
        stripped = text.strip()
        points = _POINT.findall(stripped)
        skeleton = re.sub(r"[\s,]+", "", _POINT.sub("P", stripped))
        if skeleton != "[" + "P" * len(points) + "]" or not points:
            raise InvalidValue(f"footprint: must look like [[x, y], [x, y], [x, y], ...], got {text!r}")
        return cls(np.array(points, dtype=np.float64))

    @classmethod
    def rectangle(cls, front: float, rear: float, width: float) -> Footprint:
        """Return a rectangle from x = -rear to x = front [m], `width` [m] wide and centred in y.

        Raises:
            InvalidValue: If a number is not finite or the rectangle has no area.
        """
        sides = {"front": front, "rear": rear, "width": width}
        front, rear, width = (finite_number(value, f"footprint: {name}") for name, value in sides.items())
        half = 0.5 * width
        return cls(np.array([[front, half], [-rear, half], [-rear, -half], [front, -half]]))

    def padded(self, padding: float) -> Footprint:
        """Return the polygon with every vertex moved by sign(x) * padding and sign(y) * padding [m], as in Nav2."""
        return Footprint(self.vertices + padding * np.sign(self.vertices))

    @cached_property
    def length(self) -> float:
        """Extent along x [m]."""
        return float(np.ptp(self.vertices[:, 0]))

    @cached_property
    def width(self) -> float:
        """Extent along y [m]."""
        return float(np.ptp(self.vertices[:, 1]))

    @cached_property
    def circumscribed_radius(self) -> float:
        """Largest distance [m] of a point of the outline from the origin."""
        return float(np.max(np.hypot(self.vertices[:, 0], self.vertices[:, 1])))

    def displacement(self, pose: Pose2, reference: Pose2) -> float:
        """Return an upper bound of the distance [m] that a point of the outline moves from `reference` to `pose`."""
        turn = normalize_angle(pose.yaw - reference.yaw)
        return float(displacement(pose.distance_to(reference), turn, self.circumscribed_radius))

    @cached_property
    def inscribed_radius(self) -> float:
        """Smallest distance [m] of a point of the outline from the origin."""
        start, edge = self.vertices, np.roll(self.vertices, -1, axis=0) - self.vertices
        along = np.clip(-np.sum(start * edge, axis=1) / np.sum(edge**2, axis=1), 0.0, 1.0)
        nearest = start + along[:, None] * edge
        return float(np.min(np.hypot(nearest[:, 0], nearest[:, 1])))


def _core(vertices: FloatArray) -> tuple[ConvexBody, ...]:
    import shapely

    core = shapely.Polygon(vertices).buffer(-CORE_DEPTH, quad_segs=_CORE_ARC)
    return tuple(convex_body(piece) for piece in convex_cover(core))


def convex_body(piece: ArrayLike) -> ConvexBody:
    """Return a convex piece, Shape (n, 2) [m], with the normals and offsets of its edges."""
    vertices = np.array(piece, dtype=np.float64)
    normals, offsets = edge_planes(vertices)
    return ConvexBody(readonly(vertices), readonly(normals), readonly(offsets))
