"""Compare the answers of a survey with those of cells that are asked alone, in verdict, duration and CPU time.

    optdock survey scenario.yaml --within 8 --out survey
    python -m experiments.benchmarks survey --folder survey --sample 1000

For each sampled cell `plan_dock` is called alone, with the time budget and the clock of the survey, and the answer of
the survey is opened as a plan file, which `optdock certify` must accept.
"""

from __future__ import annotations

import argparse
import collections
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import stats

from experiments.real_maps import DRAWN_SCENARIOS, problem_of
from optdock.config import Scenario
from optdock.errors import NoMotionExists, OptdockError
from optdock.geometry.pose import Pose2
from optdock.io.plan_file import load_plan, save_plan
from optdock.reports.plan_file_verdict import judge_plan_file
from optdock.reports.report import failed_plan_file, table
from optdock.runner import Case, Workers, run_cases
from optdock.survey.dock_places import DockPlace
from optdock.survey.opened import plan_of_cell
from optdock.survey.rounds import CellState
from optdock.survey.survey import SurveySettings, docks_of, open_survey, run_survey

if TYPE_CHECKING:
    from collections.abc import Sequence

    from optdock.survey.survey import DockSurvey

__all__ = ["main"]

FREE = (CellState.CERTIFIED, CellState.IMPOSSIBLE, CellState.NOT_FOUND)


def small_survey() -> DockSurvey:
    """Return a survey of 3 m around a dock of a map of this project, at 20 cm and 8 headings."""
    problem = problem_of(DRAWN_SCENARIOS[0])
    (dock,) = docks_of("hall", Scenario(problem), [DockPlace("dock", problem.goal)])
    settings = SurveySettings(within=3.0, resolution=0.2, headings=8)
    with tempfile.TemporaryDirectory() as folder, Workers(1, clock="counted") as workers:
        return run_survey([dock], settings, Path(folder), workers)[0]


def alone(found: DockSurvey, cell: int) -> dict[str, Any]:
    """Return the verdict and the duration of a cell that is asked alone."""
    pose = Pose2.from_sequence(found.task.grid.poses(np.array([cell]))[0])
    scenario = found.task.scenario
    try:
        plan = replace(scenario, problem=scenario.problem.starting_at(pose)).plan(found.task.time_budget)
    except NoMotionExists:
        return {"verdict": "IMPOSSIBLE"}
    except OptdockError:
        return {"verdict": "NOT_FOUND"}
    return {"verdict": "CERTIFIED", "seconds": plan.trajectory.duration}


def opened(found: DockSurvey, cell: int) -> dict[str, Any]:
    """Return the verdict on the plan file of a cell, as `optdock certify` reaches it."""
    scenario, problem = found.task.scenario, found.task.scenario.problem
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "plan.json"
        try:
            plan = plan_of_cell(found.answers, cell, scenario, found.task.time_budget)
            problem = plan.problem
            plan.save(target)
        except OptdockError as error:
            problem = problem.starting_at(Pose2.from_sequence(found.task.grid.poses(np.array([cell]))[0]))
            save_plan(target, failed_plan_file(error, problem.frame))
        judged = judge_plan_file(load_plan(target), problem)
    return {"outcome": judged.outcome, "reason": judged.reason, "false": [str(one) for one in judged.false_claims]}


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the tables. Return 1 if a verdict of the survey is refuted."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, help="folder of a finished survey (default: one of a small hall)")
    parser.add_argument("--dock", help="name of the dock (default: the best)")
    parser.add_argument("--sample", type=int, default=1000, help="number of cells (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="seed of the sample (default: %(default)s)")
    parser.add_argument("--jobs", type=int, help="number of processes (default: one per core)")
    options = parser.parse_args(arguments)
    found = small_survey() if options.folder is None else open_survey(options.folder, options.dock)
    free = np.flatnonzero(np.isin(found.answers.verdict, FREE))
    cells = np.random.default_rng(options.seed).choice(free, min(options.sample, free.size), replace=False).tolist()
    results: dict[str, list[Any]] = {}
    costs: dict[str, float] = {}
    with Workers(options.jobs, clock="counted") as workers:
        for function in (alone, opened):
            cases = [Case(f"{function.__name__} {cell}", (cell,)) for cell in cells]
            outcomes = list(run_cases(function, cases, workers=workers, shared=(found,)))
            failed = [outcome for outcome in outcomes if outcome.error]
            if failed:
                print(f"{failed[0].key}: {failed[0].error}")
                return 1
            results[function.__name__] = [outcome.value for outcome in outcomes]
            costs[function.__name__] = sum(outcome.cpu_seconds for outcome in outcomes) / len(outcomes)
    return report(found, cells, results, costs, free.size)


def report(
    found: DockSurvey, cells: list[int], results: dict[str, list[Any]], costs: dict[str, float], free: int
) -> int:
    """Print the tables; return 1 if a verdict of the survey is refuted."""
    print(f"{found.summary}\n")
    told = [CellState(found.answers.verdict[cell]).name for cell in cells]
    methods = [str(found.answers.method[cell]) for cell in cells]
    pairs = collections.Counter(zip(told, methods, (one["verdict"] for one in results["alone"]), strict=True))
    rows = [(*(name.lower() for name in key), str(count)) for key, count in sorted(pairs.items())]
    print(table([("survey", "answer", "asked alone", "cells"), *rows]))
    wrong = [
        (cell, told[i], one["outcome"], one["reason"], one["false"])
        for i, (cell, one) in enumerate(zip(cells, results["opened"], strict=True))
        if (told[i] == "CERTIFIED") != (one["outcome"] == "certified")
        or (told[i] == "IMPOSSIBLE") != (one["outcome"] == "impossible")
        or one["false"]
    ]
    for cell, name, outcome, reason, claims in wrong:
        pose = found.task.grid.poses(np.array([cell]))[0].round(3).tolist()
        print(f"opened: {pose}: {name.lower()} ({found.answers.method[cell]}), file {outcome}: {reason} {claims or ''}")
    refuted = sum(
        name == "IMPOSSIBLE" and one["verdict"] == "CERTIFIED" for name, one in zip(told, results["alone"], strict=True)
    )
    low, high = stats.binomtest(len(wrong) + refuted, len(cells)).proportion_ci(method="wilson")
    print(f"\nrefuted: {refuted} impossible cells with a plan, {len(wrong)} answers whose plan file differs,")
    print(f"of {len(cells)} (95 % interval of the share: {100.0 * low:.2f} to {100.0 * high:.2f} %)")
    ratios = [
        found.answers.seconds[cell] / one["seconds"]
        for cell, one in zip(cells, results["alone"], strict=True)
        if "seconds" in one and np.isfinite(found.answers.seconds[cell])
    ]
    if ratios:
        levels = np.quantile(ratios, (0.05, 0.5, 0.9, 0.95, 0.99)).round(3).tolist()
        print(
            "duration of the survey over that of the cell alone: p5 {}, p50 {}, p90 {}, p95 {}, p99 {}".format(*levels)
        )
    survey, each = 1e3 * found.summary.cpu_seconds / free, 1e3 * costs["alone"]
    print(f"CPU per cell: survey {survey:.2f} ms, alone {each:.1f} ms, {each / survey:.1f} times as much")
    return int(bool(wrong or refuted))


if __name__ == "__main__":
    sys.exit(main())
