"""Chapter of a plan file: scene with the robot along its motion, limits, certificate, and reasons of a refusal."""

from __future__ import annotations

import functools
import itertools
import math
from typing import TYPE_CHECKING

import numpy as np
import shapely

from optdock.geometry.obstacles import in_words
from optdock.impossibility import BlockedStraight
from optdock.io.plan_file import CERTIFIED
from optdock.model.path import Direction
from optdock.plotting.plan_picture import refused_pose
from optdock.plotting.scene import View, view_of
from optdock.reports.html.certificate_words import claimed, plan_tables, plan_texts
from optdock.reports.html.figures import (
    Curve,
    LegendEntry,
    Outline,
    curve_figure,
    draw_area,
    draw_curve,
    draw_outlines,
    draw_point,
    draw_robot,
    scene_figure,
    swept_area,
)
from optdock.reports.html.page import Chapter, Chart, Content, Player, Readout
from optdock.reports.plan_file_verdict import judge_plan_file
from optdock.reports.shown_motion import clearance_curve, shown_motion

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from bokeh import plotting

    from optdock.geometry.arrays import FloatArray
    from optdock.geometry.pose import Pose2
    from optdock.impossibility import ImpossibilityProof
    from optdock.io.plan_file import PlanFile
    from optdock.model.clearance_rule import ClearanceRule
    from optdock.model.path import Path
    from optdock.model.problem import DockingProblem
    from optdock.reports.html.page import Block
    from optdock.reports.plan_file_verdict import PlanFileVerdict
    from optdock.reports.shown_motion import ShownMotion

__all__ = ["clearance_chart", "enclosed_area", "plan_chapter", "plan_summary", "shown_view", "start_relief"]

_SPACING = 0.02  # [m] between drawn points of a path
_AROUND = 0.5  # [m] around a path whose scene is not known


def plan_chapter(name: str, plan: PlanFile, problem: DockingProblem | None = None) -> Chapter:
    """Return the chapter of a plan file.

    Args:
        name: Name of the file.
        plan: The file.
        problem: Problem for which the file is checked and with which its scene is drawn; None if it is not known.

    Raises:
        InvalidFile: If parts of the file contradict each other.
    """
    verdict = None if problem is None else judge_plan_file(plan, problem)
    outcome, grade, severity = _outcome(plan, verdict)
    rank = (severity, claimed(plan, "margin", math.inf))
    content = functools.partial(_content, plan, problem, verdict)
    return Chapter(name, "plans", outcome, grade, plan_summary(plan), content, _numbers(plan), rank)


def _content(plan: PlanFile, problem: DockingProblem | None, verdict: PlanFileVerdict | None) -> Content:
    motion = None if plan.path is None else shown_motion(plan, plan.path, problem)
    blocks: list[Block] = []
    player, tightest = None, None
    if motion is not None:
        readouts = [*_readouts(motion)]
        if problem is not None and len(problem.all_obstacles):
            chart, found = clearance_chart(
                motion.label, motion.at, motion.poses, problem, problem.path_clearance, start_relief(plan)
            )
            blocks.append(chart)
            readouts += found
            tightest = motion.poses[int(np.nanargmin(np.array(found[-1].values, dtype=float)))]
        blocks += _motion_charts(motion)
        outline = problem.robot.footprint.vertices.tolist() if problem is not None else []
        player = Player(motion.clock, motion.unit, motion.at.tolist(), motion.poses.tolist(), outline, readouts)
    scene = _scene(plan, problem, motion, tightest)
    return Content([*scene, *blocks, *plan_texts(plan, problem, verdict), *plan_tables(plan, verdict)], player)


def _outcome(plan: PlanFile, verdict: PlanFileVerdict | None) -> tuple[str, str, float]:
    """Return the outcome in words, its grade, and its severity, of which the lowest comes first."""
    if verdict is None:
        return f"{plan.status}, not checked", "neutral", 2.0 if plan.status == CERTIFIED else 1.0
    if verdict.outcome == "refuted":
        return ("refuted" if plan.error is None else plan.status), "bad", 0.0 if plan.error is None else 1.0
    words = {"unproven": "path certified, motion not proven", "impossible": "impossible, proven"}
    grade = "good" if verdict else "neutral"
    return words.get(verdict.outcome, verdict.outcome), grade, 2.0 if verdict else 1.5


def plan_summary(plan: PlanFile) -> str:
    """Return the reason of the failure, or length, duration, least clearance and time of planning, in one line."""
    if plan.error is not None:
        return plan.error.message
    parts = []
    if plan.path is not None:
        parts.append(f"{plan.path.driven:.3f} m ({_gears_in_words(plan.path)})")
    if plan.trajectory is not None:
        parts.append(f"{float(plan.trajectory.t[-1] - plan.trajectory.t[0]):.3f} s")
    least = claimed(plan, "min_clearance", math.inf)
    if math.isfinite(least):
        nearest, at = in_words(str((plan.certificate or {}).get("nearest", ""))), claimed(plan, "at_s", math.nan)
        parts.append(f"least clearance {least:.4f} m to {nearest or 'an obstacle'} at s = {at:.3f} m")
    if "total" in plan.timing_ms:
        parts.append(f"planned in {plan.timing_ms['total']:.1f} ms")
    return ", ".join(parts) or f"status {plan.status}"


def _gears_in_words(path: Path) -> str:
    """Return the gears and turns in place, e.g. `3 gears: reverse, forward, reverse`."""
    names = {Direction.FORWARD: "forward", Direction.REVERSE: "reverse", Direction.IN_PLACE: "turn in place"}
    merged = [names[gear] for gear, _ in itertools.groupby(segment.direction for segment in path.segments)]
    kind = "parts" if names[Direction.IN_PLACE] in merged else "gears"
    return merged[0] if len(merged) == 1 else f"{len(merged)} {kind}: {', '.join(merged)}"


def _numbers(plan: PlanFile) -> dict[str, object]:
    """Return the numbers of the file, unchanged."""
    error = None if plan.error is None else plan.error._asdict()
    proof: dict[str, object] | None = None if plan.impossibility is None else {"message": plan.impossibility.message}
    if proof is not None and plan.impossibility is not None and plan.impossibility.bottleneck is not None:
        proof["bottleneck"] = vars(plan.impossibility.bottleneck)
    duration = None if plan.trajectory is None else float(plan.trajectory.t[-1])
    return {
        "status": plan.status,
        "completed": plan.completed,
        "frame": plan.frame,
        "duration": duration,
        "certificate": plan.certificate,
        "error": error,
        "impossibility": proof,
        "tried": plan.tried,
        "timing_ms": plan.timing_ms,
    }


# The motion and its figures.


def _motion_charts(motion: ShownMotion) -> Iterator[Chart]:
    for panel in motion.panels:
        name, _, unit = panel.label.partition(" [")
        unit = unit.rstrip("]")
        curves = [Curve(name, motion.panels_at, panel.values)]
        for bound in (panel.upper, panel.lower):
            if np.isfinite(bound).any():
                shown = np.where(np.isfinite(bound), bound, math.nan)
                curves.append(Curve("limit", motion.panels_at, shown, "limit", "dashed", 1.5))
        span = float(motion.panels_at[0]), float(motion.panels_at[-1])
        figure = curve_figure(curves, (motion.label, panel.label), span, panel.axis_range, motion.cusps.tolist())
        text = f"{name} from {np.nanmin(panel.values):.3f} to {np.nanmax(panel.values):.3f} {unit}"
        limited = len(curves) > 1
        legend = [LegendEntry(name, "path"), *([LegendEntry("limit", "limit", "dashed")] if limited else [])]
        legend += [LegendEntry("cusp", "muted", "dotted")] if motion.cusps.size else []
        most = np.nanmax(np.abs(panel.upper)) if np.isfinite(panel.upper).all() else math.inf
        text += f"; largest limit {most:.3f} {unit}" if math.isfinite(most) else ("" if limited else "; no limit")
        yield Chart(name.capitalize(), f"{text}.", figure, legend)


def _readouts(motion: ShownMotion) -> Iterator[Readout]:
    """Generate the values of all quantities at the poses of the player."""
    for panel in motion.panels:
        name, _, unit = panel.label.partition(" [")
        yield Readout(name, unit.rstrip("]"), np.interp(motion.at, motion.panels_at, panel.values).tolist())


def start_relief(plan: PlanFile | None) -> float:
    """Return the start relief of the certificate in a plan file [m], see `ClearanceRule.required_at`."""
    return 0.0 if plan is None else claimed(plan, "start_relief", 0.0)


def clearance_chart(
    label: str,
    at: FloatArray,
    poses: FloatArray,
    problem: DockingProblem,
    rule: ClearanceRule,
    relief: float = 0.0,
) -> tuple[Chart, list[Readout]]:
    """Return the chart of clearance and required clearance, and the clearances and margins for the player.

    Args:
        label: Label of the horizontal axis.
        at: Values of the horizontal axis, Shape (n,).
        poses: Poses, Shape (n, 3).
        problem: The docking problem.
        rule: Clearance rule: that of the path, with the tracking tube, or that of driven poses.
        relief: Start relief of the rule [m].
    """
    clearances, required, rows = curve = clearance_curve(poses, problem, rule, relief)
    margins = curve.margins
    k = int(np.argmin(margins))
    curves = [
        Curve("clearance", at, clearances),
        Curve("required", at, required, "limit", "dashed", 1.5),
        Curve("margin", at, margins, "start", "dotted", 1.5),
    ]
    top = 1.15 * max(0.02, min(float(clearances.max()), 6.0 * float(required.max()) + 0.1))
    figure = curve_figure(
        curves, (label, "clearance [m]"), (float(at[0]), float(at[-1])), (min(0.0, 1.15 * float(margins[k])), top)
    )
    draw_point(figure, np.array([[at[k], clearances[k]]]), "hot", "x", 12)
    what = in_words(problem.all_obstacles.name_of(int(rows[k]))) if rows[k] >= 0 else "no obstacle"
    clock, _, unit = label.partition(" [")
    text = (
        f"Tightest of {at.size} poses at {clock} {at[k]:.3f} {unit.rstrip(']')}: {clearances[k]:.4f} m to {what}, "
        f"required {required[k]:.4f} m, margin {margins[k]:.4f} m."
    )
    legend = [
        LegendEntry("clearance", "path"),
        LegendEntry("required", "limit", "dashed"),
        LegendEntry("margin", "start", "dotted"),
        LegendEntry("tightest", "hot", "point"),
    ]
    readouts = [Readout("clearance", "m", clearances.tolist()), Readout("margin", "m", margins.tolist())]
    return Chart("Clearance", text, figure, legend), readouts


# The scene.


def shown_view(problem: DockingProblem | None, paths: Sequence[FloatArray]) -> View:
    """Return the visible rectangle of a scene around paths, Shape (n, 3) each."""
    if problem is not None:
        return view_of(problem, paths)
    places = np.vstack([poses[:, :2] for poses in paths])
    low, high = places.min(axis=0) - _AROUND, places.max(axis=0) + _AROUND
    return View(float(low[0]), float(high[0]), float(low[1]), float(high[1]))


def _scene(
    plan: PlanFile, problem: DockingProblem | None, motion: ShownMotion | None, tightest: FloatArray | None
) -> Iterator[Chart]:
    drawn = [each for each in (plan.raw_path, plan.path) if each is not None]
    place = _refused(plan, problem, drawn[-1] if drawn else None)
    paths = [each.sample(_SPACING).poses for each in drawn]
    paths += [place.as_array()[None]] if place is not None else []
    if not paths and problem is None:
        return
    view = shown_view(problem, paths)
    axes, legend = scene_figure(view, problem)
    if plan.impossibility is not None and problem is not None:
        legend += _draw_proof(axes, plan, problem)
    if motion is not None and problem is not None:
        dense = plan.path.sample(_SPACING).poses if plan.path is not None else motion.poses
        draw_area(axes, swept_area(problem.robot.footprint, dense), Outline("robot", "robot", 0.22))
        legend.append(LegendEntry("swept area", "robot", "faint"))
    legend += _draw_paths(axes, plan)
    if problem is not None:
        legend += _draw_ends(axes, problem)
        legend += _draw_places(axes, problem, plan, place, tightest)
        if motion is not None:
            draw_robot(axes, problem.robot.footprint, motion.poses[0])
    text = _scene_text(plan, place)
    yield Chart("Scene", text, axes, legend, (view.right - view.left) / (view.top - view.bottom))


def _scene_text(plan: PlanFile, place: Pose2 | None) -> str:
    found = [name for name, path in (("raw path", plan.raw_path), ("path", plan.path)) if path is not None]
    text = f"Scene from above with {' and '.join(found) or 'start and goal'}; x and y have equal scales."
    if place is not None:
        text += f" The refusal is at {place.brief}."
    return text


def _refused(plan: PlanFile, problem: DockingProblem | None, path: Path | None) -> Pose2 | None:
    if plan.error is None or problem is None:
        return None
    return refused_pose(problem, plan.status, plan.error.where, path)


def _draw_paths(axes: plotting.figure, plan: PlanFile) -> Iterator[LegendEntry]:
    if plan.raw_path is not None:
        samples = plan.raw_path.sample(_SPACING)
        draw_curve(axes, Curve("raw path", samples.x, samples.y, "raw", width=4.0))
        yield LegendEntry("raw path", "raw")
    if plan.path is None:
        return
    samples = plan.path.sample(_SPACING)
    for gear, colour, name in ((1, "path", "path, forward"), (-1, "reverse", "path, reverse")):
        mine = samples.direction == gear
        if mine.any():
            x, y = (np.where(mine, column, math.nan) for column in (samples.x, samples.y))
            draw_curve(axes, Curve(name, x, y, colour))
            yield LegendEntry(name, colour)
    if plan.path.cusps:
        draw_point(axes, plan.path.poses_at(np.array(plan.path.cusps))[:, :2], "ink", "diamond", 9)
        yield LegendEntry("cusp", "ink", "point")


def _draw_ends(axes: plotting.figure, problem: DockingProblem) -> Iterator[LegendEntry]:
    for pose, name in ((problem.start, "start"), (problem.goal, "goal")):
        draw_outlines(axes, problem.robot.footprint, pose.as_array()[None], Outline("", name))
        yield LegendEntry(name, name)


def _draw_places(
    axes: plotting.figure, problem: DockingProblem, plan: PlanFile, place: Pose2 | None, tightest: FloatArray | None
) -> Iterator[LegendEntry]:
    """Draw the refused pose, or the poses of least clearance and of least margin."""
    at = claimed(plan, "at_s", math.nan)
    marks = []
    proof = plan.impossibility
    found = "refused here" if proof is None or proof.bottleneck is None else "bottleneck"
    if isinstance(proof, BlockedStraight):
        return  # its poses are drawn already
    if place is not None:
        marks.append((found, place.as_array()[None], "dashed"))
    elif plan.path is not None:
        if math.isfinite(at):
            marks.append(("least clearance", plan.path.poses_at(min(at, plan.path.length)), "dotted"))
        if tightest is not None:
            marks.append(("tightest place", tightest[None], "dashed"))
    for name, poses, dash in marks:
        draw_outlines(axes, problem.robot.footprint, poses, Outline("", "hot", dash=dash, width=2.0))
        yield LegendEntry(name, "hot", dash)


def _draw_proof(axes: plotting.figure, plan: PlanFile, problem: DockingProblem) -> Iterator[LegendEntry]:
    """Draw the cells of a proof that no motion exists, or its blocked poses."""
    proof = plan.impossibility
    hot = Outline("", "hot", dash="dashed", width=2.0)
    if isinstance(proof, BlockedStraight):
        poses = np.array([(pose.x, pose.y, pose.yaw) for pose in proof.poses])
        draw_outlines(axes, problem.robot.footprint, poses, hot)
        yield LegendEntry("blocked", "hot", "dashed")
    elif proof is not None:
        colour = "start" if proof.end == "start" else "goal"
        draw_area(axes, enclosed_area(proof), Outline(colour, "", 0.3))
        yield LegendEntry(f"enclosed area around the {proof.end}", colour, "faint")


def enclosed_area(proof: ImpossibilityProof) -> shapely.Geometry:
    """Return the positions that a proof encloses at some heading, as polygons with holes [m]."""
    squares = np.array(proof.squares())
    level = np.round(np.log2(np.ptp(squares[:, :, 0], axis=1)), 6)
    # Squares of one size share whole edges, for which the union is five times as fast.
    sizes = [shapely.coverage_union_all(shapely.polygons(squares[level == one])) for one in np.unique(level)]
    return shapely.union_all(sizes)
