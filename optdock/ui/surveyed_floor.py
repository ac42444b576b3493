"""A survey on the page: its best dock, and the durations of all headings as maps below the scene."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.errors import InvalidValue
from optdock.geometry.pose import Pose2
from optdock.survey.rounds import CellState
from optdock.survey.survey import open_survey
from optdock.ui.scene_edits import EditedScene
from optdock.ui.scene_maps import inside

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from optdock.geometry.arrays import FloatArray
    from optdock.survey.rounds import SurveyAnswers

__all__ = ["SurveyedFloor", "surveyed_floor"]

_EMPTY, _IMPOSSIBLE, _NOT_FOUND = 250, 251, 252  # codes of `layer_figure`
_LONGEST = 249.0  # code of the longest duration


class SurveyedFloor(NamedTuple):
    """A survey of one dock.

    Attributes:
        scene: The scene, whose start is the certified cell with the median duration.
        x: Positions of the columns [m].
        y: Positions of the rows [m].
        layers: Codes of the cells for each heading, see `layer_figure`.
        headings: Headings of the layers [degrees].
        longest: Duration with the last colour [s].
        summary: Result of the survey in one sentence.
    """

    scene: EditedScene
    x: FloatArray
    y: FloatArray
    layers: list[NDArray[np.uint8]]
    headings: list[float]
    longest: float
    summary: str


def surveyed_floor(source: str | Path, folder: str | Path) -> SurveyedFloor:
    """Return the best dock of a survey.

    Args:
        source: Folder of the survey.
        folder: Folder that must contain it.

    Raises:
        InvalidFile: If the folder contains no finished survey.
        InvalidValue: If it is not inside the folder, or no cell is certified.
    """
    found = open_survey(inside(source, folder))
    layers, answers = found.answers.layers(), found.answers
    if not np.isfinite(layers.seconds).any():
        raise InvalidValue(f"{Path(source).name}: the robot docks from no start pose")
    longest = float(np.nanmax(layers.seconds))
    codes = np.full(layers.seconds.shape, _EMPTY, dtype=np.uint8)
    is_certified = np.isfinite(layers.seconds)
    codes[is_certified] = (_LONGEST * layers.seconds[is_certified] / longest).astype(np.uint8)
    codes[layers.impossible], codes[layers.not_found] = _IMPOSSIBLE, _NOT_FOUND
    scenario = found.surveyed.scenario
    scene = EditedScene(scenario)
    start = _usual_start(answers)
    return SurveyedFloor(
        scene.with_problem(scenario.problem.starting_at(start)),
        layers.x,
        layers.y,
        [*codes],
        np.degrees(layers.headings).round(1).tolist(),
        longest,
        str(found.summary),
    )


def _usual_start(answers: SurveyAnswers) -> Pose2:
    """Return the pose of the certified cell whose duration is nearest to the median."""
    cells = np.flatnonzero((answers.verdict == CellState.CERTIFIED) & (answers.method != "shared"))
    if cells.size == 0:
        cells = np.flatnonzero(answers.verdict == CellState.CERTIFIED)
    seconds = answers.seconds[cells]
    cell = cells[int(np.argmin(np.abs(seconds - np.median(seconds))))]
    x, y, yaw = answers.start[cell].tolist()
    return Pose2(round(x, 6), round(y, 6), math.radians(round(math.degrees(yaw), 4)))
