"""Time parameterization: optimality gap, cost, and compliance with every limit.

    python -m experiments.benchmarks timing                tables over the committed suites, 200 fresh paths, CPU times
    python -m experiments.benchmarks timing --fresh 2000   2000 fresh random paths
    python -m experiments.benchmarks timing --lateral-jerk 20   20 paths under limits of lateral jerk, against IPOPT
    python -m experiments.benchmarks timing --recompute    recompute the references (minutes), timing_reference.json

T is the resulting duration, B the jerk-limited optimum (a local one, by IPOPT), A the bound without jerk (TOPP-RA).
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
from collections import Counter
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from experiments.benchmarks.tables import Table, Timer, yardstick
from experiments.benchmarks.timing_paths import clothoid_case, random_case, suite
from optdock.plugins.interfaces import TimingStatus
from optdock.timing.near_optimal import NearOptimal
from optdock.timing.windowed import Windowed

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from experiments.benchmarks.timing_paths import Case
    from optdock.geometry.arrays import FloatArray
    from optdock.model.trajectory import Trajectory
    from optdock.plugins.interfaces import TimeParameterizer, TimingResult

_REFERENCES = FilePath(__file__).with_name("timing_reference.json")
_SUITES = ("std", "hard", "clothoid", "smoothed")
_FRESH_SEED = 20261121
_KEPT = 1.0 + 1e-6


def methods() -> dict[str, TimeParameterizer]:
    """Return the compared methods."""
    return {
        "near-optimal": NearOptimal(),
        "  step 0.10 s": NearOptimal(step=0.10),
        "  step 0.06 s": NearOptimal(step=0.06),
        "  smooth": NearOptimal(smooth=True),
        "windowed": Windowed(),
    }


class Run(NamedTuple):
    """A timed call: its result and its CPU time, the minimum of the repetitions [s]."""

    case: Case
    result: TimingResult
    seconds: float


def run(method: TimeParameterizer, case: Case, repeat: int = 3) -> Run:
    """Time one call `repeat` times."""
    speed, acceleration = case.start
    seconds, results = [], []
    for _ in range(repeat):
        timer = Timer()
        results.append(
            method.parameterize(case.path, case.limits, case.zone, start_speed=speed, start_acceleration=acceleration)
        )
        seconds.append(timer.cpu)
    return Run(case, results[-1], min(seconds))


def worst_quotient(case: Case, trajectory: Trajectory) -> float:
    """Return the largest ratio of any quantity to its limit on a 1 ms grid and all phase ends."""
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
        np.abs(2.0 * v * a * k + v**3 * rate) / limits.max_lateral_jerk,
        a / limits.max_acceleration,
        -a / limits.max_deceleration,
        np.abs(law.jerks) / limits.max_jerk,
    )
    return max(float(np.max(quotient)) for quotient in quotients)


def clean(item: Run) -> bool:
    """Whether the result is OK, within every limit, and at rest at the end."""
    trajectory = item.result.trajectory
    if item.result.status is not TimingStatus.OK or trajectory is None:
        return False
    end = np.abs(trajectory.time_law.states[-1] - (item.case.path.length, 0.0, 0.0)).max()
    return worst_quotient(item.case, trajectory) <= _KEPT and bool(end < 1e-9)


def recompute() -> None:
    """Compute and store A and B of some suites, B from two initial iterates."""
    from experiments.benchmarks.timing_reference import acceleration_bound

    found: dict[str, dict[str, float]] = json.loads(_REFERENCES.read_text()) if _REFERENCES.exists() else {}
    for i, case in enumerate(case for name in _SUITES for case in suite(name)):
        guesses = [run(method, case, 1).result.trajectory for method in (NearOptimal(), Windowed())]
        optima = [_optimum(case, guess, 300) for guess in guesses if guess is not None]
        row = {"A": acceleration_bound(case), "B": min(optima, default=np.inf)}
        if i % 12 == 0 and guesses[0] is not None:
            row["B doubled"] = _optimum(case, guesses[0], 600)
        found[case.name] = row
        print(case.name, row, flush=True)
        _REFERENCES.write_text(json.dumps(found, indent=1) + "\n")


def _optimum(case: Case, guess: Trajectory, intervals: int) -> float:
    """Return the optimum; infinite if IPOPT does not converge."""
    from experiments.benchmarks.timing_reference import jerk_limited_optimum

    try:
        return jerk_limited_optimum(case, guess.time_law, intervals)
    except RuntimeError as error:
        print(case.name, error)
        return np.inf


def suite_table(name: str) -> Table:
    """Return the table of one suite: every method against B and A."""
    references = json.loads(_REFERENCES.read_text())
    cases = suite(name)
    own = {case.name: references[case.name] for case in cases}
    doubled = [abs(row["B doubled"] / row["B"] - 1.0) for row in own.values() if "B doubled" in row]
    rows = []
    for label, method in methods().items():
        runs = [run(method, case, 1) for case in cases]
        good = [item for item in runs if clean(item)]
        times = np.array([item.result.trajectory.duration for item in good if item.result.trajectory])
        to_b = times / [own[item.case.name]["B"] for item in good]
        to_a = times / [own[item.case.name]["A"] for item in good]
        shown = (*np.percentile(to_b, (50, 90, 100)), np.percentile(to_a, 50))
        rows.append((label, f"{len(good)}/{len(runs)}", *(f"{value:.4f}" for value in shown), _jerk_steps(good)))
    note = (
        f"B/A median {np.median([row['B'] / row['A'] for row in own.values()]):.3f}; doubling the grid changes B by at"
        f" most {max(doubled):.1e}; jerk steps: median of the sum of |jerk step| / max_jerk per second"
    )
    header = ("method", "clean", "T/B median", "p90", "max", "T/A median", "jerk steps")
    return Table(f"{name}: {len(cases)} paths", header, tuple(rows), note)


def _jerk_steps(runs: list[Run]) -> float:
    laws = [(item.result.trajectory.time_law, item.case.limits.max_jerk) for item in runs if item.result.trajectory]
    return float(np.median([np.sum(np.abs(np.diff(law.jerks))) / jerk / law.duration for law, jerk in laws]))


def cost_table(count: int) -> Table:
    """Return CPU times for paths of 5 m, as clothoid splines."""
    kinds: dict[str, Callable[[int], Case]] = {
        "standard": lambda i: random_case(501, i, length=5.0, gears=1),
        "hard": lambda i: random_case(502, i, length=5.0, gears=1, hard=True),
        "knots 8 cm apart": lambda i: clothoid_case(503, i, length=5.0, hard=i % 2 == 1),
        "standard, one cusp": lambda i: random_case(504, i, length=5.0, gears=2),
    }
    rows = []
    for kind, make in kinds.items():
        cases = [make(i) for i in range(count)]
        for label, method in methods().items():
            ms = [1e3 * run(method, case, 5).seconds for case in cases]
            rows.append((kind, label.strip(), *(f"{value:.2f}" for value in np.percentile(ms, (50, 90, 95, 99, 100)))))
    note = f"{count} paths each, CPU ms, least of 5 calls; yardstick {1e3 * yardstick():.2f} ms"
    return Table("CPU of 5 m paths", ("paths", "method", "p50", "p90", "p95", "p99", "max"), tuple(rows), note)


def lateral_jerk_table(count: int) -> Table:
    """Return results for paths with a limit below their unconstrained lateral jerk, and IPOPT's optimum."""
    rows: list[tuple[str | int, ...]] = []
    notes: list[str] = []
    for share in (0.8, 0.4, 0.2):
        to_b: dict[str, list[float]] = {}
        slower, clean_ones, unsolved = [], 0, 0
        for i in range(count):
            case = clothoid_case(505, i, length=3.0, hard=i % 2 == 1)
            free = run(NearOptimal(), case, 1).result.trajectory
            if free is None:
                continue
            limits = dataclasses.replace(case.limits, max_lateral_jerk=share * _lateral_jerk(free))
            case = case._replace(limits=limits)
            runs = {label: run(method, case, 1) for label, method in methods().items() if "step" not in label}
            found = {label: one.result.trajectory for label, one in runs.items()}
            clean_ones += sum(map(clean, runs.values()))
            best = min((_optimum(case, law, 200) for law in found.values() if law is not None), default=np.inf)
            unsolved += not np.isfinite(best)
            slower.append(best / free.duration)
            for label, law in found.items():
                if law is not None and np.isfinite(best):
                    to_b.setdefault(label, []).append(law.duration / best)
        for label, ratios in to_b.items():
            shown = (f"{value:.4f}" for value in np.percentile(ratios, (50, 90, 100)))
            rows.append((f"{share:.1f}", label.strip(), len(ratios), *shown, f"{np.median(slower):.3f}"))
        notes.append(f"share {share:.1f}: {clean_ones} of {3 * count} runs clean, {unsolved} without an optimum")
    header = ("share", "method", "paths", "T/B median", "p90", "max", "B over T without the limit, median")
    return Table("Lateral jerk, paths of 3 m", header, tuple(rows), "; ".join(notes))


def _lateral_jerk(trajectory: Trajectory) -> float:
    """Return the largest lateral jerk of a motion, on a grid of 1 ms [m/s^3]."""
    _s, v, a, _j = trajectory.time_law.at(np.arange(0.0, trajectory.duration, 1e-3)).T
    s = np.clip(_s, 0.0, trajectory.path.length)
    k, rate = trajectory.path.curvature_at(s), trajectory.path.curvature_rate_at(s)
    return float(np.max(np.abs(2.0 * v * a * k + v**3 * rate)))


def fresh_table(count: int, seed: int) -> Table:
    """Return results for fresh random paths of all kinds: status, and the worst ratio among those reported OK."""
    statuses: Counter[str] = Counter()
    repairs: Counter[str] = Counter()
    worst, broken = (0.0, ""), 0
    for i in range(count):
        case = clothoid_case(seed, i, hard=i % 2 == 1) if i % 4 == 3 else random_case(seed, i, hard=i % 3 == 0)
        item = run(NearOptimal(), case, 1)
        statuses[item.result.status.name] += 1
        repairs.update(item.result.report.gears)
        if item.result.status is TimingStatus.OK and item.result.trajectory is not None:
            broken += not clean(item)
            worst = max(worst, (worst_quotient(case, item.result.trajectory), case.name))
    rows = [("paths", count), *((f"ended {name}", number) for name, number in statuses.items())]
    rows += [("OK but beyond a limit by > 1e-6, or not at rest at the end", broken)]
    rows += [("worst quotient among OK", f"{worst[0]:.9f} ({worst[1]})")]
    rows += [(f"gears by: {how}", number) for how, number in repairs.most_common()]
    return Table(f"Fresh random paths, seed {seed}, near-optimal", ("what", "number"), tuple(rows))


def main(arguments: list[str]) -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recompute", action="store_true", help="recompute the references")
    parser.add_argument("--fresh", type=int, default=200, help="number of fresh random paths")
    parser.add_argument("--seed", type=int, default=_FRESH_SEED, help="seed of the fresh paths")
    parser.add_argument("--cost", type=int, default=40, help="number of paths per CPU row")
    parser.add_argument(
        "--lateral-jerk", type=int, default=0, help="only run this number of paths under limits of lateral jerk"
    )
    options = parser.parse_args(arguments)
    if options.lateral_jerk:
        print(lateral_jerk_table(options.lateral_jerk))
        return
    if options.recompute:
        recompute()
    run(NearOptimal(), suite("std")[0])  # imports and caches
    for name in _SUITES:
        print(suite_table(name))
    print(cost_table(options.cost))
    print(fresh_table(options.fresh, options.seed))


if __name__ == "__main__":
    main(sys.argv[1:])
