from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from optdock.model.limits import SpeedZone
from optdock.model.path import Path
from optdock.timing import reference_program
from optdock.timing.forward_backward import forward_backward_pass
from optdock.timing.jerk_phases import MotionState, state_after
from optdock.timing.path_limits import ReferenceBounds, limits_along
from optdock.timing.reference_program import (
    applied,
    coefficients_of,
    initial_guess,
    jerk_step_bands,
    limit_rows,
    solve_reference,
    spline_of,
    spline_phases,
)

REST = MotionState()


@pytest.fixture(autouse=True)
def _free_jerk_steps(monkeypatch):
    monkeypatch.setattr(reference_program, "_JERK_STEP_PRICE", 0.0)


def _solved(make, all_limits, seed, start=REST):
    path = make.random_path(np.random.default_rng(seed), length=3.0)
    along = limits_along(path, all_limits, SpeedZone(0.15, 0.4))[0]
    bounds = ReferenceBounds(along)
    return bounds, solve_reference(bounds, start)


@pytest.mark.parametrize("seed", range(4))
def test_knots_are_on_the_zone_start_and_large_jumps(make, all_limits, seed):
    bounds, found = _solved(make, all_limits, seed)
    grid, launch, stop = found.grid, found.launch, found.stop
    assert grid.knots[grid.zone] == pytest.approx(bounds.limits.zone_start, abs=1e-12)
    assert (grid.knots[0], grid.knots[-1]) == (launch.state.s, stop.state.s)
    assert np.all(grid.steps > 0.0)
    jumps = bounds.limits.s[bounds.jumps]
    jumps = jumps[(jumps > grid.knots[0]) & (jumps < grid.knots[-1])]
    on_a_knot = [np.min(np.abs(grid.knots - s)) < 1e-9 for s in jumps]
    assert np.mean(on_a_knot) > 0.6


def test_the_stop_arc_ends_at_rest_at_the_end(make, all_limits):
    _bounds, found = _solved(make, all_limits, 1)
    launch, stop = found.launch, found.stop
    assert state_after(stop.state, *stop.phases[0]) == pytest.approx((3.0, 0.0, 0.0), abs=1e-12)
    assert state_after(MotionState(), *launch.phases[0]) == pytest.approx(tuple(launch.state), abs=1e-15)


def test_stencils_are_value_slope_and_curvature_of_one_spline():
    rng = np.random.default_rng(3)
    steps, c = rng.uniform(0.5, 2.0, 12), rng.uniform(0.5, 1.0, 14)
    spline = spline_of(steps)
    x, a, curve = (applied(part, c) for part in (spline.right_value, spline.right_slope, spline.curve))
    # From the right knot of a cell over the next cell: x + 2 a h + x'' h^2 / 2, a + x'' h / 2.
    h = steps[1:]
    np.testing.assert_allclose(x[1:], x[:-1] + 2.0 * a[:-1] * h + 0.5 * curve[1:] * h * h, atol=1e-12)
    np.testing.assert_allclose(a[1:], a[:-1] + 0.5 * curve[1:] * h, atol=1e-12)
    half = 0.5 * h
    middle = x[:-1] + 2.0 * a[:-1] * half + 0.5 * curve[1:] * half * half
    np.testing.assert_allclose(applied(spline.centre_value, c)[1:], middle, atol=1e-12)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("start", [MotionState(), MotionState(0.0, 0.15, 0.1)])
def test_the_reference_keeps_its_limits_and_its_ends(make, all_limits, seed, start):
    _bounds, found = _solved(make, all_limits, seed, start)
    grid, launch, stop = found.grid, found.launch, found.stop
    assert found.iterations < 30
    ends = [(found.table[0][i], found.table[1][i], found.table[2][i]) for i in (0, -1)]
    assert ends == [tuple(launch.state), tuple(stop.state)]
    assert np.all(found.table[1][1:-1] ** 2 <= grid.bound[1:-1] * 1.01)
    assert found.table[2].max() <= all_limits.max_acceleration * 1.01
    assert found.table[2].min() >= -all_limits.max_deceleration * 1.01
    jerk = found.table[4, :-1]
    assert jerk.max() <= all_limits.max_jerk * 1.01
    for rate in grid.rate:
        yaw = np.abs(grid.curvature * found.table[2] + rate * found.table[1] ** 2)
        assert np.all(yaw[1:-1] <= all_limits.max_yaw_acceleration)


@pytest.mark.parametrize("seed", range(4))
def test_the_reference_uses_up_the_lateral_jerk_and_keeps_it(make, all_limits, seed):
    _bounds, found = _solved(make, replace(all_limits, max_lateral_jerk=0.1), seed)
    grid = found.grid
    sideways = [
        np.abs(found.table[1] * (2.0 * grid.curvature * found.table[2] + rate * found.table[1] ** 2))
        for rate in grid.rate
    ]
    assert 0.09 < np.max(np.maximum(*sideways)[1:-1]) <= 0.1 * (1.0 - 0.02) * 1.01
    assert found.iterations < 35


@pytest.mark.parametrize("seed", range(3))
def test_an_independent_solver_finds_no_faster_spline(make, all_limits, seed):
    casadi = pytest.importorskip("casadi")
    bounds, found = _solved(make, all_limits, seed)
    grid, launch, stop = found.grid, found.launch, found.stop
    guess = initial_guess(grid, bounds, forward_backward_pass(bounds, REST), launch.state, stop.state)
    spline = spline_of(grid.steps)
    rows = limit_rows(grid, bounds, spline).linear
    start = coefficients_of(grid.steps, guess, launch.state, stop.state)
    c = casadi.SX.sym("c", start.size)

    def mapped(stencil):
        return sum(casadi.DM(stencil[k]) * c[k : k + grid.steps.size] for k in range(3))

    linear = [mapped(rows[:, r]) - 1.0 for r in range(rows.shape[1])]
    knots = casadi.vertcat(start[:2] @ [0.5, 0.5], mapped(spline.right_value))
    bend = mapped(spline.curve) / (2.0 * bounds.jerk)
    roots = [casadi.sqrt(casadi.fmax(side, 1e-9)) for side in (knots[:-1], knots[1:], c[1:-1])]
    jerk = [sign * bend * root - 1.0 for root in roots for sign in (1.0, -1.0)]
    program = {"x": c, "f": casadi.dot(casadi.DM(grid.steps), c[1:-1] ** -0.5), "g": casadi.vertcat(*linear, *jerk)}
    options = {"ipopt.print_level": 0, "print_time": False, "ipopt.sb": "yes"}
    solver = casadi.nlpsol("reference", "ipopt", program, options)
    lower, upper = np.full(start.size, 1e-6), np.full(start.size, 10.0)
    lower[[0, 1, -2, -1]] = upper[[0, 1, -2, -1]] = start[[0, 1, -2, -1]]
    best = solver(x0=np.clip(start, lower, upper), lbx=lower, ubx=upper, lbg=-np.inf, ubg=0.0)
    assert solver.stats()["success"]
    ours = np.sum(2.0 * grid.steps / (found.table[1][:-1] + found.table[1][1:]))
    x = np.append(launch.state.v**2, applied(spline.right_value, np.array(best["x"]).ravel()))
    theirs = np.sum(2.0 * grid.steps / (np.sqrt(x[:-1]) + np.sqrt(x[1:])))
    assert ours == pytest.approx(theirs, rel=4e-3)


def test_spline_phases_reproduce_the_knots(make, all_limits):
    _bounds, found = _solved(make, all_limits, 2)
    state = found.launch.state
    for n, phase in enumerate(spline_phases(*found.table[:3])):
        state = state_after(state, *phase)
        if n % 2:
            knot = (n + 1) // 2
            assert state == pytest.approx((found.table[0][knot], found.table[1][knot], found.table[2][knot]), abs=1e-9)


def test_jerk_step_bands_are_the_squared_steps_of_the_second_derivative():
    rng = np.random.default_rng(5)
    steps, c, weight = rng.uniform(0.5, 2.0, 9), rng.uniform(0.5, 1.0, 11), rng.uniform(0.5, 1.5, 8)
    spline = spline_of(steps)
    bands = jerk_step_bands(spline, weight)
    matrix = sum(np.diag(bands[3 - d, d:], d) for d in range(4))
    matrix = matrix + np.triu(matrix, 1).T
    wanted = np.sum((weight * np.diff(applied(spline.curve, c))) ** 2)
    assert 0.5 * c @ matrix @ c == pytest.approx(wanted, rel=1e-12)


def test_knots_are_wider_at_constant_speed(make, all_limits):
    along = limits_along(Path((make.spline([6.0], [0.0, 0.0]),)), all_limits, SpeedZone())[0]
    grid = solve_reference(ReferenceBounds(along), REST).grid
    duration = np.diff(grid.time)
    assert duration[grid.steps.size // 2] == pytest.approx(0.16, rel=0.05)
    assert duration[0] == pytest.approx(0.08, rel=0.05)
