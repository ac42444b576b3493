"""Kernels in C against their NumPy twins: bounds of stretches, whole proofs of clearance, and time laws.

Both must be equal to the last bit. Stretches are drawn with bodies and obstacles that touch or overlap, in tiny cells,
at huge coordinates, and with NaN and infinite numbers; programs of the interior point method with cells of very
different lengths, without a solution, and with NaN and infinite numbers; and places that motions reach, also at rests
and beyond the end. Time laws of random paths and limits are computed and proven as a whole.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from experiments.fuzz.case import Verdict
from experiments.fuzz.doors import path_of, problem_of, zone_of
from experiments.fuzz.generators.problems import path_problem
from experiments.fuzz.generators.shapes import footprint, log_uniform, obstacle
from experiments.fuzz.kinds import timings
from optdock.deadline import budget_clock
from optdock.errors import OptdockError
from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.kernels import using_kernels
from optdock.model.constant_jerk import TimeLaw
from optdock.model.limits import MotionLimits
from optdock.model.path import Path
from optdock.timing.interior_point import Iterate, Program, advanced
from optdock.timing.near_optimal import NearOptimal
from optdock.timing.reference_program import jerk_step_bands, spline_of
from optdock.verification import conservative_advancement
from optdock.verification.conservative_advancement import Advances, prove_clearance
from optdock.verification.proximity import bounded_footprint
from optdock.verification.turning_rules import crossings

if TYPE_CHECKING:
    from experiments.fuzz.case import Case
    from optdock.geometry.arrays import FloatArray
    from optdock.kernels import Lane
    from optdock.verification.proximity import BoundedBody

__all__ = [
    "DEGENERATE",
    "DEGENERATE_PROGRAMS",
    "draw",
    "drawn_law",
    "drawn_program",
    "drawn_shapes",
    "drawn_stretches",
    "is_equal",
    "judge",
]

DEGENERATE = ("none", "touching", "tiny", "huge", "still", "nan", "inf")
DEGENERATE_PROGRAMS = ("none", "lengths", "infeasible", "tiny", "nan", "inf")
_PROOFS, _TIMINGS, _CROSSINGS, _PROGRAMS = 0.2, 0.1, 0.15, 0.15  # shares of the cases
LANES: tuple[Lane, Lane] = ("twin", "native")
_SETS = 10  # of stretches for every body and its obstacles
_FAR = 1e7  # [m]


def draw(rng: np.random.Generator) -> Case:
    """Draw a path problem, or the seed and the degeneracy of stretches, of a program or of a time law."""
    share = rng.uniform()
    if share < _PROOFS:
        return {**path_problem(rng), "kind": "kernels", "degenerate": None}
    if share < _PROOFS + _TIMINGS:
        return {**timings.draw(rng), "kind": "kernels", "plugin": "NearOptimal"}
    if share < _PROOFS + _TIMINGS + _CROSSINGS:
        return {"kind": "kernels", "law": int(rng.integers(2**31))}
    if share < _PROOFS + _TIMINGS + _CROSSINGS + _PROGRAMS:
        return {"kind": "kernels", "program": str(rng.choice(DEGENERATE_PROGRAMS)), "seed": int(rng.integers(2**31))}
    return {"kind": "kernels", "degenerate": str(rng.choice(DEGENERATE)), "seed": int(rng.integers(2**31))}


def judge(case: Case) -> Verdict:
    """Compare both lanes."""
    if "plugin" in case:
        return _timings(case)
    if "law" in case:
        return _crossings(np.random.default_rng(case["law"]))
    if "program" in case:
        return _programs(case)
    if case["degenerate"] is None:
        return _proofs(case)
    rng = np.random.default_rng(case["seed"])
    body, obstacles = drawn_shapes(rng, case["degenerate"])
    for _ in range(_SETS):
        advances, within = drawn_stretches(rng, case["degenerate"])
        found = []
        for lane in LANES:
            with using_kernels(lane), np.errstate(all="ignore"):
                found.append(conservative_advancement._body_bounds(body, advances, obstacles, within))
        if not is_equal(*found):
            return Verdict("kernel differs", f"bounds: {case['degenerate']}")
    return Verdict("equal")


def _proofs(case: Case) -> Verdict:
    try:
        path, problem = path_of(case["path"]), problem_of(case)
    except OptdockError as error:
        return Verdict(f"input refused: {type(error).__name__}", str(error))
    found = []
    for lane in LANES:
        with using_kernels(lane):
            found.append(prove_clearance(Path(path.segments), problem))
    return Verdict("equal proofs") if is_equal(*found) else Verdict("kernel differs", "proof")


def _timings(case: Case) -> Verdict:
    path, limits, found = path_of(case["path"]), MotionLimits(**case["limits"]), []
    begins = case["start_speed"], case.get("start_acceleration", 0.0)
    for lane in LANES:
        with using_kernels(lane), budget_clock("counted"):  # refusals have a time limit
            result = NearOptimal().parameterize(
                path, limits, zone_of(case), start_speed=begins[0], start_acceleration=begins[1]
            )
        law = None if result.trajectory is None else result.trajectory.time_law
        motion = (np.zeros(0), np.zeros(0)) if law is None else (law.durations, law.jerks)
        found.append((*motion, result.worst_ratio, result.status))
    return Verdict("equal timings") if is_equal(*found) else Verdict("kernel differs", "timing")


def _crossings(rng: np.random.Generator) -> Verdict:
    for _ in range(_SETS):
        law, places = drawn_law(rng)
        found = []
        for lane in LANES:
            with using_kernels(lane), np.errstate(all="ignore"):
                found.append(crossings(law, places))
        if not is_equal(*found):
            return Verdict("kernel differs", "crossings")
    return Verdict("equal crossings")


def drawn_law(rng: np.random.Generator) -> tuple[TimeLaw, FloatArray]:
    """Draw a time law, possibly with rests, phases backwards and very short phases, and places, some of them NaN."""
    n = int(rng.integers(1, 30))
    durations = np.exp(rng.uniform(-20.0 if rng.uniform() < 0.3 else -3.0, 1.0, n))
    jerks = rng.choice([0.0, 1.0, -1.0], n) * rng.exponential(1.0, n)
    at_rest = rng.uniform() < 0.3
    law = TimeLaw(
        durations, jerks if not at_rest else 0.0 * jerks, 0.0, 0.0 if at_rest else float(rng.exponential(1.0))
    )
    borders = law.states[:, 0]
    places = np.concatenate((borders, rng.uniform(-1.0, 2.0, 20) * max(1e-3, float(np.abs(borders).max())), [np.nan]))
    places[rng.integers(0, n + 1)] += 1e-15
    return law, rng.permutation(places)


def _programs(case: Case) -> Verdict:
    program, c = drawn_program(np.random.default_rng(case["seed"]), case["program"])
    found = []
    for lane in LANES:
        with using_kernels(lane), np.errstate(all="ignore"):
            iterate = Iterate.of(program, c)
            found.append([iterate := advanced(program, iterate, most) for most in (1, 7, 40)])
    same = all(is_equal(*pair) for pair in zip(*found, strict=True))
    return Verdict("equal programs") if same else Verdict("kernel differs", f"program: {case['program']}")


def drawn_program(rng: np.random.Generator, degenerate: str) -> tuple[Program, FloatArray]:
    """Draw a program of the interior point method and positive coefficients; see `DEGENERATE_PROGRAMS`."""
    count, with_places = int(rng.integers(4, 40)), int(rng.integers(0, 5))
    spread = 8.0 if degenerate == "lengths" else 1.0
    steps = 0.05 * np.exp(spread * rng.uniform(-1.0, 1.0, count))
    spline = spline_of(steps)
    value, curve = spline.right_value, spline.curve / rng.uniform(0.5, 20.0)
    most = rng.uniform(0.05, 1.0, count) * (1e-12 if degenerate == "tiny" else 1.0)
    turns = rng.normal(size=(int(rng.integers(0, 6)), count))
    rows = [value / most, spline.right_slope / 0.7, -spline.right_slope / 0.7, *(turn * value for turn in turns)]
    curved = [curve, -curve, *(value * rng.normal(size=count) for _ in range(with_places))]
    places = np.stack([value] * with_places, axis=1) if with_places else np.zeros((3, 0, count))
    bands = jerk_step_bands(spline, rng.exponential(1e-3, count - 1))
    program = Program(steps, np.stack(rows, axis=1), np.stack(curved, axis=1), places, spline.right_share, bands)
    c = np.full(count + 2, float(rng.uniform(0.1, 0.5)) * most.min())
    if degenerate == "infeasible":
        c[:2] = 5.0 * most[:2]  # given, and above their bounds
    if degenerate in ("nan", "inf"):
        spoiled = (*program, c)[int(rng.integers(7))]
        if spoiled.size:
            spoiled.flat[int(rng.integers(spoiled.size))] = (
                np.nan if degenerate == "nan" else rng.choice([-1, 1]) * np.inf
            )
    return program, c


def is_equal(first: tuple[object, ...], second: tuple[object, ...]) -> bool:
    """Whether two results are equal to the last bit; any NaN is equal to any other."""
    return all(_is_same(a, b) for a, b in zip(first, second, strict=True))


def _is_same(first: object, second: object) -> bool:
    a, b = np.asarray(first), np.asarray(second)
    if a.shape != b.shape or a.dtype != b.dtype:
        return False
    if a.dtype.kind != "f":
        return bool(np.array_equal(a, b))
    same = (a == b) & (np.signbit(a) == np.signbit(b))
    return bool(np.all(same | (np.isnan(a) & np.isnan(b))))


def drawn_shapes(rng: np.random.Generator, degenerate: str) -> tuple[BoundedBody, ObstacleSet]:
    """Draw a convex body and obstacles; see `DEGENERATE` for the second argument."""
    drawn = footprint(rng)
    robot = Footprint.from_radius(drawn["radius"]) if "radius" in drawn else Footprint(drawn["polygon"])
    bodies = bounded_footprint(robot)
    body, polygons = bodies[int(rng.integers(len(bodies)))], []
    far = _FAR if degenerate == "huge" else 0.0
    for _ in range(int(rng.integers(1, 9))):
        if degenerate == "touching" and rng.uniform() < 0.5:
            polygons.append(_in_contact(rng, body))
        else:
            polygons.append(np.array(obstacle(rng)) + far + rng.uniform(-1.5, 1.5, 2))
    return body, ObstacleSet.from_polygons(polygons)


def _in_contact(rng: np.random.Generator, body: BoundedBody) -> FloatArray:
    """Return a copy of the body that touches it along an edge, or the same polygon."""
    vertices, normals, offsets = body.body
    edge = int(rng.integers(len(normals)))
    thickness = offsets[edge] - (vertices @ normals[edge]).min()
    return vertices + float(rng.choice([0.0, 1.0])) * thickness * normals[edge]


def drawn_stretches(rng: np.random.Generator, degenerate: str) -> tuple[Advances, FloatArray]:
    """Draw stretches of motion, and the distances within which pairs are evaluated exactly."""
    k, n = int(rng.integers(1, 12)), int(rng.integers(1, 24))
    far = _FAR if degenerate == "huge" else 0.0
    poses = rng.uniform(-1.0, 1.0, (k, 3)) * [1.0, 1.0, np.pi] + [far, far, 0.0]
    if degenerate == "touching":
        poses[0] = 0.0  # the pose at which copies of the body touch it
        poses[1:, 2] = rng.choice([0.0, 0.5 * np.pi, np.pi, 0.25 * np.pi], k - 1)
    width = 0.0 if degenerate == "still" else log_uniform(rng, 1e-16, 1e-9) if degenerate == "tiny" else 0.08
    velocity, bounds = rng.normal(size=(n, 3)), rng.exponential(size=(5, n))
    bounds[0] = width * rng.uniform(size=n)
    exact_within = rng.exponential(0.2, n)
    if degenerate in ("nan", "inf"):
        arrays: tuple[FloatArray, ...] = (poses, velocity, bounds, exact_within)
        spoiled = arrays[int(rng.integers(4))]
        spoiled.flat[int(rng.integers(spoiled.size))] = np.nan if degenerate == "nan" else rng.choice([-1, 1]) * np.inf
    return Advances(poses, rng.integers(0, k, n), velocity, *bounds), exact_within
