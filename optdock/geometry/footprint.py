"""The robot's outline, in Nav2's syntax."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from optdock.errors import InvalidValue
from optdock.geometry.arrays import FrozenArrays, readonly
from optdock.geometry.checked import finite_number, number
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
CORE_DEPTH = 2e-6  # [m]: how deep within the outline the core begins
_CORE_ARC = 4  # segments of a quarter circle in the outline of a core
_RADIUS_SIDES = 32  # of the polygon around a circle: it sticks out by at most 0.5 % of the radius


@dataclass(frozen=True, eq=False, repr=False)
class Footprint(FrozenArrays):
    """A simple polygon around the robot, in its own frame (x forward, y left).

    Args:
        vertices: Shape (n, 2) [m], either orientation, n >= 3.

    Attributes:
        bodies: The convex pieces that cover exactly the polygon; one when it is convex.
        core: Convex pieces of what lies at least `CORE_DEPTH` inside a polygon that is not convex, which is not seen
            piece by piece (`optdock.verification.contact_tolerance`); none when it is convex. Arcs of its outline are
            chords inside the removed rim, so a core is never too small, but for one hundredth of `CORE_DEPTH`.

    Raises:
        InvalidValue: Fewer than three distinct vertices, no area, crossing edges, NaN.
    """

    vertices: FloatArray
    bodies: tuple[ConvexBody, ...] = field(init=False, repr=False)
    core: tuple[ConvexBody, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        vertices = simple_polygon(self.vertices, "footprint")
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "bodies", tuple(convex_body(piece) for piece in convex_pieces(vertices)))
        object.__setattr__(self, "core", _core(vertices) if len(self.bodies) > 1 else ())

    def __repr__(self) -> str:
        return f"<Footprint {self.length:.4g} m x {self.width:.4g} m, {len(self.vertices)} corners>"

    @classmethod
    def from_radius(cls, radius: float) -> Footprint:
        """A round robot: the regular polygon of 32 sides around the circle of `radius` [m].

        The circle is inside and touches the middle of every side; at the corners the polygon sticks out by 0.5 % of
        the radius. Sides face forward, left, backward and right, so length and width are those of the circle, and
        padding moves every side outwards by at least the padding. (Nav2's polygon has its corners on the circle and is
        smaller than the robot.)

        Raises:
            InvalidValue: The radius is not a positive number.
        """
        checked = number(radius, "footprint.radius")
        if not (np.isfinite(checked) and checked > 0.0):
            raise InvalidValue(f"footprint.radius: must be > 0 m, got {radius}")
        angle = 2.0 * np.pi * (np.arange(_RADIUS_SIDES) + 0.5) / _RADIUS_SIDES
        corner = checked * (1.0 + 1e-15) / np.cos(np.pi / _RADIUS_SIDES)  # beyond what rounding takes away
        return cls(corner * np.column_stack((np.cos(angle), np.sin(angle))))

    @classmethod
    def from_string(cls, text: str) -> Footprint:
        """Nav2's `"[[x, y], [x, y], ...]"`; commas, spaces and tabs separate.

        Raises:
            InvalidValue: Anything but a list of at least three pairs of numbers.
        """
        stripped = text.strip()
        points = _POINT.findall(stripped)
        skeleton = re.sub(r"[\s,]+", "", _POINT.sub("P", stripped))
        if skeleton != "[" + "P" * len(points) + "]" or not points:
            raise InvalidValue(f"footprint: must look like [[x, y], [x, y], [x, y], ...], got {text!r}")
        return cls(np.array(points, dtype=np.float64))

    @classmethod
    def rectangle(cls, front: float, rear: float, width: float) -> Footprint:
        """A rectangle from x = -rear to x = front [m], `width` [m] wide and centred in y.

        Raises:
            InvalidValue: A number is not finite, or the outline no polygon.
        """
        sides = {"front": front, "rear": rear, "width": width}
        front, rear, width = (finite_number(value, f"footprint: {name}") for name, value in sides.items())
        half = 0.5 * width
        return cls(np.array([[front, half], [-rear, half], [-rear, -half], [front, -half]]))

    def padded(self, padding: float) -> Footprint:
        """Every vertex moved by sign(x) * padding and sign(y) * padding [m], as Nav2 does."""
        return Footprint(self.vertices + padding * np.sign(self.vertices))

    @property
    def length(self) -> float:
        """Extent along x [m]."""
        return float(np.ptp(self.vertices[:, 0]))

    @property
    def width(self) -> float:
        """Extent along y [m]."""
        return float(np.ptp(self.vertices[:, 1]))

    @property
    def circumscribed_radius(self) -> float:
        """Largest distance of an outline point from the origin [m]."""
        return float(np.max(np.hypot(self.vertices[:, 0], self.vertices[:, 1])))

    def displacement(self, pose: Pose2, reference: Pose2) -> float:
        """How far any point of the outline is at most from where it would be at the reference [m]."""
        turn = normalize_angle(pose.yaw - reference.yaw)
        return float(displacement(pose.distance_to(reference), turn, self.circumscribed_radius))

    @property
    def inscribed_radius(self) -> float:
        """Smallest distance of an outline point from the origin [m]."""
        start, edge = self.vertices, np.roll(self.vertices, -1, axis=0) - self.vertices
        along = np.clip(-np.sum(start * edge, axis=1) / np.sum(edge**2, axis=1), 0.0, 1.0)
        nearest = start + along[:, None] * edge
        return float(np.min(np.hypot(nearest[:, 0], nearest[:, 1])))


def _core(vertices: FloatArray) -> tuple[ConvexBody, ...]:
    import shapely

    core = shapely.Polygon(vertices).buffer(-CORE_DEPTH, quad_segs=_CORE_ARC)
    return tuple(convex_body(piece) for piece in convex_cover(core))


def convex_body(piece: ArrayLike) -> ConvexBody:
    """A convex piece, Shape (n, 2) [m], with the planes of its edges."""
    vertices = np.array(piece, dtype=np.float64)
    normals, offsets = edge_planes(vertices)
    return ConvexBody(readonly(vertices), readonly(normals), readonly(offsets))
