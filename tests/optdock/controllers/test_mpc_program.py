"""The program of the MPC: model compared with exact motion, cost to go with the Riccati equation."""

import math
import shutil

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from experiments.fuzz.kinds.kernels import replaced
from optdock.controllers.mpc_program import (
    CommandBounds,
    MpcCycle,
    MpcWeights,
    TrackingProgram,
    arcs_between,
    condensed,
    cost_to_go,
    predicted,
    riccati_back,
    step_matrices,
)
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2, Twist2
from optdock.kernels import using_kernels
from optdock.model.limits import MotionLimits
from optdock.model.robot import Robot
from optdock.simulation import Actuation, DifferentialDrive
from optdock.testing.drives import s_curve_drive

needs_compiler = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
LANES = ["twin", pytest.param("native", marks=needs_compiler)]
ROBOT = Robot(Footprint.rectangle(0.4, 0.3, 0.5), MotionLimits(max_speed=9.0, max_reverse_speed=9.0))


@pytest.fixture(autouse=True)
def _no_kernel_is_replaced():
    """A kernel whose first result differs is replaced by its twin, and would be equal to it."""
    yield
    assert replaced() == ""


def reference(times):
    row = s_curve_drive(Pose2(0.0, 0.0, 0.3)).sample_at(times)
    return np.column_stack((row.x, row.y, row.yaw))


def test_arcs_lead_from_each_pose_to_the_next():
    times = np.linspace(1.0, 5.0, 30)
    poses = reference(times)
    arcs = arcs_between(poses, times)
    for k in range(29):
        end = Pose2(*poses[k]).moved(Twist2(arcs.v[k], arcs.w[k]), arcs.h[k])
        rest = Pose2(*poses[k + 1]).in_frame_of(end)
        assert (rest.x, rest.y, rest.yaw) == pytest.approx((*arcs.residual[k], 0.0), abs=1e-12)
        assert math.hypot(*arcs.residual[k]) < 2e-4


@pytest.mark.parametrize("lag", [0.0, 0.1])
def test_the_model_is_the_derivative_of_exact_motion(lag):
    """Against the plant of the simulation, in central differences around the reference."""
    times = np.array([2.0, 2.05])
    poses = reference(times)
    arcs = arcs_between(poses, times)
    a, b, c = (matrix[0] for matrix in step_matrices(arcs, (lag, lag)))
    plant = DifferentialDrive(ROBOT, Actuation(linear_lag=lag, angular_lag=lag, longest_substep=0.05 / 200), 0.05)

    def exact(state, command):
        start = Pose2(*poses[0]) @ Pose2(*state[:3])
        end = plant.step(plant.moving(start, Twist2(*state[3:])), Twist2(*command))
        seen = end.pose.in_frame_of(Pose2(*poses[1]))
        return np.array([seen.x, seen.y, seen.yaw, end.twist.linear, end.twist.angular])

    v, w = arcs.v[0], arcs.w[0]
    rest, command = np.array([0.0, 0.0, 0.0, v, w]), np.array([v, w])
    assert np.abs(exact(rest, command) - (a @ rest + b @ command + c)).max() < 1e-6
    for k in range(5):
        bump = 1e-4 * np.eye(5)[k]
        slope = (exact(rest + bump, command) - exact(rest - bump, command)) / 2e-4
        assert np.abs(slope - a[:, k]).max() < 1e-3
    for k in range(2):
        bump = 1e-4 * np.eye(2)[k]
        slope = (exact(rest, command + bump) - exact(rest, command - bump)) / 2e-4
        assert np.abs(slope - b[:, k]).max() < 1e-3


def test_eliminated_states_are_those_of_the_recursion():
    times = np.concatenate(([2.0], 2.02 + 0.05 * np.arange(9)))
    matrices = step_matrices(arcs_between(reference(times), times), (0.1, 0.05))
    random = np.random.default_rng(3)
    state, commands = random.normal(size=5), random.normal(size=(9, 2))
    found = predicted(state, matrices)
    for k, (a, b, c) in enumerate(zip(*matrices, strict=True)):
        state = a @ state + b @ commands[k] + c
        assert found.errors[k] + found.by_commands[k] @ commands.ravel() == pytest.approx(state)


def test_the_cost_to_go_of_a_long_steady_drive_solves_the_riccati_equation():
    times = 0.1 * np.arange(400)
    poses = np.column_stack((0.3 * times, 0.0 * times, 0.0 * times))
    arcs = arcs_between(poses, times)
    stage, effort = np.array([1.0, 4.0, 2.0]), np.array([0.5, 0.2])
    a, b, _ = step_matrices(arcs, (0.0, 0.0))
    steady = solve_discrete_are(a[0, :3, :3], b[0, :3], 0.1 * np.diag(stage), 0.1 * np.diag(effort))
    assert riccati_back(arcs, stage, effort, np.array([9.0, 9.0, 9.0]))[0] == pytest.approx(steady, rel=1e-6)


@pytest.mark.parametrize("lag", [0.0, 0.1])
def test_the_cost_is_that_of_the_predicted_errors(lag):
    """Against the sum of the weighted squares, evaluated for random commands."""
    random, h = np.random.default_rng(5), np.array([0.02, *[0.05] * 7])
    times = 2.0 + np.concatenate(([0.0], np.cumsum(h)))
    poses = np.concatenate((reference(times), reference(times + lag)))
    state, weights, root = random.normal(size=5), np.array([2.0, 5.0, 1.5]), random.normal(size=(3, 3))
    after = root @ root.T
    found = condensed(poses, h, lag, state, weights, after)
    arcs = arcs_between(poses[:9], times - 2.0)
    prediction = predicted(state, step_matrices(arcs, (lag, lag)))

    def cost(u):
        errors = (prediction.errors + prediction.by_commands @ u)[:, :3]
        return 0.5 * float(np.sum(h[:, None] * weights * errors**2)) + 0.5 * float(errors[-1] @ after @ errors[-1])

    for _ in range(5):
        u = random.normal(size=16)
        assert 0.5 * u @ found.hessian @ u + found.gradient @ u == pytest.approx(cost(u) - cost(0.0 * u))
    assert found.errors == pytest.approx(prediction.errors[:, :3], abs=1e-12)
    assert found.by_commands == pytest.approx(prediction.by_commands[:, :3], abs=1e-12)
    leading = arcs_between(poses[9:], times - 2.0)
    assert found.nominal == pytest.approx(np.column_stack((leading.v, leading.w)), abs=1e-12)


def random_cycle(random, n):
    """Data of a cycle, also at rest, in turns in place, over whole turns of the yaw, and without limits."""
    first, other, infinite = *random.uniform(0.01, 0.2, 2), random.choice([1.0, np.inf], 3)
    moves = random.uniform(-0.03, 0.03, (2 * n + 2, 3)) * random.choice([0.0, 1.0], 3)
    poses = np.cumsum(moves, axis=0)
    poses[:, 2] += 2.0 * np.pi * random.integers(-2, 3, 2 * n + 2)
    root, limits = random.normal(size=(3, 3)), random.uniform(0.1, 2.0, 6)
    return MpcCycle(
        poses=poses,
        lengths=(first, other),
        lag=float(random.choice([0.0, 0.07, 0.3])),
        state=tuple(random.normal(size=5).tolist()),
        after=root @ root.T,
        nominal_before=tuple(random.normal(size=2).tolist()),
        last=tuple(random.normal(size=2).tolist()),
        last_acceleration=float(random.normal()),
        elapsed=float(random.uniform(0.01, 0.2)),
        bounds=CommandBounds((-0.2, 0.3), (-0.5, 0.6), 0.9 * limits[5] * infinite[0]),
        limits=MotionLimits(
            max_speed=limits[0],
            max_reverse_speed=limits[1],
            max_acceleration=limits[2],
            max_deceleration=limits[3],
            max_jerk=limits[4],
            max_yaw_acceleration=infinite[1],
            max_lateral_acceleration=limits[5] * infinite[0],
            max_wheel_speed=infinite[2],
        ),
        curvature=None,
    )


def filled_program(cycle, weights, n, tube, lane):
    """Arrays of the program for a cycle, and the commands that follow the reference."""
    program = TrackingProgram(n, weights, ackermann=False, tube=tube)
    with using_kernels(lane):
        program.fill(cycle)
    return *program._program[:4], program.nominal


@needs_compiler
@pytest.mark.parametrize("seed", range(30))
def test_both_lanes_are_equal_up_to_rounding(seed):
    random = np.random.default_rng(seed)
    n, tube = int(random.integers(3, 20)), ((0.03, 0.1), None)[seed % 2]
    weights, cycle = MpcWeights(*(random.uniform(0.1, 9.0, size) for size in (3, 2, 2, 3))), random_cycle(random, n)
    times, found = np.concatenate(([0.0], np.cumsum(random.uniform(0.01, 0.2, n)))), []
    for lane in ("twin", "native"):
        with using_kernels(lane):
            costs = cost_to_go(cycle.poses[: n + 1], times, weights)
        found.append((*filled_program(cycle, weights, n, tube, lane), costs))
    for one, other in zip(*found, strict=True):
        assert np.abs(one - other).max() <= 1e-11 * max(1.0, np.abs(one).max())


@pytest.mark.parametrize("lane", LANES)
@pytest.mark.parametrize("seed", range(10))
def test_plans_of_commands_satisfy_the_bounds_and_cost_least(lane, seed):
    """On the way from the solution to other feasible commands the cost rises, and at once."""
    random, n = np.random.default_rng(seed), 8
    weights = MpcWeights(*(random.uniform(0.1, 9.0, size) for size in (3, 2, 2, 3)))
    cycle = random_cycle(random, n)._replace(
        last=(0.05, 0.1), last_acceleration=0.0, bounds=CommandBounds((-0.1, 0.1), (-0.3, 0.3), 0.1)
    )
    program = TrackingProgram(n, weights, ackermann=False, tube=(0.03, 0.1))
    with using_kernels(lane):
        found = program.solve(cycle)
    assert found is not None
    h, g, a, bounds, *_ = program._program
    u = np.concatenate((found.commands.ravel(), [found.outside, found.over_jerk]))

    def excess(u):
        values = np.concatenate((u, a @ u))
        return float(np.maximum(bounds[0] - values, values - bounds[1]).max())

    def cost(u):
        return 0.5 * float(u @ h @ u) + float(g @ u)

    assert excess(u) <= 1e-8
    constant = np.concatenate((np.tile(cycle.last, n), [1e3, 1e3]))  # feasible by the slacks
    assert excess(constant) <= 0.0
    for share in (1e-4, 1e-2, 1.0):
        assert cost(u + share * (constant - u)) > cost(u)


def test_whole_turns_of_the_yaw_are_no_motion():
    times = np.linspace(1.0, 3.0, 12)
    poses = reference(times)
    turned = poses + np.outer(np.arange(12) % 3, [0.0, 0.0, 2.0 * np.pi])
    for one, other in zip(arcs_between(poses, times), arcs_between(turned, times), strict=True):
        assert one == pytest.approx(other, abs=1e-12)
