"""Synthetic drives whose truths are known: integrated in steps of 1 ms, by other means than the library's."""

import math

import numpy as np
import pytest

from optdock.calibration.recording import Recording
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.model.limits import MotionLimits
from optdock.model.robot import Robot

STEP = 0.001
PERIOD = 0.02
TRACK = 0.4
ROBOT = Robot(
    Footprint.rectangle(0.3, 0.3, 0.45),
    MotionLimits(max_curvature=3.0, max_curvature_rate=30.0, max_wheel_speed=0.6, track_width=TRACK),
)
DOCK = Pose2(2.0, 0.3, 0.2)


def drive(  # what is hidden, and what the recording leaves out
    *,
    seed=0,
    duration=7.5,
    speed=0.2,
    turning=0.4,
    latency=0.08,
    lag=0.1,
    bands=(0.0, 0.0),
    scale=0.0,
    drift=0.0,
    turn_scale=0.0,
    window=0.04,
    late=0.0,
    noise=(0.002, 0.003),
    range_noise=(0.0, 0.0),
    wrong=0.0,
    blind=0.0,
    localized=(0.0, 0.0),
    jump=(math.inf, 0.0),
    detections=True,
    docked=True,
    stored=DOCK,
    robot=ROBOT,
):
    """A recording of a robot that drives to and fro and turns about, and is at its dock where the frame begins."""
    random = np.random.default_rng(seed)
    cycles = np.arange(0.0, duration, PERIOD)
    phase = random.uniform(0.0, 2.0 * math.pi)
    v = speed * np.sin(1.3 * cycles + phase) * np.minimum(cycles, 1.0)
    w = turning * np.sin(1.9 * cycles + 2.0 * phase) * np.minimum(cycles, 1.0)
    times = np.arange(0.0, duration, STEP)
    held = np.clip(np.floor((times - latency) / PERIOD + 1e-9).astype(int), -1, len(cycles) - 1)
    rims = [np.where(held >= 0, (v + side * 0.5 * TRACK * w)[held], 0.0) for side in (-1.0, 1.0)]
    rims = [np.where(np.abs(rim) < band, 0.0, rim) for rim, band in zip(rims, bands, strict=True)]
    asked = 0.5 * (rims[0] + rims[1]), (rims[1] - rims[0]) / TRACK
    gain = 1.0 - math.exp(-STEP / lag)
    rates = []
    for target in asked:
        rate = np.zeros(len(times))
        for k in range(1, len(times)):
            rate[k] = rate[k - 1] + gain * (target[k - 1] - rate[k - 1])
        rates.append(rate)
    told = integrated(*rates, Pose2(0.0, 0.0, 0.0))
    true = integrated(rates[0] * (1.0 + scale), rates[1] * (1.0 + turn_scale) + drift * rates[0], Pose2(-1.0, 0.1, 0.1))
    summed = [np.concatenate(([0.0], np.cumsum(rate * STEP))) for rate in rates]
    mean = [
        (total[np.arange(len(times))] - total[np.maximum(np.arange(len(times)) - round(window / STEP), 0)]) / window
        for total in summed
    ]
    rows = np.arange(0, len(times), round(PERIOD / STEP))
    twists = np.column_stack([part[rows] for part in mean])
    seen = []
    for k in range(500, len(times), 100) if detections else ():
        x, y, yaw = true[k]
        off = np.array([-math.cos(yaw) * x - math.sin(yaw) * y, math.sin(yaw) * x - math.cos(yaw) * y, -yaw])
        away = math.hypot(x, y)
        if away < blind:
            continue
        sigma = np.array([noise[0] + range_noise[0] * away] * 2 + [noise[1] + range_noise[1] * away])
        off += sigma * random.standard_normal(3)
        if random.random() < wrong:
            angle = random.uniform(0.0, 2.0 * math.pi)
            off += np.array([0.15 * math.cos(angle), 0.15 * math.sin(angle), 0.3])
        seen.append((times[k] + late, *off, 0.003, 0.005))
    return Recording(
        f"drive-{seed}",
        cycles,
        np.column_stack((v, w)),
        twists[: len(cycles)],
        np.column_stack((times[rows], told[rows])),
        twists,
        np.full(len(rows), 0.01),
        located(times, true, localized, jump, random),
        np.array(seen).reshape(-1, 6),
        stored,
        duration if docked else None,
        robot,
    )


def integrated(v, w, start):
    yaw = start.yaw + np.concatenate(([0.0], np.cumsum(w[:-1] * STEP)))
    x, y = (np.concatenate(([0.0], np.cumsum(v[:-1] * turn(yaw[:-1]) * STEP))) for turn in (np.cos, np.sin))
    return np.column_stack((start.x + x, start.y + y, yaw))


def located(times, true, sigmas, jump, random):
    """The true poses in the map, with the dock at `DOCK`, an offset of its own for each recording, and a jump."""
    rows = np.arange(0, len(times), 200)
    offset = np.array([sigmas[0], sigmas[0], sigmas[1]]) * random.standard_normal(3)
    poses = np.array([(DOCK @ Pose2(*true[row].tolist())).as_array() for row in rows]) + offset
    poses[times[rows] >= jump[0], 0] += jump[1]
    return np.column_stack((times[rows], poses))


@pytest.fixture(scope="session")
def drives():
    """Three recordings of one robot, with everything about it slightly wrong."""
    hidden = {
        "latency": 0.11, "lag": 0.12, "scale": 0.02, "drift": 0.03, "turn_scale": -0.03, "window": 0.1, "late": 0.12,
        "range_noise": (0.004, 0.006), "wrong": 0.08, "localized": (0.01, 0.004),
    }  # fmt: skip
    return [drive(seed=seed, **hidden) for seed in (4, 5, 6)], hidden
