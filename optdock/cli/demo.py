"""`optdock demo`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from optdock.cli.exits import reported
from optdock.cli.progress import working

if TYPE_CHECKING:
    from optdock.config import Scenario
    from optdock.plan import DockPlan
    from optdock.simulation import Run

__all__ = ["demo"]


def demo(
    out: Annotated[Path, typer.Option(help="Folder for the plan, the run and the pictures.")] = Path("demo"),
) -> None:
    """Run the built-in scenario from start to finish: plan, prove, time, drive, draw."""
    with reported():
        from optdock.builtin import demo_scenario
        from optdock.cli.simulate import driven, refuse_fault
        from optdock.cli.solving import solved_or_saved
        from optdock.config import load_scenario
        from optdock.io.atomic_file import write_text
        from optdock.io.plan_file import DEFAULT_PERIOD, DEFAULT_SPACING, save_plan
        from optdock.report import plan_file, plan_rows, run_json, run_rows, table

        scenario = load_scenario(demo_scenario())
        plan = solved_or_saved(scenario, out / "plan.json", None, DEFAULT_SPACING)
        save_plan(out / "plan.json", plan_file(plan, scenario.problem.frame, DEFAULT_PERIOD))
        run = driven(scenario, plan, 0)
        write_text(out / "run.json", run_json(run, 0))
        typer.echo(table([*plan_rows(plan), *run_rows(run)]))
        _draw(scenario, plan, run, out)
        typer.echo(f"pictures and files are in {out}")
    refuse_fault(run)


def _draw(scenario: Scenario, plan: DockPlan, run: Run, out: Path) -> None:
    from optdock.cli.pictures import draw_plan
    from optdock.plotting import save_animation, save_profile_picture, save_run_picture

    problem = scenario.problem
    title = f"built-in scenario: certified, {plan.trajectory.duration:.1f} s"
    with working("drawing", 4) as advance:
        draw_plan(out / "plan.png", problem, plan, title)
        advance("plan.png")
        zone = problem.dock.approach
        save_profile_picture(out / "profile.png", plan.trajectory, problem.robot.limits, zone, title=title)
        advance("profile.png")
        save_run_picture(out / "run.png", problem, run, title="built-in scenario: driven with lag, latency and noise")
        advance("run.png")
        save_animation(out / "run.gif", problem, run.times, run.poses)
        advance("run.gif")
