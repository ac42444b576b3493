"""Small moves that may end a refusal: of start or dock out of an obstacle, or of an obstacle out of the way."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.impossibility import BlockedStraight, ImpossibilityProof
from optdock.verification import TOLERANCE, pose_clearances

if TYPE_CHECKING:
    from optdock.model.problem import DockingProblem
    from optdock.ui.drawn_plan import DrawnPlan

__all__ = ["Mend", "mend_of"]

_ENDS = {"StartOccupied": "start", "GoalOccupied": "dock"}
_STEP, _STEPS, _DIRECTIONS = 0.01, 60, 8  # [m], steps tried in each of the directions
_MORE = 1e-3  # [m] that an obstacle is moved farther than what is missing
_LEAST_APART = 1e-4  # [m] between nearest points that have a direction


class Mend(NamedTuple):
    """A move of a part of the scene.

    Attributes:
        part: Name of the part.
        dx: Whole centimetres [m].
        dy: Whole centimetres [m].
    """

    part: str
    dx: float
    dy: float

    def __str__(self) -> str:
        moves = ((self.dx, ("right", "left")), (self.dy, ("up", "down")))
        parts = [f"{abs(length):.2f} m {names[length < 0.0]}" for length, names in moves if length]
        return f"Try: move {self.part} {' and '.join(parts)}."


def mend_of(drawn: DrawnPlan, problem: DockingProblem) -> Mend | None:
    """Return a small move against the reason of a refusal; None if no such move is known.

    Start or dock in an obstacle are moved to the nearest of the tried places with the required clearance. The nearest
    obstacle of the place where the clearance is not kept is moved away from the robot by what is missing; whether a
    motion exists then is not known.

    Args:
        drawn: The answer.
        problem: Its docking problem.
    """
    if drawn.error in _ENDS:
        return _freed_end(_ENDS[drawn.error], problem)
    missing = _missing_at_place(drawn)
    place = next((one for one in drawn.places if one.obstacle.startswith("obstacles[")), None)
    if missing <= 0.0 or place is None:
        return None
    apart = place.nearest[1] - place.nearest[0]
    distance = float(np.hypot(*apart))
    if distance < _LEAST_APART:
        return None
    dx, dy = ((missing + _MORE) / distance * apart).tolist()
    return Mend(place.obstacle, _away_from_zero(dx), _away_from_zero(dy))


def _freed_end(end: str, problem: DockingProblem) -> Mend | None:
    """Return the shortest tried move of `start` or `dock` to a pose with the required clearance."""
    pose = (problem.start if end == "start" else problem.goal).as_array()
    required = problem.clearance.required if end == "start" else problem.clearance.at_dock
    obstacles = problem.all_obstacles
    if end == "dock":  # its station moves with it
        names = [obstacles.name_of(row) for row in range(len(obstacles))]
        obstacles = obstacles.subset(np.array([name != "dock" for name in names], dtype=np.bool_))
    lengths = np.repeat(_STEP * np.arange(1, _STEPS + 1), _DIRECTIONS)
    angles = np.tile(2.0 * math.pi / _DIRECTIONS * np.arange(_DIRECTIONS), _STEPS)
    moves = np.column_stack((lengths * np.cos(angles), lengths * np.sin(angles)))
    moves = _STEP * np.round(moves / _STEP)
    clearances, _ = pose_clearances(
        pose + np.column_stack((moves, np.zeros(len(moves)))), problem.robot.footprint, obstacles
    )
    good = np.flatnonzero((clearances >= required + TOLERANCE) & np.any(moves != 0.0, axis=1))
    if not good.size:
        return None
    dx, dy = moves[good[np.argmin(np.hypot(*moves[good].T))]].tolist()
    return Mend(end, dx, dy)


def _missing_at_place(drawn: DrawnPlan) -> float:
    """Return the clearance or width that is missing at the first place [m]; 0 if it is not known."""
    proof, error = drawn.file.impossibility, drawn.file.error
    if isinstance(proof, BlockedStraight):
        return proof.poses[0].required - proof.poses[0].clearance
    if isinstance(proof, ImpossibilityProof):
        return 0.0 if proof.bottleneck is None else proof.bottleneck.missing_width
    where = {} if error is None else error.where
    amount = where.get("amount") if where.get("reason") == "clearance" else None
    return float(amount) if isinstance(amount, int | float) else 0.0


def _away_from_zero(length: float) -> float:
    """Return the next whole centimetre that is farther from 0 [m]; 0 for less than a millimetre."""
    if abs(length) < 0.1 * _STEP:
        return 0.0
    return math.copysign(_STEP * math.ceil(abs(length) / _STEP - 1e-9), length)
