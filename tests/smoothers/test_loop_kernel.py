"""The kernel of an iteration: evaluation and linearization are equal to NumPy to the last bit, steps to 1e-12."""

import dataclasses
import shutil

import numpy as np
import pytest

from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.kernels import kernels_in_use, using_kernels
from optdock.model.clearance_rule import ClearanceRule
from smoothers.scp.basis import Basis
from smoothers.scp.collision.collision_scene import scene_around
from smoothers.scp.collision.linearization import active_pairs
from smoothers.scp.cost import Weights
from smoothers.scp.goal_projection import driven_path
from smoothers.scp.loop import evaluated, linearized
from smoothers.scp.nlp import Formulation, NonlinearProgram, formulate
from smoothers.scp.qp_step import (
    NOTHING_ADDED,
    Additions,
    Linearization,
    Penalties,
    ProgramPool,
    StepBounds,
    linearize_and_solve_natively,
    solve_natively,
    solve_step,
)
from smoothers.scp.rollout import Variables
from smoothers.scp.settings import DEFAULT_SETTINGS

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")

L_SHAPE = np.array([[0.5, 0.3], [0.1, 0.3], [0.1, 0.5], [-0.4, 0.5], [-0.4, -0.3], [0.5, -0.3]])
FOOTPRINTS = {
    "box": Footprint.rectangle(0.45, 0.35, 0.6),
    "parts": Footprint(L_SHAPE),
    "disc": Footprint.from_radius(0.4),
}
CORNERS = (
    np.array([[0, 0], [1, 0], [1, 1], [0, 1]]),
    np.array([[1, 0.1], [0.2, 1], [-1, 0.3], [-0.3, -1], [0.6, -0.8]]),
)


def drawn(cases, seed, name, count=10, **changes):
    """A program among random obstacles of which many overlap the path, and random variables."""
    rng = np.random.default_rng(seed)
    basis, variables, start, signs = cases.random_path(seed, ((6, 2), (5, 3)))
    path = sketch(basis, variables, start, signs)
    places = path.sample(0.1).poses
    places = places[rng.integers(0, len(places), count), :2] + rng.uniform(-0.7, 0.7, (count, 2))
    posts = [place + rng.uniform(0.02, 0.5) * CORNERS[rng.integers(2)] for place in places]
    limits = {} if seed % 3 else {"max_curvature_rate": np.inf}
    goal = Pose2.from_sequence(path.end.as_array())
    problem = cases.open_problem(goal, obstacles=posts, footprint=FOOTPRINTS[name], start=path.start, **limits)
    rule = ClearanceRule(0.05, 0.0, 0.5) if seed % 2 else ClearanceRule(0.1, 0.02, 0.3, at_start=0.01)
    problem = dataclasses.replace(problem, clearance=rule)
    scene = scene_around(problem, path.sample(0.1).poses[:, :2], 0.02 * seed, DEFAULT_SETTINGS.collision)
    scene = dataclasses.replace(scene, settings=dataclasses.replace(scene.settings, **changes))
    nlp = formulate(path, problem, scene, Formulation(Weights(), 12, 0.15), None, DEFAULT_SETTINGS)
    size, lengths = nlp.basis.num_knots, nlp.lengths * rng.uniform(0.8, 1.2, 2)
    return nlp, Variables(rng.uniform(-0.8, 0.8, size), lengths)


def sketch(basis, variables, start, signs):
    """The path of the variables."""
    ends = type("Ends", (), {"start": start, "signs": signs})
    return driven_path(type("Program", (), {"basis": basis, "ends": ends}), variables)


def bits(found):
    """Memory of all arrays and numbers of a result, without signs of zeros."""
    if isinstance(found, tuple):
        return b"".join(bits(one) for one in found)
    if found is None or isinstance(found, NonlinearProgram | Basis):
        return b""
    return (np.asarray(found, dtype=np.float64) + 0.0).tobytes()


def in_both_lanes(function, *arguments):
    """The result by NumPy, after a comparison with that of the kernel."""
    found = []
    for lane in ("twin", "native"):
        with using_kernels(lane):
            found.append(function(*arguments))
    assert "NumPy for" not in kernels_in_use()  # a kernel that differs in its first call is replaced by its twin
    assert bits(found[0]) == bits(found[1])
    return found[0]


def linearized_in_both_lanes(current, buffer):
    """The linearization by NumPy, after a comparison with that of the kernel."""
    with using_kernels("twin"):
        found = linearized(current, buffer)
    step = ProgramPool(), StepBounds(0.2, 1.0, Penalties(300.0, 1000.0))
    assert bits(found) == bits(linearize_and_solve_natively(current, buffer, NOTHING_ADDED, *step)[0])
    return found


@pytest.mark.parametrize("name", FOOTPRINTS)
@pytest.mark.parametrize("seed", range(8))
def test_evaluation_and_linearization_are_equal_in_both_lanes(cases, name, seed):
    nlp, variables = drawn(cases, seed, name)
    start = in_both_lanes(evaluated, nlp, np.concatenate(variables))
    assert start.moved == 0.0
    linearized_in_both_lanes(start, 1e-3 * seed)
    changed = np.concatenate((start.variables.curvature + 0.05, 1.02 * start.variables.lengths))
    assert in_both_lanes(evaluated, nlp, changed, start).moved > 0.0


@pytest.mark.parametrize("name", FOOTPRINTS)
@pytest.mark.parametrize("seed", range(8))
def test_a_step_is_that_of_the_library_daqp(cases, name, seed):
    nlp, variables = drawn(cases, seed, name)
    around = linearized(evaluated(nlp, np.concatenate(variables)), 1e-3)
    pools, penalties = (ProgramPool(), ProgramPool()), Penalties(300.0 * 1.6**seed, 1000.0 * 1.6**seed)
    for trust_region, proximal in ((0.2, 1.0), (0.05, 3.0)):  # the second one begins with the active rows of the first
        steps = []
        for lane, pool in zip(("twin", "native"), pools, strict=True):
            with using_kernels(lane):
                steps.append(solve_step(nlp, around, pool, StepBounds(trust_region, proximal, penalties)))
        # Of rows that depend on each other, DAQP and the kernel may choose different ones, which changes roundings.
        np.testing.assert_allclose(steps[1].change, steps[0].change, rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(steps[1].gain, steps[0].gain, rtol=1e-11)
        assert np.array_equal(pools[0].latest.active, pools[1].latest.active)


@pytest.mark.parametrize("name", FOOTPRINTS)
@pytest.mark.parametrize("seed", range(8))
def test_the_guess_does_not_change_a_step(cases, name, seed):
    nlp, variables = drawn(cases, seed, name)
    around = linearized(evaluated(nlp, np.concatenate(variables)), 1e-3)
    pool, step = ProgramPool(), StepBounds(0.2, 1.0, Penalties(300.0, 1000.0))
    first = solve_natively(nlp, around, pool, step)
    again = solve_natively(nlp, around, pool, step)
    np.testing.assert_allclose(again.change, first.change, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("name", FOOTPRINTS)
@pytest.mark.parametrize("seed", range(8))
def test_a_step_is_the_same_in_one_call_with_the_linearization(cases, name, seed):
    nlp, variables = drawn(cases, seed, name)
    step = StepBounds(0.2, 1.0, Penalties(300.0, 1000.0))
    around, found = linearize_and_solve_natively(
        evaluated(nlp, np.concatenate(variables)), 1e-3, NOTHING_ADDED, ProgramPool(), step
    )
    assert bits(solve_natively(nlp, around, ProgramPool(), step)) == bits(found)


@pytest.mark.parametrize("name", FOOTPRINTS)
@pytest.mark.parametrize("added", [0, 1, 20, 60])  # of at most 48 rows
@pytest.mark.parametrize("has_costs", [False, True])
def test_added_costs_and_rows_are_those_of_the_twin(cases, name, added, has_costs):
    nlp, variables = drawn(cases, 3, name)
    step = dataclasses.replace(nlp.settings.step, clearance_rows=(12, 24, 48))
    nlp = dataclasses.replace(nlp, settings=dataclasses.replace(nlp.settings, step=step))
    current, size, rng = evaluated(nlp, np.concatenate(variables)), nlp.basis.size, np.random.default_rng(added)
    moved = rng.normal(size=(5, size))
    costs = np.concatenate((rng.normal(size=size), (moved.T @ moved).ravel())) if has_costs else np.empty(0)
    rows = rng.uniform(-0.1, 0.3, (added, 1 + size)).round(1)  # some gaps are equal
    rows[:1, 0] = -1.0  # the smallest
    more = Additions(costs, rows, rng.integers(1, nlp.basis.num_nodes, added))
    with using_kernels("twin"):
        around, without = linearized(current, 1e-3, more), linearized(current, 1e-3)
    within = StepBounds(0.2, 1.0, Penalties(300.0, 1000.0))
    natively, step = linearize_and_solve_natively(current, 1e-3, more, ProgramPool(), within)
    assert bits(around) == bits(natively)
    assert bits(solve_natively(nlp, around, ProgramPool(), within)) == bits(step)
    assert around.node.size <= 48
    assert (bits(without) == bits(around)) == (added == 0 and not has_costs)


@pytest.mark.parametrize("name", FOOTPRINTS)
def test_the_selection_of_rows_is_equal_in_both_lanes(cases, name):
    deep = thinned = cut = 0
    for seed in range(12):
        nlp, variables = drawn(cases, seed, name, count=25, few_planes=8, nearest=8)
        rows = (12, 24, 36, 48) if seed % 2 else (12, 24, 36, 48, 300)
        step = dataclasses.replace(nlp.settings.step, clearance_rows=rows)
        nlp = dataclasses.replace(nlp, settings=dataclasses.replace(nlp.settings, step=step))
        start = in_both_lanes(evaluated, nlp, np.concatenate(variables))
        around, found = linearized_in_both_lanes(start, 1e-3), start.clearance
        active = active_pairs(nlp.scene, found, nlp.basis.num_intervals, rows[-1] // 3)
        deep += active.penetrating.size > 0
        thinned += active.separated.size + active.penetrating.size < found.margin.size
        cut += around.node.size == rows[-1]
    assert min(deep, thinned, cut) >= 2


def test_without_obstacles_there_are_no_rows(cases):
    nlp, variables = drawn(cases, 3, "box", count=0)
    start = in_both_lanes(evaluated, nlp, np.concatenate(variables))
    around = linearized_in_both_lanes(start, 1e-3)
    assert start.shortfall == 0.0
    assert around.parts.rows.gradient.shape == (0, nlp.basis.size)


def test_a_program_that_no_library_solves_has_no_step(cases):
    nlp, variables = drawn(cases, 3, "box")
    start = evaluated(nlp, np.concatenate(variables))
    around = linearized(start, 1e-3)
    parts = around.parts
    around = Linearization.of(nlp.basis, parts._replace(goal=(parts.goal[0], np.full(3, np.nan))))
    for lane in ("twin", "native"):
        with using_kernels(lane):
            assert solve_step(nlp, around, ProgramPool(), StepBounds(0.2, 1.0, Penalties(300.0, 1000.0))) is None
