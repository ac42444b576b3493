"""Visibility: the proof that the marker of the dock is in the camera's view on every point of a stretch of a path.

Equation C20 of docs/theory/certificate.md defines the position q of the marker in the robot frame and the bound M of
|q''|. The mount of the camera is a rigid transform and preserves these norms. Over a stretch from a known pose the
margins to the edges of the cone and to the range limits are bounded by (C21). The bounds are concave, so they are
smallest at one of the two ends. A cone of at most half a turn is the intersection of two half-planes, and both bounds
apply. A wider cone is a union of half-planes whose normals lie between the normals of its two edges. The half-plane
that attains the signed distance at the known pose therefore gives a valid lower bound everywhere.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from optdock.deadline import never_late
from optdock.model.path import PolylineSegment
from optdock.verification.certificate import TOLERANCE, Violation
from optdock.verification.motion_bounds import Cells, PathMotion

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.geometry.arrays import FloatArray
    from optdock.model.camera import Camera, RequiredView
    from optdock.model.path import Path
    from optdock.model.problem import DockingProblem
    from optdock.verification.motion_bounds import CellEnds, CellMotion, Nodes

__all__ = ["ViewProof", "prove_view"]

_MAX_STEP = 0.1  # [m], length of first cells: some twenty on the last two metres
_MOST_FIRST = 100_000  # first cells; they are longer on longer stretches
_ROUNDING = 1e-9  # [m] of arc lengths that are summed in another order
_MAX_LEVELS = 24  # of bisection: cells of 6 nanometres
_MAX_POSES = 60_000  # added by bisection


class ViewProof(NamedTuple):
    """Result of the proof; its truth value tells whether it holds.

    Attributes:
        margin: Proven lower bound of the margin of the marker in the view on the stretch [m]; not sharp, because cells
            are bisected only until they are proven. If poses violate the rule, the value is the smallest margin found;
            if no view is required, the value is inf.
        violations: The worst violating pose, or the worst cell given up; empty if the proof holds.
    """

    margin: float
    violations: tuple[Violation, ...]

    def __bool__(self) -> bool:
        return not self.violations


def prove_view(path: Path, problem: DockingProblem, is_late: Callable[[], bool] = never_late) -> ViewProof:
    """Prove that the marker is in view where the dock of `problem` requires it, or find the pose that violates it.

    Args:
        path: The path to check.
        problem: The problem, see `DockingProblem.required_view`.
        is_late: Polled after every round of cells, which takes well below a millisecond. Once it is True, open cells
            are given up.
    """
    view = problem.required_view
    stretch = view.stretch(path) if view is not None else None
    if view is None or stretch is None:
        return ViewProof(np.inf, ())
    motion = PathMotion(path)
    cells = _clipped(motion, stretch)
    budget, level, margin = cells.first.size + _MAX_POSES, 0, np.inf
    while True:
        ends = cells.ends()
        nodes = motion.nodes(ends.segment, ends.u)
        broken = _broken(view, problem, nodes)
        if broken is not None:
            return broken
        bounds = motion.bounds(cells, nodes.poses[ends.first], nodes.poses[ends.last])
        lowest = _lowest_margins(view, nodes, ends, bounds)
        distances = (bounds.farthest(ends, one) for one in _distances(problem, view, nodes.poses))
        required = problem.required_view_margin(*distances)
        proven = lowest >= required - TOLERANCE  # NaN is not proven
        margin = min(margin, float(np.min(lowest[proven], initial=np.inf)))
        left = np.flatnonzero(~proven)
        budget -= nodes.s.size
        if left.size == 0:
            return ViewProof(margin, ())
        if level >= _MAX_LEVELS or budget <= 0 or is_late():
            k = left[np.argmin((lowest - required)[left])]
            return _unproven(float(nodes.s[ends.first[k]]), float(required[k] - lowest[k]), min(margin, lowest[k]))
        cells, level = cells.rows(left).cut(2), level + 1


def _clipped(motion: PathMotion, stretch: tuple[float, float]) -> Cells:
    """Return cells of the motion that exactly cover a stretch of the path."""
    path, (begin, end) = motion.path, stretch
    cells = motion.cells(max(_MAX_STEP, path.length / _MOST_FIRST))
    first, last = cells.first.copy(), cells.last.copy()
    for i, (segment, start) in enumerate(zip(path.segments, path.segment_starts[:-1].tolist(), strict=True)):
        # Steps that only turn have one arc length; rounding must not exclude them.
        low, high = begin - start - _ROUNDING, end - start + _ROUNDING
        if isinstance(segment, PolylineSegment):  # by pose number, so that turning steps are included
            low, high = _pose_number(segment, low, "left"), _pose_number(segment, high, "right")
        own = cells.segment == i
        first[own], last[own] = np.clip(first[own], low, high), np.clip(last[own], low, high)
    kept = np.flatnonzero(last > first)
    return Cells(cells.segment[kept], first[kept], last[kept])


def _pose_number(segment: PolylineSegment, s: float, side: Literal["left", "right"]) -> float:
    """Return the first (`left`) or the last (`right`) parameter of a polyline at an arc length [m], clipped."""
    knots = segment.knots
    i = int(np.searchsorted(knots, s, side=side))
    if i in (0, knots.size):
        return float(min(i, knots.size - 1))
    before, after = float(knots[i - 1]), float(knots[i])
    return i - 1 + (s - before) / (after - before)


def _broken(view: RequiredView, problem: DockingProblem, nodes: Nodes) -> ViewProof | None:
    """Return the result for the pose that violates the rule most, or None if no pose violates it."""
    found = view.margins(nodes.poses)
    required = problem.required_view_margin(*_distances(problem, view, nodes.poses))
    short = required - found.smallest
    k = int(np.argmax(short)) if short.size else -1
    if k < 0 or short[k] <= TOLERANCE:
        return None
    worst, s = view.worst(found, k, float(required[k])), float(nodes.s[k])
    message = f"the dock leaves the camera's view at s = {s:.3f} m: {worst}"
    if required[k] > 0.0:
        message += f", with {required[k]:.4f} m kept for the tube about the path"
    where = {
        "pose": nodes.poses[k].tolist(),
        "quantity": worst.name,
        "unit": worst.unit,
        "value": worst.value,
        "limit": worst.limit,
        "margin": float(found.smallest[k]),
        "required": float(required[k]),
    }
    return ViewProof(float(found.smallest[k]), (Violation("view", message, s, worst.excess, where),))


def _unproven(s: float, short: float, margin: float) -> ViewProof:
    message = f"the camera's view of the dock near s = {s:.4f} m cannot be proven; the bound is {short:.3g} m short"
    return ViewProof(margin, (Violation("unproven", message, s, short),))


def _distances(problem: DockingProblem, view: RequiredView, poses: FloatArray) -> tuple[FloatArray, ...]:
    """Return the distances of poses from the goal, the start and the marker, Shape (n,) [m] each."""
    points = (problem.goal.as_array()[:2], problem.start.as_array()[:2], view.marker)
    return tuple(np.hypot(*(poses[:, :2] - point).T) for point in points)


class _Advance(NamedTuple):
    """Stretches of motion from known poses: position and motion of the marker in the camera frame.

    `point`, `velocity`: q and q' in the camera frame, Shape (n, 2); `width` in u, and `bend`, the bound M of |q''|,
    Shape (n,).
    """

    point: FloatArray
    velocity: FloatArray
    width: FloatArray
    bend: FloatArray

    def linear(self, normal: FloatArray) -> FloatArray:
        """Return the smallest n.q over the stretches, for normals of Shape (n, 2) or (2,). Shape (n,) [m]."""
        here = np.sum(normal * self.point, axis=1)
        gained = self.width * np.sum(normal * self.velocity, axis=1) - self.stray
        smallest: FloatArray = here + np.minimum(0.0, gained)
        return smallest

    @property
    def stray(self) -> FloatArray:
        """Largest deviation of q from linear motion. Shape (n,) [m]."""
        stray: FloatArray = 0.5 * self.bend * self.width**2
        return stray


def _lowest_margins(view: RequiredView, nodes: Nodes, ends: CellEnds, bounds: CellMotion) -> FloatArray:
    """Return lower bounds of the margin over cells; each half is bounded from the pose at its end of the cell."""
    halves = (
        _advance(view, nodes.poses[ends.first], bounds.velocity_first, bounds),
        _advance(view, nodes.poses[ends.last], -bounds.velocity_last, bounds),
    )
    first, last = (_lowest(view.camera, half) for half in halves)
    return np.minimum(first, last)


def _advance(view: RequiredView, poses: FloatArray, velocity: FloatArray, bounds: CellMotion) -> _Advance:
    """Return the motion of the marker over half of each cell, from poses with d pose / du = `velocity`."""
    width = 0.5 * bounds.width
    yaw, turning = poses[:, 2], velocity[:, 2]
    c, s = np.cos(yaw), np.sin(yaw)
    dx, dy = view.marker[0] - poses[:, 0], view.marker[1] - poses[:, 1]
    x, y = c * dx + s * dy, c * dy - s * dx  # q in the robot's frame
    moved_x = turning * y - c * velocity[:, 0] - s * velocity[:, 1]
    moved_y = -turning * x - c * velocity[:, 1] + s * velocity[:, 0]
    mount = view.camera.mount
    to_camera = np.array([[np.cos(mount.yaw), -np.sin(mount.yaw)], [np.sin(mount.yaw), np.cos(mount.yaw)]])
    farthest = np.hypot(x, y) + bounds.speed * width
    bend = farthest * bounds.twist + 2.0 * bounds.turn * bounds.speed + bounds.bend
    velocity_seen = np.column_stack((moved_x, moved_y)) @ to_camera
    return _Advance(view.camera.points_seen(poses, view.marker), velocity_seen, width, bend)


def _lowest(camera: Camera, advance: _Advance) -> FloatArray:
    """Return the smallest of the bounds (C21). Shape (n,) [m]."""
    point, moved = advance.point, advance.width[:, None] * advance.velocity
    distance = np.hypot(point[:, 0], point[:, 1])
    farthest = np.maximum(distance, np.hypot(*(point + moved).T) + advance.stray)
    lowest: FloatArray = np.minimum(_lowest_in_cone(camera, advance), camera.max_range - farthest)
    if camera.min_range > 0.0:
        outward = point / np.maximum(distance, np.finfo(np.float64).tiny)[:, None]
        lowest = np.minimum(lowest, advance.linear(outward) - camera.min_range)
    return lowest


def _lowest_in_cone(camera: Camera, advance: _Advance) -> FloatArray:
    """Return the smallest distance to the edges of the cone. Shape (n,) [m]."""
    if camera.sees_all_around:
        return np.full(advance.width.size, np.inf)
    half = 0.5 * camera.field_of_view
    if half <= 0.5 * np.pi:
        edges = (np.array([np.sin(half), side * np.cos(half)]) for side in (1.0, -1.0))
        left, right = (advance.linear(edge) for edge in edges)
        return np.minimum(left, right)
    most = half - 0.5 * np.pi
    bearing = np.clip(np.arctan2(advance.point[:, 1], advance.point[:, 0]), -most, most)
    return advance.linear(np.column_stack((np.cos(bearing), np.sin(bearing))))
