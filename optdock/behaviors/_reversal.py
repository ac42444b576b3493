"""A path driven the other way: the same poses, gears exchanged."""

from __future__ import annotations

from typing import TYPE_CHECKING

from optdock.geometry.clothoid import ClothoidSpline
from optdock.path import Path
from optdock.segments import ClothoidSegment, Direction, PolylineSegment

if TYPE_CHECKING:
    from optdock.segments import Segment

__all__ = ["reversed_path"]


def reversed_path(path: Path) -> Path:
    """The path from its end to its start; every pose is the same, so its clearance is too.

    With s' = length - s the gear changes its sign and so does the curvature along the travel.
    """
    return Path(tuple(_reversed_segment(segment) for segment in reversed(path.segments)), path.frame)


def _reversed_segment(segment: Segment) -> Segment:
    if isinstance(segment, ClothoidSegment):
        spline = segment.spline
        knots = (spline.length - spline.knots)[::-1]
        return ClothoidSegment(ClothoidSpline(spline.end, knots, -spline.curvature[::-1], -spline.sign))
    assert isinstance(segment, PolylineSegment)  # a path holds no other kind
    return PolylineSegment(segment.poses[::-1], Direction(-segment.direction))
