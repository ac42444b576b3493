"""Experiment 1: dock on maps of a hall, a corridor and a storage, from plan to closed loop, optionally on Nav2's maps.

Plans, certifies and times every scenario of `real_maps`, and drives it with lag, latency and noise until the
AxisGoalChecker reports success. Prints a table of raw against smoothed paths; draws one picture of each plan and of
each run. Writes to results/01_docking_on_maps/.

    python experiments/01_docking_on_maps.py [--maps DIR] [--only TEXT] [--no-pictures]
"""

from __future__ import annotations

import argparse
import os
import re
import statistics
import sys
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from optdock.config import Scenario
from optdock.errors import OptdockError
from optdock.io.atomic_file import write_text
from optdock.planning.pipeline import warm_up
from optdock.planning.plan import PartialPlan
from optdock.plugins.interfaces import Controller, GoalChecker
from optdock.plugins.registry import PluginChoice, create_plugin
from optdock.reports.comparison import PathFigures, comparison_csv, comparison_table, figures_of
from optdock.reports.report import table
from optdock.simulation import Actuation, SimulationSettings, run_closed_loop

sys.path.insert(0, str(Path(__file__).parent))
from real_maps import DRAWN_SCENARIOS, HINT, SCENARIOS, MapScenario, maps_folder, problem_of

if TYPE_CHECKING:
    from optdock.planning.plan import DockPlan
    from optdock.simulation import Run

OUT = Path("results") / Path(__file__).stem
TIME_BUDGET = 0.5  # [s]: sufficient on a loaded machine; the table lists the planning time of each plan
# Actuators with 60 ms lag and 40 ms latency, localization with white noise of 2 mm and 0.1 degrees.
WORLD = {"position_noise": 0.002, "yaw_noise": 0.0017}
ACTUATION = Actuation(linear_lag=0.06, angular_lag=0.06, latency=0.04)
CONTROLLER = PluginChoice("TrackingController", {"preview": 0.1})
# Docking tolerances for Nav2's checker. The DockGoalChecker, which also checks the heading, runs in parallel.
CHECKER = PluginChoice(
    "AxisGoalChecker", {"along_path_tolerance": 0.02, "cross_track_tolerance": 0.02, "stopped": True}
)
SECOND_CHECKER = PluginChoice("DockGoalChecker", {})


class Result(NamedTuple):
    """Result of one scenario."""

    scenario: Scenario
    plan: DockPlan | None
    run: Run | None
    error: str
    refusal: OptdockError | None = None


def scenario_of(task: MapScenario, maps: Path) -> Scenario:
    """Return the task as a scenario, as if read from a file."""
    name = re.sub(r"[^a-z0-9]+", "_", task.name.lower())
    return Scenario(
        problem_of(task, maps), TIME_BUDGET, controller=CONTROLLER, goal_checker=CHECKER, source=Path(f"{name}.yaml")
    )


def solve(scenario: Scenario) -> Result:
    """Plan and drive one scenario."""
    problem = scenario.problem
    try:
        plan = scenario.plan()
    except OptdockError as error:
        return Result(scenario, None, None, f"{type(error).__name__}: {error}", error)
    settings = SimulationSettings(actuation=ACTUATION, obstacles=problem.all_obstacles, seed=1, **WORLD)
    controller = create_plugin(Controller, CONTROLLER.name, CONTROLLER.parameters)
    checker, second = (create_plugin(GoalChecker, c.name, c.parameters) for c in (CHECKER, SECOND_CHECKER))
    robot, goal = problem.robot, problem.goal
    run = run_closed_loop(plan.trajectory, robot, goal, controller, checker, settings, beside=[second])
    return Result(scenario, plan, run, run.fault)


def figures(result: Result) -> list[PathFigures]:
    """Return the raw and the smoothed row of the comparison."""
    if result.plan is None:
        return [PathFigures(result.scenario.source.stem, "smoothed", result.error.split(":")[0])]
    plan = result.plan
    raw = figures_of(result.scenario, "raw", plan.raw_path)
    return [raw, figures_of(result.scenario, "smoothed", plan.path, plan.trajectory.duration)]


def run_row(result: Result) -> tuple[str, ...]:
    """Return one row of the table of runs."""
    name = result.scenario.source.stem
    if result.plan is None or result.run is None:
        return (name, "-", "-", "-", "-", "-", "-", result.error)
    error, total = result.run.final_error, result.plan.timing_ms["total"]
    numbers = (f"{1e3 * error.x:+.1f}", f"{1e3 * error.y:+.1f}", f"{1e3 * error.yaw:+.1f}")
    clearance = "-" if result.run.min_clearance is None else f"{result.run.min_clearance:.4f}"
    second = "docked" if result.run.verdicts[SECOND_CHECKER.name] else "not docked"
    return (name, f"{total:.1f}", *numbers, clearance, second, result.error or "docked")


def draw(result: Result) -> None:
    """Draw the pictures of one scenario."""
    from optdock.plotting import save_plan_picture, save_run_picture

    plan, problem, name = result.plan, result.scenario.problem, result.scenario.source.stem
    if plan is None or result.run is None:
        left = PartialPlan.left_by(result.refusal) if result.refusal else PartialPlan()
        title = f"{name}: {result.error}"
        save_plan_picture(OUT / f"{name}.png", problem, raw_path=left.raw_path, refusal=result.refusal, title=title)
        return
    title = f"{name}: certified, {plan.path.length:.2f} m, {plan.trajectory.duration:.1f} s"
    save_plan_picture(
        OUT / f"{name}.png",
        problem,
        raw_path=plan.raw_path,
        path=plan.path,
        certificate=plan.certificate,
        title=title,
    )
    save_run_picture(OUT / f"{name}_run.png", problem, result.run, title=f"{name}: driven with lag, latency and noise")


def known_tasks(maps: Path, parser: argparse.ArgumentParser) -> tuple[MapScenario, ...]:
    """Return the scenarios whose maps exist; Nav2's maps are required only if they were requested explicitly."""
    missing = [name for name in ("depot.yaml", "warehouse.yaml") if not (maps / name).is_file()]
    if not missing:
        return (*DRAWN_SCENARIOS, *SCENARIOS)
    if maps != maps_folder() or "OPTDOCK_DATA" in os.environ:
        parser.error(f"{maps} holds no {' and no '.join(missing)}; {HINT}")
    print(f"On the maps of this project only. Nav2's {HINT}.\n")
    return DRAWN_SCENARIOS


def main() -> int:
    """Run the experiment. Return 0 if every scenario is certified and docks."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="run only the scenarios whose name contains this text")
    parser.add_argument("--no-pictures", action="store_true", help="print tables only")
    parser.add_argument(
        "--maps",
        type=Path,
        help="directory of Nav2's depot.yaml and warehouse.yaml (default: %(default)s)",
        default=maps_folder(),
    )
    arguments = parser.parse_args()
    tasks = [task for task in known_tasks(arguments.maps, parser) if arguments.only in task.name]
    if not tasks:
        parser.error(f"--only: no scenario's name holds {arguments.only!r}")
    warm_up()
    results = [solve(scenario_of(task, arguments.maps)) for task in tasks]
    rows = [row for result in results for row in figures(result)]
    errors = ("along mm", "cross mm", "yaw mrad")
    heads = ("scenario", "plan ms", *errors, "driven clearance m", SECOND_CHECKER.name, "closed loop")
    text = "\n\n".join(
        (comparison_table(rows), table([heads, *(run_row(result) for result in results)]), summary(results))
    )
    print(text)
    write_text(OUT / "tables.txt", text + "\n")
    write_text(OUT / "comparison.csv", comparison_csv(rows))
    if not arguments.no_pictures:
        for result in results:
            draw(result)
    return 0 if all(not result.error for result in results) else 1


def summary(results: list[Result]) -> str:
    """Return counts and medians over all scenarios."""
    plans = [result.plan for result in results if result.plan is not None]
    docked = sum(1 for result in results if result.run is not None and not result.error)
    total = [plan.timing_ms["total"] for plan in plans]
    middle = f"median {statistics.median(total):.1f} ms, worst {max(total):.1f} ms" if total else "-"
    return f"{len(plans)} of {len(results)} certified, {docked} docked; request to certified trajectory: {middle}"


if __name__ == "__main__":
    sys.exit(main())
