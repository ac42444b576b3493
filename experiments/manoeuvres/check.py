"""Independent check of the benchmark's plans: poses, clearances and time law by the fuzzer's oracle and shapely.

No code of `optdock.verification` is used. The path is sampled with the oracle's clothoids, at most 1 cm and 2 mrad
between poses; distances of the outline to the obstacles are computed by shapely. Only the list of obstacles is that of
the problem (map cells as rectangles), because the union of a warehouse map takes seconds.

A fault is reported only if a sample violates a bound by more than twice the tolerance of the certificate.
"""

from __future__ import annotations

import dataclasses
import itertools
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import shapely

from experiments.fuzz.doors import law_spec, path_spec, problem_spec
from experiments.fuzz.oracle.motion import motion_of
from experiments.fuzz.oracle.rules import findings
from experiments.fuzz.oracle.sweep import required_at, start_run
from experiments.fuzz.oracle.timing import judge_timing
from experiments.fuzz.oracle.world import placed

if TYPE_CHECKING:
    from collections.abc import Iterator

    from experiments.fuzz.case import Case as Spec
    from experiments.fuzz.oracle.motion import Floats, Ints, Motion
    from optdock.model.problem import DockingProblem
    from optdock.planning.plan import DockPlan

__all__ = ["Check", "checked"]

STEP, TURN, PERIOD = 0.01, 0.002, 0.005  # [m], [rad], [s]
_FORGIVEN = 2e-6  # [m]: twice the tolerance of the certificate
_ON_PATH = 1e-6  # [m], [rad] between trajectory samples and path
_STEERING = 1.0 + 2e-6  # relative
_INSTANT = 1e-6  # [s]
_SAME_PLACE = 1e-7  # [m]: tolerance of rest positions
_BATCH = 5000


class Check(NamedTuple):
    """Result of the check.

    Args:
        faults: The violated rules with values, each once; empty: none.
        min_clearance: Smallest sampled distance [m].
        margin: Smallest difference of sampled and required distance [m].
        poses: Number of sampled poses.
    """

    faults: tuple[str, ...]
    min_clearance: float
    margin: float
    poses: int


def checked(plan: DockPlan, problem: DockingProblem, start_relief: float | None = None) -> Check:
    """Check at samples whether `plan` satisfies all bounds of `problem`.

    Args:
        plan: The plan.
        problem: The problem.
        start_relief: Start relief of the clearance rule [m]; None: that of the plan's certificate.
    """
    gears = path_spec(plan.path)
    motion = motion_of(gears)
    spec = _spec(problem)
    swept = _poses(motion)
    distance = _clearances(swept, problem)
    relief = plan.certificate.start_relief if start_relief is None else start_relief
    margin = distance - required_at(spec, swept, float(distance[0]), relief)
    worst = int(np.argmin(margin))
    faults = [f"{one.kind} at {one.s:.3f} m, {one.ratio:.3g} x" for one in findings(spec, motion) if one.is_broken]
    if not margin[worst] >= -_FORGIVEN:
        faults.append(f"clearance {1e3 * margin[worst]:.4f} mm beyond the rule at {swept[worst].round(4).tolist()}")
    faults += _relief_faults(relief, spec)
    faults += _time_faults(plan, gears, spec, motion)
    faults += _steering_faults(plan, motion, problem)
    return Check(tuple(dict.fromkeys(faults)), float(distance.min()), float(margin[worst]), len(swept))


def _spec(problem: DockingProblem) -> Spec:
    """Return the problem as plain data, without the map, which only the clearance check uses."""
    return problem_spec(dataclasses.replace(problem, costmap=None, obstacles=()))


def _poses(motion: Motion) -> Floats:
    """Return poses along the whole path, including the ends of its pieces. Shape (n, 3)."""
    parts = np.maximum(1, np.ceil(np.maximum(motion.way / STEP, motion.turn / TURN))).astype(np.int64)
    piece = np.repeat(np.arange(parts.size), parts + 1)
    rank = np.arange(piece.size) - np.repeat(np.cumsum(parts + 1) - (parts + 1), parts + 1)
    return motion.poses_at(piece, rank / parts[piece])


def _clearances(poses: Floats, problem: DockingProblem) -> Floats:
    """Return the distance of the outline to the nearest obstacle; -inf if they overlap by more than rounding."""
    found = np.full(len(poses), np.inf)
    if not len(problem.all_obstacles):
        return found
    tree, outline = shapely.STRtree(shapely.polygons(problem.all_obstacles.vertices)), problem.robot.footprint.vertices
    shrunk = np.array(shapely.buffer(shapely.Polygon(outline), -_FORGIVEN, join_style="mitre").exterior.coords)[:-1]
    for first in range(0, len(poses), _BATCH):
        rows = np.arange(first, min(first + _BATCH, len(poses)))
        found[rows] = _nearest(tree, outline, poses[rows])
        touching = rows[found[rows] <= 0.0]
        inner = _nearest(tree, shrunk, poses[touching])
        found[touching] = np.where(inner > 0.0, 0.0, -np.inf)
    return found


def _nearest(tree: Any, outline: Floats, poses: Floats) -> Floats:  # noqa: ANN401
    out = np.full(len(poses), np.inf)
    if len(poses):
        bodies = shapely.polygons(placed(outline, poses))
        (rows, _), distance = tree.query_nearest(bodies, return_distance=True, all_matches=False)
        out[rows] = distance
    return out


def _relief_faults(relief: float, spec: Spec) -> Iterator[str]:
    """Check that the start relief is no longer than the rule allows."""
    if not 0.0 <= relief <= start_run(spec) * (1.0 + 1e-9):
        yield f"start relief of {relief:.4f} m, {start_run(spec):.4f} m are allowed"


def _time_faults(plan: DockPlan, gears: list[Spec], spec: Spec, motion: Motion) -> Iterator[str]:
    """Check speeds, accelerations and rests of the time law, and that its samples every 5 ms lie on the path."""
    law = plan.trajectory.time_law
    timed = {
        "path": gears,
        "law": law_spec(law),
        "limits": spec["limits"],
        "zone": spec["zone"],
        "start_speed": abs(spec["start_speed"]),
        "wheels": "unknown" if spec.get("start_curvature") is None else "known",
    }
    verdict = judge_timing(timed, motion)
    values = {**verdict.ratios, **verdict.structure}
    yield from (f"{name}, {values[name]:.6g} x" for name in verdict.broken)
    samples = plan.trajectory.sample(PERIOD)
    piece, share = _places(motion, samples.s)
    off = float(np.abs(np.column_stack((samples.x, samples.y, samples.yaw)) - motion.poses_at(piece, share)).max())
    if not off <= _ON_PATH:
        yield f"the trajectory's samples are {off:.3g} off the path"


def _places(motion: Motion, s: Floats) -> tuple[Ints, Floats]:
    """Return piece and share at arc lengths."""
    piece = np.clip(np.searchsorted(motion.s, s, side="right") - 1, 0, motion.s.size - 1)
    return piece, np.clip((s - motion.s[piece]) / np.maximum(motion.h[piece], 1e-300), 0.0, 1.0)


def _steering_faults(plan: DockPlan, motion: Motion, problem: DockingProblem) -> Iterator[str]:
    """Check steering angle and rate, if the robot limits them; the wheels turn at rest at cusps.

    The steering angle changes sign in reverse for the same curvature along the direction of travel.
    """
    limits = problem.robot.limits
    base = getattr(limits, "wheelbase", 0.0)
    if not base > 0.0:
        return
    first, last = (np.arctan(base * motion.gear * k) for k in (motion.k0, motion.k1))
    most = float(np.maximum(np.abs(first), np.abs(last)).max())
    if not most <= limits.max_steering_angle * _STEERING:
        yield f"steering angle {most:.6f} rad"
    samples = plan.trajectory.sample(PERIOD)
    piece, share = _places(motion, samples.s)
    bend = motion.k0[piece] + share * (motion.k1 - motion.k0)[piece]
    change = np.abs(motion.k1 - motion.k0)[piece] / np.maximum(motion.h[piece], 1e-300)
    rate = float((base * change * np.abs(samples.speed) / (1.0 + (base * bend) ** 2)).max())
    if not rate <= limits.max_steering_rate * _STEERING:
        yield f"steering rate {rate:.6f} rad/s"
    law = plan.trajectory.time_law
    for before, after in itertools.pairwise(motion.segments):
        still = np.abs(law.states[:, 0] - after.start_s) <= _SAME_PLACE
        rest = float(law.durations[still[1:] & still[:-1]].sum())
        turn = abs(first[after.first] - last[before.stop - 1])
        if not turn / limits.max_steering_rate <= rest * _STEERING + _INSTANT:
            yield f"the wheels turn by {turn:.4f} rad in a rest of {rest:.4f} s at {after.start_s:.3f} m"
