"""Kernels in C against their NumPy twins: bounds of stretches, also degenerate ones, whole proofs, and roll-outs.

Both must be equal to the last bit. Stretches are drawn with bodies and obstacles that touch or overlap, in tiny cells,
at huge coordinates, and with NaN and infinite numbers.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, cast

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
from smoothers.scp.basis import basis_for
from smoothers.scp.collision.clearance_along import clearance_along
from smoothers.scp.collision.collision_scene import Scene, scene_around
from smoothers.scp.collision.linearization import separating_plane_rows
from smoothers.scp.cost import CostModel
from smoothers.scp.goal_projection import end_sensitivity, onto_goal, project_and_roll_out
from smoothers.scp.nlp import Ends, NonlinearProgram, TracedInput, VariableBounds
from smoothers.scp.rollout import Variables, roll_out, sensitivity
from smoothers.scp.settings import DEFAULT_SETTINGS

if TYPE_CHECKING:
    from experiments.fuzz.case import Case
    from optdock.geometry.arrays import FloatArray
    from optdock.verification.proximity import BoundedBody

__all__ = [
    "BENT",
    "DEGENERATE",
    "draw",
    "drawn_program",
    "drawn_shapes",
    "drawn_stretches",
    "is_equal",
    "judge",
    "replaced",
    "rolled",
]

DEGENERATE = ("none", "touching", "tiny", "huge", "still", "nan", "inf")
_ROLL_OUTS = 0.3  # share of the cases that are roll-outs of the smoother
_PROOFS = 0.2  # share of the cases that are whole proofs
_SETS = 10  # of stretches for every body and its obstacles
_FAR = 1e7  # [m]


def draw(rng: np.random.Generator) -> Case:
    """Draw a path problem, or the seed and the degeneracy of stretches or of a roll-out."""
    if rng.uniform() < _ROLL_OUTS:
        return {**path_problem(rng), "kind": "kernels", "degenerate": str(rng.choice(BENT)), "roll_out": _seed(rng)}
    if rng.uniform() < _PROOFS:
        return {**path_problem(rng), "kind": "kernels", "degenerate": None}
    return {"kind": "kernels", "degenerate": str(rng.choice(DEGENERATE)), "seed": _seed(rng)}


def judge(case: Case) -> Verdict:
    """Compare both lanes."""
    run = _roll_outs if "roll_out" in case else _proofs if case["degenerate"] is None else _stretches
    found = run(case)
    return Verdict("kernel differs", replaced()) if replaced() else found


def _seed(rng: np.random.Generator) -> int:
    return int(rng.integers(2**31))


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


# Roll-outs of the smoother, with their projections, sensitivities, clearances and rows.

BENT = ("none", "straight", "fixed", "astray", "rate", "short", "huge")
_SHAPES = (((24, 2),), ((6, 3), (5, 2)), ((4, 2), (8, 5), (4, 12)), ((12, 4),))


def _roll_outs(case: Case) -> Verdict:
    try:
        problem = problem_of(case)
    except OptdockError as error:
        return Verdict(f"input refused: {type(error).__name__}", str(error))
    rng = np.random.default_rng(case["roll_out"])
    nlp, variables = drawn_program(rng, problem.start.as_array(), case["degenerate"])
    with using_kernels("twin"):
        places = project_and_roll_out(nlp, variables)[1].poses[:, :2]
    scene = scene_around(problem, places, float(rng.uniform(0.0, 0.1)), DEFAULT_SETTINGS.collision)
    scene = replace(scene, start_relief=float(rng.choice([0.0, 0.4])))
    found = []
    for lane in ("twin", "native"):
        with using_kernels(lane):
            found.append(rolled(replace(nlp, scene=scene), variables))
    # The largest of 0.0 and -0.0 is either, so zeros are compared without their signs.
    differing = [i for i, both in enumerate(zip(*found, strict=True)) if not np.array_equal(*both)]
    return Verdict("kernel differs", f"roll-out: {differing}") if differing else Verdict("equal roll-outs")


def drawn_program(rng: np.random.Generator, start: FloatArray, degenerate: str) -> tuple[NonlinearProgram, Variables]:
    """Draw bounds, a target and variables; see `BENT` for the last argument. The program has no cost and no scene.

    Short gears are long enough that poses differ: among vertices in equal places NumPy selects any.
    """
    basis = basis_for(_SHAPES[int(rng.integers(len(_SHAPES)))])
    lengths = rng.uniform(0.1, 2.0, basis.num_gears) * (1e-6 if degenerate == "short" else 1.0)
    curvature = rng.uniform(-2.0, 2.0, basis.num_knots) * rng.choice([0.01, 0.3, 1.0])
    signs = rng.choice([-1.0, 1.0], basis.num_gears)
    curvature *= 0.0 if degenerate == "straight" else 1.0
    start = start + np.array([_FAR, -_FAR, 0.0]) * (degenerate == "huge")
    with using_kernels("twin"):
        end = roll_out(basis, Variables(curvature, lengths), start, signs).poses[-1]
    away = 1.0 if degenerate == "astray" else rng.choice([0.0, 1e-6, 1e-3, 0.1])
    limit = np.full(basis.num_knots, 1.5)
    lower, upper = np.concatenate((-limit, 1e-12 * lengths)), np.concatenate((limit, 9.0 * lengths))
    if degenerate == "fixed":
        lower[0] = upper[0] = rng.choice([0.0, 0.4])
        lower[basis.num_knots - 1] = upper[basis.num_knots - 1] = 0.0
    rate = float(rng.choice([0.1, 1.0, 6.0])) if degenerate == "rate" else float(rng.choice([30.0, np.inf]))
    nlp = NonlinearProgram(
        basis,
        Ends(start, end + away * rng.normal(size=3), signs, float(rng.choice([0.5, 5.0]))),
        VariableBounds(lower, upper, rate),
        VariableBounds(0.999 * lower, 0.999 * upper, 0.99 * rate),
        cast(CostModel, None),
        cast(Scene, None),
        cast(TracedInput, None),
        lengths,
        0.5,
        DEFAULT_SETTINGS,
    )
    return nlp, Variables(curvature, lengths)


def rolled(nlp: NonlinearProgram, variables: Variables) -> list[FloatArray]:
    """Return all arrays of the projection of variables, and of its clearance and rows if the program has a scene."""
    basis, ends = nlp.basis, nlp.ends
    projected, driven = project_and_roll_out(nlp, variables)
    closed = onto_goal(basis, variables, ends, nlp.bounds, nlp.settings.projection)
    given, by = roll_out(basis, variables, ends.start, ends.signs), sensitivity(basis, projected, driven)
    found = [*projected, *driven, *closed, *given, *by, end_sensitivity(basis, projected, driven.moves)]
    if nlp.scene is not None:
        near = clearance_along(nlp.scene, basis, driven, ends.signs, 0.3)
        every = np.arange(near.margin.size)
        rows = separating_plane_rows(basis, driven, by, near, every, nlp.scene.settings)
        found += [near.table, *near.pairs, *near.required, *rows]
    return found
