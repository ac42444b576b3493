"""Approximation of a footprint by a few discs within it: an obstacle that overlaps a disc overlaps the footprint."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.deadline import clock_name
from optdock.geometry.arrays import frozen
from optdock.kernels import Kernel, twin_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.geometry.arrays import BoolArray, FloatArray
    from optdock.geometry.footprint import Footprint

__all__ = ["DiscCover", "disc_cover", "prepare_footprint"]

_FIT = 0.03  # largest distance of the outline from the discs, in radii of the largest disc
_SMALLER = 0.6  # ratio of the radii of successive discs in a corner
_SAMPLES, _FEWEST_SAMPLES = 160, 4  # of the outline that discs must cover, and of every edge
_SOME, _FEW = 64, 16  # samples of the outline per step
_ROWS = 8192  # pairs of a point and an edge per step, half a millisecond
_ROUNDING = 1e-9  # [m]: larger than the rounding errors of depths


class DiscCover(NamedTuple):
    """Discs within a footprint: a centre (2,), discs (n, 3), and the extent of the body from the centre [m]."""

    centre: FloatArray
    discs: FloatArray
    reach: float

    @property
    def largest_disc(self) -> DiscCover:
        """Cover by the largest disc alone, which does not depend on the heading."""
        x, y, radius = self.discs[0].tolist()
        return DiscCover(self.centre + np.array([x, y]), np.array([(0.0, 0.0, radius)]), radius)

    @property
    def turns(self) -> bool:
        """Whether the heading of the robot matters."""
        return bool(self.discs[:, :2].any())


@functools.lru_cache(maxsize=16)
def _bodies(footprint: Footprint) -> list[DiscCover]:  # noqa: ARG001 - the key
    """Return the cached list of the discs of a footprint, which is empty until the discs are computed."""
    return []


def disc_cover(footprint: Footprint, look: Callable[[], None]) -> DiscCover:
    """Return the discs of a footprint, computed once.

    `look` is called every few milliseconds, except on a counted clock, which must not depend on earlier calls. An
    exception raised by `look` is passed on, and no result is cached.
    """
    kept = _bodies(footprint)
    if not kept:
        kept.append(_discs_within(footprint, look if clock_name() != "counted" else lambda: None))
    return kept[0]


def prepare_footprint(footprint: Footprint) -> None:
    """Compute the discs of a footprint before a search for a proof needs them: 2 to 10 ms, once per footprint."""
    disc_cover(footprint, lambda: None)


def _discs_within(footprint: Footprint, look: Callable[[], None]) -> DiscCover:
    """Return a few discs that fill a footprint up to `_FIT`, chosen greedily by the covered part of the outline."""
    outline = footprint.vertices
    centre = 0.5 * (outline.min(axis=0) + outline.max(axis=0))
    outline = outline - centre
    reach = float(np.hypot(*outline.T).max())
    step = np.linspace(-reach, reach, 61)
    points = np.stack(np.meshgrid(step, step), axis=-1).reshape(-1, 2)
    points = np.vstack((points, 0.0 * points[:1]))
    radius = _depths(points, outline, look)
    points, radius = points[radius > 0.0], radius[radius > 0.0]
    if radius.size == 0:  # a sliver of the outline between all discs
        points = np.stack([body.vertices.mean(axis=0) - centre for body in footprint.bodies])
        radius = _depths(points, outline, look)
    largest = radius.max()
    # Ever smaller discs in every corner, along the line from the corner on which the depth grows fastest.
    inward = np.empty_like(outline)
    for i, corner in enumerate(outline):
        look()
        along = points - corner
        inward[i] = along[(radius / np.hypot(*along.T)).argmax()]
    shares = _SMALLER ** np.arange(1, 12)
    corners = (outline[:, None] + shares[:, None] * inward[:, None]).reshape(-1, 2)
    points = np.vstack((points, corners))
    radius = np.concatenate((radius, _depths(corners, outline, look)))
    points, radius = points[radius > 0.0], radius[radius > 0.0]
    ends = np.roll(outline, -1, axis=0)
    per_edge = max(_FEWEST_SAMPLES, -(-_SAMPLES // len(outline)))
    share = np.linspace(0.0, 1.0, per_edge, endpoint=False)[:, None, None]
    samples = (outline + share * (ends - outline)).reshape(-1, 2)
    covers = []
    for k in range(0, len(samples), _FEW):
        look()
        covers.append(_covered(samples[k : k + _FEW], points, radius, float(_FIT * largest)))
    chosen = _cover(np.concatenate(covers), int(radius.argmax()), look)
    return frozen(DiscCover(centre, np.column_stack((points, radius))[chosen], reach))


def _cover(covers: BoolArray, first: int, look: Callable[[], None]) -> list[int]:
    """Return columns of which at least one is true in every row, chosen greedily by the number of new rows."""
    chosen, left, gains = [first], np.ones(len(covers), dtype=np.bool_), covers.sum(axis=0)
    while True:
        newly = np.flatnonzero(left & covers[:, chosen[-1]])
        left[newly] = False
        for k in range(0, newly.size, _SOME):
            look()
            gains -= covers[newly[k : k + _SOME]].sum(axis=0)
        if not left.any():
            return chosen
        chosen.append(int(gains.argmax()))


def _depths(points: FloatArray, outline: FloatArray, look: Callable[[], None]) -> FloatArray:
    """Return the depth of points in a polygon, Shape (n,) [m]; `look` is called every half a millisecond."""
    found, step = np.empty(len(points)), max(1, _ROWS // len(outline))
    for k in range(0, len(points), step):
        look()
        found[k : k + step] = _depth(points[k : k + step], outline)
    return found


_DEPTHS = Kernel("optdock_depths", sizes=2, numbers=1)
_COVERED = Kernel("optdock_covered", sizes=2, numbers=1)


def _depth_native(points: FloatArray, outline: FloatArray) -> FloatArray:
    n, corners, depth = len(points), len(outline), np.empty(len(points))
    arrays = (np.ascontiguousarray(points), 2 * n), (np.ascontiguousarray(outline), 2 * corners), (depth, n)
    _DEPTHS((n, corners), (_ROUNDING,), arrays)
    return depth


@twin_of(_depth_native)
def _depth(points: FloatArray, outline: FloatArray) -> FloatArray:
    """Return the depth of points in a polygon, Shape (n,) [m]; minus the distance from the polygon for points outside.

    `points`: Shape (n, 2). `outline`: corners in order, Shape (k, 2) [m].
    """
    start, end = outline, np.roll(outline, -1, axis=0)
    (ex, ey), (tx, ty) = (end - start).T, np.moveaxis(points[:, None] - start, 2, 0)
    along = np.clip((tx * ex + ty * ey) / (ex * ex + ey * ey), 0.0, 1.0)
    dx, dy = tx - along * ex, ty - along * ey
    distance = np.sqrt((dx * dx + dy * dy).min(axis=1))
    crosses = (start[:, 1] > points[:, 1:]) != (end[:, 1] > points[:, 1:])
    with np.errstate(divide="ignore", invalid="ignore"):
        at = start[:, 0] + ty / ey * ex
    inside = (crosses & (points[:, :1] < at)).sum(axis=1) % 2 == 1
    depth: FloatArray = np.where(inside, distance - _ROUNDING, -distance)
    return depth


def _covered_native(samples: FloatArray, points: FloatArray, radius: FloatArray, tolerance: float) -> BoolArray:
    m, n = len(samples), len(points)
    covers = np.empty((m, n), dtype=np.int64)
    arrays = (
        (np.ascontiguousarray(samples), 2 * m),
        (np.ascontiguousarray(points), 2 * n),
        (radius, n),
        (covers, m * n),
    )
    _COVERED((m, n), (tolerance,), arrays)
    return covers.astype(np.bool_)


@twin_of(_covered_native)
def _covered(samples: FloatArray, points: FloatArray, radius: FloatArray, tolerance: float) -> BoolArray:
    """Return which discs cover samples of the outline up to a tolerance [m]; the nearest disc always does.

    `samples`: Shape (m, 2). `points`: centres of the discs, Shape (n, 2) [m]. `radius`: Shape (n,) [m]. Returns a mask,
    Shape (m, n).
    """
    dx, dy = np.moveaxis(samples[:, None] - points, 2, 0)
    gap = np.sqrt(dx * dx + dy * dy) - radius
    covers: BoolArray = gap <= tolerance
    covers[np.arange(len(samples)), gap.argmin(axis=1)] = True
    return covers
