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
from optdock.kernels import using_kernels
from optdock.model.path import Path
from optdock.verification import conservative_advancement
from optdock.verification.conservative_advancement import Advances, prove_clearance
from optdock.verification.proximity import bounded_footprint

if TYPE_CHECKING:
    from experiments.fuzz.case import Case
    from optdock.geometry.arrays import FloatArray
    from optdock.verification.proximity import BoundedBody

__all__ = ["DEGENERATE", "draw", "drawn_stretches", "is_equal", "judge"]

DEGENERATE = ("none", "touching", "tiny", "huge", "still", "nan", "inf")
_PROOFS = 0.3  # share of the cases that are whole proofs


def draw(rng: np.random.Generator) -> Case:
    """Draw a path problem, or the seed and the degeneracy of stretches."""
    if rng.uniform() < _PROOFS:
        return {**path_problem(rng), "kind": "kernels", "degenerate": None}
    return {"kind": "kernels", "degenerate": str(rng.choice(DEGENERATE)), "seed": int(rng.integers(2**31))}


def judge(case: Case) -> Verdict:
    """Compare both lanes."""
    if case["degenerate"] is None:
        return _proofs(case)
    arguments = drawn_stretches(np.random.default_rng(case["seed"]), case["degenerate"])
    found = []
    for lane in ("twin", "native"):
        with using_kernels(lane), np.errstate(all="ignore"):
            found.append(conservative_advancement._body_bounds(*arguments))
    return Verdict("equal") if is_equal(*found) else Verdict("kernel differs", f"bounds: {case['degenerate']}")


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
    """Whether two results are equal to the last bit; NaN is equal to NaN."""
    return all(
        np.shape(a) == np.shape(b) and np.asarray(a).tobytes() == np.asarray(b).tobytes()
        for a, b in zip(first, second, strict=True)
    )


def drawn_stretches(rng: np.random.Generator, degenerate: str) -> tuple[BoundedBody, Advances, ObstacleSet, FloatArray]:
    """Draw the arguments of the kernel of the proof; see `DEGENERATE` for the second argument."""
    drawn = footprint(rng)
    robot = Footprint.from_radius(drawn["radius"]) if "radius" in drawn else Footprint(drawn["polygon"])
    bodies = bounded_footprint(robot)
    body = bodies[int(rng.integers(len(bodies)))]
    k, n = int(rng.integers(1, 12)), int(rng.integers(1, 24))
    far = 1e7 if degenerate == "huge" else 0.0
    poses = rng.uniform(-1.0, 1.0, (k, 3)) * [1.0, 1.0, np.pi] + [far, far, 0.0]
    if degenerate == "touching":  # sides in contact, also at right angles, and vertices that coincide
        poses = np.round(poses, 1)
        poses[:, 2] = rng.choice([0.0, 0.5 * np.pi, np.pi, 0.25 * np.pi], k)
    obstacles = _obstacles(rng, body, degenerate, far)
    width = 0.0 if degenerate == "still" else log_uniform(rng, 1e-16, 1e-9) if degenerate == "tiny" else 0.08
    velocity, bounds = rng.normal(size=(n, 3)), rng.exponential(size=(5, n))
    bounds[0] = width * rng.uniform(size=n)
    exact_within = rng.exponential(0.2, n)
    if degenerate in ("nan", "inf"):
        arrays: tuple[FloatArray, ...] = (poses, velocity, bounds, exact_within)
        spoiled = arrays[int(rng.integers(4))]
        spoiled.flat[int(rng.integers(spoiled.size))] = np.nan if degenerate == "nan" else rng.choice([-1, 1]) * np.inf
    return body, Advances(poses, rng.integers(0, k, n), velocity, *bounds), obstacles, exact_within


def _obstacles(rng: np.random.Generator, body: BoundedBody, degenerate: str, far: float) -> ObstacleSet:
    polygons = []
    for _ in range(int(rng.integers(1, 9))):
        points = np.array(body.body.vertices if degenerate == "touching" and rng.uniform() < 0.5 else obstacle(rng))
        away = rng.uniform(-1.5, 1.5, 2)
        polygons.append(points + far + (np.round(away, 1) if degenerate == "touching" else away))
    return ObstacleSet.from_polygons(polygons)
