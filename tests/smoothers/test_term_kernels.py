"""The kernels of terms are equal to NumPy to 1e-12: symbols, costs and shortfalls, rows, and samples of paths."""

import dataclasses
import shutil

import casadi
import numpy as np
import pytest

from experiments.families import FEASIBLE_FAMILIES, instance
from optdock.errors import FailedToSmoothPath
from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.pose import Pose2
from optdock.kernels import kernels_in_use, using_kernels
from optdock.model.path import ClothoidSegment, Path
from smoothers import CasadiSmoother, HardTerm, SoftTerm
from smoothers.scp.loop import evaluated
from smoothers.scp.rollout import roll_out
from smoothers.scp.term_functions import term_set
from smoothers.scp.term_rows import TermBound, linearized_terms, require_numbers, term_points, terms_along
from smoothers.scp.term_samples import samples_of
from tests.smoothers.test_terms import program_of

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")

PLANE = HardTerm("plane", lambda p: 0.2 - p.y + 0.3 * p.x * p.y)
BEND = HardTerm("bend", lambda p: 0.9 - p.curvature**2 - 0.2 * p.remaining)
KINK = HardTerm("kink", lambda p: casadi.sqrt(casadi.fabs(p.y)) - 0.1 * p.s * p.gear)
LATE = SoftTerm("late", lambda p: casadi.sin(p.remaining) * p.x + 0.2 * p.s - casadi.cos(p.yaw), weight=0.7)
SIDE = SoftTerm("side", lambda p: casadi.fmax(0, p.y - 0.1), weight=3.0)
GONE = HardTerm("gone", lambda p: casadi.log(p.x))  # not a number for x < 0
SETS = {"hard": (PLANE, BEND, KINK), "soft": (LATE, SIDE), "both": (PLANE, LATE, KINK, SIDE), "gone": (GONE,)}


def in_both_lanes(function, *arguments):
    """The result by NumPy, after a comparison with that of the kernel."""
    found = []
    for lane in ("twin", "native"):
        with using_kernels(lane):
            found.append(function(*arguments))
            assert "NumPy for" not in kernels_in_use()  # a kernel that differs in its first call is replaced
    assert_close(*found)
    return found[0]


def assert_close(one, other):
    if one is other:
        return
    if isinstance(one, tuple):
        assert len(one) == len(other)
        for a, b in zip(one, other, strict=True):
            assert_close(a, b)
    else:
        assert np.shape(one) == np.shape(other)
        assert other == pytest.approx(one, rel=1e-12, abs=1e-12, nan_ok=True)


@pytest.mark.parametrize("name", SETS)
@pytest.mark.parametrize("seed", range(4))
def test_terms_along_a_path_and_their_rows_are_equal_in_both_lanes(cases, name, seed):
    basis, variables, start, signs = cases.random_path(seed)
    rollout, rng = roll_out(basis, variables, start, signs), np.random.default_rng(seed)
    bound = TermBound(term_set(SETS[name]), signs, 0.7, 0.4, (0.1, 0.5, 1e9)[seed % 3], 0.3)
    if seed % 2:
        hard = len(bound.terms.hard)
        bound = dataclasses.replace(bound, margins=rng.uniform(0.0, 0.1, (basis.num_nodes, hard)))
    points = term_points(bound, basis, variables, rollout)
    along = in_both_lanes(terms_along, bound, basis, variables.lengths, points)
    assert along.worst == along.short.max()
    assert name != "gone" or (np.isinf(along.short) == (points[:, 0] < 0.0)).all()
    if not np.isfinite(along.values).all():
        with pytest.raises(FailedToSmoothPath, match="'gone' is not a finite number"):
            require_numbers(bound, points, along)
        assert along.acts
    else:
        added = in_both_lanes(linearized_terms, bound, basis, variables, rollout, along)
        assert along.acts
        assert (added.costs.size > 0) == (name != "hard")
        assert name != "soft" or added.node.size == 0
        assert name == "soft" or seed != 2 or added.node.size > 0


def test_terms_without_effect_do_not_act(cases):
    basis, variables, start, signs = cases.random_path(1)
    far = [HardTerm("far", lambda p: 100.0 - p.y), SoftTerm("floor", lambda p: casadi.fmax(0, p.y - 100.0))]
    bound = TermBound(term_set(far), signs, 0.0, 0.0, 0.35, 2.0)
    points = term_points(bound, basis, variables, roll_out(basis, variables, start, signs))
    assert not in_both_lanes(terms_along, bound, basis, variables.lengths, points).acts
    nearer = dataclasses.replace(bound, reach=200.0)
    assert in_both_lanes(terms_along, nearer, basis, variables.lengths, points).acts


@pytest.mark.parametrize("are_equal", [False, True])
def test_of_many_near_nodes_those_with_the_lowest_values_have_rows(are_equal):
    """A path of more nodes than rows; if the values of all nodes are equal, the first ones have rows."""
    case = instance(next(iter(FEASIBLE_FAMILIES)), 0)
    nlp, guess = program_of(case.problem, case.raw_path, [HardTerm("all", lambda p: 0.5 - 0.1 * casadi.sin(7.0 * p.x))])
    iterate = evaluated(nlp, np.concatenate(guess))
    assert nlp.basis.num_nodes > 48
    values = iterate.terms.values[:, 0]
    if are_equal:
        values[:] = 0.5
    bound = dataclasses.replace(nlp.terms, reach=1e9, bend=1e9)
    found = in_both_lanes(linearized_terms, bound, nlp.basis, iterate.variables, iterate.rollout, iterate.terms)
    lowest = np.sort(np.argsort(values, kind="stable")[:48])
    assert set(found.node) <= set(lowest)
    assert found.node.size >= 47  # the first node is given


@pytest.mark.parametrize("family", ["open_s", "alcove", "reverse_cusp"])
def test_the_kernel_of_an_evaluation_writes_the_symbols(family):
    case = instance(family, 0)
    nlp, guess = program_of(case.problem, case.raw_path, [HardTerm("far", lambda p: 100.0 - p.y), LATE])
    found = in_both_lanes(evaluated, nlp, np.concatenate(guess))
    wanted = term_points(nlp.terms, nlp.basis, found.variables, found.rollout)
    assert found.term_points == pytest.approx(wanted, rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("start", [Pose2(0.3, -0.2, 0.5), Pose2(0.0, 0.0, 31.0), Pose2(0.0, 0.0, -np.pi)])
def test_samples_of_clothoids_are_equal_in_both_lanes_and_lie_on_the_path(sign, start):
    rng = np.random.default_rng(sign + 1)
    knots = np.concatenate(([0.0], np.cumsum(rng.uniform(0.01, 0.6, 12))))
    bent = ClothoidSegment(ClothoidSpline(start, knots, rng.uniform(-6.0, 6.0, 13), sign))
    path = Path((bent,))
    points, s = in_both_lanes(samples_of, path, 0.4, 0.8)
    poses = path.poses_at(s)
    assert points[:, :2] == pytest.approx(poses[:, :2], abs=1e-9)
    assert np.exp(1j * points[:, 2]) == pytest.approx(np.exp(1j * poses[:, 2]), abs=1e-12)
    assert np.all((-np.pi <= points[:, 2]) & (points[:, 2] < np.pi))
    assert points[:, 3] == pytest.approx(path.curvature_at(s), abs=1e-9)
    only, _ = in_both_lanes(samples_of, path, 0.4, 0.8, {"curvature"})
    assert not only[:, :3].any()
    assert np.array_equal(only[:, 3:], points[:, 3:])


def test_results_are_equal_in_both_lanes():
    case = instance(next(iter(FEASIBLE_FAMILIES)), 1)
    smoother = CasadiSmoother(terms=[HardTerm("near", lambda p: 0.35 - p.curvature), LATE])
    paths = []
    for lane in ("twin", "native"):
        with using_kernels(lane):
            paths.append(smoother.smooth(case.raw_path, 30.0, problem=case.problem).path)
    one, other = (path.sample(0.05).poses for path in paths)
    assert one.shape == other.shape
    assert other == pytest.approx(one, abs=1e-9)
