"""Summary of the answers for one dock: shares, times, and one sentence."""

from __future__ import annotations

import collections
import dataclasses
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from optdock.survey.rounds import CellState

if TYPE_CHECKING:
    from optdock.survey.questions import SurveyTask
    from optdock.survey.rounds import SurveyAnswers

__all__ = ["DockSummary"]


@dataclass(frozen=True)
class DockSummary:
    """Summary of one dock.

    Args:
        robot: Name of the robot.
        dock: Name of the dock.
        pose: Pose of the docked robot [m, m, rad].
        free: Number of cells at whose centre the robot overlaps no obstacle.
        certified: Number of these cells with a certified motion.
        impossible: Number of these cells with a proof that no motion exists.
        not_found: Number of the others.
        floor: Share of the positions with a free cell that are certified for at least one heading.
        p50: Median of the durations [s]; nan without a motion.
        p95: 95th percentile of the durations [s]; nan without a motion.
        margin: 5th percentile of the least clearances beyond the required ones, away from the dock [m]; nan if unknown.
        reasons: Most frequent reasons of refusals, with the number of their cells.
        obstruction: Most frequent reason for which cells are impossible; empty if none is.
        answers: Number of free cells by method.
        asked: Number of questions.
        cpu_seconds: CPU time [s].
    """

    robot: str
    dock: str
    pose: tuple[float, float, float]
    free: int
    certified: int
    impossible: int
    not_found: int
    floor: float
    p50: float
    p95: float
    margin: float
    reasons: tuple[tuple[str, int], ...]
    obstruction: str
    answers: dict[str, int]
    asked: int
    cpu_seconds: float

    @classmethod
    def of(cls, robot: str, dock: str, task: SurveyTask, answers: SurveyAnswers) -> DockSummary:
        """Return the summary of answers."""
        verdict = answers.verdict
        is_free = np.isin(verdict, (CellState.CERTIFIED, CellState.IMPOSSIBLE, CellState.NOT_FOUND))
        counts = {one: int((verdict == one).sum()) for one in CellState}
        seconds = answers.seconds[(verdict == CellState.CERTIFIED) & np.isfinite(answers.seconds)]
        p50, p95 = np.quantile(seconds, (0.5, 0.95)).tolist() if seconds.size else (math.nan, math.nan)
        margins = [one.margin for one in answers.asked.values() if one.margin is not None]
        by_heading = verdict.reshape(answers.grid.shape)
        is_reached = (by_heading == CellState.CERTIFIED).any(axis=0)
        is_floor = is_free.reshape(answers.grid.shape).any(axis=0)
        sources = answers.source[is_free & (verdict != CellState.CERTIFIED)].tolist()
        reasons = collections.Counter(answers.asked[cell].reason for cell in sources if cell in answers.asked)
        proven = answers.source[verdict == CellState.IMPOSSIBLE].tolist()
        obstructions = collections.Counter(answers.asked[cell].reason for cell in proven)
        goal = task.scenario.problem.goal
        return cls(
            robot,
            dock,
            (goal.x, goal.y, goal.yaw),
            int(is_free.sum()),
            counts[CellState.CERTIFIED],
            counts[CellState.IMPOSSIBLE],
            counts[CellState.NOT_FOUND],
            float(is_reached.sum() / max(is_floor.sum(), 1)),
            p50,
            p95,
            float(np.quantile(margins, 0.05)) if margins else math.nan,
            tuple(reasons.most_common(3)),
            next((reason for reason, _ in obstructions.most_common(1)), ""),
            dict(collections.Counter(answers.method[is_free].tolist())),
            len(answers.asked),
            answers.cpu_seconds,
        )

    @property
    def share(self) -> float:
        """Share of the free cells that are certified; 0 without free cells."""
        return self.certified / self.free if self.free else 0.0

    def __str__(self) -> str:
        name = f"{self.robot}, {self.dock}"
        if not self.free:
            return f"{name}: no free start pose in the region"
        text = f"{name}: certified from {_percent(self.share)} of {self.free} free start poses"
        if self.certified:
            text += f", in {self.p50:.1f} s in the median, 95 % within {self.p95:.1f} s"
        if self.not_found:
            text += f"; not found from {_percent(self.not_found / self.free)}, without a proof"
        if self.impossible:
            text += f"; impossible from {_percent(self.impossible / self.free)}"
            text += f": {self.obstruction}" if self.obstruction else ""
        return text

    def as_dict(self) -> dict[str, Any]:
        """Return plain values."""
        values = dataclasses.asdict(self)
        plain = {
            name: None if isinstance(value, float) and not math.isfinite(value) else value
            for name, value in values.items()
        }
        return {**plain, "share": self.share, "sentence": str(self)}


def _percent(share: float) -> str:
    """Return a share in percent; only all cells are 100 %, and only none are 0 %."""
    shown = f"{100.0 * share:.1f}"
    if shown == "100.0" and share < 1.0:
        return "more than 99.9 %"
    return "less than 0.1 %" if shown == "0.0" and share > 0.0 else f"{shown} %"
