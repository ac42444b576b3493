"""Tables of the smoothing benchmark: the smoother's tasks, and statistics of its results."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from experiments.benchmarks.smoothing_calls import best_of, called, judged
from experiments.benchmarks.tables import Table, Timer, fixed_work, percentile
from experiments.families import instance
from optdock.geometry.pose import Pose2
from optdock.model.problem import DockingProblem

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from experiments.benchmarks.smoothing_calls import Call, Verdict
    from experiments.families import Instance
    from optdock.model.path import Path
    from optdock.plugins.interfaces import Smoother

__all__ = ["Run", "baseline_table", "budget_table", "family_table", "reasons_table", "solved", "warm_table"]

MAX_SHIFT, MAX_TURN = 0.04, math.radians(2.0)  # largest displacement of the dock at a re-plan [m, rad]


class Run(NamedTuple):
    """One instance, the smoother's result, its verdicts, and the call that stops at the first certified path.

    The last two are None without a result, or if not requested.
    """

    drawn: Instance
    call: Call
    verdict: Verdict | None
    first: Call | None = None

    @property
    def is_certified(self) -> bool:
        """Whether the result is a certified path."""
        return self.verdict is not None and self.verdict.is_certified

    @property
    def is_false(self) -> bool:
        """Whether the two verdicts contradict each other."""
        return self.verdict is not None and self.verdict.is_false


def solved(
    smoother: Smoother, families: Iterable[str], seeds: int, repeats: int, early: Smoother | None = None
) -> list[Run]:
    """Smooth every instance without a time limit; of `repeats` calls the fastest counts.

    Args:
        smoother: The measured smoother.
        families: Names.
        seeds: Number of instances per family.
        repeats: Number of calls per instance.
        early: The same smoother, stopping at the first certified path.
    """
    runs: list[Run] = []
    for family in families:
        called(smoother, *_input(instance(family, 0)))  # builds the cached models, which are created once per size
        for seed in range(seeds):
            drawn = instance(family, seed)
            call = _fastest(smoother, drawn, repeats)
            verdict = None if call.path is None else judged(call.path, drawn.problem)
            first = None if early is None or call.path is None else _fastest(early, drawn, repeats)
            runs.append(Run(drawn, call, verdict, first))
    return runs


def _fastest(smoother: Smoother, drawn: Instance, repeats: int) -> Call:
    return best_of([called(smoother, *_input(drawn)) for _ in range(repeats)])


def _input(drawn: Instance) -> tuple[Path, DockingProblem]:
    return drawn.raw_path, drawn.problem


def _milliseconds(values: Iterable[float], *shares: float) -> tuple[float, ...]:
    listed = [1e3 * value for value in values]
    return tuple(percentile(listed, share) for share in shares)


def _by_family(runs: Sequence[Run]) -> list[tuple[str, list[Run]]]:
    groups = [(family, list(group)) for family, group in itertools.groupby(runs, lambda run: run.drawn.family)]
    return [*groups, ("all", list(runs))] if len(groups) > 1 else groups


def family_table(runs: Sequence[Run], unit: float) -> Table:
    """Return certified rate and times, per feasible family."""
    header = (
        *("family", "certified", "of", "false", "iterations p50", "first ms p50", "p90"),
        *("converged ms p50", "p90", "p99", "max", "cpu ms p50", "p99", "units p50"),
    )
    rows = [_family_row(family, group, unit) for family, group in _by_family(runs)]
    note = (
        "certified: the library's certificate holds. false: it holds and the dense check shows a violation. first: the "
        "call stops at the first certified path. Wall clock, warm process. units: CPU over the yardstick's."
    )
    return Table("Smoothing, feasible families", header, tuple(rows), note)


def _family_row(family: str, group: list[Run], unit: float) -> tuple[object, ...]:
    calls = [run.call for run in group if run.call.path is not None]
    cpu = [call.cpu for call in calls]
    return (
        family,
        sum(run.is_certified for run in group),
        len(group),
        sum(run.is_false for run in group),
        percentile([call.number("iterations") for call in calls], 50),
        *_milliseconds([run.first.wall for run in group if run.first is not None], 50, 90),
        *_milliseconds([call.wall for call in calls], 50, 90, 99, 100),
        *_milliseconds(cpu, 50, 99),
        percentile(cpu, 50) / unit,
    )


def reasons_table(runs: Sequence[Run]) -> Table:
    """Return verdicts and their times, per infeasible family."""
    header = ("family", "expected reason", "right", "of", "others", "cpu ms p50", "p90", "max", "wall ms max")
    rows = []
    for family, group in _by_family(runs):
        wrong = sorted({run.call.reason or "a path" for run in group if run.call.reason != run.drawn.expected_reason})
        expected = group[0].drawn.expected_reason if family != "all" else ""
        right = sum(run.call.reason == run.drawn.expected_reason for run in group)
        cpu = _milliseconds([run.call.cpu for run in group], 50, 90, 100)
        times = (*cpu, *_milliseconds([run.call.wall for run in group], 100))
        rows.append((family, expected, right, len(group), ", ".join(wrong) or "none", *times))
    return Table("Smoothing, infeasible families: verdicts", header, tuple(rows))


def warm_table(smoother: Smoother, runs: Sequence[Run], repeats: int) -> Table:
    """Re-smooth after a displacement of the dock: from the last result, and from the raw path."""
    header = (
        *("family", "cold certified", "warm certified", "of", "cold cpu ms p50", "warm cpu ms p50", "warm p90"),
        *("cold iterations p50", "warm iterations p50"),
    )
    pairs = [_again(smoother, run, repeats) for run in runs if run.call.path is not None]
    again = {id(cold): warm for cold, warm in pairs}
    groups = _by_family([cold for cold, _ in pairs])
    rows = [(family, *_warm_row([(cold, again[id(cold)]) for cold in group])) for family, group in groups]
    note = f"the dock moved by up to {100 * MAX_SHIFT:.0f} cm and {math.degrees(MAX_TURN):.0f} degrees"
    return Table("Warm re-smooth", header, tuple(rows), note)


def _warm_row(pairs: list[tuple[Run, Run]]) -> tuple[object, ...]:
    cold, warm = [pair[0] for pair in pairs], [pair[1] for pair in pairs]
    warm_calls = [run.call for run in warm if run.is_certified]
    return (
        sum(run.is_certified for run in cold),
        sum(run.is_certified for run in warm),
        len(pairs),
        *_milliseconds([run.call.cpu for run in cold if run.is_certified], 50),
        *_milliseconds([call.cpu for call in warm_calls], 50, 90),
        percentile([run.call.number("iterations") for run in cold if run.is_certified], 50),
        percentile([call.number("iterations") for call in warm_calls], 50),
    )


def _again(smoother: Smoother, run: Run, repeats: int) -> tuple[Run, Run]:
    """Solve the moved problem from the raw path, and from the last result."""
    problem = _with_moved_dock(run.drawn)
    pair = []
    for warm_start in (None, run.call.path):
        calls = [called(smoother, run.drawn.raw_path, problem, warm_start=warm_start) for _ in range(repeats)]
        call = best_of(calls)
        verdict = None if call.path is None else judged(call.path, problem)
        pair.append(Run(run.drawn, call, verdict))
    return pair[0], pair[1]


def _with_moved_dock(drawn: Instance) -> DockingProblem:
    rng = np.random.Generator(np.random.PCG64([drawn.seed, 77]))
    shift, angle, turn = MAX_SHIFT * rng.uniform(), rng.uniform(-math.pi, math.pi), MAX_TURN * rng.uniform(-1.0, 1.0)
    move = Pose2(shift * math.cos(angle), shift * math.sin(angle), turn)
    old, problem = drawn.problem.dock, drawn.problem
    dock = replace(old, pose=old.pose @ move)
    return DockingProblem(problem.start, dock, problem.robot, problem.obstacles, problem.clearance)


def budget_table(smoother: Smoother, runs: Sequence[Run], budgets: Sequence[float], calls: int) -> Table:
    """Return results of hard budgets [s]: rate of certified paths, lateness, cost relative to the converged result."""
    header = (
        *("budget ms", "calls", "certified", "timed out", "false", "late ms p50", "p99", "worst", "late cpu ms worst"),
        *("cost gap % p50", "p90", "max", "host ms p99", "worst"),
    )
    feasible = [run for run in runs if run.is_certified]
    rows = [_budget_row(smoother, feasible, budget, max(1, calls // len(budgets))) for budget in budgets]
    note = (
        "late: elapsed minus budget, negative when early; by wall clock (with other processes) and CPU time. "
        "Instances: those that converge to a certified path without a limit, in turn. host: excess of the yardstick, "
        "run between the calls, over its median: lateness caused by the machine alone."
    )
    return Table("Hard time budgets", header, tuple(rows) if feasible else (), note)


def _budget_row(smoother: Smoother, feasible: Sequence[Run], budget: float, calls: int) -> tuple[object, ...]:
    made: list[tuple[Run, Run]] = []
    same: list[float] = []
    for run in itertools.islice(itertools.cycle(feasible), calls):
        call = called(smoother, *_input(run.drawn), budget=budget)
        verdict = None if call.path is None else judged(call.path, run.drawn.problem)
        made.append((run, Run(run.drawn, call, verdict)))
        timer = Timer()
        fixed_work()
        same.append(timer.wall)
    limited = [run for _, run in made]
    gaps = [100.0 * _cost_gap(free.call, run.call) for free, run in made if run.is_certified]
    return (
        1e3 * budget,
        len(made),
        sum(run.is_certified for run in limited),
        sum(run.call.reason == "timed out" for run in limited),
        sum(run.is_false for run in limited),
        *_milliseconds([run.call.wall - budget for run in limited], 50, 99, 100),
        *_milliseconds([run.call.cpu - budget for run in limited], 100),
        *(percentile(gaps, share) for share in (50, 90, 100)),
        *_milliseconds([seconds - percentile(same, 50) for seconds in same], 99, 100),
    )


def _cost_gap(converged: Call, limited: Call) -> float:
    return limited.number("cost") / converged.number("cost") - 1.0


def baseline_table(runs_of: Mapping[str, Sequence[Run]], unit: float) -> Table:
    """Compare smoothers on the same raw paths; `raw` is the input itself."""
    header = (
        *("smoother", "certified", "of", "collide", "too close", "over curvature", "over rate", "no straight end"),
        *("max curvature / limit p50", "wall ms p50", "p99", "cpu ms p50", "units p50"),
    )
    rows = [_baseline_row(name, runs, unit) for name, runs in runs_of.items()]
    note = (
        "selected feasible families; counts of paths by the dense check. collide: overlap; too close: less than "
        "the required clearance"
    )
    return Table("Smoothers compared on the same raw paths", header, tuple(rows), note)


def _baseline_row(name: str, runs: Sequence[Run], unit: float) -> tuple[object, ...]:
    judged_runs = [(run, run.verdict.dense) for run in runs if run.verdict is not None]
    broken = [dense.broken for _, dense in judged_runs]
    ratios = [d.max_curvature / run.drawn.problem.robot.limits.max_curvature for run, d in judged_runs]
    cpu = [run.call.cpu for run in runs]
    return (
        name,
        sum(run.is_certified for run in runs),
        len(runs),
        sum(dense.min_clearance < 0.0 for _, dense in judged_runs),
        *(sum(bound in names for names in broken) for bound in ("clearance", "curvature", "curvature rate")),
        sum("final straight" in names for names in broken),
        percentile(ratios, 50),
        *_milliseconds([run.call.wall for run in runs], 50, 99),
        *_milliseconds(cpu, 50),
        percentile(cpu, 50) / unit,
    )
