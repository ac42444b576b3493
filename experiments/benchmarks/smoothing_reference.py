"""Distance of the smoother's results from a local optimum: the same cost minimized by ipopt, from the same result.

A separate formulation: a free line separates every robot outline from every near obstacle at every node, in one
nonlinear program with exact derivatives. Clearance is constrained at the nodes only, without reserve, so the reference
is slightly better than any path that is safe between them. Costs are those of `CasadiSmoother` without tracking.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from experiments.benchmarks.smoothing_calls import called
from experiments.benchmarks.tables import Table, Timer, percentile
from experiments.dense_check import clearance_at
from experiments.families import instance
from optdock.geometry.separation import separation

if TYPE_CHECKING:
    from collections.abc import Iterable

    import casadi as ca

    from optdock.geometry.arrays import FloatArray, IntArray
    from optdock.model.path import Path
    from optdock.model.problem import DockingProblem
    from optdock.plugins.interfaces import Smoother

__all__ = ["reference_table"]

WEIGHTS = (1.0, 0.4, 0.15)  # CasadiSmoother's defaults: length, curvature, curvature rate
IPOPT: dict[str, float | str] = {"print_level": 0, "sb": "yes", "mu_init": 1e-3, "max_iter": 500}
_NEAR = 0.4  # obstacles farther than this from the outline at a node have no line [m]
_INTERVALS = 4  # per knot span
_ROUNDS = 2  # the required clearance depends on the poses and is updated between rounds
_MIN_LENGTH = 0.02  # [m], as in the smoother
_GAUSS = (0.5 - 0.5 / math.sqrt(3.0), 0.5 + 0.5 / math.sqrt(3.0))


class _Gear(NamedTuple):
    """One gear before its final straight: knot curvatures (q + 1,) [1/m], length [m], sign."""

    curvature: FloatArray
    length: float
    sign: int


class _Pairs(NamedTuple):
    """Separated pairs: node, obstacle, direction of the line's normal [rad], its offset [m]; Shape (m,)."""

    node: IntArray
    obstacle: IntArray
    angle: FloatArray
    offset: FloatArray


class _Optimum(NamedTuple):
    cost: float
    converged: bool
    seconds: float


def path_cost(gears: tuple[_Gear, ...], problem: DockingProblem) -> float:
    """Return the weighted length, squared curvature and squared curvature rate, for piecewise linear curvature."""
    limits, total = problem.robot.limits, 0.0
    for gear in gears:
        k, h = gear.curvature, gear.length / (len(gear.curvature) - 1)
        squares = h / 3.0 * np.sum(k[1:] ** 2 + k[1:] * k[:-1] + k[:-1] ** 2)
        slopes = np.sum(np.diff(k) ** 2) / h
        bend, jerk = WEIGHTS[1] / limits.max_curvature**2, WEIGHTS[2] / limits.max_curvature_rate**2
        total += WEIGHTS[0] * gear.length + bend * float(squares) + jerk * float(slopes)
    return total


def gears_of(path: Path, problem: DockingProblem) -> tuple[_Gear, ...]:
    """Return the smoother's variables of its result."""
    gears = []
    for i, segment in enumerate(path.segments):
        straight = problem.dock.final_straight if i == len(path.segments) - 1 else 0.0
        length = segment.length - straight
        knots = np.linspace(0.0, length, int(np.sum(segment.knots <= length + 1e-9)))
        gears.append(_Gear(segment.curvature_at(knots), length, int(segment.direction)))
    return tuple(gears)


def reference_table(smoother: Smoother, families: Iterable[str], seeds: int) -> Table:
    """Return the costs of the smoother's results and of ipopt; `smoother` must not weigh tracking."""
    header = ("family", "compared", "of", "cost gap % p50", "p90", "max", "ipopt ms p50", "smoother ms p50")
    rows = [_row(smoother, family, seeds) for family in families]
    note = "ipopt starts from the smoother's result, holds clearance at the nodes only and keeps no reserve"
    return Table("Cost against an ipopt reference in the same basin (no tracking term)", header, tuple(rows), note)


def _row(smoother: Smoother, family: str, seeds: int) -> tuple[object, ...]:
    gaps, reference_times, times = [], [], []
    for seed in range(seeds):
        drawn = instance(family, seed)
        call = called(smoother, drawn.raw_path, drawn.problem)
        if call.path is None:
            continue
        gears = gears_of(call.path, drawn.problem)
        optimum = _optimum(gears, drawn.problem)
        if optimum.converged:
            gaps.append(100.0 * (path_cost(gears, drawn.problem) / optimum.cost - 1.0))
            reference_times.append(1e3 * optimum.seconds)
            times.append(1e3 * call.wall)
    shares = (percentile(gaps, 50), percentile(gaps, 90), percentile(gaps, 100))
    return (family, len(gaps), seeds, *shares, percentile(reference_times, 50), percentile(times, 50))


def _optimum(gears: tuple[_Gear, ...], problem: DockingProblem) -> _Optimum:
    timer, converged = Timer(), False
    for _ in range(_ROUNDS):
        gears, converged = _improved(gears, problem)
    return _Optimum(path_cost(gears, problem), converged, timer.wall)


def _improved(gears: tuple[_Gear, ...], problem: DockingProblem) -> tuple[tuple[_Gear, ...], bool]:
    """Solve one nonlinear program; return the gears at its solution, and whether ipopt converged."""
    import casadi as ca

    start = np.concatenate([*(gear.curvature for gear in gears), [gear.length for gear in gears]])
    x = ca.SX.sym("x", start.size)
    poses = _node_poses(gears, problem, x)
    now = np.array(ca.Function("poses", [x], [poses])(start))
    pairs = _near_pairs(now, problem)
    lines = ca.SX.sym("lines", 2 * len(pairs.node))
    apart = _held_apart(poses, now, pairs, lines, problem)
    fixed, low, high = _path_bounds(gears, problem, x, poses)
    g = ca.vertcat(*fixed, *apart)
    program = {"x": ca.vertcat(x, lines), "f": _symbolic_cost(gears, problem, x), "g": g}
    solver = ca.nlpsol("reference", "ipopt", program, {"print_time": False, "ipopt": dict(IPOPT)})
    box_low, box_high = _box(gears, problem, lines.numel())
    found = solver(
        x0=np.concatenate((start, pairs.angle, pairs.offset)),
        lbx=box_low,
        ubx=box_high,
        lbg=np.concatenate((low, np.zeros(len(apart)))),
        ubg=np.concatenate((high, np.full(len(apart), np.inf))),
    )
    return _unpacked(gears, np.array(found["x"]).ravel()), bool(solver.stats()["success"])


def _unpacked(gears: tuple[_Gear, ...], values: FloatArray) -> tuple[_Gear, ...]:
    out, at, knots = [], 0, sum(len(gear.curvature) for gear in gears)
    for i, gear in enumerate(gears):
        count = len(gear.curvature)
        out.append(_Gear(values[at : at + count], float(values[knots + i]), gear.sign))
        at += count
    return tuple(out)


def _split(gears: tuple[_Gear, ...], x: ca.SX) -> list[tuple[ca.SX, ca.SX]]:
    """Return symbolic knot curvatures and length of every gear."""
    out, at, knots = [], 0, sum(len(gear.curvature) for gear in gears)
    for i, gear in enumerate(gears):
        out.append((x[at : at + len(gear.curvature)], x[knots + i]))
        at += len(gear.curvature)
    return out


def _symbolic_cost(gears: tuple[_Gear, ...], problem: DockingProblem, x: ca.SX) -> ca.SX:
    import casadi as ca

    limits, total = problem.robot.limits, ca.SX(0)
    for k, length in _split(gears, x):
        h = length / (k.numel() - 1)
        squares = h / 3.0 * ca.sum1(k[1:] ** 2 + k[1:] * k[:-1] + k[:-1] ** 2)
        slopes = ca.sumsqr(k[1:] - k[:-1]) / h
        bend, jerk = WEIGHTS[1] / limits.max_curvature**2, WEIGHTS[2] / limits.max_curvature_rate**2
        total += WEIGHTS[0] * length + bend * squares + jerk * slopes
    return total


def _node_poses(gears: tuple[_Gear, ...], problem: DockingProblem, x: ca.SX) -> ca.SX:
    """Return poses at the ends of all intervals, by two-point Gauss sums. Shape (nodes, 3)."""
    import casadi as ca

    px, py, yaw = (ca.SX(value) for value in problem.start.as_array())
    rows = [ca.horzcat(px, py, yaw)]
    for gear, (k, length) in zip(gears, _split(gears, x), strict=True):
        h = length / (k.numel() - 1)
        for j in range(k.numel() - 1):
            for i in range(_INTERVALS):
                for share in _GAUSS:
                    heading = yaw + h * _turned(k[j], k[j + 1], (i + share) / _INTERVALS)
                    px += gear.sign * 0.5 * h / _INTERVALS * ca.cos(heading)
                    py += gear.sign * 0.5 * h / _INTERVALS * ca.sin(heading)
                rows.append(ca.horzcat(px, py, yaw + h * _turned(k[j], k[j + 1], (i + 1) / _INTERVALS)))
            yaw = yaw + h * _turned(k[j], k[j + 1], 1.0)
    return ca.vertcat(*rows)


def _turned(first: ca.SX, second: ca.SX, share: float) -> ca.SX:
    return share * first + 0.5 * share * share * (second - first)


def _path_bounds(
    gears: tuple[_Gear, ...], problem: DockingProblem, x: ca.SX, poses: ca.SX
) -> tuple[list[ca.SX], FloatArray, FloatArray]:
    """Return goal and curvature rate: expressions, lower and upper bounds."""
    import casadi as ca

    goal, sign = problem.goal, gears[-1].sign
    back = sign * problem.dock.final_straight
    target_yaw = goal.yaw + 2.0 * math.pi * round((_end_yaw(gears, problem) - goal.yaw) / (2.0 * math.pi))
    target = [goal.x - back * math.cos(goal.yaw), goal.y - back * math.sin(goal.yaw), target_yaw]
    expressions, highs = [ca.transpose(poses[-1, :])], [np.array(target)]
    lows = [np.array(target)]
    for k, length in _split(gears, x):
        spans = k.numel() - 1
        limit = problem.robot.limits.max_curvature_rate * length / spans
        expressions += [limit - (k[1:] - k[:-1]), limit + (k[1:] - k[:-1])]
        lows.append(np.zeros(2 * spans))
        highs.append(np.full(2 * spans, np.inf))
    return expressions, np.concatenate(lows), np.concatenate(highs)


def _end_yaw(gears: tuple[_Gear, ...], problem: DockingProblem) -> float:
    turns = (g.length / (len(g.curvature) - 1) * np.sum(0.5 * (g.curvature[1:] + g.curvature[:-1])) for g in gears)
    return problem.start.yaw + float(sum(turns))


def _box(gears: tuple[_Gear, ...], problem: DockingProblem, lines: int) -> tuple[FloatArray, FloatArray]:
    """Return bounds: curvatures (the last of them zero) and lengths; none on lines."""
    knots = sum(len(gear.curvature) for gear in gears)
    limit = np.full(knots, problem.robot.limits.max_curvature)
    limit[-1] = 0.0
    low = np.concatenate((-limit, np.full(len(gears), _MIN_LENGTH), np.full(lines, -np.inf)))
    return low, np.concatenate((limit, np.full(len(gears) + lines, np.inf)))


def _near_pairs(poses: FloatArray, problem: DockingProblem) -> _Pairs:
    """Return pairs of node and obstacle, with the lines that currently separate them best."""
    obstacles, found = problem.all_obstacles, []
    for body in problem.robot.footprint.bodies:
        node, row = (index.ravel() for index in np.indices((len(poses), len(obstacles))))
        gap = separation(body, poses[node], obstacles.pieces(row))
        near = gap.distance < _NEAR
        node, row, axis = node[near], row[near], gap.axis[near]
        highest = np.max(np.sum(obstacles.vertices[row] * axis[:, None], axis=2), axis=1)
        angle = np.arctan2(axis[:, 1], axis[:, 0])
        found.append(_Pairs(node, row, angle, highest + 0.5 * gap.distance[near]))
    return _Pairs(*(np.concatenate(columns) for columns in zip(*found, strict=True)))


def _held_apart(poses: ca.SX, now: FloatArray, pairs: _Pairs, lines: ca.SX, problem: DockingProblem) -> list[ca.SX]:
    """Return distances of robot corners above, and obstacle corners below their line: each must be >= 0."""
    import casadi as ca

    required, count, rows = _required(now, problem), len(pairs.node), []
    outline = problem.robot.footprint.vertices
    for i, (node, obstacle) in enumerate(zip(pairs.node, pairs.obstacle, strict=True)):
        nx, ny, offset = ca.cos(lines[i]), ca.sin(lines[i]), lines[count + i]
        c, s = ca.cos(poses[int(node), 2]), ca.sin(poses[int(node), 2])
        for vx, vy in outline:
            x, y = poses[int(node), 0] + c * vx - s * vy, poses[int(node), 1] + s * vx + c * vy
            rows.append(nx * x + ny * y - offset)
        for qx, qy in np.unique(problem.all_obstacles.vertices[obstacle], axis=0):
            rows.append(offset - float(required[node]) - nx * float(qx) - ny * float(qy))
    return rows


def _required(poses: FloatArray, problem: DockingProblem) -> FloatArray:
    from_goal = np.hypot(poses[:, 0] - problem.goal.x, poses[:, 1] - problem.goal.y)
    from_start = np.hypot(poses[:, 0] - problem.start.x, poses[:, 1] - problem.start.y)
    return problem.path_clearance.required_at(from_goal, from_start, clearance_at(problem.start, problem))
