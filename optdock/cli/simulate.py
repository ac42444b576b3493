"""`optdock simulate` and `optdock demo`."""

from __future__ import annotations

import math
import shutil
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from optdock.cli.common import (
    METRES,
    RADIANS,
    SECONDS,
    BudgetOption,
    PlotOption,
    ReportOption,
    ScenarioArgument,
    VerboseOption,
    check_picture,
    check_report,
    checked_positive,
    reported,
    spare,
    working,
)
from optdock.cli.exit_status import ExitStatus
from optdock.cli.plan import PlanOutputs, draw_profile, solved, write
from optdock.errors import InvalidValue

if TYPE_CHECKING:
    from optdock.config import Scenario
    from optdock.config.simulated_drive import WorldDeviations
    from optdock.planning.plan import DockPlan
    from optdock.samples.tube import Deviations
    from optdock.simulation import Run

__all__ = ["demo", "simulate"]


# The defaults of the disturbances are those of `WorldDeviations`, which is loaded only by the command.
def simulate(  # noqa: PLR0913 - one parameter per option
    scenario: ScenarioArgument,
    *,
    out: Annotated[Path, typer.Option(help="Run file to write (JSON).")] = Path("run.json"),
    time_budget: BudgetOption = None,
    seed: Annotated[int, typer.Option(help="Seed of the measurement noise; equal seeds give equal runs.", min=0)] = 0,
    position_noise: Annotated[
        float, typer.Option(metavar=METRES, help="Standard deviation of the measured x and y.")
    ] = 0.001,
    yaw_noise: Annotated[float, typer.Option(metavar=RADIANS, help="Standard deviation of the measured yaw.")] = 0.001,
    lag: Annotated[float, typer.Option(metavar=SECONDS, help="Time constant of the drive.")] = 0.06,
    latency: Annotated[float, typer.Option(metavar=SECONDS, help="Delay of the commands.")] = 0.04,
    plot: PlotOption = None,
    report: ReportOption = None,
    gif: Annotated[
        Path | None, typer.Option(metavar="FILE.gif", help="Write an animation of the drive.", show_default=False)
    ] = None,
    verbose: VerboseOption = False,
) -> None:
    """Plan, then drive the plan in closed loop with lag, latency and noise; print the errors.

    The exit status is 3 if the run does not dock, collides, or leaves the region proven by the certificate.
    """
    with reported(verbose=verbose):
        from optdock.config import load_scenario
        from optdock.config.simulated_drive import WorldDeviations, driven
        from optdock.reports.report import run_json, run_rows, table
        from optdock.simulation import beyond_proof

        world = _checked(WorldDeviations(position_noise, yaw_noise, lag, latency))
        checked_positive("--time-budget", time_budget, "s")
        check_picture("--plot", plot)
        check_report(report)
        _check_animation(gif)
        spare(scenario, out, plot, gif, report)
        loaded = load_scenario(scenario)
        plan = solved(loaded, time_budget, PlanOutputs(picture=plot, report=report))
        run = driven(loaded, plan, seed, world)
        _write(loaded, run, seed, out, (plot, gif))
        if report is not None:
            _write_report(report, loaded, plan, run_json(run, seed))
        files = ", ".join(str(one) for one in (out, plot, gif, report) if one)
        left = beyond_proof(plan.path, plan.problem, plan.certificate, run.poses)
        typer.echo(table([*run_rows(run, _deviations(plan, run), left), ("written", files)]))
        _refuse_fault(run, left)


def demo(
    *,
    out: Annotated[Path, typer.Option(help="Folder for the scenario, the plan, the run and the pictures.")] = Path(
        "demo"
    ),
    verbose: VerboseOption = False,
) -> None:
    """Run the built-in scenario: plan, prove, time, drive, draw.

    The scenario files are written next to the results and can be edited: optdock plan demo/scenario.yaml
    """
    with reported(verbose=verbose):
        from optdock.config import load_scenario
        from optdock.config.simulated_drive import driven
        from optdock.reports.report import limit_rows, plan_rows, run_rows, table
        from optdock.simulation import beyond_proof

        check_picture("--out", out / "plan.png")
        scenario = load_scenario(_demo_files(out))
        with working("docking", 3) as advance:
            outputs = PlanOutputs(out / "plan.json", out / "plan.png")
            plan = solved(scenario, outputs=outputs)
            write(scenario, plan, outputs)
            advance("planned")
            draw_profile(out / "profile.png", scenario, plan)
            advance("motion drawn")
            run = driven(scenario, plan, 0)
            _write(scenario, run, 0, out / "run.json", (out / "run.png", out / "run.gif"))
            advance("driven")
        limits = limit_rows(scenario.problem.robot.limits, scenario.default_limits)
        left = beyond_proof(plan.path, plan.problem, plan.certificate, run.poses)
        typer.echo(table([*plan_rows(plan), *limits, *run_rows(run, _deviations(plan, run), left)]))
        typer.echo(f"\nThe scenario, the plan, the run and their pictures are in {out}. Next, for example:")
        typer.echo(f"  {_program()} plan {out / 'scenario.yaml'} --plot plan.png")
        _refuse_fault(run, left)


def _program() -> str:
    """Return the command of this program: its name if it is in PATH, otherwise its file."""
    called = sys.argv[0]
    return called if Path(called).stem == "optdock" and shutil.which("optdock") is None else "optdock"


def _demo_files(folder: Path) -> Path:
    """Copy the built-in scenario and its map into a folder and return the scenario file.

    Raises:
        InvalidFile: If a file cannot be written.
    """
    from optdock.config import demo_scenario
    from optdock.io.atomic_file import replacing

    built_in = demo_scenario()
    target = folder / "scenario.yaml"
    for source in built_in.parent.glob("hall*"):
        with replacing(target if source == built_in else folder / source.name) as temporary:
            shutil.copyfile(source, temporary)
    return target


def _write(scenario: Scenario, run: Run, seed: int, out: Path, pictures: tuple[Path | None, Path | None]) -> None:
    """Write the run file, and a picture and an animation if requested."""
    from optdock.io.atomic_file import write_text
    from optdock.reports.report import run_json

    write_text(out, run_json(run, seed))
    picture, animation = pictures
    if picture is not None:
        from optdock.plotting import save_run_picture

        title = f"{scenario.source.stem}: driven with lag, latency and noise, seed {seed}"
        save_run_picture(picture, scenario.problem, run, title=title)
    if animation is not None:
        from optdock.plotting import save_animation

        save_animation(animation, scenario.problem, run.times, run.poses)


def _write_report(target: Path, scenario: Scenario, plan: DockPlan, run: str) -> None:
    """Write the report of a plan and of the text of its run file."""
    from optdock.io.run_file import parse_run
    from optdock.reports.html import plan_chapter, run_chapter, save_report

    file, problem = plan.as_file(), scenario.problem
    chapters = [run_chapter("run", parse_run(run, "run"), problem, file), plan_chapter("plan", file, problem)]
    save_report(target, scenario.source.stem, chapters)


def _refuse_fault(run: Run, left: str) -> None:
    """Report on stderr that a run did not dock, collided, or left the proven region.

    Raises:
        Exit: If the run failed in one of these ways.
    """
    faults = [*([run.fault] if run.fault else []), *([f"left the proven range: {left}"] if left else [])]
    for fault in faults:
        typer.echo(fault, err=True)
    if faults:
        raise typer.Exit(ExitStatus.NOT_CERTIFIED)


def _deviations(plan: DockPlan, run: Run) -> Deviations:
    """Return the deviations of a run from the path of its plan."""
    from optdock.samples.tube import Tube

    return Tube(plan.path, plan.problem, plan.certificate.start_relief).deviations(run.poses)


def _checked(world: WorldDeviations) -> WorldDeviations:
    from optdock.io.numbers import unit_fault
    from optdock.simulation import Actuation

    for name, value in world._asdict().items():
        if not (math.isfinite(value) and value >= 0.0):
            raise InvalidValue(f"--{name.replace('_', '-')}: must be finite and >= 0, got {value}")
    try:
        Actuation(world.lag, world.lag, world.latency)
    except InvalidValue as error:  # for finite values >= 0, only the latency has a further rule
        raise InvalidValue(f"--latency: {str(error).partition(': ')[2]}") from error
    fault = unit_fault(world.yaw_noise, "rad")
    if fault:
        raise InvalidValue(f"--yaw-noise: {fault}")
    return world


def _check_animation(gif: Path | None) -> None:
    if gif is not None and gif.suffix.lower() != ".gif":
        raise InvalidValue(f"--gif: must end in .gif, got {gif}")
