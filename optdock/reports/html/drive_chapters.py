"""Chapters of drives: simulated runs against their plans, and logs of dockings."""

from __future__ import annotations

import functools
import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.executor.task_states import State
from optdock.geometry.pose import pose_errors, wrap_angles
from optdock.reports.html.figures import (
    Curve,
    LegendEntry,
    Outline,
    band_figure,
    curve_figure,
    draw_area,
    draw_curve,
    draw_outlines,
    draw_point,
    draw_robot,
    scene_figure,
    swept_area,
)
from optdock.reports.html.page import Chapter, Chart, Content, Player, Readout, Table
from optdock.reports.html.plan_chapter import clearance_chart, shown_view, start_relief
from optdock.reports.shown_motion import thinned
from optdock.samples.tube import Tube

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from optdock.executor.log import DockingLog
    from optdock.geometry.arrays import FloatArray
    from optdock.io.plan_file import PlanFile
    from optdock.io.run_file import RunColumns
    from optdock.model.problem import DockingProblem
    from optdock.model.trajectory import Trajectory
    from optdock.reports.html.page import Block
    from optdock.samples.tube import Deviations

__all__ = ["detected_docks", "log_chapter", "run_chapter"]

_TIME = "time [s]"
_MOST_EVENTS = 400


class _Series(NamedTuple):
    """One chart over time: title, unit and curves."""

    title: str
    unit: str
    curves: Sequence[Curve]


def _series_charts(series: Sequence[_Series], marks: Sequence[float] = ()) -> Iterator[Chart]:
    for title, unit, curves in series:
        first = curves[0].x
        figure = curve_figure(curves, (_TIME, f"{title} [{unit}]"), (float(first[0]), float(first[-1])), marks=marks)
        ranges = (f"{one.label} from {np.nanmin(one.y):.3f} to {np.nanmax(one.y):.3f} {unit}" for one in curves)
        legend = [LegendEntry(one.label, one.colour, "line" if one.dash == "solid" else one.dash) for one in curves]
        legend += [LegendEntry("planning result", "muted", "dotted")] if len(marks) else []
        yield Chart(title.capitalize(), f"{'; '.join(ranges)}.", figure, legend)


def run_chapter(
    name: str, run: RunColumns, problem: DockingProblem | None = None, plan: PlanFile | None = None
) -> Chapter:
    """Return the chapter of a simulated run.

    Args:
        name: Name of the file.
        run: The run.
        problem: Its problem; None if it is not known.
        plan: Plan that was driven, for the deviations from its path; None if it is not known.
    """
    outcome = "collided" if run.collided else ("docked" if run.docked else "not docked")
    severity = 0.5 if run.collided else (2.0 if run.docked else 1.0)
    summary = f"driven in {run.times[-1]:.2f} s" + (f"; {run.reason}" if run.reason else "")
    final = None if run.final_error is None else dict(zip(("along", "cross", "yaw"), run.final_error, strict=True))
    numbers: dict[str, object] = {
        "duration": float(run.times[-1]),
        "docked": run.docked,
        "reason": run.reason,
        "collided": run.collided,
        "goal_checkers": run.goal_checkers,
        "final_error": final,
        "min_clearance": run.min_clearance,
    }
    rank = (severity, math.inf if run.min_clearance is None else run.min_clearance)
    content = functools.partial(_run_content, run, problem, plan)
    return Chapter(name, "runs", outcome, "good" if severity == 2.0 else "bad", summary, content, numbers, rank)


def _run_content(run: RunColumns, problem: DockingProblem | None, plan: PlanFile | None) -> Content:
    rows = thinned(run.times.size)
    at, poses = run.times[rows], run.poses[rows]
    errors = pose_errors(run.poses, run.planned)
    along, across, turned = errors[rows].T
    series = [
        _Series("tracking error", "mm", [Curve("along", at, 1e3 * along), Curve("across", at, 1e3 * across, "goal")]),
        _Series("yaw error", "rad", [Curve("yaw error", at, turned, "start")]),
        *_command_series(at, run.commands[rows], run.twists[rows]),
    ]
    readouts = [
        Readout("speed", "m/s", run.twists[rows, 0].tolist()),
        Readout("along", "mm", (1e3 * along).tolist()),
        Readout("across", "mm", (1e3 * across).tolist()),
    ]
    blocks: list[Block] = [_run_scene(run, problem)]
    deviations, relief = None, start_relief(plan)
    if problem is not None and plan is not None and plan.path is not None:
        deviations = Tube(plan.path, problem, relief).deviations(run.poses)
        moved = [
            Curve("displacement", at, 1e3 * deviations.displacement[rows]),
            Curve("width of the tube", at, 1e3 * deviations.width[rows], "limit", "dashed", 1.5),
        ]
        series.insert(0, _Series("deviation from the path", "mm", moved))
    if problem is not None and len(problem.all_obstacles):
        chart, found = clearance_chart(_TIME, at, poses, problem, problem.clearance, relief)
        blocks.append(chart)
        readouts += found
    blocks += _series_charts(series)
    blocks.append(Table("Result of the drive", (), [*_run_rows(run, errors, deviations)]))
    outline = [] if problem is None else problem.robot.footprint.vertices.tolist()
    return Content(blocks, Player("time", "s", at.tolist(), poses.tolist(), outline, readouts))


def _command_series(at: FloatArray, commands: FloatArray, twists: FloatArray) -> list[_Series]:
    """Return the charts of commanded and driven speed and yaw rate."""
    return [
        _Series(title, unit, [
            Curve("driven", at, twists[:, i]), Curve("command", at, commands[:, i], "goal", "dashed", 1.5),
        ])
        for i, (title, unit) in enumerate((("speed", "m/s"), ("yaw rate", "rad/s")))
    ]  # fmt: skip


def _run_rows(run: RunColumns, errors: FloatArray, deviations: Deviations | None) -> Iterator[tuple[str, str]]:
    yield "docked", "yes" if run.docked else f"no: {run.reason}"
    for checker, reached in run.goal_checkers.items():
        yield checker, "reached" if reached else "not reached"
    if run.final_error is not None:
        along, across, yaw = run.final_error
        yield "final error", f"along {1e3 * along:+.2f} mm, across {1e3 * across:+.2f} mm, yaw {yaw:+.5f} rad"
    along, across, yaw = np.max(np.abs(errors), axis=0)
    yield "largest error", f"along {1e3 * along:.2f} mm, across {1e3 * across:.2f} mm, yaw {yaw:.5f} rad"
    if run.min_clearance is not None:
        yield "least clearance driven", f"{run.min_clearance:.4f} m"
    if deviations is not None:
        most, width = float(deviations.displacement.max()), float(deviations.width.max())
        yield "largest displacement from the path", f"{1e3 * most:.2f} mm"
        left = int((deviations.excess > 0.0).sum())
        kept = "kept" if left == 0 else f"left at {left} of {deviations.excess.size} poses"
        yield "tracking tube", f"{kept}, {1e3 * width:.1f} mm wide" if width > 0.0 else "not certified"


def _run_scene(run: RunColumns, problem: DockingProblem | None) -> Chart:
    view = shown_view(problem, [run.poses])
    axes, legend = scene_figure(view, problem)
    if problem is not None:
        draw_area(axes, swept_area(problem.robot.footprint, run.poses), Outline("robot", "robot", 0.22))
        draw_outlines(axes, problem.robot.footprint, problem.goal.as_array()[None], Outline("", "goal"))
        legend += [LegendEntry("swept area", "robot", "faint"), LegendEntry("goal", "goal")]
    for label, poses, colour, dash in (
        ("driven", run.poses, "path", "solid"),
        ("planned", run.planned, "raw", "dashed"),
    ):
        draw_curve(axes, Curve(label, poses[:, 0], poses[:, 1], colour, dash))
        legend.append(LegendEntry(label, colour, "line" if dash == "solid" else dash))
    if problem is not None:
        draw_robot(axes, problem.robot.footprint, run.poses[0])
    text = "Drive from above, against the planned poses; x and y have equal scales."
    return Chart("Drive", text, axes, legend, (view.right - view.left) / (view.top - view.bottom))


def log_chapter(name: str, log: DockingLog) -> Chapter:
    """Return the chapter of the log of a docking.

    Args:
        name: Name of the file.
        log: The log.
    """
    cycles, ending = log.cycles, log.cycles[-1].ending
    lasted = cycles[-1].measurements.stamp - cycles[0].measurements.stamp
    outcome = "no ending" if ending is None else ending.kind.value
    grade, severity = ("good", 2.0) if ending else ("bad", 1.0)
    reason = "the log ends before the task" if ending is None else ending.reason
    summary = f"{log.task.task} in {lasted:.2f} s, {len(cycles)} cycles"
    if ending is not None:
        summary += f", error code {ending.kind.code}, {ending.num_retries} retries"
    summary += f"; {reason}" if reason else ""
    numbers = {
        "task": log.task.task,
        "cycles": len(cycles),
        "duration": lasted,
        "ending": None if ending is None else {**ending._asdict(), "kind": ending.kind.value, "code": ending.kind.code},
        "events": [event._asdict() for cycle in cycles for event in cycle.events],
    }
    content = functools.partial(_log_content, log)
    return Chapter(name, "logs", outcome, grade, summary, content, numbers, (severity, 0.0))


def _log_content(log: DockingLog) -> Content:
    problem, cycles, poses = log.task.problem, log.cycles, log.measured
    times, commands = log.commands[:, 0], log.commands[:, 1:]
    twists = np.array([(cycle.measurements.twist.linear, cycle.measurements.twist.angular) for cycle in cycles])
    rows = thinned(times.size)
    series = _command_series(times[rows], commands[rows], twists[rows])
    posed = np.array([i for i, cycle in enumerate(cycles) if cycle.measurements.pose is not None], dtype=int)
    blocks: list[Block] = []
    player = None
    if posed.size:
        blocks.append(_log_scene(log, detected_docks(log, times, poses)))
        kept = thinned(posed.size)
        at, shown = times[posed[kept]], poses[kept]
        away = np.hypot(shown[:, 0] - problem.goal.x, shown[:, 1] - problem.goal.y)
        series.insert(0, _Series("distance to the stored dock", "m", [Curve("distance", at, away)]))
        readouts = [
            Readout("distance", "m", away.tolist()),
            Readout("command", "m/s", commands[posed[kept], 0].tolist()),
            Readout("command", "rad/s", commands[posed[kept], 1].tolist()),
            Readout("state", "", [cycles[i].state.value for i in posed[kept]]),
        ]
        outline = problem.robot.footprint.vertices.tolist()
        player = Player("time", "s", at.tolist(), shown.tolist(), outline, readouts)
    marks = [times[i] for i, cycle in enumerate(cycles) if any(one.result is not None for one in cycle.planned)]
    blocks += [_state_chart(log, times), *_series_charts(series, [float(mark) for mark in marks])]
    return Content([*blocks, *_log_tables(log)], player)


def detected_docks(log: DockingLog, times: FloatArray, poses: FloatArray) -> FloatArray:
    """Return the detected docked poses in the fixed frame, with the measured pose at their stamps, Shape (n, 3)."""
    began = log.cycles[0].measurements.stamp
    stamps = [
        times[i] if cycle.measurements.pose_stamp is None else cycle.measurements.pose_stamp - began
        for i, cycle in enumerate(log.cycles)
        if cycle.measurements.pose is not None
    ]
    found = [one for cycle in log.cycles for one in cycle.measurements.detections]
    if not found or len(stamps) < 2:
        return np.zeros((0, 3))
    at = np.array([one.stamp - began for one in found])
    unwrapped = np.column_stack((poses[:, :2], np.unwrap(poses[:, 2])))
    x, y, yaw = (np.interp(at, stamps, unwrapped[:, k]) for k in range(3))
    seen = np.array([one.pose.as_array() for one in found])
    c, s = np.cos(yaw), np.sin(yaw)
    turned = wrap_angles(yaw + seen[:, 2])
    return np.column_stack((x + c * seen[:, 0] - s * seen[:, 1], y + s * seen[:, 0] + c * seen[:, 1], turned))


def _log_scene(log: DockingLog, detected: FloatArray) -> Chart:
    problem, poses = log.task.problem, log.measured
    view = shown_view(problem, [poses])
    axes, legend = scene_figure(view, problem)
    draw_area(axes, swept_area(problem.robot.footprint, poses), Outline("robot", "robot", 0.22))
    for planned in (one for cycle in log.cycles for one in cycle.planned):
        if planned.trajectory is not None:
            samples = planned.trajectory.path.sample(0.02)
            draw_curve(axes, Curve("planned", samples.x, samples.y, "raw", width=3.0))
    draw_curve(axes, Curve("measured", poses[:, 0], poses[:, 1]))
    if len(detected):
        draw_point(axes, detected[thinned(len(detected)), :2], "start", "x", 6)
    draw_outlines(axes, problem.robot.footprint, problem.goal.as_array()[None], Outline("", "goal"))
    draw_robot(axes, problem.robot.footprint, poses[0])
    legend += [
        LegendEntry("swept area", "robot", "faint"), LegendEntry("measured poses", "path"),
        LegendEntry("planned paths", "raw"), LegendEntry("detected docks", "start", "point"),
        LegendEntry("stored dock", "goal"),
    ]  # fmt: skip
    text = f"Docking from above: {len(poses)} measured poses, {len(detected)} detections of the dock; equal scales."
    return Chart("Docking", text, axes, legend, (view.right - view.left) / (view.top - view.bottom))


def _state_chart(log: DockingLog, times: FloatArray) -> Chart:
    """Return the time line of the states, with the events."""
    order = [state.value for state in State]
    values = [cycle.state.value for cycle in log.cycles]
    begins = [0, *(i for i in range(1, len(values)) if values[i] != values[i - 1])]
    ends = [*begins[1:], len(values) - 1]
    names = [name for name in order if name in values]
    bands = [(names.index(values[i]), float(times[i]), float(times[j])) for i, j in zip(begins, ends, strict=True)]
    began = log.cycles[0].measurements.stamp
    events = [event.stamp - began for cycle in log.cycles for event in cycle.events]
    figure = band_figure(names, bands, events[:_MOST_EVENTS])
    spent = {name: sum(end - begin for row, begin, end in bands if names[row] == name) for name in names}
    text = "; ".join(f"{name} {seconds:.2f} s" for name, seconds in spent.items())
    legend = [LegendEntry("state", "path", "area"), LegendEntry("event", "hot", "point")]
    return Chart("States and events", f"{text}.", figure, legend)


def _log_tables(log: DockingLog) -> Iterator[Table]:
    began = log.cycles[0].measurements.stamp
    events = [
        (f"{event.stamp - began:.3f}", event.name, event.detail) for cycle in log.cycles for event in cycle.events
    ]
    if events:
        yield Table("Events", ("time [s]", "event", "detail"), events[:_MOST_EVENTS])
    planned = [
        (
            f"{cycle.measurements.stamp - began:.3f}",
            one.result.outcome.value,
            _length(one.trajectory),
            one.result.reason,
        )
        for cycle in log.cycles
        for one in cycle.planned
        if one.result is not None
    ]
    if planned:
        yield Table("Planning during the docking", ("time [s]", "outcome", "path", "reason"), planned)


def _length(trajectory: Trajectory | None) -> str:
    return "" if trajectory is None else f"{trajectory.path.driven:.3f} m in {trajectory.duration:.2f} s"
