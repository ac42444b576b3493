"""Pictures of plans for the commands, finished or not."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

    from optdock.plan import DockPlan, PartialPlan
    from optdock.problem import DockingProblem

__all__ = ["draw_plan"]


def draw_plan(target: Path, problem: DockingProblem, found: DockPlan | PartialPlan, title: str) -> None:
    """Whatever exists of a plan, drawn into the scene.

    Raises:
        MissingExtra: Matplotlib is not installed.
        InvalidFile: The file cannot be written.
    """
    from optdock.plotting import save_plan_picture

    save_plan_picture(
        target, problem, raw_path=found.raw_path, path=found.path, certificate=found.certificate, title=title
    )
