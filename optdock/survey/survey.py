"""`run_survey`: survey one or several docks for one or several robots, and write the results to a folder.

A folder contains `outcomes.jsonl`, from which an interrupted survey continues and cells are opened, `survey.parquet`
with one row per cell, `survey.json` with the settings, a summary of each dock and the ranking, and for each dock a
picture and a scenario.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

from optdock.config import load_scenario, save_scenario
from optdock.errors import InvalidFile, InvalidValue
from optdock.geometry.checked import positive
from optdock.io.atomic_file import write_text
from optdock.io.guarded_file import MostBytes, parse_json, read_text
from optdock.io.plan_file import strict_json
from optdock.runner import OutcomeStore, read_outcomes, run_cases, run_head
from optdock.survey.dock_places import DockPlace
from optdock.survey.grid import Box, SurveyGrid
from optdock.survey.questions import SurveyTask
from optdock.survey.rounds import survey_dock
from optdock.survey.summary import DockSummary
from optdock.survey.table import require_parquet, save_table

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence
    from contextlib import AbstractContextManager

    from optdock.config import Scenario
    from optdock.geometry.arrays import BoolArray
    from optdock.runner import Case, Outcome, Workers
    from optdock.survey.rounds import SurveyAnswers

__all__ = [
    "FORMAT",
    "DockSurvey",
    "SurveySettings",
    "SurveyedDock",
    "docks_of",
    "file_stems",
    "open_survey",
    "run_survey",
]

FORMAT = "optdock-survey/1"
_LONGEST_STEM = 60  # letters of the name of a file; 240 bytes at most

Progress: TypeAlias = "Callable[[str, int], AbstractContextManager[Callable[[str], None]]]"


@dataclass(frozen=True)
class SurveySettings:
    """Settings of a survey.

    Args:
        within: Radius of the region around each dock [m]; not used if a region is given.
        region: The same region for all docks, or None.
        resolution: Distance between neighbouring positions [m].
        headings: Number of headings.
        time_budget: Time for planning one question [s].
    """

    within: float = 6.0
    region: Box | None = None
    resolution: float = 0.1
    headings: int = 16
    time_budget: float = 0.5


class SurveyedDock(NamedTuple):
    """Name of the robot, name of the dock, and scenario of the robot with the dock at its place."""

    robot: str
    dock: str
    scenario: Scenario

    @property
    def key(self) -> str:
        """Name that is unique in a survey."""
        return f"{self.robot}/{self.dock}"


class DockSurvey(NamedTuple):
    """Answers for one robot and one dock."""

    surveyed: SurveyedDock
    task: SurveyTask
    answers: SurveyAnswers
    summary: DockSummary


def docks_of(robot: str, scenario: Scenario, places: Iterable[DockPlace]) -> Iterator[SurveyedDock]:
    """Yield the docks of a robot; each scenario starts in its dock."""
    for name, pose in places:
        problem = scenario.problem
        moved = dataclasses.replace(problem, dock=dataclasses.replace(problem.dock, pose=pose)).starting_at(pose)
        yield SurveyedDock(robot, name, dataclasses.replace(scenario, problem=moved))


def run_survey(
    docks: Sequence[SurveyedDock],
    settings: SurveySettings,
    out: Path,
    workers: Workers,
    progress: Progress | None = None,
) -> list[DockSurvey]:
    """Survey docks and write the results, except pictures, to a folder.

    Args:
        docks: The docks.
        settings: Settings of the survey.
        out: The folder. A survey that was interrupted there is continued.
        workers: The processes to use, as an open context.
        progress: Called with the name of a dock and the number of cases before each round; returns a context with a
            function that is called for every finished case.

    Returns:
        The docks, the best first: by the share of certified cells, then by `DockSummary.p95`.

    Raises:
        InvalidValue: If there is no dock, two docks of a robot have the same name, or a setting is wrong.
        InvalidFile: If the folder belongs to another survey, or a file cannot be written.
        MissingExtra: If pyarrow is not installed.
    """
    if not docks:
        raise InvalidValue("survey: there is no dock")
    names = [dock.key for dock in docks]
    if len(set(names)) < len(names):
        raise InvalidValue(f"survey: docks must have different names, got {', '.join(names)}")
    require_parquet()
    tasks = [_task(dock, settings) for dock in docks]
    head = run_head(_described(docks, settings), workers)
    found: list[DockSurvey] = []
    with OutcomeStore(out / "outcomes.jsonl", head) as store:
        for dock, (task, region) in zip(docks, tasks, strict=True):
            found.append(_surveyed(dock, task, region, workers, store, progress))
    found.sort(key=lambda one: (-one.summary.share, one.summary.p95))
    save_table(out / "survey.parquet", [(one.surveyed.robot, one.surveyed.dock, one.answers) for one in found])
    rows = [one.summary.as_dict() for one in found]
    files = {key: f"{stem}.yaml" for key, stem in file_stems(docks).items()}
    maps: dict[int, Path | None] = {}
    for one in found:
        scenario, target = one.surveyed.scenario, out / files[one.surveyed.key]
        # Docks of one map share the map file of the first of them.
        known = maps.get(id(scenario.problem.costmap))
        written = save_scenario(target, scenario, map_source=known, note=f"dock of a survey, {one.surveyed.key}")
        maps.setdefault(id(scenario.problem.costmap), written[1] if len(written) > 1 else None)
    told = dataclasses.asdict(settings)
    document = {"format": FORMAT, "settings": told, "docks": rows, "scenarios": files, "run": head}
    write_text(out / "survey.json", strict_json(document) + "\n")
    return found


def open_survey(folder: Path, name: str | None = None) -> DockSurvey:
    """Return the answers for one dock of a finished survey.

    Args:
        folder: Folder of the survey.
        name: Name of the dock, with its robot before a slash if several robots have one; None for the best dock.

    Raises:
        InvalidFile: If the folder contains no finished survey.
        InvalidValue: If there is no such dock, or there are several.
    """
    source = folder / "survey.json"
    document: Any = parse_json(read_text(source, MostBytes.JSON))
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise InvalidFile(f"{source}: format: must be {FORMAT}")
    try:
        keys = [f"{row['robot']}/{row['dock']}" for row in document["docks"]]
        values = dict(document["settings"])
        values["region"] = None if values["region"] is None else Box(**values["region"])
        settings, files = SurveySettings(**values), {key: str(document["scenarios"][key]) for key in keys}
    except (KeyError, TypeError, ValueError) as error:
        raise InvalidFile(f"{source}: is damaged: {type(error).__name__}: {error}") from None
    fitting = [key for key in keys if name is None or name in (key, key.partition("/")[2])]
    if not fitting or (name is not None and len(fitting) > 1):
        raise InvalidValue(f"dock: must be one of {', '.join(keys)}, got {name}")
    robot, _, dock = fitting[0].partition("/")
    surveyed = SurveyedDock(robot, dock, load_scenario(folder / files[fitting[0]]))
    task, region = _task(surveyed, settings)
    stored = read_outcomes(folder / "outcomes.jsonl")

    def _recalled(_: Callable[..., object], cases: Sequence[Case]) -> Iterator[Outcome]:
        for case in cases:
            if case.key not in stored:
                raise InvalidFile(f"{folder}: the survey is not finished: {case.key} is missing")
            yield stored[case.key]

    answers = survey_dock(task, region, _recalled, name=f"{surveyed.key} ")
    return DockSurvey(surveyed, task, answers, DockSummary.of(robot, dock, task, answers))


def file_stems(docks: Iterable[SurveyedDock]) -> dict[str, str]:
    """Return the names of the files of docks without suffix, by `SurveyedDock.key`; no two of them are equal."""
    found: dict[str, str] = {}
    taken: set[str] = set()
    for dock in docks:
        letters = (letter if letter.isalnum() or letter in "-." else "_" for letter in f"{dock.robot}_{dock.dock}")
        plain = stem = "".join(letters)[:_LONGEST_STEM]
        for number in itertools.count(2):
            if stem.casefold() not in taken:  # some file systems ignore case
                break
            stem = f"{plain}-{number}"
        taken.add(stem.casefold())
        found[dock.key] = stem
    return found


def _surveyed(
    dock: SurveyedDock,
    task: SurveyTask,
    region: BoolArray,
    workers: Workers,
    store: OutcomeStore,
    progress: Progress | None,
) -> DockSurvey:
    def run(function: Callable[..., object], cases: Sequence[Case]) -> Iterator[Outcome]:
        with nullcontext(None) if progress is None else progress(dock.key, len(cases)) as advance:
            yield from run_cases(function, cases, workers=workers, shared=(task,), store=store, progress=advance)

    answers = survey_dock(task, region, run, name=f"{dock.key} ")
    return DockSurvey(dock, task, answers, DockSummary.of(dock.robot, dock.dock, task, answers))


def _task(dock: SurveyedDock, settings: SurveySettings) -> tuple[SurveyTask, BoolArray]:
    """Return the task of a dock, and the positions in the surveyed region."""
    goal, costmap = dock.scenario.problem.goal, dock.scenario.problem.costmap
    reach = positive(settings.within, "survey.within", "m")
    positive(settings.time_budget, "survey.time_budget", "s")
    box = settings.region or Box(goal.x - reach, goal.y - reach, goal.x + reach, goal.y + reach)
    if costmap is not None:
        (left, lower), (right, upper) = costmap.lower, costmap.upper
        if not (box.left < right and left < box.right and box.lower < upper and lower < box.upper):
            raise InvalidValue(f"survey.region: is outside the map, which ends at {costmap.lower} and {costmap.upper}")
        box = Box(max(box.left, left), max(box.lower, lower), min(box.right, right), min(box.upper, upper))
    grid = SurveyGrid.covering(box, settings.resolution, settings.headings)
    inside = grid.within(goal.x, goal.y, math.inf if settings.region is not None else reach)
    return SurveyTask(dock.scenario, grid, settings.time_budget), inside


def _described(docks: Sequence[SurveyedDock], settings: SurveySettings) -> dict[str, Any]:
    """Return everything that determines the answers, as plain values."""
    described = {
        dock.key: {
            "problem": dock.scenario.problem.fingerprint._asdict(),
            "plugins": [
                [choice.name, dict(choice.parameters)]
                for choice in (*dock.scenario.planner, dock.scenario.smoother, dock.scenario.timing)
            ],
        }
        for dock in docks
    }
    return {"survey": dataclasses.asdict(settings), "docks": described}
