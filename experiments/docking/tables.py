"""Tables and distributions of the outcomes of the docking study."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from optdock.reports.report import table

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from experiments.docking.outcome import Outcome

__all__ = ["FORGIVEN", "draw_distributions", "table_of"]

FORGIVEN = 1e-4  # [m]: grid of the search for the nearest path point


def table_of(outcomes: Sequence[Outcome]) -> str:
    """Return one row per world, rate and method; p50 / p95 / max."""
    head = [
        "world", "Hz", "method", "success", "across, mm", "yaw, degrees", "along, mm", "time, s", "curvature, 1/m",
        "over limit", "of", "replans", "off path, mm", "clearance, mm", "wrong in tube", "left / logged",
        "busiest cycle, ms",
    ]  # fmt: skip
    groups: dict[tuple[str, float, str], list[Outcome]] = {}
    for one in outcomes:
        groups.setdefault((one.world, one.rate, one.method), []).append(one)
    return table([head, *(_row(key, found) for key, found in groups.items())])


def _row(key: tuple[str, float, str], found: list[Outcome]) -> list[str]:
    world, rate, method = key
    followed = [one for one in found if math.isfinite(one.short)]
    over = max(found, key=lambda one: one.over)
    wrong = sum(one.short > FORGIVEN for one in followed)
    return [
        world,
        f"{rate:g}",
        method,
        f"{sum(one.succeeded for one in found)}/{len(found)}",
        _spread((1e3 * abs(one.cross) for one in found), 2),
        _spread((math.degrees(abs(one.yaw)) for one in found), 3),
        _spread((1e3 * abs(one.along) for one in found), 2),
        _spread((one.duration for one in found), 1),
        _spread((one.curvature for one in found), 1),
        f"{over.over:.3f}",
        over.limit or "-",
        f"{np.mean([one.replans for one in found]):.1f}",
        _spread((1e3 * one.displacement for one in followed), 1) if followed else "-",
        f"{1e3 * min(one.clearance for one in found):.0f}",
        f"{wrong}" if followed else "-",
        f"{sum(one.left for one in followed)} / {sum(one.reported for one in followed)}" if followed else "-",
        f"{1e3 * max(one.busy for one in found):.2f}",
    ]


def _spread(values: Iterable[float], digits: int) -> str:
    column = np.fromiter(values, dtype=np.float64)
    return " / ".join(f"{value:.{digits}f}" for value in (*np.percentile(column, [50, 95]), column.max()))


def draw_distributions(target: Path, outcomes: Sequence[Outcome]) -> None:
    """Draw cumulative distributions of the errors at the dock, one column per world, one line per method."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    worlds = list(dict.fromkeys(one.world for one in outcomes))
    quantities = (
        ("|cross| [mm]", lambda one: 1e3 * abs(one.cross)),
        ("|yaw| [degrees]", lambda one: math.degrees(abs(one.yaw))),
        ("|along| [mm]", lambda one: 1e3 * abs(one.along)),
    )
    figure, axes = plt.subplots(3, len(worlds), figsize=(5.0 * len(worlds), 9.0), squeeze=False, layout="constrained")
    for column, world in enumerate(worlds):
        here = [one for one in outcomes if one.world == world]
        for row, (label, value) in enumerate(quantities):
            axis = axes[row, column]
            for method in dict.fromkeys(one.method for one in here):
                errors = np.sort([value(one) for one in here if one.method == method])
                axis.step(
                    np.maximum(errors, 1e-3), np.arange(1, errors.size + 1) / errors.size, where="post", label=method
                )
            axis.set(
                xscale="log", xlabel=label, ylabel="share of dockings", ylim=(0.0, 1.0), title=world if row == 0 else ""
            )
            axis.grid(visible=True, alpha=0.3)
    axes[0, 0].legend(loc="lower right", fontsize="small")
    figure.savefig(target, dpi=110)
    plt.close(figure)
