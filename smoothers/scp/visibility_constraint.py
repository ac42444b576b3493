"""Visibility constraint: the camera's view contains the dock's marker at the nodes of the path's last stretch.

A margin is the distance [m] by which the marker would have to move in the camera's frame to leave the view. Margins
have the unit of clearances, so the shortfalls and rows of both can be combined. Every edge of the view gives one row
per node. The edges are the two half-planes of a cone of at most half a turn, or the nearest half-plane of a wider cone,
and the circles of the smallest and the largest range. Between two nodes a margin falls below its chord by an eighth of
its second difference, to leading order; the margins at the nodes are reduced by that amount. The two ends of the
stretch lie between nodes, and their poses are extrapolated from the previous node.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.arrays import readonly
from optdock.geometry.lazy import cached_property
from optdock.kernels import Kernel, twin_of
from smoothers.scp.collision.linearization import ClearanceRows
from smoothers.scp.rollout import sensitivity

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray, IntArray
    from optdock.model.camera import RequiredView
    from optdock.model.problem import DockingProblem
    from smoothers.scp.basis import Basis
    from smoothers.scp.rollout import Rollout, Sensitivity, Variables

__all__ = ["SeenPlaces", "ViewBound", "linearized_view", "view_along"]

_KERNEL = Kernel("optdock_seen_along", sizes=3, numbers=1)
_SAME_PLACE = 1e-9  # [m]: rounding of the places where the stretch begins and ends


@dataclass(frozen=True, eq=False)
class ViewBound:
    """The required view along a path."""

    view: RequiredView  # camera, marker and stretch
    problem: DockingProblem  # whole problem, whose start and goal determine the required margin
    signs: FloatArray  # gears, Shape (num_gears,)
    after: float  # distance from the last node to the goal [m]: the final straight, and later pieces of the path
    reach: float  # larger margins have no row [m]

    @cached_property
    def packed(self) -> FloatArray:
        """Stretch, marker and camera, see `View` in the kernel."""
        view, camera, mount = self.view, self.view.camera, self.view.camera.mount
        stretch = view.visible_distance, view.blind_distance, self.after
        limits = 0.5 * camera.field_of_view, camera.min_range, camera.max_range
        return readonly(np.array((*stretch, *view.marker, mount.x, mount.y, mount.yaw, *limits)))

    @cached_property
    def num_edges(self) -> int:
        """Number of edges of the view."""
        camera = self.view.camera
        cone = 0 if camera.sees_all_around else 1 if camera.field_of_view > np.pi else 2
        return cone + (camera.min_range > 0.0) + bool(np.isfinite(camera.max_range))


class SeenPlaces(NamedTuple):
    """Marker and view margins at positions along a path."""

    node: IntArray  # node before each position, Shape (p,)
    ahead: FloatArray  # distance of the position from that node [m], Shape (p,); 0 at nodes
    poses: FloatArray  # Shape (p, 3)
    seen: FloatArray  # marker in the robot's frame, Shape (p, 2) [m]
    normals: FloatArray  # gradient of each margin by the marker in the robot's frame, Shape (edges, p, 2)
    margin: FloatArray  # margin of every edge above the requirement and the loss between nodes, Shape (edges, p) [m]


def view_along(bound: ViewBound, basis: Basis, variables: Variables, rollout: Rollout) -> SeenPlaces:
    """Return the view at the positions along the path where it is required."""
    found, problem = _seen_along(bound, basis, variables, rollout), bound.problem
    tube = problem.robot.tracking
    if tube.cross == 0.0 and tube.yaw == 0.0:
        return found
    to_ends = [np.hypot(*(found.poses[:, :2] - at.as_array()[:2]).T) for at in (problem.goal, problem.start)]
    required = problem.required_view_margin(to_ends[0], to_ends[1], np.hypot(*found.seen.T))
    return found._replace(margin=found.margin - required)


def _seen_natively(bound: ViewBound, basis: Basis, variables: Variables, rollout: Rollout) -> SeenPlaces:
    gears, nodes, edges = basis.num_gears, basis.num_nodes, bound.num_edges
    node, out, work = np.empty(nodes + 2, dtype=np.int64), np.empty((6 + 3 * edges) * (nodes + 2)), (3 + edges) * nodes
    arrays = (
        (basis.divisions, 2 * gears),
        (bound.packed, bound.packed.size),
        (bound.signs, gears),
        (variables.lengths, gears),
        (rollout.packed, 4 * nodes + 6 * basis.num_intervals),
        (node, nodes + 2),
        (out, out.size),
        (np.empty(work), work),
    )
    p = _KERNEL((gears, nodes, edges), (_SAME_PLACE,), arrays)
    ahead, poses, seen, normals, margin, _ = np.split(out, np.cumsum((p, 3 * p, 2 * p, 2 * edges * p, edges * p)))
    shaped = poses.reshape(p, 3), seen.reshape(p, 2), normals.reshape(edges, p, 2), margin.reshape(edges, p)
    return SeenPlaces(node[:p], ahead, *shaped)


@twin_of(_seen_natively)
def _seen_along(bound: ViewBound, basis: Basis, variables: Variables, rollout: Rollout) -> SeenPlaces:
    """Return the result of `view_along` without the margin that the tracking tube requires."""
    node, ahead = _places(bound.view, _left_to_drive(bound, basis, variables))
    poses = _driven_on(bound, basis, rollout, node, ahead)
    seen, normals, margin = _edges(bound.view, poses)
    lost = _lost_between(basis, _edges(bound.view, rollout.poses)[2])
    return SeenPlaces(node, ahead, poses, seen, normals, margin - lost[:, node])


def linearized_view(
    bound: ViewBound, basis: Basis, variables: Variables, rollout: Rollout, places: SeenPlaces
) -> ClearanceRows | None:
    """Return one linearized constraint per margin smaller than `bound.reach`, or None if no margin is."""
    edge, place = np.nonzero(places.margin < bound.reach)
    if not edge.size:
        return None
    by_place = _sensitivity(bound, basis, rollout, sensitivity(basis, variables, rollout), places)
    cosine, sine = np.cos(places.poses[place, 2]), np.sin(places.poses[place, 2])
    normal, seen = places.normals[edge, place], places.seen[place]
    # d seen / d x = (-cos, sin), d seen / d y = (-sin, -cos), d seen / d yaw = (y, -x)
    gradient = (sine * normal[:, 1] - cosine * normal[:, 0])[:, None] * by_place[0][place]
    gradient -= (sine * normal[:, 0] + cosine * normal[:, 1])[:, None] * by_place[1][place]
    gradient += (normal[:, 0] * seen[:, 1] - normal[:, 1] * seen[:, 0])[:, None] * by_place[2][place]
    rows = ClearanceRows(gradient, places.margin[edge, place], places.node[place])
    return rows.subset(np.abs(gradient).max(axis=1, initial=0.0) > _SAME_PLACE)  # the start is given


def _left_to_drive(bound: ViewBound, basis: Basis, variables: Variables) -> FloatArray:
    """Return the distance from each node to the end of the path, in decreasing order, Shape (num_nodes,) [m]."""
    lengths = variables.lengths
    later = np.append(np.cumsum(lengths[::-1])[::-1][1:], 0.0)
    left: FloatArray = (1.0 - basis.fraction) * lengths[basis.node_gear] + later[basis.node_gear] + bound.after
    return left


def _places(view: RequiredView, left: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the nodes and the two ends of the stretch: nodes, and distances after them, Shape (p,) each."""
    far, near = view.visible_distance, view.blind_distance
    inside = np.flatnonzero((left <= far + _SAME_PLACE) & (left >= near - _SAME_PLACE))
    between = [edge for edge in (far, near) if left[-1] < edge < left[0]]
    before = [int(np.flatnonzero(left >= edge)[-1]) for edge in between]
    ahead = [left[node] - edge for node, edge in zip(before, between, strict=True)]
    return np.append(inside, np.array(before, dtype=np.int64)), np.append(np.zeros(inside.size), ahead)


def _driven_on(bound: ViewBound, basis: Basis, rollout: Rollout, node: IntArray, ahead: FloatArray) -> FloatArray:
    """Return poses at distances after the nodes, extrapolated with the curvature at the nodes. Shape (p, 3)."""
    sign = bound.signs[basis.node_gear[node]]
    turn = ahead * rollout.curvature[node]
    x, y, yaw = rollout.poses[node].T
    middle = yaw + 0.5 * turn
    return np.column_stack((x + sign * ahead * np.cos(middle), y + sign * ahead * np.sin(middle), yaw + turn))


def _edges(view: RequiredView, poses: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the marker in the robot frame (n, 2), and inward normals (edges, n, 2) and margins (edges, n)."""
    camera, mount = view.camera, view.camera.mount
    point = camera.points_seen(poses, view.marker)
    c, s = np.cos(mount.yaw), np.sin(mount.yaw)
    turned = np.array([[c, s], [-s, c]])  # transforms row vectors from the camera's frame into the robot's
    distance = np.maximum(np.hypot(*point.T), 1e-9)
    outward = point / distance[:, None]
    normals, margins = _cone(view, point)
    if camera.min_range > 0.0:
        normals.append(outward)
        margins.append(distance - camera.min_range)
    if np.isfinite(camera.max_range):
        normals.append(-outward)
        margins.append(camera.max_range - distance)
    seen: FloatArray = point @ turned + [mount.x, mount.y]
    shape = len(margins), len(poses)
    return seen, np.reshape(normals, (*shape, 2)) @ turned, np.reshape(margins, shape)


def _cone(view: RequiredView, point: FloatArray) -> tuple[list[FloatArray], list[FloatArray]]:
    """Return the inward normals (n, 2) and the margins (n,) of the edges of the cone, in the camera's frame."""
    if view.camera.sees_all_around:
        return [], []
    half = 0.5 * view.camera.field_of_view
    if half <= 0.5 * np.pi:
        edges = [np.tile([np.sin(half), side * np.cos(half)], (len(point), 1)) for side in (1.0, -1.0)]
    else:
        most = half - 0.5 * np.pi
        bearing = np.clip(np.arctan2(point[:, 1], point[:, 0]), -most, most)
        edges = [np.column_stack((np.cos(bearing), np.sin(bearing)))]
    return edges, [np.sum(edge * point, axis=1) for edge in edges]


def _lost_between(basis: Basis, margin: FloatArray) -> FloatArray:
    """Return the loss of the margins, Shape (edges, n), in the intervals next to each node, to leading order [m]."""
    lost = np.zeros_like(margin)
    inner = np.flatnonzero((basis.fraction > 0.0) & (basis.fraction < 1.0))
    lost[:, inner] = np.maximum(margin[:, inner - 1] - 2.0 * margin[:, inner] + margin[:, inner + 1], 0.0) / 8.0
    return lost


def _sensitivity(
    bound: ViewBound, basis: Basis, rollout: Rollout, by: Sensitivity, places: SeenPlaces
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the derivatives of the poses at the positions with respect to the variables, Shape (p, size) each.

    The distance of an end of the stretch from its node changes by the same amount as the remaining length at that node.
    """
    node, ahead = places.node, places.ahead
    between = np.flatnonzero(ahead > 0.0)
    x, y, yaw = by.x[node], by.y[node], by.yaw[node]
    if between.size:
        node, ahead = node[between], ahead[between, None]
        gear, sign = basis.node_gear[node], bound.signs[basis.node_gear[node]][:, None]
        further = np.zeros((between.size, basis.size))
        gears = np.arange(basis.num_gears)
        further[:, basis.num_knots :] = np.where(gears > gear[:, None], 1.0, 0.0)
        further[np.arange(between.size), basis.num_knots + gear] = 1.0 - basis.fraction[node]
        turning = np.zeros((between.size, basis.size))
        turning[:, : basis.num_knots] = basis.node_curvatures[node]
        bend = rollout.curvature[node][:, None]
        swing = ahead * turning + bend * further
        middle = places.poses[between, 2:] - 0.5 * ahead * bend
        turned = yaw[between] + 0.5 * swing
        x[between] += sign * (further * np.cos(middle) - ahead * np.sin(middle) * turned)
        y[between] += sign * (further * np.sin(middle) + ahead * np.cos(middle) * turned)
        yaw[between] += swing
    return x, y, yaw
