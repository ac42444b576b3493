"""Table of the field study."""

from __future__ import annotations

import collections
import math
from typing import TYPE_CHECKING

import numpy as np

from optdock.reports.report import table

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from experiments.docking.field.outcome import FieldOutcome

__all__ = ["field_table"]

_HEAD = [
    "world", "Hz", "method", "good", "false docked", "failed", "collisions", "across p95, mm", "yaw p95, degrees",
    "along p95, mm", "time p50, s", "of plan p50", "over limit", "of", "longest, s", "cycle p99, ms",
    "belief off p95, mm", "degrees", "recovered p95, detections",
]  # fmt: skip


def field_table(outcomes: Sequence[FieldOutcome]) -> str:
    """Return one row per world, rate and method; the errors are of the runs that are reported docked."""
    groups: dict[tuple[str, float, str], list[FieldOutcome]] = {}
    for one in outcomes:
        groups.setdefault((one.world, one.rate, one.method), []).append(one)
    return table([_HEAD, *(_row(key, found) for key, found in groups.items())])


def _row(key: tuple[str, float, str], found: list[FieldOutcome]) -> list[str]:
    world, rate, method = key
    docked = [one for one in found if one.docked]
    failed = collections.Counter(one.ending for one in found if not one.docked)
    over = max(found, key=lambda one: one.over)
    return [
        world,
        f"{rate:g}",
        method,
        f"{sum(one.good for one in found)}/{len(found)}",
        f"{sum(one.falsely_docked for one in found)}",
        ", ".join(f"{count} {ending}" for ending, count in failed.most_common()) or "-",
        f"{sum(one.collided for one in found)}",
        _percentile((1e3 * abs(one.cross) for one in docked), 95, 1),
        _percentile((math.degrees(abs(one.yaw)) for one in docked), 95, 2),
        _percentile((1e3 * abs(one.along) for one in docked), 95, 1),
        _percentile((one.duration for one in found), 50, 1),
        _percentile((one.duration / one.planned for one in found), 50, 2),
        f"{over.over:.3f}",
        over.limit,
        f"{max(one.duration for one in found):.0f}",
        _percentile((1e3 * one.busy for one in found), 99, 2),
        _percentile((1e3 * one.off for one in docked), 95, 1),
        _percentile((math.degrees(one.turned_off) for one in docked), 95, 2),
        _percentile((one.recovered_after for one in found), 95, 0),
    ]


def _percentile(values: Iterable[float], percent: float, digits: int) -> str:
    """Return a percentile of the values that are not NaN, as one of these values; `-` without values."""
    column = np.fromiter(values, dtype=np.float64)
    column = column[~np.isnan(column)]
    return f"{np.percentile(column, percent, method='higher'):.{digits}f}" if column.size else "-"
