"""Identification of the drive's delay from commands and speeds."""

import shutil

import numpy as np
import pytest

from experiments.fuzz.kinds.kernels import replaced
from optdock.controllers.delay_estimate import DelayEstimate, advanced
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2, Twist2
from optdock.kernels import using_kernels
from optdock.model.limits import MotionLimits
from optdock.model.robot import Robot
from optdock.simulation import Actuation, DifferentialDrive

ROBOT = Robot(Footprint.from_radius(0.3), MotionLimits())
RAMP = [min(0.4, 0.008 * k) for k in range(120)]


@pytest.fixture(autouse=True)
def _no_kernel_is_replaced():
    """A kernel whose first result differs is replaced by its twin, and would be equal to it."""
    yield
    assert replaced() == ""


def identified(actuation, commands=RAMP, known=0.0):
    plant, estimate = DifferentialDrive(ROBOT, actuation), DelayEstimate(known)
    state = plant.at_rest(Pose2(0.0, 0.0, 0.0))
    for command in commands:
        state = plant.step(state, Twist2(command))
        estimate.update(command, state.twist.linear, 0.02)
    return estimate.delay


@pytest.mark.parametrize(("lag", "latency"), [(0.0, 0.0), (0.1, 0.0), (0.0, 0.1), (0.2, 0.1), (0.06, 0.025)])
@pytest.mark.parametrize("sign", [1.0, -0.7])
def test_it_finds_latency_plus_lag_on_the_first_ramp(lag, latency, sign):
    found = identified(Actuation(linear_lag=lag, latency=latency), [sign * command for command in RAMP])
    assert found == pytest.approx(lag + latency, abs=0.02)


def test_it_moves_smoothly():
    plant, estimate = DifferentialDrive(ROBOT, Actuation(linear_lag=0.2)), DelayEstimate()
    state, before = plant.at_rest(Pose2(0.0, 0.0, 0.0)), 0.0
    for command in RAMP:
        state = plant.step(state, Twist2(command))
        estimate.update(command, state.twist.linear, 0.02)
        assert abs(estimate.delay - before) <= 0.5 * 0.02 + 1e-12
        before = estimate.delay


def test_no_evidence_from_a_held_or_unmeasured_drive():
    estimate = DelayEstimate(0.07)
    for command in RAMP:
        estimate.update(command, 0.0, 0.02)
    assert estimate.delay == 0.07


def test_no_evidence_at_rest():
    assert identified(Actuation(), [0.0] * 50, known=0.12) == 0.12


def test_evidence_replaces_the_known_delay():
    assert identified(Actuation(), known=0.2) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("rate", [10, 50, 200])
@pytest.mark.parametrize("noise", [0.0, 0.005])
def test_it_finds_the_same_at_any_rate_and_with_noise_in_the_speed(rate, noise):
    period, random = 1.0 / rate, np.random.default_rng(1)
    drive = Actuation(linear_lag=0.1, latency=0.06)
    plant, estimate = DifferentialDrive(ROBOT, drive, period), DelayEstimate()
    state = plant.at_rest(Pose2(0.0, 0.0, 0.0))
    for k in range(3 * rate):
        command = min(0.25, 0.4 * k * period)
        state = plant.step(state, Twist2(command))
        estimate.update(command, state.twist.linear + noise * float(random.standard_normal()), period)
    assert estimate.delay == pytest.approx(0.16, abs=0.025)


def test_varying_periods():
    plant, estimate = (DifferentialDrive(ROBOT, Actuation(linear_lag=0.1, latency=0.06), 0.01), DelayEstimate())
    state, k = plant.at_rest(Pose2(0.0, 0.0, 0.0)), 0
    for steps in np.random.default_rng(2).choice([1, 2, 5, 10], 80).tolist():
        command = min(0.25, 0.4 * 0.01 * k)
        for _ in range(steps):
            state = plant.step(state, Twist2(command))
        k += steps
        estimate.update(command, state.twist.linear, 0.01 * steps)
    assert estimate.delay == pytest.approx(0.16, abs=0.025)


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
@pytest.mark.parametrize("seed", range(20))
def test_both_lanes_advance_the_models_equally(seed):
    """With periods of any length, commands at the borders of periods, and models without a lag."""
    random = np.random.default_rng(seed)
    period, begin = float(random.choice([0.005, 0.02, 0.1, 0.5])), 3.0
    since = [begin - 0.9, *sorted(begin - random.choice([0.02, 0.013, 0.2], 9) * random.integers(0, 9, 9) - 1e-9)]
    commands, models = random.uniform(-1.0, 1.0, 10).tolist(), random.uniform(-1.0, 1.0, (2, 11, 13))
    found = []
    for lane in ("twin", "native"):
        with using_kernels(lane):
            found.append(advanced(models, (since, commands), (begin, period), (0.3, 0.9, period)))
    assert np.abs(found[0] - found[1]).max() < 1e-12


def test_a_model_is_the_exact_response_to_its_delayed_command():
    """A step of the command at time 0, half a period before the end of the model's delay."""
    history = [-1.0, 0.0], [0.0, 1.0]
    speeds, misfits = advanced(np.zeros((2, 11, 13)), history, (0.09, 0.02), (0.1, 1.0, 0.02))
    latencies, lags = np.linspace(0.0, 0.2, 11), np.linspace(0.0, 0.3, 13)
    since = np.minimum(np.maximum(0.11 - latencies, 0.0), 0.02)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        wanted = np.where(since > 0.0, 1.0 - np.exp(-since / lags), 0.0)
    assert speeds == pytest.approx(wanted, abs=1e-12)
    assert misfits == pytest.approx(0.02 * (wanted - 0.1) ** 2, abs=1e-12)
