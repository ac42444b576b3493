"""Figures of the tutorial and the theory, drawn by the library from real plans: `python docs/tools/figures.py`.

Each figure is written for light and for dark pages, as SVG into `docs/assets/`. `make docs` does not draw them, because
they change rarely.
"""

from __future__ import annotations

import itertools
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
import shapely
from matplotlib.figure import Figure

import optdock as od
from optdock.executor import InlinePlanning
from optdock.geometry.pose import transform_points
from optdock.plotting.canvas import COLOURS
from optdock.plotting.marker_picture import draw_marker_array
from optdock.ros import plan_markers
from optdock.ros.bag import bag_types
from optdock.runner import Workers
from optdock.simulation import Actuation, DifferentialDrive, DockSensor, PoseSensor, Sensors, SimulatedRobot
from optdock.survey.dock_places import DockPlace
from optdock.survey.grid import Box
from optdock.survey.survey import SurveySettings, docks_of, run_survey
from optdock.timing.forward_backward import forward_backward_pass
from optdock.timing.jerk_phases import MotionState
from optdock.timing.path_limits import ReferenceBounds, limits_along
from optdock.verification import pose_clearances

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.axes import Axes

    from optdock.executor.planning import PlanResult
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
    """Return a problem between two boxes into a dock, with a start closer to a third box than required."""
    clearance = od.ClearanceRule(required=0.05, at_dock=0.0, taper=0.6)
    return od.DockingProblem(od.Pose2(0.9, 0.36, 0.0), _DOCK, _ROBOT, _OBSTACLES, clearance=clearance)


def draw_taper(axes: Axes, plan: od.DockPlan) -> None:
    """Draw clearance and required clearance along the path: relief at the start, taper at the dock."""
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
    """Return the swept area of the outline: the union of the hulls of neighbouring poses."""
    shapes = transform_points(poses, _ROBOT.footprint.vertices)
    hulls = [shapely.MultiPoint(np.concatenate(pair)).convex_hull for pair in itertools.pairwise(shapes)]
    return shapely.union_all(hulls)


def draw_swept(axes: Axes, plan: od.DockPlan) -> None:
    """Draw the swept areas of the raw path, which hits two boxes, and of the certified path, which hits none."""
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
    """Draw the jerk-limited speed, the forward-backward pass, and the maximum velocity curve."""
    (limits,) = limits_along(plan.path, _ROBOT.limits, _DOCK.approach)
    if limits is None:
        raise ValueError("the path has no length")
    curve = 1.0 / limits.maximum_velocity_curve()
    axes.stairs(np.minimum(curve, 1.0), limits.s, color=COLOURS["goal"], baseline=None, label="maximum velocity curve")
    fast = forward_backward_pass(ReferenceBounds(limits), MotionState())
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
    """Draw a plan from behind the dock: the guess of the search, and the certified path with its cusp."""
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
    """Draw a gap that is too narrow: the cells reachable on the goal's side, and the bottleneck."""
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


class _Watched(InlinePlanning):
    """Planning that records the plans."""

    def __init__(self) -> None:
        super().__init__()
        self.plans: list[od.DockPlan] = []

    def poll(self, stamp: float) -> PlanResult | None:
        """Return the result if available, and record it."""
        result = super().poll(stamp)
        if result is not None and result.motion is not None and result.motion.plan is not None:
            self.plans.append(result.motion.plan)
        return result


def draw_markers(axes: Axes, plan: od.DockPlan) -> None:  # noqa: ARG001 - has a problem of its own
    """Draw a docking in a simulated world: stored, true and detected dock, and the markers of the plan."""
    given = od.load_scenario(ASSETS.parents[1] / "ros" / "optdock_ros" / "optdock_ros" / "simulated_bay.yaml").problem
    dock, planning = given.goal @ od.Pose2(0.03, -0.04, 0.05), _Watched()
    settings = od.ExecutorSettings(navigate_to_staging_pose=False)
    sensors = Sensors(
        PoseSensor(settings.position_sigma, settings.yaw_sigma), dock=DockSensor(position_sigma=0.003, yaw_sigma=0.005)
    )
    drive = DifferentialDrive(given.robot, Actuation(linear_lag=0.1, angular_lag=0.1, latency=0.06))
    world = SimulatedRobot(drive, given.start, dock, sensors)
    executor = od.DockingExecutor(given, settings, planning=planning)
    step, track, seen = executor.step(world.measurements), [], []
    while step.ending is None:
        told = world.advance(step.command, 0.02)
        track.append(world.state.pose.as_array())
        seen += [(world.state.pose @ one.pose).as_array() for one in told.detections]
        step = executor.step(told)
    if not step.ending.kind.succeeded:
        raise ValueError(str(step.ending))
    for shape in given.obstacles.vertices:
        axes.fill(*shape.T, color="#888888", linewidth=0)
    station = given.dock.footprint
    assert station is not None
    for pose, style, label in ((given.goal, ":", "station, as stored"), (dock, "-", "station, as it is")):
        outline = transform_points(pose.as_array()[None], station.vertices)[0]
        axes.plot(*np.vstack((outline, outline[:1])).T, style, color="#888888", linewidth=1.2, label=label)
    axes.plot(*np.array(seen)[:, :2].T, ".", color=COLOURS["goal"], markersize=3, label="detected: docked pose")
    axes.plot(*np.array(track)[:, :2].T, color=COLOURS["raw"], linewidth=5.0, alpha=0.6, label="driven")
    draw_marker_array(axes, plan_markers(bag_types, planning.plans[0], given.frame, 0.0))
    axes.set(aspect="equal", xlabel="x [m]", ylabel="y [m]", xlim=(1.4, 3.6), ylim=(0.3, 1.75))
    axes.legend(**_LEGEND)


def draw_survey(axes: Axes, plan: od.DockPlan) -> None:  # noqa: ARG001 - has a problem of its own
    """Draw the least duration at every position of a room, and the positions from which no motion exists."""
    scenario = od.load_scenario(ASSETS.parents[1] / "examples" / "data" / "room.yaml")
    given, settings = scenario.problem, SurveySettings(region=Box(0.0, 0.0, 5.0, 3.0), resolution=0.125, headings=8)
    docks = list(docks_of("robot", scenario, [DockPlace("dock", given.goal)]))
    with tempfile.TemporaryDirectory() as folder, Workers(clock="counted") as workers:
        layers = run_survey(docks, settings, Path(folder), workers)[0].answers.layers()
    for shape in given.all_obstacles.vertices:
        axes.fill(*shape.T, color="#888888", linewidth=0)
    with np.errstate(invalid="ignore"):
        least = np.where(np.isfinite(layers.seconds), layers.seconds, np.inf).min(axis=0)
    drawn = axes.pcolormesh(layers.x, layers.y, np.ma.masked_invalid(least), cmap="viridis_r", rasterized=True)
    axes.figure.colorbar(drawn, ax=axes, label="least duration [s]")
    j, i = np.nonzero(layers.impossible.any(axis=0) & ~np.isfinite(least))
    axes.plot(layers.x[i], layers.y[j], "x", color=COLOURS["hot"], markersize=3, label="impossible, proven")
    outline = transform_points(given.goal.as_array()[None], given.robot.footprint.vertices)[0]
    axes.fill(*outline.T, facecolor="none", edgecolor=COLOURS["goal"], linewidth=1.4, label="docked robot")
    axes.set(aspect="equal", xlabel="x [m]", ylabel="y [m]", xlim=(-0.2, 5.2), ylim=(-0.2, 3.2))
    axes.legend(**_LEGEND)


FIGURES: dict[str, tuple[Callable[[Axes, od.DockPlan], None], float]] = {
    "taper": (draw_taper, 2.5),
    "swept": (draw_swept, 3.4),
    "speed": (draw_speed, 2.8),
    "behind": (draw_behind, 3.6),
    "no-way": (draw_no_way, 4.2),
    "markers": (draw_markers, 4.9),
    "survey": (draw_survey, 3.6),
}
"""Drawing function, and height [inch]."""


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
    """Plan once, draw all figures."""
    plan = od.plan_dock(problem(), time_budget=2.0)
    sys.stdout.write(f"{plan}\n")
    for name in FIGURES:
        for scheme in _INK:
            target = save(name, plan, scheme)
            sys.stdout.write(f"{target.name} {target.stat().st_size / 1e3:.0f} kB\n")


if __name__ == "__main__":
    main()
