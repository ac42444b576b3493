"""Chapter of a survey: from where, and how fast, a robot reaches each dock."""

from __future__ import annotations

import functools
import math
from collections import Counter
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from shapely import Polygon, union_all

from optdock.errors import InvalidFile
from optdock.reports.html.figures import LegendEntry, Outline, draw_area, draw_outlines, layer_figure
from optdock.reports.html.page import Chapter, Chart, Content, Table, Text

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import ArrayLike, NDArray

    from optdock.geometry.arrays import FloatArray
    from optdock.model.problem import DockingProblem
    from optdock.reports.html.page import Block

__all__ = ["SurveyColumns", "survey_chapter"]

_MOST_CELLS = 60_000  # of a survey whose headings are shown one by one
_CERTIFIED, _IMPOSSIBLE, _NOT_FOUND, _OCCUPIED = "certified", "impossible", "not found", "occupied"
_ORDER = (_OCCUPIED, _IMPOSSIBLE, _NOT_FOUND)  # the later one counts at a position without a certified heading
_DIGITS = 6  # of coordinates that are equal


class SurveyColumns(NamedTuple):
    """Cells of a survey, Shape (n,) each.

    Attributes:
        dock: Name of the dock.
        robot: Name of the robot.
        x: Position [m].
        y: Position [m].
        yaw: Heading [rad].
        verdict: `certified`, `impossible`, `not found` or `occupied`.
        answer: How the verdict was found.
        seconds: Duration of the motion [s]; nan without a motion.
    """

    dock: NDArray[np.str_]
    robot: NDArray[np.str_]
    x: FloatArray
    y: FloatArray
    yaw: FloatArray
    verdict: NDArray[np.str_]
    answer: NDArray[np.str_]
    seconds: FloatArray

    @classmethod
    def of(cls, columns: Mapping[str, ArrayLike], source: str) -> SurveyColumns:
        """Return the columns of a table.

        Args:
            columns: Values of every column; further columns are ignored.
            source: Name of the table for messages.

        Raises:
            InvalidFile: If a column is missing or has the wrong type.
        """
        found = []
        for name, kind in cls.__annotations__.items():
            if name not in columns:
                raise InvalidFile(f"{source}: has no column {name}")
            try:
                found.append(np.asarray(columns[name], dtype=float if "Float" in str(kind) else str))
            except (TypeError, ValueError) as error:
                raise InvalidFile(f"{source}: column {name}: {error}") from error
        read = cls(*found)
        return read._replace(verdict=np.char.replace(read.verdict, "_", " "))

    def of_pair(self, dock: str, robot: str) -> SurveyColumns:
        """Return the cells of a dock and a robot."""
        rows = (self.dock == dock) & (self.robot == robot)
        return SurveyColumns(*(column[rows] for column in self))


def survey_chapter(
    name: str, cells: SurveyColumns, head: Mapping[str, object], problems: Mapping[str, DockingProblem] | None = None
) -> Chapter:
    """Return the chapter of a survey.

    Args:
        name: Name of the survey.
        cells: Its cells.
        head: Content of `survey.json`; its `docks` are the summaries of the docks, the best first, and may be missing.
        problems: Problems by `robot/dock`, which are drawn on the maps; may be incomplete.
    """
    counts = Counter(cells.verdict.tolist())
    docks = [*dict.fromkeys(cells.dock.tolist())]
    free = len(cells.x) - counts[_OCCUPIED]
    share = 100.0 * counts[_CERTIFIED] / max(free, 1)
    dock_count = f"{len(docks)} dock{'s' if len(docks) != 1 else ''}"
    summary = f"{dock_count}, {len(cells.x)} cells; {share:.1f} % of the {free} free cells are certified"
    told = head.get("docks")
    rows = [row for row in told if isinstance(row, dict)] if isinstance(told, list) else []
    numbers = {"cells": len(cells.x), "verdicts": dict(sorted(counts.items())), "docks": rows}
    content = functools.partial(_content, cells, rows, problems or {})
    return Chapter(name, "surveys", "surveyed", "neutral", summary, content, numbers, (2.0, 0.0))


def _content(
    cells: SurveyColumns, rows: Sequence[Mapping[str, object]], problems: Mapping[str, DockingProblem]
) -> Content:
    pairs = [*dict.fromkeys(zip(cells.dock.tolist(), cells.robot.tolist(), strict=True))]
    blocks: list[Block] = []
    if rows:
        blocks.append(Text("Docks, the best first", [str(row.get("sentence", "")) for row in rows]))
        blocks.append(Table("Ranking", ("robot", *_RANKED.values()), [_ranked_row(row) for row in rows]))
        reasons = [(str(row.get("dock", "")), *map(str, one[::-1])) for row in rows for one in _reasons(row)]
        blocks += [Table("Most frequent reasons of refusals", ("dock", "cells", "reason"), reasons)] if reasons else []
    blocks.append(
        Table("Verdicts", ("dock", "robot", "cells", *_COUNTED, "median time [s]"), [*_count_rows(cells, pairs)])
    )
    answers = Counter(zip(cells.verdict.tolist(), cells.answer.tolist(), strict=True))
    found = [(verdict, answer or "–", str(count)) for (verdict, answer), count in sorted(answers.items())]
    blocks.append(Table("How the verdicts were found", ("verdict", "answer", "cells"), found))
    is_small = len(cells.x) <= _MOST_CELLS
    for dock, robot in pairs:
        mine, key = cells.of_pair(dock, robot), f"{robot}/{dock}"
        blocks.append(_map(mine, key.strip("/"), problems.get(key), by_heading=is_small))
    return Content(blocks)


_COUNTED = (_CERTIFIED, _IMPOSSIBLE, _NOT_FOUND, _OCCUPIED)
_RANKED = {
    "dock": "dock", "pose": "pose [m, m, rad]", "share": "certified cells [%]", "floor": "certified positions [%]",
    "p50": "median time [s]", "p95": "time of 95 % [s]", "margin": "margin of 95 % [m]",
}  # fmt: skip


def _reasons(row: Mapping[str, object]) -> list[list[object]]:
    """Return reasons of refusals with their numbers of cells."""
    found = row.get("reasons")
    return [one for one in found if isinstance(one, list)] if isinstance(found, list) else []


def _ranked_row(row: Mapping[str, object]) -> tuple[str, ...]:
    cells = [str(row.get("robot", ""))]
    for name in _RANKED:
        value = row.get(name)
        if isinstance(value, list):
            cells.append(", ".join(f"{one:.3f}" for one in value if isinstance(one, int | float)))
        elif isinstance(value, int | float):
            cells.append(f"{100.0 * value:.1f}" if name in ("share", "floor") else f"{value:.3f}")
        else:
            cells.append("" if value is None else str(value))
    return tuple(cells)


def _count_rows(cells: SurveyColumns, pairs: Sequence[tuple[str, str]]) -> Iterator[tuple[str, ...]]:
    for dock, robot in pairs:
        mine = cells.of_pair(dock, robot)
        counts = [int((mine.verdict == verdict).sum()) for verdict in _COUNTED]
        times = mine.seconds[(mine.verdict == _CERTIFIED) & np.isfinite(mine.seconds)]
        median = f"{float(np.median(times)):.2f}" if times.size else ""
        yield dock, robot, str(len(mine.x)), *map(str, counts), median


class _CellGrid(NamedTuple):
    """Verdicts and durations as arrays, Shape (headings, rows, columns); the verdict of missing cells is empty."""

    x: FloatArray
    y: FloatArray
    yaw: FloatArray
    verdict: NDArray[np.str_]
    seconds: FloatArray


def _grid(cells: SurveyColumns) -> _CellGrid:
    (x, i), (y, j), (yaw, k) = (
        np.unique(np.round(column, _DIGITS), return_inverse=True) for column in (cells.x, cells.y, cells.yaw)
    )
    shape = yaw.size, y.size, x.size
    verdict, seconds = np.full(shape, "", dtype="U16"), np.full(shape, np.nan)
    verdict[k, j, i], seconds[k, j, i] = cells.verdict, cells.seconds
    return _CellGrid(x, y, yaw, verdict, seconds)


def _map(cells: SurveyColumns, name: str, problem: DockingProblem | None, *, by_heading: bool) -> Chart:
    """Return the map of a dock: least duration over all headings, and every heading or their certified share."""
    grid = _grid(cells)
    known = np.where(grid.verdict == _CERTIFIED, grid.seconds, np.nan)
    best, best_words = _best(grid.verdict, known)
    layers = [(best, best_words)]
    labels = ["best heading"]
    longest = float(np.nanmax(known)) if np.isfinite(known).any() else 1.0
    if by_heading:
        layers += [*zip(known, grid.verdict, strict=True)]
        labels += [f"heading {math.degrees(yaw):.1f} degrees" for yaw in grid.yaw]
    else:
        free = np.maximum(((grid.verdict != _OCCUPIED) & (grid.verdict != "")).sum(axis=0), 1)
        layers.append((longest * (grid.verdict == _CERTIFIED).sum(axis=0) / free, best_words))
        labels.append("share of certified headings, 0 to 100 % on the whole scale")
    figure = layer_figure(grid.x, grid.y, [_codes(*layer, longest) for layer in layers], longest)
    legend = [LegendEntry(word, colour, "area") for word, colour in _COLOURS.items()]
    if problem is not None:
        station = [Polygon(corners) for corners in _station(problem)]
        draw_area(figure, union_all(station), Outline("dock", "dock"))
        draw_outlines(figure, problem.robot.footprint, problem.goal.as_array()[None], Outline("", "goal"))
        legend += [LegendEntry("docked robot", "goal"), *([LegendEntry("dock", "dock", "area")] if station else [])]
    certified = int((best_words == _CERTIFIED).sum())
    text = (
        f"Time to {name} from {int((best_words != '').sum())} positions; at {certified} of them a heading is "
        f"certified, with a least time of {np.nanmin(known) if certified else math.nan:.1f} s and a longest time of "
        f"{longest:.1f} s."
    )
    width, height = (float(np.ptp(axis)) + _step(axis) for axis in (grid.x, grid.y))
    return Chart(f"Map of {name}", text, figure, legend, min(max(width / height, 0.5), 3.0), labels)


def _station(problem: DockingProblem) -> Iterator[FloatArray]:
    """Generate the convex pieces of the station, Shape (n, 2) each."""
    obstacles = problem.all_obstacles
    return (obstacles.vertices[row] for row in range(len(obstacles)) if obstacles.name_of(row) == "dock")


_COLOURS = {_IMPOSSIBLE: "impossible", _NOT_FOUND: "hot", _OCCUPIED: "occupied"}


def _best(verdict: NDArray[np.str_], seconds: FloatArray) -> tuple[FloatArray, NDArray[np.str_]]:
    """Return the least duration over all headings, and the verdict of each position, Shape (rows, columns) each."""
    words = np.full(verdict.shape[1:], "", dtype="U16")
    for word in _ORDER:
        words[(verdict == word).any(axis=0)] = word
    words[(verdict == _CERTIFIED).any(axis=0)] = _CERTIFIED
    least = np.where(np.isfinite(seconds), seconds, np.inf).min(axis=0)
    return np.where(np.isfinite(least), least, np.nan), words


def _codes(seconds: FloatArray, words: NDArray[np.str_], longest: float) -> NDArray[np.uint8]:
    """Return the codes of `layer_figure`: 0 to 249 for durations from 0 to `longest` [s], then the verdicts."""
    codes = np.full(words.shape, 250, dtype=np.uint8)
    is_certified = (words == _CERTIFIED) & np.isfinite(seconds)
    codes[is_certified] = np.clip(249.0 * seconds[is_certified] / longest, 0.0, 249.0).astype(np.uint8)
    for code, word in enumerate(_COLOURS, start=251):
        codes[words == word] = code
    return codes


def _step(axis: FloatArray) -> float:
    return float(np.diff(axis).min()) if axis.size > 1 else 1.0
