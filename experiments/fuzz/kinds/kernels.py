"""Kernels in C against their NumPy twins: bounds of stretches, also degenerate ones, and whole proofs of clearance.

Both must be equal to the last bit. Stretches are drawn with bodies and obstacles that touch or overlap, in tiny cells,
at huge coordinates, and with NaN and infinite numbers.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from experiments.fuzz.case import Verdict
from experiments.fuzz.doors import path_of, problem_of
from experiments.fuzz.generators.problems import path_problem
from experiments.fuzz.generators.shapes import footprint, log_uniform, obstacle
from optdock.errors import OptdockError
from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.kernels import kernels_in_use, using_kernels
from optdock.model.path import Path
from optdock.verification import stretch_bounds
from optdock.verification.conservative_advancement import prove_clearance
from optdock.verification.proximity import bounded_footprint
from optdock.verification.stretch_bounds import Advances

if TYPE_CHECKING:
    from experiments.fuzz.case import Case
    from optdock.geometry.arrays import FloatArray
    from optdock.verification.proximity import BoundedBody

__all__ = ["DEGENERATE", "draw", "drawn_shapes", "drawn_stretches", "is_equal", "judge", "replaced"]

DEGENERATE = ("none", "touching", "tiny", "huge", "still", "nan", "inf")
_PROOFS = 0.2  # share of the cases that are whole proofs
_SETS = 10  # of stretches for every body and its obstacles
_FAR = 1e7  # [m]


def draw(rng: np.random.Generator) -> Case:
    """Draw a path problem, or the seed and the degeneracy of stretches."""
    if rng.uniform() < _PROOFS:
        return {**path_problem(rng), "kind": "kernels", "degenerate": None}
    return {"kind": "kernels", "degenerate": str(rng.choice(DEGENERATE)), "seed": int(rng.integers(2**31))}


def judge(case: Case) -> Verdict:
    """Compare both lanes."""
    found = _proofs(case) if case["degenerate"] is None else _stretches(case)
    return Verdict("kernel differs", replaced()) if replaced() else found


def replaced() -> str:
    """Return which kernels were replaced by their twins because their first result differs; empty if none."""
    told = kernels_in_use()
    return told if "NumPy for" in told else ""


def _stretches(case: Case) -> Verdict:
    rng = np.random.default_rng(case["seed"])
    body, obstacles = drawn_shapes(rng, case["degenerate"])
    for _ in range(_SETS):
        advances, within = drawn_stretches(rng, case["degenerate"])
        found = []
        for lane in ("twin", "native"):
            with using_kernels(lane), np.errstate(all="ignore"):
                found.append(stretch_bounds._body_bounds(body, advances, obstacles, within))
        if not is_equal(*found):
            return Verdict("kernel differs", f"bounds: {case['degenerate']}")
    return Verdict("equal")


def _proofs(case: Case) -> Verdict:
    try:
        path, problem = path_of(case["path"]), problem_of(case)
    except OptdockError as error:
        return Verdict(f"input refused: {type(error).__name__}", str(error))
    found = []
    for lane in ("twin", "native"):
        with using_kernels(lane):
            found.append(prove_clearance(Path(path.segments), problem))
    return Verdict("equal proofs") if is_equal(*found) else Verdict("kernel differs", "proof")


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
