"""Registry of the kinds of cases: how each is drawn, and how the library is checked on it."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from experiments.fuzz.kinds import (
    damaged_files,
    files,
    impossibilities,
    judged,
    kernels,
    limits,
    paths,
    plans,
    prices,
    replans,
    timing_kernels,
    timings,
    trajectories,
    values,
    views,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np

    from experiments.fuzz.case import Case, Verdict

__all__ = ["KINDS", "Kind"]


class Kind(NamedTuple):
    """Functions of one kind of cases."""

    draw: Callable[[np.random.Generator], Case]
    judge: Callable[[Case], Verdict]


KINDS: dict[str, Kind] = {
    "paths": Kind(paths.draw, paths.judge),
    "trajectories": Kind(trajectories.draw, trajectories.judge),
    "timings": Kind(timings.draw, timings.judge),
    "limits": Kind(limits.draw, limits.judge),
    "plans": Kind(plans.draw, plans.judge),
    "prices": Kind(prices.draw, prices.judge),
    "replans": Kind(replans.draw, replans.judge),
    "measured": Kind(replans.draw_measured, replans.judge),
    "decisions": Kind(replans.draw_decision, replans.judge),
    "impossibilities": Kind(impossibilities.draw, impossibilities.judge),
    "kernels": Kind(kernels.draw, kernels.judge),
    "timing_kernels": Kind(timing_kernels.draw, timing_kernels.judge),
    "files": Kind(files.draw, files.judge),
    "damaged_files": Kind(damaged_files.draw, damaged_files.judge),
    "judged": Kind(judged.draw, judged.judge),
    "values": Kind(values.draw, values.judge),
    "views": Kind(views.draw, views.judge),
}
