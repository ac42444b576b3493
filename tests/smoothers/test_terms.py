"""Terms as expressions: their symbols, errors, derivatives, and the symbolic program as the oracle of the search."""

import dataclasses
import math
import pickle
import threading

import casadi
import numpy as np
import pytest

from experiments.benchmarks.symbolic_program import (
    cost_expression,
    end_error,
    model_for,
    rate_rows,
    term_expressions,
)
from experiments.families import instance
from optdock.deadline import Deadline
from optdock.errors import InvalidValue
from optdock.geometry.pose import Pose2
from optdock.model.robot import Drive
from optdock.plugins.interfaces import never_cancelled
from optdock.quadratic_program import minimizer
from smoothers import CasadiSmoother, HardTerm, SoftTerm
from smoothers.scp import term_rows
from smoothers.scp.collision.linearization import ClearanceRows
from smoothers.scp.cost import Quadratic
from smoothers.scp.goal_projection import end_sensitivity
from smoothers.scp.loop import additions, evaluated, judged
from smoothers.scp.qp_step import (
    Linearization,
    Penalties,
    ProgramPool,
    StepBounds,
    Subproblem,
    blocks_for,
    step_program,
    trusted_nodes,
)
from smoothers.scp.rollout import Variables, roll_out, sensitivity
from smoothers.scp.search import Solver
from smoothers.scp.term_functions import term_set
from smoothers.scp.term_rows import TermBound, linearized_terms, term_points, terms_along
from smoothers.terms import SYMBOLS

TERMS = (
    HardTerm("plane", lambda p: p.wall - p.y + 0.3 * p.x * p.y, wall=0.2),
    SoftTerm("zone", lambda p: casadi.fmax(0, casadi.fabs(p.curvature) - 0.3) * p.gear, weight=2.0),
    HardTerm("facing", lambda p: casadi.cos(p.yaw - p.bearing) + 0.1 * p.s**2, bearing=0.4),
    SoftTerm("late", lambda p: casadi.sin(p.remaining) * p.x + 0.2 * p.s, weight=0.7),
    HardTerm("bend", lambda p: 0.9 - p.curvature**2 - 0.2 * p.remaining),
)
STEP = 1e-6


def bound_of(signs, terms=TERMS, reach=1e9):
    return TermBound(term_set(terms), signs, 0.7, 0.4, reach, 3.0)


def no_rows(basis):
    return ClearanceRows(np.zeros((0, basis.size)), np.zeros(0), np.zeros(0, dtype=np.int64))


def test_the_symbols_are_those_of_the_path_in_their_order(cases):
    basis, variables, start, signs = cases.random_path(4)
    rollout = roll_out(basis, variables, start, signs)
    bound = bound_of(signs, [HardTerm(name, lambda p, name=name: getattr(p, name)) for name in SYMBOLS])
    x, y, yaw, curvature, s, remaining, gear = bound.terms.values(term_points(bound, basis, variables, rollout)).T
    assert np.column_stack((x, y)) == pytest.approx(rollout.poses[:, :2])
    assert np.exp(1j * yaw) == pytest.approx(np.exp(1j * rollout.poses[:, 2]))
    assert np.abs(yaw).max() <= math.pi
    assert curvature == pytest.approx(rollout.curvature)
    assert gear == pytest.approx(signs[basis.node_gear])
    assert s[0] == pytest.approx(0.7)
    assert remaining[-1] == pytest.approx(0.4)
    assert s + remaining == pytest.approx(np.full(s.size, variables.lengths.sum() + 1.1))
    steps = np.diff(s)[basis.left]
    assert steps == pytest.approx(rollout.steps)


def test_blocks_of_points_are_the_functions_of_the_terms_one_by_one():
    terms, rng = term_set(TERMS), np.random.default_rng(1)
    for count in (1, 31, 32, 33, 200):
        points = rng.normal(size=(count, 7))
        both, known = terms.with_slopes(points), len(TERMS)
        values, slopes = both[:, :known], both[:, known:].reshape(count, 6, known)
        assert np.array_equal(values, terms.values(points))
        for k, term in enumerate((*terms.hard, *terms.soft)):
            one = term.function.function
            symbols = one.sx_in()
            slope = casadi.Function("d", symbols, [casadi.jacobian(one(*symbols)[0], symbols[0])])
            parameters = list(term.values.values())
            assert values[:, k] == pytest.approx([float(one(row, parameters)[0]) for row in points], abs=1e-14)
            wanted = np.array([np.array(casadi.DM.full(slope(row, parameters))).ravel()[:6] for row in points])
            assert slopes[:, :, k] == pytest.approx(wanted, abs=1e-14)


def test_many_points_are_evaluated_in_parts():
    terms, points = term_set(TERMS), np.random.default_rng(2).normal(size=(10_000, 7))
    parts = [terms.values(points[begin : begin + 1000]) for begin in range(0, 10_000, 1000)]
    assert np.array_equal(terms.values(points), np.concatenate(parts))


@pytest.mark.parametrize("seed", range(3))
def test_rows_and_gradients_are_those_of_differences(cases, seed):
    basis, variables, start, signs = cases.random_path(seed)
    bound, knots = bound_of(signs), basis.num_knots

    def along(flat):
        moved = Variables(flat[:knots], flat[knots:])
        rollout = roll_out(basis, moved, start, signs)
        points = term_points(bound, basis, moved, rollout)
        return bound.terms.values(points)[:, :3], terms_along(bound, basis, moved.lengths, points).cost

    flat, rollout = np.concatenate(variables), roll_out(basis, variables, start, signs)
    points = term_points(bound, basis, variables, rollout)
    found = terms_along(bound, basis, variables.lengths, points)
    added = linearized_terms(bound, basis, variables, rollout, found)
    nothing = Quadratic(np.zeros(basis.size), np.zeros((basis.size, basis.size)))
    quadratic, rows = added.to(nothing, no_rows(basis))
    hard, soft = [], []
    for shift in STEP * np.eye(flat.size):
        (up, above), (down, below) = along(flat + shift), along(flat - shift)
        hard.append((up - down) / (2.0 * STEP))
        soft.append((above - below) / (2.0 * STEP))
    assert quadratic.gradient == pytest.approx(np.array(soft), rel=1e-5, abs=1e-6)
    hard = np.array(hard)
    expected = [hard[:, node, k] for k in range(3) for node in range(basis.num_nodes)]
    kept = [row for row in expected if np.abs(row).max() > 1e-9]
    assert rows.gap.size == len(kept)
    assert rows.gradient == pytest.approx(np.array(kept), rel=1e-5, abs=1e-6)
    assert np.linalg.eigvalsh(quadratic.hessian).min() > -1e-9


def program_of(problem, path, terms=TERMS):
    """The nonlinear program of a smoothing task, and a solver that made it."""
    smoother = CasadiSmoother(terms=terms)
    solver = Solver(ProgramPool(), Deadline(60.0), never_cancelled, smoother.settings)
    nlp, guesses = solver.prepared(smoother.call_for(path, problem))
    return nlp, guesses.first.variables


def programs(cases):
    ahead = Pose2(3.2, 0.7, 0.0)
    steered = {"wheelbase": 0.5, "max_steering_rate": 0.7}
    # The hard term at the start is satisfied there.
    terms = (*TERMS[1:4], HardTerm("plane", lambda p: p.wall - p.y + 0.1 * p.curvature, wall=3.0))
    yield program_of(cases.open_problem(ahead), cases.kinked((0.0, 0.0), (1.2, 0.0), (2.0, 0.7), (3.2, 0.7)), terms)
    case = instance("reverse_cusp", 0)
    limits = dataclasses.replace(case.problem.robot.limits, **steered)
    car = dataclasses.replace(case.problem.robot, drive=Drive.ACKERMANN, limits=limits)
    yield program_of(dataclasses.replace(case.problem, robot=car), case.raw_path, TERMS[1:4])


def oracle_of(nlp):
    """The function of the variables that returns cost, goal error, rate rows and hard terms with their derivatives."""
    model = model_for(nlp.basis.shape)
    soft, hard = term_expressions(model, nlp.terms)
    values = [
        cost_expression(model, nlp.cost) + soft,
        end_error(model, nlp.ends.target),
        rate_rows(model, nlp.inner_bounds.rate),
        casadi.vec(hard),
    ]
    slopes = [casadi.jacobian(value, model.variables) for value in values]
    function = casadi.Function("oracle", [model.variables, model.start, model.signs], [*values, *slopes])

    def oracle(variables):
        found = function(np.concatenate(variables), nlp.ends.start, nlp.ends.signs)
        return [np.array(one.full()) for one in found]

    return oracle


def rate_rows_of_the_step(nlp, around):
    """The rows of the curvature rate in the quadratic program, and their right sides."""
    basis = nlp.basis
    program = step_program(nlp, around, ProgramPool(), StepBounds(0.5, 1.0, Penalties(300.0, 3000.0)))
    assert minimizer(program) is not None
    blocks = blocks_for(basis, basis.span_gear.size, around.node.size, nlp.settings.step)
    up, down, upper = blocks.rate_up, blocks.rate_down, program.bounds[1, len(program.g) :]
    rows = np.concatenate((program.a[up, blocks.path], program.a[down, blocks.path]))
    return rows, np.concatenate((upper[up], upper[down]))


@pytest.mark.parametrize("which", [0, 1])
def test_the_whole_program_is_the_symbolic_one(cases, which, monkeypatch):
    """Values and derivatives of cost, terms, goal error and rate rows at random variables, to 1e-9."""
    monkeypatch.setattr(term_rows, "_MOST_ROWS", 10_000)
    nlp, guess = list(programs(cases))[which]
    basis, rng, oracle = nlp.basis, np.random.default_rng(7), oracle_of(nlp)
    assert (which == 1) == (nlp.cost.easing is not None)  # the second robot has steered wheels
    for _ in range(3):
        bends = guess.curvature + rng.uniform(-0.3, 0.3, basis.num_knots)
        variables = Variables(bends, guess.lengths * rng.uniform(0.9, 1.1, basis.num_gears))
        value, error, rate, hard, gradient, by_goal, by_rate, by_terms = oracle(variables)
        rollout = roll_out(basis, variables, nlp.ends.start, nlp.ends.signs)
        iterate, by = judged(nlp, variables, rollout, 0.1), sensitivity(basis, variables, rollout)
        assert iterate.cost == pytest.approx(value.item(), rel=1e-11)
        assert iterate.end_error == pytest.approx(error.ravel(), abs=1e-9)
        everywhere = dataclasses.replace(nlp.terms, reach=1e9)
        added = linearized_terms(everywhere, basis, variables, rollout, iterate.terms)
        quadratic, rows = added.to(nlp.cost.quadratic(variables, rollout, by), no_rows(basis))
        assert quadratic.gradient == pytest.approx(gradient.ravel(), rel=1e-9, abs=1e-9)
        goal = end_sensitivity(basis, variables, rollout.moves), iterate.end_error
        assert goal[0] == pytest.approx(by_goal, abs=1e-9)
        kept = np.flatnonzero(np.abs(by_terms).max(axis=1) > 1e-9)
        assert rows.gap == pytest.approx(hard.ravel()[kept], abs=1e-9)
        assert rows.gradient == pytest.approx(by_terms[kept], abs=1e-9)
        headings = by.yaw[trusted_nodes(basis, nlp.settings.step)]
        parts = Subproblem(variables, quadratic, np.eye(basis.size), goal, headings, rows.lowest(400))
        around = Linearization.of(basis, parts)
        made, limits = rate_rows_of_the_step(nlp, around)
        assert made == pytest.approx(by_rate, abs=1e-9)
        assert -limits == pytest.approx(rate.ravel(), abs=1e-9)


@pytest.mark.parametrize(
    ("expression", "says"),
    [
        (lambda p: p.wal, "did you mean wall"),
        (lambda p: casadi.vertcat(p.x, p.y), r"scalar, got a matrix of shape \(2, 1\)"),
        (lambda p: casadi.SX.sym("speed") * p.x, "depends on speed"),
        (lambda _: casadi.SX.sym("x"), "symbols of another term"),
        (lambda _: casadi.MX.sym("x"), "got MX"),
        (lambda _: None, "got NoneType"),
        (lambda _: math.nan, "must be finite"),
        (lambda _: casadi.log(casadi.SX(0.0)), "must be finite"),
        (lambda p: p.x / "m", "Error"),
        ("p.x", "must be a function"),
    ],
)
def test_a_wrong_expression_is_refused_with_the_name_of_its_term(expression, says):
    with pytest.raises(InvalidValue, match=f"'mine'.*{says}"):
        HardTerm("mine", expression, wall=1.0)


def test_wrong_values_and_sets_are_refused():
    with pytest.raises(InvalidValue, match="'mine': parameter 'gear': has the name of a symbol"):
        HardTerm("mine", lambda p: p.x, gear=1.0)
    with pytest.raises(InvalidValue, match="'mine': wall"):
        HardTerm("mine", lambda p: p.x, wall=math.inf)
    with pytest.raises(InvalidValue, match="'mine': weight"):
        SoftTerm("mine", lambda p: p.x, weight=-1.0)
    with pytest.raises(InvalidValue, match="no parameter 'wal'; did you mean wall"):
        HardTerm("mine", lambda p: p.x + p.wall, wall=1.0).with_values(wal=2.0)
    with pytest.raises(InvalidValue, match=r"terms\[1\]: there is another term 'plane'"):
        CasadiSmoother(terms=[TERMS[0], TERMS[0].with_values(wall=1.0)])
    with pytest.raises(InvalidValue, match=r"write terms=\[...\]"):
        CasadiSmoother(terms=TERMS[0])
    with pytest.raises(InvalidValue, match="must be a list of terms, got None"):
        CasadiSmoother(terms=None)
    with pytest.raises(InvalidValue, match=r"terms\[0\]"):
        CasadiSmoother(terms=[lambda p: p.x])


@pytest.mark.parametrize(
    ("expression", "bad"),
    [
        (lambda p: casadi.fmin(1.0, casadi.log(p.x)), [True, False]),
        (lambda p: casadi.fmax(-1.0, 2.0 * casadi.sqrt(p.x)), [True, False]),
        (lambda p: casadi.if_else(casadi.log(p.x) < 3.0, 1.0, 2.0), [True, False]),
        (lambda p: casadi.if_else(p.x > 0.0, casadi.fmin(1.0, casadi.log(p.x)), 2.0), [False, False]),
        (lambda p: casadi.if_else(p.x > 0.0, 2.0, casadi.fmin(1.0, casadi.log(p.x))), [True, False]),
        (lambda p: casadi.fmin(1.0, casadi.fabs(p.x)), [False, False]),
        (lambda p: casadi.if_else(casadi.log(p.x), 1.0, 2.0), [True, False]),
        (lambda p: 1.0 + casadi.logic_not(casadi.log(p.x)), [True, False]),
        (lambda p: 1.0 + casadi.logic_and(casadi.log(p.x), p.y), [True, False]),
        (lambda p: casadi.copysign(2.0 + p.y, casadi.fabs(casadi.log(p.x))), [True, False]),
        (lambda p: casadi.log(p.x) ** p.y, [True, False]),
        (lambda p: casadi.power(1.0 + 0.0 * p.y, casadi.log(p.x)), [True, False]),
    ],
)
def test_a_number_that_does_not_exist_is_not_hidden_by_minima_and_comparisons(expression, bad):
    points = np.zeros((2, 7))
    points[:, 0] = -1.0, 2.0
    terms = term_set([HardTerm("mine", expression)])
    assert np.isnan(terms.values(points)[:, 0]).tolist() == bad
    assert np.isnan(terms.with_slopes(points)[:, 0]).tolist() == bad


def test_other_values_need_no_other_functions_and_leave_the_term_as_it_is():
    term, points = TERMS[0], np.zeros((1, 7))
    other = term.with_values(wall=0.9)
    assert other.function is term.function
    assert term_set([term]).values(points)[0, 0] == pytest.approx(0.2)
    assert term_set([other]).values(points)[0, 0] == pytest.approx(0.9)
    assert TERMS[1].with_weight(5.0).weight == 5.0
    assert TERMS[1].weight == 2.0


def test_terms_made_of_lambdas_can_be_pickled():
    points = np.random.default_rng(2).normal(size=(70, 7))
    smoother = pickle.loads(pickle.dumps(CasadiSmoother(terms=TERMS)))
    assert np.array_equal(term_set(smoother.terms).values(points), term_set(TERMS).values(points))


def test_threads_evaluate_the_same_terms_at_once():
    terms, points, wrong = term_set(TERMS), np.random.default_rng(3).normal(size=(300, 7)), []
    wanted = terms.with_slopes(points)

    def work(shift):
        for _ in range(100):
            mine = points + shift
            others = terms.with_slopes(mine)
            HardTerm("another", lambda p: p.x * p.y)
            back = terms.with_slopes(points)
            if not (np.array_equal(back, wanted) and others.shape == wanted.shape and np.isfinite(others).all()):
                wrong.append(shift)

    threads = [threading.Thread(target=work, args=(0.1 * k,)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []


def test_added_rows_have_the_buffer_of_the_clearance_rows():
    """It grows with the distance from both ends of the path, up to the whole buffer."""
    case = instance("open_s", 0)
    nlp, guess = program_of(case.problem, case.raw_path, [HardTerm("near", lambda p: 0.1 + 0.0001 * p.y)])
    near = dataclasses.replace(nlp, terms=dataclasses.replace(nlp.terms, reach=1e9))
    iterate = evaluated(near, np.concatenate(guess))
    bare, buffered = additions(iterate, 0.0), additions(iterate, 0.01)
    place = iterate.rollout.poses[bare.node, :2]
    to_end = np.minimum(*(np.hypot(*(place - end[:2]).T) for end in (nlp.ends.start, nlp.ends.target)))
    wanted = 0.01 * np.minimum(1.0, to_end / nlp.settings.step.buffer_taper)
    assert wanted.max() == 0.01
    assert bare.rows[:, 0] - buffered.rows[:, 0] == pytest.approx(wanted, abs=1e-12)


def test_shortfalls_of_terms_are_those_of_their_zones_and_less_by_the_allowance_at_the_ends():
    case = instance("open_s", 0)
    far = [HardTerm("far", lambda p: 100.0 - p.y)]
    nlp, guess = program_of(case.problem, case.raw_path, far)
    # The margins are what the values lack, at the first, the last, and one other node.
    hundred = evaluated(nlp, np.concatenate(guess)).terms.values
    allowance = nlp.settings.loop.end_allowance
    for node, allowed in ((0, allowance), (nlp.basis.num_nodes - 1, allowance), (20, 0.0)):
        margins = np.zeros((nlp.basis.num_nodes, 1))
        margins[node] = hundred[node] + 0.02
        bound = dataclasses.replace(nlp.terms, margins=margins)
        found = evaluated(dataclasses.replace(nlp, terms=bound), np.concatenate(guess))
        assert found.shortfall == pytest.approx(0.02 - allowed, abs=1e-9)
        assert np.count_nonzero(found.zones) == 1
