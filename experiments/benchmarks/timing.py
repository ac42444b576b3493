"""Benchmark of the time parameterization: how close to the optimum, at what cost, and whether every limit holds.

    python -m experiments.benchmarks.timing              tables over the committed suites, 200 fresh paths, CPU times
    python -m experiments.benchmarks.timing --fresh 2000 that many fresh random paths
    python -m experiments.benchmarks.timing --recompute  the references too (minutes), kept in timing_reference.json

T is the duration found, B the jerk-limited optimum (a local one, by IPOPT), A the bound without jerk (TOPP-RA).
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from experiments.benchmarks.timing_paths import clothoid_case, random_case, suite
from optdock.interfaces import TimingStatus
from optdock.timing.near_optimal import NearOptimal
from optdock.timing.windowed import Windowed

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from experiments.benchmarks.timing_paths import Case
    from optdock.geometry.arrays import FloatArray
    from optdock.interfaces import TimeParameterizer, TimingResult
    from optdock.trajectory import Trajectory

_REFERENCES = FilePath(__file__).with_name("timing_reference.json")
_SUITES = ("std", "hard", "clothoid")
_FRESH_SEED = 20261121
_KEPT = 1.0 + 1e-6


def methods() -> dict[str, TimeParameterizer]:
    """Every method kept."""
    return {
        "near-optimal": NearOptimal(),
        "  step 0.10 s": NearOptimal(step=0.10),
        "  step 0.06 s": NearOptimal(step=0.06),
        "  smooth": NearOptimal(smooth=True),
        "windowed": Windowed(),
    }


class Run(NamedTuple):
    """One timed call: result and CPU time, the least of the repetitions [s]."""

    case: Case
    result: TimingResult
    seconds: float


def run(method: TimeParameterizer, case: Case, repeat: int = 3) -> Run:
    """Time one call."""
    least, result = np.inf, None
    for _ in range(repeat):
        begin = time.process_time()
        result = method.parameterize(
            case.path, case.limits, case.zone, start_speed=case.start[0], start_acceleration=case.start[1]
        )
        least = min(least, time.process_time() - begin)
    assert result is not None
    return Run(case, result, least)


def worst_quotient(case: Case, trajectory: Trajectory) -> float:
    """Largest quotient of any quantity and its limit on a 1 ms grid plus all phase ends, analytic curvature."""
    limits, path, law = case.limits, trajectory.path, trajectory.time_law
    t = np.union1d(np.arange(0.0, law.duration, 1e-3), law.times)
    s, v, a, _jerk = law.at(t).T
    s = np.clip(s, 0.0, path.length)
    k, rate = path.curvature_at(s), path.curvature_rate_at(s)
    top = np.where(path.direction_at(s) > 0, limits.max_speed, limits.max_reverse_speed)
    top = np.where(s >= path.length - case.zone.distance, np.minimum(top, case.zone.speed), top)
    quotients: Iterable[FloatArray] = (
        v / top,
        np.where(v < -1e-12, np.inf, 0.0),
        np.abs(v * k) / limits.max_yaw_rate,
        v * v * np.abs(k) / limits.max_lateral_acceleration,
        v * (1.0 + 0.5 * limits.track_width * np.abs(k)) / limits.max_wheel_speed,
        np.abs(a * k + v * v * rate) / limits.max_yaw_acceleration,
        a / limits.max_acceleration,
        -a / limits.max_deceleration,
        np.abs(law.jerks) / limits.max_jerk,
    )
    return max(float(np.max(quotient)) for quotient in quotients)


def clean(item: Run) -> bool:
    """OK, within every limit, at rest at the end."""
    trajectory = item.result.trajectory
    if item.result.status is not TimingStatus.OK or trajectory is None:
        return False
    end = np.abs(trajectory.time_law.states[-1] - (item.case.path.length, 0.0, 0.0)).max()
    return worst_quotient(item.case, trajectory) <= _KEPT and end < 1e-9


def recompute() -> None:
    """Solve for A and B of every suite, B from two first iterates, and keep them."""
    from experiments.benchmarks.timing_reference import acceleration_bound, jerk_limited_optimum

    found: dict[str, dict[str, float]] = {}
    for name in _SUITES:
        for i, case in enumerate(suite(name)):
            guesses = [run(method, case, 1).result.trajectory for method in (NearOptimal(), Windowed())]
            optima = []
            for guess in guesses:
                try:
                    optima.append(jerk_limited_optimum(case, guess.time_law) if guess is not None else np.inf)
                except RuntimeError as error:
                    print(case.name, error)
            row = {"A": acceleration_bound(case), "B": min(optima, default=np.inf)}
            if i % 12 == 0 and guesses[0] is not None:
                row["B doubled"] = jerk_limited_optimum(case, guesses[0].time_law, 600)
            found[case.name] = row
            print(case.name, row, flush=True)
    _REFERENCES.write_text(json.dumps(found, indent=1) + "\n")


def print_suite(name: str) -> None:
    """One suite: every method against B and A."""
    references = json.loads(_REFERENCES.read_text())
    cases = suite(name)
    ratios = [references[case.name]["B"] / references[case.name]["A"] for case in cases]
    doubled = [abs(row["B doubled"] / row["B"] - 1.0) for row in references.values() if "B doubled" in row]
    print(
        f"\n{name}: {len(cases)} paths, B/A median {np.median(ratios):.3f}, doubling the grid changes B by <= {max(doubled):.1e}"
    )
    print(f"{'method':14} {'clean':>7} {'T/B med':>8} {'p90':>7} {'max':>7} {'<=1.05':>7} {'T/A med':>8} {'ms/5 m':>7}")
    for label, method in methods().items():
        runs = [run(method, case, 1) for case in cases]
        good = [item for item in runs if clean(item)]
        times = np.array([item.result.trajectory.duration for item in good if item.result.trajectory])
        to_b = times / [references[item.case.name]["B"] for item in good]
        to_a = times / [references[item.case.name]["A"] for item in good]
        cost = np.median([item.seconds * 5e3 / item.case.path.length for item in runs])
        print(
            f"{label:14} {len(good):3}/{len(runs):3} {np.median(to_b):8.4f} {np.percentile(to_b, 90):7.4f} {to_b.max():7.4f}"
            f" {np.mean(to_b <= 1.05):7.0%} {np.median(to_a):8.3f} {cost:7.2f}"
        )


def print_cost(count: int) -> None:
    """CPU time of single-gear paths of 5 m."""
    print(f"\nCPU of single-gear paths of 5 m [ms], {count} each, least of 3 calls")
    print(f"{'paths':10} {'method':14} {'p50':>6} {'p90':>6} {'p95':>6} {'p99':>6} {'max':>6}")
    kinds: dict[str, Callable[[int], Case]] = {
        "std": lambda i: random_case(501, i, length=5.0, gears=1),
        "hard": lambda i: random_case(502, i, length=5.0, gears=1, hard=True),
        "clothoid": lambda i: clothoid_case(503, i, length=5.0, hard=i % 2 == 1),
        "one cusp": lambda i: random_case(504, i, length=5.0, gears=2),
    }
    for kind, make in kinds.items():
        cases = [make(i) for i in range(count)]
        for label, method in methods().items():
            ms = [1e3 * run(method, case).seconds for case in cases]
            row = " ".join(f"{value:6.2f}" for value in (*np.percentile(ms, (50, 90, 95, 99)), max(ms)))
            print(f"{kind:10} {label:14} {row}")


def print_fresh(count: int, seed: int) -> None:
    """Fresh random paths of all kinds: how they end, and the worst quotient among those called OK."""
    statuses: dict[str, int] = {}
    repairs: dict[str, int] = {}
    worst, broken = (0.0, ""), 0
    for i in range(count):
        case = clothoid_case(seed, i, hard=i % 2 == 1) if i % 4 == 3 else random_case(seed, i, hard=i % 3 == 0)
        item = run(NearOptimal(), case, 1)
        statuses[item.result.status.name] = statuses.get(item.result.status.name, 0) + 1
        for how in _gears(item.result):
            repairs[how] = repairs.get(how, 0) + 1
        if item.result.status is TimingStatus.OK and item.result.trajectory is not None:
            quotient = worst_quotient(case, item.result.trajectory)
            broken += quotient > _KEPT
            worst = max(worst, (quotient, case.name))
    print(f"\nfresh paths, seed {seed}: {count}; ended {statuses}; above a limit by > 1e-6: {broken}")
    print(f"worst quotient {worst[0]:.9f} ({worst[1]}); per gear: {repairs}")


def _gears(result: TimingResult) -> list[str]:
    found = result.report.get("gears", [])
    return [str(how) for how in found] if isinstance(found, list) else []


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recompute", action="store_true", help="solve for the references again")
    parser.add_argument("--fresh", type=int, default=200, help="number of fresh random paths")
    parser.add_argument("--seed", type=int, default=_FRESH_SEED, help="of the fresh paths")
    parser.add_argument("--cost", type=int, default=50, help="number of paths per CPU row")
    arguments = parser.parse_args()
    if arguments.recompute:
        recompute()
    run(NearOptimal(), suite("std")[0])  # imports and caches
    for name in _SUITES:
        print_suite(name)
    print_cost(arguments.cost)
    print_fresh(arguments.fresh, arguments.seed)


if __name__ == "__main__":
    main()
