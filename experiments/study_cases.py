"""Docking problems of the studies: docks on the maps of this project, on Nav2's maps if present, and the examples' bay.

Every dock has the start of its scenario (number 0) and random free starts at a distance of 1 to 6 m.
"""

from __future__ import annotations

import zlib
from pathlib import Path
from typing import NamedTuple

import numpy as np

from experiments.manoeuvres.cases import free_starts
from experiments.real_maps import DRAWN_SCENARIOS, HINT, SCENARIOS, maps_folder, problem_of
from optdock.config import load_scenario
from optdock.geometry.pose import Pose2
from optdock.model.problem import DockingProblem

BAY = "bay of the examples"
EXAMPLES = Path(__file__).resolve().parents[1] / "examples" / "data"

__all__ = ["BAY", "EXAMPLES", "DockCase", "PathTask", "dock_cases", "maps_text", "problem_for"]


class DockCase(NamedTuple):
    """Name of a scenario of `real_maps`, and number of the start."""

    scenario: str
    number: int


class PathTask(NamedTuple):
    """A case and a source of raw paths."""

    scenario: str
    number: int
    source: str


def _scenarios() -> tuple[str, ...]:
    has_nav2 = all((maps_folder() / name).is_file() for name in ("depot.yaml", "warehouse.yaml"))
    return (BAY, *(one.name for one in (*DRAWN_SCENARIOS, *(SCENARIOS if has_nav2 else ()))))


def dock_cases(scale: float, per_dock: int) -> list[DockCase]:
    """Return the cases at a scale, evenly distributed over docks and starts; at full scale `per_dock` of every dock."""
    found = [DockCase(name, number) for number in range(per_dock) for name in _scenarios()]
    count = max(2, round(scale * len(found)))
    return [found[row] for row in np.linspace(0, len(found) - 1, count).round().astype(int)]


def problem_for(case: DockCase) -> DockingProblem:
    """Return the problem of a case."""
    if case.scenario == BAY:
        problem = load_scenario(EXAMPLES / "bay.yaml").problem
    else:
        problem = problem_of(next(one for one in (*DRAWN_SCENARIOS, *SCENARIOS) if one.name == case.scenario))
    if case.number == 0:
        return problem
    rng = np.random.default_rng((zlib.crc32(case.scenario.encode()), case.number))
    return problem.starting_at(Pose2.from_sequence(np.concatenate(list(free_starts(problem, 1, rng)))[0]))


def maps_text() -> str:
    """Return the sentence about the maps that were used."""
    count = len(_scenarios())
    if count > len(DRAWN_SCENARIOS) + 1:
        return f"{count} docks on the maps of this project and on Nav2's depot and warehouse."
    return f"{count} docks on the maps of this project only. Nav2's maps are missing: {HINT}."
