"""`optdock plan` and `optdock compare`, and the planning step of all commands."""

from __future__ import annotations

import re
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from optdock.cli.common import (
    METRES,
    SECONDS,
    BudgetOption,
    JobsOption,
    PlotOption,
    ReportOption,
    SchedulerOption,
    VerboseOption,
    check_picture,
    check_report,
    checked_positive,
    one_line,
    reported,
    spare,
    working,
)
from optdock.cli.exit_status import ExitStatus, status_of
from optdock.errors import InvalidFile, InvalidValue, OptdockError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from optdock.config import Scenario
    from optdock.io.plan_file import PlanFile
    from optdock.planning.plan import DockPlan, PartialPlan
    from optdock.reports.comparison import PathFigures
    from optdock.runner import Workers

__all__ = ["PlanOutputs", "compare", "draw_profile", "plan", "solved", "write", "written_failure"]

_NAV2 = "Instead of a scenario"


class PlanOutputs(NamedTuple):
    """Output files of a plan or a failure, and the sampling steps; a file that is None is not written.

    Args:
        file: Plan file.
        picture: Picture of the plan.
        spacing: Largest distance between path samples [m].
        period: Largest time between trajectory samples [s].
        report: HTML report.
    """

    file: Path | None = None
    picture: Path | None = None
    spacing: float = 0.02
    period: float = 0.02
    report: Path | None = None


_USUAL = PlanOutputs()


def plan(  # noqa: PLR0913 - one parameter per option
    scenarios: Annotated[
        list[Path] | None, typer.Argument(help="Scenario file (YAML), or several.", show_default=False)
    ] = None,
    *,
    out: Annotated[
        Path, typer.Option(help="Plan file to write (JSON); for several scenarios, folder of the plan files.")
    ] = Path("plan.json"),
    time_budget: BudgetOption = None,
    spacing: Annotated[
        float, typer.Option(metavar=METRES, help="Largest distance between path samples in the file.")
    ] = _USUAL.spacing,
    period: Annotated[
        float, typer.Option(metavar=SECONDS, help="Largest time between trajectory samples in the file.")
    ] = _USUAL.period,
    csv: Annotated[
        Path | None,
        typer.Option(help="Write the trajectory as CSV, sampled with --period.", show_default=False),
    ] = None,
    plot: PlotOption = None,
    report: ReportOption = None,
    profile: Annotated[
        Path | None,
        typer.Option(
            metavar="PICTURE",
            help="Draw speed, acceleration, jerk, curvature and yaw rate over time, with their limits.",
            show_default=False,
        ),
    ] = None,
    nav2_params: Annotated[
        Path | None, typer.Option(help="Nav2 parameter file: footprint, limits, dock types.", rich_help_panel=_NAV2)
    ] = None,
    map_: Annotated[Path | None, typer.Option("--map", help="Map (map_server YAML).", rich_help_panel=_NAV2)] = None,
    docks: Annotated[
        Path | None, typer.Option(help="Dock database; default: docks in the parameters.", rich_help_panel=_NAV2)
    ] = None,
    dock: Annotated[str | None, typer.Option(help="Name of the dock.", rich_help_panel=_NAV2)] = None,
    start: Annotated[
        str | None, typer.Option(metavar="X,Y,YAW", help="Start pose, in m, m, rad.", rich_help_panel=_NAV2)
    ] = None,
    jobs: JobsOption = None,
    scheduler: SchedulerOption = None,
    verbose: VerboseOption = False,
) -> None:
    """Plan a docking and write a certified plan file, or the reason for the failure.

    For example, after `optdock demo`: optdock plan demo/scenario.yaml --out plan.json --plot plan.png

    Several scenarios are planned at the same time, with time budgets in CPU time. Every plan file has the name of its
    scenario, a table is printed, and the exit status is the highest exit status of all scenarios. For example:
    optdock plan first.yaml second.yaml --out plans
    """
    with reported(verbose=verbose):
        checked_positive("--spacing", spacing, "m")
        checked_positive("--period", period, "s")
        checked_positive("--time-budget", time_budget, "s")
        check_picture("--plot", plot)
        check_picture("--profile", profile)
        check_report(report)
        nav2 = _Nav2Sources(nav2_params, map_, docks, dock, start)
        outputs = PlanOutputs(out, plot, spacing, period, report)
        if scenarios is None or len(scenarios) == 1:
            scenario = scenarios[0] if scenarios else None
            spare(scenario, out, csv, plot, profile, report)
            _plan_and_report(_loaded(scenario, nav2), time_budget, outputs, profile, csv)
            return
        from optdock.runner import Workers

        _check_several(outputs, profile, csv, *nav2)
        ended = _plan_several(scenarios, time_budget, outputs, Workers(jobs, scheduler))
    if ended:
        raise typer.Exit(ended)


class _Nav2Sources(NamedTuple):
    params: Path | None
    map: Path | None
    docks: Path | None
    dock: str | None
    start: str | None


def _loaded(scenario: Path | None, nav2: _Nav2Sources) -> Scenario:
    from optdock.config import load_scenario
    from optdock.nav2.docking_problem import nav2_scenario
    from optdock.reports.report import table

    given = [name for name, value in nav2._asdict().items() if value is not None]
    if scenario is not None and not given:
        return load_scenario(scenario)
    if scenario is None and nav2.params is not None and nav2.map is not None and nav2.start is not None:
        found = nav2_scenario(nav2.params, nav2.map, nav2.start, docks_source=nav2.docks, dock_name=nav2.dock)
        typer.echo(table(found.costmap_rows))
        return found
    raise InvalidValue("give either a scenario file, or --nav2-params with --map, --dock and --start")


def _plan_and_report(
    scenario: Scenario, time_budget: float | None, outputs: PlanOutputs, profile: Path | None, csv: Path | None
) -> None:
    from optdock.reports.report import limit_rows, plan_rows, table

    found = solved(scenario, time_budget, outputs)
    write(scenario, found, outputs)
    if profile is not None:
        draw_profile(profile, scenario, found)
    if csv is not None:
        found.save_csv(csv, period=outputs.period)
    written = ", ".join(
        str(path) for path in (outputs.file, csv, outputs.picture, profile, outputs.report) if path is not None
    )
    rows = [
        *plan_rows(found),
        *limit_rows(scenario.problem.robot.limits, scenario.default_limits),
        ("written", written),
    ]
    typer.echo(table(rows))


def solved(scenario: Scenario, time_budget: float | None = None, outputs: PlanOutputs = _USUAL) -> DockPlan:
    """Return the certified plan of a scenario; if planning fails, write and draw the partial results.

    Args:
        scenario: The scenario.
        time_budget: Wall-clock time instead of the time budget of the scenario [s].
        outputs: Output files that are written if planning fails.

    Raises:
        OptdockError: If no certified plan is found, see `plan_dock`, or if a file cannot be written.
    """
    from optdock.planning.plan import PartialPlan

    try:
        return scenario.plan(time_budget)
    except OptdockError as error:
        if status_of(error) is not ExitStatus.BAD_INPUT:
            failed = written_failure(error, scenario.problem.frame, outputs)
            with _secondary():
                _write_report(outputs.report, scenario, failed)
                _draw(outputs.picture, scenario, PartialPlan.left_by(error), one_line(error), error)
        raise


def written_failure(error: OptdockError, frame: str, outputs: PlanOutputs) -> PlanFile:
    """Write the plan file of a failure, and return its content.

    Raises:
        InvalidFile: If the file cannot be written.
    """
    from optdock.io.plan_file import save_plan
    from optdock.reports.report import failed_plan_file

    failed = failed_plan_file(error, frame)
    if outputs.file is not None:
        save_plan(outputs.file, failed, spacing=outputs.spacing)
    return failed


def write(scenario: Scenario, found: DockPlan, outputs: PlanOutputs) -> None:
    """Write and draw a certified plan.

    Raises:
        InvalidFile: If a file cannot be written.
        InvalidValue: If there are too many samples.
    """
    if outputs.file is not None:
        found.save(outputs.file, spacing=outputs.spacing, period=outputs.period)
    _draw(outputs.picture, scenario, found, f"certified, {found.trajectory.duration:.1f} s")
    _write_report(outputs.report, scenario, found.as_file(outputs.period))


def _write_report(target: Path | None, scenario: Scenario, plan: PlanFile) -> None:
    """Write the report of a plan or a refusal."""
    if target is not None:
        from optdock.reports.html import plan_chapter, save_report

        name = scenario.source.stem
        save_report(target, name, [plan_chapter(name, plan, scenario.problem)])


@contextmanager
def _secondary() -> Iterator[None]:
    """Print errors that occur while a failure is drawn, so that the failure itself is raised."""
    try:
        yield
    except OptdockError as error:
        typer.echo(str(error), err=True)


def _draw(
    target: Path | None,
    scenario: Scenario,
    found: DockPlan | PartialPlan,
    verdict: str,
    refusal: OptdockError | None = None,
) -> None:
    """Draw a plan or partial plan with its scene."""
    if target is None:
        return
    from optdock.plotting import save_plan_picture

    save_plan_picture(
        target,
        scenario.problem,
        raw_path=found.raw_path,
        path=found.path,
        certificate=found.certificate,
        refusal=refusal,
        title=f"{scenario.source.stem}: {verdict}",
    )


def draw_profile(target: Path, scenario: Scenario, found: DockPlan) -> None:
    """Draw the motion of a plan over time, with its limits."""
    from optdock.plotting import save_profile_picture

    problem = scenario.problem
    title = f"{scenario.source.stem}: certified, {found.trajectory.duration:.1f} s"
    save_profile_picture(target, found.trajectory, problem.robot.limits, problem.dock.approach, title=title)


def _check_several(outputs: PlanOutputs, *others: object) -> None:
    """Raise InvalidValue if options do not suit several scenarios."""
    if any(option is not None for option in (outputs.picture, outputs.report, *others)):
        raise InvalidValue("--plot, --profile, --csv, --report and the options of Nav2 need a single scenario")
    if outputs.file is None or outputs.file.suffix == ".json":
        raise InvalidValue(f"--out: several scenarios need a folder for their plan files, got {outputs.file}")


def _plan_several(sources: list[Path], time_budget: float | None, outputs: PlanOutputs, workers: Workers) -> ExitStatus:
    """Plan scenarios, write their plan files, print a table, and return the highest exit status."""
    from optdock.config import load_scenario
    from optdock.io.atomic_file import write_text
    from optdock.reports.report import table
    from optdock.runner import Case, run_cases

    folder = outputs.file or Path()
    targets = [folder / f"{source.stem}.json" for source in sources]
    for source in sources:
        spare(source, *targets)
    steps = time_budget, outputs.spacing, outputs.period
    cases = [Case(source.stem, (load_scenario(source), *steps)) for source in sources]
    rows: list[tuple[str, ...]] = [("scenario", "status", "length m", "duration s", "clearance m", "planning ms")]
    statuses: list[ExitStatus] = []
    with workers, working("planning", len(cases)) as advance:
        for outcome, target in zip(run_cases(_planned, cases, workers=workers, progress=advance), targets, strict=True):
            status, reason, text, row = outcome.value or (ExitStatus.UNEXPECTED, outcome.error, "", ["error"])
            if reason:
                typer.echo(f"{outcome.key}: {reason}", err=True)
            if text:
                write_text(target, text)
            rows.append((outcome.key, *row, *[""] * (5 - len(row))))
            statuses.append(ExitStatus(status))
    typer.echo(table(rows))
    typer.echo(f"plan files are in {folder}")
    return max(statuses)


def _planned(
    scenario: Scenario, time_budget: float | None, spacing: float, period: float
) -> tuple[int, str, str, list[str]]:
    """Plan a scenario in a worker; return its exit status, the reason of a failure, the plan file, and a table row."""
    from optdock.reports.report import failed_plan_file

    try:
        found = scenario.plan(time_budget)
    except OptdockError as error:
        status = status_of(error)
        kept = status is not ExitStatus.BAD_INPUT
        text = failed_plan_file(error, scenario.problem.frame).as_json(spacing=spacing) if kept else ""
        return int(status), one_line(error), text, [type(error).__name__]
    clearance, total = found.certificate.min_clearance, found.timing_ms["total"]
    figures = (found.path.driven, found.trajectory.duration, clearance)
    row = ["certified", *(f"{value:.3f}" for value in figures), f"{total:.1f}"]
    return int(ExitStatus.CERTIFIED), "", found.as_file(period, proof=True).as_json(spacing=spacing), row


def compare(
    scenarios: Annotated[
        list[Path], typer.Argument(help="Scenario files (YAML); other files are skipped.", show_default=False)
    ],
    *,
    smoother: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Smoother plugin to measure on the raw path of each plan; may be repeated. Default: the paths of the "
            "plans.",
            show_default=False,
        ),
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for comparison.csv and a picture of each scenario.")] = Path(
        "comparison"
    ),
    report: ReportOption = None,
    verbose: VerboseOption = False,
) -> None:
    """Compare raw and smoothed paths of scenarios: print a table, write a CSV and pictures.

    Every smoother that is given smooths the same raw path once, and its path is measured whether it is certified or
    not; the column reason of the CSV lists the violated rules. Time budgets count CPU time.

    The exit status is the highest exit status of all scenarios; the measured smoothers do not change it.

    For example: optdock compare bay.yaml --smoother CasadiSmoother --smoother SimpleSmoother
    """
    with reported(verbose=verbose):
        from optdock.config import load_scenario
        from optdock.deadline import budget_clock
        from optdock.io.atomic_file import write_text
        from optdock.plotting.canvas import format_of
        from optdock.plugins.interfaces import Smoother
        from optdock.plugins.registry import load_plugin
        from optdock.reports.comparison import comparison_csv, comparison_table

        names = tuple(dict.fromkeys(smoother or ()))
        for name in names:
            load_plugin(Smoother, name)
        format_of(out / "plan.png")
        check_report(report)
        loaded = [load_scenario(source) for source in _scenarios_among(scenarios)]
        figures: list[PathFigures] = []
        statuses: list[ExitStatus] = []
        with budget_clock("cpu"), working("comparing", len(loaded)) as advance:
            for number, scenario in enumerate(loaded, start=1):
                rows, status = _compared(scenario, names, out / f"{number:02d}_{scenario.source.stem}.png")
                figures.extend(rows)
                statuses.append(status)
                advance(scenario.source.stem)
        write_text(out / "comparison.csv", comparison_csv(figures))
        typer.echo(comparison_table(figures))
        if report is not None:
            from optdock.reports.html import comparison_chapter, save_report

            save_report(report, "Comparison", [comparison_chapter("comparison.csv", comparison_csv(figures))])
        typer.echo(f"comparison.csv and pictures are in {out}")
        for row in figures:
            if names and row.smoother and row.reason:
                typer.echo(f"{row.scenario}, {row.smoother}: {row.reason}")
    if ended := max(statuses):
        raise typer.Exit(ended)


def _scenarios_among(sources: list[Path]) -> list[Path]:
    """Return the scenario files; report other files on stderr.

    Raises:
        InvalidFile: If there is no scenario file.
    """
    found = [source for source in sources if _is_scenario(source)]
    for source in sources:
        if source not in found:
            typer.echo(f"{source}: skipped, because it has no line 'format: optdock-scenario/1'", err=True)
    if not found:
        raise InvalidFile("none of the files is a scenario; 'optdock demo' writes one, demo/scenario.yaml")
    return found


def _is_scenario(source: Path) -> bool:
    """Whether a file has the format of a scenario, or cannot be read."""
    from optdock.io.guarded_file import MostBytes, read_bytes

    if source.is_dir():
        return False
    try:
        content = read_bytes(source, MostBytes.YAML)
    except InvalidFile:
        return True
    return re.search(rb"^\W*format\W*:\W*optdock-scenario/", content, re.MULTILINE) is not None


def _compared(scenario: Scenario, smoothers: tuple[str, ...], picture: Path) -> tuple[list[PathFigures], ExitStatus]:
    """Draw a scenario, and return its rows and exit status; a failure becomes a row and a line on stderr."""
    from optdock.planning.plan import PartialPlan
    from optdock.plugins.registry import PluginChoice
    from optdock.reports.comparison import figures_of, planned_figures, raw_path_of, smoothed_figures

    outputs = PlanOutputs(picture=picture)
    found: DockPlan | OptdockError
    try:
        found = solved(scenario, outputs=outputs)
    except OptdockError as error:
        if status_of(error) is ExitStatus.BAD_INPUT:
            raise
        typer.echo(f"{scenario.source.stem}: {one_line(error)}", err=True)
        found, raw, status = error, PartialPlan.left_by(error).raw_path, status_of(error)
    else:
        write(scenario, found, outputs)
        raw, status = raw_path_of(found) if smoothers else found.raw_path, ExitStatus.CERTIFIED
    rows = [] if raw is None else [figures_of(scenario, "raw", raw)]
    if raw is None or not smoothers:
        return [*rows, planned_figures(scenario, found)], status
    own = scenario.smoother
    choices = [own if name == own.name else PluginChoice(name) for name in smoothers]
    return [*rows, *(smoothed_figures(scenario, raw, choice) for choice in choices)], status
