"""Drawing of the scene: map, obstacles, dock, robot and camera view."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.pose import transform_points
from optdock.model.costs import LETHAL, NO_INFORMATION
from optdock.plotting.canvas import COLOURS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.colors import ListedColormap

    from optdock.geometry.arrays import FloatArray
    from optdock.geometry.footprint import Footprint
    from optdock.geometry.pose import Pose2
    from optdock.model.camera import Camera, RequiredView
    from optdock.model.costmap import Costmap
    from optdock.model.costs import CostArray
    from optdock.model.path import Path
    from optdock.model.problem import DockingProblem

__all__ = [
    "DRAWN_BY_THE_MAP",
    "OutlineStyle",
    "View",
    "camera_cone",
    "camera_outline",
    "draw_arrow",
    "draw_cone",
    "draw_footprints",
    "draw_scene",
    "draw_shapes",
    "draw_sweep",
    "draw_view",
    "view_cones",
    "view_of",
]

# Names of obstacles that are already visible in the drawn map.
DRAWN_BY_THE_MAP = ("map", "unknown", "map border")
_GREYS = {"free": 255, "unknown": 225, "occupied": 70}
_MAP_ORDER = 0.8  # above the grid, below all other elements
_SLIMMEST = 0.55  # least ratio of the sides, so that obstacles next to a straight path and a legend have room
_CONES = 4  # number of cones along the path; more cones would hide each other
_BEYOND = 1.08  # length of a drawn cone divided by the distance of the marker, or by the minimum range
_ARC = 0.05  # [rad]: largest angle between the points of an arc
_MARGIN = 0.6  # [m]: margin around the content
_CLOSE_BY = 1.0  # [m]: parts of obstacles within this distance are included


class View(NamedTuple):
    """Visible rectangle of a picture [m]."""

    left: float
    right: float
    bottom: float
    top: float

    def figure_size(self, width: float = 9.0, tallest: float = 9.0) -> tuple[float, float]:
        """Return the figure size [inch] for the view with equal axes and room for labels."""
        ratio = (self.top - self.bottom) / (self.right - self.left)
        return (width, width * ratio + 0.9) if width * ratio <= tallest else (tallest / ratio + 0.9, tallest)


def view_of(problem: DockingProblem, paths: Sequence[FloatArray]) -> View:
    """Return a view that contains the robot along every path, Shape (n, 3) each, the dock, and nearby obstacles.

    Only the near part of a long obstacle is included; cells of the map do not widen the view.
    """
    outline = problem.robot.footprint.vertices
    ends = np.array([problem.start.as_array(), problem.goal.as_array()])
    points = [transform_points(poses, outline).reshape(-1, 2) for poses in (*paths, ends)]
    if problem.dock.footprint is not None:
        points.append(transform_points(ends[1:], problem.dock.footprint.vertices)[0])
    everything = np.vstack(points)
    lower, upper = everything.min(axis=0) - _CLOSE_BY, everything.max(axis=0) + _CLOSE_BY
    near = problem.obstacles.in_box(lower, upper)
    everything = np.vstack((everything, *(np.clip(corners, lower, upper) for corners in (near.lower, near.upper))))
    middle, half = 0.5 * (everything.min(axis=0) + everything.max(axis=0)), 0.5 * np.ptp(everything, axis=0) + _MARGIN
    half = np.maximum(half, _SLIMMEST * half.max())
    (left, bottom), (right, top) = middle - half, middle + half
    return View(float(left), float(right), float(bottom), float(top))


def draw_scene(axes: Axes, problem: DockingProblem, view: View) -> None:
    """Draw the map, the obstacles and the dock on axes in metres with equal scales."""
    if problem.costmap is not None:
        _draw_map(axes, problem.costmap, view)
    _draw_obstacles(axes, problem, view)
    axes.set_aspect("equal")
    axes.set_xlim(view.left, view.right)
    axes.set_ylim(view.bottom, view.top)
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.grid(visible=True, color="#dddddd", linewidth=0.5, zorder=0.5)
    axes.set_axisbelow(True)


def _draw_map(axes: Axes, costmap: Costmap, view: View) -> None:
    grey = np.full(costmap.data.shape, _GREYS["free"], dtype=np.uint8)
    grey[costmap.data == NO_INFORMATION] = _GREYS["unknown"]
    grey[costmap.data == LETHAL] = _GREYS["occupied"]
    (x0, y0), (x1, y1) = costmap.lower, costmap.upper
    axes.set_facecolor(str(_GREYS["unknown"] / 255.0))  # also outside the map
    axes.fill([x0, x1, x1, x0], [y0, y0, y1, y1], color="white", zorder=0.0)
    axes.imshow(
        grey,
        cmap=_greys(),
        vmin=0,
        vmax=255,
        origin="lower",
        extent=(x0, x1, y0, y1),
        interpolation="nearest",
        zorder=_MAP_ORDER,
    )
    shown = _in_view(costmap, view)
    is_beyond = view.left < x0 or view.right > x1 or view.bottom < y0 or view.top > y1
    is_unknown = bool(np.any(shown == NO_INFORMATION))
    unknown = {
        (True, False): "map, unknown",
        (False, True): "beyond the map",
        (True, True): "unknown or beyond the map",
    }
    labels = {
        "occupied": "map, occupied" if np.any(shown == LETHAL) else "",
        "unknown": unknown.get((is_unknown, is_beyond), ""),
    }
    for name, label in labels.items():
        if label:
            axes.plot([], [], "s", color=str(_GREYS[name] / 255.0), markersize=9, label=label)


def _greys() -> ListedColormap:
    """Return grey values as colours; free cells are transparent, so the grid below remains visible."""
    from matplotlib.colors import ListedColormap

    return ListedColormap(
        [(grey / 255.0, grey / 255.0, grey / 255.0, float(grey < _GREYS["free"])) for grey in range(256)]
    )


def _in_view(costmap: Costmap, view: View) -> CostArray:
    """Return the costs of the cells in the view; the array may be empty."""
    (x0, y0), side = costmap.lower, costmap.resolution
    rows, columns = (
        slice(max(0, int((low - start) / side)), max(0, int((high - start) / side) + 1))
        for low, high, start in ((view.bottom, view.top, y0), (view.left, view.right, x0))
    )
    return costmap.data[rows, columns]


def _draw_obstacles(axes: Axes, problem: DockingProblem, view: View) -> None:
    from matplotlib.collections import PolyCollection

    lower, upper = np.array([view.left, view.bottom]), np.array([view.right, view.top])
    obstacles = problem.all_obstacles.in_box(lower, upper)
    hidden = DRAWN_BY_THE_MAP if problem.costmap is not None else ()
    for colour, label, wanted in (("obstacle", "obstacle", False), ("dock", "dock", True)):
        rows = [
            row
            for row in range(len(obstacles))
            if obstacles.name_of(row) not in hidden and (obstacles.name_of(row) == "dock") is wanted
        ]
        if rows:
            shapes = [obstacles.vertices[row] for row in rows]
            axes.add_collection(
                PolyCollection(shapes, facecolor=COLOURS[colour], edgecolor=COLOURS[colour], label=label, zorder=1)
            )


class OutlineStyle(NamedTuple):
    """Style of polygons."""

    edge: str = "none"
    face: str = "none"
    width: float = 1.0
    alpha: float = 1.0
    line: str = "-"
    order: float = 2.0
    label: str = ""


def draw_footprints(axes: Axes, footprint: Footprint, poses: FloatArray, style: OutlineStyle) -> None:
    """Draw the outline of the robot at every pose, Shape (n, 3)."""
    draw_shapes(axes, list(transform_points(poses, footprint.vertices)), style)


def draw_shapes(axes: Axes, shapes: Sequence[FloatArray], style: OutlineStyle) -> None:
    """Draw polygons, Shape (k, 2) each."""
    from matplotlib.collections import PolyCollection

    outlines = PolyCollection(
        shapes,
        facecolor=style.face,
        edgecolor=style.edge,
        linewidth=style.width,
        linestyle=style.line,
        alpha=style.alpha,
        zorder=style.order,
        label=style.label or None,
    )
    axes.add_collection(outlines)


def draw_sweep(axes: Axes, footprint: Footprint, poses: FloatArray) -> None:
    """Draw the area swept by the outline through poses, Shape (n, 3), and the outlines."""
    blue = COLOURS["robot"]
    draw_footprints(axes, footprint, poses, OutlineStyle(face=blue, alpha=0.12))
    draw_footprints(axes, footprint, poses, OutlineStyle(edge=blue, width=0.6, order=2.1))


def draw_arrow(axes: Axes, pose: Pose2, length: float, colour: str, label: str) -> None:
    """Draw the position and the heading of a pose."""
    tip = (pose.x + length * np.cos(pose.yaw), pose.y + length * np.sin(pose.yaw))
    axes.annotate(
        "",
        xy=tip,
        xytext=(pose.x, pose.y),
        arrowprops={"arrowstyle": "-|>", "color": colour, "linewidth": 2.2, "mutation_scale": 16},
        zorder=6,
    )
    axes.plot([pose.x], [pose.y], "o", color=colour, markersize=6, label=label, zorder=6)


def draw_view(axes: Axes, view: RequiredView, path: Path | None) -> None:
    """Draw the marker, and camera cones along the part of the path where the marker must be in view."""
    axes.plot(
        *view.marker, "*", color=COLOURS["goal"], markeredgecolor="black", markersize=13, label="marker", zorder=6.5
    )
    stretch = None if path is None else view.stretch(path)
    if path is None or stretch is None:
        return
    cones = view_cones(view, path)
    label = f"camera, must see the marker from s = {stretch[0]:.2f} m to {stretch[1]:.2f} m"
    draw_shapes(axes, cones, OutlineStyle(face=COLOURS["goal"], alpha=0.10, order=1.2))
    draw_shapes(axes, cones, OutlineStyle(edge=COLOURS["goal"], width=0.9, alpha=0.8, order=1.3, label=label))


def view_cones(view: RequiredView, path: Path) -> list[FloatArray]:
    """Return camera cones along the part of a path where the marker must be in view, Shape (n, 2) each [m]."""
    stretch = view.stretch(path)
    return [] if stretch is None else [camera_cone(view, pose) for pose in path.poses_at(np.linspace(*stretch, _CONES))]


def draw_cone(axes: Axes, view: RequiredView, pose: FloatArray) -> None:
    """Draw the camera cone at a pose of the robot, Shape (3,), from which the marker is not in view."""
    style = OutlineStyle(edge=COLOURS["hot"], width=1.4, line="--", order=6.4, label="camera there")
    draw_shapes(axes, [camera_cone(view, pose)], style)


def camera_cone(view: RequiredView, pose: FloatArray) -> FloatArray:
    """Return the outline of the camera's cone at a pose of the robot, Shape (n, 2) [m]."""
    seen = camera_outline(view.camera, float(view.margins(pose[None]).distance[0]))
    outline: FloatArray = transform_points(pose[None], seen)[0]
    return outline


def camera_outline(camera: Camera, distance: float) -> FloatArray:
    """Return the outline of a camera's cone in the frame of the robot, a little beyond a distance. Shape (n, 2) [m]."""
    reach = min(camera.max_range, max(_BEYOND * distance, _BEYOND * camera.min_range))
    outline: FloatArray = transform_points(camera.mount.as_array()[None], _sector(camera, reach))[0]
    return outline


def _sector(camera: Camera, reach: float) -> FloatArray:
    """Return the outline of the cone in the camera's frame, from the minimum range to `reach` [m]. Shape (n, 2) [m]."""
    half = 0.5 * camera.field_of_view
    angles = np.linspace(-half, half, max(2, math.ceil(2.0 * half / _ARC)))
    arc = np.column_stack((np.cos(angles), np.sin(angles)))
    inner = (
        camera.min_range * arc[::-1] if camera.min_range > 0.0 else np.zeros((0 if camera.sees_all_around else 1, 2))
    )
    return np.vstack((reach * arc, inner))
