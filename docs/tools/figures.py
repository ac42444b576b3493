"""The figures of the tutorial and the theory, drawn by the library from real plans: `python docs/tools/figures.py`.

Each is written twice, for light and for dark pages, as SVG into `docs/assets/`. `make docs` does not draw them:
a figure changes only when what it shows changes.
"""

from __future__ import annotations

import itertools
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
import shapely
from matplotlib.figure import Figure

import optdock as od
from optdock.geometry.pose import transform_points
from optdock.plotting.canvas import COLOURS
from optdock.timing.forward_backward import forward_backward_pass
from optdock.timing.motion import State
from optdock.timing.path_limits import ReferenceBounds, limits_along
from optdock.verification import pose_clearances

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.axes import Axes

    from optdock.geometry.arrays import FloatArray

ASSETS = Path(__file__).resolve().parents[1] / "assets"
_LEGEND: dict[str, Any] = {"frameon": False, "loc": "lower center", "bbox_to_anchor": (0.5, 1.0), "ncols": 3}
_INK = {"light": "#333333", "dark": "#d6d8de"}
_ROBOT = od.Robot(
    od.Footprint.rectangle(0.45, 0.45, 0.6),
    od.MotionLimits(
        max_speed=0.8, max_acceleration=0.5, max_deceleration=0.5, max_jerk=1.0,
        max_yaw_rate=0.6, max_yaw_acceleration=0.6, max_curvature=1.5, max_curvature_rate=6.0,
    ),
)  # fmt: skip
_STATION = [(0.47, -0.4), (0.65, -0.4), (0.65, 0.4), (0.47, 0.4)]
_DOCK = od.Dock(
    od.Pose2(4.0, 1.0, 0.0), od.Footprint(_STATION), final_straight=0.3, approach_speed=0.1, approach_distance=0.3
)
_OBSTACLES = [
    [(1.6, 1.05), (2.5, 1.05), (2.5, 1.5), (1.6, 1.5)],
    [(2.75, -0.5), (3.6, -0.5), (3.6, 0.28), (2.75, 0.28)],
    [(0.2, 0.1), (0.43, 0.1), (0.43, 0.5), (0.2, 0.5)],
]


def problem() -> od.DockingProblem:
    """Between two boxes into a dock, from a start that is closer to a third one than required."""
    clearance = od.ClearanceRule(required=0.05, at_dock=0.0, taper=0.6)
    return od.DockingProblem(od.Pose2(0.9, 0.36, 0.0), _DOCK, _ROBOT, _OBSTACLES, clearance=clearance)


def draw_taper(axes: Axes, plan: od.DockPlan) -> None:
    """Clearance along the path, and what is required of it: relief at the start, taper at the dock."""
    given, path = plan.problem, plan.path
    s = np.linspace(0.0, path.length, 600)
    poses = path.poses_at(s)
    clear, _ = pose_clearances(poses, given.robot.footprint, given.all_obstacles)
    away = [np.hypot(*(poses[:, :2] - end.as_array()[:2]).T) for end in (given.goal, given.start)]
    needed = given.clearance.required_at(*away, float(clear[0]))
    axes.fill_between(s, needed, color=COLOURS["goal"], alpha=0.18, linewidth=0)
    axes.plot(s, needed, color=COLOURS["goal"], label="required")
    axes.plot(s, clear, color=COLOURS["robot"], label="clearance of the footprint")
    axes.annotate("relief at the start", (0.02, needed[8]), (0.25, 0.012), va="center")
    end = path.length - given.clearance.taper
    axes.annotate("taper at the dock", (end, given.clearance.required), (end - 0.05, 0.012), va="center", ha="right")
    axes.set(xlabel="distance travelled s [m]", ylabel="clearance [m]", ylim=(0.0, 0.16), xlim=(0.0, path.length))
    axes.legend(**_LEGEND)


def _swept(poses: FloatArray) -> shapely.Geometry:
    """What the outline covers between its poses: hulls of neighbours, as one shape."""
    shapes = transform_points(poses, _ROBOT.footprint.vertices)
    hulls = [shapely.MultiPoint(np.concatenate(pair)).convex_hull for pair in itertools.pairwise(shapes)]
    return shapely.union_all(hulls)


def draw_swept(axes: Axes, plan: od.DockPlan) -> None:
    """The swept hull along the raw path, which hits a box, and along the certified path, which does not."""
    given = plan.problem
    blocks = shapely.union_all([shapely.Polygon(one) for one in _OBSTACLES])
    for shape in (*_OBSTACLES, transform_points(given.goal.as_array()[None, :], np.array(_STATION))[0]):
        axes.fill(*np.asarray(shape).T, color="#888888", linewidth=0)
    for path, colour, label in (
        (plan.raw_path, COLOURS["raw"], "raw path"),
        (plan.path, COLOURS["robot"], "certified path"),
    ):
        poses = path.poses_at(np.linspace(0.0, path.length, 240))
        hull = _swept(poses)
        axes.fill(*hull.exterior.xy, facecolor=(colour, 0.16), edgecolor=colour, linewidth=1.0)
        axes.plot(poses[:, 0], poses[:, 1], color=colour, label=label)
        hit = hull.intersection(blocks)
        for piece in getattr(hit, "geoms", [hit]):
            if piece.area > 1e-9:
                axes.fill(*piece.exterior.xy, color=COLOURS["hot"], linewidth=0, zorder=3)
    for pose in (given.start, given.goal):
        axes.plot(*pose.as_array()[:2], "o", markersize=4, color=COLOURS["start"], zorder=4)
    axes.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
    axes.legend(**_LEGEND)


def draw_speed(axes: Axes, plan: od.DockPlan) -> None:
    """The jerk-limited speed under the forward-backward pass, and that under the maximum velocity curve."""
    (limits,) = limits_along(plan.path, _ROBOT.limits, _DOCK.approach)
    if limits is None:
        raise ValueError("the path has no length")
    curve = 1.0 / limits.maximum_velocity_curve()
    axes.stairs(np.minimum(curve, 1.0), limits.s, color=COLOURS["goal"], baseline=None, label="maximum velocity curve")
    fast = forward_backward_pass(ReferenceBounds(limits), State())
    axes.plot(
        limits.s, np.sqrt(fast.speed_squared), color=COLOURS["raw"], linestyle="--", label="forward-backward pass"
    )
    law = plan.trajectory
    states = [law.at(t) for t in np.linspace(0.0, law.duration, 500)]
    axes.plot(
        [one.s for one in states], [abs(one.twist.linear) for one in states], color=COLOURS["robot"], label="plan"
    )
    axes.set(xlabel="distance travelled s [m]", ylabel="speed [m/s]", ylim=(0.0, 0.9), xlim=(0.0, plan.path.length))
    axes.legend(**_LEGEND)


def draw_behind(axes: Axes, plan: od.DockPlan) -> None:  # noqa: ARG001 - has a problem of its own
    """From behind the dock: the guess of the search, and the certified path with its cusp."""
    racks = [[(2.0, 2.2), (7.0, 2.2), (7.0, 2.6), (2.0, 2.6)], [(0.6, -1.2), (1.0, -1.2), (1.0, 2.6), (0.6, 2.6)]]
    dock = od.Dock(od.Pose2(4.0, 1.0, 0.0), od.Footprint(_STATION), "forward", final_straight=0.3)
    clearance = od.ClearanceRule(0.05, at_dock=0.0)
    given = od.DockingProblem(od.Pose2(6.0, 0.9, 0.2), dock, _ROBOT, racks, clearance=clearance)
    found = od.plan_dock(given, time_budget=5.0)
    for shape in (*racks, transform_points(given.goal.as_array()[None, :], np.array(_STATION))[0]):
        axes.fill(*np.asarray(shape).T, color="#888888", linewidth=0)
    for path, style, label in ((found.raw_path, "raw", f"guess: {found.stage}"), (found.path, "robot", "certified")):
        poses = path.poses_at(np.linspace(0.0, path.length, 300))
        axes.plot(poses[:, 0], poses[:, 1], color=COLOURS[style], label=label)
    axes.fill(*_swept(poses).exterior.xy, facecolor=(COLOURS["robot"], 0.16), edgecolor=COLOURS["robot"], linewidth=0.8)
    cusps = found.path.poses_at(np.array(found.path.cusps))
    axes.plot(cusps[:, 0], cusps[:, 1], "o", markersize=4, color=COLOURS["hot"], label="cusp", linestyle="none")
    axes.plot(*given.start.as_array()[:2], "o", markersize=4, color=COLOURS["start"])
    axes.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
    axes.legend(**_LEGEND)


def draw_no_way(axes: Axes, plan: od.DockPlan) -> None:  # noqa: ARG001 - there is none
    """A gap that is too narrow: where the robot can be on the goal's side, and the bottleneck."""
    walls = [(-0.2, -0.2, 5.4, 0.0), (-0.2, 3.2, 5.4, 3.4), (-0.2, 0.0, 0.0, 3.2), (5.2, 0.0, 5.4, 3.2)]
    boxes = [*walls, (2.5, 0.0, 2.7, 1.3), (2.5, 1.95, 2.7, 3.2)]
    obstacles = [[(a, b), (c, b), (c, d), (a, d)] for a, b, c, d in boxes]
    dock = od.Dock(od.Pose2(4.2, 1.6, 0.0), final_straight=0.3)
    given = od.DockingProblem(od.Pose2(1.0, 1.0, 0.3), dock, _ROBOT, obstacles, clearance=0.05)
    proof = od.prove_impossible(given, time_budget=10.0)
    if proof is None or proof.bottleneck is None:
        raise ValueError("no proof in time")
    tight = proof.bottleneck
    for shape in obstacles:
        axes.fill(*np.asarray(shape).T, color="#888888", linewidth=0)
    cells = shapely.union_all([shapely.Polygon(square) for square in proof.squares()]).simplify(0.01)
    for part in getattr(cells, "geoms", [cells]):
        axes.fill(*part.exterior.xy, color=COLOURS["robot"], alpha=0.25, linewidth=0)
    axes.fill([], [], color=COLOURS["robot"], alpha=0.25, label=f"cells around the {proof.end}")
    for pose, colour, label in (
        (given.start, COLOURS["start"], "start"),
        (given.goal, COLOURS["goal"], "goal"),
        (
            od.Pose2(tight.x, tight.y, tight.yaw),
            COLOURS["hot"],
            f"bottleneck, {100 * tight.missing_width:.0f} cm missing",
        ),
    ):
        outline = transform_points(pose.as_array()[None, :], _ROBOT.footprint.vertices)[0]
        axes.fill(*outline.T, facecolor="none", edgecolor=colour, linewidth=1.4, label=label)
    axes.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
    axes.legend(**{**_LEGEND, "ncols": 2})


FIGURES: dict[str, tuple[Callable[[Axes, od.DockPlan], None], float]] = {
    "taper": (draw_taper, 2.5),
    "swept": (draw_swept, 3.4),
    "speed": (draw_speed, 2.8),
    "behind": (draw_behind, 3.6),
    "no-way": (draw_no_way, 4.2),
}
"""What is drawn, and how high it is [inch]."""


def save(name: str, plan: od.DockPlan, scheme: str) -> Path:
    """Draw one figure for one colour scheme of the pages."""
    draw, height = FIGURES[name]
    ink = _INK[scheme]
    style = {f"{part}.color": ink for part in ("text", "xtick", "ytick")}
    style |= {"axes.edgecolor": ink, "axes.labelcolor": ink, "svg.hashsalt": "optdock", "font.size": 9.0}
    style |= {"axes.spines.top": False, "axes.spines.right": False, "axes.facecolor": "none", "path.simplify": True}
    with mpl.rc_context(style):
        figure = Figure(figsize=(5.8, height), layout="constrained")
        draw(figure.subplots(), plan)
        target = ASSETS / f"{name}-{scheme}.svg"
        figure.savefig(target, transparent=True, metadata={"Date": None, "Creator": None})
    return target


def main() -> None:
    """Plan once, draw everything."""
    plan = od.plan_dock(problem(), time_budget=2.0)
    sys.stdout.write(f"{plan}\n")
    for name in FIGURES:
        for scheme in _INK:
            target = save(name, plan, scheme)
            sys.stdout.write(f"{target.name} {target.stat().st_size / 1e3:.0f} kB\n")


if __name__ == "__main__":
    main()
