"""Approximation of a footprint by a few discs within it: an obstacle that overlaps a disc overlaps the footprint."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.deadline import clock_name
from optdock.geometry.arrays import frozen

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.geometry.arrays import BoolArray, FloatArray
    from optdock.geometry.footprint import Footprint

__all__ = ["DiscCover", "disc_cover", "prepare_footprint"]

_FIT = 0.03  # largest distance of the outline from the discs, in radii of the largest disc
_SMALLER = 0.6  # ratio of the radii of successive discs in a corner
_SAMPLES, _FEWEST_SAMPLES = 160, 4  # of the outline that discs must cover, and of every edge
_SOME = 64  # samples of the outline per step
_ROWS = 8192  # pairs of a point and an edge per step, half a millisecond


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
    """Compute the discs of a footprint before a search for a proof needs them: 6 to 40 ms, once per footprint."""
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
    radius = _depth(points, outline, look)
    points, radius = points[radius > 0.0], radius[radius > 0.0]
    if radius.size == 0:  # a sliver of the outline between all discs
        points = np.stack([body.vertices.mean(axis=0) - centre for body in footprint.bodies])
        radius = _depth(points, outline, look)
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
    radius = np.concatenate((radius, _depth(corners, outline, look)))
    points, radius = points[radius > 0.0], radius[radius > 0.0]
    ends = np.roll(outline, -1, axis=0)
    per_edge = max(_FEWEST_SAMPLES, -(-_SAMPLES // len(outline)))
    share = np.linspace(0.0, 1.0, per_edge, endpoint=False)[:, None, None]
    samples = (outline + share * (ends - outline)).reshape(-1, 2)
    covers = np.empty((len(samples), len(points)), dtype=np.bool_)
    for i, sample in enumerate(samples):
        look()
        gap = np.hypot(*(sample - points).T) - radius
        covers[i] = gap <= _FIT * largest
        covers[i, gap.argmin()] = True
    chosen = _cover(covers, int(radius.argmax()), look)
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


def _depth(points: FloatArray, outline: FloatArray, look: Callable[[], None]) -> FloatArray:
    """Return the depth of points in a polygon, Shape (n,) [m]; at most 0 for points outside."""
    found, step = np.empty(len(points)), max(1, _ROWS // len(outline))
    start, end = outline, np.roll(outline, -1, axis=0)
    edge = end - start
    for k in range(0, len(points), step):
        look()
        some = points[k : k + step]
        to = some[:, None] - start
        along = np.clip((to * edge).sum(axis=2) / (edge * edge).sum(axis=1), 0.0, 1.0)
        distance = np.hypot(*(to - along[..., None] * edge).transpose(2, 0, 1)).min(axis=1)
        crosses = (start[:, 1] > some[:, 1:]) != (end[:, 1] > some[:, 1:])
        with np.errstate(divide="ignore", invalid="ignore"):
            at = start[:, 0] + (some[:, 1:] - start[:, 1]) / edge[:, 1] * edge[:, 0]
        inside = (crosses & (some[:, :1] < at)).sum(axis=1) % 2 == 1
        found[k : k + step] = np.where(inside, distance - 1e-9, -distance)
    return found
