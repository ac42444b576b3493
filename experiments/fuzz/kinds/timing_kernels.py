"""Kernels of time laws against their NumPy twins: whole time laws, programs of the interior point method, crossings.

Results must be equal to the last bit. Time laws of random paths and limits are computed and proven; programs are drawn
with cells of very different lengths, without a solution, and with NaN and infinite numbers, and places that motions
reach also at rests and beyond the end.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from experiments.fuzz.case import Verdict
from experiments.fuzz.doors import path_of, zone_of
from experiments.fuzz.kinds import timings
from experiments.fuzz.kinds.kernels import is_equal, replaced
from optdock.deadline import budget_clock
from optdock.errors import OptdockError
from optdock.kernels import using_kernels
from optdock.model.constant_jerk import TimeLaw
from optdock.model.limits import MotionLimits
from optdock.timing.interior_point import Iterate, Program, advanced
from optdock.timing.near_optimal import NearOptimal
from optdock.timing.reference_program import jerk_step_bands, spline_of
from optdock.verification.turning_rules import crossings

if TYPE_CHECKING:
    from experiments.fuzz.case import Case
    from optdock.geometry.arrays import FloatArray
    from optdock.kernels import Lane

__all__ = ["DEGENERATE_PROGRAMS", "LANES", "draw", "drawn_law", "drawn_program", "judge"]

LANES: tuple[Lane, Lane] = ("twin", "native")
DEGENERATE_PROGRAMS = ("none", "lengths", "infeasible", "tiny", "nan", "inf")
_TIMINGS, _PROGRAMS = 0.2, 0.3  # shares of the cases
_LAWS = 10  # time laws of a case


def draw(rng: np.random.Generator) -> Case:
    """Draw a path with limits, the seed and the degeneracy of a program, or the seed of time laws."""
    share = rng.uniform()
    if share < _TIMINGS:
        return {**timings.draw(rng), "kind": "timing_kernels", "plugin": "NearOptimal"}
    if share < _TIMINGS + _PROGRAMS:
        degenerate = str(rng.choice(DEGENERATE_PROGRAMS))
        return {"kind": "timing_kernels", "program": degenerate, "seed": int(rng.integers(2**31))}
    return {"kind": "timing_kernels", "laws": int(rng.integers(2**31))}


def judge(case: Case) -> Verdict:
    """Compare both lanes."""
    if "plugin" in case:
        found = _timings(case)
    else:
        found = _programs(case) if "program" in case else _crossings(np.random.default_rng(case["laws"]))
    return Verdict("kernel differs", replaced()) if replaced() else found


def _timings(case: Case) -> Verdict:
    try:
        path, limits = path_of(case["path"]), MotionLimits(**case["limits"])
    except OptdockError as error:
        return Verdict(f"input refused: {type(error).__name__}", str(error))
    found = []
    begins = case["start_speed"], case.get("start_acceleration", 0.0)
    for lane in LANES:
        with using_kernels(lane), budget_clock("counted"):  # refusals have a time limit
            result = NearOptimal().parameterize(
                path, limits, zone_of(case), start_speed=begins[0], start_acceleration=begins[1]
            )
        law = None if result.trajectory is None else result.trajectory.time_law
        motion = (np.zeros(0), np.zeros(0)) if law is None else (law.durations, law.jerks)
        found.append((*motion, result.worst_ratio, result.status))
    return Verdict("equal timings") if is_equal(*found) else Verdict("kernel differs", "timing")


def _crossings(rng: np.random.Generator) -> Verdict:
    for _ in range(_LAWS):
        law, places = drawn_law(rng)
        found = []
        for lane in LANES:
            with using_kernels(lane), np.errstate(all="ignore"):
                found.append(crossings(law, places))
        if not is_equal(*found):
            return Verdict("kernel differs", "crossings")
    return Verdict("equal crossings")


def drawn_law(rng: np.random.Generator) -> tuple[TimeLaw, FloatArray]:
    """Draw a time law, possibly with rests, phases backwards and very short phases, and places, some of them NaN."""
    n = int(rng.integers(1, 30))
    durations = np.exp(rng.uniform(-20.0 if rng.uniform() < 0.3 else -3.0, 1.0, n))
    jerks = rng.choice([0.0, 1.0, -1.0], n) * rng.exponential(1.0, n)
    at_rest = rng.uniform() < 0.3
    law = TimeLaw(
        durations, jerks if not at_rest else 0.0 * jerks, 0.0, 0.0 if at_rest else float(rng.exponential(1.0))
    )
    borders = law.states[:, 0]
    places = np.concatenate((borders, rng.uniform(-1.0, 2.0, 20) * max(1e-3, float(np.abs(borders).max())), [np.nan]))
    places[rng.integers(0, n + 1)] += 1e-15
    return law, rng.permutation(places)


def _programs(case: Case) -> Verdict:
    program, c = drawn_program(np.random.default_rng(case["seed"]), case["program"])
    found = []
    for lane in LANES:
        with using_kernels(lane), np.errstate(all="ignore"):
            iterate = Iterate(c)
            found.append([iterate := advanced(program, iterate, most) for most in (1, 7, 40)])
    same = all(is_equal(*pair) for pair in zip(*found, strict=True))
    return Verdict("equal programs") if same else Verdict("kernel differs", f"program: {case['program']}")


def drawn_program(rng: np.random.Generator, degenerate: str) -> tuple[Program, FloatArray]:
    """Draw a program of the interior point method and positive coefficients; see `DEGENERATE_PROGRAMS`."""
    count, with_places = int(rng.integers(4, 40)), int(rng.integers(0, 5))
    spread = 8.0 if degenerate == "lengths" else 1.0
    steps = 0.05 * np.exp(spread * rng.uniform(-1.0, 1.0, count))
    spline = spline_of(steps)
    value, curve = spline.right_value, spline.curve / rng.uniform(0.5, 20.0)
    most = rng.uniform(0.05, 1.0, count) * (1e-12 if degenerate == "tiny" else 1.0)
    turns = rng.normal(size=(int(rng.integers(0, 6)), count))
    rows = [value / most, spline.right_slope / 0.7, -spline.right_slope / 0.7, *(turn * value for turn in turns)]
    curved = [curve, -curve, *(value * rng.normal(size=count) for _ in range(with_places))]
    places = np.stack([value] * with_places, axis=1) if with_places else np.zeros((3, 0, count))
    bands = jerk_step_bands(spline, rng.exponential(1e-3, count - 1))
    program = Program.of(steps, np.stack(rows, axis=1), np.stack(curved, axis=1), places, spline.right_share, bands)
    c = np.full(count + 2, float(rng.uniform(0.1, 0.5)) * most.min())
    if degenerate == "infeasible":
        c[:2] = 5.0 * most[:2]  # given, and above their bounds
    if degenerate in ("nan", "inf"):
        spoiled = (*program.parts, c)[int(rng.integers(7))]
        if spoiled.size:
            spoiled.flat[int(rng.integers(spoiled.size))] = (
                np.nan if degenerate == "nan" else rng.choice([-1, 1]) * np.inf
            )
    return program, c
