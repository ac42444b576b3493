"""Report of several files: reads plans, runs, logs, comparisons and surveys, and writes one HTML page."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from optdock.config import load_scenario
from optdock.errors import InvalidFile, InvalidValue, MissingExtra
from optdock.executor.log import LOG_FORMAT, read_log
from optdock.io.atomic_file import write_text
from optdock.io.guarded_file import MostBytes, check_regular, parse_json, read_text
from optdock.io.plan_file import PLAN_FORMAT, load_plan
from optdock.io.quoting import shown
from optdock.io.run_file import RUN_FORMAT, load_run
from optdock.reports.html.comparison_chapter import comparison_chapter, is_comparison
from optdock.reports.html.drive_chapters import log_chapter, run_chapter
from optdock.reports.html.page import Table, html_page
from optdock.reports.html.plan_chapter import plan_chapter
from optdock.reports.html.survey_chapter import SurveyColumns, survey_chapter

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from optdock.io.plan_file import PlanFile
    from optdock.io.run_file import RunColumns
    from optdock.model.problem import DockingProblem
    from optdock.reports.html.page import Block, Chapter

__all__ = ["read_chapters", "save_report"]

_CONFIDENCE = 0.95
_WITH_PROBLEM = (PLAN_FORMAT, RUN_FORMAT)
_COMPARISON, _SURVEY = "comparison", "survey"
_BEGIN = 2000  # characters in which a file states its format
_SAME_PATH = 0.01  # [m]: largest distance of the planned poses of a run from the path that it follows
_FORMAT = re.compile(r'"format"\s*:\s*"(?P<name>[^"\n]*)"')


def save_report(target: str | Path, title: str, chapters: Sequence[Chapter]) -> None:
    """Write a report.

    Args:
        target: HTML file to write.
        title: Title of the page.
        chapters: One chapter for each file; the worst results are placed first.

    Raises:
        MissingExtra: If Bokeh is not installed.
        InvalidFile: If the file cannot be written.
    """
    ranked = sorted(chapters, key=lambda chapter: chapter.rank)
    write_text(target, html_page(title, [*_overview(ranked)], ranked))


def read_chapters(
    sources: Sequence[Path], problems: Sequence[DockingProblem] | Mapping[str, DockingProblem] = ()
) -> list[Chapter]:
    """Read files of any kind and return their chapters; a run is compared with the plan among the files that it drove.

    Args:
        sources: The files.
        problems: Problems of the plans and runs: none, one for all, one for each in their order, or by the names of
            the files without suffix.

    Raises:
        InvalidFile: If a file cannot be read or has an unknown format.
        InvalidValue: If there are several problems, but not one for each plan and run.
        MissingExtra: If Bokeh is not installed.
    """
    kinds = [_kind_of(source) for source in sources]
    files = [*zip(sources, kinds, _problem_of_each(sources, kinds, problems), strict=True)]
    plans = [load_plan(source) if kind == PLAN_FORMAT else None for source, kind, _ in files]
    seen = Counter(source.name for source in sources)
    chapters = []
    for (source, kind, problem), plan in zip(files, plans, strict=True):
        name = source.name if seen[source.name] == 1 else str(source)
        if plan is not None:
            chapters.append(_plan_chapter(name, plan, problem))
        elif kind == RUN_FORMAT:
            run = load_run(source)
            driven = next((one for one in plans if one is not None and _follows(run, one)), None)
            chapters.append(run_chapter(name, run, problem, driven))
        elif kind == LOG_FORMAT:
            chapters.append(log_chapter(name, read_log(source)))
        elif kind == _SURVEY:
            chapters.append(_survey_chapter(name, source))
        else:
            chapters.append(comparison_chapter(name, read_text(source, MostBytes.JSON)))
    return chapters


def _problem_of_each(
    sources: Sequence[Path], kinds: Sequence[str], problems: Sequence[DockingProblem] | Mapping[str, DockingProblem]
) -> list[DockingProblem | None]:
    """Return the problem of every file; None if it needs none, or if none is given for it.

    Raises:
        InvalidValue: If there are several problems, but not one for each plan and run.
    """
    if isinstance(problems, Mapping):
        return [problems.get(source.stem) for source in sources]
    wanting = sum(kind in _WITH_PROBLEM for kind in kinds)
    if len(problems) not in (0, 1, wanting):
        raise InvalidValue(f"scenarios: give one, or one for each of the {wanting} plans and runs, got {len(problems)}")
    given = iter([*problems] * wanting if len(problems) == 1 else problems)
    return [next(given, None) if kind in _WITH_PROBLEM else None for kind in kinds]


def _plan_chapter(name: str, plan: PlanFile, problem: DockingProblem | None) -> Chapter:
    try:
        return plan_chapter(name, plan, problem)
    except InvalidFile as error:
        raise InvalidFile(f"{name}: {error}") from error


def _survey_chapter(name: str, folder: Path) -> Chapter:
    """Read a survey.

    Raises:
        InvalidFile: If a file of the survey cannot be read.
        MissingExtra: If pyarrow is not installed.
    """
    cells = folder / "survey.parquet"
    check_regular(cells, MostBytes.LOG)
    try:
        from pyarrow import ArrowException, parquet
    except ImportError as error:
        raise MissingExtra("surveys need pyarrow: pip install 'optdock[survey]'") from error
    try:
        table = parquet.read_table(cells)
    except (ArrowException, OSError) as error:
        raise InvalidFile(f"{cells}: is not a Parquet file: {error}") from error
    columns = {name: table[name].to_numpy() for name in table.column_names if name in SurveyColumns._fields}
    try:
        head = parse_json(read_text(folder / "survey.json", MostBytes.JSON))
    except ValueError as error:
        raise InvalidFile(f"{folder / 'survey.json'}: is not JSON: {error}") from error
    head = head if isinstance(head, dict) else {}
    scenarios = head.get("scenarios")
    named = scenarios if isinstance(scenarios, dict) else {}
    problems = {key: load_scenario(folder / Path(str(file)).name).problem for key, file in named.items()}
    return survey_chapter(name, SurveyColumns.of(columns, str(cells)), head, problems)


def _kind_of(source: Path) -> str:
    """Return the format that a file states near its beginning, or the kind of a file without such a line.

    Raises:
        InvalidFile: If the file has no known format.
    """
    if source.is_dir() and (source / "survey.json").exists():
        return _SURVEY
    begin = read_text(source, MostBytes.LOG)[:_BEGIN]
    if is_comparison(begin):
        return _COMPARISON
    found = _FORMAT.search(begin)
    if found is None or found["name"] not in (*_WITH_PROBLEM, LOG_FORMAT):
        known = ", ".join((*_WITH_PROBLEM, LOG_FORMAT))
        got = "no format" if found is None else f"format {shown(found['name'])}"
        raise InvalidFile(
            f"{source}: must be a comparison.csv, the folder of a survey, or have one of the formats {known}, got {got}"
        )
    return found["name"]


def _follows(run: RunColumns, plan: PlanFile) -> bool:
    """Whether the planned poses of a run are on the path of a plan."""
    if plan.path is None:
        return False
    from scipy.spatial import KDTree

    along = plan.path.sample(_SAME_PATH).poses[:, :2]
    apart, _ = KDTree(along).query(run.planned[:, :2])
    return bool(np.max(apart) <= _SAME_PATH)


def _overview(chapters: Sequence[Chapter]) -> Iterator[Block]:
    """Generate the blocks of the summary: counts with confidence intervals, and all files, the worst first."""
    counts = [*_counts(chapters)]
    if counts:
        confidence = f"{100.0 * _CONFIDENCE:.0f} % confidence interval"
        yield Table("Outcomes", ("files", "outcome", "number", "share", confidence), counts)
    rows = [(chapter.title, chapter.outcome, chapter.summary) for chapter in chapters]
    links = [f"file-{i}" for i in range(1, len(chapters) + 1)]
    yield Table(
        "Files, the worst results first" if len(chapters) > 1 else "", ("file", "outcome", "result"), rows, links
    )


def _counts(chapters: Sequence[Chapter]) -> Iterator[tuple[str, ...]]:
    """Generate the share of every outcome among several files of its kind, with the confidence interval of Wilson."""
    from scipy.stats import binomtest

    totals = Counter(chapter.kind for chapter in chapters)
    counts = Counter((chapter.kind, chapter.outcome) for chapter in chapters)
    for kind, total in ((kind, total) for kind, total in totals.items() if total > 1):
        for outcome, count in ((one, count) for (of, one), count in counts.most_common() if of == kind):
            low, high = binomtest(count, total).proportion_ci(_CONFIDENCE, method="wilson")
            interval = f"{100.0 * low:.1f} to {100.0 * high:.1f} %"
            yield kind, outcome, f"{count} of {total}", f"{100.0 * count / total:.1f} %", interval
